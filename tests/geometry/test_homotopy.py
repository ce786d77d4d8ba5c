"""Words of paths are invariant under what deforms paths, and tell apart what cannot be deformed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.geometry.homotopy import crossings, word_text

POSTS = np.array([[0.0, 0.0], [2.0, 0.5]])


def through(*points):
    """A path through points, finely sampled."""
    points = np.array(points, dtype=float)
    return np.concatenate([np.linspace(a, b, 57) for a, b in zip(points[:-1], points[1:], strict=True)])


@pytest.mark.parametrize(
    ("points", "word"),
    [
        ([(-1, 0.1), (3, 1.5)], "0+ 1+"),  # above both
        ([(-1, 0), (0, -1), (3, -1)], ""),  # below both
        ([(-1, 0), (0, 1), (2, -1), (3, 0)], "0+"),  # above the first, below the second
        ([(3, 1), (2, 1), (0, 1), (-1, 0)], "1- 0-"),  # back
        ([(-1, 0), (0, 1), (1, 0), (0, -1), (-1, 0), (0, 1), (1, 0)], "0+ 0+"),  # once round the first
        ([(-1, 0), (1, 1), (-1, 2), (-1, 0)], ""),  # there and back
    ],
)
def test_words_by_hand(points, word):
    assert word_text(crossings(through(*points), POSTS)) == word


@given(st.lists(st.tuples(st.floats(-3, 5), st.floats(-3, 3)), min_size=2, max_size=8))
def test_a_closed_path_winds_about_a_point_as_often_as_its_letters_say(points):
    """The winding number of a closed path, summed from angles, is minus the sum of the crossings."""
    path = through(*points, points[0])
    apart = path - POSTS[0]
    if np.linalg.norm(apart, axis=1).min() < 0.05 or np.abs(apart[:, 0]).min() < 1e-9:
        return
    angle = np.unwrap(np.arctan2(apart[:, 1], apart[:, 0]))
    if np.abs(np.diff(angle)).max() > 2.0:  # sampled too coarsely for angles
        return
    turns = round((angle[-1] - angle[0]) / (2 * np.pi))
    assert sum(direction for point, direction in crossings(path, POSTS) if point == 0) == -turns


@given(st.integers(0, 2**31))
def test_small_deformations_change_nothing(seed):
    rng = np.random.default_rng(seed)
    path = through((-1, 0), (0, 1), (1, 0.2), (2, -0.5), (3, 0))
    bump = np.sin(np.linspace(0, np.pi, len(path)))[:, None] * rng.uniform(-0.15, 0.15, 2)
    assert crossings(path + bump, POSTS) == crossings(path, POSTS)


def test_there_and_back_again_is_no_way():
    rng = np.random.default_rng(0)
    path = through(*rng.uniform(-3, 4, (9, 2)))
    assert crossings(np.concatenate([path, path[::-1]]), POSTS) == ()


def test_points_that_move():
    """A path at rest, and a point that passes below it: seen from the point, the path passes above."""
    still = np.zeros((101, 2))
    moving = np.linspace([1.0, -0.5], [-1.0, -0.5], 101)[:, None]
    assert crossings(still, moving) == ((0, 1),)
    assert crossings(still, moving + [0.0, 1.0]) == ()
