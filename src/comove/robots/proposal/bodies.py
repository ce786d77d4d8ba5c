"""Collision bodies of and about a robot, as points, and their contacts."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from comove.arrays import Array
from comove.model.scene import Scene
from comove.robots.model import Arm, Robot
from comove.robots.search.capsules import vertices_of
from comove.robots.verification.bodies import links_within, obstacle_object

ROOM = 20.0  # m, half the width of a scene that states none


def placed_bodies(robot: Robot, q: Array) -> Iterator[tuple[str, Array]]:
    """Yield every collision body's link and bounding points; arrays, shape (n, 3) [m]. Their hull contains it.

    Parameters
    ----------
    q : array, shape (n_joints,) [rad, m]
    """
    geometry = robot.collision
    data, placed = robot.model.createData(), geometry.createData()
    pin.updateGeometryPlacements(robot.model, data, geometry, placed, q)
    for item, place in zip(geometry.geometryObjects, placed.oMg, strict=True):
        yield link_of(item.name), _points_around(item.geometry) @ place.rotation.T + place.translation


def points_from_tip(robot: Robot, arm: Arm, links: Collection[str]) -> Array:
    """Return points around links at home in an arm's tip frame; array, shape (n, 3) [m]."""
    tip = robot.tool_pose(robot.home, replace(arm, tool=np.eye(4)))
    points = [points for link, points in placed_bodies(robot, robot.home) if link in links]
    return np.asarray((np.concatenate([np.empty((0, 3)), *points]) - tip[:3, 3]) @ tip[:3, :3])


def link_of(geometry: str) -> str:
    """Return the link of a collision body, which Pinocchio numbers."""
    return geometry.rpartition("_")[0]


def _points_around(shape: coal.CollisionGeometry) -> Array:
    """Return a mesh's vertices, or the corners of a body's box; array, shape (n, 3) [m]."""
    if isinstance(shape, coal.BVHModelBase | coal.ConvexBase):
        return vertices_of(shape)
    shape.computeLocalAABB()
    return np.array(list(product(*zip(shape.aabb_local.min_, shape.aabb_local.max_, strict=True))))


def touching(robot: Robot, joints: Array, margin: float | Array = 0.0) -> NDArray[np.bool_]:
    """Return which pairs of bodies come within margins [m]; array, shape (n_configurations, n_pairs).

    Parameters
    ----------
    joints : array, shape (n_configurations, n_joints) [rad, m]
    """
    geometry = robot.collision
    data, of_geometry = robot.model.createData(), geometry.createData()
    margins = np.broadcast_to(margin, len(geometry.collisionPairs)).tolist()
    for request, amount in zip(of_geometry.collisionRequests, margins, strict=True):
        request.security_margin = amount
    touched = np.zeros((len(joints), len(geometry.collisionPairs)), dtype=bool)
    for k, q in enumerate(joints):
        pin.computeCollisions(robot.model, data, geometry, of_geometry, q, False)
        touched[k] = [result.isCollision() for result in of_geometry.collisionResults]
    return touched


def pairs_of(robot: Robot) -> list[tuple[str, str]]:
    """Return the link names of every compared pair of bodies. They are sorted within the pair."""
    links = [link_of(item.name) for item in robot.collision.geometryObjects]
    both = (sorted((links[pair.first], links[pair.second])) for pair in robot.collision.collisionPairs)
    return [(a, b) for a, b in both]


def near_but_apart(
    robot: Robot,
    margin: Array,
    count: int,
    rng: np.random.Generator,
    *,
    most_between: int = 2,
    contact: float = 5e-4,
) -> set[tuple[str, str]]:
    """Return pairs of links nearer than at a home, but without contact.

    Candidates are seen in random configurations, and only links with one or two joints between them: they are checked
    on a grid of these joints, refined about its nearest configuration. So the result is observed, not proved.

    Parameters
    ----------
    margin : array, shape (n_pairs,), distance that each pair keeps [m]
    count : number of random configurations
    most_between : joints between two links whose distances can be sampled
    contact : distance of two links that counts as contact [m]
    """
    joints = rng.uniform(robot.lower, robot.upper, (count, len(robot.lower)))
    near, touch = (touching(robot, joints, margin) for margin in (margin, 0.0))
    links, geometry = pairs_of(robot), robot.collision
    # by links, which have several bodies
    touched = {pair for pair, seen in zip(links, touch.T, strict=True) if seen.any()}
    found = set[tuple[str, str]]()
    for k, pair in enumerate(geometry.collisionPairs):
        if links[k] in touched or not near[:, k].any():
            continue
        one, other = (
            robot.model.supports[geometry.geometryObjects[i].parentJoint] for i in (pair.first, pair.second)
        )
        columns = [robot.model.idx_vs[joint] for joint in set(one) ^ set(other)]
        if len(columns) <= most_between and _least_distance(robot, k, columns) > contact:
            found.add(links[k])
        else:
            touched.add(links[k])
    return found - touched


def _least_distance(robot: Robot, k: int, columns: Sequence[int]) -> float:
    """Return the least distance of pair k on joints' refined grids [m]."""
    n_grid, n_grids = 21, 4  # configurations of a joint on a grid, and grids one about the nearest of another
    model, geometry = robot.model, robot.collision
    data, of_geometry = model.createData(), geometry.createData()
    lower, upper, least = robot.lower[columns], robot.upper[columns], np.inf
    for _ in range(n_grids):
        axes = (np.linspace(a, b, n_grid) for a, b in zip(lower, upper, strict=True))
        grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, len(columns))
        samples = np.repeat(robot.home[None], len(grid), axis=0)
        samples[:, columns] = grid
        distances = np.empty(len(samples))
        for i, q in enumerate(samples):
            pin.updateGeometryPlacements(model, data, geometry, of_geometry, q)
            distances[i] = pin.computeDistance(geometry, of_geometry, k).min_distance
        least = min(least, float(distances.min()))
        best, step = grid[distances.argmin()], 2.0 * (upper - lower) / (n_grid - 1)
        lower, upper = np.maximum(best - step, lower), np.minimum(best + step, upper)
    return least


def scene_of(obstacles: Sequence[dict[str, Any]], folder: Path = Path()) -> Scene:
    """Return a scene of obstacles alone; files of meshes are relative to a folder.

    Raises
    ------
    SceneError
        If they are no obstacles as scenes have them.
    """
    nobody = {"name": "nobody", "start": [0.0] * 3, "goal": [0.0] * 3}
    data = {
        "name": "surroundings",
        "duration": 1.0,
        "workspace": {"lower": [-ROOM] * 3, "upper": [ROOM] * 3},
        "manipulators": [nobody],
        "obstacles": list(obstacles),
    }
    return Scene.from_dict(data, folder=folder, check_ends=False)


def names_of(around: Scene) -> list[str]:
    """Return the names of a scene's obstacles."""
    return [around.name_of(i) for i in range(len(around.file.obstacles))]


def among(robot: Robot, around: Scene | None) -> Robot:
    """Return a robot with the obstacles of a scene, if any. Every moving link is compared with them."""
    if around is None:
        return robot
    geometry = robot.collision.copy()
    links = [k for k, item in enumerate(geometry.geometryObjects) if item.parentJoint > 0]
    for i, name in enumerate(names_of(around)):
        body = obstacle_object(around, i, f"{name}_0")  # numbered, as Pinocchio numbers the bodies of links
        body.parentFrame = 0
        number = geometry.addGeometryObject(body)
        for link in links:
            geometry.addCollisionPair(pin.CollisionPair(link, number))
    return replace(robot, collision=geometry)


def buried(robot: Robot, around: Scene | None, q: Array) -> list[str]:
    """Return which links are inside a scene's closed meshes, in words. No triangle need be near them.

    Parameters
    ----------
    robot : without the scene's obstacles
    q : array, shape (n_joints,) [rad, m]
    """
    return [] if around is None else links_within(robot, around.surfaces, names_of(around), q)
