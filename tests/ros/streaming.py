"""Runs by `comove run --ros 2` against a robot that is where its commands say, and what becomes of them.

The tests of streams and `benchmarks/streams.py` use them.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import yaml

from comove.robots import VerifiedJointMotion
from comove.robots.files import verified_against
from tests.robots.small_robots import EXAMPLES
from tests.ros.robots import Process, Ros, second_host

MOVED = 0.02  # rad, by which a joint has moved when something fails
STEP = 1e-9  # rad, from which on two commands differ
CUT = "network cut"
REST = 3.0  # s, in which arms must have come to rest for good
OBSTACLES = "/seen"
FAR = {
    "topic": OBSTACLES,
    "kind": "geometry_msgs/msg/PoseArray",
    "frame": "world",
    "names": ["cart"],
    "centers": [[0.7, 3.0, 0.3]],
}
"""A robot's obstacle that is far away; the scene has it as `cart`."""
FAR_CLOUD = {**FAR, "kind": "sensor_msgs/msg/PointCloud2", "radius": 0.1}
"""The same as a camera sees it."""


@dataclass(frozen=True)
class Rest:
    """How arms came to rest after a fault: times until the last command that moved each arm [s], how far apart these
    are, by how much the hands changed their distance [m], and whether an arm moved later."""

    after: float
    apart: float
    torn: float
    moved_on: bool


@contextmanager
def running(
    ros: Ros, scene: Path, plan: Path, out: Path, options: Sequence[str] = ()
) -> Iterator[subprocess.Popen]:
    """A run of comove as a process."""
    words = [
        "run",
        str(scene),
        "--ros",
        "2",
        "--plan",
        str(plan),
        "--out",
        str(out),
        "--no-pictures",
        "--no-film",
    ]
    process = subprocess.Popen(
        [sys.executable, "-m", "comove", *words, *options],
        env={**os.environ, "COMOVE_ROS_PYTHON": ros.python},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
    finally:
        bridges = bridges_of(process, "ros2_")
        process.send_signal(signal.SIGCONT)
        process.kill()
        process.wait()
        for bridge in bridges:  # a stopped one would stay
            with suppress(ProcessLookupError):
                os.kill(bridge, signal.SIGKILL)


@contextmanager
def standing(
    ros: Ros,
    plan: VerifiedJointMotion,
    fault: str = "",
    around: Mapping[str, Any] | None = None,
    *,
    reverse: bool = False,
) -> Iterator[Process]:
    """A robot at the beginning of a plan, on a host of its own where the network will be cut.

    Its controllers may have their joints in the reverse order.
    """
    around = around or (FAR_CLOUD if fault.startswith("clouds") else FAR)
    with (
        second_host() if fault == CUT else nullcontext() as host,
        patch.dict(os.environ, host.domain if host else {}),
        ros.sink(plan.robot, plan.joints.position[0], around, host, reverse=reverse) as sink,
    ):
        sink.wait_for("ready")
        yield sink


def bridges_of(process: subprocess.Popen, program: str = "ros2_stream") -> list[int]:
    """The numbers of the processes of a run that execute a program."""
    found = subprocess.run(["pgrep", "-P", str(process.pid), "-f", program], capture_output=True, text=True)
    return [int(number) for number in found.stdout.split()]


def rows_of(sink: Process) -> dict[str, np.ndarray]:
    """Commands by the first joint of each arm: rows of an instant [s] and the joints."""
    sink.tell(tell=True)
    rows = sink.wait_for("rows")["rows"]
    arms = dict.fromkeys(row[1] for row in rows)
    return {arm: np.array([[row[0], *row[2:]] for row in rows if row[1] == arm]) for arm in arms}


def wait_until_it_moves(
    sink: Process, process: subprocess.Popen, far: float = MOVED, within: float = 60.0
) -> None:
    """Wait until commands have moved a joint."""
    until = time.monotonic() + within
    while time.monotonic() < until and process.poll() is None:
        rows = rows_of(sink)
        if len(rows) == 2 and all(np.abs(r[-1, 1:] - r[0, 1:]).max() > far for r in rows.values()):
            return
        time.sleep(0.05)
    raise AssertionError(
        f"it does not move: {process.stdout.read() if process.poll() is not None else 'yet'}"
    )


def rest_after(sink: Process, plan: VerifiedJointMotion, at: float, until: float) -> Rest:
    """How the arms came to rest after an instant. They may move again after `until`."""
    rows, robot = rows_of(sink), plan.robot
    ends, later = [], False
    for r in rows.values():
        moves = r[1:, 0][np.abs(np.diff(r[:, 1:], axis=0)).max(axis=1) > STEP]
        during = moves[(moves > at) & (moves < until)]
        first = at if not len(during) else during[np.append(np.diff(during) > 0.2, True)][0]
        ends.append(first - at)
        later = later or bool((during > first).any())
    first = dict(zip([a[0] for a in _joints(robot)], range(2), strict=True))
    count = min(len(r) for r in rows.values())
    q = np.zeros((count, len(robot.joint_names)))
    for arm, r in rows.items():
        q[:, robot.arms[first[arm]].columns] = r[-count:, 1:]
    tips = np.array([[robot.tool_pose(x, arm)[:3, 3] for arm in robot.arms] for x in q[::5]])
    apart = np.linalg.norm(tips[:, 0] - tips[:, 1], axis=1)
    return Rest(max(ends), max(ends) - min(ends), float(np.ptp(apart)), later)


def _joints(robot) -> list[list[str]]:
    return [[robot.joint_names[c] for c in arm.columns] for arm in robot.arms]


def silence(what: str, seconds: float) -> Callable[[subprocess.Popen, Process], None]:
    return lambda process, sink: sink.tell(silent=what, **{"for": seconds})


FAULTS: dict[str, Callable[[subprocess.Popen, Process], None]] = {
    "comove killed": lambda process, sink: process.kill(),
    "comove stopped": lambda process, sink: process.send_signal(signal.SIGSTOP),
    "bridge killed": lambda process, sink: os.kill(bridges_of(process)[0], signal.SIGKILL),
    "bridge stopped": lambda process, sink: os.kill(bridges_of(process)[0], signal.SIGSTOP),
    "clouds killed": lambda process, sink: os.kill(bridges_of(process, "ros2_clouds")[0], signal.SIGKILL),
    "clouds stopped": lambda process, sink: os.kill(bridges_of(process, "ros2_clouds")[0], signal.SIGSTOP),
    "joints silent": silence("joints", 60.0),
    "obstacles silent": silence("obstacles", 60.0),
    CUT: lambda process, sink: sink.host.cut(),
    "Ctrl-C": lambda process, sink: process.send_signal(signal.SIGINT),
}
"""What may fail while arms move, and how."""


def planned(folder: Path, duration: float = 6.0) -> tuple[Path, Path, VerifiedJointMotion]:
    """A scene of two UR10 with a far cart in a folder, its result, and its motion."""
    data = yaml.safe_load((EXAMPLES / "robots" / "two_ur10.yaml").read_text(encoding="utf-8"))
    (center,) = FAR["centers"]
    cart = {"name": "cart", "shape": "sphere", "center": center, "radius": 0.1}
    cart["motion"] = {"waypoints": [center, [0.7, 3.1, 0.3]], "times": [0.0, duration]}
    scene = folder / "scene.yaml"
    scene.write_text(yaml.safe_dump({**data, "duration": duration, "obstacles": [*data["obstacles"], cart]}))
    words = ["solve", str(scene), "--out", str(folder / "plan"), "--no-pictures", "--budget", "3"]
    subprocess.run([sys.executable, "-m", "comove", *words], check=True, capture_output=True)
    return scene, folder / "plan", verified_against(folder / "plan")[0]
