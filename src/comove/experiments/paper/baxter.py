"""Figures 7 to 9: Baxter carries a stick through a wide and a narrow passage, in MuJoCo."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from comove.errors import ComoveError, ExtraError
from comove.experiments.examples import example
from comove.experiments.paper.measures import largest_turn
from comove.planning import LeastJerk, Paper, PaperCost, load_kernels, movements_of
from comove.planning.method import Method

PASSAGES = ("wide", "narrow")
METHODS: dict[str, Method | None] = {"paper": Paper(), "comove": None}
BUDGET = 60.0  # s
N_INSTANTS, WIDTH = 5, 340  # of the pictures: in a row, and pixels of each


@dataclass(frozen=True)
class Passage:
    """Settings of a transport: one of `PASSAGES` by one of `METHODS`.

    Attributes
    ----------
    scene : name of the passage
    who : name of the method
    velocity : c_vel of equation (4), for the paper's method
    budget : time after which the best motion so far is taken [s]
    """

    scene: str
    who: str
    velocity: float
    budget: float = BUDGET


@dataclass(frozen=True)
class Transport:
    """Holds the results of Baxter's transport through a passage.

    Attributes
    ----------
    passage : settings of the transport
    verified : whether the judge verified the joint motion
    delivered : whether the stick, welded to the grippers, was delivered in MuJoCo
    reasons : reasons for a failure
    turn : largest change of the stick's direction [rad]
    distance_error, clearance : distance error of the planned hands, and clearance of links, hands and stick from
        posts and table [m]
    lag, end_error : distance of the simulated stick behind its plan, and from its goal at the end [m]; None if
        nothing was simulated
    seconds : wall time of the search [s]
    picture : PNG of equally spaced instants, from the front and below from above; empty if none can be drawn
    """

    passage: Passage
    verified: bool
    delivered: bool
    reasons: tuple[str, ...]
    turn: float
    distance_error: float
    clearance: float
    lag: float | None
    end_error: float | None
    seconds: float
    picture: bytes = field(default=b"", repr=False)

    @property
    def done(self) -> bool:
        """Return whether the motion is verified and the stick was delivered."""
        return self.verified and self.delivered


def missing() -> str:
    """Return what is not installed, in words; empty if Baxter and MuJoCo are there."""
    from comove.robots import Robot
    from comove.simulators.engine import engine

    try:
        Robot.load("baxter")
        engine()
    except ExtraError as error:
        return str(error)
    return ""


def transport(passage: Passage) -> Transport:
    """Plan for the arms, judge the joints, simulate, and draw."""
    from comove.robots import Robot, carry
    from comove.simulators import Weld, simulate

    scene, robot = example(f"baxter_{passage.scene}"), Robot.load("baxter")
    method = METHODS[passage.who]
    load_kernels(scene.n_dims, False)
    begun = time.perf_counter()
    found = carry(
        scene,
        robot,
        demonstration=movements_of(scene.taught, scene),
        method=method,
        budget=passage.budget,
        objective=LeastJerk() if method is None else PaperCost(velocity=passage.velocity),
    )
    seconds = time.perf_counter() - begun
    if found.solution.interrupted:
        raise KeyboardInterrupt
    attempt, report = found.solution.attempt, found.report
    told = Transport(
        passage,
        found.verified,
        False,
        found.solution.reasons,
        largest_turn(attempt),
        found.solution.report.distance_error_max,
        min(report.clearance_scene, found.solution.report.clearance_min),
        None,
        None,
        seconds,
    )
    if not found.verified:
        return told
    execution = simulate(found.joints, scene, robot, Weld())
    return Transport(
        **vars(told)
        | {
            "delivered": execution.delivered,
            "reasons": execution.reasons,
            "lag": execution.measures["lag_max"],
            "end_error": execution.measures["end_error"],
            "picture": _picture(execution),
        }
    )


def _picture(execution) -> bytes:
    from comove.simulators import ABOVE, FRONT, draw_sheet

    with _file() as path:
        try:
            draw_sheet(
                execution, path, count=N_INSTANTS, columns=N_INSTANTS, width=WIDTH, views=(FRONT, ABOVE)
            )
        except ComoveError:  # nothing can be drawn here; what was simulated counts without
            return b""
        return path.read_bytes()


@contextmanager
def _file() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder) / "sheet.png"
