"""Variety of episodes: ends, paths, and sides of passing obstacles."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from comove.arrays import Array, Integers
from comove.geometry.homotopy import crossings, word_text
from comove.model.motion import CoordinatedMotion

N_WORD, N_PATH = 401, 33
"""Samples of a path for its class, and for its distance from others."""
PAIRS, SEED = 100_000, 0
"""Pairs of episodes that are compared, drawn with this seed where there are more."""


@dataclass(frozen=True)
class Variety:
    """Variety of episodes.

    Attributes
    ----------
    starts, goals : mean distance between two episodes' starts, and goals, of the end effectors' centre [m]
    paths : mean distance between the paths of two episodes, each the root mean square over equal shares of the
        duration, of the end effectors' centre [m]
    shapes : the same of the paths less the straight lines from start to goal [m]
    classes : number of episodes by class: the obstacles that are passed below or above
    entropy : entropy of the classes [bit]; 0 if all are of one class, 1 for two that are equally frequent
    """

    starts: float
    goals: float
    paths: float
    shapes: float
    classes: dict[str, int]
    entropy: float


def center_path(motion: CoordinatedMotion, n_steps: int) -> Array:
    """Return the end effectors' centre at equal shares of the duration. Array, shape (n_steps, n_dims) [m]."""
    return motion.hands(np.linspace(0.0, 1.0, n_steps))[0].mean(axis=1)


def passing_class(motion: CoordinatedMotion) -> str:
    """Return the class of a motion among the obstacles.

    It lists the obstacles whose upward rays the end effectors' centre crosses, in order. In the plane this is the
    homotopy class among the obstacles' centres. In space the motion is projected from above and, after a bar, from
    the side; moving obstacles count where they are at the time.
    """
    scene, path = motion.scene, center_path(motion, N_WORD)
    if not len(scene.file.obstacles):
        return ""
    centers = scene.centers_at(np.linspace(0.0, scene.duration, N_WORD))
    views = ((0, 1),) if scene.n_dims == 2 else ((0, 1), (0, 2))
    return " | ".join(word_text(crossings(path[:, view], centers[..., view])) for view in map(list, views))


def variety(paths: Array, classes: Mapping[str, int]) -> Variety:
    """Return the variety of episodes.

    Parameters
    ----------
    paths : array, shape (n_episodes, n_steps, n_dims), the `center_path` of all episodes or some [m]
    classes : number of episodes by class
    """
    first, second = _pairs(len(paths))
    straight = paths[:, :1] + np.linspace(0.0, 1.0, paths.shape[1])[:, None] * (paths[:, -1:] - paths[:, :1])

    def mean(values: Array) -> float:
        """Return pairs' mean RMS distance in (n_episodes, n_steps, n_dims) values."""
        apart = ((values[first] - values[second]) ** 2).sum(axis=2).mean(axis=1)
        return float(np.sqrt(apart).mean()) if len(first) else 0.0

    shares = [count / sum(classes.values()) for count in classes.values()]
    return Variety(
        starts=mean(paths[:, :1]),
        goals=mean(paths[:, -1:]),
        paths=mean(paths),
        shapes=mean(paths - straight),
        classes=dict(sorted(classes.items(), key=lambda item: (-item[1], item[0]))),
        entropy=abs(math.fsum(share * math.log2(share) for share in shares)),
    )


def _pairs(count: int) -> tuple[Integers, Integers]:
    """Return the numbers of two episodes, for all pairs. Where there are too many, return a random sample."""
    if count * (count - 1) // 2 <= PAIRS:
        first, second = np.triu_indices(count, 1)
        return first, second
    rng = np.random.default_rng(SEED)
    first = rng.integers(count, size=PAIRS)
    return first, (first + rng.integers(1, count, size=PAIRS)) % count
