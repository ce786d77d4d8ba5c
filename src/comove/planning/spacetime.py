"""A planner in space and time, for obstacles whose motion is known.

Two trees grow in configurations and normalised time, forward from the start at 0 and backward from the goal at 1,
until they meet; samples are such as both ends can reach in time (Grothe et al., 2022). A node is a configuration and
its time. An edge is free if it is slow enough and the body keeps its margin along it while the obstacles move and
turn: its displacement relative to any point of them is bounded by the sum of its span and theirs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.compiled import kernel
from comove.contacts.displaced import instant_at
from comove.geometry.distances import REACH
from comove.model.scene import Scene
from comove.planning import trees
from comove.planning.configurations import (
    Space,
    clearance_at,
    interpolate,
    is_free_between,
    may_be_within,
    random_configuration,
    span,
)
from comove.planning.planner import continuous, sample
from comove.planning.trees import copy_to, rrt_connect, shortened

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SpaceTimeSettings:
    """Settings of the planner in space and time, and of how its paths become motions.

    Attributes
    ----------
    n_intervals : intervals between the times at which the obstacles' positions are stored
    time_step : largest extension of a tree [durations]
    waiting : probability that a sample is a configuration of the tree at another time
    n_shortcuts : number of shortcuts that are tried
    shares : shares of the speed limit, tried in turn: smoothed motions are faster in between
    unlimited : largest speed if nothing limits the speed [straight ways a duration]
    margins : margins of the clearance, tried in turn [m]
    smoothings : widths of the smoothing, each with a time for acceleration and braking together [durations]
    fading, fades : time in which an initial velocity fades, in times to brake, and its least and largest share of the
        duration
    """

    n_intervals: int = 400
    time_step: float = 0.05
    waiting: float = 0.2
    n_shortcuts: int = 150
    shares: tuple[float, ...] = (0.6, 0.8, 0.9, 0.7)
    unlimited: float = 5.0
    margins: tuple[float, ...] = (0.02, 0.01, 0.005, 0.015)
    smoothings: tuple[tuple[float, float], ...] = (
        (0.003, 0.06),
        (0.01, 0.1),
        (0.02, 0.15),
        (0.03, 0.25),
        (0.04, 0.4),
        (0.05, 0.6),
        (0.07, 0.9),
    )
    fading: float = 6.0
    fades: tuple[float, float] = (0.05, 0.9)


SETTINGS = SpaceTimeSettings()


class SpaceTime(NamedTuple):
    """A scene with moving obstacles, in the form that the planner's kernels take.

    Attributes
    ----------
    space : space with the displacements of the obstacles
    speed : limit of the speed of a node [m a duration]
    time_step, waiting : as in `SpaceTimeSettings`
    clock : that of the space
    """

    space: Space
    speed: float
    time_step: float
    waiting: float
    clock: Array


def spacetime(scene: Scene, space: Space, settings: SpaceTimeSettings = SETTINGS) -> SpaceTime:
    """Return the space of a scene together with the motion of its obstacles."""
    moved = scene.displacements(np.linspace(0.0, scene.duration, settings.n_intervals + 1))
    steps = np.linalg.norm(np.diff(moved.offsets, axis=0), axis=2)
    steps += np.abs(np.diff(moved.angles, axis=0)) * space.around.obstacles[:, REACH]
    space = space._replace(moved=moved, fastest=float(steps.max(initial=0.0)) * settings.n_intervals)
    return SpaceTime(space, np.inf, settings.time_step, settings.waiting, space.clock)


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
    n_shortcuts: int = SETTINGS.n_shortcuts,
) -> tuple[Array, Array] | None:
    """Plan and shorten a path from the start at time 0 to the goal at time 1; None if none is found.

    Parameters
    ----------
    start, goal : arrays, shape (n_columns,)
    speed : largest speed of a node [m a duration]
    margin : clearance that is kept beyond the scene's [m]; less if the ends have less
    max_nodes : number of nodes after which planning ends
    before : array, shape (n_before, n_columns), path of an earlier plan, at even times from 0 to 1
    n_shortcuts : number of shortcuts that are tried

    Returns
    -------
    path : array, shape (n_configurations, n_columns), angles unwrapped and quaternions of continuous sign
    times : array, shape (n_configurations,), from 0 to 1
    """
    space, scratch = world.space, np.empty((world.space.blocks.node.shape[0], 3))
    at_ends = [
        clearance_at(space, q, instant_at(space.moved, t), scratch, 0.0)
        for q, t in ((start, 0.0), (goal, 1.0))
    ]
    margin = min(space.required + margin, 0.5 * (space.required + min(at_ends)))
    world = world._replace(speed=speed)
    before = np.empty((0, len(start))) if before is None else before
    before = np.column_stack([before, np.linspace(0.0, 1.0, len(before))])
    ends = np.append(start, 0.0), np.append(goal, 1.0)
    path = rrt_connect(world, *ends, margin, rng, max_nodes, 40 * max_nodes, before)
    if len(path) == 0:
        return None
    path = shortened(world, path, margin, rng, n_shortcuts)
    return continuous(space, path[:, :-1]), path[:, -1].copy()


def targets_in_time(
    space: Space,
    path: Array,
    times: Array,
    n_steps: int,
    smoothings: Sequence[tuple[float, float]] = SETTINGS.smoothings,
) -> Array:
    """Smooth a path by several widths, at rest at both ends; array, shape (n_smoothings, n_steps, n_columns)."""
    from scipy.ndimage import gaussian_filter1d  # a fifth of a second that only moving obstacles are worth

    s, smooth = np.linspace(0.0, 1.0, n_steps), []
    way = np.empty((n_steps, path.shape[1]))
    for width, ease in smoothings:
        sample(space, path, times, _eased(s, ease), way)
        mirrored = np.pad(way, ((n_steps // 2,) * 2, (0, 0)), mode="reflect", reflect_type="odd")
        filtered = gaussian_filter1d(mirrored, width * n_steps, axis=0)
        smooth.append(filtered[n_steps // 2 : n_steps // 2 + n_steps])
    return np.stack(smooth)


def coast(
    velocity: Array, acceleration: float, n_steps: int, settings: SpaceTimeSettings = SETTINGS
) -> Array:
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
    fading = np.clip(settings.fading * np.linalg.norm(velocity) / acceleration, *settings.fades)
    return velocity * s * np.clip(1.0 - s / fading, 0.0, None) ** 3


def _eased(s: Array, ease: float) -> Array:
    """Map normalised times so that the pace rises from 0 in half of `ease`, and falls to 0 in the other half."""
    half = ease / 2
    slope = 1.0 / (1.0 - half)
    first = np.where(s < half, 0.5 * slope * s**2 / half, slope * (s - half / 2))
    rest = 1.0 - s
    return np.where(rest < half, 1.0 - 0.5 * slope * rest**2 / half, first)


@kernel
def edge_is_free_in_time(world, p, q, margin):
    """Return whether the body is slow enough, and keeps the clearance `margin` [m], along the edge from p to q."""
    moved, nodes = span(world.space, p, q), np.empty((world.space.blocks.node.shape[0], 3))
    if moved > world.speed * abs(q[-1] - p[-1]):
        return False
    times = p[-1], q[-1]
    return is_free_between(world.space, p, q, moved, times, margin, np.empty(p.shape[0]), nodes)


@trees.answers(trees.extend, SpaceTime)
@kernel
def _extend(world, p, q, steps, margin, out):
    moved, waited = span(world.space, p, q), abs(q[-1] - p[-1])
    share = min(1.0, world.space.settings.step * steps / max(moved, 1e-12))
    share = min(share, world.time_step * steps / max(waited, 1e-12))
    _between(world, p, q, share, out)
    if not edge_is_free_in_time(world, p, out, margin):
        return trees.BLOCKED
    return trees.ARRIVED if share == 1.0 else trees.FREE


@trees.answers(trees.nearest, SpaceTime)
@kernel
def _nearest(world, tree, count, q):
    best, least, later = -1, np.inf, tree[0, -1] == 0.0
    for i in range(count):
        wait = q[-1] - tree[i, -1] if later else tree[i, -1] - q[-1]
        if wait > 0.0 and may_be_within(world.space, tree[i], q, world.speed * wait):
            way = span(world.space, tree[i], q)
            effort = way / world.space.settings.step + wait / world.time_step
            if way <= world.speed * wait and effort < least:
                best, least = i, effort
    return best


@trees.answers(trees.draw, SpaceTime)
@kernel
def _draw(world, nodes, counts, this, rng, out):
    if rng.random() < world.waiting:
        copy_to(nodes[this, int(rng.random() * counts[this])], out)
    else:
        random_configuration(world.space, rng, out)
    soonest = span(world.space, nodes[0, 0], out) / world.speed
    latest = 1.0 - span(world.space, nodes[1, 0], out) / world.speed
    if soonest >= latest:
        return False
    out[-1] = soonest + rng.random() * (latest - soonest)
    return True


@trees.answers(trees.between, SpaceTime)
@kernel
def _between(world, p, q, share, out):
    interpolate(world.space, p, q, share, out)
    out[-1] = q[-1] if share == 1.0 else p[-1] + share * (q[-1] - p[-1])
    return True


@trees.answers(trees.length, SpaceTime)
@kernel
def _duration(world, p, q):
    return abs(q[-1] - p[-1])


@trees.answers(trees.shortens, SpaceTime)
@kernel
def _shortens(world, p, q, way):
    return span(world.space, p, q) <= world.speed * abs(q[-1] - p[-1])
