"""The movement that a scene names: a recording, or a primitive of a library beside the scene file."""

import re
import shlex

import numpy as np
import pytest
import yaml

from comove.dmp import DMP, Library, Primitive, learn, write_primitive
from comove.dmp import operations as op
from comove.dmp.demonstrations import Demonstration, write_csv, write_npz, write_robomimic, write_rosbag
from comove.errors import SceneError
from comove.model import Scene, demonstration_of, recording_of
from comove.model.demonstration import fitted
from comove.robots import Robot, end_effector_path
from tests.commands import invoke

PLANAR = {
    "name": "taught",
    "duration": 5.0,
    "workspace": {"lower": [0, 0], "upper": [1, 1]},
    "manipulators": [{"name": "hand", "start": [0.1, 0.5], "goal": [0.9, 0.5]}],
}
SPATIAL = {
    **PLANAR,
    "workspace": {"lower": [0, 0, 0], "upper": [1, 1, 1]},
    "manipulators": [{"name": "hand", "start": [0.1, 0.5, 0.5], "goal": [0.9, 0.5, 0.5]}],
}
SINE = learn(Demonstration.from_lasa("Sine"), name="Sine")


@pytest.fixture
def folder(tmp_path):
    Library(tmp_path / "library").add(SINE)
    Library(tmp_path / "mine" / "inner").add(SINE, "wave")
    cycle = DMP(np.ones((2, 5)), *np.zeros((4, 2)), 1.0, variant="rhythmic")
    Library(tmp_path / "library").add(Primitive("cycle", cycle))
    return tmp_path


def scene(folder, source, data=PLANAR):
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump({**data, "demonstration": source}))
    return Scene.load(path)


@pytest.mark.parametrize("name", ["Sine", "library/Sine", "mine/inner/wave"])
def test_a_primitive_comes_as_it_lies_there(folder, name):
    loaded = scene(folder, {"library": name})
    assert recording_of(loaded) is None
    assert np.array_equal(demonstration_of(loaded).weights, SINE.dmp.weights)
    assert (demonstration_of(loaded).duration, demonstration_of(loaded).phase) == (
        SINE.dmp.duration,
        SINE.dmp.phase,
    )


def test_joints_are_no_path_of_a_hand(folder):
    """Neither as a recording, nor as a primitive, nor as an argument."""
    share = np.linspace(0.0, 1.0, 30)
    for unit, axes in (("rad", ("a", "b")), ("deg", ("a", "b")), ("LeRobot unit", ("a.pos", "b.pos"))):
        joints = Demonstration(3 * share, np.outer(share, [0.5, 1.0]), "arm", unit=unit, axes=axes)
        Library(folder / "library").add(learn(joints, name="arm"), replace=True)
        write_npz(folder / "arm.npz", joints)
        for source in ({"library": "arm"}, {"file": "arm.npz"}):
            with pytest.raises(SceneError, match=r"joints in .*, which is no path.*--robot ROBOT"):
                demonstration_of(scene(folder, source))
        with pytest.raises(SceneError, match="movement of joints"):
            fitted(scene(folder, None), joints)


@pytest.mark.slow
def test_the_joints_of_a_robot_become_a_path_by_the_printed_command(folder):
    words = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
    share = np.linspace(0.0, 1.0, 40)
    joints = Demonstration(2 * share, np.outer(share, [0.3, -0.2, 0.4, 0.5, 0.1]), unit="rad", axes=words)
    write_csv(folder / "arm.csv", joints)
    source = {"file": "arm.csv", "robot": "two_so101", "arm": "left"}
    with pytest.raises(SceneError, match=r"no path of an end effector") as caught:
        scene(folder, source, SPATIAL)
    _, command, keys = re.split("run: comove |, and write ", caught.value.way_out)
    assert invoke(*shlex.split(command), folder=folder).exit_code == 0
    path = end_effector_path(joints, Robot.load("two_so101"), "left")
    taught = demonstration_of(scene(folder, yaml.safe_load(keys), SPATIAL))
    assert np.allclose(taught.goal[:3], path.goal, atol=1e-9)


def test_recordings_are_fitted_as_before(folder):
    loaded = scene(folder, {"lasa": "Sine"})
    assert recording_of(loaded).name == "Sine 0"
    assert np.array_equal(demonstration_of(loaded).weights, DMP.fit(Demonstration.from_lasa("Sine")).weights)
    assert demonstration_of(scene(folder, None)) is None


def test_plane_and_scale(folder):
    loaded = scene(folder, {"library": "Sine", "plane": "xz", "scale": 0.01}, SPATIAL)
    played = demonstration_of(loaded).rollout().position
    assert np.allclose(played[:, [0, 2]], 0.01 * SINE.dmp.rollout().position, atol=1e-12)
    assert not played[:, 1].any()
    recorded = (
        demonstration_of(scene(folder, {"lasa": "Sine", "plane": "xz", "scale": 0.01}, SPATIAL))
        .rollout()
        .position
    )
    assert np.abs(played - recorded).max() < 1e-9


@pytest.mark.parametrize(
    ("source", "data", "message"),
    [
        ({"library": "Sinus"}, PLANAR, "no primitive 'Sinus'; did you mean 'Sine'"),
        ({"library": "none/Sine"}, PLANAR, "library is empty"),
        ({"library": "../library/Sine"}, PLANAR, "lies outside the scene's folder"),
        ({"library": "mine/../../x/Sine"}, PLANAR, "lies outside"),
        ({"library": "/library/Sine"}, PLANAR, "lies outside"),
        ({"library": "away/Sine"}, PLANAR, "lies outside"),
        ({"library": "a\0b/Sine"}, PLANAR, "lies outside"),
        ({"library": ""}, PLANAR, "cannot name a primitive"),
        ({"library": ".."}, PLANAR, "lies outside"),
        ({"library": "cycle"}, PLANAR, "rhythmic and never ends"),
        ({"library": "Sine"}, SPATIAL, "2 dimensions, the scene 3; add `plane: xy`"),
        ({"library": "Sine", "plane": "xy"}, PLANAR, None),
    ],
)
def test_what_is_not_there_or_does_not_fit(folder, source, data, message):
    (folder / "away").symlink_to(folder.parent)
    loaded = scene(folder, source, data)
    if message is None:
        assert demonstration_of(loaded) is not None
        return
    with pytest.raises(SceneError) as caught:
        demonstration_of(loaded)
    assert caught.value.key == "demonstration.library"
    assert message in str(caught.value)
    assert str(folder / "scene.yaml") in str(caught.value)


def test_a_damaged_primitive_is_named(folder):
    path = folder / "library" / "Sine.dmp.json"
    path.write_text(path.read_text()[:-50])
    with pytest.raises(SceneError, match=r"Sine\.dmp\.json.*breaks off"):
        demonstration_of(scene(folder, {"library": "Sine"}))


def test_a_pose_lends_its_positions(folder):
    time = np.linspace(0, 2, 101)
    half = 0.3 * time
    orientation = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    position = np.stack([time, np.sin(time), 0 * time], axis=1)
    turn = learn(Demonstration(time, position, orientation=orientation), name="turn", poses=True)
    Library(folder / "library").add(turn)
    taught = demonstration_of(scene(folder, {"library": "turn"}, SPATIAL))
    assert np.array_equal(taught.weights, op.settled(turn.dmp.translation).weights)


def test_checksums_of_scenes_stay():
    """The place of the library in the model does not change what other scenes are."""
    assert Scene.from_dict(PLANAR).sha256 == Scene.from_dict({**PLANAR, "demonstration": None}).sha256


def test_a_recording_of_a_file_that_holds_several(folder):
    """By episode and manipulator of a data set, by topic of a bag."""
    time = np.linspace(0, 2, 41)
    hands = {
        name: Demonstration(time, np.outer(time, [0.1, size, 0.2]))
        for name, size in (("left", 0.1), ("right", 0.2))
    }
    write_robomimic(folder / "many.hdf5", [hands, {name: hands["left"] for name in hands}])
    write_rosbag(folder / "hands.mcap", hands)
    chosen = recording_of(
        scene(folder, {"file": "many.hdf5", "episode": 1, "manipulator": "robot1"}, SPATIAL)
    )
    assert np.array_equal(chosen.position, hands["left"].position)
    chosen = recording_of(scene(folder, {"file": "hands.mcap", "topic": "/right/point"}, SPATIAL))
    assert np.array_equal(chosen.position, hands["right"].position)
    with pytest.raises(SceneError, match="it holds 2 episodes"):
        recording_of(scene(folder, {"file": "many.hdf5", "manipulator": "robot1"}, SPATIAL))
    with pytest.raises(SceneError, match="episode 1 belongs to a file"):
        scene(folder, {"lasa": "Angle", "episode": 1})


SECONDS = np.arange(101) / 50.0
HAND = np.column_stack((0.3 * SECONDS, 0.1 * np.sin(SECONDS)))
PAIR = {
    **PLANAR,
    "manipulators": [
        {"name": "left", "start": [0.1, 0.5], "goal": [0.7, 0.5]},
        {"name": "right", "start": [0.1, 0.7], "goal": [0.7, 0.7]},
    ],
}


def table(folder, header, *columns, separator=","):
    rows = "".join(separator.join(f"{x:.9g}" for x in row) + "\n" for row in np.column_stack(columns))
    (folder / "hand.csv").write_text(header + "\n" + rows)
    return "hand.csv"


def test_a_scene_says_how_its_recording_is_read(folder):
    name = table(folder, "n;u;v", np.arange(101), 1e3 * HAND, separator=";")
    keys = {"file": name, "unit": "mm", "columns": ["u", 3], "delimiter": ";", "rate": 50}
    loaded = scene(folder, keys)
    recording = recording_of(loaded)
    np.testing.assert_allclose(recording.position, HAND, atol=1e-9)
    np.testing.assert_allclose(recording.time, SECONDS, atol=1e-9)
    assert isinstance(demonstration_of(loaded), DMP)
    loaded = scene(
        folder, {"file": name, "unit": "mm", "columns": ["u", "v"], "time": "n [ms]", "clean": False}
    )
    np.testing.assert_allclose(recording_of(loaded).time, np.arange(101) / 1e3)
    cleaned = scene(folder, keys | {"clean": True})
    assert recording_of(cleaned).notes != recording.notes


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({}, "write below demonstration: columns: "),
        ({"columns": ["u", "v"]}, "write below demonstration: rate: HZ"),
        ({"columns": ["u", "v"], "rate": 50, "unit": "deg", "topic": "/x"}, "only bags have topics"),
        ({"columns": ["u", "v"], "rate": 50, "unit": "parsec"}, "'parsec' is not known"),
        ({"columns": ["u", "v"], "rate": 50, "dataset": "obs"}, "no such option"),
    ],
)
def test_what_a_scene_has_to_say_is_told_in_its_keys(folder, keys, words):
    name = table(folder, "n;u;v", np.arange(101), 1e3 * HAND, separator=";")
    with pytest.raises(SceneError, match=words) as caught:
        demonstration_of(scene(folder, {"file": name, **keys}))
    assert "--" not in caught.value.way_out


def test_the_keys_that_a_refusal_names_lead_to_the_movement(folder):
    name = table(folder, "left_x,left_y,right_x,right_y", HAND, HAND + 1)
    source = {"file": name}
    for _ in range(4):
        try:
            movement = demonstration_of(scene(folder, source))
            break
        except SceneError as error:
            keys = error.way_out.partition("below demonstration: ")[2].replace("HZ", "100")
            source |= yaml.safe_load(keys.replace("; ", "\n"))
    assert source == {"file": name, "manipulator": "left", "rate": 100}
    assert np.allclose(movement.goal, HAND[-1])


@pytest.mark.parametrize("key", ["unit", "columns", "rate", "clean", "drop_missing"])
def test_keys_of_reading_need_a_file(folder, key):
    value = {"unit": "mm", "columns": ["x"], "rate": 50, "clean": True, "drop_missing": True}[key]
    with pytest.raises(SceneError, match=f"{key} .* belongs to a file"):
        scene(folder, {"lasa": "Sine", key: value})


def test_what_was_learned_is_named_by_its_file(folder):
    write_primitive(folder / "taught.json", SINE)
    loaded = scene(folder, {"file": "taught.json"})
    assert recording_of(loaded) is None
    assert np.array_equal(demonstration_of(loaded).weights, SINE.dmp.weights)
    laid = scene(folder, {"file": "taught.json", "plane": "xz", "scale": 0.01}, SPATIAL)
    played = demonstration_of(laid).rollout().position
    assert np.allclose(played[:, [0, 2]], 0.01 * SINE.dmp.rollout().position, atol=1e-12)
    with pytest.raises(
        SceneError, match=r"unit 'mm' belongs to a recording, and taught\.json is a primitive"
    ):
        demonstration_of(scene(folder, {"file": "taught.json", "unit": "mm"}))
    joints = Demonstration(SECONDS, HAND, unit="rad", axes=("a", "b"))
    write_primitive(folder / "taught.json", learn(joints, name="arm"))
    with pytest.raises(SceneError, match="movement of joints in rad"):
        demonstration_of(scene(folder, {"file": "taught.json"}))
    (folder / "taught.json").write_bytes((folder / "taught.json").read_bytes().replace(b"arm", b"leg"))
    with pytest.raises(SceneError, match="checksum"):
        demonstration_of(scene(folder, {"file": "taught.json"}))


@pytest.mark.parametrize("names", [("left", "right"), ("Left Hand", "Right Hand"), ("right_arm", "left_arm")])
def test_each_hand_follows_its_body_of_a_tracker(folder, names):
    header = ",".join(["time", *(f"{name} {axis}" for name in names for axis in "XY")])
    name = table(folder, header, SECONDS, HAND, HAND * [1, -1])
    left, right = demonstration_of(scene(folder, {"file": name}, PAIR))
    sign = 1 if names[0].lower().startswith("left") else -1
    assert np.allclose(left.goal, HAND[-1] * [1, sign]) and np.allclose(right.goal, HAND[-1] * [1, -sign])


def test_a_fault_in_one_of_two_hands_is_told(folder):
    name = table(folder, "time,left_x,left_y,right_x,right_y", SECONDS, HAND, HAND)
    lines = (folder / name).read_text().splitlines()
    lines[40] = lines[40].rpartition(",")[0] + ","
    (folder / name).write_text("\n".join(lines) + "\n")
    with pytest.raises(SceneError, match="row 41, column right_y: the cell is empty"):
        demonstration_of(scene(folder, {"file": name}, PAIR))


def test_coordinates_in_another_order_are_those_of_the_scene(folder):
    name = table(folder, "time,y [m],x [m]", SECONDS, HAND[:, ::-1])
    recording = recording_of(scene(folder, {"file": name}))
    np.testing.assert_allclose(recording.position, HAND, atol=1e-9)
