"""What constraints keep of a pose is kept by construction, and certified; the oracle is scipy's Rotation."""

import re
import warnings
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove import solve
from comove.control.safety.twists import poses_of
from comove.dmp import motion_basis
from comove.errors import ComoveWarning, SceneError
from comove.model import CoordinatedMotion, Scene, load_coordinates
from comove.model.constraints import DirectionConstraint, RotationConstraint
from comove.model.coordinates import HandPoses, poses_at, projected_coordinates
from comove.model.shapes import spatial
from comove.verification.bounds import node_bounds
from comove.verification.verify import MotionCourse, verify
from tests.cases import examples

SLANTED = np.array([1.0, 2.0, 2.0]) / 3.0
START = Rotation.from_euler("xyz", [10.0, 20.0, 40.0], degrees=True)
SCENE = {
    "version": 2,
    "name": "masked",
    "duration": 4.0,
    "workspace": {"lower": [0, 0, 0], "upper": [1, 1, 1]},
    "payload": {"shape": "box", "size": [0.3, 0.1, 0.05], "start": {}, "goal": {}},
    "grasps": {"a": {"position": [-0.15, 0, 0]}, "b": {"position": [0.15, 0, 0]}},
}


def pose(position, turn):
    return {"position": [*map(float, position)], "quaternion_wxyz": turn.as_quat(scalar_first=True).tolist()}


def held(constraint, turn=None, shift=(0.4, 0.3, 0.1), start=START, **further):
    """Return a scene whose payload turns by a rotation of the world, and is shifted."""
    data = deepcopy(SCENE) | further
    first = np.array([0.3, 0.35, 0.45])
    goal = start if turn is None else turn * start
    data["payload"] |= {"start": pose(first, start), "goal": pose(first + shift, goal)}
    return data | {"constraints": [constraint] if isinstance(constraint, dict) else constraint}


def about(axis, degrees):
    return Rotation.from_rotvec(np.deg2rad(degrees) * np.asarray(axis))


SHIFT = np.array([2.0, -1.0, 0.0]) / 10.0  # in the plane across SLANTED
KEPT = [
    ({"type": "no_rotation"}, None, (0.4, 0.3, 0.1), None, None),
    ({"type": "axis", "axis": [2, 4, 4]}, about(SLANTED, 70.0), (0.4, 0.3, 0.1), SLANTED, None),
    ({"type": "axis", "axis": [0, 0, 1]}, about([0, 0, 1], -50.0), (0.4, 0.3, 0.1), np.eye(3)[2], None),
    (
        {"type": "axis", "axis": [1, 0, 0], "frame": "payload"},
        about(START.apply([1, 0, 0]), 35.0),
        (0.4, 0.3, 0.1),
        START.apply([1, 0, 0]),
        None,
    ),
    ({"type": "planar"}, about([0, 0, 1], 80.0), (0.4, 0.3, 0.0), np.eye(3)[2], np.eye(3)[2]),
    ({"type": "planar", "normal": [1, 2, 2]}, about(SLANTED, -60.0), SHIFT, SLANTED, SLANTED),
]


@pytest.mark.parametrize(("constraint", "turn", "shift", "axis", "normal"), KEPT)
def test_whatever_a_search_does_keeps_it_to_rounding(constraint, turn, shift, axis, normal):
    """Any weights give a motion that keeps it, and its certificate says so; so are planes and axes of the payload."""
    scene = Scene.from_dict(held(constraint, turn, shift))
    coordinates, basis = load_coordinates(scene), motion_basis(12, "jerk")
    weights = 0.05 * np.random.default_rng(0).normal(size=(coordinates.n_columns, 12))
    motion = CoordinatedMotion(scene, coordinates, basis, coordinates.boundary(), weights)
    s = np.linspace(0.0, 1.0, 1001)
    hands = motion.hands(s)[0]
    poses = poses_at(coordinates, motion.at(s)[0])
    turned = Rotation.from_quat(poses.quaternion[:, 0], scalar_first=True)
    turned *= turned[0].inv()
    if axis is None:
        assert np.abs(turned.as_rotvec()).max() < 1e-12
    else:
        assert np.linalg.norm(np.cross(turned.as_rotvec(), axis), axis=1).max() < 1e-12
        assert turned.magnitude().max() > 0.5  # it does turn
    if normal is not None:
        assert np.abs((hands - hands[0]) @ normal).max() < 1e-12
    assert np.ptp(hands, axis=0).max() > 0.1
    verdict = verify(motion)
    assert not [reason for reason in verdict.reasons if "payload" in reason]
    assert verdict.report.constraint_excess_max <= 0.0


FLAT = {
    "workspace": {"lower": [0, 0], "upper": [1, 1]},
    "payload": {
        "shape": "polygon",
        "vertices": [[-0.1, -0.05], [0.1, -0.05], [0.0, 0.1]],
        "start": {"position": [0.3, 0.3], "angle_deg": 40},
        "goal": {"position": [0.7, 0.6], "angle_deg": 40},
    },
    "grasps": {"a": {"position": [-0.1, -0.05]}, "b": {"position": [0.1, -0.05]}},
}
BAR = {"shape": "bar", "length": 0.3, "radius": 0.01}
POSED = [
    *(held(constraint, turn, shift) for constraint, turn, shift, *_ in KEPT),
    held({"type": "upright"}, about([0, 0, 1], 70.0)),
    held({"type": "upright", "tolerance_deg": 40}, about([0, 0, 1], 70.0)),
    held([], None, grasps={"a": {"position": [-0.15, 0.02, 0]}}),
    held([], about(SLANTED, 40.0)),
    SCENE | FLAT | {"constraints": [{"type": "no_rotation"}]},
    SCENE | FLAT | {"constraints": [{"type": "upright"}]},
]
for one in (held([], about(SLANTED, 40.0)), held({"type": "upright"}, about([0, 0, 1], 70.0))):
    one["payload"] = BAR | {end: one["payload"][end] for end in ("start", "goal")}
    POSED.append(one)


@pytest.mark.parametrize("data", POSED)
def test_the_pose_of_a_group_is_that_of_its_payload(data):
    """In the world and in the payload's own frame, whatever of it is kept: in plans, and as an execution goes."""
    scene = Scene.from_dict(data)
    coordinates, basis = load_coordinates(scene), motion_basis(12, "jerk")
    weights = 0.03 * np.random.default_rng(0).normal(size=(coordinates.n_columns, 12))
    motion = CoordinatedMotion(scene, coordinates, basis, coordinates.boundary(), weights)
    s, n_dims = np.linspace(0.0, 1.0, 101), scene.n_dims
    poses, hands = poses_at(coordinates, motion.at(s)[0]), motion.hands(s)[0]
    start = data["payload"]["start"]
    turn = Rotation.from_euler("z", start.get("angle_deg", 0.0), degrees=True)
    if "quaternion_wxyz" in start:
        turn = Rotation.from_quat(start["quaternion_wxyz"], scalar_first=True)
    for found in (HandPoses(poses.center[0], poses.quaternion[0]), poses_of(scene, "start")):
        assert (Rotation.from_quat(found.quaternion[0], scalar_first=True) * turn.inv()).magnitude() < 1e-9
        np.testing.assert_allclose(found.center[0, :n_dims], start["position"], atol=1e-12)
    turned = Rotation.from_quat(poses.quaternion[:, 0], scalar_first=True)
    for hand, grasp in enumerate(data["grasps"].values()):
        there = poses.center[:, 0] + turned.apply(spatial(np.array(grasp["position"])))
        np.testing.assert_allclose(there[:, :n_dims], hands[:, hand], atol=1e-12)


@pytest.mark.parametrize("way", [[0, 0.2, 0], [0, -0.2, 0], [-0.2, 0, 0], [-0.1, 0.1, 0.1]])
def test_the_x_axis_of_a_bar_points_along_it(way):
    """In files of version 1 as well, with a bar that stays upright, whichever way it points."""
    first = np.array([[0.3, 0.5, 0.3], [0.3, 0.5, 0.3] + np.array(way)])
    goal = first + [0.3, 0.1, 0.2]
    ends = zip("ab", first.tolist(), goal.tolist(), strict=True)
    data = {
        "name": "old",
        "duration": 4.0,
        "workspace": {"lower": [0, 0, 0], "upper": [1, 1, 1]},
        "load": {"shape": "bar", "length": float(np.linalg.norm(way))},
        "manipulators": [{"name": name, "start": start, "goal": end} for name, start, end in ends],
        "constraints": [{"type": "upright"}],
    }
    scene = Scene.from_dict(data)
    turn = Rotation.from_quat(poses_of(scene, "start").quaternion[0], scalar_first=True).as_matrix()
    np.testing.assert_allclose(turn[:, 0], way / np.linalg.norm(way), atol=1e-12)
    assert turn[2, 2] > 0.5  # not upside down
    coordinates = load_coordinates(scene)
    (own,) = poses_at(coordinates, coordinates.boundary()[0]).quaternion
    np.testing.assert_allclose(np.abs(own @ poses_of(scene, "start").quaternion[0]), 1.0, atol=1e-12)


def free_motion(turn, seed):
    """A motion that nothing constrains, as the verifier sees it, and rotations from its start."""
    free = Scene.from_dict(held([], turn))
    coordinates, basis = load_coordinates(free), motion_basis(12, "jerk")
    weights = 0.05 * np.random.default_rng(seed).normal(size=(coordinates.n_columns, 12))
    motion = CoordinatedMotion(free, coordinates, basis, coordinates.boundary(), weights)
    position = coordinates.motion(motion.knots)[0, :, :2]
    turned = Rotation.from_quat(
        poses_at(coordinates, motion.at(np.linspace(0, 1, 5001))[0]).quaternion[:, 0], scalar_first=True
    )
    return MotionCourse(motion, node_bounds(motion), position), turned * turned[0].inv()


def test_the_bound_of_a_free_motion_is_that_of_its_samples():
    """The angle between a payload's direction and the world's is bounded by little more than its largest sample."""
    course, turned = free_motion(about(SLANTED, 50.0), 1)
    own, world = START.apply([0.0, 1.0, 0.0]), np.eye(3)[0]
    constraint = DirectionConstraint((0, 1), 0.1, own, world)
    there = turned.apply(own)
    worst = np.arccos(np.clip(there @ world, -1, 1)).max()
    assert worst <= constraint.bound(course) < worst + 1e-3
    assert "leans by up to" in constraint.reason(constraint.bound(course), ("a", "b"))


@pytest.mark.parametrize("n_level", [2, 3])
def test_a_payload_in_a_plane_leaves_end_effectors_beside_it_at_one_height(n_level):
    """Their height is one direction of the coordinates, however many share it; the payload keeps its plane."""
    beside = {
        name: {"start": [0.1, y, 0.2], "goal": [0.3, y, 0.3]}
        for name, y in zip("cde", (0.1, 0.9, 0.6), strict=True)
    }
    level = [{"type": "same_height", "between": [*pair]} for pair in ("cd", "de")[: n_level - 1]]
    data = held([{"type": "planar", "normal": [1, 2, 2]}, *level], about(SLANTED, 40.0), SHIFT)
    scene = Scene.from_dict(data | {"end_effectors": beside})
    coordinates, basis = load_coordinates(scene), motion_basis(12, "jerk")
    assert coordinates.free.shape == (coordinates.n_columns, 2 + 2 + 3 * 3 - (n_level - 1))
    np.testing.assert_allclose(
        coordinates.free.T @ coordinates.free, np.eye(coordinates.free.shape[1]), atol=1e-12
    )
    weights = 0.05 * np.random.default_rng(0).normal(size=(coordinates.n_columns, 12))
    motion = CoordinatedMotion(scene, coordinates, basis, coordinates.boundary(), weights)
    hands = motion.hands(np.linspace(0.0, 1.0, 1001))[0]
    assert np.abs((hands[:, :2] - hands[0, :2]) @ SLANTED).max() < 1e-12
    assert np.ptp(hands[:, 2 : 2 + n_level, 2], axis=1).max() == 0.0 < 0.1 < np.ptp(hands[:, 2, 2])
    np.testing.assert_allclose(hands[[0, -1]], [scene.start, scene.goal], atol=1e-12)
    assert not [reason for reason in verify(motion).reasons if "height" in reason or "payload" in reason]


def test_a_search_by_projected_hands_stays_in_the_plane():
    """What hands say is mapped onto what the payload keeps."""
    crossed = [{"type": "planar"}, {"type": "no_rotation"}]
    coordinates = projected_coordinates(Scene.from_dict(held(crossed, None, (0.4, 0.3, 0.0))))
    np.testing.assert_allclose(coordinates.search[2], 0.0, atol=1e-15)
    assert np.linalg.matrix_rank(coordinates.search) == 2


@pytest.mark.parametrize("normal", [[1, 2, 2], [0, 0, 1]])
def test_a_second_plane_is_refused(normal):
    """One parallel to the first says nothing new, one across it would leave a line; either alone is read."""
    planes = [{"type": "planar", "normal": [1, 2, 2]}, {"type": "planar", "normal": normal}]
    data = held(planes, None, np.cross(SLANTED, [0.0, 0.0, 0.3]))
    with pytest.raises(SceneError, match=r"planar is already given by constraints\[0\]; keep one") as raised:
        Scene.from_dict(data)
    assert raised.value.key == "constraints[1]"
    for plane in planes:
        Scene.from_dict(data | {"constraints": [plane]})


@examples(15)
@given(st.integers(0, 2**32 - 1))
def test_no_rotation_is_larger_than_its_bound(seed):
    """About any axes one after the other; no direction of the payload alone tells the angle of its rotation."""
    turn = Rotation.random(random_state=np.random.default_rng(seed))
    course, turned = free_motion(turn, seed)
    worst = turned.magnitude().max()
    bound = RotationConstraint((0, 1), 0.1).bound(course)
    widest = min(np.sqrt(1.5) * np.sin(min(worst + 2e-3, np.pi) / 2), 1.0)  # where all three axes turn as far
    assert worst <= bound <= 2 * np.arcsin(widest)


PILLAR = {"shape": "box", "center": [0.5, 0.5, 0.5], "size": [0.08, 0.08, 1.0]}


@pytest.mark.parametrize("normal", [[0, 0, 1], [1, 2, 2]])
def test_a_plane_is_kept_around_an_obstacle(normal):
    """The way around a pillar is planned and optimised in the plane."""
    way = np.cross(normal, [0.0, 0.0, 1.0]) if normal[0] else np.array([1.0, 0.3, 0.0])
    shift, unit = 0.6 * way / np.linalg.norm(way), np.array(normal) / np.linalg.norm(normal)
    data = held({"type": "planar", "normal": normal}, about(unit, 40.0), shift, start=Rotation.identity())
    for end, side in (("start", -0.5), ("goal", 0.5)):
        data["payload"][end]["position"] = (np.full(3, 0.5) + side * shift).tolist()
    solution = solve(Scene.from_dict(data | {"obstacles": [PILLAR]}), seed=0)
    assert solution.verified, solution.reasons
    position = solution.trajectory.position
    assert np.abs((position - position[0]) @ unit).max() < 1e-12


def test_a_payload_leans_within_its_tolerance():
    """A goal that leans is reached exactly, and on the way the payload never leans further than it may."""
    up = [0, 0, 1]
    low = {"shape": "box", "center": [0.5, 0.5, 0.2], "size": [0.1, 1.0, 0.4]}
    high = {"shape": "box", "center": [0.5, 0.5, 0.8], "size": [0.1, 1.0, 0.4]}
    data = held({"type": "upright", "tolerance_deg": 12, "up": up}, start=Rotation.identity())
    tilted = Rotation.from_euler("xyz", [0.0, 9.0, 90.0], degrees=True)
    data["payload"] |= {"start": pose([0.2, 0.5, 0.5], about(up, 30)), "goal": pose([0.8, 0.5, 0.6], tilted)}
    solution = solve(Scene.from_dict(data | {"obstacles": [low, high]}), seed=0)
    assert solution.verified, solution.reasons
    motion = solution.motion.motion
    q = motion.at(np.linspace(0.0, 1.0, 2001))[0]
    turned = Rotation.from_quat(poses_at(motion.coordinates, q).quaternion[:, 0], scalar_first=True)
    up_axis = turned.as_matrix()[:, :, 2]
    leaning = np.arctan2(np.hypot(up_axis[:, 0], up_axis[:, 1]), up_axis[:, 2])
    assert leaning[-1] == pytest.approx(np.deg2rad(9.0), abs=1e-9)
    assert leaning.max() <= solution.report.tilt_max <= np.deg2rad(12.0)


LEVEL, PLACE = {"type": "upright", "tolerance_deg": 0.5}, (0.4, 0.3, 0.1)
X, Z = {"type": "axis", "axis": [1, 0, 0]}, {"type": "axis", "axis": [0, 0, 1]}
REFUSED = [
    ([{"type": "no_rotation"}], about(SLANTED, 30.0), PLACE),
    ([X], about([0, 0, 1], 30.0), PLACE),
    ([{"type": "planar"}], about([0, 0, 1], 30.0), (0.3, 0.3, 0.2)),
    ([{"type": "upright", "tolerance_deg": 10}], about([1, 0, 0], 17.5), PLACE),
    ([{"type": "upright", "tolerance_deg": 10}], about([1, 0, 0], 60.0), PLACE),
    ([{"type": "upright", "tolerance_deg": 10}], about([1, 0, 0], 180.0), PLACE),
    ([LEVEL], about([1, 0, 0], 17.5), PLACE),
    ([LEVEL], about([1, 0, 0], 60.0), PLACE),
    ([LEVEL, X], about([0, 0, 1], 30.0), PLACE),
    ([{"type": "planar"}, {"type": "no_rotation"}], about([0, 0, 1], 30.0), (0.3, 0.3, 0.0)),
    ([{"type": "planar", "normal": [0, 1, 0]}, Z], about([0, 0, 1], 30.0), (0.3, 0.0, 0.1)),
    ([{"type": "planar"}, X], about(SLANTED, 30.0), (0.3, 0.3, 0.0)),
]


def follow(data, error):
    """Change a scene as an error says, word by word."""
    advice, constraints = error.way_out, data["constraints"]
    named = [int(number) for number in re.findall(r"constraints\[(\d)\]", f"{advice} {error.key}")]
    if "{type: axis" in advice:
        constraints[named[0]] = yaml.safe_load(advice[advice.index("{") : advice.index("}") + 1])
    elif "goal position" in advice:
        place = advice[advice.index("[") : advice.index("]") + 1]
        data["payload"]["goal"]["position"] = yaml.safe_load(place)
    elif wide := re.search(r"tolerance_deg: ([\d.]+)", advice):
        constraints[named[0]]["tolerance_deg"] = float(wide[1])
    else:
        assert "leave" in advice
        data["constraints"] = [c for i, c in enumerate(constraints) if i not in named]


@pytest.mark.parametrize(("constraints", "turn", "shift"), REFUSED)
def test_a_goal_that_needs_what_is_kept_is_refused_with_advice_that_works(constraints, turn, shift):
    """The message names the constraints and says what to write; what it says is accepted."""
    data = held(deepcopy(constraints), turn, shift)
    with pytest.raises(SceneError) as raised:
        Scene.from_dict(data)
    follow(data, raised.value)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ComoveWarning)  # an axis is told with four digits
        Scene.from_dict(data)


def test_in_the_plane_advice_is_no_axis():
    """A turned goal may keep the orientation of the start, or the constraint is left out."""
    data = {
        "version": 2,
        "name": "flat",
        "workspace": {"lower": [0, 0], "upper": [1, 1]},
        "payload": {
            "shape": "box",
            "size": [0.2, 0.1],
            "start": {"position": [0.3, 0.3], "angle_deg": 10},
            "goal": {"position": [0.7, 0.6], "angle_deg": 90},
        },
        "grasps": {"a": {"position": [-0.1, 0]}, "b": {"position": [0.1, 0]}},
        "constraints": [{"type": "no_rotation"}],
    }
    with pytest.raises(SceneError, match="80 deg from its start") as raised:
        Scene.from_dict(data)
    assert "leave constraints[0] out" in raised.value.way_out
    Scene.from_dict(data | {"constraints": []})
    data["payload"]["goal"]["angle_deg"] = float(re.search(r"angle_deg: (\S+)", raised.value.way_out)[1])
    Scene.from_dict(data)


def test_a_goal_within_the_tolerance_is_moved_onto_the_constraint():
    """As with all constraints, and a warning names the shift."""
    data = held({"type": "planar"}, about([0, 0, 1], 30.0), (0.4, 0.3, 5e-4))
    with pytest.warns(ComoveWarning, match="goal was moved"):
        scene = Scene.from_dict(data)
    assert scene.groups[0].goal.center[2] == pytest.approx(scene.groups[0].start.center[2], abs=1e-12)


def test_masks_are_for_payloads_with_poses_in_space():
    """In the plane, and for loads without poses, they are refused with what to do."""
    flat = {
        "version": 2,
        "name": "flat",
        "duration": 4.0,
        "workspace": {"lower": [0, 0], "upper": [1, 1]},
        "payload": {
            "shape": "box",
            "size": [0.2, 0.1],
            "start": {"position": [0.3, 0.3]},
            "goal": {"position": [0.7, 0.6]},
        },
        "grasps": {"a": {"position": [-0.1, 0]}, "b": {"position": [0.1, 0]}},
        "constraints": [{"type": "planar"}],
    }
    with pytest.raises(SceneError, match="the scene is planar"):
        Scene.from_dict(flat)
    scene = Scene.from_dict(flat | {"constraints": [{"type": "no_rotation"}]})
    solution = solve(scene, seed=0)
    assert solution.verified
    apart = solution.trajectory.position[:, 1] - solution.trajectory.position[:, 0]
    assert np.abs(apart - [0.2, 0.0]).max() < 1e-12
    old = {
        "name": "old",
        "duration": 4.0,
        "workspace": {"lower": [0, 0, 0], "upper": [1, 1, 1]},
        "load": {"shape": "bar", "length": 0.2},
        "manipulators": [
            {"name": "a", "start": [0.3, 0.3, 0.3], "goal": [0.6, 0.6, 0.3]},
            {"name": "b", "start": [0.5, 0.3, 0.3], "goal": [0.8, 0.6, 0.3]},
        ],
        "constraints": [{"type": "axis", "axis": [0, 0, 1]}],
    }
    with pytest.raises(SceneError, match="comove scene upgrade"):
        Scene.from_dict(old)


KINDS = {"upright": "axis", "no_rotation": "no_rotation", "axis": "axis", "planar": "planar"}
"""Constraint kinds by the words of scene files; `upright` with a tolerance bounds the angle of an axis."""


def of_the_page():
    """The example in the documentation of scenes, and the constraints of its table."""
    page = (Path(__file__).parents[2] / "docs" / "scenes.md").read_text(encoding="utf-8")
    _, _, part = page.partition("## Constraints on the payload")
    example = yaml.safe_load(part.split("```yaml\n")[1].split("```")[0])
    return example, [
        yaml.safe_load(text) for text in re.findall(r"^\| `(\{type: .*?\})` \|", part, re.MULTILINE)
    ]


def test_the_example_of_the_page_is_solved_and_its_words_are_read():
    example, words = of_the_page()
    assert solve(Scene.from_dict(example), seed=0).verified
    assert [word["type"] for word in words] == ["upright", "no_rotation", "axis", "planar"]
    for word in words:
        level = deepcopy(example) | {"constraints": [word]}
        level["payload"]["goal"]["rpy_deg"] = [0, 0, 0]
        assert Scene.from_dict(level).constraints[0].kind == KINDS[word["type"]]
