"""Placements of all joints at once, against Pinocchio's one after the other."""

import numpy as np
import pinocchio as pin
import pytest

from comove.robots.verification.kinematics import joint_placements, joint_twists, moved_by
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
            np.testing.assert_allclose(turns[joint, step], pose.rotation, atol=1e-13)
            np.testing.assert_allclose(places[joint, step], pose.translation, atol=1e-13)


@pytest.mark.parametrize("name", ["baxter", *RANDOM, "gantry"])
def test_twists_are_those_of_pinocchio(name):
    """The world's Jacobian, column by column, and what its columns move."""
    machine, rng = robot(name), np.random.default_rng(5)
    q, rates = rng.uniform(machine.lower, machine.upper, (8, len(machine.lower))), rng.normal(size=(8, 1))
    rates = rates * rng.normal(size=len(machine.lower))
    model, data = machine.model, machine.model.createData()
    twists, moves = joint_twists(machine, *joint_placements(machine, q), rates), moved_by(machine)
    for step, joints in enumerate(q):
        columns = pin.computeJointJacobians(model, data, joints)
        np.testing.assert_allclose(twists[step], (columns * rates[step]).T, atol=1e-12)
        for joint in range(model.njoints):
            own = pin.getJointJacobian(model, data, joint, pin.LOCAL).any(axis=0)
            np.testing.assert_array_equal(moves[joint], own)
