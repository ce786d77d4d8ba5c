"""Operations on movements: blend, sequence, mirror, rotate, scale, retime, reverse.

All are pure functions and exact up to rounding, unless they say otherwise. Rollouts to mirrored, rotated and scaled
goals equal the mirrored, rotated and scaled rollouts of the original movement. Only the classic variant, which scales
along the axes, cannot be rotated; the result has the closed-form variant and is the same movement as long as the ends
stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array
from comove.dmp.arguments import is_number, numbers, require_positive, require_steps, vector
from comove.dmp.averaging import mixed
from comove.dmp.basis import MAX_BASIS
from comove.dmp.dmp import DMP, VECTORS, require_positions
from comove.dmp.estimation import USUAL, solver, taper
from comove.dmp.probabilistic import N_SEEN, ProMP
from comove.dmp.system import N_INTERVALS, Phase
from comove.dmp.variants import Variant
from comove.errors import OptionError
from comove.trajectory import Trajectory

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

AXES = "xyz"
PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
N_FIT = N_INTERVALS + 1  # instants at which a movement is compared with its refit: the knots

PRECISION_FLOOR = 1e-6  # of the mean variance, added to all: what never varies has a finite precision


def mirror(dmp: DMP, normal: str | int | ArrayLike, *, about: ArrayLike | None = None) -> DMP:
    """Mirror the movement in a line or a plane. The line is for planar movements, the plane for spatial ones.

    Parameters
    ----------
    normal : direction perpendicular to the mirror: "x", "y" or "z", or the number of a coordinate, whose sign is
        changed, or a vector, shape (n_dims,)
    about : a point of the mirror, shape (n_dims,); by default the start, or the centre of a rhythmic movement
    """
    require_positions(dmp)
    if isinstance(normal, str) and normal in tuple(AXES[: dmp.n_dims]):
        normal = AXES.index(normal)
    if isinstance(normal, (int, np.integer)) and not isinstance(normal, bool) and 0 <= normal < dmp.n_dims:
        normal = np.eye(dmp.n_dims)[normal]
    n = vector("normal", normal, dmp.n_dims)
    length = np.linalg.norm(n)
    if not length > 0:
        raise OptionError("the mirror's normal is zero", way_out="give a direction")
    n = n / length
    return _mapped(dmp, np.eye(dmp.n_dims) - 2.0 * np.outer(n, n), about)


def rotate(dmp: DMP, rotation: float | Rotation | ArrayLike, *, about: ArrayLike | None = None) -> DMP:
    """Rotate the movement about a point.

    Parameters
    ----------
    rotation : an angle [rad], counter-clockwise, for a planar movement; scipy's `Rotation` for a spatial one; or a
        rotation matrix, shape (n_dims, n_dims)
    about : fixed point, shape (n_dims,); by default the start, or the centre of a rhythmic movement
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
    """Scale the movement in size; its duration stays.

    Parameters
    ----------
    factor : positive number
    about : fixed point, shape (n_dims,); by default the start, or the centre of a rhythmic movement
    """
    require_positive("factor", factor)
    return _mapped(dmp, factor * np.eye(dmp.n_dims), about)


def retime(dmp: DMP, duration: float) -> DMP:
    """Return the movement on the same path with another duration [s]."""
    return dmp.towards(duration=duration)


def reverse(dmp: DMP, *, n_basis: int | None = None) -> DMP:
    """Reverse the movement, from its goal to its start.

    The ends and their velocities are exact. Between them the damped system cannot be run backwards, so the shape is
    fitted again. With twice as many weights, the default, the handwriting of the LASA set is reproduced within 2e-4
    of its extent, with the variant dmp++ within 2e-3.

    Parameters
    ----------
    n_basis : number of shape weights per dimension, at most 200
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
    time = np.linspace(0.0, dmp.duration, N_FIT)
    return backwards.shaped(time, dmp.at(time[::-1]).position)


def blend(a: DMP, b: DMP, share: float) -> DMP:
    """Blend two movements as ``(1 - share) a + share b``. They are sampled at equal shares of their durations.

    Ends, end velocities in units of duration, weights and durations are interpolated. Movements with different
    variants, phases or numbers of weights are first converted: b gets the variant and phase of a, and both the larger
    number of weights; this conversion is a fit and not exact.

    Parameters
    ----------
    share : share of b; 0 gives a, 1 gives b, and values outside this range exaggerate the difference
    """
    require_positions(a)
    require_positions(b)
    if a.n_dims != b.n_dims:
        raise OptionError(
            f"movements in {a.n_dims} and {b.n_dims} dimensions cannot be blended",
            way_out="give both the same",
        )
    if (a.variant is Variant.RHYTHMIC) != (b.variant is Variant.RHYTHMIC):
        raise OptionError(
            "a rhythmic movement and one that ends cannot be blended", way_out="give two of a kind"
        )
    if not is_number(share):
        raise OptionError(f"share = {share!r}", way_out="give a number, from 0 to 1 for movements in between")
    a, b = settled(a), settled(b)
    if (a.variant, a.phase, a.weights.shape) != (b.variant, b.phase, b.weights.shape):
        count = max(a.weights.shape[1], b.weights.shape[1])
        a, b = (refitted(dmp, n_basis=count, phase=a.phase, variant=a.variant) for dmp in (a, b))
    duration = (1 - share) * a.duration + share * b.duration
    if not duration > 0:
        raise OptionError(
            f"share = {share!r} makes a duration of {duration:.4g} s", way_out="give one nearer to 0 to 1"
        )
    return mixed((a, b), np.array([1 - share, share]))


@dataclass(frozen=True, eq=False)
class MovementSequence:
    """Movements that follow one another, or overlap. Position and velocity are continuous.

    Attributes
    ----------
    parts : the movements, each shifted to start at the end of the one before
    begins : starting time of each movement [s]
    """

    parts: tuple[DMP, ...]
    begins: tuple[float, ...]

    @property
    def n_dims(self) -> int:
        """Return the number of coordinates."""
        return self.parts[0].n_dims

    @property
    def duration(self) -> float:
        """Return the duration [s]."""
        return self.begins[-1] + self.parts[-1].duration

    def at(self, time: ArrayLike) -> Trajectory:
        """Return positions and velocities at times [s], shape (n_steps,)."""
        time = np.asarray(time, dtype=float)
        position, velocity = np.zeros((2, len(time), self.n_dims))
        for part, begin in zip(self.parts, self.begins, strict=True):
            first, last = part is self.parts[0], part is self.parts[-1]
            played = part.at(time - begin if last else np.minimum(time - begin, part.duration))
            begun = first | (time >= begin)
            moving = begun & (last | (time < begin + part.duration))
            # Each adds its displacement so far; the first one counts from the origin, the others from their start.
            position += np.where(begun[:, None], played.position - (0.0 if first else part.start), 0.0)
            velocity += np.where(moving[:, None], played.velocity, 0.0)
        return Trajectory(time, position, velocity)

    def rollout(self, *, n_steps: int = 201) -> Trajectory:
        """Play the movements at even times."""
        require_steps(n_steps)
        return self.at(np.linspace(0.0, self.duration, n_steps))

    def fitted(self, *, n_basis: int | None = None, phase: Phase | None = None) -> DMP:
        """Fit one primitive to the whole sequence. Both ends and their velocities are exact.

        Parameters
        ----------
        n_basis : number of shape weights per dimension; by default the sum over all movements, at most 200
        phase : canonical system; by default the first movement's
        """
        first, last = self.parts[0], self.parts[-1]
        count = n_basis or min(MAX_BASIS, sum(part.weights.shape[1] for part in self.parts))
        whole = DMP(
            weights=np.zeros((self.n_dims, count)),
            start=first.start,
            goal=last.goal,
            start_velocity=first.start_velocity,
            goal_velocity=last.goal_velocity,
            duration=self.duration,
            phase=phase or first.phase,
        )
        played = self.rollout(n_steps=N_FIT)
        return whole.shaped(played.time, played.position)


def sequence(*movements: DMP, overlap: float = 0.0) -> MovementSequence:
    """Put movements one after the other.

    Each movement is shifted, without rotation, to start at the end of the one before, with its end velocity: give
    that one a `towards(goal_velocity=...)` to pass the joint without stopping. With an overlap, each begins before
    the one before has ended, and both add up, which rounds the joints.

    Parameters
    ----------
    movements : one or more, all of the same dimension
    overlap : time by which each movement begins earlier [s]; at most half of the shortest movement

    Raises
    ------
    OptionError
        If the movements do not fit together, or overlap and one of them ends in motion.
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
    return MovementSequence(tuple(parts), tuple(begins))


def settled(dmp: DMP) -> DMP:
    """Return the same movement with the variant's scaling applied to its weights."""
    displacement = dmp.goal - dmp.start
    if dmp.variant is Variant.CLASSIC:
        return replace(dmp, weights=dmp.shape_weights, learned=displacement, variant=Variant.CLOSED_FORM)
    if np.array_equal(dmp.learned, displacement):
        return dmp
    return replace(dmp, weights=dmp.shape_weights, learned=displacement)


def refitted(
    dmp: DMP, *, n_basis: int | None = None, phase: Phase | None = None, variant: Variant | str | None = None
) -> DMP:
    """Fit the movement in another basis by least squares. Both ends and their velocities are exact.

    Parameters
    ----------
    n_basis, phase, variant : properties of the new basis; by default the movement's own
    """
    wanted = replace(
        dmp,
        weights=np.zeros((dmp.n_dims, n_basis or dmp.weights.shape[1])),
        phase=phase or dmp.phase,
        variant=dmp.variant if variant is None else Variant.named(variant),
        learned=dmp.goal - dmp.start,
    )
    if (wanted.variant is Variant.RHYTHMIC) != (dmp.variant is Variant.RHYTHMIC):
        raise OptionError("a rhythmic movement is none that ends", way_out="keep its variant")
    if wanted.variant is Variant.CLASSIC:
        wanted = replace(wanted, variant=Variant.CLOSED_FORM)
    played = dmp.rollout(n_steps=N_FIT)
    return wanted.shaped(played.time, played.position)


def in_space(dmp: DMP, plane: str) -> DMP:
    """Place a planar movement in a coordinate plane of space: "xy", "xz" or "yz"."""
    if plane not in PLANES or dmp.n_dims != 2:
        raise OptionError(
            f"plane = {plane!r} for a movement in {dmp.n_dims} dimensions",
            way_out="give xy, xz or yz for a planar movement",
        )
    laid = np.eye(3)[:, list(PLANES[plane])]
    if dmp.variant is Variant.DMP_PLUS_PLUS:
        dmp = settled(dmp)  # half a turn is about another axis there
    return replace(dmp, **{name: laid @ getattr(dmp, name) for name in ("weights", *VECTORS)})


def _mapped(dmp: DMP, matrix: Array, about: ArrayLike | None) -> DMP:
    """Map the movement by ``y -> about + M (y - about)``. M is a rotation or reflection times a scale."""
    require_positions(dmp)
    along_axes = (np.abs(matrix) > 1e-15).sum(axis=1).max() == 1
    if dmp.variant is Variant.CLASSIC and not along_axes:
        dmp = settled(dmp)
    fixed = dmp.goal if dmp.variant is Variant.RHYTHMIC else dmp.start
    fixed = fixed if about is None else vector("about", about, dmp.n_dims)
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


def _require_ending(dmp: DMP, doing: str) -> None:
    require_positions(dmp)
    if dmp.variant is Variant.RHYTHMIC:
        raise OptionError(
            f"a rhythmic movement never ends and cannot be {doing}", way_out="give one that ends"
        )


def coactivated(
    promps: Sequence[ProMP], activations: ArrayLike, *, length: float = USUAL.usual_length
) -> ProMP:
    """Return the product of distributions at every instant (Paraschos et al., 2018).

    Each is raised to its activation, from 0 (it has no part) to 1.

    Parameters
    ----------
    promps : distributions of the same manipulators and dimension; the result has the first one's basis and duration
    activations : array, shape (n_promps,), or (n_promps, n_steps) at even shares of the duration; from 0 to 1
    length : length over which instants of the result correlate [durations]; a product at each instant does not
        determine it

    Raises
    ------
    OptionError
        If the distributions do not fit together, or the activations are out of range.
    """
    if not isinstance(promps, (list, tuple)) or not promps or not all(isinstance(p, ProMP) for p in promps):
        raise OptionError(f"promps = {promps!r}", way_out="give a list of ProMPs")
    first = promps[0]
    if any((p.n_columns, p.manipulators) != (first.n_columns, first.manipulators) for p in promps):
        raise OptionError(
            "the distributions are of other manipulators", way_out="give distributions of one kind"
        )
    given = numbers(activations)
    given = given[:, None] if given.ndim == 1 else given
    if given.ndim != 2 or len(given) != len(promps) or not ((given >= 0) & (given <= 1)).all():
        raise OptionError(
            f"activations of shape {given.shape}", way_out=f"give {len(promps)} rows of numbers from 0 to 1"
        )
    if not given.any(axis=0).all():
        raise OptionError(
            "no distribution is active at some instants", way_out="give one an activation above 0"
        )
    n_steps = N_SEEN * first.mean_parameters.shape[1]
    s = np.linspace(0.0, 1.0, n_steps)
    active = np.stack([np.interp(s, np.linspace(0.0, 1.0, len(row)), row) for row in given])
    mean, covariance = _product(promps, active, s)
    values, vectors = np.linalg.eigh(covariance)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    # C(s, s') = root(s) k(s, s') root(s')': positive, and the product itself at every instant.
    whole = np.einsum("tce,st,sde->ctds", root, taper(n_steps, 1, length), root).reshape(mean.size, mean.size)
    back = np.kron(np.eye(first.n_columns), solver(first.basis, s))
    none = np.zeros(0)
    return replace(
        first,
        mean_parameters=(back @ mean.T.ravel()).reshape(first.mean_parameters.shape),
        covariance=back @ whole @ back.T,
        slopes=none,
        context_mean=none,
        context_std=none,
        n_recordings=0,
        notes=(f"{len(promps)} distributions that act at once",),
    )


def _product(promps: Sequence[ProMP], active: Array, s: Array) -> tuple[Array, Array]:
    """Return mean and covariance of the product of Gaussians at every instant."""
    n_columns = promps[0].n_columns
    information, drawn = np.zeros((len(s), n_columns, n_columns)), np.zeros((len(s), n_columns))
    for promp, activation in zip(promps, active, strict=True):
        time = s * promp.duration
        own = promp.covariance_at(time)
        least = PRECISION_FLOOR * max(float(np.trace(own, axis1=1, axis2=2).mean()) / n_columns, 1e-300)
        precision = activation[:, None, None] * np.linalg.inv(own + least * np.eye(n_columns))
        information += precision
        drawn += (precision @ promp.mean_at(time)[:, :, None])[:, :, 0]
    covariance: Array = np.asarray(np.linalg.inv(information), dtype=np.float64)
    return (covariance @ drawn[:, :, None])[:, :, 0], 0.5 * (covariance + np.swapaxes(covariance, 1, 2))
