"""Packages: what they hold, and that each Python found here installs them, solves a scene and passes tests."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml

import comove
from tests.clean import ROOT, VERSIONS, environment, pythons, run

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
BUILT = re.compile(r"PKG-INFO|setup\.cfg|MANIFEST\.in|src/comove\.egg-info/.*")
"""What an archive of the sources holds beside the sources."""
SMALL = ("geometry/test_rotations.py", "dmp/test_dmp.py", "verification/test_bounds.py", "results")
"""Tests that need nothing but the core, and touch what compiles."""


def bounds(requirements: list[str]) -> dict[str, str]:
    """Return the lower bound, or the version, that requirements ask for, by the name in lower case."""
    found = (re.fullmatch(r"([\w.-]+)(?:>=|==)([\d.]+)(?:,.*)?", text) for text in requirements)
    return {match[1].lower(): match[2] for match in found if match}


def test_the_newest_numba_that_is_allowed_is_tested():
    """`comove.compiled` stands on classes that numba may change in any minor version."""
    (wanted,) = (text for text in PROJECT["dependencies"] if text.startswith("numba"))
    major, minor = map(int, re.search(r",<(\d+)\.(\d+)$", wanted).groups())
    assert version("numba").startswith(f"{major}.{minor - 1}.")


def test_the_oldest_versions_are_the_lower_bounds():
    text = (ROOT / "packaging" / "oldest.txt").read_text(encoding="utf-8")
    pins = bounds([line for line in text.splitlines() if not line.startswith("#")])
    wanted = bounds(PROJECT["dependencies"])
    assert len(wanted) == len(PROJECT["dependencies"]) and wanted.keys() == pins.keys()
    for name, bound in wanted.items():
        assert pins[name] == bound or pins[name].removeprefix(bound).strip(".0") == "", name


def test_the_conda_recipe_asks_for_what_the_package_asks_for():
    jinja2 = pytest.importorskip("jinja2")
    source = (ROOT / "packaging" / "conda" / "meta.yaml").read_text(encoding="utf-8")
    recipe = yaml.safe_load(jinja2.Template(source, undefined=jinja2.StrictUndefined).render(PYTHON="python"))
    assert recipe["package"] == {"name": PROJECT["name"], "version": comove.__version__}
    assert recipe["build"]["entry_points"] == [f"{k} = {v}" for k, v in PROJECT["scripts"].items()]
    assert recipe["about"]["license"] == PROJECT["license"]
    needed = [text.replace("-base", "").replace(" ", "", 1) for text in recipe["requirements"]["run"]]
    supported = f"python{PROJECT['requires-python']}"
    assert sorted(needed) == sorted([supported, *(text.lower() for text in PROJECT["dependencies"])])
    assert supported in [text.replace(" ", "", 1) for text in recipe["requirements"]["host"]]


def steps() -> list[dict]:
    """Return the steps of all jobs of all workflows."""
    files = sorted((ROOT / ".github" / "workflows").glob("*.yaml"))
    flows = [yaml.safe_load(file.read_text(encoding="utf-8")) for file in files]
    return [step for flow in flows for job in flow["jobs"].values() for step in job["steps"]]


def test_workflows_do_chores_that_exist():
    chores = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    done = [step["run"].split() for step in steps() if "run" in step]
    assert {words[0] for words in done} == {"make", "python"}
    assert {words[1] for words in done if words[0] == "make"} <= chores
    assert all("run" in step or re.fullmatch(r"[\w-]+/[\w-]+@[\w./]+", step["uses"]) for step in steps())


def test_workflows_run_every_supported_python():
    text = (ROOT / ".github" / "workflows" / "ci.yaml").read_text(encoding="utf-8")
    matrices = [
        job["strategy"]["matrix"]["python"]
        for job in yaml.safe_load(text)["jobs"].values()
        if "strategy" in job
    ]
    assert len(matrices) == 2 and all(tuple(matrix) == VERSIONS for matrix in matrices)


@pytest.fixture(scope="session")
def packages(tmp_path_factory):
    """The archive of the sources and the wheel, made from what git tracks."""
    if importlib.util.find_spec("build") is None:
        pytest.skip("packages are not built here: pip install 'comove[docs]'")
    folder = tmp_path_factory.mktemp("packages")
    source = folder / "source"
    subprocess.run(["git", "clone", "-q", ROOT, source], check=True)
    tracked = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    for name in filter(None, tracked.split("\0")):  # as they stand, committed or not
        shutil.copy(ROOT / name, source / name)
    subprocess.run([sys.executable, "-m", "build", "-q", "--outdir", folder / "dist", source], check=True)
    (archive,), (wheel,) = (folder / "dist").glob("*.tar.gz"), (folder / "dist").glob("*.whl")
    return source, archive, wheel


@pytest.mark.release
def test_the_archive_of_sources_holds_what_is_tracked(packages):
    source, archive, _ = packages
    tracked = subprocess.run(
        ["git", "ls-files"], cwd=source, capture_output=True, text=True, check=True
    ).stdout
    with tarfile.open(archive) as file:
        held = {name.partition("/")[2] for name in file.getnames() if not file.getmember(name).isdir()}
    assert {name for name in held if not BUILT.fullmatch(name)} == set(tracked.splitlines()) - {"MANIFEST.in"}


def used(packages, python: Path, folder: Path, *constraints: object, tested: bool = True) -> None:
    """Install the wheel into an empty environment; solve, verify and perhaps test there, and from the archive."""
    _, archive, wheel = packages
    bin = folder / "venv" / "bin"
    variables = environment(folder / "home", bin)
    run([python, "-m", "venv", folder / "venv"], folder, variables)
    run([bin / "pip", "install", "-q", *constraints, wheel, "pytest", "hypothesis"], folder, variables)
    scene = run([bin / "python", "-c", "import comove; print(comove.__path__[0])"], folder, variables).strip()
    shutil.copy(Path(scene) / "examples" / "narrow.yaml", folder)
    assert "verified" in run([bin / "comove", "solve", "narrow.yaml", "--out", "result"], folder, variables)
    with tarfile.open(archive) as file:
        file.extractall(folder, filter="data")
    sources = folder / archive.name.removesuffix(".tar.gz")
    shutil.rmtree(sources / "src")  # the tests test what is installed
    tests = [f"tests/{name}" for name in SMALL]
    if tested:
        run([bin / "python", "-m", "pytest", "-p", "no:cacheprovider", *tests], sources, variables)
    run([bin / "pip", "install", "-q", "--no-deps", "--force-reinstall", archive], folder, variables)
    assert "verified" in run([bin / "comove", "verify", "narrow.yaml", "result"], folder, variables)


@pytest.mark.release
@pytest.mark.parametrize("version", VERSIONS)
def test_packages_work_in_an_empty_environment(version, packages, tmp_path):
    if version not in pythons():
        pytest.skip(f"there is no Python {version} here")
    # All tests run in one of these versions already; the oldest is tested with the oldest packages as well.
    used(packages, pythons()[version], tmp_path, tested=version == VERSIONS[-1])


@pytest.mark.release
def test_packages_work_with_the_oldest_versions(packages, tmp_path):
    if VERSIONS[0] not in pythons():
        pytest.skip(f"there is no Python {VERSIONS[0]} here")
    used(packages, pythons()[VERSIONS[0]], tmp_path, "-c", ROOT / "packaging" / "oldest.txt")
