"""Rods among obstacles that move and turn, and among each other, against placed obstacles and sampled points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from comove.contacts.displaced import instant_at
from comove.contacts.rods import near_enough, nearest_shares, rod_distance, rods_distance
from comove.geometry.distances import CENTER, segment_distance
from tests.cases import examples
from tests.planning.test_timing import DURATION, scene_of

POINT = arrays(float, 3, elements=st.one_of(st.integers(-2, 2).map(float), st.floats(-2, 2)))
TOLERANCE = 1e-7  # m


@given(POINT, POINT, POINT, POINT)
def test_segments_are_as_far_apart_as_their_nearest_points(a, b, c, d):
    s, t, apart = nearest_shares(a, b, c, d)
    assert apart == pytest.approx(np.linalg.norm(a + s * (b - a) - c - t * (d - c)), abs=1e-12)
    u = np.linspace(0, 1, 41)
    p, q = a + u[:, None] * (b - a), c + u[:, None] * (d - c)
    grid = np.linalg.norm(p[:, None] - q[None], axis=2).min()
    step = (np.linalg.norm(b - a) + np.linalg.norm(d - c)) / 80
    assert grid - step - 1e-9 <= apart <= grid + 1e-7
    assert nearest_shares(c, d, a, b)[2] == pytest.approx(apart, abs=1e-7)
    assert near_enough(a, b, c, d, apart + 1e-6)
    for cutoff in (apart + 1e-6, 0.5 * apart, -1.0):
        found = rods_distance(a, b, c, d, cutoff)
        assert found == apart or (found == np.inf and apart >= cutoff - 1e-9)


@examples(30)
@given(st.integers(0, 2**32 - 1), st.integers(0, 40))
def test_rods_are_as_far_from_displaced_obstacles_as_from_placed_ones(seed, sample):
    scene, rng = scene_of(seed), np.random.default_rng(seed)
    moved = scene.displacements(np.linspace(0.0, DURATION, 41))
    placed, instant = scene.obstacles_at(sample / 40 * DURATION), instant_at(moved, sample / 40)
    for row, body in enumerate(placed):
        p, q = body[CENTER : CENTER + 3] + rng.uniform(-0.25, 0.25, (2, 3))
        wanted = segment_distance(placed, row, *p, *q, np.inf, TOLERANCE)
        for cutoff in (np.inf, wanted + 0.01, wanted - 0.01):
            found = rod_distance(scene.obstacles, moved, row, instant, p, q, cutoff, TOLERANCE)
            if wanted <= cutoff:
                assert found == pytest.approx(wanted, abs=2 * TOLERANCE)
            else:
                assert found > cutoff - TOLERANCE
