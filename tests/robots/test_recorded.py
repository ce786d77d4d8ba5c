"""Paths of end effectors from recorded joints, against the closed form of an arm of two links in a plane."""

import numpy as np
import pytest

from comove.dmp.demonstrations import Demonstration
from comove.errors import ComoveWarning, DemonstrationError, RobotError
from comove.robots import Robot, end_effector_path
from tests.robots.small_robots import written

UPPER, FORE = 0.4, 0.3
TIME = np.linspace(0.0, 2.0, 41)
TORSO, SHOULDER, ELBOW = np.outer([0.2, 0.7, -1.1], np.sin(TIME))


def links(prefix, torso=False):
    """Two links that turn about z, on a torso that slides along z."""

    def joint(name, parent, x, kind="revolute", axis="0 0 1"):
        return (
            f'<joint name="{prefix}{name}" type="{kind}"><parent link="{parent}"/><child link="{prefix}{name}_link"/>'
            f'<origin xyz="{x} 0 0"/><axis xyz="{axis}"/>'
            f'<limit lower="-2" upper="2" velocity="3" effort="9"/></joint>'
            f'<link name="{prefix}{name}_link"/>'
        )

    first = joint("torso", "base", 0, "prismatic") if torso else ""
    base = f"{prefix}torso_link" if torso else "base"
    return (
        first
        + joint("shoulder", base, 0)
        + joint("elbow_joint", f"{prefix}shoulder_link", UPPER)
        + f'<joint name="{prefix}fixed" type="fixed"><parent link="{prefix}elbow_joint_link"/>'
        f'<child link="{prefix}tip"/><origin xyz="{FORE} 0 0"/></joint><link name="{prefix}tip"/>'
    )


@pytest.fixture
def two_arms(tmp_path):
    text = f'<robot name="two"><link name="base"/>{links("left_")}{links("right_")}</robot>'
    description = {
        "models": [{"urdf": "two.urdf"}],
        "arms": {side: {"tip": f"{side}_tip"} for side in ("left", "right")},
        "acceleration": 5.0,
    }
    return Robot.load(written(tmp_path, {"two.urdf": text}, description))


def joints(axes, *columns, **changes):
    return Demonstration(TIME, np.stack(columns, axis=1), "arm", **{"unit": "rad", "axes": axes} | changes)


def is_closed_form(path):
    turned = SHOULDER + ELBOW
    expected = np.stack(
        [
            UPPER * np.cos(SHOULDER) + FORE * np.cos(turned),
            UPPER * np.sin(SHOULDER) + FORE * np.sin(turned),
            0 * TIME,
        ],
        axis=1,
    )
    np.testing.assert_allclose(path.position, expected, atol=1e-12)
    np.testing.assert_allclose(path.rotation.as_rotvec()[:, 2], turned, atol=1e-9)
    np.testing.assert_array_equal(path.time, TIME)
    assert (path.unit, path.axes) == ("m", ())


@pytest.mark.parametrize(
    "axes",
    [
        ("left_shoulder", "left_elbow_joint"),
        ("left_shoulder.pos", "left_elbow.pos"),
        ("kLeftShoulder", "kLeftElbow"),
        ("Left_Shoulder_Joint", "LEFT_ELBOW"),
    ],
)
def test_joints_are_found_by_their_names(two_arms, axes):
    path = end_effector_path(joints(axes, SHOULDER, ELBOW), two_arms)
    is_closed_form(path)
    assert "end effector of 'left' of the robot 'small'" in path.notes[-1]
    degrees = joints(axes, np.rad2deg(SHOULDER), np.rad2deg(ELBOW), unit="deg")
    is_closed_form(end_effector_path(degrees, two_arms))
    beside = joints(("left_gripper", *axes[::-1], "torso"), TIME, ELBOW, SHOULDER, TIME)
    is_closed_form(end_effector_path(beside, two_arms))


@pytest.mark.parametrize("axes", [("shoulder", "elbow"), ("joint0", "joint1"), ("qpos[0]", "qpos[1]")])
def test_of_several_arms_one_is_named(two_arms, axes):
    recording = joints(axes, SHOULDER, ELBOW)
    with pytest.raises(DemonstrationError, match="may be those of left, right") as caught:
        end_effector_path(recording, two_arms)
    assert caught.value.options == {"arm": "left"}
    is_closed_form(end_effector_path(recording, two_arms, "right"))
    with pytest.raises(RobotError, match="no arm 'middle'"):
        end_effector_path(recording, two_arms, "middle")


def test_what_is_no_recording_of_the_robot_is_told(two_arms):
    for recording, says in [
        (
            joints(("left_shoulder", "left_wrist"), SHOULDER, ELBOW),
            "and not left_elbow_joint of the arm 'left'",
        ),
        (joints(("a", "b"), SHOULDER, ELBOW), "it holds a, b, and not left_shoulder, left_elbow_joint"),
        (Demonstration(TIME, np.stack([SHOULDER, ELBOW], axis=1)), "positions in m, not joints"),
        (
            joints(("left_shoulder", "left_elbow"), SHOULDER, ELBOW, unit="LeRobot unit"),
            "a robot needs radians",
        ),
    ]:
        with pytest.raises(DemonstrationError, match=says):
            end_effector_path(recording, two_arms)


def test_joints_beyond_their_limits_are_warned_of(two_arms):
    with pytest.warns(ComoveWarning, match=r"'left_elbow_joint' was recorded 1\.3 rad beyond its limits"):
        end_effector_path(joints(("left_shoulder", "left_elbow"), SHOULDER, 3.0 * ELBOW), two_arms)


def test_a_joint_below_the_arm_that_the_description_holds_must_not_move(tmp_path):
    text = f'<robot name="one"><link name="base"/>{links("", torso=True)}</robot>'
    description = {
        "models": [{"urdf": "one.urdf"}],
        "arms": {"arm": {"tip": "tip"}},
        "posture": {"torso": 0.0},
        "acceleration": 5.0,
    }
    robot = Robot.load(written(tmp_path, {"one.urdf": text}, description))
    axes = ("torso", "shoulder", "elbow_joint")
    with pytest.raises(
        DemonstrationError, match=r"recorded up to 0\.2 rad from 0, where the robot 'small' holds it"
    ):
        end_effector_path(joints(axes, TORSO, SHOULDER, ELBOW), robot)
    is_closed_form(end_effector_path(joints(axes, 0 * TORSO, SHOULDER, ELBOW), robot))
    description["posture"] = {}
    free = Robot.load(written(tmp_path, {"one.urdf": text}, description))
    path = end_effector_path(joints(axes, TORSO, SHOULDER, ELBOW), free)
    np.testing.assert_allclose(path.position[:, 2], TORSO, atol=1e-12)
