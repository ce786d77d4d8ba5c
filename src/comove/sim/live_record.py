"""Record of a robot's online run, and its verification.

=================== ==============================================================================================
quantity            computed from
=================== ==============================================================================================
grasps              commanded joints by Pinocchio against the payload as it was commanded, at every step
joints              ranges, speeds and accelerations of the commands, at every step
clearance           distances of the exact bodies by coal, at commanded *and* at measured joints, at every `stride`-th
                    step: sampled, not certified in between
contacts            the simulator's, at every simulation step
=================== ==============================================================================================
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from comove.arrays import Array, Integers, first_least
from comove.brief import brief
from comove.model.moving import rotations
from comove.model.scene import Scene
from comove.robots.model import Robot
from comove.robots.motion import JointMotion, approach_shares
from comove.robots.verification.bodies import links_of
from comove.robots.verification.checks import without_gripper
from comove.robots.verification.kinematics import moved_by
from comove.sim.execution import Contact, distances, work_geometry
from comove.sim.loads import Load, carried, hand_poses, load_of, points_of

if TYPE_CHECKING:
    from comove.robots.online.executor import JointExecutor

ROUNDING = 1e-6  # by which a share of a limit may exceed 1
MET = (
    ("clearance_scene", "a link and an obstacle"),
    ("clearance_carried", "the load and an obstacle"),
    ("clearance_load", "a link and the load"),
    ("clearance_self", "two links"),
)
"""Distances of a report below which something touches, and what that is."""


@dataclass(frozen=True)
class RunTolerances:
    """Limits for the verification of an online run.

    Attributes
    ----------
    hold_error : of commanded end effectors on the payload, which commands keep to rounding [m; a radian counts 1]
    squeezed : of the distance change of end effectors in the simulator, with its compliant servos, and of commanded
        end effectors on the payload while the arms brake by themselves [m; a radian counts 1]
    end_error : of the payload at its goal in the simulator [m]
    """

    hold_error: float = 1e-6
    squeezed: float = 1e-3
    end_error: float = 5e-3


@dataclass(eq=False)
class OnlineRecord:
    """Record of a run, step by step.

    Attributes
    ----------
    scene, robot : the scene and the robot
    time : times of the samples, after each control step [s]
    commanded, measured : joints, arrays of shape (n_joints,) [rad]
    nodes : end effectors and corners of the payload as commanded, arrays of shape (n_nodes, 3) [m]
    load : poses of the payload in the simulator, arrays of shape (4, 4)
    driven_off : whether the robot yielded to an external displacement; commands hold nothing then
    braked : whether the arms braked by themselves, as a command was late; none did unless given
    obstacles : true positions of the obstacles' centres, arrays of shape (n_obstacles, 3) [m]; their orientations are
        those of the scene
    contacts : unwanted contacts
    arrived, unstable, interrupted : how it ended
    given_up : reason why the executor gave up; empty if it did not
    """

    __repr__ = brief

    scene: Scene
    robot: Robot
    time: list[float] = field(default_factory=list)
    commanded: list[Array] = field(default_factory=list)
    measured: list[Array] = field(default_factory=list)
    nodes: list[Array] = field(default_factory=list)
    load: list[Array] = field(default_factory=list)
    driven_off: list[bool] = field(default_factory=list)
    obstacles: list[Array] = field(default_factory=list)
    braked: list[bool] = field(default_factory=list)
    contacts: tuple[Contact, ...] = ()
    arrived: bool = False
    unstable: bool = False
    interrupted: bool = False
    given_up: str = ""

    @property
    def period(self) -> float:
        """Return the control period [s]."""
        return float(self.time[0])

    @property
    def held(self) -> NDArray[np.bool_]:
        """Return where commands are to hold the payload to rounding; array, shape (n_steps,)."""
        held = ~np.array(self.driven_off)
        return held & ~np.array(self.braked) if self.braked else held

    @property
    def motion(self) -> JointMotion:
        """Return the commanded joints as a motion."""
        position = np.array([self.commanded[0], *self.commanded])
        return JointMotion(np.array([0.0, *self.time]), self.robot.joint_names, position)

    def add(self, executor: JointExecutor, measured: Array, load: Array) -> None:
        """Add the state after a control step."""
        from comove.control.safety.twists import nodes_of  # those who verify a record need none

        self.time.append(executor.time)
        self.commanded.append(executor.position.copy())
        self.measured.append(np.array(measured, dtype=float))
        self.nodes.append(nodes_of(self.scene, executor.poses))
        self.load.append(load)
        self.driven_off.append(executor.driven_off)
        self.obstacles.append(executor.observer.ground_truth(np.array([executor.time]))[0])


@dataclass(frozen=True)
class OnlineReport:
    """Measures of a run, and reasons against it.

    Attributes
    ----------
    hold_error_max : largest error of a commanded end effector on the payload, except while the robot is displaced [m;
        a radian counts 1]
    distance_error_max : largest change of two end effectors' distance in the simulator [m]
    velocity_ratio_max, acceleration_ratio_max : largest share of a joint's limit that commands use, likewise
    joint_margin_min : least distance of commanded joints from their limits [rad]
    clearance_scene, clearance_load, clearance_self : least sampled distances of links from obstacles, from the
        payload, and of each other [m]
    clearance_carried : least sampled distance of the payload from obstacles [m]
    nearest : names of the bodies at the least distance from an obstacle
    lag_max : largest difference of measured and commanded joints [rad]
    end_error : distance of the payload from its goal in the simulator [m]
    duration_s : duration of the run [s]
    without_gripper : names of the arms whose description has no gripper
    reasons : reasons against the run; none if it is valid
    """

    hold_error_max: float
    distance_error_max: float
    velocity_ratio_max: float
    acceleration_ratio_max: float
    joint_margin_min: float
    clearance_scene: float
    clearance_load: float
    clearance_self: float
    clearance_carried: float
    nearest: str
    lag_max: float
    end_error: float
    duration_s: float
    without_gripper: tuple[str, ...]
    reasons: tuple[str, ...]


def judge_run(
    record: OnlineRecord, *, stride: int = 5, limits: RunTolerances = RunTolerances()
) -> OnlineReport:
    """Verify a run from its measures.

    Parameters
    ----------
    stride : steps between samples of clearances; four times as many between those of links from each other
    limits : limits of the measures
    """
    commanded, measured = np.array(record.commanded), np.array(record.measured)
    hands = hand_poses(record.robot, record.scene, commanded)
    load = load_of(record.scene, hands[0])
    speed, acceleration, margin = _limits(record, commanded)
    clearances, nearest = _clearances(record, load, (commanded, measured), stride)
    measures = {
        "hold_error_max": _hold_error(record, hands, record.held),
        "distance_error_max": _distance_errors(hand_poses(record.robot, record.scene, measured)),
        "velocity_ratio_max": speed,
        "acceleration_ratio_max": acceleration,
        "joint_margin_min": margin,
        **clearances,
        "lag_max": float(np.abs(commanded - measured).max()),
        "end_error": _end_error(record, load),
        "duration_s": record.time[-1],
    }
    return OnlineReport(
        **measures,
        nearest=nearest,
        without_gripper=without_gripper(record.robot),
        reasons=tuple(_reasons(record, measures, hands, limits)),
    )


def _reasons(record: OnlineRecord, m: dict[str, float], hands: Array, limits: RunTolerances) -> list[str]:
    """Return the reasons against a run. `hands` are commanded poses, shape (n_steps, n_hands, 4, 4)."""
    reasons = [
        f"{contact.between[0]} and {contact.between[1]} touch at {contact.time:.2f} s, {contact.depth:.2g} m deep"
        for contact in record.contacts
    ]
    reasons += [f"{what} meet, by their exact bodies" for name, what in MET if not m[name] > 0.0]
    if record.given_up:
        reasons.append(record.given_up)
    if record.unstable:
        reasons.append(f"the simulation broke down at {record.time[-1]:.2f} s")
    if not record.arrived:
        reasons.append(f"the load has not arrived after {record.time[-1]:.2f} s")
    elif not m["end_error"] <= limits.end_error:
        reasons.append(f"the load ends {m['end_error']:.2g} m from its goal")
    if not m["hold_error_max"] <= limits.hold_error:
        reasons.append(f"a commanded hand is off the load by {m['hold_error_max']:.2g} m or rad")
    braked = _hold_error(record, hands, ~np.array(record.driven_off))
    if not braked <= max(limits.squeezed, m["hold_error_max"]):
        reasons.append(f"a commanded hand of braking arms is off the load by {braked:.2g} m or rad")
    torn = _distance_errors(hands[~np.array(record.driven_off)])
    if not torn <= limits.squeezed:
        reasons.append(f"hands were commanded to change their distance by {torn:.2g} m")
    if not m["distance_error_max"] <= limits.squeezed:
        reasons.append(f"hands change their distance by {m['distance_error_max']:.2g} m")
    for name in ("velocity", "acceleration"):
        if not m[f"{name}_ratio_max"] <= 1 + ROUNDING:
            reasons.append(f"a joint uses {m[f'{name}_ratio_max']:.3g} of its {name} limit")
    if not m["joint_margin_min"] >= 0:
        reasons.append(f"a joint is {-m['joint_margin_min']:.2g} rad beyond its limits")
    return reasons


def _hold_error(record: OnlineRecord, hands: Array, held: NDArray[np.bool_]) -> float:
    """Return the largest commanded grasp error at some steps, (n_steps,) [m, rad]."""
    if not held.any():
        return 0.0
    nodes, hands, grasp = np.array(record.nodes)[held], hands[held], record.scene.grasp
    off = np.linalg.norm(hands[..., :3, 3] - nodes[:, : hands.shape[1]], axis=-1).max()
    if grasp is None:
        return float(off)
    chord = np.linalg.norm(hands[..., :3, :3] - grasp.hand_rotations(nodes), axis=(-2, -1)) / np.sqrt(8.0)
    return float(max(off, 2.0 * np.arcsin(min(1.0, chord.max()))))


def _distance_errors(hands: Array) -> float:
    """Return the largest change of two end effectors' distance [m]. `hands` is an array of shape (n_steps, n_hands,
    4, 4)."""
    if not len(hands):
        return 0.0
    apart = distances(hands[..., :3, 3])
    return float(np.abs(apart - apart[0]).max(initial=0.0))


def _limits(record: OnlineRecord, commanded: Array) -> tuple[float, float, float]:
    """Return the largest joint-limit shares, and the least margin [rad]."""
    robot, rates = record.robot, np.diff(commanded, axis=0) / record.period
    bends, off = np.diff(rates, axis=0) / record.period, np.array(record.driven_off)
    went = off[1:] | off[:-1]  # where it was, not where it was commanded to
    rates, bends = rates[~went], bends[~(went[1:] | went[:-1])]
    shares = np.abs(rates) / robot.velocity
    soft = approach_shares(commanded[1:][~went], rates, robot.approach, robot.lower, robot.upper)
    margin = np.minimum(commanded - robot.lower, robot.upper - commanded).min()
    return (
        float(np.maximum(shares, soft).max(initial=0.0)),
        float((np.abs(bends) / robot.acceleration).max(initial=0.0)),
        float(margin),
    )


def _end_error(record: OnlineRecord, load: Load | None) -> float:
    """Return the distance of the simulated payload from its goal [m]."""
    if load is None:
        return 0.0
    goal = record.scene.nodes_at("goal")[list(load.holders)]
    return float(np.linalg.norm(points_of(record.load[-1], load.grasps) - goal, axis=1).max())


def _clearances(
    record: OnlineRecord, load: Load | None, joints: tuple[Array, Array], stride: int
) -> tuple[dict[str, float], str]:
    """Return the least distances by name, and the nearest bodies. Every `stride`-th step counts, with commanded and
    with measured joints; names are those of `OnlineReport`."""
    robot = record.robot
    geometry, names, parts = work_geometry(robot, record.scene, load)
    data, placed = robot.model.createData(), geometry.createData()
    first = robot.collision.ngeoms
    pairs = [(pair.first, pair.second) for pair in geometry.collisionPairs]
    ends = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    links, beyond = range(first), range(first + len(record.scene.motions), geometry.ngeoms)
    kinds = np.array([0 if a in links and b not in beyond else 2 if b in links else 1 for a, b in pairs])
    least, which, own = np.full(3, np.inf), np.full(3, -1), _LinkDistances(robot)
    turned, balls = rotations(record.scene.turns(np.asarray(record.time))), _BoundingBalls(geometry)
    for q, poses in zip(joints, _loads(record, load, joints), strict=True):
        for step in range(0, len(q), stride):
            pin.updateGeometryPlacements(robot.model, data, geometry, placed, q[step])
            for i, center in enumerate(record.obstacles[step]):
                placed.oMg[first + i] = pin.SE3(turned[step, i] @ placed.oMg[first + i].rotation, center)
            for item, part in zip(parts, () if load is None else load.parts, strict=True):
                placed.oMg[item] = pin.SE3(poses[step]) * part.placement
            apart = balls.apart(placed, *ends)
            for kind in range(3):
                near = np.flatnonzero((kinds == kind) & (apart < least[kind]))
                if not len(near):
                    continue
                distance = np.array(
                    [pin.computeDistance(geometry, placed, k).min_distance for k in near.tolist()]
                )
                if distance.min() < least[kind]:
                    which[kind], least[kind] = near[first_least(distance)], distance.min()
            if step % (4 * stride) == 0:
                own.look(q[step])
    pair = int(which[int(np.argmin(least[:2]))])
    nearest = "" if pair < 0 else f"{names[pairs[pair][0]]} and {names[pairs[pair][1]]}"
    measured = ("clearance_scene", "clearance_carried", "clearance_load")
    return {**dict(zip(measured, least.tolist(), strict=True)), "clearance_self": own.least}, nearest


class _LinkDistances:
    """Least distance of a robot's links from each other.

    A pair is measured again when it may have come nearer than the least distance: no distance changes by more than
    the joints' motions times their levers.

    Attributes
    ----------
    least : least distance of any pair so far [m]
    """

    def __init__(self, robot: Robot):
        links, moved = links_of(robot), moved_by(robot)
        first, second = links.pairs.T
        differ = moved[links.joint[first]] != moved[links.joint[second]]
        self._robot, self._data, self._placed = robot, robot.model.createData(), robot.collision.createData()
        self._pairs, self.least = [self._number(pair) for pair in links.pairs.tolist()], np.inf
        self._change = np.where(differ, links.reach[first] + links.reach[second], 0.0)
        self._distance, self._at = np.full(len(differ), -np.inf), np.zeros((len(differ), robot.model.nv))

    def _number(self, pair: list[int]) -> int:
        return int(self._robot.collision.findCollisionPair(pin.CollisionPair(*pair)))

    def look(self, q: Array) -> None:
        """Take in joints (n_joints,) [rad, m]."""
        possible = self._distance - (self._change * np.abs(q - self._at)).sum(axis=1)
        near = np.flatnonzero(possible < self.least)
        if not len(near):
            return
        robot = self._robot
        pin.updateGeometryPlacements(robot.model, self._data, robot.collision, self._placed, q)
        for k in near.tolist():
            found = pin.computeDistance(robot.collision, self._placed, self._pairs[k])
            self._distance[k], self._at[k] = found.min_distance, q
        self.least = min(self.least, float(self._distance[near].min()))


class _BoundingBalls:
    """Bounding balls of a geometry model's bodies."""

    def __init__(self, geometry: Any):
        shapes = [item.geometry for item in geometry.geometryObjects]
        for shape in shapes:
            shape.computeLocalAABB()
        self.center = np.array([shape.aabb_center for shape in shapes])
        self.radius = np.array([shape.aabb_radius for shape in shapes])

    def apart(self, placed: Any, first: Integers, second: Integers) -> Array:
        """Bound the distances of bodies from below, (n_pairs,) [m]; `placed` is a pinocchio.GeometryData."""
        center = np.array([place.act(point) for place, point in zip(placed.oMg, self.center, strict=True)])
        return (
            np.linalg.norm(center[first] - center[second], axis=1) - self.radius[first] - self.radius[second]
        )


def _loads(record: OnlineRecord, load: Load | None, joints: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the payload's poses as commanded and as simulated. Arrays, shape (n_steps, 4, 4)."""
    simulated = np.array(record.load)
    if load is None:
        return simulated, simulated
    held = hand_poses(record.robot, record.scene, joints[0])[:, list(load.holders)]
    return carried(held, np.linalg.inv(held[0]) @ load.pose), simulated
