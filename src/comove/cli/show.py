"""`comove show`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import verb


@verb
def show(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Result folder.")],
    open_pictures: Annotated[bool, typer.Option("--open", help="Open the pictures as well.")] = False,
) -> int:
    """Print the summary of a result and name its pictures."""
    from comove.cli.texts import PICTURES, joints_text, summary_text
    from comove.results.solution import SOLUTION

    summary, _ = SOLUTION.read(folder, whole=True)
    robot = None
    if (folder / "robot.json").is_file():
        from comove.robots.files import JOINTS

        robot, _ = JOINTS.read(folder, whole=True)
    print(summary_text(summary, folder))
    if robot is not None:
        print(joints_text(robot["robot"], robot))
    if open_pictures:
        for name in PICTURES:
            typer.launch(str(folder / name))
    return 0
