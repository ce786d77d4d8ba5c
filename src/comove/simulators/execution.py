"""What happened while a joint motion was executed: series, contacts, and whether the load was delivered."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.robots.model import Robot
from comove.robots.motion import JointMotion
from comove.scenes.scene import Scene
from comove.simulators.forces import internal_wrenches, squeezes
from comove.simulators.grasps import GraspModel
from comove.simulators.loads import Load, carried, inverse, points_of
from comove.simulators.perturbation import PLAN, Perturbation
from comove.simulators.settings import Settings

Array = NDArray[np.float64]

DROPPED = 0.03  # m, that a load has slid in a hand that has lost it


@dataclass(frozen=True)
class Contact:
    """Two things that touched and should not have.

    Attributes
    ----------
    between : what touched
    time : when first [s]
    depth : how deep at most [m]
    """

    between: tuple[str, str]
    time: float
    depth: float


@dataclass(frozen=True, eq=False)
class Execution:
    """A joint motion as it was executed.

    Time 0 is where the motion begins; the last samples are of the robot standing still at the end. Planned poses of
    the load are where the planned hands carry it as it lies in the hands at time 0.

    Attributes
    ----------
    robot, scene, motion : what was executed
    simulator : "mujoco" or "geometric"
    grasp : how the hands held the load
    load : None without one
    settings, perturbation : as given
    time : array, shape (n_steps,) [s]
    commanded, joints : arrays, shape (n_steps, n_joints) [rad], asked for and measured
    torque : array, shape (n_steps, n_joints), of the motors [N m]
    hands, hands_planned : arrays, shape (n_steps, n_manipulators, 4, 4), grasp frames
    load_pose : array, shape (n_steps, 4, 4); NaN without a load
    wrench : array, shape (n_steps, n_holders, 6), force and torque on the load at the grasps [N, N m]
    fingers : array, shape (n_steps, n_fingers) [rad or m]
    contacts : of robot and load with obstacles and each other
    steps_per_second : how fast it went
    unstable : when the simulation broke down [s], None if it did not
    """

    robot: Robot
    scene: Scene
    motion: JointMotion
    simulator: str
    grasp: GraspModel
    load: Load | None
    settings: Settings
    time: Array
    commanded: Array
    joints: Array
    torque: Array
    hands: Array
    hands_planned: Array
    load_pose: Array
    wrench: Array
    fingers: Array
    contacts: tuple[Contact, ...]
    perturbation: Perturbation = PLAN
    steps_per_second: float = 0.0
    unstable: float | None = None

    @property
    def holders(self) -> list[int]:
        """Hands that hold the load, by number."""
        return [] if self.load is None else list(self.load.holders)

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Pairs of holders, by number of the hand."""
        return tuple((a, b) for i, a in enumerate(self.holders) for b in self.holders[i + 1 :])

    @cached_property
    def held(self) -> Array:
        """The load's pose in the frame of each holder; array, shape (n_steps, n_holders, 4, 4)."""
        return inverse(self.hands[:, self.holders]) @ self.load_pose[:, None]

    @cached_property
    def load_planned(self) -> Array:
        """Where the load should be; array, shape (n_steps, 4, 4)."""
        if not np.isfinite(self.held[0]).all():  # it broke down before the motion began
            return np.full_like(self.load_pose, np.nan)
        return carried(self.hands_planned[:, self.holders], self.held[0])

    @cached_property
    def lag(self) -> Array:
        """Largest distance of a grasp on the load, or of a hand without one, from its plan [m]; (n_steps,)."""
        if self.load is None:
            apart = self.hands[..., :3, 3] - self.hands_planned[..., :3, 3]
        else:
            apart = points_of(self.load_pose, self.load.grasps) - points_of(
                self.load_planned, self.load.grasps
            )
        return np.linalg.norm(apart, axis=-1).max(axis=-1)

    @cached_property
    def distance_error(self) -> Array:
        """Distances of the holders less those of their grasps on the load [m]; array, shape (n_steps, n_pairs)."""
        planned = _distances(np.zeros((0, 3)) if self.load is None else self.load.grasps)
        return _distances(self.hands[:, self.holders][..., :3, 3]) - planned

    @cached_property
    def slip(self) -> Array:
        """How far each holder has slid on the load since time 0 [m]; array, shape (n_steps, n_holders)."""
        in_load = inverse(self.held)[..., :3, 3]
        return np.linalg.norm(in_load - in_load[:1], axis=-1)

    @cached_property
    def internal(self) -> Array:
        """Wrenches that cancel out (`comove.simulators.forces`); array, shape (n_steps, n_holders, 6) [N, N m]."""
        return internal_wrenches(self.wrench, self._arms)

    @cached_property
    def squeeze(self) -> Array:
        """Force between two hands along their line, positive where they press [N]; (n_steps, n_pairs)."""
        return squeezes(self.wrench, self._arms)

    @cached_property
    def _arms(self) -> Array:
        return self.hands[:, self.holders][..., :3, 3] - self.load_pose[:, None, :3, 3]

    @property
    def start_error(self) -> float:
        """How far the load lies from its planned start at time 0 [m]."""
        return self._from_scene(0)

    @property
    def end_error(self) -> float:
        """How far the load, carried as it lay at time 0, ends from its plan [m]."""
        return float(self.lag[-1])

    @property
    def goal_error(self) -> float:
        """How far the load ends from its planned goal, its start error included [m]."""
        return self._from_scene(-1)

    def _from_scene(self, step: int) -> float:
        """Largest distance of a grasp on the load from the planned hand [m]."""
        if self.load is None:
            return float(self.lag[step])
        apart = (
            points_of(self.load_pose[step], self.load.grasps)
            - self.hands_planned[step][self.holders][:, :3, 3]
        )
        return float(np.linalg.norm(apart, axis=-1).max())

    @cached_property
    def measures(self) -> dict[str, float | None]:
        """The figures of the execution: metres, newtons, shares; None where there is nothing to measure."""
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
        """Why the load was not delivered, in words; empty where it was."""
        limits, found = self.settings, []
        if self.unstable is not None:
            found.append(f"the simulation broke down at {self.unstable:.2f} s")
        if self.start_error > np.linalg.norm(self.perturbation.start_error) + limits.end_error_limit:
            found.append(
                f"the load was {1e3 * self.start_error:.1f} mm from its place when the motion began: the hands "
                "did not hold it"
            )
        for contact in self.contacts:
            found.append(
                f"{contact.between[0]} touched {contact.between[1]} at {contact.time:.2f} s, "
                f"{1e3 * contact.depth:.1f} mm deep at most"
            )
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
        """Whether the load arrived, held all the way, without touching anything."""
        return not self.reasons

    def series(self) -> dict[str, NDArray[Any]]:
        """All series by name, for files."""
        measured = ("time", "commanded", "joints", "torque", "hands", "hands_planned", "load_pose")
        forces = ("wrench", "fingers")
        derived = ("lag", "distance_error", "slip", "internal", "squeeze")
        return {name: getattr(self, name) for name in (*measured, *forces, *derived)}


def _slipped(hand: str, time: Array, slip: Array, limit: float) -> list[str]:
    """How the load slid in a hand, in words; nothing where it hardly did."""
    if slip.max() > DROPPED:
        return [f"the load left the hand '{hand}' at {time[slip > DROPPED][0]:.2f} s"]
    if slip.max() > limit:
        return [
            f"the load slid {1e3 * slip.max():.1f} mm in the hand '{hand}', beyond {1e3 * limit:g} mm from "
            f"{time[slip > limit][0]:.2f} s on"
        ]
    return []


def _distances(points: Array) -> Array:
    first, second = np.triu_indices(points.shape[-2], 1)
    return np.linalg.norm(points[..., first, :] - points[..., second, :], axis=-1)


def _largest(series: Array) -> float | None:
    return float(np.abs(series).max()) if series.size else None
