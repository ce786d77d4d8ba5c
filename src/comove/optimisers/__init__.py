"""Black-box optimisers, independent of robots."""

from comove.optimisers.augmented_lagrangian import AugmentedLagrangian
from comove.optimisers.ccmaes import (
    CCMAES,
    FactorForm,
    MatrixForm,
    NoForm,
    PrintedForm,
    Reduction,
    StaleForm,
)
from comove.optimisers.cmaes import CMAES
from comove.optimisers.covariance import DiagonalCovariance, FullCovariance, TransformationMatrix
from comove.optimisers.epsilon_level import EpsilonLevel
from comove.optimisers.minimise import minimise
from comove.optimisers.minimiser import Minimiser, Result
from comove.optimisers.parameters import Parameters
from comove.optimisers.printed import PrintedCCMAES
from comove.optimisers.reasons import Reason
from comove.optimisers.restarts import BIPOP, IPOP, NoRestarts
from comove.optimisers.simple import Affine, Penalty, Plain, ProjectionRepair

__all__ = [
    "BIPOP",
    "CCMAES",
    "CMAES",
    "IPOP",
    "Affine",
    "AugmentedLagrangian",
    "DiagonalCovariance",
    "EpsilonLevel",
    "FactorForm",
    "FullCovariance",
    "MatrixForm",
    "Minimiser",
    "NoForm",
    "NoRestarts",
    "Parameters",
    "Penalty",
    "Plain",
    "PrintedCCMAES",
    "PrintedForm",
    "ProjectionRepair",
    "Reason",
    "Reduction",
    "Result",
    "StaleForm",
    "TransformationMatrix",
    "minimise",
]
