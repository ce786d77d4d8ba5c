"""Joints that deviate from their commands: nothing that is certified comes nearer, and what that takes is told."""

import warnings

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from comove.errors import ComoveWarning
from comove.model import Scene
from comove.robots import JointMotion, verify_joints
from comove.robots.description import Uncertainty
from comove.robots.verification.allowed import allowed_deviation
from comove.robots.verification.bodies import LOAD, SCENE, SELF, bodies_of, links_of
from comove.robots.verification.carried import Carried, payload_shift
from comove.robots.verification.deviations import Balls, lever_arms, shifts_of_hands
from comove.robots.verification.kinematics import Bases, reaches_of
from comove.robots.verification.verify import tightened
from comove.verification.verify import verify
from tests.robots.known_carry import baxter, known_carry, on_scene, scene_data, uncertain_baxter
from tests.robots.small_robots import RANDOM, gantry_scene, lifts_scene, robot

DURATION = 2.0  # s


def balls_of(machine):
    """The balls about a robot's links that move."""
    links = links_of(machine)
    moved = np.flatnonzero(links.joint > 0)
    parts = links.joint, links.solids.center, links.solids.radius, links.reach
    return Balls(*(part[moved] for part in parts))


def wandering(machine, rng, n_knots=6):
    """A fast motion anywhere within the limits."""
    q = rng.uniform(machine.lower, machine.upper, (n_knots, len(machine.lower)))
    return JointMotion(np.linspace(0.0, DURATION, n_knots), machine.joint_names, q).curve


def at_rest(machine, q):
    """A motion that stays at joints."""
    return JointMotion(np.array([0.0, DURATION]), machine.joint_names, np.stack([q, q])).curve


def placements(machine, q):
    """The poses of all joints by Pinocchio."""
    data = machine.model.createData()
    pin.forwardKinematics(machine.model, data, q)
    return [data.oMi[joint].copy() for joint in range(machine.model.njoints)]


@pytest.mark.parametrize("name", [*RANDOM, "gantry", "two_ur10"])
def test_lever_arms_are_distances_from_axes_at_all_instants(name):
    """Between the instants that are looked at, too, and hardly longer than they must be."""
    machine, rng = robot(name), np.random.default_rng(1)
    balls, curve = balls_of(machine), wandering(machine, rng)
    levers = lever_arms(machine, balls, curve)
    found, axes = np.zeros(levers.shape), reaches_of(machine).axes
    for q in curve(np.linspace(0.0, DURATION, 1701)):
        poses = placements(machine, q)
        centers = np.array([poses[j].act(c) for j, c in zip(balls.joint, balls.center, strict=True)])
        for joint in range(1, machine.model.njoints):
            column = machine.model.idx_vs[joint]
            axis = poses[joint].rotation @ axes[column]
            away = np.linalg.norm(np.cross(centers - poses[joint].translation, axis), axis=1) + balls.radius
            found[:, column] = np.maximum(found[:, column], away)
    moves = (balls.reach > 0.0) & ~reaches_of(machine).slides
    assert (levers[balls.reach == 0.0] == 0.0).all()
    assert (levers[:, reaches_of(machine).slides] == (balls.reach > 0.0)[:, reaches_of(machine).slides]).all()
    assert (levers[moves] >= found[moves] - 1e-12).all()
    assert (levers <= balls.reach + 1e-12).all()
    assert np.median((levers - found)[moves]) < 0.05  # m, at joints that turn by some rad/s


@pytest.mark.parametrize("name", [*RANDOM, "gantry"])
@pytest.mark.parametrize("size", [0.01, 0.7])
def test_no_point_moves_further_than_its_lever_arms_allow(name, size):
    """Also where all joints deviate by half a radian and more: nothing of higher order is missing."""
    machine, rng = robot(name), np.random.default_rng(2)
    balls, n = balls_of(machine), len(machine.lower)
    for _ in range(10):
        q = rng.uniform(machine.lower, machine.upper)
        deviations = size * rng.uniform(0.1, 1.0, n)
        bound, hands = (
            lever_arms(machine, balls, at_rest(machine, q)) @ deviations,
            shifts_of_hands(machine, machine.arms, deviations, at_rest(machine, q)),
        )
        before = placements(machine, q)
        points = balls.center + balls.radius[:, None] * Rotation.random(len(bound), random_state=rng).apply(
            [0, 0, 1]
        )
        for _ in range(20):
            off = deviations * rng.choice([-1.0, 1.0, rng.uniform(-1.0, 1.0)], n)
            after = placements(machine, q + off)
            for joint, point, most in zip(balls.joint, points, bound, strict=True):
                assert np.linalg.norm(after[joint].act(point) - before[joint].act(point)) <= most + 1e-12
            for k, arm in enumerate(machine.arms):
                joint, grasp = machine.grasp_frame(arm)
                apart = (before[joint] * grasp).inverse() * (after[joint] * grasp)
                assert np.linalg.norm(apart.translation) <= hands.off[k] + 1e-12
                assert np.linalg.norm(pin.log3(apart.rotation)) <= hands.turn[k] + 1e-9


def test_a_stretched_arm_moves_as_far_as_its_lever_arms_allow():
    """Its shoulder, elbow and wrist turn about parallel axes: no part of the bound can be left out."""
    machine, e = robot("lifts"), 1e-3
    q = np.where(machine.lower < -1.0, 0.0, 0.5)  # the lifts in the middle, all else straight
    arm = machine.arms[0]
    hands = shifts_of_hands(machine, machine.arms, np.full(len(q), e), at_rest(machine, q))
    turned = np.where(np.isin(np.arange(len(q)), arm.columns[1:]), e, 0.0)
    moved = np.linalg.norm((machine.tool_pose(q + turned, arm) - machine.tool_pose(q, arm))[:3, 3])
    assert hands.off[0] == pytest.approx(moved + e, rel=1e-5)  # and the lift
    assert hands.turn[0] == pytest.approx(3 * e)


def everything(machine, scene, uncertainty, q):
    """All bodies about joints at rest, the payload at its start."""
    carried, hands = Carried.straight(scene), scene.nodes_at("start")[None, : len(machine.arms)]
    bases, still = Bases(machine, uncertainty), at_rest(machine, q)
    return bodies_of(bases, machine.arms, carried, hands, 0.0, curve=still).placed_at(scene.nodes_at("start"))


def apart(bodies, q):
    """The distances of all pairs by coal, computed by Pinocchio; array, shape (n_pairs,) [m]."""
    data, placed = bodies.robot.model.createData(), bodies.geometry.createData()
    pin.computeDistances(bodies.robot.model, data, bodies.geometry, placed, q)
    return np.array([result.min_distance for result in placed.distanceResults])


@pytest.mark.parametrize(("name", "scene"), [("lifts", lifts_scene), ("gantry", gantry_scene)])
def test_no_pair_comes_nearer_than_is_taken_by_any_joint(name, scene):
    """Every joint by itself, and corners of the box of all: links, obstacles and the payload where it lies."""
    box = {"shape": "box", "center": [0.5, 0.1, 0.9], "size": [0.1, 0.1, 0.1]}
    machine, place, rng = robot(name), scene(obstacles=(box,)), np.random.default_rng(3)
    n, e, felt = len(machine.lower), 0.05, set()
    alone = [
        dict(zip(machine.joint_names, np.where(np.arange(n) == j, e, 1e-9), strict=True)) for j in range(n)
    ]
    for q in rng.uniform(machine.lower, machine.upper, (12, n)):
        for stated in (*alone, e):
            uncertainty = Uncertainty(joints=stated)
            bodies = everything(machine, place, uncertainty, q)
            deviations, before = uncertainty.deviations(machine.joint_names), apart(bodies, q)
            for _ in range(4):
                nearer = before - apart(bodies, q + deviations * rng.choice([-1.0, 1.0], n))
                counts = before > 0.0
                assert (nearer <= bodies.strayed + 1e-5)[counts].all()
                felt |= {
                    (kind, str(stated)) for kind in bodies.kind[counts & (nearer > 0.3 * bodies.strayed)]
                }
    assert {kind for kind, _ in felt} == {SCENE, LOAD, SELF}
    assert {stated for _, stated in felt} == {str(stated) for stated in (*alone, e)}


def test_joints_that_move_both_links_of_a_pair_take_nothing():
    machine = robot("lifts")
    stated = {name: 0.05 if "lift" in name else 1e-9 for name in machine.joint_names}
    bodies = everything(machine, lifts_scene(), Uncertainty(joints=stated), machine.home)
    for pair, kind in enumerate(bodies.kind):
        if kind == SELF:
            sides = {name.split("_")[0] for name in bodies.name(pair).split(" and ")}
            expected = 0.05 * (len(sides) if "base" not in sides else 1) if len(sides) > 1 else 0.0
            assert bodies.strayed[pair] == pytest.approx(expected, abs=1e-7)


OVERHANG = {"shape": "bar", "length": 0.5, "radius": 0.01, "overhang": 0.2, "mass": 1.0}
BOX = {"shape": "box", "size": [0.4, 0.6, 0.2], "mass": 1.0}


@pytest.mark.parametrize("load", [OVERHANG, BOX])
def test_a_payload_moves_no_further_than_its_hands_allow(load):
    """Whatever rigid motion displaces no grasp by more, nor turns it more about the line between them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ComoveWarning)
        scene = lifts_scene(load=load)
    carried, rng, tight = Carried.straight(scene), np.random.default_rng(4), 0.0
    nodes = scene.nodes_at("start")
    grasps, corners = nodes[:2], nodes[2:]
    line = (grasps[1] - grasps[0]) / np.linalg.norm(grasps[1] - grasps[0])
    for _ in range(2000):
        swing = 0.2 * rng.standard_normal() * np.cross(line, rng.standard_normal(3))
        spin = rng.choice([0.0, 0.2]) * rng.uniform(-1.0, 1.0)
        turn = Rotation.from_rotvec(swing - (swing @ line) * line) * Rotation.from_rotvec(spin * line)
        about = nodes.mean(axis=0) + rng.choice([0.0, 0.3]) * rng.standard_normal(3)

        def moved(points, turn=turn, about=about):
            return np.linalg.norm(turn.apply(points - about) + about - points, axis=1).max()

        bound = payload_shift(carried, moved(grasps), abs(spin))
        assert moved(corners) <= bound + 1e-12
        tight = max(tight, moved(corners) / bound)
    assert tight > 0.9


def test_what_is_off_by_nothing_shifts_no_payload():
    assert payload_shift(Carried(known_carry()[0]), 0.0, 0.0) == 0.0


def test_a_motion_is_verified_for_all_joints_that_follow_within_the_deviations():
    """Commands keep the clearances that they keep without; beside them, nothing touches while joints deviate."""
    motion, joints = known_carry()
    sure = verify_joints(baxter(), motion, joints)
    strays = verify_joints(uncertain_baxter(joints=0.005), motion, joints)
    assert strays.verified is not None
    assert strays.report.joint_margin_min == pytest.approx(sure.report.joint_margin_min - 0.005)
    assert 0.01 < strays.report.hand_uncertainty < 0.03  # m: arms of a metre, seven joints
    assert strays.report.hand_uncertainty <= strays.report.load_uncertainty < 0.03
    least = min(
        getattr(sure.report, name) for name in ("clearance_scene", "clearance_load", "clearance_self")
    )
    for name in ("clearance_scene", "clearance_load", "clearance_self"):
        assert getattr(strays.report, name) == getattr(sure.report, name)
    assert 0.0 < strays.report.clearance_deviating < least - 0.01
    assert np.isnan(sure.report.load_uncertainty)
    assert np.isnan(sure.report.clearance_deviating)
    assert tightened(strays.verified).report == strays.report


def test_one_number_is_that_of_every_joint():
    motion, joints = known_carry()
    one, each = (
        verify_joints(uncertain_baxter(joints=stated), motion, joints).report
        for stated in (0.005, dict.fromkeys(baxter().joint_names, 0.005))
    )
    assert one.asdict() == each.asdict()


def test_bases_and_joints_add_up():
    motion, joints = known_carry()
    stated = ({"position": 0.003}, {"joints": 0.003}, {"position": 0.003, "joints": 0.003})
    bases, strays, both = (verify_joints(uncertain_baxter(**one), motion, joints).report for one in stated)
    assert both.hand_uncertainty == pytest.approx(bases.hand_uncertainty + strays.hand_uncertainty)
    assert both.clearance_deviating == pytest.approx(strays.clearance_deviating - 0.003, abs=1e-3)


@pytest.mark.parametrize(
    ("stated", "told"),
    [
        (
            0.01,
            ["the payload may be off by", "how far joints may deviate", "ask for more clearance", "smaller"],
        ),
        (0.02, ["may meet at", "m nearer than they are commanded", "or state smaller deviations"]),
        (0.4, ["may be", "beyond its limits", "as it may deviate by 0.4 rad"]),
    ],
)
def test_deviations_that_a_motion_does_not_allow_are_refused(stated, told):
    motion, joints = known_carry()
    verdict = verify_joints(uncertain_baxter(joints=stated), motion, joints)
    assert verdict.verified is None
    assert any(all(word in reason for word in told) for reason in verdict.reasons), verdict.reasons


@pytest.mark.parametrize("tolerances", [{}, {"position": 0.002, "rotation_deg": 0.05}])
def test_what_is_said_to_be_allowed_is_verified_and_little_more_is_not(tolerances):
    motion, joints = known_carry()
    machine, hands = uncertain_baxter(**tolerances), verify(motion).verified
    most = allowed_deviation(machine, hands, joints)
    assert most > 0.001
    assert verify_joints(uncertain_baxter(**tolerances, joints=most), hands, joints).verified is not None
    assert verify_joints(uncertain_baxter(**tolerances, joints=1.12 * most), hands, joints).verified is None


def test_what_is_allowed_is_found_where_links_are_nearest():
    """Far from the payload, near to a link: pairs decide, not the payload."""
    motion, joints = known_carry()
    post = {"shape": "sphere", "center": [0.2, 0.95, 0.1], "radius": 0.05}
    scene = Scene.from_dict(scene_data(obstacles=(post,)))
    hands = verify(on_scene(motion, scene)).verified
    most = allowed_deviation(baxter(), hands, joints)
    fits = verify_joints(uncertain_baxter(joints=most), hands, joints)
    refused = verify_joints(uncertain_baxter(joints=1.12 * most), hands, joints)
    assert fits.verified is not None
    assert any("joints that deviate" in reason for reason in refused.reasons), refused.reasons


def test_a_motion_in_contact_allows_none():
    motion, joints = known_carry()
    away = JointMotion(joints.time, joints.joint_names, joints.position + 0.5)
    assert allowed_deviation(baxter(), verify(motion).verified, away) == 0.0
