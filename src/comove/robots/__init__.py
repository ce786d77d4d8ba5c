"""Models, inverse kinematics of several arms, limits, timing and checks of joint motions of robots."""

from comove.errors import ExtraError

try:
    import pinocchio  # noqa: F401  before any module here needs it
except ImportError as error:  # the extra is not installed
    raise ExtraError("a robot", "robot") from error

from comove.robots.carry import RobotSolution, carry
from comove.robots.check import RobotCheck, RobotMotion
from comove.robots.description import bundled_robots, find_description
from comove.robots.effort import DEFAULT_MASS
from comove.robots.files import StoredJoints, read_joints, verified_motion, verify_stored, write_joints
from comove.robots.model import Arm, Robot
from comove.robots.motion import JointMotion
from comove.robots.search.carrying import Carrying, robot_method
from comove.robots.search.tracking import track
from comove.robots.timing import Timing, fastest_timing, shortest_duration
from comove.robots.transfers import Transfers, plan_transfers
from comove.robots.verification.verify import JointReport, JointVerdict, VerifiedJointMotion, verify_joints

__all__ = [
    "DEFAULT_MASS",
    "Arm",
    "Carrying",
    "JointMotion",
    "JointReport",
    "JointVerdict",
    "Robot",
    "RobotCheck",
    "RobotMotion",
    "RobotSolution",
    "StoredJoints",
    "Timing",
    "Transfers",
    "VerifiedJointMotion",
    "bundled_robots",
    "carry",
    "fastest_timing",
    "find_description",
    "plan_transfers",
    "read_joints",
    "robot_method",
    "shortest_duration",
    "track",
    "verified_motion",
    "verify_joints",
    "verify_stored",
    "write_joints",
]
