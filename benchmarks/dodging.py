"""Existence of evasive motions: a search for any contact-free movement.

It continues an execution at some instant, knows how everything will move, and need not reach a goal. It shares
nothing with planner and executor: CMA-ES over the payload's twist at a few instants, linear in between, verified as
executions are.
"""

from __future__ import annotations

import numpy as np

from comove.control.safety.twists import advanced, twists_between
from comove.model.coordinates import HandPoses
from comove.optim import CMAES
from comove.verification.record import Record, verify_execution

HORIZON, PERIOD, N_KNOTS = 2.0, 0.01, 11  # s, s, both ends counted
STARTS, GENERATIONS = 6, 150
NEAR = 0.05  # m, of contact that counts as much as twice a limit


def dodge(record: Record, since: float, seed: int = 0) -> Record | None:
    """Return a contact-free continuation for `HORIZON`, or None. Up to the instant `since` [s] it is as recorded.

    Parameters
    ----------
    record : of steps of `PERIOD`, of one body
    """
    scene, rng, k = record.scene, np.random.default_rng(seed), round(since / PERIOD)
    time = np.arange(k + round(HORIZON / PERIOD) + 1) * PERIOD
    around = scene.centers + scene.offsets(time), scene.obstacle_sagittas(time)
    axes = [0, 1, 5] if scene.n_dims == 2 else list(range(6))
    scale = scene.speed_limit * np.where(np.array(axes) < 3, 1.0, 5.0)
    for _ in range(STARTS):
        search = CMAES(np.zeros((N_KNOTS - 1) * len(axes)), 0.5, rng)
        for _ in range(GENERATIONS):
            values = []
            for sample in search.ask():
                found = gone_on(record, k, time, sample.reshape(-1, len(axes)) * scale, axes, around)
                report = verify_execution(found)
                excess = max(
                    report.speed_max / scene.speed_limit, report.acceleration_max / scene.acceleration_limit
                )
                values.append(max(0.0, excess - 1.0) + max(0.0, -report.clearance_min / NEAR))
                if values[-1] == 0.0:
                    return found
            search.tell(np.array(values))
    return None


def gone_on(
    record: Record, k: int, time: np.ndarray, knots: np.ndarray, axes: list[int], around: tuple
) -> Record:
    """Return a record continued after step k with given twists. They are an array of shape (N_KNOTS - 1, n_axes)."""
    n, before = len(time), HandPoses(record.center[max(k - 1, 0)], record.quaternion[max(k - 1, 0)])
    poses = HandPoses(record.center[k], record.quaternion[k])
    at, now = np.linspace(time[k], time[-1], N_KNOTS), twists_between(record.scene, before, poses, PERIOD)
    twists = np.zeros((n, 1, 6))
    for i, axis in enumerate(axes):
        twists[:, 0, axis] = np.interp(time, at, [now[0, axis], *knots[:, i]])
    center, quaternion = np.zeros((n, 1, 3)), np.zeros((n, 1, 4))
    center[:k], quaternion[:k] = record.center[:k], record.quaternion[:k]
    for step in range(k, n):
        center[step], quaternion[step] = poses.center, poses.quaternion
        poses = advanced(poses, twists[step], PERIOD)
    return Record(record.scene, time, center, quaternion, *around)


def news(record: Record, delay: float) -> float:
    """Return when the first touched motion could be known [s]. It is `delay` [s] late."""
    scene = record.scene
    for time, nodes in zip(record.time, record.nodes, strict=True):
        clearance, name = scene.clearance_at(nodes, time)
        if clearance < 0.0:
            break
    touched = [
        motion for j, motion in enumerate(scene.motions) if motion is not None and scene.name_of(j) == name
    ]
    kinks = [kink for motion in touched for kink in motion.kinks if kink + delay < time]
    return max(kinks, default=0.0) + delay
