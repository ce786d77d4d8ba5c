"""Resting contacts of a payload at its start or goal.

A payload may lie on an obstacle, or within the clearance of it. An obstacle with `support: true` may be nearer at an
end than the clearance c, down to contact. Let d be its distance there, n the direction in which the body leaves it,
and u the largest displacement of any node from that end. At every instant the body must then keep c from the obstacle
*receded* against n by

    r = max(0, c - d + TOLERANCE - SLOPE u).

As that moves no point of the obstacle by more than r, the true distance is at least ``min(c, d - TOLERANCE + SLOPE
u)``: never below its value at the end, growing with every millimetre that the body moves, and the full clearance
from ``u = (c - d + TOLERANCE) / SLOPE`` on. The rule depends on poses alone, not on time, so pauses, retiming and
pushes do not change it. All other pairs keep the full clearance.
"""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from comove.arrays import Array, Integers, first_largest, first_least
from comove.errors import SceneError
from comove.geometry import distances as sd
from comove.geometry.rotations import matrices
from comove.model.files.keys import SceneFile
from comove.model.files.words import Words
from comove.model.moving import ObstacleMotion
from comove.model.rigid import ENDS
from comove.model.shapes import MovingBody

SLOPE = 0.5  # by which the required distance grows per displacement: a body leaves at 30 degrees or more
TOLERANCE = 1e-4  # m, of drawings, by which a body may be in its support, and its distance may shrink
SPARE = 0.05  # by which a direction must be steeper than `SLOPE`, so that a motion along it can be certified
PASSABLE = 0.01  # m, beyond twice the clearance, by which a slot is wide enough to be left
PROVABLE_END = 1e-9  # of the workspace, and of a metre, that an end keeps beyond the clearance asked for
REFINED, PROBE = (
    4,
    1e-4,
)  # rounds in which a direction is improved, by differences of distances over this step [m]


class Supported(Protocol):
    """The part of `comove.model.scene.Scene` that resting contacts use."""

    @property
    def file(self) -> SceneFile: ...
    @property
    def path(self) -> Path | None: ...
    @property
    def words(self) -> Words: ...
    @property
    def n_dims(self) -> int: ...
    @property
    def lower(self) -> Array: ...
    @property
    def upper(self) -> Array: ...
    @property
    def clearance(self) -> float: ...
    @property
    def body(self) -> MovingBody: ...
    @property
    def obstacles(self) -> Array: ...
    @property
    def first_rows(self) -> Integers: ...
    @property
    def motions(self) -> tuple[ObstacleMotion | None, ...]: ...
    @property
    def rests(self) -> tuple[Rest, ...]: ...
    def nodes_at(self, end: str) -> Array: ...
    def name_of(self, obstacle: int) -> str: ...
    def distance_from(self, obstacle: int, nodes: Array, offset: Array | float = 0.0) -> float: ...


class Rest(NamedTuple):
    """A resting contact at one end.

    Attributes
    ----------
    end : "start" or "goal"
    obstacle : number of the obstacle in the scene's file
    nodes : array, shape (n_nodes, 3), the body there [m]
    distance : distance from the obstacle there [m], negative by at most `TOLERANCE`
    normal : array, shape (3,), unit vector along which the body leaves the obstacle
    """

    end: str
    obstacle: int
    nodes: Array
    distance: float
    normal: Array

    def relief(self, clearance: float) -> float:
        """Return how far the obstacle recedes while the body rests [m]."""
        return max(0.0, clearance - self.distance + TOLERANCE)

    def reach(self, clearance: float) -> float:
        """Return the displacement [m] beyond which full clearance is required."""
        return self.relief(clearance) / SLOPE

    def displacement(self, nodes: Array) -> Array:
        """Return the largest displacement of a node; arrays, shape (..., n_nodes, 3) -> (...,) [m]."""
        return np.asarray(np.linalg.norm(nodes - self.nodes, axis=-1).max(axis=-1))


def provable(scene: Supported) -> float:
    """Return the margin of ends beyond the required clearance [m]."""
    return PROVABLE_END * max(1.0, float((scene.upper - scene.lower).max()))


def recessions(scene: Supported, nodes: Array, beyond: float = 0.0) -> Array:
    """Return receded obstacles' displacements; array, shape (..., n_obstacles, 3) [m].

    Parameters
    ----------
    nodes : array, shape (..., n_nodes, 3), the body [m]
    beyond : margin beyond the clearance that a search keeps [m], by which obstacles recede further
    """
    moved = np.zeros((*nodes.shape[:-2], len(scene.motions), 3))
    for rest in scene.rests:  # of two on one obstacle the larger one counts
        size = rest.relief(scene.clearance) + beyond - SLOPE * rest.displacement(nodes)
        own = moved[..., rest.obstacle, :]
        larger = size > np.linalg.norm(own, axis=-1)
        moved[..., rest.obstacle, :] = np.where(larger[..., None], -size[..., None] * rest.normal, own)
    return moved


def recession_sagittas(scene: Supported, nodes: Array, deviation: Array, moved: Array) -> Array:
    """Bound the interpolation error of recessions; (n_knots - 1, n_obstacles) [m].

    Between two knots the recession changes by `SLOPE` times the largest displacement of a node at most, and is never
    negative; so interpolated recessions exceed it by no more than that, and by no more than the larger of the two.

    Parameters
    ----------
    nodes : array, shape (n_knots, n_nodes, 3) [m]
    deviation : array, shape (n_knots - 1, n_nodes), distance of the nodes from their chords [m]
    moved : array, shape (n_knots, n_obstacles, 3), `recessions` at the knots [m]
    """
    size = np.linalg.norm(moved, axis=-1)
    travel = (np.linalg.norm(np.diff(nodes, axis=0), axis=-1) + deviation).max(axis=1)
    return np.asarray(np.minimum(np.maximum(size[1:], size[:-1]), SLOPE * travel[:, None]))


def rests_of(scene: Supported) -> tuple[Rest, ...]:
    """Find the resting contacts of a scene at both ends.

    Raises
    ------
    SceneError
        If a payload is deeper in a support than `TOLERANCE`, or no motion could leave its supports.
    """
    supports = [i for i, obstacle in enumerate(scene.file.obstacles) if obstacle.support]
    found: list[Rest] = []
    for end in ENDS if supports else ():
        nodes = scene.nodes_at(end)
        own = [rest for i in supports if (rest := _rest(scene, end, i, nodes)) is not None]
        if own:
            _require_way(scene, end, own)
        found += own
    return _told_apart(scene, found)


def lift_direction(rests: list[Rest]) -> Array:
    """Return the unit vector that leaves all supports best; shape (3,).

    It points to the point of the normals' convex hull that is nearest to the origin: of all unit vectors its least
    product with a normal is largest. Where that point is the origin, the vector is 0.
    """
    normals, best = np.array([rest.normal for rest in rests]), np.zeros(3)
    for size in (1, 2, 3):
        for some in combinations(range(len(normals)), min(size, len(normals))):
            corners = normals[list(some)]
            square = np.block([[corners @ corners.T, np.ones((len(some), 1))], [np.ones(len(some)), 0.0]])
            shares = np.linalg.lstsq(square, np.append(np.zeros(len(some)), 1.0), rcond=None)[0][:-1]
            point = shares @ corners
            away = float(np.linalg.norm(point))
            inside = (shares >= -1e-12).all() and away > 1e-9
            if inside and (normals @ point >= away**2 - 1e-12).all():
                return np.asarray(point / away)
    return best


def require_no_rest(scene: Supported) -> None:
    """Raise for resting contacts, which stepwise motions cannot have.

    Raises
    ------
    SceneError
        If the scene has any; it states where start and goal must be.
    """
    told = []
    for end in ENDS:
        rests = [rest for rest in scene.rests if rest.end == end]
        if rests:
            way = lift_direction(rests)
            high = max(rest.relief(scene.clearance) / float(rest.normal @ way) for rest in rests)
            told.append(f"{scene.words.moved(end)} by {_written(scene, high * way)} m")
    if told:
        raise SceneError(
            f"the payload rests on {scene.name_of(scene.rests[0].obstacle)}, and a motion that is made step by step "
            f"keeps {scene.clearance:g} m of clearance from the start on",
            file=scene.path,
            key=scene.words.key(f"obstacles[{scene.rests[0].obstacle}].support"),
            way_out=f"move {' and '.join(told)}, or plan all of it: comove solve",
        )


def _rest(scene: Supported, end: str, obstacle: int, nodes: Array) -> Rest | None:
    """Return the contact of an end with a support, or None."""
    distance = scene.distance_from(obstacle, nodes)
    if distance >= scene.clearance + provable(scene):
        return None
    far = scene.clearance - distance + TOLERANCE
    normal = _normal(scene, obstacle, nodes, far)
    where, name = scene.words.key(f"manipulators.{end}"), scene.name_of(obstacle)
    apart = scene.distance_from(obstacle, nodes, -far * normal)
    is_single = apart >= scene.clearance + 0.5 * TOLERANCE
    if distance < -TOLERANCE - provable(scene):
        by = f"by {_written(scene, -distance * normal)} m" if is_single else f"out of {name}"
        raise SceneError(
            f"at the {end} the payload or an end effector is {-distance:.3g} m deep in {name}, which supports it "
            f"({TOLERANCE:g} m is allowed)",
            file=scene.path,
            key=where,
            way_out=f"move {scene.words.moved(end)} {by}",
        )
    if not is_single:
        raise SceneError(
            f"at the {end} the payload or an end effector is within {scene.clearance:g} m of {name} on several "
            "sides, so that no straight way leaves it",
            file=scene.path,
            key=where,
            way_out=f"move the {end}, or divide {name} into convex obstacles",
        )
    return Rest(end, obstacle, nodes, distance, normal)


def _normal(scene: Supported, obstacle: int, nodes: Array, far: float) -> Array:
    """Return the unit vector of an obstacle's best recession; shape (3,).

    Of the axes of the world, the obstacle and the payload, the best is improved along the gradient of the distance,
    which exists once the two are apart.
    """

    def apart(way: Array) -> float:
        return scene.distance_from(obstacle, nodes, -far * way)

    row = scene.obstacles[scene.first_rows[obstacle]]
    turn = matrices(
        np.array(getattr(scene.file.obstacles[obstacle], "quaternion_wxyz", (1.0, 0.0, 0.0, 0.0)))
    )
    axes = [np.eye(3), turn.T, row[sd.ROTATION : sd.ROTATION + 9].reshape(3, 3).T]
    axes += [nodes[own[[1, 2, 4]]] - nodes[own[0]] for own in scene.body.solids[:, :5]]
    axes += [nodes[scene.body.edges[:, 1]] - nodes[scene.body.edges[:, 0]]]
    ways = np.concatenate(axes)
    if scene.n_dims == 2:
        ways = np.concatenate([ways, ways[:, [1, 0, 2]] * [-1.0, 1.0, 1.0]]) * [1.0, 1.0, 0.0]
    length = np.linalg.norm(ways, axis=1, keepdims=True)
    ways = (ways / np.maximum(length, 1e-12))[length[:, 0] > 1e-9]
    ways = np.concatenate([ways, -ways])
    best = ways[first_largest([apart(way) for way in ways])]
    steps = PROBE * np.eye(3)[: scene.n_dims]
    for _ in range(REFINED):
        ahead, back = (
            [scene.distance_from(obstacle, nodes, -far * best - sign * step) for step in steps]
            for sign in (1, -1)
        )
        slope = np.zeros(3)
        slope[: scene.n_dims] = np.subtract(ahead, back)
        size = float(np.linalg.norm(slope))
        if size == 0.0 or apart(slope / size) <= apart(best):
            break
        best = slope / size
    return np.asarray(best)


def _require_way(scene: Supported, end: str, rests: list[Rest]) -> None:
    """Raise if no direction leaves the supports, as in a slot."""
    steepest = min(float(rest.normal @ lift_direction(rests)) for rest in rests)
    if steepest >= SLOPE + SPARE:
        return
    names = [scene.name_of(rest.obstacle) for rest in rests]
    pairs = list(combinations(rests, 2))
    opposed = pairs[first_least([first.normal @ second.normal for first, second in pairs])]
    last = opposed[first_largest([rest.distance for rest in opposed])]
    wide = 2 * scene.clearance + PASSABLE - sum(rest.distance for rest in opposed)
    moved = _written(scene, -wide * last.normal)
    raise SceneError(
        f"at the {end} the payload or an end effector is within {scene.clearance:g} m of {', '.join(names[:-1])} and "
        f"{names[-1]}, and no direction leaves all of them",
        file=scene.path,
        key=scene.words.key(f"manipulators.{end}"),
        way_out=f"move {scene.name_of(last.obstacle)} by {moved} m",
    )


def _told_apart(scene: Supported, rests: list[Rest]) -> tuple[Rest, ...]:
    """Return contacts; those of one obstacle share a direction or are far apart.

    Raises
    ------
    SceneError
        If start and goal are near each other, but on different sides of an obstacle.
    """
    kept: list[Rest] = []
    for rest in rests:
        for other in (other for other in kept if other.obstacle == rest.obstacle):
            if np.allclose(other.normal, rest.normal, rtol=0.0, atol=1e-9):
                rest = rest._replace(normal=other.normal)
            elif rest.displacement(other.nodes) < (
                needed := rest.reach(scene.clearance) + other.reach(scene.clearance)
            ):
                raise SceneError(
                    f"start and goal rest on different sides of {scene.name_of(rest.obstacle)}, less than "
                    f"{needed:.3g} m from each other",
                    file=scene.path,
                    key=scene.words.key(f"obstacles[{rest.obstacle}].support"),
                    way_out=f"move the goal {needed:.3g} m further from the start",
                )
        kept.append(rest)
    return tuple(kept)


def _written(scene: Supported, vector: Array) -> str:
    """Return a vector as in scene files, rounded away from 0."""
    found = [float(f"{x:.6g}") for x in np.where(np.abs(vector) < 1e-9, 0.0, vector)[: scene.n_dims]]
    return f"[{', '.join(f'{x:g}' for x in found)}]"
