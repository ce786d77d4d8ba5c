"""An independent judge for tests: plain NumPy on dense samples of the true curve.

It reads the *file* of a scene, never its kernels' tables, has distances and load geometry of its own, and takes
from a motion only its configurations q(s), exact at every s. What it finds is met by the motion, so it is an
upper bound of the true clearance: nothing certified may lie above it.
"""

from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

COARSE = 1600  # intervals of a first look
COARSE_PARTS = 32  # of an edge, at a first look
REFINEMENTS, PARTS = 3, 8  # how often and how finely the lowest cells are looked at again
KEPT_OF_AN_EDGE, KEPT = 6, 16  # cells, of the lowest values and as many of the lowest bounds


# --- Signed distances ---


def obstacle_distance(obstacle, points, time=None):
    """Signed distances [m] from `points`, array of shape (..., n_dims), to an obstacle of a scene file.

    `time` holds the instants [s] of the first axes of `points`; an obstacle that moves is at 0 s unless given.
    """
    n_dims = points.shape[-1]
    points = points if time is None else as_seen(obstacle, points, time)
    local = points - np.array(obstacle.center)
    if n_dims == 2:
        turn = np.deg2rad(getattr(obstacle, "rotation_deg", 0.0))
        x = np.cos(turn) * local[..., 0] + np.sin(turn) * local[..., 1]
        y = np.cos(turn) * local[..., 1] - np.sin(turn) * local[..., 0]
        local = np.stack([x, y], axis=-1)
    else:
        w, x, y, z = getattr(obstacle, "quaternion_wxyz", (1.0, 0.0, 0.0, 0.0))
        if (x, y, z) != (0.0, 0.0, 0.0):
            local = local @ Rotation.from_quat([x, y, z, w]).as_matrix()
    return _DISTANCES[obstacle.shape](obstacle, np.abs(local))


def as_seen(obstacle, points, time):
    """Points at some instants where an obstacle that moves sees them: relative to its pose at 0 s."""
    if getattr(obstacle, "motion", None) is None:
        return points
    n_dims, t = points.shape[-1], np.ravel(time)
    turned, center = _displaced(obstacle, t)
    seen = points.reshape(len(t), -1, n_dims) - center[:, None]
    return (np.array(obstacle.center) + seen @ turned).reshape(points.shape)  # the inverse turn of rows


def placed(obstacle, time):
    """Orientations (n, n_dims, n_dims) and centres (n, n_dims) [m] of an obstacle of a scene file at instants [s]."""
    turned, center = _displaced(obstacle, np.ravel(time))
    n_dims, (w, *xyz) = center.shape[1], getattr(obstacle, "quaternion_wxyz", (1.0, 0.0, 0.0, 0.0))
    own = Rotation.from_quat([*xyz, w])
    if n_dims == 2:
        own = Rotation.from_euler("z", getattr(obstacle, "rotation_deg", 0.0), degrees=True)
    return turned @ own.as_matrix()[:n_dims, :n_dims], center


def _displaced(obstacle, t):
    """How an obstacle has turned since 0 s, and its centres."""
    motion, start = getattr(obstacle, "motion", None), np.array(obstacle.center, dtype=float)
    n_dims, way = len(start), np.zeros((len(t), len(start)))
    turned = np.broadcast_to(np.eye(n_dims), (len(t), n_dims, n_dims))
    if motion is None:
        return turned, start + way
    if motion.velocity is not None:
        way = t[:, None] * motion.velocity
    if motion.waypoints is not None:
        way = np.stack([np.interp(t, motion.times, x) - x[0] for x in np.transpose(motion.waypoints)], axis=1)
    if motion.circle is not None:
        angle = 2 * np.pi * t / motion.circle.period_s
        way[:, :2] = motion.circle.radius * np.stack([np.cos(angle) - 1.0, np.sin(angle)], axis=1)
    if motion.turn is not None:
        hinge = np.array(motion.turn.hinge or np.zeros(n_dims))
        axis = np.array(motion.turn.axis or (0.0, 0.0, 1.0))
        angles = np.deg2rad(motion.turn.rate_deg_per_s) * t[:, None] * axis / np.linalg.norm(axis)
        turned = Rotation.from_rotvec(angles).as_matrix()[:, :n_dims, :n_dims]
        way = way + hinge - turned @ hinge
    return turned, start + way


def _box(box, p):
    return _cornered(p[..., i] - 0.5 * size for i, size in enumerate(box.size))


def _cornered(beyond):
    """Distance from how far a point is beyond each face of a product of shapes (negative: within)."""
    square, inside = 0.0, -np.inf
    for x in beyond:
        square, inside = square + np.maximum(x, 0.0) ** 2, np.maximum(x, inside)
    return np.sqrt(square) + np.minimum(inside, 0.0)


def _capsule(capsule, p):
    along, across = (
        (p[..., 0], p[..., 1]) if p.shape[-1] == 2 else (p[..., 2], np.hypot(p[..., 0], p[..., 1]))
    )
    return np.hypot(np.maximum(along - 0.5 * capsule.length, 0.0), across) - capsule.radius


def _cylinder(cylinder, p):
    return _cornered((np.hypot(p[..., 0], p[..., 1]) - cylinder.radius, p[..., 2] - 0.5 * cylinder.height))


def _ellipsoid(ellipsoid, p):
    """Exact near the nearest of the points; what is 0.05 m further away is told too far (by its inner sphere)."""
    r = np.array(ellipsoid.radii)
    away = _norm(p)
    distance = away - r.min()
    near = away - r.max() < distance.min(initial=np.inf) + 0.05
    distance[near] = _near_ellipsoid(r, p[near])
    return distance


def _near_ellipsoid(r, p):
    """By bisection for the multiplier t of the nearest point r^2 p / (r^2 + t); p, array of shape (n, n_dims)."""
    axes = [(radius, np.maximum(x, 1e-9 * radius)) for radius, x in zip(r, p.T, strict=True)]
    low = np.max([radius * x - radius**2 for radius, x in axes], axis=0)
    high = np.sqrt(sum((radius * x) ** 2 for radius, x in axes)) - r.min() ** 2
    for _ in range(40):
        middle = 0.5 * (low + high)
        outside = sum((radius * x / (middle + radius**2)) ** 2 for radius, x in axes) > 1.0
        low, high = np.where(outside, middle, low), np.where(outside, high, middle)
    t = 0.5 * (low + high)
    return t * np.sqrt(sum((x / (t + radius**2)) ** 2 for radius, x in axes))


_DISTANCES = {
    "box": _box,
    "sphere": lambda sphere, p: _norm(p) - sphere.radius,
    "capsule": _capsule,
    "cylinder": _cylinder,
    "ellipsoid": _ellipsoid,
}


def _norm(p):
    """np.linalg.norm along the last axis, several times faster for 2 or 3 numbers."""
    return np.sqrt(sum(p[..., i] ** 2 for i in range(p.shape[-1])))


def point_clearance(scene, points, time=None):
    """Distances [m] from `points`, array of shape (..., n_dims), to obstacles and border, whichever is nearer.

    `time` is as in `obstacle_distance`.
    """
    lower, upper = np.array(scene.file.workspace.lower), np.array(scene.file.workspace.upper)
    least = np.inf
    for axis in range(points.shape[-1]):
        x = points[..., axis]
        least = np.minimum(least, np.minimum(x - lower[axis], upper[axis] - x))
    for obstacle in scene.file.obstacles:
        least = np.minimum(least, obstacle_distance(obstacle, points, time))
    return least


# --- Hands and load ---


def hands_of(coordinates, q, file=None):
    """Hands (n, n_manipulators, n_dims) [m] of configurations q (n, n_columns), by the table of coordinates.py.

    `file` is that of the scene, needed where it demands a common height of hands that are free.
    """
    n_dims, column = coordinates.n_dims, 0
    hands = np.empty((len(q), sum(len(group.members) for group in coordinates.groups), n_dims))
    lower = {} if file is None else _same_height(file, coordinates.groups)
    heights = {}
    for group in coordinates.groups:
        first, held = group.members[0], (group.unturned @ group.grasps.T).T[:, :n_dims]
        own = n_dims - 1 if lower.get(first, first) != first else n_dims
        center = np.concatenate(
            [q[:, column : column + own], heights.get(lower.get(first), q[:, :0])], axis=1
        )
        heights.setdefault(first, center[:, -1:])
        column += own
        if group.orientation in ("none", "fixed"):
            turned = np.repeat(held[None], len(q), axis=0)
        elif group.orientation in ("plane", "vertical"):
            if coordinates.kind == "load":
                c, s = np.cos(q[:, column]), np.sin(q[:, column])
                column += 1
            else:
                c, s = (
                    q[:, column : column + 2] / np.linalg.norm(q[:, column : column + 2], axis=1)[:, None]
                ).T
                column += 2
            turned = np.repeat(held[None], len(q), axis=0)
            turned[..., 0] = np.outer(c, held[:, 0]) - np.outer(s, held[:, 1])
            turned[..., 1] = np.outer(s, held[:, 0]) + np.outer(c, held[:, 1])
        elif group.orientation == "axis":
            along = q[:, column : column + 3] / np.linalg.norm(q[:, column : column + 3], axis=1)[:, None]
            column += 3
            turned = held[None, :, :1] * along[:, None, :]
        else:
            turn = Rotation.from_quat(q[:, [column + 1, column + 2, column + 3, column]]).as_matrix()
            column += 4
            turned = np.einsum("nij,mj->nmi", turn, held)
        hands[:, list(group.members)] = center[:, None, :] + turned
    return hands


def _same_height(file, groups):
    """For every hand at the height of hands of other groups the first of them, by repeated looks at all pairs."""
    names = [m.name for m in file.manipulators]
    pairs = [tuple(names.index(n) for n in c.between) for c in file.constraints if c.type == "same_height"]
    pairs = [pair for pair in pairs if not any(set(pair) <= set(group.members) for group in groups)]
    lowest = {hand: hand for pair in pairs for hand in pair}
    for _ in pairs:
        for i, j in pairs:
            lowest[i] = lowest[j] = min(lowest[i], lowest[j])
    return lowest


def body_of(scene, hands):
    """What must not touch anything: ends (n, n_edges, n_dims) of its edges and their radii (n_edges,) [m].

    `hands` is an array of shape (n, n_manipulators, n_dims).
    """
    load, names = scene.file.load, [m.name for m in scene.file.manipulators]
    edges = [(hands[:, i], hands[:, i], 0.0) for i in range(len(names))]
    if load is not None and load.shape == "bar":
        first, second = (hands[:, names.index(name)] for name in (load.held_by or names))
        beyond = load.overhang * (second - first) / np.linalg.norm(second - first, axis=-1)[:, None]
        edges = [(first - beyond, second + beyond, load.radius), *edges]
    elif load is not None and load.shape == "frame":
        rods = [(hands[:, names.index(a)], hands[:, names.index(b)], load.radius) for a, b in load.edges]
        edges = [*rods, *edges]
    elif load is not None:
        edges = [*_polygon(load, names, hands), *edges]
    first, second, radii = zip(*edges, strict=True)
    return np.stack(first, axis=1), np.stack(second, axis=1), np.array(radii)


def _polygon(load, names, hands):
    """Edges of a polygon whose `grasps` are given, from the line through its first two hands."""
    held, grasps = list(load.grasps), {name: np.array(grasp) for name, grasp in load.grasps.items()}
    line = grasps[held[1]] - grasps[held[0]]
    first, second = hands[:, names.index(held[0])], hands[:, names.index(held[1])]
    wanted = second - first
    c = (line[0] * wanted[:, 0] + line[1] * wanted[:, 1]) / (line @ line)
    s = (line[0] * wanted[:, 1] - line[1] * wanted[:, 0]) / (line @ line)
    turn = np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=1)
    corners = [first + turn @ (np.array(vertex) - grasps[held[0]]) for vertex in load.vertices]
    return [(corners[i - 1], corners[i], load.radius) for i in range(len(corners))]


# --- The least clearance of a motion ---


@lru_cache(maxsize=8)
def _coarse_basis(basis):
    boundary, shape = basis.at(np.linspace(0.0, 1.0, COARSE + 1))
    return boundary[0], shape[0]


def hands_at(motion, s=None):
    """Hands (n, n_manipulators, n_dims) at normalised times `s` (n,); at even times where none are given."""
    boundary, shape = _coarse_basis(motion.basis) if s is None else (m[0] for m in motion.basis.at(s))
    q = boundary @ motion.boundary + shape @ motion.weights.T
    return hands_of(motion.coordinates, q, motion.scene.file)


def separations(hands, first, second):
    """Distances (n,) [m] of two of the hands (n, n_manipulators, n_dims)."""
    return _norm(hands[:, first] - hands[:, second])


def height_differences(hands, first, second):
    """Differences (n,) [m] of the heights of two of the hands (n, n_manipulators, n_dims)."""
    return np.abs(hands[:, first, -1] - hands[:, second, -1])


def tilts(hands):
    """By how much a body held by hands (n, n_held, n_dims) is tilted against the first of n [rad].

    In the plane the angle it has turned; in space by how much its vertical has moved in its own frame, or, for
    two hands, by how much the inclination of the line between them has changed.
    """
    line = hands[:, 1] - hands[:, 0]
    if hands.shape[2] == 2:
        turned = np.arctan2(line[:, 1], line[:, 0]) - np.arctan2(line[0, 1], line[0, 0])
        return np.abs(turned - 2 * np.pi * np.round(turned / (2 * np.pi)))
    if hands.shape[1] == 2:
        slope = np.arctan2(line[:, 2], np.hypot(line[:, 0], line[:, 1]))
        return np.abs(slope - slope[0])
    x = line / _norm(line)[:, None]
    normal = np.cross(line, hands[:, 2] - hands[:, 0])
    normal /= _norm(normal)[:, None]
    vertical = np.stack([x[:, 2], np.cross(normal, x)[:, 2], normal[:, 2]], axis=1)
    return np.arctan2(_norm(np.cross(vertical, vertical[0])), vertical @ vertical[0])


def least_clearance(motion, scene=None):
    """The least clearance [m] that brute force meets, and its normalised time.

    A grid over time and over every edge, then the lowest cells again, 8 times finer, three times over: some
    800,000 steps in time and 30,000 along an edge where it matters.
    """
    scene = scene or motion.scene
    a, b, radii = body_of(scene, hands_at(motion))
    way = np.maximum(*(_norm(np.diff(x, axis=0)) for x in (a, b)))
    length = _norm(b[0] - a[0])
    coarse = np.linspace(0.0, 1.0, COARSE + 1)
    least, time, cells = np.inf, 0.0, []
    for edge in range(len(radii)):
        parts = COARSE_PARTS if length[edge] > 0 else 0
        shares = np.linspace(0.0, 1.0, parts + 1)
        points = a[:, edge, None] + shares[:, None] * (b - a)[:, edge, None]
        clearance = point_clearance(scene, points, coarse * scene.file.duration) - radii[edge]
        corner, (k, i) = _least(clearance)
        if clearance[k, i] < least:
            least, time = float(clearance[k, i]), float(k / COARSE)
        step = 1.0 / parts if parts else 0.0
        bound = corner - 0.5 * way[:, edge, None] - 0.5 * step * length[edge]
        k, i = _lowest(corner, bound, KEPT_OF_AN_EDGE)
        one = np.ones(len(k))
        cells.append(np.stack([k / COARSE, one / COARSE, one * edge, i * step, one * step]))
    cells, shares = np.concatenate(cells, axis=1), np.linspace(0.0, 1.0, PARTS + 1)
    for _ in range(REFINEMENTS):
        cells, found, when = _refined(motion, scene, cells, shares)
        if found < least:
            least, time = found, when
    return least, time


def _least(clearance):
    """Least corner of every cell of a grid over time and share, the last two axes, and where the least is."""
    corner = np.minimum(clearance[..., 1:, :], clearance[..., :-1, :])
    if clearance.shape[-1] > 1:
        corner = np.minimum(corner[..., 1:], corner[..., :-1])
    return corner, np.unravel_index(clearance.argmin(), clearance.shape)


def _lowest(corner, bound, count):
    """Indices of the cells that are lowest, and of those that may be."""
    kept = {int(i) for x in (corner, bound) for i in np.argpartition(x.ravel(), count)[:count]}
    return np.unravel_index(sorted(kept), corner.shape)


def _refined(motion, scene, cells, shares):
    """The lowest parts of `cells` (time, its step, edge, share, its step), the least clearance in them, when."""
    t0, dt, e, s0, ds = cells
    e = e.astype(int)
    times = np.minimum(t0[:, None] + shares * dt[:, None], 1.0)
    a, b, radii = body_of(scene, hands_at(motion, times.ravel()))
    shape = (*times.shape, *a.shape[1:])
    row = np.arange(len(e))
    a, b = a.reshape(shape)[row, :, e], b.reshape(shape)[row, :, e]  # (n_cells, n_times, n_dims)
    along = s0[:, None] + shares * ds[:, None]
    points = a[:, :, None] + along[:, None, :, None] * (b - a)[:, :, None]
    clearance = point_clearance(scene, points, times * scene.file.duration) - radii[e, None, None]
    corner, at = _least(clearance)
    way = np.maximum(*(_norm(np.diff(x, axis=1)) for x in (a, b)))
    length = _norm(b[:, 0] - a[:, 0]) * ds / PARTS
    bound = corner - 0.5 * way[:, :, None] - 0.5 * length[:, None, None]
    c, k, i = _lowest(corner, bound, KEPT)
    finer = np.stack([times[c, k], dt[c] / PARTS, e[c], along[c, i], ds[c] / PARTS])
    return finer, float(clearance[at]), float(times[at[0], at[1]])


def configuration_clearance(scene, hands, n_points=201):
    """Least clearance [m] of every configuration; hands (n, n_manipulators, n_dims), `n_points` along an edge."""
    a, b, radii = body_of(scene, hands)
    shares = np.linspace(0.0, 1.0, n_points)[:, None]
    points = a[:, :, None, :] + shares * (b - a)[:, :, None, :]
    return (point_clearance(scene, points) - radii[:, None]).min(axis=(1, 2))


# --- Triangles ---


def mesh_clearance(motion, triangles, offsets=None, n_times=241, refinements=REFINEMENTS):
    """The least distance [m] of hands and load from triangles (n, 3, 3) that brute force meets, and its time.

    Exact distances of segments from triangles at even times, then around the lowest ones, 8 times finer, three times
    over. The load's edges are taken, not what is between them. `offsets` says how far the triangles have moved at
    normalised times.
    """
    offsets = offsets or (lambda s: np.zeros((len(s), 3)))
    times, least = np.linspace(0.0, 1.0, n_times), (np.inf, 0.0)
    step = times[1]
    for _ in range(refinements + 1):
        a, b, radii = body_of(motion.scene, hands_at(motion, times))
        moved = offsets(times)[:, None]
        apart = segments_from_triangles(a - moved, b - moved, triangles) - radii
        apart = apart.min(axis=1)
        k = int(apart.argmin())
        least = min(least, (float(apart[k]), float(times[k])))
        low = times[np.argsort(apart)[:5]]
        times = np.unique(np.clip(low[:, None] + step * np.linspace(-1, 1, 2 * PARTS + 1), 0.0, 1.0))
        step /= PARTS
    return least


def segments_from_triangles(a, b, triangles):
    """Least distance of every segment a-b, arrays (..., 3), from any of the triangles (n, 3, 3)."""
    shape = a.shape[:-1]
    p, q = (np.broadcast_to(x.reshape(-1, 1, 3), (a.size // 3, len(triangles), 3)) for x in (a, b))
    corners = [np.broadcast_to(triangles[:, k], p.shape) for k in range(3)]
    least = np.minimum(_point_triangle(p, *corners), _point_triangle(q, *corners))
    for k in range(3):
        least = np.minimum(least, _segment_segment(p, q, corners[k], corners[(k + 1) % 3]))
    least[_pierces(p, q, *corners)] = 0.0
    return least.min(axis=1).reshape(shape)


def _dot(x, y):
    return (x * y).sum(axis=-1)


def _point_segment(p, a, b):
    along = b - a
    share = np.clip(_dot(p - a, along) / np.maximum(_dot(along, along), 1e-300), 0.0, 1.0)
    return _norm(p - a - share[..., None] * along)


def _point_triangle(p, a, b, c):
    """By the foot on the plane where it is inside, else by the sides."""
    least = np.minimum(np.minimum(_point_segment(p, a, b), _point_segment(p, b, c)), _point_segment(p, c, a))
    normal = np.cross(b - a, c - a)
    size = _norm(normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        height = _dot(p - a, normal) / size
        foot = p - (height / size)[..., None] * normal
        inside = np.ones(p.shape[:-1], dtype=bool)
        for u, v in ((a, b), (b, c), (c, a)):
            inside &= _dot(np.cross(v - u, foot - u), normal) >= 0
    return np.where(inside & (size > 0), np.minimum(least, np.abs(height)), least)


def _segment_segment(p, q, a, b):
    """Of two segments: where both feet are inside, else by the ends, which the other tests see."""
    u, v, w = q - p, b - a, p - a
    uu, uv, vv, uw, vw = _dot(u, u), _dot(u, v), _dot(v, v), _dot(u, w), _dot(v, w)
    det = uu * vv - uv**2
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = (uv * vw - vv * uw) / det, (uu * vw - uv * uw) / det
        inside = (det > 1e-14 * uu * vv) & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
        across = _norm(w + s[..., None] * u - t[..., None] * v)
    least = np.minimum(_point_segment(a, p, q), _point_segment(b, p, q))
    return np.where(inside, np.minimum(least, across), least)


def _pierces(p, q, a, b, c):
    """Whether a segment goes through a triangle (Moeller & Trumbore, 1997)."""
    way, ab, ac = q - p, b - a, c - a
    h = np.cross(way, ac)
    det = _dot(ab, h)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = _dot(p - a, h) / det
        r = np.cross(p - a, ab)
        v, t = _dot(way, r) / det, _dot(ac, r) / det
        return (det != 0) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 1)
