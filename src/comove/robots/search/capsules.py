"""Capsules around a robot's bodies: the model of its links in a search.

A capsule is the set of all points within a radius of a segment, its axis. Each body that moves is inside one capsule,
or inside the union of a few where these have clearly less volume, but for corners and rims that stick out a few
millimetres: a capsule around all of a short cylinder would be much wider than the cylinder. Meshes that do not move,
such as a table, may be hollow and large; their surface is inside balls, a cell of a grid each.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import coal
import numpy as np
from scipy.spatial import ConvexHull

from comove.arrays import Array, Integers
from comove.compiled import copy_to, kernel

PROUD, PROUDEST = 0.04, 0.003  # by which bodies may stick out: share of the radius, and m, at most
FINE, MOST_PARTS = 0.01, 100  # m, between points of a surface, and parts of an edge at most
CLEARLY = 0.99  # share of another number below which one is less: rounding must not decide what is symmetric


@dataclass(frozen=True)
class CapsuleSettings:
    """Settings of the cutting of bodies and the search for capsules.

    Attributes
    ----------
    depth : cuts one after another; two of them give up to four capsules
    cuts : shares of a body's extent at which it may be cut
    n_points : approximate number of points that decide a cut
    worthwhile : volume of the parts' capsules, in units of that of one, below which a body is cut
    wider : radii that are tried, in units of the least: a wider capsule may be shorter
    cell : edge of the cells into which meshes that do not move are cut [m]
    """

    depth: int = 2
    cuts: tuple[float, ...] = (0.2, 0.35, 0.5, 0.65, 0.8)
    n_points: int = 300
    worthwhile: float = 0.9
    wider: tuple[float, ...] = (1.0, 1.02, 1.05, 1.1, 1.16, 1.25)
    cell: float = 0.2


SETTINGS = CapsuleSettings()


class LinkCapsule(NamedTuple):
    """A capsule. Its axis has two ends, arrays of shape (3,), and it has a radius [m]."""

    start: Array
    end: Array
    radius: float

    @property
    def volume(self) -> float:
        """Return the volume [m^3]."""
        return np.pi * self.radius**2 * (self.length + 4.0 / 3.0 * self.radius)

    @property
    def length(self) -> float:
        """Return the length of the axis [m]."""
        return float(np.linalg.norm(self.end - self.start))

    @property
    def mean_width(self) -> float:
        """Return the mean distance of parallel supporting planes [m]."""
        return 2.0 * self.radius + 0.5 * self.length


def capsules_of(shape: Any, moves: bool, how: CapsuleSettings = SETTINGS) -> list[LinkCapsule]:
    """Return capsules around a coal shape, in its own frame. For static meshes, they hold the surface alone."""
    kind, z = type(shape).__name__, np.array([0.0, 0.0, 1.0])
    if kind == "Sphere":
        return [LinkCapsule(0 * z, 0 * z, shape.radius)]
    if kind == "Capsule":
        return [LinkCapsule(-shape.halfLength * z, shape.halfLength * z, shape.radius)]
    if kind == "Box":
        return holding(*_on_box(np.array(shape.halfSide)), how)
    if kind == "Cylinder":
        return [around(_around_cylinder(shape.radius, shape.halfLength), how)]
    points, spacing = on_triangles(*_surface(shape))
    return holding(points, spacing, how) if moves else _balls(points, spacing, how.cell)


def convex_parts(
    vertices: Array, triangles: Integers, moves: bool, how: CapsuleSettings = SETTINGS
) -> list[Array]:
    """Return point sets (n, 3) [m] whose hulls together hold a surface.

    A mesh that moves is cut as for its capsules, which then hold the hulls but for what may stick out. One that does
    not move may be hollow and large, and is cut into cells.

    Parameters
    ----------
    vertices, triangles : arrays, shape (n_vertices, 3) [m] and (n_triangles, 3)
    """
    points, spacing = on_triangles(vertices, triangles)
    if moves:
        return [part for part, _ in _parted(points, spacing, how, how.depth)]
    low, parts = points.min(axis=0), []
    for cell in np.unique(np.floor((points - low) / how.cell), axis=0):
        corner = low + how.cell * cell
        near = (points >= corner - spacing) & (points <= corner + how.cell + spacing)
        parts.append(points[near.all(axis=1)])
    return parts


def vertices_of(shape: Any) -> Array:
    """Return the vertices of a mesh or a convex body of coal; array, shape (n_vertices, 3) [m]."""
    if isinstance(shape, coal.ConvexBase):
        return np.array([shape.point(i) for i in range(shape.num_points)])
    return np.array(shape.vertices())


def _surface(shape: Any) -> tuple[Array, Integers]:
    """Return vertices [m] and triangles of a mesh or convex body; arrays, shape (n, 3)."""
    vertices = vertices_of(shape)
    if isinstance(shape, coal.ConvexBase):
        return vertices, ConvexHull(vertices).simplices
    triangles = [shape.tri_indices(i) for i in range(shape.num_tris)]
    return vertices, np.array([(t[0], t[1], t[2]) for t in triangles])


def holding(points: Array, spacing: float, how: CapsuleSettings = SETTINGS) -> list[LinkCapsule]:
    """Compute capsules whose union holds a body.

    Parameters
    ----------
    points : array, shape (n_points, 3), corners of small triangles of which the body's surface consists [m]
    spacing : diameter of these triangles, at most [m]
    """
    return [capsule for _, capsule in _parted(points, spacing, how, how.depth)]


def _parted(
    points: Array, spacing: float, how: CapsuleSettings, depth: int
) -> list[tuple[Array, LinkCapsule]]:
    """Cut a body where its parts' capsules have clearly less volume; return points and capsules."""
    one = around(points, how)
    if depth == 0 or (cut := _best_cut(points[:: 1 + len(points) // how.n_points], how)) is None:
        return [(points, one)]
    direction, at = cut
    along = points @ direction
    # What lies across the cut is in a part with all its corners, as parts overlap by its length.
    parts = points[along <= at + spacing], points[along >= at - spacing]
    smaller = [cut for part in parts for cut in _parted(part, spacing, how, depth - 1)]
    if _volume([capsule for _, capsule in smaller]) > how.worthwhile * one.volume:
        return [(points, one)]
    return smaller


def around(points: Array, how: CapsuleSettings = SETTINGS) -> LinkCapsule:
    """Compute a small capsule around points, along one of their axes. Some points may stick out."""
    return _smallest([_along(points, axis, how) for axis in _axes(points)])


def _along(points: Array, direction: Array, how: CapsuleSettings) -> LinkCapsule:
    """Compute a small capsule around points in a direction, shape (3,). Some points may stick out."""
    across = np.linalg.svd(direction[None])[2][1:]
    middle, low, high, radius = _held(points, across, direction, np.array(how.wider))
    base = middle @ across
    return LinkCapsule(base + low * direction, base + high * direction, radius)


@kernel
def _held(points: Array, across: Array, direction: Array, wider: Array) -> tuple[Array, float, float, float]:
    """Compute the capsule of clearly least mean width, see `_along`. Return its middle, ends' heights and radius.

    Parameters
    ----------
    across : array, shape (2, 3), unit vectors that span the plane across the axis
    wider : array, radii that are tried, see `CapsuleSettings`
    """
    n = points.shape[0]
    flat, height, low, high = np.empty((n, 2)), np.empty(n), np.full(2, np.inf), np.full(2, -np.inf)
    for i in range(n):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        height[i] = x * direction[0] + y * direction[1] + z * direction[2]
        for k in range(2):
            flat[i, k] = x * across[k, 0] + y * across[k, 1] + z * across[k, 2]
            low[k], high[k] = min(low[k], flat[i, k]), max(high[k], flat[i, k])
    for k in range(2):
        low[k] = 0.5 * (low[k] + high[k])
    middle, least = _circle(flat, low)
    proud, best, found = min(PROUD * least, PROUDEST), np.inf, (0.0, 0.0, 0.0)
    for factor in wider:
        radius, first, last = factor * (least - proud) + 1e-9, np.inf, -np.inf  # of rounding
        for i in range(flat.shape[0]):
            square = (flat[i, 0] - middle[0]) ** 2 + (flat[i, 1] - middle[1]) ** 2
            half = np.sqrt((radius + proud) ** 2 - square)  # of the stretch in which the axis has to be
            first, last = min(first, height[i] + half), max(last, height[i] - half)
        if first > last:
            first = last = 0.5 * (first + last)
        width = 2.0 * radius + 0.5 * (last - first)
        if width < CLEARLY * best:
            best, found = width, (first, last, radius)
    return middle, *found


@kernel
def _circle(points: Array, centre: Array, n_steps: int = 30) -> tuple[Array, float]:
    """Compute a small circle around points (n_points, 2). See Badoiu and Clarkson (2003).

    `centre`, of the first circle, is overwritten.
    """
    middle, least = np.empty(2), np.inf
    for k in range(n_steps):
        furthest, square = 0, -1.0
        for i in range(points.shape[0]):
            away = (points[i, 0] - centre[0]) ** 2 + (points[i, 1] - centre[1]) ** 2
            if away > square:
                furthest, square = i, away
        if square < CLEARLY * least:
            least = square
            copy_to(centre, middle)
        for axis in range(2):
            centre[axis] += (points[furthest, axis] - centre[axis]) / (k + 2)
    return middle, np.sqrt(least)


def _best_cut(points: Array, how: CapsuleSettings) -> tuple[Array, float] | None:
    """Return direction and height of the cut that minimises two capsules' volume."""
    least, best = np.inf, None
    for axis in _axes(points):
        along = points @ axis
        for share in how.cuts:
            at = float(along.min() + share * np.ptp(along))
            parts = points[along <= at], points[along >= at]
            if min(map(len, parts)) < 3:
                continue
            room = _volume([_along(part, _axes(part)[-1], how) for part in parts])
            if room < CLEARLY * least:
                least, best = room, (axis, at)
    return best


def _smallest(capsules: list[LinkCapsule]) -> LinkCapsule:
    """Return the first capsule without a later, clearly narrower one."""
    best = capsules[0]
    for capsule in capsules[1:]:
        if capsule.mean_width < CLEARLY * best.mean_width:
            best = capsule
    return best


def _volume(capsules: list[LinkCapsule]) -> float:
    return sum(capsule.volume for capsule in capsules)


def _axes(points: Array) -> list[Array]:
    """Return candidate axis directions: the frame's, and the points' longest if unique."""
    away = points - points.mean(axis=0)
    values, vectors = np.linalg.eigh(away.T @ away)
    return [*np.eye(3), *([vectors[:, 2]] if values[1] < CLEARLY * values[2] else [])]


def _on_box(half: Array) -> tuple[Array, float]:
    """Return points on a box's faces, and the squares' diameter [m]."""
    steps = [np.linspace(-h, h, 1 + int(np.clip(np.ceil(2 * h / FINE), 1, MOST_PARTS))) for h in half]
    grid = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1)
    on_face = (np.abs(grid) == half).any(axis=-1)
    return grid[on_face], np.sqrt(2) * max(float(step[1] - step[0]) for step in steps)


def _around_cylinder(radius: float, half: float, n: int = 48) -> Array:
    """Return the corners of a prism of n sides around a cylinder; array, shape (2 n, 3) [m]."""
    angle = 2 * np.pi * np.arange(n) / n
    ring = radius / np.cos(np.pi / n) * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.concatenate([np.column_stack([ring, np.full(n, z)]) for z in (-half, half)])


def on_triangles(points: Array, triangles: Integers) -> tuple[Array, float]:
    """Return points on triangles, corners included, and their triangles' diameter [m]."""
    corners = points[triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    parts = np.clip(np.ceil(longest / FINE), 1, MOST_PARTS).astype(int)
    dense = [(_shares(n) @ corners[parts == n]).reshape(-1, 3) for n in np.unique(parts) if n > 1]
    return np.concatenate([points, *dense]), float((longest / parts).max())


def _shares(count: int) -> Array:
    """Return barycentric points on a triangle, `count` parts an edge; array, shape (n_points, 3)."""
    return np.array([(i, j, count - i - j) for i in range(count + 1) for j in range(count + 1 - i)]) / count


def _balls(points: Array, spacing: float, cell: float) -> list[LinkCapsule]:
    """Return balls that cover a mesh's surface, one per grid cell."""
    place = np.floor((points - points.min(axis=0)) / cell).astype(int)
    number = np.ravel_multi_index(tuple(place.T), tuple(place.max(axis=0) + 1))
    order = np.argsort(number, kind="stable")
    groups = np.split(points[order], np.flatnonzero(np.diff(number[order])) + 1)
    spread = spacing / np.sqrt(3)  # no point of a triangle is further from all its corners
    balls = []
    for group in groups:
        middle = 0.5 * (group.min(axis=0) + group.max(axis=0))
        reach = float(np.linalg.norm(group - middle, axis=1).max())
        balls.append(LinkCapsule(middle, middle, reach + spread))
    return balls
