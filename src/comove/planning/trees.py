"""Tree search and shortcuts for planners of every kind: RRT-Connect (Kuffner and LaValle, 2000).

A *world* answers seven questions about *nodes*: configurations of a payload with the joints of its arms and with
times, if any (`world.World`), or the joints of a robot alone (`robots.free_space.Room`). The former is a named tuple,
whose answers are kernels; the latter is a Python object with methods of these names, for which the searches run
uncompiled (`rrt_connect.py_func`). Every world has a `clock`.
"""

from __future__ import annotations

import numpy as np

from comove.compiled import Question, copy_to, kernel
from comove.planning.clock import worked

BLOCKED, FREE, ARRIVED = 0, 1, 2
WORTHWHILE = 1e-3  # share of a path's length that a shortcut saves at least
WHOLE = np.inf  # steps of an extension that goes all the way


@Question
def draw(world, trees, counts, this, rng, out):
    """Write a random node for tree `this`; return whether it can be of use."""
    return world.draw(trees, counts, this, rng, out)


@Question
def nearest(world, tree, count, q):
    """Return the number of the node nearest to q; -1 if there is none."""
    return world.nearest(tree, count, q)


@Question
def extend(world, p, q, steps, margin, out):
    """Write a node some steps from p towards q; return blocked, free or arrived."""
    return world.extend(p, q, steps, margin, out)


@Question
def between(world, p, q, share, out):
    """Write the node at a share of an edge. Values that follow from p are left out."""
    world.between(p, q, share, out)


@Question
def exists(world, p, node):
    """Complete a node on a free edge from p; return whether it exists."""
    return world.exists(p, node)


@Question
def length(world, p, q):
    """Return an edge's length, by which points on paths are sampled."""
    return world.length(p, q)


@Question
def shortens(world, p, q, way, margin):
    """Return whether a straight edge may replace a path of length `way`."""
    return world.shortens(p, q, way, margin)


@kernel(nogil=True)
def rrt_connect(world, start, goal, margin, rng, max_nodes, max_draws, before):
    """Grow a tree from each end until they meet; return the path. It is empty if they do not meet.

    Parameters
    ----------
    start, goal : arrays, shape (n_values,), nodes
    margin : clearance that edges keep [m]
    max_nodes : number of nodes of both trees after which the search ends
    max_draws : number of random nodes after which the search ends
    before : array, shape (n_before, n_values), path of an earlier plan, whose free ends begin the trees; may be empty

    Returns
    -------
    array, shape (n_nodes, n_values)
    """
    width = start.shape[0]
    trees, parents = np.empty((2, max_nodes, width)), np.full((2, max_nodes), -1)
    counts = np.ones(2, dtype=np.int64)
    copy_to(start, trees[0, 0])
    copy_to(goal, trees[1, 0])
    sample, new = np.empty(width), np.empty(width)
    if extend(world, start, goal, WHOLE, margin, new) == ARRIVED:
        copy_to(goal, trees[0, 1])
        return trees[0, :2].copy()
    for this in range(2):
        for k in range(1, before.shape[0] - 1):
            last, row = counts[this] - 1, k if this == 0 else before.shape[0] - 1 - k
            if counts[this] >= max_nodes // 2:
                break
            if extend(world, trees[this, last], before[row], WHOLE, margin, new) != ARRIVED:
                break
            counts[this] = _added(trees, parents, counts, this, new, last)
    this = np.int64(
        0
    )  # a plain 0 is a type of its own, for which all that takes it would be compiled once more
    for _ in range(max_draws):
        if counts[0] + counts[1] + 2 >= max_nodes or worked(world.clock, counts[this]):
            break
        if not draw(world, trees, counts, this, rng, sample):
            continue
        near = nearest(world, trees[this], counts[this], sample)
        if near < 0:
            continue
        if extend(world, trees[this, near], sample, 1.0, margin, new) != BLOCKED:
            counts[this] = _added(trees, parents, counts, this, new, near)
            other, tip = 1 - this, counts[this] - 1
            at = nearest(world, trees[other], counts[other], trees[this, tip])
            while at >= 0 and counts[other] + 1 < max_nodes:
                reached = extend(world, trees[other, at], trees[this, tip], 1.0, margin, new)
                if reached == BLOCKED:
                    break
                counts[other] = _added(trees, parents, counts, other, new, at)
                at = counts[other] - 1
                if reached == ARRIVED:
                    return _joined(trees, parents, tip, at) if this == 0 else _joined(trees, parents, at, tip)
        this = 1 - this
    return np.empty((0, width))


@kernel
def _added(trees, parents, counts, tree, node, parent):
    """Add a node to a tree; return its new number of nodes."""
    copy_to(node, trees[tree, counts[tree]])
    parents[tree, counts[tree]] = parent
    return counts[tree] + 1


@kernel
def _joined(trees, parents, mine, theirs):
    """Return the path between the roots of both trees. Node `mine` of tree 0 coincides with `theirs` of tree 1."""
    count, i = 0, mine
    while i >= 0:
        count, i = count + 1, parents[0, i]
    first, i = count, parents[1, theirs]
    while i >= 0:
        count, i = count + 1, parents[1, i]
    path = np.empty((count, trees.shape[2]))
    i = mine
    for row in range(first - 1, -1, -1):
        copy_to(trees[0, i], path[row])
        i = parents[0, i]
    i = parents[1, theirs]
    for row in range(first, count):
        copy_to(trees[1, i], path[row])
        i = parents[1, i]
    return path


@kernel(nogil=True)
def shortened(world, path, margin, rng, n_trials, near):
    """Replace random pieces of a path by free straight edges; return it.

    If `near`, most of them are short, as most of these are free, and each saves a thousandth of the path or more.
    """
    count, width = path.shape[0], path.shape[1]
    work, lengths = np.empty((count + 2 * n_trials + 2, width)), np.empty(count + 2 * n_trials + 2)
    for row in range(count):
        copy_to(path[row], work[row])
    p, q, end, total = np.empty(width), np.empty(width), np.empty(width), -1.0
    for _ in range(n_trials):
        if count <= 2:
            break
        if total < 0.0:  # the path has changed
            total = 0.0
            for i in range(count - 1):
                lengths[i] = length(world, work[i], work[i + 1])
                total += lengths[i]
        u, v = rng.random() * total, rng.random() * total
        if near:
            v = abs(u + (2.0 * v / total - 1.0) ** 3 * total)
            v = total - abs(total - v)
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
        between(world, work[i], work[i + 1], (u - at_i) / max(lengths[i], 1e-12), p)
        between(world, work[j], work[j + 1], (v - at_j) / max(lengths[j], 1e-12), q)
        if not (
            shortens(world, p, q, v - u - WORTHWHILE * total, margin)
            and exists(world, work[i], p)
            and exists(world, work[j], q)
        ):
            continue
        if extend(world, p, q, WHOLE, margin, end) != ARRIVED:
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
        count, total = count + moved, -1.0
    return work[:count].copy()
