"""Online execution by arms: measured joints in, commanded joints out, among moving obstacles.

A transfer motion is planned and verified among the static obstacles, and followed until contact with a moving
obstacle is predicted: then the online replanner chooses another path in time (`comove.robots.online.pilot`). Every
control step the safety filter changes the desired rates of all joints so that links and payload keep clear of the
observed obstacles, and the end effectors keep their grasps. Where the arms lag, the reference waits for them.

The payload is moved by the exact step of its twist, and joints are solved for its end effectors: so commands keep the
grasps to rounding, however long a run is. Measured joints that lag slow the plan down. A displaced robot raises an
error, and can be made compliant until it rests, to continue from there.
"""

from __future__ import annotations

import time as clock
from dataclasses import dataclass, field, fields
from itertools import product

import numpy as np

from comove.arrays import Array
from comove.control.clouds import Clouds
from comove.control.loop import ControlLoop, ExecutionLog, Setpoint
from comove.control.observers import Functions, Observer
from comove.control.safety.cbf_qp import FilterSettings, JointState, SafetyFilter
from comove.control.safety.twists import nodes_of, poses_of
from comove.dmp.arguments import require_positive
from comove.errors import OptionError, RobotError
from comove.geometry.rotations import quaternion_of_rotation
from comove.model.coordinates import HandPoses
from comove.model.resting import require_no_rest
from comove.model.scene import Scene
from comove.planning.clock import Budget
from comove.robots.carrying import RobotCarrier
from comove.robots.model import Robot
from comove.robots.online.arm_rows import ArmRows, JointSettings
from comove.robots.online.course_finder import CourseFinder
from comove.robots.online.holding import HoldingArms
from comove.robots.online.pilot import Pilot, PilotSettings, movers
from comove.robots.online.recovery import Recovery, RecoverySettings, at_ease, way_back
from comove.robots.online.reference import MotionReference
from comove.robots.solving import solve_joints
from comove.robots.verification.verify import VerifiedJointMotion
from comove.verification.record import Record


@dataclass(frozen=True)
class OnlineSettings:
    """Settings of a run.

    Attributes
    ----------
    period : control period [s]
    leisure : work of the search for the plan, before anything moves, as `Budget.work`
    catch_up : time constant of the return to the reference [s]
    behind : distance of the end effectors behind the reference at which it waits [m]
    near_by : distance of the end effectors from the reference up to which its prediction holds for them [m]
    lag : difference of measured and commanded joints at which the reference waits [rad]
    lost : difference at which a robot counts as displaced [rad]
    at_goal, at_rest : distance and speed of the end effectors at which a run ends [m, m/s]
    filter, joints, pilot, recovery : settings of the safety filter, of the arms' rows in it, of the online replanner,
        and of the recovery of a displaced robot
    """

    period: float = 0.004
    leisure: float = 10.0
    catch_up: float = 0.15
    behind: float = 0.05
    near_by: float = 0.02
    lag: float = 0.06
    lost: float = 0.5
    at_goal: float = 1e-3
    at_rest: float = 2e-3
    filter: FilterSettings = field(default_factory=lambda: FilterSettings(spare=5e-4))
    joints: JointSettings = field(default_factory=JointSettings)
    pilot: PilotSettings = field(default_factory=PilotSettings)
    recovery: RecoverySettings = field(default_factory=RecoverySettings)

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name not in ("filter", "joints", "pilot", "recovery"):
                require_positive(name, value)
        if not 1e-3 <= self.period <= 0.02:
            raise OptionError(
                f"a control period of {self.period} s", key="period", way_out="give 0.001 to 0.02 s"
            )


@dataclass(frozen=True, eq=False, repr=False)
class JointRecord(Record):
    """The record of an execution by exactly followed joint commands.

    Attributes
    ----------
    robot : the robot
    joints : array, shape (n_steps, n_joints), all its joints at the times of the record [rad]
    """

    robot: Robot
    joints: Array


class JointExecutor(ControlLoop):
    """An executor of a robot that holds a payload, step by step.

    Parameters
    ----------
    scene : the scene; obstacles may move
    robot : the robot, whose arms are the scene's manipulators
    observer : observer of the obstacles; by default one of present places and velocities
    plan : verified motion of the scene that is followed first; planned unless given
    seed : seed of the plans
    settings : see `OnlineSettings`

    Attributes
    ----------
    held : the arms that hold the payload, with the joints commanded last
    poses : poses of the payload
    log : log of the run
    plan : the current transfer motion

    Raises
    ------
    OptionError
        If the observer is one of `Clouds`: links are checked against obstacles that a scene names.
    SceneError, RobotError
        If the robot cannot hold the payload at its start or goal, or no transfer motion is found among static
        obstacles.
    """

    settings: OnlineSettings

    def __init__(
        self,
        scene: Scene,
        robot: Robot,
        observer: Observer | None = None,
        *,
        plan: VerifiedJointMotion | None = None,
        seed: int = 0,
        settings: OnlineSettings = OnlineSettings(),
    ):
        require_no_rest(scene)
        if isinstance(observer, Clouds):
            way_out = "name what moves in the scene, and give Observed(scene), which takes measured places"
            raise OptionError(
                "arms keep clear of what a scene names, not of clouds", key="observer", way_out=way_out
            )
        begun = clock.perf_counter()
        self.plan = self._first_plan(scene, robot, settings, seed) if plan is None else plan
        planned, scene = clock.perf_counter() - begun, scene.held_as_in(self.plan.scene)
        standing = scene.standing()
        carrier = RobotCarrier(robot, standing.timed(self.plan.scene.duration))
        observer = Functions.of_motions(scene) if observer is None else observer
        super().__init__(scene, observer, settings)
        rows = ArmRows(scene, carrier.arms, carrier.grasp, settings.period, settings.joints)
        self.filter = SafetyFilter(scene, settings.period, settings.filter, rows)
        self.held = HoldingArms(carrier, rows, self.plan.joints.position[0])
        self.log.note_plan(planned)
        self.tell(f"a plan of {self.plan.scene.duration:.2f} s")
        self._follow_plan()
        stands = ~scene.moving[scene.owners]
        finder = CourseFinder(
            standing,
            rows.arms,
            self.plan.motion.motion.coordinates,
            MotionReference.of_plan(self.plan, self.held.columns, settings.pilot.reference),
            rows.needs._replace(obstacle=rows.needs.obstacle[stands]),
            goals=np.array([np.concatenate(q) for q in product(*carrier.goals)]),
            seed=seed,
            settings=settings.pilot.finder,
        )
        self.replanner: Pilot = Pilot(finder, settings.pilot)
        self._rehearse()
        self._stand_at_start()

    def _rehearse(self) -> None:
        """Make a step to load all kernels and the roadmap. The first step of a run would take seconds."""
        self._stand_at_start()
        log, self.log = self.log, ExecutionLog()
        self._advance(0.0)
        if self.scene.moving.any():
            self.replanner.prepare(movers(self.scene, self.observer.observe(0.0)))
        self.log = log

    def _stand_at_start(self) -> None:
        """Rest at the beginning of the plan."""
        self._stop_at(poses_of(self.scene, "start"))
        self.held.rest(self.plan.joints.position[0][self.held.columns])
        self.replanner.waited = self.replanner.clock = 0.0
        self._recovery: Recovery | None = None

    @property
    def robot(self) -> Robot:
        """Return the robot."""
        return self.held.carrier.robot

    @property
    def position(self) -> Array:
        """Return the joints commanded last, those that do not move included; array, shape (n_joints,) [rad]."""
        return self.held.position

    @property
    def joints(self) -> Array:
        """Return the commanded joints of the arms; array, shape (n_arm_joints,) [rad]."""
        return self.held.joints

    @property
    def driven_off(self) -> bool:
        """Return whether the robot is displaced from its command; then `recover` replaces `step`."""
        return self._recovery is not None

    def step(self, measured: Array) -> Array:
        """Perform one control step; return the joints to command. Arrays, shape (n_joints,) [rad].

        Raises
        ------
        RobotError
            If measured joints are no numbers, or far from the command; then nothing is done, and `driven_off`
            is true.
        """
        self._step(self._lag(measured))
        return self.position.copy()

    def _follow(self) -> None:
        self.step(self.position)

    def _recorded(self, record: Record, joints: list[Array]) -> JointRecord:
        position = np.tile(self.position, (len(joints), 1))
        position[:, self.held.columns] = joints
        return JointRecord(
            **{item.name: getattr(record, item.name) for item in fields(Record)},
            robot=self.robot,
            joints=position,
        )

    def command(self, measured: Array) -> Array:
        """Perform one control step, of a displaced robot as well; return the joints to command.

        Arrays, shape (n_joints,) [rad]. It raises what `recover` does.
        """
        if not self.driven_off:
            try:
                return self.step(measured)
            except RobotError:
                if not self.driven_off:
                    raise
        return self.recover(measured)

    def rest_at(self, joints: Array) -> None:
        """Rest at joints at which a robot has braked, near the command; array, shape (n_joints,) [rad].

        The reference waits meanwhile.

        Raises
        ------
        RobotError
            If the payload cannot be held there.
        """
        self.position[self.held.columns] = joints[self.held.columns]
        poses = self.payload_at(self.position)
        if not self.held.hold(poses):
            raise self._cannot_go_on()
        self._stop_at(poses)

    def recover(self, measured: Array) -> Array:
        """Perform a control step of a displaced robot; return the joints to command.

        Arrays, shape (n_joints,) [rad]. Commands are compliant: they stay near to the measured joints. Once the robot
        rests, the payload turns gently to the nearest feasible pose, from which `step` continues on another
        trajectory.

        Raises
        ------
        RobotError
            If measured joints are no numbers, or the robot was not displaced, does not come to rest, or cannot
            continue from there.
        """
        begun, recovery = clock.perf_counter(), self._recovery
        measured, columns, lost = self._numbers(measured), self.held.columns, self.settings.lost
        if recovery is None:
            raise RobotError(f"'{self.robot.name}' was not driven off", way_out="call 'step'")
        if self.time - recovery.began > recovery.settings.longest:
            raise RobotError(
                f"'{self.robot.name}' was driven off at {recovery.began:.2f} s, and has not come to stand since",
                way_out="look what holds it",
            )
        stands = recovery.stands(measured[columns], self.time)
        self.position[columns] = recovery.command(self.position[columns], measured[columns], lost)
        if recovery.ended:
            self._go_on()
        elif stands and not len(recovery.way):
            recovery.way = self._way_back(measured)
        self.n_steps += 1
        self.log.control.append(clock.perf_counter() - begun)
        return self.position.copy()

    def _way_back(self, measured: Array) -> Array:
        """Return one command a period back to a feasible pose; array, shape (n_steps, n_joints) [rad]."""
        settings, arms = self.settings.recovery, self.held.rows.arms
        held = self._tools(measured)
        for poses in (self._nearest(held), self.poses):  # or to where it was driven off from
            wanted, nodes = held.copy(), nodes_of(self.scene, poses)
            wanted[:, :3, 3] = nodes[: len(held)]
            wanted[:, :3, :3] = self.held.carrier.grasp.hand_rotations(nodes)
            way = way_back(arms, measured[self.held.columns], held, wanted, settings)
            if way is not None:
                way += np.linspace(1.0, 0.0, len(way))[:, None] * (
                    self.joints - way[0]
                )  # commands do not jump
                return at_ease(arms, way, self.period, settings)
        raise self._cannot_go_on()

    def _cannot_go_on(self) -> RobotError:
        return RobotError(
            f"'{self.robot.name}' was driven off, and cannot go on from where it stands at {self.time:.2f} s",
            way_out="take the load, and begin again",
        )

    def _nearest(self, held: Array) -> HandPoses:
        """Return the payload's poses nearest to end effectors; `held` is (n_hands, 4, 4)."""
        grasp = self.held.carrier.grasp
        if not grasp.keypoints:
            return poses_of(self.scene, held[:, : self.scene.n_dims, 3])
        (group,), nodes = self.scene.groups, self.scene.nodes_at("start")
        rotation = grasp.payload_rotations(held[:, :3, :3], nodes, group.start.rotation)
        center = held[:, :3, 3].mean(axis=0) - rotation @ group.grasps.mean(axis=0)
        return HandPoses(center[None], quaternion_of_rotation(rotation)[None])

    def _go_on(self) -> None:
        """Start steps at the end of the recovery path."""
        self.rest_at(self.position)
        self.replanner.stand(self.replanner.present(self))
        self._recovery = None
        self.tell("it goes on from where it stands")

    def payload_at(self, joints: Array) -> HandPoses:
        """Return the payload's poses nearest to the end effectors. `joints` has shape (n_joints,) [rad]."""
        return self._nearest(self._tools(joints))

    def _tools(self, joints: Array) -> Array:
        """Return the poses of the end effectors at all joints, (n_joints,); array, shape (n_hands, 4, 4)."""
        return np.array([self.robot.tool_pose(joints, arm) for arm in self.held.carrier.holders])

    def _numbers(self, measured: Array) -> Array:
        measured = np.asarray(measured, dtype=float)
        if measured.shape != self.position.shape or not np.isfinite(measured).all():
            raise RobotError(
                f"the measured joints are {np.array2string(measured, threshold=8)}",
                way_out=f"give {len(self.position)} finite numbers, in the order of joint_names",
            )
        return measured

    def _lag(self, measured: Array) -> float:
        """Return the largest difference of measured and commanded joints [rad]."""
        measured = self._numbers(measured)
        apart = np.abs(measured - self.position)
        if apart.max() > self.settings.lost:
            name = self.robot.joint_names[int(apart.argmax())]
            self._recovery = Recovery(self.time, measured[self.held.columns], self.settings.recovery)
            off = f"{name} is {apart.max():.2g} rad from where it was commanded"
            self.tell(off)
            raise RobotError(f"{off} at {self.time:.2f} s", way_out="look what holds it, or command slower")
        return float(apart.max())

    def _paced(self, reference: Setpoint, lag: float) -> tuple[float, JointState]:
        """Return the reference's time scaling, and rates that lead joints to it."""
        how, behind = self.settings, self.distance_from(reference.here)
        left = min(1.0 - behind / how.behind, 2.0 * (1.0 - lag / how.lag))
        pace = min(max(left, 0.0), 1.0)
        passes = self.replanner.is_clear and behind <= how.near_by
        self.filter.passing(how.joints.passing if passes else 1.0)
        drawn = pace * reference.rates + (reference.joints - self.joints) / how.catch_up
        return pace, self.held.state(drawn)

    def _move(self, rates: Array) -> None:
        """Move payload and joints by the largest feasible share of a twist."""
        poses = self.held.advance(self.poses, self.twists, rates)
        self.log.stopped += poses is None  # it cannot hold on: it stands
        self._placed(self.poses if poses is None else poses)

    @staticmethod
    def _first_plan(scene: Scene, robot: Robot, settings: OnlineSettings, seed: int) -> VerifiedJointMotion:
        budget = Budget(work=settings.leisure)
        found = solve_joints(scene.standing(), robot, seed=seed, budget=budget)
        if found.joints.motion is None:
            raise RobotError(
                f"no carry is found among what stands: {found.reasons[0]}",
                file=scene.path,
                way_out="solve it with 'comove solve' first",
            )
        motion: VerifiedJointMotion = found.joints.motion
        return motion

    def _follow_plan(self, n_steps: int = 201) -> None:
        """Require no more clearance of links than the plan has."""
        motion, joints = self.plan.motion.motion, self.plan.joints
        s = np.linspace(0.0, 1.0, n_steps)
        along = np.ascontiguousarray(joints.at(s * joints.duration)[0][:, self.held.columns])
        nodes = np.ascontiguousarray(motion.coordinates.motion(motion.at(s))[0])
        self.held.rows.follow(along, nodes)
