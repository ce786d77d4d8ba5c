"""Online execution among obstacles that move."""

from comove.execution.executor import Event, Executor, Log, Pace, Plan
from comove.execution.files import write_run
from comove.execution.sight import Functions, Known, Sight

__all__ = ["Event", "Executor", "Functions", "Known", "Log", "Pace", "Plan", "Sight", "write_run"]
