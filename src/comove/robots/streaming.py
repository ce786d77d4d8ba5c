"""Commands of a joint motion, one for every cycle of a controller."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.errors import OptionError
from comove.primitives.arguments import is_number
from comove.robots.motion import JointMotion

Array = NDArray[np.float64]

SLOWEST, FASTEST = 20.0, 1e4  # Hz: below, hands would leave their distance between commands
BLOCK = 1000  # commands computed at once


class JointCommand(NamedTuple):
    """The command of the joints at an instant.

    Attributes
    ----------
    time : since the beginning of the motion [s]
    position, velocity, acceleration : arrays, shape (n_joints,) [rad, rad/s, rad/s^2; m for joints that slide]
    """

    time: float
    position: Array
    velocity: Array
    acceleration: Array


def commands(joints: JointMotion, rate: float, columns: NDArray[np.int64]) -> Iterator[JointCommand]:
    """Return an iterator over the commands of some joints at a rate [Hz], from rest at the start to rest at the goal.

    The last command is at the end of the motion, also where the cycles do not divide it.

    Raises
    ------
    OptionError
        If no robot is driven at that rate.
    """
    if not is_number(rate) or not SLOWEST <= rate <= FASTEST:
        raise OptionError(
            f"commands at {rate} Hz",
            key="rate",
            way_out=f"give {SLOWEST:g} to {FASTEST:g}, such as 1000 for libfranka or 500 for a UR",
        )
    return _commands(joints, float(rate), columns)


def _commands(joints: JointMotion, rate: float, columns: NDArray[np.int64]) -> Iterator[JointCommand]:
    count = int(np.ceil(joints.duration * rate - 1e-9))
    for first in range(0, count + 1, BLOCK):
        cycles = np.arange(first, min(first + BLOCK, count + 1)).astype(np.float64)
        time = np.minimum(cycles / rate, joints.duration)
        values = (samples[:, columns] for samples in joints.at(time))
        for instant, *command in zip(time.tolist(), *values, strict=True):
            yield JointCommand(instant, *command)
