"""Packages that load their names on first use. A command thus loads only the modules that it needs."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from threading import Lock
from typing import Any

_lock, _inside, _was_enabled = Lock(), 0, True


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

    Modules and compilers make many objects that stay, and each collection would visit them all; at the end all of
    them join the oldest generation. Threads may be in it at once: the last one that leaves enables it, if the first
    found it so.
    """
    global _inside, _was_enabled
    with _lock:
        if _inside == 0:
            _was_enabled = gc.isenabled()
            gc.disable()
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0 and _was_enabled:
                if not gc.get_freeze_count():  # or the first new object would lead to a collection of all
                    gc.freeze()
                    gc.unfreeze()
                gc.enable()
