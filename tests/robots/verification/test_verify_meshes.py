"""Meshes beside a robot: verdicts as of the boxes that they are, insides, and notches that hulls would fill."""

import warnings

import coal
import numpy as np
import pinocchio as pin
import pytest

from comove.model import Scene
from comove.robots import verify_joints
from comove.robots.verification.bodies import _triangles, depth_of
from tests.meshes import prism, write_stl
from tests.robots.known_carry import TABLE, baxter, known_carry, on_scene, scene_data


def slab(folder, size, name="slab.stl"):
    """A box as a closed mesh whose origin is its centre."""
    x, y, z = np.array(size) / 2
    vertices, faces = prism(np.array([[-x, -y], [x, -y], [x, y], [-x, y]]), 0, 2 * z)
    write_stl(folder / name, vertices - [0, 0, z], faces)
    return {"shape": "mesh", "file": name}


def verdict_on(folder, *obstacles):
    """The verdict on the known carry among obstacles."""
    motion, joints = known_carry()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = Scene.from_dict(scene_data(obstacles=obstacles), folder=folder)
    return verify_joints(baxter(), on_scene(motion, scene), joints)


def test_a_box_as_a_mesh_is_as_far_away_as_the_box(tmp_path):
    mesh = slab(tmp_path, TABLE["size"]) | {"center": TABLE["center"]}
    one, other = verdict_on(tmp_path, TABLE), verdict_on(tmp_path, mesh)
    assert one.verified is not None
    assert other.verified is not None
    assert other.report.clearance_scene == pytest.approx(one.report.clearance_scene, abs=2e-3)
    assert "mesh" in other.report.where["clearance_scene"][0]


def test_a_mesh_in_the_way_of_a_link_is_named(tmp_path):
    size, center = [0.06, 0.06, 0.4], [0.75, 0.35, 0.5]
    mesh = slab(tmp_path, size) | {"center": center}
    (boxed,) = verdict_on(tmp_path, {"shape": "box", "size": size, "center": center}).reasons
    (reason,) = verdict_on(tmp_path, mesh).reasons
    assert "obstacles[0] (mesh)" in reason
    assert reason.split(" and ")[0] == boxed.split(" and ")[0]  # the same link


def depth_told(reason):
    """How deep bodies meet, as a message says [m]."""
    return float(reason.partition("meet, ")[2].removeprefix("at most ").split()[0])


def test_a_mesh_is_met_as_deep_as_the_box_that_it_is(tmp_path):
    size, center = [0.06, 0.06, 0.4], [0.75, 0.35, 0.5]
    mesh = slab(tmp_path, size) | {"center": center}
    (boxed,) = verdict_on(tmp_path, {"shape": "box", "size": size, "center": center}).reasons
    (reason,) = verdict_on(tmp_path, mesh).reasons
    assert depth_told(boxed) > 0.001
    assert depth_told(reason) == pytest.approx(depth_told(boxed), rel=0.1)


@pytest.mark.parametrize("apart", [0.15, 0.1948])
@pytest.mark.parametrize("meshes", [(), (0,), (1,), (0, 1)])
def test_depths_of_boxes_are_the_same_as_meshes(apart, meshes, tmp_path):
    shapes = [coal.Box(0.2, 0.2, 0.2), coal.Box(0.2, 0.2, 0.2)]
    corners = 0.1 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for k in meshes:
        vertices, faces = prism(corners, 0, 0.2)
        shapes[k] = _triangles((vertices - [0, 0, 0.1])[faces])
    places = [pin.SE3.Identity(), pin.SE3(np.eye(3), np.array([apart, 0.003, 0.002]))]
    depth, is_bound = depth_of(shapes, places)
    assert depth == pytest.approx(0.2 - apart, abs=1e-6)
    assert not is_bound


def test_the_depth_of_a_mesh_that_is_not_convex_is_a_bound():
    vertices, faces = _channel(0.7)
    places = [pin.SE3.Identity(), pin.SE3(np.eye(3), vertices.mean(axis=0))]
    depth, is_bound = depth_of([_triangles(vertices[faces]), coal.Sphere(0.05)], places)
    assert is_bound
    assert depth > 0.05


def test_a_link_inside_a_closed_mesh_is_found_though_no_triangle_is_near(tmp_path):
    around = slab(tmp_path, [0.7, 1.2, 1.8], "around.stl") | {"center": [-0.15, 0.0, 0.0]}
    reasons = verdict_on(tmp_path, around).reasons
    assert any("torso begins inside obstacles[0] (mesh)" in reason for reason in reasons)


def test_a_notch_is_free_that_a_hull_would_fill(tmp_path):
    """Two walls with a floor between them, one mesh: the carry passes over the floor, inside the mesh's hull."""
    vertices, faces = _channel(0.7)
    write_stl(tmp_path / "channel.stl", vertices, faces)
    channel = {"shape": "mesh", "file": "channel.stl", "center": [0.68, 0.0, -0.2]}
    assert verdict_on(tmp_path, channel).verified is not None


@pytest.mark.parametrize(("center", "free"), [((0.0, 0.0, 1.6), True), ((0.7, 0.0, 0.3), False)])
def test_more_edges_may_meet_at_a_vertex_than_a_hull_can_have(tmp_path, center, free):
    """The tip of a cone of 400 triangles: coal's hulls have at most 255 neighbours of a vertex."""
    turn = np.linspace(0.0, 2.0 * np.pi, 401)[:-1]
    rim = 0.1 * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(400)])
    vertices = np.vstack([rim, [[0.0, 0.0, 0.3]], [[0.0, 0.0, 0.0]]])
    k = np.arange(400)
    sides = np.column_stack([k, (k + 1) % 400, np.full(400, 400)])
    floor = np.column_stack([(k + 1) % 400, k, np.full(400, 401)])
    write_stl(tmp_path / "cone.stl", vertices, np.vstack([sides, floor]))
    verdict = verdict_on(tmp_path, {"shape": "mesh", "file": "cone.stl", "center": list(center)})
    assert (verdict.verified is not None) == free


def _channel(length):
    """A channel along x: three boxes in one mesh, by their prisms."""
    parts, count, faces = [], 0, []
    for low, high in (((-1.0, 0.0), (1.0, 0.05)), ((-1.0, 0.05), (-0.95, 0.5)), ((0.95, 0.05), (1.0, 0.5))):
        (a, b), (c, d) = low, high
        corners, own = prism(np.array([[a, b], [c, b], [c, d], [a, d]]), 0, length)
        parts.append(corners[:, [2, 0, 1]] - [length / 2, 0.0, 0.0])
        faces.append(own + count)
        count += len(corners)
    return np.concatenate(parts), np.concatenate(faces)
