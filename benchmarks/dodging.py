"""Could anybody have dodged? A search for any movement that keeps the limits and touches nothing for a while.

It goes on from where an execution was at some instant, knows how everything will move, and need not get anywhere. It
shares nothing with planner and executor: targets of the load's twist, which change once or twice, are approached as
fast as the limits of the hands allow; the best ones are varied, generation by generation, and what is found is judged
as executions are.
"""

from __future__ import annotations

import numpy as np

from comove.control.safety.twists import advanced, twists_between
from comove.geometry.rotations import exponential, matrices, quaternion_product
from comove.model.coordinates import HandPoses, load_coordinates
from comove.planning.objective import Objective
from comove.verification.record import Record, verify_execution

HORIZON, PERIOD, N_MOMENTS = 2.0, 0.01, 20  # s, s, moments in which targets may change
N_FIRST, N_GENERATIONS, N_DRAWN, N_KEPT = 1000, 15, 400, 40
CLEAR = 0.02  # m, of clearance with which the search is content
KEPT = 0.95, 0.99  # of the speed, as held turns make hands faster, and of the acceleration
STOPPING = 0.4  # s, at the end, as a record is verified from rest to rest


def dodge(record: Record, since: float, seed: int = 0) -> Record | None:
    """What touches nothing until `HORIZON` after an instant [s], up to which it is as recorded; None if not found.

    Parameters
    ----------
    record : of steps of `PERIOD`, of one body
    """
    scene, rng, k = record.scene, np.random.default_rng(seed), round(since / PERIOD)
    n_steps = round(HORIZON / PERIOD)
    time = np.arange(k + n_steps + 1, dtype=np.float64) * PERIOD
    objective = Objective(scene, load_coordinates(scene)).with_penalty(margin=CLEAR)
    moved = scene.displacements(time[k::5])
    axes = [0, 1, 5] if scene.n_dims == 2 else list(range(6))

    def drawn(n: int) -> np.ndarray:
        first, later = np.zeros((2, n, 6))
        for targets in (first, later):
            targets[:, axes] = rng.standard_normal((n, len(axes)))
            targets[:, :3] *= scene.speed_limit
            targets[:, 3:] *= scene.speed_limit / np.linalg.norm(scene.groups[0].points, axis=1).max()
        turned = np.arange(N_MOMENTS) >= rng.integers(0, N_MOMENTS, n)[:, None]
        return np.where(turned[:, :, None], later[:, None], first[:, None])

    targets, values = np.zeros((0, N_MOMENTS, 6)), np.zeros(0)
    for generation in range(N_GENERATIONS + 1):
        more = drawn(N_DRAWN if generation else N_FIRST)
        if generation:
            share = rng.uniform(0.05, 0.6, (N_DRAWN, 1, 1))
            more = targets[rng.integers(0, len(targets), N_DRAWN)] + share * more
        nodes, _ = gone_on(record, k, more)
        found = objective.evaluate_nodes(np.ascontiguousarray(nodes[:, ::5]), moved).clearance
        targets, values = np.concatenate([targets, more]), np.concatenate([values, found])
        best = np.argsort(-values, kind="stable")[:N_KEPT]
        targets, values = targets[best], values[best]
        if values[0] >= CLEAR:
            break
    for some in targets[values > 0.0]:
        _, twists = gone_on(record, k, some[None])
        went = _recorded(record, k, time, twists[0])
        report = verify_execution(went)
        limits = report.speed_max / scene.speed_limit, report.acceleration_max / scene.acceleration_limit
        if report.clearance_min >= 0.0 and max(limits) <= 1.0 + 1e-9:
            return went
    return None


def gone_on(record: Record, k: int, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and twists of a load that goes on after step k towards given twists, within the limits of the hands.

    Parameters
    ----------
    targets : array, shape (n, N_MOMENTS, 6)

    Returns
    -------
    nodes : array, shape (n, n_steps + 1, n_nodes, 3) [m]
    twists : array, shape (n, n_steps, 6)
    """
    scene, n, n_steps = record.scene, len(targets), round(HORIZON / PERIOD)
    n_hands, point = len(scene.manipulators), scene.groups[0].points
    before, now = (HandPoses(record.center[i], record.quaternion[i]) for i in (max(k - 1, 0), k))
    twist = np.repeat(twists_between(scene, before, now, PERIOD), n, axis=0)
    center, quaternion = np.repeat(now.center, n, axis=0), np.repeat(now.quaternion, n, axis=0)
    nodes, twists = np.zeros((n, n_steps + 1, len(point), 3)), np.zeros((n, n_steps, 6))
    held = np.repeat(record.nodes[k][None], n, axis=0)
    last = np.repeat((held[:1] - record.nodes[max(k - 1, 0)])[:, :n_hands] / PERIOD, n, axis=0)
    nodes[:, 0] = held
    fastest, change = KEPT[0] * scene.speed_limit, KEPT[1] * scene.acceleration_limit * PERIOD
    for step in range(n_steps):
        target = targets[:, step * N_MOMENTS // n_steps] * (step * PERIOD < HORIZON - STOPPING)
        aim = _of_hands(target, held[:, :n_hands] - center[:, None], twist)
        share = np.minimum(1.0, fastest / np.maximum(np.linalg.norm(aim, axis=2).max(axis=1), 1e-9))
        target, aim = share[:, None] * target, share[:, None, None] * aim
        # The largest share s of the way to it of which |now + s (aim - now) - last| <= change, for every hand.
        here = _of_hands(twist, held[:, :n_hands] - center[:, None], twist)
        a, b = aim - here, here - last
        aa, ab, bb = (a * a).sum(axis=2), (a * b).sum(axis=2), (b * b).sum(axis=2) - change**2
        root = np.sqrt(np.maximum(ab**2 - aa * bb, 0.0))
        share = np.clip((root - ab) / np.maximum(aa, 1e-12), 0.0, 1.0).min(axis=1)[:, None]
        twist = twist + share * (target - twist)
        center = center + PERIOD * twist[:, :3]
        quaternion = quaternion_product(exponential(PERIOD * twist[:, 3:]), quaternion)
        placed = center[:, None] + np.einsum("nij,kj->nki", matrices(quaternion), point)
        last, held = (placed - held)[:, :n_hands] / PERIOD, placed
        nodes[:, step + 1], twists[:, step] = placed, twist
    return nodes, twists


def _of_hands(twist: np.ndarray, arms: np.ndarray, turning: np.ndarray) -> np.ndarray:
    """Average velocities of hands at `arms` (n, n_hands, 3) [m] over the next step, which bends by half a turn."""
    arms = arms + 0.5 * PERIOD * np.cross(turning[:, None, 3:], arms)
    return twist[:, None, :3] + np.cross(twist[:, None, 3:], arms)


def _recorded(record: Record, k: int, time: np.ndarray, twists: np.ndarray) -> Record:
    """The record that goes on after step k with given twists, array of shape (n_steps, 6)."""
    scene, poses = record.scene, HandPoses(record.center[k], record.quaternion[k])
    center, quaternion = [*record.center[:k], poses.center], [*record.quaternion[:k], poses.quaternion]
    for twist in twists:
        poses = advanced(poses, twist[None], PERIOD)
        center.append(poses.center)
        quaternion.append(poses.quaternion)
    around = scene.centers + scene.offsets(time), scene.obstacle_sagittas(time)
    return Record(scene, time, np.array(center), np.array(quaternion), *around)


def news(record: Record, delay: float) -> float:
    """When one could first know, `delay` [s] late, of the motion that was touched first; that instant [s]."""
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
