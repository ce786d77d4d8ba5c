"""Online execution among moving obstacles."""

from comove.execution.clouds import Clouds, Scanned
from comove.execution.comparison import Compared, compare, write_comparison
from comove.execution.executor import Event, ExecutionLog, Executor, Pace, Plan
from comove.execution.files import write_run
from comove.execution.measured import Measured, Observed, Sensor
from comove.execution.sight import Functions, Known, Sight
from comove.execution.tracks import Scanner

__all__ = [
    "Clouds",
    "Compared",
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
    "Sight",
    "compare",
    "write_comparison",
    "write_run",
]
