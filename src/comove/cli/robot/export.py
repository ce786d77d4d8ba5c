"""`comove robot export`."""

from __future__ import annotations

from typing import Annotated

import typer

from comove.cli.app import verb_of
from comove.cli.robot.app import Folder, robot_app

FORMATS = ("baxter-csv", "csv", "npz", "rosbag1", "rosbag2", "mcap")


@verb_of(robot_app)
def export(
    folder: Folder,
    format: Annotated[str, typer.Option(help=f"One of: {', '.join(FORMATS)}.")] = "baxter-csv",
    rate: Annotated[float, typer.Option(help="Samples a second, 20 or more.")] = 100.0,
    transfers: Annotated[
        bool, typer.Option(help="Also the ways from home to the grasp and from there home.")
    ] = True,
) -> int:
    """Judge the motion in DIR anew and write it there in a format that robots play."""
    from comove.cli.robot.report import stored_motion
    from comove.errors import OptionError, near_name
    from comove.export import FORMATS, check_export, export
    from comove.robots import plan_transfers

    if format not in FORMATS:
        raise OptionError(f"unknown format '{format}'", key="--format", way_out=near_name(format, FORMATS))
    motion = stored_motion(folder)
    check_export(motion, folder, FORMATS[format], rate=rate, transfers=transfers)
    ways = plan_transfers(motion) if transfers else None
    written = export(motion, folder, FORMATS[format], rate=rate, transfers=ways)
    print(f"{motion.scene.name}, {motion.robot.name}: verified, exported for {FORMATS[format].what}")
    for path in written:
        print(f"  {path}")
    return 0
