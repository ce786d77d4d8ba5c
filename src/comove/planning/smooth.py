"""Smooth motions: convex optimisation of planned paths and demonstrations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from comove.arrays import Array
from comove.dmp.basis import motion_basis
from comove.dmp.dmp import DMP
from comove.model.coordinated_dmp import CoordinatedDMP
from comove.model.coordinates import load_coordinates
from comove.model.motion import CoordinatedMotion
from comove.planning.convex.costs import Anchored, JerkCost, PaperSquares, SumOfSquares, squares
from comove.planning.convex.limits import Limits
from comove.planning.convex.optimise import optimise
from comove.planning.convex.programme import SETTINGS as CONVEX
from comove.planning.convex.programme import ConvexProgramme, ConvexSettings
from comove.planning.objective import N_STEPS
from comove.planning.objectives import LeastJerk
from comove.planning.pace import in_least_time
from comove.planning.search import Search
from comove.trajectory import interpolated
from comove.verification.verify import verify

# Work, as computed distances that take about as long.
STEP = 1e5  # of a step of the optimisation
PROGRAMME = 400.0  # of a quadratic programme, for every variable


@dataclass(frozen=True)
class SmoothingSettings:
    """Settings of the smoothing of planned paths.

    Attributes
    ----------
    n_basis : shape weights a column: few, and more if these cannot follow a path
    ridges : of the initial fit, from smooth to accurate
    near : distance within which a fit follows the path about which clearances are linearised [m]
    again : trust region after a rejection [m]
    attempts : programmes until a motion is verified, each with more margin
    more, more_border : margin that each adds, for obstacles and for the border [m]
    fast, fastest : weights a column, and samples, of motions in least time, and of the best of them, as fast motions
        use their limits to the full
    most_weights : weights of all columns: programmes of more take seconds and gain a percent
    pulls : of end effectors to the planned path, where arms must follow it
    shares : of the pull to a demonstration, one after the other, where arms must follow
    roughly : trust region below which that ends, as arms succeed by chance only below [m]
    parts : of the path there that are tried: stretched arms have to turn fast
    alike : relative difference in jerk of motions that a demonstration draws to the same one
    hopeless : penetration from which on more margin does not help [m]
    unmet : relative excess, summed over limits, beyond which the duration is too short
    gentle : weight of the jerk beside the duration, both relative to their initial values
    faster : largest radius of the trust region where the duration is minimised [m]
    convex : settings of the programmes
    """

    n_basis: tuple[int, ...] = (16, 24, 40)
    ridges: tuple[float, ...] = (1e-8, 1e-9, 1e-10, 1e-11)
    near: float = 0.05
    again: float = 0.03
    attempts: int = 4
    more: float = 1e-3
    more_border: float = 2e-4
    fast: tuple[int, int] = (24, 201)
    fastest: tuple[int, int] = (49, 401)
    most_weights: int = 200
    pulls: tuple[float, ...] = (0.0, 1e3, 1e4, 3e4, 1e5, 3e5, 1e6, 1e7)
    shares: tuple[float, ...] = (1e-2, 1.0)
    roughly: float = 2e-3
    parts: tuple[float, ...] = (1.0, 0.8, 0.5)
    alike: float = 0.02
    hopeless: float = 0.01
    unmet: float = 1.5e-2
    gentle: float = 1e-3
    faster: float = 0.2
    convex: ConvexSettings = CONVEX


SETTINGS = SmoothingSettings()


def smooth_way(search: Search, way: Array, boundary: Array, smoothing: SmoothingSettings = SETTINGS) -> bool:
    """Optimise a path without contact; return whether the motion is verified.

    Parameters
    ----------
    way : array, shape (N_STEPS, n_columns), path in payload coordinates, at even times
    boundary : array, shape (4, n_columns), as in `CoordinatedMotion`
    """
    programme, z, reference = _along(search, way, boundary, smoothing)
    if search.kinematics.has_limits:
        return _carried(search, programme, z, reference, smoothing)
    return _verified(search, programme, z, reference, smoothing)


def _along(
    search: Search, way: Array, boundary: Array, smoothing: SmoothingSettings
) -> tuple[ConvexProgramme, Array, Array]:
    """Return a programme that can follow a path, weights, and path samples."""
    for n_basis in smoothing.n_basis:
        programme = _programme(search, boundary, n_basis)
        curves = programme.curves
        n_fine, n_columns = curves.fine.base.shape
        fine = np.linspace(0.0, N_STEPS - 1, n_fine)
        reference = interpolated(fine, np.arange(float(N_STEPS)), way[:, :n_columns])
        for ridge in smoothing.ridges:
            z = curves.fit(reference, ridge)
            off = np.abs((curves.fine.q(z) - reference) / programme.watched.scale[:n_columns]).max()
            if off < smoothing.near:
                return programme, z, reference
    return programme, z, reference


def smooth_demonstration(
    search: Search, taught: tuple[DMP, ...], smoothing: SmoothingSettings = SETTINGS
) -> bool:
    """Adapt the demonstration to the scene; return whether the motion is verified."""
    scene = search.scene
    basis, coordinates = motion_basis(smoothing.n_basis[-1], "jerk"), load_coordinates(scene)
    dmp = CoordinatedDMP.from_demonstration(taught, scene, coordinates, basis)
    return _verified(
        search, _programme(search, dmp.boundary, smoothing.n_basis[-1]), dmp.weights.ravel(), None, smoothing
    )


def follows(search: Search) -> bool:
    """Return whether motions are to resemble the demonstration."""
    return search.aim.is_smooth and search.aim.pull(search.taught is not None) > 0


def least_worth(search: Search) -> float:
    """Return a lower bound of the objective: 1, that of straight motions, if only jerk counts; else 0."""
    own = search.own is not None and search.own.function is not None
    return 0.0 if own or follows(search) else search.aim.least


def _programme(search: Search, boundary: Array, n_basis: int) -> ConvexProgramme:
    scene = search.scene
    peaky = min(scene.acceleration_limit, scene.jerk_limit) < np.inf  # such limits are used to the full
    n_coarse = 201 if peaky else 101
    return ConvexProgramme(
        scene, load_coordinates(scene), motion_basis(n_basis, "jerk"), boundary, n_coarse=n_coarse
    )


def _squares(search: Search, smooth: LeastJerk, n_samples: int) -> JerkCost:
    objective = search.objective
    return squares(search.scene, smooth, objective.demonstration, n_samples, objective.precision)


def _verified(
    search: Search,
    programme: ConvexProgramme,
    z: Array,
    reference: Array | None,
    smoothing: SmoothingSettings,
) -> bool:
    """Optimise with growing margins, then for time if needed; return success."""
    smooth = search.aim.smoothness
    settings = replace(_convex(search, smoothing), wish=smooth.wish)
    cost = _squares(search, smooth, len(programme.curves.coarse.base))
    if cost.precision is not None:  # steep valleys and flat grounds: begin near the best, or be stuck
        even = replace(cost, precision=None)
        z, reference = _optimised(search, programme, even, z, settings, reference), None
        search.judge(programme.curves.motion(z))
    known = search.found.best_cost if search.own is None and smooth is search.aim else np.inf
    for attempt in range(smoothing.attempts):
        z = _optimised(search, programme, cost, z, settings, reference, known)
        verdict, reference = search.judge(programme.curves.motion(z)), None
        verified = verdict.verified is not None
        if verdict.report.clearance_min < search.scene.clearance - smoothing.hopeless:
            return False
        if verified or too_fast(programme, z, smoothing):
            break
        settings = _stricter(settings, attempt, smoothing)
        programme.limits = programme.limits.stricter(verdict.report.limit_ratios(search.scene))
    # For equation (4) another path costs less time.
    hasty = search.aim.is_time or (
        search.aim.is_smooth and not verified and too_fast(programme, z, smoothing)
    )
    if hasty and not search.scene.moving.any():  # at another pace, things that move would be elsewhere
        detail = smoothing.fast if search.aim.is_time else smoothing.fastest  # what a message names must do
        return hurry(search, programme.curves.motion(z), detail, smoothing) or verified
    return verified


def _carried(
    search: Search,
    programme: ConvexProgramme,
    z: Array,
    reference: Array,
    smoothing: SmoothingSettings,
) -> bool:
    """Optimise a motion that the kinematics can execute; return whether it is verified.

    The smoothest motion of all comes first, then the smoothest that the follower accepts; after each rejection, end
    effectors are drawn more strongly to their planned positions. While there is no motion at all, though, the one
    nearest to the planned path comes before all others, unless its bends would decide the duration. Last, motions are
    drawn to the demonstration as far as the kinematics can follow.
    """
    nodes, hands = programme.curves.hands(reference)
    anchor = np.ascontiguousarray(hands[:: (len(hands) - 1) // (len(programme.curves.coarse.base) - 1)])
    aim = search.aim.smoothness
    taught, smooth = _squares(search, aim, len(anchor)), squares(search.scene, aim, None, len(anchor))
    settings, found = replace(_convex(search, smoothing), wish=aim.wish), False
    along: Array | None = reference
    at: Array | None = None
    if search.found.best is None and not search.paced:
        nearest = _optimised(
            search, programme, Anchored(smooth, anchor, smoothing.pulls[-1]), z, settings, reference
        )
        found = search.judge(programme.curves.motion(nearest)).verified is not None
    free = _optimised(search, programme, smooth, z, settings, reference)
    least, _ = programme.value(smooth, free, 0.0)
    known = search.found.smoothest if taught.demonstration is not None else ()
    if any(abs(least - other) < smoothing.alike * other for other in known) or _is_outdone(
        search, programme, free
    ):
        return True
    programme.follower = search.kinematics.along(nodes)
    if programme.is_followed(free) and search.judge(programme.curves.motion(free)).verified is not None:
        at = free
    for pull in smoothing.pulls if at is None else ():
        z = _optimised(search, programme, Anchored(smooth, anchor, pull), z, settings, along)
        if _is_outdone(search, programme, z):  # the next ones are drawn away further
            return True
        verdict, along = search.judge(programme.curves.motion(z)), None
        if verdict.verified is not None:
            at = z
            break
        if not programme.is_followed(z):  # it asks for too much: arms are thinner than what stands for them
            programme.follower = None
        elif verdict.report.clearance_min < search.scene.clearance:
            settings = _stricter(settings, 0, smoothing)
        elif programme.follower is not None:
            programme.follower = programme.follower.stricter()
    if at is None:
        return found
    search.found.smoothest.append(least)
    if taught.demonstration is None:
        return True
    jerk, _ = programme.value(smooth, at, 0.0)
    if any(abs(jerk - other) < smoothing.alike * other for other in search.found.drawn):
        return True
    search.found.drawn.append(jerk)
    # With all of its weight, arms would be stretched further, and take longer.
    nearer = replace(settings, radius=smoothing.again, least=smoothing.roughly)
    for share in smoothing.shares[:1] if search.paced else smoothing.shares:
        cost = replace(taught, pull=share * taught.pull)
        ahead = _optimised(search, programme, cost, at, nearer)
        parts = (at + part * (ahead - at) for part in smoothing.parts)
        at = next((z for z in parts if search.judge(programme.curves.motion(z)).verified is not None), at)
    return True


def _is_outdone(search: Search, programme: ConvexProgramme, z: Array) -> bool:
    """Return whether a motion is no better than the best one.

    Where only jerk counts, less smooth ones are not either.
    """
    own = search.own is not None and search.own.function is not None
    if own or not search.aim.is_smooth or follows(search):
        return False
    return search.worth(programme.curves.motion(z)) >= search.found.best_cost


def _optimised(
    search: Search,
    programme: ConvexProgramme,
    cost: SumOfSquares,
    z: Array,
    settings: ConvexSettings,
    reference: Array | None = None,
    known: float = np.inf,
) -> Array:
    """Optimise shape weights by `optimise` while there is time; return the best."""
    search.check_time()
    outcome = optimise(programme, cost, z, settings, reference, search.over, known)
    search.count(outcome.iterations, STEP)
    search.clock.add_work(outcome.programmes * PROGRAMME * programme.curves.n)
    search.tell(outcome.value, outcome.missed)
    return outcome.z


def cheaper(search: Search, dmp: CoordinatedDMP, smoothing: SmoothingSettings = SETTINGS) -> None:
    """Optimise a motion along its path by equation (4), and verify it."""
    scene, weights, taught = search.scene, search.objective.weights, search.objective.demonstration
    if taught is not None:
        taught = taught[..., : scene.n_dims].reshape(N_STEPS, -1) if weights.resemblance > 0 else None
    # More weights bend between samples, where neither speeds nor lengths of quaternions are evaluated.
    basis = search.basis(min(dmp.basis.n_basis, smoothing.n_basis[-1]), "velocity")
    programme = ConvexProgramme(scene, dmp.coordinates, basis, dmp.boundary, n_coarse=N_STEPS)
    terms = weights.goal, weights.velocity, weights.resemblance
    cost, settings = PaperSquares(terms, scene.goal.ravel(), taught), replace(smoothing.convex, wish=0.0)
    z = _refitted(programme, dmp.rollout(), smoothing)
    z = _optimised(search, programme, cost, z, smoothing.convex)  # away from obstacles that hold it fast
    for attempt in range(smoothing.attempts):
        z = _optimised(search, programme, cost, z, settings)
        verdict = search.judge(programme.curves.motion(z))
        if verdict.verified is not None:
            return
        settings = _stricter(settings, attempt, smoothing)
        noticed = 1.003 + settings.unnoticed
        programme.limits = programme.limits.stricter(verdict.report.limit_ratios(scene), noticed)


def _refitted(programme: ConvexProgramme, motion: CoordinatedMotion, smoothing: SmoothingSettings) -> Array:
    """Return the shape weights that are nearest to a motion."""
    times = np.linspace(0.0, 1.0, len(programme.curves.fine.base))
    return programme.curves.fit(motion.at(times)[0], smoothing.ridges[-1])


def too_fast(programme: ConvexProgramme, z: Array, smoothing: SmoothingSettings) -> bool:
    """Return whether limits are exceeded, by more than the sampling error."""
    _, hands = programme.curves.hands(programme.curves.coarse.q(z))
    return programme.limits.excess(hands) > smoothing.unmet


def hurry(
    search: Search,
    motion: CoordinatedMotion,
    detail: tuple[int, int],
    smoothing: SmoothingSettings = SETTINGS,
) -> bool:
    """Make a motion as fast as possible; return whether it is verified.

    If the given duration is too short for it, a sufficient one is noted in `search.found.needed`.

    Parameters
    ----------
    detail : shape weights a column, and samples at which limits are evaluated
    """
    search.journal.stage = "gaining time"
    n_basis, n_coarse = detail
    n_basis = min(n_basis, max(smoothing.fast[0], smoothing.most_weights // motion.coordinates.n_columns))
    coordinates, basis = motion.coordinates, motion_basis(n_basis, "jerk")
    limits = search.limits or Limits.of(search.scene, search.scene.duration)
    programme = ConvexProgramme(
        search.scene, coordinates, basis, motion.boundary, n_coarse=n_coarse, limits=limits
    )
    z, curves = _refitted(programme, motion, smoothing), programme.curves
    _, hands = curves.hands(curves.coarse.q(z))
    gentle = squares(search.scene, LeastJerk(), None)
    jerk, pace = gentle.value(hands), limits.pace(hands)
    if not (jerk > 0 and pace > 0):
        return False
    cost = replace(gentle, weight=smoothing.gentle / jerk, haste=1.0 / pace)
    settings = replace(_convex(search, smoothing), wish=0.0, most=smoothing.faster)
    for attempt in range(smoothing.attempts):
        z = _optimised(search, programme, cost, z, settings)
        motion = curves.motion(z)
        if search.judge(motion).verified is not None:
            return True
        if _note_slower(search, motion):
            return False
        settings = _stricter(settings, attempt, smoothing)
    return False


def _note_slower(search: Search, motion: CoordinatedMotion) -> bool:
    """Note a duration in which a too fast motion is verified; return success."""
    asked = search.asked or search.scene
    if not (asked.is_timed and asked.is_limited) or asked.moving.any() or search.kinematics.has_limits:
        return False
    slower = in_least_time(motion, asked)
    if slower.scene.duration <= asked.duration or verify(slower, search.checks).verified is None:
        return False
    search.found.needed = min(slower.scene.duration, search.found.needed)
    return True


def _convex(search: Search, smoothing: SmoothingSettings) -> ConvexSettings:
    """Return the settings of a search's programmes, by its effort."""
    settings, gain = smoothing.convex, search.level.gain
    return settings if gain is None else replace(settings, gain=gain)


def _stricter(settings: ConvexSettings, attempt: int, smoothing: SmoothingSettings) -> ConvexSettings:
    """Return settings with wider margins, for the next try after a rejection."""
    more = attempt + 1
    return replace(
        settings,
        radius=smoothing.again,
        margin=smoothing.convex.margin + more * smoothing.more,
        border_margin=smoothing.convex.border_margin + more * smoothing.more_border,
    )
