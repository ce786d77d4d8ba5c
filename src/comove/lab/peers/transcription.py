"""Direct transcription for IPOPT: end-effector positions at knots are unknown.

Distances are equalities at the knots. Points along the payload, every two centimetres, keep away from obstacles at
the knots; a smooth lower bound of their smallest distance is one constraint per obstacle. Between the knots end
effectors follow cubic splines.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from comove.arrays import Array
from comove.geometry import distances as sd
from comove.lab.peers.common import (
    Best,
    Peer,
    first_hands,
    growing,
    independent_distances,
    kept_clearance,
    moved_aside,
    needed,
)
from comove.lab.systems import WEIGHTS, Offers, SystemProblem
from comove.model.scene import Scene

SMOOTH = 1e-9  # m^2, under square roots
OPTIONS = {
    "print_level": 0,
    "sb": "yes",
    "max_iter": 150,  # of an attempt
    "tol": 1e-4,
    "constr_viol_tol": 1e-6,
    "acceptable_tol": 1e-2,
    "acceptable_iter": 5,
    "mu_strategy": "adaptive",
}


@dataclass(frozen=True)
class Transcription(Peer):
    """IPOPT through CasADi, restarted randomly until feasible. Restarts begin around the guess.

    Attributes
    ----------
    n_knots : number of knots
    margin : margin on top of the gap between smooth bounds and distances [m]
    spacing : distance between the points along the payload [m]
    sharpness : sharpness of the smooth bounds [1/m]
    stride : largest distance from knot to knot [m]: with more, movements jump walls
    limit : share of the limits of speed and acceleration that differences of knots keep
    """

    name: str
    n_knots: int = 80
    margin: float = 0.004
    spacing: float = 0.02
    sharpness: float = 400.0
    stride: float = 0.04
    limit: float = 0.95
    modules = ("casadi",)

    def refuses(self, scene: Scene) -> str:
        """Return why the scene cannot be represented; empty if it can. Meshes, for example, have no formula."""
        if (scene.obstacles[:, sd.KIND] == sd.POLYTOPE).any():
            return "It knows boxes, spheres, capsules, cylinders and ellipsoids, but no meshes."
        return super().refuses(scene)

    def run(self, problem: SystemProblem, offers: Offers) -> None:
        """Minimise J over the knots."""
        best, rng = Best(problem, offers), np.random.default_rng(problem.seed)
        s = np.linspace(0.0, 1.0, self.n_knots)
        programme, y = self._programme(problem.scene)
        guess = first_hands(problem, s)
        best.see(first_hands(problem, problem.instants))  # it may do already
        for noise in growing(0.01, most=0.3):  # m, by which the load is moved aside
            if (left := problem.budget - offers.seconds) <= 0.0:
                break
            programme.set_initial(y, moved_aside(guess, noise, rng).reshape(self.n_knots, -1))
            programme.solver("ipopt", {"print_time": False}, OPTIONS | {"max_cpu_time": left})
            with suppress(RuntimeError):  # not converged: its last iterate is looked at all the same
                programme.solve()
            knots = np.asarray(programme.debug.value(y)).reshape(self.n_knots, *problem.scene.start.shape)
            if np.isfinite(knots).all() and best.see(
                CubicSpline(s, knots, bc_type="clamped")(problem.instants)
            ):
                break
        best.close()

    def _programme(self, scene: Scene) -> tuple[Any, Any]:
        """Return the programme and its unknowns, of n_knots rows [m]."""
        casadi = needed("casadi")
        programme = casadi.Opti()
        (n_hands, n_dims), n_knots = scene.start.shape, self.n_knots
        y = programme.variable(n_knots, n_hands * n_dims)
        hands = [y[:, i * n_dims : (i + 1) * n_dims] for i in range(n_hands)]
        for end, rows in ((scene.start, (0, 1)), (scene.goal, (n_knots - 3, n_knots - 2, n_knots - 1))):
            for row in rows:  # several, so that they are at rest
                programme.subject_to(y[row, :] == end.ravel()[None])
        for c in independent_distances(scene):
            apart = casadi.sum2((hands[c.first] - hands[c.second]) ** 2)
            programme.subject_to(apart[2:-3] == c.distance**2)
        for (first, second), least in zip(*scene.kept_apart, strict=True):
            apart = casadi.sum2((hands[first] - hands[second]) ** 2)
            programme.subject_to(apart[2:-3] >= (least + self.margin) ** 2)
        rate = (n_knots - 1) / scene.duration
        for hand in hands:
            programme.subject_to(casadi.sum2((hand[1:, :] - hand[:-1, :]) ** 2)[1:-2] <= self.stride**2)
            changing = hand
            for limit in (scene.speed_limit, scene.acceleration_limit):
                changing = (changing[1:, :] - changing[:-1, :]) * rate
                if limit < np.inf:
                    programme.subject_to(casadi.sum2(changing**2)[1:-2] <= (self.limit * limit) ** 2)
        margin = scene.clearance + kept_clearance(scene, self.margin)
        for hand in hands:
            for axis in range(n_dims):
                low, high = scene.lower[axis] + margin, scene.upper[axis] - margin
                programme.subject_to(programme.bounded(low, hand[2:-3, axis], high))
        if len(scene.obstacles):
            along = y[2:-3, :].T
            clearance = self._clearance(scene).map(along.shape[1])(along)
            programme.subject_to(casadi.vec(clearance) >= margin)
        goal = np.tile(scene.goal.ravel(), (n_knots, 1))
        effort = casadi.sumsqr(y[1:, :] - y[:-1, :]) * (n_knots - 1) ** 2
        programme.minimize((WEIGHTS.goal * casadi.sumsqr(y - goal) + WEIGHTS.velocity * effort) / n_knots)
        return programme, y

    def _clearance(self, scene: Scene) -> Any:
        """Return smooth lower bounds of obstacle distances [m]. They are a function of a configuration, (n_hands *
        n_dims,)."""
        casadi = needed("casadi")
        x = casadi.SX.sym("x", scene.start.size)
        hands = [x[i * scene.n_dims : (i + 1) * scene.n_dims] for i in range(len(scene.start))]
        clear = []
        for row in scene.obstacles:
            of_points = []
            for (i, j), radius in zip(scene.body.edges, scene.body.radii, strict=True):
                length = float(np.linalg.norm(scene.start[i] - scene.start[j]))
                for share in np.linspace(0.0, 1.0, int(np.ceil(length / self.spacing)) + 1):
                    point = (1 - share) * hands[i] + share * hands[j]
                    of_points.append(self._distance(row, point, scene.n_dims) - float(radius))
            clear.append(-self._largest([-distance for distance in of_points], 0.0))
        return casadi.Function("clearance", [x], [casadi.vertcat(*clear)])

    def _largest(self, values: list[Any], lowered: float) -> Any:
        """Return a smooth bound of the largest value, upper unless `lowered`."""
        casadi = needed("casadi")
        top = values[0]
        for value in values[1:]:
            top = casadi.fmax(top, value)
        total = sum(casadi.exp(self.sharpness * (value - top)) for value in values)
        return top + (casadi.log(total) - lowered) / self.sharpness

    def _distance(self, row: Array, point: Any, n_dims: int) -> Any:
        """Return a smooth lower bound of a point's obstacle distance [m]. The point has the shape (n_dims,)."""
        casadi = needed("casadi")
        kind, size = int(row[sd.KIND]), row[sd.SIZE : sd.SIZE + 3]
        turn = row[sd.ROTATION : sd.ROTATION + 9].reshape(3, 3)[:n_dims]
        own = casadi.DM(turn.T) @ (point - casadi.DM(row[sd.CENTER : sd.CENTER + n_dims]))
        x, y, z = own[0], own[1], own[2]
        if kind == sd.SPHERE:
            return casadi.sqrt(x**2 + y**2 + z**2 + SMOOTH) - size[0]
        if kind == sd.CAPSULE:
            beyond = casadi.fmax(casadi.fabs(z) - size[1], 0.0)
            return casadi.sqrt(x**2 + y**2 + beyond**2 + SMOOTH) - size[0]
        if kind == sd.CYLINDER:
            radial = casadi.sqrt(x**2 + y**2 + SMOOTH) - size[0]
            return self._largest([radial, z - size[1], -z - size[1]], np.log(2))
        if kind == sd.ELLIPSOID:
            scaled = casadi.sqrt((x / size[0]) ** 2 + (y / size[1]) ** 2 + (z / size[2]) ** 2 + SMOOTH)
            return (scaled - 1.0) * min(size)
        sides = [sign * u - a for u, a in zip((x, y, z), size, strict=True) for sign in (1, -1)]
        return self._largest(sides[: 2 * n_dims], np.log(n_dims))
