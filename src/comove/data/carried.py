"""Episodes of a robot: verified, simulated and stored joint motions."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np

from comove.arrays import Array
from comove.data.cameras import CamerasPart, videos_of
from comove.data.episode import (
    DAMAGED,
    OPTION,
    Made,
    measured,
    packed,
    sample_times,
    stored,
    timed_run,
    unpacked,
)
from comove.data.many import movement_of
from comove.data.runs import LONGEST, StoredCarry, StoredMotion, StudyRun
from comove.data.study_file import SimulationPart
from comove.errors import ResultError, SceneError
from comove.model.files.keys import canonical
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.planning import Budget, movements_of
from comove.planning.clock import now
from comove.planning.effort import NORMAL, EffortLevel
from comove.planning.method import Method
from comove.results.sealed import checksum, finite
from comove.robots import (
    JointMotion,
    Robot,
    RobotCarrier,
    VerifiedJointMotion,
    find_description,
    verify_joints,
)
from comove.sim import GRASPS, Execution, Perturbation, simulate
from comove.solving import solve
from comove.verification.verify import VerifiedMotion


def robot_of(scene: Scene) -> Robot:
    """Return the robot that a scene names, loaded once.

    Raises
    ------
    RobotError
        If there is none, or it cannot be loaded.
    """
    return robot_named(str(scene.file.robot), scene.folder)


def robot_named(name: str, folder: Path | None) -> Robot:
    """Return a bundled robot, or one described beside the scene. Errors are those of `robot_of`."""
    return _loaded(find_description(name, folder))


@lru_cache(maxsize=4)
def _loaded(path: Path) -> Robot:
    return Robot.load(path)


def require_hold(scene: Scene, still: float = 0.1) -> None:
    """Verify that the arms can hold the payload at start and goal. One of the scene's grasps must suffice.

    Parameters
    ----------
    still : time for which the robot has to stand at an end [s]
    """
    robot, first = robot_of(scene), None
    for choice in scene.alternatives:
        try:
            carrier = RobotCarrier(robot, choice.timed(still))
            _require_held(carrier, "start", carrier.starts)
            _require_held(carrier, "goal", carrier.goals)
            return
        except SceneError as error:
            first = first or error
    if first is not None:
        raise first


def _require_held(carrier: RobotCarrier, end: Literal["start", "goal"], branches: Sequence[Array]) -> None:
    """Refuse an end at which no inverse-kinematics solutions hold the payload."""
    robot, scene = carrier.robot, carrier.scene
    contents = json.loads(canonical(scene.file))
    for hand in contents["manipulators"]:
        hand["start"] = hand["goal"] = hand[end]
    if (load := contents["load"]).get(end) is not None:
        load["start"] = load["goal"] = load[end]
    motion = CoordinatedMotion.straight(Scene.from_dict(contents, folder=scene.folder))
    first = ""
    for joints in product(*branches):
        q = robot.home
        for arm, own in zip(carrier.holders, joints, strict=True):
            q[arm.columns] = own
        standing = JointMotion(np.array([0.0, scene.duration]), robot.joint_names, np.stack([q, q]))
        verdict = verify_joints(robot, motion, standing)
        if verdict.verified is not None:
            return
        first = first or verdict.reasons[0]
    raise SceneError(f"the robot cannot hold the load: {first}", key=scene.words.key(f"manipulators.{end}"))


@dataclass(frozen=True)
class Carrying:
    """Settings of a robot's transfer motions.

    Attributes
    ----------
    budget : processor time for the solution [s]
    method : method of the search; comove's own unless given
    simulation : settings of the simulation; None without one
    cameras : cameras of the simulation; None without pictures
    effort : effort for improving a verified motion
    """

    budget: float
    method: Method | None = None
    simulation: SimulationPart | None = None
    cameras: CamerasPart | None = None
    effort: EffortLevel = NORMAL


def carried_run(run: StudyRun, scene: Scene, how: Carrying) -> Made:
    """Solve a scene for its robot; return the row and the motion.

    The motion follows the demonstration that the scene names.

    Parameters
    ----------
    run : the row as far as it is known
    """

    def search(run: StudyRun) -> Made:
        movements, begun, firsts = movements_of(movement_of(scene), scene), now(), list[float]()
        found = solve(
            scene,
            robot=robot_of(scene),
            demonstration=movements,
            seed=run.seed,
            method=how.method,
            budget=Budget.of(how.budget, option=OPTION),
            effort=how.effort,
            found=lambda motion: firsts.append(now() - begun),
        )
        run = measured(run, found)
        if found.joints.motion is None:
            reasons = "; ".join(found.reasons or found.joints.verdict.reasons)
            return replace(run, status="not verified", reason=reasons[:LONGEST]), None
        run = replace(run, first=firsts[0] if firsts else run.first)
        motion = stored(run.key, found.attempt)
        return _simulated(run, motion, found.joints.motion, how)

    return timed_run(run, scene, search)


def _simulated(run: StudyRun, motion: StoredMotion, joints: VerifiedJointMotion, how: Carrying) -> Made:
    """Simulate verified joints if required; return the row and motion."""
    if how.simulation is None:
        return run, replace(motion, carry=_stored_carry(run.key, joints, None))
    execution = executed(joints, how.simulation, run.seed)
    motion = replace(motion, carry=_stored_carry(run.key, joints, execution))
    if not execution.delivered:
        return replace(run, status="not delivered", reason="; ".join(execution.reasons)[:LONGEST]), motion
    if how.cameras is not None:
        times = sample_times(joints.scene, how.cameras.rate)
        motion = replace(motion, videos=videos_of(execution, how.cameras, times))
    return run, motion


def executed(motion: VerifiedJointMotion, simulation: SimulationPart, seed: int) -> Execution:
    """Simulate a verified motion in MuJoCo. Where the settings say so, it is perturbed by the seed of its episode."""
    drawn = None
    if simulation.perturbed:  # numbers of their own: those of the seed alone have drawn the scene
        drawn = Perturbation.drawn(np.random.default_rng([seed, 1]), len(motion.robot.joint_names))
    return simulate(motion.joints, motion.scene, motion.robot, GRASPS[simulation.grasp](), drawn)


def _stored_carry(key: str, motion: VerifiedJointMotion, execution: Execution | None) -> StoredCarry:
    """Return joints, certificate and simulation measures for the run database."""
    simulated = {} if execution is None else {name: finite(x) for name, x in execution.measures.items()}
    return StoredCarry(
        key,
        packed(_arrays(motion.joints)),
        _json(figures_of(motion)),
        _json(simulated) if simulated else "",
    )


def figures_of(motion: VerifiedJointMotion) -> dict[str, Any]:
    """Return a joint motion's measures, and checksums of robot and joints."""
    return {
        **{name: finite(value) for name, value in motion.report.asdict().items()},
        "robot": motion.robot.name,
        "robot_sha256": motion.robot.sha256,
        "joints_sha256": checksum(_arrays(motion.joints)),
    }


def _arrays(joints: JointMotion) -> dict[str, Any]:
    return {"time": joints.time, "joint_names": np.array(joints.joint_names), "position": joints.position}


def _json(data: dict[str, Any]) -> str:
    return json.dumps(data, sort_keys=True, allow_nan=False)


def restored_carry(kept: StoredCarry, motion: VerifiedMotion, store: Path) -> VerifiedJointMotion:
    """Rebuild the joints in a run database, and verify them again.

    Parameters
    ----------
    motion : motion of the end effectors, verified again
    store : path of the run database, for messages

    Raises
    ------
    ResultError
        If they were damaged or fail the verification, or the robot was edited.
    RobotError
        If the robot cannot be loaded.
    """
    robot = robot_of(motion.motion.scene)
    try:
        arrays, certificate = unpacked(kept.joints), json.loads(kept.certificate)
        names = tuple(str(name) for name in arrays["joint_names"])
        joints = JointMotion(arrays["time"], names, arrays["position"])
        if checksum(arrays) != certificate["joints_sha256"]:
            raise ValueError("their checksum does not fit")
    except (ValueError, KeyError, TypeError, EOFError, OSError, zipfile.BadZipFile) as error:
        raise ResultError(
            f"the joints of the row '{kept.key[:12]}' cannot be rebuilt: {error}", file=store, way_out=DAMAGED
        ) from error
    if certificate.get("robot_sha256") != robot.sha256:
        raise ResultError(
            f"the robot '{robot.name}' is not the one that carried the row '{kept.key[:12]}': its description, "
            "models or meshes have changed",
            file=store,
            way_out="put its files back, or generate the episodes again in a new folder",
        )
    verdict = verify_joints(robot, motion, joints)
    if verdict.verified is None:
        raise ResultError(
            f"the joints of the row '{kept.key[:12]}' do not stand the check any more: {verdict.reasons[0]}",
            file=store,
            way_out=DAMAGED,
        )
    return verdict.verified
