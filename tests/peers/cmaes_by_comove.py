"""The classes of `cmaes` made of comove's search, as a plugin of pytest that runs the peer's own tests on them.

    COMOVE_PEER_TESTS=FOLDER pytest tests/peers       # FOLDER/cmaes holds a checkout of the peer

Points that comove did not ask for are told as injected ones. Faults are `AssertionError`, as the peer has them.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from comove.errors import ComoveWarning, OptionError
from comove.optimisers import Minimiser, NoRestarts, Plain


@contextmanager
def asserting() -> Iterator[None]:
    """Raise what the peer raises."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", ComoveWarning)
            yield
    except (OptionError, ComoveWarning) as error:
        raise AssertionError(str(error)) from error


class CMA:
    """The peer's door to CMA-ES."""

    separable = False

    def __init__(self, mean, sigma, bounds=None, n_max_resampling=100, seed=None, population_size=None, cov=None,
                 lr_adapt=False):  # fmt: skip
        self.dim, self.generation, self._mean = len(mean), 0, np.array(mean, dtype=float)
        self.population_size = population_size or 4 + int(3 * np.log(self.dim))
        self._funhist_term = 10 + int(np.ceil(30 * self.dim / self.population_size))
        with asserting():
            self._search = Minimiser(
                mean,
                sigma,
                bounds=pair(bounds, self.dim),
                method=Plain(separable=self.separable),
                restarts=NoRestarts(),
                population=self.population_size,
                covariance=cov,
                seed=0 if seed is None else seed,
            )
        self._waiting: list[np.ndarray] = []

    def set_bounds(self, bounds):
        """Change the bounds, which must hold the mean."""
        with asserting():
            ends = pair(bounds, self.dim)
            if ends is not None and ((self._mean < ends[0]) | (self._mean > ends[1])).any():
                raise OptionError("the mean lies outside the bounds")
            self._search.change_bounds(ends)

    def ask(self):
        """Return one point."""
        if not self._waiting:
            self._waiting = list(self._search.ask().x)
        return self._waiting.pop()

    def tell(self, solutions):
        """Learn from a generation of points and values."""
        with asserting():
            if len(solutions) != self.population_size:
                raise OptionError("tell a whole generation")
            points = np.array([x for x, _ in solutions])
            if not self._waiting and not self._search._asked:
                self._search.inject(points)
            asked = self._search.ask().x
            values = np.array([value for _, value in solutions], dtype=float)
            order = [int(np.argmin(np.abs(points - x).sum(axis=1))) for x in asked]
            self._search.tell(values[order])
        self._mean, *_ = self._search._run.distribution
        self.generation += 1
        self._waiting = []

    def should_stop(self):
        """Return whether the search has ended."""
        return self._search.reason is not None


class SepCMA(CMA):
    """The same with variances along the axes only."""

    separable = True


def pair(bounds, n):
    """Return the peer's bounds, shape (n, 2), as comove's."""
    if bounds is None:
        return None
    array = np.asarray(bounds, dtype=float)
    if array.shape != (n, 2):
        raise OptionError(f"bounds of shape {array.shape}")
    return array[:, 0], array[:, 1]


def pytest_configure(config):
    """Put comove's classes in the peer's place."""
    import cmaes

    cmaes.CMA, cmaes.SepCMA = CMA, SepCMA
