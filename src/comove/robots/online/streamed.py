"""Record of a robot's run by streamed commands, as they were played."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.brief import brief
from comove.model.scene import Scene
from comove.robots.model import Robot

Truths = NDArray[np.bool_]


@dataclass(frozen=True)
class StreamTiming:
    """What a streamed run took, in seconds.

    Attributes
    ----------
    period_p50, period_p999, period_most : time between commands: median, 99.9 %, most
    latency_p50, latency_p999 : from the measurement of obstacles until a command is played that knows it, or from the
        joints' without obstacles
    joints_age_p50, joints_age_p99 : age of the joints' reports when they arrive
    """

    period_p50: float
    period_p999: float
    period_most: float
    latency_p50: float
    latency_p999: float
    joints_age_p50: float
    joints_age_p99: float


@dataclass(eq=False)
class StreamedRun:
    """Record of a run by streamed commands, a row a period.

    Attributes
    ----------
    scene, robot : the scene and the robot
    period : control period [s]
    commanded, measured : arrays, shape (n_steps, n_joints), joints as commanded and as measured last [rad]
    held : array, shape (n_steps,), whether the executor's own command was played; where the arms braked, it was not
    nodes : array, shape (n_steps, n_nodes, 3), keypoints of the payload as commanded [m]
    obstacles : array, shape (n_steps, n_obstacles, 3), centres of the obstacles as they were taken to be [m]
    arrived, interrupted : how it ended
    given_up : reason why it ended; empty if it did not give up
    stops : reasons why the arms braked, one a stop
    timing : what was in time
    """

    __repr__ = brief

    scene: Scene
    robot: Robot
    period: float
    commanded: Array
    measured: Array
    held: Truths
    nodes: Array
    obstacles: Array
    arrived: bool
    interrupted: bool
    given_up: str
    stops: tuple[str, ...]
    timing: StreamTiming
