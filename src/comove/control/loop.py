"""The control loop of an execution: replan, filter, move and log.

A `Replanner` keeps the reference: poses of the rigid groups, and joints where arms hold them. Where it is certified
for exactly known motions it is followed exactly; otherwise the safety filter changes its velocities to keep clear of
the observed obstacles. `comove.control.Executor` moves free end effectors,
`comove.robots.online.executor.JointExecutor` arms.
"""

from __future__ import annotations

import time as clock
from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from comove.arrays import Array
from comove.control.observers import Observer, going_on
from comove.control.safety.cbf_qp import NO_JOINTS, NOTHING, Allowed, JointState, SafetyFilter
from comove.control.safety.twists import advanced, hand_velocities, nodes_of, poses_of, twists_between
from comove.dmp.arguments import require_positive
from comove.model.coordinates import HandPoses
from comove.model.scene import Scene
from comove.planning.search import Interruption
from comove.processes import one_blas_thread
from comove.verification.record import Record


@dataclass(frozen=True)
class Event:
    """An event of an execution: its time [s] and description."""

    time: float
    what: str


KEPT = 100_000  # control steps, attempts to plan and events that a log has at most: a robot may run for weeks


BRAKING = 1.0  # s, at most, until a run whose budget is spent is at rest


def _latest() -> deque[Any]:
    return deque(maxlen=KEPT)


@dataclass(eq=False)
class ExecutionLog:
    """The log of an execution. Its size is bounded: it holds the latest steps, plans and events.

    Attributes
    ----------
    events : events in their order
    control, planning : computing times of control steps, and of attempts to plan [s]
    plans, planned : number of all attempts to plan, and the computing time of those within control steps [s]
    blocking : number of control steps in which an obstacle hindered most, by the obstacle's number; -1 for the
        border, the number of the file's obstacles for all else that is seen
    relaxed : by how much the safety filter had to relax its rows at most [m/s]
    stopped : number of control steps in which arms had to stop at once
    evaluations, generations : totals of all plans
    first_plan : computing time until the first plan was found [s], None where there was none
    """

    events: deque[Event] = field(default_factory=_latest)
    control: deque[float] = field(default_factory=_latest)
    planning: deque[float] = field(default_factory=_latest)
    plans: int = 0
    planned: float = 0.0
    blocking: dict[int, int] = field(default_factory=dict)
    relaxed: float = 0.0
    stopped: int = 0
    evaluations: int = 0
    generations: int = 0
    first_plan: float | None = None

    def note_plan(self, time: float, *, aside: bool = False) -> None:
        """Note an attempt to plan and its computing time [s].

        Parameters
        ----------
        aside : whether it was computed beside the control steps
        """
        self.planning.append(time)
        self.plans, self.planned = self.plans + 1, self.planned + (0.0 if aside else time)

    def note(self, allowed: Allowed, scene: Scene) -> None:
        """Note the safety filter's result: blocking obstacle and relaxation."""
        self.relaxed = max(self.relaxed, allowed.relaxed)
        if allowed.blocking != NOTHING:
            row, named = allowed.blocking, len(scene.owners)
            # What clouds show has no lasting number.
            who = scene.owner_of(row) if row < named else len(scene.motions)
            self.blocking[who] = self.blocking.get(who, 0) + 1

    def quantile(self, q: float) -> float | None:
        """Return a quantile of the control steps' computing times [s]; None without steps."""
        return float(np.quantile(self.control, q)) if self.control else None

    @property
    def summary(self) -> dict[str, Any]:
        """Return the execution's part of every stored summary."""
        return {
            "plans": self.plans,
            "control_s_median": self.quantile(0.5),
            "control_s_p999": self.quantile(0.999),
            "relaxed_max": self.relaxed,
            "events": [{"time": event.time, "what": event.what} for event in self.events],
        }


class Setpoint(NamedTuple):
    """The setpoint of one control step, on the reference.

    Attributes
    ----------
    here, ahead : its poses now and a period later
    exact : whether it is certified, and followed exactly
    joints, rates : arrays, shape (n_joints,), its joints and their rates [rad, rad/s]
    """

    here: HandPoses
    ahead: HandPoses
    exact: bool = False
    joints: Array = np.zeros(0)
    rates: Array = np.zeros(0)


class Replanner(ABC):
    """The base class of reference generators for a control loop."""

    @abstractmethod
    def update(self, run: ControlLoop) -> None:
        """Predict along the reference; replace it on failure or for a better one."""

    @abstractmethod
    def current(self, run: ControlLoop) -> Setpoint:
        """Return the setpoint of the present control step."""

    def advance(self, run: ControlLoop, pace: float) -> None:  # noqa: B027  a reference in time needs none
        """Advance by a control period, at a share of the reference's speed."""


class LoopSettings(Protocol):
    """The settings that every control loop needs.

    Attributes
    ----------
    catch_up : time constant of the return to the reference [s]
    at_goal, at_rest : distance and speed of the end effectors at which an execution ends [m, m/s]
    """

    @property
    def catch_up(self) -> float: ...
    @property
    def at_goal(self) -> float: ...
    @property
    def at_rest(self) -> float: ...


class HandStates(NamedTuple):
    """End effectors and their mean velocities; arrays, shape (n_manipulators, 3) [m, m/s]."""

    position: Array
    velocity: Array


class Standstill(Replanner):
    """A reference that stays where the payload is."""

    def update(self, run: ControlLoop) -> None:
        """Do nothing."""

    def current(self, run: ControlLoop) -> Setpoint:
        """Return the present poses and joints."""
        return Setpoint(run.poses, run.poses, joints=run.joints, rates=np.zeros_like(run.joints))


class ControlLoop:
    """The base of executors: one control step after the other.

    Parameters
    ----------
    scene : the scene to be executed
    observer : observer of its obstacles
    settings : when it has arrived, and how it returns to the reference
    """

    replanner: Replanner
    filter: SafetyFilter

    def __init__(self, scene: Scene, observer: Observer, settings: LoopSettings):
        self.scene, self.observer, self.settings = scene, observer, settings
        self.log, self.n_steps, self.goal = ExecutionLog(), 0, poses_of(scene, "goal")
        self._interruption = Interruption()
        self._stop_at(poses_of(scene, "start"))

    def _stop_at(self, poses: HandPoses) -> None:
        """Rest at some poses."""
        self.poses, self.twists = poses, np.zeros((len(self.scene.groups), 6))
        self._hands = HandStates(hands := self.hands(poses), np.zeros_like(hands))

    @property
    def period(self) -> float:
        """Return the control period [s]."""
        return self.filter.period

    @property
    def time(self) -> float:
        """Return the present time [s]."""
        return self.n_steps * self.period

    @property
    def arrived(self) -> bool:
        """Return whether the payload is at its goal, at rest."""
        return self._speed <= self.settings.at_rest and self.distance_from(self.goal) <= self.settings.at_goal

    @property
    def _speed(self) -> float:
        """Return the largest end-effector speed of the last step [m/s]."""
        return float(np.linalg.norm(self._hands.velocity, axis=1).max())

    @property
    def joints(self) -> Array:
        """Return the commanded joints of the arms, empty without arms; array, shape (n_joints,) [rad]."""
        return np.zeros(0)

    @property
    def ended(self) -> bool:
        """Return whether the execution has ended."""
        return self.arrived

    @property
    def interrupted(self) -> bool:
        """Return whether Ctrl-C has ended the run."""
        return self._interruption.wished

    @one_blas_thread()
    def run(self, budget: float) -> Record:
        """Execute until arrival, or for `budget` [s] of simulated time.

        Commands are followed exactly. A payload that still moves when the budget is spent brakes within its limits,
        for up to `BRAKING` s more.

        Raises
        ------
        OptionError
            If the budget is not a positive number.
        """
        require_positive("budget", budget)
        poses, joints, replanner = [self.poses], [self.joints], self.replanner
        with self._interruption.noticed():
            try:
                while not (self.interrupted or self.time >= budget + BRAKING - 1e-9):
                    if self.time >= budget - 1e-9:
                        if self._speed <= self.settings.at_rest:
                            break
                        self.replanner = Standstill()
                    self._follow()
                    poses.append(self.poses)
                    joints.append(self.joints)
                    if self.ended:
                        break
            finally:
                self.replanner = replanner
        if self.arrived or len(poses) == 1:
            poses.append(self.poses)  # and stands
            joints.append(self.joints)
        return self._recorded(self.record(poses), joints)

    def _follow(self) -> None:
        raise NotImplementedError

    def _recorded(self, record: Record, joints: list[Array]) -> Record:
        """Return a record with the joints, (n_joints,), at its times, if any."""
        return record

    def record(self, poses: list[HandPoses], scene: Scene | None = None) -> Record:
        """Return the record of poses at every control step. The obstacles' motions are those of `scene`, if given."""
        time = self.period * np.arange(len(poses), dtype=np.float64)
        known = None if scene is None else (scene.centers_at(time), scene.obstacle_sagittas(time))
        return Record(
            scene or self.scene,
            time,
            np.array([p.center for p in poses]),
            np.array([p.quaternion for p in poses]),
            *(known or self._truth(time)),
        )

    @property
    def blocker(self) -> str:
        """Return the known reason why the payload is not at its goal. It is empty if none is known."""
        seen = self.observer.observe(self.time)
        still = np.zeros_like(seen.velocity)
        there = going_on(self.scene, seen._replace(velocity=still), still, self.time)
        clearance, nearest = there.clearance_at(nodes_of(self.scene, self.goal), self.time)
        if clearance < self.scene.clearance:
            return f"{nearest} is where the load has to go"
        most = max(self.log.blocking, key=self.log.blocking.__getitem__, default=NOTHING)
        return "" if most == NOTHING else f"{self.scene.name_of(most)} was most in the way"

    def _truth(self, time: Array) -> tuple[Array, Array]:
        """Return the obstacles' true positions and their chord deviations between steps."""
        centers = self.observer.ground_truth(time)
        if self.observer.certain:
            return centers, self.scene.obstacle_sagittas(time)
        between = 0.5 * (time[1:] + time[:-1])
        return centers, np.linalg.norm(
            self.observer.ground_truth(between) - 0.5 * (centers[1:] + centers[:-1]), axis=2
        )

    def distance_from(self, poses: HandPoses) -> float:
        """Return the largest distance [m] of an end effector from other poses."""
        return float(np.linalg.norm(self._hands.position - self.hands(poses), axis=1).max())

    def hands(self, poses: HandPoses) -> Array:
        """Return the end effectors at given poses; array, shape (n_manipulators, 3) [m]."""
        return nodes_of(self.scene, poses)[: len(self.scene.manipulators)]

    def let_pass(self, until: float) -> None:
        """Let time pass without a control step, until an instant [s]. What is executed rests."""
        self.n_steps = max(self.n_steps, round(until / self.period))

    def tell(self, what: str) -> None:
        """Add an event to the log."""
        self.log.events.append(Event(self.time, what))

    def _step(self, lag: float = 0.0) -> None:
        """Perform one control step: replan, filter, move."""
        begun = clock.perf_counter() - self.log.planned
        self.replanner.update(self)
        self._advance(lag)
        self.n_steps += 1
        self.log.control.append(clock.perf_counter() - self.log.planned - begun)

    def _advance(self, lag: float) -> None:
        """Move by one control step. The last command was missed by `lag`."""
        reference = self.replanner.current(self)
        if reference.exact:
            self.twists = twists_between(self.scene, self.poses, reference.ahead, self.period)
            self._move(np.zeros(0))
            return
        pace, joints = self._paced(reference, lag)
        twists = pace * twists_between(self.scene, reference.here, reference.ahead, self.period)
        twists = twists + twists_between(self.scene, self.poses, reference.here, self.settings.catch_up)
        wanted = hand_velocities(self.scene, self.poses, twists)
        seen = self.observer.observe(self.time)
        allowed = self.filter.allowed(self.poses, self._hands.velocity, wanted, seen, joints)
        self.log.note(allowed, self.scene)
        self.twists = allowed.twists
        self._move(allowed.rates)
        self.replanner.advance(self, pace)

    def _paced(self, reference: Setpoint, lag: float) -> tuple[float, JointState]:
        """Return the reference's time scaling, 0 to 1, and the joints' state."""
        return 1.0, NO_JOINTS

    def _move(self, rates: Array) -> None:
        """Move the rigid groups by their twists, and joints by their rates."""
        self._placed(advanced(self.poses, self.twists, self.period))

    def _placed(self, poses: HandPoses) -> None:
        """Set the poses at the end of the step."""
        hands = self.hands(poses)
        self._hands = HandStates(hands, (hands - self._hands.position) / self.period)
        self.poses = poses
