"""Arms carry a payload among obstacles that move: it waits, and all of it is known in time."""

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

import comove
from comove.errors import OptionError, SceneError
from comove.model import CoordinatedMotion, Scene
from comove.model.coordinates import load_coordinates
from comove.planning.configurations import configuration_space, span
from comove.planning.spacetime import spacetime
from comove.robots import Robot, read_joints
from comove.robots.carrying import RobotCarrier
from comove.sim.dynamics import simulate
from comove.sim.playback import play
from comove.verification.verify import verify
from tests.commands import invoke
from tests.robots.known_carry import baxter, scene_data
from tests.robots.raw_links import RawLinks
from tests.robots.small_robots import gantry, gantry_scene, robot

DURATION, OPENS, OPEN = 8.0, 3.0, 5.0  # s
GATE = {
    "name": "gate",
    "shape": "box",
    "center": [0.0, 0.0, 0.2],
    "size": [0.1, 2.6, 0.5],
    "motion": {"waypoints": [[0, 0, 0.2], [0, 0, 0.2], [0, 3.0, 0.2]], "times": [0.0, OPENS, OPEN]},
}
"""A gate as wide as the way, which opens sideways: neither the payload nor the columns get past it before."""


def gated(**changes):
    """The gantry's scene with the gate, as the contents of a file."""
    return json.loads(
        gantry_scene((GATE,), duration=DURATION, **changes).file.model_dump_json(exclude_none=True)
    )


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    """Folders of the gantry, and of the scene solved by it on the command line."""
    folder = tmp_path_factory.mktemp("gate")
    gantry(folder)
    (folder / "gate.yaml").write_text(yaml.safe_dump(gated(robot="robot.yaml")), encoding="utf-8")
    result = invoke("solve", folder / "gate.yaml", "--out", folder / "result", "--budget", "60")
    assert result.exit_code == 0, result.output
    return folder, folder / "result"


def test_the_payload_waits_until_the_gate_is_open(solved):
    folder, out = solved
    with np.load(out / "joints.npz") as stored:
        time, position, names = stored["time"], stored["position"], stored["joint_names"].tolist()
    machine, gate = Robot.load(folder / "robot.yaml"), Scene.from_dict(gated()).file.obstacles
    assert names == list(machine.joint_names)
    apart = RawLinks(machine).distances(gate, time, position)
    told = json.loads((out / "robot.json").read_text())["clearance_scene"]
    assert apart.min() > 0.005, time[apart.min(axis=(1, 2)).argmin()]
    assert told <= apart.min() + 2e-4
    with np.load(out / "solution.npz") as stored:
        middle = stored["position"][:, :, 0].mean(axis=1)
        assert middle[stored["time"] < OPENS].max() < -0.05, "nothing passes it before"
    assert time[-1] == DURATION, "nor is the motion stretched"


def test_what_is_stored_is_verified_played_and_exported_in_time(solved):
    _, out = solved
    assert invoke("verify", out).exit_code == 0
    played = invoke("simulate", out, "--no-pictures")
    assert played.exit_code == 0, played.output
    refused = invoke("export", out, "--approach")
    assert refused.exit_code == 2
    assert "leave out approach" in refused.output + refused.stderr
    exported = invoke("export", out)
    assert exported.exit_code == 0
    assert "begin the motion at the instant" in exported.stderr
    assert "obstacles move" in json.loads((out / "motion.csv.json").read_text())["begin"]


def test_the_motion_holds_for_these_obstacles_in_their_own_time_only(solved):
    """It is rejected where the gate opens later, and the payload meets it when the motion is played."""
    folder, out = solved
    late = gated(robot="robot.yaml")
    late["obstacles"][0]["motion"]["times"] = [0.0, OPENS + 2.5, OPEN + 2.5]
    (folder / "late.yaml").write_text(yaml.safe_dump(late), encoding="utf-8")
    told = invoke("verify", folder / "late.yaml", out)
    assert told.exit_code == 1
    assert "gate" in told.output + told.stderr
    joints, machine = read_joints(out).joints, Robot.load(folder / "robot.yaml")
    assert play(joints, machine, read_joints(out).scene).delivered
    scene = Scene.from_dict(late, folder=folder)
    for simulated in (play(joints, machine, scene), simulate(joints, scene, machine)):
        assert any("gate" in reason for reason in simulated.reasons), simulated.simulator


def test_neither_the_straight_motion_nor_one_past_a_gate_that_stays_is_verified():
    scene = Scene.from_dict(gated())
    assert verify(CoordinatedMotion.straight(scene)).verified is None
    shut = gated()
    del shut["obstacles"][0]["motion"]
    found = comove.solve(Scene.from_dict(shut), robot=robot("gantry"), budget=5.0)
    assert not found.joints.verified


def test_plans_are_in_time():
    """Payload and columns stay on their side until the gate leaves, no faster than asked, and clear at all times."""
    scene = Scene.from_dict(gated())
    carrier, coordinates, speed = RobotCarrier(robot("gantry"), scene), load_coordinates(scene), 3.0
    space, ends = configuration_space(scene, coordinates), coordinates.boundary()
    found, rng = None, np.random.default_rng(0)
    for _ in range(20):
        found = carrier.plan_in_time(
            spacetime(scene, space),
            ends[0],
            ends[2],
            speed,
            0.01,
            rng,
            max_nodes=1000,
            before=None,
            n_shortcuts=80,
        )
        if found is not None:
            break
    assert found is not None
    path, times = found
    assert (times[0], times[-1]) == (0.0, 1.0) and (np.diff(times) > 0).all()
    for p, q, wait in zip(path[:-1], path[1:], np.diff(times), strict=True):
        assert span(space, p, q) <= speed * wait * (1 + 1e-9)
    fine = np.linspace(0.0, 1.0, 400)
    between = np.stack([np.interp(fine, times, column) for column in path.T], axis=1)
    assert between[fine * DURATION < OPENS, 0].max() < -0.05
    nodes = coordinates.nodes(np.ascontiguousarray(between.T[None]))[0]
    assert min(scene.clearance_at(x, t * DURATION)[0] for x, t in zip(nodes, fine, strict=True)) > 0.0


def test_joints_at_the_ends_are_those_among_obstacles_as_they_are_then():
    """At 0 s the gate stands in the way of the goal's side, at the end it has gone."""
    carrier = RobotCarrier(robot("gantry"), Scene.from_dict(gated()))
    first, last = (carrier.ends.at(end).arms.around.obstacles[0, 1:4] for end in ("start", "goal"))
    np.testing.assert_allclose(first, GATE["center"])
    np.testing.assert_allclose(last, [0.0, 3.0, 0.2])
    np.testing.assert_allclose(carrier.arms.around.obstacles[0, 1:4], GATE["center"])


def test_links_are_looked_at_where_obstacles_are_then():
    """A sphere crosses the left column after 6 s; arms that stand still meet it then, and at no other sample."""
    way = [[-0.3, 3.0, 0.85], [-0.3, -3.0, 0.85]]
    ball = {"shape": "sphere", "radius": 0.1, "center": way[0]}
    ball["motion"] = {"waypoints": way, "times": [5.0, 7.0]}
    carrier = RobotCarrier(robot("gantry"), gantry_scene((ball,), duration=DURATION))
    course = np.stack([np.concatenate([joints[0] for joints in carrier.starts])] * 2)
    nodes = np.repeat(carrier.scene.nodes_at("start")[None], 81, axis=0)
    assert carrier.strain(nodes[None], course).clearance[0] < 0.0
    _, spare = carrier.along(nodes).follow(nodes)
    times, y = np.linspace(0.0, DURATION, 81), [joint.max() for joint in np.abs(nodes[0, :2, 1:2])]
    meets = np.interp(times, [5.0, 7.0], [3.0, -3.0])
    near = (np.abs(meets[:, None] - [y[0], -y[1]]) < 0.1).any(axis=1)
    assert (spare[near, -2] < 0.0).all()
    assert (spare[np.abs(times - 6.0) > 1.0, -2] > 0.0).all()
    still = carrier.along(nodes)
    quiet = replace(still, arms=still.arms.among(carrier.scene.obstacles))
    assert (quiet.follow(nodes)[1][:, -2] > 0.0).all()


def test_arms_carry_past_a_door_that_revolves_in_the_way(tmp_path):
    """It turns about its middle, in the middle of the way, and never leaves it."""
    door = {"shape": "box", "center": [0.0, 0.0, 0.2], "size": [0.1, 0.4, 0.5], "name": "door"}
    door["motion"] = {"turn": {"axis": [0.0, 0.0, 1.0], "rate_deg_per_s": 20.0}}
    machine, scene = Robot.load(gantry(tmp_path)), gantry_scene((door,), duration=DURATION)
    assert verify(CoordinatedMotion.straight(scene)).verified is None
    found = comove.solve(scene, robot=machine, budget=60.0)
    assert found.joints.verified, found.reasons

    joints = found.joints.motion.joints
    apart = RawLinks(machine).distances(scene.file.obstacles, joints.time, joints.position)
    assert apart.min() > 0.005, joints.time[apart.min(axis=(1, 2)).argmin()]
    assert found.joints.report.clearance_scene <= apart.min() + 2e-4


def test_approach_and_release_are_refused_and_the_advice_works():
    scene, wanted = Scene.from_dict(gated()), {"robot": robot("gantry"), "budget": 60.0}
    with pytest.raises(OptionError, match="during the carry only") as told:
        comove.solve(scene, approach=True, **wanted)
    assert told.value.key == "approach"
    assert comove.solve(scene, **wanted).joints.verified


def test_a_duration_too_short_is_told_and_without_it_one_is_found():
    short = gated()
    short["duration"], short["limits"] = 1.0, {"speed": 0.4}
    with pytest.raises(SceneError, match="takes less than") as told:
        comove.solve(Scene.from_dict(short), robot=robot("gantry"))
    assert told.value.key == "duration" and "leave it out" in told.value.way_out
    del short["duration"]
    found = comove.solve(Scene.from_dict(short), robot=robot("gantry"), budget=60.0)
    assert found.joints.verified
    assert found.scene.duration > OPENS


def test_an_obstacle_that_drives_into_the_robots_base_is_told_with_the_time():
    way = [[-2.0, 0.0, 0.1], [0.0, 0.0, 0.1]]
    ram = {"shape": "box", "size": [0.2, 0.2, 0.05], "center": way[0], "name": "ram"}
    ram["motion"] = {"waypoints": way, "times": [0.0, 10.0]}
    space = {"lower": [-3, -3, -3], "upper": [3, 3, 3]}
    carrier = RobotCarrier(baxter(), Scene.from_dict(scene_data(obstacles=(ram,), workspace=space)))
    with pytest.raises(SceneError, match=r"torso and ram .* at \d+\.\d\d s, and no arm .* moves that link"):
        carrier.require_room_for_obstacles()


def test_an_obstacle_that_comes_to_the_goal_is_told_with_the_time():
    """It stops in the columns that hold the payload there, beside the payload itself."""
    way = [[1.5, 0.25, 0.85], [0.3, 0.25, 0.85]]
    guest = {"name": "guest", "shape": "sphere", "radius": 0.1, "center": way[0]}
    guest["motion"] = {"waypoints": way, "times": [0.0, DURATION]}
    scene = gantry_scene((guest,), duration=DURATION)
    with pytest.raises(SceneError, match=r"guest .* at the goal at 8 s, whatever joints hold"):
        comove.solve(scene, robot=robot("gantry"))
