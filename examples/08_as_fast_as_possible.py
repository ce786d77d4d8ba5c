"""
As fast as possible
===================

Without a duration, the shortest one is found that keeps speed, acceleration and jerk of every end effector within
limits, at every instant. The path changes too: a fast path in a gap is not the smoothest one.
"""

import comove
from comove.lab.examples import example
from comove.view.figures import draw_motion, save

scene = example("narrow").limited(speed=1.0, acceleration=2.0, jerk=10.0)  # m/s, m/s^2, m/s^3
solution = comove.solve(scene, objective=comove.LeastTime(), seed=0)
print("verified:", solution.verified, f"in {solution.scene.duration:.2f} s")
report = solution.report
print(f"fastest {report.speed_max:.2f} m/s, at most {report.acceleration_max:.2f} m/s^2")
save(draw_motion(solution.attempt), "fast.png")
