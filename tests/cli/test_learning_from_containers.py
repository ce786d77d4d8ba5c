"""`comove learn` from bags, HDF5 files and datasets: each command that a refusal prints works as it is printed."""

import re
import shlex

import h5py
import numpy as np
import pytest

from comove.dmp import read_primitive
from tests.commands import invoke
from tests.dmp.demonstrations.formats.bags import TYPES, bag, header, joint_state, pose_stamped
from tests.dmp.demonstrations.formats.test_lerobot_features import ANGLES, PATH, SO_101, dataset, state
from tests.dmp.demonstrations.formats.test_ros_transforms import STAMPS, Course

SHARE = np.linspace(0.0, 1.0, 40)
POSITION = np.stack([0.3 * SHARE, 0.1 * np.sin(np.pi * SHARE), 0.2 + 0.05 * SHARE], axis=1)
POSE, JOINTS = "geometry_msgs/PoseStamped", "sensor_msgs/JointState"


def hdf5(path, datasets):
    with h5py.File(path, "w") as file:
        for key, value in datasets.items():
            file[key] = value


def two_topics(path):
    plan = TYPES["nav_msgs/msg/Path"](header=header(5), poses=[pose_stamped(0.1 * k, 0) for k in range(9)])
    poses = [("/ee_pose", POSE, k, pose_stamped(0.01 * k, (k + 1) * 10**8)) for k in range(20)]
    bag(path, [*poses, ("/plan", "nav_msgs/Path", 5, plan)])


def arm_and_gripper(path):
    names = [("a", "b"), ("finger",)]
    bag(
        path,
        [
            (
                "/joint_states",
                JOINTS,
                k,
                joint_state(names[k % 2], [0.01 * k] * len(names[k % 2]), (k + 1) * 10**8),
            )
            for k in range(40)
        ],
    )


def two_hands_of_tf(path):
    bag(path, Course(0, STAMPS).messages("base", "left") + Course(1, STAMPS).messages("base", "right"))


RECORDINGS = {
    "two_topics": two_topics,
    "arm_and_gripper": arm_and_gripper,
    "two_hands_of_tf": two_hands_of_tf,
    "unknown.hdf5": lambda path: hdf5(path, {"log/actions": np.c_[POSITION, POSITION]}),
    "without rate.h5": lambda path: hdf5(path, {"robot/hand_xyz": POSITION, "robot/force": 0 * POSITION}),
    "hands.hdf5": lambda path: hdf5(
        path,
        {
            f"data/demo_{i}/obs/robot0_{side}_eef_pos": POSITION + i
            for i in range(3)
            for side in ("left", "right")
        },
    ),
    "several_episodes": lambda path: state(path, PATH, ["x", "y", "z"], lengths=(31, 30, 29)),
    "without_names": lambda path: state(path, np.c_[PATH, PATH], None),
    "other_vectors": lambda path: dataset(path, {"a": (PATH, list("xyz")), "b": (PATH, list("xyz"))}),
    "two_hands": lambda path: state(
        path, np.c_[PATH, PATH], [f"{side}_{axis}" for side in ("left", "right") for axis in "xyz"]
    ),
}


@pytest.mark.parametrize("name", RECORDINGS)
@pytest.mark.few(5)
def test_printed_commands_lead_to_a_primitive(tmp_path, name):
    RECORDINGS[name](tmp_path / name)
    arguments = ["learn", name, "--out", "out.json"]
    for _ in range(5):
        outcome = invoke(*arguments, folder=tmp_path)
        if outcome.exit_code == 0:
            break
        assert outcome.exit_code == 2 and outcome.stdout == ""
        assert not list(tmp_path.glob("*.json"))
        (command,) = re.findall(r"; run: comove (.*) \(comove explain", outcome.stderr)
        arguments = shlex.split(command.replace("UNIT", "m").replace("HZ", "50"))  # which no file says
    assert arguments[-1] != "out.json", "there was something to choose"
    assert read_primitive(tmp_path / arguments[-1]).dmp.n_dims >= 1


@pytest.mark.slow
def test_small_arms_become_joints_or_the_path_of_a_robot(tmp_path):
    """Never a circle of advice: the joints as they stand, in degrees, or through a robot's description."""
    pytest.importorskip("pinocchio")
    values = 60 * np.c_[ANGLES, ANGLES[:, :2], np.abs(ANGLES[:, :1])]
    state(tmp_path / "so101", values, [*SO_101, "gripper.pos"])
    outcome = invoke("learn", "so101", "--out", "joints.json", folder=tmp_path)
    assert outcome.exit_code == 0 and "degrees, or percent" in outcome.stdout
    assert read_primitive(tmp_path / "joints.json").unit == "LeRobot unit"
    assert invoke("learn", "so101", "--unit", "deg", "--out", "deg.json", folder=tmp_path).exit_code == 0
    assert read_primitive(tmp_path / "deg.json").unit == "rad"
    arguments = ["learn", "so101", "--robot", "two_so101", "--out", "x.json"]
    asked = []
    while (outcome := invoke(*arguments, folder=tmp_path)).exit_code:
        (command,) = re.findall(r"; run: comove (.*) \(comove explain", outcome.stderr)
        arguments = shlex.split(command)
        asked.append(arguments[-4:-2])
    assert asked == [["--unit", "deg"], ["--arm", "left"]]
    primitive = read_primitive(tmp_path / "so101.json")
    assert (primitive.unit, primitive.dmp.n_dims) == ("m", 3)
    assert "end effector of 'left' of the robot 'two_so101'" in outcome.stdout
    lost = invoke("learn", "so101", "--arm", "left", "--out", "y.json", folder=tmp_path)
    assert lost.exit_code == 2 and "--robot ROBOT" in lost.stderr
