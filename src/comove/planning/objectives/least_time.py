"""The objective of least time: the shortest duration that the limits allow."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LeastTime:
    """The objective of the shortest duration within the limits of speed, acceleration and jerk at every instant.

    The scene's own duration is ignored; limits that the scene leaves out are set by `planning.pace.LIMITS`.
    """
