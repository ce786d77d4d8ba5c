"""Shared parts of benchmarks: clocks, tables, optional peers, and TOPP-RA."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from importlib import import_module
from math import ceil, floor, log10
from pathlib import Path
from statistics import median
from types import ModuleType
from typing import Any

import numpy as np

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def on_one_thread() -> None:
    """Restart the script with single-threaded numerical libraries, unless it is."""
    if any(os.environ.get(name) != "1" for name in THREAD_VARIABLES):
        environment = os.environ | dict.fromkeys(THREAD_VARIABLES, "1")
        sys.stdout.flush()
        os.execve(sys.executable, [sys.executable, *sys.argv], environment)


def peer(name: str) -> ModuleType:
    """Import a module of a peer. Where it is missing, exit with the command that installs it."""
    try:
        return import_module(name)
    except ImportError as error:
        sys.exit(f"{error.name or name} is not installed; run: pip install 'comove[bench]'")


class Watch:
    """Progress callback of `comove.solve` that records improvements, on the wall or by another clock."""

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.clock, self.begun, self.seen = clock, clock(), [(0.0, float("inf"))]

    def __call__(self, progress: Any) -> None:
        if progress.best is not None and progress.best < self.seen[-1][1]:
            self.seen.append((self.clock() - self.begun, progress.best))

    def converged(self, within: float = 0.01) -> float:
        """Return when the best came within a share of the last [s]. It is NaN where there is none."""
        return self.reached((1 + within) * self.last)

    @property
    def last(self) -> float:
        """Return the last value. It is inf where there is none."""
        return self.seen[-1][1]

    def reached(self, value: float) -> float:
        """Return when the best came down to a value [s]. It is NaN where it never did."""
        return next((t for t, best in self.seen if best <= value < float("inf")), float("nan"))


class Parts:
    """Exclusive processor time by part of a program [s]. Calls of other parts are excluded.

    Parameters
    ----------
    parts : functions of each part, as pairs of a module or class, and a name in it
    """

    def __init__(self, parts: Mapping[str, Iterable[tuple[Any, str]]]) -> None:
        self.seconds, self._inner = dict.fromkeys(parts, 0.0), [0.0]
        for part, functions in parts.items():
            for owner, name in functions:
                setattr(owner, name, self._timed(part, getattr(owner, name)))

    def _timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def timed(*arguments: Any, **named: Any) -> Any:
            self._inner.append(0.0)
            started = time.process_time()
            try:
                return function(*arguments, **named)
            finally:
                spent = time.process_time() - started
                self.seconds[part] += spent - self._inner.pop()
                self._inner[-1] += spent

        return timed

    def of(self, function: Callable[[], Any]) -> dict[str, float]:
        """Return the seconds of each part in one call."""
        self.seconds = dict.fromkeys(self.seconds, 0.0)
        function()
        return self.seconds


def elapsed(function: Callable[[], Any]) -> float:
    """Return the wall time of one call [s]."""
    started = time.perf_counter()
    function()
    return time.perf_counter() - started


def medians(functions: Mapping[str, Callable[[], Any]], repeats: int) -> dict[str, float]:
    """Return the median wall time of each function [s]. They alternate, so that other work on the machine slows all
    of them alike. The first round warms up and does not count."""
    times: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(repeats + 1):
        for name, function in functions.items():
            times[name].append(elapsed(function))
    return {name: median(values[1:]) for name, values in times.items()}


def memory_of(pid: int) -> float:
    """Return the resident memory of a process [MB]."""
    fields = Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()
    return int(fields[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def print_table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print an aligned Markdown table."""
    cells = [list(map(str, row)) for row in (header, *rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    cells.insert(1, ["-" * width for width in widths])
    for row in cells:
        print("| " + " | ".join(map(str.ljust, row, widths)) + " |")


def print_head(header: Sequence[str]) -> None:
    """Print the head of a Markdown table with later rows."""
    print_row(header)
    print("|" + "---|" * len(header), flush=True)


def print_row(cells: Sequence[object]) -> None:
    """Print a row of a Markdown table."""
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


def by_toppra(position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> Callable[[], Any]:
    """Return a function that computes the fastest movement by TOPP-RA. The method is that of Pham and Pham, 2018. It
    returns a curve that has a `duration`; None where there is none, or TOPP-RA is not installed.

    Parameters
    ----------
    position : array, shape (n_steps, n), samples of a movement from rest to rest
    velocity, acceleration : arrays, shape (n,), limits of every coordinate
    """
    try:
        import toppra
        from toppra.algorithm import TOPPRA
        from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint
    except ImportError:
        return lambda: None
    toppra.setup_logging("ERROR")
    # At rest at both ends, the path by time has no speed there: by its own length it has.
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))])
    kept = np.concatenate([[True], np.diff(length) > 1e-6 * length[-1] / len(position)])
    path = toppra.SplineInterpolator(length[kept], position[kept])
    limits = [
        kind(np.stack([-most, most], axis=1))
        for kind, most in ((JointVelocityConstraint, velocity), (JointAccelerationConstraint, acceleration))
    ]
    return lambda: TOPPRA(limits, path, parametrizer="ParametrizeConstAccel").compute_trajectory()


def number(value: float, digits: int = 3) -> str:
    """Return a number with significant digits, rarely with an exponent."""
    if value == 0 or not 1e-3 <= abs(value) < 1e6:
        return f"{value:.{digits}g}"
    return f"{value:.{max(0, digits - 1 - floor(log10(abs(value))))}f}"


def quantile(values: Sequence[float], share: float) -> float:
    """Return the least value that `share` of the values do not exceed. Infinite values are allowed."""
    ranked = sorted(values)
    return ranked[max(0, ceil(share * len(ranked)) - 1)]
