"""`comove verify`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from comove.cli import options as o
from comove.cli.app import NOT_VERIFIED, VERIFIED, verb
from comove.errors import OptionError

if TYPE_CHECKING:
    from comove.robots import JointVerdict
    from comove.scenes import Scene


@verb
def verify(
    scene: o.SceneFile,
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Result folder.")],
    robot: Annotated[
        str | None,
        typer.Option(
            help="The robot whose joint motion it is: a bundled one's name, or a description (YAML); what SCENE says "
            "unless given."
        ),
    ] = None,
    *,
    limits: o.SceneLimits,
) -> int:
    """Judge a saved result anew, from the files alone."""
    from comove.cli.progress import progress_bar
    from comove.cli.texts import in_rows, joints_text
    from comove.results import changes_to, filled_in, read_result, verify_result
    from comove.results.words import motion_rows
    from comove.scenes import Scene

    with progress_bar():
        stored = read_result(folder)
        loaded = filled_in(Scene.load(scene, limits.changes), stored)
        verdict = verify_result(stored, loaded)
        joints = _joints_verdict(folder, loaded, scene, robot)
    reasons = (*verdict.reasons, *(joints.reasons if joints is not None else ()))
    if reasons:
        print(f"{folder}: rejected", file=sys.stderr)
        for reason in dict.fromkeys(reasons):
            print(f"  - {reason}", file=sys.stderr)
        if changed := changes_to(loaded, stored, scene):
            options = " ".join(f"--{key} {value}" for key, value in changed.items())
            print(f"  it was solved with {options}: give that again", file=sys.stderr)
        return NOT_VERIFIED
    print(f"{folder}: verified")
    rows = motion_rows({**verdict.report.asdict(), "duration": loaded.duration}, loaded)
    print(*in_rows(rows), sep="\n")
    if joints is not None and joints.verified is not None:
        print(joints_text(joints.verified.robot.name, joints.report.asdict()))
    elif loaded.file.robot is not None:
        print("  the hands alone: the folder holds no motion of a robot's joints")
    return VERIFIED


def _joints_verdict(folder: Path, scene: Scene, file: Path, named: str | None) -> JointVerdict | None:
    """Return the verdict on a robot's motion, None if the folder holds none.

    The robot is the one that the command or the scene names. A folder may name only a bundled robot: a description of
    its own choice could allow anything.
    """
    if not (folder / "robot.json").exists() and not (folder / "joints.npz").exists():
        if named is not None:
            raise OptionError(
                "the folder holds no motion of a robot's joints",
                file=folder,
                key="--robot",
                way_out="leave it out, or name the folder of `comove robot solve`",
            )
        return None
    from comove.cli.robot import robot_named
    from comove.errors import RobotError
    from comove.robots import bundled_robots, read_joints, verify_stored

    if named is None and scene.file.robot is None:
        named = read_joints(folder).summary.get("robot_file")
        if named not in bundled_robots():
            raise RobotError(
                "neither the scene nor the command names a robot, and the folder's is no bundled one",
                file=file,
                key="robot",
                way_out="give its description by --robot FILE, once you have read it",
            )
    robot, _ = robot_named(named, scene, file)
    return verify_stored(folder, robot, scene=scene)
