"""Compilation times of a first run, or of the whole warm-up.

The command runs in this process with an empty cache of kernels; numba's own events tell when the compilation of a
function for one signature begins and ends. A function's time is without the functions that it calls. A function that
stands in the table with several signatures is compiled once for each. Without a command, all jobs of the warm-up that
the installed extras allow are done one after the other, and then once more by processes on all cores, as users do
them; times are of the processor.

To repeat: ``pip install comove``, ``python benchmarks/compiling.py [solve narrow.yaml]``.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage

from timing import print_table


def exclusive_times(events) -> dict[str, list[float]]:
    """Return exclusive compilation times by function [s]. Each function has one for every signature; times exclude
    called functions."""
    times, stack = defaultdict(list), []
    for at, event in events:
        if event.is_start:
            stack.append([at, 0.0])
        else:
            begun, inner = stack.pop()
            function = event.data["dispatcher"].py_func
            times[f"{function.__module__.removeprefix('comove.')}.{function.__name__}"].append(
                at - begun - inner
            )
            if stack:
                stack[-1][1] += at - begun
    return times


def warm_up() -> None:
    """Compile the whole warm-up with an empty cache; print the table."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ |= {"NUMBA_CACHE_DIR": folder, "COMOVE_COMPILE_ALONE": "1"}
        from comove.planning.warming import JOBS

        rows = []
        for name, job in JOBS.items():
            if job.is_possible:
                begun, before = time.process_time(), kept(folder)
                job.solve()
                rows.append([name, time.process_time() - begun, kept(folder) - before])
        rows.append(["all", sum(row[1] for row in rows), kept(folder)])
    with tempfile.TemporaryDirectory() as folder:
        seconds = by_all_cores(folder)
        rows.append(["all, on all cores", seconds, kept(folder)])
    print_table(["job", "processor [s]", "files of code"], [[n, f"{s:.1f}", k] for n, s, k in rows])


def by_all_cores(folder: str) -> float:
    """Return the processor time [s] of the warm-up as users have it, with an empty cache, all processes together."""
    environment = {name: value for name, value in os.environ.items() if name != "COMOVE_COMPILE_ALONE"}
    code = "from comove.planning.warming import unfinished, warm_up; warm_up(unfinished())"
    before = getrusage(RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", code], env=environment | {"NUMBA_CACHE_DIR": folder}, check=True)
    after = getrusage(RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def kept(folder: str) -> int:
    """Count the compiled functions in a cache."""
    return sum(1 for _ in Path(folder).rglob("*.nbc"))


def main() -> None:
    """Run the command and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rows", type=int, default=40)
    parser.add_argument("arguments", nargs=argparse.REMAINDER, help="of comove, such as: solve narrow.yaml")
    options = parser.parse_args()
    if not options.arguments:
        warm_up()
        return

    with tempfile.TemporaryDirectory() as folder:
        os.environ |= {"NUMBA_CACHE_DIR": f"{folder}/kernels", "MPLCONFIGDIR": f"{folder}/fonts"}
        os.environ["COMOVE_COMPILE_ALONE"] = "1"  # all in this process
        from numba.core import event

        from comove.cli import main as comove

        started = time.perf_counter()
        with event.install_recorder("numba:compile") as recorder:
            try:
                sys.argv = ["comove", *options.arguments, "--out", f"{folder}/result"]
                comove()
            except SystemExit as left:
                if left.code:
                    sys.exit(left.code)
        wall = time.perf_counter() - started

    times = exclusive_times(recorder.buffer)
    total = sum(map(sum, times.values()))
    signatures = sum(map(len, times.values()))
    print(f"{wall:.1f} s, of which {total:.1f} s compile {len(times)} functions for {signatures} signatures")
    rooms = defaultdict(list)
    for name, each in times.items():
        rooms[name.rsplit(".", 1)[0]] += each
    for title, of in (("module", rooms), ("function", times)):
        print()
        slowest = sorted(of.items(), key=lambda row: -sum(row[1]))[: options.rows]
        print_table(
            [title, "seconds", "signatures"],
            [[name, f"{sum(each):.2f}", len(each)] for name, each in slowest],
        )


if __name__ == "__main__":
    main()
