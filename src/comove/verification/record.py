"""The judge of executions: what really happened, step by step, among obstacles that were where they were.

An execution is a sequence of poses of rigid bodies that moved with constant twists in between. So every point of a
body strays from the chord of its step by ``|w|^2 |r| h^2 / 8`` at most, and the continuous-time certificate of
`comove.verification.certificate` covers the whole of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from comove.primitives.rotations import matrices, quaternion_product
from comove.scenes.constraints import DistanceConstraint, SeparationConstraint
from comove.scenes.scene import Scene
from comove.verification.certificate import Paths, certified_clearance, certified_solids

Array = NDArray[np.float64]

END_ERROR = 1e-3  # m, by which an execution may miss its goal
END_SPEED = 1e-3  # m/s, below which it is at rest
ROUNDING = 1e-9  # by which a share of a limit may exceed 1


@dataclass(frozen=True, eq=False)
class Record:
    """What happened.

    Attributes
    ----------
    scene : in which
    time : array, shape (n_steps,), even, from 0 [s]
    center : array, shape (n_steps, n_groups, 3), of the rigid groups' frames [m]
    quaternion : array, shape (n_steps, n_groups, 4), w x y z
    obstacles : array, shape (n_steps, n_obstacles, 3), where their centres really were [m]
    sag : array, shape (n_steps - 1, n_obstacles), how far these strayed from their chords between the steps [m]
    """

    scene: Scene
    time: Array
    center: Array
    quaternion: Array
    obstacles: Array
    sag: Array

    @cached_property
    def nodes(self) -> Array:
        """Hands, then corners of the load; array, shape (n_steps, n_nodes, 3) [m]."""
        nodes = np.zeros((len(self.time), self.scene.body.n_nodes, 3))
        corner, turns = len(self.scene.manipulators), matrices(self.quaternion)
        for g, group in enumerate(self.scene.groups):
            own = [*group.members, *range(corner, corner + len(group.corners))]
            nodes[:, own] = self.center[:, g, None] + np.einsum("tij,nj->tni", turns[:, g], group.points)
            corner += len(group.corners)
        return nodes

    @property
    def position(self) -> Array:
        """Hands; array, shape (n_steps, n_manipulators, n_dims) [m]."""
        return self.nodes[:, : len(self.scene.manipulators), : self.scene.n_dims]


@dataclass(frozen=True)
class RecordReport:
    """What was measured of an execution; bounds hold between the steps too.

    Attributes
    ----------
    clearance_min : certified lower bound of the clearance [m]
    nearest, nearest_time : what came nearest, in words, and when [s]
    distance_error_max : of the distances that constraints and loads fix [m]
    separation_spare_min : least of what hands kept beyond their separations [m]; None without any
    end_error, end_speed : distance of the hands from their goals at the end [m], and their speed there [m/s]
    speed_max, acceleration_max : of the hands [m/s], [m/s^2]
    reasons : what is wrong, in words; empty for an execution that was as it should be
    """

    clearance_min: float
    nearest: str
    nearest_time: float
    distance_error_max: float
    separation_spare_min: float | None
    end_error: float
    end_speed: float
    speed_max: float
    acceleration_max: float
    reasons: tuple[str, ...]


def judge(record: Record, blocker: str = "") -> RecordReport:
    """Judge an execution by the true motion of its obstacles.

    Parameters
    ----------
    blocker : what kept the load from its goal, in words, if that is known
    """
    scene, step = record.scene, np.diff(record.time)[:, None]
    hands = record.nodes[:, : len(scene.manipulators)]
    velocity = np.diff(hands, axis=0) / step[:, :, None]
    # An arc is longer than its chord by (w h)^2 / 24.
    turned = (np.linalg.norm(_spins(record), axis=2) * step).max(initial=0.0)
    speeds = np.linalg.norm(velocity, axis=2) * (1 + turned**2 / 20)
    lower, nearest, when = _clearance(record)
    errors = [
        np.abs(np.linalg.norm(hands[:, c.first] - hands[:, c.second], axis=1) - c.distance).max()
        for c in scene.constraints
        if isinstance(c, DistanceConstraint)
    ]
    spare = [
        float((np.linalg.norm(hands[:, c.first] - hands[:, c.second], axis=1) - c.least).min())
        for c in scene.constraints
        if isinstance(c, SeparationConstraint)
    ]
    changes = np.diff(velocity, axis=0, prepend=0.0)  # from rest
    end_error = np.linalg.norm(hands[-1, :, : scene.n_dims] - scene.goal, axis=1).max()
    report = RecordReport(
        clearance_min=lower,
        nearest=nearest,
        nearest_time=when,
        distance_error_max=float(max(errors, default=0.0)),
        separation_spare_min=min(spare, default=None),
        end_error=float(end_error),
        end_speed=float(speeds[-1].max()),
        speed_max=float(speeds.max()),
        acceleration_max=float(np.linalg.norm(changes, axis=2).max() / step.min()),
        reasons=(),
    )
    return _with_reasons(report, scene, blocker)


def _with_reasons(report: RecordReport, scene: Scene, blocker: str) -> RecordReport:
    reasons, r = [], report
    if not r.clearance_min >= scene.clearance:
        how = f"reaches {-r.clearance_min:.3g} m into" if r.clearance_min < 0 else "comes too near to"
        asked = f" ({scene.clearance:g} m of clearance are asked for)" if scene.clearance else ""
        reasons.append(f"the load or a hand {how} {r.nearest} at {r.nearest_time:.2f} s{asked}")
    tolerance = min(
        (c.tolerance for c in scene.constraints if isinstance(c, DistanceConstraint)), default=np.inf
    )
    if not r.distance_error_max <= tolerance:
        reasons.append(f"a distance is off by {r.distance_error_max:.3g} m (tolerance {tolerance:g} m)")
    if r.separation_spare_min is not None and r.separation_spare_min < 0:
        reasons.append(f"two hands come {-r.separation_spare_min:.3g} m nearer than they may")
    if not r.end_error <= END_ERROR:
        reasons.append(f"the goal is missed by {r.end_error:.3g} m{blocker and f': {blocker}'}")
    if not r.end_speed <= END_SPEED:
        reasons.append(f"a hand still moves at {r.end_speed:.3g} m/s at the end")
    if not r.speed_max <= scene.speed_limit * (1 + ROUNDING):
        reasons.append(f"a hand moves at {r.speed_max:.4g} m/s (limit {scene.speed_limit:g} m/s)")
    if not r.acceleration_max <= scene.acceleration_limit * (1 + ROUNDING):
        reasons.append(
            f"a hand accelerates by {r.acceleration_max:.4g} m/s^2 (limit {scene.acceleration_limit:g} m/s^2)"
        )
    return RecordReport(**{**vars(r), "reasons": tuple(reasons)})


def _spins(record: Record) -> Array:
    """Angular velocities between the steps; array, shape (n_steps - 1, n_groups, 3) [rad/s]."""
    before, after = record.quaternion[:-1], record.quaternion[1:]
    turn = quaternion_product(after, before * [1.0, -1.0, -1.0, -1.0])
    turn *= np.where(turn[..., :1] < 0, -1.0, 1.0)
    size = np.linalg.norm(turn[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(size, turn[..., :1])
    scale = np.where(size > 1e-12, angle / np.maximum(size, 1e-300), 2.0)
    return turn[..., 1:] * scale / np.diff(record.time)[:, None, None]


def _clearance(record: Record) -> tuple[float, str, float]:
    """Certified lower bound [m], what is nearest, and when [s]."""
    scene, body, nodes = record.scene, record.scene.body, record.nodes
    finite = (
        np.isfinite(nodes).all() and np.isfinite(record.obstacles).all() and np.isfinite(record.sag).all()
    )
    if not finite:
        return -np.inf, "something", 0.0
    bulge, corner = np.zeros((len(nodes) - 1, nodes.shape[1])), len(scene.manipulators)
    square = (_spins(record) ** 2).sum(axis=2) * np.diff(record.time)[:, None] ** 2 / 8
    for g, group in enumerate(scene.groups):
        own = [*group.members, *range(corner, corner + len(group.corners))]
        bulge[:, own] = square[:, g, None] * np.linalg.norm(group.points, axis=1)
        corner += len(group.corners)
    offsets = record.obstacles - scene.obstacles[:, 1:4]
    still = not offsets.any()
    paths = Paths(offsets[:0] if still else offsets, record.sag)
    around = scene.obstacles, paths, *scene.workspace, scene.clearance
    found = certified_clearance(nodes, bulge, body.edges, body.radii, *around)
    if len(body.solids):
        found = certified_solids(nodes, bulge, body.solids, *around, *found)
    lower, _, k, nearest = found
    if body.filled:
        lower = min(lower, scene.clearance_at(nodes[0])[0])
    return float(lower), scene.name_of(int(nearest)), float(record.time[k])
