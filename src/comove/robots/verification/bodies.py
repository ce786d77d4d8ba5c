"""Collision bodies of a robot, their pairs, and each pair's required clearance.

======== ================================================================ ==========================
kind     pairs                                                            keep
======== ================================================================ ==========================
`SCENE`  every link that a joint moves with every obstacle, and all
         links with those obstacles that move                             the scene's clearance
`LOAD`   the payload and links, except beyond a holder's last joint       the scene's clearance
`SELF`   links that the robot's description lets collide                  5 mm, or less if required
======== ================================================================ ==========================

The scene's clearance is `limits.clearance`, 5 mm unless given; the payload keeps it from obstacles as well. Links
that no joint moves may touch obstacles at rest, as a base does that stands on a table: no motion changes it. Where
the places of the robot's bases have tolerances (`uncertainty`), distances between links and obstacles, and between
bodies on different bases, are reduced by their effect. Where joints may deviate from their commands, the pairs keep
these clearances as commanded, and touch nowhere within the deviations (`comove.robots.verification.deviations`).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product
from typing import Any, NamedTuple

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
from comove.model.scene import Scene, of_geometry
from comove.robots.model import Arm, Robot
from comove.robots.motion import JointCurve, Ranges
from comove.robots.verification.carried import Carried, leverage, load_shapes, payload_shift, placements
from comove.robots.verification.deviations import Balls, lever_arms, shifts_of_hands
from comove.robots.verification.kinematics import Bases, common_joints, moved_by, supports_of
from comove.robots.verification.slabs import CYLINDER, ELLIPSOID, OTHER, POINTS, Pairs, Solid, Solids

COAL_ERROR = 1e-4  # m, taken from every distance for errors of coal and of GJK
BURIED = 0.01  # m, depth up to which a link may be in its support, as tolerances of drawings
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


class CollisionBody(NamedTuple):
    """A body and the properties of its shape.

    Attributes
    ----------
    item : pinocchio.GeometryObject
    name : its name, for messages
    solid : its shape for kernels
    hull : its convex hull as a body, where it is a mesh that has one
    is_convex : whether the hull may replace it
    """

    item: Any
    name: str
    solid: Solid
    hull: CollisionBody | None = None
    is_convex: bool = False


class LinkBodies(NamedTuple):
    """The bodies of a robot's links, and their hulls, for all scenes.

    Attributes
    ----------
    bodies : links, then hulls
    pairs : array, shape (n_pairs, 2), links that may not touch
    joint : array, shape (n_bodies,), joint that each is on
    reach, root, length : arrays, shape (n_bodies, n_joints), (n_bodies, 3) and (n_bodies,), see `Reaches.of_ball`
    base : array, shape (n_bodies,), number of the model on whose base a body is
    solids : the bodies for kernels
    """

    bodies: tuple[CollisionBody, ...]
    pairs: Integers
    joint: Integers
    reach: Array
    root: Array
    length: Array
    base: Integers
    solids: Solids


@lru_cache(maxsize=8)
def links_of(robot: Robot) -> LinkBodies:
    """Return the links of a robot."""
    geometry, bases = robot.collision, Bases(robot, robot.description.uncertainty)
    links = [_body(item, robot.model.frames[item.parentFrame].name) for item in geometry.geometryObjects]
    bodies = (*links, *(link.hull for link in links if link.hull is not None))
    joint, reaches = np.array([body.item.parentJoint for body in bodies], dtype=np.int64), bases.reaches
    found = [
        reaches.of_ball(k, body.solid.center, body.solid.radius)
        for k, body in zip(joint.tolist(), bodies, strict=True)
    ]
    pairs = np.array([(p.first, p.second) for p in geometry.collisionPairs], dtype=np.int64).reshape(-1, 2)
    return LinkBodies(
        bodies,
        pairs[joint[pairs[:, 0]] != joint[pairs[:, 1]]],
        joint,
        np.array([reach for reach, _, _ in found]).reshape(-1, robot.model.nv),
        np.array([root for _, root, _ in found]).reshape(-1, 3),
        np.array([length for _, _, length in found]),
        np.array([bases.numbers.get(body.name, 0) for body in bodies], dtype=np.int64),
        Solids.of(joint, [body.solid for body in bodies]),
    )


@of_geometry
def _obstacles(scene: Scene) -> tuple[CollisionBody, ...]:
    """Return the obstacles of a scene, as they are in its file."""
    names = [scene.name_of(i) for i in range(len(scene.file.obstacles))]
    return tuple(_body(obstacle_object(scene, i, name, -scene.begins), name) for i, name in enumerate(names))


def _body(item: Any, name: str) -> CollisionBody:
    """Return a body, with its hull where it is a mesh."""
    hull, is_convex = _hull_of(item)
    body = None if hull is None else CollisionBody(hull, name, solid_of(hull))
    return CollisionBody(item, name, solid_of(item), body, is_convex)


@dataclass(frozen=True, eq=False)
class Bodies:
    """Robot, obstacles and payload as bodies, and hulls of links and obstacles.

    Attributes
    ----------
    robot : robot that moves the bodies
    bodies : the bodies
    joint : array, shape (n_bodies,), number of the joint that each body is on, 0 for the universe
    ends : array, shape (n_pairs, 2), numbers of both bodies of every pair
    kind : array, shape (n_pairs,), SCENE, LOAD or SELF
    required : array, shape (3,), required clearance of each kind [m]
    taken : array, shape (n_pairs,), amount by which the true distance may be less than the computed one [m]
    strayed : array, shape (n_pairs,), by which joints that deviate may lessen the distance besides [m]
    reach : array, shape (n_pairs, n_joints + 1 + n_moving), largest change of a distance per motion of each joint, of
        the payload, and of each moving obstacle [m/rad, m/m]
    exact : array, shape (n_pairs,), index of the exact pair for which a pair is a rough substitute, or its own index:
        the convex hulls of meshes, nearer to everything and much faster, are checked first
    rods : for each shape of the payload, its number and the keypoints that it spans (see `load_shapes`)
    surfaces : the scene's meshes, which have an inside where they close
    moving : the obstacles that move
    """

    robot: Robot
    bodies: tuple[CollisionBody, ...]
    joint: Integers
    ends: Integers
    kind: Integers
    required: Array
    taken: Array
    strayed: Array
    reach: Array
    exact: Integers
    rods: tuple[tuple[int, ...], ...]
    surfaces: Surfaces
    moving: MovingObstacles

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the bodies, for messages."""
        return tuple(body.name for body in self.bodies)

    @property
    def joint_reach(self) -> Array:
        """Return the columns of `reach` that belong to joints; array, shape (n_pairs, n_joints)."""
        return self.reach[:, : self.robot.model.nv]

    @property
    def deviating(self) -> Bodies:
        """Return the bodies while joints deviate. Pairs are nearer, and may not touch."""
        return replace(self, taken=self.taken + self.strayed, required=np.zeros(3))

    def some(self, which: NDArray[np.bool_]) -> Bodies:
        """Return the bodies with some of their pairs; array, shape (n_pairs,).

        Pairs go with their rough substitutes, or neither does.
        """
        number = np.cumsum(which) - 1
        chosen = {name: getattr(self, name)[which] for name in ("ends", "kind", "taken", "strayed", "reach")}
        return replace(self, **chosen, exact=number[self.exact[which]])

    def placed_at(self, place: Array, time: float = 0.0) -> Bodies:
        """Return the bodies with payload and moving obstacles placed at an instant. They are placed in `geometry`.

        Parameters
        ----------
        place : array, shape (n_nodes, 3), keypoints of the payload [m]
        time : the instant [s]
        """
        bodies = list(self.bodies)
        numbers = [rod for rod, *_ in self.rods] + self.moving.body.tolist()
        for number, turn, middle in zip(
            numbers, *self.placements(place[None], np.array([time])), strict=True
        ):
            item = pin.GeometryObject(bodies[number].item)
            item.placement = pin.SE3(turn[0], middle[0])
            bodies[number] = bodies[number]._replace(item=item)
        return replace(self, bodies=tuple(bodies))

    def placements(self, nodes: Array, time: Array) -> tuple[list[Array], list[Array]]:
        """Compute the placements of the payload's shapes, then of moving obstacles.

        Parameters
        ----------
        nodes : array, shape (n_steps, n_nodes, 3), keypoints of the payload [m]
        time : array, shape (n_steps,) [s]

        Returns
        -------
        for each, arrays of shape (n_steps, 3, 3) and (n_steps, 3) [m]
        """
        placed = [placements(nodes, tuple(spanned)) for _, *spanned in self.rods]
        if len(self.moving.body):
            turns, places = self.moving.placements(time)
            placed += [(turns[:, k], places[:, k]) for k in range(turns.shape[1])]
        return [turns for turns, _ in placed], [places for _, places in placed]

    @cached_property
    def geometry(self) -> Any:
        """Return the bodies and pairs as a pinocchio.GeometryModel."""
        geometry = pin.GeometryModel()
        for body in self.bodies:
            geometry.addGeometryObject(body.item)
        for first, second in self.ends.tolist():
            geometry.addCollisionPair(pin.CollisionPair(first, second))
        return geometry

    @cached_property
    def frame(self) -> Integers:
        """Return the bodies' frames: those of joints, payload shapes, moving obstacles; array, shape (n_bodies,)."""
        frame = self.joint.copy()
        numbers = [rod for rod, *_ in self.rods] + self.moving.body.tolist()
        frame[numbers] = self.robot.model.njoints + np.arange(len(numbers))
        return frame

    @cached_property
    def solids(self) -> Solids:
        """Return the bodies for kernels."""
        links, here = links_of(self.robot), pin.SE3.Identity()
        frames, others = self.frame[len(links.bodies) :], self.bodies[len(links.bodies) :]
        solids = [
            body.solid if frame < self.robot.model.njoints else solid_of(body.item, here)
            for frame, body in zip(frames, others, strict=True)
        ]
        return links.solids.with_others(Solids.of(frames, solids))

    @cached_property
    def pairs(self) -> Pairs:
        """Return the pairs for kernels."""
        moved = moved_by(self.robot)[self.joint]
        first, second = self.ends.T
        return Pairs(
            np.ascontiguousarray(self.ends),
            self.kind,
            common_joints(self.robot, self.joint[first], self.joint[second]),
            self.exact == np.arange(len(self.exact)),
            self.taken,
            np.ascontiguousarray(self.reach),
            moved[first] != moved[second],
        )

    def name(self, pair: int) -> str:
        """Return the names of both bodies of a pair, for messages."""
        first, second = self.ends[pair].tolist()
        return f"{self.bodies[first].name} and {self.bodies[second].name}"


def bodies_of(
    bases: Bases,
    arms: tuple[Arm, ...],
    carried: Carried,
    hands: Array,
    miss: float,
    *,
    holding: Sequence[Arm] | None = None,
    curve: JointCurve | None = None,
) -> Bodies:
    """Combine robot, obstacles and payload.

    Parameters
    ----------
    arms : arms in the order of the end effectors
    hands : array, shape (n_steps, n_hands, 3), positions of the end effectors [m]
    miss : largest error of the end effectors from the payload's motion [m]
    holding : arms whose end effectors hold the payload, and so have no distance from it; all holders unless given
    curve : joint positions by time [s], from which joints may deviate; any within the limits unless given
    """
    robot, scene = bases.robot, carried.motion.scene
    links, shapes = links_of(robot), load_shapes(carried)
    holders = tuple(arms[i] for i in scene.file.holder_numbers)
    held_by = holders if holding is None else tuple(holding)
    known = _bodies_for_all_motions(scene, robot, held_by, len(shapes))
    n_own, first_load = len(links.bodies), len(known.bodies) - len(known.hulls)
    rods = tuple((first_load + k, *shape.nodes) for k, shape in enumerate(shapes))
    loads = [
        _body(pin.GeometryObject(f"load {k}", 0, pin.SE3.Identity(), shape.geometry), "the load")
        for k, shape in enumerate(shapes)
    ]
    bodies = (*known.bodies[:first_load], *loads, *known.hulls)
    others = np.zeros(len(bodies) - n_own)
    base = np.concatenate([links.base, np.full(len(others), SCENE_ITSELF)])
    pull = np.concatenate([bases.pulls(links.base, links.root, links.length), others])
    pulls = [bases.of_hand(arms[i], hands[:, i]) for i in scene.file.holder_numbers]
    for rod, *_ in rods:  # a load between two bases is on neither
        base[rod] = pulls[0][0] if len({number for number, _ in pulls}) == 1 else LOAD_ALONE
        pull[rod] = payload_shift(carried, max(amount for _, amount in pulls), bases.turn)
    taken = _taken(known.ends, pull, base)
    taken[known.kind == LOAD] += miss * leverage(carried)
    strayed, e = np.zeros(len(taken)), bases.deviations
    if e is not None:
        strayed = _strayed(robot, known, e, curve)
        off, turn = shifts_of_hands(robot, holders, e, curve)
        strayed[known.kind == LOAD] += payload_shift(carried, off.max(initial=0.0), turn.max(initial=0.0))
    keep = scene.clearance if scene.file.on_robot else max(scene.clearance, ROBOT_CLEARANCE)
    return Bodies(
        robot=robot,
        bodies=bodies,
        joint=known.joint,
        ends=known.ends,
        kind=known.kind,
        required=np.array([keep, keep, min(keep, ROBOT_CLEARANCE)]),
        taken=taken,
        strayed=strayed,
        reach=known.reach,
        exact=known.exact,
        rods=rods,
        surfaces=scene.surfaces,
        moving=replace(known.moving, scene=scene),
    )


class KnownBodies(NamedTuple):
    """The bodies and pairs of all motions on a scene.

    Attributes
    ----------
    bodies : links and obstacles, which the payload's shapes follow, then the hulls of obstacles
    hulls : the latter
    joint, ends, kind, exact, reach, moving : as in `Bodies`
    """

    bodies: tuple[CollisionBody, ...]
    hulls: tuple[CollisionBody, ...]
    joint: Integers
    ends: Integers
    kind: Integers
    exact: Integers
    reach: Array
    moving: MovingObstacles


@of_geometry
def _bodies_for_all_motions(
    scene: Scene, robot: Robot, holders: tuple[Arm, ...], n_loads: int
) -> KnownBodies:
    """Return the bodies and pairs of a scene. None of the payload's shapes has a hull."""
    links, obstacles = links_of(robot), _obstacles(scene)
    n_links, n_own = robot.collision.ngeoms, len(links.bodies)
    first_load = n_own + len(obstacles)
    of_links = [k for k in range(n_links) if links.bodies[k].hull is not None]
    hulls = dict(zip(of_links, range(n_links, n_own), strict=True))
    meshes = [k for k, body in enumerate(obstacles, n_own) if body.hull is not None]
    hulls |= {mesh: first_load + n_loads + k for k, mesh in enumerate(meshes)}
    further = tuple(body.hull for body in obstacles if body.hull is not None)
    bodies = (*links.bodies, *obstacles, *further)
    numbers = [*range(first_load), *range(first_load + n_loads, len(bodies) + n_loads)]
    by_number = dict(zip(numbers, bodies, strict=True))
    moving = MovingObstacles.among(
        scene, {number: body.item for number, body in by_number.items()}, n_own, hulls
    )
    joint = np.zeros(len(bodies) + n_loads, dtype=np.int64)
    joint[:n_own] = links.joint
    reach = np.zeros((len(joint), robot.model.nv))
    reach[:n_own] = links.reach
    loads = list(range(first_load, first_load + n_loads))
    ends, kind, exact = _with_hulls(
        by_number, len(joint), hulls, *_pairs(robot, scene, range(n_own, first_load), loads, list(holders))
    )
    changes = _changes(robot, joint, reach, ends, kind, moving)
    return KnownBodies(bodies, further, joint, ends, kind, exact, changes, moving)


def links_apart(robot: Robot) -> Array:
    """Return the distance that each pair of links keeps in every scene; array, shape (n_pairs,) [m].

    Pairs are those of the robot's collision geometry; distances are as coal computes them.
    """
    links, bases = links_of(robot), Bases(robot, robot.description.uncertainty)
    pairs = np.array([(p.first, p.second) for p in robot.collision.collisionPairs], dtype=np.int64)
    pull = bases.pulls(links.base, links.root, links.length)
    return ROBOT_CLEARANCE + _taken(pairs.reshape(-1, 2), pull, links.base)


def _taken(ends: Integers, pull: Array, base: Integers) -> Array:
    """Return the largest possible error of pairs' computed distances; array, shape (n_pairs,) [m].

    Parameters
    ----------
    ends : array, shape (n_pairs, 2), numbers of both bodies
    pull : array, shape (n_bodies,), largest displacement by the tolerance of a base [m]
    base : array, shape (n_bodies,), number of the model on whose base a body is; negative for others
    """
    first, second = ends.T
    return np.where(base[first] == base[second], 0.0, pull[first] + pull[second]) + COAL_ERROR


def _strayed(robot: Robot, known: KnownBodies, deviations: Array, curve: JointCurve | None) -> Array:
    """Bound how much nearer links that deviate are to others; (n_pairs,) [m]."""
    links, moved, (first, second) = links_of(robot), moved_by(robot)[known.joint], known.ends.T
    balls = Balls(links.joint, links.solids.center, links.solids.radius, links.reach)
    levers = np.zeros((len(known.joint), robot.model.nv))
    levers[: len(links.joint)] = lever_arms(robot, balls, curve)
    return np.where(moved[first] != moved[second], levers[first] + levers[second], 0.0) @ deviations


def _pairs(
    robot: Robot, scene: Scene, obstacles: range, loads: list[int], holders: list[Arm]
) -> tuple[Integers, Integers]:
    """Return pairs of bodies, array of shape (n_pairs, 2), and their kinds.

    They are links among each other, with obstacles if a joint or the obstacle moves them past, and with the payload.
    """
    joint, in_hands = links_of(robot).joint[: robot.collision.ngeoms], list(beyond_wrists(robot, holders))
    parts = [(links_of(robot).pairs, SELF)]
    for number, moves in zip(obstacles, scene.moving, strict=True):
        parts.append((_with(np.flatnonzero(moves | (joint > 0)), number), SCENE))
    parts += [(_with(np.flatnonzero(~np.isin(joint, in_hands)), load), LOAD) for load in loads]
    kind = np.repeat([kind for _, kind in parts], [len(ends) for ends, _ in parts])
    return np.concatenate([ends for ends, _ in parts]), kind


def _with(links: Integers, other: int) -> Integers:
    return np.column_stack([links, np.full(len(links), other)])


def warn_of_buried_links(robot: Robot, scene: Scene) -> None:
    """Warn of immovable links deep in a static obstacle, which nothing checks.

    Warns
    -----
    ComoveWarning
        Names the pairs, how deep they are, and what to change.
    """
    told, obstacles = list[str](), _obstacles(scene)
    links = _links_at_rest(robot)
    still = [obstacles[i] for i in np.flatnonzero(~scene.moving).tolist()]
    for link, obstacle in _with_balls_that_meet(links, still):
        pair = [link.item.geometry, obstacle.item.geometry], [link.item.placement, obstacle.item.placement]
        if distance_of(*pair) < 0.0 and (depth := depth_of(*pair)[0]) > BURIED:
            told.append(f"{link.name} is {depth:.2g} m deep in {obstacle.name}")
    if told:
        warnings.warn(
            f"{'; '.join(told)}: no motion changes this, and it is not checked; move the obstacle, or correct "
            "where the robot's base stands",
            ComoveWarning,
            stacklevel=3,
        )


@lru_cache(maxsize=8)
def _links_at_rest(robot: Robot) -> list[CollisionBody]:
    """Return the links that no joint moves, not to be changed."""
    links = links_of(robot).bodies[: robot.collision.ngeoms]
    return [body for body in links if body.item.parentJoint == 0]


def _with_balls_that_meet(
    first: list[CollisionBody], second: list[CollisionBody]
) -> list[tuple[CollisionBody, CollisionBody]]:
    """Return the pairs of placed bodies whose bounding balls meet."""
    if not first or not second:
        return []
    (one, r), (two, s) = (
        (np.array([body.solid.center for body in some]), np.array([body.solid.radius for body in some]))
        for some in (first, second)
    )
    near = np.linalg.norm(one[:, None] - two, axis=2) < r[:, None] + s
    return [(first[i], second[k]) for i, k in np.argwhere(near).tolist()]


def _with_hulls(
    bodies: Mapping[int, CollisionBody],
    n_bodies: int,
    hulls: Mapping[int, int],
    ends: Integers,
    kind: Integers,
) -> tuple[Integers, Integers, Integers]:
    """Return pairs with hulls in place of meshes, their kinds, and `Bodies.exact`.

    Hulls replace convex meshes; the rough substitutes of other pairs come last.

    Parameters
    ----------
    bodies : bodies by their numbers, without the payload's
    hulls : numbers of hulls, by those of the meshes that they hold
    """
    convex, rough = np.arange(n_bodies), np.arange(n_bodies)
    for mesh, hull in hulls.items():
        (convex if bodies[mesh].is_convex else rough)[mesh] = hull
    ends = convex[ends]
    held = np.flatnonzero((rough[ends] != ends).any(axis=1))
    exact = np.concatenate([np.arange(len(ends)), held])
    return np.concatenate([ends, rough[ends[held]]]), kind[exact], exact


def obstacle_object(scene: Scene, i: int, name: str, time: float = 0.0) -> Any:
    """Return obstacle i at an instant [s] as a pinocchio.GeometryObject.

    At ``-scene.begins`` it is as in the file. A mesh is one of triangles.
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
    """Return which links are inside the scene's closed meshes, in words. See `links_within`."""
    names = bodies.names[len(links_of(bodies.robot).bodies) :]
    return links_within(bodies.robot, bodies.surfaces, names, joints)


def links_within(robot: Robot, surfaces: Surfaces, obstacles: Sequence[str], joints: Array) -> list[str]:
    """Return which links are inside closed meshes, in words. No triangle need be near them.

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
    """Return the joints that move links of end effectors: each arm's last one, and those beyond it."""
    lasts = {robot.grasp_frame(arm)[0] for arm in arms}
    return {joint for joint, above in enumerate(supports_of(robot)) if lasts & above}


def _hull_of(item: Any) -> tuple[Any | None, bool]:
    """Return a mesh's convex hull, if any, and whether it is equivalent."""
    mesh = item.geometry
    if not isinstance(mesh, coal.BVHModelBase) or (convex := _convex_of(mesh)) is None:
        return None, False
    name, on = f"{HULL_OF}{item.name}", (item.parentJoint, item.parentFrame, item.placement)
    return pin.GeometryObject(name, *on, convex), _is_convex(mesh)


def _convex_of(mesh: Any) -> Any | None:
    """Return the convex hull of a mesh, None where coal builds none. More than 255 edges meet at a vertex then."""
    if mesh.convex is None:
        with suppress(RuntimeError):
            mesh.buildConvexHull(True, "Qt")
    return mesh.convex


def solid_of(item: Any, placement: Any = None) -> Solid:
    """Return a pinocchio.GeometryObject for kernels, at its placement or another."""
    shape, place = item.geometry, item.placement if placement is None else placement
    shape.computeLocalAABB()
    ball = place.act(np.array(shape.aabb_center)), float(shape.aabb_radius)
    kind, points, size = _outline(shape)
    points = points @ place.rotation.T + place.translation
    return Solid(kind, points.T, np.array(size), place.rotation, place.translation, *ball)


def _outline(shape: Any) -> tuple[int, Array, tuple[float, float, float]]:
    """Return a shape's kind, points, and size; array, shape (n_points, 3). See `Solids`."""
    none = np.empty((0, 3))
    if isinstance(shape, coal.Sphere):
        return POINTS, np.zeros((1, 3)), (shape.radius, 0.0, 0.0)
    if isinstance(shape, coal.Capsule):
        return POINTS, shape.halfLength * np.array([[0, 0, -1.0], [0, 0, 1.0]]), (shape.radius, 0.0, 0.0)
    if isinstance(shape, coal.Box):
        return POINTS, np.array(list(product((-1.0, 1.0), repeat=3))) * shape.halfSide, (0.0, 0.0, 0.0)
    if isinstance(shape, coal.ConvexBase):
        return POINTS, np.array(shape.points()), (0.0, 0.0, 0.0)
    if isinstance(shape, coal.Cylinder):
        return CYLINDER, none, (shape.radius, shape.halfLength, 0.0)
    if isinstance(shape, coal.Ellipsoid):
        return ELLIPSOID, none, tuple(shape.radii)
    return OTHER, none, (0.0, 0.0, 0.0)


def depth_of(shapes: Sequence[Any], places: Sequence[Any]) -> tuple[float, bool]:
    """Compute the penetration depth of two bodies.

    Of meshes coal detects contact, not its depth; so their hulls are used.

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
            if (convex := _convex_of(shape)) is None:
                return 0.0, False
            hulls[k], is_bound = convex, is_bound or not _is_convex(shape)
    return max(0.0, -distance_of(hulls, places)), is_bound


def distance_of(shapes: Sequence[Any], places: Sequence[Any], most: float = np.inf) -> float:
    """Compute the distance of two bodies [m], negative where they meet; other arguments as in `depth_of`.

    A distance above `most` may be returned as `most` [m], which saves time with meshes.
    """
    placed = [coal.Transform3s(place.rotation, place.translation) for place in places]
    result = coal.DistanceResult()
    if 0.0 < most < result.min_distance:  # coal computes nothing where this is not positive
        result.min_distance = most
    coal.distance(shapes[0], placed[0], shapes[1], placed[1], coal.DistanceRequest(), result)
    return float(result.min_distance)


def _is_convex(mesh: Any, missing: float = 1e-3) -> bool:
    """Return whether a mesh may be replaced by its hull. They may differ by less than `missing` of its volume."""
    hull, volume = mesh.convex, mesh.convex.computeVolume()
    return mesh.num_vertices == hull.num_points and abs(mesh.computeVolume() - volume) < missing * volume


def _changes(
    robot: Robot, joint: Integers, reach: Array, ends: Integers, kind: Integers, moving: MovingObstacles
) -> Array:
    """Bound how joints, then payload, then moving obstacles change distances. Joints that move both bodies do not.

    Parameters
    ----------
    joint : array, shape (n_bodies,), joint that each body is on
    reach : array, shape (n_bodies, n_joints), reach of balls about the bodies, see `Reaches`

    Returns
    -------
    array, shape (n_pairs, n_joints + 1 + n_moving)
    """
    moved, (first, second) = moved_by(robot)[joint], ends.T
    change = np.where(moved[first] != moved[second], reach[first] + reach[second], 0.0)
    by_obstacle = moving.owns(first) + moving.owns(second)
    return np.column_stack([change, kind == LOAD, by_obstacle])


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
    def among(
        cls, scene: Scene, items: Mapping[int, Any], first: int, hulls: Mapping[int, int]
    ) -> MovingObstacles:
        """Return the moving obstacles of a scene among bodies.

        Parameters
        ----------
        items : pinocchio.GeometryObjects of the bodies, by number
        first : number of the first obstacle's body, which those of the others follow
        hulls : numbers of hulls, by those of the meshes that they hold
        """
        moving = np.flatnonzero(scene.moving)
        body = [(k, first + i) for k, i in enumerate(moving.tolist())]
        body += [(k, hulls[number]) for k, number in body if number in hulls]
        of, numbers = np.array(body, dtype=np.int64).reshape(-1, 2).T
        placed = [items[number].placement for number in numbers.tolist()]
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
        """Compute the bodies' placements at instants, array of shape (n_steps,) [s].

        Returns
        -------
        arrays, shape (n_steps, n_bodies, 3, 3) and (n_steps, n_bodies, 3) [m]
        """
        own = self.obstacle[self.of]
        turns = rotations(self.scene.turns(time)[:, own]) @ self.turn
        return turns, self.place + self.scene.offsets(time)[:, own]

    @cached_property
    def speed(self) -> Ranges:
        """Bound the speeds of moving obstacles' points from above [m/s]. Without rotation only kinks change them."""
        scene, own = self.scene, self.obstacle
        knots = np.unique([0.0, *scene.obstacle_kinks, scene.duration])
        middle = 0.5 * (knots[1:] + knots[:-1])  # rounding must not take the velocity before a kink
        speeds = np.linalg.norm(scene.obstacle_velocities(middle)[:, own], axis=2)
        return Ranges(knots, np.where(scene.turning[own], scene.obstacle_speeds[own], speeds))
