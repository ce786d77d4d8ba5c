"""Proposed descriptions: arms that the tree of links has, tools, homes, limits and pairs of links."""

import json
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from comove.errors import RobotError
from comove.robots import Robot
from comove.robots.description import load_description
from comove.robots.proposal import examine, homes, propose
from comove.robots.proposal import proposal as proposals
from comove.robots.proposal.homes import HomeSettings
from comove.robots.proposal.proposal import ProposalSettings, _srdf_beside
from comove.robots.proposal.tree import Tree, words_of

ROBOTS = "package://example-robot-data/robots"
LIMIT = '<limit lower="-2" upper="2" velocity="2" effort="40"/>'


def link(name, size=(0.05, 0.05, 0.05), at=(0, 0, 0)):
    shape = f'<geometry><box size="{size[0]} {size[1]} {size[2]}"/></geometry>'
    place = f'<origin xyz="{at[0]} {at[1]} {at[2]}"/>'
    mass = '<inertial><mass value="1"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>'
    return f'<link name="{name}">{mass}<collision>{place}{shape}</collision></link>'


def joint(name, parent, child, at=(0, 0, 0.15), axis=(0, 1, 0), kind="revolute", more=LIMIT):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{at[0]} {at[1]} {at[2]}"/><axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>{more}</joint>'
    )


def arm(prefix, base, at=(0, 0, 0.15), n=6, gripper=None):
    """An arm of n joints about y and z in turn, with two sliding fingers along an axis of its last link."""
    text, before = "", base
    for k in range(n):
        text += link(f"{prefix}link{k}")
        axis = (0, 1, 0) if k % 2 == 0 else (0, 0, 1)
        text += joint(f"{prefix}joint{k}", before, f"{prefix}link{k}", at if k == 0 else (0, 0, 0.15), axis)
        before = f"{prefix}link{k}"
    if gripper is not None:
        across = np.roll(gripper, 1)
        for side, name in ((1, "a"), (-1, "b")):
            place = 0.1 * np.array(gripper) + 0.03 * side * across
            text += link(f"{prefix}finger_{name}", (0.01, 0.01, 0.01))
            slides = '<limit lower="0" upper="0.03" velocity="1" effort="10"/>'
            text += joint(
                f"{prefix}slide_{name}", before, f"{prefix}finger_{name}", place, across, "prismatic", slides
            )
    return text


def urdf(*parts):
    return f'<robot name="made">{"".join(parts)}</robot>'


def tree_of(text):
    return Tree.of(ET.fromstring(text))


def written(tmp_path, text, name="made.urdf"):
    (tmp_path / name).write_text(text, encoding="utf-8")
    return str(tmp_path / name)


@pytest.mark.parametrize("n", [4, 6, 7])
def test_an_arm_ends_where_its_fingers_begin(n):
    (chain,) = tree_of(urdf(link("base"), arm("", "base", n=n, gripper=(0, 0, 1)))).chains()
    assert chain.joints == tuple(f"joint{k}" for k in range(n))
    assert chain.fingers == ("slide_a", "slide_b")
    assert chain.trunk == ()


def test_what_arms_hang_on_is_a_trunk_and_belongs_to_none():
    trunk = link("base") + link("chest") + joint("waist", "base", "chest")
    head = link("face") + joint("nod", "chest", "face")
    both = arm("left_", "chest", (0, 0.2, 0)) + arm("right_", "chest", (0, -0.2, 0))
    left, right = tree_of(urdf(trunk, head, both)).chains()
    assert left.trunk == right.trunk == ("waist",)
    assert {name.partition("_")[0] for name in left.joints} == {"left"}
    assert len(left.joints) == len(right.joints) == 6


def test_legs_are_no_arms_and_short_chains_are_none():
    (chain,) = tree_of(urdf(link("base"), arm("left_leg_", "base"))).chains()
    assert chain.is_other
    assert tree_of(urdf(link("base"), arm("", "base", n=3))).chains() == ()


def test_the_arms_of_a_known_robot(tmp_path):
    """As in the description that somebody wrote by hand."""
    proposal = propose([f"{ROBOTS}/baxter_description/urdf/baxter.urdf"], tmp_path / "baxter.yaml")
    known = Robot.load("baxter")
    for arm in known.arms:
        found = proposal.robot.arm(arm.name)
        assert found.tip == arm.tip
        assert [proposal.robot.joint_names[c] for c in found.columns] == [
            known.joint_names[c] for c in arm.columns
        ]
        assert set(found.fingers) == set(arm.fingers)


def test_two_of_a_kind_stand_apart_and_are_ready(tmp_path):
    panda = f"{ROBOTS}/panda_description/urdf/panda.urdf"
    file = tmp_path / "pandas.yaml"
    proposal = propose([panda, panda], file, apart=0.7)
    file.write_text(proposal.text(), encoding="utf-8")
    robot = Robot.load(file)
    assert [arm.name for arm in robot.arms] == ["left", "right"]
    assert robot.arms[0].home == pytest.approx(robot.arms[1].home)
    for arm in robot.arms:
        pose = robot.tool_pose(robot.home, arm)
        assert pose[:3, 2] == pytest.approx([0, 0, -1], abs=0.1), "the hand points down"
        assert pose[1, 3] * (1 if arm.name == "left" else -1) > 0, "on its own side"
    found = examine(robot)
    assert found.sound
    assert found.clearance > 0
    assert 0.5 < found.arms[0].reach < 1.2


@pytest.mark.slow
def test_the_hands_share_less_where_bases_are_further_apart_and_nothing_beyond_their_reach(tmp_path):
    panda = f"{ROBOTS}/panda_description/urdf/panda.urdf"
    shares = []
    for apart in (0.4, 0.9, 2.5):
        found = examine(propose([panda, panda], tmp_path / "pandas.yaml", apart=apart).robot)
        shares.append(found.shared["left", "right"])
    assert shares[0] > shares[1] > shares[2] == 0.0
    assert found.sound
    assert any("as long" in doubt for doubt in found.doubts)


@pytest.mark.parametrize(
    ("places", "pairs"),
    [
        (((0, 0), (0, 3)), {"01"}),
        (((0, 0), (0, 3), (0, 6)), {"01", "12"}),
        (((0, 6), (0, 0), (0, 3)), {"12", "02"}),
        (((0, 0), (0, 3), (3, 0), (3, 3)), {"01", "02", "13", "23"}),
        (((0, 0), (0, 0), (0, 3)), {"02", "12"}),
    ],
)
def test_only_neighbours_are_said_to_share_no_place(tmp_path, places, pairs):
    """A payload may be as long as its hands are apart: that is to be looked at, and no fault."""
    written(tmp_path, urdf(link("base"), arm("", "base")))
    n = len(places)
    models = [
        {"urdf": "made.urdf", "prefix": f"{k}_", "base": {"position": [*places[k], 0]}} for k in range(n)
    ]
    arms = {f"arm{k}": {"tip": f"{k}_link5", "home": [0, 0.5, 0, 0.5, 0, 0.5]} for k in range(n)}
    file = tmp_path / "row.yaml"
    file.write_text(json.dumps({"name": "row", "models": models, "arms": arms}), encoding="utf-8")
    found = examine(Robot.load(file))
    told = {"".join(re.findall(r"'arm(\d)'", doubt)) for doubt in found.doubts if "come no nearer" in doubt}
    assert told == pairs
    assert not any("hands" in fault for fault in found.faults)


@pytest.mark.parametrize("approach", [(0, 0, 1), (1, 0, 0), (0, -1, 0)])
def test_the_approach_leads_from_the_wrist_to_the_fingers(tmp_path, approach):
    path = written(tmp_path, urdf(link("base"), arm("", "base", gripper=approach)))
    proposal = propose([path], tmp_path / "made.yaml")
    (found,) = proposal.robot.arms
    assert found.tool[:3, 2] == pytest.approx(approach, abs=1e-5)
    assert np.abs(found.tool[:3, 1] @ np.roll(approach, 1)) == pytest.approx(1.0, abs=1e-5), (
        "fingers open along y"
    )
    along = 0.1 + 0.75 * 0.005  # fingers begin 0.1 m from the wrist and are as long as half of their boxes
    assert found.tool[:3, 3] == pytest.approx(along * np.array(approach), abs=1e-4)


def test_a_tool_frame_whose_x_is_the_approach_is_turned_and_stays_where_it_is(tmp_path):
    """As those of many robots are, PR2 among them."""
    tool = '<link name="tool_frame"/>' + joint(
        "to_tool", "link5", "tool_frame", (0.15, 0, 0), kind="fixed", more=""
    )
    path = written(tmp_path, urdf(link("base"), arm("", "base", gripper=(1, 0, 0)), tool))
    proposal = propose([path], tmp_path / "made.yaml")
    (found,) = proposal.robot.arms
    assert found.tip == "tool_frame"
    assert found.tool[:3, 2] == pytest.approx([1, 0, 0], abs=1e-5)
    assert np.abs(found.tool[:3, 1] @ [0, 1, 0]) == pytest.approx(1.0, abs=1e-5), "fingers open along y"
    assert found.tool[:3, 3] == pytest.approx([0, 0, 0])
    assert any("fingers point along its x" in note for note in proposal.notes)


@pytest.mark.parametrize("front", [1, -1])
def test_hands_at_home_stand_side_by_side_where_arms_reach_best(tmp_path, front):
    """In front is where most of what the hands reach is: iCub's is where x is negative."""
    text = urdf(link("torso"), arm("l_", "torso", (0, 0.2, 0.3)), arm("r_", "torso", (0, -0.2, 0.3)))
    bent = '<limit lower="0.05" upper="2" velocity="2" effort="40"/>'
    if front < 0:
        bent = '<limit lower="-2" upper="-0.05" velocity="2" effort="40"/>'
    robot = propose(
        [written(tmp_path, text.replace(f'"0 1 0"/>{LIMIT}', f'"0 1 0"/>{bent}'))], tmp_path / "robot.yaml"
    ).robot
    left, right = (robot.tool_pose(robot.home, robot.arm(name)) for name in ("left", "right"))
    assert front * left[0, 3] > 0.1
    assert left[[0, 2], 3] == pytest.approx(right[[0, 2], 3], abs=0.01)
    assert left[1, 3] > right[1, 3]
    for pose in (left, right):
        assert pose[:3, 2] == pytest.approx([0, 0, -1], abs=0.02)


APPROACHES = {  # of published models, by what their makers say of these frames, or their meshes show
    "ur_description/urdf/ur3_robot": {"arm": ("tool0", "z")},
    "ur_description/urdf/ur5_robot": {"arm": ("tool0", "z")},
    "ur_description/urdf/ur10_joint_limited_robot": {"arm": ("tool0", "z")},
    "xarm_description/urdf/xarm7": {"arm": ("link_eef", "z")},
    "kinova_description/robots/kinova": {"arm": ("j2s6s200_end_effector", "x")},
    "tiago_description/robots/tiago_no_hand": {"arm": ("arm_tool_link", "x")},
    "z1_description/urdf/z1": {"arm": ("gripperStator", "x")},
    "panda_description/urdf/panda": {"arm": ("panda_hand_tcp", "z")},
    "so_arm_description/urdf/so101": {"arm": ("gripper_link", "-z")},
    "alex_description/urdf/alex_nub_hands": {"left": ("leftNub", "-z"), "right": ("rightNub", "-z")},
    "g1_description/urdf/g1_29dof_rev_1_0": dict.fromkeys(("left", "right"), (None, "x")),
    "romeo_description/urdf/romeo_small": {"left": ("l_gripper", "x"), "right": ("r_gripper", "x")},
    "icub_description/robots/icub_reduced": {"left": ("l_gripper", "x"), "right": ("r_gripper", "x")},
    "simple_humanoid_description/urdf/simple_humanoid": dict.fromkeys(("left", "right"), (None, "-z")),
    "human_description/robots/human": dict.fromkeys(("left", "right"), (None, "-y")),
    "talos_data/robots/talos_reduced": dict.fromkeys(("left", "right"), (None, "-z")),
    "tiago_pro_description/robots/tiago_pro": dict.fromkeys(("left", "right"), (None, "z")),
    "pr2_description/urdf/pr2": dict.fromkeys(("left", "right"), (None, "x")),
}


@pytest.fixture
def cheap(monkeypatch):
    """Where neither homes nor pairs that touch matter."""
    monkeypatch.setattr(proposals, "SETTINGS", ProposalSettings(n_samples=1))
    monkeypatch.setattr(homes, "SETTINGS", HomeSettings(n_drawn=10, n_tried=1, n_steps=1))


@pytest.mark.usefixtures("cheap")
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow) if k > 3 else name for k, name in enumerate(APPROACHES)],
)
def test_published_models_approach_as_their_makers_say(tmp_path, name):
    robot = propose([f"{ROBOTS}/{name}.urdf"], tmp_path / "made.yaml").robot
    assert {arm.name for arm in robot.arms} == set(APPROACHES[name])
    for arm in robot.arms:
        tip, axis = APPROACHES[name][arm.name]
        assert arm.tip == (tip or arm.tip)
        wanted = np.eye(3)["xyz".index(axis[-1])] * (-1 if axis[0] == "-" else 1)
        np.testing.assert_allclose(arm.tool[:3, 2], wanted, atol=1e-5)


def behind(at):
    """An arm whose last link is a flange: its frame is at the face, and all of the link lies behind it."""
    text = urdf(link("base"), arm("", "base"))
    inertial = f'<inertial><origin xyz="{at[0]} {at[1]} {at[2]}"/><mass value="1"/>'
    last = link("link5", (0.06, 0.06, 0.05), at).replace('<inertial><mass value="1"/>', inertial)
    return text.replace(link("link5"), last)


FIXED = '<joint name="{0}" type="fixed"><parent link="{1}"/><child link="{0}"/><origin rpy="{2}"/></joint>'
QUARTER = np.pi / 2


@pytest.mark.usefixtures("cheap")
@pytest.mark.parametrize(
    ("frames", "tip", "axis"),
    [
        ([], "link5", (0, 0, 1)),
        ([("tool0", "link5", "0 0 0")], "tool0", (0, 0, 1)),
        ([("made_tcp", "link5", "0 0 0")], "made_tcp", (0, 0, 1)),
        ([("left_ee", "link5", "0 0 0")], "left_ee", (0, 0, 1)),
        ([("flange", "link5", f"0 {-QUARTER} {-QUARTER}")], "flange", (1, 0, 0)),
        (
            [("flange", "link5", f"0 {-QUARTER} {-QUARTER}"), ("tool0", "flange", f"{QUARTER} 0 {QUARTER}")],
            "tool0",
            (0, 0, 1),
        ),
    ],
)
def test_a_flange_whose_mass_lies_behind_it_approaches_away_from_the_arm(tmp_path, frames, tip, axis):
    """As those of the UR e-series: 'flange' has x forward, 'tool0' z, as ROS-Industrial has them."""
    more = "".join(f'<link name="{name}"/>{FIXED.format(name, on, rpy)}' for name, on, rpy in frames)
    text = behind((0, 0, -0.03)).replace("</robot>", f"{more}</robot>")
    (found,) = propose([written(tmp_path, text)], tmp_path / "made.yaml").robot.arms
    assert found.tip == tip
    np.testing.assert_allclose(found.tool[:3, 2], axis, atol=1e-5)
    np.testing.assert_allclose(found.tool[:3, 3], 0.0, atol=1e-4)


@pytest.mark.parametrize("way", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0)])
def test_without_fingers_the_approach_leads_from_the_wrist_to_the_end_of_the_last_link(tmp_path, way):
    """And that is told."""
    way = np.array(way)
    stick = link("stick", tuple(0.02 + 0.06 * abs(way)), tuple(0.04 * way))
    fixed = joint("to_stick", "link5", "stick", tuple(0.03 * way), kind="fixed", more="")
    path = written(tmp_path, urdf(link("base"), arm("", "base"), stick, fixed))
    proposal = propose([path], tmp_path / "made.yaml")
    (found,) = proposal.robot.arms
    assert found.tip == "stick"
    assert found.tool[:3, 2] == pytest.approx(way, abs=1e-5)
    assert found.tool[:3, 3] == pytest.approx(0.08 * way, abs=1e-4)
    assert np.linalg.det(found.tool[:3, :3]) == pytest.approx(1.0)
    assert any("without fingers" in note for note in proposal.notes)


def test_where_the_tip_is_the_wrist_the_approach_leads_to_the_centre_of_mass(tmp_path):
    """As of hands that have neither fingers nor collision bodies."""
    hand = link("link5").replace(
        '<inertial><mass value="1"/>', '<inertial><origin xyz="0.002 -0.06 0"/><mass value="1"/>'
    )
    hand = hand[: hand.index("<collision>")] + "</link>"
    text = urdf(link("base"), arm("", "base")).replace(link("link5"), hand)
    (found,) = propose([written(tmp_path, text)], tmp_path / "made.yaml").robot.arms
    assert found.tool[:3, 2] == pytest.approx([0, -1, 0], abs=1e-5)
    assert found.tool[:3, 3] == pytest.approx([0, -0.06, 0], abs=1e-4)


def test_a_chest_on_a_long_spine_is_no_hand(tmp_path):
    """Two arms and a neck leave it, which are too long for fingers."""
    spine = arm("spine_", "base", n=5)
    both = arm("left_", "spine_link4", (0, 0.2, 0)) + arm("right_", "spine_link4", (0, -0.2, 0))
    neck = link("skull") + joint("nod", "spine_link4", "skull")
    left, right = tree_of(urdf(link("base"), spine, both, neck)).chains()
    assert left.trunk == right.trunk == tuple(f"spine_joint{k}" for k in range(5))
    assert len(left.joints) == len(right.joints) == 6


def test_a_joint_that_follows_one_that_is_not_there_stays(tmp_path):
    """As the fingers of Alex's psyonic hands do."""
    follows = LIMIT + '<mimic joint="lost"/>'
    text = urdf(link("base"), arm("", "base"), link("nail"), joint("bent", "link5", "nail", more=follows))
    proposal = propose([written(tmp_path, text)], tmp_path / "made.yaml")
    assert proposal.data["posture"] == {"bent": 0.0}
    assert any("'bent' goes along with 'lost'" in note for note in proposal.notes)


def test_a_tool_frame_at_the_wrist_is_moved_between_the_fingers(tmp_path):
    """As that of an SO-100 is, whose last link is called gripper."""
    text = urdf(link("base"), arm("", "base", gripper=(0, 0, 1))).replace("link5", "gripper")
    (found,) = propose([written(tmp_path, text)], tmp_path / "made.yaml").robot.arms
    assert found.tip == "gripper"
    assert 0.1 < found.tool[2, 3] < 0.105


def test_limits_that_fingers_and_other_joints_lack_are_guessed_too(tmp_path):
    """As MuJoCo's models have no speeds, and joints without motors no efforts."""
    text = urdf(link("base"), arm("", "base", gripper=(0, 0, 1)), link("head") + joint("nod", "base", "head"))
    text = text.replace(' velocity="1" effort="10"', "").replace(' velocity="2" effort="40"', "")
    limits = propose([written(tmp_path, text)], tmp_path / "made.yaml").data["limits"]
    assert set(limits) == {*(f"joint{k}" for k in range(6)), "slide_a", "slide_b", "nod"}
    assert limits["slide_a"]["velocity"] < limits["joint0"]["velocity"]
    assert all(set(given) == {"velocity", "effort"} for given in limits.values())


def test_arms_that_face_each_other_have_their_hands_between_them(tmp_path):
    """As ALOHA's, whose names tell the side before a slash."""
    base = link("base")
    far = arm("rig_right/", "base", (0.5, 0, 0.1)).replace(
        '<origin xyz="0.5 0 0.1"/>', '<origin xyz="0.5 0 0.1" rpy="0 0 3.14159265"/>'
    )
    text = urdf(base, arm("rig_left/", "base", (-0.5, 0, 0.1)), far)
    robot = propose([written(tmp_path, text)], tmp_path / "made.yaml").robot
    assert [arm.name for arm in robot.arms] == ["left", "right"]
    left, right = (robot.tool_pose(robot.home, robot.arm(name))[:3, 3] for name in ("left", "right"))
    assert -0.5 < left[0] < right[0] - 0.1 < right[0] < 0.5
    assert left[0] == pytest.approx(-right[0], abs=0.02)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("left_toolhead", "left toolhead"),
        ("LFsrFR_frame", "l fsr fr frame"),
        ("RHipYaw", "r hip yaw"),
        ("jointGripper", "joint gripper"),
        ("rig-left/tool0.tip", "rig left tool tip"),
        ("FR3Hand2", "fr hand"),
        ("RLEG_HIP_R", "rleg hip r"),
        ("", ""),
    ],
)
def test_names_are_split_into_words(name, words):
    assert words_of(name) == tuple(words.split())


@pytest.mark.parametrize("name", ["overhead_left_j", "left_legacy_j", "kneepadtest", "shipyard_j", "Toenail"])
def test_an_arm_whose_names_hold_a_leg_or_a_head_within_a_word_is_one(name):
    text = urdf(link("base"), arm("", "base")).replace('"joint', f'"{name}')
    (chain,) = tree_of(text).chains()
    assert not chain.is_other


def test_a_tool_that_is_called_a_head_leaves_the_arm_an_arm():
    head = link("print_head") + joint("to_head", "link5", "print_head", kind="fixed", more="")
    (chain,) = tree_of(urdf(link("base"), arm("", "base"), head)).chains()
    assert not chain.is_other


@pytest.mark.parametrize(
    "name", ["leg", "LeftHip{}Yaw", "r_knee", "RLEG_J", "wheels", "neck", "HeadPan", "FL_calf_joint"]
)
def test_chains_of_legs_wheels_and_necks_are_no_arms(name):
    text = urdf(link("base"), arm("", "base"))
    for k in range(6):
        text = text.replace(f'"joint{k}"', f'"{name.format(k)}{k}"')
    (chain,) = tree_of(text).chains()
    assert chain.is_other


@pytest.mark.parametrize(
    "name", ["left_gripper_yaw", "GripperRoll", "wrist_gripper_pitch", "gripper_rotation"]
)
def test_a_wrist_of_a_gripper_is_a_joint_of_the_arm(name):
    """It turns by less than half a turn, as fingers do."""
    limit = '<limit lower="-1.5" upper="1.5" velocity="2" effort="40"/>'
    last = link("end") + joint(name, "link5", "end", more=limit)
    (chain,) = tree_of(urdf(link("base"), arm("", "base"), last)).chains()
    assert chain.joints[-1] == name
    assert chain.fingers == ()


@pytest.mark.parametrize(("stroke", "n_joints"), [(0.08, 6), (0.5, 7)])
def test_a_joint_that_slides_far_is_no_finger(stroke, n_joints):
    slides = f'<limit lower="0" upper="{stroke}" velocity="1" effort="10"/>'
    last = link("end") + joint("quill", "link5", "end", axis=(0, 0, 1), kind="prismatic", more=slides)
    (chain,) = tree_of(urdf(link("base"), arm("", "base"), last)).chains()
    assert len(chain.joints) == n_joints


def test_every_joint_with_a_motor_is_in_an_arm_or_named_in_the_notes(tmp_path):
    parts = (
        arm("", "base", gripper=(0, 0, 1))
        + arm("leg_", "base", (1, 0, 0))
        + arm("short_", "base", (0, 1, 0), n=2)
    )
    pan = link("camera") + joint("pan", "link2", "camera")
    proposal = propose([written(tmp_path, urdf(link("base"), parts, pan))], tmp_path / "made.yaml")
    told = "\n".join(proposal.notes)
    moving = {
        *(f"leg_joint{k}" for k in range(6)),
        "short_joint0",
        "short_joint1",
        "pan",
        "slide_a",
        "slide_b",
    }
    assert all(re.search(rf"\b{name}\b", told) for name in moving)
    assert set(proposal.robot.joint_names) == {f"joint{k}" for k in range(6)}


def test_the_advice_for_a_joint_that_was_taken_for_a_finger_works(tmp_path):
    """As the note says: out of `fingers`, a tip beyond it, and a value of home for it."""
    last = link("end") + joint("left_gripper_turner", "link5", "end")
    last = last.replace('lower="-2" upper="2"', 'lower="-1" upper="1"')
    file = tmp_path / "made.yaml"
    proposal = propose([written(tmp_path, urdf(link("base"), arm("", "base"), last))], file)
    (entry,) = proposal.data["arms"].values()
    assert entry["fingers"] == ["left_gripper_turner"]
    (note,) = (note for note in proposal.notes if "left_gripper_turner" in note)
    assert all(word in note for word in ("`fingers`", "`tip`", "`home`"))
    entry["fingers"], entry["tip"], entry["home"] = [], "end", [*entry["home"], 0.0]
    file.write_text(proposal.text(), encoding="utf-8")
    assert len(Robot.load(file).joint_names) == 7


@pytest.mark.parametrize(("lower", "upper", "n_joints"), [(-2.6, 2.6, 7), (-0.2, 2.0, 6)])
def test_a_joint_called_gripper_that_turns_by_more_than_half_a_turn_is_a_wrist(lower, upper, n_joints):
    """As that of Alex's nub hands is; a jaw, such as an SO-100's, is not."""
    limit = f'<limit lower="{lower}" upper="{upper}" velocity="2" effort="40"/>'
    last = link("end") + joint("gripper", "link5", "end", more=limit)
    (chain,) = tree_of(urdf(link("base"), arm("", "base"), last)).chains()
    assert len(chain.joints) == n_joints
    assert (chain.fingers, chain.grippers) == ((), ()) if n_joints == 7 else (("gripper",), ("end",))


def test_an_arm_is_at_home_as_the_other_one_in_a_mirror(tmp_path):
    """Where its joints are alike but for signs, as those of a pair of human arms are."""
    bent = '<limit lower="-0.5" upper="1.9" velocity="2" effort="40"/>'
    mirrored = '<limit lower="-1.9" upper="0.5" velocity="2" effort="40"/>'
    left = arm("l_", "torso", (0, 0.2, 0.3)).replace(f'"0 0 1"/>{LIMIT}', f'"0 0 1"/>{bent}')
    right = arm("r_", "torso", (0, -0.2, 0.3)).replace(f'"0 0 1"/>{LIMIT}', f'"0 0 1"/>{mirrored}')
    robot = propose([written(tmp_path, urdf(link("torso"), left, right))], tmp_path / "robot.yaml").robot
    one, other = (robot.arm(name).home for name in ("left", "right"))
    assert other == pytest.approx(np.where(np.arange(6) % 2 == 0, one, -one), abs=1e-9)
    assert np.abs(one[1::2]).max() > 0.5, "so that it is another one than a copy"


def test_pairs_that_always_touch_are_not_compared(tmp_path):
    """A link so fat that it always holds the base."""
    text = urdf(link("base"), arm("", "base")).replace(link("link2"), link("link2", (1.0, 1.0, 1.0)))
    proposal = propose([written(tmp_path, text)], tmp_path / "made.yaml")
    (pairs,) = proposal.srdf.values()
    assert 'link1="base" link2="link2"' in pairs
    (tmp_path / "made.srdf").write_text(pairs, encoding="utf-8")
    for model in proposal.data["models"]:
        model["srdf"] = "made.srdf"
    (tmp_path / "made.yaml").write_text(proposal.text(), encoding="utf-8")
    robot = Robot.load(tmp_path / "made.yaml")
    names = [item.name for item in robot.collision.geometryObjects]
    compared = {frozenset((names[p.first], names[p.second])) for p in robot.collision.collisionPairs}
    assert frozenset(("base_0", "link2_0")) not in compared


@pytest.mark.usefixtures("cheap")
@pytest.mark.parametrize("stroke", [20.0, 1.0])
def test_joints_that_drive_a_base_are_no_arms_and_those_of_a_gantry_are(tmp_path, stroke):
    """As simulators add them: two that slide, and one that turns a link without a body."""
    slides = f'<limit lower="{-stroke}" upper="{stroke}" velocity="1" effort="100"/>'
    drive = (
        '<link name="world"/><link name="at_x"/><link name="at_y"/>'
        + joint("drive_x", "world", "at_x", (0, 0, 0), (1, 0, 0), "prismatic", slides)
        + joint("drive_y", "at_x", "at_y", (0, 0, 0), (0, 1, 0), "prismatic", slides)
        + joint("drive_z", "at_y", "base", (0, 0, 0), (0, 0, 1), "continuous", "")
    )
    text = urdf(drive, link("base"), arm("", "base"))
    (chain,) = tree_of(text).chains()
    own = tuple(f"joint{k}" for k in range(6))
    base = ("drive_x", "drive_y", "drive_z")
    assert (chain.trunk, chain.joints) == ((base, own) if stroke > 2.0 else ((), base + own))
    data = propose([written(tmp_path, text)], tmp_path / "robot.yaml").data
    assert set(data.get("posture", {})) == set(chain.trunk)


@pytest.mark.parametrize("folder", ["srdf", "urdf"])
def test_an_srdf_that_lacks_pairs_is_completed(folder, tmp_path):
    """As Romeo's is, whose links have other names in some of its URDFs; one of that name may lie beside a URDF."""
    (tmp_path / "urdf").mkdir()
    (tmp_path / folder).mkdir(exist_ok=True)
    own = '<robot name="made"><disable_collisions link1="link0" link2="link4" reason="Never"/></robot>'
    (tmp_path / folder / "made.srdf").write_text(own, encoding="utf-8")
    text = urdf(link("base"), arm("", "base")).replace(link("link2"), link("link2", (1.0, 1.0, 1.0)))
    proposal = propose([written(tmp_path / "urdf", text)], tmp_path / "made.yaml")
    (pairs,) = proposal.srdf.values()
    assert [model["srdf"] for model in proposal.data["models"]] == [f"{folder}/made.srdf"]
    assert 'link1="link0" link2="link4"' in pairs
    assert 'link1="base" link2="link2"' in pairs


@pytest.mark.parametrize(
    ("urdf_name", "srdfs", "wanted"),
    [
        ("ur5_gripper", ["ur5", "ur5_gripper"], "ur5_gripper"),
        ("ur5_robot", ["ur5", "ur5_gripper"], "ur5"),
        ("ur5", ["ur5e"], None),
        ("b1", ["b1-z1", "b1"], "b1"),
    ],
)
def test_the_srdf_of_a_model_is_that_of_its_whole_name(tmp_path, urdf_name, srdfs, wanted):
    (tmp_path / "urdf").mkdir()
    (tmp_path / "srdf").mkdir()
    for name in srdfs:
        (tmp_path / "srdf" / f"{name}.srdf").write_text('<robot name="made"/>', encoding="utf-8")
    file = tmp_path / "urdf" / f"{urdf_name}.urdf"
    assert _srdf_beside(file, f"package://made/urdf/{file.name}") == (
        None if wanted is None else f"package://made/srdf/{wanted}.srdf"
    )


def test_two_of_a_kind_leave_out_the_same_pairs(tmp_path):
    """One file of pairs serves both, so what is loaded from what was written compares what the proposal does."""
    text = urdf(link("base"), arm("", "base")).replace(link("link2"), link("link2", (1.0, 1.0, 1.0)))
    file = tmp_path / "made.yaml"
    proposal = propose([written(tmp_path, text)] * 2, file, apart=3.0)
    (pairs,) = proposal.srdf.values()
    (tmp_path / "made.srdf").write_text(pairs, encoding="utf-8")
    for model in proposal.data["models"]:
        model["srdf"] = "made.srdf"
    file.write_text(proposal.text(), encoding="utf-8")

    def compared(robot):
        names = [item.name for item in robot.collision.geometryObjects]
        return {frozenset((names[p.first], names[p.second])) for p in robot.collision.collisionPairs}

    assert compared(Robot.load(file)) == compared(proposal.robot)


def test_a_hand_with_long_fingers_is_no_chest(tmp_path):
    """As TIAGo's is, whose fingers have seven joints each in its URDF."""
    hand = "".join(arm(f"finger{k}_", "link5", (0.02 * k, 0, 0.1), n=7) for k in range(3))
    (chain,) = tree_of(urdf(link("base"), arm("", "base"), hand)).chains()
    assert len(chain.joints) == 6
    assert len(chain.fingers) == 21


@pytest.mark.parametrize(("gap", "never"), [(0.003, True), (-0.01, False), (0.05, False)])
def test_links_that_come_near_and_cannot_touch_are_not_compared(tmp_path, gap, never):
    """A small link swings on a circle of 0.15 m past a wall on a link below, and leaves a gap, or none."""
    wall, small = (
        link("link1", at=(0.15 + 0.0014 + gap + 0.025, 0, 0.15)),
        link("link3", (0.002, 0.002, 0.002)),
    )
    text = urdf(link("base"), arm("", "base")).replace(link("link1"), wall).replace(link("link3"), small)
    proposal = propose([written(tmp_path, text)], tmp_path / "made.yaml")
    told = 'link1="link1" link2="link3" reason="Never"' in "".join(proposal.srdf.values())
    assert told == never == any("'link1' and 'link3' come near" in note for note in proposal.notes)


@pytest.mark.parametrize("nothing", ["0", "1e9"])
def test_limits_that_no_motor_has_are_guessed_and_told(tmp_path, nothing):
    text = urdf(link("base"), arm("", "base")).replace(
        'velocity="2" effort="40"', f'velocity="{nothing}" effort="{nothing}"', 1
    )
    proposal = propose([written(tmp_path, text)], tmp_path / "made.yaml")
    assert proposal.data["limits"] == {"joint0": {"velocity": 1.0, "effort": 50.0}}
    assert any("joint0" in note and "guesses" in note for note in proposal.notes)


def test_springs_are_guessed_where_a_motor_cannot_hold_the_arm(tmp_path):
    """As PR2's shoulders cannot by its URDF; without springs that is a fault."""
    text = urdf(link("base"), arm("", "base"))
    text = text.replace(LIMIT, LIMIT.replace("40", "4"), 1)  # of joint0, on which all hangs
    file = tmp_path / "made.yaml"
    proposal = propose([written(tmp_path, text)], file)
    assert proposal.data["springs"] == {"joint0": 0.9}
    assert any("springs" in note for note in proposal.notes)
    assert not any("own weight" in fault for fault in examine(proposal.robot).faults)
    without = {key: value for key, value in proposal.data.items() if key != "springs"}
    file.write_text(replace(proposal, data=without).text(), encoding="utf-8")
    (fault,) = (fault for fault in examine(Robot.load(file)).faults if "own weight" in fault)
    assert "'joint0'" in fault


def test_a_trunk_stays_within_its_limits(tmp_path):
    lift = '<limit lower="0.1" upper="0.4" velocity="1" effort="100"/>'
    trunk = (
        link("base") + link("chest") + joint("lift", "base", "chest", (0, 0, 0), (0, 0, 1), "prismatic", lift)
    )
    both = arm("left_", "chest", (0, 0.4, 0)) + arm("right_", "chest", (0, -0.4, 0))
    proposal = propose([written(tmp_path, urdf(trunk, both))], tmp_path / "made.yaml")
    assert proposal.data["posture"] == {"lift": 0.1}


def test_a_joint_may_be_called_like_a_link(tmp_path):
    """As the fingers' joint of an SO-100 is, and here a joint of the arm itself as well."""
    text = urdf(link("base"), arm("", "base", gripper=(0, 0, 1)))
    for own, other in (("slide_a", "link5"), ("joint2", "link3")):
        text = text.replace(f'"{own}"', f'"{other}"')
    proposal = propose([written(tmp_path, text)] * 2, tmp_path / "robot.yaml")
    plain = propose(
        [written(tmp_path, urdf(link("base"), arm("", "base", gripper=(0, 0, 1))), "plain.urdf")] * 2,
        tmp_path / "robot.yaml",
    )
    assert "left_link3" in proposal.robot.joint_names
    q = np.linspace(-0.5, 0.5, len(plain.robot.lower))
    for one, other in zip(proposal.robot.arms, plain.robot.arms, strict=True):
        assert proposal.robot.tool_pose(q, one) == pytest.approx(plain.robot.tool_pose(q, other))


def test_a_joint_that_does_not_move_may_mimic_another(tmp_path):
    stiff = joint("stiff", "link5", "tag", kind="fixed", more='<mimic joint="joint0"/>')
    text = urdf(link("base"), arm("", "base"), link("tag"), stiff)
    assert propose([written(tmp_path, text)], tmp_path / "robot.yaml").robot.arms


def test_a_home_at_a_limit_is_within_it(tmp_path):
    """A limit of 1.5708 rad is no 1.571."""
    near = '<limit lower="1.2006" upper="1.2008" velocity="2" effort="40"/>'
    text = urdf(link("base"), arm("", "base")).replace(LIMIT, near, 1)
    file = tmp_path / "robot.yaml"
    proposal = propose([written(tmp_path, text)], file)
    file.write_text(proposal.text(), encoding="utf-8")
    assert (Robot.load(file).home[0] >= 1.2006) and (Robot.load(file).home[0] <= 1.2008)


def limits_of(seed):
    """An arm whose limits are drawn, so that hands can point down near some of them only."""
    rng, text = np.random.default_rng(seed), urdf(link("base"), arm("", "base"))
    for _ in range(6):
        lower, upper = -rng.uniform(0.1, 2.5), rng.uniform(0.1, 2.5)
        text = text.replace(LIMIT, f'<limit lower="{lower}" upper="{upper}" velocity="2" effort="40"/>', 1)
    return text


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.few(1)
def test_a_home_keeps_what_search_and_approach_demand(tmp_path, seed):
    """Its distance from limits and between links is computed here from the raw file and coal's distances."""
    proposal = propose([written(tmp_path, limits_of(seed))], tmp_path / "made.yaml")
    robot = proposal.robot
    limits = [limit.attrib for limit in ET.fromstring(limits_of(seed)).iter("limit")]
    lower, upper = (np.array([float(limit[key]) for limit in limits]) for key in ("lower", "upper"))
    margin = np.minimum(robot.home - lower, upper - robot.home)
    assert (margin >= 0.02 - 1e-9).all()
    assert examine(robot).clearance >= 0.005 or any("no home" in note for note in proposal.notes)
    assert not any("at home" in fault for fault in examine(robot).faults)


@pytest.mark.usefixtures("cheap")
@pytest.mark.parametrize("home", [[2.0, 0.5, 0, 0.5, 0, 0.5], [0, -1.99, 0, 0.5, 0, 0.5]])
def test_a_home_at_a_limit_is_a_fault_and_the_advice_helps(tmp_path, home):
    path = written(tmp_path, urdf(link("base"), arm("", "base")))
    file = tmp_path / "made.yaml"
    proposal = propose([path], file)
    (entry,) = proposal.data["arms"].values()
    entry["home"] = home
    file.write_text(proposal.text(), encoding="utf-8")
    (fault,) = (fault for fault in examine(Robot.load(file)).faults if "limit" in fault)
    name, lower, upper = re.search(r"'joint(\d)'.* between (\S+) and (\S+)$", fault).groups()
    entry["home"] = [
        float(np.clip(value, float(lower), float(upper))) if k == int(name) else value
        for k, value in enumerate(home)
    ]
    file.write_text(proposal.text(), encoding="utf-8")
    assert not any("limit" in fault for fault in examine(Robot.load(file)).faults)


@pytest.mark.parametrize(("gap", "sound"), [(-0.002, False), (0.003, False), (0.007, False), (0.012, True)])
def test_links_that_are_too_near_at_home_are_a_fault(tmp_path, gap, sound):
    """The verification asks for 5 mm, approach and release for 4 more; two bases may stand as near as one likes."""
    (tmp_path / "made.urdf").write_text(urdf(link("base"), arm("", "base")), encoding="utf-8")
    places = ([0, 0, 0], [0, 0.05 + gap, 0])
    models = [{"urdf": "made.urdf", "prefix": f"{k}_", "base": {"position": places[k]}} for k in (0, 1)]
    arms = {f"arm{k}": {"tip": f"{k}_link5", "home": [0.0] * 6} for k in (0, 1)}
    file = tmp_path / "two.yaml"
    file.write_text(json.dumps({"name": "two", "models": models, "arms": arms}), encoding="utf-8")
    faults = [fault for fault in examine(Robot.load(file)).faults if "at home" in fault]
    assert (not faults) == sound
    assert all(("touch" if gap < 0 else "mm apart, and have to keep 9.1 mm") in fault for fault in faults)


def test_links_that_are_drawn_and_collide_with_nothing_are_told(tmp_path):
    """As the jaws of an SO-100 are; what does not move may be drawn only."""
    plain = '<link name="{0}"><visual><geometry><sphere radius="0.01"/></geometry></visual></link>'
    text = urdf(link("base"), arm("", "base"), plain.format("tip"), plain.format("plate"))
    text = text.replace("</robot>", joint("to_tip", "link5", "tip", kind="fixed", more="") + "</robot>")
    text = text.replace("</robot>", joint("to_plate", "base", "plate", kind="fixed", more="") + "</robot>")
    doubts = examine(propose([written(tmp_path, text)], tmp_path / "made.yaml").robot).doubts
    (told,) = (doubt for doubt in doubts if "no collision body" in doubt)
    assert "'tip'" in told and "'plate'" not in told


def test_what_is_written_is_a_description(tmp_path):
    path = written(tmp_path, urdf(link("base"), arm("", "base", gripper=(0, 0, 1))))
    file = tmp_path / "deep" / "made.yaml"
    file.parent.mkdir()
    proposal = propose([path], file)
    file.write_text(proposal.text(), encoding="utf-8")
    assert load_description(file).models[0].urdf == str(Path("..") / "made.urdf")
    assert Robot.load(file).arms[0].name == "arm"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (urdf(link("base")), "no arm of four joints"),
        (urdf(link("base"), arm("leg_", "base")), "no arm of four joints"),
        ("<robot", "it is not XML"),
        ("", "it is not XML"),
        ("<mujoco/>", "model of MuJoCo's"),
        (urdf(), "it has no link"),
    ],
)
def test_what_is_no_robot(tmp_path, text, words):
    with pytest.raises(RobotError, match=words):
        propose([written(tmp_path, text)], tmp_path / "made.yaml")


def test_a_model_that_is_not_there(tmp_path):
    for name in ("none.urdf", "package://nothing/none.urdf", "."):
        with pytest.raises(RobotError):
            propose([name], tmp_path / "made.yaml")


def five_joints(angle, limit):
    """An arm of five joints whose first stands at an angle."""
    body = (
        '<inertial><mass value="1"/><inertia ixx=".01" ixy="0" ixz="0" iyy=".01" iyz="0" izz=".01"/></inertial>'
        '<collision><geometry><sphere radius="0.03"/></geometry></collision>'
    )
    parts = ['<robot name="five"><link name="base"/>']
    for k in range(5):
        above, rpy = (f"l{k - 1}", "0 0 0") if k else ("base", f"{angle} 0 0")
        parts.append(
            f'<link name="l{k}">{body}</link><joint name="j{k}" type="revolute"><parent link="{above}"/>'
            f'<child link="l{k}"/><origin xyz="0 0 0.15" rpy="{rpy}"/><axis xyz="{"0 1 0" if k % 2 else "0 0 1"}"/>'
            f'<limit lower="-{limit}" upper="{limit}" velocity="1" effort="50"/></joint>'
        )
    return "".join(parts) + "</robot>"


@pytest.mark.parametrize(("angle", "rounded"), [("1.5708", True), ("1.57", None), (repr(np.pi / 2), None)])
@pytest.mark.few(1)
def test_right_angles_of_arms_of_five_joints_are_rounded(angle, rounded, tmp_path):
    path = tmp_path / "five.urdf"
    path.write_text(five_joints(angle, 2.8), encoding="utf-8")
    proposal = propose([str(path)], tmp_path / "five.yaml")
    assert proposal.data["models"][0].get("round_right_angles") is rounded
    assert any("taken for right angles" in note for note in proposal.notes) == bool(rounded)


def test_limits_in_degrees_are_proposed_in_radians(tmp_path):
    path = tmp_path / "five.urdf"
    path.write_text(five_joints("0", 160), encoding="utf-8")
    proposal = propose([str(path)], tmp_path / "five.yaml")
    assert proposal.data["limits"]["j3"] == {"lower": -2.79253, "upper": 2.79253}
    assert any("no usable lower and upper" in note for note in proposal.notes)


SRDF = """\
<robot name="made">
  <group name="left_manipulator"><joint name="world"/><chain base_link="base" tip_link="l_link5"/></group>
  <group name="grippers"><joint name="l_slide_a"/><joint name="l_slide_b"/></group>
  <group name="everything"><group name="left_manipulator"/><group name="grippers"/><group name="everything"/></group>
  <group name="by links">LINKS</group>
  <group_state name="ready" group="left_manipulator">STATES</group_state>
  <disable_collisions link1="base" link2="l_link3" reason="Never"/>
</robot>
"""


def srdf_of(tmp_path, state=(0.1, -0.5, 0.2, 1.2, 0, 0.7)):
    links = "".join(f'<link name="r_link{k}"/>' for k in range(6))
    both = [
        f'<joint name="{side}_joint{k}" value="{value}"/>' for side in "lr" for k, value in enumerate(state)
    ]
    text = SRDF.replace("LINKS", links).replace("STATES", "".join(both))
    return written(tmp_path, text, "moveit.srdf")


def two_arms(tmp_path):
    arms = [arm(f"{side}_", "base", (0, y, 0.15), gripper=(0, 0, 1)) for side, y in (("l", 0.4), ("r", -0.4))]
    return written(tmp_path, urdf(link("base"), *arms))


def test_groups_of_an_srdf_name_the_joints_of_chains_links_and_groups(tmp_path):
    """Of a group that names itself as well."""
    tree = tree_of(Path(two_arms(tmp_path)).read_text())
    groups = tree.groups(ET.parse(srdf_of(tmp_path)).getroot())
    assert groups["left_manipulator"] == {f"l_joint{k}" for k in range(6)}
    assert groups["by links"] == {f"r_joint{k}" for k in range(6)}
    assert groups["everything"] == groups["left_manipulator"] | {"l_slide_a", "l_slide_b"}


def test_arms_are_called_as_the_groups_of_an_srdf_and_are_home_in_a_state(tmp_path):
    """The pairs of the SRDF are left out as well; a state that is not there is refused."""
    file = tmp_path / "pair.yaml"
    found = propose([two_arms(tmp_path)], file, srdf=srdf_of(tmp_path), home_state="ready")
    assert list(found.data["arms"]) == ["left_manipulator", "by_links"]
    home = [0.1, -0.5, 0.2, 1.2, 0, 0.7]
    assert found.robot.arm("left_manipulator").home == pytest.approx(home)
    assert found.robot.arm("by_links").home == pytest.approx(home)
    assert frozenset(("base", "l_link3")) in found.robot.sources[0].srdf.disabled
    with pytest.raises(RobotError, match=r"no group state 'redy'.*did you mean 'ready'"):
        propose([two_arms(tmp_path)], file, srdf=srdf_of(tmp_path), home_state="redy")


def test_an_arm_without_a_group_of_its_joints_is_told(tmp_path):
    path = Path(srdf_of(tmp_path))
    path.write_text(path.read_text().replace('<link name="r_link5"/>', ""))
    found = propose([two_arms(tmp_path)], tmp_path / "pair.yaml", srdf=str(path), home_state="ready")
    assert list(found.data["arms"]) == ["left_manipulator", "right"]
    assert any("no group of the SRDF has just the joints r_joint0" in note for note in found.notes)
