"""The scenes that come with the package can be taken along, and what was changed stays."""

import pytest

from comove.errors import ResultError
from comove.lab.examples import EXAMPLES, copy_examples, example
from comove.model import Scene


def test_copies_are_the_scenes_themselves_and_changed_ones_stay(tmp_path):
    mine = tmp_path / "narrow.yaml"
    mine.write_text("mine")
    copy_examples(tmp_path)
    assert mine.read_text() == "mine"
    for name in set(EXAMPLES) - {"narrow"}:
        assert Scene.load(tmp_path / f"{name}.yaml").file == example(name).file


def test_where_nothing_can_be_written_is_said(tmp_path):
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(ResultError, match="taken"):
        copy_examples(tmp_path / "taken")
