"""Equation (4) of the paper and search penalties, evaluated over a population.

In unit duration and with T samples,

    J = c_goal 1/T sum_t sum_i |y_i - g_i|^2 + c_vel (T-1)^2/T sum_t sum_i |y_i(t+1) - y_i(t)|^2
        + c_obst 1/T sum_t sum_m I(the payload or an end effector is in obstacle m at t)
        + c_res 1/T sum_t sum_i |y_i - d_i|^2

where d_i is the demonstration transferred to manipulator i. The indicator I is reported; a search minimises a penalty
of penetration with a slope in its place (`ContactPenalty`), which is evaluated between the samples too. End effectors
that must stay apart are treated alike: their distance beyond the separation counts as a clearance.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.compiled import kernel
from comove.contacts.displaced import farthest_moved
from comove.contacts.query import Query, least_distance, near_things
from comove.contacts.surroundings import from_border, surroundings_of
from comove.dmp.basis import rollouts
from comove.geometry.surfaces import count_meshes
from comove.model.adaptation import N_STEPS
from comove.model.coordinates import Coordinates
from comove.model.motion import CoordinatedMotion
from comove.model.moving import Displacements
from comove.model.resting import recessions
from comove.model.scene import Scene
from comove.planning.objectives.criteria import PaperCost


@dataclass(frozen=True)
class Cost:
    """The terms of the objective, weighted, and their sum J."""

    goal: float
    velocity: float
    obstacle: float
    resemblance: float

    @property
    def total(self) -> float:
        """Return J, the sum of all terms."""
        return self.goal + self.velocity + self.obstacle + self.resemblance


class ContactPenalty(NamedTuple):
    """The penalty of obstacles in a search: ``slope * max(0, margin - d) + step * (d <= 0)``.

    Here d is the clearance beyond the scene's (`limits.clearance`).

    Attributes
    ----------
    margin : d from which on there is no penalty [m]
    slope : slope of the penalty [1/m]
    step : penalty of contact
    along_path : whether to weight by path length instead of time, so that passing an obstacle fast is not cheaper
    limits : share of the speed and acceleration limits that the search keeps to
    near : share of the speed limit, lowered by `limits`, from which on a motion counts as too fast
    between, parts : distance between poses that are checked [m], and most of them between two samples
    tolerance : of the distance along a payload's edge [m]
    """

    margin: float = 0.01
    slope: float = 50.0
    step: float = 10.0
    along_path: bool = False
    limits: float = 1.0
    near: float = 0.99
    between: float = 0.01
    parts: int = 6
    tolerance: float = 1e-4


class Evaluation(NamedTuple):
    """The values of a population, arrays of shape (n_rollouts,) unless said otherwise.

    Attributes
    ----------
    cost : J without its obstacle term
    penalty : penalty of obstacles, the border and separations
    clearance : least clearance that was found [m], capped at the scene's clearance plus the margin (at least a
        millimetre); for end effectors that must stay apart, the scene's clearance plus their distance beyond the
        separation; NaN where obstacles were left out
    hits : mean number of touched obstacles over the samples, the indicator term of (4)
    speed : largest speed of an end effector [m/s]
    acceleration : largest acceleration of an end effector [m/s^2]
    terms : array, shape (n_rollouts, 3), terms of goal, velocity and resemblance
    possible : whether the kinematics can execute the rollout
    """

    cost: Array
    penalty: Array
    clearance: Array
    hits: Array
    speed: Array
    acceleration: Array
    terms: Array
    possible: NDArray[np.bool_] | bool = True


@dataclass(frozen=True, eq=False)
class Objective:
    """Equation (4) on a scene, and the penalties of a search.

    Attributes
    ----------
    scene, coordinates : the scene, and the coordinates of the motions
    weights : weights of the terms
    penalty : penalty of obstacles in the search
    demonstration : array, shape (N_STEPS, n_manipulators, 3), demonstration transferred to every manipulator [m];
        None without one
    precision : array, shape (N_STEPS, n_hands * n_dims, n_hands * n_dims), of a demonstrated distribution; None for
        one movement
    """

    scene: Scene
    coordinates: Coordinates
    weights: PaperCost = field(default_factory=PaperCost)
    penalty: ContactPenalty = field(default_factory=ContactPenalty)
    demonstration: Array | None = None
    precision: Array | None = None

    def with_penalty(self, **changes: Any) -> Objective:
        """Return the objective with a changed penalty."""
        return replace(self, penalty=self.penalty._replace(**changes))

    def evaluate(self, q: Array, size: float = 1.0, limited: bool = False) -> Evaluation:
        """Evaluate a population of configurations over time.

        Parameters
        ----------
        q : array, shape (n_rollouts, n_columns, n_steps)
        size : size of the payload, 1 for the real one
        limited : whether to leave out the obstacles of rollouts beyond the limits
        """
        nodes = self.coordinates.nodes(q, size)
        return self.evaluate_nodes(nodes, self.scene.displacements_along(nodes.shape[1]), limited)

    def evaluate_nodes(self, nodes: Array, moved: Displacements, limited: bool = False) -> Evaluation:
        """Evaluate a population of node positions over time.

        Parameters
        ----------
        nodes : array, shape (n_rollouts, n_steps, n_nodes, 3), evenly spaced in time [m]
        moved : displacements of obstacles at the steps; none if nothing moves
        limited : as of `evaluate`
        """
        scene, w, p, around = self.scene, self.weights, self.penalty, surroundings_of(self.scene)
        n_hands = len(scene.manipulators)
        offsets = moved.offsets[None]
        if scene.rests:  # supports recede from every rollout by itself
            receded = recessions(scene, nodes)[:, :, scene.owners]
            moved = moved.shifted(receded[0])
            offsets = receded + (offsets if offsets.shape[1] else 0.0)
            offsets.setflags(write=False)
        taught, c_res = np.zeros((0, n_hands, 3)), 0.0
        if self.demonstration is not None and w.resemblance > 0:
            taught, c_res = self.demonstration, w.resemblance
        fastest, hardest = np.inf, np.inf
        if limited:  # and not by rounding alone
            share = (1.0 + 1e-9) * p.limits
            fastest, hardest = share * p.near * scene.speed_limit, share * scene.acceleration_limit
        return Evaluation(
            *_evaluate(
                around,
                nodes,
                n_hands,
                moved,
                offsets,
                taught,
                np.array([w.goal, w.velocity, c_res, scene.duration]),
                np.array([fastest, hardest]),
                p._replace(margin=p.margin + scene.clearance),
                scene.clearance,
            )
        )

    def search_value(self, evaluation: Evaluation) -> Array:
        """Return the search objective: cost plus penalties of obstacles and limits; shape (n_rollouts,)."""
        value = evaluation.cost + evaluation.penalty
        speed, acceleration = self.limit_ratios(evaluation)
        near = self.penalty.near
        value = value + np.where(speed > near, 0.5 * (speed - near) + 0.005, 0.0)
        return value + 0.1 * np.maximum(0.0, acceleration - 0.97)

    def limit_ratios(self, evaluation: Evaluation) -> tuple[Array, Array]:
        """Return speed and acceleration divided by their limits in the search; arrays, shape (n_rollouts,)."""
        return (
            evaluation.speed / (self.penalty.limits * self.scene.speed_limit),
            evaluation.acceleration / (self.penalty.limits * self.scene.acceleration_limit),
        )

    def feasible(self, evaluation: Evaluation) -> NDArray[np.bool_]:
        """Return which rollouts are feasible at the samples; array of bool, shape (n_rollouts,)."""
        speed, acceleration = self.limit_ratios(evaluation)
        clear = evaluation.clearance > self.scene.clearance
        return clear & (speed <= self.penalty.near) & (acceleration <= 1.0) & evaluation.possible

    def cost(self, motion: CoordinatedMotion) -> Cost:
        """Return the terms of J of one motion."""
        return self.cost_of(
            self.evaluate(rollouts(motion.basis, motion.boundary, motion.weights[None], N_STEPS))
        )

    def cost_of(self, value: Evaluation) -> Cost:
        """Return the terms of J of the first rollout of an evaluation."""
        goal, velocity, resemblance = value.terms[0]
        return Cost(
            float(goal), float(velocity), self.weights.obstacle * float(value.hits[0]), float(resemblance)
        )


@kernel
def _evaluate(around, nodes, n_hands, moved, offsets, taught, cost_weights, largest, contact, needed):
    n_rollouts, n_steps = nodes.shape[0], nodes.shape[1]
    c_goal, c_vel, c_res, duration = cost_weights[0], cost_weights[1], cost_weights[2], cost_weights[3]
    terms, total = np.zeros((n_rollouts, 3)), np.zeros(n_rollouts)
    speed, acceleration = np.zeros(n_rollouts), np.zeros(n_rollouts)
    penalty, clearance, hits = np.zeros(n_rollouts), np.zeros(n_rollouts), np.zeros(n_rollouts)
    rate = (n_steps - 1) / duration
    near = np.empty(around.convex.shape[0] + count_meshes(around.surfaces), dtype=np.int64)
    normals = np.full((around.solids.shape[0], near.shape[0], 3), 1.0 / sqrt(3.0))
    scratch = near, normals, np.empty((nodes.shape[2], 3)), np.empty(around.obstacles.shape[0])
    for k in range(n_rollouts):
        x = nodes[k]
        fastest, hardest = 0.0, 0.0
        for t in range(n_steps):
            for i in range(n_hands):
                step, bent = 0.0, 0.0
                for axis in range(3):
                    terms[k, 0] += (x[t, i, axis] - x[n_steps - 1, i, axis]) ** 2
                    if c_res > 0.0:
                        terms[k, 2] += (x[t, i, axis] - taught[t, i, axis]) ** 2
                    if t + 1 < n_steps:
                        step += (x[t + 1, i, axis] - x[t, i, axis]) ** 2
                    if 0 < t < n_steps - 1:
                        bent += (x[t + 1, i, axis] - 2 * x[t, i, axis] + x[t - 1, i, axis]) ** 2
                    elif t == 0:  # at rest: as if mirrored in time
                        bent += (2 * (x[1, i, axis] - x[0, i, axis])) ** 2
                terms[k, 1] += step
                fastest, hardest = max(fastest, step), max(hardest, bent)
        terms[k, 0] *= c_goal / n_steps
        terms[k, 1] *= c_vel * (n_steps - 1) ** 2 / n_steps
        terms[k, 2] *= c_res / n_steps
        total[k] = terms[k, 0] + terms[k, 1] + terms[k, 2]
        speed[k], acceleration[k] = sqrt(fastest) * rate, sqrt(hardest) * rate * rate
        if speed[k] > largest[0] or acceleration[k] > largest[1]:
            clearance[k] = np.nan
            continue
        own = Displacements(offsets[min(k, offsets.shape[0] - 1)], moved.angles, moved.axes, moved.centers)
        penalty[k], clearance[k], hits[k] = _obstacle_penalty(around, x, own, contact, needed, scratch)
    return total, penalty, clearance, hits, speed, acceleration, terms


@kernel(counted=False)
def _obstacle_penalty(around, x, moved, contact, needed, scratch):
    """Return a rollout's penalty, least clearance and mean number of touched obstacles. The clearance is capped.

    Parameters
    ----------
    around : Surroundings
    x : array, shape (n_steps, n_nodes, 3) [m]
    moved : Displacements of the obstacles at the steps
    contact : ContactPenalty, whose margin is one of the clearance itself
    needed : clearance that the scene requires [m]
    scratch : arrays for near things, directions of `Query`, keypoints, and distances by obstacle
    """
    margin, n_steps, n_rows = contact.margin, x.shape[0], around.obstacles.shape[0]
    near, normals, pose, least_of = scratch
    cap = max(margin, needed + 1e-3)  # nothing beyond it counts
    total, least, n_touched, thickest = 0.0, cap, 0, 0.0
    for e in range(around.radii.shape[0]):
        thickest = max(thickest, around.radii[e])
    for t in range(n_steps):
        after = min(t + 1, n_steps - 1)
        longest = _longest(x, t, after)
        if not longest < 1e6:  # not finite, or as good as
            return np.inf, -np.inf, float(n_rows)
        relative = longest + farthest_moved(moved, around.obstacles, t, after)
        parts = min(1 + int(relative / contact.between), contact.parts)
        reach = cap + relative
        n_near = near_things(around, moved, (t, t, 0.0), x[t], reach + thickest, near)
        at_border = from_border(around, x[t]) < reach
        apart = cap
        for i in range(around.separations.shape[0]):
            spare = (
                chord_distance(x, t, after, around.pairs[i, 0], around.pairs[i, 1]) - around.separations[i]
            )
            apart = min(apart, needed + spare)
        if n_near == 0 and not at_border and apart >= cap:
            continue
        weight = (longest if contact.along_path else 1.0 / n_steps) / parts
        for part in range(parts):
            share, d = part / parts, apart
            _between(x, t, after, share, pose)
            if at_border:
                d = min(d, from_border(around, pose))
            least_of[:] = cap
            noted = least_of[: n_rows if part == 0 else 0]
            query = Query(near[:n_near], normals, noted, contact.tolerance, 0.0)
            d = least_distance(around, moved, (t, after, share), pose, query, d, -np.inf)
            for distance in noted:
                n_touched += distance <= 0.0
            if d < margin:
                total += weight * contact.slope * (margin - d)
            if d <= needed:
                total += weight * contact.step
            least = min(least, d)
    return total, least, n_touched / n_steps


@kernel(counted=False)
def _longest(x, t, after):
    """Return the largest distance that any node moves between two samples [m]."""
    longest = 0.0
    for n in range(x.shape[1]):
        moved = 0.0
        for axis in range(3):
            moved += (x[after, n, axis] - x[t, n, axis]) ** 2
        if not moved < np.inf:
            return np.inf
        longest = max(longest, moved)
    return sqrt(longest)


@kernel(counted=False)
def _between(x, t, after, f, out):
    for n in range(x.shape[1]):
        for axis in range(3):
            out[n, axis] = x[t, n, axis] + f * (x[after, n, axis] - x[t, n, axis])


@kernel(counted=False)
def chord_distance(x, t, after, i, j):
    """Return the least distance [m] of two end effectors between two samples. Both move straight."""
    along, step = 0.0, 0.0
    for axis in range(3):
        here, there = x[t, i, axis] - x[t, j, axis], x[after, i, axis] - x[after, j, axis]
        along -= here * (there - here)
        step += (there - here) ** 2
    f = min(1.0, max(0.0, along / max(step, 1e-300)))
    square = 0.0
    for axis in range(3):
        here, there = x[t, i, axis] - x[t, j, axis], x[after, i, axis] - x[after, j, axis]
        square += (here + f * (there - here)) ** 2
    return sqrt(square)
