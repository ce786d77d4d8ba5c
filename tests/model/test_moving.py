"""Obstacles go where their motion says."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.errors import ComoveWarning, SceneError
from comove.geometry import distances as sd
from comove.geometry.distances import point_distance
from comove.model import Scene
from tests.brute_force import obstacle_distance
from tests.cases import examples

DISC = {"shape": "circle", "center": [0.5, 0.9], "radius": 0.05}
POINTS, TIMES = [[0.5, 0.9], [0.5, 0.1], [0.4, 0.1]], [0.5, 1.5, 2.0]
MOTIONS = {
    "velocity": {"velocity": [0.3, -0.2]},
    "waypoints": {"waypoints": POINTS, "times": TIMES},
    "circle": {"circle": {"radius": 0.2, "period_s": 3.0}},
    "turn": {"turn": {"rate_deg_per_s": -40, "hinge": [0.1, 0.05]}},
    "turn on the way": {
        "waypoints": POINTS,
        "times": TIMES,
        "turn": {"rate_deg_per_s": 70, "hinge": [0, -0.1]},
    },
}
SHAPES = {
    "box": {"size": [0.3, 0.1, 0.2]},
    "sphere": {"radius": 0.1},
    "capsule": {"radius": 0.05, "length": 0.3},
    "cylinder": {"radius": 0.1, "height": 0.3},
    "ellipsoid": {"radii": [0.05, 0.1, 0.2]},
}


def scene(motion=None, **more):
    obstacle = DISC if motion is None else {**DISC, "motion": motion}
    hands = [{"name": n, "start": [0.1, y], "goal": [0.9, y]} for n, y in (("left", 0.4), ("right", 0.6))]
    return Scene.from_dict(
        {
            "name": "moving",
            "duration": 4.0,
            "workspace": {"lower": [0, 0], "upper": [1, 1]},
            "obstacles": [obstacle, {"shape": "box", "center": [0.5, 0.5], "size": [0.1, 0.1]}],
            "load": {"shape": "bar", "length": 0.2},
            "manipulators": hands,
            **more,
        }
    )


def path(motion, time):
    return scene(motion).offsets(np.atleast_1d(time))[:, 0, :2] + DISC["center"]


def test_a_constant_velocity():
    np.testing.assert_allclose(path(MOTIONS["velocity"], [0.0, 2.0]), [[0.5, 0.9], [1.1, 0.5]])


def test_waypoints_are_met_at_their_times_and_the_last_is_kept():
    at = path(MOTIONS["waypoints"], [0.0, 0.5, 1.0, 1.5, 2.0, 9.0])
    np.testing.assert_allclose(at, [POINTS[0], POINTS[0], [0.5, 0.5], POINTS[1], POINTS[2], POINTS[2]])


def test_a_circle_begins_at_the_centre_and_runs_counter_clockwise():
    at = path(MOTIONS["circle"], [0.0, 0.75, 1.5, 3.0])
    np.testing.assert_allclose(at, [[0.5, 0.9], [0.3, 1.1], [0.1, 0.9], [0.5, 0.9]], atol=1e-12)


@pytest.mark.parametrize("how", MOTIONS)
def test_velocities_are_the_derivatives(how):
    moving, time, h = scene(MOTIONS[how]), np.array([0.2, 0.7, 1.2, 1.8, 2.5]), 1e-6
    difference = (moving.offsets(time + h) - moving.offsets(time - h)) / (2 * h)
    np.testing.assert_allclose(moving.obstacle_velocities(time), difference, atol=1e-8)


@pytest.mark.parametrize("how", MOTIONS)
@given(n_intervals=st.integers(1, 40), end=st.floats(0.1, 5.0))
def test_centres_stray_from_their_chords_by_their_sags_at_most(how, n_intervals, end):
    moving, time = scene(MOTIONS[how]), np.linspace(0.0, end, n_intervals + 1)
    finely = np.linspace(0.0, end, 50 * n_intervals + 1)
    at, finer = moving.offsets(time)[:, 0], moving.offsets(finely)[:, 0]
    chords = np.stack([np.interp(finely, time, column) for column in at.T], axis=1)
    strays = np.linalg.norm(finer - chords, axis=1)[:-1].reshape(n_intervals, 50).max(axis=1)
    sagittas = moving.obstacle_sagittas(time)[:, 0]
    assert (strays <= sagittas + 1e-12).all()
    if end / n_intervals < 0.2:
        assert (sagittas <= 1.2 * strays + 1e-3).all(), "and hardly less"


def random_obstacle(rng, shape, n_dims):
    """An obstacle that turns about any axis and hinge while it goes any way."""
    obstacle = {"shape": shape, **SHAPES[shape], "center": rng.uniform(0.4, 0.6, n_dims).tolist()}
    obstacle |= {key: obstacle[key][:n_dims] for key in ("size", "radii") if key in obstacle}
    if shape != "sphere":
        turn = {"rotation_deg": 200 * rng.random()} if n_dims == 2 else {}
        obstacle |= turn or {
            "quaternion_wxyz": Rotation.random(random_state=rng).as_quat()[[3, 0, 1, 2]].tolist()
        }
    turn = {"rate_deg_per_s": float(rng.uniform(-200, 200)), "hinge": rng.uniform(-0.2, 0.2, n_dims).tolist()}
    if n_dims == 3:
        turn["axis"] = rng.standard_normal(3).tolist()
    path = [{}, {"velocity": [0.1, -0.2, 0.1][:n_dims]}, {"circle": {"radius": 0.2, "period_s": 3.0}}]
    return obstacle | {"motion": {**path[rng.integers(3)], "turn": turn}}


@pytest.mark.parametrize("n_dims", [2, 3])
@pytest.mark.parametrize("shape", SHAPES)
@examples(10)
@given(seed=st.integers(0, 2**32 - 1), time=st.floats(0.0, 9.0))
def test_the_distance_to_a_turned_obstacle_is_that_to_the_turned_shape(shape, n_dims, seed, time):
    """A hand, by the scene and by the file alone (scipy's rotations); then the whole table by the hand's distance."""
    if shape == "cylinder" and n_dims == 2:
        return
    rng = np.random.default_rng(seed)
    obstacle = random_obstacle(rng, shape, n_dims)
    data = {
        "name": "turned",
        "duration": 4.0,
        "workspace": {"lower": [-9.0] * n_dims, "upper": [9.0] * n_dims},
        "obstacles": [obstacle],
        "manipulators": [{"name": "a", "start": [-8.0] * n_dims, "goal": [8.0] * n_dims}],
    }
    turned = Scene.from_dict(data)
    point = turned.centers[0] + turned.offsets(np.array([time]))[0, 0] + rng.uniform(-0.4, 0.4, 3)
    point[n_dims:] = 0.0
    truth = float(obstacle_distance(turned.file.obstacles[0], point[None, :n_dims], np.array([time]))[0])
    assert turned.clearance_at(point[None], time)[0] == pytest.approx(truth, abs=1e-6)
    table = turned.obstacles_at(time)
    assert point_distance(table, 0, *point) == pytest.approx(truth, abs=1e-6)


@examples(10)
@given(seed=st.integers(0, 2**32 - 1), time=st.floats(0.0, 9.0))
def test_displacements_take_points_of_obstacles_to_where_they_are(seed, time):
    """A corner of every box, by the displacement and by the table at that instant."""
    rng = np.random.default_rng(seed)
    boxes = [
        random_obstacle(rng, "box", 2),
        {**SHAPES["box"], "shape": "box", "center": [5, 5], "size": [1, 1]},
    ]
    hands = [{"name": "a", "start": [-8, -8], "goal": [8, 8]}]
    around = {"workspace": {"lower": [-9, -9], "upper": [9, 9]}, "manipulators": hands, "load": None}
    both = scene(obstacles=boxes, **around)
    (offsets,), (angles,), axes, centers = both.displacements(np.array([time]))
    for before, after, row in zip(both.obstacles, both.obstacles_at(time), range(2), strict=True):
        corner, there = (
            line[sd.CENTER : sd.CENTER + 3]
            + line[sd.ROTATION : sd.ROTATION + 9].reshape(3, 3) @ [0.1, 0.2, 0.0]
            for line in (before, after)
        )
        turned = Rotation.from_rotvec(angles[row] * axes[row]).apply(corner - centers[row])
        np.testing.assert_allclose(centers[row] + offsets[row] + turned, there, atol=1e-9)


def test_a_mesh_turns_as_its_triangles_do():
    """A gate that turns by a quarter about a vertical hinge is the gate that stands there, turned."""
    file = Path(__file__).parents[2] / "examples" / "meshes" / "gate.yaml"
    data = yaml.safe_load(file.read_text(encoding="utf-8"))
    gate = {key: value for key, value in data["obstacles"][0].items() if key != "motion"}
    hinge, center = np.array([0.2, 0.1, 0.0]), np.array(gate["center"], dtype=float)
    turn = {"rate_deg_per_s": 45, "axis": [0, 0, 2], "hinge": hinge.tolist()}
    quarter = Rotation.from_rotvec([0.0, 0.0, np.pi / 2])
    w, *xyz = gate.get("quaternion_wxyz", (1.0, 0.0, 0.0, 0.0))
    x, y, z, w = (quarter * Rotation.from_quat([*xyz, w])).as_quat()
    there = (center + hinge - quarter.apply(hinge)).tolist()
    stands = gate | {"center": there, "quaternion_wxyz": [w, x, y, z]}
    one, other = (
        Scene.from_dict(data | {"obstacles": [obstacle]}, folder=file.parent, check_ends=False)
        for obstacle in (gate | {"motion": {"turn": turn}}, stands)
    )
    rng, nodes = np.random.default_rng(0), one.nodes_at("start")
    for _ in range(20):
        moved = nodes + rng.uniform(-0.4, 0.8, 3)
        assert one.clearance_at(moved, 2.0)[0] == pytest.approx(other.clearance_at(moved)[0], abs=1e-9)
    np.testing.assert_allclose(one.obstacles_at(2.0), other.obstacles, atol=1e-9)


@pytest.mark.parametrize("how", MOTIONS)
@examples(10)
@given(seed=st.integers(0, 2**32 - 1), n_steps=st.integers(50, 2000), end=st.floats(0.1, 5.0))
def test_points_of_obstacles_keep_to_the_bounds_of_their_speed(how, seed, n_steps, end):
    box = {"shape": "box", "center": DISC["center"], "size": [0.3, 0.1], "rotation_deg": 30}
    moving = scene(obstacles=[{**box, "motion": MOTIONS[how]}])
    own = np.random.default_rng(seed).uniform(-1, 1, 2) * [0.15, 0.05]
    fine = np.linspace(0.0, end, n_steps + 1)
    at = np.array([moving.obstacles_at(t)[0] for t in fine])
    turns = at[:, sd.ROTATION : sd.ROTATION + 9].reshape(-1, 3, 3)
    points = at[:, sd.CENTER : sd.CENTER + 3] + turns @ [*own, 0.0]
    assert (np.linalg.norm(np.diff(points, axis=0), axis=1) <= moving.obstacle_speeds * fine[1] + 1e-12).all()


def test_obstacles_that_stand_have_no_motion():
    moving = scene(MOTIONS["velocity"])
    assert moving.moving.tolist() == [True, False]
    assert not moving.offsets(np.array([3.0]))[0, 1].any() and not moving.turning.any()
    assert scene(MOTIONS["turn"]).turning.tolist() == [True, False]
    assert scene().displacements_along(11).offsets.shape == (0, 2, 3)
    assert moving.displacements_along(11).offsets.shape == (11, 2, 3)


def test_scene_files_that_turn_are_compared_after_their_motions_were_asked():
    one, same = scene(MOTIONS["turn"]), scene(MOTIONS["turn"])
    for turning in (one, same):
        turning.displacements_along(3)
    assert one.file == same.file != scene(MOTIONS["velocity"]).file


def test_scenes_without_motion_keep_their_checksum():
    assert scene().sha256 == scene(None).sha256 != scene(MOTIONS["velocity"]).sha256
    assert b"motion" not in scene().file.model_dump_json().encode()


def test_what_moves_may_pass_the_goal_but_not_begin_on_the_load():
    visitor = {**DISC, "center": [0.9, 0.5], "motion": {"velocity": [0.0, 0.3]}}
    assert scene(obstacles=[visitor]).moving.all()
    with pytest.raises(SceneError, match="at the start the load or a hand reaches"):
        scene(obstacles=[{**visitor, "center": [0.1, 0.5]}])
    with pytest.raises(SceneError, match="at the goal the load or a hand reaches"):
        scene(obstacles=[{**DISC, "center": [0.9, 0.5]}])


@pytest.mark.parametrize(
    ("motion", "key", "words"),
    [
        ({}, "motion", "it does not say how"),
        (
            {"velocity": [1, 1], "circle": {"radius": 1, "period_s": 1}},
            "motion",
            "velocity and circle are given",
        ),
        ({"velocity": [1, 1, 1]}, "motion.velocity", "has 3 numbers"),
        ({"velocity": 1}, "motion.velocity", "is not a list"),
        ({"velocity": [float("nan"), 1]}, "motion.velocity[0]", "nan"),
        ({"velocty": [1, 1]}, "motion.velocty", "'velocity'?"),
        ({"waypoints": POINTS}, "motion", "waypoints are given without times"),
        ({"times": TIMES}, "motion", "it does not say how"),
        ({"waypoints": POINTS, "times": [0, 1]}, "motion", "3 waypoints and 2 times"),
        (
            {"waypoints": POINTS, "times": [0, 2, 2]},
            "motion",
            "times[2] = 2.0 does not come after times[1] = 2.0",
        ),
        ({"waypoints": POINTS, "times": [-1, 1, 2]}, "motion.times[0]", "out of range"),
        ({"waypoints": [], "times": []}, "motion", "there are no waypoints"),
        (
            {"waypoints": POINTS[1:], "times": [0, 1]},
            "motion.waypoints[0]",
            "the motion begins at [0.5, 0.1]",
        ),
        ({"circle": {"radius": 0, "period_s": 1}}, "motion.circle.radius", "0 is out of range"),
        ({"circle": {"radius": 1, "period_s": 1e-300}}, "motion.circle.period_s", "1e-300 is out of range"),
        ({"circle": {"radius": 1e300, "period_s": 1}}, "motion.circle.radius", "1e+300 is out of range"),
        ({"circle": {"radius": 1, "period_s": 1e-3}}, "motion", "the obstacle moves at 6283.19 m/s; let it"),
        ({"velocity": [1e4, 0]}, "motion", "the obstacle moves at 10000 m/s"),
        ({"velocity": [1e300, 1]}, "motion.velocity[0]", "1e+300 is out of range"),
        (
            {"waypoints": [[0.5, 0.9], [0.5, 0.5]], "times": [0, 1e-300]},
            "motion",
            "the obstacle moves at 4e+299 m/s",
        ),
        ({"circle": {"radius": 1}}, "motion.circle", "required here: radius, period_s"),
        ({"turn": {}}, "motion.turn", "required here: rate_deg_per_s"),
        ({"turn": {"rate_deg_per_s": 0}}, "motion.turn.rate_deg_per_s", "leave out turn"),
        ({"turn": {"rate_deg_per_s": -3601}}, "motion.turn.rate_deg_per_s", "at most 3600, in deg/s"),
        ({"turn": {"rate_deg_per_s": 9, "axis": [0, 0, 1]}}, "motion.turn.axis", "planar; leave it out"),
        ({"turn": {"rate_deg_per_s": 9, "axis": [0, 0, 0]}}, "motion.turn.axis", "such as [0, 0, 1]"),
        ({"turn": {"rate_deg_per_s": 9, "axis": [0, 0, 1e-12]}}, "motion.turn.axis", "has no direction"),
        ({"turn": {"rate_deg_per_s": 9, "axis": [0, 0, np.nan]}}, "motion.turn.axis[2]", "finite"),
        ({"turn": {"rate_deg_per_s": 9, "axis": [0, 1]}}, "motion.turn.axis", "write 3 (x, y, z)"),
        ({"turn": {"rate_deg_per_s": 9, "hinge": [0, 0, 1]}}, "motion.turn.hinge", "has 3 numbers"),
        ({"turn": {"rate_deg_per_s": 3600, "hinge": [99, 0]}}, "motion", "at 6220.35 m/s; let it"),
        ({"turn": {"rate_deg_per_s": 9}, "times": [1]}, "motion", "times are given without waypoints"),
    ],
)
def test_what_is_wrong_with_a_motion(motion, key, words):
    with pytest.raises(SceneError) as caught:
        scene(motion)
    assert str(caught.value).startswith(f"obstacles[0].{key}: ")
    assert words in str(caught.value)


def test_a_turn_in_space_needs_an_axis_and_slow_tips():
    data = {
        "name": "door",
        "duration": 4.0,
        "workspace": {"lower": [-1, -1, -1], "upper": [1, 1, 1]},
        "manipulators": [{"name": "a", "start": [0.1, 0.1, 0], "goal": [0.9, 0.1, 0]}],
    }
    door = {"shape": "box", "center": [0, 0, 500], "size": [0.1, 0.1, 400]}
    for turn, key, words in (
        ({"rate_deg_per_s": 3600}, "", "in space a turn needs an axis; add one, such as axis: [0, 0, 1]"),
        (
            {"rate_deg_per_s": 3600, "axis": [1, 0, 0]},
            "",
            "move at up to 12566.4 m/s; let it turn more slowly",
        ),
    ):
        with pytest.raises(SceneError) as caught:
            Scene.from_dict(data | {"obstacles": [door | {"motion": {"turn": turn}}]})
        assert str(caught.value).startswith(f"obstacles[0].motion.turn{key}: ") and words in str(caught.value)
    advised = {"rate_deg_per_s": 3600, "axis": [0, 0, 1]}
    assert Scene.from_dict(data | {"obstacles": [{**door, "size": [0.1] * 3, "motion": {"turn": advised}}]})


@pytest.mark.parametrize(
    ("motion", "speed"),
    [
        ({"velocity": [0.3, 0.4]}, "0.5"),
        ({"waypoints": [[0.5, 0.9], [0.5, 0.5]], "times": [1.0, 1.5]}, "0.8"),
        ({"circle": {"radius": 0.1, "period_s": 1.0}}, "0.628"),
    ],
)
def test_what_no_hand_gets_away_from_is_warned_of(motion, speed):
    hands = [{"name": "a", "start": [0.1, 0.1], "goal": [0.9, 0.1]}]
    data = {
        "name": "chased",
        "duration": 4.0,
        "workspace": {"lower": [0, 0], "upper": [1, 1]},
        "obstacles": [{"shape": "circle", "center": [0.5, 0.9], "radius": 0.05, "motion": motion}],
        "manipulators": hands,
        "limits": {"speed": 0.45},
    }
    words = rf"obstacles\[0\]\.motion: up to {speed} m/s, faster than the hands may move \(0\.45 m/s\)"
    with pytest.warns(ComoveWarning, match=words):
        Scene.from_dict(data)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Scene.from_dict({**data, "limits": {"speed": 0.85}})


def test_what_moves_can_be_left_out():
    data = {
        "name": "two",
        "duration": 4.0,
        "workspace": {"lower": [0, 0, 0], "upper": [1, 1, 1]},
        "obstacles": [
            {
                "shape": "sphere",
                "center": [0.2, 0.9, 0.5],
                "radius": 0.05,
                "motion": {"velocity": [0.1, 0, 0]},
            },
            {"shape": "box", "center": [0.5, 0.5, 0.9], "size": [0.1, 0.2, 0.1]},
        ],
        "load": {"shape": "bar", "length": 0.2},
        "manipulators": [
            {"name": "a", "start": [0.2, 0.2, 0.2], "goal": [0.7, 0.2, 0.2]},
            {"name": "b", "start": [0.4, 0.2, 0.2], "goal": [0.9, 0.2, 0.2]},
        ],
    }
    scene = Scene.from_dict(data)
    without = scene.standing()
    assert [obstacle.shape for obstacle in without.file.obstacles] == ["box"]
    np.testing.assert_array_equal(without.obstacles, scene.obstacles[1:])
    assert without.owners.tolist() == [0]
    assert without.name_of(0) == scene.name_of(1).replace("1", "0")


def test_meshes_stay_what_they_are_where_others_are_left_out():
    """Where what moves is left out, the scene is the one in which it never was."""
    file = Path(__file__).parents[2] / "examples" / "meshes" / "gate.yaml"
    data = yaml.safe_load(file.read_text(encoding="utf-8"))
    ball = {
        "shape": "sphere",
        "center": [0.1, 0.1, 0.1],
        "radius": 0.02,
        "motion": {"velocity": [0.01, 0, 0]},
    }
    alone = Scene.from_dict(data, folder=file.parent)
    left = Scene.from_dict(data | {"obstacles": [ball, *data["obstacles"]]}, folder=file.parent).standing()
    np.testing.assert_array_equal(left.obstacles, alone.obstacles)
    np.testing.assert_array_equal(left.owners, alone.owners)
    for name in ("owner", "row", "center", "root"):
        np.testing.assert_array_equal(getattr(left.surfaces, name), getattr(alone.surfaces, name))
    rng = np.random.default_rng(0)
    nodes = alone.nodes_at("start")
    for _ in range(20):
        moved = nodes + rng.uniform(-0.4, 0.8, 3)
        assert left.clearance_at(moved)[0] == alone.clearance_at(moved)[0]
