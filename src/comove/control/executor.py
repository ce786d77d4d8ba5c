"""Online execution among moving obstacles: follow a plan, evade, stop in time, plan anew.

Every control step asks what is observed. A plan that is certified for exactly known motions is followed exactly.
Otherwise the twist programme modifies the plan's velocities to keep clear of the obstacles that are seen now; where
the path is blocked the load slows down and evades until it is free. A plan that seems not to hold any more is
replaced by one from the present state on.
"""

from __future__ import annotations

import time as clock
import warnings
from array import array
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from comove.control.observers import Known, Observer, going_on
from comove.control.safety.twist_qp import MAX_PERIOD, NOTHING, Allowed, ProgrammeSettings, TwistProgramme
from comove.control.safety.twists import advanced, hand_velocities, nodes_of, poses_of, twists_between
from comove.dmp.arguments import require_positive
from comove.dmp.demonstrations import Demonstration
from comove.dmp.dmp import DMP
from comove.dmp.poses import PoseDMP
from comove.dmp.probabilistic import ProMP
from comove.errors import ComoveWarning, OptionError
from comove.geometry.distances import inflated
from comove.geometry.rotations import matrices
from comove.model.coordinates import HandPoses, poses_at
from comove.model.groups import GroupPose
from comove.model.motion import CoordinatedMotion
from comove.model.resting import require_no_rest
from comove.model.scene import Scene
from comove.planning.arguments import movements_of, warn_of_adaptation
from comove.planning.clock import Budget
from comove.planning.methods import Guide, Quick
from comove.planning.search import Interruption
from comove.planning.solver import solve
from comove.processes import one_blas_thread
from comove.verification.certificate import certify
from comove.verification.record import Record
from comove.verification.verify import VerifiedMotion

Array = NDArray[np.float64]

NO_PLAN = "no plan yet"


@dataclass(frozen=True)
class Pace:
    """Periods and time budgets of an execution.

    Attributes
    ----------
    period : control period [s]
    watch : time between two checks of whether the plan still holds [s]
    patience : time between two attempts to plan [s]; it doubles while they fail
    leisure, haste : work of the first attempt to plan and of any later one, as `Budget.work`: about as many seconds,
        but counted, so that a run is the same on every machine
    """

    period: float = 0.01
    watch: float = 0.1
    patience: float = 0.25
    leisure: float = 10.0
    haste: float = 1.0

    def __post_init__(self) -> None:
        for name in ("period", "watch", "patience"):
            require_positive(name, getattr(self, name), MAX_PERIOD)
        for name in ("leisure", "haste"):
            require_positive(name, getattr(self, name))


@dataclass(frozen=True)
class ExecutionSettings:
    """Settings of the executor that follow from nothing else.

    Attributes
    ----------
    longer : factors on the shortest duration worth trying, tried in turn
    hurry : duration of the shortest plan, as a multiple of the way at the speed limit
    shortest : least duration of a plan [s]
    catch_up : time constant of the return to a plan [s]
    homing, caution : time constant of the approach to the goal without a plan [s], and share of the speed limit
    lost : distance behind a plan that was meant for something else [m]
    spare : kept on top of the scene's clearance, as an execution is verified between its steps as well [m]
    n_remembered : configurations of the last plan that the next one may use
    at_leisure : method of the first plan, while nothing moves yet
    most_patient : longest time between two attempts to plan, after some have failed [s]
    nearly_done : share of a demonstration after which it counts no more
    at_goal, at_rest : distance and speed at which an execution ends [m, m/s]
    """

    longer: tuple[float, ...] = (1.0, 1.3, 1.7, 2.3)
    hurry: float = 1.5
    shortest: float = 0.5
    catch_up: float = 0.1
    homing: float = 0.5
    caution: float = 0.5
    lost: float = 0.03
    spare: float = 5e-4
    n_remembered: int = 20
    at_leisure: Quick = field(default_factory=lambda: Quick(n_failures=24))
    most_patient: float = 2.0
    nearly_done: float = 0.8
    at_goal: float = 5e-4
    at_rest: float = 5e-4


SETTINGS = ExecutionSettings()


@dataclass(frozen=True)
class Event:
    """An event of an execution, which happened at `time` [s] and is described by `what`."""

    time: float
    what: str


@dataclass(eq=False)
class StepLog:
    """The log of what an executor does step by step.

    Attributes
    ----------
    events : events in their order
    control, planning : computing time of every control step, and of every attempt to plan [s]
    blocking : number of control steps in which an obstacle hindered most, by the obstacle's number; -1 for the
        border, the number of the file's obstacles for all else that is seen
    relaxed : by how much the programme had to relax its rows at most [m/s]
    """

    events: list[Event] = field(default_factory=list)
    control: array[float] = field(default_factory=lambda: array("d"))
    planning: list[float] = field(default_factory=list)
    blocking: dict[int, int] = field(default_factory=dict)
    relaxed: float = 0.0

    def note(self, allowed: Allowed, scene: Scene) -> None:
        """Note what the programme allowed in a control step: what hindered, and how far rows were relaxed."""
        self.relaxed = max(self.relaxed, allowed.relaxed)
        if allowed.blocking != NOTHING:
            row, named = allowed.blocking, len(scene.owners)
            # What clouds show has no lasting number.
            who = scene.owner_of(row) if row < named else len(scene.motions)
            self.blocking[who] = self.blocking.get(who, 0) + 1


@dataclass(eq=False)
class ExecutionLog(StepLog):
    """The log that an executor keeps, see `StepLog`.

    Attributes
    ----------
    evaluations, generations : totals of all plans
    first_plan : computing time until the first plan was found [s], None where there was none
    """

    evaluations: int = 0
    generations: int = 0
    first_plan: float | None = None


@dataclass(frozen=True, eq=False)
class Plan:
    """A verified motion that begins at an instant [s]; `certain` where the obstacles move as the file says."""

    motion: CoordinatedMotion
    begins: float
    certain: bool

    @property
    def ends(self) -> float:
        """Return the time at which the motion ends [s]."""
        return self.begins + self.motion.scene.duration

    def poses(self, *time: float) -> list[HandPoses]:
        """Return the poses of the rigid groups at some instants [s]; after the end, those of the goal."""
        s = np.clip((np.array(time) - self.begins) / self.motion.scene.duration, 0.0, 1.0)
        return [poses_at(self.motion.coordinates, q) for q in self.motion.at(s)[0]]


class Executor:
    """An executor that moves the load of a scene step by step among moving obstacles.

    Parameters
    ----------
    scene : the scene to be executed
    observer : observer of its obstacles; by default one that knows their motions
    seed : seed of the plans
    pace : periods and time budgets
    demonstration : a movement of one hand, or one for each, that plans should resemble from the present state on
    plan : a verified motion of the scene that is followed first; one is searched unless given

    Raises
    ------
    OptionError
        If the plan is one for another scene.

    Warns
    -----
    ComoveWarning
        If the demonstration is magnified by more than 3 or leaves the workspace, as for `solve`.

    Attributes
    ----------
    time : present time [s]
    poses : present poses of the rigid groups
    twists : array, shape (n_groups, 6), twists of the last step [m/s, rad/s]
    log : log of the execution
    """

    def __init__(
        self,
        scene: Scene,
        observer: Observer | None = None,
        *,
        seed: int = 0,
        pace: Pace | None = None,
        demonstration: DMP | PoseDMP | ProMP | tuple[DMP, ...] | None = None,
        plan: VerifiedMotion | None = None,
    ):
        scene = scene.in_one_way() if plan is None else scene.held_as_in(plan.motion.scene)
        require_no_rest(scene)
        self.scene, self.pace, self.seed = scene, pace or Pace(), seed
        if np.isfinite(scene.jerk_limit):
            message = (
                f"limits.jerk ({scene.jerk_limit:g} m/s^3) does not bind an execution, whose accelerations change "
                "from step to step; speed, acceleration and clearance do"
            )
            warnings.warn(message, ComoveWarning, stacklevel=2)
        self.demonstration = movements_of(demonstration, scene)
        if self.demonstration is not None:  # once, and not for the rest of it that every plan follows
            warn_of_adaptation(self.demonstration, scene)
        self.observer = Known(scene) if observer is None else observer
        self.log, self.n_steps = ExecutionLog(), 0
        self.poses, self.goal = poses_of(scene, "start"), poses_of(scene, "goal")
        self.twists = np.zeros((len(scene.groups), 6))
        self._before = np.zeros((len(scene.manipulators), 3))
        self.plan: Plan | None = None
        self._last: Plan | None = None  # that was followed
        self._interruption = Interruption()
        self._programme = TwistProgramme(scene, self.pace.period, ProgrammeSettings(spare=SETTINGS.spare))
        self._watched = self._planned = -np.inf
        self._patience = self.pace.patience
        self.observer.carried(self.time, nodes_of(self.scene, self.poses))
        if plan is not None:
            self._begin_with(plan)

    def _begin_with(self, plan: VerifiedMotion) -> None:
        if plan.motion.scene.sha256 != self.scene.sha256:
            raise OptionError(
                "the plan is one for another scene", key="plan", way_out="solve this scene, or leave it out"
            )
        self.plan = self._last = Plan(plan.motion, 0.0, self.observer.certain)
        self._tell(f"a plan that arrives at {self.plan.ends:.2f} s")

    @property
    def time(self) -> float:
        """Return the present time [s]."""
        return self.n_steps * self.pace.period

    @property
    def interrupted(self) -> bool:
        """Return whether Ctrl-C has ended the run."""
        return self._interruption.wished

    @property
    def arrived(self) -> bool:
        """Return whether the load is at its goal, at rest."""
        hands = self._hands(self.poses) - self._hands(self.goal)
        at_rest = np.abs(hand_velocities(self.scene, self.poses, self.twists)).max() <= SETTINGS.at_rest
        return bool(at_rest and np.linalg.norm(hands, axis=1).max() <= SETTINGS.at_goal)

    def step(self) -> None:
        """Perform one control step: see, decide, move."""
        self._keep_a_plan()
        begun = clock.perf_counter()
        period, now = self.pace.period, self.time
        if self.plan is not None and self.plan.certain:
            (there,) = self.plan.poses(now + period)
            self.twists = twists_between(self.scene, self.poses, there, period)
        else:
            self.twists = self._dodged(now)
        poses = advanced(self.poses, self.twists, period)
        self._before = (self._hands(poses) - self._hands(self.poses)) / period
        self.poses = poses
        self.n_steps += 1
        self.observer.carried(self.time, nodes_of(self.scene, self.poses))
        self.log.control.append(clock.perf_counter() - begun)

    @one_blas_thread()
    def run(self, budget: float) -> Record:
        """Execute until the load has arrived, or for `budget` [s] of simulated time, and return the record.

        Raises
        ------
        OptionError
            If the budget is not a positive number.
        """
        require_positive("budget", budget)
        poses = [self.poses]
        with self._interruption.noticed():
            while not (self.interrupted or self.time >= budget - 1e-9):
                self.step()
                poses.append(self.poses)
                if self.arrived and (self.plan is None or self.time >= self.plan.ends - 1e-9):
                    break
        if self.arrived or len(poses) == 1:
            poses.append(self.poses)  # and stands
        time = self.pace.period * np.arange(len(poses), dtype=np.float64)
        return Record(
            self.scene,
            time,
            np.array([p.center for p in poses]),
            np.array([p.quaternion for p in poses]),
            *self._truth(time),
        )

    @property
    def blocker(self) -> str:
        """Return what keeps the load from its goal, in words; empty where nothing is known to."""
        goal = self.goal
        nodes = nodes_of(self.scene, goal)
        seen = self.observer.observe(self.time)
        still = np.zeros_like(seen.velocity)
        there = going_on(self.scene, seen._replace(velocity=still), still, self.time)
        clearance, nearest = there.clearance_at(nodes)
        if clearance < self.scene.clearance:
            return f"{nearest} is where the load has to go"
        most = max(self.log.blocking, key=self.log.blocking.__getitem__, default=NOTHING)
        return "" if most == NOTHING else f"{self.scene.name_of(most)} was most in the way"

    def _truth(self, time: Array) -> tuple[Array, Array]:
        """Return the true positions of the obstacles, and their distances from their chords between the steps."""
        centers = self.observer.ground_truth(time)
        if self.observer.certain:
            return centers, self.scene.obstacle_sagittas(time)
        between = 0.5 * (time[1:] + time[:-1])
        return centers, np.linalg.norm(
            self.observer.ground_truth(between) - 0.5 * (centers[1:] + centers[:-1]), axis=2
        )

    def _dodged(self, now: float) -> Array:
        """Return the twists that the programme allows.

        The desired velocities are those of the plan, or without one of the way to the goal.
        """
        seen, period = self.observer.observe(now), self.pace.period
        if self.plan is None:
            wanted = self._homing()
        else:
            here, there = self.plan.poses(now, now + period)
            twists = twists_between(self.scene, here, there, period)
            twists = twists + twists_between(self.scene, self.poses, here, SETTINGS.catch_up)
            wanted = hand_velocities(self.scene, self.poses, twists)
        allowed = self._programme.allowed(self.poses, self._before, wanted, seen)
        self.log.note(allowed, self.scene)
        return allowed.twists

    def _homing(self) -> Array:
        """Return velocities of the hands straight to the goal, at moderate speed; array, shape (n_hands, 3) [m/s]."""
        twists = twists_between(self.scene, self.poses, self.goal, SETTINGS.homing)
        wanted = hand_velocities(self.scene, self.poses, twists)
        fastest = np.linalg.norm(wanted, axis=1).max()
        return wanted * min(1.0, SETTINGS.caution * min(self.scene.speed_limit, 1.0) / max(fastest, 1e-9))

    def _keep_a_plan(self) -> None:
        """Give up a plan that is expected to fail, and search for one where there is none."""
        if self.plan is not None and self.plan.certain:
            return
        now = self.time
        if self.plan is not None and now - self._watched >= self.pace.watch - 1e-9:
            self._watched = now
            reason = self._against(self.plan, now)
            if reason:
                self._tell(f"the plan is given up: {reason}")
                self.plan = None
        if self.plan is None and not self.arrived and now - self._planned >= self._patience - 1e-9:
            self._planned = now
            self._plan_anew(now)
            failed = self.plan is None
            self._patience = min(SETTINGS.most_patient, 2 * self._patience) if failed else self.pace.patience

    def _against(self, plan: Plan, now: float) -> str:
        """Return why a plan does not hold any more; empty if it does."""
        (there,) = plan.poses(now)
        behind = self._hands(self.poses) - self._hands(there)
        if np.linalg.norm(behind, axis=1).max() > SETTINGS.lost:
            return f"the load is {np.linalg.norm(behind, axis=1).max():.3g} m behind it"
        if now >= plan.ends:
            return "" if self.arrived else "its end is past"
        expected, scene = self.observer.predict(now), plan.motion.scene
        scene = replace(scene, obstacles=expected.obstacles, owners=expected.owners, motions=expected.motions)
        ahead = certify(replace(plan.motion, scene=scene), since=(now - plan.begins) / scene.duration)
        if ahead.lower < scene.clearance:
            return f"{scene.name_of(ahead.nearest)} would come too near at {plan.begins + ahead.time:.2f} s"
        return ""

    def _plan_anew(self, now: float) -> None:
        """Search for a plan from the present state on."""
        begun = clock.perf_counter()
        expected, seen = self.observer.predict(now), self.observer.observe(now)
        expected = replace(expected, obstacles=inflated(expected.obstacles, seen.margin))  # by their margins
        starts = tuple(
            GroupPose(center, matrices(quaternion))
            for center, quaternion in zip(self.poses.center, self.poses.quaternion, strict=True)
        )
        method, left = self._method(now), self.pace.haste if self.n_steps else self.pace.leisure
        for k, longer in enumerate(SETTINGS.longer):
            duration = longer * self._shortest(now)
            later = expected.resumed(now, duration, starts, self.twists)
            # What is left, half of it unless nothing is to be tried afterwards.
            budget = Budget(work=left / (1 + (longer != SETTINGS.longer[-1])))
            with warnings.catch_warnings(action="ignore", category=ComoveWarning):
                found = solve(
                    later,
                    demonstration=self._left_of_it(now),
                    seed=self.seed + 7 * self.n_steps + k,
                    method=method,
                    budget=budget,
                    progress=False,
                )
            left -= found.effort.work
            self.log.evaluations += found.effort.evaluations
            self.log.generations += found.effort.generations
            if found.motion is not None or (
                isinstance(method, Guide) and method.will_do(found.report, later)
            ):
                self.plan = self._last = Plan(found.attempt, now, self.observer.certain)
                self._tell(f"a plan that arrives at {now + duration:.2f} s")
                break
        else:
            if not (self.log.events and self.log.events[-1].what.startswith(NO_PLAN)):  # once is enough
                self._tell(f"{NO_PLAN}: {found.reasons[0]}")
        self.log.planning.append(clock.perf_counter() - begun)
        if self.plan is not None and self.log.first_plan is None:
            self.log.first_plan = sum(self.log.planning)

    def _left_of_it(self, now: float) -> dict[str, DMP] | None:
        """Return the rest of every hand's demonstration, None where it is nearly done or there is none."""
        done = now / self.scene.duration
        if self.demonstration is None or done > SETTINGS.nearly_done:
            return None
        rest = {own: _rest(own, done) for own in set(self.demonstration)}
        names = self.scene.manipulators
        return {name: rest[own] for name, own in zip(names, self.demonstration, strict=True)}

    def _method(self, now: float) -> Quick:
        """Return the planning method.

        A plan among obstacles that are not exactly known only guides the load, and the programme keeps the limits.
        """
        if self.n_steps == 0:
            return SETTINGS.at_leisure
        if self.observer.certain:
            return Quick()
        if self._last is None:
            return Guide()
        s = (now - self._last.begins) / self._last.motion.scene.duration
        return Guide(before=self._last.motion.at(np.linspace(min(s, 1.0), 1.0, SETTINGS.n_remembered))[0])

    def _shortest(self, now: float) -> float:
        """Return the duration of the first plan to try [s].

        It is the scene's remaining time, or more if the path needs it.
        """
        scene, hands = self.scene, self._hands(self.goal) - self._hands(self.poses)
        way = float(np.linalg.norm(hands, axis=1).max())
        at_the_limits = (
            SETTINGS.hurry * way / scene.speed_limit,
            4.0 * (way / scene.acceleration_limit) ** 0.5,
        )
        return max(scene.duration - now, *at_the_limits, SETTINGS.shortest)

    def _hands(self, poses: HandPoses) -> Array:
        """Return the hands at given poses; array, shape (n_manipulators, 3) [m]."""
        return nodes_of(self.scene, poses)[: len(self.scene.manipulators)]

    def _tell(self, what: str) -> None:
        self.log.events.append(Event(self.time, what))


def _rest(dmp: DMP, done: float) -> DMP:
    """Return the rest of a movement after the fraction `done` of it."""
    n_basis = max(20, dmp.weights.shape[1])
    time = np.linspace(done, 1.0, 10 * n_basis) * dmp.duration
    return DMP.fit(Demonstration(time - time[0], dmp.at(time).position, unit="any"), n_basis=n_basis)
