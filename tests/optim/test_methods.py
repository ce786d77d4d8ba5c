"""What every method of constrained minimisation must do, and what is particular to each."""

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.errors import OptionError
from comove.optim import (
    CCMAES,
    CMAES,
    Affine,
    AugmentedLagrangian,
    EpsilonLevel,
    FactorForm,
    MatrixForm,
    Minimiser,
    NoRestarts,
    Parameters,
    Penalty,
    Plain,
    PrintedForm,
    ProjectionRepair,
    Reason,
    StaleForm,
    minimise,
)
from comove.optim.method import Patience
from tests.cases import examples


def onto_half_space(x):
    """The nearest points with x_1 >= 1."""
    return np.column_stack([np.maximum(x[:, 0], 1.0), x[:, 1:]])


METHODS = {
    "lagrangian": AugmentedLagrangian(),
    "matrix": CCMAES(),
    "factor": CCMAES(FactorForm),
    "epsilon": EpsilonLevel(),
    "projection": ProjectionRepair(onto_half_space),
    "penalty": Penalty(),
}
EXACT = ["lagrangian", "matrix", "factor", "epsilon", "projection"]


def sphere(x):
    return (x**2).sum(axis=1)


def wall(x):
    """x_1 >= 1."""
    return 1.0 - x[:, :1]


def drive(search, f, h, n_tells):
    """Tell what is asked for; the points that were asked for."""
    asked = []
    for _ in range(n_tells):
        if search.reason is not None:
            break
        request = search.ask()
        asked.append(request.x.copy())
        search.tell(
            f(request.x) if request.objective else None, h(request.x) if request.constraints else None
        )
    return asked


# --- All ---


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.few(6)
def test_a_wall_before_the_optimum(name, seed):
    """min |x|^2 over x_1 >= 1 is 1, in 8 dimensions."""
    result = minimise(
        sphere,
        np.full(8, 2.0),
        0.7,
        constraints=wall,
        method=METHODS[name],
        restarts=NoRestarts(),
        seed=seed,
    )
    assert result.fun == pytest.approx(1.0, abs=1e-8 if name in EXACT else 5e-2)
    assert result.feasible or name == "penalty"  # which ends a little inside the wall


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.few(3)
def test_an_infeasible_start(name):
    result = minimise(
        sphere, np.full(8, -2.0), 0.7, constraints=wall, method=METHODS[name], restarts=NoRestarts(), seed=3
    )
    assert result.fun == pytest.approx(1.0, abs=1e-6 if name in EXACT else 5e-2)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("how", [copy.deepcopy, lambda search: pickle.loads(pickle.dumps(search))])
def test_a_copy_goes_on_with_the_same_samples(name, how):
    """Whatever a run is waiting for."""
    search = Minimiser(np.full(4, 2.0), 0.7, n_constraints=1, method=METHODS[name], seed=5)
    for _ in range(12):
        drive(search, sphere, wall, 1)
        other = how(search)
        assert np.array_equal(search.ask().x, other.ask().x)
        kept = copy.deepcopy(search)
        for one, two in zip(drive(search, sphere, wall, 6), drive(other, sphere, wall, 6), strict=True):
            assert np.array_equal(one, two)
        search = kept


@pytest.mark.parametrize("name", METHODS)
def test_bounds_are_never_left(name):
    lower, upper = np.array([-0.5, 0.2, -1.0, -3.0]), np.array([1.5, 4.0, 1.0, -1.0])
    search = Minimiser(
        np.array([1.2, 1.0, 0.0, -2.0]),
        2.0,
        n_constraints=1,
        bounds=(lower, upper),
        method=METHODS[name],
        seed=2,
    )
    for x in drive(search, sphere, wall, 400):
        assert (x >= lower).all()
        assert (x <= upper).all()
    assert search.result().fun == pytest.approx(1.0 + 0.2**2 + 1.0, abs=5e-2)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.few(3)
def test_nan_counts_as_infeasible(name):
    """Objective and constraint are NaN in a half space that the optimum does not touch."""

    def f(x):
        return np.where(x[:, 1] < -0.5, np.nan, sphere(x))

    def h(x):
        return np.where(x[:, 1:2] < -0.5, np.nan, wall(x))

    result = minimise(f, np.full(5, 2.0), 0.7, constraints=h, method=METHODS[name], max_evaluations=8_000)
    assert result.fun == pytest.approx(1.0, abs=1e-5 if name in EXACT else 5e-2)
    assert np.isfinite(h(result.x[None])).all()


@pytest.mark.parametrize("name", ["matrix", "factor", "epsilon", "penalty"])
def test_a_constraint_that_is_never_violated_changes_nothing(name):
    """The run is that without constraints to the bit."""

    def never(x):
        return np.full((len(x), 3), -1.0)

    def nothing(x):
        return np.zeros((len(x), 0))

    bound = Minimiser(np.ones(6), 0.5, n_constraints=3, method=METHODS[name])
    free = Minimiser(np.ones(6), 0.5, n_constraints=0, method=METHODS[name])
    while bound._restoration is not None:
        drive(bound, sphere, never, 1)
    for one, two in zip(drive(bound, sphere, never, 60), drive(free, sphere, nothing, 60), strict=True):
        assert np.array_equal(one, two)


@pytest.mark.parametrize("name", EXACT)
def test_a_scaled_problem_gives_the_scaled_run(name):
    """By a power of two, and without rounding where nothing but the samples' order counts."""
    method = ProjectionRepair(lambda x: 8 * onto_half_space(x / 8)) if name == "projection" else METHODS[name]
    plain = Minimiser(np.full(5, 2.0), 0.5, n_constraints=1, method=METHODS[name])
    scaled = Minimiser(np.full(5, 16.0), 4.0, n_constraints=1, method=method)
    one = drive(plain, sphere, wall, 150)
    two = drive(scaled, lambda x: sphere(x / 8), lambda x: wall(x / 8), 150)
    for x, y in zip(one, two, strict=True):
        assert y == pytest.approx(8 * x, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("name", ["lagrangian", "matrix", "factor"])
def test_duplicated_constraints(name):
    """Ten copies of one wall are one wall."""
    result = minimise(
        sphere,
        np.full(5, 2.0),
        0.7,
        constraints=lambda x: np.repeat(wall(x), 10, axis=1),
        method=METHODS[name],
        restarts=NoRestarts(),
    )
    assert result.fun == pytest.approx(1.0, abs=1e-8)


@pytest.mark.parametrize("name", ["lagrangian", "matrix", "epsilon"])
def test_many_constraints(name):
    """A ball of radius 1 around (2, 0, ..) described by 300 tangent planes; the optimum lies near (1, 0, ..)."""
    rng = np.random.default_rng(0)
    normals = rng.standard_normal((300, 4))
    normals[0] = [-1.0, 0, 0, 0]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    centre = np.array([2.0, 0, 0, 0])
    result = minimise(
        sphere,
        centre,
        0.3,
        constraints=lambda x: (x - centre) @ normals.T - 1.0,
        method=METHODS[name],
        restarts=NoRestarts(),
        max_evaluations=30_000,
    )
    assert result.feasible
    assert result.fun == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("name", ["lagrangian", "matrix", "epsilon", "penalty"])
def test_infeasible_problems_end_with_the_least_violated_point(name):
    """x_1 <= -1 and x_1 >= 1: every point between misses by 2 in sum, all others by more."""
    result = minimise(
        sphere,
        np.full(3, 2.0),
        0.5,
        constraints=lambda x: np.column_stack([x[:, 0] + 1, 1 - x[:, 0]]),
        method=METHODS[name],
        max_evaluations=3000,
    )
    assert not result.feasible
    assert result.violation == pytest.approx(2.0, abs=1e-9)
    assert -1 - 1e-9 <= result.x[0] <= 1 + 1e-9


@pytest.mark.parametrize("name", ["lagrangian", "matrix", "epsilon", "penalty"])
@pytest.mark.few(2)
def test_values_beyond_all_bounds_are_survived(name):
    """exp(100 |x|) overflows in most of the first samples; the optimum is ordinary."""

    def f(x):
        with np.errstate(over="ignore"):
            return np.exp(100 * (np.abs(x[:, 0] - 1) + (x[:, 1:] ** 2).sum(axis=1)))

    for seed in range(3):
        result = minimise(
            f,
            np.full(3, 1.0),
            2.0,
            constraints=lambda x: wall(x) * 1e150,
            method=METHODS[name],
            seed=seed,
            max_evaluations=4000,
        )
        assert result.n_constraint > 3000
        assert result.feasible or name == "penalty"


# --- Equalities ---


def circle(x):
    """x_1^2 + x_2^2 = 1."""
    return (x[:, :1] ** 2 + x[:, 1:2] ** 2) - 1.0


@pytest.mark.parametrize(
    ("name", "tolerance", "precision"),
    [("lagrangian", 1e-4, 1e-9), ("epsilon", 1e-4, 1e-4), ("matrix", 1e-2, 1e-4)],
)
@pytest.mark.few(1)
def test_an_equality(name, tolerance, precision):
    """min x_1 + x_2 + |rest|^2 on the unit circle is -sqrt 2, and with a tolerance t -sqrt(2 + 2 t)."""
    result = minimise(
        lambda x: x[:, 0] + x[:, 1] + (x[:, 2:] ** 2).sum(axis=1),
        np.full(4, 0.8),
        0.4,
        constraints=circle,
        equality=[True],
        tolerance=tolerance,
        method=METHODS[name],
        max_evaluations=40_000,
    )
    assert result.feasible
    assert abs(circle(result.x[None])[0, 0]) <= tolerance
    assert result.fun == pytest.approx(-np.sqrt(2 + 2 * tolerance), abs=precision)


def test_linear_equalities_by_projection():
    rng = np.random.default_rng(0)
    matrix, right = rng.standard_normal((2, 6)), rng.standard_normal(2)
    result = minimise(
        sphere, np.zeros(6), 1.0, method=ProjectionRepair(Affine(matrix, right)), restarts=NoRestarts()
    )
    expected = np.linalg.pinv(matrix) @ right
    assert matrix @ result.x == pytest.approx(right, abs=1e-12)
    assert result.x == pytest.approx(expected, abs=1e-5)


def test_contradicting_linear_equalities_are_told():
    with pytest.raises(OptionError, match="contradict"):
        Affine(np.ones((2, 3)), np.array([0.0, 1.0]))


@pytest.mark.parametrize(
    ("matrix", "right"),
    [
        (np.ones((2, 3)), np.zeros(3)),
        (np.ones(3), 1.0),
        ([["a"]], [1.0]),
        ([[1.0, np.nan]], [1.0]),
        ([[1.0]], [np.inf]),
        ([[10**400]], [1.0]),
        (None, None),
    ],
)
def test_linear_equalities_that_do_not_fit_are_told(matrix, right):
    with pytest.raises(OptionError, match="shapes"):
        Affine(matrix, right)


def test_linear_equalities_may_be_lists():
    assert Affine([[1.0, 1.0]], [2.0])(np.zeros((1, 2))) == pytest.approx(np.ones((1, 2)))


# --- Constrained CMA-ES ---


@pytest.mark.parametrize("n", [10, 40, pytest.param(400, marks=pytest.mark.slow)])
@pytest.mark.parametrize("form", [MatrixForm, FactorForm])
@pytest.mark.few(2)
def test_ten_thousand_reductions_leave_the_distribution_regular(form, n):
    """Every reduction multiplies the determinant by 1 - share or so; singular it never gets."""
    passes = 10_000 if form is MatrixForm or n == 10 else 10_000 // (n // 4)
    rng = np.random.default_rng(0)
    covariance = form(n)
    records = rng.standard_normal((3, n))
    for _ in range(passes):
        z = rng.standard_normal((1, n))
        told = covariance.record(z, covariance.scaled(z))
        fading = 1 / (n + 2)
        records = (1 - fading) * records + fading * told
        records = covariance.reduce(records, np.full(3, 0.1 / (n + 2) / 3))
        covariance.matrix /= np.abs(covariance.matrix).max()  # only the shape counts
        if form is FactorForm:
            covariance._decompose()
    steps = covariance.scaled(np.eye(n))
    assert np.isfinite(steps).all()
    assert np.linalg.svd(steps, compute_uv=False).min() > 0


def test_the_printed_form_says_when_it_loses_definiteness():
    result = minimise(
        sphere,
        np.full(10, 2.0),
        1.0,
        constraints=wall,
        method=CCMAES(PrintedForm),
        restarts=NoRestarts(),
    )
    assert result.reason is Reason.NOT_POSITIVE_DEFINITE
    assert result.feasible


def test_the_printed_form_is_equation_6():
    """For one sample and one constraint, against the formula."""
    rng = np.random.default_rng(0)
    form = PrintedForm(4)
    record = rng.standard_normal((1, 4))
    form.reduce(record, np.array([0.1]))
    assert form.matrix == pytest.approx(np.eye(4) - 0.1 * record.T @ record / (record @ record.T))


@given(st.integers(0, 2**32 - 1))
@examples(30)
def test_the_factor_form_scales_along_one_whitened_direction(seed):
    """A (I - s w w^T): eigenvalues of the bracket are 1 - s and 1, so that det A shrinks by exactly 1 - s."""
    rng = np.random.default_rng(seed)
    form = FactorForm(4)
    root = rng.standard_normal((4, 4))
    form.matrix = root @ root.T + 0.1 * np.eye(4)
    form._decompose()
    before = np.linalg.det(form.matrix)
    form.reduce(rng.standard_normal((1, 4)), np.array([0.2]))
    assert np.linalg.det(form.matrix) == pytest.approx((1 - 0.2) ** 2 * before, rel=1e-9)


@given(st.integers(0, 2**32 - 1))
@examples(30)
def test_with_records_carried_along_the_factor_form_is_the_matrix_form(seed):
    """As long as nothing is learned of values, which they do differently: A z is violated, z is recorded."""
    rng = np.random.default_rng(seed)
    factor, matrix = FactorForm(5), MatrixForm(5)
    steps, samples = np.zeros((2, 5)), np.zeros((2, 5))
    for _ in range(30):
        z, violated = rng.standard_normal(5), rng.random(2) < 0.7
        steps[violated] = 0.8 * steps[violated] + 0.2 * factor.scaled(z[None])
        samples[violated] = 0.8 * samples[violated] + 0.2 * z
        shares = 0.2 * violated
        steps, samples = factor.reduce(steps, shares), matrix.reduce(samples, shares)
        assert factor.scaled(np.eye(5)) == pytest.approx(matrix.scaled(np.eye(5)), rel=1e-8, abs=1e-12)


def test_stale_records_shorten_what_is_short_already():
    """A constraint is violated along the first axis for a while, and then along the second."""
    ratios = {}
    for form in (FactorForm, StaleForm):
        covariance, record = form(2), np.zeros((1, 2))
        for axis in [0] * 40 + [1] * 40:
            record = 0.9 * record + 0.1 * covariance.scaled(np.eye(2)[axis][None])
            record = covariance.reduce(record, np.array([0.1]))
        first, second = covariance.standard_deviations()
        ratios[form] = second / first
    assert ratios[StaleForm] > 4.0 * ratios[FactorForm] > 4.0


def test_reductions_narrow_the_distribution_across_the_wall():
    """Along the wall's normal, and not along it."""
    search = Minimiser(np.full(6, 1.05), 1.0, n_constraints=1, method=CCMAES())
    drive(search, sphere, wall, 40)
    spread = search._run._es.covariance.standard_deviations()
    assert spread[0] < 0.8 * spread[1:].min()


def test_a_run_that_finds_nothing_feasible_says_that_it_stalled():
    """The feasible set closes after the first generations."""
    calls = []

    def closing(x):
        calls.append(len(x))
        return np.full((len(x), 1), -1.0 if len(calls) < 20 else 1.0)

    result = minimise(
        sphere,
        np.ones(5),
        1.0,
        constraints=closing,
        method=CCMAES(passes=5, stalls=3),
        restarts=NoRestarts(),
    )
    assert result.reason is Reason.STALLED
    assert result.feasible
    assert sum(calls) < 20 * 8 + 3 * 6 * 8 + 8


def test_viability_boundaries_fall_to_zero_and_then_the_run_begins_cleanly():
    """Without the restoration before it: the run itself is given an infeasible start."""
    search = Minimiser(np.full(5, 2.0), 0.5, n_constraints=1, method=CCMAES())
    search._start_run(np.full(5, -2.0))
    heights = []
    for _ in range(400):
        drive(search, sphere, wall, 1)
        if search._run.boundaries is not None:
            heights.append(search._run.boundaries[0])
    assert heights[0] > 1.0
    assert (np.diff(heights) <= 0).all()
    assert heights[-1] == 0.0
    assert search.result().fun == pytest.approx(1.0, abs=1e-3)


# --- The plain run ---


def test_plain_is_cma_es():
    """The very samples of `CMAES`."""
    search = Minimiser(np.ones(5), 0.5, method=Plain(), seed=7)
    alone = CMAES(
        np.ones(5), 0.5, np.random.default_rng([7, 1, 0]), parameters=Parameters.default(5, active=True)
    )
    for x in drive(search, sphere, None, 30):
        y = alone.ask()
        assert np.array_equal(x, y)
        alone.tell(sphere(y))


@pytest.mark.parametrize("weight", [0.0, -1.0, np.inf, np.nan])
def test_bad_weights_are_told(weight):
    with pytest.raises(OptionError, match="weight"):
        Minimiser(np.ones(3), 1.0, method=Penalty(weight))


def balls(x):
    """Negative inside one of 729 balls of radius 1/4 about whole numbers from 1 to 9 (CEC 2006, g12)."""
    nearest = np.clip(np.round(x), 1, 9)
    return ((x - nearest) ** 2).sum(axis=1, keepdims=True) - 0.0625


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.few(2)
def test_disconnected_feasible_sets_are_crossed(seed):
    """The best ball is found from any other, with few evaluations: from afar the constraint has no slope."""
    start = np.random.default_rng(seed).uniform(0, 10, 3)
    result = minimise(
        lambda x: ((x - 5) ** 2).sum(axis=1) / 100 - 1,
        start, 3.0, constraints=balls, bounds=(0.0, 10.0), seed=seed, target=-1 + 1e-4, max_evaluations=8000,
    )  # fmt: skip
    assert result.fun <= -1 + 1e-4


def wrinkled(x):
    """Oscillate around x, by a factor that repeats at every scale (COCO's T_osz; Hansen et al., 2009)."""
    size = np.log(np.abs(x) + 1e-300)
    fast, slow = np.where(x > 0, 10.0, 5.5), np.where(x > 0, 7.9, 3.1)
    return np.sign(x) * np.exp(size + 0.049 * (np.sin(fast * size) + np.sin(slow * size)))


@pytest.mark.parametrize("seed", [1, 6, 7])
@pytest.mark.few(1)
def test_two_wrinkled_constraints_that_nearly_oppose_each_other(seed):
    """Their forces are a hundred times the slope that they hold; where no model fits, multipliers must not fall."""
    rng, n = np.random.default_rng(seed), 10
    weights, centre = 10.0 ** (6 * np.arange(n) / (n - 1)), rng.standard_normal(n)
    slope = 2 * weights * centre
    size = np.linalg.norm(slope)
    across = weights * rng.standard_normal(n)
    across *= 100 * size / np.linalg.norm(across)
    rows = np.stack([slope - across, across]) / size
    x0, optimum = rng.standard_normal(n), rng.uniform(-2, 2, n)
    best = (weights * centre**2).sum() / size
    result = minimise(
        lambda x: (weights * (wrinkled(x - optimum) - centre) ** 2).sum(axis=1) / size,
        x0,
        1.0,
        constraints=lambda x: wrinkled(x - optimum) @ rows.T,
        seed=seed,
        max_evaluations=30_000,
        target=best + 1e-7,
    )
    assert result.reason is Reason.TARGET


def test_a_huge_value_of_one_sample_is_no_convergence():
    patience = Patience(1.0, window=10)
    values = np.append(np.linspace(0.0, 1.0, 11), 1e40)
    assert all(patience.reason(np.ones(3), 1.0, values * 0.9**i) is None for i in range(60))
