"""Robot model built from a description by Pinocchio: kinematics, limits and collision geometry."""

from __future__ import annotations

import hashlib
import sysconfig
import tempfile
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import coal
import numpy as np
import pinocchio as pin

from comove.arrays import Array, Integers
from comove.brief import brief
from comove.errors import ComoveWarning, RobotError, near_name
from comove.robots.description import (
    BUNDLED,
    ArmDescription,
    RobotFile,
    errors_in,
    find_description,
    load_description,
)
from comove.robots.formats import GroupState, Srdf
from comove.robots.further_limits import FurtherLimits, in_radians_or_metres
from comove.robots.masses import mass_beyond, masses_of, moved_masses, with_guessed_masses
from comove.robots.soundness import ends_of
from comove.robots.urdf import OF_JOINT, Mimic, Source, errors_of_reader, for_pinocchio, read_source

LARGEST_BODY = 50.0  # m, radius of a collision body
FREEDOMS = 6  # of a hand's pose
LARGEST_LIMIT = 1e6  # rad, m, s, N m or N


@dataclass(frozen=True, eq=False)
class Arm:
    """One arm of a robot.

    Attributes
    ----------
    name : name of the manipulator in a scene
    tip : name of the arm's last frame in the model
    columns : array, shape (n_joints,), indices of the arm's joints in the robot's joint vector q
    tool : array, shape (4, 4), the grasp frame in the tip frame
    home : array, shape (n_joints,), joint positions at home [rad, m for prismatic joints]
    fingers : names of joints that close on the payload
    payload : mass that it is rated for, infinite where none is stated [kg]
    hand : mass of the links beyond that of its last joint, which counts as payload [kg]
    """

    name: str
    tip: str
    columns: Integers
    tool: Array
    home: Array
    fingers: tuple[str, ...]
    payload: float = np.inf
    hand: float = 0.0


# Robots in use, by description and checksum: who loads one again gets it with all that was computed for it.
_LOADED: WeakValueDictionary[tuple[Path, str, str], Robot] = WeakValueDictionary()


@dataclass(frozen=True, eq=False)
class Robot:
    """One or several manipulators with one joint vector q, shape (n_joints,).

    Attributes
    ----------
    description : RobotFile from which the robot was built; its posture names all joints that do not move
    model : pinocchio.Model of the moving joints; all others are locked
    collision : pinocchio.GeometryModel with the pairs that can collide
    arms : the arms, in the order of the description
    lower, upper : position limits, soft ones included, arrays, shape (n_joints,) [rad, m for prismatic joints]
    velocity, acceleration, effort : limits, arrays, shape (n_joints,) [rad/s, rad/s^2, N m]
    jerk : likewise, infinite where none is stated [rad/s^3]
    approach : array, shape (n_joints,), least time constant with which a joint approaches its position limits: q +
        approach q' stays within them [s]; 0 where none is stated
    relief : array, shape (n_joints,), share of the torque due to the robot's own weight that springs hold
    sha256 : checksum of the description, the models and their collision meshes
    sources : URDF texts of the models, with limits and prefixes filled in, and their placements
    """

    __repr__ = brief

    description: RobotFile
    model: Any
    collision: Any
    arms: tuple[Arm, ...]
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    effort: Array
    jerk: Array
    approach: Array
    relief: Array
    sha256: str
    sources: tuple[Source, ...]

    @property
    def files(self) -> tuple[Path, ...]:
        """Return the robot's files without those of installed packages."""
        installed = [BUNDLED, *(Path(sysconfig.get_paths()[kind]) for kind in ("purelib", "platlib"))]
        read = dict.fromkeys(path for source in self.sources for path in source.files)
        return tuple(path for path in read if not any(path.is_relative_to(place) for place in installed))

    @classmethod
    def load(cls, robot: str | Path, folder: Path | None = None) -> Robot:
        """Load a robot by the name or path of its description.

        Raises
        ------
        RobotError
            If the description, a model or a mesh is missing or does not fit.
        """
        path = find_description(robot, folder)
        loaded = assembled(load_description(path), path)
        with errors_in(path):
            _require_grippers_apart(loaded)
        return _LOADED.setdefault((path, loaded.sha256, repr(loaded.description.ros)), loaded)

    @property
    def name(self) -> str:
        """Return the name of the description."""
        return self.description.name

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Return the names of the moving joints, in the order of q."""
        return tuple(self.model.names[1:])

    def resting(self, joints: Array) -> Robot:
        """Return the robot with other joints for home, array, shape (n_joints,) [rad]."""
        return replace(self, arms=tuple(replace(arm, home=joints[arm.columns]) for arm in self.arms))

    @property
    def home(self) -> Array:
        """Return the joint positions with all arms at home; array, shape (n_joints,) [rad]."""
        q = np.zeros(len(self.lower))
        for arm in self.arms:
            q[arm.columns] = arm.home
        return q

    def arm(self, name: str) -> Arm:
        """Return the arm of the manipulator called `name`.

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

    def grasp_frame(self, arm: Arm) -> tuple[int, Any]:
        """Return the joint that moves a grasp frame, and the placement there. It is an SE3."""
        if arm in self._grasp_frames:
            joint, placement = self._grasp_frames[arm]
            return joint, placement.copy()
        tip = self.model.frames[self.model.getFrameId(arm.tip)]
        found = tip.parentJoint, tip.placement * pin.SE3(arm.tool)
        if arm in self.arms:
            self._grasp_frames[arm] = found
        return found

    @cached_property
    def _grasp_frames(self) -> dict[Arm, tuple[int, Any]]:
        return {}

    def gripper_links(self, arm: Arm) -> frozenset[str]:
        """Return the link names of an arm's gripper in the description."""
        links = {link for source in self.sources for link in source.gripper_links}
        joint, _ = self.grasp_frame(arm)
        frames = (
            self.model.frames[self.model.getFrameId(link, pin.FrameType.BODY)] for link in sorted(links)
        )
        return frozenset(frame.name for frame in frames if frame.parentJoint == joint)

    def tool_pose(self, q: Array, arm: Arm) -> Array:
        """Compute the pose of the arm's grasp frame in the scene; array, shape (4, 4)."""
        return self.tool_poses(np.asarray(q, dtype=float)[None], (arm,))[0, 0]

    def tool_poses(self, joints: Array, arms: Sequence[Arm]) -> Array:
        """Compute the poses of the arms' grasp frames in the scene; array, shape (n_steps, n_arms, 4, 4).

        Parameters
        ----------
        joints : array, shape (n_steps, n_joints), [rad]
        """
        data, frames = self._data, [self.model.getFrameId(arm.tip) for arm in arms]
        poses = np.empty((len(joints), len(arms), 4, 4))
        for step, q in enumerate(joints):
            pin.framesForwardKinematics(self.model, data, q)
            for i, frame in enumerate(frames):
                poses[step, i] = data.oMf[frame].homogeneous @ arms[i].tool
        return poses

    @cached_property
    def joints_above(self) -> dict[str, tuple[str, str, bool]]:
        """Return each link's parent joint, parent link and whether the joint moves."""
        joints = (joint for source in self.sources for joint in ET.fromstring(source.urdf).findall("joint"))
        ends = ((joint.get("name", ""), *ends_of(joint), joint.get("type") != "fixed") for joint in joints)
        return {child: (name, parent, moves) for name, parent, child, moves in ends}

    @cached_property
    def _data(self) -> Any:
        return self.model.createData()


def assembled(description: RobotFile, file: Path) -> Robot:
    """Return the robot of a description. Its paths are relative to `file`, which errors name."""
    digest = hashlib.sha256(description.model_dump_json(exclude={"ros"}).encode())  # names move nothing
    sources = tuple(read_source(source, description, file, digest) for source in description.models)
    if any(arm.gripper is not None for arm in description.arms.values()):
        from comove.robots.mounting import with_grippers

        sources = with_grippers(sources, description, file, digest)
    with errors_in(file):
        _check_poses(description, [name for source in sources for name in source.free])
        sources, model, collision = _joined(sources)
        further = {name: limits for source in sources for name, limits in source.limits.items()}
        _apply_soft_limits(model, further)
        for key in ("posture", "limits", "springs"):
            _require_known(getattr(description, key), list(model.names)[1:], key)
        chains = _chains(description, model)
        mimics = {name: mimic for source in sources for name, mimic in source.mimics.items()}
        states = [state for source in sources for state in source.srdf.states]
        description = _with_posture(description, model, mimics, chains, states)
        robot = _reduced(description, model, collision, chains, sources, states, further, digest.hexdigest())
    for gap in _gaps(robot):
        warnings.warn(f"{file}: {gap}", ComoveWarning, stacklevel=2)
    return robot


def _require_grippers_apart(robot: Robot) -> None:
    """Reject grippers that touch their own arm at home."""
    if not any(source.gripper_links for source in robot.sources):
        return
    geometry, model = robot.collision.copy(), robot.model
    names = [model.frames[item.parentFrame].name for item in geometry.geometryObjects]
    pairs = [(pair.first, pair.second) for pair in geometry.collisionPairs]
    geometry.removeAllCollisionPairs()
    found = []
    for arm in robot.arms:
        own, chain = robot.gripper_links(arm), set(model.supports[robot.grasp_frame(arm)[0]])
        for pair in pairs:
            ours = [names[one] in own for one in pair]
            other = geometry.geometryObjects[pair[ours.index(False)]] if ours.count(True) == 1 else None
            if other is not None and other.parentJoint in chain:
                geometry.addCollisionPair(pin.CollisionPair(*pair))
                found.append((arm, pair))
    placed = geometry.createData()
    pin.computeCollisions(model, model.createData(), geometry, placed, robot.home, False)
    for (arm, pair), result in zip(found, placed.collisionResults, strict=True):
        if result.isCollision():
            hand, other = sorted(
                (names[one] for one in pair), key=lambda link: link not in robot.gripper_links(arm)
            )
            raise RobotError(
                f"at home the gripper's link '{hand}' touches '{other}' of its own arm",
                key=f"arms.{arm.name}.gripper",
                way_out="correct its mount or the home, or let it touch that link: "
                f"gripper: {{touch_links: ['{other}']}}",
            )


def _joined(read: tuple[Source, ...]) -> tuple[tuple[Source, ...], Any, Any]:
    """Build all models as one on their bases, with guessed masses."""
    with tempfile.TemporaryDirectory() as folder:
        loader = coal.CachedMeshLoader(coal.BV_OBBRSS)
        sources, models, geometries = zip(
            *(_built(source, Path(folder), loader) for source in read), strict=True
        )
    model, collision = models[0], geometries[0]
    _move_base(model, collision, pin.SE3(sources[0].base.homogeneous))
    for source, part, geometry in zip(sources[1:], models[1:], geometries[1:], strict=True):
        names, own = ({frame.name for frame in one.frames} for one in (model, part))
        if twice := (names & own) - {"universe"}:
            raise RobotError(
                f"two models have a link or joint '{min(twice)}'",
                key="models",
                way_out="give one a prefix: prefix: right_",
            )
        model, collision = pin.appendModel(
            model, part, collision, geometry, 0, pin.SE3(source.base.homogeneous)
        )
    return sources, model, collision


def _check_poses(description: RobotFile, free: list[str]) -> None:
    """Reject poses of joints with one value, and values of others. Only floating and planar joints have poses."""
    _require_known(description.poses or {}, free, "poses", "floating or planar joint")
    for key in ("posture", "limits", "springs"):
        for name in getattr(description, key):
            if name in free:
                raise RobotError(
                    f"the joint '{name}' floats, or is planar: it does not move, and has no single value",
                    key=key,
                    way_out=f"leave it out, and say where it is: poses: {{{name}: {{position: [0, 0, 0]}}}}",
                )


def _apply_soft_limits(model: Any, further: Mapping[str, FurtherLimits]) -> None:
    """Narrow the position limits of a model's joints to their soft limits."""
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        if joint.nq == 1:
            lower[joint.idx_q] = max(lower[joint.idx_q], further[name].soft_lower)
            upper[joint.idx_q] = min(upper[joint.idx_q], further[name].soft_upper)
    model.lowerPositionLimit, model.upperPositionLimit = lower, upper


def _built(source: Source, folder: Path, loader: Any) -> tuple[Source, Any, Any]:
    """Build the model and its collision geometry with pairs that can collide.

    Meshes pass through a folder. The source is returned as well, with guessed masses.
    """
    failure: Exception | None = None
    with errors_of_reader() as errors:
        try:
            text = for_pinocchio(source, folder)
            model = pin.buildModelFromXML(text)
            _tell_frames_apart(model)
            geometry = pin.buildGeomFromUrdfString(
                model, text, pin.GeometryType.COLLISION, mesh_loader=loader
            )
            _compare(model, geometry, source.srdf)
        except (ValueError, RuntimeError, IndexError) as error:
            failure = error
    with errors_in(source.file):
        if errors or failure is not None:
            reason = errors[0] if errors or failure is None else _reason(failure)
            raise RobotError(
                f"the model cannot be built: {reason}", way_out="correct the URDF, or its mesh"
            ) from failure
        _check_bodies(geometry)
    source, note = with_guessed_masses(source, model, geometry)
    if note is not None:
        warnings.warn(f"{source.file}: {note}", ComoveWarning, stacklevel=2)
    return source, model, geometry


def _tell_frames_apart(model: Any) -> None:
    """Rename frames of joints that share a link's name. Frames are found by name alone."""
    links = {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY}
    for frame in model.frames:
        if frame.type in (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT) and frame.name in links:
            frame.name += OF_JOINT


def frame_of_joint(model: Any, name: str) -> int:
    """Return the number of the frame of a joint in a model."""
    return model.getFrameId(name + OF_JOINT if model.existFrame(name + OF_JOINT) else name)


def _reason(error: Exception) -> str:
    """Return an error's reason by Pinocchio or coal, without code locations."""
    text = str(error).partition("message: ")[2] or str(error)
    return ", ".join(text.partition("\nHint")[0].split("\n")).strip(" ,.") or type(error).__name__


def _check_bodies(geometry: Any) -> None:
    """Reject collision bodies of impossible size."""
    for item in geometry.geometryObjects:
        item.geometry.computeLocalAABB()
        radius = item.geometry.aabb_radius
        if not 0 < radius < LARGEST_BODY or not np.isfinite(item.geometry.aabb_center).all():
            raise RobotError(
                f"the collision body '{item.name}' is {2 * radius:.3g} m wide",
                way_out='write metres; a mesh in millimetres takes scale="0.001 0.001 0.001"',
            )


def _compare(model: Any, geometry: Any, srdf: Srdf) -> None:
    """Set the collision pairs: all but neighbours and those that the SRDF disables."""
    items = list(geometry.geometryObjects)
    joints = np.array([item.parentJoint for item in items], dtype=int)
    parents = np.array(model.parents)[joints]
    compared = ~((joints[:, None] == joints) | (parents[:, None] == joints) | (joints[:, None] == parents))
    bodies: dict[str, list[int]] = {}
    for number, item in enumerate(items):
        bodies.setdefault(model.frames[item.parentFrame].name, []).append(number)
    for pairs, kept in ((srdf.disabled, False), (srdf.enabled, True)):
        for pair in pairs:
            first, second = (bodies.get(link, []) for link in (min(pair), max(pair)))
            compared[np.ix_(first, second)] = compared[np.ix_(second, first)] = kept
    compared[joints[:, None] == joints] = False  # rigid
    geometry.setCollisionPairs(compared)


def _drop_rigid(geometry: Any) -> None:
    """Drop the collision pairs of bodies that locked joints connect rigidly."""
    joints = np.array([item.parentJoint for item in geometry.geometryObjects], dtype=int)
    compared = np.zeros((len(joints), len(joints)), dtype=bool)
    for pair in geometry.collisionPairs:
        compared[pair.first, pair.second] = joints[pair.first] != joints[pair.second]
    geometry.setCollisionPairs(compared)


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


def _require_known(named: Iterable[str], known: list[str], key: str, kind: str = "joint") -> None:
    for name in named:
        if name not in known:
            raise RobotError(
                f"there is no {kind} '{name}' in the models", key=key, way_out=_near(name, known)
            )


def _near(name: str, names: list[str], most: int = 30) -> str:
    """Return the most similar names, or up to `most` names in all."""
    guess, known, listed = near_name(name, names).partition("known: ")
    return guess + (known + listed if len(names) <= most else f"{len(names)} are known")


def _chains(description: RobotFile, model: Any) -> dict[str, list[str]]:
    """List each arm's joints from base to tip, except posture joints."""
    chains: dict[str, list[str]] = {}
    for name, arm in description.arms.items():
        tip = _frame(model, arm.tip, f"arms.{name}.tip")
        supports = [model.names[j] for j in model.supports[tip.parentJoint] if j > 0]
        chain = [joint for joint in supports if joint not in description.posture]
        for other, joints in chains.items():
            if shared := [joint for joint in chain if joint in joints]:
                stay = ", ".join(f"{joint}: {_near_zero_text(model, joint)}" for joint in shared)
                raise RobotError(
                    f"the arms '{other}' and '{name}' share the joint '{shared[0]}'",
                    key="posture",
                    way_out=f"say where it stays: posture: {{{stay}}}",
                )
        if not chain:
            raise RobotError(
                f"no joint moves the frame '{arm.tip}'", key=f"arms.{name}.tip", way_out="name another"
            )
        _require_known(arm.fingers, list(model.names)[1:], f"arms.{name}.fingers")
        if own := [finger for finger in arm.fingers if finger in chain]:
            raise RobotError(
                f"the joint '{own[0]}' is between the base and the tip '{arm.tip}'",
                key=f"arms.{name}.fingers",
                way_out="choose a tip before the fingers, or leave it out of them",
            )
        chains[name] = chain
    if not chains:
        raise RobotError("no arm is named", key="arms", way_out="name one: {left: {tip: FRAME}}")
    return chains


def _frame(model: Any, name: str, key: str) -> Any:
    """Return the frame called `name`. A link precedes a joint of the same name."""
    if model.existFrame(name):
        return model.frames[model.getFrameId(name)]
    links = [frame.name for frame in model.frames if frame.type == pin.FrameType.BODY]
    raise RobotError(f"there is no frame '{name}'", key=key, way_out=_near(name, links))


def _with_posture(
    description: RobotFile,
    model: Any,
    mimics: dict[str, Mimic],
    chains: dict[str, list[str]],
    states: Sequence[GroupState],
) -> RobotFile:
    """Complete the posture by group states, <mimic>, and values nearest to 0."""
    moving = {joint for chain in chains.values() for joint in chain}
    posture: dict[str, float] = {}
    for state in description.states or ():
        values = [one.values for one in states if one.name == state]
        if not values:
            raise _unknown_state(state, states, "states", "leave it out")
        known = set(list(model.names)[1:]) - moving
        posture |= {name: value for one in values for name, value in one.items() if name in known}
    given = posture | description.posture
    posture = dict(given)
    for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        if name not in moving and joint.nq == 1:
            posture.setdefault(name, _nearest_to_zero(model, name))
    # Each comes after the joint it follows; none follows itself.
    for name in TopologicalSorter({name: [mimic.joint] for name, mimic in mimics.items()}).static_order():
        if (
            name in given or name not in mimics or name not in list(model.names)
        ):  # a fixed joint may have a <mimic>
            continue
        mimic = mimics[name]
        if mimic.joint not in list(model.names):
            raise RobotError(
                f"the joint '{name}' goes along with '{mimic.joint}', which is not there",
                key="posture",
                way_out=f"correct its <mimic>, or say where it stays: posture: {{{name}: "
                f"{_near_zero_text(model, name)}}}",
            )
        if name in moving or mimic.joint in moving:
            raise RobotError(
                f"the joint '{name}' goes along with '{mimic.joint}', which no arm here can",
                key="posture",
                way_out=f"say where it stays: posture: {{{name}: {_near_zero_text(model, name)}}}",
            )
        posture[name] = mimic.multiplier * posture.get(mimic.joint, 0.0) + mimic.offset
    return description.model_copy(update={"posture": posture})


def _locked_at(description: RobotFile, model: Any, rounding: float = 1e-9) -> Array:
    """Return Pinocchio's configuration of the locked joints."""
    q = pin.neutral(model)
    for name, value in description.posture.items():
        joint = model.joints[model.getJointId(name)]
        if joint.nq == 2:  # turns without end
            q[joint.idx_q : joint.idx_q + 2] = np.cos(value), np.sin(value)
            continue
        lower, upper = _range(model, joint)
        if not lower - rounding <= value <= upper + rounding:
            raise RobotError(
                f"the joint '{name}' stays at {value:g}, outside its limits",
                key="posture",
                way_out=f"keep it between {lower:.10g} and {upper:.10g}",
            )
        q[joint.idx_q] = value
    return q


def _nearest_to_zero(model: Any, name: str) -> float:
    """Return the value nearest to 0 within the limits of a joint."""
    joint = model.joints[model.getJointId(name)]
    if joint.nq != 1:
        return 0.0
    lower, upper = _range(model, joint)
    return min(max(0.0, lower), upper)


def _near_zero_text(model: Any, name: str) -> str:
    """Return a joint's value nearest to 0 in all needed digits."""
    value = _nearest_to_zero(model, name)
    return f"{value:g}" if float(f"{value:g}") == value else repr(value)


def _range(model: Any, joint: Any) -> tuple[float, float]:
    """Return a locked joint's limits in ascending order."""
    ends = (model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q])
    return float(min(ends)), float(max(ends))


def _reduced(
    description: RobotFile,
    model: Any,
    collision: Any,
    chains: dict[str, list[str]],
    sources: tuple[Source, ...],
    states: Sequence[GroupState],
    further: Mapping[str, FurtherLimits],
    sha256: str,
) -> Robot:
    """Build the robot with every joint locked but those of the arms."""
    moving = {joint for chain in chains.values() for joint in chain}
    for name in moving:
        if model.joints[model.getJointId(name)].nq > 1:
            raise RobotError(
                f"the joint '{name}' turns without end and has no limits",
                key="limits",
                way_out=f"give them: limits: {{{name}: {{lower: -3, upper: 3}}}}",
            )
    locked = [j for j in range(1, model.njoints) if model.names[j] not in moving]
    stay = _locked_at(description, model)
    for j in locked:  # becomes a frame of its name
        if model.existFrame(model.names[j] + OF_JOINT):
            model.names[j] += OF_JOINT
    reduced, geometry = pin.buildReducedModel(model, collision, locked, stay)
    _tell_frames_apart(reduced)
    _drop_rigid(geometry)
    names = list(reduced.names)[1:]
    limits = _limits(description, reduced, names, further)
    arms = tuple(
        replace(
            _arm(name, arm, chains[name], np.array([names.index(j) for j in chains[name]]), states, limits),
            payload=arm.payload or np.inf,
            hand=mass_beyond(chains[name][-1], sources),
        )
        for name, arm in description.arms.items()
    )
    _require_deviations(description, names)
    relief = np.array([description.springs.get(name, 0.0) for name in names])
    return Robot(
        description, reduced, geometry, arms, **limits, relief=relief, sha256=sha256, sources=sources
    )


def _limits(
    description: RobotFile, model: Any, names: list[str], further: Mapping[str, FurtherLimits]
) -> dict[str, Array]:
    """Collect and check the limits of the moving joints; arrays, shape (n_joints,)."""
    limits = {
        "lower": np.array(model.lowerPositionLimit),
        "upper": np.array(model.upperPositionLimit),
        "velocity": np.array(model.velocityLimit),
        "effort": np.array(model.effortLimit),
        "acceleration": _or(description.acceleration, [further[name].acceleration for name in names]),
        "jerk": _or(np.inf, [further[name].jerk for name in names]),
        "approach": np.array([further[name].approach for name in names]),
    }
    for i, name in enumerate(names):
        lower, upper = limits["lower"][i], limits["upper"][i]
        if not -LARGEST_LIMIT < lower < upper < LARGEST_LIMIT:
            raise RobotError(
                f"the joint '{name}' has the limits {lower:g} to {upper:g}",
                key="limits",
                way_out=f"give others: limits: {{{name}: {{lower: -3, upper: 3}}}}",
            )
        _check_units(name, lower, upper, slides=model.joints[i + 1].shortname().startswith("JointModelP"))
        for key in ("velocity", "effort", "acceleration", "jerk"):
            if not 0 < limits[key][i] <= (np.inf if key == "jerk" else LARGEST_LIMIT):
                raise RobotError(
                    f"the joint '{name}' has the {key} limit {limits[key][i]:g}",
                    key="limits",
                    way_out=f"give another: limits: {{{name}: {{{key}: NUMBER}}}}",
                )
    return limits


def _require_deviations(description: RobotFile, names: list[str]) -> None:
    """Reject deviations that leave out a joint. Nothing could be certified."""
    joints, key = description.uncertainty.joints, "uncertainty.joints"
    if not isinstance(joints, dict):
        return
    _require_known(joints, names, key, "joint that moves")
    if missing := [name for name in names if name not in joints]:
        known = max(joints.values(), default=0.005)
        raise RobotError(
            f"the joint '{missing[0]}' moves and has no deviation",
            key=key,
            way_out=f"state it: {{{missing[0]}: {known:g}}}, or one number for all joints: joints: {known:g}",
        )


def _or(default: float, values: list[float | None]) -> Array:
    return np.array([default if value is None else value for value in values])


def _check_units(name: str, lower: float, upper: float, slides: bool) -> None:
    """Reject position limits apparently in degrees or millimetres."""
    if (right := in_radians_or_metres(lower, upper, slides=slides)) is not None:
        unit, other = ("m", "millimetres") if slides else ("rad", "degrees")
        raise RobotError(
            f"the joint '{name}' has the limits {lower:g} to {upper:g} {unit}, {other} it seems",
            key="limits",
            way_out=f"give {unit}: limits: {{{name}: {{lower: {right[0]!r}, upper: {right[1]!r}}}}}",
        )


def _arm(
    name: str,
    arm: ArmDescription,
    chain: list[str],
    columns: Integers,
    states: Sequence[GroupState],
    limits: dict[str, Array],
) -> Arm:
    lower, upper = limits["lower"][columns], limits["upper"][columns]
    home, key = 0.5 * (lower + upper), f"arms.{name}.home"
    if arm.home is not None:
        home = np.array(arm.home)
    elif arm.home_state is not None:
        key += "_state"
        home = np.array(_of_state(arm.home_state, chain, states, key))
    if len(home) != len(columns):
        raise RobotError(
            f"home has {len(home)} values, the arm {len(columns)} joints",
            key=key,
            way_out="give one value a joint, from the base to the tip",
        )
    outside = (home < lower) | (home > upper)
    if outside.any():
        raise RobotError(
            f"joint {int(outside.argmax()) + 1} is at {home[outside][0]:g} at home, outside its limits",
            key=key,
            way_out=f"keep it between {lower[outside][0]:.10g} and {upper[outside][0]:.10g}",
        )
    return Arm(name, arm.tip, columns, arm.tool.homogeneous, home, tuple(arm.fingers))


def _unknown_state(state: str, states: Sequence[GroupState], key: str, otherwise: str) -> RobotError:
    known = sorted({one.name for one in states})
    return RobotError(
        f"there is no group state '{state}' in the SRDFs",
        key=key,
        way_out=near_name(state, known) if known else otherwise,
    )


def _of_state(state: str, chain: list[str], states: Sequence[GroupState], key: str) -> list[float]:
    """Return the joints of an arm in a group state."""
    named = [one.values for one in states if one.name == state]
    if not named:
        raise _unknown_state(state, states, key, "give values: home: [..]")
    found = {tuple(values[joint] for joint in chain) for values in named if set(chain) <= set(values)}
    if len(found) != 1:
        missing = ", ".join(joint for joint in chain if not any(joint in values for values in named))
        raise RobotError(
            f"the group state '{state}' has "
            + (
                f"{len(found)} values for the arm's joints"
                if found
                else f"no values for {missing or 'all joints'}"
            ),
            key=key,
            way_out=f"give its {len(chain)} values by home: [..], from the base to the tip",
        )
    return list(found.pop())


def _is_body(inertia: Any, rounding: float = 0.01) -> bool:
    """Return whether a body can have an inertia, up to rounding. Other messages name negative moments."""
    moments = np.linalg.eigvalsh(np.array(inertia.inertia))
    least = 1e-9 * inertia.mass  # kg m^2, of a body a few hundredths of a millimetre wide
    return (
        bool(moments[2] >= least and moments[0] + moments[1] >= (1.0 - rounding) * moments[2])
        or moments[0] < 0.0
    )


def _gaps(robot: Robot) -> Iterator[str]:
    """Yield messages of missing collision bodies and masses of arms."""
    grippers = {link for source in robot.sources for link in source.gripper_links}
    bodies = {
        item.parentJoint
        for item in robot.collision.geometryObjects
        if robot.model.frames[item.parentFrame].name not in grippers
    }
    held = sum(masses_of(source.urdf, source.gripper_links, robot.model) for source in robot.sources)
    masses = moved_masses(robot.model, held)
    for arm in robot.arms:
        joints = [robot.model.getJointId(robot.joint_names[column]) for column in arm.columns]
        if not bodies & set(joints):
            yield f"no link of the arm '{arm.name}' has a collision body: what it touches is not known"
        if not masses[joints[0]]:
            yield f"no link of the arm '{arm.name}' has a mass: what it asks of its motors is not known"
        own = robot.gripper_links(arm)
        if own and not sum(masses_of(source.urdf, own, robot.model).sum() for source in robot.sources):
            yield (
                f"no link of the gripper of the arm '{arm.name}' has a mass: what it asks of the motors is not "
                "known; write <inertial> into its URDF"
            )
        if strange := [
            robot.model.names[joint] for joint in joints if not _is_body(robot.model.inertias[joint])
        ]:
            yield (
                f"what {', '.join(strange)} of the arm '{arm.name}' move has moments of inertia that no body has "
                "(none, or one larger than the sum of the others): what it asks of its motors may be wrong"
            )
        if len(joints) < FREEDOMS and any(source.nearly_right for source in robot.sources):
            yield (
                f"angles such as 1.5708 leave axes of joints askew, for which the {len(joints)} joints of the arm "
                f"'{arm.name}' cannot make up: take them for right angles by round_right_angles: true, beside urdf"
            )
