"""What is measured is what is meant; exponents are fitted and judged against their targets."""

import numpy as np
import pytest

from comove.errors import OptionError
from comove.lab.bench.scaling import (
    Case,
    ScalingCurve,
    draw_growth,
    gap_scene,
    generation_times,
    measure,
    ring_scene,
    scaling_text,
)


def test_rings():
    for n in (2, 3, 8):
        scene = ring_scene(n, n_obstacles=5)
        assert len(scene.manipulators) == n
        assert len(scene.body.edges) == (1 if n == 2 else n)
        assert len(scene.obstacles) == 5
    above = gap_scene(0.5).file.obstacles[1]
    assert above.center[1] - above.size[1] / 2 == pytest.approx(0.55)


def test_more_steps_take_longer():
    short, long = (min(generation_times(Case(ring_scene(), n_steps=n), 3)) for n in (101, 1601))
    assert long > 2 * short


def test_verdicts():
    x, exact = np.array([1.0, 2.0, 4.0, 8.0]), np.ones((1, 5))
    for exponent, verdict in ((0.5, "met"), (1.5, "missed")):
        curve = ScalingCurve("steps", "generation", x, x[:, None] ** exponent * exact, 1.0, 1.0)
        assert curve.exponent.value == pytest.approx(exponent)
        assert curve.exponent_end.value == pytest.approx(exponent)
        assert curve.verdict == verdict
    text = scaling_text([curve])
    assert "**Targets missed**: steps (generation)." in text
    assert "| 1.50 (1.50 to 1.50) |" in text


def test_growth_is_drawn():
    x = np.array([1.0, 2.0, 4.0])
    curves = [ScalingCurve("steps", "solve", x, np.stack([x, x, x], axis=1), 1.0, None)] * 5
    figure = draw_growth(curves)
    assert [axes.get_visible() for axes in figure.axes] == [True] * 5 + [False] * 3
    drawn = {line.get_label(): line.get_ydata() for line in figure.axes[0].get_lines()}
    assert drawn["exponent 1.00"] == pytest.approx(x)


def test_bad_options():
    with pytest.raises(OptionError, match="did you mean 'basis'"):
        measure(["bases"], 3)
    with pytest.raises(OptionError, match="1 or more"):
        measure(["basis"], 0)
    with pytest.raises(OptionError, match="nothing to measure"):
        measure(["difficulty"], 1, solves=False)
