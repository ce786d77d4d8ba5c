"""Online execution among moving obstacles."""

from comove.execution.clouds import Clouds, Scanned
from comove.execution.executor import Event, ExecutionLog, Executor, Pace, Plan
from comove.execution.files import write_run
from comove.execution.measured import Measured, Observed, Sensor
from comove.execution.observers import Functions, Known, Observer
from comove.execution.tracks import Scanner
from comove.results.runs import StoredRun, read_run

__all__ = [
    "Clouds",
    "Event",
    "Executor",
    "Functions",
    "Known",
    "ExecutionLog",
    "Measured",
    "Observed",
    "Pace",
    "Plan",
    "Scanned",
    "Scanner",
    "Sensor",
    "StoredRun",
    "Observer",
    "read_run",
    "write_run",
]
