"""The example scenes of the package."""

from __future__ import annotations

import shutil
from importlib.resources import files
from pathlib import Path

from comove.errors import ResultError
from comove.io.files import whole_path
from comove.scenes.scene import Scene

EXAMPLES = ("wide", "narrow", "complex", "window", "triangle")


def example_path(name: str) -> Path:
    """Return the path of an example's scene file."""
    return Path(str(files("comove") / "examples" / f"{name}.yaml"))


def example(name: str) -> Scene:
    """Load an example scene."""
    return Scene.load(example_path(name))


def copy_examples(folder: Path) -> None:
    """Copy the example scene files to a folder, for users to try and change; existing files are kept.

    Raises
    ------
    ResultError
        If one cannot be written.
    """
    for source in sorted(example_path("narrow").parent.glob("*.yaml")):
        if not (folder / source.name).exists():
            with whole_path(folder / source.name, ResultError, replace=False) as draft:
                shutil.copyfile(source, draft)
