"""Spheres about clouds hold every point, and stick out no farther than asked where there may be enough of them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.geometry.sphere_cover import covered, thinned
from tests.cases import examples


def beyond(points, cover):
    """How far each point lies out of the nearest sphere [m]."""
    return (np.linalg.norm(points[:, None] - cover.center, axis=2) - cover.radius).min(axis=1)


def cover_of(points, group=None, detail=0.02, most=64):
    cells = thinned(points, 0.5 * detail)
    groups = np.zeros(len(cells.point), dtype=np.int64)
    if group is not None:
        groups[cells.of] = group
    return covered(points, cells, groups, detail, most)


def disc(n, radius=0.07, center=(0.5, 0.5)):
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    flat = np.array(center) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.concatenate([flat, np.zeros((n, 1))], axis=1)


@examples(60)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(1, 400),
    scale=st.sampled_from([1e-4, 0.03, 1.0, 30.0]),
    most=st.sampled_from([1, 7, 200]),
    flat=st.booleans(),
    doubled=st.booleans(),
)
def test_every_point_is_held_and_no_more_spheres_than_allowed(seed, n, scale, most, flat, doubled):
    rng = np.random.default_rng(seed)
    points = scale * rng.standard_normal((n, 3)) * [1.0, 0.3, 0.0 if flat else 0.5]
    points = np.concatenate([points, points[: n // 2]]) if doubled else points
    cover = cover_of(points, detail=0.1 * scale, most=most)
    assert beyond(points, cover).max() <= 1e-12 * scale
    assert 1 <= len(cover.radius) <= most


def test_spheres_hold_points_of_one_group_each():
    points = np.concatenate([disc(50), disc(50, center=(0.9, 0.5))])
    group = np.repeat([0, 1], 50)
    cells = thinned(points, 0.01)
    cover = covered(points, cells, group[np.unique(cells.of, return_index=True)[1]], 0.02, 64)
    for g in (0, 1):
        own = type(cover)(*(field[cover.group == g] for field in cover))
        assert beyond(points[group == g], own).max() <= 1e-12


def test_a_disc_and_a_ball_stay_one_sphere():
    cover = cover_of(disc(60))
    assert len(cover.radius) == 1
    assert cover.radius[0] == pytest.approx(0.07, abs=2e-3)
    np.testing.assert_allclose(cover.center[0], [0.5, 0.5, 0.0], atol=2e-3)
    ball = np.random.default_rng(0).standard_normal((2000, 3))
    cover = cover_of(0.08 * ball / np.linalg.norm(ball, axis=1, keepdims=True))
    assert len(cover.radius) == 1
    assert cover.radius[0] == pytest.approx(0.08, abs=4e-3)


@pytest.mark.parametrize("detail", [0.01, 0.02, 0.05])
def test_spheres_along_a_wall_stick_out_by_the_detail(detail):
    wall = np.stack([np.full(201, 0.3), np.linspace(0, 1, 201), np.zeros(201)], axis=1)
    cover = cover_of(wall, detail=detail, most=500)
    assert beyond(wall, cover).max() <= 0
    assert cover.radius.max() <= 1.5 * detail  # half a cell's points are as one
    assert np.abs(cover.center[:, 0] - 0.3).max() < 1e-9


def test_nothing_is_hidden_in_a_large_hollow_sphere():
    """A room's walls all around are no ball."""
    cover = cover_of(disc(2000, radius=0.45))
    assert cover.radius.max() < 0.2
    assert beyond(np.array([[0.5, 0.5, 0.0]]), cover)[0] > 0.3


def test_no_points_no_spheres():
    assert len(cover_of(np.zeros((0, 3))).radius) == 0
