"""The robot as a constraint of a search: checks and costs of what its arms do during a motion of the hands."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import cycle, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.coordination.motion import CoordinatedMotion
from comove.errors import RobotError, SceneError
from comove.planning.configurations import Space
from comove.planning.methods import Comove
from comove.planning.search import Schedule
from comove.robots.effort import DEFAULT_MASS
from comove.robots.model import Arm, Robot
from comove.robots.search.chains import chains_of, place_arm, pose_error
from comove.robots.search.following import MET, Arms, ArmSurroundings, Strain, follow, solutions
from comove.robots.search.links import ENOUGH, FAT, Links, links_clearance, links_of, place_links
from comove.robots.search.planner import plan_with_arms
from comove.robots.search.tracking import track
from comove.robots.timing import shortest_duration
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

SPARE, NEAR_LIMIT = 0.005, 0.95  # m of links, and share of rates and torques, that a search keeps to at first
COARSER = 3  # samples of which one is looked at to tell branches apart
EASE = 2.0  # cost of jolts: of joints that all use their whole acceleration all the time
SAMPLES = 81  # of a movement that a search looks at
SEEDS = 64  # random joints from which a pose is solved
SAME_BRANCH = 0.3  # rad, within which two solutions are one
DIGITS = 6  # of angles that are compared: what mirrors each other is equally far away
BRANCHES = 4  # solutions of an end that are kept, per arm
N_BETWEEN, WANDER = 300, 0.4  # configurations between start and goal, and how far from there they stray [rad]
TIMED = 4.0  # s, in which a movement is tracked whose pace is looked for
SLOWER = 1.002  # times what that allows: at another pace joints are sampled elsewhere
UNLIKELY = 0.5  # plans not found yet that every further pair of joints at start and goal is credited with

N_THREADS = min(4, os.cpu_count() or 1)
_THREADS = ThreadPoolExecutor(N_THREADS, thread_name_prefix="comove-arms")


@dataclass(frozen=True, eq=False)
class Carrying:
    """A robot that carries the load of a scene; the constraint object of a search.

    Attributes
    ----------
    robot, scene : the robot, and the scene whose load it carries
    caution : number of times that the constraints were tightened
    """

    robot: Robot
    scene: Scene
    caution: int = 0

    def __post_init__(self) -> None:
        scene = self.scene
        if scene.n_dims != 3:
            raise _unfit(
                scene, "workspace", "a robot moves in space, and the scene is planar", "use x, y and z"
            )
        if scene.moving.any():
            way_out = "leave out motion, and stop the robot where something comes near"
            raise _unfit(scene, "obstacles", "robots carry among obstacles that stand only", way_out)
        if scene.file.load is None:
            raise _unfit(scene, "load", "there is nothing to carry", "add load: {shape: bar, length: 0.5}")
        if scene.meshes:
            way_out = "put boxes and bars in their place, or solve it without a robot"
            raise _unfit(scene, "shape", "arms carry past boxes and round things, not meshes", way_out)
        if scene.grasp is None:
            way_out = "say it: grasp: {orientation: down, yaw: load}"
            raise _unfit(scene, "grasp", "a robot cannot know how to hold the load", way_out)
        for name in scene.manipulators:
            self.robot.arm(name)

    @cached_property
    def holders(self) -> tuple[Arm, ...]:
        """Return the arms in the order of the scene's manipulators."""
        return tuple(self.robot.arm(name) for name in self.scene.manipulators)

    @cached_property
    def columns(self) -> NDArray[np.int64]:
        """Return the indices of the chains' joints in the robot's joint vector; array, shape (n_joints,)."""
        return np.concatenate([arm.columns for arm in self.holders])

    @cached_property
    def mass(self) -> float:
        """Return the mass of the load [kg]."""
        return DEFAULT_MASS if self.scene.load_mass is None else self.scene.load_mass

    @cached_property
    def arms(self) -> Arms:
        """Return the chains, links and surroundings of the arms as arrays, for kernels."""
        scene, grasp = self.scene, self.scene.grasp
        lattice = _lattice(scene.body.solids)
        carried = np.zeros(len(self.holders))
        carried[list(grasp.holders)] = self.mass / len(grasp.holders)
        around = ArmSurroundings(
            at_rest=np.ascontiguousarray(grasp.at_rest),
            turning=np.ascontiguousarray(grasp.turning),
            first=grasp.holders[0],
            second=grasp.holders[min(1, len(grasp.holders) - 1)],
            obstacles=scene.obstacles,
            edges=np.concatenate([scene.body.edges, lattice]),
            radii=np.concatenate([scene.body.radii, np.zeros(len(lattice))]),
            carried=carried,
            clearance=scene.clearance,
            spare=SPARE * (1 + self.caution),
            share=NEAR_LIMIT * 0.9**self.caution,
            posture=np.concatenate([arm.home for arm in self.holders]),
        )
        return Arms(chains_of(self.robot, self.holders), self._links, around)

    @cached_property
    def _links(self) -> Links:
        return links_of(self.robot, self.holders)

    @cached_property
    def _busy(self) -> Arms:
        """Return `arms` with only the pairs of links that may meet between the joints of start and goal."""
        first, last = (np.array(ends) for ends in zip(*self._ends, strict=True))
        rng = np.random.default_rng(0)
        shares = rng.uniform(size=(N_BETWEEN, 1))
        drawn = rng.integers(len(first), size=N_BETWEEN)
        between = first[drawn] + shares * (last[drawn] - first[drawn])
        between += rng.normal(0.0, WANDER, between.shape)
        chains = self.arms.chains
        samples = np.clip(between, chains.lower, chains.upper)
        return self.arms._replace(links=self.arms.links.near(chains, samples))

    def stricter(self) -> Carrying:
        """Return a copy with more caution, for use after the judge rejected a motion that the search accepted."""
        return self._changed("_tally", caution=self.caution + 1)

    def on(self, scene: Scene) -> Carrying:
        """Return a copy on a scene that differs only in its duration and limits."""
        return self._changed(scene=scene)

    def _changed(self, *kept: str, **changes: Any) -> Carrying:
        """Return a changed copy that keeps the cached values which depend on neither caution nor pace."""
        other = replace(self, **changes)
        for name in ("starts", "goals", "_ends", "_links", *kept):
            if name in vars(self):
                vars(other)[name] = vars(self)[name]
        return other

    @cached_property
    def starts(self) -> tuple[Array, ...]:
        """Return the joint positions that hold the load at the start, by arm; arrays, shape (n_branches, n_joints),
        best first.

        Raises
        ------
        SceneError
            If an arm cannot reach the start.
        """
        return self._branches("start")

    @cached_property
    def goals(self) -> tuple[Array, ...]:
        """Return the joint positions that hold the load at the goal, by arm, as in `starts`."""
        return self._branches("goal")

    def plan(
        self,
        space: Space,
        start: Array,
        goal: Array,
        margin: float,
        rng: np.random.Generator,
        *,
        required: float = 0.0,
        max_nodes: int = 1000,
    ) -> Array | None:
        """Plan a path of the load that the arms can follow; arguments as in `comove.planning.planner.plan`."""
        tally = self._tally  # Thompson sampling (1933) of what has led to plans so far
        drawn = int(rng.beta(*tally).argmax())
        first, last = self._ends[drawn]
        ends = (start, first), (goal, last)
        lenient = next(self._leniency)
        path = plan_with_arms(
            space, self.arms, *ends, margin, rng, required=required, lenient=lenient, max_nodes=max_nodes
        )
        tally[0 if path is not None else 1, drawn] += 1.0
        return path

    def forget(self) -> None:
        """Forget which plans have been tried."""
        for name in ("_tally", "_leniency"):
            vars(self).pop(name, None)

    @cached_property
    def _leniency(self) -> Iterator[float]:
        """Return an iterator over the tolerance of the links' clearance, one for each plan [m]: capsules are wider
        than the links, for some robots by much.
        """
        return cycle((0.0, FAT))

    @cached_property
    def _tally(self) -> Array:
        """Return the counts of plans found and not found for every pair of ends, with a prior that favours likely
        pairs; array, shape (2, n_pairs).
        """
        ranks = np.arange(len(self._ends))
        return np.stack([np.ones(len(ranks)), 1.0 + UNLIKELY * ranks])

    @cached_property
    def _ends(self) -> tuple[tuple[Array, Array], ...]:
        """Return pairs of joint positions at start and goal, first those that keep the clearance and differ least, as
        paths between them are likely.
        """
        at = [self.scene.nodes_at(end) for end in ("start", "goal")]
        both = [[np.concatenate(q) for q in product(*found)] for found in (self.starts, self.goals)]
        enough = self.scene.clearance - FAT
        free = [
            [self.clearance(q, nodes) > enough for q in some] for some, nodes in zip(both, at, strict=True)
        ]
        pairs = product(zip(both[0], free[0], strict=True), zip(both[1], free[1], strict=True))
        ranked = sorted(
            pairs, key=lambda pair: (not (pair[0][1] and pair[1][1]), _apart(pair[0][0], pair[1][0]))
        )
        return tuple((first, last) for (first, _), (last, _) in ranked)

    def ask(self, nodes: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Compute the penalty of motions for what the robot cannot, or can hardly, carry out, and whether it can
        carry them out.

        Parameters
        ----------
        nodes : array, shape (n_rollouts, n_steps, n_nodes, 3), hands first, evenly spaced in time [m]

        Returns
        -------
        penalty, possible : arrays, shape (n_rollouts,)
        """
        steps = np.linspace(0, nodes.shape[1] - 1, SAMPLES).round().astype(int)
        nodes = np.ascontiguousarray(nodes[:, steps])
        strain, around = self.strain(nodes, self.best_start(nodes[0])), self.arms.around
        possible = (strain.missing <= MET).all(axis=1) & (strain.rates <= 1.0).all(axis=(1, 2))
        possible &= strain.clearance > around.clearance
        return (strain.penalty + EASE * strain.jolt).sum(axis=1) + strain.contact, possible

    def shortest(self, motion: CoordinatedMotion) -> float:
        """Return the least duration in which the joints can follow a motion of the hands [s].

        The law of motion is unchanged; the result is inf if an arm does not reach, or the motors cannot even hold
        the load.
        """
        joints, miss = track(self, motion.on(motion.scene.timed(TIMED)))
        if miss is not None:
            return np.inf
        holders = [self.holders[i].name for i in self.scene.grasp.holders]
        try:
            timing = shortest_duration(
                self.robot, joints, carried=dict.fromkeys(holders, self.mass / len(holders))
            )
        except RobotError:
            return np.inf
        return SLOWER * timing.duration

    def strain(self, nodes: Array, start: Array) -> Strain:
        """Compute what motions demand of the arms from given joints, array of shape (n_joints,); nodes as in
        `ask`.
        """
        parts = np.array_split(nodes, min(len(nodes), N_THREADS))
        done = _THREADS.map(lambda part: follow(self._busy, part, start, self.scene.duration), parts)
        return Strain(*(np.concatenate(arrays) for arrays in zip(*done, strict=True)))

    def best_start(self, nodes: Array) -> Array:
        """Choose, for each arm, the start from which it follows one motion best; array, shape (n_joints,).

        Parameters
        ----------
        nodes : array, shape (n_steps, n_nodes, 3) [m]
        """
        starts, n_most = self.starts, max(map(len, self.starts))
        nodes = np.ascontiguousarray(nodes[::COARSER])
        tried = [[s[min(k, len(s) - 1)] for s in starts] for k in range(n_most)]
        if n_most == 1:
            return np.concatenate(tried[0])
        penalties = np.array([self.strain(nodes[None], np.concatenate(q)).penalty[0] for q in tried])
        return np.concatenate([tried[k][i] for i, k in enumerate(penalties.argmin(axis=0))])

    def clearance(self, q: Array, nodes: Array) -> float:
        """Compute the least distance of the links from obstacles, load and each other, at most 5 cm [m].

        Parameters
        ----------
        q : array, shape (n_joints,), joint positions of the chains
        nodes : array, shape (n_nodes, 3), positions of the hands and of the load's nodes [m]
        """
        chains, links, around = self.arms
        a, b = links.start.copy(), links.end.copy()
        place_links(chains, links, q, a, b)
        return links_clearance(links, a, b, around.obstacles, nodes, around.edges, around.radii, ENOUGH)

    def _branches(self, end: str) -> tuple[Array, ...]:
        """Compute the joint positions at an end, by arm; those in contact are kept only if there are no others."""
        nodes = self.scene.nodes_at(end)
        rotations = self.scene.grasp.hand_rotations(nodes[: len(self.holders)])
        chains, posture, found = self.arms.chains, self.arms.around.posture, []
        rng = np.random.default_rng(0)
        draws = rng.uniform(chains.lower, chains.upper, (SEEDS, len(posture)))
        for i, arm in enumerate(self.holders):
            seeds = np.concatenate([[posture], draws])
            joints, missing = solutions(chains, i, rotations[i], nodes[i], posture, seeds)
            if missing.min() > MET:
                shift, turn = self._miss(i, joints[missing.argmin()], rotations[i], nodes[i])
                x, y, z = nodes[i]
                raise _unfit(
                    self.scene,
                    f"manipulators.{end}",
                    f"the arm '{arm.name}' cannot reach its {end} at {x:.3g}, {y:.3g}, {z:.3g}: "
                    f"{shift:.3g} m and {turn:.3g} degrees are missing",
                    "move it nearer, turn the load or the hands on it, or use another robot",
                )
            part = slice(chains.first[i], chains.first[i + 1])
            branches = _distinct(joints[missing <= MET][:, part], posture[part])
            alone = np.repeat(posture[None], len(branches), axis=0)
            alone[:, part] = branches
            free = np.array([self.clearance(q, nodes) for q in alone]) > 0.0
            found.append(branches[free] if free.any() else branches)
        return tuple(found)

    def _miss(self, arm: int, q: Array, rotation: Array, point: Array) -> tuple[float, float]:
        """Compute the error of an arm's grasp from a pose: in position [m] and in orientation [deg]."""
        chains = self.arms.chains
        count = chains.first[arm + 1] - chains.first[arm] + 1
        rotations, points, error = np.empty((count, 3, 3)), np.empty((count, 3)), np.empty(6)
        place_arm(chains, arm, q, rotations, points)
        pose_error(rotations[-1], points[-1], rotation, point, error)
        return float(np.linalg.norm(error[:3])), float(np.rad2deg(np.linalg.norm(error[3:])))


def _unfit(scene: Scene, key: str, message: str, way_out: str) -> SceneError:
    return SceneError(message, file=scene.path, key=key, way_out=way_out)


def _lattice(solids: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the edges and face diagonals of boxes, which stand for them in distances to links; array, shape
    (n_lines, 2), of corners.
    """
    lines = [(a, b) for a in range(8) for b in range(a) if (a ^ b).bit_count() < 3]
    return (
        np.array([(corners[a], corners[b]) for corners in solids for a, b in lines])
        .reshape(-1, 2)
        .astype(int)
    )


def _apart(p: Array, q: Array) -> float:
    return round(float(np.abs(p - q).max()), DIGITS)


def _distinct(joints: Array, posture: Array) -> Array:
    """Return the distinct solutions of one arm, nearest to home first; `joints` has the shape (n, n_joints of the
    arm).
    """
    kept: list[Array] = []
    for i in np.argsort(np.abs(joints - posture).max(axis=1).round(DIGITS), kind="stable"):
        if all(np.abs(joints[i] - other).max() > SAME_BRANCH for other in kept):
            kept.append(joints[i])
    return np.array(kept[:BRANCHES])


def robot_method() -> Comove:
    """Return the default method with fewer attempts: with arms to follow, a generation takes forty times as long."""
    return Comove(
        n_plans=2,
        n_failures=30,
        n_restarts=8,
        n_unfit=8,
        n_polishings=4,
        n_ways=3,
        n_idle=1,
        polishing=Schedule(sigma=0.02, generations=200, patience=20, gain=0.01),
    )
