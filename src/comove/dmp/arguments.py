"""Checks of arguments: numbers, vectors and counts."""

from __future__ import annotations

from dataclasses import fields
from enum import StrEnum
from typing import Any, Self, TypeGuard

import numpy as np

from comove.arrays import Array
from comove.errors import OptionError, near_name

MAX_STEPS = 100_000_000


class NamedOption(StrEnum):
    """A choice among names, given itself or by name."""

    @classmethod
    def named(cls, name: str) -> Self:
        """Return the choice with the given name.

        Raises
        ------
        OptionError
            If there is no such choice; the argument is called as the class in lower case.
        """
        try:
            return cls(name)
        except ValueError:
            raise OptionError(
                f"{cls.__name__.lower()} = {name!r}",
                way_out=near_name(str(name), [choice.value for choice in cls]),
            ) from None


def is_number(value: object) -> TypeGuard[float]:
    """Return whether `value` is one finite number."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        return False
    return bool(-1e308 < value < 1e308)


def is_count(value: object, least: int = 1, most: int = MAX_STEPS) -> TypeGuard[int]:
    """Return whether `value` is a whole number from `least` to `most`."""
    return (
        isinstance(value, (int, np.integer)) and not isinstance(value, bool) and least <= int(value) <= most
    )


def numbers(value: object) -> Array:
    """Convert `value` to a new array of floats; return a zero-dimensional NaN if that is impossible."""
    try:
        return np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return np.full((), np.nan)


def vector(name: str, value: object, n_dims: int) -> Array:
    """Return `value` as a new array of `n_dims` finite numbers."""
    array = numbers(value)
    if array.shape != (n_dims,) or not np.isfinite(array).all():
        raise OptionError(f"{name} = {value!r}", way_out=f"give {n_dims} finite numbers")
    return array


def require_positive(name: str, value: object, most: float = 1e308, *, of: str = "") -> None:
    """Raise unless `value` is positive and at most `most`. `of` names its unit in the message."""
    if not is_number(value) or not 0 < value <= most:
        bound = f" up to {most:g}" if most < 1e308 else ""
        unit = f" of {of}" if of else ""
        raise OptionError(f"{name} = {value!r}", key=name, way_out=f"give a positive number{unit}{bound}")


def require_count(name: str, value: object, most: int = MAX_STEPS) -> None:
    """Raise unless `value` is a whole number from 1 to `most`."""
    if not is_count(value, most=most):
        bound = f"to {most}" if most < MAX_STEPS else "on"
        raise OptionError(f"{name} = {value!r}", key=name, way_out=f"give a whole number from 1 {bound}")


def require_numbers(settings: Any) -> None:
    """Raise unless settings are positive, and integers 1 or more."""
    for entry in fields(settings):
        if isinstance(entry.default, int):
            require_count(entry.name, getattr(settings, entry.name))
        elif isinstance(entry.default, float):
            require_positive(entry.name, getattr(settings, entry.name))


def instants(time: object) -> Array:
    """Return `time` as a new array of finite times [s], shape (n_steps,)."""
    array = numbers(time)
    if array.ndim != 1 or not np.isfinite(array).all():
        raise OptionError(f"time of shape {array.shape}", way_out="give an array of finite numbers [s]")
    return array


def require_steps(n_steps: object) -> None:
    """Raise unless `n_steps` is a valid number of samples."""
    if not is_count(n_steps, least=2):
        raise OptionError(f"n_steps = {n_steps!r}", way_out=f"give a whole number from 2 to {MAX_STEPS:,}")
