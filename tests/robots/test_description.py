"""Descriptions of robots: which are found, what they say, and how mistakes in them are told."""

import re
from pathlib import Path

import pytest
import yaml

from comove.errors import RobotError
from comove.robots import bundled_robots, description, find_description
from comove.robots.description import (
    ArmDescription,
    GripperDescription,
    GripperShape,
    JointLimits,
    ModelSource,
    RobotFile,
    Servo,
    Uncertainty,
    load_description,
)
from tests.robots.small_robots import BUNDLED

GOOD = "name: r\nmodels: [{urdf: r.urdf}]\narms: {left: {tip: hand}}\n"


def told(action, *arguments):
    """What an action says is wrong, in one sentence."""
    with pytest.raises(RobotError) as caught:
        action(*arguments)
    message = str(caught.value)
    assert "\n" not in message
    assert "pydantic" not in message
    return message


def loaded(tmp_path, text):
    path = tmp_path / "robot.yaml"
    path.write_text(text, encoding="utf-8")
    return load_description(path)


@pytest.mark.parametrize("name", bundled_robots())
def test_bundled_descriptions_are_found_by_name_and_have_homes(name):
    file = load_description(find_description(name))
    assert file.name == name
    assert all(arm.home is not None for arm in file.arms.values())


def test_the_bundled_robots_are_those_of_the_examples():
    assert bundled_robots() == BUNDLED


def test_descriptions_are_found_by_path_and_beside_a_scene(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(GOOD, encoding="utf-8")
    assert find_description(path) == path
    assert find_description("mine.yaml", tmp_path) == path
    assert find_description(str(path), tmp_path / "elsewhere") == path


@pytest.mark.parametrize("name", ["baxtr", "no/such.yaml", "x" * 5000, "a\0b", "."])
def test_a_robot_that_is_not_there_is_told_with_those_that_are(name, tmp_path):
    message = told(find_description, name, tmp_path)
    assert f"known: {', '.join(BUNDLED)}" in message
    assert ("did you mean 'baxter'?" in message) == (name == "baxtr")


def test_the_least_that_a_description_says_fills_in_the_rest(tmp_path):
    file = loaded(tmp_path, GOOD)
    assert file.arms["left"].tool.position == (0.0, 0.0, 0.0)
    assert file.models[0].base.quaternion_wxyz == (1.0, 0.0, 0.0, 0.0)
    assert (file.acceleration, file.posture, file.servo) == (5.0, {}, None)


def test_the_example_of_the_module_is_a_description():
    (text,) = re.findall(r"```yaml\n(.*?)```", description.__doc__, re.DOTALL)
    file = RobotFile.model_validate(yaml.safe_load(text))
    assert set(yaml.safe_load(text)) == set(RobotFile.model_fields)  # every key is shown
    assert set(file.arms) == {"left", "right"}


def test_the_page_for_users_shows_a_description_and_every_key():
    page = (Path(__file__).parents[2] / "docs" / "robots.md").read_text(encoding="utf-8")
    files = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    names = [RobotFile.model_validate(yaml.safe_load(text)).name for text in files if "arms:" in text]
    assert names == ["two_pandas", "held"]
    keys = set(re.findall(r"^\| (?:· )?`(\w+)`", page, re.MULTILINE))
    keys |= set(re.findall(r"`(\w+)`", "".join(re.findall(r"^\|.*", page, re.MULTILINE))))
    for part in (RobotFile, ModelSource, ArmDescription, GripperDescription, GripperShape):
        assert set(part.model_fields) <= keys
    assert all(key in page for part in (JointLimits, Servo, Uncertainty) for key in part.model_fields)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("name: [", ["line 2", "not YAML"]),
        ("", ["empty"]),
        ("- a", ["a list, not a mapping"]),
        (GOOD + "name: again\n", ["'name' is given twice", "in line 1 and in line 4"]),
        (GOOD + "armz: 1\n", ["armz (line 4)", "did you mean 'arms'?"]),
        (GOOD.replace("hand}", "hand, hoem: [0]}"), ["arms.left.hoem", "did you mean 'home'?"]),
        (GOOD.replace("hand}", "hand, tool: {positon: [0, 0, 0]}}"), ["arms.left.tool.positon", "'position'?"]),
        (GOOD.replace("r.urdf}", "r.urdf, base: {quaternion: 1}}"), ["models[0].base", "'quaternion_wxyz'?"]),
        (GOOD + "limits: {j: {lowr: 1}}\n", ["limits.j.lowr (line 4)", "did you mean 'lower'?"]),
        (GOOD + "servo: {stifness: [1]}\n", ["servo.stifness", "did you mean 'stiffness'?"]),
        (GOOD + "uncertainty: {rotation: 1}\n", ["uncertainty.rotation", "did you mean 'rotation_deg'?"]),
        (GOOD.replace("tip: hand", ""), ["arms.left", "'tip' is missing"]),
        (GOOD.replace("name: r\n", ""), ["'name' is missing", "required here: name, models, arms"]),
        (GOOD.replace("name: r\n", "name: a/b\n"), ["name (line 1)", "'a/b' cannot name a file"]),
        (GOOD.replace("[{urdf: r.urdf}]", "[]"), ["models (line 2)", "write at least 1 model"]),
        (GOOD.replace("[{urdf: r.urdf}]", "r.urdf"), ["models (line 2)", "'r.urdf' is not a list"]),
        (GOOD.replace("{left: {tip: hand}}", "[left]"), ["arms (line 3)", "is not a mapping"]),
        (GOOD.replace("left:", "'a b':"), ["arms.'a b'", "contains a point or a blank"]),
        (GOOD.replace("{tip: hand}", "hand"), ["arms.left", "'hand' is not a mapping"]),
        (GOOD.replace("hand}", "hand, home: 3}"), ["arms.left.home", "3 is not a list"]),
        (GOOD.replace("hand}", "hand, home: [0, .nan]}"), ["arms.left.home[1]", "nan is not a finite number"]),
        (GOOD.replace("hand}", "hand, home: [0, '1']}"), ["arms.left.home[1]", "'1' is not a number"]),
        (GOOD.replace("r.urdf}", "r.urdf, base: {position: [0, 0]}}"), ["position", "has 2 numbers", "x, y, z"]),
        (GOOD.replace("hand}", "hand, tool: {quaternion_wxyz: [1, 1, 0, 0]}}"), ["has the norm 1.41421", "w first"]),
        (GOOD.replace("r.urdf}", "r.urdf, prefix: 'a b'}"), ["models[0].prefix", "'a b' cannot begin names"]),
        (GOOD.replace("r.urdf}", "r.urdf, prefix: '<\"&'}"), ["models[0].prefix", "cannot begin names"]),
        (GOOD + "acceleration: 0\n", ["acceleration (line 4)", "0 is out of range", "greater than 0"]),
        (GOOD + "acceleration: fast\n", ["acceleration (line 4)", "'fast' is not a number"]),
        (GOOD + "limits: {j: {velocity: -1}}\n", ["limits.j.velocity", "-1 is out of range"]),
        (GOOD + "springs: {j: 1.5}\n", ["springs.j", "1.5 is out of range", "not greater than 1"]),
        (GOOD + "posture: {j: true}\n", ["posture.j", "true is not a number"]),
        (GOOD + "servo: {stiffness: [100, 0]}\n", ["servo.stiffness[1]", "greater than 0"]),
        (GOOD + "uncertainty: {position: -1}\n", ["uncertainty.position", "not less than 0"]),
        (GOOD + "uncertainty: {joints: -0.1}\n", ["uncertainty.joints (line 4)", "-0.1 is out of", "greater than 0"]),
        (GOOD + "uncertainty: {joints: 0}\n", ["uncertainty.joints (line 4)", "0 is out of", "greater than 0"]),
        (GOOD + "uncertainty: {joints: .nan}\n", ["uncertainty.joints (line 4)", "nan is not a finite number"]),
        (GOOD + "uncertainty: {joints: wide}\n", ["uncertainty.joints (line 4)", "'wide' is not a number"]),
        (GOOD + "uncertainty: {joints: [0.1]}\n", ["uncertainty.joints (line 4)", "[0.1] is not a number"]),
        (GOOD + "uncertainty: {joints: {j: -1}}\n", ["uncertainty.joints.j", "-1 is out of", "greater than 0"]),
        (GOOD + "uncertainty: {joints: {j: .inf}}\n", ["uncertainty.joints.j", "inf is not a finite number"]),
    ],
)  # fmt: skip
def test_a_mistake_is_told_with_file_key_line_value_and_way_out(text, parts, tmp_path):
    message = told(loaded, tmp_path, text)
    assert str(tmp_path / "robot.yaml") in message
    for part in parts:
        assert part in message
    assert "; " in message


def test_several_mistakes_are_told_together(tmp_path):
    with pytest.raises(RobotError) as caught:
        loaded(tmp_path, GOOD + "acceleration: x\nspringz: {}\nservo: 3\n")
    lines = str(caught.value).split("\n")
    assert [line.strip().split(" ")[0] for line in lines[1:]] == ["acceleration", "springz", "servo"]


@pytest.mark.parametrize(
    ("stated", "deviations"),
    [("", [0.0, 0.0]), ("joints: 0.01", [0.01, 0.01]), ("joints: {b: 0.02, a: 0.01}", [0.01, 0.02])],
)
def test_deviations_of_joints_are_those_of_all_or_of_each(stated, deviations, tmp_path):
    uncertainty = loaded(tmp_path, GOOD + f"uncertainty: {{{stated}}}\n").uncertainty
    assert uncertainty.deviations(["a", "b"]).tolist() == deviations
    assert ("joints" in uncertainty.model_dump()) == bool(stated)  # so that others keep their checksums
