"""Contacts: the places of a movement where the payload is near obstacles.

A movement is checked at even samples, and between them where it is nearest. Every contact is a point of the payload,
the direction away from the obstacle, and the distance: the data of a linearised clearance.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.contacts.displaced import carried_back, carried_forward, moves, turned_forward
from comove.contacts.query import nearest_point, normal_at, part_apart
from comove.contacts.surroundings import (
    Surroundings,
    corner_of,
    count_corners,
    count_parts,
    most_corners,
    radius_of,
    surroundings_of,
    whose,
)
from comove.geometry.distances import distance_and_gradient, point_distance
from comove.geometry.surfaces import count_meshes
from comove.model.coordinates import ANGLE, DIRECTION, POINT, Coordinates
from comove.model.moving import Displacements
from comove.model.scene import Scene

CLOSE = 0.03  # m, distance below which a part is checked at all samples, and at the ends of rods and corners
# One sample in so many becomes a contact when close, and up to three times as far; beyond that, one in 12.
FINE, COARSE = 2, 4
TOLERANCE = 1e-6  # m, of the distance of a rod
HALVINGS = 3  # halvings of the step in the search for the nearest place between samples

# Columns of a contact: sample, share of the time to the next or previous sample (-1 to 1), block of the point, block
# of the other hand if two must stay apart (else -1), point, direction, the other hand, distance [m], owner.
SAMPLE, TAU, BLOCK, OTHER, PLACE, NORMAL, MATE, DISTANCE, OWNER, N_FIELDS = 0, 1, 2, 3, 4, 7, 10, 13, 14, 15


class MovedLoad(NamedTuple):
    """A payload among its surroundings, and the coordinates that move it.

    Attributes
    ----------
    around : payload and its obstacles
    block : array of int, shape (n_nodes,), block of the coordinates that moves each node
    n_owners : number of obstacles; as owners of contacts, the border and the separations follow them
    """

    around: Surroundings
    block: Integers
    n_owners: int


class Transit(NamedTuple):
    """A movement through its surroundings.

    Attributes
    ----------
    load : the payload and its surroundings
    nodes : array, shape (n_samples, n_nodes, 3), positions of the nodes [m]
    moved : displacements of the obstacles at the samples; none if nothing moves
    way : array, shape (n_samples,), sum, since the first sample, of the largest displacement of any node [m]
    """

    load: MovedLoad
    nodes: Array
    moved: Displacements
    way: Array


def moved_load(scene: Scene, coordinates: Coordinates) -> MovedLoad:
    """Return a scene's payload with its surroundings, as coordinates move it."""
    blocks = coordinates.blocks
    block = np.zeros(len(blocks.node), dtype=np.int64)
    for b in range(len(blocks.kind)):
        block[blocks.node[blocks.first[b] : blocks.first[b + 1]]] = b
    last = scene.owners.max(initial=len(scene.file.obstacles) - 1)  # higher where some were only seen
    return MovedLoad(surroundings_of(scene), block, int(last) + 1)


@kernel
def find_contacts(load, nodes, moved, cutoff, found, least):
    """Write the contacts nearer than `cutoff` into `found` and return their number.

    Parameters
    ----------
    load : MovedLoad
    nodes : array, shape (n_samples, n_nodes, 3), positions of the nodes [m]
    moved : Displacements of the obstacles at the samples; none if nothing moves
    found : array, shape (n_most, N_FIELDS); n_most = 0 if only `least` is needed
    least : array, shape (n_owners + 2,), into which are written the least distance from each obstacle,
        from the border, and of end effectors beyond their separation [m], each at most `cutoff`
    """
    least[:] = cutoff
    around, transit = load.around, Transit(load, nodes, moved, _way(nodes))
    n_samples, n_rows, n_meshes = nodes.shape[0], around.convex.shape[0], count_meshes(around.surfaces)
    distance, tau = np.empty(n_samples), np.zeros(n_samples)
    contact, points = np.zeros(N_FIELDS), np.empty((most_corners(around.solids) + 2, 3))
    n = 0
    for part in range(count_parts(around)):
        for thing in range(n_rows + n_meshes):
            row, owner = whose(around, thing)
            if not _look_along(transit, part, thing, row, cutoff, distance, tau, points):
                continue
            for s in range(n_samples):
                least[owner] = min(least[owner], distance[s])
            for s in range(1, n_samples - 1):
                if found.shape[0] == 0 or distance[s] >= cutoff:
                    continue
                nearest = distance[s] <= distance[s - 1] and distance[s] <= distance[s + 1]
                if not _kept(s, distance[s], nearest):
                    continue
                _look(transit, part, thing, row, s, tau[s], cutoff, points)
                _describe(transit, part, thing, row, s, tau[s], points, contact)
                contact[DISTANCE], contact[OWNER] = distance[s], owner
                n = _written(contact, found, n)
                if distance[s] < CLOSE and thing < n_rows:
                    n = _ends(transit, part, thing, row, cutoff, contact, found, n)
    n = _border(load, nodes, cutoff, contact, found, least, n)
    return _apart(load, nodes, cutoff, contact, found, least, n)


@kernel
def _way(nodes):
    """Return the summed largest displacement of any keypoint; array, shape (n_samples,)."""
    way = np.zeros(nodes.shape[0])
    for s in range(1, nodes.shape[0]):
        moved = 0.0
        for i in range(nodes.shape[1]):
            square = 0.0
            for axis in range(3):
                square += (nodes[s, i, axis] - nodes[s - 1, i, axis]) ** 2
            moved = max(moved, square)
        way[s] = way[s - 1] + sqrt(moved)
    return way


@kernel(counted=False)
def _kept(s, distance, nearest):
    """Return whether a sample becomes a contact."""
    if distance < CLOSE:
        return nearest or s % FINE == 0
    if distance < 3 * CLOSE:
        return s % COARSE == 0
    return s % (3 * COARSE) == 0


@kernel(counted=False)
def _written(contact, found, n):
    """Append a contact if there is space; return the number of contacts."""
    if n == found.shape[0]:
        return n
    for field in range(N_FIELDS):  # assigning the array would take a second more to compile
        found[n, field] = contact[field]
    return n + 1


@kernel(counted=False)
def _look_along(transit, part, thing, row, cutoff, distance, tau, points):
    """Write a part's distances from a thing, and nearest places between samples.

    Returns
    -------
    bool, whether any distance is below `cutoff`
    """
    (load, nodes, moved, way), changes = transit, moves(transit.moved, row)
    n_samples, any_near, far = way.shape[0], False, cutoff + CLOSE
    distance[:], tau[:] = far, 0.0
    for s in range(0, n_samples, COARSE):
        if part_apart(load.around, moved, (s, s, 0.0), nodes[s], part, thing, row, far) < far:
            distance[s] = _look(transit, part, thing, row, s, 0.0, far, points)
    for first in range(0, n_samples - 1, COARSE):
        last = min(first + COARSE, n_samples - 1)
        between = min(distance[first], distance[last])
        # In between, the distance is smaller by half of the way at most: samples are skipped where that is still far.
        worth = changes or between - 0.5 * (way[last] - way[first]) <= min(CLOSE, cutoff)
        for s in range(first + 1, last):
            distance[s] = between
            if (
                worth
                and part_apart(load.around, moved, (s, s, 0.0), nodes[s], part, thing, row, cutoff) < cutoff
            ):
                distance[s] = _look(transit, part, thing, row, s, 0.0, cutoff, points)
    for s in range(n_samples):
        distance[s] = min(distance[s], cutoff)
        any_near = any_near or distance[s] < cutoff
    if not any_near:
        return False
    before = distance[0]
    for s in range(1, n_samples - 1):
        here = distance[s]
        if here < min(CLOSE, cutoff) and here <= before and here <= distance[s + 1]:
            step = 0.5
            for _ in range(HALVINGS):
                middle = tau[s]
                for sign in (-1.0, 1.0):
                    place = middle + sign * step
                    between = _look(transit, part, thing, row, s, place, cutoff, points)
                    if between < distance[s]:
                        distance[s], tau[s] = between, place
                step *= 0.5
        before = here
    return True


@kernel(counted=False)
def _instant(s, tau):
    return s, s + (1 if tau > 0.0 else -1 if tau < 0.0 else 0), abs(tau)


@kernel(counted=False)
def _look(transit, part, thing, row, s, tau, cutoff, points):
    """Return a part's distance [m] from a thing, at most `cutoff`.

    Written into `points` are the corners of the part in the thing's frame, then the nearest point, and, for a mesh,
    its direction from the thing.
    """
    around, nodes, instant = transit.load.around, transit.nodes, _instant(s, tau)
    n_corners, (_, t, w) = count_corners(around, part), instant
    for i in range(n_corners):
        k = corner_of(around, part, i)
        for axis in range(3):
            points[i, axis] = (1 - w) * nodes[s, k, axis] + w * nodes[t, k, axis]
        points[i, 0], points[i, 1], points[i, 2] = carried_back(
            transit.moved, row, instant, points[i, 0], points[i, 1], points[i, 2]
        )
    near, normal = points[points.shape[0] - 2], points[points.shape[0] - 1]
    return nearest_point(around, part, thing, row, points[:n_corners], cutoff, TOLERANCE, near, normal)


@kernel(counted=False)
def _describe(transit, part, thing, row, s, tau, points, contact):
    """Write the contact that `_look` found, except distance and owner."""
    around, place, normal = transit.load.around, contact[PLACE : PLACE + 3], contact[NORMAL : NORMAL + 3]
    for axis in range(3):
        place[axis], normal[axis] = points[points.shape[0] - 2, axis], points[points.shape[0] - 1, axis]
    normal_at(around, part, thing, row, place, normal)
    carried_forward(transit.moved, row, _instant(s, tau), place)
    turned_forward(transit.moved, row, _instant(s, tau), normal)
    contact[SAMPLE], contact[TAU], contact[OTHER] = s, tau, -1
    contact[BLOCK] = transit.load.block[corner_of(around, part, 0)]


@kernel(counted=False)
def _ends(transit, part, thing, row, cutoff, contact, found, n):
    """Write contacts of a part's near corners; return the number of contacts. The nearest point is left out."""
    around, nodes, moved = transit.load.around, transit.nodes, transit.moved
    place, normal, obstacles = contact[PLACE : PLACE + 3], contact[NORMAL : NORMAL + 3], around.obstacles
    instant, a, b, c = _instant(int(contact[SAMPLE]), contact[TAU]), place[0], place[1], place[2]
    s, t, w = instant
    for corner in range(count_corners(around, part)):
        i = corner_of(around, part, corner)
        for axis in range(3):
            place[axis] = (1 - w) * nodes[s, i, axis] + w * nodes[t, i, axis]
        if (place[0] - a) ** 2 + (place[1] - b) ** 2 + (place[2] - c) ** 2 < 1e-12:
            continue
        x, y, z = carried_back(moved, row, instant, place[0], place[1], place[2])
        distance = point_distance(obstacles, row, x, y, z) - radius_of(around, part)
        if distance >= cutoff:
            continue
        _, normal[0], normal[1], normal[2] = distance_and_gradient(obstacles, row, x, y, z)
        turned_forward(moved, row, instant, normal)
        contact[DISTANCE] = distance
        n = _written(contact, found, n)
    return n


@kernel(counted=False)
def _border(load, nodes, cutoff, contact, found, least, n):
    """Write contacts with the workspace border; return the number of contacts."""
    contact[TAU], contact[OTHER], contact[OWNER] = 0.0, -1, load.n_owners
    for s in range(1, nodes.shape[0] - 1):
        for i in range(nodes.shape[1]):
            if load.around.thickness[i] < 0.0:
                continue
            for axis in range(3):
                for side in (1.0, -1.0):
                    border = load.around.lower[axis] if side > 0.0 else load.around.upper[axis]
                    distance = side * (nodes[s, i, axis] - border) - load.around.thickness[i]
                    least[load.n_owners] = min(least[load.n_owners], distance)
                    if distance >= cutoff or s % COARSE != 0 or found.shape[0] == 0:
                        continue
                    contact[SAMPLE], contact[BLOCK], contact[DISTANCE] = s, load.block[i], distance
                    for k in range(3):
                        contact[PLACE + k] = nodes[s, i, k]
                        contact[NORMAL + k] = side if k == axis else 0.0
                    n = _written(contact, found, n)
    return n


@kernel(counted=False)
def _apart(load, nodes, cutoff, contact, found, least, n):
    """Write contacts of end effectors that must stay apart; return the number of contacts."""
    contact[TAU], contact[OWNER] = 0.0, load.n_owners + 1
    around = load.around
    for k in range(around.separations.shape[0]):
        i, j = around.pairs[k, 0], around.pairs[k, 1]
        contact[BLOCK], contact[OTHER] = load.block[i], load.block[j]
        for s in range(1, nodes.shape[0] - 1):
            length = 0.0
            for axis in range(3):
                contact[NORMAL + axis] = nodes[s, i, axis] - nodes[s, j, axis]
                length += contact[NORMAL + axis] ** 2
            length = max(sqrt(length), 1e-12)
            distance = length - around.separations[k]
            least[load.n_owners + 1] = min(least[load.n_owners + 1], distance)
            if distance >= cutoff or s % FINE != 0 or found.shape[0] == 0:
                continue
            contact[SAMPLE], contact[DISTANCE] = s, distance
            for axis in range(3):
                contact[NORMAL + axis] /= length
                contact[PLACE + axis], contact[MATE + axis] = nodes[s, i, axis], nodes[s, j, axis]
            n = _written(contact, found, n)
    return n


@kernel
def spins(blocks, b, q, turns):
    """Write the angular velocities of unit rates of a block's orientation.

    Parameters
    ----------
    q : array, shape (n_columns,), configuration
    turns : array, shape (4, 3), into whose first rows the angular velocities are written

    Returns
    -------
    int, number of columns of the orientation
    """
    kind, o = blocks.kind[b], blocks.turn[b]
    turns[:] = 0.0
    if kind == POINT:
        return 0
    if kind == ANGLE:
        turns[0, 2] = 1.0
        return 1
    if kind == DIRECTION and blocks.n_dims == 2:
        square = q[o] ** 2 + q[o + 1] ** 2
        turns[0, 2], turns[1, 2] = -q[o + 1] / square, q[o] / square
        return 2
    if kind == DIRECTION:  # perpendicular to the direction; a rotation about it has no effect
        x, y, z = q[o], q[o + 1], q[o + 2]
        square = x * x + y * y + z * z
        turns[0, 1], turns[0, 2] = z / square, -y / square
        turns[1, 0], turns[1, 2] = -z / square, x / square
        turns[2, 0], turns[2, 1] = y / square, -x / square
        return 3
    w, x, y, z = q[o], q[o + 1], q[o + 2], q[o + 3]
    f = 2.0 / (w * w + x * x + y * y + z * z)
    turns[0, 0], turns[0, 1], turns[0, 2] = -f * x, -f * y, -f * z
    turns[1, 0], turns[1, 1], turns[1, 2] = f * w, f * z, -f * y
    turns[2, 0], turns[2, 1], turns[2, 2] = -f * z, f * w, f * x
    turns[3, 0], turns[3, 1], turns[3, 2] = f * y, -f * x, f * w
    return 4


@kernel
def _slope(blocks, b, q, point, normal, sign, slope, turns):
    """Add the derivatives of a block's point along `normal` to `slope`. Its shape is (n_columns,)."""
    width = spins(blocks, b, q, turns)
    x, y, z = point[0] - q[blocks.center[b, 0]], point[1] - q[blocks.center[b, 1]], point[2]
    if blocks.n_dims == 3:
        z -= q[blocks.center[b, 2]]
    for axis in range(blocks.n_dims):
        slope[blocks.center[b, axis]] += sign * normal[axis]
    mx, my, mz = y * normal[2] - z * normal[1], z * normal[0] - x * normal[2], x * normal[1] - y * normal[0]
    for k in range(width):
        slope[blocks.turn[b] + k] += sign * (turns[k, 0] * mx + turns[k, 1] * my + turns[k, 2] * mz)


@kernel
def linearised(blocks, contacts, q, off, shape, rows, distance):
    """Write distances as linear functions of the weights, ``distance + rows dz``.

    Parameters
    ----------
    contacts : array, shape (n, N_FIELDS)
    q : array, shape (n_samples, n_columns), configurations at which the contacts were found
    off : array, shape (n_samples, n_columns), `q` less the configurations of the movement whose weights change
    shape : array, shape (n_samples, n_basis), values of the basis functions
    rows : array, shape (n, n_columns * n_basis), written
    distance : array, shape (n,), written [m]
    """
    n_columns, n_basis = q.shape[1], shape.shape[1]
    here, slope, turns, b = np.empty(n_columns), np.empty(n_columns), np.empty((4, 3)), np.empty(n_basis)
    for r in range(contacts.shape[0]):
        contact = contacts[r]
        s, w = int(contact[SAMPLE]), abs(contact[TAU])
        t = s + (1 if contact[TAU] > 0.0 else -1 if contact[TAU] < 0.0 else 0)
        for c in range(n_columns):
            here[c], slope[c] = (1 - w) * q[s, c] + w * q[t, c], 0.0
        for k in range(n_basis):
            b[k] = (1 - w) * shape[s, k] + w * shape[t, k]
        normal = contact[NORMAL : NORMAL + 3]
        _slope(blocks, int(contact[BLOCK]), here, contact[PLACE : PLACE + 3], normal, 1.0, slope, turns)
        if contact[OTHER] >= 0:
            _slope(blocks, int(contact[OTHER]), here, contact[MATE : MATE + 3], normal, -1.0, slope, turns)
        distance[r] = contact[DISTANCE]
        for c in range(n_columns):
            distance[r] -= slope[c] * ((1 - w) * off[s, c] + w * off[t, c])
            for k in range(n_basis):
                rows[r, c * n_basis + k] = slope[c] * b[k]


@kernel
def hand_slopes(blocks, block, nodes, q, n_hands):
    """Return the end effectors' derivatives by column; array, shape (n_samples, n_hands, n_dims, n_columns).

    Parameters
    ----------
    block : array of int, shape (n_nodes,), block that moves each keypoint
    nodes : array, shape (n_samples, n_nodes, 3) [m]
    q : array, shape (n_samples, n_columns)
    """
    n_samples, n_columns = q.shape
    slopes = np.zeros((n_samples, n_hands, blocks.n_dims, n_columns))
    turns, arm = np.empty((4, 3)), np.zeros(3)
    for s in range(n_samples):
        for i in range(n_hands):
            b = block[i]
            width = spins(blocks, b, q[s], turns)
            for axis in range(blocks.n_dims):
                column = blocks.center[b, axis]
                arm[axis], slopes[s, i, axis, column] = nodes[s, i, axis] - q[s, column], 1.0
            for k in range(width):
                column, (x, y, z), (u, v, w) = blocks.turn[b] + k, turns[k], arm
                slopes[s, i, 0, column], slopes[s, i, 1, column] = y * w - z * v, z * u - x * w
                if blocks.n_dims == 3:
                    slopes[s, i, 2, column] = x * v - y * u
    return slopes
