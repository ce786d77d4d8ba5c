"""One door for all kinds of files."""

import os
import subprocess
import sys

import numpy as np
import pytest

from comove.dmp.demonstrations import (
    Demonstration,
    write,
    write_aloha,
    write_csv,
    write_lerobot,
    write_npz,
    write_robomimic,
    write_rosbag,
)
from comove.dmp.demonstrations.formats import FORMATS
from comove.dmp.demonstrations.samples import select_name
from comove.errors import DemonstrationError


@pytest.fixture
def recordings(tmp_path, hand):
    """A file of each kind with the hands `left` and `right`, and what it should hold."""
    for library in ("h5py", "pyarrow", "rosbags"):
        pytest.importorskip(library)
    demos = {"left": hand(), "right": hand(1)}
    joints = {"n_dims": 7, "turned": False, "unit": "rad", "rate": 50.0}
    write_csv(tmp_path / "a.csv", demos)
    write_npz(tmp_path / "a.NPZ", demos)
    write_robomimic(tmp_path / "a.hdf5", [demos, {"left": hand(2), "right": hand(3)}])
    write_aloha(tmp_path / "episode_0.h5", {"left": hand(**joints), "right": hand(1, **joints)})
    write_lerobot(tmp_path / "lerobot", [demos, demos], dtype="float64")
    for name in ("a.bag", "a.mcap", "a.db3", "rosbag2"):
        write_rosbag(tmp_path / name, demos)
    return tmp_path


@pytest.mark.parametrize(
    ("name", "choice"),
    [
        ("a.csv", {"manipulator": "right"}),
        ("a.NPZ", {"manipulator": "right"}),
        ("a.hdf5", {"manipulator": "robot1", "episode": "demo_0"}),
        ("a.hdf5", {"manipulator": "robot1", "episode": 0}),
        ("lerobot", {"manipulator": "right", "episode": 1}),
        ("lerobot", {"manipulator": "right", "episode": "0"}),
        ("a.bag", {"topic": "/right/pose"}),
        ("a.mcap", {"topic": "/right/pose"}),
        ("a.db3", {"topic": "/right/pose"}),
        ("rosbag2", {"topic": "/right/pose"}),
    ],
)
@pytest.mark.few(4)
def test_every_kind_is_loaded_by_one_call(recordings, hand, name, choice):
    demo = Demonstration.load(recordings / name, **choice)
    assert demo.position.tobytes() == hand(1).position.tobytes()
    np.testing.assert_array_equal(demo.orientation, hand(1).orientation)
    np.testing.assert_allclose(demo.time, hand(1).time, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "n_movements"),
    [
        ("a.csv", 2),
        ("a.NPZ", 2),
        ("a.hdf5", 4),
        ("episode_0.h5", 2),
        ("lerobot", 4),
        ("a.bag", 2),
        ("rosbag2", 2),
    ],
)
def test_all_movements_have_names_of_their_own(recordings, name, n_movements):
    demos = Demonstration.load_all(recordings / name)
    assert isinstance(demos, tuple)
    assert len(demos) == len({demo.name for demo in demos}) == n_movements


@pytest.mark.parametrize(
    ("name", "choice", "key", "says", "way_out"),
    [
        ("a.csv", {}, "manipulator", "holds 2 manipulators", "name one of left, right"),
        (
            "a.csv",
            {"topic": "/x"},
            "topic",
            "'/x' was asked for, but only bags have topics",
            "leave the topic",
        ),
        (
            "a.NPZ",
            {"episode": 1},
            "episode",
            "1 was asked for, but it holds one recording",
            "leave the episode",
        ),
        ("a.hdf5", {}, "episode", "holds 2 episodes", "name one of demo_0, demo_1"),
        ("a.hdf5", {"episode": 5}, "episode", "no episode 5", "known: demo_0, demo_1"),
        ("a.hdf5", {"episode": 1}, "manipulator", "holds 2 manipulators", "name one of robot0, robot1"),
        ("a.hdf5", {"topic": "/x"}, "topic", "only bags have topics", "leave the topic out"),
        ("episode_0.h5", {"manipulator": "rigth"}, "manipulator", "no 'rigth'", "did you mean 'right'"),
        ("lerobot", {}, "episode", "holds 2 episodes", "name one of 0, 1"),
        ("lerobot", {"episode": 0}, "manipulator", "holds 2 manipulators", "left, right"),
        ("a.bag", {}, "topic", "holds 2 topics", r"/left/pose \(geometry_msgs/msg/PoseStamped\), /right"),
        (
            "rosbag2",
            {"manipulator": "left"},
            "manipulator",
            "a bag knows topics",
            "leave the manipulator out",
        ),
        ("a.mcap", {"episode": 0}, "episode", "it holds one recording", "leave the episode out"),
        ("a.db3", {"topic": "/left/psoe"}, "topic", "no '/left/psoe'", "did you mean '/left/pose"),
    ],
)
@pytest.mark.few(5)
def test_what_has_to_be_chosen_is_listed(recordings, refused, name, choice, key, says, way_out):
    refused(lambda p: Demonstration.load(p, **choice), recordings / name, key=key, says=says, way_out=way_out)


def test_long_lists_are_cut():
    with pytest.raises(DemonstrationError, match=r"holds 99 episodes; name one of 0, .*, 19 and 79 more$"):
        select_name({str(i): None for i in range(99)}, None, "file", "episode")
    with pytest.raises(DemonstrationError, match=r"and 79 more$"):
        select_name({str(i): None for i in range(99)}, "x", "file", "episode")


def test_folders_and_kinds_that_are_none_are_told(tmp_path, refused):
    refused(
        Demonstration.load,
        tmp_path,
        key=None,
        says="a folder without meta/info.json",
        way_out="name the folder",
    )
    path = tmp_path / "a.pkl"
    refused(
        Demonstration.load, path, key=None, says="kind '.pkl' is not known", way_out=r"known: \.csv, .*\.npz"
    )
    refused(Demonstration.load_all, path, key=None, says="kind '.pkl' is not known", way_out="known")
    for suffix in (suffix for format in FORMATS for suffix in format.suffixes):
        path = tmp_path / f"none{suffix}"
        refused(Demonstration.load, path, key=None, says="no such file", way_out="check the path")


def test_plain_files_need_no_further_library(tmp_path, hand):
    write_csv(tmp_path / "a.csv", hand())
    code = (
        "import sys\n"
        "from comove.dmp.demonstrations import Demonstration\n"
        "Demonstration.load('a.csv')\n"
        "print({'scipy', 'h5py', 'pyarrow', 'rosbags'} & set(sys.modules))"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    run = {"cwd": tmp_path, "capture_output": True, "text": True, "check": True, "env": environment}
    assert subprocess.run([sys.executable, "-c", code], **run).stdout.strip() == "set()"


@pytest.mark.parametrize("name", ["a.csv", "a.NPZ", "a.h5", "a.mcap"])
def test_every_kind_with_a_suffix_is_written_by_one_call(tmp_path, hand, name):
    for library in ("h5py", "rosbags"):
        pytest.importorskip(library)
    write(tmp_path / name, hand())
    (again,) = Demonstration.load_all(tmp_path / name)
    assert again.position.tobytes() == hand().position.tobytes()


def test_kinds_that_nobody_writes_are_told(tmp_path, hand, refused):
    refused(
        lambda path: write(path, hand()),
        tmp_path / "a.cvs",
        key=None,
        says=r"kind '\.cvs' is not written",
        way_out=r"did you mean '\.csv'",
    )
    assert not list(tmp_path.iterdir())
