"""The verifier of motions, the only maker of `VerifiedMotion`.

It bounds the violation of a scene's constraints at every instant. Properties that a block of the coordinates keeps by
construction follow from the block: end effectors of one block are images of fixed points under one rigid motion, and
a block that only shifts, or only turns about the vertical, keeps all tilts. End effectors of different blocks are
bounded by their derivatives between the knots.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import InitVar, asdict, dataclass, field
from typing import Any, ClassVar, NamedTuple, NoReturn, Protocol, Self

import numpy as np

import comove
from comove.arrays import Array
from comove.brief import brief
from comove.dmp.system import INTERVAL, N_INTERVALS
from comove.errors import OptionError
from comove.model.blocks import turned
from comove.model.constraints import Constraint, Course
from comove.model.coordinates import ANGLE, DIRECTION, POINT, Block, coordinates_for
from comove.model.motion import CoordinatedMotion
from comove.model.resting import TOLERANCE
from comove.model.scene import Scene
from comove.trajectory import Trajectory
from comove.verification.bounds import (
    NodeBounds,
    derivative_bounds,
    largest_acceleration,
    largest_jerk,
    largest_speed,
    lengths,
    node_bounds,
    turning_bounds,
)
from comove.verification.certificate import Clearance, certify

CHORD_DEVIATION = INTERVAL**2 / 8  # by which a point leaves its chord, per second derivative


class Finding(NamedTuple):
    """The result of the check of one constraint.

    Attributes
    ----------
    constraint : the constraint
    error : upper bound of its error at every instant
    reason : why it does not hold, in words; empty where it does
    """

    constraint: Constraint
    error: float
    reason: str


def examine(course: Course, constraints: Sequence[Constraint], names: Sequence[str]) -> list[Finding]:
    """Check every constraint over continuous time; `names` are those of the end effectors."""
    errors = [(c, c.bound(course)) for c in constraints]
    return [Finding(c, error, "" if error <= c.allowed else c.reason(error, names)) for c, error in errors]


def measures(findings: Sequence[Finding]) -> dict[str, float]:
    """Return the worst measures of constraints by their names in reports."""
    worst: dict[str, float] = {}
    for c, error, _ in findings:
        if c.report:
            worse = min if c.report.endswith("_min") else max
            worst[c.report] = worse(worst.get(c.report, c.measure(error)), c.measure(error))
    return worst


class MotionCourse(Course):
    """The end effectors of a motion. Its coordinates define rigid parts, its derivatives bound others."""

    def __init__(self, motion: CoordinatedMotion, bounds: NodeBounds, position: Array):
        self.motion, self.position, self.n_dims = motion, position, motion.scene.n_dims
        self._acceleration = bounds.acceleration

    def stray(self, hands: Sequence[int]) -> Array:
        """Return the summed largest distances of end effectors from their chords."""
        return CHORD_DEVIATION * self._acceleration[:, list(hands)].sum(axis=1)

    def relative(self, first: int, second: int, axes: slice) -> tuple[Array, Array]:
        """Return one end effector relative to another. It is exact where both are columns of q and constants."""
        blocks = [self._block(first), self._block(second)]
        if not all(self._is_shifted(part, axes) for part, _ in blocks):
            apart = self.position[:, first, axes] - self.position[:, second, axes]
            return apart, self.stray((first, second))
        columns = np.arange(self.motion.coordinates.n_columns)
        knots = [self.motion.knots[:, :, columns[part.columns][: self.n_dims][axes]] for part, _ in blocks]
        relative = knots[0] - knots[1]
        relative[0] += np.subtract(*(part.points[i, axes] for part, i in blocks))
        return relative[0], CHORD_DEVIATION * derivative_bounds(relative)[2]

    def rigid(self, first: int, second: int, *, roll: bool = False) -> bool:
        """Return whether one block moves both end effectors, including their roll."""
        part, _ = self._block(first)
        return second in part.nodes and not (roll and part.kind == DIRECTION)

    def tilting(self, hands: Sequence[int]) -> Array:
        """Return zeros where lines keep their tilt, else infinity. A block, or one shared height, keeps it."""
        part, _ = self._block(hands[0])
        kept = set(hands) <= set(part.nodes.tolist()) and self._keeps_tilt(part)
        return np.full(N_INTERVALS, 0.0 if kept or self._is_level(hands) else np.inf)

    def direction(self, hand: int, own: Array) -> tuple[Array, Array]:
        """Return a body-fixed direction and a bound of its chord deviation."""
        part, _ = self._block(hand)
        turn = self.motion.knots[:, :, part.columns][:, :, self.n_dims :]
        if part.kind == POINT:
            return np.tile(own, (N_INTERVALS + 1, 1)), np.zeros(N_INTERVALS)
        if part.kind == DIRECTION:
            return np.tile(own, (N_INTERVALS + 1, 1)), np.full(N_INTERVALS, np.inf)
        first = turned(part.kind, turn[:, :1], np.eye(3))[0, 0].T
        there = turned(part.kind, turn, (first.T @ own)[None])[0, :, 0]
        reach = np.linalg.norm(own[:2]) if part.kind == ANGLE else 1.0
        return there, CHORD_DEVIATION * reach * turning_bounds(part.kind, turn)[0]

    def _is_level(self, hands: Sequence[int]) -> bool:
        """Return whether end effectors in space share one height for any q."""
        columns = np.arange(self.motion.coordinates.n_columns)
        blocks = [self._block(hand) for hand in hands]
        if self.n_dims != 3 or not all(self._keeps_tilt(part) for part, _ in blocks):
            return False
        return len({(int(columns[part.columns][2]), float(part.points[i, 2])) for part, i in blocks}) == 1

    def _block(self, hand: int) -> tuple[Block, int]:
        """Return the block that moves an end effector, and its index there."""
        for part in self.motion.coordinates.parts:
            found = np.flatnonzero(part.nodes == hand)
            if len(found):
                return part, int(found[0])
        raise LookupError(f"no block moves hand {hand}")

    def _keeps_tilt(self, part: Block) -> bool:
        return part.kind == POINT or (part.kind == ANGLE and self.n_dims == 3)

    def _is_shifted(self, part: Block, axes: slice) -> bool:
        return part.kind == POINT or (self._keeps_tilt(part) and axes == slice(2, 3))


class Sealed:
    """A frozen result that only its checking function can create.

    Other callers of the constructor get an error that names this function.

    Attributes
    ----------
    MAKER, INSTEAD : the function that creates it, and a substitute for pickling it, in words
    """

    __slots__ = ()
    MAKER: ClassVar[str]
    INSTEAD: ClassVar[str]

    def _require(self, sealed: bool) -> None:
        """Raise a TypeError unless the constructor's caller has the seal."""
        if not sealed:
            raise TypeError(f"{type(self).__name__} comes from {self.MAKER}, not from its constructor")

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: dict[int, object]) -> Self:
        return self

    def __reduce__(self) -> NoReturn:
        raise TypeError(f"{type(self).__name__} is not pickled: {self.INSTEAD}")


END_ERROR = 1e-9  # m
END_SPEED = 1e-9  # m/s
END_STEP = 1e-9  # of the largest acceleration, and of 1 m/s^2: what is less is rounding

_SEAL = object()


@dataclass(frozen=True)
class Report:
    """The measures of a motion. Bounds hold at every instant, not only at samples.

    Attributes
    ----------
    clearance_min : certified lower bound of the clearance [m]
    distance_error_max : upper bound of the error of every distance constraint, those that a payload or relative
        poses imply included [m]
    end_error : largest miss of a start or a goal [m]
    end_speed : largest speed at the end [m/s]
    speed_max : upper bound of an end effector's speed [m/s]
    acceleration_max : upper bound of an end effector's acceleration [m/s^2]
    separation_spare_min : lower bound of the spare of the end effectors' distances beyond the least that their
        separations allow [m]; negative where one is broken
    tilt_max : upper bound of the change of the tilt of an upright payload [rad]
    height_error_max : upper bound of the difference of heights that must be the same [m]
    constraint_excess_max : upper bound of what errors of constraints of other kinds exceed their tolerance by, each
        in its own unit
    jerk_max : upper bound of an end effector's jerk, infinite where its acceleration jumps at the start or the end
        [m/s^3]

    support_distance_min : lower bound of the distance from supports, near ends that rest on them [m]; there
        `clearance_min` is that from supports that recede (`comove.model.resting`)
    support_left, support_met : time from which the full clearance is kept from supports of the start, and until which
        it is kept from those of the goal [s]

    All from `separation_spare_min` on are None where the scene requires none of the kind.
    """

    clearance_min: float
    distance_error_max: float
    end_error: float
    end_speed: float
    speed_max: float
    acceleration_max: float
    separation_spare_min: float | None = None
    tilt_max: float | None = None
    height_error_max: float | None = None
    constraint_excess_max: float | None = None
    jerk_max: float | None = None
    support_distance_min: float | None = None
    support_left: float | None = None
    support_met: float | None = None

    def limit_ratios(self, scene: Scene) -> tuple[float, float, float]:
        """Return speed, acceleration and jerk divided by their limits. Without a limit they are 0."""
        return (
            self.speed_max / scene.speed_limit,
            self.acceleration_max / scene.acceleration_limit,
            (self.jerk_max or 0.0) / scene.jerk_limit,
        )

    def asdict(self) -> dict[str, float]:
        """Return the measures by name, without those that the scene lacks."""
        return {name: value for name, value in asdict(self).items() if value is not None}


@dataclass(frozen=True, eq=False, repr=False)
class VerifiedMotion(Sealed):
    """A motion that has passed every check; only `verify` creates it.

    Attributes
    ----------
    motion : CoordinatedMotion
    report : Report
    """

    __repr__ = brief

    __slots__ = ("motion", "report")
    MAKER = "comove.verification.verify"
    INSTEAD = "send its `motion` and verify that anew"

    motion: CoordinatedMotion
    report: Report
    seal: InitVar[object] = field(default=None, kw_only=True)

    def __post_init__(self, seal: object) -> None:
        self._require(seal is _SEAL)

    @property
    def clearance_min(self) -> float:
        """Return the certified lower bound of the clearance [m]."""
        return self.report.clearance_min

    def trajectory(self, n_steps: int | None = None) -> Trajectory:
        """Return samples of the motion, at 100 Hz or finer by default."""
        return self.motion.trajectory(n_steps)

    def show(self) -> None:
        """Show the motion in a notebook, or else in a browser; see `comove.show`."""
        comove.show(self)

    def _repr_html_(self) -> str:
        return comove.as_html(self)


class Check(Protocol):
    """A further check of a motion; it returns reasons against it."""

    def __call__(self, motion: CoordinatedMotion) -> Sequence[str]:
        """Return the reasons against `motion`."""


@dataclass(frozen=True)
class CheckOfVerified:
    """A further check of a verified motion, which it need not repeat.

    Attributes
    ----------
    check : function of a `VerifiedMotion`, or of the motion itself where it violates its scene, that returns the
        reasons against it
    """

    check: Callable[[CoordinatedMotion | VerifiedMotion], Sequence[str]]

    def __call__(self, motion: CoordinatedMotion) -> Sequence[str]:
        """Return the reasons against `motion`."""
        return self.check(motion)


@dataclass(frozen=True)
class Verdict:
    """The verification result of a motion.

    Attributes
    ----------
    verified : the verified motion, or None
    report : the measures
    reasons : why it was rejected, in words
    """

    verified: VerifiedMotion | None
    report: Report
    reasons: tuple[str, ...]

    def checked(self, motion: CoordinatedMotion, checks: Sequence[Check]) -> Verdict:
        """Return the result after further checks of the same motion."""
        reasons = list(self.reasons)
        for check in checks:
            if self.verified is not None and isinstance(check, CheckOfVerified):
                told = check.check(self.verified)
            else:
                told = check(motion)
            reasons.extend([told] if isinstance(told, str) else told)
        return Verdict(None if reasons else self.verified, self.report, tuple(reasons))


def verify(motion: CoordinatedMotion, checks: Sequence[Check] = ()) -> Verdict:
    """Verify a motion in continuous time: ends, constraints, limits and clearance.

    Parameters
    ----------
    motion
        The candidate, on its scene.
    checks
        Further checks, a robot's for example.
    """
    if not isinstance(motion, CoordinatedMotion):
        raise OptionError(
            f"the motion is {type(motion).__name__}",
            way_out="give a CoordinatedMotion, such as `solution.attempt`; a VerifiedMotion has passed already",
        )
    scene, duration = motion.scene, motion.scene.duration
    nodes = motion.nodes_at_knots
    position, velocity, acceleration = nodes[:, :, : len(scene.manipulators)]
    ends = np.abs(position[[0, -1], :, : scene.n_dims] - np.stack([scene.start, scene.goal]))
    bounds = node_bounds(motion)
    clearance = certify(motion, bounds)
    start_speed, step = _from_rest(scene, velocity / duration, acceleration / duration**2)
    jerk_max = None
    if np.isfinite(scene.jerk_limit):  # a step of the acceleration is an infinite jerk
        jerk_max = largest_jerk(motion, bounds.jerk) if step == 0.0 else np.inf
    findings = examine(MotionCourse(motion, bounds, position), scene.constraints, scene.manipulators)
    report = Report(
        clearance_min=clearance.lower,
        end_error=float(ends.max()),
        end_speed=float(lengths(velocity[-1]).max() / duration),
        speed_max=largest_speed(motion, velocity, bounds.jerk),
        acceleration_max=largest_acceleration(motion, acceleration, bounds.jerk, scene.acceleration_limit),
        jerk_max=jerk_max,
        **{"distance_error_max": 0.0, **measures(findings)},
        **support_measures(scene, nodes[0], clearance.lower),
    )
    reasons = []
    if not _are_of_the_scene(motion):
        reasons.append("the motion's coordinates are not those of the scene")
    if not np.isfinite(motion.knots).all():
        reasons.append("the motion is not finite")
    if not report.end_error <= END_ERROR:
        reasons.append(f"an end is missed by {report.end_error:.3g} m")
    reasons += [finding.reason for finding in findings if finding.reason]
    if not start_speed <= END_SPEED:
        reasons.append(f"a hand moves at {start_speed:.3g} m/s at the start already, before which it rests")
    if jerk_max is not None and step > 0.0:
        reasons.append(
            f"a hand's acceleration jumps by {step:.3g} m/s^2 at the start or the end, where it rests"
        )
    reasons += broken_limits(report, scene, END_SPEED)
    if not clearance.lower >= scene.clearance:
        reasons.append(_contact(motion, clearance))
    verified = None if reasons else VerifiedMotion(motion, report, seal=_SEAL)
    return Verdict(verified, report, tuple(reasons)).checked(motion, checks)


def support_measures(scene: Scene, nodes: Array, lower: float, time: Array | None = None) -> dict[str, Any]:
    """Return a `Report`'s measures of supports. They are empty without a resting contact.

    Parameters
    ----------
    nodes : array, shape (n_knots, n_nodes, 3), the body at the knots [m]
    lower : certified lower bound of the clearance from supports that recede [m]
    time : array, shape (n_knots,), times of the knots, evenly spaced over the duration unless given [s]
    """
    if not scene.rests:
        return {}
    time = np.linspace(0.0, scene.duration, len(nodes)) if time is None else time
    least = min(rest.distance for rest in scene.rests) - TOLERANCE + min(0.0, lower - scene.clearance)
    found: dict[str, Any] = {"support_distance_min": least}
    travel = np.linalg.norm(np.diff(nodes, axis=0), axis=-1).max(axis=1)
    step = np.maximum(np.append(travel, 0.0), np.append(0.0, travel))
    for rest in scene.rests:
        near = np.flatnonzero(rest.displacement(nodes) <= rest.reach(scene.clearance) + step)
        if not len(near):
            continue
        if rest.end == "start":
            last = float(time[min(int(near[-1]) + 1, len(time) - 1)])
            found["support_left"] = max(last, found.get("support_left", 0.0))
        else:
            first = float(time[max(int(near[0]) - 1, 0)])
            found["support_met"] = min(first, found.get("support_met", np.inf))
    return found


def _from_rest(scene: Scene, velocity: Array, acceleration: Array) -> tuple[float, float]:
    """Return the start's largest speed [m/s] and acceleration steps at ends [m/s^2].

    Before the start and after the end the end effectors rest, unless the scene continues another movement; steps that
    are rounding are 0.

    Parameters
    ----------
    velocity, acceleration : arrays, shape (n_knots, n_manipulators, 3), at the knots
    """
    in_motion = scene.begins > 0 or any(group.start_twist.any() for group in scene.groups)
    sizes = lengths(acceleration)
    step = float(sizes[-1:].max() if in_motion else sizes[[0, -1]].max())
    rounding = END_STEP * max(1.0, float(sizes.max()))
    speed = 0.0 if in_motion else float(lengths(velocity[0]).max())
    return speed, 0.0 if step <= rounding else step


def broken_limits(
    report: Report, scene: Scene, end_speed: float, *, up_to: str = "up to ", rounding: float = 0.0
) -> list[str]:
    """Return messages of the end effectors' broken limits.

    Parameters
    ----------
    end_speed : largest speed that counts as rest [m/s]
    up_to : words before bounds, in contrast to measured values
    rounding : by which a share of a limit may exceed 1
    """
    reasons, share = [], 1 + rounding
    if not report.end_speed <= end_speed:
        reasons.append(f"a hand still moves at {report.end_speed:.3g} m/s at the end")
    if not report.speed_max <= scene.speed_limit * share:
        limit = f"(limit {scene.speed_limit:g} m/s)"
        reasons.append(f"a hand moves at {up_to}{report.speed_max:.4g} m/s {limit}")
    if not report.acceleration_max <= scene.acceleration_limit * share:
        limit = f"(limit {scene.acceleration_limit:g} m/s^2)"
        reasons.append(f"a hand accelerates by {up_to}{report.acceleration_max:.4g} m/s^2 {limit}")
    if report.jerk_max is not None and not report.jerk_max <= scene.jerk_limit * share:
        limit = f"(limit {scene.jerk_limit:g} m/s^3)"
        most = (
            f"reaches {up_to}{report.jerk_max:.4g} m/s^3" if np.isfinite(report.jerk_max) else "has no bound"
        )
        reasons.append(f"a hand's jerk {most} {limit}")
    return reasons


def _are_of_the_scene(motion: CoordinatedMotion) -> bool:
    """Return whether the motion's coordinates are the scene's of that name."""
    try:
        return motion.coordinates.same_as(coordinates_for(motion.scene, motion.coordinates.kind))
    except OptionError:  # the scene has none of that name
        return False


def _contact(motion: CoordinatedMotion, clearance: Clearance) -> str:
    scene = motion.scene
    what = scene.name_of(clearance.nearest)
    when = f"at {clearance.time:.2f} s"
    if clearance.upper < 0:
        return f"the load or a hand reaches {-clearance.upper:.3g} m or more into {what} {when}"
    if clearance.upper == 0:  # a surface has no depth
        return f"the load or a hand touches {what} {when}"
    if clearance.upper < scene.clearance:
        return f"only {clearance.upper:.3g} m from {what} {when} (clearance {scene.clearance:g} m asked for)"
    return (
        f"the clearance of {clearance.upper:.3g} m from {what} {when} could not be certified to be at least "
        f"{scene.clearance:g} m"
    )
