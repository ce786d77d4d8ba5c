"""Work for processes, which has to be in a module that they can import."""

import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from comove.errors import OptionError


def square(number):
    return number * number


def process_of(number):
    time.sleep(0.05)
    return os.getpid()


def failing(number):
    if number == 1:
        raise ValueError("no idea\nreally")
    if number == 2:
        raise OptionError("it is two", way_out="give another")
    if number == 3:
        sys.exit("gone")
    if number == 4:
        return lambda: None  # which no other process can be sent
    return number


def kill(number):
    if number is not None:
        os.kill(os.getpid(), signal.SIGKILL)


def note(folder, name):
    Path(folder, f"{name}.note").write_text(str(os.getpid()))


def threads(number):
    return {name: os.environ[name] for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")}


@dataclass(frozen=True)
class Killing:
    """Kills its own process on some tasks, on each as often as is left in a file."""

    folder: Path

    def __call__(self, number):
        file = self.folder / str(number)
        if file.exists() and int(file.read_text()):
            file.write_text(str(int(file.read_text()) - 1))
            os.kill(os.getpid(), signal.SIGKILL)
        return number


def sleeping(number):
    time.sleep(60.0 if number == 1 else 0.0)
    return number


class Unloadable:
    """Cannot be made anew in another process."""

    def __reduce__(self):
        return _refuse, ()

    def __call__(self, number):
        return number


def _refuse():
    raise ValueError("never again")
