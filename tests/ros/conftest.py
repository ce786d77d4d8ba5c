"""Verified motions of Baxter, for all tests of this room."""

import numpy as np
import pytest

from comove import Scene
from comove.model.motion import CoordinatedMotion
from comove.robots import JointMotion, verify_joints
from comove.robots.transfers import plan_transfers
from tests.robots.known_carry import baxter, followed, grasp_frames, known_carry, scene_data
from tests.robots.known_path import START, hands


@pytest.fixture(scope="session")
def verified():
    """Ten seconds through the posts."""
    return verify_joints(baxter(), *known_carry()).verified


@pytest.fixture(scope="session")
def brief():
    """Two seconds without posts."""
    ends = hands(np.array([0.0, 3.5]))[:, :, :3, 3].tolist()
    names = ("left", "right")
    moves = [{"name": n, "start": a, "goal": b} for n, a, b in zip(names, *ends, strict=True)]
    scene = Scene.from_dict(scene_data(2.0, (), name="brief", manipulators=moves))
    motion = CoordinatedMotion.straight(scene)
    time = np.linspace(0.0, 2.0, 401)
    joints = followed(baxter(), grasp_frames(motion, time), START)
    verdict = verify_joints(baxter(), motion, JointMotion(time, baxter().joint_names, joints))
    assert verdict.verified is not None, verdict.reasons
    return verdict.verified


@pytest.fixture(scope="session")
def transfers(verified):
    """From home to the carry and back home."""
    return plan_transfers(verified)
