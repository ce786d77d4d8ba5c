"""Named tuples of arrays that kernels take by address.

numba by itself passes every array of a named tuple as seven numbers or more, to every function, and handles the tuple
as one value of hundreds of numbers: most of the code of a planner, and of the time to compile it, would be copies. A
tuple of arrays from Python is therefore laid out in memory once a call, and kernels receive its address, from which
they load the fields in use (see `lowering`). Tuples made by kernels are numba's own.
"""

from __future__ import annotations

import hashlib
from typing import Any

from numba.core import types


class Shared(types.NamedTuple):
    """The type of a named tuple in memory, constant during a call.

    References to arrays loaded from it are not counted. Kernels may return neither the arrays nor the tuple.
    """

    def __init__(self, parts: tuple, kind: type):
        super().__init__(parts, kind)
        words = f"{kind.__module__} {self.name}"
        self.name = f"{kind.__name__}.{hashlib.sha256(words.encode()).hexdigest()[:16]}"  # part of symbols


def shared(one: Any) -> Any:
    """Return numba's type of an argument, named tuples of arrays by address."""
    if not _is_tuple(one):
        return one
    parts = tuple(map(shared, one))
    if hasattr(one, "instance_class"):
        has_arrays = any(isinstance(part, types.Array | Shared) for part in parts)
        return Shared(parts, one.instance_class) if has_arrays and all(map(_is_plain, parts)) else one
    return types.BaseTuple.from_types(parts)


def _is_tuple(one: Any) -> bool:
    return isinstance(one, types.BaseTuple)


def _is_plain(one: Any) -> bool:
    """Return whether a part can be laid out in memory."""
    if _is_tuple(one) and not isinstance(one, Shared):
        return all(map(_is_plain, one))
    return isinstance(one, Shared | types.Array | types.Number | types.Boolean | types.NoneType)
