"""Clean environments: a fresh virtual environment, an empty home, nothing of this machine but the installer."""

from __future__ import annotations

import os
import re
import subprocess
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
VERSIONS = tuple(re.findall(r"Python :: (3\.\d+)\"", (ROOT / "pyproject.toml").read_text(encoding="utf-8")))
"""Versions of Python that the package says it supports."""


@cache
def pythons() -> dict[str, Path]:
    """Return an interpreter that can make environments for each supported version that is found here."""
    places = [*map(Path, os.environ["PATH"].split(os.pathsep)), *Path.home().glob(".pyenv/versions/*/bin")]
    question = "import sys, venv, ensurepip; print(sys.executable if sys.prefix == sys.base_prefix else '')"
    found: dict[str, Path] = {}
    for version in VERSIONS:
        for python in (place / f"python{version}" for place in places):
            if python.is_file():
                answer = subprocess.run([python, "-c", question], capture_output=True, text=True)
                if answer.stdout.strip():  # the interpreter itself, where a shim was asked
                    found.setdefault(version, Path(answer.stdout.strip()))
    return found


def environment(home: Path, *places: Path) -> dict[str, str]:
    """Return the variables of a clean environment; `places` are searched for programs before those of the system."""
    home.mkdir(exist_ok=True)
    installer = {name: value for name, value in os.environ.items() if name.startswith("PIP_")}
    path = os.pathsep.join([*map(str, places), "/usr/bin", "/bin"])
    return {**installer, "HOME": str(home), "PATH": path, "LANG": "C.UTF-8"}


def run(command: list[object], cwd: Path, variables: dict[str, str], timeout: float = 1200) -> str:
    """Run a command and return what it printed; a failure shows all that it said."""
    words = [str(word) for word in command]
    done = subprocess.run(words, cwd=cwd, env=variables, capture_output=True, text=True, timeout=timeout)
    assert done.returncode == 0, f"{words}\n{done.stdout}\n{done.stderr}"
    return done.stdout
