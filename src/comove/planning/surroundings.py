"""A load and all that it must not touch, in the form that the kernels of planning take."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.compiled import kernel
from comove.geometry.distances import CENTER
from comove.geometry.solids import border_distance, empty_solid, solid_at, solids_or_none
from comove.geometry.surfaces import Surfaces, signed_distance, surfaces_or_none
from comove.model.scene import Scene

Array = NDArray[np.float64]


class Surroundings(NamedTuple):
    """A load and all that it must not touch.

    Attributes
    ----------
    edges, radii : arrays, shapes (n_edges, 2) and (n_edges,), end nodes and radii [m] of the rods of hands and loads
    solids : array of int, shape (n_solids, n), corner nodes of the load's solids; None where it has none
    obstacles : array, shape (n_rows, n_columns), table of obstacles
    owners : array of int, shape (n_rows,), obstacle to which each row of the table belongs
    convex : array of int, rows that are obstacles themselves; the other rows belong to meshes and guide the sampling
    surfaces : meshes; None where there is none
    lower, upper : arrays, shape (3,), corners of the workspace [m]
    pairs, separations : arrays, shapes (n_pairs, 2) and (n_pairs,), hands that must stay apart, and by how much [m]
    """

    edges: NDArray[np.int64]
    radii: Array
    solids: NDArray[np.int64] | None
    obstacles: Array
    owners: NDArray[np.int64]
    convex: NDArray[np.int64]
    surfaces: Surfaces | None
    lower: Array
    upper: Array
    pairs: NDArray[np.int64]
    separations: Array


def surroundings_of(scene: Scene) -> Surroundings:
    """Return the load of a scene and all that it must not touch."""
    return Surroundings(
        scene.body.edges,
        scene.body.radii,
        solids_or_none(scene.body.solids),
        scene.obstacles,
        np.asarray(scene.owners),
        np.flatnonzero(scene.convex_rows),
        surfaces_or_none(scene.surfaces),
        *scene.workspace,
        *scene.kept_apart,
    )


@kernel
def from_border(around, nodes):
    """Return the distance [m] of the body, with its nodes at `nodes`, (n_nodes, 3), from the workspace's border."""
    d = np.inf
    for e in range(around.edges.shape[0]):
        a, b, radius = nodes[around.edges[e, 0]], nodes[around.edges[e, 1]], around.radii[e]
        for axis in range(3):
            d = min(d, min(a[axis], b[axis]) - around.lower[axis] - radius)
            d = min(d, around.upper[axis] - max(a[axis], b[axis]) - radius)
    return min(d, _solids_from_border(around.solids, around, nodes))


@kernel
def _solids_from_border(solids, around, nodes):
    d = np.inf
    if solids is None:
        return d
    solid = empty_solid(solids)
    for s in range(solids.shape[0]):
        solid_at(nodes, solids[s], solid)
        d = min(d, border_distance(solid, around.lower, around.upper))
    return d


@kernel
def seen_from(surfaces, mesh, obstacles, nodes, corners):
    """Return corners of the body as seen from a mesh at its place in the table; shape (n_corners, 3) [m]."""
    hull, row = np.empty((corners.shape[0], 3)), surfaces.row[mesh]
    for i in range(corners.shape[0]):
        for axis in range(3):
            moved = obstacles[row, CENTER + axis] - surfaces.center[mesh, axis]
            hull[i, axis] = nodes[corners[i], axis] - moved
    return hull


@kernel
def solids_from_mesh(solids, surfaces, mesh, obstacles, nodes, cutoff):
    """Return the distance [m] of the load's solids from a mesh at its place in the table, at most `cutoff`."""
    if solids is None:
        return cutoff
    d = cutoff
    for s in range(solids.shape[0]):
        d = min(d, signed_distance(surfaces, mesh, seen_from(surfaces, mesh, obstacles, nodes, solids[s]), d))
    return d
