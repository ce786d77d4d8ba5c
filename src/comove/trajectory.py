"""Sampled movements of several manipulators."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from comove.brief import brief

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Trajectory:
    """A movement of one or several manipulators, sampled in time; the arrays are read-only.

    Attributes
    ----------
    time : array, shape (n_steps,), [s]
    position : array, shape (n_steps, n_manipulators, n_dims), [m]; (n_steps, n_dims) for one primitive
    velocity : array, shaped as `position`, [m/s]
    manipulators : names along the axis `n_manipulators`; empty for one primitive
    """

    __repr__ = brief

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


@dataclass(frozen=True)
class PoseTrajectory(Trajectory):
    """A sampled movement that also holds orientations; the arrays are read-only.

    Attributes
    ----------
    orientation : array, shape (n_steps, n_manipulators, 4), unit quaternions w x y z, continuous in time;
        (n_steps, 4) for one primitive
    angular_velocity : array, shape (n_steps, n_manipulators, 3), in the world's frame [rad/s];
        (n_steps, 3) for one primitive
    """

    __repr__ = brief

    orientation: NDArray[np.float64] = field(kw_only=True)
    angular_velocity: NDArray[np.float64] = field(kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, width in (("orientation", 4), ("angular_velocity", 3)):
            array = np.array(getattr(self, name), dtype=float)
            if array.shape != (*self.position.shape[:-1], width):
                raise ValueError(f"{name} {array.shape} does not belong to position {self.position.shape}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def rotation(self) -> Rotation:
        """Return the orientations as SciPy's `Rotation`. Its shape is (n_steps,) or (n_steps * n_manipulators,)."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self.orientation.reshape(-1, 4), scalar_first=True)


def interpolated(
    at: NDArray[np.float64], time: NDArray[np.float64], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return values at other times by linear interpolation; array, shape (len(at), n_columns).

    Parameters
    ----------
    at : array, shape (n,), times wanted
    time, values : arrays, shapes (n_steps,) and (n_steps, n_columns)
    """
    return np.stack([np.interp(at, time, column) for column in values.T], axis=1)
