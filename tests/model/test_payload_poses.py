"""Payloads whose poses a scene gives: end effectors go with them, whichever way they turn."""

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.errors import SceneError
from comove.model import Scene
from comove.model.files.keys import canonical
from comove.model.files.reading import parse_scene
from comove.model.groups import GroupPose

BAR = {"shape": "bar", "length": 0.4}
BOX = {"shape": "box", "size": [0.4, 0.2, 0.05]}
ENDS = {"left": [-0.2, 0.0, 0.0], "right": [0.2, 0.0, 0.0]}
ROTATIONS = st.integers(0, 10**6).map(lambda seed: Rotation.random(random_state=seed))
LEVEL = Rotation.identity()


def wxyz(turn):
    return np.roll(turn.as_quat(), 1).tolist()


def scene_data(load=BOX, grasps=ENDS, turns=(LEVEL, LEVEL), frames=None, **more):
    """The contents of a scene file: a payload that goes from one place to another, turned as given."""
    places = [0.0, 0.0, 0.5], [0.1, 0.2, 0.6]
    poses = dict(zip(("start", "goal"), zip(places, turns, strict=True), strict=True))
    load = dict(load) | ({"grasps": dict(grasps)} if "grasps" not in load and load["shape"] != "bar" else {})
    load |= {end: {"position": p, "quaternion_wxyz": wxyz(turn)} for end, (p, turn) in poses.items()}
    frames = (
        {name: Rotation.from_euler("x", 180, degrees=True) for name in grasps} if frames is None else frames
    )
    return {
        "name": "tilted",
        "duration": 5.0,
        "workspace": {"lower": [-1, -1, 0], "upper": [1, 1, 1]},
        "load": load,
        "grasp": {"frames": {name: wxyz(frame) for name, frame in frames.items()}},
        "manipulators": [
            {"name": name} | {end: (np.array(p) + turn.apply(r)).tolist() for end, (p, turn) in poses.items()}
            for name, r in grasps.items()
        ],
    } | more


def placed(scene, turn):
    """The nodes of a scene's payload, turned about a place."""
    nodes = np.zeros((scene.body.n_nodes, 3))
    nodes[scene.nodes_of_groups[0]] = GroupPose(np.array([0.1, 0.2, 0.3]), turn.as_matrix()).place(
        scene.groups[0].points
    )
    return nodes


def refused(data):
    with pytest.raises(SceneError) as told:
        Scene.from_dict(data, check_ends=False)
    return str(told.value)


@given(start=ROTATIONS, turn=ROTATIONS, frame=ROTATIONS, twist=st.integers(0, 10**6))
def test_grasp_frames_turn_with_the_payload_in_any_way(start, turn, frame, twist):
    """Of a box, of a bar, whose nodes are on one line, and of a payload in one hand alone."""
    w = np.random.default_rng(twist).standard_normal((3, 4))
    one = {"only": [0.1, 0.0, 0.02]}
    for load, grasps in ((BOX, ENDS), (BAR, ENDS), (BOX, one)):
        frames = {name: frame * Rotation.from_euler("z", k) for k, name in enumerate(grasps)}
        scene = Scene.from_dict(scene_data(load, grasps, (start, LEVEL), frames), check_ends=False)
        nodes = placed(scene, turn)
        wanted = [(turn * own).as_matrix() for own in frames.values()]
        np.testing.assert_allclose(scene.grasp.hand_rotations(nodes), wanted, atol=1e-12)
        velocities = np.cross(w.T[:, None], nodes).transpose(1, 2, 0) + np.array([0.3, 0.1, -0.2, 0.5])
        np.testing.assert_allclose(scene.grasp.spins(nodes, velocities), w, atol=1e-11)
        np.testing.assert_allclose(
            scene.grasp.hand_rotations(scene.nodes_at("start"))[0],
            (start * frames[next(iter(grasps))]).as_matrix(),
            atol=1e-12,
        )


def test_the_point_that_tells_how_a_bar_is_turned_is_no_part_of_it():
    data = scene_data(BAR)
    data["load"]["goal"] = data["load"]["start"]
    for hand in data["manipulators"]:
        hand["goal"] = hand["start"]
    scene, bare = Scene.from_dict(data), dict(data)
    del bare["grasp"]
    plain = Scene.from_dict(bare)
    (extra,) = set(range(scene.body.n_nodes)) - set(range(plain.body.n_nodes))
    there = scene.nodes_at("start")[extra]
    ball = {"shape": "sphere", "center": there.tolist(), "radius": 0.05}
    for own in (scene, plain):
        met = Scene.from_dict(own.file.model_dump() | {"obstacles": [ball]})
        assert met.nearest_at(met.nodes_at("start"))[0] == pytest.approx(0.05, abs=1e-9)
    hands = np.concatenate([plain.start, plain.goal])
    tight = {"lower": (hands.min(axis=0) - 0.02).tolist(), "upper": (hands.max(axis=0) + 0.02).tolist()}
    assert not ((tight["lower"] < there) & (there < tight["upper"])).all()
    Scene.from_dict(scene.file.model_dump() | {"workspace": tight})


def test_end_effectors_off_the_payload_are_refused_and_the_advice_mends_it():
    data = scene_data(turns=(LEVEL, Rotation.from_euler("y", 30, degrees=True)))
    right = data["manipulators"][1]
    right["goal"] = (np.array(right["goal"]) + [0.0, 2e-4, 0.0]).tolist()
    told = refused(data)
    assert "0.0002 m" in told
    assert "load.goal" in told
    written = told.split("manipulators[1].goal: ")[1].split("]")[0] + "]"
    right["goal"] = [float(x) for x in written.strip("[]").split(",")]
    scene = Scene.from_dict(data)
    np.testing.assert_allclose(scene.goal[1], right["goal"], atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"load": {**BOX, "start": {"position": [0, 0, 0.5]}}}, "add load.goal"),
        ({"load": {**BOX, "grasps": ENDS}}, "add load.start and load.goal"),
        ({"grasp": {"orientation": "down"}}, "give grasp.frames"),
        ({"grasp": {"frames": {"left": [1, 0, 0, 0]}}}, "give one to each manipulator"),
        ({"grasp": {"frames": {"left": [1, 0, 0, 0], "wrong": [1, 0, 0, 0]}}}, "no manipulator 'wrong'"),
        ({"grasp": {"frames": {"left": [1, 0, 0, 0]}, "orientation": "down"}}, "give frames alone"),
        ({"grasp": {"frames": {"left": [1, 0, 0, 0.5], "right": [1, 0, 0, 0]}}}, "unit quaternion"),
    ],
)
def test_what_contradicts_itself_is_told(changes, words):
    assert words in refused(scene_data() | changes)


def test_a_planar_payload_turns_in_the_plane():
    turn = Rotation.from_euler("z", 90, degrees=True)
    data = {
        "name": "planar",
        "duration": 5.0,
        "workspace": {"lower": [0, 0], "upper": [1, 1]},
        "load": {
            "shape": "box",
            "size": [0.2, 0.1],
            "start": {"position": [0.3, 0.3]},
            "goal": {"position": [0.7, 0.7], "quaternion_wxyz": wxyz(turn)},
        },
        "manipulators": [{"name": "a", "start": [0.2, 0.3], "goal": [0.7, 0.6]}],
    }
    scene = Scene.from_dict(data)
    np.testing.assert_allclose(scene.groups[0].goal.rotation, turn.as_matrix(), atol=1e-12)
    data["load"]["goal"]["quaternion_wxyz"] = wxyz(Rotation.from_euler("x", 90, degrees=True))
    assert "turns out of the plane" in refused(data)


def test_upright_keeps_the_tilt_of_the_start():
    tilted = Rotation.from_euler("x", 25, degrees=True)
    turned = Rotation.from_euler("z", 40, degrees=True) * tilted
    upright = [{"type": "upright"}]
    scene = Scene.from_dict(scene_data(turns=(tilted, turned), constraints=upright))
    assert scene.groups[0].orientation == "vertical"
    for end, turn in (("start", tilted), ("goal", turned)):
        wanted = turn * Rotation.from_euler("x", 180, degrees=True)
        np.testing.assert_allclose(
            scene.grasp.hand_rotations(scene.nodes_at(end))[0], wanted.as_matrix(), atol=1e-12
        )
    assert "tilted by 25 deg at the goal" in refused(scene_data(turns=(tilted, LEVEL), constraints=upright))
    one = {"left": ENDS["left"]}  # whose hand alone tells no heading
    scene = Scene.from_dict(scene_data(grasps=one, turns=(tilted, turned), constraints=upright))
    assert scene.groups[0].orientation == "vertical"


def test_scenes_without_poses_keep_their_checksum():
    data = scene_data()
    plain = {**data, "load": {**BOX, "grasps": ENDS}, "grasp": {"orientation": "down"}}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        written = canonical(Scene.from_dict(plain).file)
    assert not any(key in written for key in (b"frames", b'"start":null', b"position"))
    scene = Scene.from_dict(data)
    assert canonical(parse_scene(scene.file.model_dump())) == canonical(scene.file)
