"""What a folder holds is played as it happened, and judged anew: runs, robots, simulations."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

import comove
from comove.control import Executor, write_run
from comove.errors import OptionError, ResultError
from comove.io.folders import whole_folder
from comove.results import RESULT
from comove.results.reference import SCENE
from comove.stored import ResultPart
from comove.verification.record import verify_execution
from comove.view.workbench.playback import RecordedMotion, playback_of, playback_of_item
from comove.view.workbench.shelf import Item, shelf_of
from comove.view.workbench.words import measures_words

CROSSING = {
    "name": "crossing",
    "duration": 3.0,
    "workspace": {"lower": [0, 0], "upper": [1, 1]},
    "obstacles": [
        {"shape": "circle", "center": [0.5, 0.9], "radius": 0.06, "motion": {"velocity": [0, -0.25]}},
        {"shape": "box", "center": [0.5, 0.05], "size": [0.1, 0.1]},
    ],
    "load": {"shape": "bar", "length": 0.2},
    "manipulators": [
        {"name": "left", "start": [0.15, 0.4], "goal": [0.85, 0.4]},
        {"name": "right", "start": [0.15, 0.6], "goal": [0.85, 0.6]},
    ],
    "limits": {"speed": 0.6, "acceleration": 3.0},
}


@pytest.fixture(scope="module")
def executed():
    """A run among a disc that falls."""
    executor = Executor(comove.Scene.from_dict(CROSSING))
    return executor.run(9.0), executor


@pytest.fixture
def run_folder(executed, tmp_path):
    """Its folder."""
    record, executor = executed
    with whole_folder(tmp_path / "run", RESULT) as draft:
        report = verify_execution(record)
        write_run(draft, record, report, executor.log, seed=0, interrupted=False, wall_time_s=1.0)
    return tmp_path / "run"


def test_a_run_is_played_as_it_was_recorded(executed, run_folder):
    record, _ = executed
    shelf = shelf_of([run_folder], run_folder.parent)
    assert list(shelf.items) == ["the run"]
    playback = playback_of_item(shelf.item)
    assert playback.holds and playback.verdict == "executed, and verified at every instant"
    shown, scene = playback.recording, playback.scene
    assert scene.sha256 == record.scene.sha256
    steps = np.searchsorted(record.time, shown.time)
    np.testing.assert_array_equal(record.time[steps], shown.time)
    np.testing.assert_array_equal(record.nodes[steps], shown.nodes)
    disc = scene.centers[0] + shown.offsets[:, 0]
    np.testing.assert_allclose(disc[:, 1], 0.9 - 0.25 * shown.time, atol=1e-9)
    assert not shown.offsets[:, 1].any()
    assert len(shown.time) < 310 and shown.time[-1] == record.time[-1]


def test_speed_and_clearance_of_a_run_are_those_of_its_hands(executed):
    record, _ = executed
    shown = RecordedMotion.of_run(record)
    hands = record.position
    speed = np.linalg.norm(np.diff(hands, axis=0), axis=2) / np.diff(record.time)[:, None]
    report = verify_execution(record)
    assert shown.speed.max() <= speed.max() + 1e-12 <= report.speed_max + 2e-12
    assert shown.acceleration.max() <= report.acceleration_max + 1e-9
    assert shown.clearance.min() >= report.clearance_min - 1e-12
    disc = record.obstacles[:, 0, :2]
    bar = np.linspace(0.0, 1.0, 201)[:, None, None] * (hands[:, 1] - hands[:, 0]) + hands[:, 0]
    away = np.linalg.norm(bar - disc, axis=2).min(axis=0) - 0.06
    steps = np.searchsorted(record.time, shown.time)
    assert (shown.clearance <= away[steps] + 1e-6).all(), "nothing is nearer than the disc or the disc is"


def test_an_edited_run_or_another_scene_is_not_verified(run_folder):
    with np.load(run_folder / "run.npz") as archive:
        arrays = dict(archive)
    arrays["center"] = arrays["center"] + 1e-3
    whole = (run_folder / "run.npz").read_bytes()
    np.savez(run_folder / "run.npz", **arrays)
    edited = playback_of(run_folder)
    assert not edited.holds and any("its checksum is not" in reason for reason in edited.reasons)
    (run_folder / "run.npz").write_bytes(whole)
    text = (run_folder / SCENE).read_text(encoding="utf-8")
    (run_folder / SCENE).write_text(text.replace("0.06", "0.01"), encoding="utf-8")
    other = playback_of(run_folder)
    assert not other.holds and any("not the one that was executed" in reason for reason in other.reasons)
    (run_folder / SCENE).unlink()
    with pytest.raises(ResultError, match="does not say which scene"):
        shelf_of([run_folder], run_folder.parent)


def test_a_run_that_does_not_arrive_is_not_called_good(executed):
    record, _ = executed
    half = len(record.time) // 2
    cut = {name: getattr(record, name)[:half] for name in ("time", "center", "quaternion", "obstacles")}
    playback = playback_of(replace(record, **cut, sagitta=record.sagitta[: half - 1]))
    assert not playback.holds
    assert any("the goal is missed" in reason for reason in playback.reasons)


# --- robots ---


@pytest.fixture(scope="module")
def carried(tmp_path_factory):
    """A folder with a known motion of Baxter, and its geometric playback as a simulation."""
    pytest.importorskip("pinocchio", reason="robots are not installed: pip install 'comove[robot]'")
    from comove.sim import play, write_simulation
    from tests.robots.known_carry import baxter, known_carry
    from tests.robots.known_folder import write

    folder = write(tmp_path_factory.mktemp("carried") / "result")
    motion, joints = known_carry()
    write_simulation(play(joints, baxter(), motion.scene), folder)
    return folder


def test_a_robots_hands_are_at_the_load_in_what_is_played(carried):
    playback = playback_of_item(Item(carried / SCENE, carried, ResultPart.JOINTS))
    assert playback.holds, playback.reasons
    assert "links from obstacles" in {name for name, _, _ in playback.rows}
    robot, shown = playback.robot, playback.recording
    assert shown.links.shape == (len(shown.time), len(robot.lower), 7)
    from comove.geometry.rotations import matrices

    for hand, name in enumerate(playback.scene.manipulators):
        arm = robot.arm(name)
        last, frame = int(arm.columns[-1]), robot.model.frames[robot.model.getFrameId(arm.tip)]
        in_joint = frame.placement.homogeneous @ arm.tool
        poses = shown.links[:, last]
        grasp = np.einsum("tij,j->ti", matrices(poses[:, 3:]), in_joint[:3, 3]) + poses[:, :3]
        np.testing.assert_allclose(grasp, shown.nodes[:, hand], atol=1e-5)


def test_a_simulation_comes_first_and_is_played_with_the_load_where_it_was(carried):
    shelf = shelf_of([carried], carried.parent)
    assert list(shelf.items) == ["the simulation", "the robot", "the hands"]
    simulated = playback_of_item(shelf.item)
    planned = playback_of_item(shelf.items["the robot"])
    assert simulated.verdict == "simulated, and delivered"
    assert planned.proved and not simulated.proved
    assert "proved" not in measures_words(simulated.rows, simulated.proved)
    n = len(planned.recording.time)
    np.testing.assert_allclose(simulated.recording.nodes[:n], planned.recording.nodes, atol=2e-3)
    there, wanted = simulated.recording.links[:n].copy(), planned.recording.links
    there[..., 3:] *= np.sign(
        (there[..., 3:] * wanted[..., 3:]).sum(axis=-1, keepdims=True)
    )  # q and -q are one
    np.testing.assert_allclose(there, wanted, atol=2e-2)


def test_what_touched_in_a_simulation_is_told_with_its_time(carried, tmp_path):
    import shutil

    from comove.sim import Contact, play, write_simulation
    from tests.robots.known_carry import baxter, known_carry

    folder = shutil.copytree(carried, tmp_path / "result")
    motion, joints = known_carry()
    scene = motion.scene
    contacts = (Contact(("the load", scene.name_of(1)), 2.5, 0.002), Contact(("a", "b"), 3.0, 0.001))
    write_simulation(replace(play(joints, baxter(), scene), contacts=contacts), folder)
    playback = playback_of(folder)
    assert playback.verdict == "simulated, and not delivered"
    assert [(touch.time, touch.obstacle) for touch in playback.touches] == [(2.5, 1), (3.0, -1)]
    assert any("2.50 s" in reason for reason in playback.reasons)


def test_without_robots_a_scene_says_what_to_install(carried, monkeypatch):
    import sys

    for name in [name for name in sys.modules if name.startswith("comove.robots")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    playback = playback_of(comove.Scene.load(carried / SCENE))
    assert playback.robot is None
    assert "comove[robot]" in playback.reasons[0]


def test_several_that_are_named_are_told_apart_and_the_second_stands_beside(run_folder, tmp_path):
    other = tmp_path / "other" / "run"
    shutil.copytree(run_folder, other)
    same = shelf_of([run_folder, other], tmp_path)
    assert [item.result for item in same.items.values()] == [run_folder, other]
    assert (same.first, same.beside) == (str(run_folder), str(other))
    alone = shelf_of([run_folder], tmp_path)
    assert alone.beside is None and not alone.comparable, "there is nothing else"
    assert not shelf_of([], tmp_path).comparable, "examples are solved anew, not compared"
    scene = run_folder / SCENE
    mixed = shelf_of([run_folder, scene], tmp_path)
    assert list(mixed.comparable) == ["stored: run", "scene: scene"]
    with pytest.raises(OptionError, match="named twice"):
        shelf_of([run_folder, run_folder / ".." / "run"], tmp_path)
