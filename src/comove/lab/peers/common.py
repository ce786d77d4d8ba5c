"""Base class of peers, with clearances, first guess and time law. `Best` keeps the best candidate."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import import_module
from importlib.metadata import packages_distributions, version
from types import ModuleType
from typing import ClassVar

import numpy as np

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.dmp.basis import motion_basis
from comove.errors import ExtraError
from comove.geometry.distances import configuration_distance
from comove.lab.systems import Offers, System, SystemProblem, cost_of
from comove.model.constraints import DistanceConstraint, SeparationConstraint
from comove.model.coordinated_dmp import CoordinatedDMP
from comove.model.coordinates import load_coordinates
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.model.shapes import spatial
from comove.planning.seeds import minimum_jerk, steady
from comove.verification.record import END_SPEED

DIFFERENCE = 1e-6  # m, of slopes


class PeerOutOfTime(Exception):
    """Signal that the budget of a peer is used up."""


def needed(name: str) -> ModuleType:
    """Import a module that `comove[bench]` installs."""
    try:
        return import_module(name)
    except ImportError as error:
        raise ExtraError(f"the peer '{name.split('.')[0]}'", "bench") from error


class Peer(System):
    """System based on another tool.

    Attributes
    ----------
    modules : names of the modules that it needs
    """

    modules: ClassVar[tuple[str, ...]]

    @property
    def version(self) -> str:
        """Return the versions of its packages, empty where not installed."""
        of_modules = packages_distributions()
        packages = {p for name in self.modules for p in of_modules.get(name.split(".")[0], ())}
        return ", ".join(sorted(f"{package} {version(package)}" for package in packages))

    def refuses(self, scene: Scene) -> str:
        """Return why peers cannot represent the scene; empty if they can."""
        if scene.moving.any():
            return "It knows only obstacles that stand still."
        if scene.body.n_nodes > len(scene.manipulators):
            return "It moves hands, which do not tell how this load is turned."
        if not all(isinstance(c, (DistanceConstraint, SeparationConstraint)) for c in scene.constraints):
            return "It is told of distances and separations of hands, and of no other constraint."
        return ""

    def warm_up(self, problem: SystemProblem) -> None:
        """Import the modules and compile the kernels of distances."""
        for name in self.modules:
            needed(name)
        clearances(problem.scene, problem.scene.start[None])


def independent_distances(scene: Scene) -> list[DistanceConstraint]:
    """Return the distances without those that follow from others. The end effectors are at the start."""
    rows: list[Array] = []
    kept: list[DistanceConstraint] = []
    for c in scene.distances:
        row = np.zeros_like(scene.start)
        row[c.first] = scene.start[c.first] - scene.start[c.second]
        row[c.second] = -row[c.first]
        if np.linalg.matrix_rank(np.array([*rows, row.ravel()]), tol=1e-6) > len(rows):
            rows.append(row.ravel())
            kept.append(c)
    return kept


def first_hands(problem: SystemProblem, s: Array) -> Array:
    """Return the first guess of peers that improve a movement. It is the demonstration, or else the payload moved
    straight and rotated evenly.

    Parameters
    ----------
    s : array, shape (n_steps,), shares of the duration

    Returns
    -------
    array, shape (n_steps, n_manipulators, n_dims), [m]; the constraints between end effectors hold along it
    """
    scene = problem.scene
    if problem.demonstration is None:
        return CoordinatedMotion.straight(scene).hands(s)[0]
    taught = CoordinatedDMP.from_demonstration(
        problem.demonstration, scene, load_coordinates(scene), motion_basis(30, "velocity")
    )
    return taught.rollout().hands(s)[0]


def moved_aside(hands: Array, size: float, rng: np.random.Generator) -> Array:
    """Move all end effectors together by a few random waves. Array, shape (n_steps, n_manipulators, n_dims)."""
    n_waves = 3
    s, n_dims = np.linspace(0.0, np.pi, len(hands)), hands.shape[2]
    waves = np.sin(s[:, None] * np.arange(1, n_waves + 1)) / np.arange(1, n_waves + 1)
    return hands + (waves @ rng.normal(0.0, size, (n_waves, n_dims)))[:, None]


def growing(size: float, most: float) -> Iterator[float]:
    """Yield sizes of random changes, doubled up to `most`."""
    while True:
        yield size
        size = min(2.0 * size, most)


@kernel
def _clearances(
    nodes: Array, edges: Integers, radii: Array, table: Array, lower: Array, upper: Array
) -> Array:
    result = np.empty(nodes.shape[0])
    for t in range(nodes.shape[0]):
        result[t] = configuration_distance(nodes[t], edges, radii, table, lower, upper)[0]
    return result


def clearances(scene: Scene, hands: Array) -> Array:
    """Return the payload's signed distances from obstacles, shape (n_steps,) [m].

    Parameters
    ----------
    hands : array, shape (n_steps, n_manipulators, n_dims) [m]
    """
    body = scene.body
    return _clearances(spatial(hands), body.edges, body.radii, scene.obstacles, *scene.workspace)


def clearance_slopes(scene: Scene, hands: Array) -> Array:
    """Return the derivatives of `clearances` by the end effectors. Array, shape (n_steps, n_manipulators, n_dims)."""
    aside = DIFFERENCE * np.eye(hands[0].size).reshape(-1, *hands.shape[1:])
    moved = hands[:, None, None] + np.stack([aside, -aside])
    found = clearances(scene, moved.reshape(-1, *hands.shape[1:])).reshape(len(hands), 2, *hands.shape[1:])
    return (found[:, 0] - found[:, 1]) / (2 * DIFFERENCE)


def kept_clearance(scene: Scene, most: float) -> float:
    """Return a clearance margin for motion between samples [m].

    Parameters
    ----------
    most : largest margin [m]; half of the excess clearance of the ends, if that is less
    """
    ends = float(clearances(scene, np.stack([scene.start, scene.goal])).min())
    return max(0.0, min(most, 0.5 * (ends - scene.clearance)))


def violation(problem: SystemProblem, hands: Array) -> float:
    """Return the largest violation at the samples [m], [m/s] or [m/s^2]. It is at most 0 if there is none. This is a
    peer's own check of a candidate; only the verification covers the time between the samples.

    Parameters
    ----------
    hands : array, shape (n_steps, n_manipulators, n_dims), even in time [m]
    """
    scene = problem.scene
    step = scene.duration / (len(hands) - 1)
    missed = [scene.clearance - clearances(scene, hands).min()]
    for c in scene.constraints:
        if isinstance(c, (DistanceConstraint, SeparationConstraint)):
            apart = np.linalg.norm(hands[:, c.first] - hands[:, c.second], axis=1)
            if isinstance(c, DistanceConstraint):
                missed.append(np.abs(apart - c.distance).max() - c.tolerance)
            else:
                missed.append(c.least - apart.min())
    velocity = np.diff(hands, axis=0, prepend=hands[:1]) / step
    missed.append(np.linalg.norm(velocity, axis=2).max() - scene.speed_limit)
    missed.append(np.linalg.norm(velocity[-1], axis=1).max() - END_SPEED)
    changes = np.diff(velocity, axis=0) / step
    missed.append(np.linalg.norm(changes, axis=2).max() - scene.acceleration_limit)
    return float(np.max(missed)) if np.isfinite(hands).all() else np.inf


class Best:
    """Best candidate so far, offered when feasible and clearly cheaper.

    Parameters
    ----------
    problem : problem that is solved
    offers : record of the offers
    better : cost relative to the last offer below which there is another
    """

    def __init__(self, problem: SystemProblem, offers: Offers, better: float = 0.99):
        self.problem, self.offers, self.better = problem, offers, better
        self.rank, self.seconds = (np.inf, np.inf), 0.0
        self.hands: Array | None = None
        self.offered: tuple[float, Array | None] = np.inf, None

    def see(self, hands: Array, seconds: float | None = None) -> bool:
        """Check a candidate; return whether it looks feasible. The candidate is given at the problem's instants.
        `seconds` is when it was found; by default now."""
        missed, cost = violation(self.problem, hands), float(cost_of(self.problem.scene, hands))
        rank = (max(missed, 0.0), cost)
        if self.hands is None or rank < self.rank:
            self.rank, self.hands = rank, hands
            self.seconds = self.offers.seconds if seconds is None else seconds
            if missed <= 0.0 and cost < self.better * self.offered[0]:
                self.close()
        return missed <= 0.0

    def close(self) -> None:
        """Offer the best candidate, unless it was the last offer."""
        if self.hands is not None and self.hands is not self.offered[1]:
            self.offered = self.rank[1], self.hands
            self.offers.take(self.hands, self.seconds)


def timed(hands_at: Callable[[Array], Array], problem: SystemProblem, n_places: int = 4001) -> Array:
    """Return a path with a time law, from rest to rest.

    The speed along its length is that of minimum jerk. If that is too fast, the speed is constant except for ramps
    at both ends, as short as the limits allow. Length is that of the end effector that moves most, so that no end
    effector is faster than the path.

    Parameters
    ----------
    hands_at : function from shares of the path, (n,), to end effectors, (n, n_manipulators, n_dims) [m]; any spacing
        of shares
    n_places : points along the path at which its length is measured

    Returns
    -------
    array, shape (N_SAMPLES, n_manipulators, n_dims), [m]
    """
    shares = np.linspace(0.0, 1.0, n_places)
    steps = np.linalg.norm(np.diff(hands_at(shares), axis=0), axis=2).max(axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    if length[-1] == 0.0:
        return hands_at(np.zeros_like(problem.instants))
    scene, s = problem.scene, problem.instants
    travelled = minimum_jerk(s)
    fastest = 0.98 * scene.speed_limit * scene.duration / length[-1]  # in lengths a duration
    if fastest < 1.875:
        ramp = min(max(1.0 - 1.0 / fastest, 0.05), 0.5)
        travelled = steady(s, ramp)
    return hands_at(np.interp(travelled * length[-1], length, shares))
