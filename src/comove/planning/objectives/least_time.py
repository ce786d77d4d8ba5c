"""The objective of haste: the shortest duration that the limits allow."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LeastTime:
    """Shortest duration within the limits of speed, acceleration and jerk at every instant.

    The scene's own duration does not count; limits that it leaves out are filled in (`planning.pace.LIMITS`).
    """
