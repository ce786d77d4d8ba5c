"""Notebooks show scenes and results: what is displayed agrees with what is known, and is text."""

import base64
import re
import subprocess
import sys
from dataclasses import replace

import pytest

from comove.stored import motion_rows
from comove.view.figures import as_html
from tests.solved import example, solved


def cells(page):
    """Return the rows of the table, by their names."""
    return dict(re.findall(r"<tr><th[^>]*>(.*?)</th><td[^>]*>(.*?)</td></tr>", page))


def picture(page):
    return base64.b64decode(re.search(r"base64,([^']+)'", page).group(1))


@pytest.mark.parametrize("name", ["wide", "window"])
def test_a_scene_shows_its_picture_and_contents(name):
    scene = example(name)
    page = scene._repr_html_()
    assert picture(page).startswith(b"\x89PNG") and len(page) < 300_000
    found = cells(page)
    assert found["end effectors"] == ", ".join(scene.manipulators)
    assert all(scene.name_of(i) in found["obstacles"] for i in range(min(6, len(scene.file.obstacles))))


def test_a_solution_shows_its_verdict_and_measures():
    solution = solved("wide")
    wanted = {name: said for name, said, _ in motion_rows(solution.report.asdict(), solution.scene)}
    for thing in (solution, solution.motion):
        page = thing._repr_html_()
        assert "wide: verified at every instant" in page and wanted.items() <= cells(page).items()
        assert picture(page).startswith(b"\x89PNG")


def test_an_attempt_is_not_shown_as_verified():
    failed = replace(solved("wide"), motion=None, reasons=("a hand is < fast > & late",))
    page = failed._repr_html_()
    assert "wide: not verified" in page and "verified at every instant" not in page
    assert "a hand is &lt; fast &gt; &amp; late" in page


def test_what_has_no_picture_is_refused():
    with pytest.raises(TypeError, match="int has no picture"):
        as_html(3)


def test_pictures_are_loaded_only_when_they_are_drawn():
    code = (
        "import sys, comove; comove.Scene; assert not {'comove.view.figures', 'matplotlib'} & {*sys.modules}"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
