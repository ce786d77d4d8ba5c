"""Bags of ROS 1 and ROS 2: exact round trips, messages of others, and damage told."""

import os
import struct
import time
import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from comove.dmp.demonstrations import Demonstration, read_rosbag, write_rosbag
from comove.dmp.demonstrations.formats import rosbag
from comove.errors import ComoveWarning, DemonstrationError

pytest.importorskip("rosbags")
from rosbags import rosbag1
from rosbags.typesys import Stores, get_typestore

from tests.cases import examples
from tests.dmp.demonstrations.formats.bags import TYPES, bag, header, joint_state, make, point, pose_stamped

KINDS = ["one.bag", "one.mcap", "one.db3", "folder", "sqlite"]
FILES = KINDS[:3]
SHARED_FOLDER = examples(20, suppress_health_check=[HealthCheck.function_scoped_fixture])


def write(path, demos, **options):
    write_rosbag(path, demos, storage="sqlite3" if path.name == "sqlite" else "mcap", **options)
    return path


@pytest.fixture
def path(tmp_path):
    return tmp_path / "bag"


@pytest.mark.parametrize("name", KINDS)
@SHARED_FOLDER
@given(st.integers(2, 30), st.integers(0, 2**32 - 1))
@pytest.mark.few(2)
def test_what_is_written_is_read_bit_by_bit(tmp_path_factory, hand, name, n_steps, seed):
    rng = np.random.default_rng(seed)
    stamps = np.concatenate(([0], np.cumsum(rng.integers(1, 10**9, n_steps - 1)))) / 1e9
    turned, plain, arm = (
        hand(seed, n_steps),
        hand(seed, n_steps, turned=False),
        hand(seed, n_steps, n_dims=14),
    )
    axes = tuple(f"joint {i}" for i in range(14))
    demos = {
        "left": Demonstration(stamps, turned.position, orientation=turned.orientation),
        "right": Demonstration(stamps, plain.position),
        "torso": Demonstration(stamps + 0.0, arm.position, unit="rad", axes=axes),
    }
    path = write(tmp_path_factory.mktemp("bags") / name, demos)
    again = read_rosbag(path)
    assert list(again) == ["/left/pose", "/right/point", "/torso/joint_states"]
    for demo, written in zip(again.values(), demos.values(), strict=True):
        assert demo.time.tobytes() == written.time.tobytes()
        assert demo.position.tobytes() == written.position.tobytes()
        assert (demo.unit, demo.axes) == (written.unit, written.axes)
    assert again["/left/pose"].orientation.tobytes() == demos["left"].orientation.tobytes()
    assert again["/right/point"].orientation is None


@pytest.mark.parametrize("name", KINDS)
def test_others_read_what_is_written(tmp_path, hand, name):
    """The library's own readers, with the definitions in the bag, see the same poses in the order of ROS."""
    from rosbags.highlevel import AnyReader

    demo = hand()
    path = write(tmp_path / name, demo, frame_id="base", start_ns=5 * 10**9)
    with AnyReader([path]) as reader:
        ((connection, stamp, raw), *_) = reader.messages()
        message = reader.deserialize(raw, connection.msgtype)
    assert (connection.topic, connection.msgtype) == ("/pose", "geometry_msgs/msg/PoseStamped")
    assert stamp == 5 * 10**9
    assert (message.header.frame_id, message.header.stamp.sec) == ("base", 5)
    turn = message.pose.orientation
    np.testing.assert_array_equal([turn.w, turn.x, turn.y, turn.z], demo.orientation[0])
    if path.is_dir():
        assert set(os.listdir(path)) == {"metadata.yaml", f"{name}.{'db3' if name == 'sqlite' else 'mcap'}"}
    assert os.listdir(tmp_path) == [name]


def test_headers_tell_the_time_and_where_they_do_not_the_bag_does(path):
    late = [
        ("/p", "geometry_msgs/PoseStamped", 9 * 10**9 + k, pose_stamped(k * 1.0, 10**9 + k * 10**8))
        for k in range(3)
    ]
    (demo,) = read_rosbag(bag(path, late)).values()
    np.testing.assert_array_equal(demo.time, [0.0, 0.1, 0.2])
    assert demo.notes == ()
    mute = [("/p", "geometry_msgs/PoseStamped", 10**9 * (2 + k), pose_stamped(k * 1.0, 0)) for k in range(3)]
    (demo,) = read_rosbag(bag(path.with_name("mute"), mute)).values()
    np.testing.assert_array_equal(demo.time, [0.0, 1.0, 2.0])
    assert demo.notes[0] == "headers without a stamp: time is that of the bag"


def test_two_topics_say_how_much_later_the_second_began(path, hand):
    messages = [
        (topic, "geometry_msgs/PoseStamped", 10**9, pose_stamped(k * 1.0, 10**18 + (k + late) * 10**7))
        for topic, late in (("/a", 0), ("/b", 3))
        for k in range(3)
    ]
    demos = read_rosbag(bag(path, messages))
    assert demos["/a"].notes == ()
    assert demos["/b"].notes == ("time shifted by -0.03 s to start at 0",)


def test_all_types_are_read(path):
    second, turn = 10**9, make("Quaternion", x=0.0, y=0.0, z=0.6, w=0.8)
    covariance = np.zeros(36)
    twist = make("Twist", linear=point(kind="Vector3"), angular=point(kind="Vector3"))
    trajectory_point = TYPES["trajectory_msgs/msg/JointTrajectoryPoint"]

    def poses(n):
        return [pose_stamped(0.5 * k, (3 + k) * second, z=0.6, w=0.8) for k in range(n)]

    def points(n):
        none = np.empty(0)
        return [
            trajectory_point(
                positions=np.array([0.1 * k, 0.5 * k]),
                velocities=none,
                accelerations=none,
                effort=none,
                time_from_start=make("Duration", sec=k, nanosec=0),
            )
            for k in range(n)
        ]

    messages = []
    for k in range(3):
        stamp, stamped = (3 + k) * second, header((3 + k) * second)
        moved = make("Pose", position=point(0.5 * k), orientation=turn)
        transform = make("Transform", translation=point(0.5 * k, kind="Vector3"), rotation=turn)
        for topic, kind, message in [
            (
                "/point",
                "geometry_msgs/PointStamped",
                make("PointStamped", header=stamped, point=point(0.5 * k)),
            ),
            ("/pose", "geometry_msgs/PoseStamped", make("PoseStamped", header=stamped, pose=moved)),
            (
                "/transform",
                "geometry_msgs/TransformStamped",
                make("TransformStamped", header=stamped, child_frame_id="hand", transform=transform),
            ),
            (
                "/odometry",
                "nav_msgs/Odometry",
                make(
                    "nav_msgs/Odometry",
                    header=stamped,
                    child_frame_id="hand",
                    pose=make("PoseWithCovariance", pose=moved, covariance=covariance),
                    twist=make("TwistWithCovariance", twist=twist, covariance=covariance),
                ),
            ),
            ("/path", "nav_msgs/Path", make("nav_msgs/Path", header=stamped, poses=poses(k + 1))),
            ("/joints", "sensor_msgs/JointState", joint_state(["a", "b"], [0.1 * k, 0.5 * k], stamp)),
            (
                "/plan",
                "trajectory_msgs/JointTrajectory",
                make(
                    "trajectory_msgs/JointTrajectory",
                    header=stamped,
                    joint_names=["a", "b"],
                    points=points(k + 1),
                ),
            ),
            ("/word", "std_msgs/String", TYPES["std_msgs/msg/String"](data="hello")),
        ]:
            messages.append((topic, kind, stamp, message))
    bag(path, messages)
    assert list(rosbag.topics(path)) == sorted(t for t in {m[0] for m in messages} if t != "/word")
    demos = read_rosbag(path)
    for topic, demo in demos.items():
        np.testing.assert_array_equal(demo.time, [0.0, 1.0, 2.0], err_msg=topic)
        if demo.axes:
            assert (demo.axes, demo.unit) == (("a", "b"), "rad")
            np.testing.assert_allclose(demo.position, np.outer(range(3), [0.1, 0.5]))
        else:
            np.testing.assert_array_equal(demo.position, np.outer(range(3), [0.5, 0, 0]), err_msg=topic)
            if topic != "/point":
                np.testing.assert_array_equal(demo.orientation, [[0.8, 0, 0, 0.6]] * 3)
    assert "the last of 3 messages" in demos["/path"].notes


def test_quaternions_that_nobody_set_are_left_out(path):
    stamps = [(k + 1) * 10**8 for k in range(3)]
    messages = [("/p", "geometry_msgs/PoseStamped", t, pose_stamped(t * 1e-9, t, w=0.0)) for t in stamps]
    (demo,) = read_rosbag(bag(path, messages)).values()
    assert demo.orientation is None
    assert demo.notes == ("all quaternions are zero: orientations left out",)


def poses(*rows, topic="/p"):
    return [
        (topic, "geometry_msgs/PoseStamped", 10**9 + k, pose_stamped(x, int(t * 1e9), w=w))
        for k, (t, x, w) in enumerate(rows)
    ]


NAN = float("nan")


@pytest.mark.parametrize(
    ("messages", "key", "says", "way_out"),
    [
        (poses((1, 0.0, 1.0)), "time", "this one has 1", "record more"),
        (poses((1, 0.0, 1.0), (2, NAN, 1.0)), "/p, sample 1, coordinate 0", "nan", "remove"),
        (
            poses((1, 0.0, 1.0), (2, 0.0, 0.0)),
            "/p, sample 1, orientation",
            "norm 0, not 1",
            "unit quaternions",
        ),
        (poses((2, 0.0, 1.0), (2, 1.0, 1.0)), "/p, sample 1, stamp", "passes only 1e-09 s in all", "seconds"),
        ([("/p", "geometry_msgs/PoseStamped", 1, None)], "/p", "no messages", "another topic"),
        (
            [("/p", "nav_msgs/Path", 1, make("nav_msgs/Path", header=header(1), poses=[]))],
            "/p",
            "path is empty",
            "another topic",
        ),
        (
            [("/j", "sensor_msgs/JointState", 1, joint_state(["a", "b"], [], 1))],
            "/j",
            "no message has positions",
            "another topic",
        ),
        (
            [("/j", "sensor_msgs/JointState", 1, joint_state(["a", "b"], [1.0], 1))],
            "/j, sample 0",
            "1 positions of 2 joints",
            "every joint",
        ),
        (
            [("/j", "sensor_msgs/JointState", k, joint_state(["a", "a"], [1.0, k], k)) for k in (1, 10**9)],
            "/j",
            "'a' stands twice",
            "name of its own",
        ),
        (
            [("/w", "std_msgs/String", 1, TYPES["std_msgs/msg/String"](data="hello"))],
            None,
            r"holds /w \(std_msgs/msg/String\)",
            "read are geometry_msgs/PoseStamped",
        ),
        (
            [("/p", "geometry_msgs/PoseStamped", 1, b"\0\1\0\0ab")],
            None,
            "no whole bag .*deserialize",
            "reindex",
        ),
        (
            [("/j", "sensor_msgs/JointState", 1, b"\0\1\0\0" + bytes(12) + b"\xff" * 8)],
            None,
            "no whole bag",
            "reindex",
        ),
    ],
)
def test_what_is_no_movement_is_told(path, refused, messages, key, says, way_out):
    refused(read_rosbag, bag(path, messages), key=key, says=says, way_out=way_out)


def test_topics_are_listed_with_their_types(path, hand):
    write_rosbag(path, {"left": hand(), "right": hand(1)})
    assert list(read_rosbag(path, topic="/right/pose")) == ["/right/pose"]
    says = r"topic: there is no '/rigth/pose'; did you mean '/right/pose'\? known: /left/pose \(geometry_msgs/msg/P"
    with pytest.raises(DemonstrationError, match=says):
        read_rosbag(path, topic="/rigth/pose")


@pytest.mark.parametrize("name", FILES)
def test_files_cut_anywhere_are_refused(tmp_path, hand, cut_anywhere, name):
    path = write(tmp_path / name, {"left": hand(), "right": hand(1, n_dims=7, turned=False, unit="rad")})
    cut_anywhere(lambda: read_rosbag(path), path, step=41)


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_files_cut_at_every_byte_are_refused(tmp_path, hand, cut_anywhere, name):
    path = write(tmp_path / name, hand())
    cut_anywhere(lambda: read_rosbag(path), path)


@pytest.mark.parametrize("name", ["folder", "sqlite"])
def test_folders_with_a_cut_file_are_refused(tmp_path, hand, name):
    path = write(tmp_path / name, hand())
    (file,) = (file for file in path.iterdir() if file.suffix != ".yaml")
    content = file.read_bytes()
    for length in range(0, len(content), 97):
        file.write_bytes(content[:length])
        with pytest.raises(DemonstrationError, match=r"no whole bag|its header says|no SQLite|is empty"):
            read_rosbag(path)
    file.unlink()
    with pytest.raises(DemonstrationError, match="missing"):
        read_rosbag(path)


@pytest.mark.parametrize("name", FILES)
def test_damage_is_read_or_told(tmp_path, hand, damaged, name):
    path = write(tmp_path / name, hand())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ComoveWarning)
        damaged(lambda: list(read_rosbag(path).values()), path, 150)


def test_an_index_that_promises_more_messages_is_told(path, hand, monkeypatch):
    write_rosbag(path, hand())
    file = path / "metadata.yaml"
    file.write_text(file.read_text().replace("message_count: 12", "message_count: 13"))
    with pytest.raises(DemonstrationError, match="/pose: it has 12 messages and the index says 13"):
        read_rosbag(path)
    monkeypatch.setattr(rosbag, "MAX_ROWS", 10)
    with pytest.raises(DemonstrationError, match="/pose: it has 13 messages; up to 10"):
        read_rosbag(path)


def test_bags_of_ros_1_without_an_index_are_told(tmp_path, hand):
    path = write(tmp_path / "one.bag", hand())
    content = path.read_bytes()
    at = content.index(b"index_pos=") + len(b"index_pos=")
    path.write_bytes(content[:at] + struct.pack("<Q", 0) + content[at + 8 :])
    with pytest.raises(DemonstrationError, match=r"not indexed.*rosbag reindex"):
        read_rosbag(path)


def test_bags_of_ros_1_by_others_are_read(tmp_path):
    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    path = tmp_path / "theirs.bag"
    with rosbag1.Writer(path) as writer:
        writer.set_compression(rosbag1.Writer.CompressionFormat.LZ4) if writer.bio is None else None
        connection = writer.add_connection("/hand", "geometry_msgs/msg/PointStamped", typestore=store)
        for k in range(4):
            stamp = types["builtin_interfaces/msg/Time"](sec=7, nanosec=k * 10**6)
            head = types["std_msgs/msg/Header"](seq=k, stamp=stamp, frame_id="")
            where = types["geometry_msgs/msg/Point"](x=1.0 * k, y=0.0, z=0.0)
            message = types["geometry_msgs/msg/PointStamped"](header=head, point=where)
            writer.write(connection, k, store.serialize_ros1(message, connection.msgtype))
    (demo,) = read_rosbag(path).values()
    np.testing.assert_array_equal(demo.position[:, 0], range(4))
    np.testing.assert_array_equal(demo.time, np.arange(4) / 1e3)
    assert demo.name == "theirs/hand"


def test_what_does_not_fit_is_not_written(tmp_path, refused, hand):
    path = tmp_path / "one.mcap"
    joints = hand(unit="rad", axes=("a", "b", "c"))
    for demos, says, way_out in [
        ({}, "no movement", "give one"),
        ({"left arm": hand()}, "'left arm' is no name in ROS", "letter"),
        (hand(n_dims=2, turned=False), "2 dimensions", "into space"),
        ({"a": joints}, "a has joints and orientations", "two movements"),
    ]:
        for name in ("one.mcap", "one.bag", "folder"):
            refused(
                lambda p, d=demos: write_rosbag(p, d), tmp_path / name, key=None, says=says, way_out=way_out
            )
    with pytest.raises(DemonstrationError, match="storage: 'zip' is no storage; choose mcap or sqlite3"):
        write_rosbag(path, hand(), storage="zip")
    assert os.listdir(tmp_path) == []
    write_rosbag(path, hand())
    write_rosbag(path, hand(1))
    assert read_rosbag(path)["/pose"].position.tobytes() == hand(1).position.tobytes()
    folder = tmp_path / "folder"
    write_rosbag(folder, hand())
    refused(lambda p: write_rosbag(p, hand()), folder, key=None, says="not empty", way_out="name another")
    nowhere = tmp_path / "no" / "one.bag"
    refused(lambda p: write_rosbag(p, hand()), nowhere, key=None, says="written", way_out="check")
    assert sorted(os.listdir(tmp_path)) == ["folder", "one.mcap"]


def test_paths_that_are_no_bag_are_told(tmp_path, refused):
    for name in FILES:
        refused(read_rosbag, tmp_path / name, key=None, says="no such file", way_out="check the path")
    (tmp_path / "one.db3").write_bytes(b"time,x\n" * 100)
    refused(read_rosbag, tmp_path / "one.db3", key=None, says="no SQLite database", way_out="copy it again")
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(DemonstrationError, match=r"metadata\.yaml: there is no such file; check the path"):
        read_rosbag(empty)


def test_a_missing_library_names_the_command(tmp_path, refused, hand, without):
    path = write(tmp_path / "one.bag", hand())
    without("rosbags")
    command = r"run: pip install 'comove\[data\]'"
    refused(read_rosbag, path, key=None, says="needs rosbags", way_out=command)
    refused(lambda p: write_rosbag(p, hand()), path, key=None, says="needs rosbags", way_out=command)


def test_a_database_is_compared_with_its_own_header(tmp_path, refused, hand):
    path = write(tmp_path / "one.db3", hand())
    content = path.read_bytes()
    for length in (len(content) - 1, len(content) - 4096, 4096):
        path.write_bytes(content[:length])
        says = f"it has {length} bytes and its header says {len(content)}"
        refused(read_rosbag, path, key=None, says=says, way_out="reindex")


def test_messages_are_written_in_the_order_of_their_stamps(tmp_path, hand):
    import sqlite3

    path = write(tmp_path / "one.db3", {"left": hand(), "right": hand(1, rate=33.0)})
    with sqlite3.connect(path) as database:
        rows = database.execute("SELECT timestamp, topic_id FROM messages ORDER BY id").fetchall()
    assert rows == sorted(rows)
    assert {topic for _, topic in rows[:6]} == {1, 2}


def changed_anywhere(read, file, step):
    """How often one changed byte of a file is told, and how often it changes nothing that is read."""
    content, before = file.read_bytes(), numbers(read())
    told = same = 0
    for at in range(0, len(content), step):
        file.write_bytes(content[:at] + bytes([content[at] ^ 4]) + content[at + 1 :])
        try:
            after = numbers(read())
        except DemonstrationError:
            told += 1
        else:
            assert after == before, at
            same += 1
    file.write_bytes(content)
    return told, same


def numbers(demos):
    return [
        (name, demo.time.tobytes(), demo.position.tobytes(), demo.orientation.tobytes())
        for name, demo in demos.items()
    ]


def test_every_changed_byte_of_an_mcap_is_told(tmp_path, hand):
    """By its checksums, which the library does not write and mostly does not read."""
    write_rosbag(tmp_path / "a.mcap", {"left": hand(0), "right": hand(1)})
    told, same = changed_anywhere(lambda: read_rosbag(tmp_path / "a.mcap"), tmp_path / "a.mcap", 7)
    assert same <= 0.02 * told


def test_a_bag_without_checksums_is_read_as_it_stands(tmp_path, hand):
    """ROS 1 and SQLite have none, and an MCAP need not: there another number is another movement."""
    write_rosbag(tmp_path / "a.bag", hand(0))
    (before,) = read_rosbag(tmp_path / "a.bag").values()
    content = (tmp_path / "a.bag").read_bytes()
    number = before.position[3, 0].tobytes()
    (tmp_path / "a.bag").write_bytes(content.replace(number, (-before.position[3, 0]).tobytes()))
    (after,) = read_rosbag(tmp_path / "a.bag").values()
    assert after.position[3, 0] == -before.position[3, 0]
    pytest.importorskip("mcap")
    from mcap.reader import make_reader

    write_rosbag(tmp_path / "a.mcap", hand(0))
    with open(tmp_path / "a.mcap", "rb") as file:  # another implementation agrees with the checksums
        assert len(list(make_reader(file, validate_crcs=True).iter_messages())) == before.n_steps


def test_what_only_ends_in_mcap_is_told_at_once(tmp_path):
    """200 MB of zeros, which are 22 million records of length 0."""
    with open(tmp_path / "a.mcap", "wb") as file:
        file.truncate(200_000_000)
    before = time.process_time()
    with pytest.raises(DemonstrationError, match="no whole bag"):
        read_rosbag(tmp_path / "a.mcap")
    assert time.process_time() - before < 60.0  # of processor time: about 1 s
