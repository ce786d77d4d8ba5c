"""Processes that connect to ROS.

ROS brings its own Python, so a program that runs in that communicates with this one: `ros1_bridge.py` or
`ros2_bridge.py`. It reads commands and writes events, one JSON object a line.

Commands:

    {"do": "connect", "servers": [ACTION], "joint_states": TOPIC, "joints": [NAME], "timeout": s, "sim_time": bool,
        "grippers": {ARM: {"kind": TYPE, "action": ACTION, "joint": NAME}}}
    {"do": "send", "delay": s, "goals": {ACTION: {"id": NUMBER, "joints": [NAME], "time": [ns],
        "position": [[rad]], "velocity": ..., "acceleration": ...,
        "path": rad, "end": rad, "late": s}}}             the controller's tolerances; 0 rad: what it has by itself
    {"do": "grip", "goals": {ARM: {"position": rad or m, "effort": N, "seconds": s}}}
    {"do": "guard", "ids": {ACTION: NUMBER}}             goals of another bridge, to be cancelled at the end
    {"do": "cancel"}
    {"do": "look", "joint_states": TOPIC, "timeout": s}   (ROS 2) what there is, without a motion

Events:

    {"event": "refused", "reason": REASON, "what": TEXT, "found": [NAME]}
    {"event": "connected"}, {"event": "sent"}, {"event": "cancelled"}
    {"event": "joints", "time": s since the common start, "age": s, "position": {NAME: rad}, "now": s (ROS 2)}
    {"event": "goal", "server": ACTION, "status": STATUS, "text": TEXT, "time": s since the common start}
    {"event": "gripper", "arm": ARM, "status": STATUS, "text": TEXT, "time": s since the common start}
    {"event": "busy", "server": ACTION, "busy": bool}     whether another client has a goal there
    {"event": "seen", "distribution": NAME, "rmw": NAME, "domain": ID, "python": VERSION, "nodes": [NODE],
        "servers": [{"action": ACTION, "answer": s or null, "busy": bool}]}
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
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

WHEELS = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
"""Set by wheels of ROS 2 in their Python; another Python of theirs that inherits it would not find its libraries."""

Event = Mapping[str, Any]


class Bridge:
    """A bridge in a process of its own.

    Parameters
    ----------
    python, program : path of a Python with ROS, and of the bridge

    Raises
    ------
    OSError
        If it cannot be started.
    """

    def __init__(self, python: str, program: Path):
        self._events: queue.Queue[Event] = queue.Queue()
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
        threading.Thread(target=_listen, args=(self._process.stdout, self._events), daemon=True).start()

    def tell(self, command: Mapping[str, Any]) -> None:
        """Send a command."""
        stream = self._process.stdin
        with suppress(OSError, ValueError):  # it has ended; what listens says so
            if stream is not None:
                stream.write(json.dumps(command) + "\n")
                stream.flush()

    def news(self, wait: float) -> Iterator[Event]:
        """Yield the events that are there. The first is awaited for `wait` [s]."""
        with suppress(queue.Empty):
            yield self._events.get(timeout=max(wait, 0.0))
            while True:
                yield self._events.get_nowait()

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

    def close(self) -> None:
        """End the process, which cancels its goals first."""
        with suppress(OSError, subprocess.TimeoutExpired):
            if self._process.stdin is not None:
                self._process.stdin.close()
            self._process.wait(3.0)
        self._process.kill()
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._errors.close()


def _listen(stream: IO[str], events: queue.Queue[Event]) -> None:
    with suppress(ValueError):  # closed, or cut off
        for line in stream:
            events.put(json.loads(line))
    events.put({"event": "ended"})


def awaited(bridge: Bridge, kinds: tuple[str, ...], timeout: float, others: list[Event]) -> Event | None:
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
