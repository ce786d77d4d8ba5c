"""Rigid groups of a scene file: which manipulators move as one body, by the load and the constraints."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from math import asin, degrees

import numpy as np
from numpy.typing import NDArray

from comove.errors import SceneError
from comove.geometry.convex_decomposition import Cover
from comove.geometry.rotations import similarity
from comove.geometry.solids import N_CORNERS
from comove.scenes.constraints import (
    ROUNDING,
    Constraint,
    DistanceConstraint,
    RelativePoseConstraint,
    SameHeightConstraint,
    UprightConstraint,
    distance_tolerance,
)
from comove.scenes.groups import (
    GroupPose,
    RigidGroup,
    fit_pose,
    levelling,
    nearest_distances,
    orientation_of,
    standing,
    tilt_between,
)
from comove.scenes.model import SceneFile

Array = NDArray[np.float64]

HEADING = 1e-3  # m, by which hands that tell a heading must be beside each other
TILT_ROUNDING = 1e-9  # rad


def rigid_sets(
    file: SceneFile, constraints: tuple[Constraint, ...], path: object = None
) -> list[tuple[int, ...]]:
    """Return the sets of manipulators that move as one rigid body, in the order of their first member.

    All holders of the load belong to one set, and so do hands with a relative pose; distances bind hands only where
    every pair of a set has one.

    Raises
    ------
    SceneError
        If distances tie hands together that may still move against each other.
    """
    names = file.names
    held = list(combinations(sorted(names.index(name) for name in file.holders), 2))
    posed = [(c.first, c.second) for c in constraints if isinstance(c, RelativePoseConstraint)]
    apart = [(c.first, c.second) for c in constraints if isinstance(c, DistanceConstraint)]
    bodies = _components(len(names), held + posed)
    component = _components(len(names), held + posed + apart)
    tied = {frozenset(pair) for pair in apart}
    sets = []
    for root in dict.fromkeys(component):
        members = tuple(i for i, c in enumerate(component) if c == root)
        for a, b in combinations(members, 2):
            if bodies[a] != bodies[b] and frozenset((a, b)) not in tied:
                raise SceneError(
                    f"the distances tie {', '.join(names[i] for i in members)} together but leave '{names[a]}' "
                    f"and '{names[b]}' free to move against each other",
                    file=path,
                    key="constraints",
                    way_out="give the distance of every pair of the group, or leave out the ones in between",
                )
        sets.append(members)
    return sets


def rigid_group(
    file: SceneFile,
    members: tuple[int, ...],
    constraints: tuple[Constraint, ...],
    start: Array,
    goal: Array,
    path: object = None,
    cover: Cover | None = None,
) -> tuple[RigidGroup, list[DistanceConstraint]]:
    """Return the rigid group of `members` and the distance constraints that the file implies but does not state.

    Parameters
    ----------
    start, goal : arrays, shape (n_manipulators, 3), [m]
    cover : polytopes that represent a load that is a mesh

    Raises
    ------
    SceneError
        If start or goal violate what the load and the constraints require by more than their tolerances.
    """
    names, n_dims = file.names, file.dimension
    own = [c for c in constraints if _is_among(c, members)]
    ends = start[list(members)], goal[list(members)]
    stated = {frozenset((c.first, c.second)): c for c in own if isinstance(c, DistanceConstraint)}
    grasps, corners = _held(file, members, ends[0], stated, path, cover)
    orientation = orientation_of(grasps, n_dims)
    rolls = orientation == "axis" and _is_solid(corners)  # on one line: turns about it count
    if rolls:
        grasps, corners = _on_x_axis(file, members, grasps, corners, ends, path)
    implied = []
    for (a, i), (b, j) in combinations(enumerate(members), 2):
        distance = float(np.linalg.norm(grasps[a] - grasps[b]))
        constraint = stated.get(frozenset((i, j)))
        if constraint is None:
            constraint = DistanceConstraint(i, j, distance, _implied_tolerance(own, i, j, distance))
            implied.append(constraint)
        elif abs(constraint.distance - distance) > constraint.tolerance + ROUNDING:
            raise SceneError(
                f"'{names[i]}' and '{names[j]}' hold the load {distance:g} m apart, but their distance "
                f"constraint says {constraint.distance:g} m",
                file=path,
                key="constraints",
                way_out="make them agree",
            )
        for end, hands in zip(("start", "goal"), ends, strict=True):
            actual = float(np.linalg.norm(hands[a] - hands[b]))
            if abs(actual - distance) > constraint.tolerance + ROUNDING:
                raise SceneError(
                    f"'{names[i]}' and '{names[j]}' are {actual:g} m apart at the {end}, but they must be "
                    f"{distance:g} m apart (tolerance {constraint.tolerance:g} m)",
                    file=path,
                    key=f"manipulators[{i}].{end}, manipulators[{j}].{end}",
                    way_out="move one of them or correct the distance",
                )
    poses = [fit_pose(grasps, hands, orientation) for hands in ends]
    slack = max((c.tolerance for c in (*stated.values(), *implied)), default=0.0)
    for end, pose, hands in zip(("start", "goal"), poses, ends, strict=True):
        miss = float(np.abs(pose.place(grasps) - hands).max())
        mirrored = grasps * ([1, -1, 1] if n_dims == 2 else [1, 1, -1])
        miss_mirrored = float(np.abs(fit_pose(mirrored, hands, orientation).place(mirrored) - hands).max())
        if miss > slack + ROUNDING and miss_mirrored < miss / 2:  # all distances agree and no rotation fits
            raise SceneError(
                f"the hands at the {end} are the mirror image of the load's grasps",
                file=path,
                key="manipulators",
                way_out=f"swap two of them at the {end}",
            )
    if rolls:
        poses = [GroupPose(pose.center, standing(pose.rotation[:, 0])) for pose in poses]
    group = RigidGroup(members, grasps, corners, orientation, *poses)
    if any(isinstance(c, (UprightConstraint, SameHeightConstraint)) for c in own) and len(members) > 1:
        group = _upright(group, ends, own, file, path)
    elif any(isinstance(c, RelativePoseConstraint) for c in own) and orientation == "axis":
        group = _without_roll(group)
    elif rolls:
        raise SceneError(
            f"{_listed(file, members)} leave the {file.load.shape} free to turn about the line through their hands",
            file=path,
            key="load",
            way_out="add {type: upright} to the constraints (or grasp, which implies it), or a third hand",
        )
    return group, implied


def require_same_heights(
    file: SceneFile, constraints: tuple[Constraint, ...], start: Array, goal: Array, path: object = None
) -> None:
    """Refuse a start or goal at which hands miss their common height by more than the tolerance.

    Parameters
    ----------
    start, goal : arrays, shape (n_manipulators, 3), [m]

    Raises
    ------
    SceneError
        If a hand misses it.
    """
    names, up = file.names, file.dimension - 1
    for i, c in enumerate(constraints):
        for end, hands in (("start", start), ("goal", goal)) if isinstance(c, SameHeightConstraint) else ():
            miss = abs(float(hands[c.first, up] - hands[c.second, up]))
            if miss > c.tolerance + ROUNDING:
                raise SceneError(
                    f"at the {end} the heights of '{names[c.first]}' and '{names[c.second]}' differ by "
                    f"{miss:.3g} m (tolerance {c.tolerance:g} m)",
                    file=path,
                    key=f"constraints[{i}]",
                    way_out="move one of them, or widen the tolerance",
                )


def levelled(
    file: SceneFile,
    sets: list[tuple[int, ...]],
    constraints: tuple[Constraint, ...],
    hands: Array,
    path: object = None,
) -> Array:
    """Return the hands (n_manipulators, 3) [m], with free hands that share a height moved to their mean height.

    Raises
    ------
    SceneError
        If a hand that shares the height of a hand of another group is not free.
    """
    names, up = file.names, file.dimension - 1
    free = {i for (i, *others) in sets if not others and file.names[i] not in file.holders}
    pairs = []
    for i, c in enumerate(constraints):
        if not isinstance(c, SameHeightConstraint) or any({c.first, c.second} <= set(m) for m in sets):
            continue
        for hand in (c.first, c.second):
            if hand not in free:
                raise SceneError(
                    f"'{names[hand]}' is tied to a load or other hands, and shares its height with one outside",
                    file=path,
                    key=f"constraints[{i}].between",
                    way_out="name two free hands, or two hands of one load",
                )
        pairs.append((c.first, c.second))
    hands, component = hands.copy(), _components(len(names), pairs)
    for root in {component[a] for a, _ in pairs}:
        level = [i for i, c in enumerate(component) if c == root]
        hands[level, up] = hands[level, up].mean()
    return hands


def _components(n: int, pairs: list[tuple[int, int]]) -> list[int]:
    """Return the connected component of each of n nodes, as the number of one of its nodes."""
    component = list(range(n))
    for a, b in pairs:
        old, new = component[a], component[b]
        component = [new if c == old else c for c in component]
    return component


def _is_among(constraint: Constraint, members: tuple[int, ...]) -> bool:
    """Return whether a constraint concerns only hands among `members`."""
    named = (
        constraint.members
        if isinstance(constraint, UprightConstraint)
        else (constraint.first, constraint.second)
    )
    return set(named) <= set(members)


def _implied_tolerance(own: list[Constraint], i: int, j: int, distance: float) -> float:
    """Return the tolerance [m] of a distance that is implied by relative poses or a load and not stated."""
    poses = [c for c in own if isinstance(c, RelativePoseConstraint)]
    for c in poses:
        if {c.first, c.second} == {i, j}:
            return c.tolerance
    return max([distance_tolerance(None, distance), *(c.tolerance for c in poses)])


def _held(
    file: SceneFile,
    members: tuple[int, ...],
    hands: Array,
    stated: dict[frozenset[int], DistanceConstraint],
    path: object,
    cover: Cover | None,
) -> tuple[Array, Array]:
    """Return grasps and further points of the load in the group's frame.

    Arrays, shapes (n_members, 3) and (n_corners, 3) [m].
    """
    holders = tuple(i for i in members if file.names[i] in file.holders)
    grasps, corners = _load_shape(file, holders, cover) if holders else (None, np.zeros((0, 3)))
    held = [members.index(i) for i in holders]
    if holders and file.load.shape in ("box", "mesh") and grasps is None:  # centred between its holders
        grasps = _grasps_from_start(holders, hands[held], stated, file, path)
    if grasps is not None and holders == members:
        return grasps, corners
    found = _grasps_from_start(members, hands, stated, file, path)
    if grasps is not None:  # others go along with the load that some hold
        orientation = orientation_of(grasps, file.dimension)
        if orientation == "axis" and _is_solid(corners):
            own, corners = _on_x_axis(file, holders, grasps, corners, (found[held], found[held]), path)
            pose = fit_pose(own, found[held], orientation)
            grasps, pose = own, GroupPose(pose.center, standing(pose.rotation[:, 0]))
        else:
            pose = fit_pose(grasps, found[held], orientation)
        found[held], corners = pose.place(grasps), pose.place(corners)
    return found, corners


def _on_x_axis(
    file: SceneFile,
    members: tuple[int, ...],
    grasps: Array,
    corners: Array,
    ends: tuple[Array, Array],
    path: object,
) -> tuple[Array, Array]:
    """Return grasps on one line and a solid's corners, in a frame that has this line as its x axis.

    The frame's z axis is as near as possible to the solid's own z axis.

    Raises
    ------
    SceneError
        If the line is vertical, so that the heading of the solid is not determined.
    """
    line = grasps[-1] - grasps[0]
    for way in (line, *(hands[-1] - hands[0] for hands in ends)):
        if np.hypot(way[0], way[1]) < HEADING:
            raise SceneError(
                f"{_listed(file, members)} hold the {file.load.shape} one above the other, which leaves open where "
                "it is heading",
                file=path,
                key="load",
                way_out="move one of them aside, or let a third hand hold it",
            )
    frame, middle = standing(line / np.linalg.norm(line)), grasps.mean(axis=0)
    along = (grasps - middle) @ frame[:, 0]
    return np.outer(along, [1.0, 0.0, 0.0]), (corners - middle) @ frame


def _listed(file: SceneFile, members: tuple[int, ...]) -> str:
    """Return the members' names as text, ``'a' and 'b'`` or ``'a', 'b' and 'c'``."""
    names = [f"'{file.names[i]}'" for i in members]
    return f"{', '.join(names[:-1])} and {names[-1]}"


def _is_solid(corners: Array) -> bool:
    """Return whether the corners are those of a solid: a bar has two at most, its ends."""
    return len(corners) > 2


def _load_shape(file: SceneFile, holders: tuple[int, ...], cover: Cover | None) -> tuple[Array | None, Array]:
    """Return grasps and corners of the load in its own frame.

    The grasps are None where the hands' start determines them.
    """
    load, names = file.load, file.names
    if load.shape == "bar":
        half, first = load.length / 2, names.index((load.held_by or names)[0])
        ends = np.array([[-half if i == first else half, 0.0, 0.0] for i in holders])
        beyond = [half + load.overhang] if load.overhang else []
        return ends, np.array([[side * x, 0.0, 0.0] for x in beyond for side in (-1, 1)]).reshape(-1, 3)
    grasps, corners = None, np.zeros((0, 3))
    if getattr(load, "grasps", None):
        grasps = np.zeros((len(holders), 3))
        grasps[:, : file.dimension] = [load.grasps[names[i]] for i in holders]
    if load.shape == "polygon":
        corners = np.zeros((len(load.vertices), 3))
        corners[:, : file.dimension] = load.vertices
    elif load.shape == "box" and file.dimension == 2:
        corners = np.array([[x, y, 0.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
        corners[:, :2] *= 0.5 * np.array(load.size)
    elif cover is not None:
        corners = np.concatenate([polytope.vertices for polytope in cover.polytopes])
    elif load.shape == "box":
        sides = 1.0 - 2.0 * (np.arange(N_CORNERS)[:, None] >> np.arange(3) & 1)
        corners = -0.5 * sides * np.array(load.size)
    return grasps, corners


def _grasps_from_start(
    members: tuple[int, ...],
    hands: Array,
    stated: dict[frozenset[int], DistanceConstraint],
    file: SceneFile,
    path: object,
) -> Array:
    """Return grasps about their mean, from the hands at the start, moved onto the stated distances.

    Grasps on one line are put on the x axis.
    """
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
    if file.dimension == 3 and orientation_of(grasps, 3) == "axis":
        line = grasps[-1] - grasps[0]
        grasps = np.outer(grasps @ line / np.linalg.norm(line), [1.0, 0.0, 0.0])
    return grasps


def _of(
    stated: dict[frozenset[int], DistanceConstraint], members: tuple[int, ...], pair: tuple[int, int]
) -> DistanceConstraint | None:
    return stated.get(frozenset(members[i] for i in pair))


def _without_roll(group: RigidGroup) -> RigidGroup:
    """Return a group of hands on one line as a body that turns in any way, roll about the line included.

    From start to goal it turns as little as possible.
    """
    first, last = group.start.rotation, group.goal.rotation
    turned = similarity(first[:, 0], last[:, 0]) @ first
    return replace(group, orientation="space", goal=GroupPose(group.goal.center, turned))


def _upright(
    group: RigidGroup, ends: tuple[Array, Array], own: list[Constraint], file: SceneFile, path: object
) -> RigidGroup:
    """Return the group in a frame that turns about the vertical only (in the plane: not at all).

    It keeps the tilt of the start, turned as little as possible so that hands of the same height are level.
    """
    allowed, level = TILT_ROUNDING, []
    for c in own:
        if isinstance(c, UprightConstraint):
            allowed = max(allowed, c.tolerance + TILT_ROUNDING)
        elif isinstance(c, SameHeightConstraint):
            along = np.subtract(*(group.grasps[group.members.index(i)] for i in (c.first, c.second)))
            level.append(group.start.rotation @ along)
            allowed = max(allowed, asin(min(1.0, 2 * c.tolerance / np.linalg.norm(along))))
    turn, up = group.start.rotation, np.eye(3)[file.dimension - 1]
    if level:
        turn = levelling(np.array(level), up) @ turn
        left = np.abs(levelling(np.array(level), up) @ np.array(level).T)[file.dimension - 1].max()
        if left > 1e-9:
            raise SceneError(
                f"hands of one load cannot be at the same height: turned at best they still differ by {left:.3g} m",
                file=path,
                key="constraints",
                way_out="leave one of the same_height constraints out",
            )
    kept = replace(
        group,
        grasps=group.grasps @ turn.T,
        corners=group.corners @ turn.T,
        orientation="fixed" if file.dimension == 2 else "vertical",
    )
    poses = [fit_pose(kept.grasps, hands, kept.orientation) for hands in ends]
    for end, pose, free in zip(("start", "goal"), poses, (group.start, group.goal), strict=True):
        tilt = tilt_between(group.orientation, free.rotation, pose.rotation @ turn)
        if tilt > allowed:
            who = ", ".join(f"'{file.names[i]}'" for i in group.members)
            how = "not turn" if file.dimension == 2 else "turn about the vertical only"
            unsaid = file.grasp is not None and not any(c.type == "upright" for c in file.constraints)
            raise SceneError(
                f"the body that {who} hold is tilted by {degrees(tilt):.3g} deg at the {end}, and it may {how} "
                f"({'as grasp implies; ' if unsaid else ''}tolerance {degrees(allowed):.3g} deg)",
                file=path,
                key=f"manipulators.{end}",
                way_out="keep the tilt of the start, or "
                + ("give {type: upright, tolerance_deg: ..}" if unsaid else "widen the tolerance"),
            )
    return replace(kept, start=poses[0], goal=poses[1])
