"""How large the source is: lines, modules, kernels, depth of calls, what `verify` loads; of two commits side by side.

- lines of Python in the package; in its core, the packages that find, verify and carry out motions, by their present
  and former names; in docstrings; in tests; modules; functions that numba compiles; files by extension;
- calls of comove on the stack, from `comove.solve` on, where the planner's kernel begins, for ``narrow.yaml``;
- modules of comove that `comove verify` loads for a result of that scene.

The last two run the source, whose kernels are compiled first: a minute for a commit without any.

To repeat: ``python benchmarks/house.py [COMMIT] [--count-only]``, in a clone that has the commit.
"""

from __future__ import annotations

import argparse
import ast
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from timing import print_table

ROOT = Path(__file__).parents[1]
CORE = {
    *("model", "geometry", "contacts", "planning", "control", "verification", "robots", "results"),
    *("io", "errors.py", "cli"),
    *("scenes", "coordination", "constraints", "reaction", "execution"),  # former names
}
SCENE = "src/comove/examples/narrow.yaml"
PLANNER = "rrt_connect"
FRAMES = f"""
import sys, comove
from comove.compiled.kernels import Kernel
scene, call, found = comove.Scene.load(sys.argv[1]), Kernel.__call__, []
comove.solve(scene)
def counted(kernel, *args, **more):
    if kernel.py_func.__name__ == {PLANNER!r}:
        frame, n = sys._getframe(1), 0
        while frame is not None:
            n, frame = n + ("/src/comove/" in frame.f_code.co_filename), frame.f_back
        found.append(n)
    return call(kernel, *args, **more)
Kernel.__call__ = counted
comove.solve(scene)
print(found[0])
"""
LOADED = """
import sys
from comove.cli import main
sys.argv[0] = "comove"
try:
    main()
except SystemExit:
    print(sum(name.startswith("comove.") for name in sys.modules))
"""


def nodes_of(package: Path) -> Iterator[tuple[Path, str, ast.Module]]:
    """Yield the path inside a package, the text and the syntax tree of every module."""
    for path in sorted(package.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        yield path.relative_to(package), text, ast.parse(text)


def docstring_lines(tree: ast.Module) -> int:
    """Count the lines of docstrings."""
    owners = (
        node for node in ast.walk(tree) if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef))
    )
    return sum(
        node.body[0].end_lineno - node.body[0].lineno + 1 for node in owners if ast.get_docstring(node, False)
    )


def kernels(tree: ast.Module) -> int:
    """Count the functions that numba compiles."""
    marks = (
        mark.func if isinstance(mark, ast.Call) else mark
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        for mark in node.decorator_list
    )
    return sum(ast.unparse(mark) == "kernel" for mark in marks)


def counted(root: Path, files: list[str]) -> dict[str, str]:
    """Return what can be read from the files of a source tree, by what it is."""
    found = dict.fromkeys(("lines", "of them core", "of them docstrings", "modules", "kernels"), 0)
    for inside, text, tree in nodes_of(root / "src" / "comove"):
        n = text.count("\n")
        parts = n, n * (inside.parts[0] in CORE), docstring_lines(tree), 1, kernels(tree)
        found = {what: found[what] + part for what, part in zip(found, parts, strict=True)}
    found["lines of tests"] = sum(
        path.read_text(encoding="utf-8").count("\n") for path in (root / "tests").rglob("*.py")
    )
    endings = Counter(Path(name).suffix or "none" for name in files).most_common()
    common = ", ".join(f"{n} {ending}" for ending, n in endings[:5])
    rest = sum(n for _, n in endings[5:])
    return {what: f"{n:,}" for what, n in found.items()} | {"files": f"{common}, {rest} others"}


def ran(root: Path) -> dict[str, str]:
    """Return what running a source tree tells, by what it is."""
    with tempfile.TemporaryDirectory() as folder:

        def printed(*words: str) -> str:
            environment = os.environ | {"PYTHONPATH": str(root / "src")}
            command = [sys.executable, "-W", "ignore", *words]
            done = subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True)
            if done.returncode:
                sys.exit(f"{root}: {' '.join(words)[:60]}: exit code {done.returncode}\n{done.stderr}")
            return done.stdout.splitlines()[-1]

        scene = str(root / SCENE)
        frames = printed("-c", FRAMES, scene)
        printed("-m", "comove", "solve", scene, "--out", "out")
        return {
            "calls to the planner": frames,
            "modules of verify": printed("-c", LOADED, "verify", "out"),
        }


def measured(root: Path, files: list[str], *, count_only: bool) -> dict[str, str]:
    """Return all measures of a source tree."""
    return counted(root, files) | ({} if count_only else ran(root))


def git(*words: str) -> bytes:
    """Return what git prints of this repository."""
    return subprocess.run(["git", "-C", str(ROOT), *words], check=True, stdout=subprocess.PIPE).stdout


def main() -> None:
    """Measure this checkout, and a commit beside it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("commit", nargs="?", metavar="COMMIT", help="commit that is measured beside it")
    parser.add_argument("--count-only", action="store_true", help="run nothing")
    asked = parser.parse_args()
    columns = {}
    if asked.commit is not None:
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run(["tar", "-x", "-C", folder], input=git("archive", asked.commit), check=True)
            files = git("ls-tree", "-r", "--name-only", asked.commit).decode().splitlines()
            columns[asked.commit] = measured(Path(folder), files, count_only=asked.count_only)
    files = git("ls-files").decode().splitlines()
    columns["now"] = measured(ROOT, files, count_only=asked.count_only)
    rows = [[what, *(column[what] for column in columns.values())] for what in columns["now"]]
    print_table(["", *columns], rows)


if __name__ == "__main__":
    main()
