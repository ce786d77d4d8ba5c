"""The example scenes that come with the package."""

from __future__ import annotations

import shutil
from importlib.resources import files
from pathlib import Path

from comove.demonstrations.files import whole_path
from comove.errors import ResultError
from comove.scenes.scene import Scene

EXAMPLES = ("wide", "narrow", "complex", "window", "triangle")


def example_path(name: str) -> Path:
    """Where an example's scene file is."""
    return Path(str(files("comove") / "examples" / f"{name}.yaml"))


def example(name: str) -> Scene:
    """Load an example scene."""
    return Scene.load(example_path(name))


def copy_examples(folder: Path) -> None:
    """Leave the scene files in a folder, to be tried and changed; what is there already is kept.

    Raises
    ------
    ResultError
        If one cannot be written.
    """
    for source in sorted(example_path("narrow").parent.glob("*.yaml")):
        if not (folder / source.name).exists():
            with whole_path(folder / source.name, ResultError, replace=False) as draft:
                shutil.copyfile(source, draft)
