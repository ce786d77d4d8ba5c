"""Robots in ROS on loopback, an action server each arm in a process of its own (`ros1_server.py`, `ros2_server.py`).

The tests of sending and `benchmarks/ros.py` use them. ROS 1 is installed by apt, ROS 2 by ``make ros2``: its wheels
for each distribution, in an environment of its own.
"""

from __future__ import annotations

import json
import os
import queue
import random
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from comove.robots import Robot
from comove.ros.clients import MIDDLEWARES, RosClient
from comove.ros.streams import StreamNames

HERE = Path(__file__).parent
VENVS = Path(os.environ.get("COMOVE_TEST_ROS2", HERE.parents[1] / ".venv-ros2"))
DOMAINS = 42100  # first of the ports that stand for domains of ROS 2
STARTING = 15.0  # s, that a master may need


@dataclass(frozen=True)
class Host:
    """A network namespace of its own, wired to this one: a computer beside this one for what ROS sees.

    Attributes
    ----------
    name : name of the namespace, and of the wire's end here
    domain : environment in which nodes of ROS 2 on both find each other
    """

    name: str
    domain: dict[str, str]

    @property
    def prefix(self) -> list[str]:
        """The beginning of a command that runs there."""
        return ["ip", "netns", "exec", self.name]

    def cut(self) -> None:
        """Pull the wire."""
        _ip("link", "set", self.name, "down")


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)


class Process:
    """A process, on this host or another, whose lines are events; a context that ends it."""

    def __init__(self, arguments: Sequence[str], environment: Mapping[str, str], host: Host | None = None):
        self.host = host
        self.process = subprocess.Popen(
            [*(host.prefix if host else ()), *arguments],
            env={**os.environ, **environment},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        self.events: queue.Queue[dict[str, Any]] = queue.Queue()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        for line in self.process.stdout:
            if line.startswith("{"):
                self.events.put(json.loads(line))

    def tell(self, **order: Any) -> None:
        """Write a line that it reads."""
        self.process.stdin.write(json.dumps(order) + "\n")
        self.process.stdin.flush()

    def wait_for(self, name: str, timeout: float = 10.0) -> dict[str, Any]:
        """The next event of a name; `queue.Empty` where it does not come within `timeout` [s]."""
        until = time.monotonic() + timeout
        while True:
            event = self.events.get(timeout=max(0.01, until - time.monotonic()))
            if event["event"] == name:
                return event

    def __enter__(self) -> Process:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.send_signal(signal.SIGCONT)
        self.process.kill()
        self.process.wait()


@contextmanager
def ros_master() -> Iterator[dict[str, str]]:
    """Run a master of ROS 1 on a free port of loopback; lends the environment that leads there."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    environment = {
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}",
        "ROS_IP": "127.0.0.1",
        "ROS_LOG_DIR": "/tmp/roslog",
    }
    process = subprocess.Popen(
        ["roscore", "-p", str(port)],
        env={**os.environ, **environment},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        until = time.monotonic() + STARTING
        while time.monotonic() < until:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.05)
        yield environment
    finally:
        process.send_signal(signal.SIGINT)  # as Ctrl-C: it ends what it has started
        process.wait(STARTING)


PROFILE = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com"><transport_descriptors><transport_descriptor>
<transport_id>own</transport_id><type>UDPv4</type>{interfaces}
</transport_descriptor></transport_descriptors>
<participant profile_name="own" is_default_profile="true"><rtps>
<userTransports><transport_id>own</transport_id></userTransports><useBuiltinTransports>false</useBuiltinTransports>
{discovery}</rtps></participant></profiles>
"""
LOOPBACK = "<interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>"
SOONER = """<builtin><discovery_config>
<leaseDuration><sec>2</sec></leaseDuration><leaseAnnouncement><sec>0</sec><nanosec>250000000</nanosec></leaseAnnouncement>
<initialAnnouncements><count>10</count><period><sec>0</sec><nanosec>50000000</nanosec></period></initialAnnouncements>
</discovery_config></builtin>
"""


@contextmanager
def dds_domain(*, quick: bool = True) -> Iterator[dict[str, str]]:
    """Lend the environment of a domain of ROS 2 on loopback. A `quick` one finds nodes, and their ends, sooner."""
    with _domain() as number, _environment(number, LOOPBACK, quick=quick) as environment:
        yield environment


@contextmanager
def _domain() -> Iterator[int]:
    """Lend the number of a domain. A port keeps others from it."""
    with socket.socket() as held:
        while True:
            domain = random.SystemRandom().randrange(1, 100)
            with suppress(OSError):
                held.bind(("127.0.0.1", DOMAINS + domain))
                break
        yield domain


@contextmanager
def _environment(domain: int, interfaces: str, *, quick: bool) -> Iterator[dict[str, str]]:
    """Lend the environment of a domain on some interfaces, all where none are named, over UDP alone.

    Killed nodes would leave files of shared memory, in which others hang. Only a profile excludes it: where a node is
    to find this host alone (`LOCALHOST`), ROS takes shared memory whatever Fast DDS was told.
    """
    with tempfile.NamedTemporaryFile("w", suffix=".xml") as file:
        file.write(PROFILE.format(interfaces=interfaces, discovery=SOONER if quick else ""))
        file.flush()
        profiles = {f"{name}_DEFAULT_PROFILES_FILE": file.name for name in ("FASTDDS", "FASTRTPS")}
        yield {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT", **profiles}


@cache
def may_have_hosts() -> bool:
    """Whether this host may have a second one beside it."""
    try:
        with second_host():
            return True
    except (OSError, subprocess.CalledProcessError):
        return False


@contextmanager
def second_host() -> Iterator[Host]:
    """Lend a second host. `CalledProcessError` or `OSError` where this one may have none."""
    with _domain() as number:  # nobody else has it
        here, there, name = f"10.77.{number}.1", f"10.77.{number}.2", f"comove{number}"
        inside = ("-n", name)
        _ip("netns", "add", name)
        try:
            _ip("link", "add", name, "type", "veth", "peer", "name", "wire", "netns", name)
            _ip("addr", "add", f"{here}/24", "dev", name)
            _ip(*inside, "addr", "add", f"{there}/24", "dev", "wire")
            for words in (("set", "lo"), ("set", "wire")):
                _ip(*inside, "link", *words, "up")
            _ip("link", "set", name, "up")
            with _environment(number, "", quick=False) as environment:
                yield Host(name, environment)
        finally:
            _ip("netns", "del", name)  # the wire goes with it


@dataclass(frozen=True)
class Ros:
    """A version of ROS that may be installed here.

    Attributes
    ----------
    name, version : name for people, and 1 or 2
    python : its Python
    modules : modules that the servers load
    network : context of the environment in which nodes find each other
    install : command that installs it
    """

    name: str
    version: int
    python: str
    modules: str
    network: Callable[[], AbstractContextManager[dict[str, str]]]
    install: str

    @cached_property
    def is_there(self) -> bool:
        """Whether it is installed here."""
        if not Path(self.python).exists() or (self.version == 1 and shutil.which("roscore") is None):
            return False
        return not subprocess.run(
            [self.python, "-c", f"import {self.modules}"], capture_output=True
        ).returncode

    def action(self, arm: str) -> str:
        """Return the usual name of an arm's action."""
        return MIDDLEWARES[self.version].names.action.format(arm=arm)

    def client(self, **settings: Any) -> RosClient:
        """Return a client for it."""
        return RosClient((self.version,), python=self.python, **settings)

    def sink(
        self,
        robot: Robot,
        position: Sequence[float],
        obstacles: Mapping[str, Any] | None = None,
        host: Host | None = None,
        *,
        reverse: bool = False,
    ) -> Process:
        """Start a robot that is where its streamed commands say; it is there at its event "ready".

        Its controllers may have their joints in the reverse order.
        """
        step = -1 if reverse else 1
        arms = {arm.name: [robot.joint_names[column] for column in arm.columns][::step] for arm in robot.arms}
        settings = {
            "topics": StreamNames.of(robot).topics(arms),
            "position": dict(zip(robot.joint_names, np.asarray(position).tolist(), strict=True)),
            "obstacles": obstacles,
        }
        return Process([self.python, str(HERE / "ros2_sink.py"), json.dumps(settings)], {}, host)

    def server(
        self,
        arm: str,
        position: Mapping[str, float],
        environment: Mapping[str, str],
        *,
        fault: str | None = None,
        states: bool = True,
        action: str | None = None,
        gripper: str | None = None,
        host: Host | None = None,
    ) -> Process:
        """Start the server of an arm whose joints are at `position` [rad], on this host unless another is given.

        It is there at its event "ready".
        """
        settings = {"arm": arm, "position": dict(position), "action": action or self.action(arm)}
        settings |= {"fault": fault, "states": states, "gripper": gripper}
        program = HERE / f"ros{self.version}_server.py"
        return Process([self.python, str(program), json.dumps(settings)], environment, host)


NOETIC = Ros(
    "noetic",
    1,
    "/usr/bin/python3",
    "rospy, actionlib, trajectory_msgs.msg, sensor_msgs.msg, rosmaster",
    ros_master,
    "apt-get install python3-rospy python3-actionlib python3-roslaunch",
)
JAZZY, KILTED = (
    Ros(
        name,
        2,
        str(VENVS / name / "bin" / "python"),
        "rclpy, control_msgs.action, moveit_msgs.action, sensor_msgs.msg",
        dds_domain,
        "make ros2",
    )
    for name in ("jazzy", "kilted")
)
