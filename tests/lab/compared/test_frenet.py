"""Frenet-Serret frames against curves whose frames are known."""

import numpy as np
import pytest

from comove.lab.compared.cooperation import frenet_frames

T = np.linspace(0.0, 2.0, 401)


def derivatives(path):
    """First and second derivative of a function of time, by central differences of the function itself."""
    h = 1e-4
    return (path(T + h) - path(T - h)) / (2 * h), (path(T + h) - 2 * path(T) + path(T - h)) / h**2


def test_the_frame_of_a_helix():
    radius, pitch, w = 0.3, 0.1, 5.0
    slope, bend = derivatives(
        lambda t: np.stack([radius * np.cos(w * t), radius * np.sin(w * t), pitch * t], axis=1)
    )
    frames = frenet_frames(slope, bend)
    normal = np.stack([-np.cos(w * T), -np.sin(w * T), 0 * T], axis=1)
    speed = np.hypot(radius * w, pitch)
    binormal = np.stack([pitch * np.sin(w * T), -pitch * np.cos(w * T), radius * w + 0 * T], axis=1) / speed
    assert frames[:, :, 1] == pytest.approx(normal, abs=1e-5)
    assert frames[:, :, 2] == pytest.approx(binormal, abs=1e-5)


def test_the_frame_does_not_depend_on_the_pace():
    slope, bend = derivatives(lambda t: np.stack([np.cos(t), np.sin(t), t**2], axis=1))
    rate, change = 1.0 + 0.5 * np.sin(T), 0.7 * np.cos(T)
    paced = frenet_frames(slope * rate[:, None], bend * rate[:, None] ** 2 + slope * change[:, None])
    assert paced == pytest.approx(frenet_frames(slope, bend), abs=1e-7)


@pytest.mark.parametrize("n_dims", [2, 3])
def test_frames_are_right_handed_and_orthonormal(n_dims):
    rng = np.random.default_rng(n_dims)
    slope, bend = rng.standard_normal((2, 300, n_dims))
    slope[:5] = 0.0  # at rest
    frames = frenet_frames(slope, bend)
    assert np.einsum("tij,tik->tjk", frames, frames) == pytest.approx(np.tile(np.eye(n_dims), (300, 1, 1)))
    assert np.linalg.det(frames) == pytest.approx(np.ones(300))


def test_a_straight_path_keeps_its_normal():
    direction = np.array([1.0, 2.0, -0.5])
    frames = frenet_frames(np.outer(np.sin(np.pi * T / 2), direction), np.outer(np.cos(T), direction))
    assert frames[:, :, 0] == pytest.approx(np.tile(direction / np.linalg.norm(direction), (len(T), 1)))
    assert np.ptp(frames[:, :, 1], axis=0).max() < 1e-12


def test_a_path_that_never_moves_has_a_frame():
    assert frenet_frames(np.zeros((5, 3)), np.zeros((5, 3))) == pytest.approx(
        np.tile(np.eye(3), (5, 1, 1)), abs=1
    )
