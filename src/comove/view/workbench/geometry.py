"""Scenes and payloads as meshes and poses, without a viewer. A planar scene lies in the plane z = 0; its obstacles
are drawn as prisms of a small height, and its payload above them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array, Integers
from comove.geometry.rotations import fit_quaternion
from comove.model.scene import Scene
from comove.view.figures.shapes import all_around, hull_faces, load_pairs, outline, support_points
from comove.view.figures.style import COLOURS

AROUND, ALONG = 32, 17  # directions in which round bodies are sampled, about the vertical and along it


@dataclass(frozen=True)
class Proportions:
    """Sizes of drawn elements, as shares of the workspace's longest side.

    Attributes
    ----------
    height : height of the obstacles of a planar scene
    thin : least radius of rods
    hand : radius of the ball of an end effector
    grip : radius of the draggable balls of starts and goals, larger than that of an end effector
    comfort : clearance from which on the path is green
    view : distance of the camera
    view_of_arms : distance of the camera with a robot, which fills more of the picture than the workspace
    between : distance of two scenes side by side, in widths of the wider workspace
    between_arms : likewise with a robot, which is wider than its workspace
    ghosts : number of equal times at which the payload is drawn
    many : number of obstacles from which on each is drawn with a quarter of the triangles and without a shadow
    """

    height: float = 0.03
    thin: float = 0.004
    hand: float = 0.011
    grip: float = 0.0209
    comfort: float = 0.05
    view: float = 0.95
    view_of_arms: float = 0.7125
    between: float = 0.2
    between_arms: float = 0.4
    ghosts: int = 9
    many: int = 60


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles of a body in its own frame.

    Attributes
    ----------
    vertices : array, shape (n_vertices, 3) [m]
    faces : array of int, shape (n_faces, 3), vertices of the triangles, seen from outside counter-clockwise
    """

    vertices: Array
    faces: Integers

    @classmethod
    def of(cls, triangles: Array) -> Surface:
        """Return the surface of triangles, shape (n_faces, 3, 3) [m]. Corners are not shared."""
        return cls(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))


@dataclass(frozen=True, eq=False)
class Piece:
    """Rigid part of end effectors or payload, with its path.

    Attributes
    ----------
    name : path under which a viewer keeps it
    surface : its triangles in its own frame
    colour : red, green, blue, from 0 to 255
    position : array, shape (n_steps, 3) [m]
    quaternion : array, shape (n_steps, 4), w x y z
    """

    name: str
    surface: Surface
    colour: tuple[int, int, int]
    position: Array
    quaternion: Array


def colour_of(text: str) -> tuple[int, int, int]:
    """Return the red, green and blue of a colour such as "#2a7f3f"."""
    red, green, blue = bytes.fromhex(text.lstrip("#"))
    return red, green, blue


def longest_side(scene: Scene) -> float:
    """Return the longest side of the workspace [m]."""
    return float((scene.upper - scene.lower).max())


def obstacle_surfaces(scene: Scene, sizes: Proportions = Proportions()) -> tuple[Surface, ...]:
    """Return the surfaces of all obstacles about their centres. They are oriented as in the scene."""
    meshes = {int(owner): mesh for mesh, owner in enumerate(scene.surfaces.owner)}
    coarser = 2 if len(scene.first_rows) >= sizes.many else 1
    directions = all_around(AROUND // coarser, (ALONG - 1) // coarser + 1)
    found = []
    for obstacle, row in enumerate(scene.first_rows):
        if obstacle in meshes:
            triangles = scene.surfaces.of(meshes[obstacle])
        elif scene.n_dims == 2:
            triangles = _prism(outline(scene.obstacles[row], (0, 1)), sizes.height * longest_side(scene))
        else:
            triangles = hull_faces(support_points(scene.obstacles[row], directions))
        found.append(Surface.of(triangles - scene.centers[obstacle]))
    return tuple(found)


def _prism(border: Array, height: float) -> Array:
    """Return the triangles of a prism above a convex outline [m]. `border` is an array of shape (n, 2)."""
    below = np.concatenate([border, np.zeros((len(border), 1))], axis=1)
    return hull_faces(np.concatenate([below, below + [0.0, 0.0, height]]))


def ball(radius: float) -> Surface:
    """Return a sphere about the origin."""
    return Surface.of(hull_faces(radius * all_around(AROUND, ALONG)[:: 1 if radius > 0.05 else 2]))


def rod(length: float, radius: float) -> Surface:
    """Return a capsule about the origin along z. `length` is that of its axis [m]."""
    directions = all_around(AROUND, ALONG)
    ends = radius * directions + 0.5 * length * np.sign(directions[:, 2:] + 1e-9) * [0.0, 0.0, 1.0]
    return Surface.of(hull_faces(ends))


def pieces_of(scene: Scene, nodes: Array, sizes: Proportions = Proportions()) -> tuple[Piece, ...]:
    """Return end effectors and payload along a motion as rigid pieces.

    Parameters
    ----------
    nodes : array, shape (n_steps, n_nodes, 3), positions of the nodes [m]
    """
    side, still = longest_side(scene), np.tile([1.0, 0.0, 0.0, 0.0], (len(nodes), 1))
    raised = nodes + [0.0, 0.0, 0.5 * sizes.height * side if scene.n_dims == 2 else 0.0]
    dark = colour_of("#30343b")
    found = [
        Piece(f"hand_{i}", ball(sizes.hand * side), colour_of(COLOURS[i % len(COLOURS)]), raised[:, i], still)
        for i in range(len(scene.manipulators))
    ]
    radii = dict(zip(map(tuple, scene.body.edges.tolist()), scene.body.radii.tolist(), strict=True))
    for number, (first, second) in enumerate(load_pairs(scene)):
        way = raised[:, second] - raised[:, first]
        length = np.linalg.norm(way, axis=1)
        surface = rod(float(length[0]), max(radii.get((first, second), 0.0), sizes.thin * side))
        found.append(
            Piece(
                f"rod_{number}",
                surface,
                dark,
                0.5 * (raised[:, first] + raised[:, second]),
                _turned_to(way, length),
            )
        )
    for number, corners in enumerate(scene.body.solids):
        own = raised[:, list(dict.fromkeys(corners.tolist()))]
        middle = own.mean(axis=1)
        surface = Surface.of(hull_faces(own[0] - middle[0]))
        found.append(
            Piece(f"solid_{number}", surface, colour_of("#8a8f98"), middle, fit_quaternion(own[0], own))
        )
    return tuple(found)


def _turned_to(way: Array, length: Array) -> Array:
    """Return the shortest rotations of the z-axis to given directions. Array, shape (n_steps, 4)."""
    x, y, z = (way / np.maximum(length, 1e-12)[:, None]).T
    w = np.sqrt(np.maximum(0.5 * (1.0 + z), 0.0))
    upside_down = w < 1e-6
    divisor = np.where(upside_down, 1.0, 2.0 * w)
    turns = np.stack([w, -y / divisor, x / divisor, np.zeros_like(w)], axis=1)
    turns[upside_down] = [0.0, 1.0, 0.0, 0.0]
    return turns / np.linalg.norm(turns, axis=1, keepdims=True)


def workspace_lines(scene: Scene) -> Array:
    """Return the edges of the workspace; array, shape (n_edges, 2, 3) [m]."""
    low, high = np.zeros(3), np.zeros(3)
    low[: scene.n_dims], high[: scene.n_dims] = scene.lower, scene.upper
    numbers = range(2**scene.n_dims)
    corners = np.array([[(low, high)[(i >> a) & 1][a] for a in range(3)] for i in numbers])
    return corners[[(i, i | 1 << a) for i in numbers for a in range(scene.n_dims) if not i >> a & 1]]


def segments_of(path: Array) -> Array:
    """Return the segments of a path. The shapes are (n_points, 3) -> (n_points - 1, 2, 3) [m]."""
    return np.stack([path[:-1], path[1:]], axis=1)


def clearance_colours(clearance: Array, comfortable: float) -> NDArray[np.uint8]:
    """Return colours of clearances, from red over yellow to green. Red is contact, green the clearance `comfortable`
    or more.

    Parameters
    ----------
    clearance : array, shape (n,) [m]

    Returns
    -------
    array, shape (n, 3)
    """
    share = np.clip(clearance / max(comfortable, 1e-9), 0.0, 1.0)
    stops = np.array([colour_of("#d7263d"), colour_of("#f2b134"), colour_of("#2a9d4b")], dtype=float)
    mixed = np.stack([np.interp(share, [0.0, 0.45, 1.0], stops[:, i]) for i in range(3)], axis=1)
    return mixed.round().astype(np.uint8)
