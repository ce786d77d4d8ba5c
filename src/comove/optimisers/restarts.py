"""When and how a search begins again after a run has ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

LARGEST = 10_000  # samples a generation


@dataclass(frozen=True)
class Setting:
    """How a run differs from the first.

    Attributes
    ----------
    population : samples a generation; None for the method's own
    sigma : first step size, in units of the user's
    local : whether it explores a neighbourhood with few samples
    """

    population: int | None = None
    sigma: float = 1.0
    local: bool = False


@dataclass(frozen=True)
class Ended:
    """A run that has ended: its setting, its samples a generation, and what it cost in evaluations."""

    setting: Setting
    population: int
    evaluations: int


class Restarts(Protocol):
    """Decides about the next run."""

    def following(self, ended: Sequence[Ended], rng: np.random.Generator) -> Setting | None:
        """The next run after these; None to end."""


@dataclass(frozen=True)
class NoRestarts:
    """One run, no more."""

    def following(self, ended: Sequence[Ended], rng: np.random.Generator) -> Setting | None:
        """Nothing follows."""
        return None


@dataclass(frozen=True)
class IPOP:
    """Every run has more samples a generation than the one before (Auger and Hansen, 2005).

    Attributes
    ----------
    factor : by which the population grows
    limit : restarts at most
    """

    factor: float = 2.0
    limit: int = 1000

    def following(self, ended: Sequence[Ended], rng: np.random.Generator) -> Setting | None:
        """A larger population."""
        if len(ended) > self.limit:
            return None
        return Setting(int(min(self.factor * ended[-1].population, LARGEST)))


@dataclass(frozen=True)
class BIPOP:
    """Large populations take turns with small ones of small steps, at equal cost (Hansen, 2009).

    Attributes
    ----------
    limit : restarts at most
    """

    limit: int = 1000

    def following(self, ended: Sequence[Ended], rng: np.random.Generator) -> Setting | None:
        """Whichever of the two has cost less since the first run."""
        if len(ended) > self.limit:
            return None
        first = ended[0].population
        large = [run for run in ended if not run.setting.local]
        spent = sum(run.evaluations for run in large[1:])
        if sum(run.evaluations for run in ended if run.setting.local) >= spent:
            return Setting(int(min(2 * large[-1].population, LARGEST)))
        share = rng.random() ** 2
        population = int(first * (0.5 * large[-1].population / first) ** share)
        return Setting(max(4, population), 10.0 ** (-2 * rng.random()), local=True)
