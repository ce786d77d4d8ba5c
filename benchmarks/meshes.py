"""How well and how fast convex polytopes hold a mesh: how many, how far beyond it, and how long that takes.

    python benchmarks/meshes.py

Every mesh is turned at random three times; the worst is told. Times are of the processor.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from timing import number, peer, print_table

from comove.geometry.convex_decomposition import decompose
from comove.geometry.topology import solids_and_sheets

MESHES = Path(__file__).parents[1] / "examples" / "meshes"
N_TURNS = 3


def main() -> None:
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
