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
from comove.optimisers.cmaes import (
    CMAES,
    DiagonalCovariance,
    FullCovariance,
    Parameters,
    TransformationMatrix,
)
from comove.optimisers.epsilon_level import EpsilonLevel
from comove.optimisers.method import Reason
from comove.optimisers.minimiser import Minimiser, Result, minimise
from comove.optimisers.printed import PrintedCCMAES
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
