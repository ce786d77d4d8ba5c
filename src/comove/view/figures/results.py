"""Result folders of solutions, with pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from comove.model.files.keys import canonical
from comove.planning import Solution
from comove.results import write_solution
from comove.results.inputs import Words, write_inputs
from comove.results.reference import SCENE
from comove.view.figures.pictures import Pictures, drawn


def save_result(
    solution: Solution,
    folder: Path,
    *,
    wall_time_s: float,
    demonstration: Any = None,
    source: str | Path | None = None,
    command: Words = (),
    made: Mapping[Path, bytes] = MappingProxyType({}),
    pictures: bool = True,
) -> dict[str, Any]:
    """Write a solution, its scene, inputs and pictures into a folder. Of a robot's solution, the files and the
    picture of its joint motion are written as well.

    Parameters
    ----------
    wall_time_s : total time for the summary [s]
    demonstration : movement that is drawn beside the motion
    source : name or path of the description of its robot; that of the scene unless given
    command, made : as in `comove.results.inputs.write_inputs`
    pictures : whether pictures are drawn

    Returns
    -------
    dict, the contents of solution.json
    """
    scene, joints = solution.scene, solution.joints
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
            solution.attempt,
            source=source,
            present=joints.present,
        )
    if pictures:
        for name, picture in drawn(Pictures.of(solution, demonstration)).items():
            (folder / name).write_bytes(picture)
    return summary
