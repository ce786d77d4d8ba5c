"""Obstacles known only from noisy, delayed and sometimes missing measurements.

Centres are measured; the rotations of obstacles are known from the scene. Every obstacle is tracked by a steady and a
quick filter (`filters`). The margin that is added to the scene's clearance, for the present position after the delay
and missed measurements, is `sigmas` standard deviations of the filter that is less certain: the quick one, which
expects sudden turns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array, Integers
from comove.control.filters import Belief, Expectations, informed, later, unknown
from comove.control.observers import Observer, sighting
from comove.control.safety.cbf_qp import Sighting
from comove.dmp.arguments import is_number, numbers, require_positive
from comove.errors import OptionError
from comove.model.scene import Scene

MOST = {"noise": 10.0, "agility": 1e6, "fastest": 1e3, "sharpest": 1e3, "sigmas": 10.0, "unseen": 1e3}
FINEST = 1e-9  # m of noise, below which filters fail by rounding


@dataclass(frozen=True)
class Sensor:
    """The accuracy of a sensor, and the motions that its filters expect.

    Attributes
    ----------
    noise : standard deviation of a coordinate [m]
    delay : time between a measurement and its arrival [s]
    dropout : fraction of measurements that never arrive
    agility : spectral density of the obstacles' acceleration [m^2/s^3]: how suddenly velocities change
    fastest, sharpest : standard deviations of the velocity of an obstacle that has just been seen, and of the angular
        velocity of its direction [m/s], [rad/s]
    sigmas : margin for the uncertainty, in standard deviations
    unseen : standard deviation of the position of an obstacle never seen [m]
    """

    noise: float = 0.01
    delay: float = 0.05
    dropout: float = 0.0
    agility: float = 0.5
    fastest: float = 0.5
    sharpest: float = 1.2
    sigmas: float = 3.0
    unseen: float = 10.0

    def __post_init__(self) -> None:
        for name, most in MOST.items():
            require_positive(name, getattr(self, name), most)
        if self.noise < FINEST:
            raise OptionError(f"noise = {self.noise!r}", key="noise", way_out=f"give {FINEST:g} m or more")
        for name, most in (("delay", 10.0), ("dropout", 0.99)):
            if not is_number(getattr(self, name)) or not 0 <= getattr(self, name) <= most:
                raise OptionError(
                    f"{name} = {getattr(self, name)!r}", key=name, way_out=f"give a number from 0 to {most:g}"
                )


class Observed(Observer):
    """A tracker of obstacles by measurements, which the caller supplies.

    Parameters
    ----------
    scene : the scene whose obstacles are observed; those without a `motion` are static
    sensor : accuracy of the measurements
    """

    def __init__(self, scene: Scene, sensor: Sensor | None = None):
        super().__init__(scene)
        self.sensor = sensor or Sensor()
        n, n_dims = len(scene.motions), scene.n_dims
        self._when = np.full(n, -np.inf)
        self._expected = Expectations(self.sensor.agility, self.sensor.fastest, self.sensor.sharpest)
        spread = np.repeat([self.sensor.unseen, self.sensor.fastest, self.sensor.sharpest], 3).reshape(3, 3)
        spread[:2, n_dims:] = 0.0  # nothing leaves the plane
        spread[2, : 2 * (3 - n_dims)] = 0.0
        self._belief = unknown(scene.centers, scene.moving[:, None] * spread.ravel() ** 2)
        # Compiles, or loads, the kernels now.
        informed(self._predicted(np.arange(n), 0.0), scene.centers, self.sensor.noise**2, self._expected)

    def update(self, obstacle: int, center: ArrayLike, time: float) -> None:
        """Update the tracks by one measurement.

        Parameters
        ----------
        obstacle : number of the obstacle in the scene
        center : array, shape (n_dims,), measured position of its centre [m]
        time : time of the measurement [s]

        Raises
        ------
        OptionError
            If there is no such obstacle, if the centre is not a point, or if the time is not after that of the last
            one.
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
                f"the measurement of {self.scene.name_of(int(obstacle))} is {center.tolist()}",
                way_out=f"give {n_dims} finite numbers",
            )
        if not is_number(time) or not time > self._when[obstacle]:
            raise OptionError(
                f"the measurement of {self.scene.name_of(int(obstacle))} at {time!r} s does not come after the one "
                f"at {self._when[obstacle]:g} s",
                way_out="pass on measurements in their order, each once",
            )
        self._take_in(np.array([obstacle]), np.pad(center, (0, 3 - n_dims))[None], float(time))

    def is_news(self, obstacle: int, time: float) -> bool:
        """Return whether a measurement is newer than an obstacle's last one.

        Parameters
        ----------
        obstacle : its number
        time : instant of the measurement [s]
        """
        return time > self._when[obstacle]

    def _take_in(self, which: Integers, centers: Array, time: float) -> None:
        """Update obstacles' estimates by centres, (n_measured, 3) [m], of an instant [s]."""
        belief = informed(self._predicted(which, time), centers, self.sensor.noise**2, self._expected)
        self._belief.put(which, belief)
        self._when[which] = time

    def _predicted(self, which: Integers, time: float) -> Belief:
        """Return the estimates for some obstacles at a later instant [s]."""
        when = self._when[which]
        dt = np.where(np.isfinite(when), np.maximum(time - when, 0.0), 0.0)
        return later(self._belief.at(which), dt, self._expected)

    def observe(self, time: float) -> Sighting:
        """Return the obstacles at estimated positions, with a margin of uncertainty."""
        center, n, moving = self.scene.centers.copy(), len(self._when), np.flatnonzero(self.scene.moving)
        velocity, margin = np.zeros((n, 3)), np.zeros(n)
        belief = self._predicted(moving, time)
        center[moving], velocity[moving] = belief.position, belief.velocity
        margin[moving] = self.sensor.sigmas * belief.deviation
        return sighting(self.scene, center, velocity, margin, time)

    def bends(self, time: float) -> Array:
        """Return the angular velocities of the velocities' directions; array, shape (n_rows, 3) [rad/s]."""
        moving, spin = np.flatnonzero(self.scene.moving), np.zeros((len(self._when), 3))
        spin[moving] = self._predicted(moving, time).spin
        return spin[self.scene.owners]


class Measured(Observed):
    """A tracker of synthetic measurements, generated from true positions for tests.

    Parameters
    ----------
    truth : observer of the true positions
    sensor : accuracy of the measurements, one at every observed instant
    rng : random numbers for noise and missing measurements
    """

    def __init__(self, truth: Observer, scene: Scene, sensor: Sensor | None, rng: np.random.Generator):
        super().__init__(scene, sensor)
        self._truth, self._rng = truth, rng

    def observe(self, time: float) -> Sighting:
        """Measure; return the obstacles at their estimated positions."""
        then = time - self.sensor.delay
        if then >= 0.0 or not np.isfinite(self._when[self.scene.moving]).all():
            then = max(then, 0.0)  # before it begins, everything stands as it does at 0 s
            places = self._truth.ground_truth(np.array([then]))[0]
            noise, n_dims = self.sensor.noise * self._rng.standard_normal(places.shape), self.scene.n_dims
            noise[:, n_dims:] = 0.0
            arrives = self._rng.random(len(places)) >= self.sensor.dropout
            which = np.flatnonzero(self.scene.moving & (self._when < then) & arrives)
            self._take_in(which, places[which] + noise[which], then)
        return super().observe(time)

    def ground_truth(self, time: Array) -> Array:
        """Return the true positions of the obstacles' centres; array, shape (n_times, n_obstacles, 3) [m]."""
        return self._truth.ground_truth(time)
