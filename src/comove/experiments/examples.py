"""The example scenes that come with the package."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from comove.scenes.scene import Scene

EXAMPLES = ("wide", "narrow", "complex", "window", "triangle")


def example_path(name: str) -> Path:
    """Where an example's scene file is."""
    return Path(str(files("comove") / "examples" / f"{name}.yaml"))


def example(name: str) -> Scene:
    """Load an example scene."""
    return Scene.load(example_path(name))
