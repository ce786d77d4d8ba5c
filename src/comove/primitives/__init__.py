"""Phase, basis and dynamic movement primitives."""

from comove.primitives.alignment import Alignment
from comove.primitives.average import AveragedDMP, average
from comove.primitives.basis import MotionBasis, motion_basis
from comove.primitives.coactivation import coactivated
from comove.primitives.dmp import DMP, FitError
from comove.primitives.estimation import EstimationSettings
from comove.primitives.files import (
    Primitive,
    Provenance,
    learn,
    learn_distribution,
    read_primitive,
    write_primitive,
)
from comove.primitives.library import Library, Match
from comove.primitives.limits import ViaPoint, constrained, largest
from comove.primitives.online import DMPState, rate_for_lag
from comove.primitives.pacing import PacedDMP, PacingSettings, slowed
from comove.primitives.phase import ExponentialPhase, LinearPhase, Phase
from comove.primitives.pose_distributions import PoseProMP
from comove.primitives.poses import VERTICAL, Pose, PoseDMP, PoseState
from comove.primitives.probabilistic import ProMP
from comove.primitives.variants import Variant

__all__ = [
    "Alignment",
    "AveragedDMP",
    "DMP",
    "DMPState",
    "EstimationSettings",
    "ExponentialPhase",
    "FitError",
    "Library",
    "LinearPhase",
    "Match",
    "MotionBasis",
    "PacedDMP",
    "PacingSettings",
    "Phase",
    "Pose",
    "PoseDMP",
    "PoseProMP",
    "PoseState",
    "Primitive",
    "ProMP",
    "Provenance",
    "VERTICAL",
    "Variant",
    "ViaPoint",
    "average",
    "coactivated",
    "constrained",
    "largest",
    "learn",
    "learn_distribution",
    "motion_basis",
    "rate_for_lag",
    "read_primitive",
    "slowed",
    "write_primitive",
]
