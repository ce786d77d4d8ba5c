"""The orientations of hands that hold a load which turns about the vertical only, from the hands' positions.

The heading psi of the load is the direction, seen from above, from its second holder to its first. A hand's grasp
frame (z the approach direction, fingers open along y) keeps its tilt and turns with the load:

    R(psi) = Rz(psi + offset) R(0)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comove.geometry.rotations import matrices, rotation_in_plane
from comove.scenes.model import GraspPart, SceneFile

Array = NDArray[np.float64]

HELD = {
    "down": np.diag([-1.0, 1.0, -1.0]),
    "forward": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
}
"""Grasp frames at heading 0, by their names: the approach points down, or along the heading with fingers that open
upwards."""


@dataclass(frozen=True, eq=False)
class Grasp:
    """Holds how the hands are oriented while they carry the load.

    Attributes
    ----------
    holders : numbers of the hands that hold the load; the heading points from the second to the first. A single
        holder carries a load that does not turn, whose heading is 0
    at_rest : array, shape (n_manipulators, 3, 3), every hand's grasp frame while the heading is 0, offset included
    turning : array of bool, shape (n_manipulators,), True for hands that turn with the load; the others do not turn
    """

    holders: tuple[int, ...]
    at_rest: Array
    turning: NDArray[np.bool_]

    def heading(self, hands: Array) -> Array:
        """Return the heading of the load [rad], between -pi and pi; array, shape (...).

        Parameters
        ----------
        hands : array, shape (..., n_manipulators, 3), [m]
        """
        x, y = self._along(hands)
        return np.arctan2(y, x)

    def hand_rotations(self, hands: Array) -> Array:
        """Return the orientations of the hands' grasp frames; array, shape (..., n_manipulators, 3, 3).

        Parameters
        ----------
        hands : array, shape (..., n_manipulators, 3), [m]
        """
        x, y = self._along(hands)
        size = np.hypot(x, y)[..., None]
        c = np.where(self.turning, x[..., None] / size, 1.0)[..., None]
        s = np.where(self.turning, y[..., None] / size, 0.0)[..., None]
        rotations = np.empty((*c.shape[:-1], 3, 3))
        rotations[..., 0, :] = c * self.at_rest[:, 0] - s * self.at_rest[:, 1]
        rotations[..., 1, :] = s * self.at_rest[:, 0] + c * self.at_rest[:, 1]
        rotations[..., 2, :] = self.at_rest[:, 2]
        return rotations

    def heading_rates(self, hands: Array, velocities: Array) -> Array:
        """Compute the rates of the load's heading as hands move; array, shape (..., n) [rad/s].

        Parameters
        ----------
        hands : array, shape (..., n_manipulators, 3), [m]
        velocities : array, shape (..., n_manipulators, 3, n), n ways in which they move [m/s]
        """
        if len(self.holders) == 1:
            return np.zeros((*velocities.shape[:-3], velocities.shape[-1]))
        first, second = self.holders[:2]
        x, y = (along[..., None] for along in self._along(hands))
        change = velocities[..., first, :, :] - velocities[..., second, :, :]
        return (x * change[..., 1, :] - y * change[..., 0, :]) / (x * x + y * y)

    def _along(self, hands: Array) -> tuple[Array, Array]:
        """Return x and y of the vector from the second holder to the first [m]; two arrays, shape (...)."""
        hands = np.asarray(hands, dtype=float)
        if len(self.holders) == 1:
            return np.ones(hands.shape[:-2]), np.zeros(hands.shape[:-2])
        first, second = self.holders[:2]
        return tuple(np.moveaxis(hands[..., first, :2] - hands[..., second, :2], -1, 0))


def grasp_of(file: SceneFile, carried: tuple[int, ...]) -> Grasp | None:
    """Return the grasp that a scene file describes, the first where it describes several; None where it has none.

    Parameters
    ----------
    carried : numbers of the hands that form one rigid body with the load
    """
    if file.grasp is None:
        return None
    part = alternatives(file)[0]
    offset = part.offset_deg
    offsets = [offset.get(name, 0.0) if isinstance(offset, dict) else offset for name in file.names]
    held = HELD[part.orientation or "down"]
    if part.quaternion_wxyz is not None:
        held = matrices(np.array(part.quaternion_wxyz))
    return Grasp(
        holders=file.holder_numbers,
        at_rest=np.stack([rotation_in_plane(np.deg2rad(angle)) @ held for angle in offsets]),
        turning=np.isin(np.arange(len(file.names)), carried),
    )


def alternatives(file: SceneFile, step: float = 45.0) -> tuple[GraspPart, ...]:
    """Return the grasps that a scene file leaves open, each with a yaw that is given; none where it has none.

    Where the yaw is free, hands are turned by all multiples of `step` [deg] beyond their offsets: all by the same, or
    the first against the others.
    """
    if file.grasp is None:
        return ()
    found = list[GraspPart]()
    for part in file.grasp.any_of or (file.grasp,):
        if part.yaw == "load":
            found.append(part)
            continue
        turns = step * np.arange(round(360 / step))
        for first, others in ((1, 1), (1, -1)):
            for turn in turns.tolist():
                signs = [first if name == file.names[0] else others for name in file.names]
                said = part.offset_deg
                offset = {
                    name: (said.get(name, 0.0) if isinstance(said, dict) else said) + sign * turn
                    for name, sign in zip(file.names, signs, strict=True)
                }
                same = all(abs((sign - 1) * turn) % 360 == 0 for sign in signs)
                if others == 1 or not same:
                    found.append(part.model_copy(update={"yaw": "load", "offset_deg": offset}))
    return tuple(found)
