"""The certificate of solid boxes is sound, and where a calm motion is clear it lies within a millimetre of the truth.

Two judges that share nothing with it say what is true: points of the box, and coal where it is installed.
"""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.dmp.basis import motion_basis
from comove.model import CoordinatedMotion, Scene, load_coordinates
from comove.verification import verify
from comove.verification.certificate import certify
from tests.cases import examples

from .random_boxes import box_near_contact, least_by_coal, least_clearance
from .random_motions import WIDE, on_scene, scene_data
from .test_certificate import CALM, ROUNDING, peak_acceleration

seeds = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("chunk", range(4))
@pytest.mark.few(1)
def test_nothing_is_certified_above_the_truth(chunk):
    """60 random motions of boxes, whose clearance is a matter of a millimetre."""
    outcomes = Counter()
    for seed in range(15 * chunk, 15 * chunk + 15):
        motion = box_near_contact(np.random.default_rng([seed, 21]))
        clearance, truth = certify(motion), least_clearance(motion)
        assert clearance.lower <= max(truth, 0.0) + ROUNDING, (seed, clearance, truth)
        if truth > 0:
            calm = peak_acceleration(motion) < CALM
            outcomes["clear and calm" if calm else "clear"] += 1
            assert not calm or truth - clearance.lower <= 1e-3, (seed, clearance, truth)
        else:
            outcomes["contact"] += 1
            assert verify(motion).verified is None, (seed, clearance, truth)
    assert outcomes["clear and calm"] > 2
    assert outcomes["contact"] > 2


@pytest.mark.slow
def test_coal_agrees():
    """At instants ever closer about the least distance."""
    coal, compared = pytest.importorskip("coal"), 0
    for seed in range(12):
        motion = box_near_contact(np.random.default_rng([seed, 22]))
        clearance, truth = certify(motion), least_by_coal(motion, coal)
        assert clearance.lower <= max(truth, 0.0) + 1e-6, (seed, clearance, truth)
        near_obstacle = clearance.nearest >= 0 and 0 < truth < 0.1
        if near_obstacle and peak_acceleration(motion) < CALM and truth < least_clearance(motion) + 1e-6:
            compared += 1
            assert truth - clearance.lower <= 1e-3, (seed, clearance, truth)
    assert compared > 2


@pytest.mark.slow
def test_fifty_motions_of_boxes():
    """The same on 50 others; `benchmarks/soundness.py` takes as many as one has time for."""
    gaps, above = [], []
    for seed in range(50):
        motion = box_near_contact(np.random.default_rng([seed, 23]))
        clearance, truth = certify(motion), least_clearance(motion)
        if clearance.lower > max(truth, 0.0) + ROUNDING:
            above.append((seed, clearance, truth))
        if truth > 0 and peak_acceleration(motion) < CALM:
            gaps.append(truth - clearance.lower)
    print(
        f"\nmedian gap {np.median(gaps):.2g} m, 99 %: {np.quantile(gaps, 0.99):.2g} m, most {max(gaps):.2g} m"
    )
    assert not above, above


def carried(size, start, goal, obstacles):
    """A box in one hand, which does not turn, straight from start to goal in space without a border."""
    data = {
        "name": "carried",
        "duration": 1.0,
        "workspace": {"lower": [WIDE[0]] * 3, "upper": [WIDE[1]] * 3},
        "load": {"shape": "box", "size": size},
        "manipulators": [{"name": "a", "start": start, "goal": goal}],
        "obstacles": obstacles,
    }
    scene, basis = Scene.from_dict(data), motion_basis(20)
    coordinates = load_coordinates(scene)
    weights = np.zeros((coordinates.n_columns, basis.n_basis))
    return CoordinatedMotion(scene, coordinates, basis, coordinates.boundary(), weights)


@pytest.mark.parametrize(
    "obstacle",
    [
        {"shape": "sphere", "radius": 0.01},
        {"shape": "box", "size": [0.02, 0.02, 0.02]},
        {"shape": "capsule", "radius": 0.01, "length": 1e-6},
        {"shape": "cylinder", "radius": 0.01, "height": 0.02},
        {"shape": "ellipsoid", "radii": [0.01, 0.01, 0.01]},
    ],
    ids=lambda o: o["shape"],
)
def test_what_is_smaller_than_the_box_and_before_its_middle_counts(obstacle):
    """A tray is carried over it: no edge comes near, but the face does, by 3 mm above it or 1 mm below its top."""
    for spare in (0.003, -0.001):
        here = obstacle | {"center": [0.5, 0.5, 0.5 - 0.01 - 0.01 - spare]}
        motion = carried([0.6, 0.4, 0.02], [0.0, 0.5, 0.5], [1.0, 0.5, 0.5], [here])
        clearance = certify(motion)
        if spare > 0:
            assert spare - 1.1e-4 < clearance.lower <= spare + ROUNDING
            assert verify(motion).verified is not None
        else:
            assert clearance.lower < 0
            assert clearance.upper <= 0
            assert any("obstacles[0]" in reason for reason in verify(motion).reasons)


@pytest.mark.parametrize("thickness", [5e-4, 1e-5])
def test_a_thin_wall_between_two_knots_is_seen(thickness):
    """The box passes it within one interval, so that it touches at no knot."""
    motion = carried([2e-3, 0.1, 0.1], [0.0, 0.5, 0.5], [2.0, 0.5, 0.5], [])
    x = motion.hands(np.linspace(0, 1, 801))[0][:, 0, 0]
    k = int(np.searchsorted(x, 1.0))
    at = 0.5 * (x[k] + x[k + 1])
    assert x[k + 1] - x[k] > 2e-3 + 2 * thickness
    wall = {"shape": "box", "center": [at, 0.5, 0.5], "size": [thickness, 0.3, 0.3]}
    data = scene_data(motion.scene)
    assert certify(on_scene(motion, data | {"obstacles": [wall]})).lower < 0
    wall["center"] = [at, 0.5 + 0.05 + 0.15 + 0.002, 0.5]  # beside the way
    assert 0.0018 < certify(on_scene(motion, data | {"obstacles": [wall]})).lower <= 0.002


@examples(25)
@given(seeds)
def test_fewer_obstacles_and_smaller_boxes_have_more_clearance(seed):
    motion = box_near_contact(np.random.default_rng(seed))
    data = scene_data(motion.scene) | {"limits": {"clearance": 0.0}}
    whole = certify(on_scene(motion, data)).lower
    if whole < 0:
        return  # a rejected motion's bound says nothing
    fewer = certify(on_scene(motion, data | {"obstacles": data["obstacles"][1:]})).lower
    assert fewer >= whole - 2e-4
    smaller = data["load"] | {"size": [0.9 * x for x in data["load"]["size"]]}
    assert certify(on_scene(motion, data | {"load": smaller})).lower >= whole - 2e-4


def test_the_border_of_the_workspace_counts_for_every_corner():
    motion = carried([0.2, 0.3, 0.4], [0.0, 0.5, 0.5], [1.0, 0.5, 0.5], [])
    for side, value, spare in (
        ("lower", [-0.101, -3, -3], 0.001),
        ("upper", [3, 0.652, 3], 0.002),
        ("upper", [3, 3, 0.703], 0.003),
    ):
        data = scene_data(motion.scene)
        data["workspace"][side] = value
        clearance = certify(on_scene(motion, data))
        assert spare - 1e-4 < clearance.lower <= spare + ROUNDING
        assert clearance.nearest == -1
