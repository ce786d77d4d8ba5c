"""Phase, basis and dynamic movement primitives."""

from typing import TYPE_CHECKING

from comove._doors import lazily

if TYPE_CHECKING:
    from comove.primitives.alignment import Alignment as Alignment
    from comove.primitives.averaging import AveragedDMP as AveragedDMP, average as average
    from comove.primitives.basis import MotionBasis as MotionBasis, motion_basis as motion_basis
    from comove.primitives.coactivation import coactivated as coactivated
    from comove.primitives.dmp import DMP as DMP, FitError as FitError
    from comove.primitives.estimation import EstimationSettings as EstimationSettings
    from comove.primitives.files import (
        Primitive as Primitive,
        Provenance as Provenance,
        learn as learn,
        learn_distribution as learn_distribution,
        read_primitive as read_primitive,
        write_primitive as write_primitive,
    )
    from comove.primitives.library import Library as Library, Match as Match
    from comove.primitives.limits import ViaPoint as ViaPoint, constrained as constrained, largest as largest
    from comove.primitives.online import DMPState as DMPState, rate_for_lag as rate_for_lag
    from comove.primitives.pacing import (
        PacedDMP as PacedDMP,
        PacingSettings as PacingSettings,
        slowed as slowed,
    )
    from comove.primitives.system import (
        ExponentialPhase as ExponentialPhase,
        LinearPhase as LinearPhase,
        Phase as Phase,
    )
    from comove.primitives.pose_distributions import PoseProMP as PoseProMP
    from comove.primitives.poses import (
        VERTICAL as VERTICAL,
        Pose as Pose,
        PoseDMP as PoseDMP,
        PoseState as PoseState,
    )
    from comove.primitives.probabilistic import ProMP as ProMP
    from comove.primitives.variants import Variant as Variant

__all__, __getattr__, __dir__ = lazily(
    __name__,
    {
        "primitives.alignment": ["Alignment"],
        "primitives.averaging": ["AveragedDMP", "average"],
        "primitives.basis": ["MotionBasis", "motion_basis"],
        "primitives.coactivation": ["coactivated"],
        "primitives.dmp": ["DMP", "FitError"],
        "primitives.estimation": ["EstimationSettings"],
        "primitives.files": [
            "Primitive",
            "Provenance",
            "learn",
            "learn_distribution",
            "read_primitive",
            "write_primitive",
        ],
        "primitives.library": ["Library", "Match"],
        "primitives.limits": ["ViaPoint", "constrained", "largest"],
        "primitives.online": ["DMPState", "rate_for_lag"],
        "primitives.pacing": ["PacedDMP", "PacingSettings", "slowed"],
        "primitives.system": ["ExponentialPhase", "LinearPhase", "Phase"],
        "primitives.pose_distributions": ["PoseProMP"],
        "primitives.poses": ["VERTICAL", "Pose", "PoseDMP", "PoseState"],
        "primitives.probabilistic": ["ProMP"],
        "primitives.variants": ["Variant"],
    },
)
