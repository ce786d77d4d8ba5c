"""Controllers of a robot that is moved here: what answers action goals and streamed positions.

One follows trajectories for each arm, or for all arms. Each gripper has one for positions, or for trajectories of its
joint.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from comove.arrays import Array
from comove.model.scene import Scene
from comove.robots.description import RosGripper
from comove.robots.model import Robot
from comove.ros.bridges import Event
from comove.ros.clients import ARM, Names
from comove.ros.streams import StreamNames
from comove.ros.trajectory_control import NANO, ControlState, GoalEnd, TrajectoryController, TrajectoryGoal

SLOWEST = 20_000_000  # ns, in which a streamed position is reached at most
STEADY = 0.05  # share of the last period of streamed positions in what is expected of the next one
TRAJECTORIES = "joint_trajectory"  # topic of a controller beside its action


class MovedRobot(Protocol):
    """A robot that follows commands step by step, such as `comove.sim.robot.SimulatedRobot`."""

    robot: Robot
    scene: Scene
    timestep: float
    n_steps: int
    command: Array

    @property
    def time(self) -> float:
        """Return the time since the start [s]."""

    @property
    def position(self) -> Array:
        """Return the measured joint positions; array, shape (n_joints,) [rad]."""

    @property
    def velocity(self) -> Array:
        """Return the measured joint velocities; array, shape (n_joints,) [rad/s]."""

    @property
    def torque(self) -> Array:
        """Return the motors' torques; array, shape (n_joints,) [N m]."""

    @property
    def is_broken(self) -> bool:
        """Return whether it can go on no more."""

    @property
    def obstacle_centers(self) -> Array:
        """Return the centres of the moving obstacles; array, shape (n_moving, 3) [m]."""

    def begin_obstacles(self) -> None:
        """Let moving obstacles begin now, unless they have begun."""

    def grip(self, arm: str, share: float, effort: float = 0.0) -> None:
        """Close an arm's gripper by a share from 0 to 1. `effort` is the largest [N]; 0 for its own."""

    def closed_share(self, arm: str) -> float:
        """Return the share by which an arm's gripper is closed."""

    def has_gripped(self, arm: str) -> bool:
        """Return whether an arm's gripper is done; it then holds the payload if it can."""

    def holds(self, arm: str) -> bool:
        """Return whether an arm's gripper holds the payload."""

    def news(self) -> list[str]:
        """Return what grippers and payload did since the last call, in words."""

    def step(self, position: Array, velocity: Array, acceleration: Array) -> None:
        """Move for one time step by commanded joints; arrays, shape (n_joints,) [rad, s]."""


class GoalServer(Protocol):
    """What decides about the goals of an action."""

    kind: str

    @property
    def is_busy(self) -> bool:
        """Return whether a goal is executed."""

    def answer(self, event: Event, now: int) -> str:
        """Return the reason why a goal is refused now [ns]; empty if it is accepted."""

    def begin(self, number: str, now: int) -> list[GoalEnd]:
        """Execute an accepted goal; return the end of the one that it replaces."""

    def cancel(self, number: str) -> list[GoalEnd]:
        """End a goal and hold."""

    def feedback(self, now: int) -> dict[str, Any]:
        """Return the progress of the goal, as an order to `ros2_robot.py`."""

    def result(self) -> Mapping[str, Any]:
        """Return what a result holds beside the end of the goal."""


class JointServer:
    """Server of trajectories of some joints.

    Parameters
    ----------
    joints : names of the joints
    measured : function that returns their measured state
    period : time between updates [ns]
    moving_end : whether trajectories may end with a velocity
    """

    kind = "follow_joint_trajectory"

    def __init__(
        self, joints: Sequence[str], measured: Callable[[], ControlState], period: int, *, moving_end: bool
    ):
        self._measured, self._accepted = measured, dict[str, TrajectoryGoal]()
        self.controller = TrajectoryController(joints, measured().position, period, moving_end=moving_end)

    @property
    def is_busy(self) -> bool:
        """Return whether a goal is executed."""
        return self.controller.goal is not None

    def answer(self, event: Event, now: int) -> str:
        """Return the reason why a goal is refused now [ns]; see `GoalServer`."""
        goal = TrajectoryGoal.of_message(event)
        reason = self.controller.error_of(goal, now)
        if not reason:
            self._accepted[goal.number] = goal
        return reason

    def begin(self, number: str, now: int) -> list[GoalEnd]:
        """Execute an accepted goal; see `GoalServer`."""
        return self.controller.accept(self._accepted.pop(number), now, self._measured())

    def cancel(self, number: str) -> list[GoalEnd]:
        """End a goal and hold."""
        return self.controller.cancel(number, self._measured())

    def follow(self, goal: TrajectoryGoal, now: int) -> None:
        """Follow a trajectory that is not a goal from now on [ns]."""
        self.controller.follow(goal, now, self._measured())

    def update(self, now: int) -> tuple[Array, list[GoalEnd]]:
        """Return commanded positions, velocities and accelerations, and ended goals."""
        command, ends = self.controller.update(now, self._measured())
        return command.stacked(), ends

    def feedback(self, now: int) -> dict[str, Any]:
        """Return desired and measured joints and their difference, as an order."""
        controller, fields = self.controller, ("positions", "velocities", "accelerations")
        since = max(0, now - controller.start)
        states = {"desired": controller.desired, "actual": controller.actual, "error": controller.error}
        told = {
            name: {**dict(zip(fields, state.stacked().tolist(), strict=True)), "time_from_start": since}
            for name, state in states.items()
        }
        goal = "" if controller.goal is None else controller.goal.number
        return {
            "do": "feedback",
            "goal": goal,
            "stamp": now,
            "joints": list(controller.joints),
            "states": told,
        }

    def result(self) -> Mapping[str, Any]:
        """Return nothing more."""
        return {}


class GripperServer:
    """Server of positions of an arm's gripper. Fingers that hold the payload have stalled.

    Parameters
    ----------
    robot, arm : robot and its arm
    names : description of the grippers
    """

    def __init__(self, robot: MovedRobot, arm: str, names: RosGripper):
        self.kind: str = names.type
        self._robot, self._arm, self._names = robot, arm, names
        self._accepted = dict[str, tuple[float, float]]()
        self._number: str | None = None

    @property
    def position(self) -> float:
        """Return the position of its joint [rad, m]."""
        names = self._names
        return names.open + self._robot.closed_share(self._arm) * (names.closed - names.open)

    @property
    def is_busy(self) -> bool:
        """Return whether a goal is executed."""
        return self._number is not None

    def move(self, position: float, effort: float = 0.0) -> None:
        """Move to a position of its joint, with a largest effort; 0 for its own."""
        names = self._names
        self._robot.grip(self._arm, (position - names.open) / (names.closed - names.open), effort)

    def answer(self, event: Event, now: int) -> str:
        """Return the reason why a goal is refused now [ns]; see `GoalServer`."""
        position, effort = event["position"], event["effort"]
        if len(position) != 1:
            return f"it has {len(position)} positions for one joint"
        if not np.isfinite([*position, effort]).all():
            return "it has numbers that are not finite"
        self._accepted[event["goal"]] = position[0], effort
        return ""

    def begin(self, number: str, now: int) -> list[GoalEnd]:
        """Execute an accepted goal; see `GoalServer`."""
        replaced, self._number = self._number, number
        self.move(*self._accepted.pop(number))
        return [] if replaced is None else [GoalEnd(replaced, "ABORTED")]

    def cancel(self, number: str) -> list[GoalEnd]:
        """End a goal and hold."""
        if number != self._number:
            return []
        self._number = None
        self.move(self.position)
        return [GoalEnd(number, "CANCELED")]

    def update(self) -> list[GoalEnd]:
        """Return the end of the goal, if it has ended."""
        if self._number is None or not self._robot.has_gripped(self._arm):
            return []
        number, self._number = self._number, None
        return [GoalEnd(number, "SUCCEEDED")]

    def feedback(self, now: int) -> dict[str, Any]:
        """Return its state as an order."""
        return {"do": "progress", "goal": self._number, **self.result()}

    def result(self) -> Mapping[str, Any]:
        """Return its state."""
        holds = self._robot.holds(self._arm)
        return {"position": self.position, "stalled": holds, "reached": not holds}


class FingerServer(JointServer):
    """Server of trajectories of a gripper's joint.

    Parameters
    ----------
    joint : name of the joint
    gripper : server that moves the gripper
    period, moving_end : as of `JointServer`
    """

    def __init__(self, joint: str, gripper: GripperServer, period: int, *, moving_end: bool):
        super().__init__(
            [joint], lambda: ControlState(np.array([gripper.position])), period, moving_end=moving_end
        )
        self._gripper, self._last = gripper, gripper.position

    def update(self, now: int) -> tuple[Array, list[GoalEnd]]:
        """Move the gripper where a trajectory says so; see `JointServer`."""
        command, ends = super().update(now)
        if (wanted := float(command[0, 0])) != self._last:
            self._last = wanted
            self._gripper.move(wanted)
        return command, ends


class RobotControllers:
    """All controllers of a robot.

    Parameters
    ----------
    robot : robot that they move
    names : names of its interfaces
    moving_end : whether trajectories may end with a velocity
    """

    def __init__(self, robot: MovedRobot, names: Names, *, moving_end: bool = False):
        self.robot, self.names = robot, names
        arms, period = robot.robot.arms, round(robot.timestep * NANO)
        self._columns = {arm.name: np.asarray(arm.columns).tolist() for arm in arms}
        self._moved = {
            action: [column for arm in moved for column in self._columns[arm]]
            for action, moved in names.actions(tuple(self._columns)).items()
        }
        self.arms = {
            action: JointServer(
                [robot.robot.joint_names[column] for column in columns],
                self._measured(columns),
                period,
                moving_end=moving_end,
            )
            for action, columns in self._moved.items()
        }
        topics = StreamNames.of(robot.robot).topics({arm: [arm] for arm in self._columns})
        self._streamed = {
            topic: [column for arm in moved for column in self._columns[arm]]
            for topic, moved in topics.items()
        }
        self._streamed_at = dict[str, tuple[int, int]]()
        self._short = {f"{action.rpartition('/')[0]}/{TRAJECTORIES}": action for action in self.arms}
        self._grippers = dict[str, GripperServer]()
        self.fingers = dict[str, FingerServer | GripperServer]()
        if (gripper := names.gripper) is not None:
            for arm in self._columns:
                server = self._grippers[arm] = GripperServer(robot, arm, gripper)
                action = gripper.action.replace(ARM, arm)
                self.fingers[action] = server
                if gripper.type == "joint_trajectory":
                    joint = str(gripper.joint).replace(ARM, arm)
                    self.fingers[action] = FingerServer(joint, server, period, moving_end=moving_end)
        still = np.zeros_like(robot.command)
        self._command = np.stack([robot.command, still, still])  # positions, velocities, accelerations

    def _measured(self, columns: Sequence[int]) -> Callable[[], ControlState]:
        return lambda: ControlState(self.robot.position[columns], self.robot.velocity[columns])

    @property
    def servers(self) -> dict[str, GoalServer]:
        """Return all servers by the names of their actions."""
        return {**self.arms, **self.fingers}

    @property
    def joint_names(self) -> list[str]:
        """Return the names of all joints whose states are told: the robot's, and grippers' that have names."""
        return [*self.robot.robot.joint_names, *self._finger_joints]

    @property
    def _finger_joints(self) -> list[str]:
        gripper = self.names.gripper
        if gripper is None or gripper.joint is None:
            return []
        return [gripper.joint.replace(ARM, arm) for arm in self._grippers]

    def states(self) -> dict[str, list[float]]:
        """Return positions, velocities and efforts of all joints that are told."""
        robot = self.robot
        fingers = [gripper.position for gripper in self._grippers.values()] if self._finger_joints else []
        still = [0.0] * len(fingers)
        return {
            "position": robot.position.tolist() + fingers,
            "velocity": robot.velocity.tolist() + still,
            "effort": robot.torque.tolist() + still,
        }

    def step(self, now: int) -> Iterator[tuple[str, GoalEnd]]:
        """Update all controllers and move the robot one step; yield actions whose goals have ended."""
        found = list[tuple[str, GoalEnd]]()
        for action, columns in self._moved.items():
            self._command[:, columns], ends = self.arms[action].update(now)
            found += [(action, end) for end in ends]
        for action, server in self.fingers.items():
            ends = server.update() if isinstance(server, GripperServer) else server.update(now)[1]
            found += [(action, end) for end in ends]
        self.robot.step(*self._command.copy())
        yield from found

    @property
    def streams(self) -> dict[str, str]:
        """Return the topics of commands, and what they take: positions or short trajectories."""
        return {**dict.fromkeys(self._streamed, "positions"), **dict.fromkeys(self._short, "trajectory")}

    def stream(self, event: Event, now: int) -> str:
        """Follow a streamed command [ns]; return the reason why it is ignored, empty if it is not.

        Servos of robots know how fast their setpoints move: positions are reached after as long as the last one took.
        """
        topic = event["topic"]
        if topic in self._short:
            return self._follow(self._short[topic], event, now)
        columns, position = self._streamed[topic], event["position"]
        if len(position) != len(columns) or not np.isfinite(position).all():
            return f"they are not {len(columns)} finite numbers"
        moved = {action: [c for c in columns if c in own] for action, own in self._moved.items()}
        for action, own in moved.items():
            if own and self.arms[action].is_busy:
                return f"{action} has a goal"
        over = self._expected(topic, now)
        for action, own in moved.items():
            if own:
                controller = self.arms[action].controller
                wanted: Array = controller.desired.position.copy()
                wanted[[self._moved[action].index(c) for c in own]] = [
                    position[columns.index(c)] for c in own
                ]
                controller.glide(wanted, over, now)
        return ""

    def _expected(self, topic: str, now: int) -> int:
        """Return the time until a topic's next command [ns]."""
        before, period = self._streamed_at.get(topic, (now - SLOWEST, SLOWEST))
        taken = min(now - before, SLOWEST)
        period += round(STEADY * (taken - period)) if period < SLOWEST else taken - period
        self._streamed_at[topic] = now, period
        return max(period, round(self.robot.timestep * NANO))

    def _follow(self, action: str, event: Event, now: int) -> str:
        """Follow a short trajectory [ns]; return the reason why it is ignored."""
        server = self.arms[action]
        if server.is_busy:
            return f"{action} has a goal"
        goal = TrajectoryGoal.of_message({"goal": "", "path": [], "end": [], "late": 0.0, **event})
        reason = server.controller.error_of(goal, now)
        if not reason:
            server.follow(goal, now)
        return reason

    def offers(self) -> list[tuple[str, str]]:
        """Return what they offer, in words."""
        rows = [
            ("action", f"{action} ({', '.join(server.controller.joints)})")
            for action, server in self.arms.items()
        ]
        kind = "" if self.names.gripper is None else self.names.gripper.type
        rows += [("gripper", f"{action} ({kind})") for action in self.fingers]
        if not self.fingers:
            rows.append(("grippers", "none: the robot's description has no 'ros: gripper'"))
        rows += [(f"streamed {kind}", topic) for topic, kind in self.streams.items()]
        return rows
