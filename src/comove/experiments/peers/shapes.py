"""The shape weights of all hands, as optimisers that know no robot take them: numbers in, costs and constraints out.

Every hand is a primitive of its own, whose ends hold by construction. That the hands keep their distances, touch
nothing and keep their limits are constraints at samples; those of distances have 0.9 of the tolerance and
clearances 5 mm more than is asked for, because hands also move between the samples.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from comove.coordination.coordinates import arms_coordinates
from comove.coordination.motion import CoordinatedDMP
from comove.experiments.peers.common import BETTER, Best, OutOfTime, clearance_slopes, clearances, first_hands
from comove.experiments.systems import WEIGHTS, Offers, Problem
from comove.primitives.basis import motion_basis

Array = NDArray[np.float64]

N_STEPS = 201
AT = np.arange(2, N_STEPS - 2, 2)  # samples at which there are constraints
WINDOWS = 20  # of time
INSIDE = 0.9  # of a tolerance or limit
MARGIN = 0.005  # m


class Shapes:
    """Offsets x of the weights from those of the first guess, array, shape (n,), which is 0.

    Parameters
    ----------
    problem : whose hands they move
    offers : that take what looks feasible
    n_basis : shape weights a hand and dimension
    """

    def __init__(self, problem: Problem, offers: Offers, n_basis: int):
        self.problem, self.offers, scene = problem, offers, problem.scene
        coordinates, basis = arms_coordinates(scene), motion_basis(n_basis, "acceleration")
        s = np.linspace(0.0, 1.0, N_STEPS)
        dmp = CoordinatedDMP(scene, coordinates, basis, coordinates.boundary(), np.zeros(0))
        self.dmp = dmp.fitted(s, coordinates.from_hands(first_hands(problem, s)))
        self.n, self.best = self.dmp.weights.size, Best(problem, offers)
        self.phi = basis.at(s)[1][0]
        self.seen, self.promise = np.zeros(self.n), (np.inf, np.inf)
        self.looked_at = np.inf

    def hands(self, x: Array) -> Array:
        """Samples of many; x (n_points, n) -> (n_points, N_STEPS, n_manipulators, n_dims) [m].

        Raises
        ------
        OutOfTime
            When the budget is used up.
        """
        if self.offers.seconds > self.problem.budget:
            raise OutOfTime
        weights = self.dmp.weights + x.reshape(-1, *self.dmp.weights.shape)
        q = self.dmp.rollouts(weights, N_STEPS)
        return np.moveaxis(q, 1, 2).reshape(len(q), N_STEPS, *self.problem.scene.start.shape)

    def costs(self, hands: Array) -> Array:
        """J; hands (n_points, N_STEPS, n_manipulators, n_dims) -> (n_points,)."""
        to_goal = ((hands - self.problem.scene.goal) ** 2).sum(axis=(1, 2, 3)) / N_STEPS
        effort = (np.diff(hands, axis=1) ** 2).sum(axis=(1, 2, 3)) * (N_STEPS - 1) ** 2 / N_STEPS
        return WEIGHTS.goal * to_goal + WEIGHTS.velocity * effort

    def spare(self, hands: Array) -> list[Array]:
        """What is left of all that is asked for, [m] or [m/s]; arrays, shape (n_points, n_samples) for each demand.

        Twice for each distance (too far, too near), for each separation, for the clearance, and for speed and
        acceleration of each hand where there are limits.
        """
        scene, rate = self.problem.scene, (N_STEPS - 1) / self.problem.scene.duration
        left = []
        for c in scene.distances:
            error = np.linalg.norm(hands[:, :, c.first] - hands[:, :, c.second], axis=2) - c.distance
            left += [INSIDE * c.tolerance - error, INSIDE * c.tolerance + error]
        for (first, second), least in zip(*scene.kept_apart, strict=True):
            left.append(np.linalg.norm(hands[:, :, first] - hands[:, :, second], axis=2) - least)
        clear = clearances(scene, hands.reshape(-1, *hands.shape[2:])).reshape(hands.shape[:2])
        left.append(clear - scene.clearance - MARGIN)
        for i in range(len(scene.manipulators)):
            velocity = np.diff(hands[:, :, i], axis=1) * rate
            if scene.speed_limit < np.inf:
                left.append(INSIDE * scene.speed_limit - np.linalg.norm(velocity, axis=2))
            if scene.acceleration_limit < np.inf:
                change = np.diff(velocity, axis=1) * rate
                left.append(INSIDE * scene.acceleration_limit - np.linalg.norm(change, axis=2))
        return left

    def note(self, x: Array, cost: float, missed: float) -> None:
        """Keep a point by the most that it misses at the samples and its cost; see whether it is to be offered."""
        promise = (max(missed, 0.0), cost)
        if promise < self.promise:
            self.promise, self.seen = promise, x.copy()
            if missed <= 0.0 and cost < BETTER * self.looked_at:
                self.looked_at = cost
                self.best.see(self.offered(x))

    def offered(self, x: Array) -> Array:
        """The hands of a point at the instants of an offer."""
        weights = self.dmp.weights + x.reshape(self.dmp.weights.shape)
        return self.dmp.rollout(weights).hands(self.problem.instants)[0]

    def close(self) -> None:
        """Offer the best that was seen."""
        self.best.see(self.offered(self.seen))
        self.best.close()

    @cached_property
    def curvature(self) -> Array:
        """Second derivatives of J, which is quadratic; array, shape (n, n)."""
        steps = np.diff(self.phi, axis=0) * (N_STEPS - 1)
        block = 2 * (WEIGHTS.goal * self.phi.T @ self.phi + WEIGHTS.velocity * steps.T @ steps) / N_STEPS
        return np.kron(np.eye(self.n // len(block)), block)

    def cost_slope(self, hands: Array) -> Array:
        """How J follows the weights; hands (N_STEPS, n_manipulators, n_dims) -> (n,)."""
        scene = self.problem.scene
        steps = np.diff(hands, axis=0)
        pull = np.diff(steps, axis=0, prepend=0.0 * steps[:1], append=0.0 * steps[:1]) * (N_STEPS - 1) ** 2
        by_hands = 2 * (WEIGHTS.goal * (hands - scene.goal) - WEIGHTS.velocity * pull) / N_STEPS
        return (by_hands.reshape(N_STEPS, -1).T @ self.phi).ravel()

    def limits(self, hands: Array) -> Array:
        """`spare` of one movement at every second sample, distances as shares of a decimetre; shape (n_limits,)."""
        return np.concatenate([left[0, AT] for left in self.spare(hands[None])]) * 10

    def limit_slopes(self, hands: Array) -> Array:
        """How `limits` follow the weights; array, shape (n_limits, n)."""
        scene = self.problem.scene
        rate, shape = (N_STEPS - 1) / scene.duration, scene.start.shape
        rows: list[Array] = []

        def of_hands(slopes: Array, phi: Array) -> Array:
            """Slopes by hands (n_samples, n_hands, n_dims) and these by weights (n_samples, n_basis)."""
            return (slopes[..., None] * phi[:, None, None]).reshape(len(slopes), -1)

        def apart(first: int, second: int) -> Array:
            slopes = np.zeros((len(AT), *shape))
            along = hands[AT, first] - hands[AT, second]
            along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
            slopes[:, first], slopes[:, second] = along, -along
            return of_hands(slopes, self.phi[AT])

        for c in scene.distances:
            error = apart(c.first, c.second)
            rows += [-error, error]
        rows += [apart(first, second) for first, second in scene.kept_apart[0]]
        rows.append(of_hands(clearance_slopes(scene, hands[AT]), self.phi[AT]))
        for i in range(shape[0]):
            changing, phi = hands[:, i], self.phi
            for limit in (scene.speed_limit, scene.acceleration_limit):
                changing, phi = np.diff(changing, axis=0) * rate, np.diff(phi, axis=0) * rate
                if limit < np.inf:
                    slopes = np.zeros((len(AT), *shape))
                    size = np.linalg.norm(changing[AT], axis=1, keepdims=True)
                    slopes[:, i] = -changing[AT] / np.maximum(size, 1e-12)
                    rows.append(of_hands(slopes, phi[AT]))
        return np.concatenate(rows) * 10
