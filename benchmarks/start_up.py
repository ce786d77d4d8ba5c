"""Waiting times of command line and first search, for two versions.

- first run: ``comove solve narrow.yaml`` with no compiled kernels and no font cache yet, once (`--first`);
- later runs, each a new process with both in place: `solve`, with pictures and without, `verify`, `show`, `--help`,
  and ``import comove`` with the first `solve` in Python;
- solve of ``examples/baxter/gap_30.yaml`` (`--robots`).

Wall time counts all from the start of the process to its end; processor time, of the process and of those that help
it, shows whether the machine was busy with something else. Caches lie in temporary folders: those of the user are
neither used nor changed.

To repeat: ``pip install "comove[robot]"``,
``python benchmarks/start_up.py [--before SRC] [--repeats 5] [--first] [--robots]``, where SRC is the folder `src` of
another version.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from statistics import median

from timing import number, print_table

SRC = Path(__file__).parents[1] / "src"
SCENE = "comove/examples/narrow.yaml"
ROBOT_SCENE = Path(__file__).parents[1] / "examples" / "baxter" / "gap_30.yaml"
FROM_PYTHON = "import sys, comove; assert comove.solve(comove.Scene.load(sys.argv[1])).verified"


def measured(src: Path, folder: Path, words: list[str], *, alone: bool) -> tuple[float, float]:
    """Return processor and wall time of a Python command [s]. If it fails, exit with its message."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    environment |= {
        "PYTHONPATH": str(src),
        "NUMBA_CACHE_DIR": f"{folder}/kernels",
        "MPLCONFIGDIR": f"{folder}/fonts",
    }
    if alone:  # what is compiled first must not be going on in the background while others are measured
        environment["COMOVE_COMPILE_ALONE"] = "1"
    before, started = getrusage(RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(
        [sys.executable, *words], env=environment, cwd=folder, capture_output=True, text=True
    )
    wall, after = time.perf_counter() - started, getrusage(RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(f"{src}: {' '.join(words)}: exit code {done.returncode}\n{done.stderr}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall


def commands(src: Path, *, is_new: bool, robots: bool) -> dict[str, list[str]]:
    """Return the words after `python`, by their names in the table."""
    comove, scene = ["-m", "comove"], str(src / SCENE)
    solve = [*comove, "solve", scene, "--out", "out"]
    found = {
        "comove solve narrow.yaml": solve,
        "the same, --no-pictures": [*solve, "--no-pictures"] if is_new else [],
        "comove verify": [*comove, "verify", "out"],
        "comove show": [*comove, "show", "out"],
        "comove --help": [*comove, "--help"],
        "import comove, first solve": ["-c", FROM_PYTHON, scene],
    }
    if robots:
        found["comove solve gap_30.yaml"] = [*comove, "solve", str(ROBOT_SCENE), "--out", "joints"]
    return found


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--before", type=Path, help="folder src of another version")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--first", action="store_true", help="measure first runs alone")
    parser.add_argument("--robots", action="store_true", help="measure a robot's scene as well")
    options = parser.parse_args()

    sources = [SRC, *([options.before.resolve()] if options.before else [])]
    with tempfile.TemporaryDirectory() as place:
        folders = [Path(place, str(i)) for i in range(len(sources))]
        asked = [commands(src, is_new=src == SRC, robots=options.robots) for src in sources]
        for folder in folders:
            folder.mkdir()
        rows = []
        for name in asked[0]:
            times: list[list[tuple[float, float]]] = [[] for _ in sources]
            for repeat in range(1 if options.first else 1 + options.repeats):
                for found, src, folder, of in zip(times, sources, folders, asked, strict=True):
                    if of[name]:
                        one = measured(src, folder, of[name], alone=not options.first and not repeat)
                        found += [one] if options.first or repeat else []
            rows.append([name, *(cell for found in times for cell in cells(found))])
            if options.first:
                break
    header = ["command", "processor [s]", "wall [s]"]
    header += ["processor, before [s]", "wall, before [s]"] if options.before else []
    print_table(header, rows)


def cells(times: list[tuple[float, float]]) -> list[str]:
    """Return the medians of processor time and wall time as text."""
    return [number(median(one)) for one in zip(*times, strict=True)] if times else ["-", "-"]


if __name__ == "__main__":
    main()
