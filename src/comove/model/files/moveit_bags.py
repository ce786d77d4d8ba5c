"""Planning scenes of MoveIt in bags of ROS 2. Definitions of their messages.

A bag is read as MoveIt's planning scene monitor reads its topics: whole scenes replace what was there, others change
it. What `move_group` publishes, ``/monitored_planning_scene``, holds everything and is read alone. Cylinders and
cones are height, radius in messages. Messages are decoded by the definitions here, which those of the bag must equal.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.errors import ComoveWarning, SceneError, listed, shortened
from comove.geometry.rotations import quaternion_of_rotation
from comove.io.files import installed
from comove.model.files.moveit import (
    OCTOMAP,
    AttachedObject,
    CollisionObject,
    PlacedShape,
    PlanningScene,
    fault_of_triangles,
    homogeneous,
)

SCENE, OBJECT = "moveit_msgs/msg/PlanningScene", "moveit_msgs/msg/CollisionObject"
ATTACHED, WORLD = "moveit_msgs/msg/AttachedCollisionObject", "moveit_msgs/msg/PlanningSceneWorld"
STATE, ROBOT_TRAJECTORY = "moveit_msgs/msg/RobotState", "moveit_msgs/msg/RobotTrajectory"
DISPLAY = "moveit_msgs/msg/DisplayTrajectory"
READ = (SCENE, OBJECT, ATTACHED, WORLD)
"""Types that are read."""
WHOLE = "monitored_planning_scene"
"""How the topic ends that holds everything."""
MAX_BYTES = 500_000_000
"""Largest size of all messages that are read [bytes]."""
DEFINITIONS = {
    "object_recognition_msgs/msg/ObjectType": "string key\nstring db",
    "octomap_msgs/msg/Octomap": "std_msgs/Header header\nbool binary\nstring id\nfloat64 resolution\nint8[] data",
    "octomap_msgs/msg/OctomapWithPose": (
        "std_msgs/Header header\ngeometry_msgs/Pose origin\noctomap_msgs/Octomap octomap"
    ),
    OBJECT: (
        "std_msgs/Header header\ngeometry_msgs/Pose pose\nstring id\nobject_recognition_msgs/ObjectType type\n"
        "shape_msgs/SolidPrimitive[] primitives\ngeometry_msgs/Pose[] primitive_poses\n"
        "shape_msgs/Mesh[] meshes\ngeometry_msgs/Pose[] mesh_poses\n"
        "shape_msgs/Plane[] planes\ngeometry_msgs/Pose[] plane_poses\n"
        "string[] subframe_names\ngeometry_msgs/Pose[] subframe_poses\n"
        "byte ADD=0\nbyte REMOVE=1\nbyte APPEND=2\nbyte MOVE=3\nbyte operation"
    ),
    ATTACHED: (
        "string link_name\nCollisionObject object\nstring[] touch_links\n"
        "trajectory_msgs/JointTrajectory detach_posture\nfloat64 weight"
    ),
    STATE: (
        "sensor_msgs/JointState joint_state\nsensor_msgs/MultiDOFJointState multi_dof_joint_state\n"
        "AttachedCollisionObject[] attached_collision_objects\nbool is_diff"
    ),
    "moveit_msgs/msg/AllowedCollisionEntry": "bool[] enabled",
    "moveit_msgs/msg/AllowedCollisionMatrix": (
        "string[] entry_names\nAllowedCollisionEntry[] entry_values\n"
        "string[] default_entry_names\nbool[] default_entry_values"
    ),
    "moveit_msgs/msg/LinkPadding": "string link_name\nfloat64 padding",
    "moveit_msgs/msg/LinkScale": "string link_name\nfloat64 scale",
    "moveit_msgs/msg/ObjectColor": "string id\nstd_msgs/ColorRGBA color",
    WORLD: "CollisionObject[] collision_objects\noctomap_msgs/OctomapWithPose octomap",
    SCENE: (
        "string name\nRobotState robot_state\nstring robot_model_name\n"
        "geometry_msgs/TransformStamped[] fixed_frame_transforms\n"
        "AllowedCollisionMatrix allowed_collision_matrix\nLinkPadding[] link_padding\nLinkScale[] link_scale\n"
        "ObjectColor[] object_colors\nPlanningSceneWorld world\nbool is_diff"
    ),
    ROBOT_TRAJECTORY: (
        "trajectory_msgs/JointTrajectory joint_trajectory\n"
        "trajectory_msgs/MultiDOFJointTrajectory multi_dof_joint_trajectory"
    ),
    DISPLAY: "string model_id\nRobotTrajectory[] trajectory\nRobotState trajectory_start",
}
"""Texts of MoveIt's types and those that they hold, by name, as in its repository since Foxy."""
ADD, REMOVE, APPEND, MOVE = range(4)
MOVED = 1e-6
"""Motion beyond which something has moved [m, rad]."""
KINDS = {1: "box", 2: "sphere", 3: "cylinder", 4: "cone", 5: "prism"}
"""Shapes by their number in `shape_msgs/msg/SolidPrimitive`."""
POSES = {"primitives": "primitive_poses", "meshes": "mesh_poses", "planes": "plane_poses"}
"""Fields of an object that hold shapes, and those that hold their poses."""
Encoded = tuple[str, bytes]
"""Type and content of a message, encoded in CDR."""
N_DIMENSIONS = {"box": 3, "sphere": 1, "cylinder": 2, "cone": 2, "prism": 1}


def read(path: Path) -> PlanningScene:
    """Read the last planning scene of a bag of ROS 2.

    Raises
    ------
    SceneError, DemonstrationError
        If the bag cannot be read, or holds no planning scene; its topics are named.
    """
    messages = [(kind, message) for kind, _, message in _messages_in(path)]
    try:
        return _applied(messages, path)
    except SceneError as error:
        error.file = error.file or path
        raise


def messages_in(path: Path) -> list[Encoded]:
    """Return a bag's messages from its last whole scene on.

    Raises
    ------
    SceneError, DemonstrationError
        As `read`.
    """
    return [(kind, data) for kind, data, _ in _messages_in(path)]


def _messages_in(path: Path) -> list[tuple[str, bytes, Any]]:
    """Return the messages of `messages_in`, decoded as well."""
    from comove.dmp.demonstrations.formats.rosbag import opened

    if path.suffix.lower() == ".bag":
        raise SceneError(
            "it is a bag of ROS 1", file=path, way_out="convert it: rosbags-convert --src ... --dst ..."
        )
    with opened(path, DEFINITIONS) as bag:
        chosen = _chosen(path, bag)
        found, size = list[Encoded](), 0
        for one, _, data in bag.reader.messages(chosen):
            found.append((one.msgtype, bytes(data)))
            size += len(data)
            if size > MAX_BYTES:
                told = f"its planning scenes take more than {MAX_BYTES // 1_000_000} MB"
                raise SceneError(told, file=path, way_out="record it for a shorter time")
        if not found:
            raise SceneError("its planning scene has no messages", file=path, way_out="record it anew")
        messages = list[tuple[str, bytes, Any]]()
        while found:  # from the last one back to the last whole scene
            kind, data = found.pop()
            messages.append((kind, data, bag.decode(data, kind)))
            if kind == SCENE and not messages[-1][2].is_diff:
                break
    return messages[::-1]


def store() -> Any:
    """Return the types of ROS 2 with those of MoveIt.

    Raises
    ------
    ExtraError
        If the library rosbags is missing.
    """
    installed("rosbags", "a planning scene of MoveIt", "data")
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    found = get_typestore(Stores.ROS2_HUMBLE)
    for kind, text in DEFINITIONS.items():
        found.register(get_types_from_msg(text, kind))
    return found


def write(path: Path, messages: Sequence[Encoded]) -> None:
    """Write encoded messages as a bag, one MCAP file, in their order.

    Raises
    ------
    ExtraError
        If the library rosbags is missing.
    """
    types = store()
    from rosbags.rosbag2 import StoragePlugin, Writer

    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        bag = Path(folder, "bag")
        with Writer(bag, version=8, storage_plugin=StoragePlugin.MCAP) as writer:
            topics = {
                kind: writer.add_connection(f"/{kind.rsplit('/', 1)[1]}", kind, typestore=types)
                for kind in dict.fromkeys(kind for kind, _ in messages)
            }
            for stamp, (kind, data) in enumerate(messages, start=1):
                writer.write(topics[kind], stamp, _exact(types, kind, data))
        (bag / "bag.mcap").replace(path)


def _exact(types: Any, kind: str, data: bytes) -> bytes:
    """Return an encoded message without the trailing bytes of rmw_fastrtps."""
    definition = types.get_msgdef(kind)
    decode = definition.deserialize_cdr_le if data[1] else definition.deserialize_cdr_be
    _, size = decode(data[4:], 0, definition.cls, types)
    return data[: size + 4]


def encoded(scene: PlanningScene) -> Encoded:
    """Return the world of a planning scene as a message."""
    types = store()
    objects = [_message(types, one) for one in scene.objects]
    world = _made(types, WORLD, collision_objects=objects)
    return SCENE, bytes(types.serialize_cdr(_made(types, SCENE, world=world), SCENE))


def _made(types: Any, kind: str, **given: Any) -> Any:
    """Return a message; fields that are not given are empty, 0, or made so themselves."""
    from rosbags.interfaces import Nodetype

    values = {}
    for name, (node, what) in types.fielddefs[kind][1]:
        if name in given:
            values[name] = given[name]
        elif node == Nodetype.BASE:
            values[name] = {"string": "", "bool": False}.get(what[0], 0.0 if "float" in what[0] else 0)
        elif node == Nodetype.NAME:
            values[name] = _made(types, what)
        else:
            (inner, of), _ = what
            plain = inner == Nodetype.BASE and of[0] != "string"
            values[name] = np.zeros(0, {"bool": np.bool_}.get(of[0], of[0])) if plain else []
    return types.types[kind](**values)


def _message(types: Any, one: CollisionObject) -> Any:
    """Return an object as a message."""
    given: dict[str, list[Any]] = {}

    def add(several: str, shape: Any, pose: Array) -> None:
        given.setdefault(several, []).append(shape)
        given.setdefault(POSES[several], []).append(_pose_message(types, pose))

    for shape in one.shapes:
        if shape.mesh is not None:
            vertices, faces = shape.mesh
            points = [_made(types, "geometry_msgs/msg/Point", x=x, y=y, z=z) for x, y, z in vertices.tolist()]
            corners = faces.astype(np.uint32)
            triangles = [_made(types, "shape_msgs/msg/MeshTriangle", vertex_indices=row) for row in corners]
            mesh = _made(types, "shape_msgs/msg/Mesh", vertices=points, triangles=triangles)
            add("meshes", mesh, shape.pose)
        elif shape.kind == "plane":
            add("planes", _made(types, "shape_msgs/msg/Plane", coef=shape.sizes.copy()), shape.pose)
        else:
            number = next(key for key, kind in KINDS.items() if kind == shape.kind)
            sizes = shape.sizes[::-1] if shape.kind in ("cylinder", "cone") else shape.sizes
            solid = _made(types, "shape_msgs/msg/SolidPrimitive", type=number, dimensions=sizes.copy())
            add("primitives", solid, shape.pose)
    header = _made(types, "std_msgs/msg/Header", frame_id=one.frame)
    pose = _pose_message(types, one.pose)
    return _made(types, OBJECT, header=header, pose=pose, id=one.name, **given)


def _pose_message(types: Any, pose: Array) -> Any:
    w, x, y, z = quaternion_of_rotation(pose[:3, :3]).tolist()
    at = dict(zip("xyz", pose[:3, 3].tolist(), strict=True))
    return _made(
        types,
        "geometry_msgs/msg/Pose",
        position=_made(types, "geometry_msgs/msg/Point", **at),
        orientation=_made(types, "geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
    )


def _chosen(path: Path, bag: Any) -> list[Any]:
    """Return the connections that are read."""
    usable = [one for one in bag.reader.connections if one.msgtype in READ]
    if not usable or bag.store is None:
        held = listed([f"{one.topic} ({one.msgtype})" for one in bag.reader.connections], 20) or "nothing"
        raise SceneError(
            f"it holds no planning scene, but {held}",
            file=path,
            way_out="record it: ros2 bag record -o scene /monitored_planning_scene",
        )
    whole = {one.topic for one in usable if one.msgtype == SCENE and one.topic.endswith(WHOLE)}
    if len(whole) > 1:
        raise SceneError(
            f"it holds several planning scenes, {listed(sorted(whole))}",
            file=path,
            way_out="record one of them",
        )
    usable = [one for one in usable if one.topic in whole] if whole else usable
    for one in usable:
        if (
            one.digest
            and one.digest.startswith("RIHS01_")
            and one.digest != bag.store.hash_rihs01(one.msgtype)
        ):
            raise SceneError(
                f"its {one.msgtype} is none of those that are read ({shortened(one.digest)})",
                file=path,
                way_out="record it by MoveIt 2 with moveit_msgs 2.2 to 2.7",
            )
    return usable


@dataclass
class _Monitor:
    """A planning scene while messages change it, with objects by name."""

    scene: PlanningScene = field(default_factory=PlanningScene)
    objects: dict[str, CollisionObject] = field(default_factory=dict)
    attached: dict[str, AttachedObject] = field(default_factory=dict)
    taken_at: dict[str, dict[str, float]] = field(default_factory=dict)
    """Joints at which objects were attached that lay in the world."""

    def require_still(self) -> None:
        """Refuse objects that the robot moved after it took them.

        Their poses on its links are those of that instant, which no message holds.
        """
        for name, joints in self.taken_at.items():
            now = self.scene.joints
            if name in self.attached and any(abs(now[key] - at) > MOVED for key, at in joints.items()):
                raise SceneError(
                    f"the robot moved after the object '{shortened(name)}' was attached to it by its name",
                    way_out="record /monitored_planning_scene, which says where on the link it is",
                )

    def of_scene(self, message: Any) -> None:
        """Apply a planning scene. A whole one is the first."""
        fixed = {frame_name(one.child_frame_id): one for one in message.fixed_frame_transforms}
        if fixed:
            frame = frame_name(next(iter(fixed.values())).header.frame_id)
            poses = {name: _transform(one.transform, name) for name, one in fixed.items()}
            self.scene = replace(self.scene, frame=frame, transforms=poses)
        if message.allowed_collision_matrix.entry_names:
            matrix = message.allowed_collision_matrix
            self.scene = replace(self.scene, allowed=_allowed(matrix), compared=frozenset(matrix.entry_names))
        changed = {one.link_name: one.padding != 0.0 for one in message.link_padding}
        for one in message.link_scale:
            changed[one.link_name] = changed.get(one.link_name, False) or one.scale != 1.0
        padded = self.scene.padded - changed.keys() | {name for name, is_so in changed.items() if is_so}
        self.scene = replace(self.scene, padded=padded)
        _warn_of_base(message.robot_state.multi_dof_joint_state)
        state = message.robot_state.joint_state
        joints = dict(zip(state.name, map(float, state.position), strict=False))
        self.scene = replace(self.scene, joints={**self.scene.joints, **joints})
        if joints and not message.robot_state.is_diff:
            self.attached = {}
        for one in message.robot_state.attached_collision_objects:
            self.of_attached(one)
        self.of_world(message.world)

    def of_world(self, world: Any) -> None:
        """Apply what is in the world."""
        for one in world.collision_objects:
            self.of_object(one)
        if world.octomap.octomap.id:
            self.objects.pop(OCTOMAP, None)
            if len(world.octomap.octomap.data):
                shape = PlacedShape("octomap", np.empty(0), np.eye(4), OCTOMAP)
                self.objects[OCTOMAP] = CollisionObject(OCTOMAP, np.eye(4), (shape,))

    def of_object(self, message: Any) -> None:
        """Apply an object of the world."""
        name, operation = message.id, int(message.operation)
        if operation == REMOVE:
            if name:
                self.objects.pop(name, None)
            else:
                self.objects = {key: one for key, one in self.objects.items() if key == OCTOMAP}
            return
        if operation == MOVE:
            if name not in self.objects:
                told = f"the object '{shortened(name)}' is moved, and is not in the recording"
                raise SceneError(told, way_out="record the whole scene: /monitored_planning_scene")
            pose = _pose(message.pose, name)
            self.objects[name] = self.objects[name]._replace(
                pose=pose, frame=frame_name(message.header.frame_id)
            )
            return
        if operation not in (ADD, APPEND):
            raise SceneError(
                f"the object '{shortened(name)}' has the operation {operation}", way_out="record it anew"
            )
        own = object_of(message)
        if not own.shapes:
            return  # which MoveIt refuses as well
        there = self.objects.get(name) if operation == APPEND else None
        self.objects[name] = own if there is None else there._replace(shapes=there.shapes + own.shapes)

    def of_attached(self, message: Any) -> None:
        """Apply an object that is attached to a link, or detached."""
        name, link = message.object.id, message.link_name
        if int(message.object.operation) == REMOVE:
            gone = [key for key, one in self.attached.items() if name in ("", key) and link in ("", one.link)]
            for key in gone:
                one = self.attached.pop(key)
                let_go = one.object._replace(frame=f"{one.link}, as it let go of the object")
                self.objects.setdefault(key, let_go)
            return
        own, there = object_of(message.object), self.objects.pop(name, None)
        if not own.shapes and there is not None:
            own = there
            self.taken_at[name] = dict(self.scene.joints)
        elif int(message.object.operation) == APPEND and name in self.attached:
            before = self.attached[name].object
            own = before._replace(shapes=before.shapes + own.shapes)
        if own.shapes:
            self.attached[name] = AttachedObject(own, link, tuple(message.touch_links), float(message.weight))


def _warn_of_base(state: Any) -> None:
    """Warn of joints that place the robot away from the origin."""
    for name, transform in zip(state.joint_names, state.transforms, strict=False):
        at, turn = transform.translation, transform.rotation
        if max(abs(at.x), abs(at.y), abs(at.z)) > MOVED or abs(turn.w) < 1.0 - MOVED:
            warnings.warn(
                f"the joint '{shortened(name)}' places the robot at ({at.x:g}, {at.y:g}, {at.z:g}) m, which is not "
                "read: have the robot's description place its base there",
                ComoveWarning,
                stacklevel=2,
            )


def _applied(messages: list[tuple[str, Any]], path: Path) -> PlanningScene:
    """Return the planning scene after all messages."""
    monitor = _Monitor()
    apply = {
        SCENE: monitor.of_scene,
        OBJECT: monitor.of_object,
        ATTACHED: monitor.of_attached,
        WORLD: monitor.of_world,
    }
    kind, first = messages[0]
    if kind == SCENE and first.is_diff:
        message = (
            f"{path}: no planning scene in it is whole, so objects from before the recording are missing"
        )
        warnings.warn(message, ComoveWarning, stacklevel=2)
    for kind, message in messages:
        apply[kind](message)
    monitor.require_still()
    scene, objects = monitor.scene, tuple(monitor.objects.values())
    frames = {one.frame for one in objects}
    if not scene.frame and len(frames) == 1:
        scene = replace(scene, frame=frames.pop())
    return replace(scene, objects=objects, attached=tuple(monitor.attached.values()))


def object_of(message: Any) -> CollisionObject:
    """Return the object in a message. As in MoveIt, one shape without the object's pose gives its own to it.

    Raises
    ------
    SceneError
        If it has a pose that is none, or a shape without its sizes.
    """
    name = message.id
    pose, shapes = _pose(message.pose, name), tuple(_shapes(message))
    if len(shapes) == 1 and np.array_equal(pose, np.eye(4)):
        pose, shapes = shapes[0].pose, (shapes[0]._replace(pose=np.eye(4)),)
    return CollisionObject(name, pose, shapes, frame_name(message.header.frame_id))


def _shapes(message: Any) -> Iterator[PlacedShape]:
    """Yield the shapes of an object; missing poses are the object's own."""
    name, where = message.id, f"'{shortened(message.id)}'"

    def posed(kind: str, shapes: Any, poses: Any) -> Iterator[tuple[Any, Array]]:
        if len(poses) > len(shapes):
            told = f"the object {where} has {len(shapes)} {kind} and {len(poses)} poses of them"
            raise SceneError(told, way_out="record it anew")
        for i, shape in enumerate(shapes):
            yield shape, _pose(poses[i], name) if i < len(poses) else np.eye(4)

    for shape, pose in posed("primitives", message.primitives, message.primitive_poses):
        kind = KINDS.get(int(shape.type), f"number {int(shape.type)}")
        sizes = np.array(shape.dimensions, dtype=np.float64)
        if len(sizes) != N_DIMENSIONS.get(kind, len(sizes)) or not np.isfinite(sizes).all():
            told = f"the object {where} has a {kind} of the dimensions {sizes.tolist()}"
            raise SceneError(told, way_out="correct it where it is made, and record it anew")
        yield PlacedShape(kind, sizes[::-1] if kind in ("cylinder", "cone") else sizes, pose, where)
    for shape, pose in posed("meshes", message.meshes, message.mesh_poses):
        points = [(point.x, point.y, point.z) for point in shape.vertices]
        vertices = np.array(points, dtype=np.float64).reshape(-1, 3)
        faces = np.array([one.vertex_indices for one in shape.triangles], dtype=np.int64).reshape(-1, 3)
        fault = fault_of_triangles(len(vertices), faces)
        if fault is not None or not np.isfinite(vertices).all():
            told = f"the object {where}: {fault or 'vertices are not finite'}"
            raise SceneError(told, way_out="correct it where it is made, and record it anew")
        yield PlacedShape("mesh", np.empty(0), pose, where, (vertices, faces))
    for shape, pose in posed("planes", message.planes, message.plane_poses):
        yield PlacedShape("plane", np.array(shape.coef, dtype=np.float64), pose, where)


def _pose(message: Any, name: str) -> Array:
    """Return the pose in a message; array, shape (4, 4). Without an orientation it is not turned."""
    position, turn = message.position, message.orientation
    quaternion = np.array([turn.x, turn.y, turn.z, turn.w])
    if not quaternion.any():
        quaternion[3] = 1.0
    at = np.array([position.x, position.y, position.z])
    pose = homogeneous(at, quaternion)
    if pose is None or not np.isfinite(at).all():
        told = f"'{shortened(name)}' has a pose at {at.tolist()} with the quaternion {quaternion.tolist()}"
        raise SceneError(told, way_out="write a unit quaternion, w last, and record it anew")
    return pose


def _transform(message: Any, name: str) -> Array:
    """Return the pose in a transform; array, shape (4, 4)."""
    return _pose(SimpleNamespace(position=message.translation, orientation=message.rotation), name)


def _allowed(matrix: Any) -> frozenset[frozenset[str]]:
    """Return the pairs of names that may touch; a name alone may touch all others."""
    names = list(matrix.entry_names)
    pairs = {
        frozenset((names[i], names[j]))
        for i, row in enumerate(matrix.entry_values[: len(names)])
        for j, enabled in enumerate(row.enabled[: len(names)])
        if enabled and i != j
    }
    alone = zip(matrix.default_entry_names, matrix.default_entry_values, strict=False)
    return frozenset(pairs | {frozenset((name,)) for name, enabled in alone if enabled})


def frame_name(name: str) -> str:
    """Return a frame's name without the slash of ROS 1."""
    return name.removeprefix("/")
