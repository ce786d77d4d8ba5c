"""Writing of a solution into a result folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from comove._version import __version__
from comove.model.motion import CoordinatedMotion
from comove.planning.objective import Objective
from comove.planning.objectives import OBJECTIVES, OwnFunctions, PaperCost
from comove.planning.objectives.own import name_of
from comove.planning.solution import Solution
from comove.results.sealed import SAME, Summary, finite
from comove.results.solution import SOLUTION, motion_arrays, smoothness_of
from comove.verification.measures import WEIGHTS

NAMES = {kind: name for name, kind in OBJECTIVES.items()}
RECOMPUTED = ("goal", "velocity", "obstacle")  # resemblance needs a movement that is not in the folder


def write_solution(solution: Solution, folder: Path, wall_time_s: float) -> Summary:
    """Write `solution.npz` and `solution.json`; return the summary.

    The folder exists. The summary says so where the scene names a robot and there is no joint motion.
    """
    summary = _summary_of(solution, wall_time_s)
    if solution.scene.file.robot is not None and solution.joints is None:
        summary["hands_alone"] = True
    return SOLUTION.write(folder, summary, motion_arrays(solution.attempt))


def _summary_of(solution: Solution, wall_time_s: float) -> Summary:
    """Return the contents of `solution.json`."""
    report, cost = solution.report, solution.cost
    terms = {name: getattr(cost, name) for name in WEIGHTS}
    return {
        "verified": solution.motion is not None,
        "interrupted": solution.interrupted,
        "timed_out": solution.timed_out,
        "reasons": list(solution.reasons),
        "scene": solution.scene.name,
        "duration": solution.scene.duration,
        "method": solution.method,
        "seed": solution.seed,
        "version": __version__,
        "cost": cost.total,
        "cost_terms": terms,
        "cost_weights": _weights_of(terms, solution.attempt),
        **{name: finite(value) for name, value in report.asdict().items()},
        "objective": _said_of(solution.objective),
        "demonstration": None if solution.followed is None else vars(solution.followed),
        **smoothness_of(solution.attempt),
        "evaluations": solution.effort.evaluations,
        "generations": solution.effort.generations,
        **({"log": dict(solution.log)} if solution.log else {}),
        "time_to_first_verified_s": solution.effort.first_verified,
        "wall_time_s": wall_time_s,
        "scene_sha256": solution.scene.sha256,
    }


def _said_of(objective: object) -> dict[str, Any]:
    if not isinstance(objective, OwnFunctions):
        return {"type": NAMES[type(objective)], **vars(objective)}
    function = None if objective.function is None else name_of(objective.function)
    return {"type": "own", "function": function, "constraints": [name_of(c) for c in objective.constraints]}


def _weights_of(terms: Mapping[str, float], motion: CoordinatedMotion) -> dict[str, float]:
    """Compute the weights of the terms of J that the motion determines. Where a term is 0, it is the usual weight."""
    weights = {}
    for name, unit in _unit_terms(motion).items():
        usual = WEIGHTS[name]
        weight = terms[name] / unit if unit > 0 else usual
        weights[name] = usual if abs(weight - usual) <= SAME * usual else float(f"{weight:.12g}")
    return weights


def _unit_terms(motion: CoordinatedMotion) -> dict[str, float]:
    cost = Objective(motion.scene, motion.coordinates, PaperCost(1.0, 1.0, 1.0)).cost(motion)
    return {name: getattr(cost, name) for name in RECOMPUTED}
