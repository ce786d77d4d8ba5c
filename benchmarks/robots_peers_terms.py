"""Requirements of two-arm transfer motions for all peers, and their verification.

The payload is fixed to the first end effector, the second is constrained to the first, and both stay as level as
they are at the start. Kinematics are Pinocchio's, contacts coal's.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from comove.model import Scene
from comove.model.files.keys import UNTURNED
from comove.model.motion import CoordinatedMotion
from comove.robots import Robot, RobotCarrier
from comove.robots.description import Placement
from comove.robots.urdf import for_pinocchio
from comove.robots.verification.bodies import Bodies, bodies_of
from comove.robots.verification.carried import Carried, placements
from comove.robots.verification.kinematics import Bases

Array = NDArray[np.float64]

BUDGET, EACH = 10.0, 2.0  # s, for a scene, and for one pair of joints at its ends
TOLERANCE = 1e-3, 5e-3  # m, rad, by which hands may be off
ROOM = 5e-3  # m, by which a load may leave its workspace
N_SAMPLES = 1000


@dataclass(frozen=True)
class Outcome:
    """Result of a system: joints at even times in unit duration. They have the shape (N_SAMPLES, n_joints), and are
    None without a result. `first` is the time to the first valid path, `whole` to the result [s of the processor];
    `verified` whether comove's own verification succeeds."""

    joints: Array | None
    first: float
    whole: float
    verified: bool = False


class Terms:
    """Scene as a problem for peers.

    Attributes
    ----------
    arms : the two arms that hold the payload
    columns : array, shape (n_free,), their joints among the robot's
    ends : pairs of joints of the whole robot at start and goal, the solutions of comove, the likeliest first
    lower, upper : arrays, shape (3,), range of end effectors that keeps the payload in its workspace [m]
    """

    def __init__(self, scene: Scene, robot: Robot, carrier: RobotCarrier):
        self.scene, self.robot, self.arms = scene, robot, carrier.holders[:2]
        self.columns = np.concatenate([arm.columns for arm in carrier.holders])
        self.ends = [(self.whole(start), self.whole(goal)) for start, goal in carrier._pairs]
        nodes, count = scene.nodes_at("start"), len(scene.manipulators)
        beyond = np.linalg.norm(nodes[:, None] - nodes[None, :count], axis=2).min(axis=1).max()
        inset = float(scene.body.radii.max()) + np.array([beyond, beyond, 0.0])
        self.lower, self.upper = scene.lower + inset, scene.upper - inset

    def whole(self, q: Array) -> Array:
        """Return the joints of the whole robot, shape (n_joints,)."""
        whole = self.robot.home
        whole[self.columns] = q
        return whole

    def load_on_hand(self, q: Array) -> Array:
        """Return payload nodes in the first end effector, (4, n_nodes) [m]."""
        nodes = self.scene.nodes_at("start").T
        return np.linalg.inv(self.robot.tool_pose(q, self.arms[0])) @ np.vstack(
            [nodes, np.ones(nodes.shape[1])]
        )

    @cached_property
    def bodies(self) -> Bodies:
        """Return the exact bodies of robot, obstacles and payload."""
        carried = Carried(CoordinatedMotion.straight(self.scene))
        bases = Bases(self.robot, self.robot.description.uncertainty)
        return bodies_of(bases, self.arms, carried, self.scene.start[None], 0.0)

    @cached_property
    def contacts(self) -> Contacts:
        """Return the contact queries of coal."""
        return Contacts(self.bodies)


class Contacts:
    """Contacts of the bodies of robot, payload and obstacles. Hulls of meshes are checked first."""

    def __init__(self, known: Bodies):
        self.known, self.geometry = known, known.geometry.copy()
        obstacles = [k for k, name in enumerate(known.names) if name.startswith("obstacles[")]
        own = np.arange(len(known.exact))
        stand_ins = known.exact != own
        in_rough = stand_ins | ~np.isin(own, known.exact[stand_ins])
        for rod, *_ in known.rods:
            for obstacle in obstacles:
                self.geometry.addCollisionPair(pin.CollisionPair(rod, obstacle))
        self.data = known.robot.model.createData()
        self.rough, self.exact = self.geometry.createData(), self.geometry.createData()
        for pairs, without in ((self.rough, ~in_rough), (self.exact, stand_ins)):
            for number in np.flatnonzero(without).tolist():
                pairs.deactivateCollisionPair(number)

    def touch(self, q: Array, nodes: Array) -> bool:
        """Return whether anything touches. The shapes are q (n_joints,), nodes of the payload (n_nodes, 3) [m]."""
        return self._any(self.rough, q, nodes) and self._any(self.exact, q, nodes)

    def _any(self, pairs: Any, q: Array, nodes: Array) -> bool:
        pin.updateGeometryPlacements(self.known.robot.model, self.data, self.geometry, pairs, q)
        for rod, *spanned in self.known.rods:
            (rotation,), (middle,) = placements(nodes[None], tuple(spanned))
            pairs.oMg[rod] = pin.SE3(rotation, middle)
        return bool(pin.computeCollisions(self.geometry, pairs, True))


def flaws(terms: Terms, joints: Array) -> str:
    """Return a motion's violations at its samples in words, if any."""
    scene, robot, arms = terms.scene, terms.robot, terms.arms
    nodes, off = terms.load_on_hand(joints[0]), np.zeros(2)
    held = [robot.tool_pose(joints[0], arm) for arm in arms]
    apart = np.linalg.inv(np.linalg.inv(held[0]) @ held[1])
    if (joints < robot.lower - 1e-9).any() or (joints > robot.upper + 1e-9).any():
        return "limits"
    for q in joints:
        poses = [robot.tool_pose(q, arm) for arm in arms]
        error = apart @ np.linalg.inv(poses[0]) @ poses[1]
        turn = Rotation.from_matrix(error[:3, :3]).magnitude()
        off = np.maximum(off, [np.linalg.norm(error[:3, 3]), turn])
        here = (poses[0] @ nodes)[:3].T
        if (here < scene.lower - ROOM).any() or (here > scene.upper + ROOM).any():
            return "out of the workspace"
        if terms.contacts.touch(q, here):
            return "contact"
    return "" if (off <= TOLERANCE).all() else f"hands off by {1e3 * off[0]:.1f} mm, {1e3 * off[1]:.1f} mrad"


def element(tag: str, /, **attributes: str) -> ET.Element:
    """Return an element of a URDF."""
    return ET.Element(tag, attributes)


def fixed(name: str, parent: str, child: str, pose: Array) -> ET.Element:
    """Return a fixed joint at a pose, array of shape (4, 4)."""
    joint = element("joint", name=name, type="fixed")
    x, y, z = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz").tolist()
    origin = element("origin", xyz=" ".join(map(repr, pose[:3, 3].tolist())), rpy=f"{x!r} {y!r} {z!r}")
    joint.extend([element("parent", link=parent), element("child", link=child), origin])
    return joint


def placed(base: Placement) -> Array:
    """Return the pose of a base; array, shape (4, 4)."""
    return pose(base.position, base.quaternion_wxyz)


def pose(position: Any, quaternion_wxyz: Any) -> Array:
    """Return a pose as a Fortran-ordered array, shape (4, 4)."""
    found = np.asfortranarray(np.eye(4))
    found[:3, :3] = Rotation.from_quat(quaternion_wxyz, scalar_first=True).as_matrix()
    found[:3, 3] = position
    return found


def pose_of(obstacle: Any) -> Array:
    """Return the pose of an obstacle as an array, shape (4, 4); a ball has no orientation."""
    return pose(obstacle.center, getattr(obstacle, "quaternion_wxyz", UNTURNED))


def as_one_urdf(terms: Terms, folder: Path, *, loaded: bool) -> ET.Element:
    """Return one URDF of all models with payload and grasps. It has a link `grasp_ARM` for every end effector, and
    the payload on the first if `loaded`. Joints outside the robot stay at 0. Changed meshes are written into the
    folder."""
    robot, whole = terms.robot, element("robot", name="both")
    whole.append(element("link", name="world"))
    for k, source in enumerate(robot.sources):
        own = folder / str(k)
        own.mkdir()
        model = ET.fromstring(for_pinocchio(source, own))
        children = {joint.find("child").get("link") for joint in model.findall("joint")}
        (root,) = (link.get("name") for link in model.findall("link") if link.get("name") not in children)
        for joint in model.findall("joint"):
            if joint.get("type") != "fixed" and joint.get("name") not in robot.joint_names:
                joint.set("type", "fixed")
                for part in joint.findall("mimic"):
                    joint.remove(part)
        whole.extend(list(model))
        whole.append(fixed(f"base {k}", "world", root, placed(source.base)))
    for arm in terms.arms:
        whole.append(element("link", name=f"grasp_{arm.name}"))
        whole.append(fixed(f"to_{arm.name}", arm.tip, f"grasp_{arm.name}", arm.tool))
    if loaded:
        whole.extend(_load(terms))
    return whole


def _load(terms: Terms) -> list[ET.Element]:
    """Return the bar as a link on the first end effector."""
    nodes, body = terms.load_on_hand(terms.ends[0][0])[:3].T, terms.scene.body
    ends = nodes[np.unique(body.edges)]
    far = np.linalg.norm(ends[:, None] - ends[None], axis=2)
    a, b = ends[list(np.unravel_index(far.argmax(), far.shape))]
    turned = Rotation.align_vectors((b - a)[None], [[0.0, 0.0, 1.0]])[0].as_quat(scalar_first=True)
    link, collision, geometry = element("link", name="load"), element("collision"), element("geometry")
    size = {"radius": repr(float(body.radii.max())), "length": repr(float(far.max()))}
    geometry.append(element("cylinder", **size))
    collision.append(geometry)
    link.append(collision)
    return [link, fixed("holds", f"grasp_{terms.arms[0].name}", "load", pose(0.5 * (a + b), turned))]


def links_of(robot: Robot) -> list[str]:
    """Return the link of every body of a robot."""
    return [item.name.rpartition("_")[0] for item in robot.collision.geometryObjects]


def left_out(terms: Terms) -> list[tuple[str, str]]:
    """Return the pairs of links that may collide. They include the payload with links beyond wrists."""
    robot, links = terms.robot, links_of(terms.robot)
    compared = {frozenset((links[p.first], links[p.second])) for p in robot.collision.collisionPairs}
    names = sorted(set(links))
    pairs = [(a, b) for k, a in enumerate(names) for b in names[:k] if frozenset((a, b)) not in compared]
    lasts = {int(arm.columns[-1]) + 1 for arm in terms.arms}
    items = zip(links, robot.collision.geometryObjects, strict=True)
    holding = [link for link, item in items if lasts & set(robot.model.supports[item.parentJoint])]
    return pairs + [("load", link) for link in dict.fromkeys(holding)]


def standing(robot: Robot) -> list[str]:
    """Return the links with static bodies."""
    items = list(zip(links_of(robot), robot.collision.geometryObjects, strict=True))
    return sorted({link for link, _ in items} - {link for link, item in items if item.parentJoint != 0})
