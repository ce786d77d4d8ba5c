"""How long a user waits for the command line: first run after installation, later runs, and the help.

- first run: ``comove solve narrow.yaml`` with no compiled kernels and no font cache yet, once;
- later runs: the same with both in place, a new process each, median;
- help: ``comove --help``, median.

Wall time counts all from the start of the process to its end; processor time tells whether the machine was
busy with something else. Caches lie in a temporary folder: those of the user are neither used nor changed.

To repeat: ``pip install comove``, ``python benchmarks/start_up.py [--repeats 5] [--scene FILE]``.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from statistics import median

from timing import number, print_table

COMOVE = (sys.executable, "-m", "comove")


def run(arguments: Sequence[str], environment: dict[str, str]) -> tuple[float, float]:
    """Wall time and processor time of one command [s]; leaves with its message where it fails."""
    before, started = getrusage(RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run([*COMOVE, *arguments], env=environment, capture_output=True, text=True)
    wall, after = time.perf_counter() - started, getrusage(RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(f"comove {' '.join(arguments)}: exit code {done.returncode}\n{done.stderr}")
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def row(name: str, times: Sequence[tuple[float, float]]) -> list[str]:
    """One row of the table."""
    wall, processor = zip(*times, strict=True)
    return [name, str(len(times)), number(median(wall)), number(max(wall)), number(median(processor))]


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--scene", type=Path, default=files("comove") / "examples" / "narrow.yaml")
    options = parser.parse_args()

    with tempfile.TemporaryDirectory() as folder:
        caches = {"NUMBA_CACHE_DIR": f"{folder}/kernels", "MPLCONFIGDIR": f"{folder}/fonts"}
        solve = ["solve", str(options.scene), "--out", f"{folder}/result"]
        environment = os.environ | caches
        verb = f"`comove solve {Path(options.scene).name}`"
        first = [run(solve, environment)]
        later = [run(solve, environment) for _ in range(options.repeats)]
        asked = [run(["--help"], environment) for _ in range(options.repeats)]
    ratio = number(median(wall for wall, _ in first) / median(wall for wall, _ in later))
    print_table(
        ["command", "runs", "wall median [s]", "wall max [s]", "processor median [s]", "times a later run"],
        [
            [*row(f"{verb}, first run", first), ratio],
            [*row(f"{verb}, later", later), "1"],
            [
                *row("`comove --help`", asked),
                number(median(w for w, _ in asked) / median(w for w, _ in later)),
            ],
        ],
    )


if __name__ == "__main__":
    main()
