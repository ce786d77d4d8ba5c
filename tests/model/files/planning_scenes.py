"""Planning scenes as bags of ROS 2, written by rosbags alone with the definitions of moveit_msgs, typed anew."""

import numpy as np

MESSAGES = {
    "object_recognition_msgs/msg/ObjectType": "string key\nstring db\n",
    "octomap_msgs/msg/Octomap": """\
std_msgs/Header header
bool binary
string id
float64 resolution
int8[] data
""",
    "octomap_msgs/msg/OctomapWithPose": """\
std_msgs/Header header
geometry_msgs/Pose origin
octomap_msgs/Octomap octomap
""",
    "moveit_msgs/msg/CollisionObject": """\
std_msgs/Header header
geometry_msgs/Pose pose
string id
object_recognition_msgs/ObjectType type
shape_msgs/SolidPrimitive[] primitives
geometry_msgs/Pose[] primitive_poses
shape_msgs/Mesh[] meshes
geometry_msgs/Pose[] mesh_poses
shape_msgs/Plane[] planes
geometry_msgs/Pose[] plane_poses
string[] subframe_names
geometry_msgs/Pose[] subframe_poses
byte ADD=0
byte REMOVE=1
byte APPEND=2
byte MOVE=3
byte operation
""",
    "moveit_msgs/msg/AttachedCollisionObject": """\
string link_name
CollisionObject object
string[] touch_links
trajectory_msgs/JointTrajectory detach_posture
float64 weight
""",
    "moveit_msgs/msg/RobotState": """\
sensor_msgs/JointState joint_state
sensor_msgs/MultiDOFJointState multi_dof_joint_state
AttachedCollisionObject[] attached_collision_objects
bool is_diff
""",
    "moveit_msgs/msg/AllowedCollisionEntry": "bool[] enabled\n",
    "moveit_msgs/msg/AllowedCollisionMatrix": """\
string[] entry_names
AllowedCollisionEntry[] entry_values
string[] default_entry_names
bool[] default_entry_values
""",
    "moveit_msgs/msg/LinkPadding": "string link_name\nfloat64 padding\n",
    "moveit_msgs/msg/LinkScale": "string link_name\nfloat64 scale\n",
    "moveit_msgs/msg/ObjectColor": "string id\nstd_msgs/ColorRGBA color\n",
    "moveit_msgs/msg/PlanningSceneWorld": """\
CollisionObject[] collision_objects
octomap_msgs/OctomapWithPose octomap
""",
    "moveit_msgs/msg/PlanningScene": """\
string name
RobotState robot_state
string robot_model_name
geometry_msgs/TransformStamped[] fixed_frame_transforms
AllowedCollisionMatrix allowed_collision_matrix
LinkPadding[] link_padding
LinkScale[] link_scale
ObjectColor[] object_colors
PlanningSceneWorld world
bool is_diff
""",
    "moveit_msgs/msg/RobotTrajectory": """\
trajectory_msgs/JointTrajectory joint_trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_joint_trajectory
""",
    "moveit_msgs/msg/DisplayTrajectory": """\
string model_id
RobotTrajectory[] trajectory
RobotState trajectory_start
""",
}
"""What moveit_msgs (branch ros2) and its neighbours define, without comments."""
SCENE, OBJECT, ATTACHED, WORLD = (
    f"moveit_msgs/msg/{name}"
    for name in ("PlanningScene", "CollisionObject", "AttachedCollisionObject", "PlanningSceneWorld")
)
ADD, REMOVE, APPEND, MOVE = range(4)
TYPES = {"box": 1, "sphere": 2, "cylinder": 3, "cone": 4, "prism": 5}
HERE = ([0, 0, 0], [0, 0, 0, 1])


class Messages:
    """Makes messages of ROS 2, of which only what differs from a default is said."""

    def __init__(self, **changed):
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.store = get_typestore(Stores.ROS2_HUMBLE)
        for name, text in (MESSAGES | changed).items():
            self.store.register(get_types_from_msg(text, name))

    def make(self, kind, **given):
        """A message; fields that are not given are empty, 0 or made so themselves."""
        from rosbags.interfaces import Nodetype

        values = {}
        for name, (node, what) in self.store.fielddefs[kind][1]:
            if name in given:
                values[name] = given[name]
            elif node == Nodetype.BASE:
                values[name] = {"string": "", "bool": False}.get(what[0], 0.0 if "float" in what[0] else 0)
            elif node == Nodetype.NAME:
                values[name] = self.make(what)
            else:
                (inner, of), _ = what
                plain = inner == Nodetype.BASE and of[0] != "string"
                types = {"bool": np.bool_, "octet": np.uint8, "byte": np.uint8}
                values[name] = np.zeros(0, types.get(of[0], of[0])) if plain else []
        return self.store.types[kind](**values)

    def header(self, frame):
        """A header in a frame."""
        return self.make("std_msgs/msg/Header", frame_id=frame)

    def pose(self, position=(0, 0, 0), quaternion=(0, 0, 0, 1)):
        """A pose, of a quaternion x y z w."""
        point = dict(zip("xyz", map(float, position), strict=True))
        turn = dict(zip("xyzw", map(float, quaternion), strict=True))
        return self.make(
            "geometry_msgs/msg/Pose",
            position=self.make("geometry_msgs/msg/Point", **point),
            orientation=self.make("geometry_msgs/msg/Quaternion", **turn),
        )

    def object(self, name, shapes=(), pose=HERE, frame="world", operation=ADD):
        """A collision object of shapes (kind, sizes or vertices and triangles, pose)."""
        given = {"primitives": [], "primitive_poses": [], "meshes": [], "mesh_poses": []}
        given |= {"planes": [], "plane_poses": []}
        for kind, sizes, *own in shapes:
            own = self.pose(*(own[0] if own else HERE))
            if kind == "mesh":
                point = [
                    self.make("geometry_msgs/msg/Point", **dict(zip("xyz", v, strict=True))) for v in sizes[0]
                ]
                faces = [
                    self.make("shape_msgs/msg/MeshTriangle", vertex_indices=np.array(f, np.uint32))
                    for f in sizes[1]
                ]
                given["meshes"].append(self.make("shape_msgs/msg/Mesh", triangles=faces, vertices=point))
                given["mesh_poses"].append(own)
            elif kind == "plane":
                given["planes"].append(self.make("shape_msgs/msg/Plane", coef=np.array(sizes, float)))
                given["plane_poses"].append(own)
            else:
                sizes = np.array(sizes, dtype=float)
                number = TYPES.get(kind, kind)
                solid = self.make("shape_msgs/msg/SolidPrimitive", type=number, dimensions=sizes)
                given["primitives"].append(solid)
                given["primitive_poses"].append(own)
        return self.make(
            OBJECT, header=self.header(frame), pose=self.pose(*pose), id=name, operation=operation, **given
        )

    def attached(self, link, one, touch_links=(), weight=0.0):
        """An object attached to a link."""
        return self.make(ATTACHED, link_name=link, object=one, touch_links=list(touch_links), weight=weight)

    def scene(
        self, objects=(), *, is_diff=False, frames=None, joints=None, attached=(), allowed=None, octomap=b""
    ):
        """A planning scene in the frame `world`."""
        fixed = [
            self.make(
                "geometry_msgs/msg/TransformStamped",
                header=self.header("world"),
                child_frame_id=child,
                transform=self.transform(*pose),
            )
            for child, pose in ({} if is_diff and not frames else {"world": HERE, **(frames or {})}).items()
        ]
        state = self.make(
            "sensor_msgs/msg/JointState",
            name=list(joints or {}),
            position=np.array(list((joints or {}).values()), dtype=float),
        )
        tree = self.make(
            "octomap_msgs/msg/Octomap",
            id="OcTree" * bool(octomap),
            data=np.frombuffer(octomap, dtype=np.int8),
        )
        mapped = self.make("octomap_msgs/msg/OctomapWithPose", octomap=tree)
        world = self.make(WORLD, collision_objects=list(objects), octomap=mapped)
        robot = self.make(
            "moveit_msgs/msg/RobotState",
            joint_state=state,
            attached_collision_objects=list(attached),
            is_diff=is_diff,
        )
        return self.make(
            SCENE,
            robot_state=robot,
            fixed_frame_transforms=fixed,
            world=world,
            is_diff=is_diff,
            **({} if allowed is None else {"allowed_collision_matrix": self.matrix(*allowed)}),
        )

    def transform(self, position, quaternion):
        """A transform, of a quaternion x y z w."""
        pose = self.pose(position, quaternion)
        at = {axis: getattr(pose.position, axis) for axis in "xyz"}
        return self.make(
            "geometry_msgs/msg/Transform",
            translation=self.make("geometry_msgs/msg/Vector3", **at),
            rotation=pose.orientation,
        )

    def matrix(self, pairs, alone=()):
        """An allowed collision matrix in which these pairs may touch."""
        names = sorted({name for pair in pairs for name in pair})
        rows = [
            self.make(
                "moveit_msgs/msg/AllowedCollisionEntry",
                enabled=np.array([{a, b} in [set(pair) for pair in pairs] for b in names]),
            )
            for a in names
        ]
        return self.make(
            "moveit_msgs/msg/AllowedCollisionMatrix",
            entry_names=names,
            entry_values=rows,
            default_entry_names=list(alone),
            default_entry_values=np.ones(len(alone), dtype=bool),
        )

    def bag(self, path, messages, version=9, storage="SQLITE3"):
        """Write (topic, type, message) to a bag folder, or to an .mcap file; return its path."""
        import shutil

        from rosbags.rosbag2 import StoragePlugin, Writer

        folder = path.with_suffix(".folder") if path.suffix == ".mcap" else path
        shutil.rmtree(folder, ignore_errors=True)
        with Writer(folder, version=version, storage_plugin=StoragePlugin[storage]) as writer:
            topics = {}
            for stamp, (topic, kind, message) in enumerate(messages, start=1):
                if topic not in topics:
                    topics[topic] = writer.add_connection(topic, kind, typestore=self.store)
                writer.write(topics[topic], stamp, self.store.serialize_cdr(message, kind))
        if folder != path:
            (file,) = folder.glob("*.mcap")
            file.replace(path)
            shutil.rmtree(folder)
        return path
