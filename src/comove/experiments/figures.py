"""Counterparts of the paper's Figures 3 to 5, from one recorded human movement."""

from __future__ import annotations

from pathlib import Path

from comove.experiments.examples import example
from comove.planning import LeastJerk, Solution, carried_demonstration, solve
from comove.primitives import DMP
from comove.scenes import Scene
from comove.views import draw_progress, draw_side_by_side, save


def draw_figures(folder: Path, solutions: dict[str, Solution], dmp: DMP) -> dict[str, str]:
    """Draw the figures into `folder`; return a description of each.

    Parameters
    ----------
    solutions : solutions of the examples "wide" and "narrow", and of "narrow-free", solved without the demonstration
    dmp : the demonstrated movement
    """
    alone = single(example("wide"))
    initial = solve(alone, demonstration=dmp, objective=LeastJerk())
    save(
        draw_side_by_side(
            [initial.attempt],
            ["initial movement of one hand"],
            [carried_demonstration(dmp, alone)],
            states=False,
        ),
        folder / "figure3.png",
    )
    wide, narrow, free = (solutions[name].attempt for name in ("wide", "narrow", "narrow-free"))
    save(
        draw_side_by_side([wide, narrow], ["(a) wide passage", "(b) narrow passage"], states=False),
        folder / "figure4.png",
    )
    save(draw_progress(narrow), folder / "figure5.png")
    carried = carried_demonstration(dmp, narrow.scene)
    save(
        draw_side_by_side([narrow, free], ["near to what was taught", "without it"], [carried, None]),
        folder / "taught.png",
    )
    return {
        "figure3.png": "the demonstrated movement, adapted by one hand to the wide passage",
        "figure4.png": "two hands with a bar through the wide and the narrow passage",
        "figure5.png": "objective and constraint along the movement through the narrow passage",
        "taught.png": "the same passage with and without regard for the demonstration's shape",
    }


def single(scene: Scene) -> Scene:
    """Return the scene with one free hand in place of the load."""
    data = scene.file.model_dump(exclude_defaults=True)
    hands = [scene.start.mean(axis=0), scene.goal.mean(axis=0)]
    data.pop("load", None)
    data.pop("constraints", None)
    data["manipulators"] = [{"name": "hand", "start": hands[0].tolist(), "goal": hands[1].tolist()}]
    return Scene.from_dict(data, folder=scene.folder)
