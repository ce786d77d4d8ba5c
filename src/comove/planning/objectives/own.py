"""Objectives and constraints of the user's own: any function of a sampled motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comove.coordination.motion import CoordinatedMotion
from comove.errors import OptionError

Array = NDArray[np.float64]

N_SAMPLES = 201
TOLERANCE = 1e-4  # by which an equality may be missed, in its own unit


@dataclass(frozen=True, eq=False)
class Samples:
    """A motion at even times, as functions of the user get it.

    Attributes
    ----------
    time : array, shape (n_steps,) [s]
    position, velocity, acceleration : arrays, shape (n_steps, n_manipulators, n_dims) [m, m/s, m/s^2]
    manipulators : their names
    nodes : array, shape (n_steps, n_nodes, 3), the hands and then the corners of the load [m]
    """

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    manipulators: tuple[str, ...]
    nodes: Array

    @classmethod
    def of(cls, motion: CoordinatedMotion, n_steps: int = N_SAMPLES) -> Samples:
        """Return samples of a motion."""
        s, scene = np.linspace(0.0, 1.0, n_steps), motion.scene
        nodes = motion.coordinates.motion(motion.at(s))
        position, velocity, acceleration = nodes[:, :, : len(scene.manipulators), : scene.n_dims]
        duration = scene.duration
        return cls(
            s * duration,
            position,
            velocity / duration,
            acceleration / duration**2,
            scene.manipulators,
            nodes[0],
        )


Function = Callable[[Samples], float]


@dataclass(frozen=True, eq=False)
class Equality:
    """A constraint g = 0, within a tolerance in its own unit; constraints that are plain functions are h <= 0.

    Attributes
    ----------
    function : of `Samples`, gives a number or an array of them
    tolerance : by which each may be missed
    """

    function: Callable[[Samples], object]
    tolerance: float = TOLERANCE

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise OptionError(f"{self.function!r} is no function", key="constraints")
        number = isinstance(self.tolerance, (int, float)) and not isinstance(self.tolerance, bool)
        if not (number and 0 < self.tolerance < np.inf):
            raise OptionError(
                f"the tolerance {self.tolerance!r}", key="constraints", way_out="give a small number"
            )

    def __call__(self, samples: Samples) -> object:
        """By how much it is missed beyond its tolerance; at most 0 where it is kept."""
        return np.abs(np.asarray(self.function(samples), dtype=float)) - self.tolerance


@dataclass(frozen=True, eq=False)
class OwnFunctions:
    """What the user minimises, and what must hold besides the scene.

    Attributes
    ----------
    function : of `Samples`; None where another objective counts, and only constraints are the user's
    constraints : of `Samples`, h <= 0, or `Equality`
    """

    function: Function | None
    constraints: tuple[Callable[[Samples], object], ...] = ()

    def value(self, samples: Samples) -> float:
        """Return the objective.

        Raises
        ------
        OptionError
            The function fails, or does not give a number.
        """
        value = _called(self.function, samples, "objective")
        if value.shape != () or np.isnan(value):
            raise OptionError(
                f"'{name_of(self.function)}' gives {_shown(value)}, not one number",
                key="objective",
                way_out="return a number for every motion",
            )
        return float(value)

    def violations(self, samples: Samples) -> Array:
        """Return what all constraints give, one after the other; positive where one is broken.

        Raises
        ------
        OptionError
            One fails, or gives what is no number.
        """
        values = [np.zeros(0)]
        for constraint in self.constraints:
            value = _called(constraint, samples, "constraints")
            if value.ndim > 1 or np.isnan(value).any():
                raise OptionError(
                    f"'{name_of(constraint)}' gives {_shown(value)}",
                    key="constraints",
                    way_out="return a number, or a flat array of numbers, for every motion",
                )
            values.append(np.atleast_1d(value))
        return np.concatenate(values)

    def reasons(self, motion: CoordinatedMotion) -> list[str]:
        """Say which constraints a motion breaks at its samples; a further check of the judge."""
        samples, reasons = Samples.of(motion), []
        for constraint in self.constraints:
            worst = float(np.max(_called(constraint, samples, "constraints"), initial=-np.inf))
            if not worst <= 0.0:
                reasons.append(f"the constraint '{name_of(constraint)}' is missed by {worst:.3g}")
        return reasons


def name_of(function: object) -> str:
    """The name of a function in messages."""
    inner = getattr(function, "function", function)
    return getattr(inner, "__name__", type(inner).__name__)


def own(objective: object, constraints: Sequence[object]) -> OwnFunctions | None:
    """Return the user's functions, None where there are none.

    Raises
    ------
    OptionError
        A constraint is no function.
    """
    for constraint in constraints:
        if not callable(constraint):
            raise OptionError(
                f"the constraint {constraint!r} is no function",
                key="constraints",
                way_out="give functions of Samples: h(samples) <= 0, or Equality(g)",
            )
    function = objective if callable(objective) else None
    return OwnFunctions(function, tuple(constraints)) if function is not None or constraints else None


def _called(function: Callable[[Samples], object], samples: Samples, key: str) -> Array:
    try:
        value = function(samples)
        return np.asarray(value, dtype=float)
    except OptionError:
        raise
    except Exception as error:
        raise OptionError(
            f"'{name_of(function)}' fails: {type(error).__name__}: {error}",
            key=key,
            way_out="mend the function; it is called with Samples",
        ) from error


def _shown(value: Array) -> str:
    return f"an array of shape {value.shape}" if value.ndim else "nan" if np.isnan(value) else f"{value}"
