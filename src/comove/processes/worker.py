"""Worker process of a pool: `python -m comove.processes.worker SOCKET`.

It receives the module path and the work, reports that it is ready, then answers each task by the result or the
exception. It ends when the other end closes, or when the process that started it is gone.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
import time
import warnings
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from comove.errors import ComoveWarning, InputError


def main(number: int) -> None:
    """Process the tasks that arrive on a socket."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the starter's business
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    warnings.simplefilter("ignore", ComoveWarning)  # of drawn scenes there would be thousands
    connection = Connection(number)
    with suppress(EOFError, OSError):  # the other end is gone
        sys.path[:] = connection.recv()
        try:
            work = pickle.loads(connection.recv_bytes())
        except (ImportError, AttributeError, TypeError, ValueError, pickle.PickleError) as error:
            connection.send(("unable", told(error)))
            return
        connection.send(("ready", None))
        while True:
            _answer(connection, work)


def _answer(connection: Connection, work: Any) -> None:
    """Process the next task and send the answer."""
    packed = connection.recv_bytes()
    try:
        answer = pickle.dumps(("made", work(pickle.loads(packed))))
    except InputError as error:
        answer = pickle.dumps(("refused", str(error)))
    except (Exception, SystemExit) as error:  # whatever the work may raise
        answer = pickle.dumps(("failed", told(error)))
    connection.send_bytes(answer)


def told(error: BaseException) -> str:
    """Return an exception in one line."""
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__


def _end_with(starter: int, look: float = 0.5) -> None:
    """Exit as soon as the starting process is gone. `look` is the interval between checks [s]."""
    while os.getppid() == starter:
        time.sleep(look)
    os._exit(1)


if __name__ == "__main__":
    main(int(sys.argv[1]))
