"""Witnesses: movements that show that a scene can be solved, made before the scene and without any planner.

A witness is a few poses of the load. Between two of them the load moves by minimum jerk, from rest to rest: its
centre on the straight line, its orientation on the shortest turn. The duration of a segment is proportional to its
length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comove.geometry.rotations import conjugate, exponential, logarithm, matrices, quaternion_product
from comove.planning.seeds import minimum_jerk
from comove.scenes.scene import Scene
from comove.scenes.shapes import spatial
from comove.verification.record import ExecutionReport, RecordSamples, verify_execution

Array = NDArray[np.float64]

WHERE_NOTHING_MOVES = 1e-9  # m, added to every segment's way


@dataclass(frozen=True, eq=False)
class Witness:
    """Poses that a load passes one after another, which show that a scene can be solved.

    Attributes
    ----------
    center : array, shape (n_poses, 3), origin of the load's frame, the middle of the hands [m]
    quaternion : array, shape (n_poses, 4), w x y z; the load turns the shorter way from one to the next
    held : array, shape (n_manipulators, 3), hands in the load's frame [m]
    """

    center: Array
    quaternion: Array
    held: Array

    @classmethod
    def from_rows(cls, rows: list[list[float]], scene: Scene) -> Witness:
        """Build a witness from poses in the format of files, in a scene that starts at the first of them.

        Parameters
        ----------
        rows : a pose each: x, y [m] and an angle [rad] in the plane; x, y, z [m] and a quaternion w, x, y, z in space
        """
        center, quaternion = poses(np.array(rows, dtype=float))
        return cls(center, quaternion, (spatial(scene.start) - center[0]) @ matrices(quaternion[0]))

    @property
    def reach(self) -> float:
        """Return the distance of the farthest hand from the centre [m]."""
        return float(np.linalg.norm(self.held, axis=1).max())

    def hands(self, n_samples: int = 801) -> Array:
        """Return the hands at even times of the movement; array, shape (n_samples, n_manipulators, 3) [m]."""
        turns = np.stack(
            [
                logarithm(quaternion_product(conjugate(before), after))
                for before, after in zip(self.quaternion, self.quaternion[1:], strict=False)
            ]
        )
        moves = np.diff(self.center, axis=0)
        ways = np.linalg.norm(moves, axis=1) + self.reach * np.linalg.norm(turns, axis=1)
        ends = np.cumsum(np.append(0.0, ways + WHERE_NOTHING_MOVES))
        s = np.linspace(0.0, ends[-1], n_samples)
        k = np.clip(np.searchsorted(ends, s, side="right") - 1, 0, len(moves) - 1)
        share = minimum_jerk((s - ends[k]) / (ends[k + 1] - ends[k]))[:, None]
        center = self.center[k] + share * moves[k]
        rotation = matrices(quaternion_product(self.quaternion[k], exponential(share * turns[k])))
        return center[:, None] + np.einsum("tij,nj->tni", rotation, self.held)

    def judged(self, scene: Scene) -> ExecutionReport:
        """Return the judge's report on the witness, which covers the time between the samples too."""
        hands = self.hands()[:, :, : scene.n_dims]
        return verify_execution(RecordSamples(scene, np.linspace(0.0, scene.duration, len(hands)), hands))


def poses(rows: Array) -> tuple[Array, Array]:
    """Return centres and quaternions of poses as files hold them; arrays, shapes (n_poses, 3) and (n_poses, 4)."""
    if rows.shape[1] == 7:
        return rows[:, :3], rows[:, 3:] / np.linalg.norm(rows[:, 3:], axis=1, keepdims=True)
    zero, half = np.zeros(len(rows)), 0.5 * rows[:, 2]
    center = np.stack([rows[:, 0], rows[:, 1], zero], axis=1)
    return center, np.stack([np.cos(half), zero, zero, np.sin(half)], axis=1)
