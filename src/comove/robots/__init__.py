"""Robots: models, inverse kinematics of several arms, limits, timing and checks of joint motions."""

from comove.robots.model import Arm, Robot
from comove.robots.motion import JointMotion
from comove.robots.verify import JointReport, JointVerdict, VerifiedJointMotion, verify_joints

__all__ = [
    "Arm",
    "JointMotion",
    "JointReport",
    "JointVerdict",
    "Robot",
    "VerifiedJointMotion",
    "verify_joints",
]
