"""A table has a row for every scene, method and seed, and each is what `solve` finds."""

import pytest

import comove
from comove.data import study
from comove.errors import OptionError
from comove.lab.examples import example_path


@pytest.mark.slow
def test_rows_are_those_of_solve(tmp_path):
    scenes = [comove.Scene.load(example_path(name)) for name in ("wide", "turning")]
    table = study(scenes, seeds=2, workers=2, out=tmp_path / "study")
    assert [(run.seed, run.scene) for run in table.runs] == [
        (0, "wide"),
        (0, "turning"),
        (1, "wide"),
        (1, "turning"),
    ]
    for run in table.runs[:2]:
        scene = next(scene for scene in scenes if scene.name == run.scene)
        alone = comove.solve(scene, demonstration=comove.model.demonstration_of(scene), seed=run.seed)
        assert (run.status, run.cost) == ("verified", alone.cost.total)
        assert run.scene_sha256 == scene.sha256
    assert set(map(len, table.columns.values())) == {4}
    parquet = pytest.importorskip("pyarrow.parquet")
    table.write_parquet(tmp_path / "table.parquet")
    assert parquet.read_table(tmp_path / "table.parquet").to_pydict() == table.columns
    assert study(scenes, seeds=1, out=tmp_path / "study").runs == table.runs[:2]  # nothing is run again


def test_bad_arguments():
    wide = comove.Scene.load(example_path("wide"))
    with pytest.raises(OptionError, match="two scenes are called 'wide'"):
        study([wide, wide])
    with pytest.raises(OptionError, match="did you mean 'comove'"):
        study([wide], ["comvoe"])
    for arguments in (([],), ([wide], []), ([wide], ["comove"], 0)):
        with pytest.raises(OptionError, match="nothing to run"):
            study(*arguments)
