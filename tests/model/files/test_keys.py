"""The model takes the contract's scenes and tells what is wrong with others in plain words."""

import copy
import json
import math

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given
from hypothesis import strategies as st

from comove.errors import ComoveWarning, SceneError
from comove.model.files import keys
from comove.model.files.keys import canonical
from comove.model.files.reading import load_scene_file, parse_scene
from tests.cases import examples

EXAMPLE = """\
version: 1                 # optional; required: name, workspace, manipulators
name: narrow
duration: 10.0             # s
workspace: {lower: [0, 0], upper: [1, 1]}     # m; 2 numbers = planar, 3 = spatial
obstacles:
  - {shape: box, center: [0.5, 0.2], size: [0.1, 0.5]}      # full edge lengths
  - {shape: circle, center: [0.3, 0.8], radius: 0.05}       # circle = sphere, in both dimensions
load: {shape: bar, length: 0.2, radius: 0.0}
manipulators:
  - {name: left,  start: [0.15, 0.4], goal: [0.85, 0.4]}
  - {name: right, start: [0.15, 0.6], goal: [0.85, 0.6]}
limits: {speed: 1.0}       # m/s of each manipulator
constraints:
  - {type: distance, between: [left, right], distance: 0.2, tolerance: 0.0002}
demonstration: {file: carry.csv}
"""
BOX = "{shape: box, center: [0.5, 0.2], size: [0.1, 0.5]}"
CIRCLE = "{shape: circle, center: [0.3, 0.8], radius: 0.05}"
BAR = "{shape: bar, length: 0.2, radius: 0.0}"
DISTANCE = "{type: distance, between: [left, right], distance: 0.2, tolerance: 0.0002}"
SOURCE = "{file: carry.csv}"

SPATIAL = {
    "name": "window 2.b",
    "duration": 5,
    "workspace": {"lower": [0, 0, 0], "upper": [1, 1, 1]},
    "obstacles": [
        {"shape": "box", "center": [0, 0, 0], "size": [1, 2, 3], "quaternion_wxyz": [0.6, 0.8, 0, 0]},
        {"shape": "sphere", "center": [0, 0, 9], "radius": 1},
        {"shape": "capsule", "center": [0, 0, 0], "radius": 0.1, "length": 0.3},
        {"shape": "cylinder", "center": [0, 0, 0], "radius": 0.1, "height": 0.3},
        {"shape": "ellipsoid", "center": [0, 0, 0], "radii": [0.1, 0.2, 0.3]},
    ],
    "load": {"shape": "frame", "edges": [["a", "b"], ["b", "c"], ["c", "a"]], "radius": 0.01},
    "manipulators": [
        {"name": "a", "start": [0.1, 0.1, 0.1], "goal": [0.9, 0.1, 0.1]},
        {"name": "b", "start": [0.1, 0.3, 0.1], "goal": [0.9, 0.3, 0.1]},
        {"name": "c", "start": [0.1, 0.2, 0.3], "goal": [0.9, 0.2, 0.3]},
    ],
    "limits": {"speed": 1, "acceleration": 2.5, "clearance": 0.01},
    "demonstration": {"lasa": "Angle", "demo": 3, "plane": "xz", "scale": 0.01},
    "robot": "baxter",
    "grasp": {"orientation": "down", "yaw": "load", "offset_deg": {"a": 30}},
}
PLANAR = {
    "name": "plate",
    "duration": 5,
    "workspace": {"lower": [0, 0], "upper": [1, 1]},
    "obstacles": [{"shape": "ellipse", "center": [0.5, 0.5], "radii": [0.1, 0.2], "rotation_deg": -30}],
    "load": {
        "shape": "polygon",
        "vertices": [[0, 0], [0.3, 0], [0, 0.4]],
        "grasps": {"a": [0, 0], "b": [0.3, 0.4]},
        "held_by": ["b", "a"],
    },
    "manipulators": [
        {"name": "a", "start": [0.1, 0.1], "goal": [0.5, 0.1]},
        {"name": "b", "start": [0.4, 0.5], "goal": [0.8, 0.5]},
        {"name": "c", "start": [0.4, 0.5], "goal": [0.8, 0.5]},
    ],
    "constraints": [{"type": "distance", "between": ["a", "b"], "distance": 0.5}],
}


@pytest.fixture
def scene_path(tmp_path):
    (tmp_path / "carry.csv").write_text("time,x,y\n0,0,0\n1,1,1\n")
    return tmp_path / "narrow.yaml"


def refusal(path, old="", new=""):
    """The error of loading the example in which `old` is replaced by `new`."""
    assert old in EXAMPLE
    path.write_text(EXAMPLE.replace(old, new, 1))
    with pytest.raises(SceneError) as caught:
        load_scene_file(path)
    assert str(caught.value).startswith(f"{path}: ")
    return check_words(caught.value)


def check_words(error):
    """Demand plain words: no library's text, no addresses, and a way out."""
    text = str(error).lower()
    assert not [bad for bad in ("pydantic", "http", "traceback", "input should", "[type=") if bad in text]
    assert error.way_out or " errors\n" in text
    assert all(character.isprintable() or character == "\n" for character in text)
    return error


def edited(data, path, value):
    """A copy of `data` with `value` at `path`."""
    data = copy.deepcopy(data)
    part = data
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = value
    return data


def test_the_example_of_the_contract(scene_path):
    scene_path.write_text(EXAMPLE)
    scene = load_scene_file(scene_path)
    assert (scene.version, scene.name, scene.duration, scene.dimension) == (1, "narrow", 10.0, 2)
    assert scene.workspace.upper == (1.0, 1.0)
    box, circle = scene.obstacles
    assert (box.shape, box.size, box.rotation_deg) == ("box", (0.1, 0.5), 0.0)
    assert (circle.shape, circle.radius) == ("sphere", 0.05)
    assert (scene.load.length, scene.load.radius, scene.load.overhang) == (0.2, 0.0, 0.0)
    assert scene.names == scene.holders == ("left", "right")
    assert scene.manipulators[1].goal == (0.85, 0.6)
    assert (scene.limits.speed, scene.limits.acceleration, scene.limits.clearance) == (1.0, None, 0.0)
    assert scene.constraints[0].between == ("left", "right")
    assert scene.constraints[0].tolerance == 0.0002
    assert scene.demonstration.file == "carry.csv"
    with pytest.raises(ValueError, match="frozen"):
        scene.duration = 3.0


def test_whole_numbers_are_read_as_floats():
    scene = parse_scene(SPATIAL)
    assert type(scene.duration) is float
    assert {type(x) for x in scene.workspace.lower} == {float}
    assert type(scene.obstacles[1].radius) is float


def test_a_spatial_scene_and_a_polygon():
    spatial, planar = parse_scene(SPATIAL), parse_scene(PLANAR)
    assert spatial.dimension == 3
    assert spatial.load.edges[2] == ("c", "a")
    assert spatial.holders == ("a", "b", "c")
    assert spatial.robot == SPATIAL["robot"]
    assert planar.obstacles[0].shape == "ellipsoid"
    assert planar.holders == ("b", "a")
    assert planar.load.grasps == {"a": (0.0, 0.0), "b": (0.3, 0.4)}


@pytest.mark.parametrize(
    "load", [None, {"shape": "box", "size": [1, 1, 1]}, {"shape": "mesh", "file": "a.stl"}]
)
def test_other_loads(load):
    scene = parse_scene(SPATIAL | {"load": load, "grasp": None})
    assert scene.holders == (("a", "b", "c") if load else ())


def test_arrays_pass_for_lists():
    data = edited(SPATIAL, ("workspace", "upper"), np.array([1.0, 2.0, 3.0]))
    data["manipulators"][0]["start"] = np.float32([0.5, 0.5, 0.5])
    data["duration"] = np.float64(5)
    scene = parse_scene(data)
    assert scene.workspace.upper == (1.0, 2.0, 3.0)
    assert type(scene.duration) is float
    assert canonical(scene)


def test_quaternions_are_normalised_within_the_tolerance():
    for scale in (1 + 9e-4, 1 - 9e-4):
        raw = [scale * 0.6, 0, -scale * 0.8, 0]
        scene = parse_scene(edited(SPATIAL, ("obstacles", 0, "quaternion_wxyz"), raw))
        assert math.hypot(*scene.obstacles[0].quaternion_wxyz) == pytest.approx(1.0, abs=1e-15)
        assert scene.obstacles[0].quaternion_wxyz == pytest.approx((0.6, 0.0, -0.8, 0.0), abs=1e-15)


# --- One thing wrong ---

ONE_WRONG = [
    # old, new, key, message, way out
    ("duration: 10.0", "duration: -1", "duration (line 3)", "-1", "greater than 0"),
    ("duration: 10.0", "duration: 0", "duration (line 3)", "0 ", "greater than 0"),
    ("duration: 10.0", "duration: 1e4", "duration (line 3)", "10000.0", "not greater than 3600"),
    ("duration: 10.0", "duration: .nan", "duration (line 3)", "nan is not a finite number", "plain number"),
    ("duration: 10.0", "duration: -.inf", "duration (line 3)", "-inf is not a finite number", "plain number"),
    ("duration: 10.0", "duration: 1e400", "duration (line 3)", "inf is not a finite number", "plain number"),
    ("duration: 10.0", "duration: true", "duration (line 3)", "true is not a number", "plain number"),
    ("duration: 10.0", "duration: '10'", "duration (line 3)", "'10' is not a number", "no quotes"),
    ("duration: 10.0", "duration: 0,5", "duration (line 3)", "'0,5' is not a number", "a point for decimals"),
    ("duration: 10.0", "duration: 10 s", "duration (line 3)", "'10 s' is not a number", "no unit"),
    ("duration: 10.0", "duration: 0x10", "duration (line 3)", "'0x10' is not a number", "plain number"),
    ("duration: 10.0", "duration: [1]", "duration (line 3)", "[1] is not a number", "plain number"),
    ("duration: 10.0", "durration: 10", "durration (line 3)", "unknown key 'durration'", "'duration'?"),
    ("name: narrow", "", None, "'name' is missing", "required here: name, workspace"),
    ("version: 1 ", "version: 3 ", "version (line 1)", "version 3 is not known", "write 2, or 1"),
    ("version: 1 ", "version: true ", "version (line 1)", "true is not a whole number", "write a whole"),
    ("name: narrow", "name: ''", "name (line 2)", "'' cannot name a file", "begin with a letter"),
    ("name: narrow", "name: ../up", "name (line 2)", "'../up' cannot name a file", "begin with a letter"),
    ("name: narrow", "name: -rf", "name (line 2)", "'-rf' cannot name a file", "begin with a letter"),
    ("name: narrow", "name: a.", "name (line 2)", "'a.' cannot name a file", "begin with a letter"),
    ("name: narrow", 'name: "a\\e[2J"', "name (line 2)", "'a\\x1b[2J' cannot name a file", "begin with"),
    ("name: narrow", "name: " + "x" * 101, "name (line 2)", "101 characters", "at most 100"),
    ("name: narrow", "name: 010", "name (line 2)", "10 is not text", "in quotes"),
    ("upper: [1, 1]", "upper: [1, 0]", "workspace (line 4)", "y goes from 0.0 to 0.0", "less than upper"),
    ("upper: [1, 1]", "upper: [1]", "workspace.upper (line 4)", "1 number", "write 2 numbers (x, y)"),
    ("upper: [1, 1]", "upper: [1,0, 1,0]", "workspace.upper (line 4)", "4 numbers", "decimal points"),
    ("upper: [1, 1]", "upper: [1, one]", "workspace.upper[1] (line 4)", "'one' is not a num", "plain number"),
    ("upper: [1, 1]", "upper: 1", "workspace.upper (line 4)", "1 is not a list", "in brackets"),
    (", upper: [1, 1]", "", "workspace (line 4)", "'upper' is missing", "required here: lower, upper"),
    ("{lower: [0, 0], upper: [1, 1]}", "1", "workspace (line 4)", "1 is not a mapping", "'key: value'"),
    ("0.05", "0", "obstacles[1].radius (line 7)", "0 is out of range", "greater than 0"),
    ("0.05", "-0.05", "obstacles[1].radius (line 7)", "-0.05 is out of range", "greater than 0"),
    ("[0.1, 0.5]", "[0.1, 0]", "obstacles[0].size[1] (line 6)", "0 is out of range", "greater than 0"),
    ("[0.1, 0.5]", "[0.1, .5, 1]", "obstacles[0].size (line 6)", "[0.1, 0.5, 1.0] has 3 numbers", "planar"),
    ("radius: 0.05", "raduis: 0.05", "obstacles[1].raduis (line 7)", "unknown key 'raduis'", "'radius'?"),
    (", radius: 0.05", "", "obstacles[1] (line 7)", "'radius' is missing", "shape, center, radius"),
    ("radius: 0.05", "radius: 1,05", "obstacles[1].05 (line 7)", "unknown key '05'", "a point"),
    (
        "0.05}",
        "1, motion: {}}",
        "obstacles[1].motion (line 7)",
        "it does not say how",
        "velocity, waypoints, circle",
    ),
    ("circle,", "crcle,", "obstacles[1] (line 7)", "the shape 'crcle' is not known", "'circle'?"),
    ("shape: circle, ", "", "obstacles[1] (line 7)", "'shape' is missing", "box, circle, sphere"),
    ("shape: circle", "shape: [1]", "obstacles[1] (line 7)", "the shape [1] is not known", "known: box"),
    (CIRCLE, "3", "obstacles[1] (line 7)", "3 is not a mapping", "'key: value'"),
    (CIRCLE, "", "obstacles[1] (line 7)", "nothing is not a mapping", "'key: value'"),
    (
        CIRCLE,
        "{shape: mesh, file: a.stl, center: [0, 0]}",
        "obstacles[1].shape (line 7)",
        "a mesh needs a spatial scene",
        "box, circle",
    ),
    (
        CIRCLE,
        "{shape: cylinder, center: [0, 0], radius: 1, height: 1}",
        "obstacles[1].shape (line 7)",
        "a cylinder needs a spatial scene",
        "circle",
    ),
    (
        CIRCLE,
        "{shape: box, center: [0, 0], size: [1, 1], quaternion_wxyz: [0, 1, 0, 0]}",
        "obstacles[1].quaternion_wxyz (line 7)",
        "[0.0, 1.0, 0.0, 0.0] turns in space",
        "use rotation_deg",
    ),
    ("length: 0.2", "length: 0", "load.length (line 8)", "0 is out of range", "greater than 0"),
    ("length: 0.2", "length: 0.201", "constraints[0].distance (line 14)", "0.2 m, but the load", "equal"),
    ("radius: 0.0}", "radius: -1}", "load.radius (line 8)", "-1 is out of range", "not less than 0"),
    ("radius: 0.0}", "over: 1}", "load.over (line 8)", "unknown key 'over'", "overhang"),
    ("bar,", "bra,", "load (line 8)", "the shape 'bra' is not known", "'bar'?"),
    ("bar,", "bar, held_by: [left, lft],", "load.held_by[1] (line 8)", "no manipulator 'lft'", "'left'?"),
    ("bar,", "bar, held_by: [left],", "load.held_by (line 8)", "['left'] has 1 name", "name two"),
    (
        "bar,",
        "bar, held_by: [left, left],",
        "load.held_by (line 8)",
        "names a manipulator twice",
        "different",
    ),
    (BAR, "{shape: mesh, file: a.stl}", "load.shape (line 8)", "mesh needs a spatial scene", "polygon"),
    (BAR, "{shape: frame, edges: []}", "load.edges (line 8)", "0 entries", "at least 1 pair"),
    (
        BAR,
        "{shape: frame, edges: [[left, up]]}",
        "load.edges[0][1] (line 8)",
        "manipulator 'up'",
        "left, right",
    ),
    (
        BAR,
        "{shape: polygon, vertices: [[0, 0], [1, 1]]}",
        "load.vertices (line 8)",
        "2 entries",
        "at least 3",
    ),
    (
        BAR,
        "{shape: polygon, vertices: [[0, 0], [1, 1], [1, 2, 3]]}",
        "load.vertices[2] (line 8)",
        "[1.0, 2.0, 3.0] has 3 numbers",
        "write 2 numbers",
    ),
    (
        BAR,
        "{shape: box, size: [1, 1], grasps: {left: [0, 0], rigt: [1, 0]}}",
        "load.grasps.rigt (line 8)",
        "no manipulator 'rigt'",
        "'right'?",
    ),
    (
        BAR,
        "{shape: box, size: [1, 1], grasps: {left: [0, 0]}}",
        "load.grasps (line 8)",
        "grasps are given for ['left']",
        "held_by",
    ),
    (
        BAR,
        "{shape: box, size: [1, 1], grasps: {left: [0, 0], right: [0.3, 0]}}",
        "constraints[0].distance (line 14)",
        "0.2 m, but the load keeps left and right 0.3 m apart",
        "make them equal",
    ),
    ("name: left,", "name: right,", "manipulators[1].name (line 11)", "'right' is already", "its own name"),
    ("name: left,", "name: le.ft,", "manipulators[0].name (line 10)", "'le.ft' contains a point", "letters"),
    ("name: left,", "", "manipulators[0] (line 10)", "'name' is missing", "name, start, goal"),
    ("0.15, 0.4]", "0.15]", "manipulators[0].start (line 10)", "[0.15] has 1 number", "write 2 numbers"),
    ("speed: 1.0", "speed: 0", "limits.speed (line 12)", "0 is out of range", "greater than 0"),
    ("speed: 1.0", "clearance: -1", "limits.clearance (line 12)", "-1 is out of range", "not less than 0"),
    ("speed: 1.0", "sped: 1.0", "limits.sped (line 12)", "unknown key 'sped'", "'speed'?"),
    ("limits: {speed: 1.0}", "robot: [1]", "robot (line 12)", "[1] is not text", "write a name"),
    ("limits: {speed: 1.0}", "grasp: up", "grasp (line 12)", "'up' is not a mapping", "'key: value'"),
    ("limits: {speed: 1.0}", "robot: ''", "robot (line 12)", "'' names no robot", "such as baxter"),
    ("limits: {speed: 1.0}", "grasp: {}", "grasp (line 12)", "the scene is planar", "leave grasp out"),
    (
        "[left, right]",
        "[left, rihgt]",
        "constraints[0].between[1] (line 14)",
        "manipulator 'rihgt'",
        "'right'?",
    ),
    ("[left, right]", "[left, left]", "constraints[0].between (line 14)", "a manipulator twice", "different"),
    ("[left, right]", "[left]", "constraints[0].between (line 14)", "['left'] has 1 name", "name two"),
    ("distance: 0.2,", "distance: 0,", "constraints[0].distance (line 14)", "0 is out of range", "greater"),
    (
        "distance: 0.2,",
        "distance: 0.3,",
        "constraints[0].distance (line 14)",
        "0.2 m apart",
        "make them equal",
    ),
    ("0.0002", "-1", "constraints[0].tolerance (line 14)", "-1 is out of range", "not less than 0"),
    (
        ": distance",
        ": distnace",
        "constraints[0] (line 14)",
        "the type 'distnace' is not known",
        "'distance'?",
    ),
    (
        DISTANCE,
        "{type: upright, tolerance: 5}",
        "constraints[0].tolerance (line 14)",
        "unknown key 'tolerance'",
        "'tolerance_deg'?",
    ),
    (
        DISTANCE,
        "{type: upright, tolerance_deg: 50}",
        "constraints[0].tolerance_deg (line 14)",
        "50 is out of range",
        "not greater than 45",
    ),
    (
        DISTANCE,
        "{type: upright}\n  - {type: upright}",
        "constraints[1] (line 15)",
        "the upright is already given by constraints[0]",
        "keep one",
    ),
    (
        DISTANCE,
        "{type: separation}",
        "constraints[0] (line 14)",
        "'between', 'distance' are missing",
        "type, between, distance",
    ),
    (
        DISTANCE,
        "{type: separation, between: [left, right], distance: -1}",
        "constraints[0].distance (line 14)",
        "-1 is out of range",
        "greater than 0",
    ),
    (
        DISTANCE,
        "{type: separation, between: [left, rigth], distance: 1}",
        "constraints[0].between[1] (line 14)",
        "no manipulator 'rigth'",
        "'right'?",
    ),
    (
        DISTANCE,
        "{type: same_height, between: [left, right], tolerance: -1}",
        "constraints[0].tolerance (line 14)",
        "-1 is out of range",
        "not less than 0",
    ),
    (
        DISTANCE,
        "{type: same_height, between: [left, right]}\n  - {type: same_height, between: [right, left]}",
        "constraints[1] (line 15)",
        "the same height between right and left is already given by constraints[0]",
        "keep one",
    ),
    (
        DISTANCE,
        "{type: relative_pose, between: [left, right], distance: 0.2}",
        "constraints[0].distance (line 14)",
        "unknown key 'distance'",
        "between, tolerance",
    ),
    (
        DISTANCE,
        "{type: seperation, between: [left, right], distance: 0.2}",
        "constraints[0] (line 14)",
        "the type 'seperation' is not known",
        "'separation'?",
    ),
    (
        DISTANCE,
        f"{DISTANCE}\n  - {{type: distance, between: [right, left], distance: 0.2}}",
        "constraints[1] (line 15)",
        "between right and left is already given by constraints[0]",
        "keep one",
    ),
    (SOURCE, "{}", "demonstration (line 15)", "neither file nor lasa", "give one"),
    (SOURCE, "{file: carry.csv, lasa: Angle}", "demonstration (line 15)", "both file and lasa", "give one"),
    (SOURCE, "{file: carry.csv, demo: 1}", "demonstration (line 15)", "demo 1 belongs to", "leave demo out"),
    (SOURCE, "{lasa: Angle, demo: 7}", "demonstration.demo (line 15)", "7 is out of range", "greater than 6"),
    (
        SOURCE,
        "{lasa: Angle, demo: 1.5}",
        "demonstration.demo (line 15)",
        "1.5 is not a whole",
        "whole number",
    ),
    (SOURCE, "{lasa: Angle, scale: 0}", "demonstration.scale (line 15)", "0 is out of range", "greater"),
    (SOURCE, "{lasa: Angle, plane: zz}", "demonstration.plane (line 15)", "'zz' is not known", "'xy', 'xz'"),
    (
        SOURCE,
        "{lasa: Angle, plane: yz}",
        "demonstration.plane (line 15)",
        "needs a spatial scene",
        "leave it",
    ),
    (
        SOURCE,
        "{lasa: A, manipulator: x}",
        "demonstration (line 15)",
        "manipulator 'x' belongs to a file",
        "leave manipulator out",
    ),
    (
        SOURCE,
        "{library: reach, file: carry.csv}",
        "demonstration (line 15)",
        "both file and library are given",
        "one of the three",
    ),
    (SOURCE, "{file: cary.csv}", "demonstration.file (line 15)", "no file 'cary.csv'", "'carry.csv'?"),
    (SOURCE, "{file: carry.npz}", "demonstration.file (line 15)", "no file 'carry.npz'", "no .npz file"),
    (SOURCE, "{file: ../carry.csv}", "demonstration.file (line 15)", "'../carry.csv' lies outside", "move"),
    (SOURCE, "{file: a/../carry.csv}", "demonstration.file (line 15)", "lies outside", "move the file"),
    (SOURCE, "{file: /etc/passwd}", "demonstration.file (line 15)", "'/etc/passwd' lies outside", "move"),
    (SOURCE, "{file: .}", "demonstration.file (line 15)", "'.' is a folder", "name a file"),
    (SOURCE, '{file: "a\\0b"}', "demonstration.file (line 15)", "cannot name a file", "relative to"),
    (SOURCE, f"{{file: {'x' * 300}}}", "demonstration.file (line 15)", "cannot name a file", "relative to"),
]


@pytest.mark.parametrize(
    ("old", "new", "key", "message", "way_out"),
    ONE_WRONG,
    ids=[f"{i}-{x[1][:20]}" for i, x in enumerate(ONE_WRONG)],
)
def test_one_thing_wrong(scene_path, old, new, key, message, way_out):
    error = refusal(scene_path, old, new)
    assert error.key == key
    assert message in error.message
    assert way_out in error.way_out


SPATIAL_WRONG = [
    (("obstacles", 0, "rotation_deg"), 30, "obstacles[0].rotation_deg", "30.0 turns", "quaternion_wxyz"),
    (
        ("obstacles", 0, "quaternion_wxyz"),
        [1, 0, 0],
        "obstacles[0].quaternion_wxyz",
        "3 numbers",
        "w, x, y, z",
    ),
    (
        ("obstacles", 0, "quaternion_wxyz"),
        [1.002, 0, 0, 0],
        "obstacles[0].quaternion_wxyz",
        "[1.002, 0.0, 0.0, 0.0] has the norm 1.002",
        "unit quaternion",
    ),
    (("obstacles", 1, "center"), [0, 0], "obstacles[1].center", "2 numbers", "spatial, so write 3 numbers"),
    (("obstacles", 3, "height"), -1, "obstacles[3].height", "-1", "greater than 0"),
    (("obstacles", 4, "radii"), [1, 1], "obstacles[4].radii", "2 numbers", "spatial"),
    (
        ("load",),
        PLANAR["load"] | {"vertices": [[0, 0, 0]] * 3, "grasps": None},
        "load.shape",
        "planar",
        "box",
    ),
    (("load",), {"shape": "bar", "length": 0.2}, "load", "3 manipulators", "add held_by: [NAME, NAME]"),
    (
        ("load",),
        {"shape": "frame", "edges": [["a", "b"], ["b", "c"]], "held_by": ["a", "b"]},
        "load.edges[1][1]",
        "'c' does not hold the load",
        "add it to held_by",
    ),
    (("load", "held_by"), [], "load.held_by", "no manipulator is named", "at least one"),
    (("load",), {"shape": "mesh", "file": "../a.stl"}, "load.file", "outside the scene's folder", "move"),
    (("workspace", "lower"), [0] * 4, "workspace.lower", "4 numbers", "write 2 (planar) or 3 (spatial)"),
    (("workspace", "lower"), [0], "workspace.lower", "1 number", "write 2 (planar) or 3 (spatial)"),
    (("manipulators",), [], "manipulators", "0 entries", "at least 1 manipulator"),
    (("robot",), {"a": object()}, "robot", "is not text", "write a name"),
    (("duration",), 10**400, "duration", "is not a number", "plain number"),
    (("duration",), 10**5000, "duration", "a very long int is not a number", "plain number"),
]


@pytest.mark.parametrize(
    ("path", "value", "key", "message", "way_out"), SPATIAL_WRONG, ids=[x[2] for x in SPATIAL_WRONG]
)
def test_one_thing_wrong_in_space(path, value, key, message, way_out):
    with pytest.raises(SceneError) as caught:
        parse_scene(edited(SPATIAL, path, value))
    error = check_words(caught.value)
    assert error.key == key
    assert message in error.message
    assert way_out in error.way_out


def test_a_bar_needs_two_manipulators():
    data = {key: SPATIAL[key] for key in ("name", "duration", "workspace")}
    data |= {"manipulators": SPATIAL["manipulators"][:1], "load": {"shape": "bar", "length": 1}}
    with pytest.raises(SceneError, match="has 1 manipulator; add a second manipulator"):
        parse_scene(data)
    with pytest.raises(SceneError, match=r"known: a$"):
        parse_scene(data | {"load": {"shape": "bar", "length": 1, "held_by": ["a", "b"]}})


def test_more_manipulators_than_anybody_has_are_refused_at_once():
    hands = [{"name": f"m{i}", "start": [0.5, 0.5], "goal": [0.6, 0.6]} for i in range(20_000)]
    data = {
        "name": "crowd",
        "duration": 1,
        "workspace": {"lower": [0, 0], "upper": [1, 1]},
        "manipulators": hands,
    }
    with pytest.raises(SceneError, match="manipulators: the list has 20000 entries; write at most 100"):
        parse_scene(data)


def test_only_a_load_is_kept_upright(scene_path):
    text = EXAMPLE.replace(f"load: {BAR}\n", "").replace(DISTANCE, "{type: upright}")
    scene_path.write_text(text)
    with pytest.raises(SceneError, match=r"constraints\[0\] \(line 13\): there is no load .*; add a load"):
        load_scene_file(scene_path)


def test_further_constraints_and_their_defaults():
    kinds = {
        "relative_pose": {"between": ("a", "b"), "tolerance": None},
        "separation": {"between": ("a", "b"), "distance": 0.1, "tolerance": 0.0},
        "upright": {"tolerance_deg": 0.1},
        "same_height": {"between": ("a", "b"), "tolerance": 1e-3},
    }
    written = [
        {"type": kind, **{k: v for k, v in keys.items() if not k.startswith("tolerance")}}
        for kind, keys in kinds.items()
    ]
    scene = parse_scene(SPATIAL | {"constraints": written})
    assert [c.model_dump() for c in scene.constraints] == [
        {"type": kind, **keys} for kind, keys in kinds.items()
    ]
    assert parse_scene(json.loads(canonical(scene))) == scene


def test_the_canonical_form_of_a_distance_is_as_it_was():
    """Results that were made before other constraints existed are still those of their scenes."""
    constraint = json.loads(canonical(parse_scene(PLANAR)))["constraints"]
    assert constraint == [{"between": ["a", "b"], "distance": 0.5, "tolerance": None, "type": "distance"}]


def test_distances_agree_within_their_tolerance(scene_path):
    text = EXAMPLE.replace("length: 0.2", "length: 0.2002")
    for tolerance in (", tolerance: 0.0002", ""):  # one thousandth of the distance, unless said
        scene_path.write_text(text.replace(", tolerance: 0.0002", tolerance))
        load_scene_file(scene_path)
    refusal(scene_path, "length: 0.2", "length: 0.2002001")


def test_files_are_looked_for_only_where_the_folder_is_known():
    data = SPATIAL | {"demonstration": {"file": "nowhere.csv"}}
    assert parse_scene(data).demonstration.file == "nowhere.csv"
    with pytest.raises(SceneError, match=r"no file 'nowhere\.csv'"):
        parse_scene(data, folder="/tmp")
    for name in ("/tmp/nowhere.csv", "../nowhere.csv"):
        with pytest.raises(SceneError, match="lies outside"):
            parse_scene(SPATIAL | {"demonstration": {"file": name}})


def test_links_must_not_lead_out_of_the_folder(tmp_path):
    folder = tmp_path / "scenes"
    folder.mkdir()
    (tmp_path / "secret.csv").touch()
    (folder / "inside.csv").touch()
    (folder / "out.csv").symlink_to(tmp_path / "secret.csv")
    (folder / "alias.csv").symlink_to("inside.csv")
    (folder / "circle.csv").symlink_to("circle.csv")
    parse_scene(SPATIAL | {"demonstration": {"file": "alias.csv"}}, folder=folder)
    for name, words in (("out.csv", "lies outside"), ("circle.csv", "'circle.csv'")):
        with pytest.raises(SceneError, match=words):
            parse_scene(SPATIAL | {"demonstration": {"file": name}}, folder=folder)


def test_scenes_in_another_folder_find_their_files(scene_path, tmp_path, monkeypatch):
    scene_path.write_text(EXAMPLE)
    monkeypatch.chdir(tmp_path)
    assert load_scene_file("narrow.yaml").name == "narrow"
    monkeypatch.chdir("/")
    assert load_scene_file(scene_path).name == "narrow"


# --- Several things wrong ---


def test_the_first_three_errors_are_told_in_the_order_of_the_file(scene_path):
    text = EXAMPLE.replace("duration: 10.0", "duration: ten").replace("radius: 0.05", "raduis: 0.05")
    text = text.replace("speed: 1.0", "speed: -1").replace("name: left", "nmae: left") + "colour: red\n"
    scene_path.write_text(text)
    with pytest.raises(SceneError) as caught:
        load_scene_file(scene_path)
    first, *told = str(check_words(caught.value)).splitlines()
    assert first == f"{scene_path}: 5 errors"
    assert [line.partition(": ")[0].strip() for line in told] == [
        "duration (line 3)",
        "obstacles[1].raduis (line 7)",
        "manipulators[0].nmae (line 10)",
        "and 2 more",
    ]
    assert all("; " in line for line in told[:3])


def test_missing_keys_are_told_in_one_sentence():
    with pytest.raises(SceneError) as caught:
        parse_scene({}, file="a.yaml")
    required = "name, workspace, manipulators"
    missing = "'name', 'workspace', 'manipulators' are missing"
    assert str(caught.value) == f"a.yaml: {missing}; required here: {required}"


@pytest.mark.parametrize("data", [None, 3, [], "text", {1: 2}, {None: 1}, object()])
def test_anything_but_a_mapping_with_text_keys_is_refused(data):
    with pytest.raises(SceneError) as caught:
        parse_scene(data)
    check_words(caught.value)


def test_thousands_of_errors_are_cut_short():
    with pytest.raises(SceneError) as caught:
        parse_scene(SPATIAL | {"obstacles": [{"shape": "bxo"}] * 3000} | {f"key{i}": i for i in range(1000)})
    text = str(caught.value)
    assert "and 3997 more" in text
    assert len(text) < 1000


# --- Warnings ---


def test_a_workspace_in_millimetres_is_warned_of(scene_path):
    scene_path.write_text(EXAMPLE.replace("upper: [1, 1]", "upper: [1000, 1000]"))
    with pytest.warns(ComoveWarning, match=r"narrow\.yaml: workspace: 1000 m wide, .* millimetres"):
        load_scene_file(scene_path)


@pytest.mark.filterwarnings("error")
def test_ordinary_scenes_give_no_warning(scene_path):
    scene_path.write_text(EXAMPLE)
    load_scene_file(scene_path)
    parse_scene(SPATIAL | {"load": SPATIAL["load"] | {"mass": 0.5}})


# --- The canonical form ---


def test_formatting_does_not_change_the_canonical_form(scene_path):
    scene_path.write_text(EXAMPLE)
    scene = load_scene_file(scene_path)
    other = """
demonstration: {file: 'carry.csv'}
constraints: [{tolerance: 2e-4, distance: +.2, "type": distance, between: [left, right]}]
limits:
  speed: 1
  clearance: -0.0
manipulators:
- start: [15e-2, 0.4]
  goal: [0.85, 0.40]
  name: left
- {goal: [0.85, 0.6], name: right, start: [0.15, 0.6]}
load:
  length: 0.20
  shape: bar
obstacles:
  - {shape: box, center: [0.5, 0.2], size: [0.1, 0.5], rotation_deg: 0}
  - {radius: 5e-2, center: [0.3, 0.8], shape: sphere}
workspace: {upper: [1.0, 1.], lower: [0.0, -0]}
name: narrow
duration: 010
"""
    scene_path.write_text(other)
    assert canonical(load_scene_file(scene_path)) == canonical(scene)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("0.0002", "0.00020000000000000004"),
        ("narrow", "narow"),
        ("0.85, 0.4", "0.85, 0.41"),
        ("speed: 1.0", "clearance: 0.01"),
        ("circle,", "box,"),
    ],
)
def test_every_value_changes_the_canonical_form(scene_path, old, new):
    scene_path.write_text(EXAMPLE)
    before = canonical(load_scene_file(scene_path))
    text = EXAMPLE.replace(old, new, 1)
    scene_path.write_text(text.replace("radius: 0.05", "size: [1, 1]") if new == "box," else text)
    assert canonical(load_scene_file(scene_path)) != before


@pytest.mark.parametrize("data", [SPATIAL, PLANAR], ids=["spatial", "planar"])
def test_the_canonical_form_is_sorted_json_that_reads_back(data):
    scene = parse_scene(data)
    text = canonical(scene)
    assert text == json.dumps(json.loads(text), sort_keys=True, separators=(",", ":")).encode()
    assert parse_scene(json.loads(text)) == scene
    assert canonical(parse_scene(json.loads(text))) == text


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: math.hypot(*q) > 0.1))
def test_normalising_twice_changes_nothing(parts):
    norm = math.hypot(*parts)
    quaternion = [part / norm * 1.0005 for part in parts]
    once = parse_scene(edited(SPATIAL, ("obstacles", 0, "quaternion_wxyz"), quaternion))
    assert parse_scene(json.loads(canonical(once))) == once


# --- Whatever is wrong, only SceneError comes out ---

junk = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=5)
    | st.sampled_from(
        ["box", "circle", "mesh", "bar", "polygon", "frame", "distance", "upright", "separation", "left", "a"]
    )
    | st.sampled_from([10**400, "\ud800", "x" * 300, "\x1b[2J", b"bytes", ()]),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(["shape", "type", "name", "center", "size", "between", "file", "motion"])
            | st.text(max_size=3),
            inner,
            max_size=4,
        )
    ),
    max_leaves=6,
)


def places(data, path=()):
    """All key paths in `data`."""
    keys = data if isinstance(data, dict) else range(len(data)) if isinstance(data, list) else ()
    return [place for key in keys for place in ((*path, key), *places(data[key], (*path, key)))]


@st.composite
def mutated(draw):
    """A good scene in which up to three places are deleted, replaced or extended."""
    data = copy.deepcopy(draw(st.sampled_from([SPATIAL, PLANAR])))
    for _ in range(draw(st.integers(1, 3))):
        *way, last = draw(st.sampled_from(places(data) or [("name",)]))
        part = data
        for key in way:
            part = part[key]
        action = draw(st.sampled_from(["delete", "replace", "insert"]))
        if action == "delete":
            del part[last]
        elif action == "replace":
            part[last] = draw(junk)
        elif isinstance(part, dict):
            part[draw(st.text(max_size=6) | st.sampled_from(["radiu", "shape", "motion"]))] = draw(junk)
        else:
            part.insert(last, draw(junk))
        if not data:
            break
    return data


@examples(200, suppress_health_check=[HealthCheck.too_slow])
@given(data=mutated())
@example(data=edited(SPATIAL, ("obstacles", 0, "box"), 3))
@example(data=SPATIAL | {"constraints": [{"type": "distance", "distance": -1, "tolerance": -1}]})
@example(data=SPATIAL | {"load": {"shape": "box", "size": [1, 1, 1], "grasps": {"": [1]}}})
@pytest.mark.filterwarnings("ignore::comove.errors.ComoveWarning")
def test_mutations_raise_nothing_but_scene_errors(data):
    try:
        scene = parse_scene(data, file="scene.yaml", folder="/tmp")
    except SceneError as error:
        check_words(error)
        assert str(error).startswith("scene.yaml: ")
    else:
        assert parse_scene(json.loads(canonical(scene))) == scene


POSITIVE = {
    "duration",
    "size",
    "radius",
    "length",
    "height",
    "radii",
    "speed",
    "acceleration",
    "scale",
    "distance",
}


@pytest.mark.parametrize("data", [SPATIAL, PLANAR], ids=["spatial", "planar"])
@pytest.mark.parametrize("value", [5e-324, 1e-300, 1e-10, 1e10, 1e300])
def test_what_can_be_no_length_or_time_is_refused(data, value):
    for path in places(data):
        part = data
        for key in path:
            part = part[key]
        keys = {key for key in path if isinstance(key, str)}
        if isinstance(part, (int, float)) and "demo" not in keys and (value > 1 or keys & POSITIVE):
            if keys == {"load", "radius"} and value < 1:
                continue  # may be 0
            with pytest.raises(SceneError, match=r"out of range|leaves no time|has the norm"):
                parse_scene(edited(data, path, value))


@pytest.mark.parametrize("data", [SPATIAL, PLANAR], ids=["spatial", "planar"])
@pytest.mark.parametrize("value", [None, {}, [], "junk", -1, math.nan], ids=repr)
def test_every_place_may_hold_junk(data, value):
    for path in places(data):
        try:
            parse_scene(edited(data, path, value))
        except SceneError as error:
            check_words(error)


# --- The room ---


def test_all_public_models_forbid_unknown_keys_and_are_frozen():
    parts = [part for part in vars(keys).values() if isinstance(part, type) and issubclass(part, keys.Part)]
    assert len(parts) >= 15
    for part in parts:
        assert part.model_config["frozen"]
        assert part.model_config["extra"] == "forbid" or part.__name__.startswith("Unsupported")
