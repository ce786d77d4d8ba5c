"""Benchmarks import names that exist, and those that are commands print their options."""

import ast
import runpy
import sys
from importlib import import_module
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
SCRIPTS = sorted(BENCHMARKS.glob("*.py"))
COMMANDS = [path for path in SCRIPTS if '__name__ == "__main__"' in path.read_text(encoding="utf-8")]
OWN = ("comove", "tests", "benchmarks")
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def imports_of(path):
    """Modules of the repository that a file imports, wherever in it, and the names from them."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in OWN:
            yield from ((node.module, name.name) for name in node.names)
        elif isinstance(node, ast.Import):
            yield from ((name.name, None) for name in node.names if name.name.split(".")[0] in OWN)


def exists(module, name):
    """Whether a module has a name, or a module of that name."""
    try:
        found = import_module(module)
        return name is None or hasattr(found, name) or bool(import_module(f"{module}.{name}"))
    except ModuleNotFoundError as error:
        return error.name is not None and error.name.split(".")[0] not in OWN  # an optional dependency


def test_imported_names_exist():
    wanted = {(path.name, *named) for path in SCRIPTS for named in imports_of(path)}
    assert not [(file, module, name) for file, module, name in wanted if not exists(module, name)]


@pytest.mark.parametrize("path", COMMANDS, ids=lambda path: path.stem)
def test_commands_print_their_options(path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [str(path), "--help"])
    monkeypatch.setattr(sys, "path", [str(BENCHMARKS), *sys.path])
    for name in THREADS:
        monkeypatch.setenv(name, "1")  # else some start again with it
    with pytest.raises(SystemExit) as left:
        runpy.run_path(str(path), run_name="__main__")
    assert left.value.code == 0
    assert "--help" in capsys.readouterr().out
