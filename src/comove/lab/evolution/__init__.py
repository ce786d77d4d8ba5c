"""Methods that search the shape weights of a scene by CMA-ES, and combinations of movements by it."""

from comove.lab.evolution.combination import Combination, combine
from comove.lab.evolution.paper import Paper, Projection
from comove.lab.evolution.printed import Printed

__all__ = ["Combination", "Paper", "Printed", "Projection", "combine"]
