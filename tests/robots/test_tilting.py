"""Robots tilt what they carry: by Pinocchio and by differences, not by the kinematics of the search."""

from functools import lru_cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import comove
from comove.errors import ComoveWarning, SceneError
from comove.model import Scene
from comove.model.motion import CoordinatedMotion
from comove.robots import Robot, RobotCarrier, verify_joints
from comove.robots.search.following import follow_one, hand_rotation
from comove.robots.verification.carried import Carried
from comove.sim import Weld, simulate
from tests.meshes import prism
from tests.model.test_payload_poses import wxyz
from tests.robots.raw_links import RawLinks

DOWN = Rotation.from_matrix(np.diag([-1.0, 1.0, -1.0]))
TRAY = {"shape": "box", "size": [0.5, 0.2, 0.04], "mass": 0.6}
ACROSS = Rotation.from_euler("z", 90, degrees=True)  # the payload's x axis points along the world's y


def tilted(degrees, axis="x"):
    return Rotation.from_euler(axis, degrees, degrees=True) * ACROSS


@lru_cache
def robot(name="two_pandas"):
    return Robot.load(name)


def tray_data(goal=None, load=TRAY, robot="two_pandas", at=(0.45, 0.0, 0.3), to=(0.5, 0.05, 0.45), **more):
    """The contents of a scene file in which two arms carry a tray between them, and tilt it."""
    goal = tilted(35) if goal is None else goal
    half = 0.23 if robot == "two_pandas" else 0.28
    grasps = {"left": [half, 0.0, 0.02], "right": [-half, 0.0, 0.02]}
    poses = {"start": (list(at), ACROSS), "goal": (list(to), goal)}
    offset = Rotation.from_euler("z", 180 if robot == "two_pandas" else 0, degrees=True)
    load = dict(load) | ({} if load["shape"] == "bar" else {"grasps": grasps})
    load |= {end: {"position": p, "quaternion_wxyz": wxyz(turn)} for end, (p, turn) in poses.items()}
    return {
        "name": "tray",
        "duration": 6.0,
        "robot": robot,
        "grasp": {"frames": dict.fromkeys(grasps, wxyz(offset * DOWN))},
        "workspace": {"lower": [-0.5, -1.0, 0.0], "upper": [1.4, 1.0, 1.4]},
        "load": load,
        "manipulators": [
            {"name": name} | {end: (np.array(p) + turn.apply(r)).tolist() for end, (p, turn) in poses.items()}
            for name, r in grasps.items()
        ],
        "limits": {"speed": 0.5, "acceleration": 1.0},
    } | more


@lru_cache
def followed():
    """A tray that is tilted by 35 degrees on the straight line, and the joints of two Pandas that carry it so."""
    scene = Scene.from_dict(tray_data())
    carrier, straight = RobotCarrier(robot(), scene), CoordinatedMotion.straight(scene)
    joints, miss = carrier.track(straight)
    assert miss is None
    return straight, carrier, joints


def test_the_stored_joints_hold_the_payload_in_all_poses():
    """Between samples too: forward kinematics of the raw URDFs give the payload's pose times the grasps, by SciPy."""
    straight, _, joints = followed()
    scene, load, raw = straight.scene, straight.scene.file.load, RawLinks(robot())
    for time in np.random.default_rng(0).uniform(0.0, scene.duration, 40):
        q = straight.at([time / scene.duration])[0, 0]
        center, turn = q[:3], Rotation.from_quat(np.roll(q[3:], -1))
        for name in scene.manipulators:
            pose = raw.grasp(name, joints.curve(time))
            frame = Rotation.from_quat(np.roll(scene.file.grasp.frames[name], -1))
            np.testing.assert_allclose(pose.translation, center + turn.apply(load.grasps[name]), atol=1e-6)
            np.testing.assert_allclose(pose.rotation, (turn * frame).as_matrix(), atol=1e-6)


def test_tilting_is_verified_with_its_spin_and_bounds():
    straight, _, joints = followed()
    assert verify_joints(robot(), straight, joints).reasons == ()
    carried, h = Carried(straight), 1e-4
    time = np.linspace(2 * h, straight.scene.duration - 2 * h, 301)
    behind, held, ahead = (carried.hands(time + shift) for shift in (-h, 0.0, h))
    spins = held.spins
    turned = (ahead.rotations @ behind.rotations.swapaxes(-1, -2)).reshape(-1, 3, 3)
    by_difference = Rotation.from_matrix(turned).as_rotvec().reshape(spins.shape) / (2 * h)
    np.testing.assert_allclose(spins, by_difference, atol=1e-6)
    jerk = np.linalg.norm(ahead.spins - 2 * spins + behind.spins, axis=2) / h**2
    bound = carried.swing.over(time - h, time + h)
    assert (jerk <= bound + 1e-3).all()
    assert bound.max() < 50 * jerk.max(), "and it is no bound for everything"


def test_a_hand_that_is_turned_off_the_payload_is_found():
    straight, _, joints = followed()
    off = joints.position.copy()
    column = robot().arm("left").columns[-1]
    off[:, column] += 1e-3 * np.sin(np.pi * joints.time / joints.time[-1]) ** 2
    told = verify_joints(robot(), straight, type(joints)(joints.time, joints.joint_names, off)).reasons
    assert any("hand 'left'" in reason and "turned" in reason for reason in told)


def test_kernels_turn_hands_as_the_scene_says():
    straight, carrier, _ = followed()
    coordinates, out = straight.coordinates, np.empty((3, 3))
    nodes = coordinates.nodes(np.ascontiguousarray(straight.at(np.linspace(0, 1, 7))[0].T[None]))[0]
    for at in nodes:
        for i, wanted in enumerate(straight.scene.grasp.hand_rotations(at)):
            hand_rotation(carrier.arms.around, at, i, out)
            np.testing.assert_allclose(out, wanted, atol=1e-12)


def test_a_goal_that_no_arm_can_reach_is_told_with_what_is_missing():
    scene = Scene.from_dict(tray_data(tilted(30), to=(1.1, 0.0, 0.5)))
    with pytest.raises(
        SceneError, match=r"cannot reach its goal at .*: 0\.\d+ m and \d.* degrees are missing"
    ):
        RobotCarrier(robot(), scene).require_reach()
    with pytest.raises(SceneError, match="degrees are missing"):
        RobotCarrier(robot(), Scene.from_dict(tray_data(tilted(150)))).require_reach()


def test_a_mesh_is_carried_as_the_box_that_it_is(tmp_path):
    """Links keep the same distance from both, by polytopes and by coal's box, but for what polytopes are larger."""
    x, y, z = 0.5 * np.array(TRAY["size"])
    vertices, faces = prism(np.array([[-x, -y], [x, -y], [x, y], [-x, y]]), 0, 2 * z)
    lines = [f"v {a} {b} {c - z}" for a, b, c in vertices]
    lines += ["f " + " ".join(str(i + 1) for i in face) for face in faces]
    (tmp_path / "tray.obj").write_text("\n".join(lines))
    mesh = {"shape": "mesh", "file": "tray.obj", "mass": 0.6}
    scene = Scene.from_dict(tray_data(load=mesh), folder=tmp_path)
    straight, (_, _, joints) = CoordinatedMotion.straight(scene), followed()
    own, of_box = (verify_joints(robot(), motion, joints, slack=0.0) for motion in (straight, followed()[0]))
    assert own.reasons == ()
    excess = scene.excess["load"] + 1e-3
    assert own.report.clearance_load == pytest.approx(of_box.report.clearance_load, abs=excess)
    carrier = RobotCarrier(robot(), scene)
    nodes, q = scene.nodes_at("start"), joints.curve(0.0)[carrier.ends.columns]
    near = [
        c.ends.clearances(q[None], n)[0]
        for c, n in ((carrier, nodes), (followed()[1], followed()[0].scene.nodes_at("start")))
    ]
    assert near[0] == pytest.approx(near[1], abs=excess)


def test_a_mesh_without_a_volume_is_told_and_counts_as_a_thin_wall(tmp_path):
    """Nothing is inside of it, and links keep clear of its surface."""
    (tmp_path / "flat.obj").write_text(
        "v -0.25 -0.1 0\nv 0.25 -0.1 0\nv 0.25 0.1 0\nv -0.25 0.1 0\nf 1 2 3 4\n"
    )
    with pytest.warns(ComoveWarning, match="'flat.obj' is not closed"):
        scene = Scene.from_dict(tray_data(load={"shape": "mesh", "file": "flat.obj"}), folder=tmp_path)
    straight, joints = CoordinatedMotion.straight(scene), followed()[2]
    report = verify_joints(robot(), straight, joints).report
    assert 0.005 < report.clearance_load < np.inf


@pytest.mark.slow
def test_a_plank_is_tilted_through_a_slot_and_delivered():
    """Level it would not pass: slabs on both sides, 40 degrees inclined, are nearer to it than their ends rise."""
    turn = tilted(40)
    slabs = [
        {
            "shape": "box",
            "center": (np.array([0.46, 0.0, 0.39]) + turn.apply([0.0, 0.0, side * 0.08])).tolist(),
            "size": [0.2, 0.04, 0.03],
            "quaternion_wxyz": wxyz(turn),
        }
        for side in (-1, 1)
    ]
    ends = {"at": (0.34, 0.0, 0.35), "to": (0.58, 0.0, 0.4)}
    plank = {**TRAY, "size": [0.5, 0.12, 0.04]}
    scene = Scene.from_dict(tray_data(tilted(20), plank, obstacles=slabs, **ends))
    found = comove.solve(scene, robot=robot(), seed=0)
    assert found.verified, found.reasons
    played = simulate(found.joints.attempt, scene, robot(), Weld())
    assert played.delivered, played.reasons


@pytest.mark.slow
def test_one_arm_tilts_what_it_holds_alone():
    data = tray_data(tilted(50, "y"))
    data["manipulators"], data["load"]["held_by"] = data["manipulators"][:1], ["left"]
    for key in (data["load"]["grasps"], data["grasp"]["frames"]):
        del key["right"]
    found = comove.solve(Scene.from_dict(data), robot=robot(), seed=0)
    assert found.verified, found.reasons


def test_pairs_of_ends_are_first_those_between_which_the_straight_motion_leads():
    """A UR5 holds a box in several ways, and hardly ever changes from one to another while it holds it."""
    machine, grasps = robot("ur5_and_panda"), {"left": [0.2, 0.0, 0.03], "right": [-0.2, 0.0, 0.03]}
    poses = {
        "start": ([0.107, -0.039, 0.315], Rotation.from_quat([-0.0046, -0.0079, 0.7423, 0.67])),
        "goal": ([0.336, -0.1, 0.383], Rotation.from_quat([-0.102, -0.3135, 0.7657, 0.5523])),
    }
    load = {"shape": "box", "size": [0.44, 0.16, 0.06], "mass": 0.6, "grasps": grasps}
    load |= {end: {"position": p, "quaternion_wxyz": wxyz(turn)} for end, (p, turn) in poses.items()}
    turned = Rotation.from_euler("z", 180, degrees=True) * DOWN
    data = tray_data() | {
        "robot": "ur5_and_panda",
        "grasp": {"frames": {"left": wxyz(DOWN), "right": wxyz(turned)}},
        "load": load,
        "manipulators": [
            {"name": name} | {end: (np.array(p) + turn.apply(r)).tolist() for end, (p, turn) in poses.items()}
            for name, r in grasps.items()
        ],
    }
    scene = Scene.from_dict(data)
    carrier, motion = RobotCarrier(machine, scene), CoordinatedMotion.straight(scene)
    first, last = carrier._pairs[0]
    nodes = np.ascontiguousarray(motion.coordinates.motion(motion.at(np.linspace(0, 1, 201)))[0])
    q, missing = np.empty((201, len(first))), np.empty((201, 2))
    follow_one(carrier.arms, nodes, np.stack([first, first]), q, missing)
    assert missing.max() < 1e-3
    assert np.abs(q[-1] - last).max() < 1.0
