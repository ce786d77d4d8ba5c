"""The example that learns from generated episodes: it learns, and the judge sees what is wrong with a motion."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from comove.data import Study, on_processes, run_study
from comove.data.datasets import FORMATS, export_episodes
from comove.errors import DemonstrationError, ResultError
from comove.verification.record import RecordSamples, verify_execution

pytest.importorskip("torch", reason="torch is not installed: pip install 'comove[learn]'")
pytestmark = pytest.mark.slow

FOLDER = Path(__file__).parents[1] / "examples" / "learning"
POSTS = FOLDER.parent / "studies" / "planar.yaml"
N_EPISODES, N_SCENES, FIRST = 8, 6, 5_000_000


@pytest.fixture(scope="module")
def learn():
    """The example as a module."""
    found = importlib.util.spec_from_file_location("learn_example", FOLDER / "learn.py")
    module = importlib.util.module_from_spec(found)
    sys.modules["learn_example"] = module  # dataclasses look their module up
    found.loader.exec_module(module)
    yield module
    del sys.modules["learn_example"]


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A study of few episodes, and the folder that holds them."""
    folder = tmp_path_factory.mktemp("learning")
    text = (FOLDER / "gate.yaml").read_text(encoding="utf-8")
    assert "episodes: 1000\n" in text
    (folder / "gate.yaml").write_text(text.replace("episodes: 1000\n", f"episodes: {N_EPISODES}\n"))
    loaded = Study.load(folder / "gate.yaml")
    run_study(loaded, folder / "out", on_processes(1))
    export_episodes(folder / "out", loaded.folder, FORMATS["npz"], 20)
    return loaded, folder / "out"


@pytest.fixture(scope="module")
def policies(learn, study):
    """A policy that has learned hardly anything, and one that has learned for a while."""
    episodes = learn.Episodes.read(study[1], N_EPISODES)
    return episodes, *(learn.trained(episodes, learn.Settings(width=64, steps=steps)) for steps in (1, 1500))


def test_a_policy_that_has_learned_comes_nearer(learn, study, policies):
    """In scenes that no episode has, free and on the load; and on the load no output can pull at it."""
    episodes, before, after = policies
    scenes = learn.unseen(study[0], FIRST, N_SCENES)
    for held in (False, True):
        missed = []
        for policy in (before, after):
            records = learn.carried(policy, scenes, episodes.time, held=held)
            reports = [verify_execution(record) for record in records]
            missed.append(np.median([report.end_error for report in reports]))
            if held:
                assert max(report.distance_error_max for report in reports) < 1e-9
        assert missed[1] < 0.25 * missed[0]
    free = [verify_execution(r) for r in learn.carried(before, scenes, episodes.time, held=False)]
    assert min(report.distance_error_max for report in free) > 1e-6


def test_the_judge_sees_planted_failures(learn, study, policies):
    """An episode carries; one whose end, distance or way is spoilt fails in that alone."""
    episodes, tolerances = policies[0], learn.Tolerances()
    scene = study[0].draw(0).scene
    hands = episodes.hands[0]
    middle = len(hands) // 2

    def met(spoilt):
        return tolerances.met(verify_execution(RecordSamples(scene, episodes.time, spoilt)))

    assert met(hands) == (True, True, True)
    short = hands.copy()
    short[-1] -= [0.02, 0.0]  # both hands
    assert met(short) == (False, True, True)
    pulled = hands.copy()
    along = (pulled[-9, 1] - pulled[-9, 0]) / 0.3
    pulled[-9, 1] += 0.02 * along  # beyond the gate
    assert met(pulled) == (True, True, False)
    hit = hands.copy()
    hit[middle] += [0.0, 0.2]  # into the upper part of the gate
    assert met(hit) == (True, False, True)


def test_the_command_prints_a_table_and_draws(learn, study, tmp_path, monkeypatch, capsys):
    picture = tmp_path / "learned.png"
    monkeypatch.setattr(
        sys,
        "argv",
        ["learn.py", str(study[1]), "--study", str(study[0].path), "--numbers", "2", str(N_EPISODES)]
        + ["--scenes", "4", "--first", str(FIRST), "--steps", "20", "--out", str(picture)],
    )
    learn.main()
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    assert len(rows) == 2 + 4 and all(row.count("|") == rows[0].count("|") for row in rows)
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        (["--numbers", "9"], r"has 8 episodes as NPZ, and 9 are asked for; run: comove generate"),
        (["--numbers", "0"], "nothing to learn"),
        (["--scenes", "2"], "give numbers above 0, and 4 scenes or more"),
        (["--first", "7"], "scene 7 is among the 8 episodes of the study; give 8 or more"),
        (["--study", str(POSTS)], "are not those of .*; name the study that made them"),
        (["--study", "nowhere.yaml"], "nowhere.yaml: there is no such file"),
        (["--out", "nowhere/learned.png"], "nowhere"),
    ],
)
def test_wrong_options_are_told_in_one_sentence(learn, study, monkeypatch, tmp_path, changes, says):
    monkeypatch.chdir(tmp_path)
    words = [str(study[1]), "--study", str(study[0].path), "--numbers", "2", "--scenes", "4", "--steps", "2"]
    monkeypatch.setattr(sys, "argv", ["learn.py", *words, *changes])
    with pytest.raises(SystemExit, match=says) as told:
        learn.main()
    assert str(told.value).startswith("error: ") and "\n" not in str(told.value)


def test_files_that_are_no_episodes_are_told(learn, study, tmp_path):
    folder = tmp_path / "npz"
    folder.mkdir()
    whole = (study[1] / "npz/episode_000000.npz").read_bytes()
    for content in (b"", b"no archive", whole[: len(whole) // 2]):
        (folder / "episode_000000.npz").write_bytes(content)
        with pytest.raises(DemonstrationError, match=r"episode_000000.npz: "):
            learn.Episodes.read(tmp_path, 1)
    (folder / "episode_000000.npz").write_bytes(whole)
    with np.load(folder / "episode_000000.npz") as archive:
        shorter = {
            name: archive[name][:-1] if name in ("time", "position") else archive[name] for name in archive
        }
    np.savez(folder / "episode_000001.npz", **shorter)
    with pytest.raises(ResultError, match="other numbers of samples, hands or obstacles"):
        learn.Episodes.read(tmp_path, 2)
