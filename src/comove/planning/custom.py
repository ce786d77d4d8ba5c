"""Constrained CMA-ES for functions of the user and sampled constraints."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from comove.arrays import Array
from comove.dmp.basis import motion_basis, rollouts
from comove.model.constraints import Constraint
from comove.model.coordinated_dmp import CoordinatedDMP
from comove.model.coordinates import load_coordinates
from comove.model.motion import CoordinatedMotion
from comove.planning.convex.limits import Limits
from comove.planning.objective import N_STEPS
from comove.planning.objectives.own import OwnFunctions, Samples
from comove.planning.search import Search

if TYPE_CHECKING:
    from comove.optim import Minimiser


@dataclass(frozen=True)
class CustomSettings:
    """Settings of the search with sampled functions.

    Attributes
    ----------
    n_basis, n_free : shape weights a column, and those that are changed: the smoothest
    sigma : first step size, by which the middle of a motion moves [m]
    margins : margins beyond the scene's clearance and constraints, one after the other after rejections [m]
    scale : missing clearance that counts as much as a limit exceeded by 100 % [m]
    runs, worth_another : runs at most, and the relative gain after which another run follows
    patience, gain : a run ends after `patience` generations without a relative gain of `gain`
    """

    n_basis: int = 24
    n_free: int = 8
    sigma: float = 0.02
    margins: tuple[float, ...] = (5e-4, 2e-3, 5e-3)
    scale: float = 0.01
    runs: int = 12
    worth_another: float = 0.01
    patience: int = 60
    gain: float = 1e-3


SETTINGS = CustomSettings()


def improve_own(
    search: Search, own: OwnFunctions, start: CoordinatedMotion, settings: CustomSettings = SETTINGS
) -> bool:
    """Improve a motion by the user's functions; return whether one was verified.

    A run that has converged is restarted from its result, as long as restarts improve the objective.
    """
    margins, verified, before = iter(settings.margins), False, np.inf
    margin = next(margins)
    for _ in range(settings.runs):
        start = _minimised(search, own, start, margin, settings)
        if search.judge(start).verified is None:
            wider = next(margins, None)
            if wider is None:
                break
            margin = wider
            continue
        verified, value = True, search.worth(start)
        if search.over() or (np.isfinite(before) and value > before - settings.worth_another * abs(before)):
            break
        before = value
    return verified


@dataclass(frozen=True, eq=False)
class _Variations:
    """Variations of a motion for CMA-ES, as changes of the free weights.

    Attributes
    ----------
    search, own : the search, and the user's functions
    start : the motion
    margin : margin of the constraints [m]
    settings : settings of the search
    """

    search: Search
    own: OwnFunctions
    start: CoordinatedMotion
    margin: float
    settings: CustomSettings

    @cached_property
    def kept(self) -> list[tuple[Constraint, float]]:
        """Return the sampled constraints and their admissible errors."""
        scene = self.search.scene
        ends = np.stack([scene.nodes_at(end)[: len(scene.manipulators)] for end in ("start", "goal")])
        # What an end needs of a tolerance no margin can keep.
        return [(c, max(c.tolerance - self.margin, c.error(ends, scene.n_dims).max())) for c in scene.sampled]

    @property
    def width(self) -> int:
        """Return the number of coordinates of a point."""
        return int(self.start.coordinates.search.shape[1]) * self.settings.n_free

    def moved(self, x: Array) -> Array:
        """Return the weights of a population, (n_points, n) -> (n_points, n_columns, n_basis)."""
        all_weights, n_free = np.repeat(self.start.weights[None], len(x), axis=0), self.settings.n_free
        all_weights[:, :, :n_free] += self.start.coordinates.search @ x.reshape(len(x), -1, n_free)
        return all_weights

    def values(self, x: Array) -> tuple[Array, Array]:
        """Return objectives, (n_points,), and constraints, (n_points, n): clearance, limits, the user's."""
        search, scene, start, scale = self.search, self.search.scene, self.start, self.settings.scale
        population = self.moved(x)
        motions = [replace(start, weights=own_weights) for own_weights in population]
        q = rollouts(start.basis, start.boundary, population, N_STEPS)
        clearance = search.objective.evaluate(q).clearance
        hands = start.coordinates.nodes(q)[:, :, : len(scene.manipulators)]
        flat = hands[..., : scene.n_dims].reshape(len(x), N_STEPS, -1)
        search.count(len(x))
        samples = [Samples.of(search.handed(motion)) for motion in motions]
        limits = Limits.of(scene, scene.duration)
        fixed = np.column_stack(
            [
                (scene.clearance + self.margin - clearance) / scale,
                [limits.excess(own_hands) for own_hands in flat],
                *(
                    [(c.error(one, scene.n_dims).max() - most) / scale for one in hands]
                    for c, most in self.kept
                ),
            ]
        )
        costs = [
            self.own.value(one) if self.own.function else search.worth(m)
            for one, m in zip(samples, motions, strict=True)
        ]
        own = np.stack([self.own.violations(one) for one in samples])
        return np.array(costs), np.column_stack([fixed, own])


def _with_free_weights(search: Search, start: CoordinatedMotion, n_basis: int) -> CoordinatedMotion:
    basis = motion_basis(n_basis, "jerk")
    s = np.linspace(0.0, 1.0, len(basis.shape[0]))
    coordinates = load_coordinates(search.scene)
    dmp = CoordinatedDMP(search.scene, coordinates, basis, start.boundary, start.weights)
    return dmp.fitted(s, start.at(s)[0]).rollout()


def _minimised(
    search: Search, own: OwnFunctions, start: CoordinatedMotion, margin: float, settings: CustomSettings
) -> CoordinatedMotion:
    """Return the best motion of one run of CMA-ES from a motion."""
    free = _with_free_weights(search, start, settings.n_basis)
    about = _Variations(search, own, free, margin, settings)
    known: dict[bytes, tuple[Array, Array]] = {}

    def cached(x: Array) -> tuple[Array, Array]:
        key = x.tobytes()
        if key not in known:
            known.clear()
            known[key] = about.values(x)
        return known[key]

    waited, reference = 0, np.inf

    def over(state: Minimiser) -> bool:
        nonlocal waited, reference
        best = state.best_fun
        search.tell(float(best), 0.0)
        waited += 1
        if best < reference - settings.gain * abs(reference) or not np.isfinite(reference):
            waited, reference = 0 if np.isfinite(best) else waited, min(best, reference)
        enough = np.isfinite(best) or search.found.best is not None
        return search.over() or (waited >= settings.patience and bool(enough))

    from comove.optim import minimise  # slow to import

    found = minimise(
        lambda x: cached(x)[0],
        np.zeros(about.width),
        settings.sigma,
        constraints=lambda x: cached(x)[1],
        seed=int(search.rng.integers(2**31)),
        callback=over,
    )
    return replace(about.start, weights=about.moved(found.x[None])[0])
