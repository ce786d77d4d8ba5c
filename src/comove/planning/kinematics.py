"""Kinematics of end effectors: limited by the scene alone, or by a robot."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.planning.planner import PlannerSettings, plan
from comove.planning.spacetime import plan_in_time
from comove.verification.verify import Check

if TYPE_CHECKING:
    from comove.model.motion import CoordinatedMotion
    from comove.model.scene import Scene
    from comove.planning.configurations import Space
    from comove.planning.convex.programme import Follower
    from comove.planning.objective import Evaluation, Objective
    from comove.planning.world import World

# Work, as computed distances that take about as long.
FOLLOWED = 5e4  # of a rollout that arms follow
CERTIFIED = 2e5  # of a certificate
CARRIED = 6e6  # of a certificate of joints


class Kinematics:
    """The kinematics of free end effectors, and the protocol of all others.

    Attributes
    ----------
    has_limits : whether it limits motions besides the scene; then it plans, and evaluates movements
    work_of_rollout, work_of_check : work of asking about a movement, and of verifying a motion
    """

    has_limits: ClassVar[bool] = False
    work_of_rollout: ClassVar[float] = 0.0
    work_of_check: ClassVar[float] = CERTIFIED

    @property
    def duration(self) -> float:
        """Return the duration of searches where the scene leaves it open [s]."""
        return 1.0

    @property
    def checks(self) -> tuple[Check, ...]:
        """Return the checks of a motion besides those of the scene."""
        return ()

    def planner(self, settings: PlannerSettings) -> Callable[..., Array | None]:
        """Return the path planner, as `comove.planning.planner.plan`; settings are of free ones."""
        return partial(plan, settings=settings)

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
        """Plan a path among moving obstacles, as `comove.planning.spacetime.plan_in_time`.

        `share` is that of their speed limits that joints may use, `free` are settings for free end effectors.
        """
        return plan_in_time(world, start, goal, speed, margin, rng, max_nodes=max_nodes, **free)

    def on(self, scene: Scene) -> Kinematics:
        """Return the kinematics on a scene with another duration and other limits.

        Where obstacles move and the duration differs, they are elsewhere at the goal, and so may be its joints.
        """
        return self

    def along(self, nodes: Array) -> Follower | None:
        """Return the follower of movements near a given one, or None. `nodes` is (n_steps, n_nodes, 3) [m]."""
        return None

    def followed(self, value: Evaluation, objective: Objective, q: Array) -> Evaluation:
        """Return an evaluation of rollouts, and whether they can be executed.

        Parameters
        ----------
        q : array, shape (n_rollouts, n_columns, n_steps), configurations of the objective's coordinates
        """
        return value

    def asking(self, nodes: Array) -> Callable[[int], Iterator[tuple[float, bool, bool]]]:
        """Return a function of a movement's number: its penalty, whether it seems possible, and whether that is all.

        They come in turn, ever closer from below; the last ones are exact.

        Parameters
        ----------
        nodes : array, shape (n_rollouts, n_steps, n_nodes, 3), end effectors first, evenly spaced in time [m]
        """
        return lambda k: iter([(0.0, True, True)])

    def shortest(self, motion: CoordinatedMotion) -> float:
        """Return the least duration of a movement's execution [s]. It is inf if the movement is impossible."""
        return 0.0

    def stricter(self) -> Kinematics:
        """Return more careful kinematics, after the rejection of a movement deemed possible."""
        return self


FREE = Kinematics()
"""The kinematics of free end effectors."""


class LimitedKinematics(Kinematics):
    """The base class of kinematics with own limits, such as robots."""

    has_limits: ClassVar[bool] = True
    work_of_rollout: ClassVar[float] = FOLLOWED
    work_of_check: ClassVar[float] = CARRIED
    scene: Scene
    """The scene on which end effectors are moved, with the duration in which motions are searched."""

    @abstractmethod
    def plan(
        self,
        space: Space,
        start: Array,
        goal: Array,
        margin: float,
        rng: np.random.Generator,
        *,
        required: float,
        max_nodes: int,
    ) -> Array | None:
        """Return an executable path, or None; as `comove.planning.planner.plan`."""

    @abstractmethod
    def ask(self, nodes: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return penalties of (nearly) impossible movements, and whether movements seem possible.

        Parameters
        ----------
        nodes : array, shape (n_rollouts, n_steps, n_nodes, 3), end effectors first, evenly spaced in time [m]

        Returns
        -------
        penalty, possible : arrays, shape (n_rollouts,)
        """

    def asking(self, nodes: Array) -> Callable[[int], Iterator[tuple[float, bool, bool]]]:
        """Return a function that evaluates `ask` for one movement, by its number."""

        def ask(k: int) -> Iterator[tuple[float, bool, bool]]:
            (penalty,), (possible,) = self.ask(nodes[k : k + 1])
            yield float(penalty), bool(possible), True

        return ask

    @abstractmethod
    def reasons(self, motion: CoordinatedMotion) -> Sequence[str]:
        """Return the reasons why a motion cannot be executed, verified exactly; none if it can."""

    @property
    def duration(self) -> float:
        """Return the duration of its scene [s]."""
        return self.scene.duration

    def planner(self, settings: PlannerSettings) -> Callable[..., Array | None]:
        """Return its own function `plan`."""
        return self.plan

    @property
    def checks(self) -> tuple[Check, ...]:
        """Return the check that a motion can be executed."""
        return (self.reasons,)

    def followed(self, value: Evaluation, objective: Objective, q: Array) -> Evaluation:
        """Return an evaluation with the penalties and possible rollouts of `ask`."""
        penalty, possible = self.ask(objective.coordinates.nodes(q))  # arms hold the real load
        return value._replace(penalty=value.penalty + penalty, possible=possible)
