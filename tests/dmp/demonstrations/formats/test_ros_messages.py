"""Movements in topics that hold several, out of order, without stamps, or of joints in any order."""

import json
import re
from datetime import UTC, datetime

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comove.dmp.demonstrations import Demonstration, read_rosbag
from comove.dmp.demonstrations.formats import rosbag
from comove.errors import DemonstrationError

pytest.importorskip("rosbags")
from rosbags import rosbag1
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.dmp.demonstrations.formats.advice import printed_options
from tests.dmp.demonstrations.formats.bags import (
    TYPES,
    bag,
    header,
    joint_state,
    make,
    point,
    pose,
    pose_stamped,
)

SECOND = 10**9
POSE, JOINTS = "geometry_msgs/PoseStamped", "sensor_msgs/JointState"


@pytest.fixture
def path(tmp_path):
    return tmp_path / "bag"


def stamped(kind, x, stamp, frame="base", child=None, **turn):
    """One message of a body at x."""
    head = make("Header", stamp=make("Time", sec=stamp // SECOND, nanosec=stamp % SECOND), frame_id=frame)
    if kind == "geometry_msgs/TransformStamped":
        rotation = pose(0.0, **turn).orientation
        moved = make("Transform", translation=point(x, kind="Vector3"), rotation=rotation)
        return make("TransformStamped", header=head, child_frame_id=child, transform=moved)
    if kind == "nav_msgs/Odometry":
        none = np.zeros(36)
        still = make("Twist", linear=point(kind="Vector3"), angular=point(kind="Vector3"))
        return make(
            "nav_msgs/Odometry",
            header=head,
            child_frame_id=child,
            pose=make("PoseWithCovariance", pose=pose(x, **turn), covariance=none),
            twist=make("TwistWithCovariance", twist=still, covariance=none),
        )
    if kind == "geometry_msgs/PoseWithCovarianceStamped":
        covered = make("PoseWithCovariance", pose=pose(x, **turn), covariance=np.zeros(36))
        return make("PoseWithCovarianceStamped", header=head, pose=covered)
    return make("PoseStamped", header=head, pose=pose(x, **turn))


def load(path, topic=None, **options):
    return Demonstration.load(path, topic=topic, **options)


def choices(path, topic=None):
    """Return the movements that a refusal names; each of them can be loaded."""
    with pytest.raises(DemonstrationError) as caught:
        load(path, topic)
    names = re.findall(r"(?<!\w)/[\w:@+.]+", caught.value.way_out.partition("; run:")[0])
    assert printed_options(caught.value) == {"topic": names[0]}
    return {name: load(path, name) for name in names}


@pytest.mark.parametrize("seed", range(5))
def test_joints_that_change_places_are_permuted(path, seed):
    rng = np.random.default_rng(seed)
    names = [f"j{i}" for i in range(5)]
    angles = rng.normal(size=(20, 5))
    messages = []
    for k in range(20):
        order = rng.permutation(5) if k else np.arange(5)
        state = joint_state([names[i] for i in order], angles[k, order], (k + 1) * 10**8)
        messages.append(("/joint_states", JOINTS, k, state))
    demo = load(bag(path, messages))
    assert demo.axes == tuple(names)
    np.testing.assert_array_equal(demo.position, angles)
    assert any("put into that of the first message" in note for note in demo.notes)


def test_joints_of_two_publishers_are_two_movements(path):
    """Neither is left out because the other is heard more often, nor merged with it."""
    messages = []
    for k in range(12):
        names = ["finger"] if k % 3 == 2 else ["a", "b"]
        state = joint_state(names, np.full(len(names), 0.1 * k), (1 + k) * 10**8)
        messages.append(("/joint_states", JOINTS, k, state))
    found = choices(bag(path, messages))
    assert list(found) == ["/joint_states:a", "/joint_states:finger"]
    assert found["/joint_states:a"].axes == ("a", "b")
    np.testing.assert_allclose(
        found["/joint_states:a"].position[:, 0], [0, 0.1, 0.3, 0.4, 0.6, 0.7, 0.9, 1.0]
    )
    np.testing.assert_allclose(found["/joint_states:finger"].position[:, 0], [0.2, 0.5, 0.8, 1.1])
    assert set(read_rosbag(path)) == set(found)
    with pytest.raises(DemonstrationError, match="there is no '/joint_states:b'"):
        load(path, "/joint_states:b")


def test_joints_of_which_one_publisher_tells_a_part_have_names_of_their_own(path):
    messages = [
        ("/j", JOINTS, k, joint_state(["a", "b"][: 1 + k % 2], [k, 0.5][: 1 + k % 2], (1 + k) * 10**8))
        for k in range(8)
    ]
    found = choices(bag(path, messages))
    assert [demo.axes for demo in found.values()] == [("a",), ("a", "b")]


def test_joints_without_names_are_numbered(path):
    messages = [("/j", JOINTS, k, joint_state([], [0.1 * k, 0.2 * k], (1 + k) * 10**8)) for k in range(4)]
    demo = load(bag(path, messages))
    assert (demo.unit, demo.axes) == ("rad", ("joint0", "joint1"))
    np.testing.assert_array_equal(demo.position[:, 1], 0.2 * np.arange(4))


@pytest.mark.parametrize("kind", ["geometry_msgs/TransformStamped", "nav_msgs/Odometry"])
def test_bodies_of_one_topic_are_told_apart_by_their_frames(path, kind):
    messages = [
        ("/tracker", kind, k, stamped(kind, x * k, (1 + k) * 10**8, child=child))
        for k in range(4)
        for child, x in (("cup", 0.5), ("spoon", 0.7))
    ]
    found = choices(bag(path, messages))
    assert list(found) == ["/tracker:cup", "/tracker:spoon"]
    np.testing.assert_array_equal(found["/tracker:spoon"].position[:, 0], 0.7 * np.arange(4))


def test_poses_in_two_frames_are_two_movements(path):
    messages = [
        ("/p", POSE, k, stamped(POSE, 0.1 * k, (1 + k) * 10**8, frame=("left_base", "right_base")[k % 2]))
        for k in range(8)
    ]
    assert list(choices(bag(path, messages))) == ["/p:left_base", "/p:right_base"]


def test_each_place_in_an_array_of_poses_is_a_movement(path):
    kind = "geometry_msgs/PoseArray"

    def array(k, n):
        return make("PoseArray", header=header((1 + k) * 10**8), poses=[pose(1.0 * k + i) for i in range(n)])

    found = choices(bag(path, [("/hands", kind, k, array(k, 2)) for k in range(4)]))
    assert list(found) == ["/hands:0", "/hands:1"]
    np.testing.assert_array_equal(found["/hands:1"].position[:, 0], np.arange(4) + 1.0)
    single = bag(path.with_name("single"), [("/hand", kind, k, array(k, 1)) for k in range(4)])
    np.testing.assert_array_equal(load(single).position[:, 0], np.arange(4))
    changing = bag(path.with_name("changing"), [("/seen", kind, k, array(k, 1 + k % 2)) for k in range(4)])
    with pytest.raises(DemonstrationError, match="1 poses, then 2: nothing tells which is whose"):
        load(changing)


def test_poses_with_covariance_and_without_a_header_are_read(path):
    covered, bare = "geometry_msgs/PoseWithCovarianceStamped", "geometry_msgs/Pose"
    messages = []
    for k in range(3):
        messages.append(("/covered", covered, 7, stamped(covered, 0.5 * k, (k + 1) * 10**8, z=0.6, w=0.8)))
        messages.append(("/bare", bare, (3 + k) * SECOND, pose(0.5 * k, z=0.6, w=0.8)))
    bag(path, messages)
    for topic, step in (("/covered", 0.1), ("/bare", 1.0)):
        demo = load(path, topic)
        np.testing.assert_allclose(demo.time, step * np.arange(3))
        np.testing.assert_array_equal(demo.position[:, 0], 0.5 * np.arange(3))
        np.testing.assert_array_equal(demo.orientation, [[0.8, 0.0, 0.0, 0.6]] * 3)
    assert "messages without a header: time is that of the bag" in load(path, "/bare").notes


def poses_at(*stamps, received=None):
    received = received or [SECOND + k for k in range(len(stamps))]
    return [
        ("/p", POSE, at, pose_stamped(stamp / SECOND, stamp))
        for at, stamp in zip(received, stamps, strict=True)
    ]


@pytest.mark.parametrize("seed", range(5))
def test_messages_that_come_late_by_little_are_sorted(path, seed):
    rng = np.random.default_rng(seed)
    stamps = (SECOND + np.arange(100) * 10_000_000).tolist()
    arrived = np.argsort(np.array(stamps) + rng.uniform(0, 4e7, 100), kind="stable")
    demo = load(bag(path, poses_at(*(stamps[i] for i in arrived))))
    np.testing.assert_array_equal(demo.position[:, 0], np.array(stamps) / SECOND)
    np.testing.assert_allclose(demo.time, 0.01 * np.arange(100), atol=1e-12)
    assert any("sorted by their stamps" in note for note in demo.notes)


def test_a_clock_that_is_set_back_begins_another_movement(path):
    first, second = [SECOND + k * 10**8 for k in range(30)], [SECOND + k * 10**8 for k in range(20)]
    found = choices(bag(path, poses_at(*first, *second)))
    assert list(found) == ["/p:part0", "/p:part1"]
    assert [demo.n_steps for demo in found.values()] == [30, 20]
    assert any("samples 30 to 49 of 50" in note for note in found["/p:part1"].notes)


def test_two_clocks_in_one_topic_are_told(path):
    stamps = [SECOND + k * 10**8 + (k % 2) * 50 * SECOND for k in range(60)]
    with pytest.raises(DemonstrationError, match=r"sample 2, stamp: time goes back 29 times, by 49\.9 s"):
        load(bag(path, poses_at(*stamps)))
    backwards = [100 * SECOND - k * 10**7 for k in range(60)]
    with pytest.raises(DemonstrationError, match="time goes back 59 times"):
        load(bag(path.with_name("backwards"), poses_at(*backwards)))


def test_headers_that_all_say_the_same_tell_no_time(path):
    received = [SECOND + k * 10**8 for k in range(5)]
    demo = load(bag(path, poses_at(*[SECOND] * 5, received=received)))
    np.testing.assert_allclose(demo.time, 0.1 * np.arange(5))
    assert "headers with one and the same stamp: time is that of the bag" in demo.notes


def test_slow_topics_are_in_seconds(path):
    demo = load(bag(path, poses_at(*(SECOND * (1 + 2 * k) for k in range(30)))), unit="m")
    assert demo.duration == 58.0
    assert demo.notes == ()


@pytest.mark.parametrize("stamp", [0, 7 * SECOND])
def test_paths_without_times_need_a_rate(path, stamp):
    """Planners give no stamps, or one for all poses."""
    plan = TYPES["nav_msgs/msg/Path"](
        header=header(5), poses=[pose_stamped(0.1 * k, stamp) for k in range(11)]
    )
    bag(path, [("/plan", "nav_msgs/Path", 1, plan)])
    with pytest.raises(DemonstrationError, match="11 poses have one and the same stamp") as caught:
        load(path)
    demo = load(path, **printed_options(caught.value))
    np.testing.assert_allclose(demo.time, np.arange(11) / 100)
    np.testing.assert_allclose(demo.position[:, 0], 0.1 * np.arange(11))
    timed = bag(path.with_name("timed"), poses_at(SECOND, 2 * SECOND))
    with pytest.raises(DemonstrationError, match="times of their own; leave the rate out"):
        load(timed, rate=10.0)


def test_topics_with_nothing_to_follow_are_not_offered(path):
    messages = [("/hand", POSE, 1 + k, pose_stamped(0.1 * k, (1 + k) * SECOND)) for k in range(5)]
    messages += [("/goal", POSE, 2, pose_stamped(1.0, SECOND)), ("/never", POSE, 1, None)]
    twist = make("Twist", linear=point(kind="Vector3"), angular=point(kind="Vector3"))
    messages.append(("/speed", "geometry_msgs/Twist", 3, twist))
    assert list(rosbag.topics(bag(path, messages))) == ["/hand"]
    assert load(path).n_steps == 5
    with pytest.raises(DemonstrationError, match="/speed: its type geometry_msgs/msg/Twist is not read"):
        load(path, "/speed")
    with pytest.raises(DemonstrationError, match="this one has 1"):
        load(path, "/goal")


def test_only_what_is_chosen_is_read(path, monkeypatch):
    """What there is to choose from is listed before anything is decoded."""
    messages = [
        (topic, POSE, 1 + k, pose_stamped(0.1 * k, (1 + k) * SECOND))
        for k in range(5)
        for topic in ("/a", "/b")
    ]
    bag(path, messages)
    decoded = []
    original = rosbag.read_messages
    monkeypatch.setattr(
        rosbag,
        "read_messages",
        lambda p, topic, *args, **kw: decoded.append(topic) or original(p, topic, *args, **kw),
    )
    with pytest.raises(DemonstrationError, match=r"/a .*/b"):
        load(path)
    assert decoded == []
    load(path, "/b")
    assert decoded == ["/b"]


def written_by_mcap(path, encoding, profile="", schema_encoding="jsonschema"):
    writer_of = pytest.importorskip("mcap.writer").Writer
    with open(path, "wb") as stream:
        writer = writer_of(stream)
        writer.start(profile=profile, library="")
        schema = writer.register_schema(name="foxglove.PoseInFrame", encoding=schema_encoding, data=b"{}")
        channel = writer.register_channel(schema_id=schema, topic="/hand", message_encoding=encoding)
        for k in range(30):
            data = json.dumps({"position": {"x": 0.1 * k}}).encode()
            writer.add_message(channel_id=channel, log_time=k * 10**8, publish_time=k * 10**8, data=data)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("encoding", "said", "way_out"),
    [
        ("protobuf", "Protobuf", "time,x,y,z"),
        ("ros1", "ROS 1", "the .bag"),
        ("cdr", "CDR without the profile ros2", "ros2 bag convert"),
    ],
)
def test_a_whole_mcap_of_other_messages_is_not_called_damaged(tmp_path, encoding, said, way_out):
    path = written_by_mcap(tmp_path / "a.mcap", encoding)
    with pytest.raises(DemonstrationError) as caught:
        load(path)
    assert f"it is whole, but its messages are {said}, not those of ROS 2: /hand" in str(caught.value)
    assert way_out in caught.value.way_out
    assert "repair" not in str(caught.value)


HAND = np.column_stack([0.01 * np.arange(30), 0.5 + 0.02 * np.arange(30), np.cos(0.1 * np.arange(30))])
TURNS = Rotation.from_rotvec(np.outer(0.05 * np.arange(30), [0.2, 0.3, 0.9]))
BEGIN = 1_700_000_000 * SECOND


def json_pose(k):
    turn = dict(zip("xyzw", TURNS[k].as_quat().tolist(), strict=True))
    return {"position": dict(zip("xyz", HAND[k].tolist(), strict=True)), "orientation": turn}


def stamp_of(k):
    return divmod(BEGIN + k * SECOND // 50, SECOND)


def of_foxglove(k):
    sec, nsec = stamp_of(k)
    return {"timestamp": {"sec": sec, "nsec": nsec}, "frame_id": "base", "pose": json_pose(k)}


def of_rosbridge(k):
    secs, nsecs = stamp_of(k)
    return {"header": {"stamp": {"secs": secs, "nsecs": nsecs}, "frame_id": "base"}, "pose": json_pose(k)}


def with_dates(k):
    sec, nsec = stamp_of(k)
    date = f"{datetime.fromtimestamp(sec, UTC):%Y-%m-%dT%H:%M:%S}.{nsec:09d}Z"
    return {"timestamp": date, "pose": {"pose": json_pose(k), "covariance": [0.0] * 36}}


def as_transform(k):
    pose = json_pose(k)
    moved = {"translation": pose["position"], "rotation": pose["orientation"]}
    return of_foxglove(k) | {"parent_frame_id": "base", "child_frame_id": "tool"} | moved


def as_frames(k):
    own = as_transform(k)
    header = {"stamp": own["timestamp"], "frame_id": "base"}
    return {"transforms": [{"header": header, "child_frame_id": "tool", "transform": own}]}


def written_as_json(path, topics, compression):
    with open(path, "wb") as stream:
        mcap = pytest.importorskip("mcap.writer")
        writer = mcap.Writer(stream, compression=mcap.CompressionType[compression], chunk_size=2000)
        writer.start()
        for topic, (schema, make) in topics.items():
            schema = writer.register_schema(schema, "jsonschema", b"{}")
            channel = writer.register_channel(topic, "json", schema)
            for k in range(30):
                received = BEGIN + k * SECOND // 50 + 1000
                data = make(k) if isinstance(make(k), bytes) else json.dumps(make(k)).encode()
                writer.add_message(channel, received, data, received)
        writer.finish()
    return path


@pytest.mark.parametrize("compression", ["NONE", "LZ4", "ZSTD"])
@pytest.mark.parametrize(
    ("schema", "make"),
    [
        ("foxglove.PoseInFrame", of_foxglove),
        ("geometry_msgs/PoseStamped", of_rosbridge),
        ("mine", with_dates),
        ("foxglove.FrameTransform", as_transform),
        ("tf2_msgs/msg/TFMessage", as_frames),
    ],
)
def test_poses_in_json_are_read_as_those_of_ros(tmp_path, schema, make, compression):
    path = written_as_json(tmp_path / "a.mcap", {"/hand": (schema, make)}, compression)
    hand = load(path)
    np.testing.assert_array_equal(hand.position, HAND)
    np.testing.assert_allclose(hand.time, np.arange(30) / 50, atol=1e-12)
    assert (hand.rotation * TURNS.inv()).magnitude().max() < 1e-7


def test_joints_in_json_are_read_and_what_holds_no_movement_is_told(tmp_path):
    def joints(k):
        return {"name": ["a", "b"], "position": HAND[k, :2].tolist()}

    others = {
        "/log": ("foxglove.Log", lambda k: {"text": "a"}),
        "/speed": ("foxglove.Vector3", lambda k: {"x": 1}),
    }
    path = written_as_json(tmp_path / "a.mcap", {"/j": ("sensor_msgs/JointState", joints)} | others, "ZSTD")
    arm = load(path)
    np.testing.assert_array_equal(arm.position, HAND[:, :2])
    assert (arm.axes, arm.unit) == (("a", "b"), "rad")
    with pytest.raises(DemonstrationError, match=r"it holds /log \(foxglove.Log\), /speed"):
        load(written_as_json(tmp_path / "b.mcap", others, "ZSTD"))


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        (
            {"pose": {"position": {"x": 0, "y": 0}, "orientation": {}}},
            r"PoseStamped.pose.position.z: .* no number",
        ),
        ({"timestamp": "yesterday"} | {"pose": json_pose(0)}, "'yesterday' is no time"),
        (b"{", "a message is no JSON"),
        ([], "a message has no object"),
    ],
)
def test_json_that_lacks_what_others_have_is_told(tmp_path, broken, words):
    topic = "geometry_msgs/PoseStamped", lambda k: broken if k == 7 else of_foxglove(k)
    path = written_as_json(tmp_path / "a.mcap", {"/hand": topic}, "NONE")
    with pytest.raises(DemonstrationError, match=words):
        load(path)
    damaged = bytearray(path.read_bytes())
    damaged[200] ^= 1
    path.write_bytes(damaged)
    with pytest.raises(DemonstrationError, match=r"checksum|whole"):
        load(path)


def test_a_bag_of_another_serialisation_is_not_called_damaged(path):
    bag(path, poses_at(SECOND, 2 * SECOND))
    file = path / "metadata.yaml"
    file.write_text(file.read_text().replace("serialization_format: cdr", "serialization_format: json"))
    with pytest.raises(DemonstrationError, match="kind of bag that is not read") as caught:
        load(path)
    assert "repair" not in str(caught.value)


def test_pointers_of_git_lfs_inside_a_bag_are_told(path):
    bag(path, poses_at(SECOND, 2 * SECOND))
    (file,) = path.glob("*.db3")
    file.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:ab\nsize 12345\n")
    with pytest.raises(DemonstrationError, match=r"db3: .*pointer of Git LFS.*git lfs pull"):
        load(path)


def test_transforms_of_ros_1_are_read(tmp_path):
    store = get_typestore(Stores.ROS1_NOETIC)
    for number, kind in enumerate(("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")):
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", kind))
        types, path = store.types, tmp_path / f"{number}.bag"
        with rosbag1.Writer(path) as writer:
            connection = writer.add_connection("/tf", kind, typestore=store)
            for k in range(4):
                stamp = types["builtin_interfaces/msg/Time"](sec=7, nanosec=k * 10**6)
                head = types["std_msgs/msg/Header"](seq=k, stamp=stamp, frame_id="/base")
                moved = types["geometry_msgs/msg/Transform"](
                    translation=types["geometry_msgs/msg/Vector3"](x=1.0 * k, y=0.0, z=0.0),
                    rotation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.6, w=0.8),
                )
                one = types["geometry_msgs/msg/TransformStamped"](
                    header=head, child_frame_id="/tool", transform=moved
                )
                writer.write(connection, k, store.serialize_ros1(types[kind](transforms=[one]), kind))
        demo = load(path)
        np.testing.assert_array_equal(demo.position[:, 0], range(4))
        np.testing.assert_array_equal(demo.orientation, [[0.8, 0.0, 0.0, 0.6]] * 4)
        assert "tool in base" in demo.notes
