"""Planning of tasks: each stage becomes scenes, whose motions are solved and verified one after the other.

Grasps, inverse-kinematics branches, approach and first transfer are chosen together, by `comove.solve`. Where a later
transfer fails with the grasps chosen, the first one is solved again with the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from comove.arrays import Array
from comove.errors import ComoveError, RobotError, TaskError
from comove.geometry.rotations import quaternion_of_rotation
from comove.model.scene import Scene
from comove.planning.solution import Solution
from comove.robots.model import Arm
from comove.robots.motion import JointMotion
from comove.robots.transfers import Retreat, backwards, plan_transfers, withdrawal
from comove.robots.verification.carried import Carried
from comove.solving import solve
from comove.tasks.grasps import MOST_WAYS
from comove.tasks.plan import TaskPart, TaskPlan
from comove.tasks.stages import Leg, Stage
from comove.tasks.world import Body, World, pose_of

SUNK = 2e-3  # m, of a body in what it rests on, that is lifted out
AROUND = 1.0  # m, of the workspace around everything that is carried

Ways = list[dict[str, dict[str, Any]]]
"""Ways to hold a body by all arms: a grasp of a scene for each."""


def planned(world: World, stages: Sequence[Stage], budget: float, seed: int) -> TaskPlan:
    """Return the plan of all stages; see `Task.solve`."""
    parts, poses, left = list[TaskPart](), {name: body.pose for name, body in world.bodies.items()}, budget
    before: _Solved | None = None
    for number, stage in enumerate(stages):
        if not stage.legs:
            raise TaskError(
                f"'{stage.body.name}' is approached and not carried",
                key="approach",
                way_out="close the hands and carry it, or leave the approach out",
            )
        share = left / (len(stages) - number)
        planner = _Planner(world, stage, poses, seed, before if stage.takes_over else None)
        found, before, spent = planner.parts(share)
        parts += found
        left = max(left - spent, 0.1 * budget)
        poses[stage.body.name] = stage.legs[-1].goal
    return TaskPlan(world.robot, tuple(parts))


class _Solved(NamedTuple):
    """A leg's solution, and its scene."""

    scene: Scene
    solution: Solution


class _Planner:
    """Planner of one stage.

    Parameters
    ----------
    world, stage : the world, and the stage
    poses : where bodies are, by name, arrays, shape (4, 4) [m]
    seed : seed of all random numbers
    giving : last transfer of the arms from which these take the body over; None for none
    """

    def __init__(
        self, world: World, stage: Stage, poses: Mapping[str, Array], seed: int, giving: _Solved | None
    ):
        self.world, self.stage, self.seed, self.giving = world, stage, seed, giving
        others = (body.at(poses[name]) for name, body in world.bodies.items() if name != stage.body.name)
        self.obstacles = [dict(obstacle) for obstacle in world.obstacles]
        self.obstacles += [obstacle for body in others for obstacle in _as_obstacles(body)]
        if giving is not None:
            self.supports: list[str | None] = []
        elif stage.stands_on is not None:
            self.supports = [stage.stands_on]
        else:
            self.supports = [one["name"] for one in world.obstacles if one.get("support")]

    def parts(self, budget: float) -> tuple[list[TaskPart], _Solved, float]:
        """Return the stage's parts, last transfer, and processor time [s]."""
        ways, spent, error = self._ways(), 0.0, None
        while ways:
            try:
                legs = list[_Solved]()
                for solved in self._legs(ways, budget - spent):
                    legs.append(solved)
                    spent += solved.solution.effort.seconds
                return list(self._written(legs)), legs[-1], spent
            except TaskError as why:
                error = error or why
                if not legs or spent >= budget or (len(legs) == len(self.stage.legs) and self.giving is None):
                    break
                chosen = self._held(legs[0].solution, self._start(legs[0].scene))
                ways = [way for way in ways if not _is_way(way, chosen)]
        assert error is not None, "there was a way to try"
        raise error

    def _ways(self) -> Ways:
        """Return the ways to hold the body."""
        grasps = self.stage.grasps
        each = int(MOST_WAYS ** (1.0 / len(grasps)) + 1e-9)
        ways = [grasp.ways(each) for grasp in grasps.values()]
        return [dict(zip(grasps, chosen, strict=True)) for chosen in product(*ways)]

    def _legs(self, ways: Ways, budget: float) -> Iterator[_Solved]:
        """Yield the legs' solutions, the first by any of some ways."""
        stage, start, begin, left = self.stage, self.stage.body.pose, None, budget
        supports = self.supports
        for number, leg in enumerate(stage.legs):
            is_last = number + 1 == len(stage.legs)
            wanted: dict[str, Any] = {"begin": begin} if number else {"approach": self.giving is None}
            if is_last and stage.retreats:
                wanted["release"] = True
            scene, solution = self._solved(
                f"carry {number + 1} of '{stage.body.name}'", leg, start, supports, ways, left, wanted
            )
            left = max(left - solution.effort.seconds, 0.1 * budget)
            yield _Solved(scene, solution)
            ways, start, supports = [self._held(solution, self._start(scene))], leg.goal, [leg.rests_on]
            begin = solution.joints.motion.joints.position[-1]

    def _solved(
        self,
        name: str,
        leg: Leg,
        start: Array,
        supports: Sequence[str | None],
        ways: Ways,
        budget: float,
        wanted: Mapping[str, Any],
    ) -> _Solved:
        """Solve a leg; `wanted` are further arguments of `comove.solve`."""
        try:
            scene = self._scene(leg, start, supports, ways)
            found = solve(scene, robot=self.world.robot, budget=budget, seed=self.seed, **wanted)
        except ComoveError as error:
            raise TaskError(
                f"{name}: {getattr(error, 'message', error)}",
                key=getattr(error, "key", None),
                way_out=getattr(error, "way_out", None) or "give it other grasps or another goal",
            ) from error
        if not found.verified:
            raise TaskError(
                f"{name}: {'; '.join(found.reasons) or 'no motion was found'}",
                key="carry",
                way_out="give it other grasps, another goal or more budget",
            )
        if found.joints.without:
            raise TaskError(
                f"{name}: {'; '.join(found.joints.without)}",
                key="approach",
                way_out="give it other grasps, or more budget",
            )
        return _Solved(scene, found)

    def _around(self, *supports: str | None) -> list[dict[str, Any]]:
        """Return the obstacles; the body rests on some at an end."""
        return [
            {key: value for key, value in one.items() if key != "support"}
            | ({"support": True} if one["name"] in supports else {})
            for one in self.obstacles
        ]

    def _scene(self, leg: Leg, start: Array, supports: Sequence[str | None], ways: Ways) -> Scene:
        """Return the scene of a leg, which begins on supports."""
        body = self.stage.body
        around = np.stack([start[:3, 3], leg.goal[:3, 3]])
        reach = AROUND + body.radius
        data: dict[str, Any] = {
            "version": 2,
            "name": body.name,
            "workspace": {
                "lower": (around.min(axis=0) - reach).tolist(),
                "upper": (around.max(axis=0) + reach).tolist(),
            },
            "obstacles": self._around(*supports, leg.rests_on),
            "payload": {
                "parts": [dict(part) for part in body.parts],
                "mass": body.mass,
                "start": _written_pose(start),
                "goal": _written_pose(leg.goal),
            },
            "grasps": ways if len(ways) > 1 else ways[0],
            "limits": {"clearance": self.world.clearance},
        }
        if leg.time is not None:
            data["duration"] = leg.time
        if leg.upright_deg is not None:
            data["constraints"] = [{"type": "upright", "tolerance_deg": leg.upright_deg}]
        for end, under in (("start", supports), ("goal", [leg.rests_on])):
            data["payload"][end]["position"][2] += self._sunk(data, end, under)
        return Scene.from_dict(data, folder=self.world.folder)

    @staticmethod
    def _start(scene: Scene) -> Array:
        """Return the body's pose at the start of a scene; array, shape (4, 4) [m]."""
        load = scene.file.load
        assert load is not None and load.start is not None, "it has a payload with poses"
        return pose_of(load.start.model_dump())

    def _sunk(self, data: dict[str, Any], end: str, supports: Sequence[str | None]) -> float:
        """Return how deep the body is in supports at an end [m].

        It is 0 beyond a tolerance. Prisms that hold its cylinders are larger than these.
        """
        under = [k for k, one in enumerate(self.obstacles) if one["name"] in supports]
        if not under:
            return 0.0
        data = {**data, "obstacles": self._around()}
        scene = Scene.from_dict(data, folder=self.world.folder, check_ends=False)
        depth = -scene.nearest_at(scene.nodes_at(end), 0.0, under)[0]
        return depth if 0.0 < depth < SUNK else 0.0

    def _held(self, solution: Solution, start: Array) -> dict[str, dict[str, Any]]:
        """Return the grasps of a solution whose body starts at a pose."""
        robot, q = self.world.robot, solution.joints.motion.joints.position[0]
        found = {}
        for name in self.stage.grasps:
            there = np.linalg.inv(start) @ robot.tool_pose(q, robot.arm(name))
            found[name] = {
                "position": there[:3, 3].tolist(),
                "approach": there[:3, 2].tolist(),
                "closing": there[:3, 1].tolist(),
            }
        return found

    def _written(self, legs: Sequence[_Solved]) -> Iterator[TaskPart]:
        """Yield the parts of solved legs."""
        stage, first, last = self.stage, legs[0].solution, legs[-1].solution
        close, open_ = stage.close_time or 1.0, stage.open_time
        if self.giving is not None:
            yield from self._taken_over(first, close)
        else:
            approach, motion = first.joints.transfers, first.joints.motion
            if close != approach.grip_time:
                approach = plan_transfers(motion, release=False, grip_time=close, seed=self.seed)
            closing = dict.fromkeys(stage.grasps, approach.approach.duration - close)
            yield TaskPart(
                ("approach", "close"), approach.approach, closing, {}, approach.clearance_min, first
            )
        for leg in legs:
            found = leg.solution.joints
            yield TaskPart(("carry",), found.motion.joints, {}, {}, _clearance(leg.solution), leg.solution)
        if open_ is None:
            return
        opening = dict.fromkeys(stage.grasps, 0.0)
        if not stage.retreats:
            end = last.joints.motion.joints
            rest = JointMotion(
                np.array([0.0, open_]), end.joint_names, np.repeat(end.position[-1:], 2, axis=0)
            )
            yield TaskPart(("open",), rest, {}, opening, _clearance(last), last)
            return
        release = last.joints.transfers
        if open_ != release.grip_time:
            release = plan_transfers(last.joints.motion, approach=False, grip_time=open_, seed=self.seed)
        yield TaskPart(("open", "retreat"), release.release, {}, opening, release.clearance_min, last)

    def _taken_over(self, taking: Solution, time: float) -> Iterator[TaskPart]:
        """Yield how arms take the body over.

        They come while the others hold it, and then these leave.
        """
        assert self.giving is not None, "the body is taken from other arms"
        robot, given = self.world.robot, self.giving.solution
        takers = tuple(robot.arm(name) for name in self.stage.grasps)
        givers = tuple(robot.arm(name) for name in self.giving.scene.manipulators)
        held, away = given.joints.motion.joints.position[-1], robot.home
        both = held.copy()
        for arm in takers:
            both[arm.columns] = away[arm.columns] = taking.joints.motion.joints.position[0][arm.columns]
        coming, clearance = self._withdrawal(taking, "start", held, givers, both, time)
        closing = dict.fromkeys(self.stage.grasps, coming.duration - time)
        yield TaskPart(("hand_over",), backwards(coming), closing, {}, clearance, taking)
        leaving, clearance = self._withdrawal(given, "goal", away, takers, both, time)
        opening = {arm.name: 0.0 for arm in givers}
        yield TaskPart(("hand_over",), leaving, {}, opening, clearance, given)

    def _withdrawal(
        self, solution: Solution, end: str, other: Array, holding: tuple[Arm, ...], both: Array, time: float
    ) -> tuple[JointMotion, float]:
        """Return how arms leave the body at an end, and the clearance.

        Others hold it meanwhile. The motion leads from joints `both` to joints `other`, arrays (n_joints,).
        """
        assert solution.motion is not None, "it is verified"
        robot, carried = self.world.robot.resting(other), Carried(solution.motion.motion)
        try:
            return withdrawal(Retreat(robot, carried, end, other, holding=holding), both, time, self.seed)
        except RobotError as error:
            raise TaskError(
                f"hand_over of '{self.stage.body.name}': {error.message}",
                key="hand_over",
                way_out=error.way_out,
            ) from error


def _clearance(solution: Solution) -> float:
    """Return the certified clearance of a solution's joints and payload [m]."""
    report = solution.joints.report
    assert solution.motion is not None, "parts are of verified solutions"
    links = min(report.clearance_scene, report.clearance_load, report.clearance_self)
    return min(links, solution.motion.clearance_min)


def _is_way(way: Mapping[str, Mapping[str, Any]], held: Mapping[str, Mapping[str, Any]]) -> bool:
    """Return whether a way to hold a body was the chosen one."""
    return all(
        np.abs(np.array(way[arm][key]) - np.array(held[arm][key])).max() < 1e-3
        for arm in held
        for key in ("position", "approach", "closing")
    )


def _written_pose(pose: Array) -> dict[str, Any]:
    return {
        "position": pose[:3, 3].tolist(),
        "quaternion_wxyz": quaternion_of_rotation(pose[:3, :3]).tolist(),
    }


def _as_obstacles(body: Body) -> Iterator[dict[str, Any]]:
    """Yield a body's parts as obstacles where it is.

    Raises
    ------
    TaskError
        If a part has a shape that no obstacle has.
    """
    for number, part in enumerate(body.parts):
        inside = pose_of(part)
        shape = {key: value for key, value in part.items() if key not in ("position", "quaternion_wxyz")}
        if shape["shape"] == "bar":  # along x; a capsule is along z
            shape["shape"] = "capsule"
            inside[:3, :3] = inside[:3, :3] @ np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
        if shape["shape"] == "hull":
            raise TaskError(
                f"'{body.name}' stands in the way, and a hull is no shape of an obstacle",
                key="bodies",
                way_out="give it boxes, cylinders, bars or a mesh",
            )
        place = _written_pose(body.pose @ inside)
        shape["center"] = place.pop("position")
        yield {"name": f"{body.name}_{number}", **shape, **place}
