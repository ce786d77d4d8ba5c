"""Rigid groups of a scene file, by the payload and the constraints."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from math import asin, degrees
from typing import TYPE_CHECKING

import numpy as np

from comove.arrays import Array, first_largest, listed
from comove.errors import SceneError
from comove.geometry.rotations import (
    UP,
    facing,
    levelling,
    logarithm,
    matrices,
    quaternion_of_rotation,
    rotation_in_plane,
    similarity,
    standing,
)
from comove.io.keys import UNTURNED
from comove.model.constraints import (
    Constraint,
    DirectionConstraint,
    DistanceConstraint,
    PlaneConstraint,
    RelativePoseConstraint,
    RotationConstraint,
    SameHeightConstraint,
    UprightConstraint,
)
from comove.model.constraints.kinds import MAX_TOLERANCE, PoseConstraint, distance_tolerance
from comove.model.files.keys import ROUNDING, BarLoad, BoxLoad, Gripped, PartsLoad, PolygonLoad, SceneFile
from comove.model.groups import (
    GroupPose,
    Mask,
    Orientation,
    RigidGroup,
    connected,
    fit_pose,
    nearest_distances,
    orientation_of,
    tilt_between,
)
from comove.model.shapes import box_corners, parts_of, spatial

if TYPE_CHECKING:
    from comove.geometry.convex_decomposition import ConvexDecomposition

ENDS = ("start", "goal")
POSED = 1e-4  # m, by which an end effector may miss its grasp on a payload whose poses are given
KEYPOINT = 0.1  # m, from a line to the point beside it that tells how a body turns about it
FLAT = 1e-3  # width of a body in lengths, below which it counts as a line
HEADING = 1e-3  # m, by which hands that tell a heading must be beside each other
TILT_ROUNDING = 1e-9  # rad
PARALLEL = 1e-6  # sine of the angle up to which two axes are the same
EDGE = (
    0.001  # rad, by which a payload leans less at its ends than it may: what is between them has to be proved
)


@dataclass(frozen=True, eq=False)
class LoadBodies:
    """The rigid bodies of a scene file, with start and goal.

    Attributes
    ----------
    file, path : the scene file, and its path, for messages
    constraints : the constraints that the file states
    start, goal : arrays, shape (n_manipulators, 3), [m]
    decomposition : polytopes that represent a payload mesh
    """

    file: SceneFile
    constraints: tuple[Constraint, ...]
    start: Array
    goal: Array
    path: object = None
    decomposition: ConvexDecomposition | None = None

    def sets(self) -> list[tuple[int, ...]]:
        """Return the sets of manipulators that move as one body.

        They are in the order of their first member. All holders of the payload belong to one set, and so do end
        effectors with a relative pose; distances bind them only where every pair of a set has one.

        Raises
        ------
        SceneError
            If distances bind end effectors that may still move against each other.
        """
        names = self.file.names
        held = list(combinations(sorted(self.file.holder_numbers), 2))
        posed = [c.hands for c in self.constraints if isinstance(c, RelativePoseConstraint)]
        apart = [c.hands for c in self.constraints if isinstance(c, DistanceConstraint)]
        bodies = connected(len(names), held + posed)
        component = connected(len(names), held + posed + apart)
        tied = {frozenset(pair) for pair in apart}
        sets = []
        for root in dict.fromkeys(component):
            members = tuple(i for i, c in enumerate(component) if c == root)
            for a, b in combinations(members, 2):
                if bodies[a] != bodies[b] and frozenset((a, b)) not in tied:
                    raise self._error(
                        f"the distances tie {', '.join(names[i] for i in members)} together but leave '{names[a]}' "
                        f"and '{names[b]}' free to move against each other",
                        "constraints",
                        "give the distance of every pair of the group, or leave out the ones in between",
                    )
            sets.append(members)
        return sets

    def levelled(self, sets: list[tuple[int, ...]]) -> LoadBodies:
        """Return the bodies with free end effectors at their shared height.

        Raises
        ------
        SceneError
            If end effectors miss their common height by more than the tolerance at an end, or if one that shares the
            height of another body's is not free.
        """
        names, up, pairs = self.file.names, self.file.dimension - 1, []
        free = {i for (i, *others) in sets if not others and names[i] not in self.file.holders}
        level = [(i, c) for i, c in enumerate(self.constraints) if isinstance(c, SameHeightConstraint)]
        for i, c in level:
            for end, error in zip(ENDS, c.error(np.stack(self.ends), up + 1), strict=True):
                if error > c.tolerance + ROUNDING:
                    raise self._error(*_keyed(c.unmet(end, error, names), f"constraints[{i}]"))
        for i, c in level:
            if any(set(c.hands) <= set(members) for members in sets):
                continue
            for hand in c.hands:
                if hand not in free:
                    raise self._error(
                        f"'{names[hand]}' is tied to a load or other hands, and shares its height with one outside",
                        f"constraints[{i}].between",
                        "name two free hands, or two hands of one load",
                    )
            pairs.append(c.hands)
        start, goal = (hands.copy() for hands in self.ends)
        component = connected(len(names), pairs)
        for root in {component[a] for a, _ in pairs}:
            together = [i for i, c in enumerate(component) if c == root]
            for hands in (start, goal):
                hands[together, up] = hands[together, up].mean()
        return replace(self, start=start, goal=goal)

    def group(self, members: tuple[int, ...]) -> tuple[RigidGroup, list[DistanceConstraint]]:
        """Return the rigid group of `members`, and implied distances.

        Raises
        ------
        SceneError
            If start or goal violate requirements of payload or constraints by more than their tolerances.
        """
        body = _Body(self, members)
        if body.poses:
            return body.posed()
        grasps, corners = body.held()
        orientation = orientation_of(grasps, self.file.dimension)
        rolls = orientation == "axis" and _is_solid(corners)  # on one line: turns about it count
        if rolls:
            grasps, corners = body.on_x_axis(members, grasps, corners, body.ends)
        implied = body.implied(grasps)
        poses = [fit_pose(grasps, hands, orientation) for hands in body.ends]
        slack = max((c.tolerance for c in (*body.stated.values(), *implied)), default=0.0)
        body.require_no_mirror(grasps, orientation, poses, slack)
        if rolls:
            poses = [GroupPose(pose.center, standing(pose.rotation[:, 0])) for pose in poses]
        start, goal = poses
        group = RigidGroup(members, grasps, corners, orientation, start, goal)
        if len(members) > 1 and body.has(UprightConstraint, SameHeightConstraint):
            group = body.upright(group)
        elif orientation == "axis" and body.has(RelativePoseConstraint):
            group = _without_roll(group)
        elif rolls:
            raise self._error(
                f"{body.listed(members)} leave the {_shape(self.file)} free to turn about the line through their "
                "hands",
                "load",
                "add {type: upright} to the constraints (or grasp, which implies it), or a third hand",
            )
        return group, implied

    @property
    def ends(self) -> tuple[Array, Array]:
        """Return the end effectors at start and goal."""
        return self.start, self.goal

    def _error(self, message: str, key: str, way_out: str) -> SceneError:
        return SceneError(message, file=self.path, key=key, way_out=way_out)


class _Body:
    """One rigid body: its members' data while its group is made."""

    def __init__(self, bodies: LoadBodies, members: tuple[int, ...]):
        self.file, self.members, self.decomposition = bodies.file, members, bodies.decomposition
        self.names, self.n_dims, self._error = bodies.file.names, bodies.file.dimension, bodies._error
        self.ends = bodies.start[list(members)], bodies.goal[list(members)]
        self.own = [c for c in bodies.constraints if set(c.hands) <= set(members)]
        self.stated_in_file = bodies.constraints[: len(bodies.file.constraints)]
        self.stated = {frozenset(c.hands): c for c in self.own if isinstance(c, DistanceConstraint)}
        load, holds = bodies.file.load, not {*members}.isdisjoint(bodies.file.holder_numbers)
        given = (load.start, load.goal) if load is not None and holds else ()
        self.poses = [
            GroupPose(spatial(np.array(pose.position)), matrices(np.array(pose.quaternion_wxyz)))
            for pose in given
            if pose is not None
        ]

    def has(self, *kinds: type[Constraint]) -> bool:
        """Return whether the body has a constraint of one of these kinds."""
        return any(isinstance(c, kinds) for c in self.own)

    def listed(self, members: tuple[int, ...]) -> str:
        """Return names as text, ``'a' and 'b'`` or ``'a', 'b' and 'c'``."""
        names = [f"'{self.names[i]}'" for i in members]
        return f"{', '.join(names[:-1])} and {names[-1]}"

    def implied(self, grasps: Array) -> list[DistanceConstraint]:
        """Return the distances that grasps imply, checked at both ends."""
        implied = []
        for (a, i), (b, j) in combinations(enumerate(self.members), 2):
            both = f"'{self.names[i]}' and '{self.names[j]}'"
            distance = float(np.linalg.norm(grasps[a] - grasps[b]))
            constraint = self.stated.get(frozenset((i, j)))
            if constraint is None:
                constraint = DistanceConstraint(i, j, distance, self._implied_tolerance(i, j, distance))
                implied.append(constraint)
            elif abs(constraint.distance - distance) > constraint.tolerance + ROUNDING:
                raise self._error(
                    f"{both} hold the load {distance:g} m apart, but their distance constraint says "
                    f"{constraint.distance:g} m",
                    "constraints",
                    "make them agree",
                )
            for end, hands in zip(ENDS, self.ends, strict=True):
                actual = float(np.linalg.norm(hands[a] - hands[b]))
                if abs(actual - distance) > constraint.tolerance + ROUNDING:
                    raise self._error(
                        f"{both} are {actual:g} m apart at the {end}, but they must be {distance:g} m apart "
                        f"(tolerance {constraint.tolerance:g} m)",
                        f"manipulators[{i}].{end}, manipulators[{j}].{end}",
                        "move one of them or correct the distance",
                    )
        return implied

    def _implied_tolerance(self, i: int, j: int, distance: float) -> float:
        """Return the tolerance [m] of an implied distance. It follows from relative poses or the payload."""
        poses = [c for c in self.own if isinstance(c, RelativePoseConstraint)]
        for c in poses:
            if set(c.hands) == {i, j}:
                return c.tolerance
        return max([distance_tolerance(None, distance), *(c.tolerance for c in poses)])

    def require_no_mirror(
        self, grasps: Array, orientation: Orientation, poses: list[GroupPose], slack: float
    ) -> None:
        """Raise if end effectors mirror the grasps. All distances agree then, and no rotation fits."""
        mirrored = grasps * ([1, -1, 1] if self.n_dims == 2 else [1, 1, -1])
        for end, pose, hands in zip(ENDS, poses, self.ends, strict=True):
            miss = float(np.abs(pose.place(grasps) - hands).max())
            miss_mirrored = float(
                np.abs(fit_pose(mirrored, hands, orientation).place(mirrored) - hands).max()
            )
            if miss > slack + ROUNDING and miss_mirrored < miss / 2:
                raise self._error(
                    f"the hands at the {end} are the mirror image of the load's grasps",
                    "manipulators",
                    f"swap two of them at the {end}",
                )

    def posed(self) -> tuple[RigidGroup, list[DistanceConstraint]]:
        """Return the group of a payload with poses, and implied distances.

        Raises
        ------
        SceneError
            If end effectors are not where these poses place their grasps, or a constraint is violated.
        """
        file, (start, goal) = self.file, self.poses
        grasps = (self.ends[0] - start.center) @ start.rotation
        holders = tuple(i for i in self.members if self.names[i] in file.holders)
        own, corners = load_shape(file, holders, self.decomposition)
        if own is not None:
            grasps[[self.members.index(i) for i in holders]] = own
        for end, pose, hands in zip(ENDS, (start, goal), self.ends, strict=True):
            self._require_held(end, pose.place(grasps), hands)
        self.ends = start.place(grasps), goal.place(grasps)
        orientation: Orientation = "plane" if self.n_dims == 2 else "space"
        unturned = np.eye(3)
        points = np.concatenate([grasps, corners])
        if file.grasp is not None:
            corners = _telling(grasps, corners)
        elif len(grasps) == 1 and np.abs(start.rotation - goal.rotation).max() < TILT_ROUNDING:
            orientation, unturned = "none", start.rotation  # it has no reason to turn
            goal = GroupPose(goal.center, unturned)
        elif self.n_dims == 3 and np.abs(points[:, 1:]).max() < ROUNDING:
            orientation, unturned = "axis", _roll(start.rotation)
        group = RigidGroup(self.members, grasps, corners, orientation, start, goal, unturned)
        implied = self.implied(grasps)
        if orientation != "none" and self.has(UprightConstraint, SameHeightConstraint):
            group = self.upright(group)
        return self.masked(group), implied

    def masked(self, group: RigidGroup) -> RigidGroup:
        """Return a payload's group with masks, its goal moved onto them.

        Raises
        ------
        SceneError
            If an end contradicts the masks.
        """
        own = [c for c in self.own if isinstance(c, PoseConstraint)]
        if not own:
            return group
        turns = [c for c in own if isinstance(c, DirectionConstraint) and c.by_mask]
        axes = [c.world for c in turns] + [UP] * (group.orientation == "vertical")
        fixed = [c for c in own if isinstance(c, RotationConstraint)]
        is_fixed = fixed or group.orientation in ("none", "fixed")
        is_fixed = is_fixed or any(np.linalg.norm(np.cross(axes[0], axis)) > PARALLEL for axis in axes[1:])
        start, goal, rotation = group.start, group.goal, group.goal.rotation
        if is_fixed or axes:
            turned = quaternion_of_rotation(rotation @ start.rotation.T)
            twist = 0.0 if is_fixed else float(turned[1:] @ axes[0])
            kept = np.append(turned[0], twist * axes[0]) if twist else np.array(UNTURNED)
            rotation = matrices(kept / np.linalg.norm(kept)) @ start.rotation
            self._require_turn(rotation @ goal.rotation.T, turned, start.rotation, [*fixed, *turns])
        center, normal = goal.center, None
        for c in (c for c in own if isinstance(c, PlaneConstraint)):
            off, normal = (center - start.center) @ c.normal, c.normal
            center = center - off * normal
            if abs(off) > c.tolerance + ROUNDING:
                there = f"write goal position: {listed(center[: self.n_dims], 6)}"
                told = (
                    f"the goal is {abs(off):.3g} m out of the plane in which the payload moves from its start"
                )
                raise self._error(told, self._key("planar"), f"{there}, or leave the constraint out")
        goal, free = GroupPose(center, rotation), not is_fixed
        is_level = free and bool(axes) and abs(axes[0] @ UP) > 1.0 - PARALLEL**2
        if not free or is_level:
            group = replace(group, orientation="vertical" if free else "fixed", unturned=start.rotation)
        elif group.orientation != "vertical":
            group = replace(group, orientation="space", unturned=np.eye(3))
        mask = Mask(axes[0] if group.orientation == "space" and axes else None, normal)
        for lean in (c for c in own if isinstance(c, DirectionConstraint) and not c.by_mask):
            up = start.rotation.T @ lean.own
            mask = mask._replace(up=up, tilt=lean.tolerance)
            self._require_lean((start, goal), up, lean.tolerance)
        return replace(
            group, start=start, goal=goal, mask=mask if group.orientation == "space" else Mask(normal=normal)
        )

    def _key(self, *kinds: str) -> str:
        return f"constraints[{next(i for i, c in enumerate(self.file.constraints) if c.type in kinds)}]"

    def _require_turn(
        self, missed: Array, turned: Array, start: Array, keeping: list[PoseConstraint]
    ) -> None:
        """Raise if constraints do not allow the goal's rotation `turned`."""
        off = float(np.linalg.norm(logarithm(quaternion_of_rotation(missed))))
        allowed = min((c.tolerance for c in keeping), default=0.0) + TILT_ROUNDING
        if off <= allowed:
            return
        axis = logarithm(turned)
        about = listed(axis / np.linalg.norm(axis), 4)
        told = f"the goal turns the payload by {degrees(np.linalg.norm(axis)):.3g} deg"
        left_out = f"{degrees(off):.3g} deg of it out (tolerance {degrees(allowed):.3g} deg)"
        kept = [i for i, c in enumerate(self.file.constraints) if c.type in ("no_rotation", "axis", "planar")]
        against = [i for i in kept if _turn_left_out(self.stated_in_file[i], turned)] or kept
        named = " and ".join(f"constraints[{i}]" for i in against)
        way_out = f"leave {named} out, or write another orientation at the goal"
        if self.n_dims == 2:
            angle = round(degrees(np.arctan2(start[1, 0], start[0, 0])), 6) + 0.0
            way_out = f"leave {named} out, or write angle_deg: {angle:g} at the goal, as at the start"
        elif len(kept) == 1:
            way_out = f"write {{type: axis, axis: {about}}} instead, or another orientation at the goal"
        told += "" if self.n_dims == 2 else f" about {about}"
        raise self._error(
            f"{told} from its start, and the constraints leave {left_out}",
            f"constraints[{against[0]}]",
            way_out,
        )

    def _require_lean(self, poses: tuple[GroupPose, GroupPose], up: Array, tilt: float) -> None:
        """Raise if a payload's direction `up` leans too far at an end."""
        for end, pose in zip(ENDS, poses, strict=True):
            there = pose.rotation @ up
            angle = float(np.arctan2(np.hypot(*there[:2]), there[2]))
            if angle > tilt - EDGE:
                wider = _wider(angle)
                way_out = f"write {wider}" if wider else "leave the constraint out"
                raise self._error(
                    f"the payload leans by {degrees(angle):.3g} deg from upright at the {end} (tolerance "
                    f"{degrees(tilt):g} deg, of which an end needs {degrees(EDGE):g} to spare)",
                    self._key("upright"),
                    f"{way_out}, or write another orientation at the {end}",
                )

    def _require_held(self, end: str, held: Array, hands: Array) -> None:
        off = np.linalg.norm(held - hands, axis=1)
        worst = first_largest(off)
        if off[worst] > POSED:
            i, there = self.members[worst], listed(held[worst, : self.n_dims], 10)
            raise self._error(
                f"the payload's pose at the {end} places the grasp of '{self.names[i]}' {off[worst]:.3g} m from "
                "where this end effector is",
                f"load.{end}",
                f"write manipulators[{i}].{end}: {there}, or correct the pose",
            )

    def held(self) -> tuple[Array, Array]:
        """Return grasps and further payload points in the group's frame.

        Arrays, shapes (n_members, 3) and (n_corners, 3) [m].
        """
        file, hands = self.file, self.ends[0]
        holders = tuple(i for i in self.members if self.names[i] in file.holders)
        grasps, corners = (
            load_shape(file, holders, self.decomposition) if holders else (None, np.zeros((0, 3)))
        )
        inside = [self.members.index(i) for i in holders]
        if holders and _shape(file) in ("box", "mesh") and grasps is None:  # centred between its holders
            grasps = self._grasps_from_start(holders, hands[inside])
        if grasps is not None and holders == self.members:
            return grasps, corners
        found = self._grasps_from_start(self.members, hands)
        if grasps is not None:  # others go along with the load that some hold
            orientation = orientation_of(grasps, self.n_dims)
            if orientation == "axis" and _is_solid(corners):
                own, corners = self.on_x_axis(holders, grasps, corners, (found[inside], found[inside]))
                pose = fit_pose(own, found[inside], orientation)
                grasps, pose = own, GroupPose(pose.center, standing(pose.rotation[:, 0]))
            else:
                pose = fit_pose(grasps, found[inside], orientation)
            found[inside], corners = pose.place(grasps), pose.place(corners)
        return found, corners

    def on_x_axis(
        self, members: tuple[int, ...], grasps: Array, corners: Array, ends: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        """Return grasps and corners in a frame along the grasps' line.

        The line is the frame's x axis. Its z axis is as near as possible to the solid's own z axis.

        Raises
        ------
        SceneError
            If the line is vertical, so that the heading of the solid is not determined.
        """
        line = grasps[-1] - grasps[0]
        for way in (line, *(hands[-1] - hands[0] for hands in ends)):
            if np.hypot(way[0], way[1]) < HEADING:
                raise self._error(
                    f"{self.listed(members)} hold the {_shape(self.file)} one above the other, which leaves open "
                    "where it is heading",
                    "load",
                    "move one of them aside, or let a third hand hold it",
                )
        frame, middle = standing(line / np.linalg.norm(line)), grasps.mean(axis=0)
        along = (grasps - middle) @ frame[:, 0]
        return np.outer(along, [1.0, 0.0, 0.0]), (corners - middle) @ frame

    def _grasps_from_start(self, members: tuple[int, ...], hands: Array) -> Array:
        """Return grasps about their mean, moved onto the stated distances.

        They follow from the end effectors at the start.

        Grasps on one line are put on the x axis.
        """
        stated = {}
        for a, b in combinations(range(len(members)), 2):
            if np.linalg.norm(hands[a] - hands[b]) < 1e-9:
                raise self._error(
                    f"'{self.names[members[a]]}' and '{self.names[members[b]]}' start at the same point",
                    f"manipulators[{members[b]}].start",
                    "move them apart",
                )
            if constraint := self.stated.get(frozenset((members[a], members[b]))):
                stated[a, b] = constraint
        if stated:
            wanted = np.array([c.distance for c in stated.values()])
            off = [abs(np.linalg.norm(hands[a] - hands[b]) - c.distance) for (a, b), c in stated.items()]
            if all(o <= c.tolerance for o, c in zip(off, stated.values(), strict=True)):
                hands = nearest_distances(hands, list(stated), wanted)
            elif len(members) == 2:  # told by the caller, with both values
                return np.array([[-wanted[0] / 2, 0, 0], [wanted[0] / 2, 0, 0]])
        grasps = hands - hands.mean(axis=0)
        if self.n_dims == 3 and orientation_of(grasps, 3) == "axis":
            line = grasps[-1] - grasps[0]
            grasps = np.outer(grasps @ line / np.linalg.norm(line), [1.0, 0.0, 0.0])
        return grasps

    def upright(self, group: RigidGroup) -> RigidGroup:
        """Return the group as one that turns about the vertical only.

        In the plane it does not turn at all. It keeps the tilt of the start, turned as little as possible so that end
        effectors of the same height are level.
        """
        allowed, level = TILT_ROUNDING, []
        for c in self.own:
            if isinstance(c, UprightConstraint):
                allowed = max(allowed, c.tolerance + TILT_ROUNDING)
            elif isinstance(c, SameHeightConstraint):
                along = np.subtract(*(group.grasps[group.members.index(i)] for i in (c.first, c.second)))
                level.append(group.start.rotation @ along)
                allowed = max(allowed, asin(min(1.0, 2 * c.tolerance / float(np.linalg.norm(along)))))
        turn, up = group.start.rotation, np.eye(3)[self.n_dims - 1]
        if group.orientation == "axis" and not self.poses:
            turn = facing(turn[:, 0])  # hands leave the roll open
        if level:
            turn = levelling(np.array(level), up) @ turn
            left = np.abs(levelling(np.array(level), up) @ np.array(level).T)[self.n_dims - 1].max()
            if left > 1e-9:
                raise self._error(
                    "hands of one load cannot be at the same height: turned at best they still differ by "
                    f"{left:.3g} m",
                    "constraints",
                    "leave one of the same_height constraints out",
                )
        kept = replace(group, orientation="fixed" if self.n_dims == 2 else "vertical", unturned=turn)
        poses = [_about_vertical(pose, turn, self.n_dims) for pose in self.poses] or [
            fit_pose(kept.grasps, hands, kept.orientation, turn) for hands in self.ends
        ]
        for end, pose, free in zip(ENDS, poses, (group.start, group.goal), strict=True):
            tilt = tilt_between(group.orientation, free.rotation, pose.rotation)
            if tilt > allowed:
                who = ", ".join(f"'{self.names[i]}'" for i in group.members)
                how = "not turn" if self.n_dims == 2 else "turn about the vertical only"
                unsaid = self.file.grasp is not None and not any(
                    c.type == "upright" for c in self.file.constraints
                )
                raise self._error(
                    f"the body that {who} hold is tilted by {degrees(tilt):.3g} deg at the {end}, and it may {how} "
                    f"({'as grasp implies; ' if unsaid else ''}tolerance {degrees(allowed):.3g} deg)",
                    f"manipulators.{end}",
                    self._way_to_tilt(tilt),
                )
        return replace(kept, start=poses[0], goal=poses[1])

    def _way_to_tilt(self, tilt: float) -> str:
        """Return advice for a body tilted by an angle [rad]."""
        wider, kept = _wider(tilt), "keep the tilt of the start"
        if any(c.type == "upright" for c in self.file.constraints):
            wider = f"write {wider} in" if wider else "leave out"
            return f"{kept}, or {wider} {self._key('upright')}"
        if self.file.grasp is not None:
            return f"{kept}, or add {{type: upright, {wider}}}" if wider else kept
        return f"{kept}, or widen the tolerance"


def _turn_left_out(constraint: Constraint, turned: Array) -> bool:
    """Return whether a constraint forbids a payload's turn, a quaternion."""
    turn = constraint.turn if isinstance(constraint, PlaneConstraint) else constraint
    axis = turn.world if isinstance(turn, DirectionConstraint) else np.zeros(3)
    sine = np.linalg.norm(turned[1:] - (turned[1:] @ axis) * axis)
    return 2.0 * asin(min(1.0, float(sine))) > turn.allowed + TILT_ROUNDING


def _wider(tilt: float) -> str | None:
    """Return the tolerance that allows a tilt [rad], or None."""
    wide = float(np.ceil(degrees(tilt + EDGE)))
    return f"tolerance_deg: {wide:g}" if wide <= MAX_TOLERANCE else None


def _keyed(told: tuple[str, str], key: str) -> tuple[str, str, str]:
    message, way_out = told
    return message, key, way_out


def _shape(file: SceneFile) -> str:
    return "" if file.load is None else file.load.shape


def _is_solid(corners: Array) -> bool:
    """Return whether corners are a solid's; a bar has two."""
    return len(corners) > 2


def load_shape(
    file: SceneFile, holders: tuple[int, ...], decomposition: ConvexDecomposition | None
) -> tuple[Array | None, Array]:
    """Return grasps and corners of the payload in its own frame.

    The grasps are None where the end effectors' start determines them.
    """
    load, names = file.load, file.names
    if isinstance(load, BarLoad):
        half, first = load.length / 2, names.index((load.held_by or names)[0])
        ends = np.array([[-half if i == first else half, 0.0, 0.0] for i in holders])
        beyond = [half + load.overhang] if load.overhang else []
        return ends, np.array([[side * x, 0.0, 0.0] for x in beyond for side in (-1, 1)]).reshape(-1, 3)
    grasps, corners = None, np.zeros((0, 3))
    if isinstance(load, Gripped) and load.grasps:
        grasps = np.zeros((len(holders), 3))
        grasps[:, : file.dimension] = [load.grasps[names[i]] for i in holders]
    if decomposition is not None:
        corners = np.concatenate([polytope.vertices for polytope in decomposition.polytopes])
    elif isinstance(load, PolygonLoad):
        corners = np.zeros((len(load.vertices), 3))
        corners[:, : file.dimension] = load.vertices
    elif isinstance(load, BoxLoad) and file.dimension == 2:
        corners = np.array([[x, y, 0.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
        corners[:, :2] *= 0.5 * np.array(load.size)
    elif isinstance(load, BoxLoad):
        corners = box_corners(load.size)
    elif isinstance(load, PartsLoad):
        corners = parts_of(load).corners
    return grasps, corners


def _about_vertical(pose: GroupPose, turn: Array, n_dims: int) -> GroupPose:
    """Return the nearest pose turned by `turn`, then about the vertical."""
    left = pose.rotation @ turn.T
    angle = float(np.arctan2(left[1, 0] - left[0, 1], left[0, 0] + left[1, 1])) if n_dims == 3 else 0.0
    return GroupPose(pose.center, rotation_in_plane(angle) @ turn)


def _roll(rotation: Array) -> Array:
    """Return a rotation's roll about x beyond the smallest rotation."""
    left = similarity(np.array([1.0, 0.0, 0.0]), rotation[:, 0]).T @ rotation
    roll = np.arctan2(left[2, 1], left[1, 1])
    return np.roll(rotation_in_plane(roll), 1, axis=(0, 1))


def _telling(grasps: Array, corners: Array) -> Array:
    """Return a body's corners with keypoints that determine its orientation.

    Keypoints are added where all its points are on one line. No part of the body reaches there.
    """
    points = np.concatenate([grasps, corners])
    middle = points.mean(axis=0)
    _, spread, axes = np.linalg.svd(points - middle, full_matrices=True)
    known = int((spread > FLAT * max(spread.max(), KEYPOINT)).sum())
    return np.concatenate([corners, middle + KEYPOINT * axes[known:2]])


def _without_roll(group: RigidGroup) -> RigidGroup:
    """Return a group on one line as a freely turning body.

    Roll about the line counts; from start to goal it turns as little as possible.
    """
    first, last = group.start.rotation, group.goal.rotation
    turned = similarity(first[:, 0], last[:, 0]) @ first
    return replace(group, orientation="space", goal=GroupPose(group.goal.center, turned))
