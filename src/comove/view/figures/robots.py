"""Figures of robots: home configuration with reach, and joint motions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from comove.arrays import Array
from comove.view.figures.pictures import Joints, arm_lines
from comove.view.figures.style import COLOURS, new_figure

if TYPE_CHECKING:  # robots are an extra
    from comove.robots.model import Robot
    from comove.robots.proposal import Examination

VIEWS = (("from above", 0, 1), ("from the front", 1, 2), ("from the side", 0, 2))
AXES = (("#c0392b", "x"), ("#27ae60", "y: fingers open"), ("#2c5fb3", "z: approach"))
OF_ARMS = ("#8e44ad", "#d68910", "#16a085", "#7f8c8d")  # none of them the colour of an axis


def draw_joints(joints: Joints, *, title: str = "") -> Figure:
    """Draw joint positions, speeds and accelerations relative to their limits."""
    rows = (
        ("position in its range", 2 * (joints.position - joints.lower) / (joints.upper - joints.lower) - 1),
        ("share of speed", joints.velocity / joints.velocity_limit),
        ("share of acceleration", joints.acceleration / joints.acceleration_limit),
    )
    figure = new_figure(5.4 * len(joints.arms) + 1.2, 7.2)
    figure.suptitle(title or joints.name)
    axes = np.atleast_2d(
        figure.subplots(len(rows), len(joints.arms), sharex=True, sharey=True, squeeze=False)
    )
    for column, (name_of_arm, columns) in enumerate(joints.arms):
        for row, (name, values) in enumerate(rows):
            panel: Axes = axes[row, column]
            for i, joint in enumerate(columns):
                panel.plot(
                    joints.time,
                    values[:, joint],
                    color=COLOURS[i % len(COLOURS)],
                    linewidth=1.3,
                    label=joints.joint_names[joint],
                )
            for limit in (-1.0, 1.0):
                panel.axhline(limit, color="#b03030", linewidth=1.0, linestyle="--")
            panel.set_ylim(-1.12, 1.12)
            panel.grid(alpha=0.25)
            if column == 0:
                panel.set_ylabel(name)
        axes[0, column].legend(
            title=name_of_arm,
            fontsize=7,
            ncols=4,
            loc="lower center",
            bbox_to_anchor=(0.5, 1.0),
            frameon=False,
        )
        axes[-1, column].set_xlabel("time [s]")
    return figure


def draw_robot(robot: Robot, found: Examination, *, most_places: int = 600, axis: float = 0.1) -> Figure:
    """Draw a robot at home in three views. The views show links, grasp frames, and reached positions.

    Parameters
    ----------
    most_places : largest number of drawn positions for each end effector
    axis : length of the axes of a grasp frame [m]
    """
    figure = new_figure(15.0, 5.6)
    figure.suptitle(f"{robot.name} at home")
    panels = figure.subplots(1, len(VIEWS))
    lines, bodies = [line[0] for line in arm_lines(robot, robot.home[None])], _bodies(robot)
    for panel, (title, i, j) in zip(panels, VIEWS, strict=True):
        for k, of_arm in enumerate(found.arms):
            colour = OF_ARMS[k % len(OF_ARMS)]
            places = of_arm.places[:most_places]
            panel.scatter(places[:, i], places[:, j], s=5, color=colour, alpha=0.4, linewidths=0)
            panel.plot([], [], "o", color=colour, label=f"{of_arm.name}: reach {of_arm.reach:.2f} m")
        for center, radius in bodies:
            place = float(center[i]), float(center[j])
            panel.add_patch(
                Circle(place, radius, facecolor="#909090", edgecolor="none", alpha=0.16, zorder=2)
            )
        for line in lines:
            panel.plot(line[:, i], line[:, j], color="#303030", linewidth=2.2, zorder=3)
        for arm in robot.arms:
            pose = robot.tool_pose(robot.home, arm)
            for column, (colour, _) in enumerate(AXES):
                ends = np.stack([pose[:3, 3], pose[:3, 3] + axis * pose[:3, column]])
                panel.plot(ends[:, i], ends[:, j], color=colour, linewidth=2.5, zorder=4)
        panel.set_aspect("equal")
        panel.set_title(title)
        panel.set_xlabel(f"{'xyz'[i]} [m]")
        panel.set_ylabel(f"{'xyz'[j]} [m]")
        panel.grid(alpha=0.25)
    for colour, name in AXES:
        panels[0].plot([], [], color=colour, linewidth=2.5, label=name)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize=9)
    return figure


def _bodies(robot: Robot) -> list[tuple[Array, float]]:
    """Return centre and radius [m] of each collision body's bounding ball."""
    import pinocchio as pin

    geometry = robot.collision
    data, of_geometry = robot.model.createData(), geometry.createData()
    pin.updateGeometryPlacements(robot.model, data, geometry, of_geometry, robot.home)
    found = []
    for item, place in zip(geometry.geometryObjects, of_geometry.oMg, strict=True):
        item.geometry.computeLocalAABB()
        center = place.act(np.array(item.geometry.aabb_center))
        found.append((np.array(center), float(item.geometry.aabb_radius)))
    return found
