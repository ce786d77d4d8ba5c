"""
Your own objective and constraint
=================================

A function of the sampled motion is minimised, and another one must not exceed zero. The scene's own rules
hold as ever.
"""

import comove
from comove.lab.examples import example
from comove.planning import Samples
from comove.view.figures import draw_side_by_side, save


def height(motion: Samples) -> float:
    """Return the mean height of the end effectors [m]."""
    return motion.position[..., 1].mean()


def slow(motion: Samples) -> float:
    """Return an end effector's excess of 0.25 m/s along x."""
    return abs(motion.velocity[..., 0]).max() - 0.25


scene = example("narrow")
smooth = comove.solve(scene, seed=0)
low = comove.solve(scene, objective=height, constraints=[slow], budget=8.0, seed=0)
for name, solution in (("smooth", smooth), ("low", low)):
    samples = Samples.of(solution.attempt)
    print(
        f"{name}: verified {solution.verified}, mean height {height(samples):.3f} m, "
        f"at most {0.25 + slow(samples):.3f} m/s along x"
    )
save(draw_side_by_side([smooth.attempt, low.attempt], ["least jerk", "least height"]), "own.png")
