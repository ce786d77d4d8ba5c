"""Kernels of the payload's configuration space.

Its configurations, those of `load_coordinates`, satisfy the rigid constraints. Along an edge between two of them,
centres move on straight lines and orientations turn on great circles, so no keypoint moves further than the edge's
*span*: the displacement of a group's centre plus its reach times the angle. An edge is checked at its ends, then in
the middle of the part that these do not cover, and so on: around a configuration with clearance d, no obstacle is met
within the span d. Where obstacles move, the span relative to them counts. An edge with many steps of almost no length
counts as not free. Two end effectors that must stay apart may both move: half of their distance beyond the separation
counts as clearance.
"""

from __future__ import annotations

from math import acos, cos, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array, first_largest
from comove.compiled import kernel
from comove.contacts.displaced import RESTING
from comove.contacts.query import Query, least_distance, separating
from comove.contacts.surroundings import Surroundings, from_border, surroundings_of
from comove.geometry.distances import point_distance
from comove.geometry.surfaces import count_meshes
from comove.model.blocks import keep_mask, lean, place_one
from comove.model.coordinates import (
    ANGLE,
    DIRECTION,
    POINT,
    QUATERNION,
    Blocks,
    Coordinates,
)
from comove.model.resting import lift_direction
from comove.model.scene import Scene
from comove.planning.clock import clock_until, worked
from comove.planning.timing import Timing, drift, instant_of, too_fast, write_time

MESH_WORK = 100  # cost of a distance from a mesh, in distances from convex obstacles
SOLID_WORK = 10  # cost of a distance of a solid, in distances of segments
DEPTH = 64  # of a stack of parts of an edge: halves of 2^64 steps need no more
LIFTS = (1.05, 0.8, 0.6, 0.4, 0.2)  # shares of the whole way off supports that are tried


class SpaceSettings(NamedTuple):
    """Settings of how a space is searched.

    Attributes
    ----------
    step : span of an extension of a tree [m]
    cap : cap of clearances beyond the one required [m]
    tolerance : of clearances [m]
    creeping : steps along an edge that may be shorter than the tolerance
    """

    step: float = 0.1
    cap: float = 0.12
    tolerance: float = 2e-4
    creeping: int = 40


SETTINGS = SpaceSettings()


class Space(NamedTuple):
    """A scene in the form that the planner's kernels take.

    Attributes
    ----------
    blocks : map from a configuration to nodes
    reach : array, shape (n_blocks,), distance from a group's centre to its furthest point [m]
    around : payload and all that it must not touch
    untimed : timing of nodes without times, among obstacles where they are at 0 s
    query : things and accuracy of clearances
    required : clearance that the scene requires [m]
    cap : largest clearance that is computed [m]
    clock : clock of the budget; no configuration is free after its deadline
    parts : array, shape (DEPTH, 2), scratch of the check of one edge
    found : array, shape (2,), numbers of paths found by RRT-Connect and by the multi-tree RRT, which the planner
        counts
    settings : settings of the search
    """

    blocks: Blocks
    reach: Array
    around: Surroundings
    untimed: Timing
    query: Query
    required: float
    cap: float
    clock: Array
    parts: Array
    found: NDArray[np.int64]
    settings: SpaceSettings


def configuration_space(
    scene: Scene, coordinates: Coordinates, settings: SpaceSettings = SETTINGS, clock: Array | None = None
) -> Space:
    """Return the space of a scene in its payload coordinates. Its clock has no deadline unless given."""
    reach, around, tolerance = (
        np.array([group.reach for group in coordinates.groups]),
        surroundings_of(scene),
        settings.tolerance,
    )
    normals = separating(len(scene.body.solids), around.n_things)
    return Space(
        coordinates.blocks,
        reach,
        around,
        Timing.none(scene.displacements(np.zeros(0))),
        Query(np.arange(around.n_things), normals, np.zeros(0), tolerance, tolerance),
        scene.clearance,
        settings.cap + scene.clearance,
        clock_until() if clock is None else clock,
        np.empty((DEPTH, 2)),
        np.zeros(2, dtype=np.int64),
        settings,
    )


def lifted(scene: Scene, space: Space, q: Array, end: str, margin: float) -> Array:
    """Return an end's configuration, lifted off its supports to a margin [m].

    The margin adds to the clearance. Where other obstacles are nearer, the lifted configuration with most clearance
    is returned; the end itself where it rests on nothing. Paths are planned from there, as they keep the clearance
    throughout.

    Parameters
    ----------
    q : array, shape (n_columns,), configuration of the end
    end : "start" or "goal"
    """
    rests = [rest for rest in scene.rests if rest.end == end]
    if not rests:
        return q
    way, blocks, nodes = lift_direction(rests), space.blocks, np.empty((space.blocks.node.shape[0], 3))
    place_one(blocks, q, 1.0, nodes)
    missing = [scene.clearance + margin - scene.distance_from(rest.obstacle, nodes) for rest in rests]
    high = max(lack / float(rest.normal @ way) for lack, rest in zip(missing, rests, strict=True))
    if high <= 0.0:
        return q
    tried = []
    for share in LIFTS:
        there = np.array(q)
        for center in blocks.center:
            there[center[: blocks.n_dims]] += share * high * way[: blocks.n_dims]
        keep_mask(blocks, there)
        tried.append((min(clearance_of(space, there, nodes, 0.0), space.required + margin), there))
    return tried[first_largest([clearance for clearance, _ in tried])][1]


@kernel(counted=False)
def clearance_of(space, q, nodes, floor):
    """Return the clearance [m] of configuration q, at most the cap; a result below `floor` need not be exact.

    Once time is up, the result is -inf. `nodes` is scratch space, array of shape (n_nodes, 3).
    """
    return _clearance_at(space, space.untimed.moved, RESTING, q, nodes, floor)


@kernel(counted=False)
def clearance_in_time(space, timing, node, nodes, floor):
    """Return `clearance_of` a node at its time; `timing` as of an edge."""
    return _clearance_at(space, timing.moved, instant_of(timing, node), node, nodes, floor)


@kernel(counted=False)
def _clearance_at(space, moved, instant, q, nodes, floor):
    around = space.around
    bodies = around.edges.shape[0] + around.solids.shape[0] * SOLID_WORK
    obstacles = around.convex.shape[0] + MESH_WORK * count_meshes(around.surfaces)
    if worked(space.clock, 1 + bodies * (1 + obstacles)):
        return -np.inf
    place_one(space.blocks, q, 1.0, nodes)
    clearance = min(space.cap, from_border(around, nodes))
    for i in range(around.separations.shape[0]):
        a, b = nodes[around.pairs[i, 0]], nodes[around.pairs[i, 1]]
        apart = sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)
        clearance = min(clearance, space.required + 0.5 * (apart - around.separations[i]))
    for b in range(space.blocks.tilt.shape[0]):
        if space.blocks.tilt[b] < pi:  # which a span spends as it does distances
            clearance = min(clearance, space.required + _tilt_left(space, b, q))
    if clearance <= floor:
        return clearance
    return least_distance(around, moved, instant, nodes, space.query, clearance, floor)


@kernel
def _tilt_left(space, b, q):
    """Return the span [m] that a group may still tilt."""
    return space.reach[b] * (space.blocks.tilt[b] - lean(space.blocks, b, q, np.empty(3)))


@kernel
def angle_between(kind, n_dims, p, q, o):
    """Return the angle [rad] between two orientations. They start at column o."""
    if kind == POINT:
        return 0.0
    if kind == ANGLE:
        return abs(wrapped(q[o] - p[o]))
    width = n_dims if kind == DIRECTION else 4
    dot = 0.0
    for i in range(o, o + width):
        dot += p[i] * q[i]
    if kind == QUATERNION:
        return 2.0 * acos(min(1.0, abs(dot)))
    return acos(min(1.0, max(-1.0, dot)))


@kernel(counted=False)
def span(space, p, q):
    """Bound the displacement of any keypoint between two configurations from above [m]."""
    blocks, longest = space.blocks, 0.0
    for b in range(blocks.kind.shape[0]):
        moved = 0.0
        for axis in range(blocks.n_dims):
            c = blocks.center[b, axis]
            moved += (q[c] - p[c]) ** 2
        angle = angle_between(blocks.kind[b], blocks.n_dims, p, q, blocks.turn[b])
        longest = max(longest, sqrt(moved) + space.reach[b] * angle)
    return longest


@kernel
def may_be_within(space, p, q, far):
    """Return whether a span may be below `far` [m]. Only the first block's centre is compared."""
    moved, blocks = 0.0, space.blocks
    for axis in range(blocks.n_dims):
        c = blocks.center[0, axis]
        moved += (q[c] - p[c]) ** 2
    return moved < far * far


@kernel
def distances_along(space, path):
    """Return path lengths up to each configuration [m].

    They are sums of spans; array, shape (n_configurations,).
    """
    reached = np.zeros(path.shape[0])
    for i in range(path.shape[0] - 1):
        reached[i + 1] = reached[i] + span(space, path[i], path[i + 1])
    return reached


def way_length(space: Space, way: Array) -> float:
    """Return the length of a path [m]; `way` has the shape (n_steps, n_columns)."""
    return float(distances_along(space, way)[-1])


@kernel(counted=False)
def interpolate(space, p, q, f, out):
    """Write the configuration at the share f from p to q. Angles are unwrapped with respect to p."""
    blocks = space.blocks
    for b in range(blocks.kind.shape[0]):
        kind, o, n_dims = blocks.kind[b], blocks.turn[b], blocks.n_dims
        for axis in range(n_dims):
            c = blocks.center[b, axis]
            out[c] = p[c] + f * (q[c] - p[c])
        if kind == ANGLE:
            out[o] = p[o] + f * wrapped(q[o] - p[o])
        elif kind != POINT:
            width = n_dims if kind == DIRECTION else 4
            _great_circle(p, q, o, width, f, kind == QUATERNION, out)


@kernel
def _great_circle(p, q, o, width, f, either_sign, out):
    dot = 0.0
    for c in range(o, o + width):
        dot += p[c] * q[c]
    sign = -1.0 if either_sign and dot < 0.0 else 1.0
    angle = acos(min(1.0, max(-1.0, sign * dot)))
    if angle < 1e-6:
        a, b = 1.0 - f, f
    else:
        a, b = sin((1.0 - f) * angle) / sin(angle), sin(f * angle) / sin(angle)
    norm = 0.0
    for c in range(o, o + width):
        out[c] = a * p[c] + b * sign * q[c]
        norm += out[c] ** 2
    for c in range(o, o + width):
        out[c] /= sqrt(norm)


@kernel(counted=False)
def edge_is_free(space, p, q, margin, scratch, nodes):
    """Return whether the body keeps a margin [m] along an edge.

    Parameters
    ----------
    p, q, scratch : arrays, shape (n_columns or more,); scratch is overwritten
    nodes : scratch space, array, shape (n_nodes, 3)
    """
    return edge_is_free_in_time(space, space.untimed, p, q, margin, scratch, nodes)


@kernel(counted=False)
def edge_is_free_in_time(space, timing, p, q, margin, scratch, nodes):
    """Return whether an edge between timed nodes is free and slow enough.

    Parameters
    ----------
    timing : times of nodes
    p, q, margin, scratch, nodes : as of `edge_is_free`; a time is the last entry of a node
    """
    moved = span(space, p, q)
    if too_fast(timing, moved, p, q):
        return False
    length, last = moved + drift(timing, p, q), clearance_in_time(space, timing, q, nodes, margin) - margin
    if last <= 0.0 or last >= length:
        return last > 0.0
    first = clearance_in_time(space, timing, p, nodes, margin) - margin
    if first <= 0.0:
        return False
    creeping, top, parts = 0, 1, space.parts  # that are still to be checked, as lengths from p
    parts[0, 0], parts[0, 1] = first, length - last
    while top > 0:
        top -= 1
        begin, end = parts[top, 0], parts[top, 1]
        if begin >= end:
            continue
        middle = 0.5 * (begin + end)
        interpolate(space, p, q, middle / length, scratch)
        write_time(timing, p, q, middle / length, scratch)
        clearance = clearance_in_time(space, timing, scratch, nodes, margin) - margin
        creeping += clearance < space.settings.tolerance
        if clearance <= 0.0 or creeping > space.settings.creeping or top + 2 > DEPTH:
            return False
        parts[top, 0], parts[top, 1] = begin, middle - clearance
        parts[top + 1, 0], parts[top + 1, 1] = middle + clearance, end
        top += 2
    return True


@kernel
def deforms(space, one, other, margin):
    """Return whether a planar path deforms into another with a margin [m].

    Each runs at a pace of its own: a path leads through the free-space diagram of straight moves between the two
    (Alt and Godau, 1995).

    Parameters
    ----------
    one, other : arrays, shapes (n_one, n_columns) and (n_other, n_columns), with angles unwrapped
    """
    last_one, last_other = one.shape[0] - 1, other.shape[0] - 1
    scratch, nodes = np.empty(one.shape[1]), np.empty((space.blocks.node.shape[0], 3))
    seen = np.zeros((last_one + 1, last_other + 1), dtype=np.bool_)
    stack, top = np.zeros((3 * seen.size + 1, 2), dtype=np.int64), 1
    while top > 0:
        top -= 1
        i, j = stack[top]
        if seen[i, j]:
            continue
        seen[i, j] = True
        if not _turns_alike(space.blocks, one[i], other[j]):
            continue
        if not edge_is_free(space, one[i], other[j], margin, scratch, nodes):
            continue
        if i == last_one and j == last_other:
            return True
        for step in range(3):  # the last one is tried next: both move
            on, off = int(step != 1), int(step != 0)
            if i + on <= last_one and j + off <= last_other:
                stack[top, 0], stack[top, 1] = i + on, j + off
                top += 1
    return False


@kernel
def _turns_alike(blocks, p, q):
    """Return whether no orientation differs by more than 90 degrees; else one might turn once more than the other."""
    for b in range(blocks.kind.shape[0]):
        kind, o = blocks.kind[b], blocks.turn[b]
        turned = abs(q[o] - p[o]) if kind == ANGLE else 0.0
        if kind == DIRECTION:
            turned = angle_between(kind, blocks.n_dims, p, q, o)
        if turned > 0.5 * pi:
            return False
    return True


@kernel
def nearest(space, tree, count, q):
    """Return the index of the nearest of the first `count` nodes."""
    best, least = 0, np.inf
    for i in range(count):
        if may_be_within(space, tree[i], q, least):
            distance = span(space, tree[i], q)
            if distance < least:
                best, least = i, distance
    return best


@kernel
def random_configuration(space, rng, out):
    """Write a random configuration, uniform in workspace and orientations. It meets the bodies' constraints."""
    blocks, lower, upper = space.blocks, space.around.lower, space.around.upper
    for b in range(blocks.kind.shape[0]):
        for axis in range(blocks.n_dims):
            c = blocks.center[b, axis]
            out[c] = lower[axis] + rng.random() * (upper[axis] - lower[axis])
        random_turn(blocks, b, rng, out)
    keep_mask(blocks, out)


@kernel
def random_turn(blocks, b, rng, out):
    """Write a random orientation of a block. Its `up` is near the vertical where required."""
    o, most = blocks.turn[b], blocks.tilt[b]
    if most >= pi:
        random_orientation(blocks.kind[b], blocks.n_dims, o, rng, out)
        return
    yaw, about, half = pi * rng.random(), 2 * pi * rng.random(), 0.5 * most * sqrt(rng.random())
    w, x, y, z = blocks.level[b]
    c, s = cos(yaw), sin(yaw)
    w, x, y, z = c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w
    a, b1 = sin(half) * cos(about), sin(half) * sin(about)
    c = cos(half)
    out[o], out[o + 1] = c * w - a * x - b1 * y, c * x + a * w + b1 * z
    out[o + 2], out[o + 3] = c * y - a * z + b1 * w, c * z + a * y - b1 * x


@kernel
def random_orientation(kind, n_dims, o, rng, out):
    """Write a random orientation of one block, uniform over all orientations."""
    if kind == ANGLE:
        out[o] = 2 * pi * rng.random() - pi
    elif kind != POINT:
        width = n_dims if kind == DIRECTION else 4
        norm = 0.0
        while norm < 1e-6:
            norm = 0.0
            for c in range(o, o + width):
                out[c] = rng.standard_normal()
                norm += out[c] ** 2
        for c in range(o, o + width):
            out[c] /= sqrt(norm)


@kernel
def in_an_obstacle(obstacles, x, y, z):
    """Return whether a point lies in any obstacle."""
    for j in range(obstacles.shape[0]):
        if point_distance(obstacles, j, x, y, z) < 0.0:
            return True
    return False


@kernel
def wrapped(angle):
    """Return the angle [rad], wrapped to the range from -pi to pi."""
    return angle - 2 * pi * np.round(angle / (2 * pi))
