"""Movements whose ends nearly coincide are adapted to other ends without a jump, and within bounds."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.dmp import DMP, Library, Pose, PoseDMP, learn
from comove.dmp.demonstrations import Demonstration
from comove.dmp.variants import APART, CLOSED, adaptation, extent_of
from comove.errors import ComoveWarning
from comove.geometry.rotations import similarity, turn_between
from tests.cases import examples
from tests.dmp.movements import random_dmp

seeds = st.integers(0, 2**32 - 1)
S = np.linspace(0.0, 1.0, 201)
REST = S**3 * (10 - 15 * S + 6 * S**2)
GROWTH = 6 / 5  # of a shape, beyond the larger of its own size and 1 / APART displacements
STEEPEST = 60  # m that a path moves for a metre of the gap, if gap, displacement and extent are alike


def loop(gap, n_dims=2):
    """Out and back, with ends that are `gap` apart, an array or a number of metres along x."""
    away = np.zeros(n_dims)
    away[: np.size(gap)] = gap
    path = np.zeros((len(S), n_dims))
    path[:, 0], path[:, 1] = 0.14 * (1 - np.cos(2 * np.pi * REST)), 0.05 * np.sin(2 * np.pi * REST)
    return Demonstration(5 * S, path + np.outer(REST, away), "loop")


def unit(rng, n_dims):
    vector = rng.standard_normal(n_dims)
    return vector / np.linalg.norm(vector)


@examples(50)
@given(seeds, st.integers(1, 5), st.floats(0.0, 1.0))
def test_near_ends_shift_and_ends_well_apart_scale_and_turn(seed, n_dims, share):
    rng = np.random.default_rng(seed)
    extent, direction, wanted = rng.uniform(0.01, 100), unit(rng, n_dims), rng.standard_normal(n_dims)
    near, apart = CLOSED * share * extent, (APART + (1 - APART) * share) * extent * (1 + 1e-12)
    assert np.array_equal(adaptation(near * direction, wanted, extent), np.eye(n_dims))
    learned = apart * direction
    assert np.array_equal(adaptation(learned, wanted, extent), similarity(learned, wanted))


@examples(100)
@given(seeds, st.sampled_from([2, 3]), st.floats(0.0, 1.0), st.floats(0.0, 30.0))
def test_the_matrix_is_bounded_and_turns_with_the_world(seed, n_dims, share, far):
    rng = np.random.default_rng(seed)
    learned, wanted = share * unit(rng, n_dims), far * unit(rng, n_dims)
    matrix = adaptation(learned, wanted, 1.0)
    assert np.linalg.norm(matrix, 2) <= GROWTH * max(1.0, far / APART)
    turn = Rotation.random(random_state=rng).as_matrix()
    if n_dims == 2:
        turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    turned = adaptation(turn @ learned, turn @ wanted, 1.0)
    assert np.abs(turned - turn @ matrix @ turn.T).max() < 1e-9 * max(1.0, far / APART)


@examples(60)
@given(seeds, st.floats(0.0, 2 * np.pi), st.floats(0.0, 0.4), st.floats(0.0, 2 * np.pi))
def test_the_matrix_is_continuous_in_the_gap_whatever_its_direction(seed, angle, length, direction):
    """In the plane: through zero, round it, and past the direction opposite to the wanted one."""
    wanted = np.array([np.cos(angle), np.sin(angle)])
    gap = length * np.array([np.cos(direction), np.sin(direction)])
    step = 1e-7 * unit(np.random.default_rng(seed), 2)
    moved = adaptation(gap + step, wanted, 1.0) - adaptation(gap, wanted, 1.0)
    assert np.linalg.norm(moved, 2) <= STEEPEST * 1e-7


def test_the_matrix_is_continuous_in_the_gap_in_space():
    wanted, rng = np.array([0.3, -0.5, 0.8]), np.random.default_rng(0)
    for _ in range(20):
        direction = unit(rng, 3)
        if direction @ wanted < -0.8:  # at the opposite direction the axis is not determined
            continue
        gaps = np.outer(np.linspace(0.0, 0.4, 2001), direction)
        matrices = np.stack([adaptation(gap, wanted, 1.0) for gap in gaps])
        assert np.linalg.norm(np.diff(matrices, axis=0), 2, axis=(1, 2)).max() < STEEPEST * 0.4 / 2000


@pytest.mark.parametrize("variant", ["closed-form", "pastor", "dmp++"])
@pytest.mark.parametrize("gap", [0.0, 1e-12, 1e-6, 1e-3, 0.02, 0.05, 0.1])
def test_a_moved_goal_blows_no_variant_up(variant, gap):
    dmp = DMP.fit(loop(gap), variant=variant)
    assert np.abs(dmp.rollout(n_steps=201).position - loop(gap).position).max() < 5e-3
    for goal in ([gap + 0.05, 0.0], [gap, 0.05], [0.3, -0.4]):
        path = dmp.rollout(goal=goal).position
        assert extent_of(path[::4]) < 1.3 * max(dmp.extent, np.linalg.norm(goal) / APART)
        assert np.abs(path[[0, -1]] - [dmp.start, goal]).max() < 1e-9


@pytest.mark.parametrize("variant", ["closed-form", "pastor", "dmp++"])
def test_a_rollout_changes_with_the_gap_as_little_as_the_gap(variant):
    gaps, goal = np.linspace(-0.1, 0.1, 401), np.array([0.25, 0.1])
    dmp = DMP.fit(loop(0.0), variant=variant)
    paths = []
    for gap in gaps:
        away = np.array([gap, 0.0])
        own = replace(dmp, goal=dmp.start + away, learned=away)
        paths.append(own.rollout(goal=dmp.start + goal).position)
    assert np.abs(np.diff(paths, axis=0)).max() < STEEPEST * (gaps[1] - gaps[0])


def test_the_classic_form_is_the_published_one_and_says_what_holds():
    dmp = DMP.fit(loop(1e-6), variant="classic")
    with pytest.warns(ComoveWarning, match=r"5e\+04 in dimension 0.*variant = 'closed-form'") as told:
        path = dmp.rollout(goal=[0.05, 0.0])
    assert len(told) == 1
    shape = dmp.rollout().position - np.outer(REST, [1e-6, 0.0])
    assert np.ptp(path.position[:, 0]) == pytest.approx(np.ptp(shape[:, 0]) * 5e4, rel=0.01)
    with warnings.catch_warnings():
        warnings.simplefilter("error", ComoveWarning)
        held = DMP.fit(loop(1e-6), variant="closed-form").rollout(goal=[0.05, 0.0])
        dmp.rollout()  # between its own ends it is what was recorded
        apart = DMP.fit(Demonstration(5 * S, np.outer(REST, [1.0, 0.5])), variant="classic")
        apart.rollout(goal=[9.0, 9.0])  # asked for, and no blow-up
    assert np.ptp(held.position, axis=0).max() < 0.4


@examples(20)
@given(seeds, st.sampled_from([1, 2, 3]))
def test_the_extent_turns_and_shifts_with_the_movement(seed, n_dims):
    dmp = random_dmp(seed, n_dims=n_dims)
    path = dmp.at(np.linspace(0, dmp.duration, 51)).position
    assert dmp.extent == max(np.linalg.norm(path - point, axis=1).max() for point in path)
    assert replace(dmp, start=dmp.start + 1, goal=dmp.goal + 1).extent == pytest.approx(dmp.extent)


@pytest.mark.parametrize("gap", [0.0, 1e-9, 1e-3, 0.02, 0.1])
def test_a_turn_that_comes_back_is_not_blown_up(gap):
    """A hand swings by 0.7 rad and back, up to `gap` rad; then it ends half a radian away about another axis."""
    vectors = np.outer(0.7 * np.sin(np.pi * REST) ** 2, [0, 1, 0]) + np.outer(gap * REST, [1, 0, 0])
    turns = Rotation.from_rotvec(vectors).as_quat(scalar_first=True)
    shown = Demonstration(5 * S, np.outer(REST, [0.8, 0.0, 0.0]), orientation=turns)
    dmp = PoseDMP.fit(shown, variant="dmp++")
    goal = Pose([0.8, 0, 0], Rotation.from_rotvec([0, 0, 0.5]).as_quat(scalar_first=True))
    played = dmp.rollout(goal=goal)
    turned = np.linalg.norm([turn_between(q, played.orientation[0]) for q in played.orientation], axis=1)
    assert turned.max() < GROWTH * max(0.7, 0.5 / APART) + 0.5
    if gap < CLOSED * 0.7:
        assert turned.max() < 1.0
    assert np.linalg.norm(turn_between(played.orientation[-1], goal.orientation)) < 1e-9


def test_a_library_is_ranked_alike_where_the_wanted_ends_nearly_coincide(tmp_path):
    library, kept = Library(tmp_path), []
    for name, gap in (("near", 0.0), ("far", 0.3)):
        library.add(learn(loop(gap), name=name))
    for gap in (0.0, 1e-12, 1e-9, 1e-6):
        matches = library.find(start=[0.01, 0.0], goal=[0.01 + gap, 0.0], shape=loop(0.3))
        kept.append([(match.name, match.distance) for match in matches])
    for other in kept[1:]:
        for (name, distance), (first, least) in zip(other, kept[0], strict=True):
            assert name == first and distance == pytest.approx(least, rel=1e-4)
