"""A payload, its end effectors and their obstacles, as arrays.

*Parts* of the payload and end effectors are rods, then solids; *things* are convex obstacles, then meshes. Both are
numbered. The *corners* that place a part are keypoints of the payload.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.geometry.surfaces import Surfaces
from comove.model.scene import Scene


class Surroundings(NamedTuple):
    """A payload with its end effectors, and the obstacles of both.

    Attributes
    ----------
    edges, radii : arrays, shapes (n_rods, 2) and (n_rods,), corners and radii [m] of rods
    solids : array of int, shape (n_solids, n), corners of solids
    thickness : array, shape (n_nodes,), radius of the thickest rod that ends at each keypoint [m], 0 for the corner
        of a solid alone; -1 for keypoints of neither
    obstacles : array, shape (n_rows, n_columns), table of obstacles at 0 s
    owners : array of int, shape (n_rows,), obstacle to which each row of the table belongs
    convex : array of int, rows that are obstacles themselves; the other rows belong to meshes and guide the sampling
    surfaces : meshes
    lower, upper : arrays, shape (3,), corners of the workspace [m]
    pairs, separations : arrays, shapes (n_pairs, 2) and (n_pairs,), end effectors to keep apart, and how far [m]
    """

    edges: Integers
    radii: Array
    solids: Integers
    thickness: Array
    obstacles: Array
    owners: Integers
    convex: Integers
    surfaces: Surfaces
    lower: Array
    upper: Array
    pairs: Integers
    separations: Array

    @property
    def n_things(self) -> int:
        """Return the number of things."""
        return len(self.convex) + len(self.surfaces.root)


def surroundings_of(scene: Scene) -> Surroundings:
    """Return a scene's payload and end effectors with their obstacles."""
    body, thickness = scene.body, np.full(scene.body.n_nodes, -1.0)
    np.maximum.at(thickness, body.edges, np.asarray(body.radii)[:, None])
    np.maximum.at(thickness, body.solids, 0.0)
    return Surroundings(
        body.edges,
        body.radii,
        body.solids,
        thickness,
        scene.obstacles,
        np.asarray(scene.owners),
        np.flatnonzero(scene.convex_rows),
        scene.surfaces,
        *scene.workspace,
        *scene.kept_apart,
    )


@kernel(counted=False)
def count_parts(around):
    """Return the number of parts."""
    return around.edges.shape[0] + around.solids.shape[0]


@kernel(counted=False)
def count_corners(around, part):
    """Return the number of corners of a part."""
    return 2 if part < around.edges.shape[0] else most_corners(around.solids)


@kernel(counted=False)
def corner_of(around, part, i):
    """Return the keypoint at a corner of a part."""
    n_rods = around.edges.shape[0]
    return around.edges[part, i] if part < n_rods else around.solids[part - n_rods, i]


@kernel(counted=False)
def most_corners(solids):
    """Return the largest number of corners of a part."""
    return max(2, solids.shape[1])


@kernel(counted=False)
def radius_of(around, part):
    """Return the radius [m] of a part, 0 for a solid."""
    return around.radii[part] if part < around.edges.shape[0] else 0.0


@kernel(counted=False)
def whose(around, thing):
    """Return a thing's row in the obstacle table, and its obstacle."""
    n_rows = around.convex.shape[0]
    if thing < n_rows:
        return around.convex[thing], around.owners[around.convex[thing]]
    mesh = thing - n_rows
    return around.surfaces.row[mesh], around.surfaces.owner[mesh]


@kernel(counted=False)
def from_border(around, nodes):
    """Return the distance [m] of all parts from the workspace border. `nodes` has the shape (n_nodes, 3)."""
    d = np.inf
    for i in range(nodes.shape[0]):
        if around.thickness[i] < 0.0:
            continue
        for axis in range(3):
            beside = min(nodes[i, axis] - around.lower[axis], around.upper[axis] - nodes[i, axis])
            d = min(d, beside - around.thickness[i])
    return d
