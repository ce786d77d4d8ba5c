"""The objectives by which a search compares motions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, Self

import numpy as np

from comove.arrays import Array
from comove.errors import OptionError
from comove.model.motion import CoordinatedMotion
from comove.planning.convex.costs import jerk_cost
from comove.verification.measures import WEIGHTS


class Evaluated(Protocol):
    """Equation (4) on the scene that is searched, with the demonstration (`planning.objective.Objective`)."""

    @property
    def demonstration(self) -> Array | None: ...
    @property
    def precision(self) -> Array | None: ...
    def cost(self, motion: CoordinatedMotion) -> Any: ...


class Criterion:
    """The base class of objectives. The lower value is better.

    Attributes
    ----------
    is_smooth : whether smooth motions alone minimise it, along a planned path
    is_time : whether it is the duration, so that the scene's own does not count
    least : lower bound of its value for motions that follow no demonstration
    """

    is_smooth: ClassVar[bool] = True
    is_time: ClassVar[bool] = False
    least: ClassVar[float] = 0.0

    def value(
        self, motion: CoordinatedMotion, evaluated: Evaluated, returned: Callable[[], CoordinatedMotion]
    ) -> float:
        """Return the value for a motion, where less is better.

        Parameters
        ----------
        evaluated : equation (4) on the scene that is searched, with the demonstration
        returned : function that returns the motion as the caller gets it
        """
        raise NotImplementedError

    def check_untaught(self) -> None:
        """Reject an objective that needs a demonstration, where there is none."""

    def pull(self, taught: bool) -> float:
        """Return the weight of the deviation from a demonstration. It is 0 without one, or if it is not used."""
        return 0.0

    @property
    def begins_taught(self) -> bool:
        """Return whether a search uses the demonstration, as its start or aim."""
        return self.pull(True) > 0

    @property
    def weights(self) -> PaperCost:
        """Return the weights of equation (4) evaluated beside the objective."""
        return PaperCost()

    @property
    def smoothness(self) -> LeastJerk:
        """Return the objective of the convex programmes that smooth a path."""
        return LeastJerk()

    def scaled(self, ratio: float) -> Self:
        """Return the objective for a scene with lengths multiplied by a ratio."""
        return self


@dataclass(frozen=True)
class LeastJerk(Criterion):
    """The objective of least squared jerk of all end effectors.

    With a demonstration, deviation and its jerk count. In unit duration, with L the root of the summed squared
    distances from start to goal and d_i the demonstration transferred to end effector i, it is ::

        1/(720 L^2) integral sum_i |y_i''' - d_i'''|^2 ds + pull/L^2 integral sum_i |y_i - d_i|^2 ds,

    which is 1 for straight motions of least jerk (Flash and Hogan, 1985) without a demonstration.

    Attributes
    ----------
    resemblance : resemblance to the demonstration, from 0 (not used) to 1 (as near as obstacles allow); 0.7 for a
        demonstration, unless given
    room : soft clearance beyond the scene's, kept where it costs little [m]. While a path is optimised, each
        obstacle that is touched adds 15 % to the value, and less the more of this clearance is kept; of several
        paths, the one whose motion has the least value above is taken. Unless given it is a centimetre, and in
        workspaces below 0.3 m or above 5 m a hundredth of the longest side
    """

    least: ClassVar[float] = 1.0
    resemblance: float | None = None
    room: float | None = None

    def __post_init__(self) -> None:
        value = self.resemblance
        number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
        if value is not None and not (number and 0 <= value <= 1):
            raise OptionError(
                f"the resemblance {value!r} is not between 0 and 1",
                key="resemblance",
                way_out="give 0 for a motion that needs no demonstration, 1 for one as near to it as possible",
            )
        number = isinstance(self.room, (int, float, np.number)) and not isinstance(self.room, bool)
        if self.room is not None and not (number and 0 <= self.room < np.inf):
            raise OptionError(
                f"the wish for room {self.room!r}", key="room", way_out="give a number of metres, 0 for none"
            )

    @property
    def wish(self) -> float:
        """Return the soft clearance [m]. The default suits scenes of decimetres to metres."""
        return 0.01 if self.room is None else float(self.room)

    def value(
        self, motion: CoordinatedMotion, evaluated: Evaluated, returned: Callable[[], CoordinatedMotion]
    ) -> float:
        """Return the value for a motion, as `Criterion.value`."""
        return jerk_cost(motion, self, evaluated.demonstration, evaluated.precision)

    @property
    def smoothness(self) -> LeastJerk:
        """Return the objective itself."""
        return self

    def scaled(self, ratio: float) -> Self:
        """Return the objective for scaled lengths. A default soft clearance stays as it is."""
        return replace(self, room=self.wish if self.room is None else ratio * self.room)

    def check_untaught(self) -> None:
        """Reject a resemblance without a demonstration, as `Criterion.check_untaught`."""
        if self.resemblance:
            raise OptionError(
                f"a resemblance of {self.resemblance:g} without a demonstration",
                key="objective",
                way_out="give a demonstration, or LeastJerk() without a resemblance",
            )

    def pull(self, taught: bool) -> float:
        """Return the weight of the deviation from a demonstration. It is 0 without one, or if it is not used.

        It grows from 10^2, for a resemblance just above 0, to 10^7.7, for one of 1.
        """
        strength = 0.7 if self.resemblance is None else float(self.resemblance)
        return 10.0 ** (2.0 + 5.7 * strength) if taught and strength > 0 else 0.0


@dataclass(frozen=True)
class LeastTime(Criterion):
    """The objective of the shortest duration within the limits, at every instant.

    The scene's own duration is ignored; `planning.pace.LIMITS` replaces limits that it leaves out.
    """

    is_time: ClassVar[bool] = True

    def value(
        self, motion: CoordinatedMotion, evaluated: Evaluated, returned: Callable[[], CoordinatedMotion]
    ) -> float:
        """Return the duration of the motion as it is returned [s]."""
        return returned().scene.duration


@dataclass(frozen=True)
class PaperCost(Criterion):
    """The weights of equation (4) and of the resemblance to a demonstration.

    Attributes
    ----------
    goal, velocity, obstacle : c_goal, c_vel, c_obst
    resemblance : c_res, weight of the distance from the demonstration; 0 if this is only the start of the search
    """

    is_smooth: ClassVar[bool] = False
    goal: float = WEIGHTS["goal"]
    velocity: float = WEIGHTS["velocity"]
    obstacle: float = WEIGHTS["obstacle"]
    resemblance: float = WEIGHTS["resemblance"]

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0 <= value < np.inf:
                raise OptionError(f"the cost weight {name} = {value!r}", way_out="give a number, 0 or more")

    def value(
        self, motion: CoordinatedMotion, evaluated: Evaluated, returned: Callable[[], CoordinatedMotion]
    ) -> float:
        """Return J of the motion, by the weights of `evaluated`."""
        return evaluated.cost(motion).total

    def pull(self, taught: bool) -> float:
        """Return the weight of the distance from the demonstration; 0 without one."""
        return self.resemblance if taught else 0.0

    @property
    def begins_taught(self) -> bool:
        """Return True: a demonstration is the start for any weight."""
        return True

    @property
    def weights(self) -> PaperCost:
        """Return the objective itself."""
        return self
