"""A planner in space and time, and smooth movements along its paths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from comove.arrays import Array
from comove.model.scene import Scene
from comove.planning.configurations import Space, clearance_in_time
from comove.planning.planner import continuous, sample
from comove.planning.timing import Timing, fastest_point
from comove.planning.trees import rrt_connect, shortened
from comove.planning.world import World


@dataclass(frozen=True)
class SpaceTimeSettings:
    """Settings of the planner in space and time, and of its smoothing.

    Attributes
    ----------
    n_intervals : intervals between the times at which the obstacles' positions are stored
    time_step : largest extension of a tree [durations]
    waiting : probability that a sample is a configuration of the tree at another time
    n_shortcuts : number of shortcuts that are tried
    shares : shares of the speed limit, tried in turn: smoothed motions are faster in between
    unlimited : largest speed if nothing limits the speed [straight paths a duration]
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


def spacetime(scene: Scene, space: Space, settings: SpaceTimeSettings = SETTINGS) -> World:
    """Return a space with the motion of the scene's obstacles."""
    resting = space.around.obstacles
    moved = scene.displacements(np.linspace(0.0, scene.duration, settings.n_intervals + 1))
    timing = Timing(
        True,
        moved,
        fastest_point(resting, moved),
        np.inf,
        1.0,
        scene.duration,
        settings.time_step,
        settings.waiting,
    )
    return World.of(space, timing)


def plan_in_time(
    world: World,
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
    """Plan a path from start at time 0 to goal at 1; None if there is none.

    Parameters
    ----------
    start, goal : arrays, shape (n_columns,)
    speed : largest speed of a keypoint [m a duration]
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
    ends = np.append(start, 0.0), np.append(goal, 1.0)
    at_ends = [clearance_in_time(space, world.timing, node, scratch, 0.0) for node in ends]
    margin = min(space.required + margin, 0.5 * (space.required + min(at_ends)))
    world = world.paced(speed)
    before = np.empty((0, len(start))) if before is None else before
    before = np.column_stack([before, np.linspace(0.0, 1.0, len(before))])
    path = rrt_connect(world, *ends, margin, rng, max_nodes, 40 * max_nodes, before)
    if len(path) == 0:
        return None
    path = shortened(world, path, margin, rng, n_shortcuts, False)
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
    """Return the displacement that a fading initial velocity adds to a movement. The movement begins at rest.

    Parameters
    ----------
    velocity : array, shape (n_columns,), rate of the configuration at the start [1 a duration]
    acceleration : limit of the end effectors' acceleration [m a duration squared]

    Returns
    -------
    array, shape (n_steps, n_columns)
    """
    s = np.linspace(0.0, 1.0, n_steps)[:, None]
    fading = np.clip(settings.fading * np.linalg.norm(velocity) / acceleration, *settings.fades)
    return velocity * s * np.clip(1.0 - s / fading, 0.0, None) ** 3


def _eased(s: Array, ease: float) -> Array:
    """Map normalised times to accelerate and brake in `ease` / 2 each."""
    half = ease / 2
    slope = 1.0 / (1.0 - half)
    first = np.where(s < half, 0.5 * slope * s**2 / half, slope * (s - half / 2))
    rest = 1.0 - s
    return np.where(rest < half, 1.0 - 0.5 * slope * rest**2 / half, first)
