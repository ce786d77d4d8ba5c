"""Cooperation of robot and human in cycles (Nemec et al., Auton. Robots 2018 [8]).

The robot follows a speed-scaled primitive with a stiffness in the path's frame,

    nu(s) tau y' = z,   nu(s) tau z' = alpha (beta (g - y) - z) + f(s),   nu(s) tau s' = 1,
    K(s) = R(s) diag(k_t, k_n, k_b) R(s)^T,   D(s) = 2 K(s)^(1/2),

where R is the Frenet-Serret frame and nu > 1 means slower than demonstrated. (The phase is linear here.) The
transformed system depends on the phase alone, so that y follows the path p(s) of the primitive at any pace. This
structure is the source's. The laws below are ours.

**Together.** The human is a spring of stiffness k_h towards a path h(s) and a pace mu(s) of her own; the payload
has unit mass. Across the path it deviates by e; along the path both agree on a pace,

    e'' = -K e - D e' + k_h (1 - t t^T) (h(s) - p(s) - e) - 2 sqrt(k_h) (1 - t t^T) e',
    T_pace d(s')/dt = (k_t / nu + k_h mu) / (k_t + k_h) - s',

with s' in 1/duration.

**Learning.** A stiff robot deviates little, even if its partner wants a large deviation. That wish can still be
estimated: where both forces balance, K e = k_h (w - e), so that the deviation e(s) and the robot's own force K e give

    w = e + K e / k_h,          1/u = 1/m + k_t / k_h (1/m - 1/nu),

the deviation w across the path that the human alone would choose, and, from the measured slowness m(s) = 1/s', her
slowness u (with an assumed k_h). After a cycle

    p <- p + zeta w,                    nu <- nu + zeta (m - nu),
    S <- (1 - zeta) (S + zeta w w^T),   v <- (1 - zeta) (v + zeta (u - nu)^2),
    k_i = k_min + (k_max - k_min) / (1 + (R^T S R)_ii / sigma^2),   i = n, b;   k_t likewise from v / sigma_pace^2.

S begins large, so that the robot is soft at first, and stays large across the path where the human varies. With e
in place of w it would not: the deviations of a stiff robot are small, which would make it stiffer still, however much
its partner varies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.compiled import kernel
from comove.dmp.arguments import require_positive
from comove.errors import OptionError
from comove.trajectory import interpolated

SLOWEST, FASTEST = 0.05, 20.0  # paces, in 1/duration
LONGEST = 20.0  # longest cycle, in durations
STILL, STRAIGHT = 1e-6, 1e-6  # shares of the largest slope and bend below which they have no direction


@dataclass(frozen=True)
class Laws:
    """Parameters of the laws of cooperation and learning.

    Attributes
    ----------
    softest, stiffest : k_min and k_max [N/m, with a unit mass]
    learning : zeta
    spread, pace_spread : sigma [m] and sigma_pace [durations]; a variation of that size halves the stiffness above
        `softest`
    first_spread, first_pace_spread : standard deviations from which S and v begin
    pace_time : T_pace [s]
    partner : k_h that the robot assumes of the human [N/m]
    """

    softest: float = 50.0
    stiffest: float = 2000.0
    learning: float = 0.3
    spread: float = 0.01
    pace_spread: float = 0.1
    first_spread: float = 0.1
    first_pace_spread: float = 1.0
    pace_time: float = 0.1
    partner: float = 300.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            require_positive(name, value)
        if not self.learning <= 1.0:
            raise OptionError(f"learning = {self.learning!r}", key="learning", way_out="give at most 1")
        if not self.softest <= self.stiffest:
            raise OptionError(
                f"softest = {self.softest!r}", key="softest", way_out=f"give at most {self.stiffest:g}"
            )


@dataclass(frozen=True, eq=False)
class Intention:
    """Path and pace intended by the human in one cycle. They are given at the samples of the phase.

    Attributes
    ----------
    path : array, shape (n_samples, n_paths, n_dims), h: wanted path [m]
    pace : array, shape (n_samples,), mu: wanted pace [1/duration]
    stiffness : k_h [N/m]
    """

    path: Array
    pace: Array
    stiffness: float


@dataclass(frozen=True, eq=False)
class Skill:
    """Skill of the robot, at even phase samples from 0 to 1.

    Attributes
    ----------
    path : array, shape (3, n_samples, n_paths, n_dims), p and its first two derivatives by the phase [m]
    slowness : array, shape (n_samples,), nu
    covariance : array, shape (n_samples, n_paths, n_dims, n_dims), S: covariance of the human's path [m^2]
    pace_variance : array, shape (n_samples,), v: variance of the human's slowness
    """

    path: Array
    slowness: Array
    covariance: Array
    pace_variance: Array

    @classmethod
    def taught(cls, path: Array, laws: Laws) -> Skill:
        """Return the skill before the first cycle."""
        _, n_samples, n_paths, n_dims = path.shape
        covariance = np.broadcast_to(
            laws.first_spread**2 * np.eye(n_dims), (n_samples, n_paths, n_dims, n_dims)
        )
        return cls(path, np.ones(n_samples), covariance, np.full(n_samples, laws.first_pace_spread**2))

    @cached_property
    def frames(self) -> Array:
        """Return the frames R along every path; array, shape (n_samples, n_paths, n_dims, n_dims)."""
        return np.stack([frenet_frames(p[1], p[2]) for p in np.moveaxis(self.path, 2, 0)], axis=1)

    def stiffness(self, laws: Laws) -> Array:
        """Return the stiffnesses k_t, k_n (and k_b); array, shape (n_samples, n_paths, n_dims), [N/m]."""
        frames = self.frames
        variance = np.einsum("spdi,spde,spei->spi", frames, self.covariance, frames) / laws.spread**2
        variance[:, :, 0] = self.pace_variance[:, None] / laws.pace_spread**2
        return laws.softest + (laws.stiffest - laws.softest) / (1.0 + variance)


@dataclass(frozen=True, eq=False)
class Cycle:
    """Measurements of one cycle, at the samples of the phase.

    Attributes
    ----------
    deviation : array, shape (n_samples, n_paths, n_dims), e [m]
    wish : array, shape (n_samples, n_paths, n_dims), w: deviation that the human alone would choose [m]
    slowness : array, shape (n_samples,), m: measured slowness
    slowness_wish : array, shape (n_samples,), u: slowness that the human alone would choose
    effort : root mean square of the human's force over time [N]
    duration : duration of the cycle, divided by that of the demonstrated movement
    """

    deviation: Array
    wish: Array
    slowness: Array
    slowness_wish: Array
    effort: float
    duration: float


def run_cycle(skill: Skill, intention: Intention, laws: Laws, duration: float, period: float) -> Cycle:
    """Simulate one cycle of robot and human.

    Parameters
    ----------
    duration : duration of the demonstrated movement [s]
    period : time step of the integration [s]
    """
    frames, stiffness = skill.frames, skill.stiffness(laws)
    of_robot = np.einsum("spdi,spi,spei->spde", frames, stiffness, frames)
    damping = np.einsum("spdi,spi,spei->spde", frames, 2.0 * np.sqrt(stiffness), frames)
    tangent = frames[:, :, :, 0]
    across = np.eye(tangent.shape[2]) - tangent[:, :, :, None] * tangent[:, :, None, :]
    wanted = np.einsum("spde,spe->spd", across, intention.path - skill.path[0])
    k_t = stiffness[:, :, 0].mean(axis=1)
    phase, deviation, pace, effort = _move(
        Springs(of_robot, damping, across, wanted),
        Pacing(k_t, skill.slowness, intention.pace, laws.pace_time),
        intention.stiffness,
        duration,
        period,
    )
    s = np.linspace(0.0, 1.0, len(skill.slowness))
    measured = interpolated(s, phase, deviation.reshape(len(phase), -1)).reshape(skill.path.shape[1:])
    force = np.einsum("spde,spef,spf->spd", across, of_robot, measured)
    slowness = np.interp(s, phase, 1.0 / pace)
    along = k_t / laws.partner
    return Cycle(
        measured,
        measured + force / laws.partner,
        slowness,
        1.0 / np.clip(1.0 / slowness + along * (1.0 / slowness - 1.0 / skill.slowness), SLOWEST, FASTEST),
        float(np.sqrt(effort)),
        (len(phase) - 1) * period / duration,
    )


def learned(skill: Skill, cycle: Cycle, change: Array, laws: Laws) -> Skill:
    """Return the skill after a cycle.

    Parameters
    ----------
    change : array, shape (3, n_samples, n_paths, n_dims), the human's intention as the primitive can represent it,
        and its first two derivatives [m]
    """
    zeta, w = laws.learning, cycle.wish
    return replace(
        skill,
        path=skill.path + zeta * change,
        slowness=skill.slowness + zeta * (cycle.slowness - skill.slowness),
        covariance=(1 - zeta) * (skill.covariance + zeta * w[..., :, None] * w[..., None, :]),
        pace_variance=(1 - zeta) * (skill.pace_variance + zeta * (cycle.slowness_wish - skill.slowness) ** 2),
    )


class Springs(NamedTuple):
    """Stiffness and damping across the paths, by samples of the phase.

    Attributes
    ----------
    of_robot, damping : arrays, shape (n_samples, n_paths, n_dims, n_dims), K [N/m] and D [N s/m]
    across : array of the same shape, 1 - t t^T
    wanted : array, shape (n_samples, n_paths, n_dims), deviation that the human wants [m]
    """

    of_robot: Array
    damping: Array
    across: Array
    wanted: Array


class Pacing(NamedTuple):
    """Terms that set the pace, by samples of the phase.

    Attributes
    ----------
    k_t : array, shape (n_samples,), stiffness along the paths [N/m]
    slowness, wanted : arrays, shape (n_samples,), nu of the robot, and mu of the human [1/duration]
    time : T_pace [s]
    """

    k_t: Array
    slowness: Array
    wanted: Array
    time: float


@kernel
def _move(
    springs: Springs, pacing: Pacing, k_h: float, duration: float, period: float
) -> tuple[Array, Array, Array, float]:
    """Return phase, deviation and pace per step, and mean squared force. The force is the human's. The deviation is
    integrated by the backward Euler method, with the coefficients of the phase before each step."""
    of_robot, damping, across, wanted = springs
    k_t, slowness, pace_wanted, pace_time = pacing
    n_samples, n_paths, n_dims = wanted.shape
    most = int(LONGEST * duration / period) + 2
    phase, pace = np.empty(most), np.empty(most)
    deviation = np.zeros((most, n_paths, n_dims))
    velocity, force = np.zeros((n_paths, n_dims)), np.empty(n_dims)
    d_h, total, s = 2.0 * np.sqrt(k_h), 0.0, 0.0
    rate = (k_t[0] / slowness[0] + k_h * pace_wanted[0]) / (k_t[0] + k_h)
    for step in range(most):
        phase[step], pace[step] = s, rate
        if s >= 1.0 or step == most - 1:
            return phase[: step + 1], deviation[: step + 1], pace[: step + 1], total / max(step, 1)
        at = s * (n_samples - 1)
        j = min(int(at), n_samples - 2)
        f = at - j
        for p in range(n_paths):
            left = np.eye(n_dims)
            for a in range(n_dims):
                pull, own = 0.0, 0.0
                for b in range(n_dims):
                    here = (1 - f) * across[j, p, a, b] + f * across[j + 1, p, a, b]
                    k = (1 - f) * of_robot[j, p, a, b] + f * of_robot[j + 1, p, a, b]
                    d = (1 - f) * damping[j, p, a, b] + f * damping[j + 1, p, a, b]
                    pull -= k_h * here * deviation[step, p, b] + d_h * here * velocity[p, b]
                    own -= k * deviation[step, p, b] + k_h * here * deviation[step, p, b]
                    left[a, b] += period * (d + d_h * here) + period * period * (k + k_h * here)
                goal = k_h * ((1 - f) * wanted[j, p, a] + f * wanted[j + 1, p, a])
                total += (goal + pull) ** 2 / n_paths
                force[a] = velocity[p, a] + period * (own + goal)
            velocity[p] = np.linalg.solve(left, force)
            for a in range(n_dims):
                deviation[step + 1, p, a] = deviation[step, p, a] + period * velocity[p, a]
        stiff = (1 - f) * k_t[j] + f * k_t[j + 1]
        nu = (1 - f) * slowness[j] + f * slowness[j + 1]
        mu = (1 - f) * pace_wanted[j] + f * pace_wanted[j + 1]
        agreed = (stiff / nu + k_h * mu) / (stiff + k_h)
        rate = agreed + (rate - agreed) * np.exp(-period / pace_time)
        rate = min(max(rate, SLOWEST), FASTEST)
        s = s + rate * period / duration
    return phase, deviation, pace, total


def frenet_frames(slope: Array, bend: Array) -> Array:
    """Compute tangent, normal and binormal at every sample of a path.

    The normal is perpendicular to the tangent and points to the side to which the path bends. In the plane it is the
    tangent, rotated to the left by 90 degrees. Where the path is stationary, the nearest tangent is used; where it
    is straight, the normal is transported along it with the least rotation (Bishop, 1975).

    Parameters
    ----------
    slope, bend : arrays, shape (n_steps, n_dims), first and second derivatives of the path by any parameter

    Returns
    -------
    array, shape (n_steps, n_dims, n_dims), with the columns tangent, normal (and binormal)
    """
    tangent = _tangents(slope)
    if slope.shape[1] == 2:
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        return np.stack([tangent, normal], axis=2)
    across = bend - (bend * tangent).sum(axis=1, keepdims=True) * tangent
    speed = np.linalg.norm(slope, axis=1)
    size = np.linalg.norm(across, axis=1)
    # A curvature counts where the path moves and turns noticeably in the time that it takes.
    bent = (size > STRAIGHT * max(np.linalg.norm(bend, axis=1).max(), 1e-300)) & (speed > STILL * speed.max())
    across[bent] /= size[bent, None]
    normal = _normals(tangent, across, bent)
    return np.stack([tangent, normal, np.cross(tangent, normal)], axis=2)


def _tangents(slope: Array) -> Array:
    """Return unit tangents, where stationary those of the nearest sample. They are the x axis if the path never
    moves."""
    speed = np.linalg.norm(slope, axis=1)
    moving = np.flatnonzero(speed > STILL * max(speed.max(), 1e-300))
    if not len(moving):
        return np.tile(np.eye(slope.shape[1])[0], (len(slope), 1))
    steps = np.arange(len(slope))
    after = np.searchsorted(moving, steps).clip(max=len(moving) - 1)
    before = (after - 1).clip(min=0)
    nearer = np.abs(moving[after] - steps) <= np.abs(moving[before] - steps)
    nearest = np.where(nearer, moving[after], moving[before])
    return slope[nearest] / speed[nearest, None]


def _normals(tangent: Array, across: Array, bent: NDArray[np.bool_]) -> Array:
    """Return unit normals; array, shape (n_steps, 3). They are `across` where the path bends, else the last normal
    transported along it."""
    # Of a path that is straight all along any normal does.
    last = across[bent][0] if bent.any() else np.eye(3)[np.abs(tangent[0]).argmin()]
    normal = np.empty_like(tangent)
    for k, along in enumerate(tangent):
        last = across[k] if bent[k] else last
        last = last - (last @ along) * along
        last = normal[k] = last / np.linalg.norm(last)
    return normal
