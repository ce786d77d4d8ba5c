"""The page of made-up runs, and a small reproduction from end to end."""

import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from comove.dmp import DMP
from comove.errors import ResultError
from comove.io.folders import check_target
from comove.lab.examples import copy_examples, example
from comove.lab.paper.claims import ClaimVerdict, judge_all
from comove.lab.paper.figures import BAXTER, FAILED, FIGURES, shown_failures, story_panels, verdict
from comove.lab.paper.jobs import CONTENDERS, run, scene_of
from comove.lab.paper.measures import measure_motion
from comove.lab.paper.page import CONTENTS, Effort, _by_hand, write_page
from comove.lab.paper.runs import (
    SCENES,
    STORY,
    Job,
    ReproductionPlan,
    all_jobs,
    recorded,
)
from comove.lab.paper.tables import all_runs
from comove.model.motion import CoordinatedMotion
from tests.commands import invoke
from tests.lab.paper.ideal import GOOD, MOVEMENTS, changed, ideal_runs


@pytest.fixture(scope="module")
def page():
    runs = ideal_runs()
    return write_page(runs, judge_all(runs), Effort(90.0, 150.0, 2), "paper")


def test_the_page_shows_every_figure_and_every_claim(page):
    assert re.findall(r"!\[.+?\]\(paper/(.+?)\)", page) == [*FIGURES[:6], *BAXTER.values(), *FIGURES[6:]]
    for claim, finding in judge_all(ideal_runs()):
        assert f"“{claim.quote}” | **{finding.verdict.value}**" in page
    assert "in 1.5 minutes" in " ".join(page.split())
    for heading in re.findall(r"\]\(#(.+?)\)", page):
        titles = [
            re.sub(r"[^\w -]", "", t.lower()).replace(" ", "-") for t in re.findall(r"^#+ (.+)$", page, re.M)
        ]
        assert heading in titles


def sections(runs):
    """The section on recordings in the page of some runs, in one line."""
    page = write_page(runs, judge_all(runs), Effort(90.0, 150.0, 2), "paper")
    return page.split("## Any recording")[1].split("## Sensitivity")[0]


def test_failures_are_told_and_drawn_and_where_there_are_none_nothing_is():
    runs, asked = ideal_runs(seeds=20), {"scene": "complex", "movement": "Angle"}
    none = sections(runs)
    for scene, name in FAILED.items():
        assert f"On `{scene}` none of" in " ".join(none.split()) and name not in none
    wrong = (
        "the distance between 'left' and 'right' is off by up to 0.005 m (tolerance 0.0002 m)",
        "a hand moves at up to 2 m/s (limit 1 m/s)",
    )
    failed = changed(runs, "recordings", asked, verified=False, distance_error=0.005, reasons=wrong)
    straight = CoordinatedMotion.straight(example("complex"))
    failed = replace(
        failed,
        outcomes=tuple(o if o.measures.verified else replace(o, motion=straight) for o in failed.outcomes),
    )
    section = sections(failed)
    assert "On `complex` 2 of 20 failed:" in section and "On `wide` none of 20 failed" in section
    told = "a distance is off by up to 0.005 m; a hand moves at up to 2 m/s (limit 1 m/s)"
    assert f"| Angle | 0 | {told} |" in section and f"| Angle | 1 | {told} |" in section
    assert "| all | 20 of 20 | 20 of 20 | 18 of 20 | 10 of 10 |" in section
    assert f"](paper/{FAILED['complex']})" in section and FAILED["wide"] not in section
    assert [o.job.seed for o in shown_failures(failed, "complex")] == [0], "the first of each recording"


def test_the_border_of_the_workspace_is_no_wall():
    assert verdict(measure_motion(CoordinatedMotion.straight(example("narrow")))) == "50 mm into a wall"
    inside = CoordinatedMotion.straight(scene_of("open"))
    boundary = inside.boundary.copy()
    boundary[[0, 2], 1] += 0.43  # the upper hand, which was at 0.6 m of 1 m
    beyond = replace(inside, boundary=boundary)
    assert verdict(measure_motion(beyond)).startswith("30 mm beyond the border of the workspace")
    assert "0.2 mm into a wall" in verdict(replace(GOOD, verified=False, clearance=-0.0002))


@pytest.mark.slow
def test_what_is_typed_gives_the_motions_of_the_figures(tmp_path):
    copy_examples(tmp_path)
    done = subprocess.run(
        ["bash", "-c", _by_hand(ReproductionPlan(1).band)],
        cwd=tmp_path,
        env={**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        timeout=2400,
    )
    assert "error:" not in done.stderr
    found = {
        name: json.loads((tmp_path / name / "solution.json").read_text())["verified"]
        for name in ("initial", "winding", "figure4a", "figure4b", "figure6c", "taught", "figure6b")
    }
    assert found == dict.fromkeys(found, True) | {"figure6b": False}


def test_tables_have_as_many_cells_in_every_line(page):
    lines = page.splitlines()
    for line, above in zip(lines[1:], lines, strict=False):
        if line.startswith("|") and above.startswith("|"):
            assert line.count(" | ") == above.count(" | "), line


def test_prose_is_wrapped_and_numbers_are_numbers(page):
    for line in page.splitlines():
        assert len(line) <= 118 or line.startswith(("|", "!"))
        assert "nan" not in line.lower().split()
    assert "{" not in page.replace(_by_hand(ReproductionPlan(1).band), "").replace(
        "`{lasa: LShape, plane: xy}`", ""
    ).replace("`demonstration: {lasa: LShape}`", "")


def test_every_run_is_a_line_of_the_table():
    runs = ideal_runs()
    head, *lines = all_runs(runs).splitlines()
    assert len(lines) == len(runs.outcomes)
    assert head.startswith("purpose,scene,who,movement,seed") and "clearance" in head


def test_panels_are_methods_by_scenes():
    for panel in story_panels(ideal_runs()):
        assert panel.value.shape == panel.low.shape == panel.high.shape == (len(CONTENDERS), len(SCENES))


def test_those_without_random_numbers_run_once():
    jobs = [
        job
        for job in all_jobs(ReproductionPlan(7), MOVEMENTS)
        if job.purpose == "story" and job.scene == "wide"
    ]
    for who, contender in CONTENDERS.items():
        assert [job.seed for job in jobs if job.who == who] == list(range(7 if contender.random else 1))
    assert len(set(jobs)) == len(jobs)


@pytest.mark.parametrize(
    "who", ["leader-follower [7]", pytest.param("task-priority [5]", marks=pytest.mark.slow)]
)
def test_they_draw_none_indeed(who):
    taught = DMP.fit(recorded(STORY["narrow"]))
    assert not CONTENDERS[who].random
    first, second = (
        run(Job("story", "narrow", who, STORY["narrow"], taught, seed=seed)).measures for seed in (0, 1)
    )
    assert (first.cost, first.distance_error, first.clearance) == (
        second.cost,
        second.distance_error,
        second.clearance,
    )


def reproduce(*words):
    return invoke("reproduce", *words)


def test_bad_input_is_told_in_one_sentence_and_nothing_is_written(tmp_path):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").write_text("mine")
    for words, said in (
        (("--seeds", 0, "--out", tmp_path / "new"), "seeds"),
        (("--seeds", 1, "--processes", 0, "--out", tmp_path / "new"), "processes"),
        (("--seeds", 1, "--out", tmp_path / "file"), "it is a file"),
        (("--seeds", 1, "--out", tmp_path / "other"), "holds no reproduction"),
    ):
        result = reproduce(*words)
        assert result.exit_code == 2, result.output
        assert said in result.stderr and len(result.stderr.strip().splitlines()) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"file", "other"}


def test_only_a_reproduction_is_replaced(tmp_path):
    (tmp_path / "paper").mkdir()
    (tmp_path / "paper.md").write_text("an earlier one")
    (tmp_path / "paper" / "story.png").write_text("")
    check_target(tmp_path, CONTENTS)
    (tmp_path / "paper" / "mine.txt").write_text("mine")
    with pytest.raises(ResultError, match=r"besides a reproduction the folder holds 'paper/mine.txt'"):
        check_target(tmp_path, CONTENTS)


@pytest.mark.slow
def test_ctrl_c_ends_it_at_once_and_leaves_nothing(tmp_path):
    command = [sys.executable, "-m", "comove", "reproduce", "--seeds", "1", "--out", str(tmp_path / "out")]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    for line in process.stderr:
        if "at once" in line:
            break
    process.send_signal(signal.SIGINT)  # to the parent alone: it ends the others
    assert process.wait(timeout=600) == 130
    assert "interrupted" in process.stderr.read()
    assert not list(tmp_path.iterdir())


SMALL = "comove reproduce --seeds 2 --out look"
"""A reproduction as the paper's page tells it."""


@pytest.mark.release
def test_a_small_reproduction(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result, small = invoke(*SMALL.split()[1:]), tmp_path / "look"
    assert result.exit_code == 0, result.output
    files = {p.relative_to(small).as_posix() for p in small.rglob("*.*")}
    assert files | {f"paper/{name}" for name in FAILED.values()} == CONTENTS.names
    page = (small / "paper.md").read_text(encoding="utf-8")
    for target in re.findall(r"\]\((paper/.+?)\)", page):
        assert 0 < (small / target).stat().st_size < 300_000
    assert sum(page.count(f"**{verdict.value}**") for verdict in ClaimVerdict) >= 20
    assert page.count("verified") > 20
