"""The number of processor cores that this process may use, and whether others may help it."""

from __future__ import annotations

import os

ALONE = "COMOVE_COMPILE_ALONE"  # environment variable: if set, no other process helps to compile kernels


def n_processors() -> int:
    """Return the number of cores that this process may use; those of the machine where the system does not tell."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
