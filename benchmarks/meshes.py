"""Accuracy and speed of convex decompositions and of mesh readers.

    python benchmarks/meshes.py
    python benchmarks/meshes.py readers

Every mesh is rotated at random three times; the worst is shown. Files are those of example-robot-data and of comove,
read by comove and by trimesh. Times are of the processor.
"""

from __future__ import annotations

import argparse
import io
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from timing import number, peer, print_table

import comove
from comove.geometry.convex_decomposition import decompose
from comove.geometry.topology import solids_and_sheets
from comove.geometry.triangles import FORMATS, read_bytes, triangles_of

MESHES = Path(__file__).parents[1] / "examples" / "meshes"
N_TURNS = 3
QUADRILATERAL = b"".join(
    [
        b"ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\n",
        b"property float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n",
        np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype="<f4").tobytes(),
        *(bytes([len(face)]) + np.array(face, dtype="<i4").tobytes() for face in ([0, 1, 2, 3], [0, 2, 1])),
    ]
)
SPECIAL = {  # name, what is in it, its format and number of triangles, and its height [m]
    "two walls, corners counted back from each": (
        b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 0 0 5\nv 1 0 5\nv 0 1 5\nf -3 -2 -1\n",
        *(".obj", 2, 5.0),
    ),
    "a quadrilateral and a triangle": (QUADRILATERAL, ".ply", 3, 0.0),
    "cut off after one of two faces": (b"OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", ".off", 2, 0.0),
}


def main() -> None:
    """Print the requested table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", nargs="?", choices=("polytopes", "readers"), default="polytopes")
    {"polytopes": decompose_all, "readers": read_all}[parser.parse_args().what]()


def read_all() -> None:
    """Read all mesh files of robots; print two tables. Some special files are added."""
    peer("trimesh")
    robots = Path(peer("pinocchio").__file__).parents[4] / "share" / "example-robot-data" / "robots"
    folders = (robots, Path(comove.__file__).parent, MESHES.parent)
    files = sorted(
        {p.resolve() for folder in folders for p in folder.rglob("*") if p.suffix.lower() in FORMATS}
    )
    found = defaultdict(list)
    for path in files:
        data, suffix = read_bytes(path), path.suffix.lower()
        begun = time.process_time()
        own, between = _boxed(*triangles_of(data, suffix)), time.process_time()
        other, ended = _by_trimesh(data, suffix), time.process_time()
        same = (
            other is not None and own[0] == other[0] and np.allclose(own[1], other[1], rtol=1e-6, atol=1e-9)
        )
        found[suffix].append((own[0], same, between - begun, ended - between))
    rows = [[suffix, len(own), *np.sum(own, axis=0)] for suffix, own in found.items()]
    print_table(
        ["format", "files", "triangles", "same by trimesh", "comove", "trimesh"],
        [[s, n, int(faces), int(same), f"{a:.1f} s", f"{b:.1f} s"] for s, n, faces, same, a, b in rows],
    )
    print()
    rows = []
    for name, (data, suffix, n_triangles, height) in SPECIAL.items():
        other = _by_trimesh(data, suffix)
        told = "refused" if other is None else f"{other[0]} triangles, {np.ptp(other[1], axis=0)[2]:g} m high"
        rows.append([suffix, name, f"{n_triangles} triangles, {height:g} m high", told])
    print_table(["format", "file", "what is in it", "by trimesh"], rows)


def _boxed(vertices: np.ndarray, faces: np.ndarray) -> tuple[int, np.ndarray]:
    """Return the number of non-degenerate triangles, and the bounding box. The box is an array of shape (2, 3)."""
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return int((area > 0.0).sum()), np.stack([corners.min(axis=(0, 1)), corners.max(axis=(0, 1))])


def _by_trimesh(data: bytes, suffix: str) -> tuple[int, np.ndarray] | None:
    """Return `_boxed` by trimesh; None where it refuses."""
    trimesh = peer("trimesh")
    try:
        scene = trimesh.load_scene(io.BytesIO(data), file_type=suffix[1:], process=False, skip_materials=True)
        mesh = scene.convert_units("meters").to_mesh() if scene.units else scene.to_mesh()
        return _boxed(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    except Exception:  # a reader of foreign formats may raise anything
        return None


def decompose_all() -> None:
    """Decompose every mesh and print the table."""
    trimesh = peer("trimesh")
    meshes = {
        "box": trimesh.creation.box((0.3, 0.2, 0.1)),
        "L-shaped profile": trimesh.load(MESHES / "profile.obj"),
        "gate with a round top": trimesh.load(MESHES / "gate.obj"),
        "torus of 2048 triangles": trimesh.creation.torus(0.1, 0.03, major_sections=32, minor_sections=32),
        "tube, wall of an eighth of its diameter": trimesh.creation.annulus(0.075, 0.1, 0.2),
    }
    gate = meshes["gate with a round top"]
    decompose(solids_and_sheets(np.array(gate.vertices), np.array(gate.faces)))
    rows = []
    for name, mesh in meshes.items():
        for share in (0.03, 0.011) if name.startswith("gate") else (0.03,):
            side, found = float(np.ptp(mesh.vertices, axis=0).max()), []
            for turn in range(N_TURNS):
                vertices = mesh.vertices @ Rotation.random(random_state=turn).as_matrix().T
                begun = time.process_time()
                parts = solids_and_sheets(np.array(vertices), np.array(mesh.faces))
                held = decompose(parts, share * side)
                found.append((len(held.polytopes), held.excess / side, time.process_time() - begun))
            n, excess, seconds = np.max(found, axis=0)
            rows.append([name, f"{100 * share:g} %", int(n), f"{100 * excess:.1f} %", f"{number(seconds)} s"])
    print_table(["mesh", "resolution", "polytopes", "excess", "time"], rows)


if __name__ == "__main__":
    main()
