"""Point clouds: what is read of them, and where obstacles are that they show, without ROS."""

from __future__ import annotations

import importlib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace as Message

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import comove.ros
from comove import Scene
from comove.control.clouds import surface
from comove.errors import SendError
from comove.geometry import distances as sd
from comove.ros.cloud_fits import WITHIN, Shape, Unseen, fitted_center
from comove.ros.clouds import ObstacleClouds, watched
from comove.ros.point_clouds import CloudError, points_of

NOISE = 0.005  # m, that is expected of points
CAMERA = 0.003  # m, that they have
GATE = 0.1  # m, in which a centre is looked for
EVERY = 10**9


def cloud_of(points, *, kind="<f4", rows=1, before=0, between=0, after=0, end=0, names="xyz"):
    """A message with points (n, 3), and bytes between them that mean nothing."""
    values = np.asarray(points).astype(kind).reshape(rows, -1, 3)
    n, size, step = values.shape[1], values.itemsize, before + 3 * (values.itemsize + between) + after
    data = np.full((rows, n * step + end), 0xAB, dtype=np.uint8)
    fields, number = [], {"f4": 7, "f8": 8}[kind[1:]]
    for k, name in enumerate(names):
        offset = before + k * (size + between)
        column = values[..., "xyz".index(name)]
        inner = data[:, : n * step].reshape(rows, n, step)
        inner[..., offset : offset + size] = (
            np.ascontiguousarray(column).view(np.uint8).reshape(rows, n, size)
        )
        fields.append(Message(name=name, offset=offset, datatype=number, count=1))
    fields.append(Message(name="rgb", offset=0, datatype=7, count=1))
    return Message(
        header=Message(frame_id="world"),
        height=rows,
        width=n,
        fields=fields,
        is_bigendian=kind[0] == ">",
        point_step=step,
        row_step=data.shape[1],
        data=bytearray(data.tobytes()),
        is_dense=False,
    )


@settings(max_examples=50, deadline=None)
@given(
    kind=st.sampled_from(["<f4", ">f4", "<f8", ">f8"]),
    rows=st.integers(1, 5),
    columns=st.integers(0, 7),
    gaps=st.tuples(*[st.integers(0, 9)] * 4),
    names=st.permutations("xyz"),
    seed=st.integers(0, 2**32 - 1),
)
def test_points_are_read_wherever_they_lie(kind, rows, columns, gaps, names, seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(rows * columns, 3)).astype("f4")
    points[rng.random(points.shape) < 0.2] = np.nan
    before, between, after, end = gaps
    message = cloud_of(
        points, kind=kind, rows=rows, before=before, between=between, after=after, end=end, names=names
    )
    np.testing.assert_array_equal(points_of(message, EVERY).T, points)


def test_of_large_clouds_some_points_are_read():
    points = np.arange(3 * 120 * 160).reshape(-1, 3)
    image = points_of(cloud_of(points, rows=120), 5000)
    assert 4000 < image.shape[1] <= 5000
    np.testing.assert_array_equal(image, points.reshape(120, 160, 3)[::2, ::2].reshape(-1, 3).T)
    line = points_of(cloud_of(points), 5000)
    np.testing.assert_array_equal(line, points[::4].T)


def test_messages_that_cannot_be_read_are_told():
    points = np.zeros((6, 3))
    with pytest.raises(CloudError, match="no z, but x, y, rgb"):
        points_of(cloud_of(points, names="xy"), EVERY)
    whole = cloud_of(points)
    whole.fields[1].datatype = 4
    with pytest.raises(CloudError, match="y is of type 4"):
        points_of(whole, EVERY)
    for change in ({"width": 7}, {"height": 2}, {"data": bytearray(5)}, {"point_step": 11}):
        short = cloud_of(points, rows=1)
        vars(short).update(change)
        with pytest.raises(CloudError, match="bytes are not"):
            points_of(short, EVERY)


SHAPES = {
    "sphere": {"shape": "sphere", "radius": 0.1},
    "box": {"shape": "box", "size": [0.2, 0.3, 0.4]},
    "cube": {"shape": "box", "size": [0.1, 0.1, 0.1]},
    "capsule": {"shape": "capsule", "radius": 0.06, "length": 0.3},
    "cylinder": {"shape": "cylinder", "radius": 0.06, "height": 0.3},
}
MOVES = {"velocity": [0.1, 0.0, 0.0]}


def scene_with(*obstacles):
    """A scene of robots with obstacles."""
    return Scene.from_dict(
        {
            "version": 1,
            "name": "seen",
            "duration": 5.0,
            "workspace": {"lower": [-3, -3, -3], "upper": [3, 3, 3]},
            "manipulators": [{"name": "left", "start": [-2, 0, 2], "goal": [-2, 1, 2]}],
            "obstacles": list(obstacles),
        }
    )


def placed(name, center=(0.0, 0.0, 0.0), seed=0, **more):
    turn = Rotation.random(random_state=seed).as_quat(scalar_first=True).tolist()
    turned = {} if name == "sphere" else {"quaternion_wxyz": turn}
    return {"name": name, "center": list(center), **SHAPES[name], **turned, **more}


def shape_of(scene, number=0):
    told = watched(scene, {number: "it"}, NOISE)["moving"]["it"]
    return Shape.of(told)


def seen_points(scene, rng, *, side=None, number=0, spacing=0.012, noise=CAMERA, strays=0.2):
    """Points of an obstacle on the side that a camera sees, (n, 3) [m], with stray ones all around."""
    row = scene.obstacles[number]
    points = surface(row, 3, spacing, rng)
    side = rng.normal(size=3) if side is None else np.asarray(side)
    camera = row[sd.CENTER : sd.CENTER + 3] + 1.5 * side / np.linalg.norm(side)
    shape = shape_of(scene, number)
    normals = shape.gradients(0.999 * (points - row[sd.CENTER : sd.CENTER + 3]))
    ray = camera - points
    points = points[(normals * ray).sum(axis=1) > 0.15 * np.linalg.norm(ray, axis=1)]
    points = points + noise * rng.normal(size=points.shape)
    n_strays = int(strays / (1.0 - strays) * len(points))
    around = shape.reach + GATE
    return np.vstack([points, row[sd.CENTER : sd.CENTER + 3] + rng.uniform(-around, around, (n_strays, 3))])


@pytest.mark.parametrize("name", SHAPES)
def test_distances_are_those_of_the_kernels(name):
    rng = np.random.default_rng(1)
    scene = scene_with(placed(name, motion=MOVES))
    points = rng.normal(scale=0.2, size=(200, 3))
    found, slopes = shape_of(scene).distances(points), shape_of(scene).gradients(points)
    np.testing.assert_allclose(found, [sd.point_distance(scene.obstacles, 0, *p) for p in points], atol=1e-12)
    ahead, step = rng.normal(size=(200, 3)), 1e-7
    numeric = (shape_of(scene).distances(points + step * ahead) - found) / step
    np.testing.assert_allclose((slopes * ahead).sum(axis=1), numeric, atol=1e-4)


def test_distances_of_a_mesh_are_those_of_the_kernels(tmp_path):
    import trimesh

    trimesh.creation.icosahedron().apply_scale(0.15).export(tmp_path / "stone.stl")
    stone = {
        "name": "stone",
        "shape": "mesh",
        "file": "stone.stl",
        "center": [0.0, 0.0, 0.0],
        "motion": MOVES,
    }
    data = scene_with().file.model_dump(mode="json", exclude_none=True) | {"obstacles": [stone]}
    scene = Scene.from_dict(data, folder=tmp_path)
    points = np.random.default_rng(1).normal(scale=0.15, size=(200, 3))
    found = shape_of(scene).distances(points)
    rows = range(len(scene.obstacles))
    kernels = [min(sd.point_distance(scene.obstacles, j, *p) for j in rows) for p in points]
    np.testing.assert_allclose(found, kernels, atol=1e-12)


@pytest.mark.parametrize("name", SHAPES)
def test_half_visible_shapes_are_found(name):
    """3 mm of noise, 20 % of stray points, seen from anywhere, begun 5 cm away: told centres are right."""
    errors = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        at = rng.uniform(-1.0, 1.0, 3)
        scene = scene_with(placed(name, at, seed, motion=MOVES))
        off = rng.normal(size=3)
        start = at + 0.05 * off / np.linalg.norm(off)
        try:
            found = fitted_center(shape_of(scene), seen_points(scene, rng), start, NOISE, GATE)
        except Unseen:
            continue
        errors.append(np.linalg.norm(found - at))
    assert len(errors) >= 10, "most views show enough"
    assert max(errors) < WITHIN * NOISE and np.median(errors) < 0.002


@pytest.mark.parametrize("seed", range(4))
def test_a_covered_face_is_not_told(seed):
    """One face alone tells where a box is if both of its edges in either direction are seen, and not else."""
    rng = np.random.default_rng(seed)
    box = placed("box", motion=MOVES) | {"quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}
    scene = scene_with(box)
    face = seen_points(scene, rng, side=[1.0, 0.0, 0.0], strays=0.0)
    assert (face[:, 0] > 0.1 - 5 * CAMERA).all()
    start = rng.uniform(-0.02, 0.02, 3)
    whole = fitted_center(shape_of(scene), face, start, NOISE, GATE)
    assert np.linalg.norm(whole) < WITHIN * NOISE
    with pytest.raises(Unseen, match="leave open where it is"):
        fitted_center(shape_of(scene), face[face[:, 1] < 0.1], start, NOISE, GATE)


def test_other_things_are_not_taken_for_the_obstacle():
    rng = np.random.default_rng(0)
    scene = scene_with(placed("sphere", motion=MOVES))
    shape, start = shape_of(scene), np.array([0.02, 0.0, 0.0])
    wall = np.column_stack([np.full(2000, 0.1), rng.uniform(-0.3, 0.3, (2000, 2))])
    wall += CAMERA * rng.normal(size=wall.shape)
    with pytest.raises(Unseen, match="leave open"):
        fitted_center(shape, wall, start, NOISE, GATE)
    with pytest.raises(Unseen, match="20 points show it"):
        fitted_center(shape, seen_points(scene, rng, strays=0.0)[:20], start, NOISE, GATE)
    with pytest.raises(Unseen):
        fitted_center(shape, rng.uniform(-0.2, 0.2, (600, 3)), start, NOISE, GATE)
    ball = seen_points(scene, rng, strays=0.0)
    with pytest.raises(Unseen, match="lie inside it"):
        fitted_center(
            shape, np.vstack([ball, rng.normal(scale=0.02, size=(len(ball), 3))]), start, NOISE, GATE
        )
    with pytest.raises(Unseen):
        fitted_center(shape, ball + [0.0, 0.15, 0.0], start, NOISE, GATE)
    table = np.column_stack([rng.uniform(-0.3, 0.3, (len(ball), 2)), np.full(len(ball), -0.1)])
    assert np.linalg.norm(fitted_center(shape, np.vstack([ball, table]), start, NOISE, GATE)) < WITHIN * NOISE


@pytest.fixture
def tracks(monkeypatch):
    """A function that returns what follows the moving obstacles of a scene."""
    monkeypatch.syspath_prepend(str(Path(comove.ros.__file__).parent))
    module = importlib.import_module("ros2_tracks")

    def of(scene):
        names = {int(j): scene.file.obstacles[j].name for j in np.flatnonzero(scene.moving)}
        return module.CloudTracks(**watched(scene, names, NOISE), noise=NOISE)

    return of


def scan(scene, rng, hidden=()):
    """A message of all obstacles of a scene but the hidden ones, seen from one place."""
    shown = [k for k, o in enumerate(scene.file.obstacles) if o.name not in hidden]
    parts = [seen_points(scene, rng, side=[1.0, -1.0, 1.0], number=k, strays=0.0) for k in shown]
    return cloud_of(np.vstack([*parts, np.full((50, 3), np.nan)]))


def at_time(scene, time, centers):
    """The scene with obstacles where they are then."""
    return replace(scene, obstacles=scene.obstacles_at(time, centers))


def test_obstacles_are_followed_and_a_hidden_one_is_not_told(tracks):
    rng = np.random.default_rng(0)
    table = {"name": "table", "shape": "box", "center": [0.0, 0.0, -0.25], "size": [1.0, 1.0, 0.1]}
    scene = scene_with(
        placed("sphere", [0.0, 0.0, -0.1], motion=MOVES),
        table,
        placed(
            "cube", [0.3, 0.3, 0.2], 2, motion={"turn": {"rate_deg_per_s": 90.0, "axis": [1.0, 1.0, 0.0]}}
        ),
    )
    followed = tracks(scene)
    followed.zero = 100.0
    for k in range(40):
        time = k / 30.0
        centers = scene.centers.copy()
        centers[0] += [0.3 * np.sin(2.0 * time), 0.0, 0.0]
        centers[2] += [0.0, 0.2 * time, 0.0]
        hidden = {"cube"} if 20 <= k < 25 else set()
        told, unseen = followed.update(scan(at_time(scene, time, centers), rng, hidden), 100.0 + time)
        assert set(told) == {"sphere", "cube"} - hidden and set(unseen) == hidden
        for name, center in told.items():
            assert np.linalg.norm(center - centers[{"sphere": 0, "cube": 2}[name]]) < WITHIN * NOISE


def test_clouds_that_come_too_often_or_late_are_left_out(tracks):
    rng = np.random.default_rng(0)
    scene = scene_with(placed("sphere", motion=MOVES))
    followed, message = tracks(scene), scan(scene, rng)
    assert followed.update(message, 1.0)[0]
    for time in (1.0, 0.9, 1.001):
        assert followed.update(message, time) == ({}, {})
    assert followed.update(message, 1.04)[0]
    message.fields[0].name = "u"
    told, unseen = followed.update(message, 1.08)
    assert told == {} and "no x" in unseen["sphere"]


def test_shapes_that_are_not_fitted_are_refused():
    egg = {
        "name": "egg",
        "shape": "ellipsoid",
        "center": [0, 0, 0],
        "radii": [0.1, 0.2, 0.3],
        "motion": MOVES,
    }
    with pytest.raises(SendError, match="'egg' is an ellipsoid, which is not fitted") as found:
        watched(scene_with(egg), {0: "egg"}, NOISE)
    assert "PoseArray" in found.value.way_out
    still = watched(scene_with({k: v for k, v in egg.items() if k != "motion"}), {}, NOISE)
    assert still == {"moving": {}, "still": []}
    scene = scene_with(placed("cube", motion=MOVES))
    scene.excess[0] = 0.02
    with pytest.raises(SendError, match="reach up to 20 mm beyond it"):
        watched(scene, {0: "cube"}, NOISE)


def test_the_program_tells_what_it_does_not_see(monkeypatch):
    events = []
    program = Message(news=lambda wait: events.pop(0), last_words=lambda: "killed")
    monkeypatch.setattr("comove.ros.clouds.started", lambda *_: (program, {"event": "watching"}, []))
    clouds = ObstacleClouds("/cloud", scene_with(placed("cube", motion=MOVES)), {0: "cube"}, NOISE)
    assert clouds.unseen == {"cube": "no cloud has come"}
    unseen = {"event": "unseen", "time": 0.0, "frame": "world", "why": {"cube": "3 points show it"}}
    seen = {"event": "obstacles", "time": 0.0, "frame": "world", "centers": {"cube": [0.0, 0.0, 0.0]}}
    events += [[unseen], [seen], [{"event": "ended"}]]
    assert clouds.news() == [unseen] and clouds.unseen == unseen["why"]
    assert clouds.news() == [seen] and clouds.unseen == {} and not clouds.ended
    assert clouds.news() == [] and clouds.ended == "the program that reads the clouds ended: killed"
