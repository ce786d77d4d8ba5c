"""Tracking of point clouds: groups of points with velocities, and covering spheres.

A cloud's cells belong to the track whose predicted spheres are nearest; cells that are near to none begin a new
track, and a track that has split becomes two with one velocity. Two that touch and move alike become one. The middle
of a track's points is the measurement of a Kalman filter (1960) that treats accelerations as white noise; where a
track has grown or shrunk by much, its middle is no measure of its motion, and the filter continues without it.

A sphere that contains no point of a new cloud deep inside, and is nearest to none, is kept for a while and moves on
with its track, as an obstacle that is hidden still exists; but no longer than it had been seen before.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.dmp.arguments import require_count, require_positive
from comove.errors import OptionError
from comove.geometry.distances import points_apart
from comove.geometry.sphere_cover import Cells, covered, thinned

MOST = {
    "noise": 1.0,
    "spacing": 1.0,
    "detail": 10.0,
    "own": 10.0,
    "memory": 60.0,
    "agility": 1e6,
    "fastest": 1e3,
    "sigmas": 10.0,
    "other": 1.0,
    "deep": 1.0,
    "alike": 10.0,
    "forgotten": 1.0,
    "around": 100.0,
    "future": 60.0,
    "history": 60.0,
}


def _require_positive(settings: Scanner | Association) -> None:
    for name, most in MOST.items():
        if hasattr(settings, name):
            require_positive(name, getattr(settings, name), most)


@dataclass(frozen=True)
class Association:
    """Settings of the association of points with earlier spheres and tracks.

    Attributes
    ----------
    other : share of its points by which a track must grow or shrink to ignore its middle
    deep : share of a sphere's radius; points so near to its centre confirm it
    alike : difference of velocity up to which tracks that touch are one [m/s]
    forgotten : factor on a track's `stray` from one cloud to the next
    """

    other: float = 0.25
    deep: float = 0.5
    alike: float = 0.05
    forgotten: float = 0.5

    def __post_init__(self) -> None:
        _require_positive(self)


@dataclass(frozen=True)
class Scanner:
    """The accuracy of point clouds, and settings of their tracking.

    Attributes
    ----------
    noise : standard deviation of a point's coordinate [m]
    spacing : largest distance of neighbouring points on a surface [m]
    detail : largest distance of a sphere's surface from the points seen, apart from noise and spacing [m]
    most : largest number of spheres
    own : distance within which points belong to the payload or an end effector, or to an obstacle of the file [m]
    memory : time for which obstacles out of sight are kept [s]
    agility : spectral density of the obstacles' acceleration [m^2/s^3]: how suddenly they turn
    fastest : standard deviation of a velocity that is not known yet [m/s]
    sigmas : margin for noise and unknown motion, in standard deviations
    around : distance beyond the workspace up to which points count [m]
    future : time by which a cloud may be ahead of the clock [s]
    history : time for which the payload's places are stored [s]
    association : settings of the association of points with tracks
    """

    noise: float = 0.002
    spacing: float = 0.01
    detail: float = 0.02
    most: int = 64
    own: float = 0.01
    memory: float = 0.5
    agility: float = 0.1
    fastest: float = 0.5
    sigmas: float = 3.0
    around: float = 0.2
    future: float = 1.0
    history: float = 2.0
    association: Association = Association()

    def __post_init__(self) -> None:
        _require_positive(self)
        require_count("most", self.most, 1000)
        if self.spacing > self.detail:
            raise OptionError(
                f"detail = {self.detail:g} m is finer than spacing = {self.spacing:g} m",
                key="detail",
                way_out="give at least the spacing",
            )


class Tracks(NamedTuple):
    """Groups of points that move together, at the last cloud's instant.

    Attributes
    ----------
    position : array, shape (n_tracks, 3), middles of their points [m]
    velocity : array, shape (n_tracks, 3), [m/s]
    covariance : array, shape (n_tracks, 2, 2), of position and velocity of a coordinate, equal for all coordinates
    size : array, shape (n_tracks,), number of points
    begun : array, shape (n_tracks,), time at which each was first seen [s]
    stray : array, shape (n_tracks,), speed at which points were seen to leave the positions predicted by the motion
        [m/s]
    """

    position: Array
    velocity: Array
    covariance: Array
    size: Array
    begun: Array
    stray: Array

    def at(self, which: Integers) -> Tracks:
        """Return some of the tracks, in the order of `which`."""
        return Tracks(*(field[which] for field in self))


class Spheres(NamedTuple):
    """Spheres that must not be touched, at the last cloud's instant.

    Attributes
    ----------
    center : array, shape (n_spheres, 3), [m]
    radius : array, shape (n_spheres,), [m]
    track : array of int, shape (n_spheres,), number of the track
    seen : array, shape (n_spheres,), time at which points were last seen in each [s]
    """

    center: Array
    radius: Array
    track: Integers
    seen: Array


class Memory(NamedTuple):
    """The known tracks and spheres. The instant [s] is minus infinity before the first cloud."""

    time: float
    tracks: Tracks
    spheres: Spheres


def blank() -> Memory:
    """Return an empty memory, before the first cloud."""
    none, no_place = np.zeros(0), np.zeros((0, 3))
    tracks = Tracks(no_place, no_place, np.zeros((0, 2, 2)), none, none, none)
    return Memory(-np.inf, tracks, Spheres(no_place, none, np.zeros(0, dtype=np.int64), none))


def moved(memory: Memory, time: float, agility: float) -> Memory:
    """Return the memory at a later instant [s], with all velocities constant."""
    dt = time - memory.time if np.isfinite(memory.time) else 0.0
    tracks, spheres = memory.tracks, memory.spheres
    forward = np.array([[1.0, dt], [0.0, 1.0]])
    noise = agility * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    tracks = tracks._replace(
        position=tracks.position + dt * tracks.velocity,
        covariance=forward @ tracks.covariance @ forward.T + noise,
    )
    center = spheres.center + dt * tracks.velocity[spheres.track]
    return Memory(time, tracks, spheres._replace(center=center))


def margins(memory: Memory, time: float, scanner: Scanner) -> Array:
    """Return points' possible distances outside their spheres at `time` [s]; array, shape (n_spheres,) [m].

    The points themselves are known up to the noise, which the radii include; the margin is for their motion since.
    """
    tracks, (_, _, track, seen) = memory.tracks, memory.spheres
    age = np.maximum(time - seen, 0.0)
    variance = tracks.covariance[track, 1, 1] * age**2 + scanner.agility * age**3 / 3
    return scanner.sigmas * np.sqrt(variance) + tracks.stray[track] * age


def updated(memory: Memory, points: Array, time: float, scanner: Scanner) -> Memory:
    """Return the memory after a cloud, shape (n_points, 3) [m]. Its instant [s] is later."""
    edge, lapse = 0.5 * scanner.detail, time - memory.time
    cells, now = thinned(points, edge), moved(memory, time, scanner.agility)
    tracks, spheres = now.tracks, now.spheres
    reach = margins(now, time, scanner) + scanner.spacing
    nearest, beyond, confirmed = _nearest_spheres(
        cells.point, spheres.center, spheres.radius, reach, scanner.association.deep
    )
    known = nearest >= 0
    label = np.where(known, spheres.track[nearest] if len(spheres.track) else -1, -1)
    # How far points lie out of where the motion puts them, margins aside.
    out = np.zeros(len(tracks.size))
    np.maximum.at(out, label[known], np.maximum(beyond[known] - reach[nearest[known]] + scanner.spacing, 0.0))
    tracks = tracks._replace(stray=np.maximum(out / lapse, scanner.association.forgotten * tracks.stray))
    part, heirs = _parts(cells, label, tracks.velocity, scanner.association.alike)
    tracks = _measured(tracks, points, part[cells.of], heirs, time, scanner)
    pad = scanner.sigmas * scanner.noise + scanner.spacing / sqrt(2.0)  # between the points of a square grid
    fresh = covered(points, cells, part, scanner.detail, scanner.most)
    seen = np.full(len(fresh.radius), time)
    # Spheres that no point confirms; merged tracks continue as their heirs.
    n_parts, age = len(heirs), time - spheres.seen
    successor = np.full(len(memory.tracks.size), -1)
    successor[heirs[heirs >= 0][::-1]] = np.flatnonzero(heirs >= 0)[::-1]
    before = spheres.seen - memory.tracks.begun[spheres.track]
    ghosts = np.flatnonzero(~confirmed & (age <= np.minimum(scanner.memory, before)))
    lone = np.unique(spheres.track[ghosts][successor[spheres.track[ghosts]] < 0])
    successor[lone] = n_parts + np.arange(len(lone))
    kept = Tracks(*(np.concatenate(both) for both in zip(tracks, _still(now.tracks.at(lone)), strict=True)))
    return Memory(
        time,
        kept,
        Spheres(
            np.concatenate([fresh.center, spheres.center[ghosts]]),
            np.concatenate([fresh.radius + pad, spheres.radius[ghosts]]),
            np.concatenate([fresh.group, successor[spheres.track[ghosts]]]).astype(np.int64),
            np.concatenate([seen, spheres.seen[ghosts]]),
        ),
    )


def _still(tracks: Tracks) -> Tracks:
    """Return tracks without present points, with size 0.

    So any points that are seen again count as another size.
    """
    return tracks._replace(size=np.zeros(len(tracks.size)))


def _measured(
    before: Tracks, points: Array, part: Integers, heirs: Integers, time: float, scanner: Scanner
) -> Tracks:
    """Return one track per part. It continues a track, corrected by the positions of its points."""
    n, old = len(heirs), np.maximum(heirs, 0)
    size = np.bincount(part, minlength=n).astype(float)
    middle = np.stack([np.bincount(part, weights=column, minlength=n) for column in points.T], axis=1)
    middle = middle / np.maximum(size, 1)[:, None]
    variance = (scanner.noise**2 + scanner.spacing**2) / np.maximum(size, 1)
    fresh = np.zeros((n, 2, 2))
    fresh[:, 0, 0], fresh[:, 1, 1] = variance, scanner.fastest**2
    if not len(before.size):
        none = np.zeros(n)
        return Tracks(middle, np.zeros((n, 3)), fresh, size, np.full(n, time), none)
    state, is_heir = before.at(old), heirs >= 0
    first = np.unique(heirs, return_index=True)[1]  # of several heirs, the largest
    same = is_heir & (np.abs(size - state.size) <= scanner.association.other * state.size)
    same &= np.isin(np.arange(n), first)
    gain = state.covariance[:, :, 0] / (state.covariance[:, 0, 0] + variance)[:, None]
    gain *= same[:, None]
    surprise = middle - state.position
    position = np.where(same[:, None], state.position + gain[:, :1] * surprise, middle)
    covariance = state.covariance - gain[:, :, None] * state.covariance[:, None, 0]
    anew = fresh.copy()
    anew[:, 1, 1] = state.covariance[:, 1, 1]
    covariance = np.where(same[:, None, None], covariance, anew)
    return Tracks(
        position,
        np.where(is_heir[:, None], state.velocity + gain[:, 1:] * surprise, 0.0),
        np.where(is_heir[:, None, None], covariance, fresh),
        size,
        np.where(is_heir, state.begun, time),
        np.where(is_heir, state.stray, 0.0),
    )


def _parts(cells: Cells, label: Integers, velocity: Array, most_apart: float) -> tuple[Integers, Integers]:
    """Sort cells into connected parts, of one or of alike tracks.

    Tracks that touch and move alike share a part; cells of no track have parts of their own.

    Parameters
    ----------
    label : array of int, shape (n_cells,), tracks, -1 for none
    velocity : array, shape (n_tracks, 3) [m/s]
    most_apart : difference of velocity up to which tracks move alike [m/s]

    Returns
    -------
    part : array of int, shape (n_cells,), the part of each cell
    heirs : array of int, shape (n_parts,), the track that each part continues, -1 for none; the largest part
        of a track comes first
    """
    if not len(label):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    block = cells.key // 2  # twice the edge: cells in touching blocks are connected
    low = block.min(axis=0) - 1
    span = block.max(axis=0) - low + 2
    place = ((block[:, 0] - low[0]) * span[1] + block[:, 1] - low[1]) * span[2] + block[:, 2] - low[2]
    _, one, of = np.unique(place * (label.max() + 2) + label + 1, return_index=True, return_inverse=True)
    nodes = _joined(place[one], label[one], span[1] * span[2], span[2], velocity, most_apart)
    _, part = np.unique(nodes[of], return_inverse=True)
    size = np.bincount(part)
    owner = np.full(len(size), -1)
    np.maximum.at(owner, part, label)
    order = np.argsort(-size, kind="stable")
    rank = np.empty(len(size), dtype=np.int64)
    rank[order] = np.arange(len(size))
    return rank[part], owner[order]


@kernel
def _joined(
    place: Integers, label: Integers, row: int, column: int, velocity: Array, most_apart: float
) -> Integers:
    """Return the first connected node for each node; array of int, shape (n_nodes,).

    Parameters
    ----------
    place : array of int, shape (n_nodes,), sorted grid positions: x row + y column + z
    label : array of int, shape (n_nodes,), tracks, -1 for none
    """
    n = place.shape[0]
    root = np.arange(n)
    for i in range(n):
        for dx in range(2):
            for dy in range(-1, 2):
                for dz in range(-1, 2):
                    wanted = place[i] + dx * row + dy * column + dz
                    if wanted < place[i]:
                        continue
                    j = np.searchsorted(place, wanted)
                    while j < n and place[j] == wanted:  # several of one place belong to several tracks
                        a, b = label[i], label[j]
                        alike = a == b
                        if a >= 0 and b >= 0 and not alike:
                            alike = points_apart(velocity[a], velocity[b]) < most_apart
                        if alike:
                            _join(root, i, j)
                        j += 1
    for i in range(n):
        root[i] = _root(root, i)
    return root


@kernel
def _join(root: Integers, i: int, j: int) -> None:
    a, b = _root(root, i), _root(root, j)
    root[max(a, b)] = min(a, b)


@kernel
def _root(root: Integers, i: int) -> int:
    while root[i] != i:
        root[i] = root[root[i]]
        i = root[i]
    return i


@kernel
def _nearest_spheres(
    points: Array, center: Array, radius: Array, reach: Array, deep: float
) -> tuple[Integers, Array, NDArray[np.bool_]]:
    """Return each point's nearest sphere, its distance, and which spheres are confirmed.

    The nearest is -1 beyond all reaches. Confirmed spheres contain a point nearer to their centre than the share
    `deep` of their radius, or are nearest to one. Distances are from the surface [m], negative inside.
    """
    n, m = points.shape[0], center.shape[0]
    nearest, beyond = np.full(n, -1), np.full(n, np.inf)
    confirmed = np.zeros(m, dtype=np.bool_)
    for i in range(n):
        for j in range(m):
            x, y, z = points[i, 0] - center[j, 0], points[i, 1] - center[j, 1], points[i, 2] - center[j, 2]
            far = radius[j] + reach[j]
            square = x * x + y * y + z * z
            if square > far * far:
                continue
            if square < (deep * radius[j]) ** 2:
                confirmed[j] = True
            out = sqrt(square) - radius[j]
            if out < beyond[i]:
                nearest[i], beyond[i] = j, out
        if nearest[i] >= 0:
            confirmed[nearest[i]] = True
    return nearest, beyond, confirmed
