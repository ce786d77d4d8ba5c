"""A stored execution is verified from its poses and the scene; whatever else it says may not help it."""

import json
import shutil

import numpy as np
import pytest

from comove.control import Executor, Functions, Pace, write_run
from comove.io.folders import whole_folder
from comove.model import Scene
from comove.results import RESULT
from comove.results.runs import RUN, read_run, verify_run
from comove.results.sealed import finite
from comove.verification.record import verify_execution
from comove.view.workbench.playback import playback_of
from tests.commands import invoke

SCENE = {
    "name": "standing",
    "duration": 4.0,
    "workspace": {"lower": [0, 0], "upper": [1, 1]},
    "obstacles": [
        {"shape": "box", "center": [0.5, 0.15], "size": [0.1, 0.3], "name": "post"},
        {"shape": "circle", "center": [0.5, 0.95], "radius": 0.03, "motion": {"velocity": [0.02, 0.0]}},
    ],
    "load": {"shape": "bar", "length": 0.2},
    "manipulators": [
        {"name": "left", "start": [0.15, 0.4], "goal": [0.85, 0.4]},
        {"name": "right", "start": [0.15, 0.6], "goal": [0.85, 0.6]},
    ],
    "limits": {"speed": 0.5, "acceleration": 2.0, "clearance": 0.01},
}


def written(folder, executor):
    record = executor.run(12.0)
    with whole_folder(folder, RESULT) as draft:
        report = verify_execution(record)
        write_run(draft, record, report, executor.log, seed=0, interrupted=False, wall_time_s=1.0)
    return folder


@pytest.fixture(scope="module")
def honest(tmp_path_factory):
    scene = Scene.from_dict(SCENE)
    return written(tmp_path_factory.mktemp("run") / "run", Executor(scene, seed=0, pace=Pace(period=0.02)))


@pytest.fixture
def folder(honest, tmp_path):
    return shutil.copytree(honest, tmp_path / "run")


def verified(folder):
    return verify_run(read_run(folder, Scene.from_dict(SCENE)))


def forge(folder, **changes):
    """Change arrays, and bring along all measures and checksums, by comove's own functions."""
    summary, arrays = RUN.read(folder)
    stored = read_run(folder, Scene.from_dict(SCENE))
    stored.arrays.update(arrays | changes)
    report = verify_execution(stored.record)
    said = {name: finite(value) for name, value in report.asdict().items() if name != "reasons"}
    said |= {"verified": True, "reasons": [], "duration_s": float(stored.arrays["time"][-1])}
    RUN.write(folder, summary | said, stored.arrays)
    return report


def test_an_honest_run_is_verified_by_its_poses_alone(folder):
    assert verified(folder).reasons == ()
    assert verified(folder).clearance_min == pytest.approx(RUN.read(folder)[0]["clearance_min"], rel=1e-9)


def test_runs_tell_how_obstacles_are_turned(tmp_path):
    """A run among a beam that turns, one that says that it turned otherwise, and one that does not say."""
    turn = {"rate_deg_per_s": 30, "hinge": [0.02, 0.0]}
    beam = {
        "shape": "box",
        "center": [0.5, 0.9],
        "size": [0.1, 0.02],
        "rotation_deg": 20,
        "motion": {"turn": turn},
    }
    scene = Scene.from_dict(SCENE | {"obstacles": [beam]})
    folder = written(tmp_path / "run", Executor(scene, seed=0, pace=Pace(period=0.02)))
    summary, arrays = RUN.read(folder)
    angle = 2 * np.arctan2(*arrays["obstacle_quaternion"][:, 0, [3, 0]].T)
    np.testing.assert_allclose(np.rad2deg(angle), 20 + 30 * arrays["time"], atol=1e-9)
    assert verify_run(read_run(folder)).reasons == ()
    assert len(repr(read_run(folder))) < 500
    RUN.write(folder, summary, {key: arrays[key] for key in arrays if key != "obstacle_quaternion"})
    assert verify_run(read_run(folder)).reasons == ()
    RUN.write(
        folder, summary, arrays | {"obstacle_quaternion": np.roll(arrays["obstacle_quaternion"], 1, axis=0)}
    )
    (reason,) = verify_run(read_run(folder)).reasons
    assert "obstacles[0] (box) was, by the run's own record alone, turned otherwise" in reason


def test_a_run_through_a_standing_box_is_not_saved_by_obstacles_of_its_own(folder):
    """The straight way through the post, the post and the disc moved away, and all checksums right."""
    arrays = RUN.read(folder)[1]
    shift = np.array([0.0, -0.35])  # the bar of 0.2 m then passes through the post
    away = np.sin(np.linspace(0.0, np.pi, len(arrays["time"])))[:, None] * shift
    center = arrays["center"].copy()
    center[:, 0, :2] += away
    position = arrays["position"] + away[:, None]
    obstacles = arrays["obstacle_center"] + np.array([30.0, 0.0])
    claimed = forge(folder, center=center, position=position, obstacle_center=obstacles)
    assert not [reason for reason in claimed.reasons if "post" in reason], "by its own record it is clear"
    reasons = verified(folder).reasons
    assert any("reaches" in reason and "post" in reason for reason in reasons)
    assert any("by the run's own record alone" in reason for reason in reasons)
    playback = playback_of(folder)
    assert not playback.holds and playback.verdict == "not verified"


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        (lambda a: {"obstacle_center": a["obstacle_center"] + 1e-3}, "by the run's own record alone"),
        (lambda a: {"time": a["time"] ** 1.1}, "not evenly spaced"),
        (lambda a: {"time": a["time"] + 1.0}, "not evenly spaced"),
        (lambda a: {"position": a["position"] + 1e-4}, "'position' in run.npz was edited"),
        (lambda a: {"quaternion": 0.5 * a["quaternion"]}, "not of unit length"),
        (lambda a: {"center": a["center"] + np.array([0.0, 0.0, 0.2])}, "leaves the plane"),
    ],
    ids=["obstacles", "times", "later", "positions", "quaternions", "height"],
)
def test_what_no_execution_can_have_recorded_is_told(changed, why, folder):
    forge(folder, **changed(RUN.read(folder)[1]))
    assert any(why in reason for reason in verified(folder).reasons)


def test_measures_of_another_run_are_told(folder):
    summary, arrays = RUN.read(folder)
    for name, value in (("clearance_min", 0.5), ("duration_s", 1.0), ("scene", "other"), ("cost", 0.0)):
        RUN.write(folder, summary | {name: value}, arrays)
        assert any(name in reason or "names another" in reason for reason in verified(folder).reasons)


def test_obstacles_that_were_only_observed_are_not_trusted_and_said_to_be_so(tmp_path):
    scene = Scene.from_dict(SCENE)
    places = [lambda t: [0.5, 0.15], lambda t: [0.5 + 0.05 * t, 0.95]]
    observer = Functions(scene, places)
    folder = written(tmp_path / "run", Executor(scene, seed=0, pace=Pace(period=0.02), observer=observer))
    (reason,) = verified(folder).reasons
    assert "obstacles[1]" in reason and "by the run's own record alone" in reason


def test_the_command_verifies_runs_and_says_against_what(folder):
    done = invoke("verify", folder)
    assert done.exit_code == 0, done.stderr
    assert "against the folder's own scene" in done.stdout
    scene = folder.parent / "standing.yaml"
    scene.write_text(json.dumps(SCENE))
    done = invoke("verify", scene, folder)
    assert done.exit_code == 0 and f"against {scene}" in done.stdout
    moved = json.loads(json.dumps(SCENE))
    moved["obstacles"][0]["center"] = [0.5, 0.5]
    scene.write_text(json.dumps(moved))
    done = invoke("verify", scene, folder)
    assert done.exit_code == 1
    assert "not the one that was executed" in done.stderr and "post" in done.stderr
