"""What there is in ROS 2: controllers, how soon they answer, and what the joint states say."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from comove.errors import SendError
from comove.ros.bridges import Bridge, Event
from comove.ros.clients import ROS2, pythons, ros_missing


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
    topic = joint_states or ROS2.names.joint_states
    tried = list[str]()
    for candidate in [python] if python else pythons():
        try:
            bridge = Bridge(candidate, ROS2.program)
        except OSError as error:
            tried.append(f"{candidate} ({error.strerror})")
            continue
        try:
            bridge.tell({"do": "look", "joint_states": topic, "timeout": seconds})
            events = _until_seen(bridge, 15.0 + 4.0 * seconds)
        finally:
            bridge.close()
        last = events[-1] if events else {"event": "refused", "what": "it did not answer"}
        if last["event"] == "seen":
            return _found(last, events)
        if last.get("reason") == "name":
            raise SendError(
                f"ROS takes no name '{topic}': {last['found'][0]}",
                key="joint_states",
                way_out="give another one",
            )
        tried.append(f"{candidate} ({last.get('what', 'it ended')})")
    raise ros_missing((2,), tried)


def _until_seen(bridge: Bridge, timeout: float) -> list[Event]:
    until, events = time.monotonic() + timeout, list[Event]()
    while (left := until - time.monotonic()) > 0.0:
        for event in bridge.news(left):
            events.append(event)
            if event["event"] in ("seen", "refused", "ended"):
                return events
    return events


def _found(seen: Event, events: Sequence[Event]) -> RosFound:
    conflicts = [event["joint"] for event in events if event["event"] == "conflict"]
    ages = np.array(seen["age"] or [np.nan])
    return RosFound(
        seen["distribution"],
        seen["rmw"],
        seen["domain"],
        seen["python"],
        tuple(RosServer(**server) for server in seen["servers"]),
        tuple(seen["nodes"]),
        tuple(seen["joints"]),
        conflicts[0] if conflicts else "",
        seen["rate"],
        (float(np.median(ages)), float(ages[np.abs(ages).argmax()])),
    )
