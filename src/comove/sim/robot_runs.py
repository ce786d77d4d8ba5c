"""Stored online runs of robots, `robot_run.json` and `robot_run.npz`.

The arrays are, after every control step, `time` (n_steps,) [s], `commanded` and `measured` (n_steps, n_joints)
[rad], `nodes` (n_steps, n_nodes, 3), end effectors and corners of the payload as commanded [m], `load_pose`
(n_steps, 4, 4), the payload in the simulator, `driven_off` (n_steps,), whether the robot yielded to an external
displacement, and `obstacle_center` (n_steps, n_obstacles, 3) [m]. `scene.json` is the scene of the run. A real
robot's run has `braked` (n_steps,), whether its arms braked as a command was late; where `obstacles` is `measured` in
the summary, `obstacle_center` is where the obstacles were taken to be.

The verification uses joints and times of the run; it computes obstacles that were not measured from the scene, end
effectors from the joints, and the payload from the end effectors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from comove._version import __version__
from comove.arrays import Array
from comove.errors import ResultError, shortened
from comove.model.files.keys import canonical
from comove.model.scene import Scene
from comove.results.reference import SCENE
from comove.results.sealed import (
    COUNT,
    FITS,
    NUMBER,
    SAME,
    TEXT,
    TEXTS,
    TRUTH,
    Arrays,
    ResultKind,
    Stored,
    Summary,
    finite,
    require_types,
)
from comove.robots.files import source_of
from comove.robots.model import Robot
from comove.sim.live_record import OnlineRecord, OnlineReport, judge_run
from comove.sim.loads import are_poses, carried, hand_poses, load_of, points_of

if TYPE_CHECKING:
    from comove.control.loop import ExecutionLog
    from comove.robots.online.executor import JointRecord
    from comove.robots.online.streamed import StreamedRun

LOST = 0.5  # rad, difference of measured and commanded joints from which on a robot counts as driven off
HELD, PLACED = 5e-3, 2e-2  # m, by which a load may move in the hands, and be off its place when it is grasped
MEASURED = (
    "measured"  # obstacles of a run, which are where they were taken to be; else where the scene has them
)
ARRIVED, AT_REST = 1e-3, 5e-3  # m and m/s, of commanded hands at the end

_TYPES = (
    dict.fromkeys(("as_it_should_be", "arrived", "interrupted"), TRUTH)
    | dict.fromkeys(("scene", "scene_sha256", "robot", "robot_sha256", "version"), TEXT)
    | {"without_gripper": TEXTS.or_nothing}
    | {"reasons": TEXTS, "duration_s": NUMBER, "period_s": NUMBER, "seed": COUNT}
)

ROBOT_RUN = ResultKind(
    summary="robot_run.json",
    arrays="robot_run.npz",
    checksum="motion_sha256",
    made_by="comove run SCENE --out DIR",
    hint="run it again",
    required=("time", "commanded", "measured", "nodes", "load_pose", "driven_off", "obstacle_center"),
    optional=("braked",),
    unsealed=("planning_s", "control_s_median", "control_s_p999", "wall_time_s"),
    require_entries=lambda summary, file: require_types(summary, _TYPES, file),
)


def write_robot_run(
    folder: Path,
    record: OnlineRecord,
    report: OnlineReport,
    log: ExecutionLog,
    *,
    seed: int,
    wall_time_s: float,
    source: str | Path | None = None,
    more: Mapping[str, Any] | None = None,
) -> Summary:
    """Write both files and the scene; return the summary.

    Parameters
    ----------
    more : further entries of the summary
    source : the robot's description: the name of a bundled one or a path; that of the scene unless given
    """
    (folder / SCENE).write_bytes(canonical(record.scene.file) + b"\n")
    measures = {
        name: finite(value) if isinstance(value, float) else value for name, value in vars(report).items()
    }
    del measures["reasons"]
    summary = {
        "as_it_should_be": not report.reasons,
        "arrived": record.arrived,
        "interrupted": record.interrupted,
        "reasons": list(report.reasons),
        "scene": record.scene.name,
        "scene_sha256": record.scene.sha256,
        "robot": record.robot.name,
        "robot_file": source_of(record.robot, record.scene, source),
        "robot_sha256": record.robot.sha256,
        "seed": seed,
        "version": __version__,
        "period_s": record.period,
        **measures,
        "stopped_steps": log.stopped,
        "contacts": [asdict(contact) for contact in record.contacts],
        "planning_s": [float(seconds) for seconds in log.planning],
        "wall_time_s": wall_time_s,
        "blocking": {str(obstacle): steps for obstacle, steps in sorted(log.blocking.items())},
        **log.summary,
        **(more or {}),
    }
    arrays = {
        "time": np.array(record.time),
        "commanded": np.array(record.commanded),
        "measured": np.array(record.measured),
        "nodes": np.array(record.nodes),
        "load_pose": np.array(record.load),
        "driven_off": np.array(record.driven_off),
        "obstacle_center": np.array(record.obstacles),
    }
    if record.braked:
        arrays["braked"] = np.array(record.braked)
    return ROBOT_RUN.write(folder, summary, arrays)


def read_robot_run(folder: str | Path) -> Stored:
    """Read the folder of a robot's online run without verification.

    Raises
    ------
    ResultError
        If a file is missing, incomplete or unreadable.
    """
    return Stored(Path(folder), *ROBOT_RUN.read(folder))


def verify_robot_run(stored: Stored, scene: Scene, robot: Robot) -> tuple[OnlineRecord, OnlineReport]:
    """Verify a stored online run from its joints and times alone.

    Clearances are those at samples, as `judge_run` measures them.

    Raises
    ------
    ResultError
        If the arrays do not belong to the scene and the robot, or are no numbers.
    """
    arrays, summary = stored.arrays, stored.summary
    _require_shapes(stored, scene, robot)
    time = arrays["time"]
    moved = scene.centers_at(time)
    if summary.get("obstacles") == MEASURED:
        moved[:, scene.moving] = arrays["obstacle_center"][:, scene.moving]
    record = OnlineRecord(
        scene,
        robot,
        list(time),
        list(arrays["commanded"]),
        list(arrays["measured"]),
        list(arrays["nodes"]),
        list(arrays["load_pose"]),
        list(arrays["driven_off"]),
        list(moved),
        list(arrays.get("braked", ())),
        arrived=_has_arrived(scene, arrays),
        interrupted=summary.get("interrupted") is not False,
    )
    report = judge_run(record)
    reasons = [*report.reasons, *_impossible(record, arrays, moved)]
    reasons += ROBOT_RUN.broken_seals(summary, arrays)
    for key, right in (("scene_sha256", scene.sha256), ("robot_sha256", robot.sha256)):
        if summary.get(key) != right:
            reasons.append(f"the {key[:5]} is not the one that was run: its checksum differs")
    reasons += ROBOT_RUN.mistyped(summary)
    if summary.get("as_it_should_be") is not True:
        reasons.append(f"{ROBOT_RUN.summary} does not claim that the run is as it should be")
    elif not reasons:
        reasons += _misstated(summary, report, record)
    return record, replace(report, reasons=tuple(reasons))


def streamed(run: StreamedRun) -> OnlineRecord:
    """Return the record of a real robot's run. The payload is where measured end effectors carry it."""
    n_steps, scene, robot = len(run.commanded), run.scene, run.robot
    load = load_of(scene, hand_poses(robot, scene, run.commanded[:1])[0])
    poses = np.full((n_steps, 4, 4), np.nan)
    if load is not None:
        begin, held = (
            hand_poses(robot, scene, q)[:, list(load.holders)] for q in (run.commanded[:1], run.measured)
        )
        poses = carried(held, np.linalg.inv(begin[0]) @ load.pose)
    return OnlineRecord(
        scene,
        robot,
        list(run.period * np.arange(1, n_steps + 1)),
        list(run.commanded),
        list(run.measured),
        list(run.nodes),
        list(poses),
        [False] * n_steps,
        list(run.obstacles),
        list(~run.held),
        arrived=run.arrived,
        interrupted=run.interrupted,
        given_up=run.given_up,
    )


def followed(record: JointRecord) -> OnlineRecord:
    """Return an unsimulated run's record, with joints exactly as commanded."""
    joints, n_steps = record.joints[1:], len(record.time) - 1
    held = hand_poses(record.robot, record.scene, record.joints)
    load = load_of(record.scene, held[0])
    poses = np.full((n_steps, 4, 4), np.nan)
    if load is not None:
        held = held[:, list(load.holders)]
        poses = carried(held, np.linalg.inv(held[0]) @ load.pose)[1:]
    return OnlineRecord(
        record.scene,
        record.robot,
        list(record.time[1:]),
        list(joints),
        list(joints),
        list(record.nodes[1:]),
        list(poses),
        [False] * n_steps,
        list(record.obstacles[1:]),
        arrived=_has_arrived(record.scene, {"nodes": record.nodes, "time": record.time}),
    )


def _require_shapes(stored: Stored, scene: Scene, robot: Robot) -> None:
    arrays, n = stored.arrays, stored.arrays["time"].size
    n_joints = len(robot.joint_names)
    shapes = {
        "time": (n,),
        "commanded": (n, n_joints),
        "measured": (n, n_joints),
        "nodes": (n, scene.body.n_nodes, 3),
        "load_pose": (n, 4, 4),
        "driven_off": (n,),
        "obstacle_center": (n, len(scene.motions), 3),
    }
    truths: tuple[str, ...] = ("driven_off",)
    loose = ("load_pose",) if scene.file.load is None else ()
    if "braked" in arrays:
        shapes["braked"], truths = (n,), (*truths, "braked")
    ROBOT_RUN.require_shapes(arrays, shapes, stored.folder, loose=loose, truths=truths)
    if not (np.diff(arrays["time"], prepend=0.0) > 0).all():
        raise ResultError(
            "the times do not increase",
            file=stored.folder / ROBOT_RUN.arrays,
            key="time",
            way_out=ROBOT_RUN.hint,
        )


def _has_arrived(scene: Scene, arrays: Arrays) -> bool:
    hands = arrays["nodes"][-2:, : len(scene.manipulators), : scene.n_dims]
    speed = np.linalg.norm(np.diff(hands, axis=0)[0], axis=1).max() / np.diff(arrays["time"])[-1]
    off = np.linalg.norm(hands[-1] - scene.goal, axis=1).max()
    return bool(off <= ARRIVED + FITS and speed <= AT_REST)


def _impossible(record: OnlineRecord, arrays: Arrays, moved: Array) -> list[str]:
    """List the values that no run on the scene can have."""
    scene, time, reasons = record.scene, arrays["time"], []
    if not np.abs(time - record.period * np.arange(1, len(time) + 1)).max() <= FITS:
        reasons.append(f"the times in {ROBOT_RUN.arrays} are not evenly spaced from 0 s")
    apart = np.linalg.norm(arrays["obstacle_center"] - moved, axis=2).max(axis=0, initial=0.0)
    reasons += [
        f"{scene.name_of(int(i))} was, by the run's own record alone, {apart[i]:.3g} m from where the scene moves it"
        for i in np.flatnonzero(~(apart <= FITS))
    ]
    start = np.linalg.norm(
        arrays["nodes"][0, : len(scene.manipulators), : scene.n_dims] - scene.start, axis=1
    )
    if not start.max() <= ARRIVED:
        reasons.append(f"it begins {start.max():.3g} m from the start")
    lag = np.abs(arrays["commanded"] - arrays["measured"]).max(axis=1)
    off = arrays["driven_off"]
    began = np.flatnonzero(off & ~np.concatenate([[False], off[:-1]]))
    if (began == 0).any() or not (lag[began - 1] > LOST).all():
        reasons.append(f"{ROBOT_RUN.arrays} says that the robot was driven off where it was as commanded")
    if not (lag[~off] <= LOST + FITS).all():
        reasons.append(f"a joint is {lag[~off].max():.2g} rad from where it was commanded")
    return reasons + _unheld(record, arrays)


def _unheld(record: OnlineRecord, arrays: Arrays) -> list[str]:
    """List violations of the rigid grasp of the payload."""
    scene, reasons = record.scene, []
    for own, group in zip(scene.nodes_of_groups, scene.groups, strict=True):
        nodes = arrays["nodes"][:, own]
        right = np.linalg.norm(group.points[:, None] - group.points, axis=-1)
        apart = np.abs(np.linalg.norm(nodes[:, :, None] - nodes[:, None], axis=-1) - right).max()
        if not apart <= SAME:
            reasons.append(
                f"'nodes' in {ROBOT_RUN.arrays} is no rigid body: a distance is off by {apart:.2g} m"
            )
    measured = hand_poses(record.robot, scene, arrays["measured"])
    load = load_of(scene, hand_poses(record.robot, scene, arrays["commanded"][:1])[0])
    if load is None:
        return reasons
    poses, hands = arrays["load_pose"], measured[:, list(load.holders)]
    if not are_poses(poses):
        reasons.append(f"'load_pose' in {ROBOT_RUN.arrays} is no pose")
        return reasons
    held = carried(hands, np.linalg.inv(hands[0]) @ poses[0])
    off = np.linalg.norm(points_of(poses, load.grasps) - points_of(held, load.grasps), axis=-1).max()
    placed = np.linalg.norm(points_of(poses[0], load.grasps) - hands[0, :, :3, 3], axis=-1).max()
    if not (off <= HELD and placed <= PLACED):
        reasons.append(f"the load is up to {max(off, placed):.2g} m from where the measured hands hold it")
    return reasons


def _misstated(summary: Summary, report: OnlineReport, record: OnlineRecord) -> list[str]:
    """List the differences of the summary's measures from the run's."""
    right = {name: value for name, value in vars(report).items() if isinstance(value, float)}
    reasons = ROBOT_RUN.differences(summary, right)
    said: dict[str, Any] = {"scene": record.scene.name, "robot": record.robot.name, "arrived": record.arrived}
    reasons += [
        f"{ROBOT_RUN.summary} says {key} = {shortened(repr(summary.get(key)))}, it is {value!r}"
        for key, value in said.items()
        if summary.get(key) != value
    ]
    return reasons
