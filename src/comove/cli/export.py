"""`comove export`."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated

import typer

from comove.cli import options as o
from comove.cli.app import verb
from comove.cli.texts import say
from comove.errors import OptionError

if TYPE_CHECKING:
    from comove.robots.transfers import Transfers

FORMATS = ("baxter-csv", "csv", "npz", "rosbag1", "rosbag2", "mcap", "moveit")


@verb
def export(
    folder: o.JointFolder,
    format: Annotated[
        str | None,
        typer.Option(help=f"One of: {', '.join(FORMATS)}; baxter-csv for a Baxter, else csv, unless given."),
    ] = None,
    rate: Annotated[float, typer.Option(help="Samples a second, 20 or more.")] = 100.0,
    transfers: Annotated[
        bool | None,
        typer.Option(
            help="Also the motions to the grasp and from there home, both or neither; unless said, those found."
        ),
    ] = None,
    approach: Annotated[bool, typer.Option("--approach", help="Also the motion to the grasp.")] = False,
    release: Annotated[bool, typer.Option("--release", help="Also the motion from the grasp home.")] = False,
    present: o.PresentFile = None,
    *,
    trusted: o.Trusted,
) -> int:
    """Verify the motion in DIR again and export it for a robot."""
    from comove.cli.texts import in_rows
    from comove.robots.transfers import possible_transfers
    from comove.ros import FORMATS as KINDS
    from comove.ros import IN_STEP, check_export, export, usual_format
    from comove.stored import gripper_rows

    if format is not None:
        o.require_one_of(format, FORMATS, "format")
    if transfers is not None and (approach or release):
        key = "--approach" if approach else "--release"
        raise OptionError(
            "--transfers is both, --no-transfers neither", key=key, way_out="leave one of the options out"
        )
    strict = bool(transfers or approach or release)
    both = bool(transfers or (transfers is None and not strict))
    o.require_approach(present, both or approach)
    motion = trusted.verified(folder)
    in_step = bool(motion.scene.moving.any())
    both = both and (strict or not in_step)
    approach, release = both or approach, both or release
    o.require_approach(present, approach)
    kind = usual_format(motion) if format is None else KINDS[format]
    parts = [o.CARRY, *(["approach"] if approach else []), *(["release"] if release else [])]
    check_export(motion, folder, kind, rate=rate, parts=parts)
    planned: Transfers | None = None
    if len(parts) > 1:
        begin = o.present_in(folder, motion, present)
        planned, errors = possible_transfers(motion, approach, release, begin)
        for error in errors.values():
            if strict:
                raise error
            what = (
                "the carry alone is exported" if planned is None else "one of approach and release is missing"
            )
            say(f"warning: {what}: {error}", file=sys.stderr)
    written = export(motion, folder, kind, rate=rate, transfers=planned)
    say(f"{motion.scene.name}, {motion.robot.name}: verified, exported for {kind.what}")
    if in_step:
        say(f"warning: {IN_STEP}", file=sys.stderr)
    for row in in_rows(gripper_rows(motion.report.without_gripper)):
        say(row)
    for path in written:
        say(f"  {path}")
    return 0
