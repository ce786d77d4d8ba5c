"""One dynamic movement primitive: equations (1) and (2) of the paper with both ends exact."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comove.errors import DemonstrationError, OptionError
from comove.primitives.basis import N_INTERVALS, MotionBasis, hold_step, motion_basis
from comove.primitives.phase import ExponentialPhase, Phase
from comove.trajectory import Trajectory

Array = NDArray[np.float64]


class Recording(Protocol):
    """What a primitive is fitted to: time (n_steps,) [s], position (n_steps, n_dims) [m]."""

    time: Array
    position: Array
    start_velocity: Array


@dataclass(frozen=True)
class DMPState:
    """Where an execution stands.

    Attributes
    ----------
    time : since the start [s]
    position, velocity : arrays, shape (n_dims,), [m], [m/s]
    goal : array, shape (n_dims,), [m]; may be moved while the movement runs
    duration : [s]
    force : array, shape (n_knots, n_dims), the forcing term at the knots, in units of duration
    """

    time: float
    position: Array
    velocity: Array
    goal: Array
    duration: float
    force: Array


@dataclass(frozen=True)
class DMP:
    """A movement in `n_dims` dimensions on one canonical system.

    Attributes
    ----------
    weights : array, shape (n_dims, n_basis), the free shape weights; any value meets both ends
    start, goal : arrays, shape (n_dims,), [m]
    start_velocity, goal_velocity : arrays, shape (n_dims,), [m/s]
    duration : [s]
    phase : canonical system
    """

    weights: Array
    start: Array
    goal: Array
    start_velocity: Array
    goal_velocity: Array
    duration: float
    phase: Phase = ExponentialPhase()

    @classmethod
    def fit(cls, demonstration: Recording, *, n_basis: int = 20, phase: Phase | None = None) -> DMP:
        """Fit the shape weights to one demonstration by least squares on its positions.

        Parameters
        ----------
        demonstration
            Its time may be sampled unevenly. The primitive starts with the demonstration's velocity
            and ends at rest at its last position.
        n_basis
            Free shape weights a dimension; what holds the ends is extra.
        phase
            Canonical system; exponential unless given.

        Raises
        ------
        DemonstrationError
            If the recording holds fewer than two samples or lasts no time.
        OptionError
            If `n_basis` is out of range.
        """
        if isinstance(n_basis, bool) or not isinstance(n_basis, (int, np.integer)) or not 1 <= n_basis <= 200:
            raise OptionError(f"n_basis = {n_basis!r}", way_out="give a whole number from 1 to 200")
        time = demonstration.time - demonstration.time[0]
        if len(time) < 2 or not time[-1] > 0:
            raise DemonstrationError("the recording lasts no time", way_out="give two samples or more")
        position, duration = demonstration.position, float(time[-1])
        dmp = cls(
            weights=np.zeros((position.shape[1], n_basis)),
            start=position[0].copy(),
            goal=position[-1].copy(),
            start_velocity=np.array(demonstration.start_velocity, dtype=float),
            goal_velocity=np.zeros(position.shape[1]),
            duration=duration,
            phase=phase or ExponentialPhase(),
        )
        boundary, shape = dmp.basis.at(time / duration)
        missing = position - boundary[0] @ dmp.boundary_values()
        weights = np.linalg.lstsq(shape[0], missing, rcond=None)[0].T
        return replace(dmp, weights=weights)

    @property
    def basis(self) -> MotionBasis:
        """The matrices behind the rollout."""
        return motion_basis(self.weights.shape[1], "velocity", self.phase)

    def boundary_values(self) -> Array:
        """Start, start velocity, goal and goal velocity in unit duration; array, shape (4, n_dims)."""
        return np.stack(
            [self.start, self.start_velocity * self.duration, self.goal, self.goal_velocity * self.duration]
        )

    def towards(
        self,
        *,
        start: ArrayLike | None = None,
        goal: ArrayLike | None = None,
        duration: float | None = None,
        start_velocity: ArrayLike | None = None,
        goal_velocity: ArrayLike | None = None,
    ) -> DMP:
        """The same shape weights between other ends; what is not given stays.

        The start velocity is kept in units of duration, so that slowing down slows the start too.

        Raises
        ------
        OptionError
            If a vector has the wrong length or is not finite, or the duration is not positive.
        """
        new_duration = self.duration if duration is None else _number(duration)
        if not (np.isfinite(new_duration) and new_duration > 0):
            raise OptionError(f"duration = {duration!r}", way_out="give a positive number of seconds")
        ratio = self.duration / new_duration
        return replace(
            self,
            start=self._vector("start", start, self.start),
            goal=self._vector("goal", goal, self.goal),
            start_velocity=self._vector("start_velocity", start_velocity, self.start_velocity * ratio),
            goal_velocity=self._vector("goal_velocity", goal_velocity, self.goal_velocity * ratio),
            duration=new_duration,
        )

    def rollout(
        self,
        *,
        start: ArrayLike | None = None,
        goal: ArrayLike | None = None,
        duration: float | None = None,
        start_velocity: ArrayLike | None = None,
        goal_velocity: ArrayLike | None = None,
        n_steps: int = 201,
    ) -> Trajectory:
        """Play the movement, between other ends if they are given.

        Returns
        -------
        Trajectory
            time (n_steps,) [s], position and velocity (n_steps, n_dims), exact at every sample.

        Raises
        ------
        OptionError
            If an argument is out of range.
        """
        if not isinstance(n_steps, (int, np.integer)) or n_steps < 2:
            raise OptionError(f"n_steps = {n_steps!r}", way_out="give a whole number, two or more")
        dmp = self.towards(
            start=start,
            goal=goal,
            duration=duration,
            start_velocity=start_velocity,
            goal_velocity=goal_velocity,
        )
        return dmp.at(np.linspace(0.0, dmp.duration, n_steps))

    def at(self, time: ArrayLike) -> Trajectory:
        """Positions and velocities at any times [s], array of shape (n_steps,); at rest after the end."""
        time = np.asarray(time, dtype=float)
        boundary, shape = self.basis.at(time / self.duration)
        position, velocity, _ = boundary @ self.boundary_values() + shape @ self.weights.T
        return Trajectory(time, position, velocity / self.duration)

    def initial_state(self) -> DMPState:
        """The state at time 0, from which `step` goes on."""
        basis = self.basis
        weights = basis.forcing_of_boundary @ self.boundary_values() + basis.forcing_of_shape @ self.weights.T
        return DMPState(
            0.0, self.start, self.start_velocity, self.goal, self.duration, basis.forcing @ weights
        )

    def step(self, state: DMPState, dt: float) -> DMPState:
        """Advance by `dt` [s] online, with the forcing term held first order over the step.

        Agrees with `rollout` to second order in `dt`, and to rounding where the steps meet the knots.

        Raises
        ------
        OptionError
            If `dt` is not positive.
        """
        if not dt > 0:
            raise OptionError(f"dt = {dt}", way_out="give a positive number of seconds")
        ds, s = dt / state.duration, state.time / state.duration
        if s >= 1.0 - 1e-9:  # the forcing is cut off at the end
            now = then = np.zeros_like(state.position)
        else:
            now, then = _force_at(state.force, s), _force_at(state.force, s + ds)
        error, velocity = hold_step(
            ds, state.position - state.goal, state.velocity * state.duration, now, then
        )
        return replace(
            state,
            time=state.time + dt,
            position=error + state.goal,
            velocity=velocity / state.duration,
        )

    def _vector(self, name: str, value: ArrayLike | None, default: Array) -> Array:
        if value is None:
            return default
        try:
            vector = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            vector = np.full(1, np.nan)
        if vector.shape != self.start.shape or not np.isfinite(vector).all():
            raise OptionError(f"{name} = {value!r}", way_out=f"give {len(self.start)} finite numbers")
        return vector


def _number(value: object) -> float:
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return float("nan")


def _force_at(force: Array, s: float) -> Array:
    """The forcing term at normalised time `s`, linear between the knots."""
    position = min(s, 1.0) * N_INTERVALS
    k = min(int(position), N_INTERVALS - 1)
    return force[k] + (position - k) * (force[k + 1] - force[k])
