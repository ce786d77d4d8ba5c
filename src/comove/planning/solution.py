"""The result of `solve`, and the reports of its progress."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import comove
from comove.brief import brief
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.planning.objective import Cost
from comove.planning.objectives import Criterion, OwnFunctions, PaperCost
from comove.planning.resemblance import Followed
from comove.trajectory import Trajectory
from comove.verification.verify import Report, VerifiedMotion


@dataclass(frozen=True)
class Progress:
    """A report of the progress of a search.

    Attributes
    ----------
    stage : description of the current stage
    generation : number of generations since the start
    cost : cost of the best sample of this generation, in the terms of the current stage
    violation : penalty of that sample, 0 if it violates nothing
    best : value of the objective for the best motion so far, None before there is one; verified, unless obstacles are
        only costs
    motion : best motion so far
    """

    stage: str
    generation: int
    cost: float
    violation: float
    best: float | None
    motion: CoordinatedMotion | None = None

    @property
    def words(self) -> str:
        """Return the state of the search in one line."""
        return (
            f"{self.stage} · generation {self.generation} · cost {self.cost:.4f} · "
            f"constraint {self.violation:.2g} · {self.best_words}"
        )

    @property
    def best_words(self) -> str:
        """Return the best cost so far in words."""
        return f"best verified {'none yet' if self.best is None else f'{self.best:.4f}'}"


ProgressCallback = Callable[[Progress], None]


@dataclass(frozen=True)
class SearchEffort:
    """The effort of a search.

    Attributes
    ----------
    evaluations, generations : numbers of evaluated rollouts and of generations of the optimiser
    seconds : processor time spent in `solve`, less the time spent on compilation [s]
    work : work counted in `solve`, in units of about a second's; the same on every machine unless it timed out
    first_verified : processor time from scene and demonstration in memory to the first verified motion [s]
    """

    evaluations: int = 0
    generations: int = 0
    seconds: float = 0.0
    work: float = 0.0
    first_verified: float | None = None

    def after(self, earlier: SearchEffort) -> SearchEffort:
        """Return the summed effort of an earlier search and this one. The first verified motion of both counts."""
        later = None if self.first_verified is None else earlier.seconds + self.first_verified
        return SearchEffort(
            earlier.evaluations + self.evaluations,
            earlier.generations + self.generations,
            earlier.seconds + self.seconds,
            earlier.work + self.work,
            later if earlier.first_verified is None else earlier.first_verified,
        )


@dataclass(frozen=True, eq=False)
class Solution:
    """The result of `solve`.

    Attributes
    ----------
    scene : scene that was solved
    motion : verified motion; None if none was found
    attempt : motion that is returned in any case: the verified one, or else the best attempt
    report : measures of `attempt` from its verification
    reasons : why `attempt` is not verified, in words; empty if it is
    cost : terms of J of `attempt`
    method, seed : name of the method, and seed of all random numbers
    effort : rollouts, time and work of the search
    interrupted : whether the user stopped the search
    timed_out : whether the budget ran out before the search ended by itself; then another machine may find another
        motion
    log : figures that the method reports of its run, numbers or lists of numbers by name
    objective : objective that was minimised
    followed : distances of the end effectors from the demonstration, None if none was followed
    joints : `comove.robots.JointSolution` that executes the motion; None without a robot
    """

    __repr__ = brief

    scene: Scene
    motion: VerifiedMotion | None
    attempt: CoordinatedMotion
    report: Report
    reasons: tuple[str, ...]
    cost: Cost
    method: str
    seed: int
    effort: SearchEffort
    interrupted: bool = False
    timed_out: bool = False
    log: Mapping[str, float | list[float]] = field(default_factory=dict)
    objective: Criterion | OwnFunctions = field(default_factory=PaperCost)
    followed: Followed | None = None
    joints: Any = None

    @property
    def verified(self) -> bool:
        """Return whether the motion is verified, and with a robot its joints."""
        return self.motion is not None and (self.joints is None or self.joints.verified)

    @property
    def trajectory(self) -> Trajectory:
        """Return samples of `attempt` at 100 Hz or more."""
        return self.attempt.trajectory()

    def after(self, earlier: Solution) -> Solution:
        """Return the solution with the effort of an earlier search added."""
        effort = self.effort.after(earlier.effort)
        return replace(self, effort=effort if self.verified else replace(effort, first_verified=None))

    def show(self) -> None:
        """Show the motion in a notebook, or else in a browser; see `comove.show`."""
        comove.show(self)

    def _repr_html_(self) -> str:
        return comove.as_html(self)
