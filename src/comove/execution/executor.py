"""Online execution among obstacles that move: follow a plan, dodge, stop in time, plan anew.

Every control step asks what is seen. While a plan holds that is certified for what is known exactly, it is followed
to the letter. Otherwise the twist programme lets through of it what keeps clear of what is seen now; where the way is
blocked the load slows down and waits in the open, dodging. A plan that seems not to hold any more is replaced by one
from the present state on.
"""

from __future__ import annotations

import time as clock
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from comove.coordination.motion import CoordinatedMotion
from comove.execution.sight import Known, Sight
from comove.planning.methods import Quick
from comove.planning.search import Interruption
from comove.planning.solver import solve
from comove.primitives.arguments import require_positive
from comove.primitives.rotations import matrices, quaternion_product
from comove.reaction.programme import MAX_PERIOD, NOTHING, Programme
from comove.reaction.twists import Poses, advanced, hand_velocities, nodes_of, poses_at, poses_of
from comove.scenes.distances import inflated
from comove.scenes.groups import Pose
from comove.scenes.scene import Scene
from comove.verification.certificate import certify
from comove.verification.record import Record

Array = NDArray[np.float64]

LONGER = (1.0, 1.3, 1.7, 2.3)  # times the shortest duration worth trying, tried in turn
HURRY = 1.5  # times the way at the speed limit, of the shortest plan
CATCH_UP = 0.1  # s, in which what is missing to a plan is made up for
HOMING = 0.5  # s, in which what is missing to the goal would be made up for, without a plan
CAUTION = 0.5  # of the speed limit, without a plan
LOST = 0.03  # m, behind a plan that was meant for something else
SPARE = 5e-4  # m, kept on top of the scene's clearance: what happens between two steps is judged as well
NO_PLAN = "no plan yet"
AT_LEISURE = Quick(n_failures=24)  # of the first plan: nothing moves yet
MOST_PATIENT = 2.0  # s, between two attempts to plan, after some have failed
AT_GOAL, AT_REST = 5e-4, 5e-4  # m and m/s, at which an execution ends


@dataclass(frozen=True)
class Pace:
    """How often things are done.

    Attributes
    ----------
    period : of control [s]
    watch : between two looks at whether the plan still holds [s]
    patience : between two attempts to plan [s]; it doubles while they fail
    """

    period: float = 0.01
    watch: float = 0.1
    patience: float = 0.25

    def __post_init__(self) -> None:
        for name in ("period", "watch", "patience"):
            require_positive(name, getattr(self, name), MAX_PERIOD)


@dataclass(frozen=True)
class Event:
    """Something that happened, at `time` [s], in words."""

    time: float
    what: str


@dataclass(eq=False)
class Log:
    """What is written down on the way.

    Attributes
    ----------
    events : in their order
    control, planning : what every control step and every attempt to plan took [s]
    blocking : how often which obstacle hindered most, by number; -1 for the border
    relaxed : by how much the programme had to give way at most [m/s]
    evaluations, generations : of all plans
    first_plan : what finding the first plan took [s], None where there was none
    """

    events: list[Event] = field(default_factory=list)
    control: list[float] = field(default_factory=list)
    planning: list[float] = field(default_factory=list)
    blocking: dict[int, int] = field(default_factory=dict)
    relaxed: float = 0.0
    evaluations: int = 0
    generations: int = 0
    first_plan: float | None = None


@dataclass(frozen=True, eq=False)
class Plan:
    """A verified motion from an instant [s] on; `certain` where nothing but the file says what obstacles do."""

    motion: CoordinatedMotion
    begins: float
    certain: bool

    @property
    def ends(self) -> float:
        """[s]"""
        return self.begins + self.motion.scene.duration

    def poses(self, time: float) -> Poses:
        """At an instant; those of the goal after the end."""
        s = min(1.0, max(0.0, (time - self.begins) / self.motion.scene.duration))
        return poses_at(self.motion.coordinates, self.motion.at(np.array([s]))[0, 0])


class Executor:
    """Executes a scene step by step.

    Parameters
    ----------
    scene : what is to be done
    sight : what is seen of its obstacles; their known motions unless given
    seed : of the plans
    pace : how often things are done

    Attributes
    ----------
    time : of now [s]
    poses : of the rigid groups
    twists : array, shape (n_groups, 6), of the last step
    log : what happened
    """

    def __init__(self, scene: Scene, sight: Sight | None = None, *, seed: int = 0, pace: Pace | None = None):
        self.scene, self.pace, self.seed = scene, pace or Pace(), seed
        self.sight = Known(scene) if sight is None else sight
        self.log, self.n_steps = Log(), 0
        self.poses, self.goal = poses_of(scene, "start"), poses_of(scene, "goal")
        self.twists = np.zeros((len(scene.groups), 6))
        # As they were when the last step began: seen from there, turning on is an acceleration too.
        self._before = np.zeros((len(scene.manipulators), 3))
        self.plan: Plan | None = None
        self._interruption = Interruption()
        self._programme = Programme(scene, self.pace.period)
        self._watched = self._planned = -np.inf
        self._patience = self.pace.patience

    @property
    def time(self) -> float:
        """Of now [s]."""
        return self.n_steps * self.pace.period

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C has ended the run."""
        return self._interruption.wished

    @property
    def arrived(self) -> bool:
        """Whether the load is at its goal, at rest."""
        hands = self._hands(self.poses) - self._hands(self.goal)
        at_rest = np.abs(hand_velocities(self.scene, self.poses, self.twists)).max() <= AT_REST
        return bool(at_rest and np.linalg.norm(hands, axis=1).max() <= AT_GOAL)

    def step(self) -> None:
        """One control step: see, decide, move."""
        self._keep_a_plan()
        begun = clock.perf_counter()
        period, now = self.pace.period, self.time
        if self.plan is not None and self.plan.certain:
            self.twists = twists_between(self.scene, self.poses, self.plan.poses(now + period), period)
        else:
            self.twists = self._dodged(now)
        self._before = hand_velocities(self.scene, self.poses, self.twists)
        self.poses = advanced(self.poses, self.twists, period)
        self.n_steps += 1
        self.log.control.append(clock.perf_counter() - begun)

    def run(self, budget: float) -> Record:
        """Execute until the load has arrived, or for `budget` [s] of simulated time; what happened.

        Raises
        ------
        OptionError
            If the budget is no positive number.
        """
        require_positive("budget", budget)
        poses = [self.poses]
        with self._interruption.noticed():
            while not (self.interrupted or self.time >= budget - 1e-9):
                self.step()
                poses.append(self.poses)
                if self.arrived and (self.plan is None or self.time >= self.plan.ends - 1e-9):
                    break
        if self.arrived or len(poses) == 1:
            poses.append(self.poses)  # and stands
        time = np.arange(len(poses)) * self.pace.period
        return Record(
            self.scene,
            time,
            np.array([p.center for p in poses]),
            np.array([p.quaternion for p in poses]),
            *self._truth(time),
        )

    @property
    def blocker(self) -> str:
        """What keeps the load from its goal, in words; empty where nothing is known to."""
        goal = self.goal
        nodes = nodes_of(self.scene, goal)
        seen = self.sight.seen(self.time)
        there = replace(self.scene, obstacles=seen.table, motions=(None,) * len(self.scene.motions))
        clearance, nearest = there.clearance_at(nodes)
        if clearance < self.scene.clearance:
            return f"{nearest} is where the load has to go"
        most = max(self.log.blocking, key=self.log.blocking.get, default=NOTHING)
        return "" if most == NOTHING else f"{self.scene.name_of(most)} was most in the way"

    def _truth(self, time: Array) -> tuple[Array, Array]:
        """Where obstacles really were, and how far they strayed between the steps."""
        centers = self.sight.true(time)
        if self.sight.certain:
            return centers, self.scene.obstacle_sags(time)
        between = 0.5 * (time[1:] + time[:-1])
        return centers, np.linalg.norm(self.sight.true(between) - 0.5 * (centers[1:] + centers[:-1]), axis=2)

    def _dodged(self, now: float) -> Array:
        """The twists that the programme allows of what the plan, or the way to the goal, asks for."""
        seen, period = self.sight.seen(now), self.pace.period
        seen = seen._replace(margin=seen.margin + SPARE)
        if self.plan is None:
            wanted = self._homing()
        else:
            here, there = self.plan.poses(now), self.plan.poses(now + period)
            twists = twists_between(self.scene, here, there, period)
            twists = twists + twists_between(self.scene, self.poses, here, CATCH_UP)
            wanted = hand_velocities(self.scene, self.poses, twists)
        allowed = self._programme.allowed(self.poses, self._before, wanted, seen)
        if allowed.blocking != NOTHING:
            blocking = self.scene.owner_of(allowed.blocking)
            self.log.blocking[blocking] = self.log.blocking.get(blocking, 0) + 1
        self.log.relaxed = max(self.log.relaxed, allowed.relaxed)
        return allowed.twists

    def _homing(self) -> Array:
        """Velocities of the hands straight to the goal, without haste; array, shape (n_hands, 3) [m/s]."""
        twists = twists_between(self.scene, self.poses, self.goal, HOMING)
        wanted = hand_velocities(self.scene, self.poses, twists)
        fastest = np.linalg.norm(wanted, axis=1).max()
        return wanted * min(1.0, CAUTION * min(self.scene.speed_limit, 1.0) / max(fastest, 1e-9))

    def _keep_a_plan(self) -> None:
        """See that there is a plan which holds, as far as one can see."""
        if self.plan is not None and self.plan.certain:
            return
        now = self.time
        if self.plan is not None and now - self._watched >= self.pace.watch - 1e-9:
            self._watched = now
            reason = self._against(self.plan, now)
            if reason:
                self._tell(f"the plan is given up: {reason}")
                self.plan = None
        if self.plan is None and not self.arrived and now - self._planned >= self._patience - 1e-9:
            self._planned = now
            self._plan_anew(now)
            failed = self.plan is None
            self._patience = min(MOST_PATIENT, 2 * self._patience) if failed else self.pace.patience

    def _against(self, plan: Plan, now: float) -> str:
        """Why a plan does not hold any more; empty if it does."""
        behind = self._hands(self.poses) - self._hands(plan.poses(now))
        if np.linalg.norm(behind, axis=1).max() > LOST:
            return f"the load is {np.linalg.norm(behind, axis=1).max():.3g} m behind it"
        if now >= plan.ends:
            return "" if self.arrived else "its end is past"
        expected, scene = self.sight.ahead(now), plan.motion.scene
        scene = replace(scene, obstacles=expected.obstacles, motions=expected.motions)
        ahead = certify(replace(plan.motion, scene=scene), since=(now - plan.begins) / scene.duration)
        if ahead.lower < scene.clearance:
            return f"{scene.name_of(ahead.nearest)} would come too near at {plan.begins + ahead.time:.2f} s"
        return ""

    def _plan_anew(self, now: float) -> None:
        """Look for a plan from the present state on."""
        begun = clock.perf_counter()
        expected = self.sight.ahead(now)
        expected = replace(expected, obstacles=inflated(expected.obstacles, self.sight.seen(now).margin))
        starts = tuple(
            Pose(center, matrices(quaternion))
            for center, quaternion in zip(self.poses.center, self.poses.quaternion, strict=True)
        )
        for k, longer in enumerate(LONGER):
            duration = longer * self._shortest(now)
            later = expected.resumed(now, duration, starts, self.twists)
            method = AT_LEISURE if self.n_steps == 0 and k == 0 else Quick()
            found = solve(later, seed=self.seed + 7 * self.n_steps + k, method=method, budget=30.0)
            self.log.evaluations += found.evaluations
            self.log.generations += found.generations
            if found.motion is not None:
                self.plan = Plan(found.attempt, now, self.sight.certain)
                self._tell(f"a plan that arrives at {now + duration:.2f} s")
                break
        else:
            if not (self.log.events and self.log.events[-1].what.startswith(NO_PLAN)):  # once is enough
                self._tell(f"{NO_PLAN}: {found.reasons[0]}")
        self.log.planning.append(clock.perf_counter() - begun)
        if self.plan is not None and self.log.first_plan is None:
            self.log.first_plan = sum(self.log.planning)

    def _shortest(self, now: float) -> float:
        """Duration of the first plan to try [s]: what the scene leaves, or enough for the way."""
        way = self._hands(self.goal) - self._hands(self.poses)
        way = float(np.linalg.norm(way, axis=1).max())
        enough = max(
            HURRY * way / self.scene.speed_limit, 4.0 * np.sqrt(way / self.scene.acceleration_limit), 0.5
        )
        return max(self.scene.duration - now, enough)

    def _hands(self, poses: Poses) -> Array:
        """Hands at given poses; array, shape (n_manipulators, 3) [m]."""
        return nodes_of(self.scene, poses)[: len(self.scene.manipulators)]

    def _tell(self, what: str) -> None:
        self.log.events.append(Event(self.time, what))


def twists_between(scene: Scene, here: Poses, there: Poses, duration: float) -> Array:
    """Constant twists from some poses to others; array, shape (n_groups, 6) [m/s, rad/s].

    A body whose roll nobody sees does not roll.
    """
    twists = np.zeros((len(scene.groups), 6))
    twists[:, :3] = (there.center - here.center) / duration
    for g, group in enumerate(scene.groups):
        if group.orientation in ("none", "fixed"):
            continue
        p, q = here.quaternion[g], there.quaternion[g]
        if group.orientation == "axis":
            a, b = (matrices(x)[:, 0] for x in (p, q))
            across, along = np.cross(a, b), float(a @ b)
        else:
            turn = quaternion_product(q, p * np.array([1.0, -1.0, -1.0, -1.0]))
            turn = turn if turn[0] >= 0 else -turn
            size = np.linalg.norm(turn[1:])
            twists[g, 3:] = turn[1:] * (2 * np.arctan2(size, turn[0]) / max(size, 1e-300)) / duration
            continue
        size = np.linalg.norm(across)
        twists[g, 3:] = across * (np.arctan2(size, along) / max(size, 1e-300)) / duration
    return twists
