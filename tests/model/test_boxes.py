"""Box loads: where the hands put the box, what must be said for that, and what its solid touches."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.model.coordinates import ANGLE, QUATERNION, load_coordinates
from tests.cases import examples

from .test_scene import quiet, refused, scene_of

SIZE = np.array([0.3, 0.2, 0.1])
GRASPS = {"a": [0.2, 0.02, 0.07], "b": [-0.2, 0.02, 0.07]}
POST = {"shape": "cylinder", "center": [0.35, 0.2, 0.1], "radius": 0.02}
UPRIGHT = [{"type": "upright"}]
angles = st.floats(-3.1, 3.1)


def box(**more):
    return {"shape": "box", "size": SIZE.tolist(), **more}


def placed(grasps, center, turn):
    """Hands of a load with its frame at `center`, turned by a SciPy rotation."""
    return np.asarray(center) + turn.apply(np.array(list(grasps.values())))


def yaw(angle):
    return Rotation.from_euler("z", angle)


def corners_of(scene, end):
    return scene.nodes_at(end)[scene.body.solids[0]]


def expected(center, turn):
    """Corners of the box: along x first, then y, then z."""
    signs = np.array([[1.0 if i >> k & 1 else -1.0 for k in range(3)] for i in range(8)])
    return np.asarray(center) + turn.apply(0.5 * signs * SIZE)


def two_hands(first, last, *, center=(0.3, 0.2, 0.4), goal=(1.0, 0.2, 0.6), **more):
    """A scene of two hands that hold the box, level, at these headings."""
    load = more.pop("load", box(grasps=GRASPS))
    return scene_of(placed(GRASPS, center, yaw(first)), placed(GRASPS, goal, yaw(last)), load=load, **more)


@examples(40)
@given(angles, angles)
def test_two_hands_and_upright_place_the_box(first, last):
    for scene in (
        quiet(two_hands(first, last, constraints=UPRIGHT)),
        quiet(two_hands(first, last, grasp={})),
    ):
        assert scene.groups[0].orientation == "vertical"
        assert np.allclose(corners_of(scene, "start"), expected((0.3, 0.2, 0.4), yaw(first)), atol=1e-12)
        assert np.allclose(corners_of(scene, "goal"), expected((1.0, 0.2, 0.6), yaw(last)), atol=1e-12)
        assert load_coordinates(scene).parts[0].kind == ANGLE


def test_hands_at_other_heights_than_the_grasps_hold_it_tilted():
    """Its z axis leans as little as they allow, and keeps that tilt to the goal."""
    turn = yaw(0.4) * Rotation.from_euler("y", -0.3)  # along its own x axis upwards
    start, goal = (
        placed(GRASPS, c, t * turn) for c, t in (((0.3, 0, 0.4), yaw(0)), ((1.0, 0, 0.4), yaw(1.0)))
    )
    scene = quiet(scene_of(start, goal, load=box(grasps=GRASPS), constraints=UPRIGHT))
    assert np.allclose(corners_of(scene, "start"), expected((0.3, 0, 0.4), turn), atol=1e-12)
    assert np.allclose(corners_of(scene, "goal"), expected((1.0, 0, 0.4), yaw(1.0) * turn), atol=1e-12)


def test_two_hands_alone_do_not_say_how_it_is_turned():
    error = refused(two_hands(0.0, 0.5))
    assert (error.key, error.message) == (
        "load",
        "'a' and 'b' leave the box free to turn about the line through their hands",
    )
    assert "type: upright" in error.way_out
    assert "grasp" in error.way_out
    assert "third hand" in error.way_out


def test_a_relative_pose_says_it_too():
    """The box starts as level as the hands allow and turns least on the way to the goal."""
    pose = [{"type": "relative_pose", "between": ["a", "b"]}]
    pitch = yaw(0.5) * Rotation.from_euler("y", -0.6)
    start, goal = placed(GRASPS, (0.3, 0, 0.4), yaw(0.5)), placed(GRASPS, (1.0, 0, 0.4), pitch)
    scene = quiet(scene_of(start, goal, load=box(grasps=GRASPS), constraints=pose))
    assert load_coordinates(scene).parts[0].kind == QUATERNION
    assert np.allclose(corners_of(scene, "start"), expected((0.3, 0, 0.4), yaw(0.5)), atol=1e-12)
    assert np.allclose(corners_of(scene, "goal"), expected((1.0, 0, 0.4), pitch), atol=1e-12)


@examples(30)
@given(st.integers(0, 10**6))
def test_three_hands_place_it_in_any_orientation(seed):
    rng = np.random.default_rng(seed)
    grasps = {"a": [0.2, 0.1, 0.05], "b": [-0.2, 0.1, 0.0], "c": [0.0, -0.2, 0.05]}
    first, last = (Rotation.random(random_state=seed + i) for i in range(2))
    centers = rng.uniform(0, 1, (2, 3))
    data = scene_of(
        *(placed(grasps, c, t) for c, t in zip(centers, (first, last), strict=True)), load=box(grasps=grasps)
    )
    scene = quiet(data)
    assert np.allclose(corners_of(scene, "start"), expected(centers[0], first), atol=1e-9)
    assert np.allclose(corners_of(scene, "goal"), expected(centers[1], last), atol=1e-9)


def test_without_grasps_it_is_centred_between_the_hands():
    """Along the line of two, and along the world's axes for one, or for three, as they start."""
    load = box()
    pair = quiet(scene_of([[0, 0, 0], [0, 0.4, 0]], [[1, 0, 0], [1.4, 0, 0]], load=load, constraints=UPRIGHT))
    assert np.allclose(np.ptp(corners_of(pair, "start"), axis=0), [0.2, 0.3, 0.1])
    assert np.allclose(np.ptp(corners_of(pair, "goal"), axis=0), [0.3, 0.2, 0.1])
    assert np.allclose(corners_of(pair, "start").mean(axis=0), [0, 0.2, 0])
    one = quiet(scene_of([[0.0, 0, 0]], [[1.0, 0, 0]], load=load))
    assert np.allclose(corners_of(one, "goal"), expected((1, 0, 0), yaw(0)))
    hands = np.array([[0.3, 0, 0], [-0.3, 0, 0], [0, 0.3, 0.1]])
    three = quiet(scene_of(hands, hands, load=load))
    assert np.allclose(corners_of(three, "start"), expected(hands.mean(axis=0), yaw(0)))


def test_others_go_along_with_the_box_that_some_hold():
    """A third hand on a line to a holder, in whatever place among the names."""
    third = np.array([0.9, -0.5, 0.1])
    ends = []
    for center, turn in (((0.3, 0, 0.4), yaw(0.3)), ((1.0, 0, 0.4), yaw(1.0))):
        ends.append(np.insert(placed(GRASPS, center, turn), 1, center + turn.apply(third), axis=0))
    load = box(grasps={"a": GRASPS["a"], "c": GRASPS["b"]}, held_by=["a", "c"])
    pose = [{"type": "relative_pose", "between": ["b", "c"]}]
    for constraints in (pose, [*pose, *UPRIGHT]):
        scene = quiet(scene_of(*ends, load=load, constraints=constraints))
        assert [group.members for group in scene.groups] == [(0, 1, 2)]
        assert np.allclose(corners_of(scene, "start"), expected((0.3, 0, 0.4), yaw(0.3)), atol=1e-9)
        assert np.allclose(corners_of(scene, "goal"), expected((1.0, 0, 0.4), yaw(1.0)), atol=1e-9)


def test_one_above_the_other_does_not_say_where_it_is_heading():
    grasps = {"a": [0, 0, 0.1], "b": [0, 0, -0.1]}
    hands = placed(grasps, (0.5, 0.5, 0.5), yaw(0))
    error = refused(scene_of(hands, hands, load=box(grasps=grasps), constraints=UPRIGHT))
    assert (error.key, error.way_out) == ("load", "move one of them aside, or let a third hand hold it")
    assert "'a' and 'b' hold the box one above the other" in error.message


@pytest.mark.parametrize(
    ("change", "key", "message"),
    [
        ({"size": [0.3, 0.2]}, "load.size", "2 numbers"),
        ({"size": [0.3, 0.2, 0]}, "load.size[2]", "0 is out of range"),
        ({"grasps": {"a": [0, 0, 0]}}, "load.grasps", "grasps are given for ['a']"),
        ({"grasps": {"a": [0.2, 0.02], "b": [0, 0, 0]}}, "load.grasps.a", "2 numbers"),
        (
            {"grasps": {"a": [0.3, 0.0, 0.1], "b": [-0.2, 0, 0.1]}},
            "manipulators[0].start",
            "0.4 m apart at the start",
        ),
        ({"radius": 0.1}, "load.radius", "unknown key 'radius'"),
    ],
)
def test_what_is_wrong_with_a_box(change, key, message):
    error = refused(two_hands(0.0, 0.5, load=box(grasps=GRASPS) | change, constraints=UPRIGHT))
    assert error.key.startswith(key)
    assert message in error.message


@pytest.mark.parametrize(
    ("what", "obstacle", "free"),
    [
        ("above the middle of the top", {"shape": "sphere", "center": [0.3, 0.2, 0.49], "radius": 0.03}, True),
        ("on the middle of the top", {"shape": "sphere", "center": [0.3, 0.2, 0.47], "radius": 0.03}, False),
        ("wholly inside", {"shape": "sphere", "center": [0.3, 0.2, 0.41], "radius": 0.01}, False),
        ("a post below", POST | {"height": 0.48}, True),
        ("a post from below", POST | {"height": 0.52}, False),
    ],
    ids=lambda x: x if isinstance(x, str) else "",
)  # fmt: skip
def test_the_box_is_solid(what, obstacle, free):
    data = two_hands(0.2, 0.5, constraints=UPRIGHT, obstacles=[obstacle])
    if free:
        assert quiet(data).clearance_at(quiet(data).nodes_at("start"))[0] == pytest.approx(0.01, abs=1e-7)
    else:
        assert "obstacles[0]" in refused(data).message


def test_its_corners_stay_in_the_workspace():
    data = two_hands(0.0, 0.0, constraints=UPRIGHT)
    data["workspace"] = {"lower": [0.16, -1, -1], "upper": [2, 2, 2]}
    assert "the border of the workspace" in refused(data).message


def test_a_box_in_the_plane_is_a_polygon():
    """Its border and its inside touch; hands place it as any body in the plane."""
    load = {"shape": "box", "size": [0.4, 0.1], "grasps": {"a": [0.2, 0], "b": [-0.2, 0]}, "mass": 1.0}
    data = scene_of([[0.4, 0], [0, 0]], [[1, 0.4], [1, 0]], load=load)
    scene = quiet(data)
    assert np.allclose(np.ptp(scene.nodes_at("start")[2:, :2], axis=0), [0.4, 0.1])
    assert np.allclose(np.ptp(scene.nodes_at("goal")[2:, :2], axis=0), [0.1, 0.4])
    for center, free in (([0.2, 0.0], False), ([0.2, 0.055], False), ([0.2, 0.07], True)):
        tried = data | {"obstacles": [{"shape": "circle", "center": center, "radius": 0.01}]}
        if free:
            quiet(tried)
        else:
            assert "obstacles[0]" in refused(tried).message
