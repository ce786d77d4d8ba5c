"""Online runs in MuJoCo, and the judge of their records."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from comove.errors import OptionError
from comove.io.folders import whole_folder
from comove.model import Scene
from comove.results import RESULT
from comove.robots.online.executor import JointExecutor, OnlineSettings
from comove.sim.building import build_world
from comove.sim.engine import NO_PICTURES, drawing_backend, engine
from comove.sim.execution import Contact
from comove.sim.live import run_live
from comove.sim.live_record import judge_run
from comove.sim.pictures import FilmedRun, draw_film, draw_sheet, place
from comove.sim.robot_runs import ROBOT_RUN, write_robot_run
from comove.sim.world import moving_body
from tests.robots.known_carry import TABLE, posts, scene_data
from tests.robots.small_robots import EXAMPLES, robot

pytestmark = pytest.mark.slow
BALL = {
    "shape": "sphere",
    "center": [0.88, 0.9, 0.1],
    "radius": 0.08,
    "motion": {"waypoints": [[0.88, 0.9, 0.1], [0.88, -0.9, 0.1]], "times": [0.5, 5.0]},
}


@pytest.fixture(scope="module")
def executed():
    """A run in which a ball flies over the load, and its executor."""
    scene = Scene.from_dict(scene_data(obstacles=(TABLE, *posts(0.30), BALL)))
    executor = JointExecutor(scene, robot("baxter"), seed=2)
    return executor, run_live(executor, 40.0)


def test_the_load_arrives_and_the_hands_hold_it(executed):
    executor, record = executed
    report = judge_run(record)
    assert report.reasons == ()
    assert record.arrived
    assert report.hold_error_max < 1e-6
    assert report.distance_error_max < 1e-3
    assert min(report.clearance_scene, report.clearance_carried) > 0.0
    assert report.duration_s == pytest.approx(executor.time)
    assert len(executor.log.control) == executor.n_steps == len(record.time)


def test_clearances_are_those_of_the_true_obstacles(executed):
    _, record = executed
    stride = 50
    report = judge_run(record, stride=stride)
    least = np.inf
    for nodes, centers in zip(record.nodes[::stride], record.obstacles[::stride], strict=True):
        share = np.linspace(-0.05, 1.05, 300)[:, None]  # the bar reaches 3 cm beyond the hands
        bar = nodes[0] + share * (nodes[1] - nodes[0])
        least = min(least, np.linalg.norm(bar - centers[3], axis=1).min() - 0.08 - 0.012)
    assert report.clearance_carried <= least + 1e-3
    moved = replace(record, obstacles=[centers - [0.1, 0.0, 0.0] for centers in record.obstacles])
    assert judge_run(moved, stride=stride).clearance_carried < report.clearance_carried


def test_what_is_wrong_with_a_run_is_said(executed):
    _, record = executed
    off = [q.copy() for q in record.commanded]
    off[10][3] += 1e-3
    said = judge_run(replace(record, commanded=off), stride=200).reasons
    assert any("off the load" in reason for reason in said)
    touched = replace(record, contacts=(Contact(("a", "b"), 1.0, 0.01),), arrived=False)
    said = judge_run(touched, stride=200).reasons
    assert any("a and b touch at 1.00 s" in reason for reason in said)
    assert any("has not arrived" in reason for reason in said)
    within = [centers.copy() for centers in record.obstacles]
    for centers, nodes in zip(within, record.nodes, strict=True):
        centers[3] = nodes[:2].mean(axis=0)
    said = judge_run(replace(record, obstacles=within), stride=200).reasons
    assert any("the load and an obstacle meet" in reason for reason in said), said


def test_a_ball_through_a_shoulder_drives_the_robot_off_and_it_goes_on():
    path = EXAMPLES / "robots" / "two_xarm7.yaml"
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    begin, velocity = np.array([-0.4466, -0.6988, 0.2749]), np.array([0.2738, 0.2009, 0.0])  # m, m/s
    track = {"waypoints": [begin.tolist(), (begin + 40 * velocity).tolist()], "times": [0.0, 40.0]}
    data["obstacles"].append(
        {"shape": "sphere", "center": track["waypoints"][0], "radius": 0.08, "motion": track}
    )
    scene = Scene.from_dict({**data, "demonstration": None})
    executor = JointExecutor(scene, robot("two_xarm7"), seed=9124)
    record = run_live(executor, 40.0)
    report = judge_run(record, stride=100)
    assert record.arrived and not record.given_up
    assert any(record.driven_off) and not record.driven_off[-1]
    assert any("link1" in contact.between[0] for contact in record.contacts)
    assert report.hold_error_max < 1e-6
    assert report.velocity_ratio_max <= 1.0 + 1e-6
    assert report.end_error < 5e-3


def test_files_are_sealed_and_read_back(executed, tmp_path):
    executor, record = executed
    summary = write_robot_run(
        tmp_path, record, judge_run(record, stride=200), executor.log, seed=2, wall_time_s=1.0
    )
    assert summary["as_it_should_be"]
    read, arrays = ROBOT_RUN.read(tmp_path)
    assert read["scene_sha256"] == record.scene.sha256
    np.testing.assert_array_equal(arrays["commanded"], np.array(record.commanded))


def test_a_run_is_drawn_with_obstacles_and_joints_where_they_were(executed):
    _, record = executed
    filmed = FilmedRun.of(record)
    world = build_world(filmed.robot, filmed.scene, filmed.load, filmed.conditions.grasp)
    data = engine().MjData(world.model)
    for step in (0, len(record.time) // 2, len(record.time) - 1):
        place(filmed, world, data, step)
        assert np.allclose(data.body(moving_body(3)).xpos, record.obstacles[step][3])
        assert np.array_equal(data.qpos[world.qpos], record.measured[step])
        assert np.allclose(world.load_pose(data), record.load[step], atol=1e-9)


@pytest.mark.skipif(drawing_backend() == NO_PICTURES, reason="neither EGL nor OSMesa")
def test_a_run_has_pictures_and_a_film_of_its_length(executed, tmp_path):
    filmed = FilmedRun.of(executed[1])
    draw_sheet(filmed, tmp_path / "robot_run.png", count=2, columns=2, width=80)
    film = draw_film(filmed, tmp_path / "robot_run.mp4", rate=2.0, width=80)
    assert (tmp_path / "robot_run.png").read_bytes().startswith(b"\x89PNG") and film.stat().st_size > 0


def test_a_stored_run_is_played_and_judged_anew(executed, tmp_path):
    pytest.importorskip("viser")
    from comove.view.workbench.playback import playback_of

    executor, record = executed
    report = judge_run(record)
    write_robot_run(tmp_path / "", record, report, executor.log, seed=2, wall_time_s=1.0)
    played = playback_of(tmp_path)
    assert played.holds and played.robot is not None and played.recording.links.shape[1] > 0
    assert played.recording.time[-1] == pytest.approx(record.time[-1])
    summary, arrays = ROBOT_RUN.read(tmp_path)
    ROBOT_RUN.write(tmp_path, summary, dict(arrays) | {"measured": arrays["measured"] + 0.01})
    assert not playback_of(tmp_path).holds


def test_a_run_takes_the_place_of_an_earlier_one(executed, tmp_path):
    executor, record = executed
    report = judge_run(record, stride=200)
    for seed in (1, 2):
        with whole_folder(tmp_path / "run", RESULT) as draft:
            write_robot_run(draft, record, report, executor.log, seed=seed, wall_time_s=1.0)
    assert ROBOT_RUN.read(tmp_path / "run")[0]["seed"] == 2


def test_periods_that_the_simulator_cannot_keep_are_refused():
    scene = Scene.from_dict(scene_data(obstacles=(TABLE,)))
    executor = JointExecutor(scene, robot("baxter"), settings=OnlineSettings(period=0.005))
    with pytest.raises(OptionError, match="multiple of"):
        run_live(executor, 1.0)
