"""The line of progress: in notebooks by itself, elsewhere where it is asked for, never by a search within another."""

import sys
import types

import pytest

from comove import solve
from comove.errors import OptionError
from comove.planning import displays
from comove.planning.displays import displayed
from comove.planning.solution import Progress
from tests.solved import example

STATE = Progress("smooth", 3, 0.5, 0.0, 0.25)


@pytest.fixture
def cell(monkeypatch):
    """What the running cell of a notebook has displayed: the texts of each display, in their order."""
    displays_of_cell = []

    def display(data, *, raw, display_id):
        assert raw and display_id
        texts = [data["text/plain"]]
        displays_of_cell.append(texts)
        return types.SimpleNamespace(update=lambda data, raw: texts.append(data["text/plain"]))

    ipython = types.ModuleType("IPython")
    ipython.get_ipython = lambda: types.SimpleNamespace(kernel=object())
    ipython.display = types.ModuleType("IPython.display")
    ipython.display.display = display
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", ipython.display)
    monkeypatch.setattr(displays, "DELAY", 0.0)
    monkeypatch.setattr(displays, "PAUSE", 0.0)
    return displays_of_cell


def test_in_a_notebook_one_line_shows_best_cost_and_time_left(cell, capsys):
    solution = solve(example("wide"), budget=20.0)
    (texts,) = cell
    *during, last = texts
    assert during and all("best verified" in text and text.endswith(" s left") for text in during)
    assert last.startswith("done in ") and "best verified 0." in last and solution.verified
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("progress", [False, lambda state: None])
def test_in_a_notebook_nothing_is_shown_to_who_says_so(cell, progress):
    solve(example("wide"), progress=progress)
    assert not cell


def test_short_searches_and_close_reports_show_nothing(cell, monkeypatch):
    monkeypatch.setattr(displays, "DELAY", 60.0)
    solve(example("wide"))
    assert not cell
    monkeypatch.setattr(displays, "DELAY", 0.0)
    monkeypatch.setattr(displays, "PAUSE", 60.0)
    with displayed(None, 5.0) as tell:
        tell(STATE)
        tell(STATE)
    assert len(cell[0]) == 2  # the first, and the end


def test_plain_programs_show_nothing_unless_asked(capsys, monkeypatch):
    monkeypatch.setattr(displays, "DELAY", 0.0)
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    with displayed(None, 5.0) as tell:
        assert tell is False
    solve(example("wide"))
    assert capsys.readouterr() == ("", "")
    with displayed(True, 5.0) as tell:
        tell(STATE)
    out, err = capsys.readouterr()
    assert out == "" and "best verified 0.2500" in err and "5 s left" in err and "done in" in err


def test_what_is_no_progress_is_refused():
    with pytest.raises(OptionError, match="progress = 'bar'"), displayed("bar", 5.0):
        pass
