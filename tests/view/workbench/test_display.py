"""`show` draws whatever moves, in a notebook or in a browser, and says what a judge says of it."""

import html
import sys
import types
import webbrowser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

import comove
from comove.io.folders import whole_folder
from comove.model import CoordinatedMotion
from comove.results import RESULT, read_result
from comove.view.figures import save_result
from tests.solved import example, solved

pytest.importorskip("viser", reason="the viewer is not installed: pip install 'comove[view]'")


@pytest.fixture
def seen(monkeypatch):
    """Pages that a browser was asked to open."""
    pages = []

    def opened(address):
        path = Path(unquote(urlsplit(address).path))
        pages.append(path.read_text(encoding="utf-8"))
        path.unlink()
        path.parent.rmdir()
        return True

    monkeypatch.setattr(webbrowser, "open", opened)
    return pages


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A result folder."""
    folder = tmp_path_factory.mktemp("shown") / "result"
    with whole_folder(folder, RESULT) as draft:
        save_result(solved("wide"), draft, wall_time_s=1.0)
    return folder


def test_a_solution_and_its_motion_are_shown_with_the_verdict(seen):
    solution = solved("wide")
    for thing in (solution, solution.motion, solution.attempt):
        thing.show()
    assert len(seen) == 3
    for page in seen:
        assert "<title>wide: verified at every instant</title>" in page
        assert "clearance: " in page and "mm at least, at every instant" in page
        assert len(page) < 5e6


def test_a_scene_is_shown_before_it_is_solved(seen):
    example("window").show()
    assert "<title>window: no motion yet</title>" in seen[0]


def test_a_motion_through_a_wall_is_not_shown_as_verified(seen):
    CoordinatedMotion.straight(example("narrow")).show()
    assert "<title>narrow: not verified</title>" in seen[0]
    assert "the load or a hand" in seen[0]
    assert "verified at every instant" not in seen[0]


def test_a_folder_is_judged_anew(seen, folder, tmp_path):
    comove.show(folder)
    comove.show(str(folder))
    read_result(folder).show()
    assert ["wide: verified at every instant" in page for page in seen] == [True] * 3


def test_in_a_notebook_it_is_shown_in_the_notebook(seen, monkeypatch):
    shown = []
    ipython = types.ModuleType("IPython")
    ipython.get_ipython = lambda: types.SimpleNamespace(kernel=object())
    display = types.ModuleType("IPython.display")
    display.HTML, display.display = str, shown.append
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    solved("wide").show()
    assert not seen
    (frame,) = shown
    assert frame.startswith("<iframe") and 'sandbox="allow-scripts"' in frame
    inside = html.unescape(frame.partition('srcdoc="')[2].partition('" width')[0])
    assert "<title>wide: verified at every instant</title>" in inside
    ipython.get_ipython = lambda: object()  # of a terminal, which shows no pages
    solved("wide").show()
    assert len(shown) == 1 and len(seen) == 1


def test_without_a_browser_it_says_where_the_page_is(monkeypatch, capsys):
    monkeypatch.setattr(webbrowser, "open", lambda address: False)
    example("wide").show()
    path = Path(capsys.readouterr().out.strip().rpartition("the page is ")[2])
    assert "no motion yet" in path.read_text(encoding="utf-8")
    path.unlink()
    path.parent.rmdir()


def test_what_does_not_move_is_refused():
    with pytest.raises(TypeError, match="a dict cannot be shown"):
        comove.show({})
    with pytest.raises(comove.errors.ResultError, match="holds no"):
        comove.show(Path(__file__).parent)


def test_without_the_viewer_it_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(comove.errors.ExtraError, match=r"comove\[view\]"):
        example("wide").show()
