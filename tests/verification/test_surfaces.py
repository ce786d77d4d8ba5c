"""What is certified of meshes holds of their triangles, however these are written, by brute force."""

from collections import Counter

import numpy as np
import pytest

from comove.verification.certificate import certify
from tests import brute_force
from tests.verification.random_meshes import near_contact

ROUNDING = 1e-9  # m


def outcome(motion, triangles, way):
    """What the certificate says, the truth [m], and the outcome in a word."""
    clearance, (truth, _) = certify(motion), brute_force.mesh_clearance(motion, triangles, way)
    if clearance.lower >= 0.0:
        return clearance, truth, "certified" if clearance.lower <= truth + ROUNDING else "false certificate"
    return clearance, truth, "contact" if truth <= 0.0 else "undecided"


def tried(seeds, folder):
    """Outcomes by their number, and the false ones."""
    found, false = Counter(), []
    for seed in seeds:
        motion, triangles, way = near_contact(np.random.default_rng([seed, 17]), folder)
        clearance, truth, word = outcome(motion, triangles, way)
        found[word] += 1
        if word == "false certificate":
            false.append((seed, clearance, truth))
        calm = certify(motion).lower > 0 or truth < 2e-3
        assert calm, (seed, clearance, truth)  # what is clear is told to be
    return found, false


def test_nothing_is_certified_that_touches_a_triangle(tmp_path):
    found, false = tried(range(12), tmp_path)
    assert not false
    assert found["certified"] > 3
    assert found["contact"] > 1


@pytest.mark.slow
def test_forty_more(tmp_path):
    found, false = tried(range(1000, 1040), tmp_path)
    assert not false
    assert found["certified"] > 13
