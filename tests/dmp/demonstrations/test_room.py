"""The room as a whole: light to import, and taking nothing from rooms below it."""

import ast
import subprocess
import sys
from pathlib import Path

import comove.dmp.demonstrations as room

FOLDER = Path(room.__file__).parent


def test_importing_it_loads_nothing_heavy():
    heavy = {"scipy", "matplotlib", "pandas", "h5py", "pyarrow", "rosbags"}
    code = f"import sys, comove.dmp.demonstrations; print({heavy} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_formats_know_no_demonstration():
    """Samples go into a `Demonstration` and come out of it; a format sees nothing but samples."""
    for file in (FOLDER / "formats").glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom):
                assert node.module not in (
                    "comove.dmp.demonstrations",
                    "comove.dmp.demonstrations.demonstration",
                ), file


def test_all_is_complete_and_documented():
    for name in room.__all__:
        assert getattr(room, name).__doc__
