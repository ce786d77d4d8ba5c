"""What a compiled function depends on: its code, the code of what it calls, and the values that all of it takes from
modules.

numba keeps what it has compiled until the file of the function itself changes. But the code of small functions
becomes part of their callers, and values of modules become constants, wherever they are written: what other files
hold would be out of date, and nobody would know.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterable
from functools import cache
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

ADDRESS = re.compile(r"0x[0-9a-f]+")
# known to numba's cache by its own version
LIBRARIES = frozenset({"builtins", "llvmlite", "math", "numba", "numpy", "scipy"})
_answers: dict[Callable, dict[type, Callable]] = {}


def answered(question: Callable, kind: type, answer: Callable) -> None:
    """Note which function is compiled in place of a question about values of one kind (see `planning.trees`)."""
    _answers.setdefault(question, {})[kind] = answer


def fingerprint(function: Callable, argument_types: Iterable[Any] = ()) -> str:
    """Return a checksum of all that the compiled code of a function depends on.

    Parameters
    ----------
    function : a Python function
    argument_types : numba's types of its arguments, which choose what answers a question
    """
    kinds, reached, pending = _kinds(argument_types), dict[Callable, bytes](), [function]
    while pending:
        one = pending.pop()
        if one not in reached:
            reached[one], called = _own(one)
            answers = _answers.get(one, {})
            pending += [*called, *(answers[kind] for kind in kinds if kind in answers)]
    return hashlib.sha256(b"".join(reached.values())).hexdigest()


def _kinds(types: Iterable[Any]) -> list[type]:
    """Return the classes of named tuples among numba's types, and within them, each once."""
    found = dict[type, None]()
    for one in types:
        kind = getattr(one, "instance_class", None)
        found.update(dict.fromkeys([*([kind] if kind else []), *_kinds(getattr(one, "types", ()))]))
    return list(found)


@cache
def _own(function: Any) -> tuple[bytes, tuple[Callable, ...]]:
    """Return a checksum of a function without those that it calls, and these."""
    code, words, called = function.__code__, list[str](), list[Callable]()
    known = {**function.__globals__, **_free(function)}
    for part in _codes(code):
        words += [part.co_code.hex(), *_constants(part, function.__doc__), *part.co_names]
        for name in (*part.co_names, *part.co_freevars):
            if name in known:
                _describe(known[name], part.co_names, words, called)
    _describe(function.__defaults__, (), words, called)
    return hashlib.sha256("\n".join(words).encode()).digest(), tuple(called)


def _free(function: Any) -> dict[str, Any]:
    """Return the values that a function takes from what it is defined in; those not defined yet are left out."""
    found = {}
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            found[name] = cell.cell_contents
        except ValueError:
            continue
    return found


def _codes(code: CodeType) -> list[CodeType]:
    """Return a code, and those of the functions and comprehensions that are defined in it."""
    return [code, *(inner for part in code.co_consts if isinstance(part, CodeType) for inner in _codes(part))]


def _constants(code: CodeType, docstring: str | None) -> list[str]:
    """Return the constants of a code, in words, without codes and the docstring."""
    plain = [part for part in code.co_consts if part != docstring and not isinstance(part, CodeType)]
    return [repr(sorted(map(repr, part)) if isinstance(part, frozenset) else part) for part in plain]


def _describe(value: Any, names: tuple[str, ...], words: list[str], called: list[Callable]) -> None:
    """Add the words that describe a value of a module, and the functions in it.

    Parameters
    ----------
    names : names that the code uses, of which some may be attributes of a module
    """
    if hasattr(value, "py_func"):  # of a kernel, or of numba's own
        words.append(repr(sorted(value.targetoptions.items())))
        called.append(value.py_func)
    elif isinstance(value, FunctionType) and not _is_library(value.__module__):
        called.append(value)
    elif isinstance(value, ModuleType):
        words.append(value.__name__)
        for name in () if _is_library(value.__name__) else names:
            if hasattr(value, name):
                _describe(getattr(value, name), (), words, called)
    elif isinstance(value, tuple | list):
        words.append(type(value).__qualname__)
        for part in value:
            _describe(part, (), words, called)
    elif isinstance(value, np.ndarray):
        words += [value.dtype.str, str(value.shape), hashlib.sha256(value.tobytes()).hexdigest()]
    elif isinstance(value, type):
        words += [value.__qualname__, *getattr(value, "_fields", ())]
    else:
        words.append(ADDRESS.sub("", f"{type(value).__qualname__} {value!r}"))


def _is_library(module: str) -> bool:
    return module.partition(".")[0] in LIBRARIES
