"""The door: what it counts, returns and refuses."""

import pickle
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from comove.errors import ComoveWarning, OptionError
from comove.optim import (
    BIPOP,
    CCMAES,
    IPOP,
    AugmentedLagrangian,
    EpsilonLevel,
    Minimiser,
    NoRestarts,
    Penalty,
    Reason,
    Reduction,
    minimise,
)
from comove.optim.restarts import Ended, Setting


def sphere(x):
    return (x**2).sum(axis=1)


def one_sphere(x):
    return float((x**2).sum())


def wall(x):
    return 1.0 - x[:, :1]


def one_wall(x):
    return np.array([1.0 - x[0]])


def rastrigin(x):
    return (x**2 - 10 * np.cos(2 * np.pi * x) + 10).sum(axis=1)


class Counted:
    """A function that remembers every point."""

    def __init__(self, function):
        self.function, self.points = function, []

    def __call__(self, x):
        self.points.extend(x.copy())
        return self.function(x)


@pytest.mark.parametrize("limit", [5, 20, 137, 2000])
def test_evaluations_are_counted_and_limited(limit):
    f, h = Counted(sphere), Counted(wall)
    result = minimise(f, np.full(4, 2.0), 0.5, constraints=h, max_evaluations=limit)
    assert result.n_objective == len(f.points) <= limit
    assert result.n_constraint == len(h.points) <= limit
    assert result.reason is Reason.EVALUATIONS


@pytest.mark.parametrize("method", [None, CCMAES()])
def test_the_best_feasible_point_ever_seen_is_returned(method):
    f = Counted(sphere)
    result = minimise(f, np.full(4, 2.0), 0.5, constraints=wall, method=method, max_evaluations=700)
    points = np.array(f.points)
    feasible = points[(wall(points) <= 0).all(axis=1)]
    assert result.fun == sphere(feasible).min()
    assert sphere(result.x[None])[0] == result.fun
    assert result.violation == 0.0
    assert (np.diff(result.history[:, 0]) >= 0).all()
    assert result.history[-1, 2] == result.fun


def test_without_a_feasible_point_the_least_violated_is_returned():
    h = Counted(lambda x: 1.0 + x[:, :1] ** 2)
    result = minimise(sphere, np.full(3, 2.0), 0.5, constraints=h, max_evaluations=400)
    assert result.violation == (1.0 + np.array(h.points)[:, 0] ** 2).min()
    assert not result.feasible


def test_one_point_at_a_time_is_the_same_search():
    options = {"seed": 3, "max_evaluations": 1500}
    many = minimise(sphere, np.full(3, 2.0), 0.5, constraints=wall, **options)
    single = minimise(one_sphere, np.full(3, 2.0), 0.5, constraints=one_wall, vectorized=False, **options)
    assert np.array_equal(many.x, single.x)
    assert many.n_constraint == single.n_constraint


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_results_do_not_depend_on_workers(workers):
    with ThreadPoolExecutor(workers) as pool:
        result = minimise(
            one_sphere,
            np.full(3, 2.0),
            0.5,
            constraints=one_wall,
            vectorized=False,
            map=pool.map,
            max_evaluations=800,
        )
    alone = minimise(
        one_sphere, np.full(3, 2.0), 0.5, constraints=one_wall, vectorized=False, max_evaluations=800
    )
    assert np.array_equal(result.x, alone.x)
    assert np.array_equal(result.history, alone.history, equal_nan=True)


def test_zero_constraints_are_no_constraints():
    options = {"seed": 1, "max_evaluations": 900}
    none = minimise(sphere, np.full(3, 2.0), 0.5, **options)
    empty = minimise(sphere, np.full(3, 2.0), 0.5, constraints=lambda x: np.zeros((len(x), 0)), **options)
    assert np.array_equal(none.x, empty.x)


def test_the_target_ends_the_search():
    result = minimise(sphere, np.full(4, 2.0), 0.5, constraints=wall, target=1.5)
    assert result.reason is Reason.TARGET
    assert 1.0 <= result.fun <= 1.5


def test_time_ends_the_search():
    begun = time.process_time()
    result = minimise(rastrigin, np.full(10, 3.0), 2.0, max_evaluations=10**9, max_seconds=0.3)
    assert result.reason is Reason.SECONDS
    assert 0.3 <= time.process_time() - begun < 20.0  # all evaluations would take hours


def test_waiting_costs_no_time():
    def waiting(x):
        time.sleep(0.01)
        return sphere(x)

    result = minimise(waiting, np.ones(2), 0.5, max_evaluations=120, max_seconds=0.1)
    assert result.reason is Reason.EVALUATIONS


def test_the_work_of_other_processes_counts():
    """A map whose calls are made elsewhere: this process only waits."""

    def elsewhere(call, points):
        return [(-1, 1.0, call(point)[2]) for point in points]

    wanted = {"max_evaluations": 10**6, "vectorized": False, "map": elsewhere}
    result = minimise(lambda x: float(x @ x), np.ones(3), 0.5, max_seconds=100.0, **wanted)
    assert result.reason is Reason.SECONDS and 100 <= result.n_objective < 130


def test_the_callback_sees_the_search_and_may_end_it():
    seen = []

    def callback(search):
        seen.append(search.n_objective)
        return len(seen) == 5

    result = minimise(sphere, np.ones(3), 0.5, callback=callback)
    assert result.reason is Reason.CALLBACK
    assert len(seen) == 5
    assert seen == sorted(seen)


def test_what_the_objective_raises_comes_through_and_the_search_can_go_on():
    calls = []

    def f(x):
        calls.append(len(x))
        if len(calls) == 20:
            raise ZeroDivisionError("the simulator fell over")
        return sphere(x)

    with pytest.raises(ZeroDivisionError, match="fell over") as caught:
        minimise(f, np.full(3, 2.0), 0.5, constraints=wall, seed=4, max_evaluations=1000)
    assert f"after {sum(calls[:-1])} evaluations of the objective" in caught.value.__notes__[0]
    search = pickle.loads(pickle.dumps(caught.value.search))
    while search.n_objective < 900:
        request = search.ask()
        search.tell(
            sphere(request.x) if request.objective else None, wall(request.x) if request.constraints else None
        )
    whole = minimise(sphere, np.full(3, 2.0), 0.5, constraints=wall, seed=4, max_evaluations=1000)
    assert search.result().history[10].tolist() == whole.history[10].tolist()


def test_arrays_of_the_caller_are_left_alone():
    x0, mask = np.full(3, 2.0), np.array([True])
    minimise(sphere, x0, 0.5, constraints=wall, equality=mask, max_evaluations=200)
    assert np.array_equal(x0, np.full(3, 2.0))
    assert np.array_equal(mask, [True])

    def vandal(x):
        values = sphere(x)
        x[:] = np.nan
        return values

    spoilt = minimise(vandal, x0, 0.5, max_evaluations=500)
    assert np.array_equal(spoilt.x, minimise(sphere, x0, 0.5, max_evaluations=500).x)


def test_the_same_seed_is_the_same_search():
    results = [
        minimise(rastrigin, np.full(4, 3.0), 1.0, seed=seed, max_evaluations=4000) for seed in (1, 1, 2)
    ]
    assert np.array_equal(results[0].history, results[1].history, equal_nan=True)
    assert not np.array_equal(results[0].x, results[2].x)


# --- Restarts ---


@pytest.mark.parametrize("method", [AugmentedLagrangian(), CCMAES(), EpsilonLevel(), Penalty()])
def test_methods_for_constraints_serve_without_any(method):
    result = minimise(sphere, np.full(3, 2.0), 0.5, method=method, restarts=NoRestarts())
    assert result.fun < 1e-9
    assert result.n_constraint == 0


def test_nothing_outside_the_bounds_is_evaluated_even_if_the_start_lies_there():
    f, h = Counted(sphere), Counted(wall)
    with pytest.warns(ComoveWarning, match="nearest point inside"):
        minimise(f, np.full(3, 9.0), 0.5, constraints=h, bounds=(0.0, 3.0), max_evaluations=300)
    points = np.array(f.points + h.points)
    assert points.min() >= 0.0
    assert points.max() <= 3.0


@pytest.mark.parametrize("restarts", [IPOP(), pytest.param(BIPOP(), marks=pytest.mark.slow)])
def test_restarts_find_what_one_run_does_not(restarts):
    """The global optimum of Rastrigin's function in 6 dimensions, from seed 0 to 2."""
    for seed in range(3):
        result = minimise(
            rastrigin,
            np.full(6, 3.0),
            2.0,
            restarts=restarts,
            seed=seed,
            target=1e-8,
            max_evaluations=200_000,
        )
        assert result.reason is Reason.TARGET


def test_restarts_begin_at_different_feasible_points():
    search = Minimiser(np.full(3, 2.0), 0.5, n_constraints=1, seed=2)
    begins = []
    while len(begins) < 4:
        fresh = search._restoration is not None
        request = search.ask()
        search.tell(
            sphere(request.x) if request.objective else None, wall(request.x) if request.constraints else None
        )
        if fresh and search._restoration is None:
            begins.append(search._run._es.mean)
    assert (wall(np.array(begins)) <= 0).all()
    assert len(np.unique(np.round(begins, 6), axis=0)) == 4


def test_bipop_spends_as_much_on_small_populations_as_on_large_ones():
    rng, ended = np.random.default_rng(0), [Ended(Setting(), 10, 1000)]
    for _ in range(60):
        setting = BIPOP().following(ended, rng)
        ended.append(Ended(setting, setting.population, 100 * setting.population))
    large = [run for run in ended[1:] if not run.setting.local]
    small = [run for run in ended[1:] if run.setting.local]
    cost = [sum(run.evaluations for run in runs) for runs in (large, small)]
    assert abs(cost[0] - cost[1]) <= large[-1].evaluations
    assert [run.population for run in large][:5] == [20, 40, 80, 160, 320]
    assert all(run.population <= large[-1].population for run in small)
    assert all(1e-2 <= run.setting.sigma <= 1 for run in small)


def test_bipop_may_begin_with_several_populations_that_grow_and_a_small_one_after_each():
    rng, ended = np.random.default_rng(0), [Ended(Setting(), 10, 1000)]
    for _ in range(12):
        setting = BIPOP(5.0, before=3, least=1).following(ended, rng)
        ended.append(Ended(setting, setting.population, 100 * setting.population))
    assert [run.setting.local for run in ended[:7]] == [False, True, False, True, False, True, True]
    assert [run.population for run in ended if not run.setting.local][:3] == [10, 50, 250]


@pytest.mark.parametrize(
    ("rule", "wrong"),
    [
        (IPOP, {"factor": 0}),
        (IPOP, {"factor": np.nan}),
        (IPOP, {"limit": -1}),
        (BIPOP, {"factor": np.inf}),
        (BIPOP, {"before": 0}),
        (BIPOP, {"before": "two"}),
        (BIPOP, {"before": 2.5}),
        (BIPOP, {"least": -1}),
        (BIPOP, {"limit": None}),
        (AugmentedLagrangian, {"penalty": 0}),
        (Penalty, {"weight": "heavy"}),
        (AugmentedLagrangian, {"growth": 0.5}),
        (AugmentedLagrangian, {"learning": np.nan}),
        (AugmentedLagrangian, {"adaptation": "fast"}),
        (AugmentedLagrangian, {"repairs": -3}),
        (AugmentedLagrangian, {"trust": np.inf}),
        (CCMAES, {"passes": 0}),
        (CCMAES, {"shrinkage": 1.5}),
        (CCMAES, {"patience": 1j}),
        (Reduction, {"size": -0.1}),
        (EpsilonLevel, {"quantile": 2}),
        (EpsilonLevel, {"horizon": True}),
    ],
)
def test_settings_that_cannot_be_followed_are_told(rule, wrong):
    with pytest.raises(OptionError, match=next(iter(wrong))):
        rule(**wrong)


def test_no_restarts():
    result = minimise(sphere, np.ones(3), 0.5, restarts=NoRestarts())
    assert result.reason is Reason.CONVERGED
    assert "tolerance" in result.reason.value


# --- Bad input ---


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"x0": []}, "x0"),
        ({"x0": [np.nan, 1.0]}, "x0"),
        ({"x0": [[1.0, 2.0]]}, "x0"),
        ({"sigma0": 0.0}, "sigma0"),
        ({"sigma0": -1.0}, "sigma0"),
        ({"sigma0": np.nan}, "sigma0"),
        ({"population": 1}, "population"),
        ({"population": 2.5}, "population"),
        ({"population": "many"}, "population"),
        ({"constraints": lambda x: [["low"]]}, "h <= 0 is feasible"),
        ({"seed": -1}, "seed"),
        ({"seed": 0.5}, "seed"),
        ({"tolerance": -1.0}, "tolerance"),
        ({"bounds": (0.0, -1.0)}, "bounds"),
        ({"bounds": ([0, 0, 0], [1, 1, 1])}, "bounds"),
        ({"bounds": 3}, "bounds"),
        ({"max_evaluations": 0}, "positive limits"),
        ({"max_seconds": -1.0}, "positive limits"),
        ({"constraints": lambda x: np.zeros(len(x))}, "h <= 0 is feasible"),
        ({"constraints": lambda x: np.zeros((len(x) + 1, 2))}, "h <= 0 is feasible"),
        ({"constraints": lambda x: np.zeros((len(x), 1 + (len(x) > 1)))}, "h <= 0 is feasible"),
        ({"constraints": lambda x: np.full((len(x), 2), np.nan)}, "h <= 0 is feasible"),
        ({"constraints": wall, "equality": [True, False]}, "equality"),
        ({"constraints": wall, "equality": [1]}, "equality"),
        ({"f": "sphere"}, "no function"),
        ({"constraints": 3}, "no function"),
        ({"max_evaluations": "many"}, "max_evaluations"),
        ({"target": "low"}, "target"),
        ({"method": CCMAES}, "method"),
        ({"method": "ccmaes"}, "method"),
        ({"restarts": "bipop"}, "restarts"),
        ({"f": lambda x: np.zeros((len(x), 1))}, "objective"),
        ({"f": lambda x: 0.0}, "objective"),
        ({"f": lambda x: ["low"] * len(x)}, "objective"),
        ({"f": lambda x: np.full(len(x), np.nan)}, "finite"),
        ({"f": lambda x: sphere(x) + 0j}, "real numbers"),
        ({"f": lambda x: sphere(x[None]) + 0j, "vectorized": False}, "real numbers"),
        ({"f": lambda x: [0.0] * (1 + (x[0] > 2)), "vectorized": False}, "objective"),
        ({"vectorized": "no"}, "vectorized"),
        ({"bounds": (None, 3.0)}, "-inf"),
    ],
)
def test_bad_input_is_told(changes, words):
    arguments = {"f": sphere, "x0": np.full(2, 2.0), "sigma0": 0.5, "max_evaluations": 500} | changes
    f, x0, sigma0 = (arguments.pop(key) for key in ("f", "x0", "sigma0"))
    with pytest.raises(OptionError, match=words):
        minimise(f, x0, sigma0, **arguments)


@pytest.mark.parametrize("method", [AugmentedLagrangian(), CCMAES(), EpsilonLevel(), Penalty()])
@pytest.mark.parametrize("seed", range(40))
@pytest.mark.few(8)
def test_no_values_make_a_search_fail(method, seed):
    """Objective and constraints are noise over up to 600 orders of magnitude, and sometimes not finite."""
    rng = np.random.default_rng(seed)
    n, m = rng.integers(1, 6), rng.integers(1, 5)
    span, lost = rng.choice([3, 20, 100, 300]), rng.choice([0.0, 0.2])

    def noise(*shape):
        values = rng.choice([-1.0, 1.0], shape) * 10.0 ** rng.uniform(-span, span, shape)
        return np.where(rng.random(shape) < lost, rng.choice([np.nan, np.inf, -np.inf], shape), values)

    search = Minimiser(
        np.zeros(n), 1.0, n_constraints=int(m), equality=rng.random(m) < 0.4, method=method, seed=seed
    )
    for _ in range(200):
        if search.reason is not None:
            break
        request = search.ask()
        assert np.isfinite(request.x).all()
        k = len(request.x)
        search.tell(noise(k) if request.objective else None, noise(k, m) if request.constraints else None)
    assert np.isfinite(search.result().x).all()
