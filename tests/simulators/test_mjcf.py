"""Models of MuJoCo's as URDFs: MuJoCo itself says where bodies are, what they weigh, and how far joints go."""

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest

from comove.errors import RobotError
from comove.simulators.engine import engine
from comove.simulators.mjcf import urdf_of

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
    for limit in tree.findall("joint/limit"):  # as a description states them
        limit.attrib |= {"velocity": "1", "effort": "1"}
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
