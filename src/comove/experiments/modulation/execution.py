"""Execution as in the paper (III-B): the hands' coordinated primitive, its velocities turned by modulation matrices.

Each hand follows the primitive from start to goal and is drawn back to it once an obstacle has passed; the hands'
distances are kept only as far as their velocities are equal. It serves for comparison with `Executor`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from comove.coordination.motion import CoordinatedMotion
from comove.execution.observers import Observer
from comove.experiments.modulation.matrices import Modulation, Sharing, modulated
from comove.experiments.modulation.obstacles import level_obstacle
from comove.geometry.distances import CENTER
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

DRAWN = 2.0  # 1/s, gain towards the primitive, and after its end the goal
N_POINTS = 13  # along every edge of the load, that count for which hand or point is nearest
AT_GOAL = 5e-4  # m


def run_modulated(
    scene: Scene,
    observer: Observer,
    sharing: Sharing,
    budget: float,
    period: float = 0.01,
    modulation: Modulation | None = None,
    *,
    load: bool = True,
) -> tuple[Array, Array]:
    """Follow the primitive with modulated velocities, and return the positions of the hands.

    Parameters
    ----------
    observer : observer of the obstacles
    sharing : assignment of modulation matrices to points; `Sharing.NONE` follows the primitive as it is
    budget : largest simulated time [s]
    load : whether points of the load are modulated as well, not the hands alone

    Returns
    -------
    time : array, shape (n_steps,) [s]
    hands : array, shape (n_steps, n_hands, n_dims) [m]
    """
    n, modulation = scene.n_dims, modulation or Modulation()
    radius = float(scene.body.radii.max(initial=0.0)) + scene.clearance
    bare = [level_obstacle(scene, j, margin=radius) for j in range(len(scene.motions))]
    pairs = [e for e in scene.body.edges if e[0] != e[1] and e.max() < len(scene.manipulators)]
    motion, hands, steps = CoordinatedMotion.straight(scene), scene.start.copy(), [scene.start.copy()]
    for k in range(round(budget / period)):
        now = k * period
        s = np.array([now / scene.duration])
        target, slope = motion.hands(s)[:2, 0] if s[0] < 1.0 else (scene.goal, np.zeros_like(hands))
        wanted = slope / scene.duration + DRAWN * (target - hands)
        fastest = np.linalg.norm(wanted, axis=1).max()
        wanted = wanted * min(1.0, scene.speed_limit / max(fastest, 1e-12))
        seen = observer.observe(now)
        around = [
            replace(o, center=tuple(row[CENTER : CENTER + n]), velocity=tuple(v[:n]))
            for o, row, v in zip(bare, seen.table, seen.velocity, strict=True)
        ]
        points, velocities = hands, wanted
        for a, b in pairs if load else ():
            share = np.linspace(0.0, 1.0, N_POINTS)[1:-1, None]
            points = np.concatenate([points, hands[a] + share * (hands[b] - hands[a])])
            velocities = np.concatenate([velocities, wanted[a] + share * (wanted[b] - wanted[a])])
        allowed = modulated(points, velocities, around, sharing=sharing, modulation=modulation)
        hands = hands + period * allowed[: len(hands)]
        steps.append(hands)
        if now > scene.duration and np.linalg.norm(hands - scene.goal, axis=1).max() < AT_GOAL:
            break
    return np.arange(len(steps)) * period, np.array(steps)
