"""The continuous-time certificate of clearance.

Between two knots every node stays within its *chord deviation* ``h^2/8 max|y''|`` of the chord. So every point of an
edge stays within the larger deviation of its two nodes of the corresponding point of the ruled surface that the
chords span. On that surface a space-time cell [t0, t1] x [s0, s1] is at least

    along - dt/2 max(|dp(s0)|, |dp(s1)|)

away from an obstacle, since signed distances have Lipschitz constant 1. Here `along` bounds the distance along the
edge at mid-time: by the same constant, ``d(middle) - ds/2 length``, or by convexity, as obstacles are convex:
beyond the middle the distance stays above the line through the middle and the other end. Cells that are not
clear enough are halved along their larger term. The least bound over all cells, less the chord deviation and the
radius of the load, is a lower bound of the clearance at every instant.

A moving obstacle is treated in its own frame: the load moves by the relative motion of the two. The obstacle's centre
strays from the chord of its own path between two knots by a known *sagitta*, which is added to the chord deviation.

A solid box between two knots stays within the largest chord deviation of its corners of the box of their chords,
whose centre b and half edges e_k are linear in time. The gap along a fixed direction n between this box and an
obstacle, ``n (c - b) - sum_k |n e_k|`` less a constant (`comove.geometry.solids`), is then concave in time: over
[t0, t1] it is least at an end. The direction is that of the interval before, or the best at mid-time; intervals that
are not clear enough are halved. The same holds for a hull: its reach along n is the largest of functions linear in
time, and so convex in time.

A support recedes from a payload that rests on it (`comove.model.resting`): it is an obstacle that moves, whose
sagitta bounds how far it is ahead of where it may be.

An obstacle that is a mesh is represented by its triangles (`comove.geometry.surfaces`). Every part of the body is a
convex hull of nodes, which leaves a gap along n to each triangle, concave in time as before; a tree of boxes skips
those far away. A body that is outside at the start and never meets a triangle stays outside, so only the start is
checked for being inside.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.dmp.system import INTERVAL, N_INTERVALS
from comove.model.motion import CoordinatedMotion
from comove.model.resting import recession_sagittas, recessions
from comove.model.scene import Scene
from comove.verification.bounds import NodeBounds, node_bounds
from comove.verification.clearance_kernels import (
    Around,
    CurveArrays,
    MeshWay,
    Need,
    Paths,
    certified_clearance,
    certified_solids,
    certified_surface,
)

Array = NDArray[np.float64]

ROUNDING = 1e-12  # of the largest coordinate, and of a metre


@dataclass(frozen=True)
class CertificateSettings:
    """Settings of the certificate: how tight its bound is, and how long it looks for it; it is sound in any case.

    Attributes
    ----------
    loose, tight : how far the bound may stay below the true clearance, in general and close to the required one [m]
    common : sides of workspaces for which these are made; for others they grow and shrink along [m]
    most_cells, most_halves : cells of edges, and halves of intervals of solids and triangles, each of which takes a
        search for a direction; a bound that needs more is given up as it stands, lower than it might be
    """

    loose: float = 1e-4
    tight: float = 1e-7
    common: tuple[float, float] = (0.3, 10.0)
    most_cells: int = 2_000_000
    most_halves: int = 300_000

    def need(self, scene: Scene, nodes: Array) -> Need:
        """Return the accuracy required of the bound for a body with these nodes, array of shape (..., 3) [m]."""
        side = float((scene.upper - scene.lower).max())
        unit = 1.0 if self.common[0] <= side <= self.common[1] else side
        rounding = ROUNDING * max(1.0, side, float(np.abs(nodes).max()))
        most = self.most_cells, self.most_halves
        return Need(scene.clearance, self.loose * unit, self.tight * unit, rounding, *most)


SETTINGS = CertificateSettings()


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
    """Bound the clearance of the whole load and all hands over continuous time.

    Parameters
    ----------
    bounds : bounds of `motion`, computed unless given
    since : normalised time from which on the clearance is bounded
    """
    scene, q = motion.scene, motion.knots[0]
    s = INTERVAL * np.arange(N_INTERVALS + 1, dtype=np.float64)
    deviation = INTERVAL**2 / 8 * (bounds or node_bounds(motion)).acceleration
    if len(scene.obstacle_kinks) or since > 0:  # between kinks obstacles go straight, or on circles
        s = np.union1d(s, np.append(scene.obstacle_kinks / scene.duration, since))
        s = s[s >= since]
        q = motion.at(s)[0]
        deviation = deviation[np.minimum((0.5 * (s[1:] + s[:-1]) / INTERVAL).astype(int), N_INTERVALS - 1)]
    nodes = motion.coordinates.nodes(np.ascontiguousarray(q.T[None]))[0]
    time = s * scene.duration
    paths = Paths(np.zeros((0, len(scene.obstacles), 3)), np.zeros((0, len(scene.obstacles))))
    if scene.moving.any():
        paths = Paths(scene.by_row(scene.offsets(time)), scene.by_row(scene.obstacle_sagittas(time)))
    return certify_curve(scene, CurveArrays(nodes, deviation), time, paths, settings)


def certify_curve(
    scene: Scene,
    curve: CurveArrays,
    time: Array,
    paths: Paths,
    settings: CertificateSettings = SETTINGS,
) -> Clearance:
    """Bound the clearance of a load that is known at some instants, among obstacles that move on `paths`.

    Parameters
    ----------
    time : array, shape (n_knots,), instants of the curve's knots [s]
    """
    if not all(np.isfinite(array).all() for array in (*curve, *paths)):
        return Clearance(-np.inf, -np.inf, float(time[0]), -1)
    if scene.rests:
        paths = _receded(scene, curve, paths)
    body, own, need = scene.body, scene.convex_rows, settings.need(scene, curve.nodes)
    moving = Paths(*(np.ascontiguousarray(array[:, own]) for array in paths))
    around = Around(scene.obstacles[own], moving, *scene.workspace, need)
    found = certified_clearance(curve, body.edges, body.radii, around)
    if len(body.solids):
        found = certified_solids(curve, body.solids, around, found)
    if found.nearest >= 0:
        found = found._replace(nearest=int(scene.owners[own][found.nearest]))
    parts = (body.edges, body.radii), (body.solids, np.zeros(len(body.solids)))
    for mesh, (obstacle, row) in enumerate(zip(scene.surfaces.owner, scene.surfaces.row, strict=True)):
        way = np.zeros(curve.nodes[:, 0].shape), np.zeros(len(curve.deviation))
        if len(paths.offset):
            way = np.ascontiguousarray(paths.offset[:, row]), np.ascontiguousarray(paths.sagitta[:, row])
        for hulls, radii in parts:
            if len(hulls):
                moves = MeshWay(scene.surfaces, mesh, int(obstacle), *way)
                found = certified_surface(curve, hulls, radii, moves, need, found)
    lower, upper, k, nearest = found
    if body.filled or len(scene.surfaces.root):  # at the start, a body inside may touch no border
        at_start, _ = scene.clearance_at(curve.nodes[0], float(time[0]))
        lower, upper = min(lower, at_start), min(upper, at_start)
    return Clearance(lower, upper, float(time[k]), nearest)


def _receded(scene: Scene, curve: CurveArrays, paths: Paths) -> Paths:
    """Return the paths of obstacles where supports recede from a payload that rests on them."""
    moved = recessions(scene, curve.nodes)
    sagitta = scene.by_row(recession_sagittas(scene, curve.nodes, curve.deviation, moved))
    if not len(paths.offset):
        return Paths(scene.by_row(moved), sagitta)
    return Paths(paths.offset + scene.by_row(moved), paths.sagitta + sagitta)
