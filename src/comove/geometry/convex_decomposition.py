"""Convex polytopes that tightly contain a mesh.

A convex solid is its own hull. Anything else is cut into small pieces (`comove.geometry.cells`). Two pieces see each
other if every straight line between them stays within the resolution of the mesh; pieces that all see each other have
a hull that hardly leaves it (approximate convex decomposition by visibility, Liu et al., 2010). Such groups are grown
from many pieces; the group that contains most of the pieces not yet contained is kept, and so on until every piece is
in a hull. As hulls are convex, a hull that contains the extreme points of a piece contains the whole piece, and so
the hulls contain the mesh. Sheets, which have no inside, are treated as thin walls.

At the end every triangle of any mesh is checked: a part outside all hulls is cut off by their planes and becomes a
thin polytope of its own.

How far the hulls reach beyond the mesh is bounded by halving boxes: distances have Lipschitz constant 1, so the
distance at the middle of a box and the half diagonal of the box bound the distance everywhere in it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.compiled import copy_to, kernel
from comove.geometry.cells import half, pieces
from comove.geometry.polytopes import Polytope, coarser, hull_of, solid_hull_of, thickened
from comove.geometry.surfaces import Parts, Surfaces, point_distances, surface_of

ROUNDING = (
    1e-9  # of its size, by which a solid may miss being convex, and a triangle be outside its polytopes
)
FLAT = 1e-12  # of the square of its size: a triangle of less has no plane
MOST_SAMPLES = 16  # along a line
MOST_CORNERS, MOST_OPEN = 64, 192  # corners of a remaining polygon; pending polygons


@dataclass(frozen=True)
class DecompositionSettings:
    """Settings of the convex decomposition.

    Attributes
    ----------
    share : resolution where none is given, as a share of the mesh's longest side
    sheet : assumed thickness of a sheet, as a share of the mesh's longest side
    n_cells : cells along the longest side into which a part that is not convex is cut in any case
    n_planes, plane_area : cuts across every axis at flat sides, and the least share of the surface in one plane for a
        cut there
    bend, smallest : how far from convex pieces may be, and how small they are cut, as shares of the resolution
    near : share of the resolution by which a group's hull may reach beyond the mesh; the rest is for coarser hulls
    finest : share of the resolution below which over-approximation errors count as equal
    n_nodes, most_nodes : nodes of the grid of known distances, along the longest side and in all
    n_seen : most points of a piece that see others
    strictness : shares of `near` within which pieces must see each other, tried in turn until the hull of a group is
        near enough to the mesh
    n_seeds, n_tried : pieces from which groups are grown, and groups whose hulls are computed
    much_work, little_work : largest numbers of pieces that are combined: with `few`, and without
    most_pieces : number of pieces, not combined, beyond which the resolution is coarser, by the factor `coarser`
    most_hulls : number of hulls of one part beyond which its pieces stay as they are
    most_parts : number of parts that are cut one by one
    """

    share: float = 0.03
    sheet: float = 2e-4
    n_cells: int = 8
    n_planes: int = 12
    plane_area: float = 1e-4
    bend: float = 0.3
    smallest: float = 0.5
    near: float = 0.75
    finest: float = 0.5
    n_nodes: int = 64
    most_nodes: int = 200_000
    n_seen: int = 8
    strictness: tuple[float, ...] = (1.0, 0.6, 0.3, 0.1)
    n_seeds: int = 24
    n_tried: int = 6
    much_work: int = 2000
    little_work: int = 300
    most_pieces: int = 1000
    coarser: float = 1.5
    most_hulls: int = 60
    most_parts: int = 100


SETTINGS = DecompositionSettings()


@dataclass(frozen=True)
class ConvexDecomposition:
    """A union of convex polytopes that contains a mesh.

    Attributes
    ----------
    polytopes : their union contains every triangle and the solids that the triangles close
    excess : upper bound of the over-approximation error: distance of the polytopes' points from the mesh [m]
    """

    polytopes: tuple[Polytope, ...]
    excess: float


def decompose(
    parts: Parts,
    resolution: float | None = None,
    *,
    few: bool = True,
    settings: DecompositionSettings = SETTINGS,
) -> ConvexDecomposition:
    """Find convex polytopes that contain solids and sheets.

    Parameters
    ----------
    resolution : approximately how far the polytopes may reach beyond the mesh [m]; 3 % of its longest side by default
    few : whether small pieces are combined to few polytopes at any cost; else only where this takes little work
    """
    size = float(np.ptp(parts.vertices, axis=0).max())
    thin = settings.sheet * size
    resolution = settings.share * size if resolution is None else resolution
    work = settings.much_work if few else settings.little_work
    found, excess, rest = [], 0.0, []
    for part, thickness in [(p, 0.0) for p in parts.solids] + [(p, thin) for p in parts.sheets]:
        corners = parts.vertices[part]
        if _area(corners).max() <= FLAT * size**2:
            continue  # only lines: `left_out` covers them below
        hull = _hull(corners, resolution, thickness)
        if hull is None:
            groups = _Groups(corners, resolution, thickness, work, settings)
            if groups.n <= (work if few or not thickness else 0):
                work -= groups.n
                hull = groups.decomposed()
        if hull is None:
            rest.append((corners, thickness))
        else:
            found += hull[0]
            excess = max(excess, hull[1])
    own, beyond = _singles(rest, resolution, thin, settings)
    found, excess = found + own, max(excess, beyond)
    triangles = parts.vertices[np.concatenate([*parts.solids, *parts.sheets])]
    for polygon in left_out(triangles, found, ROUNDING * size):
        found.append(_thin(polygon, thin))
        excess = max(excess, thin)
    return ConvexDecomposition(tuple(found), excess)


def _hull(corners: Array, resolution: float, thickness: float) -> tuple[list[Polytope], float] | None:
    """Return the hull of a part and its over-approximation error [m].

    It is None unless the part is convex or no larger than the resolution.
    """
    points = np.unique(corners.reshape(-1, 3), axis=0)
    size = float(np.ptp(points, axis=0).max())
    if size <= resolution:
        return [coarser(_thin(points, max(thickness, ROUNDING * size)), resolution)[0]], size
    hull = None if thickness else hull_of(points)
    if hull is None or not _is_convex(corners, hull):
        return None
    own, beyond = coarser(hull, resolution)
    return [own], beyond


def _singles(
    parts: list[tuple[Array, float]], resolution: float, thickness: float, settings: DecompositionSettings
) -> tuple[list[Polytope], float]:
    """Return the hulls of all pieces and their over-approximation error [m].

    Where the hulls would be too many, the parts are cut again with a coarser resolution.

    Parameters
    ----------
    parts : list of pairs: triangles, array of shape (n, 3, 3) [m], and the thickness of a sheet, 0 for a solid [m]
    thickness : thickness of the sheet that all parts are merged to where they are too many [m]
    """
    if len(parts) > settings.most_parts:  # as one sheet: the inside does not matter, as nothing gets in
        parts = [(np.concatenate([corners for corners, _ in parts]), thickness)]
    while True:
        groups = [_Groups(corners, resolution, own, settings.most_pieces, settings) for corners, own in parts]
        if sum(own.n for own in groups) <= settings.most_pieces:
            break
        resolution, settings = settings.coarser * resolution, replace(settings, n_planes=0)
    found: list[Polytope] = []
    excess = 0.0
    for own in groups:
        hulls, beyond = own.singles()
        found, excess = found + hulls, max(excess, beyond)
    return found, excess


def left_out(triangles: Array, polytopes: list[Polytope], tolerance: float) -> list[Array]:
    """Return the parts of triangles outside all polytopes, polygons (n, 3) [m].

    Parameters
    ----------
    triangles : array, shape (n_triangles, 3, 3) [m]
    tolerance : distance by which a contained point may be outside a polytope [m]
    """
    first = np.cumsum([0, *(len(p.planes) for p in polytopes)])
    planes = np.concatenate([p.planes for p in polytopes]) if polytopes else np.zeros((0, 4))
    corners, counts = _left_out(triangles, planes, first, tolerance)
    return [own[:n] for own, n in zip(corners, counts, strict=True)]


def _area(corners: Array) -> Array:
    """Return twice the areas of triangles (n, 3, 3); array, shape (n,) [m^2]."""
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)


def _thin(points: Array, thickness: float) -> Polytope:
    return solid_hull_of(thickened(points, thickness))


def _is_convex(corners: Array, hull: Polytope) -> bool:
    """Return whether all hull vertices lie behind every triangle's plane."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    flat = area > 1e-12 * hull.size**2
    normals = normals[flat] / area[flat, None]
    for some in np.array_split(np.arange(len(normals)), max(1, len(normals) * len(hull.vertices) // 2**22)):
        beyond = (normals[some] @ hull.vertices.T).max(axis=1) - (normals[some] * corners[flat][some, 0]).sum(
            axis=1
        )
        if beyond.max(initial=0.0) > ROUNDING * hull.size:
            return False
    return True


class _Groups:
    """Groups of a part's pieces that are combined to hulls.

    They are in a frame of the part's own. A sheet's pieces are made `thickness` [m] thick. Where there are more than
    `most` pieces, some are missing.
    """

    def __init__(
        self,
        corners: Array,
        resolution: float,
        thickness: float,
        most: int,
        settings: DecompositionSettings,
    ):
        self.frame = frame_of(corners)
        self.corners = np.ascontiguousarray(corners @ self.frame.T)
        self.low, self.high = self.corners.min(axis=(0, 1)), self.corners.max(axis=(0, 1))
        self.size = float((self.high - self.low).max())
        self.resolution, self.near = resolution, settings.near * resolution
        self.thickness, self.settings = thickness, settings
        self.surface = surface_of(self.corners, 0 if thickness else len(corners))
        planes = [self._planes(axis) for axis in range(3)]
        first = np.cumsum([0, *map(len, planes)])
        out = ROUNDING * self.size
        self.points, self.first = pieces(
            self.surface,
            np.concatenate(planes),
            first,
            self.low - out,
            self.high + out,
            settings.bend * resolution,
            settings.smallest * resolution,
            most,
        )
        self.n = len(self.first) - 1
        if thickness:
            self.points, self.first = thickened(self.points, thickness), 6 * self.first

    def _planes(self, axis: int) -> Array:
        """Return the positions of cuts: at flat sides, and evenly between them."""
        how = self.settings
        normals = np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])
        area = np.linalg.norm(normals, axis=1)
        across = np.abs(normals[:, axis]) > (1 - 1e-9) * np.maximum(area, 1e-300)
        at = np.round(self.corners[across, 0, axis] / (1e-6 * self.size)).astype(np.int64)
        places, which = np.unique(at, return_inverse=True)
        share = np.bincount(which, area[across], minlength=len(places)) / area.sum()
        few = np.sort(share)[-how.n_planes - 1] if len(share) > how.n_planes else 0.0
        large = share > max(how.plane_area, few)
        places = 1e-6 * self.size * places[large]
        inner = (places > self.low[axis] + 1e-5 * self.size) & (places < self.high[axis] - 1e-5 * self.size)
        # To the last digit: a cut beside a side leaves slivers.
        exact = self.corners[across, 0, axis]
        places = np.array([exact[np.abs(exact - p).argmin()] for p in places[inner]])
        ends = np.concatenate([[self.low[axis]], places, [self.high[axis]]])
        cell = max(self.size / how.n_cells, self.resolution)
        even = [
            np.linspace(a, b, int(np.ceil((b - a) / cell - 1e-9)) + 1)[1:-1]
            for a, b in zip(ends[:-1], ends[1:], strict=True)
        ]
        return np.sort(np.concatenate([places, *even]))

    def decomposed(self) -> tuple[list[Polytope], float] | None:
        """Return hulls of all pieces and their over-approximation error [m].

        Hulls are in the given frame. It is None where the hulls are too many.
        """
        self.distance = Distance(self.surface, self.low, self.high, self.resolution, self.settings)
        apart = self._apart()
        rng = np.random.default_rng(0)
        middle = np.add.reduceat(self.points, self.first[:-1]) / np.diff(self.first)[:, None]
        left, chosen = np.ones(self.n, dtype=bool), []
        while left.any():
            hull, held = self._best(apart, middle, left, rng)
            chosen.append((hull, held))
            left &= ~held
            if len(chosen) > self.settings.most_hulls:
                return None
        for k in reversed(range(len(chosen))):  # remove hulls whose pieces others contain
            others = [held for i, (_, held) in enumerate(chosen) if i != k]
            if others and np.any(others, axis=0).all():
                del chosen[k]
        found, excess = [], 0.0
        for hull, held in chosen:
            around, _ = coarser(hull, self.resolution - self.near)
            beyond = 0.0
            if around is not hull or not self._is_filled(hull, held):
                beyond = self.distance.farthest(around, self.settings.finest * self.resolution)
            excess = max(excess, beyond)
            found.append(self._turned(around))
        return found, excess

    def singles(self) -> tuple[list[Polytope], float]:
        """Return every piece's hull and a bound of the over-approximation error [m]."""
        found, excess = [], 0.0
        for k in range(self.n):
            points = self._points_of(k)
            hull = hull_of(points) or _thin(points, ROUNDING * self.size)
            around, _ = coarser(hull, self.resolution - self.near)
            excess = max(excess, float(np.linalg.norm(np.ptp(around.vertices, axis=0))))
            found.append(self._turned(around))
        return found, excess

    def _turned(self, polytope: Polytope) -> Polytope:
        """Return a polytope of the part's frame in the given frame."""
        planes = np.column_stack([polytope.planes[:, :3] @ self.frame, polytope.planes[:, 3]])
        return Polytope(polytope.vertices @ self.frame, planes)

    def _apart(self) -> Array:
        """Return how far lines between pieces leave the solid; shape (n, n) [m].

        Lines connect extreme points of the pieces, and their middles.
        """
        seen, first = [], [0]
        for a, b in zip(self.first[:-1], self.first[1:], strict=True):
            own = self.points[a:b]
            if len(own) > self.settings.n_seen:
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
        """Return the hull that contains most remaining pieces, and which."""
        open_ = np.flatnonzero(left)
        seeds = rng.choice(open_, size=min(self.settings.n_seeds, len(open_)), replace=False)
        for strict in self.settings.strictness:
            see = apart <= strict * self.near
            groups = {}
            for seed in seeds:
                away = np.linalg.norm(middle - middle[seed], axis=1)
                for order in (
                    np.argsort(away, kind="stable"),
                    np.argsort(away + self.size * ~left, kind="stable"),
                    np.argsort(-see.sum(axis=1), kind="stable"),
                ):
                    group = _group(see, seed, order)
                    groups[group.tobytes()] = group
            ranked = sorted(groups.values(), key=lambda group: -(group & left).sum())
            best = None
            for group in ranked[: self.settings.n_tried]:
                hull = hull_of(self.points[np.repeat(group, np.diff(self.first))])
                if hull is None or not self._is_near(hull):
                    continue
                held = self._held(hull)
                if best is None or (held & left).sum() > (best[1] & left).sum():
                    best = hull, held
            if best is not None:
                return best
        piece = int(seeds[0])  # a single piece is nearly convex
        hull = solid_hull_of(self._points_of(piece))
        return hull, self._held(hull) | (np.arange(self.n) == piece)

    def _is_near(self, hull: Polytope) -> bool:
        """Return whether a hull stays near enough to the mesh."""
        if self.thickness:  # a thin hull may contain no grid node
            return self.distance.farthest(hull, self.settings.finest * self.near) <= self.near
        return self.distance.is_near(hull, self.near)

    def _points_of(self, piece: int) -> Array:
        return self.points[self.first[piece] : self.first[piece + 1]]

    def _held(self, hull: Polytope) -> NDArray[np.bool_]:
        return np.logical_and.reduceat(
            _behind(self.points, hull.planes, ROUNDING * self.size), self.first[:-1]
        )

    def _is_filled(self, hull: Polytope, held: NDArray[np.bool_]) -> bool:
        """Return whether the pieces in a hull fill it completely."""
        if self.thickness or not self.distance.is_near(hull, 0.0):
            return False
        from scipy.spatial import ConvexHull

        volume = ConvexHull(hull.vertices).volume
        pieces = (hull_of(self._points_of(int(k))) for k in np.flatnonzero(held))
        return volume - sum(ConvexHull(p.vertices).volume for p in pieces if p) <= ROUNDING * volume


def frame_of(corners: Array) -> Array:
    """Return a frame along the normals of the largest flat sides.

    Returns
    -------
    array, shape (3, 3): z is the normal of the largest flat side, x that of the largest one across it
    """
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
    """Return the normal of the largest total area, up to its sign."""
    some = np.argsort(-area, kind="stable")[:200]
    total = (np.abs(normals[some] @ normals.T) > 1 - 1e-6) @ area
    return normals[some[total.argmax()]]


class Distance:
    """Distances from a solid or a sheet, 0 inside.

    Parameters
    ----------
    surface : the triangles that bound the solid
    low, high : arrays, shape (3,), corners of the box around it [m]
    resolution : distance up to which the grid holds distances; about the spacing of the grid [m]
    """

    def __init__(
        self, surface: Surfaces, low: Array, high: Array, resolution: float, settings: DecompositionSettings
    ):
        self.surface = surface
        wide = high - low + 2 * resolution
        step = min(float((high - low).max()) / settings.n_nodes, 0.5 * resolution)
        self.step = max(step, float(np.cbrt(wide.prod() / settings.most_nodes)))
        count = np.ceil(wide / self.step).astype(int) + 3
        self.origin = 0.5 * (low + high) - 0.5 * self.step * (count - 1)
        axes = [self.origin[k] + self.step * np.arange(count[k]) for k in range(3)]
        self._nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        self._field = self(self._nodes, resolution + 3 * self.step)
        self.field = self._field.reshape(count)

    def __call__(self, points: Array, cutoff: float = np.inf) -> Array:
        """Return distances of points (n, 3), at most `cutoff`; shape (n,) [m]."""
        return point_distances(self.surface, 0, np.ascontiguousarray(points), cutoff, False)

    def is_near(self, hull: Polytope, most: float) -> bool:
        """Return whether all grid nodes in a hull are near the solid. The largest distance allowed is `most` [m]."""
        far = self._nodes[self._field > most]
        low, high = hull.vertices.min(axis=0), hull.vertices.max(axis=0)
        far = far[((far > low) & (far < high)).all(axis=1)]
        return not bool(_behind(far, hull.planes, -1e-6 * self.step).any())

    def farthest(self, hull: Polytope, enough: float) -> float:
        """Return an upper bound of a hull's distances from the solid [m]. It is at least `enough`."""
        low, high = hull.vertices.min(axis=0), hull.vertices.max(axis=0)
        nodes = self._nodes[self._field > enough]
        inside = _behind(nodes, hull.planes, 0.0)
        most = max(enough, float(self(hull.vertices).max()), float(self(nodes[inside]).max(initial=0.0)))
        half, middles = 0.5 * float((high - low).max()), 0.5 * (low + high)[None]
        corners = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), axis=-1).reshape(-1, 3)
        while len(middles):
            reach = np.sqrt(3.0) * half
            middles = middles[_behind(middles, hull.planes, reach)]
            away = point_distances(self.surface, 0, middles, np.inf, True)
            if reach <= 0.25 * most:
                return max(most, float((away + reach).max(initial=0.0)))
            inside = _behind(middles, hull.planes, 0.0)
            most = max(most, float(away[inside].max(initial=0.0)))
            half *= 0.5
            # Drop boxes that cannot be farther than the largest distance found, as those inside the solid.
            middles = middles[away + reach > most]
            middles = (middles[:, None] + half * corners).reshape(-1, 3)
        return most


@kernel
def _left_out(triangles, planes, first, tolerance):
    """Return the polygons of triangles that polytopes leave over.

    Parameters
    ----------
    planes : array, shape (n_planes, 4), of all polytopes [m]
    first : array of int, shape (n_polytopes + 1,), index of each polytope's first plane

    Returns
    -------
    corners : array, shape (n_polygons, MOST_CORNERS, 3) [m]
    counts : array of int, shape (n_polygons,), number of corners of each polygon
    """
    found, counts, n_found = np.empty((16, MOST_CORNERS, 3)), np.empty(16, dtype=np.int64), 0
    stack = np.empty((256, MOST_CORNERS, 3))
    sizes, after = np.empty(256, dtype=np.int64), np.empty(256, dtype=np.int64)
    inner, outer = np.empty((MOST_CORNERS, 3)), np.empty((MOST_CORNERS, 3))
    for triangle in triangles:
        sizes[0], after[0] = 3, 0
        _copy_rows(triangle, 3, stack[0])
        top = 1
        while top > 0:
            top -= 1
            n, polytope = sizes[top], after[top]
            polygon = stack[top, :n].copy()
            # What lies beyond one of its planes as a whole is not touched by a polytope.
            while polytope < first.shape[0] - 1 and _is_beyond(
                polygon, planes[first[polytope] : first[polytope + 1]], tolerance
            ):
                polytope += 1
            # In no polytope, or in so many pieces already that it is left as it is.
            whole = polytope == first.shape[0] - 1 or top > MOST_OPEN
            for k in range(0 if whole else first[polytope], 0 if whole else first[polytope + 1]):
                n_outer = half(polygon, planes[k], tolerance, 1.0, outer)
                if n_outer > 2:
                    if top == stack.shape[0]:
                        stack = np.concatenate((stack, np.empty_like(stack)))
                        sizes = np.concatenate((sizes, np.empty_like(sizes)))
                        after = np.concatenate((after, np.empty_like(after)))
                    sizes[top], after[top] = n_outer, polytope + 1
                    _copy_rows(outer, n_outer, stack[top])
                    top += 1
                    n = half(polygon, planes[k], tolerance, -1.0, inner)
                    polygon = inner[:n].copy()
                    whole = n + 2 > MOST_CORNERS
                    if n < 3 or whole:
                        break
            if whole:
                if n_found == found.shape[0]:
                    found = np.concatenate((found, np.empty_like(found)))
                    counts = np.concatenate((counts, np.empty_like(counts)))
                counts[n_found] = n
                _copy_rows(polygon, n, found[n_found])
                n_found += 1
    return found[:n_found], counts[:n_found]


@kernel
def _copy_rows(source, n, target):
    for i in range(n):
        copy_to(source[i], target[i])


@kernel
def _is_beyond(polygon, planes, tolerance):
    """Return whether a polygon lies beyond a plane by `tolerance` [m]. Shapes are (n, 3) and (m, 4)."""
    for plane in planes:
        least = np.inf
        for p in polygon:
            least = min(least, plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2] - plane[3])
        if least >= tolerance:
            return True
    return False


@kernel
def _behind(points, planes, out):
    """Return which points (n, 3) lie behind all planes (m, 4). They may be beyond by `out` [m]."""
    inside = np.ones(points.shape[0], dtype=np.bool_)
    for i in range(points.shape[0]):
        for k in range(planes.shape[0]):
            along = planes[k, 0] * points[i, 0] + planes[k, 1] * points[i, 1] + planes[k, 2] * points[i, 2]
            if along > planes[k, 3] + out:
                inside[i] = False
                break
    return inside


@kernel
def _lines(points, first, middle, field, origin, step, most):
    """Return how far lines between pieces leave the solid, (n, n) [m]; infinite beyond `most`."""
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


@kernel
def _line(a, b, field, origin, step, most):
    """Return how far the line between two points leaves the solid [m].

    Where it is more than `most`, any value above `most` may be returned.
    """
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


@kernel
def _interpolated(field, x, y, z):
    i, j, k = int(x), int(y), int(z)
    f, g, h = x - i, y - j, z - k
    near = (1 - f) * (1 - g) * field[i, j, k] + f * (1 - g) * field[i + 1, j, k]
    near += (1 - f) * g * field[i, j + 1, k] + f * g * field[i + 1, j + 1, k]
    far = (1 - f) * (1 - g) * field[i, j, k + 1] + f * (1 - g) * field[i + 1, j, k + 1]
    far += (1 - f) * g * field[i, j + 1, k + 1] + f * g * field[i + 1, j + 1, k + 1]
    return (1 - h) * near + h * far


@kernel
def _group(see, seed, order):
    """Return a group of pieces that all see each other. It is grown from a seed; array of bool, shape (n,).

    Parameters
    ----------
    see : array of bool, shape (n, n), whether two pieces see each other
    order : array of int, the order in which pieces are tried
    """
    n = see.shape[0]
    group, may = np.zeros(n, dtype=np.bool_), see[seed].copy()
    group[seed] = True
    for piece in order:
        if may[piece] and not group[piece]:
            group[piece] = True
            for other in range(n):
                may[other] &= see[piece, other]
    return group
