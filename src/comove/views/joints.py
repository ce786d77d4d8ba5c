"""Pictures of a robot's motion: joints between their limits, and speeds and accelerations as shares of theirs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from comove.views.style import COLOURS, new_figure

if TYPE_CHECKING:  # robots are an extra
    from comove.robots.model import Robot
    from comove.robots.motion import JointMotion


def draw_joints(robot: Robot, joints: JointMotion, *, title: str = "") -> Figure:
    """Draw positions (between the limits), speeds and accelerations (as shares of theirs) of every arm's joints."""
    rows = (
        ("position in its range", 2 * (joints.position - robot.lower) / (robot.upper - robot.lower) - 1),
        ("share of speed", joints.velocity / robot.velocity),
        ("share of acceleration", joints.acceleration / robot.acceleration),
    )
    figure = new_figure(5.4 * len(robot.arms) + 1.2, 7.2)
    figure.suptitle(title or robot.name)
    axes = np.atleast_2d(figure.subplots(len(rows), len(robot.arms), sharex=True, sharey=True, squeeze=False))
    for column, arm in enumerate(robot.arms):
        for row, (name, values) in enumerate(rows):
            panel: Axes = axes[row, column]
            for i, joint in enumerate(arm.columns):
                panel.plot(
                    joints.time,
                    values[:, joint],
                    color=COLOURS[i % len(COLOURS)],
                    linewidth=1.3,
                    label=robot.joint_names[joint],
                )
            for limit in (-1.0, 1.0):
                panel.axhline(limit, color="#b03030", linewidth=1.0, linestyle="--")
            panel.set_ylim(-1.12, 1.12)
            panel.grid(alpha=0.25)
            if column == 0:
                panel.set_ylabel(name)
        axes[0, column].set_title(arm.name)
        axes[0, column].legend(fontsize=7, ncols=2, loc="upper right")
        axes[-1, column].set_xlabel("time [s]")
    return figure
