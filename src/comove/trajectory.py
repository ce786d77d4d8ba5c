"""Sampled movements of several manipulators."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Trajectory:
    """A sampled movement; the arrays are read-only.

    Attributes
    ----------
    time : array, shape (n_steps,), [s]
    position : array, shape (n_steps, n_manipulators, n_dims), [m]; (n_steps, n_dims) for one primitive
    velocity : array, shaped as `position`, [m/s]
    manipulators : names along the axis `n_manipulators`; empty for one primitive
    """

    time: NDArray[np.float64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    manipulators: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("time", "position", "velocity"):
            array = np.array(getattr(self, name), dtype=float)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if self.position.shape != self.velocity.shape or len(self.time) != len(self.position):
            raise ValueError(
                f"time {self.time.shape}, position {self.position.shape} and velocity "
                f"{self.velocity.shape} do not belong together"
            )
