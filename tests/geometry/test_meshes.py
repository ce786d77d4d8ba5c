"""Meshes in scenes: files that are refused or mended, and scenes whose load and obstacles are meshes."""

import os
import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comove.errors import ComoveWarning, SceneError
from comove.geometry import meshes as module
from comove.geometry.convex_decomposition import left_out
from comove.geometry.distances import POLYTOPE, point_distance
from comove.geometry.surfaces import signed_distance
from comove.model import CoordinatedMotion, Scene
from comove.verification import verify

from ..meshes import box, l_profile, prism, ring, write_obj, write_stl

GRASPS = {"a": [0.02, 0.19, 0.03], "b": [0.29, 0.025, 0.03]}


@pytest.fixture
def folder(tmp_path):
    write_stl(tmp_path / "l.stl", *l_profile())
    write_obj(tmp_path / "l.obj", *l_profile())
    write_stl(tmp_path / "ring.stl", *ring())
    write_obj(tmp_path / "box.obj", *box([0.3, 0.2, 0.1]))
    return tmp_path


def data(load=None, obstacles=(), **more):
    """Two hands that move an L, or something else, along y."""
    load = {"shape": "mesh", "file": "l.obj", "grasps": GRASPS} if load is None else load
    held = np.array(list(load["grasps"].values()))
    return {
        "name": "meshes",
        "duration": 5.0,
        "workspace": {"lower": [0, 0, 0], "upper": [2, 2, 1]},
        "obstacles": list(obstacles),
        "load": load,
        "constraints": [{"type": "upright"}],
        "manipulators": [
            {"name": n, "start": list(h + [0.5, 0.3, 0.3]), "goal": list(h + [0.5, 1.3, 0.3])}
            for n, h in zip(load["grasps"], held, strict=True)
        ],
        **more,
    }


def obstacle(file, **more):
    return {"shape": "mesh", "file": file, "center": [1.5, 1.0, 0.5], **more}


def build(folder, *args, **more):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return Scene.from_dict(data(*args, **more), folder=folder)


def refused(folder, *args, **more):
    with pytest.raises(SceneError) as caught:
        Scene.from_dict(data(*args, **more), folder=folder)
    assert caught.value.key and caught.value.way_out
    return str(caught.value)


def test_a_load_of_any_shape(folder):
    scene = build(folder)
    assert scene.body.solids.shape[0] == 2
    assert scene.excess == {"load": 0.0}
    nodes = scene.nodes_at("start")[2:]
    assert np.ptp(nodes, axis=0) == pytest.approx([0.3, 0.2, 0.06])
    assert nodes.min(axis=0) == pytest.approx([0.5, 0.3, 0.3])


def test_formats_agree(folder):
    one, other = build(folder), build(folder, data()["load"] | {"file": "l.stl"})
    assert np.ptp(one.nodes_at("start"), axis=0) == pytest.approx(np.ptp(other.nodes_at("start"), axis=0))


def test_an_obstacle_is_several_rows_and_one_name(folder):
    turn = Rotation.from_euler("x", 90, degrees=True)
    quaternion = turn.as_quat()[[3, 0, 1, 2]].tolist()
    ball = {"shape": "sphere", "center": [0.2, 1.8, 0.8], "radius": 0.1}
    scene = build(folder, obstacles=[ball, obstacle("ring.stl", quaternion_wxyz=quaternion), ball])
    assert set(scene.owners) == {0, 1, 2}
    own = scene.obstacles[scene.owners == 1]
    assert len(own) > 3
    assert (own[:, 0] == POLYTOPE).all()
    assert scene.name_of(1) == "obstacles[1] (mesh)"
    assert scene.name_of(scene.owner_of(len(own))) == "obstacles[1] (mesh)"
    assert scene.centers == pytest.approx(np.array([[0.2, 1.8, 0.8], [1.5, 1.0, 0.5], [0.2, 1.8, 0.8]]))
    # The ring's axis lies along y, and its hole is open.
    rows = np.flatnonzero(scene.owners == 1)
    assert min(point_distance(scene.obstacles, j, 1.5, 0.98, 0.5) for j in rows) > 0.04
    assert min(point_distance(scene.obstacles, j, 1.575, 0.98, 0.5) for j in rows) < 0
    assert scene.obstacles_at(0.0) is scene.obstacles


def test_a_mesh_moves_as_a_whole(folder):
    scene = build(folder, obstacles=[obstacle("ring.stl", motion={"velocity": [-0.1, 0, 0]})])
    assert scene.moving.tolist() == [True]
    assert scene.offsets(np.array([0.0, 2.0])).shape == (2, 1, 3)
    there = scene.obstacles_at(2.0)
    assert there[:, 1:4] == pytest.approx(np.tile([1.3, 1.0, 0.5], (len(there), 1)))
    assert scene.displacements_along(7).offsets.shape == (7, len(there), 3)


def test_scale_makes_metres(folder):
    vertices, faces = l_profile()
    write_obj(folder / "mm.obj", 1000 * vertices, faces)
    scene = build(folder, {"shape": "mesh", "file": "mm.obj", "scale": 0.001, "grasps": GRASPS})
    assert np.ptp(scene.nodes_at("start")[2:], axis=0) == pytest.approx([0.3, 0.2, 0.06])
    with pytest.warns(
        ComoveWarning, match=r"load.file: 'mm.obj' is 300 m long, which looks like millimetres"
    ):
        refused(folder, {"shape": "mesh", "file": "mm.obj", "grasps": GRASPS})
    assert "out of range" in refused(folder, data()["load"] | {"scale": 0})
    assert "out of range" in refused(folder, obstacles=[obstacle("ring.stl", scale=-1)])


def test_the_checksum_follows_the_mesh(folder):
    before = build(folder).sha256
    assert build(folder).sha256 == before
    vertices, faces = l_profile()
    write_obj(folder / "l.obj", 1.01 * vertices, faces)
    assert build(folder).sha256 != before


def test_a_mesh_of_a_box_is_placed_as_a_box(folder):
    grasps = {"a": [-0.16, 0.0, 0.0], "b": [0.16, 0.0, 0.0]}
    mesh = build(folder, {"shape": "mesh", "file": "box.obj", "grasps": grasps})
    same = build(folder, {"shape": "box", "size": [0.3, 0.2, 0.1], "grasps": grasps})
    for end in ("start", "goal"):
        corners = [np.unique(s.nodes_at(end)[2:].round(9), axis=0) for s in (mesh, same)]
        assert corners[0] == pytest.approx(corners[1])
    text = refused(folder, {"shape": "mesh", "file": "box.obj", "grasps": grasps}, constraints=[])
    assert "leave the mesh free to turn about the line through their hands" in text


@pytest.mark.slow
def test_an_open_mesh_is_thin_walls_and_says_so(folder):
    """As a load it has room for something: a point in its corner that its hull would hold is not in it."""
    vertices, faces = l_profile()
    write_obj(folder / "open.obj", vertices, faces[:-1])
    with pytest.warns(ComoveWarning, match=r"'open.obj' is not closed: what is open counts as thin walls"):
        scene = Scene.from_dict(data(data()["load"] | {"file": "open.obj"}), folder=folder)
    with pytest.warns(ComoveWarning, match="not closed"):
        decomposition = module.read_mesh(folder / "open.obj", 1.0, file=None, key="x").decomposed(
            None, few=True
        )
    assert left_out(vertices[faces[:-1]], list(decomposition.polytopes), 1e-9) == []
    assert len(scene.body.solids) == len(decomposition.polytopes)
    inside = np.array([0.025, 0.1, 0.03])
    assert min((p.planes[:, :3] @ inside - p.planes[:, 3]).max() for p in decomposition.polytopes) < 0.025


@pytest.mark.parametrize("write", [write_obj, write_stl])
def test_triangles_without_area_count_where_they_stick_out(folder, write):
    """A line from a corner is met as what it is; one along an edge leaves a closed box closed, without a word."""
    vertices, faces = box([0.3, 0.2, 0.1])
    name = write(folder / f"lines.{write.__name__[-3:]}", vertices, [*faces, [0, 0, 1], [2, 2, 2]]).name
    build(folder, obstacles=[obstacle(name)])
    top = int(vertices[:, 2].argmax())
    line = vertices[top] + [[0.0, 0.0, 0.0], [0.0, 0.0, 0.2]]
    write(folder / name, [*vertices, line[1]], [*faces, [top, top, len(vertices)], [len(vertices), top, top]])
    with pytest.warns(ComoveWarning, match="not closed in 1 of its 2 parts"):
        scene = Scene.from_dict(data(obstacles=[obstacle(name)]), folder=folder)
    for share in (0.2, 1.0):
        beside = np.array([[1.5, 1.01, 0.5]]) + (1 - share) * line[0] + share * line[1]
        assert signed_distance(scene.surfaces, 0, beside, np.inf) == pytest.approx(0.01, abs=1e-6)


def test_two_sides_of_a_sheet_stop_what_comes(folder):
    """A small closed box and, apart, a large sheet whose triangles are there both ways round."""
    vertices, faces = box([0.05, 0.05, 0.05])
    sheet = np.array([[-0.45, 0, -0.45], [0.45, 0, -0.45], [0.45, 0, 0.45], [-0.45, 0, 0.45]])
    both = np.array([[0, 1, 2], [0, 2, 3]])
    both = np.concatenate([both, both[:, ::-1]]) + len(vertices)
    write_obj(
        folder / "sheet.obj", np.concatenate([vertices - [0.4, 0.2, 0], sheet]), np.concatenate([faces, both])
    )
    with pytest.warns(ComoveWarning, match="in 1 of its 2 parts"):
        scene = Scene.from_dict(
            data(obstacles=[{"shape": "mesh", "file": "sheet.obj", "center": [0.6, 0.8, 0.4]}]), folder=folder
        )
    verdict = verify(CoordinatedMotion.straight(scene))
    assert verdict.verified is None
    assert "obstacles[0] (mesh)" in verdict.reasons[0]


def test_a_start_within_a_solid_is_refused_however_its_triangles_are_written(folder):
    """Once, each twice, each both ways round, turned inwards, or beside another with a side in common."""
    vertices, faces = box([0.8, 0.8, 0.8])
    turned = faces[:, ::-1]
    beside = np.concatenate([faces, faces + 8])
    pair = np.concatenate([vertices, vertices + [0.8, 0.0, 0.0]])
    for name, (v, f) in {
        "once": (vertices, faces),
        "twice": (vertices, np.concatenate([faces, faces])),
        "both": (vertices, np.concatenate([faces, turned])),
        "inwards": (vertices, turned),
        "mixed": (vertices, np.concatenate([faces[::2], turned[1::2]])),
        "pair": (pair, beside),
    }.items():
        write_obj(folder / f"{name}.obj", v, f)
        text = refused(
            folder, obstacles=[{"shape": "mesh", "file": f"{name}.obj", "center": [0.65, 0.4, 0.35]}]
        )
        assert "at the start the load or a hand reaches" in text, name


@pytest.mark.parametrize("turn", ["one", "all", "some"])
def test_triangles_turned_the_wrong_way_are_turned_back(folder, turn):
    vertices, faces = l_profile()
    faces = faces.copy()
    wrong = {"one": [3], "all": slice(None), "some": slice(0, None, 3)}[turn]
    faces[wrong] = faces[wrong][:, ::-1]
    write_obj(folder / "turned.obj", vertices, faces)
    scene = build(folder, data()["load"] | {"file": "turned.obj"})
    assert len(scene.body.solids) == 2
    assert scene.excess["load"] == 0.0


def test_a_corner_that_three_solids_share_is_no_hole(folder):
    """Two boxes that share an edge: four faces meet there."""
    vertices, faces = box([0.1, 0.1, 0.1])
    other = vertices + [0.1, 0.1, 0.0]
    write_obj(folder / "two.obj", np.concatenate([vertices, other]), np.concatenate([faces, faces + 8]))
    scene = build(folder, obstacles=[obstacle("two.obj")])
    assert scene.excess[0] < 0.01
    assert len(scene.obstacles) == 2


NAN = "v 0 0 0\nv 1 0 0\nv 0 1 nan\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
POINT = "v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n"


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.stl", b"solid a\nendsolid a\n", ["'a.stl'", "; "]),
        ("a.stl", b"", ["'a.stl': it has 0 bytes", "header"]),
        ("a.stl", b"\0" * 80 + np.uint32(10**9).tobytes(), ["claims 1000000000 triangles and holds 0"]),
        ("a.obj", NAN.encode(), ["'a.obj': 'nan' is no number"]),
        ("a.obj", POINT.encode(), ["is a point"]),
        ("a.obj", b"v 0 0 0\n", ["'a.obj'"]),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex zwei\n", ["'a.ply': its header has no end"]),
        ("a.off", b"OFF\n1", ["'a.off'"]),
        ("a.fbx", b"x", ["'a.fbx': it is no mesh that can be read", "DAE, OBJ, OFF, PLY, STL"]),
        ("a.pkl", b"x", ["is no mesh that can be read"]),
    ],
)
def test_a_file_that_holds_no_mesh_is_refused(folder, name, content, told):
    (folder / name).write_bytes(content)
    for text in (
        refused(folder, data()["load"] | {"file": name}),
        refused(folder, obstacles=[obstacle(name)]),
    ):
        assert all(part in text for part in told), text
        assert "Traceback" not in text


@pytest.mark.parametrize(
    ("file", "told"),
    [
        ("none.stl", ["obstacles[0].file", "there is no file 'none.stl'"]),
        ("../l.stl", ["outside the scene's folder"]),
        ("/etc/passwd", ["outside the scene's folder"]),
        ("folder.stl", ["'folder.stl' is a folder"]),
        ("pipe.stl", ["'pipe.stl' is not a regular file"]),
    ],
)
def test_files_are_in_the_scenes_folder(folder, file, told):
    (folder / "folder.stl").mkdir()
    os.mkfifo(folder / "pipe.stl")
    text = refused(folder, obstacles=[obstacle(file)])
    assert all(part in text for part in told), text


def test_too_many_triangles_are_refused(folder, monkeypatch):
    monkeypatch.setattr(module, "MAX_FACES", 100)
    write_stl(folder / "many.stl", *prism(np.array([[0, 0], [0.3, 0], [0.3, 0.2], [0, 0.2]]), 0, 0.1))
    build(folder, obstacles=[obstacle("many.stl")])
    assert "has 128 triangles; decimate it to 100 or fewer" in refused(
        folder, obstacles=[obstacle("ring.stl", scale=2)]
    )


def test_a_resolution_as_coarse_as_the_mesh_is_refused(folder):
    assert "the resolution is 0.5 m" in refused(folder, obstacles=[obstacle("ring.stl", resolution=0.5)])


def test_meshes_need_space(folder):
    flat = {
        "name": "flat",
        "duration": 1.0,
        "workspace": {"lower": [0, 0], "upper": [1, 1]},
        "obstacles": [{"shape": "mesh", "file": "l.stl", "center": [0.5, 0.5]}],
        "manipulators": [{"name": "a", "start": [0.1, 0.1], "goal": [0.2, 0.1]}],
    }
    with pytest.raises(SceneError, match="a mesh needs a spatial scene"):
        Scene.from_dict(flat, folder=folder)
