"""A movement is adapted to the hands, also where its ends nearly coincide, and a load turns as it was taught."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import comove
from comove.dmp import DMP, PoseDMP, ProMP, Variant
from comove.dmp.demonstrations import Demonstration
from comove.dmp.operations import rotate
from comove.dmp.variants import APART, CLOSED
from comove.errors import ComoveWarning, OptionError
from comove.geometry.rotations import exponential, similarity
from comove.model.adaptation import (
    carried_to_hands,
    covariance_of_hands,
    hands_of_poses,
    magnification,
    modulate,
)
from tests.cases import examples
from tests.dmp.movements import random_dmp

T = np.linspace(0.0, 1.0, 201)
REST = T**3 * (10 - 15 * T + 6 * T**2)
SWING = 0.7  # rad, in the middle of the way


def recording(axis, n_dims=3):
    """Straight on, swinging about an axis and back."""
    position = np.zeros((len(T), n_dims))
    position[:, 0] = 0.8 * REST
    turn = SWING * np.sin(np.pi * REST) ** 2
    return Demonstration(
        10 * T, position, "swing", orientation=exponential(turn[:, None] * np.asarray(axis, float))
    )


def scene(n_dims=3, constraints=(), load=None, turned=0.0):
    """Two hands that carry something straight on, and turn it about the vertical."""
    c, s = 0.15 * np.cos(turned), 0.15 * np.sin(turned)
    ends = {
        "left": ([0.2, 0.15, 0.0], [1.0 - s, c, 0.0]),
        "right": ([0.2, -0.15, 0.0], [1.0 + s, -c, 0.0]),
    }
    return comove.Scene.from_dict(
        {
            "name": "open",
            "duration": 10.0,
            "workspace": {"lower": [-0.5, -1, -1][:n_dims], "upper": [2, 1, 1][:n_dims]},
            "load": load or {"shape": "bar", "length": 0.3},
            "constraints": list(constraints),
            "manipulators": [
                {"name": name, "start": start[:n_dims], "goal": goal[:n_dims]}
                for name, (start, goal) in ends.items()
            ],
        }
    )


def heading(hands):
    """Of the second hand to the first, seen from above [rad], from that at the start."""
    across = hands[:, 0, :2] - hands[:, 1, :2]
    angle = np.unwrap(np.arctan2(across[:, 1], across[:, 0]))
    return angle - angle[0]


@pytest.mark.parametrize("n_dims", [2, 3])
@pytest.mark.parametrize("turned", [0.0, 0.5])
def test_hands_turn_with_the_load_and_end_where_they_must(n_dims, turned):
    place = scene(n_dims, turned=turned)
    hands = carried_to_hands(hands_of_poses(PoseDMP.fit(recording([0, 0, 1], n_dims)), place), place)
    assert np.allclose(hands[0], place.start, atol=1e-9)
    assert np.allclose(hands[-1], place.goal, atol=1e-9)
    assert np.linalg.norm(hands[:, 0] - hands[:, 1], axis=1) == pytest.approx(0.3, abs=2e-3)
    led = turned * REST  # to the load's own end, about as evenly as the way is gone
    assert heading(hands) == pytest.approx(SWING * np.sin(np.pi * REST) ** 2 + led, abs=0.05)


@pytest.mark.parametrize("n_dims", [2, 3])
def test_a_motion_swings_as_it_was_taught(n_dims):
    place, taught = scene(n_dims), recording([0, 0, 1], n_dims)
    solution = comove.solve(place, demonstration=taught, objective=comove.LeastJerk(1.0))
    assert solution.verified
    assert heading(solution.attempt.hands(T)[0]).max() == pytest.approx(SWING, rel=0.05)
    assert solution.followed.distance < 5e-3
    straight = comove.solve(place, demonstration=DMP.fit(taught), objective=comove.LeastJerk(1.0))
    assert np.abs(heading(straight.attempt.hands(T)[0])).max() < 1e-3


def test_what_an_upright_load_cannot_do_is_left_out():
    tray = {
        "shape": "box",
        "size": [0.2, 0.2, 0.02],
        "grasps": {"left": [0, 0.15, 0], "right": [0, -0.15, 0]},
    }
    place = scene(constraints=[{"type": "upright"}], load=tray)
    both = np.array([1.0, 0.0, 1.0])  # a roll about the way, and a turn about the vertical
    hands = carried_to_hands(hands_of_poses(PoseDMP.fit(recording(both)), place), place)
    assert hands[..., 2] == pytest.approx(0.0, abs=1e-9)
    assert heading(hands).max() == pytest.approx(SWING, rel=0.1)


def test_the_axis_of_turning_goes_with_the_way():
    """Taught along x with a nose that rises; carried out along y, the nose still rises."""
    up = hands_of_poses(PoseDMP.fit(recording([0, -1, 0])), scene())
    assert (
        np.ptp(carried_to_hands(up, scene())[..., 2]) < 1e-6
    )  # the bar lies across: it rolls, and nothing shows
    data = {
        "name": "along y",
        "duration": 10.0,
        "workspace": {"lower": [-1, -1, -1], "upper": [1, 2, 1]},
        "load": {"shape": "bar", "length": 0.3},
        "manipulators": [
            {"name": "back", "start": [0, 0, 0], "goal": [0, 0.8, 0]},
            {"name": "front", "start": [0, 0.3, 0], "goal": [0, 1.1, 0]},
        ],
    }
    place = comove.Scene.from_dict(data)
    hands = carried_to_hands(hands_of_poses(PoseDMP.fit(recording([0, -1, 0])), place), place)
    rise = np.arcsin((hands[:, 1, 2] - hands[:, 0, 2]) / 0.3)
    assert rise.max() == pytest.approx(SWING, rel=0.05)
    assert np.abs(hands[..., 0]).max() < 1e-6


def test_poses_for_hands_that_are_free_are_refused():
    data = {
        "name": "free",
        "duration": 5.0,
        "workspace": {"lower": [-1, -1], "upper": [2, 2]},
        "manipulators": [
            {"name": "a", "start": [0, 0], "goal": [1, 0]},
            {"name": "b", "start": [0, 1], "goal": [1, 1]},
        ],
    }
    free = comove.Scene.from_dict(data)
    with pytest.raises(OptionError, match="held by all hands"):
        comove.solve(free, demonstration=PoseDMP.fit(recording([0, 0, 1], 2)))
    with pytest.raises(OptionError, match="3 dimensions, the scene 2"):
        comove.solve(scene(2), demonstration=PoseDMP.fit(recording([0, 0, 1])))
    assert comove.solve(free, demonstration=recording([0, 0, 1], 2)).verified  # of a recording, its positions


WAY = np.array([0.55, 0.4])  # from start to goal, of the adapted movements below
STEEPEST = 60  # m that a path moves for a metre of the gap, if displacement and extent are alike


def loop(gap, n_dims=2):
    """Out and back in the plane, or in space; its ends are `gap` apart, an array."""
    path = np.zeros((len(T), n_dims))
    path[:, 0], path[:, 1] = 0.14 * (1 - np.cos(2 * np.pi * REST)), 0.05 * np.sin(2 * np.pi * REST)
    return Demonstration(5 * T, path + np.outer(REST, gap), "loop")


def adapted(dmp, way):
    start = np.full(dmp.n_dims, 0.1)
    return modulate(dmp, start, start + way).at(T * dmp.duration).position


@examples(40)
@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]), st.sampled_from(list(Variant)[:4]))
def test_a_movement_with_ends_well_apart_is_similar_to_itself(seed, n_dims, variant):
    dmp = random_dmp(seed, variant, n_dims=n_dims, still=True)
    own, way = dmp.goal - dmp.start, np.random.default_rng(seed + 1).standard_normal(n_dims)
    if np.linalg.norm(own) < 1.01 * APART * dmp.extent:
        return
    path = dmp.at(T * dmp.duration).position
    wanted = 0.1 + (path - dmp.start) @ similarity(own, way).T
    assert np.abs(adapted(dmp, way) - wanted).max() < 1e-10 * max(1.0, np.abs(wanted).max())


@examples(60)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([2, 3]),
    st.sampled_from(list(Variant)[:4]),
    st.one_of(st.floats(0.0, 0.5), st.floats(0.0, 1e-6)),
)
def test_both_ends_are_met_and_the_size_is_bounded(seed, n_dims, variant, gap):
    rng = np.random.default_rng(seed)
    dmp = random_dmp(seed, variant, n_dims=n_dims, still=True)
    away = gap * rng.standard_normal(n_dims)
    dmp = replace(dmp, goal=dmp.start + away, learned=away)
    way = rng.standard_normal(n_dims)
    path = adapted(dmp, way)
    reach = max(dmp.extent, np.linalg.norm(way) / APART)
    assert np.abs(path[0] - 0.1).max() < 1e-12
    assert np.abs(path[-1] - 0.1 - way).max() < 1e-11 * max(1.0, reach)
    assert np.linalg.norm(path - path[0], axis=1).max() < 1.5 * reach + np.linalg.norm(way)


@examples(30)
@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]), st.floats(0.0, 0.5))
def test_adapting_commutes_with_turning_the_world(seed, n_dims, gap):
    rng = np.random.default_rng(seed)
    dmp = random_dmp(seed, n_dims=n_dims, still=True)
    dmp = replace(dmp, goal=dmp.start + gap * rng.standard_normal(n_dims))
    start, way = rng.standard_normal((2, n_dims))
    turn = Rotation.random(random_state=rng).as_matrix()
    if n_dims == 2:
        turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    plain = modulate(dmp, start, start + way)
    turned = modulate(rotate(dmp, turn), turn @ start, turn @ (start + way))
    size = max(dmp.extent, 5 * np.linalg.norm(way))
    missed = turned.at(T * dmp.duration).position - plain.at(T * dmp.duration).position @ turn.T
    assert np.abs(missed).max() < 1e-8 * size


@pytest.mark.parametrize("n_dims", [2, 3])
def test_the_adapted_movement_changes_with_the_gap_as_little_as_the_gap(n_dims):
    """Through zero, and in all directions of the plane: the direction of a tiny gap is noise."""
    way = np.array([*WAY, 0.2])[:n_dims]
    closed = DMP.fit(loop(np.zeros(n_dims), n_dims))
    for angle in np.linspace(0.0, np.pi, 5):
        gaps = np.outer(np.linspace(-0.08, 0.08, 161), [np.cos(angle), np.sin(angle), 0.0][:n_dims])
        paths = [adapted(replace(closed, goal=closed.start + gap), way) for gap in gaps]
        if n_dims == 3 and ((gaps / 0.08) @ way / np.linalg.norm(way)).min() < -0.95:
            continue  # opposite directions, where the axis is not determined
        steepest = STEEPEST * np.linalg.norm(way) / closed.extent
        assert np.linalg.norm(np.diff(paths, axis=0), axis=2).max() < 0.001 * steepest
    exact = adapted(closed, way)
    noise = 1e-3 * np.random.default_rng(0).standard_normal((20, n_dims))
    for gap in noise:
        moved = np.abs(adapted(replace(closed, goal=closed.start + gap), way) - exact).max()
        assert moved < 0.01  # the line between the ends, and nothing turns


@pytest.mark.parametrize("gap", [0.0, 1e-9, 1e-3, 0.03, 0.2])
def test_covariances_turn_and_scale_with_the_movement(gap):
    rng = np.random.default_rng(3)
    recordings = []
    for _ in range(6):
        bend = 0.02 * rng.standard_normal() * np.sin(np.pi * REST) ** 2
        position = loop(np.array([gap, 0.0])).position + np.outer(bend, [1.0, 2.0])
        recordings.append(Demonstration(5 * T, position + 0.002 * np.outer(REST, rng.standard_normal(2))))
    promp, place = ProMP.fit(recordings), scene(2)
    covariance = covariance_of_hands(promp, place, T[::10])
    assert np.abs(covariance - np.swapaxes(covariance, 1, 2)).max() < 1e-12
    assert np.linalg.eigvalsh(covariance).min() > -1e-12
    mean, far = promp.mean, np.linalg.norm(place.goal - place.start, axis=1).max()
    between = promp.towards(start=mean.start, goal=mean.goal).covariance_at(T[::10] * promp.duration)
    most = max(1.0, far / (APART * mean.extent)) ** 2 * 1.5
    assert np.trace(covariance, axis1=1, axis2=2).max() < most * 2 * np.trace(between, axis1=1, axis2=2).max()
    if np.linalg.norm(mean.goal - mean.start) < CLOSED * mean.extent:
        assert np.array_equal(covariance[:, :2, :2], between)


@pytest.mark.parametrize("size", [0.0, 1e-6, 1e-3])
def test_the_axis_of_turning_does_not_flip_with_a_tiny_gap(size):
    """A load is moved out and back while its nose rises; where exactly it comes back to is noise."""
    rise = exponential(np.outer(SWING * np.sin(np.pi * REST) ** 2, [0.0, 1.0, 0.0]))
    place, found = scene(), []
    for gap in size * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 0, -1.0]]):
        shown = Demonstration(10 * T, loop(gap, 3).position, "nod", orientation=rise)
        found.append(carried_to_hands(hands_of_poses(PoseDMP.fit(shown), place), place))
        assert np.abs(found[-1][[0, -1]] - [place.start, place.goal]).max() < 1e-9
    assert np.abs(np.diff(found, axis=0)).max() < 0.01


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4])
def test_the_axis_of_turning_does_not_flip_where_the_load_stays(size):
    """The scene's start and goal nearly coincide: the direction between them is noise."""
    found, up = [], recording([0, -1, 0])
    for x, y in ((1, 0), (0, 1), (-1, 0)):
        hands = {"back": [-0.15, 0.0, 0.0], "front": [0.15, 0.0, 0.0]}
        place = comove.Scene.from_dict(
            {
                "name": "on the spot",
                "duration": 10.0,
                "workspace": {"lower": [-1, -1, -1], "upper": [1, 1, 1]},
                "load": {"shape": "bar", "length": 0.3},
                "manipulators": [
                    {"name": name, "start": at, "goal": [at[0] + size * x, at[1] + size * y, 0.0]}
                    for name, at in hands.items()
                ],
            }
        )
        found.append(carried_to_hands(hands_of_poses(PoseDMP.fit(up), place), place))
    assert np.abs(np.diff(found, axis=0)).max() < 0.01
    assert np.arcsin(np.ptp(found[0][:, 1, 2] - found[0][:, 0, 2]) / 0.3) == pytest.approx(SWING, rel=0.05)


def test_poses_of_the_classic_form_are_not_blown_up():
    swing = np.outer(SWING * np.sin(np.pi * REST) ** 2, [0, 0, 1.0]) + np.outer(1e-6 * REST, [0, 0, 1.0])
    shown = Demonstration(10 * T, recording([0, 0, 1]).position, "swing", orientation=exponential(swing))
    place = scene(turned=0.5)
    dmp = PoseDMP.fit(shown, variant="classic", axis=(0, 0, 1))
    hands = carried_to_hands(hands_of_poses(dmp, place), place)
    assert heading(hands) == pytest.approx(SWING * np.sin(np.pi * REST) ** 2 + 0.5 * REST, abs=0.05)


def test_a_magnified_path_of_poses_is_told():
    shown = replace(recording([0, 0, 1]), position=0.2 * recording([0, 0, 1]).position)
    with pytest.warns(ComoveWarning, match="magnified 5 times for the load, from 0.16 m to 0.8 m"):
        hands_of_poses(PoseDMP.fit(shown), scene())
    factor, said = magnification(DMP.fit(shown), np.zeros(3), np.array([0.4, 0, 0]), "it")
    assert factor == pytest.approx(2.5) and not said


def test_hands_follow_poses_of_many_weights():
    """A load that is shaken ten times on its way: none of it is lost on the way to the hands."""
    t = np.linspace(0.0, 1.0, 2001)
    rest = t**3 * (10 - 15 * t + 6 * t**2)
    shake = np.sin(20 * np.pi * rest)
    path = np.outer(rest, [0.8, 0, 0]) + np.outer(0.05 * shake, [0, 1.0, 0])
    shown = Demonstration(20 * t, path, orientation=exponential(np.outer(0.3 * shake, [0, 0, 1.0])))
    hands = hands_of_poses(PoseDMP.fit(shown, n_basis=80), scene())
    found = heading(carried_to_hands(hands, scene()))
    assert found == pytest.approx(0.3 * np.sin(20 * np.pi * REST), abs=0.02)
