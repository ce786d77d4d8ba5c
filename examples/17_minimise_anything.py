"""
Minimise anything under constraints
===================================

The optimisers know nothing of robots. Here Rosenbrock's valley is searched inside a disc, on whose border the least
value lies.
"""

import numpy as np
from matplotlib.figure import Figure

from comove.optim import minimise
from comove.view.figures import save

seen = []


def valley(x: np.ndarray) -> np.ndarray:
    """Return Rosenbrock's function of a population, array of shape (n, 2)."""
    seen.append(x.mean(axis=0))
    return 100.0 * (x[:, 1] - x[:, 0] ** 2) ** 2 + (1.0 - x[:, 0]) ** 2


result = minimise(
    valley,
    np.array([-0.5, 0.5]),
    0.3,
    constraints=lambda x: (x**2).sum(axis=1, keepdims=True) - 1.0,
    max_evaluations=4000,
)
print(
    "at",
    np.round(result.x, 4),
    f"value {result.fun:.5f}, on the border to {abs(np.linalg.norm(result.x) - 1):.0e}",
)

figure = Figure(figsize=(5, 4.6))
axes = figure.add_subplot()
x, y = np.meshgrid(np.linspace(-1.3, 1.3, 201), np.linspace(-1.3, 1.3, 201))
axes.contour(x, y, np.log(100.0 * (y - x**2) ** 2 + (1.0 - x) ** 2 + 1e-3), 20, cmap="Greys", linewidths=0.6)
axes.plot(np.cos(np.linspace(0, 2 * np.pi, 200)), np.sin(np.linspace(0, 2 * np.pi, 200)), color="tab:red")
axes.plot(*np.array(seen).T, ".-", markersize=3, linewidth=0.8)
axes.set(aspect="equal", title="means of the populations, inside the disc")
save(figure, "valley.png")
