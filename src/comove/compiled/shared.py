"""Named tuples of arrays, which kernels take by their address.

numba by itself passes every array of a named tuple as seven numbers or more, to every function, and handles the tuple
as one value of hundreds of numbers: most of the code of a planner, and of the time to compile it, would be copies.
A tuple that holds arrays and comes from Python is therefore laid out in memory once a call, and kernels are given its
address, from which they load what they use; `lowering` says how. Tuples that kernels make are numba's own.
"""

from __future__ import annotations

import hashlib
from typing import Any

from numba.core import types


class Shared(types.NamedTuple):
    """The type of a named tuple in memory, none of which changes during a call.

    Arrays that a kernel loads from it are not counted. Kernels may not return them, nor the tuple.
    """

    def __init__(self, parts: tuple, kind: type):
        super().__init__(parts, kind)
        words = f"{kind.__module__} {self.name}"
        self.name = f"{kind.__name__}.{hashlib.sha256(words.encode()).hexdigest()[:16]}"  # part of symbols


def shared(one: Any) -> Any:
    """Return numba's type of an argument from Python, with named tuples of arrays by their address."""
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
