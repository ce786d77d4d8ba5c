"""Layouts of simulators and recorders in HDF5, and datasets by their path: numbers against h5py's."""

import json
import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comove.dmp.demonstrations import Demonstration, read_hdf5
from comove.dmp.demonstrations.formats import hdf5
from comove.errors import ComoveError, ComoveWarning, DemonstrationError, OptionError
from tests.dmp.demonstrations.formats.advice import follow, printed_options

h5py = pytest.importorskip("h5py")

N = 40
SHARE = np.linspace(0.0, 1.0, N)
PATH = np.stack([0.3 * SHARE, 0.1 * np.sin(np.pi * SHARE), 0.2 + 0.05 * SHARE], axis=1)
TURN = Rotation.from_rotvec(np.outer(SHARE, [0.2, -0.4, 1.0]))
XYZW = TURN.as_quat()
WXYZ = XYZW[:, [3, 0, 1, 2]]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "a.hdf5"


def written(path, datasets, attributes=None):
    with h5py.File(path, "w") as file:
        for key, value in datasets.items():
            file[key] = value
        for key, value in (attributes or {}).items():
            place, _, name = key.rpartition("@")
            (file[place] if place else file).attrs[name] = value
    return path


def load(path, **options):
    return Demonstration.load(path, **options)


def test_two_arms_of_one_robot_are_two_hands(path):
    """As robosuite 1.5 records them."""
    datasets = {}
    for number, side in enumerate(("right", "left")):
        datasets[f"data/demo_0/obs/robot0_{side}_eef_pos"] = PATH + number
        datasets[f"data/demo_0/obs/robot0_{side}_eef_quat"] = XYZW
        datasets[f"data/demo_0/obs/robot0_{side}_gripper_qpos"] = PATH[:, :2]
        datasets[f"data/demo_0/obs/robot0_base_to_{side}_eef_pos"] = PATH
    datasets["data/demo_0/obs/cubeA_pos"] = PATH
    written(path, datasets, {"data@env_args": json.dumps({"env_kwargs": {"control_freq": 25}})})
    hands = read_hdf5(path)["demo_0"]
    assert list(hands) == ["robot0_left", "robot0_right"]
    np.testing.assert_array_equal(hands["robot0_left"].position, PATH + 1)
    np.testing.assert_allclose(hands["robot0_right"].orientation, WXYZ, atol=1e-12)
    np.testing.assert_allclose(hands["robot0_left"].time, np.arange(N) / 25)


def test_libero_has_rotation_vectors(path):
    datasets = {
        "ee_pos": PATH,
        "ee_ori": TURN.as_rotvec(),
        "joint_states": np.zeros((N, 7)),
        "gripper_states": PATH,
    }
    written(path, {f"data/demo_0/obs/{key}": value for key, value in datasets.items()})
    demo = load(path)
    np.testing.assert_array_equal(demo.position, PATH)
    assert (demo.rotation * TURN.inv()).magnitude().max() < 1e-7
    assert demo.duration == (N - 1) / 20
    assert any("20 samples a second, as robosuite" in note for note in demo.notes)


def test_maniskill_has_poses_with_quaternions_w_first(path):
    pose = np.concatenate((PATH, WXYZ), axis=1)
    datasets = {
        "traj_0/obs/extra/tcp_pose": pose,
        "traj_0/obs/agent/qpos": np.zeros((N, 9)),
        "traj_0/actions": np.zeros((N - 1, 7)),
    }
    demo = load(written(path, datasets))
    np.testing.assert_array_equal(demo.position, PATH)
    np.testing.assert_allclose(demo.orientation, WXYZ, atol=1e-12)
    del datasets["traj_0/obs/extra/tcp_pose"]
    joints = load(written(path, datasets | {"traj_0/obs/agent/qpos": np.outer(SHARE, np.arange(9) / 9)}))
    assert (joints.unit, joints.n_dims) == ("rad", 9)
    many = {f"traj_{i}/obs/extra/tcp_pose": pose for i in (10, 9, 0)}
    assert hdf5.episodes(written(path, many)) == ("traj_0", "traj_9", "traj_10")


@pytest.mark.parametrize(
    ("n_columns", "arms"),
    [(6, {"": 6}), (7, {"": 7}), (8, {"": 8}), (9, {"": 9}), (12, {"left": 6, "right": 6}),
     (14, {"left": 7, "right": 7}), (16, {"left": 8, "right": 8})],
)  # fmt: skip
def test_aloha_with_any_number_of_joints(path, n_columns, arms):
    qpos = np.outer(SHARE, 0.1 * (1 + np.arange(n_columns)))
    found = read_hdf5(written(path, {"observations/qpos": qpos}))["a"]
    assert {name: demo.n_dims for name, demo in found.items()} == arms
    np.testing.assert_array_equal(np.concatenate([demo.position for demo in found.values()], axis=1), qpos)
    assert all(demo.unit == "rad" and len(demo.axes) == demo.n_dims for demo in found.values())
    named = found[next(iter(arms))].axes == hdf5.ALOHA_JOINTS
    assert named == (n_columns in (7, 14))


@pytest.mark.parametrize(
    "datasets",
    [
        {"time": 0.1 * np.arange(N), "position": PATH},
        {"t": 0.1 * np.arange(N), "x": PATH[:, 0], "y": PATH[:, 1], "z": PATH[:, 2]},
        {"timestamps": 100.0 * np.arange(N), "xyz": PATH},
        {"time_ms": 100 * np.arange(N), "ee_position": PATH},
        {"timestamp_ns": 1_700_000_000_000_000_000 + 100_000_000 * np.arange(N), "pos": PATH},
        {"time": (0.1 * np.arange(N))[:, None], "tcp_pos": PATH, "camera": np.zeros((N, 4, 4, 3), np.uint8)},
    ],
)
def test_plain_files_say_by_their_names_what_they_hold(path, datasets):
    for above in ("", "recording/"):
        written(path, {f"{above}{key}": value for key, value in datasets.items()})
        demo = load(path) if not above else follow(path)
        np.testing.assert_array_equal(demo.position, PATH)
        np.testing.assert_allclose(demo.time, 0.1 * np.arange(N), atol=1e-9)


def test_plain_files_in_the_plane_with_orientations_and_units(path):
    time = 0.1 * np.arange(N)
    flat = load(written(path, {"time": time, "position": PATH[:, :2]}))
    assert (flat.n_dims, flat.unit) == (2, "m")
    turned = load(written(path, {"time": time, "position": PATH, "orientation": WXYZ}))
    np.testing.assert_allclose(turned.orientation, WXYZ, atol=1e-12)
    scaled = load(written(path, {"time": time, "position": 1000 * PATH}, {"position@units": "mm"}))
    np.testing.assert_allclose(scaled.position, PATH)
    stated = load(written(path, {"time": time, "position": 1000 * PATH}), unit="mm")
    np.testing.assert_allclose(stated.position, PATH)
    with pytest.raises(OptionError, match="says that it is in mm"):
        load(written(path, {"time": time, "position": PATH}, {"position@units": "mm"}), unit="cm")


@pytest.mark.parametrize(
    ("datasets", "expected"),
    [
        ({"observations/eef_pose": np.c_[PATH, XYZW], "action": PATH}, PATH),
        ({"robot/hand": PATH, "robot/force": np.zeros((N, 6))}, PATH),
        ({"log/actions": np.c_[PATH, PATH]}, PATH),
        ({"run/velocity": PATH, "run/ee_pos": PATH}, PATH),
        ({"O_T_EE": np.tile(np.eye(4), (N, 1, 1))}, np.zeros((N, 3))),
        ({"deep/er/and/deeper/xyz": PATH}, PATH),
        ({"with space/xyz": PATH}, PATH),
    ],
)
def test_refusals_print_the_options_that_then_read_it(path, datasets, expected):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ComoveWarning)
        np.testing.assert_array_equal(follow(written(path, datasets)).position, expected)


def test_datasets_whose_names_say_nothing_need_a_unit_and_those_of_forces_are_not_offered(path):
    written(path, {"time": 0.1 * np.arange(N), "log": np.c_[PATH, PATH]})
    with pytest.raises(DemonstrationError, match=r"--columns 1,2,3 --unit UNIT") as caught:
        load(path, dataset="log")
    np.testing.assert_array_equal(load(path, **printed_options(caught.value)).position, PATH)
    written(path, {"time": 0.1 * np.arange(N), "torque": PATH, "joint_vel": PATH})
    with pytest.raises(DemonstrationError, match="record positions as well: here are .*torque") as caught:
        load(path)
    assert "run:" not in caught.value.way_out
    with pytest.raises(DemonstrationError, match="'torque' are no positions"):
        load(path, dataset="torque")


def test_names_of_columns_are_used_where_the_file_has_them(path):
    """Beside the numbers, as pandas writes them, or in an attribute."""
    table, names = np.c_[0.1 * np.arange(N), PATH, XYZW], ["t", "x", "y", "z", "qx", "qy", "qz", "qw"]
    pandas = {"df/block0_values": table, "df/block0_items": np.array([name.encode() for name in names])}
    own = written(path.with_name("b.hdf5"), {"df/table": table}, {"df/table@columns": names})
    for file in (written(path, pandas), own):
        demo = follow(file)
        np.testing.assert_array_equal(demo.position, PATH)
        np.testing.assert_allclose(demo.orientation, WXYZ, atol=1e-12)
        np.testing.assert_allclose(demo.time, table[:, 0], atol=1e-12)
    flat = load(own, dataset="df/table", columns=["x", "3"])
    np.testing.assert_array_equal(flat.position, PATH[:, :2])


def test_matrices_are_poses_in_either_order(path):
    poses = np.tile(np.eye(4), (N, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = TURN.as_matrix(), PATH
    for stored in (poses, poses.transpose(0, 2, 1)):
        demo = load(written(path, {"O_T_EE": stored}), dataset="O_T_EE", rate=100.0)
        np.testing.assert_array_equal(demo.position, PATH)
        assert (demo.rotation * TURN.inv()).magnitude().max() < 1e-7
    with pytest.raises(DemonstrationError, match="matrices are no poses"):
        load(written(path, {"O_T_EE": 2.0 * poses}), dataset="O_T_EE", rate=100.0)


def test_datasets_are_named_in_the_file_or_in_an_episode(path):
    datasets = {
        f"data/demo_{i}/obs/{name}": PATH + i for i in range(3) for name in ("robot0_eef_pos", "cup_pos")
    }
    written(path, datasets)
    with pytest.raises(DemonstrationError, match="3 episodes"):
        load(path)
    np.testing.assert_array_equal(load(path, dataset="data/demo_1/obs/cup_pos", rate=20.0).position, PATH + 1)
    np.testing.assert_array_equal(
        load(path, episode="2", dataset="obs/cup_pos", rate=20.0).position, PATH + 2
    )
    np.testing.assert_array_equal(
        load(path, episode="2", dataset="/obs/cup_pos", rate=20.0).position, PATH + 2
    )
    with pytest.raises(DemonstrationError, match="no such dataset; did you mean 'data/demo_0/obs/cup_pos'"):
        load(path, episode=0, dataset="data/demo_0/obs/cup_poss")


def test_columns_of_a_dataset_are_chosen_by_their_numbers(path):
    table = np.c_[np.zeros(N), PATH, np.outer(SHARE, [90.0, 45.0])]
    written(path, {"table": table, "time": 0.1 * np.arange(N)})
    np.testing.assert_array_equal(load(path, dataset="table", columns=["2", "3", "4"]).position, PATH)
    joints = load(path, dataset="table", columns=["5", "6"], unit="deg")
    np.testing.assert_allclose(joints.position, np.deg2rad(table[:, 4:]))
    assert (joints.unit, joints.axes) == ("rad", ("table[4]", "table[5]"))
    for columns in (["7"], ["0"], ["x"], ["1", "1"]):
        with pytest.raises(ComoveError, match=r"column|twice"):
            load(path, dataset="table", columns=columns)
    with pytest.raises(OptionError, match="--dataset PATH"):
        load(path, columns=["1"])


def test_links_are_followed_only_inside_the_file(path, tmp_path):
    with h5py.File(written(path, {"kept/xyz": PATH, "time": 0.1 * np.arange(N)}), "a") as file:
        file["position"] = h5py.SoftLink("/kept/xyz")
        file["loop"] = h5py.SoftLink("/loop")
        file["lost"] = h5py.SoftLink("/nowhere")
        file["other"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/xyz")
    np.testing.assert_array_equal(load(path, dataset="position").position, PATH)
    for name, says in (
        ("loop", "not in the file"),
        ("lost", "not in the file"),
        ("other", "link into another file"),
    ):
        with pytest.raises(DemonstrationError, match=says):
            load(path, dataset=name)
    assert not (tmp_path / "other.h5").exists()


def test_what_a_dataset_holds_instead_of_numbers_is_told(path):
    records = np.zeros(N, dtype=[("t", "f8"), ("x", "f8")])
    written(path, {"words": ["a"] * N, "records": records, "xyz": PATH, "t": 0.1 * np.arange(N)})
    for name, says in (("words", "it holds text"), ("records", "it holds records of t, x")):
        with pytest.raises(DemonstrationError, match=says) as caught:
            load(path, dataset=name)
        assert printed_options(caught.value)["dataset"] == "xyz"


def test_a_rate_is_asked_for_where_nothing_says_it(path):
    written(path, {"data/demo_0/obs/eef_pos": PATH, "data/demo_0/obs/eef_quat": WXYZ})
    with pytest.raises(DemonstrationError, match="nothing says when its rows were recorded") as caught:
        load(path)
    demo = load(path, **printed_options(caught.value))
    assert demo.duration == pytest.approx((N - 1) / 100)
    assert demo.orientation is None
    assert any("nothing says in which order" in note for note in demo.notes)
    told = load(written(path, {"xyz": PATH}, {"@fps": 30}))
    assert told.duration == pytest.approx((N - 1) / 30)


def test_what_is_huge_is_told_before_it_is_read(path):
    with h5py.File(path, "w") as file:
        file.create_dataset("xyz", (10**10, 3), "f4", chunks=(1000, 3), compression="gzip")
        file["t"] = np.zeros(5)
    with pytest.raises(DemonstrationError, match="it claims float32"):
        load(path, dataset="xyz", rate=10.0)
