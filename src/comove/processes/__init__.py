"""Pool of worker processes that reports which task a killed process had."""

from comove.processes.pool import (
    ALONE,
    ONE_THREAD,
    Ahead,
    PoolSettings,
    TaskResult,
    end_process,
    n_processors,
    run_tasks,
    start_process,
)
from comove.processes.threads import one_blas_thread

__all__ = [
    "ALONE",
    "ONE_THREAD",
    "Ahead",
    "PoolSettings",
    "TaskResult",
    "end_process",
    "n_processors",
    "one_blas_thread",
    "run_tasks",
    "start_process",
]
