"""Drake's `KinematicTrajectoryOptimization`: a B-spline of end-effector positions.

Distances (within half of their tolerance) and clearances are inequalities at even instants; clearances use comove's
exact kernel and its central differences. J is a quadratic cost of the control points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.lab.peers.common import (
    Best,
    Peer,
    PeerOutOfTime,
    clearance_slopes,
    clearances,
    first_hands,
    growing,
    independent_distances,
    kept_clearance,
    moved_aside,
    needed,
)
from comove.lab.systems import WEIGHTS, Offers, SystemProblem


@dataclass(frozen=True)
class Drake(Peer):
    """SNOPT on Drake's programme, restarted randomly until feasible. Restarts begin around the guess.

    Attributes
    ----------
    n_control, order : control points, and one more than the degree
    n_instants : instants at which constraints hold
    n_cost : instants at which J is summed
    band : share of a distance's tolerance that is kept: a spline cannot meet more equalities than it has control
        points
    margin : margin on clearances and separations [m], because hands also move between the instants
    limit : share of the limits of speed and acceleration that is kept
    iterations : major iterations of an attempt
    """

    name: str
    n_control: int = 20
    order: int = 4
    n_instants: int = 119
    n_cost: int = 201
    band: float = 0.5
    margin: float = 0.005
    limit: float = 0.9
    iterations: int = 200
    modules = (
        "pydrake.planning",
        "pydrake.solvers",
        "pydrake.autodiffutils",
        "pydrake.math",
        "pydrake.trajectories",
    )

    def run(self, problem: SystemProblem, offers: Offers) -> None:
        """Minimise J over the control points."""
        solvers, best = needed("pydrake.solvers"), Best(problem, offers)
        rng, scene = np.random.default_rng(problem.seed), problem.scene
        optimisation = self._optimisation(problem, offers)
        basis, points = optimisation.basis(), optimisation.control_points()
        values, s = self.values(basis, problem.instants), np.linspace(0.0, 1.0, self.n_cost)
        fit, guess = np.linalg.pinv(self.values(basis, s)), first_hands(problem, s)
        best.see(first_hands(problem, problem.instants))  # it may do already
        programme, latest = optimisation.get_mutable_prog(), np.zeros(points.shape)

        def visit(x: Array) -> None:
            latest[:] = x.reshape(points.shape)

        programme.AddVisualizationCallback(visit, points.ravel())
        options = solvers.SolverOptions()
        options.SetOption(solvers.SnoptSolver.id(), "Major iterations limit", self.iterations)
        for noise in growing(0.01, most=0.3):  # m, by which the load is moved aside
            if offers.seconds >= problem.budget:
                break
            visit((fit @ moved_aside(guess, noise, rng).reshape(self.n_cost, -1)).T)
            programme.SetInitialGuess(points, latest)
            programme.SetInitialGuess(optimisation.duration(), scene.duration)
            try:
                visit(solvers.SnoptSolver().Solve(programme, None, options).GetSolution(points))
            except RuntimeError:  # Drake's own, about what `_clearance` raises when time is up
                if offers.seconds < problem.budget:
                    raise
            if best.see((values @ latest.T).reshape(-1, *scene.start.shape)):
                break
        best.close()

    def values(self, basis: Any, s: Array) -> Array:
        """Return the basis at shares of the duration; shape (n, n_control)."""
        return np.array([[basis.EvaluateBasisFunctionI(i, at) for i in range(self.n_control)] for at in s])

    def _optimisation(self, problem: SystemProblem, offers: Offers) -> Any:
        scene = problem.scene
        n_dims, n = scene.n_dims, scene.start.size
        optimisation = self.constrained(problem, offers)
        programme, points = optimisation.get_mutable_prog(), optimisation.control_points()
        optimisation.AddDurationConstraint(scene.duration, scene.duration)
        for limit, bounded in (
            (scene.speed_limit, optimisation.AddVelocityBounds),
            (scene.acceleration_limit, optimisation.AddAccelerationBounds),
        ):
            if limit < np.inf:
                most = np.full(n, self.limit * limit / np.sqrt(n_dims))
                bounded(-most, most)
        values = self.values(optimisation.basis(), np.linspace(0.0, 1.0, self.n_cost))
        steps = np.diff(values, axis=0) * (self.n_cost - 1)
        square = 2 * (WEIGHTS.goal * values.T @ values + WEIGHTS.velocity * steps.T @ steps) / self.n_cost
        for row, goal in zip(points, scene.goal.ravel(), strict=True):
            programme.AddQuadraticCost(square, -2 * WEIGHTS.goal * goal * values.mean(axis=0), row)
        return optimisation

    def constrained(self, problem: SystemProblem, offers: Offers) -> Any:
        """Return Drake's programme with a scene's constraints. It is from rest to rest, without duration and cost."""
        planning, solvers = needed("pydrake.planning"), needed("pydrake.solvers")
        scene = problem.scene
        (n_hands, n_dims), n = scene.start.shape, scene.start.size
        optimisation = planning.KinematicTrajectoryOptimization(n, self.n_control, self.order, scene.duration)
        for s, end in ((0.0, scene.start.ravel()), (1.0, scene.goal.ravel())):
            optimisation.AddPathPositionConstraint(end, end, s)
            optimisation.AddPathVelocityConstraint(np.zeros(n), np.zeros(n), s)
        optimisation.AddPathAccelerationConstraint(np.zeros(n), np.zeros(n), 1.0)
        low, high = (np.tile(border, n_hands) for border in (scene.lower, scene.upper))
        optimisation.AddPositionBounds(low, high)

        def apart(first: int, second: int, least: float, greatest: float) -> Any:
            square = np.zeros((n, n))
            for axis in range(n_dims):
                a, b = first * n_dims + axis, second * n_dims + axis
                square[[a, b], [a, b]], square[[a, b], [b, a]] = 2.0, -2.0
            return solvers.QuadraticConstraint(square, np.zeros(n), least**2, greatest**2)

        demands = []
        for c in independent_distances(scene):
            kept = self.band * c.tolerance
            demands.append(apart(c.first, c.second, c.distance - kept, c.distance + kept))
        for (first, second), least in zip(*scene.kept_apart, strict=True):
            demands.append(apart(first, second, least + self.margin, np.inf))
        demands.append(_clearance(problem, offers, self.margin))
        for s in np.linspace(0.0, 1.0, self.n_instants + 2)[2:-2]:
            for demand in demands:
                optimisation.AddPathPositionConstraint(demand, s)
        return optimisation


def _clearance(problem: SystemProblem, offers: Offers, margin: float) -> Any:
    """Return the clearance constraint with at most a margin [m]."""
    solvers, autodiff = needed("pydrake.solvers"), needed("pydrake.autodiffutils")
    scene = problem.scene
    least = scene.clearance + kept_clearance(scene, margin)

    def value(x: Array) -> Array:
        if offers.seconds > problem.budget:
            raise PeerOutOfTime
        if x.dtype == float:
            return clearances(scene, x.reshape(1, *scene.start.shape))
        hands = autodiff.ExtractValue(x).reshape(1, *scene.start.shape)
        slopes = clearance_slopes(scene, hands).reshape(1, -1) @ autodiff.ExtractGradient(x)
        return autodiff.InitializeAutoDiff(clearances(scene, hands)[:, None], slopes)[:, 0]

    return solvers.PyFunctionConstraint(scene.start.size, value, [least], [np.inf])
