"""The parts of a mesh: solids, where its triangles close, and sheets, where they do not.

Vertices at one place are merged, and so are triangles of the same vertices. Triangles that have an edge which no
other triangle shares are removed, again and again: this removes a fin, and all of an open box. The remainder of a
connected part is a solid if all its edges are shared by two triangles, or are traversed equally often in both
directions. Where neither holds, triangles that occur equally often in both orientations, such as a wall between two
solids, are examined apart from the rest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array, Integers
from comove.geometry.surfaces import Parts, holds, surface_of

SAME = 1e-9  # of a mesh's size, within which vertices are one
FLAT = 1e-12  # of the cube of a part's size: a smaller volume counts as 0


def solids_and_sheets(vertices: Array, faces: Integers) -> Parts:
    """Sort triangles by the solids and sheets that they form.

    Parameters
    ----------
    vertices, faces : arrays, shapes (n_vertices, 3) [m] and (n_faces, 3), in any order and orientation
    """
    vertices, faces, slack = welded(vertices, faces)
    areas = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    unique, both = _by_turns(faces[areas])
    lines = _apart(faces[~areas], unique)
    closed, sheets = [], [lines] if len(lines) else []
    for part in _connected(unique, len(vertices)):
        solids, rest = _closed_ones(vertices, unique[part])
        if not solids and both[part].any() and not both[part].all():
            for own in (part[~both[part]], part[both[part]]):
                more, rest = _closed_ones(vertices, unique[own])
                solids += more
                sheets += rest
        else:
            sheets += rest
        closed += solids
    return Parts(vertices, tuple(_outwards(vertices, closed)), tuple(sheets), slack)


def _apart(lines: Integers, faces: Integers) -> Integers:
    """Return the degenerate triangles that no other triangle contains."""
    pairs = faces[:, [(0, 1), (1, 2), (2, 0), (0, 0), (1, 1), (2, 2)]].reshape(-1, 2)
    n = 1 + max(int(lines.max(initial=0)), int(faces.max(initial=0)))
    known = pairs.min(axis=1) * n + pairs.max(axis=1)
    return lines[~np.isin(lines.min(axis=1) * n + lines.max(axis=1), known)]


def _closed_ones(vertices: Array, faces: Integers) -> tuple[list[Integers], list[Integers]]:
    """Return the solids of triangles, consistently oriented, and the remaining triangles."""
    shared = _without_rims(faces)
    solids, sheets = [], [] if shared.all() else [faces[~shared]]
    core = faces[shared]
    for part in (core[own] for own in _connected(core, len(vertices))):
        whole = part if is_closed(part) else _turned_alike(part)
        size = float(np.ptp(vertices[part], axis=(0, 1)).max())
        if whole is None or abs(volume_of(vertices[whole])) <= FLAT * size**3:
            sheets.append(part)
        else:
            solids.append(whole)
    return solids, sheets


def _without_rims(faces: Integers) -> NDArray[np.bool_]:
    """Return which triangles remain when those with unshared edges are removed repeatedly."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, side = np.unique(edges, axis=0, return_inverse=True)
    side = side.reshape(3, -1).T  # of every triangle, by number
    count, left = np.bincount(side.ravel()), np.ones(len(faces), dtype=bool)
    order = np.argsort(side.ravel(), kind="stable")
    owner, first = order // 3, np.concatenate([[0], np.cumsum(count)])
    waiting = [int(k) for k in np.flatnonzero((count[side] == 1).any(axis=1))]
    while waiting:
        k = waiting.pop()
        if not left[k]:
            continue
        left[k] = False
        for s in side[k]:
            count[s] -= 1
            if count[s] == 1:
                waiting += [int(other) for other in owner[first[s] : first[s + 1]] if left[other]]
    return left


def welded(vertices: Array, faces: Integers) -> tuple[Array, Integers, float]:
    """Return triangles without unused vertices, and equal vertices merged.

    The last result is how far vertices moved [m].
    """
    used, place = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], place.reshape(faces.shape)
    low = vertices.min(axis=0)
    width = float(np.ptp(vertices, axis=0).max())
    grid = np.round((vertices - low) / (SAME * width)).astype(np.int64)
    _, first, place = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    place = place.reshape(-1)
    moved = np.linalg.norm(vertices - vertices[first][place], axis=1)
    return vertices[first], place[faces], float(moved.max())


def _by_turns(faces: Integers) -> tuple[Integers, NDArray[np.bool_]]:
    """Return every triangle once, in its main orientation, and those without one."""
    order = np.argsort(faces, axis=1)
    _, first, which = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_inverse=True)
    # A permutation of three numbers is even if it is one of the turns.
    way = np.where(((np.roll(order, -1, axis=1) - order) % 3 == 1).all(axis=1), 1.0, -1.0)
    balance = np.bincount(which.reshape(-1), weights=way, minlength=len(first))
    kept, wrong = faces[first], balance * way[first] < 0
    kept[wrong] = kept[wrong][:, ::-1]
    return kept, balance == 0


def _connected(faces: Integers, n_vertices: int) -> list[Integers]:
    """Return the numbers of the faces of each connected part."""
    if not len(faces):
        return []
    from scipy.sparse import coo_array  # slow to import, and only meshes need it
    from scipy.sparse.csgraph import connected_components

    a, b, c = faces.T
    ends = np.concatenate([a, b]), np.concatenate([b, c])
    graph = coo_array((np.ones(len(ends[0])), ends), shape=(n_vertices, n_vertices))
    labels = connected_components(graph, directed=False)[1][a]
    order = np.argsort(labels, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)


def is_closed(faces: Integers) -> bool:
    """Return whether every edge is traversed equally often in both directions."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    n = int(faces.max()) + 1
    there, back = np.sort(edges[:, 0] * n + edges[:, 1]), np.sort(edges[:, 1] * n + edges[:, 0])
    return bool((there == back).all())


def _turned_alike(faces: Integers) -> Integers | None:
    """Return a part's faces in consistent orientation, None if not closed."""
    faces = faces.copy()
    neighbours: dict[frozenset[int], list[int]] = {}
    for k, face in enumerate(faces.tolist()):
        for i in range(3):
            neighbours.setdefault(frozenset((face[i], face[i - 1])), []).append(k)
    if any(len(both) != 2 for both in neighbours.values()):
        return None
    done = np.zeros(len(faces), dtype=bool)
    for seed in range(len(faces)):
        waiting = [] if done[seed] else [seed]
        done[seed] = True
        while waiting:
            k = waiting.pop()
            face = faces[k].tolist()
            for i in range(3):
                a, b = face[i - 1], face[i]
                one, two = neighbours[frozenset((a, b))]
                other = two if one == k else one
                if not done[other]:
                    there = faces[other].tolist()
                    if any(
                        there[j - 1] == a and there[j] == b for j in range(3)
                    ):  # the same way: it must turn
                        faces[other] = faces[other][::-1]
                    done[other] = True
                    waiting.append(other)
    return faces if is_closed(faces) else None


def volume_of(corners: Array) -> float:
    """Return the volume of triangles (n_triangles, 3, 3) [m^3]. It is negative where they are turned inwards."""
    a, b, c = np.moveaxis(corners - corners.mean(axis=(0, 1)), 1, 0)
    return float((a * np.cross(b, c)).sum()) / 6


def _outwards(vertices: Array, parts: list[Integers]) -> list[Integers]:
    """Return the solids that closed parts bound, turned outwards.

    A part that is turned inwards is a cavity of the parts around it, which are then one solid with it; where there
    are none it is turned.
    """
    boxes = [(vertices[part].min(axis=(0, 1)), vertices[part].max(axis=(0, 1))) for part in parts]
    inward = [k for k, part in enumerate(parts) if volume_of(vertices[part]) < 0]
    turned = list(parts)
    around: dict[int, list[int]] = {}
    solids = {}
    for k in inward:
        low, high = boxes[k]
        for i, other in enumerate(boxes):
            if i == k or not ((other[0] < low).all() and (other[1] > high).all()):
                continue
            if i not in solids:
                solids[i] = surface_of(vertices[parts[i]], len(parts[i]))
            if holds(solids[i], 0, *vertices[parts[k][0, 0]]):
                around.setdefault(k, []).append(i)
        if k not in around:
            turned[k] = parts[k][:, ::-1]
    together = sorted({k for k in around} | {i for others in around.values() for i in others})
    alone = [turned[k] for k in range(len(parts)) if k not in together]
    return [*alone, np.concatenate([turned[k] for k in together])] if together else alone
