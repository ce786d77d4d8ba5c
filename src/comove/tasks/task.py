"""Tasks: sequences of phases over one world, planned and verified as a whole.

```python
from comove.tasks import Grasp, Task, World

world = World.from_mujoco(env.sim)
pot = world.body("pot_root")
held = dict(tilt_deg=(-40, 40), flip=True)
task = Task(world)
task.approach(robot0=Grasp(pot, site="pot_handle0", **held), robot1=Grasp(pot, site="pot_handle1", **held))
task.close(time=1.0)
task.carry(pot, shift=[0, 0, 0.2], upright=True)
plan = task.solve(budget=10)
for command in plan.stream(rate=20): ...
```
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from comove.arrays import Array
from comove.dmp.arguments import is_number, numbers
from comove.errors import TaskError, near_name
from comove.tasks.grasps import Grasp
from comove.tasks.plan import TaskPlan
from comove.tasks.planning import planned
from comove.tasks.stages import Leg, Stage
from comove.tasks.world import Body, World


@dataclass(eq=False)
class Task:
    """A sequence of phases, each added by the method of its name.

    The arms begin where they are in the world. A gripper holds nothing at first.

    Parameters
    ----------
    world : robot, obstacles and movable bodies

    Attributes
    ----------
    stages : what was added so far: for each body that is held, from the approach to the retreat
    """

    world: World
    stages: list[Stage] = field(default_factory=list, init=False)
    _poses: dict[str, Array] = field(default_factory=dict, init=False)

    def approach(self, **grasps: Grasp) -> None:
        """Approach a body, with open grippers.

        Parameters
        ----------
        grasps : how each arm may hold it, by the arm's name

        Raises
        ------
        TaskError
            If an arm is unknown or holds something, or the grasps are of several bodies.
        """
        self._require(not self._is_holding, "approach", "the hands are full", "open them before")
        done = not self.stages or self.stages[-1].retreats
        self._require(done, "approach", "the hands are at a body already", "retreat before")
        self._require_grasps("approach", grasps)
        bodies = {grasp.body.name for grasp in grasps.values()}
        self._require(
            len(bodies) == 1,
            "approach",
            f"the grasps are of {' and '.join(sorted(bodies))}",
            "let the arms carry one after the other",
        )
        body = next(iter(grasps.values())).body
        self._require(
            body.name in self.world.bodies,
            "approach",
            f"the world has no body '{body.name}'",
            "give a Grasp of one of its bodies: world.body(NAME)",
        )
        legs = [leg for stage in self.stages if stage.body.name == body.name for leg in stage.legs]
        stands_on = legs[-1].rests_on if legs else None
        self.stages.append(Stage(body.at(self.pose_of(body)), self._now(grasps), stands_on=stands_on))

    def close(self, time: float = 1.0) -> None:
        """Close the grippers of the approach, in a time [s].

        Raises
        ------
        TaskError
            If there was no approach, or the time is not positive.
        """
        self._require(
            bool(self.stages) and self.stages[-1].close_time is None,
            "close",
            "no hand has approached anything",
            "approach a body before",
        )
        self.stages[-1].close_time = _positive("close", time)

    def carry(
        self,
        body: Body,
        *,
        to: Sequence[Sequence[float]] | Array | None = None,
        shift: Sequence[float] | None = None,
        upright: bool | float = False,
        time: float | None = None,
    ) -> None:
        """Carry the body that is held.

        Parameters
        ----------
        body : the body
        to : its goal, array, shape (4, 4), a pose in the world
        shift : instead, displacement from where it is, array, shape (3,) [m]
        upright : whether what is up stays up, within 5 degrees; or within so many [deg]
        time : duration [s]; as short as possible unless given

        Raises
        ------
        TaskError
            If it is not held, or there is not one goal.
        """
        self._carry("carry", body, to, shift, upright, time)

    def _carry(
        self,
        phase: str,
        body: Body,
        to: Sequence[Sequence[float]] | Array | None,
        shift: Sequence[float] | None,
        upright: bool | float,
        time: float | None,
        on: str | None = None,
    ) -> None:
        """Add a transfer; see `carry`. `on` names the obstacle on which the body then rests."""
        stage = self._held(phase, body)
        self._require(
            (to is None) != (shift is None), "carry", "it has not one goal", "give either `to` or `shift`"
        )
        if to is not None:
            goal = numbers(to)
            self._require(
                goal.shape == (4, 4) and _is_pose(goal), "carry", "`to` is no pose", "give a 4 x 4 pose"
            )
        else:
            step = numbers(shift)
            self._require(
                step.shape == (3,) and bool(np.isfinite(step).all()),
                "carry",
                f"`shift` is {shift}",
                "give three numbers [m]",
            )
            goal = self.pose_of(body).copy()
            goal[:3, 3] += step
        tolerance = {True: 5.0, False: None}[upright] if isinstance(upright, bool) else upright
        self._require(
            tolerance is None or (is_number(tolerance) and 0.0 < tolerance < 180.0),
            phase,
            f"`upright` is {upright!r}",
            "give True, False, or a tolerance below 180 [deg]",
        )
        stage.legs.append(Leg(goal, tolerance, None if time is None else _positive(phase, time), on))
        self._poses[body.name] = goal

    def set_down(
        self,
        body: Body,
        on: str,
        at: Sequence[float],
        *,
        upright: bool | float = True,
        time: float | None = None,
    ) -> None:
        """Set the held body down on an obstacle, turned as it is.

        Parameters
        ----------
        body : the body
        on : name of the obstacle, a level box, on which it then rests
        at : array, shape (2,), where its frame is then, x and y in the world [m]
        upright, time : as of `carry`

        Raises
        ------
        TaskError
            If it is not held, or there is no such obstacle.
        """
        self._held("set_down", body)
        goal = self.pose_of(body).copy()
        place = numbers(at)
        told = place.shape == (2,) and bool(np.isfinite(place).all())
        self._require(told, "set_down", f"`at` is {at}", "give x and y in the world [m]")
        goal[:2, 3] = place
        goal[2, 3] += self.world.top_of(on) - body.at(goal).lowest
        self._carry("set_down", body, goal, None, upright, time, on)

    def hand_over(self, body: Body, time: float = 1.0, **grasps: Grasp) -> None:
        """Hand the held body over to other arms.

        They approach it where it is and close; then those that held it open and draw back.

        Parameters
        ----------
        body : the body
        time : time in which grippers close, and in which the others open [s]
        grasps : how each arm may take it, by the arm's name

        Raises
        ------
        TaskError
            If it is not held or was not carried, or an arm is unknown or holds it already.
        """
        stage = self._held("hand_over", body)
        self._require(
            bool(stage.legs), "hand_over", "nothing was carried", "carry the body to where it is taken"
        )
        self._require_grasps("hand_over", grasps)
        both = sorted(set(grasps) & set(stage.grasps))
        self._require(not both, "hand_over", f"'{', '.join(both)}' holds it already", "name other arms")
        other = next(
            (grasp.body.name for grasp in grasps.values() if grasp.body.name != body.name), body.name
        )
        self._require(
            other == body.name, "hand_over", f"a grasp is of '{other}'", f"give grasps of '{body.name}'"
        )
        time = _positive("hand_over", time)
        stage = Stage(body.at(self.pose_of(body)), self._now(grasps), close_time=time, takes_over=True)
        self.stages.append(stage)

    def open(self, time: float = 1.0) -> None:
        """Open the grippers that hold something, in a time [s]. The body stays where it is.

        Raises
        ------
        TaskError
            If nothing is held, or the time is not positive.
        """
        self._require(self._is_holding, "open", "the hands are empty", "close them before")
        stage = self.stages[-1]
        self._require(bool(stage.legs), "open", "nothing was carried", "carry the body before")
        stage.open_time = _positive("open", time)

    def retreat(self) -> None:
        """Draw the open grippers back, and go where the arms began.

        Raises
        ------
        TaskError
            If no hand was opened.
        """
        self._require(
            bool(self.stages) and self.stages[-1].open_time is not None,
            "retreat",
            "no hand was opened",
            "open the hands before",
        )
        self.stages[-1].retreats = True

    def solve(self, budget: float = 30.0, seed: int = 0) -> TaskPlan:
        """Plan all phases and verify them.

        Parameters
        ----------
        budget : processor time [s]
        seed : seed of all random numbers

        Raises
        ------
        TaskError
            If there is nothing to plan, or a phase cannot be carried out; it names the phase and the reason.
        """
        self._require(bool(self.stages), "solve", "the task has no phase", "add an approach")
        return planned(self.world, self.stages, budget, seed)

    def pose_of(self, body: Body) -> Array:
        """Return where a body is after the phases so far; array, shape (4, 4) [m]."""
        return self._poses.get(body.name, body.pose)

    @property
    def _is_holding(self) -> bool:
        return (
            bool(self.stages) and self.stages[-1].close_time is not None and self.stages[-1].open_time is None
        )

    def _now(self, grasps: Mapping[str, Grasp]) -> dict[str, Grasp]:
        """Return grasps of a body where it is now."""
        return {
            name: replace(grasp, body=grasp.body.at(self.pose_of(grasp.body)))
            for name, grasp in grasps.items()
        }

    def _require_grasps(self, phase: str, grasps: Mapping[str, Grasp]) -> None:
        arms = {arm.name for arm in self.world.robot.arms}
        self._require(
            bool(grasps), phase, "no arm is named", f"name one or more of {', '.join(sorted(arms))}"
        )
        for name, grasp in grasps.items():
            self._require(name in arms, phase, f"there is no arm '{name}'", near_name(name, arms))
            self._require(
                isinstance(grasp, Grasp), phase, f"'{name}' has a {type(grasp).__name__}", "give a Grasp"
            )

    def _held(self, phase: str, body: Body) -> Stage:
        """Return the stage in which a body is held."""
        self._require(
            self._is_holding and self.stages[-1].body.name == body.name,
            phase,
            f"'{body.name}' is not held",
            "approach it and close the hands before",
        )
        return self.stages[-1]

    def _require(self, holds: bool, phase: str, message: str, way_out: str) -> None:
        if not holds:
            raise TaskError(message, key=phase, way_out=way_out)


def _positive(phase: str, time: float) -> float:
    if not is_number(time) or time <= 0.0:
        raise TaskError(f"a time of {time!r} s", key=phase, way_out="give a positive number")
    return float(time)


def _is_pose(pose: Array) -> bool:
    turn = pose[:3, :3]
    return bool(
        np.isfinite(pose).all()
        and np.abs(turn @ turn.T - np.eye(3)).max() < 1e-6
        and np.linalg.det(turn) > 0.0
        and np.abs(pose[3] - [0.0, 0.0, 0.0, 1.0]).max() < 1e-9
    )
