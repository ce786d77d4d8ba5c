"""What a search learns of movements: arms follow them, and strain, rates and nearness are what is verified."""

import threading

import numpy as np
import pinocchio as pin
import pytest

from comove.model import Scene
from comove.robots import verify_joints
from comove.robots.carrying import RobotCarrier
from comove.robots.search.chains import TURN
from comove.robots.search.following import (
    MET,
    N_PATIENT,
    SEARCHING,
    SETTLING,
    follow,
    follow_one,
    hand_rotation,
    posture_on,
    solutions,
)
from tests.robots.known_carry import TABLE, grasp_frames, known_carry, scene_data
from tests.robots.small_robots import columns, gantry_scene, grasp_errors, movement, robot, task, whole


@pytest.mark.parametrize("name", ["gantry", "gap_30", "two_pandas", "ur5_and_panda"])
def test_hands_are_turned_as_the_scenes_grasp_says(name):
    carrying, out = task(name), np.empty((3, 3))
    for hands in np.random.default_rng(0).normal(size=(20, len(carrying.holders), 3)):
        for i, wanted in enumerate(carrying.scene.grasp.hand_rotations(hands)):
            hand_rotation(carrying.arms.around, hands, i, out)
            np.testing.assert_allclose(out, wanted, atol=1e-14)


@pytest.mark.parametrize("name", ["gantry", "gap_30", "two_pandas", "ur5_and_panda"])
def test_solutions_hold_the_hand_and_keep_the_limits(name):
    carrying = task(name)
    chains, rng = carrying.arms.chains, np.random.default_rng(1)
    nodes = carrying.scene.nodes_at("start")
    rotations = carrying.scene.grasp.hand_rotations(nodes[: len(carrying.holders)])
    seeds = rng.uniform(chains.lower, chains.upper, (20, len(chains.lower)))
    for i, arm in enumerate(carrying.holders):
        joints, missing = solutions(
            chains,
            i,
            rotations[i],
            nodes[i],
            carrying.arms.around.posture,
            seeds.copy(),
            SETTLING,
            N_PATIENT,
        )
        assert (missing < 1e-8).any()
        assert (joints >= chains.lower).all()
        assert (joints <= chains.upper).all()
        for q, left in zip(whole(carrying, joints), missing, strict=True):
            pose = carrying.robot.tool_pose(q, arm)
            turn = np.linalg.norm(pin.log3(rotations[i] @ pose[:3, :3].T))
            away = np.hypot(np.linalg.norm(nodes[i] - pose[:3, 3]), TURN * turn)
            assert left == pytest.approx(away, abs=1e-6)


@pytest.mark.parametrize("name", ["gantry", "gap_30", "two_pandas", "ur5_and_panda"])
def test_arms_follow_a_movement_within_what_a_search_allows(name):
    carrying = task(name)
    motion = movement(carrying.scene)
    nodes = motion.nodes(101)
    q, missing = np.empty((101, len(columns(carrying.holders)))), np.empty((101, 2))
    follow_one(carrying.arms, nodes, carrying.best_course(nodes), q, missing)
    time = np.linspace(0.0, carrying.scene.duration, 101)
    errors = grasp_errors(carrying.robot, carrying.holders, whole(carrying, q), grasp_frames(motion, time))
    np.testing.assert_allclose(errors, missing, atol=1e-7)
    assert missing.max() <= MET
    assert np.abs(np.diff(q, axis=0)).max() < 0.15


def test_rates_are_those_that_the_verification_finds():
    motion, _ = known_carry()
    carrying = RobotCarrier(robot("baxter"), motion.scene)
    joints, miss = carrying.track(motion)
    assert miss is None
    report = verify_joints(carrying.robot, motion, joints).report
    nodes = motion.nodes(101)[None]
    strain = carrying.strain(nodes, joints.position[[0, -1]][:, columns(carrying.holders)])
    speed, acceleration, torque = strain.rates[0].max(axis=0)
    assert speed == pytest.approx(report.velocity_ratio_max, rel=0.1)
    assert acceleration == pytest.approx(report.acceleration_ratio_max, rel=0.2)
    assert torque == pytest.approx(report.torque_ratio_max, rel=0.05)
    around = carrying.arms.around
    assert strain.clearance[0] == pytest.approx(around.clearance + around.spare)
    assert strain.contact[0] == 0.0


def test_a_faster_movement_strains_in_proportion():
    """Speeds grow with the pace, accelerations with its square, still torques do not."""
    carrying = task("gantry")
    nodes = movement(carrying.scene).nodes(101)[None]
    course = carrying.best_course(nodes[0])
    slow, fast = (follow(carrying.arms, nodes, course, duration) for duration in (100.0, 50.0))
    np.testing.assert_allclose(fast[1][..., 0], 2 * slow[1][..., 0], rtol=1e-12)
    np.testing.assert_allclose(fast[1][..., 1], 4 * slow[1][..., 1], rtol=1e-12)
    np.testing.assert_allclose(fast[1][..., 2], slow[1][..., 2], rtol=1e-2)
    weights = 9.81 * (2.0 + 2.0 + 0.5)  # N, of z, yaw and half of the load
    assert slow[1][0, 0, 2] == pytest.approx(weights / 200.0, rel=1e-2)


def test_what_links_pass_between_two_samples_is_noticed():
    """Three samples of a movement over 0.6 m, and a thin rod that the columns meet in between."""
    rod = {"shape": "cylinder", "center": [-0.15, 0.25, 0.8], "radius": 0.005, "height": 0.2}
    free = {**rod, "center": [-0.15, 0.4, 0.8]}
    found = []
    for obstacles in ((rod,), (free,), ()):
        carrying = RobotCarrier(robot("gantry"), gantry_scene(obstacles))
        nodes = movement(carrying.scene).nodes(3)[None]
        strain = carrying.strain(nodes, carrying.best_course(nodes[0]))
        found.append((strain.clearance[0], strain.contact[0]))
    assert found[0][0] < 0.0 < found[0][1]
    assert found[1] == found[2]  # as without any
    assert found[1][0] > 0.0


def test_links_that_come_too_near_the_load_cost_something():
    high = {"shape": "bar", "length": 0.6, "radius": 0.12, "overhang": 0.03}
    workspace = {"lower": [0.0, -1.4, -0.5], "upper": [1.4, 1.4, 1.0]}
    scene = Scene.from_dict(scene_data(load=high, workspace=workspace, obstacles=()))
    motion = movement(scene)
    thick = RobotCarrier(robot("baxter"), scene)
    thin = RobotCarrier(robot("baxter"), Scene.from_dict(scene_data(obstacles=(TABLE,))))
    nodes = motion.nodes(101)[None]
    contacts = [c.strain(nodes, thin.best_course(nodes[0])).contact[0] for c in (thick, thin)]
    assert contacts[0] > contacts[1] == 0.0


def test_motions_that_are_asked_about_first_of_all_are_answered():
    """The ends, which then are still unknown, are solved by the same threads that follow motions."""
    carrying = RobotCarrier(robot("gantry"), gantry_scene())
    nodes = movement(carrying.scene, (0.0, 0.0)).nodes(101)
    course = np.stack([np.concatenate([q[0] for q in ends]) for ends in (carrying.starts, carrying.goals)])
    asked = threading.Thread(
        target=carrying.strain, args=(np.repeat(nodes[None], 8, axis=0), course), daemon=True
    )
    asked.start()
    asked.join(60.0)
    assert not asked.is_alive()


def test_a_movement_out_of_reach_costs_more_the_further_it_is():
    carrying = task("gantry")
    nodes = [movement(carrying.scene, (0.0, shift)).nodes(101) for shift in (0.0, 0.8, 1.0)]
    strain = carrying.strain(np.array(nodes), carrying.best_course(nodes[0]))
    near, far, further = strain.missing.max(axis=1)
    assert near < MET
    most = 0.65 - SEARCHING.keep  # of the right hand, as far as a search lets it go
    assert (far, further) == (pytest.approx(0.8 - most, abs=1e-3), pytest.approx(1.0 - most, abs=1e-3))
    assert (np.diff(strain.penalty.sum(axis=1)) > 0.5).all()


def test_redundant_joints_are_drawn_from_those_of_the_start_to_those_of_the_goal_as_the_hands_move():
    carrying = task("gap_30")
    around, rng = carrying.arms.around, np.random.default_rng(3)
    course, out = rng.normal(size=(2, 14)), np.empty(14)
    for share in (0.0, 0.25, 1.0):
        posture_on(course, around, around.ends[0] + share * (around.ends[1] - around.ends[0]), out)
        np.testing.assert_allclose(out, course[0] + share * (course[1] - course[0]), atol=1e-12)
    posture_on(course, around._replace(ends=around.ends[[0, 0]]), around.ends[0], out)
    np.testing.assert_array_equal(out, course[0])  # where start and goal are one
