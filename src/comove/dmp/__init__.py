"""Phase, basis and dynamic movement primitives."""

from typing import TYPE_CHECKING

from comove._doors import lazily

if TYPE_CHECKING:
    from comove.dmp.alignment import Alignment as Alignment
    from comove.dmp.averaging import AveragedDMP as AveragedDMP, average as average
    from comove.dmp.basis import MotionBasis as MotionBasis, motion_basis as motion_basis
    from comove.dmp.dmp import DMP as DMP, FitError as FitError
    from comove.dmp.estimation import EstimationSettings as EstimationSettings
    from comove.dmp.files import (
        Primitive as Primitive,
        Provenance as Provenance,
        learn as learn,
        learn_distribution as learn_distribution,
        read_primitive as read_primitive,
        write_primitive as write_primitive,
    )
    from comove.dmp.library import Library as Library, Match as Match
    from comove.dmp.limits import ViaPoint as ViaPoint, constrained as constrained, largest as largest
    from comove.dmp.online import DMPState as DMPState, rate_for_lag as rate_for_lag
    from comove.dmp.operations import coactivated as coactivated
    from comove.dmp.pacing import (
        PacedDMP as PacedDMP,
        PacingSettings as PacingSettings,
        slowed as slowed,
    )
    from comove.dmp.system import (
        ExponentialPhase as ExponentialPhase,
        LinearPhase as LinearPhase,
        Phase as Phase,
    )
    from comove.dmp.pose_distributions import PoseProMP as PoseProMP
    from comove.dmp.poses import (
        VERTICAL as VERTICAL,
        Pose as Pose,
        PoseDMP as PoseDMP,
        PoseState as PoseState,
    )
    from comove.dmp.probabilistic import ProMP as ProMP
    from comove.dmp.variants import Variant as Variant

__all__, __getattr__, __dir__ = lazily(
    __name__,
    {
        "dmp.alignment": ["Alignment"],
        "dmp.averaging": ["AveragedDMP", "average"],
        "dmp.basis": ["MotionBasis", "motion_basis"],
        "dmp.dmp": ["DMP", "FitError"],
        "dmp.estimation": ["EstimationSettings"],
        "dmp.files": [
            "Primitive",
            "Provenance",
            "learn",
            "learn_distribution",
            "read_primitive",
            "write_primitive",
        ],
        "dmp.library": ["Library", "Match"],
        "dmp.limits": ["ViaPoint", "constrained", "largest"],
        "dmp.online": ["DMPState", "rate_for_lag"],
        "dmp.operations": ["coactivated"],
        "dmp.pacing": ["PacedDMP", "PacingSettings", "slowed"],
        "dmp.system": ["ExponentialPhase", "LinearPhase", "Phase"],
        "dmp.pose_distributions": ["PoseProMP"],
        "dmp.poses": ["VERTICAL", "Pose", "PoseDMP", "PoseState"],
        "dmp.probabilistic": ["ProMP"],
        "dmp.variants": ["Variant"],
    },
)
