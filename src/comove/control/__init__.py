"""Online execution among moving obstacles."""

from comove.control.clouds import Clouds, Scanned
from comove.control.executor import Executor
from comove.control.files import write_run
from comove.control.loop import Event, ExecutionLog
from comove.control.measured import Measured, Observed, Sensor
from comove.control.observers import Functions, Known, Observer
from comove.control.replanning import Pace, Plan
from comove.control.tracks import Association, Scanner
from comove.results.runs import StoredRun, read_run

__all__ = [
    "Association",
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
