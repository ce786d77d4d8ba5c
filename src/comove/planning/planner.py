"""Planners in the load's own configuration space: RRT-Connect, a forest for space, and shortcuts.

Every configuration on a path holds the rigid constraints by construction, and every edge is checked by
conservative advancement.
"""

from __future__ import annotations

from math import sqrt

import numba
import numpy as np
from numpy.typing import NDArray

from comove.coordination.coordinates import ANGLE, DIRECTION, POINT, QUATERNION
from comove.planning.configurations import (
    Space,
    clearance_of,
    copy_to,
    edge_is_free,
    in_an_obstacle,
    interpolate,
    random_configuration,
    random_orientation,
    span,
)
from comove.scenes.distances import CENTER, REACH, point_distance

Array = NDArray[np.float64]

STEP = 0.1  # m, of an RRT extension
FEW_NODES, MANY_NODES = 1000, 10000  # of a first attempt (restarts beat patience), and of the last
N_SHORTCUTS = 100
RETRACTIONS = 30  # random steps by which a pose in collision may escape
TOURNAMENT = 2  # nodes drawn to find one worth expanding
NEIGHBOURS, CONNECT_WITHIN = 6, 0.5  # of the forest; m
PLANE_MARGINS = (0.008, 0.004, 0.002, 0.0005)  # m, tried in turn
SPACE_MARGINS = (0.008, 0.004, 0.002, 0.004)


def plan(
    space: Space,
    start: Array,
    goal: Array,
    margin: float,
    rng: np.random.Generator,
    *,
    required: float = 0.0,
    max_nodes: int = FEW_NODES,
) -> Array | None:
    """A shortened path from start to goal that keeps a margin, or None where none was found.

    Parameters
    ----------
    start, goal : arrays, shape (n_columns,)
    margin : clearance kept along the path [m] on top of `required`; less where the ends have less
    max_nodes : after which the planner gives up

    Returns
    -------
    array, shape (n_configurations, n_columns), angles unwrapped and quaternions of continuous sign
    """
    scratch = np.empty((space.blocks.node.shape[0], 3))
    at_ends = min(clearance_of(space, q, scratch) for q in (start, goal))
    margin = min(required + margin, 0.5 * (required + at_ends))
    grow = _rrt_connect if space.blocks.n_dims == 2 or len(space.blocks.kind) > 1 else _forest
    path = grow(space, start, goal, margin, rng, max_nodes)
    if len(path) == 0:
        return None
    return continuous(space, _shortened(space, path, margin, rng, N_SHORTCUTS))


def continuous(space: Space, path: Array) -> Array:
    """The same path (n_configurations, n_columns), angles unwrapped and quaternions of continuous sign."""
    path = path.copy()
    blocks = space.blocks
    for kind, o in zip(blocks.kind, blocks.turn, strict=True):
        if kind == ANGLE:
            path[:, o] = np.unwrap(path[:, o])
        elif kind == QUATERNION:
            turn = path[:, o : o + 4]
            signs = np.where((turn[1:] * turn[:-1]).sum(axis=1) < 0, -1.0, 1.0)
            turn[1:] *= np.cumprod(signs)[:, None]
    return path


@numba.njit(cache=True, error_model="numpy")
def along(space, path, shares):
    """Configurations at given shares of a path's length (in spans).

    Parameters
    ----------
    path : array, shape (n_configurations, n_columns)
    shares : array, shape (n_profiles, n_steps), between 0 and 1 and not decreasing along the steps

    Returns
    -------
    array, shape (n_profiles, n_steps, n_columns)
    """
    n = path.shape[0]
    reached = np.zeros(n)
    for i in range(n - 1):
        reached[i + 1] = reached[i] + span(space, path[i], path[i + 1])
    out = np.empty((shares.shape[0], shares.shape[1], path.shape[1]))
    for profile in range(shares.shape[0]):
        i = 0
        for t in range(shares.shape[1]):
            length = shares[profile, t] * reached[n - 1]
            while i < n - 2 and reached[i + 1] < length:
                i += 1
            f = (length - reached[i]) / max(reached[i + 1] - reached[i], 1e-12)
            interpolate(space, path[i], path[i + 1], min(1.0, max(0.0, f)), out[profile, t])
    return out


@numba.njit(cache=True, error_model="numpy")
def _rrt_connect(space, start, goal, margin, rng, max_nodes):
    """RRT-Connect (Kuffner and LaValle, 2000); an empty path where it fails."""
    n_columns = start.shape[0]
    trees = np.empty((2, max_nodes, n_columns))
    parents = np.full((2, max_nodes), -1)
    counts = np.ones(2, dtype=np.int64)
    copy_to(start, trees[0, 0])
    copy_to(goal, trees[1, 0])
    sample, target, scratch = np.empty(n_columns), np.empty(n_columns), np.empty(n_columns)
    nodes = np.empty((space.blocks.node.shape[0], 3))
    if edge_is_free(space, start, goal, margin, scratch, nodes):
        copy_to(goal, trees[0, 1])
        return trees[0, :2].copy()
    this = 0
    for _ in range(20 * max_nodes):
        if counts[0] + counts[1] + 2 >= max_nodes:
            break
        random_configuration(space, rng, sample)
        near = nearest(space, trees[this], counts[this], sample)
        towards(space, trees[this, near], sample, STEP, target)
        if edge_is_free(space, trees[this, near], target, margin, scratch, nodes):
            new = counts[this]
            copy_to(target, trees[this, new])
            parents[this, new] = near
            counts[this] += 1
            other = 1 - this
            at = nearest(space, trees[other], counts[other], target)
            while counts[other] + 1 < max_nodes:
                arrived = towards(space, trees[other, at], trees[this, new], STEP, target)
                if not edge_is_free(space, trees[other, at], target, margin, scratch, nodes):
                    break
                end = counts[other]
                copy_to(target, trees[other, end])
                parents[other, end] = at
                counts[other] += 1
                at = end
                if arrived:
                    mine, theirs = (new, at) if this == 0 else (at, new)
                    return joined(trees, parents, mine, theirs)
        this = 1 - this
    return np.empty((0, n_columns))


@numba.njit(cache=True, error_model="numpy")
def nearest(space, tree, count, q):
    best, least = 0, np.inf
    for i in range(count):
        distance = span(space, tree[i], q)
        if distance < least:
            best, least = i, distance
    return best


@numba.njit(cache=True, error_model="numpy")
def towards(space, p, q, step, out):
    """Go from p towards q, at most `step`; True where q is reached."""
    length = span(space, p, q)
    interpolate(space, p, q, min(1.0, step / max(length, 1e-12)), out)
    return length <= step


@numba.njit(cache=True, error_model="numpy")
def joined(trees, parents, mine, theirs):
    """Path from the root of tree 0 through `mine` ~ `theirs` to the root of tree 1."""
    depths = np.zeros(2, dtype=np.int64)
    for tree in range(2):
        i = mine if tree == 0 else theirs
        while i >= 0:
            depths[tree] += 1
            i = parents[tree, i]
    path = np.empty((depths[0] + depths[1], trees.shape[2]))
    i, row = mine, depths[0] - 1
    while i >= 0:
        copy_to(trees[0, i], path[row])
        i, row = parents[0, i], row - 1
    i, row = theirs, depths[0]
    while i >= 0:
        copy_to(trees[1, i], path[row])
        i, row = parents[1, i], row + 1
    return path


@numba.njit(cache=True, error_model="numpy")
def _forest(space, start, goal, margin, rng, max_nodes):
    """Trees grown from windows, existing nodes and free space until start and goal are in one.

    In space a bar must enter a window nearly end-on: uniform samples hardly ever do, poses that bridge
    two obstacles and slides along the bar's own axis do.
    """
    n_columns = start.shape[0]
    tree, member = np.empty((max_nodes, n_columns)), np.empty(max_nodes, dtype=np.int64)
    links = np.empty((max_nodes, 2), dtype=np.int64)
    n_links, count = 0, 2
    copy_to(start, tree[0])
    copy_to(goal, tree[1])
    member[0], member[1] = 0, 1
    room = np.full(max_nodes, space.cap)
    new, scratch = np.empty(n_columns), np.empty(n_columns)
    nodes = np.empty((space.blocks.node.shape[0], 3))
    if edge_is_free(space, start, goal, margin, scratch, nodes):
        return tree[:2].copy()
    for trial in range(40 * max_nodes):
        if count >= max_nodes:
            break
        draw = rng.random()
        if (count < 32 and trial < 1000) or draw < 0.1:
            found = _bridge(space, rng, margin, new, scratch, nodes)
        elif draw < 0.64:
            i = _node_to_expand(member, room, count, rng)
            _perturb(space, tree[i], 1.0, True, rng, new)
            found = _retract(space, new, margin, RETRACTIONS, rng, scratch, nodes)
        else:
            random_configuration(space, rng, new)
            found = clearance_of(space, new, nodes) > margin
        if not found:
            continue
        copy_to(new, tree[count])
        member[count], room[count] = count, clearance_of(space, new, nodes)
        count += 1
        n_links = _link(space, tree, member, count, links, n_links, margin, scratch, nodes)
        if member[0] == member[1]:
            return _path_through(tree, links, n_links, count)
    return np.empty((0, n_columns))


@numba.njit(cache=True, error_model="numpy")
def _link(space, tree, member, count, links, n_links, margin, scratch, nodes):
    """Connect the newest node to its nearest neighbours in other trees."""
    new = count - 1
    distances = np.empty(new)
    for i in range(new):
        distances[i] = span(space, tree[i], tree[new])
    for _ in range(NEIGHBOURS):
        near, least = -1, CONNECT_WITHIN
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


@numba.njit(cache=True, error_model="numpy")
def _node_to_expand(member, room, count, rng):
    """A random node, preferably of a tree that holds neither start nor goal, else one in tight space."""
    best, least = 0, np.inf
    for _ in range(TOURNAMENT):
        i = rng.integers(0, count)
        if member[i] != member[0] and member[i] != member[1]:
            return i
        if room[i] < least:
            best, least = i, room[i]
    return best


@numba.njit(cache=True, error_model="numpy")
def _bridge(space, rng, margin, out, scratch, nodes):
    """A free pose centred between two obstacle points that are near each other; False where none was found."""
    obstacles, n_obstacles = space.obstacles, space.obstacles.shape[0]
    n_dims = space.blocks.n_dims
    if n_obstacles == 0:
        return False
    a, b = np.zeros(3), np.zeros(3)
    for _ in range(200):
        j = rng.integers(0, n_obstacles)
        inside = True
        for axis in range(n_dims):
            low = max(space.lower[axis], obstacles[j, CENTER + axis] - obstacles[j, REACH])
            high = min(space.upper[axis], obstacles[j, CENTER + axis] + obstacles[j, REACH])
            inside &= low < high
            a[axis] = low + rng.random() * (high - low)
            b[axis] = a[axis] + 0.1 * rng.standard_normal()
        if not inside or point_distance(obstacles, j, a[0], a[1], a[2]) > 0.0:
            continue
        if not in_an_obstacle(obstacles, b[0], b[1], b[2]):
            continue
        x, y, z = 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2])
        if in_an_obstacle(obstacles, x, y, z):
            continue
        for axis in range(n_dims):
            out[axis] = 0.5 * (a[axis] + b[axis])
        for _ in range(4):
            random_orientation(space.blocks.kind[0], n_dims, n_dims, rng, out)
            if _retract(space, out, margin, 4 * RETRACTIONS, rng, scratch, nodes):
                return True
    return False


@numba.njit(cache=True, error_model="numpy")
def _retract(space, q, margin, n_trials, rng, scratch, nodes):
    """Move a pose, in place, by random steps that gain clearance until it keeps the margin; False if it does not.

    Hardly any random pose is free in a narrow passage, but many are near a free one.
    """
    clearance, size = clearance_of(space, q, nodes, -np.inf), 1.0
    for _ in range(n_trials):
        if clearance > margin:
            return True
        _perturb(space, q, size, False, rng, scratch)
        gained = clearance_of(space, scratch, nodes, clearance)
        if gained > clearance:
            copy_to(scratch, q)
            clearance, size = gained, min(1.0, 1.5 * size)
        else:
            size *= 0.8
    return clearance > margin


@numba.njit(cache=True, error_model="numpy")
def _perturb(space, q, size, may_slide, rng, out):
    """A pose near q, `size` a share of the usual step; for a bar half of the time one slid along its own axis."""
    n_dims, kind, reach = space.blocks.n_dims, space.blocks.kind[0], max(space.reach[0], 1e-6)
    slide = may_slide and kind == DIRECTION and rng.random() < 0.5
    shift = (2.0 * rng.random() - 1.0) * 2.4 * reach if slide else 0.0
    move, turn = (0.004, 0.025) if slide else (0.05 * size, 0.025 * size / reach)
    for c in range(q.shape[0]):
        out[c] = q[c]
    for axis in range(n_dims):
        out[axis] += move * rng.standard_normal()
        if slide:
            out[axis] += shift * q[n_dims + axis]
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


@numba.njit(cache=True, error_model="numpy")
def _path_through(tree, links, n_links, count):
    """The path from node 0 to node 1 over the links, which form trees."""
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


@numba.njit(cache=True, error_model="numpy")
def _shortened(space, path, margin, rng, n_trials):
    """Replace pieces between random points of the path by straight edges where these are free."""
    n_columns = path.shape[1]
    count = path.shape[0]
    work = np.empty((count + 2 * n_trials + 2, n_columns))
    for row in range(count):
        copy_to(path[row], work[row])
    p, q, scratch = np.empty(n_columns), np.empty(n_columns), np.empty(n_columns)
    nodes = np.empty((space.blocks.node.shape[0], 3))
    lengths = np.empty(work.shape[0])
    for _ in range(n_trials):
        if count <= 2:
            break
        total = 0.0
        for i in range(count - 1):
            lengths[i] = span(space, work[i], work[i + 1])
            total += lengths[i]
        u, v = rng.random() * total, rng.random() * total
        u, v = min(u, v), max(u, v)
        i, j, at_i, at_j = 0, 0, 0.0, 0.0
        while i < count - 2 and at_i + lengths[i] < u:
            at_i += lengths[i]
            i += 1
        while j < count - 2 and at_j + lengths[j] < v:
            at_j += lengths[j]
            j += 1
        if i == j:
            continue
        interpolate(space, work[i], work[i + 1], (u - at_i) / max(lengths[i], 1e-12), p)
        interpolate(space, work[j], work[j + 1], (v - at_j) / max(lengths[j], 1e-12), q)
        if span(space, p, q) > v - u - 1e-6 or not edge_is_free(space, p, q, margin, scratch, nodes):
            continue
        moved = 2 - (j - i)  # rows i+1 .. j give way to p and q
        if moved > 0:
            for row in range(count - 1, j, -1):
                copy_to(work[row], work[row + moved])
        elif moved < 0:
            for row in range(j + 1, count):
                copy_to(work[row], work[row + moved])
        copy_to(p, work[i + 1])
        copy_to(q, work[i + 2])
        count += moved
    return work[:count].copy()
