"""Export of verified joint motions to files and messages of robots."""

from comove.errors import ExportError, SendError
from comove.ros.clients import Names, Ros1Client, Ros2Client, RosClient, connect
from comove.ros.bags import moveit_messages
from comove.ros.formats import FORMATS, ExportFormat, check_export, export, usual_format
from comove.ros.parts import IN_STEP, JointSamples, MotionPart, MotionProvenance, parts_of
from comove.ros.send import SendOutcome, Tolerances, TrajectoryClient, send

__all__ = [
    "FORMATS",
    "ExportError",
    "ExportFormat",
    "JointSamples",
    "MotionPart",
    "IN_STEP",
    "MotionProvenance",
    "Names",
    "Ros1Client",
    "Ros2Client",
    "RosClient",
    "SendError",
    "SendOutcome",
    "Tolerances",
    "TrajectoryClient",
    "check_export",
    "connect",
    "export",
    "moveit_messages",
    "parts_of",
    "send",
    "usual_format",
]
