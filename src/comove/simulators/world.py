"""World of a simulation: a MuJoCo model, and the indices of everything in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.robots.model import Robot
from comove.simulators.bodies import ROBOT
from comove.simulators.loads import Load

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class World:
    """A compiled MuJoCo model with the indices of what is in it.

    Attributes
    ----------
    model : mujoco.MjModel
    robot, load : the robot and the load in the world; the load may be None
    qpos, dofs, servos : arrays, shape (n_joints,), indices of coordinates, degrees of freedom and servos of the
        robot's joints, in its order
    lead : array, shape (n_joints,), factor of a reference velocity in the servos' reference position [s]
    sites : array, shape (n_manipulators,), indices of the hands' grasp frames
    holder_names : names of the arms that hold the load
    holder_sites, held_sites : arrays, shape (n_holders,), indices of the sites of these hands, and of their grasps on
        the load
    fingers : names of the joints of each holder's fingers, empty where they do not move
    load_body, load_qpos, load_dof : indices of the load's body, first coordinate and first degree of freedom; -1
        without a load
    hand_of_geom : array, shape (n_geoms,), number of the holder that a shape belongs to, -1 for none
    watched : array of bool, shape (n_geoms, n_geoms), whether the contact of a pair of shapes is reported
    """

    model: Any
    robot: Robot
    load: Load | None
    qpos: Ints
    dofs: Ints
    servos: Ints
    lead: Array
    sites: Ints
    holder_names: tuple[str, ...]
    holder_sites: Ints
    held_sites: Ints
    fingers: tuple[tuple[str, ...], ...]
    load_body: int
    load_qpos: int
    load_dof: int
    hand_of_geom: Ints
    watched: NDArray[np.bool_]

    def names_of(self, pair: tuple[int, int]) -> tuple[str, str]:
        """Return the names of what two shapes belong to, for messages: the load before a link, a link before an
        obstacle.
        """
        first, second = sorted(pair, key=self._rank)
        return self._name_of(first), self._name_of(second)

    def _rank(self, geom: int) -> int:
        if self.model.geom_bodyid[geom] == self.load_body:
            return 0
        return 1 if self.model.geom_contype[geom] == ROBOT[0] else 2

    def _name_of(self, geom: int) -> str:
        shape, body = self.model.geom(geom), self.model.body(self.model.geom_bodyid[geom])
        return body.name if self._rank(geom) == 1 else shape.name
