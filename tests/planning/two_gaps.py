"""Scenes with two walls whose gaps lie apart, and simple movements of which none gets through alone."""

import numpy as np

from comove.dmp import DMP
from comove.dmp.demonstrations import Demonstration
from comove.model import Scene


def two_gaps(gap=0.16, bar=None, upper=0.7, lower=0.3):
    """One hand, or two that carry a bar, past a gap on top and one below."""

    def wall(x, y):
        low, high = y - gap / 2, 1 - (y + gap / 2)
        return [
            {"shape": "box", "center": [x, low / 2], "size": [0.06, low]},
            {"shape": "box", "center": [x, 1 - high / 2], "size": [0.06, high]},
        ]

    half = 0.0 if bar is None else bar / 2
    hands = {"hand": 0.5} if bar is None else {"left": 0.5 - half, "right": 0.5 + half}
    data = {
        "name": "two-gaps",
        "duration": 5.0,
        "workspace": {"lower": [0, 0], "upper": [1, 1]},
        "obstacles": wall(0.35, upper) + wall(0.65, lower),
        "manipulators": [{"name": n, "start": [0.1, y], "goal": [0.9, y]} for n, y in hands.items()],
        "limits": {"speed": 3.0},
    }
    if bar is not None:
        data["load"] = {"shape": "bar", "length": bar}
    return Scene.from_dict(data)


def bump(middle, height=0.3):
    """A movement to the right with a bump to the left of its way."""
    t = np.linspace(0, 1, 201)
    s = t**3 * (10 - 15 * t + 6 * t**2)
    bell = np.exp(-0.5 * ((s - middle) / 0.12) ** 2)
    bell = bell - bell[0] * (1 - s) - bell[-1] * s
    return DMP.fit(Demonstration(3 * t, np.stack([s, height * bell], axis=1)))


def bumps():
    return {"early": bump(0.3), "middle": bump(0.5), "late": bump(0.7)}
