"""Episodes of robots: joints that carry the load, verified anew, and the same rows however they are run."""

import json
import re
import shutil
from dataclasses import replace
from functools import partialmethod
from pathlib import Path

import numpy as np
import pytest
import yaml

import comove
from comove.data import Shard, Study, StudyStore, Sweep, groups_of, on_processes, report_of, run_study, study
from comove.data.datasets import FORMATS, export_episodes
from comove.data.datasets.samples import episodes_of
from comove.data.keys import change
from comove.data.on_dask import on_dask
from comove.data.runs import RUNS, UNREPEATED, merge
from comove.errors import ExtraError, InputError, OptionError, ResultError
from comove.robots import Robot
from comove.sim.engine import engine
from tests.commands import invoke
from tests.data.test_runner import rows
from tests.data.test_study import SCENE as PLANAR
from tests.robots.small_robots import gantry

EXAMPLES = Path(__file__).parents[2] / "examples" / "studies"
SCENE = {
    "name": "gantry",
    "robot": "robot.yaml",
    "duration": 6.0,
    "workspace": {"lower": [-0.5, -0.9, 0.0], "upper": [0.5, 0.9, 0.45]},
    "obstacles": [{"shape": "cylinder", "center": [0.0, 0.4, 0.2], "radius": 0.04, "height": 0.4}],
    "load": {"shape": "bar", "length": 0.5, "radius": 0.01, "mass": 1.0},
    "manipulators": [
        {"name": "left", "start": [-0.3, 0.25, 0.3], "goal": [0.3, 0.25, 0.3]},
        {"name": "right", "start": [-0.3, -0.25, 0.3], "goal": [0.3, -0.25, 0.3]},
    ],
    "grasp": {"orientation": "down", "offset_deg": -90},
}
DRAWS = [
    {"key": "scene", "uniform": [[-0.05, -0.05, 0.0], [0.05, 0.05, 0.0]]},
    {"key": "goal", "uniform": [[-0.05, -0.05, -0.05], [0.05, 0.05, 0.05]]},
    {"key": "load.mass", "uniform": [0.5, 1.5]},
]


def require_mujoco():
    """Import MuJoCo as comove does, so that it can draw, or skip a test where it is not installed."""
    try:
        engine()
    except ExtraError:
        pytest.skip("MuJoCo is not installed")


def written(folder, **changes):
    """A study of the gantry, the cheapest robot, beside its description."""
    gantry(folder)
    contents = {"name": "carried", "scene": SCENE, "draws": DRAWS, "episodes": 2, "budget": 60} | changes
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in contents.items() if value is not None}))
    return path


def stored(study, folder):
    """Run a study in this process, into a store."""
    store = StudyStore.create(folder / RUNS)
    with store.writer() as writer:
        store.describe(study.described, study.total)
        for number in range(study.total):
            writer.add(*study.run(number))
    return store


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A study of two simulated episodes, its folder, and the episodes at 25 Hz."""
    require_mujoco()
    folder = tmp_path_factory.mktemp("carried")
    study = Study.load(written(folder, simulate={"grasp": "weld"}))
    (folder / "out").mkdir()
    stored(study, folder / "out")
    return study, folder / "out", list(episodes_of(folder / "out", study.folder, 25))


@pytest.mark.slow
def test_joints_hold_the_load_where_the_scene_says(done):
    """By the robot's own kinematics, at both ends of every episode and all the way."""
    study, out, episodes = done
    robot = Robot.load(study.folder / "robot.yaml")
    assert [episode.run.status for episode in episodes] == ["verified", "verified"]
    assert len({tuple(episode.scene.goal.ravel()) for episode in episodes}) == 2
    for episode, (run, kept) in zip(episodes, StudyStore.open(out / RUNS).motions(), strict=True):
        scene, joints = episode.scene, episode.joints
        assert scene.sha256 == run.scene_sha256 == study.draw(run.number).scene.sha256
        arms = [robot.arm(name) for name in scene.manipulators]
        for q, hands in ((joints.wanted[-1], scene.goal), (joints.measured[-1], scene.goal)):
            reached = np.array([robot.tool_pose(q, arm)[:3, 3] for arm in arms])
            assert np.abs(reached - hands).max() < 0.01
        apart = np.linalg.norm(joints.hands[:, 0] - joints.hands[:, 1], axis=1)
        assert np.abs(apart - 0.5).max() < 0.002
        assert np.abs(joints.measured[1:] - joints.wanted[:-1]).max() < 0.01
        assert not np.array_equal(joints.measured[1:], joints.wanted[:-1])  # servos lag a little
        certificate, simulated = json.loads(kept.carry.certificate), json.loads(kept.carry.simulation)
        assert 0.0 < certificate["velocity_ratio_max"] <= 1.0 and certificate["clearance_scene"] >= 0.005
        assert 0.0 < simulated["end_error"] < 0.003


def test_an_episode_comes_out_the_same_again(done):
    """Also its simulation, whose perturbation hangs on the seed alone."""
    study, out, _ = done
    (_, (before, kept)) = StudyStore.open(out / RUNS).motions()
    run, motion = study.run(1)
    same = dict.fromkeys(UNREPEATED)
    assert replace(run, **same) == replace(before, **same)
    assert motion == kept


def test_datasets_hold_joints_beside_the_hands(done):
    parquet, h5py = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("h5py")
    study, out, episodes = done
    for name in ("lerobot", "robomimic", "npz"):
        export_episodes(out, study.folder, FORMATS[name], 25)
    info = json.loads((out / "lerobot/meta/info.json").read_text())
    assert info["robot_type"] == "small"
    joints = list(episodes[0].joints.names)
    assert info["features"]["observation.state"]["names"] == [f"{name}.pos" for name in joints]
    assert info["features"]["action"]["names"] == [f"{name}.pos" for name in joints]
    rows = parquet.read_table(out / "lerobot/data/chunk-000/file-000.parquet")
    first = episodes[0]
    state = np.array(rows.column("observation.state").to_pylist())[: len(first.time)]
    assert np.allclose(state, first.joints.measured, atol=1e-6)
    hands = np.array(rows.column("observation.hands").to_pylist())[: len(first.time)]
    assert np.allclose(hands[:, :3], first.joints.hands[:, 0], atol=1e-6)
    assert np.allclose(np.linalg.norm(hands[:, 3:7], axis=1), 1.0, atol=1e-6)
    with h5py.File(out / "robomimic.hdf5") as root:
        demo = root["data/demo_0"]
        both = np.hstack([demo[f"obs/robot{i}_joint_pos"] for i in (0, 1)])
        columns = np.concatenate(first.joints.columns)
        assert np.array_equal(both, first.joints.measured[:, columns])
        assert np.array_equal(demo["actions"], first.joints.wanted)
        assert np.array_equal(demo["obs/robot1_eef_pos"], first.joints.hands[:, 1])
        assert demo["obs/robot0_eef_quat"].shape == (len(first.time), 4)
        assert json.loads(demo.attrs["comove"])["joints"]["robot"] == "small"
    with np.load(out / "npz/episode_000001.npz") as archive:
        assert list(archive["joint_names"]) == joints
        assert np.array_equal(archive["joint_position"], episodes[1].joints.measured)
        assert np.array_equal(archive["joint_action"], episodes[1].joints.wanted)


def copy_of(done, folder):
    """A copy of the store of a study, to be damaged."""
    shutil.copytree(done[1], folder / "out", ignore=lambda *_: ["lerobot", "npz", "robomimic.hdf5"])
    return StudyStore.open(folder / "out" / RUNS)


def test_joints_that_were_damaged_are_not_exported(done, tmp_path):
    store = copy_of(done, tmp_path)
    with store.connected() as connection:
        connection.execute("UPDATE carries SET joints = substr(joints, 1, 500)")
    with pytest.raises(ResultError, match=r"the joints of the row .* cannot be rebuilt"):
        list(episodes_of(tmp_path / "out", done[0].folder, 25))


def test_joints_of_another_episode_do_not_stand_the_check(done, tmp_path):
    store = copy_of(done, tmp_path)
    with store.connected() as connection:
        last = connection.execute(
            "SELECT joints, certificate FROM carries JOIN runs USING (key) ORDER BY number DESC"
        ).fetchone()
        connection.execute("UPDATE carries SET joints = ?, certificate = ?", last)
    with pytest.raises(ResultError, match="do not stand the check any more"):
        list(episodes_of(tmp_path / "out", done[0].folder, 25))


def test_a_robot_that_was_edited_is_told(done, tmp_path):
    copy_of(done, tmp_path)
    for file in ("robot.yaml", "gantry.urdf"):
        shutil.copy(done[0].folder / file, tmp_path)
    urdf = tmp_path / "gantry.urdf"
    urdf.write_text(urdf.read_text().replace('velocity="1.5"', 'velocity="1.4"'))
    with pytest.raises(ResultError, match="'small' is not the one that carried"):
        list(episodes_of(tmp_path / "out", tmp_path, 25))
    edited = Study.load(written_again(tmp_path))
    with pytest.raises(ResultError, match=r"edited since: robots.robot.yaml was"):
        run_study(edited, tmp_path / "out", on_processes(1))


def written_again(folder):
    """The study of `done` beside a robot that is there already."""
    contents = {"name": "carried", "scene": SCENE, "draws": DRAWS, "episodes": 2, "budget": 60}
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(contents | {"simulate": {"grasp": "weld"}}))
    return path


def test_what_is_not_delivered_is_kept_apart_with_its_reason(tmp_path):
    """Servos as soft as rubber that err about the load: the joints are verified, and the load does not arrive."""
    require_mujoco()
    path = written(tmp_path, simulate={"grasp": "weld", "perturbed": True}, episodes=1)
    robot = tmp_path / "robot.yaml"
    soft = yaml.safe_load(robot.read_text()) | {"servo": {"stiffness": [30.0, 30.0, 30.0, 2.0]}}
    robot.write_text(yaml.safe_dump(soft))
    study, out = Study.load(path), tmp_path / "out"
    out.mkdir()
    store = stored(study, out)
    (run,) = store.runs()
    assert run.status == "not delivered" and "from its goal" in run.reason
    assert list(store.motions()) == [] and len(list(store.motions("not delivered"))) == 1
    report = report_of(out)
    assert report.statuses == {"not delivered": 1} and report.verified_share == 0.0
    assert list(report.reasons) == [run.reason]
    with pytest.raises(ResultError, match="no verified episode"):
        list(episodes_of(out, study.folder, 25))


def test_a_shift_of_the_scene_is_one_of_the_robot():
    """Hands, obstacles, their waypoints and the workspace move as one."""
    moving = {"shape": "sphere", "center": [0, 0, 1], "radius": 0.1}
    moving["motion"] = {"waypoints": [[0, 0, 1], [0, 1, 1]], "times": [0, 1]}
    data = json.loads(json.dumps(SCENE | {"obstacles": [*SCENE["obstacles"], moving]}))
    change(data, "scene", [0.1, 0.2, -0.1])
    for name in ("lower", "upper"):
        assert np.allclose(np.subtract(data["workspace"][name], SCENE["workspace"][name]), [0.1, 0.2, -0.1])
    for own, before in zip(data["manipulators"], SCENE["manipulators"], strict=True):
        for end in ("start", "goal"):
            assert np.allclose(np.subtract(own[end], before[end]), [0.1, 0.2, -0.1])
    assert np.allclose(data["obstacles"][0]["center"], [0.1, 0.6, 0.1])
    assert np.allclose(data["obstacles"][1]["center"], [0.1, 0.2, 0.9])
    assert np.allclose(data["obstacles"][1]["motion"]["waypoints"], [[0.1, 0.2, 0.9], [0.1, 1.2, 0.9]])
    assert data["load"] == SCENE["load"] and data["grasp"] == SCENE["grasp"]


NOWHERE = {"key": "scene", "uniform": [[2, 0, 0], [3, 0, 0]]}
BAD = [
    ({"scene": SCENE | {"robot": "baxtre"}}, "did you mean 'baxter'"),
    ({"scene": SCENE | {"robot": "none.yaml"}}, "there is no robot 'none.yaml'"),
    ({"scene": {k: v for k, v in SCENE.items() if k not in ("robot", "grasp")}, "simulate": {}}, "no robot"),
    ({"simulate": {"grasp": "glue"}}, r"simulate.grasp.*weld"),
    ({"simulate": {"grip": "weld"}}, "did you mean 'grasp'"),
    ({"simulate": True}, "simulate.*mapping"),
    ({"draws": [{"key": "robot", "choice": ["baxter", "two_panda"]}]}, "did you mean 'two_pandas'"),
    ({"draws": [{"key": "scene", "uniform": [0, 1]}]}, "cannot be added to"),
]


@pytest.mark.parametrize(("changes", "told"), BAD)
def test_bad_studies_of_robots_are_one_sentence(tmp_path, changes, told):
    with pytest.raises(InputError, match=told) as caught:
        Study.load(written(tmp_path, **changes))
    assert "\n" not in str(caught.value)


NEVER = [
    ({"draws": [NOWHERE]}, "cannot reach its start"),
    ({"draws": [{"key": "load.mass", "uniform": [90, 99]}]}, "cannot hold the load: .* needs up to .* N "),
    ({"scene": {k: v for k, v in SCENE.items() if k != "grasp"}}, "how to hold the load"),
    ({"scene": {k: v for k, v in SCENE.items() if k != "load"}, "draws": []}, "add a load"),
    ({"scene": SCENE | {"obstacles": 5}}, "obstacles: 5 is not a list"),
    ({"scene": PLANAR | {"robot": "baxter"}, "draws": []}, "a robot moves in space, and the scene is planar"),
]


@pytest.mark.parametrize(("changes", "told"), NEVER)
def test_what_no_arm_can_do_is_told_before_the_first_run(tmp_path, monkeypatch, changes, told):
    monkeypatch.setattr(Study, "draw", partialmethod(Study.draw, attempts=3))
    outcome = invoke("generate", written(tmp_path, **changes), "--out", tmp_path / "out")
    assert outcome.exit_code == 2 and outcome.stderr.count("\n") == 1, outcome.stderr
    assert re.search(rf"none of \d+ draws gives a valid scene, the last because: .*{told}", outcome.stderr)
    assert not (tmp_path / "out").exists()


def test_without_mujoco_the_way_out_is_told(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    engine.cache_clear()
    with pytest.raises(ExtraError, match=r"pip install 'comove\[sim\]'"):
        Study.load(written(tmp_path, simulate={}))
    engine.cache_clear()


def test_the_example_is_a_study_of_a_robot():
    study = Study.load(EXAMPLES / "baxter.yaml", episodes=3)
    assert study.on_robot and study.total == 3
    assert study.draw(0).scene is not None


def swept(folder, **changes):
    """A sweep over the scene of the gantry, beside its description."""
    gantry(folder)
    (folder / "scene.yaml").write_text(yaml.safe_dump(SCENE))
    (folder / "free.yaml").write_text(yaml.safe_dump(FREE))
    contents = {"name": "compared", "scenes": ["scene.yaml"], "budget": 60} | changes
    path = folder / "sweep.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in contents.items() if value is not None}))
    return path


FREE = {k: v for k, v in SCENE.items() if k not in ("robot", "grasp")} | {"name": "free"}


def test_a_sweep_carries_by_robots_and_moves_hands_beside_them(tmp_path):
    require_mujoco()
    options = {"scenes": ["scene.yaml", "free.yaml"], "settings": {"duration": [5.0, 7.0]}, "simulate": {}}
    sweep = Sweep.load(swept(tmp_path, **options))
    (tmp_path / "out").mkdir()
    store = stored(sweep, tmp_path / "out")
    runs = list(store.runs())
    assert [run.status for run in runs] == ["verified"] * 4
    assert [run.duration for run in runs] == [5.0, 7.0, 5.0, 7.0]
    assert all(0.0 < run.first <= run.seconds for run in runs)
    carries = [motion.carry for _, motion in store.motions()]
    assert carries[2:] == [None, None] and len({carry.joints for carry in carries[:2]}) == 2
    groups = groups_of(tmp_path / "out")
    assert [(g.runs, g.verified, g.delivered) for g in groups] == [
        (1, 1, 1),
        (1, 1, 1),
        (1, 1, None),
        (1, 1, None),
    ]
    assert [g.duration for g in groups] == [5.0, 7.0, 5.0, 7.0]


def test_runs_of_a_sweep_follow_from_the_robot_and_its_simulation(tmp_path):
    scenes = {"scenes": ["scene.yaml", "free.yaml"]}
    before = Sweep.load(swept(tmp_path, **scenes))
    simulated = Sweep.load(swept(tmp_path, **scenes, simulate={}))
    (tmp_path / "other").mkdir()
    path = swept(tmp_path / "other", **scenes)
    urdf = path.with_name("gantry.urdf")
    urdf.write_text(urdf.read_text().replace('velocity="1.5"', 'velocity="1.4"'))
    slower = Sweep.load(path)
    assert len({sweep.key(0) for sweep in (before, simulated, slower)}) == 3
    assert len({sweep.key(1) for sweep in (before, simulated, slower)}) == 1  # there hands move freely


SWEEPS = [
    (
        {"methods": ["comove", "projection"]},
        "'projection' no robot carries, as one does in the scene gantry; use",
    ),
    ({"scenes": ["free.yaml"], "simulate": {}}, "no scene names a robot that could be simulated"),
    ({"settings": {"robot": ["baxtre"]}}, "did you mean 'baxter'"),
    ({"settings": {"robot": [["baxter"]]}}, "there is no robot"),
    ({"settings": {"robot": [""]}}, "there is no robot ''"),
    ({"settings": {"robot.name": ["baxter"]}}, "has no 'name'"),
    ({"simulate": {"grasp": "glue"}}, "'glue' is not known"),
    ({"simulate": []}, "simulate"),
    ({"simulate": {}, "cameras": {}}, "unknown key 'cameras'"),
    (
        {"scenes": ["free.yaml"], "methods": ["printed"], "settings": {"robot": ["baxter"]}},
        "'printed' no robot",
    ),
]


@pytest.mark.parametrize(("changes", "told"), SWEEPS)
def test_bad_sweeps_of_robots_are_one_sentence(tmp_path, changes, told):
    with pytest.raises(InputError, match=told) as caught:
        Sweep.load(swept(tmp_path, **changes))
    assert "\n" not in str(caught.value)


def test_robots_are_no_free_hands_in_python_either():
    scene = comove.Scene.from_dict(SCENE)
    with pytest.raises(OptionError, match="by the method 'projection' no robot carries; use comove or paper"):
        study([scene], ["comove", "projection"])


def test_a_scene_that_no_robot_can_carry_is_told_with_its_reason(tmp_path):
    nothing_held = {k: v for k, v in SCENE.items() if k != "grasp"}
    path = swept(tmp_path)
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(nothing_held))
    run, motion = Sweep.load(path).run(0)
    assert run.status == "refused" and "how to hold the load" in run.reason and motion is None


@pytest.mark.slow
def test_workers_parts_and_a_second_run_give_the_same_rows(tmp_path):
    require_mujoco()
    path = written(tmp_path, simulate={"grasp": "weld"}, episodes=5)
    study = Study.load(path)
    for workers in (1, 2):
        run_study(study, tmp_path / f"{workers}", on_processes(workers))
    parts = [tmp_path / f"part-{i}" for i in (1, 2)]
    for i, part in enumerate(parts, 1):
        run_study(study, part, on_processes(1), shard=Shard(i, 2))
    merge(parts, tmp_path / "merged")
    run_study(Study.load(path, episodes=2), tmp_path / "resumed", on_processes(1))
    run_study(study, tmp_path / "resumed", on_processes(2))
    first = rows(tmp_path / "1")
    assert len(first[1]) == 5 and all(motion.carry is not None for motion in first[1])
    assert first == rows(tmp_path / "2") == rows(tmp_path / "merged") == rows(tmp_path / "resumed")


@pytest.mark.slow
def test_a_scheduler_gives_the_same_rows(tmp_path):
    pytest.importorskip("distributed")
    study = Study.load(written(tmp_path, episodes=3))
    run_study(study, tmp_path / "processes", on_processes(1))
    run_study(study, tmp_path / "dask", on_dask("local", 2))
    assert rows(tmp_path / "dask") == rows(tmp_path / "processes")


@pytest.mark.slow
def test_baxter_delivers_with_friction(tmp_path):
    """The example, from the command to the dataset."""
    require_mujoco()
    out = tmp_path / "out"
    outcome = invoke("generate", EXAMPLES / "baxter.yaml", "--episodes", 2, "--out", out)
    assert outcome.exit_code == 0, outcome.output
    assert "2 of 2 episodes: 2 verified" in outcome.stdout and "in MuJoCo" in outcome.stdout
    info = json.loads((out / "lerobot/meta/info.json").read_text())
    assert info["robot_type"] == "baxter"
    names = info["features"]["observation.state"]["names"]
    assert len(names) == 14 and names[0].endswith(".pos")
