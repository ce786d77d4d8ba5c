"""Base class of results that only their check can create, and that can be neither changed nor pickled."""

from __future__ import annotations

from typing import ClassVar, NoReturn, Self


class Sealed:
    """A result of a check that only the check's function can create, and that cannot be changed afterwards.

    Other callers of the constructor get an error that names this function.

    Attributes
    ----------
    MAKER, INSTEAD : the function that creates it, and what to do instead of pickling it, in words
    """

    __slots__ = ()
    MAKER: ClassVar[str]
    INSTEAD: ClassVar[str]

    def _fill(self, judged: bool, **values: object) -> None:
        """Set the slots, if `judged` says that the caller has the maker's seal; else raise a TypeError."""
        if not judged:
            raise TypeError(f"{type(self).__name__} comes from {self.MAKER}, not from its constructor")
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"{type(self).__name__} does not change")

    def __delattr__(self, name: str) -> None:
        raise AttributeError(f"{type(self).__name__} does not change")

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: dict[int, object]) -> Self:
        return self

    def __reduce__(self) -> NoReturn:
        raise TypeError(f"{type(self).__name__} is not pickled: {self.INSTEAD}")
