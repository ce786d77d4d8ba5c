"""Velocity inequalities that keep end effectors and payloads clear.

They keep clear of obstacles, the border and each other. For a point p at a share f of the segment between end
effectors a and b, at distance d from an obstacle with outward normal n, a control barrier function (Ames et al.,
2017) requires of the end effectors' velocities

    n . ((1 - f) v_a + f v_b - v_obstacle) >= -rate(d - need).

Distances to convex obstacles are convex, so that their linearisation is conservative. There is one such row for the
nearest point and for both ends of every segment.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.geometry.closest_points import near_on_edge
from comove.geometry.distances import CENTER, distance_and_gradient
from comove.geometry.rotations import cross
from comove.model.scene import Scene
from comove.model.shapes import spatial


class Approach(NamedTuple):
    """Limits of the approach speed of end effectors.

    Attributes
    ----------
    gain : ratio of the largest approach speed to the remaining clearance [1/s]
    braking : assumed largest deceleration of end effectors [m/s^2], infinite without a limit
    need : clearance that is kept [m]
    retreat : largest speed at which a lost clearance is restored [m/s]
    """

    gain: float
    braking: float
    need: float
    retreat: float = 0.25

    def rate(self, left: Array) -> Array:
        """Return the largest approach speeds [m/s] for remaining clearances [m]."""
        braked = np.sqrt(2.0 * self.braking * np.maximum(left, 0.0)) if self.braking < np.inf else np.inf
        return np.where(
            left >= 0.0, np.minimum(self.gain * left, braked), np.maximum(self.gain * left, -self.retreat)
        )


def clearance_rows(
    scene: Scene, hands: Array, table: Array, velocity: Array, approach: Approach, reach: float
) -> tuple[Array, Array]:
    """Return inequalities for clearances of end effectors and payloads. They cover obstacles, the border and
    separations.

    Parameters
    ----------
    hands : array, shape (n_hands, n_dims), positions of the end effectors [m]
    table, velocity : arrays, shapes (n_obstacles, N_COLUMNS) and (n_obstacles, 3), obstacles at this instant and
        the velocities of their centres [m/s]; they rotate as the scene says
    reach : clearance beyond the needed one from which on obstacles are left out [m]

    Returns
    -------
    rows, low : arrays, shapes (n_rows, n_hands * n_dims) and (n_rows,), of ``rows v >= low`` for the velocities v
    """
    n_hands, n_dims = hands.shape
    found, count = _near(spatial(hands), scene.body.edges, scene.body.radii, table, approach.need + reach)
    edge, obstacle = found[:count, 0].astype(int), found[:count, 1].astype(int)
    share, left, normal = found[:count, 2], found[:count, 3] - approach.need, found[:count, 4:]
    rows = np.zeros((count, n_hands, n_dims))
    ends = scene.body.edges[edge].reshape(-1, 2)
    numbers = np.arange(count)
    np.add.at(rows, (numbers, ends[:, 0]), (1.0 - share)[:, None] * normal[:, :n_dims])
    np.add.at(rows, (numbers, ends[:, 1]), share[:, None] * normal[:, :n_dims])
    comes = velocity[obstacle]
    if scene.turning.any():
        first, second = spatial(hands)[ends.T]
        point = first + share[:, None] * (second - first)
        arm = point - table[obstacle, CENTER : CENTER + 3]
        comes = comes + cross(scene.spins[scene.owners[obstacle]], arm)
    low = (normal * comes).sum(axis=1) - approach.rate(left)
    sets = [
        (rows.reshape(count, hands.size), low),
        _border_rows(scene, hands, approach),
        _apart_rows(scene, hands, approach),
    ]
    return np.concatenate([rows for rows, _ in sets]), np.concatenate([low for _, low in sets])


def _border_rows(scene: Scene, hands: Array, approach: Approach) -> tuple[Array, Array]:
    """Return the inequalities of end effectors and workspace sides."""
    thick = np.zeros(len(hands))
    for edge, radius in zip(scene.body.edges, scene.body.radii, strict=True):
        thick[edge] = np.maximum(thick[edge], radius)
    inside = np.stack([hands - scene.lower, scene.upper - hands]) - (thick + approach.need)[None, :, None]
    rows = np.eye(hands.size)
    return np.concatenate([rows, -rows]), -approach.rate(inside).ravel()


def _apart_rows(scene: Scene, hands: Array, approach: Approach) -> tuple[Array, Array]:
    """Return the inequalities of separations between different bodies."""
    pairs, least = scene.kept_apart
    away = hands[pairs[:, 0]] - hands[pairs[:, 1]]
    length = np.maximum(np.linalg.norm(away, axis=1), 1e-12)
    rows = np.zeros((len(pairs), *hands.shape))
    numbers = np.arange(len(pairs))
    rows[numbers, pairs[:, 0]] = away / length[:, None]
    rows[numbers, pairs[:, 1]] = -away / length[:, None]
    return rows.reshape(len(pairs), hands.size), -approach.rate(length - least - approach.need)


@kernel
def _near(nodes: Array, edges: Integers, radii: Array, table: Array, cutoff: float) -> tuple[Array, int]:
    """Find points and ends of edges within `cutoff` [m] of obstacles.

    Returns
    -------
    found : array, shape (n_most, 7), edge, obstacle, share along the edge, distance [m] and normal (3) of every point
    count : number of rows of `found` that are used
    """
    found, count = np.empty((3 * edges.shape[0] * table.shape[0], 7)), 0
    for e in range(edges.shape[0]):
        p, q = nodes[edges[e, 0]], nodes[edges[e, 1]]
        for j in range(table.shape[0]):
            distance, nearest = near_on_edge(table, j, p, q, cutoff + radii[e])
            if distance - radii[e] > cutoff:
                continue
            for k in range(3):
                share = (nearest, 0.0, 1.0)[k]
                if k > 0 and (share == nearest or edges[e, 0] == edges[e, 1]):
                    continue
                x, y, z = p + share * (q - p)
                distance, nx, ny, nz = distance_and_gradient(table, j, x, y, z)
                if distance - radii[e] <= cutoff:
                    found[count] = np.array([e, j, share, distance - radii[e], nx, ny, nz])
                    count += 1
    return found, count
