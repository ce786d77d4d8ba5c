"""`comove serve` behind the real ROS 2, on loopback, asked by a client of MoveIt's action that is not comove's."""

import json
import math
import os
import signal
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import yaml

from comove.model.files.moveit import planning_scene_in
from comove.ros.planning_requests import ErrorCode
from tests.commands import invoke
from tests.ros.planning_goals import BAR, LEFT, RIGHT, Cell, box, joint_goal, moved, posed
from tests.ros.robots import Process
from tests.ros.test_rehearsal import ABORTED, CANCELED, EACH, LOAD, SUCCEEDED, Command, in_network, is_running

CLIENT = Path(__file__).with_name("ros2_planning_client.py")
RIGID = 1e-4  # m and rad, by which the pose of one hand in the other may change
CHANGE = {"is_diff": True, "robot_state": {"is_diff": True}}
READY = "ready; Ctrl-C ends it", 300.0  # s, as kernels may have to be compiled


@pytest.fixture(scope="module")
def cell():
    return Cell()


@pytest.fixture(scope="module", params=EACH)
def network(request):
    with in_network(request.param):
        yield request.param


@pytest.fixture
def alone(network):
    """A version of ROS, with a network in which nobody else is."""
    with in_network(network):
        yield network


def client(ros, folder, **scenario):
    """The command of a client, and its environment."""
    file = folder / f"scenario_{time.monotonic_ns()}.json"
    file.write_text(json.dumps(scenario))
    return [ros.python, str(CLIENT), str(file)]


@contextmanager
def told(ros, folder, **scenario):
    """A stand-in for move_group that tells planning scenes."""
    with Process(client(ros, folder, stay=True, **scenario), {}) as process:
        process.wait_for("ready", 30.0)
        yield process


def ask(ros, folder, *goals, **each):
    """The results of goals that are sent at once, in their order."""
    given = [{"goal": goal, **each} for goal in goals]
    environment = {k: v for k, v in os.environ.items() if k != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    done = subprocess.run(
        client(ros, folder, goals=given), capture_output=True, text=True, env=environment, timeout=120
    )
    events = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    found = {event["goal"]: event for event in events if event["event"] == "result"}
    assert len(found) == len(goals), (events, done.stderr[-2000:])
    for event in events:
        if event["event"] == "feedback":
            found[event["goal"]].setdefault("states", []).append(event["state"])
    return [found[number] for number in range(len(goals))]


def serving(ros, *options):
    return Command(ros, "serve", "--ros", "2", "--robot", "two_pandas", *options)


@pytest.fixture(scope="module")
def served(network, cell, tmp_path_factory):
    """A function that returns the results of goals, from a server among the scene that a service tells."""
    folder = tmp_path_factory.mktemp("served")
    with told(network, folder, service=cell.scene()), serving(network) as command:
        command.wait_for(*READY)
        yield lambda *goals, **each: ask(network, folder, *goals, **each)
        assert command.process.poll() is None, "no request ends the server"


def by_name(result, row):
    return dict(zip(result["joints"], result["position"][row], strict=True))


def bar_at(cell, joints):
    """The pose of the bar in the left hand, by Pinocchio."""
    in_hand = np.linalg.inv(cell.link_pose(LEFT)) @ cell.bar
    return cell.link_pose(LEFT, joints) @ in_hand


def require_motion(cell, result, target):
    """Numbers of a trajectory, by Pinocchio and coal: it starts and ends where it should, and holds the bar."""
    assert (result["status"], result["code"]) == (SUCCEEDED, ErrorCode.SUCCESS), result["text"]
    assert result["text"].startswith("verified: ")
    start = {name: cell.joints[name] for name in result["joints"]}
    assert result["start"] == pytest.approx(cell.joints, abs=1e-5)
    assert by_name(result, 0) == pytest.approx(start, abs=1e-5)
    assert bar_at(cell, by_name(result, -1)) == pytest.approx(target, abs=RIGID)
    kept = np.linalg.inv(cell.link_pose(LEFT)) @ cell.link_pose(RIGHT)
    for row in range(len(result["time"])):
        joints = by_name(result, row)
        other = np.linalg.inv(cell.link_pose(LEFT, joints)) @ cell.link_pose(RIGHT, joints)
        assert other == pytest.approx(kept, abs=RIGID)
        assert clearance(bar_at(cell, joints)) > 0.0
    time, position, velocity = (np.array(result[key]) for key in ("time", "position", "velocity"))
    columns = [cell.robot.joint_names.index(name) for name in result["joints"]]
    assert time[0] == 0.0 and (np.diff(time) > 0).all()
    assert np.abs(velocity[[0, -1]]).max() < 1e-9, "it starts and ends at rest"
    assert (np.abs(velocity) <= cell.robot.velocity[columns] * (1 + 1e-9)).all()
    mean = 0.5 * (velocity[1:] + velocity[:-1])
    steps = np.diff(time)[:, None]
    assert np.diff(position, axis=0) / steps == pytest.approx(mean, abs=0.01), (
        "velocities are those of positions"
    )


def clearance(bar):
    """Distance of the bar from table and post [m]."""
    import coal

    def placed(at):
        return coal.Transform3s(at[:3, :3], at[:3, 3])

    least = math.inf
    for size, at in (([2, 2, 0.1], (0.5, 0, -0.06)), ([0.05, 0.05, 0.3], (0.75, 0, 0.15))):
        where = np.eye(4)
        where[:3, 3] = at
        one, other = coal.Box(*BAR[0]), coal.Box(*map(float, size))
        least = min(
            least,
            coal.distance(
                one, placed(bar), other, placed(where), coal.DistanceRequest(), coal.DistanceResult()
            ),
        )
    return least


def test_a_motion_is_planned_for_a_client(cell, served):
    target = moved(cell.bar, 0.05, 0.0, 0.1)
    (result,) = served(cell.goal(target))
    require_motion(cell, result, target)
    assert result["states"] == ["PLANNING", "IDLE"]


@pytest.mark.slow
def test_requests_at_once_are_answered_one_after_the_other(cell, served):
    """The same request has the same answer; what is asked for in another frame, and by a hand, is as well."""
    target = moved(cell.bar, 0.05, 0.0, 0.1)
    hand = moved(cell.link_pose(LEFT), 0.05, 0.0, 0.1)
    elsewhere = cell.goal(goal_constraints=[posed(moved(target, 0.0, 0.0, -1.0), "bar", "cell")])
    results = served(cell.goal(target), cell.goal(target), elsewhere, cell.goal(hand, LEFT))
    for result in results:
        require_motion(cell, result, target)
    assert results[0]["position"] == results[1]["position"]


@pytest.mark.slow
def test_joints_of_a_start_state_and_objects_of_a_request_count(cell, served):
    """A changed start is where the trajectory starts, and a box at the goal is in the way."""
    free = served(cell.goal())[0]
    back = cell.goal(goal_constraints=[joint_goal(cell.joints, 1e-3)])
    names, last = free["joints"], free["position"][-1]
    back["request"]["start_state"] = {"joint_state": {"name": names, "position": last}, "is_diff": True}
    (result,) = served(back)
    assert result["code"] == ErrorCode.SUCCESS, result["text"]
    assert by_name(result, 0) == pytest.approx(by_name(free, -1), abs=1e-5)
    assert by_name(result, -1) == pytest.approx({name: cell.joints[name] for name in names}, abs=1e-3)
    goal = cell.goal()
    crate = box("crate", [0.06, 0.06, 0.06], moved(cell.bar, 0.05, 0.0, 0.1))
    goal["planning_options"]["planning_scene_diff"] = {**CHANGE, "world": {"collision_objects": [crate]}}
    refused, later = served(goal, cell.goal())
    assert refused["code"] == ErrorCode.GOAL_IN_COLLISION and "crate" in refused["text"]
    assert later["code"] == ErrorCode.SUCCESS, "a change belongs to its request"


@pytest.mark.slow
def test_what_cannot_be_met_is_refused_and_the_next_request_is_answered(cell, served):
    bare = cell.goal()
    bare["planning_options"]["planning_scene_diff"] = cell.scene(attached=False)
    executed = {**cell.goal(), "planning_options": {"plan_only": False}}
    cases = {
        "far": (cell.goal(moved(cell.bar, 3.0)), "NO_IK_SOLUTION", "cannot reach its goal"),
        "group": (cell.goal(group_name="arms"), "INVALID_GROUP_NAME", "name one of: two_pandas"),
        "frame": (
            cell.goal(goal_constraints=[posed(cell.bar, "bar", "map")]),
            "FRAME_TRANSFORM_FAILURE",
            "the frame 'map' is unknown, or moves; give the goal in one of: 'world', 'cell'",
        ),
        "executed": (executed, "CONTROL_FAILED", "set planning_options.plan_only to true"),
        "no payload": (bare, "INVALID_OBJECT_NAME", "attach it to one hand"),
        "no time": (impossible(cell, 2.0), "TIMED_OUT", "no motion was verified"),
        "no number": (
            cell.goal(moved(cell.bar, math.nan)),
            "INVALID_GOAL_CONSTRAINTS",
            "not a finite number",
        ),
    }
    *results, last = served(*(goal for goal, _, _ in cases.values()), cell.goal())
    for (what, (_, code, words)), result in zip(cases.items(), results, strict=True):
        assert ErrorCode(result["code"]).name == code, (what, result["text"])
        assert words in result["text"] and result["status"] == ABORTED
        assert result["position"] == [] and result["joints"] == []
    assert last["code"] == ErrorCode.SUCCESS


def impossible(cell, seconds=120.0):
    """A goal within a closed ring, into which no bar gets whose ends are held: the search ends with its time."""
    target = moved(cell.bar, 0.05, 0.0, 0.2)
    goal = cell.goal(target, allowed_planning_time=seconds)
    sides = {"above": (0.0, 0.07), "below": (0.0, -0.07), "before": (0.07, 0.0), "behind": (-0.07, 0.0)}
    ring = [
        box(name, [0.02, 0.04, 0.16] if x else [0.16, 0.04, 0.02], moved(target, x, 0.0, z))
        for name, (x, z) in sides.items()
    ]
    goal["planning_options"]["planning_scene_diff"] = {**CHANGE, "world": {"collision_objects": ring}}
    return goal


@pytest.mark.slow
def test_a_request_is_cancelled_while_it_is_planned_and_ctrl_c_ends_the_server(alone, cell, tmp_path):
    """Among the scene that a topic has kept; a client that waits is told of the end."""
    with (
        told(alone, tmp_path, scenes={"/cell/scene": [cell.scene()]}),
        serving(alone, "--topic", "/cell/scene") as command,
    ):
        command.wait_for(*READY)
        (cancelled,) = ask(alone, tmp_path, impossible(cell), cancel=3.0)
        assert (cancelled["status"], cancelled["code"]) == (CANCELED, ErrorCode.PREEMPTED), cancelled["text"]
        assert 2.9 < cancelled["seconds"] < 3.0 + 2.0 * LOAD and cancelled["position"] == []
        (planned,) = ask(alone, tmp_path, cell.goal())
        assert planned["status"] == SUCCEEDED
        with Process(client(alone, tmp_path, goals=[{"goal": impossible(cell)}]), {}) as waiting:
            waiting.wait_for("feedback", 30.0)
            child = command.child()
            time.sleep(1.0)
            command.process.send_signal(signal.SIGINT)
            result = waiting.wait_for("result", 2.0 + 2.0 * LOAD)
        code, words = command.end()
    assert result["status"] == ABORTED and result["position"] == [], (words, result["text"])
    assert code == 0, words
    assert not is_running(child) and "Traceback" not in words


@pytest.mark.slow
@pytest.mark.parametrize("how", ["SIGTERM", "SIGKILL", "the other process"])
def test_the_end_of_either_process_ends_both(alone, how):
    with serving(alone) as command:
        command.wait_for(*READY)
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
    assert code == {"SIGTERM": 143, "SIGKILL": -9, "the other process": 1}[how]
    assert ("the interfaces of ROS ended" in words) == (how == "the other process")


@pytest.mark.slow
@pytest.mark.parametrize("how", ["topic", "service"])
def test_a_scene_is_imported_as_it_is_now(alone, cell, tmp_path, monkeypatch, how):
    """From a topic that keeps it, and from the service of move_group."""
    monkeypatch.setenv("COMOVE_ROS_PYTHON", alone.python)
    scene, out = cell.scene(), tmp_path / "now.yaml"
    by = {"scenes": {"/cell/scene": [scene]}} if how == "topic" else {"service": scene}
    options = ["--topic", "/cell/scene"] if how == "topic" else []
    target = moved(cell.bar, 0.05, 0.0, 0.1)
    with told(alone, tmp_path, **by):
        done = invoke(
            *("scene", "import", "--ros", "2", "--robot", "two_pandas", *options, "--out", out),
            *("--goal-position", *target[:3, 3].tolist()),
        )
    assert done.exit_code == 0, done.output
    recorded = planning_scene_in(out.with_suffix(".mcap"))
    assert {name: recorded.joints[name] for name in cell.joints} == pytest.approx(cell.joints, abs=0)
    payload = yaml.safe_load(out.read_text())["payload"]
    assert payload["start"]["position"] == pytest.approx(cell.bar[:3, 3], abs=1e-6)
    present = yaml.safe_load(out.with_name("now-present.yaml").read_text())
    assert {name: present[name] for name in cell.joints} == pytest.approx(cell.joints, abs=1e-9)


@pytest.mark.slow
def test_without_a_scene_the_topics_that_there_are_are_told(alone, cell, tmp_path, monkeypatch):
    """The advice, followed, works."""
    monkeypatch.setenv("COMOVE_ROS_PYTHON", alone.python)
    words = ["scene", "import", "--ros", "2", "--robot", "two_pandas", "--shift", "0", "0", "0.1"]
    with told(alone, tmp_path, scenes={"/cell/scene": [cell.scene()]}):
        refused = invoke(*words, "--out", tmp_path / "a.yaml")
        assert refused.exit_code == 2 and "give another one: --topic /cell/scene" in refused.output.replace(
            "\n", " "
        )
        assert not [*tmp_path.glob("a*")]
        done = invoke(*words, "--out", tmp_path / "a.yaml", "--topic", "/cell/scene")
    assert done.exit_code == 0, done.output


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--ros", "1"), "--ros: MoveIt 2 is of ROS 2, not of ROS 1; give 2"),
        (("--budget", "0"), "--budget: 0.0 is not possible"),
        (("--budget", "nan"), "--budget: nan is not possible"),
        (("--rate", "0"), "--rate: 0.0 Hz are not possible"),
        (("--scene", "none.scene"), "none.scene"),
        (("--srdf", "none.srdf"), "none.srdf"),
    ],
)
def test_options_that_do_not_fit_are_told(options, message, tmp_path):
    done = invoke("serve", "--robot", "two_pandas", *options, folder=tmp_path)
    assert done.exit_code == 2 and message in done.output
