"""How long a user waits for the command line: first run after installation, later runs, and the help.

- first run: ``comove solve narrow.yaml`` with no compiled kernels and no font cache yet, once;
- later runs: the same with both in place, a new process each, median;
- the same of ``comove solve examples/baxter/gap_30.yaml``, where the scenes of the repository are there;
- help: ``comove --help``, median.

Wall time counts all from the start of the process to its end; processor time, of the process and of the one that
helps it to compile, tells whether the machine was busy with something else. Caches lie in a temporary folder: those
of the user are neither used nor changed.

To repeat: ``pip install "comove[robot]"``, ``python benchmarks/start_up.py [--repeats 5] [--scene FILE]``.
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
ROBOT_SCENE = Path(__file__).parents[1] / "examples" / "baxter" / "gap_30.yaml"
HEADER = ("command", "runs", "wall median [s]", "wall max [s]", "processor median [s]", "times a later run")


def run(arguments: Sequence[str], environment: dict[str, str]) -> tuple[float, float]:
    """Wall time and processor time of one command [s]; leaves with its message where it fails."""
    before, started = getrusage(RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run([*COMOVE, *arguments], env=environment, capture_output=True, text=True)
    wall, after = time.perf_counter() - started, getrusage(RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(f"comove {' '.join(arguments)}: exit code {done.returncode}\n{done.stderr}")
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def rows(verb: Sequence[str], scene: Path, repeats: int) -> list[list[str]]:
    """Rows of the table for a command, run first and later."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"NUMBA_CACHE_DIR": f"{folder}/kernels", "MPLCONFIGDIR": f"{folder}/fonts"}
        command = [*verb, str(scene), "--out", f"{folder}/result"]
        first, *later = [run(command, environment) for _ in range(1 + repeats)]
    name = f"`comove {' '.join(verb)} {scene.name}`"
    return [row(f"{name}, first run", [first], later), row(f"{name}, later", later, later)]


def row(
    name: str, times: Sequence[tuple[float, float]], later: Sequence[tuple[float, float]] = ()
) -> list[str]:
    """One row of the table; how many times as long as a later run, where there is one."""
    wall, processor = zip(*times, strict=True)
    ratio = number(median(wall) / median(w for w, _ in later)) if later else ""
    return [name, str(len(times)), number(median(wall)), number(max(wall)), number(median(processor)), ratio]


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--scene", type=Path, default=files("comove") / "examples" / "narrow.yaml")
    parser.add_argument("--robot-scene", type=Path, default=ROBOT_SCENE)
    options = parser.parse_args()

    table = rows(["solve"], Path(options.scene), options.repeats)
    if options.robot_scene.is_file():
        table += rows(["solve"], options.robot_scene, options.repeats)
    asked = [run(["--help"], dict(os.environ)) for _ in range(options.repeats)]
    print_table(HEADER, [*table, row("`comove --help`", asked)])


if __name__ == "__main__":
    main()
