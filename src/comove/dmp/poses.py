"""Movements of position and orientation: two primitives on one phase.

The orientation is written as a rotation vector r relative to a reference, ``R = exp(r) R_ref``: the logarithm form
of the quaternion DMP (Ude et al., 2014), in Koutras and Doulgeri's (2020) version, in which r obeys the linear system
itself. Both ends are exact and a rollout is linear in the weights, as for positions. The reference is the goal's
orientation, so that r ends at zero; for movements of about a whole turn or more it lies between the ends, because
near whole turns small changes of orientation can be large changes of r. r is continuous beyond half a turn, and signs
of quaternions do not matter.

Online, pushes and moved goals are separate rotations, ``R = exp(e) exp(r) R_ref``. e is the shortest such rotation;
it decays or is bridged as deviations of positions are.

A movement that turns about a fixed axis, such as any planar movement or that of a tray that stays level, has the
angle about that axis as its only coordinate of orientation: SE(2), or a level SE(3).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array
from comove.brief import brief
from comove.dmp.arguments import numbers, require_steps, vector
from comove.dmp.demonstrations.demonstration import Demonstration
from comove.dmp.dmp import DMP, ROTATION_VECTOR, FitError, Recording
from comove.dmp.online import Curve, DMPState, advance, begin
from comove.dmp.system import N_INTERVALS, Phase
from comove.dmp.variants import Variant
from comove.errors import ComoveWarning, DemonstrationError, OptionError
from comove.geometry import rotations
from comove.trajectory import PoseTrajectory

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

VERTICAL = (0.0, 0.0, 1.0)
UNIT = 1e-3  # by which the norm of a quaternion may be off
SHARES = (0.0, 0.5, 0.25, 0.375)  # of the turn, at which the reference may lie


class PoseRecording(Recording, Protocol):
    """A recording with orientations, to fit a pose primitive to."""

    @property
    def orientation(self) -> Array | None:
        """Return unit quaternions w x y z, shape (n_steps, 4), or None."""


@dataclass(frozen=True, eq=False)
class Pose:
    """A position with an orientation.

    Attributes
    ----------
    position : array, shape (n_dims,), [m]; 2 or 3 coordinates
    orientation : array, shape (4,), unit quaternion w x y z
    """

    position: Array
    orientation: Array = field(default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0]))

    def __post_init__(self) -> None:
        position, orientation = numbers(self.position), numbers(self.orientation)
        if position.shape not in ((2,), (3,)) or not np.isfinite(position).all():
            raise OptionError(f"position = {self.position!r}", way_out="give 2 or 3 finite numbers")
        norm = np.linalg.norm(orientation)
        if orientation.shape != (4,) or not abs(norm - 1.0) <= UNIT:
            raise OptionError(
                f"orientation = {self.orientation!r}",
                way_out="give a unit quaternion, in the order w, x, y, z",
            )
        for name, array in (("position", position), ("orientation", orientation / norm)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @classmethod
    def of(cls, position: ArrayLike, rotation: Rotation | float | None = None) -> Pose:
        """Build a pose from scipy's `Rotation` or a vertical angle [rad]."""
        position = cast(Array, position)  # which the pose converts
        if rotation is None:
            return cls(position)
        if isinstance(rotation, (int, float, np.integer, np.floating)):
            return cls(position, np.array([np.cos(rotation / 2), 0.0, 0.0, np.sin(rotation / 2)]))
        if not hasattr(rotation, "as_quat"):
            raise OptionError(
                f"rotation = {rotation!r}",
                way_out="give scipy's Rotation, or an angle about the vertical [rad]",
            )
        return cls(position, rotation.as_quat(scalar_first=True))

    @property
    def rotation(self) -> Rotation:
        """Return the orientation as scipy's `Rotation`."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self.orientation, scalar_first=True)


@dataclass(frozen=True, eq=False)
class PoseState:
    """The state of the execution of a pose movement.

    Attributes
    ----------
    translation : state of the position
    turning : state of the undisturbed rotation vector, or of the angle
    aside : state of the rotation vector e that turns the undisturbed orientation to the body's
    """

    translation: DMPState
    turning: DMPState
    aside: DMPState

    @property
    def time(self) -> float:
        """Return the time since the start [s]."""
        return self.translation.time

    @property
    def progress(self) -> float:
        """Return the phase in durations."""
        return self.translation.progress


@dataclass(frozen=True, eq=False)
class PoseDMP:
    """A movement on SE(2) or SE(3) on one canonical system.

    Attributes
    ----------
    translation : primitive of the position, n_dims = 2 or 3
    turning : primitive of the rotation vector relative to `reference` (3 coordinates), or of the angle about `axis`
        (1 coordinate) [rad]
    reference : array, shape (4,), the orientation at which `turning` is zero, w x y z
    axis : array, shape (3,), unit vector of the axis of rotation; None if the movement turns freely
    """

    __repr__ = brief

    translation: DMP
    turning: DMP
    reference: Array
    axis: Array | None = None

    def __post_init__(self) -> None:
        sizes = self.n_dims, self.turning.n_dims
        if sizes[0] not in (2, 3) or sizes[1] != (3 if self.axis is None else 1):
            raise OptionError(
                f"{sizes[0]} coordinates of position and {sizes[1]} of orientation",
                way_out="give 2 or 3 of position, and 3 of orientation, or 1 about an axis",
            )
        if self.turning.duration != self.duration:
            raise OptionError(
                f"the turning lasts {self.turning.duration!r} s, the translation {self.duration!r} s",
                way_out="bring them to one duration by towards(duration=...)",
            )
        for name, unit, size in (("reference", self.reference, 4), ("axis", self.axis, 3)):
            if unit is not None and (
                np.shape(unit) != (size,) or not abs(np.linalg.norm(unit) - 1.0) <= 1e-9
            ):
                raise OptionError(f"{name} = {unit!r}", way_out=f"give a unit vector of {size} numbers")

    @classmethod
    def fit(
        cls,
        demonstration: PoseRecording,
        *,
        n_basis: int = 20,
        variant: Variant | str = Variant.CLOSED_FORM,
        phase: Phase | None = None,
        axis: Sequence[float] | None = None,
        at_rest: bool = True,
    ) -> PoseDMP:
        """Fit a primitive to the positions and orientations of a recording.

        Parameters
        ----------
        demonstration
            A recording with orientations. Signs of its quaternions do not matter.
        n_basis, variant, phase
            As for `DMP.fit`; rhythmic movements are not possible.
        axis
            The only axis of rotation, `VERTICAL` for a tray that stays level; the remaining recorded rotation is left
            out, with a warning. In the plane the axis is always the vertical.
        at_rest
            Whether it ends at rest, as for `DMP.fit`.

        Raises
        ------
        DemonstrationError
            If the recording holds no orientations, or turns beyond a whole turn about a wandering axis.
        OptionError
            If an option is out of range.

        Warns
        -----
        ComoveWarning
            If turning about `axis` leaves out more than a hundredth of a radian, or as for `DMP.fit`, of the position
            and of the rotation.
        """
        if Variant.named(variant) is Variant.RHYTHMIC:
            raise OptionError("variant = 'rhythmic' of poses", way_out="use a variant that ends")
        orientation, n_dims = getattr(demonstration, "orientation", None), demonstration.position.shape[1]
        if orientation is None:
            raise DemonstrationError(
                "the recording holds no orientations", way_out="record them, or fit a DMP to the positions"
            )
        if n_dims not in (2, 3):
            raise DemonstrationError(
                f"the recording has {n_dims} coordinates of position",
                way_out="give 2 or 3 beside orientations",
            )
        reference = orientation[-1] / np.linalg.norm(orientation[-1])
        # Of both signs the one with w > 0, or where w is zero the next component.
        reference = reference * np.sign(reference[np.flatnonzero(np.abs(reference) > 1e-9)[0]])
        relative = rotations.quaternion_product(orientation, rotations.conjugate(reference))
        if n_dims == 2 and axis is not None and np.abs(_unit(axis) - VERTICAL).max() > UNIT:
            raise OptionError(
                f"axis = {axis!r} of a planar movement", way_out="leave it out: it is the vertical"
            )
        about = None if axis is None and n_dims == 3 else _unit(VERTICAL if axis is None else axis)
        if about is None:
            turning = rotations.continuous_logarithm(relative)
            _require_continuous(turning, relative)
            between = _between(turning[0])
            if between.any():
                reference = rotations.quaternion_product(rotations.exponential(between), reference)
                relative = rotations.quaternion_product(orientation, rotations.conjugate(reference))
                turning = rotations.continuous_logarithm(relative, -between)
                _require_continuous(turning, relative)
        else:
            turning, left_out = _angles(relative, about)
            if left_out > 0.01:
                warnings.warn(
                    f"the movement tilts by up to {left_out:.3g} rad away from its axis, which is left out",
                    ComoveWarning,
                    stacklevel=2,
                )
        fit = partial(DMP.fit, n_basis=n_basis, variant=variant, phase=phase, at_rest=at_rest)
        turned = Demonstration(demonstration.time, turning, unit=ROTATION_VECTOR)
        return cls(fit(demonstration), fit(turned), reference, about)

    def fit_error(self, recording: PoseRecording, block_size: int = 20_000) -> tuple[FitError, FitError]:
        """Measure the movement's distance from a recording, position and orientation [rad].

        Parameters
        ----------
        recording : its first sample is at the movement's start
        block_size : samples that are compared at a time, so that long recordings need no more memory

        Raises
        ------
        DemonstrationError
            If the recording holds no orientations.
        """
        if recording.orientation is None:
            raise DemonstrationError("the recording holds no orientations", way_out="give one that does")
        time, turn = recording.time, np.zeros(len(recording.time))
        for first in range(0, len(time), block_size):
            block = slice(first, first + block_size)
            played = self._orientation(self.turning.at(time[block] - time[0]).position)
            between = rotations.quaternion_product(played, rotations.conjugate(recording.orientation[block]))
            turn[block] = 2 * np.arctan2(np.linalg.norm(between[:, 1:], axis=1), np.abs(between[:, 0]))
        return self.translation.fit_error(recording), FitError.of(turn, time)

    @property
    def n_dims(self) -> int:
        """Return the dimension of the position: 2 in the plane, 3 in space."""
        return self.translation.n_dims

    @property
    def duration(self) -> float:
        """Return the duration [s]."""
        return self.translation.duration

    @property
    def weights(self) -> Array:
        """Return the free shape weights, position first; array, shape (n_dims + 3 or 1, n_basis)."""
        return np.concatenate([self.translation.weights, self.turning.weights])

    @property
    def start(self) -> Pose:
        """Return the pose at the start of the movement."""
        return Pose(self.translation.start, self._orientation(self.turning.start))

    @property
    def goal(self) -> Pose:
        """Return the pose at the end of the movement."""
        return Pose(self.translation.goal, self._orientation(self.turning.goal))

    def towards(
        self,
        *,
        start: Pose | None = None,
        goal: Pose | None = None,
        duration: float | None = None,
        start_velocity: ArrayLike | None = None,
        goal_velocity: ArrayLike | None = None,
    ) -> PoseDMP:
        """Return the movement between other poses, with the same weights. Arguments not given keep their values.

        Parameters
        ----------
        start, goal : poses
        duration : [s]
        start_velocity, goal_velocity : arrays, shape (n_dims + 3,): velocity [m/s], then angular velocity [rad/s];
            with a fixed axis shape (n_dims + 1,), with the angular velocity about it

        Raises
        ------
        OptionError
            If the duration is not positive, a pose has another dimension, or turns away from the axis.
        """
        poses = {"start": start, "goal": goal}
        given = {name: self._checked(name, pose) for name, pose in poses.items() if pose is not None}
        moved: dict[str, Any] = {name: pose.position for name, pose in given.items()}
        turns: dict[str, Any] = {"start": self.turning.start, "goal": self.turning.goal}
        for name, pose in given.items():
            near, turns[name] = turns[name], self._turn(pose, turns[name])
            self._require_no_leap(name, pose, near, turns[name])
        for name, twist in (("start", start_velocity), ("goal", goal_velocity)):
            if twist is not None:
                moved[f"{name}_velocity"], spin = self._parts(f"{name}_velocity", twist)
                free = self.axis is None
                turns[f"{name}_velocity"] = rotations.rates_of(turns[name], spin) if free else spin
        return replace(
            self,
            translation=self.translation.towards(duration=duration, **moved),
            turning=self.turning.towards(duration=duration, **turns),
        )

    def rollout(
        self,
        *,
        start: Pose | None = None,
        goal: Pose | None = None,
        duration: float | None = None,
        start_velocity: ArrayLike | None = None,
        goal_velocity: ArrayLike | None = None,
        n_steps: int = 201,
    ) -> PoseTrajectory:
        """Play the movement, between other ends if given (see `towards`). It is exact at every sample."""
        require_steps(n_steps)
        dmp = self.towards(
            start=start,
            goal=goal,
            duration=duration,
            start_velocity=start_velocity,
            goal_velocity=goal_velocity,
        )
        return dmp.at(np.linspace(0.0, dmp.duration, n_steps))

    def at(self, time: ArrayLike) -> PoseTrajectory:
        """Return poses and velocities at times [s], shape (n_steps,). After the end it is at rest."""
        moved, turned = self.translation.at(time), self.turning.at(time)
        vectors, rates = self._vectors(turned.position), self._vectors(turned.velocity)
        return PoseTrajectory(
            moved.time,
            moved.position,
            moved.velocity,
            orientation=rotations.quaternion_product(rotations.exponential(vectors), self.reference),
            angular_velocity=rotations.angular_velocity(vectors, rates),
        )

    def initial_state(self) -> PoseState:
        """Return the state at time 0, from which `step` continues."""
        nothing = Curve(np.zeros((3, N_INTERVALS + 1, 3)), np.zeros((N_INTERVALS + 1, 3)), np.zeros(3))
        aside = begin(nothing, np.zeros(3), np.zeros(3), self.duration)
        return PoseState(self.translation.initial_state(), self.turning.initial_state(), aside)

    def step(
        self,
        state: PoseState,
        dt: float,
        *,
        rate: float = 1.0,
        coupling: ArrayLike | None = None,
        velocity_coupling: ArrayLike | None = None,
    ) -> PoseState:
        """Advance the state by `dt` [s] online, exactly, as `DMP.step` does.

        Parameters
        ----------
        coupling : array, shape (n_dims + 3,), an acceleration [m/s^2], then an angular acceleration [rad/s^2], that
            acts during the step; with a fixed axis shape (n_dims + 1,), about that axis
        velocity_coupling : array of the same shape, a velocity [m/s] and an angular velocity [rad/s] by which the
            body moves besides
        """
        push, turn = self._acting("coupling", coupling, state)
        drift, spin = self._acting("velocity_coupling", velocity_coupling, state)
        return PoseState(
            self.translation.step(state.translation, dt, rate=rate, coupling=push, velocity_coupling=drift),
            self.turning.step(state.turning, dt, rate=rate),
            advance(state.aside, dt, rate, turn, spin),
        )

    def pose(self, state: PoseState) -> Pose:
        """Return the pose of a state."""
        aside = rotations.exponential(state.aside.position)
        orientation = rotations.quaternion_product(aside, self._orientation(state.turning.position))
        return Pose(state.translation.position, orientation)

    def twist(self, state: PoseState) -> tuple[Array, Array]:
        """Return a state's velocity [m/s] and angular velocity [rad/s]. Shapes are (n_dims,) and (3,)."""
        return state.translation.velocity, self._spin(state) * (state.turning.rate / state.turning.duration)

    def redirected(self, state: PoseState, goal: Pose) -> PoseState:
        """Return the state for a goal that has moved. The shortest rotation leads to the movement that ends there."""
        goal = self._checked("goal", goal)
        turn = self._turn(goal, state.turning.goal)
        curve = self.turning.towards(goal=turn).curve
        s, now = state.turning.progress, self.pose(state).orientation
        values = curve.at(s)
        turning = replace(state.turning, goal=turn, curve=curve, position=values[0], slope=values[1])
        gap = rotations.turn_between(now, self._orientation(values[0]))
        slope = self._slope(gap, self._spin(state), values)
        moment = 1e-5  # durations, after which both are looked at again, for the curvature of the bridge
        later, then = curve.at(s + moment), self.step(state, moment * state.turning.duration)
        gap_then = rotations.turn_between(self.pose(then).orientation, self._orientation(later[0]))
        bend = (self._slope(gap_then, self._spin(then), later) - slope) / moment
        nothing = replace(state.aside.curve, bridge=None)
        aside = replace(
            state.aside, curve=nothing.bridged(np.stack([gap, slope, bend]), s), position=gap, slope=slope
        )
        return PoseState(replace(state.translation, goal=goal.position), turning, aside)

    def displaced(self, state: PoseState, pose: Pose) -> PoseState:
        """Return the state of a body pushed to `pose`; a fixed axis is kept."""
        pose = self._checked("pose", pose, tilted=True)
        undisturbed = self._orientation(state.turning.position)
        aside = rotations.turn_between(pose.orientation, undisturbed, state.aside.position)
        if self.axis is not None:
            aside = (aside @ self.axis) * self.axis
        return PoseState(
            replace(state.translation, position=pose.position),
            state.turning,
            replace(state.aside, position=aside),
        )

    def _spin(self, state: PoseState) -> Array:
        """Compute a state's angular velocity per progress; array, shape (3,)."""
        aside, turning = state.aside, state.turning
        own = rotations.angular_velocity(self._vectors(turning.position), self._vectors(turning.slope))
        carried = rotations.matrices(rotations.exponential(aside.position)) @ own
        return rotations.angular_velocity(aside.position, aside.slope) + carried

    def _slope(self, aside: Array, spin: Array, values: Array) -> Array:
        """Compute the derivative of `aside` for an angular velocity `spin`.

        exp(aside) exp(r) turns at `spin`; `values` holds r and its derivatives, shape (3, n).
        """
        own = rotations.angular_velocity(self._vectors(values[0]), self._vectors(values[1]))
        return rotations.rates_of(aside, spin - rotations.matrices(rotations.exponential(aside)) @ own)

    def _acting(
        self, name: str, coupling: ArrayLike | None, state: PoseState
    ) -> tuple[Array | None, Array | None]:
        """Return a coupling's parts on position and on rotation vector e."""
        if coupling is None:
            return None, None
        moved, turned = self._parts(name, coupling)
        if self.axis is not None:
            return moved, turned * self.axis
        return moved, rotations.rates_of(state.aside.position, turned)

    def _parts(self, name: str, value: ArrayLike) -> tuple[Array, Array]:
        """Return the position and rotation parts of an array."""
        array = vector(name, value, self.n_dims + self.turning.n_dims)
        return array[: self.n_dims], array[self.n_dims :]

    def _vectors(self, turning: Array) -> Array:
        return turning if self.axis is None else turning * self.axis

    def _orientation(self, turning: Array) -> Array:
        return rotations.quaternion_product(rotations.exponential(self._vectors(turning)), self.reference)

    def _turn(self, pose: Pose, near: Array) -> Array:
        """Return the coordinates of a pose's orientation that are nearest to `near`."""
        vector = rotations.turn_between(pose.orientation, self.reference, self._vectors(near))
        return vector if self.axis is None else np.array([vector @ self.axis])

    def _require_no_leap(self, name: str, pose: Pose, near: Array, turn: Array) -> None:
        """Raise if coordinates leap although the body hardly turns. This happens near whole turns."""
        turned = rotations.turn_between(pose.orientation, self._orientation(near))
        if np.linalg.norm(turn - near) > np.pi + np.linalg.norm(turned):
            raise OptionError(
                f"the {name} turns away from the axis of a movement of whole turns",
                way_out="turn it about that axis only, or cut the movement in two",
            )

    def _checked(self, name: str, pose: Pose, tilted: bool = False) -> Pose:
        if not isinstance(pose, Pose) or len(pose.position) != self.n_dims:
            raise OptionError(f"{name} = {pose!r}", way_out=f"give a Pose in {self.n_dims} dimensions")
        if self.axis is not None and not tilted:
            relative = rotations.quaternion_product(pose.orientation, rotations.conjugate(self.reference))
            _, away = _angles(relative[None], self.axis)
            if away > UNIT:
                raise OptionError(
                    f"the {name} is tilted by {away:.3g} rad away from the movement's axis",
                    way_out="give an orientation that turns about the axis only",
                )
        return pose


def _between(start: Array) -> Array:
    """Return a reference from which both ends are no whole turns. It is a rotation vector relative to the goal.

    Parameters
    ----------
    start : array, shape (3,), rotation vector of the start relative to the goal
    """
    angle = np.linalg.norm(start)

    def margin(share: float) -> float:
        ends = np.array([share * angle, (1 - share) * angle])
        return float(np.abs(ends - 2 * np.pi * np.maximum(np.round(ends / (2 * np.pi)), 1)).min())

    return max(SHARES, key=lambda share: (min(margin(share), 0.5 * np.pi), -share)) * start


def _unit(axis: Sequence[float]) -> Array:
    vector = numbers(axis)
    length = np.linalg.norm(vector)
    if vector.shape != (3,) or not (np.isfinite(length) and length > 0):
        raise OptionError(f"axis = {axis!r}", way_out="give three numbers, not all of them zero")
    return vector / length


def _angles(relative: Array, axis: Array) -> tuple[Array, float]:
    """Return angles about the axis, and the largest tilt from it.

    The angles, shape (n_steps, 1), are continuous and near zero at the end.
    """
    along = relative[:, 1:] @ axis
    angles = np.unwrap(2 * np.arctan2(along, relative[:, 0])[::-1], period=2 * np.pi)[::-1]
    angles = angles - 2 * np.pi * np.round(angles[-1] / (2 * np.pi))
    across = np.linalg.norm(relative[:, 1:] - along[:, None] * axis, axis=1)
    return angles[:, None], float(2 * np.arcsin(np.minimum(across, 1.0)).max())


def _require_continuous(vectors: Array, relative: Array, wandering: float = 0.3) -> None:
    """Raise if rotation vectors jump: beyond the body's rotation and `wandering` [rad]."""
    steps = np.linalg.norm(np.diff(vectors, axis=0), axis=1)
    turned = 2 * np.arccos(np.minimum(np.abs((relative[1:] * relative[:-1]).sum(axis=1)), 1.0))
    jumps = np.flatnonzero(steps > 10 * turned + wandering)
    if jumps.size:
        raise DemonstrationError(
            f"sample {jumps[0] + 1} is a whole turn away from the goal and the axis wanders there",
            key="orientation",
            way_out="cut the recording in two, so that each part turns by less than a whole turn",
        )
