"""Simulations in a result folder: `simulation.json`, `simulation.npz` and pictures."""

from __future__ import annotations

from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from comove._version import __version__
from comove.errors import OptionError, ResultError
from comove.model.scene import Scene
from comove.results.sealed import (
    FITS,
    MAPPING,
    NUMBER,
    SAME,
    TEXT,
    TEXTS,
    TRUTH,
    Arrays,
    ResultKind,
    Summary,
    checksum,
    finite,
    require_types,
)
from comove.robots.model import Robot
from comove.robots.motion import JointMotion
from comove.robots.verification.checks import without_gripper
from comove.sim.execution import Conditions, Contact, Execution, contacts_at
from comove.sim.grasps import GRASPS
from comove.sim.loads import are_poses, hand_poses, load_of
from comove.sim.settings import USUAL, Perturbation

TOOLS = ("mujoco", "pin", "numpy")
PLACED = 2e-2  # m, by which a load may be off its place when it is grasped
DEEP = 1e-3  # m, from which on bodies count as inside each other: shapes of simulators are simplified
LOOKS = 200  # samples at which it is looked what touches
PLANNED = ("commanded", "hands_planned")  # series that follow from the motion


def _require_entries(summary: Summary, file: Path) -> None:
    """Refuse a summary with entries of wrong types."""
    types = {"delivered": TRUTH, "reasons": TEXTS, "scene": TEXT, "robot": TEXT, "grasp": MAPPING}
    types["without_gripper"] = TEXTS.or_nothing
    for name in (
        "end_error",
        "distance_error_max",
        "lag_max",
        "slip_max",
        "internal_force_max",
        "torque_share_max",
    ):
        types[name] = NUMBER.or_nothing
    require_types(summary, types, file)
    require_types(summary["grasp"], {"kind": TEXT}, file, "grasp.")


SIMULATION = ResultKind(
    summary="simulation.json",
    arrays="simulation.npz",
    checksum="series_sha256",
    made_by="comove simulate DIR",
    hint="simulate it again",
    required=(
        "time",
        "commanded",
        "joints",
        "torque",
        "hands",
        "hands_planned",
        "load_pose",
        "wrench",
        "lag",
    ),
    optional=("fingers", "distance_error", "slip", "internal", "squeeze"),
    unsealed=("steps_per_second",),
    require_entries=_require_entries,
    outdated=("simulation.png", "simulation.mp4", "simulation.gif"),  # the last where nothing encodes films
)


def write_simulation(execution: Execution, folder: str | Path, *, seed: int | None = None) -> Summary:
    """Write an execution into an existing folder; return the summary. Pictures of an earlier simulation are removed.

    Parameters
    ----------
    seed : seed of the perturbation

    Raises
    ------
    ResultError
        If the folder cannot be written.
    """
    return SIMULATION.write(Path(folder), _summary_of(execution, seed), execution.series())


def _summary_of(execution: Execution, seed: int | None) -> Summary:
    """Return the contents of simulation.json."""
    motion, conditions = execution.motion, execution.conditions
    return {
        "delivered": execution.delivered,
        "reasons": list(execution.reasons),
        "simulator": conditions.simulator,
        "grasp": {"kind": type(conditions.grasp).__name__.lower(), **vars(conditions.grasp)},
        **{name: finite(value) for name, value in execution.measures.items()},
        "without_gripper": list(without_gripper(execution.robot)),
        "contacts": [asdict(contact) for contact in execution.contacts],
        "seed": seed,
        "perturbation": asdict(conditions.perturbation),
        "settings": asdict(conditions.settings),
        "scene": execution.scene.name,
        "scene_sha256": execution.scene.sha256,
        "robot": execution.robot.name,
        "robot_sha256": execution.robot.sha256,
        "motion_sha256": checksum({"time": motion.time, "position": motion.position}),
        "version": __version__,
        "versions": {tool: _version(tool) for tool in TOOLS},
        "steps_per_second": round(execution.steps_per_second),
    }


def _version(tool: str) -> str | None:
    try:
        return version(tool)
    except PackageNotFoundError:
        return None


def verify_simulation(
    summary: Summary, arrays: Arrays, robot: Robot, scene: Scene, motion: JointMotion
) -> list[str]:
    """List the reasons why a stored simulation is not valid.

    Simulated samples are taken from the arrays. End effectors, planned and at the measured joints, all derived
    quantities, the delivery by the usual limits, and contacts at samples are computed again.

    Parameters
    ----------
    summary, arrays : contents of simulation.json and simulation.npz
    robot, scene, motion : the simulated joint motion, verified again

    Raises
    ------
    ResultError
        If the arrays do not belong to the robot.
    """
    reasons = SIMULATION.broken_seals(summary, arrays) + SIMULATION.mistyped(summary)
    known = {
        "scene_sha256": (scene.sha256, "scene"),
        "robot_sha256": (robot.sha256, "robot"),
        "motion_sha256": (checksum({"time": motion.time, "position": motion.position}), "motion"),
    }
    reasons += [
        f"{SIMULATION.summary} is of another {what}: its checksum differs"
        for key, (right, what) in known.items()
        if summary.get(key) != right
    ]
    if reasons:
        return reasons
    execution = _restored(summary, arrays, robot, scene, motion)
    reasons = _impossible(execution, arrays)
    return reasons or _misstated(summary, execution)


def _restored(summary: Summary, arrays: Arrays, robot: Robot, scene: Scene, motion: JointMotion) -> Execution:
    """Return the stored execution, with the usual settings."""
    said = summary["grasp"]
    try:
        grasp = GRASPS[said["kind"]](**{key: value for key, value in said.items() if key != "kind"})
        start_error = tuple(float(x) for x in summary["perturbation"]["start_error"])
        perturbation = Perturbation(start_error=(start_error[0], start_error[1], start_error[2]))
        contacts = tuple(
            Contact((str(c["between"][0]), str(c["between"][1])), float(c["time"]), float(c["depth"]))
            for c in summary["contacts"]
        )
    except (KeyError, TypeError, ValueError, IndexError, OptionError) as error:
        raise ResultError(
            f"grasp, perturbation or contacts cannot be read: {error}",
            file=SIMULATION.summary,
            way_out=SIMULATION.hint,
        ) from error
    n, n_joints, n_hands = arrays["time"].size, len(robot.joint_names), len(scene.manipulators)
    load = load_of(scene, hand_poses(robot, scene, motion.position[:1])[0], grasp.section)
    n_holders = 0 if load is None else len(load.holders)
    shapes = {
        "time": (n,),
        **dict.fromkeys(("commanded", "joints", "torque"), (n, n_joints)),
        **dict.fromkeys(("hands", "hands_planned"), (n, n_hands, 4, 4)),
        "load_pose": (n, 4, 4),
        "wrench": (n, n_holders, 6),
    }
    SIMULATION.require_shapes(arrays, shapes, loose=("load_pose",) if load is None else ())
    series: dict[str, Any] = {name: arrays[name] for name in shapes if name not in PLANNED}
    return Execution(
        robot=robot,
        scene=scene,
        motion=motion,
        conditions=Conditions(str(summary["simulator"]), grasp, USUAL, perturbation),
        load=load,
        contacts=contacts,
        fingers=arrays.get("fingers", np.zeros((n, 0))),
        **series,
    )


def _impossible(execution: Execution, arrays: Arrays) -> list[str]:
    """List the values that no simulation of the motion can have."""
    motion, time = execution.motion, execution.time
    reasons, period = [], float(time[1] - time[0])
    if not (time[0] == 0.0 and np.abs(np.diff(time) - period).max() <= FITS and period > 0):
        reasons.append(f"the times in {SIMULATION.arrays} are not evenly spaced from 0 s")
    if not time[-1] >= motion.duration - FITS:
        reasons.append(f"{SIMULATION.arrays} ends before the motion does")
    right = {name: getattr(execution, name) for name in PLANNED}
    right["hands"] = hand_poses(execution.robot, execution.scene, execution.joints)
    for name, poses in right.items():
        if not np.abs(arrays[name] - poses).max() <= SAME:
            reasons.append(f"'{name}' in {SIMULATION.arrays} is not that of the motion and its joints")
    if np.linalg.norm(execution.conditions.perturbation.start_error) > PLACED:
        reasons.append(f"{SIMULATION.summary} says that the load began {PLACED:g} m or more from its place")
    if execution.load is not None and not are_poses(execution.load_pose):
        return [*reasons, f"'load_pose' in {SIMULATION.arrays} is no pose"]
    series = execution.series()
    for name in ("lag", "distance_error", "slip", "internal", "squeeze"):
        stated = arrays.get(name)
        off = stated is not None and stated.shape != series[name].shape
        if off or (stated is not None and stated.size and not np.allclose(stated, series[name], atol=1e-6)):
            reasons.append(f"'{name}' in {SIMULATION.arrays} is not what follows from the other series")
    return reasons + _untold(execution)


def _untold(execution: Execution) -> list[str]:
    """List the penetrations at samples that the contacts do not contain."""
    if execution.contacts:  # it was not delivered then
        return []
    found = contacts_at(execution, stride=max(1, len(execution.time) // LOOKS))
    return [
        f"{one} is {1e3 * contact.depth:.1f} mm inside {other} at {contact.time:.2f} s, of which "
        f"{SIMULATION.summary} tells nothing"
        for contact in found
        if contact.depth > DEEP
        for one, other in [contact.between]
    ]


def _misstated(summary: Summary, execution: Execution) -> list[str]:
    """List the differences of the summary from the series."""
    reasons = SIMULATION.differences(summary, execution.measures)
    if summary["delivered"] is not execution.delivered and summary["delivered"]:
        reasons += [f"{SIMULATION.summary} says delivered: {reason}" for reason in execution.reasons]
    if summary["delivered"] is not (not summary["reasons"]):
        reasons.append(f"{SIMULATION.summary} contradicts itself: delivered, and reasons why not")
    return reasons
