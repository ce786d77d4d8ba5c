"""Continuous-time certificate of a robot's clearance.

Two bodies whose distance at an instant is d are, at all times at most w before or after it, at least

    d - w sum_j max|q_j'| r_j

apart, where r_j is the largest distance of the moved body from the axis of joint j (1 for a joint that slides), and
only the joints between the two count; the load adds its own largest speed. Where this bound is too small, a
second-order bound is used for convex bodies (see `nearing`), and where that is too small as well, the time interval
is halved, for those pairs only. Distances are coal's, placements Pinocchio's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from comove.robots.extremes import Ranges, fastest
from comove.robots.verification.bodies import Bodies
from comove.robots.verification.carried import Carried
from comove.robots.verification.load_shapes import placements
from comove.robots.verification.nearing import Nearing
from comove.ties import first_least

Array = NDArray[np.float64]

FIRST = 16  # parts of the motion at the beginning
DEEPEST = 22  # halvings of a part
TIGHT, LOOSE = 1e-3, 5e-3  # m, how far a bound may stay below the clearance; where that is too small anyway
MOST = 400_000  # distances: a bound that needs more is given up as it stands, still sound, only lower


class LinkClearance(NamedTuple):
    """Bounds of the clearance of one kind of pairs, as the certificate gives them.

    Attributes
    ----------
    lower : certified lower bound of the clearance at every instant [m]; infinite where there is no pair
    upper : least clearance computed at any instant [m]
    pair : number of the pair that has `upper`
    time : time at which it has it [s]
    """

    lower: float
    upper: float
    pair: int
    time: float


class _Cells(NamedTuple):
    """Pairs during time intervals of equal length, given by the intervals' numbers; arrays, shape (n_cells,)."""

    stretch: NDArray[np.int64]
    pair: NDArray[np.int64]

    def halved(self, chosen: NDArray[np.bool_]) -> _Cells:
        """Return both halves of the chosen cells."""
        stretch = np.concatenate([2 * self.stretch[chosen], 2 * self.stretch[chosen] + 1])
        order = np.argsort(stretch, kind="stable")
        return _Cells(stretch[order], np.tile(self.pair[chosen], 2)[order])


def certify(bodies: Bodies, carried: Carried, curve: PPoly) -> list[LinkClearance]:
    """Bound the clearance of all pairs over continuous time, by kind: SCENE, LOAD, SELF.

    Where a pair violates its required clearance, the bound of its kind is only as tight as `LOOSE`.

    Parameters
    ----------
    curve : joint positions by time [s], cubic between samples
    """
    distances, nearing = _Distances(bodies, carried, curve), Nearing(bodies, curve)
    cells, width, computed = _first(bodies), curve.x[-1] / FIRST, 0
    lower, met = np.full(3, np.inf), [LinkClearance(np.inf, np.inf, -1, 0.0)] * 3
    for depth in range(DEEPEST):
        distance, change = distances(cells, width)
        kind = bodies.kind[cells.pair]
        is_exact = bodies.exact[cells.pair] == cells.pair
        for k in range(3):
            met[k] = _nearer(met[k], np.where(is_exact & (kind == k), distance, np.inf), cells, width)
        upper = np.array([least.upper for least in met])
        enough = np.maximum(bodies.required, upper - TIGHT)
        enough = np.where(upper < bodies.required, upper - LOOSE, enough)[kind]
        spare = np.where(distance > 0, distance - enough, 0.0)
        bound = distance - nearing.improved(
            change, spare, cells.pair, (cells.stretch + 0.5) * width, width / 2
        )
        done = bound >= enough
        computed += len(distance)
        if depth == DEEPEST - 1 or computed > MOST:
            done[:] = True
        np.minimum.at(lower, kind[done], bound[done])
        if done.all():
            break
        pair = np.where(distance < enough, bodies.exact[cells.pair], cells.pair)
        cells, width = _Cells(cells.stretch, pair).halved(~done), width / 2
    return [least._replace(lower=float(bound)) for least, bound in zip(met, lower, strict=True)]


def _first(bodies: Bodies) -> _Cells:
    """Return the cells of all pairs in the first intervals, rough pairs where there are such; one cell for pairs that
    never move.
    """
    rough = bodies.exact != np.arange(len(bodies.exact))
    begun = np.ones(len(rough), dtype=bool)
    begun[bodies.exact[rough]] = False
    moves = bodies.reach.any(axis=1)
    still, moving = np.flatnonzero(begun & ~moves), np.flatnonzero(begun & moves)
    stretch = np.concatenate([np.zeros(len(still), dtype=np.int64), np.repeat(np.arange(FIRST), len(moving))])
    return _Cells(stretch, np.concatenate([still, np.tile(moving, FIRST)]))


def _nearer(best: LinkClearance, distance: Array, cells: _Cells, width: float) -> LinkClearance:
    """Return the least clearance so far."""
    k = first_least(distance) if len(distance) else -1
    if k < 0 or distance.min() >= best.upper:
        return best
    return LinkClearance(
        -np.inf, float(distance.min()), int(cells.pair[k]), float((cells.stretch[k] + 0.5) * width)
    )


class _Distances:
    """Computes distances of pairs at the middle of time intervals, and how much they can change within these."""

    def __init__(self, bodies: Bodies, carried: Carried, curve: PPoly):
        self.bodies, self.carried, self.curve = bodies, carried, curve
        self.model, self.data = bodies.robot.model, bodies.robot.model.createData()
        self.placed = bodies.geometry.createData()
        self.rates = Ranges(curve.x, fastest(curve)[0])

    def __call__(self, cells: _Cells, width: float) -> tuple[Array, Array]:
        """Compute distances, less what is taken from them, and bounds of their changes; arrays, shape (n_cells,) [m].

        Parameters
        ----------
        width : length of the intervals [s]
        """
        stretches, first, counts = np.unique(cells.stretch, return_index=True, return_counts=True)
        time = (stretches + 0.5) * width
        configurations, nodes = self.curve(time), self.carried.nodes(time)
        rods = [(rod, *placements(nodes, spanned)) for rod, *spanned in self.bodies.rods]
        compute, geometry, placed = pin.computeDistance, self.bodies.geometry, self.placed
        distances: list[float] = []
        for k, q in enumerate(configurations):
            pin.updateGeometryPlacements(self.model, self.data, geometry, placed, q)
            for rod, turn, middle in rods:
                placed.oMg[rod] = pin.SE3(turn[k], middle[k])
            pairs = cells.pair[first[k] : first[k] + counts[k]].tolist()
            distances += [compute(geometry, placed, pair).min_distance for pair in pairs]
        rates = self._rates(time - 0.5 * width, time + 0.5 * width)
        change = (self.bodies.reach[cells.pair] * np.repeat(rates, counts, axis=0)).sum(axis=1)
        return np.array(distances) - self.bodies.taken[cells.pair], 0.5 * width * change

    def _rates(self, begin: Array, end: Array) -> Array:
        """Return the largest rates of the joints and the load; array, shape (n_stretches, n_joints + 1)."""
        load = self.carried.speed.over(begin, end).max(axis=1, keepdims=True)
        return np.concatenate([self.rates.over(begin, end), load], axis=1)
