"""Drake's `KinematicTrajectoryOptimization` on robots: a B-spline of joints.

Links are the convex hulls of their bodies, as in Drake. As its tutorials advise, the straight path in joints
is bent until the grasps hold, then until nothing touches; SNOPT does both. A spline meets no more equations
than it has unknowns, so there are fewer instants than control points, and a band that is part of what is tolerated.
These numbers were chosen on the first ten scenes of `robots-hard`.
"""

from __future__ import annotations

import logging
import tempfile
import time
import xml.etree.ElementTree as ET
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.geometry import (
    Box,
    Capsule,
    CollisionFilterDeclaration,
    Convex,
    Cylinder,
    GeometrySet,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.inverse_kinematics import (
    AngleBetweenVectorsConstraint,
    MinimumDistanceLowerBoundConstraint,
    PositionConstraint,
)
from pydrake.multibody.plant import CoulombFriction
from pydrake.planning import KinematicTrajectoryOptimization, RobotDiagramBuilder
from pydrake.solvers import SnoptSolver, SolverOptions
from robots_peers_terms import (
    BUDGET,
    EACH,
    N_SAMPLES,
    TOLERANCE,
    Outcome,
    Terms,
    as_one_urdf,
    left_out,
    links_of,
    pose_of,
)

Array = NDArray[np.float64]

N_CONTROL, ORDER = 16, 4  # control points, and one more than the degree
N_HELD, N_CLEAR = 12, 30  # instants at which hands hold the load, and at which nothing may touch
BAND = 0.3  # of what is tolerated, within which hands are held at instants
CLEAR = 0.005  # m, that bodies keep at instants, for what is between them
NEAR = 0.02  # m, below which distances are looked at
MAJOR, MINOR = 500, 100_000  # iterations of SNOPT, and of the quadratic programmes in them, at most
LEVER = 0.2  # m, at which points of the second hand are held in the first, besides its origin
FRICTION = CoulombFriction(0.5, 0.5)  # Drake wants it, nothing uses it


class Carry:
    """Drake's model of a scene, for one pair of end joints."""

    def __init__(self, terms: Terms):
        self.terms = terms
        builder = RobotDiagramBuilder(time_step=0.0)
        plant = builder.plant()
        with tempfile.TemporaryDirectory() as folder:
            urdf = as_one_urdf(terms, Path(folder), loaded=True)
            for link in urdf.findall("link"):
                for part in link.findall("visual") + link.findall("collision"):
                    if link.get("name") != "load":
                        link.remove(part)
            builder.parser().AddModelsFromString(ET.tostring(urdf, encoding="unicode"), "urdf")
        sets = self._add_links(plant)
        sets["load"] = plant.GetCollisionGeometriesForBody(plant.GetBodyByName("load"))
        around = self._add_obstacles(plant)
        plant.Finalize()
        self._filter(builder.scene_graph(), sets, around)
        self.diagram = builder.Build()
        self.plant = self.diagram.plant()
        self.context = self.diagram.CreateDefaultContext()
        self.at = self.diagram.mutable_plant_context(self.context)
        joints = [self.plant.GetJointByName(name) for name in terms.robot.joint_names]
        self.order = np.array([joint.position_start() for joint in joints])

    def _add_links(self, plant: Any) -> dict[str, list[Any]]:
        robot, found = self.terms.robot, dict[str, list[Any]]()
        for k, (link, item) in enumerate(zip(links_of(robot), robot.collision.geometryObjects, strict=True)):
            frame = robot.model.frames[item.parentFrame]
            at = RigidTransform((frame.placement.inverse() * item.placement).homogeneous)
            geometry = plant.RegisterCollisionGeometry(
                plant.GetBodyByName(link), at, shape_of(item.geometry), f"{link} {k}", FRICTION
            )
            found.setdefault(link, []).append(geometry)
        return found

    def _add_obstacles(self, plant: Any) -> list[Any]:
        found = []
        for k, obstacle in enumerate(self.terms.scene.file.obstacles):
            match obstacle.shape:
                case "box":
                    shape = Box(*obstacle.size)
                case "cylinder":
                    shape = Cylinder(obstacle.radius, obstacle.height)
                case "capsule":
                    shape = Capsule(obstacle.radius, obstacle.length)
                case _:
                    shape = Sphere(obstacle.radius)
            found.append(
                plant.RegisterCollisionGeometry(
                    plant.world_body(), RigidTransform(pose_of(obstacle)), shape, f"obstacle {k}", FRICTION
                )
            )
        return found

    def _filter(self, scene_graph: Any, sets: dict[str, list[Any]], around: list[Any]) -> None:
        """Restrict collisions to the bodies compared by other systems."""
        every = [geometry for group in sets.values() for geometry in group] + around
        filters = scene_graph.collision_filter_manager()
        filters.Apply(CollisionFilterDeclaration().ExcludeWithin(GeometrySet(every)))
        apart, allowed = {frozenset(pair) for pair in left_out(self.terms)}, CollisionFilterDeclaration()
        for first, second in combinations(sets, 2):
            if frozenset((first, second)) not in apart:
                allowed.AllowBetween(GeometrySet(sets[first]), GeometrySet(sets[second]))
        for group in sets.values():
            allowed.AllowBetween(GeometrySet(group), GeometrySet(around))
        filters.Apply(allowed)

    def held(self, first: Array) -> list[Any]:
        """Return the grasp constraints as at given joints of the robot."""
        terms, plant, at = self.terms, self.plant, self.at
        poses = [terms.robot.tool_pose(first, arm) for arm in terms.arms]
        a, b = (plant.GetFrameByName(f"grasp_{arm.name}") for arm in terms.arms)
        between, world = np.linalg.inv(poses[0]) @ poses[1], plant.world_frame()
        most = BAND * TOLERANCE[1]
        return [
            *(self._held_point(a, b, between, point) for point in LEVER * np.eye(4, 3, -1)),
            *(
                AngleBetweenVectorsConstraint(
                    plant, world, across, a, poses[0][2, :3], np.pi / 2 - most, np.pi / 2 + most, at
                )
                for across in np.eye(3)[:2]
            ),
            *(
                PositionConstraint(plant, world, terms.lower, terms.upper, frame, np.zeros(3), at)
                for frame in (a, b)
            ),
        ]

    def _held_point(self, a: Any, b: Any, between: Array, point: Array) -> Any:
        """Return the constraint of a second-hand point in the first's frame."""
        there = between[:3, :3] @ point + between[:3, 3]
        band = BAND * TOLERANCE[0] / np.sqrt(3)
        return PositionConstraint(self.plant, a, there - band, there + band, b, point, self.at)

    def solve(self, first: Array, last: Array, until: float) -> Array | None:
        """Return joints at even times, or None if SNOPT fails. Array, shape (N_SAMPLES, n_joints)."""
        robot, back = self.terms.robot, np.argsort(self.order)
        n, ends, s = len(back), (first[back], last[back]), np.linspace(0.0, 1.0, N_CONTROL)
        guess = ends[0][:, None] + (ends[1] - ends[0])[:, None] * (s**2 * (3 - 2 * s))
        for clear in (False, True):
            wanted = KinematicTrajectoryOptimization(n, N_CONTROL, ORDER, 1.0)
            programme, points = wanted.get_mutable_prog(), wanted.control_points()
            for place, q in zip((0.0, 1.0), ends, strict=True):
                wanted.AddPathPositionConstraint(q, q, place)
                wanted.AddPathVelocityConstraint(np.zeros(n), np.zeros(n), place)
            wanted.AddPositionBounds(robot.lower[back], robot.upper[back])
            wanted.AddDurationConstraint(1.0, 1.0)
            wanted.AddPathEnergyCost(1.0)
            for place in np.linspace(0.0, 1.0, N_HELD + 2)[1:-1]:
                for constraint in self.held(first):
                    wanted.AddPathPositionConstraint(constraint, place)
            if clear:
                apart = MinimumDistanceLowerBoundConstraint(self.plant, CLEAR, self.at, None, NEAR)
                for place in np.linspace(0.0, 1.0, N_CLEAR + 2)[1:-1]:
                    wanted.AddPathPositionConstraint(apart, place)
            programme.SetInitialGuess(points, guess)
            programme.SetInitialGuess(wanted.duration(), 1.0)

            def ask(_: Array) -> None:
                if time.process_time() > until:
                    raise OutOfTime

            programme.AddVisualizationCallback(ask, points.ravel())
            options = SolverOptions()
            options.SetOption(SnoptSolver.id(), "Major iterations limit", MAJOR)
            options.SetOption(SnoptSolver.id(), "Iterations limit", MINOR)
            try:
                found = SnoptSolver().Solve(programme, None, options)
            except RuntimeError:  # Drake's own, about what `ask` raises when time is up
                if time.process_time() > until:
                    return None
                raise
            if not found.is_success():
                return None
            guess = found.GetSolution(points)
        curve = wanted.ReconstructTrajectory(found)
        return curve.vector_values(np.linspace(0.0, 1.0, N_SAMPLES)).T[:, self.order]


class OutOfTime(Exception):
    """Signal that a budget is used up."""


def shape_of(geometry: Any) -> Any:
    """Return a body of coal as Drake's primitive or hull."""
    match type(geometry).__name__:
        case "Box":
            return Box(*(2.0 * np.array(geometry.halfSide)))
        case "Sphere":
            return Sphere(geometry.radius)
        case "Capsule":
            return Capsule(geometry.radius, 2.0 * geometry.halfLength)
        case "Cylinder":
            return Cylinder(geometry.radius, 2.0 * geometry.halfLength)
        case name if name.startswith("BVH"):
            return Convex(np.array(geometry.vertices()).T, "mesh")
        case _:
            return Convex(np.array(geometry.points()).T, "hull")


def by_drake(terms: Terms, _: int) -> Outcome:
    """Solve a scene with Drake, without random numbers."""
    logging.getLogger("drake").setLevel(logging.ERROR)  # parts of URDFs that it does not know
    carry = Carry(terms)  # a model is the robot's, and not a search's
    begun = time.process_time()
    for first, last in terms.ends:
        spent = time.process_time() - begun
        if spent > BUDGET:
            break
        joints = carry.solve(first, last, begun + min(BUDGET, spent + EACH))
        if joints is not None:
            whole = time.process_time() - begun
            return Outcome(joints, whole, whole)
    return Outcome(None, np.nan, time.process_time() - begun)
