"""Gauss-Newton steps from an infeasible point to a feasible one near it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comove.arrays import Array
from comove.optim.method import AskAndTell, Request, Start
from comove.optim.models import UNKNOWN, bound_rows, nearest_feasible


@dataclass(frozen=True)
class RestorationSettings:
    """Settings of `Restoration`.

    Attributes
    ----------
    difference : difference for slopes, in step sizes of the search
    shares : shares of a step that are tried
    steps : largest number of steps
    longest : longest step, in step sizes of the search
    """

    difference: float = 1e-4
    shares: tuple[float, ...] = (1.0, 0.3, 0.1, 0.03)
    steps: int = 15
    longest: float = 10.0


SETTINGS = RestorationSettings()


class Restoration(AskAndTell):
    """A search for a feasible point by Gauss-Newton steps.

    Each is the shortest d with h(x) + J d <= 0. It is asked and told like a run.

    Slopes are finite differences.

    Attributes
    ----------
    x : the least violated point so far; array, shape (n,)
    done : whether it is feasible or no improvement is found
    """

    def __init__(self, start: Start, settings: RestorationSettings = SETTINGS) -> None:
        self.settings = settings
        self._start, self.x, self.done = start, start.x, False
        self._steps = 0
        self._values = np.zeros(0)
        self._wait(Request(start.x[None], constraints=True), self._here_told)

    def _end(self) -> None:
        self._wait(Request(self.x[None], objective=True, known=self._values[None]), self._objective_told)

    def _objective_told(self, objective: Array, _: Array | None) -> None:
        self.done = True

    def _here_told(self, _: Array | None, constraints: Array) -> None:
        self._values = constraints[0]
        missed = self._start.violation(self._values)
        self._steps += 1
        if not missed.any() or not np.isfinite(missed).all() or self._steps > self.settings.steps:
            self._end()
            return
        width = self.settings.difference * self._start.sigma
        self._widths = np.where(self.x + width <= self._start.upper, width, -width)
        self._wait(Request(self.x + np.diag(self._widths), constraints=True), self._slopes_told)

    def _slopes_told(self, _: Array | None, constraints: Array) -> None:
        start = self._start
        slope = (constraints - self._values).T / self._widths * start.sigma
        length = np.sqrt((slope**2).sum(axis=1))
        known = np.isfinite(length) & (length > UNKNOWN)
        if not known.any():
            self._end()
            return
        rows, missed = slope[known] / length[known, None], self._values[known] / length[known]
        free = start.equality[known]
        if start.bounded:
            root = start.sigma * np.eye(len(self.x))
            walls, distances = bound_rows(root, self.x, start.lower, start.upper)
            rows, missed = np.vstack([rows, walls]), np.concatenate([missed, distances])
            free = np.concatenate([free, np.zeros(len(distances), dtype=bool)])
        self._lengths = np.where(known, length, 1.0)
        inside = np.where(free, 0.0, 1e-6)
        step = -rows.T @ nearest_feasible(rows, missed + inside, free)
        step *= start.sigma * min(1.0, self.settings.longest / (float(np.linalg.norm(step)) + 1e-300))
        points = start.inside(self.x + np.array(self.settings.shares)[:, None] * step)
        self._wait(Request(points, constraints=True), self._steps_told)

    def _steps_told(self, _: Array | None, constraints: Array) -> None:
        missed = np.vstack([self._values, constraints])
        missed = (self._start.violation(missed) / self._lengths) ** 2
        best = int(np.argmin(missed.sum(axis=1)))
        if best == 0:
            self._end()
            return
        self.x = self.ask().x[best - 1]
        self._here_told(None, constraints[best - 1 : best])
