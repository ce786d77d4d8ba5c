"""Obstacles known only from point clouds of a depth camera or scanner.

Every cloud is covered by spheres (`comove.geometry.sphere_cover`), which are tracked over time
(`comove.control.tracks`): at any time there are as many obstacles as spheres. Static obstacles in the scene's file
are kept as they are.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comove.arrays import Array
from comove.compiled import kernel
from comove.control.observers import Observer
from comove.control.safety.cbf_qp import Sighting
from comove.control.tracks import Memory, Scanner, blank, margins, moved, updated
from comove.dmp.arguments import is_number, numbers
from comove.errors import OptionError
from comove.geometry import distances as sd
from comove.geometry.rotations import evenly_spread, rotation_in_plane
from comove.geometry.solids import N_CORNERS
from comove.model.scene import FAR, MovingBody, Scene
from comove.model.shapes import inside_polygon
from comove.verification.bounds import lengths

AXES = [sd.ROTATION, sd.ROTATION + 4, sd.ROTATION + 8]  # diagonal of a rotation matrix


class Clouds(Observer):
    """A tracker of obstacles as point clouds, which the caller supplies.

    The static obstacles of a scene are known; those with a `motion` are known only from the clouds. Points of the
    payload and the end effectors are removed: an `Executor` passes their positions. Points of the arms are not
    removed; remove them before. Surfaces that no cloud contains, such as the far side of an object, are not avoided.

    Parameters
    ----------
    scene : the scene in which the payload moves
    scanner : accuracy of the clouds and settings of the tracking
    """

    def __init__(self, scene: Scene, scanner: Scanner | None = None):
        super().__init__(scene)
        self.scanner = scanner or Scanner()
        self._memory: Memory = blank()
        self._carried: deque[tuple[float, Array]] = deque()
        moving = scene.moving[scene.owners]
        self._standing = np.ascontiguousarray(scene.obstacles[~moving])
        # The file's rows keep their numbers; moving obstacles have no known position.
        self._named = scene.obstacles.copy()
        away = np.zeros(scene.obstacles.shape[1])
        away[sd.KIND], away[sd.CENTER], away[[sd.SIZE, sd.REACH]] = sd.SPHERE, FAR, 1e-3
        away[AXES] = 1.0
        self._named[moving] = away

    def carried(self, time: float, nodes: Array) -> None:
        """Set the position of the payload.

        Parameters
        ----------
        time : present time [s]
        nodes : array, shape (n_nodes, 3), end effectors first, then payload corners [m]
        """
        self._carried.append((time, nodes))
        while self._carried[0][0] < time - self.scanner.history:
            self._carried.popleft()

    def update(self, points: ArrayLike, time: float) -> None:
        """Update the tracks by one cloud.

        Points with NaN or infinite coordinates, as cameras give them where they see nothing, are ignored, and so is a
        cloud that is not later than the last one. An empty cloud means that nothing is in sight.

        Parameters
        ----------
        points : array, shape (n_points, n_dims), [m]
        time : time at which they were measured, on the clock of the execution [s]

        Raises
        ------
        OptionError
            If the array has another shape, or the time is not a number or lies in the future.
        """
        n_dims, points = self.scene.n_dims, numbers(points)
        if points.shape == (0,):
            points = points.reshape(0, n_dims)
        if points.ndim != 2 or points.shape[1] != n_dims:
            raise OptionError(
                f"a cloud of shape {points.shape}", way_out=f"give an array of shape (n_points, {n_dims})"
            )
        if not is_number(time):
            raise OptionError(f"a cloud at {time!r} s", way_out="give the time at which it was measured [s]")
        if self._carried and time > self._carried[-1][0] + self.scanner.future:
            raise OptionError(
                f"a cloud at {time:g} s lies in the future, it is {self._carried[-1][0]:g} s",
                way_out="give times on the clock of the execution",
            )
        if time > self._memory.time:
            self._memory = updated(self._memory, self._others(points, time), float(time), self.scanner)

    def observe(self, time: float) -> Sighting:
        """Return the spheres at their estimated positions. The margin covers unknown motion of their points."""
        memory = self._memory
        now = moved(memory, max(time, memory.time), 0.0) if np.isfinite(memory.time) else memory
        n, m = len(self._named), len(memory.spheres.radius)
        velocity, margin = np.zeros((n + m, 3)), np.zeros(n + m)
        table = np.zeros((n + m, self._named.shape[1]))
        table[:n] = self._named
        table[n:, sd.KIND] = sd.SPHERE
        table[n:, sd.CENTER : sd.CENTER + 3] = now.spheres.center
        table[n:, AXES] = 1.0
        table[n:, sd.SIZE] = table[n:, sd.REACH] = memory.spheres.radius
        velocity[n:] = memory.tracks.velocity[memory.spheres.track]
        margin[n:] = margins(memory, time, self.scanner)
        return Sighting(table, velocity, np.zeros((n + m, 3)), margin)

    def _others(self, points: Array, time: float) -> Array:
        """Return the nearby points, in space, outside payload and known obstacles."""
        scene, body, around = self.scene, self.scene.body, self.scanner.around
        near_by = (points >= scene.lower - around) & (points <= scene.upper + around)  # and a number
        points = points[np.logical_and.reduce(near_by.T)]
        points = np.concatenate([points, np.zeros((len(points), 3 - scene.n_dims))], axis=1)
        nodes, near = self._nodes(time), self.scanner.own
        if nodes is not None:
            points = points[~_of_body(points, nodes, body, near)]
        return points[~_of_obstacles(points, self._standing, near)]

    def _nodes(self, time: float) -> Array | None:
        """Return the payload's keypoints at an instant [s], None if unknown; array, shape (n_nodes, 3) [m]."""
        if not self._carried:
            return None
        times = np.array([t for t, _ in self._carried])
        k = int(np.clip(np.searchsorted(times, time), 1, max(len(times) - 1, 1)))
        if len(times) == 1 or time >= times[-1] or time <= times[0]:
            return self._carried[-1 if time >= times[-1] else 0][1]
        (before, first), (after, last) = self._carried[k - 1], self._carried[k]
        return first + (time - before) / (after - before) * (last - first)


class Scanned(Clouds):
    """A tracker of synthetic clouds, generated from true positions for tests.

    Points lie all around on the obstacles, also on static ones, on the payload and on the end effectors.

    Parameters
    ----------
    truth : observer of the true positions of the obstacles
    scanner : its noise and spacing are those of the clouds
    rng : random numbers for the noise and for the positions of points on the surfaces
    period : time between two clouds [s]
    delay : time between a measurement and the arrival of its cloud [s]
    """

    def __init__(
        self,
        truth: Observer,
        scene: Scene,
        scanner: Scanner | None,
        rng: np.random.Generator,
        *,
        period: float = 0.05,
        delay: float = 0.03,
    ):
        super().__init__(scene, scanner)
        self._truth, self._rng, self._period, self._delay = truth, rng, period, delay
        self._next = 0.0

    def observe(self, time: float) -> Sighting:
        """Scan if a new cloud is due; return spheres at estimated positions."""
        if time >= self._next - 1e-9:
            self._next = time + self._period
            then = max(time - self._delay, 0.0)  # before it begins, everything stands as it does at 0 s
            self.update(self.cloud(then), then)
        return super().observe(time)

    def ground_truth(self, time: Array) -> Array:
        """Return the true positions of the obstacles' centres; array, shape (n_times, n_obstacles, 3) [m]."""
        return self._truth.ground_truth(time)

    def cloud(self, time: float) -> Array:
        """Return the points of the cloud at an instant [s]; array, shape (n_points, n_dims) [m]."""
        n = self.scene.n_dims
        table = self.scene.obstacles_at(time, self._truth.ground_truth(np.array([time]))[0])
        if (table[:, sd.KIND] == sd.POLYTOPE).any():
            raise OptionError(
                "clouds of meshes are not made up", way_out="give boxes or spheres in their place"
            )
        spacing, nodes = self.scanner.spacing, self._nodes(time)
        parts = [surface(row, n, spacing, self._rng) for row in table]
        if nodes is not None:
            for a, b in nodes[self.scene.body.edges]:
                share = np.linspace(0.0, 1.0, int(np.linalg.norm(b - a) / spacing) + 2)
                parts.append(a + share[:, None] * (b - a))
        points = np.concatenate([np.zeros((0, 3)), *parts])[:, :n]
        return points + self.scanner.noise * self._rng.standard_normal(points.shape)


def surface(row: Array, n_dims: int, spacing: float, rng: np.random.Generator) -> Array:
    """Return points on an obstacle's surface, at most `spacing` [m] apart; array, shape (n_points, 3) [m].

    On boxes they lie on grids; on other shapes they are the ends of evenly spread rays from the centre.

    Parameters
    ----------
    row : array, shape (distances.N_COLUMNS,), the obstacle's row of the table
    """
    table, center = np.ascontiguousarray(row[None]), row[sd.CENTER : sd.CENTER + 3]
    if row[sd.KIND] == sd.BOX:
        return (
            center
            + _on_box(row[sd.SIZE : sd.SIZE + n_dims], spacing) @ row[AXES[0] : AXES[0] + 9].reshape(3, 3).T
        )
    inner = -sd.point_distance(table, 0, *center)
    reach = row[sd.REACH]
    angle = spacing * inner / reach**2  # between rays that end at grazing incidence
    if n_dims == 2:
        count = int(np.ceil(2 * np.pi / angle))
        turn = rotation_in_plane(2 * np.pi / count * rng.random()).T
    else:
        count, turn = int(np.ceil(4 * np.pi / angle**2)), np.linalg.qr(rng.standard_normal((3, 3)))[0]
    rays = evenly_spread(count, n_dims) @ turn
    return center + _along(table, rays, reach)[:, None] * rays


def _on_box(half: Array, spacing: float) -> Array:
    """Return points on a centred box; array, shape (n_points, 3) [m]. `half` has its half edges (n_dims,)."""
    grids = [np.linspace(-h, h, int(np.ceil(2 * h / spacing)) + 1) for h in half]
    faces = []
    for axis, h in enumerate(half):
        for side in (-h, h):
            across = [np.array([side]) if k == axis else grid for k, grid in enumerate(grids)]
            faces.append(np.stack(np.meshgrid(*across, indexing="ij"), axis=-1).reshape(-1, len(half)))
    points = np.concatenate(faces)
    return np.pad(points, ((0, 0), (0, 3 - len(half))))


@kernel
def _along(table: Array, rays: Array, reach: float) -> Array:
    """Return rays' exit distances from a table's first obstacle [m], by bisection; `rays` is (n, 3)."""
    lengths = np.empty(rays.shape[0])
    for i in range(rays.shape[0]):
        low, high = 0.0, 1.01 * reach
        for _ in range(40):
            t = 0.5 * (low + high)
            x, y, z = table[0, 1] + t * rays[i, 0], table[0, 2] + t * rays[i, 1], table[0, 3] + t * rays[i, 2]
            if sd.point_distance(table, 0, x, y, z) < 0.0:
                low = t
            else:
                high = t
        lengths[i] = low
    return lengths


@kernel
def _of_obstacles(points: Array, table: Array, near: float) -> NDArray[np.bool_]:
    """Return which points (n, 3) are within `near` [m] of obstacles."""
    found = np.zeros(points.shape[0], dtype=np.bool_)
    for i in range(points.shape[0]):
        for j in range(table.shape[0]):
            if sd.point_distance(table, j, points[i, 0], points[i, 1], points[i, 2]) <= near:
                found[i] = True
                break
    return found


def _of_body(points: Array, nodes: Array, body: MovingBody, near: float) -> NDArray[np.bool_]:
    """Return which points (n, 3) are within `near` [m] of a body; `nodes` is (n_nodes, 3) [m]."""
    found = np.zeros(len(points), dtype=bool)
    for (i, j), radius in zip(body.edges, body.radii, strict=True):
        a, way = nodes[i], nodes[j] - nodes[i]
        share = np.clip((points - a) @ way / max(way @ way, sd.TINY), 0.0, 1.0)
        found |= lengths(points - a - share[:, None] * way) <= radius + near
    for corners in body.solids:
        if (
            len(corners) != N_CORNERS
        ):  # a hull: beyond its edges a little more than is within the distance counts
            from scipy.spatial import ConvexHull  # slow to import

            planes = ConvexHull(nodes[np.unique(corners)], qhull_options="QJ").equations
            found |= (points @ planes[:, :3].T + planes[:, 3] <= near).all(axis=1)
            continue
        halves = 0.5 * (nodes[corners[[1, 2, 4]]] - nodes[corners[0]])
        middle, size = 0.5 * (nodes[corners[7]] + nodes[corners[0]]), lengths(halves)
        out = np.maximum(0.0, np.abs((points - middle) @ halves.T) / size - size)
        found |= lengths(out) <= near
    return found | inside_polygon(nodes[body.border], points) if body.filled else found
