"""What a solver returns, and how it tells of its progress."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from comove.coordination.motion import CoordinatedMotion
from comove.planning.followed import Followed
from comove.planning.objective import Cost
from comove.planning.objectives import LeastJerk, LeastTime, OwnFunctions, PaperCost
from comove.scenes.scene import Scene
from comove.trajectory import Trajectory
from comove.verification.verify import Report, VerifiedMotion


@dataclass(frozen=True)
class Progress:
    """Where a search stands.

    Attributes
    ----------
    stage : what is being done, in words
    generation : of the optimiser, since the start
    cost : J of the best sample of this generation
    violation : its penalty, 0 where it breaks nothing
    best : J of the best verified motion so far, None before there is one
    motion : that motion
    """

    stage: str
    generation: int
    cost: float
    violation: float
    best: float | None
    motion: CoordinatedMotion | None = None


ProgressCallback = Callable[[Progress], None]


@dataclass(frozen=True, eq=False)
class Solution:
    """The outcome of `solve`.

    Attributes
    ----------
    scene : what was solved
    motion : the verified motion; None where none was found
    attempt : the motion handed out: the verified one, or else the best attempt
    report : what the judge measured on `attempt`
    reasons : why `attempt` is not verified, in words; empty where it is
    cost : terms of J of `attempt`
    method, seed : how it was found
    evaluations, generations : rollouts evaluated, generations of the optimiser
    time_to_first_verified_s : from scene and demonstration in memory to the first verified motion [s]
    solve_time_s : time spent in `solve` [s]
    interrupted : stopped by the user
    log : what the method tells of its run, numbers or lists of them by name
    objective : what it is best in
    followed : how near the hands are to the demonstration, None where none was followed
    """

    scene: Scene
    motion: VerifiedMotion | None
    attempt: CoordinatedMotion
    report: Report
    reasons: tuple[str, ...]
    cost: Cost
    method: str
    seed: int
    evaluations: int
    generations: int
    time_to_first_verified_s: float | None
    solve_time_s: float
    interrupted: bool = False
    log: Mapping[str, float | list[float]] = field(default_factory=dict)
    objective: LeastJerk | LeastTime | PaperCost | OwnFunctions = field(default_factory=PaperCost)
    followed: Followed | None = None

    @property
    def verified(self) -> bool:
        """Whether `motion` holds a verified motion."""
        return self.motion is not None

    @property
    def trajectory(self) -> Trajectory:
        """Samples of `attempt` at 100 Hz or finer."""
        return self.attempt.trajectory()
