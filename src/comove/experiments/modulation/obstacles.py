"""Moving obstacles: shape, pose, velocities and margin; also built from those of a scene."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from math import cos, sin, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comove.errors import OptionError
from comove.experiments.modulation import levels as lv
from comove.experiments.modulation.shapes import Box, Capsule, Cylinder, Ellipsoid, Shape, Sphere
from comove.geometry import distances as sd
from comove.primitives.arguments import is_number, numbers, vector
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

PLANAR_CAPSULE = np.array(
    [[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]
)  # the kernel's lies along z, the planar one along x
ROTATION_ERROR = 1e-6  # by which a rotation matrix may miss one
FARTHEST = 1e100  # of a number: beyond it squares overflow
APART = -1.0  # the group of obstacles without one


@dataclass(frozen=True, eq=False)
class MovingObstacle:
    """A convex obstacle at one instant, which has velocities; change it by `dataclasses.replace`, or `moved`.

    Attributes
    ----------
    shape : geometric shape
    center : array, shape (n_dims,), [m]
    rotation : array, shape (n_dims, n_dims), the obstacle's axes in the world as columns; the identity by default
    velocity : array, shape (n_dims,), velocity of the centre [m/s]; 0 by default
    angular_velocity : array, shape (3,) in space; one number, counter-clockwise, in the plane [rad/s]; 0 by default
    margin : distance that is kept from the obstacle, for instance the radius of a load [m]
    reference : array, shape (n_dims,), a point inside, in the obstacle's own frame, away from which velocities are
        turned (Huber, Slotine & Billard, 2019) [m]; the centre by default
    group : number of the group; the obstacles of a group are one star-shaped body about a common reference, see
        `united`
    """

    shape: Shape
    center: Array
    rotation: Array | None = None
    velocity: Array | None = None
    angular_velocity: Array | float | None = None
    margin: float = 0.0
    reference: Array | None = None
    group: int | None = None

    def __post_init__(self) -> None:
        center = numbers(self.center)
        if center.shape not in ((2,), (3,)) or not np.isfinite(center).all():
            raise OptionError(f"center = {self.center!r}", key="center", way_out="give 2 or 3 finite numbers")
        n_dims = len(center)
        if not (is_number(self.margin) and self.margin >= 0):
            raise OptionError(
                f"margin = {self.margin!r}", key="margin", way_out="give 0 or a positive length"
            )
        rotation = np.eye(n_dims) if self.rotation is None else _rotation(self.rotation, n_dims)
        turn = self.angular_velocity
        turn = np.zeros(2 * n_dims - 3) if turn is None else np.atleast_1d(numbers(turn))
        if turn.shape != (2 * n_dims - 3,) or not np.isfinite(turn).all():
            way_out = "give one finite number" if n_dims == 2 else "give 3 finite numbers"
            raise OptionError(
                f"angular_velocity = {self.angular_velocity!r}", key="angular_velocity", way_out=way_out
            )
        if self.group is not None and (
            isinstance(self.group, bool) or not isinstance(self.group, (int, np.integer)) or self.group < 0
        ):
            raise OptionError(
                f"group = {self.group!r}", key="group", way_out="give a number from 0 on, or None"
            )
        given = {"center": center, "rotation": rotation, "angular_velocity": turn}
        for name in ("velocity", "reference"):
            value = getattr(self, name)
            given[name] = np.zeros(n_dims) if value is None else vector(name, value, n_dims)
        for name, array in given.items():  # own read-only copies, as the table is kept
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if not hasattr(self.shape, "in_table"):
            raise OptionError(f"shape = {self.shape!r}", key="shape", way_out="give one such as Sphere(0.1)")
        _ = self.row  # so that a shape of another dimension is told here
        if self.reference.any():
            _require_inside(self)

    @property
    def n_dims(self) -> int:
        """Return 2 in the plane, 3 in space."""
        return len(self.center)

    @cached_property
    def row(self) -> Array:
        """Return the obstacle's row of the table that kernels take; array, shape (levels.N_LEVEL_COLUMNS,)."""
        n, row = self.n_dims, np.zeros(lv.N_LEVEL_COLUMNS)
        shape = self.shape.in_table(n, self.margin)
        row[sd.KIND], row[sd.REACH] = shape.kind, shape.reach
        for column, values in ((sd.SIZE, shape.size), (lv.LEVEL, shape.level), (lv.EXPONENT, shape.exponent)):
            row[column : column + len(values)] = values
        if n == 2:  # endless along z; the ellipsoid's distance needs a finite axis, its slice does not
            endless = {sd.BOX: np.inf, sd.ELLIPSOID: max(shape.size)}
            row[sd.SIZE + 2] = endless.get(shape.kind, row[sd.SIZE + 2])
            row[lv.LEVEL + 2], row[lv.EXPONENT + 2] = np.inf, 1.0
        row[lv.VELOCITY : lv.VELOCITY + n] = self.velocity
        row[lv.TURN + 3 - len(self.angular_velocity) : lv.TURN + 3] = self.angular_velocity
        row[lv.GROUP] = APART if self.group is None else self.group
        return self._posed(row)

    def _posed(self, row: Array) -> Array:
        """Return the row with the obstacle's pose written into it, in place."""
        n = self.n_dims
        rotation = np.eye(3)
        rotation[:n, :n] = self.rotation
        if n == 2 and row[sd.KIND] == sd.CAPSULE:
            rotation = rotation @ PLANAR_CAPSULE
        row[sd.CENTER : sd.CENTER + n] = self.center
        row[sd.ROTATION : sd.ROTATION + 9] = rotation.ravel()
        row[lv.REFERENCE : lv.REFERENCE + n] = self.center + self.rotation @ self.reference
        row.setflags(write=False)
        return row

    def moved(self, dt: float) -> MovingObstacle:
        """Return the obstacle `dt` [s] later, at constant velocities.

        Raises
        ------
        OptionError
            If `dt` is not finite.
        """
        if not is_number(dt):
            raise OptionError(f"dt = {dt!r}", key="dt", way_out="give a finite number of seconds")
        center, rotation = self.center + self.velocity * dt, self.rotation
        if self.angular_velocity.any():
            rotation = _turn(self.angular_velocity * dt) @ rotation
        # A control loop moves every obstacle at every step; checked values are not checked again.
        later = copy(self)
        for name, array in (("center", center), ("rotation", rotation)):
            array.setflags(write=False)
            object.__setattr__(later, name, array)
        later.__dict__["row"] = later._posed(self.row.copy())
        return later


def level(obstacle: MovingObstacle, points: ArrayLike) -> tuple[Array, Array]:
    """Return the level function of an obstacle: 1 on its surface with the margin, greater outside (see `levels`).

    Parameters
    ----------
    points : array, shape (..., n_dims), [m]

    Returns
    -------
    level : array, shape (...)
    gradient : array, shape (..., n_dims), [1/m]

    Raises
    ------
    OptionError
        If the points are not finite or have another dimension.
    """
    points = points_of("points", points, obstacle.n_dims)
    levels, gradients = lv.levels_at(obstacle.row[None], spatial(points))
    shape = points.shape
    return levels.reshape(shape[:-1]), gradients[:, 0, : shape[-1]].reshape(shape)


def level_obstacle(
    scene: Scene,
    j: int,
    *,
    margin: float = 0.0,
    velocity: ArrayLike | None = None,
    angular_velocity: ArrayLike | None = None,
) -> MovingObstacle:
    """Return the `j`-th obstacle of a scene at its position in the scene file.

    `dataclasses.replace` moves it elsewhere.

    Parameters
    ----------
    margin : distance that is kept from the obstacle [m]
    velocity, angular_velocity : as in `MovingObstacle`

    Raises
    ------
    OptionError
        If the scene has no such obstacle, if it is a mesh, or if the velocities or the margin are not valid.
    """
    if isinstance(j, bool) or not isinstance(j, (int, np.integer)) or not 0 <= j < len(scene.motions):
        raise OptionError(
            f"no obstacle {j!r} in the scene {scene.name!r}",
            key="j",
            way_out=f"it has {len(scene.motions)}, counted from 0",
        )
    row, n = scene.obstacles[scene.first_rows[j]], scene.n_dims
    if row[sd.KIND] == sd.POLYTOPE:
        raise OptionError(
            f"{scene.name_of(j)} has no level function",
            key="j",
            way_out="put boxes or ellipsoids in its place, or use the twist programme",
        )
    kind, size = int(row[sd.KIND]), [float(x) for x in row[sd.SIZE : sd.SIZE + 3]]
    rotation = row[sd.ROTATION : sd.ROTATION + 9].reshape(3, 3)
    if n == 2 and kind == sd.CAPSULE:
        rotation = rotation @ PLANAR_CAPSULE.T
    shape: Shape
    if kind == sd.BOX:
        shape = Box(tuple(2 * edge for edge in size[:n]))
    elif kind == sd.SPHERE:
        shape = Sphere(size[0])
    elif kind == sd.CAPSULE:
        shape = Capsule(size[0], 2 * size[1])
    elif kind == sd.CYLINDER:
        shape = Cylinder(size[0], 2 * size[1])
    else:
        shape = Ellipsoid(tuple(size[:n]))
    return MovingObstacle(
        shape,
        row[sd.CENTER : sd.CENTER + n],
        rotation[:n, :n],
        velocity=velocity,
        angular_velocity=angular_velocity,
        margin=margin,
    )


def table_of(obstacles: tuple[MovingObstacle, ...], n_dims: int) -> Array:
    """Return the table of obstacles that kernels take; array, shape (n_obstacles, levels.N_LEVEL_COLUMNS).

    Raises
    ------
    OptionError
        If an obstacle has another dimension.
    """
    for j, obstacle in enumerate(obstacles):
        if not isinstance(obstacle, MovingObstacle):
            raise OptionError(f"{obstacle!r} is no MovingObstacle", key=f"obstacles[{j}]")
        if obstacle.n_dims != n_dims:
            raise OptionError(
                f"an obstacle of {obstacle.n_dims} dimensions among points of {n_dims}",
                key=f"obstacles[{j}]",
                way_out="give all of them in the plane or all in space",
            )
    return np.array([obstacle.row for obstacle in obstacles]).reshape(-1, lv.N_LEVEL_COLUMNS)


def points_of(name: str, value: ArrayLike, n_dims: int | None = None) -> Array:
    """Return a new array of finite vectors, shape (..., n_dims), of numbers up to `FARTHEST`.

    Raises
    ------
    OptionError
        If `value` is not such an array.
    """
    array = numbers(value)
    allowed = (2, 3) if n_dims is None else (n_dims,)
    if array.ndim < 1 or array.shape[-1] not in allowed or not (np.abs(array) <= FARTHEST).all():
        raise OptionError(
            f"{name} of shape {array.shape}",
            key=name,
            way_out=f"give finite vectors of {' or '.join(map(str, allowed))} numbers",
        )
    return array


def spatial(vectors: Array) -> Array:
    """Return vectors in space, as kernels take them; (..., n_dims) -> (n_vectors, 3)."""
    flat = vectors.reshape(-1, vectors.shape[-1])
    if flat.shape[1] == 3:
        return flat
    padded = np.zeros((len(flat), 3))
    padded[:, :2] = flat
    return padded


def _require_inside(obstacle: MovingObstacle) -> None:
    at, _ = level(obstacle, obstacle.center + obstacle.rotation @ obstacle.reference)
    if not at < 1.0:
        raise OptionError(
            f"the reference {obstacle.reference.tolist()} lies outside of the obstacle",
            key="reference",
            way_out="give a point inside it, in its own frame",
        )


def _rotation(value: object, n_dims: int) -> Array:
    rotation = numbers(value)
    if rotation.shape != (n_dims, n_dims) or not (
        np.abs(rotation @ rotation.T - np.eye(n_dims)).max() <= ROTATION_ERROR and np.linalg.det(rotation) > 0
    ):
        raise OptionError(
            f"{rotation.tolist()} is no rotation", key="rotation", way_out=f"give a {n_dims}x{n_dims} matrix"
        )
    return rotation


def _turn(vector: Array) -> Array:
    """Return the matrix of a rotation vector [rad] (Rodrigues), (3,) -> (3, 3), or of an angle, (1,) -> (2, 2)."""
    angle = sqrt(vector @ vector)
    c, s = cos(angle), sin(angle)
    if len(vector) == 1:
        s = s if vector[0] >= 0 else -s
        return np.array([[c, -s], [s, c]])
    x, y, z = (vector / (angle or 1.0)).tolist()
    u, v, w = (1 - c) * x, (1 - c) * y, (1 - c) * z
    return np.array(
        [
            [c + u * x, u * y - s * z, u * z + s * y],
            [u * y + s * z, c + v * y, v * z - s * x],
            [u * z - s * y, v * z + s * x, c + w * z],
        ]
    )
