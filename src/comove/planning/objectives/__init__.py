"""What a motion shall be best in."""

from comove.planning.objectives.least_jerk import LeastJerk
from comove.planning.objectives.least_time import LeastTime
from comove.planning.objectives.paper import PaperCost

__all__ = ["LeastJerk", "LeastTime", "PaperCost"]
