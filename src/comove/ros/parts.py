"""Parts of a motion for a robot, with their provenance.

The *carry* is the verified transfer motion. The *approach* moves the end effectors from home, or the present joints,
to the grasp and grips, the *release* lets go and moves them home; both come from `comove.robots.transfers`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from numbers import Real
from typing import NamedTuple

import numpy as np

from comove._version import __version__
from comove.arrays import Array, Integers
from comove.errors import ExportError
from comove.model.motion import SAMPLE_RATE
from comove.results.sealed import checksum
from comove.results.solution import motion_arrays
from comove.robots.files import joint_arrays
from comove.robots.motion import JointMotion
from comove.robots.transfers import Transfers
from comove.robots.verification.verify import VerifiedJointMotion

LEAST_RATE = 20.0  # Hz; below, cubic interpolation bends the load by more than 0.01 mm, linear by 0.4 mm
LARGEST_RATE = 1000.0  # Hz, of the fastest controllers
NANO = 10**9
PARTS = CARRY, APPROACH, RELEASE = "carry", "approach", "release"
IN_STEP = "obstacles move: begin the motion at the instant at which they are where the scene has them at 0 s"


@dataclass(frozen=True)
class MotionProvenance:
    """Provenance of a motion, written into every export. `begin` says when the motion must begin, where that
    matters. The checksums are those in the `robot.json` of a result: of the end effectors' motion and of the joints'
    carry."""

    comove: str
    scene: str
    scene_sha256: str
    robot: str
    robot_sha256: str
    motion_sha256: str
    joints_sha256: str
    part: str
    begin: str = ""

    def asdict(self) -> dict[str, str]:
        """Return the entries by name, without empty ones."""
        return {name: text for name, text in asdict(self).items() if text}


@dataclass(frozen=True, eq=False)
class JointSamples:
    """Samples of a joint motion at even instants, resting at both ends. Times are whole nanoseconds, as in ROS.

    Attributes
    ----------
    joint_names : names of the joints
    nanoseconds : array of int, shape (n_steps,), times of the samples [ns]
    position, velocity, acceleration : arrays, shape (n_steps, n_joints) [rad, rad/s, rad/s^2]
    """

    joint_names: tuple[str, ...]
    nanoseconds: Integers
    position: Array
    velocity: Array
    acceleration: Array

    @property
    def time(self) -> Array:
        """Return the times of the samples [s]; array, shape (n_steps,)."""
        return self.nanoseconds / NANO

    @classmethod
    def joined(cls, samples: Sequence[JointSamples]) -> JointSamples:
        """Return samples of the same instants as those of one motion."""
        names = tuple(name for part in samples for name in part.joint_names)
        rates = (
            np.concatenate([getattr(part, kind) for part in samples], axis=1)
            for kind in ("position", "velocity", "acceleration")
        )
        return cls(names, samples[0].nanoseconds, *rates)

    def of(self, names: tuple[str, ...]) -> JointSamples:
        """Return the samples of these joints alone."""
        columns = [self.joint_names.index(name) for name in names]
        rates = (array[:, columns] for array in (self.position, self.velocity, self.acceleration))
        return JointSamples(names, self.nanoseconds, *rates)


class GripperMotion(NamedTuple):
    """A motion of all grippers. It begins at a time in the motion [s], negative if before it."""

    time: float
    closed: bool


@dataclass(frozen=True, eq=False)
class MotionPart:
    """One motion for a robot to play: the carry, approach or release.

    Attributes
    ----------
    name : carry, approach or release
    joints : motion of all moving joints of the robot
    arms : joint names by arm, from the base to the tip
    gripped_from : time at which the grippers close [s]; infinite if they are open throughout
    released_by : time by which the grippers must be open [s]; infinite if they need not
    provenance : provenance of the motion
    """

    name: str
    joints: JointMotion
    arms: Mapping[str, tuple[str, ...]]
    gripped_from: float
    released_by: float
    provenance: MotionProvenance

    @property
    def grips(self) -> tuple[GripperMotion, ...]:
        """Return the motions of the grippers, in order: none in a carry, in which they hold."""
        if self.gripped_from <= 0.0:
            return ()
        opened = GripperMotion(0.0 if self.name == RELEASE else -1.0, closed=False)
        return (
            (opened,)
            if self.gripped_from == np.inf
            else (opened, GripperMotion(self.gripped_from, closed=True))
        )

    def samples(self, rate: float) -> JointSamples:
        """Sample the exact curve at `rate` [Hz] or slightly more. The rate is raised so that the end is a sample."""
        n_steps = max(2, int(np.ceil(self.joints.duration * rate - 1e-9)) + 1)
        nanoseconds = np.rint(np.linspace(0.0, self.joints.duration, n_steps) * NANO).astype(np.int64)
        position, velocity, acceleration = self.joints.at(nanoseconds / NANO)
        ends = [0, -1]
        position[ends], velocity[ends] = self.joints.position[ends], 0.0
        return JointSamples(self.joints.joint_names, nanoseconds, position, velocity, acceleration)

    def opening(self, time: Array) -> Array:
        """Return the gripper opening [per cent], 100 open and 0 closed. It is an array of shape (n_steps,)."""
        return np.where(time >= self.gripped_from - 0.5 / NANO, 0.0, 100.0)


def parts_of(motion: VerifiedJointMotion, transfers: Transfers | None = None) -> dict[str, MotionPart]:
    """Return the parts of a motion by name. They are the carry, and those of approach and release that exist.

    Raises
    ------
    ExportError
        If `motion` has not been verified, or `transfers` are those of another motion.
    """
    if not isinstance(motion, VerifiedJointMotion):
        raise ExportError(
            f"the motion is a {type(motion).__name__}, not a verified one of joints",
            key="motion",
            way_out="give the VerifiedJointMotion that comove.robots.verification.verify makes",
        )
    if transfers is not None and (not isinstance(transfers, Transfers) or transfers.carry is not motion):
        raise ExportError(
            "approach and release are not those of this motion",
            key="transfers",
            way_out="plan them for it: comove.robots.transfers.plan_transfers(motion)",
        )
    motions = {CARRY: (motion.joints, 0.0, np.inf)}
    if transfers is not None and (approach := transfers.approach) is not None:
        motions[APPROACH] = approach, approach.duration - transfers.grip_time, np.inf
    if transfers is not None and transfers.release is not None:
        motions[RELEASE] = transfers.release, np.inf, transfers.grip_time
    scene, robot = motion.scene, motion.robot
    arms = {arm.name: tuple(robot.joint_names[column] for column in arm.columns) for arm in robot.arms}
    provenance = MotionProvenance(
        comove=__version__,
        scene=scene.name,
        scene_sha256=scene.sha256,
        robot=robot.name,
        robot_sha256=robot.sha256,
        motion_sha256=checksum(motion_arrays(motion.motion.motion)),
        joints_sha256=checksum(joint_arrays(motion.joints)),
        part=CARRY,
        begin=IN_STEP if scene.moving.any() else "",
    )
    return {
        name: MotionPart(name, joints, arms, gripped_from, released_by, replace(provenance, part=name))
        for name, (joints, gripped_from, released_by) in motions.items()
    }


def require_rate(motion: VerifiedJointMotion, rate: float) -> None:
    """Refuse rates at which the played motion deviates too far.

    Raises
    ------
    ExportError
        If `rate` [Hz] is too low, too high or not a number; for a low one, the message states the error it causes.
    """
    if not isinstance(rate, Real) or not 0.0 < rate <= LARGEST_RATE:
        raise ExportError(
            f"the rate is {rate!r} Hz",
            key="rate",
            way_out=f"give one between {LEAST_RATE:g} and {LARGEST_RATE:g} Hz",
        )
    if rate < LEAST_RATE:
        cubic, linear = (1e3 * error for error in sampling_errors(motion, rate))
        raise ExportError(
            f"at {rate:g} Hz the hands would be up to {cubic:.3g} mm (cubic interpolation) or {linear:.3g} mm "
            "(linear) off their distance or path",
            key="rate",
            way_out=f"give {LEAST_RATE:g} Hz or more; {SAMPLE_RATE:g} Hz is usual",
        )


def sampling_errors(motion: VerifiedJointMotion, rate: float) -> tuple[float, float]:
    """Compute the interpolation errors of end effectors at `rate` [Hz]. The samples are joined by a cubic spline or
    by straight lines.

    Returns
    -------
    cubic, linear : largest error of the distance between two neighbouring end effectors, or of the position of a
        single one [m]
    """
    samples = parts_of(motion)[CARRY].samples(rate)
    time = np.linspace(0.0, motion.joints.duration, max(1001, 10 * len(samples.time)))
    cubic = JointMotion(samples.time, motion.joints.joint_names, samples.position).curve(time)
    linear = np.stack([np.interp(time, samples.time, q) for q in samples.position.T], axis=-1)
    exact = _spread(motion, motion.joints.curve(time))
    off_cubic, off_linear = (_spread(motion, q) - exact for q in (cubic, linear))
    return float(np.linalg.norm(off_cubic, axis=-1).max()), float(np.linalg.norm(off_linear, axis=-1).max())


def _spread(motion: VerifiedJointMotion, q: Array) -> Array:
    """Compute distances between neighbouring end effectors, shape (n_steps, n_pairs, 1). For a single end effector,
    compute its positions instead, shape (n_steps, 1, 3)."""
    robot = motion.robot
    hands = np.array([[robot.tool_pose(row, arm)[:3, 3] for arm in robot.arms] for row in q])
    if len(robot.arms) == 1:
        return hands
    return np.linalg.norm(np.diff(hands, axis=1), axis=-1)[..., None]
