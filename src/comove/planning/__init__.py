"""Objective, planners, growing the load, and `solve`."""

from comove.planning.objective import Cost, CostWeights
from comove.planning.solution import Progress, Solution
from comove.planning.solver import Comove, Projection, solve

__all__ = ["Comove", "Cost", "CostWeights", "Progress", "Projection", "Solution", "solve"]
