"""Pictures of the tube that a distribution of movements fills."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

Array = NDArray[np.float64]

DEVIATIONS = 2.0  # standard deviations on either side of the mean
TUBE = "#7a3e9d"


def draw_tube(axes: Axes, mean: Array, covariance: Array, *, label: str = "") -> None:
    """Draw the mean of movements in the plane, and two standard deviations on either side of it.

    Parameters
    ----------
    mean : array, shape (n_steps, 2) [m]
    covariance : array, shape (n_steps, 2, 2) [m^2]
    label : what the legend says of the tube
    """
    heading = np.gradient(mean, axis=0)
    length = np.linalg.norm(heading, axis=1, keepdims=True)
    normal = np.stack([-heading[:, 1], heading[:, 0]], axis=1) / np.where(length > 0, length, 1.0)
    variance = np.einsum("tc,tcd,td->t", normal, covariance, normal)
    aside = DEVIATIONS * np.sqrt(np.maximum(variance, 0.0))[:, None] * normal
    border = np.concatenate([mean + aside, (mean - aside)[::-1]])
    axes.fill(*border.T, color=TUBE, alpha=0.2, linewidth=0.0, zorder=0.5, label=label or None)
    axes.plot(*mean.T, "--", color=TUBE, linewidth=1.2)
