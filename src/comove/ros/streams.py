"""Streams of joint commands to a robot in ROS 2.

Its joints and the obstacles around it come back.

`ros2_stream.py` runs under ROS's own Python, plays the commands and brakes where they are late. Commands to it:

    {"do": "connect", "topics": {TOPIC: [JOINT]}, "joint_states": TOPIC, "joints": [JOINT], "period": s, "silence": s,
        "obstacles": TOPIC or null, "timeout": s}
    {"do": "begin", "position": [rad], "velocity": [rad/s], "acceleration": [rad/s^2]}
    {"do": "follow", "run": n, "number": n, "position": [rad]}   played a period after the one before
    {"do": "brake", "why": TEXT}

Events, with instants by the system's monotonic clock:

    {"event": "connected", "kinds": [TYPE], "obstacles": TYPE or null}   clouds are read as in `comove.ros.clouds`
    {"event": "joints", "time": s, "age": s, "position": {NAME: rad}}
    {"event": "obstacles", "time": s, "frame": NAME, "centers": {NAME: [m]}, "counted": whether the names are places
        in a list, which others take where one is missing}
    {"event": "braked", "run": n, "why": TEXT, "position": [rad]}     at rest; another run may begin
    {"event": "played", "time": [s], "number": [n], "run": [n], "commanded": [[rad]], "measured": [[rad]]}
    {"event": "played_all"}                               after the last one, when the input has ended
    {"event": "commanded", "topic": TOPIC, "nodes": [NODE]}            others command it as well
    {"event": "refused" | "conflict", ...}                as in `comove.ros.bridges`
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple, Self

import numpy as np

from comove.arrays import Array
from comove.errors import SendError, listed
from comove.model.scene import Scene
from comove.robots.description import RosNames
from comove.robots.model import Robot
from comove.ros.bridges import BridgeProcess, Event, awaited
from comove.ros.clients import ARM, ROS2, started
from comove.ros.clouds import CLOUD, STARTING, ObstacleClouds

PROGRAM = Path(__file__).with_name("ros2_stream.py")
ENDING = 6.0  # s, for the arms to rest at the end
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"


@dataclass(frozen=True)
class StreamNames:
    """Names of topics.

    Attributes
    ----------
    commands : topic of each arm's controller, in which the arm's name replaces ``{arm}``; without it, one controller
        has all arms
    joint_states : topic of the joints' positions
    obstacles : topic of the obstacles' positions; None for those of the scene
    frame : frame of the obstacles' positions, which must be that of the scene
    """

    commands: str = "/{arm}_position_controller/commands"
    joint_states: str = str(ROS2.names.joint_states)
    obstacles: str | None = None
    frame: str = "world"

    @classmethod
    def of(cls, robot: Robot, **given: str | None) -> StreamNames:
        """Return names: those given, else those of the robot's description, else usual ones."""
        own = robot.description.ros or RosNames()
        told = {"commands": own.commands, "joint_states": own.joint_states}
        return cls(
            **{name: value for name, value in (told | _without_none(given)).items() if value is not None}
        )

    def topics(self, arms: Mapping[str, Sequence[str]]) -> dict[str, list[str]]:
        """Return the joints that each topic moves."""
        found: dict[str, list[str]] = {}
        for arm, joints in arms.items():
            found.setdefault(self.commands.replace(ARM, arm), []).extend(joints)
        return found


def _without_none(given: Mapping[str, str | None]) -> dict[str, str | None]:
    return {name: value for name, value in given.items() if value is not None}


@dataclass(frozen=True)
class StreamSettings:
    """Settings of a stream.

    Attributes
    ----------
    period : time between commands [s]
    connect : time to wait for the robot [s]
    joints_silence, obstacles_silence : time without reports of joints, of obstacles, after which the arms brake [s]
    clock : largest difference of the robot's clock from this one [s]
    noise : standard deviation of the points of clouds [m]
    """

    period: float = 0.004
    connect: float = 10.0
    joints_silence: float = 0.25
    obstacles_silence: float = 0.5
    clock: float = 0.1
    noise: float = 0.005


class SeenObstacle(NamedTuple):
    """A measured obstacle: number in the scene, centre (3,) [m], and instant by the monotonic clock [s]."""

    number: int
    center: Array
    time: float


class Played(NamedTuple):
    """Commands as they were played; arrays with a row a period.

    Attributes
    ----------
    time : (n_steps,), instants by the monotonic clock [s]
    number : (n_steps,), numbers of the commands, -1 where it braked or held
    commanded, measured : (n_steps, n_joints), commanded joints, and those measured last [rad]
    """

    time: Array
    number: Array
    commanded: Array
    measured: Array


class Braked(NamedTuple):
    """A stop that was not commanded: the run that it ended, the reason, and the joints (n_joints,) [rad]."""

    run: int
    why: str
    position: Array


class CommandStream:
    """Stream of joint commands to a robot, as context.

    Parameters
    ----------
    robot : robot whose arms are commanded
    names : names of its topics
    settings : settings
    obstacles : names of the obstacles whose positions are told, by their numbers in the scene
    scene : their scene, without which point clouds do not tell where they are
    python : path of a Python with ROS 2; searched for unless given

    Attributes
    ----------
    kinds : types of the command topics
    ages : ages of the joints' reports when they arrived [s], the newest 10,000

    Raises
    ------
    SendError
        If there is no ROS 2 here, nobody listens to the commands, or joints or obstacles are not told.
    """

    def __init__(
        self,
        robot: Robot,
        names: StreamNames | None = None,
        settings: StreamSettings = StreamSettings(),
        *,
        obstacles: Mapping[int, str] | None = None,
        scene: Scene | None = None,
        python: str | None = None,
    ):
        self.robot, self.names, self.settings = robot, names or StreamNames.of(robot), settings
        self.kinds, self.ages = frozenset[str](), list[float]()
        self._obstacles = dict(obstacles or {})
        self._numbers = {name: number for number, name in self._obstacles.items()}
        self._position, self._heard = dict[str, float](), dict[str, float]()
        self._seen_at = dict.fromkeys(self._obstacles, -np.inf)
        self._braked, self._rows = list[Braked](), list[Event]()
        self._bridge, told_by = self._opened(python)
        self._clouds = None if told_by != CLOUD else self._read(scene, python)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _opened(self, python: str | None) -> tuple[BridgeProcess, str | None]:
        """Start the bridge; return it, and the type of the obstacles' topic."""
        names, how = self.names, self.settings
        arms = {arm.name: _joints_of(self.robot, arm.columns) for arm in self.robot.arms}
        command = {
            "do": "connect",
            "topics": names.topics(arms),
            "joint_states": names.joint_states,
            "joints": list(self.robot.joint_names),
            "period": how.period,
            "silence": how.joints_silence,
            "obstacles": names.obstacles,
            "timeout": how.connect,
        }
        process, answer, others = started(PROGRAM, command, "connected", how.connect + STARTING, python)
        if answer["event"] != "connected":
            process.close()
            raise _stream_refusal(answer, how.connect)
        self.kinds = frozenset(answer["kinds"])
        try:
            for event in others:
                self._take(event)
        except SendError:
            process.close()
            raise
        return process, answer.get("obstacles")

    def _read(self, scene: Scene | None, python: str | None) -> ObstacleClouds:
        """Start the program that reads clouds."""
        topic = str(self.names.obstacles)
        try:
            if scene is None:
                raise SendError(
                    f"'{topic}' has clouds, and shapes are not known",
                    key="obstacles",
                    way_out="give the scene as well",
                )
            return ObstacleClouds(topic, scene, self._obstacles, self.settings.noise, python)
        except BaseException:
            self._bridge.close()
            raise

    @property
    def lead(self) -> int:
        """Return the number of commands that are sent ahead of their time."""
        return 3 if TRAJECTORY not in self.kinds else 3 + round(0.02 / self.settings.period)

    @property
    def position(self) -> Array:
        """Return the measured joints; array, shape (n_joints,) [rad]."""
        return np.array([self._position[name] for name in self.robot.joint_names])

    @property
    def joints_age(self) -> float:
        """Return the time since the joint heard least recently was measured [s].

        It is negative for stamps from the future, and infinite until all are known.
        """
        if self._heard.keys() < set(self.robot.joint_names):
            return np.inf
        now = time.monotonic()
        return max((now - at for at in self._heard.values()), key=abs)

    @property
    def obstacles_age(self) -> float:
        """Return the age of the oldest obstacle's measurement [s].

        It is 0 if none are to be told, and negative for stamps from the future.
        """
        now = time.monotonic()
        return max((now - at for at in self._seen_at.values()), key=abs, default=0.0)

    def require_clock(self) -> None:
        """Wait until the joints are as new as clocks allow.

        Raises
        ------
        SendError
            If none is.
        """
        until = time.monotonic() + self.settings.connect
        while not abs(self.joints_age) <= self.settings.clock:
            self.news(0.02)
            if time.monotonic() > until:
                raise SendError(
                    f"the robot tells its joints with stamps {self.ages[-1]:.2g} s old "
                    f"({self.settings.clock:g} s allowed)",
                    key="clock",
                    way_out="set both clocks by the same time server (NTP)",
                )

    @property
    def threads(self) -> list[Thread]:
        """Return the threads that must be in time."""
        return self._bridge.threads

    def begin(self, position: Array) -> None:
        """Begin to play commands, from joints at which the robot rests; array, shape (n_joints,) [rad]."""
        limits = {"velocity": self.robot.velocity.tolist(), "acceleration": self.robot.acceleration.tolist()}
        self._bridge.tell({"do": "begin", "position": position.tolist(), **limits})

    def follow(self, run: int, number: int, position: Array) -> None:
        """Send the next command of a run; array, shape (n_joints,) [rad]. A braked run is not followed any more."""
        self._bridge.tell({"do": "follow", "run": run, "number": number, "position": position.tolist()})

    def brake(self, why: str) -> None:
        """Bring the arms to rest."""
        self._bridge.tell({"do": "brake", "why": why})

    def news(self, wait: float) -> list[SeenObstacle]:
        """Return the obstacles measured since the last call, in order. It waits at most `wait` [s]."""
        found = [seen for event in self._bridge.news(wait) for seen in self._take(event)]
        if self._clouds is not None:
            found += [seen for event in self._clouds.news() for seen in self._seen(event)]
            if self._clouds.ended and np.isfinite(list(self._seen_at.values())).any():
                self._seen_at = dict.fromkeys(self._seen_at, -np.inf)
                self.brake(self._clouds.ended)
        return found

    def why_unseen(self, name: str) -> str:
        """Return in words why points do not tell where an obstacle is; empty if no clouds are read."""
        return self._clouds.unseen.get(name, "") if self._clouds is not None else ""

    def let_turn(self, time: float) -> None:
        """Let turning obstacles begin at an instant by the monotonic clock [s]."""
        if self._clouds is not None:
            self._clouds.begin(time)

    def braked(self) -> Braked | None:
        """Return the next stop that was not commanded, once; None without one."""
        return self._braked.pop(0) if self._braked else None

    def end(self) -> Played:
        """Bring the arms to rest, and end the process; return all commands that were played."""
        self._bridge.end_input()
        others = list[Event]()
        awaited(self._bridge, ("played_all",), ENDING, others)
        for event in others:
            self._take(event)
        self.close()
        rows = {name: [row for event in self._rows for row in event[name]] for name in _PLAYED}
        joints = {
            name: np.reshape(rows[name], (-1, len(self.robot.joint_names)))
            for name in ("commanded", "measured")
        }
        return Played(np.array(rows["time"]), np.array(rows["number"], dtype=int), **joints)

    def close(self) -> None:
        """End the processes; arms that move come to rest."""
        if self._clouds is not None:
            self._clouds.end_input()
        self._bridge.close()
        if self._clouds is not None:
            self._clouds.close()

    def _take(self, event: Event) -> list[SeenObstacle]:
        """Note an event; return the obstacles of which it tells."""
        kind = event["event"]
        if kind == "joints":
            self._position |= event["position"]
            self._heard |= dict.fromkeys(event["position"], event["time"])
            self.ages = [*self.ages[-9_999:], event["age"]]
        elif kind == "obstacles":
            return self._seen(event)
        elif kind == "played":
            self._rows.append(event)
        elif kind == "braked":
            self._braked.append(Braked(event["run"], event["why"], np.array(event["position"])))
        elif kind == "conflict":
            raise SendError(
                f"the joint '{event['joint']}' is told by several nodes: {', '.join(event['nodes'])}",
                key="joint_states",
                way_out="end all but the robot's own, or name its topic",
            )
        elif kind == "commanded":
            raise _stream_refusal({"reason": kind, "what": event["topic"], "found": event["nodes"]}, 0.0)
        elif kind in ("ended", "refused"):
            raise SendError(
                f"the bridge to ROS ended: {event.get('what') or self._bridge.last_words()}",
                key="ros",
                way_out="look whether ROS works in its Python",
            )
        return []

    def _seen(self, event: Event) -> list[SeenObstacle]:
        """Return the obstacles of an event. Their names must be the scene's; numbers count those that move."""
        frame, wanted = event["frame"], self.names.frame
        if frame not in ("", wanted):
            raise SendError(
                f"{self.names.obstacles} tells obstacles in the frame '{frame}', and the scene is in '{wanted}'",
                key="frame",
                way_out=f"publish them in '{wanted}', or give --frame '{frame}' if that is the scene's",
            )
        counted, found = list(self._obstacles), list[SeenObstacle]()
        if event["event"] != "obstacles":
            return found
        missing = event.get("counted") and len(event["centers"]) != len(counted)
        for name, center in () if missing else event["centers"].items():
            number = self._numbers.get(name)
            if number is None and name.isdecimal() and int(name) < len(counted):
                number = counted[int(name)]
            if number is not None and np.isfinite(center).all():
                found.append(SeenObstacle(number, np.array(center, dtype=float), event["time"]))
        if counted and not found and not np.isfinite(list(self._seen_at.values())).any():
            told = ", ".join(event["centers"]) or "nothing"
            raise SendError(
                f"{self.names.obstacles} tells of {told}, and not of '{self._obstacles[counted[0]]}'",
                key="obstacles",
                way_out="give it the names that obstacles have in the scene, or numbers from 0 in their order, "
                "as many as move",
            )
        self._seen_at |= {seen.number: seen.time for seen in found}
        return found


_PLAYED = ("time", "number", "run", "commanded", "measured")


def _joints_of(robot: Robot, columns: Any) -> list[str]:
    return [robot.joint_names[column] for column in columns]


def _stream_refusal(answer: Event, timeout: float) -> SendError:
    """Return the error for a stream that could not begin, with advice."""
    what, found = answer.get("what") or "it did not answer", answer.get("found") or ()
    there = f"; there are {listed(found)}" if found else ""
    told = {
        "stream": (
            "commands",
            f"nobody listens to '{what}' within {timeout:g} s{there}",
            "start a forward_command_controller or joint_trajectory_controller, or give its topic by --commands",
        ),
        "kind": (
            "commands",
            f"'{what}' takes {listed(found)}",
            "give a topic of std_msgs/msg/Float64MultiArray or trajectory_msgs/msg/JointTrajectory",
        ),
        "order": (
            "commands",
            f"the controller of '{what}' moves {listed(found, 12)}, other joints than the arm",
            "give that arm's own topic by --commands, or name its joints in the controller's parameters",
        ),
        "commanded": (
            "commands",
            f"other nodes command '{what}': {listed(found)}",
            "end them: one may command an arm",
        ),
        "obstacles": (
            "obstacles",
            f"nobody tells obstacles on '{what}' within {timeout:g} s{there}",
            "start what tells them, or give another topic by --obstacles",
        ),
        "obstacle_kind": (
            "obstacles",
            f"'{what}' has messages of type {listed(found)}",
            "give a topic of PoseArray, MarkerArray, CollisionObject, PlanningScene or PointCloud2",
        ),
        "joints": (
            "joint_states",
            f"the robot says nothing of a joint '{what}' within {timeout:g} s"
            + (f"; it tells of {listed(found)}" if found else ""),
            "switch it on, and name the topic on which it tells its joints by --joint-states",
        ),
        "name": ("commands", f"ROS takes no name '{what}': {' '.join(found)}", "give another topic"),
    }
    other = "ros", f"the bridge to ROS ended: {what}", "look whether ROS works in its Python"
    key, message, way_out = told.get(answer.get("reason", ""), other)
    return SendError(message, key=key, way_out=way_out)
