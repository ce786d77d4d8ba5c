"""The largest deviation of all joints that a motion allows.

All that deviations take is proportional to them (`comove.robots.verification.deviations`): of a pair, e times the sum
l of its lever arms. Where the certificate finds it d apart and d - e l < 0, at most d / l is allowed. So e is lowered
from one violation to the next (Dinkelbach, 1967) until there is none.
"""

from __future__ import annotations

from dataclasses import replace
from math import floor, inf, log10

from comove.model.resting import TOLERANCE
from comove.robots.description import Uncertainty
from comove.robots.model import Robot
from comove.robots.motion import JointMotion, least_margin
from comove.robots.verification.bodies import bodies_of
from comove.robots.verification.carried import Carried
from comove.robots.verification.certificate import certify
from comove.robots.verification.checks import HAND_ERROR, Displacement
from comove.robots.verification.kinematics import Bases
from comove.verification.verify import VerifiedMotion

SHARE = 0.99  # of the largest deviation that no violation excludes, which is certified
LESS = 0.9  # by which it is lowered where a bound is too low, but no distance
LEAST = 1e-6  # rad, m; what allows less allows none
DIGITS = 2  # of the result, which is rounded down


def allowed_deviation(robot: Robot, motion: VerifiedMotion, joints: JointMotion) -> float:
    """Return the largest deviation of all joints that a motion allows.

    With it [rad, m for prismatic joints] the motion is verified, and hardly with any larger one; 0 where the motion
    leaves none. Tolerances of the bases count as the robot's description states them.

    Parameters
    ----------
    joints : the robot's motion, which is verified without deviations
    """
    scene, report, carried, curve = motion.motion.scene, motion.report, Carried(motion.motion), joints.curve
    arms = tuple(robot.arm(name) for name in scene.manipulators)
    stated = robot.description.uncertainty
    hands = carried.hands(carried.time).positions
    by_bases, by_joints = (
        Displacement.of(Bases(robot, uncertainty), arms, hands, carried, curve).load
        for uncertainty in (stated.model_copy(update={"joints": None}), Uncertainty(joints=1.0))
    )
    near = inf if report.support_distance_min is None else report.support_distance_min + 2 * TOLERANCE
    spare = min(report.clearance_min, near) - by_bases
    most = min(least_margin(curve, robot.lower, robot.upper).value, spare / by_joints)
    bases = Bases(robot, stated.model_copy(update={"joints": 1.0}))
    bodies = bodies_of(bases, arms, carried, hands, HAND_ERROR, curve=curve)
    while most > LEAST:
        e = SHARE * most
        tried = replace(bodies, strayed=e * bodies.strayed).deviating
        found = certify(tried, carried, curve, slack=1.0)
        if all(one.lower >= 0.0 for one in found):
            return _rounded_down(e)
        met = [(bodies.strayed[one.pair], one.upper) for one in found if one.upper < 0.0]
        most = min((e + less / levers if levers > 0.0 else 0.0 for levers, less in met), default=LESS * most)
    return 0.0


def _rounded_down(value: float) -> float:
    """Return a positive number to `DIGITS` digits, and no larger."""
    unit = 10.0 ** (floor(log10(value)) + 1 - DIGITS)
    return float(f"{floor(value / unit) * unit:.{DIGITS}g}")
