"""Centres of known shapes, fitted to points on their surfaces. It is used under ROS's own Python as well.

A shape is translated until its surface passes through the points: iteratively reweighted least squares on the signed
distance. Its scale shrinks from that of the search to that of the noise (graduated non-convexity), so that points of
other things lose their weight. The cost of a centre is the sum of squared distances in standard deviations, each
`CUT` squared at most.

A camera sees one side. What that side leaves open, such as where along its face a box lies whose edges are covered,
must not be guessed. So a centre is returned only if the cost is larger by `EVIDENCE` at the distance `within` from it
in each of many directions: the points then exclude centres there. Points on a face exclude those beyond its edges, so
a face that is seen as a whole is enough.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:  # ROS's Python has no comove
    from numpy.typing import ArrayLike, NDArray

    Array = NDArray[np.float64]

CUT = 3.0  # standard deviations, from which on a distance counts no more
EVIDENCE = 16.0  # of the cost, as of four standard deviations of one point
WITHIN = 2.0  # standard deviations, within which a returned centre is
LEAST = 30  # points on a surface
FEW, SOME, MOST = 200, 600, 3000  # points with which a fit begins, ends, and looks for edges
SWALLOWED = 0.25  # of the points on the surface, that may lie deeper inside
N_SCALES = 6  # from that of the search to that of the noise
NARROW = 8.0  # standard deviations: the largest scale, where the start is good
N_STEPS = 2  # of least squares at each scale
N_MOVES = 12  # to better centres nearby, at most
FIXED = 4.0  # times the evidence, from which on the normals fix a direction
N_ALONG = 4  # steps to `WITHIN`, on lines on which the ends of what points leave open are looked for
TINY = 1e-12
CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3.0)


class Solid(NamedTuple):
    """A convex body about its centre.

    Attributes
    ----------
    kind : "sphere", "box", "capsule", "cylinder" or "polytope"
    size : half edges of a box; radius of a sphere; radius and half length along z of a capsule or cylinder; the
        radius by which a polytope is rounded [m]
    axes : array, shape (3, 3), its axes in the world, in columns
    planes : array, shape (n_planes, 4), outward normals and offsets of a polytope [m]
    """

    kind: str
    size: Sequence[float]
    axes: Array
    planes: Array

    @classmethod
    def of(cls, told: Mapping[str, Any]) -> Solid:
        """Return the solid of a JSON object."""
        axes, planes = np.array(told["axes"], dtype=float), np.array(told.get("planes", []), dtype=float)
        return cls(told["kind"], told["size"], axes.reshape(3, 3), planes.reshape(-1, 4))

    def distances(self, points: Array) -> Array:
        """Return signed distances (n,) [m] of points (n, 3) about the centre."""
        return DISTANCES[self.kind](self, points @ self.axes)

    def gradients(self, points: Array) -> Array:
        """Return the gradients (n, 3) of the distances."""
        return GRADIENTS[self.kind](self, points @ self.axes) @ self.axes.T


def _from_capsule_axis(solid: Solid, points: Array) -> Array:
    found = points.copy()
    found[:, 2] -= np.clip(points[:, 2], -solid.size[1], solid.size[1])
    return found


def _excess(solid: Solid, points: Array) -> Array:
    """Return how far coordinates lie beyond those of a solid.

    They are those of a box, (n, 3), or radius and height of a cylinder, (n, 2).
    """
    if solid.kind == "box":
        return np.abs(points) - np.asarray(solid.size)
    radial = np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2)
    return np.stack([radial - solid.size[0], np.abs(points[:, 2]) - solid.size[1]], axis=1)


def _beyond(excess: Array) -> Array:
    out, most = np.maximum(excess, 0.0), excess[:, 0]
    for column in excess.T[1:]:
        most = np.maximum(most, column)
    return np.sqrt(np.einsum("ij,ij->i", out, out)) + np.minimum(most, 0.0)


def _slope(excess: Array) -> Array:
    """Return the gradient of what `_beyond` returns."""
    out, inside = np.maximum(excess, 0.0), np.zeros_like(excess)
    inside[np.arange(len(excess)), excess.argmax(axis=1)] = 1.0
    return np.where((_lengths(out) > 0.0)[:, None], _unit(out), inside)


def _unit(vectors: Array) -> Array:
    return vectors / np.maximum(_lengths(vectors), TINY)[:, None]


def _lengths(vectors: Array) -> Array:
    return np.sqrt(np.einsum("ij,ij->i", vectors, vectors))


def _from_planes(solid: Solid, points: Array) -> Array:
    return points @ solid.planes[:, :3].T - solid.planes[:, 3]


def _cylinder_gradient(solid: Solid, points: Array) -> Array:
    slope, radial = _slope(_excess(solid, points)), points * (1.0, 1.0, 0.0)
    return np.column_stack([_unit(radial)[:, :2] * slope[:, :1], slope[:, 1] * _signs(points[:, 2])])


def _signs(values: Array) -> Array:
    return np.where(values < 0.0, -1.0, 1.0)


DISTANCES: Mapping[str, Callable[[Solid, Array], Array]] = {
    "sphere": lambda solid, points: _lengths(points) - solid.size[0],
    "box": lambda solid, points: _beyond(_excess(solid, points)),
    "capsule": lambda solid, points: _lengths(_from_capsule_axis(solid, points)) - solid.size[0],
    "cylinder": lambda solid, points: _beyond(_excess(solid, points)),
    "polytope": lambda solid, points: _from_planes(solid, points).max(axis=1) - solid.size[0],
}
GRADIENTS: Mapping[str, Callable[[Solid, Array], Array]] = {
    "sphere": lambda solid, points: _unit(points),
    "box": lambda solid, points: _slope(_excess(solid, points)) * _signs(points),
    "capsule": lambda solid, points: _unit(_from_capsule_axis(solid, points)),
    "cylinder": _cylinder_gradient,
    "polytope": lambda solid, points: solid.planes[_from_planes(solid, points).argmax(axis=1), :3],
}


@dataclass(frozen=True)
class Shape:
    """The union of solids about one centre; a ball of radius `reach` [m] contains them."""

    solids: tuple[Solid, ...]
    reach: float

    @classmethod
    def of(cls, told: Mapping[str, Any]) -> Shape:
        """Return the shape of a JSON object."""
        return cls(tuple(Solid.of(solid) for solid in told["solids"]), told["reach"])

    def turned(self, rotation: Array) -> Shape:
        """Return the shape turned in the world; array, shape (3, 3)."""
        return Shape(tuple(solid._replace(axes=rotation @ solid.axes) for solid in self.solids), self.reach)

    def distances(self, points: Array) -> Array:
        """Return signed distances (n,) [m] of points (n, 3) about the centre."""
        found = self.solids[0].distances(points)
        for solid in self.solids[1:]:
            found = np.minimum(found, solid.distances(points))
        return found

    def gradients(self, points: Array) -> Array:
        """Return the gradients (n, 3) of the distances."""
        if len(self.solids) == 1:
            return self.solids[0].gradients(points)
        nearest = np.argmin([solid.distances(points) for solid in self.solids], axis=0)
        return np.array([solid.gradients(points) for solid in self.solids])[nearest, np.arange(len(points))]


class Unseen(Exception):
    """Reason why points do not tell where an obstacle is, in words."""


class Fit(NamedTuple):
    """A shape, points (n_points, 3) [m], and their standard deviation [m]."""

    shape: Shape
    points: Array
    noise: float

    def thinned(self, most: int) -> Fit:
        """Return the fit to `most` points at most."""
        return self._replace(points=self.points[:: max(1, -(-len(self.points) // most))])

    def distances(self, center: Array) -> Array:
        """Return the points' distances from the surface in standard deviations, (n_points,)."""
        return self.shape.distances(self.points - center) / self.noise

    def costs(self, centers: Array) -> Array:
        """Return the costs of centres (n, 3)."""
        away = self.shape.distances((self.points - centers[:, None]).reshape(-1, 3)) / self.noise
        return np.minimum(away**2, CUT**2).reshape(len(centers), -1).sum(axis=1)

    def descended(self, centers: Array, scales: ArrayLike) -> Array:
        """Return centres (n, 3) after steps of least squares at some scales.

        The weights are those of Geman and McClure.

        Parameters
        ----------
        scales : array, shape (n_scales,) or (n_scales, n), in standard deviations
        """
        for scale in np.asarray(scales, dtype=float).reshape(len(np.asarray(scales)), -1) * self.noise:
            for _ in range(N_STEPS):
                points = (self.points - centers[:, None]).reshape(-1, 3)
                away = self.shape.distances(points).reshape(len(centers), -1, 1)
                slopes = self.shape.gradients(points).reshape(len(centers), -1, 3)
                weighted = (slopes / (1.0 + (away / scale[:, None, None]) ** 2) ** 2).transpose(0, 2, 1)
                bend = weighted @ slopes
                damping = 1e-3 * np.trace(bend, axis1=1, axis2=2) + TINY
                step = np.linalg.solve(bend + damping[:, None, None] * np.eye(3), weighted @ away)[..., 0]
                centers = (
                    centers + step * np.minimum(1.0, 2.0 * scale / np.maximum(_lengths(step), TINY))[:, None]
                )
        return centers

    def evidence(self, center: Array) -> float:
        """Return the additional cost that excludes a centre.

        Stray points lie on faces by chance: as many as in a layer outside that is as thick, a third of them on those
        faces that a displacement moves away from their points.
        """
        away = self.distances(center)
        stray = float(((away > 2.0 * CUT) & (away < 4.0 * CUT)).sum()) / 3.0
        return EVIDENCE + CUT**2 * (stray + 3.0 * np.sqrt(stray))

    def directions(self, center: Array) -> tuple[Array, Array]:
        """Return directions, (3, 3) in rows, and their strengths, (3,).

        A strength is the number of points whose normals would fix the centre as well along its direction.
        """
        on = self.points[np.abs(self.distances(center)) < CUT]
        _require_points(len(on))
        normals = self.shape.gradients(on - center)
        strength, basis = np.linalg.eigh(normals.T @ normals)
        return basis.T, strength


def fitted_center(shape: Shape, points: Array, start: Array, noise: float, gate: float) -> Array:
    """Return the centre of a shape whose surface passes through points.

    Parameters
    ----------
    shape : shape, turned as it is
    points : array, shape (n_points, 3), those of other things among them [m]
    start : array, shape (3,), about where it is [m]
    noise : standard deviation of a coordinate of points on the surface [m]
    gate : largest distance of the centre from `start` [m]

    Raises
    ------
    Unseen
        If too few points lie on the surface or too many inside, or the points leave open where it is.
    """
    _require_points(len(points))
    whole = Fit(shape, points, noise).thinned(MOST)
    fit, few = whole.thinned(SOME), whole.thinned(FEW)
    scales = np.geomspace(gate / noise, 1.0, N_SCALES)
    begins = np.array([start, 0.5 * (start + np.median(few.points, axis=0)), start])
    tries = few.descended(begins, np.column_stack([scales, scales, np.minimum(scales, NARROW)]))
    center = fit.descended(tries[[few.costs(tries).argmin()]], [1.0])[0]
    for _ in range(N_MOVES):
        before = center
        center, is_open = _amid_edges(fit, whole, center)
        if _length(center - before) > WITHIN * fit.noise:  # edges were out of sight
            continue
        other = _better_near(fit, center, is_open)
        if other is None:
            other = _better_far(fit, few, center, start, gate)
        if other is None:
            break
        center = other
    else:
        raise Unseen("its points fit many places")
    away = fit.distances(center)
    n_on, n_inside = int((np.abs(away) < CUT).sum()), int((away < -CUT).sum())
    if n_inside > SWALLOWED * n_on:
        raise Unseen(f"{n_inside} points lie inside it and {n_on} on its surface")
    if not _length(center - start) <= gate:
        raise Unseen(f"its points are more than {gate:.2g} m from where it was last")
    return center


def _amid_edges(fit: Fit, whole: Fit, center: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the centre amid edges, and the directions that they fix.

    These are directions along which few normals fix it.

    Raises
    ------
    Unseen
        If the edges leave open where it is.
    """
    directions, strength = fit.directions(center)
    is_open = strength * WITHIN**2 < FIXED * fit.evidence(center)
    step = WITHIN * fit.noise / N_ALONG
    along = step * np.arange(-2 * N_ALONG, 2 * N_ALONG + 1)
    for direction in directions[is_open]:
        costs = whole.costs(center + along[:, None] * direction)
        possible = np.flatnonzero(costs < costs.min() + whole.evidence(center))
        low, high = along[possible[[0, -1]]]
        if high - low + step > 2.0 * WITHIN * fit.noise:
            raise _left_open(direction)
        center = center + 0.5 * (low + high) * direction
    return center, is_open


def _better_near(fit: Fit, center: Array, is_open: NDArray[np.bool_]) -> Array | None:
    """Return a better centre nearby, None without one.

    Directions along which edges fix it are left out.

    Raises
    ------
    Unseen
        If one is as good.
    """
    directions, _ = fit.directions(center)
    around = np.concatenate([directions[~is_open], -directions[~is_open], CORNERS @ directions])
    places = center + WITHIN * fit.noise * around
    cost, *costs = fit.costs(np.vstack([center, places]))
    best = int(np.argmin(costs))
    if costs[best] < cost:
        return fit.descended(places[[best]], [1.0])[0]
    if costs[best] < cost + fit.evidence(center):
        raise _left_open(around[best])
    return None


def _better_far(fit: Fit, few: Fit, center: Array, start: Array, gate: float) -> Array | None:
    """Return a better centre elsewhere within the gate, None without one.

    Raises
    ------
    Unseen
        If one is as good.
    """
    near = 2.0 * WITHIN * fit.noise
    steps, found = np.arange(near, 2.0 * gate, 0.5 * near), []
    for direction in np.concatenate([fit.directions(center)[0] * sign for sign in (-1.0, 1.0)]):
        line = center + steps[:, None] * direction
        line = line[((line - start) ** 2).sum(axis=1) <= gate**2]
        if len(line):
            found.append(line[few.costs(line).argmin()])
    if found:
        places = few.descended(np.array(found), [2.0, 1.0])
        found = [p for p in places if _length(p - center) > near and _length(p - start) <= gate]
    if not found:
        return None
    cost, *costs = fit.costs(np.vstack([center, *found]))
    best, evidence = int(np.argmin(costs)), fit.evidence(center)
    if costs[best] < cost - evidence:
        return found[best]
    if costs[best] < cost + evidence:
        raise Unseen(f"its points fit two places, {1e3 * _length(found[best] - center):.0f} mm apart")
    return None


def _left_open(direction: Array) -> Unseen:
    x, y, z = direction
    return Unseen(f"its points leave open where it is along [{x:.1f}, {y:.1f}, {z:.1f}]")


def _length(vector: Array) -> float:
    return float(np.sqrt(vector @ vector))


def _require_points(n_points: int) -> None:
    if n_points < LEAST:
        raise Unseen(f"{n_points} points show it ({LEAST} needed)")
