"""Movements made of movements: blended, in sequence, mirrored, turned, scaled, retimed and reversed.

All are pure functions and exact, to rounding, unless they say otherwise. Mirrored, turned and scaled movements go to
mirrored, turned and scaled goals as the rollouts of the movement itself do. Only the classic variant, which scales
along the axes, cannot be turned; it comes out in closed form, the same movement as long as the ends stay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comove.errors import OptionError
from comove.primitives.arguments import is_number, numbers, require_steps, vector
from comove.primitives.basis import MotionBasis
from comove.primitives.dmp import DMP
from comove.primitives.phase import Phase
from comove.primitives.rhythm import RhythmicBasis
from comove.primitives.variants import Variant
from comove.trajectory import Trajectory

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

AXES = "xyz"
PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
N_FIT = 801  # instants at which a movement is compared with its refit
MAX_BASIS = 200


def mirror(dmp: DMP, normal: str | int | ArrayLike, *, about: ArrayLike | None = None) -> DMP:
    """The movement mirrored in a line (in the plane) or a plane (in space).

    Parameters
    ----------
    normal : what the mirror is perpendicular to: "x", "y" or "z" or a coordinate's number, whose sign is changed,
        or a vector, shape (n_dims,)
    about : a point of the mirror, shape (n_dims,); the start, or the centre of a rhythmic movement, unless given
    """
    if isinstance(normal, str) and normal in tuple(AXES[: dmp.n_dims]):
        normal = AXES.index(normal)
    if isinstance(normal, (int, np.integer)) and not isinstance(normal, bool) and 0 <= normal < dmp.n_dims:
        normal = np.eye(dmp.n_dims)[normal]
    n = _vector("normal", normal, dmp)
    length = np.linalg.norm(n)
    if not length > 0:
        raise OptionError("the mirror's normal is zero", way_out="give a direction")
    n = n / length
    return _mapped(dmp, np.eye(dmp.n_dims) - 2.0 * np.outer(n, n), about)


def rotate(dmp: DMP, rotation: float | Rotation | ArrayLike, *, about: ArrayLike | None = None) -> DMP:
    """The movement turned about a point.

    Parameters
    ----------
    rotation : of a planar movement an angle [rad], counter-clockwise; of a spatial one scipy's `Rotation`; of any a
        matrix, shape (n_dims, n_dims)
    about : shape (n_dims,); the start, or the centre of a rhythmic movement, unless given
    """
    way_out = "give an angle [rad] in the plane, scipy's Rotation in space, or a rotation matrix"
    if hasattr(rotation, "as_matrix"):
        rotation = rotation.as_matrix()
    matrix = numbers(rotation)
    if matrix.ndim == 0 and dmp.n_dims == 2 and np.isfinite(matrix):
        c, s = np.cos(matrix), np.sin(matrix)
        matrix = np.array([[c, -s], [s, c]])
    if matrix.shape != (dmp.n_dims, dmp.n_dims) or not np.isfinite(matrix).all():
        raise OptionError(
            f"rotation = {rotation!r} of a movement in {dmp.n_dims} dimensions", way_out=way_out
        )
    if np.abs(matrix @ matrix.T - np.eye(dmp.n_dims)).max() > 1e-9 or np.linalg.det(matrix) < 0:
        raise OptionError(f"rotation = {rotation!r} is no rotation", way_out=way_out)
    return _mapped(dmp, matrix, about)


def scale(dmp: DMP, factor: float, *, about: ArrayLike | None = None) -> DMP:
    """The movement made larger or smaller, in the same time.

    Parameters
    ----------
    factor : positive; mirror a movement to turn it round
    about : the point that stays, shape (n_dims,); the start, or the centre of a rhythmic movement, unless given
    """
    if not is_number(factor) or not 0 < factor < np.inf:
        raise OptionError(f"factor = {factor!r}", way_out="give a positive number")
    return _mapped(dmp, factor * np.eye(dmp.n_dims), about)


def retime(dmp: DMP, duration: float) -> DMP:
    """The movement in another duration [s], on the same path; of a rhythmic one, with another period."""
    return dmp.towards(duration=duration)


def reversed(dmp: DMP, *, n_basis: int | None = None) -> DMP:
    """The movement backwards, from its goal to its start.

    The ends and their velocities are exact. Between them the system that brakes cannot be run backwards, so the shape
    is refitted: with twice as many weights, as unless given, the handwriting of the LASA set is met within 2e-4 of
    its extent, by dmp++ within 2e-3.

    Parameters
    ----------
    n_basis : shape weights a dimension, at most 200
    """
    _require_ending(dmp, "reversed")
    backwards = DMP(
        weights=np.zeros((dmp.n_dims, n_basis or min(MAX_BASIS, 2 * dmp.weights.shape[1]))),
        start=dmp.goal,
        goal=dmp.start,
        start_velocity=-dmp.goal_velocity,
        goal_velocity=-dmp.start_velocity,
        duration=dmp.duration,
        phase=dmp.phase,
        variant=Variant.CLOSED_FORM if dmp.variant is Variant.CLASSIC else dmp.variant,
    )
    return _fitted(backwards, dmp.at(np.linspace(dmp.duration, 0.0, N_FIT)).position)


def blend(a: DMP, b: DMP, share: float) -> DMP:
    """The movement between two: at equal shares of the durations it is ``(1 - share) a + share b``.

    Ends, end velocities in units of duration, weights and durations are interpolated. Movements of different
    variants, phases or numbers of weights are first brought to common ones, b to those of a and both to the larger
    number of weights; that alone is not exact, but a fit.

    Parameters
    ----------
    share : of b; 0 is a, 1 is b, and beyond them the difference is exaggerated
    """
    _require_positions(a), _require_positions(b)
    if a.n_dims != b.n_dims:
        raise OptionError(
            f"movements in {a.n_dims} and {b.n_dims} dimensions cannot be blended",
            way_out="give both the same",
        )
    if (a.variant is Variant.RHYTHMIC) != (b.variant is Variant.RHYTHMIC):
        raise OptionError(
            "a rhythmic movement and one that ends cannot be blended", way_out="give two of a kind"
        )
    if not is_number(share) or not np.isfinite(share):
        raise OptionError(f"share = {share!r}", way_out="give a number, from 0 to 1 for movements in between")
    a, b = settled(a), settled(b)
    if (a.variant, a.phase, a.weights.shape) != (b.variant, b.phase, b.weights.shape):
        count = max(a.weights.shape[1], b.weights.shape[1])
        a, b = (refitted(dmp, n_basis=count, phase=a.phase, variant=a.variant) for dmp in (a, b))
    mix = {name: (1 - share) * getattr(a, name) + share * getattr(b, name) for name in _LINEAR}
    if not mix["duration"] > 0:
        raise OptionError(
            f"share = {share!r} makes a duration of {mix['duration']:.4g} s",
            way_out="give one nearer to 0 to 1",
        )
    for name in ("start_velocity", "goal_velocity"):
        paces = [(1 - share) * a.duration * getattr(a, name), share * b.duration * getattr(b, name)]
        mix[name] = (paces[0] + paces[1]) / mix["duration"]
    return replace(a, **mix)


@dataclass(frozen=True, eq=False)
class Sequence:
    """Movements one after the other, or overlapping; position and velocity are continuous.

    Attributes
    ----------
    parts : the movements, each carried to where the one before it ends
    begins : when each begins [s]
    """

    parts: tuple[DMP, ...]
    begins: tuple[float, ...]

    @property
    def n_dims(self) -> int:
        """Number of coordinates."""
        return self.parts[0].n_dims

    @property
    def duration(self) -> float:
        """[s]"""
        return self.begins[-1] + self.parts[-1].duration

    @property
    def start(self) -> Array:
        """Where the first movement begins, shape (n_dims,), [m]."""
        return self.parts[0].start

    @property
    def goal(self) -> Array:
        """Where the last movement ends, shape (n_dims,), [m]."""
        return self.parts[-1].goal

    @property
    def joints(self) -> Array:
        """Where each movement hands over to the next, array, shape (n_parts - 1, n_dims), [m]."""
        return np.array([part.goal for part in self.parts[:-1]]).reshape(-1, self.n_dims)

    def at(self, time: ArrayLike) -> Trajectory:
        """Positions and velocities at any times [s], array of shape (n_steps,)."""
        time = np.asarray(time, dtype=float)
        position, velocity = np.zeros((2, len(time), self.n_dims))
        for part, begin in zip(self.parts, self.begins, strict=True):
            first, last = part is self.parts[0], part is self.parts[-1]
            played = part.at(time - begin if last else np.minimum(time - begin, part.duration))
            begun = first | (time >= begin)
            moving = begun & (last | (time < begin + part.duration))
            # Each adds the way that it has gone; the first one begins at its start, the others at nothing.
            position += np.where(begun[:, None], played.position - (0.0 if first else part.start), 0.0)
            velocity += np.where(moving[:, None], played.velocity, 0.0)
        return Trajectory(time, position, velocity)

    def rollout(self, *, n_steps: int = 201) -> Trajectory:
        """Play the movements at even times."""
        require_steps(n_steps)
        return self.at(np.linspace(0.0, self.duration, n_steps))

    def fitted(self, *, n_basis: int | None = None, phase: Phase | None = None) -> DMP:
        """One primitive that comes near to the whole sequence; both ends and their velocities are exact.

        Parameters
        ----------
        n_basis : shape weights a dimension; as many as all movements have together, at most 200, unless given
        phase : canonical system; the first movement's unless given
        """
        first, last = self.parts[0], self.parts[-1]
        count = n_basis or min(MAX_BASIS, sum(part.weights.shape[1] for part in self.parts))
        whole = DMP(
            weights=np.zeros((self.n_dims, count)),
            start=self.start,
            goal=self.goal,
            start_velocity=first.start_velocity,
            goal_velocity=last.goal_velocity,
            duration=self.duration,
            phase=phase or first.phase,
        )
        return _fitted(whole, self.rollout(n_steps=N_FIT).position)


def sequence(*movements: DMP, overlap: float = 0.0) -> Sequence:
    """Play movements one after the other.

    Each is carried, without turning, to where the one before it ends, and starts with the velocity with which that
    ends: give the former a `towards(goal_velocity=...)` to pass without stopping. With an overlap each begins before
    the one before it has ended, and both add up: the joints are rounded off.

    Parameters
    ----------
    movements : two or more, of one dimension
    overlap : by which each movement begins earlier [s]; less than half of any movement

    Raises
    ------
    OptionError
        If the movements do not fit together, or one with an overlap ends in motion.
    """
    if not movements:
        raise OptionError("there is no movement", way_out="give two or more")
    for dmp in movements:
        _require_ending(dmp, "put in sequence")
        if dmp.n_dims != movements[0].n_dims:
            raise OptionError(
                "the movements differ in their dimensions", way_out="give movements of one dimension"
            )
    shortest = min(dmp.duration for dmp in movements)
    if not is_number(overlap) or not 0 <= overlap <= shortest / 2:
        raise OptionError(
            f"overlap = {overlap!r} s", way_out=f"give 0 to {shortest / 2:.4g} s, half of the shortest"
        )
    parts, begins = [movements[0]], [0.0]
    for dmp in movements[1:]:
        before = parts[-1]
        if overlap > 0 and before.goal_velocity.any():
            raise OptionError(
                "a movement that ends in motion cannot overlap the next", way_out="leave the overlap out"
            )
        shifted = dmp.towards(start=before.goal, goal=before.goal + (dmp.goal - dmp.start))
        parts.append(replace(shifted, start_velocity=before.goal_velocity))
        begins.append(begins[-1] + before.duration - overlap)
    return Sequence(tuple(parts), tuple(begins))


def settled(dmp: DMP) -> DMP:
    """The same movement with weights that hold for its present ends: what the variant made of them is worked in."""
    displacement = dmp.goal - dmp.start
    if dmp.variant is Variant.CLASSIC:
        return replace(dmp, weights=dmp.shape_weights, learned=displacement, variant=Variant.CLOSED_FORM)
    if np.array_equal(dmp.learned, displacement):
        return dmp
    return replace(dmp, weights=dmp.shape_weights, learned=displacement)


def refitted(
    dmp: DMP, *, n_basis: int | None = None, phase: Phase | None = None, variant: Variant | str | None = None
) -> DMP:
    """The movement in another basis: both ends and their velocities exact, the shape by least squares.

    Parameters
    ----------
    n_basis, phase, variant : of the new basis; as they are unless given
    """
    wanted = replace(
        dmp,
        weights=np.zeros((dmp.n_dims, n_basis or dmp.weights.shape[1])),
        phase=phase or dmp.phase,
        variant=dmp.variant if variant is None else variant,
        learned=dmp.goal - dmp.start,
    )
    if (wanted.variant is Variant.RHYTHMIC) != (dmp.variant is Variant.RHYTHMIC):
        raise OptionError("a rhythmic movement is none that ends", way_out="keep its variant")
    if wanted.variant is Variant.CLASSIC:
        wanted = replace(wanted, variant=Variant.CLOSED_FORM)
    return _fitted(wanted, dmp.rollout(n_steps=N_FIT).position)


def in_space(dmp: DMP, plane: str) -> DMP:
    """A planar movement laid into a plane of space: "xy", "xz" or "yz"."""
    if plane not in PLANES or dmp.n_dims != 2:
        raise OptionError(
            f"plane = {plane!r} for a movement in {dmp.n_dims} dimensions",
            way_out="give xy, xz or yz for a planar movement",
        )
    laid = np.eye(3)[:, list(PLANES[plane])]
    if dmp.variant is Variant.DMP_PLUS_PLUS:
        dmp = settled(dmp)  # half a turn is about another axis there
    names = ("weights", "start", "goal", "start_velocity", "goal_velocity", "learned")
    return replace(dmp, **{name: laid @ getattr(dmp, name) for name in names})


_LINEAR = ("weights", "start", "goal", "learned", "duration")


def _mapped(dmp: DMP, matrix: Array, about: ArrayLike | None) -> DMP:
    """The movement under ``y -> about + M (y - about)`` with M a rotation or reflection times a scale."""
    _require_positions(dmp)
    along_axes = (np.abs(matrix) > 1e-15).sum(axis=1).max() == 1
    if dmp.variant is Variant.CLASSIC and not along_axes:
        dmp = settled(dmp)
    fixed = dmp.goal if dmp.variant is Variant.RHYTHMIC else dmp.start
    fixed = fixed if about is None else _vector("about", about, dmp)
    vectors = ("weights", "start_velocity", "goal_velocity", "learned")
    mapped = replace(
        dmp,
        start=fixed + matrix @ (dmp.start - fixed),
        goal=fixed + matrix @ (dmp.goal - fixed),
        **{name: matrix @ getattr(dmp, name) for name in vectors},
    )
    right = matrix @ dmp.shape_weights
    missed = np.abs(mapped.shape_weights - right).max()
    if missed > 1e-9 * np.abs(right).max():  # half a turn of what was learned: its axis is not turned along
        mapped = replace(mapped, weights=right, learned=mapped.goal - mapped.start)
    return mapped


def _fitted(dmp: DMP, position: Array) -> DMP:
    """The weights with which the movement passes nearest to positions at `N_FIT` even times."""
    of_boundary, of_position = _solver(dmp.basis)
    return replace(dmp, weights=(of_position @ (position - of_boundary @ dmp.boundary_values())).T)


@lru_cache(maxsize=16)
def _solver(basis: MotionBasis | RhythmicBasis) -> tuple[Array, Array]:
    """What the boundary values cause, and the pseudo-inverse of what the weights do, at `N_FIT` even times."""
    boundary, shape = basis.at(np.linspace(0.0, 1.0, N_FIT))
    return boundary[0], np.linalg.pinv(shape[0])


def _require_positions(dmp: DMP) -> None:
    if not isinstance(dmp, DMP):
        raise OptionError(
            f"a {type(dmp).__name__} is no DMP of positions", way_out="give a DMP, such as pose.translation"
        )


def _require_ending(dmp: DMP, doing: str) -> None:
    _require_positions(dmp)
    if dmp.variant is Variant.RHYTHMIC:
        raise OptionError(
            f"a rhythmic movement never ends and cannot be {doing}", way_out="give one that ends"
        )


def _vector(name: str, value: object, dmp: DMP) -> Array:
    _require_positions(dmp)
    return vector(name, value, dmp.n_dims)
