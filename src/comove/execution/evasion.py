"""Evasion while there is no plan: the most promising of many random courses.

A course is a twist for every moment up to a short horizon, approached from the present velocity as fast as the
acceleration limit allows (a dynamic window: Fox, Burgard and Thrun, 1997), among obstacles that move as expected.
Some courses have one twist throughout, others change to another one on the way, and the best of them is varied; the
course of a moment ago is among them. A clearance of more than `SAFE` is worth no more than `SAFE`; among safe courses
the one is taken that comes nearest to the goal and also leaves some distance to moving obstacles, as these may turn.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from comove.geometry.distances import inflated
from comove.geometry.rotations import exponential, matrices, quaternion_product
from comove.planning.objective import Objective
from comove.reaction.twists import HandPoses, hand_velocities, twists_between
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

MOMENT, N_MOMENTS = 0.1, 15  # s, and how many of them are looked ahead
N_DRAWN, N_VARIED = 60, 30  # courses drawn, and variations of the best
SPREADS = (0.4, 0.2, 0.1)  # of random twists, by which the best is varied in turn
TO_GOAL = 2  # course that goes there
SAFE = 0.01  # m of clearance, beyond which more is no better, and an objective looks no farther
UNSAFE = 100.0  # m of way to the goal that a metre of clearance below `SAFE` outweighs
ROOM = 0.15  # m of clearance to moving obstacles beyond which more is no better
CRAMPED = 5.0  # m of way to the goal that a metre short of it outweighs
TURNING = 0.2  # m of way to the goal that it must be worth to turn off


def evasive_course(
    objective: Objective,
    poses: HandPoses,
    twists: Array,
    goal: HandPoses,
    offsets: Array,
    rng: np.random.Generator,
    before: Array | None = None,
) -> Array | None:
    """Return the most promising course; array, shape (N_MOMENTS, n_groups, 6) [m/s, rad/s].

    None means that the course straight to the goal is the best.

    Parameters
    ----------
    objective : objective of the scene as it is expected to be
    poses, twists : present poses and twists of the rigid groups
    goal : poses at the goal
    offsets : array, shape (N_MOMENTS + 1, n_rows, 3), offsets of the obstacles' rows at the ends of the moments [m]
    before : the course of a moment ago
    """
    scene, hands = objective.scene, _hands(objective.scene, poses)
    n_hands = len(scene.manipulators)
    wider = replace(scene, obstacles=inflated(scene.obstacles, ROOM * scene.moving[scene.owners]))
    roomy = replace(objective, scene=wider)

    def worth(courses: Array) -> Array:
        nodes = _followed(scene, poses, twists, courses, hands)
        spare = np.minimum(objective.evaluate_nodes(nodes, offsets).clearance - scene.clearance, SAFE)
        room = np.clip(roomy.evaluate_nodes(nodes, offsets).clearance - scene.clearance, -ROOM, 0.0)
        away = np.linalg.norm(nodes[:, -1, :n_hands, : scene.n_dims] - scene.goal, axis=2).max(axis=1)
        turning = (courses != courses[:, :1]).any(axis=(1, 2, 3))
        return UNSAFE * spare + CRAMPED * room - away - TURNING * turning

    courses = _drawn(scene, poses, twists, goal, hands, rng)
    if before is not None:
        courses = np.concatenate([courses, np.concatenate([before[1:], before[-1:]])[None]])
    values = worth(courses)
    best = int(np.argmax(values))
    course, value = courses[best], values[best]
    if best == TO_GOAL:
        return None
    for spread in SPREADS:  # look closer
        varied = course + spread * _turning(_random(scene, hands, N_VARIED, rng), rng)
        varied = _limited(varied, hands, scene.speed_limit)
        values = worth(varied)
        if values.max() > value:
            course, value = varied[np.argmax(values)], values.max()
    return course


def prospect() -> Array:
    """Return the ends of the moments up to the horizon, from now on [s]; array, shape (N_MOMENTS + 1,)."""
    return MOMENT * np.arange(N_MOMENTS + 1)


def _drawn(
    scene: Scene, poses: HandPoses, twists: Array, goal: HandPoses, hands: Array, rng: np.random.Generator
) -> Array:
    """Return courses: to stand still, to go on, to go to the goal, and random ones.

    Array, shape (N_DRAWN, N_MOMENTS, n_groups, 6) [m/s, rad/s].
    """
    drawn = _random(scene, hands, N_DRAWN, rng)
    drawn[0], drawn[1] = 0.0, twists
    drawn[TO_GOAL] = twists_between(scene, poses, goal, MOMENT * N_MOMENTS)
    drawn = _limited(drawn, hands, min(scene.speed_limit, 1.0))
    courses = np.repeat(drawn[:, None], N_MOMENTS, axis=1)
    half = N_DRAWN // 2
    courses[half:] = _turning(drawn[half:], rng)
    return courses


def _random(scene: Scene, hands: Array, n: int, rng: np.random.Generator) -> Array:
    """Return random twists that the load can perform, array, shape (n, n_groups, 6).

    The fastest hand moves at 0.3 to 1 times its speed limit, or 1 m/s if the limit is higher.
    """
    drawn = rng.standard_normal((n, len(scene.groups), 6))
    for g, group in enumerate(scene.groups):
        drawn[:, g, 3:] /= max(group.reach, 1e-3)
        fixed = {"none": [3, 4, 5], "fixed": [3, 4, 5], "plane": [3, 4], "vertical": [3, 4]}
        drawn[:, g, fixed.get(group.orientation, [])] = 0.0
    drawn[:, :, scene.n_dims : 3] = 0.0
    wanted = min(scene.speed_limit, 1.0) * rng.uniform(0.3, 1.0, n)
    return drawn * (wanted / np.maximum(_speeds(hands, drawn), 1e-9))[:, None, None]


def _turning(drawn: Array, rng: np.random.Generator) -> Array:
    """Return courses that change from each twist to another one at a random moment; (n, N_MOMENTS, n_groups, 6)."""
    moment = rng.integers(1, N_MOMENTS // 2 + 3, len(drawn))
    turned = np.arange(N_MOMENTS) >= moment[:, None]
    return np.where(turned[:, :, None, None], rng.permutation(drawn)[:, None], drawn[:, None])


def _limited(twists: Array, hands: Array, limit: float) -> Array:
    """Return twists, slowed down where a hand would be faster than the limit [m/s]; any shape (..., n_groups, 6)."""
    return twists * np.minimum(1.0, limit / np.maximum(_speeds(hands, twists), 1e-9))[..., None, None]


def _followed(scene: Scene, poses: HandPoses, twists: Array, courses: Array, hands: Array) -> Array:
    """Return the nodes along courses, at the ends of the moments; (n_courses, N_MOMENTS + 1, n_nodes, 3) [m]."""
    velocity = np.zeros((len(courses), N_MOMENTS + 1, *twists.shape))
    way = np.zeros_like(velocity)
    velocity[:, 0] = twists
    for k in range(N_MOMENTS):
        change = courses[:, k] - velocity[:, k]
        needed = np.maximum(_speeds(hands, change) / scene.acceleration_limit, 1e-9)  # to get there [s]
        share = np.minimum(1.0, MOMENT / needed)[:, None, None]
        gained = MOMENT - 0.5 * np.minimum(needed, MOMENT)[:, None, None]
        velocity[:, k + 1] = velocity[:, k] + share * change
        way[:, k + 1] = way[:, k] + MOMENT * velocity[:, k] + gained * share * change
    nodes = np.zeros((*way.shape[:2], scene.body.n_nodes, 3))
    turns = quaternion_product(exponential(way[..., 3:]), poses.quaternion)
    for g, own in enumerate(scene.nodes_of_groups):
        placed = np.einsum("ktij,nj->ktni", matrices(turns[:, :, g]), scene.groups[g].points)
        nodes[:, :, own] = poses.center[g] + way[:, :, g, None, :3] + placed
    return nodes


def _hands(scene: Scene, poses: HandPoses) -> Array:
    """Return the linear map from twists to velocities of the hands; array, shape (n_hands, 3, n_groups, 6)."""
    n_groups = len(scene.groups)
    of_each = [hand_velocities(scene, poses, row.reshape(n_groups, 6)) for row in np.eye(6 * n_groups)]
    return np.moveaxis(np.array(of_each), 0, -1).reshape(-1, 3, n_groups, 6)


def _speeds(hands: Array, twists: Array) -> Array:
    """Return the speed of the fastest hand [m/s]; `twists` of any shape (..., n_groups, 6)."""
    return np.linalg.norm(np.einsum("hdgk,...gk->...hd", hands, twists), axis=-1).max(axis=-1)
