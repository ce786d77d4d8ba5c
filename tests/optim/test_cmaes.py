"""CMA-ES: it minimises, is blind to what should not matter, agrees with another, and repeats itself."""

import copy
import pickle

import cmaes
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.errors import OptionError
from comove.optim import CMAES, DiagonalCovariance, FullCovariance, Parameters, TransformationMatrix

N = 12
FORMS = {
    "full": (FullCovariance, {}),
    "active": (FullCovariance, {"active": True}),
    "matrix": (TransformationMatrix, {}),
    "separable": (DiagonalCovariance, {"separable": True}),
}
ROTATION = np.linalg.qr(np.random.default_rng(1).standard_normal((N, N)))[0]


def sphere(x):
    return (x**2).sum(axis=1)


def ellipsoid(x):
    return (10 ** (6 * np.arange(x.shape[1]) / (x.shape[1] - 1)) * x**2).sum(axis=1)


def rotated(x):
    return ellipsoid(x @ ROTATION)


def rosenbrock(x):
    return (100 * (x[:, 1:] - x[:, :-1] ** 2) ** 2 + (1 - x[:, :-1]) ** 2).sum(axis=1)


def start(form, mean=None, sigma=0.5, rng=None, population=None):
    covariance, options = FORMS[form]
    mean = np.ones(N) if mean is None else mean
    return CMAES(
        mean,
        sigma,
        np.random.default_rng(0) if rng is None else rng,
        parameters=Parameters.default(len(mean), population, **options),
        covariance=covariance(len(mean)),
    )


def run(search, f, n_generations):
    """Means on the way, and the order of the samples in every generation."""
    means, orders = [], []
    for _ in range(n_generations):
        values = f(search.ask())
        orders.append(np.argsort(values, kind="stable"))
        search.tell(values)
        means.append(search.mean.copy())
    return np.array(means), np.array(orders)


# --- It minimises ---


@pytest.mark.parametrize(
    ("form", "f", "n_generations"),
    [(form, f, 900) for form in ("full", "active", "matrix") for f in (sphere, ellipsoid, rotated)]
    + [("separable", sphere, 400), ("separable", ellipsoid, 600)]
    + [("full", rosenbrock, 1500), ("matrix", rosenbrock, 1500)],
)
def test_minimises(form, f, n_generations):
    """Condition numbers of 1e6 in any direction are learned, except by variances along the axes alone."""
    search = start(form, np.zeros(N) if f is rosenbrock else None)
    run(search, f, n_generations)
    assert f(search.mean[None])[0] < 1e-9


def test_variances_alone_do_not_learn_rotated_axes():
    search = start("separable")
    run(search, rotated, 600)
    assert rotated(search.mean[None])[0] > 1e-2


@pytest.mark.parametrize("form", ["full", "matrix"])
def test_the_covariance_becomes_the_inverse_hessian(form):
    """On a quadratic function, up to a factor (Hansen's tutorial): condition numbers agree within a factor of 4."""
    search = start(form)
    run(search, lambda x: rotated(x), 700)
    steps = search.covariance.scaled(np.eye(N))  # rows: images of unit vectors
    shape = steps.T @ steps
    hessian = ROTATION @ np.diag(10 ** (6 * np.arange(N) / (N - 1))) @ ROTATION.T
    product = np.linalg.eigvals(shape @ hessian).real
    assert product.max() / product.min() < 30


def test_active_updates_are_faster_on_the_ellipsoid():
    generations = {}
    for form in ("full", "active"):
        search, g = start(form), 0
        while rotated(search.mean[None])[0] > 1e-9:
            run(search, rotated, 1)
            g += 1
        generations[form] = g
    assert generations["active"] < 0.9 * generations["full"]


# --- Agreement ---


class Replayed:
    """Random numbers that were drawn elsewhere."""

    def __init__(self):
        self.next = None

    def standard_normal(self, shape):
        assert self.next.shape == shape
        return self.next


@pytest.mark.parametrize("f", [sphere, rosenbrock, rotated])
def test_agrees_step_by_step_with_another_implementation(f):
    """With `cmaes` (Nomura and Shibata, 2024), its constants, and the same samples in every generation."""
    n = N
    theirs = cmaes.CMA(mean=np.full(n, 0.5), sigma=0.7, seed=3)
    constants = Parameters.default(n, theirs.population_size, active=True)
    constants = Parameters(
        n=n,
        population=theirs.population_size,
        weights=theirs._weights,
        mu=theirs._mu,
        mu_eff=theirs._mu_eff,
        c_sigma=theirs._c_sigma,
        d_sigma=theirs._d_sigma,
        c_c=theirs._cc,
        c_1=theirs._c1,
        c_mu=theirs._cmu,
    )
    numbers = Replayed()
    ours = CMAES(np.full(n, 0.5), 0.7, numbers, parameters=constants)
    assert constants.lazy_gap == 1
    for _ in range(120):
        points = np.array([theirs.ask() for _ in range(theirs.population_size)])
        numbers.next = ours.covariance.whitened((points - ours.mean) / ours.sigma)
        assert np.abs(ours.ask() - points).max() < 1e-9 * max(1.0, np.abs(points).max())
        values = f(points)
        theirs.tell(list(zip(points, values, strict=True)))
        ours.tell(values)
        assert ours.mean == pytest.approx(theirs.mean, rel=1e-7, abs=1e-10)
        assert ours.sigma == pytest.approx(theirs._sigma, rel=1e-7)
        assert ours.covariance.matrix == pytest.approx(theirs._C, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("n", [5, 10, 40])
def test_constants_are_those_of_the_tutorial(n):
    """Relations of Hansen's table 1 that do not repeat its formulas."""
    p = Parameters.default(n, active=True)
    assert p.population == 4 + int(3 * np.log(n))
    assert p.weights[: p.mu].sum() == pytest.approx(1.0)
    assert (np.diff(p.weights) <= 0).all()
    assert p.mu_eff == pytest.approx(0.27 * p.population, rel=0.25)
    assert p.c_1 == pytest.approx(2 / n**2, rel=0.8)
    assert 0 < p.c_1 + p.c_mu <= 1
    # negative weights leave the covariance positive definite
    assert 1 - p.c_1 - p.c_mu * p.weights.sum() + n * p.c_mu * p.weights[p.mu :].sum() > 0
    lengths = np.linalg.norm(np.random.default_rng(0).standard_normal((200_000, n)), axis=1)
    assert p.expected_length == pytest.approx(lengths.mean(), rel=3e-3)


# --- What does not matter ---


@pytest.mark.parametrize("form", FORMS)
def test_a_scaled_problem_gives_the_scaled_run(form):
    """By a power of two: not even rounding differs."""
    plain, _ = run(start(form), ellipsoid, 60)
    scaled, _ = run(start(form, 8 * np.ones(N), 4.0), lambda x: ellipsoid(x / 8), 60)
    assert np.array_equal(scaled, 8 * plain)


@pytest.mark.parametrize("form", FORMS)
def test_a_shifted_problem_gives_the_shifted_run(form):
    shift = np.linspace(-3, 3, N)
    plain, _ = run(start(form), ellipsoid, 40)
    moved, _ = run(start(form, np.ones(N) + shift), lambda x: ellipsoid(x - shift), 40)
    assert np.abs(moved - shift - plain).max() < 1e-8


@pytest.mark.parametrize("form", FORMS)
def test_only_the_order_of_the_values_counts(form):
    plain, _ = run(start(form), sphere, 60)
    bent, _ = run(start(form), lambda x: np.exp(sphere(x)) - 7, 60)
    assert np.array_equal(plain, bent)


@pytest.mark.parametrize("form", ["full", "active", "matrix"])
def test_a_rotated_problem_gives_the_rotated_run(form):
    """The same ranking history where the random numbers are rotated too."""

    class Turned:
        def __init__(self):
            self.rng = np.random.default_rng(0)

        def standard_normal(self, shape):
            return self.rng.standard_normal(shape) @ ROTATION.T

    plain, orders = run(start(form), ellipsoid, 80)
    turned, turned_orders = run(start(form, ROTATION @ np.ones(N), rng=Turned()), rotated, 80)
    assert np.array_equal(orders, turned_orders)
    assert np.abs(turned @ ROTATION - plain).max() < 1e-8


# --- It repeats itself ---


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("how", [copy.deepcopy, lambda search: pickle.loads(pickle.dumps(search))])
def test_a_copy_goes_on_with_the_same_samples(form, how):
    search = start(form)
    run(search, ellipsoid, 7)
    search.ask()
    other = how(search)
    values = ellipsoid(search.mean + search.sigma * search.y)
    for each in (search, other):
        each.tell(values)
    assert np.array_equal(run(search, ellipsoid, 5)[0], run(other, ellipsoid, 5)[0])


def test_no_global_random_state():
    np.random.seed(0)  # noqa: NPY002
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    run(start("full"), sphere, 5)
    assert np.array_equal(before, np.random.get_state()[1])  # noqa: NPY002


def test_arrays_of_the_caller_are_left_alone():
    mean = np.ones(N)
    search = start("full", mean)
    x = search.ask()
    values, points = sphere(x), x.copy()
    values[3] = np.nan
    told = values.copy()
    search.tell(values)
    assert np.array_equal(values, told, equal_nan=True)
    assert np.array_equal(x, points)
    assert np.array_equal(mean, np.ones(N))


@given(st.integers(0, 2**31), st.integers(4, 30))
def test_nan_ranks_last(seed, population):
    """A NaN changes nothing as long as the better half of the samples is finite."""
    searches = [start("full", rng=np.random.default_rng(seed), population=population) for _ in range(2)]
    values = sphere(searches[0].ask())
    searches[1].ask()
    bad = np.argsort(values)[-(population // 2) :]
    spoilt = values.copy()
    spoilt[bad] = np.nan
    for search, told in zip(searches, (values, spoilt), strict=True):
        search.tell(told)
    assert np.array_equal(searches[0].mean, searches[1].mean)


def test_step_sizes_change_by_a_bounded_factor():
    """One generation never changes log sigma by more than 1, whatever it is told."""
    search, rng = start("full"), np.random.default_rng(4)
    for _ in range(200):
        before = search.sigma
        search.ask()
        search.tell(rng.standard_cauchy(search.parameters.population))
        assert abs(np.log(search.sigma / before)) <= 1.0


# --- Bad input ---


@pytest.mark.parametrize("mean", [[], [np.nan, 1.0], [np.inf], 3.0, [[1.0, 2.0]], "point", [None]])
def test_bad_means_are_told(mean):
    with pytest.raises(OptionError, match="vector of finite numbers"):
        CMAES(mean, 1.0, np.random.default_rng(0))


@pytest.mark.parametrize("sigma", [0, -1.0, np.nan, np.inf, "wide", None])
def test_bad_step_sizes_are_told(sigma):
    with pytest.raises(OptionError, match="sigma0"):
        CMAES(np.ones(3), sigma, np.random.default_rng(0))


@pytest.mark.parametrize("population", [0, 1, -3, 2.5, True])
def test_bad_populations_are_told(population):
    with pytest.raises(OptionError, match="population"):
        Parameters.default(5, population)
