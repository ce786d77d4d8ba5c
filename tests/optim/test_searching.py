"""What a search may be given and told on its way: fixed variables, other bounds, a shape, guests, lost values."""

import pickle
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.errors import ComoveWarning, OptionError
from comove.optim import (
    CCMAES,
    Affine,
    AugmentedLagrangian,
    EpsilonLevel,
    FactorForm,
    Minimiser,
    NoRestarts,
    Penalty,
    Plain,
    ProjectionRepair,
    Reason,
    minimise,
)
from tests.cases import examples

METHODS = {
    "plain": Plain(),
    "separable": Plain(separable=True),
    "lagrangian": AugmentedLagrangian(),
    "ccmaes": CCMAES(),
    "factor": CCMAES(form=FactorForm),
    "epsilon": EpsilonLevel(),
    "penalty": Penalty(),
}


def ellipsoid(x):
    return ((x - 0.3) ** 2 * 10.0 ** np.arange(x.shape[1])).sum(axis=1)


def wall(x):
    return 0.5 - x[:, :1]


def advance(search, f, h=None, n_requests=1):
    """Ask and tell some times; return all points."""
    points = []
    for _ in range(n_requests):
        request = search.ask()
        points.append(request.x)
        search.tell(
            f(request.x) if request.objective else None, h(request.x) if request.constraints else None
        )
    return np.concatenate(points)


# --- Fixed variables ---


@pytest.mark.parametrize("name", METHODS)
def test_fixed_variables_never_move_and_the_rest_is_the_search_without_them(name):
    """Bit for bit: the search in three variables, of which the five-dimensional one knows no more."""
    value, free = np.array([7.0, 0, 0, -2.0, 0]), [1, 2, 4]
    lower, upper = np.where(value != 0, value, -5.0), np.where(value != 0, value, 5.0)
    seen = []

    def f(x):
        seen.extend(x)
        return ellipsoid(x[:, free])

    options = {"method": METHODS[name], "seed": 3, "max_evaluations": 400}
    whole = minimise(f, np.full(5, 1.0), 0.5, constraints=lambda x: wall(x[:, free]), bounds=(lower, upper),
                     **options)  # fmt: skip
    alone = minimise(ellipsoid, np.full(3, 1.0), 0.5, constraints=wall, bounds=(-5.0, 5.0), **options)
    assert (np.array(seen)[:, [0, 3]] == value[[0, 3]]).all()
    assert np.array_equal(whole.x[free], alone.x) and whole.fun == alone.fun
    assert whole.x[0] == 7.0 and whole.x[3] == -2.0


def test_nothing_is_left_to_search_where_all_is_fixed():
    with pytest.raises(OptionError, match="every variable is fixed"):
        minimise(ellipsoid, np.ones(2), 0.5, bounds=(1.0, 1.0))
    projection = ProjectionRepair(Affine([[1.0, 1.0]], [1.0]))
    with pytest.raises(OptionError, match="projection would move fixed"):
        Minimiser(np.ones(2), 0.5, bounds=([0, 1.0], [3, 1.0]), method=projection)
    with pytest.raises(OptionError, match="bounds"):
        Minimiser(np.ones(2), 0.5, bounds=(np.inf, np.inf))


# --- Bounds that change ---


@pytest.mark.parametrize("name", [name for name in METHODS if name not in ("plain", "separable", "penalty")])
def test_bounds_may_change_on_the_way(name):
    search = Minimiser(np.ones(3), 0.5, n_constraints=1, bounds=(0.0, 2.0), method=METHODS[name], seed=1)
    advance(search, ellipsoid, wall, 20)
    search.change_bounds(([0.8, -1.0, 0.1], [3.0, 3.0, 0.1]))
    points = advance(search, ellipsoid, wall, 400)
    assert (points[:, 0] >= 0.8).all() and (points[:, 1] < 0).any() and (points[:, 2] == 0.1).all()
    assert np.abs(search.result().x - [0.8, 0.3, 0.1]).max() < 1e-3
    search.change_bounds(None)
    advance(search, ellipsoid, wall, 400)
    assert np.abs(search.result().x - [0.5, 0.3, 0.3]).max() < 1e-3


def test_what_was_learned_stays_and_what_lies_outside_is_forgotten():
    search = Minimiser(np.full(4, 0.5), 0.3, seed=0)
    advance(search, ellipsoid, n_requests=60)
    best, (mean, sigma, covariance) = search.best_fun, search._run.distribution
    search.change_bounds((-10.0, 10.0))
    assert search.best_fun == best
    again = search._run.distribution
    assert np.array_equal(again[0], mean) and again[1] == sigma and np.allclose(again[2], covariance)
    search.change_bounds((0.4, 10.0))
    assert np.isnan(search.best_fun) and not search.result().feasible
    assert np.abs(advance(search, ellipsoid, n_requests=150)[-6:] - 0.4).max() < 1e-2
    assert search.best_fun == pytest.approx(ellipsoid(np.full((1, 4), 0.4))[0], rel=1e-3)
    search.ask()
    with pytest.raises(OptionError, match="still waits for its values"):
        search.change_bounds(None)


def test_guests_that_wait_come_to_the_new_bounds_too():
    search = Minimiser(np.zeros(3), 0.1, population=6, seed=0)
    search.inject(np.full((2, 3), 0.5))
    search.change_bounds(([-1, -1, 0.2], [0.4, 1, 0.2]))
    assert np.array_equal(search.ask().x[:2], np.tile([0.4, 0.5, 0.2], (2, 1)))


# --- The first distribution ---


@pytest.mark.parametrize("method", [None, CCMAES(), CCMAES(form=FactorForm), AugmentedLagrangian()])
def test_the_first_samples_have_the_given_covariance(method):
    matrix = np.array([[4.0, 1.0, 0.0], [1.0, 1.0, -0.2], [0.0, -0.2, 0.25]])
    search = Minimiser(np.ones(3), 0.1, covariance=matrix, method=method, population=20_000, seed=2)
    found = np.cov(search.ask().x.T) / 0.01
    assert np.abs(found - matrix).max() < 0.15


def test_variances_along_the_axes_and_what_is_no_covariance():
    for method in (Plain(separable=True), Plain(), EpsilonLevel()):
        search = Minimiser(np.zeros(2), 1.0, covariance=[9.0, 0.01], method=method, population=5000)
        assert search.ask().x.std(axis=0) == pytest.approx([3.0, 0.1], rel=0.05)
    for wrong in (
        [1.0],
        [[1.0, 2.0], [2.0, 1.0]],
        [[1.0, 0.5], [0.0, 1.0]],
        [1.0, -1.0],
        "wide",
        [1.0, np.nan],
    ):
        with pytest.raises(OptionError, match="covariance"):
            Minimiser(np.zeros(2), 1.0, covariance=wrong)


def test_the_right_shape_saves_most_of_the_learning():
    """With the inverse Hessian an ellipsoid is a sphere."""
    options = {"target": 1e-9, "max_evaluations": 20_000, "restarts": NoRestarts()}
    start = 0.3 + 10.0 ** (-0.5 * np.arange(6))
    blind = minimise(ellipsoid, start, 0.5, **options)
    told = minimise(ellipsoid, start, 0.5, covariance=10.0 ** -np.arange(6.0), **options)
    assert told.n_objective < 0.8 * blind.n_objective


# --- Guests ---


@pytest.mark.parametrize("name", METHODS)
def test_injected_points_are_evaluated_as_they_are(name):
    guesses = np.array([[0.6, 0.4, 0.2], [1.5, 1.5, 1.5], [4.9, 4.9, 4.9]])
    search = Minimiser(np.ones(3), 0.2, n_constraints=1, bounds=(-5, 5), method=METHODS[name], seed=4)
    search.inject(guesses)
    points = advance(search, ellipsoid, wall, 6)
    assert all((points == guess).all(axis=1).any() for guess in guesses)
    search.inject([1.0, 2.0, 3.0])
    assert (advance(search, ellipsoid, wall, 40) == [1.0, 2.0, 3.0]).all(axis=1).any()


def test_more_guests_than_samples_fill_several_generations_and_a_far_one_is_followed_gently():
    search = Minimiser(np.zeros(3), 0.1, population=6, seed=0)
    guests = np.random.default_rng(1).uniform(-1, 1, (14, 3))
    search.inject(guests)
    points = advance(search, ellipsoid, n_requests=3)
    assert np.array_equal(points[:14], guests)
    search = Minimiser(np.zeros(3), 0.1, seed=0)
    search.inject(np.full(3, 1e6))
    request = search.ask()
    search.tell(np.where(np.arange(len(request.x)) == 0, -1.0, 1.0))
    assert np.linalg.norm(search._run.distribution[0]) < 1.0


def test_a_good_guess_wins():
    def hidden(x):
        return np.where(np.abs(x - 3.0).max(axis=1) < 0.05, -1.0, (x**2).sum(axis=1))

    guess = np.full((1, 4), 3.0)
    assert minimise(hidden, np.zeros(4), 0.3, injected=guess, max_evaluations=40).fun == -1.0
    assert minimise(hidden, np.zeros(4), 0.3, max_evaluations=40).fun > -1.0
    for wrong in ([1.0], "near", [[np.nan] * 4]):
        with pytest.raises(OptionError, match="cannot be injected"):
            minimise(hidden, np.zeros(4), 0.3, injected=wrong)
    with pytest.raises(OptionError, match="injected point 1 lies outside"):
        minimise(hidden, np.zeros(4), 0.3, bounds=(-1, 1), injected=[np.zeros(4), guess[0]])


# --- Asking and telling ---


def test_telling_without_asking_and_twice_are_errors():
    search = Minimiser(np.ones(3), 0.5)
    with pytest.raises(OptionError, match="nobody asked for; ask"):
        search.tell(np.zeros(7))
    request = search.ask()
    assert search.ask() is request
    search.tell(ellipsoid(request.x))
    with pytest.raises(OptionError, match="nobody asked for"):
        search.tell(ellipsoid(request.x))
    assert search.n_objective == len(request.x)
    search.ask()
    with pytest.raises(OptionError, match="values of shape"):
        search.tell(np.zeros(2))
    search.tell(ellipsoid(search.ask().x))  # a refused answer may be given again
    copy = pickle.loads(pickle.dumps(search))
    assert np.array_equal(copy.ask().x, search.ask().x)


def test_a_start_outside_the_bounds_is_told():
    with pytest.warns(ComoveWarning, match=r"x0\[1\] = 9 lies outside its bounds, 0 to 3"):
        search = Minimiser([1.0, 9.0, -1.0], 0.5, bounds=(0.0, 3.0))
    assert (search.ask().x >= 0).all() and (search.ask().x <= 3).all()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Minimiser([1.0, 3.0, 5.0], 0.5, bounds=([0, 0, 7], [3, 3, 7]))


@examples(20)
@given(st.integers(0, 2**32 - 1), st.sampled_from(sorted(METHODS)), st.integers(1, 6))
def test_batches_without_any_value_are_survived(seed, name, lost):
    """A simulator that fails for a while: afterwards the search finds what it finds."""
    constrained = name not in ("plain", "separable")
    search = Minimiser(
        np.ones(3),
        0.5,
        n_constraints=int(constrained),
        method=METHODS[name],
        seed=seed,
        restarts=NoRestarts(),
    )
    for k in range(600):
        if search.reason is not None:
            break
        request = search.ask()
        nothing = np.nan if k < lost else 0.0
        search.tell(
            nothing + ellipsoid(request.x) if request.objective else None,
            nothing + wall(request.x) if request.constraints else None,
        )
    assert search.result().fun < (0.05 if constrained else 1e-3)


def test_where_there_is_never_a_value_the_search_says_so():
    with pytest.raises(OptionError, match=r"no objective value of .* was finite"):
        minimise(lambda x: np.full(len(x), np.nan), np.ones(3), 0.5, max_evaluations=5000)


def test_a_start_where_nothing_is_defined_is_left_as_soon_as_one_sample_is():
    result = minimise(
        lambda x: np.where(x[:, 0] > 2.0, x[:, 0], np.nan), np.ones(1), 0.9, max_evaluations=3000, seed=5
    )
    assert 2.0 < result.fun < 2.001 and result.reason is Reason.EVALUATIONS


@pytest.mark.parametrize("limit", [1, 2, 5])
def test_a_limit_below_a_generation_ends_the_search_and_blames_no_function(limit):
    result = minimise(
        lambda x: (x**2).sum(axis=1),
        np.ones(5),
        0.3,
        constraints=lambda x: x[:, :1] - 1.0,
        max_evaluations=limit,
    )
    assert result.reason is Reason.EVALUATIONS
    assert max(result.n_objective, result.n_constraint) <= limit
