"""Plans of tasks: joint motions one after the other on one clock, and when grippers close and open."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from comove.arrays import Array
from comove.brief import brief
from comove.errors import OptionError
from comove.planning.solution import Solution
from comove.robots.model import Robot
from comove.robots.motion import JointMotion


@dataclass(frozen=True, eq=False, repr=False)
class TaskPart:
    """A joint motion of a task, from rest to rest.

    Attributes
    ----------
    phases : names of the phases that it carries out
    motion : motion of all joints
    closing : by arm, the instant of the motion at which its gripper begins to close [s]
    opening : likewise, to open
    clearance_min : certified lower bound of its clearance [m]
    solution : search that found it; the approach to a carry and the release after it have the carry's
    """

    __repr__ = brief

    phases: tuple[str, ...]
    motion: JointMotion
    closing: Mapping[str, float]
    opening: Mapping[str, float]
    clearance_min: float
    solution: Solution | None = None


class Command(NamedTuple):
    """Command of all arms at an instant.

    Attributes
    ----------
    time : instant of the plan [s]
    joints : by arm, positions, array, shape (n_joints,) [rad, m for prismatic joints]
    closed : by arm, whether its gripper is to be closed
    phases : names of the phases that are carried out
    """

    time: float
    joints: Mapping[str, Array]
    closed: Mapping[str, bool]
    phases: tuple[str, ...]


@dataclass(frozen=True, eq=False, repr=False)
class TaskPlan:
    """A task's motions. Each is verified, and begins where the one before it has ended.

    Attributes
    ----------
    robot : robot that moves
    parts : the motions in their order
    """

    __repr__ = brief

    robot: Robot
    parts: tuple[TaskPart, ...]

    @property
    def duration(self) -> float:
        """Return the duration [s]."""
        return float(self._begins[-1])

    @property
    def clearance_min(self) -> float:
        """Return the certified lower bound of the clearance of all parts [m]."""
        return min(part.clearance_min for part in self.parts)

    @cached_property
    def _begins(self) -> Array:
        return np.cumsum([0.0, *(part.motion.duration for part in self.parts)])

    def derivatives(self, time: float) -> tuple[Array, Array, Array]:
        """Return joints, rates and accelerations at an instant [s]; arrays, shape (n_joints,)."""
        number, since = self._part_at(time)
        curve, now = self.parts[number].motion.curve, np.array([since])
        return curve(now)[0], curve(now, 1)[0], curve(now, 2)[0]

    def _part_at(self, time: float) -> tuple[int, float]:
        """Return the part at an instant, and the instant in it [s]."""
        time = float(np.clip(time, 0.0, self.duration))
        number = min(bisect_right(self._begins.tolist(), time) - 1, len(self.parts) - 1)
        return number, time - float(self._begins[number])

    def at(self, time: float) -> Command:
        """Return the command at an instant [s]; before the beginning and after the end, that at these."""
        number, since = self._part_at(time)
        part, (q, _, _) = self.parts[number], self.derivatives(time)
        joints = {arm.name: q[arm.columns] for arm in self.robot.arms}
        closed = {arm.name: self._is_closed(arm.name, number, since) for arm in self.robot.arms}
        return Command(float(self._begins[number]) + since, joints, closed, part.phases)

    def _is_closed(self, arm: str, number: int, since: float) -> bool:
        """Return whether a gripper is closed at a part's instant [s].

        It is as it was told last.
        """
        for k in range(number, -1, -1):
            part, until = self.parts[k], since if k == number else np.inf
            told = [
                (events[arm], closes)
                for closes, events in ((True, part.closing), (False, part.opening))
                if arm in events and events[arm] <= until
            ]
            if told:
                return max(told)[1]
        return False

    def stream(self, rate: float) -> Iterator[Command]:
        """Yield commands at a rate [Hz], from the beginning to the end.

        Raises
        ------
        OptionError
            If the rate is not positive and finite.
        """
        if not 0.0 < rate < np.inf:
            raise OptionError(f"a rate of {rate!r} Hz", key="rate", way_out="give a positive number")
        n_steps = int(np.ceil(self.duration * rate - 1e-9))
        for k in range(n_steps + 1):
            yield self.at(k / rate)
