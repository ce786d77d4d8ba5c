"""Sending of motions to robots with one controller per arm. All arms are stopped when one does not follow. The
coordination is independent of the middleware, which a `TrajectoryClient` connects to (`comove.ros.clients`)."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any, Protocol

import numpy as np

from comove.arrays import Array, first_largest
from comove.errors import OptionError, SendError, near_name
from comove.robots.transfers import Transfers
from comove.robots.verification.verify import VerifiedJointMotion
from comove.ros.parts import (
    CARRY,
    PARTS,
    SAMPLE_RATE,
    GripperMotion,
    JointSamples,
    MotionPart,
    parts_of,
    require_rate,
)

Clock = Callable[[], float]


class Status(Enum):
    """Status of an arm's goal, by the names of ROS."""

    NONE = "none"
    PENDING = "pending"
    ACTIVE = "active"
    SUCCEEDED = "succeeded"
    PREEMPTED = "preempted"
    RECALLED = "recalled"
    ABORTED = "aborted"
    REJECTED = "rejected"
    LOST = "lost"

    @property
    def moves(self) -> bool:
        """Return whether the goal may still move the arm."""
        return self in (Status.PENDING, Status.ACTIVE)


_FAILED = {
    Status.PREEMPTED: "was stopped by somebody else",
    Status.RECALLED: "was called back by somebody else",
    Status.ABORTED: "gave up",
    Status.REJECTED: "refused the goal",
    Status.LOST: "is gone",
}


@dataclass(frozen=True)
class ArmState:
    """State reported by an arm's controller. `time` is that of the report since the common start [s]."""

    status: Status = Status.NONE
    text: str = ""
    time: float | None = None


@dataclass(frozen=True)
class RobotState:
    """Known state of a robot at an instant.

    Attributes
    ----------
    arms : states of the arms, by name
    position : positions of the joints, by name [rad]
    time : time of the newest position since the common start [s]; None before there is one
    times : times of the joints' positions since the common start, by name; `time` for joints that are missing [s]
    age : largest age of a joint's newest position when it arrived [s]; negative if the robot's clock is ahead
    silence : longest time since a joint was last reported [s]; infinite if one never was
    grippers : states of the grippers, by arm, as far as they were told to move
    unstopped : arms whose controllers do not confirm that they stop
    busy : arms whose controllers have goals of other clients
    is_guarded : whether somebody stops the arms if the connection fails
    conflict : a joint that two nodes report, and their names; None if none is known
    """

    arms: Mapping[str, ArmState] = field(default_factory=dict)
    position: Mapping[str, float] = field(default_factory=dict)
    time: float | None = None
    times: Mapping[str, float] = field(default_factory=dict)
    age: float = 0.0
    silence: float = np.inf
    grippers: Mapping[str, ArmState] = field(default_factory=dict)
    unstopped: frozenset[str] = frozenset()
    busy: frozenset[str] = frozenset()
    is_guarded: bool = True
    conflict: tuple[str, tuple[str, ...]] | None = None


class TrajectoryClient(Protocol):
    """Connection to the controllers of a robot's arms."""

    @property
    def has_grippers(self) -> bool:
        """Whether it can move grippers."""

    def connect(self, arms: Mapping[str, tuple[str, ...]], timeout: float) -> None:
        """Find the controller of each arm and listen to its joints. `arms` holds the joint names of each arm.

        Raises
        ------
        SendError
            If a controller, or anything else that is needed, is not found within `timeout` [s].
        """

    def send(self, goals: Mapping[str, JointSamples], delay: float, tolerances: Tolerances) -> None:
        """Send every arm its motion, to begin `delay` [s] from now. All arms begin at the same instant.

        `path`, `end` and `late` of the tolerances are for the controllers.
        """

    def grip(self, closed: bool) -> None:
        """Close all grippers, or open them."""

    def cancel(self) -> None:
        """Stop all arms."""

    def state(self, wait: float) -> RobotState:
        """Return the known state, after waiting at most `wait` [s]."""


JointTolerance = float | Mapping[str, float] | None
"""A tolerance of all joints, or by joint, or None for the usual one."""
UNCERTIFIED = {"start": 0.01, "path": 0.2, "end": 0.0}
"""Tolerances of joints [rad, m] of a motion that is certified for no deviations."""


@dataclass(frozen=True)
class Tolerances:
    """Tolerances beyond which a motion is not started, or is stopped.

    Those of joints are numbers for all or by name. Where they are not given, they are the deviations for which a
    motion is certified (`certified`), and without any those of `UNCERTIFIED`.

    Attributes
    ----------
    start : largest distance of a joint from the first sample [rad, m for prismatic joints]
    path : largest distance of a joint from the running motion [rad, m]
    end : largest distance of a joint from the goal, for the controllers [rad, m]; 0 for what they have by themselves
    connect : time to wait for the robot [s]
    delay : time from sending to the common start, slightly longer for long motions [s]
    late : largest time from the end of the motion until it is reported as done [s]
    silence : largest time without reports of the joints [s]
    clock : largest difference of the robot's clock from this one [s]
    look : time that one query of the state waits for news [s]
    """

    start: JointTolerance = None
    path: JointTolerance = None
    end: JointTolerance = None
    connect: float = 10.0
    delay: float = 0.3
    late: float = 3.0
    silence: float = 0.5
    clock: float = 0.1
    look: float = 0.02

    def __post_init__(self) -> None:
        for name, given in vars(self).items():
            for value in given.values() if isinstance(given, Mapping) else (given,):
                if name in UNCERTIFIED and (value is None or (name == "end" and value == 0)):
                    continue
                if isinstance(value, bool) or not 0 < value < float("inf"):  # NaN would never stop an arm
                    raise OptionError(
                        f"{value} is not possible", key=f"tolerances.{name}", way_out="give a positive number"
                    )

    def of(self, name: str, joints: Sequence[str]) -> list[float]:
        """Return the tolerances of joints: start, path or end [rad, m]."""
        given = getattr(self, name)
        if isinstance(given, Mapping):
            if missing := [joint for joint in joints if joint not in given]:
                raise OptionError(
                    f"'{missing[0]}' has none",
                    key=f"tolerances.{name}",
                    way_out="give all joints', or one number",
                )
            return [float(given[joint]) for joint in joints]
        return [UNCERTIFIED[name] if given is None else float(given)] * len(joints)

    def certified(self, motion: VerifiedJointMotion) -> Tolerances:
        """Return tolerances no wider than the certified deviations of a motion.

        Where none are certified, as they are stated in no description, these tolerances are returned.

        Raises
        ------
        OptionError
            If a given one is wider.
        """
        if motion.report.uncertainty.joints is None:
            return self
        names = motion.robot.joint_names
        allowed = motion.report.uncertainty.deviations(names).tolist()
        chosen = dict[str, Any]()
        for name in UNCERTIFIED:
            if getattr(self, name) is None:
                usual = UNCERTIFIED[name] or np.inf
                chosen[name] = {joint: min(most, usual) for joint, most in zip(names, allowed, strict=True)}
                continue
            for joint, most, value in zip(names, allowed, self.of(name, names), strict=True):
                if not 0 < value <= most:
                    told = f"{value:g} is wider than {most:g}" if value else "0 leaves it to the controllers"
                    raise OptionError(
                        f"{told}, and the motion is certified for deviations of '{joint}' up to {most:g}",
                        key=f"tolerances.{name}",
                        way_out=f"give at most {min(allowed):g}, or leave it out; or state larger deviations in the "
                        "robot's description (uncertainty: joints) and solve the scene again",
                    )
        return replace(self, **chosen)


@dataclass(frozen=True)
class SendOutcome:
    """Result of sending a motion.

    Attributes
    ----------
    arms : last reported states of the arms, by name
    deviation : largest observed distance of a joint from the motion [rad]
    reason : reason why it was stopped; empty if it was not
    """

    arms: Mapping[str, ArmState]
    deviation: float
    reason: str = ""

    @property
    def apart(self) -> float:
        """Return the time between the first and last arm's end [s]."""
        ends = [arm.time for arm in self.arms.values() if arm.time is not None]
        return max(ends) - min(ends) if ends else 0.0


def send(
    client: TrajectoryClient,
    motion: VerifiedJointMotion,
    *,
    part: str = CARRY,
    transfers: Transfers | None = None,
    tolerances: Tolerances = Tolerances(),
    rate: float = SAMPLE_RATE,
    clock: Clock = time.monotonic,
) -> SendOutcome:
    """Play a verified motion on a robot until all arms are done.

    Parameters
    ----------
    client : connection to the robot
    motion : verified motion; no other is accepted
    part : carry, approach or release; the last two are those of `transfers`
    tolerances : none wider than the deviations for which the motion is certified
    rate : samples per second [Hz], at least 20
    clock : function that returns the seconds of a monotonic clock

    Raises
    ------
    ExportError
        If the motion is not verified, or the rate too low.
    OptionError
        If there is no such part, or a tolerance is wider than certified.
    SendError
        If the robot is not found, is not at the motion's start, or an arm does not follow. Once goals were sent, all
        arms have been told to stop.
    """
    parts = parts_of(motion, transfers)
    if part not in parts:
        way_out = "give transfers, which have it" if part in PARTS else near_name(part, PARTS)
        raise OptionError(f"there is no part '{part}'", key="part", way_out=way_out)
    chosen = parts[part]
    require_rate(motion, rate)
    tolerances = tolerances.certified(motion)
    client.connect(chosen.arms, tolerances.connect)
    _require_start(client, chosen, tolerances, clock)
    grips = chosen.grips if client.has_grippers else ()
    if grips and grips[0].time < 0.0:
        _gripped(client, grips[0].closed, tolerances, clock)
    samples = chosen.samples(rate)
    goals = {arm: samples.of(names) for arm, names in chosen.arms.items()}
    delay = tolerances.delay + 1e-4 * len(samples.nanoseconds) * len(
        goals
    )  # s, that a sample may need on its way to an arm
    try:
        client.send(goals, delay, tolerances)
        return _watched(
            client, chosen, [grip for grip in grips if grip.time >= 0.0], tolerances, delay, clock
        )
    except BaseException:  # whatever it is, no arm goes on alone
        client.cancel()
        raise


def _require_start(client: TrajectoryClient, part: MotionPart, tolerances: Tolerances, clock: Clock) -> None:
    """Check that the robot reports its joints at the motion's start."""
    wanted = part.joints.joint_names
    until = clock() + tolerances.connect
    state = client.state(tolerances.look)
    while clock() < until and not (set(wanted) <= set(state.position) and abs(state.age) <= tolerances.clock):
        state = client.state(tolerances.look)
    if not state.position:
        raise SendError(
            f"the robot's joints have said nothing for {tolerances.connect:g} s",
            key="joint_states",
            way_out="switch the robot on, and name the topic on which it tells its joints",
        )
    missing = [name for name in wanted if name not in state.position]
    if missing:
        raise SendError(
            f"the robot says nothing of a joint '{missing[0]}'",
            key="joint_states",
            way_out=f"send it to the robot it was made for, '{part.provenance.robot}'",
        )
    if not abs(state.age) <= tolerances.clock:
        raise SendError(
            f"the robot tells its joints with stamps {state.age:.2g} s old ({tolerances.clock:g} s allowed), and the "
            "arms begin by the clock",
            key="clock",
            way_out="set both clocks by the same time server (NTP)",
        )
    _require_alone(state, part)
    found = np.array([state.position[name] for name in wanted])
    off, allowed = np.abs(found - part.joints.position[0]), np.array(tolerances.of("start", wanted))
    if not (off <= allowed).all():
        worst = first_largest(np.nan_to_num(off / allowed, nan=np.inf))
        way_out = "bring the robot there first, by the approach for example"
        if (np.abs(np.radians(found) - part.joints.position[0]) <= allowed).all():
            way_out = "the robot seems to tell degrees: have it tell its joints in rad"
        raise SendError(
            f"the joint '{wanted[worst]}' is at {found[worst]:.4f} rad, and the {part.name} begins at "
            f"{part.joints.position[0, worst]:.4f} rad, {off[worst]:.3g} rad away ({allowed[worst]:g} allowed)",
            key="start",
            way_out=way_out,
        )


def _require_alone(state: RobotState, part: MotionPart) -> None:
    """Check that nobody else moves the arms, or reports their joints."""
    busy = [arm for arm in part.arms if arm in state.busy]
    if busy:
        raise SendError(
            f"the controller of the arm '{busy[0]}' has a goal of another client",
            key="action",
            way_out="wait for its end, or cancel it",
        )
    if state.conflict is not None:
        joint, nodes = state.conflict
        raise SendError(
            f"the joint '{joint}' is told by several nodes: {', '.join(nodes)}",
            key="joint_states",
            way_out="end all but the robot's own, or name its topic",
        )


def _gripped(client: TrajectoryClient, closed: bool, tolerances: Tolerances, clock: Clock) -> None:
    """Move the grippers before anything else, and wait until they are done."""
    client.grip(closed)
    until = clock() + tolerances.connect
    while clock() < until:
        state = client.state(tolerances.look)
        reason = _grippers_failure(state)
        if reason:
            raise SendError(reason, key="gripper", way_out="look at it, or leave 'gripper' out of 'ros'")
        if all(gripper.status is Status.SUCCEEDED for gripper in state.grippers.values()):
            return
    raise SendError(
        f"the grippers were not done after {tolerances.connect:g} s",
        key="gripper",
        way_out="look at them, or leave 'gripper' out of 'ros'",
    )


def _grippers_failure(state: RobotState) -> str:
    for name, gripper in state.grippers.items():
        if gripper.status in _FAILED:
            told = f": {gripper.text}" if gripper.text else ""
            return f"the controller of the gripper of '{name}' {_FAILED[gripper.status]}{told}"
    return ""


def _watched(
    client: TrajectoryClient,
    part: MotionPart,
    grips: list[GripperMotion],
    tolerances: Tolerances,
    delay: float,
    clock: Clock,
) -> SendOutcome:
    """Wait until all arms are done, with the grippers moved meanwhile; stop all if one fails."""
    began, worst = clock(), 0.0
    within = np.array(tolerances.of("path", part.joints.joint_names))
    while True:
        state = client.state(tolerances.look)
        if grips and state.time is not None and state.time >= grips[0].time:
            client.grip(grips.pop(0).closed)
            state = client.state(0.0)
        off = _deviations(state, part)
        worst = max(worst, float(off.max()))
        reason = _failure(state, tolerances)
        if not reason and not (off <= within).all():
            joint = first_largest(off / within)
            reason = (
                f"the joint '{part.joints.joint_names[joint]}' is {off[joint]:.3g} rad off the motion "
                f"({within[joint]:g} allowed)"
            )
        if not reason and state.time is not None and state.time > part.released_by:
            held = [
                name for name, gripper in state.grippers.items() if gripper.status is not Status.SUCCEEDED
            ]
            reason = f"the gripper of '{held[0]}' was not open when its arm was to leave" if held else ""
        ends = [state.arms.get(arm, ArmState()) for arm in part.arms] + list(state.grippers.values())
        if not reason and not grips and all(end.status is Status.SUCCEEDED for end in ends):
            return SendOutcome(state.arms, worst)
        allowed = part.joints.duration + tolerances.late
        # Time of ROS, which may be a simulator's; where no joint has told it yet, of this clock.
        passed = clock() - began - delay if state.time is None else state.time
        if not reason and not passed <= allowed:
            slow = next(
                (n for n in part.arms if state.arms.get(n, ArmState()).status is not Status.SUCCEEDED),
                next(iter(part.arms)),
            )
            reason = f"the arm '{slow}' was not done {tolerances.late:g} s after the end of the motion"
        if reason:
            client.cancel()
            state = _stopped(client, tolerances, clock)
            going = [name for name in part.arms if name in state.unstopped or _goes_on(state, name)]
            way_out = "all arms were told to stop; look at the robot before anything else"
            if going:
                way_out = f"STOP THE ROBOT: {', '.join(going)} did not confirm the command to stop"
            error = SendError(reason, way_out=way_out)
            error.outcome = SendOutcome(state.arms, worst, reason)
            raise error


def _failure(state: RobotState, tolerances: Tolerances) -> str:
    """Return the reason why the motion cannot continue; empty if none."""
    begun = 0.1  # s after the start, when every arm must have said that it has begun
    for name, arm in state.arms.items():
        if arm.status in _FAILED:
            told = f": {arm.text}" if arm.text else ""
            return f"the controller of the arm '{name}' {_FAILED[arm.status]}{told}"
        if arm.status is Status.PENDING and state.time is not None and state.time > begun:
            return f"the controller of the arm '{name}' had not taken its goal when all were to begin"
    if reason := _grippers_failure(state):
        return reason
    if not state.is_guarded:
        return "the second bridge to ROS has ended, which would stop the arms if the first one failed"
    if state.busy:
        return f"another client has sent the controller of the arm '{min(state.busy)}' a goal"
    if not abs(state.age) <= tolerances.silence:
        return f"the robot's joints are told with stamps {state.age:.2g} s old"
    if not state.silence <= tolerances.silence:
        return f"the robot's joints have said nothing for {state.silence:.2g} s"
    return ""


def _deviations(state: RobotState, part: MotionPart) -> Array:
    """Return the joints' distances from the motion; array, shape (n_joints,)."""
    names, joints = part.joints.joint_names, part.joints
    if state.time is None:
        return np.zeros(len(names))
    times = np.array([state.times.get(name, state.time) for name in names])
    wanted = np.diagonal(joints.curve(np.clip(times, 0.0, joints.duration)))
    return np.nan_to_num(np.abs([state.position[name] for name in names] - wanted), nan=np.inf)


def _goes_on(state: RobotState, name: str) -> bool:
    """Return whether an arm may still move."""
    status = state.arms.get(name, ArmState()).status
    return status.moves or status is Status.LOST


def _stopped(client: TrajectoryClient, tolerances: Tolerances, clock: Clock) -> RobotState:
    until = clock() + 1.0
    state = client.state(tolerances.look)
    while any(arm.status.moves for arm in state.arms.values()) and clock() < until:
        state = client.state(tolerances.look)
    return state
