"""`solve_many`, which solves scenes on several processes."""

from __future__ import annotations

import json
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from comove.dmp.dmp import DMP
from comove.dmp.poses import PoseDMP
from comove.dmp.probabilistic import ProMP
from comove.errors import OptionError
from comove.model.demonstration import demonstration_of
from comove.model.scene import Scene
from comove.planning import LeastJerk, LeastTime, PaperCost, SceneKind, Solution
from comove.planning.arguments import check_budget
from comove.planning.effort import EffortLevel, EffortName
from comove.planning.method import Method
from comove.planning.warming import JOBS, require
from comove.processes import TaskResult, run_tasks
from comove.solving import solve
from comove.verification.verify import VerifiedMotion, verify

KILLS = 3  # of processes, after which a task is given up
TIMES, MORE = 3.0, 630.0  # budgets, and seconds more (compiling among them), after which a task is stopped

if TYPE_CHECKING:
    from comove.robots import Robot

Carrier: TypeAlias = "Robot | str | Path | Literal[False] | None"
Taught = DMP | PoseDMP | ProMP | tuple[DMP, ...]
Status = Literal["verified", "not verified", "refused", "error", "killed", "late"]


@dataclass(frozen=True, eq=False)
class Solved:
    """Result of one of many scenes.

    Attributes
    ----------
    number : number of the scene in the input, from 0
    status : "verified"; "not verified" for the best attempt; "refused" if the input is wrong; "error"; "killed" if
        its process was killed three times; "late" if it was stopped for taking far longer than its budget
    reasons : reasons why it is not verified
    found : the solution from its process, without verified motions and without the robot; None without one
    seconds : time that the scene took in its process [s]
    robot : as in `solve_many`
    """

    number: int
    status: Status
    reasons: tuple[str, ...]
    found: Solution | None
    seconds: float
    robot: Carrier = field(default=None, repr=False)

    @property
    def verified(self) -> bool:
        """Return whether the motion was verified by its process."""
        return self.status == "verified"

    @cached_property
    def solution(self) -> Solution | None:
        """Return the solution, verified again with its joints, or None."""
        if self.found is None:
            return None
        solution = replace(self.found, motion=verify(self.found.attempt).verified)
        robot = carrier_of(solution.scene, self.robot)
        if solution.joints is None or robot is None:
            return solution
        from comove.robots import verify_joints

        verdict = verify_joints(robot, solution.motion or solution.attempt, solution.joints.attempt)
        return replace(solution, joints=replace(solution.joints, robot=robot, verdict=verdict))

    @property
    def motion(self) -> VerifiedMotion | None:
        """Return the verified motion of the end effectors; None if the solution is not verified."""
        return self.solution.motion if self.verified and self.solution is not None else None


@dataclass(frozen=True)
class SolvingWork:
    """Work of a process: to solve scenes with given options. Attributes are the options of `comove.solve`. Without
    `demonstration`, each scene's own one is used."""

    demonstration: Taught | None = None
    seed: int = 0
    method: Method | None = None
    planner: bool = True
    budget: float = 30.0
    objective: LeastJerk | LeastTime | PaperCost | None = None
    robot: Carrier = None
    effort: EffortName | EffortLevel = "normal"

    def __call__(self, task: tuple[int, Scene]) -> tuple[bool, Solution]:
        """Return whether the motion is verified, and the picklable solution."""
        _, scene = task
        robot = carrier_of(scene, self.robot)
        solution = solve(
            scene,
            robot=False if robot is None else robot,
            demonstration=movement_of(scene) if self.demonstration is None else self.demonstration,
            seed=self.seed,
            method=self.method,
            planner=self.planner,
            budget=self.budget,
            objective=self.objective,
            effort=self.effort,
        )
        joints = solution.joints
        if joints is not None:
            joints = replace(joints, robot=None, verdict=replace(joints.verdict, verified=None))
        return solution.verified, replace(solution, motion=None, joints=joints)


def carrier_of(scene: Scene, robot: Carrier) -> Any:
    """Return the robot of a scene, loaded once; None without one.

    Parameters
    ----------
    robot : as in `solve_many`
    """
    if not _is_carried(scene, robot):
        return None
    from comove.data.carried import robot_named

    if robot is None:
        return robot_named(str(scene.file.robot), scene.folder)
    return robot_named(str(robot), None) if isinstance(robot, (str, Path)) else robot


def _is_carried(scene: Scene, robot: Carrier) -> bool:
    return robot is not False and (robot is not None or scene.file.robot is not None)


class _Named:
    """Scene that equals others with the same demonstration."""

    def __init__(self, scene: Scene):
        self.scene = scene
        source = scene.file.demonstration
        said = None if source is None else json.dumps(source.model_dump(), sort_keys=True)
        self._same = (str(scene.folder), said, scene.n_dims, scene.manipulators, scene.turns_as_one)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Named) and self._same == other._same

    def __hash__(self) -> int:
        return hash(self._same)


def movement_of(scene: Scene) -> Taught | None:
    """Return the movement that a scene names, fitted once per demonstration."""
    return _movement(_Named(scene))


@lru_cache(maxsize=64)
def _movement(named: _Named) -> Taught | None:
    return demonstration_of(named.scene)


def solve_many(
    scenes: Iterable[Scene],
    *,
    workers: int = 2,
    robot: Carrier = None,
    demonstration: Taught | None = None,
    seed: int = 0,
    method: Method | None = None,
    planner: bool = True,
    budget: float = 30.0,
    objective: LeastJerk | LeastTime | PaperCost | None = None,
    effort: EffortName | EffortLevel = "normal",
) -> Iterator[Solved]:
    """Solve scenes on several processes; yield results as they come.

    Scenes are read from the iterable as processes are free, so it may be a generator of any length. The kernels stay
    loaded from scene to scene. An error in one scene, and a process that is killed, do not stop the others. Ctrl-C,
    or closing the iterator, ends the processes.

    Parameters
    ----------
    workers
        Number of processes, each with one numerical thread.
    demonstration
        Movement for all scenes; that of each scene unless given.
    robot, seed, method, planner, budget, objective, effort
        As for `comove.solve`; the same for all scenes.

    Raises
    ------
    OptionError
        If there is no worker, or an option cannot be sent to other processes.
    """
    if workers < 1:
        raise OptionError(f"workers = {workers}", key="workers", way_out="give 1 or more")
    check_budget(budget)
    effort = EffortLevel.of(effort)
    work = SolvingWork(demonstration, seed, method, planner, budget, objective, robot, effort)
    return _outcomes(work, enumerate(scenes), workers)


def require_kernels(scenes: Iterable[Scene], robot: Carrier = None) -> None:
    """Wait until the kernels for scenes are compiled on all cores.

    Otherwise each process of a pool would compile them by itself.

    Parameters
    ----------
    robot : as in `solve_many`
    """
    kinds = dict.fromkeys((SceneKind.of(scene), _is_carried(scene, robot)) for scene in scenes)
    names = dict.fromkeys(name for kind, on_robot in kinds for name in _jobs(kind, on_robot))
    require(*(name for name in names if JOBS[name].is_possible))


def _jobs(kind: SceneKind, on_robot: bool) -> tuple[str, ...]:
    return kind.robot_jobs if on_robot else kind.jobs


def _outcomes(work: SolvingWork, tasks: Iterator[tuple[int, Scene]], workers: int) -> Iterator[Solved]:
    """Yield the results of tasks. Tasks whose process was killed are tried again."""
    again = deque(islice(tasks, workers))
    require_kernels((scene for _, scene in again), work.robot)
    kills: Counter[int] = Counter()

    def next_task() -> tuple[int, Scene] | None:
        return again.popleft() if again else next(tasks, None)

    for ended in run_tasks(work, next_task, workers=workers, allowed=TIMES * work.budget + MORE):
        number, _ = ended.task
        kills[number] += ended.killed
        if ended.killed and kills[number] < KILLS:
            again.append(ended.task)
        else:
            yield _outcome(ended, work.robot)


def _outcome(ended: TaskResult[tuple[int, Scene], tuple[bool, Solution]], robot: Carrier) -> Solved:
    """Return the result of a task that will not be repeated."""
    number, _ = ended.task
    if ended.made is not None:
        verified, solution = ended.made
        status: Status = "verified" if verified else "not verified"
        reasons = solution.reasons or (() if verified else solution.joints.verdict.reasons)
        return Solved(number, status, reasons, solution, ended.seconds, robot)
    if ended.killed or ended.late:
        return Solved(number, *lost(ended), None, ended.seconds)
    return Solved(number, "refused" if ended.refused else "error", (ended.error,), None, ended.seconds)


def lost(ended: TaskResult) -> tuple[Status, tuple[str, ...]]:
    """Return the status and reason of a task without result."""
    if ended.late:
        return "late", (f"stopped after {ended.seconds:.0f} s",)
    return "killed", (f"its process was killed {KILLS} times",)
