"""Bags, read back by readers that are not comove's."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from comove import Demonstration
from comove.ros import FORMATS, export, parts_of

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
