"""One-line representations of objects that hold arrays."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from comove.errors import shortened


def brief(thing: Any) -> str:
    """Return a dataclass as one line, arrays by their shapes.

    Use it as ``__repr__ = brief``. Fields that are None, or not part of a representation, are left out.
    """
    values = {field.name: getattr(thing, field.name) for field in dataclasses.fields(thing) if field.repr}
    told = [f"{name}={_value(value)}" for name, value in values.items() if value is not None]
    return f"{type(thing).__name__}({', '.join(told)})"


def _value(value: Any) -> str:
    name = getattr(value, "name", None)
    if isinstance(value, np.ndarray):
        return f"<array {value.shape}>" if value.size > 3 else shortened(repr(value.tolist()), 60)
    if isinstance(value, (str, bool, int)):
        return shortened(repr(value), 60)
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (tuple, list)):
        told = f"({', '.join(map(_value, value))})"
        return told if len(told) <= 60 else f"<{type(value).__name__} of {len(value)}>"
    return f"<{type(value).__name__} {name!r}>" if isinstance(name, str) else f"<{type(value).__name__}>"
