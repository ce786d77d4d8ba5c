"""How far a fit is from its recording is given to whoever asks, and told where it is far."""

import re
import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from comove.dmp import DMP, FitError, PoseDMP, ProMP, Variant, learn
from comove.dmp.demonstrations import Demonstration, lasa_names
from comove.errors import ComoveWarning
from tests.dmp.movements import recording

S = np.linspace(0.0, 1.0, 2001)


def waves(n, start=0.0, end=1.0):
    """A hand that goes up and down `n` times on its way, for a minute."""
    s = S[(start <= S) & (end >= S)]
    return Demonstration(60 * s, np.stack([s, 0.3 * np.sin(2 * np.pi * n * s)], axis=1), "waves")


def told(demonstration, fit=DMP.fit, **options):
    """Return what was said of a fit that is far off."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        fit(demonstration, **options)
    said = [str(w.message) for w in found if issubclass(w.category, ComoveWarning)]
    return [text for text in said if "the fit of" in text]


def options_in(said):
    """Return the options that a warning names."""
    number, rest = re.search(r"give n_basis=(\d+)$", said), "at_rest=False" in said
    return ({"n_basis": int(number[1])} if number else {}) | ({"at_rest": False} if rest else {})


@pytest.mark.parametrize("variant", list(Variant))
def test_the_error_is_the_distance_at_the_samples(variant):
    demo = Demonstration.from_lasa("Sine")
    late = Demonstration(demo.time + 5.0, demo.position, unit="any")  # which begins at another time
    dmp = DMP.fit(demo, n_basis=6, variant=variant)
    away = np.linalg.norm(dmp.at(demo.time - demo.time[0]).position - demo.position, axis=1)
    for shown in (demo, late):
        error = dmp.fit_error(shown)
        assert error.rms == pytest.approx(np.sqrt((away**2).mean()), rel=1e-12)
        assert error.largest == pytest.approx(away.max(), rel=1e-12)
        assert error.time == pytest.approx(demo.time[np.argmax(away)] - demo.time[0], abs=1e-9)


def test_the_error_of_a_long_recording_is_taken_in_blocks():
    demo = Demonstration.from_lasa("Sine")
    dmp = DMP.fit(demo, n_basis=6)
    whole = dmp.distances_from(demo.time, demo.position)
    assert np.array_equal(dmp.distances_from(demo.time, demo.position, block_size=77), whole)


def test_the_error_of_poses_is_a_distance_and_an_angle():
    shown = recording(3)
    dmp = PoseDMP.fit(shown, n_basis=5)
    moved, turned = dmp.fit_error(shown)
    played = dmp.at(shown.time)
    between = Rotation.from_quat(played.orientation, scalar_first=True) * (
        Rotation.from_quat(shown.orientation, scalar_first=True).inv()
    )
    assert turned.largest == pytest.approx(between.magnitude().max(), abs=1e-9)
    assert moved == dmp.translation.fit_error(shown) and isinstance(turned, FitError)
    kept = learn(shown, n_basis=5, poses=True).provenance
    assert (kept.error_rms, kept.error_max) == (moved.rms, moved.largest)
    assert (kept.turn_rms, kept.turn_max) == (turned.rms, turned.largest)


def test_a_fit_that_is_far_off_is_told_with_weights_that_are_enough():
    (said,) = told(waves(20))
    error = DMP.fit(waves(20)).fit_error(waves(20))
    assert f"off by up to {error.largest:.2g} m" in said and f"at {error.time:.3g} s" in said
    assert options_in(said) and not told(waves(20), **options_in(said))


def test_what_no_weights_follow_is_to_be_cut():
    (said,) = told(waves(200))
    assert "no n_basis up to 200 follows it" in said and "cut it into parts" in said
    assert not told(waves(200, 0.0, 0.02))


def test_a_recording_that_ends_in_motion_is_told():
    t = np.linspace(0, 1, 101)
    throw = Demonstration(t, np.stack([2 * t**2, t**3], axis=1))
    (said,) = told(throw, n_basis=5)
    assert options_in(said) == {"at_rest": False}
    assert not told(throw, n_basis=5, at_rest=False)


def test_a_rotation_that_is_far_off_is_told_in_radians():
    turns = Rotation.from_rotvec(np.outer(0.5 * np.sin(2 * np.pi * 20 * S), [0, 0, 1])).as_quat(
        scalar_first=True
    )
    nod = Demonstration(60 * S, np.outer(S, [1.0, 0, 0]), orientation=turns)
    (said,) = told(nod, PoseDMP.fit)
    assert re.match(r"the fit of the rotation is off by up to 0\.\d+ rad", said)
    assert not told(nod, PoseDMP.fit, **options_in(said))


def test_a_rhythm_that_is_far_off_is_told():
    beat = Demonstration(10 * S, np.stack([np.sin(20 * np.pi * S), np.sin(200 * np.pi * S)], axis=1))
    (said,) = told(beat, variant="rhythmic", period=1.0, n_basis=5)
    assert not told(beat, variant="rhythmic", period=1.0, **options_in(said))
    growing = Demonstration(10 * S, np.outer(S, [1, 1]) * beat.position)
    (said,) = told(growing, variant="rhythmic", period=1.0)
    assert "its cycles differ" in said


def test_distributions_are_told_of_the_recording_that_is_far_off():
    rng = np.random.default_rng(0)
    few = [
        Demonstration(one.time, one.position + rng.normal(0, 0.02, 2) * S[:, None] * (1 - S[:, None]))
        for one in (waves(5), waves(5), waves(5))
    ]
    (said,) = told(few, ProMP.fit, n_basis=8)
    assert re.match(r"the fit of recording \d is off by up to ", said)
    assert not told(few, ProMP.fit, **options_in(said))


def test_good_fits_are_not_told():
    for name in lasa_names():
        for variant in ("closed-form", "pastor", "dmp++", "classic"):
            assert not told(Demonstration.from_lasa(name), variant=variant)
    still = 2e-4 * np.random.default_rng(0).standard_normal((len(S), 3))  # a hand that waits
    assert not told(Demonstration(10 * S, still))
    assert not told(Demonstration(10 * S, np.zeros((len(S), 3)), unit="any"))
