"""Changes by hand are functions of a scene's contents; reading them anew gives the scene that was meant."""

import numpy as np
import pytest

import comove
from comove.errors import OptionError
from comove.geometry.rotations import exponential, matrices
from comove.lab.examples import example
from comove.model import Scene
from comove.view.workbench.edits import (
    SIZES,
    Draft,
    Grip,
    History,
    contents_of,
    grips_of,
    moved,
    place_of,
    sizes_of,
    with_box,
    with_size,
    with_value,
    without_obstacle,
)

QUARTER = exponential(np.array([0.0, 0.0, np.pi / 2]))


@pytest.fixture(params=["narrow", "window", "triangle"])
def scene(request):
    return example(request.param)


def grip_of(scene, name):
    return next(grip for grip in grips_of(scene) if grip.name == name)


def test_contents_read_back_to_the_same_scene(scene):
    again = comove.Scene.from_dict(contents_of(scene), folder=scene.folder)
    assert np.array_equal(again.start, scene.start)
    assert np.array_equal(again.obstacles, scene.obstacles)
    assert contents_of(again) == contents_of(scene)


def test_a_moved_obstacle_is_where_it_was_let_go(scene):
    contents, grip = contents_of(scene), grip_of(scene, "obstacle_0")
    to = place_of(contents, grip)
    to[: scene.n_dims] += 0.01
    again = comove.Scene.from_dict(moved(contents, grip, to), folder=scene.folder)
    np.testing.assert_allclose(again.centers[0], to, atol=1e-6)
    assert contents == contents_of(scene), "a draft is never changed in place"


def test_a_start_moves_and_turns_as_one_body(scene):
    """Whatever is dragged, the distances between the hands stay, so the load can still be held."""
    contents, grip = contents_of(scene), grip_of(scene, "start_0")
    to = place_of(contents, grip)
    to[1] += 0.02
    after = np.array([m["start"] for m in moved(contents, grip, to, QUARTER)["manipulators"]])
    np.testing.assert_allclose(after.mean(axis=0), to[: scene.n_dims], atol=1e-9)
    for i in range(len(after)):
        for j in range(i):
            before = np.linalg.norm(scene.start[i] - scene.start[j])
            assert np.linalg.norm(after[i] - after[j]) == pytest.approx(before, abs=1e-9)
    turned = (scene.start[0] - scene.start.mean(axis=0)) @ matrices(QUARTER)[: scene.n_dims, : scene.n_dims].T
    np.testing.assert_allclose(after[0] - after.mean(axis=0), turned, atol=1e-9)


def test_an_obstacle_turns_about_its_centre():
    scene = example("narrow")
    contents, grip = contents_of(scene), grip_of(scene, "obstacle_0")
    turned = moved(contents, grip, place_of(contents, grip), QUARTER)["obstacles"][0]
    assert turned["rotation_deg"] == pytest.approx(90.0)
    assert turned["center"] == contents["obstacles"][0]["center"]
    twice = moved(
        {**contents, "obstacles": [turned, *contents["obstacles"][1:]]},
        grip,
        place_of(contents, grip),
        QUARTER,
    )
    assert abs(twice["obstacles"][0]["rotation_deg"]) == pytest.approx(180.0)


def test_the_path_of_a_moving_obstacle_moves_along():
    scene = comove.Scene.load(example("narrow").path.parent / "turning.yaml")
    contents, grip = contents_of(scene), grip_of(scene, "obstacle_0")
    to = place_of(contents, grip) + [0.05, -0.02, 0.0]
    again = comove.Scene.from_dict(moved(contents, grip, to), folder=scene.folder)
    times = np.linspace(0.0, scene.duration, 7)
    np.testing.assert_allclose(again.offsets(times), scene.offsets(times), atol=1e-6)
    np.testing.assert_allclose(again.centers[0] - scene.centers[0], [0.05, -0.02, 0.0], atol=1e-6)


def test_a_hinge_turns_with_its_door():
    """A door that is turned by a quarter opens as before, seen from its own frame."""
    scene = example("narrow")
    turn = {"rate_deg_per_s": 30, "hinge": [-0.05, 0.01]}
    contents, grip = contents_of(scene), grip_of(scene, "obstacle_0")
    contents["obstacles"][0]["motion"] = {"turn": turn}
    door = Scene.from_dict(contents, check_ends=False)
    turned = moved(contents, grip, place_of(contents, grip), QUARTER)
    times = np.linspace(0.0, 4.0, 7)
    again = Scene.from_dict(turned, check_ends=False)
    np.testing.assert_allclose(again.turns(times), door.turns(times))
    np.testing.assert_allclose(again.offsets(times), door.offsets(times) @ matrices(QUARTER).T, atol=1e-6)


@pytest.mark.parametrize(
    "to", [[np.nan, 0, 0], [0, 0], "here", [np.inf, 0, 0], [1e9, 0, 0], None, [[0, 0, 0]]]
)
def test_what_is_no_place_is_refused(to):
    scene = example("narrow")
    with pytest.raises(OptionError, match="finite numbers"):
        moved(contents_of(scene), grip_of(scene, "obstacle_0"), to)


def test_undo_and_redo_lead_back_and_forth():
    contents = contents_of(example("narrow"))
    drafts = [Draft(with_value(contents, "duration", 3.0 + i)) for i in range(3)]
    history = History((Draft(contents),))
    for draft in drafts:
        history = history.then(draft)
    assert history.then(drafts[-1]) is history, "what changes nothing is no step"
    assert history.undone().now == drafts[1]
    assert history.undone().redone() == history
    assert history.redone() == history
    back = history.undone().undone().undone().undone()
    assert back.now.contents == contents
    other = back.then(drafts[2])
    assert other.redone().now == drafts[2], "what was undone is gone once something else is done"


def test_limits_and_durations():
    contents = contents_of(example("narrow"))
    assert with_value(contents, "speed", 0.0)["limits"]["speed"] is None
    assert with_value(contents, "clearance", 0.0)["limits"]["clearance"] == 0.0
    assert with_value(contents, "duration", 0.0)["duration"] is None
    for value in (-1.0, np.nan, np.inf, "3", True, None):
        with pytest.raises(OptionError):
            with_value(contents, "speed", value)


def test_a_longer_bar_moves_the_hands_apart():
    scene = example("narrow")
    again = comove.Scene.from_dict(with_value(contents_of(scene), "bar", 0.3))
    assert np.linalg.norm(again.start[0] - again.start[1]) == pytest.approx(0.3, abs=1e-9)
    np.testing.assert_allclose(again.start.mean(axis=0), scene.start.mean(axis=0), atol=1e-9)
    with pytest.raises(OptionError, match="only a bar"):
        with_value(contents_of(example("triangle")), "bar", 0.3)


@pytest.mark.parametrize("keys", [{"method": "magic"}, {"objective": "rm -rf"}, {"resemblance": 2.0}])
def test_a_draft_asks_for_what_there_is(keys):
    with pytest.raises(OptionError):
        Draft(contents_of(example("narrow")), **keys)


def test_every_obstacle_and_both_ends_of_every_group_can_be_taken(scene):
    names = [grip.name for grip in grips_of(scene)]
    assert len(names) == len(set(names)) == len(scene.file.obstacles) + 2 * len(scene.groups)
    assert Grip("start", 0).name == "start_0"


def test_an_added_box_reads_back_as_a_named_obstacle_and_can_be_taken_away(scene):
    contents = contents_of(scene)
    once = with_box(contents)
    twice = Scene.from_dict(with_box(once), folder=scene.folder)
    *before, first, second = twice.file.obstacles
    assert len(before) == len(scene.file.obstacles)
    assert (first.name, second.name) == ("box_1", "box_2") and first.size == second.size
    np.testing.assert_allclose(first.center, 0.5 * (scene.lower + scene.upper), atol=1e-6)
    assert without_obstacle(once, len(before)) == contents


@pytest.mark.parametrize(
    "obstacle",
    [
        {"shape": "box", "center": [0.5, 0.5, 0.5], "size": [0.1, 0.2, 0.3]},
        {"shape": "sphere", "center": [0.5, 0.5, 0.5], "radius": 0.1},
        {"shape": "capsule", "center": [0.5, 0.5, 0.5], "radius": 0.1, "length": 0.3},
        {"shape": "cylinder", "center": [0.5, 0.5, 0.5], "radius": 0.1, "height": 0.3},
        {"shape": "ellipsoid", "center": [0.5, 0.5, 0.5], "radii": [0.1, 0.2, 0.3]},
        {"shape": "mesh", "center": [0.5, 0.5, 0.5], "file": "wall.obj", "scale": 0.5},
    ],
    ids=lambda obstacle: obstacle["shape"],
)
def test_every_size_of_an_obstacle_can_be_changed_alone(obstacle):
    contents = {"obstacles": [obstacle]}
    sizes = sizes_of(contents, 0)
    assert 0 < len(sizes) <= len(SIZES)
    for number in range(len(sizes)):
        after = [size[-1] for size in sizes_of(with_size(contents, 0, number, 0.77), 0)]
        assert after == [0.77 if i == number else size[-1] for i, size in enumerate(sizes)]
    for number, value in ((len(sizes), 0.1), (0, 0.0), (0, float("nan")), (0, "1"), (0, True)):
        with pytest.raises(OptionError, match="a number above 0"):
            with_size(contents, 0, number, value)


@pytest.mark.parametrize("end", ["start", "goal"])
def test_a_payload_with_poses_moves_and_turns_as_one_body(end):
    """Its box goes along with its hands, and so do all ways to put it down."""
    box = {"shape": "box", "size": [0.3, 0.2]}
    box |= {"start": {"position": [0.3, 0.3]}, "goal": {"position": [0.7, 0.7], "free": "yaw"}}
    scene = Scene.from_dict(
        {
            "version": 2,
            "name": "box",
            "workspace": {"lower": [0, 0], "upper": [1, 1]},
            "payload": box,
            "grasps": {"left": {"position": [-0.1, 0]}, "right": {"position": [0.1, 0.05]}},
        }
    )
    contents, grip = contents_of(scene), grip_of(scene, f"{end}_0")
    to = place_of(contents, grip) + [0.02, -0.03, 0]
    again = Scene.from_dict(moved(contents, grip, to, QUARTER), check_ends=False)
    turn, middle = matrices(QUARTER), place_of(contents, grip)
    for before, after in zip(scene.alternatives, again.alternatives, strict=True):
        nodes = to + (before.nodes_at(end) - middle) @ turn.T
        assert after.nodes_at(end) == pytest.approx(nodes, abs=1e-9)
