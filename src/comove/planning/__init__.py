"""`solve`, its methods and objectives, and the choice of library movements."""

from comove.planning.arguments import carried_demonstration, movements_of
from comove.planning.choice import Candidate, Choice, best_movement
from comove.planning.clock import Budget
from comove.planning.kernels import SceneKind, load_kernels
from comove.planning.methods import Comove
from comove.planning.objective import Cost
from comove.planning.objectives import Equality, LeastJerk, LeastTime, PaperCost, Samples
from comove.planning.solution import Progress, Solution
from comove.planning.solver import check_method, solve

__all__ = [
    "Budget",
    "Candidate",
    "Choice",
    "Comove",
    "Cost",
    "Equality",
    "LeastJerk",
    "LeastTime",
    "PaperCost",
    "Progress",
    "Samples",
    "SceneKind",
    "Solution",
    "best_movement",
    "carried_demonstration",
    "check_method",
    "load_kernels",
    "movements_of",
    "solve",
]
