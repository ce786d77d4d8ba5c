"""A load and all that it must not touch, in the form that the kernels of planning take."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.geometry.solids import solids_or_none
from comove.geometry.surfaces import Surfaces, surfaces_or_none
from comove.scenes.scene import Scene

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
