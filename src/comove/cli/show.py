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
    """Print the summary of a result, and of its simulation, and name its pictures."""
    from comove.cli.texts import PICTURES, joints_text, simulation_text, summary_text
    from comove.results.solution import SOLUTION

    summary, _ = SOLUTION.read(folder, whole=True)
    texts = [summary_text(summary, folder)]
    if (folder / "robot.json").is_file():
        from comove.robots.files import JOINTS

        robot, _ = JOINTS.read(folder, whole=True)
        texts.append(joints_text(robot["robot"], robot))
    if (folder / "simulation.json").is_file():
        from comove.simulators import SIMULATION

        simulation, _ = SIMULATION.read(folder, whole=True)
        texts.append(simulation_text(simulation, folder))
    print("\n".join(texts))
    if open_pictures:
        for name in PICTURES:
            typer.launch(str(folder / name))
    return 0
