"""OMPL's sampling-based planners, for payload poses or end-effector manifolds.

They return a path, to which a time law is added: from rest to rest with the speed of minimum jerk along its length.
States keep a margin of half of the checked step (5 mm) from everything, and along a motion no point of the payload
moves further than that step between two states, so that no collision is missed in between.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import sqrt
from typing import Any, Literal

import numpy as np

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.lab.peers.common import Best, Peer, independent_distances, needed, timed
from comove.lab.systems import Offers, SystemProblem
from comove.model.blocks import Unmasked, width_of
from comove.model.coordinates import ANGLE, QUATERNION, Blocks, load_coordinates, place, write_pose
from comove.model.scene import Scene
from comove.planning.configurations import Space, clearance_of, configuration_space, interpolate, span
from comove.planning.planner import along
from comove.trajectory import interpolated

MODULES = ("ompl.base", "ompl.geometric", "ompl.util")


@dataclass(frozen=True)
class OmplSettings:
    """Settings of the planners.

    Attributes
    ----------
    step : distance between the states that are checked along a motion [m]
    range : length of a motion that a tree grows by [m]: better in all scenes tried than OMPL's choice (0.35 to 0.41)
    shorter : length relative to the last noted path below which another is noted
    projections : largest number of steps of Newton's method onto the manifold
    simplifying : largest share of the budget for simplification
    """

    step: float = 0.005
    range: float = 0.2
    shorter: float = 0.99
    projections: int = 20
    simplifying: float = 0.2


SETTINGS = OmplSettings()


@dataclass(frozen=True)
class OMPL(Peer):
    """Planner in SE(2) or SE(3) with a travel-bounding metric. The metric bounds the travel of the farthest end
    effector.

    Attributes
    ----------
    planner : its name in `ompl.geometric`
    then : treatment of its path: offered as found, or simplified first, or improved for the whole budget
    settings : settings of the planner
    """

    name: str
    planner: str
    then: Literal["offer", "simplify", "improve"]
    settings: OmplSettings = SETTINGS
    modules = MODULES

    def refuses(self, scene: Scene) -> str:
        """Return why a single-payload planner does not suit the scene. It is empty if it does."""
        if len(scene.groups) > 1 or scene.groups[0].orientation not in ("plane", "axis", "space"):
            return "It plans for one load that all hands hold and that may turn freely."
        return super().refuses(scene)

    def warm_up(self, problem: SystemProblem) -> None:
        """Import OMPL and compile the kernels of its checks."""
        super().warm_up(problem)
        load = OmplLoad(problem.scene, self.settings.step)
        motion_is_free(load.space, load.start, load.goal, load.step, load.margin)
        load.hands(np.stack([load.start, load.goal]), np.zeros(1))

    def run(self, problem: SystemProblem, offers: Offers) -> None:
        """Plan, and offer the path with a time law. An improving planner offers paths as they become shorter."""
        base = needed("ompl.base")
        _quiet(problem.seed)
        load = OmplLoad(problem.scene, self.settings.step)
        space = _pose_space(base, load)
        information = base.SpaceInformation(space)
        information.setStateValidityChecker(lambda state: load.is_free(load.read(state)))
        information.setMotionValidator(_validator(base, information, load))
        information.setup()
        ends = [_write(space, load, q) for q in (load.start, load.goal)]
        planning = OmplPlanning(problem, offers, information, self.planner, ends, self.settings)
        found: list[tuple[float, float, Array]] = []

        def note() -> None:
            path = planning.path
            if not found or path.length() < self.settings.shorter * found[-1][1]:
                found.append((offers.seconds, path.length(), load.path(path)))

        improves = self.then == "improve"
        if not planning.solve(note if improves else lambda: None):
            return
        if self.then == "simplify":
            planning.simplify()
        note()
        best = Best(problem, offers)
        for seconds, _, path in found:
            best.see(timed(partial(load.hands, path), problem), seconds if improves else None)
        best.close()


@dataclass(frozen=True)
class ProjectedOMPL(Peer):
    """RRTConnect on the manifold of fixed distances, by projection.

    Attributes
    ----------
    settings : settings of the planner
    """

    name: str
    settings: OmplSettings = SETTINGS
    modules = MODULES

    def refuses(self, scene: Scene) -> str:
        """Return why the scene does not suit; empty if it does."""
        if not scene.distances:
            return "No distance ties the hands, so that there is nothing to project on."
        return super().refuses(scene)

    def warm_up(self, problem: SystemProblem) -> None:
        """Import OMPL and compile the kernels of its checks."""
        super().warm_up(problem)
        start = problem.scene.start.ravel()
        _free_hands(problem.scene, self.settings.step)(start)
        Manifold(problem.scene, self.settings.projections).project(start, 0.0)

    def run(self, problem: SystemProblem, offers: Offers) -> None:
        """Plan, simplify, and offer both paths."""
        base, geometric = needed("ompl.base"), needed("ompl.geometric")
        _quiet(problem.seed)
        scene, settings, n = problem.scene, self.settings, problem.scene.start.size
        manifold, free = Manifold(scene, settings.projections), _free_hands(scene, settings.step)
        ambient = base.RealVectorStateSpace(n)
        ambient.setBounds(
            _bounds(base, *(np.tile(border, len(scene.start)) for border in (scene.lower, scene.upper)))
        )
        space = base.ProjectedStateSpace(ambient, _constraint(base, manifold))
        information = base.ConstrainedSpaceInformation(space)
        space.setDelta(settings.step)

        def read(state: Any) -> Array:
            return np.array([state[i] for i in range(n)])

        information.setStateValidityChecker(lambda state: free(read(state)))
        information.setup()
        ends = []
        for hands in (scene.start, scene.goal):
            ends.append(space.allocState())
            ends[-1].copy(hands.ravel())
        planning = OmplPlanning(problem, offers, information, "RRTConnect", ends, settings)
        best = Best(problem, offers)
        for simplified in (False, True) if planning.solve() else ():
            if simplified:
                planning.simplify()
            path = geometric.PathGeometric(planning.path)  # a copy, which is filled up along the manifold
            path.interpolate()
            states, seconds = np.array([read(state) for state in path.getStates()]), offers.seconds
            best.see(timed(partial(manifold.hands, states), problem), seconds)
        best.close()


class OmplPlanning:
    """Planner set up on a problem.

    Parameters
    ----------
    information : OMPL's space information
    planner : its name in `ompl.geometric`
    ends : first and last state
    settings : settings of the planner
    """

    def __init__(
        self,
        problem: SystemProblem,
        offers: Offers,
        information: Any,
        planner: str,
        ends: list[Any],
        settings: OmplSettings,
    ):
        base, geometric = needed("ompl.base"), needed("ompl.geometric")
        self.problem, self.offers, self.information, self.settings = problem, offers, information, settings
        self.wanted = base.ProblemDefinition(information)
        self.wanted.setStartAndGoalStates(*ends)
        self.wanted.setOptimizationObjective(base.PathLengthOptimizationObjective(information))
        self.planner = getattr(geometric, planner)(information)
        self.planner.setProblemDefinition(self.wanted)
        self.planner.setRange(settings.range)
        self.planner.setup()

    @property
    def path(self) -> Any:
        """Return the current path."""
        return self.wanted.getSolutionPath()

    def solve(self, note: Callable[[], None] = lambda: None) -> bool:
        """Plan until the planner or budget ends; return whether a path exists. Once there is a path, `note` is
        called at every termination check of the planner, after every small step."""

        def stop() -> bool:
            if self.wanted.hasExactSolution():
                note()
            return self.offers.seconds > self.problem.budget

        self.planner.solve(needed("ompl.base").PlannerTerminationCondition(stop))
        return bool(self.wanted.hasExactSolution())

    def simplify(self) -> None:
        """Shorten the current path."""
        budget, begun = self.problem.budget, self.offers.seconds
        until = min(begun + self.settings.simplifying * budget, budget)
        ended = needed("ompl.base").PlannerTerminationCondition(lambda: self.offers.seconds > until)
        needed("ompl.geometric").PathSimplifier(self.information).simplify(self.path, ended)


class OmplLoad:
    """Payload in OMPL's coordinates. They are x, y and an angle, or x, y, z and a quaternion w x y z.

    Parameters
    ----------
    scene : scene whose payload is held by all end effectors
    step : distance between the states that are checked along a motion [m]

    Attributes
    ----------
    space : configuration space for the kernels of `comove.planning.configurations`, which interpolate like OMPL
    start, goal : arrays, shape (3,) or (7,)
    reach : distance of the farthest end effector from the centre [m]
    margin : clearance that states keep [m]
    """

    def __init__(self, scene: Scene, step: float):
        (group,) = scene.groups
        self.scene, self.n_dims, self.step = scene, scene.n_dims, step
        kind = ANGLE if self.n_dims == 2 else QUATERNION
        blocks = Blocks(
            np.array([kind], dtype=np.int64),
            np.arange(3, dtype=np.int64)[None] % (self.n_dims + 1),
            np.array([self.n_dims], dtype=np.int64),
            np.array([0, len(group.points)], dtype=np.int64),
            np.array(scene.nodes_of_groups[0], dtype=np.int64),
            np.ascontiguousarray(group.points),
            self.n_dims,
            *Unmasked.of(self.n_dims + width_of(kind, self.n_dims), 1),
        )
        self.space: Space = configuration_space(scene, load_coordinates(scene))._replace(blocks=blocks)
        self.start, self.goal = (write_pose(kind, pose, self.n_dims) for pose in (group.start, group.goal))
        self.reach, self._nodes = float(group.reach), np.zeros((scene.body.n_nodes, 3))
        ends = min(clearance_of(self.space, q, self._nodes, -1.0) for q in (self.start, self.goal))
        self.margin = _margin(scene, ends, step)

    def is_free(self, q: Array) -> bool:
        """Return whether a state keeps the margin."""
        return clearance_of(self.space, q, self._nodes, self.margin) > self.margin

    def read(self, state: Any) -> Array:
        """Convert a state of OMPL to an array."""
        if self.n_dims == 2:
            return np.array([state.getX(), state.getY(), state.getYaw()])
        turn = state.rotation()
        return np.array([state.getX(), state.getY(), state.getZ(), turn.w, turn.x, turn.y, turn.z])

    def path(self, path: Any) -> Array:
        """Return the states of a path, including the start. AORRTC (OMPL 2.0.1) omits the start if the path from it
        is free."""
        states = np.array([self.read(state) for state in path.getStates()])
        begins = span(self.space, self.start, states[0]) < 1e-9
        return states if begins else np.concatenate([self.start[None], states])

    def hands(self, path: Array, shares: Array) -> Array:
        """Return end effectors at shares of a path [m]. The shapes are (n_states, n_columns), (n,) -> (n,
        n_manipulators, n_dims)."""
        (q,) = along(self.space, np.ascontiguousarray(path), np.ascontiguousarray(shares[None]))
        nodes = place(self.space.blocks, np.ascontiguousarray(q.T)[None], 1.0)[0]
        return nodes[:, : len(self.scene.manipulators), : self.n_dims]


class Manifold:
    """Manifold of end effectors that keep the independent distances. End effectors are stored one after the other.

    Parameters
    ----------
    projections : largest number of steps of a projection

    Attributes
    ----------
    pairs : array of int, shape (n_distances, 2), end effectors
    wanted : array, shape (n_distances,), distances [m]
    tolerance : tolerance of a projection [m]
    """

    def __init__(self, scene: Scene, projections: int):
        kept = independent_distances(scene)
        self.shape, self.projections = scene.start.shape, projections
        self.pairs = np.array([(c.first, c.second) for c in kept], dtype=np.int64)
        self.wanted = np.array([c.distance for c in kept])
        self.tolerance = 0.1 * min(c.tolerance for c in scene.distances)

    def hands(self, states: Array, shares: Array) -> Array:
        """Return projected end effectors at shares of a path [m]. The shapes are (n_states, n), (n_shares,) ->
        (n_shares, n_hands, n_dims)."""
        length = np.linalg.norm(np.diff(states, axis=0), axis=1)
        at = np.concatenate([[0.0], np.cumsum(length)]) / max(length.sum(), 1e-12)
        x = interpolated(shares, at, states)
        for row in x:
            self.project(row, 1e-12)
        return x.reshape(-1, *self.shape)

    def project(self, x: Array, tolerance: float) -> bool:
        """Project end effectors onto the manifold in place; return success. Their shape is (n_hands * n_dims,)."""
        return bool(_project(x, self.pairs, self.wanted, self.shape[1], tolerance, self.projections))


@kernel
def motion_is_free(space: Space, p: Array, q: Array, step: float, margin: float) -> bool:
    """Return whether all states between two keep a margin [m]. Points move at most a step [m] between states."""
    nodes, between = np.zeros((space.blocks.node.shape[0], 3)), p.copy()
    if clearance_of(space, q, nodes, margin) <= margin:
        return False
    parts = int(span(space, p, q) / step) + 1
    for i in range(1, parts):
        interpolate(space, p, q, i / parts, between)
        if clearance_of(space, between, nodes, margin) <= margin:
            return False
    return True


@kernel
def distance_errors(
    x: Array, pairs: Integers, wanted: Array, n_dims: int, errors: Array, slopes: Array
) -> None:
    """Compute the errors of distances [m] and their derivatives, in place.

    Parameters
    ----------
    x : array, shape (n_hands * n_dims,), [m]
    pairs, wanted : arrays, shapes (n_distances, 2) and (n_distances,): pairs of end effectors, and their distances
        [m]
    errors, slopes : arrays, shapes (n_distances,) [m] and (n_distances, n_hands * n_dims)
    """
    slopes[:] = 0.0
    for k in range(pairs.shape[0]):
        a, b, square = pairs[k, 0] * n_dims, pairs[k, 1] * n_dims, 0.0
        for axis in range(n_dims):
            square += (x[a + axis] - x[b + axis]) ** 2
        length = sqrt(square)
        errors[k] = length - wanted[k]
        for axis in range(n_dims):
            slope = (x[a + axis] - x[b + axis]) / max(length, 1e-12)
            slopes[k, a + axis], slopes[k, b + axis] = slope, -slope


@kernel
def _project(x: Array, pairs: Integers, wanted: Array, n_dims: int, tolerance: float, most: int) -> bool:
    n = pairs.shape[0]
    errors, slopes = np.zeros(n), np.zeros((n, x.shape[0]))
    for _ in range(most):
        distance_errors(x, pairs, wanted, n_dims, errors, slopes)
        if np.abs(errors).max() <= tolerance:
            return True
        square = slopes @ slopes.T
        for k in range(n):
            square[k, k] += 1e-12  # hands on one line
        x -= slopes.T @ np.linalg.solve(square, errors)
    return False


def _quiet(seed: int) -> None:
    """Silence OMPL and set its seed, which must be positive."""
    util = needed("ompl.util")
    util.setLogLevel(util.LOG_NONE)
    util.RNG.setSeed(seed + 1)


def _pose_space(base: Any, load: OmplLoad) -> Any:
    space = base.SE2StateSpace() if load.n_dims == 2 else base.SE3StateSpace()
    space.setBounds(_bounds(base, load.scene.lower, load.scene.upper))
    # Between quaternions OMPL measures half of the angle.
    space.setSubspaceWeight(1, load.reach if load.n_dims == 2 else 2 * load.reach)
    return space


def _bounds(base: Any, lower: Array, upper: Array) -> Any:
    """Return OMPL's bounds of a vector space; arrays, shape (n,)."""
    bounds = base.RealVectorBounds(len(lower))
    for axis, (low, high) in enumerate(zip(lower.tolist(), upper.tolist(), strict=True)):
        bounds.setLow(axis, low)
        bounds.setHigh(axis, high)
    return bounds


def _margin(scene: Scene, ends: float, step: float) -> float:
    """Return the clearance of states, below that of the ends [m]."""
    return scene.clearance + max(0.0, min(step / 2, 0.9 * (ends - scene.clearance)))


def _write(space: Any, load: OmplLoad, q: Array) -> Any:
    """Convert a configuration, shape (n_columns,), to a state of OMPL."""
    state, values = space.allocState(), [float(value) for value in q]
    if load.n_dims == 2:
        state.setX(values[0])
        state.setY(values[1])
        state.setYaw(values[2])
    else:
        state.setXYZ(*values[:3])
        turn = state.rotation()
        turn.w, turn.x, turn.y, turn.z = values[3:]
    space.enforceBounds(state)
    return state


def _validator(base: Any, information: Any, load: OmplLoad) -> Any:
    """Return a validator that checks a motion in one call. OMPL's own one makes a call per state."""

    class Validator(base.MotionValidator):
        def checkMotion(self, first: Any, second: Any, *last_valid: Any) -> bool:
            return motion_is_free(load.space, load.read(first), load.read(second), load.step, load.margin)

    return Validator(information)


def _constraint(base: Any, manifold: Manifold) -> Any:
    class Distances(base.Constraint):
        def __init__(self) -> None:
            n = manifold.shape[0] * manifold.shape[1]
            super().__init__(n, len(manifold.wanted), manifold.tolerance)
            self.errors, self.slopes = np.zeros(len(manifold.wanted)), np.zeros((len(manifold.wanted), n))

        def function(self, x: Array, out: Array) -> None:
            distance_errors(x, manifold.pairs, manifold.wanted, manifold.shape[1], out, self.slopes)

        def jacobian(self, x: Array, out: Array) -> None:
            distance_errors(x, manifold.pairs, manifold.wanted, manifold.shape[1], self.errors, self.slopes)
            out[:] = self.slopes

        def project(self, x: Array) -> bool:
            return manifold.project(x, manifold.tolerance)

    return Distances()


def _free_hands(scene: Scene, step: float) -> Callable[[Array], bool]:
    """Return the check of end effectors, shape (n_hands * n_dims,). Kernel and margin are the same as for poses."""
    coordinates = load_coordinates(scene)
    space, nodes = configuration_space(scene, coordinates), np.zeros((scene.body.n_nodes, 3))
    # A block for every hand: what ties them is not for the kernel to know.
    n, n_dims = scene.start.shape
    blocks = Blocks(
        np.zeros(n, dtype=np.int64),
        np.array([[*range(i * n_dims, (i + 1) * n_dims), *[0] * (3 - n_dims)] for i in range(n)]),
        np.full(n, n * n_dims, dtype=np.int64),
        np.arange(n + 1),
        np.arange(n),
        np.zeros((n, 3)),
        n_dims,
        *Unmasked.of(n * n_dims, n),
    )
    space = space._replace(blocks=blocks, reach=np.zeros(n))
    ends = min(clearance_of(space, q.ravel(), nodes, -1.0) for q in (scene.start, scene.goal))
    margin = _margin(scene, ends, step)
    return lambda x: clearance_of(space, x, nodes, margin) > margin
