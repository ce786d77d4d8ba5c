"""Plans of payloads with arms: trees whose nodes hold the joints too.

An edge is followed from the joints of the node where it begins: every arm has to reach its grasp on each of many
poses without a jump, while links keep their clearance from everything there at that time. The trees of both ends
meet in the payload's configuration; whether the joints of both belong to one inverse-kinematics solution is checked
when the whole path is followed from the start.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from comove.arrays import Array
from comove.compiled import copy_to, kernel
from comove.model.blocks import place_one
from comove.planning.clock import worked
from comove.planning.configurations import clearance_in_time, span
from comove.planning.planner import continuous
from comove.planning.timing import drift, instant_of, time_for_joints
from comove.planning.trees import rrt_connect, shortened
from comove.planning.world import World, between, follow, reaches
from comove.robots.search.chains import reach_pose
from comove.robots.search.following import SEARCHING, Arms, hand_rotation, posture_on
from comove.robots.search.links import ENOUGH, ROUGH, clearances_at, links_clearance, place_links
from comove.robots.search.ranges import may_reach

LEADING = SEARCHING._replace(tolerance=1e-3, most=12)
"""Iteration for a pose on an edge, which begins further away than a sample of a movement."""
FOLLOWING_WORK = 2000  # distances of segments that a pose of all arms takes as long as


class ArmPlanSettings(NamedTuple):
    """Settings of plans in which arms follow the payload.

    Attributes
    ----------
    sub_step : span between the poses that the arms are followed through [m]
    jump : rotation of a joint within a sub-step that leads to another solution branch [rad]
    settling : turn of a joint within a sub-step that takes no time, as redundant joints come to rest [rad]
    n_trees : pairs of trees that meet, where their paths cannot be followed from one end to the other
    n_draws : configurations drawn for each node at most; most of them are out of reach
    n_shortcuts : attempts to shorten a path
    spacing : largest span between the vertices of a path before it is shortened [m]
    shorter : least saving of a straight piece that is followed [m]
    """

    sub_step: float = 0.03
    jump: float = 0.4
    settling: float = 0.02
    n_trees: int = 3
    n_draws: int = 50
    n_shortcuts: int = 80
    spacing: float = 0.05
    shorter: float = 0.02


SETTINGS = ArmPlanSettings()


class CarryingArms(NamedTuple):
    """The arms that hold a payload, for a world of nodes.

    Attributes
    ----------
    arms : arms among the obstacles of the world's space
    n_columns : number of columns of a configuration, after which joints follow in a node
    course : array, shape (2, n_joints), joints at start and goal, between which redundant joints are drawn
    settings : settings of the plan
    """

    arms: Arms
    n_columns: int
    course: Array
    settings: ArmPlanSettings


def plan_with_arms(
    world: World,
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
) -> tuple[Array, Array, Array] | None:
    """Plan a payload path that the arms can follow; None if there is none.

    Parameters
    ----------
    world : world of the payload alone, with times or without
    arms : the arms that hold the payload
    start, goal : configuration of the payload, array of shape (n_columns,), and joints, array of shape (n_joints,)
    margin : margin of the clearance of payload and links above the required one [m]; less where the ends have less
    required : required clearance of the payload [m]
    lenient : amount by which the clearance of links may be less [m], as the verification computes it more exactly
    densely : return configurations at most `spacing` apart, with joints that were followed from the start

    Returns
    -------
    arrays, shapes (n_configurations, n_columns), (n_configurations, n_joints) and (n_configurations, 0 or 1):
    configurations, their joints, and their normalised times, if any
    """
    space, n, timed = world.space, len(start[0]), world.timing.timed
    if timed:
        arms = arms.among(space.around.obstacles, world.timing.moved)
    nodes = [np.concatenate([*end, [t] * timed]) for end, t in ((start, 0.0), (goal, 1.0))]
    scratch, spare, at_ends = np.empty((space.blocks.node.shape[0], 3)), [], []
    for node in nodes:
        spare.append(_links_at(world, arms, node, n) - arms.around.clearance)
        at_ends.append(clearance_in_time(space, world.timing, node, scratch, 0.0))
    kept = min(margin - lenient, 0.5 * min(spare) if min(spare) > 0.0 else min(spare) - ROUGH)
    arms = arms._replace(around=arms.around._replace(clearance=arms.around.clearance + kept))
    margin = min(required + margin, 0.5 * (required + min(at_ends)))
    world = World.of(space, world.timing, CarryingArms(arms, n, np.stack([start[1], goal[1]]), settings))
    path = (_way if densely else _planned)(world, *nodes, margin, rng, max_nodes)
    if not len(path):
        return None
    q, joints, time = np.split(path, [n, n + len(start[1])], axis=1)
    return continuous(space, q), np.ascontiguousarray(joints), time


def _links_at(world: World, arms: Arms, node: Array, n: int) -> float:
    """Compute the links' clearance at a node [m]. Its first n values are a configuration."""
    nodes, q = np.empty((world.space.blocks.node.shape[0], 3)), node[None, n : n + len(arms.chains.lower)]
    place_one(world.space.blocks, node, 1.0, nodes)
    instant = instant_of(world.timing, node)
    return float(clearances_at(arms.chains, arms.links, arms.around, instant, q.copy(), nodes, ENOUGH)[0])


@kernel
def _planned(
    world: World, start: Array, goal: Array, margin: float, rng: np.random.Generator, max_nodes: int
) -> Array:
    """Plan and shorten a path; it is empty without success. Trees that meet in different joints are grown anew.

    Parameters
    ----------
    start, goal : arrays, shape (n_values,), nodes

    Returns
    -------
    array, shape (n_nodes, n_values)
    """
    nothing, how = np.empty((0, start.shape[0])), world.arms.settings
    for _ in range(how.n_trees):
        path = rrt_connect(world, start, goal, margin, rng, max_nodes, how.n_draws * max_nodes, nothing)
        if path.shape[0] == 0:
            return nothing
        path = dense(world, path)
        if follow_path(world, path):
            return shortened(world, path, margin, rng, how.n_shortcuts, False)
    return nothing


@kernel
def _way(
    world: World, start: Array, goal: Array, margin: float, rng: np.random.Generator, max_nodes: int
) -> Array:
    """Plan as `_planned`, and follow the path again. It returns dense, with all joints."""
    path = _planned(world, start, goal, margin, rng, max_nodes)
    if path.shape[0] == 0:
        return path
    path = dense(world, path)
    return path if follow_path(world, path) else path[:0]


@kernel
def dense(world: World, path: Array) -> Array:
    """Return the path with intermediate nodes, at most `spacing` [m] apart. Their joints are unknown."""
    counts, n, spacing = np.ones(path.shape[0], dtype=np.int64), 1, world.arms.settings.spacing
    for k in range(1, path.shape[0]):
        counts[k] = max(1, int(np.ceil(span(world.space, path[k - 1], path[k]) / spacing)))
        n += counts[k]
    out, row = np.empty((n, path.shape[1])), 0
    copy_to(path[0], out[0])
    for k in range(1, path.shape[0]):
        for i in range(1, counts[k]):
            between(world, path[k - 1], path[k], i / counts[k], out[row + i])
        row += counts[k]
        copy_to(path[k], out[row])
    return out


@kernel
def follow_path(world: World, path: Array) -> bool:
    """Write the joints along a path from the start; return whether arms can follow."""
    n, course = world.arms.n_columns, world.arms.course
    copy_to(course[0], path[0, n : n + course.shape[1]])
    for k in range(1, path.shape[0]):
        if not follow_edge(world.arms, world, path[k - 1], path[k]):
            return False
    return True


@follow.answered_for(CarryingArms)
@kernel
def follow_edge(carrying: CarryingArms, world: World, p: Array, target: Array) -> bool:
    """Follow an edge from p's joints, written at its end; return success.

    It fails where an arm does not reach, jumps, lacks the time, or comes too near.
    """
    space, how, course, (chains, links, _, around) = (
        world.space,
        carrying.settings,
        carrying.course,
        carrying.arms,
    )
    nodes, rotation = np.empty((space.blocks.node.shape[0], 3)), np.empty((3, 3))
    at = np.empty_like(p)
    joints = target[carrying.n_columns : carrying.n_columns + course.shape[1]]
    copy_to(p[carrying.n_columns : carrying.n_columns + course.shape[1]], joints)
    before, posture = np.empty_like(joints), np.empty_like(joints)
    start, end = links.start.copy(), links.end.copy()
    way = max(span(space, p, target), drift(world.timing, p, target))
    count = max(1, int(np.ceil(way / how.sub_step)))
    seconds = time_for_joints(world.timing, p, target) / count
    for step in range(1, count + 1):
        if worked(space.clock, FOLLOWING_WORK + links.joint.shape[0] * around.obstacles.shape[0]):
            return False
        between(world, p, target, step / count, at)
        place_one(space.blocks, at, 1.0, nodes)
        posture_on(course, around, nodes, posture)
        copy_to(joints, before)
        for i in range(chains.first.shape[0] - 1):
            hand_rotation(around, nodes, i, rotation)
            left = reach_pose(chains, i, rotation, nodes[i], posture, LEADING, joints)
            if left > LEADING.tolerance:
                return False
        for j in range(joints.shape[0]):
            if abs(joints[j] - before[j]) > min(how.jump, how.settling + seconds * chains.velocity[j]):
                return False
        place_links(chains, links, joints, start, end)
        need, instant = around.clearance, instant_of(world.timing, at)
        if links_clearance(links, around, instant, start, end, nodes, need + 0.01) < need:
            return False
    return True


@reaches.answered_for(CarryingArms)
@kernel
def _may_reach(carrying: CarryingArms, world: World, node: Array) -> bool:
    arms = carrying.arms
    for c in range(carrying.n_columns, carrying.n_columns + carrying.course.shape[1]):
        node[c] = np.nan
    nodes, rotation = np.empty((world.space.blocks.node.shape[0], 3)), np.empty((3, 3))
    place_one(world.space.blocks, node, 1.0, nodes)
    for i in range(arms.chains.first.shape[0] - 1):
        hand_rotation(arms.around, nodes, i, rotation)
        if not may_reach(arms.ranges, i, rotation, nodes[i]):
            return False
    return True
