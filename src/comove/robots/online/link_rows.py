"""Rows of links in the safety filter, in numba kernels: bounds of approach speeds.

The variables are those of the twists, x, which move the payload, and the rates of the joints. A row

    n . (velocity of a link's nearest point - velocity of the other's) >= -rate(h)

is a control barrier as in `comove.control.safety.cbf_constraints`; h is the remaining clearance, n its direction.
Links are capsules, which are a little wider than the bodies in them. Joints can change their rates only a little in
a step, so most rows hold for all admissible rates: those are left out, and mostly not even measured. Where limits of
joints are relaxed themselves, the next step detects the loss of clearance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from comove.arrays import Array, Integers
from comove.compiled import copy_to, kernel
from comove.contacts.displaced import RESTING
from comove.contacts.rods import near_enough, nearest_shares, rod_distance
from comove.control.safety.cbf_constraints import Direction, against, horizon, rate, speed_along, write_along
from comove.control.safety.limits import length_of
from comove.control.safety.qp_workspace import HANDS, Rates, Sighting
from comove.geometry.closest_points import PLACE_TOLERANCE, near_on_edge, solid_gradient
from comove.geometry.distances import CENTER, REACH, points_apart
from comove.robots.search.chains import jacobian, place_arm
from comove.robots.search.following import Arms
from comove.robots.search.links import (
    STATIC,
    clearance_between,
    load_clearances,
    place_links,
)


class LinkNeeds(NamedTuple):
    """Required clearances of links, and the distance of checked bodies.

    Attributes
    ----------
    obstacle : array, shape (n_rows,), from every row of the table of obstacles [m]
    other : of links that move from the payload and from each other [m]
    still : of links that do not move from the payload; their capsules may be much wider than the bodies [m]
    near : clearance above which nothing is checked [m]
    """

    obstacle: Array
    other: float
    still: float
    near: float


class LinkRows(NamedTuple):
    """Work arrays for rows of links.

    Attributes
    ----------
    start, end : arrays, shape (n_links, 3), ends of the links' axes [m]
    axes, places : arrays, shape (n_joints, 3), axes of the joints in the world's frame, and points on them [m]
    speed : array, shape (n_links,), bounds of the speed of any point of a link in this step [m/s]
    rows, low : arrays, shape (n_rows, n_variables + n_joints) and (n_rows,)
    owner : array, shape (n_rows,), the row of the table of obstacles, or `HANDS` for payload and links
    filled : array, shape (1,), number of written rows
    """

    start: Array
    end: Array
    axes: Array
    places: Array
    speed: Array
    rows: Array
    low: Array
    owner: Integers
    filled: Integers


def most_rows(arms: Arms, n_obstacles: int) -> int:
    """Return the largest number of rows among that many obstacles."""
    links = arms.links
    return len(links.moving) * n_obstacles + len(links.radius) * len(arms.around.edges) + len(links.pairs)


def empty_rows(arms: Arms, n_obstacles: int, n_variables: int) -> LinkRows:
    """Return work arrays for that many obstacles, and variables of the payload."""
    links, n_joints, count = arms.links, len(arms.chains.lower), most_rows(arms, n_obstacles)
    return LinkRows(
        links.start.copy(),
        links.end.copy(),
        np.empty((n_joints, 3)),
        np.empty((n_joints, 3)),
        np.zeros(len(links.radius)),
        np.zeros((count, n_variables + n_joints)),
        np.zeros(count),
        np.zeros(count, dtype=np.int64),
        np.zeros(1, dtype=np.int64),
    )


@kernel
def hand_jacobians(arms: Arms, q: Array) -> tuple[Array, Array]:
    """Return grasps' zero-padded Jacobians, (n_arms, 6, n_joints), and positions, (n_arms, 3) [m]."""
    chains, n_arms = arms.chains, arms.chains.first.shape[0] - 1
    jacobians, hands = np.zeros((n_arms, 6, q.shape[0])), np.empty((n_arms, 3))
    for i in range(n_arms):
        first, n = chains.first[i], chains.first[i + 1] - chains.first[i]
        turns, places, own = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((6, n))
        place_arm(chains, i, q, turns, places)
        jacobian(chains, i, turns, places, own)
        for row in range(6):
            copy_to(own[row], jacobians[i, row, first : first + n])
        copy_to(places[n], hands[i])
    return jacobians, hands


@kernel
def link_rows(
    arms: Arms,
    q: Array,
    bounds: tuple[Array, Array],
    nodes: Array,
    load: tuple[Array, Array],
    sighting: Sighting,
    how: tuple[LinkNeeds, Rates],
    work: LinkRows,
) -> int:
    """Write the rows of links possibly too near after this step; return their number.

    Parameters
    ----------
    q : array, shape (n_joints,), joint positions
    bounds : arrays, shape (n_joints,), least and largest rates of the joints in this step
    nodes : array, shape (n_nodes, 3), keypoints [m]
    load : arrays, shape (6, n_variables) and (3,), the payload's twists per unit of the variables, and its centre
    sighting : the obstacles
    how : clearances of links, and rates of the programme
    """
    needs, rates = how
    links, around = arms.links, arms.around
    _place(arms, q, work)
    place_links(arms.chains, links, q, work.start, work.end)
    _bound_speeds(arms, bounds, work)
    work.filled[0] = 0
    nearest = np.empty(3)
    for i in links.moving:
        a, b, thick = work.start[i], work.end[i], links.radius[i]
        for j in range(sighting.table.shape[0]):
            need = thick + needs.obstacle[j] + sighting.margin[j]
            comes = length_of(sighting.velocity[j])
            comes += length_of(sighting.spin[j]) * (sighting.table[j, REACH] + need + needs.near)
            gain, towards = against(rates.gain, comes, rates)
            near = min(needs.near, horizon(work.speed[i] + comes, gain, towards))
            place = sighting.table[j, CENTER : CENTER + 3]
            if not near_enough(a, b, place, place, need + near + sighting.table[j, REACH]):
                continue
            h, share = near_on_edge(sighting.table, j, a, b, need + near)
            if h - need < near:
                _obstacle_row(arms, i, share, sighting, j, -rate(h - need, gain, towards), work)
                _leave_out_what_holds(bounds, work)
    for i in range(links.radius.shape[0]):
        for e in range(0 if links.holds[i] else around.edges.shape[0]):
            c, d = nodes[around.edges[e, 0]], nodes[around.edges[e, 1]]
            need = links.radius[i] + around.radii[e]
            need += needs.still if links.joint[i] == STATIC else needs.other
            if not near_enough(work.start[i], work.end[i], c, d, need + needs.near):
                continue
            one, two, apart = nearest_shares(work.start[i], work.end[i], c, d)
            if around.edges[e, 0] != around.edges[e, 1] and apart - need < needs.near and apart > 1e-6:
                for axis in range(3):
                    nearest[axis] = c[axis] + two * (d[axis] - c[axis])
                _load_row(arms, i, one, nearest, load, -rate(apart - need, rates.gain, rates), work)
    for p in range(links.pairs.shape[0]):
        i, k = links.pairs[p]
        need = links.radius[i] + links.radius[k] - links.wider[p] + needs.other
        near = min(needs.near, horizon(work.speed[i] + work.speed[k], rates.gain, rates))
        if not near_enough(work.start[i], work.end[i], work.start[k], work.end[k], need + near):
            continue
        one, two, apart = nearest_shares(work.start[i], work.end[i], work.start[k], work.end[k])
        if apart - need < near and apart > 1e-6:
            _pair_row(arms, i, one, k, two, -rate(apart - need, rates.gain, rates), work)
            _leave_out_what_holds(bounds, work)
    return int(work.filled[0])


@kernel
def _bound_speeds(arms: Arms, bounds: tuple[Array, Array], work: LinkRows) -> None:
    """Write bounds of links' speeds: a joint's rate times the largest lever."""
    chains, links = arms.chains, arms.links
    for i in links.moving:
        work.speed[i] = 0.0
        if links.arm[i] < 0:
            continue
        for j in range(chains.first[links.arm[i]], links.joint[i] + 1):
            fastest, far = max(abs(bounds[0][j]), abs(bounds[1][j])), 1.0
            if not chains.slides[j]:
                far = max(
                    points_apart(work.start[i], work.places[j]), points_apart(work.end[i], work.places[j])
                )
            work.speed[i] += fastest * far


@kernel
def _leave_out_what_holds(bounds: tuple[Array, Array], work: LinkRows) -> None:
    """Drop the last row where no admissible rates violate it. The payload has no part in it."""
    m = work.filled[0] - 1
    row, worst = work.rows[m], 0.0
    offset = row.shape[0] - bounds[0].shape[0]
    for j in range(bounds[0].shape[0]):
        worst += row[offset + j] * bounds[0 if row[offset + j] > 0.0 else 1][j]
    if worst >= work.low[m]:
        work.filled[0] = m


@kernel
def _place(arms: Arms, q: Array, work: LinkRows) -> None:
    """Write the axes of all joints."""
    chains = arms.chains
    for i in range(chains.first.shape[0] - 1):
        first, n = chains.first[i], chains.first[i + 1] - chains.first[i]
        turns, places = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
        place_arm(chains, i, q, turns, places)
        for k in range(n):
            for a in range(3):
                work.places[first + k, a] = places[k, a]
                work.axes[first + k, a] = 0.0
                for b in range(3):
                    work.axes[first + k, a] += turns[k, a, b] * chains.axis[first + k, b]


@kernel
def _link_part(
    arms: Arms, i: int, p: Array, normal: Direction, sign: float, work: LinkRows, row: Array
) -> None:
    """Add a link point's velocity along a normal, times `sign`, to `row`. The point p [m] is of link i."""
    chains, links = arms.chains, arms.links
    if links.arm[i] < 0:
        return
    offset, axes, places = row.shape[0] - chains.lower.shape[0], work.axes, work.places
    for j in range(chains.first[links.arm[i]], links.joint[i] + 1):
        x, y, z = axes[j, 0], axes[j, 1], axes[j, 2]
        if not chains.slides[j]:
            u, v, w = p[0] - places[j, 0], p[1] - places[j, 1], p[2] - places[j, 2]
            x, y, z = y * w - z * v, z * u - x * w, x * v - y * u
        row[offset + j] += sign * (normal[0] * x + normal[1] * y + normal[2] * z)


@kernel
def _obstacle_row(
    arms: Arms, i: int, share: float, sighting: Sighting, j: int, low: float, work: LinkRows
) -> None:
    """Write the row of link i against obstacle j."""
    p, m = np.empty(3), work.filled[0]
    _point_on(work, i, share, p)
    _, nx, ny, nz = solid_gradient(sighting.table, j, p[0], p[1], p[2])
    work.rows[m, :] = 0.0
    _link_part(arms, i, p, (nx, ny, nz), 1.0, work, work.rows[m])
    work.low[m], work.owner[m] = speed_along(sighting, j, p, (nx, ny, nz)) + low, j
    work.filled[0] += 1


@kernel
def _load_row(
    arms: Arms, i: int, share: float, near: Array, load: tuple[Array, Array], low: float, work: LinkRows
) -> None:
    """Write the row of link i against the payload's point `near`. Its `basis` and `center` are `load`."""
    (basis, center), p, m = load, np.empty(3), work.filled[0]
    _point_on(work, i, share, p)
    normal = _direction(near, p)
    row = work.rows[m]
    row[:] = 0.0
    _link_part(arms, i, p, normal, 1.0, work, row)
    write_along(basis, center, near, normal, -1.0, row)
    work.low[m], work.owner[m] = low, HANDS
    work.filled[0] += 1


@kernel
def _pair_row(arms: Arms, i: int, one: float, k: int, two: float, low: float, work: LinkRows) -> None:
    """Write the row of two links, at shares of their axes."""
    p, r, m = np.empty(3), np.empty(3), work.filled[0]
    _point_on(work, i, one, p)
    _point_on(work, k, two, r)
    normal = _direction(r, p)
    work.rows[m, :] = 0.0
    _link_part(arms, i, p, normal, 1.0, work, work.rows[m])
    _link_part(arms, k, r, normal, -1.0, work, work.rows[m])
    work.low[m], work.owner[m] = low, HANDS
    work.filled[0] += 1


@kernel
def _point_on(work: LinkRows, i: int, share: float, p: Array) -> None:
    for axis in range(3):
        p[axis] = work.start[i, axis] + share * (work.end[i, axis] - work.start[i, axis])


@kernel
def _direction(a: Array, b: Array) -> Direction:
    """Return the unit vector from a to b."""
    size = points_apart(a, b)
    return (b[0] - a[0]) / size, (b[1] - a[1]) / size, (b[2] - a[2]) / size


@kernel(nogil=True)
def keeps_clear(arms: Arms, start: Array, end: Array, nodes: Array, needs: LinkNeeds) -> bool:
    """Return whether placed links keep clear of obstacles, payload and each other.

    Parameters
    ----------
    start, end : arrays, shape (n_links, 3), ends of the links' axes as `place_links` writes them [m]
    nodes : array, shape (n_nodes, 3), keypoints [m]
    """
    left = needs.obstacle.copy()
    other, still = _lowered(arms, start, end, nodes, arms.around.obstacles, left, needs.other, needs.still)
    for j in range(left.shape[0]):
        if left[j] < needs.obstacle[j]:
            return False
    return other >= needs.other and still >= needs.still


@kernel(nogil=True)
def clearances_along(
    arms: Arms, joints: Array, nodes: Array, table: Array, clearance: float
) -> tuple[Array, float, float]:
    """Compute the links' least clearances along a motion. See `LinkNeeds`.

    Parameters
    ----------
    joints, nodes : arrays, shape (n_steps, n_joints) and (n_steps, n_nodes, 3)
    table : array, shape (n_rows, n_columns), the obstacles
    clearance : largest value of a result [m]

    Returns
    -------
    array, shape (n_rows,), and two numbers [m]
    """
    start, end = arms.links.start.copy(), arms.links.end.copy()
    obstacle, other, still = np.full(table.shape[0], clearance), clearance, clearance
    for t in range(joints.shape[0]):
        place_links(arms.chains, arms.links, joints[t], start, end)
        other, still = _lowered(arms, start, end, nodes[t], table, obstacle, other, still)
    return obstacle, other, still


@kernel
def _lowered(
    arms: Arms,
    start: Array,
    end: Array,
    nodes: Array,
    table: Array,
    obstacle: Array,
    other: float,
    still: float,
) -> tuple[float, float]:
    """Lower clearances, named as in `LinkNeeds`, to those of placed links; return the numbers."""
    links, around = arms.links, arms.around
    for i in links.moving:
        p, q, thick = start[i], end[i], links.radius[i]
        for j in range(table.shape[0]):
            far = obstacle[j] + thick
            apart = rod_distance(table, around.moved, j, RESTING, p, q, far, PLACE_TOLERANCE)
            obstacle[j] = min(obstacle[j], apart - thick)
    moving, standing = load_clearances(links, around, start, end, nodes, max(other, still))
    return clearance_between(links, start, end, min(other, moving)), min(still, standing)
