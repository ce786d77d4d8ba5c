"""How far hands that hold a payload are from its surface, and the words for hands that hold nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from comove.scenes.groups import RigidGroup
from comove.scenes.model import BoxLoad, FrameLoad, Gripped, MeshLoad, PolygonLoad, SceneFile
from comove.scenes.shapes import inside_polygon

if TYPE_CHECKING:
    from comove.geometry.convex_decomposition import ConvexDecomposition

Array = NDArray[np.float64]

FINGERS = 0.04
"""Distance from a payload at which a hand still holds it [m]: fingers of parallel grippers are about 4 cm long, and a
hand may be given by their roots."""
SHARE = 0.02
"""Share of the payload's longest side that is allowed besides, for sizes that are rounded."""


def grasp_distances(
    file: SceneFile, groups: list[RigidGroup], decomposition: ConvexDecomposition | None = None
) -> Array:
    """Compute how far each hand that holds the payload is from it.

    Parameters
    ----------
    groups : the rigid groups of the scene; one of them holds the payload
    decomposition : of a payload that is a mesh

    Returns
    -------
    array, shape (n_holders,), [m]; 0 inside of the payload. Of a mesh, the distance from the polytopes that contain
    it, which is at most their over-approximation error less.
    """
    load, holders = file.load, file.holder_numbers
    group = next((g for g in groups if set(holders) <= set(g.members)), None)
    if load is None or group is None:
        return np.zeros(len(holders))
    hands = group.grasps[[group.members.index(i) for i in holders]]
    if isinstance(load, FrameLoad):
        at = {name: group.grasps[group.members.index(file.names.index(name))] for name in file.holders}
        ends = np.array([[at[first], at[second]] for first, second in load.edges])
        return np.maximum(_from_segments(hands, ends) - load.radius, 0.0)
    if isinstance(load, PolygonLoad):
        border = np.stack([group.corners, np.roll(group.corners, -1, axis=0)], axis=1)
        apart = np.maximum(_from_segments(hands, border) - load.radius, 0.0)
        return np.where(inside_polygon(group.corners, hands), 0.0, apart)
    if isinstance(load, BoxLoad):
        edges = group.corners[[1, 3] if file.dimension == 2 else [1, 2, 4]] - group.corners[0]
        lengths = np.linalg.norm(edges, axis=1)
        along = np.abs((hands - group.corners.mean(axis=0)) @ (edges / lengths[:, None]).T)
        return np.linalg.norm(np.maximum(along - lengths / 2, 0.0), axis=1)
    if isinstance(load, MeshLoad) and decomposition is not None:
        from comove.geometry.polytopes import nearest_in_hull  # most scenes need no polytopes

        last = np.cumsum([len(polytope.vertices) for polytope in decomposition.polytopes])
        hulls = np.split(group.corners, last[:-1])
        feet = [nearest_in_hull(np.ascontiguousarray(hull), hands) for hull in hulls]
        return np.linalg.norm(hands - np.array(feet), axis=2).min(axis=0)
    return np.zeros(len(holders))  # a bar lies between its hands


def far_grasps(
    file: SceneFile, groups: list[RigidGroup], decomposition: ConvexDecomposition | None = None
) -> str | None:
    """Return what is wrong with the grasp that is farthest from the payload; None if all are near.

    The allowed distance is `FINGERS` and `SHARE` of the payload's longest side.
    """
    apart = grasp_distances(file, groups, decomposition)
    if not apart.size or apart.max() <= FINGERS:
        return None
    group = next(g for g in groups if set(file.holder_numbers) <= set(g.members))
    points = group.corners if len(group.corners) else group.grasps
    longest = float(np.ptp(points, axis=0).max())
    if apart.max() <= FINGERS + SHARE * longest:
        return None
    # Hands at the two ends of a payload are equally far but for rounding.
    worst = int(np.flatnonzero(apart > apart.max() - 1e-9)[0])
    name, load = file.holders[worst], file.load
    shape = "frame" if load is None else load.shape
    return (
        f"load: '{name}' is to hold the {shape}, and is {apart[worst]:.3g} m away from its surface: there is "
        f"nothing between its fingers; {_advice(file)}"
    )


def _advice(file: SceneFile) -> str:
    load = file.load
    if isinstance(load, FrameLoad):
        return "give the frame an edge that ends at this hand, or leave the hand out of held_by"
    if isinstance(load, Gripped) and load.grasps:
        return "give load.grasps on the payload, and hands at start and goal that are as far apart"
    if file.dimension == 3 and len(file.holders) == 2:
        lies = "it is centred between its two hands, and its x axis is the line through them"
        first = (
            "give its length along this line as the first of its sizes" if isinstance(load, BoxLoad) else ""
        )
        return f"{lies}: {first or 'turn the mesh'}, move the hands onto it, or give load.grasps"
    return (
        "it is centred between its hands, and its axes are those of the world at the start: move the hands onto it, "
        "or give load.grasps"
    )


def _from_segments(points: Array, ends: Array) -> Array:
    """Compute the distances of points (n, 3) from the nearest of segments (m, 2, 3); array, shape (n,) [m]."""
    start, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    to = points[:, None] - start
    share = np.clip((to * along).sum(axis=2) / (along**2).sum(axis=1), 0.0, 1.0)
    return np.linalg.norm(to - share[..., None] * along, axis=2).min(axis=1)
