r"""Distributions of movements: probabilistic movement primitives (Paraschos et al., 2013, 2018).

On comove's basis a movement is linear in its parameters: start, start velocity, goal and goal velocity in unit
duration, and the shape weights, for every coordinate of every end effector,

    y(s) = psi(s) theta,   psi = [B(s)  Phi(s)],   theta ~ N(mean, covariance).

So a distribution of movements is a Gaussian over these parameters, and everything else follows in closed form: the
mean and covariance at each instant, conditioning on via-points and velocities, samples, likelihoods. The ends are
parameters themselves, so that samples between given ends meet them exactly.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array, Integers
from comove.brief import brief
from comove.dmp.alignment import NEVER, Alignment, aligned, one_recording, require_spread, together
from comove.dmp.arguments import (
    instants,
    is_number,
    numbers,
    require_count,
    require_positive,
    require_steps,
    vector,
)
from comove.dmp.basis import MAX_BASIS, MotionBasis, motion_basis
from comove.dmp.dmp import DMP, FAR, Recording
from comove.dmp.estimation import (
    N_ENDS,
    USUAL,
    EstimationSettings,
    checked_contexts,
    estimate,
    features,
    fitted_parameters,
    notes_of,
    solver,
    widening,
    without_noise,
)
from comove.dmp.limits import ViaPoint
from comove.dmp.system import ExponentialPhase, Phase
from comove.errors import ComoveWarning, DemonstrationError, OptionError, near_name

Recordings = Sequence[Recording | Mapping[str, Recording]]

N_SEEN = 2  # instants for every parameter of a coordinate, at which the covariance is estimated
MET = 1e-6  # by which exact conditions may be missed, as a share of the movement's extent
ROUNDING = 1e-14  # relative eigenvalue of the covariance that counts as none
EXACT = 1e-13  # relative eigenvalue of what is conditioned on, below which it counts as fixed


@dataclass(frozen=True, eq=False)
class ProMP:
    """A distribution of movements, Gaussian in their parameters.

    Coordinates follow one another, manipulator by manipulator. The parameters of a coordinate are start, start
    velocity, goal and goal velocity in unit duration, then the shape weights.

    Attributes
    ----------
    mean_parameters : array, shape (n_columns, 4 + n_basis), n_columns = n_manipulators * n_dims
    covariance : array, shape (n_parameters, n_parameters), n_parameters = n_columns * (4 + n_basis)
    noise : array, shape (n_columns,), standard deviation of the observation noise [m]
    duration, duration_std : mean and standard deviation of the recordings' durations [s]
    phase : canonical system
    manipulators : their names; () for one without a name
    slopes : array, shape (n_context, n_columns, 4 + n_basis), change of the mean parameters with the context
    context_mean, context_std : arrays, shape (n_context,), of the recordings
    n_recordings : number of recordings from which it was learned; 0 if it was made otherwise
    notes : how it was learned
    """

    __repr__ = brief

    mean_parameters: Array
    covariance: Array
    noise: Array
    duration: float
    duration_std: float = 0.0
    phase: Phase = ExponentialPhase()
    manipulators: tuple[str, ...] = ()
    slopes: Array = field(default_factory=lambda: np.zeros(0))
    context_mean: Array = field(default_factory=lambda: np.zeros(0))
    context_std: Array = field(default_factory=lambda: np.zeros(0))
    n_recordings: int = 0
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        require_positive("duration", self.duration, of="seconds")
        if not is_number(self.duration_std) or self.duration_std < 0:
            raise OptionError(f"duration_std = {self.duration_std!r}", way_out="give 0 s or more")
        mean = numbers(self.mean_parameters)
        if mean.ndim != 2 or not N_ENDS < mean.shape[1] <= N_ENDS + MAX_BASIS:
            raise OptionError(
                f"mean_parameters of shape {mean.shape}", way_out="give (n_columns, 4 + n_basis) numbers"
            )
        n_context = np.size(self.context_mean)
        shapes = {
            "mean_parameters": mean.shape,
            "covariance": (mean.size, mean.size),
            "noise": (len(mean),),
            "slopes": (n_context, *mean.shape),
            "context_mean": (n_context,),
            "context_std": (n_context,),
        }
        for name, shape in shapes.items():
            array = numbers(getattr(self, name))
            array = array.reshape(shape) if name == "slopes" and not array.size else array
            if array.shape != shape or not np.isfinite(array).all():
                raise OptionError(f"{name} of shape {array.shape}", way_out=f"give {shape} finite numbers")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if len(mean) % max(len(self.manipulators), 1):
            raise OptionError(
                f"{len(mean)} coordinates of {len(self.manipulators)} manipulators",
                way_out="give each the same number",
            )
        spread = np.abs(self.covariance).max(initial=0.0)
        if (
            np.abs(self.covariance - self.covariance.T).max() > 1e-9 * spread
            or self._eigen[0].min() < -1e-9 * spread
        ):
            raise OptionError("the covariance is not symmetric and positive", way_out="learn it anew")

    @classmethod
    def fit(
        cls,
        demonstrations: Recordings,
        *,
        n_basis: int = 20,
        phase: Phase | None = None,
        alignment: Alignment | str = Alignment.DURATION,
        contexts: ArrayLike | None = None,
        settings: EstimationSettings = USUAL,
    ) -> ProMP:
        """Estimate a distribution from several recordings of one movement.

        Each recording is fitted by least squares; mean and covariance are those of the fits. The covariance of
        different instants is tapered over a length of time, under which recordings that are left out in turn are most
        likely. Variances, and covariances between coordinates and end effectors at one instant, are those of the
        recordings, widened because recordings are few (`estimation.widening`).

        Parameters
        ----------
        demonstrations
            Two or more recordings; where several manipulators were recorded together, each a mapping by their names.
        n_basis
            Number of shape weights per coordinate; the four boundary values are counted apart.
        phase
            Canonical system; an exponential one by default.
        alignment
            How recordings are aligned in time: `duration`, at equal shares of their durations, or `warping`.
        contexts
            Task parameters of every recording, shape (n_recordings, n_context); the mean is linear in them.
        settings
            How the spread is estimated from few recordings, and how they are warped.

        Raises
        ------
        DemonstrationError
            If there are fewer than two recordings, they do not belong together, or they do not differ.
        OptionError
            If an option is out of range.

        Warns
        -----
        ComoveWarning
            If the recordings are so few that the taper cannot be chosen by leaving one out, or one has fewer samples
            than a coordinate has weights, or its fit is off by more than a twentieth of the movement's extent in a
            coordinate; names the distance and a remedy.
        """
        require_count("n_basis", n_basis, most=MAX_BASIS)
        phase = ExponentialPhase() if phase is None else phase
        if not isinstance(phase, Phase):
            raise OptionError(f"phase = {phase!r}", way_out="give LinearPhase() or ExponentialPhase()")
        names, times, positions = together(demonstrations)
        require_spread(times, positions)
        given = checked_contexts(contexts, len(times))
        way = Alignment.named(alignment)
        shares = aligned(times, positions, way, settings.warping)
        basis = motion_basis(n_basis, phase=phase)
        found = [fitted_parameters(basis, s, y) for s, y in zip(shares, positions, strict=True)]
        parameters = np.stack([theta for theta, _ in found])
        n_columns, n_features = parameters.shape[1:]
        extent = max(float(np.ptp(y, axis=0).max()) for y in positions)
        _tell_far_fit(basis, shares, positions, FAR * extent)
        noise = np.sqrt(np.mean([error**2 for _, error in found], axis=0) + (settings.noise * extent) ** 2)
        n_seen = N_SEEN * n_features
        even = np.linspace(0.0, 1.0, n_seen)
        values = (parameters @ features(basis, even)[0].T).reshape(len(parameters), -1)
        centre = given.mean(axis=0)
        gaussian = estimate(values, given - centre, np.repeat(noise, n_seen), n_columns, settings)
        back = np.kron(np.eye(n_columns), solver(basis, even))
        durations = np.array([time[-1] - time[0] for time in times])
        notes = notes_of(durations, way, gaussian, widening(len(times), given.shape[1]))
        fewest = min(map(len, times))
        if fewest < n_features:
            notes += (
                "a recording has fewer samples than a coordinate has weights: the smoothest fit was taken",
            )
            warnings.warn(
                f"a recording has {fewest} samples for {n_features} weights and boundary values of a coordinate: the "
                "smoothest fit is taken",
                ComoveWarning,
                stacklevel=2,
            )
        if not gaussian.chosen:
            warnings.warn(
                f"{len(times)} recordings tell too little of how instants hang together: their correlations are "
                f"tapered over {gaussian.length:g} of the duration; record more",
                ComoveWarning,
                stacklevel=2,
            )
        return cls(
            (back @ gaussian.mean).reshape(n_columns, n_features),
            without_noise(back @ gaussian.covariance @ back.T, NEVER * extent),
            noise,
            float(durations.mean()),
            float(durations.std(ddof=1)),
            phase,
            names,
            (gaussian.slopes @ back.T).reshape(-1, n_columns, n_features),
            centre,
            given.std(axis=0),
            len(times),
            notes,
        )

    @property
    def n_columns(self) -> int:
        """Return the number of coordinates of all manipulators."""
        return len(self.mean_parameters)

    @property
    def n_dims(self) -> int:
        """Return the number of coordinates of one manipulator."""
        return self.n_columns // max(len(self.manipulators), 1)

    @property
    def n_basis(self) -> int:
        """Return the number of shape weights of a coordinate."""
        return self.mean_parameters.shape[1] - N_ENDS

    @property
    def basis(self) -> MotionBasis:
        """Return the basis matrices of the movements."""
        return motion_basis(self.n_basis, phase=self.phase)

    @property
    def mean(self) -> DMP:
        """Return the mean movement, a primitive of all coordinates."""
        return self._movement(self.mean_parameters)

    @property
    def movements(self) -> tuple[DMP, ...]:
        """Return the mean movement of every manipulator."""
        return self.split(self.mean)

    def split(self, movement: DMP) -> tuple[DMP, ...]:
        """Return the manipulators' movements from one of all coordinates."""
        firsts = range(0, self.n_columns, self.n_dims)
        return tuple(movement.part(slice(first, first + self.n_dims)) for first in firsts)

    def mean_at(self, time: ArrayLike) -> Array:
        """Return mean positions [m] at times [s]; shape (n_steps, n_columns)."""
        return self._psi(time)[0] @ self.mean_parameters.T

    def covariance_at(self, time: ArrayLike, *, of_velocity: bool = False) -> Array:
        """Return the covariance of positions or velocities at times [s].

        Returns
        -------
        array, shape (n_steps, n_columns, n_columns), [m^2], or [m^2/s^2]
        """
        psi = self._psi(time)[int(of_velocity)]
        blocks = self.covariance.reshape(*self.mean_parameters.shape, *self.mean_parameters.shape)
        left = np.tensordot(psi, blocks, axes=(1, 1))  # (n_steps, n_columns, n_columns, n_features)
        return np.einsum("tcdg,tg->tcd", left, psi)

    def std_at(self, time: ArrayLike) -> Array:
        """Return standard deviations of positions [m]; shape (n_steps, n_columns)."""
        variance = np.diagonal(self.covariance_at(time), axis1=1, axis2=2)
        return np.sqrt(np.maximum(variance, 0.0))

    def sample(self, rng: np.random.Generator) -> DMP:
        """Draw a movement of all coordinates, with its own ends. Its duration is the mean."""
        return self._movement(self._drawn(rng, 1)[0])

    def sample_trajectories(self, rng: np.random.Generator, n_samples: int, n_steps: int = 201) -> Array:
        """Draw movements and play them at even times.

        Returns
        -------
        array, shape (n_samples, n_steps, n_columns), [m]
        """
        require_count("n_samples", n_samples)
        require_steps(n_steps)
        psi = features(self.basis, np.linspace(0.0, 1.0, n_steps))[0]
        return np.swapaxes(self._drawn(rng, n_samples) @ psi.T, 1, 2)

    def condition(
        self,
        *via: ViaPoint,
        position_covariance: ArrayLike = 0.0,
        velocity_covariance: ArrayLike = 0.0,
        manipulator: str | None = None,
        far: float = 5.0,
    ) -> ProMP:
        """Return the distribution of the movements that pass via-points.

        Parameters
        ----------
        via
            Points of one manipulator, or of all coordinates; the others follow by their correlation.
        position_covariance, velocity_covariance
            Uncertainty of the points: a variance, variances of the coordinates, or a covariance matrix, [m^2] and
            [m^2/s^2]; 0 for points that are passed exactly.
        manipulator
            Name of the one whose points are given; all coordinates unless given.
        far
            Standard deviations from the mean beyond which a point is warned of.

        Raises
        ------
        OptionError
            If an argument is out of range, or a point lies where no movement of the distribution passes.

        Warns
        -----
        ComoveWarning
            If a point is more than `far` standard deviations from the mean; names the distance.
        """
        from scipy.linalg import block_diag  # slow to import

        if not via:
            raise OptionError("there is no via-point", way_out="give ViaPoint(time, position)")
        columns = self._columns_of(manipulator)
        rows, targets, noises = [], [], []
        for point in via:
            row, target = self._via_rows(point, columns)
            noise = covariance_of("position_covariance", position_covariance, len(columns))
            if point.velocity is not None:
                of_velocity = covariance_of("velocity_covariance", velocity_covariance, len(columns))
                noise = block_diag(noise, of_velocity)
            self._tell_far(point, row, target, noise, far)
            rows.append(row)
            targets.append(target)
            noises.append(noise)
        return self._conditioned(np.concatenate(rows), np.concatenate(targets), block_diag(*noises))

    def towards(
        self,
        *,
        start: ArrayLike | None = None,
        goal: ArrayLike | None = None,
        start_velocity: ArrayLike | None = None,
        goal_velocity: ArrayLike | None = None,
        duration: float | None = None,
    ) -> ProMP:
        """Return the distribution between given ends, met by every sample.

        Parameters
        ----------
        start, goal, start_velocity, goal_velocity : arrays, shape (n_columns,), [m], [m/s]; free if not given
        duration : [s]

        Raises
        ------
        OptionError
            If an argument is out of range, or the recordings never vary there and end elsewhere.
        """
        timed = self if duration is None else replace(self, duration=duration)
        ends = {
            "start": start,
            "start_velocity": start_velocity,
            "goal": goal,
            "goal_velocity": goal_velocity,
        }
        mean, of_column = self.mean_parameters, np.arange(self.n_columns) * self.mean_parameters.shape[1]
        places, targets = [], []
        for k, (name, value) in enumerate(ends.items()):
            if value is not None:
                places.append(of_column + k)
                unit = timed.duration if name.endswith("velocity") else 1.0
                targets.append(vector(name, value, self.n_columns) * unit)
        if not places:
            return timed
        at, values = np.concatenate(places), np.concatenate(targets)
        bound = timed._conditioned(np.eye(mean.size)[at], values, np.zeros((len(at), len(at))))
        parameters, covariance = bound.mean_parameters.copy(), bound.covariance.copy()
        parameters.reshape(-1)[at] = values
        covariance[at], covariance[:, at] = 0.0, 0.0
        return replace(bound, mean_parameters=parameters, covariance=covariance)

    def at_context(self, context: ArrayLike, far: float = 5.0) -> ProMP:
        """Return the distribution for task parameters, shape (n_context,).

        Raises
        ------
        OptionError
            If the number of task parameters is another.

        Warns
        -----
        ComoveWarning
            If they are more than `far` standard deviations from those of the recordings.
        """
        if not len(self.context_mean):
            raise OptionError("the distribution depends on no context", way_out="fit it with contexts=")
        away = vector("context", context, len(self.context_mean)) - self.context_mean
        distance = float(np.max(np.abs(away) / np.where(self.context_std > 0, self.context_std, 1.0)))
        if distance > far:
            warnings.warn(
                f"the context {context!r} is {distance:.3g} standard deviations from those of the recordings",
                ComoveWarning,
                stacklevel=2,
            )
        none = np.zeros(0)
        return replace(
            self,
            mean_parameters=self.mean_parameters + np.tensordot(away, self.slopes, axes=1),
            slopes=none,
            context_mean=none,
            context_std=none,
        )

    def log_likelihood(self, demonstration: Recording | Mapping[str, Recording]) -> float:
        """Return the log density of a recording's samples, observed with noise.

        Raises
        ------
        DemonstrationError
            If the recording is of other manipulators or dimensions.
        """
        names, time, position, _ = one_recording(demonstration, 0)
        if names != self.manipulators or position.shape[1] != self.n_columns:
            raise DemonstrationError(
                f"the recording has {position.shape[1]} coordinates of {', '.join(names) or 'one hand'}",
                way_out=f"give {self.n_columns} of {', '.join(self.manipulators) or 'one hand'}",
            )
        psi = features(self.basis, (time - time[0]) / (time[-1] - time[0]))[0]
        away = ((position - psi @ self.mean_parameters.T) / self.noise).T.ravel()
        # In the space of the parameters: |I + L' H' R^-1 H L| has their number of rows, not that of the samples.
        factor = self._factor.reshape(*self.mean_parameters.shape, -1)
        seen = np.einsum("tf,cfk->ctk", psi, factor / self.noise[:, None, None])
        seen = seen.reshape(-1, seen.shape[2])
        root = np.linalg.cholesky(np.eye(seen.shape[1]) + seen.T @ seen)
        short = np.linalg.solve(root, seen.T @ away)
        log_scale = np.log(np.diag(root)).sum() + len(time) * np.log(self.noise).sum()
        return float(-0.5 * (away @ away - short @ short + len(away) * np.log(2 * np.pi)) - log_scale)

    @cached_property
    def _eigen(self) -> tuple[Array, Array]:
        values, vectors = np.linalg.eigh(0.5 * (self.covariance + self.covariance.T))
        return values, vectors

    @cached_property
    def _factor(self) -> Array:
        """Return L with ``L L' = covariance``; coordinates without variance have zero rows."""
        values, vectors = self._eigen
        values = np.where(
            values > ROUNDING * values[-1], values, 0.0
        )  # roots of rounding errors would be seen
        factor = vectors * np.sqrt(np.maximum(values, 0.0))
        return np.where(np.diag(self.covariance)[:, None] > 0.0, factor, 0.0)

    def _drawn(self, rng: np.random.Generator, n: int) -> Array:
        if not isinstance(rng, np.random.Generator):
            raise OptionError(f"rng = {rng!r}", way_out="give numpy.random.default_rng(seed)")
        drawn = rng.standard_normal((n, self._factor.shape[1])) @ self._factor.T
        return self.mean_parameters + drawn.reshape(n, *self.mean_parameters.shape)

    def _movement(self, parameters: Array) -> DMP:
        start, start_velocity, goal, goal_velocity = parameters[:, :N_ENDS].T
        return DMP(
            weights=parameters[:, N_ENDS:],
            start=start,
            goal=goal,
            start_velocity=start_velocity / self.duration,
            goal_velocity=goal_velocity / self.duration,
            duration=self.duration,
            phase=self.phase,
        )

    def _psi(self, time: ArrayLike) -> Array:
        """Return features of positions and velocities [1/s]; (2, n_steps, n_features)."""
        psi = features(self.basis, instants(time) / self.duration)[:2]
        return np.stack([psi[0], psi[1] / self.duration])

    def index_of(self, manipulator: str) -> int:
        """Return the place of a manipulator among all of them."""
        if manipulator not in self.manipulators:
            raise OptionError(
                f"there is no manipulator {manipulator!r}",
                key="manipulator",
                way_out=near_name(str(manipulator), self.manipulators)
                if self.manipulators
                else "leave it out",
            )
        return self.manipulators.index(manipulator)

    def _columns_of(self, manipulator: str | None) -> Integers:
        if manipulator is None:
            return np.arange(self.n_columns)
        first = self.index_of(manipulator) * self.n_dims
        return np.arange(first, first + self.n_dims)

    def _via_rows(self, point: ViaPoint, columns: Integers) -> tuple[Array, Array]:
        """Return the rows of parameters that a via-point fixes, and values."""
        if not isinstance(point, ViaPoint):
            raise OptionError(f"via = {point!r}", way_out="give ViaPoint(time, position)")
        if not is_number(point.time) or not 0 <= point.time <= self.duration:
            raise OptionError(
                f"a via-point at {point.time!r} s", way_out=f"give a time from 0 to {self.duration:.6g} s"
            )
        psi = self._psi([point.time])[:, 0]
        rows, targets = [], []
        for order, value in enumerate((point.position, point.velocity)):
            if value is None:
                continue
            what = f"the {('position', 'velocity')[order]} of a via-point"
            target = vector(what, value, len(columns))
            row = np.zeros((len(columns), *self.mean_parameters.shape))
            row[np.arange(len(columns)), columns] = psi[order]
            rows.append(row.reshape(len(columns), -1))
            targets.append(target)
        return np.concatenate(rows), np.concatenate(targets)

    def _tell_far(self, point: ViaPoint, rows: Array, target: Array, noise: Array, far: float) -> None:
        away = target - rows @ self.mean_parameters.ravel()
        distance = np.sqrt(away @ _pseudo_inverse(rows @ self.covariance @ rows.T + noise) @ away)
        if distance > far:
            off = np.linalg.norm(away[: np.size(point.position)])
            warnings.warn(
                f"the via-point at {point.time:g} s is {distance:.3g} standard deviations from what was taught, "
                f"{off:.3g} m from the mean there: the movement is bent far beyond the recordings",
                ComoveWarning,
                stacklevel=3,
            )

    def _conditioned(self, rows: Array, target: Array, noise: Array) -> ProMP:
        """Return the distribution given ``rows theta = target`` up to Gaussian noise."""
        seen = self._factor.T @ rows.T  # (rank, n)
        away = target - rows @ self.mean_parameters.ravel()
        inverse = _pseudo_inverse(seen.T @ seen + noise)
        gain = self._factor @ (seen @ inverse)
        parameters = self.mean_parameters.ravel() + gain @ away
        if not noise.any():
            extent = max(float(np.ptp(self.mean_at(np.linspace(0, self.duration, 51)), axis=0).max()), 1e-300)
            missed = np.abs(rows @ parameters - target).max()
            if missed > MET * extent:
                raise OptionError(
                    f"no movement of the distribution passes there: it is missed by {missed:.3g} m, where the "
                    "recordings do not vary",
                    way_out="give the point an uncertainty, or record movements that pass there",
                )
        # The symmetric form that stays positive: (I - K H) S (I - K H)' + K R K'.
        left = self._factor - gain @ seen.T
        covariance = left @ left.T + gain @ noise @ gain.T
        return replace(
            self,
            mean_parameters=parameters.reshape(self.mean_parameters.shape),
            covariance=0.5 * (covariance + covariance.T),
        )


def _tell_far_fit(basis: MotionBasis, shares: list[Array], positions: list[Array], allowed: float) -> None:
    """Warn of the worst fit, with a better number of weights."""

    def off(basis: MotionBasis) -> Array:
        fits = [
            features(basis, s)[0] @ (solver(basis, s) @ y) for s, y in zip(shares, positions, strict=True)
        ]
        return np.array([np.abs(fit - y).max() for fit, y in zip(fits, positions, strict=True)])

    found, n_basis, way_out = off(basis), basis.n_basis, "smooth the recordings, or cut them into parts"
    worst = int(np.argmax(found))
    if found[worst] <= allowed:
        return
    while n_basis < MAX_BASIS:
        n_basis = min(2 * n_basis, MAX_BASIS)
        if off(motion_basis(n_basis, phase=basis.phase)).max() < allowed:
            way_out = f"give n_basis={n_basis}"
            break
    warnings.warn(
        f"the fit of recording {worst} is off by up to {found[worst]:.2g} in a coordinate, "
        f"{FAR * found[worst] / allowed:.0%} of the movement's extent: {way_out}",
        ComoveWarning,
        stacklevel=3,
    )


def covariance_of(name: str, value: ArrayLike, n: int) -> Array:
    """Return a covariance, shape (n, n), from variances or a matrix. Errors name the argument."""
    array = numbers(value)
    if array.ndim == 0:
        array = np.full(n, float(array))
    if array.shape == (n,):
        array = np.diag(array)
    good = array.shape == (n, n) and np.isfinite(array).all() and np.allclose(array, array.T)
    if not good or np.linalg.eigvalsh(array).min() < -1e-12 * np.abs(array).max():
        raise OptionError(
            f"{name} = {value!r}", way_out=f"give a variance, {n} of them, or a covariance matrix"
        )
    return array


def _pseudo_inverse(matrix: Array) -> Array:
    values, vectors = np.linalg.eigh(matrix)
    kept = values > EXACT * max(float(values[-1]), 1e-300)
    return (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
