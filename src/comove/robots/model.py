"""A robot as its models tell it: kinematics, limits, collision geometry, by Pinocchio."""

from __future__ import annotations

import hashlib
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.errors import ExtraError, RobotError, near_name
from comove.primitives.rotations import matrices
from comove.robots.description import (
    ArmDescription,
    JointLimits,
    ModelSource,
    Placement,
    RobotFile,
    find_description,
    load_description,
)

try:
    import pinocchio as pin
except ImportError as error:  # the extra is not installed
    raise ExtraError("a robot", "robot") from error

Array = NDArray[np.float64]

MESHES = {".stl", ".dae", ".obj", ".ply"}
MOVING = ("revolute", "continuous", "prismatic")
MAX_BYTES = 20_000_000


@dataclass(frozen=True, eq=False)
class Arm:
    """One arm of a robot.

    Attributes
    ----------
    name : that of the manipulator it is
    tip : frame of the model
    columns : array, shape (n_joints,), where its joints stand in the robot's vector
    tool : array, shape (4, 4), the grasp frame in the tip frame
    home : array, shape (n_joints,) [rad]
    fingers : names of joints that close on the load
    """

    name: str
    tip: str
    columns: NDArray[np.int64]
    tool: Array
    home: Array
    fingers: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Robot:
    """One or several manipulators, their joints in one vector q, array of shape (n_joints,).

    Attributes
    ----------
    description : what it was made from
    model : pinocchio.Model of the moving joints; all others are locked
    collision : pinocchio.GeometryModel with the pairs that can collide
    arms : in the description's order
    lower, upper : arrays, shape (n_joints,) [rad, m for prismatic joints]
    velocity, acceleration, effort : limits, arrays, shape (n_joints,) [rad/s, rad/s^2, N m]
    relief : array, shape (n_joints,), share of the own weight's torque that springs hold
    sha256 : of the description, the models and the meshes they collide with
    sources : the models' texts (URDF), completed and prefixed, with their placements
    """

    description: RobotFile
    model: Any
    collision: Any
    arms: tuple[Arm, ...]
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    effort: Array
    relief: Array
    sha256: str
    sources: tuple[Source, ...]

    @classmethod
    def load(cls, robot: str | Path, folder: Path | None = None) -> Robot:
        """Load a robot by the name of a bundled description or the path of one.

        Raises
        ------
        RobotError
            If the description, a model or a mesh is missing or does not fit.
        """
        path = find_description(robot, folder)
        return _assemble(load_description(path), path)

    @property
    def name(self) -> str:
        """Of the description."""
        return self.description.name

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Of the moving joints, in the order of q."""
        return tuple(self.model.names[1:])

    @property
    def home(self) -> Array:
        """All arms at home; array, shape (n_joints,) [rad]."""
        q = np.zeros(len(self.lower))
        for arm in self.arms:
            q[arm.columns] = arm.home
        return q

    def arm(self, name: str) -> Arm:
        """The arm of a manipulator's name.

        Raises
        ------
        RobotError
            If the robot has none of that name.
        """
        for arm in self.arms:
            if arm.name == name:
                return arm
        names = [arm.name for arm in self.arms]
        raise RobotError(
            f"the robot '{self.name}' has no arm '{name}'", key="manipulators", way_out=near_name(name, names)
        )

    def tool_pose(self, q: Array, arm: Arm) -> Array:
        """The arm's grasp frame in the scene; array, shape (4, 4)."""
        data = self._data
        pin.framesForwardKinematics(self.model, data, np.asarray(q, dtype=float))
        return data.oMf[self.model.getFrameId(arm.tip)].homogeneous @ arm.tool

    @cached_property
    def _data(self) -> Any:
        return self.model.createData()


@dataclass(frozen=True)
class Source:
    """A model as it was read: its URDF, where its base stands, the folder of each package it names."""

    urdf: str
    base: Placement
    file: Path


def package_folders(file: Path) -> list[str]:
    """Where ``package://NAME/`` is looked for: beside the description, in ROS's path, in installed data."""
    folders = [str(file.parent)]
    folders += [part for part in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if part]
    try:
        import cmeel_pth
    except ImportError:
        return folders
    return [*folders, str(Path(cmeel_pth.__file__).parent / "cmeel.prefix" / "share")]


def resolve(uri: str, file: Path) -> Path:
    """The path that a URI in a description or a model means.

    Raises
    ------
    RobotError
        If there is no such file.
    """
    tail = re.sub(r"^(package|file)://", "", uri)
    folders = package_folders(file) if uri.startswith("package://") else [str(file.parent)]
    for folder in folders:
        path = Path(folder) / tail
        if path.is_file():
            return path
    looked = ", ".join(folders)
    raise RobotError(
        f"there is no file '{uri}'",
        file=file,
        way_out=f"correct the path or install the package; looked in {looked}",
    )


def _assemble(description: RobotFile, file: Path) -> Robot:
    digest = hashlib.sha256(description.model_dump_json().encode())
    model, collision, sources = None, None, []
    known: set[str] = set()
    for source in description.models:
        urdf, srdf = _read(source, description, file, digest)
        placement = _se3(source.base)
        part, geometry = _build(urdf, srdf, resolve(source.urdf, file), file)
        known |= set(part.names[1:])
        sources.append(Source(urdf, source.base, resolve(source.urdf, file)))
        if model is None:
            _move_base(part, geometry, placement)
            model, collision = part, geometry
        else:
            twice = set(model.names[1:]) & set(part.names[1:])
            if twice:
                raise RobotError(
                    f"two models have a joint '{min(twice)}'",
                    file=file,
                    key="models",
                    way_out="give one a prefix",
                )
            model, collision = pin.appendModel(model, part, collision, geometry, 0, placement)
    _require_known(description.posture, known, "posture", file)
    _require_known(description.limits, known, "limits", file)
    _require_known(description.springs, known, "springs", file)
    moving = _moving_joints(description, model, file)
    return _reduced(description, model, collision, moving, sources, digest.hexdigest(), file)


def _read(source: ModelSource, description: RobotFile, file: Path, digest: Any) -> tuple[str, str | None]:
    """Text of a URDF with limits filled in and names prefixed, and of its SRDF."""
    path = resolve(source.urdf, file)
    tree = _xml(path, file)
    if tree.tag != "robot":
        raise RobotError(f"it is a <{tree.tag}>, not a <robot>", file=path, way_out="name a URDF")
    joints = {
        f"{source.prefix}{j.get('name')}": j for j in tree.iter("joint") if j.find("parent") is not None
    }
    arms = {part for arm in description.arms.values() for part in arm.fingers}
    for name, joint in joints.items():
        if joint.get("type") in MOVING and name not in description.posture and name not in arms:
            _fill_limits(joint, name, description.limits.get(name))
    for mesh in tree.findall("./link/collision/geometry/mesh"):
        named = mesh.get("filename", "")
        if Path(named).suffix.lower() not in MESHES:
            raise RobotError(
                f"the mesh '{named}' has an unknown format",
                file=path,
                way_out=f"convert it to one of {', '.join(sorted(MESHES))}",
            )
        digest.update(resolve(named, path if not named.startswith("package://") else file).read_bytes())
    srdf = None
    if source.srdf is not None:
        srdf = resolve(source.srdf, file).read_text(encoding="utf-8")
        digest.update(srdf.encode())
    if source.prefix:
        for link in tree.findall("./link"):
            link.set("name", source.prefix + link.get("name", ""))
        for joint in joints.values():
            joint.set("name", source.prefix + joint.get("name", ""))
            for end in ("parent", "child"):
                joint.find(end).set("link", source.prefix + joint.find(end).get("link", ""))
            if (mimic := joint.find("mimic")) is not None:
                mimic.set("joint", source.prefix + mimic.get("joint", ""))
        if srdf is not None:
            srdf = re.sub(r'(link[12]=")', rf"\g<1>{source.prefix}", srdf)
    urdf = ET.tostring(tree, encoding="unicode")
    digest.update(urdf.encode())
    return urdf, srdf


def _xml(path: Path, file: Path) -> ET.Element:
    if path.stat().st_size > MAX_BYTES:
        raise RobotError("it is larger than 20 MB", file=path, way_out="name a URDF")
    text = path.read_text(encoding="utf-8", errors="replace")
    if "<!ENTITY" in text:
        raise RobotError("it defines entities", file=path, way_out="write them out")
    try:
        return ET.fromstring(text)
    except ET.ParseError as error:
        way_out = "expand it by xacro first" if path.suffix == ".xacro" else "correct it"
        raise RobotError(f"it is no XML: {error}", file=path, way_out=way_out) from error


def _fill_limits(joint: ET.Element, name: str, given: JointLimits | None) -> None:
    """Write the description's limits into a joint; a turning joint without limits becomes a limited one."""
    values = {} if given is None else given.model_dump(exclude_none=True, exclude={"acceleration"})
    limit = joint.find("limit")
    if limit is None:
        if not values:
            return
        limit = ET.SubElement(joint, "limit")
    for key, value in values.items():
        limit.set(key, repr(value))
    if joint.get("type") == "continuous" and "lower" in values and "upper" in values:
        joint.set("type", "revolute")


def _build(urdf: str, srdf: str | None, path: Path, file: Path) -> tuple[Any, Any]:
    try:
        model = pin.buildModelFromXML(urdf)
        geometry = pin.buildGeomFromUrdfString(
            model,
            urdf,
            pin.GeometryType.COLLISION,
            package_dirs=[str(path.parent), *package_folders(file)],
        )
        geometry.addAllCollisionPairs()
        _drop_adjacent(model, geometry)
        if srdf is not None:
            pin.removeCollisionPairsFromXML(model, geometry, srdf, False)
    except (ValueError, RuntimeError, IndexError) as error:
        reason = str(error).strip().splitlines()[-1] if str(error).strip() else type(error).__name__
        raise RobotError(
            f"the model cannot be built: {reason}", file=path, way_out="correct the URDF"
        ) from error
    return model, geometry


def _drop_adjacent(model: Any, geometry: Any) -> None:
    """Forget pairs of bodies that one joint connects: they touch where they are joined."""
    objects = geometry.geometryObjects
    for pair in [pin.CollisionPair(p.first, p.second) for p in geometry.collisionPairs]:
        i, j = objects[pair.first].parentJoint, objects[pair.second].parentJoint
        if i == j or model.parents[i] == j or model.parents[j] == i:
            geometry.removeCollisionPair(pair)


def _drop_rigid(geometry: Any) -> None:
    """Forget pairs of bodies that have become one by locking joints."""
    objects = geometry.geometryObjects
    for pair in [pin.CollisionPair(p.first, p.second) for p in geometry.collisionPairs]:
        if objects[pair.first].parentJoint == objects[pair.second].parentJoint:
            geometry.removeCollisionPair(pair)


def _move_base(model: Any, geometry: Any, placement: Any) -> None:
    for joint in range(1, model.njoints):
        if model.parents[joint] == 0:
            model.jointPlacements[joint] = placement * model.jointPlacements[joint]
    for frame in list(model.frames)[1:]:  # all but the universe's own
        if frame.parentJoint == 0:
            frame.placement = placement * frame.placement
    for item in geometry.geometryObjects:
        if item.parentJoint == 0:
            item.placement = placement * item.placement


def _se3(placement: Placement) -> Any:
    return pin.SE3(matrices(np.array(placement.quaternion_wxyz)), np.array(placement.position))


def _require_known(named: Iterable[str], known: set[str], key: str, file: Path) -> None:
    for name in named:
        if name not in known:
            raise RobotError(
                f"there is no joint '{name}' in the models",
                file=file,
                key=key,
                way_out=near_name(name, sorted(known)),
            )


def _moving_joints(description: RobotFile, model: Any, file: Path) -> dict[str, list[str]]:
    """Joints of each arm from its base to its tip, those that stay apart."""
    still = set(description.posture)
    chains: dict[str, list[str]] = {}
    for name, arm in description.arms.items():
        tip = model.getFrameId(arm.tip)
        if tip >= model.nframes:
            raise RobotError(
                f"there is no frame '{arm.tip}'",
                file=file,
                key=f"arms.{name}.tip",
                way_out=near_name(arm.tip, [frame.name for frame in model.frames]),
            )
        _require_known(arm.fingers, set(model.names[1:]), f"arms.{name}.fingers", file)
        supports = [j for j in model.supports[model.frames[tip].parentJoint] if j > 0]
        chain = [model.names[j] for j in supports if model.names[j] not in still]
        for other, joints in chains.items():
            if shared := set(joints) & set(chain):
                raise RobotError(
                    f"the arms '{other}' and '{name}' share the joint '{min(shared)}'",
                    file=file,
                    key="posture",
                    way_out=f"say where it stays: posture: {{{min(shared)}: 0}}",
                )
        if not chain:
            raise RobotError(
                f"no joint moves the frame '{arm.tip}'",
                file=file,
                key=f"arms.{name}.tip",
                way_out="name another",
            )
        chains[name] = chain
    if not chains:
        raise RobotError("no arm is named", file=file, key="arms", way_out="name one: {left: {tip: FRAME}}")
    return chains


def _reduced(
    description: RobotFile,
    model: Any,
    collision: Any,
    chains: dict[str, list[str]],
    sources: list[Source],
    sha256: str,
    file: Path,
) -> Robot:
    """The robot with every joint but the arms' locked."""
    posture = pin.neutral(model)
    moving = {joint for chain in chains.values() for joint in chain}
    for name, value in description.posture.items():
        joint = model.joints[model.getJointId(name)]
        if joint.nq == 1:
            posture[joint.idx_q] = value
    locked = [j for j in range(1, model.njoints) if model.names[j] not in moving]
    for name in moving:
        joint = model.joints[model.getJointId(name)]
        if joint.nq != 1 or joint.nv != 1:
            raise RobotError(
                f"the joint '{name}' has no limits",
                file=file,
                key="limits",
                way_out=f"give them: limits: {{{name}: {{lower: -3, upper: 3}}}}",
            )
    reduced, geometry = pin.buildReducedModel(model, collision, locked, posture)
    _drop_rigid(geometry)
    limits = {
        "lower": np.array(reduced.lowerPositionLimit),
        "upper": np.array(reduced.upperPositionLimit),
        "velocity": np.array(reduced.velocityLimit),
        "effort": np.array(reduced.effortLimit),
        "acceleration": np.array(
            [_acceleration(description, name) for name in list(reduced.names)[1:]], dtype=float
        ),
    }
    for i, name in enumerate(list(reduced.names)[1:]):
        for key, values in limits.items():
            wrong = not np.isfinite(values[i]) or (key not in ("lower", "upper") and not 0 < values[i] < 1e6)
            if wrong or not limits["lower"][i] < limits["upper"][i]:
                raise RobotError(
                    f"the joint '{name}' has the {key} limit {values[i]:g}",
                    file=file,
                    key="limits",
                    way_out=f"give it: limits: {{{name}: {{{key}: ...}}}}",
                )
    names = list(reduced.names)[1:]
    arms = tuple(
        _arm(name, arm, np.array([names.index(j) for j in chains[name]]), limits, file)
        for name, arm in description.arms.items()
    )
    relief = np.array([description.springs.get(name, 0.0) for name in names])
    return Robot(
        description, reduced, geometry, arms, **limits, relief=relief, sha256=sha256, sources=tuple(sources)
    )


def _arm(
    name: str, arm: ArmDescription, columns: NDArray[np.int64], limits: dict[str, Array], file: Path
) -> Arm:
    lower, upper = limits["lower"][columns], limits["upper"][columns]
    home = np.clip(0.0, lower, upper) if arm.home is None else np.array(arm.home)
    if len(home) != len(columns):
        raise RobotError(
            f"home has {len(home)} values, the arm {len(columns)} joints",
            file=file,
            key=f"arms.{name}.home",
            way_out="give one value a joint, from the base to the tip",
        )
    outside = (home < lower) | (home > upper)
    if outside.any():
        raise RobotError(
            f"joint {int(outside.argmax()) + 1} is at {home[outside][0]:g} at home, outside its limits",
            file=file,
            key=f"arms.{name}.home",
            way_out=f"keep it between {lower[outside][0]:g} and {upper[outside][0]:g}",
        )
    return Arm(name, arm.tip, columns, _se3(arm.tool).homogeneous, home, tuple(arm.fingers))


def _acceleration(description: RobotFile, name: str) -> float:
    given = description.limits.get(name)
    return description.acceleration if given is None or given.acceleration is None else given.acceleration
