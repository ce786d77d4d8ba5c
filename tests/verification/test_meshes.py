"""What is certified of meshes is true of the meshes themselves, by coal, which sees their triangles."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comove.errors import SceneError
from comove.model import CoordinatedMotion, Scene
from comove.verification import verify
from comove.verification.certificate import certify

from ..meshes import as_coal, box, l_profile, ring, star, write_obj

COAL_ERROR = 1e-4
FAR = {"lower": [-3, -3, -3], "upper": [4, 4, 4]}


def scene_of(folder, load, obstacles, start, goal, turn=0.0):
    """A load held at two points of its frame, turned about the vertical on its way from start to goal."""
    grasps = {"a": [0.0, 0.0, 0.0], "b": [0.2, 0.0, 0.0]}
    held = np.array(list(grasps.values()))
    last = Rotation.from_euler("z", turn).apply(held)
    return Scene.from_dict(
        {
            "name": "meshes",
            "duration": 4.0,
            "workspace": FAR,
            "obstacles": obstacles,
            "load": load | {"grasps": grasps},
            "constraints": [{"type": "upright"}],
            "manipulators": [
                {"name": n, "start": list(p + start), "goal": list(q + goal)}
                for n, p, q in zip(grasps, held, last, strict=True)
            ],
        },
        folder=folder,
    )


def true_least(scene, motion, load, obstacles, coal, n=101):
    """Least distance of the load's triangles and hands from the obstacles' triangles, at many instants."""
    own, least = as_coal(*load, coal), np.inf
    others = [as_coal(*mesh, coal) for mesh in obstacles]
    times = np.linspace(0.0, 1.0, n)
    q = motion.at(times)[0]
    nodes = motion.coordinates.nodes(np.ascontiguousarray(q.T[None]))[0]
    offsets = scene.offsets(times * scene.duration)
    for step in range(n):
        a, b = nodes[step, 0], nodes[step, 1]
        x = (b - a) / np.linalg.norm(b - a)
        turn = np.stack([x, np.cross([0.0, 0.0, 1.0], x), [0.0, 0.0, 1.0]], axis=1)
        for k, other in enumerate(others):
            part = scene.file.obstacles[k]
            w, *xyz = part.quaternion_wxyz
            there = coal.Transform3s(
                Rotation.from_quat([*xyz, w]).as_matrix(), np.array(part.center) + offsets[step, k]
            )
            least = min(
                least,
                coal.distance(
                    own,
                    coal.Transform3s(turn, a),
                    other,
                    there,
                    coal.DistanceRequest(),
                    coal.DistanceResult(),
                ),
            )
    return least


def test_nothing_is_certified_above_the_truth(tmp_path):
    assert [certified_and_true(tmp_path, seed) for seed in (1, 11)] == [True, True]


@pytest.mark.slow
def test_nothing_is_certified_above_the_truth_wherever_meshes_are(tmp_path):
    assert [certified_and_true(tmp_path, seed) for seed in range(12)].count(True) > 3


def certified_and_true(folder, seed):
    """Hold a certificate among two meshes against coal; True where one was near, None where an end is in one."""
    coal = pytest.importorskip("coal")
    write_obj(folder / "load.obj", *l_profile())
    rng = np.random.default_rng([seed, 5])
    made = [star(rng), ring(height=rng.uniform(0.03, 0.2))]
    obstacles = []
    for k, mesh in enumerate(made):
        name = f"{seed}-{k}.obj"
        write_obj(folder / name, *mesh)
        turn = Rotation.random(random_state=int(rng.integers(2**31))).as_quat()[[3, 0, 1, 2]]
        center = rng.uniform([0.2, -0.5, -0.25], [0.9, 0.5, 0.25])
        motion = {"velocity": rng.uniform(-0.1, 0.1, 3).tolist()} if seed % 2 else None
        obstacles.append(
            {"shape": "mesh", "file": name, "center": center.tolist(), "quaternion_wxyz": turn.tolist()}
            | ({"motion": motion} if motion else {})
        )
    ends, turn = (np.array([-0.6, 0, 0]), np.array([1.5, 0.2, 0.1])), rng.uniform(-2, 2)
    try:
        scene = scene_of(folder, {"shape": "mesh", "file": "load.obj"}, obstacles, *ends, turn=turn)
    except SceneError as error:  # an end in an obstacle
        assert "at the" in str(error)
        return None
    motion = CoordinatedMotion.straight(scene)
    found, truth = certify(motion), true_least(scene, motion, l_profile(), made, coal)
    assert found.lower <= max(truth, 0.0) + COAL_ERROR, (seed, found, truth)
    if truth <= 0.0:
        assert verify(motion).verified is None
        return False
    # What stands for a mesh reaches beyond it, and the hands, which are points, see it up to an eighth nearer.
    spare = sum(scene.excess.values()) + 1e-3 + truth / 8
    assert found.lower > truth - spare, (seed, found, truth)
    return found.nearest >= 0


@pytest.mark.parametrize("seed", range(6))
def test_a_mesh_of_a_box_is_judged_as_the_box(tmp_path, seed):
    """Both as load and as obstacle; what is certified is within the slack of the certificate."""
    rng = np.random.default_rng(seed)
    size, post = rng.uniform(0.05, 0.3, 3), rng.uniform(0.05, 0.3, 3)
    write_obj(tmp_path / "load.obj", *box(size))
    write_obj(tmp_path / "post.obj", *box(post))
    center = [0.5, rng.uniform(0.35, 0.5), 0.1]
    turn = Rotation.from_euler("z", rng.uniform(0, 3)).as_quat()[[3, 0, 1, 2]].tolist()
    loads = {"shape": "box", "size": size.tolist()}, {"shape": "mesh", "file": "load.obj"}
    posts = (
        {"shape": "box", "size": post.tolist(), "center": center, "quaternion_wxyz": turn},
        {"shape": "mesh", "file": "post.obj", "center": center, "quaternion_wxyz": turn},
    )
    found = []
    for load in loads:
        for obstacle in posts:
            scene = scene_of(
                tmp_path, load, [obstacle], np.array([-0.6, 0, 0]), np.array([1.5, 0.1, 0]), turn=1.0
            )
            found.append(certify(CoordinatedMotion.straight(scene)))
    lower = [clearance.lower for clearance in found]
    assert lower[0] > 0.0
    # To the hands, which are points, a mesh is up to an eighth nearer than it is (`comove.geometry.polytopes`).
    assert lower[0] == pytest.approx(lower[2], abs=2e-4)
    assert lower[1] == pytest.approx(lower[3], abs=2e-4)
    assert 7 / 8 * lower[0] - 2e-4 < lower[1] < lower[0] + 2e-4
    assert {clearance.nearest for clearance in found} == {0}
