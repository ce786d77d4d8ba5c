"""`comove generate` and `comove sweep`: the same rows however they are run, and one sentence for bad input."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

import comove
from comove.data import Study, StudyStore
from comove.data.episode import restored
from comove.data.runs import RUNS
from tests.commands import invoke
from tests.data.test_runner import rows

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples" / "studies"


def refused(outcome, *words):
    """One sentence on stderr, nothing else."""
    assert outcome.exit_code == 2, outcome.output
    assert outcome.stdout == ""
    assert outcome.stderr.startswith("error: ")
    for word in words:
        assert word in outcome.stderr


def study(folder, **changes):
    """The example with few episodes."""
    contents = yaml.safe_load((EXAMPLES / "planar.yaml").read_text()) | {"formats": [], "seed": 0}
    shutil.copy(EXAMPLES / "posts.yaml", folder)
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(contents | {"episodes": 4} | changes))
    return path


@pytest.mark.slow
def test_workers_and_parts_give_the_same_rows_bit_by_bit(tmp_path):
    """One process, two processes, and three parts by the script and the command of the guide for clusters."""
    file = study(tmp_path)
    for workers in (1, 2):
        outcome = invoke("generate", file, "--out", tmp_path / f"{workers}", "--workers", workers)
        assert outcome.exit_code == 0, outcome.output
    guide = (ROOT / "docs/guides/cluster.md").read_text(encoding="utf-8")
    script, merge = re.findall(r"^```bash\n(.*?)^```", guide, re.MULTILINE | re.DOTALL)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    for job, words in ((1, script), (2, script), (3, script), (0, merge)):
        environment = {**os.environ, "PATH": path, "SLURM_ARRAY_TASK_ID": str(job)}
        done = subprocess.run(
            ["bash", "-c", words], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=600
        )
        assert done.returncode == 0, done.stderr
    assert "holds 4 of 4 runs" in done.stdout
    first = rows(tmp_path / "1")
    assert len(first[1]) == 4
    assert first == rows(tmp_path / "2") == rows(tmp_path / "whole")
    again = invoke("generate", file, "--out", tmp_path / "whole", "--json")
    assert "4 of 4 runs were in" in again.stderr
    report = json.loads(again.stdout)
    assert report["statuses"] == {"verified": 4} and report["verified_share"] == 1.0
    assert report["variety"]["paths"] > 0.01


@pytest.mark.slow
def test_episodes_are_what_the_study_draws_and_solve_finds(tmp_path):
    """A row's motion is verified on its scene, and is the one that `solve` finds for it."""
    file = study(tmp_path, episodes=1)
    outcome = invoke("generate", file, "--out", tmp_path / "out", "--workers", 1)
    assert outcome.exit_code == 0 and "episodes.png" in outcome.stdout
    assert (tmp_path / "out/episodes.png").read_bytes().startswith(b"\x89PNG")
    loaded, store = Study.load(file), StudyStore.open(tmp_path / "out" / RUNS)
    ((run, kept),) = store.motions()
    drawn = loaded.draw(0)
    assert (run.seed, run.scene_sha256) == (drawn.seed, drawn.scene.sha256)
    motion = restored(kept, loaded.folder, store.path)
    verdict = comove.verify(motion)
    assert verdict.verified is not None
    assert verdict.report.clearance_min == run.clearance_min
    alone = comove.solve(
        drawn.scene, demonstration=comove.model.demonstration_of(drawn.scene), seed=drawn.seed
    )
    assert (alone.attempt.weights == motion.weights).all()
    assert alone.cost.total == run.cost


@pytest.mark.slow
def test_episodes_that_are_not_verified_are_kept_apart_with_their_reason(tmp_path):
    """Too fast for any motion: nothing is verified, and every row says why."""
    draws = [{"key": "duration", "choice": [0.2]}]
    outcome = invoke("generate", study(tmp_path, draws=draws, episodes=2), "--out", tmp_path / "out")
    assert outcome.exit_code == 1, outcome.output
    assert "2 of 2 episodes: 2 not verified" in outcome.stdout
    runs, motions = rows(tmp_path / "out")
    assert motions == [] and all("0.2 s are too short for the limits" in run.reason for run in runs)


@pytest.mark.slow
def test_a_sweep_compares(tmp_path):
    for name in ("posts.yaml", "resemblance.yaml"):
        shutil.copy(EXAMPLES / name, tmp_path)
    outcome = invoke("sweep", tmp_path / "resemblance.yaml", "--out", tmp_path / "out")
    assert outcome.exit_code == 0, outcome.output
    assert "8 of 8 runs: 8 verified" in outcome.stdout
    assert "objective.resemblance 0.9, duration 4" in outcome.stdout
    runs, _ = rows(tmp_path / "out")
    near = {s: [r.followed for r in runs if f": {s}," in r.settings] for s in ("0.3", "0.9")}
    assert max(near["0.9"]) < min(near["0.3"])  # more resemblance is nearer to the demonstration


@pytest.mark.slow
def test_ctrl_c_leaves_a_store_that_goes_on(tmp_path):
    file, out = study(tmp_path, episodes=200), tmp_path / "out"
    command = [sys.executable, "-m", "comove", "generate", str(file), "--out", str(out)]
    running = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    end = time.monotonic() + 600.0
    while not ((out / RUNS).exists() and _count(out)) and time.monotonic() < end:
        time.sleep(0.1)
    running.send_signal(signal.SIGINT)
    _, err = running.communicate(timeout=600)
    assert running.returncode == 130
    assert "of 200 runs are in" in err and "the same command goes on" in err and "Traceback" not in err
    done = _count(out)
    assert 0 < done < 200
    file = study(tmp_path, episodes=done + 1)
    outcome = invoke("generate", file, "--out", out)
    assert f"{done} of {done + 1} runs were in" in outcome.stderr


def _count(out):
    try:
        return len(StudyStore.open(out / RUNS).keys())
    except comove.errors.ResultError:  # it is just being made
        return 0


def test_bad_input_is_one_sentence(tmp_path):
    file, out = study(tmp_path), tmp_path / "out"
    refused(invoke("generate", tmp_path / "none.yaml", "--out", out), "there is no such file")
    refused(
        invoke("generate", EXAMPLES / "posts.yaml", "--out", out), "it is a scene, not a study", "episodes"
    )
    refused(invoke("generate", file, "--out", out, "--workers", 0), "--workers")
    refused(invoke("generate", file, "--out", out, "--shard", "3/2"), "--shard", "i from 1 to n")
    refused(invoke("sweep", file, "--out", out), "unknown key", "scene")
    refused(invoke("sweep", "merge", tmp_path / "none", "--out", out), "no such file", "comove generate")
    blocked = study(tmp_path, draws=[{"key": "obstacles.0.center", "choice": [[0.15, 0.5]]}])
    outcome = invoke("generate", blocked, "--out", out)
    refused(outcome, "none of 400 draws gives a valid scene", "at the start", "narrow the distributions")
    assert not out.exists()


@pytest.mark.slow
def test_an_edited_study_is_refused(tmp_path):
    out = tmp_path / "out"
    draws = [{"key": "duration", "choice": [0.2]}]
    invoke("generate", study(tmp_path, draws=draws, episodes=1), "--out", out)
    edited = study(tmp_path, draws=draws, episodes=1, seed=5)
    outcome = invoke("generate", edited, "--out", out)
    assert outcome.exit_code == 2
    assert "edited since: seed was 0 and is 5; give the study its former values back" in outcome.stderr
