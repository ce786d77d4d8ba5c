"""What is said of joints that deviate from their commands, and advice that works where it is followed."""

import json
import re

import pytest
import yaml

from comove.model import Scene
from comove.robots import Robot, verify_joints
from comove.robots.description import BUNDLED
from tests.commands import invoke
from tests.robots.known_carry import known_carry, on_scene, scene_data
from tests.robots.known_folder import write


def described(folder, joints):
    """Baxter, whose joints may deviate by so much; the path of its description."""
    path = folder / "deviating.yaml"
    text = (BUNDLED / "baxter.yaml").read_text(encoding="utf-8")
    stated = yaml.safe_dump({"uncertainty": {"joints": joints}}) if joints is not None else ""
    path.write_text(text + "\n" + stated, encoding="utf-8")
    return path


def carried(folder, joints):
    """The known movement, in a folder, by a robot whose joints may deviate by so much."""
    path = described(folder, joints)
    motion, known = known_carry()
    scene = Scene.from_dict(scene_data(robot=str(path)))
    return write(folder / "result", on_scene(motion, scene), known, Robot.load(path), path)


@pytest.fixture(scope="module")
def certified(tmp_path_factory):
    return carried(tmp_path_factory.mktemp("certified"), 0.005)


@pytest.fixture(scope="module")
def uncertified(tmp_path_factory):
    return carried(tmp_path_factory.mktemp("uncertified"), None)


def test_a_certified_deviation_is_told_and_stored(certified):
    summary = json.loads((certified / "robot.json").read_text())
    assert summary["uncertainty"] == {"position": 0.0, "rotation_deg": 0.0, "joints": 0.005}
    assert summary["hand_uncertainty"] <= summary["load_uncertainty"] < 0.03
    for verb in ("verify", "show"):
        said = invoke(verb, certified)
        assert said.exit_code == 0
        assert re.search(r"deviations of joints +certified up to 0\.005 rad", said.output)
        assert re.search(r"links where joints deviate +[\d.]+ mm from anything at least", said.output)
        assert re.search(r"load where joints deviate +off its place by 20\.5 mm at most", said.output)
    assert "the motion allows up to 0.0069 rad for all joints alike" in invoke("verify", certified).output


def test_where_none_is_stated_the_files_say_nothing_of_it(uncertified):
    summary = json.loads((uncertified / "robot.json").read_text())
    assert summary["uncertainty"] == {"position": 0.0, "rotation_deg": 0.0}
    assert not {"load_uncertainty", "clearance_deviating"} & set(summary)
    assert "deviate" not in invoke("show", uncertified).output


def test_what_verify_says_to_write_is_certified(uncertified, tmp_path):
    said = invoke("verify", uncertified).output
    (advice,) = re.findall(r"allows up to [\d.]+ rad: write uncertainty: (\{.*?\})", said)
    path = described(tmp_path, yaml.safe_load(advice)["joints"])
    assert verify_joints(Robot.load(path), *known_carry()).verified is not None


def test_more_than_a_motion_allows_is_refused_with_what_it_does(tmp_path):
    folder = carried(tmp_path, 0.02)
    refused = invoke("verify", folder)
    assert refused.exit_code == 1
    assert "joints that deviate may bring them" in refused.stderr
    (advice,) = re.findall(r"deviations of joints: .* write uncertainty: (\{.*?\})", refused.stderr)
    path = described(tmp_path, yaml.safe_load(advice)["joints"])
    assert verify_joints(Robot.load(path), *known_carry()).verified is not None


def test_send_says_that_nothing_is_proved_and_what_to_write(uncertified):
    said = invoke("send", uncertified, "--timeout", "1").stderr
    assert said.count("nothing is proved about joints that deviate") == 1
    assert "write uncertainty: {joints: 0.0069}, which the motion allows, and solve the scene again" in said


@pytest.mark.parametrize(
    ("option", "value", "told"),
    [
        ("--path-tolerance", "0.2", "0.2 is wider than 0.005"),
        ("--goal-tolerance", "0.0051", "0.0051 is wider than 0.005"),
        ("--goal-tolerance", "0", "0 leaves it to the controllers"),
        ("--start-tolerance", "0.01", "0.01 is wider than 0.005"),
    ],
)
def test_a_tolerance_wider_than_certified_is_refused(certified, option, value, told):
    refused = invoke("send", certified, option, value, "--timeout", "1")
    assert refused.exit_code == 2
    assert f"{option}: {told}" in refused.stderr
    assert "give at most 0.005" in refused.stderr
    followed = invoke("send", certified, option, "0.005", "--timeout", "1").stderr
    assert "wider" not in followed
    assert "nothing is proved" not in followed
