"""Obstacles that move, among the bodies of a robot at work: where they are at an instant, and how fast at most."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array, Integers
from comove.model.moving import rotations
from comove.model.scene import Scene
from comove.robots.motion import Ranges


@dataclass(frozen=True, eq=False)
class MovingObstacles:
    """The bodies of a geometry model that are obstacles in motion.

    Attributes
    ----------
    scene : scene whose obstacles they are
    obstacle : array, shape (n_moving,), numbers of the obstacles that move
    body : array, shape (n_bodies,), numbers of their bodies: the obstacles themselves, and hulls of meshes
    of : array, shape (n_bodies,), for each body the index of its obstacle in `obstacle`
    turn, place : arrays, shape (n_bodies, 3, 3) and (n_bodies, 3), placements of the bodies in the file [m]
    """

    scene: Scene
    obstacle: Integers
    body: Integers
    of: Integers
    turn: Array
    place: Array

    @classmethod
    def among(cls, scene: Scene, geometry: Any, first: int, hulls: Mapping[int, int]) -> MovingObstacles:
        """Return the obstacles of a scene that move, among bodies.

        Parameters
        ----------
        geometry : pinocchio.GeometryModel
        first : number of the first obstacle's body, which those of the others follow
        hulls : numbers of hulls, by those of the meshes that they hold
        """
        moving = np.flatnonzero(scene.moving)
        body = [(k, first + i) for k, i in enumerate(moving.tolist())]
        body += [(k, hulls[number]) for k, number in body if number in hulls]
        of, numbers = np.array(body, dtype=np.int64).reshape(-1, 2).T
        placed = [geometry.geometryObjects[number].placement for number in numbers.tolist()]
        return cls(
            scene,
            moving,
            numbers,
            of,
            np.array([place.rotation for place in placed]).reshape(-1, 3, 3),
            np.array([place.translation for place in placed]).reshape(-1, 3),
        )

    def owns(self, body: Integers) -> NDArray[np.bool_]:
        """Return which moving obstacle each of some bodies is part of; arrays, shape (n,) -> (n, n_moving)."""
        part = np.zeros((len(body), len(self.obstacle)), dtype=bool)
        for number, k in zip(self.body, self.of, strict=True):
            part[:, k] |= body == number
        return part

    def placements(self, time: Array) -> tuple[Array, Array]:
        """Compute where the bodies are at some instants, array of shape (n_steps,) [s].

        Returns
        -------
        arrays, shape (n_steps, n_bodies, 3, 3) and (n_steps, n_bodies, 3) [m]
        """
        own = self.obstacle[self.of]
        turns = rotations(self.scene.turns(time)[:, own]) @ self.turn
        return turns, self.place + self.scene.offsets(time)[:, own]

    @cached_property
    def speed(self) -> Ranges:
        """Return upper bounds of the speed of a point of each moving obstacle [m/s].

        Between kinks the speed of what does not turn is constant.
        """
        scene, own = self.scene, self.obstacle
        knots = np.unique([0.0, *scene.obstacle_kinks, scene.duration])
        speeds = np.linalg.norm(scene.obstacle_velocities(knots[:-1])[:, own], axis=2)
        return Ranges(knots, np.where(scene.turning[own], scene.obstacle_speeds[own], speeds))
