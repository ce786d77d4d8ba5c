"""
Among things that move
======================

The motions of a disc and of a box are known. The plan is one in space and time, and the certificate covers moving
obstacles at every instant. Darker is later.
"""

import sys
from pathlib import Path

import comove
from comove.view.figures import draw_motion, save

scene = comove.Scene.load(Path(sys.argv[0]).parent / "moving" / "crossing.yaml")
solution = comove.solve(scene, seed=0)
print(
    "verified:", solution.verified, f"- {1e3 * solution.report.clearance_min:.1f} mm from everything, always"
)
save(draw_motion(solution.attempt), "crossing.png")
