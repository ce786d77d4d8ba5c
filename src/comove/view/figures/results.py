"""A solution as a result folder: its files, and the pictures of it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from comove.model.files.keys import canonical
from comove.planning import Solution, carried_demonstration
from comove.results import write_solution
from comove.results.inputs import Words, write_inputs
from comove.results.reference import SCENE
from comove.view.figures.motion import draw_motion, draw_progress
from comove.view.figures.robots import arm_lines, draw_joints
from comove.view.figures.style import save

if TYPE_CHECKING:  # robots are an extra
    from comove.robots import JointSolution


def save_result(
    solution: Solution,
    folder: Path,
    *,
    wall_time_s: float,
    demonstration: Any = None,
    source: str | Path | None = None,
    command: Words = (),
    made: Mapping[Path, bytes] = MappingProxyType({}),
) -> dict[str, Any]:
    """Write a solution, its scene, what it was made from and its pictures into an existing folder.

    Of a robot's solution, the files and the picture of its joints' motion are written as well.

    Parameters
    ----------
    wall_time_s : time that the summary states for all of it [s]
    demonstration : movement that is drawn beside the motion
    source : name or path of the description of its robot; what the scene says unless given
    command, made : as of `comove.results.inputs.write_inputs`

    Returns
    -------
    dict, the contents of solution.json
    """
    scene, motion, joints = solution.scene, solution.attempt, solution.joints
    title = scene.name if solution.verified else f"{scene.name} (not verified)"
    carried = None if demonstration is None else carried_demonstration(demonstration, scene)
    arms = arms_along(joints)
    save(draw_motion(motion, title=title, demonstration=carried, arms=arms), folder / "motion.png")
    save(draw_progress(motion), folder / "progress.png")
    (folder / SCENE).write_bytes(canonical(scene.file) + b"\n")
    files = () if joints is None else joints.robot.files
    write_inputs(folder, scene, command=command, files=files, made=made)
    summary = write_solution(solution, folder, wall_time_s)
    if joints is not None:
        from comove.robots import write_joints

        write_joints(
            folder,
            joints.attempt,
            joints.verdict,
            joints.robot,
            motion,
            source=source,
            present=joints.present,
        )
        title = f"{scene.name}, {joints.robot.name}" + ("" if solution.verified else " (not verified)")
        save(draw_joints(joints.robot, joints.attempt, title=title), folder / "joints.png")
    return summary


def arms_along(joints: JointSolution | None, n_states: int = 4) -> list[NDArray[np.float64]]:
    """Return the lines of a robot's arms at equal times, as `draw_motion` takes them; none without a robot."""
    if joints is None:
        return []
    motion = joints.attempt
    return arm_lines(joints.robot, motion.at(np.linspace(0.0, motion.duration, n_states))[0])
