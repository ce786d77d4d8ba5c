"""Whole folders and files: whoever writes them is killed at every step, and several write at once."""

import errno
import os
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import pytest

from comove.errors import ComoveWarning, DemonstrationError
from comove.io import drafts, files
from comove.io.files import require_room
from tests.killing import killed_at

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="kills processes as Unix does")
N_FILES = 3
WATCHED = {drafts.__file__, files.__file__}


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("two renames", "no locks")]


@pytest.fixture(params=["exchange", *SLOW])
def system(request, monkeypatch):
    """What the system can do."""
    if request.param != "exchange":
        monkeypatch.setattr(drafts, "exchanged", lambda *_: False)
    elif not can_exchange(request.getfixturevalue("tmp_path")):
        pytest.skip("this file system cannot exchange folders")
    if request.param == "no locks":
        monkeypatch.setattr(drafts, "_lock", unlocked)
        monkeypatch.setattr(drafts, "_GAP", -1.0)
        monkeypatch.setattr(drafts, "_LONG", -1.0)
    return request.param


def unlocked(number, *, wait):
    raise OSError(errno.EBADF, "no locks")


def can_exchange(folder):
    for name in "ab":
        (folder / name).mkdir()
    done = drafts.exchanged(folder / "a", folder / "b")
    for name in "ab":
        (folder / name).rmdir()
    return done


def fill(folder, text):
    for number in range(N_FILES):
        (folder / f"{number}.txt").write_text(text)


def contents(folder):
    return {path.name: path.read_text() for path in folder.iterdir()}


def whole(text):
    return {f"{number}.txt": text for number in range(N_FILES)}


def replace(target, text):
    with drafts.draft(target) as draft:
        fill(draft, text)
        drafts.put(draft, target)


def write_file(target, text):
    with files.whole_file(target) as file:
        file.write(text.encode())


@pytest.mark.slow
def test_whoever_is_killed_leaves_the_old_folder_or_the_new_one(tmp_path, system):
    target, step, cut_off = tmp_path / "result", 0, 0
    replace(target, "old")
    while killed_at(step := step + 1, WATCHED, replace, target, "new"):
        if system == "exchange":
            assert contents(target) in (whole("old"), whole("new"))
        elif not target.exists():
            with pytest.warns(ComoveWarning, match="was cut off before the end"):
                assert drafts.finish(target)
            assert contents(target) == whole("new")
            cut_off += 1
        replace(target, "old")  # the next writer cleans up
        assert [path.name for path in tmp_path.iterdir()] == ["result"]
        assert contents(target) == whole("old")
    assert step > 30
    assert contents(target) == whole("new")
    assert (cut_off > 0) == (system != "exchange")


@pytest.mark.slow
def test_the_next_writer_ends_what_was_cut_off_too(tmp_path, system):
    target = tmp_path / "result"
    replace(target, "old")
    step = 0
    while killed_at(step := step + 1, WATCHED, replace, target, "new"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ComoveWarning)
            replace(target, "newer")
        assert contents(target) == whole("newer")
        assert [path.name for path in tmp_path.iterdir()] == ["result"]


@pytest.mark.slow
def test_files_are_whole_whoever_is_killed(tmp_path):
    target = tmp_path / "file.txt"
    write_file(target, "old")
    step = 0
    while killed_at(step := step + 1, WATCHED, write_file, target, "new"):
        assert target.read_text() in ("old", "new")
        write_file(target, "old")
        assert [path.name for path in tmp_path.iterdir()] == ["file.txt"]
    assert target.read_text() == "new"
    assert step > 30


WRITER = """
import sys
sys.path.insert(0, {root!r})
from pathlib import Path
from tests.io.test_drafts import drafts, replace
if {renames}:
    drafts.exchanged = lambda *_: False
while True:
    replace(Path({target!r}), {text!r})
"""


def writers(target, texts, renames):
    root = str(Path(__file__).parents[2])
    return [
        subprocess.Popen(
            [sys.executable, "-c", WRITER.format(root=root, target=str(target), text=text, renames=renames)],
            stderr=subprocess.PIPE,
        )
        for text in texts
    ]


@pytest.mark.parametrize(
    "renames",
    [pytest.param(False, id="exchange"), pytest.param(True, id="two renames", marks=pytest.mark.slow)],
)
def test_several_writers_at_once(tmp_path, renames):
    if not renames and not can_exchange(tmp_path):
        pytest.skip("this file system cannot exchange folders")
    target, seen, gaps = tmp_path / "result", set(), 0
    replace(target, "a")
    processes = writers(target, ["b", "c"], renames)
    try:
        began = time.monotonic()
        while time.monotonic() < began + 60 and (not {"b", "c"} <= seen or time.monotonic() < began + 3):
            try:
                folder = os.open(target, os.O_RDONLY)
            except FileNotFoundError:
                gaps += 1
                continue
            names = os.listdir(folder)
            if drafts._is(folder, target):  # or else it was replaced after it was opened
                assert len(names) == N_FILES
            os.close(folder)
            try:
                found = drafts.steadily(target, lambda: read_whole(target))
            except (DemonstrationError, OSError):
                if not renames:
                    raise
                continue  # between two renames it may be gone, for as long as a writer is kept waiting
            seen.update(found.values())
            assert len(set(found.values())) == 1
    finally:
        for process in processes:
            process.kill()
        told = [process.communicate()[1].decode() for process in processes]
    assert told == ["", ""]
    assert {"b", "c"} <= seen
    if not renames:
        assert gaps == 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ComoveWarning)
        replace(target, "last")
    assert contents(target) == whole("last")
    assert [path.name for path in tmp_path.iterdir()] == ["result"]


def read_whole(folder):
    try:
        found = contents(folder)
    except OSError as error:
        raise DemonstrationError("gone") from error
    if len(found) != N_FILES:
        raise DemonstrationError("not whole")
    return found


def test_drafts_of_writers_that_live_are_left_alone(tmp_path):
    target = tmp_path / "result"
    with drafts.draft(target) as mine:
        fill(mine, "mine")
        replace(target, "theirs")
        assert contents(mine) == whole("mine")
        drafts.put(mine, target)
    assert contents(target) == whole("mine")
    assert [path.name for path in tmp_path.iterdir()] == ["result"]


def test_names_that_are_long_or_strange_or_alike(tmp_path):
    for name in ("x" * 255, "ä" * 127, "a b", "a\nb", os.fsdecode(b"\xff\xfe"), ".hidden", "r", "re"):
        target = tmp_path / name
        replace(target, "old")
        replace(target, "new")
        assert contents(target) == whole("new")
    assert len(list(tmp_path.iterdir())) == 8
    with drafts.draft(tmp_path / "r") as draft:
        replace(tmp_path / "re", "new")
        assert draft.exists()


def test_an_interruption_between_two_renames_puts_the_old_folder_back(tmp_path, monkeypatch):
    monkeypatch.setattr(drafts, "exchanged", lambda *_: False)
    target, rename = tmp_path / "result", os.rename
    replace(target, "old")

    def interrupted(first, second):
        rename(first, second)
        if Path(first) == target:
            raise KeyboardInterrupt

    monkeypatch.setattr(os, "rename", interrupted)
    with pytest.raises(KeyboardInterrupt):
        replace(target, "new")
    assert contents(target) == whole("old")
    assert [path.name for path in tmp_path.iterdir()] == ["result"]


@pytest.mark.parametrize("moment", ["_lock", "_is", "rmtree"])
def test_a_signal_while_a_draft_is_made_or_removed_leaves_nothing(tmp_path, monkeypatch, moment):
    """Whoever waits for a draft to appear, to end the command then, meets it between its folder and its lock."""
    owner = drafts.shutil if moment == "rmtree" else drafts
    real, ended = getattr(owner, moment), []

    def signalled(*arguments, **options):
        if not ended:
            ended.append(True)
            raise SystemExit(143)
        return real(*arguments, **options)

    monkeypatch.setattr(owner, moment, signalled)
    with pytest.raises(SystemExit), drafts.draft(tmp_path / "out") as folder:
        fill(folder, "new")
    assert ended
    assert os.listdir(tmp_path) == []


def test_a_draft_in_a_folder_that_is_gone_is_told(tmp_path):
    with pytest.raises(FileNotFoundError), drafts.draft(tmp_path / "gone" / "out"):
        raise AssertionError


@pytest.mark.skipif(not hasattr(os, "O_TMPFILE"), reason="files without names are Linux's")
def test_the_look_whether_there_is_room_leaves_nothing_whenever_it_is_killed(tmp_path, monkeypatch):
    """What is made to see whether a folder may be written has no name, so that no kill can leave it."""
    try:
        os.close(os.open(tmp_path, os.O_TMPFILE | os.O_RDWR))
    except OSError:
        pytest.skip("this file system has no files without names")
    monkeypatch.setattr(tempfile, "mkdtemp", lambda **_: pytest.fail("a folder with a name was made"))
    require_room(tmp_path / "result")
    assert list(tmp_path.iterdir()) == []
