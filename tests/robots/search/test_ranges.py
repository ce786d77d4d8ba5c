"""How far wrists can be from shoulders, against poses by Pinocchio and poses that are searched for."""

import numpy as np
import pinocchio as pin
import pytest

from comove.robots import Robot
from comove.robots.search.chains import chains_of
from comove.robots.search.following import PERSISTENT, solutions
from comove.robots.search.ranges import may_reach, ranges_of
from tests.robots.small_robots import BUNDLED, RANDOM, columns, robot, urdf, written


@pytest.mark.parametrize("name", [*BUNDLED, *RANDOM, "gantry"])
@pytest.mark.few(5)
def test_no_pose_that_joints_have_is_out_of_range(name):
    arms = robot(name)
    chains = chains_of(arms, arms.arms)
    ranges, rng = ranges_of(chains), np.random.default_rng(1)
    for _ in range(300):
        q = np.zeros(len(arms.lower))
        q[columns(arms.arms)] = rng.uniform(chains.lower, chains.upper)
        for i, arm in enumerate(arms.arms):
            pose = arms.tool_pose(q, arm)
            assert may_reach(ranges, i, pose[:3, :3].copy(), pose[:3, 3].copy())


@pytest.mark.parametrize("name", ["baxter", "ur5_and_panda", "two_so101", "random 0"])
def test_no_joints_are_found_for_a_pose_out_of_range_and_many_poses_are(name):
    arms = robot(name)
    chains = chains_of(arms, arms.arms)
    ranges, rng = ranges_of(chains), np.random.default_rng(2)
    middle = 0.5 * (chains.lower + chains.upper)
    out = 0
    for _ in range(60):
        rotation = pin.exp3(rng.uniform(-np.pi, np.pi, 3))
        point = ranges.shoulder[0] + rng.uniform(-1.0, 1.0, 3) * ranges.most[0]
        if may_reach(ranges, 0, rotation, point):
            continue
        out += 1
        seeds = rng.uniform(chains.lower, chains.upper, (10, len(middle)))
        assert solutions(chains, 0, rotation, point, middle, seeds, PERSISTENT, len(seeds))[1].min() > 1e-3
    assert out >= 10


@pytest.mark.filterwarnings("ignore:.*no link of the arm")
def test_two_links_reach_their_sum_and_not_less_than_their_difference(tmp_path):
    """An arm of 0.5 m and 0.3 m whose elbow turns between half a turn and none: 0.2 m to 0.8 m."""
    links = '<link name="upper"/><link name="fore"/><link name="tip"/>'
    limit = '<limit lower="{}" upper="{}" velocity="1" effort="9"/>'
    joints = [("j0", "base", "upper", "0 0 0", -3, 3), ("j1", "upper", "fore", "0.5 0 0", 0, np.pi)]
    joints += [("j2", "fore", "tip", "0.3 0 0", -3, 3)]
    body = links + "".join(
        f'<joint name="{name}" type="revolute"><parent link="{a}"/><child link="{b}"/><origin xyz="{at}"/>'
        f'<axis xyz="0 0 1"/>{limit.format(low, high)}</joint>'
        for name, a, b, at, low, high in joints
    )
    tool = {"position": [0.0, 0.4, 0.1]}
    description = {"models": [{"urdf": "one.urdf"}], "arms": {"a": {"tip": "tip", "tool": tool}}}
    planar = Robot.load(written(tmp_path, {"one.urdf": urdf(body)}, description))
    ranges = ranges_of(chains_of(planar, planar.arms))
    np.testing.assert_allclose(ranges.shoulder[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(ranges.wrist[0], [0.0, -0.4, -0.1], atol=1e-12)
    np.testing.assert_allclose([ranges.least[0], ranges.most[0]], [0.2, 0.8], atol=0.012)
