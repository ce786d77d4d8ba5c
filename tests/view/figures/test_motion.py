"""Pictures of motions, measures and the pipeline: what is wrong is coloured, what is missing is not drawn."""

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex

from comove.dmp import DMP
from comove.lab.examples import example
from comove.lab.paper.jobs import scene_of
from comove.lab.paper.runs import given_to_both
from comove.model import recording_of
from comove.model.motion import CoordinatedMotion
from comove.view.figures import (
    Panel,
    draw_failures,
    draw_measures,
    draw_motion,
    draw_pipeline,
    draw_progress_side_by_side,
    draw_side_by_side,
    save,
)
from comove.view.figures.motion import FINE, N_STATES, OFF, TOUCHES


def colours(axes):
    (load,) = [c for c in axes.collections if isinstance(c, LineCollection)]
    return [to_hex(colour) for colour in load.get_colors()]


@pytest.fixture(scope="module")
def apart():
    """Free hands that leave their distance on the way, far from all walls in the wide passage."""
    motion = given_to_both(DMP.fit(recording_of(example("narrow"))), "wide")
    weights = motion.weights.copy()
    weights[1] += 0.05
    return CoordinatedMotion(motion.scene, motion.coordinates, motion.basis, motion.boundary, weights)


def test_the_load_is_coloured_where_it_touches_and_where_it_is_off(apart):
    straight = CoordinatedMotion.straight(example("narrow"))
    left, right = draw_side_by_side([straight, apart], ["straight", "apart"]).axes
    assert len(colours(left)) == len(colours(right)) == N_STATES
    assert set(colours(left)) == {FINE, TOUCHES} and colours(left)[0] == FINE
    assert OFF in colours(right)
    legend = [text.get_text() for text in left.figure.legends[0].get_texts()]
    assert {"load, touching", "load, a distance off"} <= set(legend)


def test_failures_show_the_worst_state_of_what_is_broken(apart):
    straight = CoordinatedMotion.straight(example("narrow"))
    left, right = draw_failures([straight, apart], ["straight", "apart"]).axes
    (red,) = [line for line in left.lines if line.get_linewidth() == 3.5]
    assert to_hex(red.get_color()) == TOUCHES
    assert (abs(red.get_xdata() - 0.5) <= 0.05).all(), "within the wall"
    (orange,) = [line for line in right.lines if line.get_linewidth() == 3.5]
    assert to_hex(orange.get_color()) == OFF
    errors = np.abs(np.diff(apart.hands(np.linspace(0, 1, 801))[0], axis=1)[:, 0])
    most = np.abs(np.linalg.norm(errors, axis=1) - 0.2).max()
    drawn = np.linalg.norm(np.diff(orange.get_xydata(), axis=0))
    assert abs(drawn - 0.2) == pytest.approx(most, rel=1e-6)
    legend = [text.get_text() for text in left.figure.legends[0].get_texts()]
    assert legend[:2] == ["left", "right"] and "load, where a distance is most off" in legend


def test_hands_beyond_the_workspace_are_seen_up_to_half_of_it():
    scene = example("wide")
    motion = CoordinatedMotion.straight(scene)
    for lift, reach in ((0.5, 1.1), (40.0, 1.5)):
        boundary = motion.boundary.copy()
        boundary[[0, 2], 1] += lift
        away = CoordinatedMotion(scene, motion.coordinates, motion.basis, boundary, motion.weights)
        (axes,) = draw_side_by_side([away], ["away"]).axes
        assert axes.get_xlim() == pytest.approx((-0.02, 1.02))
        assert axes.get_ylim()[1] == pytest.approx(reach, abs=0.05)


def test_goals_are_where_they_should_be_reached():
    scene = example("narrow")
    motion = CoordinatedMotion.straight(scene)
    boundary = motion.boundary.copy()
    boundary[2, 0] -= 0.4  # ends half-way
    short = CoordinatedMotion(scene, motion.coordinates, motion.basis, boundary, motion.weights)
    (axes,) = draw_side_by_side([short], ["short"]).axes
    squares = [line.get_xydata()[0] for line in axes.lines if line.get_marker() == "s"]
    np.testing.assert_allclose(squares, scene.goal)


def test_motions_are_in_rows_and_their_progress_on_the_same_axes():
    motion = CoordinatedMotion.straight(scene_of("wide", tolerance=0.002))
    figure = draw_side_by_side([motion] * 3, ["a", "b", "c"], columns=2)
    assert [axes.get_subplotspec().get_gridspec().get_geometry() for axes in figure.axes] == [(2, 2)] * 3
    figure = draw_progress_side_by_side([motion, motion], ["a", "b"], velocity=0.2)
    lower = figure.axes[2:]
    assert lower[0].get_ylim() == lower[1].get_ylim()
    assert lower[0].get_ylim()[0] == pytest.approx(-1.3 * 0.002), (
        "the tolerance is what one sees of an exact motion"
    )


def test_measures_that_are_missing_are_not_drawn(tmp_path):
    value = np.array([[1.0, 2.0], [np.nan, 1e-9]])
    panels = [
        Panel("linear", value, value - 0.1, value + 0.1),
        Panel("logarithmic", value, value, value, 1e-3),
    ]
    figure = draw_measures(panels, ("one", "two"), ("a", "b"))
    linear, logarithmic = figure.axes[:2]
    assert logarithmic.get_xscale() == "log" and linear.get_xscale() == "linear"
    shown = [np.asarray(line.get_xdata(), dtype=float) for line in logarithmic.lines]
    assert min(np.nanmin(x) for x in shown) == pytest.approx(1e-3), "what is less is at the floor"
    assert [text.get_text() for text in linear.get_yticklabels()] == ["one", "two"]
    save(figure, tmp_path / "measures.png")


def test_the_pipeline_has_four_steps(tmp_path):
    recording = recording_of(example("narrow"))
    dmp = DMP.fit(recording)
    given = given_to_both(dmp, "narrow")
    straight = CoordinatedMotion.straight(example("wide"))
    figure = draw_pipeline(recording, dmp, given, straight)
    assert [axes.get_title()[:2] for axes in figure.axes] == ["1.", "2.", "3.", "4."]
    assert "50 mm into a wall" in figure.axes[2].get_title()
    assert "verified" in figure.axes[3].get_title()
    save(figure, tmp_path / "pipeline.png")


def test_speed_and_acceleration_are_drawn_below_the_motion():
    """Of minimum jerk along the straight way: peaks of 1.875 L/T and 10/sqrt(3) L/T^2."""
    assert len(draw_motion(CoordinatedMotion.straight(example("window"))).axes) == 4 + 2
    motion = CoordinatedMotion.straight(example("narrow"))
    _, speed, acceleration = draw_motion(motion).axes
    ways = np.linalg.norm(motion.scene.goal - motion.scene.start, axis=1)
    for hand, way in enumerate(ways):
        assert speed.lines[hand].get_ydata().max() == pytest.approx(1.875 * way / 10, rel=0.02)
        peak = acceleration.lines[hand].get_ydata().max()
        assert peak == pytest.approx(10 / np.sqrt(3) * way / 100, rel=0.02)
    assert speed.get_xlim() == (0, motion.scene.duration)


def test_arms_are_drawn_whole_where_they_leave_the_workspace():
    motion = CoordinatedMotion.straight(example("window"))
    scene = motion.scene
    base = scene.lower - 0.2 * (scene.upper - scene.lower)
    arms = [np.stack([np.stack([base, 0.5 * (scene.lower + scene.upper)])] * 4)]
    figure = draw_motion(motion, arms=arms)
    panels = [axes for axes in figure.axes if axes.get_xlabel().endswith("[m]")]
    assert len(panels) == 3
    for axes, (i, j) in zip(panels, ((0, 1), (0, 2), (1, 2)), strict=True):
        lines = [line.get_xydata() for line in axes.get_lines()]
        assert sum(len(line) == 2 and np.allclose(line[0], base[[i, j]]) for line in lines) == 4
        assert axes.get_xlim()[0] < base[i] and axes.get_ylim()[0] < base[j]
