"""Parts of compared methods: demonstrated primitives and fitted curves.

A motion is verified as a curve with exact ends. An integrated motion approaches its goal without quite reaching it.
If the remaining error is small (see `FitSettings`), a correction of minimum jerk over its last part leads it to the
goal; else it keeps its own end, which the verification then reports. Shape weights are then fitted, as many as are
needed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from comove.arrays import Array
from comove.dmp.basis import motion_basis
from comove.errors import OptionError
from comove.model.coordinated_dmp import CoordinatedDMP
from comove.model.coordinates import Coordinates
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.model.shapes import spatial
from comove.planning.objective import N_STEPS
from comove.planning.search import Search
from comove.planning.seeds import minimum_jerk
from comove.trajectory import interpolated


@dataclass(frozen=True)
class FitSettings:
    """Settings of the curves that are fitted to integrated motions.

    Attributes
    ----------
    end_error, end_speed : largest remaining error of a motion that has arrived [m] and [m/s], as attractors only
        approach their goal
    led : share of the duration over which an error at the end is corrected
    n_bases : numbers of shape weights a dimension that are tried in turn
    close : distance between curve and motion below which no more weights are tried [m]
    most_samples : largest number of samples
    """

    end_error: float = 5e-3
    end_speed: float = 1e-2
    led: float = 0.2
    n_bases: tuple[int, ...] = (30, 60, 120, 200)
    close: float = 1e-6
    most_samples: int = 4001


FITTING = FitSettings()


def taught_primitives(search: Search, n_basis: int = 30) -> CoordinatedDMP:
    """Return the demonstration transferred to every end effector (paper, III-B). Without one, return straight lines
    of minimum jerk.

    Parameters
    ----------
    search : search whose objective is in coordinates of free end effectors
    n_basis : shape weights a dimension

    Raises
    ------
    OptionError
        If the scene continues another movement: demonstrated movements begin at rest.
    """
    scene, coordinates = search.scene, search.objective.coordinates
    if any(group.start_twist.any() for group in scene.groups):
        raise OptionError(
            "what is taught begins at rest, and the scene goes on from another movement",
            key="method",
            way_out="use the method 'comove'",
        )
    basis = motion_basis(n_basis, "velocity")
    if search.taught is not None:
        return CoordinatedDMP.from_demonstration(search.taught, scene, coordinates, basis)
    s = np.linspace(0.0, 1.0, N_STEPS)
    hands = scene.start + minimum_jerk(s)[:, None, None] * (scene.goal - scene.start)
    dmp = CoordinatedDMP(scene, coordinates, basis, coordinates.boundary(), np.zeros(0))
    return dmp.fitted(s, coordinates.from_hands(hands))


def group_means(scene: Scene) -> Array:
    """Return the averaging matrix of groups, shape (n_groups, n_manipulators)."""
    means = np.zeros((len(scene.groups), len(scene.manipulators)))
    for g, group in enumerate(scene.groups):
        means[g, list(group.members)] = 1.0 / len(group.members)
    return means


@dataclass(frozen=True, eq=False)
class Fit:
    """Curve fitted to an integrated motion.

    Attributes
    ----------
    motion : the curve
    error : largest distance between end effectors on the curve and in the integrated motion, corrected at its end [m]
    end_miss : largest distance of an end effector from its goal at the end of the integration [m]
    """

    motion: CoordinatedMotion
    error: float
    end_miss: float


def fit_curve(
    scene: Scene, coordinates: Coordinates, s: Array, hands: Array, settings: FitSettings = FITTING
) -> Fit:
    """Fit a curve to sampled positions of the end effectors.

    Parameters
    ----------
    coordinates : coordinates of free end effectors
    s : array, shape (n_steps,), even normalised times from 0 to 1
    hands : array, shape (n_steps, n_manipulators, n_dims), positions of the end effectors [m]
    settings : settings of the fit
    """
    miss = float(np.linalg.norm(hands[-1] - scene.goal, axis=1).max())
    slope = (3.0 * hands[-1] - 4.0 * hands[-2] + hands[-3]) / (2.0 * (s[-1] - s[-2]))
    speed = float(np.linalg.norm(slope, axis=1).max()) / scene.duration
    boundary = coordinates.boundary()
    if miss <= settings.end_error and speed <= settings.end_speed:
        share = minimum_jerk((s - (1.0 - settings.led)) / settings.led)[:, None, None]
        hands = hands + share * (scene.goal - hands[-1])
    else:
        boundary[2], boundary[3] = coordinates.from_hands(np.stack([hands[-1], slope]))
    stride = -(-(len(s) - 1) // (settings.most_samples - 1))
    s, hands = s[::stride], hands[::stride]
    for n_basis in settings.n_bases:
        dmp = CoordinatedDMP(scene, coordinates, motion_basis(n_basis, "velocity"), boundary, np.zeros(0))
        motion = dmp.fitted(s, coordinates.from_hands(hands)).rollout()
        error = float(np.linalg.norm(motion.hands(s)[0] - hands, axis=2).max())
        if error <= settings.close:
            break
    return Fit(motion, error, miss)


def count_execution(search: Search, hands: Array) -> None:
    """Count an execution as a generation of the search; report its cost.

    Parameters
    ----------
    hands : array, shape (n_steps, n_manipulators, n_dims), positions of the end effectors at even times [m]
    """
    scene, even = search.scene, np.linspace(0.0, len(hands) - 1.0, N_STEPS)
    sampled = interpolated(even, np.arange(len(hands), dtype=np.float64), hands.reshape(len(hands), -1))
    nodes = spatial(sampled.reshape(1, N_STEPS, *hands.shape[1:]))
    search.count(1)
    value = search.objective.evaluate_nodes(nodes, scene.displacements_along(N_STEPS))
    search.tell(float(value.cost[0]), float(value.penalty[0]))


def control_times(duration: float, period: float, most: int) -> Array:
    """Return even normalised times from 0 to 1; shape (n_steps + 1,). They are a control period [s] apart. The
    period is shorter if there would be fewer than 200 steps, and longer if there would be more than `most`."""
    return np.linspace(0.0, 1.0, int(np.clip(np.ceil(duration / period), 200, most)) + 1)


def judge_execution(
    search: Search,
    s: Array,
    hands: Array,
    settings: FitSettings,
    before: Callable[[CoordinatedMotion], Mapping[str, float]] = lambda motion: {},
) -> None:
    """Fit a curve, log its errors (see `fit_curve`), and verify it.

    Parameters
    ----------
    settings : settings of the fit
    before : called with the curve before it is verified; returns further measures for the log
    """
    fit = fit_curve(search.scene, search.objective.coordinates, s, hands, settings)
    search.journal.log |= {"fit_error_max_m": fit.error, "integration_end_miss_m": fit.end_miss}
    search.journal.log |= before(fit.motion)
    search.judge(fit.motion)
