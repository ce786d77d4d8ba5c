"""The site: its pages say what the code does, and no link in it is broken."""

from __future__ import annotations

import ast
import doctest
import importlib.util
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
import yaml

from comove import errors
from comove.lab.examples import copy_examples
from comove.model.constraints import KINDS
from comove.model.files.keys import SceneFile

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"


@pytest.fixture(scope="module", autouse=True)
def site_parts():
    sys.path.insert(0, str(DOCS))
    yield
    sys.path.remove(str(DOCS))


def test_the_page_of_errors_has_a_place_for_each_and_for_nothing_else():
    page = (DOCS / "reference" / "errors.md").read_text(encoding="utf-8")
    assert re.findall(r"autoexception:: comove\.errors\.(\w+)$", page, re.MULTILINE) == list(errors.kinds())


def test_all_errors_stand_in_one_file():
    """Elsewhere exceptions are caught before a user sees them; none is below the root of all errors."""
    elsewhere = {
        base.attr if isinstance(base, ast.Attribute) else base.id
        for path in (ROOT / "src" / "comove").rglob("*.py")
        if path.name != "errors.py"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
        for base in node.bases
        if isinstance(base, (ast.Name, ast.Attribute))
    }
    assert "Exception" in elsewhere and not elsewhere & set(errors.kinds())


@pytest.mark.parametrize("name", errors.kinds())
def test_every_error_explains_itself_by_an_example_that_raises_it(name, tmp_path, monkeypatch):
    copy_examples(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "viser", sys.modules.get("viser"))  # one example does without it
    (example,) = doctest.DocTestFinder(recurse=False).find(errors.kinds()[name], name)
    raised = [part.exc_msg for part in example.examples if part.exc_msg]
    caught = "except" in example.docstring or "catch" in example.docstring
    assert caught or [text.split(":")[0] for text in raised] == [f"comove.errors.{name}"]
    said: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    runner.run(example, out=said.append)
    assert runner.tries > 1 and not runner.failures, "".join(said)


def test_the_page_of_keys_holds_every_key_of_a_scene():
    from site_parts.scene_keys import page

    text = page()
    for name in SceneFile.model_fields:
        assert f"| `{name}` |" in text
    for kind, keys in KINDS.items():
        assert f"\n## {keys.__name__}\n" in text and f"`{kind}`" in text
    links = set(re.findall(r"\(#([a-z0-9]+)\)", text))
    titles = {title.lower() for title in re.findall(r"^## (\w+)$", text, re.MULTILINE)}
    assert links and links <= titles


def test_the_page_of_commands_holds_what_help_says():
    from site_parts.command_line import page

    text = page()
    for command in ("comove solve", "comove solve", "comove library add", "comove bench run"):
        section = text.split(f"\n## {command}\n", 1)[1].split("\n## ")[0]
        said = subprocess.run(
            [sys.executable, "-m", *command.split(), "--help"],
            capture_output=True,
            text=True,
            check=True,
            env={"COLUMNS": "300", "PATH": "/usr/bin:/bin"},
        ).stdout
        options = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", said)) - {"--help"}
        assert options and all(f"`{option}`" in section for option in options), command


def test_pages_for_machines_name_pages_that_exist():
    text = (DOCS / "llms.txt").read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)]+)\.html\)", text)
    assert len(targets) > 8
    for target in targets:
        written = target in ("reference/command_line", "reference/scene_keys")
        assert written or (DOCS / f"{target}.md").is_file(), target


def test_forms_are_yaml():
    files = [*ROOT.glob(".github/ISSUE_TEMPLATE/*.yaml"), ROOT / "CITATION.cff"]
    assert len(files) >= 3
    for file in files:
        assert isinstance(yaml.safe_load(file.read_text(encoding="utf-8")), dict), file


class Links(HTMLParser):
    """What a page links to, and the places in it that can be linked to."""

    def __init__(self) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.places: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        of = dict(attrs)
        self.targets += [of[name] for name in ("href", "src") if of.get(name)]
        self.places |= {of[name] for name in ("id", "name") if of.get(name)}


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("sphinx") is None, reason="the site is not built here")
def test_the_site_is_built_without_warnings_and_without_broken_links(tmp_path):
    site = tmp_path / "html"
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", str(DOCS), str(site)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1500)
    assert done.returncode == 0, done.stderr
    pages = {}
    for path in site.rglob("*.html"):
        pages[path] = Links()
        pages[path].feed(path.read_text(encoding="utf-8"))
    checked = 0
    for path, links in pages.items():
        for target in links.targets:
            parts = urlsplit(target)
            if parts.scheme or parts.netloc:
                assert parts.scheme in ("https", "http", "data", "mailto"), f"{path.name}: {target}"
                continue
            file = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            assert file.exists(), f"{path.name}: {target}"
            if parts.fragment and file in pages:
                assert unquote(parts.fragment) in pages[file].places | {""}, f"{path.name}: {target}"
            checked += 1
    assert checked > 1000
