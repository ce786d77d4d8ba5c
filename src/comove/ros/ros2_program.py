"""What the programs share that run under ROS 2's own Python: lines in and out, and a clean end."""

import json
import os
import queue
import signal
import sys
import threading
import traceback
from contextlib import suppress
from importlib import import_module

MOST = 10_000  # events that wait for comove to read them
NEEDED = ("rclpy", "sensor_msgs.msg", "trajectory_msgs.msg")


class Refused(Exception):
    """Error that keeps a program from going on. Its arguments are a reason, its subject, and what was found."""


class Teller:
    """Writer of events to the original output. Prints of ROS go to the error stream and cannot mix with them.

    A thread of its own writes: nothing else waits for somebody who does not read.
    """

    def __init__(self):
        self.file = os.fdopen(os.dup(1), "w")
        os.dup2(2, 1)
        self.lines = queue.Queue(MOST)
        self.thread = threading.Thread(target=self.write, daemon=True)
        self.thread.start()

    def __call__(self, event, **content):
        with suppress(queue.Full):
            self.lines.put_nowait(json.dumps(dict(content, event=event)) + "\n")

    def write(self):
        with suppress(OSError):  # nobody listens any more; the input ends as well
            for line in iter(self.lines.get, None):
                self.file.write(line)
                self.file.flush()

    def close(self):
        """Write what is left."""
        with suppress(queue.Full):
            self.lines.put_nowait(None)
            self.thread.join(1.0)


def run(program, needed=(), types="control_msgs"):
    """Execute the commands that are read, until the input ends.

    Parameters
    ----------
    program : function of a Teller that returns an object with `obey(do, **content)` and `close()`
    needed : modules that the program loads besides the usual ones
    types : package of the actions that it uses, which ROS may be without
    """
    tell = Teller()
    try:
        begun = loaded(program, (*NEEDED, *needed), types, tell)
        if begun is not None:
            obey(begun, tell)
    finally:
        tell.close()
        sys.stderr.flush()


def loaded(program, needed, types, tell):
    """Return the program, or tell what it lacks."""
    for reason, modules in (("ros", needed), (types, [f"{types}.action"])):
        try:
            for module in modules:
                import_module(module)
        except ImportError as error:
            tell("refused", reason=reason, what=str(error))
            return None
    return program(tell)


def obey(program, tell):
    """Execute commands, a line each; close the program however that ends."""

    def end(*_):
        raise SystemExit

    signal.signal(signal.SIGTERM, end)
    try:
        for line in iter(sys.stdin.readline, ""):
            program.obey(**json.loads(line))
    except Refused as refusal:
        reason, what, found = refusal.args
        tell("refused", reason=reason, what=what, found=found)
    except Exception as error:
        traceback.print_exc()
        tell("refused", reason="ended", what=f"{type(error).__name__}: {error}")
    finally:
        program.close()
