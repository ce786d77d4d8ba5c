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
def test_torques_are_those_of_pinocchio(name):
    machine, rng = robot(name), np.random.default_rng(6)
    model = machine.model.copy()
    model.armature = rng.uniform(0.0, 0.5, model.nv)
    q, (rates, bends) = (
        rng.uniform(machine.lower, machine.upper, (8, model.nv)),
        rng.normal(size=(2, 8, model.nv)),
    )
    found = inverse_dynamics(machine, Inertias.of(model), q, rates, bends)
    data = model.createData()
    for step, motion in enumerate(zip(q, rates, bends, strict=True)):
        np.testing.assert_allclose(found[step], pin.rnea(model, data, *motion), atol=1e-9)


@pytest.mark.parametrize("name", ["baxter", *RANDOM, "gantry"])
def test_torques_at_rest_are_those_without_rates(name):
    machine, rng = robot(name), np.random.default_rng(7)
    q = rng.uniform(machine.lower, machine.upper, (8, machine.model.nv))
    still, inertias = np.zeros_like(q), Inertias.of(machine.model)
    at_rest = inverse_dynamics(machine, inertias, q, q[:0], q[:0])
    np.testing.assert_array_equal(at_rest, inverse_dynamics(machine, inertias, q, still, still))
