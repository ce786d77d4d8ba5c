"""Latency of the workbench: from the last movement of a drag to the first verified motion, without a browser.

    python benchmarks/workbench.py [--drags 100] [SCENE ...]

Every drag takes an obstacle, a start or a goal, and moves it in `STEPS` steps to a random place near its own, as a
hand would: a step every `PERIOD`. What is timed is what the page does: the draft goes to the planner's process, and
its first verified answer to the last step comes back with all that is drawn. Drags that end where no scene can be (a
start inside an obstacle), or where no motion is found, are counted apart, with the time after which the page says so.
The next drag begins with the first answer, as that of a person who does not wait: it ends the search before it.
"""

import argparse
import queue
import time
from pathlib import Path

import numpy as np

import comove
from comove.workbench.edits import Draft, contents_of, grips_of, moved, place_of
from comove.workbench.link import Link
from comove.workbench.shelf import read_scene

STEPS, PERIOD = 5, 0.05  # s
REACH = 0.06  # of the longest side of the workspace: how far from its own place a thing is dragged
ENOUGH = 60.0  # s, after which a drag counts as lost
EXAMPLES = Path(comove.__file__).parent / "examples"
SCENES = [
    EXAMPLES / f"{name}.yaml" for name in ("wide", "narrow", "complex", "turning", "window", "triangle")
]


def answer_to(number, answers, kinds=("kept", "found", "solved", "failed")):
    """Wait for the first answer of some kinds to one draft; return its kind, and when it came [s]."""
    until = time.perf_counter() + ENOUGH
    while True:
        header = answers.get(timeout=max(until - time.perf_counter(), 0.01)).header
        if header["id"] == number and header["kind"] in kinds:
            return header["kind"], time.perf_counter()


def dragged(scene, link, answers, rng):
    """Make one drag; return what came of it and after which time [s]."""
    contents = contents_of(scene)
    grips = grips_of(scene)
    grip = grips[rng.integers(len(grips))]
    home, reach = place_of(contents, grip), REACH * float((scene.upper - scene.lower).max())
    there = home.copy()
    there[: scene.n_dims] += rng.uniform(-reach, reach, scene.n_dims)
    for step in range(1, STEPS + 1):
        draft = Draft(moved(contents, grip, home + step / STEPS * (there - home)))
        begun, number = time.perf_counter(), link.submit(draft, dragging=step < STEPS)
        if step < STEPS:
            time.sleep(PERIOD)
    kind, arrived = answer_to(number, answers)
    return kind, arrived - begun


def memory_of(pid):
    """Return the resident memory of a process [MB]."""
    fields = Path(f"/proc/{pid}/statm").read_text().split()
    return int(fields[1]) * 4096 / 1e6


def measured(path, n_drags, seed):
    """Drag many times in one scene, and print a row of the table."""
    scene, answers, rng = read_scene(path), queue.Queue(), np.random.default_rng(seed)
    link = Link(path.parent, answers.put)
    answer_to(link.submit(Draft(contents_of(scene))), answers, ("solved",))  # kernels are loaded
    for _ in range(10):
        dragged(scene, link, answers, rng)
    before = memory_of(link.pid)
    made = [dragged(scene, link, answers, rng) for _ in range(n_drags)]
    after = memory_of(link.pid)
    link.close()
    found = 1e3 * np.array([t for kind, t in made if kind != "failed"])
    anew = 1e3 * np.array([t for kind, t in made if kind not in ("failed", "kept")])
    failed = 1e3 * np.array([t for kind, t in made if kind == "failed"])

    def spread(times):
        return f"{np.median(times):5.0f} {np.percentile(times, 95):6.0f}" if len(times) else "    -      -"

    kept = len(found) - len(anew)
    print(
        f"{path.stem:14s} {len(found):5d} {spread(found)}   {kept:4d}   {len(anew):4d} {spread(anew)}   "
        f"{len(failed):4d} {spread(failed)}   {before:5.0f} {after:6.0f}",
        flush=True,
    )


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", type=Path, default=SCENES)
    parser.add_argument("--drags", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print(
        f"{options.drags} drags a scene; times in ms after the last movement: median and 95 %; memory in MB"
    )
    print(
        "scene          found  med.   95 %   kept   anew  med.   95 %   none  med.   95 %   memory: before, after"
    )
    for path in options.scenes:
        measured(path, options.drags, options.seed)


if __name__ == "__main__":
    main()
