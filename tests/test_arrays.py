"""Ties are decided by the order, not by rounding."""

import numpy as np
import pytest

from comove.arrays import first_largest, first_least, listed


@pytest.mark.parametrize("rounding", [0.0, 1e-16, -1e-16, 1e-13])
def test_the_first_of_those_that_only_rounding_tells_apart(rounding):
    values = np.array([0.1, 0.66, 0.66 + rounding, 0.3])
    assert first_largest(values) == 1
    assert first_least(-values) == 1
    assert first_largest(values[::-1]) == 1


def test_what_is_larger_is_larger():
    assert first_largest([1.0, 1.0 + 1e-6]) == 1
    assert first_least([1e-3, 0.0, 1e-3]) == 1
    assert first_largest([[1.0, 2.0], [3.0, 0.0]]) == 2
    assert first_largest([0.0, 0.0]) == 0


def test_what_is_no_number_is_told_first():
    assert first_largest([1.0, np.nan, 2.0]) == 1
    assert first_least([1.0, np.nan, 0.0]) == 1
    assert first_largest([1.0, np.inf, np.inf]) == 1
    assert first_largest([-np.inf, -1.0, -1.0]) == 1
    assert first_least([-np.inf, 1.0]) == 0


def test_coordinates_are_written_without_traces_of_rounding():
    told = listed([0.5, 5.55e-17, -0.0, -1e-9, 0.30000000000000004, -12.3456], 3)
    assert told == "[0.5, 0, 0, 0, 0.3, -12.346]"
    assert listed([1 / 3], 6) == "[0.333333]"
