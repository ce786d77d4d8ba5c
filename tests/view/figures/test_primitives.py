"""Pictures of primitives: drawn for every kind, labelled, and saying what they show."""

from dataclasses import replace

import numpy as np
import pytest

from comove.dmp import Primitive, Variant, learn
from comove.dmp import operations as op
from comove.dmp.demonstrations import Demonstration
from comove.view.figures import draw_library, draw_primitive, save

SINE = Demonstration.from_lasa("Sine")


def texts(figure):
    """Everything that is written in a figure."""
    found = [figure._suptitle.get_text()]
    for axes in figure.axes:
        found += [axes.get_title(), axes.get_title("left"), axes.get_xlabel(), axes.get_ylabel()]
    return [text for text in found if text]


def drawn(figure, tmp_path):
    figure.set_dpi(110)  # as `save` does, so that what is measured is what was saved
    save(figure, tmp_path / "picture.png")
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")
    return figure


def unreadable(figure):
    """Labels and titles of axes that cover each other, or are cut off."""
    renderer = figure.canvas.get_renderer()
    boxes = []
    for axes in figure.axes:
        for artist in (axes.title, axes._left_title, axes.xaxis.label, axes.yaxis.label):
            if artist.get_text():
                boxes.append((artist.get_text(), artist.get_window_extent(renderer)))
    pairs = [(a, b) for i, a in enumerate(boxes) for b in boxes[i + 1 :]]
    width, height = figure.bbox.size
    cut = [name for name, box in boxes if min(box.x0, box.y0, width - box.x1, height - box.y1) < 0]
    return [(a[0], b[0]) for a, b in pairs if a[1].overlaps(b[1])] + cut


@pytest.mark.parametrize("variant", list(Variant))
@pytest.mark.parametrize("recorded", [True, False])
@pytest.mark.few(2)
def test_every_variant(tmp_path, variant, recorded):
    primitive = learn(SINE, name="Sine", variant=variant)
    figure = drawn(draw_primitive(primitive, SINE if recorded else None), tmp_path)
    said = texts(figure)
    assert "Sine" in said[0] and variant in said[0]
    assert len(figure.axes) == 6
    assert not unreadable(figure)
    error = f"{primitive.provenance.error_rms:.2g} LASA unit"
    assert any(error in text for text in said) == recorded
    labels = [text for text in said if "[" in text]
    assert all("[s]" in text or "LASA unit" in text for text in labels)
    assert len(labels) >= 8


@pytest.mark.parametrize("n_dims", [1, 2, 3, 4, 7, 9])
@pytest.mark.few(2)
def test_every_dimension(tmp_path, n_dims):
    time = np.linspace(0, 2, 101)
    position = np.stack([np.sin(time * (1 + k)) for k in range(n_dims)], axis=1)
    recording = Demonstration(time, position, "joints", unit="rad")
    primitive = learn(recording, name="joints")
    assert not unreadable(drawn(draw_primitive(primitive, recording), tmp_path))
    assert not unreadable(drawn(draw_library([primitive] * 3), tmp_path))


def test_no_label_is_cut_off(tmp_path):
    """Limits that the layout learned too late made wider labels than there was room for."""
    time = np.linspace(0, 3, 301)
    way = (time / 3) ** 3 * (10 - 15 * time / 3 + 6 * (time / 3) ** 2)
    position = np.stack([0.5 * way, 0.2 * np.sin(np.pi * way), 0.3 * way**2 + 0.02 * np.sin(9 * way)], axis=1)
    recording = Demonstration(time, position, "reach")
    assert not unreadable(drawn(draw_primitive(learn(recording), recording), tmp_path))


@pytest.mark.parametrize("n_dims", [2, 3])
@pytest.mark.parametrize("recorded", [True, False])
@pytest.mark.few(1)
def test_orientations_are_drawn(tmp_path, n_dims, recorded):
    time = np.linspace(0, 3, 301)
    way = np.sin(time / 2)
    position = np.stack([0.5 * way, 0.2 * np.sin(np.pi * way), 0.3 * way**2], axis=1)[:, :n_dims]
    orientation = np.stack([np.cos(way), 0 * way, 0 * way, np.sin(way)], axis=1)
    orientation[150:] *= -1.0  # the same orientations
    recording = Demonstration(time, position, "pour", orientation=orientation)
    figure = drawn(draw_primitive(learn(recording, poses=True), recording if recorded else None), tmp_path)
    assert not unreadable(figure)
    last = figure.axes[-1]
    assert [text.get_text() for text in last.get_legend().get_texts()] == list("wxyz")
    assert len(last.lines) == (8 if recorded else 4)
    assert max(np.abs(np.diff(line.get_ydata())).max() for line in last.lines) < 0.05


def test_the_goals_that_are_asked_for(tmp_path):
    dmp = learn(SINE).dmp
    figure = drawn(draw_primitive(dmp, goals=[[10.0, 0.0], [0.0, 10.0]]), tmp_path)
    ends = [line.get_xydata()[-1].tolist() for line in figure.axes[1].lines]
    assert [10.0, 0.0] in [[round(x, 9) for x in end] for end in ends]
    assert [0.0, 10.0] in [[round(x, 9) for x in end] for end in ends]


@pytest.mark.parametrize("count", [7, 30])
@pytest.mark.few(1)
def test_the_sheet_names_every_movement(tmp_path, count):
    primitives = [replace(learn(SINE), name=f"sine {k}") for k in range(count)]
    figure = drawn(draw_library(primitives, title="mine"), tmp_path)
    said = texts(figure)
    assert said[0] == f"mine: {count} movements"
    for primitive in primitives:
        assert primitive.name in said
    assert sum(f"{SINE.duration:.3g} s\nfit error" in text for text in said) == count
    assert not unreadable(figure)


@pytest.mark.slow
def test_sheets_of_none_of_one_and_of_too_many(tmp_path):
    one = Primitive("one", op.in_space(learn(SINE).dmp, "xz"))
    assert texts(drawn(draw_library([]), tmp_path)) == ["library: 0 movements"]
    said = texts(drawn(draw_library([one]), tmp_path))
    assert said[0] == "library: 1 movement" and "x, z · " in said[-1]
    assert "the first 120" in texts(draw_library([one] * 121))[0]
