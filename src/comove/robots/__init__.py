"""Robots: models, inverse kinematics of several arms, limits, timing and checks of joint motions."""

from comove.robots.model import Arm, Robot
from comove.robots.motion import JointMotion

__all__ = ["Arm", "JointMotion", "Robot"]
