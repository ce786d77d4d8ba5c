"""Measures of a verified motion for people: smoothness and terms of J.

The terms of the paper's objective, equation (4), that follow from the motion alone have weight 1 here.
In unit duration and with T samples,

    goal = 1/T sum_t sum_i |y_i - g_i|^2,    velocity = (T-1)^2/T sum_t sum_i |y_i(t+1) - y_i(t)|^2.

The obstacle term counts the obstacles in contact: none, where the clearance is certified.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comove.arrays import Array
from comove.model.motion import CoordinatedMotion
from comove.verification.bounds import largest_jerk, node_bounds

WEIGHTS = {"goal": 1.0, "velocity": 0.01, "obstacle": 10.0, "resemblance": 0.0}
"""Usual weights of the terms."""
N_STEPS = 201


def unit_terms(motion: CoordinatedMotion) -> dict[str, float]:
    """Compute the terms of goal, velocity and obstacles of a verified motion."""
    return unit_terms_of(motion.hands(np.linspace(0.0, 1.0, N_STEPS))[0])


def unit_terms_of(position: Array) -> dict[str, float]:
    """Compute the terms of a movement without contact from its samples.

    Parameters
    ----------
    position : array, shape (n_steps, n_manipulators, n_dims), end effectors at even times [m]
    """
    n_steps, away, moved = len(position), position - position[-1], np.diff(position, axis=0)
    return {
        "goal": float((away**2).sum() / n_steps),
        "velocity": float((moved**2).sum() * (n_steps - 1) ** 2 / n_steps),
        "obstacle": 0.0,
    }


@dataclass(frozen=True)
class Smoothness:
    """Measures of a motion's smoothness.

    Attributes
    ----------
    jerk_max : upper bound of the jerk of an end effector between start and end [m/s^3]; the others are sampled, not
        certified
    jerk_squared : squared jerk of all end effectors, integrated over unit duration [m^2]
    jerk_ratio : `jerk_squared` over that of straight minimum-jerk motions with the same ends (Flash and Hogan, 1985)
    spectral_arc_length : mean over the end effectors' speeds (Balasubramanian et al., 2015): smoother if nearer to 0
    halfway, nearly_there : fractions of the duration after which half and 95 % of the path are travelled
    """

    jerk_max: float
    jerk_squared: float
    jerk_ratio: float
    spectral_arc_length: float
    halfway: float
    nearly_there: float


def smoothness(motion: CoordinatedMotion, n_steps: int = 801) -> Smoothness:
    """Return measures of a motion's smoothness from `n_steps` samples."""
    scene, s = motion.scene, np.linspace(0.0, 1.0, n_steps)
    _, velocity, acceleration = motion.hands(s)
    jerk, speed = np.diff(acceleration, axis=0) * (n_steps - 1), np.linalg.norm(velocity, axis=2)
    straight = 720.0 * max(float(((scene.goal - scene.start) ** 2).sum()), 1e-12)
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]).sum(axis=1))])
    halfway, nearly = np.interp([0.5 * way[-1], 0.95 * way[-1]], way, s)
    squared = float((jerk**2).sum() / (n_steps - 1))
    return Smoothness(
        largest_jerk(motion, node_bounds(motion).jerk),
        squared,
        squared / straight,
        float(np.mean([spectral_arc_length(own) for own in speed.T])),
        float(halfway),
        float(nearly),
    )


def spectral_arc_length(
    speed: Array, *, highest: float = 10.0, quiet: float = 0.05, padding: int = 16
) -> float:
    """Return minus the arc length of a speed's normalised amplitude spectrum. It is 0 for zero speed.

    The frequencies are those of a movement that lasts one second, so that the duration of a movement does not matter.

    Parameters
    ----------
    speed : array, shape (n_steps,), evenly spaced from start to end
    highest, quiet : frequency of a movement of a second [Hz], and share of the largest amplitude, beyond and below
        which the spectrum does not count (Balasubramanian et al., 2015)
    padding : how many times as many samples the spectrum has
    """
    spectrum = np.abs(np.fft.rfft(speed, padding * len(speed)))
    if spectrum[0] <= 0.0:
        return 0.0
    amplitude = spectrum / spectrum[0]
    frequency = np.arange(len(amplitude)) * (len(speed) - 1) / (padding * len(speed))  # over one second
    kept = frequency <= highest
    loud = np.flatnonzero(amplitude[kept] >= quiet)
    frequency, amplitude = frequency[: loud[-1] + 1], amplitude[: loud[-1] + 1]
    if len(frequency) < 2:
        return 0.0
    return -float(np.hypot(np.diff(frequency) / (frequency[-1] - frequency[0]), np.diff(amplitude)).sum())
