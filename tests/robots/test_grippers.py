"""Grippers of a description: part of the arm's model in geometry, mass and pairs; told where there is none."""

import html
import json
import math
import re
import shutil
from dataclasses import replace
from types import SimpleNamespace

import coal
import numpy as np
import pinocchio as pin
import pytest
import yaml
from scipy.spatial.transform import Rotation

import comove
from comove.errors import ComoveWarning, RobotError
from comove.model import Scene
from comove.robots import Robot, verify_joints
from comove.robots.mounting import COLOUR
from comove.robots.proposal import examine, propose
from comove.robots.verification.checks import without_gripper
from comove.sim import simulate
from comove.sim.engine import engine
from comove.sim.urdf import for_mujoco
from comove.stored import joint_rows, run_rows, simulation_rows
from comove.view.workbench.bodies import bodies_of as drawn_bodies
from tests.brute_force import obstacle_distance
from tests.commands import invoke
from tests.robots.small_robots import BUNDLED, EXAMPLES, robot, written
from tests.robots.test_model import LIMIT, MASS, TETRAHEDRON, joint, link, load, two_joints

SHAPES = [
    {
        "shape": "box",
        "center": [0.02, -0.01, 0.05],
        "size": [0.06, 0.1, 0.04],
        "quaternion_wxyz": [0.8, 0, 0.6, 0],
    },
    {
        "shape": "cylinder",
        "center": [0, 0.1, 0.02],
        "radius": 0.03,
        "height": 0.08,
        "quaternion_wxyz": [0.6, 0.8, 0, 0],
    },
    {"shape": "sphere", "center": [0.1, 0, 0.1], "radius": 0.04},
    {
        "shape": "capsule",
        "center": [-0.1, 0, 0.1],
        "radius": 0.02,
        "length": 0.1,
        "quaternion_wxyz": [0.6, 0, 0.8, 0],
    },
]
MOUNT = {"position": [0.1, 0.02, -0.03], "quaternion_wxyz": [0.5, 0.5, -0.5, 0.5]}
FINGERS = (
    link("palm")
    + joint(
        "drive",
        "palm",
        "finger",
        "prismatic",
        '<limit lower="0" upper="0.04" effort="9" velocity="1"/>',
        "0 1 0",
    )
    + link("finger")
    + joint("follow", "palm", "thumb", "prismatic", f'{LIMIT}<mimic joint="drive" multiplier="-1"/>', "0 1 0")
    + link("thumb")
)
UR10 = "package://example-robot-data/robots/ur_description/urdf/ur10_robot.urdf"


def gripper_urdf(body=FINGERS):
    return f'<robot name="gripper">{body}</robot>'


def held(folder, gripper, urdf=FINGERS, **more):
    """The arm of two joints with a gripper; its URDF lies beside the description."""
    (folder / "gripper.urdf").write_text(gripper_urdf(urdf), encoding="utf-8")
    return load(folder, arms={"left": {"tip": "hand", "gripper": gripper}}, **more)


def bodies_of(machine):
    """The collision bodies of grippers, and where each is at some joints."""
    own = machine.gripper_links(machine.arms[0])
    frames = machine.model.frames
    return [item for item in machine.collision.geometryObjects if frames[item.parentFrame].name in own]


def configurations(machine, count=5):
    rng = np.random.default_rng(3)
    return rng.uniform(machine.lower, machine.upper, (count, len(machine.lower)))


def test_bodies_are_where_tip_and_mount_put_them_by_brute_force(tmp_path):
    machine, bare = held(tmp_path, {"shapes": SHAPES, "mass": 0.8, "mount": MOUNT}), load(tmp_path)
    mount = pin.SE3(
        Rotation.from_quat(MOUNT["quaternion_wxyz"], scalar_first=True).as_matrix(),
        np.array(MOUNT["position"]),
    )
    data, rng = machine.model.createData(), np.random.default_rng(0)
    shapes = [SimpleNamespace(**{"quaternion_wxyz": (1.0, 0.0, 0.0, 0.0)} | shape) for shape in SHAPES]
    for q in configurations(machine):
        pin.forwardKinematics(machine.model, data, q)
        base = pin.SE3(bare.tool_pose(q, bare.arms[0])) * mount
        for point in base.translation + rng.uniform(-0.3, 0.3, (20, 3)):
            by_hand = min(float(obstacle_distance(shape, base.actInv(point)[None])[0]) for shape in shapes)
            found = []
            for item in bodies_of(machine):
                place, result = data.oMi[item.parentJoint] * item.placement, coal.DistanceResult()
                ball = coal.Transform3s(np.eye(3), point)
                placed = coal.Transform3s(place.rotation, place.translation)
                coal.distance(item.geometry, placed, coal.Sphere(1e-9), ball, coal.DistanceRequest(), result)
                found.append(result.min_distance)
            assert min(found) == pytest.approx(by_hand, abs=1e-5) or max(min(found), by_hand) < 0.0


def test_a_mesh_is_a_body_and_kept_with_results(tmp_path):
    (tmp_path / "hull.obj").write_text(TETRAHEDRON, encoding="utf-8")
    machine = held(tmp_path, {"shapes": [{"shape": "mesh", "file": "hull.obj", "scale": 0.1}], "mass": 0.5})
    (item,) = bodies_of(machine)
    assert np.array(item.geometry.vertices()).max() == pytest.approx(0.1)
    assert tmp_path / "hull.obj" in machine.files
    assert {path.name for path in held(tmp_path, {"urdf": "gripper.urdf"}).files} == {
        "robot.yaml",
        "r.urdf",
        "gripper.urdf",
    }


def test_shapes_weigh_what_they_should_wherever_the_arm_is(tmp_path):
    """Against the gradient of the potential energy of a box, whose middle is its centre of mass."""
    box = {"shape": "box", "center": [0.1, 0.2, 0.3], "size": [0.1, 0.2, 0.3]}
    machine, bare = held(tmp_path, {"shapes": [box], "mass": 2.0}), load(tmp_path)
    assert pin.computeTotalMass(machine.model) == pytest.approx(pin.computeTotalMass(bare.model) + 2.0)

    def energy(q):
        return 2.0 * 9.81 * (bare.tool_pose(q, bare.arms[0]) @ [0.1, 0.2, 0.3, 1.0])[2]

    for q in configurations(machine):
        with_it, without = (
            pin.computeGeneralizedGravity(m.model, m.model.createData(), q) for m in (machine, bare)
        )
        steps = 1e-5 * np.eye(len(q))
        slope = [(energy(q + step) - energy(q - step)) / 2e-5 for step in steps]
        np.testing.assert_allclose(with_it - without, slope, atol=1e-6)
    frame = machine.model.getFrameId("left_gripper_body", pin.FrameType.BODY)
    size, own = np.array(box["size"]), machine.model.inertias[2] - bare.model.inertias[2]
    moments = machine.model.frames[frame].placement.actInv(own).inertia
    np.testing.assert_allclose(moments, np.diag((size @ size - size**2) * 2.0 / 12.0), atol=1e-9)


def test_a_urdf_is_as_if_it_were_written_into_that_of_the_arm(tmp_path):
    rpy = '<origin xyz="0.1 0.02 -0.03" rpy="0.3 0 0"/>'
    mount = {"position": [0.1, 0.02, -0.03], "quaternion_wxyz": [math.cos(0.15), math.sin(0.15), 0.0, 0.0]}
    fixed = f'<joint name="m" type="fixed"><parent link="hand"/><child link="palm"/>{rpy}</joint>'
    given = {"urdf": "gripper.urdf", "mount": mount, "prefix": ""}
    (tmp_path / "a").mkdir()
    by_hand = load(tmp_path / "a", text=two_joints(more=FINGERS + fixed), posture={"drive": 0.02})
    machine = held(tmp_path, given, posture={"drive": 0.02})
    assert machine.joint_names == by_hand.joint_names
    assert machine.description.posture == by_hand.description.posture == {"drive": 0.02, "follow": -0.02}
    for q in configurations(machine):
        placed = []
        for one in (machine, by_hand):
            data, of_geometry = one.model.createData(), one.collision.createData()
            pin.updateGeometryPlacements(one.model, data, one.collision, of_geometry, q)
            names = [item.name for item in one.collision.geometryObjects]
            placed.append(
                {name: place.homogeneous for name, place in zip(names, of_geometry.oMg, strict=True)}
            )
            placed[-1]["inertia"] = pin.crba(one.model, data, q)
        assert placed[0].keys() == placed[1].keys()
        for name, pose in placed[0].items():
            np.testing.assert_allclose(pose, placed[1][name], atol=1e-12)


def pairs(machine):
    frames, items = machine.model.frames, machine.collision.geometryObjects
    return {
        frozenset(frames[items[k].parentFrame].name for k in (p.first, p.second))
        for p in machine.collision.collisionPairs
    }


def test_a_gripper_is_kept_from_every_link_of_its_arm_that_moves_against_it_but_those_it_may_touch(tmp_path):
    machine = held(tmp_path, {"urdf": "gripper.urdf"})
    own = {f"left_gripper_{name}" for name in ("palm", "finger", "thumb")}
    assert machine.gripper_links(machine.arms[0]) == own
    assert {frozenset((name, "upper")) for name in own} <= pairs(
        machine
    )  # the neighbour of the last joint, too
    free = held(tmp_path, {"urdf": "gripper.urdf", "touch_links": ["upper"]})
    assert pairs(machine) - pairs(free) == {frozenset((name, "upper")) for name in own}
    assert machine.sha256 != free.sha256


def test_two_arms_may_have_the_same_gripper_and_a_description_without_one_keeps_its_checksum(tmp_path):
    models = [
        {"urdf": "r.urdf", "prefix": f"{side}_", "base": {"position": [0, y, 0]}}
        for side, y in (("l", 0), ("r", 3))
    ]
    (tmp_path / "gripper.urdf").write_text(gripper_urdf(), encoding="utf-8")

    def two(**grippers):
        arms = {
            side: {"tip": f"{side}_hand"} | ({"gripper": grippers[side]} if side in grippers else {})
            for side in "lr"
        }
        return load(tmp_path, models=models, arms=arms)

    machine = two(l={"urdf": "gripper.urdf"}, r={"urdf": "gripper.urdf"})
    assert frozenset(("l_gripper_palm", "r_gripper_palm")) in pairs(machine)
    with pytest.raises(RobotError) as error:
        two(l={"urdf": "gripper.urdf", "prefix": "g_"}, r={"urdf": "gripper.urdf", "prefix": "g_"})
    assert "arms.r.gripper.prefix" in str(error.value)
    (advised,) = re.findall(r"prefix: (\w+)$", str(error.value))
    two(l={"urdf": "gripper.urdf", "prefix": "g_"}, r={"urdf": "gripper.urdf", "prefix": advised})
    assert "gripper" not in two().description.model_dump_json()


def test_mujoco_has_its_bodies_and_its_mass(tmp_path):
    mujoco = engine()
    machine = held(tmp_path, {"shapes": SHAPES, "mass": 0.8, "mount": MOUNT})
    text = for_mujoco(machine.sources, machine.description.posture, machine.joint_names, drawn=True)
    model = mujoco.MjModel.from_xml_string(text)
    assert model.body_mass.sum() == pytest.approx(pin.computeTotalMass(machine.model), rel=1e-6)
    data = mujoco.MjData(model)
    of_gripper = [
        g for g in range(model.ngeom) if model.body(model.geom_bodyid[g]).name == "left_gripper_body"
    ]
    assert len(of_gripper) == 2 * len(bodies_of(machine))  # drawn, and to collide
    ours, place = machine.model.createData(), machine.collision.createData()
    for q in configurations(machine):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        pin.updateGeometryPlacements(machine.model, ours, machine.collision, place, q)
        numbers = [machine.collision.getGeometryId(item.name) for item in bodies_of(machine)]
        expected = np.array([place.oMg[k].translation for k in numbers])
        away = np.linalg.norm(data.geom_xpos[of_gripper][:, None] - expected, axis=-1)
        assert away.min(axis=1).max() < 1e-9 and away.min(axis=0).max() < 1e-9


def test_pages_draw_it_where_it_is(tmp_path):
    machine = held(tmp_path, {"shapes": SHAPES, "mass": 0.8, "mount": MOUNT})
    grey = tuple(round(255 * float(part)) for part in COLOUR.split()[:3])
    (drawn,) = [part.surface.vertices for part in drawn_bodies(machine) if part.colour == grey]
    frame = machine.model.frames[machine.model.getFrameId("left_gripper_body", pin.FrameType.BODY)]
    local = (drawn - frame.placement.translation) @ frame.placement.rotation
    shapes = [SimpleNamespace(**{"quaternion_wxyz": (1.0, 0.0, 0.0, 0.0)} | shape) for shape in SHAPES]
    away = np.array([obstacle_distance(shape, local) for shape in shapes])
    assert away.min(axis=0).max() < 0.005  # of the lattice on which surfaces are drawn
    assert (np.abs(away).min(axis=1) < 0.005).all()


# --- Where there is none ---

BARE = {"two_ur10": ("left", "right"), "two_xarm7": ("left", "right"), "ur5_and_panda": ("left",)}


@pytest.mark.parametrize("name", BUNDLED)
@pytest.mark.few(4)
def test_arms_that_end_at_a_flange_have_no_gripper_wherever_the_tool_is(name):
    machine = robot(name)
    assert without_gripper(machine) == BARE.get(name, ())
    at_flange = tuple(replace(arm, tool=np.eye(4)) for arm in machine.arms if arm.name in BARE.get(name, ()))
    assert without_gripper(replace(machine, arms=at_flange)) == BARE.get(name, ())


def test_the_grasp_frame_is_that_of_the_arm_that_is_given_whatever_was_asked_before():
    machine = robot("two_ur10")
    arm = machine.arms[0]
    for tool in (arm.tool, np.eye(4), arm.tool):
        asked = replace(arm, tool=tool)
        joint, placement = machine.grasp_frame(asked)
        data = machine.model.createData()
        pin.forwardKinematics(machine.model, data, machine.home)
        np.testing.assert_allclose(
            (data.oMi[joint] * placement).homogeneous, machine.tool_pose(machine.home, asked), atol=1e-12
        )
        placement.translation[:] = 9.0  # of a copy


def test_what_is_out_of_reach_of_the_grasp_is_no_gripper(tmp_path):
    box = {"shape": "box", "center": [0, 0, 0.05], "size": [0.1, 0.1, 0.1]}
    arms = {
        "left": {"tip": "hand", "gripper": {"shapes": [box], "mass": 1.0}, "tool": {"position": [0, 0, 0.12]}}
    }
    assert without_gripper(load(tmp_path, arms=arms)) == ()
    arms["left"]["tool"] = {"position": [0, 0, 0.2]}
    assert without_gripper(load(tmp_path, arms=arms)) == ("left",)


def test_every_kind_of_verdict_says_so():
    for rows in (joint_rows, simulation_rows, run_rows):
        assert rows({"without_gripper": ("left", "right")}) == [
            ("grippers", "none in the description at 'left', 'right': not verified", "")
        ]
        assert rows({"without_gripper": []}) == rows({}) == []


def test_a_check_advises_a_gripper_that_works(tmp_path):
    told = next(doubt for doubt in examine(robot("two_ur10")).doubts if "gripper" in doubt)
    advice = re.search(r"or (gripper: \{.*\})$", told)[1].replace("KILOGRAMS", "1.2")
    data = yaml.safe_load(UR10_PAIR)
    for arm in data["arms"].values():
        arm |= yaml.safe_load(advice)
    machine = Robot.load(written(tmp_path, {}, data))
    assert without_gripper(machine) == ()
    assert not any("gripper" in doubt for doubt in examine(machine).doubts)


def test_a_check_tells_a_gripper_away_from_the_grasp_and_a_tool_that_lacks(tmp_path):
    box = {"shape": "box", "center": [0, 0, 0.05], "size": [0.02, 0.02, 0.1]}
    arms = {"left": {"tip": "hand", "gripper": {"shapes": [box], "mass": 1.0}}}
    told = [doubt for doubt in examine(load(tmp_path, arms=arms)).doubts if "tool" in doubt]
    arms["left"] |= yaml.safe_load(re.search(r"such as (tool: .*)$", told[0])[1])
    advised = load(tmp_path, arms=arms)
    assert advised.arms[0].tool[2, 3] == pytest.approx(0.1)
    assert not any("tool" in doubt for doubt in examine(advised).doubts)
    arms["left"]["tool"] = {"position": [0, 0, 0.3]}
    assert any("correct `mount` or `tool`" in doubt for doubt in examine(load(tmp_path, arms=arms)).doubts)


# --- Bad input ---


@pytest.mark.parametrize(
    ("gripper", "told"),
    [
        ({}, "neither urdf nor shapes are given; give one of the two"),
        ({"urdf": "gripper.urdf", "shapes": SHAPES, "mass": 1}, "both urdf and shapes are given"),
        ({"shapes": SHAPES}, "the shapes have no mass; write mass: KILOGRAMS beside shapes"),
        ({"shapes": [], "mass": 1}, "write at least 1 shape"),
        ({"urdf": "gripper.urdf", "mass": 1}, "mass belongs to shapes, and none are given; leave mass out"),
        (
            {"shapes": SHAPES, "mass": -0.5},
            r"gripper.mass \(line \d+\): -0.5 is out of range; write a number greater than 0",
        ),
        ({"shapes": [{"shape": "cone"}], "mass": 1}, "'cone' is not known; write 'box', 'sphere'"),
        ({"shapes": [{"shape": "box", "radius": 1}], "mass": 1}, "the box has no size; give a box size"),
        ({"shapes": [{"shape": "box", "size": [1, 1]}], "mass": 1}, "has 2 numbers; write three"),
        ({"shapes": [{"shape": "sphere", "radius": 0.1, "height": 1}], "mass": 1}, "a sphere has no height"),
        (
            {"shapes": [{"shape": "sphere", "radius": 0.1, "widht": 1}], "mass": 1},
            r"shapes\[0\].widht .*unknown key 'widht'",
        ),
        ({"shapes": [{"shape": "sphere", "radius": 60.0}], "mass": 1}, "is 120 m wide"),
        (
            {"shapes": [{"shape": "mesh", "file": "none.stl"}], "mass": 1},
            "gripper: there is no file 'none.stl'",
        ),
        ({"urdf": "none.urdf"}, "arms.left.gripper: there is no file 'none.urdf'"),
        ({"urdf": "empty.urdf"}, "empty.urdf: it has no link; name a URDF"),
        ({"urdf": "floats.urdf"}, 'floats.urdf: .*leaves the gripper free to move; write type="fixed" in it'),
        (
            {"urdf": "gripper.urdf", "prefix": "", "touch_links": ["uper"]},
            "no link 'uper' in the model of the arm; did you mean 'upper'",
        ),
        (
            {"urdf": "r.urdf", "prefix": ""},
            "there is a link or joint 'base' in the models or another gripper",
        ),
    ],
)
def test_a_gripper_that_cannot_be_used_is_told_in_one_sentence(gripper, told, tmp_path):
    (tmp_path / "empty.urdf").write_text(gripper_urdf(""), encoding="utf-8")
    floats = link("world") + joint("free", "world", "palm", "floating", "") + FINGERS
    (tmp_path / "floats.urdf").write_text(gripper_urdf(floats), encoding="utf-8")
    with pytest.raises(RobotError, match=told) as error:
        held(tmp_path, gripper)
    assert "\n" not in str(error.value)


def test_a_tip_that_does_not_exist_is_told_and_one_of_a_joint_is_that_of_its_link(tmp_path):
    gripper = {"shapes": SHAPES, "mass": 1.0}
    with pytest.raises(RobotError, match=r"arms\.left\.tip: there is no frame 'hnad'; did you mean 'hand'"):
        load(tmp_path, arms={"left": {"tip": "hnad", "gripper": gripper}})
    of_joint = load(tmp_path, arms={"left": {"tip": "elbow", "gripper": gripper}})
    assert [body.placement for body in bodies_of(of_joint)] == [
        b.placement for b in bodies_of(held(tmp_path, gripper))
    ]


def test_a_gripper_that_touches_its_own_arm_at_home_is_told_and_the_advice_works(tmp_path):
    long = {"shape": "box", "center": [-0.2, 0, -0.1], "size": [0.5, 0.02, 0.02]}
    arms = {"left": {"tip": "hand", "home": [0, 0], "gripper": {"shapes": [long], "mass": 1.0}}}
    with pytest.raises(RobotError) as error:
        load(tmp_path, arms=arms)
    assert "the gripper's link 'left_gripper_body' touches 'upper' of its own arm" in str(error.value)
    advised = yaml.safe_load(re.search(r"gripper: (\{touch_links: .*\})", str(error.value))[1])
    arms["left"]["gripper"] |= advised
    assert load(tmp_path, arms=arms).name == "small"


def test_masses_and_bodies_of_a_gripper_do_not_stand_for_those_of_the_arm(tmp_path):
    gripper, arms = {"shapes": SHAPES, "mass": 1.0}, {}
    arms["left"] = {"tip": "hand", "gripper": gripper}
    plain = two_joints(body="").replace(MASS, "")
    with pytest.warns(ComoveWarning) as warned:
        load(tmp_path, plain, arms)
    told = " ".join(str(one.message) for one in warned)
    assert "no link of the arm 'left' has a collision body" in told
    assert "no link of the arm 'left' has a mass" in told
    massless = two_joints().replace('<mass value="1"/>', '<mass value="0"/>')
    with pytest.warns(ComoveWarning, match="were guessed from collision bodies.*hand .* kg"):
        guessed = load(tmp_path, massless, arms)
    own = 2 * 1000.0 * 4.0 / 3.0 * np.pi * 0.05**3
    assert pin.computeTotalMass(guessed.model) == pytest.approx(own + 1.0, rel=1e-6)
    with pytest.warns(ComoveWarning, match="no link of the gripper of the arm 'left' has a mass"):
        held(tmp_path, {"urdf": "gripper.urdf"}, urdf='<link name="palm"/>')


# --- Proposals and whole tasks ---


@pytest.mark.parametrize("forward", ["0 0 0.1", "0.1 0 0", "0 0 -0.1"])
@pytest.mark.filterwarnings("ignore::comove.errors.ComoveWarning")
@pytest.mark.slow
def test_a_proposal_turns_the_gripper_along_the_approach_with_the_tool_between_its_fingers(tmp_path, forward):
    place, limit = f'<origin xyz="{forward}"/>', '<limit lower="0" upper="0.04"/>'
    inertial = MASS.split("<collision>")[0]
    pad = f'{inertial}<collision>{place}<geometry><sphere radius="0.01"/></geometry></collision>'
    sides = "".join(
        joint(name, "palm", f"{name}_pad", "prismatic", limit, "0 1 0", forward) + link(f"{name}_pad", pad)
        for name in ("a", "b")
    )
    (tmp_path / "hand.urdf").write_text(gripper_urdf(link("palm") + sides), encoding="utf-8")
    proposal = propose([UR10], tmp_path / "new.yaml", gripper=str(tmp_path / "hand.urdf"))
    (arm,) = proposal.robot.arms
    assert any("velocity and effort of arm_gripper_a, arm_gripper_b" in note for note in proposal.notes)
    assert arm.fingers == ("arm_gripper_a", "arm_gripper_b")
    assert without_gripper(proposal.robot) == ()
    pads = [item for item in bodies_of(proposal.robot) if "pad" in item.name]
    _, grasp = proposal.robot.grasp_frame(arm)
    middle = np.mean([grasp.actInv(item.placement).translation for item in pads], axis=0)
    np.testing.assert_allclose(middle[:2], 0.0, atol=1e-6)
    assert abs(middle[2]) < 0.06
    tip = proposal.robot.model.frames[proposal.robot.model.getFrameId(arm.tip)]
    assert (tip.placement.actInv(pads[0].placement)).translation[2] == pytest.approx(0.2, abs=1e-6)


def test_a_gripper_for_arms_that_have_fingers_or_with_an_arm_of_its_own_is_refused(tmp_path):
    (tmp_path / "hand.urdf").write_text(gripper_urdf(), encoding="utf-8")
    panda = "package://example-robot-data/robots/panda_description/urdf/panda.urdf"
    with pytest.raises(RobotError, match="every arm has fingers already"):
        propose([panda], tmp_path / "new.yaml", gripper=str(tmp_path / "hand.urdf"))
    with pytest.raises(
        RobotError, match="has an arm of its own, from 'shoulder_pan_joint' to 'wrist_3_joint'"
    ):
        propose([UR10], tmp_path / "new.yaml", gripper=UR10)


UR10_PAIR = f"""
name: ur10_pair
models:
  - {{urdf: {UR10}, base: {{position: [0.0, 0.6, 0.0]}}, prefix: left_}}
  - {{urdf: {UR10}, base: {{position: [0.0, -0.6, 0.0]}}, prefix: right_}}
arms:
  left: {{tip: left_tool0, tool: {{position: [0, 0, 0.15]}}, home: [-0.5, -1.2, 1.6, -1.97, -1.571, 0.0]}}
  right: {{tip: right_tool0, tool: {{position: [0, 0, 0.15]}}, home: [0.5, -1.2, 1.6, -1.97, -1.571, 0.0]}}
"""


@pytest.mark.slow
def test_two_arms_with_grippers_pass_between_walls_and_not_where_only_bare_arms_would(tmp_path):
    """A beam between payload and flange is in the way of any gripper; wide slots in it are not."""
    data = yaml.safe_load(UR10_PAIR)
    box = {"shape": "box", "center": [0, 0, 0.08], "size": [0.1, 0.1, 0.16]}
    bare = Robot.load(written(tmp_path, {}, data))
    for arm in data["arms"].values():
        arm["gripper"] = {"shapes": [box], "mass": 0.9}
    machine = Robot.load(written(tmp_path, {}, data))
    scene = yaml.safe_load((EXAMPLES / "robots" / "two_ur10.yaml").read_text())
    scene["workspace"]["upper"][2] = 0.16  # the payload cannot go over the beam

    def beams(*sides):
        scene["obstacles"] = [
            {
                "name": f"beam{k}",
                "shape": "box",
                "center": [0.65, 0.5 * (a + b), 0.19],
                "size": [0.05, b - a, 0.06],
            }
            for k, (a, b) in enumerate(sides)
        ]
        return Scene.from_dict(scene)

    closed = beams((-0.7, 0.7))
    through = comove.solve(closed, robot=bare, seed=0)
    assert through.verified  # with the beam between the payload and the hands
    assert through.joints.report.without_gripper == ("left", "right")
    verdict = verify_joints(machine, through.attempt, through.joints.attempt)
    assert verdict.verified is None
    assert any("_gripper_body" in reason and "beam0" in reason for reason in verdict.reasons)
    assert not comove.solve(closed, robot=machine, seed=0, budget=5.0).verified
    found = comove.solve(beams((-0.7, -0.42), (-0.18, 0.18), (0.42, 0.7)), robot=machine, seed=0)
    assert found.verified
    assert found.joints.report.without_gripper == ()
    done = simulate(found.joints.attempt, found.scene, machine)
    assert done.delivered and not done.contacts


@pytest.mark.slow
def test_commands_carry_a_gripper_into_the_result_and_say_where_there_is_none(tmp_path):
    description = yaml.safe_load(UR10_PAIR)
    description["arms"]["left"]["gripper"] = {"urdf": "hand.urdf"}
    palm = MASS.replace('<sphere radius="0.05"/>', '<box size="0.06 0.06 0.16"/>').replace(
        "<collision>", '<collision><origin xyz="0 0 0.08"/>'
    )
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "hand.urdf").write_text(gripper_urdf(link("palm", palm)), encoding="utf-8")
    written(tmp_path / "made", {}, description)
    scene = yaml.safe_load((EXAMPLES / "robots" / "two_ur10.yaml").read_text()) | {"robot": "robot.yaml"}
    (tmp_path / "made" / "scene.yaml").write_text(yaml.safe_dump(scene), encoding="utf-8")
    out, line = tmp_path / "made" / "out", "none in the description at 'right': not verified"
    done = invoke("solve", str(tmp_path / "made" / "scene.yaml"), "--out", str(out), "--budget", "5")
    assert done.exit_code == 0, done.stderr
    assert line in done.stdout
    out.rename(tmp_path / "moved")
    shutil.rmtree(tmp_path / "made")
    for command in ("verify", "show", "simulate"):
        done = invoke(*command.split(), str(tmp_path / "moved"))
        assert done.exit_code == 0, done.stderr
        assert line in done.stdout, command
    assert json.loads((tmp_path / "moved" / "robot.json").read_text())["without_gripper"] == ["right"]
    done = invoke("report", str(tmp_path / "moved"), "--html", str(tmp_path / "page.html"))
    assert done.exit_code == 0, done.stderr
    assert html.escape(line) in (tmp_path / "page.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_datasets_say_which_robots_have_none(tmp_path):
    scene = yaml.safe_load((EXAMPLES / "robots" / "two_ur10.yaml").read_text())
    study = {"name": "few", "scene": scene, "episodes": 1, "draws": []}
    (tmp_path / "study.yaml").write_text(yaml.safe_dump(study), encoding="utf-8")
    done = invoke("generate", str(tmp_path / "study.yaml"), "--out", str(tmp_path / "out"))
    assert done.exit_code == 0, done.stderr
    assert "two_ur10: none in the description at 'left', 'right': not verified" in done.stdout
