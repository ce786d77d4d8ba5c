"""Summaries of docstrings, which help, editors and generated pages show alone."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import comove

SOURCE = Path(comove.__file__).parent
PACKAGES = sorted(
    path.stem for path in SOURCE.iterdir() if path.suffix == ".py" or (path / "__init__.py").is_file()
)
MOST_WORDS = 12
DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def docstrings_of(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line and docstring of a module, its classes and its functions."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, DOCUMENTED) and (docstring := ast.get_docstring(node)):
            yield getattr(node, "lineno", 1), docstring


def n_words(docstring: str) -> int:
    """Return the number of words in the first sentence, which a colon or semicolon ends too."""
    return len(re.split(r"(?<=[.:;])\s", docstring.strip(), maxsplit=1)[0].split())


@pytest.mark.parametrize("package", PACKAGES)
def test_first_sentences_have_few_words(package):
    place = SOURCE / package
    files = sorted(place.rglob("*.py")) if place.is_dir() else [place.with_suffix(".py")]
    too_long = [
        f"{path.relative_to(SOURCE)}:{line}: {n_words(docstring)} words"
        for path in files
        for line, docstring in docstrings_of(path)
        if n_words(docstring) > MOST_WORDS
    ]
    assert not too_long, f"{len(too_long)} first sentences of more than {MOST_WORDS} words:\n" + "\n".join(
        too_long
    )
