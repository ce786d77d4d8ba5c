"""Models of how the hands hold the load in a simulation: rigidly, by a joint, or by fingers and friction
(`friction`).

Every hand has a site, its grasp frame, and the load has a site for each hand. Their relative poses are known only
when the hands stand at the load, so a grasp is closed at run time: the load's sites are moved to the hands, and the
constraints between both are activated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

from comove.robots.model import Arm
from comove.simulators.bodies import STIFF
from comove.simulators.engine import engine
from comove.simulators.world import World

HARD = (0.99, 0.999, 0.001, 0.5, 2.0)  # impedance of a grasp's constraint: 1 % soft at most


class GraspModel(Protocol):
    """A model of how hands hold a load in a simulation.

    Attributes
    ----------
    touching : whether hands and load are in contact; otherwise they pass through each other
    """

    touching: ClassVar[bool]

    def section(self, radius: float) -> tuple[float, float] | None:
        """Return width and height of the box that stands for a bar of some radius [m], None where the bar is
        round.
        """

    def moving(self, arms: Sequence[Arm]) -> tuple[str, ...]:
        """Return the names of the joints that the grasp moves besides the arms'."""

    def furnish(self, spec: Any, arms: Sequence[Arm], friction: float) -> None:
        """Add what the grasp needs to the world; `friction` is a factor on its coefficient of friction."""

    def close(self, world: World, data: Any) -> None:
        """Take hold of the load while the hands stand at it."""


class _Fixed:
    """A grasp by a constraint between hand and load, the base of welds and links."""

    touching: ClassVar[bool] = False
    kind: ClassVar[str]

    def section(self, radius: float) -> tuple[float, float] | None:
        """Return None: bars are round."""
        return None

    def moving(self, arms: Sequence[Arm]) -> tuple[str, ...]:
        """Return no joints."""
        return ()

    def furnish(self, spec: Any, arms: Sequence[Arm], friction: float) -> None:
        """Add a constraint, inactive at first, between each hand's site and the load's site for it."""
        mj = engine()
        for arm in arms:
            grasp = spec.add_equality(
                type=getattr(mj.mjtEq, self.kind),
                objtype=mj.mjtObj.mjOBJ_SITE,
                active=False,
                solref=STIFF,
                solimp=HARD,
            )
            grasp.name, grasp.name1, grasp.name2 = f"grasp {arm.name}", f"hand {arm.name}", f"held {arm.name}"

    def close(self, world: World, data: Any) -> None:
        """Activate the constraints, at the present poses of the hands."""
        for name in world.holder_names:
            data.eq_active[world.model.equality(f"grasp {name}").id] = 1


@dataclass(frozen=True)
class Weld(_Fixed):
    """A grasp that fixes position and orientation of the load to the hand, as one body."""

    kind: ClassVar[str] = "mjEQ_WELD"


@dataclass(frozen=True)
class Connect(_Fixed):
    """A grasp that fixes one common point of hand and load, about which they may turn."""

    kind: ClassVar[str] = "mjEQ_CONNECT"
