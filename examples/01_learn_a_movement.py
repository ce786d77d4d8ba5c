"""
Learn a movement
================

Fit a primitive to a person's recorded movement and play it to another goal.
"""

import numpy as np

import comove
from comove.view.figures import draw_primitive, save

demonstration = comove.Demonstration.from_lasa("Angle")
dmp = comove.DMP.fit(demonstration, n_basis=20)
error = dmp.at(demonstration.time).position - demonstration.position
print(
    f"fit error: {np.sqrt((error**2).sum(axis=1).mean()):.3f} of a shape {np.ptp(demonstration.position):.0f} wide"
)

elsewhere = dmp.rollout(goal=[10.0, -5.0], duration=2.0, n_steps=201)
print("ends at", elsewhere.position[-1], "at rest:", np.allclose(elsewhere.velocity[-1], 0.0))
save(draw_primitive(comove.learn(demonstration), demonstration), "learned.png")
