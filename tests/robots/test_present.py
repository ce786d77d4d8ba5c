"""Present joints: what is read, what is refused and in which words, and that starts near them are preferred."""

import json
import math

import numpy as np
import pytest

import comove
from comove.errors import OptionError, RobotError
from comove.robots import RobotCarrier
from comove.robots.present import present_joints, read_present, stored_present
from tests.robots.small_robots import lifts_scene, robot


def named(name="lifts"):
    machine = robot(name)
    return dict(zip(machine.joint_names, machine.home.tolist(), strict=True))


def test_joints_are_read_by_name_in_any_order():
    machine, given = robot("lifts"), named()
    backwards = dict(reversed(given.items()))
    assert (present_joints(backwards, machine) == machine.home).all()
    assert (present_joints(None, machine) == machine.home).all()
    assert (present_joints(machine.home + 0.1, machine) == machine.home + 0.1).all()


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (
            {"left_elbow_joint": 45.0},
            "present.left_elbow_joint: it is 45 rad, .*: degrees, it seems; .*0.785398",
        ),
        ({"left_elbow_joint": 2.7}, "it is 2.7 rad, outside its limits; give a value between -2.6 and 2.6"),
        ({"left_lift_joint": 700}, "it is 700 m, outside its limits: millimetres, it seems; .*: 0.7 for"),
        ({"left_lift_joint": math.nan}, "present.left_lift_joint: it is nan; give a finite number"),
        ({"left_lift_joint": "0.3"}, "it is '0.3'; give a finite number"),
        ({"left_lift_joint": True}, "it is True; give a finite number"),
        ({"left_lift_joint": None, "right_lift_joint": None}, None),
        ({3: 0.3}, "'small' has no joint '3'"),
        ({"left_elbow": 0.3}, "'small' has no joint 'left_elbow'; did you mean 'left_elbow_joint'"),
    ],
)
def test_what_are_no_joints_of_the_robot_is_refused(changes, told):
    given = named() | changes
    if told is None:
        given = {name: value for name, value in given.items() if value is not None}
        told = "left_lift_joint, right_lift_joint of 'small' are missing; give a value for each joint of all arms"
    with pytest.raises(RobotError, match=told):
        present_joints(given, robot("lifts"))


def test_degrees_become_what_is_advised():
    advised = {"left_elbow_joint": float(f"{math.radians(45.0):.6g}")}
    assert present_joints(named() | advised, robot("lifts"))[2] == pytest.approx(math.pi / 4, abs=1e-6)


@pytest.mark.parametrize("array", [np.zeros(7), np.zeros((8, 1)), ["0"] * 8, [[0], [0, 0]], "home", 3])
def test_arrays_of_another_shape_are_refused(array):
    with pytest.raises(RobotError, match=r"present: it is an array of .*'small' has 8 joints"):
        present_joints(array, robot("lifts"))


def test_joints_of_grippers_may_be_there_and_locked_ones_where_they_are_locked(tmp_path):
    """As /joint_states of a PR2 has them."""
    machine, file = robot("pr2"), tmp_path / "state.json"
    given = named("pr2") | {"l_gripper_l_finger_joint": 0.5, "torso_lift_joint": 0.0}
    given["torso_lift_joint"] = machine.description.posture["torso_lift_joint"]
    file.write_text(json.dumps({"name": [*given], "position": [*given.values()], "effort": []}))
    assert read_present(file, machine) == named("pr2")
    given["torso_lift_joint"] = 0.3
    file.write_text(json.dumps(given))
    with pytest.raises(
        RobotError, match=r"state.json: present.torso_lift_joint: it is 0.3, .*posture: {torso_lift"
    ):
        read_present(file, machine)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("name: [a, b]\nposition: [1.0]\n", "position: name and position are not two lists of one length"),
        ("name: [a, a]\nposition: [1.0, 2.0]\n", "name: 'a' is there twice"),
    ],
)
def test_joint_states_that_are_none_are_refused(tmp_path, text, told):
    file = tmp_path / "state.yaml"
    file.write_text(text)
    with pytest.raises(RobotError, match=f"state.yaml: {told}"):
        read_present(file, robot("lifts"))


def test_a_stored_folder_tells_where_its_approach_begins(tmp_path):
    machine, file = robot("lifts"), tmp_path / "robot.json"
    for told, right in ((None, None), (named(), machine.home)):
        file.write_text(json.dumps({"present": told}))
        assert np.array_equal(stored_present(tmp_path, machine), right)
    for wrong in ([0.1], named() | {"left_lift_joint": 7.0}, {}):
        file.write_text(json.dumps({"present": wrong}))
        with pytest.raises(RobotError, match=r"robot.json: present"):
            stored_present(tmp_path, machine)


def test_of_two_elbows_the_one_near_the_present_joints_is_taken():
    scene, machine = lifts_scene(), robot("lifts")
    ways = [np.concatenate(q) for q in zip(*RobotCarrier(machine, scene).starts, strict=True)]
    assert len(ways) == 2
    for near in ways:
        shifted = near + np.tile([0.1, 0.05, 0.0, 0.0], 2)
        found = comove.solve(scene, robot=machine, present=shifted, budget=20.0)
        assert found.verified and np.abs(found.joints.attempt.position[0] - near).max() < 1e-6
        assert (found.joints.present == shifted).all()


def test_who_holds_the_payload_already_approaches_nothing():
    scene, machine = lifts_scene(), robot("lifts")
    begin = np.concatenate([starts[-1] for starts in RobotCarrier(machine, scene).starts])
    held = comove.solve(scene, robot=machine, begin=begin, budget=20.0).joints.attempt.position[0]
    np.testing.assert_allclose(held, begin, atol=1e-6)
    for more in ({"approach": True}, {"present": machine.home}):
        with pytest.raises(OptionError, match="begin: the robot holds the load already"):
            comove.solve(scene, robot=machine, begin=begin, **more)
    with pytest.raises(RobotError, match=r"begin\.left_elbow_joint: it is 2.7 rad, outside"):
        comove.solve(scene, robot=machine, begin=begin + np.array([0, 0, 2.7 - begin[2], 0, 0, 0, 0, 0]))
