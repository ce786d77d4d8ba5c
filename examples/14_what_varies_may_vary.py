"""
What varies may vary
====================

Seven people's recordings of one letter: where they agree, the motion has to agree; where they vary, it is free.
"""

import numpy as np
from matplotlib.figure import Figure

import comove
from comove.dmp import ProMP
from comove.view.figures import save

recordings = [comove.Demonstration.from_lasa("Sine", demo) for demo in range(7)]
movement = ProMP.fit(recordings, n_basis=15)
time = np.linspace(0.0, movement.mean.duration, 101)
mean = movement.mean.at(time).position
samples = [movement.sample(np.random.default_rng(seed)).at(time).position for seed in range(20)]
spread = np.std(samples, axis=0).sum(axis=1)
print(f"it varies by {spread.max():.1f} at most, by {spread[-1]:.1f} at its end")

figure = Figure(figsize=(7, 4))
axes = figure.add_subplot()
for sample in samples:
    axes.plot(*sample.T, color="0.8", linewidth=1)
for recording in recordings:
    axes.plot(*recording.position.T, color="tab:blue", linewidth=0.8)
axes.plot(*mean.T, color="tab:red", linewidth=2)
axes.set(aspect="equal", title="recordings (blue), what may be drawn from them (grey), mean (red)")
save(figure, "distribution.png")
