"""Distributions that studies sample: uniform, truncated normal, and choice."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from comove.arrays import Array


@dataclass(frozen=True, eq=False)
class Uniform:
    """Uniform distribution, independent in each coordinate.

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
    """Normal distribution, independent in each coordinate, truncated at two bounds.

    Attributes
    ----------
    mean, deviation, lower, upper : arrays, shape () for a number or (n,) for a list of n numbers
    """

    mean: Array
    deviation: Array
    lower: Array
    upper: Array

    def draw(self, rng: np.random.Generator) -> Any:
        """Return a number or list, by the inverse distribution function."""
        from scipy.special import ndtr, ndtri

        low, high = (ndtr((bound - self.mean) / self.deviation) for bound in (self.lower, self.upper))
        value = self.mean + self.deviation * ndtri(low + (high - low) * rng.random(self.mean.shape))
        return np.clip(value, self.lower, self.upper).tolist()


@dataclass(frozen=True)
class OneOf:
    """Choice among values of equal probability."""

    values: tuple[Any, ...]

    def draw(self, rng: np.random.Generator) -> Any:
        """Return a copy of one of the values."""
        return copy.deepcopy(self.values[int(rng.integers(len(self.values)))])


Distribution = Uniform | TruncatedNormal | OneOf
