"""Robots: models, inverse kinematics of several arms, limits, timing and checks of joint motions."""

from comove.robots.files import StoredJoints, read_joints, verify_stored, write_joints
from comove.robots.model import Arm, Robot
from comove.robots.motion import JointMotion
from comove.robots.timing import Timing, fastest_timing, shortest_duration
from comove.robots.verify import JointReport, JointVerdict, VerifiedJointMotion, verify_joints

__all__ = [
    "Arm",
    "JointMotion",
    "JointReport",
    "JointVerdict",
    "Robot",
    "StoredJoints",
    "Timing",
    "VerifiedJointMotion",
    "fastest_timing",
    "read_joints",
    "shortest_duration",
    "verify_joints",
    "verify_stored",
    "write_joints",
]
