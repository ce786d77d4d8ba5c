"""Sending over the real ROS 1 and ROS 2, on loopback: an action server each arm, and faults of all kinds."""

import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, suppress
from dataclasses import replace

import numpy as np
import pytest

from comove.processes import n_processors
from comove.robots.description import RosGripper
from comove.ros import (
    Names,
    Ros1Client,
    Ros2Client,
    RosClient,
    SendError,
    Tolerances,
    connect,
    parts_of,
    send,
)
from comove.ros.bridges import BridgeProcess, awaited
from comove.ros.clients import MIDDLEWARES, ROS1
from tests.ros.robots import JAZZY, KILTED, NOETIC, Process

BRIEF = Tolerances(connect=10.0, late=1.0, silence=2.0)  # other work on this machine is no fault of the arms
LOAD = max(
    1.0, os.getloadavg()[0] / n_processors()
)  # by how much all is slower than on a machine of one's own
SOON = 0.1 * LOAD  # s, until all arms must have stopped
GRIPPER = RosGripper(action="/{arm}_gripper/grip", open=0.04, closed=0.0)
GRIPPERS = [
    "gripper_command",
    *(
        pytest.param(kind, marks=pytest.mark.slow)
        for kind in ("parallel_gripper_command", "joint_trajectory")
    ),
]
TRIES = 3  # of a measurement of time, of which the best counts


def versions(*rows):
    """Parameters of versions of ROS; tests of those that are not here are skipped."""
    return [
        pytest.param(
            ros, id=ros.name, marks=pytest.mark.skipif(not ros.is_there, reason=f"needs: {ros.install}")
        )
        for ros in rows
    ]


EACH = versions(NOETIC, KILTED, JAZZY)
needs_ros1 = pytest.mark.skipif(not NOETIC.is_there, reason=f"needs: {NOETIC.install}")


@pytest.fixture(scope="module", params=EACH)
def network(request):
    """A version of ROS, and an environment in which its nodes find each other."""
    with request.param.network() as environment:
        yield request.param, environment


@pytest.fixture
def robot(network, brief, monkeypatch):
    """Starts a robot with faults by arm; a client for it comes with it."""
    ros, environment = network
    for key, value in environment.items():
        monkeypatch.setenv(key, value)
    with ExitStack() as running:

        def start(joints=None, off=None, arms=("left", "right"), gripper=None, states=True, **faults):
            """The arms stand where a joint motion begins, the brief one's unless given."""
            joints, kind = joints or brief.joints, None if gripper is None else gripper.type
            at = dict(zip(joints.joint_names, joints.position[0].tolist(), strict=True))
            servers = {}
            for arm in arms:
                position = {
                    name: value + (off or {}).get(name, 0.0)
                    for name, value in at.items()
                    if name.startswith(arm)
                }
                server = ros.server(
                    arm, position, environment, fault=faults.get(arm), states=states, gripper=kind
                )
                servers[arm] = running.enter_context(server)
            for server in servers.values():
                server.wait_for("ready")
            return servers, running.enter_context(ros.client(names=Names(gripper=gripper)))

        yield start


@pytest.mark.slow  # in real time
@pytest.mark.parametrize("name", ["brief", "verified"])
def test_both_arms_finish_in_step(robot, name, request):
    """A short part of a carry, and a whole one. Processes are as late as a machine is busy: the best try counts."""
    motion = request.getfixturevalue(name)
    for left in reversed(range(TRIES)):
        servers, client = robot(motion.joints)
        outcome = send(client, motion, tolerances=BRIEF)
        stamps = {arm: server.wait_for("goal")["stamp"] for arm, server in servers.items()}
        ends = [server.wait_for("done")["at"] for server in servers.values()]
        assert stamps["left"] == stamps["right"] > 0
        assert outcome.deviation < 0.2
        apart = max(abs(ends[0] - ends[1]), outcome.apart)
        print(f"ends {1e3 * apart:.1f} ms apart, deviation {outcome.deviation:.4f} rad")
        if apart < 0.05 or not left:
            break
    assert apart < 0.05


def test_one_controller_of_both_arms_gets_one_goal(network, brief, monkeypatch):
    ros, environment = network
    for key, value in environment.items():
        monkeypatch.setenv(key, value)
    at = dict(zip(brief.robot.joint_names, brief.joints.position[0].tolist(), strict=True))
    both = Names("/both_arms/follow_joint_trajectory")
    if ros.version == 1:
        both = replace(both, joint_states="/robot/joint_states")
    with ros.server("both", at, environment, action=both.action) as server, ros.client(names=both) as client:
        server.wait_for("ready")
        outcome = send(client, brief, tolerances=BRIEF)
        server.wait_for("goal")
        server.wait_for("done")
        assert server.events.empty()
    assert outcome.apart == 0.0 and outcome.deviation < 0.2
    assert outcome.arms["left"] == outcome.arms["right"]


@pytest.mark.parametrize("kind", GRIPPERS)
@pytest.mark.parametrize("network", versions(KILTED), indirect=True)
def test_grippers_close_at_the_end_of_the_approach(robot, kind, verified, transfers):
    approach = transfers.approach
    servers, client = robot(
        approach, gripper=GRIPPER.model_copy(update={"type": kind, "joint": "{arm}_finger"})
    )
    outcome = send(client, verified, part="approach", transfers=transfers, tolerances=BRIEF)
    assert outcome.apart < 0.2 * LOAD
    for server in servers.values():
        opened, goal, closed = (server.wait_for(name) for name in ("gripped", "goal", "gripped"))
        assert opened["position"] == 0.04 and closed["position"] == 0.0
        assert closed["at"] > goal["at"] + approach.duration - transfers.grip_time


@pytest.mark.slow
@pytest.mark.parametrize("network", versions(NOETIC, KILTED), indirect=True)
def test_all_parts_go_over_one_connection(network, robot, verified, transfers):
    robot(transfers.approach)
    bridges, (ros, _) = set(), network
    with connect(version=ros.version, python=ros.python) as connected:
        for part in ("approach", "carry", "release"):
            outcome = connected.send(verified, part=part, transfers=transfers, tolerances=BRIEF)
            assert outcome.deviation < 0.2 and outcome.apart < 0.2 * LOAD
            bridges.add(connected.client._bridge)
    assert len(bridges) == 1


def fails(client, motion, message, **changes):
    """Send, and return the error once it has come."""
    with pytest.raises(SendError, match=message) as caught:
        send(client, motion, tolerances=replace(BRIEF, **changes))
    return caught.value


@pytest.mark.parametrize("how", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_killed_server_stops_the_other_arm(network, robot, brief, how):
    """ROS 1 closes its connections. ROS 2 leaves a killed one in its graph, and the silence of its joints tells."""
    soon = SOON if network[0].version == 1 else 1.0 * LOAD
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
        error = fails(client, brief, "the arm 'left' is gone|joints have said nothing", silence=0.5)
        thread.join()
        assert error.outcome.arms["right"].status.name == "PREEMPTED"
        cancelled, stopped = (
            servers["right"].wait_for(event)["at"] - killed[0] for event in ("cancel", "stopped")
        )
        print(f"told to stop after {1e3 * cancelled:.1f} ms, stopped after {1e3 * stopped:.1f} ms")
        if stopped < soon or not left:
            break
    assert stopped < soon


@pytest.mark.slow
def test_a_server_that_hangs_stops_the_other_arm(robot, brief):
    servers, client = robot()

    def hang():
        servers["left"].wait_for("goal")
        time.sleep(0.8)
        servers["left"].process.send_signal(signal.SIGSTOP)

    thread = threading.Thread(target=hang)
    thread.start()
    fails(client, brief, "said nothing for|it left the graph|its feedback has stopped", path=10.0)
    thread.join()
    servers["right"].wait_for("stopped")


@pytest.mark.slow
def test_an_arm_that_gives_up_stops_the_other(robot, brief):
    servers, client = robot(left="abort")
    fails(client, brief, "'left' gave up: it left the path", path=10.0)
    aborted, stopped = servers["left"].wait_for("aborted")["at"], servers["right"].wait_for("stopped")["at"]
    assert stopped - aborted < 10 * SOON
    print(f"stopped after {1e3 * (stopped - aborted):.1f} ms")


@pytest.mark.slow
@pytest.mark.parametrize("how", ["stuck", "slow"])
def test_an_arm_that_lags_is_stopped(robot, brief, how):
    servers, client = robot(right=how)
    error = fails(client, brief, "the joint 'right_.*' is 0.2.* rad off the motion")
    assert error.outcome.deviation > 0.2
    for server in servers.values():
        server.wait_for("stopped")


def test_a_refused_goal_stops_the_other_arm(robot, brief):
    _, client = robot(left="refuse")
    error = fails(client, brief, "'left' refused the goal")
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


def test_a_clock_that_is_not_set_is_told(robot, brief):
    """Be it that of one arm alone."""
    servers, client = robot(left="skewed")
    fails(client, brief, r"tells its joints with stamps 3(\.\d*)? s old .*NTP", connect=4.0)
    assert all(server.events.empty() for server in servers.values())


def test_a_robot_that_tells_degrees_is_not_moved(robot, brief):
    off = {
        name: np.degrees(at) - at
        for name, at in zip(brief.robot.joint_names, brief.joints.position[0], strict=True)
    }
    _, client = robot(off=off)
    fails(client, brief, "seems to tell degrees")


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
        "no action server answers at '.*right.*follow_joint_trajectory' within 4 s",
        connect=4.0,
    )


@pytest.mark.parametrize("network", versions(NOETIC), indirect=True)
def test_ros_1_says_itself_whose_time_it_is(network, robot, brief):
    robot()
    with network[0].client(sim_time=True) as client:
        fails(client, brief, "the parameter use_sim_time says whose time it is; set that")


@needs_ros1
def test_a_missing_master_is_told(brief, monkeypatch):
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:9")
    with Ros1Client() as client:
        fails(client, brief, "no ROS master at http://127.0.0.1:9; start one by roscore")


@pytest.mark.parametrize("python", [sys.executable, "/no/such/python"])
def test_a_python_without_ros_is_told(brief, monkeypatch, python):
    monkeypatch.setenv("COMOVE_ROS_PYTHON", python)
    for client, which in ((Ros1Client(), "ROS 1"), (Ros2Client(), "ROS 2"), (RosClient(), "ROS 2 or ROS 1")):
        with client:
            fails(client, brief, f"no Python here has {which}; tried .*COMOVE_ROS_PYTHON")


def test_an_environment_that_is_not_sourced_is_told(brief, monkeypatch, tmp_path):
    (tmp_path / "jazzy").mkdir()
    (tmp_path / "jazzy" / "setup.bash").touch()
    monkeypatch.setenv("COMOVE_ROS_PYTHON", sys.executable)
    monkeypatch.setattr("comove.ros.clients.DISTRIBUTIONS", tmp_path)
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    with RosClient() as client:
        fails(client, brief, f"'source {tmp_path}/jazzy/setup.bash' first")


@pytest.mark.slow
def test_when_the_bridge_ends_another_one_stops_all_arms(robot, brief):
    servers, client = robot(left="endless", right="endless")

    def kill():
        for server in servers.values():
            server.wait_for("goal")
        client._bridge.kill()

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
        client._bridge._process.send_signal(signal.SIGSTOP)

    thread = threading.Thread(target=hang)
    thread.start()
    error = fails(client, brief, "joints have said nothing for", silence=0.5)
    thread.join()
    for server in servers.values():
        server.wait_for("stopped", 5.0)
    assert "did not answer" in error.outcome.arms["left"].text


def goals_of(motion):
    """The arms of a motion, and their goals."""
    part = parts_of(motion)["carry"]
    samples = part.samples(100.0)
    return part.arms, {arm: samples.of(names) for arm, names in part.arms.items()}


def end_of(server, timeout=10.0):
    """Whether an arm stopped, or was done."""
    until = time.monotonic() + timeout
    while time.monotonic() < until:
        with suppress(queue.Empty):
            event = server.events.get(timeout=0.1)["event"]
            if event in ("stopped", "done"):
                return event
    return "moves on"


@pytest.mark.parametrize("how", ["cancel", pytest.param("kill", marks=pytest.mark.slow)])
@pytest.mark.parametrize("network", versions(KILTED), indirect=True)
def test_goals_that_are_looked_at_late_are_ended(robot, verified, how):
    """A server that has not looked at a goal does not know it, when it is asked to end it."""
    servers, client = robot(verified.joints, left="late", right="late")
    arms, goals = goals_of(verified)
    client.connect(arms, 10.0)
    client.send(goals, 0.3, BRIEF)
    while not client._is_sent:
        client.state(0.01)
    if how == "kill":
        client._bridge.kill()
    client.cancel()
    assert [end_of(server) for server in servers.values()] == ["stopped", "stopped"]


@pytest.mark.parametrize("network", versions(KILTED), indirect=True)
def test_arms_stop_when_nobody_watches_them(robot, verified):
    """As when comove is stopped by Ctrl-Z: its bridges stay."""
    servers, client = robot(verified.joints)
    arms, goals = goals_of(verified)
    client.connect(arms, 10.0)
    client.send(goals, 0.3, BRIEF)
    for _ in range(20):
        client.state(0.05)
    assert [end_of(server) for server in servers.values()] == ["stopped", "stopped"]


@pytest.mark.slow
@pytest.mark.parametrize("network", versions(KILTED), indirect=True)
def test_old_stamps_stop_all(robot, verified):
    servers, client = robot(verified.joints, right="frozen")
    fails(client, verified, "joints are told with stamps", silence=0.5, path=10.0)
    assert [end_of(server) for server in servers.values()] == ["stopped", "stopped"]


@pytest.mark.slow
@pytest.mark.parametrize("network", versions(KILTED), indirect=True)
def test_without_its_guard_no_arm_moves_on(robot, verified):
    servers, client = robot(verified.joints)

    def kill():
        for server in servers.values():
            server.wait_for("goal")
        client._guard.kill()

    thread = threading.Thread(target=kill)
    thread.start()
    fails(client, verified, "the second bridge to ROS has ended")
    thread.join()
    assert [end_of(server) for server in servers.values()] == ["stopped", "stopped"]


@pytest.mark.slow
@pytest.mark.parametrize("network", versions(KILTED), indirect=True)
def test_arms_do_not_leave_with_grippers_that_jam(robot, verified, transfers):
    _, client = robot(transfers.release, gripper=GRIPPER, left="jammed", right="jammed")
    with pytest.raises(SendError, match=r"the gripper of '.*' gave up: it stalled before it was open"):
        send(client, verified, part="release", transfers=transfers, tolerances=BRIEF)


@pytest.mark.parametrize("ros", versions(KILTED, JAZZY))
def test_a_goal_that_comes_after_its_cancellation_is_ended(ros, monkeypatch):
    """Services keep no order among each other, and a server forgets whom it was asked to end."""
    action, number = ros.action("left"), "ab" * 16
    goal = {"id": number, "joints": ["left_1"], "time": [0, 10**10], "path": [0.0], "end": [0.0], "late": 1.0}
    goal |= {kind: [[0.0], [0.0]] for kind in ("position", "velocity", "acceleration")}
    command = {
        "do": "connect",
        "servers": [action],
        "joint_states": "/joint_states",
        "joints": [],
        "timeout": 10.0,
    }
    command |= {"sim_time": False, "grippers": {}}
    with ros.network() as environment, ros.server("left", {"left_1": 0.0}, environment) as server:
        for key, value in environment.items():
            monkeypatch.setenv(key, value)
        server.wait_for("ready")
        bridges = [BridgeProcess(ros.python, MIDDLEWARES[2].program) for _ in range(2)]
        try:
            for bridge in bridges:
                bridge.tell(command)
            for bridge in bridges:
                assert awaited(bridge, ("connected", "refused"), 30.0, [])["event"] == "connected"
            sender, guard = bridges
            guard.tell({"do": "guard", "ids": {action: number}})
            guard.tell({"do": "cancel"})
            assert awaited(guard, ("cancelled",), 10.0, [])["event"] == "cancelled"
            sender.tell({"do": "send", "delay": 0.1, "goals": {action: goal}})
            for event in ("goal", "cancel", "stopped"):
                server.wait_for(event, 3.0)
        finally:
            for bridge in bridges:
                bridge.close()


@pytest.mark.parametrize("ros", versions(NOETIC, KILTED))
def test_what_breaks_the_bridge_is_told(ros):
    bridge = MIDDLEWARES[ros.version].program
    done = subprocess.run([ros.python, str(bridge)], input="rubbish\n", capture_output=True, text=True)
    assert "Error" in done.stderr.splitlines()[-1]


def test_no_room_for_temporary_files_is_told(brief, monkeypatch):
    def none(*_, **__):
        raise FileNotFoundError(2, "No usable temporary directory found in ['/tmp']")

    monkeypatch.setattr("comove.ros.bridges.tempfile.TemporaryFile", none)
    with Ros1Client() as client:
        fails(client, brief, "No usable temporary directory")


@pytest.mark.slow
def test_when_comove_ends_all_arms_stop(network, robot, brief):
    """Even when it is killed: the input of its bridges ends."""
    ros, environment = network
    servers, _ = robot()
    code = (
        "import sys, time; from comove.ros import JointSamples as Goal, RosClient, Tolerances;"
        "import numpy as np; n = np.arange(3) * 10**10; version, python, *names = sys.argv[1:];"
        "client = RosClient((int(version),), python=python);"
        "arms = {a: tuple(x for x in names if x.startswith(a)) for a in ('left', 'right')};"
        "client.connect(arms, 20.0); goals = {a: Goal(j, n, *3 * [np.zeros((3, 7))]) for a, j in arms.items()};"
        "client.send(goals, 0.1, Tolerances()); time.sleep(60)"
    )
    arguments = [sys.executable, "-c", code, str(ros.version), ros.python, *brief.robot.joint_names]
    with Process(arguments, environment) as comove:
        for server in servers.values():
            server.wait_for("goal", 60.0)
        time.sleep(0.3)
        comove.process.kill()
        killed = time.monotonic()
        for server in servers.values():
            assert server.wait_for("stopped")["at"] - killed < 10 * SOON


@needs_ros1
def test_its_messages_are_those_of_control_msgs():
    """Checksums as in the public headers that ROS generates; other ones would be refused by a robot's servers."""
    code = "import sys; sys.path.insert(0, sys.argv[1]); from ros1_bridge import message_types;"
    code += "print({name: kind._md5sum for name, kind in message_types().items()})"
    done = subprocess.run(
        [NOETIC.python, "-c", code, ROS1.program.parent], capture_output=True, text=True, check=True
    )
    for name, checksum in {
        "FollowJointTrajectoryAction": "bc4f9b743838566551c0390c65f1a248",
        "FollowJointTrajectoryActionGoal": "cff5c1d533bf2f82dd0138d57f4304bb",
        "FollowJointTrajectoryActionResult": "c4fb3b000dc9da4fd99699380efcc5d9",
        "FollowJointTrajectoryActionFeedback": "d8920dc4eae9fc107e00999cce4be641",
    }.items():
        assert f"'control_msgs/{name}': '{checksum}'" in done.stdout


@needs_ros1
@pytest.mark.parametrize("name", ["python2.7", "python3"])
def test_the_bridge_is_for_the_pythons_of_all_ros_1(name, tmp_path):
    python = shutil.which(name)
    if python is None or subprocess.run([python, "-V"], capture_output=True).returncode:
        pytest.skip(f"{name} is not installed")
    copy = shutil.copy(ROS1.program, tmp_path)
    subprocess.run([python, "-m", "py_compile", copy], check=True)
