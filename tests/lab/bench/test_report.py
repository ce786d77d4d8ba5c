"""The numbers of a report, from a store made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from comove.errors import ResultError
from comove.lab.bench.report import CONTENTS, missing_of, paired_ratio, standings, write_report
from comove.lab.bench.store import Configuration, Figures, Machine, Run, RunStore

MACHINE = Machine("a processor", 4, "3.11.0")


def a_run(system, scene, history=(), seed=0, status=None, message="", **figures):
    """One that ends as its history does."""
    status = status or ("verified" if history else "not verified")
    cost = history[-1][1] if history else None
    measured = Figures(seconds=1.0, first_verified=history[0][0] if history else None, cost=cost, **figures)
    what = Configuration("easy", scene, "ab", system, seed, 10.0, "0.1.0")
    return Run(what, status, message, "2025-01-01T00:00:00", MACHINE, measured, tuple(history))


RUNS = [
    a_run("comove", "one", [(0.01, 0.5), (0.5, 0.21), (1.0, 0.2)], path_length=1.0, clearance_min=0.004),
    a_run("comove", "two", [(0.03, 0.4)], path_length=3.0, clearance_min=0.002),
    a_run("comove", "three", message="a hand reaches 0.01 m into obstacles[0]"),
    a_run("other", "one", [(0.1, 0.6)], path_length=2.0),
    a_run("other", "two", [(0.6, 0.2)], path_length=2.0),
    a_run("other", "three", [(2.0, 1.0)], path_length=2.0),
    a_run("shy", "one", status="refused", message="it is in space"),
]


@pytest.fixture
def store(tmp_path):
    store = RunStore.create(tmp_path / "runs.sqlite")
    with store.writer() as writer:
        for run in RUNS:
            writer.add(run)
    return store


def test_standings():
    comove, other, shy = standings(RUNS)
    assert (comove.n_verified, len(comove.runs), comove.refused) == (2, 3, 0)
    assert comove.best == {"one": 0.2, "two": 0.2, "three": 1.0}
    assert comove.by_scene(comove.first) == {"one": 0.01, "two": 0.03, "three": np.inf}
    assert comove.by_scene(comove.near_best) == {"one": 0.5, "two": np.inf, "three": np.inf}
    assert comove.by_scene(comove.cost_ratio) == {"one": 1.0, "two": 2.0, "three": np.inf}
    assert comove.median_of("path_length") == 2.0
    assert comove.success.value == pytest.approx(2 / 3)
    assert comove.success.low == pytest.approx(0.2077, abs=1e-4)  # Wilson
    assert other.by_scene(other.near_best) == {"one": np.inf, "two": 0.6, "three": 2.0}
    assert (shy.runs, shy.refused) == ((), 1)


def test_pairs_are_scenes_that_both_solve():
    comove, other, _ = standings(RUNS)
    ratio, n = paired_ratio(other.by_scene(other.first), comove.by_scene(comove.first))
    assert n == 2
    assert ratio.value == pytest.approx(15.0)  # of 10 and 20
    assert np.isnan(paired_ratio({"one": np.inf}, {"one": 1.0})[0].value)


def test_several_seeds_are_no_further_scenes():
    more = [replace(r, configuration=replace(r.configuration, seed=s)) for r in RUNS[:3] for s in range(4)]
    (comove,) = standings(more)
    assert comove.success.value == pytest.approx(2 / 3)
    assert (comove.success.low, comove.success.high) == (0.0, 1.0)  # three scenes say little
    assert len(comove.by_scene(comove.first)) == 3


def test_budgets_and_versions_are_kept_apart():
    slow = replace(RUNS[0], configuration=replace(RUNS[0].configuration, budget=60.0))
    assert [s.system for s in standings([*RUNS[:1], slow])] == ["comove, 10 s", "comove, 60 s"]
    new = replace(RUNS[0], configuration=replace(RUNS[0].configuration, version="0.2.0"))
    assert [s.system for s in standings([*RUNS[:1], new])] == ["comove, comove 0.1.0", "comove, comove 0.2.0"]


def test_the_report(store, tmp_path):
    text = write_report(store, tmp_path / "report")
    assert sorted(p.name for p in (tmp_path / "report").iterdir()) == sorted(CONTENTS.names)
    assert (tmp_path / "report" / "report.md").read_text(encoding="utf-8") == text
    assert "| comove | 2/3 | 67 % (21-94) | - | 0.03 (0.01-never) | never (0.5-never) | 1.5 (1-2) |" in text
    assert "| other | 3/3 | 100 % (44-100) | - | 0.6 (0.1-2) | 2 (0.6-never) | 1 (1-3) |" in text
    assert "| shy | 0/0 | - | 1 | - | - | - |" in text
    assert "| other | 15 (10-20), 2 scenes | 1.75 (0.5-3), 2 scenes | 1 | 0 |" in text
    assert "- comove, three, seed 0: not verified: a hand reaches" in text
    assert "Incomplete" not in text
    assert write_report(store, tmp_path / "report") == text  # over the old one


def test_what_is_missing_is_named(store):
    planned = [RUNS[0].configuration, *(replace(RUNS[0].configuration, scene=s) for s in ("four", "five"))]
    with store.writer() as writer:
        writer.plan(planned)
    (line,) = missing_of(store, store.runs())
    assert line == "2 of 3 runs of comove on easy (the next: four, seed 0, 10 s)"


def test_nothing_to_report(tmp_path):
    store = RunStore.create(tmp_path / "runs.sqlite")
    with pytest.raises(ResultError, match="no run has ended yet"):
        write_report(store, tmp_path / "report")
    assert not (tmp_path / "report").exists()
