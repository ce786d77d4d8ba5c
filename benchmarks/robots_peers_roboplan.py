"""RoboPlan: RRT-Connect under pose constraints, with its own TOPP-RA.

The second end effector is constrained to the first. Of three steps between checked states (0.05, 0.02 and 0.01 rad)
the largest of the best was used, on the first ten scenes of `robots-easy` and of `robots-hard`.
"""

from __future__ import annotations

import tempfile
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from roboplan.core import (
    Box,
    Cylinder,
    JointConfiguration,
    Scene,
    Sphere,
    loadUrdfSceneDescriptionFromXml,
)
from roboplan.rrt import RRT, PoseConstraint, RRTOptions
from roboplan.toppra import PathParameterizerTOPPRA, TOPPRAOptions
from robots_peers_terms import (
    BUDGET,
    EACH,
    N_SAMPLES,
    TOLERANCE,
    Outcome,
    Terms,
    as_one_urdf,
    left_out,
    pose_of,
    standing,
)
from scipy.interpolate import CubicHermiteSpline

Array = NDArray[np.float64]

STEP = 0.02  # rad, between states that are checked


class RoboPlan:
    """RoboPlan's model of a scene: one URDF of all models. The payload is on the first end effector unless left
    out."""

    def __init__(self, terms: Terms, *, loaded: bool):
        self.terms, robot = terms, terms.robot
        with tempfile.TemporaryDirectory() as folder:
            text = ET.tostring(as_one_urdf(terms, Path(folder), loaded=loaded), encoding="unicode")
            self.scene = Scene("both", loadUrdfSceneDescriptionFromXml(text))
        self.scene.addGroup("all", list(robot.joint_names))
        for arm in terms.arms:
            self.scene.addGroup(arm.name, [robot.joint_names[column] for column in arm.columns])
        pairs = [pair for pair in left_out(terms) if loaded or "load" not in pair]
        self.scene.setCollisions(pairs, False)
        self._add_obstacles()

    def _add_obstacles(self) -> None:
        color, known = np.array([0.5, 0.5, 0.5, 1.0]), standing(self.terms.robot)
        for k, obstacle in enumerate(self.terms.scene.file.obstacles):
            for part, shape, at in parts_of(obstacle):
                name = f"obstacle{k}{part}"
                getattr(self.scene, f"add{type(shape).__name__}Geometry")(name, "universe", shape, at, color)
                self.scene.setCollisions([(name, body) for body in known], False)
                known.append(name)

    def constraints(self, q: Array) -> list[PoseConstraint]:
        """Return the pose constraints of both end effectors at joints q. The second is fixed to the first, and the
        first stays level."""
        terms = self.terms
        poses = [terms.robot.tool_pose(q, arm) for arm in terms.arms]
        frames = [f"grasp_{arm.name}" for arm in terms.arms]
        none, turn = np.zeros(6), np.array([np.inf, np.inf, np.inf, 0.0, 0.0, np.inf])
        any_way = np.full(3, np.inf)
        room = [np.append(terms.lower, -any_way), np.append(terms.upper, any_way)]
        world = np.asfortranarray(np.eye(4))
        apart = np.asfortranarray(np.linalg.inv(poses[0]) @ poses[1])
        level = np.asfortranarray(poses[0])
        held = {"position_tolerance": TOLERANCE[0], "orientation_tolerance": TOLERANCE[1]}
        level_held = {"orientation_tolerance": TOLERANCE[1]}
        return [
            PoseConstraint(self.scene, "all", frames[1], none, none, apart, frames[0], **held),
            PoseConstraint(self.scene, "all", frames[0], -turn, turn, level, **level_held),
            *(PoseConstraint(self.scene, "all", frame, *room, world) for frame in frames),
        ]

    def plan(
        self, group: str, start: Array, goal: Array, seed: int, constraints: list[PoseConstraint]
    ) -> Any:
        """Return a path of a group of joints, or None. It has the time for one pair of ends."""
        options = RRTOptions(
            group_name=group,
            max_nodes=40_000,
            max_connection_distance=0.5,
            collision_check_step_size=STEP,
            max_planning_time=EACH,
            rrt_connect=True,
        )
        rrt = RRT(self.scene, options)
        rrt.setRngSeed(seed)
        ends = []
        for q in (start, goal):
            ends.append(JointConfiguration())
            ends[-1].positions = q
        try:
            return rrt.plan(*ends, constraints)
        except RuntimeError:  # it found none
            return None

    def timed(self, group: str, path: Any) -> Array:
        """Return the path at even times by TOPP-RA; array, shape (N_SAMPLES, n_joints of the group)."""
        options = TOPPRAOptions()
        options.dt = 0.005
        found = PathParameterizerTOPPRA(self.scene, group).generate(path, options)
        times = np.array(found.times)
        curve = CubicHermiteSpline(times, np.array(found.positions), np.array(found.velocities))
        return curve(np.linspace(times[0], times[-1], N_SAMPLES))


def parts_of(obstacle: Any) -> Iterator[tuple[str, Any, Array]]:
    """Yield an obstacle's shapes supported by RoboPlan, and their poses. A capsule is a cylinder with two balls."""
    at = pose_of(obstacle)
    match obstacle.shape:
        case "box":
            yield "", Box(*obstacle.size), at
        case "cylinder":
            yield "", Cylinder(obstacle.radius, obstacle.height), at
        case "capsule":
            yield "", Cylinder(obstacle.radius, obstacle.length), at
            for end, side in (("top", 0.5), ("bottom", -0.5)):
                moved = at.copy(order="F")
                moved[:3, 3] += side * obstacle.length * at[:3, 2]
                yield end, Sphere(obstacle.radius), moved
        case _:
            yield "", Sphere(obstacle.radius), at


def by_roboplan(terms: Terms, seed: int) -> Outcome:
    """Solve a scene with RoboPlan."""
    planner = RoboPlan(terms, loaded=True)  # a model is the robot's, and not a search's, as comove's is
    begun = time.process_time()
    for first, last in terms.ends:
        if time.process_time() - begun > BUDGET:
            break
        path = planner.plan("all", first, last, seed, planner.constraints(first))
        if path is not None:
            done = time.process_time() - begun
            return Outcome(planner.timed("all", path), done, time.process_time() - begun)
    return Outcome(None, np.nan, time.process_time() - begun)
