"""Measures in words: rounding is 0, what is more is said."""

from pathlib import Path

import pytest

from comove.cli.generate import _sides
from comove.cli.texts import summary_text
from comove.data.variety import Variety
from comove.stored import joint_rows, motion_rows, run_rows, simulation_rows

DEVIATIONS = [
    (motion_rows, "distance_error_max"),
    (motion_rows, "end_error"),
    (motion_rows, "height_error_max"),
    (motion_rows, "tilt_max"),
    (motion_rows, "constraint_excess_max"),
    (joint_rows, "hand_error_max"),
    (joint_rows, "hand_turn_max"),
    (run_rows, "hold_error_max"),
    (run_rows, "distance_error_max"),
    (simulation_rows, "distance_error_max"),
]


@pytest.mark.parametrize(("rows", "key"), DEVIATIONS)
def test_deviations_of_rounding_are_zero(rows, key):
    for value, is_zero in ((1.4e-16, True), (-3e-15, True), (0.0, True), (2e-9, False)):
        [(_, said, _)] = rows({key: value})
        assert "e-1" not in said and (any(word == "0" for word in said.split()) == is_zero), said


def test_a_summary_says_what_its_numbers_are():
    text = summary_text({"scene": "wide", "smoothness": {"jerk_ratio": 835.0}}, Path())
    assert "root mean square jerk" in text and "28.9 times that of a straight minimum-jerk motion" in text
    assert "noted, not proven" not in text


@pytest.mark.parametrize(
    ("classes", "entropy", "said"),
    [
        ({"a": 5}, 0.0, "the same in all episodes"),
        ({"a": 2, "b": 2}, 1.0, "2 classes, as varied as 2 equally frequent ones"),
    ],
)
def test_passing_sides(classes, entropy, said):
    assert _sides(Variety(0.0, 0.0, 0.0, 0.0, classes, entropy)) == said
