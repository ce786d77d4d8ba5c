"""Robots: descriptions and models, planning with arms, verification of joint motions, approach and release."""

from typing import TYPE_CHECKING

from comove._doors import lazily
from comove.errors import ExtraError

try:
    import pinocchio  # noqa: F401  before any module here needs it
except ImportError as error:  # the extra is not installed
    raise ExtraError("a robot", "robot") from error

if TYPE_CHECKING:
    from comove.robots.carrying import RobotCarrier as RobotCarrier
    from comove.robots.description import (
        bundled_robots as bundled_robots,
        find_description as find_description,
    )
    from comove.robots.files import (
        StoredJoints as StoredJoints,
        read_joints as read_joints,
        verify_stored as verify_stored,
        write_joints as write_joints,
    )
    from comove.robots.model import Arm as Arm, Robot as Robot
    from comove.robots.motion import JointCommand as JointCommand, JointMotion as JointMotion
    from comove.robots.recorded import end_effector_path as end_effector_path
    from comove.robots.solving import (
        JointSolution as JointSolution,
        carry as carry,
        robot_method as robot_method,
    )
    from comove.robots.transfers import Transfers as Transfers, plan_transfers as plan_transfers
    from comove.robots.verification.allowed import allowed_deviation as allowed_deviation
    from comove.robots.verification.verify import (
        JointReport as JointReport,
        JointVerdict as JointVerdict,
        VerifiedJointMotion as VerifiedJointMotion,
        verify_joints as verify_joints,
    )

__all__, __getattr__, __dir__ = lazily(
    __name__,
    {
        "robots.carrying": ["RobotCarrier"],
        "robots.description": ["bundled_robots", "find_description"],
        "robots.files": ["StoredJoints", "read_joints", "verify_stored", "write_joints"],
        "robots.model": ["Arm", "Robot"],
        "robots.motion": ["JointCommand", "JointMotion"],
        "robots.recorded": ["end_effector_path"],
        "robots.solving": ["JointSolution", "carry", "robot_method"],
        "robots.transfers": ["Transfers", "plan_transfers"],
        "robots.verification.allowed": ["allowed_deviation"],
        "robots.verification.verify": ["JointReport", "JointVerdict", "VerifiedJointMotion", "verify_joints"],
    },
)
