"""The world of a simulation is the robot of the description and the scene as it is written."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from comove.errors import ComoveWarning, RobotError, SceneError
from comove.model import Scene
from comove.robots import JointMotion, Robot
from comove.robots.description import bundled_robots
from comove.sim import Friction, Perturbation, Weld, simulate
from comove.sim.building import build_world
from comove.sim.dynamics import at_start
from comove.sim.engine import engine
from comove.sim.loads import hand_poses, load_of
from comove.sim.servos import PayloadTorques, servo_gains
from comove.sim.world import add_obstacles, lower_floor, move_obstacles
from tests.robots.known_path import known_motion
from tests.sim.benchmark import posts, standing

CRANE = """<robot name="crane">
  <link name="ground"/>
  <link name="mast"><inertial><mass value="4"/><origin xyz="0.1 0 0.3"/>
    <inertia ixx=".25" iyy=".3" izz=".1" ixy=".01" ixz="0" iyz="0"/></inertial></link>
  <link name="boom"><inertial><mass value="2"/><origin xyz="0.4 0 0"/>
    <inertia ixx=".01" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="wrist"><inertial><mass value="1"/>
    <inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
  <link name="tip"/>
  <joint name="turn" type="continuous"><parent link="ground"/><child link="mast"/><axis xyz="0 0 1"/>
    <origin xyz="0 0 0.1" rpy="0.1 -0.2 0.3"/><limit effort="100" velocity="1"/></joint>
  <joint name="lift" type="prismatic"><parent link="mast"/><child link="boom"/><axis xyz="0 0 1"/>
    <origin xyz="0.1 0 0.5" rpy="0 0.4 0"/><limit lower="0" upper="0.5" effort="200" velocity="1"/></joint>
  <joint name="bend" type="revolute"><parent link="boom"/><child link="wrist"/><axis xyz="0 1 1"/>
    <origin xyz="0.8 0 0" rpy="1.2 0 0.5"/><limit lower="-2" upper="2" effort="20" velocity="2"/></joint>
  <joint name="end" type="fixed"><parent link="wrist"/><child link="tip"/>
    <origin xyz="0 0 0.2" rpy="0 1.57079632679 0"/></joint>
</robot>"""


def test_obstacles_turn_in_the_simulator_as_in_the_scene():
    """Boxes on hinges: MuJoCo's frames of their shapes are those of the scene's table."""
    turn = {"rate_deg_per_s": 50, "axis": [1, 2, 3], "hinge": [0.1, 0.0, 0.2]}
    turned = {"quaternion_wxyz": [0.5, 0.5, 0.5, 0.5], "motion": {"velocity": [0.1, 0, 0], "turn": turn}}
    boxes = [{"shape": "box", "center": [x, 0.0, 0.5], "size": [0.1, 0.2, 0.3], **turned} for x in (0.0, 1.0)]
    boxes.insert(1, {"shape": "sphere", "center": [0.0, 4.0, 0.5], "radius": 0.1})
    around = {"workspace": {"lower": [-9, -9, -9], "upper": [9, 9, 9]}, "duration": 4.0, "name": "hinged"}
    hands = [{"name": "a", "start": [3, 3, 3], "goal": [3, 4, 3]}]
    scene, spec = Scene.from_dict({**around, "obstacles": boxes, "manipulators": hands}), engine().MjSpec()
    add_obstacles(spec, scene)
    model = spec.compile()
    data = engine().MjData(model)
    for time in (0.0, 2.5):
        table = scene.obstacles_at(time)
        move_obstacles(data, scene, time, table[:, 1:4])
        engine().mj_kinematics(model, data)
        for i in range(len(boxes)):
            geom = data.geom(scene.name_of(i))
            np.testing.assert_allclose(geom.xpos, table[i, 1:4], atol=1e-12)
            np.testing.assert_allclose(geom.xmat, table[i, 4:13], atol=1e-12)


@pytest.fixture
def crane(tmp_path):
    """Makes a robot of two cranes, joints held where `posture` says."""

    def make(posture="{}", extra="", limits="{lower: -3, upper: 3}") -> Robot:
        (tmp_path / "crane.urdf").write_text(CRANE)
        (tmp_path / "cranes.yaml").write_text(
            "name: cranes\nmodels:\n"
            "  - {urdf: crane.urdf, prefix: a_}\n"
            "  - {urdf: crane.urdf, prefix: b_, base: {position: [0, 2, 0], quaternion_wxyz: [0.6, 0, 0, 0.8]}}\n"
            "arms: {a: {tip: a_tip, tool: {position: [0, 0.1, 0]}}, b: {tip: b_tip}}\n"
            f"posture: {posture}\n"
            f"limits: {{a_turn: {limits}, b_turn: {limits}}}\n{extra}"
        )
        return Robot.load(tmp_path / "cranes.yaml")

    return make


def bare(robot, q, **keys):
    """A scene without a load in which the robot's hands stand where they are."""
    hands = [robot.tool_pose(q, arm)[:3, 3].tolist() for arm in robot.arms]
    return Scene.from_dict(
        {
            "name": "bare",
            "duration": 1.0,
            "workspace": {"lower": [-5, -5, -5], "upper": [5, 5, 5]},
            "manipulators": [
                {"name": a.name, "start": h, "goal": h} for a, h in zip(robot.arms, hands, strict=True)
            ],
            **keys,
        }
    )


def in_state(robot, q, scene=None):
    """The world and its state with the joints at q."""
    world = build_world(robot, scene or bare(robot, q), None, Weld())
    data = engine().MjData(world.model)
    data.qpos[world.qpos] = q
    engine().mj_forward(world.model, data)
    return world, data


def some_joints(robot, seed=0):
    return np.random.default_rng(seed).uniform(robot.lower, robot.upper)


def assert_same_robot(robot):
    """Masses, weight and hands are those of Pinocchio."""
    q = some_joints(robot)
    world, data = in_state(robot, q)
    mass = np.zeros((world.model.nv, world.model.nv))
    for column, unit in zip(mass, np.eye(world.model.nv), strict=True):
        engine().mj_mulM(world.model, data, column, unit)
    inertia = pin.crba(robot.model, robot.model.createData(), q)
    inertia = np.triu(inertia) + np.triu(inertia, 1).T
    assert np.allclose(mass[np.ix_(world.dofs, world.dofs)], inertia, atol=1e-6)
    weight = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), q)
    assert np.allclose(data.qfrc_bias[world.dofs], weight, atol=1e-6)
    for site, arm in zip(world.sites, robot.arms, strict=True):
        pose = robot.tool_pose(q, arm)
        assert np.allclose(data.site_xpos[site], pose[:3, 3], atol=1e-9)
        assert np.allclose(data.site_xmat[site].reshape(3, 3), pose[:3, :3], atol=1e-9)


@pytest.mark.parametrize("name", bundled_robots())
@pytest.mark.few(3)
def test_masses_and_hands_are_those_of_the_description(name):
    assert_same_robot(Robot.load(name))


@pytest.mark.parametrize(
    "posture", ["{}", "{a_turn: 0.7, b_lift: 0.2}", "{a_lift: 0.3, a_bend: -1.1, b_bend: 0.4}"]
)
def test_joints_that_do_not_move_stay_where_the_posture_says(crane, posture):
    assert_same_robot(crane(posture))


def test_servos_are_as_stiff_as_the_motors_are_strong_where_nothing_is_said(crane):
    robot = crane()
    stiffness, damping = servo_gains(robot)
    by_name = dict(zip(robot.joint_names, stiffness, strict=True))
    assert by_name["a_bend"] == pytest.approx(20 / 0.025)
    assert by_name["a_lift"] == pytest.approx(200 / 0.001)
    assert np.allclose(damping**2, 4 * np.where(stiffness > 1e5, 3.0, 0.3) * stiffness)


def test_a_servo_for_another_number_of_joints_is_refused(crane):
    with pytest.raises(RobotError, match=r"servo.stiffness: it has 2 values, the arm 'a' 3 joints"):
        servo_gains(crane(extra="servo: {stiffness: [1000, 1000]}\n"))


def test_a_robot_of_cranes_holds_still(crane):
    robot = crane()
    q = some_joints(robot, 3)
    motion = JointMotion(np.linspace(0, 1, 5), robot.joint_names, np.repeat(q[None], 5, axis=0))
    execution = simulate(motion, bare(robot, q), robot)
    assert execution.delivered
    assert execution.measures["lag_max"] < 1e-6


def test_obstacles_are_where_and_as_large_as_the_scene_says():
    turned = [0.6, 0.0, 0.8, 0.0]
    shapes = [
        {"shape": "box", "center": [2, 2, 0.5], "size": [0.2, 0.4, 0.6], "quaternion_wxyz": turned},
        {"shape": "sphere", "center": [-2, 2, 0.5], "radius": 0.3},
        {"shape": "capsule", "center": [2, -2, 0.5], "radius": 0.1, "length": 0.4, "quaternion_wxyz": turned},
        {"shape": "cylinder", "center": [-2, -2, 0.5], "radius": 0.1, "height": 0.4},
        {"shape": "ellipsoid", "center": [2, 0, 2.5], "radii": [0.1, 0.2, 0.3]},
    ]
    robot, motion = known_motion()
    scene = bare(robot, motion.position[0], obstacles=shapes)
    world, data = in_state(robot, motion.position[0], scene)
    sizes = ([0.1, 0.2, 0.3], [0.3, 0, 0], [0.1, 0.2, 0], [0.1, 0.2, 0], [0.1, 0.2, 0.3])
    for i, (shape, size) in enumerate(zip(shapes, sizes, strict=True)):
        geom = world.model.geom(f"obstacles[{i}] ({shape['shape']})")
        assert np.allclose(data.geom_xpos[geom.id], shape["center"])
        assert np.allclose(geom.size, size)
        assert np.allclose(geom.quat, shape.get("quaternion_wxyz", [1, 0, 0, 0]))


def test_links_meet_obstacles_and_the_load_but_not_each_other():
    robot, motion = known_motion()
    scene = posts()
    load = load_of(scene, hand_poses(robot, scene, motion.position[:1])[0])
    model = build_world(robot, scene, load, Weld()).model
    link = next(g for g in range(model.ngeom) if model.body(model.geom_bodyid[g]).name == "left_wrist")
    post, stick = model.geom("obstacles[1] (cylinder)").id, model.geom("the load").id

    def meet(a, b):
        return bool(
            (model.geom_contype[a] & model.geom_conaffinity[b])
            | (model.geom_contype[b] & model.geom_conaffinity[a])
        )

    assert meet(link, post) and meet(link, stick) and meet(stick, post)
    assert not meet(link, link)


def test_a_moment_of_inertia_below_0_is_raised(crane, tmp_path):
    """As of the antennas of a TIAGo: MuJoCo would refuse the whole robot."""
    robot = crane()
    text = (tmp_path / "crane.urdf").read_text()
    wrist = '<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/>'
    assert wrist in text
    (tmp_path / "crane.urdf").write_text(text.replace(wrist, wrist.replace('ixx=".01"', 'ixx="-1e-5"')))
    with pytest.warns(ComoveWarning, match="none can be negative"):
        robot = Robot.load(tmp_path / "cranes.yaml")
    model = in_state(robot, some_joints(robot))[0].model
    assert model.body_inertia[1:].min() > 0
    assert model.body_mass.sum() == pytest.approx(sum(body.mass for body in robot.model.inertias))


def test_the_stick_weighs_what_the_scene_says():
    robot, motion = known_motion()
    for grasp in (Weld(), Friction()):
        scene = posts(mass=0.8)
        load = load_of(scene, hand_poses(robot, scene, motion.position[:1])[0], grasp.section)
        world = build_world(robot, scene, load, grasp)
        assert world.model.body_mass[world.load_body] == pytest.approx(0.8)


def test_a_finger_that_loses_its_load_does_not_leap_past_it():
    """From rest and with all its force, it goes less far in a time step than where its servo gives it all."""
    robot, motion = known_motion()
    scene, grasp = posts(), Friction()
    load = load_of(scene, hand_poses(robot, scene, motion.position[:1])[0], grasp.section)
    world = build_world(robot, scene, load, grasp)
    data, model = at_start(world, motion, PayloadTorques(robot, scene), Perturbation()), world.model
    fingers = world.fingers
    places = [model.joint(finger).qposadr[0] for finger in fingers]
    opened = np.array([max(model.joint(finger).range, key=abs) for finger in fingers])
    data.qpos[places], data.ctrl[[model.actuator(finger).id for finger in fingers]] = opened, -50.0 * opened
    engine().mj_step(model, data)
    closing = (opened - data.qpos[places]) * np.sign(opened)
    assert ((closing > 0) & (closing < 1e-3)).all(), closing


def test_the_floor_is_under_the_robot():
    """Baxter's base frame is 0.92 m above the floor."""
    robot, motion = standing()
    world, data = in_state(robot, motion.position[0])
    lower_floor(world, data, motion.position)
    assert world.model.geom("the floor").pos[2] == pytest.approx(-0.925, abs=0.005)


def test_the_floor_is_under_arms_that_will_go_lower_than_they_begin(crane):
    robot = crane()
    ways = np.linspace([0, 0.5, 0] * 2, [0.0, 0, 0] * 2, 30)  # booms go down
    world, data = in_state(robot, ways[0])
    floor = world.model.geom("the floor").id

    def touches(planned):
        data.qpos[world.qpos] = ways[0]
        engine().mj_forward(world.model, data)
        lower_floor(world, data, planned)
        assert (data.qpos[world.qpos] == ways[0]).all()
        met = False
        for q in ways:
            data.qpos[world.qpos] = q
            engine().mj_forward(world.model, data)
            met |= any(floor in contact.geom for contact in data.contact)
        return met

    assert touches(ways[:1])  # where they begin is not enough
    assert not touches(ways)


def test_a_scene_that_is_not_the_motions_is_refused():
    robot, motion = known_motion()
    with pytest.raises(SceneError, match=r"manipulators\[0\].start: the motion begins with the hand"):
        moved = bare(robot, motion.position[-1])
        simulate(motion, moved, robot)


def test_hands_without_fingers_cannot_hold_by_friction(crane):
    robot = crane()
    q = some_joints(robot)
    scene = bare(robot, q)
    hands = [robot.tool_pose(q, arm)[:3, 3] for arm in robot.arms]
    load = {"shape": "bar", "length": float(np.linalg.norm(hands[0] - hands[1]))}
    scene = bare(robot, q, load=load)
    motion = JointMotion(np.linspace(0, 1, 5), robot.joint_names, np.repeat(q[None], 5, axis=0))
    with pytest.raises(RobotError, match=r"the arm 'a' has no fingers"):
        simulate(motion, scene, robot, Friction())
    assert simulate(motion, scene, robot).delivered


def test_a_stick_that_is_too_wide_for_the_fingers_is_refused():
    robot, motion = standing()
    with pytest.raises(RobotError, match="does not open wide enough"):
        simulate(motion, posts(), robot, Friction(size=(0.08, 0.024)))


def test_a_visual_mesh_that_is_missing_hinders_nothing(crane, tmp_path):
    from comove.errors import ComoveWarning
    from comove.sim.pictures import furnish

    robot = crane()
    path = Path(tmp_path / "crane.urdf")
    path.write_text(
        CRANE.replace(
            "<collision>", '<visual><geometry><mesh filename="none.stl"/></geometry></visual><collision>', 1
        )
    )
    robot = Robot.load(tmp_path / "cranes.yaml")
    q = some_joints(robot)
    with pytest.warns(ComoveWarning, match="is not drawn"):
        build_world(robot, bare(robot, q), None, Weld(), finish=furnish)
