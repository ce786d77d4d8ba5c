"""Inverse kinematics in closed form beside EAIK, ssik and frankik: what others find, and nothing else, is found."""

import numpy as np
import pinocchio as pin
import pytest

from tests.robots.search.test_closed_form import (
    FEEBLE,
    REGULAR,
    ROUNDED,
    all_solutions,
    apart,
    arm_of,
    is_regular,
    posed,
)

SAME = 1e-4  # rad
ARMS = (
    "puma",
    "skew wrist",
    "offset shoulder",
    "puma, from the grasp",
    "iiwa",
    "pr2 alike",
    "two_ur10",
    "two_pandas",
    "two_fr3",
    "two_xarm7",
    "pr2",
)


def axes_and_steps(machine):
    """Axes of the first arm's joints at 0 and the steps from one to the next, the last to the grasp; and its turn."""
    arm, model = machine.arms[0], machine.model
    at = [machine.home, *np.repeat(machine.home[None], len(arm.columns), axis=0)]
    for k, q in enumerate(at):
        q[arm.columns] = 0.0 if k == 0 else np.eye(len(arm.columns))[k - 1]
    placed = []
    for q in at:
        data = model.createData()
        pin.forwardKinematics(model, data, q)
        placed.append([data.oMi[j] for j in joints_of(machine)])
    axes = np.array(
        [
            pin.log3(moved[k].rotation @ still.rotation.T)
            for k, (moved, still) in enumerate(zip(placed[1:], placed[0], strict=True))
        ]
    )
    grasp = machine.tool_pose(at[0], arm)
    places = np.array([*(place.translation for place in placed[0]), grasp[:3, 3]])
    return axes, np.vstack([places[:1], np.diff(places, axis=0)]), grasp[:3, :3]


def joints_of(machine):
    """Numbers of the first arm's joints."""
    first = np.array(machine.model.idx_vs)
    return [int(np.flatnonzero(first == column)[-1]) for column in machine.arms[0].columns]


def drawn(name, n, seed=0):
    """Regular joints of an arm within a turn, and the pose of its grasp at them."""
    machine, _, form = arm_of(name, is_right=True)
    columns, rng = machine.arms[0].columns, np.random.default_rng(seed)
    low, high = np.maximum(machine.lower[columns], -3.0), np.minimum(machine.upper[columns], 3.0)
    while n:
        q = rng.uniform(low, high)
        if is_regular(machine, q, form.free, FEEBLE.get(name, REGULAR)):
            n -= 1
            yield q, *posed(machine, q)


def as_pose(rotation, point):
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, point
    return pose


def are_the_same(some, others):
    """Whether each of some joints is among others, and the other way round."""
    some, others = np.array(some), np.array(others)
    if not (len(some) and len(others)):
        return len(some) == len(others)
    return all(apart(others, q).min() < SAME for q in some) and all(
        apart(some, q).min() < SAME for q in others
    )


@pytest.mark.parametrize("name", ARMS)
def test_eaik_finds_the_same_solutions(name):
    """EAIK fixes the joint that is given, too; of what it finds counts what Pinocchio places at the pose."""
    robots = pytest.importorskip("eaik.IK_HP")
    machine, _, form = arm_of(name, is_right=True)
    axes, steps, turn = axes_and_steps(machine)
    for q, rotation, point in drawn(name, 40):
        fixed = [] if form.free < 0 else [(form.free, q[form.free])]
        theirs = []
        for joints in robots.HPRobot(axes, steps, fixed).IK(as_pose(rotation @ turn.T, point)).Q:
            joints = joints if len(joints) == len(q) else np.insert(joints, form.free, q[form.free])
            turned, place = posed(machine, joints)
            miss = np.linalg.norm(place - point) + np.linalg.norm(pin.log3(turned @ rotation.T))
            if miss < max(1e-6, 2.0 * ROUNDED.get(name, 0.0)):
                theirs.append(joints)
        assert are_the_same(
            theirs, all_solutions(form, rotation, point, 0.0 if form.free < 0 else q[form.free])
        )


@pytest.mark.parametrize("name", ["puma", "skew wrist", "offset shoulder", "two_ur10"])
def test_ssik_finds_the_same_solutions(name):
    """Of arms of six joints."""
    ssik = pytest.importorskip("ssik")
    machine, _, form = arm_of(name, is_right=True)
    axes, steps, turn = axes_and_steps(machine)
    arm = ssik.Manipulator.from_axes(axes, steps)
    for _, rotation, point in drawn(name, 40):
        pose = as_pose(rotation @ turn.T, point)
        theirs = arm.solve(pose, respect_limits=False, enumerate_windings=False)
        assert are_the_same([one.q for one in theirs], all_solutions(form, rotation, point, 0.0))


@pytest.mark.parametrize(("name", "kind"), [("two_pandas", "panda"), ("two_fr3", "fr3")])
def test_what_frankik_finds_is_found(name, kind):
    """He and Liu's solutions for a given last joint, as published for these two arms; those within their limits."""
    frankik = pytest.importorskip("frankik")
    form = arm_of(name, is_right=True)[2]
    flange = np.linalg.inv(frankik.fk(np.zeros(7))) @ flange_at_0()
    low, high = (getattr(frankik, f"q_{end}_{kind}") for end in ("min", "max"))
    known = 0
    for q, *pose in drawn(name, 60):
        if not ((q >= low) & (q <= high)).all():
            continue
        theirs = frankik.ik_full(frankik.fk(q) @ flange, q_actual=q, q7=q[6], is_fr3=kind == "fr3")
        theirs = theirs[~np.isnan(theirs).any(axis=1)]
        ours = all_solutions(form, *pose, q[6])
        assert all(apart(ours, joints).min() < SAME for joints in theirs)
        known += len(theirs) > 0 and apart(theirs, q).min() < SAME
    assert known > 20


def flange_at_0():
    """The flange of a Panda and of an FR3 at 0, by the published parameters (Denavit and Hartenberg, modified)."""
    pose = np.eye(4)
    quarter = 0.5 * np.pi
    for along, turned, up in (
        (0.0, 0.0, 0.333),
        (0.0, -quarter, 0.0),
        (0.0, quarter, 0.316),
        (0.0825, quarter, 0.0),
        (-0.0825, -quarter, 0.384),
        (0.0, quarter, 0.0),
        (0.088, quarter, 0.0),
        (0.0, 0.0, 0.107),
    ):
        step = pin.SE3(pin.utils.rotate("x", turned), np.array([along, 0.0, 0.0])).homogeneous
        pose = pose @ step @ pin.SE3(np.eye(3), np.array([0.0, 0.0, up])).homogeneous
    return pose
