"""RRT-Connect for a load that a robot carries: every node of a tree stores the joints too.

An edge is free if the load and its hands keep their clearance along it, and if all arms can follow it from the joints
of the node where it begins, without a jump, while the links keep their clearance. The two trees meet in the load's
configuration; whether the joints of both belong to one branch is checked when the whole path is followed from the
start.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.compiled import kernel
from comove.model.blocks import place_one
from comove.planning import trees
from comove.planning.clock import worked
from comove.planning.configurations import (
    Space,
    clearance_of,
    edge_is_free,
    interpolate,
    nearest,
    random_configuration,
    span,
)
from comove.planning.planner import continuous
from comove.planning.trees import copy_to, rrt_connect, shortened
from comove.robots.search.chains import reach_pose
from comove.robots.search.following import SEARCHING, Arms, hand_rotation, posture_on
from comove.robots.search.links import ENOUGH, ROUGH, clearance_at, links_clearance, place_links
from comove.robots.search.ranges import may_reach

Array = NDArray[np.float64]

LEADING = SEARCHING._replace(tolerance=1e-3, most=12)
"""Iteration for a pose on an edge, which begins further away than a sample of a movement."""
FOLLOWING_WORK = 2000  # distances of segments that a pose of all arms takes as long as


class ArmPlanSettings(NamedTuple):
    """Settings of plans in which arms follow the load.

    Attributes
    ----------
    sub_step : span between the poses that the arms are followed through [m]
    jump : turn of a joint within a sub-step that leads to another branch [rad]
    n_trees : pairs of trees that meet, where their paths cannot be followed from one end to the other
    n_draws : configurations drawn for each node at most; most of them are out of reach
    n_shortcuts : attempts to shorten a path
    spacing : span between the vertices of a path that is to be shortened, at most [m]
    shorter : span that a straight piece has to save, to be worth following it [m]
    """

    sub_step: float = 0.03
    jump: float = 0.4
    n_trees: int = 3
    n_draws: int = 50
    n_shortcuts: int = 80
    spacing: float = 0.05
    shorter: float = 0.02


SETTINGS = ArmPlanSettings()


class CarriedSpace(NamedTuple):
    """The space of a load and of the arms that carry it; a node is a configuration and the joints.

    Attributes
    ----------
    space : space of the load
    arms : arms that carry it
    n_columns : number of columns of a configuration
    course : array, shape (2, n_joints), joints at start and goal, between which redundant joints are drawn
    settings : settings of the plan
    clock : that of the space
    """

    space: Space
    arms: Arms
    n_columns: int
    course: Array
    settings: ArmPlanSettings
    clock: Array


def plan_with_arms(
    space: Space,
    arms: Arms,
    start: tuple[Array, Array],
    goal: tuple[Array, Array],
    margin: float,
    rng: np.random.Generator,
    *,
    required: float,
    lenient: float = 0.0,
    max_nodes: int,
    densely: bool = False,
    settings: ArmPlanSettings = SETTINGS,
) -> tuple[Array, Array] | None:
    """Plan a path of the load that the arms can follow from start to goal; None where none was found.

    Parameters
    ----------
    arms : the arms that carry the load
    start, goal : configuration of the load, array of shape (n_columns,), and joints, array of shape (n_joints,)
    margin : margin of the clearance of load and links above the required one [m]; less where the ends have less
    required : required clearance of the load [m]
    lenient : amount by which the clearance of links may be less [m], as the verification computes it more exactly
    densely : return configurations at most `spacing` apart, with joints that were followed from the start

    Returns
    -------
    arrays, shapes (n_configurations, n_columns) and (n_configurations, n_joints): configurations and their joints
    """
    spare = min(_links_at(space, arms, q, joints) for q, joints in (start, goal)) - arms.around.clearance
    kept = arms.around.clearance + min(margin - lenient, 0.5 * spare if spare > 0.0 else spare - ROUGH)
    arms = arms._replace(around=arms.around._replace(clearance=kept))
    scratch = np.empty((space.blocks.node.shape[0], 3))
    at_ends = min(clearance_of(space, q, scratch, 0.0) for q, _ in (start, goal))
    margin = min(required + margin, 0.5 * (required + at_ends))
    course = np.stack([start[1], goal[1]])
    world, n = CarriedSpace(space, arms, len(start[0]), course, settings, space.clock), len(start[0])
    find = _way if densely else _planned
    path = find(world, np.concatenate(start), np.concatenate(goal), margin, rng, max_nodes)
    return (continuous(space, path[:, :n]), np.ascontiguousarray(path[:, n:])) if len(path) else None


def _links_at(space: Space, arms: Arms, q: Array, joints: Array) -> float:
    """Compute the clearance of the links at a configuration of the load with these joints [m]."""
    nodes = np.empty((space.blocks.node.shape[0], 3))
    place_one(space.blocks, q, 1.0, nodes)
    return clearance_at(arms.chains, arms.links, arms.around, joints, nodes, ENOUGH)


@kernel
def _planned(
    world: CarriedSpace, start: Array, goal: Array, margin: float, rng: np.random.Generator, max_nodes: int
) -> Array:
    """Plan a path and shorten it, anew where trees have met in joints that do not; it is empty where none was found.

    Parameters
    ----------
    start, goal : arrays, shape (n_values,), configuration of the load and joints

    Returns
    -------
    array, shape (n_configurations, n_values)
    """
    nothing, how = np.empty((0, start.shape[0])), world.settings
    for _ in range(how.n_trees):
        path = rrt_connect(world, start, goal, margin, rng, max_nodes, how.n_draws * max_nodes, nothing)
        if path.shape[0] == 0:
            return nothing
        path = _dense(world.space, path, how.spacing)
        if _follow(world, path):
            return shortened(world, path, margin, rng, how.n_shortcuts)
    return nothing


@kernel
def _way(
    world: CarriedSpace, start: Array, goal: Array, margin: float, rng: np.random.Generator, max_nodes: int
) -> Array:
    """Plan as `_planned` does, and follow the path once more: it comes back dense, with all joints."""
    path = _planned(world, start, goal, margin, rng, max_nodes)
    if path.shape[0] == 0:
        return path
    path = _dense(world.space, path, world.settings.spacing)
    return path if _follow(world, path) else path[:0]


@kernel
def _dense(space: Space, path: Array, spacing: float) -> Array:
    """Return the path with intermediate vertices, at most `spacing` [m] apart, whose joints are not known yet."""
    counts, n = np.ones(path.shape[0], dtype=np.int64), 1
    for k in range(1, path.shape[0]):
        counts[k] = max(1, int(np.ceil(span(space, path[k - 1], path[k]) / spacing)))
        n += counts[k]
    out, row = np.empty((n, path.shape[1])), 0
    copy_to(path[0], out[0])
    for k in range(1, path.shape[0]):
        for i in range(1, counts[k]):
            interpolate(space, path[k - 1], path[k], i / counts[k], out[row + i])
        row += counts[k]
        copy_to(path[k], out[row])
    return out


@kernel
def _follow(world: CarriedSpace, path: Array) -> bool:
    """Write the joints along a path from those of the start; returns False where the arms cannot follow."""
    n = world.n_columns
    copy_to(world.course[0], path[0, n:])
    for k in range(1, path.shape[0]):
        copy_to(path[k - 1, n:], path[k, n:])
        if not follow_edge(world, path[k - 1], path[k], path[k, n:]):
            return False
    return True


@kernel
def follow_edge(world: CarriedSpace, p: Array, target: Array, joints: Array) -> bool:
    """Follow an edge with all arms, joints in place; returns False where an arm does not reach, jumps or comes too
    near.
    """
    space, how = world.space, world.settings
    chains, links, around = world.arms.chains, world.arms.links, world.arms.around
    nodes, at, rotation = np.empty((space.blocks.node.shape[0], 3)), np.empty_like(p), np.empty((3, 3))
    before, posture = np.empty_like(joints), np.empty_like(joints)
    start, end = links.start.copy(), links.end.copy()
    count = max(1, int(np.ceil(span(space, p, target) / how.sub_step)))
    for step in range(1, count + 1):
        if worked(space.clock, FOLLOWING_WORK + links.joint.shape[0] * around.obstacles.shape[0]):
            return False
        interpolate(space, p, target, step / count, at)
        place_one(space.blocks, at, 1.0, nodes)
        posture_on(world.course, around, nodes, posture)
        copy_to(joints, before)
        for i in range(chains.first.shape[0] - 1):
            hand_rotation(around, nodes, i, rotation)
            left = reach_pose(chains, i, rotation, nodes[i], posture, LEADING, joints)
            if left > LEADING.tolerance:
                return False
        for j in range(joints.shape[0]):
            if abs(joints[j] - before[j]) > how.jump:
                return False
        place_links(chains, links, joints, start, end)
        need = around.clearance
        if links_clearance(links, around, start, end, nodes, need + 0.01) < need:
            return False
    return True


@trees.answers(trees.extend, CarriedSpace)
@kernel
def _extend(world: CarriedSpace, p: Array, q: Array, steps: float, margin: float, out: Array) -> int:
    space, n, scratch = world.space, world.n_columns, np.empty(p.shape[0])
    way, nodes = span(space, p, q), np.empty((space.blocks.node.shape[0], 3))
    interpolate(space, p, q, min(1.0, space.settings.step * steps / max(way, 1e-12)), out)
    if not edge_is_free(space, p, out, margin, scratch, nodes):
        return trees.BLOCKED
    copy_to(p[n:], out[n:])
    if not follow_edge(world, p, out, out[n:]):
        return trees.BLOCKED
    if way > space.settings.step * steps:
        return trees.FREE
    for c in range(n, q.shape[0]):  # in the joints of q, not in those of another branch; a random q has none
        if abs(out[c] - q[c]) > world.settings.jump:
            return trees.BLOCKED
    return trees.ARRIVED


@trees.answers(trees.nearest, CarriedSpace)
@kernel
def _nearest(world: CarriedSpace, tree: Array, count: int, q: Array) -> int:
    return nearest(world.space, tree, count, q)


@trees.answers(trees.draw, CarriedSpace)
@kernel
def _draw(
    world: CarriedSpace,
    nodes: Array,
    counts: NDArray[np.int64],
    this: int,
    rng: np.random.Generator,
    out: Array,
) -> bool:
    random_configuration(world.space, rng, out)
    for c in range(world.n_columns, out.shape[0]):
        out[c] = np.nan
    nodes, rotation = np.empty((world.space.blocks.node.shape[0], 3)), np.empty((3, 3))
    place_one(world.space.blocks, out, 1.0, nodes)
    for i in range(world.arms.chains.first.shape[0] - 1):
        hand_rotation(world.arms.around, nodes, i, rotation)
        if not may_reach(world.arms.ranges, i, rotation, nodes[i]):
            return False
    return True


@trees.answers(trees.between, CarriedSpace)
@kernel
def _between(world: CarriedSpace, p: Array, q: Array, share: float, out: Array) -> bool:
    interpolate(world.space, p, q, share, out)
    copy_to(p[world.n_columns :], out[world.n_columns :])
    return follow_edge(world, p, out, out[world.n_columns :])


@trees.answers(trees.length, CarriedSpace)
@kernel
def _length(world: CarriedSpace, p: Array, q: Array) -> float:
    return span(world.space, p, q)


@trees.answers(trees.shortens, CarriedSpace)
@kernel
def _shortens(world: CarriedSpace, p: Array, q: Array, way: float) -> bool:
    return span(world.space, p, q) <= way - world.settings.shorter
