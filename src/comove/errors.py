"""The exception tree.

Every error that a user can cause is an :class:`InputError`: it carries the file, the key and the
value that are wrong and the way out, and reads as one sentence.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

LONGEST_WORD, LONGEST_MESSAGE = 300, 3000
"""Characters of one word, and of a whole message, beyond which the middle is left out."""
MOST_KNOWN = 100
"""Names that are compared and listed."""


class ComoveError(Exception):
    """Root of everything that comove raises on purpose."""


class InputError(ComoveError):
    """Bad input, told in one sentence.

    Parameters
    ----------
    message
        What is wrong, with the offending value in it.
    file
        The file it stands in.
    key
        Where in the file: a dotted key, a row, an option.
    way_out
        What to write instead.
    """

    def __init__(self, message: str, *, file: object = None, key: str | None = None, way_out: str = ""):
        message, way_out = readable(message), readable(way_out)
        super().__init__(message)
        self.message, self.file, self.key, self.way_out = message, file, key, way_out

    def __str__(self) -> str:
        said = self.key is not None and self.message.startswith(f"{self.key} ")  # "period = 0" names its key
        parts = (self.file, None if said else self.key)
        place = ": ".join(readable(str(part)) for part in parts if part is not None)
        sentence = f"{place}: {self.message}" if place else self.message
        return f"{sentence}; {self.way_out}" if self.way_out else sentence


class DemonstrationError(InputError):
    """A recording that cannot be read or used."""


class LibraryError(InputError):
    """A primitive's file, or a library of them, that cannot be read, written or used."""


class SceneError(InputError):
    """A scene file, or a scene, that contradicts itself or the contract."""


class ResultError(InputError):
    """A result folder that is missing, incomplete or edited."""


class RobotError(InputError):
    """A robot's description or model that cannot be read or used, or a motion that is not its own."""


class ExtraError(ComoveError):
    """Something optional is not installed; the message holds the command that installs it.

    Parameters
    ----------
    what
        What needs it, in words.
    extra
        The extra of this package that brings it.
    """

    def __init__(self, what: str, extra: str):
        super().__init__(f"{what} needs more than the core: python -m pip install 'comove[{extra}]'")
        self.extra = extra


class OptionError(InputError):
    """An option or argument outside its range."""


class ConstraintError(InputError):
    """Constraints that cannot be met together near a movement."""


class ComoveWarning(UserWarning):
    """Something was changed or looks wrong, and the user should know."""


def shortened(text: str, limit: int = 120) -> str:
    """Leave out the middle of a long text.

    >>> shortened("9" * 1000, 20)
    '9999999999...9999999'
    """
    return text if len(text) <= limit else f"{text[: limit // 2]}...{text[len(text) - limit // 2 + 3 :]}"


def readable(message: str) -> str:
    """A message in which nothing that is quoted is too long to be read."""
    words = re.sub(rf"\S{{{LONGEST_WORD + 1},}}", lambda word: shortened(word[0]), message)
    return shortened(words, LONGEST_MESSAGE)


def plain(message: str) -> str:
    """A message whose characters a terminal shows; the others are escaped as Python does.

    Lines that are indented go on with the message; a line that is not comes from what is quoted.
    """
    lines = re.split(r"\n(?=  )", message)
    return "\n".join("".join(c if c.isprintable() else repr(c)[1:-1] for c in line) for line in lines)


def near_name(name: str, names: Iterable[str]) -> str:
    """Say which of the known `names` was probably meant, and list them all.

    >>> near_name("raduis", ["center", "radius"])
    "did you mean 'radius'? known: center, radius"
    """
    names, name = list(names), shortened(str(name))
    near = difflib.get_close_matches(name, names[:MOST_KNOWN], n=1, cutoff=0.6)
    guess = f"did you mean '{near[0]}'? " if near else ""
    more = f" and {len(names) - MOST_KNOWN} more" if len(names) > MOST_KNOWN else ""
    return f"{guess}known: {', '.join(names[:MOST_KNOWN])}{more}"
