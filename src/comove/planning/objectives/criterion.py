"""The protocol of objectives, by which a search meets all of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, ClassVar, Self

if TYPE_CHECKING:
    from comove.model.motion import CoordinatedMotion
    from comove.planning.objective import Objective
    from comove.planning.objectives.least_jerk import LeastJerk
    from comove.planning.objectives.paper import PaperCost


class Criterion:
    """The base class of objectives: which of two motions is better.

    Attributes
    ----------
    is_smooth : whether smooth motions alone minimise it, which a path must be planned for
    is_time : whether it is the duration, so that the scene's own does not count
    least : lower bound of its value for motions that follow no demonstration
    """

    is_smooth: ClassVar[bool] = True
    is_time: ClassVar[bool] = False
    least: ClassVar[float] = 0.0

    def value(
        self, motion: CoordinatedMotion, evaluated: Objective, returned: Callable[[], CoordinatedMotion]
    ) -> float:
        """Return the value for a motion, where less is better.

        Parameters
        ----------
        evaluated : equation (4) on the scene that is searched, with the demonstration
        returned : function that returns the motion as the caller gets it
        """
        raise NotImplementedError

    def check_untaught(self) -> None:
        """Refuse an objective that needs a demonstration, where there is none.

        Raises
        ------
        OptionError
            If it does.
        """

    def pull(self, taught: bool) -> float:
        """Return the weight of the deviation from a demonstration; 0 if there is none or it is not used."""
        return 0.0

    @property
    def begins_taught(self) -> bool:
        """Return whether a search begins at the demonstration, or its result resembles it."""
        return self.pull(True) > 0

    @property
    def weights(self) -> PaperCost:
        """Return the weights of equation (4) where that is evaluated beside the objective."""
        from comove.planning.objectives.paper import PaperCost

        return PaperCost()

    @property
    def smoothness(self) -> LeastJerk:
        """Return the objective of the convex programmes that make a planned path smooth."""
        from comove.planning.objectives.least_jerk import LeastJerk

        return LeastJerk()

    def scaled(self, ratio: float) -> Self:
        """Return the objective for a scene whose lengths are multiplied by a ratio."""
        return self
