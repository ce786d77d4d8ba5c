"""Base class of results that only their check can create, and that are not pickled."""

from __future__ import annotations

from typing import ClassVar, NoReturn, Self


class Sealed:
    """A result of a check that only the check's function can create; a frozen dataclass, so that it does not change.

    Other callers of the constructor get an error that names this function.

    Attributes
    ----------
    MAKER, INSTEAD : the function that creates it, and what to do instead of pickling it, in words
    """

    __slots__ = ()
    MAKER: ClassVar[str]
    INSTEAD: ClassVar[str]

    def _require(self, sealed: bool) -> None:
        """Raise a TypeError unless the caller of the constructor had the maker's seal."""
        if not sealed:
            raise TypeError(f"{type(self).__name__} comes from {self.MAKER}, not from its constructor")

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: dict[int, object]) -> Self:
        return self

    def __reduce__(self) -> NoReturn:
        raise TypeError(f"{type(self).__name__} is not pickled: {self.INSTEAD}")
