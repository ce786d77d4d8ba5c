"""Planning scenes of MoveIt 2 as they are now; `ros2_moveit.py` listens to them under ROS's own Python."""

from __future__ import annotations

import base64
import time
from pathlib import Path
from typing import Self

from comove.errors import SendError, listed
from comove.model.files.moveit_bags import SCENE, Encoded, write
from comove.ros.bridges import Event, awaited
from comove.ros.clients import started

PROGRAM = Path(__file__).with_name("ros2_moveit.py")
TOPIC, SERVICE = "/monitored_planning_scene", "/get_planning_scene"
STARTING = 20.0  # s, for a Python to load ROS and to join its graph
LISTEN = 5.0  # s, in which a planning scene is told


class LiveScene:
    """The planning scene that ROS 2 tells, as a context.

    Parameters
    ----------
    topic : topic of planning scenes
    service : service that tells the present one; it is asked where there is one
    python : path of a Python with ROS 2 and moveit_msgs; searched for unless given

    Attributes
    ----------
    process : program that listens
    messages : messages of the last whole planning scene, and of what changed it since

    Raises
    ------
    SendError
        If there is no ROS 2 with MoveIt's messages here, or it does not take a name.
    """

    def __init__(self, topic: str = TOPIC, service: str = SERVICE, *, python: str | None = None):
        self.topic, self.messages = topic, list[Encoded]()
        command = {"do": "watch", "topic": topic, "service": service}
        self.process, answer, others = started(PROGRAM, command, "watching", STARTING, python)
        self._moved = False
        if answer["event"] != "watching":
            self.process.close()
            raise refusal(answer)
        for event in others:
            self.note(event)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.close()

    def note(self, event: Event) -> bool:
        """Note a planning scene, and return whether it was one. Of joints alone the last ones are kept."""
        if event["event"] != "scene":
            return False
        if event["whole"]:
            self.messages.clear()
        elif self._moved and event["moved"]:
            self.messages.pop()
        self.messages.append((SCENE, base64.b64decode(event["data"])))
        self._moved = event["moved"]
        return True

    def wait(self, within: float = LISTEN) -> None:
        """Wait until a planning scene was told.

        Raises
        ------
        SendError
            If none was told `within` [s]; it names the topics that there are.
        """
        until = time.monotonic() + within
        while not self.messages and time.monotonic() < until and not self.process.has_ended:
            for event in self.process.news(until - time.monotonic()):
                self.note(event)
        if self.messages:
            return
        self.process.tell({"do": "topics"})
        answer = awaited(self.process, ("missing",), LISTEN, [])
        topics = answer["topics"] if answer is not None and answer["event"] == "missing" else []
        if self.topic in topics:
            raise SendError(
                f"nothing was told on {self.topic} within {within:g} s, and no service tells the planning scene",
                key="--topic",
                way_out="change something in the scene, or start move_group, which answers",
            )
        raise SendError(
            f"nobody tells planning scenes on {self.topic} (topics of them: {listed(topics) or 'none'})",
            key="--topic",
            way_out=f"give another one: --topic {topics[0]}"
            if topics
            else "start move_group, and look whether both have the same ROS_DOMAIN_ID",
        )


def record(file: Path, topic: str = TOPIC, *, within: float = LISTEN, python: str | None = None) -> None:
    """Write the present planning scene of ROS 2 to a bag.

    Raises
    ------
    SendError
        As `LiveScene`, and if no planning scene is told `within` [s].
    """
    with LiveScene(topic, python=python) as live:
        live.wait(within)
        write(file, live.messages)


def refusal(answer: Event) -> SendError:
    """Return the error for a program that cannot serve or listen."""
    if answer["reason"] == "name":
        return SendError(
            f"ROS takes no name '{answer['what']}': {' '.join(answer['found'])}",
            key="--topic",
            way_out="give another name",
        )
    return SendError(
        f"the program in ROS ended: {answer['what']}",
        key="ros",
        way_out="look whether ROS 2 works in its Python",
    )
