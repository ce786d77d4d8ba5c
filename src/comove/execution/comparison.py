"""One scene, every way to deal with its moving obstacles, one judge (the counterpart of the paper's Figure 2).

All have the same start, goal and obstacles, and `comove.verification.record.judge` judges what came of it. Hands that
nothing holds together are judged where they are, straight from step to step; the load is what lies between them, its
corners where the pose that fits the hands best puts them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove._version import __version__
from comove.execution.executor import Executor, Pace
from comove.execution.modulated import run_modulated
from comove.execution.sight import Functions, Known
from comove.planning.search import Interruption
from comove.reaction.modulation import Sharing
from comove.reaction.twists import poses_of
from comove.scenes.scene import Scene
from comove.verification.record import PairConstraint, Record, RecordReport, judge

Array = NDArray[np.float64]

MODULATED = {
    "no modulation": (Sharing.NONE, True),
    "own matrix each": (Sharing.OWN, True),
    "nearest hand's matrix": (Sharing.SAME, False),
    "same matrix on all": (Sharing.SAME, True),
}
SEEN, KNOWN = "obstacles seen only", "motions known"
METHODS = (*MODULATED, SEEN, KNOWN)
"""What is compared: the primitive as it is; modulations, by a matrix each, by that of the hand that is nearest to an
obstacle (the paper's rule), by that of the nearest point of hands and load; and the executor twice."""


@dataclass(frozen=True, eq=False)
class LooseRecord(Record):
    """What happened to hands that nothing holds together.

    Attributes
    ----------
    hands : array, shape (n_steps, n_manipulators, 3), [m]
    """

    hands: Array

    @cached_property
    def nodes(self) -> Array:
        """Hands where they are, corners of the load where the pose that fits them best puts them."""
        nodes = super().nodes.copy()
        nodes[:, : self.hands.shape[1]] = self.hands
        return nodes

    def holds(self, c: PairConstraint) -> bool:
        """Nothing holds them."""
        return False

    @cached_property
    def spins(self) -> Array:
        """None: nothing turns between two steps, hands go straight."""
        return np.zeros((len(self.time) - 1, len(self.scene.groups), 3))


@dataclass(frozen=True, eq=False)
class Compared:
    """What one method made of a scene.

    Attributes
    ----------
    method : its name, one of `METHODS`
    record : what happened
    report : how it is judged
    """

    method: str
    record: Record
    report: RecordReport

    @property
    def ours(self) -> bool:
        """Whether it is this package's executor."""
        return self.method not in MODULATED

    @property
    def arrived(self) -> bool:
        """Whether the hands came to where they should."""
        return not any("goal is missed" in reason for reason in self.report.reasons)

    @cached_property
    def distance_errors(self) -> Array:
        """Largest error of a fixed distance; array, shape (n_steps,) [m]; 0 where nothing is fixed."""
        errors, nodes = np.zeros(len(self.record.time)), self.record.nodes
        for c in self.record.scene.distances:
            apart = np.linalg.norm(nodes[:, c.first] - nodes[:, c.second], axis=1)
            errors = np.maximum(errors, np.abs(apart - c.distance))
        return errors

    @cached_property
    def clearances(self) -> Array:
        """Of load and hands from everything, at every step; array, shape (n_steps,) [m]."""
        record = self.record
        steps = zip(np.ascontiguousarray(record.nodes), record.time, strict=True)
        return np.array([record.scene.clearance_at(nodes, float(time))[0] for nodes, time in steps])

    @property
    def off(self) -> NDArray[np.bool_]:
        """At which steps a distance is off by more than its tolerance; array, shape (n_steps,)."""
        return self.distance_errors > max((c.tolerance for c in self.record.scene.distances), default=np.inf)

    @property
    def touching(self) -> NDArray[np.bool_]:
        """At which steps the load or a hand is in something; array, shape (n_steps,)."""
        return self.clearances < 0.0


def compare(
    record: Record, budget: float, *, seed: int = 0, pace: Pace | None = None
) -> tuple[list[Compared], bool]:
    """Do with every other method what an executor with known motions has done, and judge all alike.

    Parameters
    ----------
    record : of that executor
    budget : simulated time that each of the others may take [s]
    seed, pace : of executors

    Returns
    -------
    compared : in the order of `METHODS`
    interrupted : whether Ctrl-C has ended it early; then some are missing
    """
    scene, pace, interruption = record.scene, pace or Pace(), Interruption()
    runs: dict[str, Callable[[], Record]] = {
        name: lambda how=how: loose_run(scene, how[0], budget, pace.period, load=how[1])
        for name, how in MODULATED.items()
    }
    runs[SEEN] = lambda: Executor(scene, Functions.of_motions(scene), seed=seed, pace=pace).run(budget)
    runs[KNOWN] = lambda: record
    compared: list[Compared] = []
    with interruption.noticed():
        for method, run in runs.items():
            if not interruption.wished:
                made = _among_known(run())
                compared.append(Compared(method, made, judge(made)))
    return compared, interruption.wished


def write_comparison(folder: Path, compared: list[Compared], *, seed: int) -> dict[str, Any]:
    """Write `comparison.json` into an existing folder; returns what it holds."""
    scene = compared[0].record.scene
    summary = {
        "scene": scene.name,
        "scene_sha256": scene.sha256,
        "version": __version__,
        "seed": seed,
        "clearance_wanted": scene.clearance,
        "methods": [_row(c) for c in compared],
    }
    text = json.dumps(summary, indent=2, allow_nan=False)
    (folder / "comparison.json").write_text(text + "\n", encoding="utf-8")
    return summary


def _row(compared: Compared) -> dict[str, Any]:
    r, scene = compared.report, compared.record.scene
    return {
        "method": compared.method,
        "verified": not r.reasons,
        "arrived": compared.arrived,
        "contact": r.clearance_min < 0.0,
        "distance_error_max": r.distance_error_max,
        "clearance_min": r.clearance_min if math.isfinite(r.clearance_min) else None,
        "end_error": r.end_error,
        "duration_s": float(compared.record.time[-1]),
        "speed_share_max": r.speed_max / scene.speed_limit,
        "acceleration_share_max": r.acceleration_max / scene.acceleration_limit,
        "reasons": list(r.reasons),
    }


def loose_run(
    scene: Scene, sharing: Sharing, budget: float, period: float = 0.01, *, load: bool = True
) -> LooseRecord:
    """Follow the primitive with modulated velocities, see `run_modulated`, among obstacles as the file moves them."""
    time, hands = run_modulated(scene, Known(scene), sharing, budget, period, load=load)
    poses = [poses_of(scene, h) for h in hands]
    return LooseRecord(
        scene,
        time,
        np.array([p.center for p in poses]),
        np.array([p.quaternion for p in poses]),
        Known(scene).true(time),
        scene.obstacle_sags(time),
        np.concatenate([hands, np.zeros((*hands.shape[:2], 3 - scene.n_dims))], axis=2),
    )


def _among_known(record: Record) -> Record:
    """The record with its obstacles where the scene's file says: the same truth for all."""
    sag = record.scene.obstacle_sags(record.time)
    return replace(record, obstacles=Known(record.scene).true(record.time), sag=sag)
