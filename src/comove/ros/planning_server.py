"""Server of motions for MoveIt 2: requests for two arms that hold one payload, planned and verified.

`ros2_moveit.py` serves the action under ROS's own Python. Requests are answered here one after the other, and what is
computed for a robot is kept between them. A bad request is refused in words and never ends the server.
"""

from __future__ import annotations

import base64
import itertools
import sys
import tempfile
import time
import traceback
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from comove.errors import ComoveError, InputError, listed, shortened
from comove.model.files.moveit import BAGS, MARK, planning_scene_in
from comove.model.files.moveit_bags import SCENE, Encoded, encoded, messages_in, write
from comove.model.scene import Scene
from comove.planning.clock import Budget
from comove.planning.effort import EffortName
from comove.planning.kernels import SceneKind
from comove.planning.solution import Solution
from comove.robots.carrying import GivenJoints, RobotCarrier
from comove.robots.kernels import load_robot_kernels
from comove.robots.model import Robot
from comove.robots.planning_scenes import (
    Displacement,
    ImportOptions,
    PlacedPayload,
    scene_from,
    with_supports_at_rest,
)
from comove.ros.bridges import Event, awaited
from comove.ros.live_scenes import SERVICE, STARTING, TOPIC, LiveScene, refusal
from comove.ros.parts import CARRY, parts_of
from comove.ros.planning_requests import (
    ErrorCode,
    PayloadGoal,
    Refusal,
    budget_in,
    goals_in,
    groups_in,
    joints_of_group,
    path_constraints,
    require_plannable,
    scaling,
)
from comove.solving import solve

ACTION = "/comove/move_action"
LOOK = 0.05  # s, between looks at what arrives while it plans
OPTION = "allowed_planning_time"

Tell = Callable[[str], None]


@dataclass(frozen=True)
class PlanningSettings:
    """Settings of a server of motions.

    Attributes
    ----------
    action : name of the action
    topic, service : topic of planning scenes, and the service that tells the present one
    scene : file of the planning scene that is there before the topic tells one; None for none
    options : payload, objects that are left out, and supports, as of `comove scene import`
    srdf : SRDF with the groups that requests may name, besides the robot's own name; None for none
    budget : time for planning where a request sets none [s]
    effort, seed : as of `comove.solve`
    rate : points of a trajectory a second [Hz]
    """

    action: str = ACTION
    topic: str = TOPIC
    service: str = SERVICE
    scene: Path | None = None
    options: ImportOptions = field(default_factory=ImportOptions)
    srdf: Path | None = None
    budget: float = 5.0
    effort: EffortName = "quick"
    seed: int = 0
    rate: float = 100.0


USUAL = PlanningSettings()


@dataclass(frozen=True)
class PlannedMotion:
    """A verified motion, with the joints of the requested group."""

    solution: Solution
    joints: frozenset[str]


class MotionPlanner:
    """Planner of requests of MoveIt 2, without ROS.

    Parameters
    ----------
    robot : robot whose arms hold the payload
    settings : settings

    Raises
    ------
    InputError
        If the planning scene or the SRDF of the settings cannot be read.
    """

    def __init__(self, robot: Robot, settings: PlanningSettings = USUAL):
        self.robot, self.settings = robot, settings
        self.groups = groups_in(robot, settings.srdf)
        self.given = [] if settings.scene is None else _messages_of(settings.scene)
        self._scaled = {(1.0, 1.0): robot}

    def plan(
        self,
        request: Mapping[str, Any],
        messages: Sequence[Encoded],
        *,
        only_plan: bool = True,
        stop: Callable[[], bool] | None = None,
        tell: Tell = lambda _: None,
    ) -> PlannedMotion:
        """Plan the motion that a request asks for.

        Parameters
        ----------
        request : fields of `moveit_msgs/MotionPlanRequest`, as `ros2_moveit.py` tells them
        messages : planning scenes, from the last whole one on, the request's own last
        only_plan : whether the motion is not to be executed
        stop : function that returns whether the search shall end
        tell : function that gets what was asked for, in words

        Raises
        ------
        Refusal
            If there is no such motion, or the request cannot be met.
        """
        require_plannable(request, only_plan)
        robot, budget = self._limited(*scaling(request)), budget_in(request, self.settings.budget)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "request.mcap")
            placed = self._placed(file, messages, robot)
            joints = joints_of_group(request, self.groups, placed)
            goals = goals_in(request, placed)
            for i, goal in enumerate(goals):
                tell(f"{goal.words}, within {budget:g} s")
                begun = time.process_time()
                try:
                    share = Budget.of(budget / (len(goals) - i), OPTION)
                    return PlannedMotion(self._solved(file, request, placed, goal, share, stop), joints)
                except Refusal as refused:
                    if i == len(goals) - 1 or refused.code == ErrorCode.PREEMPTED:
                        raise
                    budget = max(budget - (time.process_time() - begun), 0.1)
        raise AssertionError("a request has a goal")

    def _limited(self, velocity: float, acceleration: float) -> Robot:
        """Return the robot with a share of its limits."""
        key = velocity, acceleration
        if key not in self._scaled:
            own = self.robot
            limits: dict[str, Any] = {
                "velocity": velocity * own.velocity,
                "acceleration": acceleration * own.acceleration,
            }
            self._scaled[key] = replace(own, **limits)
        return self._scaled[key]

    def _placed(self, file: Path, messages: Sequence[Encoded], robot: Robot) -> PlacedPayload:
        """Write the planning scene of a request; return its payload."""
        if not messages:
            raise Refusal(
                ErrorCode.COLLISION_CHECKING_UNAVAILABLE,
                f"no planning scene was told on {self.settings.topic}, and the request has none; start move_group, "
                "give comove serve a file by --scene, or send the whole scene as planning_scene_diff",
            )
        write(file, messages)
        try:
            if not planning_scene_in(file).attached:
                raise _not_attached(None)
            placed = PlacedPayload.of(file, robot, self.settings.options)
            if not placed.is_held:
                raise _not_attached(placed.payload.object.name)
            _ = placed.holders
        except InputError as error:
            of_state = error.key is not None and error.key.startswith("robot_state")
            code = ErrorCode.INVALID_ROBOT_STATE if of_state else ErrorCode.INVALID_OBJECT_NAME
            raise Refusal.of(code, error) from None
        return placed

    def _solved(
        self,
        file: Path,
        request: Mapping[str, Any],
        placed: PlacedPayload,
        goal: PayloadGoal,
        budget: Budget,
        stop: Callable[[], bool] | None,
    ) -> Solution:
        """Solve the scene of a goal; refuse what is not verified."""
        constraints = path_constraints(request, placed, goal)
        scene = self._scene(file, placed, goal, constraints)
        end = goal.joints or None
        load_robot_kernels(SceneKind.of(scene))
        begin = np.array(placed.q)
        at_end = None if end is None else np.array([end[name] for name in placed.robot.joint_names])
        _require_ends(RobotCarrier(placed.robot, scene.timed(10.0), given=GivenJoints(begin, at_end)))
        try:
            found = solve(
                scene,
                robot=placed.robot,
                begin=dict(placed.present),
                end=end,
                seed=self.settings.seed,
                budget=budget,
                effort=self.settings.effort,
                stop=stop,
            )
        except InputError as error:
            raise Refusal.of(ErrorCode.PLANNING_FAILED, error) from None
        if found.interrupted:
            raise Refusal(
                ErrorCode.PREEMPTED,
                "the request was cancelled, or the server ended, while it was planned for",
            )
        if not found.verified:
            reasons = found.reasons if found.motion is None else found.joints.reasons
            code = ErrorCode.TIMED_OUT if found.timed_out else ErrorCode.PLANNING_FAILED
            raise Refusal(code, f"no motion was verified: {listed(list(dict.fromkeys(reasons)), 4)}")
        last = found.joints.motion.joints.position[-1]
        goal.require_met(dict(zip(placed.robot.joint_names, last.tolist(), strict=True)))
        return found

    def _scene(
        self, file: Path, placed: PlacedPayload, goal: PayloadGoal, constraints: list[dict[str, Any]]
    ) -> Scene:
        """Return the scene of a goal."""
        options = replace(self.settings.options, goal=Displacement(goal.displacement))
        folder = file.parent
        try:
            imported = scene_from(file, placed.robot, folder, "request", options)
            for name, mesh in imported.meshes.items():
                (folder / name).write_bytes(mesh)
            data, _ = with_supports_at_rest(imported.data, folder)
        except InputError as error:
            raise Refusal.of(ErrorCode.COLLISION_CHECKING_UNAVAILABLE, error) from None
        try:
            return Scene.from_dict(
                data | ({"constraints": constraints} if constraints else {}), folder=folder
            )
        except InputError as error:
            raise Refusal.of(_code_of_end(error), error) from None


def _not_attached(name: str | None) -> Refusal:
    told = (
        "nothing is attached to the robot" if name is None else f"'{shortened(name)}' is attached to no hand"
    )
    return Refusal(
        ErrorCode.INVALID_OBJECT_NAME,
        f"{told}, and arms move with the payload that they hold; attach it to one hand, and name the other hands "
        "among its touch_links",
    )


def _require_ends(carrier: RobotCarrier) -> None:
    """Refuse ends that are out of reach, or where something touches."""
    try:
        carrier.require_reach()
    except InputError as error:
        raise Refusal.of(ErrorCode.NO_IK_SOLUTION, error) from None
    try:
        carrier.require_clear_ends()
    except InputError as error:
        raise Refusal.of(_code_of_end(error), error) from None


def _code_of_end(error: InputError) -> ErrorCode:
    """Return the code for an end with contacts."""
    key = error.key or ""
    if "goal" in key:
        return ErrorCode.GOAL_IN_COLLISION
    return ErrorCode.START_STATE_IN_COLLISION if "start" in key else ErrorCode.PLANNING_FAILED


def _messages_of(path: Path) -> list[Encoded]:
    """Return a planning scene in a file as messages."""
    if path.suffix.lower() in BAGS or (path / MARK).is_file():
        return messages_in(path)
    return [encoded(planning_scene_in(path))]


class PlanningServer:
    """A server of motions in ROS 2, as a context.

    Parameters
    ----------
    robot, settings : as of `MotionPlanner`
    tell : function that gets what was asked for and found, in words
    python : path of a Python with ROS 2 and moveit_msgs; searched for unless given

    Attributes
    ----------
    planner : planner of the requests
    ended : reason why it ended by itself; empty if it did not

    Raises
    ------
    InputError
        As `MotionPlanner`.
    SendError
        If there is no ROS 2 with MoveIt's messages here, or it does not take a name.
    """

    def __init__(
        self,
        robot: Robot,
        settings: PlanningSettings = USUAL,
        *,
        tell: Tell = print,
        python: str | None = None,
    ):
        self.planner, self.ended, self._tell = MotionPlanner(robot, settings), "", tell
        self._waiting, self._cancelled = deque[Event](), set[str]()
        self._looked, self._numbers = -np.inf, itertools.count(1)
        load_robot_kernels(SceneKind(3, meshes=True))  # before it is there
        self._live = LiveScene(settings.topic, settings.service, python=python)
        self._live.process.tell({"do": "serve", "action": settings.action})
        others = list[Event]()
        answer = awaited(self._live.process, ("serving", "refused"), STARTING, others)
        if answer is None or answer["event"] != "serving":
            self._live.process.close()
            told = {"reason": "ended", "what": "it did not answer"}
            raise refusal(answer if answer is not None and answer["event"] == "refused" else told)
        self.middleware = f"{answer['distribution'] or 'ROS 2'}, {answer['rmw']}, domain {answer['domain']}"
        self._note(others)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._live.process.close()

    def offers(self) -> list[tuple[str, str]]:
        """Return what it offers, in words."""
        settings = self.planner.settings
        return [
            ("middleware", self.middleware),
            ("action", f"{settings.action} (moveit_msgs/action/MoveGroup)"),
            ("groups", listed(list(self.planner.groups), 12)),
            ("planning scene", f"{settings.topic}, {settings.service}"),
        ]

    def run(self, stop: Callable[[], bool]) -> None:
        """Answer requests until `stop` returns True, or the program in ROS ends."""
        while not stop() and not self.ended:
            self._listen(LOOK)
            if self._waiting:
                self._answer(self._waiting.popleft(), stop)

    def _listen(self, wait: float) -> None:
        """Note what has arrived; wait at most `wait` [s]."""
        self._looked = time.monotonic()
        self._note(self._live.process.news(wait))

    def _note(self, events: Sequence[Event]) -> None:
        for event in events:
            if event["event"] == "goal":  # with the planning scene of that moment
                self._waiting.append({**event, "scene": list(self._live.messages)})
            elif event["event"] == "cancel":
                self._cancelled.add(event["goal"])
            elif event["event"] in ("ended", "refused"):
                self.ended = f"the interfaces of ROS ended: {self._live.process.last_words()}"
            else:
                self._live.note(event)

    def _is_over(self, goal: str, stop: Callable[[], bool]) -> bool:
        """Return whether a request is not to be planned for any longer."""
        if time.monotonic() - self._looked > LOOK:
            self._listen(0.0)
        return goal in self._cancelled or bool(self.ended) or stop()

    def _answer(self, event: Event, stop: Callable[[], bool]) -> None:
        """Answer a request; tell what was asked for and found."""
        goal, number, begun = event["goal"], next(self._numbers), time.monotonic()

        def tell(text: str) -> None:
            self._tell(f"request {number}: {text}")

        more = [(SCENE, base64.b64decode(data)) for data in event["more"]]
        messages = [*(event["scene"] or self.planner.given), *more]
        answer: dict[str, Any] = {"status": "ABORTED"}
        try:
            if self._is_over(goal, stop):
                raise Refusal(
                    ErrorCode.PREEMPTED,
                    "the request was cancelled, or the server ended, before it was planned for",
                )
            self._live.process.tell({"do": "begin", "goal": goal})
            planned = self.planner.plan(
                event["request"],
                messages,
                only_plan=event["only_plan"],
                stop=lambda: self._is_over(goal, stop),
                tell=tell,
            )
            answer = self._trajectory(planned)
        except Refusal as refused:
            answer |= {"code": refused.code.value, "text": refused.text}
            if goal in self._cancelled:
                answer["status"] = "CANCELED"
        except ComoveError as error:
            answer |= {"code": ErrorCode.PLANNING_FAILED.value, "text": str(error)}
        except Exception as error:  # the next request may be answered all the same
            traceback.print_exc(file=sys.stderr)
            told = f"this is a defect of comove ({type(error).__name__}: {error}); please report it"
            answer |= {"code": ErrorCode.CRASH.value, "text": told}
        seconds = time.monotonic() - begun
        self._live.process.tell({"do": "end", "goal": goal, "seconds": seconds, **answer})
        name = ErrorCode(answer["code"]).name
        tell(f"{answer['text'] if name == 'SUCCESS' else f'{name}: ' + answer['text']} ({seconds:.2f} s)")
        self._cancelled.discard(goal)

    def _trajectory(self, planned: PlannedMotion) -> dict[str, Any]:
        """Return a motion as the answer to a request."""
        motion = planned.solution.joints.motion
        samples = parts_of(motion)[CARRY].samples(self.planner.settings.rate)
        names = tuple(name for name in samples.joint_names if name in planned.joints)
        moved = samples.of(names)
        rows = zip(
            moved.nanoseconds.tolist(),
            moved.position.tolist(),
            moved.velocity.tolist(),
            moved.acceleration.tolist(),
            strict=True,
        )
        report = motion.report
        least = min(report.clearance_scene, report.clearance_load, report.clearance_self)
        with suppress(TypeError):  # there is nothing to hit
            least = min(least, motion.motion.clearance_min)
        text = f"verified: {motion.joints.duration:.2f} s, clearance {1e3 * least:.1f} mm"
        start = dict(zip(samples.joint_names, samples.position[0].tolist(), strict=True))
        return {
            "status": "SUCCEEDED",
            "code": ErrorCode.SUCCESS.value,
            "text": text,
            "start": start,
            "joints": names,
            "points": [*rows],
        }
