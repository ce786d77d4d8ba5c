"""Runs of `generate.py`, in a module that other processes can import."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from comove.data import StudyRun
from comove.data.runs import StoredMotion


@dataclass(frozen=True)
class TimedWork:
    """Work that also returns its process's time before and after [s]."""

    work: Callable[[Any], Any]

    def __call__(self, task: Any) -> tuple[float, float, Any]:
        """Return both times, and the result."""
        begun = time.process_time()
        made = self.work(task)
        return begun, time.process_time(), made


@dataclass(frozen=True)
class Idle:
    """Study whose runs wait, and log their beginning."""

    total: int
    name: str = "idle"
    budget: float = 1.0
    pause: float = 0.0
    log: Path | None = None

    @property
    def described(self) -> dict[str, Any]:
        """Return nothing."""
        return {}

    def require(self) -> None:
        """Need nothing."""

    def example_scenes(self) -> tuple[()]:
        """Return none, as none is solved."""
        return ()

    def key(self, number: int) -> str:
        """Return the number as a key."""
        return f"{number:012d}"

    def run(self, number: int) -> tuple[StudyRun, StoredMotion | None]:
        """Return a row after the pause."""
        if self.log is not None:
            with open(self.log, "a", encoding="utf-8") as log:
                log.write(f"{number}\n")
        time.sleep(self.pause)
        return row_of(number), None


def row_of(number: int) -> StudyRun:
    """Return a row of typical length."""
    x = (number % 9973) / 9973.0
    figures = dict.fromkeys(("duration", "cost", "clearance_min", "end_error", "speed_max", "jerk_max"), x)
    return StudyRun(
        f"{number:064d}",
        number,
        f"posts-{number:06d}",
        f"{number:064x}",
        "comove",
        seed=number,
        status="verified" if number % 100 else "not verified",
        reason="" if number % 100 else "the load comes too near to obstacles[0] (circle)",
        passing=f"0+ {number % 3}-",
        motion_sha256=f"{number:064x}",
        seconds=x,
        started="2026-01-01T00:00:00.000+00:00",
        **figures,
    )
