"""A made-up robot of two arms, altered in many ways: what is read is read right, all else is told in a sentence.

The advice of a message is followed wherever it says what to write.
"""

import re
import warnings
import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest
import yaml

from comove.errors import ComoveWarning, RobotError
from comove.robots import Robot
from comove.robots.soundness import NUMBERS
from tests.robots.small_robots import written

INERTIAL = (
    '<inertial><origin xyz="0 0 0.02" rpy="0 0 0.1"/><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" '
    'iyz="0" izz="0.01"/></inertial>'
)
BODY = (
    '<collision><origin xyz="0 0 0.05" rpy="0 0 0.2"/><geometry>{}</geometry></collision>'
    '<visual><origin xyz="0 0 0.05" rpy="0 0 0.3"/><geometry>{}</geometry>'
    '<material name="grey"><color rgba="0.5 0.5 0.5 1"/></material></visual>'
)
SHAPES = (
    '<cylinder radius="0.04" length="0.1"/>',
    '<box size="0.05 0.06 0.1"/>',
    '<sphere radius="0.05"/>',
    '<mesh filename="tetrahedron.obj" scale="0.05 0.05 0.05"/>',
)
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
AXES = ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1")
PLACES = ("0 {y} 0.5", "0 0 0.08", "0 0 0.28", "0 0 0.08", "0 0 0.24", "0 0 0.06")
ARMS = {"left": {"tip": "left_hand"}, "right": {"tip": "right_hand"}}
TAIL = (
    '<dynamics damping="0.1" friction="0.2"/><calibration rising="0"/>'
    '<safety_controller soft_lower_limit="-2.5" soft_upper_limit="2.5" k_position="20" k_velocity="10"/>'
)


def arm(side: str, y: float) -> str:
    """Links and joints of an arm with a hand and two fingers, one of which follows the other."""
    parts, before = [], "base"
    for k, (axis, place) in enumerate(zip(AXES, PLACES, strict=True)):
        shape = SHAPES[k % len(SHAPES)]
        name = f"{side}_l{k + 1}"
        parts.append(
            f'<link name="{name}">{INERTIAL}{BODY.format(shape, shape)}</link><joint name="{side}_j{k + 1}" '
            f'type="revolute"><parent link="{before}"/><child link="{name}"/><origin xyz="{place.format(y=y)}" '
            f'rpy="0 0 0.1"/><axis xyz="{axis}"/><limit lower="-2.8" upper="2.8" velocity="2" effort="100" '
            f'drake:acceleration="2.5"/>{TAIL}</joint>'
        )
        before = name
    parts.append(
        f'<link name="{side}_hand">{INERTIAL}</link><joint name="{side}_wrist" type="fixed"><parent link="{before}"/>'
        f'<child link="{side}_hand"/><origin xyz="0 0 0.05"/></joint>'
    )
    for finger, mimic in (("a", ""), ("b", f'<mimic joint="{side}_a" multiplier="-1" offset="0.01"/>')):
        parts.append(
            f'<link name="{side}_finger_{finger}">{INERTIAL}</link><joint name="{side}_{finger}" type="prismatic">'
            f'<parent link="{side}_hand"/><child link="{side}_finger_{finger}"/><axis xyz="0 1 0"/><limit '
            f'lower="-0.04" upper="0.04" velocity="0.2" effort="70"/>{mimic}</joint>'
        )
    return "".join(parts)


TOY = (
    '<robot name="toy"><material name="blue"><color rgba="0 0 1 1"/></material><link name="base"><collision>'
    f'<geometry><box size="0.2 0.8 0.4"/></geometry></collision></link>{arm("left", 0.35)}{arm("right", -0.35)}'
    "</robot>"
)


def load(folder, text=TOY, srdf=None, arms=ARMS, **more):
    """The robot of a URDF; warnings are collected in `load.said`."""
    (folder / "tetrahedron.obj").write_text(TETRAHEDRON, encoding="utf-8")
    model, files = {"urdf": "r.urdf"}, {"r.urdf": text}
    if srdf is not None:
        files["r.srdf"], model["srdf"] = f'<robot name="toy">{srdf}</robot>', "r.srdf"
    model |= more.pop("model", {})
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        machine = Robot.load(written(folder, files, {"models": [model], "arms": arms, **more}))
    load.said = [str(warning.message) for warning in caught]
    return machine


def refused(folder, text=TOY, **more):
    """The message with which a robot is refused: one sentence with the file's name, and what to do after `; `."""
    with pytest.raises(RobotError) as caught:
        load(folder, text, **more)
    message = str(caught.value)
    assert str(folder) in message
    assert "\n" not in message
    assert "; " in message
    return message


def test_the_robot_is_sound_as_it_is(tmp_path):
    machine = load(tmp_path)
    assert load.said == []
    assert len(machine.joint_names) == 12
    assert (machine.acceleration == 2.5).all()
    assert (machine.upper == 2.5).all()
    assert (machine.approach == 0.05).all()


# --- Attributes that are not what they should be ---

PLACES_OF_NUMBERS = sorted(
    {
        (element.tag, key)
        for element in ET.fromstring(TOY.replace("drake:", "")).iter()
        for key in element.attrib
        if key in NUMBERS.get(element.tag, {}) or key in ("lower", "upper", "velocity", "effort")
    }
)
JUNK = (
    "1.57, 1.3 ..", "nan", "inf", "-inf", "1e999", "\u22121.5", "", " ", "abc", "1_0", "0x10",
    "1 2 3 4 5 6 7", "--1", "1e", "\u0661", "1.2.3", "0,5", "0, 1, 0", "1;2;3", "1.0f", "0 0 nan", "NaN 0 0",
)  # fmt: skip


def with_value(tag, key, value, which=0):
    """The robot with another value of an attribute, in its element number `which`; and its true value."""
    attribute = f"drake:{key}" if key == "acceleration" else key
    found = list(re.finditer(rf'(<{tag}\b[^>]*?\b{attribute}=")([^"]*)(")', TOY))
    place = found[which % len(found)]
    escaped = value.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    return TOY[: place.start(2)] + escaped + TOY[place.end(2) :], place.group(2)


@pytest.mark.parametrize(("tag", "key"), PLACES_OF_NUMBERS)
def test_every_number_that_is_none_is_told_with_its_place_and_value(tag, key, tmp_path):
    for which, values in ((0, JUNK), (-1, JUNK[:3])):
        for value in values:
            text, right = with_value(tag, key, value, which)
            if value == right:
                continue
            message = refused(tmp_path, text)
            assert key in message
            named = ("link '", "joint '", "material '")
            assert any(name in message for name in named) or ("$" in value and "it is a xacro" in message)
            if value.isascii() and len(value) > 2:
                assert value in message.replace("\\", "")
            if which == 0 and value in JUNK[6:]:
                follow(tmp_path, text, message, key, right)


def follow(folder, text, message, key, right):
    """Do as a message says, where it says what to write; then that is no longer wrong."""
    way_out = message.rpartition("; ")[2]
    written_out = re.search(rf'write [\w:]*{key}="([^"]*)"', way_out)
    if written_out:
        old = re.search(r"<\w+ [\w:]+='(.*)'>; ", message)
        corrected = text.replace(f'"{old.group(1)}"', f'"{written_out.group(1)}"', 1) if old else text
        if corrected != text:
            try:
                load(folder, corrected)
            except RobotError as error:  # a number, but none that is possible there
                assert f"{key}=" not in str(error)
    if "limits: {" in way_out:
        given = yaml.safe_load(way_out[way_out.index("limits: ") :].replace("NUMBER", right))["limits"]
        load(folder, text, limits=given)


@pytest.mark.parametrize(("tag", "key"), PLACES_OF_NUMBERS)
def test_numbers_may_be_written_in_every_way_that_urdfs_have(tag, key, tmp_path):
    _, right = with_value(tag, key, "")
    numbers = [float(part) for part in right.split()]
    for style in ("{:.6e}", " {:+.9f} ", "{:.12g}\n"):
        if key == "rgba":
            continue
        load(tmp_path, with_value(tag, key, " ".join(style.format(number) for number in numbers))[0])


# --- Markup ---


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text,
        lambda text: text.replace("<robot ", '<robot xmlns:drake="http://drake.mit.edu" '),
        lambda text: text.replace("<robot ", '<robot xmlns="http://www.ros.org" '),
        lambda text: text.replace("drake:acceleration", "acceleration"),
        lambda text: text.replace("</robot>", "<drake:collision_filter_group name='a'/></robot>"),
        lambda text: text.replace("</collision>", "<drake:proximity_properties/></collision>"),
        lambda text: text.replace("</visual>", "<drake:accepting_renderer name='a'/></visual>"),
        lambda text: text.replace("<robot ", '<robot xmlns:xacro="http://ros.org/wiki/xacro" '),
        lambda text: '<?xml version="1.0" encoding="utf-8"?>\n<!-- made by hand -->\n' + text,
        lambda text: "\ufeff" + text,
        lambda text: text.replace("><", ">\n  <"),
        lambda text: text.replace("</robot>", "<gazebo reference='base'><a:b c:d='e'/></gazebo></robot>"),
        lambda text: text.replace("</robot>", "<transmission name='t'><type>x</type></transmission></robot>"),
    ],
)
def test_other_markup_changes_nothing(change, tmp_path):
    machine, plain = load(tmp_path, change(TOY)), load(tmp_path)
    assert (machine.acceleration == 2.5).all()
    q = np.linspace(-1, 1, 12)
    for arm_a, arm_b in zip(machine.arms, plain.arms, strict=True):
        np.testing.assert_array_equal(machine.tool_pose(q, arm_a), plain.tool_pose(q, arm_b))
    again = ET.fromstring(machine.sources[0].urdf)  # it can be read by any reader
    assert again.tag == "robot"


def test_the_least_acceleration_and_jerk_that_are_stated_bind(tmp_path):
    text = TOY.replace('drake:acceleration="2.5"', 'acceleration="4" deceleration="3" jerk="50"', 1)
    machine = load(tmp_path, text)
    assert machine.acceleration[0] == 3.0
    assert machine.acceleration[1] == 2.5
    assert machine.jerk[0] == 50.0
    assert np.isinf(machine.jerk[1:]).all()
    given = {"left_j1": {"acceleration": 1.0, "jerk": 10.0}}
    machine = load(tmp_path, text, limits=given)
    assert (machine.acceleration[0], machine.jerk[0]) == (1.0, 10.0)
    free = load(tmp_path, TOY.replace('drake:acceleration="2.5"', ""), acceleration=7.0)
    assert (free.acceleration == 7.0).all()


JOINT = re.search(r'type="revolute".*?k_velocity="10"/>', TOY).group(0)  # the first one
IN_DEGREES = JOINT.replace("2.8", "160").replace("2.5", "160")
IN_MILLIMETRES = JOINT.replace("revolute", "prismatic").replace("2.8", "400").replace("2.5", "400")


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('drake:acceleration="2.5"', 'drake:acceleration="0"', "has the acceleration limit 0"),
        ('drake:acceleration="2.5"', 'drake:acceleration="-2"', "has the acceleration limit -2"),
        ('drake:acceleration="2.5"', 'jerk="0"', "has the jerk limit 0"),
        (SHAPES[0], '<drake:capsule radius="0.1" length="0.2"/>', "has the shape <drake:capsule>"),
        (' name="left_j1"', ' name="left_j1" name="x"', "duplicate attribute"),
        ("</robot>", "", "it is not XML"),
        ("</robot>", "<xacro:arm/></robot>", "it is a xacro"),
        # limits
        (JOINT, IN_DEGREES, "{lower: -2.79253, upper: 2.79253}"),
        (JOINT, IN_MILLIMETRES, "{lower: -0.4, upper: 0.4}"),
        ('lower="-2.8" upper="2.8"', 'lower="2.8" upper="-2.8"', "has the limits 2.8 to -2.8"),
        ('lower="-2.8" upper="2.8"', 'lower="1" upper="1"', "has the limits 1 to 1"),
        (' velocity="2"', "", "velocity is missing"),
        (' effort="100"', "", "effort is missing"),
        ('velocity="2"', 'velocity="-2"', "velocity is '-2'"),
        ('velocity="2"', 'velocity="0"', "has the velocity limit 0"),
        ('effort="100"', 'effort="0"', "has the effort limit 0"),
        ('soft_upper_limit="2.5"', 'soft_upper_limit="-2.6"', "which leave nothing of its limits"),
        # what cannot be
        ('axis xyz="0 0 1"', 'axis xyz="0 0 0"', "axis of the joint 'left_j1' has no direction"),
        ('axis xyz="0 0 1"', 'axis xyz="0, 0, 1"', 'write xyz="0 0 1"'),
        ('axis xyz="0 0 1"', 'axis xyz="0 0 1 0"', "write three numbers with blanks between"),
        ('xyz="0 0.35 0.5"', 'xyz="0 350 5000"', "has an origin at 0 350 5000"),
        ('rpy="0 0 0.1"', 'rpy="0 0 9000"', "is turned by 0 0 9000"),
        ('mass value="1"', 'mass value="-1"', "has the mass -1 kg"),
        ('mass value="1"', 'mass value="1e7"', "has the mass 1e+07 kg"),
        ('ixx="0.01"', 'ixx="1e7"', "moments of inertia"),
        ('cylinder radius="0.04"', 'cylinder radius="0"', "<cylinder> with the radius '0'"),
        ('cylinder radius="0.04"', 'cylinder radius="-1"', "<cylinder> with the radius '-1'"),
        ('box size="0.05 0.06 0.1"', 'box size="0.05 0 0.1"', "<box> with the size '0.05 0 0.1'"),
        ('scale="0.05 0.05 0.05"', 'scale="0 1 1"', "<mesh> with the scale '0 1 1'"),
        ('scale="0.05 0.05 0.05"', 'scale="0.05"', "write three numbers"),
        ('filename="tetrahedron.obj"', 'filename="missing.obj"', "there is no file 'missing.obj'"),
        # what is missing
        ('<mass value="1"/>', "<mass/>", "'left_l1' has <mass> without value; write value: one number [kg]"),
        ('<mass value="1"/>', "", "the link 'left_l1' has an <inertial> without <mass>"),
        (' ixz="0"', "", "the link 'left_l1' has <inertia> without ixz"),
        (' radius="0.04"', "", "the link 'left_l1' has <cylinder> without radius"),
        ('<axis xyz="0 0 1"/>', "<axis/>", "the joint 'left_j1' has <axis> without xyz"),
        # names and trees
        ('<child link="left_l1"/>', '<child link="left_l9"/>', "left_l9"),
        ('<child link="left_l1"/>', '<child link="base"/>', ""),
        ('<parent link="base"/>', '<parent link="left_l6"/>', "circle"),
        ('joint name="left_j2"', 'joint name="left_j1"', "left_j1"),
        ('link name="left_l2"', 'link name="left_l1"', "'left_l2', which is not there"),
        ('joint name="left_j1"', 'joint name=""', "a joint has the name ''"),
        ('joint name="left_j1"', 'joint name="universe"', "Pinocchio's own"),
        ('type="revolute"', 'type="ball"', "ball"),
        # joints that arms cannot have
        ('type="revolute"', 'type="continuous"', "turns without end"),
        ("<dynamics", '<mimic joint="left_j2"/><dynamics', "goes along with 'left_j2', which no arm here can"),
        ("<dynamics", '<mimic joint="left_j1"/><dynamics', "goes along with itself"),
        ('mimic joint="left_a"', 'mimic joint="nothing"', "goes along with 'nothing', which is not there"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_told(old, new, told, tmp_path):
    assert old in TOY
    message = refused(tmp_path, TOY.replace(old, new, 1))
    assert told in message
    if "limits: {" in message:
        given = yaml.safe_load(message[message.index("limits: {") :].replace("NUMBER", "1.5"))["limits"]
        load(tmp_path, TOY.replace(old, new, 1), limits=given)
    if "posture: {" in message:
        given = yaml.safe_load(message[message.index("posture: {") :])["posture"]
        load(tmp_path, TOY.replace(old, new, 1), posture=given)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"ixx": "-0.01"}, "none can be negative"),
        ({"ixy": "0.5"}, "none can be negative"),
        ({"izz": "0.5"}, "moments of inertia that no body has"),
        ({"ixx": "0", "iyy": "0", "izz": "0"}, "moments of inertia that no body has"),
        ({"izz": "0.0200001"}, None),
    ],
)
def test_inertias_that_no_body_has_are_told(changes, told, tmp_path):
    text = TOY
    for key, value in changes.items():
        text = re.sub(rf'{key}="[^"]*"', f'{key}="{value}"', text)
    load(tmp_path, text)
    assert bool(load.said) == (told is not None)
    assert all(told in said for said in load.said)


# --- Joints of several degrees of freedom, and lifts ---


def on_a_joint(kind, inside=""):
    """The robot on a joint between the ground and its base."""
    joint = (
        f'<link name="ground"/><joint name="below" type="{kind}"><parent link="ground"/><child link="base"/>'
        f'<origin xyz="1 0 0" rpy="0 0 1.5"/><axis xyz="0 0 1"/>{inside}</joint>'
    )
    return TOY.replace("</robot>", f"{joint}</robot>")


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_a_base_that_floats_stays_where_the_description_says(kind, tmp_path):
    text, q = on_a_joint(kind), np.linspace(-1, 1, 12)
    fixed, machine = load(tmp_path, on_a_joint("fixed")), load(tmp_path, text)
    (said,) = load.said
    assert f"the {kind} joint 'below' does not move" in said
    np.testing.assert_array_equal(machine.tool_pose(q, machine.arms[0]), fixed.tool_pose(q, fixed.arms[0]))
    advised = yaml.safe_load(said[said.index("poses: ") :])
    load(tmp_path, text, **advised)
    assert load.said == []
    turn = [float(np.cos(0.2)), 0.0, 0.0, float(np.sin(0.2))]
    moved = load(tmp_path, text, poses={"below": {"position": [0.1, 0.2, 0.0], "quaternion_wxyz": turn}})
    there = pin.SE3(pin.rpy.rpyToMatrix(0, 0, 1.5), np.array([1.0, 0, 0]))
    pose = pin.SE3(pin.Quaternion(turn[0], *turn[1:]).matrix(), np.array([0.1, 0.2, 0.0]))
    plain = load(tmp_path)
    np.testing.assert_allclose(
        moved.tool_pose(q, moved.arms[1]),
        (there * pose).homogeneous @ plain.tool_pose(q, plain.arms[1]),
        atol=1e-12,
    )


@pytest.mark.parametrize("key", ["posture", "limits", "springs"])
def test_a_floating_joint_has_no_single_value_and_the_advice_works(key, tmp_path):
    given = {"below": {"velocity": 1.0} if key == "limits" else 0.0}
    message = refused(tmp_path, on_a_joint("floating"), **{key: given})
    load(tmp_path, on_a_joint("floating"), **yaml.safe_load(message[message.index("poses: ") :]))


def test_poses_that_a_joint_cannot_have_are_told(tmp_path):
    assert "leaves its plane" in refused(
        tmp_path, on_a_joint("planar"), poses={"below": {"position": [0, 0, 0.1]}}
    )
    tilted = {"quaternion_wxyz": [float(np.cos(0.1)), float(np.sin(0.1)), 0.0, 0.0]}
    assert "leaves its plane" in refused(tmp_path, on_a_joint("planar"), poses={"below": tilted})
    message = refused(tmp_path, poses={"left_j1": {"position": [0, 0, 0]}})
    assert "no floating or planar joint 'left_j1'" in message


LIFT = '<limit lower="{}" upper="{}" velocity="0.1" effort="500"/>'


@pytest.mark.parametrize(
    ("low", "high"), [(0.1, 0.5), (-0.5, -0.1), (-0.0523598775598, -0.01), (0.1234567891, 1), (-1, 1)]
)
def test_a_lift_that_all_arms_share_stays_where_the_advice_says(low, high, tmp_path):
    text = on_a_joint("prismatic", LIFT.format(low, high))
    message = refused(tmp_path, text)
    assert "the arms 'left' and 'right' share the joint 'below'" in message
    machine = load(tmp_path, text, **yaml.safe_load(message[message.index("posture: {") :]))
    assert low - 1e-9 <= machine.description.posture["below"] <= high + 1e-9
    assert abs(machine.description.posture["below"]) == pytest.approx(max(0.0, low, -high))


def test_a_joint_of_an_arm_whose_range_does_not_include_0_has_a_home(tmp_path):
    machine = load(tmp_path, TOY.replace('lower="-2.8" upper="2.8"', 'lower="0.4" upper="2.8"', 1))
    assert machine.home[0] == pytest.approx(0.5 * (0.4 + 2.5))


# --- SRDFs ---


def pairs_of(machine):
    """Pairs of links that are compared."""
    geometry, frames = machine.collision, machine.model.frames
    ends = [(pair.first, pair.second) for pair in geometry.collisionPairs]
    name = [frames[item.parentFrame].name for item in geometry.geometryObjects]
    return {frozenset((name[a], name[b])) for a, b in ends}


def pair(first, second):
    return f'link1="{first}" link2="{second}"'


@pytest.mark.parametrize("prefix", ["", "one_"])
def test_default_collisions_of_moveit_are_disabled_and_enabled(prefix, tmp_path):
    arms = {name: {"tip": prefix + arm["tip"]} for name, arm in ARMS.items()}
    more = {"model": {"prefix": prefix}, "arms": arms}
    links = [prefix + name for name in ("left_l6", "right_l6", "right_l4", "left_l5", "left_l3")]
    free = pairs_of(load(tmp_path, **more))
    srdf = '<disable_default_collisions link="left_l6"/>'
    of_hand = {found for found in free if links[0] in found}
    assert len(of_hand) > 5
    assert pairs_of(load(tmp_path, srdf=srdf, **more)) == free - of_hand
    srdf += f"<enable_collisions {pair('left_l6', 'right_l6')}/><enable_collisions {pair('right_l4', 'left_l6')}/>"
    kept = {frozenset((links[0], links[1])), frozenset((links[0], links[2]))}
    assert pairs_of(load(tmp_path, srdf=srdf, **more)) == (free - of_hand) | kept
    srdf += f"<disable_collisions {pair('right_l6', 'left_l6')} reason='Never'/>"
    assert pairs_of(load(tmp_path, srdf=srdf, **more)) == (free - of_hand) | {frozenset((links[0], links[2]))}
    neighbours = frozenset((links[0], links[3]))
    assert neighbours not in free
    assert pairs_of(load(tmp_path, srdf=f"<enable_collisions {pair('left_l6', 'left_l5')}/>", **more)) == (
        free | {neighbours}
    )


STATES = (
    '<group_state name="ready" group="left_arm">'
    + "".join(f'<joint name="left_j{k}" value="0.{k}"/>' for k in range(1, 7))
    + '</group_state><group_state name="ready" group="right_arm">'
    + "".join(f'<joint name="right_j{k}" value="-0.{k}"/>' for k in range(1, 7))
    + '</group_state><group_state name="open" group="hands"><joint name="left_a" value="0.03"/>'
    '<joint name="right_a" value="0.02"/><joint name="left_j1" value="1"/></group_state>'
    '<group_state name="there" group="base"><joint name="virtual" value="0 0 0"/></group_state>'
)


def test_group_states_are_homes_and_postures(tmp_path):
    arms = {name: {**arm, "home_state": "ready"} for name, arm in ARMS.items()}
    machine = load(tmp_path, srdf=STATES, arms=arms, states=["open", "there"], posture={"right_a": 0.01})
    assert load.said == []
    np.testing.assert_allclose(machine.arms[0].home, 0.1 * np.arange(1, 7))
    np.testing.assert_allclose(machine.arms[1].home, -0.1 * np.arange(1, 7))
    posture = machine.description.posture
    assert (posture["left_a"], posture["right_a"]) == (0.03, 0.01)
    assert posture["left_b"] == pytest.approx(-0.03 + 0.01)
    given = {"left": {**arms["left"], "home": [0.0] * 6}, "right": arms["right"]}
    assert (load(tmp_path, srdf=STATES, arms=given).arms[0].home == 0).all()


@pytest.mark.parametrize(
    ("srdf", "more", "told"),
    [
        (STATES, {"home": "raedy"}, "there is no group state 'raedy' in the SRDFs; did you mean 'ready'?"),
        ("", {"home": "ready"}, "there is no group state 'ready' in the SRDFs; give values"),
        (STATES, {"home": "open"}, "has no values for left_j2, left_j3, left_j4, left_j5, left_j6"),
        (
            STATES.replace("0.6", "3"),
            {"home": "ready"},
            "joint 6 is at 3 at home, outside its limits; keep it",
        ),
        (
            STATES.replace("0.6", "up"),
            {"home": "ready"},
            "'ready' has the joint 'left_j6' at 'up'; write a number",
        ),
        (STATES, {"states": ["close"]}, "there is no group state 'close' in the SRDFs"),
        (STATES.replace("0.03", "0.3"), {"states": ["open"]}, "'left_a' stays at 0.3, outside its limits"),
        (
            STATES + STATES.replace("0.2", "0.4"),
            {"home": "ready"},
            "'ready' has 2 values for the arm's joints",
        ),
        ("<disable_default_collisions/>", {}, "does not name a link"),
        ('<enable_collisions link1="base"/>', {}, "<enable_collisions> does not name two links"),
        ('<disable_collisions link2="base"/>', {}, "<disable_collisions> does not name two links"),
    ],
)
def test_an_srdf_that_does_not_fit_is_told(srdf, more, told, tmp_path):
    arms = ARMS
    if "home" in more:
        arms = {name: {**arm, "home_state": more["home"]} for name, arm in ARMS.items()}
    states = {key: value for key, value in more.items() if key == "states"}
    assert told in refused(tmp_path, srdf=srdf, arms=arms, **states)


def test_a_warning_is_a_warning_of_comove(tmp_path):
    with pytest.warns(ComoveWarning):
        Robot.load(
            written(tmp_path, {"r.urdf": on_a_joint("floating").replace(SHAPES[3], SHAPES[2])},
                    {"models": [{"urdf": "r.urdf"}], "arms": ARMS})
        )  # fmt: skip
