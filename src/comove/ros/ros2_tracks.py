"""Moving obstacles in one point cloud after another. It is used under ROS's own Python."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from cloud_fits import CUT, Shape, Unseen, fitted_center
from point_clouds import CloudError, points_of

if TYPE_CHECKING:  # ROS's Python has no comove
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

MOST = 80_000  # points of a cloud that are read
PACE = 0.02  # s, between clouds that are read
GATE, SPEED, WIDEST = (
    0.1,
    1.0,
    0.3,
)  # m, m/s and m: how far from where it is expected an obstacle is looked for
GOES_ON = 0.2  # s, for which an obstacle is expected to go on as before


@dataclass
class Track:
    """A moving obstacle.

    Attributes
    ----------
    shape : its shape as it is turned at 0 s
    spin : array, shape (3,), angular velocity [rad/s]
    center, velocity : arrays, shape (3,), as seen last [m], [m/s]
    time : when that was [s]
    """

    shape: Shape
    spin: Array
    center: Array
    velocity: Array
    time: float = -np.inf

    @classmethod
    def of(cls, told: Mapping[str, Any]) -> Track:
        """Return the track of a JSON object."""
        spin, center = np.array(told["spin"], dtype=float), np.array(told["center"], dtype=float)
        return cls(Shape.of(told), spin, center, np.zeros(3))

    def turned(self, seconds: float) -> Shape:
        """Return the shape as it is turned after some seconds."""
        return self.shape.turned(rotation(max(seconds, 0.0) * self.spin)) if self.spin.any() else self.shape

    def expected(self, time: float) -> tuple[Array, float]:
        """Return the expected centre, (3,) [m], and its uncertainty [m]."""
        since = time - self.time
        ahead = self.velocity * since if since < GOES_ON else np.zeros(3)
        return self.center + ahead, min(GATE + SPEED * since, WIDEST)

    def see(self, center: Array, time: float) -> None:
        """Note where it is."""
        since = time - self.time
        self.velocity = (center - self.center) / since if since < GOES_ON else np.zeros(3)
        self.center, self.time = center, time


class CloudTracks:
    """Moving obstacles, followed through clouds.

    Parameters
    ----------
    moving : those that are looked for, by name: JSON objects with the entries of a shape, "center" [m] and "spin"
    still : static ones: JSON objects with the entries of a shape and "center"
    noise : standard deviation of points on a surface [m]

    Attributes
    ----------
    zero : instant at which obstacles begin to turn, None as long as they do not [s]
    """

    def __init__(
        self, moving: Mapping[str, Mapping[str, Any]], still: Sequence[Mapping[str, Any]], noise: float
    ):
        self.tracks = {name: Track.of(told) for name, told in moving.items()}
        self.still = [(Shape.of(told), np.array(told["center"], dtype=float)) for told in still]
        self.noise, self.zero, self.last = noise, None, -np.inf

    def update(self, message: Any, time: float) -> tuple[dict[str, list[float]], dict[str, str]]:
        """Return centres [m] by name, and why others are not told.

        Parameters
        ----------
        message : a PointCloud2; one that follows too soon, or is older than the last, is left out
        time : when it was measured [s]
        """
        if time < self.last + PACE:
            return {}, {}
        self.last = time
        try:
            points = points_of(message, MOST)
        except CloudError as error:
            return {}, dict.fromkeys(self.tracks, str(error))
        turned = 0.0 if self.zero is None else time - self.zero
        there = {name: (track.turned(turned), *track.expected(time)) for name, track in self.tracks.items()}
        centers, unseen = dict[str, list[float]](), dict[str, str]()
        for name, (shape, center, gate) in there.items():
            others = [(other, at) for key, (other, at, _) in there.items() if key != name]
            try:
                found = fitted_center(
                    shape, self._near(points, shape, center, gate, others), center, self.noise, gate
                )
            except Unseen as reason:
                unseen[name] = str(reason)
            else:
                self.tracks[name].see(found, time)
                centers[name] = found.tolist()
        return centers, unseen

    def _near(
        self,
        points: NDArray[Any],
        shape: Shape,
        center: Array,
        gate: float,
        others: Sequence[tuple[Shape, Array]],
    ) -> Array:
        """Return the points (n, 3) that may be an obstacle's: near it, and not nearer to another one."""
        reach, near = shape.reach + gate + CUT * self.noise, CUT * self.noise
        inside = np.ones(points.shape[1], dtype=bool)
        for row, middle in zip(points, center.tolist(), strict=True):
            inside &= np.abs(row - middle) <= reach  # false where it is no number
        found = points.T[np.flatnonzero(inside)].astype(float)
        away = np.abs(shape.distances(found - center))
        kept = away <= gate + near
        for other, at in (*self.still, *others):
            if np.sqrt(((at - center) ** 2).sum()) <= reach + other.reach + near:
                from_it = other.distances(found - at)
                kept &= (from_it > near) | (np.abs(from_it) > away)
        return found[kept]


def rotation(turn: Array) -> Array:
    """Return the matrix (3, 3) of a rotation vector (3,) [rad]."""
    angle = float(np.sqrt(turn @ turn))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = turn / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
