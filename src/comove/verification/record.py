"""The verification of executions among obstacles at their true positions.

An execution is a sequence of poses of rigid bodies that move with constant twists in between. So every point of a
body strays from the chord of its step by at most ``|w|^2 |r| h^2 / 8``, and the continuous-time certificate of
`comove.verification.certificate` covers the whole execution.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.brief import brief
from comove.errors import OptionError
from comove.geometry.rotations import matrices, quaternion_product
from comove.model.constraints import Course
from comove.model.scene import Scene
from comove.verification.certificate import SETTINGS, Clearance, Paths, certify_curve
from comove.verification.clearance_kernels import CurveArrays
from comove.verification.verify import Report, broken_limits, examine, measures, support_measures

END_ERROR = 1e-3  # m, by which an execution may miss its goal
END_SPEED = 1e-3  # m/s, below which it is at rest
ROUNDING = 1e-9  # by which a share of a limit may exceed 1


@dataclass(frozen=True, eq=False)
class Record:
    """The record of an execution: poses of the rigid groups and positions of the obstacles.

    Attributes
    ----------
    scene : the scene that was executed
    time : array, shape (n_steps,), evenly spaced, from 0 [s]
    center : array, shape (n_steps, n_groups, 3), origins of the rigid groups' frames [m]
    quaternion : array, shape (n_steps, n_groups, 4), orientations of the rigid groups, w x y z
    obstacles : array, shape (n_steps, n_obstacles, 3), true positions of the obstacles' centres [m]; they turn as the
        scene says
    sagitta : array, shape (n_steps - 1, n_obstacles), largest distance of these from their chords [m]
    """

    __repr__ = brief

    scene: Scene
    time: Array
    center: Array
    quaternion: Array
    obstacles: Array
    sagitta: Array

    def table(self, step: int) -> Array:
        """Return the obstacle table with the true poses at a step."""
        return self.scene.obstacles_at(float(self.time[step]), self.obstacles[step])

    @cached_property
    def nodes(self) -> Array:
        """Return the keypoints, end effectors first, then payload corners; array, shape (n_steps, n_nodes, 3) [m]."""
        nodes, turns = np.zeros((len(self.time), self.scene.body.n_nodes, 3)), matrices(self.quaternion)
        for g, own in enumerate(self.scene.nodes_of_groups):
            turned = np.einsum("tij,nj->tni", turns[:, g], self.scene.groups[g].points)
            nodes[:, own] = self.center[:, g, None] + turned
        return nodes

    @cached_property
    def spins(self) -> Array:
        """Return the angular velocities between the steps; array, shape (n_steps - 1, n_groups, 3) [rad/s]."""
        before, after = self.quaternion[:-1], self.quaternion[1:]
        turn = quaternion_product(after, before * [1.0, -1.0, -1.0, -1.0])
        turn *= np.where(turn[..., :1] < 0, -1.0, 1.0)
        size = np.linalg.norm(turn[..., 1:], axis=-1, keepdims=True)
        angle = 2 * np.arctan2(size, turn[..., :1])
        scale = np.where(size > 1e-12, angle / np.maximum(size, 1e-300), 2.0)
        return turn[..., 1:] * scale / np.diff(self.time)[:, None, None]

    @cached_property
    def chord_deviations(self) -> Array:
        """Return keypoints' largest distances from their chords; array, shape (n_steps - 1, n_nodes) [m]."""
        chord_deviations = np.zeros((len(self.time) - 1, self.scene.body.n_nodes))
        square = (self.spins**2).sum(axis=2) * np.diff(self.time)[:, None] ** 2 / 8
        for g, own in enumerate(self.scene.nodes_of_groups):
            chord_deviations[:, own] = square[:, g, None] * np.linalg.norm(
                self.scene.groups[g].points, axis=1
            )
        return chord_deviations

    @property
    def position(self) -> Array:
        """Return the positions of the end effectors; array, shape (n_steps, n_manipulators, n_dims) [m]."""
        return self.nodes[:, : len(self.scene.manipulators), : self.scene.n_dims]

    def holds(self, hands: Sequence[int]) -> bool:
        """Return whether end effectors are on one rigid body."""
        return any(set(hands) <= set(own) for own in self.scene.nodes_of_groups)

    def tilting(self, hands: Sequence[int]) -> Array:
        """Return half of each step's rotation that changes tilts [rad].

        A line between end effectors of one body tilts at most that much more than at the worse end of the step.
        """
        (g,) = {g for g, own in enumerate(self.scene.nodes_of_groups) if set(hands) & set(own)}
        axes = slice(0, 2) if self.scene.n_dims == 3 else slice(2, 3)
        return 0.5 * np.linalg.norm(self.spins[:, g, axes], axis=1) * np.diff(self.time)

    def direction(self, hand: int, own: Array) -> tuple[Array, Array]:
        """Return a body-fixed direction at every step, and its chord deviation."""
        (g,) = {g for g, nodes in enumerate(self.scene.nodes_of_groups) if hand in nodes}
        turns = matrices(self.quaternion[:, g])
        stray = (self.spins[:, g] ** 2).sum(axis=1) * np.diff(self.time) ** 2 / 8
        return turns @ (self.scene.groups[g].start.rotation.T @ own), stray


@dataclass(frozen=True, eq=False)
class RecordSamples:
    """A record of sampled end-effector positions from any source.

    End effectors move straight from sample to sample, and obstacles as in the scene.

    Attributes
    ----------
    scene : a scene whose payload is determined by its end effectors, as bars and frames are
    time : array, shape (n_steps,), evenly spaced, from 0 [s]
    position : array, shape (n_steps, n_manipulators, n_dims), positions of the end effectors [m]

    Raises
    ------
    OptionError
        If the end effectors do not determine the payload, or the arrays do not belong to the scene.
    """

    scene: Scene
    time: Array
    position: Array

    def __post_init__(self) -> None:
        scene, shape = self.scene, (len(self.time), len(self.scene.manipulators), self.scene.n_dims)
        if np.shape(self.position) != shape or len(self.time) < 3:
            raise OptionError(
                f"position has the shape {np.shape(self.position)}",
                key="position",
                way_out=f"give {shape[1]} hands in {shape[2]} dimensions at every time, 3 or more",
            )
        unknown = [c for c in scene.constraints if c.turning]
        if scene.body.n_nodes > len(scene.manipulators) or (unknown and scene.n_dims == 3):
            raise OptionError(
                "hands do not tell how this load is turned", key="scene", way_out="take a bar or a frame"
            )

    @cached_property
    def nodes(self) -> Array:
        """Return the end effectors in space; array, shape (n_steps, n_manipulators, 3) [m]."""
        nodes = np.zeros((*np.shape(self.position)[:2], 3))
        nodes[..., : self.scene.n_dims] = self.position
        return nodes

    @property
    def chord_deviations(self) -> Array:
        """Return zeros, as end effectors move along chords; array, shape (n_steps - 1, n_manipulators) [m]."""
        return np.zeros((len(self.time) - 1, len(self.scene.manipulators)))

    @cached_property
    def obstacles(self) -> Array:
        """Return the positions of the obstacles' centres; array, shape (n_steps, n_obstacles, 3) [m]."""
        return self.scene.centers_at(self.time)

    @cached_property
    def sagitta(self) -> Array:
        """Return the centres' largest distances from their chords; array, shape (n_steps - 1, n_obstacles) [m]."""
        return self.scene.obstacle_sagittas(self.time)

    def holds(self, hands: Sequence[int]) -> bool:
        """Return False, as no rigid body is known."""
        return False

    def tilting(self, hands: Sequence[int]) -> Array:
        """Return zeros. The direction between two straight-moving end effectors turns monotonically in a step."""
        return np.zeros(len(self.time) - 1)

    def direction(self, hand: int, own: Array) -> tuple[Array, Array]:
        """Return infinite deviations, as the bodies' rotations are unknown."""
        return np.tile(own, (len(self.time), 1)), np.full(len(self.time) - 1, np.inf)


@dataclass(frozen=True, kw_only=True)
class ExecutionReport(Report):
    """The measures of an execution, between the steps too.

    Exceptions are velocities, which are averages over a step, and accelerations, the changes of these from one step
    to the next. The jerk is not measured. Errors at ends are distances of end effectors: `end_error` is that of the
    goal.

    Attributes
    ----------
    start_error : largest distance of an end effector from the required start [m]
    reasons : faults in words; empty for a correct execution
    """

    start_error: float
    reasons: tuple[str, ...] = ()


def verify_execution(record: Record | RecordSamples, blocker: str = "") -> ExecutionReport:
    """Verify an execution by the true obstacle motion; return the report.

    Parameters
    ----------
    blocker : reason in words why the payload did not reach its goal, if known
    """
    scene, step = record.scene, np.diff(record.time)[:, None]
    hands = record.nodes[:, : len(scene.manipulators)]
    velocity = np.diff(hands, axis=0) / step[:, :, None]
    speeds = np.linalg.norm(velocity, axis=2)
    changes = np.diff(velocity, axis=0, prepend=0.0, append=0.0)  # from rest to rest
    misses = np.linalg.norm(hands[[0, -1], :, : scene.n_dims] - [scene.start, scene.goal], axis=2).max(axis=1)
    clearance = clearance_of(record)
    findings = examine(_RecordCourse(record), scene.constraints, scene.manipulators)
    measured: dict[str, Any] = {"distance_error_max": 0.0, **measures(findings)}
    report = ExecutionReport(
        clearance_min=clearance.lower,
        start_error=float(misses[0]),
        end_error=float(misses[1]),
        end_speed=float(speeds[-1].max()),
        speed_max=float(speeds.max()),
        acceleration_max=float(np.linalg.norm(changes, axis=2).max() / step.min()),
        **measured,
        **support_measures(scene, record.nodes, clearance.lower, record.time),
    )
    reasons = _contact(record, clearance)
    reasons += [finding.reason for finding in findings if finding.reason]
    if not report.start_error <= END_ERROR:
        reasons.append(f"it begins {report.start_error:.3g} m from the start")
    if not report.end_error <= END_ERROR:
        reasons.append(f"the goal is missed by {report.end_error:.3g} m{blocker and f': {blocker}'}")
    reasons += broken_limits(report, scene, END_SPEED, up_to="", rounding=ROUNDING)
    return replace(report, reasons=tuple(reasons))


def clearance_of(record: Record | RecordSamples) -> Clearance:
    """Return the certificate over all steps.

    Steps are cut where the known motion of an obstacle has a kink, and where it turns far: within a part, obstacles
    and nodes stray no more from their chords than over the step. Where obstacles were elsewhere than the scene says,
    steps stay whole.
    """
    scene, time, nodes, chord_deviations = record.scene, record.time, record.nodes, record.chord_deviations
    obstacles, sagitta = record.obstacles, record.sagitta
    kinks = {t - scene.begins for motion in scene.motions if motion is not None for t in motion.kinks}
    inside = [*kinks, *SETTINGS.turning_times(scene, float(time[-1]))]
    cut = np.union1d(time, [t for t in inside if time[0] < t < time[-1]])
    if len(cut) > len(time) and np.allclose(obstacles, scene.centers_at(time), rtol=0.0, atol=1e-12):
        k = np.clip(np.searchsorted(time, cut, side="right") - 1, 0, len(time) - 2)
        share = ((cut - time[k]) / (time[k + 1] - time[k]))[:, None, None]
        nodes, chord_deviations = (1 - share) * nodes[k] + share * nodes[k + 1], chord_deviations[k[:-1]]
        obstacles, sagitta, time = scene.centers_at(cut), scene.obstacle_sagittas(cut), cut
    paths = Paths(obstacles - scene.centers, scene.turns(time), sagitta)
    return certify_curve(scene, CurveArrays(nodes, chord_deviations), time, paths)


def _contact(record: Record | RecordSamples, clearance: Clearance) -> list[str]:
    scene, lower = record.scene, clearance.lower
    unknown = np.flatnonzero(~np.isfinite(record.obstacles).all(axis=(0, 2)))
    if len(unknown):
        return [
            f"nobody knows where {scene.name_of(int(unknown[0]))} really was: contact cannot be ruled out"
        ]
    if not np.isfinite(record.nodes).all():
        return ["the record holds what is no number"]
    if lower >= scene.clearance:
        return []
    how = f"reaches {-lower:.3g} m into" if lower < 0 else "comes too near to"
    asked = f" ({scene.clearance:g} m of clearance are asked for)" if scene.clearance else ""
    return [f"the load or a hand {how} {scene.name_of(clearance.nearest)} at {clearance.time:.2f} s{asked}"]


class _RecordCourse(Course):
    """The end effectors of a record, moving along arcs between steps."""

    def __init__(self, record: Record | RecordSamples):
        self.record, self.n_dims = record, record.scene.n_dims
        self.position = record.nodes[:, : len(record.scene.manipulators)]

    def stray(self, hands: Sequence[int]) -> Array:
        """Return the summed largest distances of end effectors from their chords."""
        return self.record.chord_deviations[:, list(hands)].sum(axis=1)

    def relative(self, first: int, second: int, axes: slice) -> tuple[Array, Array]:
        """Return one end effector relative to another, and its chord deviation."""
        apart = self.position[:, first, axes] - self.position[:, second, axes]
        return apart, self.stray((first, second))

    def rigid(self, first: int, second: int, *, roll: bool = False) -> bool:
        """Return whether one body is known to hold both end effectors. A record knows its roll too."""
        return self.record.holds((first, second))

    def tilting(self, hands: Sequence[int]) -> Array:
        """Return the additional tilt of lines between end effectors within steps."""
        return self.record.tilting(hands)

    def direction(self, hand: int, own: Array) -> tuple[Array, Array]:
        """Return a direction of a body known from a record."""
        return self.record.direction(hand, own)
