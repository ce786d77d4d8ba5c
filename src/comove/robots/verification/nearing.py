"""Second-order bound of how much nearer convex bodies can come, along the line between their nearest points.

Let n be the unit vector along that line at an instant. Two convex bodies are separated by a slab perpendicular to n,
whose width follows from their support functions, and their distance is at least the distance of their points along n.
At a time w before or after, a point p of a body is where its velocity takes it, to within w^2/2 max|p''|; so the
distance then is at least

    slab - w max |n (v_a - v_b)| - w^2/2 max|p''|,

where the first maximum is over all points a and b of the bodies, here of balls about them. Joints that move both
bodies count for neither. With r_j as in `certificate` the second derivative is at most

    sum r_j |q_j''| + 2 sum |q_j'| sum r_j |q_j'|,

as the second derivative of a position by two joints is no longer than the reach r_j of the one nearer to the body. So
a hand that glides over a table comes no nearer to first order, however fast it is.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from comove.robots.extremes import Ranges, fastest
from comove.robots.verification.bodies import Bodies

Array = NDArray[np.float64]


class Nearing:
    """Computes bounds of how much nearer the bodies of pairs come.

    Attributes
    ----------
    applies : array, shape (n_pairs,), whether the bound applies to a pair: convex bodies on a robot or in the scene
    """

    def __init__(self, bodies: Bodies, curve: PPoly):
        self.bodies, self.curve, model = bodies, curve, bodies.robot.model
        self.model, self.data, self.placed = model, model.createData(), bodies.geometry.createData()
        items, pairs = bodies.geometry.geometryObjects, bodies.geometry.collisionPairs
        moved = np.zeros((len(items), model.nv), dtype=bool)
        for body, item in enumerate(items):
            moved[body, [model.idx_vs[j] for j in model.supports[item.parentJoint] if j > 0]] = True
        self._pairs = np.array([(p.first, p.second) for p in pairs]).reshape(-1, 2)
        first, second = moved[self._pairs].swapaxes(0, 1)
        self._sides = np.stack([first & ~second, second & ~first])
        self._centers = [np.array(item.geometry.aabb_center) for item in items]
        self._radii = np.array([item.geometry.aabb_radius for item in items])
        loads = {rod for rod, *_ in bodies.rods}
        self._supports = [support_function(item.geometry) for item in items]
        plain = np.array([bool(known) and k not in loads for k, known in enumerate(self._supports)])
        self.applies = plain[self._pairs].all(axis=1)
        bend = np.abs(curve(curve.x, 2))
        self._rates = Ranges(curve.x, np.hstack([fastest(curve)[0], np.maximum(bend[1:], bend[:-1])]))

    def improved(
        self, change: Array, spare: Array, pair: NDArray[np.int64], time: Array, half: float
    ) -> Array:
        """Return smaller bounds of how much a distance changes, where these may help; arrays, shape (n,) [m].

        Parameters
        ----------
        change : known bounds of the change
        spare : change of the distances that is allowed; not positive where bodies touch or no bound can help
        time : middle of the time intervals, in ascending order [s]
        half : half of the intervals' length [s]
        """
        todo = np.flatnonzero((spare > 0) & (change > spare) & self.applies[pair])
        bulge = 0.5 * half**2 * self.second_order(pair[todo], time[todo] - half, time[todo] + half)
        todo, bulge = todo[bulge < spare[todo]], bulge[bulge < spare[todo]]
        better = change.copy()
        if len(todo):
            lost, speed = self.first_order(pair[todo], time[todo])
            better[todo] = np.fmin(change[todo], lost + half * speed + bulge)
        return better

    def second_order(self, pair: NDArray[np.int64], begin: Array, end: Array) -> Array:
        """Bound |p''| during time intervals; all arrays of shape (n,), [s] -> [m/s^2]."""
        rates, bends = np.split(self._rates.over(begin, end), 2, axis=1)
        reach = self.bodies.reach[pair, :-1]
        between = self._sides[:, pair].any(axis=0)
        return (bends * reach).sum(axis=1) + 2 * (rates * between).sum(axis=1) * (rates * reach).sum(axis=1)

    def first_order(self, pair: NDArray[np.int64], time: Array) -> tuple[Array, Array]:
        """Compute distance minus slab width, and how fast points of both bodies come nearer along n.

        Parameters
        ----------
        time : array, shape (n,), in ascending order [s]

        Returns
        -------
        arrays, shape (n,), [m] and [m/s]
        """
        instants, of_instant = np.unique(time, return_inverse=True)
        columns, lost = np.empty((len(instants), 6, self.model.nv)), np.empty(len(pair))
        normals, centers, placed_for = np.empty((len(pair), 3)), np.empty((len(pair), 2, 3)), -1
        positions, rates = self.curve(instants), self.curve(instants, 1)
        for i, (number, k) in enumerate(zip(pair.tolist(), of_instant.tolist(), strict=True)):
            if k != placed_for:
                pin.computeJointJacobians(self.model, self.data, positions[k])
                pin.updateGeometryPlacements(self.model, self.data, self.bodies.geometry, self.placed)
                columns[k], placed_for = self.data.J * rates[k], k
            lost[i], normals[i] = self._slab(number)
            centers[i] = [
                self.placed.oMg[body].act(self._centers[body]) for body in self._pairs[number].tolist()
            ]
        speed, turning = 0.0, 0.0
        for side, sign in enumerate((1.0, -1.0)):
            twist = np.einsum("nij,nj->ni", columns[of_instant], self._sides[side, pair])
            velocity = twist[:, :3] + np.cross(twist[:, 3:], centers[:, side])
            speed = speed + sign * (normals * velocity).sum(axis=1)
            across = np.linalg.norm(np.cross(normals, twist[:, 3:]), axis=1)
            turning = turning + across * self._radii[self._pairs[pair, side]]
        return lost, np.abs(speed) + turning

    def _slab(self, pair: int) -> tuple[float, Array]:
        """Compute the distance of two bodies minus the width of the slab between them [m], and the slab's normal."""
        found = pin.computeDistance(self.bodies.geometry, self.placed, pair)
        n = np.array(found.normal) / np.linalg.norm(found.normal)  # from the first to the second
        (a, first), (b, second) = ((body, self.placed.oMg[body]) for body in self._pairs[pair].tolist())
        ends = self._supports[a](first.rotation.T @ n), self._supports[b](-second.rotation.T @ n)
        slab = (second.translation - first.translation) @ n - ends[0] - ends[1]
        return found.min_distance - slab, n


def support_function(shape: Any) -> Callable[[Array], float] | None:
    """Return the function that tells how far a convex shape reaches along a unit vector in its own frame [m]; None
    for other shapes.
    """
    if isinstance(shape, coal.Sphere):
        return lambda n: shape.radius
    if isinstance(shape, coal.Box):
        return lambda n: float(np.abs(n) @ shape.halfSide)
    if isinstance(shape, coal.Capsule):
        return lambda n: shape.radius + shape.halfLength * abs(n[2])
    if isinstance(shape, coal.Cylinder):
        return lambda n: shape.radius * float(np.hypot(n[0], n[1])) + shape.halfLength * abs(n[2])
    if isinstance(shape, coal.Ellipsoid):
        return lambda n: float(np.linalg.norm(n * shape.radii))
    if isinstance(shape, coal.ConvexBase):
        points = np.array([shape.point(k) for k in range(shape.num_points)])
        return lambda n: float((points @ n).max())
    return None
