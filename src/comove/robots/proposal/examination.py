"""An examination of a robot before it carries anything: reach, the space that arms share, its home, what lacks."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from comove.robots.model import Arm, Robot
from comove.robots.proposal.bodies import link_of
from comove.robots.proposal.homes import DOWN, base_of
from comove.scenes.model import ROBOT_CLEARANCE

Array = NDArray[np.float64]

N_DRAWN = 2000  # configurations of every arm
N_TESTED = 200  # configurations of the robot that are tested for contact
SHARED = 0.05  # m, from a place of another hand, within which a place counts as shared
FEW_JOINTS = 6  # with fewer an arm cannot hold a load in every orientation
MOST_NAMED = 4  # links in one sentence
MOST_BETWEEN = 2  # joints, of links whose every distance can be looked at
N_GRID, N_REFINED = (
    21,
    4,
)  # configurations of a joint on a grid, and grids, each about the nearest configuration
TOUCHING = 0.0005  # m: a distance of links that counts as contact
OFTEN = 0.5  # share of random configurations from which on a pair is told


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
    shared : share of the places of one arm's hand that another's reaches too, by pair of arms
    clearance : least distance of two links at home [m], inf where no two can collide
    nearest : names of these links
    free : share of random configurations in which nothing touches
    faults : what must be mended before it carries, in words
    doubts : what should be looked at, in words
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


def examine(robot: Robot, seed: int = 0) -> Examination:
    """Examine a robot in random configurations and at home."""
    rng = np.random.default_rng(seed)
    arms = tuple(findings_of(robot, arm, rng) for arm in robot.arms)
    shared = {(a.name, b.name): _shared(a.places, b.places) for a, b in combinations(arms, 2)}
    clearance, nearest = _at_home(robot)
    free, often = _contacts(robot, rng)
    faults, doubts = [], []
    if clearance <= 0.0:
        faults.append(
            f"at home '{nearest[0]}' and '{nearest[1]}' touch: give another home, or name the pair in an SRDF if "
            "it always touches"
        )
    faults += [
        f"the hands of '{a}' and '{b}' have no place in common: put the bases nearer to each other"
        for (a, b), share in shared.items()
        if share == 0.0
    ]
    faults += [
        f"the motor of '{joint}' would have to give {share:.0%} of what it can to hold the robot's own weight at "
        "home: say by `springs` what else does, or give another home"
        for joint, share in overloaded(robot).items()
    ]
    doubts += [
        f"'{a}' and '{b}' touch in {share:.0%} of random configurations: if that is harmless, name them in an SRDF"
        for (a, b), share in often.items()
    ]
    for arm in arms:
        if arm.n_joints < FEW_JOINTS:
            doubts.append(
                f"the arm '{arm.name}' has {arm.n_joints} joints, so that its hand cannot turn every way: loads that "
                "it shares must leave it the turns that it lacks"
            )
    if unseen := _without_bodies(robot):
        doubts.append(
            f"{', '.join(unseen[:MOST_NAMED])}{' and others' * (len(unseen) > MOST_NAMED)} move and are drawn, but "
            "have no collision body: nothing keeps them from touching; give them one in the URDF"
        )
    if not len(robot.collision.collisionPairs):
        doubts.append("no two links are compared: what touches is not known")
    return Examination(arms, shared, clearance, nearest, free, tuple(faults), tuple(doubts))


def findings_of(robot: Robot, arm: Arm, rng: np.random.Generator) -> ArmFindings:
    """Return the findings about an arm in random configurations."""
    q = np.repeat(robot.home[None], N_DRAWN, axis=0)
    q[:, arm.columns] = rng.uniform(
        robot.lower[arm.columns], robot.upper[arm.columns], (N_DRAWN, len(arm.columns))
    )
    places = robot.tool_poses(q, (arm,))[:, 0, :3, 3]
    reach = float(np.linalg.norm(places - base_of(robot, arm), axis=1).max())
    tilt = float(np.arccos(np.clip(DOWN @ robot.tool_pose(robot.home, arm)[:3, 2], -1.0, 1.0)))
    return ArmFindings(arm.name, arm.tip, len(arm.columns), reach, places, tilt)


def overloaded(robot: Robot) -> dict[str, float]:
    """Return the joints whose motors cannot hold the robot's own weight at home, and the torques in what they can."""
    torque = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), robot.home)
    shares = np.abs(torque) * (1.0 - robot.relief) / robot.effort
    return {robot.joint_names[k]: float(shares[k]) for k in np.flatnonzero(shares > 1.0)}


def _shared(a: Array, b: Array) -> float:
    """Return the share of the places of one hand near to a place of another's."""
    distance, _ = cKDTree(b).query(a, distance_upper_bound=SHARED)
    return float(np.isfinite(distance).mean())


def _at_home(robot: Robot) -> tuple[float, tuple[str, str]]:
    """Return the least distance of two links at home [m], and their names."""
    geometry = robot.collision
    data, of_geometry = robot.model.createData(), geometry.createData()
    if not len(geometry.collisionPairs):
        return np.inf, ("", "")
    pin.computeDistances(robot.model, data, geometry, of_geometry, robot.home)
    distances = [result.min_distance for result in of_geometry.distanceResults]
    pair = geometry.collisionPairs[int(np.argmin(distances))]
    names = [link_of(geometry.geometryObjects[i].name) for i in (pair.first, pair.second)]
    return float(min(distances)), (names[0], names[1])


def _without_bodies(robot: Robot) -> list[str]:
    """Return the links that joints move and pictures show, but which have no collision body."""
    found = list[str]()
    for source in robot.sources:
        for link in ET.fromstring(source.urdf).findall("link"):
            if link.find("visual") is not None and link.find("collision") is None:
                frame = robot.model.getFrameId(link.get("name", ""), pin.FrameType.BODY)
                if robot.model.frames[frame].parentJoint > 0:
                    found.append(f"'{link.get('name')}'")
    return found


def _contacts(robot: Robot, rng: np.random.Generator) -> tuple[float, dict[tuple[str, str], float]]:
    """Return the share of random configurations without contact, and pairs that often touch with their share."""
    touched = touching(robot, rng.uniform(robot.lower, robot.upper, (N_TESTED, len(robot.lower))))
    shares = zip(pairs_of(robot), touched.mean(axis=0), strict=True)
    often = {pair: float(share) for pair, share in shares if share >= OFTEN}
    return float((~touched.any(axis=1)).mean()), often


def touching(robot: Robot, joints: Array, margin: float = 0.0) -> NDArray[np.bool_]:
    """Return which pairs of bodies touch, or come within a margin [m], in some configurations; array, shape
    (n_configurations, n_pairs).

    Parameters
    ----------
    joints : array, shape (n_configurations, n_joints) [rad, m]
    """
    geometry = robot.collision
    data, of_geometry = robot.model.createData(), geometry.createData()
    for request in of_geometry.collisionRequests:
        request.security_margin = margin
    touched = np.zeros((len(joints), len(geometry.collisionPairs)), dtype=bool)
    for k, q in enumerate(joints):
        pin.computeCollisions(robot.model, data, geometry, of_geometry, q, False)
        touched[k] = [result.isCollision() for result in of_geometry.collisionResults]
    return touched


def pairs_of(robot: Robot) -> list[tuple[str, str]]:
    """Return the names of the links of every pair of bodies that is compared, sorted within the pair."""
    links = [link_of(item.name) for item in robot.collision.geometryObjects]
    both = (sorted((links[pair.first], links[pair.second])) for pair in robot.collision.collisionPairs)
    return [(a, b) for a, b in both]


def near_but_apart(robot: Robot, count: int, rng: np.random.Generator) -> set[tuple[str, str]]:
    """Return the pairs of links that come nearer to each other than is kept between links, but do not touch.

    Of those that are seen to do so in random configurations, only links with one or two joints between them can be
    among these: they are looked at on a grid of these joints, refined about its nearest configuration. So it is seen,
    not proved.
    """
    joints = rng.uniform(robot.lower, robot.upper, (count, len(robot.lower)))
    near, touch = (touching(robot, joints, margin) for margin in (ROBOT_CLEARANCE, 0.0))
    links, geometry = pairs_of(robot), robot.collision
    # by links, which have several bodies
    touched = {pair for pair, seen in zip(links, touch.T, strict=True) if seen.any()}
    found = set[tuple[str, str]]()
    for k, pair in enumerate(geometry.collisionPairs):
        if links[k] in touched or not near[:, k].any():
            continue
        one, other = (
            robot.model.supports[geometry.geometryObjects[i].parentJoint] for i in (pair.first, pair.second)
        )
        columns = [robot.model.idx_vs[joint] for joint in set(one) ^ set(other)]
        if len(columns) <= MOST_BETWEEN and _least_distance(robot, k, columns) > TOUCHING:
            found.add(links[k])
        else:
            touched.add(links[k])
    return found - touched


def _least_distance(robot: Robot, k: int, columns: Sequence[int]) -> float:
    """Return the least distance of pair k of bodies on a grid of some joints, and on finer ones about it [m]."""
    model, geometry = robot.model, robot.collision
    data, of_geometry = model.createData(), geometry.createData()
    lower, upper, least = robot.lower[columns], robot.upper[columns], np.inf
    for _ in range(N_REFINED):
        axes = (np.linspace(a, b, N_GRID) for a, b in zip(lower, upper, strict=True))
        grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, len(columns))
        samples = np.repeat(robot.home[None], len(grid), axis=0)
        samples[:, columns] = grid
        distances = np.empty(len(samples))
        for i, q in enumerate(samples):
            pin.updateGeometryPlacements(model, data, geometry, of_geometry, q)
            distances[i] = pin.computeDistance(geometry, of_geometry, k).min_distance
        least = min(least, float(distances.min()))
        best, step = grid[distances.argmin()], 2.0 * (upper - lower) / (N_GRID - 1)
        lower, upper = np.maximum(best - step, lower), np.minimum(best + step, upper)
    return least
