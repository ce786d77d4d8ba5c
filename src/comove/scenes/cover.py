"""Convex polytopes that together hold a solid, and reach little beyond it.

What is convex is its own hull. Anything else is cut into small pieces (`comove.scenes.cells`). Two pieces see each
other if every straight line between them stays within the resolution of the solid; pieces that all see each other
have a hull that hardly leaves it (approximate convex decomposition by visibility, Liu et al., 2010). Such groups are
grown from many pieces, the one that holds most of what is not yet held is kept, and so on until every piece is in a
hull. As hulls are convex, a piece whose extreme points are held is held as a whole, and so is the solid.

How far the hulls reach beyond the solid is bounded by halving boxes: distances have Lipschitz constant 1, so the
distance in the middle of a box and its half diagonal bound it in the box.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, cKDTree

from comove.scenes.cells import Solid, are_inside, pieces, solid_of
from comove.scenes.polytopes import Polytope, coarser, hull_of

Array = NDArray[np.float64]

SHARE = 0.03  # of the longest side, the resolution where none is given
N_CELLS = 8  # along the longest side, of what is not convex
N_NODES, MOST_NODES = 64, 500_000  # of the grid of known distances: along the longest side, and in all
BEND, SMALLEST = 0.3, 0.5  # of the resolution: how far from convex pieces may be, and how small they are cut
CONVEX = 1e-9  # of its size, by which a solid may miss being convex
FOR_GROUPS = 0.75  # of the resolution; the rest is for coarser hulls
STRICTNESS = (1.0, 0.6, 0.3, 0.1)  # of this, tried in turn until a group's hull is near enough to the solid
N_SEEDS, N_ORDERS, N_TRIED = 24, 3, 6
MOST_SAMPLES = 16  # along a line
N_SEEN = 8  # points of a piece that see
PLANE_AREA = 2e-3  # of the surface, from which on what lies in one plane is worth a cut
FINEST = 0.5  # of the resolution, below which overhangs are not told apart


@dataclass(frozen=True)
class Cover:
    """Polytopes that hold a solid.

    Attributes
    ----------
    polytopes : their union holds it
    overhang : upper bound of how far a point of theirs is from the solid [m]
    """

    polytopes: tuple[Polytope, ...]
    overhang: float


def cover_of(vertices: Array, faces: NDArray[np.int64], resolution: float | None = None) -> Cover | None:
    """A cover of the solid that closed triangles bound; None where nothing of it has a volume.

    Parameters
    ----------
    vertices, faces : arrays, shapes (n_vertices, 3) [m] and (n_faces, 3), turned outwards
    resolution : about how far the cover may reach beyond the solid [m]; 3 % of its longest side unless given
    """
    resolution = SHARE * float(np.ptp(vertices, axis=0).max()) if resolution is None else resolution
    found, overhang = [], 0.0
    for part in parts_of(vertices, faces):
        own, beyond = _part_cover(vertices[part], resolution)
        found += own
        overhang = max(overhang, beyond)
    return Cover(tuple(found), overhang) if found else None


def parts_of(vertices: Array, faces: NDArray[np.int64], *, together: bool = True) -> list[NDArray[np.int64]]:
    """The faces by connected part; list of arrays, shape (n_faces, 3).

    Parameters
    ----------
    together : all are one part where one of them is a cavity, which is turned inwards
    """
    n, (a, b, c) = len(vertices), faces.T
    ends = np.concatenate([a, b]), np.concatenate([b, c])
    _, label = connected_components(coo_array((np.ones(len(ends[0])), ends), shape=(n, n)), directed=False)
    labels = label[a]
    parts = [faces[labels == k] for k in np.unique(labels)]
    if together and any(volume_of(vertices[part]) < 0 for part in parts):
        return [faces]
    return parts


def volume_of(corners: Array) -> float:
    """What triangles enclose, array of shape (n_triangles, 3, 3); negative where they are turned inwards [m^3]."""
    middle = corners.mean(axis=(0, 1))
    a, b, c = np.moveaxis(corners - middle, 1, 0)
    return float((a * np.cross(b, c)).sum()) / 6


def _part_cover(corners: Array, resolution: float) -> tuple[list[Polytope], float]:
    hull = hull_of(np.unique(corners.reshape(-1, 3), axis=0))
    if hull is None:
        return [], 0.0
    if _is_convex(corners, hull):
        own, beyond = coarser(hull, resolution)
        return [own], beyond
    return _Groups(corners, resolution).cover()


def _is_convex(corners: Array, hull: Polytope) -> bool:
    """Whether every triangle's plane has all vertices of the hull behind it."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    flat = area > 1e-12 * hull.size**2
    normals = normals[flat] / area[flat, None]
    for some in np.array_split(np.arange(len(normals)), max(1, len(normals) * len(hull.vertices) // 2**22)):
        beyond = (normals[some] @ hull.vertices.T).max(axis=1) - (normals[some] * corners[flat][some, 0]).sum(
            axis=1
        )
        if beyond.max(initial=0.0) > CONVEX * hull.size:
            return False
    return True


class _Groups:
    """Groups of pieces of one part, in a frame of its own."""

    def __init__(self, corners: Array, resolution: float):
        self.frame = frame_of(corners)
        self.corners = np.ascontiguousarray(corners @ self.frame.T)
        self.low, self.high = self.corners.min(axis=(0, 1)), self.corners.max(axis=(0, 1))
        self.size = float((self.high - self.low).max())
        self.resolution, self.near = resolution, FOR_GROUPS * resolution
        self.solid = solid_of(self.corners)
        planes = [self._planes(axis) for axis in range(3)]
        first = np.cumsum([0, *map(len, planes)])
        out = CONVEX * self.size
        self.points, self.first = pieces(
            self.solid,
            np.concatenate(planes),
            first,
            self.low - out,
            self.high + out,
            BEND * resolution,
            SMALLEST * resolution,
        )
        self.distance = Distance(self.corners, self.solid, resolution)
        self.n = len(self.first) - 1

    def _planes(self, axis: int) -> Array:
        """Where the part is cut across an axis: at large flat sides, and evenly in between."""
        normals = np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])
        area = np.linalg.norm(normals, axis=1)
        across = np.abs(normals[:, axis]) > (1 - 1e-9) * np.maximum(area, 1e-300)
        at = np.round(self.corners[across, 0, axis] / (1e-6 * self.size)).astype(np.int64)
        places, which = np.unique(at, return_inverse=True)
        share = np.bincount(which, area[across], minlength=len(places)) / area.sum()
        places = 1e-6 * self.size * places[share > PLANE_AREA]
        inner = (places > self.low[axis] + 1e-5 * self.size) & (places < self.high[axis] - 1e-5 * self.size)
        # To the last digit: a cut beside a side leaves slivers.
        exact = self.corners[across, 0, axis]
        places = np.array([exact[np.abs(exact - p).argmin()] for p in places[inner]])
        ends = np.concatenate([[self.low[axis]], places, [self.high[axis]]])
        even = [
            np.linspace(a, b, int(np.ceil((b - a) / (self.size / N_CELLS) - 1e-9)) + 1)[1:-1]
            for a, b in zip(ends[:-1], ends[1:], strict=True)
        ]
        return np.sort(np.concatenate([places, *even]))

    def cover(self) -> tuple[list[Polytope], float]:
        """Hulls that hold all pieces, in the given frame, and their overhang [m]."""
        apart = self._apart()
        rng = np.random.default_rng(0)
        middle = np.add.reduceat(self.points, self.first[:-1]) / np.diff(self.first)[:, None]
        left, chosen = np.ones(self.n, dtype=bool), []
        while left.any():
            hull, held = self._best(apart, middle, left, rng)
            chosen.append((hull, held))
            left &= ~held
        for k in reversed(range(len(chosen))):  # what the others hold as well is not needed
            others = [held for i, (_, held) in enumerate(chosen) if i != k]
            if others and np.any(others, axis=0).all():
                del chosen[k]
        found, overhang = [], 0.0
        for hull, held in chosen:
            around, _ = coarser(hull, self.resolution - self.near)
            beyond = 0.0
            if around is not hull or not self._is_filled(hull, held):
                beyond = self.distance.farthest(around, FINEST * self.resolution)
            overhang = max(overhang, beyond)
            planes = np.column_stack([around.planes[:, :3] @ self.frame, around.planes[:, 3]])
            found.append(Polytope(around.vertices @ self.frame, planes))
        return found, overhang

    def _apart(self) -> Array:
        """How far lines between two pieces leave the solid at most, as far as points of theirs tell; (n, n) [m]."""
        seen, first = [], [0]
        for a, b in zip(self.first[:-1], self.first[1:], strict=True):
            own = self.points[a:b]
            if len(own) > N_SEEN:
                along = own @ np.array([[1.0, 1, 1], [1, 1, -1], [1, -1, 1], [1, -1, -1]]).T
                own = own[np.unique(np.concatenate([along.argmax(axis=0), along.argmin(axis=0)]))]
            seen.append(own)
            first.append(first[-1] + len(own))
        d = self.distance
        middle = np.add.reduceat(self.points, self.first[:-1]) / np.diff(self.first)[:, None]
        return _lines(np.concatenate(seen), np.array(first), middle, d.field, d.origin, d.step, self.near)

    def _best(
        self, apart: Array, middle: Array, left: NDArray[np.bool_], rng: np.random.Generator
    ) -> tuple[Polytope, NDArray[np.bool_]]:
        """The hull that holds most of the pieces that are left, and which pieces it holds."""
        open_ = np.flatnonzero(left)
        seeds = rng.choice(open_, size=min(N_SEEDS, len(open_)), replace=False)
        for strict in STRICTNESS:
            see = apart <= strict * self.near
            groups = {}
            for seed in seeds:
                away = np.linalg.norm(middle - middle[seed], axis=1)
                for order in (
                    np.argsort(away, kind="stable"),
                    np.argsort(away + self.size * ~left, kind="stable"),
                    np.argsort(-see.sum(axis=1), kind="stable"),
                )[:N_ORDERS]:
                    group = _group(see, seed, order)
                    groups[group.tobytes()] = group
            ranked = sorted(groups.values(), key=lambda group: -(group & left).sum())
            best = None
            for group in ranked[:N_TRIED]:
                hull = hull_of(self.points[np.repeat(group, np.diff(self.first))])
                if hull is None or not self.distance.is_near(hull, self.near):
                    continue
                held = self._held(hull)
                if best is None or (held & left).sum() > (best[1] & left).sum():
                    best = hull, held
            if best is not None:
                return best
        piece = int(seeds[0])  # what is not convex by less than a piece's bend
        hull = hull_of(self._points_of(piece))
        return hull, self._held(hull) | (np.arange(self.n) == piece)

    def _points_of(self, piece: int) -> Array:
        return self.points[self.first[piece] : self.first[piece + 1]]

    def _held(self, hull: Polytope) -> NDArray[np.bool_]:
        """Which pieces are in a hull."""
        return np.logical_and.reduceat(_behind(self.points, hull.planes, CONVEX * self.size), self.first[:-1])

    def _is_filled(self, hull: Polytope, held: NDArray[np.bool_]) -> bool:
        """Whether the pieces in a hull are all of it."""
        if not self.distance.is_near(hull, 0.0):
            return False
        volume = ConvexHull(hull.vertices).volume
        pieces = (hull_of(self._points_of(k)) for k in np.flatnonzero(held))
        return volume - sum(ConvexHull(p.vertices).volume for p in pieces if p) <= CONVEX * volume


def frame_of(corners: Array) -> Array:
    """Axes as rows, along the largest flat side and the largest one across it; array, shape (3, 3)."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    kept = area > 1e-12 * area.max()
    normals, area = normals[kept] / area[kept, None], area[kept]
    z = _main_direction(normals, area)
    across = np.abs(normals @ z) < 1e-3
    if across.any():
        x = _main_direction(normals[across], area[across])
    else:
        points = corners.reshape(-1, 3) - corners.mean(axis=(0, 1))
        x = np.linalg.svd(points - np.outer(points @ z, z), full_matrices=False)[2][0]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _main_direction(normals: Array, area: Array) -> Array:
    """The normal, up to its sign, that most area has."""
    some = np.argsort(-area, kind="stable")[:200]
    total = (np.abs(normals[some] @ normals.T) > 1 - 1e-6) @ area
    return normals[some[total.argmax()]]


class Distance:
    """Distances from a solid, 0 inside, never below the true ones.

    Parameters
    ----------
    corners : array, shape (n_triangles, 3, 3), the triangles that bound it [m]
    resolution : how far outside, and about how finely, distances are known on the grid [m]
    """

    def __init__(self, corners: Array, solid: Solid, resolution: float):
        self.corners, self.solid = corners, solid
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        wide = high - low + 2 * resolution
        step = min(float((high - low).max()) / N_NODES, 0.5 * resolution)
        self.step = max(step, float(np.cbrt(wide.prod() / MOST_NODES)))
        samples, self._owner = _samples(corners, self.step)
        self._tree = cKDTree(samples)
        count = np.ceil(wide / self.step).astype(int) + 3
        self.origin = 0.5 * (low + high) - 0.5 * self.step * (count - 1)
        axes = [self.origin[k] + self.step * np.arange(count[k]) for k in range(3)]
        nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        inside = are_inside(solid, nodes)
        field = np.zeros(len(nodes))
        if inside.any():  # about: what is far away is only known to be
            field = self.step * distance_transform_edt(~inside.reshape(count)).ravel()
        near = ~inside & (field < resolution + 2 * self.step)
        field[near] = self._outside(nodes[near])
        self.field = field.reshape(count)
        self._nodes, self._field = nodes, field

    def __call__(self, points: Array) -> Array:
        """Of points, array of shape (n, 3); array, shape (n,) [m]."""
        result = np.zeros(len(points))
        outside = ~are_inside(self.solid, np.ascontiguousarray(points))
        result[outside] = self._outside(points[outside])
        return result

    def _outside(self, points: Array) -> Array:
        away, nearest = self._tree.query(points)
        return np.minimum(away, _from_triangles(points, self.corners[self._owner[nearest]]))

    def is_near(self, hull: Polytope, most: float) -> bool:
        """Whether no node of the grid in a hull is farther than `most` [m] from the solid."""
        far = self._nodes[self._field > most]
        low, high = hull.vertices.min(axis=0), hull.vertices.max(axis=0)
        far = far[((far > low) & (far < high)).all(axis=1)]
        return not bool(_behind(far, hull.planes, -1e-6 * self.step).any())

    def farthest(self, hull: Polytope, enough: float) -> float:
        """Upper bound of how far a point of a hull is from the solid [m], `enough` where it is less than that."""
        low, high = hull.vertices.min(axis=0), hull.vertices.max(axis=0)
        nodes = self._nodes[self._field > enough]
        inside = _behind(nodes, hull.planes, 0.0)
        most = max(enough, float(self(hull.vertices).max()), float(self(nodes[inside]).max(initial=0.0)))
        half, middles = 0.5 * float((high - low).max()), 0.5 * (low + high)[None]
        corners = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), axis=-1).reshape(-1, 3)
        while len(middles):
            reach = np.sqrt(3.0) * half
            middles = middles[_behind(middles, hull.planes, reach)]
            away = self(middles)
            if reach <= 0.25 * most:
                return max(most, float((away + reach).max(initial=0.0)))
            inside = _behind(middles, hull.planes, 0.0)
            most = max(most, float(away[inside].max(initial=0.0)))
            half *= 0.5
            # What is deep inside the solid needs no second look, nor what cannot be farther than what was met.
            deep = away == 0.0
            deep[deep] = self._tree.query(middles[deep])[0] > reach + self.step
            middles = middles[~deep & (away + reach > most)]
            middles = (middles[:, None] + half * corners).reshape(-1, 3)
        return most


def _samples(corners: Array, spacing: float) -> tuple[Array, NDArray[np.int64]]:
    """Points on triangles, no point of which is farther than `spacing` [m] from one, and whose they are."""
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    count = np.maximum(1, np.ceil(longest / spacing).astype(int))
    points, owner = [], []
    for n in np.unique(count):
        own = np.flatnonzero(count == n)
        i, j = (index.ravel() for index in np.meshgrid(np.arange(n + 1), np.arange(n + 1)))
        u, v = i[i + j <= n] / n, j[i + j <= n] / n
        shares = np.stack([1 - u - v, u, v], axis=1)
        points.append(np.einsum("sk,tkd->tsd", shares, corners[own]).reshape(-1, 3))
        owner.append(np.repeat(own, len(u)))
    return np.concatenate(points), np.concatenate(owner)


def _from_triangles(points: Array, corners: Array) -> Array:
    """Distance [m] of each point (n, 3) from the triangle (n, 3, 3) of its own."""
    a, b, c = np.moveaxis(corners, 1, 0)
    ab, ac, ap = b - a, c - a, points - a
    aa, bb, mixed = (ab * ab).sum(axis=1), (ac * ac).sum(axis=1), (ab * ac).sum(axis=1)
    p, q = (ab * ap).sum(axis=1), (ac * ap).sum(axis=1)
    area = np.maximum(aa * bb - mixed**2, 1e-300)
    u, v = (bb * p - mixed * q) / area, (aa * q - mixed * p) / area
    foot = np.linalg.norm(ap - u[:, None] * ab - v[:, None] * ac, axis=1)
    best = np.where((u >= 0) & (v >= 0) & (u + v <= 1), foot, np.inf)
    for s, e in ((a, b), (b, c), (c, a)):
        along = e - s
        share = ((points - s) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-300)
        share = np.clip(share, 0.0, 1.0)[:, None]
        best = np.minimum(best, np.linalg.norm(points - s - share * along, axis=1))
    return best


@numba.njit(cache=True, error_model="numpy")
def _behind(points, planes, out):
    """Which points (n, 3) are beyond none of the planes (m, 4) by more than `out` [m]."""
    inside = np.ones(points.shape[0], dtype=np.bool_)
    for i in range(points.shape[0]):
        for k in range(planes.shape[0]):
            along = planes[k, 0] * points[i, 0] + planes[k, 1] * points[i, 1] + planes[k, 2] * points[i, 2]
            if along > planes[k, 3] + out:
                inside[i] = False
                break
    return inside


@numba.njit(cache=True, error_model="numpy")
def _lines(points, first, middle, field, origin, step, most):
    """How far lines between pieces leave the solid, (n, n) [m]; infinite where it is more than `most`."""
    n = first.shape[0] - 1
    apart = np.zeros((n, n))
    for p in range(n):
        for q in range(p):
            worst = _line(middle[p], middle[q], field, origin, step, most)
            for i in range(first[p], first[p + 1]):
                if worst > most:
                    break
                for j in range(first[q], first[q + 1]):
                    worst = max(worst, _line(points[i], points[j], field, origin, step, most))
                    if worst > most:
                        break
            apart[p, q] = apart[q, p] = worst if worst <= most else np.inf
    return apart


@numba.njit(cache=True, error_model="numpy")
def _line(a, b, field, origin, step, most):
    """How far the line between two points leaves the solid [m]; somewhere, where it is more than `most`."""
    dx, dy, dz = (b[0] - a[0]) / step, (b[1] - a[1]) / step, (b[2] - a[2]) / step
    x, y, z = (a[0] - origin[0]) / step, (a[1] - origin[1]) / step, (a[2] - origin[2]) / step
    n = min(MOST_SAMPLES, 2 + int(np.sqrt(dx * dx + dy * dy + dz * dz)))
    worst = 0.0
    for k in range(1, n):
        f = k / n
        worst = max(worst, _interpolated(field, x + f * dx, y + f * dy, z + f * dz))
        if worst > most:
            break
    return worst


@numba.njit(cache=True, error_model="numpy")
def _interpolated(field, x, y, z):
    i, j, k = int(x), int(y), int(z)
    f, g, h = x - i, y - j, z - k
    near = (1 - f) * (1 - g) * field[i, j, k] + f * (1 - g) * field[i + 1, j, k]
    near += (1 - f) * g * field[i, j + 1, k] + f * g * field[i + 1, j + 1, k]
    far = (1 - f) * (1 - g) * field[i, j, k + 1] + f * (1 - g) * field[i + 1, j, k + 1]
    far += (1 - f) * g * field[i, j + 1, k + 1] + f * g * field[i + 1, j + 1, k + 1]
    return (1 - h) * near + h * far


@numba.njit(cache=True, error_model="numpy")
def _group(see, seed, order):
    """Pieces that all see each other, from a seed, taken up in an order; array of bool, shape (n,)."""
    n = see.shape[0]
    group, may = np.zeros(n, dtype=np.bool_), see[seed].copy()
    group[seed] = True
    for piece in order:
        if may[piece] and not group[piece]:
            group[piece] = True
            for other in range(n):
                may[other] &= see[piece, other]
    return group
