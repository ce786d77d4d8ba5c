"""Planning scenes of MoveIt, imported and solved: both layouts of text, and bags of versions 8 and 9.

    python benchmarks/planning_scenes.py --scenes 20 --seed 0

Two Pandas lift a rail off a table (texts, which have no robot) or hold a bar that is attached to one hand (bags, a
whole scene and what changes it), among random boxes, cylinders and spheres. Each scene goes through `comove scene
import`, `solve` and `verify`. No obstacle is near the payload, or above it, at its start or goal; where one
touches an arm there, `solve` refuses the scene. Needs comove[robot,data].
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from timing import on_one_thread, print_head, print_row

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.ros.planning_goals import BAR, Cell, Wire, moved, pose

SCENE, TOPIC = "moveit_msgs/msg/PlanningScene", "/monitored_planning_scene"
KINDS = {"box": (1, 3), "sphere": (2, 1), "cylinder": (3, 2)}
"""Number in `shape_msgs/SolidPrimitive`, and number of sizes."""
AWAY = 0.16  # m, of an obstacle's centre from the payload's axis, and all above it, at its ends


@dataclass(frozen=True)
class Shape:
    """An obstacle. Sizes are those of messages: a cylinder's height comes before its radius."""

    name: str
    kind: str
    sizes: tuple[float, ...]
    center: tuple[float, ...]


def drawn(random: np.random.Generator, ends: list[np.ndarray], length: float) -> list[Shape]:
    """Return obstacles that keep away from a payload along y at its ends."""
    found = list[Shape]()
    wanted = random.integers(2, 6)
    while len(found) < wanted:
        center = random.uniform([0.3, -0.3, 0.15], [0.8, 0.3, 0.6])
        if any(_distance(center, end, length) < AWAY for end in ends):
            continue
        kind = str(random.choice([*KINDS]))
        sizes = random.uniform(0.03, 0.1, 3) if kind == "box" else random.uniform([0.05, 0.02], [0.15, 0.05])
        sizes = sizes[-KINDS[kind][1] :]
        found.append(Shape(f"{kind} {len(found)}", kind, tuple(sizes.tolist()), tuple(center.tolist())))
    return found


def _distance(point: np.ndarray, middle: np.ndarray, length: float) -> float:
    """Return the distance from a payload and all above it, where the hands are."""
    along = np.clip(point[1] - middle[1], -0.5 * length, 0.5 * length)
    above = max(point[2] - middle[2], 0.0)
    return float(np.linalg.norm(point - middle - [0.0, along, above]))


def text(path: Path, random: np.random.Generator, *, poses: bool) -> list[str]:
    """Write a scene as text, with `poses` of objects or in the layout before; return the options of its import."""
    length = random.uniform(0.45, 0.55)
    rail = np.array([random.uniform(0.39, 0.45), 0.0, 0.145])
    goal = np.array([random.uniform(0.5, 0.6), random.uniform(-0.05, 0.05), random.uniform(0.35, 0.5)])
    shapes = [
        Shape("table", "box", (0.6, 1.2, 0.04), (0.5, 0.0, 0.1)),
        Shape("rail", "box", (0.05, length, 0.05), tuple(rail.tolist())),
        *drawn(random, [rail, goal], length),
    ]
    lines = ["(noname)+"]
    for one in shapes:
        sizes = one.sizes[::-1] if one.kind == "cylinder" else one.sizes
        at, none = " ".join(map(repr, one.center)), "0 0 0"
        lines += [
            f"* {one.name}",
            *([at, "0 0 0 1"] if poses else []),
            "1",
            one.kind,
            " ".join(map(repr, sizes)),
        ]
        lines += [none if poses else at, "0 0 0 1", "0 0 0 0", *(["0"] if poses else [])]
    path.write_text("\n".join([*lines, ".", ""]))
    return ["--payload", "rail", "--support", "table", "--goal-position", *map(repr, goal.tolist())]


def bag(path: Path, random: np.random.Generator, *, version: int) -> list[str]:
    """Write a bag, a whole scene and what changes it; return the options of its import."""
    cell, wire = Cell(), Wire()
    shift = random.uniform([-0.05, -0.1, 0.08], [0.12, 0.1, 0.25])
    shapes = drawn(random, [cell.bar[:3, 3], cell.bar[:3, 3] + shift], BAR[0][1])
    whole, objects = cell.scene(), [_message(one) for one in shapes]
    whole["world"]["collision_objects"] = whole["world"]["collision_objects"][:1] + objects[:1]
    away = {**_message(shapes[1]), "pose": pose(moved(np.eye(4), 0.0, 0.0, 3.0))}
    back = {"id": shapes[1].name, "header": {"frame_id": "world"}, "pose": objects[1]["pose"], "operation": 3}
    changes = [[away, *objects[2:]], [back]]
    scenes = [whole, *({"is_diff": True, "world": {"collision_objects": one}} for one in changes)]
    made = [(TOPIC, SCENE, wire.make(SCENE, scene)) for scene in scenes]
    wire.messages.bag(path, made, version=version, storage="MCAP" if path.suffix else "SQLITE3")
    return ["--shift", *map(repr, shift.tolist())]


def _message(one: Shape) -> dict[str, Any]:
    at = np.eye(4)
    at[:3, 3] = one.center
    return {
        "header": {"frame_id": "world"},
        "id": one.name,
        "pose": pose(at),
        "primitives": [{"type": KINDS[one.kind][0], "dimensions": [*one.sizes]}],
        "primitive_poses": [pose(np.eye(4))],
    }


LAYOUTS: dict[str, tuple[str, Callable[[Path, np.random.Generator], list[str]]]] = {
    "text with poses": ("cell.scene", lambda path, random: text(path, random, poses=True)),
    "text without": ("cell.scene", lambda path, random: text(path, random, poses=False)),
    "bag, version 8": ("cell", lambda path, random: bag(path, random, version=8)),
    "bag, version 9": ("cell.mcap", lambda path, random: bag(path, random, version=9)),
}


def comove(folder: Path, *words: str) -> tuple[bool, str]:
    """Run a command; return whether it ended with 0, and what it told."""
    done = subprocess.run(
        [sys.executable, "-m", "comove", *words], cwd=folder, capture_output=True, text=True
    )
    told = (done.stderr if done.returncode == 2 else done.stdout).split("error: ")[-1]
    return done.returncode == 0, " ".join(told.split())


def tried(layout: str, seed: int, budget: float) -> tuple[list[bool], float, str]:
    """Return which steps of a scene succeeded, the time [s], and why the first that failed did."""
    name, make = LAYOUTS[layout]
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        options = make(here / name, np.random.default_rng(seed))
        begun = time.perf_counter()
        steps = list[bool]()
        words = ["scene", "import", name, "--robot", "two_pandas", *options, "--out", "made.yaml"]
        for step in range(3):
            if step == 1:
                present = ["--present", "made-present.yaml"] if (here / "made-present.yaml").exists() else []
                words = ["solve", "made.yaml", "--out", "found", *present, "--budget", f"{budget:g}"]
            elif step == 2:
                words = ["verify", "found"]
            succeeded, told = comove(here, *words)
            steps.append(succeeded)
            if not succeeded:
                return [*steps, False, False][:3], time.perf_counter() - begun, told
        return steps, time.perf_counter() - begun, ""


def main() -> None:
    """Print a row a scene, and a sum a layout."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=int, default=20, help="number of scenes")
    parser.add_argument("--seed", type=int, default=0, help="seed of the first scene")
    parser.add_argument("--budget", type=float, default=30.0, help="budget of `comove solve` [s]")
    given = parser.parse_args()
    on_one_thread()
    columns = ("scene", "layout", "imported", "solved", "verified", "s")
    print_head(columns)
    totals = {layout: np.zeros(5) for layout in LAYOUTS}
    reasons = list[str]()
    for number in range(given.scenes):
        layout = [*LAYOUTS][number % len(LAYOUTS)]
        steps, seconds, why = tried(layout, given.seed + number, given.budget)
        totals[layout] += [1, *steps, seconds]
        print_row((number, layout, *("yes" if step else "no" for step in steps), f"{seconds:.1f}"))
        if why:
            reasons.append(f"{number}: {why}")
    print()
    print_head(("layout", "scenes", *columns[2:]))
    for layout, (n, *rest, seconds) in totals.items():
        print_row((layout, int(n), *map(int, rest), f"{seconds:.1f}"))
    print(*(f"\n{why}" for why in reasons), sep="")


if __name__ == "__main__":
    main()
