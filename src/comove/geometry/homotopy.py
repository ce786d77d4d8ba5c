"""Homotopy classes of paths among points in the plane.

Paths of one class can be deformed into each other without touching a point. From every point a ray goes up. A path is
a word: the rays that it crosses, in order, with the direction; a crossing that is undone at once is left out. Two
paths between the same ends can be deformed into each other without touching a point if and only if their words are
equal (the fundamental group of the plane without points is free).
"""

from __future__ import annotations

import numpy as np

from comove.arrays import Array


def crossings(path: Array, points: Array) -> tuple[tuple[int, int], ...]:
    """Return the word of a path: rays crossed, and directions. A direction of 1 is towards +x.

    Parameters
    ----------
    path : array, shape (n_steps, 2), along which the path goes straight
    points : array, shape (n_points, 2) or, for points that move, (n_steps, n_points, 2)
    """
    apart = path[:, None] - np.broadcast_to(points, (len(path), *np.shape(points)[-2:]))
    right = apart[..., 0] >= 0.0
    steps, which = np.nonzero(right[1:] != right[:-1])
    before, after = apart[steps, which], apart[steps + 1, which]
    share = before[:, 0] / (before[:, 0] - after[:, 0])
    above = before[:, 1] + share * (after[:, 1] - before[:, 1]) > 0.0
    order = np.lexsort((which, share, steps))
    word: list[tuple[int, int]] = []
    for k in order[above[order]]:
        letter = (int(which[k]), 1 if right[steps[k] + 1, which[k]] else -1)
        if word and word[-1] == (letter[0], -letter[1]):
            word.pop()
        else:
            word.append(letter)
    return tuple(word)


def word_text(word: tuple[tuple[int, int], ...]) -> str:
    """Return a word as text, such as ``0+ 2-``.

    >>> word_text(((0, 1), (2, -1)))
    '0+ 2-'
    """
    return " ".join(f"{point}{'+' if direction > 0 else '-'}" for point, direction in word)
