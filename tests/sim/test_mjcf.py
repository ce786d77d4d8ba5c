"""Models of MuJoCo's as URDFs: MuJoCo itself says where bodies are, what they weigh, and how far joints go."""

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest
import yaml

from comove.errors import RobotError
from comove.sim.engine import engine
from comove.sim.mjcf import urdf_of

ARM = """
<mujoco model="arm">
  <compiler angle="degree"/>
  <default><geom contype="1"/><default class="visual"><geom contype="0" conaffinity="0"/></default></default>
  <asset><mesh name="wedge" vertex="0 0 0  .1 0 0  0 .1 0  0 0 .1" scale="1 2 1"/></asset>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="base" pos="0 .1 .2" euler="0 0 30">
      <geom type="box" size=".1 .1 .05" mass="3"/>
      <body name="shoulder" pos=".1 0 .1" quat=".7 .2 .5 -.3">
        <joint name="turn" axis="0 0 1" range="-90 120" actuatorfrcrange="-40 40"/>
        <joint name="lift" axis="0 1 .2" pos="0 .05 0" range="-60 60"/>
        <geom type="capsule" size=".04" fromto="0 0 0 .3 .1 0" mass="1"/>
        <body name="fore" pos=".3 .1 0">
          <joint name="slide" type="slide" axis="1 0 0" pos=".02 .01 0" range="0 .2"/>
          <geom type="mesh" mesh="wedge" mass=".5"/>
          <geom class="visual" type="ellipsoid" size=".1 .1 .2" mass="0"/>
          <body name="left" pos="0 .02 0"><joint name="l" type="slide" axis="0 1 0" range="0 .03"/>
            <geom type="sphere" size=".01" mass=".1"/></body>
          <body name="right" pos="0 -.02 0"><joint name="r" type="slide" axis="0 -1 0" range="0 .03"/>
            <geom type="cylinder" size=".01 .02" mass=".1"/></body>
        </body>
      </body>
    </body>
  </worldbody>
  <contact><exclude body1="base" body2="fore"/></contact>
  <equality><joint joint1="r" joint2="l" polycoef="0 1 0 0 0"/></equality>
  <actuator><motor joint="slide" gear="2" forcerange="-15 15"/></actuator>
</mujoco>
"""


def written(tmp_path, text=ARM):
    path = tmp_path / "arm.xml"
    path.write_text(text, encoding="utf-8")
    return path


def links_of(path):
    """The links of the URDF that a model becomes, by name."""
    return {link.get("name"): link for link in ET.fromstring(urdf_of(path).urdf).iter("link")}


def test_bodies_are_where_mujoco_has_them_and_weigh_as_much(tmp_path):
    path = written(tmp_path)
    mujoco = engine()
    theirs = mujoco.MjModel.from_xml_path(str(path))
    tree = ET.fromstring(urdf_of(path).urdf)
    state, ours = mujoco.MjData(theirs), pin.buildModelFromXML(ET.tostring(tree, encoding="unicode"))
    data, rng = ours.createData(), np.random.default_rng(0)
    assert set(ours.names[1:]) == {"turn", "lift", "slide", "l", "r"}
    for _ in range(20):
        q = np.empty(ours.nq)
        for name in ours.names[1:]:
            value = rng.uniform(-0.6, 0.6)
            state.qpos[theirs.joint(name).qposadr[0]] = value
            q[ours.joints[ours.getJointId(name)].idx_q] = value
        mujoco.mj_forward(theirs, state)
        pin.framesForwardKinematics(ours, data, q)
        for body in ("base", "shoulder", "fore", "left", "right"):
            pose = data.oMf[ours.getFrameId(body)]
            np.testing.assert_allclose(pose.translation, state.body(body).xpos, atol=1e-12)
            np.testing.assert_allclose(pose.rotation.ravel(), state.body(body).xmat, atol=1e-12)
        np.testing.assert_allclose(
            pin.computeGeneralizedGravity(ours, data, q)[[ours.joints[ours.getJointId("lift")].idx_v]],
            state.qfrc_bias[theirs.joint("lift").dofadr[0]],
            atol=1e-9,
        )


def test_limits_motors_couplings_and_pairs_are_kept(tmp_path):
    found = urdf_of(written(tmp_path))
    joints = {joint.get("name"): joint for joint in ET.fromstring(found.urdf).findall("joint")}
    turn, slide, right = (joints[name] for name in ("turn", "slide", "r"))
    limit = turn.find("limit")
    assert (turn.get("type"), slide.get("type")) == ("revolute", "prismatic")
    np.testing.assert_allclose([float(limit.get(key)) for key in ("lower", "upper")], np.deg2rad([-90, 120]))
    assert (limit.get("effort"), slide.find("limit").get("effort")) == ("40.0", "30.0")
    assert right.find("mimic").attrib == {"joint": "l", "multiplier": "1.0", "offset": "0.0"}
    pair = ET.fromstring(found.srdf).find("disable_collisions")
    assert {pair.get("link1"), pair.get("link2")} == {"base", "fore"}


def test_shapes_that_collide_are_where_mujoco_has_them(tmp_path):
    path = written(tmp_path)
    found = urdf_of(path)
    links = {
        link.get("name"): link.findall("collision") for link in ET.fromstring(found.urdf).findall("link")
    }
    shapes = {
        name: [part.find("geometry")[0].tag for part in parts] for name, parts in links.items() if parts
    }
    assert shapes == {
        "base": ["box"],
        "shoulder": ["cylinder", "sphere", "sphere"],
        "fore": ["mesh"],
        "left": ["sphere"],
        "right": ["cylinder"],
    }
    ends = [np.array(part.find("origin").get("xyz").split(), dtype=float) for part in links["shoulder"][1:]]
    np.testing.assert_allclose(sorted(map(tuple, ends)), [(0, 0, 0), (0.3, 0.1, 0)], atol=1e-12)
    (mesh,) = found.meshes.values()
    corners = np.frombuffer(mesh[84:], dtype="<f4,(3,3)<f4,<u2".replace("<f4,(", "(3,)<f4,("))["f1"]
    origin = links["fore"][0].find("origin")
    turned = pin.rpy.rpyToMatrix(np.array(origin.get("rpy").split(), dtype=float))
    placed = corners.reshape(-1, 3) @ turned.T + np.array(origin.get("xyz").split(), dtype=float)
    np.testing.assert_allclose(placed.min(axis=0), 0.0, atol=1e-6)
    np.testing.assert_allclose(placed.max(axis=0), [0.1, 0.2, 0.1], atol=1e-6)


def test_what_viewers_draw_is_drawn_in_its_colour_and_what_no_urdf_has_is_not(tmp_path):
    """Shapes that collide in a hidden group are not; the ellipsoid of the hand has no counterpart."""
    text = ARM.replace('type="box" size', 'group="3" type="box" size')
    text = text.replace('type="sphere" size', 'rgba="1 .5 0 1" type="sphere" size')
    links = links_of(written(tmp_path, text))
    counts = {name: len(link.findall("visual")) for name, link in links.items()}
    assert {name: n for name, n in counts.items() if n} == {"shoulder": 3, "fore": 1, "left": 1, "right": 1}
    assert len(links["base"].findall("collision")) == 1
    colour = links["left"].find("visual/material/color").get("rgba")
    np.testing.assert_allclose(np.array(colour.split(), dtype=float), [1.0, 0.5, 0.0, 1.0])


def test_things_that_lie_about_are_left_out_and_a_robot_that_moves_freely_is_not(tmp_path):
    box = '<body name="box" pos="1 0 0"><freejoint/><geom type="box" size=".1 .1 .1" mass="1"/></body></worldbody>'
    base = '<body name="base" pos="0 .1 .2" euler="0 0 30">'
    text = ARM.replace("</worldbody>", box).replace(base, f"{base}<freejoint/>")
    links = links_of(written(tmp_path, text))
    assert "box" not in links
    assert {"base", "shoulder", "fore"} <= set(links)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("</mujoco>", "", "MuJoCo cannot read it"),
        ('name="lift" axis="0 1 .2"', 'name="lift" type="ball"', "ball joint"),
        ('name="slide" type="slide"', 'name="slide" type="slide" ref=".1"', "is at 0.1"),
        ('type="cylinder" size=".01 .02"', 'type="ellipsoid" size=".01 .02 .03"', "none of box"),
    ],
)
def test_what_has_no_counterpart_is_told(tmp_path, old, new, told):
    assert old in ARM
    with pytest.raises(RobotError, match=told):
        urdf_of(written(tmp_path, ARM.replace(old, new)))


MOTORS = """
<mujoco><compiler angle="radian"/><worldbody><geom name="ground" type="plane" size="0 0 1"/>
  <body name="table" pos="1 0 .4"><geom type="box" size=".4 .3 .02" mass="9"/></body>
  <body name="door" pos="-2 0 0"><joint name="hinge"/><geom type="box" size=".4 .02 1" mass="9"/></body>
  <body name="can" pos="1 0 .5"><freejoint/><geom type="cylinder" size=".03 .06" mass=".4"/></body>
  <body name="a" gravcomp="1"><joint name="a" axis="0 0 1" range="-2 2" limited="true" damping=".3" frictionloss=".1"
    {joint}/><geom size=".05" mass="1"/>
    <body name="b" pos="0 0 .3" gravcomp="1"><joint name="b" axis="0 1 0"/><geom size=".05" mass="1"/></body></body>
</worldbody>
<tendon><fixed name="t"><joint joint="a" coef="2"/></fixed></tendon>
<actuator>{actuator}<motor joint="b" ctrllimited="true" ctrlrange="-7 7"/></actuator></mujoco>
"""


@pytest.mark.parametrize(
    ("actuator", "joint", "effort", "velocity"),
    [
        ('<motor joint="a" ctrllimited="true" ctrlrange="-176 176"/>', "", 176.0, None),
        ('<motor joint="a" gear="-20" ctrllimited="true" ctrlrange="-3 3"/>', "", 60.0, None),
        ('<motor joint="a" ctrllimited="true" ctrlrange="-9 5"/>', "", 5.0, None),
        ('<motor tendon="t" ctrllimited="true" ctrlrange="-6 6"/>', "", 12.0, None),
        (
            '<motor joint="a" ctrlrange="-9 9" ctrllimited="true" forcelimited="true" forcerange="-4 4"/>',
            "",
            4.0,
            None,
        ),
        ('<motor joint="a" ctrllimited="true" ctrlrange="-9 9"/>', 'actuatorfrcrange="-3 3"', 3.0, None),
        ('<general joint="a" gainprm="5" ctrllimited="true" ctrlrange="-2 2"/>', "", 10.0, None),
        ('<position joint="a" kp="1000" forcelimited="true" forcerange="-40 40"/>', "", 40.0, None),
        ('<position joint="a" kp="1000" ctrllimited="true" ctrlrange="-1 1"/>', "", None, None),
        ('<velocity joint="a" kv="50" gear="2" ctrllimited="true" ctrlrange="-3 3"/>', "", 300.0, 1.5),
    ],
)
def test_actuators_become_efforts_and_speeds(tmp_path, actuator, joint, effort, velocity):
    """By hand from MuJoCo's definition of each; what nothing limits is a guess, marked and told."""
    found = urdf_of(written(tmp_path, MOTORS.format(actuator=actuator, joint=joint)))
    (limit,) = ET.fromstring(found.urdf).findall("joint[@name='a']/limit")
    guessed = limit.get("{urn:comove}guessed", "").split()
    for key, value in (("effort", effort), ("velocity", velocity)):
        assert (key in guessed) == (value is None)
        assert float(limit.get(key)) > 0.0
        assert value is None or float(limit.get(key)) == pytest.approx(value)
        assert any(f"limits no {key} of" in note and "'a'" in note for note in found.notes) == (value is None)
    upper = 1.0 if "<position" in actuator and "ctrlrange" in actuator else 2.0
    assert float(limit.get("upper")) == pytest.approx(upper)


def test_furniture_becomes_obstacles_and_what_moves_freely_a_payload(tmp_path):
    text = MOTORS.format(actuator='<motor joint="a" ctrllimited="true" ctrlrange="-9 9"/>', joint="")
    found = urdf_of(written(tmp_path, text))
    assert set(links_of(written(tmp_path, text))) == {"world", "a", "b"}
    obstacles = {entry["name"]: entry for entry in yaml.safe_load(found.obstacles)["obstacles"]}
    assert set(obstacles) == {"ground", "table", "door"}
    assert obstacles["table"] == {
        "name": "table",
        "shape": "box",
        "size": [0.8, 0.6, 0.04],
        "center": [1, 0, 0.4],
    }
    top = obstacles["ground"]["center"][2] + 0.5 * obstacles["ground"]["size"][2]
    assert top == pytest.approx(0.0)
    told = "\n".join(found.notes)
    assert "'can' moves freely" in told
    assert "{shape: bar, length: 0.12, radius: 0.03, mass: 0.4}" in told
    assert "'hinge'" in told


def test_every_limit_has_what_other_readers_ask_for_and_dynamics_are_kept(tmp_path):
    text = MOTORS.format(actuator='<position joint="a" kp="9"/>', joint="")
    tree = ET.fromstring(urdf_of(written(tmp_path, text)).urdf)
    for limit in tree.iter("limit"):
        assert float(limit.get("effort")) > 0.0
        assert float(limit.get("velocity")) > 0.0
    (joint,) = tree.findall("joint[@name='a']")
    assert joint.find("dynamics").attrib == {"damping": "0.3", "friction": "0.1"}
    assert joint.get("{urn:comove}springs") == "1.0"
    assert pin.buildModelFromXML(ET.tostring(tree, encoding="unicode")).nq == 3


BOMBS = {
    "entities": '<!DOCTYPE m [<!ENTITY a "aaaaaaaa"><!ENTITY b "&a;&a;&a;">]><mujoco model="&b;"/>',
    "depth": "<mujoco><worldbody>" + "<body>" * 100_000,
    "itself": '<mujoco><include file="arm.xml"/></mujoco>',
    "a texture": "<mujoco><asset><texture name='t' type='2d' builtin='flat' width='1000000' height='1000000'/>"
    "</asset></mujoco>",
    "a height field": "<mujoco><asset><hfield name='h' nrow='100000' ncol='100000' size='1 1 1 1'/></asset></mujoco>",
    "bodies": "<mujoco><worldbody>"
    + '<replicate count="1000" offset="1 0 0">' * 4
    + '<geom size="1"/>'
    + "</replicate>" * 4
    + "</worldbody></mujoco>",
}


@pytest.mark.slow
@pytest.mark.parametrize("bomb", BOMBS.values(), ids=BOMBS)
def test_a_small_file_that_asks_for_endless_work_is_refused_in_one_sentence(tmp_path, monkeypatch, bomb):
    monkeypatch.setattr("comove.sim.mjcf.SECONDS", 3)
    with pytest.raises(
        RobotError, match=r"arm\.xml: [^\n]*; (correct it|make it smaller|name a robot's model)$"
    ):
        urdf_of(written(tmp_path, bomb))


def test_all_that_no_urdf_has_and_that_changes_the_robot_is_named_once(tmp_path):
    """A linkage, a polynomial, a held joint, tendons, thrusters, rotors, listed and filtered contacts."""
    text = ARM.replace(
        '<equality><joint joint1="r" joint2="l" polycoef="0 1 0 0 0"/></equality>',
        """<equality>
          <joint joint1="r" joint2="l" polycoef="0 1 0.5 0 0"/>
          <joint joint1="l" polycoef=".01 0 0 0 0"/>
          <connect body1="left" body2="right" anchor="0 0 0"/>
          <weld body1="base" body2="fore" active="false"/>
          <tendon tendon1="cable"/>
        </equality>
        <tendon>
          <fixed name="cable" stiffness="3"><joint joint="turn" coef="1"/><joint joint="lift" coef="-1"/></fixed>
          <fixed name="idle"><joint joint="turn" coef="1"/></fixed>
        </tendon>""",
    )
    text = text.replace("<actuator>", '<actuator><general name="fan" site="nozzle" gear="0 0 1 0 0 0"/>')
    text = text.replace("<contact>", '<contact><pair geom1="pad" geom2="ball"/>')
    text = text.replace('<geom type="sphere"', '<site name="nozzle"/><geom name="ball" type="sphere"')
    text = text.replace(
        '<geom type="cylinder"',
        '<geom name="pad" type="box" size=".01 .01 .01" contype="0" conaffinity="0" mass="0"/>'
        '<geom contype="2" conaffinity="2" type="cylinder"',
    )
    text = text.replace('name="lift"', 'name="lift" armature=".1"').replace(
        "<asset>", '<option gravity="0 0 -1.6"/><asset>'
    )
    notes = urdf_of(written(tmp_path, text)).notes
    for wanted in (
        "'r' follow others by polynomials",
        "holds 'l' at 0.01: say it by `posture`",
        "hold 'left' and 'right' together",
        "length of 'cable' is constrained",
        "tendons 'cable' pull at the robot",
        "actuators 'fan' drive no joint",
        "rotors of 'lift' have an inertia",
        "shapes of 'right' touch only what the model lists",
        "'left', 'right', 'shoulder' pass through others of the robot",
        "gravity is 0, 0, -1.6 m/s^2",
    ):
        assert sum(wanted in note for note in notes) == 1, wanted
    assert not any("'idle'" in note or "'base' and 'fore'" in note for note in notes)
    plain = urdf_of(written(tmp_path)).notes
    assert not any("left out" in note or "pass through" in note or "gravity" in note for note in plain)


def test_neighbours_do_not_pass_through_each_other_and_no_gravity_is_another(tmp_path):
    """MuJoCo lets no joined bodies touch, whatever their bits say; gravity may be switched off."""
    geom = '<geom type="sphere" size=".05" contype="1" conaffinity="2"/>'
    inner = f'<body name="b" pos="0 0 .2"><joint name="j" axis="1 0 0" range="-1 1"/>{geom}</body>'
    arm = f'<body name="a"><joint name="i" axis="0 0 1" range="-1 1"/>{geom}{geom}{inner}</body>'
    motors = '<actuator><motor joint="i" ctrlrange="-1 1"/><motor joint="j" ctrlrange="-1 1"/></actuator>'
    option = '<option><flag gravity="disable"/></option>'
    text = f'<mujoco model="m">{option}<worldbody>{arm}</worldbody>{motors}</mujoco>'
    notes = urdf_of(written(tmp_path, text)).notes
    assert not any("pass through" in note for note in notes)
    assert any("gravity is 0, 0, 0 m/s^2" in note for note in notes)


def test_meshes_whose_names_differ_by_a_slash_are_two_files(tmp_path):
    other = "".join(
        f'<mesh name="{name}" vertex="0 0 0  {x} 0 0  0 .1 0  0 0 .1"/>'
        for name, x in (("a-b", 0.1), ("a/b", 0.2))
    )
    text = ARM.replace("<asset>", f"<asset>{other}").replace(
        '<geom type="mesh"', '<geom type="mesh" mesh="a/b"/><geom type="mesh" mesh="a-b"/><geom type="mesh"'
    )
    found = urdf_of(written(tmp_path, text))
    files = {mesh.get("filename") for mesh in ET.fromstring(found.urdf).iter("mesh")}
    assert len(files) == len(found.meshes) == len(set(found.meshes.values())) == 3


def test_a_coupling_that_is_off_couples_nothing(tmp_path):
    off = ARM.replace('polycoef="0 1 0 0 0"', 'polycoef="0 1 0 0 0" active="false"')
    joints = {
        joint.get("name"): joint
        for joint in ET.fromstring(urdf_of(written(tmp_path, off)).urdf).iter("joint")
    }
    assert joints["r"].find("mimic") is None
