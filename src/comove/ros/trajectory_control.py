"""Rules of a `joint_trajectory_controller` of ros2_control, without ROS.

They are those of its documentation and source (ros2_controllers) for joints with position commands, with the default
parameters:

- A goal is refused unless it names every joint of the controller once, has points whose times rise, and ends at rest
  and in the future.
- Between points positions are interpolated linearly, by cubics where both points have velocities, and by quintics
  where both have accelerations as well. Before the first point they lead there from the present state.
- A goal with the stamp 0 begins at once. A new goal replaces the present one, which is aborted.
- Tolerances compare positions alone. 0 is the controller's own tolerance, -1 none. One for a foreign joint, or
  another negative one, makes all of them those of the controller.
- A goal ends when its last point is due and all joints are within its goal tolerances. After the goal time tolerance
  it is aborted; where that is 0, the controller waits for ever.
- A goal that is cancelled or aborted leaves the joints where they are measured at that instant.

It is stricter than the original, which would move joints in ways that nobody wants: a joint that is named twice,
numbers that are not finite, and accelerations without velocities are refused.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from comove.arrays import Array
from comove.errors import listed

NANO = 10**9
STOPPED = float(np.finfo(np.float32).eps)
"""Largest velocity of a last point [rad/s]."""
ERASED = -1.0
SUCCESSFUL, INVALID_GOAL, PATH_TOLERANCE_VIOLATED, GOAL_TOLERANCE_VIOLATED = 0, -1, -4, -5
FIELDS = ("positions", "velocities", "accelerations", "effort")


class Waypoint(NamedTuple):
    """Point of a trajectory, as in trajectory_msgs: its time after the start [ns], and values of all joints."""

    time: int
    positions: Sequence[float]
    velocities: Sequence[float] = ()
    accelerations: Sequence[float] = ()
    effort: Sequence[float] = ()


@dataclass(frozen=True)
class TrajectoryGoal:
    """Goal of FollowJointTrajectory.

    Attributes
    ----------
    number : identifier
    joints : names of the joints
    stamp : time at which it starts [ns]; 0 for at once
    points : points of the trajectory
    path, end : tolerances of position, velocity and acceleration by joint, on the path and at the goal
    late : time after the last point in which joints must be within the goal tolerances [s]
    """

    number: str
    joints: tuple[str, ...]
    stamp: int
    points: tuple[Waypoint, ...]
    path: Mapping[str, Sequence[float]] = field(default_factory=dict)
    end: Mapping[str, Sequence[float]] = field(default_factory=dict)
    late: float = 0.0

    @classmethod
    def of_message(cls, message: Mapping[str, Any]) -> TrajectoryGoal:
        """Return the goal of an event of `ros2_robot.py`."""
        return cls(
            message["goal"],
            tuple(message["joints"]),
            message["stamp"],
            tuple(Waypoint(**point) for point in message["points"]),
            {name: values for name, *values in message["path"]},
            {name: values for name, *values in message["end"]},
            message["late"],
        )


class ControlState(NamedTuple):
    """Joints at an instant; arrays of shape (n_joints,), in SI units. Derivatives may be missing."""

    position: Array
    velocity: Array | None = None
    acceleration: Array | None = None

    def or_still(self) -> ControlState:
        """Return the state with 0 for missing derivatives."""
        position, velocity, acceleration = self.stacked()
        return ControlState(position, velocity, acceleration)

    def stacked(self) -> Array:
        """Return positions, velocities and accelerations, 0 for missing ones; array, shape (3, n_joints)."""
        return np.stack([np.zeros_like(self.position) if rates is None else rates for rates in self])


class ControlTolerances(NamedTuple):
    """Tolerances of a controller: arrays of shape (n_joints,) [rad], 0 for none, and a time [s]."""

    path: Array
    end: Array
    late: float = 0.0


class GoalEnd(NamedTuple):
    """End of a goal: its number, SUCCEEDED, ABORTED or CANCELED, error code and text."""

    number: str
    status: str
    code: int = SUCCESSFUL
    text: str = ""


def goal_error(goal: TrajectoryGoal, joints: Sequence[str], now: int, *, moving_end: bool = False) -> str:
    """Return the reason why a controller refuses a goal; empty if it does not.

    Parameters
    ----------
    joints : names of the controller's joints
    now : the robot's time [ns]
    moving_end : whether the last point may have a velocity
    """
    named = goal.joints
    foreign = [name for name in named if name not in joints]
    if not named:
        return "it names no joints"
    if foreign:
        return f"the joint '{foreign[0]}' is not one of the controller"
    if missing := [name for name in joints if name not in named]:
        return f"it lacks {listed(missing)}, and goals for some of the joints are not allowed"
    if len(named) != len(joints):
        return f"it names {listed(sorted({name for name in named if named.count(name) > 1}))} twice"
    if not goal.points:
        return "its trajectory is empty"
    for i, point in enumerate(goal.points):
        if wrong := _point_error(point, len(named)):
            return f"point {i} {wrong}"
    for i, (before, after) in enumerate(pairwise(goal.points)):
        if after.time <= before.time:
            first, second = before.time / NANO, after.time / NANO
            return f"times must rise: point {i} is at {first:g} s, the next one at {second:g} s"
    last = goal.points[-1]
    for name, velocity in zip(named, last.velocities, strict=False):
        if abs(velocity) > STOPPED and not moving_end:
            return f"the velocity of '{name}' at the last point is {velocity:g} rad/s, not 0"
    if goal.stamp and goal.stamp + last.time < now:
        return f"it ended {(now - goal.stamp - last.time) / NANO:.3g} s ago by its stamp"
    return ""


def _point_error(point: Waypoint, n_joints: int) -> str:
    for name in FIELDS:
        values = getattr(point, name)
        if len(values) != n_joints and (len(values) or name == "positions"):
            return f"has {len(values)} {name} for {n_joints} joints"
        if not all(map(isfinite, values)):
            return f"has {name} that are not finite"
    if len(point.effort):
        return "has efforts, which controllers of positions do not take"
    if len(point.accelerations) and not len(point.velocities):
        return "has accelerations without velocities"
    return ""


def interpolated(first: ControlState, last: ControlState, span: float, at: float) -> ControlState:
    """Interpolate two states, by the fields that both have.

    Parameters
    ----------
    span : time between the two states [s]
    at : time after the first one, within `span` [s]
    """
    a, b = first.position, last.position
    if span <= 0.0:
        return ControlState(b, np.zeros_like(b), np.zeros_like(b))
    if first.velocity is None or last.velocity is None:
        slope = (b - a) / span
        return ControlState(a + at * slope, slope, np.zeros_like(a))
    va, vb = span * first.velocity, span * last.velocity
    if first.acceleration is None or last.acceleration is None:
        powers = np.stack([a, va, 3 * (b - a) - 2 * va - vb, 2 * (a - b) + va + vb])
    else:
        aa, ab = span**2 * first.acceleration, span**2 * last.acceleration
        powers = np.stack(
            [
                a,
                va,
                aa / 2,
                10 * (b - a) - 6 * va - 4 * vb - 1.5 * aa + 0.5 * ab,
                15 * (a - b) + 8 * va + 7 * vb + 1.5 * aa - ab,
                6 * (b - a) - 3 * (va + vb) - 0.5 * (aa - ab),
            ]
        )
    n = np.arange(len(powers))
    s = at / span
    position = s ** n.astype(float) @ powers
    velocity = (n[1:] * s ** n[:-1]) @ powers[1:] / span
    acceleration = (n[2:] * n[1:-1] * s ** n[:-2]) @ powers[2:] / span**2
    return ControlState(position, velocity, acceleration)


class GoalTrajectory:
    """Trajectory of a goal, from the state at which it was accepted.

    Parameters
    ----------
    goal : accepted goal
    joints : names of the controller's joints, in its order
    now : time at which it is accepted [ns]
    present : state at that time
    """

    def __init__(self, goal: TrajectoryGoal, joints: Sequence[str], now: int, present: ControlState):
        order = [goal.joints.index(name) for name in joints]
        self.start = goal.stamp or now
        self.times = [self.start + point.time for point in goal.points]
        self.states = [_state_of(point, order) for point in goal.points]
        first, still = self.states[0], np.zeros(len(joints))
        velocity, acceleration = present.velocity, present.acceleration
        if velocity is None and first.velocity is not None:
            velocity = still
        if acceleration is None and first.acceleration is not None:
            acceleration = still
        self.before = now, ControlState(present.position, velocity, acceleration)
        self._last = -1, self.before[1]  # time and state asked for last: a command, which is then desired

    def is_over(self, time: int) -> bool:
        """Return whether the last point is due [ns]."""
        return time >= self.times[-1]

    def at(self, time: int) -> ControlState:
        """Return the desired state at a time [ns]."""
        if time != self._last[0]:
            self._last = time, self._at(time)
        return self._last[1]

    def _at(self, time: int) -> ControlState:
        after = bisect_right(self.times, time)
        if after == len(self.times):
            return self.states[-1].or_still()
        begin, first = (self.times[after - 1], self.states[after - 1]) if after else self.before
        span, since = self.times[after] - begin, max(time - begin, 0)
        return interpolated(first, self.states[after], span / NANO, since / NANO)


def _state_of(point: Waypoint, order: Sequence[int]) -> ControlState:
    def ordered(values: Sequence[float]) -> Array | None:
        return np.array(values, dtype=np.float64)[order] if len(values) else None

    return ControlState(
        np.array(point.positions, dtype=np.float64)[order],
        ordered(point.velocities),
        ordered(point.accelerations),
    )


def resolved(goal: TrajectoryGoal, joints: Sequence[str], own: ControlTolerances) -> ControlTolerances:
    """Return the tolerances of a goal, by those of its controller."""
    found = list[Array]()
    for given, usual in ((goal.path, own.path), (goal.end, own.end)):
        values = usual.copy()
        for name, wanted in given.items():
            if name not in joints or any(value < 0.0 and value != ERASED for value in wanted):
                return own
            i = list(joints).index(name)
            values[i] = _resolved(wanted[0], float(usual[i]))
        found.append(values)
    if goal.late < 0.0 and goal.late != ERASED:
        return own
    return ControlTolerances(found[0], found[1], _resolved(goal.late, own.late))


def _resolved(given: float, usual: float) -> float:
    return usual if given == 0.0 else max(given, 0.0)


class TrajectoryController:
    """Controller of joints that follows trajectories, sampled at even instants.

    Parameters
    ----------
    joints : names of its joints
    position : array, shape (n_joints,), positions that it holds at first [rad]
    period : time between updates [ns]
    tolerances : its own tolerances; none unless given
    moving_end : whether goals may end with a velocity
    """

    def __init__(
        self,
        joints: Sequence[str],
        position: Array,
        period: int,
        *,
        tolerances: ControlTolerances | None = None,
        moving_end: bool = False,
    ):
        none = np.zeros(len(joints))
        self.joints, self.period, self.moving_end = tuple(joints), period, moving_end
        self.own = tolerances or ControlTolerances(none, none)
        self.goal: TrajectoryGoal | None = None
        self.desired = self.actual = self.error = ControlState(np.array(position, dtype=float)).or_still()
        self._held = self.desired
        self._trajectory: GoalTrajectory | None = None
        self._tolerances = self.own
        self._is_first = False

    @property
    def start(self) -> int:
        """Return the time at which the present trajectory starts [ns]; 0 without one."""
        return 0 if self._trajectory is None else self._trajectory.start

    def error_of(self, goal: TrajectoryGoal, now: int) -> str:
        """Return the reason why a goal is refused now [ns]; empty if it is not."""
        return goal_error(goal, self.joints, now, moving_end=self.moving_end)

    def accept(self, goal: TrajectoryGoal, now: int, present: ControlState) -> list[GoalEnd]:
        """Follow a goal from now on [ns]. Return the end of the one that it replaces."""
        replaced = self._ended("ABORTED", INVALID_GOAL, "Current goal preempted by new incoming action.")
        self.follow(goal, now, present)
        self.goal = goal
        self._tolerances, self._is_first = resolved(goal, self.joints, self.own), True
        return replaced

    def follow(self, goal: TrajectoryGoal, now: int, present: ControlState) -> None:
        """Follow a trajectory from now on [ns]. Its end is not told, as of one from a topic."""
        self._trajectory = GoalTrajectory(goal, self.joints, now, present)

    def cancel(self, number: str, present: ControlState) -> list[GoalEnd]:
        """End the active goal by its number, and hold the present positions."""
        if self.goal is None or self.goal.number != number:
            return []
        self.hold(present.position)
        return self._ended("CANCELED")

    def hold(self, position: Array) -> None:
        """Hold positions from now on; array, shape (n_joints,) [rad]."""
        self._trajectory, self._held = None, ControlState(np.array(position, dtype=float)).or_still()

    def glide(self, position: Array, over: int, now: int) -> None:
        """Go evenly from the present command to positions within a time [ns]."""
        goal = TrajectoryGoal("", self.joints, 0, (Waypoint(over, position.tolist()),), {}, {}, 0.0)
        self.follow(goal, now, self.desired)

    def update(self, now: int, present: ControlState) -> tuple[ControlState, list[GoalEnd]]:
        """Return the next command, and a goal that ends now.

        Parameters
        ----------
        now : the robot's time [ns]
        present : measured state
        """
        self.desired = self._held if self._trajectory is None else self._trajectory.at(now)
        self.actual, self.error = present, _difference(self.desired, present)
        if self._trajectory is None:
            return self._held, []
        ends = [] if self.goal is None else self._checked(self._trajectory, now, present)
        self._is_first = False
        if self._trajectory is None:
            return self._held, ends
        return self._trajectory.at(now + self.period), ends

    def _checked(self, trajectory: GoalTrajectory, now: int, present: ControlState) -> list[GoalEnd]:
        """Return the end of the goal, if it has ended."""
        over, (path, end, late) = trajectory.is_over(now), self._tolerances
        if (self._is_first or not over) and _is_beyond(self.error, path):
            self.hold(present.position)
            return self._ended("ABORTED", PATH_TOLERANCE_VIOLATED, "Aborted due to path tolerance violation")
        if not over:
            return []
        if not _is_beyond(self.error, end):
            self.hold(trajectory.states[-1].position)
            return self._ended("SUCCEEDED", SUCCESSFUL, "Goal successfully reached!")
        since = (now - trajectory.times[-1]) / NANO
        if late and since > late:
            self.hold(present.position)
            text = f"Aborted due to goal_time_tolerance exceeding by {since:.6f} seconds"
            return self._ended("ABORTED", GOAL_TOLERANCE_VIOLATED, text)
        return []

    def _ended(self, status: str, code: int = SUCCESSFUL, text: str = "") -> list[GoalEnd]:
        goal, self.goal = self.goal, None
        return [] if goal is None else [GoalEnd(goal.number, status, code, text)]


def _difference(desired: ControlState, present: ControlState) -> ControlState:
    velocity = None
    if desired.velocity is not None and present.velocity is not None:
        velocity = desired.velocity - present.velocity
    return ControlState(desired.position - present.position, velocity).or_still()


def _is_beyond(error: ControlState, tolerance: Array) -> bool:
    return bool(((tolerance > 0.0) & (np.abs(error.position) > tolerance)).any())
