"""Robot descriptions: the URDF models and their bases, the arms, and settings that a URDF cannot hold.

```yaml
name: two_arms
models:                        # one or several, each on its own base; prefix: before all names of a model
  - {urdf: arm.urdf, srdf: arm.srdf, prefix: left_, base: {position: [0, 0.4, 0]}}
  - {urdf: arm.urdf, srdf: arm.srdf, prefix: right_, base: {position: [0, -0.4, 0]}, round_right_angles: true}
arms:                          # by the name of the manipulator in a scene
  left: {tip: left_hand, tool: {position: [0, 0, 0.1]}, home: [0, -0.8, 0, -2.4, 0, 1.6, 0.8]}
  right: {tip: right_hand, home_state: ready, fingers: [right_gripper_finger], payload: 3, gripper: {urdf: hand.urdf}}
posture: {right_gripper_finger: 0.02}  # rad or m, of joints that do not move; nearest to 0 where not named
states: [open]                 # group states of the SRDF, for joints that neither move nor are in `posture`
poses: {right_cart: {position: [0, -0.1, 0]}}       # of floating and planar joints, which do not move
limits: {left_joint1: {lower: -2, upper: 2, velocity: 1.5, acceleration: 4, jerk: 200, effort: 50}}
acceleration: 5.0              # rad/s^2, of joints for which neither `limits` nor the URDF states one
springs: {left_joint2: 0.4}    # share of the arm's own weight that springs hold at a joint
servo: {stiffness: [2000, 2000, 2000, 2000, 1500, 1500, 400]}   # N m/rad, of a simulator's motors, by joint
uncertainty: {position: 0.002, rotation_deg: 0.1, joints: 0.005}   # of each base [m, deg], and joint [rad, m]
ros:                           # names of its controllers, for `comove send`
  action: "/{arm}_controller/follow_joint_trajectory"   # without {arm}: one controller of all arms
  joint_states: /joint_states
  gripper: {action: "/{arm}_gripper/gripper_cmd", open: 0.04, closed: 0.0, effort: 20}
```

`name`, `models` and `arms` are required. `tip` is a frame of the model; `tool` is the grasp frame in it, which is
placed at the end effector's pose in the scene: z is the direction of approach, and fingers open along y. The joints
between base and tip move, except those in `posture`. `home` has one value for each joint that moves, from the base to
the tip (the middle of its limits unless given); redundant joints are drawn towards it. `limits` replace those of the
URDF, key by key; `soft_lower`, `soft_upper` and `k_position` those of its ``<safety_controller>``
(`comove.robots.further_limits`). `payload` [kg] is the maker's rated load of an arm beyond its last joint, end
effector included. Paths are relative to the description, or ``package://NAME/...``.

`gripper` is missing in the URDF of an arm: a URDF of its own, or shapes, fixed to the tip (`GripperDescription`).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    model_validator,
)

from comove.arrays import Array
from comove.errors import RobotError, SceneError, near_name
from comove.geometry.rotations import matrices
from comove.io.keys import (
    UNTURNED,
    Contract,
    Name,
    NotNegative,
    Number,
    Part,
    Positive,
    Quaternion,
    Sizes,
    Sparse,
    Vector,
    Wrong,
    as_tuple,
    at_least,
    explained,
    scene_error,
    show,
)
from comove.io.yaml_reader import read_yaml
from comove.robots.formats import require_description

BUNDLED = Path(__file__).parent / "descriptions"


def _point(vector: tuple[float, ...]) -> tuple[float, ...]:
    if len(vector) != 3:
        raise Wrong(f"{list(vector)} has {len(vector)} numbers", "write three: x, y, z")
    return vector


Point = Annotated[Vector, AfterValidator(_point)]


class Placement(Part):
    """Pose of a frame in another one: `position` [m] and orientation, w first."""

    position: Point = (0.0, 0.0, 0.0)
    quaternion_wxyz: Quaternion = UNTURNED

    @property
    def homogeneous(self) -> Array:
        """Return the pose as a homogeneous matrix; array, shape (4, 4)."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = matrices(np.array(self.quaternion_wxyz)), self.position
        return pose


def _prefix(prefix: str) -> str:
    if not re.fullmatch(r"[\w./-]{0,100}", prefix):
        raise Wrong(f"{show(prefix)} cannot begin names", "use up to 100 letters, digits, '_', '-', '.', '/'")
    return prefix


class ModelSource(Sparse):
    """A URDF and the pose of its base in the scene; `prefix` is put before every name in it."""

    LATER = ("round_right_angles",)

    urdf: str
    srdf: str | None = None
    """File that lists the pairs of links that need not be kept apart."""
    base: Placement = Placement()
    prefix: Annotated[str, AfterValidator(_prefix)] = ""
    round_right_angles: bool | None = None
    """Whether angles of joints that are right angles but for rounding become right angles."""


SHAPES = {
    "box": ("size",),
    "sphere": ("radius",),
    "cylinder": ("radius", "height"),
    "capsule": ("radius", "length"),
    "mesh": ("file",),
}
"""Shapes of a gripper's bodies, and the keys that each must have."""


class GripperShape(Sparse):
    """A body of a gripper, in the gripper's frame [m]; keys are those of a scene's obstacles."""

    LATER = ("size", "radius", "height", "length", "file", "scale")

    shape: Literal["box", "sphere", "cylinder", "capsule", "mesh"]
    center: Point = (0.0, 0.0, 0.0)
    quaternion_wxyz: Quaternion = UNTURNED
    size: Annotated[Sizes, AfterValidator(_point)] | None = None
    radius: Positive | None = None
    height: Positive | None = None
    length: Positive | None = None
    file: str | None = None
    scale: Positive | None = None

    @model_validator(mode="after")
    def _has_its_keys(self) -> GripperShape:
        needed = SHAPES[self.shape]
        given = [key for key in self.LATER if getattr(self, key) is not None]
        way_out = f"give a {self.shape} {' and '.join(needed)}"
        if missing := [key for key in needed if key not in given]:
            raise Wrong(f"the {self.shape} has no {' and no '.join(missing)}", way_out)
        allowed = (*needed, "scale") if self.shape == "mesh" else needed
        if other := [key for key in given if key not in allowed]:
            raise Wrong(f"a {self.shape} has no {other[0]}", f"{way_out}, and leave {other[0]} out")
        return self


class GripperDescription(Sparse):
    """A gripper that is fixed to the tip of an arm: a URDF, or shapes that have a mass together [kg].

    Its links and joints are called `prefix` and their names; the one link of shapes is called "body".
    """

    LATER = ("urdf", "srdf", "prefix", "shapes", "mass")

    urdf: str | None = None
    srdf: str | None = None
    prefix: Annotated[str, AfterValidator(_prefix)] | None = None
    """Name of the arm and "_gripper_" unless given."""
    mount: Placement = Placement()
    """Pose of the gripper's base in the tip."""
    shapes: Annotated[tuple[GripperShape, ...], BeforeValidator(as_tuple), at_least(1, "shape")] | None = None
    mass: Positive | None = None
    touch_links: Annotated[tuple[str, ...], BeforeValidator(as_tuple)] = ()
    """Links of the arm's model that the gripper may touch, as it is mounted."""

    @model_validator(mode="after")
    def _one_source(self) -> GripperDescription:
        if (self.urdf is None) == (self.shapes is None):
            found = "neither urdf nor shapes are" if self.urdf is None else "both urdf and shapes are"
            raise Wrong(f"{found} given", "give one of the two")
        if self.shapes is not None and self.mass is None:
            raise Wrong("the shapes have no mass", "write mass: KILOGRAMS beside shapes")
        for key, owner, lacks in (("mass", "shapes", self.shapes), ("srdf", "urdf", self.urdf)):
            if lacks is None and getattr(self, key) is not None:
                raise Wrong(f"{key} belongs to {owner}, and none are given", f"leave {key} out")
        return self


class ArmDescription(Sparse):
    """An arm: its last frame, the grasp frame in that (z along the approach), and its home [rad or m]."""

    LATER = ("home_state", "payload", "gripper")

    tip: str
    tool: Placement = Placement()
    home: Annotated[tuple[Number, ...], BeforeValidator(as_tuple)] | None = None
    home_state: str | None = None
    """Group state of the SRDF that has the values of the joints at home, unless `home` is given."""
    fingers: Annotated[tuple[str, ...], BeforeValidator(as_tuple)] = ()
    """Joints that close on the load; `posture` holds their values while it is carried."""
    payload: Positive | None = None
    """Mass that its maker rates it for at the flange: that of its hand and its share of the load [kg]."""
    gripper: GripperDescription | None = None
    """What is fixed to the tip and is not in the model."""


class JointLimits(Sparse):
    """Joint limits in place of the URDF's. Units are rad or m, s, N m or N."""

    LATER = ("jerk", "soft_lower", "soft_upper", "k_position")

    lower: Number | None = None
    upper: Number | None = None
    velocity: Positive | None = None
    acceleration: Positive | None = None
    effort: Positive | None = None
    jerk: Positive | None = None
    soft_lower: Number | None = None
    soft_upper: Number | None = None
    k_position: Positive | None = None
    """Gain by which velocities are bounded near the soft limits [1/s]; see `comove.robots.further_limits`."""


class Servo(Part):
    """Position servos of a simulator: `stiffness` by joint, equal for all arms [N m/rad, N/m]."""

    stiffness: Sizes


class Uncertainty(Sparse):
    """Tolerances of bases, `position` [m] and `rotation_deg` [deg], and of joints."""

    LATER = ("joints",)

    position: NotNegative = 0.0
    rotation_deg: NotNegative = 0.0
    joints: (
        Annotated[
            Annotated[Positive, Tag("of all")] | Annotated[dict[str, Positive], Tag("by joint")],
            Discriminator(lambda value: "by joint" if isinstance(value, dict) else "of all"),
        ]
        | None
    ) = None
    """Largest deviation of every joint that moves from its command, or by joint [rad, m for prismatic joints]."""

    def deviations(self, names: Sequence[str]) -> Array:
        """Return joints' largest deviations [rad, m], 0 where none are stated."""
        if isinstance(self.joints, dict):
            return np.array([self.joints.get(name, 0.0) for name in names])
        return np.full(len(names), self.joints or 0.0)


class RosGripper(Sparse):
    """Controllers of the grippers in ROS 2. ``{arm}`` stands for the arm's name."""

    LATER = ("effort", "joint")

    type: Literal["gripper_command", "parallel_gripper_command", "joint_trajectory"] = "gripper_command"
    action: str
    open: Number
    closed: Number
    """Values of an open and of a closed gripper [rad, m]."""
    effort: Positive | None = None
    """Largest force or torque while it closes [N, N m]."""
    joint: str | None = None
    """Joint that the two last types move."""

    @model_validator(mode="after")
    def _names_its_joint(self) -> RosGripper:
        if self.joint is None and self.type != "gripper_command":
            raise Wrong(f"a {self.type} names its joint", "write joint: NAME, with {arm} for the arm's name")
        return self


class RosNames(Sparse):
    """Names in ROS, with ``{arm}`` for the name of each arm."""

    LATER = ("action", "joint_states", "gripper", "commands")

    action: str | None = None
    joint_states: str | None = None
    commands: str | None = None
    """Topic on which a controller takes positions or short trajectories, step by step."""
    gripper: RosGripper | None = None


class RobotFile(Sparse):
    """A robot description as written in its file."""

    LATER = ("poses", "states", "ros")

    name: Name
    models: Annotated[tuple[ModelSource, ...], BeforeValidator(as_tuple), at_least(1, "model")]
    arms: dict[Name, ArmDescription]
    posture: dict[str, Number] = Field(default={})
    """Values of joints that do not move [rad or m]; joints that are not named stay nearest to 0."""
    poses: dict[str, Placement] | None = None
    """Poses of floating and planar joints, which do not move; where the URDF has them unless named."""
    states: Annotated[tuple[str, ...], BeforeValidator(as_tuple)] | None = None
    """Group states of the SRDFs whose values joints that do not move take, unless `posture` names them."""
    acceleration: Positive = 5.0
    limits: dict[str, JointLimits] = Field(default={})
    springs: dict[str, Annotated[float, Field(ge=0, le=1)]] = Field(default={})
    """Share of the torque due to the arm's own weight that springs hold, by joint; a URDF has no springs."""
    servo: Servo | None = None
    uncertainty: Uncertainty = Uncertainty()
    ros: RosNames | None = None


_CONTRACT = Contract(root=RobotFile, families={})


@contextmanager
def errors_in(file: Path) -> Iterator[None]:
    """Name `file` in every `RobotError` that names no file yet."""
    try:
        yield
    except RobotError as error:
        error.file = error.file or file
        raise


def bundled_robots() -> tuple[str, ...]:
    """Return the names of the descriptions that come with the package."""
    return tuple(sorted(path.stem for path in BUNDLED.glob("*.yaml")))


def find_description(robot: str | Path, folder: Path | None = None) -> Path:
    """Return the file of a bundled robot or a path. Relative paths start at `folder`, if given.

    Raises
    ------
    RobotError
        If there is none.
    """
    if str(robot) in bundled_robots():
        return BUNDLED / f"{robot}.yaml"
    path = Path(robot)
    if folder is not None and not path.is_absolute():
        path = folder / path
    if not is_file(path):
        raise RobotError(
            f"there is no robot '{robot}', nor a file of that name",
            key="robot",
            way_out=f"{near_name(str(robot), bundled_robots())}; or name a description (YAML)",
        )
    return path


def is_file(path: Path) -> bool:
    """Return whether there is such a file. Its name may be impossible."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that is too long, or has a zero byte
        return False


def load_description(path: Path) -> RobotFile:
    """Read and check a robot description.

    Raises
    ------
    RobotError
        If there are errors; the message names file, key, line, value and hint of the first three.
    """
    require_description(path)
    try:
        data, lines = read_yaml(path)
        try:
            return RobotFile.model_validate(data)
        except ValidationError as error:
            raise scene_error(explained(error, data, _CONTRACT), path, lines) from None
    except SceneError as error:
        from comove.io.kinds import PathKind, misnamed

        if found := misnamed(path, PathKind.ROBOT):
            raise RobotError(found[0], file=path, way_out=found[1]) from None
        raise RobotError(error.message, file=error.file, key=error.key, way_out=error.way_out) from None
