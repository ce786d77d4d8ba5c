"""What only its judge makes: it does not change, and it is not carried elsewhere as if it had been judged there."""

from __future__ import annotations

from typing import ClassVar, NoReturn, Self


class Sealed:
    """A result of a judgement: its maker fills it once, whoever else calls the constructor is told who that is.

    Attributes
    ----------
    MAKER, INSTEAD : the function that makes it, and what to do where it cannot be pickled, in words
    """

    __slots__ = ()
    MAKER: ClassVar[str]
    INSTEAD: ClassVar[str]

    def _fill(self, judged: bool, **values: object) -> None:
        """Set the slots, if the caller has the maker's seal."""
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
