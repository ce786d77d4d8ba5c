"""Pictures of benchmarks show what is there, whatever that is."""

import numpy as np
import pytest

from comove.lab.bench.report import draw_cost_ratios, draw_shares


def lines(axes):
    return {line.get_label(): line.get_xydata() for line in axes.get_lines()}


def test_shares():
    times = {"easy": {"one": np.array([0.1, np.inf, 0.4, 1.0]), "none": np.full(3, np.inf)}, "hard": {}}
    easy, hard = draw_shares(times).axes
    steps = lines(easy)
    assert steps["one"][:, 1].max() == 0.75
    assert steps["one"][1:4, 0] == pytest.approx([0.1, 0.4, 1.0])
    assert steps["none"][:, 1].max() == 0.0
    assert not lines(hard)


def test_nobody_solves_anything():
    (axes,) = draw_shares({"easy": {"none": np.full(2, np.inf)}}).axes
    assert lines(axes)["none"][:, 1].max() == 0.0


def test_cost_ratios():
    (axes,) = draw_cost_ratios({"easy": {"one": np.array([1.0, 1.2, np.inf, 50.0])}}).axes
    assert lines(axes)["one"][-1].tolist() == [10.0, 0.5]  # what costs too much is not drawn
