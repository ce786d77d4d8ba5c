"""Peers with primitives: optimisers of shape weights, and a coupling.

`Shapes` defines the optimisation problem. Every end effector is a primitive of its own, whose ends hold by
construction. Distances between end effectors, clearance and limits are constraints at samples. Because end effectors
also move between the samples, the constraints keep a part of the tolerance as a margin: half of a tolerance, up to 5
mm of clearance, a tenth of a limit. The coupling is of two end effectors.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from comove.arrays import Array, Integers
from comove.dmp.basis import motion_basis
from comove.lab.peers.common import (
    Best,
    Peer,
    PeerOutOfTime,
    clearance_slopes,
    clearances,
    first_hands,
    growing,
    kept_clearance,
    needed,
)
from comove.lab.systems import N_SAMPLES, WEIGHTS, Offers, SystemProblem, cost_of
from comove.model.coordinated_dmp import CoordinatedDMP
from comove.model.coordinates import arms_coordinates
from comove.model.scene import Scene
from comove.model.shapes import spatial


class Demand(NamedTuple):
    """Requirement on a movement.

    Attributes
    ----------
    spare : amount by which it is met, negative if it is violated; array, shape (n_points, n_samples) [m], [m/s],
        [m/s^2]
    kept : margin that the constraints keep
    at : array, shape (n_constraints,), samples of the constraints
    """

    spare: Array
    kept: float
    at: Integers


@dataclass(frozen=True)
class SamplingSettings:
    """Settings of the constraints at samples.

    Attributes
    ----------
    n_steps : samples of a movement; constraints hold at every second one, those of limits at every eighth
    n_windows : windows of time, for each of which `Shapes.windows` returns the largest violations
    tolerance, limit : shares of tolerances and of limits that are kept as margins
    clearance : clearance that is kept as a margin [m]
    scale : units of the constraints in a metre: decimetres are of the size of the weights
    """

    n_steps: int = 201
    n_windows: int = 20
    tolerance: float = 0.5
    limit: float = 0.1
    clearance: float = 0.005
    scale: float = 10.0

    @property
    def at(self) -> Integers:
        """Return the samples of the constraints."""
        return np.arange(2, self.n_steps - 2, 2)

    @property
    def at_limits(self) -> Integers:
        """Return the samples of the speed and acceleration constraints."""
        return self.at[::4]


SAMPLING = SamplingSettings()


class Shapes:
    """Optimisation problem over offsets from the first guess's weights. The unknowns x are an array of shape (n,).

    Parameters
    ----------
    problem : problem whose end effectors move
    offers : record of candidates that look feasible
    n_basis : number of shape weights per end effector and dimension
    sampling : settings of the constraints
    """

    def __init__(
        self, problem: SystemProblem, offers: Offers, n_basis: int, sampling: SamplingSettings = SAMPLING
    ):
        self.problem, self.offers, scene = problem, offers, problem.scene
        self.sampling, self.n_steps = sampling, sampling.n_steps
        coordinates, basis = arms_coordinates(scene), motion_basis(n_basis, "acceleration")
        s = np.linspace(0.0, 1.0, self.n_steps)
        dmp = CoordinatedDMP(scene, coordinates, basis, coordinates.boundary(), np.zeros(0))
        self.dmp = dmp.fitted(s, coordinates.from_hands(first_hands(problem, s)))
        self.n, self.best = self.dmp.weights.size, Best(problem, offers)
        self.phi = basis.at(s)[1][0]
        self.seen, self.promise = np.zeros(self.n), (np.inf, np.inf)
        self.looked_at, self.kept = np.inf, kept_clearance(scene, sampling.clearance)
        guess = self._samples(self.seen)
        self.note(self.seen, float(cost_of(scene, guess)[0]), self.demands(guess))  # it may do already

    def hands(self, x: Array) -> Array:
        """Return sampled end effectors of many points [m]. The shapes are (n_points, n) -> (n_points, n_steps,
        n_manipulators, n_dims).

        Raises
        ------
        PeerOutOfTime
            If the budget is used up.
        """
        if self.offers.seconds > self.problem.budget:
            raise PeerOutOfTime
        return self._samples(x)

    def _samples(self, x: Array) -> Array:
        weights = self.dmp.weights + x.reshape(-1, *self.dmp.weights.shape)
        q = self.dmp.rollouts(weights, self.n_steps)
        return np.moveaxis(q, 1, 2).reshape(len(q), self.n_steps, *self.problem.scene.start.shape)

    def demands(self, hands: Array) -> list[Demand]:
        """Return all requirements on end effectors. `hands` has the shape (n_points, n_steps, n_manipulators,
        n_dims). There are two for each distance (not too far, not too near), one for each separation, one for the
        clearance, and one for speed and acceleration of each end effector if they have limits."""
        scene, rate = self.problem.scene, (self.n_steps - 1) / self.problem.scene.duration
        keep, at, asked = self.sampling, self.sampling.at, []
        for c in scene.distances:
            error = np.linalg.norm(hands[:, :, c.first] - hands[:, :, c.second], axis=2) - c.distance
            asked += [Demand(c.tolerance + e, keep.tolerance * c.tolerance, at) for e in (-error, error)]
        for (first, second), least in zip(*scene.kept_apart, strict=True):
            apart = np.linalg.norm(hands[:, :, first] - hands[:, :, second], axis=2)
            asked.append(Demand(apart - least, keep.clearance, at))
        clear = clearances(scene, hands.reshape(-1, *hands.shape[2:])).reshape(hands.shape[:2])
        asked.append(Demand(clear - scene.clearance, self.kept, at))
        for i in range(len(scene.manipulators)):
            changing = hands[:, :, i]
            for limit in (scene.speed_limit, scene.acceleration_limit):
                changing = np.diff(changing, axis=1) * rate
                if limit < np.inf:
                    size = np.linalg.norm(changing, axis=2)
                    asked.append(Demand(limit - size, keep.limit * limit, keep.at_limits))
        return asked

    def note(self, x: Array, cost: float, asked: list[Demand], k: int = 0) -> None:
        """Keep a point if it is the best; offer it if feasible. It is the k-th of those with these demands."""
        missed = -min(float(demand.spare[k].min()) for demand in asked)
        promise = (max(missed, 0.0), cost)
        if promise < self.promise:
            self.promise, self.seen = promise, x.copy()
            if missed <= 0.0 and cost < self.best.better * self.looked_at:
                self.looked_at = cost
                self.best.see(self.offered(x))

    def windows(self, asked: list[Demand]) -> Array:
        """Return the largest violations per time window, with margins. Array, shape (n_points, n_windows)."""
        edges = np.linspace(0, self.n_steps - 2, self.sampling.n_windows, endpoint=False, dtype=int)
        missed = [np.maximum.reduceat(d.kept - d.spare, edges, axis=1) for d in asked]
        return self.sampling.scale * np.concatenate(missed, axis=1)

    def offered(self, x: Array) -> Array:
        """Return the end effectors of a point at the offer's instants."""
        weights = self.dmp.weights + x.reshape(self.dmp.weights.shape)
        return self.dmp.rollout(weights).hands(self.problem.instants)[0]

    def close(self) -> None:
        """Offer the best point."""
        self.best.see(self.offered(self.seen))
        self.best.close()

    @cached_property
    def curvature(self) -> Array:
        """Return the second derivatives of the quadratic J; shape (n, n)."""
        steps = np.diff(self.phi, axis=0) * (self.n_steps - 1)
        block = WEIGHTS.goal * self.phi.T @ self.phi + WEIGHTS.velocity * steps.T @ steps
        block *= 2 / self.n_steps
        return np.kron(np.eye(self.n // len(block)), block)

    def cost_slope(self, hands: Array) -> Array:
        """Return the gradient of J by the weights; array, shape (n,). `hands` has the shape (n_steps,
        n_manipulators, n_dims)."""
        scene, n = self.problem.scene, self.n_steps
        steps = np.diff(hands, axis=0)
        pull = np.diff(steps, axis=0, prepend=0.0 * steps[:1], append=0.0 * steps[:1]) * (n - 1) ** 2
        by_hands = 2 * (WEIGHTS.goal * (hands - scene.goal) - WEIGHTS.velocity * pull) / n
        return (by_hands.reshape(n, -1).T @ self.phi).ravel()

    def constraints(self, asked: list[Demand]) -> Array:
        """Return the first point's spare beyond the margins. Array, shape (n_constraints,)."""
        return self.sampling.scale * np.concatenate(
            [demand.spare[0, demand.at] - demand.kept for demand in asked]
        )

    def constraint_slopes(self, hands: Array) -> Array:
        """Return the derivatives of `constraints` by the weights. Array, shape (n_constraints, n)."""
        scene, at, at_limits = self.problem.scene, self.sampling.at, self.sampling.at_limits
        rate, shape = (self.n_steps - 1) / scene.duration, scene.start.shape
        rows: list[Array] = []

        def of_hands(slopes: Array, phi: Array) -> Array:
            """Convert slopes by end effectors to slopes by weights. The shapes are (n_samples, n_hands, n_dims),
            (n_samples, n_basis) -> (n_samples, n)."""
            return (slopes[..., None] * phi[:, None, None]).reshape(len(slopes), -1)

        def apart(first: int, second: int) -> Array:
            slopes = np.zeros((len(at), *shape))
            along = hands[at, first] - hands[at, second]
            along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
            slopes[:, first], slopes[:, second] = along, -along
            return of_hands(slopes, self.phi[at])

        for c in scene.distances:
            error = apart(c.first, c.second)
            rows += [-error, error]
        rows += [apart(first, second) for first, second in scene.kept_apart[0]]
        rows.append(of_hands(clearance_slopes(scene, hands[at]), self.phi[at]))
        for i in range(shape[0]):
            changing, phi = hands[:, i], self.phi
            for limit in (scene.speed_limit, scene.acceleration_limit):
                changing, phi = np.diff(changing, axis=0) * rate, np.diff(phi, axis=0) * rate
                if limit < np.inf:
                    slopes = np.zeros((len(at_limits), *shape))
                    size = np.linalg.norm(changing[at_limits], axis=1, keepdims=True)
                    slopes[:, i] = -changing[at_limits] / np.maximum(size, 1e-12)
                    rows.append(of_hands(slopes, phi[at_limits]))
        return self.sampling.scale * np.concatenate(rows)


@dataclass(frozen=True)
class PycmaAL(Peer):
    """Pycma's `ConstrainedFitnessAL` with windowed constraints. They are the largest violations of each requirement
    in 20 windows of time. A run that ends is followed by another from the same guess, until the budget is used up."""

    name: str
    n_basis: int = 16
    sigma: float = 0.05  # the step size at first
    modules = ("cma", "cma.constraints_handler", "cma.logger")

    def run(self, problem: SystemProblem, offers: Offers) -> None:
        """Minimise J on the shape weights."""
        cma, handler, logger = map(needed, self.modules)
        shapes, rng = Shapes(problem, offers, self.n_basis), np.random.default_rng(problem.seed)
        known: dict[bytes, tuple[float, Array]] = {}

        def evaluate(points: Array) -> None:
            hands = shapes.hands(points)
            costs, asked = cost_of(problem.scene, hands), shapes.demands(hands)
            missed = shapes.windows(asked)
            known.clear()
            for k, x in enumerate(points):
                known[x.tobytes()] = float(costs[k]), missed[k]
                shapes.note(x, float(costs[k]), asked, k)

        def value(x: Array) -> tuple[float, Array]:
            x = np.asarray(x)
            if x.tobytes() not in known:
                evaluate(x[None])
            return known[x.tobytes()]

        options = {
            "verbose": -9,
            "verb_log": 0,
            "seed": np.nan,
            "randn": lambda *size: rng.standard_normal(size),
        }
        with suppress(PeerOutOfTime), _silence(handler, logger.LoggerDummy):
            while True:
                fitness = handler.ConstrainedFitnessAL(
                    lambda x: value(x)[0], lambda x: value(x)[1], logging=0, archives=False
                )
                run = cma.CMAEvolutionStrategy(np.zeros(shapes.n), self.sigma, options)
                while not run.stop():
                    points = run.ask()
                    evaluate(np.array(points))
                    run.tell(points, [fitness(x) for x in points])
                    fitness.update(run)
        shapes.close()


@contextmanager
def _silence(handler: Any, dummy: type) -> Iterator[None]:
    """Suppress warnings on constant demands, and pycma's log folder."""
    logger = handler._Logger
    handler._Logger = dummy  # as pycma's source advises
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        handler._Logger = logger


@dataclass(frozen=True)
class Scipy(Peer):
    """`scipy.optimize.minimize`, restarted randomly until feasible. Restarts begin around the guess.

    Attributes
    ----------
    method : "SLSQP" or "trust-constr"
    """

    name: str
    method: str
    n_basis: int = 24
    modules = ("scipy.optimize",)

    def run(self, problem: SystemProblem, offers: Offers) -> None:
        """Minimise J subject to the constraints at the samples. All derivatives but those of clearances are exact."""
        shapes, rng = Shapes(problem, offers, self.n_basis), np.random.default_rng(problem.seed)
        with suppress(PeerOutOfTime):
            for noise in growing(0.02, most=0.5):  # of the weights from which an attempt begins
                self._attempt(shapes, rng.normal(0.0, noise, shapes.n))
                if shapes.promise[0] <= 0.0:
                    break
        shapes.close()

    def _attempt(self, shapes: Shapes, x: Array) -> None:
        optimize, scene = needed("scipy.optimize"), shapes.problem.scene

        def hands(x: Array) -> Array:
            return shapes.hands(x[None])

        def constraints(x: Array) -> Array:
            asked = shapes.demands(samples := hands(x))
            shapes.note(x, float(cost_of(scene, samples)[0]), asked)
            return shapes.constraints(asked)

        options: dict[str, Any] = {"maxiter": 1000, "ftol": 1e-6}
        limits: Any = {
            "type": "ineq",
            "fun": constraints,
            "jac": lambda x: shapes.constraint_slopes(hands(x)[0]),
        }
        extra: dict[str, Any] = {}
        if self.method == "trust-constr":
            options = {"maxiter": 1000, "xtol": 1e-6, "gtol": 1e-5, "initial_tr_radius": 0.5}
            limits = optimize.NonlinearConstraint(
                limits["fun"], 0.0, np.inf, jac=limits["jac"], hess=optimize.BFGS()
            )
            extra["hess"] = lambda x: shapes.curvature
        optimize.minimize(
            lambda x: float(cost_of(scene, hands(x))[0]),
            x,
            jac=lambda x: shapes.cost_slope(hands(x)[0]),
            method=self.method,
            constraints=[limits],
            options=options,
            **extra,
        )


@dataclass(frozen=True)
class Coupled(Peer):
    """`DualCartesianDMP` with `CouplingTermDualCartesianDistance` that imitates the first guess. The coupling, a
    spring between two end effectors on one phase after Gams et al. (2014), keeps a distance and ignores obstacles.

    Attributes
    ----------
    spring : k; 100 holds distances to 1e-8 m in the scenes tried, ten times better than 10 and 1
    """

    name: str
    n_basis: int = 30
    spring: float = 100.0
    modules = ("movement_primitives.dmp",)

    def refuses(self, scene: Scene) -> str:
        """Return why the coupling does not suit the scene; empty if it does."""
        if len(scene.manipulators) != 2 or len(scene.distances) != 1:
            return "It couples two hands by one distance."
        return super().refuses(scene)

    def run(self, problem: SystemProblem, offers: Offers) -> None:
        """Imitate the first guess, roll out with coupling, and offer it."""
        dmp = needed(self.modules[0])
        scene, (c,) = problem.scene, problem.scene.distances
        time = problem.instants * scene.duration
        states = np.zeros((N_SAMPLES, 14))
        hands = spatial(first_hands(problem, problem.instants))
        states[:, 0:3], states[:, 7:10] = hands[:, 0], hands[:, 1]
        states[:, [3, 10]] = 1.0  # quaternions w x y z of hands that do not turn
        model = dmp.DualCartesianDMP(
            execution_time=scene.duration, dt=time[1], n_weights_per_dim=self.n_basis, int_dt=time[1]
        )
        model.imitate(time, states)
        model.configure(start_y=states[0], goal_y=states[-1])
        coupling = dmp.CouplingTermDualCartesianDistance(c.distance, lf=(1.0, 1.0), k=self.spring)
        _, states = model.open_loop(coupling_term=coupling)
        hands = np.stack([states[:, 0:3], states[:, 7:10]], axis=1)
        at = np.linspace(0, len(hands) - 1, N_SAMPLES).round().astype(int)
        offers.take(hands[at, :, : scene.n_dims])
