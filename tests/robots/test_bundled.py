"""The robots that come with the package: what is known of them, and that they deliver a load in MuJoCo."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import comove
from comove.errors import SceneError
from comove.model import Scene
from comove.robots import Robot, RobotCarrier
from comove.sim import simulate
from tests.robots.small_robots import EXAMPLES, robot, urdf, written

DENAVIT_HARTENBERG = [  # a [m], d [m], alpha [deg] of the FR3 (Craig's convention), as its maker publishes them
    (0.0, 0.333, 0),
    (0.0, 0.0, -90),
    (0.0, 0.316, 90),
    (0.0825, 0.0, 90),
    (-0.0825, 0.384, -90),
    (0.0, 0.0, 90),
    (0.088, 0.0, 90),
]


def example(name):
    return Scene.load(EXAMPLES / "robots" / f"{name}.yaml")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["g1", "pr2", "two_fr3", "two_so101"])
def test_a_load_is_carried_and_delivered(name):
    found = comove.solve(example(name), robot=Robot.load(name), seed=0)
    assert found.verified
    done = simulate(found.joints.attempt, found.scene, found.joints.robot)
    assert done.delivered
    assert not done.contacts


def test_the_fr3_is_where_its_makers_parameters_say():
    machine, rng = robot("two_fr3"), np.random.default_rng(0)
    arm = machine.arm("left")
    for q in rng.uniform(machine.lower[arm.columns], machine.upper[arm.columns], (20, 7)):
        pose = np.eye(4)
        pose[:3, 3] = 0.0, 0.4, 0.0
        for (a, d, alpha), angle in zip(DENAVIT_HARTENBERG, q, strict=True):
            step = np.eye(4)
            step[:3, :3] = Rotation.from_euler("x", alpha, degrees=True).as_matrix()
            step[:3, 3] = a, 0.0, 0.0
            turn = np.eye(4)
            turn[:3, :3] = Rotation.from_euler("z", angle).as_matrix()
            turn[:3, 3] = 0.0, 0.0, d
            pose = pose @ step @ turn
        hand = np.eye(4)
        hand[:3, :3] = Rotation.from_euler("z", -45, degrees=True).as_matrix()
        hand[:3, 3] = 0.0, 0.0, 0.107 + 0.1034
        whole = machine.home
        whole[arm.columns] = q
        np.testing.assert_allclose(machine.tool_pose(whole, arm), pose @ hand, atol=1e-9)


@pytest.mark.slow
def test_hands_of_five_joints_point_down_with_any_heading_and_nobody_is_told_that_they_turn_every_way():
    scene = example("two_so101")
    for angle in (100.0, 180.0, 270.0):
        turned = scene.file.model_dump() | {"grasp": {"orientation": "down", "offset_deg": angle}}
        RobotCarrier(robot("two_so101"), Scene.from_dict(turned)).require_reach()
    level = scene.file.model_dump() | {"grasp": {"orientation": "forward"}}
    with pytest.raises(SceneError, match="5 joints cannot turn a hand every way, but most let it point down"):
        RobotCarrier(robot("two_so101"), Scene.from_dict(level)).require_reach()


@pytest.mark.parametrize("half", ["3.14159", "3.14160", "3.14158"])
@pytest.mark.parametrize("rounded", [True, False])
def test_right_angles_of_five_digits_are_as_written_unless_rounding_is_asked_for(tmp_path, half, rounded):
    """Half a turn of five digits leaves axes askew, for which five joints cannot make up: rounded, by 3e-6 rad; in an
    SO-100's URDF it is two right angles that were cut. Other programs read what is written.
    """
    limit = '<limit lower="-2" upper="2" velocity="1" effort="9"/>'
    parts = [
        f'<link name="l{k}"/><joint name="j{k}" type="revolute"><parent link="{before}"/><child link="l{k}"/>'
        f'<origin xyz="0 0 0.1" rpy="{rpy}"/><axis xyz="0 0 1"/>{limit}</joint>'
        for k, (before, rpy) in enumerate((("base", f"{half} 0 -1.5708"), ("l0", "1.5709 0.78540 0")))
    ]
    model = {"urdf": "arm.urdf"} | ({"round_right_angles": True} if rounded else {})
    description = {"models": [model], "arms": {"a": {"tip": "l1"}}}
    with pytest.warns() as caught:
        machine = Robot.load(written(tmp_path, {"arm.urdf": urdf("".join(parts))}, description))
    said = [str(warning.message) for warning in caught if "round_right_angles" in str(warning.message)]
    assert len(said) == (not rounded)  # two joints cannot make up for it
    first, second = (placement.rotation for placement in machine.model.jointPlacements[1:3])
    angles = [np.pi, 0, -np.pi / 2] if rounded else [float(half), 0, -1.5708]
    np.testing.assert_allclose(first, Rotation.from_euler("xyz", angles).as_matrix(), atol=1e-15)
    np.testing.assert_allclose(
        second, Rotation.from_euler("xyz", [1.5709, 0.7854, 0]).as_matrix(), atol=1e-12
    )
