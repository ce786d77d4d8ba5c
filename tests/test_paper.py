"""The paper: what it cites is in its references, and it can be set."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys

import pytest

from tests.clean import ROOT

PAPER = ROOT / "paper"


def test_what_is_cited_is_referred_to_and_nothing_else():
    cited = set(re.findall(r"(?<!\w)@([\w:]+)", (PAPER / "paper.md").read_text(encoding="utf-8")))
    known = re.findall(r"^@\w+\{([\w:]+),", (PAPER / "paper.bib").read_text(encoding="utf-8"), re.MULTILINE)
    assert len(known) == len(set(known)) and cited == set(known)


@pytest.mark.slow
@pytest.mark.skipif(
    not (importlib.util.find_spec("pypandoc") and importlib.util.find_spec("typst")),
    reason="the paper is not set here: pip install 'comove[paper]'",
)
def test_the_paper_is_set():
    subprocess.run([sys.executable, PAPER / "build.py"], check=True)
    assert (PAPER / "paper.pdf").read_bytes().startswith(b"%PDF")
