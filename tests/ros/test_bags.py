"""Bags, read back by readers that are not comove's."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from comove import Demonstration
from comove.ros import FORMATS, export, moveit_messages, parts_of

BAGS = ("rosbag1", "rosbag2", "mcap")
EXACT = 1e-12
ROSBAG = """
import json, sys, rosbag
for topic, message, stamp in rosbag.Bag(sys.argv[1]).read_messages():
    if topic == "/comove/provenance":
        print(json.dumps([topic, message.data]))
    elif topic == "/comove/joint_states":
        print(json.dumps([topic, message.header.seq, message.header.stamp.to_nsec(), stamp.to_nsec(), message.name,
            message.position, message.velocity]))
    else:
        print(json.dumps([topic, message.joint_names, [[p.time_from_start.to_nsec(), p.positions, p.velocities,
            p.accelerations] for p in message.points]]))
"""


@pytest.fixture(scope="module")
def bags(verified, tmp_path_factory):
    pytest.importorskip("rosbags")
    folder = tmp_path_factory.mktemp("bags")
    return {name: export(verified, folder, FORMATS[name])[0] for name in BAGS}


@pytest.fixture(scope="module")
def samples(verified):
    return parts_of(verified)["carry"].samples(100.0)


def read(path: Path) -> dict[str, list]:
    """Messages by topic, with the bag's own stamps, by the reader of rosbags."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if path.suffix == ".bag" else Stores.ROS2_HUMBLE)
    found: dict[str, list] = {}
    with AnyReader([path], default_typestore=store) as reader:
        for connection, stamp, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((stamp, message))
    return found


@pytest.mark.parametrize("name", BAGS)
def test_trajectories_read_back(verified, bags, samples, name):
    found = read(bags[name])
    robot = verified.robot
    groups = {f"/comove/{arm.name}": arm.columns for arm in robot.arms} | {"/comove": np.arange(14)}
    for prefix, columns in groups.items():
        ((stamp, message),) = found[f"{prefix}/joint_trajectory"]
        assert message.joint_names == [robot.joint_names[column] for column in columns]
        assert stamp == 10**9 and (message.header.stamp.sec, message.header.stamp.nanosec) == (1, 0)
        time = [point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in message.points]
        for read_back, exact in (
            (time, samples.time),
            ([point.positions for point in message.points], samples.position[:, columns]),
            ([point.velocities for point in message.points], samples.velocity[:, columns]),
            ([point.accelerations for point in message.points], samples.acceleration[:, columns]),
        ):
            assert np.abs(np.array(read_back) - exact).max() < EXACT
        assert (np.diff(time) > 0).all() and not message.points[-1].velocities.any()


@pytest.mark.parametrize("name", BAGS)
def test_joint_states_read_back(verified, bags, samples, name):
    states = read(bags[name])["/comove/joint_states"]
    assert all(tuple(message.name) == verified.robot.joint_names for _, message in states)
    assert np.abs(np.array([message.position for _, message in states]) - samples.position).max() < EXACT
    assert np.abs(np.array([message.velocity for _, message in states]) - samples.velocity).max() < EXACT
    stamps = [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for _, message in states]
    assert stamps == [stamp for stamp, _ in states] == (10**9 + samples.nanoseconds).tolist()


@pytest.mark.parametrize("name", BAGS)
def test_provenance_travels_with_the_motion(verified, bags, name):
    ((_, message),) = read(bags[name])["/comove/provenance"]
    told = json.loads(message.data)
    assert told == parts_of(verified)["carry"].provenance.asdict()
    assert told["scene_sha256"] == verified.scene.sha256
    assert told["robot_sha256"] == verified.robot.sha256


def test_who_comes_late_gets_what_is_latched(bags):
    from rosbags import rosbag1, rosbag2

    with rosbag1.Reader(bags["rosbag1"]) as reader:
        latched = {c.topic: c.ext.latching for c in reader.connections}
    assert latched.pop("/comove/joint_states") == 0 and set(latched.values()) == {1}
    for name in ("rosbag2", "mcap"):
        with rosbag2.Reader(bags[name]) as reader:
            kept = {c.topic: c.ext.offered_qos_profiles[0].durability.name for c in reader.connections}
        assert kept.pop("/comove/joint_states") == "VOLATILE" and set(kept.values()) == {"TRANSIENT_LOCAL"}


def test_a_folder_is_what_ros_2_records(bags):
    assert sorted(path.name for path in bags["rosbag2"].iterdir()) == ["carry.db3", "metadata.yaml"]
    metadata = (bags["rosbag2"] / "metadata.yaml").read_text(encoding="utf-8")
    assert "carry.db3" in metadata and "comove.scene_sha256" in metadata


@pytest.mark.parametrize("name", BAGS)
def test_comove_reads_its_own_bags(bags, samples, name):
    states = Demonstration.load(bags[name], topic="/comove/joint_states")
    assert np.abs(states.position - samples.position).max() < EXACT
    left = Demonstration.load(bags[name], topic="/comove/left/joint_trajectory")
    assert np.abs(left.position - samples.position[:, :7]).max() < EXACT


def test_the_library_of_mcap_reads_it(verified, bags, samples):
    pytest.importorskip("mcap_ros2.decoder", reason="mcap-ros2-support is not installed")
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    found: dict[str, list] = {}
    with open(bags["mcap"], "rb") as file:
        for _, channel, _, message in make_reader(
            file, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            found.setdefault(channel.topic, []).append(message)
    position = np.array([message.position for message in found["/comove/joint_states"]])
    assert np.abs(position - samples.position).max() < EXACT
    (left,) = found["/comove/left/joint_trajectory"]
    acceleration = np.array([point.accelerations for point in left.points])
    assert np.abs(acceleration - samples.acceleration[:, :7]).max() < EXACT


def test_ros_1_itself_reads_it(verified, bags, samples):
    python = "/usr/bin/python3"
    if (
        not Path(python).exists()
        or subprocess.run([python, "-c", "import rosbag"], capture_output=True).returncode
    ):
        pytest.skip("ROS 1 is not installed: apt-get install python3-rosbag")
    done = subprocess.run([python, "-c", ROSBAG, bags["rosbag1"]], capture_output=True, text=True, check=True)
    found: dict[str, list] = {}
    for line in done.stdout.splitlines():
        topic, *content = json.loads(line)
        found.setdefault(topic, []).append(content)
    assert json.loads(found["/comove/provenance"][0][0])["robot"] == "baxter"
    _, stamp, received, _, position, velocity = zip(*found["/comove/joint_states"], strict=True)
    assert stamp == received == tuple((10**9 + samples.nanoseconds).tolist())
    assert np.abs(np.array(position) - samples.position).max() < EXACT
    assert np.abs(np.array(velocity) - samples.velocity).max() < EXACT
    ((names, points),) = found["/comove/right/joint_trajectory"]
    assert names[0] == "right_s0"
    time, position, velocity, acceleration = zip(*points, strict=True)
    assert list(time) == samples.nanoseconds.tolist()
    assert np.abs(np.array(position) - samples.position[:, 7:]).max() < EXACT
    assert np.abs(np.array(acceleration) - samples.acceleration[:, 7:]).max() < EXACT


@pytest.fixture(scope="module")
def for_moveit(verified, transfers, tmp_path_factory):
    pytest.importorskip("rosbags")
    return export(verified, tmp_path_factory.mktemp("moveit"), FORMATS["moveit"], transfers=transfers)


def test_moveit_gets_trajectories_by_the_definitions_in_the_file(verified, transfers, for_moveit):
    """Carry, approach and release, read by rosbags, to which comove's definitions are unknown."""
    from rosbags.highlevel import AnyReader

    assert [path.name for path in for_moveit] == [
        "moveit.mcap",
        "moveit_approach.mcap",
        "moveit_release.mcap",
    ]
    parts = parts_of(verified, transfers)
    assert list(parts) == ["carry", "approach", "release"]
    for path, part in zip(for_moveit, parts.values(), strict=True):
        wanted = part.samples(100.0)
        with AnyReader([path]) as reader:
            found = {
                connection.topic: reader.deserialize(data, connection.msgtype)
                for connection, _, data in reader.messages()
            }
            kinds = {connection.topic: connection.msgtype for connection in reader.connections}
            kept = {c.topic: c.ext.offered_qos_profiles[0].durability.name for c in reader.connections}
        assert kinds["/comove/robot_trajectory"] == "moveit_msgs/msg/RobotTrajectory"
        assert kinds["/comove/display_planned_path"] == "moveit_msgs/msg/DisplayTrajectory"
        assert {kept[topic] for topic in ("/comove/robot_trajectory", "/comove/display_planned_path")} == {
            "TRANSIENT_LOCAL"
        }
        shown = found["/comove/display_planned_path"]
        (whole,) = shown.trajectory
        for motion in (whole, found["/comove/robot_trajectory"]):
            motion = motion.joint_trajectory
            assert motion.header.stamp.sec == motion.header.stamp.nanosec == 0, (
                "it begins when it is executed"
            )
            assert tuple(motion.joint_names) == verified.robot.joint_names
            time = [p.time_from_start.sec * 10**9 + p.time_from_start.nanosec for p in motion.points]
            assert time == wanted.nanoseconds.tolist()
            for key, exact in (
                ("positions", wanted.position),
                ("velocities", wanted.velocity),
                ("accelerations", wanted.acceleration),
            ):
                assert np.abs(np.array([getattr(p, key) for p in motion.points]) - exact).max() < EXACT
        start = shown.trajectory_start
        assert start.joint_state.name == list(verified.robot.joint_names)
        assert np.abs(start.joint_state.position - wanted.position[0]).max() < EXACT
        assert json.loads(found["/comove/provenance"].data)["part"] == part.name


def test_messages_of_moveit_are_those_of_its_definitions(verified, samples):
    """Encoded as ROS 2 encodes them, by definitions typed anew."""
    from tests.model.files.planning_scenes import Messages

    store = Messages().store
    found = moveit_messages(parts_of(verified)["carry"], 100.0)
    assert set(found) == {"moveit_msgs/msg/RobotTrajectory", "moveit_msgs/msg/DisplayTrajectory"}
    message = store.deserialize_cdr(
        found["moveit_msgs/msg/RobotTrajectory"], "moveit_msgs/msg/RobotTrajectory"
    )
    position = np.array([point.positions for point in message.joint_trajectory.points])
    assert np.abs(position - samples.position).max() < EXACT
