"""Joints that carry out a movement of the hands: exact by Pinocchio, smooth, and what is out of reach is told."""

import numpy as np
import pytest
from scipy.interpolate import make_lsq_spline

from comove.robots.search import tracking
from comove.robots.search.tracking import EXACT
from tests.robots.known_carry import grasp_frames, known_carry
from tests.robots.small_robots import columns, grasp_errors, movement, task

NAMES = ("gantry", "gap_30", "two_pandas", "ur5_and_panda")
TWISTS = {"gantry": (0.1, 0.2, 0.05), "gap_30": (0.05, 0.02, 0.0, 0.3), "two_pandas": (0.05, 0.1)}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.few(2)
def test_hands_are_where_they_are_meant_to_be_at_samples_and_between(name):
    carrying = task(name)
    motion = movement(carrying.scene, TWISTS.get(name, ()))
    joints, miss = carrying.track(motion)
    assert miss is None
    assert joints.joint_names == carrying.robot.joint_names
    assert joints.duration == carrying.scene.duration
    np.testing.assert_allclose(np.diff(joints.time), 0.01, atol=1e-12)
    for time, tolerance in ((joints.time[::20], 1e-9), (joints.time[:-1:20] + 0.005, 1e-7)):
        errors = grasp_errors(
            carrying.robot, carrying.holders, joints.at(time)[0], grasp_frames(motion, time)
        )
        assert errors.max() < tolerance
    assert (joints.position >= carrying.robot.lower).all()
    assert (joints.position <= carrying.robot.upper).all()


@pytest.mark.parametrize("name", NAMES)
def test_accelerations_are_finite_and_have_no_jumps(name, monkeypatch):
    """Their steps from sample to sample shrink with the samples' distance, at the ends as well."""
    carrying = task(name)
    motion = movement(carrying.scene, TWISTS.get(name, ()))
    steps = []
    for rate in (100.0, 400.0):
        monkeypatch.setattr(tracking, "SAMPLE_RATE", rate)
        acceleration = carrying.track(motion)[0].acceleration
        assert np.abs(acceleration).max() < 0.2 * carrying.robot.acceleration.max()
        steps.append(np.abs(np.diff(acceleration, axis=0)).max(axis=1))
    coarse, fine = steps
    assert fine.max() < 0.3 * coarse.max()
    assert fine[[0, -1]].max() < 0.3 * max(coarse[[0, -1]].max(), 0.1 * coarse.max())


def test_redundancy_follows_smoothly_without_limits_on_the_way():
    """The same hands, joints as smooth as those of Newton's method from sample to sample."""
    motion, known = known_carry()
    joints, miss = task("gap_30").track(motion)
    assert miss is None
    assert np.abs(joints.acceleration).max() < 1.5 * np.abs(known.acceleration).max()


def test_joints_of_arms_that_carry_nothing_stay_at_home():
    whole = task("gap_30")
    file = whole.scene.file.model_dump(mode="json", exclude_none=True)
    file |= {
        "load": {"shape": "box", "size": [0.05, 0.05, 0.05], "held_by": ["left"]},
        "manipulators": file["manipulators"][:1],
    }
    del file["demonstration"], file["constraints"]
    scene = type(whole.scene).from_dict(file | {"obstacles": []})
    alone = type(whole)(whole.robot, scene)
    joints, miss = alone.track(movement(scene))
    assert miss is None
    still = np.setdiff1d(np.arange(14), columns(alone.holders))
    np.testing.assert_array_equal(
        joints.position[:, still], np.tile(whole.robot.home[still], (len(joints.time), 1))
    )


def test_a_pose_out_of_reach_is_told_with_arm_instant_and_distance():
    """The gantry's left hand reaches x = 0.6 and y = 1.2: what is beyond is missing."""
    carrying = task("gantry")
    motion = movement(carrying.scene, (0.0, 1.0))
    joints, miss = carrying.track(motion)
    assert miss is not None
    places = motion.hands(joints.time / joints.duration)[0]
    beyond = np.maximum(places[:, 0, 1] - 1.2, 0.0), np.maximum(places[:, 1, 1] - 0.4, 0.0)
    assert max(beyond[0].max(), beyond[1].max()) == pytest.approx(beyond[1].max())
    assert miss.arm == "right"
    assert miss.distance == pytest.approx(beyond[1].max(), abs=1e-6)
    assert miss.time == pytest.approx(joints.time[beyond[1].argmax()], abs=0.1)


def test_an_arm_that_is_too_short_misses_by_what_pinocchio_says():
    carrying = task("gap_30")
    motion = movement(carrying.scene, (0.9, 0.0, 0.3))
    joints, miss = carrying.track(motion)
    errors = grasp_errors(
        carrying.robot, carrying.holders, joints.position, grasp_frames(motion, joints.time)
    )
    worst, arm = np.unravel_index(errors.argmax(), errors.shape)
    assert miss.distance == pytest.approx(errors.max(), rel=1e-6)
    assert (miss.arm, miss.time) == (carrying.holders[arm].name, pytest.approx(joints.time[worst]))
    assert miss.distance > 0.05 > EXACT.tolerance
    assert (joints.position >= carrying.robot.lower).all()
    assert (joints.position <= carrying.robot.upper).all()


def test_smooth_joints_are_the_least_squares_spline_through_mirrored_ones():
    """As SciPy fits it to the joints themselves, at their times."""
    rng, end = np.random.default_rng(6), 7.3
    joints, time, at = (
        np.cumsum(rng.normal(size=(201, 5)), axis=0),
        np.linspace(0.0, end, 201),
        np.array([0.0, 0.31, 1.0]),
    )
    inner = np.linspace(-end, 2 * end, 3 * 24 + 1)
    spline = make_lsq_spline(
        np.concatenate([-time[:0:-1], time, 2 * end - time[-2::-1]]),
        np.concatenate([joints[:0:-1], joints, joints[-2::-1]]),
        np.concatenate([[inner[0]] * 5, inner, [inner[-1]] * 5]),
        k=5,
    )
    np.testing.assert_allclose(tracking._smooth(joints, at), spline(end * at), atol=1e-11)
