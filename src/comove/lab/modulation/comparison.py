"""Comparison of all methods for moving obstacles on one scene.

It is the counterpart of the paper's Figure 2. All methods have the same start, goal and obstacles, and
`comove.verification.record` verifies their executions. End effectors that move independently are verified at their
own positions, straight from step to step; the payload is the line between them, and its corners are placed by the
pose that fits the end effectors best.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove._version import __version__
from comove.arrays import Array
from comove.control.executor import Executor
from comove.control.observers import Functions, Known
from comove.control.replanning import Pace
from comove.control.safety.twists import poses_of
from comove.geometry.distances import CENTER
from comove.lab.modulation.matrices import Sharing, modulated
from comove.lab.modulation.obstacles import axes_of, level_obstacle
from comove.lab.systems import distance_errors
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.model.shapes import spatial
from comove.planning.search import Interruption
from comove.verification.record import ExecutionReport, Record, verify_execution

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


@dataclass(frozen=True)
class FollowSettings:
    """Settings of end effectors that follow a primitive with modulated velocities.

    Attributes
    ----------
    gain : gain towards the primitive, and after its end the goal [1/s]
    n_points : points along every edge of the payload among which the nearest is chosen
    at_goal : distance from the goal at which end effectors have arrived [m]
    """

    gain: float = 2.0
    n_points: int = 13
    at_goal: float = 5e-4


FOLLOWING = FollowSettings()


@dataclass(frozen=True, eq=False)
class LooseRecord(Record):
    """Record of an execution with independent end effectors.

    Attributes
    ----------
    hands : array, shape (n_steps, n_manipulators, 3), positions of the end effectors [m]
    """

    hands: Array

    @cached_property
    def nodes(self) -> Array:
        """Return the end effectors, and the corners of the best-fitting payload."""
        nodes = super().nodes.copy()
        nodes[:, : self.hands.shape[1]] = self.hands
        return nodes

    def holds(self, hands: Sequence[int]) -> bool:
        """Return False, as no rigid body holds the end effectors together."""
        return False

    @cached_property
    def spins(self) -> Array:
        """Return zeros, as end effectors move straight between steps."""
        return np.zeros((len(self.time) - 1, len(self.scene.groups), 3))


@dataclass(frozen=True, eq=False)
class Compared:
    """Result of one method on a scene.

    Attributes
    ----------
    method : its name, one of `METHODS`
    record : record of its execution
    report : verification report on the record
    """

    method: str
    record: Record
    report: ExecutionReport

    @property
    def arrived(self) -> bool:
        """Return whether the end effectors reached their goal."""
        return not any("goal is missed" in reason for reason in self.report.reasons)

    @property
    def distance_error(self) -> float:
        """Return the bound of the largest error of a fixed distance [m]."""
        return self.report.distance_error_max

    @property
    def clearance(self) -> float:
        """Return the certified clearance of payload and end effectors [m]."""
        return self.report.clearance_min

    @property
    def tolerance(self) -> float:
        """Return the largest tolerance of a distance [m]; infinite where none is fixed."""
        return max((c.tolerance for c in self.record.scene.distances), default=np.inf)

    @cached_property
    def distance_errors(self) -> Array:
        """Return the largest error of a fixed distance, else 0 [m]. Array, shape (n_steps,)."""
        return distance_errors(self.record.scene, self.record.nodes)

    @cached_property
    def clearances(self) -> Array:
        """Return the clearance at every step; array, shape (n_steps,) [m]."""
        return self.record.scene.clearances(self.record.nodes, self.record.time)

    @property
    def off(self) -> NDArray[np.bool_]:
        """Return the steps with excessive distance errors; bool, shape (n_steps,)."""
        return self.distance_errors > self.tolerance

    @property
    def touching(self) -> NDArray[np.bool_]:
        """Return the steps with penetration of obstacles; bool, shape (n_steps,)."""
        return self.clearances < 0.0


def compare(
    record: Record, budget: float, *, seed: int = 0, pace: Pace | None = None
) -> tuple[list[Compared], bool]:
    """Run every other method on an executor's scene, and verify all. The motions of obstacles are known.

    Parameters
    ----------
    record : record of that executor
    budget : simulated time of each of the others [s]
    seed, pace : seed and pace of the executors

    Returns
    -------
    compared : in the order of `METHODS`
    interrupted : whether Ctrl-C has ended it early; then some are missing
    """
    scene, pace, interruption = record.scene, pace or Pace(), Interruption()
    runs: dict[str, Callable[[], Record]] = {
        name: partial(loose_run, scene, sharing, budget, pace.period, load=load)
        for name, (sharing, load) in MODULATED.items()
    }
    runs[SEEN] = lambda: Executor(scene, Functions.of_motions(scene), seed=seed, pace=pace).run(budget)
    runs[KNOWN] = lambda: record
    compared: list[Compared] = []
    with interruption.noticed():
        for method, run in runs.items():
            if not interruption.wished:
                made = _among_known(run())
                compared.append(Compared(method, made, verify_execution(made)))
    return compared, interruption.wished


def write_comparison(folder: Path, compared: list[Compared], *, seed: int) -> dict[str, Any]:
    """Write `comparison.json` into a folder; return its contents."""
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
    scene: Scene,
    sharing: Sharing,
    budget: float,
    period: float = 0.01,
    *,
    load: bool = True,
    settings: FollowSettings = FOLLOWING,
) -> LooseRecord:
    """Follow the primitive with modulated velocities (paper, III-B).

    Return the record. Each end effector follows the coordinated primitive from start to goal and is drawn back to it
    once an obstacle has passed; the end effectors' distances are kept only as far as their velocities are equal.
    Obstacles move as the scene's file says.

    Parameters
    ----------
    sharing : assignment of modulation matrices to points; `Sharing.NONE` follows the primitive unchanged
    budget : largest simulated time [s]
    period : control period [s]
    load : whether points of the payload are modulated as well, not the end effectors alone
    settings : settings of the following
    """
    n, observer = scene.n_dims, Known(scene)
    radius = float(scene.body.radii.max(initial=0.0)) + scene.clearance
    bare = [level_obstacle(scene, j, margin=radius) for j in range(len(scene.motions))]
    pairs = [e for e in scene.body.edges if e[0] != e[1] and e.max() < len(scene.manipulators)]
    share = np.linspace(0.0, 1.0, settings.n_points)[1:-1, None]
    motion, steps = CoordinatedMotion.straight(scene), [scene.start.copy()]
    for k in range(round(budget / period)):
        now, at = k * period, steps[-1]
        wanted = _wanted(motion, now, at, settings.gain)
        seen = observer.observe(now)
        around = [
            replace(
                o,
                center=row[CENTER : CENTER + n],
                rotation=axes_of(row, n),
                velocity=v[:n],
                angular_velocity=w[2:] if n == 2 else w,
            )
            for o, row, v, w in zip(bare, seen.table, seen.velocity, seen.spin, strict=True)
        ]
        points, velocities = at, wanted
        for a, b in pairs if load else ():
            points = np.concatenate([points, at[a] + share * (at[b] - at[a])])
            velocities = np.concatenate([velocities, wanted[a] + share * (wanted[b] - wanted[a])])
        steps.append(at + period * modulated(points, velocities, around, sharing=sharing)[: len(at)])
        if now > scene.duration and np.linalg.norm(steps[-1] - scene.goal, axis=1).max() < settings.at_goal:
            break
    time = period * np.arange(len(steps), dtype=float)
    hands = np.array(steps)
    poses = [poses_of(scene, h) for h in hands]
    return LooseRecord(
        scene,
        time,
        np.array([p.center for p in poses]),
        np.array([p.quaternion for p in poses]),
        observer.ground_truth(time),
        scene.obstacle_sagittas(time),
        spatial(hands),
    )


def _wanted(motion: CoordinatedMotion, now: float, hands: Array, gain: float) -> Array:
    """Return velocities along and towards the primitive, within the limit [m/s]."""
    scene, s = motion.scene, np.array([now / motion.scene.duration])
    target, slope = motion.hands(s)[:2, 0] if s[0] < 1.0 else (scene.goal, np.zeros_like(hands))
    wanted = slope / scene.duration + gain * (target - hands)
    fastest = float(np.linalg.norm(wanted, axis=1).max())
    return wanted * min(1.0, scene.speed_limit / max(fastest, 1e-12))


def _among_known(record: Record) -> Record:
    """Return the record with obstacles as in the scene's file. So all methods have the same ground truth."""
    sagitta = record.scene.obstacle_sagittas(record.time)
    return replace(record, obstacles=Known(record.scene).ground_truth(record.time), sagitta=sagitta)
