"""The scene: manipulators, their payload, obstacles and constraints."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, TypeVarTuple

import numpy as np
from numpy.typing import NDArray

import comove
from comove.arrays import Array, Integers, first_largest
from comove.brief import brief
from comove.errors import ComoveWarning, SceneError
from comove.geometry import distances as sd
from comove.geometry.rotations import exponential, matrices, quaternion_product
from comove.geometry.solids import solids_clearance
from comove.geometry.surfaces import Surfaces, signed_distance, surfaces_of
from comove.io.folders import scene_folder
from comove.io.keys import Wrong, scaled
from comove.model.constraints import (
    Constraint,
    DistanceConstraint,
    Hands,
    PlaneConstraint,
    SeparationConstraint,
    UprightConstraint,
    UprightKeys,
)
from comove.model.files.keys import (
    DEFAULT_LIMITS,
    GraspChoice,
    GraspOption,
    GraspPart,
    PartsLoad,
    PayloadPose,
    SceneFile,
    canonical,
)
from comove.model.files.reading import parsed, read_scene_file
from comove.model.files.words import VERSION_1, Words
from comove.model.grasp import (
    Grasp,
    alternatives,
    angle_to,
    chosen,
    far_grasps,
    grasp_of,
    told_far,
    turned_goal,
)
from comove.model.groups import GroupPose, RigidGroup, connected
from comove.model.moving import FASTEST, Displacements, ObstacleMotion, rotations, seen_from
from comove.model.resting import TOLERANCE, Rest, provable, recessions, rests_of
from comove.model.rigid import ENDS, HEADING, LoadBodies
from comove.model.shapes import (
    FAR,
    LOAD,
    MovingBody,
    body_of,
    in_space,
    inside_polygon,
    obstacle_table,
    parts_of,
    placed,
    read_meshes,
    spatial,
)

if TYPE_CHECKING:
    from comove.geometry.convex_decomposition import ConvexDecomposition


_T = TypeVar("_T")
_Ts = TypeVarTuple("_Ts")
N_DERIVED = 32
"""Results of functions of a scene's geometry that are kept."""
TURNS = tuple(
    np.deg2rad([0.0, *(sign * angle for angle in range(5, 180, 5) for sign in (1, -1)), 180.0]).tolist()
)
"""Turns of a free goal among which one has to be clear, the smallest first [rad]."""
PROVABLE = 1e-4  # m, that hands of different groups keep at the ends beyond their separation
GEOMETRY = (
    *("_nodes", "nodes_of_groups", "start", "goal", "manipulators", "lower", "upper", "workspace"),
    *("moving", "turning", "spins", "centers", "first_rows", "convex_rows", "reaches", "obstacle_speeds"),
)
"""Cached values of a scene that depend on neither its duration nor its limits."""
HUGE = 20.0  # size of what moves in workspaces, from which on it is probably written in millimetres
TOLD_SHIFT = 1e-9  # m: ends written with ten digits are as exact as they are judged


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene that is ready to be solved. Build it by `Scene.load` or `Scene.from_dict`.

    Attributes
    ----------
    file : the parsed scene file
    folder : the folder to which the file's paths are relative
    path : path of the scene file, None where the scene was built in memory
    groups : rigid groups in the order of their first member; every manipulator is in one
    constraints : constraints that must hold at every instant, with the distances that payload and relative poses
        imply
    body : the geometry of payload and end effectors that must keep clear of obstacles
    obstacles : array, shape (n_rows, n_columns), the table for kernels, for search and avoidance: one row for
        each obstacle; of a mesh, one row for each polytope that contains a part of it
    owners : array of int, shape (n_rows,), number in the file of the obstacle to which a row belongs
    grasp : orientations of the end effectors that hold the payload, None where the file has none
    motions : motions of the obstacles, None for static ones
    begins : time on the clock of these motions at which the movement begins [s]
    surfaces : triangles of the obstacles that are meshes, for certified distances
    excess : upper bounds of the over-approximation error of a mesh's polytopes [m], by the obstacle's number, or
        "load"
    meshes : checksums of the meshes' files
    words : names and lines of keys in the scene's file
    """

    __repr__ = brief

    file: SceneFile
    folder: Path
    path: Path | None
    groups: tuple[RigidGroup, ...]
    constraints: tuple[Constraint, ...]
    body: MovingBody
    obstacles: Array
    owners: Integers
    grasp: Grasp | None = None
    motions: tuple[ObstacleMotion | None, ...] = ()
    begins: float = 0.0
    surfaces: Surfaces = field(default_factory=lambda: surfaces_of([]))
    excess: dict[int | str, float] = field(default_factory=dict)
    meshes: tuple[str, ...] = ()
    words: Words = VERSION_1

    @classmethod
    def load(
        cls, path: str | Path, changes: Mapping[str, Any] | None = None, *, check_ends: bool = True
    ) -> Scene:
        """Read a scene file (YAML).

        Parameters
        ----------
        changes
            Values that replace those of the file, such as ``{"duration": 3.0, "limits": {"jerk": 5.0}}``.
        check_ends
            Whether to check that start and goal are free of contact, by kernels that may have to be compiled; else
            `require_free_ends` does it later.

        Raises
        ------
        SceneError
            If the file cannot be read, breaks the contract or contradicts itself.
        """
        path = Path(path)
        file, words = read_scene_file(path, changes)
        scene = _worded(file, words, scene_folder(path), path)
        return scene.require_free_ends() if check_ends else scene

    @classmethod
    def from_dict(
        cls, data: dict[str, Any], *, folder: str | Path | None = None, check_ends: bool = True
    ) -> Scene:
        """Build a scene from a scene file's contents. Paths are relative to `folder`.

        Raises
        ------
        SceneError
            As `load`.
        """
        folder = None if folder is None else Path(folder)
        scene = _worded(*parsed(data, folder=folder), folder or Path(), None)
        return scene.require_free_ends() if check_ends else scene

    def require_free_ends(self) -> Scene:
        """Return the scene itself if start and goal are collision-free.

        Of the choices of grasps and goal that a scene leaves open, one is enough.

        Raises
        ------
        SceneError
            If there is contact, or less than the scene's clearance, except on supports.

        Warns
        -----
        ComoveWarning
            Names the supports that neither start nor goal is near.
        """
        if self.file.choices is not None:
            self.in_one_way()
            return self
        for end in ENDS:
            # What moves may have left the goal, or not come there yet, when the load does.
            there = [i for i in range(len(self.file.obstacles)) if end == "start" or not self.moving[i]]
            clearance, obstacle = self.nearest_at(self.nodes_at(end), 0.0, there)
            nearest = self.name_of(obstacle)
            rounding = provable(self)
            if clearance < self.clearance + rounding:  # nothing could be proved of a motion that begins there
                need = f"; {self.clearance:g} m of clearance are asked for" if self.clearance else ""
                where = (
                    f"reaches {-clearance:.3g} m into" if clearance < 0 else f"is only {clearance:.3g} m from"
                )
                where = "touches" if abs(clearance) < rounding else where
                outside = " (it leaves the workspace)" if clearance < 0 and "border" in nearest else ""
                way_out = f"move the {end}, or widen the workspace; what lies there, such as a table, is an obstacle"
                way_out += f"; workspace: {self._wide_enough()} holds both ends"
                size = float(np.ptp(self.nodes_at(end), axis=0).max())
                if size > HUGE * float((self.upper - self.lower).max()):
                    way_out = (
                        f"lengths are in metres, and what moves is {size:.4g} m wide, which looks like millimetres: "
                        f"write its sizes and {'the hands' if self.words.version == 1 else 'its grasps'} in metres"
                    )
                elif obstacle >= 0:
                    way_out = f"move the {end} or the obstacle"
                if obstacle >= 0 and clearance > -TOLERANCE and not self.moving[obstacle]:
                    support = self.words.support(obstacle, self.file.obstacles[obstacle].name or "")
                    way_out += f"; if the payload rests on it, write {support}"
                raise SceneError(
                    f"at the {end} {self.words.bodies} {where} {nearest}{outside}{need}",
                    file=self.path,
                    key=self.words.key(f"manipulators.{end}"),
                    way_out=way_out,
                )
        held = {rest.obstacle for rest in self.rests}
        idle = [i for i, obstacle in enumerate(self.file.obstacles) if obstacle.support and i not in held]
        if idle:
            warnings.warn(
                f"{', '.join(map(self.name_of, idle))} supports the payload at neither start nor goal: the key has "
                "no effect",
                ComoveWarning,
                stacklevel=3,
            )
        return self

    def _wide_enough(self) -> str:
        """Return a workspace that contains both ends, in words."""
        nodes = np.concatenate([self.nodes_at(end) for end in ENDS])[:, : self.n_dims]
        room = float(self.body.radii.max(initial=0.0)) + self.clearance + PROVABLE
        lower = np.minimum(self.lower, np.floor(1e3 * (nodes.min(axis=0) - room)) / 1e3)
        upper = np.maximum(self.upper, np.ceil(1e3 * (nodes.max(axis=0) + room)) / 1e3)
        return f"{{lower: {(lower + 0.0).round(6).tolist()}, upper: {(upper + 0.0).round(6).tolist()}}}"

    def resumed(self, time: float, duration: float, starts: tuple[GroupPose, ...], twists: Array) -> Scene:
        """Return the scene from a later instant on. It is the remainder of a movement that has begun.

        Parameters
        ----------
        time : that instant on this scene's clock [s]
        duration : duration of the remainder [s]
        starts : poses of the rigid groups at that instant
        twists : array, shape (n_groups, 6), twists of the groups: velocity of the centre [m/s], angular velocity
            [rad/s]
        """
        groups = tuple(
            replace(group, start=start, start_twist=twist * duration)
            for group, start, twist in zip(self.groups, starts, twists, strict=True)
        )
        later = self.timed(duration)._changed(choices=None)  # it is held in one way by now
        return replace(later, groups=groups, begins=self.begins + time)

    def standing(self) -> Scene:
        """Return the scene without moving obstacles."""
        kept = np.flatnonzero(~self.moving)
        rows = np.isin(self.owners, kept)
        table, owners = self.obstacles[rows].copy(), np.searchsorted(kept, self.owners[rows])
        obstacles = [self.file.obstacles[i] for i in kept.tolist()]
        stands = replace(
            self,
            obstacles=table,
            owners=owners,
            surfaces=self.surfaces.among(kept, rows),
            motions=(None,) * len(obstacles),
        )
        return stands._changed(obstacles=tuple(obstacles))

    def without_supports(self) -> Scene:
        """Return the scene without supports, so that no obstacle recedes."""
        obstacles = self.file.obstacles
        return self._changed(obstacles=tuple(one.model_copy(update={"support": None}) for one in obstacles))

    def scaled(self, factor: float) -> Scene:
        """Return the scene scaled by `factor`: lengths, speeds, accelerations and jerks.

        The demonstration is left out, as it has lengths of its own; weights of an objective are not changed.
        """
        data = scaled(self.file, factor) | {"demonstration": None}
        for manipulator, start, goal in zip(data["manipulators"], self.start, self.goal, strict=True):
            manipulator |= {"start": (factor * start).tolist(), "goal": (factor * goal).tolist()}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ComoveWarning)
            return Scene.from_dict(data, folder=self.folder, check_ends=not self.rests)

    def timed(self, duration: float | None) -> Scene:
        """Return the scene with another duration [s]; None leaves it open."""
        return self._changed(duration=duration)

    def limited(self, **limits: float | None) -> Scene:
        """Return the scene with other limits by key; None for none."""
        return self._changed(limits=self.file.limits.model_copy(update=limits))

    def with_limits(self, limits: Mapping[str, float] = DEFAULT_LIMITS) -> Scene:
        """Return the scene with limits where it has none, by key."""
        given = self.file.limits
        return self.limited(**{key: value for key, value in limits.items() if getattr(given, key) is None})

    @cached_property
    def alternatives(self) -> tuple[Scene, ...]:
        """Return the scenes of all grasps left open, or itself."""
        if self.file.choices is not None:
            return self._chosen
        parts = alternatives(self.file)
        if len(parts) < 2 and (self.file.grasp is None or parts[0] is self.file.grasp):
            return (self,)
        return tuple(self.held_as(part) for part in parts)

    @cached_property
    def far(self) -> Array:
        """Return ineffective grasps' distances from the payload; (n_ways, n_holders) [m]. See `far_grasps`."""
        return far_grasps(self.file, self.groups, self.body)

    @property
    def n_far(self) -> Integers:
        """Return each choice's number of ineffective grasps; shape (n_ways,)."""
        return np.count_nonzero(self.far, axis=1)

    @property
    def choices(self) -> tuple[GraspOption, ...]:
        """Return the file's choices, those with more effective grasps first."""
        given = self.file.choices or ()
        return tuple(given[k] for k in np.argsort(self.n_far[: len(given)], kind="stable"))

    @cached_property
    def _chosen(self) -> tuple[Scene, ...]:
        scenes, first = list[Scene](), None
        for choice in self.choices:
            try:
                scenes.append(self.put_down(choice))
            except SceneError as error:
                first = first or error
        if first is not None and not scenes:
            raise first
        return tuple(scenes)

    def put_down(self, choice: GraspOption, angle: float = 0.0) -> Scene:
        """Return the scene in one choice; a free goal is turned from the nearest one [rad].

        Raises
        ------
        SceneError
            If the scene contradicts itself with that choice.
        """
        number = next((k for k, own in enumerate(self.file.choices or ()) if own is choice), None)
        if (number, angle) in self._put_down:
            return self._put_down[number, angle]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ComoveWarning)
            scene = _worded(chosen(self.file, turned_goal(choice, angle)), self.words, self.folder, self.path)
        if number is not None:
            self._put_down[number, angle] = scene
        return scene

    @cached_property
    def _put_down(self) -> dict[tuple[int | None, float], Scene]:
        return {}

    def ways_to(self, goal: PayloadPose | None) -> tuple[Scene, ...]:
        """Return the alternatives, and choices with a free goal at `goal`."""
        found, there = [*self.alternatives], {"goal": goal, "free": None}
        for choice in self.file.choices or ():
            if goal is not None and choice.free is not None and angle_to(choice, goal) is not None:
                found.append(self.put_down(choice.model_copy(update=there)))
        return tuple(found)

    def held_as(self, part: GraspPart) -> Scene:
        """Return the scene with another grasp."""
        choice = GraspChoice(**{key: value for key, value in part if value is not None and key != "any_of"})
        other, groups = self._changed(grasp=choice), list(self.groups)
        return replace(other, grasp=grasp_of(other.file, groups))

    def held_as_in(self, other: Scene) -> Scene:
        """Return the alternative with another scene's grasp and goal."""
        file, goal = other.file, None if other.file.load is None else other.file.load.goal
        ways = self.ways_to(goal)
        return next((w for w in ways if (w.file.grasp, w.file.load) == (file.grasp, file.load)), self)

    def in_one_way(self) -> Scene:
        """Return the first alternative with free start and goal. A scene without choices returns itself.

        Raises
        ------
        SceneError
            If there is none.
        """
        if self.file.choices is None:
            return self
        first: SceneError | None = None
        for turn in TURNS:
            for choice in self.choices:
                if turn == 0.0 or choice.free is not None:
                    try:
                        return self.put_down(choice, turn).require_free_ends()
                    except SceneError as error:
                        first = first or error
        assert first is not None, "a scene with choices has alternatives"
        raise first

    def _changed(self, **keys: Any) -> Scene:
        other = replace(self, file=self.file.model_copy(update=keys))
        if keys.keys() <= {"duration", "limits"}:  # of which these values do not depend
            known = vars(self)
            vars(other).update(
                {name: known[name] for name in GEOMETRY if name in known}, derived=self.derived
            )
        return other

    def __getstate__(self) -> dict[str, Any]:
        """Return what is pickled: all but `derived`, which other processes derive themselves."""
        return {name: value for name, value in vars(self).items() if name != "derived"}

    @cached_property
    def derived(self) -> dict[tuple[Any, ...], Any]:
        """Return the latest results of functions `of_geometry` by function and arguments."""
        return {}

    @property
    def name(self) -> str:
        """Return the name of the scene."""
        return self.file.name

    @property
    def duration(self) -> float:
        """Return the duration of the movement [s].

        Raises
        ------
        SceneError
            If the scene leaves it out.
        """
        if self.file.duration is None:
            raise SceneError(
                "the scene leaves its duration out",
                file=self.path,
                key="duration",
                way_out="add one; comove solve finds the shortest, and says it",
            )
        return self.file.duration

    @property
    def is_timed(self) -> bool:
        """Return whether the scene gives the duration of the movement."""
        return self.file.duration is not None

    @property
    def n_dims(self) -> int:
        """Return 2 in the plane, 3 in space."""
        return self.file.dimension

    @cached_property
    def lower(self) -> Array:
        """Return the lower corner of the workspace; array, shape (n_dims,) [m]."""
        return np.array(self.file.workspace.lower, dtype=float)

    @cached_property
    def upper(self) -> Array:
        """Return the upper corner of the workspace; array, shape (n_dims,) [m]."""
        return np.array(self.file.workspace.upper, dtype=float)

    @cached_property
    def start(self) -> Array:
        """Return the end effectors at the start; array, shape (n_manipulators, n_dims) [m].

        They are moved onto the constraints where the file misses them by no more than their tolerance.
        """
        return self._hands_at("start")

    @cached_property
    def goal(self) -> Array:
        """Return the end effectors at the goal, as `start`."""
        return self._hands_at("goal")

    def _hands_at(self, end: str) -> Array:
        hands = np.zeros((len(self.file.manipulators), 3))
        for group in self.groups:
            pose = group.start if end == "start" else group.goal
            hands[list(group.members)] = pose.place(group.points)[: len(group.members)]
        return hands[:, : self.n_dims]

    @cached_property
    def manipulators(self) -> tuple[str, ...]:
        """Return the names of the manipulators."""
        return tuple(m.name for m in self.file.manipulators)

    @property
    def clearance(self) -> float:
        """Return the required distance of the body from obstacles [m]."""
        return self.file.limits.clearance or 0.0  # filled in when the file is read

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """Return which obstacles move; array of bool, shape (n_obstacles,)."""
        return np.array([motion is not None for motion in self.motions], dtype=bool)

    @cached_property
    def rests(self) -> tuple[Rest, ...]:
        """Return the resting contacts of the payload at start and goal.

        Raises
        ------
        SceneError
            If the payload is too deep in a support, or could not leave its supports.
        """
        return rests_of(self)

    @cached_property
    def centers(self) -> Array:
        """Return the centres of the obstacles at 0 s; array, shape (n_obstacles, 3) [m]."""
        return self.obstacles[self.first_rows, sd.CENTER : sd.CENTER + 3]

    @cached_property
    def first_rows(self) -> Integers:
        """Return the first row of every obstacle in the table; array, shape (n_obstacles,)."""
        return np.unique(self.owners, return_index=True)[1]

    @cached_property
    def convex_rows(self) -> NDArray[np.bool_]:
        """Return which table rows are obstacles, not polytopes of meshes."""
        return ~np.isin(self.owners, self.surfaces.owner)

    def by_row(self, of_obstacles: Array) -> Array:
        """Return values by row (n_times, n_rows, ...) from those by obstacle."""
        several = len(self.owners) > len(self.first_rows)
        return np.ascontiguousarray(of_obstacles[:, self.owners]) if several else of_obstacles

    def offsets(self, time: Array) -> Array:
        """Return the displacements of the obstacles' centres since 0 s. Array, shape (n_times, n_obstacles, 3) [m].

        Parameters
        ----------
        time : array, shape (n_times,) [s]
        """
        time = self.begins + time
        return self._of_motions(lambda motion: motion.offsets(time), (len(time), 3))

    def centers_at(self, time: Array) -> Array:
        """Return the positions of the obstacles' centres at times [s]. Array, shape (n_times, n_obstacles, 3) [m]."""
        return self.centers + self.offsets(time)

    def displacements(self, time: Array) -> Displacements:
        """Return the obstacles' displacements by table row, for kernels.

        Parameters
        ----------
        time : array, shape (n_times,) [s]
        """
        centers = self.obstacles[:, sd.CENTER : sd.CENTER + 3]
        offsets = self.by_row(self.offsets(time))
        if not self.turning.any():
            return Displacements.of(offsets, centers)
        rates = np.linalg.norm(self.spins, axis=1, keepdims=True)
        axes = np.where(rates > 0.0, self.spins / np.maximum(rates, 1e-300), [0.0, 0.0, 1.0])
        angles = (self.turns(time) * axes).sum(axis=2)
        return Displacements.of(offsets, centers, self.by_row(angles), axes[self.owners])

    def displacements_along(self, n_steps: int) -> Displacements:
        """Return displacements at even times, empty if no obstacle moves."""
        return _displacements_along(self, n_steps)

    def obstacle_velocities(self, time: Array) -> Array:
        """Return velocities of obstacle centres; array, shape (n_times, n_obstacles, 3) [m/s].

        Where a velocity jumps, it is the one after the jump.
        """
        time = self.begins + time
        return self._of_motions(lambda motion: motion.velocities(time), (len(time), 3))

    def obstacle_sagittas(self, time: Array) -> Array:
        """Return interpolation errors of the obstacles' centres between times.

        Array, shape (n_times - 1, n_obstacles) [m].
        """
        time = self.begins + time
        return self._of_motions(lambda motion: motion.sagittas(time), (len(time) - 1,))

    @cached_property
    def spins(self) -> Array:
        """Return the angular velocities of the obstacles; array, shape (n_obstacles, 3) [rad/s]."""
        return np.array([np.zeros(3) if motion is None else motion.spin for motion in self.motions]).reshape(
            -1, 3
        )

    @cached_property
    def turning(self) -> NDArray[np.bool_]:
        """Return which obstacles turn; array of bool, shape (n_obstacles,)."""
        return np.asarray(self.spins.any(axis=1))

    def turns(self, time: Array) -> Array:
        """Return the obstacles' rotation vectors since 0 s.

        Array, shape (n_times, n_obstacles, 3) [rad]; relative to the file, multiples of each obstacle's spin.
        """
        time = self.begins + time
        return self._of_motions(lambda motion: motion.turns(time), (len(time), 3))

    def orientations(self, time: Array) -> Array:
        """Return the obstacles' orientations; array, shape (n_times, n_obstacles, 4), w x y z."""
        first = np.array([in_space(obstacle) for obstacle in self.file.obstacles]).reshape(-1, 4)
        return quaternion_product(exponential(self.turns(time)), np.tile(first, (len(time), 1, 1)))

    @cached_property
    def reaches(self) -> Array:
        """Return radii about the centres that contain the obstacles; array, shape (n_obstacles,) [m]."""
        reaches = np.zeros(len(self.motions))
        np.maximum.at(reaches, self.owners, self.obstacles[:, sd.REACH])
        return reaches

    @cached_property
    def obstacle_speeds(self) -> Array:
        """Return bounds of the obstacles' speeds; array, shape (n_obstacles,) [m/s]."""
        centers = np.array([0.0 if motion is None else motion.speed for motion in self.motions])
        return centers + np.linalg.norm(self.spins, axis=1) * self.reaches

    @cached_property
    def obstacle_kinks(self) -> Array:
        """Return times [s] at which an obstacle's velocity may jump.

        Sorted array, shape (n_kinks,), of times during the movement.
        """
        kinks = {t - self.begins for motion in self.motions if motion is not None for t in motion.kinks}
        return np.array(sorted(t for t in kinks if 0.0 < t < self.duration))

    def _of_motions(self, of: Callable[[ObstacleMotion], Array], shape: tuple[int, ...]) -> Array:
        found = np.zeros((shape[0], len(self.motions), *shape[1:]))
        for i, motion in enumerate(self.motions):
            if motion is not None:
                found[:, i] = of(motion)
        return found

    def obstacles_at(self, time: float, centers: Array | None = None) -> Array:
        """Return the table of obstacles at an instant [s].

        Parameters
        ----------
        centers : array, shape (n_obstacles, 3), their centres, if not the scene's [m]
        """
        if not self.moving.any() and centers is None:
            return self.obstacles
        now = np.array([time])
        if centers is None:
            centers = self.centers_at(now)[0]
        turns = self.turns(now)[0] if self.turning.any() else np.zeros_like(centers)
        return _placed(self.obstacles, self.owners, centers, turns)

    @property
    def speed_limit(self) -> float:
        """Return the manipulators' speed limit [m/s], infinite if none."""
        return np.inf if self.file.limits.speed is None else self.file.limits.speed

    @property
    def acceleration_limit(self) -> float:
        """Return the manipulators' acceleration limit [m/s^2], infinite if none."""
        return np.inf if self.file.limits.acceleration is None else self.file.limits.acceleration

    @property
    def jerk_limit(self) -> float:
        """Return the manipulators' jerk limit [m/s^3], infinite if none."""
        return np.inf if self.file.limits.jerk is None else self.file.limits.jerk

    @property
    def is_limited(self) -> bool:
        """Return whether a limit of speed, acceleration or jerk is set."""
        return min(self.speed_limit, self.acceleration_limit, self.jerk_limit) < np.inf

    @property
    def load_mass(self) -> float | None:
        """Return the payload's mass [kg], None if not given."""
        return None if self.file.load is None else self.file.load.mass

    @property
    def turns_as_one(self) -> bool:
        """Return whether a single body that turns is all that moves."""
        return len(self.groups) == 1 and self.groups[0].orientation not in ("none", "fixed")

    @cached_property
    def sha256(self) -> str:
        """Return the checksum of the canonical parsed scene and its meshes.

        Comments, layout and order of keys do not matter.
        """
        return hashlib.sha256(canonical(self.file) + "".join(self.meshes).encode()).hexdigest()

    @cached_property
    def distances(self) -> tuple[DistanceConstraint, ...]:
        """Return the distance constraints."""
        return tuple(c for c in self.constraints if isinstance(c, DistanceConstraint))

    @cached_property
    def kept_apart(self) -> tuple[Integers, Array]:
        """Return pairs of end effectors to separate, and least distances.

        They are of different groups. Arrays, shapes (n, 2) and (n,) [m].
        """
        apart = [
            c
            for c in self.constraints
            if isinstance(c, SeparationConstraint) and not self.are_one_body(*c.hands)
        ]
        pairs = np.array([(c.first, c.second) for c in apart], dtype=np.int64).reshape(-1, 2)
        return pairs, np.array([c.least for c in apart])

    @cached_property
    def sampled(self) -> tuple[Constraint, ...]:
        """Return the constraints that a search has to sample."""
        return tuple(c for c in self.constraints if c.sampled)

    @property
    def ends(self) -> Array:
        """Return the end effectors at both ends; (2, n_manipulators, n_dims) [m]."""
        return np.stack([self.start, self.goal])

    def level_with(self, groups: tuple[RigidGroup, ...]) -> list[int]:
        """Return for every group the first one constrained to its height."""
        group_of = {hand: g for g, group in enumerate(groups) for hand in group.members}
        pairs = [pair for c in self.constraints for pair in c.level(self.ends)]
        return connected(len(groups), [(group_of[first], group_of[second]) for first, second in pairs])

    def are_one_body(self, first: int, second: int) -> bool:
        """Return whether two end effectors belong to one rigid group."""
        return any({first, second} <= set(group.members) for group in self.groups)

    @cached_property
    def workspace(self) -> tuple[Array, Array]:
        """Return the workspace for kernels: two arrays, shape (3,).

        A planar workspace is extended to `FAR` along z.
        """
        return spatial(self.lower, -FAR), spatial(self.upper, FAR)

    def clearance_at(self, nodes: Array, time: float = 0.0) -> tuple[float, str]:
        """Return a configuration's clearance [m] and the nearest obstacle's name.

        Supports recede from a resting payload; see `comove.model.resting`.

        Parameters
        ----------
        nodes : array, shape (n_nodes, 3), [m]
        time : the instant, which determines the positions of moving obstacles [s]
        """
        clearance, nearest = self.nearest_at(nodes, time)
        return clearance, self.name_of(nearest)

    def clearances(self, nodes: Array, time: Array) -> Array:
        """Return the clearances of many configurations [m]; array, shape (n_steps,).

        Parameters
        ----------
        nodes : array, shape (n_steps, n_nodes, 3), [m]
        time : array, shape (n_steps,), their instants [s]
        """
        states = zip(np.ascontiguousarray(nodes), time.tolist(), strict=True)
        return np.array([self.nearest_at(state, instant)[0] for state, instant in states])

    def nearest_at(
        self, nodes: Array, time: float = 0.0, among: Collection[int] | None = None
    ) -> tuple[float, int]:
        """Return a configuration's clearance [m] and the nearest obstacle.

        Only obstacles in `among` count, if given. The nearest is -1 where it is the border of the workspace. Supports
        recede as in `clearance_at`.
        """
        now = np.array([time])
        offsets = self.offsets(now)[0]
        if self.rests:
            offsets = offsets + recessions(self, nodes)
        return self._nearest(nodes, (offsets, self.turns(now)[0]), among, *self.workspace)

    def distance_from(self, obstacle: int, nodes: Array, offset: Array | float = 0.0) -> float:
        """Return a configuration's distance [m] from one displaced obstacle."""
        still = np.zeros((len(self.motions), 3))
        anywhere = np.full(3, -np.inf), np.full(3, np.inf)
        return self._nearest(nodes, (still + offset, still), [obstacle], *anywhere)[0]

    def _nearest(
        self,
        nodes: Array,
        displaced: tuple[Array, Array],
        among: Collection[int] | None,
        lower: Array,
        upper: Array,
    ) -> tuple[float, int]:
        """Return `nearest_at` for obstacles displaced by offsets [m] and turns [rad]."""
        body, own, (offsets, turns) = self.body, self.convex_rows, displaced
        rows = np.flatnonzero(own if among is None else own & np.isin(self.owners, list(among)))
        table = _placed(self.obstacles[rows], self.owners[rows], self.centers + offsets, turns)
        found = sd.configuration_distance(nodes, body.edges, body.radii, table, lower, upper)
        if len(body.solids):
            found = min(found, solids_clearance(nodes, body.solids, table, lower, upper))
        if body.filled:
            for j in np.flatnonzero(inside_polygon(nodes[body.border], table[:, 1:4])):
                found = min(found, (-float(table[j, sd.REACH]), int(j)))
        clearance, nearest = found[0], int(self.owners[rows][found[1]]) if found[1] >= 0 else -1
        hulls = [(edge, radius) for edge, radius in zip(body.edges, body.radii, strict=True)]
        hulls += [(solid, 0.0) for solid in body.solids]
        for mesh, obstacle in enumerate(self.surfaces.owner):
            if among is None or obstacle in among:
                seen = seen_from(nodes, self.centers[obstacle], offsets[obstacle], turns[obstacle])
                for own, radius in hulls:
                    points, cutoff = np.ascontiguousarray(seen[own]), clearance + radius
                    distance = signed_distance(self.surfaces, mesh, points, cutoff) - radius
                    if distance < clearance:
                        clearance, nearest = distance, int(obstacle)
        return clearance, nearest

    def show(self) -> None:
        """Show the scene in a notebook or browser; see `comove.show`."""
        comove.show(self)

    def _repr_html_(self) -> str:
        return comove.as_html(self)

    def owner_of(self, row: int) -> int:
        """Return the obstacle of a table row; keep negative numbers."""
        return int(self.owners[row]) if row >= 0 else int(row)

    def name_of(self, obstacle: int) -> str:
        """Return a description of an obstacle.

        -1 is the border of the workspace; numbers beyond the file's are tracked objects.
        """
        if obstacle < 0:
            return "the border of the workspace"
        if obstacle >= len(self.file.obstacles):
            return "something that was seen"
        found = self.file.obstacles[obstacle]
        return f"{found.name or f'obstacles[{obstacle}]'} ({found.shape})"

    def time_at(self, end: str) -> float:
        """Return the instant of the "start" or the "goal" [s]."""
        return 0.0 if end == "start" else self.duration

    def nodes_at(self, end: str) -> Array:
        """Return the nodes at an end, shape (n_nodes, 3), [m]."""
        return self._nodes[0 if end == "start" else 1].copy()

    @cached_property
    def _nodes(self) -> Array:
        nodes = np.zeros((2, self.body.n_nodes, 3))
        for group, own in zip(self.groups, self.nodes_of_groups, strict=True):
            for k, pose in enumerate((group.start, group.goal)):
                nodes[k, own] = pose.place(group.points)
        return nodes

    @cached_property
    def nodes_of_groups(self) -> tuple[list[int], ...]:
        """Return the nodes of every rigid group: members, then corners."""
        found, corner = [], len(self.manipulators)
        for group in self.groups:
            found.append([*group.members, *range(corner, corner + len(group.corners))])
            corner += len(group.corners)
        return tuple(found)


def of_geometry(function: Callable[[Scene, *_Ts], _T]) -> Callable[[Scene, *_Ts], _T]:
    """Decorate a function of a scene without its duration and limits.

    Its results are kept for such copies of the scene, and not to be changed. Further arguments are hashable.
    """

    @wraps(function)
    def kept(scene: Scene, *args: *_Ts) -> _T:
        key, known = (function, *args), scene.derived
        try:
            return known[key]
        except KeyError:
            found = function(scene, *args)
        for one in list(known)[: max(0, len(known) + 1 - N_DERIVED)]:  # the oldest, so that robots are freed
            known.pop(one, None)
        known[key] = found
        return found

    return kept


def _placed(table: Array, owners: Integers, centers: Array, turns: Array) -> Array:
    """Return table rows at other centres [m] and turns [rad]. Arrays by obstacle have shape (n_obstacles, 3)."""
    table, own = table.copy(), np.flatnonzero(turns[owners].any(axis=1))
    table[:, sd.CENTER : sd.CENTER + 3] = centers[owners]
    if not len(own):  # in most steps of executions
        return table
    axes = table[own, sd.ROTATION : sd.ROTATION + 9].reshape(-1, 3, 3)
    table[own, sd.ROTATION : sd.ROTATION + 9] = (rotations(turns[owners[own]]) @ axes).reshape(-1, 9)
    return table


@lru_cache(maxsize=8)  # a search asks for them in every generation
def _displacements_along(scene: Scene, n_steps: int) -> Displacements:
    n_samples = n_steps if scene.moving.any() else 0
    return scene.displacements(np.linspace(0.0, scene.duration, n_samples))


def _worded(file: SceneFile, words: Words, folder: Path, path: Path | None) -> Scene:
    """Build a scene; name keys in errors as the file does."""
    try:
        return _build(file, folder, path, words)
    except SceneError as error:
        if error.key is not None:
            error.key = words.key(error.key)
        raise


def _build(file: SceneFile, folder: Path, path: Path | None, words: Words) -> Scene:
    meshes = read_meshes(file, folder, path, words)
    held = {
        whose: mesh.decomposed(part.resolution, few=whose == LOAD) for whose, (mesh, part) in meshes.items()
    }
    given = np.array([[m.start for m in file.manipulators], [m.goal for m in file.manipulators]], dtype=float)
    explicit = _resolved(file, spatial(given[0]), path)
    start, goal = spatial(given)
    bodies = LoadBodies(file, explicit, start, goal, path, held.get(LOAD))
    rigid = bodies.sets()
    bodies, groups, implied = bodies.levelled(rigid), [], []
    for members in rigid:
        group, pairs = bodies.group(members)
        groups.append(group)
        implied += pairs
    table, owners = obstacle_table(file, held)
    scene = Scene(
        file=file,
        folder=folder,
        path=path,
        groups=tuple(groups),
        constraints=explicit + tuple(implied),
        body=body_of(file, groups, held.get(LOAD)),
        obstacles=table,
        owners=owners,
        grasp=grasp_of(file, groups),
        motions=tuple(obstacle.motion for obstacle in file.obstacles),
        surfaces=surfaces_of(placed(meshes, owners)),
        excess=_excess(file, held),
        meshes=tuple(mesh.sha256 for mesh, _ in meshes.values()),
        words=words,
    )
    _require_slow_tips(scene)
    for end, before, after in zip(ENDS, given, scene.ends, strict=True):
        _say_shift(end, before, after, scene.manipulators)
    _require_heading(scene, path)
    _warn_of_far_grasps(scene)
    _require_kept_ends(scene, path)
    return scene


def _warn_of_far_grasps(scene: Scene) -> None:
    """Warn of every ineffective grasp."""
    file, place, told = scene.file, "" if scene.path is None else f"{scene.path}: ", dict[str, str]()
    for name, way in np.argwhere(scene.far.T > 0.0).tolist():
        who = file.holders[name]
        at = file.choices[way].grasps[who] if file.choices else None
        told.setdefault(f"{scene.words.grasp(who, at)}: {told_far(who, scene.far[way, name], file)}", who)
    for message in told:
        warnings.warn(f"{place}{message}", ComoveWarning, stacklevel=4)


def _excess(file: SceneFile, held: Mapping[int | str, ConvexDecomposition]) -> dict[int | str, float]:
    found = {whose: decomposition.excess for whose, decomposition in held.items()}
    if isinstance(file.load, PartsLoad) and (excess := parts_of(file.load).excess):
        found[LOAD] = excess
    return found


def _resolved(file: SceneFile, start: Array, path: object) -> tuple[Constraint, ...]:
    """Return the file's constraints with numbers and SI units."""
    pose = None if file.load is None else file.load.start
    turned = None if pose is None else matrices(np.array(pose.quaternion_wxyz))
    hands = Hands(file.names, file.holder_numbers, start, turned, file.dimension)
    constraints = list[Constraint]()
    for i, keys in enumerate(file.constraints):
        try:
            constraints.append(keys.resolved(hands))
        except Wrong as error:
            message, way_out = error.args
            raise SceneError(message, file=path, key=f"constraints[{i}]", way_out=way_out) from None
    constraints += [c.turn for c in constraints if isinstance(c, PlaneConstraint)]
    kept = any(isinstance(c, UprightConstraint) for c in constraints)
    if file.grasp is not None and turned is None and not kept:
        # Hands that keep their tilt also keep the tilt of the load.
        constraints.append(UprightKeys(type="upright").resolved(hands))
    return tuple(constraints)


def _say_shift(end: str, given: Array, moved: Array, names: tuple[str, ...]) -> None:
    shift = np.linalg.norm(moved - given, axis=1)
    worst = first_largest(shift)
    if shift[worst] > TOLD_SHIFT:
        warnings.warn(
            f"the {end} was moved onto the constraints, '{names[worst]}' most, by {shift[worst]:.3g} m",
            ComoveWarning,
            stacklevel=4,
        )


def _require_slow_tips(scene: Scene) -> None:
    """Raise if points of turning obstacles exceed `FASTEST`."""
    for i in np.flatnonzero(scene.turning & (scene.obstacle_speeds > FASTEST)):
        raise SceneError(
            f"points of the obstacle move at up to {scene.obstacle_speeds[i]:g} m/s",
            file=scene.path,
            key=f"obstacles[{i}].motion.turn",
            way_out=f"let it turn more slowly: at most {FASTEST:g} m/s",
        )


def _require_heading(scene: Scene, path: object) -> None:
    """Raise if the first two holders leave the heading open. They do where one is above the other."""
    if scene.grasp is None or scene.grasp.keypoints or len(scene.grasp.holders) < 2:
        return
    first, second = scene.grasp.holders[:2]
    if np.hypot(*(scene.start[first] - scene.start[second])[:2]) < HEADING:
        names = scene.manipulators
        raise SceneError(
            f"'{names[first]}' and '{names[second]}' hold the load one above the other, so that it has no heading "
            "that the hands could turn with",
            file=path,
            key="grasp",
            way_out="move one of them aside, or name first in held_by two holders that are beside each other",
        )


def _require_kept_ends(scene: Scene, path: object) -> None:
    """Raise if an end misses a constraint; warn of small separations.

    End effectors of one group cause no warning, as their distance does not change.
    """
    names, ends = scene.manipulators, spatial(scene.ends)
    for i, c in enumerate(scene.constraints):
        for end, error in zip(ENDS, c.error(ends, scene.n_dims).tolist(), strict=True):
            if error > c.allowed:
                message, way_out = c.unmet(end, error, names)
                raise SceneError(message, file=path, key=f"constraints[{i}]", way_out=way_out)
            if isinstance(c, SeparationConstraint) and error > -PROVABLE and not scene.are_one_body(*c.hands):
                warnings.warn(
                    f"at the {end} {c.pair(names)} are just as far apart as they must be, which hardly any motion "
                    "can be proved to keep; move them a little further apart, or give the separation a tolerance",
                    ComoveWarning,
                    stacklevel=4,
                )
