"""An independent judge of links: Pinocchio on the raw URDFs of a robot, obstacles by `tests.brute_force`.

Of comove it takes where the files are, and what the description says of bases, prefixes, tools and joints that do not
move: no reader, merged model, body or distance. What a description adds to the files, such as grippers, is left out.
"""

from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from comove.robots.urdf import package_folders
from tests.brute_force import placed

SHAPES = {
    "box": lambda o: coal.Box(*o.size),
    "sphere": lambda o: coal.Sphere(o.radius),
    "capsule": lambda o: coal.Capsule(o.radius, o.length),
    "cylinder": lambda o: coal.Cylinder(o.radius, o.height),
}


class Part(NamedTuple):
    """One file of a robot: its base, its joints as the robot and as Pinocchio number them, and joints at rest."""

    base: Any
    prefix: str
    model: Any
    data: Any
    bodies: Any
    own: list
    joints: list
    rest: Any

    def whole(self, q):
        """Pinocchio's configuration of joints q, array of shape (n_joints,)."""
        full = self.rest.copy()
        for joint, value in zip(self.joints, np.asarray(q)[self.own], strict=True):
            _turn(full, joint, value)
        return full


class RawLinks:
    """The links of a robot as its files have them."""

    def __init__(self, robot):
        self.arms, self.parts = robot.description.arms, []
        for part, source in zip(robot.description.models, robot.sources, strict=True):
            model, file = pin.buildModelFromUrdf(str(source.file)), str(source.file)
            bodies = pin.buildGeomFromUrdf(
                model, file, pin.GeometryType.COLLISION, package_dirs=package_folders(source.file)
            )
            for item in bodies.geometryObjects:
                item.geometry.computeLocalAABB()
            named = [name.removeprefix(part.prefix) for name in robot.joint_names]
            own = [
                k
                for k, name in enumerate(robot.joint_names)
                if name.startswith(part.prefix) and model.existJointName(named[k])
            ]
            joints = [model.joints[model.getJointId(named[k])] for k in own]
            rest = pin.neutral(model)
            for name, value in robot.description.posture.items():
                joint = name.removeprefix(part.prefix)
                if name.startswith(part.prefix) and model.existJointName(joint):
                    _turn(rest, model.joints[model.getJointId(joint)], value)
            at = _pose(part.base), part.prefix
            self.parts.append(Part(*at, model, model.createData(), bodies, own, joints, rest))

    def frame(self, name, q):
        """The pose of a frame of the files, by its name with prefix; q, array of shape (n_joints,)."""
        part, frame = self._find(name)
        pin.framesForwardKinematics(part.model, part.data, part.whole(q))
        return part.base * part.data.oMf[frame]

    def grasp(self, arm, q):
        """The pose of an arm's grasp frame."""
        return self.frame(self.arms[arm].tip, q) * _pose(self.arms[arm].tool)

    def grasp_jacobian(self, arm, q):
        """The twist of an arm's grasp frame, in it, per velocity of each joint; array, shape (6, n_joints)."""
        part, frame = self._find(self.arms[arm].tip)
        slopes = pin.computeFrameJacobian(part.model, part.data, part.whole(q), frame)
        found = np.zeros((6, len(q)))
        found[:, part.own] = (
            _pose(self.arms[arm].tool).inverse().action @ slopes[:, [joint.idx_v for joint in part.joints]]
        )
        return found

    def _find(self, name):
        """The part in which a frame is, and its number there."""
        for part in self.parts:
            own = name.removeprefix(part.prefix)
            if name.startswith(part.prefix) and part.model.existFrame(own):
                return part, part.model.getFrameId(own)
        raise KeyError(name)

    def bodies(self, q):
        """Name, geometry, pose, and whether a joint moves it, of each body."""
        found = []
        for part in self.parts:
            at = part.bodies.createData()
            pin.updateGeometryPlacements(part.model, part.data, part.bodies, at, part.whole(q))
            for item, pose in zip(part.bodies.geometryObjects, at.oMg, strict=True):
                found.append((part.prefix + item.name, item.geometry, part.base * pose, item.parentJoint > 0))
        return found

    def distances(self, obstacles, time, joints, within=np.inf):
        """The distance of each body from obstacles of a scene file, at instants, as these move then.

        Array, shape (n_times, n_obstacles, n_bodies) [m]; infinite where neither ever moves, and a lower bound where
        the balls around both are further apart than `within`.
        """
        things = [(SHAPES[one.shape](one), one, *placed(one, time)) for one in obstacles]
        for thing, *_ in things:
            thing.computeLocalAABB()
        found = np.full((len(time), len(things), len(self.bodies(joints[0]))), np.inf)
        for k, q in enumerate(joints):
            for b, (_, geometry, pose, moves) in enumerate(self.bodies(q)):
                at = coal.Transform3s(pose.rotation, pose.translation)
                middle = pose.act(geometry.aabb_center)
                for i, (thing, one, turns, centers) in enumerate(things):
                    if not moves and one.motion is None:
                        continue
                    there = coal.Transform3s(turns[k], centers[k])
                    apart = np.linalg.norm(middle - centers[k]) - geometry.aabb_radius - thing.aabb_radius
                    if apart <= within:
                        asked, answer = coal.DistanceRequest(), coal.DistanceResult()
                        apart = coal.distance(geometry, at, thing, there, asked, answer)
                    found[k, i, b] = apart
        return found


def _turn(full, joint, value):
    """Write a joint's value into Pinocchio's configuration; one that turns without end is its cosine and sine."""
    full[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else [np.cos(value), np.sin(value)]


def _pose(placement):
    return pin.SE3(pin.Quaternion(*placement.quaternion_wxyz).matrix(), np.array(placement.position))
