"""A robot in ROS 1 on loopback: a master, and an action server each arm (`ros1_server.py`) in a process of its own.

The tests of sending and `benchmarks/ros.py` use it.
"""

from __future__ import annotations

import json
import os
import queue
import shutil
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PYTHON = "/usr/bin/python3"
SERVER = Path(__file__).with_name("ros1_server.py")
INSTALL = "apt-get install python3-rospy python3-actionlib python3-roslaunch"
STARTING = 15.0  # s, that a master may need


def has_ros() -> bool:
    """Whether ROS 1 is installed here."""
    modules = "import rospy, actionlib, trajectory_msgs.msg, sensor_msgs.msg, rosmaster"
    if shutil.which("roscore") is None or not Path(PYTHON).exists():
        return False
    return not subprocess.run([PYTHON, "-c", modules], capture_output=True).returncode


class Process:
    """A process whose lines are events; a context that ends it."""

    def __init__(self, arguments: Sequence[str], environment: Mapping[str, str]):
        self.process = subprocess.Popen(
            arguments, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        self.events: queue.Queue[dict[str, Any]] = queue.Queue()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        for line in self.process.stdout:
            if line.startswith("{"):
                self.events.put(json.loads(line))

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
    """Run a master on a free port of loopback; lends the environment that leads there."""
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


def arm_server(
    arm: str,
    position: Mapping[str, float],
    environment: Mapping[str, str],
    *,
    fault: str | None = None,
    states: bool = True,
) -> Process:
    """Start the action server of an arm whose joints are at `position` [rad]; it is there at its event "ready"."""
    settings = {"arm": arm, "position": dict(position), "fault": fault, "states": states}
    return Process([PYTHON, str(SERVER), json.dumps(settings)], {**os.environ, **environment})
