"""The number of processor cores that this process may use."""

from __future__ import annotations

import os


def n_processors() -> int:
    """Return the number of cores that this process may use; those of the machine where the system does not tell."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
