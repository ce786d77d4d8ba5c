"""Rotation vectors against scipy, and their continuity through whole turns."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.geometry import rotations
from tests.cases import examples

seeds = st.integers(0, 2**32 - 1)


def wandering(rng, n_steps=400, most=5.5):
    """Rotation vectors of a movement that stays within a whole turn of its end, which is no turn."""
    s = np.linspace(0, 1, n_steps)
    vectors = np.stack([np.sin(np.outer(s, [1, 2, 3]) * 3) @ rng.uniform(-1, 1, 3) for _ in range(3)], axis=1)
    vectors *= (1 - s)[:, None]
    return vectors * most / np.linalg.norm(vectors, axis=1).max()


@examples(40)
@given(seeds)
def test_products_matrices_and_exponentials_are_those_of_scipy(seed):
    rng = np.random.default_rng(seed)
    vectors = rng.standard_normal((2, 5, 3)) * rng.choice([1e-9, 1e-3, 1, 5], (2, 5, 1))
    a, b = (Rotation.from_rotvec(v) for v in vectors)
    qa, qb = (rotations.exponential(v) for v in vectors)
    product = rotations.matrices(rotations.quaternion_product(qa, rotations.conjugate(qb)))
    assert np.abs(product - (a * b.inv()).as_matrix()).max() < 1e-12


@examples(40)
@given(seeds, st.floats(0.1, 6.2))
def test_the_logarithm_is_continuous_whatever_the_signs(seed, most):
    rng = np.random.default_rng(seed)
    vectors = wandering(rng, most=most)
    quaternions = rotations.exponential(vectors) * rng.choice([-1, 1], (len(vectors), 1))
    assert np.abs(rotations.continuous_logarithm(quaternions) - vectors).max() < 1e-9


@examples(40)
@given(seeds, st.floats(-9.0, 9.0))
@example(0, 1e-180)
@example(0, 1e-13)
def test_whole_turns_about_a_fixed_axis(seed, turns):
    rng = np.random.default_rng(seed)
    axis = rng.standard_normal(3)
    vectors = np.outer(2 * np.pi * turns * (1 - np.linspace(0, 1, 1001)), axis / np.linalg.norm(axis))
    quaternions = Rotation.from_rotvec(vectors).as_quat(scalar_first=True) * rng.choice([-1, 1], (1001, 1))
    assert np.abs(rotations.continuous_logarithm(quaternions) - vectors).max() < 1e-9


@examples(40)
@given(seeds)
def test_the_turn_between_orientations_leads_from_one_to_the_other(seed):
    a, b = (rotations.exponential(v) for v in np.random.default_rng(seed).standard_normal((2, 3)))
    turn = rotations.turn_between(a, b)
    assert np.linalg.norm(turn) <= np.pi + 1e-12
    led = rotations.quaternion_product(rotations.exponential(turn), b)
    assert abs(led @ a) == pytest.approx(1.0, abs=1e-12)
    longer = rotations.turn_between(a, b, 2 * np.pi * turn / np.linalg.norm(turn) + turn)
    assert np.linalg.norm(longer) == pytest.approx(np.linalg.norm(turn) + 2 * np.pi, rel=1e-12)


def test_standing_still_is_no_turn():
    assert not rotations.continuous_logarithm(np.tile([-1.0, 0, 0, 0], (5, 1))).any()


@examples(40)
@given(seeds)
def test_the_nearest_logarithm(seed):
    """It is the same orientation, and no other vector of it is nearer."""
    rng = np.random.default_rng(seed)
    near = rng.standard_normal(3) * rng.choice([0, 1e-6, 1, 10])
    quaternion = rotations.exponential(rng.standard_normal(3) * rng.choice([1e-3, 1, 4]))
    vector = rotations.logarithm(quaternion, near)
    assert np.abs(np.abs(rotations.exponential(vector) @ quaternion) - 1).max() < 1e-12
    axis = vector / np.linalg.norm(vector)
    for k in (-2, -1, 1, 2):
        assert np.linalg.norm(vector + 2 * np.pi * k * axis - near) >= np.linalg.norm(vector - near) - 1e-9


@pytest.mark.parametrize("size", [0.0, 1e-7, 1e-4, 0.3, 3.0, 8.0])
def test_angular_velocities_against_differences(size):
    rng, h = np.random.default_rng(3), 1e-6
    vector, rate = size * np.array([0.6, -0.48, 0.64]), rng.standard_normal(3)
    ahead, behind = (Rotation.from_rotvec(vector + side * h * rate) for side in (1, -1))
    expected = (ahead * behind.inv()).as_rotvec() / (2 * h)
    found = rotations.angular_velocity(vector, rate)
    assert np.abs(found - expected).max() < 1e-8


@examples(100)
@given(seeds, st.floats(-9, 0))
def test_the_least_rotation(seed, exponent):
    """A rotation that carries one direction onto the other, and the least: near opposite ones as well."""
    rng = np.random.default_rng(seed)
    a = rng.standard_normal(3)
    a /= np.linalg.norm(a)
    for sign in (1, -1):
        b = sign * a + 10**exponent * rng.standard_normal(3)
        b /= np.linalg.norm(b)
        rotation = rotations.similarity(a, b)
        assert np.abs(rotation @ a - b).max() < 1e-12
        assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-12
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        angle = np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)
        assert np.trace(rotation) == pytest.approx(1 + 2 * np.cos(angle), abs=1e-9)
