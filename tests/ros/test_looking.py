"""`comove doctor --ros 2`, and the commands of the pages on ROS, with real controllers on loopback."""

import json
import re
import shlex
from contextlib import ExitStack
from pathlib import Path

import pytest

from comove.errors import SendError
from comove.robots import Robot, verify_stored
from comove.ros.looking import look
from tests.commands import invoke
from tests.ros.robots import KILTED
from tests.ros.test_robots import versions

DOCS = Path(__file__).parents[2] / "docs"
JOINTS = {"left": {"left_1": 0.1, "left_2": 0.2}, "right": {"right_1": 0.0}}


@pytest.fixture
def start(monkeypatch):
    """Starts the arms of a robot in Kilted, given their joints by arm; comove finds its Python."""
    with ExitStack() as running:
        environment = running.enter_context(KILTED.network())
        for key, value in {**environment, "COMOVE_ROS_PYTHON": KILTED.python}.items():
            monkeypatch.setenv(key, value)

        def start(joints, **options):
            for arm, position in joints.items():
                server = running.enter_context(KILTED.server(arm, position, environment, **options))
                server.wait_for("ready")

        yield start


@pytest.mark.parametrize("ros", versions(KILTED))
def test_controllers_and_joints_are_told(ros, start):
    start(JOINTS)
    found = look(seconds=2.0)
    assert [server.action for server in found.servers] == [KILTED.action(arm) for arm in ("left", "right")]
    assert all(0.0 < server.answer < 2.0 and not server.busy for server in found.servers)
    assert set(found.joints) == {"left_1", "left_2", "right_1"}
    assert found.nodes == ("/arm_left", "/arm_right") and not found.conflict
    assert 20.0 < found.rate < 250.0  # of both, at 100 Hz each
    assert abs(found.age[0]) < 1.0 and found.middleware == "rmw_fastrtps_cpp"


@pytest.mark.parametrize("ros", versions(KILTED))
def test_a_joint_of_two_nodes_is_told(ros, start):
    start({"left": {"shared": 0.1}, "right": {"shared": 0.2}})
    assert look(seconds=2.0).conflict == "shared"


@pytest.mark.parametrize("ros", versions(KILTED))
def test_doctor_tells_in_words_and_as_json(ros, start):
    start({"left": {"left_1": 0.1}})
    told = json.loads(invoke("doctor", "--ros", "2", "--json").stdout)
    assert told["servers"][0]["action"] == KILTED.action("left") and told["joints"] == ["left_1"]


def test_without_ros_doctor_says_what_is_missing(monkeypatch):
    monkeypatch.setenv("COMOVE_ROS_PYTHON", "/no/such/python")
    with pytest.raises(SendError, match="no Python here has ROS 2"):
        look()
    assert invoke("doctor", "--ros", "2").exit_code == 2
    for words in (("--ros", "1"), ("--joint-states", "/joint_states")):
        refused = invoke("doctor", *words)
        assert refused.exit_code == 2 and "give --ros 2" in refused.stderr


def test_doctor_tells_what_is_installed():
    assert re.search(r"robots +pin \d", invoke("doctor").stdout)


@pytest.mark.slow
@pytest.mark.parametrize("ros", versions(KILTED))
def test_the_commands_of_the_page_move_a_robot(ros, start, tmp_path, monkeypatch):
    """In their order: the approach from home ends where the carry begins, which ends where the release begins."""
    monkeypatch.chdir(tmp_path)
    scene = Path(__file__).parents[2] / "examples" / "robots" / "two_ur10.yaml"
    assert invoke("solve", scene, "--out", "carried", "--no-pictures").exit_code == 0
    robot: Robot = verify_stored("carried").verified.robot
    start({arm.name: {robot.joint_names[c]: float(robot.home[c]) for c in arm.columns} for arm in robot.arms})
    page = (DOCS / "ros.md").read_text(encoding="utf-8")
    lines = [
        line
        for block in re.findall(r"^```bash\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
        for line in block.splitlines()
    ]
    assert sum("comove send" in line for line in lines) == 3
    for line in lines:
        done = invoke(*shlex.split(line)[1:])
        assert done.exit_code == 0, done.stderr
