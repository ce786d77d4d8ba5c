"""An examination of a robot: reach, shared space, home and missing parts."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pinocchio as pin
from scipy.spatial import cKDTree

from comove.arrays import Array
from comove.model.scene import Scene
from comove.robots.description import Placement
from comove.robots.effort import overburdened
from comove.robots.model import FREEDOMS, Arm, Robot
from comove.robots.proposal.bodies import among, buried, names_of, pairs_of, points_from_tip, touching
from comove.robots.proposal.homes import base_of, links_apart_at_home, near_limits, tilt_of
from comove.robots.verification.checks import without_gripper


@dataclass(frozen=True)
class ExaminationSettings:
    """Settings of an examination.

    Attributes
    ----------
    n_drawn : random configurations of every arm, from which its reach follows
    n_tested : random configurations of the robot that are tested for contact
    shared : distance from a place of another end effector within which a place counts as shared [m]
    often : least share of random configurations with contact for a message
    most_named : named links without a collision body, at most
    """

    n_drawn: int = 2000
    n_tested: int = 200
    shared: float = 0.05
    often: float = 0.5
    most_named: int = 4


SETTINGS = ExaminationSettings()


@dataclass(frozen=True)
class ArmFindings:
    """The findings about an arm.

    Attributes
    ----------
    name, tip : of the arm
    n_joints : number of its joints
    reach : largest distance of the grasp frame from the first joint [m]
    places : array, shape (n, 3), places of the grasp frame in random configurations [m]
    tilt : angle between the approach at home and straight down [rad]
    """

    name: str
    tip: str
    n_joints: int
    reach: float
    places: Array
    tilt: float


@dataclass(frozen=True)
class Examination:
    """The findings about a robot.

    Attributes
    ----------
    arms : of every arm
    shared : share of the places of one arm's end effector that another's reaches too, by pair of arms
    clearance : least distance of two links at home [m], inf where no two can collide
    nearest : names of these links
    free : share of random configurations without contact
    faults : faults that must be corrected before use, in words
    doubts : doubts that should be checked, in words
    """

    arms: tuple[ArmFindings, ...]
    shared: dict[tuple[str, str], float]
    clearance: float
    nearest: tuple[str, str]
    free: float
    faults: tuple[str, ...]
    doubts: tuple[str, ...]

    @property
    def sound(self) -> bool:
        """Return whether the robot can be used as it is."""
        return not self.faults


def examine(robot: Robot, seed: int = 0, around: Scene | None = None) -> Examination:
    """Examine a robot in random configurations and at home.

    Parameters
    ----------
    around : scene of its obstacles, and of a payload, if any, that its arms have to be rated for

    Raises
    ------
    RobotError
        If the robot has no arm that the payload's scene names.
    """
    rng = np.random.default_rng(seed)
    robot, alone = among(robot, around), robot
    standing = [] if around is None else names_of(around)
    arms = tuple(findings_of(robot, arm, rng) for arm in robot.arms)
    shared = {(a.name, b.name): _shared(a.places, b.places) for a, b in combinations(arms, 2)}
    apart = links_apart_at_home(robot)
    nearest, clearance, _ = apart[0] if apart else (("", ""), np.inf, 0.0)
    near = dict[tuple[str, str], tuple[float, float]]()
    for pair, distance, needed in apart:
        if distance < needed:
            near.setdefault(pair, (distance, needed))
    free, often = _contacts(robot, rng)
    faults, doubts = [], []
    faults += [
        f"at home '{a}' and '{b}' {_how_near(distance, needed)}: give another home, or "
        + (f"move '{b}'" if b in standing else f"{_leave_out(robot, a, b)} if they are always so near")
        for (a, b), (distance, needed) in near.items()
    ]
    faults += [
        f"{told.replace('begins', 'is')} at home: give another home, or move that"
        for told in buried(alone, around, robot.home)
    ]
    faults += [
        f"the arm '{arm.name}' is rated for {arm.payload:g} kg, and its hand weighs {arm.hand:.3g} kg: correct "
        "`payload`, or the masses in the URDF"
        for arm in robot.arms
        if not arm.hand < arm.payload
    ]
    if around is not None and around.file.load is not None:
        faults += overburdened(around, tuple(robot.arm(name) for name in around.manipulators))
    faults += [
        f"at home '{joint}' is {away:.3g} from its limit, and the search keeps joints off it: give a home between "
        f"{lower:.6g} and {upper:.6g}"
        for joint, away, lower, upper in near_limits(robot)
    ]
    doubts += [
        f"the hands of '{a}' and '{b}' come no nearer to each other than {_gap(arms, a, b):.2g} m in random "
        "joints: a payload between them has to be as long, or their bases nearer"
        for a, b in _neighbours(robot)
        if shared[a, b] == 0.0
    ]
    if len(arms) == 1:
        doubts.append(
            f"'{arms[0].name}' is the only arm, and a payload is held by two: give two URDFs, or one twice, to "
            "comove robot new"
        )
    faults += [
        f"the motor of '{joint}' would have to give {share:.0%} of what it can to hold the robot's own weight at "
        "home: say by `springs` what else does, or give another home"
        for joint, share in overloaded(robot).items()
    ]
    doubts += [
        f"'{a}' and '{b}' touch in {share:.0%} of random configurations: if that is harmless, "
        f"{_leave_out(robot, a, b)}"
        for (a, b), share in often.items()
        if not {a, b} & set(standing)
    ]
    doubts += [
        f"the arm '{arm.name}' has {arm.n_joints} joints, so that its hand cannot turn every way: loads that it "
        "shares must leave it the turns that it lacks"
        for arm in arms
        if arm.n_joints < FREEDOMS
    ]
    bare = without_gripper(robot)
    if away := [name for name in bare if robot.gripper_links(robot.arm(name))]:
        doubts.append(
            f"no body of the gripper of {', '.join(map(repr, away))} is near the grasp frame: correct `mount` or "
            "`tool`"
        )
    if bare := tuple(name for name in bare if name not in away):
        doubts.append(
            f"{', '.join(map(repr, bare))}: the description has no gripper where the payload is held, so that none "
            "is verified; give one: gripper: {urdf: FILE}, or gripper: {mass: KILOGRAMS, shapes: [{shape: box, "
            "center: [0, 0, 0.06], size: [0.1, 0.1, 0.12]}]}"
        )
    for arm in robot.arms:
        own = robot.gripper_links(arm)
        if own and robot.description.arms[arm.name].tool == Placement():
            end = max(points_from_tip(robot, arm, own)[:, 2], default=0.0)
            doubts.append(
                f"the arm '{arm.name}' has a gripper and no `tool`, so that it holds the payload at '{arm.tip}': say "
                f"where in that, such as tool: {{position: [0, 0, {end:.3g}]}}"
            )
    most = SETTINGS.most_named
    if unseen := _without_bodies(robot):
        doubts.append(
            f"{', '.join(unseen[:most])}{' and others' * (len(unseen) > most)} move and are drawn, but "
            "have no collision body: nothing keeps them from touching; give them one in the URDF"
        )
    if not len(robot.collision.collisionPairs):
        doubts.append("no two links are compared: what touches is not known")
    return Examination(arms, shared, clearance, nearest, free, tuple(faults), tuple(doubts))


def findings_of(robot: Robot, arm: Arm, rng: np.random.Generator) -> ArmFindings:
    """Return the findings about an arm in random configurations."""
    n, lower, upper = SETTINGS.n_drawn, robot.lower, robot.upper
    q = np.repeat(robot.home[None], n, axis=0)
    q[:, arm.columns] = rng.uniform(lower[arm.columns], upper[arm.columns], (n, len(arm.columns)))
    places = robot.tool_poses(q, (arm,))[:, 0, :3, 3]
    reach = float(np.linalg.norm(places - base_of(robot, arm), axis=1).max())
    tilt = tilt_of(robot.tool_pose(robot.home, arm))
    return ArmFindings(arm.name, arm.tip, len(arm.columns), reach, places, tilt)


def overloaded(robot: Robot) -> dict[str, float]:
    """Return joints that cannot hold the robot at home, with relative torques."""
    torque = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), robot.home)
    shares = np.abs(torque) * (1.0 - robot.relief) / robot.effort
    return {robot.joint_names[k]: float(shares[k]) for k in np.flatnonzero(shares > 1.0)}


def _how_near(distance: float, needed: float) -> str:
    return (
        "touch"
        if distance <= 0.0
        else f"are {1e3 * distance:.3g} mm apart, and have to keep {1e3 * needed:.3g} mm"
    )


def _leave_out(robot: Robot, a: str, b: str) -> str:
    for arm in robot.arms:
        for hand, other in ((a, b), (b, a)):
            if hand in robot.gripper_links(arm) and robot.model.existFrame(other):
                return f"name it where the gripper is: arms.{arm.name}.gripper.touch_links: ['{other}']"
    return "name the pair in an SRDF"


def _neighbours(robot: Robot) -> list[tuple[str, str]]:
    """Return the pairs of arms without a third arm between them.

    No base is nearer to both bases than these are to each other (the relative neighbourhood graph: Toussaint, 1980).
    """
    bases = np.array([base_of(robot, arm) for arm in robot.arms])
    apart = np.linalg.norm(bases[:, None] - bases, axis=-1).round(6)
    names = [arm.name for arm in robot.arms]
    return [
        (names[i], names[j])
        for i, j in combinations(range(len(names)), 2)
        if not (np.maximum(apart[i], apart[j]) < apart[i, j]).any()
    ]


def _gap(arms: tuple[ArmFindings, ...], a: str, b: str) -> float:
    """Return the least distance of two end effectors' sampled places [m]."""
    one, other = (next(arm.places for arm in arms if arm.name == name) for name in (a, b))
    return float(cKDTree(one).query(other)[0].min())


def _shared(a: Array, b: Array) -> float:
    """Return the share of places within `SETTINGS.shared` of another end effector's."""
    distance, _ = cKDTree(b).query(a, distance_upper_bound=SETTINGS.shared)
    return float(np.isfinite(distance).mean())


def _without_bodies(robot: Robot) -> list[str]:
    """Return the movable, visible links without a collision body."""
    found = list[str]()
    for source in robot.sources:
        for link in ET.fromstring(source.urdf).findall("link"):
            if link.find("visual") is not None and link.find("collision") is None:
                frame = robot.model.getFrameId(link.get("name", ""), pin.FrameType.BODY)
                if robot.model.frames[frame].parentJoint > 0:
                    found.append(f"'{link.get('name')}'")
    return found


def _contacts(robot: Robot, rng: np.random.Generator) -> tuple[float, dict[tuple[str, str], float]]:
    drawn = rng.uniform(robot.lower, robot.upper, (SETTINGS.n_tested, len(robot.lower)))
    touched = touching(robot, drawn)
    shares = zip(pairs_of(robot), touched.mean(axis=0), strict=True)
    often = {pair: float(share) for pair, share in shares if share >= SETTINGS.often}
    return float((~touched.any(axis=1)).mean()), often
