"""Which grasp is taken where a scene leaves it open, and that it holds: by Pinocchio, from the stored scene."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from comove.errors import SceneError
from comove.robots import Robot, carry
from comove.robots.files import read_joints, write_joints
from comove.scenes import Scene

EXAMPLE = Path(__file__).parents[2] / "examples" / "robots" / "from_the_side.yaml"


def example(**grasp):
    scene = Scene.load(EXAMPLE)
    return Scene.from_dict({**scene.file.model_dump(), "grasp": grasp}) if grasp else scene


@pytest.mark.slow
def test_a_bar_is_carried_from_the_side_where_hands_from_above_do_not_reach():
    robot, scene = Robot.load("two_xarm7"), example()
    found = carry(scene, robot, seed=0)
    assert found.verified
    chosen = found.motion.scene
    assert len(chosen.alternatives) == 1
    assert chosen.file.grasp.orientation == "forward"
    assert chosen.sha256 in {choice.sha256 for choice in scene.alternatives}
    for q in found.joints.position[::200]:
        poses = [robot.tool_pose(q, arm) for arm in (robot.arm("left"), robot.arm("right"))]
        places = np.array([pose[:3, 3] for pose in poses])
        for pose, wanted in zip(poses, chosen.grasp.hand_rotations(places), strict=True):
            np.testing.assert_allclose(pose[:3, :3], wanted, atol=1e-6)
            assert abs(pose[2, 2]) < 1e-6  # the approach is level


@pytest.mark.slow
def test_a_grasp_by_which_nobody_reaches_is_told():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = example(any_of=[{"orientation": "down"}, {"orientation": "forward", "offset_deg": 90}])
    with pytest.raises(SceneError, match="cannot reach"):
        carry(scene, Robot.load("two_xarm7"), budget=1.0)


@pytest.mark.slow
def test_the_mesh_of_a_scene_is_found_from_the_results_folder(tmp_path):
    scene = Scene.load(EXAMPLE.with_name("over_a_sill.yaml"))
    found = carry(scene, Robot.load("two_ur10"), seed=0)
    assert found.verified
    write_joints(tmp_path, found.joints, found.verdict, found.robot, found.solution.attempt)
    assert (
        read_joints(tmp_path).scene.sha256 == found.motion.scene.sha256
    )  # the mesh is found, and it is the same one
