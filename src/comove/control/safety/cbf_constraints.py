"""Rows of the safety filter, in numba kernels.

The variables x are the free velocities of all groups in m/s; the twist of group g is ``basis[g] x``. A row
``A[i] x >= low[i]`` requires that a point p of a body approaches an obstacle no faster than the remaining distance h
allows:

    n . (v + w x r - velocity of the obstacle at p) >= -rate(h),     rate(h) = min(gain h, about sqrt(2 a h)).

This is a control barrier function (Ames et al., 2017). The square root lets a body that approaches at this rate brake
with the deceleration a. Among several obstacles, or when passing one quickly, it must also be possible to brake along
the present path: a body of speed V stops in V/(2a) times its present approach, so the gain is at most 2a/V, and
slowing down along this path is admissible in every next step.

`first_rows` writes the rows of obstacles that are near now. `missing_rows` computes the exact step of a solution,
finds the nearest points after it, and writes the rows that are violated there: the programme has a row for every
point of the payload, but only those that matter are ever written (cutting planes: Kelley, 1960). The limits of
velocities, accelerations and rotations are treated in the same way.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from comove.arrays import Array
from comove.compiled import kernel
from comove.control.safety.control_points import moved_obstacles
from comove.control.safety.limits import bent_limits, broken_limits, length_of, limit_rows
from comove.control.safety.qp_workspace import BORDER, HANDS, QP, Freedom, QPWorkspace, Rates, Sighting
from comove.control.safety.twists import place, step, turn_into
from comove.geometry.closest_points import (
    N_PARTS,
    near_on_edge,
    near_on_part,
    near_on_solid,
    solid_gradient,
)
from comove.geometry.distances import CENTER, REACH, TINY, distance_and_gradient, point_distance
from comove.geometry.solids import empty_solid, solid_at
from comove.model.coordinates import HandPoses

Direction = tuple[float, float, float]

BEND = 0.05  # of a distance: allowance of a step for second-order terms
ROUNDING = 1e-9  # m, by which a clearance may be missed
SPARE = 2e-6  # m/s, by which rows that a step has broken are kept the next time: rounds come to an end
RESERVE = 1e-7  # m, kept on top of every clearance, so that rounding never uses it up


@kernel
def rate(h: float, gain: float, rates: Rates) -> float:
    """Return the largest approach speed [m/s] at a clearance h [m]. Where h is negative, it is a retreat.

    It is ``gain h`` near by; farther away the parabola that meets it smoothly, below sqrt(2 a h). The approach then
    slows down by no more than a: d rate/dh rate = gain^2 h <= a near by, and = a farther away.
    """
    if h <= 0.0:
        return -min(-gain * h, rates.retreat)
    meet = rates.braking / gain**2
    return gain * h if h <= meet else sqrt(2.0 * rates.braking * (h - 0.5 * meet))


@kernel
def against(gain: float, fastest: float, rates: Rates) -> tuple[float, Rates]:
    """Return gain [1/s] and rates towards an obstacle of speed `fastest` [m/s].

    No point of it is faster. For moving obstacles, `passing` replaces `braking`, and the gain left by a fast group
    grows with it.
    """
    if fastest == 0.0 or rates.passing == rates.braking:
        return gain, rates
    harder = Rates(
        rates.period,
        rates.gain,
        rates.passing,
        rates.passing,
        rates.retreat,
        rates.speed,
        rates.acceleration,
        rates.clearance,
    )
    return min(rates.gain, gain * rates.passing / rates.braking), harder


@kernel
def horizon(speed: float, gain: float, rates: Rates) -> float:
    """Return the clearance [m] below which an approach is slowed down. The approach has a `speed` [m/s]."""
    corner = rates.braking / gain
    if speed <= corner:
        return speed / gain
    return 0.5 * speed * speed / rates.braking + 0.5 * corner / gain


@kernel
def first_rows(qp: QP, first: int, poses: HandPoses, before: Array, wanted: Array, sighting: Sighting) -> int:
    """Write the objective and, from row `first`, near obstacles' rows; return the number of rows."""
    freedom, rates, work, center, m = qp.freedom, qp.rates, qp.work, poses.center, first
    pace = _set_up(qp, poses, before, wanted, sighting)
    m = _first_of_points(qp, m, center, sighting, pace)
    m = _first_of_edges(qp, m, center, sighting, pace)
    m = _first_of_solids(qp, m, center, sighting, pace)
    m = _first_of_border(qp, m, center, pace)
    for k in range(freedom.pairs.shape[0]):
        h = _pair_distance(freedom, work.nodes, k)
        if h <= horizon(2 * pace, _pair_gain(qp, k), rates):
            m = _pair_row(qp, m, k, h)
    return limit_rows(qp, m, before, wanted, m > first)


@kernel
def _set_up(qp: QP, poses: HandPoses, before: Array, wanted: Array, sighting: Sighting) -> float:
    """Write the state, objective and gains; return an end effector's largest possible speed [m/s]."""
    points, freedom, rates, work = qp.points, qp.freedom, qp.rates, qp.work
    center, quaternion = poses
    for g in range(center.shape[0]):
        turn_into(quaternion[g, 0], quaternion[g, 1], quaternion[g, 2], quaternion[g, 3], work.rotation[g])
        if freedom.axis[g] >= 0:  # it turns about its second and third direction; about itself nothing turns
            for axis in range(3):
                for k in range(2):
                    freedom.basis[g, 3 + axis, freedom.axis[g] + k] = (
                        work.rotation[g, axis, 1 + k] / freedom.scale[g]
                    )
    place(points.node_group, points.node_point, center, work.rotation, work.nodes)
    place(points.group, points.point, center, work.rotation, work.points)
    work.slack[:] = 0.0
    _objective(qp, center, wanted)
    moved_obstacles(sighting.table, sighting.velocity, sighting.spin, rates.period, work.after.table)
    work.gain[:] = rates.gain
    pace = 0.0
    for i in range(before.shape[0]):
        g, fast = points.node_group[i], length_of(before[i])
        pace = max(pace, fast, length_of(wanted[i]))
        if rates.braking < np.inf:  # a fast group needs long to stop
            work.gain[g] = min(work.gain[g], 2.0 * rates.braking / fast)
    return min(pace, rates.speed)


@kernel
def _fastest(sighting: Sighting, j: int) -> float:
    return length_of(sighting.velocity[j]) + length_of(sighting.spin[j]) * sighting.table[j, REACH]


@kernel
def _near(qp: QP, g: int, pace: float, fastest: float) -> float:
    """Return the clearance [m] beyond which an obstacle does not slow groups. Its speed is `fastest`."""
    gain, rates = against(qp.work.gain[g], fastest, qp.rates)
    return horizon(pace * qp.freedom.lever[g] + fastest, gain, rates)


@kernel
def _first_of_points(qp: QP, m: int, center: Array, sighting: Sighting, pace: float) -> int:
    """Write the rows of sampled points against obstacles; return the number of rows."""
    points, rates, work, table = qp.points, qp.rates, qp.work, sighting.table
    for j in range(table.shape[0]):
        fastest = _fastest(sighting, j)
        for k in range(points.group.shape[0]):
            g, p = points.group[k], work.points[k]
            need = points.radius[k] + rates.clearance + sighting.margin[j]
            h = point_distance(table, j, p[0], p[1], p[2]) - need
            if h <= _near(qp, g, pace, fastest):
                true, nx, ny, nz = solid_gradient(table, j, p[0], p[1], p[2])
                h = max(h, true - need)  # planes of a polytope tell less
                m = _obstacle_row(qp, m, (g, j), center, p, (nx, ny, nz), sighting, h)
    return m


@kernel
def _first_of_edges(qp: QP, m: int, center: Array, sighting: Sighting, pace: float) -> int:
    """Write the rows of edges' nearest points, except their ends."""
    points, rates, work = qp.points, qp.rates, qp.work
    for j in range(sighting.table.shape[0]):
        fastest = _fastest(sighting, j)
        for e in range(points.edges.shape[0]):
            a, b = points.edges[e]
            h, share = near_on_edge(sighting.table, j, work.nodes[a], work.nodes[b], np.inf)
            h -= points.edge_radius[e] + rates.clearance + sighting.margin[j]
            work.left[e, j] = h
            inside = a != b and 0.0 < share < 1.0
            if inside and h <= _near(qp, points.node_group[a], pace, fastest):
                m = _inner_row(qp, m, center, sighting, j, e, share)
    return m


@kernel
def _first_of_solids(qp: QP, m: int, center: Array, sighting: Sighting, pace: float) -> int:
    """Write the rows of the nearest points of all parts of solids."""
    points, work, table, near = qp.points, qp.work, sighting.table, np.empty(3)
    solid = empty_solid(points.solids)
    for j in range(table.shape[0]):
        fastest = _fastest(sighting, j)
        for s in range(points.solids.shape[0]):
            g, need = points.node_group[points.solids[s, 0]], qp.rates.clearance + sighting.margin[j]
            reach, e = _near(qp, g, pace, fastest), points.edges.shape[0] + s
            work.left[e, j] = np.inf
            solid_at(work.nodes, points.solids[s], solid)
            for part in range(N_PARTS):  # each of them may be the next to touch
                h = near_on_part(table, j, solid, part, np.inf, near) - need
                work.left[e, j] = min(work.left[e, j], h)
                if h <= reach:
                    _, nx, ny, nz = solid_gradient(table, j, near[0], near[1], near[2])
                    m = _obstacle_row(qp, m, (g, j), center, near, (nx, ny, nz), sighting, h)
    return m


@kernel
def _first_of_border(qp: QP, m: int, center: Array, pace: float) -> int:
    """Write the rows of all keypoints against the border."""
    points, freedom, rates, work = qp.points, qp.freedom, qp.rates, qp.work
    for i in range(points.node_group.shape[0]):
        g, p = points.node_group[i], work.nodes[i]
        for axis in range(3):
            for side in range(2):
                h = _border(freedom, p, axis, side) - points.node_radius[i] - rates.clearance
                if h <= horizon(pace * freedom.lever[g], work.gain[g], rates):
                    m = _border_row(qp, m, g, center, p, axis, side, h)
    return m


@kernel
def missing_rows(
    qp: QP, poses: HandPoses, sighting: Sighting, x: Array, m: int, twists: Array
) -> tuple[int, float]:
    """Write the twists of x, and the rows violated after the step. These begin at row m.

    Returns
    -------
    n_rows : int
    worst : float, largest violation of a distance after the step, divided by the period [m/s]
    """
    points, freedom, rates, work = qp.points, qp.freedom, qp.rates, qp.work
    (center, quaternion), dt, worst = poses, rates.period, 0.0
    for g in range(center.shape[0]):
        for k in range(6):
            twists[g, k] = 0.0
            for c in range(x.shape[0]):
                twists[g, k] += freedom.basis[g, k, c] * x[c]
    m, far_out = broken_limits(qp, m, x)
    if far_out:  # violations by so large a step say nothing about smaller ones
        return m, worst
    after = work.after
    step(center, quaternion, twists, dt, after.center, after.quaternion)
    for g in range(center.shape[0]):
        q = after.quaternion[g]
        turn_into(q[0], q[1], q[2], q[3], after.rotation[g])
    place(points.node_group, points.node_point, after.center, after.rotation, after.nodes)
    m = bent_limits(qp, m, x, dt)
    m, worst = _missing_of_obstacles(qp, m, center, twists, sighting, worst)
    m, worst = _missing_of_border(qp, m, center, x, worst)
    for k in range(freedom.pairs.shape[0]):
        h, then = _pair_distance(freedom, work.nodes, k), _pair_distance(freedom, after.nodes, k)
        g = points.node_group[freedom.pairs[k, 0]]
        ask = _promise(h, _pair_gain(qp, k), rates) - work.slack[g, work.slack.shape[1] - 2] * dt
        if then >= ask:
            continue
        worst = max(worst, (ask - then) / dt)
        m = _pair_row(qp, m, k, h)
        bend = (then - h) / dt - _value(work, m - 1, x)
        work.low[m - 1] += SPARE - min(bend, 0.0)
    return m, worst


@kernel
def _missing_of_obstacles(
    qp: QP, m: int, center: Array, twists: Array, sighting: Sighting, worst: float
) -> tuple[int, float]:
    """Write the violated rows of edges and solids; return as `missing_rows` does."""
    points, rates, work = qp.points, qp.rates, qp.work
    n_edges, near, dt = points.edges.shape[0], np.empty(3), rates.period
    solid = empty_solid(points.solids)
    for j in range(sighting.table.shape[0]):
        fastest = _fastest(sighting, j)
        for e in range(n_edges + points.solids.shape[0]):
            a = points.edges[e, 0] if e < n_edges else points.solids[e - n_edges, 0]
            g = points.node_group[a]
            fast = length_of(twists[g, :3]) + length_of(twists[g, 3:]) * points.reach[g]
            h = work.left[e, j]
            gain, towards = against(work.gain[g], fastest, rates)
            ask = _promise(h, gain, towards) - work.slack[g, j] * dt
            if h - dt * (fast + fastest) >= ask:
                continue
            need = rates.clearance + sighting.margin[j]
            if e < n_edges:
                p, q = work.after.nodes[a], work.after.nodes[points.edges[e, 1]]
                need += points.edge_radius[e]
                then, share = near_on_edge(work.after.table, j, p, q, ask + need)
                for axis in range(3):
                    near[axis] = p[axis] + share * (q[axis] - p[axis])
            else:
                solid_at(work.after.nodes, points.solids[e - n_edges], solid)
                then = near_on_solid(work.after.table, j, solid, ask + need, near)
            if then >= ask + need:  # of a solid, `near` is nowhere then
                continue
            worst = max(worst, (ask + need - then) / dt)
            gaps = need, then - need
            m = _point_row(qp, m, (g, j), (center, twists), near, sighting, gaps, e >= n_edges)
    return m, worst


@kernel
def _missing_of_border(qp: QP, m: int, center: Array, x: Array, worst: float) -> tuple[int, float]:
    """Write the violated rows of keypoints at the border; return as `missing_rows` does."""
    points, freedom, rates, work = qp.points, qp.freedom, qp.rates, qp.work
    for i in range(points.node_group.shape[0]):
        g = points.node_group[i]
        for axis in range(3):
            for side in range(2):
                need = points.node_radius[i] + rates.clearance
                h = _border(freedom, work.nodes[i], axis, side) - need
                then = _border(freedom, work.after.nodes[i], axis, side) - need
                ask = _promise(h, work.gain[g], rates)
                ask -= work.slack[g, work.slack.shape[1] - 1] * rates.period
                if then >= ask:
                    continue
                worst = max(worst, (ask - then) / rates.period)
                m = _border_row(qp, m, g, center, work.nodes[i], axis, side, h)
                bend = (then - h) / rates.period - _value(work, m - 1, x)
                work.low[m - 1] += SPARE - min(bend, 0.0)
    return m, worst


@kernel
def _promise(h: float, gain: float, rates: Rates) -> float:
    """Return the clearance [m] required after a step that begins at h."""
    return (h - rate(h, gain, rates) * rates.period - BEND * h if h > 0.0 else h) - ROUNDING


@kernel
def _objective(qp: QP, center: Array, wanted: Array) -> None:
    """Write the objective: sum |velocity - wanted|^2 / 2, and the cost of idle rotation."""
    points, freedom, work = qp.points, qp.freedom, qp.work
    n_groups, _, n = freedom.basis.shape
    work.quadratic[:n, :n] = 0.0
    work.linear[:n] = 0.0
    for i in range(work.hands.shape[0]):
        g = points.node_group[i]
        x, y, z = (
            work.nodes[i, 0] - center[g, 0],
            work.nodes[i, 1] - center[g, 1],
            work.nodes[i, 2] - center[g, 2],
        )
        b, jacobian = freedom.basis[g], work.hands[i]
        for c in range(n):
            jacobian[0, c] = b[0, c] + b[4, c] * z - b[5, c] * y
            jacobian[1, c] = b[1, c] + b[5, c] * x - b[3, c] * z
            jacobian[2, c] = b[2, c] + b[3, c] * y - b[4, c] * x
        for axis in range(3):
            for c in range(n):
                if jacobian[axis, c] == 0.0:
                    continue
                work.linear[c] -= jacobian[axis, c] * wanted[i, axis]
                for d in range(n):
                    work.quadratic[c, d] += jacobian[axis, c] * jacobian[axis, d]
    own = np.empty((3, n))
    for g in range(n_groups):
        if not freedom.idle[g].any():
            continue
        for k in range(3):  # angular velocity in the group's frame
            for c in range(n):
                own[k, c] = 0.0
                for axis in range(3):
                    own[k, c] += work.rotation[g, axis, k] * freedom.basis[g, 3 + axis, c]
        for k in range(3):
            for l in range(3):
                for c in range(n):
                    for d in range(n):
                        work.quadratic[c, d] += freedom.idle[g, k, l] * own[k, c] * own[l, d]


@kernel
def write_along(basis: Array, center: Array, p: Array, normal: Direction, sign: float, row: Array) -> None:
    """Write a point's [m] velocity along a normal, by variable.

    Parameters
    ----------
    basis : array, shape (6, n_variables), twists of the body per unit of the variables
    center : array, shape (3,), its centre [m]
    sign : factor
    """
    nx, ny, nz = normal
    x, y, z = p[0] - center[0], p[1] - center[1], p[2] - center[2]
    a, b, c = y * nz - z * ny, z * nx - x * nz, x * ny - y * nx
    for k in range(basis.shape[1]):
        row[k] = sign * (
            nx * basis[0, k]
            + ny * basis[1, k]
            + nz * basis[2, k]
            + a * basis[3, k]
            + b * basis[4, k]
            + c * basis[5, k]
        )


@kernel
def speed_along(sighting: Sighting, j: int, p: Array, normal: Direction) -> float:
    """Return the velocity [m/s] along a normal of obstacle j's point [m]."""
    table, velocity, spin, _ = sighting
    x, y, z = p[0] - table[j, CENTER], p[1] - table[j, CENTER + 1], p[2] - table[j, CENTER + 2]
    return (
        normal[0] * (velocity[j, 0] + spin[j, 1] * z - spin[j, 2] * y)
        + normal[1] * (velocity[j, 1] + spin[j, 2] * x - spin[j, 0] * z)
        + normal[2] * (velocity[j, 2] + spin[j, 0] * y - spin[j, 1] * x)
    )


@kernel
def _row(qp: QP, m: int, g: int, center: Array, p: Array, normal: Direction) -> None:
    """Write in row m a point's velocity along a normal. It is the point p of group g."""
    qp.work.rows[m, :] = 0.0
    write_along(qp.freedom.basis[g], center[g], p, normal, 1.0, qp.work.rows[m])
    qp.work.body[m] = g


@kernel
def _obstacle_row(
    qp: QP,
    m: int,
    pair: tuple[int, int],
    center: Array,
    p: Array,
    normal: Direction,
    sighting: Sighting,
    h: float,
) -> int:
    """Write a point's row against an obstacle h [m] away; return the number of rows. `pair` is group and obstacle."""
    work, (g, j) = qp.work, pair
    gain, rates = against(work.gain[g], _fastest(sighting, j), qp.rates)
    _row(qp, m, g, center, p, normal)
    work.low[m] = speed_along(sighting, j, p, normal) - rate(h, gain, rates)
    work.owner[m] = j
    return m + 1


@kernel
def _inner_row(qp: QP, m: int, center: Array, sighting: Sighting, j: int, e: int, share: float) -> int:
    """Write the row of an edge's inner point; return the number of rows."""
    points, rates, work = qp.points, qp.rates, qp.work
    a, b = points.edges[e]
    p = np.empty(3)
    for axis in range(3):
        p[axis] = work.nodes[a, axis] + share * (work.nodes[b, axis] - work.nodes[a, axis])
    h, nx, ny, nz = distance_and_gradient(sighting[0], j, p[0], p[1], p[2])
    h -= points.edge_radius[e] + rates.clearance + sighting[3][j]
    return _obstacle_row(qp, m, (points.node_group[a], j), center, p, (nx, ny, nz), sighting, h)


@kernel
def _point_row(
    qp: QP,
    m: int,
    pair: tuple[int, int],
    moves: tuple[Array, Array],
    after: Array,
    sighting: Sighting,
    gaps: tuple[float, float],
    of_solid: bool,
) -> int:
    """Write the row of the point at `after` after the step; return the number of rows.

    Parameters
    ----------
    pair : numbers of its group and of the obstacle
    moves : centres and twists of the groups
    gaps : required distance, and the distance beyond it after the step [m]
    """
    rates, work, (g, j), (center, twists), (need, then) = qp.rates, qp.work, pair, moves, gaps
    x, p = np.empty(3), np.empty(3)
    for axis in range(3):
        x[axis] = after[axis] - work.after.center[g, axis]
    for axis in range(3):  # back to where it is now
        own = 0.0
        for k in range(3):
            inside = 0.0
            for l in range(3):
                inside += work.after.rotation[g, l, k] * x[l]
            own += work.rotation[g, axis, k] * inside
        p[axis] = center[g, axis] + own
    if of_solid:
        h, nx, ny, nz = solid_gradient(sighting[0], j, p[0], p[1], p[2])
    else:
        h, nx, ny, nz = distance_and_gradient(sighting[0], j, p[0], p[1], p[2])
    h -= need
    m = _obstacle_row(qp, m, pair, center, p, (nx, ny, nz), sighting, h)
    # What the step does beyond its first order, to this point: rounds of turns, the obstacle's turning.
    x[0], x[1], x[2] = p[0] - center[g, 0], p[1] - center[g, 1], p[2] - center[g, 2]
    v = twists[g]
    moved = (
        nx * (v[0] + v[4] * x[2] - v[5] * x[1])
        + ny * (v[1] + v[5] * x[0] - v[3] * x[2])
        + nz * (v[2] + v[3] * x[1] - v[4] * x[0])
    )
    gain, towards = against(work.gain[g], _fastest(sighting, j), rates)
    comes = work.low[m - 1] + rate(h, gain, towards)
    bend = (then - h) / rates.period - (moved - comes)
    work.low[m - 1] += SPARE - min(bend, 0.0)
    return m


@kernel
def _border(freedom: Freedom, p: Array, axis: int, side: int) -> float:
    return p[axis] - freedom.lower[axis] if side == 0 else freedom.upper[axis] - p[axis]


@kernel
def _border_row(qp: QP, m: int, g: int, center: Array, p: Array, axis: int, side: int, h: float) -> int:
    rates, work = qp.rates, qp.work
    sign = 1.0 - 2.0 * side
    normal = (sign * (axis == 0), sign * (axis == 1), sign * (axis == 2))
    _row(qp, m, g, center, p, normal)
    work.low[m] = -rate(h, work.gain[g], rates)
    work.owner[m] = BORDER
    return m + 1


@kernel
def _pair_distance(freedom: Freedom, nodes: Array, k: int) -> float:
    """Return the distance of two end effectors beyond their separation [m]."""
    p, q = nodes[freedom.pairs[k, 0]], nodes[freedom.pairs[k, 1]]
    return sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2) - freedom.apart[k]


@kernel
def _pair_gain(qp: QP, k: int) -> float:
    """Return the gain [1/s] of two end effectors: that of the faster group."""
    points, freedom, work = qp.points, qp.freedom, qp.work
    a, b = freedom.pairs[k]
    return min(work.gain[points.node_group[a]], work.gain[points.node_group[b]])


@kernel
def _pair_row(qp: QP, m: int, k: int, h: float) -> int:
    points, freedom, rates, work = qp.points, qp.freedom, qp.rates, qp.work
    a, b = freedom.pairs[k]
    length = max(h + freedom.apart[k], TINY)
    work.rows[m, :] = 0.0
    for c in range(work.hands.shape[2]):
        for axis in range(3):
            n = (work.nodes[a, axis] - work.nodes[b, axis]) / length
            work.rows[m, c] += n * (work.hands[a, axis, c] - work.hands[b, axis, c])
    work.low[m] = -rate(h, _pair_gain(qp, k), rates)
    work.owner[m], work.body[m] = HANDS, points.node_group[a]
    return m + 1


@kernel
def _value(work: QPWorkspace, i: int, x: Array) -> float:
    """Return the value of row i at x."""
    value = 0.0
    for c in range(x.shape[0]):
        value += work.rows[i, c] * x[c]
    return value
