"""Approach and release: the joint motions from home to the grasp before a carry, and back home after it.

The *approach* leads from home through free space to a place straight behind the grasp, then along the approach axis
to the grasp, with open hands, and waits while these close. The *release* waits while the hands open, draws back along
the axis and leads home. Every part is a minimum-jerk motion from rest to rest. Both are judged like the carry: limits
and clearances are kept at every instant. The load lies at its start during the approach and at its goal during the
release; hands may be near it on the straight part only. The motion of the open fingers is not judged.
"""

from __future__ import annotations

from dataclasses import InitVar, dataclass, field

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PPoly

from comove.brief import brief
from comove.errors import OptionError, RobotError
from comove.planning.seeds import minimum_jerk
from comove.robots.free_space import Room, RoomSettings, way
from comove.robots.model import Arm, Robot
from comove.robots.motion import SAMPLE_RATE, JointMotion, Ranges, largest_approach
from comove.robots.search.chains import Iteration, chains_of, reach_pose
from comove.robots.verification import checks as check
from comove.robots.verification.bodies import LOAD, Bodies, beyond_wrists, bodies_of
from comove.robots.verification.carried import Carried, placements
from comove.robots.verification.kinematics import Bases
from comove.robots.verification.verify import VerifiedJointMotion
from comove.scenes.scene import Scene
from comove.verification.verify import Sealed

Array = NDArray[np.float64]

STRAIGHT = Iteration(gain=0.1, keep=2e-3, tolerance=1e-9, steady=1e-3, most=50)
_JUDGED = object()


@dataclass(frozen=True)
class TransferSettings:
    """Settings of how approach and release are planned.

    Attributes
    ----------
    shares : of the height, tried in turn where an arm or what is near leaves less
    pace : share of the limits of joints that is used
    hands_pace : likewise of the scene's limits of hands, which are looked at in samples
    attempts : searches for a way; the last of them checks everything exactly
    straight_steps : configurations of the straight part, solved one after the other
    straight : iteration that solves them
    room : of the ways through free space
    """

    shares: tuple[float, ...] = (1.0, 0.5, 0.25)
    pace: float = 0.5
    hands_pace: float = 0.98
    attempts: int = 3
    straight_steps: int = 41
    straight: Iteration = STRAIGHT
    room: RoomSettings = field(default_factory=RoomSettings)


@dataclass(frozen=True, eq=False, repr=False)
class Transfers(Sealed):
    """Approach and release of a carry, which passed every check. Only `plan_transfers` makes it.

    Attributes
    ----------
    carry : VerifiedJointMotion between approach and release
    approach, release : JointMotion of all joints
    grip_time : time in which hands close at the end of the approach, and open at the beginning of the release [s]
    clearance_min : certified lower bound of the clearance on both [m], except of hands from the load on the straight
        parts
    """

    __repr__ = brief

    __slots__ = ("approach", "carry", "clearance_min", "grip_time", "release")
    MAKER = "comove.robots.plan_transfers"
    INSTEAD = "plan them anew"

    carry: VerifiedJointMotion
    approach: JointMotion
    release: JointMotion
    grip_time: float
    clearance_min: float
    seal: InitVar[object] = field(default=None, kw_only=True)

    def __post_init__(self, seal: object) -> None:
        self._require(seal is _JUDGED)


def plan_transfers(
    carry: VerifiedJointMotion,
    *,
    height: float = 0.08,
    grip_time: float = 1.0,
    seed: int = 0,
    settings: TransferSettings = TransferSettings(),
) -> Transfers:
    """Plan and judge the joint motions from home to the grasp, and from there home.

    Parameters
    ----------
    carry : verified motion of the robot between the two
    height : distance by which hands draw back straight from the load [m]; where they cannot, or come too near to
        something, half of it is tried, then a quarter
    grip_time : time in which hands close or open [s]
    seed : seed of the search
    settings : settings of how the ways are found

    Raises
    ------
    OptionError
        If `height` or `grip_time` is not positive and finite.
    RobotError
        If a hand cannot draw back, or no path was found; the message names what is in the way.
    """
    for name, value in (("height", height), ("grip_time", grip_time)):
        if not 0.0 < value < np.inf:
            raise OptionError(f"it is {value!r}", key=name, way_out="give a positive number")
    grip_time = _whole(grip_time)
    withdrawals = [_withdrawal(carry, end, height, grip_time, seed, settings) for end in ("start", "goal")]
    (approach, first), (release, second) = withdrawals
    return Transfers(carry, _reversed(approach), release, grip_time, min(first, second), seal=_JUDGED)


@dataclass(frozen=True, eq=False)
class _Still:
    """The load at rest where it lies; replaces `Carried` in the judge's checks."""

    place: Array

    @property
    def speed(self) -> Ranges:
        return Ranges(np.array([0.0, 1.0]), np.zeros((1, len(self.place))))

    def nodes(self, time: Array) -> Array:
        return np.broadcast_to(self.place, (len(time), *self.place.shape))


def _withdrawal(
    carry: VerifiedJointMotion, end: str, height: float, grip_time: float, seed: int, how: TransferSettings
) -> tuple[JointMotion, float]:
    """Plan and judge the motion from the grasp home, after the hands had time to open; returns it and a lower bound
    of the clearance [m].
    """
    robot, scene = carry.robot, carry.scene
    arms = tuple(robot.arm(name) for name in scene.manipulators)
    carried = Carried(carry.motion.motion)
    place = carried.nodes(np.array([0.0 if end == "start" else scene.duration]))[0]
    bases, (where, _) = Bases(robot, robot.description.uncertainty), carried.hands(carried.time)
    everything = _put(bodies_of(bases, arms, carried, where, 0.0, held=False), place)
    grasp = carry.joints.position[0 if end == "start" else -1]
    back, room = _behind(everything, scene, grasp, height, end, how)
    reasons = ["the search found no way"]
    for attempt in range(how.attempts):
        rng = np.random.default_rng((seed, attempt))
        path = way(room if attempt + 1 < how.attempts else room.rigorous, back[-1], robot.home, rng)
        if path is None:
            continue
        ways = [back, *(np.stack(pair) for pair in zip(path[:-1], path[1:], strict=True))]
        parts = [_paced(robot, scene, arms, q, how) for q in ways]
        motion = _joined(robot, grip_time, parts)
        free_from = grip_time + (len(parts[0]) - 1) / SAMPLE_RATE
        reasons, clearance = _judged(scene, arms, motion, free_from, everything, _Still(place))
        if not reasons:
            return motion, clearance
    raise RobotError(
        f"there is no way between home and the grasp at the {end}: {'; '.join(reasons)}",
        key="home",
        way_out="give another home in the robot's description, another height, or leave approach and release out",
    )


def _put(bodies: Bodies, place: Array) -> Bodies:
    """Place the load's bodies at `place`, in the geometry of `bodies`, and return `bodies`."""
    for rod, *spanned in bodies.rods:
        (turn,), (middle,) = placements(place[None], tuple(spanned))
        bodies.geometry.geometryObjects[rod].placement = pin.SE3(turn, middle)
    return bodies


def _behind(
    bodies: Bodies, scene: Scene, grasp: Array, height: float, end: str, how: TransferSettings
) -> tuple[Array, Room]:
    """Return the joints while the hands draw back straight, and the free space from there home.

    Raises
    ------
    RobotError
        If home, or the joints behind the grasp whatever the height, are not free, or not reached.
    """
    robot, error = bodies.robot, None
    for share in how.shares:
        try:
            back = _drawn_back(robot, scene, grasp, share * height, end, how)
        except RobotError as why:
            error = error or why
            continue
        ends = np.stack([back[-1], robot.home])
        room = Room.for_ends(bodies, scene, ends, scene.nodes_at(end), how.room)
        if near := room.contact(robot.home):
            raise RobotError(
                f"at home, {near} come too near to each other",
                key="home",
                way_out="give another home in the robot's description, or leave approach and release out",
            )
        if not (near := room.contact(back[-1])):
            return back, room
        error = RobotError(
            f"behind the grasp at the {end}, {near} come too near to each other",
            key="height",
            way_out="give another height",
        )
    assert error is not None, "a share was tried"
    raise error


def _drawn_back(
    robot: Robot, scene: Scene, grasp: Array, height: float, end: str, how: TransferSettings
) -> Array:
    """Compute the joints while the hands draw back straight from the load; array, shape (straight_steps, n_joints).

    Raises
    ------
    RobotError
        If an arm does not reach so far.
    """
    rows, straight = np.repeat(grasp[None], how.straight_steps, axis=0), how.straight
    for name in scene.file.holders:
        arm = robot.arm(name)
        chains, pose = chains_of(robot, (arm,)), robot.tool_pose(grasp, arm)
        turn = np.ascontiguousarray(pose[:3, :3])
        for k, share in enumerate(np.linspace(0.0, 1.0, how.straight_steps)[1:], start=1):
            q = rows[k - 1, arm.columns]
            behind = pose[:3, 3] - share * height * turn[:, 2]
            if reach_pose(chains, 0, turn, behind, q.copy(), straight, q) > straight.tolerance:
                raise RobotError(
                    f"the arm '{arm.name}' can draw back from its grasp at the {end} by less than "
                    f"{share * height:.3g} m",
                    key="height",
                    way_out=f"give a height below {share * height:.3g} m, or another grasp",
                )
            rows[k, arm.columns] = q
    return rows


def _paced(robot: Robot, scene: Scene, arms: tuple[Arm, ...], path: Array, how: TransferSettings) -> Array:
    """Sample a path with minimum jerk, as fast as shares of the limits of joints and hands allow.

    Parameters
    ----------
    path : array, shape (n_configurations, n_joints), evenly spaced
    """
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
        max((velocity / robot.velocity).max(), approach.value) / how.pace,
        np.sqrt((acceleration / (how.pace * robot.acceleration)).max()),
    ]
    places = robot.tool_poses(unit.position, arms)[:, :, :3, 3]
    hands = CubicSpline(s, places, bc_type="clamped")
    speed, pull = (np.linalg.norm(hands(s, order), axis=-1).max() for order in (1, 2))
    ratios += [
        speed / (how.hands_pace * scene.speed_limit),
        np.sqrt(pull / (how.hands_pace * scene.acceleration_limit)),
    ]
    steps = max(2, int(np.ceil(max(ratios) * SAMPLE_RATE)))
    samples = curve(minimum_jerk(np.linspace(0.0, 1.0, steps + 1)))
    samples[[0, -1]] = path[[0, -1]]  # free of rounding
    return samples


def _joined(robot: Robot, wait: float, parts: list[Array]) -> JointMotion:
    """Join several parts into one motion, after a time at rest."""
    still = np.repeat(parts[0][:1], round(wait * SAMPLE_RATE), axis=0)
    position = np.concatenate([still, parts[0], *(part[1:] for part in parts[1:])])
    return _unchanging(JointMotion(np.arange(len(position)) / SAMPLE_RATE, robot.joint_names, position))


def _reversed(motion: JointMotion) -> JointMotion:
    backwards = np.ascontiguousarray(motion.position[::-1])
    return _unchanging(JointMotion(motion.time, motion.joint_names, backwards))


def _unchanging(motion: JointMotion) -> JointMotion:
    """Make the motion's arrays read-only, so that nobody can change what was judged, and return the motion."""
    for array in (motion.time, motion.position):
        array.setflags(write=False)
    return motion


def _whole(time: float) -> float:
    """Round a time up to whole samples."""
    return np.ceil(time * SAMPLE_RATE - 1e-9) / SAMPLE_RATE


def _judged(
    scene: Scene,
    arms: tuple[Arm, ...],
    motion: JointMotion,
    free_from: float,
    everything: Bodies,
    still: _Still,
) -> tuple[list[str], float]:
    """Return the reasons against a withdrawal, and a lower bound of its clearance [m].

    Parameters
    ----------
    free_from : time from which hands must keep clear of the load, too [s]
    everything : all pairs of bodies, those of hands and load among them
    """
    robot, curve = everything.robot, motion.curve
    in_hands = list(beyond_wrists(robot, (robot.arm(name) for name in scene.file.holders)))
    of_hands = np.isin(everything.joint[everything.ends], in_hands).any(axis=1) & (everything.kind == LOAD)
    bodies, hands = everything.some(~of_hands), everything.some(of_hands)
    findings = [
        check.rest(robot, curve),
        check.limits(robot, curve),
        check.torques(robot, curve, arms, np.zeros(len(arms))),
        check.clearances(bodies, still, curve),
    ]
    if of_hands.any():
        findings.append(check.clearances(hands, still, _after(curve, free_from)))
    reasons = [reason for finding in findings for reason in finding.reasons]
    measures = [value for finding in findings[3:] for value in finding.measures.values()]
    return reasons, min(measures)


def _after(curve: PPoly, time: float) -> PPoly:
    """Return the curve from the sample nearest to `time` on, with its time counted from there."""
    first = int(np.abs(curve.x - time).argmin())
    return PPoly(curve.c[:, first:], curve.x[first:] - curve.x[first])
