"""A home for every arm: end effector down and in front, joints central.

Arms stand side by side with their end effectors in front of them, or face each other with both end effectors between
them. A home keeps the rules of the search, and of approach and release, which begin and end there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from math import radians

import numpy as np
import pinocchio as pin

from comove.arrays import Array
from comove.model.scene import Scene
from comove.robots.free_space import SETTINGS as ROOM
from comove.robots.model import Arm, Robot
from comove.robots.proposal.bodies import among, buried, link_of, placed_bodies
from comove.robots.search.following import SEARCHING
from comove.robots.verification.bodies import links_apart

DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True)
class HomeSettings:
    """Settings of the search for homes.

    Attributes
    ----------
    n_drawn, n_tried : random configurations of an arm, and those that are settled and tested for contact
    n_steps, gain, damping : of the iteration by which an end effector settles
    backwards : mean place of the end effectors along x below which the front is at negative x [reaches]
    in_front : beginning of the front along x [reaches]
    most_signs : joints of an arm up to which all signs are tried for a mirror image
    settled : largest miss of an end effector from its home, or from a mirror image [reaches and radians together]
    apart : distance of the end effectors of arms that face each other [reaches]
    far : share of the places of end effectors that are nearer than a home
    steep : angle from straight down of an approach that counts as down in the search for a home [rad]
    near_down : angle from straight down at home above which it is reported [rad]
    digits : of joints at home
    """

    n_drawn: int = 3000
    n_tried: int = 150
    n_steps: int = 60
    gain: float = 0.5
    damping: float = 1e-3
    backwards: float = -0.1
    in_front: float = 0.25
    most_signs: int = 12
    settled: float = 2e-3
    apart: float = 0.3
    far: float = 0.75
    steep: float = radians(30.0)
    near_down: float = radians(5.0)
    digits: int = 3


SETTINGS = HomeSettings()


def homes_of(robot: Robot, seed: int = 0, around: Scene | None = None) -> tuple[list[Array], list[str]]:
    """Find the best free random configuration of every arm as a home. End effectors are turned down first.

    Parameters
    ----------
    around : scene of the obstacles around the robot

    Returns
    -------
    joint positions by arm, arrays, shape (n_joints,) [rad, m], and notes on their flaws
    """
    q, notes, robot, alone = robot.home, [], among(robot, around), robot
    rng = np.random.default_rng(seed)
    drawn_by_arm = [_Drawn.of(robot, arm, rng) for arm in robot.arms]
    ahead = _middle_of_reach(drawn_by_arm)
    reach = min(drawn.reach for drawn in drawn_by_arm)
    needed = clearance_at_home(robot)
    between = _facing(np.array([drawn.base for drawn in drawn_by_arm]) / reach, ahead)
    for k, (arm, drawn, wanted) in enumerate(zip(robot.arms, drawn_by_arm, between, strict=True)):
        later = {int(column) + 1 for other in robot.arms[k + 1 :] for column in other.columns}
        begun = [*_as_before(robot, q, k), *drawn.best(q, wanted)[: SETTINGS.n_tried]]
        place = drawn.base + reach * wanted
        ended = [_settled(robot, arm, each, place, reach) for each in begun]
        best = [each for each, miss in ended if miss < SETTINGS.settled and not buried(alone, around, each)]
        found = _first_free(robot, best, later, needed)
        if found is None:  # then anywhere with the hand down
            own = [robot.tool_pose(each, arm)[:3, 3] for each in begun]
            ended = [_settled(robot, arm, *pair, reach) for pair in zip(begun, own, strict=True)]
            best = [each for each, _ in sorted(ended, key=lambda pair: pair[1] > SETTINGS.settled)]
            clear = [each for each in best if not buried(alone, around, each)]
            found = _first_free(robot, clear, later, needed)
        if found is None:  # then however the hand is turned
            keep = limit_margin(robot)
            kept = (_rounded(each, robot.lower + keep, robot.upper - keep) for each in begun)
            clear = [each for each in kept if not buried(alone, around, each)]
            found = _first_free(robot, clear, later, needed)
        q = best[0] if found is None else found
        if found is None:
            notes.append(
                f"no home of '{arm.name}' was found at which links keep {1e3 * needed.max():.3g} mm from each other"
                f"{' and from what stands around' if around is not None else ''}: write one"
            )
        tilt = tilt_of(robot.tool_pose(q, arm))
        if tilt > SETTINGS.near_down:
            notes.append(
                f"the hand of '{arm.name}' at home is {np.rad2deg(tilt):.0f} degrees from pointing down, as near as "
                f"its {len(arm.columns)} joints were seen to come, clear of everything"
            )
    return [q[arm.columns] for arm in robot.arms], notes


def limit_margin(robot: Robot) -> Array:
    """Return the distance that joints keep from their limits; array, shape (n_joints,) [rad, m]."""
    return np.minimum(SEARCHING.keep, 0.5 * (robot.upper - robot.lower))


def clearance_at_home(robot: Robot) -> Array:
    """Return the distance that each pair of links keeps at home; array, shape (n_pairs,) [m]."""
    return links_apart(robot) + ROOM.spares[-1]


def near_limits(robot: Robot, rounding: float = 1e-9) -> Iterator[tuple[str, float, float, float]]:
    """Yield joints too near limits at home, with distances and allowed ranges."""
    keep, q = limit_margin(robot), robot.home
    lower, upper = robot.lower + keep, robot.upper - keep
    for k in np.flatnonzero((q < lower - rounding) | (q > upper + rounding)):
        away = min(q[k] - robot.lower[k], robot.upper[k] - q[k])
        yield robot.joint_names[k], float(away), float(lower[k]), float(upper[k])


def links_apart_at_home(robot: Robot) -> list[tuple[tuple[str, str], float, float]]:
    """Return links, their distances and required ones at home, nearest first [m]."""
    geometry, needed = robot.collision, clearance_at_home(robot)
    if not len(needed):
        return []
    data, of_geometry = robot.model.createData(), geometry.createData()
    pin.computeDistances(robot.model, data, geometry, of_geometry, robot.home)
    apart = [float(result.min_distance) for result in of_geometry.distanceResults]
    links = [link_of(item.name) for item in geometry.geometryObjects]
    ends = [(links[pair.first], links[pair.second]) for pair in geometry.collisionPairs]
    return [(ends[k], apart[k], float(needed[k])) for k in np.argsort(apart, kind="stable")]


def _as_before(robot: Robot, q: Array, k: int) -> list[Array]:
    """Return configurations with arm k's home as an earlier arm's. Equal arms and mirror images count."""
    found, columns = [], robot.arms[k].columns
    for other in robot.arms[:k]:
        if len(other.columns) != len(columns):
            continue
        if all(np.array_equal(limit[other.columns], limit[columns]) for limit in (robot.lower, robot.upper)):
            found.append(q.copy())
            found[-1][columns] = q[other.columns]
        found += _mirrored(robot, q, other, robot.arms[k])
    return found


def _mirrored(robot: Robot, q: Array, other: Arm, arm: Arm) -> list[Array]:
    """Return an arm's configuration as another's mirror image, if joints allow."""
    if len(arm.columns) > SETTINGS.most_signs:
        return []
    signs = np.array(list(product((1.0, -1.0), repeat=len(arm.columns))))
    drawn = np.repeat(q[None], len(signs), axis=0)
    drawn[:, arm.columns] = signs * q[other.columns]
    drawn = drawn[((robot.lower <= drawn) & (drawn <= robot.upper)).all(axis=1)]
    if not len(drawn):
        return []
    hands, hand = robot.tool_poses(drawn, (arm,))[:, 0], robot.tool_pose(q, other)
    in_mirror = np.array([1.0, -1.0, 1.0])
    places = hands[:, :3, 3] - base_of(robot, arm) - in_mirror * (hand[:3, 3] - base_of(robot, other))
    miss = np.linalg.norm(places, axis=1) + np.linalg.norm(hands[:, :3, 2] - in_mirror * hand[:3, 2], axis=1)
    best = int(miss.argmin())
    return [drawn[best]] if miss[best] < SETTINGS.settled else []


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Random configurations of one arm.

    Attributes
    ----------
    arm : the arm
    joints : array, shape (n, n_joints of the arm) [rad, m]
    comfort : array, shape (n,), least distance of a joint from its limits, as a share of its range
    places : array, shape (n, 3), places of the end effector from the arm's base, in reaches
    approach : array, shape (n, 3), directions of its approach
    base, reach : place of the arm's first joint, and largest distance of the end effector from there [m]
    """

    arm: Arm
    joints: Array
    comfort: Array
    places: Array
    approach: Array
    base: Array
    reach: float

    @classmethod
    def of(cls, robot: Robot, arm: Arm, rng: np.random.Generator) -> _Drawn:
        lower, upper = robot.lower[arm.columns], robot.upper[arm.columns]
        low, high = np.maximum(lower, -np.pi), np.minimum(upper, np.pi)
        drawn = np.repeat(robot.home[None], SETTINGS.n_drawn, axis=0)
        joints = drawn[:, arm.columns] = rng.uniform(low, high, (SETTINGS.n_drawn, len(low)))
        poses, base = robot.tool_poses(drawn, (arm,))[:, 0], base_of(robot, arm)
        places = poses[:, :3, 3] - base
        reach = float(np.linalg.norm(places, axis=1).max())
        comfort = (np.minimum(joints - lower, upper - joints) / (upper - lower)).min(axis=1)
        return cls(arm, joints, comfort, places / reach, poses[:, :3, 2], base, reach)

    def best(self, q: Array, wanted: Array) -> Array:
        """Return q with this arm moved, the best for a home first; array, shape (n, n_joints)."""
        away = np.linalg.norm(self.places - wanted, axis=1)
        worth = self.comfort + 2.0 * (self.approach @ DOWN) - 2.0 * away
        found = np.repeat(q[None], len(worth), axis=0)
        found[:, self.arm.columns] = self.joints
        return found[np.argsort(-worth, kind="stable")]


def base_of(robot: Robot, arm: Arm) -> Array:
    """Return the place of the first joint of an arm; array, shape (3,) [m]."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.home)
    return np.array(data.oMi[int(arm.columns[0]) + 1].translation)


def tilt_of(pose: Array) -> float:
    """Return an end effector's angle from straight down [rad]; `pose` is (4, 4)."""
    return float(np.arccos(np.clip(DOWN @ pose[:3, 2], -1.0, 1.0)))


def floor_of(robot: Robot) -> float:
    """Return the height of a robot's lowest point at home [m]."""
    return float(min((points[:, 2].min() for _, points in placed_bodies(robot, robot.home)), default=0.0))


def _middle_of_reach(drawn: list[_Drawn]) -> Array:
    """Return the central place ahead of a base, in reaches; array, shape (3,).

    It is at the middle height of the places where end effectors can point down, and rather far away.
    """
    places = np.concatenate([arm.places for arm in drawn])
    front = -1.0 if places[:, 0].mean() < SETTINGS.backwards else 1.0
    ahead = front * places[:, 0] > SETTINGS.in_front
    down = np.concatenate([arm.approach for arm in drawn]) @ DOWN > np.cos(SETTINGS.steep)
    known = places[ahead & down] if (ahead & down).any() else places[ahead]
    if not len(known):
        return np.array([front * 0.5, 0.0, -0.15])
    return np.array([front * np.quantile(front * known[:, 0], SETTINGS.far), 0.0, np.median(known[:, 2])])


def _facing(bases: Array, ahead: Array) -> Array:
    """Return each end effector's place from its base, in reaches; array, shape (n_arms, 3).

    It is `ahead`, or between the bases of two arms that stand one behind the other, and so face each other.

    Parameters
    ----------
    bases : array, shape (n_arms, 3), places of the bases, in reaches
    ahead : array, shape (3,), the place straight in front of a base
    """
    wanted = np.repeat(ahead[None], len(bases), axis=0)
    if len(bases) != 2:
        return wanted
    way = bases[1] - bases[0]
    room = 0.5 * (abs(way[0]) - SETTINGS.apart)
    if room > SETTINGS.in_front and abs(way[0]) > abs(way[1]):
        wanted[:, 0] = np.sign(way[0]) * min(room, abs(ahead[0])) * np.array([1.0, -1.0])
    return wanted


def _settled(robot: Robot, arm: Arm, q: Array, place: Array, reach: float) -> tuple[Array, float]:
    """Return joints near q that point down at a place, and miss. The miss is in reaches and radians."""
    model, q = robot.model, q.copy()
    data, frame = model.createData(), model.getFrameId(arm.tip)
    aside = np.eye(3)[:2]  # the axes about which a hand that points down is turned; the vertical one is free
    keep, miss = limit_margin(robot), np.inf
    lower, upper = robot.lower + keep, robot.upper - keep
    q = np.clip(q, lower, upper)
    for _ in range(SETTINGS.n_steps):
        pose = robot.tool_pose(q, arm)
        error = np.concatenate([place - pose[:3, 3], aside @ np.cross(pose[:3, 2], DOWN)])
        miss = float(np.linalg.norm(error[:3])) / reach + tilt_of(pose)
        if miss < SETTINGS.settled:
            break
        moved = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)[:, arm.columns]
        lever = pose[:3, 3] - data.oMf[frame].translation
        rates = np.concatenate([moved[:3] + np.cross(moved[3:].T, lever).T, aside @ moved[3:]])
        square = rates @ rates.T + SETTINGS.damping * np.eye(5)
        q[arm.columns] += SETTINGS.gain * rates.T @ np.linalg.solve(square, error)
        q = np.clip(q, lower, upper)
    return _rounded(q, lower, upper), miss


def _rounded(q: Array, lower: Array, upper: Array) -> Array:
    """Return joints rounded within their limits; arrays, shape (n_joints,)."""
    q = np.clip(q, lower, upper)
    rounded = q.round(SETTINGS.digits)
    return np.where((rounded < lower) | (rounded > upper), q, rounded)


def _first_free(robot: Robot, some: list[Array], later: set[int], needed: Array) -> Array | None:
    """Return the free configuration with most spare distance [m]; None if there is none."""
    margins = (needed + (spare - ROOM.spares[-1]) for spare in ROOM.spares)
    near = (each for margin in margins for each in some if _is_free(robot, each, margin, later))
    return next(near, None)


def _is_free(robot: Robot, q: Array, margin: Array, later: set[int]) -> bool:
    """Return whether pairs of links keep margins [m], without later joints."""
    geometry = robot.collision
    data, of_geometry = robot.model.createData(), geometry.createData()
    for k, pair in enumerate(geometry.collisionPairs):
        joints = {geometry.geometryObjects[i].parentJoint for i in (pair.first, pair.second)}
        if joints & later:
            of_geometry.deactivateCollisionPair(k)
    for request, amount in zip(of_geometry.collisionRequests, margin.tolist(), strict=True):
        request.security_margin = amount
    return not pin.computeCollisions(robot.model, data, geometry, of_geometry, q, True)
