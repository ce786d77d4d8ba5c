"""Sending over the real ROS 1, on loopback: a master, an action server each arm, and faults of all kinds."""

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from dataclasses import replace

import pytest

from comove.processes import n_processors
from comove.ros import SendError, Tolerances, send
from comove.ros.ros1 import BRIDGE, Ros1Client
from tests.ros.ros1_robot import INSTALL, PYTHON, Process, arm_server, has_ros, ros_master

BRIEF = Tolerances(connect=3.0, late=1.0, silence=2.0)  # other work on this machine is no fault of the arms
LOAD = max(
    1.0, os.getloadavg()[0] / n_processors()
)  # by how much all is slower than on a machine of one's own
SOON = 0.1 * LOAD  # s, until all arms must have stopped
TRIES = 3  # of a measurement of time, of which the best counts


pytestmark = pytest.mark.skipif(
    not has_ros(),
    reason=f"ROS 1 is not installed: {INSTALL}",
)


@pytest.fixture(scope="module")
def master():
    """A ROS master; the environment that leads there."""
    with ros_master() as environment:
        yield environment


@pytest.fixture
def robot(master, brief, monkeypatch):
    """Starts a robot with faults by arm; a client for it comes with it."""
    for key, value in master.items():
        monkeypatch.setenv(key, value)
    with ExitStack() as running:

        def start(off=None, states=True, arms=("left", "right"), at=None, **faults):
            at = at or dict(zip(brief.robot.joint_names, brief.joints.position[0], strict=True))
            servers = {}
            for arm in arms:
                position = {
                    name: value + (off or {}).get(name, 0.0)
                    for name, value in at.items()
                    if name.startswith(arm)
                }
                server = arm_server(arm, position, master, fault=faults.get(arm), states=states)
                servers[arm] = running.enter_context(server)
            for server in servers.values():
                server.wait_for("ready")
            return servers, running.enter_context(Ros1Client())

        yield start


@pytest.mark.slow  # in real time
@pytest.mark.parametrize("name", ["brief", "verified"])
def test_both_arms_finish_in_step(robot, name, request):
    """A short part of a carry, and a whole one. Processes are as late as a machine is busy: the best try counts."""
    motion = request.getfixturevalue(name)
    at = dict(zip(motion.robot.joint_names, motion.joints.position[0], strict=True))
    for left in reversed(range(TRIES)):
        servers, client = robot(at=at)
        outcome = send(client, motion, tolerances=BRIEF)
        stamps = {arm: server.wait_for("goal")["stamp"] for arm, server in servers.items()}
        ends = [server.wait_for("done")["at"] for server in servers.values()]
        assert stamps["left"] == stamps["right"] > 0
        assert outcome.deviation < BRIEF.path
        apart = max(abs(ends[0] - ends[1]), outcome.apart)
        print(f"ends {1e3 * apart:.1f} ms apart, deviation {outcome.deviation:.4f} rad")
        if apart < 0.05 or not left:
            break
    assert apart < 0.05


def fails(client, motion, message, **changes):
    """Send, and return the error once it has come."""
    with pytest.raises(SendError, match=message) as caught:
        send(client, motion, tolerances=replace(BRIEF, **changes))
    return caught.value


@pytest.mark.parametrize("how", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_killed_server_stops_the_other_arm(robot, brief, how):
    for left in reversed(range(TRIES)):
        servers, client = robot()
        killed = []

        def kill(server=servers["left"], killed=killed):
            server.wait_for("goal")
            time.sleep(0.8)
            killed.append(time.monotonic())
            server.process.send_signal(how)

        thread = threading.Thread(target=kill)
        thread.start()
        error = fails(client, brief, "the arm 'left' is gone: its node /arm_left")
        thread.join()
        assert error.outcome.arms["right"].status.name == "PREEMPTED"
        cancelled, stopped = (
            servers["right"].wait_for(event)["at"] - killed[0] for event in ("cancel", "stopped")
        )
        print(f"told to stop after {1e3 * cancelled:.1f} ms, stopped after {1e3 * stopped:.1f} ms")
        if stopped < SOON or not left:
            break
    assert stopped < SOON


@pytest.mark.slow
def test_a_server_that_hangs_stops_the_other_arm(robot, brief):
    servers, client = robot()

    def hang():
        servers["left"].wait_for("goal")
        time.sleep(0.8)
        servers["left"].process.send_signal(signal.SIGSTOP)

    thread = threading.Thread(target=hang)
    thread.start()
    fails(client, brief, "said nothing for", path=10.0)
    thread.join()
    servers["right"].wait_for("stopped")


@pytest.mark.slow
def test_an_arm_that_gives_up_stops_the_other(robot, brief):
    servers, client = robot(left="stuck")
    fails(client, brief, "'left' gave up: it left the path", path=10.0)
    aborted, stopped = servers["left"].wait_for("aborted")["at"], servers["right"].wait_for("stopped")["at"]
    assert stopped - aborted < 10 * SOON
    print(f"stopped after {1e3 * (stopped - aborted):.1f} ms")


@pytest.mark.slow
def test_an_arm_that_lags_is_stopped_before_it_gives_up(robot, brief):
    servers, client = robot(right="stuck")
    error = fails(client, brief, "the joint 'right_.*' is 0.2.* rad off the motion")
    assert error.outcome.deviation > BRIEF.path
    for server in servers.values():
        server.wait_for("stopped")


def test_a_refused_goal_stops_the_other_arm(robot, brief):
    _, client = robot(left="refuse")
    error = fails(client, brief, "'left' refused the goal: the arm is not enabled")
    assert error.outcome.arms["right"].status.name in (
        "PREEMPTED",
        "RECALLED",
    )  # so soon that it may not have begun


@pytest.mark.slow
def test_an_arm_that_never_ends_is_stopped(robot, brief):
    servers, client = robot(right="endless")
    fails(client, brief, "'right' was not done 1 s after the end")
    servers["right"].wait_for("stopped")


def test_a_robot_elsewhere_is_not_moved(robot, brief):
    servers, client = robot(off={"right_w1": -0.05})
    fails(client, brief, r"'right_w1' is at .* 0\.05 rad away \(0\.01 allowed\); bring the robot there first")
    assert all(server.events.empty() for server in servers.values())


@pytest.mark.slow
def test_a_robot_that_says_nothing_is_not_moved(robot, brief):
    servers, client = robot(states=False)
    fails(client, brief, "joints have said nothing for 1 s; switch the robot on", connect=1.0)
    assert all(server.events.empty() for server in servers.values())


@pytest.mark.slow
def test_a_missing_server_is_told(robot, brief):
    _, client = robot(arms=("left",))
    fails(
        client,
        brief,
        "no action server answers at 'robot/limb/right/follow_joint_trajectory' within 1 s",
        connect=1.0,
    )


def test_a_missing_master_is_told(brief, monkeypatch):
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:9")
    with Ros1Client() as client:
        fails(client, brief, "no ROS master at http://127.0.0.1:9; start one by roscore")


@pytest.mark.parametrize("python", [sys.executable, "/no/such/python"])
def test_a_python_without_ros_is_told(brief, monkeypatch, python):
    monkeypatch.setenv("COMOVE_ROS_PYTHON", python)
    with Ros1Client() as client:
        fails(client, brief, "no Python here has ROS 1; tried .*COMOVE_ROS_PYTHON")


@pytest.mark.slow
def test_when_the_bridge_ends_another_one_stops_all_arms(robot, brief):
    servers, client = robot(left="endless", right="endless")

    def kill():
        for server in servers.values():
            server.wait_for("goal")
        client._process.kill()

    thread = threading.Thread(target=kill)
    thread.start()
    fails(client, brief, "'left' is gone: the bridge to ROS ended")
    thread.join()
    for server in servers.values():
        server.wait_for("stopped")


@pytest.mark.slow
def test_when_the_bridge_hangs_another_one_stops_all_arms(robot, brief):
    servers, client = robot(left="endless", right="endless")

    def hang():
        for server in servers.values():
            server.wait_for("goal")
        client._process.send_signal(signal.SIGSTOP)

    thread = threading.Thread(target=hang)
    thread.start()
    error = fails(client, brief, "joints have said nothing for", silence=0.5)
    thread.join()
    for server in servers.values():
        server.wait_for("stopped", 5.0)
    assert "did not answer" in error.outcome.arms["left"].text


def test_what_breaks_the_bridge_is_told():
    done = subprocess.run([PYTHON, str(BRIDGE)], input="rubbish\n", capture_output=True, text=True)
    assert "Error" in done.stderr.splitlines()[-1]


def test_no_file_stays_open(brief, monkeypatch):
    monkeypatch.setenv("COMOVE_ROS_PYTHON", "/no/such/python")
    with Ros1Client() as client:
        fails(client, brief, "no Python here has ROS 1")
        client.close()
        assert client._errors is None


def test_no_room_for_temporary_files_is_told(brief, monkeypatch):
    def none(*_, **__):
        raise FileNotFoundError(2, "No usable temporary directory found in ['/tmp']")

    monkeypatch.setattr("comove.ros.ros1.tempfile.TemporaryFile", none)
    with Ros1Client() as client:
        fails(client, brief, "No usable temporary directory")


@pytest.mark.slow
def test_when_comove_ends_all_arms_stop(robot, brief, master):
    """Even when it is killed: the bridge's input ends."""
    servers, _ = robot()
    code = (
        "import sys, time; from comove.ros import JointSamples as Goal, Ros1Client;"
        "import numpy as np; n = np.arange(3) * 10**10; names = sys.argv[1:];"
        "client = Ros1Client(); arms = {a: tuple(x for x in names if x.startswith(a)) for a in ('left', 'right')};"
        "client.connect(arms, 20.0);"
        "client.send({a: Goal(j, n, *3 * [np.zeros((3, 7))]) for a, j in arms.items()}, 0.1); time.sleep(60)"
    )
    arguments = [sys.executable, "-c", code, *brief.robot.joint_names]
    with Process(arguments, {**os.environ, **master}) as comove:
        for server in servers.values():
            server.wait_for("goal", 60.0)
        time.sleep(0.3)
        comove.process.kill()
        killed = time.monotonic()
        for server in servers.values():
            assert server.wait_for("stopped")["at"] - killed < 10 * SOON


def test_its_messages_are_those_of_control_msgs():
    """Checksums as in the public headers that ROS generates; other ones would be refused by a robot's servers."""
    code = "import sys; sys.path.insert(0, sys.argv[1]); from ros1_bridge import message_types;"
    code += "print({name: kind._md5sum for name, kind in message_types().items()})"
    done = subprocess.run([PYTHON, "-c", code, BRIDGE.parent], capture_output=True, text=True, check=True)
    for name, checksum in {
        "FollowJointTrajectoryAction": "bc4f9b743838566551c0390c65f1a248",
        "FollowJointTrajectoryActionGoal": "cff5c1d533bf2f82dd0138d57f4304bb",
        "FollowJointTrajectoryActionResult": "c4fb3b000dc9da4fd99699380efcc5d9",
        "FollowJointTrajectoryActionFeedback": "d8920dc4eae9fc107e00999cce4be641",
    }.items():
        assert f"'control_msgs/{name}': '{checksum}'" in done.stdout


@pytest.mark.parametrize("name", ["python2.7", "python3"])
def test_the_bridge_is_for_the_pythons_of_all_ros_1(name, tmp_path):
    python = shutil.which(name)
    if python is None or subprocess.run([python, "-V"], capture_output=True).returncode:
        pytest.skip(f"{name} is not installed")
    copy = shutil.copy(BRIDGE, tmp_path)
    subprocess.run([python, "-m", "py_compile", copy], check=True)
