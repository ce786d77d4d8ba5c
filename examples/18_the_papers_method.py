"""
The paper's method beside comove's
==================================

The paper keeps the bar's length within a band, by constrained CMA-ES over free hands; comove's coordinates hold it to
rounding, and its convex programme finds a smoother way, sooner.
"""

import comove
from comove.lab.evolution import Paper
from comove.lab.examples import example
from comove.view.figures import draw_side_by_side, save

scene = example("narrow")
demonstration = comove.Demonstration.from_lasa("Sine")
paper = comove.solve(scene, method=Paper(), demonstration=demonstration, seed=0)
ours = comove.solve(scene, seed=0)
for name, solution in (("paper's method", paper), ("comove", ours)):
    report = solution.report
    print(
        f"{name}: verified {solution.verified}, length off by {report.distance_error_max:.1e} m at most, "
        f"{report.acceleration_max:.2f} m/s^2"
    )
save(draw_side_by_side([paper.attempt, ours.attempt], ["paper's method", "comove"]), "paper.png")
