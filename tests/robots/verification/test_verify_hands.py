"""How far hands are off the load, against dense sampling by Pinocchio."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
from hypothesis import given
from hypothesis import strategies as st

from comove.robots.verification.carried import Carried, holding_errors
from tests.cases import examples
from tests.robots.known_carry import baxter, grasp_frames, known_carry


def errors_of(motion, joints):
    robot = baxter()
    return holding_errors(robot, robot.arms, Carried(motion), joints.curve)


def sampled(motion, joints, time):
    """Errors of position [m] and rotation [rad]; arrays, shape (n_steps, 2)."""
    robot, found = baxter(), []
    for q, targets in zip(joints.curve(time), grasp_frames(motion, time), strict=True):
        poses = [robot.tool_pose(q, arm) for arm in robot.arms]
        found.append(
            [
                (
                    np.linalg.norm(pose[:3, 3] - target[:3, 3]),
                    np.linalg.norm(pin.log3(target[:3, :3].T @ pose[:3, :3])),
                )
                for pose, target in zip(poses, targets, strict=True)
            ]
        )
    return np.array(found).transpose(2, 0, 1)


def assert_bounded(motion, joints, time):
    errors = errors_of(motion, joints)
    position, turn = sampled(motion, joints, time)
    piece = np.clip(np.searchsorted(errors.time, time, side="right") - 1, 0, len(errors.time) - 2)
    assert (position <= errors.position_bound[piece] + 1e-14).all()
    assert (turn <= errors.turn_bound[piece] + 1e-9).all()  # log3 is no more exact
    return errors, position, turn


@examples(5)
@given(st.integers(0, 2**32 - 1))
def test_hands_are_never_further_off_than_bound(seed):
    """Also where joints miss by a lot, and between samples that are far apart."""
    rng = np.random.default_rng(seed)
    rate = float(rng.choice([5.0, 20.0, 100.0]))
    motion, joints = known_carry(rate=rate)
    noise = rng.normal(size=joints.position.shape) * 10.0 ** rng.uniform(-8, -2)
    joints = replace(joints, position=joints.position + noise)
    errors, position, turn = assert_bounded(motion, joints, np.sort(rng.uniform(0, 10.0, 3000)))
    assert errors.position_bound.max() < 5.0 * position.max() + 4e-6
    assert errors.turn_bound.max() < 5.0 * turn.max() + 4e-6


def test_bounds_of_the_known_path_are_tight_enough_to_prove_it():
    motion, joints = known_carry()
    errors, position, _ = assert_bounded(motion, joints, np.linspace(0.0, 10.0, 7001))
    assert errors.position[errors.is_sample].max() < 1e-12
    assert errors.position_bound.max() < position.max() + 3.5e-6
    assert errors.turn_bound.max() < 3.5e-6
    assert errors.apart_bound < 7e-6


def test_the_grid_holds_all_samples():
    motion, joints = known_carry(rate=20.0)
    errors = errors_of(motion, joints)
    np.testing.assert_allclose(errors.time[errors.is_sample], joints.time, atol=1e-12)
    assert len(errors.time) > 2 * len(joints.time)


def test_hands_and_their_frames_move_as_their_velocities_say():
    """Velocities of hands and grasp frames are differences of places and orientations."""
    carried = Carried(known_carry()[0])
    time, step = np.linspace(0.5, 9.5, 40), 1e-5
    held, ahead, behind = (carried.hands(when) for when in (time, time + step, time - step))
    change = (ahead.positions - behind.positions) / (2 * step)
    np.testing.assert_allclose(held.velocities, change, atol=1e-8)
    rotations, spins = held.rotations, held.spins
    later, earlier = ahead.rotations, behind.rotations
    for k in range(len(time)):
        for hand in range(2):
            change = pin.log3(later[k, hand] @ earlier[k, hand].T) / (2 * step)
            np.testing.assert_allclose(spins[k, hand], change, atol=1e-6)
    np.testing.assert_array_equal(rotations[0, 0], rotations[0, 1])


def test_bounds_of_the_hands_motion_hold():
    """Speeds, accelerations, third derivatives and swing, against differences."""
    carried = Carried(known_carry()[0])
    knots = carried.time
    middle, width = 0.5 * (knots[1:] + knots[:-1]), np.diff(knots)
    inside = middle[:, None] + width[:, None] * np.array([-0.3, -0.1, 0.1, 0.3])
    begin, end = inside[:, 0], inside[:, -1]
    places = carried.nodes(inside.ravel()).reshape(*inside.shape, -1, 3)
    speed = np.linalg.norm(np.diff(places, axis=1), axis=-1) / (0.2 * width[0])
    pull = np.linalg.norm(np.diff(places, n=2, axis=1), axis=-1) / (0.2 * width[0]) ** 2
    for bound, found in zip(carried.bounds.over(begin, end).T, (speed, pull), strict=True):
        assert (found.max(axis=(1, 2)) <= bound * (1 + 1e-6) + 1e-7).all()
    third = np.linalg.norm(np.diff(places[:, :, :2], n=3, axis=1)[:, 0], axis=-1) / (0.2 * width[0]) ** 3
    assert (third <= carried.jerk.over(begin, end) * 1.01 + 1e-4).all()
    along = places[:, :, 0] - places[:, :, 1]
    heading = np.unwrap(np.arctan2(along[..., 1], along[..., 0]), axis=1)
    swing = np.abs(np.diff(heading, n=3, axis=1)[:, 0]) / (0.2 * width[0]) ** 3
    assert (swing <= carried.swing.over(begin, end)[:, 0] * 1.01 + 1e-3).all()
