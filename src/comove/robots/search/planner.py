"""RRT-Connect for a load that a robot carries: every node of a tree stores the joints too.

An edge is free if the load and its hands keep their clearance along it, and if all arms can follow it from the joints
of the node where it begins, without a jump, while the links keep their clearance. The two trees meet in the load's
configuration; whether the joints of both belong to one branch is checked when the whole path is followed from the
start.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from comove.coordination.blocks import place_one
from comove.planning.clock import worked
from comove.planning.configurations import (
    Space,
    clearance_of,
    copy_to,
    edge_is_free,
    interpolate,
    random_configuration,
    span,
)
from comove.planning.planner import STEP, continuous, joined, nearest, towards
from comove.robots.search.chains import reach_pose
from comove.robots.search.following import KEEP, LOOSE, PULL, Arms, hand_rotation
from comove.robots.search.links import ENOUGH, ROUGH, links_clearance, place_links

Array = NDArray[np.float64]

SUB_STEP = 0.03  # m of span, between the poses that the arms are followed through
JUMP = 0.4  # rad, of a joint within a sub-step: another branch
N_SHORTCUTS = 80
REACHED = 1e-3  # m, residual at which an arm follows
MOST = 12  # iterations a pose
FOLLOWING_WORK = 2000  # distances of segments that a pose of all arms takes as long as
SPACING = 0.05  # m, between the vertices of a path that is to be shortened


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
) -> Array | None:
    """Plan a path of the load that the arms can follow from start to goal; None where none was found.

    Parameters
    ----------
    arms : the arms that carry the load
    start, goal : configuration of the load, array of shape (n_columns,), and joints, array of shape (n_joints,)
    margin : margin of the clearance of load and links above the required one [m]; less where the ends have less
    required : required clearance of the load [m]
    lenient : amount by which the clearance of links may be less [m], as the judge computes it more exactly

    Returns
    -------
    array, shape (n_configurations, n_columns)
    """
    spare = min(_links_at(space, arms, q, joints) for q, joints in (start, goal)) - arms.around.clearance
    kept = arms.around.clearance + min(margin - lenient, 0.5 * spare if spare > 0.0 else spare - ROUGH)
    arms = arms._replace(around=arms.around._replace(clearance=kept))
    scratch = np.empty((space.blocks.node.shape[0], 3))
    at_ends = min(clearance_of(space, q, scratch) for q, _ in (start, goal))
    margin = min(required + margin, 0.5 * (required + at_ends))
    path = _rrt_connect(space, arms, *start, *goal, margin, rng, max_nodes)
    if len(path) == 0:
        return None
    path = _dense(space, path)
    joints = _followed(space, arms, path, start[1])
    if len(joints) < len(path):
        return None
    return continuous(space, _shortened(space, arms, path, joints, margin, rng))


def _links_at(space: Space, arms: Arms, q: Array, joints: Array) -> float:
    """Compute the clearance of the links at a configuration of the load with these joints [m]."""
    links, around, nodes = arms.links, arms.around, np.empty((space.blocks.node.shape[0], 3))
    place_one(space.blocks, q, 1.0, nodes)
    a, b = links.start.copy(), links.end.copy()
    place_links(arms.chains, links, joints, a, b)
    return links_clearance(links, a, b, around.obstacles, nodes, around.edges, around.radii, ENOUGH)


def _dense(space: Space, path: Array) -> Array:
    """Return the path with intermediate vertices, at most `SPACING` apart."""
    rows = [path[0]]
    for p, q in zip(path[:-1], path[1:], strict=True):
        count = int(np.ceil(span(space, p, q) / SPACING))
        for i in range(1, count):
            out = np.empty_like(p)
            interpolate(space, p, q, i / count, out)
            rows.append(out)
        rows.append(q)
    return np.array(rows)


def _shortened(
    space: Space, arms: Arms, path: Array, joints: Array, margin: float, rng: np.random.Generator
) -> Array:
    """Replace pieces of the path by straight edges where load and arms can go there."""
    for _ in range(N_SHORTCUTS):
        if len(path) <= 2:
            break
        i, j = np.sort(rng.integers(0, len(path), 2))
        if j - i < 2:
            continue
        edge = _dense(space, path[[i, j]])
        if len(edge) > j - i:  # no shorter, to the spacing of the vertices
            continue
        if not _clear(space, edge[0], edge[-1], margin):
            continue
        followed = _followed(space, arms, edge, joints[i])
        if len(followed) == len(edge) and np.abs(followed[-1] - joints[j]).max() < JUMP:
            path = np.concatenate([path[:i], edge, path[j + 1 :]])
            joints = np.concatenate([joints[:i], followed, joints[j + 1 :]])
    return path


def _clear(space: Space, p: Array, q: Array, margin: float) -> bool:
    nodes = np.empty((space.blocks.node.shape[0], 3))
    return edge_is_free(space, p, q, margin, np.empty_like(p), nodes)


@numba.njit(cache=True, error_model="numpy")
def _followed(space, arms, path, joints):
    """Compute the joints along a path, as far as the arms can follow; array, shape (n_followed, n_joints)."""
    out = np.empty((path.shape[0], joints.shape[0]))
    copy_to(joints, out[0])
    for k in range(1, path.shape[0]):
        copy_to(out[k - 1], out[k])
        if not follow_edge(space, arms, path[k - 1], path[k], out[k]):
            return out[:k]
    return out


@numba.njit(cache=True, error_model="numpy")
def follow_edge(space, arms, p, target, joints):
    """Follow an edge with all arms, joints in place; returns False where an arm does not reach, jumps or comes too
    near.
    """
    chains, links, around = arms.chains, arms.links, arms.around
    nodes = np.empty((space.blocks.node.shape[0], 3))
    at, rotation, before = np.empty_like(p), np.empty((3, 3)), np.empty_like(joints)
    start, end = links.start.copy(), links.end.copy()
    count = max(1, int(np.ceil(span(space, p, target) / SUB_STEP)))
    for step in range(1, count + 1):
        if worked(space.clock, FOLLOWING_WORK + links.joint.shape[0] * around.obstacles.shape[0]):
            return False
        interpolate(space, p, target, step / count, at)
        place_one(space.blocks, at, 1.0, nodes)
        copy_to(joints, before)
        for i in range(chains.first.shape[0] - 1):
            hand_rotation(around, nodes, i, rotation)
            left = reach_pose(
                chains, i, rotation, nodes[i], around.posture, PULL, KEEP, REACHED, LOOSE, MOST, joints
            )
            if left > REACHED:
                return False
        for j in range(joints.shape[0]):
            if abs(joints[j] - before[j]) > JUMP:
                return False
        place_links(chains, links, joints, start, end)
        need = around.clearance
        if (
            links_clearance(
                links, start, end, around.obstacles, nodes, around.edges, around.radii, need + 0.01
            )
            < need
        ):
            return False
    return True


@numba.njit(cache=True, error_model="numpy")
def _rrt_connect(space, arms, start, start_joints, goal, goal_joints, margin, rng, max_nodes):
    """Run RRT-Connect (Kuffner and LaValle, 2000) with joints; returns an empty path where it fails."""
    n_columns, n_joints = start.shape[0], start_joints.shape[0]
    trees, bodies = np.empty((2, max_nodes, n_columns)), np.empty((2, max_nodes, n_joints))
    parents = np.full((2, max_nodes), -1)
    counts = np.ones(2, dtype=np.int64)
    copy_to(start, trees[0, 0])
    copy_to(goal, trees[1, 0])
    copy_to(start_joints, bodies[0, 0])
    copy_to(goal_joints, bodies[1, 0])
    sample, target, scratch = np.empty(n_columns), np.empty(n_columns), np.empty(n_columns)
    nodes, joints = np.empty((space.blocks.node.shape[0], 3)), np.empty(n_joints)
    this = 0
    for trial in range(20 * max_nodes):
        if counts[0] + counts[1] + 2 >= max_nodes or worked(space.clock, counts[this]):
            break
        if trial > 0:
            random_configuration(space, rng, sample)
        else:
            copy_to(goal, sample)
        near = nearest(space, trees[this], counts[this], sample)
        towards(space, trees[this, near], sample, STEP, target)
        if edge_is_free(space, trees[this, near], target, margin, scratch, nodes):
            copy_to(bodies[this, near], joints)
            if follow_edge(space, arms, trees[this, near], target, joints):
                new = counts[this]
                copy_to(target, trees[this, new])
                copy_to(joints, bodies[this, new])
                parents[this, new] = near
                counts[this] += 1
                other = 1 - this
                at = nearest(space, trees[other], counts[other], target)
                while counts[other] + 1 < max_nodes:
                    arrived = towards(space, trees[other, at], trees[this, new], STEP, target)
                    if not edge_is_free(space, trees[other, at], target, margin, scratch, nodes):
                        break
                    copy_to(bodies[other, at], joints)
                    if not follow_edge(space, arms, trees[other, at], target, joints):
                        break
                    end = counts[other]
                    copy_to(target, trees[other, end])
                    copy_to(joints, bodies[other, end])
                    parents[other, end] = at
                    counts[other] += 1
                    at = end
                    if arrived:
                        mine, theirs = (new, at) if this == 0 else (at, new)
                        return joined(trees, parents, mine, theirs)
        this = 1 - this
    return np.empty((0, n_columns))
