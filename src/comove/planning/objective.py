"""The objective, equation (4) of the paper, and what the search adds to it, in one pass over a population.

In unit duration and with T samples,

    J = c_goal 1/T sum_t sum_i |y_i - g_i|^2 + c_vel (T-1)^2/T sum_t sum_i |y_i(t+1) - y_i(t)|^2
        + c_obst 1/T sum_t sum_m I(the load or a hand is in obstacle m at t)
        + c_res 1/T sum_t sum_i |y_i - d_i|^2

where d_i is the demonstration carried to manipulator i. The indicator is what is reported; a search sees
in its place a penetration term with a slope (`Penalty`), taken between the samples too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from comove.coordination.coordinates import Coordinates
from comove.coordination.motion import CoordinatedMotion
from comove.scenes.distances import point_distance, segment_distance
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

N_STEPS = 201
SUB_STEP, MAX_SUB_STEPS = 0.01, 6  # m between poses looked at, and how many between two samples
TOLERANCE = 1e-4  # m, of the distance along a load's edge while searching
NEAR_LIMIT = 0.99  # of a speed limit, kept by the search


@dataclass(frozen=True)
class CostWeights:
    """Relative importance of the terms of equation (4), and of what was taught.

    Attributes
    ----------
    goal, velocity, obstacle : c_goal, c_vel, c_obst
    resemblance : how much the shape of the demonstration counts; 0 where it is only a start
    """

    goal: float = 1.0
    velocity: float = 0.01
    obstacle: float = 10.0
    resemblance: float = 0.0


@dataclass(frozen=True)
class Cost:
    """The terms of the objective, weighted, and their sum J."""

    goal: float
    velocity: float
    obstacle: float
    resemblance: float

    @property
    def total(self) -> float:
        """J."""
        return self.goal + self.velocity + self.obstacle + self.resemblance


@dataclass(frozen=True)
class Penalty:
    """How a search feels obstacles: ``slope * max(0, margin - d) + step * (d <= 0)``, d the clearance.

    Attributes
    ----------
    margin : clearance from which on nothing is felt [m], on top of the scene's own
    slope : [1/m]
    step : cost of contact
    along_path : weigh by path length instead of time, so that rushing through an obstacle does not pay
    """

    margin: float = 0.01
    slope: float = 50.0
    step: float = 10.0
    along_path: bool = False


class Evaluation(NamedTuple):
    """Values of a population, arrays of shape (n_rollouts,).

    Attributes
    ----------
    cost : J without its obstacle term
    penalty : of obstacles
    clearance : least one seen [m], at most the margin
    hits : mean number of obstacles touched over the samples, the indicator term of (4)
    speed : largest of a hand [m/s]
    acceleration : largest of a hand [m/s^2]
    terms : array, shape (n_rollouts, 3): goal, velocity and resemblance terms
    """

    cost: Array
    penalty: Array
    clearance: Array
    hits: Array
    speed: Array
    acceleration: Array
    terms: Array


@dataclass(frozen=True, eq=False)
class Objective:
    """Equation (4) on a scene.

    Attributes
    ----------
    scene, coordinates : what is evaluated, and in which coordinates
    weights : of the terms
    penalty : what the search sees of obstacles
    demonstration : array, shape (N_STEPS, n_manipulators, 3) [m], what was taught carried to every
        manipulator; None where there is nothing to resemble
    """

    scene: Scene
    coordinates: Coordinates
    weights: CostWeights = CostWeights()
    penalty: Penalty = Penalty()
    demonstration: Array | None = None

    def with_penalty(self, **changes: object) -> Objective:
        """The same objective with another penalty."""
        return replace(self, penalty=replace(self.penalty, **changes))

    def evaluate(self, q: Array, size: float = 1.0) -> Evaluation:
        """Evaluate a population.

        Parameters
        ----------
        q : array, shape (n_rollouts, n_columns, n_steps)
        size : of the load
        """
        scene, w, p = self.scene, self.weights, self.penalty
        nodes = self.coordinates.nodes(q, size)
        n_hands = len(scene.manipulators)
        taught, c_res = np.zeros((0, n_hands, 3)), 0.0
        if self.demonstration is not None and w.resemblance > 0:
            taught, c_res = self.demonstration, w.resemblance
        return Evaluation(
            *_evaluate(
                nodes,
                n_hands,
                scene.body.edges,
                scene.body.radii,
                scene.obstacles,
                *scene.workspace,
                taught,
                np.array([w.goal, w.velocity, c_res, scene.duration]),
                np.array([p.margin + scene.clearance, p.slope, p.step, scene.clearance]),
                p.along_path,
            )
        )

    def search_value(self, evaluation: Evaluation) -> Array:
        """What a search minimises: cost, penalties of obstacles and of broken limits; shape (n_rollouts,)."""
        value = evaluation.cost + evaluation.penalty
        speed, acceleration = self.limit_ratios(evaluation)
        value = value + np.where(speed > NEAR_LIMIT, 0.5 * (speed - NEAR_LIMIT) + 0.005, 0.0)
        return value + 0.1 * np.maximum(0.0, acceleration - 0.97)

    def limit_ratios(self, evaluation: Evaluation) -> tuple[Array, Array]:
        """Speed and acceleration over their limits; arrays, shape (n_rollouts,)."""
        return (
            evaluation.speed / self.scene.speed_limit,
            evaluation.acceleration / self.scene.acceleration_limit,
        )

    def feasible(self, evaluation: Evaluation) -> NDArray[np.bool_]:
        """Which rollouts look verifiable; shape (n_rollouts,)."""
        speed, acceleration = self.limit_ratios(evaluation)
        clear = evaluation.clearance > self.scene.clearance
        return clear & (speed <= NEAR_LIMIT) & (acceleration <= 1.0)

    def cost(self, motion: CoordinatedMotion) -> Cost:
        """The terms of J of one motion."""
        boundary, shape = motion.basis.at(np.linspace(0.0, 1.0, N_STEPS))
        q = boundary[0] @ motion.boundary + shape[0] @ motion.weights.T
        value = self.evaluate(np.ascontiguousarray(q.T[None]))
        goal, velocity, resemblance = value.terms[0]
        return Cost(
            float(goal), float(velocity), self.weights.obstacle * float(value.hits[0]), float(resemblance)
        )


@numba.njit(cache=True)
def _evaluate(
    nodes, n_hands, edges, radii, obstacles, lower, upper, taught, cost_weights, penalty_weights, along_path
):
    n_rollouts, n_steps = nodes.shape[0], nodes.shape[1]
    c_goal, c_vel, c_res, duration = cost_weights
    terms = np.zeros((n_rollouts, 3))
    speed, acceleration = np.zeros(n_rollouts), np.zeros(n_rollouts)
    penalty, clearance, hits = np.zeros(n_rollouts), np.zeros(n_rollouts), np.zeros(n_rollouts)
    rate = (n_steps - 1) / duration
    for k in range(n_rollouts):
        x = nodes[k]
        fastest, hardest = 0.0, 0.0
        for t in range(n_steps):
            for i in range(n_hands):
                moved, bent = 0.0, 0.0
                for axis in range(3):
                    terms[k, 0] += (x[t, i, axis] - x[n_steps - 1, i, axis]) ** 2
                    if c_res > 0.0:
                        terms[k, 2] += (x[t, i, axis] - taught[t, i, axis]) ** 2
                    if t + 1 < n_steps:
                        moved += (x[t + 1, i, axis] - x[t, i, axis]) ** 2
                    if 0 < t < n_steps - 1:
                        bent += (x[t + 1, i, axis] - 2 * x[t, i, axis] + x[t - 1, i, axis]) ** 2
                terms[k, 1] += moved
                fastest, hardest = max(fastest, moved), max(hardest, bent)
        terms[k, 0] *= c_goal / n_steps
        terms[k, 1] *= c_vel * (n_steps - 1) ** 2 / n_steps
        terms[k, 2] *= c_res / n_steps
        speed[k], acceleration[k] = sqrt(fastest) * rate, sqrt(hardest) * rate * rate
        penalty[k], clearance[k], hits[k] = _obstacle_penalty(
            x, edges, radii, obstacles, lower, upper, penalty_weights, along_path
        )
    return terms.sum(axis=1), penalty, clearance, hits, speed, acceleration, terms


@numba.njit(cache=True)
def _obstacle_penalty(x, edges, radii, obstacles, lower, upper, penalty_weights, along_path):
    """Penalty, least clearance (capped at the margin) and mean number of touched obstacles of one rollout."""
    margin, slope, step, needed = penalty_weights
    n_steps, n_nodes, n_obstacles = x.shape[0], x.shape[1], obstacles.kind.shape[0]
    pose = np.empty((n_nodes, 3))
    near = np.empty(n_obstacles, dtype=np.int64)
    touched = np.zeros(n_obstacles, dtype=np.bool_)
    total, least, hits = 0.0, margin, 0
    thickest = radii.max()
    for t in range(n_steps):
        last = t == n_steps - 1
        after = t if last else t + 1
        longest = 0.0
        for n in range(n_nodes):
            moved = 0.0
            for axis in range(3):
                if not np.isfinite(x[t, n, axis]):
                    return np.inf, -np.inf, float(n_obstacles)
                moved += (x[after, n, axis] - x[t, n, axis]) ** 2
            longest = max(longest, moved)
        longest = sqrt(longest)
        parts = 1 if last else min(1 + int(longest / SUB_STEP), MAX_SUB_STEPS)
        n_near, at_border = _near_obstacles(
            x[t], margin + thickest + longest, obstacles, lower, upper, near
        )
        weight = (longest if along_path else 1.0 / n_steps) / parts
        if n_near == 0 and not at_border:
            continue
        for part in range(parts):
            f = part / parts
            for n in range(n_nodes):
                for axis in range(3):
                    pose[n, axis] = x[t, n, axis] + f * (x[after, n, axis] - x[t, n, axis])
            d = margin
            touched[:n_near] = False
            for e in range(edges.shape[0]):
                p, q, r = pose[edges[e, 0]], pose[edges[e, 1]], radii[e]
                if at_border:
                    for axis in range(3):
                        d = min(d, min(p[axis], q[axis]) - lower[axis] - r)
                        d = min(d, upper[axis] - max(p[axis], q[axis]) - r)
                for i in range(n_near):
                    distance = segment_distance(obstacles, near[i], p, q, margin + r, TOLERANCE) - r
                    d = min(d, distance)
                    touched[i] |= distance <= 0.0
            if d < margin:
                total += weight * slope * (margin - d)
            if d <= needed:
                total += weight * step
            least = min(least, d)
            if part == 0:
                hits += touched[:n_near].sum()
    return total, least, hits / n_steps


@numba.njit(cache=True)
def _near_obstacles(pose, cutoff, obstacles, lower, upper, near):
    """List in `near` the obstacles within `cutoff` of a body's bounding ball; is the border that near too?"""
    n_nodes = pose.shape[0]
    cx, cy, cz = 0.0, 0.0, 0.0
    for n in range(n_nodes):
        cx += pose[n, 0] / n_nodes
        cy += pose[n, 1] / n_nodes
        cz += pose[n, 2] / n_nodes
    reach = 0.0
    for n in range(n_nodes):
        reach = max(reach, (pose[n, 0] - cx) ** 2 + (pose[n, 1] - cy) ** 2 + (pose[n, 2] - cz) ** 2)
    reach = sqrt(reach) + cutoff
    count = 0
    for j in range(obstacles.kind.shape[0]):
        dx, dy, dz = cx - obstacles.center[j, 0], cy - obstacles.center[j, 1], cz - obstacles.center[j, 2]
        far = obstacles.reach[j] + reach
        if dx * dx + dy * dy + dz * dz < far * far and point_distance(obstacles, j, cx, cy, cz) < reach:
            near[count] = j
            count += 1
    border = min(cx - lower[0], upper[0] - cx, cy - lower[1], upper[1] - cy)
    return count, min(border, cz - lower[2], upper[2] - cz) < reach
