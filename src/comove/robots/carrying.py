"""The robot as kinematics of a search: plans, feasibility and verification."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, cycle, islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.errors import RobotError
from comove.model.candidates import APART
from comove.model.coordinates import load_coordinates
from comove.model.files.keys import ROBOT_CLEARANCE
from comove.model.grasp import Grasp
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene, of_geometry
from comove.planning.configurations import Space, configuration_space, way_length
from comove.planning.kinematics import LimitedKinematics
from comove.planning.seeds import targets_along
from comove.planning.spacetime import spacetime
from comove.planning.world import World
from comove.robots.effort import carried_masses, overburdened, shortest_duration
from comove.robots.ends import (
    DIGITS,
    N_THREADS,
    THREADS,
    EndJoints,
    EndSettings,
    Tally,
    apart,
    of_robot,
    unfit,
)
from comove.robots.hands import collision_of_hands
from comove.robots.model import Arm, Robot
from comove.robots.motion import JointMotion
from comove.robots.search.capsules import PROUDEST
from comove.robots.search.chains import turned_towards
from comove.robots.search.following import MET, Arms, Strain, contact_along, course_penalties, demands, follow
from comove.robots.search.links import (
    FAT,
    FATTEST,
    ROUGH,
    HandOrientation,
    Links,
    LinkSurroundings,
    load_lines,
    recalled,
)
from comove.robots.search.planner import ArmPlanSettings, plan_with_arms
from comove.robots.search.spare import ArmsFollower, FollowerSettings
from comove.robots.search.tracking import EXACT, N_COARSE, Miss, track, track_near, tracked
from comove.robots.transfers import Retreat
from comove.robots.verification.checks import struck_at_rest
from comove.robots.verification.verify import (
    JointReport,
    JointVerdict,
    VerifiedJointMotion,
    tightened,
    verify_joints,
)
from comove.verification.verify import Check, CheckOfVerified, VerifiedMotion


@dataclass(frozen=True)
class CarrierSettings:
    """Settings of a robot's kinematics in a search.

    Attributes
    ----------
    spare : clearance of links beyond the required one that is kept at first, and grows with caution [m]
    share : share of the limits of rates and torques that is used at first, and shrinks with caution
    n_samples : samples of a movement at which arms are evaluated; a few more where obstacles move
    coarser : stride of the samples that tell inverse-kinematics solutions apart
    ease : cost of jolts: of joints that all use their whole acceleration all the time
    slack : share of the links' spare clearance that the bounds of a candidate's verification may lose
    haste : stride of a candidate's samples that are solved first, as one out of reach suffices
    ends, plans, follower : settings of joints at both ends, of plans, and of the arms that follow an optimised motion
    """

    spare: float = 0.005
    share: float = 0.95
    n_samples: int = 81
    coarser: int = 2
    ease: float = 2.0
    slack: float = 1.0
    haste: int = 8
    ends: EndSettings = field(default_factory=EndSettings)
    plans: ArmPlanSettings = field(default_factory=ArmPlanSettings)
    follower: FollowerSettings = field(default_factory=FollowerSettings)


@of_geometry
def _unfit_grasps(
    scene: Scene, robot: Robot, holders: tuple[Arm, ...], required: float
) -> tuple[str, str, str] | None:
    """Return the key of unfit grasps, a message, and a hint; None if they fit.

    Parameters
    ----------
    required : distance that links keep from each other [m]
    """
    assert scene.grasp is not None, "scenes without a grasp are refused"
    nodes = scene.nodes_at("start")
    rotations, points = scene.grasp.hand_rotations(nodes), nodes[: len(holders)]
    if met := collision_of_hands(robot, holders, rotations, points, required):
        return "load.grasps", *met
    for reason in overburdened(scene, holders):
        message, hint = reason.rsplit("; ", 1)
        return "load.mass", message, hint
    return None


class GivenJoints(NamedTuple):
    """Joints of a robot at both ends, arrays of shape (n_joints,) [rad]; None for those that are not given.

    At the start, `begin`, it holds the payload exactly there already. At the goal it holds it near `end`.
    """

    begin: Array | None = None
    end: Array | None = None


NOT_GIVEN = GivenJoints()


@dataclass(frozen=True, eq=False)
class RobotCarrier(LimitedKinematics):
    """A robot that holds a scene's payload, as `comove.planning.kinematics.LimitedKinematics`.

    A search evaluates it quickly, by kernels (`plan`, `ask`, `shortest`); `reasons` verifies exactly whether it can
    execute a motion.

    Attributes
    ----------
    robot, scene : the robot, and the scene whose payload it holds
    caution : number of times that the constraints were tightened
    given : joints at the ends; those that are not given are solved
    present : array, shape (n_joints,), the robot's joints before it approaches the start [rad]; None for home
    approach, release : whether the joints at the start, and at the goal, must admit these
    barred : joints of the arms at an end from which no such motion was found, each with "start" or "goal"
    found : function that is called with every joint motion that is verified
    recalled : the links corrected after rejections, if any, for all copies
    kept : motions whose joints were verified, or given (`keep`), with the slack and these joints, for all copies
    settings : settings of the robot's kinematics
    """

    robot: Robot
    scene: Scene
    caution: int = 0
    given: GivenJoints = NOT_GIVEN
    present: Array | None = None
    approach: bool = False
    release: bool = False
    barred: tuple[tuple[str, Array], ...] = ()
    found: Callable[[VerifiedJointMotion], None] | None = None
    recalled: list[Links] = field(default_factory=list)
    kept: list[tuple[CoordinatedMotion, float, tuple[JointMotion, JointVerdict]]] = field(
        default_factory=list
    )
    settings: CarrierSettings = CarrierSettings()

    def __post_init__(self) -> None:
        scene, old = self.scene, self.scene.words.version == 1
        if scene.n_dims != 3:
            raise unfit(
                scene, "workspace", "a robot moves in space, and the scene is planar", "use x, y and z"
            )
        if scene.file.load is None:
            told = "add load: {shape: bar, length: 0.5}" if old else "add payload and grasps"
            raise unfit(scene, "load", "there is nothing to carry", told)
        if scene.grasp is None:
            way_out = "add approach and closing to every grasp, such as [0, 0, -1] and [0, 1, 0]"
            told = "say it: grasp: {orientation: down, yaw: load}" if old else way_out
            raise unfit(scene, "grasp", f"a robot cannot know how to hold the {scene.words.load}", told)
        if reason := _unfit_grasps(scene, self.robot, self.holders, min(scene.clearance, ROBOT_CLEARANCE)):
            raise unfit(scene, *reason)

    @property
    def grasp(self) -> Grasp:
        """Return the grasps of the end effectors on the payload."""
        assert self.scene.grasp is not None, "scenes without a grasp are refused"
        return self.scene.grasp

    @cached_property
    def holders(self) -> tuple[Arm, ...]:
        """Return the arms in the order of the scene's manipulators."""
        try:
            return tuple(self.robot.arm(name) for name in self.scene.manipulators)
        except RobotError as error:
            error.key = self.scene.words.key("manipulators")
            raise

    @property
    def arms(self) -> Arms:
        """Return the arms' chains, links and surroundings as arrays, for kernels."""
        return self._arms._replace(links=self.recalled[-1]) if self.recalled else self._arms

    @cached_property
    def _arms(self) -> Arms:
        scene, grasp = self.scene, self.grasp
        edges, radii = load_lines(scene)
        n_nodes = None if grasp.keypoints else len(self.holders)  # a load may turn while its hands stay
        around = LinkSurroundings(
            hold=HandOrientation(
                np.ascontiguousarray(grasp.at_rest),
                np.ascontiguousarray(grasp.turning),
                grasp.holders[0],
                grasp.holders[min(1, len(grasp.holders) - 1)],
                np.array(grasp.keypoints, dtype=np.int64),
            ),
            obstacles=scene.obstacles,
            edges=edges,
            radii=radii,
            carried=carried_masses(scene),
            clearance=scene.clearance,
            spare=self.settings.spare * (1 + self.caution),
            share=self.settings.share * 0.9**self.caution,
            posture=np.concatenate([arm.home for arm in self.holders]),
            ends=np.stack([scene.nodes_at(end)[:n_nodes] for end in ("start", "goal")]),
            eased=max(0.0, scene.clearance - ROBOT_CLEARANCE),
        ).in_motion(scene)
        chains, links, ranges, _ = of_robot(self.robot, self.holders)
        return Arms(chains, links, ranges, around)

    def along(self, nodes: Array) -> ArmsFollower:
        """Return the follower of motions near a given one; `nodes` has the shape (n_steps, n_nodes, 3) [m]."""
        return ArmsFollower.near(self.arms, self.best_course(nodes), nodes, self.settings.follower)

    def stricter(self) -> RobotCarrier:
        """Return a copy with more caution, after an accepted motion was rejected."""
        return self._changed("_tally", caution=self.caution + 1)

    def on(self, scene: Scene) -> RobotCarrier:
        """Return a copy on a scene with another duration and other limits.

        Where obstacles move and the duration differs, the joints at the goal are solved anew.
        """
        other = self._changed(scene=scene)
        if scene.moving.any() and scene.duration != self.scene.duration:
            for name in ("goals", "_pairs", "_led"):  # obstacles are elsewhere at the goal
                vars(other).pop(name, None)
        return other

    def without(self, ends: Mapping[str, Array]) -> RobotCarrier:
        """Return a copy that avoids some joints at the ends. Joints near them are avoided too.

        Parameters
        ----------
        ends : arrays, shape (n_joints,), by "start" or "goal" [rad]
        """
        barred = ((end, q[self.ends.columns]) for end, q in ends.items())
        other = self._changed(barred=(*self.barred, *barred))
        for name in ("_pairs", "_led"):
            vars(other).pop(name, None)
        return other

    def _changed(self, *kept: str, **changes: Any) -> RobotCarrier:
        """Return a changed copy that keeps valid cached values. These depend on neither caution nor duration."""
        other = replace(self, **changes)
        for name in ("starts", "goals", "_solved", "_retreats", "_refused", "_pairs", "_led", *kept):
            if name in vars(self):
                vars(other)[name] = vars(self)[name]
        return other

    @cached_property
    def starts(self) -> tuple[Array, ...]:
        """Return each arm's joints at the start, best first; arrays, shape (n_branches, n_joints).

        Raises
        ------
        SceneError
            If an arm cannot reach the start.
        """
        if self.given.begin is not None:
            return tuple(self.given.begin[arm.columns][None] for arm in self.holders)
        return self.ends.branches("start", self._solved_at("start"))

    @cached_property
    def goals(self) -> tuple[Array, ...]:
        """Return each arm's joints at the goal, as `starts`."""
        if self.given.end is not None:
            return tuple(self._ending[None, self.ends.part(i)] for i in range(len(self.holders)))
        return self.ends.branches("goal", self._solved_at("goal"))

    @cached_property
    def _ending(self) -> Array:
        """Return the arms' joints at the goal nearest to `end`; array, shape (n_joints of the arms,).

        Raises
        ------
        SceneError
            If they do not reach it from there.
        """
        assert self.given.end is not None, "it is asked for"
        nodes, columns = self.scene.nodes_at("goal"), self.ends.columns
        joints, missing = tracked(self.arms, nodes[None], self.given.end[columns][None], EXACT)
        if missing.max() > EXACT.tolerance:
            arm = self.holders[int(missing.argmax())].name
            raise unfit(
                self.scene,
                "manipulators.goal",
                f"the arm '{arm}' does not hold the payload at its goal with the joints given for that",
                "give joints with which all arms hold it there",
            )
        return joints[0]

    def _solved_at(self, end: str, all_seeds: bool = True) -> tuple[Array, ...]:
        """Return the arms' joints at an end by their poses alone."""
        if end not in self._solved:
            self._solved[end] = self.ends.solved(end, all_seeds)
        return self._solved[end]

    @cached_property
    def _solved(self) -> dict[str, tuple[Array, ...]]:
        return {}

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
        """Plan a payload path that the arms can follow; arguments as in `comove.planning.planner.plan`."""
        found = self._planned(World.of(space), start, goal, margin, rng, required, max_nodes)
        return None if found is None else found[0]

    def plan_in_time(
        self,
        world: World,
        start: Array,
        goal: Array,
        speed: float,
        margin: float,
        rng: np.random.Generator,
        *,
        max_nodes: int,
        share: float = 1.0,
        **free: Any,
    ) -> tuple[Array, Array] | None:
        """Plan among moving obstacles; see `Kinematics.plan_in_time`. The arms can follow the path in time."""
        world = world.paced(speed, share)
        found = self._planned(world, start, goal, margin, rng, world.space.required, max_nodes)
        return None if found is None else (found[0], found[2][:, 0].copy())

    def _planned(
        self,
        world: World,
        start: Array,
        goal: Array,
        margin: float,
        rng: np.random.Generator,
        required: float,
        max_nodes: int,
    ) -> tuple[Array, Array, Array] | None:
        """Plan as `plan_with_arms` does, between some of the joints at both ends."""
        drawn = self._tally.drawn(rng, len(self.kept))
        first, last = self._pairs[drawn]
        ends = (np.array(start), first), (np.array(goal), last)  # kernels compile anew for read-only arrays
        found = plan_with_arms(
            world,
            self.arms,
            *ends,
            margin,
            rng,
            required=required,
            lenient=next(self._leniency),
            max_nodes=max_nodes,
            settings=self.settings.plans,
        )
        self._tally.note(drawn, found is not None)
        if found is not None:
            vars(self)["_led"] = np.stack([first, last])
        return found

    @property
    def ends(self) -> EndJoints:
        """Return the arms' joints at both ends."""
        return EndJoints(
            self.robot, self.scene, self.grasp, self.holders, self.arms, self._begun, self.settings.ends
        )

    @cached_property
    def _begun(self) -> Array:
        """Return the arms' joints before they approach the start; array, shape (n_joints of the arms,)."""
        columns = np.concatenate([arm.columns for arm in self.holders])
        return np.array((self.robot.home if self.present is None else self.present)[columns])

    @cached_property
    def _pairs(self) -> Array:
        """Return admissible joints at both ends, likeliest first; array, shape (n_pairs, 2, n_joints)."""
        pairs = self.ends.pairs(self.starts, self.goals)
        if not self.transfers:
            return pairs
        admitted = list(islice((pair for pair in pairs if self._admits(*pair)), self.settings.ends.n_pairs))
        if not admitted:
            raise self._no_retreat(pairs[0])
        return np.array(admitted)

    @cached_property
    def _retreats(self) -> dict[str, Retreat]:
        """Return the required retreats, by the end."""
        home = self.robot.home
        present = home if self.present is None else self.present
        wanted = (("start", self.approach, present), ("goal", self.release, home))
        return {end: Retreat.on(self.scene, self.robot, end, other) for end, asked, other in wanted if asked}

    @cached_property
    def _refused(self) -> dict[tuple[str, bytes], RobotError | None]:
        """Return the known reasons against retreats, by end and joints."""
        return {}

    def _admits(self, first: Array, last: Array) -> bool:
        """Return whether joints at start and goal admit the required retreats."""
        return all(
            self._refusal(end, q) is None
            and not any(
                at == end and np.abs(q - other).max() <= self.settings.ends.same_branch
                for at, other in self.barred
            )
            for end, q in (("start", first), ("goal", last))
        )

    def _refusal(self, end: str, q: Array) -> RobotError | None:
        """Return the reason against a retreat from joints at an end."""
        if end not in self._retreats:
            return None
        key = end, q.round(DIGITS).tobytes()
        if key not in self._refused:
            joints, error = self.robot.home, None
            joints[self.ends.columns] = q
            try:
                self._retreats[end].behind(joints)
            except RobotError as why:
                error = why
            self._refused[key] = error
        return self._refused[key]

    def _no_retreat(self, pair: Array) -> RobotError:
        """Return the error that no joints admit approach and release. Its reason is that of the likeliest pair."""
        refusals = (self._refusal(end, q) for end, q in zip(("start", "goal"), pair, strict=True))
        told = next(
            (refusal.message for refusal in refusals if refusal is not None), "no other joints are left"
        )
        return RobotError(
            f"no joints that hold the load leave room for {' and '.join(self.transfers)}: {told}",
            key="grasp",
            way_out="give another grasp, move what is near, or do not ask for it",
        )

    @property
    def transfers(self) -> list[str]:
        """Return which of approach and release are required, by name."""
        return [name for name, asked in (("approach", self.approach), ("release", self.release)) if asked]

    @cached_property
    def _leniency(self) -> Iterator[float]:
        """Return tolerances of the links' clearance, one for each plan [m]. Capsules are wider than links."""
        return cycle((0.0, FAT, FATTEST))

    @cached_property
    def _tally(self) -> Tally:
        return Tally.of(len(self._pairs), self.settings.ends.unlikely)

    def ask(self, nodes: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Compute penalties of (nearly) impossible motions, and whether motions are possible.

        Parameters
        ----------
        nodes : array, shape (n_rollouts, n_steps, n_nodes, 3), end effectors first, evenly spaced in time [m]

        Returns
        -------
        penalty, possible : arrays, shape (n_rollouts,)
        """
        nodes = self._sampled(nodes)
        return self._asked(nodes, self.best_course(nodes[0]), self.arms)

    def asking(self, nodes: Array) -> Callable[[int], Iterator[tuple[float, bool, bool]]]:
        """Return a function that computes `ask` of a numbered motion, links last. It uses the present links."""
        nodes, courses, arms = self._sampled(nodes), list[Array](), self.arms

        def ask(k: int) -> Iterator[tuple[float, bool, bool]]:
            if not courses:
                courses.append(self.best_course(nodes[0]))
            missing, rates, jolt, penalty, q = demands(arms, nodes[k], courses[0], self.scene.duration)
            possible = bool((missing <= MET).all() and (rates <= 1.0).all())
            least = (penalty + self.settings.ease * jolt).sum()
            yield float(least), possible, False
            clearance, contact = contact_along(arms, q, nodes[k])
            yield float(least + contact), possible and clearance > arms.around.clearance, True

        return ask

    def _sampled(self, nodes: Array) -> Array:
        """Return the keypoints at the samples for evaluating arms."""
        n = self.settings.n_samples
        if self.scene.moving.any():  # even times tell where obstacles are
            n = 1 + next(k for k in range(n - 1, nodes.shape[1]) if (nodes.shape[1] - 1) % k == 0)
        steps = np.linspace(0, nodes.shape[1] - 1, n).round().astype(int)
        return np.ascontiguousarray(nodes[:, steps])

    def _asked(self, nodes: Array, course: Array, arms: Arms) -> tuple[Array, NDArray[np.bool_]]:
        """Compute `ask` on a course."""
        strain, around = self.strain(nodes, course, arms), arms.around
        possible = (strain.missing <= MET).all(axis=1) & (strain.rates <= 1.0).all(axis=(1, 2))
        possible &= strain.clearance > around.clearance
        return (strain.penalty + self.settings.ease * strain.jolt).sum(axis=1) + strain.contact, possible

    def shortest(self, motion: CoordinatedMotion, timed: float = 4.0, slower: float = 1.002) -> float:
        """Return the least duration in which joints can follow a motion [s].

        The law of motion is unchanged; the result is inf if an arm does not reach, or the motors cannot even hold the
        payload. It is `slower` than the value computed at the duration `timed` [s], as joints are sampled elsewhere
        in another duration.
        """
        joints, miss = self.track(motion.on(motion.scene.timed(timed)))
        if miss is not None:
            return np.inf
        return slower * shortest_duration(self.robot, joints, self.holders, self.arms.around.carried)

    def track(self, motion: CoordinatedMotion, *, haste: int = 1) -> tuple[JointMotion, Miss | None]:
        """Compute the joints along a motion, and their largest miss; `haste` as in `search.tracking.track`."""
        course = self.best_course(motion.nodes(N_COARSE))
        joints, miss = track(self.robot, self.holders, self.arms, motion, course, haste=haste)
        if self.given.end is None or miss is not None:
            return joints, miss
        led, share = joints.position[:, self.ends.columns], joints.time[:, None] / joints.duration
        rise = share**3 * (
            10.0 - 15.0 * share + 6.0 * share**2
        )  # redundant joints end elsewhere, if left free
        return track_near(self.robot, self.holders, self.arms, motion, led + rise * (self._ending - led[-1]))

    def reasons(self, motion: CoordinatedMotion | VerifiedMotion) -> tuple[str, ...]:
        """Return the reasons why the robot cannot execute a motion."""
        return self._carried_out(motion, self.settings.slack)[1].reasons

    @property
    def checks(self) -> tuple[Check, ...]:
        """Return the check of whether a motion can be executed."""
        return (CheckOfVerified(self.reasons),)

    def carried_out(self, motion: CoordinatedMotion) -> tuple[JointMotion, JointVerdict]:
        """Compute and verify the joints along a motion, with the tightest bounds."""
        return self._carried_out(motion, 0.0)

    def _carried_out(
        self, given: CoordinatedMotion | VerifiedMotion, slack: float
    ) -> tuple[JointMotion, JointVerdict]:
        """Compute and verify the joints that follow a motion. Verified ones are kept."""
        motion = given.motion if isinstance(given, VerifiedMotion) else given
        known = [(tight, result) for of, tight, result in self.kept if of is motion]
        for tight, result in known:
            if tight <= slack:
                return result
        before = known[0][1] if known else None
        if before is not None and before[1].verified is not None:  # only its clearances depend on the slack
            result = before[0], tightened(before[1].verified)
        else:
            joints, miss = self.track(motion, haste=self.settings.haste if slack > 0.0 else 1)
            if miss is not None:
                return joints, JointVerdict(None, JointReport(), (str(miss),))
            result = joints, verify_joints(self.robot, given, joints, slack=slack)
        self._recall(*result)
        if result[1].verified is not None:
            self.kept.append((motion, slack, result))
            if self.found is not None and not known:
                self.found(result[1].verified)
        return result

    def _recall(self, joints: JointMotion, verdict: JointVerdict) -> None:
        """Note links that met in a rejected motion despite clear capsules."""
        report, needed = verdict.report, min(self.scene.clearance, ROBOT_CLEARANCE)
        if not report.clearance_self < needed or "clearance_self" not in report.where:
            return
        _, time = report.where["clearance_self"]
        q = joints.curve(time)[np.concatenate([arm.columns for arm in self.holders])]
        self.recalled[:] = [recalled(self.robot, self.holders, self.arms.links, q, needed + FAT)]

    def keep(self, motion: CoordinatedMotion, led: Array) -> None:
        """Verify a motion with its joints nearest to `led`, and keep them.

        Parameters
        ----------
        led : array, shape (n_steps, n_joints), joints of the arms at even times [rad]
        """
        joints, miss = track_near(self.robot, self.holders, self.arms, motion, led)
        if miss is None:
            verdict = verify_joints(self.robot, motion, joints)
        else:
            verdict = JointVerdict(None, JointReport(), (str(miss),))
        self.kept.append((motion, 0.0, (joints, verdict)))

    def require_reach(self, all_seeds: bool = True) -> None:
        """Solve both ends, before the time of a search starts; `all_seeds` as of `EndJoints.solved`.

        Raises
        ------
        SceneError
            If an arm cannot reach its start or its goal.
        RobotError
            If no joints there admit a required approach or release.
        MissedPose
            If an arm may reach an end, but not from the first seeds.
        """
        for retreat in self._retreats.values():
            retreat.require_free_rest()
        given = {"start": self.given.begin, "goal": self.given.end}
        for end in (end for end, joints in given.items() if joints is None):
            self._solved_at(end, all_seeds)  # before clearances matter
        _ = self.starts, self.goals
        if self._retreats:
            _ = self._pairs

    def require_clear_ends(self) -> None:
        """Reject a scene whose ends have contacts for all joints.

        Raises
        ------
        SceneError
            If the exact bodies are too near; with their names.
        """
        for end, branches in (("start", self.starts), ("goal", self.goals)):
            if near := self.ends.contact(end, branches):
                raise unfit(
                    self.scene,
                    f"manipulators.{end}",
                    f"{near} come too near to each other at the {end}{self._when(end)}, whatever joints hold the "
                    "load",
                    self._apart(end) or "move it, or hold it in another way",
                )

    def _when(self, end: str) -> str:
        """Return the time of an end, in words, where it matters."""
        if not self.scene.moving.any():
            return ""
        return f" at {self.scene.time_at(end):g} s"

    def require_room_for_obstacles(self) -> None:
        """Reject obstacles that move into links at rest or both ends.

        Raises
        ------
        SceneError
            If one does; with the names of both bodies and the time.
        """
        if not self.scene.moving.any():
            return
        if (struck := struck_at_rest(self.robot, self.scene)) is not None:
            pair, near, time = struck
            raise unfit(
                self.scene,
                "obstacles",
                f"{pair} {'meet' if near <= 0.0 else f'come within {near:.3g} m of each other'} at {time:.2f} s, and "
                "no arm that carries moves that link",
                "move the obstacle along another path, or the robot's base or home",
            )
        self.require_clear_ends()

    def _apart(self, end: str) -> str:
        """Return the message that two end effectors are very near each other. It is empty otherwise."""
        hands = self.scene.nodes_at(end)[: len(self.holders)]
        for i, j in combinations(range(len(hands)), 2):
            gap = float(np.linalg.norm(hands[i] - hands[j]))
            if gap < APART:
                names = f"'{self.holders[i].name}' and '{self.holders[j].name}'"
                return f"move the grasps of {names} apart: they are {gap:.3g} m apart, hands need {APART:g} m"
        return ""

    @property
    def turning(self) -> float:
        """Return the least joint rotation to the start and goal [rad]. It is much more where links touch."""
        first, last = self._pairs[0]
        away = apart(self.ends.present, first) + apart(first, last)
        return away + (0.0 if self.may_be_clear_at_ends else 2.0 * np.pi)

    @property
    def may_be_clear_at_ends(self) -> bool:
        """Return whether the likeliest joints at both ends may be clear. Capsules, which are wider, decide."""
        return self._clearance_at_ends > self.scene.clearance - FAT

    @property
    def is_clear_at_ends(self) -> bool:
        """Return whether capsules alone tell that both ends are clear.

        Bodies may stick out of their capsules a little, and solid payloads are lines.
        """
        least = self.scene.clearance + PROUDEST + ROUGH
        return not len(self.scene.body.solids) and self._clearance_at_ends > least

    @property
    def _clearance_at_ends(self) -> float:
        """Return the likeliest joints' least clearance of capsules [m]."""
        ends = zip(self._pairs[0], ("start", "goal"), strict=True)
        return min(
            float(self.ends.at(end).clearances(q[None], self.scene.nodes_at(end))[0]) for q, end in ends
        )

    def try_planning(self) -> None:
        """Plan from start to goal, and go along a path between them."""
        coordinates, rng = load_coordinates(self.scene), np.random.default_rng(0)
        space, (start, _, goal, _) = configuration_space(self.scene, coordinates), coordinates.boundary()
        if self.scene.moving.any():
            self.plan_in_time(spacetime(self.scene, space), start, goal, np.inf, 0.0, rng, max_nodes=8)
        else:
            self.plan(space, start, goal, 0.0, rng, max_nodes=8)
        way_length(space, targets_along(space, np.stack([start, goal]), gentle=False)[0])
        for name in ("_tally", "_leniency", "_led"):  # that this plan does not count
            vars(self).pop(name, None)

    def try_following(self) -> None:
        """Follow the straight motion from start to goal, and verify that."""
        coordinates = load_coordinates(self.scene)
        straight = CoordinatedMotion.straight(self.scene, coordinates)
        nodes = coordinates.nodes(np.ascontiguousarray(straight.knots[0].T[None]))
        self.ask(nodes)
        _ = [*self.asking(nodes)(0)]
        joints, _ = self.track(straight)
        verify_joints(self.robot, straight, joints)
        follower = self.along(nodes[0])
        follower.slopes(coordinates.blocks, straight.knots[0], *follower.follow(nodes[0]))

    def strain(self, nodes: Array, course: Array, arms: Arms | None = None) -> Strain:
        """Compute the demands of motions on the arms; `course` is (2, n_joints), nodes as in `ask`."""
        arms = arms or self.arms
        if len(nodes) == 1:
            return Strain(*follow(arms, nodes, course, self.scene.duration))
        parts = np.array_split(nodes, min(len(nodes), N_THREADS))
        done = THREADS.map(lambda part: follow(arms, part, course, self.scene.duration), parts)
        return Strain(*(np.concatenate(arrays) for arrays in zip(*done, strict=True)))

    def best_course(self, nodes: Array) -> Array:
        """Choose each arm's best start and nearest goal; array, shape (2, n_joints). The last plan's are preferred.

        Parameters
        ----------
        nodes : array, shape (n_steps, n_nodes, 3) [m]
        """
        n_most = max(map(len, self.starts))
        nodes = np.ascontiguousarray(nodes[None, :: self.settings.coarser])
        led: Array | None = vars(self).get("_led")  # of the last path planned, along which most motions go
        bound = self.approach or self.release
        cost = (2, np.inf)
        if led is not None:
            strain = self.strain(nodes, led)
            kept = (strain.missing <= MET).all() and (strain.rates <= self.arms.around.share).all()
            cost = self._cost(strain)
            if n_most == 1 or (kept and cost[0] < 2):
                return led
        joined = [self._onward(i) for i in range(len(self.starts))]
        tried = np.concatenate(
            [each[np.minimum(np.arange(n_most), len(each) - 1)] for each in joined], axis=2
        )
        if n_most == 1 and not bound:
            return tried[0]
        best = course_penalties(self.arms, nodes[0], tried, self.scene.duration).argmin(axis=0)
        first = self.arms.chains.first
        chosen = np.hstack([tried[k][:, first[i] : first[i + 1]] for i, k in enumerate(best)])
        if bound and not self._admits(*chosen):
            return self._pairs[0] if led is None else led
        return chosen if led is None or self._cost(self.strain(nodes, chosen)) < cost else led

    def _onward(self, i: int) -> Array:
        """Return arm i's starts with their nearest goals; array, shape (n_starts, 2, n_joints of the arm)."""
        starts = self.starts[i]
        goals = turned_towards(self.arms.chains, starts[:, None], self.goals[i], self.ends.part(i))
        away = np.abs(starts[:, None] - goals).max(axis=2).round(DIGITS)
        return np.stack([starts, goals[np.arange(len(starts)), away.argmin(axis=1)]], axis=1)

    def _cost(self, strain: Strain) -> tuple[int, float]:
        """Return the tightness of links in one motion, and its penalty.

        The former counts first: a smoother motion improves rates, but hardly ever links that meet.
        """
        return int(self.ends.tight(strain.clearance)[0]), float(strain.penalty.sum() + strain.contact[0])
