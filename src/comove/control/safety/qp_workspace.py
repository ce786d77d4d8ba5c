"""Arrays and parameters of the safety filter's kernels, as named tuples."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from comove.arrays import Array, Integers
from comove.control.safety.control_points import LoadPoints
from comove.geometry.closest_points import N_PARTS
from comove.model.scene import Scene

BORDER, HANDS, LIMIT = -1, -2, -3
"""Who asks for a row, where it is no obstacle: the border, a hand of another body, a limit of the hands."""


class Freedom(NamedTuple):
    """The degrees of freedom of a scene's rigid groups, and their separations.

    Attributes
    ----------
    basis : array, shape (n_groups, 6, n_variables), twists per unit of the variables; the columns of an axis that
        turns are rewritten with its direction
    axis : array of int, shape (n_groups,), the first of the two variables that turn an axis in space; -1 for others
    scale : array, shape (n_groups,), length by which a variable that turns is divided [m]
    idle : array, shape (n_groups, 3, 3), in the group's frame [m^2]: cost of rotation that hardly moves the end
        effectors
    spread : array, shape (n_groups,), largest distance of an end effector from the middle of its group's [m]
    lever : array, shape (n_groups,), upper bound of the ratio of a point's speed to that of the end effectors
    pairs : array of int, shape (n_pairs, 2), pairs of end effectors that must stay apart
    apart : array, shape (n_pairs,), least distances of these pairs [m]
    lower, upper : arrays, shape (3,), the workspace [m]
    """

    basis: Array
    axis: Integers
    scale: Array
    idle: Array
    spread: Array
    lever: Array
    pairs: Integers
    apart: Array
    lower: Array
    upper: Array


class Rates(NamedTuple):
    """Limits and rates of the programme, infinite where there are none.

    Attributes
    ----------
    period : length of a control step [s]
    gain : approach speed per distance [1/s]
    braking : assumed deceleration of approaching bodies [m/s^2]
    passing : likewise towards moving obstacles; larger while they are predicted to pass by [m/s^2]
    retreat : largest speed with which a lost clearance is restored [m/s]
    speed, acceleration : limits of every end effector [m/s], [m/s^2]
    clearance : required clearance: the scene's and a reserve [m]
    """

    period: float
    gain: float
    braking: float
    passing: float
    retreat: float
    speed: float
    acceleration: float
    clearance: float


class Sighting(NamedTuple):
    """The obstacle states at an instant.

    Attributes
    ----------
    table : array, shape (n_rows, n_columns), table of the scene's obstacles with their present centres and rotations
    velocity : array, shape (n_rows, 3), velocities of the centres [m/s]
    spin : array, shape (n_rows, 3), angular velocities [rad/s]
    margin : array, shape (n_rows,), distance kept on top of the scene's clearance for uncertainty [m]
    """

    table: Array
    velocity: Array
    spin: Array
    margin: Array

    @classmethod
    def still(cls, scene: Scene) -> Sighting:
        """Return a scene's obstacles at rest, exactly at their file positions."""
        n = len(scene.obstacles)
        return cls(scene.obstacles, np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n))


class StateAfter(NamedTuple):
    """Work arrays for the state after a step.

    Attributes
    ----------
    center, quaternion, rotation : arrays, shapes (n_groups, 3) [m], (n_groups, 4) and (n_groups, 3, 3), poses
    nodes : array, shape (n_nodes, 3) [m]
    table : array, shape (n_rows, n_columns), the obstacles
    """

    center: Array
    quaternion: Array
    rotation: Array
    nodes: Array
    table: Array


class QPWorkspace(NamedTuple):
    """Work arrays that are rewritten in every step.

    Attributes
    ----------
    quadratic, linear : arrays, shapes (n + n_joints, n + n_joints), (n + n_joints,), the objective
        ``z' quadratic z / 2 + linear z``, where the rates of the joints of arms follow the n variables of the twists
    rows, low : arrays, shapes (n_rows, n + n_joints), (n_rows,), the constraints ``rows z >= low``
    owner, body : arrays of int, shape (n_rows,): the obstacle, `BORDER`, `HANDS` or `LIMIT` that requires a row; the
        group that it constrains
    hands : array, shape (n_hands, 3, n), velocities of the end effectors per unit of the variables
    rotation, nodes, points : arrays, shapes (n_groups, 3, 3), (n_nodes, 3), (n_points, 3), at the start of the step
    after : the state after the step
    left : array, shape (n_edges + n_solids, n_obstacles), clearances h at the start of the step [m]
    gain : array, shape (n_groups,), approach speed per clearance left [1/s]
    slack : array, shape (n_groups, n_obstacles + 2), by how much the rows of an owner were relaxed [m/s]
    balls : array, shape (2 n_hands + n_groups, 4), centres and radii of the balls that limit velocities,
        accelerations and rotations
    """

    quadratic: Array
    linear: Array
    rows: Array
    low: Array
    owner: Integers
    body: Integers
    hands: Array
    rotation: Array
    nodes: Array
    points: Array
    after: StateAfter
    left: Array
    gain: Array
    slack: Array
    balls: Array


class QP(NamedTuple):
    """The data shared by the kernels of the quadratic programme.

    Attributes
    ----------
    points : the geometry to keep clear
    freedom : the degrees of freedom of the groups
    rates : limits and rates
    work : work arrays
    """

    points: LoadPoints
    freedom: Freedom
    rates: Rates
    work: QPWorkspace


def empty_workspace(
    points: LoadPoints,
    freedom: Freedom,
    n_hands: int,
    shape: tuple[int, int],
    n_rounds: int,
    n_more: int = 0,
    n_joints: int = 0,
) -> QPWorkspace:
    """Return work arrays for a table's shape. They hold `n_rounds` rounds of missing rows.

    `n_more` rows are for sampled constraints, for bodies that may lean, and for arms.
    """
    n_obstacles, n_columns = shape
    n_groups, _, n = freedom.basis.shape
    n_nodes, n_edges = len(points.node_group), len(points.edges) + len(points.solids)
    parts = len(points.edges) + N_PARTS * len(points.solids)
    first = (len(points.group) + parts) * n_obstacles + 6 * n_nodes + len(freedom.pairs) + 2 * n_hands
    later = n_edges * n_obstacles + 6 * n_nodes + len(freedom.pairs) + 4 * n_hands + n_groups
    n_rows = first + n_more + n_rounds * later
    return QPWorkspace(
        np.zeros((n + n_joints, n + n_joints)),
        np.zeros(n + n_joints),
        np.zeros((n_rows, n + n_joints)),
        np.zeros(n_rows),
        np.zeros(n_rows, dtype=np.int64),
        np.zeros(n_rows, dtype=np.int64),
        np.zeros((n_hands, 3, n)),
        np.zeros((n_groups, 3, 3)),
        np.zeros((n_nodes, 3)),
        np.zeros((len(points.group), 3)),
        StateAfter(
            np.zeros((n_groups, 3)),
            np.zeros((n_groups, 4)),
            np.zeros((n_groups, 3, 3)),
            np.zeros((n_nodes, 3)),
            np.zeros((n_obstacles, n_columns)),
        ),
        np.zeros((n_edges, n_obstacles)),
        np.zeros(n_groups),
        np.zeros((n_groups, n_obstacles + 2)),
        np.zeros((2 * n_hands + n_groups, 4)),
    )
