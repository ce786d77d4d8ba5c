"""Stepwise execution: a curve to follow, and a decaying deviation.

The transformed system is linear, so its state is the sum of the undisturbed movement, known in closed form at every
phase, and a deviation e that obeys the same equation without goal and forcing,

    e'' = -alpha_y e' - alpha_y beta_y e + coupling,

in units of duration. Both are advanced exactly for any step; so is a coupling velocity, which moves the
position beside the system's own. Because the curve depends on the phase alone, a movement can be slowed down and run
backwards without leaving its path, while the deviation decays; in a pause both stand still. A goal that moves
changes the curve: a bridge, a polynomial of fifth degree, leads to the new curve without a jump in position,
velocity or acceleration. It ends when the movement ends, or a fifth of a duration after its own beginning if that is
later. Run backwards, another bridge leads to the start.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import floor

import numpy as np

from comove.arrays import Array
from comove.dmp.arguments import is_number, require_positive, vector
from comove.dmp.system import ALPHA_Y, LONG_AFTER, flow, responses, values_at
from comove.errors import OptionError

TO_ZERO = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 0.5], [-10, -6, -1.5], [15, 8, 1.5], [-6, -3, -0.5]])
"""Coefficients of the quintic on [0, 1] that leads from a position and two derivatives to rest at zero."""


@dataclass(frozen=True, eq=False)
class Bridge:
    """The remaining difference from the former curve. It is zero, with two derivatives, outside `first` to `last`.

    Attributes
    ----------
    gap : array, shape (3, n_dims): difference at the phase `begin`, in position and two derivatives
    first, begin, last : phases in durations
    """

    gap: Array
    first: float
    begin: float
    last: float

    def at(self, s: float) -> Array:
        """Return the difference and two derivatives at the phase `s`; array, shape (3, n_dims)."""
        end = self.last if s >= self.begin else self.first
        width = end - self.begin
        u = (s - self.begin) / width if width else 1.0
        if u >= 1.0:
            return np.zeros_like(self.gap)
        lengths = width ** np.arange(3)[:, None]
        coefficients = TO_ZERO @ (self.gap * lengths)
        powers = np.array(
            [
                [1, u, u**2, u**3, u**4, u**5],
                [0, 1, 2 * u, 3 * u**2, 4 * u**3, 5 * u**4],
                [0, 0, 2, 6 * u, 12 * u**2, 20 * u**3],
            ]
        )
        return powers @ coefficients / lengths


@dataclass(frozen=True, eq=False)
class Curve:
    """A movement in unit duration, exact at every phase.

    Attributes
    ----------
    knots : array, shape (3, n_knots, n_dims): position and two derivatives
    force : array, shape (n_knots, n_dims), the forcing term, linear between the knots
    goal : array, shape (n_dims,)
    periodic : whether the movement repeats after its end, instead of resting there
    bridge : transition from the curve that was followed before
    """

    knots: Array
    force: Array
    goal: Array
    periodic: bool = False
    bridge: Bridge | None = None

    def at(self, s: float) -> Array:
        """Return position and two derivatives at phase `s`; shape (3, n_dims)."""
        inside = s - floor(s) if self.periodic else max(s, 0.0)
        values = values_at(self.knots, self.force, self.goal, np.array([inside]))[:, 0]
        return values if self.bridge is None else values + self.bridge.at(s)

    def after(self, former: Curve, s: float) -> Curve:
        """Return this curve with a bridge from `former` at phase `s`."""
        return self.bridged(former.at(s) - replace(self, bridge=None).at(s), s)

    def bridged(self, gap: Array, s: float, shortest: float = 0.2) -> Curve:
        """Return this curve with a bridge from a difference at `s`.

        `gap` has shape (3, n_dims). The bridge ends with the movement, but lasts `shortest` durations at least; in a
        cycle it lasts a period.
        """
        if self.periodic:
            return replace(self, bridge=Bridge(gap, s - 1.0, s, s + 1.0))
        return replace(self, bridge=Bridge(gap, 0.0, s, max(1.0, s + shortest)))


@dataclass(frozen=True, eq=False)
class DMPState:
    """The state of an execution. Change it by `dataclasses.replace`, and continue.

    Attributes
    ----------
    time : time since the start [s]
    progress : phase s in durations: 1 at the end, beyond it while the movement rests at its goal
    position : array, shape (n_dims,), [m]; replace it by the measured position after a disturbance
    slope : array, shape (n_dims,), derivative of the position with respect to `progress`
    rate : pace of the phase in the last step
    goal : array, shape (n_dims,), [m]; may be moved while the movement runs
    duration : [s]; may be changed while the movement runs
    curve : the curve that the execution follows
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
            object.__setattr__(self, name, vector(name, getattr(self, name), len(self.curve.goal)))
        require_positive("duration", self.duration, of="seconds")

    @property
    def velocity(self) -> Array:
        """Return the velocity [m/s], shape (n_dims,); zero in a pause."""
        return self.slope * (self.rate / self.duration)


def begin(curve: Curve, start: Array, slope: Array, duration: float) -> DMPState:
    """Return the state at time 0, from which `advance` continues."""
    return DMPState(0.0, 0.0, start, slope, 1.0, curve.goal, duration, curve)


def advance(
    state: DMPState,
    dt: float,
    rate: float = 1.0,
    coupling: Array | None = None,
    velocity_coupling: Array | None = None,
) -> DMPState:
    """Advance the state by `dt` [s], exactly.

    With a velocity u the deviation obeys ``e' = z + u, z' = -alpha_y z - alpha_y beta_y e + coupling``; so e moves as
    under the acceleration ``coupling + alpha_y u`` from the velocity ``z + u``.

    Parameters
    ----------
    rate : pace of the phase: 1 as recorded, 0 paused, negative backwards (not beyond the start)
    coupling : array, shape (n_dims,), an acceleration [m/s^2] that acts during the step
    velocity_coupling : array, shape (n_dims,), a velocity [m/s] that is added during the step

    Raises
    ------
    OptionError
        If `dt` is not positive, or `rate` or a coupling is not finite.
    """
    require_positive("dt", dt, of="seconds")
    if not is_number(rate):
        raise OptionError(f"rate = {rate!r}", way_out="give a finite number: 1 as recorded, 0 paused")
    if rate == 0.0:
        return replace(state, time=state.time + dt, rate=0.0)
    curve, pushed, led = state.curve, np.zeros_like(state.position), np.zeros_like(state.position)
    if coupling is not None:
        pushed = vector("coupling", coupling, len(state.position)) * (state.duration / rate) ** 2
    if velocity_coupling is not None:
        led = vector("velocity_coupling", velocity_coupling, len(state.position))
        led = led * (state.duration / abs(rate))
    ds = float(np.clip(rate * dt / state.duration, -LONG_AFTER, LONG_AFTER))
    now = state.progress
    if not curve.periodic and ds < 0.0:
        now = min(now, 1.0 if curve.bridge is None else curve.bridge.last)
    then = now + ds if curve.periodic else max(now + ds, 0.0)
    at_now, at_then = curve.at(now), curve.at(then)
    apart, drift = state.position - at_now[0], np.sign(ds) * (state.slope - at_now[1])
    response, steady = responses(abs(ds)), np.zeros_like(pushed)
    apart, drift = flow(abs(ds), response, apart, drift + led, pushed + ALPHA_Y * led, steady)
    drift = drift - led
    return replace(
        state,
        time=state.time + dt,
        progress=then,
        position=at_then[0] + apart,
        slope=at_then[1] + np.sign(ds) * drift,
        rate=rate,
    )


def rate_for_lag(lag: float, tolerance: float) -> float:
    """Return the pace of the phase for a robot that lags. This is phase stopping (Ijspeert et al., 2013).

    Parameters
    ----------
    lag : distance of the robot from its desired position [m]
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
    if not (is_number(lag) and is_number(tolerance) and tolerance > 0):
        raise OptionError(
            f"lag = {lag!r}, tolerance = {tolerance!r}",
            way_out="give finite lengths, and a positive tolerance",
        )
    return 1.0 / (1.0 + (lag / tolerance) ** 2)
