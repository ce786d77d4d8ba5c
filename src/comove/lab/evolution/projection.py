"""Free hands whose every rollout is projected onto the constraints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from comove.model.coordinates import Coordinates, projected_coordinates
from comove.model.scene import Scene
from comove.planning.methods import Comove


@dataclass(frozen=True)
class Projection(Comove):
    """A variant of the default method with free hands, which projects every rollout onto the constraints."""

    name: ClassVar[str] = "projection"
    smooths: ClassVar[bool] = False
    coordinates: Callable[[Scene], Coordinates] = projected_coordinates
