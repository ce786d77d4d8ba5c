"""Obstacles of which only measurements are known: noisy, late, and now and then none at all.

Every obstacle is tracked by a Kalman filter (1960) that takes its acceleration for white noise. What the filter does
not know of where it is now, after the delay and whatever has been missed, is the margin that is kept on top of the
scene's clearance: `SIGMAS` standard deviations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comove.errors import OptionError
from comove.execution.sight import Sight, sighting, straight_on
from comove.primitives.arguments import is_number, numbers, require_positive
from comove.reaction.programme import Sighting
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

SIGMAS = 3.0
UNSEEN = 10.0  # m, standard deviation of what has never been seen


@dataclass(frozen=True)
class Sensor:
    """What measurements are worth.

    Attributes
    ----------
    noise : standard deviation of a coordinate [m]
    delay : between an instant and the arrival of what was measured then [s]
    dropout : share of measurements that never arrive
    agility : spectral density of the obstacles' acceleration [m^2/s^3]: how suddenly they turn
    fastest : standard deviation of a velocity of which nothing is known yet [m/s]
    """

    noise: float = 0.01
    delay: float = 0.05
    dropout: float = 0.0
    agility: float = 0.5
    fastest: float = 0.5

    def __post_init__(self) -> None:
        for name, most in (("noise", 10.0), ("agility", 1e6), ("fastest", 1e3)):
            require_positive(name, getattr(self, name), most)
        for name, most in (("delay", 10.0), ("dropout", 0.99)):
            if not is_number(getattr(self, name)) or not 0 <= getattr(self, name) <= most:
                raise OptionError(
                    f"{name} = {getattr(self, name)!r}", key=name, way_out=f"give a number from 0 to {most:g}"
                )


class Observed:
    """Obstacles tracked by measurements that somebody passes on, as they come.

    Parameters
    ----------
    scene : whose obstacles are watched; those without a `motion` stand where it says
    sensor : what the measurements are worth
    """

    certain = False

    def __init__(self, scene: Scene, sensor: Sensor | None = None):
        self.scene, self.sensor = scene, sensor or Sensor()
        n = len(scene.motions)
        self._when = np.full(n, -np.inf)
        self._state = np.zeros((n, 2, 3))  # position and velocity
        self._state[:, 0] = scene.centers
        self._covariance = np.zeros((n, 2, 2))  # of each coordinate, all alike
        self._covariance[scene.moving] = np.diag([UNSEEN**2, self.sensor.fastest**2])

    def observe(self, obstacle: int, center: ArrayLike, time: float) -> None:
        """Take in one measurement.

        Parameters
        ----------
        obstacle : its number in the scene
        center : array, shape (n_dims,), [m]
        time : at which it was there [s]

        Raises
        ------
        OptionError
            If there is no such obstacle, if the centre is no place, or if the time lies before the last one.
        """
        n_dims, center = self.scene.n_dims, numbers(center)
        if (
            isinstance(obstacle, bool)
            or not isinstance(obstacle, (int, np.integer))
            or not 0 <= obstacle < len(self._when)
        ):
            raise OptionError(
                f"there is no obstacle {obstacle!r}", way_out=f"give 0 to {len(self._when) - 1}"
            )
        if center.shape != (n_dims,) or not np.isfinite(center).all():
            raise OptionError(
                f"the measurement of obstacles[{obstacle}] is {center.tolist()}",
                way_out=f"give {n_dims} finite numbers",
            )
        if not is_number(time) or not time > self._when[obstacle]:
            raise OptionError(
                f"the measurement of obstacles[{obstacle}] at {time!r} s does not come after the one at "
                f"{self._when[obstacle]:g} s",
                way_out="pass on measurements in their order, each once",
            )
        state, covariance = self._predicted(obstacle, time)
        gain = covariance[:, 0] / (covariance[0, 0] + self.sensor.noise**2)
        surprise = np.zeros(3)
        surprise[:n_dims] = center - state[0, :n_dims]
        self._state[obstacle] = state + gain[:, None] * surprise
        self._covariance[obstacle] = covariance - np.outer(gain, covariance[0])
        self._when[obstacle] = time

    def _predicted(self, j: int, time: float) -> tuple[Array, Array]:
        """State, array of shape (2, 3), and covariance, (2, 2), of an obstacle at a later instant [s]."""
        if not np.isfinite(self._when[j]):
            return self._state[j], self._covariance[j]
        dt, q = max(0.0, time - self._when[j]), self.sensor.agility
        forward = np.array([[1.0, dt], [0.0, 1.0]])
        noise = q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        return forward @ self._state[j], forward @ self._covariance[j] @ forward.T + noise

    def seen(self, time: float) -> Sighting:
        """Where the filters believe them to be, with the margin for what they do not know."""
        center, n = self.scene.centers.copy(), len(self._when)
        velocity, margin = np.zeros((n, 3)), np.zeros(n)
        for j in np.flatnonzero(self.scene.moving):
            state, covariance = self._predicted(j, time)
            center[j], velocity[j] = state
            margin[j] = SIGMAS * np.sqrt(covariance[0, 0])
        return sighting(self.scene, center, velocity, margin)

    def ahead(self, time: float) -> Scene:
        """That they go on as they do."""
        return straight_on(self.scene, self.seen(time), time)

    def true(self, time: Array) -> Array:
        """Nobody knows."""
        centers = np.full((len(time), len(self._when), 3), np.nan)
        centers[:, ~self.scene.moving] = self.scene.centers[~self.scene.moving]
        return centers


class Measured(Observed):
    """Measurements made up from where obstacles really are, to try out what a sensor is good for.

    Parameters
    ----------
    truth : where they really are
    sensor : how it is measured, once an instant that is asked for
    rng : of noise and drop-outs
    """

    def __init__(self, truth: Sight, scene: Scene, sensor: Sensor | None, rng: np.random.Generator):
        super().__init__(scene, sensor)
        self._truth, self._rng = truth, rng

    def seen(self, time: float) -> Sighting:
        """Measure, and believe."""
        then = time - self.sensor.delay
        if then >= 0.0 or not np.isfinite(self._when[self.scene.moving]).all():
            then = max(then, 0.0)  # before it begins, everything stands as it does at 0 s
            places = self._truth.true(np.array([then]))[0]
            for j in np.flatnonzero(self.scene.moving & (self._when < then)):
                noise = self.sensor.noise * self._rng.standard_normal(self.scene.n_dims)
                if self._rng.random() >= self.sensor.dropout:
                    self.observe(int(j), places[j, : self.scene.n_dims] + noise, then)
        return super().seen(time)

    def true(self, time: Array) -> Array:
        """What is."""
        return self._truth.true(time)
