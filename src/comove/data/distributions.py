"""Distributions from which studies draw values: uniform, truncated normal, and a choice."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from comove.arrays import Array


@dataclass(frozen=True, eq=False)
class Uniform:
    """A uniform distribution, of each coordinate by itself.

    Attributes
    ----------
    lower, upper : arrays, shape () for a number or (n,) for a list of n numbers
    """

    lower: Array
    upper: Array

    def draw(self, rng: np.random.Generator) -> Any:
        """Return a number or a list of numbers."""
        return (self.lower + (self.upper - self.lower) * rng.random(self.lower.shape)).tolist()


@dataclass(frozen=True, eq=False)
class TruncatedNormal:
    """A normal distribution, of each coordinate by itself, of which only what lies between two bounds is kept.

    Attributes
    ----------
    mean, deviation, lower, upper : arrays, shape () for a number or (n,) for a list of n numbers
    """

    mean: Array
    deviation: Array
    lower: Array
    upper: Array

    def draw(self, rng: np.random.Generator) -> Any:
        """Return a number or a list of numbers, by the inverse of the distribution function."""
        from scipy.special import ndtr, ndtri

        low, high = (ndtr((bound - self.mean) / self.deviation) for bound in (self.lower, self.upper))
        value = self.mean + self.deviation * ndtri(low + (high - low) * rng.random(self.mean.shape))
        return np.clip(value, self.lower, self.upper).tolist()


@dataclass(frozen=True)
class OneOf:
    """A choice among values, each as likely as the others."""

    values: tuple[Any, ...]

    def draw(self, rng: np.random.Generator) -> Any:
        """Return a copy of one of the values."""
        return copy.deepcopy(self.values[int(rng.integers(len(self.values)))])


Distribution = Uniform | TruncatedNormal | OneOf
