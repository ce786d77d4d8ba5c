"""Bodies of a robot at work, the pairs of them that could touch, and the clearance required of each pair.

======== ================================================================ ==========================
kind     pairs                                                            keep
======== ================================================================ ==========================
`SCENE`  every link that a joint moves with every obstacle, and all
         links with those obstacles that move                             the scene's clearance
`LOAD`   the load with every link but those beyond a holder's last joint  the scene's clearance
`SELF`   links that the robot's description lets collide                  5 mm, or less if so asked
======== ================================================================ ==========================

The scene's clearance is `limits.clearance`, 5 mm unless given; the load keeps it from obstacles as well. Links that
no joint moves may touch obstacles at rest, as a base does that stands on a table: no motion changes it. Where the
places of the robot's bases have tolerances (`uncertainty`), distances between links and obstacles, and between bodies
on different bases, are reduced by their effect.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from comove.arrays import Array, Integers
from comove.errors import ComoveWarning
from comove.geometry.rotations import matrices
from comove.geometry.surfaces import Surfaces, holds
from comove.model.files.keys import ROBOT_CLEARANCE
from comove.model.moving import rotations
from comove.model.scene import Scene
from comove.robots.model import Arm, Robot
from comove.robots.motion import Ranges
from comove.robots.verification.carried import Carried, leverage, load_shapes, placements
from comove.robots.verification.kinematics import Bases, moved_by

COAL_ERROR = 1e-4  # m, by which a distance from coal is trusted
BURIED = 0.01  # m, deeper than what stands on something is in it by the tolerances of drawings
SCENE, LOAD, SELF = range(3)
HULL_OF = "hull of "  # before a body's name in that of its hull
SCENE_ITSELF, LOAD_ALONE = -1, -2  # numbers for bodies that are on no base

OBSTACLE_SHAPES: dict[str, Callable[[Any], Any]] = {
    "box": lambda o: coal.Box(*o.size),
    "sphere": lambda o: coal.Sphere(o.radius),
    "capsule": lambda o: coal.Capsule(o.radius, o.length),
    "cylinder": lambda o: coal.Cylinder(o.radius, o.height),
    "ellipsoid": lambda o: coal.Ellipsoid(*o.radii),
}


@dataclass(frozen=True, eq=False)
class Bodies:
    """Robot, obstacles and load as one geometry model.

    Attributes
    ----------
    robot : robot whose model moves the bodies
    geometry : pinocchio.GeometryModel, whose collision pairs are those that are checked
    names : names of the bodies, for messages
    kind : array, shape (n_pairs,), SCENE, LOAD or SELF
    required : array, shape (3,), required clearance of each kind [m]
    taken : array, shape (n_pairs,), amount by which the true distance may be less than the computed one [m]
    reach : array, shape (n_pairs, n_joints + 1 + n_moving), largest change of a distance per motion of each joint, of
        the load, and of each obstacle that moves [m/rad, m/m]
    exact : array, shape (n_pairs,), index of the exact pair for which a pair is a rough substitute, or its own index:
        the convex hulls of meshes, nearer to everything and much faster, are checked first
    rods : for each shape of the load, its number and the nodes that it spans (see `load_shapes`)
    surfaces : the scene's meshes, which have an inside where they close
    moving : the obstacles that move
    """

    robot: Robot
    geometry: Any
    names: tuple[str, ...]
    kind: Integers
    required: Array
    taken: Array
    reach: Array
    exact: Integers
    rods: tuple[tuple[int, ...], ...]
    surfaces: Surfaces
    moving: MovingObstacles

    @property
    def joint_reach(self) -> Array:
        """Return the columns of `reach` that belong to joints; array, shape (n_pairs, n_joints)."""
        return self.reach[:, : self.robot.model.nv]

    def some(self, which: NDArray[np.bool_]) -> Bodies:
        """Return the bodies, copied, with some of their pairs; array, shape (n_pairs,).

        Pairs go with their rough substitutes, or neither does.
        """
        geometry, number = self.geometry.copy(), np.cumsum(which) - 1
        geometry.removeAllCollisionPairs()
        for first, second in self.ends[which].tolist():
            geometry.addCollisionPair(pin.CollisionPair(first, second))
        return replace(
            self,
            geometry=geometry,
            kind=self.kind[which],
            taken=self.taken[which],
            reach=self.reach[which],
            exact=number[self.exact[which]],
        )

    def placed_at(self, place: Array, time: float = 0.0) -> Bodies:
        """Place the load's bodies, in this geometry, and moving obstacles as they are at an instant.

        Parameters
        ----------
        place : array, shape (n_nodes, 3), nodes of the load [m]
        time : the instant [s]
        """
        for rod, *spanned in self.rods:
            (turn,), (middle,) = placements(place[None], tuple(spanned))
            self.geometry.geometryObjects[rod].placement = pin.SE3(turn, middle)
        (turns,), (places,) = self.moving.placements(np.array([time]))
        for body, turn, middle in zip(self.moving.body.tolist(), turns, places, strict=True):
            self.geometry.geometryObjects[body].placement = pin.SE3(turn, middle)
        return self

    @cached_property
    def ends(self) -> Integers:
        """Return the numbers of both bodies of every pair; array, shape (n_pairs, 2)."""
        pairs = self.geometry.collisionPairs
        return np.array([(p.first, p.second) for p in pairs], dtype=np.int64).reshape(-1, 2)

    @cached_property
    def joint(self) -> Integers:
        """Return the number of the joint that each body is on, 0 for the universe; array, shape (n_bodies,)."""
        return _joints(self.geometry)

    @cached_property
    def balls(self) -> tuple[Array, Array]:
        """Return the centre, in the frame of its joint, and the radius of a ball about each body; arrays, shape
        (n_bodies, 3) and (n_bodies,) [m]; those of the load's shapes, which lie anywhere, are about their origins.
        """
        items = list(self.geometry.geometryObjects)
        middles = np.array([item.geometry.aabb_center for item in items])
        centers = [item.placement.act(middle) for item, middle in zip(items, middles, strict=True)]
        radii = np.array([item.geometry.aabb_radius for item in items])
        loads = [rod for rod, *_ in self.rods]
        radii[loads] += np.linalg.norm(middles[loads], axis=1)
        return np.array(centers), radii

    def name(self, pair: int) -> str:
        """Return the names of both bodies of a pair, for messages."""
        both = self.geometry.collisionPairs[pair]
        return f"{self.names[both.first]} and {self.names[both.second]}"


def bodies_of(
    bases: Bases, arms: tuple[Arm, ...], carried: Carried, hands: Array, miss: float, *, held: bool = True
) -> Bodies:
    """Put robot, obstacles and load into one geometry model.

    Parameters
    ----------
    arms : arms in the order of the hands
    hands : array, shape (n_steps, n_hands, 3), positions of the hands [m]
    miss : largest error of the hands from the load's motion [m]
    held : whether the holders' hands have the load in them, and so no distance from it
    """
    robot, scene, lever = bases.robot, carried.motion.scene, leverage(carried)
    geometry = robot.collision.copy()
    names = [robot.model.frames[item.parentFrame].name for item in geometry.geometryObjects]
    on = _joints(geometry)
    pairs = [(p.first, p.second, SELF) for p in geometry.collisionPairs if on[p.first] != on[p.second]]
    pairs += _add_obstacles(geometry, names, scene)
    holders = [arms[i] for i in scene.file.holder_numbers] if held else []
    rods, with_load = _add_load(robot, geometry, names, carried, holders)
    pairs, exact, hulls = _with_hulls(geometry, names, pairs + with_load)
    moving = MovingObstacles.among(scene, geometry, robot.collision.ngeoms, hulls)
    geometry.removeAllCollisionPairs()
    for first, second, _ in pairs:
        geometry.addCollisionPair(pin.CollisionPair(first, second))
    kind = np.array([p[2] for p in pairs], dtype=np.int64)
    keep = scene.clearance if scene.file.on_robot else max(scene.clearance, ROBOT_CLEARANCE)
    reach, pull, base = _links_of(geometry, bases, names)
    pulls = [bases.of_hand(arms[i], hands[:, i]) for i in scene.file.holder_numbers]
    for rod, *_ in rods:  # a load between two bases is on neither
        base[rod] = pulls[0][0] if len({number for number, _ in pulls}) == 1 else LOAD_ALONE
        pull[rod] = max(amount for _, amount in pulls) * lever
    taken = _taken([(a, b) for a, b, _ in pairs], pull, base)
    taken[kind == LOAD] += miss * lever
    return Bodies(
        robot=robot,
        geometry=geometry,
        names=tuple(names),
        kind=kind,
        required=np.array([keep, keep, min(keep, ROBOT_CLEARANCE)]),
        taken=taken,
        reach=_changes(robot, geometry, reach, np.array(pairs, dtype=np.int64).reshape(-1, 3), moving),
        exact=exact,
        rods=rods,
        surfaces=scene.surfaces,
        moving=moving,
    )


def links_apart(robot: Robot) -> Array:
    """Return the distance that each pair of links keeps in every scene; array, shape (n_pairs,) [m].

    Pairs are those of the robot's collision geometry; distances are as coal computes them.
    """
    geometry, bases = robot.collision, Bases(robot, robot.description.uncertainty)
    names = [robot.model.frames[item.parentFrame].name for item in geometry.geometryObjects]
    _, pull, base = _links_of(geometry, bases, names)
    pairs = [(pair.first, pair.second) for pair in geometry.collisionPairs]
    return ROBOT_CLEARANCE + _taken(pairs, pull, base)


def _taken(pairs: list[tuple[int, int]], pull: Array, base: Integers) -> Array:
    """Return by how much the true distance of pairs may be less than the computed one; array, shape (n_pairs,) [m].

    Parameters
    ----------
    pull, base : as `_links_of` returns them
    """
    first, second = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    return np.where(base[first] == base[second], 0.0, pull[first] + pull[second]) + COAL_ERROR


def _add_obstacles(geometry: Any, names: list[str], scene: Scene) -> list[tuple[int, int, int]]:
    """Add the scene's obstacles; returns the pairs with all links that a joint or the obstacle moves past."""
    every, moved, pairs = range(geometry.ngeoms), np.flatnonzero(_joints(geometry)).tolist(), []
    for i, moves in enumerate(scene.moving):
        names.append(scene.name_of(i))
        number = geometry.addGeometryObject(obstacle_object(scene, i, names[-1], -scene.begins))
        pairs += [(link, number, SCENE) for link in (every if moves else moved)]
    return pairs


def warn_of_buried_links(robot: Robot, scene: Scene) -> None:
    """Warn of links that no joint moves and that are deep in an obstacle at rest: nothing checks these pairs.

    Warns
    -----
    ComoveWarning
        Names the pairs, how deep they are, and what to change.
    """
    geometry, names = robot.collision.copy(), list[str]()
    links = np.flatnonzero(_joints(geometry) == 0).tolist()
    _add_obstacles(geometry, names, scene)
    told = []
    for link in links:
        item = geometry.geometryObjects[link]
        for i in np.flatnonzero(~scene.moving).tolist():
            obstacle = geometry.geometryObjects[robot.collision.ngeoms + i]
            pair = [item.geometry, obstacle.geometry], [item.placement, obstacle.placement]
            if distance_of(*pair) < 0.0 and (depth := depth_of(*pair)[0]) > BURIED:
                told.append(
                    f"{robot.model.frames[item.parentFrame].name} is {depth:.2g} m deep in {names[i]}"
                )
    if told:
        warnings.warn(
            f"{'; '.join(told)}: no motion changes this, and it is not checked; move the obstacle, or correct "
            "where the robot's base stands",
            ComoveWarning,
            stacklevel=3,
        )


def _add_load(
    robot: Robot, geometry: Any, names: list[str], carried: Carried, holders: list[Arm]
) -> tuple[tuple[tuple[int, ...], ...], list[tuple[int, int, int]]]:
    """Add the load's shapes; returns their numbers with the nodes that they span, and the pairs with links."""
    in_hands, rods, pairs = beyond_wrists(robot, holders), list[tuple[int, ...]](), []
    links = [link for link, joint in enumerate(_joints(robot.collision)) if joint not in in_hands]
    for shape in load_shapes(carried):
        name = f"load {len(rods)}"
        number = geometry.addGeometryObject(pin.GeometryObject(name, 0, pin.SE3.Identity(), shape.geometry))
        rods.append((number, *shape.nodes))
        names.append("the load")
        pairs += [(link, number, LOAD) for link in links]
    return tuple(rods), pairs


def _with_hulls(
    geometry: Any, names: list[str], pairs: list[tuple[int, int, int]]
) -> tuple[list[tuple[int, int, int]], Integers, dict[int, int]]:
    """Return pairs with hulls instead of convex meshes, then the rough substitutes of other pairs; `Bodies.exact`;
    and the hulls by mesh.
    """
    convex, rough = _hulls(geometry, names)
    pairs = [(convex.get(a, a), convex.get(b, b), kind) for a, b, kind in pairs]
    exact = list(range(len(pairs)))
    for number, (a, b, kind) in enumerate(pairs.copy()):
        if a in rough or b in rough:
            exact.append(number)
            pairs.append((rough.get(a, a), rough.get(b, b), kind))
    return pairs, np.array(exact, dtype=np.int64), convex | rough


def obstacle_object(scene: Scene, i: int, name: str, time: float = 0.0) -> Any:
    """Return obstacle i of a scene, as it is at an instant [s], as a pinocchio.GeometryObject.

    At ``-scene.begins`` it is as in the file.

    A mesh is one of triangles.
    """
    obstacle, now = scene.file.obstacles[i], np.array([time])
    turned, center = rotations(scene.turns(now)[0, i]), np.array(obstacle.center) + scene.offsets(now)[0, i]
    if obstacle.shape == "mesh":
        mesh = int(np.argmax(scene.surfaces.owner == i))
        triangles = _triangles(scene.surfaces.of(mesh) - scene.surfaces.center[mesh])
        return pin.GeometryObject(name, 0, pin.SE3(turned, center), triangles)
    turn = turned @ matrices(np.array(getattr(obstacle, "quaternion_wxyz", (1.0, 0.0, 0.0, 0.0))))
    return pin.GeometryObject(name, 0, pin.SE3(turn, center), OBSTACLE_SHAPES[obstacle.shape](obstacle))


def _triangles(corners: Array) -> Any:
    """Return triangles, array of shape (n_triangles, 3, 3), as a coal.BVHModelOBBRSS."""
    vertices, number = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    points, faces, shape = coal.StdVec_Vec3s(), coal.StdVec_Triangle(), coal.BVHModelOBBRSS()
    points.extend(list(vertices))
    faces.extend([coal.Triangle(*map(int, face)) for face in number.reshape(-1, 3)])
    shape.beginModel(len(faces), len(points))
    shape.addSubModel(points, faces)
    shape.endModel()
    return shape


def links_inside(bodies: Bodies, joints: Array) -> list[str]:
    """Return which links are inside solids that meshes of the scene close, in words, as `links_within`."""
    return links_within(bodies.robot, bodies.surfaces, bodies.names[bodies.robot.collision.ngeoms :], joints)


def links_within(robot: Robot, surfaces: Surfaces, obstacles: Sequence[str], joints: Array) -> list[str]:
    """Return which links are inside solids that meshes close, in words; no triangle need be near them.

    Parameters
    ----------
    obstacles : names of the obstacles
    joints : array, shape (n_joints,) [rad]
    """
    found = list[str]()
    solids = np.flatnonzero(surfaces.closed)
    if not len(solids):
        return found
    data, placed = robot.model.createData(), robot.collision.createData()
    pin.updateGeometryPlacements(robot.model, data, robot.collision, placed, joints)
    for k, item in enumerate(robot.collision.geometryObjects):
        point = placed.oMg[k].act(_some_point(item.geometry))
        for mesh in solids.tolist():
            if holds(surfaces, mesh, *point):
                link = robot.model.frames[item.parentFrame].name
                found.append(f"{link} begins inside {obstacles[int(surfaces.owner[mesh])]}")
    return found


def _some_point(shape: Any) -> Array:
    """Return a point of a body in its own frame [m]."""
    if isinstance(shape, coal.BVHModelBase):
        return np.array(shape.vertices()[0])
    return np.array(shape.point(0)) if isinstance(shape, coal.ConvexBase) else np.zeros(3)


def beyond_wrists(robot: Robot, arms: Iterable[Arm]) -> set[int]:
    """Return the joints whose links move rigidly with a hand: the last one of each arm, and those beyond it."""
    lasts = {robot.grasp_frame(arm)[0] for arm in arms}
    return {j for j in range(1, robot.model.njoints) if lasts & set(robot.model.supports[j])}


def _hulls(geometry: Any, names: list[str]) -> tuple[dict[int, int], dict[int, int]]:
    """Add the convex hulls of meshes; returns the hulls by mesh, those of convex meshes and those of others.

    A mesh stays without one where coal builds none: not where more than 255 edges meet at a vertex.
    """
    convex, others = dict[int, int](), dict[int, int]()
    for number in range(geometry.ngeoms):
        item = geometry.geometryObjects[number]
        if not isinstance(item.geometry, coal.BVHModelBase):
            continue
        if item.geometry.convex is None:
            try:
                item.geometry.buildConvexHull(True, "Qt")
            except RuntimeError:
                continue
        hull = pin.GeometryObject(
            f"{HULL_OF}{item.name}", item.parentJoint, item.parentFrame, item.placement, item.geometry.convex
        )
        (convex if _is_convex(item.geometry) else others)[number] = geometry.addGeometryObject(hull)
        names.append(names[number])
    return convex, others


def depth_of(shapes: Sequence[Any], places: Sequence[Any]) -> tuple[float, bool]:
    """Compute how deep two bodies are in each other.

    Of meshes coal tells that they meet, not how deep; so their hulls are taken.

    Parameters
    ----------
    shapes, places : both bodies' shapes, by coal, and placements, as Pinocchio's SE3

    Returns
    -------
    depth : 0 where it is not known, as coal builds no hull of a mesh [m]
    is_bound : whether it is an upper bound, as a mesh is not convex
    """
    hulls, is_bound = list(shapes), False
    for k, shape in enumerate(shapes):
        if isinstance(shape, coal.BVHModelBase):
            try:
                if shape.convex is None:
                    shape.buildConvexHull(True, "Qt")
            except RuntimeError:
                return 0.0, False
            hulls[k], is_bound = shape.convex, is_bound or not _is_convex(shape)
    return max(0.0, -distance_of(hulls, places)), is_bound


def distance_of(shapes: Sequence[Any], places: Sequence[Any]) -> float:
    """Compute the distance of two bodies [m], negative where they meet; arguments as in `depth_of`."""
    placed = [coal.Transform3s(place.rotation, place.translation) for place in places]
    result = coal.DistanceResult()
    coal.distance(shapes[0], placed[0], shapes[1], placed[1], coal.DistanceRequest(), result)
    return float(result.min_distance)


def _is_convex(mesh: Any, missing: float = 1e-3) -> bool:
    """Return whether a mesh may be replaced by its hull, which is nearer to everything if they differ slightly: by no
    vertex, and by less than the share `missing` of its volume.
    """
    hull, volume = mesh.convex, mesh.convex.computeVolume()
    return mesh.num_vertices == hull.num_points and abs(mesh.computeVolume() - volume) < missing * volume


def _links_of(geometry: Any, bases: Bases, names: list[str]) -> tuple[Array, Array, Integers]:
    """Return how joints move the bodies, how far tolerances of the bases move them, and on which base they are.

    Returns
    -------
    reach : array, shape (n_bodies, n_joints), reach of balls about the bodies, see `Reaches`
    pull : array, shape (n_bodies,), largest displacement by the tolerance of a base [m]
    base : array, shape (n_bodies,), number of the model whose base carries a body; -1 for obstacles
    """
    robot, count = bases.robot, geometry.ngeoms
    reach, pull, base = np.zeros((count, robot.model.nv)), np.zeros(count), np.full(count, SCENE_ITSELF)
    for k, item in enumerate(geometry.geometryObjects):
        item.geometry.computeLocalAABB()
        center = item.placement.act(np.array(item.geometry.aabb_center))
        reach[k], root, length = bases.reaches.of_ball(item.parentJoint, center, item.geometry.aabb_radius)
        if 0 < item.parentFrame < robot.model.nframes:  # a link, or its hull
            base[k] = bases.numbers.get(names[k], 0)
            pull[k] = bases.pull(base[k], root, length)
    return reach, pull, base


def _changes(robot: Robot, geometry: Any, reach: Array, pairs: Integers, moving: MovingObstacles) -> Array:
    """Bound how joints, then the load, then moving obstacles change distances; joints that move both bodies do not.

    Parameters
    ----------
    reach : array, shape (n_bodies, n_joints), as in `_links_of`
    pairs : array, shape (n_pairs, 3), numbers of two bodies, and the kind

    Returns
    -------
    array, shape (n_pairs, n_joints + 1 + n_moving)
    """
    moved, (first, second, kind) = moved_by(robot)[_joints(geometry)], pairs.T
    change = np.where(moved[first] != moved[second], reach[first] + reach[second], 0.0)
    by_obstacle = moving.owns(first) + moving.owns(second)
    return np.column_stack([change, kind == LOAD, by_obstacle])


def _joints(geometry: Any) -> Integers:
    return np.array([item.parentJoint for item in geometry.geometryObjects], dtype=np.int64)


@dataclass(frozen=True, eq=False)
class MovingObstacles:
    """The bodies of a geometry model that are obstacles in motion.

    Attributes
    ----------
    scene : scene whose obstacles they are
    obstacle : array, shape (n_moving,), numbers of the obstacles that move
    body : array, shape (n_bodies,), numbers of their bodies: the obstacles themselves, and hulls of meshes
    of : array, shape (n_bodies,), for each body the index of its obstacle in `obstacle`
    turn, place : arrays, shape (n_bodies, 3, 3) and (n_bodies, 3), placements of the bodies in the file [m]
    """

    scene: Scene
    obstacle: Integers
    body: Integers
    of: Integers
    turn: Array
    place: Array

    @classmethod
    def among(cls, scene: Scene, geometry: Any, first: int, hulls: Mapping[int, int]) -> MovingObstacles:
        """Return the obstacles of a scene that move, among bodies.

        Parameters
        ----------
        geometry : pinocchio.GeometryModel
        first : number of the first obstacle's body, which those of the others follow
        hulls : numbers of hulls, by those of the meshes that they hold
        """
        moving = np.flatnonzero(scene.moving)
        body = [(k, first + i) for k, i in enumerate(moving.tolist())]
        body += [(k, hulls[number]) for k, number in body if number in hulls]
        of, numbers = np.array(body, dtype=np.int64).reshape(-1, 2).T
        placed = [geometry.geometryObjects[number].placement for number in numbers.tolist()]
        return cls(
            scene,
            moving,
            numbers,
            of,
            np.array([place.rotation for place in placed]).reshape(-1, 3, 3),
            np.array([place.translation for place in placed]).reshape(-1, 3),
        )

    def owns(self, body: Integers) -> NDArray[np.bool_]:
        """Return which moving obstacle each of some bodies is part of; arrays, shape (n,) -> (n, n_moving)."""
        part = np.zeros((len(body), len(self.obstacle)), dtype=bool)
        for number, k in zip(self.body, self.of, strict=True):
            part[:, k] |= body == number
        return part

    def placements(self, time: Array) -> tuple[Array, Array]:
        """Compute where the bodies are at some instants, array of shape (n_steps,) [s].

        Returns
        -------
        arrays, shape (n_steps, n_bodies, 3, 3) and (n_steps, n_bodies, 3) [m]
        """
        own = self.obstacle[self.of]
        turns = rotations(self.scene.turns(time)[:, own]) @ self.turn
        return turns, self.place + self.scene.offsets(time)[:, own]

    @cached_property
    def speed(self) -> Ranges:
        """Return upper bounds of the speed of a point of each moving obstacle [m/s].

        Between kinks the speed of what does not turn is constant.
        """
        scene, own = self.scene, self.obstacle
        knots = np.unique([0.0, *scene.obstacle_kinks, scene.duration])
        middle = 0.5 * (knots[1:] + knots[:-1])  # rounding must not take the velocity before a kink
        speeds = np.linalg.norm(scene.obstacle_velocities(middle)[:, own], axis=2)
        return Ranges(knots, np.where(scene.turning[own], scene.obstacle_speeds[own], speeds))
