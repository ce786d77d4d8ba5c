"""Black-box optimisers, independent of robots."""

from comove.optim.augmented_lagrangian import AugmentedLagrangian
from comove.optim.ccmaes import (
    CCMAES,
    FactorForm,
    MatrixForm,
    NoForm,
    PrintedCCMAES,
    PrintedForm,
    Reduction,
    StaleForm,
)
from comove.optim.cmaes import (
    CMAES,
    DiagonalCovariance,
    FullCovariance,
    Parameters,
    TransformationMatrix,
)
from comove.optim.epsilon_level import EpsilonLevel
from comove.optim.method import Reason
from comove.optim.minimiser import Minimiser, Result, minimise
from comove.optim.restarts import BIPOP, IPOP, NoRestarts
from comove.optim.simple import Affine, Penalty, Plain, ProjectionRepair

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
