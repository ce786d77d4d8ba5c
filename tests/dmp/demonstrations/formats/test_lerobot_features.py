"""What the coordinates of LeRobot's vectors hold: numbers against those written by pyarrow."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comove.dmp.demonstrations import Demonstration, read_lerobot, write_lerobot
from comove.dmp.demonstrations.formats import lerobot
from comove.dmp.demonstrations.formats.lerobot_features import UNSTATED
from comove.errors import ComoveError, ComoveWarning, DemonstrationError
from tests.dmp.demonstrations.formats.advice import follow, printed_options

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")

N, FPS = 31, 20
STATE = "observation.state"
SHARE = np.linspace(0.0, 1.0, N)
PATH = np.stack([0.3 * SHARE, 0.1 * np.sin(np.pi * SHARE), 0.2 + 0.05 * SHARE], axis=1).astype(np.float32)
ANGLES = np.outer(SHARE, [0.2, -0.4, 1.0]).astype(np.float32)
GRIP = (SHARE > 0.5).astype(np.float32)[:, None]
EULER = Rotation.from_euler("xyz", ANGLES)
VECTOR = Rotation.from_rotvec(ANGLES)
XYZW = VECTOR.as_quat().astype(np.float32)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "dataset"


def dataset(path, vectors, *, stamps=None, lengths=(N,), robot_type="x", fps=FPS, frames=None):
    """A dataset of version 2.1 as LeRobot writes it: vectors are (values, names) by feature."""
    (path / "meta").mkdir(parents=True)
    (path / "data/chunk-000").mkdir(parents=True)
    features, first = {}, 0
    for name, (values, names) in vectors.items():
        features[name] = {"dtype": "float32", "shape": [values.shape[1]], "names": names}
    features["observation.images.top"] = {
        "dtype": "video",
        "shape": [4, 4, 3],
        "names": ["height", "width", "c"],
    }
    features["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
    for episode, length in enumerate(lengths):
        table = {
            name: pa.array(values[:length].tolist(), pa.list_(pa.float32()))
            for name, (values, _) in vectors.items()
        }
        table["timestamp"] = pa.array(
            (np.arange(length) / fps if stamps is None else stamps[:length]).astype(np.float32)
        )
        table |= {"frame_index": np.arange(length), "episode_index": np.full(length, episode)}
        pq.write_table(pa.table(table), path / f"data/chunk-000/episode_{episode:06d}.parquet")
        first += length
    info = {
        "codebase_version": "v2.1",
        "robot_type": robot_type,
        "total_episodes": len(lengths),
        "fps": fps,
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "features": features,
    }
    (path / "meta/info.json").write_text(json.dumps(info))
    rows = [{"episode_index": i, "tasks": ["lift"], "length": length} for i, length in enumerate(lengths)]
    (path / "meta/episodes.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return path


def state(path, values, names, **options):
    return dataset(path, {STATE: (np.asarray(values, np.float32), names)}, **options)


def motors(text):
    return {"motors": text.split()}


@pytest.mark.parametrize(
    ("columns", "names", "rotation"),
    [
        ([PATH, XYZW[:, [3, 0, 1, 2]], GRIP], ["x", "y", "z", "qw", "qx", "qy", "qz", "gripper"], VECTOR),
        (
            [PATH, XYZW, GRIP],
            ["ee.x", "ee.y", "ee.z", "ee.qx", "ee.qy", "ee.qz", "ee.qw", "gripper.pos"],
            VECTOR,
        ),
        ([PATH, XYZW, GRIP], motors("x y z quat_x quat_y quat_z quat_w gripper"), VECTOR),
        ([PATH, XYZW, GRIP], motors("x y z rx ry rz rw gripper"), VECTOR),
        ([PATH, ANGLES], ["x", "y", "z", "roll", "pitch", "yaw"], EULER),
        ([PATH, ANGLES, GRIP, GRIP], motors("x y z roll pitch yaw gripper gripper"), EULER),
        ([PATH, ANGLES, 0 * GRIP, GRIP], motors("x y z roll pitch yaw pad gripper"), EULER),
        ([PATH, ANGLES, GRIP, GRIP], motors("x y z rx ry rz gripper_left gripper_right"), VECTOR),
        ([PATH, ANGLES, ANGLES, GRIP], motors("x y z roll pitch yaw joint_0 joint_1 joint_2 gripper"), EULER),
        ([PATH, GRIP], [["x", "y", "z", "gripper"]], None),
        ([PATH, GRIP], {"x": 0, "y": 1, "z": 2, "gripper": 3}, None),
        ([GRIP, PATH[:, ::-1]], ["gripper", "tcp_z", "tcp_y", "tcp_x"], None),
        ([PATH, ANGLES], motors("x y z axis_angle1 axis_angle2 axis_angle3"), None),
    ],
)
def test_position_orientation_and_gripper_are_told_apart(path, columns, names, rotation):
    demo = Demonstration.load(state(path, np.concatenate(columns, axis=1), names))
    assert (demo.unit, demo.axes) == ("m", ())
    np.testing.assert_array_equal(demo.position, PATH)
    np.testing.assert_array_equal(demo.time, np.arange(N) / FPS)
    if rotation is None:
        assert demo.orientation is None
    else:
        assert (demo.rotation * rotation.inv()).magnitude().max() < 1e-6
    assert any(note.startswith("position from") for note in demo.notes)


def test_two_hands_are_two_movements(path):
    names = [f"{side}_arm_ee_pos_{axis}" for side in ("left", "right") for axis in "xyz"]
    state(path, np.concatenate([PATH, PATH + 1], axis=1), names)
    with pytest.raises(DemonstrationError, match="2 manipulators") as caught:
        Demonstration.load(path)
    first = Demonstration.load(path, **printed_options(caught.value))
    np.testing.assert_array_equal(first.position, PATH)
    np.testing.assert_array_equal(Demonstration.load(path, "right").position, PATH + 1)


SO_101 = [
    f"{joint}.pos" for joint in ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
]


@pytest.mark.parametrize("scale", [60.0, 5.0])
def test_small_arms_are_joints_in_a_unit_that_nothing_says(path, scale):
    """Whether their numbers are large or small: they are never taken for radians, nor for a path."""
    values = scale * np.concatenate([ANGLES, ANGLES[:, :2], GRIP], axis=1)
    demo = Demonstration.load(state(path, values, [*SO_101, "gripper.pos"]))
    assert (demo.unit, demo.is_joints, demo.axes) == (UNSTATED, True, (*SO_101, "gripper.pos"))
    np.testing.assert_array_equal(demo.position, values)
    assert any("degrees, or percent" in note for note in demo.notes)
    angles = Demonstration.load(path, unit="deg")
    assert (angles.unit, angles.axes) == ("rad", tuple(SO_101))
    np.testing.assert_allclose(angles.position, np.deg2rad(values[:, :5]))
    assert any("left out: gripper.pos" in note for note in angles.notes)


def test_arms_of_two_sides_and_rolls_of_the_wrist_are_joints(path):
    aloha = ["waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate", "gripper"]
    names = [f"{side}_{joint}" for side in ("left", "right") for joint in aloha]
    arms = read_lerobot(state(path, np.tile(SHARE[:, None], (1, 14)), names))["0"]
    assert {side: demo.axes for side, demo in arms.items()} == {"left": tuple(aloha), "right": tuple(aloha)}
    humanoid = ["kLeftShoulderPitch", "kLeftShoulderRoll", "kLeftElbow", "kLeftWristYaw"]
    (arm,) = read_lerobot(state(path.with_name("g1"), np.tile(SHARE[:, None], (1, 4)), [humanoid]))[
        "0"
    ].values()
    assert len(arm.axes) == 4
    old = ["main_shoulder_pan", "main_wrist_roll", "main_gripper"]
    koch = state(path.with_name("koch"), np.tile(SHARE[:, None], (1, 3)), old, robot_type="koch")
    assert (Demonstration.load(koch).unit, Demonstration.load(koch).n_dims) == (UNSTATED, 3)


@pytest.mark.parametrize(
    "names", [None, ["state"], {"motors": ["state"]}, [], 5, list("abcdefgh"), motors("x y z r p y g g")]
)
def test_names_that_say_nothing_lead_to_the_numbers_of_columns(path, names):
    values = np.concatenate([PATH, ANGLES, GRIP, GRIP], axis=1)
    state(path, values, names)
    with pytest.raises(DemonstrationError, match=r"nothing says which|some stand twice") as caught:
        Demonstration.load(path)
    assert printed_options(caught.value)["columns"] == ["1", "2", "3"]
    np.testing.assert_array_equal(follow(path).position, PATH)
    joints = Demonstration.load(path, columns=["4", "5", "6"], unit="rad")
    assert (joints.unit, joints.n_dims, joints.is_joints) == ("rad", 3, True)
    np.testing.assert_array_equal(joints.position, ANGLES)


def test_columns_are_chosen_by_name_as_well(path):
    names = ["x", "y", "z", "joint_0", "joint_1", "gripper", "gripper"]
    state(path, np.concatenate([PATH, ANGLES[:, :2], GRIP, GRIP], axis=1), names)
    joints = Demonstration.load(path, columns=["joint_0", "joint_1"])
    assert (joints.axes, joints.unit) == (("joint_0", "joint_1"), "rad")
    np.testing.assert_array_equal(Demonstration.load(path, columns=["x", "z"]).position, PATH[:, [0, 2]])
    for columns, says in [
        (["joint_9"], "there is no column 'joint_9'; did you mean"),
        (["gripper"], r"2 columns are called 'gripper'.*--columns 6"),
        (["1", "x"], "'x' stands twice"),
        (["8"], "there is no column '8'"),
        (["1", "2", "3", "6"], "4 columns are no position"),
    ]:
        with pytest.raises(ComoveError, match=says):
            Demonstration.load(path, columns=columns)


def test_the_only_vector_is_taken_and_of_several_one_is_named(path):
    names = ["x", "y", "z"]
    dataset(path, {"state": (PATH, names), "actions": (PATH + 1, names)})
    np.testing.assert_array_equal(Demonstration.load(path).position, PATH)
    np.testing.assert_array_equal(Demonstration.load(path, feature="actions").position, PATH + 1)
    several = dataset(path.with_name("b"), {"left": (PATH, names), "right": (PATH + 1, names)})
    with pytest.raises(DemonstrationError, match=r"vectors are left \[3\], right \[3\]") as caught:
        Demonstration.load(several)
    assert printed_options(caught.value) == {"feature": "left"}
    np.testing.assert_array_equal(follow(several).position, PATH)
    with pytest.raises(
        DemonstrationError, match=r"shape \[4, 4, 3\], which is no vector; choose one of left, right"
    ):
        Demonstration.load(several, feature="observation.images.top")


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_stamps_in_other_units_are_seen_beside_the_rate(path, factor, unit):
    demo = Demonstration.load(state(path, PATH, ["x", "y", "z"], stamps=factor * np.arange(N) / FPS))
    np.testing.assert_allclose(demo.time, np.arange(N) / FPS, rtol=1e-6)
    assert any(f"taken to be in {unit}" in note for note in demo.notes)


def test_stamps_that_begin_again_lead_to_the_rate(path):
    stamps = np.r_[np.arange(16) / FPS, np.arange(N - 16) / FPS]
    state(path, PATH, ["x", "y", "z"], stamps=stamps)
    with pytest.raises(
        DemonstrationError, match=r"row 16, column timestamp: time goes back from 0\.75 s to 0 s"
    ):
        Demonstration.load(path)
    demo = follow(path)
    np.testing.assert_allclose(demo.time, np.arange(N) / FPS)
    np.testing.assert_array_equal(demo.position, PATH)


def test_episodes_of_one_row_are_left_out_of_all_and_told(path):
    state(path, PATH, ["x", "y", "z"], lengths=(N, 1, 0, N))
    with pytest.warns(ComoveWarning, match="without two rows are left out: 1, 2"):
        assert list(read_lerobot(path)) == ["0", "3"]
    with pytest.raises(DemonstrationError, match="episode 1 has 1; choose another episode"):
        read_lerobot(path, episode=1)
    assert lerobot.episodes(path) == ("0", "1", "2", "3")


@pytest.mark.parametrize("unit", ["rad", "deg", UNSTATED])
def test_joints_of_any_name_keep_their_unit(path, unit):
    joints = Demonstration(
        np.arange(5) / 20, np.outer(range(5), [0.1, 0.2]), unit=unit, axes=("alpha", "beta")
    )
    write_lerobot(path, [joints], dtype="float64")
    again = Demonstration.load_all(path)[0]
    assert (again.axes, again.unit) == (joints.axes, "rad" if unit == "deg" else unit)
    scale = np.pi / 180 if unit == "deg" else 1.0
    np.testing.assert_allclose(again.position, scale * joints.position)


def test_pointers_of_git_lfs_are_told(path):
    state(path, PATH, ["x", "y", "z"])
    for file in ("data/chunk-000/episode_000000.parquet", "meta/info.json"):
        (path / file).write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n")
        with pytest.raises(DemonstrationError, match=r"a pointer of Git LFS.*git lfs pull"):
            Demonstration.load(path)
