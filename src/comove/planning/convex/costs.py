"""The costs of motions as sums of squares: jerk, deviation, and equation (4)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from comove.arrays import Array
from comove.compiled import copy_to, kernel
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
    """

    slopes: Array
    shape: Array


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

    def normal_equations(
        self, hands: Array, moves: Moves, further: tuple[Array, Array] | None = None
    ) -> tuple[Array, Array]:
        """Return the matrix and the vector of the normal equations.

        Differences couple few neighbouring samples. So the matrix is the product of the basis functions with their
        sums over neighbours, weighted by products of slopes.

        Parameters
        ----------
        further : residuals that are added, and their derivatives by the columns at their sample; arrays, shapes
            (n_samples, n) and (n_samples, n, n_columns)

        Returns
        -------
        array, shape (n_columns * n_basis, n_columns * n_basis), Gram matrix of the derivatives of the residuals
        array, shape (n_columns * n_basis,), half the gradient of the sum
        """
        (slopes, shape), n_columns = moves, moves.slopes.shape[2]
        sums = np.zeros((len(shape), n_columns * (n_columns + 1) // 2 * shape.shape[1]))
        gradient = np.zeros(n_columns * shape.shape[1])
        for term in self.terms(len(hands)):
            own = slopes if term.precision is None else term.precision @ slopes
            _add(term.residuals(hands), own, shape, term.order, term.scale, sums, gradient)
        if further is not None:
            _add(*further, shape, 0, 1.0, sums, gradient)
        return _square(shape.T @ sums, n_columns), gradient


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


REACH = 3  # samples between those that a difference couples, at most
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
def _add(residuals, slopes, shape, order, scale, sums, gradient):
    """Add a term to sums and gradient of `SumOfSquares.normal_equations`.

    Parameters
    ----------
    residuals, slopes : arrays, shapes (n_rows, n_rates) and (n_samples, n_rates, n_columns)
    shape : array, shape (n_samples, n_basis)
    sums : array, shape (n_samples, n_pairs * n_basis), pairs of columns in the order of an upper triangle
    gradient : array, shape (n_columns * n_basis,)
    """
    (n_samples, n_rates, n_columns), n_basis = slopes.shape, shape.shape[1]
    coupled, pulled = np.zeros((n_samples, 2 * REACH + 1)), np.zeros((n_samples, n_rates))
    padded, weights = np.zeros((n_samples + 2 * REACH, n_basis)), np.empty((n_columns, 2 * REACH + 1))
    scale *= (n_samples - 1.0) ** order
    for s in range(n_samples):
        copy_to(shape[s], padded[s + REACH])
    for row in range(residuals.shape[0]):
        first, count, sign = stencil(order, row, n_samples)
        for j in range(count):
            for i in range(count):
                product = STENCILS[count - 1, i] * STENCILS[count - 1, j]
                coupled[first + j, REACH + i - j] += scale**2 * product
            for h in range(n_rates):
                pulled[first + j, h] += sign * scale * STENCILS[count - 1, j] * residuals[row, h]
    for s in range(n_samples):
        near, first = padded[s : s + 2 * REACH + 1], 0
        for c in range(n_columns):
            along = 0.0
            for h in range(n_rates):
                along += slopes[s, h, c] * pulled[s, h]
            for k in range(n_basis):
                gradient[c * n_basis + k] += along * shape[s, k]
            for e in range(c, n_columns):
                for d in range(2 * REACH + 1):
                    weights[e, d] = 0.0
            for d in range(REACH - order, REACH + order + 1):
                for h in range(n_rates if coupled[s, d] != 0.0 else 0):
                    factor = coupled[s, d] * slopes[s, h, c]
                    if factor != 0.0:  # of centres most are 0
                        for e in range(c, n_columns):
                            weights[e, d] += factor * slopes[s + d - REACH, h, e]
            for e in range(c, n_columns):
                u, v, w, x = weights[e, 0], weights[e, 1], weights[e, 2], weights[e, 3]
                y, z, r = weights[e, 4], weights[e, 5], weights[e, 6]
                out, first = sums[s, first : first + n_basis], first + n_basis
                if abs(u) + abs(v) + abs(w) + abs(x) + abs(y) + abs(z) + abs(r) == 0.0:
                    continue
                for k in range(n_basis):
                    before = u * near[0, k] + v * near[1, k] + w * near[2, k]
                    out[k] += before + x * near[3, k] + y * near[4, k] + z * near[5, k] + r * near[6, k]


@kernel
def _square(products, n_columns):
    """Return the matrix whose upper triangle of blocks is given; they have the shape (n_basis, n_pairs * n_basis)."""
    n_basis, first = products.shape[0], 0
    square = np.empty((n_columns * n_basis, n_columns * n_basis))
    for c in range(n_columns):
        for e in range(c, n_columns):
            for k in range(n_basis):
                for i in range(n_basis):
                    square[c * n_basis + k, e * n_basis + i] = products[k, first + i]
                    square[e * n_basis + i, c * n_basis + k] = products[k, first + i]
            first += n_basis
    return square
