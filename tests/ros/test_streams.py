"""Runs of a robot by streamed commands: here a bridge that plays them without ROS, and below the real one."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from comove import Scene, solve
from comove.control import Observed, Sensor
from comove.errors import SendError
from comove.robots import Robot
from comove.robots.description import RosNames
from comove.robots.online.executor import JointExecutor, OnlineSettings
from comove.ros import streams
from comove.ros.command_player import CommandPlayer
from comove.ros.online import await_obstacles, moving_names, run_streamed
from comove.ros.streams import CommandStream, StreamNames, StreamSettings
from comove.sim.live_record import RunTolerances, judge_run
from comove.sim.robot_runs import read_robot_run, streamed, verify_robot_run, write_robot_run
from tests.robots.small_robots import EXAMPLES

SCENE = EXAMPLES / "robots" / "two_ur10.yaml"
PERIOD = 0.01
LATE = {"a measurement is late", "the next command is late"}  # also on a machine that has other work
QUICK = StreamSettings(period=PERIOD, connect=2.0)
SETTINGS = OnlineSettings(period=PERIOD)


class PlayedHere:
    """A bridge without ROS: a robot that is where its commands say."""

    threads = ()

    def __init__(self, robot, position, obstacles=None, frame="world"):
        self.robot, self.position = robot, list(position)
        self.obstacles, self.frame = None if obstacles is None else dict(obstacles), frame
        self.silent, self.more = {}, []
        self.player, self.rows, self.number = None, [], 0
        self.over, self.lock = threading.Event(), threading.Lock()
        self.told = -1
        self.thread = threading.Thread(target=self.play, daemon=True)
        self.thread.start()

    def play(self):
        due = time.monotonic()
        while not self.over.is_set():
            due += PERIOD
            time.sleep(max(0.0, due - time.monotonic()))
            with self.lock:
                if self.player is None:
                    continue
                self.position, number = self.player.tick()
                self.rows.append((time.monotonic(), number, self.player.run, self.position, self.position))
                if self.player.has_braked and self.told != self.player.run:
                    self.told = self.player.run
                    self.more.append(
                        {
                            "event": "braked",
                            "run": self.told,
                            "why": self.player.why,
                            "position": self.position,
                        }
                    )

    def tell(self, command):
        command = dict(command)
        with self.lock:
            match command.pop("do"):
                case "begin":
                    self.player = CommandPlayer(command["position"], PERIOD, *list(command.values())[1:])
                case "follow":
                    self.player.put(*command.values())
                case "brake":
                    self.player.brake(command["why"])

    def speaks(self, what):
        return time.monotonic() > self.silent.get(what, 0.0)

    def news(self, wait):
        time.sleep(min(max(wait, 0.0), 0.002))
        now, found = time.monotonic(), []
        with self.lock:
            found, self.more = self.more, []
            if self.speaks("joints"):
                position = dict(zip(self.robot.joint_names, self.position, strict=True))
                found.append({"event": "joints", "time": now, "age": 0.0, "position": position})
            if self.obstacles is not None and self.speaks("obstacles"):
                centers = {name: center for name, center in self.obstacles.items() if self.speaks(name)}
                found.append({"event": "obstacles", "time": now, "frame": self.frame, "centers": centers})
        return found

    def end_input(self):
        while not self.player.is_resting:
            time.sleep(PERIOD)
        with self.lock:
            rows = zip(
                ("time", "number", "run", "commanded", "measured"), zip(*self.rows, strict=True), strict=True
            )
            self.more += [dict(rows, event="played"), {"event": "played_all"}]

    def last_words(self):
        return "killed"

    def close(self):
        self.over.set()


@pytest.fixture(scope="module")
def planned():
    """A scene of three seconds, and its motion."""
    scene = Scene.load(SCENE, {"duration": 3.0})
    found = solve(scene, budget=2.0)
    return scene, found.joints.motion


@pytest.fixture
def connected(planned, monkeypatch):
    """A stream to a robot without ROS, and an executor at its start."""
    _, plan = planned
    made = []

    def start(position=None, **bridge):
        at = plan.joints.position[0] if position is None else position
        made.append(PlayedHere(plan.robot, at, **bridge))
        answer = {"event": "connected", "kinds": ["std_msgs/msg/Float64MultiArray"]}
        monkeypatch.setattr(streams, "started", lambda *_: (made[-1], answer, []))
        return made[-1]

    yield start
    for bridge in made:
        bridge.close()


def run_of(planned, *, during=None, observer=None, zero=None, obstacles=None):
    scene, plan = planned
    stream = CommandStream(plan.robot, StreamNames(), QUICK, obstacles=obstacles)
    executor = JointExecutor(scene, plan.robot, observer, plan=plan, settings=SETTINGS)
    if during is not None:
        usual, steps = executor.step, iter(range(10**6))
        executor.step = lambda measured: (during(next(steps)), usual(measured))[1]
    return run_streamed(executor, stream, 12.0, zero=zero), executor


def hands_apart(run):
    robot = run.robot
    tips = np.array([[robot.tool_pose(q, arm)[:3, 3] for arm in robot.arms] for q in run.commanded])
    distance = np.linalg.norm(tips[:, 0] - tips[:, 1], axis=1)
    return np.abs(distance - distance[0]).max()


def accelerations(run):
    return np.abs(np.diff(run.commanded, n=2, axis=0)) / run.period**2 / run.robot.acceleration


def test_a_run_arrives_and_its_record_is_verified(planned, connected, tmp_path):
    connected()
    run, executor = run_of(planned)
    assert run.arrived and not run.given_up and set(run.stops) <= LATE
    assert run.stops or run.held[:-10].all()
    record = streamed(run)
    report = judge_run(record, limits=RunTolerances())
    assert report.reasons == () and report.hold_error_max < 1e-9
    more = {"obstacles": "scene", "executed": "ros2"}
    write_robot_run(tmp_path, record, report, executor.log, seed=0, wall_time_s=1.0, more=more)
    _, again = verify_robot_run(read_robot_run(tmp_path), run.scene, run.robot)
    assert again.reasons == ()


@pytest.mark.slow
def test_a_late_command_stops_the_arms_together_and_they_go_on(planned, connected):
    connected()
    run, _ = run_of(planned, during=lambda k: time.sleep(0.3) if k == 120 else None)
    assert run.arrived and len(run.stops) >= 1 and "late" in run.stops[0]
    assert not run.held.all() and hands_apart(run) < 2e-4
    assert accelerations(run).max() <= 1.05


@pytest.mark.slow
def test_arms_wait_while_the_joints_are_silent(planned, connected):
    bridge = connected()

    def during(k):
        if k == 100:
            bridge.silent["joints"] = time.monotonic() + 1.5

    begun = time.monotonic()
    run, _ = run_of(planned, during=during)
    assert run.arrived and run.stops and set(run.stops) <= LATE and hands_apart(run) < 2e-4
    still = (np.abs(np.diff(run.commanded, axis=0)).max(axis=1) == 0.0).sum() * run.period
    assert still > 0.8 and time.monotonic() - begun > 4.0


def with_obstacles(scene, centers):
    """A scene with spheres that move far away."""
    data = scene.file.model_dump(mode="json", exclude_none=True)
    added = [
        {"name": name, "shape": "sphere", "center": center, "radius": 0.1}
        | {"motion": {"waypoints": [center, [*center[:2], center[2] + 0.1]], "times": [0.0, 3.0]}}
        for name, center in centers.items()
    ]
    return Scene.from_dict({**data, "obstacles": [*data.get("obstacles", []), *added]})


@pytest.mark.slow
@pytest.mark.parametrize("lost", ["obstacles", "cart"])  # all messages, or one of the obstacles in them
def test_arms_wait_while_obstacles_are_not_seen(planned, connected, lost):
    scene, plan = planned
    centers = {"cart": [0.7, 3.0, 0.3], "box": [0.7, 4.0, 0.3]}
    seen = with_obstacles(scene, centers)
    bridge = connected(obstacles=centers)
    names = moving_names(seen)
    assert list(names.values()) == list(centers)
    stream = CommandStream(plan.robot, StreamNames(obstacles="/seen"), QUICK, obstacles=names)
    observer = Observed(seen, Sensor(noise=0.005))
    zero = await_obstacles(stream, observer, 2.0)
    executor = JointExecutor(seen, plan.robot, observer, plan=plan, settings=SETTINGS)
    usual, steps, stopped = executor.step, iter(range(10**6)), []

    def step(measured):
        if next(steps) == 100:
            stopped.append(time.monotonic())
            bridge.silent[lost] = stopped[0] + 2.0
        return usual(measured)

    executor.step = step
    run = run_streamed(executor, stream, 20.0, zero=zero)
    assert run.arrived and run.stops and set(run.stops) <= LATE
    at, _, _, commanded, _ = (np.array(column) for column in zip(*bridge.rows, strict=True))
    blind = (at[1:] > stopped[0] + 1.5) & (at[1:] < stopped[0] + 2.0)
    assert blind.any() and not np.diff(commanded, axis=0)[blind].any()
    for number, name in names.items():
        away = run.obstacles[:, number] - centers[name]
        assert np.abs(away).max() < 0.05


@pytest.mark.parametrize("centers", [{"box": [0.0, 1.0, 1.0]}, {}, {"cart": [float("nan")] * 3}])
def test_an_obstacle_that_vanishes_from_messages_is_silent(planned, connected, centers):
    both = {"cart": [0.0, 0.0, 1.0], "box": [0.0, 1.0, 1.0]}
    bridge = connected(obstacles=both)
    names = {2: "cart", 5: "box"}
    stream = CommandStream(planned[1].robot, StreamNames(obstacles="/seen"), QUICK, obstacles=names)
    assert stream.obstacles_age == float("inf")
    assert {seen.number for seen in stream.news(0.005)} == {2, 5} and stream.obstacles_age < 0.1
    bridge.obstacles = centers
    begun = time.monotonic()
    while time.monotonic() < begun + 0.2:
        assert 2 not in {seen.number for seen in stream.news(0.005)}
    assert stream.obstacles_age > 0.19


@pytest.mark.slow
def test_arms_that_brake_on_their_way_to_the_beginning_do_not_jump(planned, connected):
    _, plan = planned
    at = plan.joints.position[0] + 0.009 * np.sign(np.sin(np.arange(12.0)))
    bridge = connected(position=at)
    usual, tried = bridge.tell, []

    def tell(command):
        usual(command)
        if command["do"] == "follow" and len(bridge.rows) >= 30 and not tried and not bridge.player.why:
            tried.append(True)
            usual({"do": "brake", "why": "tried"})

    bridge.tell = tell
    run, _ = run_of(planned)
    played = np.array([row[3] for row in bridge.rows])
    assert run.arrived and "tried" in run.stops and set(run.stops) <= {"tried", *LATE}
    assert (np.abs(np.diff(played, axis=0)) / PERIOD / plan.robot.velocity).max() < 0.5
    assert (np.abs(np.diff(played, n=2, axis=0)) / PERIOD**2 / plan.robot.acceleration).max() <= 1.05


@pytest.mark.slow
def test_a_displaced_robot_ends_the_run(planned, connected):
    bridge = connected()
    usual = bridge.news

    def news(wait):
        found = usual(wait)
        for event in found:
            if event["event"] == "joints" and bridge.player is not None and len(bridge.rows) > 200:
                name = next(iter(event["position"]))
                event["position"] = {**event["position"], name: event["position"][name] + 0.7}
        return found

    bridge.news = news
    run, _ = run_of(planned)
    assert not run.arrived and "rad from where it was commanded" in run.given_up
    assert hands_apart(run) < 2e-4 and accelerations(run).max() <= 1.05


def test_a_robot_elsewhere_is_not_moved(planned, connected):
    _, plan = planned
    at = plan.joints.position[0].copy()
    at[3] += 0.02
    bridge = connected(position=at)
    with pytest.raises(SendError, match=f"'{plan.robot.joint_names[3]}' is at .* away") as found:
        run_of(planned)
    assert "comove send DIR --part approach" in found.value.way_out and bridge.player is None


def test_a_bridge_that_ends_is_told(planned, connected):
    bridge = connected()
    with pytest.raises(SendError, match="the bridge to ROS ended: killed"):
        run_of(planned, during=lambda k: bridge.more.append({"event": "ended"}) if k == 20 else None)


@pytest.mark.parametrize(
    ("frame", "centers", "words", "advice"),
    [
        ("camera", {"cart": [0.0, 0.0, 1.0]}, "in the frame 'camera'", "--frame 'camera'"),
        ("world", {"card": [0.0, 0.0, 1.0]}, "tells of card, and not of 'cart'", "names"),
        ("world", {"7": [0.0, 0.0, 1.0]}, "tells of 7", "numbers from 0"),
    ],
)
def test_obstacles_that_are_not_the_scenes(planned, connected, frame, centers, words, advice):
    connected(obstacles=centers, frame=frame)
    stream = CommandStream(planned[1].robot, StreamNames(obstacles="/seen"), QUICK, obstacles={2: "cart"})
    with pytest.raises(SendError, match=words) as found:
        for _ in range(100):
            stream.news(0.01)
    assert advice in found.value.way_out


class CloudsHere:
    """What reads clouds, without ROS."""

    def __init__(self, *_):
        self.unseen, self.ended, self.events, self.zero, self.over = (
            {"cart": "3 points show it"},
            "",
            [],
            None,
            0,
        )

    def news(self):
        found, self.events = self.events, []
        return found

    def begin(self, time):
        self.zero = time

    def end_input(self):
        self.over += 1

    def close(self):
        self.over += 1


@pytest.fixture
def cloudy(planned, monkeypatch):
    """A bridge, and a stream that knows an obstacle by clouds."""
    scene, plan = planned
    seen = with_obstacles(scene, {"cart": [0.7, 3.0, 0.3]})
    bridge = PlayedHere(plan.robot, plan.joints.position[0])
    answer = {"event": "connected", "kinds": ["std_msgs/msg/Float64MultiArray"], "obstacles": streams.CLOUD}
    monkeypatch.setattr(streams, "started", lambda *_: (bridge, answer, []))
    monkeypatch.setattr(streams, "ObstacleClouds", CloudsHere)
    names = StreamNames(obstacles="/cloud")
    yield (
        bridge,
        seen,
        CommandStream(plan.robot, names, QUICK, obstacles=moving_names(seen), scene=seen),
    )
    bridge.close()


def test_clouds_tell_obstacles_as_other_messages_do(cloudy):
    _, seen, stream = cloudy
    clouds = stream._clouds
    observer, (number,) = Observed(seen), moving_names(seen)
    with pytest.raises(SendError, match=r"where 'cart.*' is: 3 points show it") as found:
        await_obstacles(stream, observer, 0.1)
    assert "about where the scene has it at 0 s" in found.value.way_out
    now = time.monotonic()
    unseen = {"event": "unseen", "time": now, "frame": "world", "why": {"cart": "none"}}
    told = {"event": "obstacles", "time": now, "frame": "world", "centers": {"cart": [0.7, 3.1, 0.3]}}
    clouds.events = [unseen]
    assert stream.news(0.01) == [] and stream.obstacles_age == float("inf")
    clouds.events = [told]
    assert await_obstacles(stream, observer, 1.0) == clouds.zero == now
    np.testing.assert_allclose(observer.observe(0.0).table[number, 1:4], [0.7, 3.1, 0.3], atol=1e-3)
    clouds.events = [{**unseen, "frame": "camera"}]
    with pytest.raises(SendError, match="in the frame 'camera'"):
        stream.news(0.01)
    stream.close()
    assert clouds.over == 2


def test_arms_brake_when_nothing_reads_the_clouds_any_more(cloudy):
    bridge, _, stream = cloudy
    now = time.monotonic()
    stream._clouds.events = [
        {"event": "obstacles", "time": now, "frame": "world", "centers": {"cart": [0.7, 3.0, 0.3]}}
    ]
    stream.news(0.01)
    stream.begin(np.array(bridge.position))
    stream._clouds.ended = "the program that reads the clouds ended: killed"
    stream.news(0.01)
    assert stream.obstacles_age == float("inf") and bridge.player.why == stream._clouds.ended
    bridge.player.why = ""
    stream.news(0.01)
    assert bridge.player.why == ""  # it was told once


def test_clouds_without_a_scene_are_refused(planned, cloudy):
    bridge, _, _ = cloudy
    with pytest.raises(SendError, match="shapes are not known"):
        CommandStream(planned[1].robot, StreamNames(obstacles="/cloud"), QUICK, obstacles={2: "cart"})
    assert bridge.over.is_set()


def test_in_a_shorter_list_nobody_takes_anothers_place(planned, connected):
    """Obstacles in a list are told by their places: where one is missing, none is told."""
    bridge = connected(obstacles={"0": [0.0, 0.0, 1.0], "1": [0.0, 0.0, 2.0]})
    usual = bridge.news

    def news(wait):
        found = usual(wait)
        for event in found:
            if event["event"] == "obstacles":
                event["counted"] = True
        return found

    bridge.news = news
    names = StreamNames(obstacles="/seen")
    stream = CommandStream(planned[1].robot, names, QUICK, obstacles={2: "cart", 3: "gate"})
    assert {seen.number for _ in range(20) for seen in stream.news(0.005)} == {2, 3}
    bridge.obstacles = {"0": [0.0, 0.0, 2.0]}
    time.sleep(0.05)
    stream.news(0.0)
    assert not [seen for _ in range(20) for seen in stream.news(0.005)]
    assert stream.obstacles_age > 0.05


def test_obstacles_have_names_or_numbers(planned, connected):
    for centers in ({"cart": [0.0, 0.0, 1.0]}, {"0": [0.0, 0.0, 1.0]}):
        connected(obstacles=centers)
        stream = CommandStream(planned[1].robot, StreamNames(obstacles="/seen"), QUICK, obstacles={2: "cart"})
        seen = [seen for _ in range(20) for seen in stream.news(0.005)]
        assert {one.number for one in seen} == {2}


def test_names_of_topics(planned):
    robot = Robot.load("two_ur10")
    arms = {"left": ["a", "b"], "right": ["c"]}
    assert StreamNames.of(robot).topics(arms) == {
        "/left_position_controller/commands": ["a", "b"],
        "/right_position_controller/commands": ["c"],
    }
    assert StreamNames.of(robot, commands="/arms").topics(arms) == {"/arms": ["a", "b", "c"]}
    described = robot.description.model_copy(update={"ros": RosNames(commands="/own")})
    assert StreamNames.of(replace(robot, description=described)).commands == "/own"


@pytest.mark.slow
def test_arms_wait_while_one_joint_is_silent(planned, connected):
    """The others go on to be told."""
    bridge = connected()
    usual, name = bridge.news, planned[1].robot.joint_names[3]

    def news(wait):
        found = usual(wait)
        for event in found:
            if event["event"] == "joints" and 100 < len(bridge.rows) < 200:
                event["position"] = {joint: q for joint, q in event["position"].items() if joint != name}
        return found

    bridge.news = news
    run, _ = run_of(planned)
    still = (np.abs(np.diff(run.commanded, axis=0)).max(axis=1) == 0.0).sum() * run.period
    assert run.arrived and run.stops and still > 0.3


@pytest.mark.slow
def test_a_stamp_from_the_future_does_not_blind(planned, connected):
    """Of a cart that moves on; and the record tells where it was while the arms braked."""
    scene, plan = planned
    moves = {"waypoints": [[0.7, 3.0, 0.3], [0.7, 3.1, 0.3]], "times": [0.0, 3.0]}
    data = scene.file.model_dump(mode="json", exclude_none=True)
    cart = {"name": "cart", "shape": "sphere", "center": [0.7, 3.0, 0.3], "radius": 0.1, "motion": moves}
    seen = Scene.from_dict({**data, "obstacles": [*data.get("obstacles", []), cart]})
    bridge, names = connected(obstacles={"cart": [0.7, 3.0, 0.3]}), moving_names(seen)
    stream = CommandStream(plan.robot, StreamNames(obstacles="/seen"), QUICK, obstacles=names)
    observer = Observed(seen, Sensor(noise=0.005))
    zero = await_obstacles(stream, observer, 2.0)
    executor = JointExecutor(seen, plan.robot, observer, plan=plan, settings=SETTINGS)
    usual, silent, early = bridge.news, [], []

    def news(wait):
        """Once silent the cart moves on; before, one stamp is of the future."""
        found, since = usual(wait), time.monotonic() - silent[0] if silent else 0.0
        for event in found:
            if event["event"] == "obstacles":
                event["centers"] = {"cart": [0.7, 3.0 + 0.2 * min(since, 1.0), 0.3]}
                if len(bridge.rows) > 30 and not early:
                    early.append(True)
                    event["time"] += 1000.0
        return found

    bridge.news = news
    bridge.silent["joints"] = 0.0
    steps, step = iter(range(10**6)), executor.step

    def stepped(measured):
        if next(steps) == 60:
            silent.append(time.monotonic())
            bridge.silent["joints"] = silent[0] + 1.0
        return step(measured)

    executor.step = stepped
    run = run_streamed(executor, stream, 20.0, zero=zero)
    (number,) = names
    assert run.arrived and run.stops
    assert abs(run.obstacles[-1, number, 1] - 3.2) < 0.03
    moved = run.obstacles[~run.held, number, 1]
    assert np.ptp(moved) > 0.05  # as it went on while they braked and stood


def test_a_forged_brake_is_found(planned, connected, tmp_path):
    """Arms that brake leave the grasp by rounding, and not by as much as a record likes."""
    connected()
    run, executor = run_of(planned)
    record = streamed(run)
    report = judge_run(record)
    record.braked = [True] * len(record.time)
    for nodes in record.nodes[50:-50]:
        nodes += 0.02
    more = {"obstacles": "scene", "executed": "ros2"}
    write_robot_run(tmp_path, record, report, executor.log, seed=0, wall_time_s=1.0, more=more)
    _, found = verify_robot_run(read_robot_run(tmp_path), run.scene, run.robot)
    assert any("braking arms is off the load" in reason for reason in found.reasons)
