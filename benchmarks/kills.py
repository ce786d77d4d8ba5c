"""Kills in the middle of a study: tests for lost and duplicate runs.

    python benchmarks/kills.py [--kills 20] [--runs 2000] [--on processes dask]

A study of cheap runs (each waits 20 ms) is run by `run_study` in a process of its own, on two processes or on a Dask
scheduler with two workers. At random moments one of them is killed with SIGKILL, in turn: a worker, the driver, the
scheduler, and everything at once as in a power cut. Killed processes are started again, by the same commands, until
the study is done; a driver whose worker was killed has to go on by itself. In the end the run database is compared
with that of an undisturbed study.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path

from generate_work import Idle
from timing import on_one_thread, print_table

from comove.data import StudyStore, on_processes, run_study
from comove.data.runs import RUNS

PAUSE = 0.02  # s of a run
PATIENCE = 120.0  # s, after which a driver that does not go on, or does not end, counts as stuck
VICTIMS = {"processes": ("worker", "driver", "all"), "dask": ("worker", "driver", "scheduler", "all")}


def main() -> None:
    """Kill, compare and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--on", choices=tuple(VICTIMS), nargs="+", default=tuple(VICTIMS))
    parser.add_argument("--drive", nargs=3, metavar=("FOLDER", "LOG", "ADDRESS"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    on_one_thread()
    if options.drive:
        drive(options.runs, *options.drive)
        return
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "whole"
        run_study(Idle(options.runs), whole, on_processes(2))
        rows = [
            tortured(Path(folder), kind, options.kills, options.runs, rows_in(whole)) for kind in options.on
        ]
    header = ("on", *("killed", "runs", "lost", "twice", "other rows", "begun again", "seconds"))
    print_table(header, rows)


def drive(runs: int, folder: str, log: str, address: str) -> None:
    """Run the study, and print every run that has ended."""
    if address == "processes":
        run = on_processes(2)
    else:
        from comove.data.on_dask import on_dask

        run = on_dask(address, 2)
    study = Idle(runs, pause=PAUSE, log=Path(log))
    run_study(study, folder, run, tell=lambda progress: print(progress.done, flush=True))


def rows_in(folder: Path) -> list[tuple]:
    """Return all rows of a run database."""
    with StudyStore.open(folder / RUNS).connected(reading=True) as connection:
        return connection.execute("SELECT * FROM runs ORDER BY number").fetchall()


def tortured(folder: Path, kind: str, kills: int, runs: int, right: list[tuple]) -> list[object]:
    """Return the table row of a disturbed study."""
    crew = Crew(folder / kind, folder / f"{kind}.log", kind, runs)
    rng, victims, killed, begun = random.Random(0), cycle(VICTIMS[kind]), Counter[str](), time.perf_counter()
    try:
        while killed.total() < kills and not crew.done:
            crew.ensure()
            time.sleep(rng.uniform(0.1, 0.6))
            victim = next(victims)
            crew.kill(victim)
            killed[victim] += 1
        crew.finish()
    finally:
        crew.close()
    found = rows_in(crew.folder)
    started = Counter(crew.log.read_text().split())
    numbers = [row[1] for row in found]
    return [
        kind,
        ", ".join(f"{n} x {what}" for what, n in killed.items()),
        runs,
        len(set(range(runs)) - set(numbers)),
        len(numbers) - len(set(numbers)),
        sum(row not in set(right) for row in found),
        sum(n > 1 for n in started.values()),
        f"{time.perf_counter() - begun:.0f}",
    ]


@dataclass
class Crew:
    """Processes of a study: driver, and Dask's scheduler and nannies."""

    folder: Path
    log: Path
    kind: str
    runs: int
    processes: dict[str, subprocess.Popen] = field(default_factory=dict)
    address: str = "processes"

    @property
    def done(self) -> bool:
        """Return whether the driver has ended by itself with all runs."""
        driver = self.processes.get("driver")
        return driver is not None and driver.poll() == 0

    def ensure(self) -> None:
        """Start missing processes, and wait until runs end."""
        if self.kind == "dask":
            self.ensure_dask()
        if not self.lives("driver"):
            command = [__file__, "--runs", self.runs, "--drive", self.folder, self.log, self.address]
            self.start("driver", command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(3):
            self.processes["driver"].stdout.readline()

    def ensure_dask(self) -> None:
        """Start a scheduler and its workers, where missing."""
        if not self.lives("scheduler"):
            with socket.socket() as free:
                free.bind(("127.0.0.1", 0))
                port = free.getsockname()[1]
            self.address = f"tcp://127.0.0.1:{port}"
            self.end("workers")
            place = ["--host", "127.0.0.1", "--port", port, "--no-dashboard"]
            self.start("scheduler", ["-m", "distributed.cli.dask_scheduler", *place])
        if not self.lives("workers"):
            count = ["--nworkers", 2, "--nthreads", 1, "--no-dashboard"]
            self.start("workers", ["-m", "distributed.cli.dask_worker", self.address, *count])

    def start(self, name: str, command: list[object], **options: object) -> None:
        """Start Python with a command, in a session of its own."""
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        path = os.pathsep.join(filter(None, (str(Path(__file__).parent), os.environ.get("PYTHONPATH"))))
        self.processes[name] = subprocess.Popen(
            [sys.executable, *map(str, command)],
            env=os.environ | {"PYTHONPATH": path},
            start_new_session=True,
            **(quiet | options),  # type: ignore[arg-type]
        )

    def lives(self, name: str) -> bool:
        """Return whether a process is running."""
        process = self.processes.get(name)
        return process is not None and process.poll() is None

    def kill(self, victim: str) -> None:
        """Kill a worker, another process, or all of them."""
        if victim == "worker":
            starter = self.processes["driver" if self.kind == "processes" else "workers"]
            workers = [pid for pid in children(starter.pid) if b"tracker" not in said(pid)]
            for pid in workers[:1]:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
        elif victim == "all":
            for name in self.processes:
                self.end(name)
        else:
            self.processes[victim].kill()
            self.processes[victim].wait()
        if victim == "scheduler":  # its driver says so, and ends by itself
            _, err = self.processes["driver"].communicate(timeout=PATIENCE)
            if self.processes["driver"].returncode and "scheduler" not in err.splitlines()[-1]:
                raise SystemExit(f"the driver said something else: {err[-300:]}")

    def end(self, name: str) -> None:
        """Kill a process and all that it started."""
        if name in self.processes:
            process = self.processes[name]
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()

    def finish(self) -> None:
        """Complete the study."""
        if not self.done:
            self.ensure()
            _, err = self.processes["driver"].communicate(timeout=PATIENCE + 2 * PAUSE * self.runs)
            if self.processes["driver"].returncode:
                raise SystemExit(f"the study does not go on: {err[-300:]}")

    def close(self) -> None:
        """End all processes."""
        for name in self.processes:
            self.end(name)


def children(pid: int) -> list[int]:
    """Return the child processes of a process."""
    with suppress(OSError):
        return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return []


def said(pid: int) -> bytes:
    """Return the command of a process."""
    with suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    return b""


if __name__ == "__main__":
    main()
