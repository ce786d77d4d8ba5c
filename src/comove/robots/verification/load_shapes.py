"""The load as shapes of coal: a capsule for each rod and a box for each solid, placed by the nodes that they span."""

from __future__ import annotations

from typing import Any, NamedTuple

import coal
import numpy as np
from numpy.typing import NDArray

from comove.robots.verification.carried import Carried

Array = NDArray[np.float64]

THIN = 1e-6  # m, radius of a rod that has none


class LoadShape(NamedTuple):
    """A shape and the nodes that define its pose.

    Attributes
    ----------
    geometry : coal.Capsule or coal.Box
    nodes : numbers of both end nodes of a rod; of the eight corners of a box, numbered in binary by the sides they
        are on
    """

    geometry: Any
    nodes: tuple[int, ...]


def load_shapes(carried: Carried) -> list[LoadShape]:
    """Return all shapes of the load, in the largest size that they have at any time."""
    body, nodes = carried.motion.scene.body, carried.nodes(carried.time)
    shapes = []
    for (a, b), radius in zip(body.edges.tolist(), body.radii.tolist(), strict=True):
        if a != b:
            shapes.append(LoadShape(coal.Capsule(max(radius, THIN), _largest(nodes, a, b)), (a, b)))
    for corners in getattr(body, "solids", np.zeros((0, 8), dtype=int)).tolist():
        size = [_largest(nodes, corners[0], corners[side]) for side in (1, 2, 4)]
        shapes.append(LoadShape(coal.Box(*size), tuple(corners)))
    return shapes


def _largest(nodes: Array, a: int, b: int) -> float:
    return float(np.linalg.norm(nodes[:, a] - nodes[:, b], axis=1).max())


def placements(nodes: Array, spanned: tuple[int, ...]) -> tuple[Array, Array]:
    """Compute orientations and centres of a shape from the positions of the nodes that it spans.

    Parameters
    ----------
    nodes : array, shape (n_steps, n_nodes, 3) [m]
    spanned : nodes as in `LoadShape`

    Returns
    -------
    array, shape (n_steps, 3, 3), rotations, and array, shape (n_steps, 3), centres [m]
    """
    ends = nodes[:, spanned[0]], nodes[:, spanned[-1]]
    if len(spanned) == 2:  # any frame whose z axis is along the rod
        z = _unit(ends[1] - ends[0])
        x = _unit(np.cross(z, np.eye(3)[np.abs(z).round(9).argmin(axis=1)]))
    else:
        x = _unit(nodes[:, spanned[1]] - ends[0])
        z = _unit(np.cross(x, nodes[:, spanned[2]] - ends[0]))
    return np.stack([x, np.cross(z, x), z], axis=2), 0.5 * (ends[0] + ends[1])


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def leverage(carried: Carried) -> float:
    """Return the largest ratio of the error of a corner of the load to the errors of its hands [m and rad].

    Two hands, each with a position error e, turn the load by up to 2e over their distance; about the line between the
    two, the load turns with the hands themselves.
    """
    scene = carried.motion.scene
    nodes = scene.nodes_at("start")
    hands = nodes[[scene.manipulators.index(name) for name in scene.file.holders]]
    corners = nodes[len(scene.manipulators) :]
    if not len(hands) or not len(corners):
        return 1.0
    beyond = np.linalg.norm(corners[:, None] - hands[None], axis=2).min(axis=1).max()
    apart = [np.linalg.norm(hands[i] - hands[j]) for i in range(len(hands)) for j in range(i)]
    return float(1.0 + beyond * (1.0 + (2.0 / min(apart) if apart else 0.0)))
