"""Packages that load their names on first use. A command thus loads only the modules that it needs."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any


def lazily(
    package: str, homes: Mapping[str, Sequence[str]]
) -> tuple[list[str], Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__all__`, `__getattr__` and `__dir__` of a package.

    Parameters
    ----------
    package : name of the package
    homes : names that the package offers, by the module below `comove` that defines them
    """
    home = {name: module for module, names in homes.items() for name in names}

    def get(name: str) -> Any:
        if name not in home:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        with uncollected():
            return getattr(import_module(f"comove.{home[name]}"), name)

    return [*home], get, lambda: sorted(home)


@contextmanager
def uncollected() -> Iterator[None]:
    """Disable garbage collection in this context.

    Modules and compilers make many objects that stay, and each collection would visit them all.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
