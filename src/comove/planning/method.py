"""The interface of methods, as `solve` uses it."""

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
        """Return the scene that is solved and verified: the given one, or the part for which the method is made."""
        return scene

    def check(self, scene: Scene) -> None:
        """Refuse a scene that the method is not made for, before anything is compiled."""
        self.coordinates(scene)

    @abstractmethod
    def run(self, search: Search, *, planner: bool) -> None:
        """Search for motions and have `search` verify them, until no improvement is expected or time is up.

        Parameters
        ----------
        planner : whether a path may be planned first

        Raises
        ------
        OutOfTime
            If the budget is spent.
        """


def require_distances(scene: Scene) -> None:
    """Refuse a scene whose hands no distance ties."""
    if not scene.distances:
        raise OptionError(
            "no distance ties the hands", key="method", way_out="use the method 'comove' for free hands"
        )
