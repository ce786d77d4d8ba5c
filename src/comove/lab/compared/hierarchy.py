"""Lexicographic quadratic programmes of tasks under common inequalities.

    level k = 1, 2, ..:   minimise |A_k x - b_k|^2   such that   G x >= h   and   A_j x = A_j x_j for j < k,

where x_j is the solution of level j. The equalities hold by writing x = x_j + N z, where N spans the null space of
all former tasks, so that every level is a smaller programme (Escande et al., 2014, solve the same in one sweep).
Where G x >= h has no solution, h is first reduced by the slack of least sum of squares.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import daqp
import numpy as np

from comove.arrays import Array
from comove.planning.convex.quadratic import FREE

REGULAR = 1e-7  # added to the quadratic form: keeps small what a task does not determine
RANK = 1e-9  # singular values below this share of the largest count as zero
TOLERANCE = 1e-10  # of rows, in the solver
SPARE = 1e-9  # by which bounds are relaxed from one level to the next, for rounding


class PriorityTask(NamedTuple):
    """Task to minimise |A x - b|^2.

    Attributes
    ----------
    matrix : array, shape (n_rows, n), A
    target : array, shape (n_rows,), b
    """

    matrix: Array
    target: Array


def lexicographic(tasks: Sequence[PriorityTask], rows: Array, low: Array) -> tuple[Array, float]:
    """Solve tasks in the order of their priority.

    Parameters
    ----------
    rows, low : arrays, shapes (n_rows, n) and (n_rows,), G and h of the inequalities G x >= h

    Returns
    -------
    x : array, shape (n,)
    slack : largest amount by which an inequality had to be relaxed
    """
    n = rows.shape[1]
    slack = _least_slack(rows, low)
    low = low - slack - SPARE * (slack > 0.0)
    x, free = np.zeros(n), np.eye(n)
    for number, (matrix, target) in enumerate(tasks):
        if free.shape[1] == 0:
            break
        reduced = matrix @ free
        z = _solve(reduced, target - matrix @ x, rows @ free, low - rows @ x - (SPARE if number else 0.0))
        if z is not None:
            x = x + free @ z
        free = free @ _null_space(reduced)
    return x, float(slack.max(initial=0.0))


def _solve(matrix: Array, target: Array, rows: Array, low: Array) -> Array | None:
    """Minimise |matrix z - target|^2 subject to rows z >= low. Return None if the solver finds no solution."""
    quadratic = matrix.T @ matrix + REGULAR * np.eye(matrix.shape[1])
    z, _, flag, _ = daqp.solve(
        quadratic,
        -matrix.T @ target,
        np.ascontiguousarray(rows),
        np.full(len(rows), FREE),
        low,
        np.zeros(len(rows), dtype=np.int32),
        primal_tol=TOLERANCE,
    )
    return z if flag > 0 else None


def _least_slack(rows: Array, low: Array) -> Array:
    """Return the least slack w >= 0 that makes inequalities solvable. These are rows x >= low - w, and w has least
    norm; array, shape (n_rows,)."""
    m, n = rows.shape
    if not m or _solve(np.eye(n), np.zeros(n), rows, low) is not None:
        return np.zeros(m)
    # Over x and w: |w|^2 + REGULAR |x|^2.
    size = np.concatenate([np.full(n, REGULAR), np.ones(m)])
    whole = np.block([[rows, np.eye(m)], [np.zeros((m, n)), np.eye(m)]])
    solution, _, flag, _ = daqp.solve(
        np.diag(size),
        np.zeros(n + m),
        whole,
        np.full(2 * m, FREE),
        np.concatenate([low, np.zeros(m)]),
        np.zeros(2 * m, dtype=np.int32),
        primal_tol=TOLERANCE,
    )
    return np.maximum(solution[n:], 0.0) if flag > 0 else np.maximum(low, 0.0)


def _null_space(matrix: Array) -> Array:
    """Return an orthonormal basis of the null space of a matrix; array, shape (n, n_free)."""
    _, singular, right = np.linalg.svd(matrix, full_matrices=True)
    rank = int((singular > RANK * max(singular.max(initial=0.0), 1e-300)).sum())
    return right[rank:].T
