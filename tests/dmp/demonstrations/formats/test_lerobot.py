"""LeRobot datasets: round trips to the precision of the format, foreign ones, and damage told."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from comove.dmp.demonstrations import Demonstration, read_lerobot, write_lerobot
from comove.dmp.demonstrations.formats import lerobot
from comove.dmp.demonstrations.formats.lerobot_tables import DatasetTables
from comove.errors import DemonstrationError
from tests.dmp.demonstrations.formats import test_lerobot_features as features

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")
STATE = "observation.state"
ALOHA = [f"{arm}_{joint}" for arm in ("left", "right") for joint in ("waist", "elbow", "gripper")]


@pytest.fixture
def path(tmp_path):
    return tmp_path / "dataset"


def pair(hand, seed=0, **changes):
    return {"left": hand(seed, rate=30.0, **changes), "right arm": hand(seed + 50, rate=30.0, **changes)}


def info(path, **changes):
    """Change `meta/info.json`."""
    file = path / "meta/info.json"
    content = json.loads(file.read_text())
    features = content["features"] | changes.pop("features", {})
    file.write_text(json.dumps(content | {"features": features} | changes))


DATA = "data/chunk-000/file-000.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"


def parquet(path, **changes):
    """Change columns of the table of frames."""
    file = path / DATA
    table = pq.read_table(file)
    columns = {name: table.column(name) for name in table.column_names} | changes
    pq.write_table(pa.table({name: column for name, column in columns.items() if column is not None}), file)
    return file


def version_3(path, names=ALOHA, lengths=(5, 4, 6), fps=50):
    """A dataset as version 3.0 lays it out: two files, the first of which holds two episodes."""
    rng = np.random.default_rng(0)
    states, episodes = [], []
    for index, length in enumerate(lengths):
        states.append(rng.normal(size=(length, len(names))).astype(np.float32))
        where = {"data/chunk_index": 0, "data/file_index": int(index > 1)}
        episodes.append({"episode_index": index, "length": length, "tasks": ["lift"], **where})
    for number, chosen in enumerate([(0, 1), (2,)]):
        rows = [(index, frame) for index in chosen for frame in range(lengths[index])]
        columns = {
            STATE: [states[index][frame].tolist() for index, frame in rows],
            "timestamp": pa.array([np.float32(frame / fps) for _, frame in rows], pa.float32()),
            "frame_index": [frame for _, frame in rows],
            "episode_index": [index for index, _ in rows],
        }
        columns[STATE] = pa.array(columns[STATE], pa.list_(pa.float32()))
        (path / "data/chunk-000").mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.table(columns), path / f"data/chunk-000/file-{number:03d}.parquet")
    (path / "meta/episodes/chunk-000").mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(episodes), path / "meta/episodes/chunk-000/file-000.parquet")
    tasks = pa.table({"task_index": [0], "__index_level_0__": ["lift"]})
    pq.write_table(tasks, path / "meta/tasks.parquet")
    content = {
        "codebase_version": "v3.0",
        "fps": fps,
        "total_episodes": len(lengths),
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "features": {STATE: {"dtype": "float32", "shape": [len(names)], "names": {"motors": names}}},
    }
    (path / "meta/info.json").write_text(json.dumps(content))
    return states


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_what_is_written_is_read_to_the_precision_of_its_numbers(path, hand, dtype):
    episodes = [pair(hand, seed) for seed in range(3)]
    write_lerobot(path, episodes, dtype=dtype, task="carry")
    again = read_lerobot(path)
    assert list(again) == ["0", "1", "2"] == list(lerobot.episodes(path))
    for episode, written in zip(again.values(), episodes, strict=True):
        assert list(episode) == ["left", "right arm"]
        for name, demo in episode.items():
            kept = written[name].position.astype(dtype).astype(float)
            assert demo.position.tobytes() == kept.tobytes()
            np.testing.assert_allclose(demo.orientation, written[name].orientation, atol=1e-7)
            assert demo.time.tobytes() == written[name].time.tobytes()
            assert demo.notes[0] == "task: carry"
    if dtype == "float64":
        assert again["1"]["left"].orientation.tobytes() == episodes[1]["left"].orientation.tobytes()


def test_the_folder_is_laid_out_as_version_3(path, hand):
    write_lerobot(path, [pair(hand), pair(hand, 1, n_steps=7)], task="carry", robot_type="two hands")
    content = json.loads((path / "meta/info.json").read_text())
    assert content["codebase_version"] == "v3.0"
    assert (content["fps"], content["total_episodes"], content["total_frames"]) == (30, 2, 19)
    assert content["robot_type"] == "two hands"
    names = content["features"][STATE]["names"]
    assert names[:8] == [*(f"left_{a}" for a in ("x", "y", "z", "qw", "qx", "qy", "qz")), "right arm_x"]
    row = pq.read_table(path / EPISODES).to_pylist()[1]
    assert (row["episode_index"], row["tasks"], row["length"]) == (1, ["carry"], 7)
    assert (row["dataset_from_index"], row["dataset_to_index"]) == (12, 19)
    assert pq.read_table(path / "meta/tasks.parquet").column("task").to_pylist() == ["carry"]
    table = pq.read_table(path / DATA)
    assert set(table.column_names) == set(content["features"])
    assert str(table.schema.field("timestamp").type) == "float"
    assert table.column("index").to_pylist() == list(range(19))
    state, action = (np.array(table.column(name).to_pylist())[12:] for name in (STATE, "action"))
    np.testing.assert_array_equal(action[:-1], state[1:])
    np.testing.assert_allclose(row[f"stats/{STATE}/mean"], state.mean(axis=0))
    assert row[f"stats/{STATE}/count"] == [7]
    assert json.loads((path / "meta/stats.json").read_text())[STATE]["count"] == [19]


def test_joints_keep_their_names(path, hand):
    joints = {
        "n_dims": 3,
        "turned": False,
        "rate": 50.0,
        "unit": "rad",
        "axes": ("waist", "elbow", "gripper"),
    }
    write_lerobot(path, [{"left": hand(0, **joints), "right": hand(1, **joints)}])
    (arms,) = read_lerobot(path).values()
    assert {name: demo.axes for name, demo in arms.items()} == dict.fromkeys(
        ("left", "right"), joints["axes"]
    )
    assert arms["left"].unit == "rad"


def test_version_3_is_read(path):
    states = version_3(path)
    again = read_lerobot(path)
    assert list(again) == ["0", "1", "2"]
    for state, arms in zip(states, again.values(), strict=True):
        assert list(arms) == ["left", "right"]
        np.testing.assert_array_equal(arms["right"].position, state[:, 3:])
        assert arms["left"].axes == ("waist", "elbow", "gripper")
        np.testing.assert_array_equal(arms["left"].time, np.arange(len(state)) / 50)
    assert again["1"]["left"].notes[0] == "task: lift"
    assert list(read_lerobot(path, episode=2)) == ["2"]
    assert read_lerobot(path, unit="deg")["0"]["left"].unit == "deg"


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["x", "y", "z"], {"": ((), "m")}),
        (["y", "x"], {"": ((), "m")}),
        (["shoulder_pan.pos", "gripper.pos"], {"": (("shoulder_pan.pos", "gripper.pos"), "LeRobot unit")}),
        (["shoulder_pan", "gripper"], {"": (("shoulder_pan", "gripper"), "rad")}),
        (["left_waist", "torso"], {"": (("left_waist", "torso"), "rad")}),
        (["a_x", "a_y", "b_x", "b_y"], {"a": ((), "m"), "b": ((), "m")}),
    ],
)
def test_names_say_whose_coordinates_they_are(path, names, expected):
    version_3(path, names)
    (demos, *_) = read_lerobot(path).values()
    assert {name: (demo.axes, demo.unit) for name, demo in demos.items()} == expected


def test_stamps_that_are_not_even_are_kept(path, hand):
    write_lerobot(path, [hand(rate=30.0)])
    stamps = np.arange(12, dtype=np.float32) / 30 + np.float32(0.001) * (np.arange(12) % 2)
    parquet(path, timestamp=pa.array(stamps))
    (demo,) = read_lerobot(path)["0"].values()
    np.testing.assert_allclose(demo.time, stamps, atol=1e-9)


def test_other_features_are_read_by_name(path, hand):
    demo = hand(rate=30.0)
    write_lerobot(path, [demo], dtype="float64")
    (action,) = read_lerobot(path, feature="action")["0"].values()
    assert action.position[:-1].tobytes() == demo.position[1:].tobytes()
    with pytest.raises(DemonstrationError, match=r"there is no 'acton'; did you mean 'action'"):
        read_lerobot(path, feature="acton")
    with pytest.raises(DemonstrationError, match="there is no episode 7; known: 0"):
        read_lerobot(path, episode=7)


def eight(axis):
    return [axis, "y", "z", *(f"gripper{i}" for i in range(5))]


def joints(n):
    return [f"joint{i}" for i in range(n)]


VECTOR = {"dtype": "float32", "shape": [7], "names": list("abcdefg")}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"codebase_version": "v1.6"}, "codebase_version: 'v1.6' is not read; convert"),
        ({"codebase_version": 3}, "codebase_version: it is '3'"),
        ({"fps": 0}, "fps: 0 is no rate"),
        ({"fps": "fast"}, "fps: it is 'fast'"),
        ({"fps": True}, "fps: it is 'True'"),
        ({"total_episodes": 3}, "total_episodes: it says 3, and 2 episodes are described"),
        ({"data_path": "../{episode_index:06d}.parquet"}, "data_path: .*names no file in the dataset"),
        ({"data_path": "/tmp/{episode_index}"}, "data_path: .*names no file in the dataset"),
        ({"data_path": "{episode_index.__class__}"}, "data_path: .*names no file in the dataset"),
        ({"data_path": "{episode_index:0999999999d}"}, "data_path: .*names no file in the dataset"),
        ({"data_path": "data/no_{episode_index:06d}.parquet"}, "no_000000.parquet: there is no such file"),
        ({"features": {STATE: VECTOR | {"shape": [7, 2]}}}, r"shape \[7, 2\], which is no vector"),
        ({"features": {STATE: VECTOR | {"shape": [6]}}}, "coordinates have no names: nothing says"),
        ({"features": {STATE: VECTOR | {"names": ["x"] * 7}}}, "names x, x, .*: some stand twice"),
        ({"features": {STATE: VECTOR | {"names": 5}}}, "coordinates have no names: nothing says"),
        ({"features": {STATE: {"shape": [8], "names": eight("x")}}}, "7 numbers, and 8 are described"),
        ({"features": {STATE: {"shape": [99], "names": joints(99)}}}, "it has 99 coordinates; up to 64"),
        ({"features": {STATE: 1}}, f"there is no '{STATE}'"),
    ],
)
def test_descriptions_that_do_not_fit_are_told(path, hand, changes, says):
    write_lerobot(path, [hand(rate=30.0), hand(1, rate=30.0)])
    info(path, **changes)
    with pytest.raises(DemonstrationError, match=says) as caught:
        read_lerobot(path)
    assert str(path) in str(caught.value)


def test_a_key_that_is_missing_is_told(path, hand):
    write_lerobot(path, [hand(rate=30.0)])
    content = json.loads((path / "meta/info.json").read_text())
    for key in ("codebase_version", "fps", "features", "total_episodes", "data_path"):
        (path / "meta/info.json").write_text(json.dumps({k: v for k, v in content.items() if k != key}))
        with pytest.raises(DemonstrationError, match=f"info.json: {key}: it is missing"):
            read_lerobot(path)


def vectors(*rows):
    return pa.array(rows, pa.list_(pa.float32()))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({STATE: None}, f"{STATE}: the column is missing"),
        ({"timestamp": None}, "timestamp: the column is missing"),
        ({STATE: pa.array(["a"] * 12)}, "it holds string, not numbers"),
        ({STATE: vectors(*[["1"] * 0] * 12)}, r"row 0, observation.state: it has 0 numbers, and 7"),
        ({STATE: vectors(*[[1.0] * 7] * 11, [1.0])}, r"row 11, observation.state: it has 1 numbers, and 7"),
        ({STATE: vectors(*[[1.0] * 7] * 11, None)}, "1 rows of episode 0 are empty"),
        ({STATE: vectors(*[[1.0] * 7] * 11, [None] * 7)}, "7 numbers are missing"),
        ({STATE: pa.array([1.0] * 12)}, "one number a row, and 7 are described"),
        ({STATE: vectors(*[[float("nan")] * 7] * 12)}, r"row 0, observation.state\[0\]: nan"),
        ({STATE: vectors(*[[1.0] * 7] * 12)}, r"row 0, observation.state\[3\] to \[6\]: .*norm 2, not 1"),
        ({"episode_index": pa.array([1] * 12)}, "it holds 0 rows of episode 0, and 12 were recorded"),
        ({"episode_index": pa.array([0] * 11 + [None])}, "1 rows are empty"),
        ({"timestamp": pa.array([0.0] * 12, pa.float32())}, "row 1, column timestamp: time stands still"),
        (
            {"timestamp": pa.array([1.0] + [0.0] * 11, pa.float32())},
            "row 1, column timestamp: time goes back from 1 s to 0 s; .* --rate 30",
        ),
    ],
)
def test_tables_that_do_not_fit_are_told(path, hand, changes, says):
    write_lerobot(path, [hand(rate=30.0)])
    file = parquet(path, **changes)
    with pytest.raises(DemonstrationError, match=says) as caught:
        read_lerobot(path)
    assert str(file) in str(caught.value)


def older(path):
    """A dataset of version 2.1 with one episode of 12 rows."""
    return features.state(path, np.eye(12)[:, :3], ["x", "y", "z"], lengths=(12,))


def test_episodes_that_are_empty_or_out_of_order_are_told(path):
    older(path)
    file = path / "meta/episodes.jsonl"
    for row, says in [
        ({"episode_index": 0, "length": 11}, "it holds 12 rows of episode 0, and 11 were recorded"),
        ({"episode_index": -1, "length": 12}, "episode -1 of length 12 stands there"),
        ({"episode_index": 0}, "line|length: it is missing"),
        ({"episode_index": 0, "length": 10**9}, "1,000,000,000 rows; read one by one"),
        ([], "line 1: it is no JSON object"),
    ]:
        file.write_text(json.dumps(row) + "\n")
        with pytest.raises(DemonstrationError, match=says):
            read_lerobot(path)
    empty = {"episode_index": 0, "length": 0}
    file.write_text(json.dumps(empty) + "\n")
    table = path / "data/chunk-000/episode_000000.parquet"
    content = pq.read_table(table)
    at = content.column_names.index("episode_index")
    pq.write_table(content.set_column(at, "episode_index", pa.array([5] * 12)), table)
    with pytest.raises(DemonstrationError, match="a movement needs two rows at least, episode 0 has 0"):
        read_lerobot(path)
    version_3(path.with_name("three"))
    (path.with_name("three") / "meta/episodes/chunk-000/file-000.parquet").unlink()
    with pytest.raises(DemonstrationError, match="there is no table of the episodes"):
        read_lerobot(path.with_name("three"))


def test_claims_are_compared_with_a_limit_before_anything_is_read(path, monkeypatch):
    older(path)
    monkeypatch.setattr(pq.ParquetFile, "iter_batches", lambda *_, **__: pytest.fail("read"))
    for name, says in [("MAX_ROWS", "12 rows"), ("MAX_BYTES", "more than")]:
        with monkeypatch.context() as patch:
            patch.setattr(lerobot, name, 5)
            with pytest.raises(DemonstrationError, match=says):
                read_lerobot(path)


def test_columns_are_read_up_to_the_limit(path, hand, monkeypatch):
    write_lerobot(path, [hand(rate=30.0)])
    monkeypatch.setattr(lerobot, "_BATCH", 5)
    (demo,) = read_lerobot(path)["0"].values()
    assert demo.n_steps == 12
    monkeypatch.setattr(lerobot, "MAX_COLUMN_BYTES", 100)
    with pytest.raises(DemonstrationError, match="has columns of more than 0 MB; split the dataset"):
        read_lerobot(path)


@pytest.mark.parametrize("step", [pytest.param(1, marks=pytest.mark.slow), 8])
def test_a_damaged_description_of_a_column_does_not_end_the_process(path, hand, step):
    """Which pyarrow does where it is asked for the sizes of columns; found by changing bytes."""
    write_lerobot(path, [hand(rate=30.0)])
    file = path / DATA
    content = file.read_bytes()
    footer = len(content) - 8 - int.from_bytes(content[-8:-4], "little")
    code = """
import sys
from pathlib import Path
from comove.dmp.demonstrations import read_lerobot
from comove.errors import DemonstrationError

file = Path(sys.argv[2])
content = file.read_bytes()
for at in range(int(sys.argv[3]), len(content), int(sys.argv[4])):
    file.write_bytes(content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :])
    try:
        read_lerobot(sys.argv[1])
    except DemonstrationError:
        pass
"""
    done = subprocess.run(
        [sys.executable, "-c", code, path, file, str(footer), str(step)], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_a_changed_number_is_told_by_the_checksum_of_its_page(path, hand):
    """Every number of a movement that comove wrote; files without checksums of pages cannot tell."""
    write_lerobot(path, [hand(rate=30.0)])
    before = read_lerobot(path)["0"][""]
    file = path / DATA
    content = file.read_bytes()
    footer = len(content) - 8 - int.from_bytes(content[-8:-4], "little")
    told = 0
    for at in range(4, footer, 3):
        file.write_bytes(content[:at] + bytes([content[at] ^ 4]) + content[at + 1 :])
        try:
            after = read_lerobot(path)["0"][""]
        except DemonstrationError:
            told += 1
        else:  # of a column that is not read
            np.testing.assert_array_equal(after.position, before.position)
            np.testing.assert_array_equal(after.time, before.time)
            np.testing.assert_array_equal(after.orientation, before.orientation)
    assert told > 100


def test_files_cut_anywhere_are_refused(path, hand, cut_anywhere):
    write_lerobot(path, [hand(rate=30.0)])
    cut_anywhere(lambda: read_lerobot(path), path / "meta/info.json", step=7)
    cut_anywhere(lambda: read_lerobot(path), path / DATA, step=11)
    cut_anywhere(lambda: read_lerobot(path), path / EPISODES, step=31)
    two = older(path.with_name("two"))
    file = two / "meta/episodes.jsonl"
    file.write_text(file.read_text().rstrip("\n"))
    content = file.read_bytes()
    for length in range(len(content)):
        file.write_bytes(content[:length])
        with pytest.raises(DemonstrationError, match=r"line 1|0 episodes are described"):
            read_lerobot(two)
    file.write_bytes(content)
    cut_anywhere(lambda: read_lerobot(two), two / "data/chunk-000/episode_000000.parquet", step=11)


@pytest.mark.slow
def test_tables_cut_at_every_byte_are_refused(path, hand, cut_anywhere):
    write_lerobot(path, [hand(rate=30.0)])
    cut_anywhere(lambda: read_lerobot(path), path / DATA)


def test_damage_is_read_or_told(path, hand, damaged):
    write_lerobot(path, [hand(rate=30.0)])
    two = older(path.with_name("two"))

    def read(folder):
        return [demo for demos in read_lerobot(folder).values() for demo in demos.values()]

    for file in (DATA, EPISODES, "meta/info.json"):
        damaged(lambda: read(path), path / file, 60)
    damaged(lambda: read(two), two / "meta/episodes.jsonl", 60)


def test_the_folder_appears_whole_or_not_at_all(path, hand, monkeypatch):
    monkeypatch.setattr(DatasetTables, "finish", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        write_lerobot(path, [hand(rate=30.0)])
    assert os.listdir(path.parent) == []


def test_what_does_not_fit_is_not_written(path, refused, hand):
    uneven = Demonstration([0.0, 0.1, 0.3], np.eye(3))
    for episodes, says, way_out in [
        ([], "no episode", "give one"),
        ([hand(), hand(rate=30.0)], "episode 1 runs at 30 Hz", "resample"),
        ([hand(rate=2.5)], "episode 0 runs at 2.5 Hz", "whole number"),
        ([uneven], "no even step", "resampled"),
        (
            [{"a": hand(unit="rad", axes=("j", "k", "l")), "b": hand(unit="rad", axes=("j", "k", "l"))}],
            "a_j, .* would not be read as 'a', 'b'",
            "left and right",
        ),
    ]:
        refused(lambda p, e=episodes: write_lerobot(p, e), path, key=None, says=says, way_out=way_out)
    with pytest.raises(DemonstrationError, match="dtype: 'float16' is no kind of number"):
        write_lerobot(path, [hand()], dtype="float16")
    assert os.listdir(path.parent) == []
    path.mkdir()
    write_lerobot(path, [hand()])
    refused(lambda p: write_lerobot(p, [hand()]), path, key=None, says="not empty", way_out="name another")
    write_lerobot(path.parent / "new" / "dataset", [hand()])


def test_what_is_no_dataset_is_told(path):
    with pytest.raises(DemonstrationError, match=r"info\.json: there is no such file"):
        read_lerobot(path)


def test_a_missing_library_names_the_command(path, hand, without):
    write_lerobot(path, [hand()])
    without("pyarrow")
    for use in (lambda: read_lerobot(path), lambda: write_lerobot(path.with_name("b"), [hand()])):
        with pytest.raises(DemonstrationError, match=r"needs pyarrow, .*; run: pip install 'comove\[data\]'"):
            use()
    assert os.listdir(path.parent) == ["dataset"]
