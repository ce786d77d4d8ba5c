"""Pictures come from another process: the same as from this one, and whatever happens to it, the result is whole."""

import json

import pytest

from comove.cli import drawing
from comove.io.folders import add_files, identity_of
from comove.processes import ALONE
from comove.view.figures import pictures
from tests.cli.test_cli import SCENE
from tests.commands import invoke
from tests.processes import works

NAMES = {"motion.png", "progress.png"}


@pytest.fixture
def solved(tmp_path):
    """Return a function that solves a scene by the command line; the folder of the result."""
    (tmp_path / "scene.yaml").write_text(SCENE)

    def solve(name, *options):
        folder = tmp_path / name
        outcome = invoke("solve", tmp_path / "scene.yaml", "--out", folder, *options, pictures=True)
        assert outcome.exit_code == 0, outcome.stderr
        assert json.loads((folder / "solution.json").read_text())["verified"]
        assert invoke("verify", tmp_path / "scene.yaml", folder).exit_code == 0
        return folder, outcome

    return solve


@pytest.fixture
def two_cores(monkeypatch):
    """Let another process draw, on any machine."""
    monkeypatch.delenv(ALONE)
    monkeypatch.setattr("comove.processes.n_processors", lambda: 2)


def drawn_in(folder):
    return {path.name: path.read_bytes() for path in folder.glob("*.png")}


def test_both_processes_draw_the_same(solved, monkeypatch, two_cores):
    there, outcome = solved("there")
    assert all(f"{there / name}" in outcome.stdout for name in NAMES)
    monkeypatch.setenv(ALONE, "1")
    here, _ = solved("here")
    assert drawn_in(there) == drawn_in(here) and drawn_in(here).keys() == NAMES


def test_a_process_that_dies_costs_the_pictures_alone(solved, monkeypatch, two_cores):
    monkeypatch.setattr(pictures, "drawn", works.kill)
    folder, outcome = solved("out")
    assert "pictures could not be drawn (the process that draws them was killed)" in outcome.stderr
    assert outcome.stderr.count("\n") == 1 and "pictures" not in outcome.stdout
    assert not drawn_in(folder)


def test_what_fails_while_this_process_draws_costs_the_pictures_alone(solved, monkeypatch):
    def failing(_):
        raise ValueError("no colours")

    monkeypatch.setenv(ALONE, "1")
    monkeypatch.setattr(pictures, "drawn", failing)
    folder, outcome = solved("out")
    assert "pictures could not be drawn (ValueError: no colours)" in outcome.stderr
    assert not drawn_in(folder)


def test_no_pictures_on_request_and_those_of_before_go_with_their_result(solved, monkeypatch):
    def refused(_):
        raise AssertionError

    folder, _ = solved("out")
    assert drawn_in(folder)
    monkeypatch.setattr(pictures, "drawn", refused)
    folder, outcome = solved("out", "--no-pictures")
    assert not drawn_in(folder) and "pictures" not in outcome.stdout
    assert not list(folder.parent.glob(".*"))


def test_a_folder_in_the_place_of_another_gets_none_of_its_files(tmp_path):
    old, new = tmp_path / "old", tmp_path / "new"
    old.mkdir()
    new.mkdir()
    add_files(old, {"a": b"1"}, identity_of(old))
    add_files(new, {"a": b"1"}, identity_of(old))
    assert (old / "a").read_bytes() == b"1"
    assert not list(new.iterdir()) and len(list(tmp_path.iterdir())) == 2


def test_nothing_helps_where_there_is_one_core(monkeypatch):
    monkeypatch.delenv(ALONE)
    monkeypatch.setattr("comove.processes.n_processors", lambda: 1)
    with drawing.drawing_ahead(True) as drawer:
        assert drawer is None
