"""Paths through the same places in other orientations are free, and shorter or other ones."""

from itertools import pairwise

import numpy as np
import pytest

import comove
from comove.model import load_coordinates
from comove.planning.configurations import configuration_space, edge_is_free, way_length
from comove.planning.orientations import can_turn, principal_axes, shortest_turned, turned_otherwise
from comove.planning.planner import plan
from tests.solved import scene_of, solved

SPATIAL = ["window", "triangle", "bar 1", "triangle 2"]


def space_of(name):
    scene = scene_of(name)
    coordinates = load_coordinates(scene)
    return configuration_space(scene, coordinates), coordinates.boundary()


def is_free(space, path, margin):
    scratch, nodes = np.empty(path.shape[1]), np.empty((space.blocks.node.shape[0], 3))
    return all(edge_is_free(space, p, q, margin, scratch, nodes) for p, q in pairwise(path))


@pytest.mark.parametrize("name", SPATIAL)
def test_turned_paths_join_the_same_ends_without_contact(name):
    space, ends = space_of(name)
    path = plan(space, ends[0], ends[2], 0.002, np.random.default_rng(0), max_nodes=4000)
    way = solved(name).attempt.at(np.linspace(0.0, 1.0, 201))[0]
    shortest, others = shortest_turned(space, path, 1e-3), turned_otherwise(space, way, 0.0)
    for turned, margin in ((shortest, 1e-3), *((other, 0.0) for other in others)):
        np.testing.assert_allclose(turned[[0, -1], :3], path[[0, -1], :3], atol=1e-12)
        assert is_free(space, turned, margin)


@pytest.mark.parametrize("name", SPATIAL)
def test_the_shortest_of_turned_paths_is_no_longer(name):
    space, ends = space_of(name)
    for seed in range(4):
        path = plan(space, ends[0], ends[2], 0.002, np.random.default_rng(seed), max_nodes=4000)
        assert way_length(space, shortest_turned(space, path, 1e-3)) < way_length(space, path) + 1e-9


def test_a_bar_is_not_turned_round_where_it_need_not_be():
    """A path that turns a bar round, carries it far, and turns it back."""
    scene = comove.Scene.from_dict(
        {
            "name": "hall",
            "duration": 5.0,
            "workspace": {"lower": [0, 0, 0], "upper": [4, 1, 1]},
            "load": {"shape": "bar", "length": 0.2},
            "manipulators": [
                {"name": "a", "start": [0.5, 0.4, 0.5], "goal": [3.5, 0.4, 0.5]},
                {"name": "b", "start": [0.5, 0.6, 0.5], "goal": [3.5, 0.6, 0.5]},
            ],
        }
    )
    coordinates = load_coordinates(scene)
    space, (start, _, goal, _) = configuration_space(scene, coordinates), coordinates.boundary()
    along, back = np.append(start[:3], [1.0, 0.0, 0.0]), np.append(start[:3], -start[3:])
    far = np.append(goal[:3] - start[:3], [0.0, 0.0, 0.0])
    path = np.stack([start, along, back, back + far, along + far, goal])
    shortest = shortest_turned(space, path, 0.0)
    np.testing.assert_array_equal(shortest[[0, -1]], path[[0, -1]])
    assert way_length(space, path) > 3.6
    assert way_length(space, shortest) < 3.1  # 3 m of translation


def test_a_bar_passes_a_window_the_other_way_round():
    space, _ = space_of("window")
    way = solved("window").attempt.at(np.linspace(0.0, 1.0, 201))[0]
    others = turned_otherwise(space, way, 0.0)
    assert others
    for other in others:
        nearest = [np.linalg.norm(way[:, :3] - q[:3], axis=1).argmin() for q in other]
        along = [way[k, 3:] @ q[3:] for k, q in zip(nearest, other, strict=True)]
        assert along[0] > 0 > min(along) and along[-1] > 0


def test_several_bodies_are_not_turned():
    assert can_turn(space_of("narrow")[0])
    scene = comove.Scene.from_dict(
        {
            "name": "two",
            "duration": 5.0,
            "workspace": {"lower": [0, 0, 0], "upper": [1, 1, 1]},
            "manipulators": [
                {"name": "a", "start": [0.2, 0.2, 0.2], "goal": [0.8, 0.2, 0.2]},
                {"name": "b", "start": [0.2, 0.6, 0.2], "goal": [0.8, 0.6, 0.2]},
            ],
        }
    )
    assert not can_turn(configuration_space(scene, load_coordinates(scene)))


def test_axes_of_equal_moments_are_those_of_the_frame():
    """Whatever the last bits of a square's corners, which differ from machine to machine."""
    square = np.array([[1, 1, 0], [1, -1, 0], [-1, -1, 0], [-1, 1, 0]]) * 0.2
    rng = np.random.default_rng(5)
    for _ in range(20):
        axes = principal_axes(square + rng.uniform(-1e-15, 1e-15, square.shape))
        assert (np.sort(np.abs(axes), axis=1) == [0, 0, 1]).all()
