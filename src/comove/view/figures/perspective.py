"""Perspective picture of a spatial scene from the side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import FigureBase
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from comove.arrays import Array
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.view.figures.shapes import hull_faces, load_pairs, obstacle_faces
from comove.view.figures.style import ARM, COLOURS, GOAL, START


def draw_perspective(
    figure: FigureBase,
    position: tuple[int, int, int],
    motion: CoordinatedMotion,
    nodes: Array,
    demonstration: Array | None = None,
    arms: Sequence[Array] = (),
) -> None:
    """Draw obstacles, end effectors' paths and payload states in perspective.

    Parameters
    ----------
    position : position of the panel, as for `add_subplot`
    nodes : array, shape (n_states, n_nodes, 3), drawn states of the payload [m]
    demonstration : array, shape (n_steps, n_manipulators, 3), [m], drawn dashed where given
    arms : as in `draw_motion`
    """
    elevation, aside = 24.0, 62.0  # deg: of the camera above the ground, and from the way as seen from above
    opaque, between = 0.42, 0.16  # the latter of what stands between the camera and the way
    scene = motion.scene
    axes = figure.add_subplot(*position, projection="3d", computed_zorder=False)
    way = (scene.goal - scene.start).mean(axis=0)
    azimuth = float(np.degrees(np.arctan2(way[1], way[0]))) - aside
    axes.view_init(elev=elevation, azim=azimuth)
    axes.set_proj_type("persp", focal_length=0.8)
    camera = np.array(
        [np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth)), np.tan(np.radians(elevation))]
    )
    middle = nodes.reshape(-1, 3).mean(axis=0)
    for faces in _obstacles(scene):
        in_front = float((faces.reshape(-1, 3).mean(axis=0) - middle) @ camera) > 0
        axes.add_collection3d(
            Poly3DCollection(
                faces,
                facecolors=_shaded(faces, between if in_front else opaque),
                edgecolors="none",
                zorder=4 if in_front else 1,
            )
        )
    _draw_load(axes, scene, nodes)
    if demonstration is not None:
        for hand in range(demonstration.shape[1]):
            axes.plot(*demonstration[:, hand].T, "--", color="0.45", linewidth=0.9, zorder=3)
    path = motion.coordinates.motion(motion.at(np.linspace(0.0, 1.0, 201)))[0]
    for hand in range(len(scene.manipulators)):
        axes.plot(*path[:, hand].T, color=COLOURS[hand % len(COLOURS)], linewidth=1.6, zorder=3)
        axes.plot(*path[:1, hand].T, "o", color=START, markersize=5, zorder=5)
        axes.plot(*scene.goal[hand][:, None], "s", color=GOAL, markersize=5, zorder=5)
    for arm in arms:
        for state in arm:
            axes.plot(*state.T, **ARM, zorder=2)
    seen = np.concatenate([[scene.lower, scene.upper], *(arm.reshape(-1, 3) for arm in arms)])
    low, high = seen.min(axis=0), seen.max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    for label, name in ((axes.set_xlabel, "x"), (axes.set_ylabel, "y"), (axes.set_zlabel, "z")):
        label(name, labelpad=-10, fontsize="small")
    axes.set_box_aspect(high - low, zoom=1.15)
    axes.tick_params(labelsize=6, pad=-2)
    axes.locator_params(nbins=4)


def _draw_load(axes: Any, scene: Scene, nodes: Array) -> None:
    """Draw the payload's edges and solids' hulls at every state."""
    lines = [state[list(pair)] for state in nodes for pair in load_pairs(scene)]
    if lines:
        axes.add_collection3d(Line3DCollection(lines, colors="0.1", linewidths=1.0, alpha=0.7, zorder=2))
    for state in nodes[:: max(1, len(nodes) // 8)]:
        for solid in scene.body.solids:
            faces = hull_faces(state[solid])
            axes.add_collection3d(
                Poly3DCollection(
                    faces,
                    facecolors=_shaded(faces, 0.25),
                    edgecolors=(0.1, 0.1, 0.1, 0.25),
                    linewidths=0.3,
                    zorder=2,
                )
            )


def _obstacles(scene: Scene) -> list[Array]:
    """Return the faces of all obstacles at 0 s, within the workspace. Arrays, shape (n_faces, 3, 3) [m]."""
    found = [scene.surfaces.of(mesh) for mesh in range(len(scene.surfaces.owner))]
    found += [obstacle_faces(row) for row in scene.obstacles[scene.convex_rows]]
    return [np.clip(faces, scene.lower, scene.upper) for faces in found]


def _shaded(faces: Array, alpha: float) -> Array:
    """Compute grey colours of faces by their angle to the light. Array, shape (n_faces, 4)."""
    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    length = np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    light = np.array([0.35, -0.55, 0.75])  # where it comes from
    bright = np.clip(normal / length @ (light / np.linalg.norm(light)), -1.0, 1.0)
    grey = np.clip(0.72 + 0.22 * bright, 0.0, 1.0)[:, None]
    return np.concatenate([grey, grey, grey, np.full((len(faces), 1), alpha)], axis=1)
