"""Paths through the same places in other orientations.

Most paths through windows differ in the orientations in which they pass them: a bar with one end or the other first,
a flat body with either side up. Trees find one of them, by chance. So a path is divided into places. In each of them
the payload fills about the same room in some other orientations. The shortest path in the graph of free moves between
all of these is a better path, or another one where the orientation of one place is barred.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.compiled import kernel
from comove.geometry.rotations import quaternion_product
from comove.model.coordinates import ANGLE, DIRECTION, POINT
from comove.planning.configurations import Space, clearance_of, distances_along, edge_is_free, span
from comove.planning.planner import along, sample

N_PLACES = 40  # of a path
ON = 4  # places that one move may lead on, at most
Places = Array
"""Places of a path in all orientations to try, its own first; array, shape (n_places, n_turns, n_columns)."""


def can_turn(space: Space) -> bool:
    """Return whether other orientations are tried: of one free body."""
    kind = space.blocks.kind
    return len(kind) == 1 and kind[0] != POINT and len(space.blocks.mask) == 0


def places_along(space: Space, path: Array) -> Places:
    """Return places between and at configurations, in all orientations to try.

    Parameters
    ----------
    path : array, shape (n_configurations, n_columns)
    """
    reached = distances_along(space, path)
    parts = np.maximum(np.ceil(np.diff(reached) * N_PLACES / max(reached[-1], 1e-12)), 1.0).astype(int)
    at = [a + (b - a) * np.arange(n) / n for (a, b), n in zip(pairwise(reached), parts, strict=True)]
    own = np.empty((parts.sum() + 1, path.shape[1]))
    sample(space, path, reached, np.append(np.concatenate(at), reached[-1]), own)
    return _turned(space, own)


def places_of(space: Space, way: Array) -> Places:
    """Return evenly spaced places of a motion in all orientations to try.

    Parameters
    ----------
    way : array, shape (n_times, n_columns); directions and quaternions may have any length
    """
    turn = int(space.blocks.turn[0])
    way = way.copy()
    if space.blocks.kind[0] != ANGLE:
        way[:, turn:] /= np.linalg.norm(way[:, turn:], axis=1)[:, None]
    return _turned(space, along(space, way, np.linspace(0.0, 1.0, N_PLACES + 1)[None])[0])


def _turned(space: Space, own: Array) -> Places:
    turn, kind = int(space.blocks.turn[0]), space.blocks.kind[0]
    if kind in (ANGLE, DIRECTION):
        others = [own[:, turn:] + np.pi if kind == ANGLE else -own[:, turn:]]
    else:
        others = [
            quaternion_product(own[:, turn:], np.append(0.0, axis))
            for axis in principal_axes(space.blocks.point)
        ]
    return np.stack([own, *(np.hstack([own[:, :turn], other]) for other in others)], axis=1)


def principal_axes(points: Array) -> Array:
    """Return the principal axes of points, (n_points, 3); array, shape (3, 3), an axis a row.

    Second moments are rounded, so that axes of equal moments are the frame's own and not up to rounding.
    """
    centered = points - points.mean(axis=0)
    moments = (centered[:, :, None] * centered[:, None, :]).sum(axis=0)
    return np.linalg.eigh(np.round(moments / max(np.trace(moments), 1e-300), 9))[1].T


def narrow_places(space: Space, places: Places) -> list[int]:
    """Return the numbers of places of locally least clearance, narrowest first."""
    room = _room(space, places)
    least = [
        k
        for k in range(ON, len(room) - ON)
        if room[k] <= room[k - ON : k + ON + 1].min() and room[k] < space.reach[0]
    ]
    return sorted(least, key=lambda k: room[k])


@kernel
def _room(space, places):
    """Return the clearances of places in their own orientation; array, shape (n_places,) [m]."""
    nodes, room = np.empty((space.blocks.node.shape[0], 3)), np.empty(places.shape[0])
    for k in range(places.shape[0]):
        room[k] = clearance_of(space, places[k, 0], nodes, -np.inf)
    return room


def shortest_turned(space: Space, path: Array, margin: float) -> Array:
    """Return the shortest path through a path's places; array, shape (n, n_columns)."""
    places = places_along(space, path)
    chosen = _shortest(space, places, _passable(places), margin)
    return np.ascontiguousarray(places[chosen[:, 0], chosen[:, 1]]) if chosen[:, 1].any() else path


def turned_otherwise(space: Space, way: Array, margin: float) -> list[Array]:
    """Return shortest paths with another orientation at one narrow place.

    Parameters
    ----------
    way : array, shape (n_times, n_columns), as of `places_of`
    margin : clearance that is kept [m]

    Returns
    -------
    list of arrays, shape (n, n_columns); of those that agree in all narrow places, one
    """
    places = places_of(space, way)
    narrow = narrow_places(space, places)
    found = dict[tuple[int, ...], Array]()
    for place in narrow:
        passable = _passable(places)
        passable[place - ON // 2 : place + ON // 2 + 1, 0] = False
        chosen = _shortest(space, places, passable, margin)
        if len(chosen) > 0:
            turns = chosen[np.searchsorted(chosen[:, 0], narrow), 1]
            found.setdefault(tuple(turns.tolist()), np.ascontiguousarray(places[chosen[:, 0], chosen[:, 1]]))
    return list(found.values())


def _passable(places: Places) -> NDArray[np.bool_]:
    passable = np.ones(places.shape[:2], dtype=bool)
    passable[0, 1:] = passable[-1, 1:] = False
    return passable


@kernel(nogil=True)
def _shortest(space, places, passable, margin):
    """Return places and orientations of the shortest path; array of int, shape (n, 2), empty without one."""
    n_places, n_turns = places.shape[0], places.shape[1]
    scratch, nodes = np.empty(places.shape[2]), np.empty((space.blocks.node.shape[0], 3))
    gone = np.full((n_places, n_turns), np.inf)
    came = np.full((n_places, n_turns, 2), -1)
    way = np.empty(ON * n_turns)
    gone[0, 0] = 0.0
    for j in range(1, n_places):
        for turn in range(n_turns):
            if not passable[j, turn]:
                continue
            q = places[j, turn]
            for back in range(ON):
                for k in range(n_turns):
                    i = j - 1 - back
                    way[back * n_turns + k] = np.inf
                    if i >= 0 and gone[i, k] < np.inf:
                        way[back * n_turns + k] = gone[i, k] + span(space, places[i, k], q)
            for _ in range(ON * n_turns):
                best = np.argmin(way)
                if way[best] == np.inf:
                    break
                i, k = j - 1 - best // n_turns, best % n_turns
                if edge_is_free(space, places[i, k], q, margin, scratch, nodes):
                    gone[j, turn], came[j, turn, 0], came[j, turn, 1] = way[best], i, k
                    break
                way[best] = np.inf
    if gone[n_places - 1, 0] == np.inf:
        return np.empty((0, 2), dtype=np.int64)
    count, i, k = 1, n_places - 1, 0
    while i > 0:
        i, k = came[i, k, 0], came[i, k, 1]
        count += 1
    out = np.empty((count, 2), dtype=np.int64)
    i, k = n_places - 1, 0
    for row in range(count - 1, -1, -1):
        out[row, 0], out[row, 1] = i, k
        i, k = came[i, k, 0], came[i, k, 1]
    return out
