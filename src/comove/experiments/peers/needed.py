"""The import of modules that only peers need."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from comove.errors import ExtraError


def needed(name: str) -> ModuleType:
    """Import a module that `comove[bench]` installs.

    Raises
    ------
    ExtraError
        If it is not installed.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise ExtraError(f"the peer '{name.split('.')[0]}'", "bench") from error
