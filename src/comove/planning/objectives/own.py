"""Objectives and constraints that are functions of a sampled motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from comove.arrays import Array
from comove.brief import brief
from comove.errors import OptionError
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of a motion at even times, for functions of the user.

    Attributes
    ----------
    time : array, shape (n_steps,) [s]
    position, velocity, acceleration : arrays, shape (n_steps, n_manipulators, n_dims), of the end effectors [m, m/s,
        m/s^2]
    manipulators : names of the manipulators
    nodes : array, shape (n_steps, n_nodes, 3), positions of the end effectors, then of the payload's corners [m]
    """

    __repr__ = brief

    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    manipulators: tuple[str, ...]
    nodes: Array

    @classmethod
    def of(cls, motion: CoordinatedMotion, n_steps: int = 201) -> Samples:
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
    """A constraint g = 0 within a tolerance. Plain functions as constraints mean h <= 0 instead.

    Attributes
    ----------
    function : g, a function of `Samples` that returns a number or an array of numbers
    tolerance : largest accepted absolute value of each number, in the unit of g
    """

    function: Callable[[Samples], object]
    tolerance: float = 1e-4

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise OptionError(f"{self.function!r} is no function", key="constraints")
        number = isinstance(self.tolerance, (int, float)) and not isinstance(self.tolerance, bool)
        if not (number and 0 < self.tolerance < np.inf):
            raise OptionError(
                f"the tolerance {self.tolerance!r}", key="constraints", way_out="give a small number"
            )

    def __call__(self, samples: Samples) -> object:
        """Return the absolute values of g less the tolerance. They are at most 0 where the constraint holds."""
        return np.abs(np.asarray(self.function(samples), dtype=float)) - self.tolerance


@dataclass(frozen=True, eq=False)
class OwnFunctions:
    """The user's objective and further constraints. There are none where only the scene is sampled.

    Attributes
    ----------
    function : objective, a function of `Samples`; None if only constraints are the user's
    constraints : functions h of `Samples`, for h <= 0, or `Equality`
    """

    function: Function | None
    constraints: tuple[Callable[[Samples], object], ...] = ()

    @property
    def given(self) -> bool:
        """Return whether the user gave any function."""
        return self.function is not None or bool(self.constraints)

    def value(self, samples: Samples) -> float:
        """Return the value of the objective.

        Raises
        ------
        OptionError
            If the function fails, or does not return a number.
        """
        if self.function is None:
            raise OptionError("no function was given", key="objective", way_out="give a function of Samples")
        value = _called(self.function, samples, "objective")
        if value.shape != () or np.isnan(value):
            raise OptionError(
                f"'{name_of(self.function)}' gives {_shown(value)}, not one number",
                key="objective",
                way_out="return a number for every motion",
            )
        return float(value)

    def violations(self, samples: Samples) -> Array:
        """Return the values of all constraints in one array. A positive value is a violation.

        Raises
        ------
        OptionError
            If a constraint fails, or returns anything but numbers.
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
        """Return a message for every violated constraint, as a check of `verify`."""
        samples, reasons = Samples.of(motion), []
        for constraint in self.constraints:
            worst = float(np.max(_called(constraint, samples, "constraints"), initial=-np.inf))
            if not worst <= 0.0:
                reasons.append(f"the constraint '{name_of(constraint)}' is missed by {worst:.3g}")
        return reasons


def name_of(function: object) -> str:
    """Return the name of a function for messages."""
    inner = getattr(function, "function", function)
    return getattr(inner, "__name__", type(inner).__name__)


def own(
    objective: object, constraints: Sequence[Callable[[Samples], object]], scene: Scene
) -> OwnFunctions | None:
    """Return the user's functions; None without them or sampled constraints.

    Raises
    ------
    OptionError
        If a constraint is no function.
    """
    for constraint in constraints:
        if not callable(constraint):
            raise OptionError(
                f"the constraint {constraint!r} is no function",
                key="constraints",
                way_out="give functions of Samples: h(samples) <= 0, or Equality(g)",
            )
    function = objective if callable(objective) else None
    functions = OwnFunctions(function, tuple(constraints))
    return functions if functions.given or scene.sampled else None


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
