"""Robots as their models tell it, against Pinocchio's reading of each model alone; and models that cannot be used."""

import copy
import math
import os
import subprocess
import sys
import warnings

import coal
import numpy as np
import pinocchio as pin
import pytest
import yaml

from comove.errors import ComoveWarning, RobotError
from comove.robots import Robot
from comove.robots.description import find_description
from comove.robots.urdf import resolve
from tests.geometry.triangles.written import WEDGE
from tests.robots.raw_links import RawLinks
from tests.robots.small_robots import BUNDLED, EXAMPLES, random_arms, robot, urdf, written

LIMIT = '<limit lower="-1" upper="2" effort="3" velocity="4"/>'
ENDLESS = '<limit effort="3" velocity="4"/>'
MASS = (
    '<inertial><mass value="1"/><inertia ixx=".1" ixy="0" ixz="0" iyy=".1" iyz="0" izz=".1"/></inertial>'
    '<collision><geometry><sphere radius="0.05"/></geometry></collision>'
)
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"


def joint(name, parent, child, kind="revolute", inside=LIMIT, axis="0 0 1", xyz="0.3 0 0.1"):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>{inside}</joint>'
    )


def link(name, inside=MASS):
    return f'<link name="{name}">{inside}</link>'


def two_joints(first=LIMIT, kind="revolute", body=MASS, more=""):
    """An arm of two joints, the first of which is as a test wants it."""
    return urdf(
        link("upper", body)
        + joint("shoulder", "base", "upper", kind, first)
        + link("hand")
        + joint("elbow", "upper", "hand", axis="0 1 0")
        + more
    )


def load(folder, text=None, arms=None, models=None, **more):
    """A robot with the arm of two joints, unless told otherwise."""
    description = {
        "models": models or [{"urdf": "r.urdf"}],
        "arms": {"left": {"tip": "hand"}} if arms is None else arms,
        **more,
    }
    return Robot.load(written(folder, {"r.urdf": two_joints() if text is None else text}, description))


def poses(model, q, names):
    """Where frames are, by Pinocchio."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return [data.oMf[model.getFrameId(name)].homogeneous for name in names]


# --- What a robot is ---


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_arms_and_bodies_are_where_their_models_and_bases_put_them(seed, tmp_path):
    """The third arm is of a second model that has its own base and prefix."""
    machine, rng = Robot.load(random_arms(tmp_path, seed)), np.random.default_rng(seed)
    raw, state, placed = RawLinks(machine), machine.model.createData(), machine.collision.createData()
    assert [arm.name for arm in machine.arms] == ["b", "a", "c"]
    assert machine.collision.ngeoms == (1 + 7 + 6) + (1 + 8)
    for q in rng.uniform(machine.lower, machine.upper, (5, len(machine.lower))):
        for arm in machine.arms:
            np.testing.assert_allclose(
                machine.tool_pose(q, arm), raw.grasp(arm.name, q).homogeneous, atol=1e-12
            )
        names = ("base", "other_base")
        wanted = [raw.frame(name, q).homogeneous for name in names]
        np.testing.assert_allclose(poses(machine.model, q, names), wanted, atol=1e-12)
        pin.updateGeometryPlacements(machine.model, state, machine.collision, placed, q)
        for name, _, pose, _ in raw.bodies(q):
            number = machine.collision.getGeometryId(name)
            np.testing.assert_allclose(placed.oMg[number].homogeneous, pose.homogeneous, atol=1e-12)


def test_columns_lead_from_base_to_tip(tmp_path):
    machine = Robot.load(random_arms(tmp_path, 0))
    for arm, letter, count in zip(machine.arms, ("b", "a", "other_a"), (6, 7, 8), strict=True):
        names = [machine.joint_names[column] for column in arm.columns]
        assert names == [f"{letter}_j{k}" for k in range(count)]
    assert sorted(np.concatenate([arm.columns for arm in machine.arms])) == list(range(21))


@pytest.mark.parametrize("name", BUNDLED)
@pytest.mark.few(3)
def test_bodies_of_all_models_are_kept_apart_from_each_other(name):
    machine = robot(name)
    bodies = machine.collision.geometryObjects
    kept = {frozenset((p.first, p.second)) for p in machine.collision.collisionPairs}
    for pair in kept:
        assert len({bodies[k].parentJoint for k in pair}) == 2
    if name == "baxter":
        assert len(kept) == 509
    else:  # every body of one model against every body of the other
        first = [k for k, b in enumerate(bodies) if b.name.startswith(machine.description.models[0].prefix)]
        others = set(range(len(bodies))) - set(first)
        moves = [(i, j) for i in first for j in others if bodies[i].parentJoint or bodies[j].parentJoint]
        assert all(frozenset(pair) in kept for pair in moves)


def test_pairs_are_all_but_neighbours_and_what_the_srdf_leaves_out_whatever_the_prefix(tmp_path):
    more = link("far") + joint("wrist", "hand", "far") + link("end") + joint("last", "far", "end")
    (tmp_path / "r.srdf").write_text(
        '<robot name="r"><disable_collisions link1 = "upper"\n link2=\'far\' reason="Never"/></robot>',
        encoding="utf-8",
    )
    found = []
    for srdf in (None, "r.srdf"):
        model = {"urdf": "r.urdf", "prefix": "p_"} | ({} if srdf is None else {"srdf": srdf})
        machine = load(tmp_path, two_joints(more=more), {"left": {"tip": "p_end"}}, [model])
        names = [item.name for item in machine.collision.geometryObjects]
        found.append(
            {tuple(sorted((names[p.first], names[p.second]))) for p in machine.collision.collisionPairs}
        )
    assert found[0] == {("p_far_0", "p_upper_0"), ("p_end_0", "p_upper_0"), ("p_end_0", "p_hand_0")}
    assert found[1] == found[0] - {("p_far_0", "p_upper_0")}


def test_limits_are_the_urdfs_unless_the_description_gives_others(tmp_path):
    given = {"elbow": {"upper": 0.5, "velocity": 1.5, "acceleration": 7}}
    machine = load(tmp_path, limits=given, acceleration=2.0)
    np.testing.assert_array_equal(machine.lower, [-1, -1])
    np.testing.assert_array_equal(machine.upper, [2, 0.5])
    np.testing.assert_array_equal(machine.velocity, [4, 1.5])
    np.testing.assert_array_equal(machine.effort, [3, 3])
    np.testing.assert_array_equal(machine.acceleration, [2, 7])


def test_a_joint_that_turns_without_end_may_be_given_limits(tmp_path):
    text = two_joints(ENDLESS, "continuous")
    machine = load(tmp_path, text, limits={"shoulder": {"lower": -6, "upper": 6}})
    assert (machine.lower[0], machine.upper[0], machine.velocity[0]) == (-6, 6, 4)


def test_home_is_in_the_middle_unless_given(tmp_path):
    np.testing.assert_array_equal(load(tmp_path).home, [0.5, 0.5])
    given = {"left": {"tip": "hand", "home": [-1, 0.25]}}
    np.testing.assert_array_equal(load(tmp_path, arms=given).home, [-1, 0.25])


def test_springs_and_fingers_are_the_descriptions(tmp_path):
    more = link("finger") + joint("grip", "hand", "finger", "prismatic")
    arms = {"left": {"tip": "hand", "fingers": ["grip"]}}
    machine = load(tmp_path, two_joints(more=more), arms, springs={"elbow": 0.25})
    np.testing.assert_array_equal(machine.relief, [0, 0.25])
    assert machine.arm("left").fingers == ("grip",)
    assert machine.joint_names == ("shoulder", "elbow")


@pytest.mark.parametrize("kind", ["revolute", "prismatic", "continuous"])
def test_joints_of_the_posture_stay_where_it_says(kind, tmp_path):
    """The torso that two arms share stays, and its bodies with it."""
    inside = ENDLESS if kind == "continuous" else LIMIT
    text = urdf(
        link("torso")
        + joint("lift", "base", "torso", kind, inside)
        + "".join(
            link(f"{side}_arm") + joint(f"{side}_joint", "torso", f"{side}_arm", axis="0 1 0", xyz=f"0 {y} 0.5")
            for side, y in (("left", 0.2), ("right", -0.2))
        )
    )  # fmt: skip
    arms = {side: {"tip": f"{side}_arm"} for side in ("left", "right")}
    machine = load(tmp_path, text, arms, posture={"lift": 0.7})
    assert machine.joint_names == ("left_joint", "right_joint")
    whole = pin.buildModelFromUrdf(str(tmp_path / "r.urdf"))
    q = np.array([0.3, -0.4])
    lift = [np.cos(0.7), np.sin(0.7)] if kind == "continuous" else [0.7]
    wanted = poses(whole, np.array([*lift, *q]), ("left_arm", "right_arm"))
    for arm, pose in zip(machine.arms, wanted, strict=True):
        np.testing.assert_allclose(machine.tool_pose(q, arm), pose, atol=1e-12)
    torso = machine.collision.geometryObjects[machine.collision.getGeometryId("torso_0")]
    assert torso.parentJoint == 0
    (pose,) = poses(whole, np.array([*lift, *q]), ("torso",))
    np.testing.assert_allclose(torso.placement.homogeneous, pose, atol=1e-12)


def test_joints_that_nobody_names_stay_as_near_to_zero_as_their_limits_allow(tmp_path):
    more = link("third") + joint("low", "base", "third", inside=LIMIT.replace('"2"', '"-0.5"'))
    machine = load(tmp_path, two_joints(more=more))
    assert machine.description.posture == {"low": -0.5}
    whole = pin.buildModelFromUrdf(str(tmp_path / "r.urdf"))
    named = {"shoulder": 0.2, "elbow": 0.1, "low": -0.5}
    (wanted,) = poses(whole, np.array([named[name] for name in list(whole.names)[1:]]), ("third",))
    (found,) = poses(machine.model, np.array([0.2, 0.1]), ("third",))
    np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_a_joint_that_mimics_another_goes_along_with_the_posture(tmp_path):
    mimic = LIMIT + '<mimic joint="grip" multiplier="-2" offset="0.1"/>'
    more = (
        link("one") + joint("grip", "hand", "one") + link("two") + joint("other", "hand", "two", inside=mimic)
    )
    machine = load(tmp_path, two_joints(more=more), posture={"grip": 0.3})
    assert machine.description.posture["other"] == pytest.approx(-0.5)
    whole = pin.buildModelFromUrdf(str(tmp_path / "r.urdf"))
    named = {"shoulder": 0.2, "elbow": 0.1, "grip": 0.3, "other": -0.5}
    (wanted,) = poses(whole, np.array([named[name] for name in list(whole.names)[1:]]), ("two",))
    (found,) = poses(machine.model, np.array([0.2, 0.1]), ("two",))
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    said = load(tmp_path, two_joints(more=more), posture={"grip": 0.3, "other": 0.0})
    assert said.description.posture["other"] == 0.0


def test_packages_are_found_from_inside_beside_the_description_and_in_ros_path(tmp_path, monkeypatch):
    text = two_joints(body=MASS + shape('<mesh filename="package://my_arm/meshes/a.obj"/>'))
    package = tmp_path / "my_arm"
    for folder in ("urdf", "meshes", "config"):
        (package / folder).mkdir(parents=True)
    (package / "urdf" / "r.urdf").write_text(text, encoding="utf-8")
    (package / "meshes" / "a.obj").write_text(TETRAHEDRON, encoding="utf-8")
    arms = {"left": {"tip": "hand"}}
    inside = {"models": [{"urdf": "../urdf/r.urdf"}], "arms": arms}
    beside = {"models": [{"urdf": "package://my_arm/urdf/r.urdf"}], "arms": arms}
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    robots = [Robot.load(written(package / "config", {}, inside)), Robot.load(written(tmp_path, {}, beside))]
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{tmp_path}")
    robots.append(Robot.load(written(elsewhere, {}, beside)))
    monkeypatch.delenv("ROS_PACKAGE_PATH")
    (tmp_path / "install").mkdir()
    (tmp_path / "install" / "share").symlink_to(tmp_path)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path / 'install'}")
    robots.append(Robot.load(written(elsewhere, {}, beside)))
    for machine in robots:
        assert any(isinstance(b.geometry, coal.BVHModelBase) for b in machine.collision.geometryObjects)
    assert robots[1].sha256 == robots[2].sha256 == robots[3].sha256
    with pytest.raises(RobotError, match="there is no file 'package://other/a"):
        resolve("package://other/a.stl", tmp_path / "r.urdf")


def shape(text):
    return f"<collision><geometry>{text}</geometry></collision>"


def test_the_checksum_tells_robots_apart_by_description_model_srdf_and_meshes(tmp_path):
    text = two_joints(body=MASS + shape('<mesh filename="a.obj"/>'))
    srdf = '<robot name="r"><disable_collisions link1="upper" link2="base"/></robot>'
    model = [{"urdf": "r.urdf", "srdf": "r.srdf"}]

    def digest(mesh=TETRAHEDRON, srdf=srdf, text=text, **more):
        (tmp_path / "a.obj").write_text(mesh, encoding="utf-8")
        (tmp_path / "r.srdf").write_text(srdf, encoding="utf-8")
        return load(tmp_path, text, models=model, **more).sha256

    others = [
        digest(mesh=TETRAHEDRON.replace("v 1", "v 2")),
        digest(srdf=srdf.replace("base", "hand")),
        digest(text=text.replace('mass value="1"', 'mass value="2"')),
        digest(acceleration=4.0),
        digest(),
    ]
    assert len(set(others)) == len(others)
    assert digest() == others[-1]


def test_a_robot_in_use_is_the_same_when_loaded_again_until_its_files_change(tmp_path):
    """What was computed for it is then known."""
    first = load(tmp_path, two_joints(body=MASS))
    assert load(tmp_path, two_joints(body=MASS)) is first
    other = load(tmp_path, two_joints(body=MASS), acceleration=4.0)
    assert other is not first
    assert other.acceleration.tolist() != first.acceleration.tolist()


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("", ["the arm 'left' has a collision body", "the arm 'left' has a mass"]),
        (
            shape('<sphere radius="0.1"/>'),
            ["guessed from collision bodies, at 1000 kg/m^3: upper 4.19 kg, hand"],
        ),
    ],
)
def test_what_a_model_leaves_out_is_said(body, told, tmp_path):
    text = two_joints(body=body).replace(MASS, body)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load(tmp_path, text)
    assert len(caught) == len(told)
    for warning, words in zip(caught, told, strict=True):
        assert warning.category is ComoveWarning
        assert words in str(warning.message)


# --- What no robot is ---

ARM = {"left": {"tip": "hand"}}
MIMIC = LIMIT + '<mimic joint="elbow"/>'
DEEP = "<a>" * 3000 + "</a>" * 3000


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("hello", ["r.urdf", "it is not XML", "line 1"]),
        ("", ["it is not XML", "no element found"]),
        ("<sdf/>", ["it is an SDF, not a URDF"]),
        ("<svg/>", ["it is a <svg>, not a <robot>"]),
        ('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro/></robot>', ["a xacro", "r.urdf > r"]),
        ('<!DOCTYPE a [<!ENTITY b "c">]><robot name="r">&b;</robot>', ["document type", "leave it out"]),
        (two_joints(more=DEEP), ["nesting is deeper than 64 levels"]),
        ("<robot/>", ["it has no link"]),
        (two_joints(more=link("lonely")), ["links 'base' and 'lonely' both hang on no joint"]),
        (two_joints(more=link("hand")), ["link 'hand' is not unique"]),
        (two_joints().replace('<child link="upper"/>', ""), ["joint 'shoulder' has no <child>"]),
        (two_joints().replace('<parent link="upper"/>', '<parent link="x"/>'), ["'elbow' has the <parent> 'x'"]),
        (two_joints(kind="wobbly"), ["Joint [shoulder] has no known type [wobbly]"]),
        (two_joints(""), ["joint 'shoulder'", "velocity is missing, effort is missing", "limits: {shoulder: {"]),
        (two_joints('<limit lower="-1" upper="1" velocity="1"/>'), ["joint 'shoulder', effort is missing"]),
        (two_joints(LIMIT.replace('"-1"', '"-1,5"')), ["lower is '-1,5'", "limits: {shoulder: {lower: NUMBER}}"]),
        (two_joints(LIMIT.replace('"4"', '"nan"')), ["velocity is 'nan'"]),
        (two_joints(LIMIT.replace('"3"', '"-3"')), ["effort is '-3'"]),
        (two_joints(LIMIT.replace('"3"', '"0"')), ["joint 'shoulder' has the effort limit 0"]),
        (two_joints(LIMIT.replace('"4"', '"0"')), ["joint 'shoulder' has the velocity limit 0"]),
        (two_joints(LIMIT.replace('"2"', '"-1"')), ["joint 'shoulder' has the limits -1 to -1"]),
        (two_joints(ENDLESS, "continuous"), ["turns without end", "limits: {shoulder:"]),
        (two_joints(MIMIC), ["'shoulder' goes along with 'elbow'", "posture: {shoulder: 0}"]),
        (two_joints().replace('axis xyz="0 0 1"', 'axis xyz="0 0 0"'), ["axis of the joint 'shoulder'"]),
        (two_joints().replace('mass value="1"', 'mass value="-1"'), ["the link 'upper' has the mass -1 kg"]),
        (two_joints().replace('mass value="1"', 'mass value="x"'), ["has <mass value='x'>", "write one number"]),
        (two_joints(body=shape("")), ["Geometry tag contains no child element"]),
        (two_joints(body=shape("<torus/>")), ["Unknown geometry type 'torus'"]),
        (two_joints(body=shape('<sphere radius="0"/>')), ["link 'upper' has a <sphere> with the radius '0'"]),
        (two_joints(body=shape('<box size="1 -1 1"/>')), ["<box> with the size '1 -1 1'"]),
        (two_joints(body=shape('<box size="900 1 1"/>')), ["'upper_0' is 900 m wide", "millimetres"]),
        (two_joints(body=shape('<mesh filename="a.stl"/>')), ["r.urdf", "there is no file 'a.stl'"]),
        (two_joints(body=shape('<mesh filename="a.fbx"/>')), ["'a.fbx' has an unknown format", ".obj"]),
        (two_joints(body=shape("<mesh/>")), ["the mesh '' has an unknown format"]),
        (two_joints(body=shape('<mesh filename="ok.obj" scale="0 0 0"/>')), ["<mesh> with the scale '0 0 0'"]),
        (two_joints(body=shape('<mesh filename="ok.obj" scale="1000 1000 1000"/>')), ["m wide", "millimetres"]),
        (two_joints(body=shape('<mesh filename="bad.obj"/>')), ["bad.obj", "line 1: '<nothing' is not known"]),
        (two_joints(body=shape('<mesh filename="claims.stl"/>')), ["claims 1000000000 triangles and holds 1"]),
    ],
)  # fmt: skip
def test_a_urdf_that_cannot_be_used_is_told_in_one_sentence(text, told, tmp_path, capfd):
    (tmp_path / "ok.obj").write_text(TETRAHEDRON, encoding="utf-8")
    (tmp_path / "bad.obj").write_text("<nothing", encoding="utf-8")
    claims = b"\0" * 80 + (10**9).to_bytes(4, "little") + b"\0" * 50  # a thousand million faces, and one
    (tmp_path / "claims.stl").write_bytes(claims)
    refused(tmp_path, told, text)
    assert capfd.readouterr().err == ""


def refused(folder, told, *arguments, **more):
    """Loading says what is wrong."""
    with pytest.raises(RobotError) as caught:
        load(folder, *arguments, **more)
    message = str(caught.value)
    assert "\n" not in message
    assert str(folder) in message
    for part in told:
        assert part in message


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"models": [{"urdf": "x.urdf"}]}, ["robot.yaml", "there is no file 'x.urdf'", "looked in"]),
        ({"models": [{"urdf": "."}]}, ["there is no file '.'"]),
        ({"models": [{"urdf": "r" * 5000}]}, ["there is no file 'rrr", "..."]),
        ({"models": [{"urdf": "package://none/x.urdf"}]}, ["there is no file 'package://none/x.urdf'"]),
        ({"models": [{"urdf": "r.urdf", "srdf": "x.srdf"}]}, ["there is no file 'x.srdf'"]),
        ({"models": [{"urdf": "r.urdf", "srdf": "robot.yaml"}]}, ["robot.yaml", "not an SRDF"]),
        ({"models": [{"urdf": "r.urdf"}, {"urdf": "r.urdf"}]}, ["two models have a link or joint 'base'", "prefix"]),
        ({"arms": {}}, ["arms", "no arm is named"]),
        ({"arms": {"left": {"tip": "hnad"}}}, ["arms.left.tip", "did you mean 'hand'?", "base, upper, hand"]),
        ({"arms": {"left": {"tip": "base"}}}, ["arms.left.tip", "no joint moves the frame 'base'"]),
        ({"arms": ARM | {"right": {"tip": "upper"}}}, ["'left' and 'right' share the joint 'shoulder'", "posture"]),
        ({"arms": {"left": {"tip": "hand", "home": [0]}}}, ["arms.left.home", "1 values, the arm 2 joints"]),
        ({"arms": {"left": {"tip": "hand", "home": [0, 3]}}}, ["joint 2 is at 3", "between -1 and 2"]),
        ({"arms": {"left": {"tip": "hand", "fingers": ["grip"]}}}, ["arms.left.fingers", "no joint 'grip'"]),
        ({"arms": {"left": {"tip": "hand", "fingers": ["elbow"]}}}, ["'elbow' is between the base and the tip"]),
        ({"posture": {"sholder": 0}}, ["posture", "no joint 'sholder'", "did you mean 'shoulder'?"]),
        ({"posture": {"shoulder": 2.5}}, ["posture", "'shoulder' stays at 2.5", "between -1 and 2"]),
        ({"limits": {"elbwo": {"lower": 0}}}, ["limits", "no joint 'elbwo'", "did you mean 'elbow'?"]),
        ({"limits": {"elbow": {"lower": 5}}}, ["limits", "'elbow' has the limits 5 to 2"]),
        ({"springs": {"neck": 0.5}}, ["springs", "no joint 'neck'", "known: shoulder, elbow"]),
        (
            {"uncertainty": {"joints": {"elbwo": 0.01, "shoulder": 0.01}}},
            ["uncertainty.joints", "no joint that moves 'elbwo'", "did you mean 'elbow'?"],
        ),
        (
            {"uncertainty": {"joints": {"shoulder": 0.01}}},
            ["uncertainty.joints", "'elbow' moves and has no deviation", "{elbow: 0.01}", "joints: 0.01"],
        ),
        ({"uncertainty": {"joints": {}}}, ["'shoulder' moves and has no deviation", "joints: 0.005"]),
    ],
)  # fmt: skip
def test_a_description_that_does_not_fit_its_model_is_told_in_one_sentence(more, told, tmp_path):
    refused(tmp_path, told, **more)


SHAPES = [
    {
        "shape": "capsule",
        "center": [0, 0, 0.3],
        "quaternion_wxyz": [1, 0, 0, 0],
        "radius": 0.02,
        "length": 0.1,
    },
    {"shape": "mesh", "file": "part.obj", "scale": 0.01, "center": [0, 0, 0.2]},
    {"shape": "box", "size": [0.1, 0.1, 0.1]},
]
GRIPPER = {
    "shapes": SHAPES,
    "mass": 1,
    "prefix": "g_",
    "mount": {"position": [0, 0, 0.1]},
    "touch_links": ["upper"],
}
HELD = {"urdf": "held.urdf", "srdf": "held.srdf", "prefix": "h_", "mount": {"quaternion_wxyz": [1, 0, 0, 0]}}
FULL = {
    "name": "full",
    "models": [{"urdf": "r.urdf", "prefix": "", "base": {"position": [0, 0, 1], "quaternion_wxyz": [1, 0, 0, 0]}},
               {"urdf": "two.urdf", "prefix": "r_"}],
    "arms": {"left": {"tip": "hand", "tool": {"position": [0, 0, 0.1]}, "home": [0, 0], "fingers": ["grip"],
        "gripper": GRIPPER}, "right": {"tip": "r_hand", "gripper": HELD}},
    "posture": {"grip": 0.1},
    "limits": {"elbow": {"lower": -1, "upper": 1, "velocity": 2, "acceleration": 3, "effort": 4}},
    "acceleration": 5,
    "springs": {"elbow": 0.5},
    "servo": {"stiffness": [100, 100]},
    "uncertainty": {"position": 0.001, "rotation_deg": 0.1, "joints": {
        "shoulder": 0.01, "elbow": 0.01, "r_shoulder": 0.01, "r_elbow": 0.02}},
}  # fmt: skip
JUNK = [None, {}, [], "junk", "", -1, 1e300, math.nan, True, [[1]], {"junk": 1}, "../../x", "a" * 300]


def places(part, path=()):
    """All places of nested data."""
    yield path
    items = part.items() if isinstance(part, dict) else enumerate(part) if isinstance(part, list) else ()
    for key, value in items:
        yield from places(value, (*path, key))


@pytest.mark.parametrize("path", list(places(FULL))[1:], ids=lambda path: ".".join(map(str, path)))
@pytest.mark.filterwarnings("ignore::comove.errors.ComoveWarning")
@pytest.mark.few(16)
def test_every_place_of_a_description_may_hold_junk(path, tmp_path):
    text = two_joints(more=link("finger") + joint("grip", "hand", "finger"))
    (tmp_path / "r.urdf").write_text(text, encoding="utf-8")
    (tmp_path / "two.urdf").write_text(two_joints(), encoding="utf-8")
    (tmp_path / "held.urdf").write_text(f'<robot name="held">{link("palm")}</robot>', encoding="utf-8")
    (tmp_path / "held.srdf").write_text('<robot name="held"/>', encoding="utf-8")
    (tmp_path / "part.obj").write_text(TETRAHEDRON, encoding="utf-8")
    for value in JUNK:
        data = copy.deepcopy(FULL)
        inner = data
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = value
        (tmp_path / "robot.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
        try:
            Robot.load(tmp_path / "robot.yaml")
        except RobotError as error:
            assert str(tmp_path) in str(error)


def test_a_posture_of_a_joint_without_a_single_value_is_told(tmp_path):
    told = ["posture", "'shoulder' floats, or is planar", "poses: {shoulder: {position: [0, 0, 0]}}"]
    with pytest.warns(ComoveWarning, match="planar joint 'shoulder'"):
        refused(tmp_path, told, two_joints("", "planar"), posture={"shoulder": 1})


def test_of_a_link_and_a_joint_of_one_name_the_link_is_the_tip(tmp_path):
    more = link("end") + joint("hand", "hand", "end", "fixed", "").replace(
        "<parent", '<origin xyz="0 0 1"/><parent'
    )
    found = []
    for text in (two_joints(), two_joints(more=more)):
        robot = load(tmp_path, text)
        found.append(robot.tool_pose(robot.home, robot.arms[0]))
    assert found[1] == pytest.approx(found[0])


def test_joints_that_a_moving_joint_takes_along_are_told(tmp_path):
    mimic = LIMIT + '<mimic joint="elbow"/>'
    more = link("rod") + joint("lever", "base", "rod", inside=mimic)
    refused(tmp_path, ["'lever' goes along with 'elbow'", "posture: {lever: 0}"], two_joints(more=more))


def test_a_model_that_is_too_large_is_not_read(tmp_path):
    (tmp_path / "large.urdf").write_bytes(b" " * 20_000_001)
    refused(tmp_path, ["large.urdf", "larger than 20 MB"], models=[{"urdf": "large.urdf"}])


def chain(n):
    """The arm of two joints with a chain of links behind it."""
    parents = ["hand", *(f"l{k}" for k in range(n - 1))]
    return two_joints(
        more="".join(link(f"l{k}", "") + joint(f"f{k}", parents[k], f"l{k}", "fixed", "") for k in range(n))
    )


def test_a_chain_of_almost_a_thousand_links_is_a_robot_like_another(tmp_path):
    assert load(tmp_path, chain(998), {"left": {"tip": "l997"}}).joint_names == ("shoulder", "elbow")


@pytest.mark.parametrize("n", [999, 10_000])
def test_a_chain_in_which_pinocchio_could_drown_is_refused(n, tmp_path):
    refused(tmp_path, ["r.urdf", "more than 1000 joints follow one another"], chain(n))


def test_bodies_and_joints_that_are_too_many_are_refused_at_once(tmp_path):
    bodies = "".join(link(f"l{k}") + joint(f"f{k}", "hand", f"l{k}", "fixed", "") for k in range(3000))
    refused(tmp_path, ["it has 3002 collision bodies, more than 1000"], two_joints(more=bodies))
    joints = "".join(link(f"l{k}", "") + joint(f"f{k}", "hand", f"l{k}") for k in range(3000))
    refused(tmp_path, ["it has 3002 joints that move, more than 1000"], two_joints(more=joints))
    links = "".join(link(f"l{k}", "") + joint(f"f{k}", "hand", f"l{k}", "fixed", "") for k in range(10_001))
    refused(tmp_path, ["it has 10004 links, more than 10000"], two_joints(more=links))


def test_a_thousand_bodies_are_compared_in_pairs_without_delay(tmp_path):
    bodies = "".join(link(f"l{k}") + joint(f"f{k}", "base", f"l{k}", "fixed", "") for k in range(998))
    machine = load(tmp_path, two_joints(more=bodies))
    assert (
        len(machine.collision.collisionPairs) == 998
    )  # of those that stand with the hand; next to them is the arm


def test_a_joint_that_mimics_one_that_mimics_goes_along_whatever_the_order(tmp_path):
    """Each is 0.1 rad further than the one that it follows, which stands after it in the file."""
    more = "".join(link(name) + joint(f"{name}j", "hand", name, inside=LIMIT + inside) for name, inside in (
        ("f", '<mimic joint="gj" offset="0.1"/>'), ("g", '<mimic joint="hj" offset="0.1"/>'), ("h", "")))  # fmt: skip
    posture = load(tmp_path, two_joints(more=more), posture={"hj": 0.5}).description.posture
    assert posture == pytest.approx({"hj": 0.5, "gj": 0.6, "fj": 0.7})


ROUND = link("a") + link("b") + joint("ja", "a", "b") + joint("jb", "b", "a")
INERTIA = 'ixx=".1" ixy="0" ixz="0" iyy=".1" iyz="0" izz=".1"'


def grip(mimic):
    """A finger that goes along with another joint."""
    return link("finger") + joint("grip", "hand", "finger", inside=LIMIT + mimic)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (two_joints(more=ROUND), ["the joints go round in a circle at the link 'a'"]),
        (two_joints(more=joint("again", "base", "hand")), ["'hand' hangs on two joints, 'elbow' and 'again'"]),
        (two_joints(more=joint("own", "hand", "hand")), ["the link 'hand' hangs on two joints"]),
        (two_joints().replace('"elbow"', '"universe"'), ["a joint has the name 'universe'", "Pinocchio's own"]),
        (two_joints().replace('"hand"', '"universe"'), ["a link has the name 'universe'"]),
        (two_joints().replace('"elbow"', '""'), ["a joint has the name ''", "1 to 200 characters"]),
        (two_joints().replace('"elbow"', '"a&#10;b"'), [r"a joint has the name 'a\nb'"]),
        (two_joints().replace('"elbow"', '"\u202eabc"'), [r"a joint has the name '\u202eabc'"]),
        (two_joints().replace('"elbow"', f'"{"x" * 201}"'), ["a joint has the name 'xxx", "1 to 200 characters"]),
        (two_joints(more=grip('<mimic joint="thumb"/>')), ["'grip' goes along with 'thumb'", "posture: {grip: 0}"]),
        (two_joints(more=grip('<mimic joint="grip"/>')), ["the joint 'grip' goes along with itself"]),
        (two_joints().replace('axis xyz="0 0 1"', 'axis xyz="1e-200 0 0"'), ["axis of the joint 'shoulder'"]),
        (two_joints().replace('axis xyz="0 0 1"', 'axis xyz="1e308 1e308 0"'), ["axis of the joint 'shoulder'"]),
        (two_joints().replace('xyz="0.3 0 0.1"', 'xyz="3e9 0 0"'), ["the joint 'shoulder' has an origin at 3e9 0 0"]),
        (two_joints().replace("<origin ", '<origin rpy="1e308 0 0" '), ["'shoulder' is turned by 1e308 0 0"]),
        (two_joints().replace("<collision>", '<collision><origin xyz="0 1e20 0"/>'), ["link 'upper' has an origin"]),
        (two_joints().replace('mass value="1"', 'mass value="1e308"'), ["the link 'upper' has the mass 1e+308 kg"]),
        (two_joints().replace(INERTIA, INERTIA.replace('ixy="0"', 'ixy="1e300"')), ["moments of inertia -1e+300"]),
        (two_joints(more="<g " + " ".join(f'a{k}=""' for k in range(65)) + "/>"), ["an element has 65 attributes"]),
        (two_joints(more="<g/>" * 300_001), ["it has more than 300000 elements"]),
        (two_joints(body=shape('<mesh filename="package://../other/ok.obj"/>')), ["leads out of its package"]),
        (two_joints(body=shape('<mesh filename="package://my_arm/../../ok.obj"/>')), ["leads out of its package"]),
        (two_joints(body=shape('<mesh filename="package://./ok.obj"/>')), ["leads out of its package"]),
        (two_joints(body=shape('<mesh filename="memory.obj"/>')), ["memory.obj", "it cannot be read"]),
        (two_joints(body=shape('<mesh filename="folder.obj"/>')), ["there is no file 'folder.obj'"]),
        (two_joints(body=shape('<mesh filename="pipe.obj"/>')), ["there is no file 'pipe.obj'"]),
        (two_joints(body=shape('<mesh filename="zero.obj"/>')), ["there is no file 'zero.obj'"]),
    ],
)  # fmt: skip
def test_what_pinocchio_takes_and_no_robot_has_is_told(text, told, tmp_path, capfd):
    (tmp_path / "memory.obj").symlink_to("/proc/self/mem")  # opens, and cannot be read
    (tmp_path / "folder.obj").mkdir()
    (tmp_path / "zero.obj").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "pipe.obj")
    (tmp_path / "ok.obj").write_text(TETRAHEDRON, encoding="utf-8")
    refused(tmp_path, told, text)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("wrong", "told"), [('ixx="-1"', "-1, 0.1, 0.1"), ('ixx=".1" ixy="5"', "-4.9, 0.1, 5.1")]
)
def test_a_negative_moment_of_inertia_is_said(wrong, told, tmp_path):
    """Not refused: robots that are sold have some, and what they weigh is right nevertheless."""
    inertia = INERTIA.replace('ixx=".1" ixy="0"' if "ixy" in wrong else 'ixx=".1"', wrong)
    text = two_joints(body=MASS.replace(INERTIA, inertia))
    with pytest.warns(ComoveWarning, match=f"the link 'upper' has the moments of inertia {told} kg m"):
        load(tmp_path, text)


@pytest.mark.parametrize(
    ("first", "second"),
    [('<parent link="upper"/>', '<parent link="base"/>'), ('<child link="upper"/>', '<child link="hand"/>')],
)
def test_a_joint_that_names_a_link_twice_is_read_by_the_first_and_no_hand_weighs_more(
    first, second, tmp_path
):
    twice = two_joints().replace(first, first + second)
    assert twice != two_joints()
    found, right = load(tmp_path, twice), load(tmp_path)
    assert found.arms[0].hand == right.arms[0].hand == 0.0
    q = np.array([0.3, 0.7])
    np.testing.assert_array_equal(found.tool_pose(q, found.arms[0]), right.tool_pose(q, right.arms[0]))


LAUGHS = "".join(f'<!ENTITY l{k} "' + f"&l{k - 1};" * 10 + '">' for k in range(1, 10))


@pytest.mark.parametrize(
    "defined",
    [
        f'<!ENTITY l0 "lol">{LAUGHS}',
        '<!ENTITY l9 SYSTEM "file:///etc/passwd">',
        '<!ENTITY % l SYSTEM "http://127.0.0.1:9/l.dtd"> %l;',
    ],
)
def test_a_document_type_reaches_nothing_and_grows_nothing(defined, tmp_path):
    text = f'<!DOCTYPE robot [{defined}]><robot name="r"><g>&l9;</g></robot>'
    refused(tmp_path, ["r.urdf", "document type"], text)
    (tmp_path / "l.srdf").write_text(text, encoding="utf-8")
    refused(tmp_path, ["l.srdf", "document type"], models=[{"urdf": "r.urdf", "srdf": "l.srdf"}])


@pytest.mark.parametrize(
    ("srdf", "told"),
    [
        ("<sdf/>", ["it is an SDF, not an SRDF", "leave `srdf` out"]),
        (two_joints(), ["it is a URDF, not an SRDF"]),
        (
            '<robot><disable_collisions link2="base"/></robot>',
            ["<disable_collisions> does not name two links"],
        ),
    ],
)
def test_an_srdf_that_cannot_be_used_is_told(srdf, told, tmp_path):
    (tmp_path / "r.srdf").write_text(srdf, encoding="utf-8")
    refused(tmp_path, ["r.srdf", *told], models=[{"urdf": "r.urdf", "srdf": "r.srdf"}])


def test_pinocchio_gets_the_triangles_that_were_read_and_metres(tmp_path):
    """A drawing in centimetres, and a link beside it that names the same file mirrored."""
    (tmp_path / "wedge.dae").write_text(WEDGE, encoding="utf-8")
    mesh = '<collision><geometry><mesh filename="wedge.dae"{}/></geometry></collision>'
    body = MASS + mesh.format("") + mesh.format(' scale="-2 2 2"')
    shapes = [item.geometry for item in load(tmp_path, two_joints(body=body)).collision.geometryObjects[1:3]]
    spans = [np.ptp(np.array(shape.vertices()), axis=0) for shape in shapes]
    np.testing.assert_allclose(spans, [[1.0, 0.5, 0.25], [2.0, 1.0, 0.5]])


def test_meshes_that_are_equal_are_read_once(tmp_path):
    """Under two names, and in two models: the hull that one of them gets, all have, but not those of another size."""
    for name in ("a.obj", "b.obj"):
        (tmp_path / name).write_text(TETRAHEDRON, encoding="utf-8")
    mesh = '<mesh filename="{}" scale="{}"/>'
    body = MASS + "".join(
        shape(mesh.format(*of)) for of in (("a.obj", "1 1 1"), ("b.obj", "1 1 1"), ("a.obj", "2 1 1"))
    )
    models = [{"urdf": "r.urdf"}, {"urdf": "r.urdf", "prefix": "other_", "base": {"position": [9, 0, 0]}}]
    geometry = load(tmp_path, two_joints(body=body), models=models).collision
    meshes = [x.geometry for x in geometry.geometryObjects if isinstance(x.geometry, coal.BVHModelBase)]
    meshes[0].buildConvexHull(True, "Qt")
    assert [mesh.convex is not None for mesh in meshes] == [True, True, False] * 2


def test_names_that_are_many_are_not_all_told(tmp_path):
    text = find_description("baxter").read_text(encoding="utf-8")
    path = tmp_path / "robot.yaml"
    path.write_text(text.replace("left_gripper\n", "left_griper\n"), encoding="utf-8")
    with pytest.raises(RobotError, match=r"did you mean 'left_gripper'\? \d+ are known$"):
        Robot.load(path)


def test_a_process_without_stderr_reads_models_as_carefully(tmp_path):
    path = written(
        tmp_path, {"r.urdf": two_joints(body=shape(""))}, {"models": [{"urdf": "r.urdf"}], "arms": ARM}
    )
    done = run(
        "import os, sys; os.close(2); sys.stderr = None\n"
        "from comove.errors import RobotError\n"
        "from comove.robots import Robot\n"
        "Robot.load('two_pandas')\n"
        f"try:\n    Robot.load({str(path)!r})\n"
        "except RobotError as error:\n    print(error)"
    )
    assert "Geometry tag contains no child element" in done.stdout


# --- Without the extra ---


def run(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)


def test_without_pinocchio_the_way_to_install_it_is_told():
    done = run(
        "import sys; sys.modules['pinocchio'] = None\n"
        "from comove.errors import ExtraError\n"
        "try:\n    import comove.robots\n"
        "except ExtraError as error:\n    print(error)"
    )
    assert done.stdout.strip() == "a robot needs more than the core: python -m pip install 'comove[robot]'"
    assert done.stderr == ""


def test_the_command_line_tells_it_too(tmp_path):
    scene = EXAMPLES / "baxter" / "gap_30.yaml"
    done = run(
        "import sys; sys.modules['pinocchio'] = None\n"
        f"sys.argv = ['comove', 'robot', 'solve', {str(scene)!r}, '--out', {str(tmp_path / 'out')!r}]\n"
        "from comove.cli import main\nmain()"
    )
    assert done.returncode == 2
    assert done.stderr.endswith(
        "error: a robot needs more than the core: python -m pip install 'comove[robot]'\n"
    )
    assert not (tmp_path / "out").exists()
