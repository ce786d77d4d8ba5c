"""How the hands hold the load in a simulation: rigidly, by a joint, or by fingers and friction (`friction`).

Every hand has a site, its grasp frame, and the load a site for each hand. Where they are is known only when the hands
stand at the load, so a grasp is closed at run time: the load's sites are moved to where the hands are, and what
connects the two is switched on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

from comove.robots.model import Arm
from comove.simulators.engine import engine
from comove.simulators.things import STIFF
from comove.simulators.world import World

HARD = (0.99, 0.999, 0.001, 0.5, 2.0)  # impedance of a grasp's constraint: 1 % soft at most


class GraspModel(Protocol):
    """What every grasp offers.

    Attributes
    ----------
    touching : whether hands and load meet in contacts; otherwise they pass through each other
    """

    touching: ClassVar[bool]

    def section(self, radius: float) -> tuple[float, float] | None:
        """Width and height of a bar of some radius that it holds [m], None where the bar is round."""

    def moving(self, arms: Sequence[Arm]) -> tuple[str, ...]:
        """Names of joints that it moves besides the arms'."""

    def furnish(self, spec: Any, arms: Sequence[Arm], friction: float) -> None:
        """Put into the world what it needs; `friction` is a factor on what it believes."""

    def close(self, world: World, data: Any) -> None:
        """Take hold of the load, the hands standing at it."""


class _Fixed:
    """What welds and links have in common."""

    touching: ClassVar[bool] = False
    kind: ClassVar[str]

    def section(self, radius: float) -> tuple[float, float] | None:
        """Bars are round."""
        return None

    def moving(self, arms: Sequence[Arm]) -> tuple[str, ...]:
        """Nothing."""
        return ()

    def furnish(self, spec: Any, arms: Sequence[Arm], friction: float) -> None:
        """A constraint between each hand's site and the load's site for it, open for now."""
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
        """Hold where the hands are."""
        for name in world.holder_names:
            data.eq_active[world.model.equality(f"grasp {name}").id] = 1


@dataclass(frozen=True)
class Weld(_Fixed):
    """Hand and load are one body: position and orientation are held."""

    kind: ClassVar[str] = "mjEQ_WELD"


@dataclass(frozen=True)
class Connect(_Fixed):
    """Hand and load share a point, about which they may turn."""

    kind: ClassVar[str] = "mjEQ_CONNECT"
