"""The interface of methods to `solve`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar

from comove.errors import OptionError
from comove.model.coordinates import Coordinates
from comove.model.scene import Scene
from comove.planning.search import Search


class Method(ABC):
    """A method that solves scenes.

    Attributes
    ----------
    name : name on the command line and in results
    coordinates : function of a scene that returns the coordinates of the method's motions
    """

    name: ClassVar[str]
    coordinates: Callable[[Scene], Coordinates]

    def scene_of(self, scene: Scene) -> Scene:
        """Return the scene to solve: the given one, or the method's part of it."""
        return scene

    def check(self, scene: Scene) -> None:
        """Reject a scene that the method cannot solve, before anything is compiled."""
        self.coordinates(scene)

    @abstractmethod
    def run(self, search: Search, *, planner: bool) -> None:
        """Search for motions that `search` verifies. It ends without further improvement, or when time is up.

        Parameters
        ----------
        planner : whether a path may be planned first

        Raises
        ------
        OutOfTime
            If the budget is spent.
        """


def require_distances(scene: Scene) -> None:
    """Reject a scene without a distance constraint."""
    if not scene.distances:
        raise OptionError(
            "no distance ties the hands", key="method", way_out="use the method 'comove' for free hands"
        )
