"""The first day of a stranger: the start page and the tutorials, word by word, where there is nothing but Python."""

from __future__ import annotations

import re
import subprocess
import time
from pathlib import Path

import pytest

from tests.clean import ROOT, environment, pythons, run

DOCS = ROOT / "docs"
TUTORIALS = sorted(page.stem for page in (DOCS / "tutorials").glob("*.md") if page.stem != "index")
BLOCK = re.compile(
    r"(?:save it as `([\w.-]+)`:\n\n)?^```(sh|python|yaml)\n(.*?)^```", re.MULTILINE | re.DOTALL
)
ENTER = "cd demo"
"""How the block begins that leads to where the tutorials begin."""
WHILE = "timeout --foreground --preserve-status --signal=INT 90 "
"""What comes before a command that serves a page until Ctrl-C."""


def blocks(page: Path) -> list[str]:
    """Return what a reader types, block by block, as lines of a shell; a file is what is said to be saved as one."""
    typed = []
    for name, language, code in BLOCK.findall(page.read_text(encoding="utf-8")):
        if language == "sh":  # a page is served until Ctrl-C
            typed.append(re.sub(r"^comove view ", f"{WHILE}comove view ", code, flags=re.MULTILINE))
        elif language == "python":
            typed.append(f"python - <<'END OF BLOCK'\n{code}END OF BLOCK\n")
        elif name:
            typed.append(f"cat > {name} <<'END OF BLOCK'\n{code}END OF BLOCK\n")
    return typed


def follow(typed: list[str], folder: Path, variables: dict[str, str]) -> None:
    """Type blocks into one shell that ends at the first failure; print what all took of the processor by then."""
    script = "".join(f"{code}\necho {number}:\ntimes\n" for number, code in enumerate(typed, 1))
    began = time.time()
    said = run(["bash", "-e", "-c", script], folder, variables)
    print(said, f"{time.time() - began:.0f} s in all")


@pytest.fixture(scope="module")
def stranger(tmp_path_factory):
    """A copy of the repository, and the variables of someone who has Python, make and git."""
    if not pythons():
        pytest.skip("there is no Python here that makes environments")
    folder = tmp_path_factory.mktemp("stranger")
    subprocess.run(["git", "clone", "-q", ROOT, folder / "comove"], check=True)
    return folder / "comove", environment(folder / "home", next(iter(pythons().values())).parent)


@pytest.fixture(scope="module")
def started(stranger):
    """The stranger after the start page."""
    copy, variables = stranger
    began = time.time()
    follow(blocks(copy / "docs" / "start.md"), copy, variables)
    first = min(picture.stat().st_mtime for picture in (copy / "demo").rglob("*.png"))
    print(f"first picture after {first - began:.0f} s")
    return copy, variables


@pytest.mark.release
def test_the_start_page_leaves_what_it_says(started):
    copy, _ = started
    files = re.findall(
        r"^\| `([\w.]+)` \|", (copy / "docs" / "start.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert len(files) == 5
    for name in files:
        assert (copy / "demo" / "first" / name).is_file()


@pytest.mark.release
@pytest.mark.parametrize("tutorial", TUTORIALS)
def test_a_tutorial_can_be_followed(tutorial, started):
    copy, variables = started
    (enter,) = (block for block in blocks(copy / "docs" / "start.md") if block.startswith(ENTER))
    follow([enter, *blocks(copy / "docs" / "tutorials" / f"{tutorial}.md")], copy, variables)
