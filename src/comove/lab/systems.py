"""Systems of the comparison, verified alike.

Each gets a problem and a clock, and offers motions when it finds them. An offer is a row of samples between which
end effectors move on straight lines, for every system. `comove.verification.record` verifies all of them after the
clock has stopped.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from comove.arrays import Array
from comove.dmp.dmp import DMP
from comove.lab.bench.store import Figures
from comove.lab.examples import scene_contents
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.planning.clock import Budget, now
from comove.planning.kernels import SceneKind, load_kernels
from comove.planning.method import Method
from comove.planning.objectives.criteria import PaperCost
from comove.planning.solution import Progress
from comove.planning.solver import solve
from comove.verification.record import ExecutionReport, RecordSamples, verify_execution

N_SAMPLES = 8001  # of an offer, even in time
WEIGHTS = PaperCost()


@dataclass(frozen=True, eq=False)
class SystemProblem:
    """Problem for a system.

    Attributes
    ----------
    scene : scene to solve
    demonstration : initial movement, if there is one
    seed : seed of all random numbers
    budget : processor time for the solution [s]
    """

    scene: Scene
    demonstration: DMP | None = None
    seed: int = 0
    budget: float = 10.0

    @property
    def instants(self) -> Array:
        """Return the sample times of an offer, in shares of the duration. Array, shape (N_SAMPLES,)."""
        return np.linspace(0.0, 1.0, N_SAMPLES)


class Offers:
    """Record of a system's offers and their processor times. It starts when it is made."""

    def __init__(self) -> None:
        self.started = now()
        self.taken: list[tuple[float, Array]] = []

    @property
    def seconds(self) -> float:
        """Return the time since the beginning [s]."""
        return now() - self.started

    def take(self, hands: Array, seconds: float | None = None) -> None:
        """Record an offer [m], shape (N_SAMPLES, n_manipulators, n_dims).

        `seconds` is when it was found; by default now.
        """
        self.taken.append((self.seconds if seconds is None else seconds, np.array(hands, dtype=float)))


class System(ABC):
    """System that solves scenes.

    Attributes
    ----------
    name : name in tables
    carries : whether it also moves a robot's joints
    """

    name: str
    carries: bool = False

    @property
    def version(self) -> str:
        """Return the version of its tool, empty for comove's own."""
        return ""

    def refuses(self, scene: Scene) -> str:
        """Return why it cannot solve a scene; empty if it can."""
        return ""

    def warm_up(self, problem: SystemProblem) -> None:  # noqa: B027  most have nothing to do
        """Load and compile everything that would delay the first run. The clock does not run yet."""

    @abstractmethod
    def run(self, problem: SystemProblem, offers: Offers) -> None:
        """Solve the problem within its budget; offer motions, the best last."""


@dataclass(frozen=True)
class OwnSystem(System):
    """System that runs a method of `comove.solve`.

    Attributes
    ----------
    method : the method
    planner : whether it may plan
    carries : as in `System`; a robot is moved by comove's own method for robots
    """

    name: str
    method: Method
    planner: bool = True
    carries: bool = False

    def warm_up(self, problem: SystemProblem) -> None:
        """Compile the kernels, including those of the method itself."""
        load_kernels(SceneKind.of(problem.scene))
        _first_look(self, problem.scene.n_dims)

    def run(self, problem: SystemProblem, offers: Offers) -> None:
        """Offer every best motion so far, finally that of `solve`."""
        found: list[tuple[float, CoordinatedMotion]] = []

        def note(progress: Progress) -> None:
            if progress.motion is not None and (not found or found[-1][1] is not progress.motion):
                found.append((offers.seconds, progress.motion))

        solution = solve(
            problem.scene,
            demonstration=problem.demonstration,
            seed=problem.seed,
            method=self.method,
            planner=self.planner,
            budget=problem.budget,
            objective=WEIGHTS,
            progress=note,
        )
        if not found or found[-1][1] is not solution.attempt:
            found.append((offers.seconds, solution.attempt))
        for seconds, motion in found:
            offers.take(motion.hands(problem.instants)[0], seconds)


@lru_cache(maxsize=32)
def _first_look(system: OwnSystem, n_dims: int) -> None:
    ends = [np.array([[x, y, 0.5][:n_dims] for y in (0.4, 0.6)]) for x in (0.2, 0.8)]
    ball = {"shape": "sphere", "center": [0.5, 0.65, 0.5][:n_dims], "radius": 0.05}
    bar = {"shape": "bar", "length": 0.2}
    scene = Scene.from_dict(scene_contents("first-look", [1.0] * n_dims, [ball], bar, ends))
    solve(scene, method=system.method, planner=system.planner, budget=0.3)


@dataclass(frozen=True)
class SystemOutcome(Figures):
    """Result of one run: figures of the last offer, and history.

    Attributes
    ----------
    verified : whether the last offer is verified
    reasons : reasons why it is not
    history : (seconds, cost) of the offers that were verified and better than those before
    """

    verified: bool = False
    reasons: tuple[str, ...] = ()
    history: tuple[tuple[float, float], ...] = field(default=(), repr=False)


def refusal(system: System, scene: Scene) -> str:
    """Return why a system is not run on a scene; empty if it is."""
    if scene.file.robot is not None and not system.carries:
        return "It moves hands, and the scene asks for a robot's joints."
    return system.refuses(scene)


def measured(system: System, problem: SystemProblem) -> SystemOutcome | None:
    """Run a system and verify its offers; None without offers."""
    system.warm_up(problem)
    offers = Offers()
    system.run(problem, offers)
    seconds = offers.seconds
    if not offers.taken:
        return None
    reports = [report_of(problem, hands) for _, hands in offers.taken]
    last, report = offers.taken[-1][1], reports[-1]
    reasons = report.reasons
    if reasons and seconds > problem.budget:
        reasons = (Budget.of(problem.budget).ran_out, *reasons)
    outcome = SystemOutcome(
        verified=not reasons,
        reasons=reasons,
        seconds=seconds,
        acceleration_max=report.acceleration_max,
        distance_error_max=report.distance_error_max,
        clearance_min=report.clearance_min,
    )
    kept = [offer for offer, report in zip(offers.taken, reports, strict=True) if not report.reasons]
    return with_figures(outcome, problem.scene, last, kept)


def with_figures(
    outcome: SystemOutcome, scene: Scene, hands: Array, verified: list[tuple[float, Array]]
) -> SystemOutcome:
    """Return a result with its last offer's figures, and history. The history is that of the verified offers.

    Parameters
    ----------
    hands : array, shape (N_SAMPLES, n_manipulators, n_dims), the last offer [m]
    verified : the verified offers and when they were found [s]
    """
    history: list[tuple[float, float]] = []
    for at, offered in verified:
        cost = float(cost_of(scene, offered))
        if not history or cost < history[-1][1]:
            history.append((at, cost))
    step = scene.duration / (len(hands) - 1)
    jerk = np.diff(hands, n=3, axis=0) / step**3
    way = float(((scene.goal - scene.start) ** 2).sum())
    return replace(
        outcome,
        first_verified=history[0][0] if history else None,
        history=tuple(history),
        cost=float(cost_of(scene, hands)),
        path_length=float(np.linalg.norm(np.diff(hands, axis=0), axis=2).sum()),
        jerk_max=float(np.linalg.norm(jerk, axis=2).max()),
        jerk_ratio=float((jerk**2).sum() * step * scene.duration**5 / (720.0 * max(way, 1e-12))),
        duration=scene.duration,
    )


def report_of(problem: SystemProblem, hands: Array) -> ExecutionReport:
    """Return the verification report on an offer."""
    return verify_execution(RecordSamples(problem.scene, problem.instants * problem.scene.duration, hands))


def cost_of(scene: Scene, hands: Array) -> Array:
    """Compute J of equation (4) in unit duration from even samples.

    Parameters
    ----------
    hands : array, shape (..., n_steps, n_manipulators, n_dims), [m]

    Returns
    -------
    array, shape (...)
    """
    n, inner = hands.shape[-3], (-3, -2, -1)
    to_goal = ((hands - scene.goal) ** 2).sum(axis=inner) / n
    effort = (np.diff(hands, axis=-3) ** 2).sum(axis=inner) * (n - 1) ** 2 / n
    return WEIGHTS.goal * to_goal + WEIGHTS.velocity * effort


def distance_errors(scene: Scene, hands: Array) -> Array:
    """Return the largest error of a fixed distance, else 0 [m]. It is that at every step.

    Parameters
    ----------
    hands : array, shape (n_steps, n_manipulators or more, n), [m]

    Returns
    -------
    array, shape (n_steps,)
    """
    errors = np.zeros(len(hands))
    for c in scene.distances:
        apart = np.linalg.norm(hands[:, c.first] - hands[:, c.second], axis=1)
        errors = np.maximum(errors, np.abs(apart - c.distance))
    return errors
