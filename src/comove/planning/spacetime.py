"""A planner in space and time, for obstacles whose motion is known.

Two trees grow in configurations and normalised time, forward from the start at 0 and backward from the goal at 1,
until they meet: RRT-Connect (Kuffner and LaValle, 2000) with samples that both ends can reach in time (Grothe et al.,
2022). An edge is free if the body keeps its margin along it while the obstacles move. This is checked by conservative
advancement, as the displacement of the body relative to the obstacles is bounded by the sum of its span and theirs.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from comove.geometry.distances import CENTER
from comove.planning.clock import worked
from comove.planning.configurations import (
    CREEPING,
    TOLERANCE,
    Space,
    clearance_of,
    copy_to,
    interpolate,
    random_configuration,
    span,
)
from comove.planning.planner import continuous
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

N_INTERVALS = 400  # intervals between the times at which the obstacles' positions are stored
STEP, TIME_STEP = 0.1, 0.05  # m and durations, largest extension of a tree
WAITING = 0.2  # probability that a sample is a configuration of the tree at another time
N_SHORTCUTS = 150
SHARES = (0.6, 0.8, 0.9, 0.7)  # of the speed limit, tried in turn: smoothed motions are faster in between
UNLIMITED = 5.0  # largest speed, in straight ways a duration, if nothing limits the speed
MARGINS = (0.02, 0.01, 0.005, 0.015)  # m, tried in turn
# Width of the smoothing, and time for acceleration and braking together, in durations.
SMOOTHINGS = ((0.003, 0.06), (0.01, 0.1), (0.02, 0.15), (0.03, 0.25), (0.04, 0.4), (0.05, 0.6), (0.07, 0.9))
# The initial velocity fades in so many times the time to brake, within these shares of the duration.
FADING, SHORTEST_LONGEST = 6.0, (0.05, 0.9)


class SpaceTime(NamedTuple):
    """A scene with moving obstacles, in the form that the planner's kernels take.

    Attributes
    ----------
    space : space with a table of obstacles that `set_time` moves
    origin : array, shape (n_rows, 3), centres of the obstacles at time 0 [m]
    offsets : array, shape (N_INTERVALS + 1, n_rows, 3), displacements of the obstacles at even times [m]
    fastest : largest speed of the obstacles [m a duration]
    """

    space: Space
    origin: Array
    offsets: Array
    fastest: float


def spacetime(scene: Scene, space: Space) -> SpaceTime:
    """Return the space of a scene together with the motion of its obstacles."""
    offsets = scene.by_row(scene.offsets(np.linspace(0.0, scene.duration, N_INTERVALS + 1)))
    fastest = np.linalg.norm(np.diff(offsets, axis=0), axis=2).max(initial=0.0) * N_INTERVALS
    table = space.obstacles.copy()
    origin = table[:, CENTER : CENTER + 3].copy()
    return SpaceTime(space._replace(obstacles=table), origin, offsets, float(fastest))


def plan_in_time(
    world: SpaceTime,
    start: Array,
    goal: Array,
    speed: float,
    margin: float,
    rng: np.random.Generator,
    *,
    max_nodes: int,
    before: Array | None = None,
) -> tuple[Array, Array] | None:
    """Plan and shorten a path from the start at time 0 to the goal at time 1; None if none is found.

    Parameters
    ----------
    start, goal : arrays, shape (n_columns,)
    speed : largest speed of a node [m a duration]
    margin : clearance that is kept beyond the scene's [m]; less if the ends have less
    max_nodes : number of nodes after which planning ends
    before : array, shape (n_before, n_columns), path of an earlier plan, at even times from 0 to 1

    Returns
    -------
    path : array, shape (n_configurations, n_columns), angles unwrapped and quaternions of continuous sign
    times : array, shape (n_configurations,), from 0 to 1
    """
    space, scratch = world.space, np.empty((world.space.blocks.node.shape[0], 3))
    at_ends = []
    for q, t in ((start, 0.0), (goal, 1.0)):
        set_time(world, t)
        at_ends.append(clearance_of(space, q, scratch))
    margin = min(space.required + margin, 0.5 * (space.required + min(at_ends)))
    before = np.empty((0, len(start))) if before is None else before
    path, times = _grow(world, start, goal, speed, margin, rng, max_nodes, before)
    if len(path) == 0:
        return None
    path, times = _shortened(world, path, times, speed, margin, rng, N_SHORTCUTS)
    return continuous(space, path), times


def targets_in_time(space: Space, path: Array, times: Array, n_steps: int) -> Array:
    """Smooth a path by several widths, at rest at both ends; array, shape (n_smoothings, n_steps, n_columns)."""
    s, smooth = np.linspace(0.0, 1.0, n_steps), []
    for width, ease in SMOOTHINGS:
        sampled = _sampled(space, path, times, _eased(s, ease))
        mirrored = np.pad(sampled, ((n_steps // 2,) * 2, (0, 0)), mode="reflect", reflect_type="odd")
        filtered = gaussian_filter1d(mirrored, width * n_steps, axis=0)
        smooth.append(filtered[n_steps // 2 : n_steps // 2 + n_steps])
    return np.stack(smooth)


def coast(velocity: Array, acceleration: float, n_steps: int) -> Array:
    """Return the displacement by which an initial velocity, which fades, changes a movement that begins at rest.

    Parameters
    ----------
    velocity : array, shape (n_columns,), rate of the configuration at the start [1 a duration]
    acceleration : limit of the hands' acceleration [m a duration squared]

    Returns
    -------
    array, shape (n_steps, n_columns)
    """
    s = np.linspace(0.0, 1.0, n_steps)[:, None]
    fading = np.clip(FADING * np.linalg.norm(velocity) / acceleration, *SHORTEST_LONGEST)
    return velocity * s * np.clip(1.0 - s / fading, 0.0, None) ** 3


def _eased(s: Array, ease: float) -> Array:
    """Map normalised times so that the pace rises from 0 in half of `ease`, and falls to 0 in the other half."""
    half = ease / 2
    slope = 1.0 / (1.0 - half)
    first = np.where(s < half, 0.5 * slope * s**2 / half, slope * (s - half / 2))
    rest = 1.0 - s
    return np.where(rest < half, 1.0 - 0.5 * slope * rest**2 / half, first)


@numba.njit(cache=True, error_model="numpy")
def set_time(world, t):
    """Move the obstacles to their positions at a normalised time."""
    at = min(max(t, 0.0), 1.0) * (world.offsets.shape[0] - 1)
    k = min(int(at), world.offsets.shape[0] - 2)
    f = at - k
    for j in range(world.origin.shape[0]):
        for axis in range(3):
            here, there = world.offsets[k, j, axis], world.offsets[k + 1, j, axis]
            world.space.obstacles[j, 1 + axis] = world.origin[j, axis] + here + f * (there - here)


@numba.njit(cache=True, error_model="numpy")
def edge_is_free_in_time(world, p, s, q, t, margin, scratch, nodes):
    """Return whether the body keeps the clearance `margin` [m] along the edge from p at time s to q at time t."""
    space = world.space
    length = span(space, p, q) + world.fastest * abs(t - s)
    travelled, creeping = 0.0, 0
    while travelled < length:
        f = travelled / length
        interpolate(space, p, q, f, scratch)
        set_time(world, s + f * (t - s))
        clearance = clearance_of(space, scratch, nodes) - margin
        creeping += clearance < TOLERANCE
        if clearance <= 0.0 or creeping > CREEPING:
            return False
        travelled += max(clearance, TOLERANCE)
    set_time(world, t)
    return clearance_of(space, q, nodes) > margin


@numba.njit(cache=True, error_model="numpy")
def _nearest(world, tree, times, count, q, t, speed, forward):
    """Return the node that can be joined to q at time t with the least effort; -1 if there is none."""
    best, least = -1, np.inf
    for i in range(count):
        wait = t - times[i] if forward else times[i] - t
        if wait <= 0.0:
            continue
        way = span(world.space, tree[i], q)
        if way <= speed * wait:
            effort = way / STEP + wait / TIME_STEP
            if effort < least:
                best, least = i, effort
    return best


@numba.njit(cache=True, error_model="numpy")
def _share(world, p, s, q, t):
    """Return the share of an edge that one extension covers."""
    return min(1.0, STEP / max(span(world.space, p, q), 1e-12), TIME_STEP / max(abs(t - s), 1e-12))


@numba.njit(cache=True, error_model="numpy")
def _grow(world, start, goal, speed, margin, rng, max_nodes, before):
    """Grow both trees; return path and times, which are empty if the trees do not meet."""
    space, n_columns = world.space, start.shape[0]
    trees, times = np.empty((2, max_nodes, n_columns)), np.zeros((2, max_nodes))
    parents, counts = np.full((2, max_nodes), -1), np.ones(2, dtype=np.int64)
    copy_to(start, trees[0, 0])
    copy_to(goal, trees[1, 0])
    times[1, 0] = 1.0
    sample, target, scratch = np.empty(n_columns), np.empty(n_columns), np.empty(n_columns)
    nodes = np.empty((space.blocks.node.shape[0], 3))
    nothing = np.empty((0, n_columns)), np.empty(0)
    if span(space, start, goal) > speed:
        return nothing
    if edge_is_free_in_time(world, start, 0.0, goal, 1.0, margin, scratch, nodes):
        copy_to(goal, trees[0, 1])
        times[0, 1] = 1.0
        return trees[0, :2].copy(), times[0, :2].copy()
    for this in range(2):
        _take_over(
            world, trees[this], times[this], parents[this], counts[this:], before, speed, margin, this == 0
        )
    this = 0
    for _ in range(40 * max_nodes):
        if counts[0] + counts[1] + 2 >= max_nodes or worked(space.clock, counts[this]):
            break
        if rng.random() < WAITING:
            copy_to(trees[this, int(rng.random() * counts[this])], sample)
        else:
            random_configuration(space, rng, sample)
        soonest, latest = span(space, start, sample) / speed, 1.0 - span(space, goal, sample) / speed
        if soonest >= latest:
            continue
        t = soonest + rng.random() * (latest - soonest)
        near = _nearest(world, trees[this], times[this], counts[this], sample, t, speed, this == 0)
        if near < 0:
            continue
        f = _share(world, trees[this, near], times[this, near], sample, t)
        interpolate(space, trees[this, near], sample, f, target)
        at = times[this, near] + f * (t - times[this, near])
        free = edge_is_free_in_time(
            world, trees[this, near], times[this, near], target, at, margin, scratch, nodes
        )
        if free:
            new = counts[this]
            copy_to(target, trees[this, new])
            times[this, new], parents[this, new] = at, near
            counts[this] += 1
            other = 1 - this
            i = _nearest(world, trees[other], times[other], counts[other], target, at, speed, other == 0)
            while i >= 0 and counts[other] + 1 < max_nodes:
                f = _share(world, trees[other, i], times[other, i], trees[this, new], at)
                interpolate(space, trees[other, i], trees[this, new], f, target)
                t = times[other, i] + f * (at - times[other, i])
                free = edge_is_free_in_time(
                    world, trees[other, i], times[other, i], target, t, margin, scratch, nodes
                )
                if not free:
                    break
                end = counts[other]
                copy_to(target, trees[other, end])
                times[other, end], parents[other, end] = t, i
                counts[other] += 1
                i = end
                if f == 1.0:
                    mine, theirs = (new, i) if this == 0 else (i, new)
                    return _joined(trees, times, parents, mine, theirs)
        this = 1 - this
    return nothing


@numba.njit(cache=True, error_model="numpy")
def _take_over(world, tree, times, parents, count, before, speed, margin, forward):
    """Add the path of an earlier plan to a tree as a branch, from the root on as far as it is still free."""
    n, scratch = before.shape[0], np.empty(before.shape[1])
    nodes = np.empty((world.space.blocks.node.shape[0], 3))
    for k in range(1, n - 1):
        row = k if forward else n - 1 - k
        t, last = row / (n - 1), count[0] - 1
        if count[0] >= tree.shape[0] // 2 or span(world.space, tree[last], before[row]) > speed * abs(
            t - times[last]
        ):
            return
        if not edge_is_free_in_time(world, tree[last], times[last], before[row], t, margin, scratch, nodes):
            return
        copy_to(before[row], tree[count[0]])
        times[count[0]], parents[count[0]] = t, last
        count[0] += 1


@numba.njit(cache=True, error_model="numpy")
def _joined(trees, times, parents, mine, theirs):
    """Return path and times from the root of tree 0 via `mine`, which coincides with `theirs`, to that of tree 1."""
    count, i = 0, mine
    while i >= 0:
        count, i = count + 1, parents[0, i]
    first, i = count, parents[1, theirs]
    while i >= 0:
        count, i = count + 1, parents[1, i]
    path, at = np.empty((count, trees.shape[2])), np.empty(count)
    i = mine
    for row in range(first - 1, -1, -1):
        copy_to(trees[0, i], path[row])
        at[row] = times[0, i]
        i = parents[0, i]
    i = parents[1, theirs]
    for row in range(first, count):
        copy_to(trees[1, i], path[row])
        at[row] = times[1, i]
        i = parents[1, i]
    return path, at


@numba.njit(cache=True, error_model="numpy")
def _sampled(space, path, times, s):
    """Interpolate a path at the increasing normalised times s, (n_steps,); array, shape (n_steps, n_columns)."""
    out, i = np.empty((s.shape[0], path.shape[1])), 0
    for row in range(s.shape[0]):
        while i < times.shape[0] - 2 and times[i + 1] < s[row]:
            i += 1
        f = (s[row] - times[i]) / max(times[i + 1] - times[i], 1e-12)
        interpolate(space, path[i], path[i + 1], min(1.0, max(0.0, f)), out[row])
    return out


@numba.njit(cache=True, error_model="numpy")
def _shortened(world, path, times, speed, margin, rng, n_trials):
    """Replace pieces of a path by straight edges of constant pace, where these are free; return path and times."""
    space, count, n_columns = world.space, path.shape[0], path.shape[1]
    work, at = np.empty((count + 2 * n_trials + 2, n_columns)), np.empty(count + 2 * n_trials + 2)
    for row in range(count):
        copy_to(path[row], work[row])
        at[row] = times[row]
    p, q, scratch = np.empty(n_columns), np.empty(n_columns), np.empty(n_columns)
    nodes = np.empty((space.blocks.node.shape[0], 3))
    for _ in range(n_trials):
        if count <= 2:
            break
        u, v = rng.random(), rng.random()
        u, v = min(u, v), max(u, v)
        i, j = 0, 0
        while at[i + 1] < u:
            i += 1
        while at[j + 1] < v:
            j += 1
        if i == j:
            continue
        interpolate(space, work[i], work[i + 1], (u - at[i]) / max(at[i + 1] - at[i], 1e-12), p)
        interpolate(space, work[j], work[j + 1], (v - at[j]) / max(at[j + 1] - at[j], 1e-12), q)
        if span(space, p, q) > speed * (v - u):
            continue
        if not edge_is_free_in_time(world, p, u, q, v, margin, scratch, nodes):
            continue
        moved = 2 - (j - i)  # rows i+1 .. j give way to p and q
        if moved > 0:
            for row in range(count - 1, j, -1):
                copy_to(work[row], work[row + moved])
                at[row + moved] = at[row]
        elif moved < 0:
            for row in range(j + 1, count):
                copy_to(work[row], work[row + moved])
                at[row + moved] = at[row]
        copy_to(p, work[i + 1])
        copy_to(q, work[i + 2])
        at[i + 1], at[i + 2] = u, v
        count += moved
    return work[:count].copy(), at[:count].copy()
