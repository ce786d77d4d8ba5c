"""The exceptions and warnings of comove, and helpers that word their messages.

Every error that a user can cause is an :class:`InputError`: it carries the file, the key and the
value that are wrong and how to correct them, and reads as one sentence.
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
    """Root class of all exceptions that comove raises on purpose."""


class InputError(ComoveError):
    """Raised when the user's input is wrong; the message is one sentence.

    Parameters
    ----------
    message
        What is wrong, with the wrong value.
    file
        The file that holds the wrong value.
    key
        The place in the file: a dotted key, a row, an option.
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
    """Raised when a recording cannot be read or used."""


class LibraryError(InputError):
    """Raised when a primitive's file, or a library of primitives, cannot be read, written or used."""


class SceneError(InputError):
    """Raised when a scene file, or a scene, contradicts itself or breaks the rules of the format."""


class ResultError(InputError):
    """Raised when a result folder is missing, incomplete or edited."""


class RobotError(InputError):
    """Raised when a robot's description or model cannot be used, or when a motion does not belong to the robot."""


class ExtraError(ComoveError):
    """Raised when an optional package is not installed; the message holds the command that installs it.

    Parameters
    ----------
    what
        The feature that needs the package, in words.
    extra
        The name of the extra of this package that installs it.
    """

    def __init__(self, what: str, extra: str):
        super().__init__(f"{what} needs more than the core: python -m pip install 'comove[{extra}]'")
        self.extra = extra


class OptionError(InputError):
    """Raised when an option or argument is outside its range."""


class ConstraintError(InputError):
    """Raised when the constraints cannot be met together near a movement."""


class ComoveWarning(UserWarning):
    """Issued when a value was changed or looks wrong, and the user should know."""


def shortened(text: str, limit: int = 120) -> str:
    """Return a text without its middle where it is longer than `limit` characters.

    >>> shortened("9" * 1000, 20)
    '9999999999...9999999'
    """
    return text if len(text) <= limit else f"{text[: limit // 2]}...{text[len(text) - limit // 2 + 3 :]}"


def readable(message: str) -> str:
    """Return a message in which long words, and the message as a whole, are shortened so that it can be read."""
    words = re.sub(rf"\S{{{LONGEST_WORD + 1},}}", lambda word: shortened(word[0]), message)
    return shortened(words, LONGEST_MESSAGE)


def plain(message: str) -> str:
    """Return a message whose unprintable characters are escaped as Python does, so that a terminal shows it safely.

    An indented line continues the message. A line that is not indented comes from quoted text: its line break is
    escaped too.
    """
    lines = re.split(r"\n(?=  )", message)
    return "\n".join("".join(c if c.isprintable() else repr(c)[1:-1] for c in line) for line in lines)


def near_name(name: str, names: Iterable[str]) -> str:
    """Return a sentence that suggests the known name nearest to `name` and lists the known `names`.

    >>> near_name("raduis", ["center", "radius"])
    "did you mean 'radius'? known: center, radius"
    """
    names, name = list(names), shortened(str(name))
    near = difflib.get_close_matches(name, names[:MOST_KNOWN], n=1, cutoff=0.6)
    guess = f"did you mean '{near[0]}'? " if near else ""
    more = f" and {len(names) - MOST_KNOWN} more" if len(names) > MOST_KNOWN else ""
    return f"{guess}known: {', '.join(names[:MOST_KNOWN])}{more}"
