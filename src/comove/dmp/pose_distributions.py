r"""Distributions of pose movements, Gaussian in the mean orientation's tangent space.

Every end effector's orientation is written as a rotation vector relative to the mean orientation of its recordings,
``R = exp(r) R_ref``, as movements of poses have it. Positions and rotation vectors of all end effectors together are
then coordinates of one `ProMP`: its properties hold for poses, with the correlation of translation and rotation and
of the end effectors, and each sampled movement is a `PoseDMP` for every end effector.

Rotation vectors tell orientations apart up to half a turn from the mean; recordings that turn farther are refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array
from comove.dmp.alignment import Alignment
from comove.dmp.arguments import numbers
from comove.dmp.demonstrations.samples import RecordedSamples
from comove.dmp.dmp import DMP
from comove.dmp.estimation import USUAL, EstimationSettings
from comove.dmp.limits import ViaPoint
from comove.dmp.poses import UNIT, Pose, PoseDMP, PoseRecording
from comove.dmp.probabilistic import ProMP, covariance_of
from comove.dmp.system import Phase
from comove.errors import DemonstrationError, OptionError
from comove.geometry import rotations
from comove.trajectory import PoseTrajectory

N_COLUMNS = 6  # of a hand: position and rotation vector
MOST_TURN = 0.9 * np.pi  # rad, from the mean orientation


PoseRecordings = Sequence[PoseRecording | Mapping[str, PoseRecording]]


@dataclass(frozen=True, eq=False)
class PoseProMP:
    """A distribution of pose movements of one or several manipulators.

    Attributes
    ----------
    promp : distribution of the coordinates: of every end effector the position [m], then the rotation vector [rad]
    references : the orientation at which rotation vectors are zero, shape (4,), w x y z, of every end effector
    """

    promp: ProMP
    references: tuple[Array, ...]

    def __post_init__(self) -> None:
        n_hands = max(len(self.promp.manipulators), 1)
        if self.promp.n_columns != N_COLUMNS * n_hands or len(self.references) != n_hands:
            raise OptionError(
                f"{self.promp.n_columns} coordinates and {len(self.references)} orientations of {n_hands} hands",
                way_out="give each hand six coordinates, and an orientation at which it does not turn",
            )
        unit = [numbers(reference) for reference in self.references]
        if not all(q.shape == (4,) and abs(np.linalg.norm(q) - 1.0) <= 1e-9 for q in unit):
            raise OptionError("an orientation is no unit quaternion", way_out="give w, x, y, z of norm 1")
        object.__setattr__(self, "references", tuple(unit))

    @classmethod
    def fit(
        cls,
        demonstrations: PoseRecordings,
        *,
        n_basis: int = 20,
        phase: Phase | None = None,
        alignment: Alignment | str = Alignment.DURATION,
        contexts: ArrayLike | None = None,
        settings: EstimationSettings = USUAL,
    ) -> PoseProMP:
        """Estimate a distribution from recordings with orientations, as `ProMP.fit`.

        Parameters
        ----------
        demonstrations
            Two or more recordings in space; where several manipulators were recorded together, each a mapping by
            their names. Signs of quaternions do not matter.
        n_basis, phase, alignment, contexts, settings
            As for `ProMP.fit`.

        Raises
        ------
        DemonstrationError
            As `ProMP.fit`, or if a recording has no orientations, is planar, or turns by nearly half a turn away from
            the mean orientation.
        """
        each = [_by_hand(demonstration, i) for i, demonstration in enumerate(demonstrations)]
        names = tuple(each[0]) if each else ()
        for i, hands in enumerate(each):
            if tuple(hands) != names:
                raise DemonstrationError(
                    f"recording {i} is of {', '.join(hands)}, recording 0 of {', '.join(names)}",
                    way_out="give recordings of one kind",
                )
        references = tuple(_mean_orientation([hands[name] for hands in each]) for name in names)
        flat = [_flat(hands, references, i) for i, hands in enumerate(each)]
        promp = ProMP.fit(
            flat, n_basis=n_basis, phase=phase, alignment=alignment, contexts=contexts, settings=settings
        )
        return cls(promp, references)

    @property
    def manipulators(self) -> tuple[str, ...]:
        """Return the names of the manipulators; () for one without a name."""
        return self.promp.manipulators

    @property
    def duration(self) -> float:
        """Return the mean duration of the recordings [s]."""
        return self.promp.duration

    @property
    def notes(self) -> tuple[str, ...]:
        """Return in words how it was learned."""
        return self.promp.notes

    @property
    def movements(self) -> tuple[PoseDMP, ...]:
        """Return the mean movement of every manipulator."""
        return self._split(self.promp.mean)

    @property
    def positions(self) -> ProMP:
        """Return the distribution of the positions alone."""
        promp, n_features = self.promp, self.promp.mean_parameters.shape[1]
        columns = np.flatnonzero(np.arange(promp.n_columns) % N_COLUMNS < 3)
        kept = (columns[:, None] * n_features + np.arange(n_features)).ravel()
        return replace(
            promp,
            mean_parameters=promp.mean_parameters[columns],
            covariance=promp.covariance[np.ix_(kept, kept)],
            noise=promp.noise[columns],
            slopes=promp.slopes[:, columns],
        )

    def mean_at(self, time: ArrayLike) -> tuple[PoseTrajectory, ...]:
        """Return every manipulator's mean poses at times [s], shape (n_steps,)."""
        return tuple(movement.at(time) for movement in self.movements)

    def covariance_at(self, time: ArrayLike) -> Array:
        """Return the covariance of positions and rotation vectors at times [s].

        Returns
        -------
        array, shape (n_steps, 6 n_manipulators, 6 n_manipulators), [m^2], [m rad] and [rad^2]
        """
        return self.promp.covariance_at(time)

    def sample(self, rng: np.random.Generator) -> tuple[PoseDMP, ...]:
        """Draw movements of all manipulators together, with ends of their own."""
        return self._split(self.promp.sample(rng))

    def condition(
        self,
        time: float,
        pose: Pose,
        *,
        position_covariance: ArrayLike = 0.0,
        rotation_covariance: ArrayLike = 0.0,
        manipulator: str | None = None,
    ) -> PoseProMP:
        """Return the distribution given an end effector's pose at a time. The others follow by their correlation.

        Parameters
        ----------
        time : [s]
        pose : pose in space
        position_covariance : uncertainty of the position, as for `ProMP.condition` [m^2]
        rotation_covariance : uncertainty of the orientation: a variance, three about the world's axes, or a matrix
            [rad^2]
        manipulator : name of the end effector, where there are several
        """
        index = self._index(manipulator)
        target = self._coordinates(pose, index)
        known = np.zeros((N_COLUMNS, N_COLUMNS))
        known[:3, :3] = covariance_of("position_covariance", position_covariance, 3)
        back = np.stack([rotations.rates_of(target[3:], unit) for unit in np.eye(3)], axis=1)
        known[3:, 3:] = back @ covariance_of("rotation_covariance", rotation_covariance, 3) @ back.T
        known = 0.5 * (known + known.T)
        via = ViaPoint(time, target)
        return replace(
            self, promp=self.promp.condition(via, position_covariance=known, manipulator=manipulator)
        )

    def towards(
        self,
        *,
        start: Pose | Mapping[str, Pose] | None = None,
        goal: Pose | Mapping[str, Pose] | None = None,
        duration: float | None = None,
    ) -> PoseProMP:
        """Return the distribution between given poses, met by every sample.

        Parameters
        ----------
        start, goal : pose of the end effector, or poses of all by name
        duration : [s]
        """
        ends: dict[str, Any] = {}
        for name, end in (("start", start), ("goal", goal)):
            if end is not None:
                ends[name] = self._end(name, end)
        return replace(self, promp=self.promp.towards(duration=duration, **ends))

    def log_likelihood(self, demonstration: PoseRecording | Mapping[str, PoseRecording]) -> float:
        """Return the log density of a recording's samples. They are positions [m] and rotation vectors [rad].

        Raises
        ------
        DemonstrationError
            If the recording is of other manipulators.
        """
        hands = _by_hand(demonstration, 0)
        if tuple(hands) != (self.manipulators or ("",)):
            raise DemonstrationError(
                f"the recording is of {', '.join(hands) or 'one hand'}",
                way_out=f"give {', '.join(self.manipulators) or 'one hand'}",
            )
        return self.promp.log_likelihood(_flat(hands, self.references, 0))

    def _split(self, movement: DMP) -> tuple[PoseDMP, ...]:
        return tuple(
            PoseDMP(whole.part(slice(3)), whole.part(slice(3, None)), reference)
            for whole, reference in zip(self.promp.split(movement), self.references, strict=True)
        )

    def _index(self, manipulator: str | None) -> int:
        if manipulator is None and len(self.references) > 1:
            raise OptionError(
                "whose pose it is, is not said",
                key="manipulator",
                way_out=f"name one of {', '.join(self.manipulators)}",
            )
        return 0 if manipulator is None else self.promp.index_of(manipulator)

    def _coordinates(self, pose: Pose, index: int) -> Array:
        """Return an end effector's position and rotation vector; shape (6,)."""
        if not isinstance(pose, Pose) or len(pose.position) != 3:
            raise OptionError(f"pose = {pose!r}", way_out="give a Pose in space")
        turn = rotations.turn_between(pose.orientation, self.references[index])
        return np.concatenate([pose.position, turn])

    def _end(self, name: str, end: Pose | Mapping[str, Pose]) -> Array:
        """Return all coordinates at an end; array, shape (6 n_manipulators,)."""
        names = self.manipulators or ("",)
        poses = end if isinstance(end, Mapping) else {names[0]: end}
        if set(poses) != set(names):
            raise OptionError(
                f"the {name} is given for {', '.join(map(str, poses)) or 'one hand'}",
                way_out=f"give a pose for each of {', '.join(names)}",
            )
        return np.concatenate([self._coordinates(poses[hand], i) for i, hand in enumerate(names)])


def _by_hand(demonstration: object, number: int) -> dict[str, Any]:
    """Return a recording's parts by manipulator, checked for spatial orientations."""
    parts: Mapping[str, Any] = demonstration if isinstance(demonstration, Mapping) else {"": demonstration}
    for name, part in parts.items():
        who = f"recording {number}" + (f", {name!r}," if name else "")
        if not hasattr(part, "position"):
            raise OptionError(
                f"{who} is {type(part).__name__}", way_out="give Demonstrations with orientations"
            )
        if getattr(part, "orientation", None) is None:
            raise DemonstrationError(
                f"{who} holds no orientations", way_out="record them, or fit a ProMP to the positions"
            )
        if np.ndim(part.position) != 2 or np.shape(part.position)[1] != 3:
            raise DemonstrationError(f"{who} is none in space", way_out="give positions x, y, z")
        norms = np.linalg.norm(np.atleast_2d(numbers(part.orientation)), axis=-1)
        if np.shape(part.orientation) != (len(part.position), 4) or not np.all(np.abs(norms - 1.0) <= UNIT):
            raise DemonstrationError(
                f"{who} has an orientation that is none",
                key="orientation",
                way_out="give a unit quaternion each",
            )
    return {str(name): part for name, part in parts.items()}


def _mean_orientation(recordings: Sequence[Any]) -> Array:
    """Return recordings' mean orientation, shape (4,), by Markley (2007). It has the least squared chords."""
    from scipy.spatial.transform import Rotation

    quaternions = np.concatenate([numbers(recording.orientation) for recording in recordings])
    shares = [np.abs(np.gradient(numbers(r.time)) / (r.time[-1] - r.time[0])) for r in recordings]
    seen = Rotation.from_quat(quaternions, scalar_first=True)
    mean = seen.mean(np.concatenate(shares)).as_quat(scalar_first=True)
    first = mean[np.flatnonzero(np.abs(mean) > 1e-9)[0]]
    return np.asarray(mean * np.sign(first), dtype=np.float64)


def _flat(hands: Mapping[str, Any], references: Sequence[Array], number: int) -> Any:
    """Return a recording in coordinates relative to the references. It is one, or a mapping by manipulator."""
    from scipy.spatial.transform import Rotation

    flat: dict[str, RecordedSamples] = {}
    for (name, part), reference in zip(hands.items(), references, strict=True):
        relative = rotations.quaternion_product(numbers(part.orientation), rotations.conjugate(reference))
        vectors = Rotation.from_quat(relative, scalar_first=True).as_rotvec()
        angle = np.linalg.norm(vectors, axis=1)
        if angle.max(initial=0.0) > MOST_TURN:
            raise DemonstrationError(
                f"recording {number} turns by {angle.max():.3g} rad away from the mean orientation",
                key="orientation",
                way_out=f"cut the recordings, so that each part stays within {MOST_TURN:.3g} rad",
            )
        position = np.concatenate([numbers(part.position), vectors], axis=1)
        flat[name] = RecordedSamples(numbers(part.time), position, unit=getattr(part, "unit", "m"))
    return flat[""] if set(flat) == {""} else flat
