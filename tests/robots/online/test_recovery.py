"""The way back of a robot that was driven off: load and hands turn as one body, by Pinocchio."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comove.robots.online.recovery import RecoverySettings, at_ease, way_back
from tests.robots.online.test_link_rows import at_start

PERIOD = 0.004


def poses(carrier, way):
    """The hands' poses; array, shape (n_steps, n_hands, 4, 4)."""
    whole = np.repeat(carrier.robot.home[None], len(way), axis=0)
    whole[:, np.concatenate([arm.columns for arm in carrier.holders])] = way
    return carrier.robot.tool_poses(whole, carrier.holders)


def displaced(held, turn, shift):
    """Poses of hands after they have turned about their middle and gone on as one body."""
    body, middle, moved = Rotation.from_rotvec(turn).as_matrix(), held[:, :3, 3].mean(axis=0), held.copy()
    moved[:, :3, :3] = body @ held[:, :3, :3]
    moved[:, :3, 3] = middle + shift + (held[:, :3, 3] - middle) @ body.T
    return moved


@pytest.mark.parametrize("turn", [(0.3, 0.0, 0.0), (0.0, -0.3, 0.1), (-0.1, -0.1, 0.15), (0.0, 0.0, 0.0)])
def test_load_and_hands_turn_as_one_body(turn):
    carrier, joints, _ = at_start()
    held = poses(carrier, joints[None])[0]
    wanted = displaced(held, np.array(turn), np.array([0.02, -0.03, 0.01]))
    way = way_back(carrier.arms, joints, held, wanted)
    went = poses(carrier, way)
    np.testing.assert_allclose(went[-1], wanted, atol=1e-6)
    np.testing.assert_array_equal(way[0], joints)
    between = np.linalg.inv(went[:, 0]) @ went[:, 1]  # one hand as the other sees it
    np.testing.assert_allclose(between, np.broadcast_to(between[0], between.shape), atol=1e-6)
    assert np.abs(np.diff(way, axis=0)).max() < 0.1


def test_hands_that_have_slid_on_the_load_come_to_lie_as_they_should():
    carrier, joints, _ = at_start()
    held = poses(carrier, joints[None])[0]
    wanted = displaced(held, np.array([0.2, 0.0, 0.1]), np.zeros(3))
    wanted[1, :3, 3] += [0.004, 0.002, -0.003]
    np.testing.assert_allclose(
        poses(carrier, way_back(carrier.arms, joints, held, wanted))[-1], wanted, atol=1e-6
    )


def test_there_is_no_way_beyond_the_reach_of_an_arm():
    carrier, joints, _ = at_start()
    held = poses(carrier, joints[None])[0]
    assert (
        way_back(carrier.arms, joints, held, displaced(held, np.zeros(3), np.array([2.0, 0.0, 0.0]))) is None
    )


def test_a_way_is_gone_gently_from_rest_to_rest():
    carrier, joints, _ = at_start()
    held, chains, pace = poses(carrier, joints[None])[0], carrier.arms.chains, RecoverySettings().pace
    way = way_back(carrier.arms, joints, held, displaced(held, np.array([0.3, 0.1, 0.0]), np.zeros(3)))
    commands = np.vstack([joints, joints, at_ease(carrier.arms, way, PERIOD), way[-1:]])
    rates = np.diff(commands, axis=0) / PERIOD
    np.testing.assert_allclose(commands[-2], way[-1], atol=1e-12)
    assert (np.abs(rates) <= 1.01 * pace * chains.velocity).all()
    bends = np.abs(np.diff(rates, axis=0)) / PERIOD  # the pace alone keeps its share, and ways bend
    assert (bends <= 3 * pace * chains.acceleration).all()
    nowhere = np.repeat(joints[None], 2, axis=0)
    assert len(at_ease(carrier.arms, nowhere, PERIOD)) == 1
