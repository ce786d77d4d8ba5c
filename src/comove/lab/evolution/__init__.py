"""Methods that search the shape weights of a scene by CMA-ES, behind the interface of `solve`."""

from comove.lab.evolution.paper import Paper
from comove.lab.evolution.printed import Printed
from comove.lab.evolution.projection import Projection

__all__ = ["Paper", "Printed", "Projection"]
