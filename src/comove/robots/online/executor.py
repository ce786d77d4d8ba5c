"""Online execution of a carry: measured joints in, commanded joints out, among obstacles that move.

A carry is planned and verified among what stands, and followed at its own pace. Every control step the joint
programme changes the wanted rates of all joints so that links and load keep clear of what is seen now, and the hands
keep hold of the load. Where the arms fall behind, the plan waits for them, and so it stops where the way is blocked;
where they wait too long, a new carry is planned around what is in the way.

The load is moved by the exact step of its twist, and joints are solved for its hands: so commands keep hold of it to
rounding, however long a run is. Measured joints slow the plan down where the robot does not come along.
"""

from __future__ import annotations

import time as clock
from array import array
from dataclasses import dataclass, field, replace

import numba
import numpy as np
from numpy.typing import NDArray

from comove.coordination.group_poses import HandPoses, poses_at
from comove.errors import OptionError, RobotError
from comove.execution.executor import Event
from comove.execution.observers import Functions, Observer
from comove.geometry.rotations import matrices
from comove.planning.objectives import LeastJerk
from comove.primitives.arguments import require_positive
from comove.reaction.qp_workspace import Sighting
from comove.reaction.twist_qp import NOTHING
from comove.reaction.twists import advanced, hand_velocities, nodes_of, poses_of, twists_between
from comove.robots.carry import RobotSolution, carry, robot_method
from comove.robots.carrying import RobotCarrier
from comove.robots.model import Robot
from comove.robots.online.joint_programme import JointProgramme, JointState
from comove.robots.online.link_rows import clearances_along, first_contact
from comove.robots.search.chains import Iteration, inside, reach_pose
from comove.robots.search.following import Arms, hand_rotation
from comove.robots.verification.verify import VerifiedJointMotion
from comove.scenes.groups import GroupPose
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

SHARES = (1.0, 0.9, 0.75, 0.5, 0.25, 0.0)  # of a twist, tried in turn
HOLDING = Iteration(gain=0.0, keep=0.0, tolerance=1e-10, steady=np.inf, most=30)
"""Iteration for the next command: redundant joints stay where the programme has taken them."""


@dataclass(frozen=True)
class OnlineSettings:
    """Settings of a run.

    Attributes
    ----------
    period : control period [s]
    leisure, haste : time that the first attempt to plan and any later one may take [s]; the robot stands meanwhile
    catch_up : time constant of the return to the plan [s]
    behind : distance of the hands behind the plan at which it waits [m]
    lag : difference of measured and commanded joints at which the plan waits [rad]
    lost : difference at which a robot does not come along any more [rad]
    foresight, every : time over which obstacles are foreseen to go on as they move now, and between two looks [s]
    patience : time that the plan may wait before another is looked for [s]; it doubles while none is found
    most_patient : longest time between two attempts [s]
    at_goal, at_rest : distance and speed of the hands at which a run ends [m, m/s]
    """

    period: float = 0.004
    leisure: float = 10.0
    haste: float = 2.0
    catch_up: float = 0.15
    behind: float = 0.05
    lag: float = 0.06
    lost: float = 0.5
    foresight: float = 1.5
    every: float = 0.02
    patience: float = 1.5
    most_patient: float = 6.0
    at_goal: float = 1e-3
    at_rest: float = 2e-3

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            require_positive(name, value)
        if not 1e-3 <= self.period <= 0.02:
            raise OptionError(
                f"a control period of {self.period} s", key="period", way_out="give 0.001 to 0.02 s"
            )


@dataclass(eq=False)
class OnlineLog:
    """The log of a run.

    Attributes
    ----------
    events : events in their order
    control, planning : computing time of every control step and of every attempt to plan [s]
    relaxed : by how much rows of the programme had to be relaxed at most [m/s]
    blocking : number of control steps in which an obstacle hindered most, by its number; -1 for the border
    stopped : number of control steps in which the robot had to stand at once
    """

    events: list[Event] = field(default_factory=list)
    control: array[float] = field(default_factory=lambda: array("d"))
    planning: list[float] = field(default_factory=list)
    relaxed: float = 0.0
    blocking: dict[int, int] = field(default_factory=dict)
    stopped: int = 0


class JointExecutor:
    """An executor that moves the joints of a robot that carries a load, step by step.

    Parameters
    ----------
    scene : the scene; obstacles may move
    robot : the robot, whose arms are the scene's manipulators
    observer : observer of the obstacles; one that sees places and velocities, and knows no future, unless given
    seed : seed of the plans
    settings : see `OnlineSettings`

    Attributes
    ----------
    position : array, shape (n_joints,), the joints commanded last, those of the robot that do not move included [rad]
    poses : poses of the load
    log : log of the run
    plan : the carry that is followed

    Raises
    ------
    SceneError, RobotError
        If the robot cannot hold the load at its start or goal, or no carry is found among what stands.
    """

    def __init__(
        self,
        scene: Scene,
        robot: Robot,
        observer: Observer | None = None,
        *,
        seed: int = 0,
        settings: OnlineSettings | None = None,
    ):
        self.scene, self.robot, self.seed = scene, robot, seed
        self.settings = settings or OnlineSettings()
        self.observer = Functions.of_motions(scene) if observer is None else observer
        self.log, self.n_steps = OnlineLog(), 0
        standing = scene.standing()
        self.plan = self._first_plan(standing)
        self.carrier = RobotCarrier(robot, standing.timed(self.plan.scene.duration))
        self.columns = np.concatenate([arm.columns for arm in self.carrier.holders])
        self.programme = JointProgramme(scene, self._arms(), self.carrier.grasp, self.settings.period)
        self._follow_plan()
        self.position = self.plan.joints.position[0].copy()
        self.rates, self._bend = np.zeros(len(self.columns)), np.zeros(len(self.columns))
        self.poses, self.goal = poses_of(scene, "start"), poses_of(scene, "goal")
        self._before = np.zeros((len(scene.manipulators), 3))
        self._phase, self._waited, self._patience = 0.0, 0.0, self.settings.patience
        self._looked, self._clear = -np.inf, 1.0

    @property
    def time(self) -> float:
        """Return the present time [s]."""
        return self.n_steps * self.settings.period

    @property
    def arrived(self) -> bool:
        """Return whether the load is at its goal, at rest."""
        n = len(self.scene.manipulators)
        off = nodes_of(self.scene, self.poses)[:n] - nodes_of(self.scene, self.goal)[:n]
        near = np.linalg.norm(off, axis=1).max() <= self.settings.at_goal
        return bool(near and np.linalg.norm(self._before, axis=1).max() <= self.settings.at_rest)

    def step(self, measured: Array) -> Array:
        """Perform one control step, and return the joints to command; arrays, shape (n_joints,) [rad].

        Raises
        ------
        RobotError
            If measured joints are no numbers, or far from what was commanded.
        """
        lag = self._lag(measured)
        seen = self.observer.observe(self.time)
        self._keep_a_plan(seen)
        begun = clock.perf_counter()
        self._advance(seen, lag)
        self.n_steps += 1
        self.log.control.append(clock.perf_counter() - begun)
        return self.position.copy()

    def _lag(self, measured: Array) -> float:
        """Return the largest difference of measured and commanded joints [rad]."""
        measured = np.asarray(measured, dtype=float)
        if measured.shape != self.position.shape or not np.isfinite(measured).all():
            raise RobotError(
                f"the measured joints are {np.array2string(measured, threshold=8)}",
                way_out=f"give {len(self.position)} finite numbers, in the order of joint_names",
            )
        apart = np.abs(measured - self.position)
        if apart.max() > self.settings.lost:
            name = self.robot.joint_names[int(apart.argmax())]
            raise RobotError(
                f"{name} is {apart.max():.2g} rad from where it was commanded at {self.time:.2f} s",
                way_out="look what holds it, or command slower",
            )
        return float(apart.max())

    def _advance(self, seen: Sighting, lag: float) -> None:
        """Move the load and the joints by one step of the programme."""
        how, scene, period = self.settings, self.scene, self.settings.period
        here, ahead, wanted_rates, behind = self._reference()
        pace = min(self._pace(behind, lag), self._foreseen(seen))
        twists = pace * twists_between(scene, here, ahead, period)
        twists = twists + twists_between(scene, self.poses, here, how.catch_up)
        wanted = hand_velocities(scene, self.poses, twists)
        joints = self.position[self.columns]
        now, _, _ = self.plan.joints.at(self._phase)
        drawn = pace * wanted_rates + (now[self.columns] - joints) / how.catch_up
        state = JointState(joints, self.rates, drawn, self._bend)
        allowed = self.programme.allowed_rates(self.poses, state, self._before, wanted, seen)
        self._note(allowed.relaxed, allowed.blocking)
        self._move(allowed.twists, self.programme.rates)
        self._phase = min(self._phase + pace * period, self.plan.joints.duration)
        waits = pace < 0.5 and self._phase < self.plan.joints.duration
        self._waited = self._waited + period if waits else 0.0

    def _move(self, twists: Array, rates: Array) -> None:
        """Move the load by a twist, or by a share of it with which the joints can come along, and the joints too."""
        scene, period, joints = self.scene, self.settings.period, self.position[self.columns]
        chains, n = self._arms().chains, len(self.scene.manipulators)
        at_first, roughest = nodes_of(scene, self.poses), np.inf
        poses, nodes, following = self.poses, at_first, joints
        for share in SHARES:
            there = advanced(self.poses, share * twists, period)
            then = nodes_of(scene, there)
            solved, missed = held(self._arms(), then, joints + share * period * rates)
            moved = (solved - joints) / period
            rough = float((np.abs(moved - self.rates) / (chains.acceleration * period)).max())
            if missed <= HOLDING.tolerance and (np.abs(moved) <= chains.velocity).all() and rough < roughest:
                poses, nodes, following, roughest = there, then, solved, rough
                if share == 1.0:
                    self._bend = moved - rates  # of the way that joints go in a step
            if roughest <= 1.0:
                break
        self.log.stopped += roughest == np.inf  # it cannot hold on: it stands
        self._before = (nodes[:n] - at_first[:n]) / period
        self.rates, self.poses = (following - joints) / period, poses
        self.position[self.columns] = following

    def _reference(self) -> tuple[HandPoses, HandPoses, Array, float]:
        """Return the plan's poses now and a period later, its joint rates, and how far hands are from it [m]."""
        motion, duration = self.plan.motion.motion, self.plan.joints.duration
        times = np.minimum(np.array([self._phase, self._phase + self.settings.period]), duration)
        here, ahead = (poses_at(motion.coordinates, q) for q in motion.at(times / duration)[0])
        _, rates, _ = self.plan.joints.at(self._phase)
        n = len(self.scene.manipulators)
        off = nodes_of(self.scene, self.poses)[:n] - nodes_of(self.scene, here)[:n]
        return here, ahead, rates[self.columns], float(np.linalg.norm(off, axis=1).max())

    def _pace(self, behind: float, lag: float) -> float:
        """Return the share of the plan's pace at which it goes on: 1 where arms come along, 0 where it waits."""
        how = self.settings
        left = min(1.0 - behind / how.behind, 2.0 * (1.0 - lag / how.lag))
        return float(np.clip(left, 0.0, 1.0))

    def _foreseen(self, seen: Sighting, n_looks: int = 12) -> float:
        """Return the share of the pace at which the plan may go on, as obstacles are foreseen to move.

        It is less than 1 where going on would meet something, and earlier than waiting would.
        """
        how = self.settings
        if self.time - self._looked < how.every - 1e-9 or not self.scene.moving.any():
            return self._clear
        self._looked = self.time
        times = np.linspace(0.0, how.foresight, n_looks + 1)[1:]
        motion, duration = self.plan.motion.motion, self.plan.joints.duration
        phases = np.minimum(self._phase + times, duration)
        going = np.ascontiguousarray(self.plan.joints.at(phases)[0][:, self.columns])
        nodes = motion.coordinates.motion(motion.at(phases / duration))[0]
        arms = self._arms()
        moves = self.scene.moving[self.scene.owners]
        need = np.where(moves, arms.around.clearance, -np.inf)  # among the rest the plan is verified
        met = first_contact(arms, going, np.ascontiguousarray(nodes), seen, times, need)
        if met == n_looks:
            self._clear = 1.0
            return self._clear
        here = np.repeat(self.position[self.columns][None], n_looks, axis=0)
        stays = np.repeat(nodes_of(self.scene, self.poses)[None], n_looks, axis=0)
        self._clear = met / n_looks if met <= first_contact(arms, here, stays, seen, times, need) else 1.0
        return self._clear

    def _note(self, relaxed: float, blocking: int) -> None:
        self.log.relaxed = max(self.log.relaxed, relaxed)
        if blocking != NOTHING:
            who = self.scene.owner_of(blocking)
            self.log.blocking[who] = self.log.blocking.get(who, 0) + 1

    def _first_plan(self, standing: Scene) -> VerifiedJointMotion:
        begun = clock.perf_counter()
        found = carry(standing, self.robot, seed=self.seed, budget=self.settings.leisure)
        self.log.planning.append(clock.perf_counter() - begun)
        if found.motion is None:
            raise RobotError(
                f"no carry is found among what stands: {found.solution.reasons[0]}",
                file=self.scene.path,
                way_out="solve it with 'comove robot solve' first",
            )
        self._tell(f"a plan of {found.motion.scene.duration:.2f} s")
        return found.motion

    def _keep_a_plan(self, seen: Sighting) -> None:
        """Look for another plan where the present one has waited too long."""
        at_rest = np.linalg.norm(self._before, axis=1).max() <= self.settings.at_rest
        if self._waited < self._patience or not at_rest:
            return
        begun = clock.perf_counter()
        found = self._around(seen)
        self.log.planning.append(clock.perf_counter() - begun)
        self._waited = 0.0
        if found.motion is None:
            self._patience = min(2.0 * self._patience, self.settings.most_patient)
            self._tell(f"no plan around what is in the way: {found.solution.reasons[0]}")
            return
        self.plan, self._phase, self._patience = found.motion, 0.0, self.settings.patience
        self._follow_plan()
        self._tell(f"another plan, of {found.motion.scene.duration:.2f} s")

    def _around(self, seen: Sighting) -> RobotSolution:
        """Plan a carry from the present joints around obstacles where they are now."""
        centers = self.observer.ground_truth(np.array([self.time]))[0]
        start = GroupPose(self.poses.center[0], matrices(self.poses.quaternion[0]))
        later = self.scene.standing(centers).resumed(
            0.0, self.plan.scene.duration, (start,), np.zeros((1, 6))
        )
        return carry(
            replace(later, begins=0.0).limited(clearance=self._left(later)).timed(None),
            self.robot,
            seed=self.seed + self.n_steps,
            method=replace(robot_method(), n_ways=1, n_plans=1),
            objective=LeastJerk(),
            budget=self.settings.haste,
            begin=self.position,
        )

    def _left(self, later: Scene, share: float = 0.8, least: float = 1e-3) -> float:
        """Return the clearance that a plan from here can keep: the scene's, or most of what is left of it [m]."""
        nodes, joints = nodes_of(self.scene, self.poses), self.position[self.columns]
        obstacle, other = clearances_along(
            self._arms(), joints[None], nodes[None], later.obstacles, later.clearance
        )
        of_load = later.clearance_at(nodes)[0]
        left = min(of_load, other, obstacle.min(initial=np.inf))
        return later.clearance if left >= later.clearance else max(share * left, least)

    def _follow_plan(self, n_steps: int = 201) -> None:
        """Tell the programme which clearances the plan has."""
        motion, joints = self.plan.motion.motion, self.plan.joints
        s = np.linspace(0.0, 1.0, n_steps)
        along = np.ascontiguousarray(joints.at(s * joints.duration)[0][:, self.columns])
        nodes = np.ascontiguousarray(motion.coordinates.motion(motion.at(s))[0])
        self.programme.follow(along, nodes)

    def _arms(self) -> Arms:
        return self.carrier.arms

    def _tell(self, what: str) -> None:
        self.log.events.append(Event(self.time, what))


@numba.njit(cache=True, error_model="numpy")
def held(arms: Arms, nodes: Array, guess: Array) -> tuple[Array, float]:
    """Solve the joints that hold the load where it is, near a guess; returns them and the largest residual [m].

    Parameters
    ----------
    nodes : array, shape (n_nodes, 3), hands first [m]
    guess : array, shape (n_joints,) [rad]
    """
    q, rotation, worst = guess.copy(), np.empty((3, 3)), 0.0
    for j in range(q.shape[0]):
        q[j] = inside(arms.chains, j, q[j], 0.0)
    for i in range(arms.chains.first.shape[0] - 1):
        hand_rotation(arms.around, nodes, i, rotation)
        worst = max(worst, reach_pose(arms.chains, i, rotation, nodes[i], guess, HOLDING, q))
    return q, worst
