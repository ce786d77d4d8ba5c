"""Displacements of moving obstacles, as kernels take them.

An obstacle moves by a translation of its centre and, where it turns, by a rotation about an axis through the centre:
a point x of the resting obstacle moves to ``center + offset + R(axis, angle) (x - center)``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from comove.arrays import Array


class Displacements(NamedTuple):
    """Displacements of obstacles from their poses at 0 s, by row of the scene's table of obstacles.

    Between two samples, offsets and angles change linearly. All arrays are read-only and C-contiguous: kernels are
    compiled for one kind of array. `of` makes them so.

    Attributes
    ----------
    offsets : array, shape (n_samples, n_rows, 3), translations of the centres [m]; n_samples = 0 if nothing moves
    angles : array, shape (n_samples, n_rows), rotation angles, not wrapped [rad]; 0 for rows that do not turn
    axes : array, shape (n_rows, 3), unit vectors of the rotation axes; any for rows that do not turn
    centers : array, shape (n_rows, 3), centres of the obstacles at 0 s, through which the axes pass [m]
    """

    offsets: Array
    angles: Array
    axes: Array
    centers: Array

    @classmethod
    def of(
        cls, offsets: Array, centers: Array, angles: Array | None = None, axes: Array | None = None
    ) -> Displacements:
        """Return displacements of these arrays; without angles and axes nothing turns."""
        if angles is None:
            angles = np.zeros(offsets.shape[:2])
        if axes is None:
            axes = np.tile([0.0, 0.0, 1.0], (len(centers), 1))
        arrays = [np.array(array, dtype=float, order="C") for array in (offsets, angles, axes, centers)]
        for array in arrays:
            array.setflags(write=False)
        return cls(*arrays)

    def shifted(self, more: Array) -> Displacements:
        """Return the displacements with further translations; array, shape (n_samples, n_rows, 3) [m]."""
        if len(self.offsets):
            return self.of(self.offsets + more, self.centers, self.angles, self.axes)
        return self.of(more, self.centers, None, self.axes)
