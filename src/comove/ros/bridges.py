"""Processes that connect to ROS.

ROS brings its own Python, so a program that runs in that communicates with this one: `ros1_bridge.py` or
`ros2_bridge.py`. It reads commands and writes events, one JSON object a line.

Commands:

    {"do": "connect", "servers": [ACTION], "joint_states": TOPIC, "joints": [NAME], "timeout": s, "sim_time": bool,
        "grippers": {ARM: {"kind": TYPE, "action": ACTION, "joint": NAME}}}
    {"do": "send", "delay": s, "goals": {ACTION: {"id": NUMBER, "joints": [NAME], "time": [ns],
        "position": [[rad]], "velocity": ..., "acceleration": ...,
        "path": [rad], "end": [rad], "late": s}}}         the controller's tolerances; 0 rad: what it has by itself
    {"do": "grip", "goals": {ARM: {"position": rad or m, "effort": N, "seconds": s, "closed": bool}}}
    {"do": "guard", "ids": {ACTION: NUMBER}}             goals of another bridge, to be cancelled at the end
    {"do": "cancel"}
    {"do": "beat"}      (ROS 2) a sign of life, without which goals are cancelled after a second
    {"do": "look", "joint_states": TOPIC, "timeout": s}   (ROS 2) what there is, without a motion

Events:

    {"event": "refused", "reason": REASON, "what": TEXT, "found": [NAME]}
    {"event": "connected"}, {"event": "sent"}, {"event": "cancelled"}
    {"event": "joints", "time": s since the common start, "age": s, "position": {NAME: rad}}
    {"event": "goal", "server": ACTION, "status": STATUS, "text": TEXT, "time": s since the common start}
    {"event": "gripper", "arm": ARM, "status": STATUS, "text": TEXT, "time": s since the common start}
    {"event": "unstopped", "servers": [ACTION]}    that have not confirmed for seconds that they end their goals
    {"event": "busy", "server": ACTION, "busy": bool}     whether another client has a goal there
    {"event": "seen", "distribution": NAME, "rmw": NAME, "domain": ID, "python": VERSION, "nodes": [NODE],
        "servers": [{"action": ACTION, "answer": s or null, "busy": bool}], "joints": [NAME], "rate": Hz, "age": [s]}
    {"event": "conflict", "joint": NAME, "nodes": [NODE]}  of two nodes that tell the same joint

When its input ends for any reason, a bridge cancels all its goals: an arm must not go on alone.
"""

from __future__ import annotations

import json
import os
import queue
import subprocess
import tempfile
import threading
import time
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

WHEELS = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
"""Set by wheels of ROS 2 in their Python; another Python of theirs that inherits it would not find its libraries."""

CLOSING = 8.0
"""Time for a bridge to end, in which it asks again for the end of goals that no server has confirmed [s]."""

Event = Mapping[str, Any]


class BridgeProcess:
    """A bridge in a process of its own. Nothing here waits for it: it may hang.

    Parameters
    ----------
    python, program : path of a Python with ROS, and of the bridge

    Attributes
    ----------
    threads : threads that read and write

    Raises
    ------
    OSError
        If it cannot be started.
    """

    def __init__(self, python: str, program: Path):
        self._commands: queue.SimpleQueue[Mapping[str, Any] | None] = queue.SimpleQueue()
        self._told = threading.Condition()
        self._events, self._joints = deque[Event](), dict[tuple[str, ...], Event]()
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115
        try:
            self._process = subprocess.Popen(
                [python, str(program)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                text=True,
                env={name: value for name, value in os.environ.items() if name != WHEELS},
                start_new_session=True,  # an interruption from the keyboard is told to it by this process
            )
        except OSError:
            self._errors.close()
            raise
        self.threads = [threading.Thread(target=work, daemon=True) for work in (self._listen, self._write)]
        for thread in self.threads:
            thread.start()

    def tell(self, command: Mapping[str, Any]) -> None:
        """Send a command."""
        self._commands.put(command)

    def news(self, wait: float) -> list[Event]:
        """Return the events since the last call. It waits `wait` [s] at most.

        Of the joints only the newest are among them, however long nobody asked.
        """
        with self._told:
            if not self._events and not self._joints:
                self._told.wait(max(wait, 0.0))
            found = [*self._joints.values(), *self._events]
            self._joints.clear()
            self._events.clear()
        return found

    @property
    def has_ended(self) -> bool:
        """Whether the process has ended."""
        return self._process.poll() is not None

    def kill(self) -> None:
        """End the process at once."""
        self._process.kill()

    def last_words(self) -> str:
        """Return the last line of the error stream."""
        self._errors.seek(0)
        lines = self._errors.read()[-4000:].decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else "without a word"

    def end_input(self) -> None:
        """End the input of the process, which then ends itself."""
        self._commands.put(None)

    def close(self) -> None:
        """End the process, which cancels its goals first."""
        self.end_input()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(CLOSING)
        self._process.kill()
        self._process.wait()
        self._errors.close()

    def _write(self) -> None:
        """Write commands to the process, and at last end its input."""
        stream = self._process.stdin
        with suppress(OSError, ValueError):  # it has ended; what listens says so
            while stream is not None and (command := self._commands.get()) is not None:
                stream.write(json.dumps(command) + "\n")
                stream.flush()
        with suppress(OSError, ValueError):
            if stream is not None:
                stream.close()

    def _listen(self) -> None:
        """Note what the process says."""
        stream = self._process.stdout
        with suppress(OSError, ValueError):  # cut off
            for line in stream or ():
                self._note(json.loads(line))
        self._note({"event": "ended"})
        with suppress(OSError):
            if stream is not None:
                stream.close()

    def _note(self, event: Event) -> None:
        with self._told:
            if event["event"] == "joints":
                self._joints[tuple(event["position"])] = event
            else:
                self._events.append(event)
            self._told.notify()


def awaited(
    bridge: BridgeProcess, kinds: tuple[str, ...], timeout: float, others: list[Event]
) -> Event | None:
    """Return the first event of some kinds, or the end.

    It is None if none comes within `timeout` [s].

    Parameters
    ----------
    others : list to which the events before it are appended, and those after it that are there
    """
    until, found = time.monotonic() + timeout, None
    while found is None and (left := until - time.monotonic()) > 0:
        for event in bridge.news(left):
            if found is None and event["event"] in (*kinds, "ended"):
                found = event
            else:
                others.append(event)
    return found
