"""Separable CMA-ES: it minimises, is blind to shifts and scales, and repeats itself to the bit."""

import numpy as np
import pytest

from comove.errors import OptionError
from comove.optimisers.separable import SeparableCMAES


def sphere(x):
    return (x**2).sum(axis=1)


def ellipsoid(x):
    return (10 ** (4 * np.arange(x.shape[1]) / (x.shape[1] - 1)) * x**2).sum(axis=1)


def run(f, n_generations, mean=None, sigma=0.5, seed=0, n=20, **options):
    """The optimiser after some generations on `f`, and the means on its way."""
    mean = np.ones(n) if mean is None else mean
    optimiser = SeparableCMAES(mean, sigma, np.random.default_rng(seed), **options)
    means = []
    for _ in range(n_generations):
        optimiser.tell(f(optimiser.ask()))
        means.append(optimiser.mean.copy())
    return optimiser, np.array(means)


@pytest.mark.parametrize(("f", "n_generations"), [(sphere, 400), (ellipsoid, 700)])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_minimises(f, n_generations, seed):
    """In 20 dimensions to 1e-10, badly scaled axes included."""
    optimiser, _ = run(f, n_generations, seed=seed)
    assert f(optimiser.mean[None])[0] < 1e-10
    assert optimiser.generation == n_generations
    assert optimiser.sigma < 1e-3


def test_it_learns_the_scale_of_each_axis():
    """On the ellipsoid the axes end up with spreads in the inverse proportion of its curvatures' roots."""
    optimiser, _ = run(ellipsoid, 500)
    spread = np.std(np.concatenate([optimiser.ask() for _ in range(500)]), axis=0)
    slope = np.polyfit(np.arange(20) * 4 / 19, np.log10(spread), 1)[0]
    assert slope == pytest.approx(-0.5, abs=0.15)


def test_a_shifted_problem_gives_the_shifted_run():
    shift = np.linspace(-3, 3, 20)
    _, plain = run(ellipsoid, 60)
    _, moved = run(lambda x: ellipsoid(x - shift), 60, mean=np.ones(20) + shift)
    assert np.abs(moved - shift - plain).max() < 1e-9


def test_a_scaled_problem_gives_the_scaled_run():
    _, plain = run(sphere, 60)
    _, scaled = run(lambda x: sphere(x / 8), 60, mean=8 * np.ones(20), sigma=4.0)
    assert np.array_equal(scaled, 8 * plain)  # a power of two: not even rounding differs


def test_only_the_order_of_the_values_counts():
    _, plain = run(sphere, 60)
    _, bent = run(lambda x: np.exp(sphere(x)) - 7, 60)
    assert np.array_equal(plain, bent)


def test_the_same_seed_is_the_same_run():
    _, one = run(sphere, 50, seed=5)
    _, other = run(sphere, 50, seed=5)
    _, different = run(sphere, 50, seed=6)
    assert np.array_equal(one, other)
    assert not np.array_equal(one, different)


def test_no_global_random_state():
    np.random.seed(0)  # noqa: NPY002
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    run(sphere, 5)
    assert np.array_equal(before, np.random.get_state()[1])  # noqa: NPY002


def test_nan_ranks_last():
    """Even behind infinity: a sample without a value never moves the mean while others have one."""
    runs = []
    for worst in (np.nan, np.inf, 1e300):

        def f(x, worst=worst):
            values = sphere(x)
            values[np.argsort(values)[-6:]] = worst
            return values

        runs.append(run(f, 40)[1])
    assert np.array_equal(runs[0], runs[2])
    assert np.array_equal(runs[1], runs[2])
    blind, _ = run(lambda x: np.where(x[:, 0] > 0.9, np.nan, sphere(x)), 60)
    assert np.isfinite(blind.mean).all()
    assert blind.mean[0] < 0.9


def test_a_generation_of_nothing_but_nan_is_survived():
    optimiser, _ = run(lambda x: np.full(len(x), np.nan), 5)
    assert np.isfinite(optimiser.mean).all()
    assert np.isfinite(optimiser.ask()).all()


def test_tell_leaves_the_callers_arrays_alone():
    mean = np.ones(6)
    optimiser = SeparableCMAES(mean, 0.5, np.random.default_rng(0), population=8)
    samples = optimiser.ask()
    kept, values = samples.copy(), np.array([3.0, np.nan, 1.0, 2.0, 5.0, 4.0, np.inf, 0.0])
    values.setflags(write=False)
    before = optimiser.mean
    optimiser.tell(values)
    assert np.array_equal(before, np.ones(6))
    assert np.array_equal(samples, kept)
    assert np.array_equal(mean, np.ones(6))
    assert np.isnan(values[1])
    samples[:] = 99.0  # and the other way round: the caller's scribbles do not reach it
    assert np.abs(optimiser.mean).max() < 10


def test_the_step_size_keeps_its_floor():
    free, _ = run(sphere, 400)
    held, _ = run(sphere, 400, sigma_floor=0.01)
    assert free.sigma < 1e-4 < 0.01 <= held.sigma


def test_samples_are_normal_about_the_mean():
    optimiser = SeparableCMAES(np.arange(3.0), 0.2, np.random.default_rng(0), population=20000)
    samples = optimiser.ask()
    assert samples.shape == (20000, 3)
    assert np.allclose(samples.mean(axis=0), np.arange(3.0), atol=0.01)
    assert np.allclose(samples.std(axis=0), 0.2, atol=0.005)


def test_the_step_size_stays_on_a_flat_function():
    """Random selection must neither explode nor collapse it."""
    rng = np.random.default_rng(1)
    optimiser, _ = run(lambda x: rng.random(len(x)), 300)
    assert 0.05 < optimiser.sigma < 5.0


@pytest.mark.parametrize(
    ("mean", "sigma", "population"),
    [
        ([0.0, np.nan], 1.0, 8),
        ([0.0, np.inf], 1.0, 8),
        ([[0.0]], 1.0, 8),
        ([0.0], 0.0, 8),
        ([0.0], -1.0, 8),
        ([0.0], np.nan, 8),
        ([0.0], 1.0, 3),
    ],
)
def test_bad_settings_are_refused(mean, sigma, population):
    with pytest.raises(OptionError):
        SeparableCMAES(mean, sigma, np.random.default_rng(0), population=population)
