"""Goals with a free axis: turns with a clear payload, by expected cost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from comove.arrays import Array
from comove.geometry.rotations import matrices
from comove.model.files.keys import GraspOption
from comove.model.grasp import turned_goal
from comove.model.resting import TOLERANCE, provable
from comove.model.scene import Scene
from comove.model.shapes import spatial


@dataclass(frozen=True)
class TurnSettings:
    """Settings of the turns of a free goal.

    Attributes
    ----------
    step : between the turns that are sampled [rad]; the best of them are refined
    apart : between further turns, which are tried where the best does not lead to a motion [rad]
    most : largest number of turns that are tried
    """

    step: float = np.deg2rad(5.0)
    apart: float = np.deg2rad(30.0)
    most: int = 8


SETTINGS = TurnSettings()


class FreeGoal:
    """The payload at a goal free about an axis, with one grasp."""

    def __init__(self, scene: Scene, option: GraspOption):
        load = scene.file.load
        assert load is not None and load.start is not None and option.free is not None
        self.scene, self.option, self.free = scene.without_supports(), option, option.free
        holders = [scene.manipulators.index(name) for name in option.grasps]
        group = next(g for g, one in enumerate(scene.groups) if {*holders} <= {*one.members})
        self.own = scene.nodes_of_groups[group]
        start = matrices(np.array(load.start.quaternion_wxyz))
        self.points = (scene.nodes_at("start")[self.own] - spatial(np.array(load.start.position))) @ start
        self.hands = spatial(np.array([*option.grasps.values()]))
        for hand, place in zip(holders, self.hands, strict=True):
            self.points[self.own.index(hand)] = place
        at_rest = [i for i in range(len(scene.file.obstacles)) if not scene.moving[i]]
        self.supports = [i for i in at_rest if scene.file.obstacles[i].support]
        self.still = [i for i in at_rest if i not in self.supports]
        self.begin = spatial(np.array(load.start.position)) + self.hands @ start.T

    def pose(self, angle: float) -> tuple[Array, Array]:
        """Return the payload's position and orientation at a turn [rad]."""
        goal = turned_goal(self.option, angle).goal
        return spatial(np.array(goal.position)), matrices(np.array(goal.quaternion_wxyz))

    def is_clear(self, angle: float) -> bool:
        """Return whether payload and end effectors are clear of static obstacles.

        Supports count as far as the payload must not be in them; resting contacts are checked where it is put down.
        """
        position, turn = self.pose(angle)
        nodes = self.scene.nodes_at("goal").copy()
        nodes[self.own] = position + self.points @ turn.T
        needed = self.scene.clearance + provable(self.scene)
        if self.scene.nearest_at(nodes, 0.0, self.still)[0] < needed:
            return False
        deep = TOLERANCE + provable(self.scene)
        return all(self.scene.distance_from(i, nodes) >= -deep for i in self.supports)

    def cost(self, angle: float) -> float:
        """Return the expected jerk: end effectors' squared displacements, and a little for the turn."""
        position, turn = self.pose(angle)
        away = position + self.hands @ turn.T - self.begin
        wrapped = angle - 2 * np.pi * np.round(angle / (2 * np.pi))
        return float((away**2).sum() + 1e-4 * wrapped**2)

    def turns(
        self, cost: Callable[[float], float] | None = None, how: TurnSettings = SETTINGS
    ) -> list[float]:
        """Return the clear turns [rad], likeliest first. They are refined local minima of a cost, then others.

        Parameters
        ----------
        cost : of a turn, infinite where it is impossible; unless given, that of a straight motion
        how : settings of the turns
        """
        cost, n = cost or self.cost, round(2 * np.pi / how.step)
        angles = how.step * (np.arange(n) - n // 2)
        angles = np.append(angles, 0.0) if not np.isclose(angles, 0.0).any() else angles
        values = np.array([cost(angle) if self.is_clear(angle) else np.inf for angle in angles.tolist()])
        found = list[tuple[float, float]]()
        for k in np.flatnonzero(np.isfinite(values)).tolist():
            if values[k] <= min(values[k - 1], values[(k + 1) % len(values)]):
                found.append(self._refined(cost, angles[k], values[k], how.step))
        rest = sorted((value, angle) for value, angle in zip(values.tolist(), angles.tolist(), strict=True))
        kept = list[float]()
        for value, angle in [*sorted(found), *rest]:
            if np.isfinite(value) and all(
                abs(np.angle(np.exp(1j * (angle - one)))) >= how.apart for one in kept
            ):
                kept.append(angle)
        return kept[: how.most]

    def _refined(
        self, cost: Callable[[float], float], angle: float, value: float, step: float
    ) -> tuple[float, float]:
        """Return the least cost near a turn, and its turn [rad]. Only clear turns count."""
        from scipy.optimize import minimize_scalar  # slow to import, and only free goals need it

        low = minimize_scalar(
            lambda x: min(cost(x), 1e6),
            bounds=(angle - step, angle + step),
            method="bounded",
            options={"xatol": 1e-4},
        )
        better = low.fun < value and self.is_clear(float(low.x))
        return (float(low.fun), float(low.x)) if better else (value, angle)
