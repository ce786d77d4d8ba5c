"""Rules for restarts after a run has ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from comove.optim.cmaes import check_number, check_whole

LARGEST = 10_000  # samples a generation


@dataclass(frozen=True)
class Setting:
    """Settings of a run that differ from the first run's.

    Attributes
    ----------
    population : samples per generation; None for the method's own
    sigma : first step size, relative to the user's
    local : whether it explores a neighbourhood with few samples
    """

    population: int | None = None
    sigma: float = 1.0
    local: bool = False


@dataclass(frozen=True)
class Ended:
    """An ended run: its setting, population, and number of evaluations."""

    setting: Setting
    population: int
    evaluations: int


class Restarts(Protocol):
    """A rule that decides on the next run."""

    def following(self, ended: Sequence[Ended], rng: np.random.Generator) -> Setting | None:
        """Return the setting of the next run, or None to end."""


class RunSequence:
    """The runs of a search, one after the other, by a rule.

    Attributes
    ----------
    rule : decides on the next run
    seed : seed of all random numbers
    setting : setting of the present run
    ended : the runs before
    n_diverged : how many of these diverged
    choices : source of the random numbers between runs
    """

    def __init__(self, rule: Restarts, seed: int, first: Setting) -> None:
        self.rule, self.seed, self.setting = rule, seed, first
        self.ended: list[Ended] = []
        self.n_diverged = 0
        self.choices = np.random.default_rng([seed, 0])

    def generator(self) -> np.random.Generator:
        """Return a new source of the random numbers of the present run."""
        return np.random.default_rng([self.seed, 1, len(self.ended)])

    def follow(self, population: int, spent: int, diverged: bool) -> bool:
        """End the present run; return whether another follows.

        Parameters
        ----------
        population : samples per generation, of a run whose setting leaves them open
        spent : evaluations of the whole search so far
        """
        cost = spent - sum(run.evaluations for run in self.ended)
        self.ended.append(Ended(self.setting, self.setting.population or population, cost))
        self.n_diverged += diverged
        following = self.rule.following(self.ended, self.choices)
        self.setting = following or self.setting
        return following is not None


@dataclass(frozen=True)
class NoRestarts:
    """The rule that ends the search after one run."""

    def following(self, ended: Sequence[Ended], rng: np.random.Generator) -> Setting | None:
        """Return None, as no run follows."""
        return None


@dataclass(frozen=True)
class IPOP:
    """Restarts with ever larger populations (Auger and Hansen, 2005).

    Attributes
    ----------
    factor : growth of the population from run to run
    limit : largest number of restarts

    Raises
    ------
    OptionError
        If the factor is below 1 or not finite, or a number is too small or not whole.
    """

    factor: float = 2.0
    limit: int = 1000

    def __post_init__(self) -> None:
        check_number("factor", self.factor, 1.0)
        check_whole("limit", self.limit, 0)

    def following(self, ended: Sequence[Ended], rng: np.random.Generator) -> Setting | None:
        """Return a setting with a larger population, or None at the limit."""
        if len(ended) > self.limit:
            return None
        return Setting(int(min(self.factor * ended[-1].population, LARGEST)))


@dataclass(frozen=True)
class BIPOP:
    """Restarts that alternate large and small populations (Hansen, 2009).

    Both kinds cost the same; small ones take small steps.

    Attributes
    ----------
    factor : growth of the large populations from run to run
    before : number of large populations from which on small ones cost as much
    least : least number of small populations after each large one
    limit : largest number of restarts

    Raises
    ------
    OptionError
        If the factor is below 1 or not finite, or a number is too small or not whole.
    """

    factor: float = 2.0
    before: int = 2
    least: int = 0
    limit: int = 1000

    def __post_init__(self) -> None:
        check_number("factor", self.factor, 1.0)
        check_whole("before", self.before, 1)
        check_whole("least", self.least, 0)
        check_whole("limit", self.limit, 0)

    def following(self, ended: Sequence[Ended], rng: np.random.Generator) -> Setting | None:
        """Return a setting of the cheaper kind so far, or None."""
        if len(ended) > self.limit:
            return None
        first = ended[0].population
        large = [run for run in ended if not run.setting.local]
        small = [run.evaluations for run in ended if run.setting.local]
        spent = sum(run.evaluations for run in large[self.before - 1 :])
        if sum(small) >= spent and len(small) >= self.least * len(large):
            return Setting(int(min(self.factor * large[-1].population, LARGEST)))
        share = rng.random() ** 2
        population = int(first * (0.5 * large[-1].population / first) ** share)
        return Setting(max(4, population), 10.0 ** (-2 * rng.random()), local=True)
