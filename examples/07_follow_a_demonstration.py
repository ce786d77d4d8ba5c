"""
Follow a demonstration
======================

A person's handwriting is adapted to both end effectors. One number between 0 and 1 sets their closeness to it; walls
and the bar's length are respected for any value.
"""

import comove
from comove.lab.examples import example
from comove.view.figures import draw_side_by_side, save

scene = example("narrow")
demonstration = comove.Demonstration.from_lasa("Sine")
found = {
    resemblance: comove.solve(
        scene, demonstration=demonstration, objective=comove.LeastJerk(resemblance=resemblance), seed=0
    )
    for resemblance in (0.0, 0.7, 0.95)
}
for resemblance, solution in found.items():
    away = (
        "" if solution.followed is None else f", {100 * solution.followed.distance:.1f} cm away in the mean"
    )
    print(f"resemblance {resemblance}: verified {solution.verified}{away}")
save(
    draw_side_by_side([solution.attempt for solution in found.values()], [f"resemblance {r}" for r in found]),
    "resemblance.png",
)
