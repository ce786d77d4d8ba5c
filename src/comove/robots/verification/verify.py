"""The verification of joint motions, the only maker of `VerifiedJointMotion`.

It shares no code with the search: models are Pinocchio's, shapes coal's, and kernels of its own compute the rest.

========================= ==============================================================================
property                  verification
========================= ==============================================================================
limits of joints          exact at every instant: extremes of the cubics between samples
torques                   sampled at 200 Hz, with a margin for between (see `effort`)
payloads                  balanced payload and end effector of each arm against its rated payload
end effectors on payload  bound at every instant (see `holding`)
clearance                 bound at every instant (see `certificate`)
payload in the scene      bound at every instant by `comove.verification`
========================= ==============================================================================
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import InitVar, dataclass, field, fields, replace
from functools import cache
from typing import Any

import numpy as np

from comove.brief import brief
from comove.errors import OptionError
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.robots.description import Uncertainty
from comove.robots.effort import carried_masses
from comove.robots.model import Robot
from comove.robots.motion import JointCommand, JointMotion, commands
from comove.robots.verification import checks as own
from comove.robots.verification.bodies import bodies_of
from comove.robots.verification.carried import Carried, holding_errors
from comove.robots.verification.certificate import CarryCourse
from comove.robots.verification.checks import without_gripper
from comove.robots.verification.kinematics import Bases
from comove.verification.verify import Check, Sealed, VerifiedMotion, verify

_SEAL = object()
DEVIATING = ("clearance_deviating", "load_uncertainty")
"""Measures of joints that deviate, where a description states deviations."""


@dataclass(frozen=True)
class JointReport:
    """Measures of a joint motion. Bounds hold at every instant, not only at samples.

    Attributes
    ----------
    joint_margin_min : least distance of a joint from its limits [rad, m for prismatic joints], exact
    velocity_ratio_max : largest share of a joint's velocity limit, or of the velocity with which it may approach its
        soft limits, exact
    acceleration_ratio_max, jerk_ratio_max : likewise of its other limits; of jerk only where some are stated
    torque_ratio_max : likewise of an effort limit; sampled, with a margin
    payload_ratio_max : largest used share of an arm's rated payload; only where one is stated
    hand_error_sampled, hand_turn_sampled : largest error of an end effector on the payload at samples [m, rad]
    hand_error_max, hand_turn_max : upper bounds of these at every instant
    distance_error_max : upper bound of the error of the end effectors' distances [m]
    clearance_scene : certified lower bound of the distance between links and obstacles [m]
    clearance_load : likewise between links and the payload
    clearance_self : likewise between links
    clearance_deviating : certified lower bound of all these distances while joints deviate [m]; only where their
        deviations are stated, as the next one
    load_uncertainty : largest displacement of a point of the payload due to the tolerances of bases and joints [m]
    hand_uncertainty : likewise of an end effector. The clearances are reduced by the effect of the bases' tolerance,
        `joint_margin_min` by the joints' deviations
    load_mass : mass with which torques were computed [kg]
    uncertainty : tolerances that were assumed of the bases' places and of the joints
    without_gripper : names of the arms whose description has no gripper, so that none was verified
    where : by measure, the name of the joint, end effector or pair that has it, and the time [s]

    A clearance is infinite where there is no pair of bodies. Measures that were not computed are NaN.
    """

    joint_margin_min: float = math.nan
    velocity_ratio_max: float = math.nan
    acceleration_ratio_max: float = math.nan
    jerk_ratio_max: float = math.nan
    torque_ratio_max: float = math.nan
    payload_ratio_max: float = math.nan
    hand_error_sampled: float = math.nan
    hand_turn_sampled: float = math.nan
    hand_error_max: float = math.nan
    hand_turn_max: float = math.nan
    distance_error_max: float = math.nan
    clearance_scene: float = math.nan
    clearance_load: float = math.nan
    clearance_self: float = math.nan
    clearance_deviating: float = math.nan
    load_uncertainty: float = math.nan
    hand_uncertainty: float = math.nan
    load_mass: float = math.nan
    uncertainty: Uncertainty = field(default_factory=Uncertainty)
    without_gripper: tuple[str, ...] = ()
    where: Mapping[str, tuple[str, float]] = field(default_factory=dict)

    def asdict(self) -> dict[str, float]:
        """Return the measures by name. Those of deviations need stated ones."""
        measures = {item.name: getattr(self, item.name) for item in fields(self) if item.type == "float"}
        return {name: x for name, x in measures.items() if name not in DEVIATING or not math.isnan(x)}


@dataclass(frozen=True, eq=False, repr=False)
class VerifiedJointMotion(Sealed):
    """A robot's motion that passed every check. Only `verify_joints` creates it.

    Attributes
    ----------
    robot : Robot that holds the payload
    motion : VerifiedMotion of end effectors and payload
    joints : JointMotion that passed the checks
    report : JointReport of the checks
    course : CarryCourse of all bodies, whose clearances were certified
    """

    __repr__ = brief

    __slots__ = ("course", "joints", "motion", "report", "robot")
    MAKER = "comove.robots.verify_joints"
    INSTEAD = "send its `joints` and verify them anew"

    robot: Robot
    motion: VerifiedMotion
    joints: JointMotion
    report: JointReport
    course: CarryCourse
    seal: InitVar[object] = field(default=None, kw_only=True)

    def __post_init__(self, seal: object) -> None:
        self._require(seal is _SEAL)

    @property
    def scene(self) -> Scene:
        """Return the scene for which the motion was verified."""
        return self.motion.motion.scene

    def stream(self, rate: float = 1000.0, arm: str | None = None) -> Iterator[JointCommand]:
        """Return an iterator over commands for a controller, one per cycle.

        It does not wait: the loop that sends the commands keeps the time, as drivers' callbacks do.

        Parameters
        ----------
        rate
            Cycles in a second [Hz].
        arm
            Name of the arm whose joints are commanded, from the base to the tip; all joints of the robot, in the
            order of `robot.joint_names`, unless given.

        Raises
        ------
        OptionError, RobotError
            If no robot is driven at that rate, or the robot has no such arm.
        """
        every = np.arange(len(self.robot.joint_names))
        return commands(self.joints, rate, every if arm is None else self.robot.arm(arm).columns)


@dataclass(frozen=True)
class JointVerdict:
    """The result of `verify_joints`: the verified motion or the reasons against it, and the measures.

    Attributes
    ----------
    verified : the verified motion, or None
    report : measures of the motion
    reasons : reasons for its rejection, in words
    """

    verified: VerifiedJointMotion | None
    report: JointReport
    reasons: tuple[str, ...]


def verify_joints(
    robot: Robot,
    motion: VerifiedMotion | CoordinatedMotion,
    joints: JointMotion,
    *,
    checks: Sequence[Check] = (),
    slack: float = 0.0,
) -> JointVerdict:
    """Verify a robot's motion: limits, torques, grasps and clearance.

    Parameters
    ----------
    motion
        Motion of end effectors and payload; a CoordinatedMotion is verified first.
    joints
        The robot's motion that executes `motion`.
    checks
        Further checks of a CoordinatedMotion.
    slack
        Share of the links' clearance beyond the required one that its bounds in the report may lose, for speed: the
        same motions are verified. Unless it is 0, the first check that fails is the last.
    """
    if isinstance(motion, CoordinatedMotion):
        verdict = verify(motion, checks)
        if verdict.verified is None:
            return _refused(
                f"the motion of the hands is not verified: {reason}" for reason in verdict.reasons
            )
        motion = verdict.verified
    if not isinstance(motion, VerifiedMotion):
        raise OptionError(
            f"the motion of the hands is a {type(motion).__name__}",
            way_out="give the VerifiedMotion of a solution, or a CoordinatedMotion",
        )
    scene = motion.motion.scene
    unfit = [*own.unfit_scene(robot, scene), *own.unfit_joints(robot, scene, joints)]
    if unfit:
        return _refused(unfit)
    joints = _own_copy(joints)
    arms = tuple(robot.arm(name) for name in scene.manipulators)
    bases = Bases(robot, robot.description.uncertainty)
    carried, curve = Carried(motion.motion), joints.curve
    errors = cache(lambda: holding_errors(robot, arms, carried, curve))
    course = cache(
        lambda: CarryCourse(
            bodies_of(bases, arms, carried, errors().hands, own.HAND_ERROR, curve=curve), carried, curve
        )
    )
    findings = list[own.JointFinding]()
    for check in (
        lambda: own.rest(robot, curve),
        lambda: own.limits(robot, curve),
        lambda: own.payload(scene, arms),
        lambda: own.torques(robot, curve, arms, carried_masses(scene)),
        lambda: own.hands(errors(), motion),
        lambda: own.displacements(bases, arms, errors(), motion, curve),
        lambda: own.clearances(course().bodies, carried, curve, slack),
        lambda: own.deviating(course().bodies, carried, curve, slack),
    ):
        findings.append(check())
        if slack > 0.0 and findings[-1].reasons:  # the next ones take longer, and one reason suffices
            break
    of_robot = JointReport(uncertainty=bases.uncertainty, without_gripper=without_gripper(robot))
    report = _with_findings(of_robot, findings)
    reasons = tuple(reason for finding in findings for reason in finding.reasons)
    verified = None if reasons else VerifiedJointMotion(robot, motion, joints, report, course(), seal=_SEAL)
    return JointVerdict(verified, report, reasons)


def tightened(known: VerifiedJointMotion) -> JointVerdict:
    """Verify the clearances of a verified motion with no slack.

    The result is that of `verify_joints` without slack: nothing else depends on it.
    """
    course = known.course
    findings = [check(course.bodies, course.load, course.curve) for check in (own.clearances, own.deviating)]
    report = _with_findings(known.report, findings)
    reasons = tuple(reason for finding in findings for reason in finding.reasons)
    made = known.robot, known.motion, known.joints, report, course
    return JointVerdict(None if reasons else VerifiedJointMotion(*made, seal=_SEAL), report, reasons)


def _with_findings(report: JointReport, findings: Sequence[own.JointFinding]) -> JointReport:
    """Return a report with the measures of checks."""
    measures: dict[str, Any] = {
        name: value for finding in findings for name, value in finding.measures.items()
    }
    kept = {name: place for name, place in report.where.items() if name not in measures}
    where = {name: place for finding in findings for name, place in finding.where.items()}
    return replace(report, **measures, where=kept | where)


def _refused(reasons: Iterable[str]) -> JointVerdict:
    return JointVerdict(None, JointReport(), tuple(reasons))


def _own_copy(joints: JointMotion) -> JointMotion:
    """Copy the motion into read-only arrays, to keep the verified values."""
    arrays = [np.array(x, dtype=float) for x in (joints.time, joints.position)]
    for array in arrays:
        array.setflags(write=False)
    return JointMotion(arrays[0], tuple(joints.joint_names), arrays[1])
