"""The checks of a joint motion, one function each, and their messages."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from comove.arrays import Array, first_largest
from comove.errors import RobotError
from comove.model.resting import TOLERANCE
from comove.model.scene import Scene
from comove.robots.effort import largest_torque, overburdened, payloads, still_torque
from comove.robots.model import Arm, Robot
from comove.robots.motion import (
    Extreme,
    JointCurve,
    JointMotion,
    largest_acceleration,
    largest_approach,
    largest_jerk,
    largest_velocity,
    least_margin,
)
from comove.robots.verification.bodies import LOAD, SCENE, SELF, Bodies, bodies_of, distance_of, links_inside
from comove.robots.verification.carried import Carried, Errors, LoadMotion, payload_shift
from comove.robots.verification.certificate import LinkClearance, certify, overlap
from comove.robots.verification.deviations import shifts_of_hands
from comove.robots.verification.kinematics import Bases, moved_by, reaches_of
from comove.verification.verify import VerifiedMotion

SAMPLE_ERROR = 1e-6  # m and rad, of a hand at samples
HAND_ERROR = 1e-5  # m and rad, of a hand at every instant
ROUNDING = 1e-9  # s, rad/s, and share of a limit, as a motion may be as fast as its limits
LARGEST = 1e6  # s, rad, m
GRIPPER_NEAR = 0.05  # m, from the grasp frame, within which a gripper has a body
GRIPPER_BEYOND = 0.01  # m, along the approach, by which a hand in one piece reaches beyond the grasp frame
FLANGE = 0.02  # m, from the grasp frame, within which an arm's own last link holds the payload
POINT = 1e-6  # m, radius of a ball that stands for a point


class JointFinding(NamedTuple):
    """The result of one check: measures, their places, and reasons against the motion."""

    measures: dict[str, float]
    where: dict[str, tuple[str, float]]
    reasons: list[str]


def unfit_scene(robot: Robot, scene: Scene) -> list[str]:
    """Return the reasons why this robot cannot execute any motion."""
    if scene.n_dims != 3:
        return ["the scene is planar, and a robot moves in space; give the scene three coordinates"]
    reasons = []
    for name in scene.manipulators:
        try:
            robot.arm(name)
        except RobotError as error:
            reasons.append(str(error))
    if scene.grasp is None and scene.file.load is not None:
        reasons.append("the scene does not say how hands hold the load; add `grasp: {orientation: down}`")
    return reasons


def struck_at_rest(robot: Robot, scene: Scene) -> tuple[str, float, float] | None:
    """Return a link at rest and the moving obstacle it meets. Their distance [m] and the time [s] follow.

    Links at rest are those that no arm of the scene's manipulators moves; None where all keep clear.
    """
    arms = tuple(robot.arm(name) for name in scene.manipulators)
    carried, bases = Carried.straight(scene), Bases(robot, robot.description.uncertainty)
    ends = np.array([0.0, scene.duration])
    home = JointMotion(ends, robot.joint_names, np.stack([robot.home] * 2))
    bodies = bodies_of(bases, arms, carried, scene.nodes_at("start")[None, : len(arms)], 0.0)
    columns = np.concatenate([arm.columns for arm in arms])
    moved = moved_by(robot)[bodies.joint[bodies.ends]][..., columns].any(axis=(1, 2))
    bodies = bodies.some((bodies.kind == SCENE) & ~moved & bodies.reach[:, robot.model.nv :].any(axis=1))
    required = float(bodies.required[SCENE])
    if certify(bodies, carried, home.curve, slack=1.0)[SCENE].upper >= required:
        return None
    found = certify(bodies, carried, home.curve)[SCENE]
    return bodies.name(found.pair), found.upper, found.time


def unfit_joints(robot: Robot, scene: Scene, joints: JointMotion) -> list[str]:
    """Return the reasons why samples are no motion of this robot. The duration is the scene's."""
    if tuple(joints.joint_names) != robot.joint_names:
        return [
            f"the motion moves {', '.join(map(str, joints.joint_names))}, the robot '{robot.name}' has "
            f"{', '.join(robot.joint_names)}; give these, in this order"
        ]
    try:
        time, position = (np.asarray(x, dtype=float) for x in (joints.time, joints.position))
    except (TypeError, ValueError):
        return ["times or positions are no numbers; give arrays of floats"]
    if time.ndim != 1 or len(time) < 2 or position.shape != (len(time), len(robot.joint_names)):
        return [
            f"time has the shape {time.shape} and position {position.shape}; give two samples or more, and for each "
            f"a position of {len(robot.joint_names)} joints"
        ]
    for name, values in (("time", time), ("position", position)):
        if not (np.abs(values) < LARGEST).all():
            at = tuple(np.argwhere(~(np.abs(values) < LARGEST))[0].tolist())
            place = ", ".join(map(str, at))
            return [f"{name}[{place}] is {values[at]:g}; give finite seconds and radians"]
    if not (np.diff(time) > 0).all():
        k = int(np.argmin(np.diff(time) > 0)) + 1
        return [
            f"time[{k}] = {time[k]:g} s does not come after time[{k - 1}] = {time[k - 1]:g} s; sort the samples"
        ]
    if abs(time[0]) > ROUNDING or abs(time[-1] - scene.duration) > ROUNDING:
        return [
            f"the motion lasts from {time[0]:.9g} s to {time[-1]:.9g} s, the scene's from 0 to "
            f"{scene.duration:.9g} s; stretch it to that duration"
        ]
    return []


def rest(robot: Robot, curve: JointCurve) -> JointFinding:
    """Check that the robot begins and ends at rest."""
    speed = np.abs(curve(curve.x[[0, -1]], 1)).max(axis=0)
    name = robot.joint_names[first_largest(speed)]
    moving = f"{name} moves at {speed.max():.3g} rad/s at an end; begin and end at rest"
    return JointFinding({}, {}, [] if speed.max() <= ROUNDING else [moving])


def limits(robot: Robot, curve: JointCurve) -> JointFinding:
    """Check the limits of position, velocity, acceleration and jerk, soft ones included.

    Positions keep theirs wherever joints deviate.
    """
    e = robot.description.uncertainty.deviations(robot.joint_names)
    margin = least_margin(curve, robot.lower + e, robot.upper - e)
    units, reasons = _units(robot), []
    if not margin.value >= 0:
        j = margin.joint
        strays = f", as it may deviate by {e[j]:g} {units[j]}" if e[j] > 0 else ""
        reasons.append(
            f"{robot.joint_names[j]} {'may be' if strays else 'is'} {-margin.value:.3g} {units[j]} beyond its limits "
            f"of {robot.lower[j]:g} to {robot.upper[j]:g} {units[j]} at {margin.time:.2f} s{strays}"
        )
    speed = largest_velocity(curve, robot.velocity)
    acceleration, jerk = largest_acceleration(curve, robot.acceleration), largest_jerk(curve, robot.jerk)
    for worst, limit, verb, order in (
        (speed, robot.velocity, "moves at", 1),
        (acceleration, robot.acceleration, "accelerates by", 2),
        (jerk, robot.jerk, "jerks by", 3),
    ):
        if not worst.value <= 1 + ROUNDING:
            j = worst.joint
            unit = f"{units[j]}/s{f'^{order}' if order > 1 else ''}"
            reasons.append(
                f"{robot.joint_names[j]} {verb} up to {worst.value * limit[j]:.4g} {unit} at {worst.time:.2f} s "
                f"(limit {limit[j]:g}); take {worst.value ** (1.0 / order):.3g} times as long"
            )
    approach = largest_approach(curve, robot.approach, robot.lower, robot.upper)
    if margin.value >= 0 and not approach.value <= 1 + ROUNDING:
        reasons.append(_too_fast_for_soft_limits(robot, curve, approach, units[approach.joint]))
    measured = {
        "joint_margin_min": margin,
        "velocity_ratio_max": max(speed, approach, key=lambda extreme: extreme.value),
        "acceleration_ratio_max": acceleration,
    }
    if np.isfinite(robot.jerk).any():
        measured["jerk_ratio_max"] = jerk
    return _found(robot, measured, reasons)


def _too_fast_for_soft_limits(robot: Robot, curve: JointCurve, worst: Extreme, unit: str) -> str:
    j = worst.joint
    position, velocity = (float(curve(worst.time, order)[j]) for order in (0, 1))
    limit = robot.upper[j] if velocity > 0 else robot.lower[j]
    told = (
        f"{robot.joint_names[j]} moves at {abs(velocity):.4g} {unit}/s at {worst.time:.2f} s, "
        f"{abs(limit - position):.3g} {unit} before its limit {limit:g}, where k_position "
        f"{1.0 / robot.approach[j]:g} allows {abs(limit - position) / robot.approach[j]:.4g}"
    )
    if not np.isfinite(worst.value):
        return f"{told}; keep it away from that limit"
    return f"{told}; take {worst.value:.3g} times as long, or keep it away from that limit"


def torques(robot: Robot, curve: JointCurve, arms: tuple[Arm, ...], masses: Array) -> JointFinding:
    """Check that the motors are strong enough."""
    worst = largest_torque(robot, arms, masses, curve)
    reasons, j = [], worst.joint
    if not worst.value <= 1 + ROUNDING:
        unit = "N" if _units(robot)[j] == "m" else "N m"
        told = (
            f"{robot.joint_names[j]} needs up to {worst.value * robot.effort[j]:.4g} {unit} at {worst.time:.2f} s "
            f"(limit {robot.effort[j]:g} {unit})"
        )
        still = still_torque(robot, arms, masses, curve)
        if still.value < 1:
            reasons.append(f"{told}; move slower, nearer to the base, or less mass than {masses.sum():g} kg")
        elif still_torque(robot, arms, 0.0 * masses, curve).value < 1:
            reasons.append(
                f"{told}, and at rest {robot.joint_names[still.joint]} up to {still.value:.3g} times its limit, "
                f"which no pace changes; move nearer to the base, or less mass than {masses.sum():g} kg"
            )
        else:
            reasons.append(
                f"{told}, and {robot.joint_names[still.joint]} up to {still.value:.3g} times its limit at rest, too "
                f"much without the load of {masses.sum():g} kg as well; move with the arms nearer to the base, or "
                "correct the model's masses and efforts, or `springs`"
            )
    finding = _found(robot, {"torque_ratio_max": worst}, reasons)
    return finding._replace(measures=finding.measures | {"load_mass": float(masses.sum())})


def payload(scene: Scene, arms: tuple[Arm, ...]) -> JointFinding:
    """Check that arms are rated for their payloads."""
    if scene.file.load is None or np.isinf([arm.payload for arm in arms]).all():
        return JointFinding({}, {}, [])
    ratios = payloads(scene, arms)
    most = first_largest(ratios)
    measure = "payload_ratio_max"
    return JointFinding(
        {measure: float(ratios[most])}, {measure: (arms[most].name, 0.0)}, [*overburdened(scene, arms)]
    )


def _found(robot: Robot, extremes: dict[str, Extreme], reasons: list[str]) -> JointFinding:
    measures = {name: worst.value for name, worst in extremes.items()}
    where = {name: (robot.joint_names[worst.joint], worst.time) for name, worst in extremes.items()}
    return JointFinding(measures, where, reasons)


def _units(robot: Robot) -> list[str]:
    return ["m" if slide else "rad" for slide in reaches_of(robot).slides]


def hands(errors: Errors, motion: VerifiedMotion) -> JointFinding:
    """Check that the end effectors are at their places on the payload."""
    names, finding = motion.motion.scene.manipulators, JointFinding({}, {}, [])
    for name, how, grid, bound in (
        ("hand_error", "off the load by {:.3g} m", errors.position, errors.position_bound),
        ("hand_turn", "turned by {:.3g} rad", errors.turn, errors.turn_bound),
    ):
        sampled = Extreme.largest(grid[errors.is_sample], errors.time[errors.is_sample])
        between = Extreme.largest(bound, errors.time)
        for kind, worst in (("sampled", sampled), ("max", between)):
            finding.measures[f"{name}_{kind}"] = worst.value
            finding.where[f"{name}_{kind}"] = names[worst.joint], worst.time
        if not sampled.value <= SAMPLE_ERROR:
            finding.reasons.append(
                f"the hand '{names[sampled.joint]}' is {how.format(sampled.value)} at {sampled.time:.2f} s (at most "
                f"{SAMPLE_ERROR:g} at samples); solve its joints more exactly"
            )
        elif not between.value <= HAND_ERROR:
            finding.reasons.append(
                f"between two samples the hand '{names[between.joint]}' may be {how.format(between.value)} about "
                f"{between.time:.2f} s (at most {HAND_ERROR:g}); sample the joints more finely"
            )
    finding.measures["distance_error_max"] = motion.report.distance_error_max + errors.apart_bound
    return finding


class Displacement(NamedTuple):
    """Largest displacement of end effectors, and of payload and end effectors [m]."""

    hand: float
    load: float

    @classmethod
    def of(
        cls, bases: Bases, arms: tuple[Arm, ...], hands: Array, carried: Carried, curve: JointCurve
    ) -> Displacement:
        """Bound the displacements by bases and joints.

        Parameters
        ----------
        hands : array, shape (n_steps, n_hands, 3), positions of the end effectors [m]
        curve : joint positions by time [s]
        """
        off = np.array([bases.of_hand(arm, hands[:, i])[1] for i, arm in enumerate(arms)])
        turn, held = np.full(len(arms), bases.turn), list(carried.motion.scene.file.holder_numbers)
        if (e := bases.deviations) is not None:
            shift = shifts_of_hands(bases.robot, arms, e, curve)
            off, turn = off + shift.off, turn + shift.turn
        load = payload_shift(carried, off[held].max(initial=0.0), turn[held].max(initial=0.0))
        return cls(float(off.max()), max(load, float(off.max())))


def displacements(
    bases: Bases, arms: tuple[Arm, ...], errors: Errors, motion: VerifiedMotion, curve: JointCurve
) -> JointFinding:
    """Check that the payload keeps clear wherever bases and joints may be."""
    off, load = Displacement.of(bases, arms, errors.hands, Carried(motion.motion), curve)
    clearance, near, reasons = motion.report.clearance_min, motion.report.support_distance_min, []
    why, way_out = list[str](), list[str]()
    if bases.turn > 0.0 or bases.uncertainty.position > 0.0:
        why, way_out = ["where the bases stand"], ["measure the bases more exactly"]
    if bases.deviations is not None:
        why.append("how far joints may deviate")
        way_out.append("state smaller deviations (uncertainty: joints)")
    told = f"the payload may be off by {load:.3g} m because of {' and '.join(why)}"
    if load > 0 and near is not None and not near - load >= -2 * TOLERANCE:
        reasons.append(
            f"the payload comes within {max(near, 0.0):.3g} m of its support, and {told}; raise start and goal by "
            f"that, or {', or '.join(way_out)}"
        )
    if load > 0 and not clearance - load >= 0:
        reasons.append(
            f"the load comes within {clearance:.3g} m of something, and {told}; ask for more clearance, or "
            f"{', or '.join(way_out)}"
        )
    measures = {"hand_uncertainty": off}
    return JointFinding(
        measures if bases.deviations is None else measures | {"load_uncertainty": load}, {}, reasons
    )


def clearances(bodies: Bodies, carried: LoadMotion, curve: JointCurve, slack: float = 0.0) -> JointFinding:
    """Check that links, payload and obstacles keep clear of each other; `slack` as in `certify`."""
    finding = JointFinding({}, {}, [])
    finding.reasons.extend(links_inside(bodies, curve(curve.x[0])))
    names = {SCENE: "clearance_scene", LOAD: "clearance_load", SELF: "clearance_self"}
    bounds = certify(bodies, carried, curve, slack)
    touching = any(found.upper < required for found, required in zip(bounds, bodies.required, strict=True))
    unsought = touching and slack > 0.0  # then others were not looked into
    for kind, found in enumerate(bounds):
        name = names[kind]
        finding.measures[name] = found.lower
        if found.pair >= 0:
            finding.where[name] = bodies.name(found.pair), found.time
        required = float(bodies.required[kind])
        if not found.upper >= required:
            how = _how_near(bodies, carried, curve, found)
            finding.reasons.append(_contact(bodies.name(found.pair), how, required, found.time, kind))
        elif not found.lower >= required and not unsought:
            of = {SCENE: "links and obstacles", LOAD: "the load and all else", SELF: "links"}[kind]
            finding.reasons.append(
                f"it could not be certified that {of} always keep {required:g} m: the bound of "
                f"{bodies.name(found.weakest)} at about {found.around:.2f} s is {found.lower:.3g} m; "
                "keep them further apart"
            )
    return finding


def deviating(bodies: Bodies, carried: LoadMotion, curve: JointCurve, slack: float = 0.0) -> JointFinding:
    """Check that nothing touches while joints deviate; `slack` as in `certify`."""
    finding = JointFinding({}, {}, [])
    if not bodies.strayed.any():
        return finding
    strayed = bodies.deviating
    bounds = certify(strayed, carried, curve, slack)
    worst = min(bounds, key=lambda found: found.lower)
    finding.measures["clearance_deviating"] = worst.lower
    if worst.pair >= 0:
        finding.where["clearance_deviating"] = strayed.name(worst.pair), worst.time
    for found in bounds:
        if found.lower >= 0.0:
            continue
        met = found.upper < 0.0
        pair, time = (found.pair, found.time) if met else (found.weakest, found.around)
        if pair >= 0:
            finding.reasons.append(
                f"{strayed.name(pair)} may meet at {time:.2f} s: joints that deviate may bring them "
                f"{strayed.strayed[pair]:.3g} m nearer than they are commanded; ask for more clearance "
                "(limits: {clearance: ..}), or state smaller deviations (uncertainty: joints)"
            )
    return finding


def _how_near(bodies: Bodies, carried: LoadMotion, curve: JointCurve, found: LinkClearance) -> str:
    """Return the distance or contact of two bodies, in words. For meshes, coal computes no depth."""
    distance = found.upper + float(bodies.taken[found.pair])
    if found.upper > 0.0:
        return f"come within {found.upper:.3g} m of each other"
    if distance > 0.0:
        return f"may meet: they come within {distance:.3g} m of each other, and places are known to that"
    depth, is_bound = overlap(bodies, carried, curve, found)
    return f"meet, {'at most ' if is_bound else ''}{depth:.3g} m deep" if depth > 0.0 else "meet"


def _contact(pair: str, how: str, required: float, time: float, kind: int) -> str:
    way_out = {
        SCENE: "find another motion, or ask for less by limits: {clearance: ..}",
        LOAD: "find another motion, or another grasp",
        SELF: "find another motion, or, where they cannot touch, leave the pair out in the robot's SRDF",
    }
    return f"{pair} {how} at {time:.2f} s ({required:g} m is to be kept); {way_out[kind]}"


@lru_cache(maxsize=8)
def without_gripper(robot: Robot) -> tuple[str, ...]:
    """Return the names of the arms whose models have no gripper.

    An arm has one if a body that moves with its end effector is within `GRIPPER_NEAR` of its grasp frame, and belongs
    to a finger or to the gripper of the description, reaches beyond the grasp frame along the approach, or is not
    that of the arm's last link, which ends before. So a bare flange is none, nor is a grasp frame in the air.
    """
    return tuple(arm.name for arm in robot.arms if not _has_gripper(robot, arm))


def _has_gripper(robot: Robot, arm: Arm) -> bool:
    joint, grasp = robot.grasp_frame(arm)
    names = {name: link for link, (name, *_) in robot.joints_above.items()}
    last = names[robot.model.names[joint]]
    given, ends_at, rigid, here = robot.gripper_links(arm), np.inf, False, pin.SE3.Identity()
    for item in robot.collision.geometryObjects:
        if item.parentJoint != joint:
            continue
        link, place = robot.model.frames[item.parentFrame].name, grasp.actInv(item.placement)
        away = distance_of((item.geometry, coal.Sphere(POINT)), (place, here))
        if link == last:
            ends_at = min(ends_at, away)
        if away > GRIPPER_NEAR:
            continue
        if link in given or _is_finger(robot, link, last):
            return True
        beyond = coal.Halfspace(np.array([0.0, 0.0, -1.0]), -GRIPPER_BEYOND)
        if distance_of((item.geometry, beyond), (place, here)) < 0.0:
            return True
        rigid = rigid or link != last
    return rigid and ends_at > FLANGE


def _is_finger(robot: Robot, link: str, last: str) -> bool:
    """Return whether a movable joint separates a link from its arm's last."""
    while link != last:
        _, link, moves = robot.joints_above[link]
        if moves:
            return True
    return False
