"""Processes that work on tasks: a pool that knows at which task a process was when it was killed."""

from comove.processes.pool import ONE_THREAD, TaskResult, run_tasks

__all__ = ["ONE_THREAD", "TaskResult", "run_tasks"]
