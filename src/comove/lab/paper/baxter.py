"""Figures 7 to 9: Baxter's passages in MuJoCo, and [5] with joints."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from comove.errors import ComoveError, ExtraError
from comove.lab.compared import TaskPriority
from comove.lab.evolution import Paper
from comove.lab.examples import example
from comove.lab.paper.measures import largest_turn
from comove.model import demonstration_of
from comove.planning import LeastJerk, PaperCost, SceneKind, load_kernels, movements_of
from comove.planning.clock import now
from comove.planning.method import Method
from comove.solving import solve

if TYPE_CHECKING:
    from comove.sim import Execution

PASSAGES = ("wide", "narrow")
METHODS: dict[str, Method | None] = {"paper": Paper(), "comove": None}
WITH_JOINTS = "task-priority [5]"
STARTS = ("recorded movement", "straight lines")
"""With what [5] begins."""


@dataclass(frozen=True)
class Passage:
    """Settings of a transport through one of `PASSAGES`. It is solved by one of `METHODS`, or `WITH_JOINTS`.

    Attributes
    ----------
    scene : name of the passage
    who : name of the method
    velocity : c_vel of equation (4), for the paper's method
    seed : seed of all random numbers
    drawn : whether to draw it
    start : initial movement, one of `STARTS`
    budget : processor time of the search [s]; arms are followed by several threads
    """

    scene: str
    who: str
    velocity: float
    seed: int
    drawn: bool = False
    start: str = STARTS[0]
    budget: float = 120.0


@dataclass(frozen=True)
class Transport:
    """Results of Baxter's transport through a passage.

    Attributes
    ----------
    passage : settings of the transport
    verified : whether the joint motion is verified
    delivered : whether the stick, welded to the grippers, was delivered in MuJoCo
    turn : largest change of the stick's direction [rad]
    distance_error, clearance : distance error of the planned end effectors, and clearance of links, end effectors and
        stick from posts and table [m]
    lag, end_error : distance of the simulated stick behind its plan, and from its goal at the end [m]; None if
        nothing was simulated
    end_missed : distance of the planned end effectors from their goals [m]
    seconds : processor time of the search [s]
    reasons : reasons why the joint motion is not verified
    log : log of the method
    picture : PNG of equally spaced instants, from the front and below from above; empty if none can be drawn
    """

    passage: Passage
    verified: bool
    turn: float
    distance_error: float
    clearance: float
    end_missed: float
    seconds: float
    reasons: tuple[str, ...] = ()
    log: Mapping[str, Any] = field(default_factory=dict, repr=False)
    delivered: bool = False
    lag: float | None = None
    end_error: float | None = None
    picture: bytes = field(default=b"", repr=False)

    @property
    def done(self) -> bool:
        """Return whether the motion is verified and the stick was delivered."""
        return self.verified and self.delivered


def missing() -> str:
    """Return the missing packages in words; empty if none is missing."""
    from comove.robots import Robot
    from comove.sim.engine import engine

    try:
        Robot.load("baxter")
        engine()
    except ExtraError as error:
        return str(error)
    return ""


def transport(passage: Passage) -> Transport:
    """Plan for the arms, verify the joints, simulate, and draw."""
    from comove.robots import Robot
    from comove.sim import Weld, simulate

    scene, robot = example(f"baxter_{passage.scene}"), Robot.load("baxter")
    method = (METHODS | {WITH_JOINTS: TaskPriority()})[passage.who]
    recorded = passage.start == STARTS[0]
    load_kernels(SceneKind.of(scene))
    begun = now()
    found = solve(
        scene,
        robot=robot,
        demonstration=movements_of(demonstration_of(scene), scene) if recorded else None,
        seed=passage.seed,
        method=method,
        budget=passage.budget,
        objective=LeastJerk() if method is None else PaperCost(velocity=passage.velocity),
    )
    seconds = now() - begun
    if found.interrupted:
        raise KeyboardInterrupt
    planned = Transport(
        passage,
        verified=found.verified,
        turn=largest_turn(found.attempt),
        distance_error=found.report.distance_error_max,
        clearance=min(found.joints.report.clearance_scene, found.report.clearance_min),
        end_missed=found.report.end_error,
        seconds=seconds,
        reasons=found.reasons,
        log=found.log,
    )
    if not found.verified:
        return planned
    execution = simulate(found.joints.attempt, scene, robot, Weld())
    return replace(
        planned,
        delivered=execution.delivered,
        lag=execution.measures["lag_max"],
        end_error=execution.measures["end_error"],
        picture=_picture(execution) if passage.drawn else b"",
    )


def _picture(execution: Execution, count: int = 5, width: int = 340) -> bytes:
    """Return a PNG of instants in two views, `width` pixels each. It is empty if nothing can be drawn."""
    from comove.sim import ABOVE, FRONT, draw_sheet

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sheet.png"
        try:
            draw_sheet(execution, path, count=count, columns=count, width=width, views=(FRONT, ABOVE))
        except ComoveError:  # what was simulated counts without
            return b""
        return path.read_bytes()
