"""Clients for robots in ROS 1 and ROS 2, with FollowJointTrajectory servers.

All arms stop when this process ends, when the bridge to ROS does, and when both do: a second bridge waits for that,
connected beforehand.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from comove.errors import OptionError, SendError, listed
from comove.robots.description import RosGripper, RosNames
from comove.robots.model import Robot
from comove.robots.verification.verify import VerifiedJointMotion
from comove.ros.bridges import BridgeProcess, Event, awaited
from comove.ros.parts import JointSamples
from comove.ros.send import ArmState, RobotState, SendOutcome, Status, Tolerances, send

PYTHON = "COMOVE_ROS_PYTHON"
DISTRIBUTIONS = Path("/opt/ros")
ARM = "{arm}"
GRIP_TIME = 0.5  # s, of a gripper's motion as a trajectory


@dataclass(frozen=True)
class Names:
    """Names of action servers and of the joint-state topic.

    Attributes
    ----------
    action : action of each arm's controller, in which the arm's name replaces ``{arm}``; without it, one controller
        has all arms, and gets one goal; None for the usual one
    joint_states : topic of the joints' positions; None for the usual one
    gripper : controllers of the grippers; None to move none
    """

    action: str | None = None
    joint_states: str | None = None
    gripper: RosGripper | None = None

    @classmethod
    def of(cls, robot: Robot, action: str | None = None, joint_states: str | None = None) -> Names:
        """Return names: those given, else those of the robot's description."""
        own = robot.description.ros or RosNames()
        return cls(action or own.action, joint_states or own.joint_states, own.gripper)

    def or_usual(self, ros: Middleware) -> Names:
        """Return these names, and usual ones where there are none."""
        usual = ros.names
        return Names(self.action or usual.action, self.joint_states or usual.joint_states, self.gripper)

    def actions(self, arms: Sequence[str]) -> dict[str, list[str]]:
        """Return the arms that each action moves."""
        found: dict[str, list[str]] = {}
        for arm in arms:
            found.setdefault((self.action or "").replace(ARM, arm), []).append(arm)
        return found

    def grippers(self, arms: Sequence[str]) -> dict[str, dict[str, str | None]]:
        """Return the controller of each arm's gripper, for a bridge."""
        if (gripper := self.gripper) is None:
            return {}
        joint = gripper.joint
        return {
            arm: {
                "kind": gripper.type,
                "action": gripper.action.replace(ARM, arm),
                "joint": None if joint is None else joint.replace(ARM, arm),
            }
            for arm in arms
        }


@dataclass(frozen=True)
class Middleware:
    """A version of ROS.

    Attributes
    ----------
    version : 1 or 2
    names : names unless others are given: Baxter's, and those of ros2_control's usual controllers
    needs : packages that the bridge loads
    """

    version: int
    names: Names
    needs: str

    @property
    def program(self) -> Path:
        """Return the path of the bridge."""
        return Path(__file__).with_name(f"ros{self.version}_bridge.py")


ROS1 = Middleware(
    1,
    Names("robot/limb/{arm}/follow_joint_trajectory", "/robot/joint_states"),
    "rospy, actionlib and trajectory_msgs",
)
ROS2 = Middleware(
    2,
    Names("/{arm}_controller/follow_joint_trajectory", "/joint_states"),
    "rclpy, control_msgs and trajectory_msgs",
)
MIDDLEWARES = {ros.version: ros for ros in (ROS2, ROS1)}
"""By version, in the order in which they are looked for."""


class RosClient:
    """`TrajectoryClient` for ROS, to be closed or used as context.

    Parameters
    ----------
    versions : versions of ROS to look for, in turn
    names : names of the robot's action servers and topic
    python : path of a Python with ROS; searched for unless given (`COMOVE_ROS_PYTHON`, /usr/bin/python3, ...)
    sim_time : whether time is that of a simulator, on /clock (ROS 2; in ROS 1 the parameter use_sim_time says so)
    answer : time within which a bridge confirms a cancellation, before the second one cancels as well [s]
    starting : time for a Python to load ROS, in addition to the time allowed for the robot [s]
    """

    def __init__(
        self,
        versions: Sequence[int] = tuple(MIDDLEWARES),
        names: Names = Names(),
        python: str | None = None,
        *,
        sim_time: bool = False,
        answer: float = 0.2,
        starting: float = 15.0,
    ):
        self._versions, self._names, self._python = versions, names, python
        self._sim_time, self._answer, self._starting = sim_time, answer, starting
        self._bridge: BridgeProcess | None = None
        self._guard: BridgeProcess | None = None
        self._is_sent = False
        self._actions = dict[str, list[str]]()
        self._state, self._heard, self._ages = RobotState(), dict[str, float](), dict[str, float]()

    @property
    def has_grippers(self) -> bool:
        """Whether the grippers have controllers."""
        return self._names.gripper is not None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def connect(self, arms: Mapping[str, tuple[str, ...]], timeout: float) -> None:
        """Find the action server of each arm; see `TrajectoryClient`. A connection to the same arms is kept."""
        joints = [name for names in arms.values() for name in names]
        if self._is_alive and set(arms) == set(self._state.arms) and set(joints) == set(self._heard):
            self._state = replace(self._state, arms={arm: ArmState() for arm in arms}, grippers={}, time=None)
            return
        tried, refused = list[str](), None
        for ros, python in self._candidates():
            self.close()
            answer = self._begin(ros, python, arms, timeout)
            if answer["event"] == "connected":
                return
            if answer["reason"] not in ("ros", "control_msgs"):
                raise _refusal(answer, timeout)
            if answer["reason"] == "control_msgs":
                refused = refused or _refusal(answer, timeout)
            tried.append(f"{python} (ROS {ros.version}: {answer['what']})")
        self.close()
        raise refused or ros_missing(self._versions, tried)

    @property
    def _is_alive(self) -> bool:
        """Whether both bridges are, and no arm was lost."""
        bridges, arms = (self._bridge, self._guard), self._state.arms.values()
        return all(b is not None and not b.has_ended for b in bridges) and not any(
            arm.status.moves or arm.status is Status.LOST for arm in arms
        )

    def _candidates(self) -> Iterator[tuple[Middleware, str]]:
        for version in self._versions:
            for python in [self._python] if self._python else pythons():
                yield MIDDLEWARES[version], python

    def _begin(
        self, ros: Middleware, python: str, arms: Mapping[str, tuple[str, ...]], timeout: float
    ) -> Event:
        """Start two bridges and connect them; return the first bad answer, or the first one's."""
        names, joints = self._names.or_usual(ros), [name for names in arms.values() for name in names]
        self._actions, self._heard = names.actions(tuple(arms)), dict.fromkeys(joints, -float("inf"))
        self._state, self._ages = RobotState(arms={arm: ArmState() for arm in arms}), {}
        command = {
            "do": "connect",
            "servers": list(self._actions),
            "joint_states": names.joint_states,
            "joints": joints,
            "timeout": timeout,
            "sim_time": self._sim_time,
            "grippers": names.grippers(tuple(arms)),
        }
        try:
            self._bridge = BridgeProcess(python, ros.program)
            self._bridge.tell(command)
            self._guard = BridgeProcess(python, ros.program)
            self._guard.tell({**command, "joints": [], "grippers": {}})
        except OSError as error:
            return {"event": "refused", "reason": "ros", "what": error.strerror or str(error)}
        answers = [
            self._connected(bridge, timeout + self._starting) for bridge in (self._bridge, self._guard)
        ]
        return next((answer for answer in answers if answer["event"] != "connected"), answers[0])

    def _connected(self, bridge: BridgeProcess, timeout: float) -> Event:
        event = self._awaited(bridge, ("connected", "refused"), timeout)
        if event is None or event["event"] == "ended":
            what = "it did not answer" if event is None else bridge.last_words()
            return {"event": "refused", "reason": "ended", "what": what}
        return event

    def send(self, goals: Mapping[str, JointSamples], delay: float, tolerances: Tolerances) -> None:
        """Send all goals with one stamp; see `TrajectoryClient`."""
        ids = {action: uuid.uuid4().hex for action in self._actions}
        told = {}
        for action, moved in self._actions.items():
            goal = JointSamples.joined([goals[arm] for arm in moved])
            told[action] = {
                "id": ids[action],
                "joints": goal.joint_names,
                "time": goal.nanoseconds.tolist(),
                "position": goal.position.tolist(),
                "velocity": goal.velocity.tolist(),
                "acceleration": goal.acceleration.tolist(),
                "path": tolerances.of("path", goal.joint_names),
                "end": tolerances.of("end", goal.joint_names),
                "late": tolerances.late,
            }
        arms = {arm: ArmState(Status.PENDING) for arm in goals}
        state = replace(self._state, arms=arms, time=None, times={}, unstopped=frozenset())
        self._state, self._is_sent = state, False
        if self._guard is not None:
            self._guard.tell({"do": "guard", "ids": ids})
        if self._bridge is not None:
            self._bridge.tell({"do": "send", "delay": delay, "goals": told})

    def grip(self, closed: bool) -> None:
        """Close all grippers, or open them."""
        gripper = self._names.gripper
        if gripper is None or self._bridge is None:
            return
        goal = {
            "position": gripper.closed if closed else gripper.open,
            "effort": gripper.effort or 0.0,
            "seconds": GRIP_TIME,
            "closed": closed,
        }
        self._state = replace(self._state, grippers=dict.fromkeys(self._state.arms, ArmState(Status.PENDING)))
        self._bridge.tell({"do": "grip", "goals": {arm: goal for arm in self._state.arms}})

    def cancel(self) -> None:
        """Stop all arms."""
        bridge, guard = self._bridge, self._guard
        if bridge is not None and not bridge.has_ended:
            bridge.tell({"do": "cancel"})
            if self._has_cancelled(bridge, self._answer):
                return
        if guard is not None:  # the first is gone, hangs or is slow, and the arms may move
            guard.tell({"do": "cancel"})
        if bridge is None or (not bridge.has_ended and self._has_cancelled(bridge, 2.0 * self._answer)):
            return
        if not bridge.has_ended:
            self._lose("did not answer")
            bridge.kill()
        if guard is not None:
            awaited(guard, ("cancelled",), self._starting, [])

    def _has_cancelled(self, bridge: BridgeProcess, within: float) -> bool:
        """Return whether the bridge confirms the cancellation. It may hang, or end meanwhile."""
        event = self._awaited(bridge, ("cancelled",), within)
        if event is not None:
            self._take(event)
        return event is not None and event["event"] == "cancelled"

    def state(self, wait: float) -> RobotState:
        """Return the known state, after waiting at most `wait` [s]."""
        if self._bridge is not None:
            if self._is_sent:
                self._bridge.tell({"do": "beat"})
            for event in self._bridge.news(wait):
                self._take(event)
        if self._guard is not None and self._guard.has_ended:
            self._state = replace(self._state, is_guarded=False)
        return replace(
            self._state, silence=time.monotonic() - min(self._heard.values(), default=-float("inf"))
        )

    def close(self) -> None:
        """End the bridges, which stop all arms that still move."""
        bridge, guard, self._bridge, self._guard = self._bridge, self._guard, None, None
        if bridge is not None:
            bridge.close()
        if guard is not None:
            if not any(arm.status.moves or arm.status is Status.LOST for arm in self._state.arms.values()):
                guard.tell({"do": "guard", "ids": {}})
            guard.close()

    def _awaited(self, bridge: BridgeProcess, kinds: tuple[str, ...], timeout: float) -> Event | None:
        others = list[Event]()
        event = awaited(bridge, kinds, timeout, others)
        for other in others if bridge is self._bridge else ():
            self._take(other)
        return event

    def _take(self, event: Event) -> None:
        """Note an event in the state."""
        state, kind = self._state, event["event"]
        if kind == "joints":
            told = event["position"]
            self._heard |= dict.fromkeys(told, time.monotonic())
            self._ages |= dict.fromkeys(told, event["age"])
            since = event["time"] if self._is_sent else None  # before, it is that of another motion
            times = state.times if since is None else {**state.times, **dict.fromkeys(told, float(since))}
            self._state = replace(
                state,
                position={**state.position, **told},
                time=since,
                times=times,
                age=max(self._ages.values(), key=abs),
            )
        elif kind == "goal":
            arm = ArmState(Status[event["status"]], event["text"], event["time"])
            arms = dict.fromkeys(self._actions[event["server"]], arm)
            self._state = replace(state, arms={**state.arms, **arms})
        elif kind == "sent":
            self._is_sent = True
        elif kind == "gripper":
            gripper = ArmState(Status[event["status"]], event["text"], event["time"])
            self._state = replace(state, grippers={**state.grippers, event["arm"]: gripper})
        elif kind == "busy":
            of_server = set(self._actions[event["server"]])
            busy = (state.busy | of_server) if event["busy"] else (state.busy - of_server)
            self._state = replace(state, busy=busy)
        elif kind == "unstopped":
            going = [arm for server in event["servers"] for arm in self._actions[server]]
            self._state = replace(state, unstopped=frozenset(going))
        elif kind == "conflict":
            self._state = replace(state, conflict=(event["joint"], tuple(event["nodes"])))
        elif kind in ("ended", "refused"):
            self._lose(f"ended: {'' if self._bridge is None else self._bridge.last_words()}")

    def _lose(self, why: str) -> None:
        lost = ArmState(Status.LOST, f"the bridge to ROS {why}")
        arms = {name: arm if arm.status is Status.LOST else lost for name, arm in self._state.arms.items()}
        self._state = replace(self._state, arms=arms)


@dataclass(frozen=True)
class ConnectedRobot:
    """A robot in ROS, to which motions are sent; a context.

    Attributes
    ----------
    client : connection to its controllers
    """

    client: RosClient

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close()

    def send(self, motion: VerifiedJointMotion, **options: Any) -> SendOutcome:
        """Play a verified motion until all arms are done; `options` are those of `comove.ros.send`."""
        return send(self.client, motion, **options)


def connect(
    action: str | None = None,
    joint_states: str | None = None,
    *,
    gripper: RosGripper | None = None,
    version: int | None = None,
    **settings: Any,
) -> ConnectedRobot:
    """Return the robot that is in ROS here, as a context.

    Parameters
    ----------
    action, joint_states, gripper : names as in `Names`; the usual ones unless given
    version : 1 or 2; ROS 2 where it is found, else ROS 1, unless given
    settings : further parameters of `RosClient`

    Raises
    ------
    OptionError
        If there is no such version.

    Examples
    --------
    >>> import comove.ros
    >>> with comove.ros.connect("/{arm}_controller/follow_joint_trajectory") as robot:
    ...     outcome = robot.send(motion)
    """
    if version is not None and version not in MIDDLEWARES:
        raise OptionError(f"there is no ROS {version!r}", key="version", way_out="give 1 or 2")
    versions = tuple(MIDDLEWARES) if version is None else (version,)
    return ConnectedRobot(RosClient(versions, Names(action, joint_states, gripper), **settings))


class Ros1Client(RosClient):
    """`RosClient` for ROS 1."""

    def __init__(self, names: Names = Names(), python: str | None = None, **settings: Any):
        super().__init__((1,), names, python, **settings)


class Ros2Client(RosClient):
    """`RosClient` for ROS 2."""

    def __init__(self, names: Names = Names(), python: str | None = None, **settings: Any):
        super().__init__((2,), names, python, **settings)


def pythons() -> list[str]:
    """Return the Pythons that may have ROS, the likeliest first."""
    named = os.environ.get(PYTHON)
    if named:
        return [named]
    found = [
        "/usr/bin/python3",
        shutil.which("python3"),
        sys.executable,
        shutil.which("python"),
        "/usr/bin/python",
    ]
    return [python for python in dict.fromkeys(found) if python and os.access(python, os.X_OK)]


def started(
    program: Path, command: Mapping[str, Any], ready: str, within: float, python: str | None
) -> tuple[BridgeProcess, Event, list[Event]]:
    """Start a program under the first Python that has ROS 2.

    Parameters
    ----------
    program : path of the program
    command : its first command
    ready : event that answers it
    within : time for the answer [s]
    python : path of the Python; searched for unless given

    Returns
    -------
    process : the process, to be closed
    answer : the event `ready`, or a refusal for another reason than that ROS 2 is missing
    others : events before it

    Raises
    ------
    SendError
        If no Python here has ROS 2.
    """
    tried, lacks = list[str](), None
    for candidate in [python] if python else pythons():
        try:
            process = BridgeProcess(candidate, program)
        except OSError as error:
            tried.append(f"{candidate} ({error.strerror})")
            continue
        process.tell(command)
        others = list[Event]()
        answer = awaited(process, (ready, "refused"), within, others)
        lacks_ros = answer is None or answer.get("reason") in ("ros", "control_msgs", "moveit_msgs", None)
        if answer is not None and (answer["event"] == ready or not lacks_ros):
            return process, answer, others
        what = "it did not answer" if answer is None else answer.get("what") or process.last_words()
        process.close()
        if answer is not None and answer.get("reason") == "moveit_msgs":
            lacks = SendError(
                f"the ROS 2 of {candidate} has no moveit_msgs: {what}",
                key="ros",
                way_out="install it (apt-get install ros-$ROS_DISTRO-moveit-msgs), and source the environment that "
                "has it",
            )
        tried.append(f"{candidate} ({what})")
    raise lacks or ros_missing((ROS2.version,), tried)


def ros_missing(versions: Sequence[int], tried: Sequence[str]) -> SendError:
    """Return the error for ROS that no Python has, with advice."""
    way_out = f"install {MIDDLEWARES[versions[0]].needs}, and name their Python in {PYTHON}"
    with suppress(OSError):
        setups = sorted(
            path / "setup.bash" for path in DISTRIBUTIONS.iterdir() if (path / "setup.bash").is_file()
        )
        if setups and "ROS_DISTRO" not in os.environ:
            way_out = f"give 'source {setups[-1]}' first"
    which = " or ".join(f"ROS {version}" for version in versions)
    return SendError(
        f"no Python here has {which}; tried {', '.join(tried) or 'none'}", key="ros", way_out=way_out
    )


def _refusal(answer: Event, timeout: float) -> SendError:
    """Return the error for a bridge that could not connect, with advice."""
    what, found = answer["what"], answer.get("found") or ()
    others = f"; there are {listed(found)}" if found else "; there is none at all"
    told = {
        "control_msgs": (
            "ros",
            f"ROS 2 has no control_msgs: {what}",
            "install it (apt-get install ros-$ROS_DISTRO-control-msgs), and source the environment that has it",
        ),
        "master": (
            "ROS_MASTER_URI",
            f"there is no ROS master at {what}",
            "start one by roscore, or set ROS_MASTER_URI to that of the robot",
        ),
        "server": (
            "action",
            f"no action server answers at '{what}' within {timeout:g} s{others if 'found' in answer else ''}",
            "start it (Baxter: rosrun baxter_interface joint_trajectory_action_server.py; ROS 2: a "
            "joint_trajectory_controller), or give its name by --action",
        ),
        "answer": (
            "action",
            f"the action server '{what}' is there and does not answer within {timeout:g} s",
            "look whether its node hangs, and whether both sides have the same ROS_DOMAIN_ID and middleware",
        ),
        "name": (
            "action",
            f"ROS takes no name '{what}': {' '.join(found)}",
            "give another --action or topic",
        ),
        "sim_time": (
            "--sim-time",
            "in ROS 1 the parameter use_sim_time says whose time it is",
            "set that, and leave the option out",
        ),
        "grippers": (
            "gripper",
            "grippers are moved in ROS 2 only",
            "leave 'gripper' out of 'ros' in the robot's description",
        ),
        "clock": (
            "use_sim_time",
            f"ROS uses simulated time and nobody tells it on {what}",
            "start the simulation, or set use_sim_time to false",
        ),
    }
    other = "ros", f"the bridge to ROS ended: {what}", "look whether ROS works in its Python"
    key, message, way_out = told.get(answer["reason"], other)
    return SendError(message, key=key, way_out=way_out)
