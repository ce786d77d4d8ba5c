"""Errors of the parts of a robot due to tolerances of the places of its bases."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from comove.robots.description import Uncertainty
from comove.robots.model import Arm, Robot
from comove.robots.verification.reach import Reaches

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Bases:
    """The bases of a robot, with the tolerances of their places."""

    robot: Robot
    uncertainty: Uncertainty

    @cached_property
    def reaches(self) -> Reaches:
        """Return the reaches of the robot's joints."""
        return Reaches(self.robot)

    @cached_property
    def numbers(self) -> dict[str, int]:
        """Return, by name of link or joint, the number of the model whose base it is on; empty where there is one
        base only.
        """
        if len(self.robot.sources) == 1:
            return {}
        return {
            part.get("name", ""): number
            for number, source in enumerate(self.robot.sources)
            for part in ET.fromstring(source.urdf)
            if part.tag in ("link", "joint")
        }

    def pull(self, base: int, root: Array, length: float) -> float:
        """Bound the displacement, by the tolerance of a base, of points at most `length` from a point `root` [m].

        Turning about its origin by an angle a moves a point at the distance r by at most a r.

        Parameters
        ----------
        root : array, shape (..., 3); the furthest of several points counts
        """
        origin = np.array(self.robot.description.models[base].base.position)
        turn = np.deg2rad(self.uncertainty.rotation_deg)
        away = np.linalg.norm(root - origin, axis=-1)
        return float(self.uncertainty.position + turn * (away.max() + length))

    def of_hand(self, arm: Arm, places: Array) -> tuple[int, float]:
        """Return the base of an arm, and the largest error of its hand due to that base [m].

        Parameters
        ----------
        places : array, shape (n_steps, 3), positions of the hand [m]
        """
        model = self.robot.model
        base = self.numbers.get(model.names[model.frames[model.getFrameId(arm.tip)].parentJoint], 0)
        return base, self.pull(base, places, 0.0)
