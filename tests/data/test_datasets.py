"""Datasets hold the verified episodes, sample by sample, under the names of their ecosystems, or are not there."""

import json
import shutil
import sys
import zlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import comove
from comove.data import Study, StudyStore, on_processes, run_study
from comove.data.datasets import FORMATS, export_episodes
from comove.data.datasets.lerobot import ENVIRONMENT, STATE, Statistics
from comove.data.datasets.mcap import movements_of
from comove.data.datasets.samples import EpisodeSamples, episodes_of
from comove.data.episode import sample_times
from comove.data.runs import RUNS
from comove.dmp import motion_basis
from comove.errors import OptionError, ResultError
from comove.model import CoordinatedMotion, Scene, load_coordinates
from comove.model.coordinates import poses_at
from comove.model.files.keys import canonical
from tests.commands import invoke

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
        pytest.importorskip(format.library)
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


def test_what_is_drawn_is_in_the_environment(tmp_path):
    scene = yaml.safe_load((EXAMPLES / "posts.yaml").read_text())
    scene["obstacles"][0] = {"name": "wall", "shape": "box", "center": [0.5, 0.05], "size": [0.1, 0.1]}
    (tmp_path / "named.yaml").write_text(yaml.safe_dump(scene))
    draws = [
        {"key": "load.length", "uniform": [0.1, 0.2]},
        {"key": "duration", "choice": [8, 10]},
        {"key": "obstacles.0.size", "uniform": [[0.05, 0.05], [0.1, 0.15]]},
        {"key": "obstacles.0.rotation_deg", "uniform": [-30, 30]},
    ]
    study = generate(tmp_path, draws=draws, scene="named.yaml", episodes=3)
    pytest.importorskip("pyarrow")
    export_episodes(tmp_path / "out", study.folder, FORMATS["lerobot"], RATE)
    features = json.loads((tmp_path / "out/lerobot/meta/info.json").read_text())["features"][ENVIRONMENT]
    seen = set()
    for episode in episodes_of(tmp_path / "out", study.folder, RATE):
        file = episode.scene.file
        wall = file.obstacles[0]
        names = features["names"]["axes"] if isinstance(features["names"], dict) else features["names"]
        said = dict(zip(names, episode.environment[-1].tolist(), strict=True))
        assert len(names) == len(set(names)) == features["shape"][0]
        assert [said["wall_size_x"], said["wall_size_y"]] == list(wall.size)
        assert [said["wall_x"], said["wall_y"]] == list(wall.center)
        assert said["wall_angle"] == pytest.approx(np.deg2rad(wall.rotation_deg))
        assert said["payload_size_x"] == pytest.approx(file.load.length + 2 * file.load.radius)
        assert said["duration"] == file.duration
        seen.add((said["wall_size_x"], said["payload_size_x"]))
    assert len(seen) == 3


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
    states = np.array(rows.column(STATE).to_pylist())
    stats = json.loads((folder / "lerobot/meta/stats.json").read_text())
    assert np.allclose(stats[STATE]["std"], states.std(axis=0), rtol=1e-9)
    assert stats["index"]["max"] == [rows.num_rows - 1]


def test_mcap_reads_back(done):
    """Hands, load and obstacles are found again bit by bit, and the load's frame carries the hands."""
    folder, episodes = done
    for episode in episodes:
        file = folder / f"mcap/episode_{episode.run.number:06d}.mcap"
        scene = episode.scene
        for hand, name in enumerate(scene.manipulators):
            found = comove.Demonstration.load(file, topic=f"/{name}/point")
            assert np.array_equal(found.position[:, :2], episode.position[:, hand])
            assert not found.position[:, 2].any() and np.allclose(found.time, episode.time, atol=1e-9)
        load = comove.Demonstration.load(file, topic="/load/pose")
        turn = 2 * np.arctan2(load.orientation[:, 3], load.orientation[:, 0])
        for hand, grasp in enumerate(scene.groups[0].grasps):
            away = np.stack([np.cos(turn) * grasp[0], np.sin(turn) * grasp[0]], axis=1)
            assert np.allclose(load.position[:, :2] + away, episode.position[:, hand], atol=1e-9)
        post = comove.Demonstration.load(file, topic="/obstacle1/point")
        assert np.array_equal(post.position[0, :2], scene.file.obstacles[1].center)


ROLLED = {
    "version": 2,
    "name": "rolled",
    "duration": 4.0,
    "workspace": {"lower": [0, 0, 0], "upper": [1, 1, 1]},
    "payload": {
        "shape": "box",
        "size": [0.3, 0.1, 0.05],
        "start": {"position": [0.3, 0.4, 0.5], "rpy_deg": [10, 20, 40]},
        "goal": {"position": [0.6, 0.5, 0.5], "rpy_deg": [80, 20, 40]},
    },
    "grasps": {
        name: {"position": [x, 0, 0], "approach": [0, 0, -1], "closing": [0, 1, 0]}
        for name, x in (("left", 0.15), ("right", -0.15))
    },
}


@pytest.mark.parametrize("constraints", [[], [{"type": "axis", "axis": [1, 0, 0], "frame": "payload"}]])
@pytest.mark.parametrize("on_robot", [False, True])
def test_the_roll_of_a_payload_is_not_guessed_from_two_hands(constraints, on_robot):
    """It is that of the motion, or of the hands' orientations where joints place them."""
    scene = Scene.from_dict(ROLLED | {"constraints": constraints})
    coordinates, basis = load_coordinates(scene), motion_basis(12, "jerk")
    weights = 0.03 * np.random.default_rng(0).normal(size=(coordinates.n_columns, 12))
    motion = CoordinatedMotion(scene, coordinates, basis, coordinates.boundary(), weights)
    time = sample_times(scene, RATE)
    q, hands, _ = motion.at(time / scene.duration)[0], *motion.hands(time / scene.duration)[:2]
    frames = scene.grasp.hand_rotations(coordinates.nodes(np.ascontiguousarray(q.T[None]))[0])
    orientation = Rotation.from_matrix(frames.reshape(-1, 3, 3)).as_quat(scalar_first=True)
    joints = SimpleNamespace(hands=hands, orientation=orientation.reshape(*frames.shape[:2], 4))
    episode = EpisodeSamples(None, SimpleNamespace(motion=motion), RATE, joints if on_robot else None)
    (load,) = (own for name, own in movements_of(episode) if name == "load")
    right = poses_at(coordinates, q)
    off = Rotation.from_quat(load.orientation, scalar_first=True)
    off *= Rotation.from_quat(right.quaternion[:, 0], scalar_first=True).inv()
    assert off.magnitude().max() < 1e-7
    np.testing.assert_allclose(load.position, right.center[:, 0], atol=1e-9)
    start = Rotation.from_euler("xyz", [10, 20, 40], degrees=True)
    assert (start.inv() * Rotation.from_quat(load.orientation[0], scalar_first=True)).magnitude() < 1e-7


def test_topics_of_obstacles_are_their_names_where_ros_allows_them(done):
    episode = done[1][0]
    contents = episode.scene.file.model_dump(mode="json", exclude_none=True)
    for obstacle, name in zip(contents["obstacles"], ("shelf", "left", "two-words"), strict=True):
        obstacle["name"] = name
    named = SimpleNamespace(
        scene=Scene.from_dict(contents),
        time=episode.time,
        position=episode.position,
        group_poses=episode.group_poses,
        run=episode.run,
    )
    assert [name for name, _ in movements_of(named)][-3:] == ["shelf", "obstacle1", "obstacle2"]


def test_mcap_tells_about_the_episode_to_other_readers(done):
    """The package of the format itself finds every topic, and scene, seed and certificate as JSON."""
    reader = pytest.importorskip("mcap.reader")
    folder, episodes = done
    with open(folder / "mcap/episode_000000.mcap", "rb") as file:
        messages = list(reader.make_reader(file).iter_messages())
    topics = {channel.topic for _, channel, _ in messages}
    assert topics == {"/comove/about", "/left/point", "/right/point", "/load/pose"} | {
        f"/obstacle{i}/point" for i in range(3)
    }
    (text,) = [message.data for _, channel, message in messages if channel.topic == "/comove/about"]
    about = json.loads(text[8:].rstrip(b"\0"))  # a string in CDR: four bytes of header, its length, a zero
    assert about["seed"] == episodes[0].run.seed
    assert about["clearance_min"] == pytest.approx(episodes[0].motion.clearance_min, abs=1e-12)


@pytest.mark.parametrize("name", ["load", "obstacle0", "left-arm"])
@pytest.mark.few(1)
def test_a_hand_that_cannot_be_a_topic_is_refused(name, tmp_path):
    pytest.importorskip("rosbags")
    scene = yaml.safe_load((EXAMPLES / "posts.yaml").read_text())
    scene["manipulators"][0]["name"] = name
    study = generate(tmp_path, scene=scene, draws=[], episodes=1)
    with pytest.raises(ResultError, match=rf"the hand '{name}' cannot be a topic.*give it another name"):
        export_episodes(tmp_path / "out", study.folder, FORMATS["mcap"], RATE)
    assert not (tmp_path / "out/mcap").exists()


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
    both = Statistics(first).with_more(Statistics(second)).plain()
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


@pytest.mark.parametrize("name", ["lerobot", "mcap", "robomimic"])
def test_a_missing_library_is_told_before_anything_is_run(name, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, FORMATS[name].library, None)
    out = tmp_path / "out"
    done = invoke("generate", EXAMPLES / "planar.yaml", "--out", out, "--format", name)
    wanted = f"{out / FORMATS[name].target}: its kind needs {FORMATS[name].library}, which is not installed"
    assert done.exit_code == 2 and wanted in done.stderr and not out.exists()


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


def copied(folder, to):
    """A copy of a study's store, which may be edited."""
    to.mkdir()
    shutil.copy(folder / RUNS, to)
    return StudyStore.open(to / RUNS)


def test_figures_are_those_of_the_motion_whatever_its_row_says(done, tmp_path):
    store = copied(done[0], tmp_path / "out")
    with store.connected() as connection:
        connection.execute(
            "UPDATE runs SET clearance_min = 0.5, end_error = 0, duration = 1, passing = 'far'"
        )
    found = list(episodes_of(tmp_path / "out", done[0].parent, RATE))
    for episode, right in zip(found, done[1], strict=True):
        assert episode.about == right.about
        assert episode.about["clearance_min"] == episode.motion.report.clearance_min < 0.5


def test_a_motion_or_scene_that_is_not_that_of_its_row_is_not_exported(done, tmp_path):
    """An easier scene under the same motion is verified, but it is another one."""
    kept = list(StudyStore.open(done[0] / RUNS).motions())
    contents = json.loads(zlib.decompress(kept[0][1].scene))
    contents["obstacles"] = contents["obstacles"][:1]
    easier = Scene.from_dict(contents, folder=done[0].parent)
    store = copied(done[0], tmp_path / "out")
    packed = zlib.compress(canonical(easier.file))
    with store.connected() as connection:
        connection.execute("UPDATE motions SET scene = ? WHERE key = ?", (packed, kept[0][0].key))
    with pytest.raises(ResultError, match="the scene of episode 0 is not that of its row"):
        list(episodes_of(tmp_path / "out", done[0].parent, RATE))
    with store.connected() as connection:  # with its checksum, only who has the study can know
        changed = (easier.sha256, kept[0][0].key)
        connection.execute("UPDATE runs SET scene_sha256 = ? WHERE key = ?", changed)
    study = Study.load(done[0].parent / "study.yaml")
    with pytest.raises(ResultError, match="the scene of episode 0 is not the one that the study draws"):
        list(episodes_of(tmp_path / "out", done[0].parent, RATE, study))
    assert len(list(episodes_of(done[0], done[0].parent, RATE, study))) == 3
    with store.connected() as connection:
        connection.execute("UPDATE runs SET motion_sha256 = 'f' WHERE number = 0")
    with pytest.raises(ResultError, match="the motion of episode 0 is not that of its row"):
        list(episodes_of(tmp_path / "out", done[0].parent, RATE))


@pytest.mark.slow
def test_episodes_of_different_kinds_do_not_fit_into_one_table(tmp_path):
    draws = [
        {"key": "obstacles", "choice": [[], [{"shape": "circle", "center": [0.7, 0.5], "radius": 0.05}]]}
    ]
    study = generate(tmp_path, draws=draws, episodes=5)
    with pytest.raises(
        ResultError,
        match="let all episodes have the same robot, hands and obstacles, or export as npz or mcap",
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
    folder, episodes = done[0] / "lerobot", done[1]
    dataset = package.LeRobotDataset("comove/posts", root=folder)
    assert (dataset.num_episodes, dataset.num_frames) == (3, sum(len(e.time) for e in episodes))
    alone = package.LeRobotDataset("comove/posts", root=folder, episodes=[1])
    found = np.array([alone[i][STATE].numpy() for i in range(alone.num_frames)])
    assert np.array_equal(found, episodes[1].position.reshape(len(found), -1).astype(np.float32))
