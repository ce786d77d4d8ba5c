"""Candidate grasps of parallel grippers: antipodal on simple shapes, sampled on meshes.

Fingers close on two opposite sides that are at most `OPENING` apart. The grasp frame (z the approach, fingers close
along y) is `DEPTH` below a flat surface at most, and on the axis of a round body. Reach is not checked here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations
from typing import NamedTuple

import numpy as np

from comove.arrays import Array, Integers
from comove.geometry.rotations import quaternion_of_rotation, rotation_in_plane

OPENING = 0.08
"""Largest distance of two sides on which fingers close [m], as grippers of arms of this size have it."""
DEPTH = 0.02
"""How far below a flat surface the fingers' middle is held [m]."""
INSET = 0.03
"""Distance of a grasp from the end of a payload [m], where it is long enough."""
APART = 0.12
"""Least distance of two hands on one payload [m]."""
N_ROUND = 8
"""Directions from which a round body is approached."""
N_RAYS = 192
"""Points on a mesh from which an opposite side is looked for."""
OPPOSITE = 0.94
"""Cosine of the largest angle between the normals of two sides that fingers hold by friction."""


class Held(NamedTuple):
    """A grasp: its frame's position [m] and orientation (w, x, y, z). The parent is the payload's frame."""

    position: tuple[float, ...]
    quaternion: tuple[float, ...]


class GraspableShape(NamedTuple):
    """A box, or a cylinder about z, of full `size` [m]. It has a pose in the payload's frame."""

    size: tuple[float, float, float]
    is_round: bool
    center: Array
    rotation: Array


def on_pieces(pieces: Sequence[GraspableShape], n_arms: int, up: Array, most: int) -> list[tuple[Held, ...]]:
    """Return sets of `n_arms` grasps on one piece, from above first.

    Parameters
    ----------
    up : array, shape (3,), the vertical at the start in the payload's frame
    most : largest number of sets
    """
    found = [
        (
            tuple(piece.rotation @ p + piece.center for p, _ in some),
            tuple(piece.rotation @ r for _, r in some),
        )
        for piece in pieces
        for some in (_round(piece, n_arms) if piece.is_round else _flat(piece, n_arms))
    ]
    return _ranked(found, up, most)


def _ranked(
    found: list[tuple[tuple[Array, ...], tuple[Array, ...]]], up: Array, most: int
) -> list[tuple[Held, ...]]:
    """Return sets of grasps, best first, by arm and finger turn."""
    from_above = [-sum(float(up @ r[:, 2]) for r in rotations) for _, rotations in found]
    flip, sets = np.diag([-1.0, -1.0, 1.0]), list[tuple[Held, ...]]()
    for k in np.argsort(-np.round(from_above, 9), kind="stable"):
        positions, rotations = found[k]
        for turn in (np.eye(3), flip):
            for order in permutations(range(len(positions))):
                sets.append(tuple(_held(positions[i], rotations[i] @ turn) for i in order))
    return sets[:most]


def _held(position: Array, rotation: Array) -> Held:
    return Held(
        tuple((np.round(position, 12) + 0.0).tolist()), tuple(quaternion_of_rotation(rotation).tolist())
    )


def _frame(approach: Array, closing: Array) -> Array:
    return np.stack([np.cross(closing, approach), closing, approach], axis=1)


def _along(length: float, n_arms: int) -> Array | None:
    """Return where arms hold a side, None without room for all."""
    if n_arms == 1:
        return np.zeros(1)
    half = length / 2 - min(INSET, length / 4)
    return np.linspace(-half, half, n_arms) if 2 * half >= APART * (n_arms - 1) else None


def _flat(piece: GraspableShape, n_arms: int) -> Iterator[list[tuple[Array, Array]]]:
    """Yield grasps on opposite faces of a box, from all sides."""
    size, axes = np.array(piece.size), np.eye(3)
    for c in np.flatnonzero(size <= OPENING):
        for a in (k for k in range(3) if k != c):
            side, inside = 3 - c - a, size[a] / 2 - min(size[a] / 2, DEPTH)
            for sign in (-1.0, 1.0):
                if (along := _along(size[side], n_arms)) is not None:
                    frame = _frame(sign * axes[a], axes[c])
                    yield [(x * axes[side] - sign * inside * axes[a], frame) for x in along]
            if n_arms == 2 and 2 * inside >= APART:
                yield [(s * inside * axes[a], _frame(-s * axes[a], axes[c])) for s in (-1.0, 1.0)]


def _round(piece: GraspableShape, n_arms: int) -> Iterator[list[tuple[Array, Array]]]:
    """Yield grasps across a cylinder, and on a disc's flat ends."""
    diameter, height, z = piece.size[0], piece.size[2], np.eye(3)[2]
    around = [rotation_in_plane(2 * np.pi * k / N_ROUND)[:, 0] for k in range(N_ROUND)]
    along, inside = _along(height, n_arms), diameter / 2 - min(diameter / 2, DEPTH)
    if diameter <= OPENING and along is not None:
        for x in around:
            yield [(h * z, _frame(-x, np.cross(z, -x))) for h in along]
    if height <= OPENING and n_arms <= N_ROUND and (n_arms == 1 or 2 * inside >= APART):
        for k in range(N_ROUND):
            spread = [around[(k + N_ROUND * i // n_arms) % N_ROUND] for i in range(n_arms)]
            yield [(inside * x, _frame(-x, z)) for x in spread]


def on_mesh(triangles: Array, n_arms: int, up: Array, most: int) -> list[tuple[Held, ...]]:
    """Return sets of grasps on opposite sides of a mesh. They are sampled on its surface.

    Parameters
    ----------
    triangles : array, shape (n_triangles, 3, 3) [m], whose normals point outwards
    up, most : as of `on_pieces`
    """
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    solid = areas > 0.0
    triangles, normals, areas = triangles[solid], normals[solid] / areas[solid, None], areas[solid]
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(areas), N_RAYS, p=areas / areas.sum())
    u, v = rng.random((2, N_RAYS, 1))
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
    corner = triangles[chosen, 0]
    points = corner + u * (triangles[chosen, 1] - corner) + v * (triangles[chosen, 2] - corner)
    hit, width = _hits(triangles, points, -normals[chosen])
    good = (width <= OPENING) & ((normals[hit] * normals[chosen]).sum(axis=1) <= -OPPOSITE)
    closing = normals[chosen][good]
    middle = points[good] - 0.5 * width[good, None] * closing
    aside = np.cross(closing, np.eye(3)[np.abs(closing).argmin(axis=1)])
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    singles = list[tuple[Array, Array]]()
    for approach in (aside, -aside, np.cross(closing, aside), -np.cross(closing, aside)):
        _, depth = _hits(triangles, middle, -approach)  # towards the palm the surface is near
        _, beyond = _hits(triangles, middle - (depth + 1e-6)[:, None] * approach, -approach)
        free = (depth <= DEPTH) & np.isinf(beyond)
        singles += [
            (m, _frame(a, c)) for m, a, c in zip(middle[free], approach[free], closing[free], strict=True)
        ]
    return _ranked(_spread(singles, n_arms, most), up, most)


def _hits(triangles: Array, points: Array, ways: Array) -> tuple[Integers, Array]:
    """Return the first triangle of each ray, and its distance. The distance is infinite where there is none.

    The method is that of Möller and Trumbore (1997).
    """
    first, apart = np.zeros(len(points), dtype=np.int64), np.full(len(points), np.inf)
    a, e, f = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    block = max(1, 2_000_000 // max(len(triangles), 1))
    for k in range(0, len(points), block):
        d, o = ways[k : k + block, None], points[k : k + block, None]
        h = np.cross(d, f)
        det = (e * h).sum(axis=2)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = o - a
            u = (s * h).sum(axis=2) / det
            q = np.cross(s, e)
            v = (q * d).sum(axis=2) / det
            t = (q * f).sum(axis=2) / det
            t = np.where((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 1e-7), t, np.inf)
        first[k : k + block], apart[k : k + block] = t.argmin(axis=1), t.min(axis=1)
    return first, apart


def _spread(
    singles: list[tuple[Array, Array]], n_arms: int, most: int
) -> list[tuple[tuple[Array, ...], tuple[Array, ...]]]:
    """Return sets of grasps far apart, from about the same side."""
    if n_arms == 1 or not singles:
        return [((p,), (r,)) for p, r in singles[:most]]
    positions = np.array([p for p, _ in singles])
    approaches = np.array([r[:, 2] for _, r in singles])
    sets = list[tuple[float, tuple[int, ...]]]()
    for i in range(len(singles)):
        alike = approaches @ approaches[i] > OPPOSITE
        members, near = [i], np.linalg.norm(positions - positions[i], axis=1)
        for _ in range(n_arms - 1):
            near[~alike] = 0.0
            members.append(int(near.argmax()))
            near = np.minimum(near, np.linalg.norm(positions - positions[members[-1]], axis=1))
        gaps = np.linalg.norm(positions[members][:, None] - positions[members], axis=2)
        least = float(gaps[np.triu_indices(n_arms, 1)].min())
        if least >= APART:
            sets.append((least, tuple(sorted(members))))
    best = sorted(dict.fromkeys(sets), key=lambda one: -round(one[0], 9))[:most]
    return [
        (tuple(singles[i][0] for i in members), tuple(singles[i][1] for i in members)) for _, members in best
    ]
