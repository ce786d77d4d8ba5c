"""A solution as a result folder: its files, and the pictures of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from comove.planning import Solution, carried_demonstration
from comove.results import write_solution
from comove.results.inputs import Words, write_inputs
from comove.results.reference import SCENE
from comove.scenes.model import canonical
from comove.view.figures.motion import draw_motion, draw_progress
from comove.view.figures.robots import arm_lines, draw_joints
from comove.view.figures.style import save

if TYPE_CHECKING:  # robots are an extra
    from comove.robots import RobotSolution


def save_result(
    solution: Solution,
    folder: Path,
    *,
    wall_time_s: float,
    demonstration: Any = None,
    command: Words = (),
    files: Iterable[Path] = (),
    made: Mapping[Path, bytes] = MappingProxyType({}),
    has_joints: bool = False,
    arms: Sequence[NDArray[np.float64]] = (),
) -> dict[str, Any]:
    """Write a solution, its scene, what it was made from and its pictures into an existing folder.

    Parameters
    ----------
    wall_time_s : time that the summary states for all of it [s]
    demonstration : movement that is drawn beside the motion
    command, files, made : as of `comove.results.inputs.write_inputs`
    has_joints : as of `comove.results.write_solution`
    arms : as of `draw_motion`

    Returns
    -------
    dict, the contents of solution.json
    """
    scene, motion = solution.scene, solution.attempt
    title = scene.name if solution.verified else f"{scene.name} (not verified)"
    carried = None if demonstration is None else carried_demonstration(demonstration, scene)
    save(draw_motion(motion, title=title, demonstration=carried, arms=arms), folder / "motion.png")
    save(draw_progress(motion), folder / "progress.png")
    (folder / SCENE).write_bytes(canonical(scene.file) + b"\n")
    write_inputs(folder, scene, command=command, files=files, made=made)
    return write_solution(solution, folder, wall_time_s, has_joints=has_joints)


def arms_along(found: RobotSolution, n_states: int = 4) -> list[NDArray[np.float64]]:
    """Return the lines of a robot's arms at equal times, as `draw_motion` takes them."""
    joints = found.joints
    return arm_lines(found.robot, joints.at(np.linspace(0.0, joints.duration, n_states))[0])


def save_robot_result(
    found: RobotSolution,
    folder: Path,
    *,
    wall_time_s: float,
    demonstration: Any = None,
    source: str | Path | None = None,
    command: Words = (),
    made: Mapping[Path, bytes] = MappingProxyType({}),
) -> dict[str, Any]:
    """Write a robot's solution as `save_result` does, and the files and the picture of its joints' motion.

    Parameters
    ----------
    source : name or path of the robot's description; what the scene says unless given
    command, made : as of `save_result`
    """
    from comove.robots import write_joints

    solution = found.solution
    summary = save_result(
        solution,
        folder,
        wall_time_s=wall_time_s,
        demonstration=demonstration,
        command=command,
        files=found.robot.files,
        made=made,
        has_joints=True,
        arms=arms_along(found),
    )
    write_joints(
        folder,
        found.joints,
        found.verdict,
        found.robot,
        solution.attempt,
        source=source,
        present=found.present,
    )
    title = f"{solution.scene.name}, {found.robot.name}" + ("" if solution.verified else " (not verified)")
    save(draw_joints(found.robot, found.joints, title=title), folder / "joints.png")
    return summary
