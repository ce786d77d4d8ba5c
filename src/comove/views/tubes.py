"""Pictures of the tube that a distribution of movements fills."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from numpy.typing import NDArray

Array = NDArray[np.float64]

DEVIATIONS = 2.0  # standard deviations within which movements are drawn
N_CORNERS = 40  # of the ellipse at an instant
TUBE = "#7a3e9d"


def draw_tube(axes: Axes, mean: Array, covariance: Array, *, label: str = "") -> None:
    """Draw the mean of movements in the plane, and the ellipses of two standard deviations at every instant.

    Parameters
    ----------
    mean : array, shape (n_steps, 2) [m]
    covariance : array, shape (n_steps, 2, 2) [m^2]
    label : what the legend says of it
    """
    angle = np.linspace(0.0, 2 * np.pi, N_CORNERS)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    values, vectors = np.linalg.eigh(covariance)
    factor = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    ellipses = mean[:, None] + DEVIATIONS * np.swapaxes(factor @ circle, 1, 2)
    axes.add_collection(
        PolyCollection(list(ellipses), facecolors=TUBE, alpha=0.03, edgecolors="none", zorder=0)
    )
    axes.plot(*mean.T, "--", color=TUBE, linewidth=1.2, label=label or None)
