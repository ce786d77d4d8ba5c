"""Whatever goes wrong inside ends in one sentence and an exit code of the contract, and never in a traceback."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from comove.errors import InputError, near_name, plain, readable, shortened

BREAKING = """
import sys
from comove.results import ResultKind
def read(self, folder, **options): {statement}
ResultKind.read = read
sys.argv = ["comove", "show", "x"]
from comove.cli import main
main()
"""


def ended_by(statement, **options):
    """What `comove show` says where reading a result ends so."""
    command = [sys.executable, "-c", BREAKING.format(statement=statement)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, **options)


@pytest.mark.parametrize(
    "statement", ["1 / 0", "raise AssertionError", "read(self, folder)", "import no_such"]
)
def test_a_defect_is_told_in_one_sentence_and_reported_in_a_file(tmp_path, statement):
    outcome = ended_by(statement, env={"TMPDIR": str(tmp_path), "PYTHONPATH": ":".join(sys.path)})
    assert outcome.returncode == 70
    assert outcome.stdout == ""
    assert outcome.stderr.count("\n") == 1
    report = Path(re.search(r"report (\S+)$", outcome.stderr.strip())[1])
    assert report.parent == tmp_path
    assert "Traceback" in report.read_text()
    assert "'show', 'x'" in report.read_text()


def test_a_defect_where_no_report_can_be_written():
    outcome = ended_by("open('/nowhere', 'w') if 0 else 1 / 0", preexec_fn=_no_files)
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
def test_what_is_no_defect(statement, code, words):
    outcome = ended_by(statement)
    assert outcome.returncode == code
    assert words in outcome.stderr
    assert outcome.stderr.count("\n") == 1


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
