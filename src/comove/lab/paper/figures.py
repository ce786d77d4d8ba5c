"""Figures of the page and of `comove demo`, counterparts of the paper's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from comove.dmp import DMP
from comove.lab.compared.single import alone
from comove.lab.examples import example
from comove.lab.modulation.pictures import draw_comparison
from comove.lab.paper import baxter
from comove.lab.paper.jobs import CONTENDERS, Outcome, title_of
from comove.lab.paper.measures import Measures
from comove.lab.paper.runs import (
    GAIT,
    INITIAL,
    OTHER_SYSTEMS,
    RECORDING_SEEDS,
    ROLES,
    SCENES,
    Runs,
)
from comove.lab.summaries import NOTHING, Interval, median_interval, wilson
from comove.planning import LeastJerk, Solution, carried_demonstration, solve
from comove.view.figures import (
    Panel,
    draw_failures,
    draw_measures,
    draw_pipeline,
    draw_progress,
    draw_progress_side_by_side,
    draw_side_by_side,
    save,
)

FIGURES = tuple(f"figure{i}.png" for i in range(1, 7)) + ("systems.png", "roles.png", "story.png")
BAXTER = {
    (scene, who): f"figure{number}{letter}.png"
    for scene, number in zip(baxter.PASSAGES, (8, 9), strict=True)
    for who, letter in zip(baxter.METHODS, "ab", strict=True)
}
"""Pictures of the robot by passage and method, where it can be simulated and drawn."""
FAILED = {scene: f"failed_{scene}.png" for scene in RECORDING_SEEDS}
"""Pictures of failed attempts from recordings by scene, where there are any."""
REACTIONS = ("nearest hand's matrix", "same matrix on all", "motions known")


def draw_all(runs: Runs, folder: Path) -> None:
    """Draw all `FIGURES` into a folder."""
    folder.mkdir()
    assert runs.recorded is not None
    pictures = {
        "figure1.png": draw_pipeline(*runs.recorded, runs.motion("figure 1")),
        "figure2.png": draw_comparison([c for c in runs.compared if c.method in REACTIONS]),
        "figure3.png": _side_by_side(
            [
                drawn
                for scene in INITIAL
                for drawn in (
                    (f"{scene}: initial movement of one hand", runs.one("figure 3", scene=scene)),
                    (f"{scene}: given to both hands, not yet optimised", runs.one("given", scene=scene)),
                )
            ],
            states=False,
        ),
        "figure4.png": _side_by_side(
            [
                (f"({letter}) {scene} passage, {title_of(who)}", runs.one("figure 4", scene=scene, who=who))
                for who in ("paper", "comove")
                for letter, scene in (("a", "wide"), ("b", "narrow"))
            ],
            states=False,
        ),
        "figure5.png": draw_progress_side_by_side(
            [runs.motion("figure 4", scene="narrow", who=who) for who in ("paper", "comove")],
            [f"narrow passage, {title_of(who)}" for who in ("paper", "comove")],
            velocity=GAIT["velocity"],
        ),
        "figure6.png": _side_by_side(
            [
                ("(a) narrow, paper's method", runs.one("figure 4", scene="narrow", who="paper")),
                ("(b) narrow, no constraint [22]", runs.one("figure 6", scene="narrow")),
                ("(c) complex, paper's method", runs.one("figure 6", who="paper")),
                ("(c) complex, comove", runs.one("figure 6", who="comove")),
            ]
        ),
        "systems.png": _side_by_side([(who, runs.one("systems", who=who)) for who in OTHER_SYSTEMS]),
        "roles.png": _side_by_side(
            [(title, runs.one("leaders", who=who)) for who, title in ROLES.items()],
            columns=3,
        ),
        "story.png": draw_measures(story_panels(runs), tuple(CONTENDERS), SCENES),
    }
    for name in FIGURES:
        save(pictures[name], folder / name)
    for scene, name in FAILED.items():
        if shown := shown_failures(runs, scene):
            save(_failures(shown), folder / name)
    for t in runs.transports:
        if t.picture:
            (folder / BAXTER[t.passage.scene, t.passage.who]).write_bytes(t.picture)


def failures(runs: Runs, scene: str) -> list[Outcome]:
    """Return the paper method's failed attempts from recordings on a scene."""
    return [outcome for outcome in runs.of("recordings", scene=scene) if not outcome.measures.verified]


def shown_failures(runs: Runs, scene: str) -> list[Outcome]:
    """Return the failed attempts that are drawn, one per recording."""
    first: dict[str, Outcome] = {}
    for outcome in failures(runs, scene):
        if outcome.motion is not None:
            first.setdefault(outcome.job.movement, outcome)
    return list(first.values())


def draw_demo(folder: Path, solutions: dict[str, Solution], dmp: DMP) -> dict[str, str]:
    """Draw counterparts of Figures 3 to 5; return their descriptions. All begin with one recorded movement.

    Parameters
    ----------
    solutions : solutions of the examples "wide" and "narrow", and of "narrow-free", solved without the demonstration
    dmp : the demonstrated movement
    """
    one = alone(example("wide"))
    initial = solve(one, demonstration=dmp, objective=LeastJerk()).attempt
    wide, narrow, free = (solutions[name].attempt for name in ("wide", "narrow", "narrow-free"))
    taught = carried_demonstration(dmp, narrow.scene)
    pictures = {
        "figure3.png": (
            draw_side_by_side(
                [initial],
                ["initial movement of one hand"],
                [carried_demonstration(dmp, one)],
                states=False,
            ),
            "the demonstrated movement, adapted by one hand to the wide passage",
        ),
        "figure4.png": (
            draw_side_by_side([wide, narrow], ["(a) wide passage", "(b) narrow passage"], states=False),
            "two hands with a bar through the wide and the narrow passage",
        ),
        "figure5.png": (
            draw_progress(narrow),
            "objective and constraint along the movement through the narrow passage",
        ),
        "taught.png": (
            draw_side_by_side([narrow, free], ["near to what was taught", "without it"], [taught, None]),
            "the same passage with and without regard for the demonstration's shape",
        ),
    }
    for name, (figure, _) in pictures.items():
        save(figure, folder / name)
    return {name: caption for name, (_, caption) in pictures.items()}


def story_panels(runs: Runs) -> list[Panel]:
    """Return the panels of measures by method and scene."""
    found = [[runs.measures("story", who=who, scene=scene) for scene in SCENES] for who in CONTENDERS]
    return [
        _panel("verified [%]", [[share_of(cell, 100.0) for cell in row] for row in found]),
        _panel("distance error [m]", _medians(found, "distance_error"), floor=1e-16),
        _panel("certified clearance [mm]", _medians(found, "clearance", 1e3)),
        _panel("J of (4)", _medians(found, "cost"), floor=1e-3),
        _panel("peak acceleration [m/s²]", _medians(found, "acceleration"), floor=1e-3),
        _panel("integrated squared jerk [m²/s⁵]", _medians(found, "jerk"), floor=1e-3),
        _panel("first verified motion [s]", _medians(found, "first"), floor=1e-3),
        _panel("time in all [s]", _medians(found, "total"), floor=1e-3),
    ]


def share_of(found: list[Measures], unit: float = 1.0) -> Interval:
    """Return the share of verified motions. For a single run the interval is the value itself."""
    share = wilson(sum(m.verified for m in found), len(found))
    return Interval(*(unit * x for x in (share if len(found) > 1 else [share.value] * 3)))


def median_of(found: list[Measures], name: str, unit: float = 1.0) -> Interval:
    """Return the median of a measure over the runs that have it; NaN if none has."""
    values = [unit * value for m in found if (value := getattr(m, name)) is not None]
    return median_interval(values) if values else NOTHING


def _medians(found: list[list[list[Measures]]], name: str, unit: float = 1.0) -> list[list[Interval]]:
    return [[median_of(cell, name, unit) for cell in row] for row in found]


def _panel(title: str, cells: list[list[Interval]], floor: float | None = None) -> Panel:
    value, low, high = np.moveaxis(np.array(cells), 2, 0)
    return Panel(title, value, low, high, floor)


def _side_by_side(drawn: list[tuple[str, Outcome]], *, states: bool = True, columns: int = 2) -> Figure:
    return draw_side_by_side(
        [outcome.motion for _, outcome in drawn if outcome.motion is not None],
        [f"{title}\n{verdict(outcome.measures)}" for title, outcome in drawn],
        states=states,
        columns=min(columns, len(drawn)),
    )


def _failures(drawn: list[Outcome]) -> Figure:
    return draw_failures(
        [outcome.motion for outcome in drawn if outcome.motion is not None],
        [f"{o.job.movement}, seed {o.job.seed}\n" + verdict(o.measures).replace(", ", "\n") for o in drawn],
    )


def verdict(m: Measures, whole: float = 10.0, off: float = 2.5e-4) -> str:
    """Return a motion's verification result in a few words.

    Parameters
    ----------
    whole : depth above which tenths are omitted [mm]
    off : error of a distance above which it is reported [m]
    """
    if m.verified:
        return f"verified, clear by {1e3 * m.clearance:.1f} mm"
    wrong = []
    if m.clearance < 0:
        depth = -1e3 * m.clearance
        beyond = "beyond the border of the workspace" if "border" in m.nearest else "into a wall"
        wrong.append(f"{depth:.{0 if depth >= whole else 1}f} mm {beyond}")
    if m.distance_error > off:
        wrong.append(f"distance {1e3 * m.distance_error:.3g} mm off")
    if m.end_error > 1e-3:
        wrong.append(f"goal missed by {1e3 * m.end_error:.0f} mm")
    return ", ".join(wrong) or "not verified"
