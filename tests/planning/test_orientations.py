"""Paths through the same places in other orientations are free, and shorter or other ones."""

from itertools import pairwise

import numpy as np
import pytest

import comove
from comove.model import load_coordinates
from comove.planning.configurations import configuration_space, edge_is_free, way_length
from comove.planning.orientations import can_turn, shortest_turned, turned_otherwise
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


def test_a_needless_turn_of_a_bar_is_undone():
    space, ends = space_of("window")
    start = ends[0]
    across = np.array([start[4], start[5], start[3]])
    across -= (across @ start[3:]) * start[3:]
    across /= np.linalg.norm(across)
    aside = np.zeros(6)
    aside[2] = 0.05
    turned = start * [1.0, 1.0, 1.0, -1.0, -1.0, -1.0]
    quarter = np.append(start[:3], across)
    path = np.stack([start, quarter, turned, turned + aside, quarter + aside, start + aside])
    assert is_free(space, path, 0.0)
    assert way_length(space, path) > 4 * way_length(space, shortest_turned(space, path, 0.0))


def test_a_bar_passes_a_window_the_other_way_round():
    space, _ = space_of("window")
    way = solved("window").attempt.at(np.linspace(0.0, 1.0, 201))[0]
    others = turned_otherwise(space, way, 0.0)
    assert others
    for other in others:
        nearest = [np.linalg.norm(way[:, :3] - q[:3], axis=1).argmin() for q in other]
        along = [way[k, 3:] @ q[3:] for k, q in zip(nearest, other, strict=True)]
        assert along[0] > 0 > min(along) and along[-1] > 0


def test_bodies_that_are_held_or_several_are_not_turned():
    assert not can_turn(space_of("narrow")[0])  # planar
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
