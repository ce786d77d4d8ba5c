"""Methods and combinations of movements by CMA-ES on weights."""

from comove.lab.evolution.combination import Combination, combine
from comove.lab.evolution.paper import Paper, Projection
from comove.lab.evolution.printed import Printed

__all__ = ["Combination", "Paper", "Printed", "Projection", "combine"]
