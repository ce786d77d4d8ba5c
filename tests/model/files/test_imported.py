"""Obstacles of other files stand where other readers of these files put them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comove.errors import ComoveWarning, SceneError
from comove.model.scene import Scene

MOVEIT = """\
(noname)+
* table top
0.5 0 0.4
0 0 0.70710678118 0.70710678118
2
box
1.0 0.5 0.04
0.1 0 0
0 0 0 1
0 0 0 0
sphere
0.05
0.2 0.1 0.3
0.5 0.5 0.5 0.5
0 0 0 0
1
place
0 0 0.02
0 0 0 1
* tetrahedron
0 0 0.2
0 0 0 1
1
mesh
4 4
0 0 0
0.1 0 0
0 0.1 0
0 0 0.1
0 2 1
0 1 3
1 2 3
0 3 2
0.8 0.3 0.5
0 0 1 0
0 0 0 0
0
.
"""
OLD = "(noname)+\n* Box_0\n1\nbox\n0.1 0.2 0.3\n0.5 0 0.2\n0 0 0 1\n0 0 0 0\n.\n"
WORLD = """\
<robot name="cell">
  <link name="world"/>
  <link name="rack">
    <collision name="post"><origin xyz="0 0.1 0.5" rpy="0.1 0.2 0.3"/>
      <geometry><box size="0.1 0.2 1"/></geometry></collision>
    <collision><origin xyz="0.3 0 0"/><geometry><cylinder radius="0.1" length="0.4"/></geometry></collision>
  </link>
  <link name="lid"><collision><geometry><mesh filename="gate.stl" scale="2 2 2"/></geometry></collision></link>
  <joint name="a" type="fixed"><parent link="world"/><child link="rack"/><origin xyz="1 0 0" rpy="0 0 1"/></joint>
  <joint name="b" type="revolute"><parent link="rack"/><child link="lid"/>
    <origin xyz="0 0.2 1" rpy="0.5 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
</robot>
"""
MODEL = """\
<mujoco><compiler angle="radian"/><worldbody>
  <geom name="floor" type="plane" size="1 1 0.1"/>
  <body name="shelf" pos="0 1 0.5" euler="0.1 0.2 0.3">
    <geom type="box" size="0.1 0.2 0.3" pos="0.1 0 0"/>
    <geom name="rail" type="capsule" size="0.02 0.2" euler="0 1 0"/>
  </body>
</worldbody></mujoco>
"""
AT, TURN = [0.1, 0.2, 0.3], [0.5, 0.5, 0.5, 0.5]


def scene_of(folder, kind, file, text):
    """A scene among the obstacles of a file."""
    (folder / file).write_text(text)
    return Scene.from_dict(
        {
            "version": 2,
            "name": "cell",
            "workspace": {"lower": [-9] * 3, "upper": [9] * 3},
            "obstacles": [
                {"shape": kind, "file": file, "center": AT, "quaternion_wxyz": TURN},
                {"shape": "sphere", "center": [5, 5, 5], "radius": 0.1},
            ],
            "end_effectors": {"hand": {"start": [-5, 0, 0], "goal": [-5, 1, 0]}},
        },
        folder=folder,
    )


def require_at(obstacle, position, rotation):
    """An obstacle is at a pose of the file's frame, which the scene places in turn."""
    outer = Rotation.from_quat(TURN, scalar_first=True)
    assert obstacle.center == pytest.approx(np.array(AT) + outer.apply(position), abs=1e-9)
    if obstacle.shape != "sphere":
        turned = Rotation.from_quat(obstacle.quaternion_wxyz, scalar_first=True).as_matrix()
        assert turned == pytest.approx((outer * rotation).as_matrix(), abs=1e-9)


def test_objects_of_a_planning_scene(tmp_path):
    """Shapes are relative to their objects; names are unique; a mesh is read from the same file."""
    scene = scene_of(tmp_path, "moveit", "cell.scene", MOVEIT)
    top, ball, solid, own = scene.file.obstacles
    assert [one.name for one in (top, ball, solid, own)] == ["table_top", "table_top_2", "tetrahedron", None]
    quarter = Rotation.from_euler("z", 90, degrees=True)
    require_at(top, [0.5, 0.1, 0.4], quarter)
    require_at(ball, [0.4, 0.2, 0.7], None)
    require_at(solid, [0.8, 0.3, 0.7], Rotation.from_euler("z", 180, degrees=True))
    assert (top.size, ball.radius, own.radius) == ((1.0, 0.5, 0.04), 0.05, 0.1)
    corners = np.unique(scene.surfaces.of(0).reshape(-1, 3).round(9), axis=0)
    outer = Rotation.from_quat(TURN, scalar_first=True)
    wanted = [[0.8, 0.3, 0.7], [0.7, 0.3, 0.7], [0.8, 0.2, 0.7], [0.8, 0.3, 0.8]]
    wanted = np.unique((np.array(AT) + outer.apply(wanted)).round(9), axis=0)
    assert corners == pytest.approx(wanted, abs=1e-8)
    changed = scene_of(tmp_path, "moveit", "cell.scene", MOVEIT.replace("0.1 0 0\n0 0.1", "0.2 0 0\n0 0.1"))
    assert changed.sha256 != scene.sha256, "a mesh counts for the checksum"


def test_the_format_before_objects_had_poses(tmp_path):
    box, _ = scene_of(tmp_path, "moveit", "old.scene", OLD).file.obstacles
    require_at(box, [0.5, 0, 0.2], Rotation.identity())
    assert box.size == (0.1, 0.2, 0.3)


def test_a_plane_is_solid_below(tmp_path):
    """Points below it, on the side from which its normal leads away, are in the box that stands for it."""
    text = OLD.replace("box\n0.1 0.2 0.3\n0.5 0 0.2", "plane\n0 0.6 0.8 -0.5\n0 0 0")
    scene = scene_of(tmp_path, "moveit", "plane.scene", text)
    outer, normal = Rotation.from_quat(TURN, scalar_first=True), np.array([0, 0.6, 0.8])
    for height in (-0.02, 0.03):
        point = np.array(AT) + outer.apply((0.5 + height) * normal)
        nodes = np.vstack([point, np.zeros((scene.body.n_nodes - 1, 3))])
        assert scene.distance_from(0, nodes) == pytest.approx(height, abs=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            "\nbox\n1.0 0.5 0.04",
            "\ncone\n0.5 0.04",
            r"line 6: no obstacle has the shape 'cone'; write it as a box",
        ),
        ("0 0 0 1\n0 0 0 0\nsphere", "0 0 0 2\n0 0 0 0\nsphere", "line 9: the quaternion has the norm 2"),
        ("0 3 2\n", "0 3 4\n", "the mesh of 4 vertices has triangles of others"),
        ("0 0 0 0\n0\n.", "0 0 0 0\n0\n", "the file ends before its last point"),
        ("1.0 0.5 0.04", "1.0 half 0.04", "line 7: '1.0 half 0.04' are not 3 numbers"),
        ("1.0 0.5 0.04", "1.0 0.5 nan", "line 7: '1.0 0.5 nan' are not finite"),
        ("* tetra", "+ tetra", r"line 20: '\+' begins neither an object"),
    ],
)
def test_a_damaged_planning_scene_is_refused(old, new, told, tmp_path):
    assert old in MOVEIT
    with pytest.raises(SceneError, match=rf"obstacles\[0\]\.file: 'cell.scene': .*{told}"):
        scene_of(tmp_path, "moveit", "cell.scene", MOVEIT.replace(old, new))


def test_bodies_of_a_urdf(tmp_path):
    """Pinocchio puts its collision bodies in the same places."""
    import pinocchio as pin

    (tmp_path / "gate.stl").write_text(
        "solid a\n"
        + "".join(
            "facet normal 0 0 0\nouter loop\n"
            + "".join(f"vertex {v}\n" for v in three)
            + "endloop\nendfacet\n"
            for three in (
                ("0 0 0", "0 1 0", "1 0 0"),
                ("0 0 0", "1 0 0", "0 0 1"),
                ("1 0 0", "0 1 0", "0 0 1"),
                ("0 0 0", "0 0 1", "0 1 0"),
            )
        )
        + "endsolid a\n"
    )
    scene = scene_of(tmp_path, "urdf", "cell.urdf", WORLD)
    model = pin.buildModelFromUrdf(str(tmp_path / "cell.urdf"))
    geometry = pin.buildGeomFromUrdf(model, str(tmp_path / "cell.urdf"), pin.COLLISION, str(tmp_path))
    data, placed = model.createData(), geometry.createData()
    pin.updateGeometryPlacements(model, data, geometry, placed, pin.neutral(model))
    assert len(scene.file.obstacles) == 1 + len(geometry.geometryObjects)
    for obstacle, pose in zip(scene.file.obstacles, placed.oMg, strict=False):
        require_at(obstacle, pose.translation, Rotation.from_matrix(pose.rotation))
    post, can, lid, _ = scene.file.obstacles
    assert (post.name, post.size) == ("post", (0.1, 0.2, 1.0))
    assert (can.name, can.radius, can.height) == ("rack", 0.1, 0.4)
    assert (lid.file, lid.scale) == ("gate.stl", 2.0)


def test_a_urdf_that_no_obstacles_can_be(tmp_path):
    with pytest.raises(SceneError, match="the mesh of the link 'lid' has the scale 2 1 2; scale the mesh"):
        scene_of(tmp_path, "urdf", "cell.urdf", WORLD.replace("2 2 2", "2 1 2"))
    with pytest.raises(SceneError, match=r"no file 'gate\.stl'"):
        scene_of(tmp_path, "urdf", "cell.urdf", WORLD)
    with pytest.raises(SceneError, match=r"'cell.urdf': .*<mujoco>|'cell.urdf': .*MJCF"):
        scene_of(tmp_path, "urdf", "cell.urdf", MODEL)


def test_bodies_of_a_model_of_mujoco(tmp_path):
    """MuJoCo puts its geoms in the same places."""
    mujoco = pytest.importorskip("mujoco")
    scene = scene_of(tmp_path, "mjcf", "cell.xml", MODEL)
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    floor, box, rail, _ = scene.file.obstacles
    require_at(floor, [0, 0, -0.05], Rotation.identity())
    for k, obstacle in ((1, box), (2, rail)):
        require_at(obstacle, data.geom_xpos[k], Rotation.from_matrix(data.geom_xmat[k].reshape(3, 3)))
    assert (box.name, rail.name, rail.length) == ("shelf", "rail", 0.4)


def test_a_robot_in_a_model_is_no_obstacle(tmp_path):
    pytest.importorskip("mujoco")
    arm = '<body name="arm"><joint type="hinge"/><geom type="box" size="1 1 1"/></body></worldbody>'
    with pytest.warns(ComoveWarning, match="'arm' has joints: it is no obstacle"):
        scene = scene_of(tmp_path, "mjcf", "cell.xml", MODEL.replace("</worldbody>", arm))
    assert len(scene.file.obstacles) == 4


@pytest.mark.parametrize("reference", ["", 'refpos="0.1 -0.2 0.3" refquat="0.6 -1 1.4 0.4"'])
def test_meshes_of_a_model_of_mujoco(reference, tmp_path):
    """MuJoCo centres and turns them; their triangles are where it has them, and come from their own files."""
    mujoco = pytest.importorskip("mujoco")
    wedge = "v 0 0 0\nv .3 0 0\nv 0 .2 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    for name in ("wedge.obj", "other.obj"):
        (tmp_path / name).write_text(wedge)
    asset = (
        '<mujoco><asset><mesh file="other.obj"/><mesh name="w" file="wedge.obj" scale="2 2 2" REF/></asset>'
    )
    geom = '<geom name="w" type="mesh" mesh="w" pos="1 0.2 0.3" euler="0.1 0.2 0.3"/></worldbody>'
    text = MODEL.replace("<mujoco>", asset.replace("REF", reference)).replace("</worldbody>", geom)
    scene = scene_of(tmp_path, "mjcf", "cell.xml", text)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "cell.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    k = model.geom("w").id
    first, n = int(model.mesh_vertadr[model.geom_dataid[k]]), int(model.mesh_vertnum[model.geom_dataid[k]])
    there = data.geom_xpos[k] + model.mesh_vert[first : first + n] @ data.geom_xmat[k].reshape(3, 3).T
    there = np.array(AT) + Rotation.from_quat(TURN, scalar_first=True).apply(there)
    found = scene.surfaces.of(0).reshape(-1, 3)
    assert max(np.linalg.norm(found - v, axis=1).min() for v in there) < 1e-6
    assert max(np.linalg.norm(there - v, axis=1).min() for v in found) < 1e-6
    with pytest.raises(SceneError, match=r"'w' is scaled by .*scale its file"):
        scene_of(tmp_path, "mjcf", "cell.xml", text.replace("2 2 2", "2 1 2"))
