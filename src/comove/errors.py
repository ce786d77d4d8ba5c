"""Exceptions and warnings of comove, and helpers for their messages.

Every error that a user can cause is an :class:`InputError`: it holds the file, the key, the wrong value and its
correction, and reads as one sentence.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar

LONGEST_WORD, LONGEST_MESSAGE = 300, 3000
"""Characters of one word, and of a whole message, beyond which the middle is left out."""
MOST_KNOWN = 100
"""Names that are compared and listed."""


class ComoveError(Exception):
    """Base class of all exceptions that comove raises on purpose.

    An `InputError` can be fixed by the user, an `ExtraError` by installing a package. Any other exception is a bug of
    comove: please report it.

    Examples
    --------
    >>> import comove
    >>> try:
    ...     comove.Scene.load("mine.yaml")
    ... except comove.errors.ComoveError as error:
    ...     print(error)
    mine.yaml: there is no such file; ...
    """

    says_all: ClassVar[bool] = False
    """Whether its messages leave nothing to explain; the command line names the explanation of all others."""


class InputError(ComoveError):
    """Error in the user's input; the message is one sentence.

    The parts of the sentence are attributes.

    Parameters
    ----------
    message
        The error, with the wrong value.
    file
        The file that holds the wrong value.
    key
        The place in the file: a dotted key, a row, an option.
    way_out
        The correction.

    Examples
    --------
    >>> import comove
    >>> try:
    ...     comove.DMP.fit(comove.Demonstration.from_lasa("Sine"), n_basis=0)
    ... except comove.errors.InputError as error:
    ...     print(error.message, "->", error.way_out)
    n_basis = 0 -> give a whole number from 1 to 200
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
    """Recording that cannot be read or used.

    The format does not match the file name, cells are empty or not numeric, time does not advance, or one file holds
    several recordings. Name the columns and the unit of a table, or which of several recordings is meant; leave out
    rows with missing cells.

    Examples
    --------
    >>> from pathlib import Path
    >>> import comove
    >>> _ = Path("hand.csv").write_text("time,x,y\\n0.0,0.1,0.2\\n0.1,0.2,\\n")
    >>> comove.Demonstration.load("hand.csv")
    Traceback (most recent call last):
    comove.errors.DemonstrationError: hand.csv: row 3, column y: the cell is empty; fill in what was measured, or
        leave such rows out: --drop-missing; run: comove learn hand.csv --drop-missing --out hand.json
    """

    options: Mapping[str, Any] = MappingProxyType({})
    """Options of reading the recording that settle the matter."""


class LibraryError(InputError):
    """Primitive or library that cannot be read, written or used.

    The file is missing, truncated, edited (its checksum differs) or of another basis, or the library has no movement
    of that name. Learn the movement again from its recording, whose checksum the file holds.

    Examples
    --------
    >>> import comove
    >>> comove.Library("movements")["Sine"]
    Traceback (most recent call last):
    comove.errors.LibraryError: movements: there is no primitive 'Sine'; the library is empty: comove library add DEMO
    """


class SceneError(InputError):
    """Scene that contradicts itself or violates the format.

    Correct the named key in the named line. Frequent causes: end effectors whose distance differs from the payload's
    length, a start or goal inside an obstacle, a duration that the limits do not allow, a misspelt key.

    Examples
    --------
    >>> import comove
    >>> comove.Scene.from_dict({
    ...     "name": "short",
    ...     "workspace": {"lower": [0, 0], "upper": [1, 1]},
    ...     "load": {"shape": "bar", "length": 0.2},
    ...     "manipulators": [
    ...         {"name": "left", "start": [0.2, 0.3], "goal": [0.8, 0.3]},
    ...         {"name": "right", "start": [0.2, 0.6], "goal": [0.8, 0.5]},
    ...     ],
    ... })
    Traceback (most recent call last):
    comove.errors.SceneError: manipulators[0].start, manipulators[1].start: 'left' and 'right' are 0.3 m apart at the
        start, but they must be 0.2 m apart (tolerance 0.0002 m); move one of them or correct the distance
    """


class TaskError(InputError):
    """Task that contradicts itself, or whose phase cannot be carried out.

    The key is the phase. Add what is missing before it, or give it other grasps, another goal or more budget.

    Examples
    --------
    >>> import numpy as np
    >>> from comove.tasks import Body, Grasp
    >>> cup = Body("cup", ({"shape": "box", "size": [0.1, 0.1, 0.1]},), 0.2, np.eye(4))
    >>> Grasp(cup, site="handle")
    Traceback (most recent call last):
    comove.errors.TaskError: site: the body 'cup' has no site 'handle'; give a position in the body's frame
    """


class MeshError(InputError):
    """Mesh that cannot be used.

    The file is truncated, holds values that are not numbers, or has too many triangles. Export it again, or give a
    simpler mesh: for a payload, its convex hull.

    Examples
    --------
    >>> from comove.geometry.triangles import triangles_of
    >>> triangles_of(b"solid part\\nfacet normal 0 0 1\\n", ".stl")
    Traceback (most recent call last):
    comove.errors.MeshError: its facet 1 is not whole; write it anew: it is cut off or damaged
    """


class ResultError(InputError):
    """Result folder that is missing, incomplete or edited, or cannot be written.

    Checksums reveal files edited since comove wrote them. Solve again, or name the folder that `comove solve` wrote;
    a folder that holds anything else is never replaced.

    Examples
    --------
    >>> from comove.results import read_result
    >>> read_result("nowhere")
    Traceback (most recent call last):
    comove.errors.ResultError: nowhere: there is no such folder; make it by: comove solve SCENE --out DIR
    """


class RobotError(InputError):
    """Robot model that cannot be used, or motion of another robot.

    `comove robot check FILE` lists all errors of a description and draws the workspace of the arms: start and goal of
    a scene must be within reach of all of them.

    Examples
    --------
    >>> from comove.robots import Robot
    >>> Robot.load("bakster")
    Traceback (most recent call last):
    comove.errors.RobotError: robot: there is no robot 'bakster', nor a file of that name; did you mean 'baxter'? ...
    """


class ExportError(RobotError):
    """Motion that cannot be exported, or not to this place.

    Only motions verified in joint space are exported, never over existing files, and never so coarsely that
    interpolation bends the payload. Run `comove solve`, or give another folder or a higher rate.

    Examples
    --------
    >>> import comove
    >>> from comove.ros import parts_of
    >>> parts_of(comove.solve(comove.Scene.load("narrow.yaml"), seed=0).motion)
    Traceback (most recent call last):
    comove.errors.ExportError: motion: the motion is a VerifiedMotion, not a verified one of joints; ...
    """


class SendError(RobotError):
    """Motion that was not started, or did not end well.

    A controller, the joint states or ROS itself are missing, the clocks differ, the robot is not at the motion's
    start, or it deviates from the motion. `outcome` is None if nothing has moved; otherwise it says how far each arm
    came, and all arms were commanded to stop: inspect the robot before anything else.

    Examples
    --------
    >>> import sys
    >>> from comove.ros import Ros1Client
    >>> Ros1Client(python=sys.executable).connect({}, timeout=1.0)
    Traceback (most recent call last):
    comove.errors.SendError: ros: no Python here has ROS 1; tried ...; install rospy, actionlib and trajectory_msgs,
        and name their Python in COMOVE_ROS_PYTHON
    """

    outcome: object = None
    """The `comove.ros.SendOutcome`, if the motion began."""


class OptionError(InputError):
    """Option or argument outside its range.

    The message states the range, or the known names.

    Examples
    --------
    >>> import comove
    >>> comove.Demonstration.from_lasa("Sine").resampled(1)
    Traceback (most recent call last):
    comove.errors.OptionError: n_steps: 1 is no number of steps; give 2 or more
    """

    says_all = True


class ExtraError(ComoveError):
    """Missing optional package; the message holds the command that installs it.

    Parameters
    ----------
    what
        The feature that needs the package, in words.
    extra
        The name of the extra of this package that installs it.

    Examples
    --------
    >>> import sys
    >>> import comove
    >>> sys.modules["viser"] = None                      # as if it were not installed
    >>> comove.show(comove.Scene.load("narrow.yaml"))
    Traceback (most recent call last):
    comove.errors.ExtraError: the workbench in the browser needs more than the core:
        python -m pip install 'comove[view]'
    """

    says_all = True

    def __init__(self, what: str, extra: str):
        super().__init__(f"{what} needs more than the core: python -m pip install 'comove[{extra}]'")
        self.extra = extra


class ComoveWarning(UserWarning):
    """Warning about a value that was changed or looks wrong.

    For example, an end effector was moved to fit the payload, a mesh was repaired, or noise was removed. Nothing
    needs to be done if that is intended. `warnings.simplefilter("error", comove.errors.ComoveWarning)` turns them
    into errors.

    Examples
    --------
    >>> import warnings
    >>> import comove
    >>> with warnings.catch_warnings(record=True) as told:
    ...     few = comove.DMP.fit(comove.Demonstration.from_lasa("Sine").resampled(10), n_basis=20)
    >>> print(told[0].message)
    the recording has 10 samples for 20 weights a dimension, and ...
    """


def kinds() -> dict[str, type[ComoveError] | type[ComoveWarning]]:
    """Return all exception and warning classes by name, in source order."""
    return {
        name: kind
        for name, kind in globals().items()
        if isinstance(kind, type) and issubclass(kind, (ComoveError, ComoveWarning))
    }


def shortened(text: str, limit: int = 120) -> str:
    """Return a text, its middle left out beyond `limit` characters.

    >>> shortened("9" * 1000, 20)
    '9999999999...9999999'
    """
    return text if len(text) <= limit else f"{text[: limit // 2]}...{text[len(text) - limit // 2 + 3 :]}"


def readable(message: str) -> str:
    """Return a message with long words, and the message itself, shortened."""
    words = re.sub(rf"\S{{{LONGEST_WORD + 1},}}", lambda word: shortened(word[0]), message)
    return shortened(words, LONGEST_MESSAGE)


def printable(text: str) -> str:
    """Return a text in one line, unprintable characters escaped as in Python.

    It is safe to print in a terminal. Path bytes that the environment's encoding lacks are shown as their UTF-8
    letters.

    >>> printable("over\\x1b[2Jwritten")
    'over\\\\x1b[2Jwritten'
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in letters(text))


def letters(text: str) -> str:
    """Return a text with surrogate-escaped path bytes decoded as UTF-8.

    Python keeps bytes of paths in that form where the environment's encoding lacks the letters.

    >>> letters("gro\\udcc3\\udc9f")
    'groß'
    """

    def decoded(found: re.Match[str]) -> str:
        return found[0].encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")

    return re.sub("[\udc80-\udcff]+", decoded, text)


def plain(message: str) -> str:
    """Return a message that is safe to print in a terminal.

    Unprintable characters are escaped as in Python. An indented line continues the message; a line that is not
    indented comes from quoted text, so its line break is escaped too.
    """
    return "\n".join(map(printable, re.split(r"\n(?=  )", message)))


def near_name(name: str, names: Iterable[str]) -> str:
    """Return a sentence that suggests the nearest name and lists all.

    >>> near_name("raduis", ["center", "radius"])
    "did you mean 'radius'? known: center, radius"
    """
    names, name = list(names), shortened(str(name))
    near = difflib.get_close_matches(name, names[:MOST_KNOWN], n=1, cutoff=0.6)
    guess = f"did you mean '{near[0]}'? " if near else ""
    return f"{guess}known: {listed(names)}"


def listed(names: Sequence[str], most: int = MOST_KNOWN) -> str:
    """Return names in one line, shortened to `most` with a count.

    >>> listed(["a", "b", "c", "d"], 2)
    'a, b and 2 more'
    """
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
