"""The certificate is sound: brute force on the true curve never meets less clearance than it certifies.

And it is worth something: where a calm motion is clear, the bound lies within a millimetre of the truth.
"""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.dmp.basis import motion_basis
from comove.model import CoordinatedMotion, Scene, load_coordinates
from comove.verification import verify
from comove.verification.bounds import node_bounds
from comove.verification.certificate import certify
from tests import brute_force
from tests.cases import examples
from tests.solved import solved
from tests.verification.random_motions import near_contact, on_scene, perturbed, random_motion, scene_data

ROUNDING = 1e-9  # m
CALM = 500.0  # m a unit of time squared, accelerations by which chords are left by 0.1 mm between knots
seeds = st.integers(0, 2**32 - 1)
SOME = ["planar 0", "planar 1", "narrow", "bar 0", "triangle 0"]
MANY = [*SOME, "wide", "complex", *(f"planar {i}" for i in range(2, 9)), "bar 1", "bar 2", "triangle 1"]


def judged(motion):
    """What the certificate says, the truth [m], and the outcome in a word."""
    clearance, (truth, _) = certify(motion), brute_force.least_clearance(motion)
    required = motion.scene.clearance
    if clearance.lower >= required:
        outcome = "certified" if truth >= required - ROUNDING else "false certificate"
    else:
        outcome = "contact" if truth < required else "undecided"
    return clearance, truth, outcome


def peak_acceleration(motion):
    """Largest acceleration of a hand, by normalised time."""
    hands = brute_force.hands_at(motion)
    return float(np.linalg.norm(np.diff(hands, 2, axis=0), axis=-1).max() * brute_force.COARSE**2)


@pytest.mark.parametrize("chunk", range(6))
@pytest.mark.few(2)
def test_nothing_is_certified_above_the_truth(chunk):
    """150 random motions whose clearance is a matter of fractions of a millimetre."""
    outcomes = Counter()
    for seed in range(25 * chunk, 25 * chunk + 25):
        motion = near_contact(np.random.default_rng([seed, 11]))
        clearance, truth, outcome = judged(motion)
        outcomes[outcome] += 1
        assert outcome != "false certificate", (seed, clearance, truth)
        if outcome != "contact":
            assert clearance.lower <= truth + ROUNDING, (seed, clearance, truth)
            if peak_acceleration(motion) < CALM:
                assert truth - clearance.lower <= 1e-3, (seed, clearance, truth)
    assert outcomes["certified"] > 5
    assert outcomes["contact"] > 3


@pytest.mark.parametrize("chunk", range(3))
@pytest.mark.few(1)
def test_nothing_is_certified_above_the_truth_where_obstacles_turn(chunk):
    """75 random motions among obstacles that turn slowly or up to three times a second, as the file tells alone."""
    outcomes = Counter()
    for seed in range(25 * chunk, 25 * chunk + 25):
        motion = near_contact(np.random.default_rng([seed, 12]), moving=0.8)
        clearance, truth, outcome = judged(motion)
        outcomes[outcome] += 1
        assert outcome != "false certificate", (seed, clearance, truth)
        if outcome != "contact":
            assert clearance.lower <= truth + ROUNDING, (seed, clearance, truth)
            if peak_acceleration(motion) < CALM:
                assert truth - clearance.lower <= 1e-3, (seed, clearance, truth)
    assert outcomes["certified"] > 5
    assert outcomes["contact"] > 3


@pytest.mark.parametrize("name", SOME)
@pytest.mark.few(2)
def test_shaken_solutions_are_not_certified_above_the_truth(name):
    """What a search meets: solved motions, scaled and shaken until they pass or touch by little."""
    rng, outcomes = np.random.default_rng(5), Counter()
    for _ in range(12):
        clearance, truth, outcome = judged(perturbed(solved(name).attempt, rng))
        outcomes[outcome] += 1
        assert outcome != "false certificate", (clearance, truth)
        if outcome != "contact":
            assert -ROUNDING <= truth - clearance.lower <= 1e-3
    assert outcomes["undecided"] <= 2


@pytest.mark.slow
def test_two_hundred_motions():
    """The same on 200 motions; `benchmarks/soundness.py` takes as many as one has time for."""
    outcomes, above, gaps = Counter(), [], []
    for seed in range(200):
        rng = np.random.default_rng([seed, 13])
        name = "" if seed % 2 else MANY[seed // 2 % len(MANY)]
        motion = perturbed(solved(name).attempt, rng) if name else near_contact(rng)
        clearance, truth, outcome = judged(motion)
        outcomes[outcome] += 1
        if outcome == "false certificate":
            above.append((seed, name, clearance, truth))
        if outcome != "contact":
            gaps.append(truth - clearance.lower)
            if gaps[-1] < -ROUNDING:
                above.append((seed, name, clearance, truth))
    print(f"\n{dict(outcomes)}; median gap {np.median(gaps):.2g} m, 99 %: {np.quantile(gaps, 0.99):.2g} m")
    assert not above, above
    assert outcomes["certified"] > 60
    assert outcomes["contact"] > 40


def test_the_bound_of_a_rejected_motion_is_a_bound_too():
    for seed in range(20):
        clearance, truth, _ = judged(near_contact(np.random.default_rng([seed, 11])))
        assert clearance.lower <= truth + ROUNDING


@pytest.mark.parametrize("thickness", [5e-4, 1e-4, 1e-5])
@pytest.mark.parametrize("n_dims", [2, 3])
def test_a_thin_wall_between_two_samples_is_seen(n_dims, thickness):
    """A hand that crosses it at 2 m a unit of time is never at a knot while it touches: they are 2.5 mm apart."""
    across = [0.5] * (n_dims - 1)
    data = {
        "name": "thin",
        "duration": 1.0,
        "workspace": {"lower": [0.0] * n_dims, "upper": [1.0] * n_dims},
        "manipulators": [{"name": "a", "start": [0.1, *across], "goal": [0.9, *across]}],
    }
    scene, basis = Scene.from_dict(data), motion_basis(30)
    coordinates = load_coordinates(scene)
    weights = np.zeros((coordinates.n_columns, basis.n_basis))
    free = CoordinatedMotion(scene, coordinates, basis, coordinates.boundary(), weights)
    x = free.hands(np.linspace(0, 1, 801))[0][:, 0, 0]
    k = int(np.searchsorted(x, 0.4))
    for share in (0.5, 0.31):
        at = x[k] + share * (x[k + 1] - x[k])
        assert np.abs(x - at).min() > 0.6 * thickness
        wall = {"shape": "box", "center": [at, *across], "size": [thickness, *[0.2] * (n_dims - 1)]}
        assert certify(on_scene(free, data | {"obstacles": [wall]})).lower < 0
        wall["center"] = [at, across[0] + 0.101, *across[1:]]  # beside the way
        assert 0.9e-3 < certify(on_scene(free, data | {"obstacles": [wall]})).lower <= 1e-3


@examples(40)
@given(seeds, st.sampled_from([2, 3]))
def test_a_contact_between_two_knots_is_seen(seed, n_dims):
    """A plate on the outer side of a bend: the curve dips into it between two knots, their chord does not."""
    motion = random_motion(np.random.default_rng(seed), n_dims=n_dims, load="hands", sigma=0.06)
    at_knots, at_middles = (
        motion.hands(s)[0][:, 0] for s in (np.linspace(0, 1, 801), (np.arange(800) + 0.5) / 800)
    )
    middles = 0.5 * (at_knots[1:] + at_knots[:-1])
    chord_deviation = np.linalg.norm(at_middles - middles, axis=1)
    k = 50 + int(np.argmax(chord_deviation[50:700]))
    outward = (at_middles[k] - middles[k]) / chord_deviation[k]
    forward = (at_knots[k + 1] - at_knots[k]) / np.linalg.norm(at_knots[k + 1] - at_knots[k])
    forward -= (forward @ outward) * outward
    axes = [outward, forward / np.linalg.norm(forward)]
    if n_dims == 3:
        axes.append(np.cross(*axes))
    half = 0.1 * np.linalg.norm(at_knots[k + 1] - at_knots[k])
    center = middles[k] + (0.8 * chord_deviation[k] + half) * outward
    plate = {"shape": "box", "center": center.tolist(), "size": [2 * half] * n_dims}
    if n_dims == 2:
        plate["rotation_deg"] = float(np.rad2deg(np.arctan2(outward[1], outward[0])))
    else:
        x, y, z, w = Rotation.from_matrix(np.array(axes).T).as_quat()
        plate["quaternion_wxyz"] = [w, x, y, z]
    touching = on_scene(motion, scene_data(motion.scene) | {"obstacles": [plate]})
    clearance, truth, outcome = judged(touching)
    assert truth < -0.15 * chord_deviation[k] < -1e-7
    assert outcome == "contact", (clearance, truth)
    assert verify(touching).verified is None


@examples(40)
@given(seeds)
def test_more_obstacles_and_thicker_loads_have_less_clearance(seed):
    rng = np.random.default_rng(seed)
    motion = near_contact(rng)
    data = scene_data(motion.scene)
    data["limits"] = {"clearance": 0.0}
    whole = certify(on_scene(motion, data)).lower
    if whole < 0:
        return  # a rejected motion's bound says nothing
    fewer = certify(on_scene(motion, data | {"obstacles": data["obstacles"][1:]})).lower
    assert fewer >= whole - 2e-4
    if data["load"] is not None and "radius" in data["load"] and len(motion.scene.body.edges) == 1:
        thicker = data["load"] | {"radius": data["load"]["radius"] + 0.5 * whole}
        thick = certify(on_scene(motion, data | {"load": thicker})).lower
        assert thick == pytest.approx(0.5 * whole, abs=2e-4)


@examples(40)
@given(seeds)
def test_the_bulge_holds_the_curve(seed):
    """Nodes accelerate by no more than the bound, so they stay within h^2/8 of it of their chords."""
    rng = np.random.default_rng(seed)
    motion = random_motion(rng)
    bound = node_bounds(motion).acceleration
    share = rng.random()
    s = (np.arange(800) + share) / 800
    nodes = motion.coordinates.motion(motion.at(s))
    assert (np.linalg.norm(nodes[2], axis=-1) <= bound * (1 + 1e-9)).all()
    knots = motion.coordinates.motion(motion.knots)[0]
    chord = (1 - share) * knots[:-1] + share * knots[1:]
    assert (np.linalg.norm(nodes[0] - chord, axis=-1) <= bound / 8 / 800**2 + 1e-12).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e200])
def test_what_is_not_finite_is_not_certified(bad):
    motion = solved("narrow").attempt
    weights = motion.weights.copy()
    weights[0, 3] = bad
    with np.errstate(all="ignore"):
        assert certify(replace(motion, weights=weights)).lower == -np.inf


@examples(30)
@given(seeds)
def test_brute_force_knows_the_curve(seed):
    """The judge of these tests maps configurations to hands by itself, and as the motion does."""
    motion = random_motion(np.random.default_rng(seed))
    s = np.random.default_rng(seed).random(20)
    assert np.abs(brute_force.hands_at(motion, s) - motion.hands(s)[0]).max() < 1e-12
