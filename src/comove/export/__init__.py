"""Export: verified joint motions as files and messages that robots play."""

from comove.export.formats import FORMATS, Format, check_export, export
from comove.export.parts import ExportError, Part, Provenance, parts_of
from comove.export.ros1 import Ros1Client
from comove.export.send import Outcome, SendError, Tolerances, TrajectoryClient, send

__all__ = [
    "FORMATS",
    "ExportError",
    "Format",
    "Outcome",
    "Part",
    "Provenance",
    "Ros1Client",
    "SendError",
    "Tolerances",
    "TrajectoryClient",
    "check_export",
    "export",
    "parts_of",
    "send",
]
