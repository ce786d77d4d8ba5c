"""Arms in the safety filter: the hands stay on the load, limits hold, and barriers are kept, judged by Pinocchio."""

from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest

from comove.control.safety.cbf_qp import FilterSettings, JointState, SafetyFilter
from comove.control.safety.qp_workspace import Sighting
from comove.control.safety.twists import hand_velocities, poses_of
from comove.errors import SceneError
from comove.model import Scene
from comove.robots.carrying import RobotCarrier
from comove.robots.online.arm_rows import ArmRows, JointSettings
from comove.robots.search.links import place_links
from tests.robots.known_carry import TABLE, scene_data
from tests.robots.small_robots import robot

PERIOD = 0.004


def filter_of(carrier):
    """The safety filter of a carrier's scene and arms."""
    rows = ArmRows(carrier.scene, carrier.arms, carrier.grasp, PERIOD)
    return SafetyFilter(carrier.scene, PERIOD, FilterSettings(spare=5e-4), rows)


@lru_cache(maxsize=4)
def ready(ball=None):
    """A filter on the known scene, with its carrier, joints and poses at the start; a ball may be in it."""
    things = (TABLE,) if ball is None else (TABLE, {"shape": "sphere", "center": list(ball), "radius": 0.05})
    carrier = RobotCarrier(robot("baxter"), Scene.from_dict(scene_data(obstacles=things)))
    q = np.concatenate([starts[0] for starts in carrier.starts])
    safe = filter_of(carrier)
    return safe, carrier, q, poses_of(carrier.scene, "start")


def asked(safe, carrier, q, poses, *, wanted, before=0.0, seen=None):
    """The allowed twist and joint rates for wanted velocities of both hands."""
    state = JointState(q, np.full(len(q), before), np.zeros(len(q)), np.zeros(len(q)))
    seen = Sighting.still(carrier.scene) if seen is None else seen
    still = np.zeros((2, 3))
    allowed = safe.allowed(poses, still, np.tile(wanted, (2, 1)), seen, state)
    return allowed, allowed.rates


def hands_by_pinocchio(carrier, q, rates):
    """Velocities and angular velocities of the grasps; arrays, shape (2, 3)."""
    machine = carrier.robot
    model, data = machine.model, machine.model.createData()
    columns = np.concatenate([arm.columns for arm in carrier.holders])
    whole, moving = machine.home, np.zeros(model.nv)
    whole[columns], moving[columns] = q, rates
    pin.forwardKinematics(model, data, whole, moving)
    velocity, spin = [], []
    for arm in carrier.holders:
        frame = model.getFrameId(arm.tip)
        pose = pin.updateFramePlacement(model, data, frame)
        motion = pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        lever = pose.rotation @ arm.tool[:3, 3]
        velocity.append(motion.linear + np.cross(motion.angular, lever))
        spin.append(motion.angular)
    return np.array(velocity), np.array(spin)


@pytest.mark.parametrize("wanted", [[0.003, 0, 0], [0, -0.003, 0.002], [-0.01, 0.02, 0.01]])
def test_joints_move_the_hands_as_the_load_moves(wanted):
    safe, carrier, q, poses = ready()
    allowed, rates = asked(safe, carrier, q, poses, wanted=wanted)
    assert allowed.relaxed == 0.0
    velocity, spin = hands_by_pinocchio(carrier, q, rates)
    np.testing.assert_allclose(velocity, hand_velocities(carrier.scene, poses, allowed.twists), atol=1e-9)
    assert np.abs(rates).max() > 1e-4
    np.testing.assert_allclose(spin[:, :2], 0.0, atol=1e-9)  # hands stay upright
    np.testing.assert_allclose(spin[:, 2], allowed.twists[0, 5], atol=1e-9)  # and turn with the load


def test_joints_accelerate_no_faster_than_they_may():
    safe, carrier, q, poses = ready()
    _, rates = asked(safe, carrier, q, poses, wanted=[0.5, -0.5, 0.3])
    most = JointSettings().share * carrier.arms.chains.acceleration * PERIOD
    assert (np.abs(rates) <= most + 1e-9).all()


def test_a_joint_brakes_before_its_limit():
    safe, carrier, q, _ = ready()
    chains = carrier.arms.chains
    for side in (1.0, -1.0):
        near = q.copy()
        near[4] = (chains.upper if side > 0 else chains.lower)[4] - side * 0.01
        low, high = safe.joints.joint_bounds(JointState(near, *np.zeros((3, len(q)))))
        towards = high[4] if side > 0 else -low[4]
        assert 0 <= towards <= 0.05 + 1e-12
        fast = np.zeros(len(q))
        fast[4] = side * 1.4  # it cannot stop at once: bounds never contradict each other
        low, high = safe.joints.joint_bounds(JointState(near, fast, *np.zeros((2, len(q)))))
        assert (low <= high).all()


def elbow_at(carrier, q):
    """Both ends of an elbow's axis, array of shape (2, 3), and its radius [m]."""
    start, end = carrier.arms.links.start.copy(), carrier.arms.links.end.copy()
    place_links(carrier.arms.chains, carrier.arms.links, q, start, end)
    elbow = int(np.flatnonzero(carrier.arms.links.joint == 3)[0])
    return np.stack([start[elbow], end[elbow]]), float(carrier.arms.links.radius[elbow])


def beside_the_elbow():
    """The centre of a ball, 3 cm from an elbow [m]."""
    _, carrier, q, _ = ready()
    ends, thick = elbow_at(carrier, q)
    return tuple((ends.mean(axis=0) + [0.0, thick + 0.05 + 0.03, 0.0]).round(4).tolist())


def test_a_link_gives_way_to_what_comes():
    safe, carrier, q, poses = ready(beside_the_elbow())
    seen = Sighting.still(carrier.scene)
    fast = seen._replace(velocity=np.array([[0.0, 0.0, 0.0], [0.0, -0.4, 0.0]]))
    free, _ = asked(safe, carrier, q, poses, wanted=[0.0, 0.0, 0.0], seen=seen)
    assert free.blocking == -2  # nothing hinders who stands still
    pushed, rates = asked(safe, carrier, q, poses, wanted=[0.0, 0.0, 0.0], seen=fast)
    assert pushed.blocking == 1
    assert np.abs(rates).max() > 1e-3


def test_what_is_foreseen_to_pass_by_hinders_less_and_what_stands_as_ever():
    _, _, q, poses = ready()
    ball = {"shape": "sphere", "center": list(beside_the_elbow()), "radius": 0.05}
    data = {**scene_data(obstacles=(TABLE, ball)), "limits": {"speed": 0.5, "acceleration": 1.0}}
    carrier = RobotCarrier(robot("baxter"), Scene.from_dict(data))
    safe = filter_of(carrier)
    still = Sighting.still(carrier.scene)
    slowly, fast = (
        still._replace(velocity=np.array([[0.0, 0.0, 0.0], [0.0, -speed, 0.0]])) for speed in (0.2, 0.3)
    )
    found = []
    for passes in (False, True, False):
        safe.passing(JointSettings().passing if passes else 1.0)
        answers = [
            asked(safe, carrier, q, poses, wanted=[0.0, 0.002, 0.0], seen=seen)
            for seen in (still, slowly, fast)
        ]
        found.append([allowed for allowed, _ in answers])
    usual, passing, again = found
    assert [allowed.blocking for allowed in usual] == [-2, 1, 1]
    assert [allowed.blocking for allowed in passing] == [-2, -2, 1]
    np.testing.assert_array_equal(passing[0].twists, usual[0].twists)
    assert 0.0 < passing[2].relaxed < usual[2].relaxed  # of what comes too fast, less is too fast
    for mine, theirs in zip(usual, again, strict=True):
        np.testing.assert_array_equal(mine.twists, theirs.twists)


def test_loads_of_several_bodies_are_refused():
    carrier = ready()[1]
    data = {
        "name": "two loads",
        "duration": 5.0,
        "workspace": {"lower": [-1, -1, -1], "upper": [1, 1, 1]},
        "manipulators": [
            {"name": name, "start": [x, 0, 0], "goal": [x, 0.1, 0]}
            for name, x in (("a", 0.0), ("b", 0.2), ("c", 0.5), ("d", 0.7))
        ],
        "constraints": [
            {"type": "distance", "between": pair, "distance": 0.2} for pair in (["a", "b"], ["c", "d"])
        ],
    }
    with pytest.raises(SceneError, match="one rigid load"):
        ArmRows(Scene.from_dict(data), carrier.arms, carrier.grasp, PERIOD)


def test_what_was_asked_before_changes_nothing():
    """Obstacles that are known exactly and badly, in turn, and steps with more rows and with fewer."""
    _, _, q, poses = ready(beside_the_elbow())
    data = scene_data(
        obstacles=(TABLE, {"shape": "sphere", "center": list(beside_the_elbow()), "radius": 0.05})
    )
    carrier = RobotCarrier(robot("baxter"), Scene.from_dict({**data, "limits": {"speed": 0.2}}))
    used = filter_of(carrier)
    known = Sighting.still(carrier.scene)
    unsure = known._replace(margin=np.array([0.0, 0.03]))
    comes = unsure._replace(velocity=np.array([[0.0, 0.0, 0.0], [0.0, -1.0, 0.0]]))
    for seen in (known, unsure, comes, known, comes, unsure):
        new = filter_of(carrier)
        answers = [asked(safe, carrier, q, poses, wanted=[0.0, 0.4, -0.2], seen=seen) for safe in (used, new)]
        (allowed, rates), (expected, expected_rates) = answers
        np.testing.assert_array_equal(rates, expected_rates)
        np.testing.assert_array_equal(allowed.twists, expected.twists)
        assert allowed.relaxed == expected.relaxed
        assert used._work.rows.shape == new._work.rows.shape  # there is as much room


def test_margins_of_one_obstacle_yield_before_the_clearance_of_another():
    """An elbow nearly touches a ball, and another one comes from behind: both are uncertain, and one has room."""
    _, carrier, q, poses = ready()
    ends, thick = elbow_at(carrier, q)
    far = thick + 0.05 + carrier.arms.around.clearance + 1e-4
    across = np.linalg.svd((ends[1] - ends[0])[None])[2][1:]
    for angle in np.arange(0.0, 2 * np.pi, np.pi / 2):
        away = np.cos(angle) * across[0] + np.sin(angle) * across[1]
        balls = [
            {"shape": "sphere", "center": (ends.mean(axis=0) + share * far * away).tolist(), "radius": 0.05}
            for share in (1.0, -2.0)
        ]
        scene = Scene.from_dict(scene_data(obstacles=(TABLE, *balls)))
        seen = Sighting.still(scene)._replace(margin=np.array([0.0, 0.25, 0.25]))
        seen.velocity[2] = 1.4 * away
        carrier = RobotCarrier(robot("baxter"), scene)
        _, rates = asked(filter_of(carrier), carrier, q, poses, wanted=[0.0, 0.0, 0.0], seen=seen)
        then, _ = elbow_at(carrier, q + PERIOD * rates)
        shares = np.linspace(0.0, 1.0, 1001)[:, None]
        apart = np.linalg.norm(then[0] + shares * (then[1] - then[0]) - balls[0]["center"], axis=1).min()
        assert apart >= far - 1e-5
