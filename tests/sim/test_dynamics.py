"""A joint motion in MuJoCo does what mechanics says."""

import dataclasses
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest

from comove.errors import RobotError, SceneError
from comove.model import Scene
from comove.robots import JointMotion
from comove.robots.effort import carried_masses, loaded_model, torques
from comove.sim import Connect, Friction, Perturbation, Push, Settings, Weld, play, simulate
from comove.sim.building import build_world
from comove.sim.dynamics import at_start
from comove.sim.engine import engine
from comove.sim.loads import hand_poses, load_of
from comove.sim.servos import PayloadTorques
from tests.robots.known_path import known_motion
from tests.sim.benchmark import joints_straight, load_straight, posts, standing

G = 9.81  # m/s^2
JOINT_DAMPING = 0.7  # N m s/rad, of Baxter's URDF


@lru_cache(maxsize=8)
def carried(grasp):
    """The known good motion."""
    robot, motion = known_motion()
    return simulate(motion, posts(), robot, grasp)


@lru_cache(maxsize=16)
def held(grasp=None, mass=0.25, perturbation=None, duration=0.5):
    """Standing still with the stick in the hands."""
    robot, motion = standing(duration)
    return simulate(motion, posts(mass=mass), robot, grasp, perturbation)


@pytest.mark.parametrize(("grasp", "end_error"), [(Weld(), 1e-3), (Connect(), 1e-3), (Friction(), 3e-3)])
def test_the_known_motion_delivers_the_stick(grasp, end_error):
    execution = carried(grasp)
    assert execution.delivered, execution.reasons
    assert execution.measures["distance_error_max"] <= 5e-4
    assert execution.end_error <= end_error
    assert execution.measures["slip_max"] <= 2e-3
    assert not execution.contacts


@pytest.mark.parametrize("grasp", [Weld(), Friction()])
def test_the_straight_way_fails_at_the_posts(grasp):
    robot, _ = known_motion()
    execution = simulate(load_straight(), posts(), robot, grasp)
    assert not execution.delivered
    assert any(
        contact.between == ("the load", "obstacles[1] (cylinder)") and 2.5 < contact.time < 3.5
        for contact in execution.contacts
    )
    assert "the load touched obstacles[1] (cylinder)" in " ".join(execution.reasons)


def test_the_shortest_way_of_the_joints_tears_the_stick_out_of_the_hands():
    robot, _ = known_motion()
    execution = simulate(joints_straight(), posts(), robot, Friction())
    assert not execution.delivered
    assert sum("the load left the hand" in reason for reason in execution.reasons) == 2


@pytest.mark.parametrize("grasp", [Weld(), Connect(), Friction()])
def test_hands_at_rest_bear_the_weight_of_the_stick(grasp):
    force = held(grasp).wrench[-1, :, :3].sum(axis=0)
    assert np.allclose(force, [0, 0, 0.25 * G], atol=1e-4)


def test_hands_that_are_linked_by_points_bear_no_torque():
    assert np.abs(held(Connect()).wrench[..., 3:]).max() < 1e-6
    sagging = held(Weld(), perturbation=Perturbation(mass=3.0))
    assert np.abs(sagging.wrench[..., 3:]).max() > 1e-3


def test_motors_at_rest_bear_the_weight_of_robot_and_stick_but_for_the_springs():
    """tau = (1 - r) g(q) + J' f, by Pinocchio's recursion and the forces on the load."""
    execution = held(Connect(), duration=2.0)
    robot, q = execution.robot, execution.joints[-1]
    data = robot.model.createData()
    tau = (1 - robot.relief) * pin.rnea(robot.model, data, q, 0 * q, 0 * q)
    pin.computeJointJacobians(robot.model, data, q)
    pin.updateFramePlacements(robot.model, data)
    for i, arm in enumerate(robot.arms):
        jacobian = pin.getFrameJacobian(
            robot.model, data, robot.model.getFrameId(arm.tip), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        tau += jacobian.T @ execution.wrench[-1, i]
    assert np.abs(execution.torque[-1] - tau).max() < 1e-4


def test_work_of_motors_and_springs_is_energy_gained_and_friction_lost():
    """From rest to rest: sum of tau dq = change of potential energy + damping; the stick keeps its height."""
    execution = carried(Weld())
    robot, q = execution.robot, execution.joints
    data = robot.model.createData()
    potential = [pin.computePotentialEnergy(robot.model, data, q[i]) for i in (0, -1)]
    weight = np.array([pin.computeGeneralizedGravity(robot.model, data, each) for each in q])
    force = execution.torque + robot.relief * weight
    dq = np.diff(q, axis=0)
    work = (0.5 * (force[1:] + force[:-1]) * dq).sum()
    lost = JOINT_DAMPING * (dq**2 / np.diff(execution.time)[:, None]).sum()
    assert abs(work - (potential[1] - potential[0]) - lost) < 0.01 * (lost + abs(potential[1] - potential[0]))


def test_a_payload_of_stated_mass_does_not_sag_whatever_it_weighs():
    heights = [held(mass=mass).load_pose[-1, 2, 3] for mass in (0.25, 1.0, 4.0)]
    assert heights == pytest.approx([heights[0]] * 3, abs=5e-5)


def test_a_payload_heavier_than_stated_sags_in_proportion_to_the_error():
    factors = (1.0, 3.0, 5.0, 0.5)
    heights = [
        held(mass=0.5, perturbation=Perturbation(mass=factor)).load_pose[-1, 2, 3] for factor in factors
    ]
    per_error = np.diff(heights) / np.diff(factors)
    assert (per_error < 0.0).all()
    np.testing.assert_allclose(per_error, per_error[0], rtol=0.03)


def test_servos_that_know_the_payload_carry_it_as_inverse_dynamics_says():
    """Torques logged at rest are those of Pinocchio with point masses at the hands; the servos add next to none."""
    execution = held(mass=4.0)
    robot, scene = execution.robot, execution.scene
    arms = tuple(robot.arm(name) for name in scene.manipulators)
    model, q, still = (
        loaded_model(robot, arms, carried_masses(scene)),
        execution.joints[-1:],
        np.zeros((1, 14)),
    )
    wanted = torques(robot, model, q, still, still)[0]
    np.testing.assert_allclose(execution.torque[-1], wanted, atol=0.1)


def test_stiffer_servos_sag_less():
    heavier = {"mass": 4.0}
    base, soft, stiff = (
        held(perturbation=Perturbation(gains=(factor,), **more)).load_pose[-1, 2, 3]
        for factor, more in ((1.0, {}), (0.5, heavier), (2.0, heavier))
    )
    assert base - soft == pytest.approx(4 * (base - stiff), rel=0.05)


@pytest.mark.parametrize(("coefficient", "holds"), [(0.02, False), (0.1, True)])
def test_friction_holds_what_fingers_press_for(coefficient, holds):
    """Two fingers a hand of 20 N hold 4 x 20 N x mu: the stick's 2.45 N from mu = 0.031 on."""
    execution = held(Friction(coefficient=coefficient), duration=1.0)
    assert execution.delivered == holds, execution.reasons


def test_no_finger_holds_a_stick_by_its_very_end():
    """Where a round finger touches it along one line, it would slip out there."""
    robot, motion = standing()
    data = posts().file.model_dump(exclude_none=True)
    scene = Scene.from_dict({**data, "load": {**data["load"], "overhang": 0.0}})
    grasp, hands = Friction(), hand_poses(robot, scene, motion.position[:1])[0]
    load = load_of(scene, hands, grasp.section)
    world = build_world(robot, scene, load, grasp, Perturbation())
    data = at_start(world, motion, PayloadTorques(robot, scene), Perturbation())
    grasp.close(world, data)
    within = dict[int, float]()  # m, how far from the stick's end a finger touches it
    for pair, point in zip(data.contact.geom, data.contact.pos, strict=True):
        bodies = world.model.geom_bodyid[pair]
        if world.load_body in bodies and world.hand_of_geom[pair].max() >= 0:
            along = (point - data.xpos[world.load_body]) @ data.xmat[world.load_body].reshape(3, 3)[:, 0]
            finger = int(bodies[bodies != world.load_body][0])
            within[finger] = max(within.get(finger, 0.0), load.parts[0].size[0] - abs(along))
    assert len(within) == 4 and min(within.values()) > 5e-3, within


def test_fingers_that_stand_beyond_each_other_open_first():
    """As those do whose limits leave out the 0 where joints begin."""
    robot, motion = standing()
    scene, grasp = posts(), Friction()
    load = load_of(scene, hand_poses(robot, scene, motion.position[:1])[0], grasp.section)
    world = build_world(robot, scene, load, grasp, Perturbation())
    data, model = at_start(world, motion, PayloadTorques(robot, scene), Perturbation()), world.model
    fingers = [model.joint(finger) for finger in world.fingers]
    for finger in fingers:
        data.qpos[finger.qposadr[0]] = -2.0 * max(finger.range, key=abs)
    engine().mj_forward(model, data)
    grasp.close(world, data)
    assert all(finger.range[0] < data.qpos[finger.qposadr[0]] < finger.range[1] for finger in fingers)


def test_what_falls_before_the_motion_begins_was_not_held():
    """Fingers without friction: the stick lies on the table when time begins, and nothing moves any more."""
    robot, motion = standing()
    execution = simulate(motion, posts(), robot, Friction(coefficient=1e-3), settings=Settings(settle=4.0))
    assert "when the motion began: the hands did not hold it" in " ".join(execution.reasons)


def test_a_push_displaces_the_stick_along_it_and_passes():
    push = Perturbation(push=Push(at=0.4, duration=0.1, force=(0.0, 0.0, -20.0)))
    execution = held(perturbation=push, duration=2.0)
    away = execution.load_pose[:, 2, 3] - execution.load_pose[0, 2, 3]
    assert np.abs(away[execution.time < 0.79]).max() < 1e-5
    assert away.min() < -1e-3 and 0.8 < execution.time[away.argmin()] < 1.0
    assert abs(away[-1]) < 1e-5


def test_a_start_error_stays_with_the_stick():
    """The fingers close where the stick lies, and the hands carry it so."""
    execution = held(Friction(), perturbation=Perturbation(start_error=(0.005, 0.0, 0.0)))
    assert execution.start_error == pytest.approx(0.005, abs=5e-4)
    assert execution.end_error < 1e-3


def test_what_is_pressed_between_the_hands_is_told():
    """Hands that are 4 mm nearer to each other than the stick allows press it."""
    robot, motion = known_motion()
    q, rows = motion.position[0].copy(), []
    data, arm = robot.model.createData(), robot.arms[0]
    frame = robot.model.getFrameId(arm.tip)
    apart = robot.tool_pose(q, robot.arms[1])[:3, 3] - robot.tool_pose(q, arm)[:3, 3]
    step = np.zeros(6)
    step[:3] = 0.004 * apart / np.linalg.norm(apart)
    jacobian = pin.computeFrameJacobian(robot.model, data, q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    s = np.linspace(0.0, 1.0, 101)
    rows = q + (3 * s**2 - 2 * s**3)[:, None] * (np.linalg.pinv(jacobian) @ step)
    pressed = simulate(JointMotion(2 * s, motion.joint_names, rows), posts(), robot, Weld())
    assert pressed.squeeze[-1, 0] > 5.0
    assert abs(pressed.squeeze[0, 0]) < 0.5
    limited = simulate(
        JointMotion(2 * s, motion.joint_names, rows),
        posts(),
        robot,
        settings=Settings(internal_force_limit=5.0),
    )
    assert "worked against each other" in " ".join(limited.reasons)


def test_the_same_again():
    first, second = (simulate(standing()[1], posts(), standing()[0], Friction()) for _ in range(2))
    assert all(np.array_equal(first.series()[name], second.series()[name]) for name in first.series())


def test_motors_give_no_more_than_they_can():
    """A motion that is ten times too fast: torques stay within the limits, and the robot lags."""
    robot, motion = known_motion()
    execution = simulate(motion.stretched(1.0), posts(), robot)
    assert execution.measures["torque_share_max"] < 1.05
    assert not execution.delivered


def test_geometry_and_physics_tell_of_one_motion():
    robot, motion = known_motion()
    drawn, real = play(motion, robot, posts()), carried(Weld())
    steps = len(drawn.time)
    assert np.allclose(drawn.time, real.time[:steps])
    assert np.abs(drawn.load_pose - real.load_pose[:steps]).max() < 1e-3
    assert np.abs(drawn.torque - real.torque[:steps]).max() < 0.5  # N m, of joint damping and control


def test_a_motion_of_other_joints_is_refused():
    robot, motion = known_motion()
    other = dataclasses.replace(motion, joint_names=motion.joint_names[::-1])
    with pytest.raises(RobotError, match="play it on the robot that it was made for"):
        simulate(other, posts(), robot)


def test_a_planar_scene_is_refused():
    robot, motion = known_motion()
    planar = Scene.from_dict(
        {
            "name": "plane",
            "duration": 1.0,
            "workspace": {"lower": [0, 0], "upper": [1, 1]},
            "manipulators": [{"name": "left", "start": [0.1, 0.1], "goal": [0.9, 0.9]}],
        }
    )
    with pytest.raises(SceneError, match="robots live in space"):
        simulate(motion, planar, robot)


def test_hands_without_a_load_are_followed_as_well():
    robot, motion = known_motion()
    file = {**posts().file.model_dump(exclude_none=True), "load": None, "constraints": (), "grasp": None}
    free = Scene.from_dict({key: value for key, value in file.items() if value not in (None, ())})
    execution = simulate(motion.stretched(4.0), free, robot)
    assert execution.delivered, execution.reasons
    assert execution.measures["slip_max"] is None
    assert execution.wrench.shape[1:] == (0, 6)


@pytest.mark.slow
def test_twenty_perturbed_grips_deliver():
    robot, motion = known_motion()
    for seed in range(20):
        perturbation = Perturbation.drawn(np.random.default_rng(seed), len(robot.joint_names))
        execution = simulate(motion, posts(), robot, Friction(), perturbation)
        assert execution.delivered and not execution.contacts, (seed, execution.reasons)


@pytest.mark.slow
def test_a_narrower_gap_and_half_the_time():
    robot, motion = known_motion()
    for scene, pace in ((posts(0.26), 10.0), (posts(), 5.0)):
        assert simulate(motion.stretched(pace), scene, robot).delivered
