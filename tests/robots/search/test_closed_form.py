"""Inverse kinematics in closed form: every pose comes from Pinocchio, and what is found is placed by it again."""

import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.robots import Robot
from comove.robots.description import find_description, load_description
from comove.robots.model import assembled
from comove.robots.search.chains import chains_of
from comove.robots.search.closed_form import (
    ALONG,
    N_BRANCHES,
    WRIST_ALONG,
    WRIST_MEET_1,
    WRIST_MEET_2,
    closed_form,
    closed_seeds,
    nearest_turns,
    solve_in_closed_form,
)
from tests.cases import examples
from tests.robots.small_robots import robot, urdf, written

X, Y, Z = "1 0 0", "0 1 0", "0 0 1"
SKEW = "1 0 -1"
MADE = {  # joints from the base: where each is in the frame of the one before, and its axis
    "puma": [("0 0 .3", Z), (".1 .05 .1", Y), ("0 -.02 .4", Y), (".05 0 .1", X), (".3 0 0", Y), ("0 0 0", X)],
    "skew wrist": [("0 0 .3", Z), ("0 0 .1", Y), (".4 0 0", Y), (".05 .02 .1", X), (".3 0 0", SKEW), ("0 0 0", Y)],
    "offset shoulder": [("0 0 .3", Z), (".1 0 0", Y), ("0 0 0", X), (".4 0 .1", X), (".3 0 0", Z), ("0 0 0", Y)],
    "puma, from the grasp": [
        ("0 0 .3", Z), ("0 0 0", Y), ("0 0 0", X), (".3 0 .1", Y), (".4 0 0", Y), ("0 .1 .1", X)
    ],
    "iiwa": [
        ("0 0 .34", Z), ("0 0 0", Y), ("0 0 .4", Z), ("0 0 0", Y), ("0 0 .4", Z), ("0 0 0", Y), ("0 0 .1", Z)
    ],
    "pr2 alike": [
        ("0 0 .3", Z), (".1 0 0", Y), ("0 0 0", X), (".4 0 0", Y), ("0 0 0", X), (".32 0 0", Y), ("0 0 0", X)
    ],
}  # fmt: skip
KNOWN = {
    "puma": (WRIST_ALONG, -1, False),
    "skew wrist": (WRIST_MEET_1, -1, False),
    "offset shoulder": (WRIST_MEET_2, -1, False),
    "puma, from the grasp": (WRIST_ALONG, -1, True),
    "iiwa": (WRIST_MEET_1, 6, True),
    "pr2 alike": (WRIST_MEET_1, 0, False),
    "two_pandas": (WRIST_MEET_1, 6, True),
    "two_xarm7": (WRIST_MEET_1, 6, True),
    "two_ur10": (ALONG, -1, False),
    "pr2": (WRIST_MEET_1, 0, False),
    "two_fr3": (WRIST_MEET_1, 6, True),
}
ROUNDED = {"two_xarm7": 1e-4, "two_ur10": 1e-4}  # m and rad: models with few digits
REGULAR, FEEBLE = 0.02, {"offset shoulder": 2e-4}  # least singular values; that arm has none above 0.01
SINGULAR = (
    1e-7  # m and rad: there, angles come from cosines near 1, and are as inexact as the root of rounding
)
SHARES = st.lists(st.floats(0, 1), min_size=7, max_size=7)


def with_right_angles(name):
    """A bundled robot whose right angles are exact, though its URDF has few digits."""
    description = load_description(find_description(name))
    models = [model.model_copy(update={"round_right_angles": True}) for model in description.models]
    return assembled(description.model_copy(update={"models": tuple(models)}), find_description(name))


@lru_cache(maxsize=16)
def arm_of(name, *, is_right=False):
    """Robot, chains and closed form of the first arm of a robot; right angles exact where they must be."""
    if name in MADE:
        parts, before = [], "base"
        for k, (place, axis) in enumerate(MADE[name]):
            parts.append(
                f'<link name="l{k}"/><joint name="j{k}" type="revolute"><parent link="{before}"/><child link="l{k}"/>'
                f'<origin xyz="{place}"/><axis xyz="{axis}"/>'
                '<limit lower="-2.9" upper="2.6" velocity="1" effort="9"/></joint>'
            )
            before = f"l{k}"
        tool = {"position": [0.02, -0.03, 0.1], "quaternion_wxyz": [0.5, -0.5, 0.5, 0.5]}
        base = {"position": [0.3, -0.2, 0.1], "quaternion_wxyz": [0.8, 0.0, 0.6, 0.0]}
        description = {
            "models": [{"urdf": "arm.urdf", "base": base}],
            "arms": {"a": {"tip": before, "tool": tool}},
        }
        with tempfile.TemporaryDirectory() as folder, pytest.warns():
            machine = Robot.load(written(Path(folder), {"arm.urdf": urdf("".join(parts))}, description))
    else:
        machine = with_right_angles(name) if is_right else robot(name)
    chains = chains_of(machine, machine.arms)
    return machine, chains, closed_form(chains, 0)


def posed(machine, joints):
    """The grasp of the first arm at some joints, by Pinocchio."""
    q = machine.home
    q[machine.arms[0].columns] = joints
    pose = machine.tool_pose(q, machine.arms[0])
    return np.ascontiguousarray(pose[:3, :3]), pose[:3, 3].copy()


def apart(p, q):
    """Largest difference of angles [rad]."""
    return np.abs(np.angle(np.exp(1j * (p - q)))).max(axis=-1)


def all_solutions(form, rotation, point, angle):
    out = np.empty((N_BRANCHES, len(form.axis)))
    count = solve_in_closed_form(form, rotation, point, angle, out)
    found = out[~np.isnan(out).any(axis=1)]
    assert len(found) == count
    return found


@pytest.mark.parametrize("name", KNOWN)
def test_the_geometry_of_known_arms_is_recognised(name):
    form = arm_of(name)[2]
    assert (form.kind, form.free, form.back) == KNOWN[name]


def test_arms_without_a_closed_form_are_told_apart():
    for name in (
        "baxter",
        "gantry",
        "random 0",
    ):  # offsets at shoulder and wrist; joints that slide; anything
        machine = robot(name)
        chains = chains_of(machine, machine.arms)
        assert [closed_form(chains, i) for i in range(len(machine.arms))] == [None] * len(machine.arms)


@pytest.mark.parametrize("name", KNOWN)
@given(shares=SHARES)
@examples(60)
def test_all_solutions_have_the_pose_and_the_joints_it_came_from_are_among_them(name, shares):
    machine, _, form = arm_of(name)
    columns = machine.arms[0].columns
    low, high = machine.lower[columns], machine.upper[columns]
    q = low + np.array(shares[: len(columns)]) * (high - low)
    rotation, point = posed(machine, q)
    found = all_solutions(form, rotation, point, 0.0 if form.free < 0 else q[form.free])
    for joints in found:
        turn, place = posed(machine, joints)
        within = ROUNDED.get(name, 1e-9 if is_regular(machine, joints, form.free) else SINGULAR)
        assert np.linalg.norm(place - point) < within
        assert np.linalg.norm(pin.log3(turn @ rotation.T)) < within
    if is_regular(machine, q, form.free, FEEBLE.get(name, REGULAR)):  # otherwise others have the same pose
        assert apart(found, q).min() < 1e2 * (ROUNDED | dict.fromkeys(FEEBLE, 1e-6)).get(name, 1e-9)


def is_regular(machine, q, free, least=REGULAR):
    return np.linalg.svd(numeric_jacobian(machine, q, free))[1][-1] > least


def numeric_jacobian(machine, q, free):
    """The grasp's Jacobian without the joint that is given, by Pinocchio's placements."""
    columns, steps = [k for k in range(len(q)) if k != free], 1e-6
    out = []
    rotation, point = posed(machine, q)
    for k in columns:
        turn, place = posed(machine, q + steps * np.eye(len(q))[k])
        out.append(np.concatenate([place - point, pin.log3(turn @ rotation.T)]) / steps)
    return np.array(out).T


@pytest.mark.parametrize("name", ["puma", "skew wrist", "two_ur10", "two_pandas"])
def test_there_are_up_to_eight_solutions_and_all_differ(name):
    machine, _, form = arm_of(name)
    rng, most = np.random.default_rng(0), 0
    columns = machine.arms[0].columns
    for _ in range(200):
        q = rng.uniform(machine.lower[columns], machine.upper[columns])
        found = all_solutions(form, *posed(machine, q), 0.0 if form.free < 0 else q[form.free])
        most = max(most, len(found))
        for i, one in enumerate(found):
            assert all(apart(one, other) > 1e-6 for other in found[:i])
    assert most == 8


@pytest.mark.parametrize("name", ["puma", "two_pandas", "two_ur10"])
def test_a_pose_out_of_reach_has_no_solution(name):
    _, _, form = arm_of(name)
    assert len(all_solutions(form, np.eye(3), np.array([5.0, 0.0, 0.0]), 0.3)) == 0


def test_whole_turns_bring_joints_nearest_to_a_posture_inside_their_limits():
    chains = chains_of(robot("two_ur10"), robot("two_ur10").arms)  # +- 2 pi
    posture = np.full(12, 6.0)
    q = np.array([0.5, -0.5, 3.0, -3.0, 0.0, 3.1])
    away = nearest_turns(chains, 0, posture, q)
    np.testing.assert_allclose(q, [0.5, 2 * np.pi - 0.5, 3.0, 2 * np.pi - 3.0, 2 * np.pi, 3.1], atol=1e-12)
    assert away == 5.5
    panda = chains_of(robot("two_pandas"), robot("two_pandas").arms)
    assert (
        nearest_turns(panda, 0, np.zeros(14), np.array([0, 0, 0, 3.0, 0, 1.0, 0])) == np.inf
    )  # -3.07 to -0.07


@pytest.mark.parametrize("name", ["two_pandas", "two_xarm7", "pr2 alike", "two_ur10"])
def test_seeds_are_inside_the_limits_and_have_the_pose(name):
    machine, chains, form = arm_of(name)
    rng, columns = np.random.default_rng(3), machine.arms[0].columns
    posture = np.concatenate([arm.home for arm in machine.arms])
    for _ in range(20):
        q = rng.uniform(machine.lower[columns], machine.upper[columns])
        rotation, point = posed(machine, q)
        seeds = closed_seeds(form, chains, 0, rotation, point, posture, 64)
        assert len(seeds) > 0 or form.free >= 0
        for seed in seeds:
            own = seed[: len(columns)]
            assert (own >= machine.lower[columns]).all() and (own <= machine.upper[columns]).all()
            np.testing.assert_array_equal(seed[len(columns) :], posture[len(columns) :])
            turn, place = posed(machine, own)
            within = ROUNDED.get(name, 1e-9)
            assert np.linalg.norm(place - point) + np.linalg.norm(pin.log3(turn @ rotation.T)) < 2 * within
