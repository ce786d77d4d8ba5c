"""What the constraints of a scene file mean for its groups, its ends and what must hold."""

import warnings

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.errors import ComoveWarning, SceneError
from comove.geometry.rotations import levelling
from comove.model import Scene
from comove.model.constraints import (
    DistanceConstraint,
    RelativePoseConstraint,
    SameHeightConstraint,
    SeparationConstraint,
    UprightConstraint,
)
from comove.model.groups import tilt_between
from tests import brute_force
from tests.cases import examples

from .test_scene import BAR, FRAME, TRIANGLE, apart, quiet, refused, scene_of

UPRIGHT = {"type": "upright", "tolerance_deg": 2.0}
SPATIAL_BAR = [[0.1, 0.4, 0.5], [0.1, 0.6, 0.5]]


def between(kind, first="a", second="b", **more):
    return {"type": kind, "between": [first, second], **more}


def turned(hands, degrees, axis="z"):
    """Hands (n, 3) turned about an axis through their middle."""
    hands = np.asarray(hands, dtype=float)
    middle = hands.mean(axis=0)
    return middle + Rotation.from_euler(axis, degrees, degrees=True).apply(hands - middle)


def shifted(data):
    """The scene, moved onto its constraints, and the warning that says so."""
    from comove.model import Scene

    with pytest.warns(ComoveWarning, match="was moved onto the constraints") as caught:
        scene = Scene.from_dict(data)
    return scene, str(caught[0].message)


# --- Relative pose ---


def test_a_relative_pose_in_space_is_a_full_orientation():
    """Where a distance leaves the roll about the line open."""
    goal = turned(SPATIAL_BAR, 90) + [0.8, 0, 0]
    bar = quiet(scene_of(SPATIAL_BAR, goal, constraints=[apart("a", "b", 0.2)]))
    pose = quiet(scene_of(SPATIAL_BAR, goal, constraints=[between("relative_pose")]))
    assert (bar.groups[0].orientation, pose.groups[0].orientation) == ("axis", "space")
    first, implied = pose.constraints
    assert first == RelativePoseConstraint(0, 1, pytest.approx(2e-4))
    assert implied == DistanceConstraint(0, 1, pytest.approx(0.2), first.tolerance)
    assert pose.distances == (implied,)
    assert np.abs(pose.goal - goal).max() < 1e-15


@examples(40)
@given(st.integers(0, 2**32 - 1))
def test_from_start_to_goal_a_relative_pose_turns_least(seed):
    """No roll about the line on top of the turn of the line."""
    rng = np.random.default_rng(seed)
    goal = Rotation.random(random_state=seed % 2**31).apply(np.subtract(SPATIAL_BAR, 0.5)) + 0.5
    group = quiet(
        scene_of(SPATIAL_BAR, goal + rng.uniform(-0.1, 0.1, 3), constraints=[between("relative_pose")])
    ).groups[0]
    turn = Rotation.from_matrix(group.goal.rotation @ group.start.rotation.T).magnitude()
    lines = [np.subtract(*hands) / 0.2 for hands in (SPATIAL_BAR, goal)]
    assert turn == pytest.approx(np.arccos(np.clip(lines[0] @ lines[1], -1, 1)), abs=1e-7)


def test_in_the_plane_a_relative_pose_is_a_distance():
    hands = [[0.1, 0.4], [0.1, 0.6]]
    scene = quiet(scene_of(hands, np.add(hands, 0.5), constraints=[between("relative_pose", tolerance=0.01)]))
    assert scene.groups[0].orientation == "plane"
    assert scene.distances[0].distance == pytest.approx(0.2)
    assert scene.distances[0].tolerance == 0.01


@pytest.mark.parametrize("n_dims", [2, 3])
def test_relative_poses_tie_in_chains(n_dims):
    """Two of them tie three hands, where two distances leave them free to move."""
    hands = TRIANGLE[:, :n_dims]
    chain = [between("relative_pose", "a", "b"), between("relative_pose", "c", "b", tolerance=0.01)]
    scene = quiet(scene_of(hands, hands + 0.5, constraints=chain))
    assert scene.groups[0].members == (0, 1, 2)
    pairs = {(c.first, c.second): c for c in scene.distances}
    assert set(pairs) == {(0, 1), (0, 2), (1, 2)}
    assert pairs[0, 1].tolerance == pytest.approx(2e-4)
    assert pairs[0, 2].tolerance == pairs[1, 2].tolerance == 0.01
    loose = [apart("a", "b", 0.2), between("relative_pose", "c", "b")]
    assert "free to move" in refused(scene_of(hands, hands + 0.5, constraints=loose)).message


def test_a_hand_with_a_relative_pose_goes_along_with_the_load():
    """It keeps its place beside the load, and the load its overhang."""
    hands = [[0.1, 0.4], [0.1, 0.6], [0.3, 0.5]]
    data = scene_of(
        hands,
        np.add(hands, 0.5),
        load={**BAR, "overhang": 0.1, "held_by": ["a", "b"]},
        constraints=[between("relative_pose", "a", "c")],
    )
    scene = quiet(data)
    assert scene.groups[0].members == (0, 1, 2)
    nodes = scene.nodes_at("goal")[:, :2]
    assert np.abs(nodes[:3] - scene.goal).max() < 1e-12
    assert np.allclose(nodes[3:], [[0.6, 0.8], [0.6, 1.2]])
    assert np.abs(scene.goal - np.add(hands, 0.5)).max() < 1e-12


def test_ends_of_a_relative_pose_agree_within_its_tolerance():
    goal = np.add(SPATIAL_BAR, [0.5, 0, 0])
    goal[1, 1] += 0.004
    data = scene_of(SPATIAL_BAR, goal, constraints=[between("relative_pose", tolerance=0.005)])
    scene, told = shifted(data)
    assert "goal" in told
    assert np.linalg.norm(np.subtract(*scene.goal)) == pytest.approx(0.2, abs=1e-15)
    data["constraints"] = [between("relative_pose", tolerance=0.003)]
    error = refused(data)
    assert "0.204 m apart at the goal" in error.message


# --- Separation ---


def test_a_separation_names_hands_by_number():
    scene = quiet(
        scene_of(TRIANGLE, TRIANGLE + 0.5, constraints=[between("separation", "c", "a", distance=0.1)])
    )
    assert scene.constraints == (SeparationConstraint(2, 0, 0.1, 0.0),)
    assert scene.distances == ()
    pairs, least = scene.kept_apart
    assert pairs.tolist() == [[2, 0]]
    assert least.tolist() == [0.1]


@pytest.mark.parametrize("end", ["start", "goal"])
def test_ends_that_break_a_separation_are_refused(end):
    data = scene_of([[0.0, 0.0], [0.0, 0.5]], [[1.0, 0.0], [1.0, 0.5]])
    data["manipulators"][1][end][1] = 0.29
    data["constraints"] = [between("separation", distance=0.3)]
    error = refused(data)
    assert error.key == "constraints[0]"
    assert all(part in error.message for part in ("'a' and 'b'", "0.29 m", "0.3 m", end))
    data["constraints"] = [between("separation", distance=0.3, tolerance=0.02)]
    assert quiet(data).kept_apart[1].tolist() == [pytest.approx(0.28)]


def test_ends_that_just_keep_a_separation_are_warned_of():
    from comove.model import Scene

    data = scene_of(
        [[0.0, 0.0], [0.0, 0.3]], [[1.0, 0.0], [1.0, 0.5]], constraints=[between("separation", distance=0.3)]
    )
    with pytest.warns(ComoveWarning, match="at the start 'a' and 'b' are just as far apart"):
        Scene.from_dict(data)


@pytest.mark.parametrize(("distance", "holds"), [(0.19, True), (0.2, True), (0.21, False)])
def test_hands_of_one_load_are_checked_when_the_scene_is_read(distance, holds):
    data = scene_of(
        [[0.1, 0.4], [0.1, 0.6]],
        [[0.9, 0.4], [0.9, 0.6]],
        load=BAR,
        constraints=[between("separation", distance=distance)],
    )
    if holds:
        assert len(quiet(data).kept_apart[0]) == 0
    else:
        assert "0.2 m apart at the start" in refused(data).message


# --- Upright ---


@pytest.mark.parametrize("angle", [0.0, 37.0])
def test_in_the_plane_an_upright_load_only_shifts(angle):
    """Whatever its tilt, which is that of the start."""
    start = turned([[0.1, 0.4, 0.0], [0.3, 0.4, 0.0]], angle)[:, :2]
    data = scene_of(start, start + 0.5, load={**BAR, "overhang": 0.05}, constraints=[UPRIGHT])
    scene = quiet(data)
    assert scene.groups[0].orientation == "fixed"
    assert isinstance(scene.constraints[0], UprightConstraint)
    assert scene.constraints[0].members == (0, 1)
    assert scene.constraints[0].tolerance == pytest.approx(np.radians(2.0))
    assert np.abs(scene.nodes_at("goal") - scene.nodes_at("start") - [0.5, 0.5, 0]).max() < 1e-12


@pytest.mark.parametrize("lean", [0.0, 30.0, 90.0])
def test_in_space_an_upright_load_turns_about_the_vertical(lean):
    """A bar keeps its inclination, a level one stays level."""
    start = turned(SPATIAL_BAR, lean, "x")
    goal = turned(start, 120.0, "z") + [0.5, 0.0, 0.2]
    scene = quiet(scene_of(start, goal, load=BAR, constraints=[UPRIGHT]))
    group = scene.groups[0]
    assert group.orientation == "vertical"
    turn = group.goal.rotation @ group.start.rotation.T
    assert np.abs(turn[2] - [0, 0, 1]).max() < 1e-15
    assert np.abs(scene.goal - goal).max() < 1e-12
    assert group.reach == pytest.approx(0.1 * np.cos(np.radians(lean)), abs=1e-12)


@pytest.mark.parametrize(("load", "hands"), [(BAR, SPATIAL_BAR), (FRAME, TRIANGLE)])
@pytest.mark.parametrize("n_dims", [2, 3])
def test_a_small_tilt_is_taken_back_with_a_warning_and_a_larger_one_refused(load, hands, n_dims):
    hands = np.array(hands) * ([1, 1, 0] if n_dims == 2 else 1)
    for tilt, holds in ((1.9, True), (2.1, False)):
        goal = turned(hands, tilt, "z" if n_dims == 2 else "x") + [0.5, 0.3, 0]
        goal = goal if n_dims == 2 else turned(goal, 70.0)
        data = scene_of(hands[:, :n_dims], goal[:, :n_dims], load=load, constraints=[UPRIGHT])
        if holds:
            scene, told = shifted(data)
            assert "the goal" in told
            ends = np.stack([scene.start, scene.goal])
            assert brute_force.tilts(ends)[1] < 1e-12
            assert np.abs(scene.goal - goal[:, :n_dims]).max() < 0.2 * np.radians(2)
            assert np.abs(scene.start - hands[:, :n_dims]).max() < 1e-12
        else:
            error = refused(data)
            assert "tilted by 2.1 deg at the goal" in error.message
            assert "tolerance 2 deg" in error.message


def test_a_load_upside_down_is_tilted():
    """The heights of a level triangle tell nothing of it."""
    goal = TRIANGLE * [1, -1, 1] + 0.5
    error = refused(scene_of(TRIANGLE, goal, load=FRAME, constraints=[UPRIGHT]))
    assert "tilted by 180 deg" in error.message


def test_upright_is_about_the_group_of_the_load_alone():
    hands = [*SPATIAL_BAR, [0.5, 0.1, 0.5], [0.5, 0.3, 0.5], [0.2, 0.2, 0.9]]
    goal = np.add(hands, [0.5, 0, 0])
    goal[2:4] = turned(goal[2:4], 40.0, "x")
    scene = quiet(
        scene_of(
            hands, goal, load={**BAR, "held_by": ["b", "a"]}, constraints=[UPRIGHT, apart("c", "d", 0.2)]
        )
    )
    assert [g.orientation for g in scene.groups] == ["vertical", "axis", "none"]


def test_a_plate_held_by_one_hand_goes_where_the_hand_goes():
    plate = {"shape": "polygon", "vertices": [[0, 0], [0.2, 0], [0, 0.1]], "held_by": ["a"]}
    data = scene_of([[0.1, 0.1]], [[0.6, 0.7]], load=plate, constraints=[UPRIGHT])
    assert np.allclose(quiet(data).nodes_at("goal")[1:, :2], [[0.6, 0.7], [0.8, 0.7], [0.6, 0.8]])


# --- Same height ---


def test_free_hands_meet_at_the_mean_of_their_heights():
    start = [[0.0, 0.0, 0.3], [0.0, 0.5, 0.304], [0.0, 1.0, 0.302]]
    pairs = [between("same_height", *pair, tolerance=0.004) for pair in ("ab", "bc")]
    scene, told = shifted(scene_of(start, np.add(start, [1, 0, 0.2]), constraints=pairs))
    assert "by 0.002 m" in told
    assert scene.constraints == (SameHeightConstraint(0, 1, 0.004), SameHeightConstraint(1, 2, 0.004))
    for hands, height in ((scene.start, 0.302), (scene.goal, 0.502)):
        assert hands[:, 2] == pytest.approx(height, abs=1e-15)
        assert len(set(hands[:, 2])) == 1


@pytest.mark.parametrize("end", ["start", "goal"])
def test_heights_that_differ_by_more_are_refused(end):
    data = scene_of(
        [[0.0, 0.3], [0.5, 0.3]],
        [[0.0, 0.9], [0.5, 0.9]],
        constraints=[between("same_height", tolerance=0.01)],
    )
    data["manipulators"][1][end][1] += 0.011
    error = refused(data)
    assert error.key == "constraints[0]"
    assert all(part in error.message for part in ("'a' and 'b'", "0.011 m", "0.01 m", end))


@pytest.mark.parametrize("n_dims", [2, 3])
def test_two_hands_of_one_load_stay_level(n_dims):
    """Turned least: both move by half of what they miss."""
    start = np.array([[0.1, 0.5, 0.5], [0.3, 0.5, 0.5]])[:, :n_dims]
    start[1, -1] += 0.0008
    goal = np.add(start, [0.5, *[0.2] * (n_dims - 1)])
    data = scene_of(start, goal, load=BAR, constraints=[between("same_height")])
    scene, _ = shifted(data)
    assert scene.groups[0].orientation == ("fixed" if n_dims == 2 else "vertical")
    for hands, written in ((scene.start, start), (scene.goal, goal)):
        assert abs(hands[0, -1] - hands[1, -1]) < 1e-15
        assert np.abs(hands - written).max() == pytest.approx(0.0004, rel=0.01)


def test_what_cannot_be_kept_level_is_refused():
    level = [between("same_height")]
    flipped = [[0.9, 0.5], [0.7, 0.5]]
    error = refused(scene_of([[0.1, 0.5], [0.3, 0.5]], flipped, load=BAR, constraints=level))
    assert "tilted by 180 deg at the goal" in error.message
    rolled = turned(TRIANGLE, 30.0, "x") + 0.5
    error = refused(scene_of(TRIANGLE, rolled, load=FRAME, constraints=level))
    assert "turn about the vertical only" in error.message
    hands = [*SPATIAL_BAR, [0.5, 0.5, 0.5]]
    data = scene_of(hands, np.add(hands, [0.4, 0, 0]), load={**BAR, "held_by": ["a", "b"]})
    data["constraints"] = [between("same_height", "c", "a")]
    error = refused(data)
    assert "'a' is tied to a load" in error.message
    assert error.key == "constraints[0].between"


# --- Turns ---


@examples(60)
@given(st.integers(0, 2**32 - 1))
def test_tilts_know_nothing_of_turns_about_the_vertical(seed):
    rng = np.random.default_rng(seed)
    a, b = Rotation.random(2, random_state=seed % 2**31)
    spin = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi))
    for orientation in ("axis", "space"):
        plain = tilt_between(orientation, a.as_matrix(), b.as_matrix())
        assert tilt_between(orientation, a.as_matrix(), (spin * b).as_matrix()) == pytest.approx(
            plain, abs=1e-12
        )
        assert tilt_between(orientation, a.as_matrix(), (spin * a).as_matrix()) < 1e-12
    lean = rng.uniform(0, 3.0)
    leaning = Rotation.from_rotvec(lean * np.array([np.cos(lean), np.sin(lean), 0.0]))
    assert tilt_between("space", (leaning * a).as_matrix(), a.as_matrix()) == pytest.approx(lean, abs=1e-7)
    assert tilt_between("plane", spin.as_matrix(), np.eye(3)) == pytest.approx(spin.magnitude(), abs=1e-12)


@examples(60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 2))
def test_levelling_is_the_least_rotation(seed, count):
    rng = np.random.default_rng(seed)
    vectors = rng.standard_normal((count, 3)) * [1, 1, 0.2]
    up = np.array([0.0, 0.0, 1.0])
    level = np.cross(*vectors) if count == 2 else np.cross(np.cross(vectors[0], up), vectors[0])
    assume(abs(level @ up) > 0.11 * np.linalg.norm(level))  # steeper ones are left as they are
    turn = levelling(vectors, up)
    assert np.allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.abs(vectors @ turn.T @ up).max() < 1e-12
    least = np.arcsin(abs(vectors[0] @ up) / np.linalg.norm(vectors[0]))
    if count == 1:
        assert Rotation.from_matrix(turn).magnitude() == pytest.approx(least, abs=1e-9)
    assert Rotation.from_matrix(turn).magnitude() >= least - 1e-9
    assert np.array_equal(levelling(vectors * [1, 1, 0], up).round(12), np.eye(3))


def test_everything_at_once():
    """A tray, a hand that keeps off it, two hands at one height, and a pair that moves as one."""
    tray = TRIANGLE + [0.0, 0.0, 0.5]
    others = [[0.0, 1.0, 0.2], [0.5, 1.2, 0.2], [0.9, 0.9, 0.9]]
    start = np.vstack([tray, others])
    goal = np.vstack([turned(tray, 45.0), others]) + [0.3, 0, 0.1]
    data = scene_of(
        start,
        goal,
        load={**FRAME, "held_by": ["a", "b", "c"]},
        constraints=[
            UPRIGHT,
            between("separation", "c", "d", distance=0.3),
            between("same_height", "d", "e"),
            between("separation", "e", "f", distance=0.2),
        ],
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = quiet(data)
    assert [g.orientation for g in scene.groups] == ["vertical", "none", "none", "none"]
    assert len(scene.constraints) == 4 + 3
    with pytest.raises(SceneError, match="constraints"):
        quiet(data | {"constraints": [*data["constraints"], between("same_height", "a", "f")]})


@pytest.mark.parametrize("tolerance", [0.1, 5.0, 1e9])
def test_a_separation_that_demands_nothing_is_refused(tolerance):
    data = {
        "name": "apart",
        "duration": 5.0,
        "workspace": {"lower": [0, 0], "upper": [1, 1]},
        "manipulators": [
            {"name": "a", "start": [0.1, 0.2], "goal": [0.9, 0.2]},
            {"name": "b", "start": [0.1, 0.8], "goal": [0.9, 0.8]},
        ],
        "constraints": [
            {"type": "separation", "between": ["a", "b"], "distance": 0.1, "tolerance": tolerance}
        ],
    }
    with pytest.raises(SceneError, match="leaves nothing of the distance"):
        Scene.from_dict(data)
