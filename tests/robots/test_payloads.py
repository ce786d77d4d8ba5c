"""Arms carry what their makers rate them for: shares as the rule of the lever has them, and hands count."""

import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from comove.errors import SceneError
from comove.model import Scene
from comove.robots import Robot, verify_joints
from comove.robots.carrying import RobotCarrier
from comove.robots.effort import carried_masses, loaded_model, overburdened
from tests.meshes import hull, write_obj
from tests.robots.known_carry import baxter, known_carry, on_scene, scene_data
from tests.robots.known_path import DISTANCE
from tests.robots.small_robots import robot, urdf, written

HAND = 0.55175  # kg, of Baxter's electric gripper and what holds it, in its URDF


def box_held_at(left: float, right: float, mass: float = 2.0) -> Scene:
    """A box that two hands hold at two places along it [m], which are as far apart as the hands are."""
    grasps = {"left": [left, 0.0, 0.0], "right": [right, 0.0, 0.0]}
    size = [2.0 * max(abs(left), abs(right)), 0.05, 0.05]
    load = {"shape": "box", "size": size, "mass": mass, "grasps": grasps}
    return Scene.from_dict(
        scene_data(obstacles=(), load=load, workspace={"lower": [-5] * 3, "upper": [5] * 3})
    )


@pytest.mark.parametrize("off", [0.0, 0.05, -0.2, 0.7 * DISTANCE])
def test_shares_balance_the_load_about_its_centre_of_mass(off):
    scene = box_held_at(off + 0.5 * DISTANCE, off - 0.5 * DISTANCE)
    masses = carried_masses(scene)
    assert masses.sum() == pytest.approx(2.0)
    assert masses @ [off + 0.5 * DISTANCE, off - 0.5 * DISTANCE] == pytest.approx(0.0, abs=1e-9)
    if off == 0.0:
        assert masses.tolist() == [1.0, 1.0]


def test_a_mesh_balances_about_the_centre_of_its_volume(tmp_path):
    """A club has most corners at its thin end; the integral is over the tetrahedra of its triangles."""
    angle = 2.0 * np.pi * np.arange(12) / 12
    thin = np.column_stack([np.full(12, 0.5), 0.02 * np.cos(angle), 0.02 * np.sin(angle)])
    thick = np.array([[0.0, y, z] for y in (-0.08, 0.08) for z in (-0.08, 0.08)])
    vertices, faces = hull(np.concatenate([thin, thick]))
    write_obj(tmp_path / "club.obj", vertices, faces)
    corners = vertices[faces]
    center = np.average(0.25 * corners.sum(axis=1), axis=0, weights=np.linalg.det(corners))
    assert abs(vertices.mean(axis=0) - center)[0] > 0.1
    grasps = {"left": [0.4, 0.0, 0.0], "right": [0.0, 0.0, 0.0]}
    load = {"shape": "mesh", "file": "club.obj", "mass": 2.0, "grasps": grasps}
    data = scene_data(obstacles=(), load=load, workspace={"lower": [-5] * 3, "upper": [5] * 3})
    for hand in data["manipulators"]:
        hand["start"] = hand["goal"] = (np.array(grasps[hand["name"]]) + [0.4, 0.0, 0.3]).tolist()
    masses = carried_masses(Scene.from_dict(data, folder=tmp_path))
    assert masses.tolist() == pytest.approx([2.0 * center[0] / 0.4, 2.0 - 2.0 * center[0] / 0.4], rel=1e-3)


def test_three_hands_hold_a_frame_in_balance():
    data = scene_data(obstacles=())
    places = np.array([[0.5, 0.3, 0.2], [0.5, -0.3, 0.2], [0.9, 0.0, 0.2]])
    names = ("left", "right", "third")
    data["manipulators"] = [
        {"name": name, "start": place.tolist(), "goal": place.tolist()}
        for name, place in zip(names, places, strict=True)
    ]
    data["load"] = {"shape": "frame", "edges": [["left", "right"], ["right", "third"]], "mass": 3.0}
    scene = Scene.from_dict(data)
    masses = carried_masses(scene)
    rods = [np.linalg.norm(places[a] - places[b]) for a, b in ((0, 1), (1, 2))]
    center = (rods[0] * places[:2].mean(axis=0) + rods[1] * places[1:].mean(axis=0)) / sum(rods)
    np.testing.assert_allclose(masses @ places / 3.0, center, atol=1e-9)


def test_torques_know_the_lever():
    """Weights at the hands by the transposed Jacobians, beside the model that torques are computed with."""
    machine, scene = baxter(), box_held_at(0.1 + 0.5 * DISTANCE, 0.1 - 0.5 * DISTANCE)
    q, weight = machine.home, np.zeros(len(machine.lower))
    data = machine.model.createData()
    for arm, share in zip(machine.arms, (0.5 - 0.1 / DISTANCE, 0.5 + 0.1 / DISTANCE), strict=True):
        model = machine.model.copy()
        frame = model.addFrame(pin.Frame("hand", *machine.grasp_frame(arm), pin.FrameType.OP_FRAME))
        jacobian = pin.computeFrameJacobian(model, model.createData(), q, frame, pin.LOCAL_WORLD_ALIGNED)
        weight += jacobian[2] * 2.0 * share * 9.81
    loaded = loaded_model(machine, machine.arms, carried_masses(scene))
    more = pin.computeGeneralizedGravity(loaded, loaded.createData(), q)
    np.testing.assert_allclose(
        more - pin.computeGeneralizedGravity(machine.model, data, q), weight, atol=1e-9
    )


def rated(machine: Robot, payload: float) -> Robot:
    return replace(machine, arms=tuple(replace(arm, payload=payload) for arm in machine.arms))


def test_a_motion_is_verified_if_its_arms_are_rated_for_it_and_the_advice_is_as_heavy_as_can_be():
    motion, joints = known_carry()
    enough, too_little = HAND + 0.125, HAND + 0.1249  # kg, with half of the 0.25 kg that nobody states
    verdict = verify_joints(rated(baxter(), enough), motion, joints)
    assert verdict.reasons == ()
    assert verdict.report.payload_ratio_max == pytest.approx(1.0)
    verdict = verify_joints(weak := rated(baxter(), too_little), motion, joints)
    assert len(verdict.reasons) == 2  # both arms
    assert (
        "'left' is rated for 0.67665 kg, and of the load of 0.25 kg it holds 0.125 kg and its hand 0.552 kg"
        in (verdict.reasons[0])
    )
    told = float(re.search(r"let the load weigh ([\d.]+) kg at most", verdict.reasons[0])[1])
    bar = scene_data()["load"]
    for mass, passes in ((told, True), (told + 1e-3, False)):
        lighter = on_scene(motion, Scene.from_dict(scene_data(load=bar | {"mass": mass})))
        assert (verify_joints(weak, lighter, joints).verified is not None) == passes


def test_what_arms_are_not_rated_for_is_refused_before_any_search():
    bar = scene_data()["load"]
    with pytest.raises(
        SceneError, match=r"rated for 2\.2 kg, and of the load of 4 kg it holds 2 kg"
    ) as caught:
        RobotCarrier(baxter(), Scene.from_dict(scene_data(load=bar | {"mass": 4.0})))
    assert caught.value.key == "load.mass"
    told = float(re.search(r"weigh ([\d.]+) kg at most", caught.value.way_out)[1])
    RobotCarrier(baxter(), Scene.from_dict(scene_data(load=bar | {"mass": told})))


def test_the_hand_is_all_that_hangs_beyond_the_last_link_whatever_holds_it(tmp_path):
    limit = '<limit lower="-1" upper="1" velocity="1" effort="9"/><axis xyz="0 0 1"/>'
    links = "".join(
        f'<link name="{name}"><inertial><mass value="{mass}"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" '
        'izz="1"/></inertial></link>'
        for name, mass in (("arm", 8.0), ("palm", 0.5), ("finger", 0.125), ("other", 4.0))
    )
    joints = "".join(
        f'<joint name="{name}" type="{kind}"><parent link="{above}"/><child link="{below}"/>{limit}</joint>'
        for name, kind, above, below in (
            ("j", "revolute", "base", "arm"),
            ("mount", "fixed", "arm", "palm"),
            ("grip", "revolute", "palm", "finger"),
            ("elsewhere", "fixed", "base", "other"),
        )
    )
    gripper = {"mass": 0.25, "shapes": [{"shape": "box", "size": [0.1, 0.1, 0.1]}]}
    for more, hand in (({}, 0.625), ({"gripper": gripper}, 0.875)):
        described = {"tip": "p_palm", "payload": 3} | more
        models = [{"urdf": "arm.urdf", "prefix": "p_"}]
        file = written(
            tmp_path, {"arm.urdf": urdf(links + joints)}, {"models": models, "arms": {"a": described}}
        )
        (machine,) = Robot.load(file).arms
        assert (machine.payload, machine.hand) == (3.0, pytest.approx(hand))


def test_bundled_arms_are_rated_as_their_makers_state_and_their_hands_leave_something():
    makers = {
        "two_ur10": [10.0, 10.0],
        "two_pandas": [3.0, 3.0],
        "two_fr3": [3.0, 3.0],
        "baxter": [2.2, 2.2],
        "two_xarm7": [3.5, 3.5],
        "ur5_and_panda": [5.0, 3.0],
    }
    for name, payloads in makers.items():
        arms = robot(name).arms
        assert [arm.payload for arm in arms] == payloads
        assert all(arm.hand < 0.3 * arm.payload for arm in arms)


def test_the_mass_that_is_advised_is_one_that_all_arms_hold():
    """Two arms are overburdened by the lever; the advice of the first suits the second as well."""
    scene = box_held_at(0.1 + DISTANCE, 0.1, 20.0)
    carrying = [replace(baxter().arm(name), payload=rated) for name, rated in (("left", 2.2), ("right", 3.0))]
    told = [*overburdened(scene, tuple(carrying))]
    assert len(told) == 2
    for reason in told:
        advised = float(re.search(r"let the load weigh ([\d.]+) kg at most", reason)[1])
        assert not [*overburdened(box_held_at(0.1 + DISTANCE, 0.1, advised), tuple(carrying))]
        assert [*overburdened(box_held_at(0.1 + DISTANCE, 0.1, 1.02 * advised), tuple(carrying))]
