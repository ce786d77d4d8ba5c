"""How often the certificate is wrong: random motions near contact, judged by it and by brute force.

    python benchmarks/soundness.py [--shapes 100000] [--meshes 10000] [--workers 2]

Motions come first; obstacles are then pushed to within fractions of a millimetre of what they sweep, or into it.
Brute force (`tests/brute_force.py`) reads the scene's file, takes from a motion only its configurations, and shares
no geometry with comove: what it meets is met by the motion. A certificate is false if it promises more than brute
force meets. Meshes are spoilt as exports spoil them: triangles turned, twice, missing, flat, loose, crossing others.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from timing import print_table

sys.path.insert(0, str(Path(__file__).parents[1]))

CHUNK = 50
STREAMS = {"shapes": 101, "meshes": 103}  # of random numbers; the tests draw from others
WORDS = ("certified", "contact", "undecided", "false certificate")


def main() -> None:
    """Draw, judge and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shapes", type=int, default=100_000)
    parser.add_argument("--meshes", type=int, default=10_000)
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    rows = []
    with ProcessPoolExecutor(asked.workers) as pool:
        for kind, count in (("shapes", asked.shapes), ("meshes", asked.meshes)):
            starts = range(0, count, CHUNK)
            total: Counter[str] = Counter()
            for found, false in pool.map(
                judged, [kind] * len(starts), starts, [min(CHUNK, count)] * len(starts)
            ):
                total += found
                for seed, lower, truth in false:
                    print(f"false: {kind} {seed}: {lower} m certified, {truth} m met", flush=True)
            rows.append([kind, sum(total.values()), *(total[word] for word in WORDS)])
    print_table(["obstacles", "tried", *WORDS], rows)


def judged(kind: str, first: int, count: int) -> tuple[Counter[str], list[tuple[int, float, float]]]:
    """Outcomes of some draws, and the false certificates among them: seed, bound and truth [m]."""
    from tests.verification import test_certificate, test_surfaces
    from tests.verification.random_meshes import near_contact as near_mesh
    from tests.verification.random_motions import near_contact

    found: Counter[str] = Counter()
    false = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(first, first + count):
            rng = np.random.default_rng([seed, STREAMS[kind]])
            if kind == "shapes":
                clearance, truth, word = test_certificate.judged(near_contact(rng))
                if word != "contact" and clearance.lower > truth + test_certificate.ROUNDING:
                    word = "false certificate"
            else:
                clearance, truth, word = test_surfaces.outcome(*near_mesh(rng, Path(folder)))
            found[word] += 1
            if word == "false certificate":
                false.append((seed, clearance.lower, truth))
    return found, false


if __name__ == "__main__":
    main()
