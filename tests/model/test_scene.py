"""A scene puts its ends onto the constraints, and refuses what cannot be with names and values."""

import copy
import json
import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from comove.errors import ComoveWarning, SceneError
from comove.model.scene import GEOMETRY, N_DERIVED, Scene, of_geometry
from tests.cases import examples

TRIANGLE = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.1, 0.15, 0.0]])
FRAME = {"shape": "frame", "edges": [["a", "b"], ["b", "c"], ["c", "a"]], "radius": 0.01}
BAR = {"shape": "bar", "length": 0.2}


def scene_of(start, goal, **more):
    """Data of a scene of hands a, b, c .. from `start` to `goal`, arrays of shape (n, 2) or (n, 3)."""
    start, goal = np.asarray(start, dtype=float), np.asarray(goal, dtype=float)
    n_dims = start.shape[1]
    return {
        "name": "test",
        "duration": 10.0,
        "workspace": {"lower": [-1.0] * n_dims, "upper": [2.0] * n_dims},
        "manipulators": [
            {"name": name, "start": s.tolist(), "goal": g.tolist()}
            for name, s, g in zip("abcdef"[: len(start)], start, goal, strict=True)
        ],
        **more,
    }


def bar_scene(**more):
    """A planar bar that is carried from left to right."""
    return scene_of([[0.1, 0.4], [0.1, 0.6]], [[0.9, 0.4], [0.9, 0.6]], load=BAR, **more)


def apart(a, b, distance, tolerance=None):
    """A distance constraint."""
    constraint = {"type": "distance", "between": [a, b], "distance": distance}
    return constraint if tolerance is None else {**constraint, "tolerance": tolerance}


def refused(data):
    """The error that refuses the scene."""
    with pytest.raises(SceneError) as caught:
        Scene.from_dict(data)
    assert caught.value.way_out
    return caught.value


def quiet(data):
    """The scene, which must be built without a word, but for hands that are put beside the load on purpose."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*there is nothing between its fingers")
        return Scene.from_dict(data)


def distances(scene, hands):
    return np.array(
        [np.linalg.norm(hands[c.first] - hands[c.second]) - c.distance for c in scene.constraints]
    )


def test_a_bar_implies_its_distance():
    scene = quiet(bar_scene())
    (constraint,) = scene.constraints
    assert (constraint.first, constraint.second, constraint.distance) == (0, 1, pytest.approx(0.2, abs=1e-16))
    assert constraint.tolerance == pytest.approx(2e-4)
    assert np.array_equal(scene.start, [[0.1, 0.4], [0.1, 0.6]])
    assert scene.groups[0].members == (0, 1)
    assert scene.groups[0].orientation == "plane"


@pytest.mark.parametrize("tie", [{"load": BAR}, {"constraints": [apart("a", "b", 0.2, 2e-4)]}])
@pytest.mark.parametrize("end", ["start", "goal"])
def test_a_small_miss_is_moved_onto_the_constraint_with_a_warning(end, tie):
    data = scene_of([[0.1, 0.4], [0.1, 0.6]], [[0.9, 0.4], [0.9, 0.6]], **tie)
    data["manipulators"][1][end][1] += 1e-4
    with pytest.warns(ComoveWarning, match=rf"the {end} was moved .* by 5e-05 m"):
        scene = Scene.from_dict(data)
    for hands in (scene.start, scene.goal):
        assert np.abs(distances(scene, hands)).max() < 1e-15
    moved = getattr(scene, end) - [m[end] for m in data["manipulators"]]
    assert np.allclose(moved[:, 1], [5e-5, -5e-5], atol=1e-12)  # least: both by half
    assert np.array_equal(scene.nodes_at(end)[:, :2], getattr(scene, end))


@examples(40)
@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]))
def test_triangles_land_on_all_their_distances(seed, n_dims):
    rng = np.random.default_rng(seed)
    start = (TRIANGLE + 1e-4 * rng.standard_normal((3, 3)))[:, :n_dims]
    goal = (TRIANGLE + [0.5, 0.3, 0] + 1e-4 * rng.standard_normal((3, 3)))[:, :n_dims]
    pairs = [("a", "b", 0, 1), ("b", "c", 1, 2), ("a", "c", 0, 2)]
    constraints = [
        apart(p, q, float(np.linalg.norm(TRIANGLE[i] - TRIANGLE[j])), 2e-3) for p, q, i, j in pairs
    ]
    with pytest.warns(ComoveWarning, match="moved onto"):
        scene = Scene.from_dict(scene_of(start, goal, constraints=constraints))
    for written, hands in ((start, scene.start), (goal, scene.goal)):
        assert np.abs(distances(scene, hands)).max() < 1e-14
        assert np.abs(hands - written).max() < 1e-3


@pytest.mark.parametrize("end", ["start", "goal"])
def test_a_larger_miss_is_refused_with_both_values(end):
    data = bar_scene()
    data["manipulators"][1][end][1] = 0.61
    error = refused(data)
    assert all(value in error.message for value in ("0.21 m", "0.2 m", "'a'", "'b'", end))
    assert end in error.key


def test_a_load_and_a_constraint_that_disagree():
    error = refused(bar_scene(constraints=[apart("a", "b", 0.3)]))
    assert "0.2 m" in error.message
    assert "0.3 m" in error.message


def mirrored(n_dims):
    """A triangle in the plane, or a tetrahedron in space, and its mirror image at the goal."""
    held = TRIANGLE[:, :2] if n_dims == 2 else np.vstack([TRIANGLE, [0.1, 0.05, 0.15]])
    return held, held * np.array([1, -1, 1][:n_dims]) + 0.5


@pytest.mark.parametrize("n_dims", [2, 3])
def test_a_mirror_image_at_the_goal_is_refused(n_dims):
    assert "mirror image" in refused(scene_of(*mirrored(n_dims), load=FRAME)).message


def test_a_triangle_may_turn_over_in_space():
    quiet(scene_of(TRIANGLE, TRIANGLE * [1, -1, 1] + 0.5, load=FRAME))


def test_a_mirror_image_is_refused_whatever_other_hands_may_do():
    """The tolerance of a pair elsewhere says nothing about this load."""
    start, goal = mirrored(2)
    others = np.array([[-0.9, -0.9], [-0.9, -0.4]])
    data = scene_of(
        np.vstack([start, others]), np.vstack([goal, others]), load={**FRAME, "held_by": ["a", "b", "c"]}
    )
    data["constraints"] = [apart("d", "e", 0.5, 0.4)]
    assert "mirror image" in refused(data).message


def test_what_is_no_mirror_image_is_not_called_one():
    """Three hands nearly on a line, the middle one 2 mm off: the distances hardly tell of it."""
    start = np.array([[0.0, 0.0], [0.1, 0.0], [0.2, 0.0]])
    goal = np.add(start, [[0.0, 0.5], [0.0, 0.502], [0.0, 0.5]])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ComoveWarning)
            scene = Scene.from_dict(scene_of(start, goal, load=FRAME))
    except SceneError as error:
        assert "mirror" not in str(error)
    else:
        assert np.abs(distances(scene, scene.goal)).max() < 1e-12


@pytest.mark.parametrize("off", [0.0, 1e-6, 3e-6, 1e-5, 1e-4, 1e-3])
def test_a_bar_in_space_that_points_back_stays_where_it_is(off):
    """Hands at their exact distance are not moved, whichever way the bar points."""
    direction = np.array([-1.0, off, 0.0]) / np.hypot(1, off)
    start = np.array([-0.1, 0.1])[:, None] * direction
    scene = quiet(scene_of(start, np.add(start, [0.0, 0.5, 0.0]), load=BAR))
    assert np.abs(scene.start - start).max() < 1e-12


BOX = {"shape": "box", "center": [0.5, 0.5], "size": [0.1, 0.1]}
DISC = {"shape": "circle", "center": [0.9, 0.5], "radius": 0.05}


def test_a_load_that_starts_or_ends_in_an_obstacle():
    """The hands are free, the bar between them is not."""
    error = refused(bar_scene(obstacles=[BOX, DISC]))
    assert re.search(r"at the goal .* reaches 0\.05 m into obstacles\[1\] \(sphere\)", error.message)
    assert "obstacles[0]" in refused(bar_scene(obstacles=[{**BOX, "center": [0.1, 0.5]}])).message


@pytest.mark.parametrize("end", ["start", "goal"])
def test_an_end_outside_the_workspace(end):
    data = bar_scene(workspace={"lower": [0.0, 0.0], "upper": [1.0, 1.0]})
    quiet(data)
    for manipulator in data["manipulators"]:
        manipulator[end][0] += 0.3 if end == "goal" else -0.3
    error = refused(data)
    assert end in error.message
    assert "border of the workspace" in error.message
    assert "leaves the workspace" in error.message


def test_a_clearance_that_an_end_does_not_keep():
    quiet(bar_scene(obstacles=[{**DISC, "center": [0.8, 0.5]}], limits={"clearance": 0.04}))
    error = refused(bar_scene(obstacles=[{**DISC, "center": [0.8, 0.5]}], limits={"clearance": 0.06}))
    assert "0.05 m" in error.message
    assert "0.06 m" in error.message


def test_thickness_counts():
    near = [{**DISC, "center": [0.84, 0.5]}]
    quiet(bar_scene(obstacles=near))
    assert "obstacles[0]" in refused({**bar_scene(obstacles=near), "load": {**BAR, "radius": 0.02}}).message


def test_a_chain_that_is_not_rigid_is_refused():
    side = float(np.linalg.norm(TRIANGLE[2]))
    data = scene_of(TRIANGLE, TRIANGLE + 0.5, constraints=[apart("a", "b", 0.2), apart("b", "c", side)])
    error = refused(data)
    assert all(name in error.message for name in ("'a'", "'c'", "free"))
    assert error.key == "constraints"
    data["constraints"].append(apart("a", "c", side))
    assert quiet(data).groups[0].members == (0, 1, 2)


def test_hands_that_start_at_one_point():
    data = scene_of(np.zeros((2, 2)), np.ones((2, 2)), load={"shape": "frame", "edges": [["a", "b"]]})
    assert "start at the same point" in refused(data).message


def test_hands_that_are_free():
    """Without load and constraints every hand is a group of its own, and a point that must not touch."""
    data = scene_of(TRIANGLE, TRIANGLE + 0.5)
    scene = quiet(data)
    assert [g.members for g in scene.groups] == [(0,), (1,), (2,)]
    assert {g.orientation for g in scene.groups} == {"none"}
    data["obstacles"] = [{"shape": "sphere", "center": [0.1, 0.16, 0.0], "radius": 0.02}]
    assert "obstacles[0]" in refused(data).message


def test_two_groups_and_a_free_hand():
    start = np.array([[0.0, 0.0], [0.0, 1.0], [0.2, 0.0], [0.3, 1.0], [1.0, 0.5]])
    data = scene_of(
        start, start + 0.1, load={**BAR, "held_by": ["c", "a"]}, constraints=[apart("b", "d", 0.3)]
    )
    scene = quiet(data)
    assert [g.members for g in scene.groups] == [(0, 2), (1, 3), (4,)]
    assert np.array_equal(scene.nodes_at("goal")[:, :2], scene.goal)


def test_an_overhang_reaches_beyond_the_hands():
    """Half a bar's length further out at either end there is something to hit."""
    long = {**BAR, "overhang": 0.1}
    data = bar_scene(obstacles=[{**DISC, "center": [0.1, 0.74]}])
    quiet(data)
    assert "obstacles[0]" in refused({**data, "load": long}).message
    scene = quiet({**bar_scene(), "load": long})
    assert np.allclose(scene.nodes_at("start")[2:, :2], [[0.1, 0.3], [0.1, 0.7]], atol=1e-15)
    assert scene.body.edges.tolist()[0] == [2, 3]
    assert scene.groups[0].reach == pytest.approx(0.2)


def polygon_scene(**more):
    """A plate with a notch, held at two corners, turned by a quarter at the goal."""
    plate = {
        "shape": "polygon",
        "vertices": [[0, 0], [0.3, 0], [0.3, 0.2], [0.15, 0.05], [0, 0.2]],
        "grasps": {"a": [0, 0], "b": [0.3, 0]},
    }
    return scene_of([[0.0, 0.0], [0.3, 0.0]], [[1.0, 0.5], [1.0, 0.8]], load=plate, **more)


def test_a_polygon():
    """Its corners go with the hands; its border and its inside may not touch, its notch may be filled."""
    scene = quiet(polygon_scene())
    corners = scene.nodes_at("goal")[2:, :2]
    assert np.allclose(corners, [[1, 0.5], [1, 0.8], [0.8, 0.8], [0.95, 0.65], [0.8, 0.5]], atol=1e-12)
    for center, touches in (
        ((0.15, 0.025), True),
        ((0.27, 0.1), True),
        ((0.15, 0.15), False),
        ((0.15, 0.06), True),
    ):
        data = polygon_scene(obstacles=[{"shape": "circle", "center": list(center), "radius": 0.012}])
        if touches:
            assert "obstacles[0]" in refused(data).message
        else:
            quiet(data)


def test_what_lies_within_a_polygon_touches_it_wherever_the_hands_are():
    """Hands inside the plate are no corners of it."""
    plate = {
        "shape": "polygon",
        "vertices": [[0, 0], [0.4, 0], [0.4, 0.4], [0, 0.4]],
        "grasps": {"a": [0.3, 0.2], "b": [0.1, 0.2]},
    }
    hands = [[0.3, 0.2], [0.1, 0.2]]
    for center in ([0.2, 0.1], [0.2, 0.3], [0.05, 0.2], [0.2, 0.2]):
        disc = {"shape": "circle", "center": center, "radius": 0.01}
        assert "obstacles[0]" in refused(scene_of(hands, hands, load=plate, obstacles=[disc])).message


def test_messages_call_obstacles_by_their_names():
    at_start = {**BOX, "center": [0.1, 0.5]}
    assert "pillar (box)" in refused(bar_scene(obstacles=[{**at_start, "name": "pillar"}])).message
    error = refused(bar_scene(obstacles=[{**BOX, "name": "shelf"}, DISC, {**DISC, "name": "shelf"}]))
    assert error.key == "obstacles[2].name"
    assert "already that of obstacles[0]" in error.message
    assert refused(bar_scene(obstacles=[{**BOX, "name": "a\x1b[2J"}])).key == "obstacles[0].name"


def test_a_name_counts_for_the_checksum_only_where_it_is_given():
    plain, named = (quiet(bar_scene(obstacles=[box])) for box in (BOX, {**BOX, "name": "shelf"}))
    assert "name" not in plain.file.obstacles[0].model_dump()
    assert plain.sha256 != named.sha256


def test_clearance_at_names_what_is_nearest():
    scene = quiet(bar_scene(obstacles=[BOX, {**DISC, "center": [0.5, 0.9]}]))
    nodes = scene.nodes_at("start")
    clearance, nearest = scene.clearance_at(np.add(nodes, [0.3, 0, 0]))
    assert clearance == pytest.approx(0.05)
    assert nearest == "obstacles[0] (box)"
    clearance, nearest = scene.clearance_at(np.add(nodes, [0.3, 0.4, 0]))
    assert clearance == pytest.approx(0.05)
    assert nearest == "obstacles[1] (sphere)"
    clearance, nearest = scene.clearance_at(np.subtract(nodes, [1.0, 0, 0]))
    assert clearance == pytest.approx(0.1)
    assert nearest == "the border of the workspace"


def shuffled(data, rng):
    """The same mapping with its keys in another order, at every level."""
    if isinstance(data, dict):
        keys = rng.permutation(list(data))
        return {str(key): shuffled(data[str(key)], rng) for key in keys}
    return [shuffled(item, rng) for item in data] if isinstance(data, list) else data


def test_the_checksum_is_of_the_content(tmp_path):
    """Not of layout, order of keys, comments, spelling of numbers or what stands for the default."""
    data = polygon_scene(obstacles=[BOX], limits={"speed": 1.0}, robot="baxter")
    data["load"]["mass"] = 0.5
    checksum = quiet(data).sha256
    assert re.fullmatch("[0-9a-f]{64}", checksum)
    for seed in range(5):
        assert quiet(shuffled(data, np.random.default_rng(seed))).sha256 == checksum
    for i, text in enumerate(
        [
            yaml.safe_dump(data),
            "# a comment\n\n" + yaml.safe_dump(data, default_flow_style=True, sort_keys=False),
            json.dumps(data, indent=4).replace("10.0", "1e1"),
        ]
    ):
        path = tmp_path / f"{i}.yaml"
        path.write_text(text)
        assert Scene.load(path).sha256 == checksum
    assert quiet({**data, "version": 1, "constraints": []}).sha256 == checksum


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("name",), "other"),
        (("duration",), 10.000001),
        (("manipulators", 0, "name"), "z"),
        (("manipulators", 0, "goal", 1), 0.40000000000000008),
        (("obstacles", 0, "size", 0), 0.2),
        (("limits",), {"speed": 2.0}),
    ],
    ids=str,
)
def test_other_content_has_another_checksum(path, value):
    data = bar_scene(obstacles=[BOX])
    changed = copy.deepcopy(data)
    part = changed
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = value
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ComoveWarning)
        assert Scene.from_dict(changed).sha256 != quiet(data).sha256


@pytest.mark.parametrize(
    "data",
    [bar_scene(), polygon_scene(), scene_of(TRIANGLE, TRIANGLE + 0.5, load=FRAME)],
    ids=["bar", "plate", "frame"],
)
def test_a_load_may_have_a_mass(data):
    """It is content where it is given, and nothing where it is not."""
    assert quiet(data).load_mass is None
    heavy = {**data, "load": {**data["load"], "mass": 0.25}}
    assert quiet(heavy).load_mass == 0.25
    assert quiet(heavy).sha256 != quiet(data).sha256
    assert quiet({**data, "load": {**data["load"], "mass": None}}).sha256 == quiet(data).sha256
    for wrong in (0, -1.0, np.inf, "1 kg"):
        assert refused({**data, "load": {**data["load"], "mass": wrong}}).key == "load.mass"


def test_nobody_carries_a_mass_without_a_load():
    assert quiet(scene_of([[0.0, 0.0]], [[1.0, 0.0]])).load_mass is None


def test_checksums_stay_what_they_were():
    """Results name the scene by its checksum: keys added since, which a scene leaves out, are no part of it."""
    assert quiet(bar_scene()).sha256 == "4804723594b4add8a375fa6a8779fc4dd6ba40c1f72058b9092a5f5fa44a15ab"


def test_limits_are_endless_where_none_is_given():
    scene = quiet(bar_scene())
    assert scene.speed_limit == scene.acceleration_limit == np.inf
    assert scene.clearance == 0.0


@pytest.mark.parametrize("clearance", [0.0, 0.05])
def test_an_end_that_is_just_as_near_as_it_may_be_is_told_at_reading(clearance):
    """No motion from there could be proved to keep its distance."""
    data = {
        "name": "tray",
        "duration": 4.0,
        "workspace": {"lower": [0, 0], "upper": [1, 1]},
        "load": {"shape": "box", "size": [0.3, 0.1], "grasps": {"a": [0, 0]}},
        "manipulators": [{"name": "a", "start": [0.15 + clearance, 0.4], "goal": [0.6, 0.4]}],
        "limits": {"clearance": clearance},
    }
    with pytest.raises(
        SceneError, match=r"at the start the load or a hand (touches|is only 0.05 m from) the border"
    ):
        Scene.from_dict(data)
    data["manipulators"][0]["start"][0] += 1e-6
    Scene.from_dict(data)


EXAMPLES = sorted(
    (Path(__file__).parents[2] / "examples").glob("[mr]o[vb]*/*.yaml")
)  # moving obstacles, robots


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_copies_in_another_duration_have_the_geometry_of_scenes_read_with_it(path):
    """What a copy takes over from the scene is what it would compute itself."""
    try:
        scene = Scene.load(path, check_ends=False)
    except SceneError:  # a file of something else
        return
    for name in GEOMETRY:
        getattr(scene, name)
    duration = 0.4 * scene.duration if scene.is_timed else 7.25
    copied = scene.timed(duration).limited(speed=0.3, clearance=0.011)
    alone = replace(copied)  # without what was computed
    assert set(GEOMETRY) <= vars(copied).keys()
    assert not set(GEOMETRY) & vars(alone).keys()
    for name in GEOMETRY:
        np.testing.assert_equal(getattr(copied, name), getattr(alone, name))


def test_a_copy_in_another_duration_shares_what_was_derived_of_the_geometry():
    """Computed once for all such copies; a copy whose grasp may differ computes its own."""
    calls = list[Scene]()

    @of_geometry
    def counted(scene, factor):
        calls.append(scene)
        return factor * scene.nodes_at("start")

    scene = Scene.from_dict(bar_scene())
    copies = scene.timed(3.0), scene.limited(speed=0.5), scene.timed(3.0).limited(speed=0.2)
    for own in (*copies, scene):
        assert counted(own, 2.0) is counted(scene, 2.0)
    assert len(calls) == 1
    np.testing.assert_array_equal(counted(scene, 3.0), 3.0 * scene.nodes_at("start"))
    assert counted(replace(scene), 2.0) is not counted(scene, 2.0)


def test_what_is_derived_of_a_scene_is_kept_for_the_latest_arguments():
    """Robots among them are not kept alive, and arguments that are named do not go unnoticed."""
    calls = list[int]()

    @of_geometry
    def same(scene, one):
        calls.append(one)
        return one

    scene = Scene.from_dict(bar_scene())
    assert [same(scene, k) for k in range(500)] == list(range(500))
    assert len(scene.derived) == N_DERIVED
    assert [same(scene, k) for k in range(500 - N_DERIVED, 500)] == calls[-N_DERIVED:]
    assert len(calls) == 500
    with pytest.raises(TypeError):
        same(scene, one=3)
