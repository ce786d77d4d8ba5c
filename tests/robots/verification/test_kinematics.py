"""Placements of all joints at once, against Pinocchio's one after the other."""

import numpy as np
import pinocchio as pin
import pytest

from comove.robots.verification.kinematics import joint_placements
from tests.robots.small_robots import BUNDLED, RANDOM, robot


@pytest.mark.parametrize("name", [*BUNDLED, *RANDOM, "gantry"])
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
