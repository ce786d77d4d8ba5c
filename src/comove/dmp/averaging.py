"""Several demonstrations of one movement: their mean and their spread.

Every demonstration is fitted separately. Phase and basis are common, so the mean of the weights and ends is the
mean of the movements at equal phases, and the deviations from it span movements that people would regard as the
same movement (a probabilistic movement primitive in the DMP's own weights; Li et al., 2023).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.dmp.alignment import together
from comove.dmp.dmp import DMP, Recording
from comove.dmp.system import Phase
from comove.dmp.variants import Variant
from comove.errors import DemonstrationError, OptionError


@dataclass(frozen=True, eq=False)
class AveragedDMP:
    """The mean of several movements, with its members.

    Attributes
    ----------
    mean : the mean movement; its duration is the mean of their durations
    members : the movements, as they were fitted
    """

    mean: DMP
    members: tuple[DMP, ...]

    def __post_init__(self) -> None:
        bases = [(dmp.weights.shape, dmp.variant, dmp.phase) for dmp in (self.mean, *self.members)]
        if len(bases) < 3 or any(basis != bases[0] for basis in bases):
            raise OptionError(
                "the members are one, or of several bases", way_out="give two or more of the mean's basis"
            )

    @property
    def duration(self) -> float:
        """Return the duration of the mean movement [s]."""
        return self.mean.duration

    def spread(self, n_steps: int = 201) -> Array:
        """Return the members' standard deviation at even phases.

        Returns
        -------
        array, shape (n_steps, n_dims), [m]
        """
        s = np.linspace(0.0, 1.0, n_steps)
        positions = np.stack([member.at(s * member.duration).position for member in self.members])
        return positions.std(axis=0, ddof=1)

    def sample(self, rng: np.random.Generator) -> DMP:
        """Draw a movement from the Gaussian that the members span; ends and duration vary with the shape."""
        share = rng.standard_normal(len(self.members)) / np.sqrt(len(self.members) - 1)
        share -= share.mean()
        mean = mixed(self.members, share + 1 / len(self.members))
        shortest = min(member.duration for member in self.members)
        return mean if mean.duration >= 0.5 * shortest else mean.towards(duration=0.5 * shortest)


def average(
    demonstrations: Sequence[Recording],
    *,
    n_basis: int = 20,
    variant: Variant | str = Variant.CLOSED_FORM,
    phase: Phase | None = None,
    at_rest: bool = True,
) -> AveragedDMP:
    """Fit several demonstrations and average them.

    Parameters
    ----------
    demonstrations
        Two or more, all with the same number of coordinates.
    n_basis, variant, phase, at_rest
        As for `DMP.fit`.

    Raises
    ------
    DemonstrationError
        If there are fewer than two, or they do not belong together.
    OptionError
        If the variant is rhythmic, or the demonstrations are not a list of recordings.
    """
    if Variant.named(variant) is Variant.RHYTHMIC:
        raise OptionError(
            "cycles begin anywhere and have no mean", key="variant", way_out="average movements that end"
        )
    names, _, _ = together(demonstrations)
    if names:
        raise DemonstrationError(
            f"the recordings are of {', '.join(names)}", way_out="average those of each manipulator by itself"
        )
    members = tuple(
        DMP.fit(demonstration, n_basis=n_basis, variant=variant, phase=phase, at_rest=at_rest)
        for demonstration in demonstrations
    )
    return AveragedDMP(mixed(members, np.full(len(members), 1 / len(members))), members)


def mixed(members: Sequence[DMP], shares: Array) -> DMP:
    """Return a combination of movements of one basis at equal phases. ``shares``, shape (n_members,), sum to 1."""
    durations = np.array([member.duration for member in members])
    duration = float(shares @ durations)
    mix: dict[str, Any] = {
        name: np.tensordot(shares, [getattr(member, name) for member in members], axes=1)
        for name in ("weights", "start", "goal", "learned")
    }
    for name in ("start_velocity", "goal_velocity"):
        paces = np.tensordot(shares * durations, [getattr(member, name) for member in members], axes=1)
        mix[name] = paces / duration
    return replace(members[0], duration=duration, **mix)
