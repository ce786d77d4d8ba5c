"""
Step by step, with a pause and a new goal
=========================================

A primitive runs online. It waits for a while, and then its goal moves. Neither makes it jump.
"""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

import comove
from comove.view.figures import save

dmp = comove.DMP.fit(comove.Demonstration.from_lasa("Angle"), n_basis=20)
state, positions, dt = dmp.initial_state(), [], dmp.duration / 400
for step in range(600):
    rate = np.interp(step, [60, 100, 200, 240], [1.0, 0.0, 0.0, 1.0])  # slows down, waits, goes on
    if step == 270:
        state = replace(state, goal=[10.0, -5.0])
    state = dmp.step(state, dt, rate=rate)
    positions.append(state.position)
positions = np.array(positions)
speed = np.linalg.norm(np.diff(positions, axis=0), axis=1) / dt
print(
    "ends at",
    positions[-1].round(6),
    f"- largest jump of the speed in a step: {abs(np.diff(speed)).max():.2f} of {speed.max():.0f}",
)

figure = Figure(figsize=(8, 3.2))
left, right = figure.subplots(1, 2)
left.plot(*positions.T)
left.plot(*dmp.rollout().position.T, "--", color="0.6")
left.set(aspect="equal", title="the way; dashed: undisturbed")
right.plot(dt * np.arange(len(speed)), speed)
right.set(xlabel="time [s]", title="speed")
save(figure, "online.png")
