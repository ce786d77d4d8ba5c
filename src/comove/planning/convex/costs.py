"""The costs of motions as sums of squares: jerk, deviation, and equation (4)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.compiled import kernel
from comove.dmp.system import N_INTERVALS
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene

N_SAMPLES = 101


class Pulling(Protocol):
    """An objective with a weight of the deviation from a demonstration."""

    def pull(self, taught: bool) -> float: ...


class Moves(NamedTuple):
    """The derivatives of end effectors by the weights of basis functions.

    Attributes
    ----------
    slopes : array, shape (n_samples, n_hands * n_dims, n_columns), derivatives of the end effectors by the columns
    shape : array, shape (n_samples, n_basis), values of the basis functions
    even : array of bool, shape (n_columns,), whether a column moves the end effectors alike at all samples
    """

    slopes: Array
    shape: Array
    even: NDArray[np.bool_]


class Term(NamedTuple):
    """A sum of squares of ``scale (D P hands - target)``. D takes differences in time.

    Attributes
    ----------
    order : 0, 1 or 3, order of the derivative (see `differences`)
    scale : factor of the residuals
    target : array, shape (n_rows, n_hands * n_dims), 0 for none
    precision : array P, shape (n_samples, n_hands * n_dims, n_hands * n_dims); None for the identity
    """

    order: int
    scale: float
    target: Array | float = 0.0
    precision: Array | None = None

    def residuals(self, hands: Array) -> Array:
        """Return the residuals; array, shape (n_rows, n_hands * n_dims)."""
        hands = hands if self.precision is None else (self.precision @ hands[:, :, None])[:, :, 0]
        return self.scale * (differences(hands, self.order) - self.target)

    def normal_equations(self, hands: Array, moves: Moves) -> tuple[Array, Array]:
        """Return the summands of `SumOfSquares.normal_equations`."""
        slopes, shape, even = moves
        if self.precision is not None:
            slopes, even = self.precision @ slopes, np.zeros_like(even)
        columns = np.argsort(~even, kind="stable")  # those that move hands evenly come first
        n_columns, n_basis, n_even = len(even), shape.shape[1], int(even.sum())
        first, n = n_even * n_basis, n_columns * n_basis
        alike = np.ascontiguousarray(slopes[0][:, columns[:n_even]])
        residuals, basis = self.residuals(hands), self.scale * differences(shape, self.order)
        rows, mixed = _moved(slopes, shape, columns[n_even:], alike, self.order, self.scale)
        flat = rows.reshape(residuals.size, n - first)
        square, gradient = np.empty((n, n)), np.empty(n)
        product = (alike.T @ alike)[:, None, :, None] * (basis.T @ basis)[:, None, :]
        square[:first, :first] = product.reshape(first, first)
        square[first:, first:] = flat.T @ flat
        square[:first, first:] = (basis.T @ mixed).reshape(first, n - first)
        square[first:, :first] = square[:first, first:].T
        gradient[:first] = ((residuals @ alike).T @ basis).ravel()
        gradient[first:] = residuals.ravel() @ flat
        if (columns[1:] < columns[:-1]).any():
            back = np.argsort(columns)
            square = square.reshape(n_columns, n_basis, n_columns, n_basis)[back][:, :, back].reshape(n, n)
            gradient = gradient.reshape(n_columns, n_basis)[back].ravel()
        return square, gradient


class SumOfSquares(ABC):
    """A sum of squares of sampled end effectors, plus their time."""

    haste: float
    """Cost of a pace of 1, as `Limits.pace` counts; 0 if limits must be kept in the given duration."""

    @abstractmethod
    def terms(self, n_samples: int) -> tuple[Term, ...]:
        """Return the sums of squares whose sum it is."""

    def value(self, hands: Array) -> float:
        """Return the sum for end effectors; `hands` has the shape (n_samples, n_hands * n_dims)."""
        return float(sum((term.residuals(hands) ** 2).sum() for term in self.terms(len(hands))))

    def normal_equations(self, hands: Array, moves: Moves) -> tuple[Array, Array]:
        """Return the matrix and the vector of the normal equations.

        Derivatives are products in which most columns, as those of centres, do not depend on time: their blocks are
        products of small matrices (Kronecker).

        Returns
        -------
        array, shape (n_columns * n_basis, n_columns * n_basis), Gram matrix of the derivatives of the residuals
        array, shape (n_columns * n_basis,), half the gradient of the sum
        """
        squares, gradients = zip(
            *(term.normal_equations(hands, moves) for term in self.terms(len(hands))), strict=True
        )
        return sum(squares[1:], squares[0]), sum(gradients[1:], gradients[0])


@dataclass(frozen=True, eq=False)
class JerkCost(SumOfSquares):
    """The squared jerk of end effectors, relative to straight minimum-jerk motions.

    With a demonstration, the jerk is that of the deviation from it, and `pull` times the mean squared deviation,
    divided by `way` squared, is added; with a distribution, its precision weights deviations at each instant.

    Attributes
    ----------
    way : root of the summed squared distances of all end effectors from start to goal [m]
    demonstration : array, shape (n_samples, n_hands * n_dims) [m], None without one
    pull : weight of the deviation from the demonstration
    precision : array, shape (n_samples, n_hands * n_dims, n_hands * n_dims), root of the relative precision (see
        `planning.resemblance`); None for equal weights
    weight : factor of the whole cost
    haste : cost of a pace of 1
    """

    way: float
    demonstration: Array | None = None
    pull: float = 0.0
    precision: Array | None = None
    weight: float = 1.0
    haste: float = 0.0

    def terms(self, n_samples: int) -> tuple[Term, ...]:
        """Return jerk and deviation."""
        jerk = np.sqrt(self.weight / (720.0 * self.way**2 * (n_samples - 1)))
        if self.demonstration is None:
            return (Term(3, jerk),)
        taught = differences(self.demonstration, 3)
        taught[:2] = taught[-2:] = 0.0  # it need not rest at its ends
        pull, aim = np.sqrt(self.weight * self.pull / (n_samples * self.way**2)), self.demonstration
        if self.precision is not None:
            aim = (self.precision @ aim[:, :, None])[:, :, 0]
        return Term(3, jerk, taught), Term(0, pull, aim, self.precision)


@dataclass(frozen=True, eq=False)
class Anchored(SumOfSquares):
    """A cost plus the deviation of end effectors from planned positions.

    Attributes
    ----------
    cost : cost without the addition
    anchor : array, shape (n_samples, n_hands * n_dims), planned positions of the end effectors [m]
    pull : weight of the deviation, as in `JerkCost`
    """

    cost: JerkCost
    anchor: Array
    pull: float

    @property
    def haste(self) -> float:  # type: ignore[override]  # it is only read
        """Return the `haste` of the cost."""
        return self.cost.haste

    def terms(self, n_samples: int) -> tuple[Term, ...]:
        """Return those of the cost, and the deviation."""
        weight = np.sqrt(self.pull / (n_samples * self.cost.way**2))
        return *self.cost.terms(n_samples), Term(0, weight, self.anchor)


@dataclass(frozen=True, eq=False)
class PaperSquares(SumOfSquares):
    """J without its obstacle term, as obstacles are constraints here.

    Attributes
    ----------
    weights : c_goal, c_vel and c_res
    goal : array, shape (n_hands * n_dims,), goal of the end effectors [m]
    demonstration : array, shape (n_samples, n_hands * n_dims) [m], if resemblance to it counts; else None
    haste : 0, as J does not depend on the duration
    """

    weights: tuple[float, float, float]
    goal: Array
    demonstration: Array | None = None
    haste: float = 0.0

    def terms(self, n_samples: int) -> tuple[Term, ...]:
        """Return distance from the goal, velocity and resemblance."""
        goal, velocity, resemblance = np.sqrt(np.array(self.weights) / n_samples)
        terms = Term(0, goal, self.goal), Term(1, velocity)
        return terms if self.demonstration is None else (*terms, Term(0, resemblance, self.demonstration))


def squares(
    scene: Scene,
    objective: Pulling,
    demonstration: Array | None,
    n_samples: int = N_SAMPLES,
    precision: Array | None = None,
) -> JerkCost:
    """Return the objective as a sum of squares at even samples.

    Parameters
    ----------
    demonstration : array, shape (n_steps, n_manipulators, 3), demonstration transferred to every end effector [m],
        where n_steps - 1 is a multiple of n_samples - 1; None if there is none
    precision : array, shape (n_steps, n_hands * n_dims, n_hands * n_dims), of `planning.resemblance`; None for none
    """
    way, pull = float(np.linalg.norm(scene.goal - scene.start)), objective.pull(demonstration is not None)
    if pull == 0 or demonstration is None:
        return JerkCost(max(way, 1e-6))
    step = (len(demonstration) - 1) // (n_samples - 1)
    taught = demonstration[::step, :, : scene.n_dims].reshape(n_samples, -1)
    return JerkCost(max(way, 1e-6), taught, pull, None if precision is None else precision[::step])


def jerk_cost(
    motion: CoordinatedMotion,
    objective: Pulling,
    demonstration: Array | None,
    precision: Array | None = None,
) -> float:
    """Return a motion's objective; `demonstration` and `precision` as in `squares`."""
    nodes = motion.nodes_at_knots[0, :: N_INTERVALS // (N_SAMPLES - 1)]
    hands = nodes[:, : len(motion.scene.manipulators), : motion.scene.n_dims].reshape(N_SAMPLES, -1)
    return squares(motion.scene, objective, demonstration, precision=precision).value(hands)


# Coefficients of differences of order 0 to 3.
STENCILS = np.array(
    [[1.0, 0.0, 0.0, 0.0], [-1.0, 1.0, 0.0, 0.0], [1.0, -2.0, 1.0, 0.0], [-1.0, 3.0, -3.0, 1.0]]
)


@kernel
def n_differences(order, n_samples):
    """Return the number of rows of `differences`."""
    return n_samples - (order if order < 3 else 1)


@kernel
def stencil(order, row, n_samples):
    """Return first sample, sample count and sign of a row of `differences`."""
    if order < 3:
        return row, order + 1, 1.0
    if row == 0:
        return 0, 3, 1.0
    return (n_samples - 3, 3, -1.0) if row == n_samples - 2 else (row - 1, 4, 1.0)


@kernel
def differences(y, order):
    """Return derivatives of an order by normalised time, from even samples.

    Third derivatives lie between the samples of a motion with no acceleration at its ends.

    Parameters
    ----------
    y : array, shape (n_samples, n)

    Returns
    -------
    array, shape (n_differences(order, n_samples), n)
    """
    n_samples, n = y.shape
    rates, scale = np.zeros((n_differences(order, n_samples), n)), (n_samples - 1.0) ** order
    for row in range(rates.shape[0]):
        first, count, sign = stencil(order, row, n_samples)
        for j in range(count):
            for i in range(n):
                rates[row, i] += STENCILS[count - 1, j] * y[first + j, i]
        for i in range(n):
            rates[row, i] *= sign * scale
    return rates


@kernel
def _moved(slopes, shape, columns, alike, order, scale):
    """Return derivatives of a term's residuals by the weights of columns.

    Parameters
    ----------
    slopes : array, shape (n_samples, n_rates, n_columns)
    shape : array, shape (n_samples, n_basis)
    columns : array of int, shape (n,)
    alike : array, shape (n_rates, n_even)

    Returns
    -------
    array, shape (n_rows, n_rates, n * n_basis)
    array, shape (n_even, n_rows, n * n_basis), their products with `alike`
    """
    (n_samples, n_rates, _), n_basis, n, n_even = (
        slopes.shape,
        shape.shape[1],
        columns.shape[0],
        alike.shape[1],
    )
    n_rows, scale = n_differences(order, n_samples), scale * (n_samples - 1.0) ** order
    rows, mixed = np.empty((n_rows, n_rates, n * n_basis)), np.zeros((n_even, n_rows, n * n_basis))
    for row in range(n_rows):
        first, count, sign = stencil(order, row, n_samples)
        s, t, u = min(first + 1, n_samples - 1), min(first + 2, n_samples - 1), min(first + 3, n_samples - 1)
        a, b, c, d = STENCILS[count - 1] * (sign * scale)
        values, second, third, fourth = shape[first], shape[s], shape[t], shape[u]
        for h in range(n_rates):
            for i in range(n):
                out, column = rows[row, h, i * n_basis : (i + 1) * n_basis], columns[i]
                x, y = a * slopes[first, h, column], b * slopes[s, h, column]
                z, w = c * slopes[t, h, column], d * slopes[u, h, column]
                for k in range(n_basis):
                    out[k] = x * values[k] + y * second[k] + z * third[k] + w * fourth[k]
            for e in range(n_even):
                if alike[h, e] != 0.0:
                    out, every = mixed[e, row], rows[row, h]
                    for k in range(n * n_basis):
                        out[k] += alike[h, e] * every[k]
    return rows, mixed
