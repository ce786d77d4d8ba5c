"""Client for a ROS 1 robot with one FollowJointTrajectory server per arm. ROS brings its own Python, so a separate
program, `ros1_bridge.py`, communicates with it. It stops all arms when this process ends."""

from __future__ import annotations

import json
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

from comove.errors import SendError
from comove.ros.parts import JointSamples
from comove.ros.send import ArmState, RobotState, Status

BRIDGE = Path(__file__).with_name("ros1_bridge.py")
PYTHON = "COMOVE_ROS_PYTHON"


@dataclass(frozen=True)
class Names:
    """Names of action servers and of the joint-state topic; by default Baxter's."""

    action: str = "robot/limb/{arm}/follow_joint_trajectory"
    joint_states: str = "/robot/joint_states"


class Ros1Client:
    """`TrajectoryClient` for ROS 1, to be closed or used as context.

    Parameters
    ----------
    names : names of the robot's action servers and topic
    python : path of a Python with rospy; searched for unless given (`COMOVE_ROS_PYTHON`, /usr/bin/python3, ...)
    answer : time within which a bridge must confirm a cancellation [s]
    starting : time for a Python to load ROS, in addition to the time allowed for the robot [s]
    """

    def __init__(
        self,
        names: Names = Names(),
        python: str | None = None,
        *,
        answer: float = 0.5,
        starting: float = 15.0,
    ):
        self._names, self._python = names, python
        self._within, self._starting = answer, starting
        self._process: subprocess.Popen[str] | None = None
        self._again: tuple[str, dict[str, Any]] | None = None
        self._errors: IO[bytes] | None = None
        self._events: queue.Queue[dict[str, Any]] = queue.Queue()
        self._state, self._heard = RobotState(), dict[str, float]()

    def __enter__(self) -> Ros1Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def connect(self, arms: Mapping[str, tuple[str, ...]], timeout: float) -> None:
        """Find the action server of each arm; see `TrajectoryClient`."""
        joints = [name for names in arms.values() for name in names]
        command = {
            "do": "connect",
            "servers": {arm: self._names.action.format(arm=arm) for arm in arms},
            "joint_states": self._names.joint_states,
            "joints": joints,
            "timeout": timeout,
        }
        tried = []
        for python in [self._python] if self._python else pythons():
            self.close()
            answer = self._begin(python, command)
            if answer["event"] == "connected":
                self._again = python, command
                self._state = RobotState(arms={arm: ArmState() for arm in arms})
                self._heard = dict.fromkeys(joints, -float("inf"))
                return
            if answer["reason"] != "ros":
                raise _refusal(answer["reason"], answer["what"], timeout)
            tried.append(f"{python} ({answer['what']})")
        raise SendError(
            f"no Python here has ROS 1; tried {', '.join(tried) or 'none'}",
            key="ros",
            way_out=f"install rospy, actionlib and trajectory_msgs, and name their Python in {PYTHON}",
        )

    def send(self, goals: Mapping[str, JointSamples], delay: float) -> None:
        """Send all goals with one stamp; see `TrajectoryClient`."""
        told = {
            arm: {
                "joints": goal.joint_names,
                "time": goal.nanoseconds.tolist(),
                "position": goal.position.tolist(),
                "velocity": goal.velocity.tolist(),
                "acceleration": goal.acceleration.tolist(),
            }
            for arm, goal in goals.items()
        }
        arms = {arm: ArmState(Status.PENDING) for arm in goals}
        self._state = replace(self._state, arms=arms, time=None)
        self._tell({"do": "send", "delay": delay, "goals": told})

    def cancel(self) -> None:
        """Stop all arms."""
        if self._process is not None and self._process.poll() is None:
            self._tell({"do": "cancel"})
            if self._has_cancelled():
                return
            self._process.kill()
        if self._again is not None:  # the bridge is gone, and the arms may move: another one stops them
            (python, command), self._again = self._again, None
            self.close()
            if self._begin(python, command)["event"] == "connected":
                self._tell({"do": "cancel_all"})

    def _has_cancelled(self) -> bool:
        """Return whether the bridge confirms the cancellation. It may hang, or end meanwhile."""
        event = self._awaited(("cancelled",), self._within)
        if event is None:
            self._lose("did not answer")
            return False
        self._take(event)
        return event["event"] == "cancelled"

    def state(self, wait: float) -> RobotState:
        """Return the known state, after waiting at most `wait` [s]."""
        for event in self._news(wait):
            self._take(event)
        return replace(
            self._state, silence=time.monotonic() - min(self._heard.values(), default=-float("inf"))
        )

    def close(self) -> None:
        """End the bridge, which stops all arms that still move."""
        process, self._process = self._process, None
        if process is not None:
            assert process.stdin is not None and process.stdout is not None
            try:
                process.stdin.close()
                process.wait(3.0)
            except (OSError, subprocess.TimeoutExpired):
                process.kill()
                process.wait()
            process.stdout.close()
        if self._errors is not None:
            self._errors.close()
            self._errors = None

    def _begin(self, python: str, command: dict[str, Any]) -> dict[str, Any]:
        """Start a bridge and connect it; return its answer."""
        self._events = queue.Queue()
        try:
            self._errors = tempfile.TemporaryFile()  # noqa: SIM115
            self._process = subprocess.Popen(
                [python, str(BRIDGE)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                text=True,
                start_new_session=True,  # an interruption from the keyboard is told to it by this process
            )
        except OSError as error:
            return {"event": "refused", "reason": "ros", "what": error.strerror}
        listener = threading.Thread(target=_listen, args=(self._process.stdout, self._events), daemon=True)
        listener.start()
        self._tell(command)
        return self._answer(command["timeout"] + self._starting)

    def _tell(self, command: Mapping[str, Any]) -> None:
        stream = None if self._process is None else self._process.stdin
        if stream is not None:
            with suppress(OSError, ValueError):  # it has ended; what listens says so
                stream.write(json.dumps(command) + "\n")
                stream.flush()

    def _answer(self, timeout: float) -> dict[str, Any]:
        event = self._awaited(("connected", "refused"), timeout)
        if event is None or event["event"] == "ended":
            what = "it did not answer" if event is None else self._last_words()
            return {"event": "refused", "reason": "ended", "what": what}
        return event

    def _awaited(self, kinds: tuple[str, ...], timeout: float) -> dict[str, Any] | None:
        """Return the first event of some kinds or the end, or None."""
        until = time.monotonic() + timeout
        while (left := until - time.monotonic()) > 0:
            for event in self._news(left):
                if event["event"] in (*kinds, "ended"):
                    return event
                self._take(event)
        return None

    def _news(self, wait: float) -> Iterator[dict[str, Any]]:
        try:
            yield self._events.get(timeout=max(wait, 0.0))
            while True:
                yield self._events.get_nowait()
        except queue.Empty:
            return

    def _take(self, event: Mapping[str, Any]) -> None:
        """Update the state by an event."""
        state = self._state
        if event["event"] == "joints":
            self._heard |= dict.fromkeys(event["position"], time.monotonic())
            self._state = replace(
                state, position={**state.position, **event["position"]}, time=event["time"], age=event["age"]
            )
        elif event["event"] == "arm":
            arm = ArmState(Status[event["status"]], event["text"], event["time"])
            self._state = replace(state, arms={**state.arms, event["arm"]: arm})
        elif event["event"] in ("ended", "refused"):
            self._lose(f"ended: {self._last_words()}")

    def _lose(self, why: str) -> None:
        lost = ArmState(Status.LOST, f"the bridge to ROS {why}")
        self._state = replace(self._state, arms=dict.fromkeys(self._state.arms, lost))

    def _last_words(self) -> str:
        if self._errors is None:
            return "without a word"
        self._errors.seek(0)
        lines = self._errors.read()[-4000:].decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else "without a word"


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


def _listen(stream: IO[str], events: queue.Queue[dict[str, Any]]) -> None:
    try:
        for line in stream:
            events.put(json.loads(line))
    except ValueError:  # closed, or cut off
        pass
    events.put({"event": "ended"})


def _refusal(reason: str, what: str, timeout: float) -> SendError:
    """Return the error for a reason that ROS refused, with advice."""
    told = {
        "master": (
            "ROS_MASTER_URI",
            f"there is no ROS master at {what}",
            "start one by roscore, or set ROS_MASTER_URI to that of the robot",
        ),
        "server": (
            "action",
            f"no action server answers at '{what}' within {timeout:g} s",
            "start it (Baxter: rosrun baxter_interface joint_trajectory_action_server.py), or give its name",
        ),
        "clock": (
            "use_sim_time",
            f"ROS uses simulated time and nobody tells it on {what}",
            "start the simulation, or set use_sim_time to false",
        ),
    }
    other = "ros", f"the bridge to ROS ended: {what}", "look whether ROS works in its Python"
    key, message, way_out = told.get(reason, other)
    return SendError(message, key=key, way_out=way_out)
