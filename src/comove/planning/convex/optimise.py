"""Sequential quadratic programming of motions, with warps of time between steps.

The cost is a sum of squares whose residuals are linearised in the shape weights (Gauss-Newton); distances are
linearised too. A step is evaluated at its trial point: contacts that are too near there are linearised and added to
the programme, before the step is shortened. A trust region bounds the change of configurations at even times.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.planning.convex.costs import SumOfSquares
from comove.planning.convex.limits import LinearLimits
from comove.planning.convex.programme import ConvexProgramme, ConvexSettings, Seen
from comove.planning.convex.quadratic import UNIT, Prices, Rows, Trust, minimum
from comove.planning.convex.warp import warped

SOUND = 1e-9  # m, by which margins may be missed


@dataclass
class ConvexOutcome:
    """The result of `optimise`.

    Attributes
    ----------
    z : array, shape (n_columns * n_basis,), shape weights
    value : value of the cost, raised where obstacles are nearer than the soft clearance
    missed : amounts by which margins and limits are missed beyond the tolerance, summed [m]
    iterations, programmes : numbers of steps tried and of quadratic programmes solved
    """

    z: Array
    value: float
    missed: float
    iterations: int = 0
    programmes: int = 0


def optimise(
    programme: ConvexProgramme,
    cost: SumOfSquares,
    z: Array,
    settings: ConvexSettings,
    reference: Array | None = None,
    over: Callable[[], bool] = lambda: False,
    known: float = np.inf,
) -> ConvexOutcome:
    """Optimise shape weights until steps bring no gain. Stop earlier if another motion is likely to stay better.

    Parameters
    ----------
    z : array, shape (n_columns * n_basis,), initial shape weights
    reference : array, shape (n_fine, n_columns), movement without contact about which the first clearances are
        linearised; that of `z` unless given
    over : function that is called before every programme and returns whether to end
    known : value of that other motion
    """
    radius, mu, need = settings.radius, settings.slack_cost, programme.need(settings)
    here = stand(programme, cost, z, settings, need, radius, reference)
    outcome, stall = ConvexOutcome(z, np.inf, here.missed), 0.0
    for _ in range(settings.iterations):
        if over():
            break
        trial = step(programme, cost, here, settings, need, radius, mu, over)
        outcome.iterations += 1
        if trial is None:
            radius *= 0.3
            if radius < settings.least:
                break
            continue
        outcome.programmes += trial.programmes
        ahead = programme.watched.moves @ trial.dz - here.off[programme.watched.at].ravel()
        size = float(np.abs(ahead / programme.watched.scale).max())
        first = not np.isfinite(here.missed)
        actual = here.value - trial.value + mu * (here.missed - trial.missed)
        restoring = trial.predicted <= 0 and trial.missed <= here.missed and trial.value < 1.01 * here.value
        even = abs(actual) < settings.gain * here.value and trial.missed <= here.missed
        taken = first or actual > max(0.05 * trial.predicted, 0.0) or even or restoring
        if not taken:
            radius = 0.4 * min(radius, size)
        elif not first and actual > 0.5 * trial.predicted and size > 0.9 * radius:
            radius = min(2 * radius, settings.most)
        elif not first and actual < 0.25 * trial.predicted and not restoring:
            radius = max(0.5 * size, 2 * settings.least)
        if taken:
            z = here.z + trial.dz
            if trial.missed == 0:
                z = warped(programme, cost, z, trial.own, trial.hands, settings)
            here = stand(programme, cost, z, settings, need, radius)
        worth = here.value * (1 + settings.worth * here.wish)
        gained = here.missed < SOUND and worth < outcome.value * (1 - settings.gain)
        likely = here.value - settings.outlook * (outcome.value - worth)
        if here.missed < SOUND and worth < outcome.value:
            outcome.z, outcome.value, outcome.missed = here.z, worth, 0.0
        stall = 0.0 if gained else stall + (1.0 if taken and here.missed < SOUND else 0.2)
        beaten = gained and likely > settings.behind * known
        if stall >= settings.patience or radius < settings.least or beaten:
            break
        if trial.slack > 1e-6 and (here.seen.depth > need).any():
            mu = min(5 * mu, settings.most_slack_cost)
    if not np.isfinite(outcome.value):
        outcome.z, outcome.value, outcome.missed = here.z, here.value, here.missed
    return outcome


class Stand(NamedTuple):
    """The current point of the optimisation, and the problem's model there.

    Attributes
    ----------
    z : array, shape (n_columns * n_basis,), shape weights
    value : value of the cost
    wish : unmet share of the soft clearance, squared and summed over obstacles
    gradient : gradient of half the cost in the variables w, ``dz = whiten' w``, in which its Hessian is the identity
    whiten : array, shape (n_columns * n_basis, n_columns * n_basis)
    seen : the movement about which clearances are linearised, and its contacts
    off : array, shape (n_samples, n_columns), configurations of `seen` less those of `z`
    limits : linearised limits of the end effectors
    pace : number of durations in which limits are kept; 1 if the duration is given
    missed : amounts by which margins and limits are missed beyond the tolerance, summed [m]; inf if not computed
    """

    z: Array
    value: float
    wish: float
    gradient: Array
    whiten: Array
    seen: Seen
    off: Array
    limits: LinearLimits
    pace: float
    missed: float


class Step(NamedTuple):
    """A trial step and its evaluation.

    Attributes
    ----------
    dz : array, shape (n_columns * n_basis,), change of the shape weights
    own, hands : cost after the step, and array, shape (n_samples, n_hands * n_dims), end effectors at coarse samples
        then [m]
    value : cost after the step, plus the price of the change of `Stand.wish`
    missed : amounts by which margins and limits are missed after the step [m]
    seen : movement after the step, and its contacts
    predicted : gain of the merit function that the programme predicts
    slack : amount by which the solution of the programme misses margins and limits [m]
    programmes : number of quadratic programmes that were solved
    """

    dz: Array
    own: float
    hands: Array
    value: float
    missed: float
    seen: Seen
    predicted: float
    slack: float
    programmes: int


def stand(
    p: ConvexProgramme,
    cost: SumOfSquares,
    z: Array,
    settings: ConvexSettings,
    need: Array,
    radius: float,
    reference: Array | None = None,
) -> Stand:
    """Evaluate and linearise the problem at weights `z`. Clearances are those at a near `reference`, if given."""
    q = p.curves.coarse.q(z)
    nodes, hands = p.curves.hands(q)
    moves = p.moves_of_hands(q, nodes)
    square, gradient = cost.normal_equations(hands, moves)
    lengths, rows = p.gauge.lengths(q, settings.gauge), p.gauge.moves(p.curves, q, settings.gauge)
    square, gradient = square + rows.T @ rows, gradient + rows.T @ lengths
    square.flat[:: p.curves.n + 1] += 1e-9 * np.trace(square) / p.curves.n
    whiten = inverse_of_lower(np.linalg.cholesky(square))
    gradient = whiten @ gradient
    own = p.curves.fine.q(z)
    cutoff = max(settings.margin + 0.005, settings.wish) + p.curves.scene.clearance + 1.8 * radius
    seen = p.look(own if reference is None else reference, cutoff, need)
    missed = p.missed(seen, hands, settings, cost) if reference is None else np.inf
    pace = p.limits.pace(hands) if cost.haste > 0 else 1.0
    value = cost.value(hands) + float(lengths @ lengths) + cost.haste * pace
    wish = _wish(p, seen, settings, need)
    limits = p.limits.linear(hands, moves, pace)
    return Stand(z, value, wish, gradient, whiten, seen, seen.q - own, limits, pace, missed)


@kernel
def inverse_of_lower(lower):
    """Return the inverse of a lower triangular matrix; array, shape (n, n)."""
    inverse = np.zeros_like(lower)
    for i in range(lower.shape[0]):
        for k in range(i):
            for j in range(k + 1):
                inverse[i, j] -= lower[i, k] * inverse[k, j]
        inverse[i, i] = 1.0
        for j in range(i + 1):
            inverse[i, j] /= lower[i, i]
    return inverse


def _wish(p: ConvexProgramme, seen: Seen, settings: ConvexSettings, need: Array) -> float:
    """Return the unmet share of the soft clearance, squared and summed."""
    if settings.wish <= 0:
        return 0.0
    n = p.load.n_owners
    unmet = 1.0 - (need[:n] - p.curves.scene.clearance - seen.depth[:n]) / settings.wish
    unmet = np.minimum(np.maximum(unmet, 0.0), 1.0)
    return float(unmet @ unmet)


def _further(
    p: ConvexProgramme, owner: Integers, bound: Array, settings: ConvexSettings, radius: float
) -> Array:
    """Return the soft clearance beyond the margin [m], -inf without one; array of the shape of `owner`.

    There is none for obstacles that are too far for a step to reach.
    """
    near = bound > -settings.wish - 0.5 * radius
    wished = near & (owner < p.load.n_owners) & (settings.wish > settings.margin)
    return np.where(wished, settings.wish - settings.margin, -np.inf)


def step(
    p: ConvexProgramme,
    cost: SumOfSquares,
    here: Stand,
    settings: ConvexSettings,
    need: Array,
    radius: float,
    mu: float,
    over: Callable[[], bool],
) -> Step | None:
    """Compute a step, corrected where its trial is too near. None on failure, or when the search is over."""
    rows, bound, owner = p.linear(here.seen, here.off, need)
    clearances = Rows(rows, bound, owner, _further(p, owner, bound, settings, radius))
    trust = Trust(p.watched.moves, here.off[p.watched.at].ravel(), radius * p.watched.scale)
    hasty = cost.haste > 0
    worth, wished = settings.worth * here.value, max(settings.wish, UNIT) ** 2
    duration = cost.haste if hasty else mu * settings.limit
    prices = Prices(mu, worth / wished, duration, here.pace, settings.hastier if hasty else 0.0)
    known, lenient, corrections, programmes = np.isfinite(here.missed), False, 0, 0
    while True:
        found = minimum(
            here.gradient, here.whiten, clearances, trust, here.limits, prices, settings.quadratic, over
        )
        if found is None:
            return None
        w, slack, short, slower, solved = found
        programmes += solved
        dz = w @ here.whiten
        if not hasty:
            slack += settings.limit * slower
        gain = -float(2 * here.gradient @ w + w @ w) + worth * (here.wish - short / wished)
        gain -= cost.haste * slower
        own, hands = p.value(cost, here.z + dz, settings.gauge)
        near = max(settings.margin + 1e-3, settings.wish) + p.curves.scene.clearance
        there = p.look(p.curves.fine.q(here.z + dz), near, need)
        value = own + worth * (_wish(p, there, settings, need) - here.wish)
        missed = p.missed(there, hands, settings, cost)
        near_enough = missed == 0.0
        predicted = gain + mu * (here.missed - min(here.missed, slack)) if known else np.inf
        trial = Step(dz, own, hands, value, missed, there, predicted, slack, programmes)
        if known:
            worse = predicted < -settings.gain * here.value and here.missed < SOUND
            if corrections == 0 and not lenient and worse:
                lenient = True  # parts that are too near may stay so, but not come nearer
                clearances = clearances._replace(bound=np.minimum(clearances.bound, 0.0))
                continue
            actual = here.value - trial.value + mu * (here.missed - missed)
            if actual > 0.5 * predicted or (near_enough and actual > 0.1 * predicted):
                return trial
            if near_enough and here.value - trial.value < 0.5 * abs(gain):
                return trial  # the model of the cost fails, not that of the clearances
            if corrections and slack > settings.margin:
                return trial
        if corrections == settings.corrections or near_enough:
            return trial
        corrections += 1
        more, least, whose = p.linear(there, np.zeros_like(here.off), need)
        further = _further(p, whose, least, settings, radius)
        clearances = clearances.with_more(more, least + more @ dz, whose, further)
