"""Studies: what is drawn lies where the file says, depends on seed and number alone, and errors are one sentence."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy import stats
from scipy.spatial.transform import Rotation

from comove.data import Study, Sweep
from comove.data.distributions import OneOf, TruncatedNormal, Uniform
from comove.data.keys import change, fit_hands
from comove.data.runs import differences
from comove.dmp import DMP, Library, Primitive
from comove.dmp.demonstrations import Demonstration
from comove.errors import OptionError, SceneError
from comove.model import recording_of

EXAMPLES = Path(__file__).parents[2] / "examples" / "studies"
SCENE = {
    "name": "free",
    "duration": 5.0,
    "workspace": {"lower": [0.0, 0.0], "upper": [2.0, 1.0]},
    "obstacles": [{"shape": "circle", "center": [1.0, 0.5], "radius": 0.1}],
    "load": {"shape": "bar", "length": 0.2},
    "manipulators": [
        {"name": "left", "start": [0.3, 0.4], "goal": [1.7, 0.4]},
        {"name": "right", "start": [0.3, 0.6], "goal": [1.7, 0.6]},
    ],
}


def written(folder, **changes):
    """A study file."""
    contents = {"name": "mine", "scene": SCENE, "draws": [], "episodes": 4} | changes
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(contents))
    return path


def draw_of(folder, draw, number=0, **changes):
    """The contents of a scene with a single draw."""
    study = Study.load(written(folder, draws=[draw], **changes))
    return study.contents(number, np.random.default_rng(study.seed_of(number)))


def test_the_distributions_are_those_that_their_names_say():
    """Kolmogorov and Smirnov's test against scipy's distributions."""
    rng = np.random.default_rng(0)
    uniform = Uniform(np.array([-1.0, 2.0]), np.array([3.0, 2.5]))
    values = np.array([uniform.draw(rng) for _ in range(2000)])
    for column, low, high in zip(values.T, uniform.lower, uniform.upper, strict=True):
        assert stats.kstest(column, stats.uniform(low, high - low).cdf).pvalue > 0.01
    normal = TruncatedNormal(*map(np.array, (1.0, 2.0, 0.0, 6.0)))
    values = np.array([normal.draw(rng) for _ in range(2000)])
    assert stats.kstest(values, stats.truncnorm(-0.5, 2.5, 1.0, 2.0).cdf).pvalue > 0.01
    assert values.min() >= 0.0 and values.max() <= 6.0
    chosen = [OneOf(("a", "b", "c")).draw(rng) for _ in range(3000)]
    assert stats.chisquare([chosen.count(c) for c in "abc"]).pvalue > 0.01


def test_an_episode_depends_on_seed_and_number_alone(tmp_path):
    def scenes(numbers, **changes):
        study = Study.load(
            written(tmp_path, draws=[{"key": "start", "uniform": [[-0.1, -0.2], [0.1, 0.2]]}], **changes)
        )
        return {n: tuple(study.draw(n).scene.start.ravel()) for n in numbers}

    all_of_them = scenes(range(4))
    assert len(set(all_of_them.values())) == 4
    assert scenes([2, 0], episodes=1000) == {n: all_of_them[n] for n in (2, 0)}
    assert not set(scenes(range(4), seed=1).values()) & set(all_of_them.values())


def test_a_seed_that_is_asked_for_is_that_of_an_edited_file(tmp_path):
    asked, edited = Study.load(written(tmp_path), seed=7), Study.load(written(tmp_path, seed=7))
    assert asked.sha256 == edited.sha256 != Study.load(written(tmp_path)).sha256
    with pytest.raises(OptionError, match=r"--seed: seed = -1; give 0 or more"):
        Study.load(written(tmp_path), seed=-1)


def test_hands_are_shifted_and_turned_as_one(tmp_path):
    data = draw_of(tmp_path, {"key": "start.turn_deg", "uniform": [90, 90]})
    assert np.allclose([m["start"] for m in data["manipulators"]], [[0.4, 0.5], [0.2, 0.5]])
    data = draw_of(tmp_path, {"key": "goal", "uniform": [[-0.1, 0.2], [-0.1, 0.2]]})
    assert np.allclose([m["goal"] for m in data["manipulators"]], [[1.6, 0.6], [1.6, 0.8]])
    assert [m["start"] for m in data["manipulators"]] == [m["start"] for m in SCENE["manipulators"]]


def test_hands_stay_at_the_ends_of_a_bar(tmp_path):
    draws = [{"key": "load.length", "uniform": [0.1, 0.3]}, {"key": "goal.turn_deg", "uniform": [-90, 90]}]
    study = Study.load(written(tmp_path, draws=draws))
    for number in range(4):
        data = study.contents(number, np.random.default_rng(number))
        hands, length = data["manipulators"], data["load"]["length"]
        for end in ("start", "goal"):
            assert math.dist(hands[0][end], hands[1][end]) == pytest.approx(length, abs=1e-12)
            center = np.mean([SCENE["manipulators"][i][end] for i in (0, 1)], axis=0)
            assert np.allclose(np.mean([hand[end] for hand in hands], axis=0), center)
        assert study.draw(number).scene is not None


@pytest.mark.parametrize("key", ["rpy_deg", "quaternion_wxyz", "angle_deg", None])
def test_poses_of_a_payload_are_shifted_and_turned_about_the_vertical(key):
    """As scipy turns them; without an orientation, from the world's axes."""
    n, turn = 2 if key == "angle_deg" else 3, Rotation.from_euler("xyz", [10, 20, 30], degrees=True)
    said = {"rpy_deg": [10, 20, 30], "quaternion_wxyz": turn.as_quat(scalar_first=True).tolist()}
    pose = {"position": [0.1, 0.2, 0.3][:n]} | ({} if key is None else {key: said.get(key, 30.0)})
    data = {"version": 2, "payload": {"goal": pose}}
    change(data, "goal", [0.5, 0.0, 0.1][:n])
    change(data, "goal.turn_deg", 40)
    assert pose["position"] == pytest.approx([0.6, 0.2, 0.4][:n])
    if n == 2:
        assert pose["angle_deg"] == 70
        return
    found = (
        Rotation.from_quat(pose[key], scalar_first=True)
        if key == "quaternion_wxyz"
        else Rotation.from_euler("xyz", pose["rpy_deg"], degrees=True)
    )
    before = turn if key else Rotation.identity()
    wanted = Rotation.from_euler("z", 40, degrees=True) * before
    assert found.as_matrix() == pytest.approx(wanted.as_matrix(), abs=1e-12)


def test_what_has_no_bar_is_left_alone():
    for scene in (
        {},
        {"load": None},
        {"load": {"shape": "box"}},
        SCENE | {"manipulators": [{"name": "a"}] * 2},
    ):
        before = yaml.safe_dump(scene)
        fit_hands(scene)
        assert yaml.safe_dump(scene) == before


def test_keys_name_entries_by_number_and_hands_by_name(tmp_path):
    data = draw_of(
        tmp_path,
        {"key": ["obstacles.0.center.1", "manipulators.left.goal.0"], "uniform": [0.1, 0.1], "add": True},
    )
    assert data["obstacles"][0]["center"] == [1.0, pytest.approx(0.6)]
    assert data["manipulators"][0]["goal"] == [pytest.approx(1.8), 0.4]
    assert draw_of(tmp_path, {"key": "limits.speed", "choice": [0.7]})["limits"] == {"speed": 0.7}
    data = {"limits": None}
    change(data, "limits.jerk", 3.0)
    assert data == {"limits": {"jerk": 3.0}}


def test_rejected_draws_are_drawn_again_and_counted(tmp_path):
    """Half of the heights put the obstacle onto the start; each rejected draw is followed by another."""
    draw = {"key": "obstacles.0.center", "choice": [[0.3, 0.5], [1.0, 0.5]]}
    study = Study.load(written(tmp_path, draws=[draw], episodes=200))
    drawn = [study.draw(n) for n in range(200)]
    assert all(one.scene.file.obstacles[0].center == (1.0, 0.5) for one in drawn)
    rejected = sum(one.rejected for one in drawn)
    assert stats.binomtest(rejected, 200 + rejected, 0.5).pvalue > 0.01
    assert "at the start" in next(one.reason for one in drawn if one.rejected)
    probe = study.probe()
    assert (probe.valid, probe.rejected) == (50, sum(one.rejected for one in drawn[:50]))
    assert 0.3 < probe.share < 0.7


def test_distributions_without_a_valid_scene_are_refused_before_the_first_run(tmp_path):
    study = Study.load(written(tmp_path, draws=[{"key": "obstacles.0.center", "choice": [[0.3, 0.5]]}]))
    assert study.draw(0).scene is None
    with pytest.raises(SceneError, match=r"none of 400 draws gives a valid scene, the last because: .*start"):
        study.probe()


def test_demonstrations_are_drawn_from_libraries(tmp_path):
    library = Library(tmp_path / "movements")
    way = np.linspace(0.0, 1.0, 50)
    for name, end in (("up", 1.0), ("down", -1.0)):
        position = np.column_stack([way, end * way**2])
        library.add(Primitive(name, DMP.fit(Demonstration(way, position)), unit="m"))
    draw = {"key": "demonstration", "library": "movements"}
    study = Study.load(written(tmp_path, draws=[draw], episodes=20))
    names = {study.draw(n).scene.file.demonstration.library for n in range(20)}
    assert names == {"movements/up", "movements/down"}
    assert set(study.described["demonstrations"]) == {"movements/up.dmp.json", "movements/down.dmp.json"}
    before = study.described
    library.path("up").write_bytes(library.path("down").read_bytes())
    (told,) = differences(before, Study.load(study.path).described)
    assert told.startswith("demonstrations.movements/up.dmp.json was")


def test_recordings_that_are_drawn_are_read_as_the_scene_says(tmp_path):
    """Keys of the scene's own demonstration hold for each of those that are drawn."""
    (tmp_path / "takes").mkdir()
    way = np.linspace(0.0, 1.0, 50)
    for name, end in (("up", 1.0), ("down", -1.0)):
        rows = "".join(f"{1e3 * x:.6g};{1e3 * y:.6g}\n" for x, y in zip(way, end * way**2, strict=True))
        (tmp_path / "takes" / f"{name}.csv").write_text("u;v\n" + rows)
    said = {"file": "takes/up.csv", "unit": "mm", "columns": ["u", "v"], "rate": 50}
    draw = {"key": "demonstration", "recordings": "takes"}
    study = Study.load(written(tmp_path, scene=SCENE | {"demonstration": said}, draws=[draw], episodes=20))
    scenes = [study.draw(n).scene for n in range(20)]
    assert {scene.file.demonstration.file for scene in scenes} == {"takes/up.csv", "takes/down.csv"}
    for scene in scenes[:4]:
        recording = recording_of(scene)
        sign = 1 if scene.file.demonstration.file.endswith("up.csv") else -1
        np.testing.assert_allclose(recording.goal, [1.0, sign], atol=1e-9)
        assert recording.duration == pytest.approx(49 / 50)


def test_edits_are_told_by_key(tmp_path):
    before = Study.load(written(tmp_path)).described
    assert differences(before, Study.load(written(tmp_path, episodes=9)).described) == []
    assert differences(before, Study.load(written(tmp_path, seed=3)).described) == ["seed was 0 and is 3"]
    other = SCENE | {"duration": 6.0}
    (told,) = differences(before, Study.load(written(tmp_path, scene=other)).described)
    assert told == "scene.duration was 5.0 and is 6.0"


GOOD = {"key": "start", "uniform": [[0, 0], [0, 0]]}
BAD = [
    ({"episode": 3}, "did you mean 'episodes'"),
    ({"episodes": 0}, "episodes .*out of range"),
    ({"version": 2}, "version.*2 is not known"),
    ({"scene": 3}, "scene.*3 is no scene"),
    ({"scene": "none.yaml"}, "none.yaml: there is no such file"),
    ({"draws": [{"key": "start"}]}, r"draws\[0\].*no distribution is given; give one of: uniform"),
    ({"draws": [GOOD | {"choice": [1]}]}, r"draws\[0\].*uniform and choice are both given"),
    ({"draws": [{"key": "duration", "normal": [5, 1]}]}, "normal is given without within"),
    ({"draws": [{"key": "duration", "normal": [5, 0], "within": [1, 2]}]}, "not positive"),
    ({"draws": [{"key": "duration", "uniform": [5, 1]}]}, "ends before it begins"),
    ({"draws": [{"key": "duration", "uniform": 5}]}, "5 is no pair"),
    ({"draws": [{"key": "duration", "uniform": ["a", 2]}]}, "no finite number"),
    ({"draws": [{"key": "start", "uniform": [[0], [0]]}]}, "cannot be added to"),
    ({"draws": [{"key": "start.turn_deg", "choice": ["x"]}]}, "'x' is no angle"),
    ({"draws": [{"key": "load.length.x", "choice": [1]}]}, "load.length is 0.2, which has no 'x'"),
    ({"draws": [{"key": "obstacles.3.center", "choice": [1]}]}, "obstacles has no entry '3'.*known: 0"),
    ({"draws": [{"key": "manipulators.lift.goal", "choice": [1]}]}, "did you mean 'left'"),
    ({"draws": [{"key": "limits.speed", "uniform": [1, 2], "add": True}]}, "no speed to add to"),
    ({"draws": [{"key": "duration", "choice": [1], "add": True}]}, "cannot be added"),
    ({"draws": [{"key": "duration", "library": "x"}]}, "write key: demonstration"),
    ({"draws": [{"key": "demonstration", "library": "x"}]}, "no primitive in x"),
    ({"draws": [{"key": "demonstration", "recordings": "x.csv"}]}, "recordings"),
    ({"draws": [{"key": "a..b", "choice": [1]}]}, "names no key"),
    ({"draws": [GOOD | {"unifrom": 3}]}, "did you mean 'uniform'"),
]


@pytest.mark.parametrize(("changes", "told"), BAD)
def test_errors_name_the_key_and_the_way_out(tmp_path, changes, told):
    path = written(tmp_path, **changes)
    with pytest.raises(SceneError, match=told) as caught:
        Study.load(path)
    assert "Traceback" not in str(caught.value) and str(tmp_path) in str(caught.value)


def test_the_examples_are_studies():
    assert Study.load(EXAMPLES / "planar.yaml").probe().share < 0.5
    sweep = Sweep.load(EXAMPLES / "resemblance.yaml")
    assert sweep.total == 8 and len({sweep.key(n) for n in range(8)}) == 8


def swept(folder, **changes):
    (folder / "free.yaml").write_text(yaml.safe_dump(SCENE))
    contents = {"name": "mine", "scenes": ["free.yaml"]} | changes
    path = folder / "sweep.yaml"
    path.write_text(yaml.safe_dump(contents))
    return path


def test_a_sweep_is_all_combinations_and_seeds_can_be_added(tmp_path):
    options = {"methods": ["comove", "paper"], "settings": {"duration": [4, 5, 6], "limits.speed": [1, 2]}}
    few, more = (Sweep.load(swept(tmp_path, seeds=n, **options)) for n in (2, 3))
    assert (few.total, more.total) == (24, 36)
    keys = [more.key(n) for n in range(36)]
    assert len(set(keys)) == 36 and keys[:24] == [few.key(n) for n in range(24)]
    assert few.described == more.described
    combinations = {(method, str(settings), seed) for _, method, settings, seed in map(more._at, range(36))}
    assert len(combinations) == 36


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"methods": ["comvoe"]}, "did you mean 'comove'"),
        ({"methods": ["paper", "paper"]}, "named twice"),
        ({"scenes": []}, "at least 1 scene"),
        ({"scenes": ["free.yaml", "free.yaml"]}, "two scenes are called 'free'"),
        ({"scenes": ["none.yaml"]}, "no such file"),
        ({"settings": {"load.length.x": [1]}}, "in the scene free: load.length is 0.2"),
        ({"settings": {"duration": [4, 4]}}, "given twice"),
        ({"settings": {"duration": []}}, "at least 1 value"),
        ({"seeds": 0}, "out of range"),
        ({"scene": "free.yaml"}, "did you mean 'scenes'"),
    ],
)
def test_errors_of_sweeps(tmp_path, changes, told):
    with pytest.raises(SceneError, match=told):
        Sweep.load(swept(tmp_path, **changes))


def test_a_study_says_how_hard_to_search(tmp_path):
    """Studies that say nothing keep their episodes: the description, of which keys are made, is the same."""
    text = (
        (EXAMPLES / "planar.yaml")
        .read_text(encoding="utf-8")
        .replace("posts.yaml", str(EXAMPLES / "posts.yaml"))
    )
    studies = {}
    for name, more in {
        "plain": "",
        "normal": "effort: normal\n",
        "quick": "effort: quick\ngain: 0.05\n",
    }.items():
        (tmp_path / name).write_text(text + more, encoding="utf-8")
        studies[name] = Study.load(tmp_path / name)
    assert studies["plain"].described == studies["normal"].described
    assert studies["quick"].described["effort"] == {"ways": 1, "gain": 0.05, "patience": 1}
    (tmp_path / "wrong").write_text(text + "effort: hard\n", encoding="utf-8")
    with pytest.raises(SceneError, match="quick"):
        Study.load(tmp_path / "wrong")
