"""Integrated motions as curves: near, with the ends that they had."""

import numpy as np
import pytest

from comove.lab.compared.common import fit_curve
from comove.model import arms_coordinates
from comove.verification import verify
from tests.model.examples import HANDS, LEVEL

S = np.linspace(0.0, 1.0, 2001)
SHARE = (S**3 * (10 - 15 * S + 6 * S**2))[:, None, None]


def way(scene, wiggle=0.0):
    off = wiggle * (np.sin(12 * np.pi * S) * S**2 * (1 - S) ** 2)[:, None, None]
    return scene.start + SHARE * (scene.goal - scene.start) + off


@pytest.mark.parametrize("scene", [HANDS, LEVEL], ids=["free", "at one height"])
def test_smooth_motions_are_met(scene):
    fit = fit_curve(scene, arms_coordinates(scene), S, way(scene, 0.5))
    assert fit.error < 1e-6
    assert fit.motion.hands(S)[0] == pytest.approx(way(scene, 0.5), abs=2 * fit.error + 1e-12)
    assert verify(fit.motion).report.end_error < 1e-9


def test_the_error_that_is_told_is_the_largest():
    hands = way(HANDS)
    hands[1000:, 0, 1] += 0.01 * np.maximum(0.0, 1.0 - np.abs(S[1000:] - 0.5) * 100)  # a jump
    fit = fit_curve(HANDS, arms_coordinates(HANDS), S, hands)
    away = np.linalg.norm(fit.motion.hands(S)[0] - hands, axis=2)
    assert fit.error == pytest.approx(away.max())
    assert fit.error > 1e-3


def test_who_has_nearly_arrived_is_led_to_the_goal():
    hands = way(HANDS) - 0.002 * SHARE
    fit = fit_curve(HANDS, arms_coordinates(HANDS), S, hands)
    assert fit.end_miss == pytest.approx(0.002 * np.sqrt(3), rel=1e-6)
    assert verify(fit.motion).verified
    assert fit.motion.hands(S[S < 0.8])[0] == pytest.approx(hands[S < 0.8], abs=1e-6)


def test_who_has_not_arrived_ends_where_he_ends():
    hands = way(HANDS)
    hands[1000:] = hands[1000]
    fit = fit_curve(HANDS, arms_coordinates(HANDS), S, hands)
    verdict = verify(fit.motion)
    assert verdict.verified is None
    assert verdict.report.end_error == pytest.approx(np.abs(hands[-1] - HANDS.goal).max())


def test_who_rushes_through_the_goal_is_still_moving():
    hands = HANDS.start + S[:, None, None] ** 2 * (HANDS.goal - HANDS.start)
    report = verify(fit_curve(HANDS, arms_coordinates(HANDS), S, hands).motion).report
    slope = 2 * np.linalg.norm(HANDS.goal - HANDS.start, axis=1).max() / HANDS.duration
    assert report.end_speed == pytest.approx(slope, rel=1e-6)
