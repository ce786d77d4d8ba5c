"""Pages to send: they say what was judged anew, and load nothing from anywhere."""

import base64
import re
import shutil

import numpy as np
import pytest

from comove.lab.examples import example_path
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
    for said in (
        "Verified",
        "clearance",
        "comove verify result",
        "the folder&#x27;s own scene",
        "data:image/png;base64,",
    ):
        assert said in outside
    assert not LOADS.findall(outside)
    assert len(page) < 5e6


def test_its_picture_is_of_what_was_verified(solved, tmp_path):
    """Not the one that lies in the folder, which anyone may have put there."""
    folder = shutil.copytree(solved / "result", tmp_path / "result")
    (folder / "motion.png").write_bytes(forged := b"\x89PNG forged")
    assert invoke("report", "result", "--html", "report.html", folder=tmp_path).exit_code == 0
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "data:image/png;base64," in page
    assert base64.b64encode(forged).decode()[:12] not in page


def test_a_report_of_a_run(solved):
    assert invoke("run", example_path("wide"), "--no-film", "--out", "run", folder=solved).exit_code == 0
    done = invoke("report", "run", "--html", "run.html", folder=solved)
    assert done.exit_code == 0, done.stderr
    page = (solved / "run.html").read_text(encoding="utf-8")
    for said in (
        "Executed, and verified at every instant",
        "What is proved",
        "comove verify run",
        "comove run ",
    ):
        assert said in page


def test_an_edited_result_is_not_reported_as_verified(solved, tmp_path):
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


def test_a_page_of_two_plays_both_until_the_longer_one_ends(solved):
    slow = ("solve", example_path("wide"), "--duration", 14, "--out", "slow", "--budget", 5)
    assert invoke(*slow, folder=solved).exit_code == 0
    done = invoke("view", "result", "slow", "--html", "pair.html", folder=solved)
    assert done.exit_code == 0, done.stderr
    page = (solved / "pair.html").read_text(encoding="utf-8")
    assert page.count("wide: verified at every instant") == 3  # the title, and a caption for each
    assert "duration: 10 s" in page and "duration: 14 s" in page
    end, messages = _played(page)
    assert end == pytest.approx(14.0, abs=0.1)
    for name, last in (("/load/rod_0", 10.0), ("/beside/load/rod_0", 14.0)):
        moved = [at for at, said in messages if said["type"] == "SetPositionMessage" and said["name"] == name]
        assert max(moved) == pytest.approx(last, abs=0.15)


def _played(page):
    """Return the end of a page's recording [s], and its messages with their times [s]."""
    import msgspec
    import zstandard

    packed = base64.b64decode(re.search(r'__VISER_EMBED_DATA__="([^"]+)"', page)[1])
    whole = zstandard.ZstdDecompressor().decompressobj().decompress(packed[8:])
    recording = msgspec.msgpack.decode(whole[8 : 8 + int.from_bytes(whole[:8], "little")])
    return recording["durationSeconds"], recording["messages"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("view", "--html", "x.html"), "name a scene"),
        (("view", example_path("wide"), example_path("wide")), "named twice"),
        (("view", "no_such.yaml"), "no_such.yaml"),
        (("view", ".", "--html", "x.html"), "it holds no solution.json"),
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
