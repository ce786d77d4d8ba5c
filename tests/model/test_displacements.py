"""Displacements are read-only, contiguous, and add up."""

import numpy as np

from comove.model.moving import Displacements

CENTERS = np.zeros((2, 3))


def test_arrays_are_copies_that_kernels_take_alike():
    given = np.zeros((4, 3, 2)).transpose(0, 2, 1)
    found = Displacements.of(given, CENTERS)
    assert all(array.flags.c_contiguous and not array.flags.writeable for array in found)
    assert given.flags.writeable
    assert found.angles.shape == (4, 2) and found.axes.shape == (2, 3)


def test_further_translations_are_added_and_rotations_kept():
    turned = Displacements.of(np.ones((4, 2, 3)), CENTERS, np.full((4, 2), 0.5), np.eye(3)[:2])
    more = turned.shifted(np.full((4, 2, 3), 2.0))
    np.testing.assert_array_equal(more.offsets, 3.0)
    np.testing.assert_array_equal(more.angles, 0.5)
    np.testing.assert_array_equal(more.axes, np.eye(3)[:2])
    resting = Displacements.of(np.zeros((0, 2, 3)), CENTERS)
    np.testing.assert_array_equal(resting.shifted(np.full((4, 2, 3), 2.0)).offsets, 2.0)
