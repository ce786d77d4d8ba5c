"""A robot is drawn where its joints put it, with few triangles that stay near the many of its meshes."""

import numpy as np
import pytest

pytest.importorskip("pinocchio", reason="robots are not installed: pip install 'comove[robot]'")

import pinocchio as pin

from comove.geometry.rotations import matrices
from comove.robots import Robot
from comove.view.workbench.bodies import bodies_of, poses_of, simplified
from comove.view.workbench.geometry import ball
from tests.robots.small_robots import robot, urdf, written

CRANE = """
<material name="paint"><color rgba="1 0.5 0 1"/></material>
<link name="mast"><visual><origin xyz="0.3 0 0" rpy="0 0 1.5707963267948966"/>
<geometry><box size="0.1 0.4 0.02"/></geometry><material name="paint"/></visual>
<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="mast"/><origin xyz="0 0 0.5"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" velocity="1" effort="10"/></joint>
"""


def placed(bodies, poses, joint):
    """All corners of what a joint carries, in the scene."""
    corners = np.concatenate([body.surface.vertices for body in bodies if body.joint == joint])
    if joint < 0:
        return corners
    return corners @ matrices(poses[joint, 3:]).T + poses[joint, :3]


@pytest.mark.filterwarnings("ignore")
def test_a_box_on_a_mast_turns_with_it(tmp_path):
    description = {"models": [{"urdf": "crane.urdf"}], "arms": {"arm": {"tip": "mast"}}}
    crane = Robot.load(written(tmp_path, {"crane.urdf": urdf(CRANE)}, description))
    bodies = bodies_of(crane)
    (pose,) = poses_of(crane, np.array([[np.pi / 2]]))
    corners = placed(bodies, pose, 0)
    np.testing.assert_allclose(corners.min(axis=0), [-0.05, 0.1, 0.49], atol=1e-9)
    np.testing.assert_allclose(corners.max(axis=0), [0.05, 0.5, 0.51], atol=1e-9)
    assert {body.colour for body in bodies} == {(255, 128, 0)}


@pytest.mark.parametrize("name", ["two_pandas", "baxter"])
@pytest.mark.few(1)
def test_what_is_drawn_of_a_robot_lies_around_its_collision_bodies(name):
    own = robot(name)
    bodies, data, state = bodies_of(own), own.model.createData(), own.collision.createData()
    q = own.home + 0.1
    (poses,) = poses_of(own, q[None])
    pin.updateGeometryPlacements(own.model, data, own.collision, state, q)
    assert sum(len(body.surface.faces) for body in bodies) <= 60_000
    assert {body.joint for body in bodies} >= set(range(own.model.njoints - 1))
    for item, place in zip(own.collision.geometryObjects, state.oMg, strict=True):
        corners = placed(bodies, poses, item.parentJoint - 1)
        centre = place.act(np.array(item.geometry.aabb_center))
        near = max(item.geometry.aabb_radius, 0.1)  # dummies of a model are tiny
        assert np.linalg.norm(corners - centre, axis=1).min() < near, item.name


def test_tools_are_drawn_where_the_robot_has_them():
    own = robot("two_pandas")
    (poses,) = poses_of(own, own.home[None])
    for arm in own.arms:
        hand = placed(bodies_of(own), poses, int(arm.columns[-1]))
        grasp = own.tool_pose(own.home, arm)[:3, 3]
        assert np.linalg.norm(hand - grasp, axis=1).min() < 0.03


@pytest.mark.parametrize("cell", [0.01, 0.03])
def test_a_simplified_ball_stays_a_ball_seen_from_outside(cell):
    surface = ball(0.1)
    simple = simplified(surface, cell)
    assert len(simple.faces) < len(surface.faces) or cell < 0.02
    away = np.abs(np.linalg.norm(simple.vertices, axis=1) - 0.1)
    assert away.max() <= np.sqrt(3) * cell
    corners = simple.vertices[simple.faces]
    volume = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert len(np.unique(simple.faces)) == len(simple.vertices)
    assert volume == pytest.approx(4 / 3 * np.pi * 1e-3, rel=0.25), "no face is turned inside out or lost"
