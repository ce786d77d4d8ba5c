"""Worlds of MuJoCo: where bodies are, what they weigh and how far fingers open is what MuJoCo itself says."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from comove.errors import RobotError, TaskError
from comove.geometry.triangles import triangles_of
from comove.model import Scene
from comove.robots.proposal.bodies import pairs_of, touching
from comove.sim.engine import engine
from comove.tasks import Rates, World

TURN = 20.0  # deg, of the fingers of one hand in their palm

PARALLEL = f"""
<body name="NAME_f1" pos="0 0 .02" euler="0 0 {TURN}">
  <joint name="NAME_f1" type="slide" axis="0 1 0" range="0 .04" damping="5"/>
  <geom type="box" size=".01 .005 .03" pos="0 .005 .03" mass=".05"/>
  <geom type="box" size=".012 .01 .03" pos="0 .012 .03" mass=".01"/></body>
<body name="NAME_f2" pos="0 0 .02" euler="0 0 {TURN}">
  <joint name="NAME_f2" type="slide" axis="0 -1 0" range="0 .04" damping="5"/>
  <geom type="box" size=".01 .005 .03" pos="0 -.005 .03" mass=".05"/>
  <geom type="box" size=".012 .01 .03" pos="0 -.012 .03" mass=".01"/></body>
<site name="NAME_grip" pos="0 0 .065" euler="0 0 {TURN}"/>
"""
"""Two slides that an equality couples, with pads 2 mm before thicker fingers; between the pads is the site."""
KNUCKLE = """
<body name="NAME_kSIDE" pos="0 Y .02"><joint name="NAME_kSIDE" axis="X 0 0" range="0 .6"/>
  <geom type="capsule" size=".004" fromto="0 0 .01 0 0 .04" mass=".02"/>
  <body name="NAME_tSIDE" pos="0 0 .05"><joint name="NAME_tSIDE" axis="X 0 0" range="-.6 .6"/>
    <geom type="box" size=".01 .005 .02" pos="0 INNER 0" mass=".02"/></body></body>
"""
LINKAGE = (
    KNUCKLE.replace("SIDE", "1").replace("Y", ".02").replace("X", "-1").replace("INNER", "-.005")
    + KNUCKLE.replace("SIDE", "2").replace("Y", "-.02").replace("X", "1").replace("INNER", ".005")
    + '<site name="NAME_grip" pos="0 0 .075"/>'
)
"""Knuckles that a tendon pulls, and tips that stay parallel: the gap is 20 mm and twice 50 mm sin(angle)."""
ARM = """
<body name="NAME_base" pos="0 PLACE 0"><geom type="cylinder" size=".06 .05" pos="0 0 .05" mass="4"/>
  <body name="NAME_l1" pos="0 0 .12"><joint name="NAME_j1" axis="0 0 1" range="-3 3"/>
    <geom type="sphere" size=".015" mass="1"/>
    <body name="NAME_l2" pos="0 0 .03"><joint name="NAME_j2" axis="0 1 0" range="-2 2"/>
      <geom type="capsule" size=".055" fromto="0 0 0 0 0 .02" mass=".5"/>
      <geom type="capsule" size=".03" fromto="0 0 .02 0 0 .25" mass="1"/>
      <body name="NAME_l3" pos="0 0 .3"><joint name="NAME_j3" axis="0 1 0" range="-2.5 2.5"/>
        <geom type="capsule" size=".025" fromto="0 0 .03 0 0 .2" mass=".8"/>
        <body name="NAME_l4" pos="0 0 .25"><joint name="NAME_j4" axis="0 0 1" range="-3 3"/>
          <geom type="mesh" mesh="wedge" mass=".3"/>
          <body name="NAME_l5" pos="0 0 .05"><joint name="NAME_j5" axis="1 0 0" range="-2 2"/>
            <geom type="sphere" size=".02" mass=".2"/>
            <body name="NAME_palm" pos="0 0 .06" quat=".9 .1 .2 .3">
              <geom type="box" size=".02 .04 .008" mass=".2"/>HAND</body></body></body></body></body></body></body>
"""
MOTORS = """
<motor joint="NAME_j1" gear="2" ctrlrange="-30 30"/><motor joint="NAME_j2" ctrlrange="-50 50"/>
<position joint="NAME_j3" kp="100" forcerange="-25 25"/><motor joint="NAME_j4" ctrlrange="-9 9"/>
<motor joint="NAME_j5" ctrlrange="-5 8"/>
"""
EFFORTS = [60.0, 50.0, 25.0, 9.0, 5.0]
MODEL = f"""
<mujoco model="two arms">
  <compiler angle="radian"/>
  <option timestep=".002"/>
  <default><joint damping=".3" armature=".001"/></default>
  <asset><mesh name="wedge" vertex="0 0 0  .03 0 0  0 .04 0  0 0 .05"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="table" pos=".6 0 .2" euler="0 0 .3"><geom name="board" type="box" size=".2 .4 .02"/>
      <geom name="vase" type="cylinder" size=".03 .1" pos="0 .3 .12"/>
      <body pos="-.3 0 0"><joint name="hinge" axis="0 1 0"/>
        <geom name="flap" type="box" size=".05 .1 .01"/></body></body>
    <geom name="stop" type="box" size=".05 .05 .05" pos="2.101 0 .5"/>
    <body name="brick" pos="2 0 .5"><freejoint/><geom type="box" size=".05 .05 .05" mass="2"/></body>
    <body name="pot" pos=".6 0 .2705" euler="0 0 1"><freejoint/>
      <geom type="box" size=".05 .1 .05" mass=".7"/><geom type="box" size=".01 .03 .01" pos="0 .13 .02" mass=".1"/>
      <site name="handle" pos="0 .13 .02" euler=".4 0 .2"/>
      <body pos="0 0 .05"><geom type="cylinder" size=".02 .01" mass=".05"/>
        <site name="knob" pos="0 0 .02"/></body></body>
    <body name="toy" pos="0 0 1.5" euler=".3 .2 .1"><freejoint/>
      <geom type="capsule" size=".02 .05" mass=".2" euler="1 0 0"/>
      <geom type="sphere" size=".03" pos=".1 0 0" mass=".1"/>
      <geom type="mesh" mesh="wedge" pos="0 0 .1" mass=".1"/></body>
    {ARM.replace("HAND", PARALLEL).replace("NAME", "a").replace("PLACE", ".4")}
    {ARM.replace("HAND", LINKAGE).replace("NAME", "b").replace("PLACE", "-.4")}
  </worldbody>
  <tendon><fixed name="pull"><joint joint="b_k1" coef="1"/><joint joint="b_k2" coef="1"/></fixed></tendon>
  <equality>
    <joint joint1="a_f2" joint2="a_f1"/><joint joint1="b_k2" joint2="b_k1"/>
    <joint joint1="b_t1" joint2="b_k1" polycoef="0 -1 0 0 0"/>
    <joint joint1="b_t2" joint2="b_k2" polycoef="0 -1 0 0 0"/>
  </equality>
  <actuator>
    {MOTORS.replace("NAME", "a")}<position joint="a_f1" kp="300" ctrlrange="0 .04"/>
    {MOTORS.replace("NAME", "b")}<position tendon="pull" kp="5" ctrlrange="0 1.2"/>
  </actuator>
</mujoco>
"""
"""Two arms, one with a parallel gripper and one with a linkage, a table with a pot on it, and a toy in the air."""


@pytest.fixture(autouse=True, scope="module")
def cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


def simulated(text=MODEL, seed=0):
    """A model, and a state of it with its arms at random joints."""
    mujoco = engine()
    model = mujoco.MjModel.from_xml_string(text)
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    for joint in range(model.njnt):
        name = model.joint(joint).name
        if name[1:3] == "_j" or name == "hinge":
            data.qpos[model.jnt_qposadr[joint]] = rng.uniform(-0.6, 0.6)
    mujoco.mj_forward(model, data)
    return model, data


@pytest.fixture(scope="module")
def seen(cache):
    model, data = simulated()
    return SimpleNamespace(model=model, data=data, world=World.from_mujoco(model, data))


def matrix(position, rotation):
    pose = np.eye(4)
    pose[:3, 3], pose[:3, :3] = position, np.reshape(rotation, (3, 3))
    return pose


def placed(entry):
    """The pose of an obstacle, or of a part of a payload, in its frame."""
    w, *xyz = entry.get("quaternion_wxyz", (1.0, 0.0, 0.0, 0.0))
    return matrix(entry.get("center", entry.get("position")), Rotation.from_quat([*xyz, w]).as_matrix())


def test_links_and_grip_sites_are_where_mujoco_has_them(seen):
    mujoco, model, world = engine(), seen.model, seen.world
    robot, rng = world.robot, np.random.default_rng(1)
    assert [arm.name for arm in robot.arms] == ["robot0", "robot1"]
    state, data = mujoco.MjData(model), robot.model.createData()
    for gripper in world.grippers.values():
        for joint, value in gripper.posture.items():
            state.qpos[model.joint(joint).qposadr[0]] = value
    for _ in range(20):
        q = rng.uniform(robot.lower, robot.upper)
        state.qpos[world.addresses] = q
        mujoco.mj_forward(model, state)
        np.testing.assert_array_equal(world.joints_of(state), q)
        pin.framesForwardKinematics(robot.model, data, q)
        for body in range(1, model.nbody):
            name = model.body(body).name
            if name[:2] in ("a_", "b_"):
                pose = data.oMf[robot.model.getFrameId(name)].homogeneous
                expected = matrix(state.xpos[body], state.xmat[body])
                np.testing.assert_allclose(pose, expected, atol=1e-6, err_msg=name)
        for arm, site in (("robot0", "a_grip"), ("robot1", "b_grip")):
            grip = matrix(state.site(site).xpos, state.site(site).xmat)
            apart = np.linalg.inv(grip) @ robot.tool_pose(q, robot.arm(arm))
            np.testing.assert_allclose(apart[:3, 3], 0.0, atol=5e-4)
            np.testing.assert_allclose(np.abs(apart[:3, 1:3]), np.eye(3)[:, 1:3], atol=2e-3)
            assert apart[2, 2] > 0.0, "the tool looks out of the hand"


def test_home_is_where_the_arms_are(seen):
    np.testing.assert_array_equal(seen.world.robot.home, seen.world.joints_of(seen.data))


def test_limits_are_those_of_actuators_and_joints(seen):
    robot = seen.world.robot
    np.testing.assert_allclose(robot.effort, EFFORTS * 2)
    np.testing.assert_allclose(robot.upper, [3.0, 2.0, 2.5, 3.0, 2.0] * 2)
    np.testing.assert_array_equal(robot.velocity, Rates().velocity)
    other = World.from_mujoco(seen.model, seen.data, rates=Rates(velocity=0.7, acceleration=3.0)).robot
    np.testing.assert_array_equal(other.velocity, 0.7)
    np.testing.assert_array_equal(other.acceleration, 3.0)


def test_weight_that_the_model_takes_off_motors_is_off(seen):
    robot = World.from_mujoco(
        *simulated(MODEL.replace('<body name="a_', '<body gravcomp="1" name="a_'))
    ).robot
    np.testing.assert_array_equal(robot.relief, [1.0] * 5 + [0.0] * 5)
    np.testing.assert_array_equal(seen.world.robot.relief, 0.0)


def test_grippers_open_as_wide_as_their_fingers_go(seen):
    parallel, linkage = seen.world.grippers["robot0"], seen.world.grippers["robot1"]
    assert (parallel.actuators, linkage.actuators) == ((5,), (11,))
    assert (parallel.open, parallel.closed) == ((0.04,), (0.0,))
    assert (linkage.open, linkage.closed) == ((1.2,), (0.0,))
    np.testing.assert_allclose((parallel.width_open, parallel.width_closed), (0.08, 0.0), atol=5e-4)
    np.testing.assert_allclose(
        (linkage.width_open, linkage.width_closed), (0.02 + 0.1 * np.sin(0.6), 0.02), atol=1e-3
    )
    np.testing.assert_allclose(
        [linkage.posture[name] for name in ("b_k1", "b_k2", "b_t1", "b_t2")],
        [0.6, 0.6, -0.6, -0.6],
        atol=0.02,
    )
    for gripper in (parallel, linkage):
        assert 0.0 < gripper.settling_time < 1.0


def test_fingers_that_are_shut_now_are_open_in_the_robot(seen):
    """The state in which they begin changes nothing but rounding."""
    mujoco, model = engine(), seen.model
    data = mujoco.MjData(model)
    data.qpos[:] = seen.data.qpos
    for name, value in {
        "b_k1": 0.3,
        "b_k2": 0.3,
        "b_t1": -0.3,
        "b_t2": -0.3,
        "a_f1": 0.02,
        "a_f2": 0.02,
    }.items():
        data.qpos[model.joint(name).qposadr[0]] = value
    other = World.from_mujoco(model, data)
    for arm, gripper in seen.world.grippers.items():
        assert other.grippers[arm].open == gripper.open
        for joint, value in gripper.posture.items():
            assert other.grippers[arm].posture[joint] == pytest.approx(value, abs=5e-3)


def test_links_that_touch_now_need_not_be_kept_apart_but_for_other_arms(seen):
    """The upper arm reaches into the base; hands of different arms are always compared."""
    robot = seen.world.robot
    names = [item.name.rpartition("_")[0] for item in robot.collision.geometryObjects]
    pairs = {frozenset((names[p.first], names[p.second])) for p in robot.collision.collisionPairs}
    for arm in "ab":
        assert frozenset((f"{arm}_base", f"{arm}_l2")) not in pairs
        assert frozenset((f"{arm}_base", f"{arm}_l3")) in pairs
    assert frozenset(("a_palm", "b_palm")) in pairs and frozenset(("a_l3", "b_l3")) in pairs


def test_hands_of_different_arms_that_touch_now_are_compared(seen):
    data = engine().MjData(seen.model)
    for name, value in {"a_j1": -np.pi / 2, "b_j1": np.pi / 2, "a_j2": 0.65, "b_j2": 0.65}.items():
        data.qpos[seen.model.joint(name).qposadr[0]] = value
    robot = World.from_mujoco(seen.model, data).robot
    hit = touching(robot, robot.home[None])[0]
    met = {pair for pair, hits in zip(pairs_of(robot), hit, strict=True) if hits}
    assert met and all({name[0] for name in pair} == {"a", "b"} for pair in met)


def test_furniture_is_where_it_stands_and_carries_what_rests_on_it(seen):
    data, found = seen.data, {entry["name"]: entry for entry in seen.world.obstacles}
    assert set(found) == {"floor", "board", "vase", "flap", "stop"}
    assert {name for name, entry in found.items() if entry.get("support")} == {"board"}
    for name in ("board", "vase", "flap", "stop"):
        geom = data.geom(name)
        np.testing.assert_allclose(placed(found[name]), matrix(geom.xpos, geom.xmat), atol=1e-8)
    assert found["board"]["size"] == pytest.approx([0.4, 0.8, 0.04])
    assert (found["vase"]["radius"], found["vase"]["height"]) == (0.03, 0.2)
    assert found["floor"]["center"][2] + found["floor"]["size"][2] / 2 == pytest.approx(0.0)
    assert min(found["floor"]["size"][:2]) >= 10.0


def test_bodies_are_what_moves_freely(seen):
    model, data, world = seen.model, seen.data, seen.world
    assert set(world.bodies) == {"pot", "toy", "brick"}
    for name, mass in (("pot", 0.85), ("toy", 0.4)):
        body = world.body(name)
        assert body.mass == pytest.approx(mass)
        np.testing.assert_allclose(body.pose, matrix(data.body(name).xpos, data.body(name).xmat), atol=1e-12)
        for site, pose in body.sites.items():
            expected = matrix(data.site(site).xpos, data.site(site).xmat)
            np.testing.assert_allclose(body.pose @ pose, expected, atol=1e-12)
        geoms = [
            k for k in range(model.ngeom) if model.body_rootid[model.geom_bodyid[k]] == model.body(name).id
        ]
        assert len(geoms) == len(body.parts) == 3
        for geom, part in zip(geoms, body.parts, strict=True):
            pose = body.pose @ placed(part)
            np.testing.assert_allclose(pose[:3, 3], data.geom_xpos[geom], atol=1e-8)
            turned = data.geom_xmat[geom].reshape(3, 3).T @ pose[:3, :3]
            along = {"bar": ([0.0, 0.0, 1.0], turned[:, 0])}.get(part["shape"], (np.eye(3), turned))
            if model.geom_size[geom][1] or part["shape"] == "mesh":  # a ball has no direction
                np.testing.assert_allclose(*along, atol=1e-8)
    assert set(world.body("pot").sites) == {"handle", "knob"}
    assert [part["shape"] for part in world.body("pot").parts] == ["box", "box", "cylinder"]
    assert world.body("pot").parts[0]["size"] == pytest.approx([0.1, 0.2, 0.1])
    capsule, ball, wedge = world.body("toy").parts
    assert (capsule["radius"], capsule["length"]) == pytest.approx((0.02, 0.1))
    assert ball["radius"] == pytest.approx(0.03) and ball["length"] < 1e-5
    assert (world.folder / wedge["file"]).is_file()


def test_bodies_reach_as_far_as_their_geoms(seen):
    """As points on the geoms show: boxes, cylinders, bars, balls and meshes, turned as they are."""
    rng = np.random.default_rng(0)
    for name in ("pot", "toy"):
        body = seen.world.body(name)
        for turn in [np.eye(3), *Rotation.random(20, random_state=1).as_matrix()]:
            pose = matrix(rng.normal(size=3), turn)
            points = np.concatenate([surface(part, seen.world.folder, rng) for part in body.parts])
            assert (np.linalg.norm(points, axis=1) <= body.radius + 1e-9).all()
            heights = points @ turn[2] + pose[2, 3]
            assert body.at(pose).lowest == pytest.approx(heights.min(), abs=1e-3)
            assert body.at(pose).lowest <= heights.min() + 1e-9


def surface(part, folder, rng):
    """Points on a part, in its body's frame."""
    along = rng.normal(size=(20_000, 3))
    along /= np.linalg.norm(along, axis=1)[:, None]
    match part["shape"]:
        case "box":
            points = 0.5 * np.array(part["size"]) * np.sign(along)
        case "cylinder":
            circle = along[:, :2] / np.linalg.norm(along[:, :2], axis=1)[:, None]
            points = np.column_stack([part["radius"] * circle, 0.5 * part["height"] * np.sign(along[:, 2])])
        case "bar":
            points = part["radius"] * along
            points[:, 0] += 0.5 * part["length"] * np.sign(along[:, 0])
        case "mesh":
            points = part["scale"] * triangles_of((folder / part["file"]).read_bytes(), ".stl")[0]
    pose = placed(part)
    return points @ pose[:3, :3].T + pose[:3, 3]


def test_a_scene_takes_what_a_world_holds(seen):
    """Obstacles and parts are written as scenes have them, and paths are relative to the world's folder."""
    world = seen.world
    for name, held in (("pot", [0.0, 0.13, 0.02]), ("toy", [0.1, 0.0, 0.0])):
        body = world.body(name)
        at = {"position": body.pose[:3, 3].tolist()}
        scene = Scene.from_dict(
            {
                "version": 2,
                "name": name,
                "duration": 4.0,
                "workspace": {"lower": [-2.0, -2.0, -0.5], "upper": [2.0, 2.0, 3.0]},
                "obstacles": [dict(entry) for entry in world.obstacles],
                "payload": {
                    "parts": [dict(part) for part in body.parts],
                    "mass": body.mass,
                    "start": at,
                    "goal": at,
                },
                "grasps": {
                    arm: {"position": held, "approach": [0, 0, -1], "closing": [0, 1, 0]}
                    for arm in ("robot0",)
                },
            },
            folder=world.folder,
            check_ends=False,
        )
        assert len(scene.file.obstacles) == 5


def test_objects_that_hold_model_and_data_will_do(seen):
    model, data = seen.model, seen.data
    for held in (
        SimpleNamespace(model=SimpleNamespace(_model=model), data=SimpleNamespace(_data=data)),
        SimpleNamespace(model=SimpleNamespace(ptr=model), data=SimpleNamespace(ptr=data)),
        SimpleNamespace(model=model, data=data),
    ):
        world = World.from_mujoco(held)
        assert world.robot.sha256 == seen.world.robot.sha256
        np.testing.assert_array_equal(world.joints_of(held.data), seen.world.joints_of(data))


def test_arms_take_the_names_that_are_given(seen):
    world = World.from_mujoco(seen.model, seen.data, arms={"low": "b_palm", "high": "a_j3"})
    assert {arm.name: arm.tip for arm in world.robot.arms} == {"low": "b_palm", "high": "a_palm"}
    assert world.grippers["low"].actuators == (11,)
    alone = World.from_mujoco(seen.model, seen.data, arms={"only": "b_k1"})
    assert alone.robot.joint_names == tuple(f"b_j{k}" for k in range(1, 6))
    posture = alone.robot.description.posture
    assert posture["a_j2"] == pytest.approx(float(seen.data.qpos[seen.model.joint("a_j2").qposadr[0]]))


def test_arms_of_one_base_are_called_by_their_sides():
    one = MODEL.replace('<body name="a_base"', '<body name="trunk"><geom size=".01"/><body name="a_base"', 1)
    one = one.replace('<body name="b_base"', "<!-- --><body name='b_base'").replace(
        "</worldbody>", "</body></worldbody>"
    )
    for old, new in (("a_", "left_"), ("b_", "right_")):
        one = one.replace(f'"{old}', f'"{new}').replace(f"'{old}", f"'{new}")
    model, data = simulated(one)
    assert [arm.name for arm in World.from_mujoco(model, data).robot.arms] == ["left", "right"]


def test_another_state_is_another_home_and_the_same_model(seen):
    data = engine().MjData(seen.model)
    data.qpos[:] = seen.data.qpos
    data.qpos[seen.world.addresses] += 0.1
    other = World.from_mujoco(seen.model, data)
    assert other.folder == seen.world.folder
    np.testing.assert_array_equal(other.robot.home, other.joints_of(data))


def test_another_payload_is_another_body_of_the_same_robot(seen):
    """Environments draw the sizes of what is carried anew."""
    model, data = simulated(MODEL.replace('size=".05 .1 .05" mass=".7"', 'size=".04 .1 .05" mass=".6"'))
    other = World.from_mujoco(model, data)
    assert other.folder == seen.world.folder and other.robot is seen.world.robot
    assert other.body("pot").mass == pytest.approx(0.75)
    stiff = World.from_mujoco(*simulated(MODEL.replace('kp="300"', 'kp="200"')))
    assert stiff.folder != seen.world.folder


def test_a_damaged_cache_is_mended(seen):
    """A file of another size is none of a world's."""
    for file in (*(seen.world.folder / "meshes").iterdir(), seen.world.folder / "robot.urdf"):
        file.write_bytes(file.read_bytes()[:100])
    again = World.from_mujoco(seen.model, seen.data)
    assert again.robot.sha256 == seen.world.robot.sha256
    assert (again.folder / "robot.urdf").stat().st_size > 1000


def test_processes_share_the_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    program = (
        "import sys, mujoco; from comove.tasks import World\n"
        "model = mujoco.MjModel.from_xml_string(sys.argv[1])\n"
        "print(World.from_mujoco(model, mujoco.MjData(model)).robot.sha256)"
    )
    running = [
        subprocess.Popen([sys.executable, "-c", program, MODEL], stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    assert len({one.communicate(timeout=100)[0] for one in running}) == 1
    assert [one.returncode for one in running] == [0, 0]
    assert not [path for path in Path(tmp_path).rglob(".*")], "drafts stay behind"


def refused(match, *arguments, **keywords):
    with pytest.raises(RobotError, match=match) as told:
        World.from_mujoco(*arguments, **keywords)
    return str(told.value)


def test_unknown_and_fixed_bodies_are_refused_in_words(seen):
    world = seen.world
    with pytest.raises(TaskError, match="no body 'pott'; did you mean 'pot'"):
        world.body("pott")
    with pytest.raises(TaskError, match="'table' is fixed, or held by joints"):
        world.body("table")
    with pytest.raises(TaskError, match="'a_palm' is fixed, or held by joints"):
        world.body("a_palm")
    with pytest.raises(TaskError, match="no site 'handel'; did you mean 'handle'"):
        world.body("pot").site("handel")


def test_worlds_without_arms_or_actuators_are_refused(seen):
    model, data = simulated(MODEL[: MODEL.index("<actuator>")] + "</mujoco>")
    refused("no actuators", model, data)
    one = MODEL.replace('<motor joint="a_j1" gear="2" ctrlrange="-30 30"/>', "")
    model, data = simulated(one)
    assert [arm.tip for arm in World.from_mujoco(model, data).robot.arms] == ["b_palm"], (
        "a's first joint hangs free"
    )
    few = "<mujoco><worldbody><body><joint name='j'/><geom size='.1'/></body></worldbody>"
    few += "<actuator><motor joint='j'/></actuator></mujoco>"
    model = engine().MjModel.from_xml_string(few)
    refused("no arm is in the model", model, engine().MjData(model))
    refused(
        "arms.left: no arm has a joint or body 'a_plam'; did you mean 'a_palm'",
        *_pair(seen),
        arms={"left": "a_plam"},
    )
    refused("has a name already", *_pair(seen), arms={"left": "a_palm", "right": "a_j1"})


def _pair(seen):
    return seen.model, seen.data


def test_states_that_are_none_are_refused(seen):
    mujoco, model = engine(), seen.model
    data = mujoco.MjData(model)
    data.qpos[model.joint("b_j2").qposadr[0]] = np.nan
    refused("position of 'b_j2' is no finite number", model, data)
    with pytest.raises(RobotError, match="diverged"):
        seen.world.joints_of(data)
    other = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='.1'/></worldbody></mujoco>")
    refused("0 positions, and the model", model, mujoco.MjData(other))
    refused("no MjModel and MjData", model)
    refused("no MjModel and MjData", "env", "sim")
    data = mujoco.MjData(model)
    data.qpos[model.joint("a_j3").qposadr[0]] = 2.7
    refused("'a_j3' is at 2.7, outside its limits -2.5 to 2.5", model, data)


def test_a_robot_that_moves_freely_is_refused():
    free = MODEL.replace(
        '<body name="a_base" pos="0 .4 0">', '<body name="a_base" pos="0 .4 0"><freejoint name=\'drift\'/>'
    )
    model, data = simulated(free)
    refused("moves freely by 'drift'", model, data)
