"""Phase, basis and dynamic movement primitives."""

from comove.primitives.basis import MotionBasis, motion_basis
from comove.primitives.dmp import DMP, DMPState
from comove.primitives.phase import ExponentialPhase, LinearPhase, Phase

__all__ = ["DMP", "DMPState", "ExponentialPhase", "LinearPhase", "MotionBasis", "Phase", "motion_basis"]
