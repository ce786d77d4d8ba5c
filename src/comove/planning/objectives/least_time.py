"""The objective of least time: the shortest duration that the limits allow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from comove.planning.objectives.criterion import Criterion

if TYPE_CHECKING:
    from comove.model.motion import CoordinatedMotion
    from comove.planning.objective import Objective


@dataclass(frozen=True)
class LeastTime(Criterion):
    """The objective of the shortest duration within the limits of speed, acceleration and jerk at every instant.

    The scene's own duration is ignored; limits that the scene leaves out are set by `planning.pace.LIMITS`.
    """

    is_time: ClassVar[bool] = True

    def value(
        self, motion: CoordinatedMotion, evaluated: Objective, returned: Callable[[], CoordinatedMotion]
    ) -> float:
        """Return the duration of the motion as it is returned [s]."""
        return returned().scene.duration
