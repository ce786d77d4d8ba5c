"""A verified motion of Baxter, for all tests of this room."""

import sys
import types

import pytest

from tests.robots.known_path import known_motion

try:
    import comove.robots.verify  # noqa: F401
except ImportError:
    stub = types.ModuleType("comove.robots.verify")

    class VerifiedJointMotion:
        def __init__(self, robot, joints, motion):
            self.robot, self.joints, self.motion = robot, joints, motion

    stub.VerifiedJointMotion = VerifiedJointMotion
    sys.modules["comove.robots.verify"] = stub


@pytest.fixture(scope="session")
def verified():
    from comove.robots.verify import VerifiedJointMotion

    robot, joints = known_motion()
    scene = types.SimpleNamespace(name="posts", sha256="5" * 64)
    return VerifiedJointMotion(robot, joints, types.SimpleNamespace(scene=scene))
