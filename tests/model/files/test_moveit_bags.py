"""Planning scenes in bags of ROS 2 are what MoveIt's planning scene monitor has after the same messages."""

import time
import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from comove.errors import ComoveWarning, InputError
from comove.geometry.meshes import MAX_FACES
from comove.model.files.moveit import mesh_in, obstacles_in, planning_scene_in
from comove.model.files.moveit_bags import DEFINITIONS
from comove.model.scene import Scene
from tests.model.files.planning_scenes import (
    ADD,
    APPEND,
    MESSAGES,
    MOVE,
    OBJECT,
    REMOVE,
    SCENE,
    WORLD,
    Messages,
)
from tests.model.files.test_imported import MOVEIT

pytest.importorskip("rosbags")

MONITORED = "/move_group/monitored_planning_scene"
QUARTER = (0, 0, np.sqrt(0.5), np.sqrt(0.5))
PUBLISHED = {
    "object_recognition_msgs/msg/ObjectType": "5eb3ee3976403366d7c50d7dbee8bec96b3bced1e752674a7194a35841632134",
    "octomap_msgs/msg/Octomap": "9891a19a05b70ec20aa8f45db3f8300b9ab80afff32c61c549d25087da9625b0",
    "octomap_msgs/msg/OctomapWithPose": "e65f8760aa96a2acef86b6d206175cfc78420082b6159dd3fa6ebf93f5f81979",
    "moveit_msgs/msg/CollisionObject": "74b0acd6d56be032bf4f764b2c2633f50588b5fb2bd71e97206c59052747cf7e",
    "moveit_msgs/msg/AttachedCollisionObject": "7fdfe7951a33a857f20fc42c9ed410a38d06dd0c209ac774ecea746dc487dc41",
    "moveit_msgs/msg/RobotState": "7c516dc15713e545cb2836c5ca745fbdcfcc10de4855a41c83e6b4bf1afc3f83",
    "moveit_msgs/msg/AllowedCollisionEntry": "eeb7cc3f1bfdb8c778aa7454ae90037c2749dab3ca0abdfe3dad2ae8723977db",
    "moveit_msgs/msg/AllowedCollisionMatrix": "ac0159eec0d99f73158c7349c9d1c01b3dc7f749d75a2ea22e74a2a1091a9b05",
    "moveit_msgs/msg/LinkPadding": "864762d9e19f758b0385427f75691374cae830495727c96405f2bad0eb20c766",
    "moveit_msgs/msg/LinkScale": "4666a0685f26365ccf4c9bfed0b14c654604fa0564be65c221d8d54fdc7a0f83",
    "moveit_msgs/msg/ObjectColor": "4f937f7b22942a9c4a6409c20255aaad1b5d9a003ae3c0edb779698be443c127",
    "moveit_msgs/msg/PlanningSceneWorld": "e08e6a4a81ca6b6a6953ac758dadc2c949555093efea6a9a22d9accf62c2c099",
    "moveit_msgs/msg/PlanningScene": "0f58540ad5eab4b9ea827d53b763c793d8cabd202b3b301fcee25afa4ce1bd80",
    "moveit_msgs/msg/RobotTrajectory": "af1dc87fb94d13e5f233e9c210d2662fa06143a8b3c6aec47c57ad45074fcce8",
}
"""Hashes of types (RIHS01) in code that ROS 2 generates, in which bags since Iron name their types."""
TETRAHEDRON = (
    [(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1)],
    [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)],
)


@pytest.fixture(scope="module")
def messages():
    return Messages()


def bag_of(messages, path, *scenes, topic=MONITORED, **how):
    return messages.bag(path, [(topic, SCENE, scene) for scene in scenes], **how)


def by_name(path):
    """Obstacles by name, in a list where one name has several."""
    found = {}
    for entry in obstacles_in(path):
        found.setdefault(entry["name"], []).append(entry)
    return found


def scene_of(path, **keys):
    """A scene among the obstacles of a bag."""
    return Scene.from_dict(
        {
            "version": 2,
            "name": "cell",
            "workspace": {"lower": [-9] * 3, "upper": [9] * 3},
            "obstacles": [{"shape": "moveit", "file": path.name, **keys}],
            "end_effectors": {"hand": {"start": [-5, 0, 0], "goal": [-5, 1, 0]}},
        },
        folder=path.parent,
    )


@pytest.fixture(scope="module")
def kitchen(messages):
    """The scene that `MOVEIT` is in the text format."""
    turn = (0, 0, 0.70710678118, 0.70710678118)
    top = [
        ("box", [1.0, 0.5, 0.04], ([0.1, 0, 0], [0, 0, 0, 1])),
        ("sphere", [0.05], ([0.2, 0.1, 0.3], [0.5] * 4)),
    ]
    solid = [("mesh", TETRAHEDRON, ([0.8, 0.3, 0.5], [0, 0, 1, 0]))]
    return messages.scene(
        [
            messages.object("table top", top, ([0.5, 0, 0.4], turn)),
            messages.object("tetrahedron", solid, ([0, 0, 0.2], [0, 0, 0, 1])),
        ]
    )


@pytest.mark.parametrize(
    ("name", "how"),
    [
        ("bag", {"version": 8}),
        ("bag", {"version": 9}),
        ("bag", {"version": 8, "storage": "MCAP"}),
        ("cell.mcap", {"version": 9, "storage": "MCAP"}),
    ],
)
def test_a_bag_is_the_same_scene_as_the_text(messages, kitchen, tmp_path, name, how):
    """Whatever holds it; which reader is wanted is told by the file."""
    text = tmp_path / "cell.scene"
    text.write_text(MOVEIT)
    path = bag_of(messages, tmp_path / name, kitchen, **how)
    wanted, found = scene_of(text).file.obstacles, scene_of(path).file.obstacles
    for one, other in zip(found, wanted, strict=True):
        assert one.name == other.name and one.center == pytest.approx(other.center, abs=1e-12)
        assert getattr(one, "size", None) == getattr(other, "size", None)
        assert getattr(one, "radius", None) == getattr(other, "radius", None)
        if one.shape != "sphere":
            assert one.quaternion_wxyz == pytest.approx(other.quaternion_wxyz, abs=1e-9)
    assert mesh_in(path, 0) == mesh_in(text, 0)


def test_definitions_are_those_of_moveit_msgs(messages):
    """Of the same fields in the same order the types have the same hash; names of fields count."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    own = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        own.register(get_types_from_msg(text, name))
    assert set(DEFINITIONS) == set(MESSAGES)
    for name in MESSAGES:
        assert own.hash_rihs01(name) == messages.store.hash_rihs01(name)
        if name in PUBLISHED:
            assert own.hash_rihs01(name) == f"RIHS01_{PUBLISHED[name]}"


def test_cylinders_are_height_and_radius_in_messages(messages, tmp_path):
    path = bag_of(
        messages, tmp_path / "bag", messages.scene([messages.object("can", [("cylinder", [0.3, 0.1])])])
    )
    (can,) = scene_of(path).file.obstacles
    assert (can.height, can.radius) == (0.3, 0.1)
    text = tmp_path / "can.scene"
    text.write_text("x\n* can\n0 0 0\n0 0 0 1\n1\ncylinder\n0.1 0.3\n0 0 0\n0 0 0 1\n0 0 0 0\n0\n.\n")
    (same,) = scene_of(text).file.obstacles
    assert (same.height, same.radius) == (0.3, 0.1)


def test_a_plane_is_solid_below(messages, tmp_path):
    plane = messages.object("floor", [("plane", [0, 0, 2, -0.5])])
    (slab,) = obstacles_in(bag_of(messages, tmp_path / "bag", messages.scene([plane])))
    assert slab["center"][2] + 0.5 * slab["size"][2] == pytest.approx(0.25)


def test_later_diffs_change_the_last_whole_scene(messages, tmp_path):
    """In the order of the messages: added, replaced, appended, moved, removed."""
    box = [("box", [0.1, 0.2, 0.3])]
    first = messages.scene([messages.object("gone", box), messages.object("before", box)])
    whole = messages.scene(
        [messages.object(name, box, ([i, 0, 0], [0, 0, 0, 1])) for i, name in enumerate("abcd")]
    )
    diffs = [
        messages.scene([messages.object("a", operation=REMOVE)], is_diff=True),
        messages.scene([messages.object("b", pose=([5, 0, 0], QUARTER), operation=MOVE)], is_diff=True),
        messages.scene(
            [messages.object("c", [("sphere", [0.2], ([0, 0, 1], [0, 0, 0, 1]))] * 2, operation=APPEND)],
            is_diff=True,
        ),
        messages.scene([messages.object("d", [("box", [1, 1, 1])], operation=ADD)], is_diff=True),
        messages.scene([messages.object("e", box)], is_diff=True),
        messages.scene([messages.object("nobody", operation=REMOVE)], is_diff=True),
    ]
    found = by_name(bag_of(messages, tmp_path / "bag", first, whole, *diffs))
    assert set(found) == set("bcde")
    (moved,) = found["b"]
    assert moved["center"].tolist() == [5, 0, 0]
    assert abs(np.dot(moved["quaternion_wxyz"], [*QUARTER[3:], *QUARTER[:3]])) == pytest.approx(1)
    assert [one["shape"] for one in found["c"]] == ["box", "sphere", "sphere"]
    assert found["c"][1]["center"].tolist() == [2, 0, 1], "shapes are appended in the object's frame"
    assert found["d"][0]["size"] == [1, 1, 1]


def test_one_shape_without_a_pose_of_the_object_moves_with_it(messages, tmp_path):
    """As in MoveIt, which takes the shape's pose for the object's."""
    shape = ("box", [0.1, 0.2, 0.3], ([1, 2, 3], QUARTER))
    whole = messages.scene([messages.object("a", [shape])])
    moved = messages.scene(
        [messages.object("a", pose=([0, 0, 9], [0, 0, 0, 1]), operation=MOVE)], is_diff=True
    )
    (entry,) = obstacles_in(bag_of(messages, tmp_path / "bag", whole))
    assert entry["center"].tolist() == [1, 2, 3]
    (entry,) = obstacles_in(bag_of(messages, tmp_path / "moved", whole, moved))
    assert entry["center"].tolist() == [0, 0, 9]
    assert entry["quaternion_wxyz"] == pytest.approx([1, 0, 0, 0])


def test_topics_of_objects_are_read_in_their_order(messages, tmp_path):
    """Without a whole scene, as a program publishes them."""
    box = [("box", [0.1, 0.2, 0.3])]
    path = messages.bag(
        tmp_path / "bag",
        [
            ("/collision_object", OBJECT, messages.object("a", box, frame="/base")),
            (
                "/planning_scene_world",
                WORLD,
                messages.make(WORLD, collision_objects=[messages.object("w", box, frame="base")]),
            ),
            ("/collision_object", OBJECT, messages.object("b", box, frame="base")),
            ("/collision_object", OBJECT, messages.object("a", operation=REMOVE)),
        ],
    )
    assert set(by_name(path)) == {"b", "w"}
    assert planning_scene_in(path).frame == "base"
    path = messages.bag(
        tmp_path / "all",
        [
            ("/collision_object", OBJECT, messages.object("a", box)),
            ("/collision_object", OBJECT, messages.object("", operation=REMOVE)),
            ("/collision_object", OBJECT, messages.object("b", box)),
        ],
    )
    assert set(by_name(path)) == {"b"}, "without a name all are removed"


def test_what_move_group_publishes_is_read_alone(messages, tmp_path):
    """It has what others asked for, which some have published in vain."""
    box = [("box", [0.1, 0.2, 0.3])]
    path = messages.bag(
        tmp_path / "bag",
        [
            (MONITORED, SCENE, messages.scene([messages.object("known", box)])),
            ("/collision_object", OBJECT, messages.object("refused", box, frame="nowhere")),
        ],
    )
    assert set(by_name(path)) == {"known"}
    both = messages.bag(
        tmp_path / "both",
        [(f"/{name}/monitored_planning_scene", SCENE, messages.scene()) for name in ("left", "right")],
    )
    with pytest.raises(InputError, match="several planning scenes, /left/monitored_planning_scene, /right"):
        obstacles_in(both)


def test_other_frames_are_placed_by_fixed_transforms(messages, tmp_path):
    box = [("box", [0.1, 0.2, 0.3], ([0.5, 0, 0], [0, 0, 0, 1]))]
    one = messages.object("a", box, ([1, 0, 0], [0, 0, 0, 1]), frame="/cell")
    placed = messages.scene([one], frames={"cell": ([0, 0, 2], QUARTER)})
    (entry,) = obstacles_in(bag_of(messages, tmp_path / "bag", placed))
    assert entry["center"] == pytest.approx([0, 1.5, 2], abs=1e-12)
    lost = bag_of(messages, tmp_path / "lost", messages.scene([one, messages.object("b", box)]))
    told = r"lost.*the object 'a' is in the frame 'cell', whose place .*known: 'world'.*leave_out: \['a'\]"
    with pytest.raises(InputError, match=told):
        scene_of(lost)
    assert [one.name for one in scene_of(lost, leave_out=["a"]).file.obstacles] == ["b"], "the advice works"


def test_attached_objects_are_no_obstacles(messages, tmp_path):
    """Nor what was in the world before it was attached; let go of, an object is where nobody knows."""
    box = [("box", [0.1, 0.2, 0.3])]
    world = messages.scene([messages.object("a", box, ([1, 0, 0], [0, 0, 0, 1])), messages.object("b", box)])
    take = messages.scene(
        attached=[messages.attached("hand", messages.object("a", frame="hand"), ["finger"], 0.5)],
        is_diff=True,
    )
    path = bag_of(messages, tmp_path / "bag", world, take)
    assert set(by_name(path)) == {"b"}
    (held,) = planning_scene_in(path).attached
    assert (held.link, held.touch_links, held.mass) == ("hand", ("finger",), 0.5)
    assert held.object.pose[:3, 3].tolist() == [1, 0, 0] and held.object.frame == "world"
    drop = messages.scene(
        attached=[messages.attached("hand", messages.object("a", operation=REMOVE))], is_diff=True
    )
    with pytest.raises(InputError, match="'a' is in the frame 'hand, as it let go of the object'"):
        scene_of(bag_of(messages, tmp_path / "dropped", world, take, drop))
    told = messages.scene(
        [messages.object("a", box, ([3, 0, 0], [0, 0, 0, 1]))],
        attached=[messages.attached("hand", messages.object("a", operation=REMOVE))],
        is_diff=True,
    )
    found = by_name(bag_of(messages, tmp_path / "told", world, take, told))
    assert found["a"][0]["center"].tolist() == [3, 0, 0]


def test_joints_and_the_matrix_are_read(messages, tmp_path):
    first = messages.scene(
        joints={"a": 0.1, "b": 0.2}, allowed=([("hand", "cup"), ("cup", "table")], ["floor"])
    )
    second = messages.scene(joints={"b": 0.5}, is_diff=True)
    scene = planning_scene_in(bag_of(messages, tmp_path / "bag", first, second))
    assert scene.joints == {"a": 0.1, "b": 0.5}
    assert scene.allowed == {frozenset(pair) for pair in (("hand", "cup"), ("cup", "table"), ("floor",))}


def test_an_octomap_is_refused_unless_it_is_left_out(messages, tmp_path):
    one = messages.object("a", [("box", [0.1, 0.2, 0.3])])
    path = bag_of(messages, tmp_path / "bag", messages.scene([one], octomap=b"\1\2"))
    with pytest.raises(
        InputError, match=r"its octomap is not read; leave it out: leave_out: \['<octomap>'\]"
    ):
        scene_of(path)
    assert [one.name for one in scene_of(path, leave_out=["<octomap>"]).file.obstacles] == ["a"]
    with pytest.raises(InputError, match=r"leave_out: it holds no 'b'; .*known: a"):
        scene_of(path, leave_out=["b"])


def test_supports_are_named(messages, tmp_path):
    box = [("box", [0.1, 0.2, 0.3])]
    path = bag_of(
        messages, tmp_path / "bag", messages.scene([messages.object(name, box) for name in ("a b", "c")])
    )
    first, second = scene_of(path, supports=["a b"]).file.obstacles
    assert (first.name, first.support, second.support) == ("a_b", True, None)


@pytest.mark.parametrize(
    ("shape", "told"),
    [
        (("cone", [0.3, 0.1]), r"'x': no obstacle has the shape 'cone'; write it as .*leave_out: \['x'\]"),
        (("prism", [0.3]), "no obstacle has the shape 'prism'"),
        ((9, [0.3]), "no obstacle has the shape 'number 9'"),
        (("box", [0.3, 0.1]), r"'x' has a box of the dimensions \[0.3, 0.1\]"),
        (("box", [0.3, 0.1, np.nan]), "'x' has a box of the dimensions"),
        (("box", [0.3, 0.1, -1.0]), "size"),
        (("plane", [0, 0, 0, 1]), "the plane has no normal"),
        (
            ("sphere", [0.1], ([0, 0, 0], [0, 0, 0, 3])),
            r"'x' has a pose at .*quaternion \[0.0, 0.0, 0.0, 3.0\]",
        ),
        (("sphere", [0.1], ([np.inf, 0, 0], [0, 0, 0, 1])), "'x' has a pose at"),
        (("mesh", (TETRAHEDRON[0], [(0, 1, 4)])), "the mesh of 4 vertices has triangles of others"),
        (("mesh", (TETRAHEDRON[0], [])), "the mesh of 4 vertices has triangles of others, or none"),
        (("mesh", ([(np.nan, 0, 0)] * 3, [(0, 1, 2)])), "vertices are not finite"),
    ],
)
def test_hostile_shapes_are_refused(messages, tmp_path, shape, told):
    path = bag_of(messages, tmp_path / "bag", messages.scene([messages.object("x", [shape])]))
    with pytest.raises(InputError, match=told):
        scene_of(path)


def test_a_pose_without_an_orientation_is_not_turned(messages, tmp_path):
    """As in MoveIt, since programs forget to say it."""
    one = messages.object("x", [("box", [1, 2, 3])], ([1, 0, 0], [0, 0, 0, 0]))
    (entry,) = obstacles_in(bag_of(messages, tmp_path / "bag", messages.scene([one])))
    assert entry["quaternion_wxyz"] == [1, 0, 0, 0]


@pytest.mark.parametrize("name", ["bag", "cell.scene"])
def test_a_mesh_of_a_million_triangles_is_refused_in_time(messages, tmp_path, name):
    n = 1_000_000
    begin = time.process_time()
    if name == "bag":
        n = MAX_FACES + 1
        mesh = ("mesh", (TETRAHEDRON[0], [(0, 1, 2)] * n))
        path = bag_of(messages, tmp_path / name, messages.scene([messages.object("x", [mesh])]))
    else:
        path = tmp_path / name
        path.write_text(f"x\n* x\n0 0 0\n0 0 0 1\n1\nmesh\n500000 {n}\n" + "0 0 0\n" * 1000)
        begin = time.process_time()
    with pytest.raises(InputError, match=f"mesh has {n} triangles .*decimate it to {MAX_FACES}"):
        scene_of(path)
    assert time.process_time() - begin < 20.0


def test_names_with_slashes_and_spaces(messages, tmp_path):
    box = [("box", [0.1, 0.2, 0.3])]
    names = ["a/b", "a b", "../../etc", "", "Möbel ☃", "x" * 300, "$(rm)\n* fake"]
    path = bag_of(messages, tmp_path / "bag", messages.scene([messages.object(name, box) for name in names]))
    found = [one.name for one in scene_of(path).file.obstacles]
    assert len(set(found)) == len(names)
    assert found[:3] == ["a_b", "a_b_2", "etc"] and not any(set("/ \n$") & set(name) for name in found)


def test_a_bag_without_a_planning_scene_lists_its_topics(messages, tmp_path):
    state = messages.make("sensor_msgs/msg/JointState")
    path = messages.bag(tmp_path / "bag", [("/joint_states", "sensor_msgs/msg/JointState", state)])
    told = r"it holds no planning scene, but /joint_states \(sensor_msgs/msg/JointState\); record it: ros2 bag record"
    with pytest.raises(InputError, match=told):
        obstacles_in(path)


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_a_truncated_bag_is_refused(messages, kitchen, tmp_path, storage):
    path = bag_of(messages, tmp_path / "bag", kitchen, storage=storage)
    (file,) = [*path.glob("*.db3"), *path.glob("*.mcap")]
    data = file.read_bytes()
    for size in (0, 1, len(data) // 2, len(data) - 10):
        file.write_bytes(data[:size])
        with pytest.raises(InputError, match=r"it is no whole bag|empty|no SQLite|bytes|damaged|checksum"):
            obstacles_in(path)
    file.unlink()
    with pytest.raises(InputError):
        obstacles_in(path)


def test_messages_of_another_version_are_refused(tmp_path):
    """Of a field more, which would be read as the end of the message, too."""
    other = Messages(**{SCENE: MESSAGES[SCENE] + "float64 more\n"})
    path = bag_of(other, tmp_path / "bag", other.scene([other.object("x", [("box", [1, 2, 3])])]))
    with pytest.raises(InputError, match="its moveit_msgs/msg/PlanningScene is none of those that are read"):
        obstacles_in(path)


def test_a_state_that_is_no_diff_has_all_attached_objects(messages, tmp_path):
    """As in MoveIt, if it has joints at all."""
    box = [("box", [0.1, 0.2, 0.3])]
    held = messages.scene(attached=[messages.attached("hand", messages.object("a", box, frame="hand"))])
    for joints, is_diff, wanted in (({"j": 1.0}, False, 0), ({"j": 1.0}, True, 1), ({}, False, 1)):
        later = messages.scene(joints=joints, is_diff=True)
        later.robot_state.is_diff = is_diff
        scene = planning_scene_in(bag_of(messages, tmp_path / f"{len(joints)}{is_diff}", held, later))
        assert len(scene.attached) == wanted


def test_what_is_taken_from_the_world_and_moved_is_refused(messages, tmp_path):
    """Its pose on the link is that at the instant it was attached, which no message holds."""
    box = [("box", [0.1, 0.2, 0.3])]
    world = messages.scene([messages.object("a", box, ([1, 0, 0], [0, 0, 0, 1]))], joints={"j": 0.1})
    take = messages.scene(
        attached=[messages.attached("hand", messages.object("a", frame="hand"))], is_diff=True
    )
    for at, is_refused in ((0.1, False), (1.5, True)):
        path = bag_of(
            messages, tmp_path / f"{at}", world, take, messages.scene(joints={"j": at}, is_diff=True)
        )
        if is_refused:
            with pytest.raises(InputError, match="the robot moved after the object 'a' was attached"):
                planning_scene_in(path)
        else:
            assert len(planning_scene_in(path).attached) == 1


def test_a_base_elsewhere_is_warned_of(messages, tmp_path):
    for x in (0.0, 5.0):
        scene = messages.scene([messages.object("a", [("box", [0.1, 0.2, 0.3])])], joints={"j": 0.1})
        state = scene.robot_state.multi_dof_joint_state
        state.joint_names = ["world_joint"]
        state.transforms = [
            messages.make(
                "geometry_msgs/msg/Transform",
                translation=messages.make("geometry_msgs/msg/Vector3", x=x, y=0.0, z=0.0),
                rotation=messages.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
            )
        ]
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            planning_scene_in(bag_of(messages, tmp_path / f"{x}", scene))
        assert any("'world_joint' places the robot at (5, 0, 0) m" in str(w.message) for w in told) == (x > 0)


def test_diffs_alone_are_warned_of(messages, tmp_path):
    box = [("box", [0.1, 0.2, 0.3])]
    path = bag_of(messages, tmp_path / "bag", messages.scene([messages.object("a", box)], is_diff=True))
    with pytest.warns(ComoveWarning, match="no planning scene in it is whole"):
        assert set(by_name(path)) == {"a"}
    moved = messages.scene([messages.object("b", operation=MOVE)], is_diff=True)
    with (
        pytest.warns(ComoveWarning, match="no planning scene"),
        pytest.raises(InputError, match="the object 'b' is moved, and is not in the recording"),
    ):
        obstacles_in(bag_of(messages, tmp_path / "moved", moved))


def test_a_bag_of_ros_1_is_refused(tmp_path):
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(InputError, match="it is a bag of ROS 1; convert it: rosbags-convert"):
        obstacles_in(tmp_path / "old.bag")


FINITE = st.floats(-5, 5, allow_subnormal=False)
POSES = st.tuples(arrays(float, 3, elements=FINITE), st.randoms(use_true_random=False)).map(
    lambda pair: (pair[0].tolist(), Rotation.random(random_state=pair[1].randrange(2**31)).as_quat().tolist())
)
SIZES = st.floats(0.01, 3)
SHAPES = st.one_of(
    st.tuples(st.just("box"), st.tuples(SIZES, SIZES, SIZES), POSES),
    st.tuples(st.just("sphere"), st.tuples(SIZES), POSES),
    st.tuples(st.just("cylinder"), st.tuples(SIZES, SIZES), POSES),
)


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(objects=st.lists(st.tuples(POSES, st.lists(SHAPES, min_size=1, max_size=3)), min_size=1, max_size=4))
def test_text_and_messages_place_the_same_shapes_alike(messages, tmp_path, objects):
    """By a third calculation, with scipy's rotations."""
    text = ["(noname)+"]
    for i, (pose, shapes) in enumerate(objects):
        text += [f"* object {i}", *(" ".join(map(repr, part)) for part in pose), str(len(shapes))]
        for kind, sizes, own in shapes:
            given_sizes = sizes[::-1] if kind == "cylinder" else sizes
            text += [
                kind,
                " ".join(map(repr, given_sizes)),
                *(" ".join(map(repr, part)) for part in own),
                "0 0 0 0",
            ]
        text.append("0")
    file = tmp_path / "drawn.scene"
    file.write_text("\n".join([*text, ".", ""]))
    made = [messages.object(f"object {i}", shapes, pose) for i, (pose, shapes) in enumerate(objects)]
    bag = bag_of(messages, tmp_path / "drawn", messages.scene(made))
    wanted = [(pose, *shape) for pose, shapes in objects for shape in shapes]
    for path in (file, bag):
        for entry, (pose, kind, sizes, own) in zip(obstacles_in(path), wanted, strict=True):
            outer, inner = Rotation.from_quat(pose[1]), Rotation.from_quat(own[1])
            assert entry["shape"] == kind
            assert entry["center"] == pytest.approx(np.array(pose[0]) + outer.apply(own[0]), abs=1e-9)
            found = [*entry.get("size", ()), *(entry[key] for key in ("height", "radius") if key in entry)]
            assert found == pytest.approx([*sizes], abs=0)
            if kind != "sphere":
                turn = Rotation.from_quat(entry["quaternion_wxyz"], scalar_first=True)
                assert (turn.inv() * outer * inner).magnitude() < 1e-7


def test_a_recording_without_an_end_is_refused(messages, kitchen, tmp_path, monkeypatch):
    monkeypatch.setattr("comove.model.files.moveit_bags.MAX_BYTES", 1_000_000)
    path = bag_of(messages, tmp_path / "bag", *[kitchen] * 2000)
    with pytest.raises(InputError, match="take more than 1 MB; record it for a shorter time"):
        obstacles_in(path)


def test_a_result_among_the_meshes_of_a_bag_may_be_moved(messages, kitchen, tmp_path):
    """Its meshes are those of the bag that lies in it."""
    import yaml

    from tests.commands import invoke

    data = {
        "version": 2,
        "name": "cell",
        "duration": 4.0,
        "workspace": {"lower": [-9] * 3, "upper": [9] * 3},
        "obstacles": [{"shape": "moveit", "file": "cell"}],
        "end_effectors": {"hand": {"start": [-1, 0, 0], "goal": [-1, 1, 0]}},
    }
    bag_of(messages, tmp_path / "cell", kitchen)
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(data))
    assert invoke("solve", "scene.yaml", "--out", "found", folder=tmp_path).exit_code == 0
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "found").rename(tmp_path / "elsewhere" / "found")
    for path in (tmp_path / "cell").iterdir():
        path.unlink()
    done = invoke("verify", "found", folder=tmp_path / "elsewhere")
    assert done.exit_code == 0, done.output


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    where=st.floats(0, 1, exclude_max=True),
    put=st.binary(min_size=1, max_size=8),
    name=st.sampled_from(["a.mcap", "bag"]),
)
def test_damaged_bytes_are_read_or_refused_in_words(messages, kitchen, tmp_path, where, put, name):
    path, whole = tmp_path / name, tmp_path / f"{name}.whole"
    if not path.exists():
        bag_of(messages, path, kitchen, storage="MCAP" if name == "a.mcap" else "SQLITE3")
    file = next(path.glob("*.db3"), path)
    if not whole.exists():
        whole.write_bytes(file.read_bytes())
    data = bytearray(whole.read_bytes())
    at = int(where * len(data))
    data[at : at + len(put)] = put
    file.write_bytes(data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ComoveWarning)
        try:
            found = obstacles_in(path)
        except InputError:
            return
    assert all("name" in entry for entry in found)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    where=st.integers(0, len(MOVEIT) - 1), put=st.text(st.sampled_from("0 1-.*e\nab"), min_size=0, max_size=4)
)
def test_damaged_texts_are_read_or_refused_in_words(tmp_path, where, put):
    path = tmp_path / "cell.scene"
    path.write_text(MOVEIT[:where] + put + MOVEIT[where + 1 :])
    try:
        found = obstacles_in(path)
    except InputError as error:
        assert error.key is None or error.key.startswith("line ")
        return
    assert all("name" in entry for entry in found)
