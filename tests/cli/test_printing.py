"""What files that nobody vouches for hold does not command the terminal on which it is printed."""

import json
import os
import subprocess
import sys

import pytest

from comove.cli.streams import _Plain
from comove.cli.texts import as_table, in_rows, learned_text, say
from comove.dmp import learn
from comove.dmp.demonstrations import Demonstration
from comove.errors import letters, plain, printable
from comove.io.folders import whole_folder
from comove.results import RESULT
from comove.results.solution import SOLUTION
from comove.view.figures import save_result
from tests.commands import invoke
from tests.solved import solved

EVIL = "\x1b[2J\x1b]0;owned\x07\x9b31m\x7f\r\u202eevil"
COMMANDS = set("\x00\x07\x08\x0b\x0c\x0d\x1b\x7f\x9b\u202e\u2066")


def comove(*arguments, cwd=None, **environment):
    """A command in a process of its own, as a terminal would get what it prints."""
    done = subprocess.run(
        [sys.executable, "-m", "comove", *map(str, arguments)],
        capture_output=True,
        cwd=cwd,
        env=os.environ | environment,
    )
    return done.returncode, done.stdout.decode("utf-8", "replace") + done.stderr.decode("utf-8", "replace")


@pytest.fixture
def folder(tmp_path):
    with whole_folder(tmp_path / "result", RESULT) as draft:
        save_result(solved("wide"), draft, wall_time_s=1.0)
    return tmp_path / "result"


def test_lines_stay_lines_whatever_they_tell_of(capsys):
    say(f"a {EVIL}\nverified", "b")
    found = capsys.readouterr().out
    assert found.count("\n") == 2 and not COMMANDS & set(found)
    for lines in (
        in_rows([(EVIL, f"{EVIL}\n  forged  yes")]),
        as_table([[EVIL, "x\ny"], ["1", "2"]]).split("\n"),
    ):
        assert not COMMANDS & set("".join(lines)) and not any("\n" in line for line in lines)
    assert not COMMANDS & set(plain(EVIL))
    assert printable("plain text, übel, 漢字") == "plain text, übel, 漢字"


def test_bytes_of_a_path_are_shown_as_letters():
    escaped = "grüße/漢".encode().decode("ascii", "surrogateescape")
    assert printable(escaped) == letters(escaped) == "grüße/漢"
    assert printable("x\udcff") == "x\\xff"


def test_the_stream_itself_lets_nothing_through_and_json_stays_json(tmp_path):
    with open(tmp_path / "out", "wb") as raw:
        stream = _Plain(raw, encoding="utf-8", errors="backslashreplace")
        stream.write(json.dumps({"name": EVIL}, ensure_ascii=False) + "\n\tend ü\n")
        stream.flush()
    text = (tmp_path / "out").read_text("utf-8")
    assert not COMMANDS & set(text)
    assert json.loads(text.splitlines()[0])["name"] == EVIL
    assert text.endswith("\n\tend ü\n")


@pytest.mark.parametrize("verb", ["verify", "show", "report"])
@pytest.mark.few(2)
def test_a_result_of_a_forger_commands_no_terminal(verb, folder):
    """In every entry of a summary that is text, and in names of arrays."""
    summary, arrays = SOLUTION.read(folder)
    texts = {key: EVIL for key, value in summary.items() if isinstance(value, str)}
    SOLUTION.write(folder, summary | texts | {"reasons": [EVIL], "verified": False}, arrays)
    options = ("--html", folder.parent / "page.html") if verb == "report" else ()
    _, told = comove(verb, folder, *options)
    assert told and not COMMANDS & set(told)


def test_a_library_of_a_forger_commands_no_terminal(tmp_path):
    demo = Demonstration.from_lasa("Sine")
    primitive = learn(demo, name="a", source=f"{EVIL}.csv")
    assert not COMMANDS & set(learned_text(primitive))
    (tmp_path / "library").mkdir()
    (tmp_path / "library" / f"evil {EVIL}.txt").write_text("no primitive")
    (tmp_path / "library" / f"evil {EVIL}.json").write_text("{}")
    for arguments in (("list",), ("show", EVIL), ("find", "--start", "0,0")):
        done = invoke("library", *arguments, "--folder", tmp_path / "library")
        assert not COMMANDS & set(done.output)
    scene = tmp_path / "scene.yaml"
    scene.write_text(json.dumps({"name": EVIL, EVIL: 1}))
    assert not COMMANDS & set(invoke("solve", scene, "--out", tmp_path / "out").output)


def test_paths_that_the_environment_cannot_encode_are_shown_by_their_letters(tmp_path):
    folder = tmp_path / "größe"
    folder.mkdir()
    plain_c = {"LC_ALL": "POSIX", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
    code, told = comove("verify", folder / "ärger", **plain_c)
    assert code == 2 and "\\udc" not in told
    assert "gr\\xf6\\xdfe/\\xe4rger" in told


@pytest.mark.skipif(sys.platform == "win32", reason="limits are those of Unix")
@pytest.mark.slow
def test_a_file_that_is_larger_than_the_process_may_write_is_told_by_its_own_exit_code(folder, tmp_path):
    command = f"ulimit -f 40; exec {sys.executable} -m comove report {folder} --html {tmp_path}/page.html"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert done.returncode == 74
    assert "larger than this process may write; raise the limit: ulimit -f unlimited" in done.stderr
    assert not (tmp_path / "page.html").exists()
