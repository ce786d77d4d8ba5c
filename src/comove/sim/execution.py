"""Record of an executed joint motion: series, contacts, delivery.

The forces of the end effectors on the payload are split into a part that moves it and an internal part. End effector
i at p_i (from the payload's origin) exerts the force f_i and the torque t_i. Their resultants are

    F = sum f_i,    M = sum (t_i + p_i x f_i).

The part that moves the payload is distributed evenly by the non-squeezing pseudoinverse of the grasp matrix (Walker,
Freeman and Marcus 1991, "Analyzing motion and internal loading of objects grasped by multiple cooperating
manipulators"),

    f_i = F / m,    t_i = (M - p_i x F) / m,

and the rest is internal: it cancels out, moves nothing and only strains arms and payload. For two end effectors the
internal force is half the difference of their forces; its part along the line between them, the squeeze, is the
force in the middle member of the virtual linkage (Williams and Khatib 1993).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from comove.arrays import Array
from comove.brief import brief
from comove.model.scene import Scene
from comove.robots.model import Robot
from comove.robots.motion import JointMotion
from comove.robots.verification.bodies import MovingObstacles, beyond_wrists, depth_of, obstacle_object
from comove.sim.loads import SETTLED, Load, carried, hand_poses, points_of, supports_under
from comove.sim.settings import PLAN, USUAL, Perturbation, Settings

if TYPE_CHECKING:
    from comove.sim.grasps import GraspModel


@dataclass(frozen=True)
class Contact:
    """Unwanted contact of two bodies.

    Attributes
    ----------
    between : names of the two bodies
    time : time of the first contact [s]
    depth : largest depth of penetration [m]
    """

    between: tuple[str, str]
    time: float
    depth: float

    @property
    def words(self) -> str:
        """Return a description."""
        first, second = self.between
        return f"{first} touched {second} at {self.time:.2f} s, {1e3 * self.depth:.1f} mm deep at most"


@dataclass(frozen=True)
class Conditions:
    """Conditions under which a joint motion was executed.

    Attributes
    ----------
    simulator : "mujoco" or "geometric"
    grasp : model of the grasp of the payload
    settings, perturbation : settings and perturbation of the simulation
    """

    simulator: str
    grasp: GraspModel
    settings: Settings = USUAL
    perturbation: Perturbation = PLAN


@dataclass(frozen=True, eq=False)
class Execution:
    """Executed joint motion.

    Time 0 is the beginning of the motion; in the last samples the robot is at rest at the end. Planned poses of the
    payload follow from the planned end effectors and the payload's pose relative to them at time 0.

    Attributes
    ----------
    robot, scene, motion : the joint motion, and the robot and the scene on which it was executed
    conditions : simulator, grasp, settings and perturbation
    load : the payload; None if there is none
    time : array, shape (n_steps,), times of the samples [s]
    joints : array, shape (n_steps, n_joints), measured joint positions [rad]
    torque : array, shape (n_steps, n_joints), torques of the motors [N m]
    hands : array, shape (n_steps, n_manipulators, 4, 4), measured grasp frames
    load_pose : array, shape (n_steps, 4, 4), poses of the payload; NaN without a payload
    wrench : array, shape (n_steps, n_holders, 6), force and torque on the payload at the grasps [N, N m]
    fingers : array, shape (n_steps, n_fingers), positions of the fingers' joints [rad or m]
    contacts : contacts of robot and payload with obstacles and with each other
    steps_per_second : steps computed per second
    unstable : time at which the simulation became unstable [s], None if it did not
    """

    __repr__ = brief

    robot: Robot
    scene: Scene
    motion: JointMotion
    conditions: Conditions
    load: Load | None
    time: Array
    joints: Array
    torque: Array
    hands: Array
    load_pose: Array
    wrench: Array
    fingers: Array
    contacts: tuple[Contact, ...]
    steps_per_second: float = 0.0
    unstable: float | None = None

    @property
    def holders(self) -> list[int]:
        """Return the numbers of the end effectors that hold the payload."""
        return [] if self.load is None else list(self.load.holders)

    @cached_property
    def commanded(self) -> Array:
        """Return the commanded joint positions; array, shape (n_steps, n_joints) [rad]."""
        return self.motion.at(np.clip(self.time, 0.0, self.motion.duration))[0]

    @cached_property
    def hands_planned(self) -> Array:
        """Return the planned grasp frames; array, shape (n_steps, n_manipulators, 4, 4)."""
        return hand_poses(self.robot, self.scene, self.commanded)

    @cached_property
    def held(self) -> Array:
        """Return the payload's pose in the frame of each holder. Array, shape (n_steps, n_holders, 4, 4)."""
        return np.linalg.inv(self.hands[:, self.holders]) @ self.load_pose[:, None]

    @cached_property
    def load_planned(self) -> Array:
        """Return the planned poses of the payload; array, shape (n_steps, 4, 4)."""
        if not np.isfinite(self.held[0]).all():  # it broke down before the motion began
            return np.full_like(self.load_pose, np.nan)
        return carried(self.hands_planned[:, self.holders], self.held[0])

    @cached_property
    def lag(self) -> Array:
        """Return the largest deviation of a grasp from its plan [m]. Without a payload, it is that of an end
        effector; array, shape (n_steps,)."""
        if self.load is None:
            apart = self.hands[..., :3, 3] - self.hands_planned[..., :3, 3]
        else:
            apart = points_of(self.load_pose, self.load.grasps) - points_of(
                self.load_planned, self.load.grasps
            )
        return np.linalg.norm(apart, axis=-1).max(axis=-1)

    @cached_property
    def distance_error(self) -> Array:
        """Return the distances of holders less those of their grasps [m]. Array, shape (n_steps, n_pairs)."""
        planned = distances(np.zeros((0, 3)) if self.load is None else self.load.grasps)
        return distances(self.hands[:, self.holders][..., :3, 3]) - planned

    @cached_property
    def slip(self) -> Array:
        """Return each holder's slip since 0 s [m]; shape (n_steps, n_holders)."""
        in_load = np.linalg.inv(self.held)[..., :3, 3]
        return np.linalg.norm(in_load - in_load[:1], axis=-1)

    @cached_property
    def internal(self) -> Array:
        """Return the internal wrenches [N, N m]; array, shape (n_steps, n_holders, 6)."""
        return internal_wrenches(self.wrench, self._arms)

    @cached_property
    def squeeze(self) -> Array:
        """Return squeezes [N], positive where end effectors press; shape (n_steps, n_pairs)."""
        return squeezes(self.wrench, self._arms)

    @cached_property
    def _arms(self) -> Array:
        return self.hands[:, self.holders][..., :3, 3] - self.load_pose[:, None, :3, 3]

    @property
    def start_error(self) -> float:
        """Return the payload's distance from its planned start at time 0 [m]."""
        return self._from_scene(0)

    @property
    def end_error(self) -> float:
        """Return the payload's final distance from its plan [m]. The plan starts at its pose at time 0."""
        return float(self.lag[-1])

    @property
    def goal_error(self) -> float:
        """Return the payload's final distance from its goal [m]. It includes the start error."""
        return self._from_scene(-1)

    def _from_scene(self, step: int) -> float:
        """Return the largest distance of a grasp from its planned frame [m]."""
        if self.load is None:
            return float(self.lag[step])
        apart = (
            points_of(self.load_pose[step], self.load.grasps)
            - self.hands_planned[step][self.holders][:, :3, 3]
        )
        return float(np.linalg.norm(apart, axis=-1).max())

    @cached_property
    def measures(self) -> dict[str, float | None]:
        """Return the measures of the execution [m, N, shares]. They are None where there is nothing to measure."""
        return {
            "end_error": self.end_error,
            "goal_error": self.goal_error,
            "start_error": self.start_error,
            "lag_max": _largest(self.lag),
            "distance_error_max": _largest(self.distance_error),
            "slip_max": _largest(self.slip),
            "internal_force_max": _largest(np.linalg.norm(self.internal[..., :3], axis=-1)),
            "internal_torque_max": _largest(np.linalg.norm(self.internal[..., 3:], axis=-1)),
            "squeeze_max": _largest(self.squeeze),
            "torque_share_max": _largest(self.torque / self.robot.effort),
            "tracking_error_max": _largest(self.joints - self.commanded),
            "contact_depth_max": max((contact.depth for contact in self.contacts), default=0.0),
        }

    @cached_property
    def reasons(self) -> tuple[str, ...]:
        """Return the reasons why the payload was not delivered; empty if delivered."""
        limits, found = self.conditions.settings, []
        if self.unstable is not None:
            found.append(f"the simulation broke down at {self.unstable:.2f} s")
        if (
            self.start_error
            > np.linalg.norm(self.conditions.perturbation.start_error) + limits.end_error_limit
        ):
            found.append(
                f"the load was {1e3 * self.start_error:.1f} mm from its place when the motion began: the hands "
                "did not hold it"
            )
        found += [contact.words for contact in self.contacts]
        for hand, slip in zip(self.holders, self.slip.T, strict=True):
            found += _slipped(self.scene.manipulators[hand], self.time, slip, limits.slip_limit)
        force = np.linalg.norm(self.internal[..., :3], axis=-1)
        if force.size and force.max() > limits.internal_force_limit:
            found.append(
                f"the hands worked against each other with {force.max():.0f} N at "
                f"{self.time[force.max(axis=1).argmax()]:.2f} s, more than {limits.internal_force_limit:g} N"
            )
        if not self.end_error <= limits.end_error_limit:
            what = "the load" if self.load is not None else "a hand"
            found.append(
                f"{what} ended {1e3 * self.end_error:.1f} mm from its goal, more than "
                f"{1e3 * limits.end_error_limit:g} mm"
            )
        return tuple(found)

    @property
    def delivered(self) -> bool:
        """Return whether the payload arrived without slip, contact or instability."""
        return not self.reasons

    def series(self) -> dict[str, NDArray[Any]]:
        """Return all series by name, for files."""
        measured = ("time", "commanded", "joints", "torque", "hands", "hands_planned", "load_pose")
        forces = ("wrench", "fingers")
        derived = ("lag", "distance_error", "slip", "internal", "squeeze")
        return {name: getattr(self, name) for name in (*measured, *forces, *derived)}


def _slipped(hand: str, time: Array, slip: Array, limit: float) -> list[str]:
    """Describe excessive slip of an end effector; empty if there is none."""
    dropped = 0.03  # m, that a load has slid in a hand that has lost it
    if slip.max() > dropped:
        return [f"the load left the hand '{hand}' at {time[slip > dropped][0]:.2f} s"]
    if slip.max() > limit:
        return [
            f"the load slid {1e3 * slip.max():.1f} mm in the hand '{hand}', beyond {1e3 * limit:g} mm from "
            f"{time[slip > limit][0]:.2f} s on"
        ]
    return []


def distances(points: Array) -> Array:
    """Return the pairwise distances of points [m]. The shapes are (..., n_points, 3) -> (..., n_pairs)."""
    first, second = np.triu_indices(points.shape[-2], 1)
    return np.linalg.norm(points[..., first, :] - points[..., second, :], axis=-1)


def _largest(series: Array) -> float | None:
    return float(np.abs(series).max()) if series.size else None


def internal_wrenches(wrenches: Array, points: Array) -> Array:
    """Compute the internal part of the end effectors' wrenches.

    Parameters
    ----------
    wrenches : array, shape (n_steps, n_hands, 6), force [N] and torque [N m] at the end effector's grasp
    points : array, shape (n_steps, n_hands, 3), positions of the grasps from the payload's origin [m], in the same
        axes

    Returns
    -------
    array, shape (n_steps, n_hands, 6)
    """
    forces, torques = wrenches[..., :3], wrenches[..., 3:]
    force = forces.sum(axis=1, keepdims=True)
    torque = (torques + np.cross(points, forces)).sum(axis=1, keepdims=True)
    share = np.concatenate(np.broadcast_arrays(force, torque - np.cross(points, force)), axis=-1)
    return wrenches - share / max(wrenches.shape[1], 1)


def squeezes(wrenches: Array, points: Array) -> Array:
    """Compute the internal forces along lines between end effectors [N].

    Each is half the difference of two forces, positive where they press.

    Parameters
    ----------
    wrenches, points : as for `internal_wrenches`

    Returns
    -------
    array, shape (n_steps, n_pairs), for the pairs (0, 1), (0, 2), ... (1, 2), ...
    """
    first, second = np.triu_indices(points.shape[1], 1)
    across = points[:, second] - points[:, first]
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-12)
    return 0.5 * ((wrenches[:, first, :3] - wrenches[:, second, :3]) * across).sum(axis=-1)


def obstacle_time(time: Array, duration: float) -> Array:
    """Return the obstacles' times in a simulation [s]. Obstacles stay after the motion's duration, since later
    contacts with a resting payload are not planned."""
    return np.minimum(time, duration)


def contacts_between(
    robot: Robot,
    motion: JointMotion,
    scene: Scene,
    load: Load | None,
    time: Array,
    joints: Array,
    poses: Array,
) -> tuple[Contact, ...]:
    """Find the contacts of links, payload and obstacles. Contacts of the payload with the end effectors that hold it
    are left out. A payload that rests on a support touches it, up to `SETTLED` deep."""
    geometry, names, moved = work_geometry(robot, scene, load)
    data, state = robot.model.createData(), geometry.createData()
    found: dict[int, tuple[float, float]] = {}
    parts = [] if load is None else [part.placement for part in load.parts]
    obstacles = MovingObstacles.among(scene, geometry.geometryObjects, robot.collision.ngeoms, {})
    turns, places = obstacles.placements(obstacle_time(time, motion.duration))
    for step, q in enumerate(joints):
        pin.updateGeometryPlacements(robot.model, data, geometry, state, q)
        for item, part in zip(moved, parts, strict=True):
            state.oMg[item] = pin.SE3(poses[step]) * part
        for item, turn, place in zip(obstacles.body.tolist(), turns[step], places[step], strict=True):
            state.oMg[item] = pin.SE3(turn, place)
        if not pin.computeCollisions(geometry, state, False):
            continue
        under = supports_under(scene, load, poses[step])
        for k in range(len(geometry.collisionPairs)):
            if state.collisionResults[k].isCollision():
                ends = geometry.collisionPairs[k].first, geometry.collisionPairs[k].second
                shapes = [geometry.geometryObjects[end].geometry for end in ends]
                depth, _ = depth_of(shapes, [state.oMg[end] for end in ends])
                if ends[0] in moved and names[ends[1]] in under and depth <= SETTLED:
                    continue
                first, deepest = found.get(k, (float(time[step]), 0.0))
                found[k] = first, max(deepest, float(depth))
    pairs = geometry.collisionPairs
    return tuple(Contact((names[pairs[k].first], names[pairs[k].second]), *seen) for k, seen in found.items())


def contacts_at(execution: Execution, stride: int = 1) -> tuple[Contact, ...]:
    """Return the contacts of an execution by geometry alone. Every `stride`-th sample is checked."""
    steps = slice(None, None, stride)
    return contacts_between(
        execution.robot,
        execution.motion,
        execution.scene,
        execution.load,
        execution.time[steps],
        execution.joints[steps],
        execution.load_pose[steps],
    )


def work_geometry(robot: Robot, scene: Scene, load: Load | None) -> tuple[Any, list[str], list[int]]:
    """Build the geometry of robot, obstacles and payload with collision pairs. Return it with the names of all
    bodies, and the numbers of the payload's parts."""
    geometry = robot.collision.copy()
    geometry.removeAllCollisionPairs()
    links = range(geometry.ngeoms)
    names = [robot.model.frames[item.parentFrame].name for item in geometry.geometryObjects]
    obstacles = []
    for i in range(len(scene.file.obstacles)):
        names.append(scene.name_of(i))
        obstacles.append(geometry.addGeometryObject(obstacle_object(scene, i, names[-1], -scene.begins)))
    hands = _hand_joints(robot, scene, load)
    parts = []
    for i, part in enumerate(load.parts if load is not None else ()):
        names.append("the load")
        parts.append(
            geometry.addGeometryObject(pin.GeometryObject(f"load {i}", 0, pin.SE3.Identity(), part.shape))
        )
    free = [i for i in links if geometry.geometryObjects[i].parentJoint not in hands]
    moving = [i for i in links if geometry.geometryObjects[i].parentJoint > 0]
    pairs = [(i, o) for i in moving for o in obstacles]
    pairs += [(p, other) for p in parts for other in (*obstacles, *free)]
    for first, second in pairs:
        geometry.addCollisionPair(pin.CollisionPair(first, second))
    return geometry, names, parts


def _hand_joints(robot: Robot, scene: Scene, load: Load | None) -> set[int]:
    arms = [robot.arm(scene.manipulators[i]) for i in (load.holders if load is not None else ())]
    return beyond_wrists(robot, arms)
