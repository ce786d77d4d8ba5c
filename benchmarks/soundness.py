"""False certificates: random motions near contact against brute force.

    python benchmarks/soundness.py [--shapes 100000] [--turning 10000] [--boxes 300] [--meshes 10000] [--joints 10000]
        [--deviating 1000] [--first 0] [--workers 2] [--files FOLDER]

Motions come first; obstacles are then pushed to within fractions of a millimetre of what they sweep, or into it.
Brute force (`tests/brute_force.py`) reads the scene's file, takes from a motion only its configurations, and shares
no geometry with comove: it finds only contacts of the motion. A certificate is false if it promises more than brute
force meets. In `turning`, obstacles turn and move, slowly or up to three times a second. Boxes are payloads, checked
by points of the box (`tests/verification/random_boxes.py`). Meshes have the faults of exports: triangles flipped,
duplicate, missing, flat, loose, crossing others. Joints are those of ten robots beside obstacles that move and turn,
a payload, or themselves, checked by their raw URDFs (`tests/robots/verification/random_joints.py`). In `deviating`
joints may be off their commands, and are moved to the corner of that box which brings bodies nearest.
With `--files`, every mesh of up to 2000 triangles in a folder, made 0.2 m large, is an obstacle once.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import warnings
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from timing import print_table

sys.path.insert(0, str(Path(__file__).parents[1]))

CHUNK = 50
# Streams of random numbers; the tests draw from others.
STREAMS = {
    **{"shapes": 101, "turning": 113, "boxes": 109, "meshes": 103, "joints": 127},
    **{"deviating": 131, "files": 107},
}
MOST, SIZE = 2000, 0.2  # triangles of a file, and what its mesh is made large [m]
FORMATS = (".stl", ".obj", ".off", ".ply", ".dae")
WORDS = ("certified", "contact", "undecided", "false certificate")


def main() -> None:
    """Sample, verify and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shapes", type=int, default=100_000)
    parser.add_argument("--turning", type=int, default=10_000)
    parser.add_argument("--boxes", type=int, default=300)
    parser.add_argument("--meshes", type=int, default=10_000)
    parser.add_argument("--joints", type=int, default=10_000)
    parser.add_argument("--deviating", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="number of the first draw of each kind")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--files", type=Path)
    asked = parser.parse_args()
    rows = []
    with ProcessPoolExecutor(asked.workers) as pool:
        files = (
            sorted(f for f in asked.files.rglob("*") if f.suffix.lower() in FORMATS) if asked.files else []
        )
        counts = {kind: getattr(asked, kind) for kind in STREAMS if kind != "files"} | {"files": len(files)}
        for kind, count in counts.items():
            chunk = CHUNK if kind != "files" else 1
            first = asked.first if kind != "files" else 0
            starts = range(first, first + count, chunk)
            total: Counter[str] = Counter()
            for found, false in pool.map(
                judged,
                [kind] * len(starts),
                starts,
                [min(chunk, first + count - start) for start in starts],
                files if kind == "files" else [None] * len(starts),
            ):
                total += found
                for seed, lower, truth in false:
                    print(f"false: {kind} {seed}: {lower} m certified, {truth} m met", flush=True)
            rows.append([kind, sum(total.values()), *(total[word] for word in WORDS)])
    print_table(["obstacles", "tried", *WORDS], rows)


def judged(
    kind: str, first: int, count: int, file: Path | None = None
) -> tuple[Counter[str], list[tuple[int, float, float]]]:
    """Return the outcomes of samples, and their false certificates. Each has seed, bound and truth [m]."""
    from comove.geometry.triangles import triangles_of
    from comove.verification.certificate import certify
    from tests.robots.verification import random_joints
    from tests.verification import test_certificate, test_surfaces
    from tests.verification.random_boxes import box_near_contact, least_clearance
    from tests.verification.random_meshes import near_contact as near_mesh
    from tests.verification.random_motions import near_contact

    warnings.simplefilter("ignore")  # of grasps beside their boxes, which matter to no certificate
    found: Counter[str] = Counter()
    false = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(first, first + count):
            rng = np.random.default_rng([seed, STREAMS[kind]])
            if kind == "files":
                vertices, faces = triangles_of(file.read_bytes(), file.suffix.lower())
                if len(faces) > MOST:
                    break
                vertices = (vertices - vertices.mean(axis=0)) * SIZE / np.ptp(vertices, axis=0).max()
                clearance, truth, word = test_surfaces.outcome(
                    *near_mesh(rng, Path(folder), (vertices, faces))
                )
            elif kind in ("shapes", "turning"):
                moving = 0.8 if kind == "turning" else 0.0
                clearance, truth, word = test_certificate.judged(near_contact(rng, moving))
                if word != "contact" and clearance.lower > truth + test_certificate.ROUNDING:
                    word = "false certificate"
            elif kind == "boxes":
                motion = box_near_contact(rng)
                clearance, truth, required = certify(motion), least_clearance(motion), motion.scene.clearance
                word = "certified" if clearance.lower >= required else "undecided"
                word = "contact" if word == "undecided" and truth < required else word
                if clearance.lower > max(truth, 0.0) + test_certificate.ROUNDING:
                    word = "false certificate"
            elif kind in ("joints", "deviating"):
                name = random_joints.robot_of(seed)
                draw = (random_joints.near_contact(rng, name),)
                if kind == "deviating":
                    draw = random_joints.deviating(rng, name)
                clearance, truth, word = random_joints.judged(name, *draw)
            else:
                clearance, truth, word = test_surfaces.outcome(*near_mesh(rng, Path(folder)))
            found[word] += 1
            if word == "false certificate":
                false.append((seed, clearance.lower, truth))
    return found, false


if __name__ == "__main__":
    main()
