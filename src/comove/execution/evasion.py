"""Where to go while there is no plan: the twist with the best prospects among many drawn.

Every candidate is followed for a while from the present velocity on, as fast as the acceleration limit lets it be
reached, among obstacles that move as expected (the dynamic window: Fox, Burgard and Thrun, 1997); half of them turn
off to another twist on the way. What stays clear by `SAFE` is as good as what stays clear by more; among the safe the
one that comes nearest to the goal is taken.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from comove.planning.objective import Objective
from comove.primitives.rotations import exponential, matrices, quaternion_product
from comove.reaction.twists import Poses, hand_velocities, twists_between
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

N_CANDIDATES = 80
TO_GOAL = 2  # candidate that goes there
PROSPECT, N_STEPS = 1.2, 13  # s that are looked ahead, and instants in it
SAFE = 0.03  # m of clearance, beyond which more is no better
UNSAFE = 100.0  # m of way to the goal that a metre of clearance below `SAFE` outweighs
TURNING = 0.2  # m of way to the goal that it must be worth to turn off


def evasive_twists(
    objective: Objective, poses: Poses, twists: Array, goal: Poses, offsets: Array, rng: np.random.Generator
) -> Array | None:
    """The twists with the best prospects; array, shape (n_groups, 6) [m/s, rad/s]; None for the way to the goal.

    Parameters
    ----------
    objective : of the scene as it is expected to be
    poses, twists : of now
    goal : poses
    offsets : array, shape (N_STEPS, n_rows, 3), of the obstacles' rows at even times of the prospect [m]
    """
    scene = objective.scene
    candidates = _candidates(scene, poses, twists, goal, rng)
    turning = np.arange(N_CANDIDATES) >= N_CANDIDATES // 2
    after = np.where(turning[:, None, None], rng.permutation(candidates), candidates)
    nodes = _followed(scene, poses, twists, candidates, after, rng.uniform(0.1, 0.7, N_CANDIDATES) * PROSPECT)
    spare = np.minimum(objective.evaluate_nodes(nodes, offsets).clearance - scene.clearance, SAFE)
    n_hands = len(scene.manipulators)
    away = np.linalg.norm(nodes[:, -1, :n_hands, : scene.n_dims] - scene.goal, axis=2).max(axis=1)
    best = int(np.argmax(UNSAFE * spare - away - TURNING * turning))
    return None if best == TO_GOAL else candidates[best]


def prospect() -> Array:
    """The instants that are looked at, from now on [s]; array, shape (N_STEPS,)."""
    return np.linspace(0.0, PROSPECT, N_STEPS)


def _candidates(scene: Scene, poses: Poses, twists: Array, goal: Poses, rng: np.random.Generator) -> Array:
    """To stand still, to go on, to go to the goal, and what is drawn; array, shape (N_CANDIDATES, n_groups, 6)."""
    drawn = rng.standard_normal((N_CANDIDATES, len(scene.groups), 6))
    for g, group in enumerate(scene.groups):
        drawn[:, g, 3:] /= max(group.reach, 1e-3)
        fixed = {"none": [3, 4, 5], "fixed": [3, 4, 5], "plane": [3, 4], "vertical": [3, 4]}
        drawn[:, g, fixed.get(group.orientation, [])] = 0.0
    drawn[:, :, scene.n_dims : 3] = 0.0
    drawn[0], drawn[1], drawn[TO_GOAL] = 0.0, twists, twists_between(scene, poses, goal, PROSPECT)
    fastest = np.maximum(_speeds(scene, poses, drawn), 1e-9)
    wanted = min(scene.speed_limit, 1.0) * rng.uniform(0.3, 1.0, N_CANDIDATES)
    wanted[: TO_GOAL + 1] = np.minimum(wanted, fastest)[: TO_GOAL + 1]
    return drawn * (wanted / fastest)[:, None, None]


def _followed(scene: Scene, poses: Poses, twists: Array, first: Array, after: Array, turn: Array) -> Array:
    """Nodes of those who go over to `first`, at `turn` [s] to `after`; (n_candidates, N_STEPS, n_nodes, 3) [m]."""
    way = (
        prospect()[:, None, None] * twists
        + _gained(scene, poses, first - twists, np.zeros(len(first)))
        + _gained(scene, poses, after - first, turn)
    )
    nodes = np.zeros((*way.shape[:2], scene.body.n_nodes, 3))
    turns = quaternion_product(exponential(way[..., 3:]), poses.quaternion)
    for g, own in enumerate(scene.nodes_of_groups):
        placed = np.einsum("ktij,nj->ktni", matrices(turns[:, :, g]), scene.groups[g].points)
        nodes[:, :, own] = poses.center[g] + way[:, :, g, None, :3] + placed
    return nodes


def _gained(scene: Scene, poses: Poses, change: Array, begins: Array) -> Array:
    """The way that a change of twists adds, as fast as it may come; (n_candidates, N_STEPS, n_groups, 6) [m, rad]."""
    time = np.maximum(prospect() - begins[:, None], 0.0)
    needed = _speeds(scene, poses, change)[:, None] / scene.acceleration_limit  # to get there [s]
    along = np.where(time < needed, 0.5 * time**2 / np.maximum(needed, 1e-9), time - 0.5 * needed)
    return along[:, :, None, None] * change[:, None]


def _speeds(scene: Scene, poses: Poses, twists: Array) -> Array:
    """Of the fastest hand, for each of several twists, (n, n_groups, 6); array, shape (n,) [m/s]."""
    return np.array([np.linalg.norm(hand_velocities(scene, poses, x), axis=1).max() for x in twists])
