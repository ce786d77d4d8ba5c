"""The scene: what moves, what it carries, what stands in the way, and what must hold."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from math import hypot
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.demonstrations import Demonstration
from comove.errors import ComoveWarning, SceneError
from comove.scenes import distances as sd
from comove.scenes.groups import (
    RigidGroup,
    fit_pose,
    nearest_distances,
    orientation_of,
    rotation_in_plane,
    rotation_of_quaternion,
)
from comove.scenes.model import DISTANCE_TOLERANCE, SceneFile, canonical, load_scene_file, parse_scene
from comove.scenes.taught import read_demonstration

Array = NDArray[np.float64]

LOADS = ("bar", "frame", "polygon")
FAR = 1e6  # m, how far a planar scene's boxes reach along z


@dataclass(frozen=True)
class DistanceConstraint:
    """``| |y_first - y_second| - distance | <= tolerance`` at every instant, [m]."""

    first: int
    second: int
    distance: float
    tolerance: float


@dataclass(frozen=True)
class Body:
    """What must not touch anything: segments between nodes, thickened.

    Nodes are the hands in the order of the manipulators, then the corners of the load.

    Attributes
    ----------
    edges : array of int, shape (n_edges, 2), nodes; equal ends make a point
    radii : array, shape (n_edges,), [m]
    n_nodes : int
    filled : bool, the edges are the border of a filled polygon
    """

    edges: NDArray[np.int64]
    radii: Array
    n_nodes: int
    filled: bool = False


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene ready to be solved; build it by `Scene.load` or `Scene.from_dict`.

    Attributes
    ----------
    file : the parsed scene file
    folder : to which its paths are relative
    path : of the scene file, None where the scene was built in memory
    start, goal : arrays, shape (n_manipulators, n_dims), [m], moved onto the constraints where the file
        missed them by no more than their tolerance
    lower, upper : arrays, shape (n_dims,), workspace [m]
    groups : rigid groups in the order of their first member; every manipulator is in one
    constraints : distance constraints, those that the load implies included
    body : what must not touch anything
    obstacles : array, shape (n_obstacles, distances.N_COLUMNS), the table that kernels take
    """

    file: SceneFile
    folder: Path
    path: Path | None
    start: Array
    goal: Array
    lower: Array
    upper: Array
    groups: tuple[RigidGroup, ...]
    constraints: tuple[DistanceConstraint, ...]
    body: Body
    obstacles: Array

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Read a scene file (YAML).

        Raises
        ------
        SceneError
            If the file cannot be read, breaks the contract or contradicts itself.
        """
        path = Path(path)
        return _build(load_scene_file(path), path.parent, path)

    @classmethod
    def from_dict(cls, data: dict[str, Any], *, folder: str | Path | None = None) -> Scene:
        """Build a scene from the contents of a scene file; paths are relative to `folder`.

        Raises
        ------
        SceneError
            As `load`.
        """
        folder = None if folder is None else Path(folder)
        return _build(parse_scene(data, folder=folder), folder or Path(), None)

    @property
    def name(self) -> str:
        """Name of the scene."""
        return self.file.name

    @property
    def duration(self) -> float:
        """Duration of the movement [s]."""
        return self.file.duration

    @property
    def n_dims(self) -> int:
        """2 in the plane, 3 in space."""
        return len(self.lower)

    @property
    def manipulators(self) -> tuple[str, ...]:
        """Names of the manipulators."""
        return tuple(m.name for m in self.file.manipulators)

    @property
    def clearance(self) -> float:
        """Distance that the body must keep from everything [m]."""
        return self.file.limits.clearance

    @property
    def speed_limit(self) -> float:
        """Speed limit of every manipulator [m/s], infinite where there is none."""
        return np.inf if self.file.limits.speed is None else self.file.limits.speed

    @property
    def acceleration_limit(self) -> float:
        """Acceleration limit of every manipulator [m/s^2], infinite where there is none."""
        return np.inf if self.file.limits.acceleration is None else self.file.limits.acceleration

    @cached_property
    def demonstration(self) -> Demonstration | None:
        """The recording that the scene names, None where it names none.

        Raises
        ------
        SceneError
            If it cannot be read or has another dimension.
        """
        if self.file.demonstration is None:
            return None
        return read_demonstration(self.file.demonstration, self.folder, self.n_dims, self.path)

    @cached_property
    def sha256(self) -> str:
        """Checksum of the canonical parsed scene: comments, layout and order of keys do not matter."""
        return hashlib.sha256(canonical(self.file)).hexdigest()

    @cached_property
    def workspace(self) -> tuple[Array, Array]:
        """Workspace as the kernels take it: two arrays, shape (3,), endless along the missing axis."""
        return _spatial(self.lower, -FAR), _spatial(self.upper, FAR)

    def clearance_at(self, nodes: Array) -> tuple[float, str]:
        """Clearance [m] of one configuration and the name of what is nearest.

        Parameters
        ----------
        nodes : array, shape (n_nodes, 3), [m]
        """
        clearance, nearest = sd.configuration_distance(
            nodes, self.body.edges, self.body.radii, self.obstacles, *self.workspace
        )
        if self.body.filled:
            for j in np.flatnonzero(_inside_polygon(nodes[self.body.edges[:, 0]], self.obstacles[:, 1:4])):
                clearance, nearest = min(clearance, -float(self.obstacles[j, sd.REACH])), int(j)
        if nearest < 0:
            return clearance, "the border of the workspace"
        return clearance, f"obstacles[{nearest}] ({self.file.obstacles[nearest].shape})"

    def nodes_at(self, end: str) -> Array:
        """Nodes at the "start" or the "goal", array of shape (n_nodes, 3), [m]."""
        nodes = np.zeros((self.body.n_nodes, 3))
        corner = len(self.manipulators)
        for group in self.groups:
            points = (group.start if end == "start" else group.goal).place(group.points)
            nodes[list(group.members)] = points[: len(group.members)]
            count = len(group.corners)
            nodes[corner : corner + count] = points[len(group.members) :]
            corner += count
        return nodes


def _build(file: SceneFile, folder: Path, path: Path | None) -> Scene:
    if file.load is not None and file.load.shape not in LOADS:
        raise SceneError(
            f"loads of shape '{file.load.shape}' are not supported",
            file=path,
            key="load.shape",
            way_out=f"use one of {', '.join(LOADS)}, a polygon in the plane only",
        )
    names = [m.name for m in file.manipulators]
    start = _spatial(np.array([m.start for m in file.manipulators]))
    goal = _spatial(np.array([m.goal for m in file.manipulators]))
    n_dims = len(file.workspace.lower)
    explicit = tuple(_explicit(c, names) for c in file.constraints)
    rigid = _rigid_sets(file, names, explicit, path)
    groups, implied = [], []
    for members in rigid:
        group, pairs = _group(file, members, explicit, start, goal, n_dims, path)
        groups.append(group)
        implied += pairs
    scene = Scene(
        file=file,
        folder=folder,
        path=path,
        start=np.array(start[:, :n_dims]),
        goal=np.array(goal[:, :n_dims]),
        lower=np.array(file.workspace.lower, dtype=float),
        upper=np.array(file.workspace.upper, dtype=float),
        groups=tuple(groups),
        constraints=explicit + tuple(implied),
        body=_body(file, names, groups),
        obstacles=_obstacle_table(file, n_dims),
    )
    moved = {end: scene.nodes_at(end)[: len(names), :n_dims] for end in ("start", "goal")}
    for end, given in (("start", scene.start), ("goal", scene.goal)):
        _say_shift(end, given, moved[end], names)
    scene = replace(scene, **moved)
    _require_free_ends(scene, path)
    return scene


def _explicit(constraint: Any, names: list[str]) -> DistanceConstraint:
    first, second = (names.index(name) for name in constraint.between)
    tolerance = constraint.tolerance
    if tolerance is None:
        tolerance = DISTANCE_TOLERANCE * constraint.distance
    return DistanceConstraint(first, second, constraint.distance, tolerance)


def _rigid_sets(
    file: SceneFile, names: list[str], explicit: tuple[DistanceConstraint, ...], path: object
) -> list[tuple[int, ...]]:
    """Sets of manipulators that move as one body: holders of the load, and complete graphs of distances."""
    holders: set[int] = set()
    if file.load is not None:
        holders = {names.index(name) for name in (file.load.held_by or names)}
    pairs = {frozenset((c.first, c.second)) for c in explicit}
    pairs |= {frozenset(pair) for pair in combinations(sorted(holders), 2)}
    component = list(range(len(names)))
    for a, b in map(tuple, pairs):
        old, new = component[a], component[b]
        component = [new if c == old else c for c in component]
    sets = []
    for root in dict.fromkeys(component):
        members = tuple(i for i, c in enumerate(component) if c == root)
        missing = [p for p in combinations(members, 2) if frozenset(p) not in pairs]
        if missing:
            a, b = (names[i] for i in missing[0])
            raise SceneError(
                f"the distances tie {', '.join(names[i] for i in members)} together but leave '{a}' and '{b}' "
                "free to move against each other",
                file=path,
                key="constraints",
                way_out="give the distance of every pair of the group, or leave out the ones in between",
            )
        sets.append(members)
    return sets


def _group(
    file: SceneFile,
    members: tuple[int, ...],
    explicit: tuple[DistanceConstraint, ...],
    start: Array,
    goal: Array,
    n_dims: int,
    path: object,
) -> tuple[RigidGroup, list[DistanceConstraint]]:
    """The rigid group of `members` and the distance constraints that the file leaves unsaid."""
    names = [m.name for m in file.manipulators]
    load = file.load
    holds = load is not None and set(load.held_by or names) == {names[i] for i in members}
    at_start, at_goal = start[list(members)], goal[list(members)]
    stated = {frozenset((c.first, c.second)): c for c in explicit}
    grasps, corners = _load_shape(file, members) if holds else (None, np.zeros((0, 3)))
    if grasps is None:
        grasps = _grasps_from_start(members, at_start, stated, n_dims, file, path)
    orientation = orientation_of(grasps, n_dims)
    implied = []
    for (a, i), (b, j) in combinations(enumerate(members), 2):
        distance = float(np.linalg.norm(grasps[a] - grasps[b]))
        constraint = stated.get(frozenset((i, j)))
        if constraint is None:
            constraint = DistanceConstraint(i, j, distance, DISTANCE_TOLERANCE * distance)
            implied.append(constraint)
        elif abs(constraint.distance - distance) > constraint.tolerance + 1e-12:
            raise SceneError(
                f"'{names[i]}' and '{names[j]}' hold the load {distance:g} m apart, but their distance "
                f"constraint says {constraint.distance:g} m",
                file=path,
                key="constraints",
                way_out="make them agree",
            )
        for end, hands in (("start", at_start), ("goal", at_goal)):
            actual = float(np.linalg.norm(hands[a] - hands[b]))
            if abs(actual - distance) > constraint.tolerance + 1e-12:
                raise SceneError(
                    f"'{names[i]}' and '{names[j]}' are {actual:g} m apart at the {end}, but they must be "
                    f"{distance:g} m apart (tolerance {constraint.tolerance:g} m)",
                    file=path,
                    key=f"manipulators[{i}].{end}, manipulators[{j}].{end}",
                    way_out="move one of them or correct the distance",
                )
    poses = [fit_pose(grasps, hands, orientation) for hands in (at_start, at_goal)]
    slack = max(
        [c.tolerance for c in (*stated.values(), *implied) if c.first in members and c.second in members],
        default=0.0,
    )
    for end, pose, hands in zip(("start", "goal"), poses, (at_start, at_goal), strict=True):
        miss = float(np.abs(pose.place(grasps) - hands).max())
        mirrored = grasps * ([1, -1, 1] if n_dims == 2 else [1, 1, -1])
        miss_mirrored = float(np.abs(fit_pose(mirrored, hands, orientation).place(mirrored) - hands).max())
        if miss > slack + 1e-12 and miss_mirrored < miss / 2:  # all distances agree and no rotation fits
            raise SceneError(
                f"the hands at the {end} are the mirror image of the load's grasps",
                file=path,
                key="manipulators",
                way_out=f"swap two of them at the {end}",
            )
    return RigidGroup(members, grasps, corners, orientation, *poses), implied


def _load_shape(file: SceneFile, members: tuple[int, ...]) -> tuple[Array | None, Array]:
    """Grasps and corners of the load in its own frame; grasps None where the hands at the start tell."""
    load, names = file.load, [m.name for m in file.manipulators]
    if load.shape == "bar":
        half, first = load.length / 2, names.index((load.held_by or names)[0])
        ends = np.array([[-half if i == first else half, 0.0, 0.0] for i in members])
        beyond = [half + load.overhang] if load.overhang else []
        return ends, np.array([[side * x, 0.0, 0.0] for x in beyond for side in (-1, 1)]).reshape(-1, 3)
    grasps = None
    if getattr(load, "grasps", None):
        grasps = _spatial(np.array([load.grasps[names[i]] for i in members], dtype=float))
    corners = _spatial(np.array(load.vertices, dtype=float)) if load.shape == "polygon" else np.zeros((0, 3))
    return grasps, corners


def _grasps_from_start(
    members: tuple[int, ...],
    hands: Array,
    stated: dict[frozenset[int], DistanceConstraint],
    n_dims: int,
    file: SceneFile,
    path: object,
) -> Array:
    """Grasps about their middle, from the start moved onto the stated distances; on x if they are in line."""
    pairs = [pair for pair in combinations(range(len(members)), 2) if _of(stated, members, pair)]
    for a, b in combinations(range(len(members)), 2):
        if np.linalg.norm(hands[a] - hands[b]) < 1e-9:
            both = [file.manipulators[members[i]].name for i in (a, b)]
            raise SceneError(
                f"'{both[0]}' and '{both[1]}' start at the same point",
                file=path,
                key=f"manipulators[{members[b]}].start",
                way_out="move them apart",
            )
    if pairs:
        wanted = np.array([_of(stated, members, pair).distance for pair in pairs])
        off = [abs(np.linalg.norm(hands[a] - hands[b]) - w) for (a, b), w in zip(pairs, wanted, strict=True)]
        if all(o <= _of(stated, members, p).tolerance for o, p in zip(off, pairs, strict=True)):
            hands = nearest_distances(hands, pairs, wanted)
        elif len(members) == 2:  # told by the caller, with both values
            return np.array([[-wanted[0] / 2, 0, 0], [wanted[0] / 2, 0, 0]])
    grasps = hands - hands.mean(axis=0)
    if n_dims == 3 and orientation_of(grasps, 3) == "axis":
        line = grasps[-1] - grasps[0]
        grasps = np.outer(grasps @ line / np.linalg.norm(line), [1.0, 0.0, 0.0])
    return grasps


def _of(
    stated: dict[frozenset[int], DistanceConstraint], members: tuple[int, ...], pair: tuple[int, int]
) -> DistanceConstraint | None:
    return stated.get(frozenset(members[i] for i in pair))


def _body(file: SceneFile, names: list[str], groups: list[RigidGroup]) -> Body:
    """Edges of the load between nodes, and every hand that is not the end of one as a point."""
    load, edges, radius = file.load, [], 0.0
    n_corners = sum(len(g.corners) for g in groups)
    corners = list(range(len(names), len(names) + n_corners))
    if load is not None:
        radius = load.radius
        if load.shape == "bar":
            holders = [names.index(name) for name in (load.held_by or names)]
            edges = [tuple(corners or holders)]
        elif load.shape == "frame":
            edges = [(names.index(a), names.index(b)) for a, b in load.edges]
        else:
            edges = list(zip(corners, corners[1:] + corners[:1], strict=True))
    touched = {node for edge in edges for node in edge}
    points = [(i, i) for i in range(len(names)) if i not in touched]
    return Body(
        edges=np.array(edges + points, dtype=np.int64).reshape(-1, 2),
        radii=np.array([radius] * len(edges) + [0.0] * len(points)),
        n_nodes=len(names) + n_corners,
        filled=load is not None and load.shape == "polygon",
    )


def _obstacle_table(file: SceneFile, n_dims: int) -> Array:
    """One row an obstacle, as `comove.scenes.distances` describes."""
    table = np.zeros((len(file.obstacles), sd.N_COLUMNS))
    for row, obstacle in zip(table, file.obstacles, strict=True):
        kind, size, reach = _SHAPES[obstacle.shape](obstacle)
        if n_dims == 2:
            rotation = rotation_in_plane(np.deg2rad(getattr(obstacle, "rotation_deg", 0.0)))
            if kind == sd.CAPSULE:  # the kernel's capsule lies along z, the planar one along x
                rotation = rotation @ np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
            if len(size) == 2 and kind in (sd.BOX, sd.ELLIPSOID):
                size = (*size, FAR if kind == sd.BOX else max(size))
        else:
            rotation = rotation_of_quaternion(np.array(getattr(obstacle, "quaternion_wxyz", (1.0, 0, 0, 0))))
        row[sd.KIND], row[sd.REACH] = kind, reach
        row[sd.CENTER : sd.CENTER + 3] = _spatial(np.array(obstacle.center))
        row[sd.ROTATION : sd.ROTATION + 9] = rotation.ravel()
        row[sd.SIZE : sd.SIZE + len(size)] = size
    return table


# Kind, size and reach of an obstacle of each shape.
_SHAPES: dict[str, Callable[[Any], tuple[int, tuple[float, ...], float]]] = {
    "box": lambda o: (sd.BOX, tuple(x / 2 for x in o.size), hypot(*o.size) / 2),
    "sphere": lambda o: (sd.SPHERE, (o.radius,), o.radius),
    "capsule": lambda o: (sd.CAPSULE, (o.radius, o.length / 2), o.radius + o.length / 2),
    "cylinder": lambda o: (sd.CYLINDER, (o.radius, o.height / 2), hypot(o.radius, o.height / 2)),
    "ellipsoid": lambda o: (sd.ELLIPSOID, tuple(o.radii), max(o.radii)),
}


def _say_shift(end: str, given: Array, moved: Array, names: list[str]) -> None:
    shift = np.linalg.norm(moved - given, axis=1)
    worst = int(shift.argmax())
    if shift[worst] > 1e-12:
        warnings.warn(
            f"the {end} was moved onto the constraints, '{names[worst]}' most, by {shift[worst]:.3g} m",
            ComoveWarning,
            stacklevel=4,
        )


def _require_free_ends(scene: Scene, path: object) -> None:
    for end in ("start", "goal"):
        clearance, nearest = scene.clearance_at(scene.nodes_at(end))
        if clearance < scene.clearance:
            need = f"; {scene.clearance:g} m of clearance are asked for" if scene.clearance else ""
            where = f"reaches {-clearance:.3g} m into" if clearance < 0 else f"is {clearance:.3g} m from"
            where = "touches" if abs(clearance) < 1e-9 else where
            outside = " (it leaves the workspace)" if clearance < 0 and "border" in nearest else ""
            raise SceneError(
                f"at the {end} the load or a hand {where} {nearest}{outside}{need}",
                file=path,
                key=f"manipulators.{end}",
                way_out=f"move the {end} or the obstacle",
            )


def _inside_polygon(vertices: Array, points: Array) -> NDArray[np.bool_]:
    """Which of `points` lie inside the polygon; both arrays of shape (n, 3), the plane is xy."""
    a, b = vertices, np.roll(vertices, -1, axis=0)
    x, y = points[:, None, 0], points[:, None, 1]
    crosses = (a[:, 1] > y) != (b[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    return (crosses & (x < at)).sum(axis=1) % 2 == 1


def _spatial(vectors: Array, fill: float = 0.0) -> Array:
    """Append `fill` as third coordinate to planar vectors."""
    if vectors.shape[-1] == 3:
        return np.array(vectors, dtype=float)
    return np.concatenate([vectors, np.full((*vectors.shape[:-1], 1), fill)], axis=-1)
