"""A single dynamic movement primitive, equations (1) and (2), both ends exact."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comove.arrays import Array
from comove.brief import brief
from comove.dmp.arguments import (
    instants,
    is_number,
    numbers,
    require_count,
    require_positive,
    require_steps,
    vector,
)
from comove.dmp.basis import MAX_BASIS, MotionBasis, released, rollouts
from comove.dmp.online import Curve, DMPState, advance, begin
from comove.dmp.rhythm import RhythmicBasis, estimated_period, rhythmic_basis
from comove.dmp.system import ExponentialPhase, Phase, values_at
from comove.dmp.variants import APART, LARGE, NO_WAY, Variant, extent_of
from comove.errors import ComoveWarning, DemonstrationError, OptionError
from comove.trajectory import Trajectory

FAR = 0.05  # distance of a fit from its recording beyond which it is warned of, as a share of the extent
ROTATION_VECTOR = "rotation vector"
NEGLIGIBLE = {"m": 1e-3, "rad": 1e-2, ROTATION_VECTOR: 1e-2}  # distances of a fit that never count, by unit
N_TRIED = 2000  # samples with which options are tried that bring a fit nearer
N_SEEN = 51  # even instants at which the extent of a movement is measured
VECTORS = ("start", "goal", "start_velocity", "goal_velocity", "learned")  # of a movement, (n_dims,) each


class Recording(Protocol):
    """A recording to which a primitive can be fitted.

    Where it has a `goal_velocity` too, shape (n_dims,), [m/s], movements that end in motion can be learned.
    """

    @property
    def time(self) -> Array:
        """Return the times of the samples, shape (n_steps,), [s]."""

    @property
    def position(self) -> Array:
        """Return the positions, shape (n_steps, n_dims), [m]."""

    @property
    def start_velocity(self) -> Array:
        """Return the velocity at the first sample, shape (n_dims,), [m/s]."""


@dataclass(frozen=True)
class FitError:
    """The distance of a movement from a recording, over its samples.

    Attributes
    ----------
    rms, largest : root-mean-square and largest distance, in the recording's unit
    time : when the distance is largest, from the recording's first sample on [s]
    """

    rms: float
    largest: float
    time: float

    @classmethod
    def of(cls, distances: Array, time: Array) -> FitError:
        """Measure distances, shape (n_steps,), at times [s]."""
        i = int(np.argmax(distances))
        return cls(float(np.sqrt((distances**2).mean())), float(distances[i]), float(time[i] - time[0]))


@dataclass(frozen=True, eq=False)
class DMP:
    """A movement in `n_dims` dimensions on one canonical system.

    Attributes
    ----------
    weights : array, shape (n_dims, n_basis), the free shape weights; both ends are met for any values
    start, goal : arrays, shape (n_dims,), [m]; the goal of a rhythmic movement is its centre
    start_velocity, goal_velocity : arrays, shape (n_dims,), [m/s]
    duration : [s]; the period of a rhythmic movement
    phase : canonical system
    variant : variant of the transformed system
    learned : array, shape (n_dims,), displacement from start to goal for which the weights were learned [m]; by
        default the present displacement
    """

    __repr__ = brief

    weights: Array
    start: Array
    goal: Array
    start_velocity: Array
    goal_velocity: Array
    duration: float
    phase: Phase = ExponentialPhase()
    variant: Variant = Variant.CLOSED_FORM
    learned: Array = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        object.__setattr__(self, "variant", Variant.named(self.variant))
        require_positive("duration", self.duration, of="seconds")
        if not np.size(self.learned):
            object.__setattr__(self, "learned", np.subtract(self.goal, self.start))
        for name in ("weights", *VECTORS):
            try:
                array = np.array(getattr(self, name), dtype=float)  # a copy of its own that nobody changes
            except (TypeError, ValueError):
                raise OptionError(f"{name} = {getattr(self, name)!r}", way_out="give numbers") from None
            if name == "weights" and array.ndim == 2 and not 1 <= array.shape[1] <= MAX_BASIS:
                raise OptionError(
                    f"weights of shape {array.shape}", way_out=f"give 1 to {MAX_BASIS} weights a dimension"
                )
            if array.ndim != (2 if name == "weights" else 1) or len(array) != len(self.weights):
                raise OptionError(
                    f"{name} of shape {array.shape} beside weights of shape {np.shape(self.weights)}",
                    way_out="give weights (n_dims, n_basis), and n_dims numbers for each end",
                )
            if not np.isfinite(array).all():
                raise OptionError(f"{name} = {array}", way_out="give finite numbers")
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @classmethod
    def fit(
        cls,
        demonstration: Recording,
        *,
        n_basis: int = 20,
        variant: Variant | str = Variant.CLOSED_FORM,
        phase: Phase | None = None,
        period: float | None = None,
        at_rest: bool = True,
    ) -> DMP:
        """Fit the shape weights to one demonstration's positions by least squares.

        Parameters
        ----------
        demonstration
            The recording; its time may be sampled unevenly. The primitive has its first and last position and its
            velocity at the start.
        n_basis
            Number of free shape weights per dimension; the functions for the end conditions are not counted.
        variant
            Variant of the transformed system, or its name.
        phase
            Canonical system; by default the variant's usual one.
        period
            Period of a rhythmic movement [s]; by default estimated from the recording, which may hold many periods.
        at_rest
            Whether the movement ends at rest even if the recording does not; otherwise it ends with the recording's
            velocity, such as a throw.

        Raises
        ------
        DemonstrationError
            If the recording holds fewer than two samples or lasts no time.
        OptionError
            If `n_basis` or `period` is out of range, or the variant is not known.

        Warns
        -----
        ComoveWarning
            If the variant cannot learn a dimension, because the recorded ends coincide in it, there are more weights
            than samples to determine them, or the fit is farther from the recording than a twentieth of its extent
            (`fit_error` measures it); names the distance, the time, and a remedy.
        """
        require_count("n_basis", n_basis, most=MAX_BASIS)
        variant = Variant.named(variant)
        if not all(hasattr(demonstration, name) for name in ("time", "position", "start_velocity")):
            raise OptionError(
                f"the demonstration is {type(demonstration).__name__}",
                way_out="give a Demonstration(time, position)",
            )
        if phase is not None and not isinstance(phase, Phase):
            raise OptionError(f"phase = {phase!r}", way_out="give LinearPhase() or ExponentialPhase()")
        time = demonstration.time - demonstration.time[0]
        if len(time) < 2 or not time[-1] > 0:
            raise DemonstrationError("the recording lasts no time", way_out="give two samples or more")
        position = demonstration.position
        if variant is Variant.RHYTHMIC:
            if phase is not None:
                raise OptionError(
                    "a rhythmic movement has no canonical system", key="phase", way_out="leave it out"
                )
            if not at_rest:
                raise OptionError("a rhythmic movement has no end", key="at_rest", way_out="leave it out")
            _tell_few(len(time), n_basis, 0)
            cycle = cls._fit_cycle(time, position, n_basis, period)
            _tell_far(cycle, demonstration, at_rest)
            return cycle
        if period is not None:
            raise OptionError(f"period = {period!r} of a movement that ends", way_out="leave it out")
        _tell_few(len(time), n_basis, 2)
        dmp = cls(
            weights=np.zeros((position.shape[1], n_basis)),
            start=position[0],
            goal=position[-1],
            start_velocity=demonstration.start_velocity,
            goal_velocity=np.zeros(position.shape[1]) if at_rest else _goal_velocity(demonstration),
            duration=float(time[-1]),
            phase=phase or variant.usual_phase,
            variant=variant,
        )
        fitted = dmp.shaped(time, position)
        if variant is Variant.CLASSIC:
            untaught = _untaught(dmp, position)[:, None]
            fitted = replace(fitted, weights=np.where(untaught, 0.0, fitted.weights))
            if untaught.any():  # which was told
                return fitted
        _tell_far(fitted, demonstration, at_rest)
        return fitted

    def shaped(self, time: Array, position: Array) -> DMP:
        """Return the movement between the same ends that fits positions best. Arguments are not checked.

        Parameters
        ----------
        time : array, shape (n_steps,), from 0 to the duration [s]
        position : array, shape (n_steps, n_dims), [m]
        """
        values = self.boundary_values()

        def design(block: slice) -> tuple[Array, Array]:
            boundary, shape = self.basis.at(time[block] / self.duration)
            return shape[0], position[block] - boundary[0] @ values

        return replace(self, weights=_least_squares(design, len(time)).T)

    def fit_error(self, recording: Recording) -> FitError:
        """Measure the distance of the movement from a recording.

        Parameters
        ----------
        recording : its first sample is at the movement's start
        """
        return FitError.of(self.distances_from(recording.time, recording.position), recording.time)

    def distances_from(self, time: Array, position: Array, block_size: int = 20_000) -> Array:
        """Return the distances from positions; array, shape (n_steps,).

        Parameters
        ----------
        time : array, shape (n_steps,), of which the first is that of the movement's start [s]
        position : array, shape (n_steps, n_dims)
        block_size : positions that are compared at a time, so that long recordings need no more memory
        """
        blocks = [slice(first, first + block_size) for first in range(0, len(time), block_size)]
        return np.concatenate(
            [
                np.linalg.norm(self.at(time[block] - time[0]).position - position[block], axis=1)
                for block in blocks
            ]
        )

    @classmethod
    def _fit_cycle(cls, time: Array, position: Array, n_basis: int, period: float | None) -> DMP:
        period = estimated_period(time, position) if period is None else period
        shortest = 2 * time[-1] / (len(time) - 1)  # which samples can tell
        if not is_number(period) or not shortest <= period <= time[-1] * (1 + 1e-9):
            raise OptionError(
                f"period = {period!r}",
                way_out=f"give one from {shortest:.4g} s to the recording's {time[-1]:.4g} s",
            )
        still = np.zeros(position.shape[1])
        dmp = cls(
            np.zeros((len(still), n_basis)), still, still, still, still, period, variant=Variant.RHYTHMIC
        )
        basis = rhythmic_basis(n_basis)

        def design(block: slice) -> tuple[Array, Array]:
            cycle = basis.on_cycle(time[block] / period)[0]
            return np.concatenate([cycle, np.ones((len(cycle), 1))], axis=1), position[block]

        solved = _least_squares(design, len(time))
        weights, centre = solved[:-1].T, solved[-1]
        onset = basis.cycle[:2, 0] @ weights.T
        return replace(
            dmp, weights=weights, start=centre + onset[0], goal=centre, start_velocity=onset[1] / period
        )

    @cached_property
    def basis(self) -> MotionBasis | RhythmicBasis:
        """Return the basis matrices of the rollout."""
        return self.variant.basis(self.weights.shape[1], self.phase)

    @property
    def n_dims(self) -> int:
        """Return the number of coordinates."""
        return len(self.start)

    @cached_property
    def shape_weights(self) -> Array:
        """Return the weights times A(d); array, shape (n_dims, n_basis)."""
        return self.scaling() @ self.weights

    def boundary_values(self) -> Array:
        """Return start, start velocity, goal and goal velocity; shape (4, n_dims). They are in unit duration."""
        return np.stack(
            [self.start, self.start_velocity * self.duration, self.goal, self.goal_velocity * self.duration]
        )

    def part(self, columns: slice) -> DMP:
        """Return the movement in some of its coordinates alone."""
        return replace(self, **{name: getattr(self, name)[columns] for name in ("weights", *VECTORS)})

    def towards(
        self,
        *,
        start: ArrayLike | None = None,
        goal: ArrayLike | None = None,
        duration: float | None = None,
        start_velocity: ArrayLike | None = None,
        goal_velocity: ArrayLike | None = None,
    ) -> DMP:
        """Return the movement between other ends, with the same weights. Arguments not given keep their values.

        Velocities at the ends are kept in units of duration, so a slower movement has slower ends. Where the variant
        turns and scales the movement, the end velocities turn and scale with it.

        Raises
        ------
        OptionError
            If a vector has the wrong length or is not finite, or the duration is not positive.

        Warns
        -----
        ComoveWarning
            If the classic form, which divides by the recorded displacement, scales a dimension far beyond its
            recorded range, because the recorded ends nearly coincide in it.
        """
        moved = replace(
            self,
            start=self._vector("start", start, self.start),
            goal=self._vector("goal", goal, self.goal),
            duration=self.duration if duration is None else duration,
        )
        ratio = (self.duration / moved.duration) * np.eye(self.n_dims)
        displaced = not np.array_equal(moved.goal - moved.start, self.goal - self.start)
        if self.variant is Variant.DMP_PLUS_PLUS and displaced:
            ratio = (self.duration / moved.duration) * moved.scaling() @ np.linalg.pinv(self.scaling())
        if self.variant is Variant.CLASSIC and displaced:
            _tell_blown_up(moved)
        return replace(
            moved,
            start_velocity=self._vector("start_velocity", start_velocity, ratio @ self.start_velocity),
            goal_velocity=self._vector("goal_velocity", goal_velocity, ratio @ self.goal_velocity),
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
        require_steps(n_steps)
        dmp = self.towards(
            start=start,
            goal=goal,
            duration=duration,
            start_velocity=start_velocity,
            goal_velocity=goal_velocity,
        )
        return dmp.at(np.linspace(0.0, dmp.duration, n_steps))

    def rollouts(self, weights: ArrayLike, n_steps: int = 201) -> Array:
        """Compute rollouts with different weights as one matrix product. All have the movement's ends.

        Parameters
        ----------
        weights : array, shape (n_rollouts, n_dims, n_basis), used instead of the movement's own weights

        Returns
        -------
        array, shape (n_rollouts, n_dims, n_steps), [m], at even times

        Raises
        ------
        OptionError
            If `weights` has another shape.
        """
        require_steps(n_steps)
        weights = numbers(weights)
        if weights.ndim != 3 or weights.shape[1:] != self.weights.shape:
            raise OptionError(
                f"weights of shape {weights.shape}",
                way_out=f"give (n_rollouts, {self.n_dims}, {self.weights.shape[1]})",
            )
        scaling = self.scaling()
        if not np.array_equal(scaling, np.eye(self.n_dims)):
            weights = scaling @ weights
        return rollouts(self.basis, self.boundary_values(), weights, n_steps)

    def at(self, time: ArrayLike) -> Trajectory:
        """Return positions and velocities at times [s], shape (n_steps,).

        A movement that ends at rest stays there; one that ends in motion is then drawn back to its goal. A rhythmic
        one runs from its start into its cycle.
        """
        time = instants(time)
        curve, s = self.curve, np.maximum(time / self.duration, 0.0)
        inside = s - np.floor(s) if curve.periodic else s
        position, velocity, _ = values_at(curve.knots, curve.force, curve.goal, inside)
        if curve.periodic:  # what is left of the way from the start into the cycle
            apart = np.stack([self.start, self.start_velocity * self.duration]) - curve.knots[:2, 0]
            left = released(s) @ apart
            position, velocity = position + left[0], velocity + left[1]
        velocity[time < 0.0] = 0.0
        return Trajectory(time, position, velocity / self.duration)

    @cached_property
    def curve(self) -> Curve:
        """Return the curve of an execution; of a rhythmic movement the limit cycle."""
        basis, weights = self.basis, self.shape_weights
        if isinstance(basis, RhythmicBasis):
            knots = basis.cycle @ weights.T
            knots[0] += self.goal
            return Curve(knots, basis.shape_force @ weights.T, self.goal, periodic=True)
        values = self.boundary_values()
        knots = basis.boundary @ values + basis.shape @ weights.T
        return Curve(knots, basis.boundary_force @ values + basis.shape_force @ weights.T, self.goal)

    def initial_state(self) -> DMPState:
        """Return the state at time 0, from which `step` continues."""
        return begin(self.curve, self.start, self.start_velocity * self.duration, self.duration)

    def step(
        self,
        state: DMPState,
        dt: float,
        *,
        rate: float = 1.0,
        coupling: ArrayLike | None = None,
        velocity_coupling: ArrayLike | None = None,
    ) -> DMPState:
        """Advance the state by `dt` [s] online, exactly for any step lengths.

        Parameters
        ----------
        state
            The present state. Replace its `position` by the measured one after a push, its `goal` by the place to
            which the goal has moved, its `duration` to continue at another pace.
        rate
            Pace of the phase: 1 as recorded, 2 twice as fast, 0 paused, negative backwards. Use `rate_for_lag` to
            slow down while a robot lags behind.
        coupling
            An acceleration [m/s^2] that acts during the step, shape (n_dims,); it has no effect in a pause.
        velocity_coupling
            A velocity [m/s] by which the position moves besides during the step, shape (n_dims,); the system's own
            velocity, which the state holds, responds to the displacement (Gams et al., 2014).

        Raises
        ------
        OptionError
            If `dt` is not positive, or something is not finite.
        """
        if not isinstance(state, DMPState) or len(state.position) != self.n_dims:
            raise OptionError("the state is none of this movement", way_out="begin with initial_state()")
        if not np.array_equal(state.goal, state.curve.goal):
            curve = self.towards(goal=state.goal).curve.after(state.curve, state.progress)
            state = replace(state, curve=curve)
        push = None if coupling is None else vector("coupling", coupling, self.n_dims)
        drift = (
            None if velocity_coupling is None else vector("velocity_coupling", velocity_coupling, self.n_dims)
        )
        return advance(state, dt, rate, push, drift)

    def scaling(self) -> Array:
        """Return A(d), which multiplies the learned forcing term. d is the displacement between these ends.

        Returns
        -------
        array, shape (n_dims, n_dims)
        """
        scales = self.variant in (Variant.CLASSIC, Variant.DMP_PLUS_PLUS)
        extent = extent_of(self._learned_path) if scales else 0.0
        return self.variant.scaling(self.learned, self.goal - self.start, extent)

    @property
    def extent(self) -> float:
        """Return the movement's greatest extent [m], from 51 even instants."""
        return extent_of(self.at(np.linspace(0.0, self.duration, N_SEEN)).position)

    @cached_property
    def _learned_path(self) -> Array:
        """Return the movement from zero to `learned`; array, shape (51, n_dims). It is at rest at both ends."""
        sampled = self.basis.sampled(N_SEEN)
        return sampled[: self.weights.shape[1]].T @ self.weights.T + np.outer(sampled[-2], self.learned)

    def _vector(self, name: str, value: ArrayLike | None, default: Array) -> Array:
        return default if value is None else vector(name, value, self.n_dims)


def require_positions(dmp: object) -> None:
    """Raise unless a movement is a primitive of positions."""
    if not isinstance(dmp, DMP):
        raise OptionError(
            f"a {type(dmp).__name__} is no DMP of positions", way_out="give a DMP, such as pose.translation"
        )


def _tell_blown_up(dmp: DMP) -> None:
    """Warn of dimensions that the classic form magnifies, as recorded ends coincide."""
    reach = np.ptp(dmp._learned_path, axis=0)
    factor, learned = np.abs(np.diag(dmp.scaling())), np.abs(dmp.learned)
    i = int(np.argmax(np.where(learned < APART * reach, factor, 0.0)))
    if factor[i] > LARGE and learned[i] < APART * reach[i]:
        warnings.warn(
            f"the classic form magnifies the movement by {factor[i]:.2g} in dimension {i}, where its recorded ends "
            f"are {learned[i]:.2g} apart and it spans {reach[i]:.2g}: it divides by that displacement; fit it with "
            "variant = 'closed-form', which keeps the size",
            ComoveWarning,
            stacklevel=3,
        )


def _goal_velocity(demonstration: Recording) -> Array:
    """Return the recording's velocity at its end, shape (n_dims,), [m/s]."""
    if not hasattr(demonstration, "goal_velocity"):
        raise OptionError(
            f"the {type(demonstration).__name__} knows no velocity at its end",
            key="at_rest",
            way_out="give a Demonstration(time, position), or leave it out",
        )
    return vector("goal_velocity", demonstration.goal_velocity, demonstration.position.shape[1])


def _untaught(dmp: DMP, position: Array) -> NDArray[np.bool_]:
    """Return the dimensions that the classic form cannot learn, shape (n_dims,). Moving ones are warned of."""
    extent = np.ptp(position, axis=0).max()
    untaught = np.abs(dmp.learned) <= NO_WAY * extent
    moving = untaught & (np.ptp(position, axis=0) > NO_WAY * extent)
    if moving.any():
        which = ", ".join(map(str, np.flatnonzero(moving)))
        warnings.warn(
            f"the recording ends where it started in dimension {which}: the classic form learns nothing "
            "there; use another variant",
            ComoveWarning,
            stacklevel=3,
        )
    return untaught


def _tell_few(n_steps: int, n_basis: int, n_ends: int) -> None:
    """Warn of more weights than samples, of which `n_ends` are always met."""
    telling = n_steps - n_ends
    if n_basis > telling:
        fewer = f"give n_basis = {telling} or less, or " if telling > 0 else ""
        warnings.warn(
            f"the recording has {n_steps} samples for {n_basis} weights a dimension, and what is between them is the "
            f"smoothest of many movements: {fewer}record more samples",
            ComoveWarning,
            stacklevel=3,
        )


def _tell_far(dmp: DMP, recording: Recording, at_rest: bool) -> None:
    """Warn of a fit far from its recording, with advice."""
    error, extent = (
        dmp.fit_error(recording),
        extent_of(recording.position[:: len(recording.time) // N_SEEN + 1]),
    )
    unit = getattr(recording, "unit", "m")
    allowed = max(FAR * extent, NEGLIGIBLE.get(unit, 0.0))
    if error.largest <= allowed:
        return
    what, unit = ("rotation", "rad") if unit == ROTATION_VECTOR else ("movement", unit)
    warnings.warn(
        f"the fit of the {what} is off by up to {error.largest:.2g} {unit}, {error.largest / extent:.0%} of its "
        f"extent, at {error.time:.3g} s: {_nearer(dmp, recording, at_rest, allowed)}",
        ComoveWarning,
        stacklevel=3,
    )


def _nearer(dmp: DMP, recording: Recording, at_rest: bool, allowed: float) -> str:
    """Return advice on how to bring a fit near its recording."""
    every = slice(None, None, len(recording.time) // N_TRIED + 1)
    time, position = recording.time[every] - recording.time[0], recording.position[every]

    def fits(**options: Any) -> bool:
        wanted = replace(dmp, **options)
        if wanted.variant is Variant.RHYTHMIC:
            wanted = DMP._fit_cycle(time, position, wanted.weights.shape[1], dmp.duration)
        else:
            wanted = wanted.shaped(time, position)
        return float(wanted.distances_from(time, position).max()) < 0.8 * allowed

    n_basis, most = dmp.weights.shape[1], min(MAX_BASIS, len(recording.time) - 2)
    rests = at_rest and dmp.variant is not Variant.RHYTHMIC and hasattr(recording, "goal_velocity")
    if rests and fits(goal_velocity=_goal_velocity(recording)):
        return "give at_rest=False, since the recording ends in motion"
    while n_basis < most:
        n_basis = min(2 * n_basis, most)
        if fits(weights=np.zeros((dmp.n_dims, n_basis))):
            return f"give n_basis={n_basis}"
    if dmp.variant is Variant.RHYTHMIC:
        return "its cycles differ; cut out some that are alike, or give the period"
    return f"no n_basis up to {most} follows it; smooth the recording, or cut it into parts"


def _least_squares(design: Callable[[slice], tuple[Array, Array]], n_steps: int, block: int = 4000) -> Array:
    """Solve a least-squares problem. Long ones are solved block by block, by normal equations, to limit the memory.

    The weights are scaled well (condition numbers of a few hundred), so squaring the condition number does no harm.

    Parameters
    ----------
    design : function from a slice of the samples to their matrix (n_block, n) and target (n_block, n_dims)
    n_steps : number of samples
    block : number of samples that are in memory at a time

    Returns
    -------
    array, shape (n, n_dims)
    """
    if n_steps <= block:
        matrix, target = design(slice(None))
    else:
        parts = (design(slice(first, first + block)) for first in range(0, n_steps, block))
        products = ((matrix.T @ matrix, matrix.T @ target) for matrix, target in parts)
        matrix, target = reduce(lambda one, other: (one[0] + other[0], one[1] + other[1]), products)
    return np.asarray(np.linalg.lstsq(matrix, target, rcond=None)[0], dtype=np.float64)
