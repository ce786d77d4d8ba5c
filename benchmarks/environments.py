"""Payloads of two end effectors in published environments.

They are bookshelves, cages, tables and boxes.

    python benchmarks/environments.py PROBLEMS [--scenes 84] [--seed 5]

PROBLEMS is the unpacked archive of MotionBenchMaker's problems for the Panda (Chamzas et al., 2022; BSD-3-Clause):
``resources/panda/problems.tar.bz2`` of the repository KavrakiLab/vamp. Of each environment, planning scenes are
sampled; in each, a bar of 0.4 m, a solid box and a tray that stays level move from a pose in front to one inside the
environment, both sampled until they are 2 cm clear. Scenes that no run solves within 60 s, with two further seeds
either, are counted and left out: their feasibility is unknown. Columns: verified; first verified motion, the first
whose objective is within 1 % of the last one's, and whole search, medians, 95 % and most [s]; largest acceleration,
as a share of that of minimum jerk along a straight path, median.
"""

from __future__ import annotations

import argparse
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from timing import Watch, on_one_thread, print_table, quantile

import comove
from comove.errors import InputError

BUDGET = 60.0  # s
STRAIGHT = 10 / np.sqrt(3)  # peak acceleration of minimum jerk over one metre in one second [m/s^2]
DURATION = 10.0  # s
CLEAR = 0.02  # m, at both ends
AROUND = 0.5  # m, of the workspace about what stands there
FAR = 0.4  # m, that start and goal are apart at least
LOADS: dict[str, tuple[dict[str, Any], float, list[dict[str, Any]]]] = {
    "bar": ({"shape": "bar", "length": 0.4, "radius": 0.01}, 0.4, []),
    "box": (
        {"shape": "box", "size": [0.24, 0.12, 0.1]},
        0.24,
        [{"type": "relative_pose", "between": ["left", "right"]}],
    ),
    "tray": ({"shape": "box", "size": [0.3, 0.2, 0.02]}, 0.3, [{"type": "upright"}]),
}


def main() -> None:
    """Sample, solve and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("problems", type=Path)
    parser.add_argument("--scenes", type=int, default=84)
    parser.add_argument("--seed", type=int, default=5)
    asked = parser.parse_args()
    on_one_thread()
    warnings.simplefilter("ignore")
    folders = sorted(path.parent for path in asked.problems.rglob("scene0001.yaml"))
    if not folders:
        parser.error(f"{asked.problems} holds no scene0001.yaml: unpack problems.tar.bz2 there")
    rows: dict[str, list[tuple[float, ...]]] = {}
    solve(folders[0], "bar", np.random.default_rng(0))  # compiles
    for i in range(asked.scenes):
        folder, load = folders[i % len(folders)], list(LOADS)[i // len(folders) % len(LOADS)]
        figures = solve(folder, load, np.random.default_rng([asked.seed, i]))
        print(f"{i:3d} {folder.name:24s} {load:5s}", *(f"{value:.3g}" for value in figures), flush=True)
        for name in (folder.name, load, "all"):
            rows.setdefault(name, []).append(figures)
    told = [[name, *row(np.array(figures))] for name, figures in rows.items()]
    header = (
        "scenes",
        "verified",
        "unknown",
        "first s",
        "95 %",
        "most",
        "converged s",
        "95 %",
        "most",
        "all s",
        "95 %",
        "most",
        "acceleration",
    )
    print_table(header, told)


def row(figures: np.ndarray) -> list[str]:
    """Return the cells of a row. Figures are verified, solvable, seconds to the first, to the last, in all,
    acceleration."""
    known = figures[figures[:, 1] > 0]
    verified, _, first, converged, whole, acceleration = known.T
    return [
        f"{int(verified.sum())} of {len(known)}",
        str(len(figures) - len(known)),
        *(
            f"{f(times):.2f}"
            for times in (first, converged, whole)
            for f in (np.median, lambda x: quantile(x, 0.95), np.max)
        ),
        f"{np.nanmedian(acceleration):.2f}",
    ]


def solve(folder: Path, load: str, rng: np.random.Generator) -> tuple[float, ...]:
    """Solve a scene sampled from an environment; return the figures of `row`."""
    scene = drawn(folder, load, rng)
    watch, begun = Watch(), time.perf_counter()
    solution = comove.solve(scene, budget=BUDGET, progress=watch)
    whole = time.perf_counter() - begun
    solvable = solution.verified or any(
        comove.solve(scene, budget=BUDGET, seed=seed).verified for seed in (1, 2)
    )
    straight = STRAIGHT * np.linalg.norm(scene.goal - scene.start, axis=1).max() / DURATION**2
    first = solution.effort.first_verified
    acceleration = solution.report.acceleration_max / straight
    soon = first if first is not None else np.inf, watch.converged()
    return solution.verified, solvable, *soon, whole, acceleration


def drawn(folder: Path, load: str, rng: np.random.Generator) -> comove.Scene:
    """Sample a scene with a payload that enters an environment."""
    path = sorted(folder.glob("scene*.yaml"))[rng.integers(100)]
    obstacles = obstacles_of(path)
    corners = np.array([corner for obstacle in obstacles for corner in hull(obstacle)])
    # Cages and shelves are what is met; a floor or a base that is far larger bounds the workspace as well.
    lower, upper = corners.min(axis=0), corners.max(axis=0)
    shape, length, constraints = LOADS[load]
    workspace = {"lower": (lower - AROUND).tolist(), "upper": (upper + AROUND).tolist()}
    data = {
        "name": folder.name,
        "duration": DURATION,
        "workspace": workspace,
        "obstacles": obstacles,
        "load": {"mass": 0.5, **shape},
        "constraints": constraints,
        "limits": {"clearance": CLEAR},
    }
    if load != "bar":
        data["load"]["grasps"] = {"left": [-length / 2, 0.0, 0.0], "right": [length / 2, 0.0, 0.0]}
    while True:
        inside = hands(rng.uniform(lower, upper), length, load, rng)
        outside = hands(rng.uniform(lower - AROUND, upper + AROUND), length, load, rng)
        middle = outside.mean(axis=0)
        if ((middle > lower) & (middle < upper)).all():
            continue
        if np.linalg.norm(middle - inside.mean(axis=0)) < FAR:
            continue
        names = ("left", "right")
        data["manipulators"] = [
            {"name": name, "start": outside[i].tolist(), "goal": inside[i].tolist()}
            for i, name in enumerate(names)
        ]
        try:
            comove.Scene.from_dict(data)
        except InputError:
            continue
        return comove.Scene.from_dict(data | {"limits": {}})


def hands(middle: np.ndarray, length: float, load: str, rng: np.random.Generator) -> np.ndarray:
    """Return both end effectors of a randomly rotated payload [m]. Array, shape (2, 3)."""
    way = rng.normal(size=3)
    if load == "tray":
        way[2] = 0.0
    way *= 0.5 * length / np.linalg.norm(way)
    return np.stack([middle - way, middle + way])


def obstacles_of(path: Path) -> list[dict[str, Any]]:
    """Return the obstacles of a MoveIt planning scene."""
    world = yaml.safe_load(path.read_text())["world"]["collision_objects"]
    found = []
    for thing in world:
        base, turn = pose(thing["pose"]) if "pose" in thing else (np.zeros(3), np.eye(3))
        for kind, place in zip(thing["primitives"], thing["primitive_poses"], strict=True):
            center, rotation = pose(place)
            obstacle = {"center": (base + turn @ center).tolist(), "quaternion_wxyz": wxyz(turn @ rotation)}
            size = kind["dimensions"]
            if kind["type"] == "box":
                found.append({"shape": "box", "size": size, **obstacle})
            elif kind["type"] == "cylinder":
                found.append({"shape": "cylinder", "height": size[0], "radius": size[1], **obstacle})
            else:
                found.append({"shape": "sphere", "center": obstacle["center"], "radius": size[0]})
    return found


def pose(place: dict[str, list[float]]) -> tuple[np.ndarray, np.ndarray]:
    """Return position [m] and rotation matrix of a pose."""
    x, y, z, w = np.array(place["orientation"]) / np.linalg.norm(place["orientation"])
    matrix = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(place["position"], dtype=float), np.array(matrix)


def wxyz(matrix: np.ndarray) -> list[float]:
    """Return the unit quaternion of a rotation (Bar-Itzhack, 2000). It is the eigenvector of a symmetric 4 x 4
    matrix."""
    m = matrix
    square = np.array(
        [
            [m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
            [m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], m[1, 2] + m[2, 1]],
            [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1]],
        ]
    )
    return np.linalg.eigh(square)[1][:, -1].tolist()


def hull(obstacle: dict[str, Any]) -> list[list[float]]:
    """Return two corners of a box contained in an obstacle [m]."""
    center = np.array(obstacle["center"])
    reach = max(np.min(obstacle.get("size", [0.02])) / 2, 0.02)
    return [(center - reach).tolist(), (center + reach).tolist()]


if __name__ == "__main__":
    main()
