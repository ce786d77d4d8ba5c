"""Could anybody have dodged? A search for any movement from rest that keeps the limits and touches nothing at first.

It knows how everything will move, need not get anywhere, and shares nothing with planner and executor: CMA-ES over
the load's twist at a few instants, straight in between, judged as executions are.
"""

from __future__ import annotations

import numpy as np

from comove.optimisers import CMAES
from comove.reaction.twists import advanced, poses_of
from comove.scenes import Scene
from comove.verification.record import Record, judge

HORIZON, PERIOD, N_KNOTS = 2.0, 0.01, 11  # s, s
STARTS, GENERATIONS = 6, 150
NEAR = 0.05  # m, of contact that counts as much as twice a limit


def dodge(scene: Scene, since: float = 0.0, seed: int = 0) -> Record | None:
    """A movement that stands until `since` [s] and touches nothing within `HORIZON`; None where none was found."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(HORIZON / PERIOD) + 1) * PERIOD
    around = scene.centers + scene.offsets(time), scene.obstacle_sags(time)
    axes = [0, 1, 5] if scene.n_dims == 2 else list(range(6))
    scale = scene.speed_limit * np.where(np.array(axes) < 3, 1.0, 5.0)
    for _ in range(STARTS):
        search = CMAES(np.zeros((N_KNOTS - 1) * len(axes)), 0.5, rng)
        for _ in range(GENERATIONS):
            values = []
            for sample in search.ask():
                record = moved(scene, time, sample.reshape(-1, len(axes)) * scale, axes, around, since)
                report = judge(record)
                excess = max(
                    report.speed_max / scene.speed_limit, report.acceleration_max / scene.acceleration_limit
                )
                values.append(max(0.0, excess - 1.0) + max(0.0, -report.clearance_min / NEAR))
                if values[-1] == 0.0:
                    return record
            search.tell(np.array(values))
    return None


def moved(
    scene: Scene, time: np.ndarray, knots: np.ndarray, axes: list[int], around: tuple, since: float
) -> Record:
    """The record of a load with given twists, array of shape (N_KNOTS - 1, n_axes), after rest until `since`."""
    poses, n = poses_of(scene, "start"), len(time)
    at, given = np.linspace(since, time[-1], N_KNOTS), np.vstack([np.zeros(len(axes)), knots])
    twists = np.zeros((n, 1, 6))
    for k, axis in enumerate(axes):
        twists[:, 0, axis] = np.interp(time, at, given[:, k])
    center, quaternion = np.zeros((n, 1, 3)), np.zeros((n, 1, 4))
    for k in range(n):
        center[k], quaternion[k] = poses.center, poses.quaternion
        poses = advanced(poses, twists[k], PERIOD)
    return Record(scene, time, center, quaternion, *around)
