"""Soft limits of URDFs, by a reader of the raw files that shares nothing with comove's."""

import warnings
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import cmeel_pth
import numpy as np
import pytest
import yaml

import comove
from comove.control.safety.cbf_qp import JointState
from comove.errors import ComoveWarning, RobotError
from comove.model import Scene
from comove.robots import JointMotion, Robot, plan_transfers
from comove.robots.effort import shortest_duration
from comove.robots.further_limits import FurtherLimits
from comove.robots.motion import JointCurve, approach_shares, largest_approach, largest_jerk
from comove.robots.online.executor import JointExecutor
from comove.robots.verification import checks
from tests.robots.known_carry import baxter, known_carry
from tests.robots.online.test_arm_rows import ready
from tests.robots.small_robots import EXAMPLES, robot, urdf, written

SHARE = Path(cmeel_pth.__file__).parent / "cmeel.prefix" / "share"
DESCRIPTIONS = Path(__file__).parents[2] / "src" / "comove" / "robots" / "descriptions"


def stated(name: str) -> dict[str, tuple[float, float, float, float]]:
    """Limits, k_position and speed of the joints of a bundled robot, as its raw URDFs and its YAML state them."""
    told = yaml.safe_load((DESCRIPTIONS / f"{name}.yaml").read_text())
    found = {}
    for model in told["models"]:
        path = model["urdf"].removeprefix("package://")
        root = ET.parse(SHARE / path).getroot()
        for joint in root.findall("joint"):
            own = model.get("prefix", "") + joint.get("name")
            limit, safety, given = (
                joint.find("limit"),
                joint.find("safety_controller"),
                told.get("limits", {}),
            )
            if joint.get("type") not in ("revolute", "prismatic"):
                continue
            given = given.get(own, {})
            low, high = (given.get(key, float(limit.get(key))) for key in ("lower", "upper"))
            gain = np.inf
            if safety is not None and "soft_lower_limit" in safety.attrib:
                low = max(low, given.get("soft_lower", float(safety.get("soft_lower_limit"))))
                high = min(high, given.get("soft_upper", float(safety.get("soft_upper_limit"))))
                gain = float(safety.get("k_position"))
            found[own] = low, high, gain, given.get("velocity", float(limit.get("velocity")))
    return found


def beyond(name: str, joints: JointMotion) -> float:
    """The most by which a motion passes limits [rad], or velocities near them [rad/s], at many instants."""
    time, worst = np.linspace(0.0, joints.duration, 20_001), -np.inf
    position, velocity, _ = joints.at(time)
    limits = stated(name)
    for k, joint in enumerate(joints.joint_names):
        if joint in limits:
            low, high, gain, fastest = limits[joint]
            q, v = position[:, k], velocity[:, k]
            worst = max(worst, (low - q).max(), (q - high).max())
            if np.isfinite(gain):
                v_high = np.clip(-gain * (q - high), -fastest, fastest)
                v_low = np.clip(-gain * (q - low), -fastest, fastest)
                worst = max(worst, (v - v_high).max(), (v_low - v).max())
    return worst


def scene_of(name: str) -> Scene:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ComoveWarning)
        return Scene.load(EXAMPLES / "robots" / f"{name}.yaml")


@pytest.mark.parametrize("name", ["pr2", "tiago_pro", "two_fr3", "two_pandas", "ur5_and_panda"])
def test_the_limits_of_a_robot_are_the_narrowest_that_its_files_state(name):
    machine, limits = robot(name), stated(name)
    for k, joint in enumerate(machine.joint_names):
        if joint in limits:
            low, high, gain, _ = limits[joint]
            assert (machine.lower[k], machine.upper[k]) == pytest.approx((low, high), abs=1e-12)
            assert machine.approach[k] == pytest.approx(1.0 / gain)
            assert low < machine.home[k] < high


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        ("tiago_pro", 1),
        *(
            pytest.param(name, seed, marks=pytest.mark.slow)
            for name in ("pr2", "tiago_pro", "two_fr3", "two_pandas", "ur5_and_panda")
            for seed in (2, 3)
        ),
    ],
)
def test_verified_motions_keep_the_soft_limits_of_the_raw_files(name, seed):
    solution = comove.solve(scene_of(name), robot=robot(name), seed=seed)
    assert solution.verified
    assert beyond(name, solution.joints.attempt) <= 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pr2", "tiago_pro"])
def test_ways_from_home_and_back_keep_the_soft_limits_of_the_raw_files(name):
    transfers = plan_transfers(comove.solve(scene_of(name), robot=robot(name), seed=1).joints.motion)
    for part in (transfers.approach, transfers.release):
        assert beyond(name, part) <= 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pr2", "tiago_pro"])
def test_commands_step_by_step_keep_the_soft_limits_of_the_raw_files(name):
    executor = JointExecutor(scene_of(name), robot(name))
    sent = [executor.position.copy()]
    while not executor.arrived and len(sent) < 5000:
        sent.append(np.array(executor.step(executor.position)))
    assert executor.arrived
    time = executor.settings.period * np.arange(len(sent))
    assert beyond(name, JointMotion(time, executor.robot.joint_names, np.array(sent))) <= 1e-6


def random_motion(seed):
    """A clamped spline of three joints, limits that it keeps, and time constants, of which one may be 0."""
    rng = np.random.default_rng(seed)
    time = np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 1.0, rng.integers(1, 8)))])
    curve = JointCurve.through(time, rng.normal(size=(len(time), 3)))
    dense = np.linspace(0.0, time[-1], 20_001)
    position = curve(dense)
    lower, upper = (
        position.min(axis=0) - rng.uniform(0.01, 1, 3),
        position.max(axis=0) + rng.uniform(0.01, 1, 3),
    )
    return curve, dense, lower, upper, rng.uniform(0.02, 0.5, 3) * rng.integers(0, 2, 3)


@pytest.mark.parametrize("seed", range(60))
def test_the_largest_share_of_the_velocity_near_limits_is_that_of_dense_sampling(seed):
    curve, time, lower, upper, approach = random_motion(seed)
    worst = largest_approach(curve, approach, lower, upper)
    shares = approach_shares(curve(time), curve(time, 1), approach, lower, upper)
    assert worst.value >= shares.max() - 1e-9
    assert worst.value == pytest.approx(shares.max(), rel=0.01, abs=1e-9)
    if worst.value > 0.0:
        q, v = curve(worst.time)[worst.joint], curve(worst.time, 1)[worst.joint]
        room = upper[worst.joint] - q if v > 0 else q - lower[worst.joint]
        assert worst.value == pytest.approx(approach[worst.joint] * abs(v) / room, rel=1e-6)


def test_a_joint_cannot_come_to_rest_at_a_soft_limit():
    time = np.linspace(0.0, 2.0, 21)
    curve = JointCurve.through(time, np.sin(0.25 * np.pi * time)[:, None] ** 2)
    reached = largest_approach(curve, np.array([0.1]), np.array([-1.0]), np.array([1.0]))
    assert reached.value > 20.0  # without bound, but for what rounding leaves of the limit
    from_limit = largest_approach(curve, np.array([0.1]), np.array([0.0]), np.array([2.0]))
    assert from_limit.value < 1.0  # it may leave one


def near_soft_limits(gain):
    """Baxter with soft limits 0.05 rad beyond the known motion, and that motion."""
    machine, (_, joints) = baxter(), known_carry()
    lower, upper = joints.position.min(axis=0) - 0.05, joints.position.max(axis=0) + 0.05
    lower, upper = np.maximum(machine.lower, lower), np.minimum(machine.upper, upper)
    return replace(machine, lower=lower, upper=upper, approach=np.full(len(lower), 1.0 / gain)), joints


def test_a_joint_that_is_too_fast_near_its_soft_limit_is_named_and_the_advice_works():
    machine, joints = near_soft_limits(0.5)
    (reason,) = checks.limits(machine, joints.curve).reasons
    assert "before its limit" in reason
    assert "where k_position 0.5 allows" in reason
    longer = float(reason.partition("take ")[2].split()[0])
    assert checks.limits(machine, joints.stretched(1.01 * longer * joints.duration).curve).reasons == []
    assert checks.limits(machine, joints.stretched(0.98 * longer * joints.duration).curve).reasons


def test_the_shortest_duration_keeps_soft_limits():
    machine, joints = near_soft_limits(1.0)
    arms, masses = machine.arms, np.full(2, 0.125)
    duration = shortest_duration(machine, joints, arms, masses)
    assert duration > shortest_duration(replace(machine, approach=np.zeros(14)), joints, arms, masses)
    finding = checks.limits(machine, joints.stretched(duration).curve)
    assert finding.reasons == []
    assert finding.measures["velocity_ratio_max"] == pytest.approx(1.0, abs=1e-6)


def test_joints_that_are_run_step_by_step_approach_soft_limits_no_faster_than_they_may():
    safe, carrier, q, _ = ready()
    chains, rows = carrier.arms.chains, safe.joints
    slow = chains._replace(approach=np.full(len(q), 2.0))
    rows.arms, arms = carrier.arms._replace(chains=slow), rows.arms
    try:
        rng = np.random.default_rng(0)
        for _ in range(50):
            position = rng.uniform(chains.lower, chains.upper)
            low, high = rows.joint_bounds(JointState(position, *np.zeros((3, len(q)))))
            assert (position + 2.0 * high <= chains.upper + 1e-9).all()
            assert (position + 2.0 * low >= chains.lower - 1e-9).all()
    finally:
        rows.arms = arms


def test_jerks_are_verified_where_they_are_limited_and_the_advice_works():
    machine, (_, joints) = baxter(), known_carry()
    free = checks.limits(machine, joints.curve)
    assert "jerk_ratio_max" not in free.measures  # nobody states any
    largest = np.abs(np.diff(joints.acceleration, axis=0) / np.diff(joints.time)[:, None])
    limited = replace(machine, jerk=np.full(14, 0.2 * largest.max()))
    assert largest_jerk(joints.curve, limited.jerk).value >= 5.0 * (1 - 1e-9)
    (reason,) = checks.limits(limited, joints.curve).reasons
    assert "jerks by up to" in reason
    longer = float(reason.partition("take ")[2].split()[0])
    assert checks.limits(limited, joints.stretched(1.01 * longer * joints.duration).curve).reasons == []
    duration = shortest_duration(limited, joints, machine.arms, np.full(2, 0.125))
    assert checks.limits(limited, joints.stretched(duration).curve).reasons == []


# --- What files state ---

HARD = '<limit lower="-1" upper="2" velocity="3" effort="4"/>'


def arm(safety="", limit=HARD, kind="revolute"):
    return urdf(
        '<link name="hand"><inertial><mass value="1"/><inertia ixx=".1" ixy="0" ixz="0" iyy=".1" iyz="0" izz=".1"/>'
        '</inertial><collision><geometry><sphere radius="0.05"/></geometry></collision></link>'
        f'<joint name="turn" type="{kind}"><parent link="base"/><child link="hand"/><axis xyz="0 0 1"/>'
        f"{limit}{safety}</joint>"
    )


def load(folder, text, **more):
    arms = {"left": {"tip": "hand"}}
    return Robot.load(
        written(folder, {"r.urdf": text}, {"models": [{"urdf": "r.urdf"}], "arms": arms, **more})
    )


def soft(**attributes):
    told = " ".join(f'{key}="{value}"' for key, value in attributes.items())
    return f"<safety_controller {told}/>"


@pytest.mark.parametrize(
    ("safety", "limits", "expected"),
    [
        ("", {}, (-1, 2, 0)),
        (soft(k_velocity=10), {}, (-1, 2, 0)),
        (soft(soft_lower_limit=-0.5, soft_upper_limit=1.5), {}, (-0.5, 1.5, 0)),
        (
            soft(soft_lower_limit=-0.5, soft_upper_limit=1.5, k_position=20, k_velocity=5),
            {},
            (-0.5, 1.5, 0.05),
        ),
        (soft(soft_lower_limit=-9, soft_upper_limit=1.5, k_position=20), {}, (-1, 1.5, 0.05)),
        (soft(soft_lower_limit=-9, soft_upper_limit=9, k_position=0), {}, (-1, 2, 0)),
        (soft(soft_lower_limit=-0.5, soft_upper_limit=1.5), {"soft_upper": 1.8}, (-0.5, 1.8, 0)),
        (soft(soft_lower_limit=-0.5, soft_upper_limit=1.5), {"lower": 0, "k_position": 4}, (0, 1.5, 0.25)),
        ("", {"soft_lower": 0.5, "k_position": 4}, (0.5, 2, 0.25)),
    ],
)
def test_soft_limits_narrow_the_others_and_the_description_replaces_them(safety, limits, expected, tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        machine = load(tmp_path, arm(safety), limits={"turn": limits})
    assert (machine.lower[0], machine.upper[0], machine.approach[0]) == pytest.approx(expected)


def test_soft_limits_of_a_joint_that_turns_without_end_do_not_bind(tmp_path):
    text = arm(
        soft(soft_lower_limit=-1, soft_upper_limit=1), '<limit velocity="3" effort="4"/>', "continuous"
    )
    with pytest.raises(RobotError, match="turns without end"):
        load(tmp_path, text)


def test_limits_of_the_description_beyond_soft_ones_are_told_and_the_advice_replaces_them(tmp_path):
    text = arm(soft(soft_lower_limit=-0.5, soft_upper_limit=1.5))
    with pytest.warns(ComoveWarning, match="go beyond the soft limits in the URDF, which bind") as caught:
        machine = load(tmp_path, text, limits={"turn": {"lower": -0.7, "upper": 1.9}})
    assert (machine.lower[0], machine.upper[0]) == (-0.5, 1.5)
    advised = yaml.safe_load(str(caught[0].message).partition("write limits: ")[2])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        machine = load(tmp_path, text, limits={"turn": {"lower": -0.7, "upper": 1.9, **advised["turn"]}})
    assert (machine.lower[0], machine.upper[0]) == (-0.7, 1.9)


def test_a_soft_limit_that_is_not_stated_is_0_as_in_ros_and_told(tmp_path):
    with pytest.warns(ComoveWarning, match="one soft limit of 'turn' is not stated and so is 0") as caught:
        machine = load(tmp_path, arm(soft(soft_lower_limit=-0.5)))
    assert (machine.lower[0], machine.upper[0]) == (-0.5, 0.0)
    advised = yaml.safe_load(str(caught[0].message).partition("write limits: ")[2])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load(tmp_path, arm(soft(soft_lower_limit=-0.5)), limits=advised)


@pytest.mark.parametrize(("low", "high"), [(2, 3), (-3, -1), (0, 0), (1, -1), (5, -5)])
def test_soft_limits_that_leave_no_range_are_refused_and_the_advice_works(low, high, tmp_path):
    text = arm(soft(soft_lower_limit=low, soft_upper_limit=high))
    with pytest.raises(
        RobotError, match=f"'turn' has the soft limits {low} to {high}, which leave"
    ) as caught:
        load(tmp_path, text)
    advised = yaml.safe_load("{" + str(caught.value).partition("limits: {")[2])
    machine = load(tmp_path, text, limits=advised)
    assert (machine.lower[0], machine.upper[0]) == (-1, 2)


def test_a_joint_that_does_not_move_stays_within_its_soft_limits(tmp_path):
    lift = arm(soft(soft_lower_limit=0.5, soft_upper_limit=1.5)).replace(
        "</robot>",
        '<link name="head"/><joint name="nod" type="revolute"><parent link="base"/><child link="head"/>'
        f"{HARD}{soft(soft_lower_limit=0.5, soft_upper_limit=1.5)}</joint></robot>",
    )
    assert load(tmp_path, lift).description.posture["nod"] == 0.5
    with pytest.raises(
        RobotError, match=r"'nod' stays at 0, outside its limits; keep it between 0\.5 and 1\.5"
    ):
        load(tmp_path, lift, posture={"nod": 0})


def test_what_is_not_stated_limits_nothing():
    assert FurtherLimits() == FurtherLimits(-np.inf, np.inf, 0.0, None, None)
