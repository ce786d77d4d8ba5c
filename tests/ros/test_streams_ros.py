"""Runs streamed over the real ROS 2, on loopback: what stops when what dies."""

import json
import os
import signal
import time

import numpy as np
import pytest

from comove import Scene
from comove.control import Observed
from comove.errors import SendError
from comove.planning.seeds import minimum_jerk
from comove.robots import Robot
from comove.ros.online import await_obstacles, moving_names
from comove.ros.streams import CommandStream, StreamNames, StreamSettings
from tests.ros.robots import JAZZY, KILTED, may_have_hosts
from tests.ros.streaming import (
    CUT,
    FAR,
    FAR_CLOUD,
    FAULTS,
    OBSTACLES,
    bridges_of,
    planned,
    rest_after,
    rows_of,
    running,
    standing,
    wait_until_it_moves,
)
from tests.ros.test_rehearsal import in_network

pytestmark = pytest.mark.slow
EACH = [
    pytest.param(ros, id=ros.name, marks=pytest.mark.skipif(not ros.is_there, reason=f"needs: {ros.install}"))
    for ros in (KILTED, JAZZY)
]


@pytest.fixture(scope="module")
def known(tmp_path_factory):
    return planned(tmp_path_factory.mktemp("streams"))


@pytest.fixture(params=EACH)
def ros(request):
    with in_network(request.param):
        yield request.param


@pytest.fixture
def sink(ros, known):
    with standing(ros, known[2]) as sink:
        yield sink


@pytest.mark.parametrize("around", [FAR, FAR_CLOUD], ids=["poses", "cloud"])
def test_a_run_arrives(ros, known, tmp_path, around):
    scene, folder, plan = known
    with (
        standing(ros, plan, around=around),
        running(ros, scene, folder, tmp_path / "run", ["--obstacles", OBSTACLES]) as process,
    ):
        said, _ = process.communicate(timeout=240)
    assert process.returncode == 0, said
    summary = json.loads((tmp_path / "run" / "robot_run.json").read_text())
    assert summary["arrived"] and summary["executed"] == "ros2" and summary["obstacles"] == "measured"
    assert 3.9 < summary["timing_ms"]["period_p50"] < 4.1


@pytest.mark.parametrize("fault", FAULTS)
def test_arms_stand_when_something_dies(ros, known, tmp_path, fault):
    scene, folder, plan = known
    if fault == CUT and not may_have_hosts():
        pytest.skip("needs network namespaces: iproute2, as root")
    with (
        standing(ros, plan, fault) as sink,
        running(ros, scene, folder, tmp_path / "run", ["--obstacles", OBSTACLES]) as process,
    ):
        wait_until_it_moves(sink, process)
        at = time.monotonic()
        FAULTS[fault](process, sink)
        time.sleep(2.5)
        rest = rest_after(sink, plan, at, at + 2.5)
    assert rest.after < 1.2 and rest.torn < 1e-3 and not rest.moved_on


def test_a_bridge_that_wakes_does_not_jump(ros, known, sink, tmp_path):
    """What it has missed is not played at once: no joint is faster than twice its motion's speed."""
    scene, folder, plan = known
    with running(ros, scene, folder, tmp_path / "run", ["--obstacles", OBSTACLES]) as process:
        wait_until_it_moves(sink, process)
        (bridge,) = bridges_of(process)
        os.kill(bridge, signal.SIGSTOP)
        time.sleep(0.3)
        os.kill(bridge, signal.SIGCONT)
        said, _ = process.communicate(timeout=240)
        rows = rows_of(sink)
    assert process.returncode == 0, said
    assert "the arms braked" in said and " late" in said  # as the bridge says, or comove before it wakes
    fastest = np.abs(plan.joints.curve(np.linspace(0.0, plan.joints.duration, 2000), 1)).max()
    for r in rows.values():
        for since in (5, 20):  # commands
            dt = r[since:, 0] - r[:-since, 0]
            step = np.abs(r[since:, 1:] - r[:-since, 1:]).max(axis=1)
            assert (step <= 2.5 * fastest * (dt + 0.02)).all()


def test_a_controller_has_its_own_order_of_joints(ros, known, tmp_path):
    """That of its parameter "joints" is kept, and other joints are refused."""
    _, _, plan = known
    with standing(ros, plan, reverse=True) as sink:
        with CommandStream(plan.robot, python=ros.python) as stream:
            stream.require_clock()
            stream.begin(stream.position)
            here = stream.position
            wanted = here + 1e-3 * np.arange(len(here))
            for number, share in enumerate(minimum_jerk(np.linspace(0.0, 1.0, 51))[1:]):  # it ends at rest
                stream.follow(0, number, here + share * (wanted - here))
            until = time.monotonic() + 5.0
            while np.abs(stream.position - wanted).max() > 1e-4 and time.monotonic() < until:
                stream.news(0.05)
            np.testing.assert_allclose(stream.position, wanted, atol=1e-4)
        sink.tell(joints=["elsewhere"])
        sink.wait_for("set")
        with pytest.raises(SendError, match="moves elsewhere, other joints than the arm"):
            CommandStream(plan.robot, python=ros.python)


def test_a_cloud_that_does_not_show_the_obstacle(ros, known):
    scene, robot = Scene.load(known[0]), Robot.load("two_ur10")
    names, settings = StreamNames(obstacles=OBSTACLES), StreamSettings(connect=3.0)
    elsewhere = {**FAR_CLOUD, "centers": [[0.7, 4.0, 0.3]]}
    with standing(ros, known[2], around=elsewhere):
        stream = CommandStream(
            robot, names, settings, obstacles=moving_names(scene), scene=scene, python=ros.python
        )
        with stream, pytest.raises(SendError, match=r"where 'cart.*' is: 0 points show it") as found:
            await_obstacles(stream, Observed(scene), settings.connect)
        assert "about where the scene has it" in found.value.way_out
        begun = time.monotonic()
        stream.close()
        assert time.monotonic() - begun < 5.0
        frame = StreamNames(obstacles=OBSTACLES, frame="camera")
        stream = CommandStream(
            robot, frame, settings, obstacles=moving_names(scene), scene=scene, python=ros.python
        )
        with stream, pytest.raises(SendError, match="in the frame 'world', and the scene is in 'camera'"):
            await_obstacles(stream, Observed(scene), settings.connect)


def test_nobody_listens_and_the_wrong_type(ros, known, sink):
    robot = Robot.load("two_ur10")
    quick = StreamSettings(connect=2.0)
    with pytest.raises(SendError, match="nobody listens to '/nowhere/commands'") as found:
        CommandStream(robot, StreamNames("/nowhere/commands"), quick, python=ros.python)
    assert "/left_position_controller/commands" in str(found.value)
    with pytest.raises(SendError, match="nobody tells obstacles on '/none'"):
        CommandStream(robot, StreamNames(obstacles="/none"), quick, obstacles={1: "cart"}, python=ros.python)
    with pytest.raises(SendError, match="has messages of type sensor_msgs/msg/JointState"):
        CommandStream(
            robot, StreamNames(obstacles="/joint_states"), quick, obstacles={1: "cart"}, python=ros.python
        )
    with pytest.raises(SendError, match="says nothing of a joint"):
        CommandStream(robot, StreamNames(joint_states="/no_states"), quick, python=ros.python)
    with pytest.raises(SendError, match="ROS takes no name"):
        CommandStream(robot, StreamNames("/a b"), quick, python=ros.python)


def test_one_commands_an_arm(ros, known, sink):
    robot = Robot.load("two_ur10")
    one = CommandStream(robot, StreamNames(), python=ros.python)
    with one, pytest.raises(SendError, match="other nodes command"):
        CommandStream(robot, StreamNames(), StreamSettings(connect=2.0), python=ros.python)
