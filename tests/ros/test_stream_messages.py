"""What the bridge reads from messages of obstacles, without ROS."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import SimpleNamespace as Message

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import comove.ros


@pytest.fixture
def bridge(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(comove.ros.__file__).parent))
    return importlib.import_module("ros2_stream")


def stamp(nanoseconds):
    return Message(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def pose(position, quaternion=(0.0, 0.0, 0.0, 1.0)):
    return Message(
        position=Message(**dict(zip("xyz", position, strict=True))),
        orientation=Message(**dict(zip("xyzw", quaternion, strict=True))),
    )


def header(at=1_500_000_000, frame="world"):
    return Message(stamp=stamp(at), frame_id=frame)


def test_poses_are_numbered(bridge):
    message = Message(header=header(), poses=[pose([1.0, 2.0, 3.0]), pose([4.0, 5.0, 6.0])])
    assert bridge.centers_of_poses(message) == (
        1_500_000_000,
        "world",
        {"0": [1.0, 2.0, 3.0], "1": [4.0, 5.0, 6.0]},
    )


def test_markers_have_namespaces_or_numbers(bridge):
    def marker(ns, number, action=0, frame="world", at=1):
        return Message(
            ns=ns, id=number, action=action, ADD=0, header=header(at, frame), pose=pose([number, 0, 0])
        )

    message = Message(markers=[marker("cart", 7, at=5), marker("", 3, at=9), marker("gone", 1, action=2)])
    assert bridge.centers_of_markers(message) == (5, "world", {"cart": [7, 0, 0], "3": [3, 0, 0]})
    two = Message(markers=[marker("a", 1), marker("b", 2, frame="camera")])
    assert bridge.centers_of_markers(two)[1] == "camera, world"  # which is no frame of a scene


@pytest.mark.parametrize("seed", range(5))
def test_objects_are_where_their_shapes_are(bridge, seed):
    rng = np.random.default_rng(seed)
    turn, at, inner = Rotation.random(random_state=seed), rng.normal(size=3), rng.normal(size=3)
    scale = 1.0 if seed else 3.0  # quaternions of others are not always of length 1
    item = Message(
        id="cart",
        header=header(),
        operation=0,
        REMOVE=1,
        pose=pose(at.tolist(), (scale * turn.as_quat()).tolist()),
        primitive_poses=[pose(inner.tolist())],
        mesh_poses=[],
    )
    _, _, found = bridge.ObjectCenters().of([item])
    np.testing.assert_allclose(found["cart"], at + turn.apply(inner), atol=1e-12)
    item.operation = 1
    assert bridge.ObjectCenters().of([item])[2] == {}


def test_an_object_without_orientation_or_shape(bridge):
    item = Message(
        id="a",
        header=header(),
        operation=0,
        REMOVE=1,
        pose=pose([1.0, 0.0, 0.0], (0.0, 0.0, 0.0, 0.0)),
        primitive_poses=[pose([0.0, 2.0, 0.0])],
        mesh_poses=[],
    )
    assert bridge.ObjectCenters().center(item) == [1.0, 2.0, 0.0]
    item.primitive_poses = []
    assert bridge.ObjectCenters().center(item) == [1.0, 0.0, 0.0]


def test_a_silent_joint_counts_though_others_speak(bridge, monkeypatch):
    clock = iter(range(100))
    monkeypatch.setattr(bridge.time, "monotonic", lambda: float(next(clock)))
    joints = bridge.MeasuredJoints(["a", "b"])
    joints.take({"a": 0.0, "b": 0.0})
    for _ in range(5):
        joints.take({"a": 0.0})
    assert joints.silence() == 6.0


def test_markers_of_one_namespace_keep_apart(bridge):
    markers = [
        Message(ns="arm", id=k, action=0, ADD=0, header=header(), pose=pose([float(k), 0.0, 0.0]))
        for k in range(2)
    ]
    _, _, found = bridge.centers_of_markers(Message(markers=markers))
    assert found == {"arm/0": [0.0, 0.0, 0.0], "arm/1": [1.0, 0.0, 0.0]}


def test_an_object_that_moves_keeps_its_shape(bridge):
    """MOVE tells no shapes: they are where they were in the object."""
    centers, told = bridge.ObjectCenters(), {"id": "box", "header": header(), "REMOVE": 1}
    added = Message(
        **told, operation=0, pose=pose([1.0, 0, 0]), primitive_poses=[pose([0.5, 0, 0])], mesh_poses=[]
    )
    moved = Message(**told, operation=3, pose=pose([2.0, 0, 0]), primitive_poses=[], mesh_poses=[])
    assert centers.of_one(added)[2] == {"box": [1.5, 0.0, 0.0]}
    assert centers.of_one(moved)[2] == {"box": [2.5, 0.0, 0.0]}
