"""Resting contacts: what a scene says of them, and what it refuses."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from comove import Scene
from comove.errors import ComoveWarning, SceneError
from comove.model.resting import SLOPE, TOLERANCE, Rest, lift_direction, recessions

UP = np.array([0.0, 0.0, 1.0])


def tray(height=0.06, goal=None, clearance=0.005, supports=(), **table):
    """A box of 6 cm that two hands hold at its top, on a table whose top is at height 0."""
    goal = height if goal is None else goal
    return {
        "name": "tray",
        "duration": 4.0,
        "workspace": {"lower": [-0.6, -0.6, -0.2], "upper": [1.6, 0.8, 1.0]},
        "obstacles": [
            {"name": "table", "shape": "box", "center": [0.5, 0, -0.05], "size": [3, 3, 0.1], "support": True}
            | table,
            *supports,
        ],
        "load": {
            "shape": "box",
            "size": [0.2, 0.1, 0.06],
            "grasps": {"a": [-0.1, 0, 0.03], "b": [0.1, 0, 0.03]},
        },
        "manipulators": [
            {"name": "a", "start": [0.0, 0, height], "goal": [1.0, 0, goal]},
            {"name": "b", "start": [0.2, 0, height], "goal": [1.2, 0, goal]},
        ],
        "constraints": [{"type": "upright"}],
        "limits": {"clearance": clearance},
    }


def wall(name, y):
    """A wall beside the box at its start, whose inner side is at y."""
    return {
        "name": name,
        "shape": "box",
        "center": [0.1, y + np.sign(y) * 0.1, 0.1],
        "size": [0.2, 0.2, 0.2],
        "support": True,
    }


@pytest.mark.parametrize("above", [-TOLERANCE, 0.0, 0.003])
def test_a_payload_rests_on_its_support_at_both_ends(above):
    scene = Scene.from_dict(tray(0.06 + above))
    assert [(rest.end, rest.obstacle) for rest in scene.rests] == [("start", 0), ("goal", 0)]
    for rest in scene.rests:
        assert rest.distance == pytest.approx(above, abs=1e-9)
        np.testing.assert_allclose(rest.normal, UP, atol=1e-9)
        assert scene.clearance_at(rest.nodes)[0] == pytest.approx(0.005 + TOLERANCE)
        away = rest.nodes + rest.reach(scene.clearance) * UP
        assert not recessions(scene, away).any()


def test_what_is_clear_of_its_support_rests_on_nothing():
    with pytest.warns(ComoveWarning, match="table .box. supports the payload at neither start nor goal"):
        assert Scene.from_dict(tray(0.0651)).rests == ()
    assert [rest.end for rest in Scene.from_dict(tray(goal=0.2)).rests] == ["start"]


def test_contact_that_nobody_asked_for_is_refused_and_the_advice_works():
    data = tray(support=None)
    with pytest.raises(SceneError, match="touches table") as caught:
        Scene.from_dict(data)
    number = int(re.search(r"write support: true in obstacles\[(\d+)\]", caught.value.way_out)[1])
    data["obstacles"][number]["support"] = True
    assert len(Scene.from_dict(data).rests) == 2


def test_the_border_supports_nothing_and_the_advice_works():
    """A payload on a floor that is the border: the workspace is widened, and the floor is written as a box."""
    data, floor = tray(), tray()["obstacles"][0]
    data["workspace"]["lower"][2] = 0.0
    for obstacles in ([], [floor]):
        data["obstacles"] = obstacles
        with pytest.raises(SceneError, match="border") as caught:
            Scene.from_dict(data)
        assert "widen the workspace; what lies there, such as a table, is an obstacle" in caught.value.way_out
    data["workspace"]["lower"][2] = -0.1
    assert len(Scene.from_dict(data).rests) == 2


def test_scenes_without_supports_keep_their_checksum():
    plain = tray(0.1, support=None)
    written = {key: value for key, value in plain["obstacles"][0].items() if value is not None}
    said = written | {"support": False}
    scenes = [Scene.from_dict(plain | {"obstacles": [one]}) for one in (written, said)]
    assert len({scene.sha256 for scene in scenes}) == 1
    assert b"support" not in str(scenes[1].file.model_dump()).encode()


def test_a_moving_support_is_refused():
    with pytest.raises(SceneError, match="it moves, so no payload can rest on it"):
        Scene.from_dict(tray(motion={"velocity": [0, 0, 0.1]}))


@given(depth=st.floats(2e-4, 0.02), tilt=st.floats(-0.5, 0.5))
@settings(max_examples=10, deadline=None)
def test_a_payload_in_its_support_is_refused_and_the_advice_works(depth, tilt):
    """The table and all that is on it are turned about y, so that no axis of the world is the direction."""
    c, s = np.cos(tilt), np.sin(tilt)
    turned = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    data = tray()
    data["load"] = {"shape": "bar", "length": 0.2, "radius": 0.06}
    data["constraints"] = []
    data["obstacles"] = [
        data["obstacles"][0]
        | {
            "center": (turned @ [0, 0, -0.05]).tolist(),
            "size": [0.6, 1, 0.1],
            "quaternion_wxyz": [np.cos(tilt / 2), 0, np.sin(tilt / 2), 0],
        }
    ]
    for hand, y in zip(data["manipulators"], (-0.1, 0.1), strict=True):
        hand["start"] = (turned @ [0.0, y, 0.06 - depth]).tolist()
        hand["goal"] = [0.6, y, 0.6]
    with pytest.raises(SceneError, match=f"{depth:.3g} m deep in table") as caught:
        Scene.from_dict(data)
    by = [float(x) for x in re.search(r"by \[(.*)\] m", caught.value.way_out)[1].split(",")]
    for hand in data["manipulators"]:
        hand["start"] = (np.array(hand["start"]) + by).tolist()
    (rest,) = Scene.from_dict(data).rests
    assert abs(rest.distance) < 1e-6
    np.testing.assert_allclose(rest.normal, turned @ UP, atol=1e-4)


def test_a_corner_can_be_left_and_a_slot_cannot():
    corner = Scene.from_dict(tray(supports=[wall("left", 0.051)]))
    way = lift_direction([rest for rest in corner.rests if rest.end == "start"])
    np.testing.assert_allclose(way, np.array([0, -1, 1]) / np.sqrt(2), atol=1e-9)
    data = tray(supports=[wall("left", 0.051), wall("right", -0.052)])
    with pytest.raises(SceneError, match="no direction leaves all of them") as caught:
        Scene.from_dict(data)
    name, by = re.fullmatch(r"move (\w+) \(box\) by \[(.*)\] m", caught.value.way_out).groups()
    moved = next(obstacle for obstacle in data["obstacles"] if obstacle["name"] == name)
    moved["center"] = (np.array(moved["center"]) + [float(x) for x in by.split(",")]).tolist()
    with pytest.warns(ComoveWarning, match="the key has no effect"):
        assert {rest.obstacle for rest in Scene.from_dict(data).rests} == {0, 1}


def test_near_ends_on_different_sides_of_a_support_are_refused():
    data = tray(goal=0.2, supports=[])
    data["obstacles"][0] |= {"center": [0.1, 0, -0.1], "size": [0.004, 0.004, 0.2]}  # a post
    data["load"] = {"shape": "bar", "length": 0.2, "radius": 0.005}
    data["constraints"] = []
    for hand, x in zip(data["manipulators"], (0.0, 0.2), strict=True):
        hand["start"], hand["goal"] = [x, 0.007, -0.1], [x, -0.007, -0.1]
    with pytest.raises(SceneError, match="different sides of table") as caught:
        Scene.from_dict(data)
    needed = float(re.search(r"goal (\S+) m further", caught.value.way_out)[1])
    for hand in data["manipulators"]:
        hand["goal"][2] += needed
    assert len(Scene.from_dict(data).rests) == 2


@given(data=st.data())
@settings(max_examples=50, deadline=None)
def test_the_lift_direction_is_the_steepest(data):
    """No drawn direction leaves all supports more steeply."""
    rng = np.random.default_rng(data.draw(st.integers(0, 10**6)))
    normals = rng.standard_normal((data.draw(st.integers(1, 5)), 3)) + [0, 0, 1]
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    way = lift_direction([Rest("start", 0, np.zeros((1, 3)), 0.0, normal) for normal in normals])
    others = rng.standard_normal((2000, 3))
    others /= np.linalg.norm(others, axis=1)[:, None]
    assert (others @ normals.T).min(axis=1).max() <= max((normals @ way).min(), 0.0) + 1e-9


@given(x=st.floats(-0.03, 0.03), z=st.floats(0.0, 0.03), clearance=st.floats(0.0, 0.02))
@settings(max_examples=25, deadline=None)
def test_recession_is_what_the_required_distance_lacks(x, z, clearance):
    scene = Scene.from_dict(tray(clearance=clearance))
    rest = scene.rests[0]
    moved = rest.nodes + [x, 0.0, z]
    required = min(clearance, rest.distance - TOLERANCE + SLOPE * np.hypot(x, z))
    assert scene.clearance_at(moved)[0] - clearance == pytest.approx(z - required, abs=1e-9)
