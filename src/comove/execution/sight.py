"""What an execution sees of its obstacles: known motions, functions of time, or measurements.

A sight tells where obstacles are now (`seen`), and what it expects of them from now on (`ahead`). Between its
measurements it may be wrong: by how much at most, as far as its figures go, is the margin that is kept on top.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comove.errors import OptionError
from comove.reaction.programme import Sighting
from comove.scenes.distances import CENTER
from comove.scenes.moving import Motion
from comove.scenes.scene import Scene

Array = NDArray[np.float64]
Position = Callable[[float], ArrayLike]

STILL = 1e-6  # m/s, below which an obstacle is taken to stand
INSTANT = 1e-4  # s, over which the velocity of a function is taken


class Sight(Protocol):
    """What every sight offers.

    Attributes
    ----------
    certain : whether what it expects is what will be
    """

    certain: bool

    def seen(self, time: float) -> Sighting:
        """The obstacles as they are believed to be at an instant [s], which must not lie in the past."""

    def ahead(self, time: float) -> Scene:
        """The scene as it is expected to be: its motions hold from that instant [s] on."""

    def true(self, time: Array) -> Array:
        """Where the centres really are; array, shape (n_times, n_obstacles, 3) [m]; NaN where nobody knows."""


@dataclass(frozen=True, eq=False)
class Known:
    """Motions as the scene's file gives them.

    Parameters
    ----------
    scene : whose obstacles move
    """

    scene: Scene
    certain: ClassVar[bool] = True

    def seen(self, time: float) -> Sighting:
        """Exactly what is."""
        return sighting(self.scene, self.true(np.array([time]))[0], self._velocity(time), self._exact)

    def ahead(self, time: float) -> Scene:
        """The scene itself."""
        return self.scene

    def true(self, time: Array) -> Array:
        """Where the file says."""
        return self.scene.centers + self.scene.offsets(time)

    @property
    def _exact(self) -> Array:
        return np.zeros(len(self.scene.motions))

    def _velocity(self, time: float) -> Array:
        return self.scene.obstacle_velocities(np.array([time]))[0]


class Functions:
    """Obstacles whose centres are functions of time; nothing is known of where they will go.

    Parameters
    ----------
    scene : whose obstacles they are
    positions : one function of time [s] an obstacle, which gives its centre, n_dims numbers [m]; None where it stands

    Raises
    ------
    OptionError
        If there are not as many functions as obstacles.
    """

    certain = False

    def __init__(self, scene: Scene, positions: Sequence[Position | None]):
        if len(positions) != len(scene.motions):
            raise OptionError(
                f"{len(positions)} functions for {len(scene.motions)} obstacles",
                key="positions",
                way_out="give one for each obstacle, None where it stands",
            )
        self.scene, self._positions = scene, tuple(positions)

    @classmethod
    def of_motions(cls, scene: Scene) -> Functions:
        """The scene's own motions, of which nobody knows how they go on."""
        return cls(
            scene,
            [
                None if motion is None else partial(_place, motion, center, scene.n_dims)
                for motion, center in zip(scene.motions, scene.centers, strict=True)
            ],
        )

    def true(self, time: Array) -> Array:
        """What the functions say."""
        centers = np.repeat(self.scene.centers[None], len(time), axis=0)
        for j, position in enumerate(self._positions):
            if position is not None:
                told = np.array([np.asarray(position(float(t)), dtype=float) for t in time])
                if told.shape != (len(time), self.scene.n_dims) or not np.isfinite(told).all():
                    raise OptionError(
                        f"the function of obstacles[{j}] gives {np.asarray(position(float(time[0]))).tolist()}",
                        way_out=f"give {self.scene.n_dims} finite numbers",
                    )
                centers[:, j, : self.scene.n_dims] = told
        return centers

    def seen(self, time: float) -> Sighting:
        """Where they are now, and how fast they got there."""
        before, now = self.true(np.array([max(0.0, time - INSTANT), max(INSTANT, time)]))
        return sighting(self.scene, now, (now - before) / INSTANT, np.zeros(len(now)))

    def ahead(self, time: float) -> Scene:
        """That they go on as they do."""
        return straight_on(self.scene, self.seen(time), time)


def straight_on(scene: Scene, seen: Sighting, time: float) -> Scene:
    """The scene whose obstacles go on from what is seen at an instant [s], at the velocities seen."""
    table = seen.table.copy()
    table[:, CENTER : CENTER + 3] -= time * seen.velocity
    velocity = seen.velocity[scene.first_rows]
    moves = np.linalg.norm(velocity, axis=1) > STILL
    motions = tuple(
        Motion(velocity=tuple(v[: scene.n_dims].tolist())) if goes else None
        for v, goes in zip(velocity, moves, strict=True)
    )
    return replace(scene, obstacles=table, motions=motions)


def _place(motion: Motion, center: Array, n_dims: int, time: float) -> Array:
    return (center + motion.offsets(np.array([time]))[0])[:n_dims]


def sighting(scene: Scene, center: Array, velocity: Array, margin: Array) -> Sighting:
    """What is seen, by row of the table, from what is known by obstacle.

    Parameters
    ----------
    center, velocity : arrays, shape (n_obstacles, 3) [m], [m/s]
    margin : array, shape (n_obstacles,) [m]
    """
    table, owners = scene.obstacles.copy(), scene.owners
    table[:, CENTER : CENTER + 3] = center[owners]
    return Sighting(table, velocity[owners], np.zeros((len(table), 3)), margin[owners])
