"""Joints at both ends, ranked and joined by kernels, against what NumPy finds one after the other."""

import numpy as np
import pytest

from comove.robots.ends import DIGITS, EndSettings, _nearest_first, joined, of_robot, patiently_solved
from comove.robots.search.chains import chains_of, place_arm, turned_towards
from comove.robots.search.following import MET
from tests.robots.small_robots import robot


@pytest.mark.parametrize("name", ["two_xarm7", "ur5_and_panda", "gantry"])
def test_ends_are_joined_as_found_and_by_whole_turns_each_pair_once(name):
    """A goal and the same goal by a turn away are one, where both are turned towards the start."""
    machine, rng = robot(name), np.random.default_rng(2)
    chains, last = chains_of(machine, machine.arms), 0.5
    starts, goals = (rng.uniform(chains.lower, chains.upper, (n, len(chains.lower))) for n in (4, 3))
    away = goals[0] + np.where(goals[0] > 0.0, -2 * np.pi, 2 * np.pi)
    may = ~chains.slides & (away >= chains.lower) & (away <= chains.upper)
    goals = np.vstack([goals, np.where(may, away, goals[0])])
    present, weight = 0.5 * (chains.lower + chains.upper), np.ones(len(chains.lower))
    weight[chains.first[1:] - 1] = last
    row, column, joints, differ = joined(chains, starts, goals, present, last)
    expected = dict[tuple[int, bytes], tuple[int, np.ndarray]]()
    for i, start in enumerate(starts):
        for k, goal in enumerate(goals):
            for one in (turned_towards(chains, start, goal), goal):
                expected.setdefault((i, (one.round(DIGITS) + 0.0).tobytes()), (k, one))
    assert len(row) == len(expected) < 2 * len(starts) * len(goals)
    for i, k, one, away, ((own, _), (number, goal)) in zip(
        row, column, joints, differ, expected.items(), strict=True
    ):
        assert (i, k) == (own, number)
        np.testing.assert_array_equal(one, goal)
        turned = [(weight * np.abs(a - b)).max() for a, b in ((present, starts[i]), (starts[i], one))]
        assert away == pytest.approx(sum(turned), abs=10.0**-DIGITS)


def test_solutions_are_sorted_by_their_distance_and_differ():
    """Of those that are alike the nearest stays; of two as near as each other, the first."""
    rng, posture, apart = np.random.default_rng(3), np.zeros(4), 0.3
    joints = rng.normal(size=(60, 4))
    joints[30:45] = joints[:15] + rng.uniform(-0.1, 0.1, (15, 4))
    joints[45:] = -joints[:15]
    kept = _nearest_first(joints, posture, apart)
    expected = list[np.ndarray]()
    for one in joints[np.argsort(np.abs(joints).max(axis=1).round(DIGITS), kind="stable")]:
        if all(np.abs(one - other).max() > apart for other in expected):
            expected.append(one)
    np.testing.assert_array_equal(kept, expected)
    assert 15 < len(kept) < len(joints)


@pytest.mark.parametrize(
    "joints",
    [
        [-3.0692, 2.128343, 2.598, 0.145638, -1.952222, 1.594430, -0.402932],
        [2.6504, 2.2315, 2.05227, 0.902076, 1.816554, 1.594430, 1.594430],
    ],
    ids=str,
)
def test_poses_near_the_limits_of_many_joints_are_reached(joints):
    """They have no closed form on a G1, and few joints lead there."""
    machine = robot("g1")
    chains, *_ = of_robot(machine, tuple(machine.arms))
    posture = np.concatenate([arm.home for arm in machine.arms]).astype(float)
    q = np.concatenate([joints, posture[len(joints) :]])
    turns, places = np.empty((len(joints) + 1, 3, 3)), np.empty((len(joints) + 1, 3))
    place_arm(chains, 0, q, turns, places)
    _, missing = patiently_solved(
        chains, 0, turns[-1].copy(), places[-1].copy(), posture, EndSettings().n_seeds
    )
    assert missing.min() <= MET
