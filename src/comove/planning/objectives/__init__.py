"""The objectives of `solve`: least jerk, least time, the paper's cost, and the user's own functions."""

from __future__ import annotations

from comove.planning.objectives.criteria import Criterion, LeastJerk, LeastTime, PaperCost
from comove.planning.objectives.own import Equality, OwnFunctions, Samples
from comove.model.files.keys import Objective

__all__ = [
    "OBJECTIVES",
    "Criterion",
    "Equality",
    "LeastJerk",
    "LeastTime",
    "OwnFunctions",
    "PaperCost",
    "Samples",
    "objective_of_scene",
]

OBJECTIVES = {"least_jerk": LeastJerk, "least_time": LeastTime, "paper": PaperCost}
"""By what scene files and results call them."""


def objective_of_scene(part: Objective | None) -> Criterion | None:
    """Return the objective of a scene file, None if it names none."""
    return None if part is None else OBJECTIVES[part.type](**part.model_dump(exclude={"type"}))
