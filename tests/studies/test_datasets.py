"""Datasets hold the verified episodes, sample by sample, under the names of their ecosystems, or are not there."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

import comove
from comove.errors import OptionError, ResultError
from comove.studies import Study, StudyStore, on_processes, run_study
from comove.studies.datasets import FORMATS, export_episodes
from comove.studies.datasets.lerobot import ENVIRONMENT, STATE, _Statistics
from comove.studies.datasets.samples import episodes_of
from comove.studies.runs import RUNS

EXAMPLES = Path(__file__).parents[2] / "examples" / "studies"
RATE = 30


def generate(folder, **changes):
    """A study of few episodes, run into a folder beside its file."""
    contents = yaml.safe_load((EXAMPLES / "planar.yaml").read_text())
    shutil.copy(EXAMPLES / "posts.yaml", folder)
    (folder / "study.yaml").write_text(yaml.safe_dump(contents | {"episodes": 3, "seed": 0} | changes))
    study = Study.load(folder / "study.yaml")
    run_study(study, folder / "out", on_processes(1))
    return study


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The folder of a study of three episodes, with all datasets, and its episodes."""
    folder = tmp_path_factory.mktemp("study")
    study = generate(folder)
    for format in FORMATS.values():
        pytest.importorskip({"lerobot": "pyarrow", "robomimic": "h5py"}.get(format.name, "numpy"))
        export_episodes(folder / "out", study.folder, format, RATE)
    return folder / "out", list(episodes_of(folder / "out", study.folder, RATE))


def test_samples_are_those_of_the_verified_curve(done):
    for episode in done[1]:
        trajectory, duration = episode.motion.trajectory(), episode.scene.duration
        steps = len(episode.time)
        assert episode.time[-1] >= duration > episode.time[-2]
        between = np.array(
            [
                np.interp(episode.time, trajectory.time, p)
                for p in trajectory.position.reshape(len(trajectory.time), -1).T
            ]
        ).T
        assert (
            np.abs(between - episode.position.reshape(steps, -1)).max() < 1e-4
        )  # both lie on one smooth curve
        assert np.array_equal(episode.action[:-1], episode.position[1:])
        assert np.allclose(episode.position[-1], episode.scene.goal, atol=1e-9)
        assert np.array_equal(episode.environment[0, :4], episode.scene.goal.ravel())
        center = episode.scene.file.obstacles[1].center
        assert [
            episode.environment[5, episode.environment_names.index(f"obstacle1_{a}")] for a in "xy"
        ] == list(center)


def test_lerobot_reads_back(done):
    parquet = pytest.importorskip("pyarrow.parquet")
    folder, episodes = done
    recordings = comove.Demonstration.load_recordings(folder / "lerobot")
    assert len(recordings) == 3
    for hands, episode in zip(recordings, episodes, strict=True):
        assert list(hands) == list(episode.scene.manipulators)
        for i, hand in enumerate(hands.values()):
            assert np.array_equal(hand.position, episode.position[:, i].astype(np.float32))
            assert np.allclose(hand.time, episode.time, atol=1e-9)
    table = parquet.read_table(folder / "lerobot/meta/episodes/chunk-000/file-000.parquet").to_pylist()
    rows = parquet.read_table(folder / "lerobot/data/chunk-000/file-000.parquet")
    info = json.loads((folder / "lerobot/meta/info.json").read_text())
    assert info["total_frames"] == rows.num_rows == table[-1]["dataset_to_index"]
    assert info["fps"] == RATE and info["codebase_version"] == "v3.0"
    assert set(info["features"]) == set(rows.column_names)
    assert info["features"][STATE]["names"] == ["left_x", "left_y", "right_x", "right_y"]
    assert rows.column("index").to_pylist() == list(range(rows.num_rows))
    for row, episode in zip(table, episodes, strict=True):
        begin, end = row["dataset_from_index"], row["dataset_to_index"]
        assert end - begin == row["length"] == len(episode.time)
        inner = rows.slice(begin, end - begin)
        assert set(inner.column("episode_index").to_pylist()) == {row["episode_index"]}
        assert inner.column("action").to_pylist()[0] == inner.column(STATE).to_pylist()[1]
        assert len(inner.column(ENVIRONMENT).to_pylist()[0]) == info["features"][ENVIRONMENT]["shape"][0]
        assert row["comove/seed"] == episode.run.seed
        assert row["comove/motion_sha256"] == episode.run.motion_sha256
        # Rebuilt in a process with other threads of linear algebra: the last digits may differ.
        assert row["comove/clearance_min"] == pytest.approx(episode.motion.clearance_min, abs=1e-12)
        again = comove.Scene.from_dict(json.loads(row["comove/scene_file"]), folder=folder.parent)
        assert again.sha256 == episode.scene.sha256
    tasks = parquet.read_schema(folder / "lerobot/meta/tasks.parquet").pandas_metadata
    assert tasks["index_columns"] == ["task"]


def test_statistics_are_those_of_all_rows(done):
    """Put together from episodes, they are numpy's of the whole table."""
    parquet = pytest.importorskip("pyarrow.parquet")
    rows = parquet.read_table(done[0] / "lerobot/data/chunk-000/file-000.parquet")
    stats = json.loads((done[0] / "lerobot/meta/stats.json").read_text())
    for name in (STATE, "action", ENVIRONMENT, "timestamp", "episode_index"):
        values = np.array(rows.column(name).to_pylist(), dtype=float).reshape(rows.num_rows, -1)
        for key, own in (("min", "min"), ("max", "max"), ("mean", "mean"), ("std", "std")):
            assert np.allclose(stats[name][key], getattr(values, own)(axis=0), rtol=1e-9, atol=1e-12), (
                name,
                key,
            )
        assert stats[name]["count"] == [rows.num_rows]
    rng = np.random.default_rng(0)
    first, second = rng.normal(3.0, 2.0, (50, 2)), rng.normal(-1.0, 0.1, (7, 2))
    both = _Statistics(first).with_more(_Statistics(second)).plain()
    assert np.allclose(both["std"], np.concatenate([first, second]).std(axis=0))


def test_robomimic_reads_back(done):
    h5py = pytest.importorskip("h5py")
    folder, episodes = done
    recordings = comove.Demonstration.load_recordings(folder / "robomimic.hdf5")
    for hands, episode in zip(recordings, episodes, strict=True):
        for i, hand in enumerate(hands.values()):
            assert np.array_equal(hand.position[:, :2], episode.position[:, i])
            assert not hand.position[:, 2].any()
    with h5py.File(folder / "robomimic.hdf5") as root:
        data = root["data"]
        assert data.attrs["total"] == sum(len(episode.time) for episode in episodes)
        for i, episode in enumerate(episodes):
            demo = data[f"demo_{i}"]
            assert {"actions", "rewards", "dones", "obs"} <= set(demo)
            assert np.array_equal(demo["obs/object"], episode.environment)
            assert np.array_equal(
                demo["actions"][:-1], np.hstack([demo[f"obs/robot{k}_eef_pos"][1:] for k in (0, 1)])
            )
            assert json.loads(demo.attrs["comove"])["scene_sha256"] == episode.run.scene_sha256


def test_npz_reads_back(done):
    for episode in done[1]:
        with np.load(done[0] / f"npz/episode_{episode.run.number:06d}.npz") as archive:
            assert np.array_equal(archive["position"], episode.position)
            assert json.loads(str(archive["about"]))["seed"] == episode.run.seed


def test_a_dataset_is_complete_or_not_there(done, tmp_path, monkeypatch):
    """A failure at the second episode leaves nothing; what is there already stays."""
    folder, _ = done
    with pytest.raises(ResultError, match="it is there already"):
        export_episodes(folder, folder.parent, FORMATS["npz"], RATE)
    copy = tmp_path / "out"
    copy.mkdir()
    shutil.copy(folder / RUNS, copy)
    store = StudyStore.open(copy / RUNS)
    with store.connected() as connection:
        connection.execute(
            "UPDATE motions SET curve = x'00' WHERE key IN (SELECT key FROM runs WHERE number = 1)"
        )
    for format in FORMATS.values():
        with pytest.raises(ResultError, match="cannot be rebuilt"):
            export_episodes(copy, folder.parent, format, RATE)
        assert {path.name for path in copy.iterdir()} <= {RUNS, f"{RUNS}-wal", f"{RUNS}-shm"}


def test_a_motion_that_was_edited_is_not_exported(done, tmp_path):
    """Weights of another episode: the curve hits what its own scene holds, or misses its ends."""
    copy = tmp_path / "out"
    copy.mkdir()
    shutil.copy(done[0] / RUNS, copy)
    with StudyStore.open(copy / RUNS).connected() as connection:
        (curve,) = connection.execute(
            "SELECT curve FROM motions JOIN runs USING (key) WHERE number = 0"
        ).fetchone()
        connection.execute("UPDATE motions SET curve = ?", (curve,))
    with pytest.raises(ResultError, match=r"does not stand the check any more|cannot be rebuilt"):
        export_episodes(copy, done[0].parent, FORMATS["npz"], RATE)


def test_episodes_of_different_kinds_do_not_fit_into_one_table(tmp_path):
    draws = [
        {"key": "obstacles", "choice": [[], [{"shape": "circle", "center": [0.7, 0.5], "radius": 0.05}]]}
    ]
    study = generate(tmp_path, draws=draws, episodes=5)
    with pytest.raises(
        ResultError, match="let all episodes have the same robot, hands and obstacles, or export as npz"
    ):
        export_episodes(tmp_path / "out", study.folder, FORMATS["lerobot"], RATE)
    assert export_episodes(tmp_path / "out", study.folder, FORMATS["npz"], RATE)[1] == 5


@pytest.mark.parametrize("rate", [0, 100_000])
def test_bad_rates(done, rate):
    with pytest.raises(OptionError, match="--rate"):
        next(episodes_of(done[0], done[0].parent, rate))


def test_lerobot_itself_reads_it(done):
    """Where the package is installed, its loader gives the same numbers, and finds single episodes."""
    package = pytest.importorskip("lerobot.datasets.lerobot_dataset")
    folder, episodes = done
    dataset = package.LeRobotDataset("comove/posts", root=folder / "lerobot")
    assert (dataset.num_episodes, dataset.num_frames) == (3, sum(len(e.time) for e in episodes))
    alone = package.LeRobotDataset("comove/posts", root=folder / "lerobot", episodes=[1])
    found = np.array([alone[i][STATE].numpy() for i in range(alone.num_frames)])
    assert np.array_equal(found, episodes[1].position.reshape(len(found), -1).astype(np.float32))
