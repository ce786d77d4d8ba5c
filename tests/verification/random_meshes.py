"""Random motions and, around them, spoilt meshes in which contact is a matter of a fraction of a millimetre."""

import warnings
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from comove.errors import ComoveWarning, SceneError
from comove.model import Scene
from comove.model.coordinates import coordinates_for
from tests import brute_force
from tests.meshes import box, hull, l_profile, ring, spoilt, star, write_obj
from tests.verification.random_motions import offset_of, random_motion, scene_data

DONE = ("flip", "double", "drop", "sliver", "fin", "unwelded", "line", "crossing")
FORWARD = np.array([0.03, -0.02, 0.04])  # m in all, how far a mesh moves that moves


def random_mesh(rng):
    """A small mesh, sound or spoilt in up to three ways: vertices and faces."""
    kind = rng.integers(6)
    if kind == 0:
        mesh = star(rng)
    elif kind == 1:
        mesh = box(rng.uniform(0.001, 0.2, 3))
    elif kind == 2:
        mesh = ring(n=int(rng.integers(5, 10)))
    elif kind == 3:
        mesh = l_profile()
    elif kind == 4:
        mesh = hull(rng.standard_normal((rng.integers(5, 12), 3)) * rng.uniform(0.02, 0.1, 3))
    else:  # a sheet, bent and shown from both sides
        vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, rng.uniform(-0.5, 0.5)]])
        faces = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
        mesh = vertices * rng.uniform(0.05, 0.2), np.concatenate([faces, faces[:, ::-1]])
    return spoilt(*mesh, rng.choice(DONE, int(rng.integers(4))), rng)


def near_contact(rng, folder, mesh=None):
    """A random motion beside a mesh, the mesh's triangles [m], and how far they move at normalised times.

    The mesh, vertices and faces, is a random one unless given.
    """
    while True:
        motion = random_motion(rng, n_dims=3)
        vertices, faces = mesh or random_mesh(rng)
        turn = Rotation.random(random_state=int(rng.integers(2**31)))
        own = turn.apply(vertices)[faces]
        moves = rng.random() < 0.3
        way = (lambda s: s[:, None] * FORWARD) if moves else (lambda s: np.zeros((len(s), 3)))
        direction = rng.standard_normal(3)
        direction /= np.linalg.norm(direction)
        hands = brute_force.hands_at(motion, np.array([rng.uniform(0.2, 0.8)]))[0]
        center, wanted = hands[rng.integers(len(hands))] - 0.6 * direction, offset_of(rng)
        for k in range(8):
            distance, _ = brute_force.mesh_clearance(
                motion, own + center, way, n_times=61, refinements=k // 4
            )
            center = center + (distance - wanted) * direction
            if abs(distance - wanted) < 1e-6:
                break
        write_obj(folder / "mesh.obj", vertices, faces)
        obstacle = {
            "shape": "mesh",
            "file": "mesh.obj",
            "center": center.tolist(),
            "quaternion_wxyz": turn.as_quat()[[3, 0, 1, 2]].tolist(),
        }
        if moves:
            obstacle["motion"] = {"velocity": (FORWARD / motion.scene.duration).tolist()}
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ComoveWarning)
                scene = Scene.from_dict(scene_data(motion.scene) | {"obstacles": [obstacle]}, folder=folder)
        except SceneError:  # an end is in contact, or within
            continue
        motion = replace(motion, scene=scene, coordinates=coordinates_for(scene, motion.coordinates.kind))
        return motion, own + center, way
