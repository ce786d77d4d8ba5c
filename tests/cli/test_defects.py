"""Whatever goes wrong inside ends in one sentence and an exit code of the contract, and never in a traceback."""

import re
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import pytest

from comove.cli import main
from comove.errors import InputError, near_name, plain, readable, shortened

BREAKING = """
import sys
from comove import stored
def read(folder): 1 / 0
stored.parts_of = read
sys.argv = ["comove", "show", "x"]
from comove.cli import main
main()
"""


@pytest.fixture
def ended_by(monkeypatch, capsys):
    """Exit code, standard output and standard error of `comove show` where reading a result ends so."""

    def call(statement):
        def read(folder):
            exec(statement, {"read": read, "folder": folder})

        monkeypatch.setattr("comove.stored.parts_of", read)
        monkeypatch.setattr(sys, "argv", ["comove", "show", "x"])
        for of_the_process in ("guard_streams", "_unwind_when_ended"):
            monkeypatch.setattr(f"comove.cli.app.{of_the_process}", lambda: None)
        with warnings.catch_warnings(), pytest.raises(SystemExit) as left:
            main()
        return left.value.code, *capsys.readouterr()

    return call


@pytest.mark.parametrize("statement", ["1 / 0", "raise AssertionError", "read(folder)", "import no_such"])
def test_a_defect_is_told_in_one_sentence_and_reported_in_a_file(ended_by, tmp_path, monkeypatch, statement):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    code, said, told = ended_by(statement)
    assert code == 70
    assert said == ""
    assert told.count("\n") == 1
    report = Path(re.search(r"report (\S+)$", told.strip())[1])
    assert report.parent == tmp_path
    assert "Traceback" in report.read_text()
    assert "'show', 'x'" in report.read_text()


def test_a_defect_where_no_report_can_be_written():
    command = [sys.executable, "-c", BREAKING]
    outcome = subprocess.run(command, capture_output=True, text=True, timeout=600, preexec_fn=_no_files)
    assert outcome.returncode == 70
    assert "no report could be written" in outcome.stderr
    assert outcome.stderr.count("\n") == 1


def _no_files():
    import resource

    resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))


@pytest.mark.parametrize(
    ("statement", "code", "words"),
    [
        ("raise OSError(5, 'Input/output error', 'disk')", 2, "disk: the system refused: Input/output error"),
        ("raise MemoryError", 2, "memory"),
        ("'\\u00e4'.encode('ascii')", 2, "PYTHONUTF8=1"),
        ("raise KeyboardInterrupt", 130, "interrupted"),
        ("raise ConnectionResetError(104, 'Connection reset')", 2, "Connection reset"),
        ("raise BrokenPipeError(32, 'Broken pipe')", 2, "Broken pipe"),  # another pipe than standard output
    ],
)
def test_what_is_no_defect(ended_by, statement, code, words):
    found, _, told = ended_by(statement)
    assert found == code
    assert words in told
    assert told.count("\n") == 1


def test_nothing_that_is_quoted_is_too_long_to_be_read():
    error = InputError("9" * 2_000_000 + " is too large", file="f" * 5000, way_out="x" * 10_000)
    assert len(str(error)) < 1500
    assert str(error).startswith("fff")
    assert "is too large" in str(error)
    assert len(str(InputError("word " * 100_000))) < 4000
    assert len(near_name("a" * 100_000, [f"n{i}" for i in range(100_000)])) < 2000
    assert shortened("short") == "short"
    assert readable("a few words") == "a few words"


def test_messages_cannot_upset_a_terminal():
    assert plain("a\x1b[2J\x00\u202eb\nc\n  d") == "a\\x1b[2J\\x00\\u202eb\\nc\n  d"
