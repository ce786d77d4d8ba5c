"""Every frozen scene can be solved, as its witness shows; they are drawn again as they are."""

import numpy as np
import pytest

from comove.errors import OptionError, ResultError
from comove.lab.bench.drawing import DIFFICULTIES, Witness
from comove.lab.bench.sets import SETS, HandSet, draw_set, scene_text, scenes_of
from comove.model import Scene
from tests.lab.bench.witnesses import witness_of

HANDS = [name for name, one in SETS.items() if isinstance(one, HandSet)]
ALL = [pytest.param(s, id=f"{s.set}-{s.name}") for name in HANDS for s in scenes_of(name)]


@pytest.mark.parametrize("frozen", ALL)
def test_the_witness_is_accepted(frozen):
    scene = frozen.load()
    report = witness_of(frozen, scene).judged(scene)
    assert report.reasons == ()
    assert report.clearance_min >= DIFFICULTIES[frozen.set].spare - 1e-6
    assert report.speed_max < scene.speed_limit


@pytest.mark.parametrize("name", HANDS)
def test_half_are_planar_and_half_spatial(name):
    frozen = scenes_of(name)
    assert len(frozen) == 50
    assert [s.name.split("-")[0] for s in frozen[:4]] == ["planar", "spatial"] * 2
    d = DIFFICULTIES[name]
    scenes = [s.load() for s in frozen[:10]]
    assert {scene.n_dims for scene in scenes} == {2, 3}
    assert all(d.manipulators[0] <= len(scene.manipulators) <= d.manipulators[1] for scene in scenes)


@pytest.mark.parametrize("name", HANDS)
@pytest.mark.parametrize("index", [0, 1])
def test_scenes_are_drawn_again_as_they_are_frozen(name, index):
    data, _ = SETS[name].draw(index)
    frozen = scenes_of(name)[index]
    again = Scene.from_dict(data)
    assert again.sha256 == frozen.load().sha256
    assert scene_text(data) == frozen.path.read_text(encoding="utf-8")


def test_a_set_is_written_as_a_whole(tmp_path):
    draw_set("hard", tmp_path / "mine", count=3, seed=5)
    assert sorted(p.name for p in (tmp_path / "mine").iterdir()) == [
        "planar-00.yaml",
        "planar-01.yaml",
        "spatial-00.yaml",
        "witnesses.yaml",
    ]
    with pytest.raises(ResultError, match="the folder is not empty"):
        draw_set("hard", tmp_path / "mine", count=3, seed=5)


def test_openings_of_hard_and_extreme_bars_are_narrower_than_the_bar():
    for name, most in (("hard", 0.9), ("extreme", 0.45)):
        for frozen in scenes_of(name):
            scene = frozen.load()
            if len(scene.manipulators) == 2 and scene.n_dims == 2:
                low, high = scene.file.obstacles[:2]
                gap = high.center[1] - high.size[1] / 2 - low.center[1] - low.size[1] / 2
                assert gap <= most * scene.file.load.length + 1e-3


def test_a_witness_moves_by_minimum_jerk():
    """Flash and Hogan, 1985: the greatest speed is 1.875 times the mean."""
    held = np.array([[-0.1, 0, 0], [0.1, 0, 0]])
    center = np.array([[0.2, 0.5, 0], [0.8, 0.5, 0]])
    quaternion = np.array([[1.0, 0, 0, 0]] * 2)
    hands = Witness(center, quaternion, held).hands(1001)
    assert np.abs(np.diff(hands[:, 0, 0])).max() * 1000 == pytest.approx(1.875 * 0.6, rel=1e-4)
    assert hands[0, 1] == pytest.approx([0.3, 0.5, 0])
    assert hands[-1, 0] == pytest.approx([0.7, 0.5, 0])


def test_a_witness_turns_the_shorter_way():
    held = np.array([[-0.1, 0, 0], [0.1, 0, 0]])
    center, turn = np.array([[0.5, 0.5, 0]] * 2), 0.75 * np.pi
    quaternion = np.array([[1.0, 0, 0, 0], [np.cos(turn), 0, 0, np.sin(turn)]])  # 3/2 pi: -pi/2 is shorter
    half = Witness(center, quaternion, held).hands(3)[1]
    assert half[1] - center[0] == pytest.approx(0.1 * np.array([np.cos(np.pi / 4), -np.sin(np.pi / 4), 0]))


@pytest.mark.parametrize("count", [0, -1, 51])
def test_counts_that_make_no_sense(count):
    with pytest.raises(OptionError, match="1 to 50"):
        scenes_of("easy", count)


def test_a_set_that_is_not_there():
    with pytest.raises(OptionError, match="did you mean 'extreme'"):
        scenes_of("extrem")
