"""Names of methods and the places of their classes; loads none."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any


@dataclass(frozen=True)
class MethodName:
    """The name of a method.

    Attributes
    ----------
    name : name on the command line, in studies and in results
    place : module and class
    serves_robots : whether it finds motions that the joints of a robot can follow
    """

    name: str
    place: str
    serves_robots: bool = False

    @property
    def is_compared(self) -> bool:
        """Return whether it is a method of others, for comparison."""
        return self.place.startswith("comove.lab.compared.")

    @property
    def kind(self) -> Any:
        """Return the class of the method."""
        module, _, kind = self.place.rpartition(".")
        return getattr(import_module(module), kind)


METHODS = {
    method.name: method
    for method in (
        MethodName("comove", "comove.planning.Comove", serves_robots=True),
        MethodName("projection", "comove.lab.evolution.Projection"),
        MethodName("paper", "comove.lab.evolution.Paper", serves_robots=True),
        MethodName("printed", "comove.lab.evolution.Printed"),
        MethodName("unconstrained", "comove.lab.compared.Unconstrained"),
        MethodName("leader-follower", "comove.lab.compared.LeaderFollower"),
        MethodName("speed-scaled", "comove.lab.compared.SpeedScaled"),
        MethodName("task-priority", "comove.lab.compared.TaskPriority", serves_robots=True),
        MethodName("single", "comove.lab.compared.Single"),
    )
}
"""All methods by name; others are derived from this table."""
OWN = tuple(name for name, method in METHODS.items() if not method.is_compared)
"""Names of comove's own methods and the paper's."""
OF_ROBOTS = tuple(name for name, method in METHODS.items() if method.serves_robots)
"""Names of methods whose motions the joints of a robot can follow."""
