"""What is told while one waits: on a terminal with progress, elsewhere in one line; and what does not count."""

import io
import re
import time
from pathlib import Path

import pytest

from comove.cli.app import since_process_start
from comove.cli.progress import progress_bar, time_spent
from comove.compiled.counting import ONCE, WarmUp, displays
from comove.planning.solution import Progress


def warm_up(seconds, workers=2, file=Path(__file__)):
    """What a search does first where kernels are missing: it waits for others, which have compiled half of them."""
    with displays[-1](WarmUp(2 * file.stat().st_size, workers, file)):
        time.sleep(seconds)


class Terminal(io.StringIO):
    def isatty(self):
        return True


def terminal(monkeypatch):
    """Standard error as a terminal of 160 columns; not a fixture, as pytest replaces the stream before every test."""
    screen = Terminal()
    monkeypatch.setattr("sys.stderr", screen)
    for name, value in (("COLUMNS", "160"), ("TERM", "xterm"), ("NO_COLOR", "1")):
        monkeypatch.setenv(name, value)
    return screen


@pytest.mark.parametrize(("workers", "cores"), [(1, "1 core"), (2, "2 cores")])
def test_without_a_terminal_one_line_says_that_kernels_are_compiled(capsys, workers, cores):
    with progress_bar(30.0) as callback:
        assert callback is None
        warm_up(0.0, workers)
    assert capsys.readouterr().err.splitlines() == [f"{ONCE}, on {cores}: up to a minute that does not count"]


def test_without_a_terminal_nothing_else_is_told(capsys):
    with progress_bar(30.0):
        pass
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("budget", [30.0, None])
def test_on_a_terminal_a_bar_shows_the_share_and_the_time_left(monkeypatch, budget):
    screen = terminal(monkeypatch)
    with progress_bar(budget, "executing"):
        warm_up(0.5)
    assert re.search(rf"{ONCE}, on 2 cores · about [01] s left .*0:00:0\d", screen.getvalue())


def test_on_a_terminal_the_search_is_shown_with_its_own_time(monkeypatch):
    screen = terminal(monkeypatch)
    with progress_bar(30.0) as callback:
        warm_up(0.0)
        after = len(screen.getvalue())
        callback(Progress("polishing", 7, 1.5, 0.25, 1.25, None))
    shown = screen.getvalue()[after:]
    assert "polishing · generation 7 · cost 1.5000 · constraint 0.25 · best verified 1.2500" in shown
    assert ONCE not in shown


def test_compiling_does_not_count():
    before = since_process_start() - time_spent()
    with progress_bar(30.0):
        warm_up(0.05)
    assert since_process_start() - time_spent() > before + 0.04
