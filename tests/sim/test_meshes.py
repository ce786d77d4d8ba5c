"""Meshes are converted once, truly, and what is in the cache is whole."""

import os
from concurrent.futures import ThreadPoolExecutor
from pkgutil import get_data

import numpy as np
import pytest

from comove.errors import RobotError
from comove.sim import meshes
from comove.sim.meshes import SEAL, as_obj, cache_folder, coloured_parts, convex_parts_of
from tests.geometry.triangles.written import WEDGE

trimesh = pytest.importorskip("trimesh")

DAE = WEDGE.replace("Y_UP", "Z_UP")


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "comove" / "meshes"


@pytest.fixture
def box(tmp_path):
    path = tmp_path / "box.stl"
    trimesh.creation.box((0.1, 0.2, 0.3)).export(path)
    return path


def test_the_cache_is_where_it_should_be(cache, box):
    assert cache_folder() == cache
    assert as_obj(box).parent == cache


def test_a_converted_mesh_is_the_same_body(box):
    mesh = trimesh.load(as_obj(box), force="mesh")
    assert mesh.is_watertight
    assert np.allclose(mesh.extents, (0.1, 0.2, 0.3))
    assert mesh.volume == pytest.approx(0.006)


def test_a_drawing_in_centimetres_becomes_metres(tmp_path):
    pytest.importorskip("collada")
    path = tmp_path / "wedge.dae"
    path.write_text(DAE)
    mesh = trimesh.load(as_obj(path), force="mesh")
    assert np.allclose(mesh.bounds, [[0, 0, 0], [1.0, 0.5, 0.25]])
    assert [part.suffix for part, _ in coloured_parts(path)] == [".obj"]


def test_a_mesh_that_is_hollow_collides_by_several_hulls(tmp_path):
    bars, path = [trimesh.creation.box(size) for size in ((40.0, 5, 5), (5.0, 40, 5))], tmp_path / "bent.stl"
    bars[1].apply_translation((-17.5, 17.5, 0.0))
    trimesh.util.concatenate(bars).export(path)  # in centimetres
    whole = trimesh.load(path, force="mesh")
    for moves in (True, False):
        parts = convex_parts_of(path, (0.01, 0.01, 0.01), moves)
        hulls = [trimesh.load(part, force="mesh") for part in parts]
        assert all(hull.is_convex for hull in hulls)
        assert sum(hull.volume for hull in hulls) < 0.6e-6 * whole.convex_hull.volume
        assert np.allclose(trimesh.util.concatenate(hulls).bounds, 0.01 * whole.bounds, atol=1e-6)
        assert len(parts) > 1
    flat = tmp_path / "flat.stl"
    trimesh.Trimesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)]).export(flat)
    parts = convex_parts_of(flat, (1.0, 1.0, 1.0), True)
    assert all(0 < trimesh.load(part, force="mesh").volume < 1e-3 for part in parts)


def test_what_is_converted_is_kept(box):
    first = as_obj(box)
    written = first.stat().st_mtime_ns
    assert as_obj(box) == first
    assert first.stat().st_mtime_ns == written


@pytest.mark.parametrize(
    "spoil", [lambda b: b[: len(b) // 2], lambda b: b.replace(b"v ", b"v 9", 1), lambda b: b""]
)
def test_a_damaged_entry_is_made_anew(box, spoil):
    path = as_obj(box)
    whole = path.read_bytes()
    assert SEAL in whole
    path.write_bytes(spoil(whole))
    assert as_obj(box).read_bytes() == whole


def test_another_mesh_of_the_same_name_is_another_entry(box):
    first = as_obj(box)
    trimesh.creation.box((0.1, 0.2, 0.4)).export(box)
    assert as_obj(box) != first


def test_many_at_once_leave_whole_entries_only(box, cache):
    with ThreadPoolExecutor(8) as pool:
        paths = set(pool.map(as_obj, [box] * 8))
    assert len(paths) == 1
    assert not [path for path in cache.iterdir() if path.name.startswith(".")]
    assert trimesh.load(as_obj(box), force="mesh").volume == pytest.approx(0.006)


@pytest.mark.parametrize("text", ["", "solid nothing\nendsolid\n", "no mesh at all"])
def test_what_holds_no_triangles_is_refused(tmp_path, text):
    path = tmp_path / "empty.stl"
    path.write_text(text)
    with pytest.raises(RobotError, match=r"empty.stl.*cannot be read"):
        as_obj(path)


def test_a_cache_that_cannot_be_written_is_told(tmp_path, monkeypatch, box):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.raises(RobotError, match="XDG_CACHE_HOME"):
        as_obj(box)


PYRAMID = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.mark.parametrize(
    "named", ["pipe.mtl", "/dev/zero", "../secret.mtl", "x" * 5000, "nul\\0.mtl", "m.png"]
)
def test_a_mesh_brings_no_files_along_but_materials_beside_it(tmp_path, named, cache):
    """Others are as if they were not there; a pipe would wait for ever."""
    folder = tmp_path / "meshes"
    folder.mkdir()
    os.mkfifo(folder / "pipe.mtl")
    (tmp_path / "secret.mtl").write_text("newmtl m\nKd 1 0 0\n")
    (folder / "own.mtl").write_text("newmtl m\nKd 1 0 0\n")
    (folder / "red.obj").write_text("mtllib own.mtl\nusemtl m\n" + PYRAMID)
    (folder / "other.obj").write_text(f"mtllib {named}\nusemtl m\n" + PYRAMID)
    ((_, red),) = coloured_parts(folder / "red.obj")
    ((_, other),) = coloured_parts(folder / "other.obj")
    assert red[0] == 1.0 and red[1] == red[2] < 0.1
    assert other != red


def test_what_would_take_trimesh_for_ever_is_drawn_plainly_or_told(tmp_path):
    changes = "".join(f"usemtl m{k}\nf 1 2 3\n" for k in range(50_000))
    (tmp_path / "changes.obj").write_text(PYRAMID + changes)
    assert len(coloured_parts(tmp_path / "changes.obj")) == 1
    (tmp_path / "many.dae").write_text(
        DAE.replace('<instance_geometry url="#g"/>', '<instance_geometry url="#g"/>' * 20_000)
    )
    with pytest.raises(RobotError, match="too many"):
        coloured_parts(tmp_path / "many.dae")


def test_a_vertex_that_is_no_place_is_told(tmp_path):
    for number in ("nan", "inf", "1e308", ""):
        (tmp_path / "a.obj").write_text(PYRAMID.replace("v 1 0 0", f"v {number} 0 0"))
        with pytest.raises(RobotError, match="cannot be read"):
            as_obj(tmp_path / "a.obj")


def test_a_mesh_that_cannot_be_opened_is_told(tmp_path):
    (tmp_path / "a.obj").symlink_to("/proc/self/mem")
    with pytest.raises(RobotError, match="the mesh cannot be read"):
        as_obj(tmp_path / "a.obj")


def test_what_other_code_has_converted_is_converted_anew(tmp_path, monkeypatch):
    path = tmp_path / "bent.stl"
    bars = [trimesh.creation.box(size) for size in ((0.4, 0.05, 0.05), (0.05, 0.4, 0.05))]
    bars[1].apply_translation((-0.175, 0.175, 0.0))
    trimesh.util.concatenate(bars).export(path)
    scale, sources = (1.0, 1.0, 1.0), {}
    several = convex_parts_of(path, scale, True)
    monkeypatch.setattr(meshes, "convex_parts", lambda points, *_: [points])  # as another comove would
    assert convex_parts_of(path, scale, True) == several

    def changed(package, name):
        source = get_data(package, name)
        sources[name] = source
        return source + b"\n" if name == "capsules.py" else source

    monkeypatch.setattr(meshes, "get_data", changed)
    meshes.made_by.cache_clear()
    try:
        assert len(convex_parts_of(path, scale, True)) == 1 < len(several)
    finally:
        meshes.made_by.cache_clear()
    assert set(sources) >= {"capsules.py", "meshes.py"} and all(sources.values())
