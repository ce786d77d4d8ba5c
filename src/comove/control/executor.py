"""Online execution among moving obstacles: follow a plan, evade, stop in time, plan anew.

Every control step asks what is observed. A plan that is certified for exactly known motions is followed exactly.
Otherwise the safety filter modifies the plan's velocities to keep clear of the obstacles that are seen now; where the
path is blocked the payload slows down and evades until it is free. A plan that seems not to hold any more is replaced
by one from the present state on.
"""

from __future__ import annotations

import time as clock
import warnings
from array import array
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.control.observers import Known, Observer, going_on
from comove.control.replanning import Pace, Plan, PlanReplanner, Reference, Replanner
from comove.control.safety.cbf_qp import NO_JOINTS, NOTHING, Allowed, FilterSettings, JointState, SafetyFilter
from comove.control.safety.twists import advanced, hand_velocities, nodes_of, poses_of, twists_between
from comove.dmp.arguments import require_positive
from comove.dmp.dmp import DMP
from comove.dmp.poses import PoseDMP
from comove.dmp.probabilistic import ProMP
from comove.errors import ComoveWarning, OptionError
from comove.model.coordinates import HandPoses
from comove.model.resting import require_no_rest
from comove.model.scene import Scene
from comove.planning.arguments import movements_of, warn_of_adaptation
from comove.planning.search import Interruption
from comove.processes import one_blas_thread
from comove.verification.record import Record
from comove.verification.verify import VerifiedMotion

SPARE = 5e-4  # m on top of the scene's clearance, as an execution is verified between its steps as well


@dataclass(frozen=True)
class Event:
    """An event of an execution, which happened at `time` [s] and is described by `what`."""

    time: float
    what: str


@dataclass(eq=False)
class ExecutionLog:
    """The log of an execution, step by step.

    Attributes
    ----------
    events : events in their order
    control, planning : computing time of every control step, and of every attempt to plan [s]
    blocking : number of control steps in which an obstacle hindered most, by the obstacle's number; -1 for the
        border, the number of the file's obstacles for all else that is seen
    relaxed : by how much the safety filter had to relax its rows at most [m/s]
    stopped : number of control steps in which arms had to stand at once
    evaluations, generations : totals of all plans
    first_plan : computing time until the first plan was found [s], None where there was none
    """

    events: list[Event] = field(default_factory=list)
    control: array[float] = field(default_factory=lambda: array("d"))
    planning: list[float] = field(default_factory=list)
    blocking: dict[int, int] = field(default_factory=dict)
    relaxed: float = 0.0
    stopped: int = 0
    evaluations: int = 0
    generations: int = 0
    first_plan: float | None = None

    def note(self, allowed: Allowed, scene: Scene) -> None:
        """Note what the safety filter allowed: what hindered, and how far rows were relaxed."""
        self.relaxed = max(self.relaxed, allowed.relaxed)
        if allowed.blocking != NOTHING:
            row, named = allowed.blocking, len(scene.owners)
            # What clouds show has no lasting number.
            who = scene.owner_of(row) if row < named else len(scene.motions)
            self.blocking[who] = self.blocking.get(who, 0) + 1

    def quantile(self, q: float) -> float | None:
        """Return a quantile of the computing times of control steps [s]; None without a step."""
        return float(np.quantile(self.control, q)) if self.control else None

    @property
    def summary(self) -> dict[str, Any]:
        """Return what the summary of every stored execution says of it."""
        return {
            "plans": len(self.planning),
            "control_s_median": self.quantile(0.5),
            "control_s_p999": self.quantile(0.999),
            "relaxed_max": self.relaxed,
            "events": [{"time": event.time, "what": event.what} for event in self.events],
        }


class ControlLoop:
    """The base of executors: one control step after the other.

    Parameters
    ----------
    scene : the scene to be executed
    observer : observer of its obstacles
    period : control period [s]

    Attributes
    ----------
    catch_up : time constant of the return to the reference [s]
    at_goal, at_rest : distance and speed of the end effectors at which an execution ends [m, m/s]
    """

    replanner: Replanner
    filter: SafetyFilter
    catch_up, at_goal, at_rest = 0.1, 5e-4, 5e-4

    def __init__(self, scene: Scene, observer: Observer, period: float):
        self.scene, self.observer, self.period = scene, observer, period
        self.log, self.n_steps, self.goal = ExecutionLog(), 0, poses_of(scene, "goal")
        self._stop_at(poses_of(scene, "start"))

    def _stop_at(self, poses: HandPoses) -> None:
        """Be at rest at some poses."""
        self.poses, self.twists = poses, np.zeros((len(self.scene.groups), 6))
        self._before = np.zeros((len(self.scene.manipulators), 3))

    @property
    def time(self) -> float:
        """Return the present time [s]."""
        return self.n_steps * self.period

    @property
    def arrived(self) -> bool:
        """Return whether the payload is at its goal, at rest."""
        at_rest = np.linalg.norm(self._before, axis=1).max() <= self.at_rest
        return bool(at_rest and self.distance_from(self.goal) <= self.at_goal)

    @property
    def joints(self) -> Array:
        """Return the commanded joints of the arms, none of end effectors alone; array, shape (n_joints,) [rad]."""
        return np.zeros(0)

    def distance_from(self, poses: HandPoses) -> float:
        """Return the largest distance of an end effector from its place at other poses [m]."""
        return float(np.linalg.norm(self.hands(self.poses) - self.hands(poses), axis=1).max())

    def hands(self, poses: HandPoses) -> Array:
        """Return the end effectors at given poses; array, shape (n_manipulators, 3) [m]."""
        return nodes_of(self.scene, poses)[: len(self.scene.manipulators)]

    def tell(self, what: str) -> None:
        """Add an event to the log."""
        self.log.events.append(Event(self.time, what))

    def _step(self, lag: float = 0.0) -> None:
        """Perform one control step: replan, filter, move."""
        begun, n_planned = clock.perf_counter(), len(self.log.planning)
        self.replanner.update(self)
        self._advance(lag)
        self.n_steps += 1
        planned = sum(self.log.planning[n_planned:])
        self.log.control.append(clock.perf_counter() - begun - planned)

    def _advance(self, lag: float) -> None:
        """Move by one control step, of whose commands the last one is missed by `lag`."""
        reference = self.replanner.current(self)
        if reference.exact:
            self.twists = twists_between(self.scene, self.poses, reference.ahead, self.period)
            self._move(np.zeros(0))
            return
        pace = self._pace(reference, lag)
        twists = pace * twists_between(self.scene, reference.here, reference.ahead, self.period)
        twists = twists + twists_between(self.scene, self.poses, reference.here, self.catch_up)
        wanted, joints = hand_velocities(self.scene, self.poses, twists), self._joint_state(reference, pace)
        seen = self.observer.observe(self.time)
        allowed = self.filter.allowed(self.poses, self._before, wanted, seen, joints)
        self.log.note(allowed, self.scene)
        self.twists = allowed.twists
        self._move(allowed.rates)
        self.replanner.advance(self, pace)

    def _pace(self, reference: Reference, lag: float) -> float:
        """Return the share of the reference's pace at which it goes on."""
        return 1.0

    def _joint_state(self, reference: Reference, pace: float) -> JointState:
        """Return the state of the joints for the safety filter, which end effectors alone do not have."""
        return NO_JOINTS

    def _move(self, rates: Array) -> None:
        """Move the rigid groups by their twists, and joints by their rates."""
        self._placed(advanced(self.poses, self.twists, self.period))

    def _placed(self, poses: HandPoses) -> None:
        """Be at the poses at the end of the step."""
        self._before = (self.hands(poses) - self.hands(self.poses)) / self.period
        self.poses = poses


class Executor(ControlLoop):
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
        if np.isfinite(scene.jerk_limit):
            message = (
                f"limits.jerk ({scene.jerk_limit:g} m/s^3) does not bind an execution, whose accelerations change "
                "from step to step; speed, acceleration and clearance do"
            )
            warnings.warn(message, ComoveWarning, stacklevel=2)
        movements, pace = movements_of(demonstration, scene), pace or Pace()
        if movements is not None:  # once, and not for the rest of it that every plan follows
            warn_of_adaptation(movements, scene)
        super().__init__(scene, Known(scene) if observer is None else observer, pace.period)
        self.filter = SafetyFilter(scene, pace.period, FilterSettings(spare=SPARE))
        self.replanner: PlanReplanner = PlanReplanner(movements, seed, pace)
        self._interruption = Interruption()
        self.observer.carried(self.time, nodes_of(scene, self.poses))
        if plan is not None:
            if plan.motion.scene.sha256 != scene.sha256:
                raise OptionError(
                    "the plan is one for another scene",
                    key="plan",
                    way_out="solve this scene, or leave it out",
                )
            self.replanner.follow(self, Plan(plan.motion, 0.0, self.observer.certain))

    @property
    def plan(self) -> Plan | None:
        """Return the plan that is followed, None where there is none."""
        return self.replanner.plan

    @property
    def interrupted(self) -> bool:
        """Return whether Ctrl-C has ended the run."""
        return self._interruption.wished

    @property
    def ended(self) -> bool:
        """Return whether the payload has arrived, and the plan has come to its end."""
        return self.arrived and (self.plan is None or self.time >= self.plan.ends - 1e-9)

    def step(self) -> None:
        """Perform one control step: observe, replan, filter, move."""
        self._step()
        self.observer.carried(self.time, nodes_of(self.scene, self.poses))

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
                if self.ended:
                    break
        if self.arrived or len(poses) == 1:
            poses.append(self.poses)  # and stands
        return self.record(poses)

    def record(self, poses: list[HandPoses], scene: Scene | None = None) -> Record:
        """Return the record of poses at every control step, on a scene in which obstacles moved as they did."""
        time = self.period * np.arange(len(poses), dtype=np.float64)
        if scene is None:
            truth = self._truth(time)
        else:
            truth = scene.centers + scene.offsets(time), scene.obstacle_sagittas(time)
        return Record(
            scene or self.scene,
            time,
            np.array([p.center for p in poses]),
            np.array([p.quaternion for p in poses]),
            *truth,
        )

    @property
    def blocker(self) -> str:
        """Return what keeps the load from its goal, in words; empty where nothing is known to."""
        goal = self.goal
        nodes = nodes_of(self.scene, goal)
        seen = self.observer.observe(self.time)
        still = np.zeros_like(seen.velocity)
        there = going_on(self.scene, seen._replace(velocity=still, spin=still), still, self.time)
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
