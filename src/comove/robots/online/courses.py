"""Paths with times through a roadmap among moving obstacles, by prediction.

Time is divided into slots. Moving obstacles are predicted to keep their present velocity and spin. For every sample
of the roadmap and every slot the cost of clearances is computed (`dangers`); then the least cost of a trajectory from
every node at every slot follows backwards in time (dynamic programming: Bellman, 1957). A slot that is not spent at
the goal costs 1, one near to an obstacle more, and one in contact so much that it is avoided where possible;
otherwise a graze costs less than a hit, as the control of each step may yet turn it into a miss. The rest of the path
at the end of the prediction horizon counts as if all obstacles stopped.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import ceil, sqrt
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from comove.arrays import Array, Integers
from comove.compiled import copy_to, kernel
from comove.contacts.rods import rod_distance
from comove.control.safety.qp_workspace import Sighting
from comove.geometry.distances import CAPSULE, CENTER, KIND, REACH, ROTATION, SIZE, SPHERE
from comove.model.blocks import place_one
from comove.model.moving import Displacements
from comove.planning.configurations import Space
from comove.robots.online.roadmap import SLOT, Roadmap, Way
from comove.robots.search.following import Arms
from comove.robots.search.links import ROUGH, Links, place_links

WAIT = -1


class SlotCosts(NamedTuple):
    """Costs of a clearance in a slot, beside 1 for every slot.

    They rise with the square of the missing clearance from 0 at `near` to `nearness` at `met`, and linearly from
    `meeting` there to `hitting` at `depth` below.

    Attributes
    ----------
    met, near : clearances below which an obstacle counts as met, and as near; in settings beyond the scene's [m]
    depth : how far below `met` a graze is a hit [m]
    hitting, meeting, nearness : costs of a slot in which an obstacle is hit, is met, and is almost met
    """

    met: float = 0.01
    near: float = 0.08
    depth: float = 0.04
    hitting: float = 300.0
    meeting: float = 100.0
    nearness: float = 10.0


@dataclass(frozen=True)
class CourseSettings:
    """Settings of the choice of a trajectory.

    Attributes
    ----------
    n_slots : predicted slots
    thicker : largest thickening of links to reduce their number [m]
    costs : costs of a slot
    """

    n_slots: int = 80
    thicker: float = 0.015
    costs: SlotCosts = field(default_factory=SlotCosts)


class Movers(NamedTuple):
    """Moving obstacles, predicted to keep their velocities and spins.

    Attributes
    ----------
    table : array, shape (n_rows, n_columns), table of the obstacles as they are now
    moved : their displacements after 0 s and after 1 s, extrapolated: instants are (0, 1, time)
    margin : array, shape (n_rows,), distance kept for uncertainty [m]
    """

    table: Array
    moved: Displacements
    margin: Array

    @classmethod
    def of(cls, seen: Sighting) -> Movers:
        """Return the moving obstacles, as predicted."""
        rate = np.linalg.norm(seen.spin, axis=1)
        axes = (
            np.where(rate[:, None] > 0.0, seen.spin, [0.0, 0.0, 1.0])
            / np.where(rate > 0.0, rate, 1.0)[:, None]
        )
        offsets, angles = (np.stack([np.zeros_like(rates), rates]) for rates in (seen.velocity, rate))
        centers = seen.table[:, CENTER : CENTER + 3]
        return cls(seen.table, Displacements.of(offsets, centers, angles, axes), seen.margin)


class Places(NamedTuple):
    """Bodies at samples, as capsules.

    Attributes
    ----------
    start, end : arrays, shape (n_samples, n_bodies, 3), ends of the axes: of links that move, and then of the
        payload's edges [m]
    radius : array, shape (n_bodies,) [m]
    """

    start: Array
    end: Array
    radius: Array


def fewer(links: Links, within: float) -> tuple[Integers, Array]:
    """Return thickened links that contain all moving ones; arrays, shape (n,), of numbers and radii [m].

    End effectors have many small links, most of which a larger one beside them nearly contains.

    Parameters
    ----------
    within : largest thickening of a link [m]
    """
    kept, radius = list[int](), links.radius.copy()
    for i in sorted(links.moving.tolist(), key=lambda i: (-links.radius[i], i)):
        ends = np.stack([links.start[i], links.end[i]])
        for k in kept:
            along = links.end[k] - links.start[k]
            share = np.clip((ends - links.start[k]) @ along / max(along @ along, 1e-18), 0.0, 1.0)
            off = np.linalg.norm(ends - links.start[k] - share[:, None] * along, axis=1).max()
            out = off + links.radius[i] - links.radius[k]
            if links.joint[i] == links.joint[k] and out <= within:
                radius[k] = max(radius[k], links.radius[k] + out)
                break
        else:
            kept.append(i)
    which = np.sort(np.array(kept, dtype=np.int64))
    return which, radius[which]


@kernel(nogil=True)
def places(
    space: Space, arms: Arms, which: tuple[Integers, Array], configurations: Array, joints: Array
) -> Places:
    """Return links and payload at samples; arrays, shape (n_samples, n_columns) and (n_samples, n_joints).

    Parameters
    ----------
    which : numbers and radii of the links, as of `fewer`
    """
    links, around, (chosen, thick) = arms.links, arms.around, which
    n, n_links, n_edges = joints.shape[0], chosen.shape[0], around.edges.shape[0]
    start, end = np.empty((n, n_links + n_edges, 3)), np.empty((n, n_links + n_edges, 3))
    nodes = np.empty((space.blocks.node.shape[0], 3))
    a, b = links.start.copy(), links.end.copy()
    for t in range(n):
        place_links(arms.chains, links, joints[t], a, b)
        place_one(space.blocks, configurations[t], 1.0, nodes)
        for m in range(n_links):
            copy_to(a[chosen[m]], start[t, m])
            copy_to(b[chosen[m]], end[t, m])
        for e in range(n_edges):
            copy_to(nodes[around.edges[e, 0]], start[t, n_links + e])
            copy_to(nodes[around.edges[e, 1]], end[t, n_links + e])
    return Places(start, end, np.concatenate((thick, around.radii)))


@kernel
def _cost(h: float, costs: SlotCosts) -> float:
    """Return the cost of a clearance h [m] in a slot."""
    if h < costs.met:
        return costs.meeting + (costs.hitting - costs.meeting) * min(1.0, (costs.met - h) / costs.depth)
    return costs.nearness * (max(costs.near - h, 0.0) / (costs.near - costs.met)) ** 2


@kernel
def instants_near(off: Array, step: Array, far: float, n: int) -> tuple[int, int]:
    """Return a slice of range(n): |off + k step| is at most `far` [m]. It is 0, 0 if empty.

    Parameters
    ----------
    off, step : arrays, shape (3,) [m]
    """
    square, along, left = 0.0, 0.0, -far * far
    for x in range(3):
        square += step[x] * step[x]
        along += off[x] * step[x]
        left += off[x] * off[x]
    if square < 1e-18:
        return 0, n if left <= 0.0 else 0
    root = along * along - square * left
    if root < 0.0:
        return 0, 0
    first, last = (-along - sqrt(root)) / square, (-along + sqrt(root)) / square
    if last < 0.0 or first > n - 1.0:
        return 0, 0
    return ceil(max(first, 0.0)), int(min(last, n - 1.0)) + 1


@kernel
def _raise_by_ball(
    p: Array,
    q: Array,
    thick: float,
    ball: tuple[Array, Array, int],
    costs: SlotCosts,
    out: Array,
) -> None:
    """Raise costs, shape (n_instants,), to those of a segment near a ball. Both are `thick` [m] in all.

    Nothing in the loop branches, so that several instants are computed at once.

    Parameters
    ----------
    ball : its centre at instant 0 and how that moves in one, arrays of shape (3,) [m], and the first instant
    """
    center, step, begin = ball
    u, v, w = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    a, b, c = center[0] - p[0], center[1] - p[1], center[2] - p[2]
    d, e, f = step[0], step[1], step[2]
    size = max(u * u + v * v + w * w, 1e-18)
    share_at_first, further = (a * u + b * v + c * w) / size, (d * u + e * v + f * w) / size
    met, near, meeting, nearness = costs.met, costs.near, costs.meeting, costs.nearness
    per, deeper = 1.0 / (near - met), (costs.hitting - meeting) / costs.depth
    for i in range(out.shape[0]):
        k = float(begin + i)
        share = share_at_first + k * further
        share = 0.0 if share < 0.0 else share
        share = 1.0 if share > 1.0 else share
        x, y, z = a + k * d - share * u, b + k * e - share * v, c + k * f - share * w
        h = sqrt(x * x + y * y + z * z) - thick
        lack = (near - h) * per
        lack = 0.0 if lack < 0.0 else lack
        hit = meeting + deeper * (met - h)
        hit = costs.hitting if hit > costs.hitting else hit
        cost = hit if h < met else nearness * lack * lack
        out[i] = cost if cost > out[i] else out[i]


@kernel
def _off_axis(axis: Array, vector: Array, out: Array) -> None:
    """Write a vector's part across a unit vector; arrays, shape (3,)."""
    along = axis[0] * vector[0] + axis[1] * vector[1] + axis[2] * vector[2]
    for x in range(3):
        out[x] = vector[x] - along * axis[x]


@kernel(nogil=True)
def dangers(bodies: Places, movers: Movers, times: Array, costs: SlotCosts) -> Array:
    """Return the cost of every sample at every instant; array, shape (n_times, n_samples).

    Parameters
    ----------
    times : array, shape (n_times,), evenly spaced from now on [s]
    """
    (start, end, radius), (table, moved, margin) = bodies, movers
    n_samples, n_times, n_movers = start.shape[0], times.shape[0], table.shape[0]
    here, step, reach = np.empty((n_movers, 3)), np.empty((n_movers, 3)), np.empty(n_movers)
    for j in range(n_movers):
        here[j] = table[j, CENTER : CENTER + 3] + times[0] * moved.offsets[1, j]
        step[j] = (times[1] - times[0]) * moved.offsets[1, j]
        reach[j] = table[j, REACH] + margin[j]
    cost, off, out, aside = np.empty((n_times, n_samples)), np.empty(3), np.empty(n_times), np.empty(3)
    for t in range(n_samples):
        out[:] = 0.0
        for m in range(radius.shape[0]):
            p, q, far, half = start[t, m], end[t, m], radius[m] + costs.near, 0.0
            for x in range(3):
                half += (0.5 * (q[x] - p[x])) ** 2
            half = sqrt(half)
            for j in range(n_movers):
                for x in range(3):
                    off[x] = here[j, x] - 0.5 * (p[x] + q[x])
                first, last = instants_near(off, step[j], half + far + reach[j], n_times)
                if table[j, KIND] == SPHERE:
                    ball = here[j], step[j], first
                    _raise_by_ball(p, q, radius[m] + reach[j], ball, costs, out[first:last])
                    continue
                turning = moved.angles[1, j] != 0.0
                # Nor are they near where they are too far off its axis.
                if table[j, KIND] == CAPSULE and not turning:
                    axis, width = table[j, ROTATION + 2 : ROTATION + 9 : 3], table[j, SIZE]
                    _off_axis(axis, off, off)
                    _off_axis(axis, step[j], aside)
                    begin, stop = instants_near(off, aside, half + far + width + margin[j], n_times)
                    first, last = max(first, begin), min(last, stop)
                was_near = False
                for k in range(first, last):
                    if out[k] < costs.hitting:
                        h = rod_distance(table, moved, j, (0, 1, times[k]), p, q, far + margin[j], ROUGH)
                        h -= margin[j] + radius[m]
                        # Distances of convex bodies that do not turn are convex in time.
                        if h >= costs.near and was_near and not turning:
                            break
                        was_near = h < costs.near
                        out[k] = max(out[k], _cost(h, costs))
        cost[:, t] = out
    return cost


@kernel(nogil=True)
def dangers_along(bodies: Places, movers: Movers, times: Array, costs: SlotCosts) -> Array:
    """Return each sample's cost at its own instant; array, shape (n_samples,). Arguments as of `dangers`."""
    (start, end, radius), (table, moved, margin) = bodies, movers
    cost = np.zeros(start.shape[0])
    for t in range(start.shape[0]):
        for m in range(radius.shape[0]):
            p, q, far = start[t, m], end[t, m], radius[m] + costs.near
            for j in range(table.shape[0]):
                h = rod_distance(table, moved, j, (0, 1, times[t]), p, q, far + margin[j], ROUGH)
                h -= margin[j] + radius[m]
                cost[t] = max(cost[t], _cost(h, costs))
    return cost


@kernel(nogil=True)
def least_costs(net: Roadmap, cost: Array, left: Array) -> tuple[Array, Integers]:
    """Return the least costs of nodes and slots, and choices. A choice is an edge or `WAIT`.

    Parameters
    ----------
    net : the roadmap, at whose goal slots cost nothing
    cost : array, shape (n_slots + 1, n_samples), costs of samples, as of `dangers`
    left : array, shape (n_nodes,), cost of the rest of the path from a node at the end

    Returns
    -------
    arrays, shape (n_slots + 1, n_nodes)
    """
    n_nodes, n_slots = net.nodes.shape[0], cost.shape[0] - 1
    value, choice = np.empty((n_slots + 1, n_nodes)), np.full((n_slots + 1, n_nodes), WAIT)
    value[n_slots] = left
    for k in range(n_slots - 1, -1, -1):
        for i in range(n_nodes):
            value[k, i] = value[k + 1, i] + cost[k + 1, net.nodes[i]] + (0.0 if i == net.goal else 1.0)
        for e in range(net.source.shape[0]):
            d, i, there = net.slots[e], net.source[e], net.target[e]
            if k + d > n_slots:
                continue
            total = value[k + d, there] + d + cost[k + d, net.nodes[there]]
            for s in range(d - 1):
                if total >= value[k, i]:
                    break
                total += cost[k + 1 + s, net.begin[e] + s * net.stride[e]]
            if total < value[k, i] - 1e-9:
                value[k, i], choice[k, i] = total, e
    return value, choice


@dataclass(frozen=True, eq=False)
class RoadmapCourse:
    """A chosen trajectory.

    Attributes
    ----------
    way : its samples, one a slot
    cost : its cost, in slots
    left : slots from its end to the goal
    """

    way: Way
    cost: float
    left: float


class Foresight:
    """A roadmap with bodies at samples, for the choice of trajectories.

    Parameters
    ----------
    space, arms : the payload's space, and the arms
    clearance : the scene's [m]
    """

    def __init__(self, space: Space, arms: Arms, clearance: float, settings: CourseSettings):
        self.space, self.arms, self.settings = space, arms, settings
        costs = settings.costs
        self._costs = costs._replace(met=clearance + costs.met, near=clearance + costs.near)
        self._which = fewer(arms.links, settings.thicker)
        self._known: tuple[Roadmap, Places] | None = None

    @property
    def touching(self) -> float:
        """Return the cost of a slot in contact."""
        return _cost(0.0, self._costs)

    def placed(self, way: Way) -> Places:
        """Return the bodies at samples."""
        return places(self.space, self.arms, self._which, *way)

    def cost_along(self, bodies: Places, rows: Integers, seen: Sighting, times: Array) -> Array:
        """Return the samples' costs, each at its own time; array, shape (n_times,).

        Parameters
        ----------
        rows : array of int, shape (n_times,), numbers of the samples; numbers beyond the last one stand for it
        seen : moving obstacles
        times : array, shape (n_times,), from now on [s]
        """
        rows = np.minimum(rows, len(bodies.start) - 1)
        chosen = bodies._replace(start=bodies.start[rows], end=bodies.end[rows])
        return dangers_along(chosen, Movers.of(seen), times, self._costs)

    def best(self, roadmap: Roadmap, extended: Roadmap, seen: Sighting, since: float) -> RoadmapCourse:
        """Return the best trajectory from the last node of a roadmap.

        Parameters
        ----------
        roadmap, extended : the roadmap, and the same one with the payload's future node
        seen : moving obstacles
        since : time from now until the trajectory begins [s]
        """
        how, n = self.settings, len(roadmap.joints)
        if self._known is None or self._known[0] is not roadmap:
            self._known = roadmap, self.placed(Way(roadmap.configurations, roadmap.joints))
        times = since + SLOT * np.arange(how.n_slots + 1, dtype=np.float64)
        more = self.placed(Way(extended.configurations[n:], extended.joints[n:]))
        movers, near = Movers.of(seen), (self._known[1], more)
        cost = np.hstack([dangers(bodies, movers, times, self._costs) for bodies in near])
        left = self._left(extended, cost[-1])
        value, choice = least_costs(extended, cost, left)
        samples, ends = _samples(extended, choice)
        way = Way(extended.configurations[samples], extended.joints[samples])
        return RoadmapCourse(way, float(value[0, -1]), float(left[ends]))

    def _left(self, net: Roadmap, blocked: Array) -> Array:
        """Return the slots from nodes to the goal, among the final obstacles; array, shape (n_nodes,)."""
        how = self.settings
        weight = net.slots + blocked[net.nodes[net.target]]
        inner = net.slots > 1
        middle = net.begin + net.stride * ((net.slots - 2) // 2)
        weight = weight + np.where(inner, blocked[np.where(inner, middle, 0)], 0.0)
        n = len(net.nodes)
        graph = coo_array((weight, (net.target, net.source)), shape=(n, n)).tocsr()
        left = dijkstra(graph, indices=net.goal)
        return np.minimum(left, how.costs.meeting * how.n_slots)


def _samples(net: Roadmap, choice: Integers) -> tuple[list[int], int]:
    """Return the samples of the last node's choices, and the final node.

    Waiting at the goal at the end is left out.
    """
    k, here, samples, rest = 0, len(net.nodes) - 1, [int(net.nodes[-1])], 1
    while k < len(choice) - 1:
        e = int(choice[k, here])
        if e == WAIT:
            samples.append(int(net.nodes[here]))
            k += 1
            rest = rest if here == net.goal else len(samples)
            continue
        d = int(net.slots[e])
        samples += [int(net.begin[e] + s * net.stride[e]) for s in range(d - 1)]
        here = int(net.target[e])
        samples.append(int(net.nodes[here]))
        k, rest = k + d, len(samples)
    return samples[:rest], here
