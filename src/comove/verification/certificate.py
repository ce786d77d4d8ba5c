"""The continuous-time certificate of clearance.

Between two knots every keypoint stays within its *chord deviation* ``h^2/8 max|y''|`` of the chord. So every point of
an edge stays within the larger deviation of its two keypoints of the corresponding point of the ruled surface that
the chords span. On that surface a space-time cell [t0, t1] x [s0, s1] is at least

    along - dt/2 max(|dp(s0)|, |dp(s1)|)

away from an obstacle, since signed distances have Lipschitz constant 1. Here `along` bounds the distance along the
edge at mid-time: by the same constant, ``d(middle) - ds/2 length``, or by convexity, as obstacles are convex:
beyond the middle the distance stays above the line through the middle and the other end. Cells that are not
clear enough are halved along their larger term. The least bound over all cells, less the chord deviation and the
radius of the payload, is a lower bound of the clearance at every instant.

A moving obstacle is treated in its own frame, in which the body is given at the knots: it moves by the relative
motion of the two. The obstacle's centre strays from the chord of its own path between two knots by a known *sagitta*,
which is added to the chord deviation. If the obstacle turns by an angle a between two knots, a point that goes
straight from z to z' relative to its centre strays from its chord by at most

    (a^2 max(|z|, |z'|) + 2 a |z' - z|) / 8,

with z and z' taken perpendicular to the axis, as the second derivative of ``R(-a t) (z + t (z' - z))`` shows.

A solid box between two knots stays within the largest chord deviation of its corners of the box of their chords,
whose centre b and half edges e_k are linear in time. The gap along a fixed direction n between this box and an
obstacle, ``n (c - b) - sum_k |n e_k|`` less a constant (`comove.geometry.solids`), is then concave in time: over
[t0, t1] it is least at an end. The direction is that of the interval before, or the best at mid-time; intervals that
are not clear enough are halved. The same holds for a hull: its reach along n is the largest of functions linear in
time, and so convex in time.

A support recedes from a payload that rests on it (`comove.model.resting`): it is a moving obstacle, whose sagitta
bounds how far it is ahead of its admissible position.

An obstacle that is a mesh is represented by its triangles (`comove.geometry.surfaces`). Every part of the body is a
convex hull of keypoints, which leaves a gap along n to each triangle, concave in time as before; a tree of boxes
skips those far away. A body that is outside at the start and never meets a triangle stays outside, so only the start
is checked for being inside.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from comove.arrays import Array
from comove.dmp.system import INTERVAL, N_INTERVALS
from comove.model.motion import CoordinatedMotion
from comove.model.moving import seen_from
from comove.model.resting import recession_sagittas, recessions
from comove.model.scene import Scene
from comove.verification.bounds import NodeBounds, lengths, node_bounds
from comove.verification.clearance_kernels import (
    ClearanceFound,
    ConvexObstacles,
    CurveArrays,
    MeshAround,
    Need,
    certified_border,
    certified_edges,
    certified_solids,
    certified_surface,
    edges_at_knots,
    hulls_at_knots,
    solids_at_knots,
)

ROUNDING = 1e-12  # of the largest coordinate, and of a metre


@dataclass(frozen=True)
class CertificateSettings:
    """Settings of the certificate: tightness of its bound, and computing effort. It is sound for any of them.

    Attributes
    ----------
    loose, tight : how far the bound may stay below the true clearance, in general and close to the required one [m]
    common : sides of workspaces for which these are made; for others they grow and shrink along [m]
    strays, most_knots : knots are added until points of turning obstacles stray from their chords by less [m], and at
        most so many; this makes bounds tight, and is not needed for them to hold
    most_cells, most_halves : cells of edges, and halves of intervals of solids and triangles, each of which takes a
        search for a direction, for all static obstacles and for each moving one; a bound that needs more stays lower
        than possible
    """

    loose: float = 1e-4
    tight: float = 1e-7
    common: tuple[float, float] = (0.3, 10.0)
    strays: float = 2e-5
    most_knots: int = 20_000
    most_cells: int = 2_000_000
    most_halves: int = 300_000

    def need(self, scene: Scene, nodes: Array) -> Need:
        """Return the accuracy required of the bound for a body; `nodes` has the shape (..., 3) [m]."""
        side = float((scene.upper - scene.lower).max())
        unit = 1.0 if self.common[0] <= side <= self.common[1] else side
        far = np.abs(scene.centers[scene.turning]).max(initial=0.0)  # nodes are turned about these
        rounding = ROUNDING * max(1.0, side, far, float(np.abs(nodes).max()))
        most = self.most_cells, self.most_halves
        return Need(scene.clearance, self.loose * unit, self.tight * unit, rounding, *most)

    def turning_times(self, scene: Scene, duration: float) -> Array:
        """Return times [s] between which turning obstacles' points stray little from chords."""
        bend = np.linalg.norm(scene.spins, axis=1) * scene.obstacle_speeds
        finest = duration * np.sqrt(bend.max(initial=0.0) / (8 * self.strays))
        return np.linspace(0.0, duration, int(min(np.ceil(finest), self.most_knots)) + 1)


SETTINGS = CertificateSettings()


class Paths(NamedTuple):
    """The motions of all obstacles at some instants.

    Attributes
    ----------
    offset : array, shape (n_knots, n_obstacles, 3), offsets of the centres from their positions in the file [m]
    turn : array, shape (n_knots, n_obstacles, 3), rotation vectors along constant axes, linear in between [rad]
    sagitta : array, shape (n_knots - 1, n_obstacles), largest distance of the centres from their chords [m]
    """

    offset: Array
    turn: Array
    sagitta: Array

    @classmethod
    def of(cls, scene: Scene, time: Array) -> Paths:
        """Return the motions by the scene; array, shape (n_knots,) [s]."""
        return cls(scene.offsets(time), scene.turns(time), scene.obstacle_sagittas(time))


class Clearance(NamedTuple):
    """The result of the certificate.

    Attributes
    ----------
    lower : certified lower bound of the clearance at every instant [m]; -inf if the motion is not finite
    upper : a clearance that occurs along the motion [m]; the true minimum lies between the two, up to deviations
    time : time of `upper` [s]
    nearest : number in the scene's file of the obstacle at `upper`, -1 for the border of the workspace
    """

    lower: float
    upper: float
    time: float
    nearest: int


def certify(
    motion: CoordinatedMotion,
    bounds: NodeBounds | None = None,
    since: float = 0.0,
    settings: CertificateSettings = SETTINGS,
) -> Clearance:
    """Bound the clearance of payload and end effectors over continuous time.

    Parameters
    ----------
    bounds : bounds of `motion`, computed unless given
    since : normalised time from which on the clearance is bounded
    """
    scene, q = motion.scene, motion.knots[0]
    s = INTERVAL * np.arange(N_INTERVALS + 1, dtype=np.float64)
    deviation = INTERVAL**2 / 8 * (bounds or node_bounds(motion)).acceleration
    if len(scene.obstacle_kinks) or since > 0 or scene.turning.any():
        # Between kinks obstacles go straight, or on circles; those that turn fast are looked at more often.
        times = np.concatenate([scene.obstacle_kinks, settings.turning_times(scene, scene.duration)])
        s = np.unique(np.concatenate([s, [since], times / scene.duration]))
        s = s[s >= since]
        q = motion.at(s)[0]
        k = np.minimum((0.5 * (s[1:] + s[:-1]) / INTERVAL).astype(int), N_INTERVALS - 1)
        deviation = deviation[k] * ((s[1:] - s[:-1]) / INTERVAL)[:, None] ** 2
    nodes = motion.coordinates.nodes(np.ascontiguousarray(q.T[None]))[0]
    time = s * scene.duration
    return certify_curve(scene, CurveArrays(nodes, deviation), time, Paths.of(scene, time), settings)


def certify_curve(
    scene: Scene,
    curve: CurveArrays,
    time: Array,
    paths: Paths,
    settings: CertificateSettings = SETTINGS,
) -> Clearance:
    """Bound the clearance of a sampled payload among obstacles on `paths`.

    Parameters
    ----------
    time : array, shape (n_knots,), instants of the curve's knots [s]
    """
    if not all(np.isfinite(array).all() for array in (*curve, *paths)):
        return Clearance(-np.inf, -np.inf, float(time[0]), -1)
    if scene.rests:
        paths = _receded(scene, curve, paths)
    body, need = scene.body, settings.need(scene, curve.nodes)
    ends = np.concatenate([body.edges.ravel(), body.solids.ravel()])
    radii = np.zeros(len(ends))
    radii[: body.edges.size] = np.repeat(body.radii, 2)
    found = ClearanceFound(np.inf, np.inf, 0, -1)
    found = certified_border(curve, ends, radii, np.array(scene.workspace), need, found)
    hulls = [(body.edges, body.radii), (body.solids, np.zeros(len(body.solids)))]
    hulls = [(own, thick) for own, thick in hulls if len(own)]
    views = list(_views(scene, curve, paths))  # twice asked for: what stands, and each obstacle that moves
    for at_knots in (True, False):  # first what the clearance is about, which spares much of the rest
        for seen, rows, meshes in views:
            if at_knots:
                found = edges_at_knots(seen.nodes, body.edges, body.radii, rows, need, found)
                if len(body.solids):
                    found = solids_at_knots(seen.nodes, body.solids, rows, need, found)
            else:
                found = certified_edges(seen, body.edges, body.radii, rows, need, found)
                if len(body.solids):
                    found = certified_solids(seen, body.solids, rows, need, found)
            for mesh in meshes:
                for own, thick in hulls:
                    if at_knots:
                        found = hulls_at_knots(seen.nodes, own, thick, mesh, need, found)
                    else:
                        found = certified_surface(seen, own, thick, mesh, need, found)
    lower, upper, k, nearest = found
    if body.filled or len(scene.surfaces.root):  # at the start, a body inside may touch no border
        at_start, _ = scene.clearance_at(curve.nodes[0], float(time[0]))
        lower, upper = min(lower, at_start), min(upper, at_start)
    return Clearance(lower, upper, float(time[k]), nearest)


def _views(
    scene: Scene, curve: CurveArrays, paths: Paths
) -> Iterator[tuple[CurveArrays, ConvexObstacles, list[MeshAround]]]:
    """Yield the curve in obstacles' frames: all static obstacles first, then each moving one."""
    moves = np.zeros(len(scene.motions), dtype=bool)
    for array in paths:
        if array.any():
            moves |= array.reshape(len(array), len(moves), -1).any(axis=(0, 2))
    for own in (~moves, *np.eye(len(moves), dtype=bool)[moves]):
        rows = scene.convex_rows & own[scene.owners]
        meshes = np.flatnonzero(own[scene.surfaces.owner])
        if rows.any() or len(meshes):
            yield (
                _seen(curve, scene, paths, int(own.argmax())) if (own & moves).any() else curve,
                ConvexObstacles(scene.obstacles[rows], scene.owners[rows]),
                [MeshAround(scene.surfaces, int(i), int(scene.surfaces.owner[i])) for i in meshes],
            )


def _seen(curve: CurveArrays, scene: Scene, paths: Paths, obstacle: int) -> CurveArrays:
    """Return a curve in a moving obstacle's frame, that of the file."""
    center, spin = scene.centers[obstacle], scene.spins[obstacle]
    offset, turn, sagitta = (array[:, obstacle] for array in paths)
    nodes = np.ascontiguousarray(seen_from(curve.nodes, center, offset, turn))
    deviation = curve.deviation + sagitta[:, None]
    if spin.any():
        across = curve.nodes - offset[:, None] - center
        axis = spin / np.linalg.norm(spin)
        across -= (across @ axis)[..., None] * axis
        reach, way = lengths(across), lengths(np.diff(across, axis=0))
        angle = lengths(np.diff(turn, axis=0))[:, None]
        deviation += angle * (angle * np.maximum(reach[1:], reach[:-1]) + 2 * way) / 8
    return CurveArrays(nodes, deviation)


def _receded(scene: Scene, curve: CurveArrays, paths: Paths) -> Paths:
    """Return the obstacles' paths with supports that recede from a resting payload."""
    moved = recessions(scene, curve.nodes)
    sagitta = recession_sagittas(scene, curve.nodes, curve.deviation, moved)
    return paths._replace(offset=paths.offset + moved, sagitta=paths.sagitta + sagitta)
