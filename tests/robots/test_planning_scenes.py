"""Scenes made of planning scenes are those that MoveIt has: poses, grasps, joints, and what may touch."""

import re
import shlex

import numpy as np
import pinocchio as pin
import pytest
import yaml
from scipy.spatial.transform import Rotation

from comove import solve
from comove.errors import InputError
from comove.model import Scene
from comove.robots import Robot, RobotCarrier
from comove.robots.planning_scenes import Goal, ImportOptions, scene_from
from tests.commands import invoke
from tests.model.files.planning_scenes import OBJECT, SCENE, Messages

pytest.importorskip("rosbags")

LINK, OTHER = "left_panda_hand", "right_panda_hand"
SHIFT = ["--shift", "0.05", "0", "0.1"]
TABLE = ("table", [("box", [2, 2, 0.1])], ([0.5, 0, -0.06], [0, 0, 0, 1]))
POST = ("post", [("cylinder", [0.3, 0.05])], ([0.6, 0, 0.15], [0, 0, 0, 1]))


@pytest.fixture(scope="module")
def messages():
    return Messages()


@pytest.fixture(scope="module")
def pandas():
    return Robot.load("two_pandas")


@pytest.fixture(scope="module")
def joints(pandas):
    """Home but for two joints, with fingers, as MoveIt publishes them."""
    q = dict(zip(pandas.joint_names, pandas.home.tolist(), strict=True))
    q |= {"left_panda_joint1": 0.1, "right_panda_joint7": 0.7}
    return q | {f"{side}_panda_finger_joint{i}": 0.02 for side in ("left", "right") for i in (1, 2)}


def link_pose(pandas, joints, link):
    """The pose of a link, by Pinocchio."""
    data = pandas.model.createData()
    q = np.array([joints[name] for name in pandas.joint_names])
    pin.framesForwardKinematics(pandas.model, data, q)
    return data.oMf[pandas.model.getFrameId(link, pin.FrameType.BODY)].homogeneous


def as_pose(matrix):
    return matrix[:3, 3], Rotation.from_matrix(matrix[:3, :3]).as_quat()


@pytest.fixture(scope="module")
def bar(pandas, joints):
    """The pose of a bar between both hands in the scene."""
    pose, (left, right) = np.eye(4), (link_pose(pandas, joints, link) for link in (LINK, OTHER))
    pose[:3, 3] = (left[:3, 3] + right[:3, 3]) / 2 - [0, 0, 0.1]
    pose[:3, :3] = Rotation.from_euler("z", 0.02).as_matrix()
    return pose


@pytest.fixture
def cell(messages, pandas, joints, bar, tmp_path):
    """A bag in which both hands hold a bar, which is given in the left one's frame as MoveIt gives it."""
    there = np.linalg.inv(link_pose(pandas, joints, LINK)) @ bar
    held = messages.object("bar", [("box", [0.04, 0.9, 0.04])], as_pose(there), frame=LINK)
    attached = messages.attached(LINK, held, ["left_panda_leftfinger", OTHER], 0.7)
    pairs = [("bar", "table"), (LINK, "bar"), (OTHER, "bar"), ("left_panda_link0", "table")]
    pairs += [("post", "left_panda_link5"), ("post", "table"), ("bar", "right_panda_link0")]
    scene = messages.scene(
        [messages.object(*TABLE), messages.object(*POST)],
        joints=joints,
        attached=[attached],
        allowed=(pairs, ["floor"]),
    )
    return messages.bag(tmp_path / "cell.mcap", [("/monitored_planning_scene", SCENE, scene)], storage="MCAP")


def imported(cell, *more):
    done = invoke("scene", "import", cell, "--robot", "two_pandas", *more)
    return done.exit_code, done.output if done.exit_code else done.stdout


def test_an_attached_object_is_the_payload_where_it_is_held(cell, pandas, joints, bar, tmp_path):
    """Grasps and start give the hands the places that the joints give them; the goal is the shifted start."""
    out = tmp_path / "scene.yaml"
    code, told = imported(cell, *SHIFT, "--out", out)
    assert code == 0, told
    scene = Scene.load(out)
    start, goal = scene.file.load.start, scene.file.load.goal
    assert start.position == pytest.approx(bar[:3, 3], abs=1e-9)
    assert goal.position == pytest.approx(bar[:3, 3] + [0.05, 0, 0.1], abs=1e-9)
    assert abs(np.dot(start.quaternion_wxyz, goal.quaternion_wxyz)) == pytest.approx(1)
    q = np.array([joints[name] for name in pandas.joint_names])
    hands = scene.nodes_at("start")
    for i, name in enumerate(scene.manipulators):
        wanted = pandas.tool_pose(q, pandas.arm(name))
        assert hands[i] == pytest.approx(wanted[:3, 3], abs=1e-9)
        turn = scene.alternatives[0].grasp.hand_rotations(hands)[i]
        assert turn == pytest.approx(wanted[:3, :3], abs=1e-9)
    assert (scene.file.load.size, scene.file.load.mass) == ((0.04, 0.9, 0.04), 0.7)
    assert [obstacle.name for obstacle in scene.file.obstacles] == ["table", "post"]
    present = yaml.safe_load((tmp_path / "scene-present.yaml").read_text())
    assert present == pytest.approx({name: joints[name] for name in pandas.joint_names})


def test_what_has_no_place_in_a_scene_is_told(cell, tmp_path):
    """Contacts that comove keeps apart, and nothing of those that it allows as well."""
    _, told = imported(cell, *SHIFT, "--out", tmp_path / "scene.yaml")
    told = " ".join(told.split())
    assert "lets touch what comove keeps apart" in told and "'left_panda_link5' and 'post'" in told
    assert "'bar' and 'right_panda_link0'" in told, "the payload keeps clear of all links but its hands'"
    assert "'left_panda_link0' and 'table'" not in told, "links that do not move may touch obstacles"
    assert "'post' and 'table'" not in told, "obstacles are not compared with each other"
    assert "lets everything touch 'floor'" in told
    assert "does not rest on: table" in told
    assert "the planning frame 'world' is taken for the scene's own" in told
    printed = invoke("scene", "import", cell, "--robot", "two_pandas", *SHIFT)
    assert "lets everything touch 'floor'" in printed.stderr and "floor" not in printed.stdout
    assert "joints are written beside the scene" in " ".join(printed.stderr.split())


def test_the_command_that_is_told_next_finds_a_motion_from_the_joints(
    cell, pandas, joints, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    _, told = imported("cell.mcap", *SHIFT, "--out", "scene.yaml")
    command = re.search(r"next +comove (.*)", told)[1]
    assert command == "solve scene.yaml --present scene-present.yaml --out carried"
    present = yaml.safe_load((tmp_path / "scene-present.yaml").read_text())
    found = solve(Scene.load("scene.yaml"), effort="quick", begin=present)
    assert found.verified
    assert found.joints.motion.joints.position[0] == pytest.approx([*present.values()], abs=1e-6)


@pytest.mark.slow
def test_the_command_that_is_told_next_works(cell, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _, told = imported("cell.mcap", *SHIFT, "--out", "scene.yaml")
    done = invoke(*shlex.split(re.search(r"next +comove (.*)", told)[1]))
    assert done.exit_code == 0, done.output


def test_a_scene_without_a_goal_is_not_written(cell, tmp_path):
    out = tmp_path / "scene.yaml"
    code, told = imported(cell, "--out", out)
    assert code == 2 and "holds no goal" in told and not [*tmp_path.glob("*.yaml")]
    advised = re.search(r"(--shift [\d. ]+)", told)[1].split()
    assert imported(cell, *advised, "--out", out)[0] == 0, "the advice works"
    code, told = imported(cell, *SHIFT, "--goal-position", 0, 0, 0)
    assert code == 2 and "given twice" in told


def test_a_goal_by_position_and_orientation(cell, bar):
    _, told = imported(cell, "--goal-position", 0.4, 0.1, 0.6, "--goal-rpy-deg", 0, 0, 20)
    goal = yaml.safe_load(told)["payload"]["goal"]
    assert goal["position"] == [0.4, 0.1, 0.6]
    turn = Rotation.from_quat(goal["quaternion_wxyz"], scalar_first=True)
    assert turn.as_euler("xyz", degrees=True) == pytest.approx([0, 0, 20], abs=1e-9)
    _, told = imported(cell, "--goal-position", 0.4, 0.1, 0.6)
    goal, start = (yaml.safe_load(told)["payload"][end] for end in ("goal", "start"))
    assert goal["quaternion_wxyz"] == start["quaternion_wxyz"]


def bag_of(messages, path, objects, **more):
    scene = messages.scene(objects, **more)
    return messages.bag(path, [("/monitored_planning_scene", SCENE, scene)])


def test_an_object_in_the_world_is_carried_if_it_is_named(messages, tmp_path):
    """With proposed grasps, and no obstacle any more."""
    box = ("box", [("box", [0.05, 0.5, 0.05])], ([0.45, 0, 0.3], [0, 0, 0, 1]))
    path = bag_of(messages, tmp_path / "bag", [messages.object(*TABLE), messages.object(*box)])
    code, told = imported(path, *SHIFT)
    assert code == 2 and "nothing is attached" in told and "--payload NAME (it holds table, box)" in told
    code, told = imported(path, *SHIFT, "--payload", "boxx")
    assert code == 2 and "did you mean 'box'" in told
    code, told = imported(path, *SHIFT, "--payload", "box")
    data = yaml.safe_load(told)
    assert code == 0 and data["grasps"] == "auto" and data["payload"]["start"]["position"] == [0.45, 0.0, 0.3]
    scene = Scene.from_dict(data, folder=tmp_path)
    assert [obstacle.name for obstacle in scene.file.obstacles] == ["table"]


def test_the_payload_has_the_frame_of_its_only_shape(messages, tmp_path):
    """Wherever that is in the object."""
    half = Rotation.from_euler("z", 90, degrees=True).as_quat()
    shape = ("box", [0.5, 0.05, 0.05], ([0.1, 0, 0.2], half))
    path = bag_of(
        messages, tmp_path / "bag", [messages.object("box", [shape], ([0.35, 0, 0.1], [0, 0, 0, 1]))]
    )
    code, told = imported(path, *SHIFT, "--payload", "box")
    payload = yaml.safe_load(told)["payload"]
    assert code == 0 and payload["shape"] == "box"
    assert payload["start"]["position"] == pytest.approx([0.45, 0, 0.3])
    turn = Rotation.from_quat(payload["start"]["quaternion_wxyz"], scalar_first=True)
    assert turn.as_euler("xyz", degrees=True) == pytest.approx([0, 0, 90])


def test_a_payload_that_rests_on_what_it_may_touch(messages, tmp_path):
    """The matrix makes a support of the table, under whatever name it has."""
    box = ("box", [("box", [0.05, 0.5, 0.05])], ([0.45, 0, 0.025], [0, 0, 0, 1]))
    top = ("my table/top", [("box", [2, 2, 0.1])], ([0.5, 0, -0.05], [0, 0, 0, 1]))
    pairs = ([("box", "my table/top")], [])
    path = bag_of(messages, tmp_path / "bag", [messages.object(*top), messages.object(*box)], allowed=pairs)
    code, told = imported(path, *SHIFT, "--payload", "box")
    assert code == 0, told
    data = yaml.safe_load(told)
    assert data["obstacles"][0]["supports"] == ["my table/top"]
    assert [rest.obstacle for rest in Scene.from_dict(data, folder=tmp_path).rests] == [0]


def test_the_planning_frame_may_be_a_link_of_the_robot(messages, pandas, joints, tmp_path):
    """Then everything is where that link is in the scene."""
    box = messages.object(
        "box", [("box", [0.05, 0.5, 0.05])], ([0.45, -0.4, 0.3], [0, 0, 0, 1]), frame="left_panda_link0"
    )
    post = messages.object(
        "post", [("sphere", [0.05])], ([0.5, -1.0, 0.6], [0, 0, 0, 1]), frame="left_panda_link0"
    )
    path = messages.bag(tmp_path / "bag", [("/collision_object", OBJECT, one) for one in (box, post)])
    code, told = imported(path, *SHIFT, "--payload", "box")
    assert code == 0, told
    data = yaml.safe_load(told)
    base = link_pose(pandas, joints, "left_panda_link0")
    assert data["payload"]["start"]["position"] == pytest.approx(base[:3, 3] + [0.45, -0.4, 0.3])
    (ball,) = Scene.from_dict(data, folder=tmp_path).file.obstacles
    assert ball.center == pytest.approx(base[:3, 3] + [0.5, -1.0, 0.6])


def test_shapes_of_payloads(messages, tmp_path):
    """Several shapes are parts, spheres bars without length, meshes files beside the scene."""
    corners = [(x, y, z) for x in (0, 0.05) for y in (-0.2, 0.2) for z in (0, 0.05)]
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    shapes = [
        ("mesh", (corners, faces)),
        ("sphere", [0.03], ([0, 0.1, 0], [0, 0, 0, 1])),
        ("cylinder", [0.3, 0.02], ([0, 0, 0.1], [0.5, 0.5, 0.5, 0.5])),
    ]
    whole = messages.object("odd one", shapes, ([0.45, 0, 0.3], [0, 0, 0, 1]))
    path = bag_of(messages, tmp_path / "bag", [whole, messages.object(*POST)])
    code, told = imported(path, *SHIFT, "--payload", "odd one")
    assert code == 2 and "meshes are written beside the scene" in told
    out = tmp_path / "scene.yaml"
    code, told = imported(path, *SHIFT, "--payload", "odd one", "--out", out)
    assert code == 0, told
    ball, can, mesh = yaml.safe_load(out.read_text())["payload"]["parts"]
    assert mesh == {"shape": "mesh", "file": "scene-odd_one.off"} and (tmp_path / mesh["file"]).is_file()
    assert ball["shape"] == "bar" and ball["radius"] == 0.03 and ball["length"] < 1e-4
    assert (can["height"], can["radius"]) == (0.3, 0.02)
    again = imported(path, *SHIFT, "--payload", "odd one", "--out", out)
    assert again[0] == 2 and "there already" in again[1]
    plane = messages.object("floor", [("plane", [0, 0, 1, 0])])
    code, told = imported(bag_of(messages, tmp_path / "flat", [plane]), *SHIFT, "--payload", "floor")
    assert code == 2 and "'floor' is a plane" in told


def test_what_fails_leaves_nothing_behind(messages, tmp_path):
    """Neither meshes nor joints, where the scene cannot be."""
    flat = ([(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0)], [(0, 1, 2)])
    sheet = messages.object("sheet", [("mesh", flat)], ([0.45, 0, 0.3], [0, 0, 0, 1]))
    path = bag_of(messages, tmp_path / "bag", [sheet])
    code, _ = imported(path, *SHIFT, "--payload", "sheet", "--out", tmp_path / "scene.yaml")
    assert code == 2 and sorted(one.name for one in tmp_path.iterdir()) == ["bag"]


def test_a_file_elsewhere_is_refused(cell, tmp_path):
    (tmp_path / "other").mkdir()
    code, told = imported(cell, *SHIFT, "--out", tmp_path / "other" / "scene.yaml")
    assert code == 2 and "not in the scene's folder" in told
    advised = re.search(r"--out (\S+)", told)[1]
    assert imported(cell, *SHIFT, "--out", advised)[0] == 0, "the advice works"


def test_further_attached_objects_and_octomaps_are_left_out_by_name(messages, pandas, joints, tmp_path):
    box = [("box", [0.02, 0.02, 0.02])]
    attached = [messages.attached(LINK, messages.object(name, box, frame=LINK)) for name in ("a", "b c")]
    path = bag_of(
        messages, tmp_path / "bag", [messages.object(*TABLE)], joints=joints, attached=attached, octomap=b"\1"
    )
    code, told = imported(path, *SHIFT)
    assert code == 2 and "b c is attached to the robot besides the payload 'a'" in " ".join(told.split())
    code, told = imported(path, *SHIFT, "--leave-out", "b c")
    assert code == 2 and "--leave-out '<octomap>'" in told
    code, told = imported(path, *SHIFT, "--leave-out", "b c", "--leave-out", "<octomap>")
    data = yaml.safe_load(told)
    assert (
        code == 0 and list(data["grasps"]) == ["left"] and data["obstacles"][0]["leave_out"] == ["<octomap>"]
    )
    code, told = imported(path, *SHIFT, "--leave-out", "d")
    assert code == 2 and "it holds no 'd'" in told


def test_what_no_hand_holds_is_refused(messages, joints, tmp_path):
    held = messages.attached(
        "left_panda_link3", messages.object("a", [("sphere", [0.1])], frame="left_panda_link3")
    )
    path = bag_of(messages, tmp_path / "bag", [], joints=joints, attached=[held])
    code, told = imported(path, *SHIFT)
    assert code == 2 and "is attached to 'left_panda_link3', and no hand of" in " ".join(told.split())
    lost = bag_of(messages, tmp_path / "lost", [], attached=[held])
    code, told = imported(lost, *SHIFT)
    assert code == 2 and "whose joints are not given" in told
    strange = bag_of(messages, tmp_path / "strange", [], joints=joints | {"elbow": 0.0}, attached=[held])
    code, told = imported(strange, *SHIFT)
    assert code == 2 and "has no joint 'elbow'" in told


def test_a_group_state_gives_the_joints(pandas, tmp_path):
    """Of a text file, which has none."""
    (tmp_path / "cell.scene").write_text(
        "x\n* box\n0.45 0 0.3\n0 0 0 1\n1\nbox\n0.05 0.5 0.05\n0 0 0\n0 0 0 1\n0 0 0 0\n0\n.\n"
    )
    joints = {
        side: "".join(
            f'<joint name="{side}_panda_joint{i}" value="{v}"/>'
            for i, v in enumerate((0.1, -0.7, 0, -2.3, 0, 1.5, 0.7), 1)
        )
        for side in ("left", "right")
    }
    states = "".join(
        f'<group_state name="ready" group="{side}">{text}</group_state>' for side, text in joints.items()
    )
    srdf = tmp_path / "pair.srdf"
    srdf.write_text(f'<robot name="pair"><group name="left"/>{states}</robot>')
    options = ImportOptions(Goal((0, 0, 0.1)), "box", srdf=srdf, state="ready")
    found = scene_from(tmp_path / "cell.scene", pandas, tmp_path, "cell", options)
    assert found.present["left_panda_joint4"] == -2.3 and len(found.present) == 14
    assert not found.is_held and found.data["grasps"] == "auto" and "obstacles" not in found.data
    for more, told in (
        ({"srdf": srdf, "state": "redy"}, "no group state 'redy'; did you mean 'ready'"),
        ({"srdf": srdf}, "both --srdf FILE and --state NAME"),
    ):
        with pytest.raises(InputError, match=told):
            scene_from(
                tmp_path / "cell.scene",
                pandas,
                tmp_path,
                "cell",
                ImportOptions(Goal((0, 0, 0.1)), "box", **more),
            )


def test_padded_links_are_told(messages, joints, tmp_path, pandas):
    padding = messages.make("moveit_msgs/msg/LinkPadding", link_name=LINK, padding=0.01)
    none = messages.make("moveit_msgs/msg/LinkPadding", link_name=OTHER, padding=0.0)
    scene = messages.scene(
        [messages.object("a", [("box", [0.05, 0.5, 0.05])], ([0.45, 0, 0.3], [0, 0, 0, 1]))]
    )
    scene.link_padding = [padding, none]
    path = messages.bag(tmp_path / "bag", [("/monitored_planning_scene", SCENE, scene)])
    found = scene_from(path, pandas, tmp_path, "cell", ImportOptions(Goal((0, 0, 0.1)), "a"))
    (note,) = [note for note in found.notes if "padded" in note]
    assert f"'{LINK}'" in note and OTHER not in note


def test_the_imported_start_is_one_that_the_robot_holds(cell, pandas, tmp_path):
    """Its inverse kinematics reaches both ends."""
    _, told = imported(cell, *SHIFT)
    scene = Scene.from_dict(yaml.safe_load(told), folder=tmp_path)
    carrier = RobotCarrier(pandas, scene.alternatives[0].timed(4.0))
    carrier.require_reach()


RESTING = """\
(noname)+
* my table
0.5 0 0.1
0 0 0 1
2
box
0.6 1.2 0.04
0 0 0
0 0 0 1
0 0 0 0
box
0.04 0.04 0.2
0 0 -0.15
0 0 0 1
0 0 0 0
0
* rail
0.42 0 0.145
0 0 0 1
1
box
0.05 0.5 0.05
0 0 0
0 0 0 1
0 0 0 0
0
.
"""


def test_a_text_says_nothing_of_supports_so_they_are_named(tmp_path):
    """Of an object of two boxes the one on which the payload rests; the advice of the refusal works."""
    file = tmp_path / "cell.scene"
    file.write_text(RESTING)
    code, told = imported(file, *SHIFT, "--payload", "rail")
    assert code == 2 and "write supports: [my_table] in obstacles[0]" in told
    code, told = imported(file, *SHIFT, "--payload", "rail", "--support", "my table")
    data = yaml.safe_load(told)
    assert code == 0 and data["obstacles"][0]["supports"] == ["my_table"]
    scene = Scene.from_dict(data, folder=tmp_path)
    assert [one.support for one in scene.file.obstacles] == [True, None]
    data["obstacles"][0]["supports"] = ["my table"]
    assert [one.support for one in Scene.from_dict(data, folder=tmp_path).file.obstacles] == [True, True]
    code, told = imported(file, *SHIFT, "--payload", "rail", "--support", "table")
    assert code == 2 and "it holds no 'table'; did you mean 'my table'" in told
