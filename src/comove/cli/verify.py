"""`comove verify`."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import NOT_VERIFIED, VERIFIED, verb
from comove.cli.changes import Acceleration, Clearance, Duration, Jerk, Speed, changes_of
from comove.errors import OptionError

LIMITS = ("speed", "acceleration", "jerk", "clearance")


@verb
def verify(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file (YAML).")],
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Result folder.")],
    robot: Annotated[
        str | None,
        typer.Option(
            help="The robot whose joint motion it is: a bundled one's name, or a description (YAML); what SCENE says "
            "unless given."
        ),
    ] = None,
    duration: Duration = None,
    speed: Speed = None,
    acceleration: Acceleration = None,
    jerk: Jerk = None,
    clearance: Clearance = None,
) -> int:
    """Judge a saved result anew, from the files alone."""
    from comove.cli.progress import progress_bar
    from comove.cli.show import FURTHER
    from comove.results import filled_in, read_result, verify_result
    from comove.scenes import Scene

    changes = changes_of(duration, speed, acceleration, jerk, clearance)
    with progress_bar():
        stored = read_result(folder)
        loaded = filled_in(Scene.load(scene, changes), stored)
        verdict = verify_result(stored, loaded)
        joints = _joints_verdict(folder, loaded, scene, robot)
    reasons = (*verdict.reasons, *(joints.reasons if joints is not None else ()))
    if reasons:
        print(f"{folder}: rejected", file=sys.stderr)
        for reason in dict.fromkeys(reasons):
            print(f"  - {reason}", file=sys.stderr)
        if options := _options_of(stored, scene, loaded):
            print(f"  it was solved with {options}: give that again", file=sys.stderr)
        return NOT_VERIFIED
    report = verdict.report
    print(f"{folder}: verified")
    print(f"  clearance at every instant   >= {1e3 * report.clearance_min:.3f} mm")
    print(f"  distance errors              <= {report.distance_error_max:.2g} m")
    for key, (words, factor, unit) in FURTHER.items():
        if (value := report.asdict().get(key)) is not None:
            print(f"  {words:24s}        {factor * value:.3g} {unit}")
    print(
        f"  speed, acceleration          <= {report.speed_max:.3f} m/s, {report.acceleration_max:.3f} m/s^2"
    )
    if report.jerk_max is not None:
        print(f"  jerk                         <= {report.jerk_max:.3f} m/s^3")
    if joints is not None:
        from comove.cli.robot.report import joints_text

        print(joints_text(joints.verified.robot.name, joints.report.asdict()))
    elif loaded.file.robot is not None:
        print("  the hands alone: the folder holds no motion of a robot's joints")
    return VERIFIED


def _options_of(stored, scene: Path, loaded) -> str | None:
    """Return the options that turn a scene file into the scene that was solved; None if there are none."""
    from comove.errors import InputError
    from comove.results.folder import SCENE
    from comove.scenes import Scene

    solved = stored.summary.get("scene_sha256")
    if loaded.sha256 == solved:
        return None
    try:
        found = json.loads((stored.folder / SCENE).read_text(encoding="utf-8"))
        limits, own = found.get("limits") or {}, loaded.file.limits
        options = {
            key: limits[key] for key in LIMITS if limits.get(key, math.nan) not in (None, getattr(own, key))
        }
        if found.get("duration") != loaded.file.duration:
            options = {"duration": found.get("duration")} | options
        if Scene.load(scene, changes_of(**({"duration": None} | options))).sha256 != solved:
            return None
    except (
        OSError,
        ValueError,
        TypeError,
        AttributeError,
        KeyError,
        InputError,
    ):  # the folder is not trusted
        return None
    return " ".join(f"--{key} {value}" for key, value in options.items())


def _joints_verdict(folder: Path, scene, file: Path, named: str | None):
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
    from comove.cli.robot.report import robot_named
    from comove.errors import RobotError
    from comove.robots import bundled_robots, read_joints, verify_stored

    source = read_joints(folder).summary.get("robot_file")
    if named is None and scene.file.robot is None and source not in bundled_robots():
        raise RobotError(
            "neither the scene nor the command names a robot, and the folder's is no bundled one",
            file=file,
            key="robot",
            way_out="give its description by --robot FILE, once you have read it",
        )
    robot, _ = robot_named(source if named is None and scene.file.robot is None else named, scene, file)
    return verify_stored(folder, robot, scene=scene)
