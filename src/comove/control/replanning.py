"""Replanning: the reference of an execution, and its replacement.

Free end effectors plan in space and time, from the present state on; arms choose candidates on a roadmap in time
(`comove.robots.online.pilot`). A plan that is certified for exactly known motions is exact. Otherwise it is a guide:
every `Pace.watch` the rest of it is certified against the predicted obstacles, and a plan that fails is replaced.
"""

from __future__ import annotations

import time as clock
import warnings
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import ceil

import numpy as np
from numpy.typing import ArrayLike

from comove.control.loop import ControlLoop, Replanner, Setpoint
from comove.control.observers import STILL
from comove.control.safety.cbf_qp import MAX_PERIOD
from comove.control.safety.twists import advanced, hand_velocities, twists_between
from comove.dmp.arguments import require_positive
from comove.dmp.demonstrations import Demonstration
from comove.dmp.dmp import DMP
from comove.errors import ComoveWarning
from comove.geometry.distances import inflated
from comove.geometry.rotations import matrices
from comove.model.coordinates import HandPoses, poses_at
from comove.model.groups import GroupPose
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.planning.clock import Budget
from comove.planning.methods import Guide, Quick
from comove.planning.solver import solve
from comove.verification.bounds import NodeBounds, node_bounds
from comove.verification.certificate import certify

NO_PLAN = "no plan yet"
MAX_SAMPLED_STEPS = 2000  # control steps for which a plan is sampled at once


@dataclass(frozen=True)
class Pace:
    """Periods and time budgets of an execution.

    Attributes
    ----------
    period : control period [s]
    watch : time between two checks of whether the plan still holds [s]
    patience : time between two attempts to plan [s]; it doubles while they fail
    leisure, haste : work of the first attempt to plan and of any later one, as `Budget.work`: about as many seconds,
        but counted, so that a run is the same on every machine
    """

    period: float = 0.01
    watch: float = 0.1
    patience: float = 0.25
    leisure: float = 10.0
    haste: float = 1.0

    def __post_init__(self) -> None:
        for name in ("period", "watch", "patience"):
            require_positive(name, getattr(self, name), MAX_PERIOD)
        for name in ("leisure", "haste"):
            require_positive(name, getattr(self, name))


@dataclass(frozen=True)
class ExecutionSettings:
    """Settings of the executor that follow from nothing else.

    Attributes
    ----------
    longer : factors on the shortest duration worth trying, tried in turn
    room : distance that plans keep, if they can, from what is seen to move and may turn, on top of all margins [m]
    hurry : duration of the shortest plan, as a multiple of the way at the speed limit
    shortest : least duration of a plan [s]
    catch_up : time constant of the return to a plan [s]
    homing, caution : time constant of the approach to the goal without a plan [s], and share of the speed limit
    lost : distance behind a plan that was meant for something else [m]
    spare : kept on top of the scene's clearance, as an execution is verified between its steps as well [m]
    n_remembered : configurations of the last plan that the next one may use
    at_leisure : method of the first plan, while nothing moves yet
    most_patient : longest time between two attempts to plan, after some have failed [s]
    nearly_done : share of a demonstration after which it counts no more
    at_goal, at_rest : distance and speed at which an execution ends [m, m/s]
    """

    longer: tuple[float, ...] = (1.0, 1.3, 1.7, 2.3)
    room: float = 0.05
    hurry: float = 1.5
    shortest: float = 0.5
    catch_up: float = 0.1
    homing: float = 0.5
    caution: float = 0.5
    lost: float = 0.03
    spare: float = 5e-4
    n_remembered: int = 20
    at_leisure: Quick = field(default_factory=lambda: Quick(n_failures=24))
    most_patient: float = 2.0
    nearly_done: float = 0.8
    at_goal: float = 5e-4
    at_rest: float = 5e-4


SETTINGS = ExecutionSettings()


@dataclass(frozen=True, eq=False)
class Plan:
    """A verified motion that begins at an instant [s]. It is `certain` for obstacle motions of the file."""

    motion: CoordinatedMotion
    begins: float
    certain: bool

    @property
    def ends(self) -> float:
        """Return the time at which the motion ends [s]."""
        return self.begins + self.motion.scene.duration

    @cached_property
    def bounds(self) -> NodeBounds:
        """Return the bounds of its motion, whatever the obstacles do."""
        return node_bounds(self.motion)

    def poses(self, time: ArrayLike) -> HandPoses:
        """Return the groups' poses at times [s], shape (n_times,). After the end they are those of the goal."""
        s = np.clip((np.asarray(time) - self.begins) / self.motion.scene.duration, 0.0, 1.0)
        return poses_at(self.motion.coordinates, self.motion.at(s)[0])


class PlanReplanner(Replanner):
    """A replanner of free end effectors.

    Parameters
    ----------
    demonstration : movements that plans should resemble, one for each end effector; None for none
    seed : seed of the plans
    pace : periods and time budgets

    Attributes
    ----------
    plan : plan that is followed, None where there is none
    """

    def __init__(self, demonstration: tuple[DMP, ...] | None, seed: int, pace: Pace):
        self.demonstration, self.seed, self.pace = demonstration, seed, pace
        self.plan: Plan | None = None
        self._last: Plan | None = None  # that was followed
        self._first, self._poses = 0, list[HandPoses]()  # the step from which on it is sampled
        self._watched = self._planned = -np.inf
        self._patience = pace.patience

    def follow(self, run: ControlLoop, plan: Plan) -> None:
        """Follow a plan from now on."""
        self.plan = self._last = plan
        self._sample(run, plan)
        run.tell(f"a plan that arrives at {plan.ends:.2f} s")

    def current(self, run: ControlLoop) -> Setpoint:
        """Return the plan's poses, or straight ones at moderate speed without one."""
        if self.plan is not None:
            if not 0 <= run.n_steps - self._first < len(self._poses) - 1:
                self._sample(run, self.plan)
            k = run.n_steps - self._first
            here, ahead = self._poses[k : k + 2]
            return Setpoint(here, ahead, self.plan.certain)
        twists = twists_between(run.scene, run.poses, run.goal, SETTINGS.homing)
        fastest = np.linalg.norm(hand_velocities(run.scene, run.poses, twists), axis=1).max()
        twists = twists * min(1.0, SETTINGS.caution * min(run.scene.speed_limit, 1.0) / max(fastest, 1e-9))
        return Setpoint(run.poses, advanced(run.poses, twists, run.period))

    def _sample(self, run: ControlLoop, plan: Plan) -> None:
        """Keep a plan's poses at the next control steps."""
        left = min(max(ceil((plan.ends - run.time) / run.period), 1), MAX_SAMPLED_STEPS)
        self._first = run.n_steps
        self._poses = list(plan.poses(run.period * (run.n_steps + np.arange(left + 1))).each())

    def update(self, run: ControlLoop) -> None:
        """Discard a plan that is predicted to fail; search for a new one."""
        if self.plan is not None and self.plan.certain:
            return
        now = run.time
        if self.plan is not None and now - self._watched >= self.pace.watch - 1e-9:
            self._watched = now
            reason = self._against(run, self.plan)
            if reason:
                run.tell(f"the plan is given up: {reason}")
                self.plan = None
        if self.plan is None and not run.arrived and now - self._planned >= self._patience - 1e-9:
            self._planned = now
            self._plan_anew(run)
            failed = self.plan is None
            self._patience = min(SETTINGS.most_patient, 2 * self._patience) if failed else self.pace.patience

    def _against(self, run: ControlLoop, plan: Plan) -> str:
        """Return the reason why a plan no longer holds, or ""."""
        now, there = run.time, self.current(run).here
        if (behind := run.distance_from(there)) > SETTINGS.lost:
            return f"the load is {behind:.3g} m behind it"
        if now >= plan.ends:
            return "" if run.arrived else "its end is past"
        expected, scene = run.observer.predict(now), plan.motion.scene
        scene = replace(scene, obstacles=expected.obstacles, owners=expected.owners, motions=expected.motions)
        ahead = certify(
            replace(plan.motion, scene=scene), plan.bounds, since=(now - plan.begins) / scene.duration
        )
        if ahead.lower < scene.clearance:
            return f"{scene.name_of(ahead.nearest)} would come too near at {plan.begins + ahead.time:.2f} s"
        return ""

    def _plan_anew(self, run: ControlLoop) -> None:
        """Search for a plan from the present state on."""
        begun, now, log = clock.perf_counter(), run.time, run.log
        expected, seen = run.observer.predict(now), run.observer.observe(now)
        starts = tuple(
            GroupPose(center, matrices(quaternion))
            for center, quaternion in zip(run.poses.center, run.poses.quaternion, strict=True)
        )
        method, left = self._method(run), self.pace.haste if run.n_steps else self.pace.leisure
        tries = [(longer, 0.0) for longer in SETTINGS.longer]
        if not run.observer.certain:
            tries.insert(0, (SETTINGS.longer[0], SETTINGS.room))
        for k, (longer, room) in enumerate(tries):
            duration = longer * self._shortest(run)
            grown = seen.margin + room * (np.linalg.norm(seen.velocity, axis=1) > STILL)
            wider = replace(expected, obstacles=inflated(expected.obstacles, grown))
            later = wider.resumed(now, duration, starts, run.twists)
            # What is left, half of it unless nothing is to be tried afterwards.
            budget = Budget(work=left / (1 + (k + 1 < len(tries))))
            with warnings.catch_warnings(action="ignore", category=ComoveWarning):
                found = solve(
                    later,
                    demonstration=self.remaining(run.scene, now),
                    seed=self.seed + 7 * run.n_steps + k,
                    method=method,
                    budget=budget,
                    progress=False,
                )
            left -= found.effort.work
            log.evaluations += found.effort.evaluations
            log.generations += found.effort.generations
            if found.motion is not None or (
                isinstance(method, Guide) and method.will_do(found.report, later)
            ):
                self.follow(run, Plan(found.attempt, now, run.observer.certain))
                break
        else:
            if not (log.events and log.events[-1].what.startswith(NO_PLAN)):  # once is enough
                run.tell(f"{NO_PLAN}: {found.reasons[0]}")
        log.note_plan(clock.perf_counter() - begun)
        if self.plan is not None and log.first_plan is None:
            log.first_plan = log.planned

    def remaining(self, scene: Scene, now: float) -> dict[str, DMP] | None:
        """Return the rest of each demonstration from an instant on. None without one, or near its end."""
        done = now / scene.duration
        if self.demonstration is None or done > SETTINGS.nearly_done:
            return None
        rest = {own: _rest(own, done) for own in set(self.demonstration)}
        names = scene.manipulators
        return {name: rest[own] for name, own in zip(names, self.demonstration, strict=True)}

    def _method(self, run: ControlLoop) -> Quick:
        """Return the planning method.

        A plan among obstacles that are not exactly known only guides; the safety filter keeps the limits.
        """
        if run.n_steps == 0:
            return SETTINGS.at_leisure
        if run.observer.certain:
            return Quick()
        if self._last is None:
            return Guide()
        s = (run.time - self._last.begins) / self._last.motion.scene.duration
        return Guide(before=self._last.motion.at(np.linspace(min(s, 1.0), 1.0, SETTINGS.n_remembered))[0])

    def _shortest(self, run: ControlLoop) -> float:
        """Return the duration of the first plan to try [s].

        It is the scene's remaining time, or more if the path needs it.
        """
        scene, way = run.scene, run.distance_from(run.goal)
        at_the_limits = (
            SETTINGS.hurry * way / scene.speed_limit,
            4.0 * (way / scene.acceleration_limit) ** 0.5,
        )
        return max(scene.duration - run.time, *at_the_limits, SETTINGS.shortest)


def _rest(dmp: DMP, done: float) -> DMP:
    """Return the rest of a movement after the fraction `done` of it."""
    n_basis = max(20, dmp.weights.shape[1])
    time = np.linspace(done, 1.0, 10 * n_basis) * dmp.duration
    return DMP.fit(Demonstration(time - time[0], dmp.at(time).position, unit="any"), n_basis=n_basis)
