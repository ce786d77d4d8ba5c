"""What is drawn is where the scene says: every vertex on its obstacle, every piece on its nodes."""

import numpy as np
import pytest

import comove
from comove.geometry import distances as sd
from comove.geometry.rotations import matrices
from comove.lab.examples import example
from comove.view.workbench.geometry import (
    clearance_colours,
    obstacle_surfaces,
    pieces_of,
    rod,
    segments_of,
    workspace_lines,
)
from comove.view.workbench.playback import RecordedMotion

SHAPES = [
    {"shape": "box", "size": [0.1, 0.2, 0.3]},
    {"shape": "sphere", "radius": 0.1},
    {"shape": "capsule", "radius": 0.05, "length": 0.2},
    {"shape": "cylinder", "radius": 0.05, "height": 0.2},
    {"shape": "ellipsoid", "radii": [0.05, 0.1, 0.15]},
]


def spatial_scene(obstacle, **further):
    turned = {} if obstacle["shape"] == "sphere" else {"quaternion_wxyz": [0.8, 0.0, 0.6, 0.0]}
    return comove.Scene.from_dict(
        {
            "name": "one",
            "duration": 2.0,
            "workspace": {"lower": [0, 0, 0], "upper": [1, 1, 1]},
            "obstacles": [{"center": [0.5, 0.5, 0.5], **turned, **obstacle}],
            "load": {"shape": "bar", "length": 0.2},
            "manipulators": [
                {"name": "a", "start": [0.1, 0.1, 0.1], "goal": [0.9, 0.7, 0.9]},
                {"name": "b", "start": [0.1, 0.3, 0.1], "goal": [0.9, 0.9, 0.9]},
            ],
        }
        | further
    )


def box_scene():
    grasps = {"a": [0.0, -0.1, 0.0], "b": [0.0, 0.1, 0.0]}
    load = {"shape": "box", "size": [0.05, 0.3, 0.05], "grasps": grasps}
    return spatial_scene(SHAPES[1], load=load, constraints=[{"type": "upright"}])


def straight(scene):
    from comove.model.motion import CoordinatedMotion

    return CoordinatedMotion.straight(scene)


@pytest.mark.parametrize("obstacle", SHAPES, ids=lambda shape: shape["shape"])
def test_every_vertex_lies_on_its_obstacle(obstacle):
    scene = spatial_scene(obstacle)
    (surface,) = obstacle_surfaces(scene)
    for vertex in surface.vertices[::7] + scene.centers[0]:
        assert abs(sd.point_distance(scene.obstacles, 0, *vertex)) < 1e-9


@pytest.mark.parametrize("obstacle", SHAPES, ids=lambda shape: shape["shape"])
def test_faces_look_outwards(obstacle):
    """The divergence theorem: triangles seen from outside counter-clockwise enclose a positive volume."""
    (surface,) = obstacle_surfaces(spatial_scene(obstacle))
    a, b, c = surface.vertices[surface.faces].swapaxes(0, 1)
    volumes = np.einsum("ni,ni->n", a, np.cross(b, c))
    assert (volumes > -1e-12).all()
    assert volumes.sum() / 6 > 1e-4


@pytest.mark.parametrize("name", ["narrow", "triangle", "box"])
def test_pieces_follow_their_nodes(name):
    scene = box_scene() if name == "box" else example(name)
    recording = RecordedMotion.of(straight(scene))
    pieces = pieces_of(scene, recording.nodes)
    hands = [piece for piece in pieces if piece.name.startswith("hand")]
    for hand, piece in enumerate(hands):
        np.testing.assert_allclose(piece.position[:, :2], recording.nodes[:, hand, :2])
    assert len(pieces) > len(hands)
    for piece in pieces:
        assert np.linalg.norm(piece.quaternion, axis=1) == pytest.approx(1.0)
        if piece.name.startswith("solid"):
            turned = np.einsum("tij,nj->tni", matrices(piece.quaternion), piece.surface.vertices)
            placed = turned + piece.position[:, None]
            corners = recording.nodes[:, scene.body.solids[0]]
            apart = np.linalg.norm(placed[:, :, None] - corners[:, None], axis=3).min(axis=2)
            assert apart.max() < 1e-9


def test_a_rod_reaches_from_hand_to_hand():
    scene = example("narrow")
    recording = RecordedMotion.of(comove.solve(scene, seed=0, budget=5.0).attempt)
    (piece,) = [p for p in pieces_of(scene, recording.nodes) if p.name == "rod_0"]
    half = 0.1 * matrices(piece.quaternion)[:, :, 2]
    np.testing.assert_allclose((piece.position + half)[:, :2], recording.nodes[:, 1, :2], atol=1e-9)
    np.testing.assert_allclose((piece.position - half)[:, :2], recording.nodes[:, 0, :2], atol=1e-9)
    ends = rod(0.2, 0.01).vertices[:, 2]
    assert (ends.min(), ends.max()) == pytest.approx((-0.11, 0.11))


def test_a_recording_agrees_with_the_certificate():
    solution = comove.solve(example("narrow"), seed=0, budget=5.0)
    recording = RecordedMotion.of(solution.attempt)
    assert recording.clearance.min() >= solution.report.clearance_min
    at = recording.index_at(float(recording.tightest[0]))
    assert recording.clearance[at] < solution.report.clearance_min + 0.005
    assert recording.speed.max() <= solution.report.speed_max
    assert recording.acceleration.max() <= solution.report.acceleration_max
    assert (recording.error <= 1.0).all(), "no constraint uses more than its tolerance"


def test_colours_tell_contact_from_room():
    red, green = clearance_colours(np.array([-0.01, 0.2]), 0.05).astype(int)
    assert red[0] > 2 * red[1]
    assert green[1] > 2 * green[0]


def test_lines():
    assert len(workspace_lines(example("narrow"))) == 4
    assert len(workspace_lines(example("window"))) == 12
    path = np.arange(12.0).reshape(4, 3)
    assert np.array_equal(segments_of(path)[:, 1], path[1:])
