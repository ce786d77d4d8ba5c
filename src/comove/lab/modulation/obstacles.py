"""Moving obstacles, built from a scene's and united where they overlap."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array
from comove.dmp.arguments import is_number, numbers, vector
from comove.errors import ComoveWarning, OptionError
from comove.geometry import distances as sd
from comove.geometry.rotations import exponential, matrices
from comove.lab.modulation import levels as lv
from comove.lab.modulation.shapes import Box, Capsule, Cylinder, Ellipsoid, Shape, Sphere
from comove.model.scene import Scene
from comove.model.shapes import spatial

PLANAR_CAPSULE = np.array(
    [[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]
)  # the kernel's lies along z, the planar one along x
ROTATION_ERROR = 1e-6  # by which a rotation matrix may miss one
FARTHEST = 1e100  # of a number: beyond it squares overflow
APART = -1.0  # the group of obstacles without one


@dataclass(frozen=True, eq=False, init=False)
class MovingObstacle:
    """Convex obstacle with velocities at one instant. Change it by `dataclasses.replace`, or `moved`.

    Attributes
    ----------
    shape : geometric shape
    center : array, shape (n_dims,), [m]
    rotation : array, shape (n_dims, n_dims), the obstacle's axes in the world as columns; the identity by default
    velocity : array, shape (n_dims,), velocity of the centre [m/s]; 0 by default
    angular_velocity : array, shape (3,) in space, (1,) counter-clockwise in the plane [rad/s]; 0 by default
    margin : distance that is kept from the obstacle, for instance the radius of a payload [m]
    reference : array, shape (n_dims,), a point inside, in the obstacle's own frame, away from which velocities are
        turned (Huber, Slotine & Billard, 2019) [m]; the centre by default
    group : number of the group; the obstacles of a group are one star-shaped body about a common reference, see
        `united`
    """

    shape: Shape
    center: Array
    rotation: Array
    velocity: Array
    angular_velocity: Array
    margin: float
    reference: Array
    group: int | None

    def __init__(
        self,
        shape: Shape,
        center: ArrayLike,
        rotation: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        angular_velocity: ArrayLike | None = None,
        margin: float = 0.0,
        reference: ArrayLike | None = None,
        group: int | None = None,
    ):
        place = numbers(center)
        if place.shape not in ((2,), (3,)) or not np.isfinite(place).all():
            raise OptionError(f"center = {center!r}", key="center", way_out="give 2 or 3 finite numbers")
        n_dims = len(place)
        if not (is_number(margin) and margin >= 0):
            raise OptionError(f"margin = {margin!r}", key="margin", way_out="give 0 or a positive length")
        n_turns = 2 * n_dims - 3
        turn = np.zeros(n_turns) if angular_velocity is None else np.atleast_1d(numbers(angular_velocity))
        if turn.shape != (n_turns,) or not np.isfinite(turn).all():
            way_out = "give one finite number" if n_dims == 2 else "give 3 finite numbers"
            raise OptionError(
                f"angular_velocity = {angular_velocity!r}", key="angular_velocity", way_out=way_out
            )
        if group is not None and (
            isinstance(group, bool) or not isinstance(group, (int, np.integer)) or group < 0
        ):
            raise OptionError(f"group = {group!r}", key="group", way_out="give a number from 0 on, or None")
        if not isinstance(shape, Shape):
            raise OptionError(f"shape = {shape!r}", key="shape", way_out="give one such as Sphere(0.1)")
        arrays = {
            "center": place,
            "rotation": np.eye(n_dims) if rotation is None else _rotation(rotation, n_dims),
            "velocity": np.zeros(n_dims) if velocity is None else vector("velocity", velocity, n_dims),
            "angular_velocity": turn,
            "reference": np.zeros(n_dims) if reference is None else vector("reference", reference, n_dims),
        }
        for array in arrays.values():  # own read-only copies, as the row is kept
            array.setflags(write=False)
        for name, value in (arrays | {"shape": shape, "margin": margin, "group": group}).items():
            object.__setattr__(self, name, value)
        _ = self.row  # so that a shape of another dimension is told here
        if self.reference.any():
            at, _ = level(self, self.center + self.rotation @ self.reference)
            if not at < 1.0:
                raise OptionError(
                    f"the reference {self.reference.tolist()} lies outside of the obstacle",
                    key="reference",
                    way_out="give a point inside it, in its own frame",
                )

    @property
    def n_dims(self) -> int:
        """Return 2 in the plane, 3 in space."""
        return len(self.center)

    @cached_property
    def row(self) -> Array:
        """Return the obstacle's row of the kernels' table. Array, shape (levels.N_LEVEL_COLUMNS,)."""
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
        """Write the obstacle's pose into its row; return the row."""
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
        """Return the obstacle `dt` [s] later, at constant velocities."""
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
    """Return the level function of an obstacle and its gradient. It is 1 on the surface with the margin, greater
    outside (see `levels`).

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
    levels, gradients = lv.levels_at(obstacle.row[None], spatial(points.reshape(-1, obstacle.n_dims)))
    shape = points.shape
    return levels.reshape(shape[:-1]), gradients[:, 0, : shape[-1]].reshape(shape)


def level_obstacle(scene: Scene, j: int, *, margin: float = 0.0) -> MovingObstacle:
    """Return a scene's `j`-th obstacle at rest, as in the file.

    `dataclasses.replace` moves it elsewhere, and gives it velocities.

    Parameters
    ----------
    margin : distance that is kept from the obstacle [m]

    Raises
    ------
    OptionError
        If the scene has no such obstacle, if it is a mesh, or if the margin is not valid.
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
            way_out="put boxes or ellipsoids in its place, or use the safety filter",
        )
    kind, size = int(row[sd.KIND]), [float(x) for x in row[sd.SIZE : sd.SIZE + 3]]
    shapes: dict[int, Callable[[], Shape]] = {
        sd.BOX: lambda: Box(tuple(2 * edge for edge in size[:n])),
        sd.SPHERE: lambda: Sphere(size[0]),
        sd.CAPSULE: lambda: Capsule(size[0], 2 * size[1]),
        sd.CYLINDER: lambda: Cylinder(size[0], 2 * size[1]),
        sd.ELLIPSOID: lambda: Ellipsoid(tuple(size[:n])),
    }
    center = row[sd.CENTER : sd.CENTER + n]
    return MovingObstacle(shapes[kind](), center, axes_of(row, n), margin=margin)


def axes_of(row: Array, n_dims: int) -> Array:
    """Return an obstacle's axes from its table row. Array, shape (n_dims, n_dims)."""
    axes = row[sd.ROTATION : sd.ROTATION + 9].reshape(3, 3)
    if n_dims == 2 and row[sd.KIND] == sd.CAPSULE:
        axes = axes @ PLANAR_CAPSULE.T
    return axes[:n_dims, :n_dims]


def table_of(obstacles: tuple[MovingObstacle, ...], n_dims: int) -> Array:
    """Return the kernels' table of obstacles. Array, shape (n_obstacles, levels.N_LEVEL_COLUMNS).

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


def united(obstacles: Sequence[MovingObstacle]) -> tuple[MovingObstacle, ...]:
    """Return the obstacles, with overlapping ones grouped about a common point.

    Where two obstacles overlap, a point can pass between them under the product of their matrices: in the notch
    between them no obstacle has its full weight. From a point in the overlap, though, both are star-shaped, and so is
    their union (Huber, Slotine & Billard, 2019, IV-C). Turned away from this point, velocities pass both in the same
    sense around the union. Margins are part of the obstacles, and the point is inside all obstacles of the group.

    References and groups that were given before are replaced. Call it again when obstacles have moved against each
    other. Overlapping obstacles that have no common point, such as three in a row, form groups as far as they have
    one; where two of different groups overlap, there is a warning, as a point can pass between them.

    Raises
    ------
    OptionError
        If the obstacles do not all have one dimension.
    """
    obstacles = tuple(obstacles)
    if not obstacles:
        return ()
    table = table_of(obstacles, obstacles[0].n_dims)
    groups: list[list[int]] = []
    for j in range(len(obstacles)):
        for members in groups:
            if _common(table, [*members, j]) is not None:
                members.append(j)
                break
        else:
            groups.append([j])
    for one, other in combinations(groups, 2):
        for i, j in product(one, other):
            if _common(table, [i, j]) is not None:
                warnings.warn(
                    f"obstacles {i} and {j} overlap and belong to no common star-shaped body; "
                    "between them the modulation can let through",
                    ComoveWarning,
                    stacklevel=2,
                )
    made = list(obstacles)
    for group, members in enumerate(groups):
        point = _common(table, members) if len(members) > 1 else None
        for j in members:
            obstacle = obstacles[j]
            reference = np.zeros(obstacle.n_dims)
            if point is not None:
                reference = obstacle.rotation.T @ (point[: obstacle.n_dims] - obstacle.center)
            made[j] = replace(obstacle, reference=reference, group=None if point is None else group)
    return tuple(made)


def _common(table: Array, members: list[int]) -> Array | None:
    """Return a point inside all of these obstacles, or None. Array, shape (3,), [m]."""
    rows = table[members]
    apart = np.linalg.norm(
        rows[:, None, sd.CENTER : sd.CENTER + 3] - rows[:, sd.CENTER : sd.CENTER + 3], axis=2
    )
    if (apart > rows[:, None, sd.REACH] + rows[:, sd.REACH]).any():
        return None
    point = np.empty(3)
    return point if lv.common_point(table, np.array(members), point) < 1.0 else None


def points_of(name: str, value: ArrayLike, n_dims: int | None = None) -> Array:
    """Return a new array of finite vectors up to `FARTHEST`. Its shape is (..., n_dims)."""
    array = numbers(value)
    allowed = (2, 3) if n_dims is None else (n_dims,)
    if array.ndim < 1 or array.shape[-1] not in allowed or not (np.abs(array) <= FARTHEST).all():
        raise OptionError(
            f"{name} of shape {array.shape}",
            key=name,
            way_out=f"give finite vectors of {' or '.join(map(str, allowed))} numbers",
        )
    return array


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
    """Return the matrix of a rotation vector or angle [rad]. The shapes are (3,) -> (3, 3), or (1,) -> (2, 2)."""
    if len(vector) == 3:
        return matrices(exponential(vector))
    c, s = np.cos(vector[0]), np.sin(vector[0])
    return np.array([[c, -s], [s, c]])
