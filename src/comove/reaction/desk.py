"""What the kernels of the twist programme work on: arrays, as named tuples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.reaction.nearness import LoadPoints
from comove.scenes.closest_points import N_PARTS

Array = NDArray[np.float64]

BORDER, HANDS, LIMIT = -1, -2, -3
"""Who asks for a row, where it is no obstacle: the border, a hand of another body, a limit of the hands."""


class Freedom(NamedTuple):
    """How the groups of a scene may move.

    Attributes
    ----------
    basis : array, shape (n_groups, 6, n_variables), twists of the variables; columns of an axis that turns are
        rewritten with its direction
    axis : array of int, shape (n_groups,), the first of the two variables that turn an axis in space; -1 for others
    scale : array, shape (n_groups,), length by which a variable that turns is divided [m]
    idle : array, shape (n_groups, 3, 3), in the group's frame [m^2]: what turning costs that moves no hand
    spread : array, shape (n_groups,), largest distance of a hand from the middle of its group's hands [m]
    lever : array, shape (n_groups,), how many times faster than the hands a point of the body may be
    pairs : array of int, shape (n_pairs, 2), hands that stay apart
    apart : array, shape (n_pairs,), by how much [m]
    lower, upper : arrays, shape (3,), the workspace [m]
    """

    basis: Array
    axis: NDArray[np.int64]
    scale: Array
    idle: Array
    spread: Array
    lever: Array
    pairs: NDArray[np.int64]
    apart: Array
    lower: Array
    upper: Array


class Rates(NamedTuple):
    """Limits and rates, infinite where there are none.

    Attributes
    ----------
    period : of a control step [s]
    gain : approach speed a distance [1/s]
    braking : deceleration that approaching bodies count on [m/s^2]
    retreat : largest speed with which a lost clearance is restored [m/s]
    speed, acceleration : limits of every hand [m/s], [m/s^2]
    clearance : that the scene asks for [m]
    """

    period: float
    gain: float
    braking: float
    retreat: float
    speed: float
    acceleration: float
    clearance: float


class Desk(NamedTuple):
    """Arrays that are written anew in every step.

    Attributes
    ----------
    quadratic, linear : arrays, shapes (n, n), (n,), the objective ``x' quadratic x / 2 + linear x``
    rows, low : arrays, shapes (n_rows, n), (n_rows,)
    owner, body : arrays of int, shape (n_rows,): an obstacle, `BORDER`, `HANDS` or `LIMIT`; the group
    hands : array, shape (n_hands, 3, n), velocities of the hands of the variables
    rotation, nodes, points : of now; shapes (n_groups, 3, 3), (n_nodes, 3), (n_points, 3)
    center_after, quaternion_after, rotation_after, nodes_after, table_after : after the step
    left : array, shape (n_edges + n_solids, n_obstacles), clearances h of now [m]
    gain : array, shape (n_groups,), approach speed a clearance left [1/s]
    slack : array, shape (n_groups, n_obstacles + 2), by how much rows of an owner were relaxed [m/s]
    balls : array, shape (2 n_hands + n_groups, 4), centres and radii of what is bound in length
    """

    quadratic: Array
    linear: Array
    rows: Array
    low: Array
    owner: NDArray[np.int64]
    body: NDArray[np.int64]
    hands: Array
    rotation: Array
    nodes: Array
    points: Array
    center_after: Array
    quaternion_after: Array
    rotation_after: Array
    nodes_after: Array
    table_after: Array
    left: Array
    gain: Array
    slack: Array
    balls: Array


def empty_desk(
    points: LoadPoints, freedom: Freedom, n_hands: int, shape: tuple[int, int], n_rounds: int
) -> Desk:
    """An empty desk for a table of that shape, large enough for `n_rounds` rounds of missing rows."""
    n_obstacles, n_columns = shape
    n_groups, _, n = freedom.basis.shape
    n_nodes, n_edges = len(points.node_group), len(points.edges) + len(points.solids)
    parts = len(points.edges) + N_PARTS * len(points.solids)
    first = (len(points.group) + parts) * n_obstacles + 6 * n_nodes + len(freedom.pairs) + 2 * n_hands
    later = n_edges * n_obstacles + 6 * n_nodes + len(freedom.pairs) + 4 * n_hands + n_groups
    n_rows = first + n_rounds * later
    return Desk(
        np.zeros((n, n)),
        np.zeros(n),
        np.zeros((n_rows, n)),
        np.zeros(n_rows),
        np.zeros(n_rows, dtype=np.int64),
        np.zeros(n_rows, dtype=np.int64),
        np.zeros((n_hands, 3, n)),
        np.zeros((n_groups, 3, 3)),
        np.zeros((n_nodes, 3)),
        np.zeros((len(points.group), 3)),
        np.zeros((n_groups, 3)),
        np.zeros((n_groups, 4)),
        np.zeros((n_groups, 3, 3)),
        np.zeros((n_nodes, 3)),
        np.zeros((n_obstacles, n_columns)),
        np.zeros((n_edges, n_obstacles)),
        np.zeros(n_groups),
        np.zeros((n_groups, n_obstacles + 2)),
        np.zeros((2 * n_hands + n_groups, 4)),
    )
