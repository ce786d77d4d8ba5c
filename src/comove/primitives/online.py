"""Execution step by step: a curve that is followed, and a deviation from it that dies out.

The transformed system is linear, so its state is that of the undisturbed movement, known in closed form at every
phase, plus a deviation e that obeys the same equation without goal and forcing,

    e'' = -alpha_y e' - alpha_y beta_y e + coupling,

in units of duration. Both are advanced exactly, whatever the step. Because the curve hangs on the phase alone, a
movement can be slowed down, paused and run backwards without leaving its path, and the deviation dies out all the
same. A goal that moves changes the curve: a bridge of fifth degree leads over to the new one without a jump in
position, velocity or acceleration, and arrives when the movement does, or a fifth of a duration later if it began
too late.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import floor

import numpy as np
from numpy.typing import NDArray

from comove.errors import OptionError
from comove.primitives.flow import flow, responses, values_at

Array = NDArray[np.float64]

SHORTEST_BRIDGE = 0.2  # durations, in which a goal that moved late is reached
HELD_BRIDGE = 1.0  # periods, in which a cycle takes to its new centre


@dataclass(frozen=True, eq=False)
class Bridge:
    """What is left of former curves: zero, with two derivatives, from `end` on.

    Attributes
    ----------
    begin, end : in durations
    coefficients : array, shape (6, n_dims), of a polynomial in (s - begin) / (end - begin)
    """

    begin: float
    end: float
    coefficients: Array

    @classmethod
    def closing(cls, gap: Array, begin: float, end: float) -> Bridge:
        """The bridge that begins with `gap`, array of shape (3, n_dims): position and two derivatives."""
        width = end - begin
        p, v, a = gap[0], gap[1] * width, gap[2] * width**2
        coefficients = [
            p,
            v,
            a / 2,
            -10 * p - 6 * v - 1.5 * a,
            15 * p + 8 * v + 1.5 * a,
            -6 * p - 3 * v - 0.5 * a,
        ]
        return cls(begin, end, np.stack(coefficients))

    def at(self, s: float) -> Array:
        """Position and two derivatives; array, shape (3, n_dims)."""
        width = self.end - self.begin
        u = (s - self.begin) / width
        if not 0.0 <= u < 1.0:
            held = np.zeros((3, self.coefficients.shape[1]))
            held[0] = self.coefficients[0] if u < 0.0 else 0.0
            return held
        powers = np.array(
            [
                [1, u, u**2, u**3, u**4, u**5],
                [0, 1, 2 * u, 3 * u**2, 4 * u**3, 5 * u**4],
                [0, 0, 2, 6 * u, 12 * u**2, 20 * u**3],
            ]
        )
        return powers @ self.coefficients / width ** np.arange(3)[:, None]


@dataclass(frozen=True, eq=False)
class Curve:
    """A movement in unit duration, exact at every phase.

    Attributes
    ----------
    knots : array, shape (3, n_knots, n_dims): position and two derivatives
    force : array, shape (n_knots, n_dims), the forcing term, linear between the knots
    goal : array, shape (n_dims,)
    periodic : goes on from the beginning after its end, instead of resting there
    bridge : leads over from the curve that was followed before
    """

    knots: Array
    force: Array
    goal: Array
    periodic: bool = False
    bridge: Bridge | None = None

    def at(self, s: float) -> Array:
        """Position and two derivatives by the phase `s` in durations; array, shape (3, n_dims)."""
        inside = s - floor(s) if self.periodic else max(s, 0.0)
        values = values_at(self.knots, self.force, self.goal, np.array([inside]))[:, 0]
        return values if self.bridge is None else values + self.bridge.at(s)

    def after(self, former: Curve, s: float) -> Curve:
        """This curve, reached from the `former` one, which is left at the phase `s`."""
        end = s + HELD_BRIDGE if self.periodic else max(1.0, s + SHORTEST_BRIDGE)
        return replace(self, bridge=Bridge.closing(former.at(s) - replace(self, bridge=None).at(s), s, end))


@dataclass(frozen=True, eq=False)
class DMPState:
    """Where an execution stands. Change it by `dataclasses.replace`, and go on.

    Attributes
    ----------
    time : since the start [s]
    progress : phase s in durations: 1 at the end, beyond it while the movement rests at its goal
    position : array, shape (n_dims,), [m]; replace it by what was measured after a disturbance
    slope : array, shape (n_dims,), change of the position by `progress`
    rate : of the last step
    goal : array, shape (n_dims,), [m]; may be moved while the movement runs
    duration : [s]; may be changed while the movement runs
    curve : what is followed
    """

    time: float
    progress: float
    position: Array
    slope: Array
    rate: float
    goal: Array
    duration: float
    curve: Curve

    def __post_init__(self) -> None:
        for name in ("position", "slope", "goal"):
            array = np.asarray(getattr(self, name), dtype=float)
            if array.shape != self.curve.goal.shape or not np.isfinite(array).all():
                raise OptionError(
                    f"{name} = {getattr(self, name)!r}",
                    way_out=f"give {len(self.curve.goal)} finite numbers",
                )
            object.__setattr__(self, name, array)
        if not (np.isfinite(self.duration) and self.duration > 0):
            raise OptionError(f"duration = {self.duration!r}", way_out="give a positive number of seconds")

    @property
    def velocity(self) -> Array:
        """Velocity, array of shape (n_dims,), [m/s]: none while the movement is paused."""
        return self.slope * (self.rate / self.duration)


def begin(curve: Curve, start: Array, slope: Array, duration: float) -> DMPState:
    """The state at time 0, from which `advance` goes on."""
    return DMPState(0.0, 0.0, start, slope, 1.0, curve.goal, duration, curve)


def advance(state: DMPState, dt: float, rate: float = 1.0, coupling: Array | None = None) -> DMPState:
    """Go on by `dt` [s], exactly.

    Parameters
    ----------
    rate : pace of the phase: 1 as recorded, 0 paused, negative backwards (not beyond the start)
    coupling : array, shape (n_dims,), an acceleration [m/s^2] that acts during the step

    Raises
    ------
    OptionError
        If `dt` is not positive, or `rate` or `coupling` are not finite.
    """
    if not (np.isfinite(dt) and dt > 0):
        raise OptionError(f"dt = {dt!r}", way_out="give a positive number of seconds")
    if not np.isfinite(rate):
        raise OptionError(f"rate = {rate!r}", way_out="give a finite number: 1 as recorded, 0 paused")
    if rate == 0.0:
        return replace(state, time=state.time + dt, rate=0.0)
    curve, pushed = state.curve, np.zeros_like(state.position)
    if coupling is not None:
        pushed = np.asarray(coupling, dtype=float)
        if pushed.shape != state.position.shape or not np.isfinite(pushed).all():
            raise OptionError(
                f"coupling = {coupling!r}", way_out=f"give {len(state.position)} finite numbers"
            )
        pushed = pushed * state.duration**2
    ds = rate * dt / state.duration
    now = state.progress
    if not curve.periodic and ds < 0.0:
        now = min(now, 1.0 if curve.bridge is None else curve.bridge.end)
    then = now + ds if curve.periodic else max(now + ds, 0.0)
    at_now, at_then = curve.at(now), curve.at(then)
    apart, drift = state.position - at_now[0], np.sign(ds) * (state.slope - at_now[1])
    apart, drift = flow(abs(ds), responses(abs(ds)), apart, drift, pushed, np.zeros_like(pushed))
    return replace(
        state,
        time=state.time + dt,
        progress=then,
        position=at_then[0] + apart,
        slope=at_then[1] + np.sign(ds) * drift,
        rate=rate,
    )


def rate_for_lag(lag: float, tolerance: float) -> float:
    """Pace of the phase while the robot lags behind: phase stopping (Ijspeert et al., 2013).

    Parameters
    ----------
    lag : distance between where the robot is and where it should be [m]
    tolerance : lag at which the pace is halved [m]

    Returns
    -------
    float
        ``1 / (1 + (lag / tolerance)^2)``

    Raises
    ------
    OptionError
        If the tolerance is not positive or the lag not finite.
    """
    if not tolerance > 0 or not np.isfinite(lag):
        raise OptionError(
            f"lag = {lag!r}, tolerance = {tolerance!r}",
            way_out="give finite lengths, and a positive tolerance",
        )
    return 1.0 / (1.0 + (lag / tolerance) ** 2)
