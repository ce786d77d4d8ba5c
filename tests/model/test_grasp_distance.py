"""Hands that hold a payload are on it or near it; those that hold nothing are warned of, and the advice works."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest

from comove import Scene
from comove.errors import ComoveWarning

ROOT = Path(__file__).parents[2]
SHIPPED = [*sorted((ROOT / "src/comove/examples").glob("*.yaml")), ROOT / "examples/baxter/box_flat.yaml"]
APART = "away from its surface"


def spatial(load, apart, along=0, extra=()):
    offset = np.zeros(3)
    offset[along] = apart / 2
    hands = [("left", -offset), ("right", offset)]
    return {
        "name": "held",
        "workspace": {"lower": [-2, -2, 0], "upper": [2, 2, 2]},
        "load": load,
        "manipulators": [
            {"name": n, "start": [*(o + [0, -1, 1])], "goal": [*(o + [0, 1, 1])]} for n, o in hands
        ],
        "constraints": [{"type": "upright"}],
        **dict(extra),
    }


def planar(load, apart):
    return {
        "name": "held",
        "workspace": {"lower": [-2, -2], "upper": [2, 2]},
        "load": load,
        "manipulators": [
            {"name": "left", "start": [-apart / 2, -1], "goal": [-apart / 2, 1]},
            {"name": "right", "start": [apart / 2, -1], "goal": [apart / 2, 1]},
        ],
    }


def said(data):
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        Scene.from_dict(data)
    return [str(one.message) for one in seen if APART in str(one.message)]


def box(*size, **more):
    return {"shape": "box", "size": list(size), **more}


SQUARE = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]


@pytest.mark.parametrize(
    ("data", "apart"),
    [
        (spatial(box(0.05, 0.05, 0.05), 0.8), 0.375),
        (spatial(box(0.05, 0.6, 0.05), 0.6, along=1), 0.275),
        (planar(box(0.05, 0.05), 0.8), 0.375),
        (planar({"shape": "polygon", "vertices": SQUARE, "radius": 0.01}, 0.6), 0.19),
        (spatial(box(0.3, 0.3, 0.3, grasps={"left": [-0.4, 0, 0], "right": [0.4, 0, 0]}), 0.8), 0.25),
    ],
    ids=["cube", "box along y", "rectangle", "polygon", "explicit grasps"],
)
def test_hands_in_the_air_are_warned_of_with_their_distance(data, apart):
    messages = said(data)
    assert len(messages) == 2
    for name, message in zip(("left", "right"), messages, strict=True):
        assert f"'{name}' is to hold the payload, and is {apart:.3g} m {APART}" in message


def test_a_holder_of_a_frame_without_an_edge():
    data = planar(
        {"shape": "frame", "edges": [["left", "right"]], "held_by": ["left", "right", "third"]}, 0.4
    )
    data["manipulators"].append({"name": "third", "start": [0.0, -1.5], "goal": [0.0, 0.5]})
    [message] = said(data)
    assert "'third' is to hold the payload, and is 0.5 m" in message
    data["load"]["edges"].append(["left", "third"])  # as the message says
    assert said(data) == []


@pytest.mark.parametrize(
    "data",
    [
        spatial(box(0.6, 0.05, 0.05), 0.6),
        spatial(box(0.6, 0.4, 0.2, grasps={"left": [-0.3, 0, 0.2], "right": [0.3, 0, 0.2]}), 0.6)
        | {"load": box(0.6, 0.4, 0.2, grasps={"left": [-0.3, 0, 0.13], "right": [0.3, 0, 0.13]})},
        spatial(box(0.6, 0.4, 0.2), 0.2),
        planar({"shape": "polygon", "vertices": SQUARE}, 0.1),
        planar({"shape": "polygon", "vertices": SQUARE}, 0.24),
        planar({"shape": "bar", "length": 0.4}, 0.4),
    ],
    ids=["faces", "above the edges", "inside", "inside of a polygon", "fingers", "bar"],
)
def test_hands_on_or_in_the_payload_are_not(data):
    assert said(data) == []


def test_the_advice_works():
    data = spatial(box(0.05, 0.6, 0.05), 0.6, along=1)
    assert "give its length along this line as the first of its sizes" in said(data)[0]
    assert said(data | {"load": box(0.6, 0.05, 0.05)}) == []
    assert said(spatial(box(0.05, 0.05, 0.05), 0.05)) == []  # hands moved onto it
    held = {"left": [0, -0.3, 0], "right": [0, 0.3, 0]}
    assert said(data | {"load": box(0.05, 0.6, 0.05, grasps=held)}) == []


def test_a_mesh(tmp_path):
    sides = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij")).reshape(3, -1).T - 0.5
    faces = "1 2 4 3,5 7 8 6,1 5 6 2,3 4 8 7,1 3 7 5,2 6 8 4"
    lines = [f"v {x} {y} {z}" for x, y, z in 0.1 * sides] + [f"f {face}" for face in faces.split(",")]
    (tmp_path / "cube.obj").write_text("\n".join(lines) + "\n")
    for apart, warned in ((0.8, True), (0.1, False)):
        with warnings.catch_warnings(record=True) as seen:
            warnings.simplefilter("always", ComoveWarning)
            Scene.from_dict(spatial({"shape": "mesh", "file": "cube.obj"}, apart), folder=tmp_path)
        assert any(f"0.35 m {APART}" in str(one.message) for one in seen) == warned


def listed(tmp_path, left, right=({"position": [-0.17, 0, 0]},), payload=None):
    """A scene file of version 2 with lists of grasps, which are on lines of their own."""
    lines = [f"  left:\n{''.join(f'    - {one}{chr(10)}' for one in left)}"]
    lines += [f"  right:\n{''.join(f'    - {one}{chr(10)}' for one in right)}"]
    payload = payload or {"shape": "box", "size": [0.4, 0.08, 0.02]}
    payload |= {"start": {"position": [0.4, 0.3, 0.5]}, "goal": {"position": [0.6, 0.7, 0.5]}}
    path = tmp_path / "listed.yaml"
    path.write_text(
        "version: 2\nname: listed\nduration: 4\nworkspace: {lower: [0, 0, 0], upper: [1, 1, 1]}\n"
        f"payload: {json.dumps(payload)}\ngrasps:\n{''.join(lines)}"
    )
    return path


@pytest.mark.parametrize("air", [0, 1, 2])
def test_every_listed_grasp_in_the_air_is_named_and_taken_last(tmp_path, air):
    """Its key and line are those of the file; the advice is followed by a distance of nothing."""
    left = [{"position": [x, 0, 0]} for x in (0.17, 0.15)]
    left.insert(air, {"position": [0.3, 0, 0]})
    path = listed(tmp_path, left, ({"position": [-0.17, 0, 0]}, {"position": [-0.4, 0, 0]}))
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always", ComoveWarning)
        scene = Scene.load(path)
    told = [str(one.message) for one in seen if APART in str(one.message)]
    assert len(told) == 2
    for message, key, apart in zip(told, (f"left[{air}]", "right[1]"), (0.1, 0.2), strict=True):
        line = next(
            number
            for number, line in enumerate(path.read_text().splitlines(), 1)
            if ("[0.3," in line and "left" in key) or ("[-0.4," in line and "right" in key)
        )
        assert f"grasps.{key} (line {line}): " in message
        assert f"is {apart} m {APART}" in message
    held = [{name: abs(at[0]) < 0.2 for name, at in way.grasps.items()} for way in scene.choices]
    assert [sum(way.values()) for way in held] == [2, 2, 1, 1, 1, 0]
    assert {name: abs(at[0]) < 0.2 for name, at in scene.in_one_way().file.load.grasps.items()} == held[0]


def test_distances_of_choices_do_not_depend_on_how_constraints_turn_the_frame(tmp_path):
    """Among constraints the group's frame is that of the world, turned at the start."""
    payload = {"shape": "bar", "length": 0.4, "radius": 0.01}
    path = listed(tmp_path, [{"position": [x, 0, 0]} for x in (0.2, 0.3, 0.12)], payload=payload)
    text = path.read_text().replace(
        '"position": [0.4, 0.3, 0.5]', '"rpy_deg": [0, 30, 70], "position": [0.4, 0.3, 0.5]'
    )
    text = text.replace('"position": [0.6, 0.7, 0.5]', '"rpy_deg": [0, 30, 70], "position": [0.6, 0.7, 0.5]')
    path.write_text(text + "constraints: [{type: no_rotation}]\n")
    with pytest.warns(ComoveWarning, match=r"grasps\.left\[1\].* payload, and is 0\.09 m"):
        scene = Scene.load(path)
    assert scene.n_far.tolist() == [0, 1, 0]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_no_shipped_example_is_warned_of(path):
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=f".*{APART}")
        Scene.load(path)
