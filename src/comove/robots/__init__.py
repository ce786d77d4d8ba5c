"""Robots that carry loads: descriptions and models, planning with arms, verification of joint motions, transfers."""

from comove.errors import ExtraError

try:
    import pinocchio  # noqa: F401  before any module here needs it
except ImportError as error:  # the extra is not installed
    raise ExtraError("a robot", "robot") from error

from comove.robots.carry import RobotSolution, carry, robot_method
from comove.robots.carrying import RobotCarrier
from comove.robots.description import bundled_robots, find_description
from comove.robots.files import StoredJoints, read_joints, verified_motion, verify_stored, write_joints
from comove.robots.model import Arm, Robot
from comove.robots.motion import JointCommand, JointMotion
from comove.robots.recorded import end_effector_path
from comove.robots.transfers import Transfers, plan_transfers
from comove.robots.verification.verify import JointReport, JointVerdict, VerifiedJointMotion, verify_joints

__all__ = [
    "Arm",
    "JointCommand",
    "JointMotion",
    "JointReport",
    "JointVerdict",
    "Robot",
    "RobotCarrier",
    "RobotSolution",
    "StoredJoints",
    "Transfers",
    "VerifiedJointMotion",
    "bundled_robots",
    "carry",
    "end_effector_path",
    "find_description",
    "plan_transfers",
    "read_joints",
    "robot_method",
    "verified_motion",
    "verify_joints",
    "verify_stored",
    "write_joints",
]
