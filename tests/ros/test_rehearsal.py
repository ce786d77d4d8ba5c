"""A simulated robot behind the real ROS 2, on loopback: `comove send` and clients that are not comove's."""

import json
import os
import queue
import re
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from comove.errors import OptionError, SendError
from comove.processes import n_processors
from comove.robots.description import RosGripper
from comove.ros import Names, Tolerances, send
from comove.ros.looking import look
from comove.ros.rehearsal import Rehearsal, RehearsalSettings
from comove.sim import Friction, Weld, simulate
from comove.sim.robot import SimulatedRobot
from tests.robots.known_folder import write
from tests.ros.robots import JAZZY, KILTED

HERE = Path(__file__).parent
LOAD = max(1.0, os.getloadavg()[0] / n_processors())  # by which all is slower than on a machine of one's own
PATIENT = Tolerances(connect=15.0, late=3.0 * LOAD, silence=2.0 * LOAD, delay=0.5 * LOAD, clock=0.5 * LOAD)
LEFT, RIGHT = (f"/{arm}_controller/follow_joint_trajectory" for arm in ("left", "right"))
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6  # of action_msgs/msg/GoalStatus
GRIPPERS = {
    kind: RosGripper(type=kind, action="/{arm}_gripper/grip", open=0.04, closed=0.0, joint="{arm}_finger")
    for kind in ("gripper_command", "parallel_gripper_command", "joint_trajectory")
}
EACH = [
    pytest.param(ros, id=ros.name, marks=pytest.mark.skipif(not ros.is_there, reason=f"needs: {ros.install}"))
    for ros in (KILTED, JAZZY)
]


@contextmanager
def served(ros, robot, names=None, **settings):
    """A robot that moves in a thread; lends what it has said so far."""
    said, stop = [], threading.Event()
    with Rehearsal(
        robot, names, RehearsalSettings(**settings), tell=said.append, python=ros.python
    ) as rehearsal:
        thread = threading.Thread(target=rehearsal.run, args=(stop.is_set,))
        thread.start()
        try:
            yield said
        finally:
            stop.set()
            thread.join()


@contextmanager
def in_network(ros):
    """An environment in which nodes find each other, in this process and those that it starts."""
    with ros.network() as environment, pytest.MonkeyPatch.context() as patch:
        for key, value in environment.items():
            patch.setenv(key, value)
        yield environment


@pytest.fixture(scope="module", params=EACH)
def network(request):
    with in_network(request.param):
        yield request.param


@pytest.fixture
def alone(network):
    """A version of ROS, with a network in which there is no robot yet."""
    with in_network(network):
        yield network


@pytest.fixture(scope="module")
def free(network, verified):
    """A robot whose arms are free, at home; with its ROS and what it has said."""
    robot = SimulatedRobot(
        verified.joints, verified.scene, verified.robot, present=verified.robot.home.copy()
    )
    with served(network, robot) as said:
        yield network, robot, said


def ask(ros, **scenario):
    """What a client has seen, by kinds of events in order."""
    arguments = [ros.python, str(HERE / "ros2_client.py"), json.dumps(scenario)]
    environment = {k: v for k, v in os.environ.items() if k != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    done = subprocess.run(arguments, capture_output=True, text=True, env=environment, timeout=90)
    found = {}
    for line in done.stdout.splitlines():
        if line.startswith("{"):
            event = json.loads(line)
            found.setdefault(event.pop("event"), []).append(event)
    assert "states" in found, done.stderr[-2000:]
    return found


def arm(robot, name):
    """Names and present positions of an arm's joints."""
    columns = list(robot.robot.arm(name).columns)
    return [robot.robot.joint_names[c] for c in columns], robot.position[columns]


def turned(robot, angle, seconds=1.0, **more):
    """A goal that turns the left arm's last joint by an angle [rad], at even speed."""
    joints, position = arm(robot, "left")
    target = position + angle * np.eye(len(joints))[-1]
    return {
        "action": LEFT,
        "joints": joints,
        "times": [seconds],
        "positions": [target.tolist()],
        **more,
    }


def series(found):
    """Stamps, arrival and positions by joint of the states that a client has seen."""
    (states,) = found["states"]
    rows, n = np.array(states["rows"]), len(states["names"])
    return rows[:, 0], rows[:, 1], dict(zip(states["names"], rows[:, 3 : 3 + n].T, strict=True))


def test_a_goal_is_executed_and_its_joints_are_told(free):
    ros, robot, _ = free
    goal = turned(robot, 0.2)
    found = ask(ros, goals=[goal])
    (result,) = found["result"]
    assert (result["status"], result["error_code"]) == (SUCCEEDED, 0)
    stamps, arrived, positions = series(found)
    assert positions["left_w2"][-1] == pytest.approx(goal["positions"][0][-1], abs=0.01)
    assert sorted(positions) == sorted(robot.robot.joint_names)
    steps = np.diff(stamps)
    assert (steps > 0).all() and np.median(steps) == pytest.approx(0.01, abs=1e-6)
    assert np.median(np.abs(arrived - stamps)) < 0.02 * LOAD
    assert len(stamps) / np.ptp(arrived) == pytest.approx(100.0, rel=0.1 * LOAD)


@pytest.mark.slow
def test_feedback_tells_desired_actual_and_error_twenty_times_a_second(free):
    ros, robot, _ = free
    found = ask(ros, goals=[turned(robot, 0.4, 2.0)])
    told = found["feedback"]
    assert 30 <= len(told) <= 42
    for row in told:
        desired, actual, error = (np.array(row[name]) for name in ("desired", "actual", "error"))
        np.testing.assert_allclose(desired[0] - actual[0], error[0], atol=1e-12)
        assert row["joints"] == arm(robot, "left")[0]
    ways = [row["desired"][0][-1] for row in told]
    assert (np.diff(ways) > 0).all() and np.diff(ways).max() < 0.012
    assert max(abs(row["error"][0][-1]) for row in told) < 0.02


def refused(robot):
    """Goals that a controller refuses, by what is wrong with them."""
    good = turned(robot, 0.1)
    joints, there = good["joints"], good["positions"][0]
    still = [0.0] * len(joints)
    return {
        "foreign": {**good, "joints": [*joints[:-1], "right_w2"]},
        "missing": {**good, "joints": joints[:-1], "positions": [there[:-1]]},
        "double": {**good, "joints": [*joints, joints[0]], "positions": [[*there, there[0]]]},
        "times": {**good, "times": [1.0, 1.0], "positions": [there, there]},
        "moving end": {**good, "velocities": [[*still[:-1], 0.1]]},
        "past": {**good, "stamp": -5.0},
        "empty": {**good, "times": [], "positions": []},
        "sizes": {**good, "positions": [there[:-1]]},
    }


@pytest.mark.slow
def test_a_controllers_rules_are_kept(free):
    ros, robot, said = free
    before, goals = robot.position, refused(robot)
    found = ask(ros, goals=list(goals.values()))
    answers = {row["goal"]: row["accepted"] for row in found["answer"]}
    assert answers == dict.fromkeys(range(len(goals)), False)
    assert np.abs(robot.position - before).max() < 1e-3
    reasons = [text.split("refused a goal: ")[1] for text in said if "refused a goal" in text]
    assert len(reasons) == len(goals)
    for part in (
        *("'right_w2' is not one", "lacks left_w2", "names left_s0 twice", "times must rise", "is empty"),
        *("velocity of 'left_w2'", " s ago by its stamp", "6 positions for 7 joints"),
    ):
        assert any(part in reason for reason in reasons), part


def allowing(robot, most):
    return {name: [most, 0.0, 0.0] for name in arm(robot, "left")[0]}


@pytest.mark.slow
def test_a_joint_off_its_path_or_goal_aborts_the_goal_with_its_code(free):
    """No servo leaps by a radian in 20 ms, nor does it come within a nanoradian."""
    ros, robot, _ = free
    leap = turned(robot, -0.5, 0.02, path=allowing(robot, 0.05))
    (result,) = ask(ros, goals=[leap])["result"]
    assert (result["status"], result["error_code"]) == (ABORTED, -4)
    assert result["error_string"] == "Aborted due to path tolerance violation"
    exact = turned(robot, 0.1, 0.3, end=allowing(robot, 1e-12), late=0.4)
    found = ask(ros, goals=[exact])
    (result,), (answer,) = found["result"], found["answer"]
    assert (result["status"], result["error_code"]) == (ABORTED, -5)
    assert "goal_time_tolerance" in result["error_string"] and answer["accepted"]


@pytest.mark.slow
def test_a_cancelled_goal_stops_within_the_servos_lag(free):
    ros, robot, _ = free
    speed = 0.4
    found = ask(ros, goals=[turned(robot, 4.0 * speed, 4.0, cancel=0.7)], listen=0.6)
    (result,) = found["result"]
    assert result["status"] == CANCELED
    stamps, _, positions = series(found)
    way = positions["left_w2"]
    moved = np.flatnonzero(np.abs(np.diff(way)) / np.diff(stamps) > 0.1 * speed)
    stopped = stamps[moved[-1] + 1]
    assert stopped - result["now"] < 0.15 * LOAD
    rest = way[stamps > result["now"] + 0.3]
    assert np.ptp(rest) < 2e-3
    assert abs(rest[-1] - np.interp(result["now"], stamps, way)) < 0.02 + 0.05 * speed * LOAD


@pytest.mark.slow
def test_a_new_goal_replaces_the_running_one(free):
    ros, robot, _ = free
    start = robot.position[robot.robot.joint_names.index("left_w2")]
    away, back = turned(robot, 1.0, 3.0), turned(robot, 0.0, 1.0, after=1.0)
    found = ask(ros, goals=[away, back])
    by_goal = {row["goal"]: row for row in found["result"]}
    assert (by_goal[0]["status"], by_goal[0]["error_code"]) == (ABORTED, -1)
    assert "preempted" in by_goal[0]["error_string"]
    assert by_goal[1]["status"] == SUCCEEDED
    stamps, _, positions = series(found)
    way = positions["left_w2"] - start
    assert 0.1 < way.max() < 0.6 and way[-1] == pytest.approx(0.0, abs=0.01)
    assert np.abs(np.diff(way) / np.diff(stamps)).max() < 1.0  # it does not leap


@pytest.mark.slow
def test_arms_move_at_once_where_goals_have_one_stamp(free):
    ros, robot, _ = free
    left = turned(robot, 0.3, 0.5, stamp=1.0)
    joints, position = arm(robot, "right")
    right = {**left, "action": RIGHT, "joints": joints}
    right["positions"] = [(position + 0.3 * np.eye(len(joints))[-1]).tolist()]
    found = ask(ros, goals=[left, right])
    ends = [row["now"] for row in found["result"]]
    assert len(ends) == 2 and abs(ends[0] - ends[1]) < 0.3 * LOAD


@pytest.mark.slow
def test_streamed_positions_are_followed_while_there_is_no_goal(free):
    ros, robot, said = free
    joints, position = arm(robot, "left")
    path = [(position + 0.002 * k * np.eye(len(joints))[-1]).tolist() for k in range(100)]
    topic = "/left_position_controller/commands"
    found = ask(ros, stream={"topic": topic, "positions": path}, listen=0.5)
    assert series(found)[2]["left_w2"][-1] == pytest.approx(path[-1][-1], abs=0.01)
    ask(ros, stream={"topic": topic, "positions": [[0.0]]}, listen=0.3)
    assert any("commands of /left_position_controller/commands are ignored" in text for text in said)
    assert robot.position[robot.robot.joint_names.index("left_w2")] == pytest.approx(path[-1][-1], abs=0.01)


@pytest.mark.slow
def test_doctor_finds_the_robot(free):
    ros, robot, _ = free
    seen = look(python=ros.python)
    assert [server.action for server in seen.servers] == [LEFT, RIGHT]
    assert all(server.answer is not None and not server.busy for server in seen.servers)
    assert set(seen.joints) == set(robot.robot.joint_names) and seen.nodes == ("/comove_simulated_robot",)
    assert seen.rate == pytest.approx(100.0, rel=0.1 * LOAD)


@pytest.mark.slow
def test_one_controller_of_all_arms_and_other_names(alone, brief):
    names = Names("/both_arms/follow_joint_trajectory", "/robot/joint_states")
    robot = SimulatedRobot(brief.joints, brief.scene, brief.robot)
    with served(alone, robot, names, rate=50.0) as said, alone.client(names=names) as client:
        outcome = send(client, brief, tolerances=PATIENT)
    assert outcome.apart == 0.0 and outcome.deviation < 0.01
    assert sum("/both_arms/follow_joint_trajectory succeeded" in text for text in said) == 1
    assert robot.report().delivered


@pytest.mark.slow
def test_what_was_sent_is_carried_as_the_simulation_says(alone, verified):
    """Servers, clocks and messages change nothing of what `comove simulate` measures."""
    robot = SimulatedRobot(verified.joints, verified.scene, verified.robot)
    with served(alone, robot), alone.client() as client:
        send(client, verified, tolerances=PATIENT)
    report = robot.report()
    assert report.delivered and not report.contacts
    measures = simulate(verified.joints, verified.scene, verified.robot, Weld()).measures
    for name in ("lag_max", "tracking_error_max", "torque_share_max", "internal_force_max"):
        assert report.measures[name] == pytest.approx(measures[name], rel=0.1), name


@pytest.mark.slow
@pytest.mark.parametrize("grasp", [Weld(), Friction()], ids=["weld", "friction"])
@pytest.mark.parametrize("kind", GRIPPERS)
def test_a_payload_is_approached_carried_and_released(alone, verified, transfers, kind, grasp):
    if isinstance(grasp, Friction) != (kind == "gripper_command") and alone is not KILTED:
        pytest.skip("tried with the other distribution")
    names = Names(gripper=GRIPPERS[kind])
    robot = SimulatedRobot(
        verified.joints, verified.scene, verified.robot, grasp, present=transfers.approach.position[0].copy()
    )
    with served(alone, robot, names) as said:
        for part in ("approach", "carry", "release"):
            with alone.client(names=names) as client:
                send(client, verified, part=part, transfers=transfers, tolerances=PATIENT)
    report = robot.report()
    assert report.delivered, (report.reasons, said)
    words = "\n".join(said)
    assert words.count("has closed on the payload") == 2
    assert "all grippers hold the payload" in words and "the payload is released at its goal" in words
    assert report.measures["end_error"] < 3e-3


@pytest.mark.slow
def test_a_gripper_that_closes_on_nothing_has_not_stalled(alone, verified):
    names = Names(gripper=GRIPPERS["gripper_command"])
    robot = SimulatedRobot(
        verified.joints, verified.scene, verified.robot, present=verified.robot.home.copy()
    )
    goal = {"kind": "GripperCommand", "action": "/left_gripper/grip", "position": 0.0}
    with served(alone, robot, names) as said:
        found = ask(alone, goals=[goal])
    (result,) = found["result"]
    assert result["status"] == SUCCEEDED and result["reached_goal"] and not result["stalled"]
    assert result["position"] == pytest.approx(0.0, abs=1e-3)
    assert any("has closed on nothing" in text for text in said)
    assert "the payload was never held by all grippers" in robot.report().reasons
    assert {"left_finger", "right_finger"} <= set(found["states"][0]["names"])


@pytest.mark.slow
def test_simulated_time_is_told_and_used(alone, brief):
    robot = SimulatedRobot(brief.joints, brief.scene, brief.robot)
    with served(alone, robot, sim_time=True):
        with alone.client(sim_time=True) as client:
            outcome = send(client, brief, tolerances=PATIENT)
        stamps, arrived, _ = series(ask(alone, sim_time=True, listen=0.5))
    assert outcome.deviation < 0.01 and robot.report().delivered
    assert 0.0 < stamps[0] < stamps[-1] < 120.0
    assert np.abs(arrived[1:] - stamps[1:]).max() < 0.1 * LOAD


class SlowRobot(SimulatedRobot):
    """A robot that takes longer than its time."""

    def step(self, *command):
        time.sleep(2 * self.timestep)
        super().step(*command)


@pytest.mark.slow
@pytest.mark.parametrize("sim_time", [False, True])
def test_what_does_not_keep_pace_is_told_once(alone, brief, sim_time):
    robot = SlowRobot(brief.joints, brief.scene, brief.robot)
    with served(alone, robot, sim_time=sim_time) as said:
        time.sleep(2.0)
    (warning,) = [text for text in said if "behind the clock" in text]
    assert ("simulated time passes more slowly" in warning) == sim_time


@pytest.mark.slow
def test_a_name_that_ros_does_not_take_is_told(alone, brief):
    robot = SimulatedRobot(brief.joints, brief.scene, brief.robot)
    with pytest.raises(SendError, match=r"does not serve the robot's interfaces: .*invalid"):
        Rehearsal(robot, Names("/a b/{arm}"), python=alone.python)


def test_a_python_without_ros_is_told(brief):
    robot = SimulatedRobot(brief.joints, brief.scene, brief.robot)
    with pytest.raises(SendError, match="no Python here has ROS 2; tried"):
        Rehearsal(robot, python=sys.executable)


@pytest.mark.parametrize("rate", [0.0, 501.0, float("nan")])
def test_a_rate_that_is_not_possible_is_told(rate):
    with pytest.raises(OptionError, match=r"--rate: .* Hz are not possible"):
        RehearsalSettings(rate=rate)


class Command:
    """A command of comove in a process of its own, whose lines are kept."""

    def __init__(self, ros, *words):
        environment = {**os.environ, "COMOVE_ROS_PYTHON": ros.python}
        arguments = [sys.executable, "-m", "comove", *map(str, words)]
        self.process = subprocess.Popen(
            arguments, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment
        )
        self.lines, self.told = queue.Queue(), []
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self):
        for line in self.process.stdout:
            self.lines.put(line.rstrip())

    def wait_for(self, part, timeout=60.0):
        """Wait for a line that has a part."""
        until = time.monotonic() + timeout
        while True:
            line = self.lines.get(timeout=max(0.01, until - time.monotonic()))
            self.told.append(line)
            if part in line:
                return line

    def end(self):
        """Return the exit code, and all that was told."""
        code = self.process.wait(30.0)
        time.sleep(0.2)
        while not self.lines.empty():
            self.told.append(self.lines.get())
        return code, "\n".join(self.told)

    def child(self):
        """The process of the interfaces."""
        found = subprocess.run(
            ["ps", "-o", "pid=", "--ppid", str(self.process.pid)], capture_output=True, text=True
        )
        return int(found.stdout.split()[0])

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()


def is_running(pid):
    """Whether a process is there and no zombie."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write(tmp_path_factory.mktemp("rehearsal") / "posts")


@pytest.mark.slow
def test_the_command_offers_carries_and_tells_at_ctrl_c(alone, folder, verified):
    with Command(alone, "simulate", folder, "--ros", "2") as command:
        command.wait_for("ready; Ctrl-C ends it")
        words = "\n".join(command.told)
        for part in (LEFT, RIGHT, "/joint_states, 14 joints, 100 Hz", "/left_position_controller/commands"):
            assert part in words
        with alone.client() as client:
            send(client, verified, tolerances=PATIENT)
        child = command.child()
        command.process.send_signal(signal.SIGINT)
        code, words = command.end()
    assert code == 0 and "posts, baxter, weld: delivered" in words
    assert re.search(r"contacts +none", words) and re.search(r"load behind its plan +0\.\d+ mm", words)
    assert not is_running(child)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["SIGINT", "SIGTERM", "SIGKILL", "the other process"])
def test_the_end_of_either_process_ends_both(alone, folder, how):
    with Command(alone, "simulate", folder, "--ros", "2") as command:
        command.wait_for("ready")
        child = command.child()
        if how == "the other process":
            os.kill(child, signal.SIGKILL)
        else:
            command.process.send_signal(getattr(signal, how))
        code, words = command.end()
    until = time.monotonic() + 10.0
    while is_running(child) and time.monotonic() < until:
        time.sleep(0.05)
    assert not is_running(child)
    assert code == {"SIGINT": 1, "SIGTERM": 143, "SIGKILL": -9, "the other process": 1}[how]
    if how != "SIGKILL":
        assert "NOT DELIVERED" in words and "from its goal" in words
    if how == "the other process":
        assert "the interfaces of ROS ended" in words


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--sim-time",), "--sim-time: no robot is served in ROS; give --ros 2 as well"),
        (("--part", "approach"), "--part: no robot is served in ROS"),
        (("--ros", "1"), "--ros: robots are simulated in ROS 2"),
        (("--ros", "2", "--present", "x.yaml"), "--present: no approach is asked for"),
        (("--ros", "2", "--rate", "0"), "--rate: 0.0 Hz are not possible"),
    ],
)
def test_options_that_do_not_fit_are_told(options, message, folder):
    from tests.commands import invoke

    done = invoke("simulate", folder, *options)
    assert done.exit_code == 2 and message in done.output
