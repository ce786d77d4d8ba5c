"""A picture of a robot at home from three sides: links, grasp frames, and the places that its hands reach."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from matplotlib.figure import Figure
from numpy.typing import NDArray

from comove.views.style import new_figure

if TYPE_CHECKING:
    from comove.robots.model import Robot
    from comove.robots.proposal import Examination

Array = NDArray[np.float64]

VIEWS = (("from above", 0, 1), ("from the front", 1, 2), ("from the side", 0, 2))
AXIS = 0.1  # m, length of the axes of a grasp frame that are drawn
AXES = (("#c0392b", "x"), ("#27ae60", "y: fingers open"), ("#2c5fb3", "z: approach"))
OF_ARMS = ("#8e44ad", "#d68910", "#16a085", "#7f8c8d")  # none of them the colour of an axis
SHOWN = 600  # places of each hand


def draw_robot(robot: Robot, found: Examination) -> Figure:
    """Draw a robot at home in three views, with the places that its hands reach."""
    figure = new_figure(15.0, 5.6)
    figure.suptitle(f"{robot.name} at home")
    panels = figure.subplots(1, len(VIEWS))
    lines, bodies = _skeleton(robot), _bodies(robot)
    for panel, (title, i, j) in zip(panels, VIEWS, strict=True):
        for k, of_arm in enumerate(found.arms):
            colour = OF_ARMS[k % len(OF_ARMS)]
            places = of_arm.places[:SHOWN]
            panel.scatter(places[:, i], places[:, j], s=5, color=colour, alpha=0.4, linewidths=0)
            panel.plot([], [], "o", color=colour, label=f"{of_arm.name}: reach {of_arm.reach:.2f} m")
        for center, radius in bodies:
            panel.add_patch(_circle(center[[i, j]], radius))
        for line in lines:
            panel.plot(line[:, i], line[:, j], color="#303030", linewidth=2.2, zorder=3)
        for arm in robot.arms:
            pose = robot.tool_pose(robot.home, arm)
            for column, (colour, _) in enumerate(AXES):
                ends = np.stack([pose[:3, 3], pose[:3, 3] + AXIS * pose[:3, column]])
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


def _circle(center: Array, radius: float):  # type: ignore[no-untyped-def]  # matplotlib's patches are untyped
    from matplotlib.patches import Circle

    return Circle((center[0], center[1]), radius, facecolor="#909090", edgecolor="none", alpha=0.16, zorder=2)


def _skeleton(robot: Robot) -> list[Array]:
    """Return, for every arm, its joints and its grasp frame; arrays, shape (n, 3) [m]."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.home)
    return [
        np.array(
            [data.oMi[int(column) + 1].translation for column in arm.columns]
            + [robot.tool_pose(robot.home, arm)[:3, 3]]
        )
        for arm in robot.arms
    ]


def _bodies(robot: Robot) -> list[tuple[Array, float]]:
    """Return centre and radius [m] of a ball around every collision body."""
    geometry = robot.collision
    data, of_geometry = robot.model.createData(), geometry.createData()
    pin.updateGeometryPlacements(robot.model, data, geometry, of_geometry, robot.home)
    found = []
    for item, place in zip(geometry.geometryObjects, of_geometry.oMg, strict=True):
        item.geometry.computeLocalAABB()
        center = place.act(np.array(item.geometry.aabb_center))
        found.append((np.array(center), float(item.geometry.aabb_radius)))
    return found
