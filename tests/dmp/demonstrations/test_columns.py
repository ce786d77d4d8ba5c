"""The vocabulary of columns: names of many recorders, told apart."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.dmp.demonstrations.bodies import bodies_of, matching_body, quaternions
from comove.dmp.demonstrations.columns import Kind, read_columns
from comove.dmp.demonstrations.formats.lerobot_features import Feature


def described(names, **rows):
    """Columns as short texts: time, index, gripper, other; body:axis [unit] of the rest."""

    def one(column):
        what = column.kind.value if column.kind not in (Kind.POSITION, Kind.ORIENTATION) else ""
        text = what or f"{column.body}:{column.axis}"
        return text + (f" [{column.unit}]" if column.unit else "")

    return [one(column) for column in read_columns(names, **rows)]


@pytest.mark.parametrize(
    ("names", "found"),
    [
        ("time x y z", ["time", ":x", ":y", ":z"]),
        ("Time X Y Z", ["time", ":x", ":y", ":z"]),
        ("t px py pz", ["time", ":x", ":y", ":z"]),
        ("timestamp tx ty tz qx qy qz qw", ["time", ":x", ":y", ":z", ":qx", ":qy", ":qz", ":qw"]),
        ("x y z rx ry rz rw gripper", [":x", ":y", ":z", ":qx", ":qy", ":qz", ":qw", "gripper"]),
        ("x y z rx ry rz", [":x", ":y", ":z", ":rx", ":ry", ":rz"]),
        ("x y z roll pitch yaw", [":x", ":y", ":z", ":roll", ":pitch", ":yaw"]),
        ("ee.x ee.y ee.qw", ["ee:x", "ee:y", "ee:qw"]),
        ("left_arm_ee_pos_x left_arm_ee_quat_w", ["left_arm_ee:x", "left_arm_ee:qw"]),
        ("robot0_right_eef_pos_x robot0_right_eef_quat_x", ["robot0_right_eef:x", "robot0_right_eef:qx"]),
        (
            "%time field.header.seq field.pose.position.x field.pose.orientation.w",
            ["time", "index", ":x", ":qw"],
        ),
        ("__time /pose/position/x /left/pose/position/x", ["time", ":x", "left:x"]),
        ("left/x x_right Xpos y_position", ["left:x", "right:x", ":x", ":y"]),
        ("X1 Y1 X2", ["1:x", "1:y", "2:x"]),
        ("vx left_vel_x accel_y wx", ["other"] * 4),
        ("j1 joint_2 q[0] panda_joint3 shoulder_pan.pos", ["joint"] * 5),
        ("gripper left_gripper gripper.pos gripper_width", ["gripper"] * 4),
        ("left.x right.gripper gripper.x", ["left:x", "gripper", "gripper:x"]),
        ("time_ms t_s stamp_ns elapsed_us", ["time [ms]", "time [s]", "time [ns]", "time [us]"]),
        ("x_mm y_cm elbow_deg", [":x [mm]", ":y [cm]", "joint [deg]"]),
        ("Frame idx # seq sub_frame", ["index"] * 5),
        (
            "actual_TCP_pose_0 actual_TCP_pose_1 actual_TCP_pose_2 actual_TCP_pose_3 actual_TCP_pose_4 "
            "actual_TCP_pose_5",
            ["TCP:x", "TCP:y", "TCP:z", "TCP:rx", "TCP:ry", "TCP:rz"],
        ),
        ("pos_0 pos_1 pos_2", [":x", ":y", ":z"]),
        ("field.name0 field.position0 field.position1 field.velocity0", ["other", "joint", "joint", "other"]),
        ("p.x p.y q.x", ["p:x", "p:y", "q:x"]),
    ],
)
def test_names_of_many_recorders(names, found):
    assert described(names.split()) == found


def test_names_with_blanks_and_units():
    names = [
        "Time (Seconds)",
        "X [mm]",
        "hand Y (Meters)",
        "q[0]",
        "p_RS_R_x [m]",
        "v_RS_R_x [m s^-1]",
        "q_RS_w []",
    ]
    expected = ["time [s]", ":x [mm]", "hand:y [m]", "joint", "RS_R:x [m]", "other [m s^-1]", "RS:qw"]
    assert described(names) == expected


def test_rows_above_name_bodies_and_quantities():
    names = ["Frame", "Time (Seconds)", *"XYZWXYZ", *"XYZWXYZ", ""]
    bodies = ["", "", *["Left"] * 7, *["Right"] * 7, "Right"]
    kinds = ["", "", *(["Rotation"] * 4 + ["Position"] * 3) * 2, "Mean Marker Error"]
    columns = read_columns(names, bodies=bodies, kinds=kinds)
    found = bodies_of(columns)
    assert list(found) == ["Left", "Right"]
    assert [c.number for c in found["Right"].position] == [13, 14, 15]
    assert [c.number for c in found["Right"].orientation] == [12, 9, 10, 11]
    assert found["Left"].position[0].label == "Left.Position.X"
    assert columns[-1].kind is Kind.OTHER


def test_a_row_of_units_counts_where_names_say_none():
    assert described(["Frame", "X", "Y"], units=["", "mm", "mm"]) == ["index", ":x [mm]", ":y [mm]"]


def test_an_orientation_finds_its_position():
    names = ["p_RS_R_x", "p_RS_R_y", "p_RS_R_z", "q_RS_w", "q_RS_x", "q_RS_y", "q_RS_z"]
    (body,) = bodies_of(read_columns(names)).values()
    assert [c.name for c in body.orientation] == names[3:]


def test_repeated_names_are_not_guessed():
    (body,) = bodies_of(read_columns(["time", *"XYZWXYZ"])).values()
    assert body.is_repeated


def test_joints_have_sides_only_where_all_of_them_say_one():
    arms = bodies_of(read_columns(["left_waist", "left_gripper", "right_waist", "right_elbow"]))
    assert {name: body.axes for name, body in arms.items()} == {
        "left": ("waist",),
        "right": ("waist", "elbow"),
    }
    assert list(bodies_of(read_columns(["left_elbow", "torso_joint"]))) == [""]
    assert list(bodies_of(read_columns(["l_elbow", "r_elbow"]))) == ["left", "right"]


def test_units_of_columns_are_converted_where_they_differ():
    table = np.array([[1.0, 2.0], [3.0, 4.0]])
    (body,) = bodies_of(read_columns(["x [mm]", "y [m]"])).values()
    fields = body.samples(table)
    assert fields["unit"] == "m"
    np.testing.assert_array_equal(fields["position"], table * [1e-3, 1.0])
    (body,) = bodies_of(read_columns(["x [mm]", "y [mm]"])).values()
    fields = body.samples(table)
    assert fields["unit"] == "mm"
    np.testing.assert_array_equal(fields["position"], table)
    (body,) = bodies_of(read_columns(["x", "y [mm]"])).values()
    np.testing.assert_array_equal(body.samples(table, unit="cm")["position"], table * [1e-2, 1e-3])


@given(st.integers(0, 2**32 - 1), st.booleans())
def test_angles_and_rotation_vectors_become_quaternions(seed, degrees):
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-np.pi, np.pi, (20, 3)) * [1.0, 0.45, 1.0]
    unit, factor = ("deg", 180.0 / np.pi) if degrees else ("rad", 1.0)
    for names, expected in [
        (("roll", "pitch", "yaw"), Rotation.from_euler("xyz", angles)),
        (("rx", "ry", "rz"), Rotation.from_rotvec(angles)),
    ]:
        columns = read_columns([f"{name} [{unit}]" for name in names])
        found = Rotation.from_quat(quaternions(angles * factor, columns)[:, [1, 2, 3, 0]])
        assert (found * expected.inv()).magnitude().max() < 1e-12


def test_a_body_is_meant_in_any_case_and_by_part_of_its_name():
    bodies = ["left_arm_ee", "right_arm_ee", "Head"]
    assert matching_body("Left", bodies) == "left_arm_ee"
    assert matching_body("head", bodies) == "Head"
    assert matching_body("arm", bodies) is None
    assert matching_body("left", ["left", "left_tool"]) == "left"


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (["x", "y"], ["x", "y"]),
        ({"motors": ["a", "b"]}, ["a", "b"]),
        ({"left": ["x"], "right": ["x"]}, ["left_x", "right_x"]),
        ({"dy": 1, "dx": 0}, ["dx", "dy"]),
        (None, None),
        (["state"], None),
        ({}, None),
    ],
)
def test_names_of_lerobot_are_flattened(names, found):
    feature = {"dtype": "float32", "shape": [2], "names": names}
    assert Feature.of(Path("info.json"), {"state": feature}, "state").names == found
