"""`comove explain`, and the messages that name it."""

from __future__ import annotations

import inspect
import subprocess
import sys

from comove import errors


def run(*arguments):
    return subprocess.run([sys.executable, "-m", "comove", *arguments], capture_output=True, text=True)


def test_a_message_names_the_command_that_explains_it(tmp_path):
    outcome = run("solve", str(tmp_path / "none.yaml"), "--out", str(tmp_path / "out"))
    (line,) = outcome.stderr.splitlines()
    assert outcome.returncode == 2 and line.endswith(" (comove explain SceneError)")
    command = line.rpartition("(comove ")[2].rstrip(")").split()
    explained = run(*command)
    assert explained.returncode == 0 and inspect.getdoc(errors.SceneError) in explained.stdout


def test_a_message_that_says_all_names_nothing(tmp_path):
    outcome = run("demo", "--out", str(tmp_path / "out"), "--seed", "one")
    assert outcome.returncode == 2 and "explain" not in outcome.stderr
    outcome = run("explain", "SceneEror")
    assert outcome.returncode == 2 and "did you mean 'SceneError'?" in outcome.stderr
    assert "(comove explain" not in outcome.stderr


def test_the_list_names_every_error_with_its_first_sentence():
    lines = run("explain").stdout.splitlines()
    assert [line.split()[0] for line in lines] == list(errors.kinds())
    for line, kind in zip(lines, errors.kinds().values(), strict=True):
        assert line.endswith(inspect.getdoc(kind).splitlines()[0])
