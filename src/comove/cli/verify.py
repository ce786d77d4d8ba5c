"""`comove verify`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import NOT_VERIFIED, VERIFIED, verb


@verb
def verify(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file (YAML).")],
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Result folder.")],
) -> int:
    """Judge a saved result anew, from the files alone."""
    from comove.cli.show import FURTHER
    from comove.results import read_result, verify_result
    from comove.scenes import Scene

    verdict = verify_result(read_result(folder), Scene.load(scene))
    robot = _robot_verdict(folder)
    reasons = (*verdict.reasons, *(robot.reasons if robot is not None else ()))
    if reasons:
        print(f"{folder}: rejected", file=sys.stderr)
        for reason in dict.fromkeys(reasons):
            print(f"  - {reason}", file=sys.stderr)
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
    if robot is not None:
        from comove.cli.robot.report import joints_text

        print(joints_text(robot.verified.robot.name, robot.report.asdict()))
    return VERIFIED


def _robot_verdict(folder: Path):
    """The judgement on a robot's motion, None where the folder holds none."""
    if not (folder / "robot.json").exists() and not (folder / "joints.npz").exists():
        return None
    from comove.robots import verify_stored

    return verify_stored(folder)
