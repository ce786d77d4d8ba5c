"""Joints of the arms that hold a payload at start and goal."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice, product

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from comove.arrays import Array, Integers, listed
from comove.compiled import kernel
from comove.contacts.displaced import RESTING
from comove.errors import SceneError
from comove.model.grasp import Grasp
from comove.model.scene import Scene
from comove.processes import n_processors
from comove.robots.free_space import Room
from comove.robots.model import Arm, Robot
from comove.robots.search.chains import Chains, chains_of, turned_towards
from comove.robots.search.closed_form import ClosedForm, closed_form, closed_seeds
from comove.robots.search.following import (
    MET,
    N_PATIENT,
    PERSISTENT,
    SETTLING,
    Arms,
    follow_one,
    solutions,
)
from comove.robots.search.links import ENOUGH, FAT, FATTEST, Links, clearances_at, links_of
from comove.robots.search.ranges import WristRanges, may_reach, ranges_of
from comove.robots.verification.bodies import bodies_of, obstacle_object
from comove.robots.verification.carried import Carried
from comove.robots.verification.certificate import are_clear
from comove.robots.verification.kinematics import Bases


@dataclass(frozen=True)
class EndSettings:
    """Settings of the search for joints at an end.

    Attributes
    ----------
    n_seeds : random joints from which a pose is solved where it has no closed form
    n_postures : random postures near which an arm is solved again, without clearance near its home
    n_angles : sampled angles of a closed form's free joint
    n_branches, same_branch : solutions of an end that are kept for each arm, and how far apart they are [rad]
    n_measured : solutions whose bodies' distances are computed where capsules have no clearance
    other : difference from the straight motion's last joints beyond which others are another branch [rad]
    last : weight of the rotation of an arm's last joint, which no singularity hinders
    whatever : of so many pairs of joints at start and goal, one is chosen despite contacts of capsules
    unlikely : prior count of failed plans of every further pair of joints at start and goal
    n_pairs : pairs that are checked where joints must admit approach or release
    """

    n_seeds: int = 64
    n_postures: int = 16
    n_angles: int = 64
    n_branches: int = 8
    same_branch: float = 0.3
    n_measured: int = 24
    other: float = 1.0
    last: float = 0.5
    whatever: int = 4
    unlikely: float = 0.5
    n_pairs: int = 16


FEWER = 4  # by which fewer random joints are tried for a pose that has no solution in closed form
DIGITS = 6  # of differences of joints, by which they are compared
SCALE = 10.0**DIGITS
FULL = 6  # joints with which a hand can be turned every way
N_THREADS = min(4, n_processors())
THREADS = ThreadPoolExecutor(N_THREADS, thread_name_prefix="comove-arms")


@dataclass(eq=False)
class Tally:
    """Results of plans between end pairs, by which the next is drawn.

    Attributes
    ----------
    well, ill : arrays, shape (n_pairs,), plans that led to a verified motion, and all others that were tried
    against : array, shape (n_pairs,), prior counts of failed plans of the pairs
    open : pair of the last plan found, while its result is not known
    n_verified : motions that were verified before that plan
    """

    well: Array
    ill: Array
    against: Array
    open: int | None = None
    n_verified: int = 0

    @classmethod
    def of(cls, n_pairs: int, unlikely: float) -> Tally:
        """Return counts without any plans. The pairs are ranked, likeliest first."""
        return cls(np.zeros(n_pairs), np.zeros(n_pairs), unlikely * np.arange(n_pairs).astype(np.float64))

    def drawn(self, rng: np.random.Generator, n_verified: int) -> int:
        """Draw the next pair: the first, then one by Thompson sampling (1933).

        Parameters
        ----------
        n_verified : number of motions verified so far, which tells the result of the last plan
        """
        if self.open is not None:
            (self.well if n_verified > self.n_verified else self.ill)[self.open] += 1.0
        self.open, self.n_verified = None, n_verified
        if not (self.well.any() or self.ill.any()):
            return 0
        return int(rng.beta(1.0 + self.well, 1.0 + self.against + self.ill).argmax())

    def note(self, pair: int, found: bool) -> None:
        """Note whether a plan was found. Its result is known when the next pair is drawn."""
        if found:
            self.open = pair
        else:
            self.ill[pair] += 1.0


class MissedPose(Exception):
    """An end that an arm may reach from more seeds."""


@dataclass(frozen=True, eq=False)
class EndJoints:
    """The joints that hold a payload at the ends of a scene.

    Attributes
    ----------
    robot, scene : the robot, and the scene whose payload it holds
    grasp : grasps of the end effectors on it
    holders : arms of the robot in the order of the scene's manipulators
    arms : these as arrays, for kernels
    present : array, shape (n_joints of the arms,), joints from which the robot approaches the start
    settings : settings of the search for joints
    time : instant of the obstacles of `arms` [s]; None where they rest
    """

    robot: Robot
    scene: Scene
    grasp: Grasp
    holders: tuple[Arm, ...]
    arms: Arms
    present: Array
    settings: EndSettings = EndSettings()
    time: float | None = None

    def pairs(self, starts: tuple[Array, ...], goals: tuple[Array, ...]) -> Array:
        """Return pairs of joints at start and goal, least rotations first.

        A pair's rotations are the largest from the present joints to the start and the largest from there to the
        goal, as one follows the other. Most pairs are the next of those that keep the clearance, then of those that
        may keep it, and among them of those with the least rotations; one of `whatever` is the next of those with the
        least rotations, regardless of contacts, as capsules may be much wider than links. Of a payload that tilts,
        those pairs come first whose goal is in the solution branch in which the straight motion from the start ends,
        as arms hardly ever change it on the way. Goals are there as they were found and, where joints can turn
        further than once, as many turns away as is nearest to the start.

        Parameters
        ----------
        starts, goals : joints at both ends, by arm; arrays, shape (n_branches, n_joints)

        Returns
        -------
        array, shape (n_pairs, 2, n_joints)
        """
        at = [(self.at(end), self.scene.nodes_at(end)) for end in ("start", "goal")]
        both = [_combined(found) for found in (starts, goals)]
        tight = [own.tightness(q, nodes) for q, (own, nodes) in zip(both, at, strict=True)]
        row, column, last, differ = joined(
            self.arms.chains, both[0], both[1], self.present, self.settings.last
        )
        tightest, others = np.maximum(tight[0][row], tight[1][column]), np.zeros(len(row), dtype=bool)
        if self.grasp.keypoints:
            led = _combined(self._led(starts))
            others = ~(self.difference(led[row], last) < self.settings.other)
        likely = np.lexsort((differ, others, tightest)), np.lexsort((differ, others))
        roomy, near = (np.argsort(order) for order in likely)
        every = self.settings.whatever
        places = np.minimum(roomy + roomy // (every - 1), every * near + every - 1)
        ranked = np.argsort(places, kind="stable")
        return np.stack([both[0][row[ranked]], last[ranked]], axis=1)

    def at(self, end: str) -> EndJoints:
        """Return the same among obstacles placed as at an end."""
        if not self.scene.moving.any():
            return self
        time = self.scene.time_at(end)
        return replace(self, time=time, arms=self.arms.among(self.scene.obstacles_at(time)))

    def _led(self, starts: tuple[Array, ...], n_steps: int = 41) -> list[Array]:
        """Return each arm's joints at the end of the straight motion.

        Arrays, shape (n_branches, n_joints of the arm), as `starts`; NaN where an arm cannot follow it.
        """
        motion, led = _straight(self.scene).motion, [np.full_like(joints, np.nan) for joints in starts]
        nodes, left = motion.nodes(n_steps), np.empty((n_steps, len(starts)))
        q = np.empty((n_steps, len(self.present)))
        for k in range(max(map(len, starts))):
            first = np.concatenate([joints[min(k, len(joints) - 1)] for joints in starts])
            follow_one(self.arms, nodes, np.stack([first, first]), q, left)
            for i, missing in enumerate(left.T):
                if k < len(led[i]) and missing.max() <= MET:
                    led[i][k] = q[-1, self.part(i)]
        return led

    def difference(self, first: Array, last: Array) -> Array:
        """Return the largest joint rotation of all arms, last joints weighted.

        Parameters
        ----------
        first, last : arrays, shape (..., n_joints) [rad]

        Returns
        -------
        array, shape (...,)
        """
        weight = np.ones(first.shape[-1])
        weight[self.arms.chains.first[1:] - 1] = self.settings.last
        return np.asarray((weight * np.abs(first - last)).max(axis=-1))

    def tightness(self, q: Array, nodes: Array) -> Integers:
        """Return 0 if links keep clear, 1 if they may, else 2; arrays, shape (n, n_joints) -> (n,).

        They may where only the capsules, which are wider than links, do not.
        """
        return self.tight(self.clearances(q, nodes))

    def tight(self, clearance: Array) -> Integers:
        """Return the `tightness` of least link clearances [m]; arrays, shape (n,)."""
        return np.add(
            clearance <= self.scene.clearance, clearance <= self.scene.clearance - FAT, dtype=np.int64
        )

    def clearances(self, q: Array, nodes: Array, some: Links | None = None) -> Array:
        """Compute the links' least distances from obstacles, payload and each other [m]. They are at most 5 cm.

        Parameters
        ----------
        q : array, shape (n, n_joints), joint positions of the chains
        nodes : array, shape (n_nodes, 3), positions of the keypoints [m]
        some : the links to check; None for all

        Returns
        -------
        array, shape (n,)
        """
        arms = self.arms
        return clearances_at(arms.chains, some or arms.links, arms.around, RESTING, q, nodes, ENOUGH)

    def solved(self, end: str, all_seeds: bool = True) -> tuple[Array, ...]:
        """Compute joint positions at an end by poses alone, nearest first.

        Parameters
        ----------
        all_seeds : whether a pose that is missed from the first seeds, and may be in reach, is solved from all

        Returns
        -------
        arrays, shape (n_solutions, n_joints of the arm)

        Raises
        ------
        SceneError
            If an arm cannot reach the end.
        MissedPose
            If an arm may reach the end, but not from the first seeds.
        """
        nodes, posture, n = self.scene.nodes_at(end), self._near(end), len(self.holders)
        rotations, found, chains = self.grasp.hand_rotations(nodes), list[Array](), self.arms.chains
        each = range(n), rotations, nodes, [posture] * n, [self.settings.n_seeds] * n
        are_slow = None in of_robot(self.robot, self.holders)[3]  # without a closed form
        solved = (THREADS.map if are_slow else map)(self._solutions, *each)
        for i, (joints, missing) in enumerate(solved):
            may_be_met = missing.min() > MET and may_reach(self.arms.ranges, i, rotations[i], nodes[i])
            if may_be_met and not all_seeds:
                raise MissedPose(f"'{self.holders[i].name}' misses its {end} from the first seeds")
            if may_be_met:
                joints, missing = patiently_solved(
                    chains, i, rotations[i], nodes[i], posture, self.settings.n_seeds
                )
            if missing.min() > MET:
                joints = joints[missing.argmin(), self.part(i)]
                raise self._out_of_reach(self.holders[i], end, joints, rotations[i], nodes[i])
            part = self.part(i)
            held = turned_towards(chains, posture[part], joints[missing <= MET][:, part], part)
            found.append(self._homely(held, posture[part]))
        return tuple(found)

    def branches(self, end: str, solved: tuple[Array, ...] | None = None) -> tuple[Array, ...]:
        """Compute the joint positions at an end, by arm; those in which its capsules have contacts come last, and
        those in which the arm by itself does are kept only if there are no others.

        Parameters
        ----------
        solved : what `solved` returns, where it is known

        Returns
        -------
        arrays, shape (n_branches, n_joints of the arm)

        Raises
        ------
        SceneError
            If an arm cannot reach the end.
        """
        if self.time is None and self.scene.moving.any():
            return self.at(end).branches(end, solved)
        nodes, posture, how, found = self.scene.nodes_at(end), self._near(end), self.settings, list[Array]()
        for i, homely in enumerate(solved or self.solved(end)):
            room = self._room(i, homely, nodes)
            if not (room > self.scene.clearance).any():  # there may be more room further away
                rotation = self.grasp.hand_rotations(nodes)[i]
                found.append(self._roomy(i, homely, rotation, nodes, posture)[: how.n_branches])
                continue
            order = np.argsort(room <= 0.0, kind="stable")
            free = order[room[order] > self.scene.clearance - FATTEST]
            found.append(homely[free][: how.n_branches])
        return tuple(found)

    def _near(self, end: str) -> Array:
        return self.present if end == "start" else self.arms.around.posture

    def contact(self, end: str, branches: tuple[Array, ...]) -> str:
        """Return two bodies that collide at an end for all joints. Exact bodies decide.

        Parameters
        ----------
        branches : joints at the end, by arm; arrays, shape (n_branches, n_joints)
        """
        robot, nodes, q, first = self.robot, self.scene.nodes_at(end), self.robot.home, ""
        bases, time = Bases(robot, robot.description.uncertainty), self.scene.time_at(end)
        carried = _straight(self.scene)
        bodies = bodies_of(bases, self.holders, carried, nodes[None, : len(self.holders)], 0.0)
        room: Room | None = None
        for joints in product(*branches):
            q[self.columns] = np.concatenate(joints)
            if are_clear(bodies, q, nodes, time):
                return ""
            room = room or Room(bodies.placed_at(nodes, time), robot.arms, np.zeros(len(bodies.kind)))
            if not (near := room.contact(q)):
                return ""
            first = first or near
        return first

    @property
    def columns(self) -> Integers:
        """Return the columns of the arms' joints among those of the robot."""
        return np.concatenate([arm.columns for arm in self.holders])

    def _room(self, i: int, branches: Array, nodes: Array) -> Array:
        """Return arm i's clearance in some joints, without other arms; array, shape (n,) [m]."""
        moved = np.repeat(self.arms.around.posture[None], len(branches), axis=0)
        moved[:, self.part(i)] = branches
        links, known = self.arms.links, of_robot(self.robot, self.holders)[1]
        own = _links_of_each(self.robot, self.holders)[i] if links is known else links.of(i)
        return self.clearances(moved, nodes, own)

    def reaches(self, i: int, nodes: Array, n_seeds: int) -> bool:
        """Return whether arm i can hold the payload and may be clear. Capsules decide, without the other arms.

        Parameters
        ----------
        nodes : array, shape (n_nodes, 3), positions of the keypoints [m]
        n_seeds : random joints from which a pose is solved where it has no closed form
        """
        rotation = self.grasp.hand_rotations(nodes)[i]
        if not may_reach(self.arms.ranges, i, rotation, nodes[i]):
            return False
        joints, missing = self._solutions(i, rotation, nodes[i], self.arms.around.posture, n_seeds)
        met, part = missing <= MET, self.part(i)
        if not met.any():
            return False
        held = self._homely(joints[met][:, part], self.arms.around.posture[part])
        return bool((self._room(i, held, nodes) > self.scene.clearance - FATTEST).any())

    def part(self, i: int) -> slice:
        """Return the columns of arm i among the joints of all arms."""
        return slice(self.arms.chains.first[i], self.arms.chains.first[i + 1])

    def _solutions(
        self, i: int, rotation: Array, point: Array, posture: Array, n_seeds: int
    ) -> tuple[Array, Array]:
        """Solve an end effector's pose near a posture. Seeds are closed-form solutions, else posture and random ones.

        Parameters
        ----------
        posture : array, shape (n_joints,)
        n_seeds : random joints from which a pose is solved where it has no closed form

        Returns
        -------
        joints : array, shape (n_solutions, n_joints), of all arms
        missing : array, shape (n_solutions,), residuals [m]
        """
        how = self.settings
        return solved_for(self.robot, self.holders, i, rotation, point, posture, n_seeds, how.n_angles)

    def _homely(self, joints: Array, posture: Array) -> Array:
        """Return the distinct solutions of one arm, nearest to a posture first; `joints` has the shape (n, n_joints
        of the arm).
        """
        return _nearest_first(np.ascontiguousarray(joints), posture, self.settings.same_branch)

    def _distinct(self, joints: Array) -> Array:
        return joints[_differ(np.ascontiguousarray(joints), self.settings.same_branch)]

    def _roomy(self, i: int, homely: Array, rotation: Array, nodes: Array, near: Array) -> Array:
        """Return distinct solutions of arm i whose capsules may be clear; all if none.

        Those come first whose bodies keep the clearance from obstacles.

        Parameters
        ----------
        homely : array, shape (n_solutions, n_joints of the arm), solutions near `near`
        near : array, shape (n_joints,)

        Returns
        -------
        array, shape (n, n_joints of the arm)
        """
        chains, part, how = self.arms.chains, self.part(i), self.settings
        rng = np.random.default_rng(0)
        draws = rng.uniform(chains.lower, chains.upper, (how.n_postures, len(near)))
        solved = [self._solutions(i, rotation, nodes[i], posture, 0) for posture in (near, *draws)]
        joints = np.concatenate([q[missing <= MET][:, part] for q, missing in solved])
        joints = turned_towards(chains, near[part], joints, part)
        room = self._room(i, joints, nodes).round(DIGITS)
        joints = self._distinct(np.concatenate([homely, joints[np.argsort(-room, kind="stable")]]))
        likely = np.flatnonzero(self._room(i, joints, nodes) > self.scene.clearance - FATTEST)
        measure, clearance = self._measure(i), self.scene.clearance
        free = (k for k in likely[: how.n_measured].tolist() if measure(joints[k]) > clearance)
        first = list(islice(free, how.n_branches))
        kept = likely if len(likely) else np.arange(len(joints))
        return joints[list(dict.fromkeys([*first, *kept.tolist()]))]

    def _measure(self, i: int) -> Callable[[Array], float]:
        """Return a function of arm i's distance from the obstacles [m].

        It takes joints of that arm, array of shape (n_joints of the arm,).
        """
        robot, arm, scene = self.robot, self.holders[i], self.scene
        model, geometry = robot.model, robot.collision.copy()
        moved = set(np.flatnonzero(np.isin(model.idx_vs, arm.columns)))
        on = [set(model.supports[item.parentJoint]) for item in geometry.geometryObjects]
        geometry.removeAllCollisionPairs()
        for number in range(len(scene.file.obstacles)):
            solid = obstacle_object(scene, number, f"obstacles[{number}]", self.time or 0.0)
            obstacle = geometry.addGeometryObject(solid)
            for link in (k for k, supports in enumerate(on) if moved & supports):
                geometry.addCollisionPair(pin.CollisionPair(link, obstacle))
        data, placed, q = model.createData(), geometry.createData(), robot.home

        def distance(joints: Array) -> float:
            q[arm.columns] = joints
            pin.computeDistances(model, data, geometry, placed, q)
            return min((result.min_distance for result in placed.distanceResults), default=np.inf)

        return distance

    def _out_of_reach(self, arm: Arm, end: str, joints: Array, rotation: Array, point: Array) -> SceneError:
        """Return the error that an arm cannot reach an end. It names the residual."""
        q = self.robot.home
        q[arm.columns] = joints
        pose = self.robot.tool_pose(q, arm)
        shift = np.linalg.norm(point - pose[:3, 3])
        turn = np.rad2deg(Rotation.from_matrix(rotation @ pose[:3, :3].T).magnitude())
        way_out = "move it nearer, turn the load or the hands on it, or use another robot"
        if len(arm.columns) < FULL:
            way_out = f"{len(arm.columns)} joints cannot turn a hand every way, but most let it point down: {way_out}"
        return unfit(
            self.scene,
            f"manipulators.{end}",
            f"the arm '{arm.name}' cannot reach its {end} at {listed(point, 3)}: "
            f"{shift:.3g} m and {round(float(turn), 2):.3g} degrees are missing",
            way_out,
        )


@lru_cache(maxsize=4)
def _straight(scene: Scene) -> Carried:
    return Carried.straight(scene)


@lru_cache(maxsize=32)
def of_robot(
    robot: Robot, holders: tuple[Arm, ...]
) -> tuple[Chains, Links, WristRanges, tuple[ClosedForm | None, ...]]:
    """Return arms' chains, links, ranges and closed forms, without any scene.

    The closed form of an arm is None where its joints do not follow from a pose in closed form.
    """
    chains = chains_of(robot, holders)
    forms = tuple(closed_form(chains, i) for i in range(len(holders)))
    return chains, links_of(robot, holders), ranges_of(chains), forms


@lru_cache(maxsize=32)
def _links_of_each(robot: Robot, holders: tuple[Arm, ...]) -> tuple[Links, ...]:
    """Return the links of each arm by itself."""
    return tuple(of_robot(robot, holders)[1].of(i) for i in range(len(holders)))


def solved_for(
    robot: Robot,
    holders: tuple[Arm, ...],
    i: int,
    rotation: Array,
    point: Array,
    posture: Array,
    n_seeds: int,
    n_angles: int = EndSettings.n_angles,
) -> tuple[Array, Array]:
    """Solve an end effector's pose, with arguments and results of `EndJoints._solutions`."""
    chains, _, _, forms = of_robot(robot, holders)
    if (form := forms[i]) is not None:
        seeds = closed_seeds(form, chains, i, rotation, point, posture, n_angles)
        if len(seeds):
            joints, missing = solutions(chains, i, rotation, point, posture, seeds, SETTLING, N_PATIENT)
            if missing.min() <= MET:
                return joints, missing
        n_seeds //= FEWER
    seeds = _seeds(chains, posture, n_seeds)
    return solutions(chains, i, rotation, point, posture, seeds, SETTLING, N_PATIENT)


def patiently_solved(
    chains: Chains, i: int, rotation: Array, point: Array, posture: Array, n_seeds: int
) -> tuple[Array, Array]:
    """Solve a pose from all seeds to the end. Arguments and results are those of `EndJoints._solutions`."""
    seeds = _seeds(chains, posture, n_seeds)
    return solutions(chains, i, rotation, point, posture, seeds, PERSISTENT, len(seeds))


def _seeds(chains: Chains, posture: Array, n_seeds: int) -> Array:
    """Return a posture and random joints; array, shape (1 + n_seeds, n_joints)."""
    rng = np.random.default_rng(0)
    return np.concatenate([[posture], rng.uniform(chains.lower, chains.upper, (n_seeds, len(posture)))])


def _combined(branches: Iterable[Array]) -> Array:
    """Return all arms' joints in each combination of solutions; array, shape (n, n_joints)."""
    every = list(branches)
    rows = np.indices([len(joints) for joints in every]).reshape(len(every), -1)
    return np.hstack([joints[row] for joints, row in zip(every, rows, strict=True)])


@kernel
def _differ(joints: Array, apart: float) -> NDArray[np.bool_]:
    """Return which joints, shape (n, n_joints), differ from all kept before."""
    kept = np.zeros(joints.shape[0], dtype=np.bool_)
    for k in range(joints.shape[0]):
        kept[k] = True
        for other in range(k):
            away = 0.0
            for j in range(joints.shape[1]):
                away = max(away, abs(joints[k, j] - joints[other, j]))
            if kept[other] and away <= apart:
                kept[k] = False
                break
    return kept


@kernel
def _nearest_first(joints: Array, posture: Array, apart: float) -> Array:
    """Return distinct joints, nearest to a posture first; arrays, shape (n, n_joints)."""
    n, away, order = joints.shape[0], np.zeros(joints.shape[0]), np.arange(joints.shape[0])
    for k in range(n):
        for j in range(joints.shape[1]):
            away[k] = max(away[k], abs(joints[k, j] - posture[j]))
        away[k] = _rounded(away[k])
        place = k  # after all that are as near
        while place > 0 and away[order[place - 1]] > away[k]:
            order[place] = order[place - 1]
            place -= 1
        order[place] = k
    ordered = joints[order]
    return ordered[_differ(ordered, apart)]


def joined(
    chains: Chains, starts: Array, goals: Array, present: Array, last: float
) -> tuple[Integers, Integers, Array, Array]:
    """Join starts to goals, turned towards them and as they are.

    Parameters
    ----------
    starts, goals : arrays, shape (n_starts, n_joints) and (n_goals, n_joints)
    present : array, shape (n_joints,), joints before the start
    last : weight of the rotation of an arm's last joint

    Returns
    -------
    row, column : arrays, shape (n,), numbers of start and goal
    joints : array, shape (n, n_joints), joints at the goal
    differ : array, shape (n,), largest rotations to start and goal, added, those of last joints weighted [rad]
    """
    weight = np.ones(len(present))
    weight[chains.first[1:] - 1] = last
    turned = turned_towards(chains, starts[:, None], goals)
    return _distinct_pairs(starts, goals, turned, np.ascontiguousarray(present), weight)


@kernel
def _distinct_pairs(
    starts: Array, goals: Array, turned: Array, present: Array, weight: Array
) -> tuple[Integers, Integers, Array, Array]:
    """Return what `joined` does; `turned` is (n_starts, n_goals, n_joints), `weight` (n_joints,)."""
    n_starts, n_goals, n_joints = starts.shape[0], goals.shape[0], starts.shape[1]
    row = np.empty(2 * n_starts * n_goals, dtype=np.int64)
    column, differ, joints = np.empty_like(row), np.empty(len(row)), np.empty((len(row), n_joints))
    rounded, n = np.empty((len(row), n_joints)), 0
    for i in range(n_starts):
        begun, before = n, 0.0
        for j in range(n_joints):
            before = max(before, weight[j] * abs(present[j] - starts[i, j]))
        for k in range(n_goals):
            for as_it_is in range(2):
                after = 0.0
                for j in range(n_joints):
                    goal = goals[k, j] if as_it_is else turned[i, k, j]
                    joints[n, j], rounded[n, j] = goal, _rounded(goal)
                    after = max(after, weight[j] * abs(starts[i, j] - goal))
                is_new = True
                for other in range(begun, n):
                    j = 0
                    while j < n_joints and rounded[other, j] == rounded[n, j]:
                        j += 1
                    if j == n_joints:
                        is_new = False
                        break
                if is_new:
                    row[n], column[n], differ[n] = i, k, _rounded(before + after)
                    n += 1
    return row[:n], column[:n], joints[:n], differ[:n]


@kernel
def _rounded(value: float) -> float:
    """Return a number rounded to `DIGITS`, as `numpy.round` does."""
    return np.rint(value * SCALE) / SCALE


def unfit(scene: Scene, key: str, message: str, way_out: str) -> SceneError:
    return SceneError(message, file=scene.path, key=scene.words.key(key), way_out=way_out)


def apart(p: Array, q: Array) -> float:
    """Return the largest difference of joints, rounded for ties of mirror images."""
    return round(float(np.abs(p - q).max()), DIGITS)
