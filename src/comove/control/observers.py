"""Obstacle states for an execution: known motions, functions of time, or measurements.

An observer returns the present state of obstacles (`observe`), and predicts their motions (`predict`). Estimates may
be wrong: a bound of their error is the margin that is added to the clearance.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array
from comove.control.safety.cbf_qp import Sighting
from comove.errors import OptionError
from comove.geometry.distances import CENTER
from comove.model.scene import Scene

Position = Callable[[float], ArrayLike]

STILL = 1e-6  # m/s, below which an obstacle is taken to stand


class Observer(ABC):
    """The base of all observers of a scene's obstacles.

    Attributes
    ----------
    scene : the scene whose obstacles are observed
    certain : whether the motions that it expects are exact
    """

    certain: ClassVar[bool] = False

    def __init__(self, scene: Scene):
        self.scene = scene

    @abstractmethod
    def observe(self, time: float) -> Sighting:
        """Return the estimated obstacle states at a present or future instant [s]."""

    def bends(self, time: float) -> Array:
        """Return the angular velocities of the velocities' directions; array, shape (n_rows, 3) [rad/s].

        They are 0 here.
        """
        return np.zeros((len(self.observe(time).table), 3))

    def predict(self, time: float) -> Scene:
        """Return the predicted scene. Its motions hold from that instant [s] on, rotations included."""
        return going_on(self.scene, self.observe(time), self.bends(time), time)

    def ground_truth(self, time: Array) -> Array:
        """Return the true positions of the centres; array, shape (n_times, n_obstacles, 3) [m].

        It is NaN where they are not known: here where an obstacle of the scene moves. Turns are those of the scene.
        """
        centers = np.full((len(time), len(self.scene.motions), 3), np.nan)
        centers[:, ~self.scene.moving] = self.scene.centers[~self.scene.moving]
        return centers

    def carried(self, time: float, nodes: Array) -> None:  # noqa: B027  most need not know
        """Set the payload's keypoints at an instant [s]; array, shape (n_nodes, 3) [m], end effectors first."""


class Known(Observer):
    """An observer that knows the motions in the scene's file exactly."""

    certain = True

    def observe(self, time: float) -> Sighting:
        """Return the obstacles at their exact positions."""
        now = np.array([time])
        velocity, margin = self.scene.obstacle_velocities(now)[0], np.zeros(len(self.scene.motions))
        return sighting(self.scene, self.ground_truth(now)[0], velocity, margin, time)

    def predict(self, time: float) -> Scene:
        """Return the scene itself."""
        return self.scene

    def ground_truth(self, time: Array) -> Array:
        """Return the file's positions of the centres; array, shape (n_times, n_obstacles, 3) [m]."""
        return self.scene.centers_at(time)


class Functions(Observer):
    """An observer of obstacles whose centres are functions of time; their future motion is not known.

    Parameters
    ----------
    scene : the scene to which the obstacles belong
    positions : one function per obstacle, from time [s] to its centre, n_dims numbers [m]; None where it is static
    instant, turn : times over which velocities, and their turning, are taken [s]
    sharpest : angular velocity of a turn that is still expected to go on [rad/s]

    Raises
    ------
    OptionError
        If there are not as many functions as obstacles.
    """

    def __init__(
        self,
        scene: Scene,
        positions: Sequence[Position | None],
        *,
        instant: float = 1e-4,
        turn: float = 0.02,
        sharpest: float = 10.0,
    ):
        if len(positions) != len(scene.motions):
            raise OptionError(
                f"{len(positions)} functions for {len(scene.motions)} obstacles",
                key="positions",
                way_out="give one for each obstacle, None where it stands",
            )
        super().__init__(scene)
        self._positions = tuple(positions)
        self._instant, self._turn, self._sharpest = instant, turn, sharpest

    @classmethod
    def of_motions(cls, scene: Scene) -> Functions:
        """Return an observer of the scene's own motions with unknown future."""
        return _OwnMotions(scene, [None] * len(scene.motions))

    def ground_truth(self, time: Array) -> Array:
        """Return the values of the functions; array, shape (n_times, n_obstacles, 3) [m]."""
        centers = np.repeat(self.scene.centers[None], len(time), axis=0)
        for j, position in enumerate(self._positions):
            if position is not None:
                told = np.array([np.asarray(position(float(t)), dtype=float) for t in time])
                if told.shape != (len(time), self.scene.n_dims) or not np.isfinite(told).all():
                    given = np.asarray(position(float(time[0]))).tolist()
                    raise OptionError(
                        f"the function of {self.scene.name_of(j)} gives {given}",
                        way_out=f"give {self.scene.n_dims} finite numbers",
                    )
                centers[:, j, : self.scene.n_dims] = told
        return centers

    def observe(self, time: float) -> Sighting:
        """Return the obstacles' present positions. Velocities are differences from the last instant."""
        instant = self._instant
        before, now = self.ground_truth(np.array([max(0.0, time - instant), max(instant, time)]))
        return sighting(self.scene, now, (now - before) / instant, np.zeros(len(now)), time)

    def bends(self, time: float) -> Array:
        """Return the angular velocities of the velocities' directions; array, shape (n_rows, 3) [rad/s]."""
        turn = self._turn
        before, now = self.observe(max(0.0, time - turn)).velocity, self.observe(time).velocity
        across, along = np.cross(before, now), (before * now).sum(axis=1)
        sine = np.linalg.norm(across, axis=1)
        angle = np.where(time > turn, np.arctan2(sine, along), 0.0)
        rate = np.where(angle < self._sharpest * turn, angle / turn, 0.0)  # faster turns are jumps
        return across * (rate / np.maximum(sine, 1e-300))[:, None]


class _OwnMotions(Functions):
    """An observer of the scene's own motions with unknown future."""

    def ground_truth(self, time: Array) -> Array:
        return self.scene.centers_at(time)


@dataclass(frozen=True, eq=False)
class Turning:
    """A motion of constant speed and turn rate, also before `since`.

    It is known in tracking as the coordinated turn (Bar-Shalom, Li and Kirubarajan, 2001), and is straight without a
    turn. It satisfies the protocol of `comove.model.moving.Motion`.

    Attributes
    ----------
    velocity : array, shape (3,), velocity of the centre at `since` [m/s]
    bend : array, shape (3,), angular velocity of its direction, perpendicular to the velocity [rad/s]
    since : reference time [s]
    spin : array, shape (3,), angular velocity of the body [rad/s]
    offset, turn : arrays, shape (3,), displacement of the centre and rotation vector at `since` [m, rad]; `turn` is a
        multiple of `spin`
    """

    velocity: Array
    bend: Array
    since: float
    spin: Array = field(default_factory=lambda: np.zeros(3))
    offset: Array = field(default_factory=lambda: np.zeros(3))
    turn: Array = field(default_factory=lambda: np.zeros(3))
    kinks: ClassVar[tuple[float, ...]] = ()

    @property
    def speed(self) -> float:
        """Return the speed of the centre [m/s]."""
        return float(np.linalg.norm(self.velocity))

    def turns(self, time: ArrayLike) -> Array:
        """Return the rotation vectors of the body; array, shape (n_times, 3) [rad]."""
        return self.turn + (np.asarray(time, dtype=float)[:, None] - self.since) * self.spin

    def offsets(self, time: ArrayLike) -> Array:
        """Return the offsets of the centre; array, shape (n_times, 3) [m]."""
        time, rate = np.asarray(time, dtype=float)[:, None] - self.since, np.linalg.norm(self.bend)
        along, across = np.sinc(rate * time / np.pi), np.sinc(0.5 * rate * time / np.pi) ** 2
        gone = time * along * self.velocity + 0.5 * time**2 * across * np.cross(self.bend, self.velocity)
        return self.offset + gone

    def velocities(self, time: ArrayLike) -> Array:
        """Return the velocities of the centre; array, shape (n_times, 3) [m/s]."""
        time, rate = np.asarray(time, dtype=float)[:, None] - self.since, np.linalg.norm(self.bend)
        turned = time * np.sinc(rate * time / np.pi) * np.cross(self.bend, self.velocity)
        return np.cos(rate * time) * self.velocity + turned

    def sagittas(self, time: ArrayLike) -> Array:
        """Return the centre's largest distances from chords between times; array, shape (n_times - 1,) [m]."""
        rate = np.linalg.norm(self.bend)
        return self.speed * rate * np.diff(np.asarray(time, dtype=float)) ** 2 / 8


def going_on(scene: Scene, seen: Sighting, bends: Array, time: float) -> Scene:
    """Return the scene with obstacles that continue their observed motions.

    Observed obstacles beyond those of the scene are appended. The instant is `time` [s].

    Parameters
    ----------
    bends : array, shape (n_rows, 3), angular velocities of the velocities' directions [rad/s]
    """
    n_rows, n_own = len(scene.owners), len(scene.motions)
    owners = np.append(scene.owners, n_own + np.arange(len(seen.table) - n_rows))
    first = np.unique(owners, return_index=True)[1]
    meshes, table = np.isin(owners, scene.surfaces.owner), seen.table.copy()
    table[meshes] = scene.obstacles[meshes[:n_rows]]  # their triangles are where the file has them
    offset = seen.table[first, CENTER : CENTER + 3] - table[first, CENTER : CENTER + 3]
    turn = np.zeros_like(offset)
    turn[:n_own] = np.where(meshes[first[:n_own], None], scene.turns(np.array([time]))[0], 0.0)
    moves = (np.linalg.norm(seen.velocity, axis=1) > STILL) | seen.spin.any(axis=1)
    velocity = np.where(moves[:, None], seen.velocity, 0.0)
    displaced = moves[first] | offset.any(axis=1) | turn.any(axis=1)
    motions = tuple(
        Turning(velocity[i], bends[i], time, seen.spin[i], offset[k], turn[k]) if displaced[k] else None
        for k, i in enumerate(first)
    )
    return replace(scene, obstacles=table, owners=owners, motions=motions)


def sighting(scene: Scene, center: Array, velocity: Array, margin: Array, time: float) -> Sighting:
    """Return obstacle states by table row, from values by obstacle.

    Obstacles turn as in the scene.

    Parameters
    ----------
    center, velocity : arrays, shape (n_obstacles, 3) [m], [m/s]
    margin : array, shape (n_obstacles,) [m]
    time : the instant [s]
    """
    table, owners = scene.obstacles_at(time, center), scene.owners
    return Sighting(table, velocity[owners], scene.spins[owners], margin[owners])
