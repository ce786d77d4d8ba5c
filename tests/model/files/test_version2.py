"""Scenes of version 2 say where the payload is and how it is held; those of version 1 become the same scenes."""

import copy
import json
import re
import warnings
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import comove
from comove.control.executor import Executor
from comove.control.safety.twists import nodes_of
from comove.errors import ComoveWarning, RobotError, SceneError
from comove.io.yaml_reader import read_yaml
from comove.model.candidates import DEPTH, OPENING
from comove.model.files.keys import canonical
from comove.model.files.upgrade import as_text, upgraded
from comove.model.files.version2 import MAX_CHOICES
from comove.model.free_goals import TurnSettings
from comove.model.scene import Scene
from comove.robots.effort import load_mass
from comove.verification.record import verify_execution
from comove.view.workbench.edits import contents_of
from comove.view.workbench.saving import scene_text
from tests.cases import examples
from tests.meshes import l_profile, write_obj
from tests.schema import satisfies

ROOT = Path(__file__).parents[3]
FILES = sorted(
    [
        *ROOT.glob("examples/*/*.yaml"),
        *ROOT.glob("src/comove/examples/*.yaml"),
        *ROOT.glob("src/comove/lab/sets/*/*.yaml"),
    ]
)
seeds = st.integers(0, 2**32 - 1)

TRAY = """\
version: 2
name: tray
duration: 8.0
workspace: {lower: [-1, -1, 0], upper: [1, 1, 2]}
obstacles:
  - {shape: box, center: [0.8, 0.8, 0.5], size: [0.1, 0.1, 0.1]}
payload:
  shape: box
  size: [0.4, 0.2, 0.05]
  start: {position: [0, 0.3, 1], rpy_deg: [0, 0, 90]}
  goal: {position: [0, -0.3, 1], rpy_deg: [0, 35, 90]}
grasps:
  left: {position: [-0.2, 0, 0], approach: [0, 0, -1], closing: [0, 1, 0]}
  right: {position: [0.2, 0, 0], approach: [0, 0, -1], closing: [0, 1, 0]}
"""
PLANAR = {
    "version": 2,
    "name": "narrow",
    "duration": 10.0,
    "workspace": {"lower": [0, 0], "upper": [1, 1]},
    "obstacles": [{"shape": "box", "center": [0.5, 0.2], "size": [0.1, 0.4]}],
    "payload": {
        "shape": "bar",
        "length": 0.2,
        "start": {"position": [0.15, 0.5], "angle_deg": 90},
        "goal": {"position": [0.85, 0.5], "angle_deg": 60},
    },
    "grasps": {"left": {"position": [-0.1, 0]}, "right": {"position": [0.1, 0]}},
}


def tray(tmp_path, *changes):
    """The scene of a file in which texts are replaced."""
    text = TRAY
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "tray.yaml").write_text(text)
    return Scene.load(tmp_path / "tray.yaml")


def changed(data, **keys):
    """A copy of a scene's contents with other keys, of which None are left out."""
    return {key: value for key, value in (copy.deepcopy(data) | keys).items() if value is not None}


def require_same(one, other, tolerance=1e-12):
    """Two scenes are the same: hands, payload at both ends, groups, body, obstacles, and how it may be held."""
    assert one.manipulators == other.manipulators
    n = len(one.nodes_at("start"))  # a robot's payload may have keypoints besides
    for end in ("start", "goal"):
        assert np.abs(other.nodes_at(end)[:n] - one.nodes_at(end)).max() < tolerance
    assert [g.members for g in one.groups] == [g.members for g in other.groups]
    assert [g.orientation for g in one.groups] == [g.orientation for g in other.groups]
    assert np.array_equal(one.body.edges, other.body.edges)
    assert np.array_equal(one.body.solids, other.body.solids)
    assert np.allclose(one.body.radii, other.body.radii, rtol=0, atol=tolerance)
    assert np.array_equal(one.obstacles, other.obstacles)
    assert one.file.limits == other.file.limits
    assert one.motions == other.motions
    assert len(one.alternatives) == len(other.alternatives)
    for this, that in zip(one.alternatives, other.alternatives, strict=True):
        assert (this.grasp is None) == (that.grasp is None)
        for end in ("start", "goal") if this.grasp is not None else ():
            turned, also = (one.grasp.hand_rotations(one.nodes_at(end)) for one in (this, that))
            assert np.abs(turned - also).max() < 10 * tolerance


def again(scene, data, folder):
    """The scene of version 2 that a scene of version 1 becomes, by way of its text."""
    contents = read_text(as_text(upgraded(scene, data)), folder)
    return Scene.from_dict(contents, folder=scene.folder, check_ends=False)


@pytest.mark.few(12)
@pytest.mark.filterwarnings("ignore::comove.errors.ComoveWarning")
@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_files_of_version_1_become_the_same_scenes(path, tmp_path):
    data, _ = read_yaml(path)
    if "manipulators" not in data:
        pytest.skip("no scene of version 1")
    scene = Scene.load(path, check_ends=False)
    require_same(scene, again(scene, data, tmp_path))


def any_scene(rng):
    """A random scene of version 1, whose hands are where poses of its load place them."""
    n = int(rng.integers(2, 4))
    shape = str(rng.choice(["bar", "frame", "box", *(["polygon"] if n == 2 else [])]))
    names = [f"hand{i}" for i in range(2 if shape == "bar" else int(rng.integers(2, 5)))]
    held = np.zeros((len(names), 3))
    held[:, :n] = rng.uniform(-0.3, 0.3, (len(names), n))
    load = {"shape": shape, "mass": 1.5} | ({"radius": 0.01} if shape != "box" else {})
    upright = n == 3 and (rng.random() < 0.5 or (shape == "box" and len(names) == 2))
    if shape == "bar":
        length = float(rng.uniform(0.1, 0.5))
        load |= {"length": length, "overhang": float(rng.choice([0.0, 0.05])), "held_by": names[::-1]}
        held = np.array([[0.5 * length, 0, 0], [-0.5 * length, 0, 0]])
    elif shape == "frame":
        load["edges"] = [[names[i - 1], name] for i, name in enumerate(names) if i]
    else:
        load["grasps"] = {name: held[i, :n].tolist() for i, name in enumerate(names)}
        load |= {"size": [0.4] * n} if shape == "box" else {"vertices": [[-0.2, 0], [0.3, -0.1], [0.1, 0.4]]}
    turns = Rotation.from_rotvec(rng.uniform(-3, 3, (2, 1)) * [0, 0, 1])
    if n == 3 and not upright:
        turns = Rotation.random(2, random_state=rng.integers(2**31))
    elif n == 3 and shape != "box":
        turns = turns * Rotation.random(random_state=rng.integers(2**31))
    elif upright:
        held[:, 2] = held[0, 2]  # level, as boxes begin
        load["grasps"] = {name: held[i].tolist() for i, name in enumerate(names)}
    at = np.zeros((2, 3))
    at[:, :n] = rng.uniform(-1, 1, (2, n))
    start, goal = ((at[k] + turns[k].apply(held))[:, :n].tolist() for k in (0, 1))
    return {
        "name": "any",
        "workspace": {"lower": [-3] * n, "upper": [3] * n},
        "load": load,
        "manipulators": [{"name": name, "start": start[i], "goal": goal[i]} for i, name in enumerate(names)],
        "constraints": [{"type": "upright"}] if upright else [],
    }


@pytest.mark.filterwarnings("ignore::comove.errors.ComoveWarning")
@examples(200)
@given(seeds)
def test_random_scenes_of_version_1_become_the_same(seed):
    data = any_scene(np.random.default_rng(seed))
    scene = Scene.from_dict(data, check_ends=False)
    with TemporaryDirectory() as folder:
        require_same(scene, again(scene, data, Path(folder)), tolerance=1e-11)


def test_a_planar_scene_equals_its_twin():
    """Hands are where the pose puts their grasps, and the checksum of all else is that of version 1."""
    scene = Scene.from_dict(PLANAR)
    hands = [(m.start, m.goal) for m in scene.file.manipulators]
    twin = Scene.from_dict(
        {key: PLANAR[key] for key in ("name", "duration", "workspace", "obstacles")}
        | {"load": {"shape": "bar", "length": 0.2}}
        | {
            "manipulators": [
                {"name": name, "start": start, "goal": goal}
                for name, (start, goal) in zip(("left", "right"), hands, strict=True)
            ]
        }
    )
    require_same(scene, twin)
    goal = np.array([0.85, 0.5]) + 0.1 * np.array([0.5, np.sqrt(0.75)])
    assert scene.goal[1] == pytest.approx(goal)
    assert json.loads(canonical(scene.file)) | {"load": None} == json.loads(canonical(twin.file)) | {
        "load": None
    }


@examples(50)
@given(seeds, st.sampled_from(["rpy_deg", "quaternion_wxyz"]))
def test_hands_are_where_poses_place_their_grasps(seed, key):
    """At both ends, turned as the payload and their grasps are; scipy says how."""
    rng = np.random.default_rng(seed)
    poses = Rotation.random(2, random_state=rng.integers(2**31))
    at = rng.uniform(-0.5, 0.5, (2, 3))
    written = poses.as_euler("xyz", degrees=True) if key == "rpy_deg" else poses.as_quat(scalar_first=True)
    held, frames = rng.uniform(-0.1, 0.1, (2, 3)), Rotation.random(2, random_state=rng.integers(2**31))
    z, y = frames.as_matrix()[..., 2], frames.as_matrix()[..., 1]
    data = {
        "version": 2,
        "name": "any",
        "workspace": {"lower": [-1] * 3, "upper": [1] * 3},
        "payload": {
            "shape": "box",
            "size": [0.3, 0.2, 0.2],
            "start": {"position": at[0], key: written[0]},
            "goal": {"position": at[1], key: written[1]},
        },
        "grasps": {
            name: {
                "position": held[i],
                "approach": (3 * z[i]).tolist(),
                "closing": (2 * y[i] - 0.01 * z[i]).tolist(),
            }
            for i, name in enumerate(("left", "right"))
        },
    }
    scene = Scene.from_dict(data, check_ends=False)
    for k, (end, hands) in enumerate(zip(("start", "goal"), scene.ends, strict=True)):
        assert hands == pytest.approx(at[k] + poses[k].apply(held), abs=1e-12)
        turned = scene.grasp.hand_rotations(scene.nodes_at(end))
        assert turned == pytest.approx((poses[k] * frames).as_matrix(), abs=1e-9)


def test_a_payload_in_one_hand_turns_only_if_its_poses_do():
    still = changed(PLANAR, grasps={"left": {"position": [0.05, 0]}})
    turning = Scene.from_dict(still)
    assert turning.groups[0].orientation == "plane"
    still["payload"]["goal"]["angle_deg"] = 90
    scene = Scene.from_dict(still)
    assert scene.groups[0].orientation == "none"
    assert scene.nodes_at("goal") - scene.nodes_at("start") == pytest.approx(
        np.tile([0.7, 0, 0], (len(scene.nodes_at("goal")), 1))
    )


def test_parts_hold_their_shapes(tmp_path):
    """Points of every shape are in the hulls, which reach no farther beyond than the scene says."""
    parts = [
        {"shape": "cylinder", "radius": 0.05, "height": 0.3, "position": [0.1, 0, 0], "rpy_deg": [0, 90, 0]},
        {"shape": "box", "size": [0.2, 0.1, 0.02], "position": [0, 0, 0.1], "rpy_deg": [0, 0, 30]},
        {"shape": "bar", "length": 0.5, "radius": 0.01},
    ]
    data = changed(read_text(TRAY, tmp_path), payload=None, grasps={"left": {"position": [0.1, 0, 0]}})
    data["payload"] = {"parts": parts, "start": {"position": [0, 0, 1]}, "goal": {"position": [0.1, 0, 1]}}
    scene = Scene.from_dict(data)
    nodes = scene.nodes_at("start") - [0, 0, 1]
    turn = np.linspace(0, 2 * np.pi, 97)
    rim = [[0.05 * np.cos(a), 0.05 * np.sin(a), z] for a in turn for z in (-0.15, 0.15)]
    rim = Rotation.from_euler("xyz", [0, 90, 0], degrees=True).apply(rim) + [0.1, 0, 0]
    corners = 0.5 * np.array([[x, y, z] for x in (-0.2, 0.2) for y in (-0.1, 0.1) for z in (-0.02, 0.02)])
    corners = Rotation.from_euler("z", 30, degrees=True).apply(corners) + [0, 0, 0.1]
    for points, hull in zip((rim, corners), scene.body.solids, strict=True):
        planes = ConvexHull(nodes[np.unique(hull)]).equations
        apart = planes[:, :3] @ np.array(points).T + planes[:, 3:]
        assert apart.max() < 1e-12
        assert -apart.max(axis=1).min() < scene.excess["load"] + 1e-12
    assert scene.excess["load"] < 0.02 * 0.05
    (rod,) = scene.body.edges[scene.body.radii > 0]
    assert nodes[rod] == pytest.approx(np.array([[-0.25, 0, 0], [0.25, 0, 0]]))


def test_meshes_among_parts_are_in_their_hulls(tmp_path):
    """All corners of the file, turned and placed by SciPy, are in the hulls of the payload."""
    vertices, faces = l_profile()
    write_obj(tmp_path / "angle.obj", vertices, faces)
    part = {
        "shape": "mesh",
        "file": "angle.obj",
        "scale": 2.0,
        "position": [0, 0, 0.1],
        "rpy_deg": [10, 20, 30],
    }
    data = changed(read_text(TRAY, tmp_path), payload=None, grasps={"left": {"position": [0.1, 0, 0]}})
    ends = {"start": {"position": [0, 0, 1]}, "goal": {"position": [0.1, 0, 1]}}
    data["payload"] = {"parts": [{"shape": "box", "size": [0.2, 0.2, 0.02]}, part], **ends}
    scene = Scene.from_dict(data, folder=tmp_path)
    turn = Rotation.from_euler("xyz", [10, 20, 30], degrees=True)
    placed = turn.apply(2.0 * vertices) + [0, 0, 0.1]
    nodes = scene.nodes_at("start") - [0, 0, 1]
    hulls = [ConvexHull(nodes[np.unique(hull)]).equations for hull in scene.body.solids[1:]]
    outside = np.min([(h[:, :3] @ placed.T + h[:, 3:]).max(axis=0) for h in hulls], axis=0)
    assert outside.max() < 1e-9
    whole = ConvexHull(placed).volume
    assert sum(ConvexHull(nodes[np.unique(hull)]).volume for hull in scene.body.solids[1:]) < 0.9 * whole
    again = Scene.from_dict(json.loads(scene.file.model_dump_json()))
    assert again.nodes_at("goal") == pytest.approx(scene.nodes_at("goal"), abs=0), (
        "no file is needed any more"
    )


def _same(one, other):
    """Two scenes are the same to rounding: bodies at both ends, choices, obstacles and limits."""
    for end in ("start", "goal"):
        assert one.nodes_at(end) == pytest.approx(other.nodes_at(end), abs=1e-11)
    assert one.manipulators == other.manipulators
    assert one.file.constraints == other.file.constraints
    assert one.file.limits == other.file.limits
    assert one.obstacles == pytest.approx(other.obstacles)
    assert len(one.alternatives) == len(other.alternatives)
    for a, b in zip(one.file.choices or (), other.file.choices or (), strict=True):
        assert (a.grasps, a.free) == (b.grasps, b.free)


@pytest.mark.parametrize(
    "changes",
    [
        (),
        (("rpy_deg: [0, 35, 90]", "rpy_deg: [0, 35, 90], free: z"),),
        (("shape: box\n  size: [0.4, 0.2, 0.05]", "shape: cylinder\n  radius: 0.05\n  height: 0.3"),),
        (("shape: box\n  size: [0.4, 0.2, 0.05]", "shape: bar\n  length: 0.5\n  radius: 0.02"),),
        (("left: {position: [-0.2, 0, 0], approach: [0, 0, -1], closing: [0, 1, 0]}", "left: auto"),),
        (("grasps:", "constraints: [{type: upright, tolerance_deg: 40}]\ngrasps:"),),
    ],
)
def test_a_scene_of_version_2_is_saved_in_version_2(changes, tmp_path):
    """What the workbench writes reads back to the same scene, in the words of the page."""
    scene = tray(tmp_path, *changes)
    text = scene_text(contents_of(scene))
    assert text.startswith("version: 2\n")
    assert "manipulators" not in text
    (tmp_path / "saved.yaml").write_text(text)
    _same(Scene.load(tmp_path / "saved.yaml"), scene)
    planar = Scene.from_dict(PLANAR)
    (tmp_path / "planar.yaml").write_text(scene_text(contents_of(planar)))
    _same(Scene.load(tmp_path / "planar.yaml"), planar)


def read_text(text, folder):
    """The contents of a YAML text."""
    (folder / "read.yaml").write_text(text)
    return read_yaml(folder / "read.yaml")[0]


def test_a_bar_may_be_held_anywhere_and_by_any_number():
    grasps = {name: {"position": [x, 0]} for name, x in (("a", -0.05), ("b", 0.02), ("c", 0.1))}
    scene = Scene.from_dict(changed(PLANAR, grasps=grasps))
    bar = scene.nodes_at("start")[scene.body.edges[0]]
    assert np.linalg.norm(bar[0] - bar[1]) == pytest.approx(0.2)
    assert np.linalg.norm(np.diff(scene.start, axis=0), axis=1) == pytest.approx([0.07, 0.08])


def test_end_effectors_without_a_payload_are_manipulators():
    ends = {
        "left": {"start": [0.1, 0.2], "goal": [0.9, 0.2]},
        "right": {"start": [0.1, 0.8], "goal": [0.9, 0.8]},
    }
    apart = [{"type": "separation", "between": ["left", "right"], "distance": 0.3}]
    scene = Scene.from_dict(changed(PLANAR, payload=None, grasps=None, end_effectors=ends, constraints=apart))
    assert scene.manipulators == ("left", "right")
    assert scene.goal.tolist() == [[0.9, 0.2], [0.9, 0.8]]
    assert len(scene.groups) == 2


# --- Several ways to hold it, and to put it down ---


def test_lists_of_grasps_are_combined_but_for_hands_at_one_place():
    several = [{"position": [x, 0]} for x in (-0.1, 0.0, 0.1)]
    scene = Scene.from_dict(changed(PLANAR, grasps={"left": several, "right": several[1:]}))
    ways = [tuple(x.tolist() for x in one.start[:, 1].round(9)) for one in scene.alternatives]
    assert ways == [(0.4, 0.5), (0.4, 0.6), (0.5, 0.6), (0.6, 0.5)]
    sets = [{"left": several[0], "right": several[2]}, {"left": several[2], "right": several[0]}]
    assert len(Scene.from_dict(changed(PLANAR, grasps=sets)).alternatives) == 2
    many = [{"position": [x, 0]} for x in np.linspace(-0.1, 0.1, 9).tolist()]
    with pytest.raises(SceneError, match=rf"grasps: \d+ ways.*at most {MAX_CHOICES} combinations"):
        Scene.from_dict(changed(PLANAR, grasps={"left": many, "right": many}))


@pytest.mark.parametrize("axis", ["yaw", "x", "z"])
def test_a_free_axis_leaves_the_goal_open_about_it_alone(axis, tmp_path):
    """The position stays, and so does what the axis tells; the first way is the one that turns least."""
    goal = "goal: {position: [0, -0.3, 1], rpy_deg: [0, 35, 90]"
    scene = tray(tmp_path, (goal, f"{goal}, free: {axis}"))
    if axis != "yaw":
        by_shape = tray(tmp_path, ("size: [0.4, 0.2, 0.05]", f"size: [0.4, 0.2, 0.05]\n  symmetric: {axis}"))
        assert by_shape.file.choices == scene.file.choices
    (choice,) = scene.file.choices
    ways = [scene.put_down(choice, turn) for turn in np.linspace(-3.0, 3.0, 13)]
    start, goals = scene.groups[0].start.rotation, [one.groups[0].goal for one in ways]
    unit = np.eye(3)["xyz".index("z" if axis == "yaw" else axis)]
    kept = [pose.rotation[2] if axis == "yaw" else pose.rotation @ unit for pose in goals]
    assert np.ptp(kept, axis=0).max() < 1e-12
    assert np.ptp([pose.center for pose in goals], axis=0).max() == 0
    turned = [Rotation.from_matrix(start.T @ pose.rotation).magnitude() for pose in goals]
    assert int(np.argmin(turned)) == 6  # the turn of 0
    for way in (ways[4], ways[9]):
        assert scene.ways_to(way.file.load.goal)[-1].sha256 == way.sha256
    assert len(scene.ways_to(scene.file.load.start)) == len(scene.alternatives)  # that is another place


def free_goals():
    """A scene whose payload may be put down at any turn, and one in which an obstacle rules out some of them."""
    free = copy.deepcopy(PLANAR) | {"obstacles": []}
    free["payload"]["shape"], free["payload"]["size"] = "box", [0.2, 0.05]
    free["payload"].pop("length")
    free["payload"]["goal"] |= {"free": "yaw"}
    free["grasps"] = {"left": {"position": [-0.1, 0]}, "right": {"position": [0.05, 0.02]}}
    blocked = free | {"obstacles": [{"shape": "box", "center": [0.85, 0.67], "size": [0.1, 0.2]}]}
    return Scene.from_dict(free), Scene.from_dict(blocked)


def test_a_free_goal_is_the_best_of_all_turns():
    """End effectors go as short ways as they can: no turn of a fine grid is better; with an obstacle in the way, the
    best of the sampled turns that are clear, as the least of all may be one at which the payload touches it."""
    for scene, step in zip(free_goals(), (np.deg2rad(1.0), TurnSettings().step), strict=True):
        result = comove.solve(scene, budget=5.0)
        assert result.verified
        lengths = {}
        for turn in np.arange(0.0, 2 * np.pi - 1e-9, step):
            with suppress(SceneError):
                way = scene.put_down(scene.file.choices[0], turn).require_free_ends()
                lengths[turn] = np.linalg.norm(way.goal - way.start) ** 2
        found = np.linalg.norm(result.scene.goal - result.scene.start) ** 2
        assert found <= min(lengths.values()) + 2e-6
        assert Executor(scene, plan=result.motion).scene.sha256 == result.scene.sha256
    assert len(lengths) < 2 * np.pi / step - 1, "the obstacle is in the way of some"


@pytest.mark.parametrize("scene", free_goals(), ids=["free", "blocked"])
def test_an_execution_puts_the_payload_down_at_a_turn_that_is_clear(scene):
    """At the position of the goal, as the hands on it tell, and where an obstacle leaves room."""
    executor = comove.Executor(scene)
    report = verify_execution(executor.run(20.0), executor.blocker)
    assert report.reasons == ()
    nodes = nodes_of(executor.scene, executor.poses)
    assert scene.nearest_at(nodes)[0] > 0.0
    (a, b), (left, right) = nodes[:2, :2] @ [1, 1j], np.array([-0.1, 0.05 + 0.02j])
    turn = (b - a) / (right - left)
    assert abs(turn) == pytest.approx(1.0)
    assert a - turn * left == pytest.approx(0.85 + 0.5j, abs=1e-3)


SHAPES = {
    "box": {"shape": "box", "size": [0.4, 0.2, 0.05]},
    "bar": {"shape": "bar", "length": 0.5, "radius": 0.01},
    "cylinder": {"shape": "cylinder", "radius": 0.03, "height": 0.4},
    "mesh": {"shape": "mesh", "file": "profile.obj"},
}


@pytest.mark.parametrize("shape", SHAPES)
def test_proposed_grasps_are_antipodal(shape, tmp_path):
    """Fingers close on two sides that face each other, near enough, and the palm stays outside."""
    data = read_text(TRAY, tmp_path) | {"grasps": {"left": "auto", "right": "auto"}}
    data["payload"] = SHAPES[shape] | {key: data["payload"][key] for key in ("start", "goal")}
    scene = Scene.from_dict(data, folder=ROOT / "examples" / "meshes", check_ends=False)
    assert len(scene.alternatives) > 1
    for way in scene.file.choices:
        for name, position in way.grasps.items():
            turn = Rotation.from_quat(way.frames[name], scalar_first=True).as_matrix()
            p, inside = np.array(position), SURFACES[shape]
            assert inside(p), "the fingers' middle is in the payload"
            for side in (-1, 1):
                out = p + side * (OPENING / 2 + 1e-6) * turn[:, 1]
                assert not inside(out), "fingers that are open are outside"
            depth = 0.03 if shape == "cylinder" else DEPTH  # its radius: fingers reach its axis
            assert not inside(p - (depth + 1e-6) * turn[:, 2]), "the palm is outside"


def _in_profile(p):
    from comove.geometry.meshes import read_mesh

    mesh = read_mesh(ROOT / "examples" / "meshes" / "profile.obj", 1.0, file=None, key="file")
    a, b, c = np.moveaxis(mesh.triangles - p, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    top = (a * np.cross(b, c)).sum(axis=1)
    low = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
    return abs(2 * np.arctan2(top, low).sum()) > 2 * np.pi  # the solid angle (Van Oosterom and Strackee)


SURFACES = {
    "box": lambda p: bool((np.abs(p) <= np.array([0.2, 0.1, 0.025]) + 1e-9).all()),
    "bar": lambda p: abs(p[0]) <= 0.25 + 1e-9 and np.hypot(p[1], p[2]) <= 0.01 + 1e-9,
    "cylinder": lambda p: abs(p[2]) <= 0.2 + 1e-9 and np.hypot(p[0], p[1]) <= 0.03 + 1e-9,
    "mesh": _in_profile,
}


# --- What is wrong, in the words of the file ---

ROBOT = ("duration: 8.0", "duration: 8.0\nrobot: two_pandas")
APPROACH = ", approach: [0, 0, -1], closing: [0, 1, 0]"
WRONG = [
    # change, key and line, message, advice
    (("version: 2", "version: 1"), "payload (line 7)", "belongs to version 2", "write version: 2"),
    (("payload:", "load:"), "load (line 7)", "'load' belongs to version 1", "say it by payload"),
    (
        ("grasps:", "manipulators:"),
        "manipulators (line 12)",
        "'manipulators' belongs to version 1",
        "payload, grasps, end_effectors",
    ),
    (
        ("position: [0, 0.3, 1]", "position: [0, 3, 1]"),
        "payload.start (line 10)",
        "workspace",
        "move the start",
    ),
    (("[-0.2, 0, 0]", "[0.2, 0, 0]"), "grasps (line 12)", "hold the payload at the same place", "move one"),
    (
        ("rpy_deg: [0, 35, 90]", "rpy_deg: [0, 35, 90], quaternion_wxyz: [1, 0, 0, 0]"),
        "payload.goal (line 11)",
        "given by rpy_deg and quaternion_wxyz",
        "give one of them",
    ),
    (
        ("rpy_deg: [0, 35, 90]", "quaternion_wxyz: [1, 1, 0, 0]"),
        "payload.goal.quaternion_wxyz (line 11)",
        "has the norm 1.41421",
        "unit quaternion",
    ),
    (("rpy_deg: [0, 35, 90]", "angle_deg: 35"), "payload.goal.angle_deg (line 11)", "spatial", "use rpy_deg"),
    (
        ("grasps:", "constraints: [{type: upright}]\ngrasps:"),
        "payload.goal (line 11)",
        "is tilted by 35 deg at the goal",
        "tolerance",
    ),
    (
        ("closing: [0, 1, 0]", "closing: [0, 0, 2]"),
        "grasps.left (line 13)",
        "close along",
        "across the approach",
    ),
    (
        (", closing: [0, 1, 0]", ""),
        "grasps.left (line 13)",
        "approach is given without closing",
        "give closing",
    ),
    (
        ("shape: box\n  size: [0.4, 0.2, 0.05]", "shape: frame\n  edges: [[left, rigth]]"),
        "payload.edges[0][1] (line 9)",
        "no end effector 'rigth'",
        "'right'",
    ),
    (
        ("left: {position: [-0.2, 0, 0], approach: [0, 0, -1], closing: [0, 1, 0]}", "left: auto2"),
        "grasps.left (line 13)",
        "'auto2' is not known",
        "write 'auto'",
    ),
    (
        ("grasps:", "grasps: auto\nconstraints:"),
        "grasps (line 12)",
        "does not say which arms",
        "write {left: auto, right: auto}, or, where the scene names a robot, auto alone",
    ),
    (
        ("rpy_deg: [0, 35, 90]", "rpy_deg: [35, 90]"),
        "payload.goal.rpy_deg (line 11)",
        "has 2 angles",
        "write 3: roll, pitch and yaw",
    ),
    (
        ("rpy_deg: [0, 35, 90]", "quaternion_wxyz: [1, 0, 0, 1]"),
        "payload.goal.quaternion_wxyz (line 11)",
        "has the norm 1.41421",
        "w first: [0.707107, 0.0, 0.0, 0.707107]",
    ),
    (
        ("rpy_deg: [0, 35, 90]", "rpy_deg: [0, 35, 90], quaternion_wxyz: [1, 0, 0, 0]"),
        "payload.goal (line 11)",
        "is given by rpy_deg and quaternion_wxyz",
        "give one of them",
    ),
    (
        ("  shape: box\n", "  shape: box\n  symmetric: x\n  goal: {position: [0, 0, 1], free: z}\n"),
        "in line 10 and in line 13",
        "the key 'goal' is given twice",
        "",
    ),
    (
        ("rpy_deg: [0, 35, 90]}", "free: z}\n  symmetric: x"),
        "payload.goal.free (line 11)",
        "a goal is free about one axis",
        "leave one of them out",
    ),
    (
        ("shape: box\n  size: [0.4, 0.2, 0.05]", "parts: [{shape: ball}]"),
        "payload.parts[0] (line 8)",
        "the shape 'ball' is not known",
        "known: bar, box, cylinder",
    ),
    (("  size:", "  sise:"), "payload.sise (line 9)", "unknown key", "'size'"),
    (("  left: {position", "  left: {positon"), "grasps.left.positon (line 13)", "unknown key", "'position'"),
    (
        ("grasps:", "end_effectors: {left: {start: [0, 0, 1], goal: [0, 0, 1]}}\ngrasps:"),
        "end_effectors.left (line 12)",
        "holds the payload",
        "leave it out",
    ),
    (("size: [0.4, 0.2, 0.05]", "size: [0.4, 0.2]"), "payload.size (line 9)", "has 2 numbers", "3 numbers"),
    (
        ("- {shape: box, center", "- {shape: moveit, file: a.scene}\n  - {shape: box, center"),
        "obstacles[0].file (line 6)",
        "no file 'a.scene'",
        "",
    ),
]


@pytest.mark.parametrize(("change", "key", "message", "advice"), WRONG)
def test_a_fault_names_keys_of_the_file_and_their_lines(change, key, message, advice, tmp_path):
    with pytest.raises(SceneError) as told:
        tray(tmp_path, change)
    assert all(part in str(told.value) for part in (key, message, advice)), told.value
    if "belongs to version" not in message:
        assert not re.search(r"\b(load|manipulators?\[|held_by)\b", str(told.value))


VALUES = (
    None,
    0,
    -1,
    "x",
    "auto",
    [],
    {},
    [1, 2],
    [1, 2, 3],
    [0, 0, 0],
    {"a": 1},
    True,
    "left",
    [{}],
    np.nan,
)


def places(data, path=()):
    """The paths of all values in plain data."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        yield (*path, key)
        yield from places(value, (*path, key))


@pytest.mark.filterwarnings("ignore::comove.errors.ComoveWarning")
@examples(300)
@given(seeds)
def test_a_file_with_any_change_is_read_or_its_fault_is_told(seed):
    """In the words of version 2, whichever value is another one, is missing, or has another key."""
    rng = np.random.default_rng(seed)
    with TemporaryDirectory() as folder:
        data = read_text(TRAY, Path(folder))
    if rng.random() < 0.5:
        parts = [{"shape": "bar", "length": 0.2, "rpy_deg": [0, 0, 1]}, {"shape": "box", "size": [0.1] * 3}]
        ends = {key: data["payload"][key] for key in ("start", "goal")}
        data["payload"] = {"parts": parts, **ends}
        data["grasps"]["right"] = [data["grasps"]["left"], data["grasps"]["right"]]
    every = [*places(data)]
    *path, last = every[rng.integers(len(every))]
    holder = data
    for key in path:
        holder = holder[key]
    if (what := rng.integers(4)) == 0:
        del holder[last]
    elif what == 1 and isinstance(holder, dict):
        holder[f"{last}x"] = holder.pop(last)
    else:
        holder[last] = VALUES[rng.integers(len(VALUES))]
    try:
        _ = Scene.from_dict(data, check_ends=False).alternatives
    except SceneError as error:
        assert not re.search(r"\b(load|manipulators?\[|held_by)\b", str(error).partition(";")[0])


def test_a_robot_needs_to_know_how_to_hold_it(tmp_path):
    with pytest.raises(SceneError, match=r"grasps\.left.* cannot know how .* add approach and closing"):
        tray(tmp_path, ROBOT, (APPROACH, ""))
    tray(tmp_path, ROBOT)


def test_a_grasp_in_the_air_is_warned_of_in_the_files_words(tmp_path):
    with pytest.warns(
        ComoveWarning, match=r"grasps\.left .line 13.: 'left' .* 0\.1 m away .* move its grasp"
    ):
        tray(tmp_path, ("[-0.2, 0, 0]", "[-0.3, 0, 0]"))


@pytest.mark.parametrize("closing", ["[0, 1, 0.5]", "[0.3, 1, 0.1]", "[0.2, 0.9, -2]"])
def test_fingers_close_across_the_approach_and_the_advice_says_where(tmp_path, closing):
    with pytest.raises(SceneError, match="not across the approach") as raised:
        tray(tmp_path, ("closing: [0, 1, 0]", f"closing: {closing}"))
    advised = re.search(r"write closing: (\[.*?\])", str(raised.value))[1]
    mended = tray(tmp_path, ("closing: [0, 1, 0]", f"closing: {advised}")).grasp.at_rest
    across = json.dumps([*json.loads(closing)[:2], 0])  # of an approach along -z
    straight = tray(tmp_path, ("closing: [0, 1, 0]", f"closing: {across}")).grasp.at_rest
    assert np.abs(mended - straight).max() < 2e-6
    tray(tmp_path, ("closing: [0, 1, 0]", "closing: [0, 1, 0.01]"))  # rounded


def test_a_payload_in_millimetres_is_told_as_one_whichever_end_leaves_the_workspace(tmp_path):
    """Not with the advice to make the workspace wider."""
    sized = ("size: [0.4, 0.2, 0.05]", "size: [400, 200, 50]")
    for more in ((), (("[-0.2, 0, 0]", "[-200, 0, 0]"), ("[0.2, 0, 0]", "[200, 0, 0]"))):
        with pytest.raises(SceneError, match="looks like millimetres") as raised:
            tray(tmp_path, sized, *more)
        assert "workspace:" not in raised.value.way_out
    tray(tmp_path)  # in metres, as it says


def test_names_are_told_in_the_words_of_version_2():
    """Of edges and constraints; what is advised is a key that the version has."""
    frame = {"shape": "frame", "edges": [["left", "rihgt"]]}
    payload = {key: value for key, value in PLANAR["payload"].items() if key in ("start", "goal")}
    data = changed(PLANAR, payload=payload | frame)
    with pytest.raises(
        SceneError, match=r"edges\[0\]\[1\]: there is no end effector 'rihgt'; did you mean 'right'"
    ):
        Scene.from_dict(data)
    data["payload"]["edges"] = [["left", "right"], ["left", "third"]]
    data["end_effectors"] = {"third": {"start": [0.2, 0.2], "goal": [0.2, 0.8]}}
    with pytest.raises(SceneError, match=r"'third' does not hold the payload; add it to grasps") as raised:
        Scene.from_dict(data)
    assert "held_by" not in str(raised.value)
    data["grasps"]["third"] = {"position": [0.05, 0.05]}
    del data["end_effectors"]
    Scene.from_dict(data, check_ends=False)
    data = changed(PLANAR, payload=None, grasps=None, constraints=[{"type": "upright"}])
    data["end_effectors"] = {"left": {"start": [0.2, 0.2], "goal": [0.2, 0.8]}}
    with pytest.raises(SceneError, match="no payload to keep upright; add a payload"):
        Scene.from_dict(data)


def test_a_robots_payload_without_a_mass_is_warned_of_once(tmp_path):
    robot, mass = (
        ("name: tray", "name: tray\nrobot: two_pandas"),
        ("shape: box\n  size", "shape: box\n  mass: 2\n  size"),
    )
    with pytest.warns(ComoveWarning, match=r"payload\.mass .line 8.: .* 0\.25 kg; write mass: 0\.25") as seen:
        scene = tray(tmp_path, robot)
    assert len(seen) == 1
    assert load_mass(scene) == 0.25
    with warnings.catch_warnings():
        warnings.simplefilter("error", ComoveWarning)
        tray(tmp_path, robot, mass)
        tray(tmp_path)  # no robot carries it


# --- The schema for editors ---


def test_the_schema_knows_all_keys_of_a_file(tmp_path):
    """Keys of a scene are properties of the schema, and a key that it lacks is refused by it and by the reader."""
    data = read_text(TRAY, tmp_path)
    assert satisfies(data)
    data["payload"]["sise"] = data["payload"].pop("size")
    assert not satisfies(data)


@pytest.mark.parametrize(
    "change",
    [
        {"version": 1},
        {"name": 7},
        {"duration": -1.0},
        {"payload": {"shape": "ball", "size": [0.4, 0.2, 0.05]}},
        {"payload": {"shape": "box"}},
        {"workspace": {"lower": [0, 0, 0]}},
        {"obstacles": {"shape": "sphere", "center": [0, 0, 0], "radius": 0.1}},
        {"obstacles": [{"shape": "sphere", "center": [0, 0, 0], "radius": 0.0}]},
        {"limits": {"speed": "fast"}},
        {"grasps": {"left": 3}},
        {"workspace": {"lower": [0, 0, 0, 0], "upper": [1, 1, 1, 1]}},
        {"obstacles": [{"shape": "sphere", "center": [0.5], "radius": 0.1}]},
        {
            "obstacles": [
                {"shape": "box", "center": [0, 0, 0], "size": [1, 1, 1], "quaternion_wxyz": [1, 0, 0]}
            ]
        },
    ],
    ids=str,
)
def test_a_wrong_scene_fails_the_schema_and_the_reader(change, tmp_path):
    data = read_text(TRAY, tmp_path) | change
    assert not satisfies(data)
    with pytest.raises(SceneError):
        Scene.from_dict(data, check_ends=False)


@pytest.mark.few(12)
@pytest.mark.filterwarnings("ignore::comove.errors.ComoveWarning")
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_shipped_scenes_satisfy_the_schema(path, tmp_path):
    """Those of version 1 as they are upgraded."""
    data, _ = read_yaml(path)
    if "workspace" not in data:
        return
    if data.get("version", 1) == 1:
        data = read_text(as_text(upgraded(Scene.load(path, check_ends=False), data)), tmp_path)
    assert satisfies(data)


GRASP = {"position": [0.2, 0, 0], "approach": [0, 0, -1], "closing": [0, 1, 0]}


@pytest.mark.parametrize(
    "grasps",
    [
        "auto",
        {"left": "auto", "right": "auto"},
        {"left": "auto", "right": GRASP},
        {"left": [GRASP], "right": [GRASP | {"position": [-0.2, 0, 0]}, GRASP | {"position": [-0.1, 0, 0]}]},
        [{"left": "auto", "right": "auto"}, {"left": GRASP, "right": GRASP | {"position": [-0.2, 0, 0]}}],
    ],
    ids=["auto", "each auto", "one auto", "lists", "sets"],
)
def test_grasps_that_are_read_satisfy_the_schema(grasps, tmp_path):
    data = read_text(TRAY, tmp_path) | {"robot": "two_pandas", "grasps": grasps}
    Scene.from_dict(data, check_ends=False)
    assert satisfies(data)
    assert not satisfies(data | {"grasps": "some"})


def test_a_mesh_without_a_volume_is_no_payload(tmp_path):
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv .2 0 .1\nv .2 .2 .1\nv 0 .2 0\nf 1 2 3\nf 1 3 4\n")
    flat = ("shape: box\n  size: [0.4, 0.2, 0.05]", "shape: mesh\n  file: flat.obj")
    with (
        pytest.warns(ComoveWarning, match=r"payload\.file \(line 9\): 'flat.obj' is not closed"),
        pytest.raises(SceneError, match=r"payload\.file \(line 9\): 'flat.obj' has no volume"),
    ):
        tray(tmp_path, flat)


def test_arms_that_a_robot_lacks_or_that_reach_no_grasp_are_told(tmp_path):
    """By the keys of the file, and how far the grasp is away."""
    from comove.robots import Robot
    from comove.robots.carrying import RobotCarrier

    robot, limits = Robot.load("two_pandas"), ("payload:", "limits: {speed: 1}\npayload:")
    third = ("  right:", "  third:")
    with pytest.raises(RobotError, match=r"grasps \(line 14\): .* has no arm 'third'; known: left, right"):
        _ = RobotCarrier(robot, tray(tmp_path, ROBOT, limits, third)).holders
    far = ("goal: {position: [0, -0.3, 1]", "goal: {position: [0, -0.3, 1.7]")
    with pytest.raises(
        SceneError, match=r"payload\.goal \(line 13\): the arm .* cannot reach .* [0-9.]+ m and"
    ):
        _ = RobotCarrier(robot, tray(tmp_path, ROBOT, limits, far)).goals
