"""The objective, equation (4) of the paper, and the penalties of the search, in one pass over a population.

In unit duration and with T samples,

    J = c_goal 1/T sum_t sum_i |y_i - g_i|^2 + c_vel (T-1)^2/T sum_t sum_i |y_i(t+1) - y_i(t)|^2
        + c_obst 1/T sum_t sum_m I(the load or a hand is in obstacle m at t)
        + c_res 1/T sum_t sum_i |y_i - d_i|^2

where d_i is the demonstration transferred to manipulator i. The indicator I is reported; a search minimises a penalty
of penetration with a slope in its place (`ContactPenalty`), which is evaluated between the samples too. Hands that
must stay apart are treated alike: their distance beyond the separation counts as a clearance.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.compiled import kernel
from comove.dmp.basis import rollouts
from comove.geometry.distances import CENTER, REACH, point_distance, segment_distance
from comove.geometry.solids import count_solids, empty_solid, solid_at, solid_distance
from comove.geometry.surfaces import signed_distance
from comove.model.coordinates import Coordinates
from comove.model.motion import CoordinatedMotion
from comove.model.resting import recessions
from comove.model.scene import Scene
from comove.planning.objectives.criteria import PaperCost
from comove.planning.surroundings import from_border, seen_from, solids_from_mesh, surroundings_of

Array = NDArray[np.float64]

N_STEPS = 201


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

    Here d is the clearance beyond the one that the scene asks for (`limits.clearance`).

    Attributes
    ----------
    margin : d from which on there is no penalty [m]
    slope : slope of the penalty [1/m]
    step : penalty of contact
    along_path : whether to weight by path length instead of time, so that passing an obstacle fast is not cheaper
    limits : share of the speed and acceleration limits that the search keeps to
    near : share of the speed limit, lowered by `limits`, from which on a motion counts as too fast
    between, parts : distance between poses that are checked [m], and most of them between two samples
    tolerance : of the distance along a load's edge [m]
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
        millimetre); for hands that must stay apart, the scene's clearance plus their distance beyond the separation
    hits : mean number of touched obstacles over the samples, the indicator term of (4)
    speed : largest speed of a hand [m/s]
    acceleration : largest acceleration of a hand [m/s^2]
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

    def evaluate(self, q: Array, size: float = 1.0) -> Evaluation:
        """Evaluate a population of configurations over time.

        Parameters
        ----------
        q : array, shape (n_rollouts, n_columns, n_steps)
        size : size of the load, 1 for the real one
        """
        nodes = self.coordinates.nodes(q, size)
        return self.evaluate_nodes(nodes, self.scene.displacements_along(nodes.shape[1]).offsets)

    def evaluate_nodes(self, nodes: Array, offsets: Array) -> Evaluation:
        """Evaluate a population of node positions over time.

        Parameters
        ----------
        nodes : array, shape (n_rollouts, n_steps, n_nodes, 3), evenly spaced in time [m]
        offsets : array, shape (n_steps, n_rows, 3), displacements of obstacles by row of the table [m]; n_steps = 0
            if none moves
        """
        scene, w, p, around = self.scene, self.weights, self.penalty, surroundings_of(self.scene)
        n_hands = len(scene.manipulators)
        offsets = offsets[None]
        if scene.rests:  # supports recede from every rollout by itself
            receded = recessions(scene, nodes)
            offsets = receded[:, :, scene.owners] + (offsets if offsets.shape[1] else 0.0)
        offsets.setflags(write=False)  # always: kernels are compiled for what may be written, or may not
        taught, c_res = np.zeros((0, n_hands, 3)), 0.0
        if self.demonstration is not None and w.resemblance > 0:
            taught, c_res = self.demonstration, w.resemblance
        return Evaluation(
            *_evaluate(
                around._replace(obstacles=around.obstacles.copy()),
                nodes,
                n_hands,
                offsets,
                taught,
                np.array([w.goal, w.velocity, c_res, scene.duration]),
                p._replace(margin=p.margin + scene.clearance),
                scene.clearance,
            )
        )

    def search_value(self, evaluation: Evaluation) -> Array:
        """Return what a search minimises: cost plus penalties of obstacles and limits; shape (n_rollouts,)."""
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
def _evaluate(around, nodes, n_hands, offsets, taught, cost_weights, contact, needed):
    n_rollouts, n_steps = nodes.shape[0], nodes.shape[1]
    c_goal, c_vel, c_res, duration = cost_weights[0], cost_weights[1], cost_weights[2], cost_weights[3]
    terms, total = np.zeros((n_rollouts, 3)), np.zeros(n_rollouts)
    origin = around.obstacles[:, CENTER : CENTER + 3].copy()
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
                    elif t == 0:  # at rest: as if mirrored in time
                        bent += (2 * (x[1, i, axis] - x[0, i, axis])) ** 2
                terms[k, 1] += moved
                fastest, hardest = max(fastest, moved), max(hardest, bent)
        terms[k, 0] *= c_goal / n_steps
        terms[k, 1] *= c_vel * (n_steps - 1) ** 2 / n_steps
        terms[k, 2] *= c_res / n_steps
        total[k] = terms[k, 0] + terms[k, 1] + terms[k, 2]
        speed[k], acceleration[k] = sqrt(fastest) * rate, sqrt(hardest) * rate * rate
        seen = offsets[min(k, offsets.shape[0] - 1)]
        penalty[k], clearance[k], hits[k] = _obstacle_penalty(around, x, seen, origin, contact, needed)
    return total, penalty, clearance, hits, speed, acceleration, terms


@kernel
def _obstacle_penalty(around, x, offsets, origin, contact, needed):
    """Return penalty, least clearance (capped) and mean number of touched obstacles of one rollout.

    Parameters
    ----------
    around : Surroundings, whose table of obstacles is written to where these move
    x : array, shape (n_steps, n_nodes, 3) [m]
    offsets : array, shape (n_steps, n_rows, 3), displacements of the obstacles; n_steps = 0 if none moves [m]
    origin : array, shape (n_rows, 3), centres of the obstacles in the scene [m]
    contact : ContactPenalty, whose margin is one of the clearance itself
    needed : clearance that the scene asks for [m]
    """
    margin = contact.margin
    n_steps, n_rows = x.shape[0], around.obstacles.shape[0]
    near, near_meshes = np.empty(n_rows, dtype=np.int64), np.empty(n_rows, dtype=np.int64)
    pose = np.empty((x.shape[1], 3))
    normals = np.full((count_solids(around.solids), n_rows, 3), 1.0 / sqrt(3.0))  # that parted them last
    # The last sample, counted from 1, at which each obstacle was touched; in the end, how often any was.
    touched = np.zeros(n_rows + 1, dtype=np.int64)
    cap = max(margin, needed + 1e-3)  # nothing beyond it is looked at
    total, least, thickest = 0.0, cap, 0.0
    for e in range(around.radii.shape[0]):
        thickest = max(thickest, around.radii[e])
    for t in range(n_steps):
        after = min(t + 1, n_steps - 1)
        longest = _longest(x, t, after)
        if not longest < 1e6:  # not finite, or as good as
            return np.inf, -np.inf, float(n_rows)
        relative = longest + _farthest(offsets, t, after)
        parts = min(1 + int(relative / contact.between), contact.parts)
        reach = cap + thickest + relative
        _move(around.obstacles, origin, offsets, t, after, 0.0)
        n_near, at_border = _near_obstacles(around, x, t, reach, near)
        n_meshes = _near_meshes(around.surfaces, around.obstacles, x, t, reach, near_meshes)
        apart = cap
        for i in range(around.separations.shape[0]):
            spare = (
                chord_distance(x, t, after, around.pairs[i, 0], around.pairs[i, 1]) - around.separations[i]
            )
            apart = min(apart, needed + spare)
        if n_near == 0 and n_meshes == 0 and not at_border and apart >= cap:
            continue
        weight = (longest if contact.along_path else 1.0 / n_steps) / parts
        for part in range(parts):
            _between(x, t, after, part / parts, pose)
            _move(around.obstacles, origin, offsets, t, after, part / parts)
            sample, d = t + 1 if part == 0 else 0, apart
            if at_border:
                d = min(d, from_border(around, pose))
            d = min(d, _of_rods(around, pose, near[:n_near], cap, sample, touched, contact.tolerance))
            d = min(d, _of_solids(around.solids, around, pose, near[:n_near], cap, sample, touched, normals))
            d = min(
                d, _from_meshes(around.surfaces, around, pose, near_meshes[:n_meshes], cap, sample, touched)
            )
            if d < margin:
                total += weight * contact.slope * (margin - d)
            if d <= needed:
                total += weight * contact.step
            least = min(least, d)
    return total, least, touched[n_rows] / n_steps


@kernel
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


@kernel
def _between(x, t, after, f, out):
    """Write the points of x at a share f of the time between two samples."""
    for n in range(x.shape[1]):
        for axis in range(3):
            out[n, axis] = x[t, n, axis] + f * (x[after, n, axis] - x[t, n, axis])


@kernel
def _note(distance, owner, sample, touched):
    """Note that an obstacle is touched at a sample, once; sample 0 is none."""
    if distance <= 0.0 and sample > 0 and touched[owner] != sample:
        touched[owner] = sample
        touched[-1] += 1


@kernel
def _move(obstacles, origin, offsets, t, after, f):
    """Move the rows of the table to where obstacles are at a share f of the time between two samples."""
    for j in range(origin.shape[0] if offsets.shape[0] > 0 else 0):
        for axis in range(3):
            moved = offsets[t, j, axis] + f * (offsets[after, j, axis] - offsets[t, j, axis])
            obstacles[j, CENTER + axis] = origin[j, axis] + moved


@kernel
def _of_rods(around, pose, near, cap, sample, touched, tolerance):
    """Return the clearance [m] of the load's rods from the obstacles that are near."""
    d = cap
    for e in range(around.edges.shape[0]):
        p, q, r = pose[around.edges[e, 0]], pose[around.edges[e, 1]], around.radii[e]
        for j in near:
            distance = segment_distance(
                around.obstacles, j, p[0], p[1], p[2], q[0], q[1], q[2], cap + r, tolerance
            )
            d = min(d, distance - r)
            _note(distance - r, around.owners[j], sample, touched)
    return d


@kernel
def _of_solids(solids, around, pose, near, cap, sample, touched, normals):
    """Return the clearance [m] of the load's solids from the obstacles that are near."""
    d = cap
    if solids is None:
        return d
    solid = empty_solid(solids)
    for s in range(solids.shape[0]):
        solid_at(pose, solids[s], solid)
        for j in near:
            distance = solid_distance(around.obstacles, j, solid, cap, normals[s, j])[0]
            d = min(d, distance)
            _note(distance, around.owners[j], sample, touched)
    return d


@kernel
def _from_meshes(surfaces, around, pose, near, cap, sample, touched):
    """Return the clearance [m] of the whole load from the meshes that are near."""
    d = cap
    if surfaces is None:
        return d
    for mesh in near:
        for e in range(around.edges.shape[0]):
            hull, r = seen_from(surfaces, mesh, around.obstacles, pose, around.edges[e]), around.radii[e]
            distance = signed_distance(surfaces, mesh, hull, cap + r) - r
            d = min(d, distance)
            _note(distance, surfaces.owner[mesh], sample, touched)
        distance = solids_from_mesh(around.solids, surfaces, mesh, around.obstacles, pose, cap)
        d = min(d, distance)
        _note(distance, surfaces.owner[mesh], sample, touched)
    return d


@kernel
def chord_distance(x, t, after, i, j):
    """Return the least distance [m] of the hands i and j while both go straight from sample t to sample `after`."""
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


@kernel
def _farthest(offsets, t, after):
    """Return the largest distance that any obstacle moves between two samples [m]."""
    farthest = 0.0
    for j in range(offsets.shape[1] if offsets.shape[0] > 0 else 0):
        moved = 0.0
        for axis in range(3):
            moved += (offsets[after, j, axis] - offsets[t, j, axis]) ** 2
        farthest = max(farthest, moved)
    return sqrt(farthest)


@kernel
def _near_meshes(surfaces, obstacles, x, t, cutoff, near):
    """Write into `near` the meshes whose boxes are within `cutoff` of the body's box; return their number."""
    count = 0
    if surfaces is None:
        return count
    for mesh in range(surfaces.root.shape[0]):
        box, away = surfaces.root[mesh], 0.0
        for axis in range(3):
            shift = obstacles[surfaces.row[mesh], CENTER + axis] - surfaces.center[mesh, axis]
            low, high = x[t, :, axis].min() - shift, x[t, :, axis].max() - shift
            away = max(away, surfaces.lower[box, axis] - high, low - surfaces.upper[box, axis])
        if away < cutoff:
            near[count] = mesh
            count += 1
    return count


@kernel
def _near_obstacles(around, x, t, cutoff, near):
    """Write into `near` the obstacles within `cutoff` of the body's bounding ball.

    Returns
    -------
    count : number of these obstacles
    at_border : whether the border of the workspace is within `cutoff` as well
    """
    n_nodes = x.shape[1]
    cx, cy, cz = 0.0, 0.0, 0.0
    for n in range(n_nodes):
        cx += x[t, n, 0] / n_nodes
        cy += x[t, n, 1] / n_nodes
        cz += x[t, n, 2] / n_nodes
    reach = 0.0
    for n in range(n_nodes):
        reach = max(reach, (x[t, n, 0] - cx) ** 2 + (x[t, n, 1] - cy) ** 2 + (x[t, n, 2] - cz) ** 2)
    reach = sqrt(reach) + cutoff
    count, obstacles, lower, upper = 0, around.obstacles, around.lower, around.upper
    for j in around.convex:
        dx, dy, dz = cx - obstacles[j, CENTER], cy - obstacles[j, CENTER + 1], cz - obstacles[j, CENTER + 2]
        far = obstacles[j, REACH] + reach
        if dx * dx + dy * dy + dz * dz < far * far and point_distance(obstacles, j, cx, cy, cz) < reach:
            near[count] = j
            count += 1
    border = min(cx - lower[0], upper[0] - cx, cy - lower[1], upper[1] - cy)
    return count, min(border, cz - lower[2], upper[2] - cz) < reach
