"""Pages to send: they say what was judged anew, and load nothing from anywhere."""

import re

import numpy as np
import pytest

from comove.experiments.examples import example_path
from tests.commands import invoke

pytest.importorskip("viser", reason="the viewer is not installed: pip install 'comove[view]'")

LOADS = re.compile(r"""(?:src|href)\s*=\s*["'](?!data:|#)[^"']+""")


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("solved")
    assert (
        invoke("solve", example_path("wide"), "--out", "result", "--budget", 5, folder=folder).exit_code == 0
    )
    return folder


def test_a_report_of_a_result(solved):
    done = invoke("report", "result", "--html", "report.html", folder=solved)
    assert done.exit_code == 0, done.stderr
    assert "verified" in done.stdout
    page = (solved / "report.html").read_text(encoding="utf-8")
    outside = page.replace(re.search(r'srcdoc="[^"]*"', page)[0], "")
    for said in ("Verified", "clearance", "comove verify result/scene.json result", "data:image/png;base64,"):
        assert said in outside
    assert not LOADS.findall(outside)
    assert len(page) < 5e6


def test_an_edited_result_is_not_reported_as_verified(solved, tmp_path):
    import shutil

    shutil.copytree(solved / "result", tmp_path / "result")
    with np.load(tmp_path / "result" / "solution.npz") as archive:
        arrays = dict(archive)
    arrays["position"] = arrays["position"] + 1e-3
    np.savez(tmp_path / "result" / "solution.npz", **arrays)
    for command in (("report", "result"), ("view", "result")):
        done = invoke(*command, "--html", "page.html", folder=tmp_path)
        assert done.exit_code == 1, done.stderr
        assert "NOT VERIFIED" in done.stdout
        assert "ot verified" in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_a_page_of_a_result(solved):
    done = invoke("view", "result", "--html", "page.html", folder=solved)
    assert done.exit_code == 0, done.stderr
    page = (solved / "page.html").read_text(encoding="utf-8")
    assert "wide: verified at every instant" in page
    assert "default-src 'unsafe-inline'" in page
    assert len(page) < 5e6


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("view", "--html", "x.html"), "name a scene"),
        (("view", "no_such.yaml"), "no_such.yaml"),
        (("view", ".", "--html", "x.html"), "which scene was solved"),
        (("report", "no_such", "--html", "x.html"), "no such folder"),
        (("view", example_path("wide"), "--html", "no/such/x.html"), "no folder"),
        (("view", example_path("wide"), "--port", "70000"), "--port"),
    ],
)
def test_wrong_wishes_are_refused_in_words(tmp_path, arguments, words):
    done = invoke(*arguments, folder=tmp_path)
    assert done.exit_code == 2
    assert words in done.stderr
    assert not list(tmp_path.iterdir())
