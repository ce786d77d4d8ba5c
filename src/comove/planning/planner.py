"""Planners in the payload's configuration space: RRT-Connect, multi-tree RRT and shortcuts.

Every configuration on a path satisfies the rigid constraints by construction, and every edge keeps its margin all
along (`comove.planning.configurations`).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

import numpy as np

from comove.arrays import Array
from comove.compiled import copy_to, kernel
from comove.geometry.distances import CENTER, REACH, ROTATION, point_distance
from comove.model.blocks import keep_mask
from comove.model.coordinates import ANGLE, DIRECTION, POINT, QUATERNION
from comove.planning.clock import worked
from comove.planning.configurations import (
    Space,
    clearance_of,
    distances_along,
    edge_is_free,
    in_an_obstacle,
    interpolate,
    may_be_within,
    random_configuration,
    random_turn,
    span,
)
from comove.planning.trees import rrt_connect, shortened
from comove.planning.world import World


class ForestSettings(NamedTuple):
    """Settings of the multi-tree RRT.

    Attributes
    ----------
    n_bridges, bridges : number of bridges before other nodes are added, and their share afterwards
    slides : lengths of slides between two obstacles, in terms of the reach
    retractions, settling : random steps by which a pose in collision may escape, and by which a bridge gains
        clearance
    projections : projections onto each of two obstacles, for points that face each other
    in_place, stays : limits that keep a bridge in its window: of its steps, in terms of the usual step, and of all of
        them together, in terms of the reach
    tournament : nodes drawn to find one worth expanding
    neighbours, within : number of nodes that a new one is connected to, and their largest distance [m]
    """

    n_bridges: int = 32
    bridges: float = 0.3
    slides: tuple[float, float, float, float] = (2.4, 1.8, 1.2, 0.6)
    retractions: int = 30
    settling: int = 16
    projections: int = 4
    in_place: float = 0.3
    stays: float = 0.3
    tournament: int = 2
    neighbours: int = 6
    within: float = 0.5


FOREST = ForestSettings()


@dataclass(frozen=True)
class PlannerSettings:
    """Settings of `plan`.

    Attributes
    ----------
    few_nodes : number of nodes of a first attempt: restarts beat long attempts
    brief, brief_forest : numbers of nodes of brief attempts by RRT-Connect and the multi-tree RRT, for paths that are
        easy
    sure : lead of the multi-tree RRT in paths found, after which RRT-Connect is not tried any more
    n_shortcuts : number of shortcuts that are tried
    forest : settings of the multi-tree RRT
    """

    few_nodes: int = 1000
    brief: int = 200
    brief_forest: int = 250
    sure: int = 3
    n_shortcuts: int = 400
    forest: ForestSettings = FOREST


SETTINGS = PlannerSettings()


def plan(
    space: Space,
    start: Array,
    goal: Array,
    margin: float,
    rng: np.random.Generator,
    *,
    required: float = 0.0,
    max_nodes: int = SETTINGS.few_nodes,
    settings: PlannerSettings = SETTINGS,
) -> Array | None:
    """Plan and shorten a path that keeps a margin; None if there is none.

    Parameters
    ----------
    start, goal : arrays, shape (n_columns,)
    margin : clearance that is kept along the path beyond `required` [m]; less if the ends have less
    max_nodes : number of nodes after which planning ends, as it does at the deadline of the space's clock

    Returns
    -------
    array, shape (n_configurations, n_columns), angles unwrapped and quaternions of continuous sign
    """
    scratch, nothing = np.empty((space.blocks.node.shape[0], 3)), np.empty((0, len(start)))
    world = World.of(space)
    at_ends = min(clearance_of(space, start, scratch, 0.0), clearance_of(space, goal, scratch, 0.0))
    margin = kept_margin(at_ends, margin, required)
    for grows_forest, most in _turns(space, max_nodes, settings):
        if grows_forest:
            flat = flat_direction(space.blocks.point)
            path = forest(space, flat, start, goal, margin, rng, most, settings.forest)
        else:
            path = rrt_connect(world, start, goal, margin, rng, most, 20 * most, nothing)
        if len(path) > 0:
            space.found[int(grows_forest)] += 1
            return continuous(space, shortened(world, path, margin, rng, settings.n_shortcuts, True))
    return None


def kept_margin(at_ends: float, margin: float, required: float) -> float:
    """Return the clearance that a path keeps [m]: less where its ends have less."""
    return min(required + margin, 0.5 * (required + at_ends))


def _turns(space: Space, max_nodes: int, settings: PlannerSettings) -> list[tuple[bool, int]]:
    """Return the planners in order: whether it is the multi-tree RRT, and its nodes.

    In the plane RRT-Connect suffices, and for several bodies there is no other. In space each of the two is much
    faster on scenes on which the other rarely finds a path: they take turns until one has found more paths.
    """
    if space.blocks.n_dims == 2 or len(space.blocks.kind) > 1:
        return [(False, max_nodes)]
    lead, few = space.found[1] - space.found[0], min(max_nodes, settings.few_nodes)
    if lead >= settings.sure:
        return [(True, max_nodes)]
    if lead > 0:
        return [(False, settings.brief), (True, max_nodes)]
    if lead < 0:
        return [(False, few), (True, max_nodes)]
    return [(False, settings.brief), (True, min(few, settings.brief_forest)), (False, few), (True, max_nodes)]


def continuous(space: Space, path: Array) -> Array:
    """Return a path with unwrapped angles and continuous quaternions; array, shape (n_configurations, n_columns)."""
    path = path.copy()
    blocks = space.blocks
    for kind, o in zip(blocks.kind, blocks.turn, strict=True):
        if kind == ANGLE:
            turns = np.round(np.diff(path[:, o]) / (2 * np.pi))
            path[1:, o] -= 2 * np.pi * np.cumsum(turns)
        elif kind == QUATERNION:
            turn = path[:, o : o + 4]
            signs = np.where((turn[1:] * turn[:-1]).sum(axis=1) < 0, -1.0, 1.0)
            turn[1:] *= np.cumprod(signs)[:, None]
    return path


@kernel
def along(space, path, shares):
    """Interpolate a path at shares of its length, the sum of spans.

    Parameters
    ----------
    path : array, shape (n_configurations, n_columns)
    shares : array, shape (n_profiles, n_steps), between 0 and 1 and not decreasing along the steps

    Returns
    -------
    array, shape (n_profiles, n_steps, n_columns)
    """
    reached = distances_along(space, path)
    out, at = np.empty((shares.shape[0], shares.shape[1], path.shape[1])), np.empty(shares.shape[1])
    for profile in range(shares.shape[0]):
        for k in range(shares.shape[1]):  # an array expression would take much longer to compile
            at[k] = shares[profile, k] * reached[-1]
        sample(space, path, reached, at, out[profile])
    return out


@kernel
def sample(space, path, reached, at, out):
    """Write a path at times, or lengths, between those of its configurations.

    An array is filled and none returned, as assigning one to a row of another would take seconds to compile.

    Parameters
    ----------
    path : array, shape (n_configurations, n_columns)
    reached, at : arrays, shapes (n_configurations,) and (n_steps,), neither of them decreasing
    out : array, shape (n_steps, n_columns)
    """
    i = 0
    for row in range(at.shape[0]):
        while i < reached.shape[0] - 2 and reached[i + 1] < at[row]:
            i += 1
        f = (at[row] - reached[i]) / max(reached[i + 1] - reached[i], 1e-12)
        interpolate(space, path[i], path[i + 1], min(1.0, max(0.0, f)), out[row])


@kernel(nogil=True)
def forest(space, flat, start, goal, margin, rng, max_nodes, settings):
    """Grow many trees until one joins start and goal; return its path. It is empty if none is found.

    In space a bar must enter a window nearly end-on, and a flat body must enter a slot edge-on, which uniform samples
    hardly ever do. So poses with much clearance are sampled between two obstacles that face each other (bridge test);
    from these a bar slides along its own axis, another body along a side of an obstacle.
    """
    n_columns = start.shape[0]
    tree, member = np.empty((max_nodes, n_columns)), np.empty(max_nodes, dtype=np.int64)
    links = np.empty((max_nodes, 2), dtype=np.int64)
    n_links, count = 0, 2
    copy_to(start, tree[0])
    copy_to(goal, tree[1])
    member[0], member[1] = 0, 1
    room = np.full(max_nodes, space.cap)
    new, ends, scratch = np.empty(n_columns), np.empty(n_columns), np.empty(n_columns)
    along = np.zeros(5)
    nodes = np.empty((space.blocks.node.shape[0], 3))
    work = scratch, nodes
    if edge_is_free(space, start, goal, margin, scratch, nodes):
        return tree[:2].copy()
    for trial in range(40 * max_nodes):
        if count >= max_nodes or worked(space.clock, count):
            break
        draw = rng.random()
        between = -1  # one of the two obstacles, if the new pose is between two
        if (count < settings.n_bridges and trial < 1000) or draw < settings.bridges:
            between = _bridge(space, flat, rng, margin, new, work, settings)
            found = between >= 0
        elif draw < settings.bridges + 0.6 * (1.0 - settings.bridges):
            i = _node_to_expand(member, room, count, rng, settings)
            _perturb(space, tree[i], 1.0, rng.random() < 0.5, rng, new)
            found = _retract(space, new, margin, margin, (settings.retractions, 1.0), rng, work)
        else:
            random_configuration(space, rng, new)
            found = clearance_of(space, new, nodes, 0.0) > margin
        if not found:
            continue
        if between >= 0:
            along = _way_through(space, new, between, margin, ends, work, settings)
        copy_to(new, tree[count])
        member[count], room[count] = count, clearance_of(space, new, nodes, 0.0)
        count += 1
        n_links = _link(space, (tree, member), count, links, n_links, margin, work, settings)
        if between >= 0 and count + 2 <= max_nodes:
            middle = count - 1
            for side in range(2):
                length = along[3 + side]
                if length == 0.0:
                    continue
                _slid(space, tree[middle], along, length, new)
                copy_to(new, tree[count])
                member[count], room[count] = member[middle], clearance_of(space, new, nodes, 0.0)
                links[n_links, 0], links[n_links, 1] = middle, count
                count, n_links = count + 1, n_links + 1
                n_links = _link(space, (tree, member), count, links, n_links, margin, work, settings)
        if member[0] == member[1]:
            return _path_through(tree, links, n_links, count)
    return np.empty((0, n_columns))


@kernel
def _way_through(space, q, j, margin, out, work, settings):
    """Return the direction of a pose's longest slide, and both lengths [m].

    The array, shape (5,), ends with the signed lengths. A bar slides along its own axis, another body along one of
    those of obstacle j.
    """
    (scratch, nodes), n_dims, kind = work, space.blocks.n_dims, space.blocks.kind[0]
    best, along = np.zeros(5), np.zeros(5)
    for axis in range(1 if kind == DIRECTION else 3):
        for row in range(n_dims):
            along[row] = (
                q[n_dims + row] if kind == DIRECTION else space.around.obstacles[j, ROTATION + 3 * row + axis]
            )
        for side in range(2):
            along[3 + side] = 0.0
            for share in settings.slides:
                length = (1.0 - 2.0 * side) * share * space.reach[0]
                if _slid(space, q, along, length, out) and edge_is_free(
                    space, q, out, margin, scratch, nodes
                ):
                    along[3 + side] = length
                    break
        far, least = abs(along[3]) + abs(along[4]), min(abs(along[3]), abs(along[4]))
        if least + 1e-3 * far > min(abs(best[3]), abs(best[4])) + 1e-3 * (abs(best[3]) + abs(best[4])):
            copy_to(along, best)
    return best


@kernel(counted=False)
def _slid(space, q, along, length, out):
    """Write a pose moved along a direction; return whether its centre stays inside."""
    copy_to(q, out)
    inside = True
    for axis in range(space.blocks.n_dims):
        out[axis] += length * along[axis]
    keep_mask(space.blocks, out)
    for axis in range(space.blocks.n_dims):
        inside &= space.around.lower[axis] < out[axis] < space.around.upper[axis]
    return inside


@kernel
def _link(space, trees, count, links, n_links, margin, work, settings):
    """Connect the newest node to its nearest neighbours in other trees; return the new number of links."""
    (tree, member), (scratch, nodes), new = trees, work, count - 1
    distances = np.empty(new)
    for i in range(new):
        distances[i] = np.inf
        if member[i] != member[new] and may_be_within(space, tree[i], tree[new], settings.within):
            distances[i] = span(space, tree[i], tree[new])
    for _ in range(settings.neighbours):
        near, least = -1, settings.within
        for i in range(new):
            if member[i] != member[new] and distances[i] < least:
                near, least = i, distances[i]
        if near < 0:
            break
        distances[near] = np.inf
        if edge_is_free(space, tree[near], tree[new], margin, scratch, nodes):
            links[n_links, 0], links[n_links, 1] = near, new
            n_links += 1
            old, kept = max(member[near], member[new]), min(member[near], member[new])
            for j in range(count):
                if member[j] == old:
                    member[j] = kept
    return n_links


@kernel
def _node_to_expand(member, room, count, rng, settings):
    """Return a random node to expand. Trees without start and goal come first, then little clearance."""
    best, least = 0, np.inf
    for _ in range(settings.tournament):
        i = rng.integers(0, count)
        if member[i] != member[0] and member[i] != member[1]:
            return i
        if room[i] < least:
            best, least = i, room[i]
    return best


@kernel
def _bridge(space, flat, rng, margin, out, work, settings):
    """Write a free pose centred between two near obstacles; return one, or -1."""
    obstacles, n_obstacles = space.around.obstacles, space.around.obstacles.shape[0]
    n_dims, widest = space.blocks.n_dims, 2.0 * space.reach[0]
    if n_obstacles < 2:
        return -1
    a, b, middle = np.zeros(3), np.zeros(3), np.zeros(3)
    for _ in range(200):
        j, k = rng.integers(0, n_obstacles), rng.integers(0, n_obstacles)
        if j == k:
            continue
        if worked(space.clock, n_obstacles):
            break
        for axis in range(n_dims):
            low = max(space.around.lower[axis], obstacles[j, CENTER + axis] - obstacles[j, REACH])
            high = min(space.around.upper[axis], obstacles[j, CENTER + axis] + obstacles[j, REACH])
            a[axis] = low + rng.random() * (high - low)
        for _ in range(settings.projections):
            _onto(obstacles, k, a, b)
            _onto(obstacles, j, b, a)
        gap, inside = 0.0, True
        for axis in range(n_dims):
            gap += (a[axis] - b[axis]) ** 2
            middle[axis] = 0.5 * (a[axis] + b[axis])
            inside &= space.around.lower[axis] < middle[axis] < space.around.upper[axis]
        if not inside or gap > widest**2 or in_an_obstacle(obstacles, middle[0], middle[1], middle[2]):
            continue
        for trial in range(8):
            for axis in range(n_dims):
                out[axis] = middle[axis]
            random_turn(space.blocks, 0, rng, out)
            if space.blocks.kind[0] == QUATERNION and trial % 2 == 0:
                _fit(space, j, flat, rng, out[n_dims:])
            keep_mask(space.blocks, out)
            if not _retract(space, out, margin, space.cap, (settings.settling, settings.in_place), rng, work):
                continue
            moved = 0.0
            for axis in range(n_dims):
                moved += (out[axis] - middle[axis]) ** 2
            if moved < (settings.stays * space.reach[0]) ** 2:
                return j
    return -1


@kernel
def _onto(obstacles, j, x, out):
    """Write approximately the nearest point of an obstacle to x."""
    h = 1e-5
    d = point_distance(obstacles, j, x[0], x[1], x[2])
    out[0] = x[0] - d * (point_distance(obstacles, j, x[0] + h, x[1], x[2]) - d) / h
    out[1] = x[1] - d * (point_distance(obstacles, j, x[0], x[1] + h, x[2]) - d) / h
    out[2] = x[2] - d * (point_distance(obstacles, j, x[0], x[1], x[2] + h) - d) / h


def flat_direction(points: Array) -> Array:
    """Return the unit vector of least spread of points, shape (n, 3)."""
    return np.ascontiguousarray(np.linalg.eigh(np.cov(points.T, bias=True))[1][:, 0])


@kernel
def _side(obstacles, j, axis, out):
    for row in range(3):
        out[row] = obstacles[j, ROTATION + 3 * row + axis]


@kernel
def _across(edge, flat, out):
    """Write the unit vector of an edge's part across `flat`; return its length [m]."""
    along, square = 0.0, 0.0
    for axis in range(3):
        along += edge[axis] * flat[axis]
    for axis in range(3):
        out[axis] = edge[axis] - along * flat[axis]
        square += out[axis] ** 2
    for axis in range(3):
        out[axis] /= max(sqrt(square), 1e-12)
    return sqrt(square)


@kernel
def _third(frame):
    """Write the third row of a frame: the cross product of the first two."""
    frame[2, 0] = frame[0, 1] * frame[1, 2] - frame[0, 2] * frame[1, 1]
    frame[2, 1] = frame[0, 2] * frame[1, 0] - frame[0, 0] * frame[1, 2]
    frame[2, 2] = frame[0, 0] * frame[1, 1] - frame[0, 1] * frame[1, 0]


@kernel
def _fit(space, j, flat, rng, out):
    """Write a quaternion that aligns a body with an obstacle's sides. Its flat side and an edge are aligned.

    A polygon is narrowest perpendicular to one of its edges (Houle and Toussaint, 1988), and fits a slot that way.
    """
    points, edge, k = space.blocks.point, np.zeros(3), rng.integers(0, 3)
    if space.around.edges.shape[0] > 0:
        chosen = rng.integers(0, space.around.edges.shape[0])
        for i in range(points.shape[0]):
            for end in range(2):
                if space.blocks.node[i] == space.around.edges[chosen, end]:
                    for axis in range(3):
                        edge[axis] += (2.0 * end - 1.0) * points[i, axis]
    own, wanted, turn = np.empty((3, 3)), np.empty((3, 3)), np.zeros((3, 3))
    copy_to(flat, own[0])
    if _across(edge, flat, own[1]) < 1e-9:  # no edge perpendicular to `flat`: any direction will do
        edge[0], edge[1], edge[2] = flat[1], flat[2], flat[0]
        _across(edge, flat, own[1])
    for row in range(2):
        sign = 1.0 if rng.random() < 0.5 else -1.0
        _side(space.around.obstacles, j, k if row == 0 else (k + rng.integers(1, 3)) % 3, wanted[row])
        for axis in range(3):
            wanted[row, axis] *= sign
    _third(own)
    _third(wanted)
    for row in range(3):
        for column in range(3):
            for i in range(3):
                turn[row, column] += wanted[i, row] * own[i, column]
    quaternion_of(turn, out)


@kernel
def quaternion_of(r, out):
    """Write the quaternion of a rotation matrix, computed from its largest component."""
    squares = np.array(
        [
            1.0 + r[0, 0] + r[1, 1] + r[2, 2],
            1.0 + r[0, 0] - r[1, 1] - r[2, 2],
            1.0 - r[0, 0] + r[1, 1] - r[2, 2],
            1.0 - r[0, 0] - r[1, 1] + r[2, 2],
        ]
    )
    largest = np.argmax(squares)
    twice = sqrt(squares[largest])
    skew = np.array([0.0, r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    for i in range(4):
        if i == largest:
            out[i] = 0.5 * twice
        elif i == 0 or largest == 0:
            out[i] = 0.5 * skew[i + largest] / twice
        else:
            out[i] = 0.5 * (r[i - 1, largest - 1] + r[largest - 1, i - 1]) / twice


@kernel(counted=False)
def _retract(space, q, margin, wished, trials, rng, work):
    """Gain clearance of a pose by random steps, in place.

    Hardly any random pose is free in a narrow passage, but many are near a free one. It ends at a clearance of
    `wished`. `trials` are the number of steps and the size of the widest.

    Returns
    -------
    bool, whether the pose has more clearance than the margin
    """
    (n_trials, widest), (scratch, nodes) = trials, work
    clearance, size = clearance_of(space, q, nodes, -np.inf), widest
    for _ in range(n_trials):
        if clearance > wished:
            return True
        _perturb(space, q, size, False, rng, scratch)
        gained = clearance_of(space, scratch, nodes, clearance)
        if gained > clearance:
            copy_to(scratch, q)
            clearance, size = gained, min(widest, 1.5 * size)
        else:
            size *= 0.8
    return clearance > margin


@kernel
def _perturb(space, q, size, slides, rng, out):
    """Write a random pose near q; `size` is the step as a share of the usual step.

    If it slides, a bar does so along its own axis, another body along a side of an obstacle.
    """
    n_dims, kind, reach = space.blocks.n_dims, space.blocks.kind[0], max(space.reach[0], 1e-6)
    n_obstacles = space.around.obstacles.shape[0]
    slide = slides and (kind == DIRECTION or (kind == QUATERNION and n_obstacles > 0))
    j, side = 0, 0
    if slide and kind != DIRECTION:
        j, side = rng.integers(0, n_obstacles), rng.integers(0, 3)
    shift = (2.0 * rng.random() - 1.0) * 2.4 * reach if slide else 0.0
    move, turn = (0.004, 0.025) if slide else (0.05 * size, 0.025 * size / reach)
    for c in range(q.shape[0]):
        out[c] = q[c]
    for axis in range(n_dims):
        out[axis] += move * rng.standard_normal()
        if slide:
            along = q[n_dims + axis]
            if kind != DIRECTION:
                along = space.around.obstacles[j, ROTATION + 3 * axis + side]
            out[axis] += shift * along
    if kind == ANGLE:
        out[n_dims] += turn * rng.standard_normal()
    elif kind != POINT:
        if kind == QUATERNION:
            turn *= 0.5
        norm = 0.0
        for c in range(n_dims, q.shape[0]):
            out[c] += turn * rng.standard_normal()
            norm += out[c] ** 2
        for c in range(n_dims, q.shape[0]):
            out[c] /= sqrt(norm)
    keep_mask(space.blocks, out)


@kernel
def _path_through(tree, links, n_links, count):
    """Return the path from node 0 to node 1 along links."""
    came = np.full(count, -1)
    came[0] = 0
    queue = np.empty(count, dtype=np.int64)
    queue[0] = 0
    head, tail = 0, 1
    while head < tail and came[1] < 0:
        at = queue[head]
        head += 1
        for i in range(n_links):
            for side in range(2):
                if links[i, side] == at and came[links[i, 1 - side]] < 0:
                    came[links[i, 1 - side]] = at
                    queue[tail] = links[i, 1 - side]
                    tail += 1
    length, at = 1, 1
    while at != 0:
        at = came[at]
        length += 1
    path = np.empty((length, tree.shape[1]))
    at = 1
    for row in range(length - 1, -1, -1):
        copy_to(tree[at], path[row])
        at = came[at]
    return path
