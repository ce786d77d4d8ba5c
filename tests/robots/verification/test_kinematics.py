"""Placements and velocities of all joints at once, against Pinocchio's one after the other."""

import numpy as np
import pinocchio as pin
import pytest

from comove.robots.verification.kinematics import (
    Inertias,
    inverse_dynamics,
    joint_motions,
    joint_placements,
    moved_by,
)
from tests.robots.small_robots import BUNDLED, RANDOM, robot


@pytest.mark.parametrize("name", [*BUNDLED, *RANDOM, "gantry"])
@pytest.mark.few(4)
def test_placements_are_those_of_pinocchio(name):
    machine, rng = robot(name), np.random.default_rng(4)
    q = rng.uniform(machine.lower, machine.upper, (12, len(machine.lower)))
    turns, places = joint_placements(machine, q)
    data = machine.model.createData()
    for step, joints in enumerate(q):
        pin.forwardKinematics(machine.model, data, joints)
        for joint, pose in enumerate(data.oMi):
            np.testing.assert_allclose(turns[step, joint], pose.rotation, atol=1e-13)
            np.testing.assert_allclose(places[step, joint], pose.translation, atol=1e-13)


@pytest.mark.parametrize("name", ["baxter", *RANDOM, "gantry"])
def test_velocities_are_those_of_pinocchio(name):
    """In the scene's axes, at the joints' origins; and a joint moves what its column of the Jacobian moves."""
    machine, rng = robot(name), np.random.default_rng(5)
    q = rng.uniform(machine.lower, machine.upper, (8, len(machine.lower)))
    rates = rng.normal(size=q.shape)
    model, data = machine.model, machine.model.createData()
    turns, _, velocities, spins = joint_motions(machine, q, rates)
    np.testing.assert_array_equal(turns, joint_placements(machine, q)[0])
    for step, (joints, rate) in enumerate(zip(q, rates, strict=True)):
        pin.computeJointJacobians(model, data, joints)
        pin.forwardKinematics(model, data, joints, rate)
        for joint in range(1, model.njoints):
            twist = pin.getVelocity(model, data, joint, pin.LOCAL_WORLD_ALIGNED)
            np.testing.assert_allclose(velocities[step, joint], twist.linear, atol=1e-12)
            np.testing.assert_allclose(spins[step, joint], twist.angular, atol=1e-12)
            own = pin.getJointJacobian(model, data, joint, pin.LOCAL).any(axis=0)
            np.testing.assert_array_equal(moved_by(machine)[joint], own)


@pytest.mark.parametrize("name", [*BUNDLED, *RANDOM, "gantry"])
@pytest.mark.few(4)
def test_torques_are_those_of_pinocchio_less_what_springs_hold(name):
    machine, rng = robot(name), np.random.default_rng(6)
    model = machine.model.copy()
    model.armature = rng.uniform(0.0, 0.5, model.nv)
    q, (rates, bends) = (
        rng.uniform(machine.lower, machine.upper, (8, model.nv)),
        rng.normal(size=(2, 8, model.nv)),
    )
    loaded, grasp = model.copy(), pin.SE3.Random()
    loaded.appendBodyToJoint(model.njoints - 1, pin.Inertia(2.0, np.zeros(3), np.zeros((3, 3))), grasp)
    found = inverse_dynamics(machine, Inertias.of(loaded), q, rates, bends, Inertias.of(model))
    data, own = loaded.createData(), model.createData()
    for step, motion in enumerate(zip(q, rates, bends, strict=True)):
        held = machine.relief * pin.computeGeneralizedGravity(model, own, q[step])
        np.testing.assert_allclose(found[step], pin.rnea(loaded, data, *motion) - held, atol=1e-9)
