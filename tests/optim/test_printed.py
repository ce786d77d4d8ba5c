"""Algorithm 1 as printed, against its lines written out once more, by loops."""

import numpy as np
import pytest

from comove.optim import PrintedCCMAES


def root(matrix):
    """The inverse of the symmetric root."""
    values, vectors = np.linalg.eigh(matrix)
    return vectors @ np.diag(values**-0.5) @ vectors.T


def test_a_generation_is_lines_4_to_11():
    run = PrintedCCMAES(np.array([1.0, -2.0, 0.5]), 0.3, np.random.default_rng(0), 8)
    p, n = run.parameters, 3
    alpha = p.weights[: p.mu]
    p_sigma, p_c = np.zeros(n), np.zeros(n)
    for _ in range(5):
        w, mu, sigma, cov = run.sample().copy(), run.mean.copy(), run.sigma, run.covariance.copy()
        values = (w**2).sum(axis=1)
        run.adapt(values)
        best = w[np.argsort(values)[: p.mu]]
        mean = mu + sum(a * (x - mu) for a, x in zip(alpha, best, strict=True))
        rho = 1 / np.sqrt(sum(a * a for a in alpha))
        p_sigma = (1 - p.c_sigma) * p_sigma
        p_sigma = p_sigma + rho / sigma * np.sqrt(1 - (1 - p.c_sigma) ** 2) * root(cov) @ (mean - mu)
        p_c = (1 - p.c_c) * p_c + rho / sigma * np.sqrt(1 - (1 - p.c_c) ** 2) * (mean - mu)
        new = (1 - p.c_mu - p.c_1) * cov + p.c_1 / rho**2 * np.outer(p_c, p_c)
        for a, x in zip(alpha, best, strict=True):
            new = new + p.c_mu / sigma**2 * a * np.outer(x - mu, x - mu)
        assert run.mean == pytest.approx(mean)
        assert run.covariance == pytest.approx(new)
        change = p.c_sigma / p.d_sigma * (np.linalg.norm(p_sigma) / p.expected_length - 1)
        assert run.sigma == pytest.approx(sigma * np.exp(change))


def test_records_and_covariance_are_equations_5_and_6():
    rng = np.random.default_rng(1)
    run = PrintedCCMAES(np.zeros(4), 0.5, rng)
    records, cov = np.zeros((3, 4)), np.eye(4)
    for _ in range(4):
        points, violated = rng.standard_normal((5, 4)), rng.random((5, 3)) < 0.5
        run.constrain(points, violated)
        for w, a in zip(points, violated, strict=True):
            for j in np.flatnonzero(a):
                records[j] = (1 - run.fading) * records[j] + run.fading / run.sigma * (w - run.mean)
            for j in np.flatnonzero(a):
                v = records[j]
                cov = cov - run.size / a.sum() * np.outer(v, v) / (v @ v)
        assert run.covariance == pytest.approx(cov)


def test_a_sphere_is_minimised():
    run = PrintedCCMAES(np.full(6, 2.0), 1.0, np.random.default_rng(0))
    for _ in range(300):
        run.adapt((run.sample() ** 2).sum(axis=1))
    assert (run.mean**2).sum() < 1e-10


def test_those_drawn_again_are_others():
    run = PrintedCCMAES(np.zeros(3), 1.0, np.random.default_rng(0))
    before = run.sample().copy()
    which = np.arange(len(before)) % 2 == 0
    assert run.sample(which) == pytest.approx(run.samples[which])
    assert (run.samples[~which] == before[~which]).all()
    assert (run.samples[which] != before[which]).all()


def test_what_is_always_violated_ends_with_no_distribution():
    """Each violation takes away as much, however little is left."""
    run = PrintedCCMAES(np.zeros(3), 1.0, np.random.default_rng(0))
    with pytest.raises(np.linalg.LinAlgError):
        for _ in range(1000):
            points = run.sample()
            run.constrain(points, np.ones((len(points), 1), dtype=bool))
