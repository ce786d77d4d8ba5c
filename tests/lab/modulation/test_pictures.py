"""Pictures of all methods side by side: every scene that can be executed can be drawn."""

import numpy as np
import pytest
from PIL import Image

from benchmarks.random_scenes import moving_scene
from comove.control import Executor
from comove.lab.examples import example_path
from comove.lab.modulation.comparison import compare
from comove.lab.modulation.pictures import FILM, animate_comparison, draw_comparison
from comove.model import Scene
from comove.view.figures import save

TURNING = example_path("turning")


@pytest.fixture(scope="module", params=[TURNING, pytest.param(3, marks=pytest.mark.slow)])
def compared(request):
    """In the plane with two hands, and the first second of a spatial scene with three."""
    if isinstance(request.param, int):
        return compare(Executor(moving_scene(request.param)).run(1.0), 1.0)[0]
    return compare(Executor(Scene.load(request.param)).run(8.0), 8.0)[0]


@pytest.mark.slow
def test_a_column_a_method_and_a_row_a_view(compared, tmp_path):
    figure = draw_comparison(compared)
    rows = 3 if compared[0].record.scene.n_dims == 2 else 5
    assert len(figure.axes) == 6 * rows
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert len(titles) == 6
    assert titles[2].startswith("the nearest hand's matrix on all (the paper)\n")
    errors = figure.axes[6 * (rows - 2)].lines[0]
    np.testing.assert_allclose(errors.get_ydata(), 1e3 * compared[0].distance_errors)
    save(figure, tmp_path / "comparison.png")


@pytest.mark.slow
def test_the_animation_moves_and_is_in_real_time(compared, tmp_path):
    animate_comparison(compared, tmp_path / "comparison.gif")
    with Image.open(tmp_path / "comparison.gif") as film:
        assert 2 <= film.n_frames <= FILM.most_frames
        total, frames = 0.0, []
        for k in range(film.n_frames):
            film.seek(k)
            total += film.info["duration"] / 1e3
            frames.append(np.asarray(film.convert("RGB"), dtype=int))
    assert any(np.abs(a - frames[0]).max() > 50 for a in frames[1:])
    ends = [c.record.time[-1] for c in compared if c.arrived]
    assert total == pytest.approx(max([*ends, compared[0].record.scene.duration]) + 1.0, abs=0.5)
