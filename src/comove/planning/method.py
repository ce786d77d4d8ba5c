"""What `solve` asks of a method."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar

from comove.coordination.coordinates import Coordinates
from comove.planning.search import Search
from comove.scenes.scene import Scene


class Method(ABC):
    """A way to solve scenes.

    Attributes
    ----------
    name : as the command line and results call it
    coordinates : in which its motions are written, of a scene
    """

    name: ClassVar[str]
    coordinates: Callable[[Scene], Coordinates]

    def scene_of(self, scene: Scene) -> Scene:
        """The scene that is solved and judged: the given one, unless a method is made for a part of it."""
        return scene

    @abstractmethod
    def run(self, search: Search, *, planner: bool) -> None:
        """Search, and have the `search` judge what is found, until nothing is to be gained or time is up.

        Parameters
        ----------
        planner : a path may be planned first

        Raises
        ------
        OutOfTime
            When the budget is spent.
        OptionError
            If the method is not made for the scene; says what to use instead.
        """
