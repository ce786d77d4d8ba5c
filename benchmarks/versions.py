"""Runs of two versions, scene by scene.

    comove bench run DIR --out old.sqlite          with the one version
    comove bench run DIR --out new.sqlite          with the other
    python benchmarks/versions.py old.sqlite new.sqlite

By set and kind of scene: verified runs of each; then, over the scenes and seeds that both solve, the geometric means
and the worst of new over old: time to the first verified motion, time to one within 2 % of the better last cost
(where both come there), time of the whole search, last cost J, and squared jerk; and in how many the last cost is
lower or higher by 2 %. Times are processor times; run both at once, each on a core of its own.
"""

from __future__ import annotations

import argparse
import json
import sqlite3
from collections import defaultdict
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from timing import number, print_table

Run = dict[str, Any]
NEAR = 1.02
"""Cost relative to the better last one, from which on a search counts as converged."""
MEASURES = {
    "first": "first_verified",
    "near the best": "near",
    "whole": "seconds",
    "cost": "cost",
    "jerk": "jerk_ratio",
}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    options = parser.parse_args()
    old, new = read(options.old), read(options.new)
    groups = defaultdict[tuple[str, str], list[tuple[Run, Run]]](list)
    for key in sorted(old.keys() & new.keys()):
        folder, scene = key[:2]
        groups[folder, scene.rpartition("-")[0]].append((old[key], new[key]))
        groups[folder, "all"].append((old[key], new[key]))
    print_table(
        ["set", "scenes", "runs", "verified", *MEASURES, "cost 2 % lower, higher"],
        [row(group, pairs) for group, pairs in groups.items()],
    )
    if left := len(old.keys() ^ new.keys()):
        print(f"{left} runs are in one of the files alone")


def read(path: Path) -> dict[tuple[str, str, int], Run]:
    """Return the runs of a store by set, scene and seed."""
    with sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True) as store:
        store.row_factory = sqlite3.Row
        return {
            (one["set"], one["scene"], one["seed"]): dict(one) for one in store.execute("select * from runs")
        }


def row(group: tuple[str, str], pairs: list[tuple[Run, Run]]) -> list[str]:
    """Return a row of the table."""
    verified = [sum(pair[i]["status"] == "verified" for pair in pairs) for i in (0, 1)]
    both = [pair for pair in pairs if all(one["status"] == "verified" for one in pair)]
    for pair in both:
        best = min(one["cost"] for one in pair)
        for one in pair:
            one["near"] = min(
                (time for time, cost in json.loads(one["history"]) if cost <= NEAR * best), default=inf
            )
    costs = [new["cost"] / old["cost"] for old, new in both]
    changed = f"{sum(cost < 1 / NEAR for cost in costs)}, {sum(cost > NEAR for cost in costs)}"
    return [
        *group,
        str(len(pairs)),
        f"{verified[0]}, {verified[1]}",
        *(ratio(both, key) for key in MEASURES.values()),
        changed,
    ]


def ratio(pairs: list[tuple[Run, Run]], key: str) -> str:
    """Return the geometric mean of new over old, and the largest."""
    ratios = [new[key] / old[key] for old, new in pairs if 0 < old[key] < inf and 0 < new[key] < inf]
    return f"{number(float(np.exp(np.mean(np.log(ratios)))))} ({number(max(ratios))})" if ratios else "-"


if __name__ == "__main__":
    main()
