"""The save button writes inside one folder, and what it writes reads back to the same scene."""

import pytest

import comove
from comove.errors import OptionError, ResultError
from comove.lab.examples import example, example_path
from comove.view.workbench.edits import contents_of, with_value
from comove.view.workbench.saving import save_scene, target_in


@pytest.mark.parametrize(
    "name",
    [
        "../x",
        "/etc/passwd",
        "a/b",
        "a\\b",
        "",
        ".",
        "..",
        ".hidden",
        "a\0b",
        "a\nb",
        "x" * 200,
        "~",
        None,
        3,
        "ü/..",
    ],
)
def test_a_name_leads_nowhere_else(tmp_path, name):
    with pytest.raises(OptionError, match="plain name"):
        target_in(tmp_path, name, ".yaml")


def test_a_link_is_not_followed(tmp_path):
    elsewhere = tmp_path / "elsewhere"
    inside = tmp_path / "inside"
    inside.mkdir()
    (inside / "x.yaml").symlink_to(elsewhere)
    with pytest.raises(OptionError, match="link"):
        target_in(inside, "x", ".yaml")


@pytest.mark.parametrize("name", ["narrow", "window", "turning", "complex", "triangle"])
def test_a_saved_scene_reads_back(tmp_path, name):
    scene = comove.Scene.load(example_path(name))
    contents = contents_of(scene)
    path = target_in(tmp_path, name, ".yaml")
    save_scene(contents, path, scene.folder)
    again = comove.Scene.load(path)
    assert again.sha256 == comove.Scene.from_dict(contents, folder=scene.folder).sha256
    assert len(path.read_text().splitlines()) < 60, "what is understood is not written"


def test_nothing_is_replaced_and_nothing_wrong_is_written(tmp_path):
    contents, path = contents_of(example("narrow")), tmp_path / "x.yaml"
    save_scene(contents, path, tmp_path)
    before = path.read_bytes()
    with pytest.raises(ResultError, match="there already"):
        save_scene(with_value(contents, "speed", 0.5), path, tmp_path)
    assert path.read_bytes() == before
    wrong = contents | {"duration": -3.0}
    with pytest.raises(comove.errors.SceneError):
        save_scene(wrong, tmp_path / "y.yaml", tmp_path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.yaml"]


def test_a_scene_that_names_files_stays_beside_them(tmp_path):
    contents = contents_of(example("narrow")) | {"demonstration": {"file": "carry.csv"}}
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "carry.csv").write_text("time,x,y\n0,0,0\n1,1,1\n2,2,1\n")
    with pytest.raises(ResultError, match="names files beside it"):
        save_scene(contents, tmp_path / "x.yaml", tmp_path / "here")
    save_scene(contents, tmp_path / "here" / "x.yaml", tmp_path / "here")
