"""What there is in ROS 2: controllers, how soon they answer, and what the joint states say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from comove.errors import SendError, listed
from comove.ros.bridges import Event
from comove.ros.clients import ROS2, started

STARTING = 15.0  # s, for a Python to load ROS


@dataclass(frozen=True)
class RosServer:
    """An action server of FollowJointTrajectory.

    Attributes
    ----------
    action : its name
    answer : time within which it answered [s]; None if it did not
    busy : whether it has a goal
    """

    action: str
    answer: float | None
    busy: bool


@dataclass(frozen=True)
class RosFound:
    """What was found in ROS 2.

    Attributes
    ----------
    distribution, middleware, domain, python : of the environment in which it was looked for
    servers : controllers
    topic : topic of the joint states
    nodes : nodes that report joint states
    joints : names of the reported joints
    conflict : a joint that several nodes report; empty if there is none
    rate : messages with joints a second [Hz]
    age : median and largest age of the joints when they arrived [s]; negative if the robot's clock is ahead; NaN
        without joints
    """

    distribution: str
    middleware: str
    domain: str
    python: str
    servers: tuple[RosServer, ...]
    topic: str
    nodes: tuple[str, ...]
    joints: tuple[str, ...]
    conflict: str
    rate: float
    age: tuple[float, float]


def look(joint_states: str | None = None, *, seconds: float = 3.0, python: str | None = None) -> RosFound:
    """Look at ROS 2 without moving anything.

    Parameters
    ----------
    joint_states : topic of the joint states; /joint_states unless given
    seconds : time for nodes to find each other [s]
    python : path of a Python with ROS 2; searched for unless given

    Raises
    ------
    SendError
        If there is no ROS 2 here, or it takes no such topic.
    """
    topic = joint_states or ROS2.names.joint_states or ""
    command = {"do": "look", "joint_states": topic, "timeout": seconds}
    process, answer, others = started(ROS2.program, command, "seen", STARTING + 4.0 * seconds, python)
    process.close()
    if answer["event"] == "seen":
        return _found(answer, others, topic)
    raise SendError(
        f"ROS cannot look at the topic '{topic}': {listed(answer.get('found') or [answer['what']])}",
        key="joint_states",
        way_out="give the name of a topic",
    )


def _found(seen: Event, events: Sequence[Event], topic: str) -> RosFound:
    conflicts = [event["joint"] for event in events if event["event"] == "conflict"]
    ages = np.array(seen["age"] or [np.nan])
    return RosFound(
        seen["distribution"],
        seen["rmw"],
        seen["domain"],
        seen["python"],
        tuple(RosServer(**server) for server in seen["servers"]),
        topic,
        tuple(seen["nodes"]),
        tuple(seen["joints"]),
        conflicts[0] if conflicts else "",
        seen["rate"],
        (float(np.median(ages)), float(ages[np.abs(ages).argmax()])),
    )
