"""
A load of any shape
===================

Two hands carry an L-shaped profile through a gate with a round top; both are triangle meshes.
"""

import sys
from pathlib import Path

import comove
from comove.view.figures import draw_motion, save

scene = comove.Scene.load(Path(sys.argv[0]).parent / "meshes" / "gate.yaml")
print(
    f"the profile is held by {len(scene.body.solids)} polytopes, without overhang:",
    scene.excess["load"] == 0,
)
print(f"the gate by {sum(scene.owners == 0)}, which reach {1e3 * scene.excess[0]:.1f} mm beyond it at most")
solution = comove.solve(scene, seed=0)
print("verified:", solution.verified)
print(f"clearance at every instant: {1e3 * solution.motion.clearance_min:.1f} mm or more")
save(draw_motion(solution.attempt), "gate.png")
