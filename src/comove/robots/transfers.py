"""Approach and release: the transit motions before and after a transfer motion.

The *approach* leads from the present joints, home unless given, through free space to a place straight behind the
grasp, then along the approach axis to the grasp, with open grippers, and waits while these close. The *release* waits
while the grippers open, draws back along the axis and leads home. Every part is a minimum-jerk motion from rest to
rest. Both are verified like the transfer motion: limits and clearances are kept at every instant. The payload lies at
its start during the approach and at its goal during the release; grippers may be near it on the straight part only.
The motion of the open fingers is not verified.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import InitVar, dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from comove.arrays import Array
from comove.brief import brief
from comove.errors import OptionError, RobotError
from comove.model.motion import SAMPLE_RATE
from comove.model.scene import Scene
from comove.planning.seeds import minimum_jerk
from comove.robots.effort import carried_masses
from comove.robots.free_space import Room, way
from comove.robots.model import Arm, Robot
from comove.robots.motion import JointCurve, JointMotion, Ranges, largest_approach
from comove.robots.present import Joints, present_joints
from comove.robots.search.chains import Iteration, chains_of, reach_pose
from comove.robots.verification import checks as check
from comove.robots.verification.bodies import LOAD, Bodies, beyond_wrists, bodies_of
from comove.robots.verification.carried import Carried
from comove.robots.verification.kinematics import Bases
from comove.robots.verification.verify import VerifiedJointMotion
from comove.verification.verify import Sealed

OPTIONS = {"start": "--approach", "goal": "--release"}
_VERIFIED = object()


@dataclass(frozen=True)
class TransferSettings:
    """Settings of the planning of approach and release.

    Attributes
    ----------
    height, grip_time : default distance by which grippers draw back [m], and time in which they close or open [s]
    shares : of the height, tried in turn where reach or contacts leave less
    straight_steps : configurations of the straight part, solved one after the other
    straight : iteration that solves them
    pace : share of the limits of joints that is used
    hands_pace : likewise of the scene's limits of end effectors, which are checked at samples
    attempts : searches for a path; the last of them checks everything exactly
    """

    height: float = 0.08
    grip_time: float = 1.0
    shares: tuple[float, ...] = (1.0, 0.5, 0.25)
    straight_steps: int = 41
    straight: Iteration = field(
        default_factory=lambda: Iteration(gain=0.1, keep=2e-3, tolerance=1e-9, steady=1e-3, most=50)
    )
    pace: float = 0.5
    hands_pace: float = 0.98
    attempts: int = 3


SETTINGS = TransferSettings()


@dataclass(frozen=True, eq=False, repr=False)
class Transfers(Sealed):
    """Approach and release, which passed every check. Only `plan_transfers` creates it.

    Attributes
    ----------
    carry : VerifiedJointMotion between approach and release
    approach, release : JointMotion of all joints; None for one that was not requested
    grip_time : time in which grippers close at the end of the approach, and open at the beginning of the release [s]
    clearance_min : certified lower bound of the clearance on both [m], except of grippers from the payload on the
        straight parts
    """

    __repr__ = brief

    __slots__ = ("approach", "carry", "clearance_min", "grip_time", "release")
    MAKER = "comove.robots.plan_transfers"
    INSTEAD = "plan them anew"

    carry: VerifiedJointMotion
    approach: JointMotion | None
    release: JointMotion | None
    grip_time: float
    clearance_min: float
    seal: InitVar[object] = field(default=None, kw_only=True)

    def __post_init__(self, seal: object) -> None:
        self._require(seal is _VERIFIED)


def plan_transfers(
    carry: VerifiedJointMotion,
    *,
    approach: bool = True,
    release: bool = True,
    present: Joints | None = None,
    height: float = SETTINGS.height,
    grip_time: float = SETTINGS.grip_time,
    seed: int = 0,
) -> Transfers:
    """Plan and verify the motions from present joints to grasp, and home.

    Parameters
    ----------
    carry : verified motion of the robot between the two
    approach, release : whether each of them is planned
    present : joints at which the approach begins, by name or an array, shape (n_joints,) [rad, m]; home unless given
    height : distance by which grippers draw back straight from the payload [m]; where they cannot, or are too near to
        a body, half of it is tried, then a quarter
    grip_time : time in which grippers close or open [s]
    seed : seed of the search

    Raises
    ------
    OptionError
        If `carry` is no verified motion of joints, `height` or `grip_time` is not positive and finite, or neither
        approach nor release is requested.
    RobotError
        If a gripper cannot draw back, or no path was found; the message names the obstacle.
    """
    if not isinstance(carry, VerifiedJointMotion):
        raise OptionError(
            f"the motion is a {type(carry).__name__}, not a verified one of joints",
            key="carry",
            way_out="give Solution.joints.motion of comove.solve, or what verify_stored found, where it is verified",
        )
    for name, value in (("height", height), ("grip_time", grip_time)):
        if not 0.0 < value < np.inf:
            raise OptionError(f"it is {value!r}", key=name, way_out="give a positive number")
    if not (approach or release):
        raise OptionError("neither approach nor release is wanted", key="approach", way_out="ask for one")
    found, errors = possible_transfers(
        carry, approach, release, present, height=height, grip_time=grip_time, seed=seed
    )
    for error in errors.values():
        raise error
    assert found is not None, "what is not found has an error"
    return found


def possible_transfers(
    carry: VerifiedJointMotion,
    approach: bool,
    release: bool,
    present: Joints | None,
    *,
    height: float = SETTINGS.height,
    grip_time: float = SETTINGS.grip_time,
    seed: int = 0,
) -> tuple[Transfers | None, dict[str, RobotError]]:
    """Plan the feasible ones of approach and release; arguments as of `plan_transfers`.

    Returns
    -------
    Transfers, None where neither was found, and the errors of those that were not, by the end of the transfer motion
    """
    require_no_transfers(carry.scene, {"approach": approach, "release": release})
    grip_time, robot = _whole(grip_time), carry.robot
    ends = {"start": present_joints(present, robot)} if approach else {}
    ends |= {"goal": robot.home} if release else {}
    found, errors = dict[str, tuple[JointMotion, float]](), dict[str, RobotError]()
    for end, other in ends.items():
        retreat = Retreat(robot, Carried(carry.motion.motion), end, other, height)
        try:
            grasp = carry.joints.position[0 if end == "start" else -1]
            found[end] = withdrawal(retreat, grasp, grip_time, seed)
        except RobotError as error:
            errors[end] = error
    if not found:
        return None, errors
    motions = {end: motion for end, (motion, _) in found.items()}
    transfers = Transfers(
        carry,
        backwards(motions["start"]) if "start" in motions else None,
        motions.get("goal"),
        grip_time,
        min(clearance for _, clearance in found.values()),
        seal=_VERIFIED,
    )
    return transfers, errors


def require_no_transfers(scene: Scene, wanted: Mapping[str, bool]) -> None:
    """Reject approach and release among moving obstacles. The scene's times are those of the transfer motion.

    Parameters
    ----------
    wanted : whether each is requested, by its name

    Raises
    ------
    OptionError
        If one is.
    """
    for name in (name for name, asked in wanted.items() if asked and scene.moving.any()):
        raise OptionError(
            f"obstacles of '{scene.name}' move, and the scene says where they are during the carry only",
            key=name,
            way_out="leave out approach and release (--approach, --release, --transfers), and bring the arms to the "
            "first joints of the motion before 0 s",
        )


@dataclass(frozen=True, eq=False)
class Retreat:
    """The retreat of grippers at an end, and free space beyond.

    Attributes
    ----------
    robot : robot whose grippers draw back
    carried : motion of the payload
    end : "start" or "goal"
    other : array, shape (n_joints,), joints from which an approach comes, or to which a release leads [rad, m]
    height : as of `plan_transfers` [m]
    holding : other arms, which hold the payload meanwhile
    """

    robot: Robot
    carried: Carried
    end: str
    other: Array
    height: float = SETTINGS.height
    holding: tuple[Arm, ...] = ()

    @classmethod
    def on(cls, scene: Scene, robot: Robot, end: str, other: Array) -> Retreat:
        """Return the retreat at an end of a scene, for any motion."""
        return cls(robot, Carried.straight(scene), end, other)

    @property
    def scene(self) -> Scene:
        """Return the scene of the transfer motion."""
        return self.carried.motion.scene

    @property
    def arms(self) -> tuple[Arm, ...]:
        """Return the arms in the order of the scene's manipulators."""
        return tuple(self.robot.arm(name) for name in self.scene.manipulators)

    @property
    def named(self) -> str:
        """Return a description of the other joints."""
        return "home" if (self.other == self.robot.home).all() else "the present joints"

    @cached_property
    def place(self) -> Array:
        """Return the payload's keypoints at the end; array, shape (n_nodes, 3) [m]."""
        return self.carried.nodes(np.array([0.0 if self.end == "start" else self.scene.duration]))[0]

    @cached_property
    def bodies(self) -> Bodies:
        """Return all bodies, the payload's at the end, and named so."""
        bases = Bases(self.robot, self.robot.description.uncertainty)
        where = self.carried.hands(self.carried.time).positions
        bodies = bodies_of(bases, self.arms, self.carried, where, 0.0, holding=self.holding)
        bodies = bodies.placed_at(self.place)
        named = list(bodies.bodies)
        for rod, *_ in bodies.rods:
            named[rod] = named[rod]._replace(name=f"{named[rod].name} at its {self.end}")
        return replace(bodies, bodies=tuple(named))

    def require_apart(self) -> None:
        """Reject other joints at which bodies of the robot and obstacles meet."""
        bodies = self.bodies.some(self.bodies.kind != LOAD)
        room = Room(bodies, self.robot.arms, -bodies.required[bodies.kind] - bodies.taken)
        if near := room.contact(self.other):
            raise RobotError(
                f"at {self.named}, {near} are in each other",
                key="home" if self.named == "home" else "present",
                way_out="give the joints at which the robot is, or correct the scene",
            )

    def require_free_rest(self) -> None:
        """Reject other joints that are not free."""
        room = self.room(self.other)
        if near := room.contact(self.other):
            what, mend = "release", "give another home in the robot's description"
            if self.end == "start":
                what, mend = "approach", f"{mend}, or present joints that are free (--present)"
            raise RobotError(
                f"at {self.named}, {near} come too near to each other",
                key="home" if self.named == "home" else "present",
                way_out=f"{mend}, or leave the {what} out",
            )

    def behind(self, grasp: Array) -> Array:
        """Return the joints of the straight retreat; array, shape (straight_steps, n_joints).

        Parameters
        ----------
        grasp : array, shape (n_joints,), joints that hold the payload at the end [rad, m]

        Raises
        ------
        RobotError
            If the joints behind the grasp are not free or not reached at any height.
        """
        error: RobotError | None = None
        for share in SETTINGS.shares:
            height = share * self.height
            try:
                back = _drawn_back(self.robot, self.scene, grasp, height, self.end)
            except RobotError as why:
                error = error or why
                continue
            if not (near := self._widest.contact(back[-1])):
                return back
            error = RobotError(
                f"{height:.3g} m behind the grasp at the {self.end}, {near} come too near to each other",
                key="height",
                way_out=f"give another height, or {_anew(self.end)}",
            )
        assert error is not None, "a share was tried"
        raise error

    @cached_property
    def _widest(self) -> Room:
        return Room.widest(self.bodies)

    def room(self, q: Array) -> Room:
        """Return the free space from joints q, (n_joints,), to the others."""
        ends = np.stack([q, self.other])
        return Room.for_ends(self.bodies, self.scene, ends, self.scene.nodes_at(self.end))


def _anew(end: str) -> str:
    return f"solve the scene with {OPTIONS[end]}, which looks for other joints at the {end}"


@dataclass(frozen=True, eq=False)
class _Still:
    """The payload at rest, which replaces `Carried` in the verifier's checks."""

    place: Array

    @property
    def bounds(self) -> Ranges:
        return Ranges(np.array([0.0, 1.0]), np.zeros((1, 2)))

    def nodes(self, time: Array) -> Array:
        return np.broadcast_to(self.place, (len(time), *self.place.shape))


def withdrawal(retreat: Retreat, grasp: Array, grip_time: float, seed: int) -> tuple[JointMotion, float]:
    """Plan and verify the motion from the grasp to the other joints.

    Grippers have time to open first. Return the motion, and a lower bound of its clearance [m].

    Parameters
    ----------
    grasp : array, shape (n_joints,), joints that hold the payload at the end [rad, m]
    grip_time : time in which grippers open [s]
    seed : seed of the search

    Raises
    ------
    RobotError
        If a gripper cannot draw back, or no path was found.
    """
    robot, scene, end = retreat.robot, retreat.scene, retreat.end
    retreat.require_free_rest()
    back = retreat.behind(grasp)
    room = retreat.room(back[-1])
    reasons = ["the search found no way"]
    for attempt in range(SETTINGS.attempts):
        rng = np.random.default_rng((seed, attempt))
        path = way(room if attempt + 1 < SETTINGS.attempts else room.rigorous, back[-1], retreat.other, rng)
        if path is None:
            continue
        ways = [back, *(np.stack(pair) for pair in zip(path[:-1], path[1:], strict=True))]
        parts = [_paced(robot, scene, retreat.arms, q) for q in ways]
        motion = _joined(robot, grip_time, parts)
        free_from = grip_time + (len(parts[0]) - 1) / SAMPLE_RATE
        reasons, clearance = _verified(retreat, motion, free_from)
        if not reasons:
            return motion, clearance
    raise RobotError(
        f"there is no way between {retreat.named} and the grasp at the {end}: {'; '.join(reasons)}",
        key="home",
        way_out=f"{_anew(end)}, or give another home in the robot's description",
    )


def _drawn_back(robot: Robot, scene: Scene, grasp: Array, height: float, end: str) -> Array:
    """Compute the joints of the straight retreat; array, (straight_steps, n_joints)."""
    how = SETTINGS
    rows = np.repeat(grasp[None], how.straight_steps, axis=0)
    for name in scene.file.holders:
        arm = robot.arm(name)
        chains, pose = chains_of(robot, (arm,)), robot.tool_pose(grasp, arm)
        turn = np.ascontiguousarray(pose[:3, :3])
        for k, share in enumerate(np.linspace(0.0, 1.0, how.straight_steps)[1:], start=1):
            q = rows[k - 1, arm.columns]
            behind = pose[:3, 3] - share * height * turn[:, 2]
            if reach_pose(chains, 0, turn, behind, q.copy(), how.straight, q) > how.straight.tolerance:
                raise RobotError(
                    f"the arm '{arm.name}' can draw back from its grasp at the {end} by less than "
                    f"{share * height:.3g} m",
                    key="height",
                    way_out=f"give a height below {share * height:.3g} m, or {_anew(end)}",
                )
            rows[k, arm.columns] = q
    return rows


def _paced(robot: Robot, scene: Scene, arms: tuple[Arm, ...], path: Array) -> Array:
    """Sample a path with minimum jerk at shares of the limits. Joints and end effectors are limited."""
    curve = CubicSpline(np.linspace(0.0, 1.0, len(path)), path)  # a straight line through two
    s = np.linspace(0.0, 1.0, 201)
    unit = JointMotion(s, robot.joint_names, curve(minimum_jerk(s)))
    velocity, acceleration = unit.largest()
    approach = largest_approach(unit.curve, robot.approach, robot.lower, robot.upper)
    if np.isinf(approach.value):
        raise RobotError(
            f"{robot.joint_names[approach.joint]} would come to rest at its soft limit, which it may only approach",
            key="home",
            way_out="give a home and a grasp farther from the limits",
        )
    ratios = [
        max((velocity / robot.velocity).max(), approach.value) / SETTINGS.pace,
        np.sqrt((acceleration / (SETTINGS.pace * robot.acceleration)).max()),
    ]
    places = robot.tool_poses(unit.position, arms)[:, :, :3, 3]
    hands = CubicSpline(s, places, bc_type="clamped")
    speed, pull = (np.linalg.norm(hands(s, order), axis=-1).max() for order in (1, 2))
    ratios += [
        speed / (SETTINGS.hands_pace * scene.speed_limit),
        np.sqrt(pull / (SETTINGS.hands_pace * scene.acceleration_limit)),
    ]
    steps = max(2, int(np.ceil(max(ratios) * SAMPLE_RATE)))
    samples = curve(minimum_jerk(np.linspace(0.0, 1.0, steps + 1)))
    samples[[0, -1]] = path[[0, -1]]  # free of rounding
    return samples


def _joined(robot: Robot, wait: float, parts: list[Array]) -> JointMotion:
    still = np.repeat(parts[0][:1], round(wait * SAMPLE_RATE), axis=0)
    position = np.concatenate([still, parts[0], *(part[1:] for part in parts[1:])])
    return _unchanging(JointMotion(np.arange(len(position)) / SAMPLE_RATE, robot.joint_names, position))


def backwards(motion: JointMotion) -> JointMotion:
    """Return a motion from its end to its beginning."""
    position = np.ascontiguousarray(motion.position[::-1])
    return _unchanging(JointMotion(motion.time, motion.joint_names, position))


def _unchanging(motion: JointMotion) -> JointMotion:
    for array in (motion.time, motion.position):
        array.setflags(write=False)
    return motion


def _whole(time: float) -> float:
    return np.ceil(time * SAMPLE_RATE - 1e-9) / SAMPLE_RATE


def _verified(retreat: Retreat, motion: JointMotion, free_from: float) -> tuple[list[str], float]:
    """Return the reasons against a withdrawal, and a clearance bound [m].

    Parameters
    ----------
    free_from : time from which grippers must keep clear of the payload, too [s]
    """
    everything, still, scene = retreat.bodies, _Still(retreat.place), retreat.scene
    robot, curve, holding = everything.robot, motion.curve, retreat.holding
    arms = (*retreat.arms, *holding)
    masses = np.repeat(
        [0.0, carried_masses(scene).sum() / max(len(holding), 1)], [len(retreat.arms), len(holding)]
    )
    in_hands = list(beyond_wrists(robot, (robot.arm(name) for name in scene.file.holders)))
    of_hands = np.isin(everything.joint[everything.ends], in_hands).any(axis=1) & (everything.kind == LOAD)
    bodies, hands = everything.some(~of_hands), everything.some(of_hands)
    findings = [
        check.rest(robot, curve),
        check.limits(robot, curve),
        check.torques(robot, curve, arms, masses),
    ]
    parts = [(bodies, still, curve)]
    if of_hands.any():
        parts.append((hands, still, _after(curve, free_from)))
    apart = [check.clearances(*part) for part in parts]
    findings += [*apart, *(check.deviating(*part) for part in parts)]
    reasons = [reason for finding in findings for reason in finding.reasons]
    return reasons, min(value for finding in apart for value in finding.measures.values())


def _after(curve: JointCurve, time: float) -> JointCurve:
    """Return the curve from the sample nearest to `time` on. Its time starts at 0."""
    first = int(np.abs(curve.x - time).argmin())
    return JointCurve(curve.x[first:] - curve.x[first], np.ascontiguousarray(curve.c[:, first:]))
