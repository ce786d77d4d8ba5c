"""Samples of movements as files hold them, for all formats."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from comove.dmp.demonstrations.units import is_angle, is_length, is_of_joints, require_unit
from comove.errors import DemonstrationError, InputError, OptionError, listed, near_name

HZ, WHICH_UNIT = "HZ", "UNIT"
"""Words of a printed command for a rate and a unit that the file does not tell, which a person replaces."""
SAY_RATE = "give the samples a second, which the recorder's settings or the documentation tell: --rate HZ"
SAY_UNIT = f"replace {WHICH_UNIT} by m or mm of positions, by rad or deg of joints"


def fault(file: object, key: str | None, message: str, way_out: str, **options: Any) -> DemonstrationError:
    """Return the error about a recording, with place and advice.

    Parameters
    ----------
    options : options that solve the problem, for the printed command
    """
    error = DemonstrationError(message, file=file, key=key, way_out=way_out)
    error.options = options
    return error


@contextmanager
def advising(path: object, given: Mapping[str, Any]) -> Iterator[None]:
    """Append to a `fault` the command with given and solving options."""
    try:
        yield
    except DemonstrationError as error:
        if error.options and "; run: " not in error.way_out:
            error.way_out += f"; run: {learn_command(path, **{**given, **error.options})}"
        raise


def require_bytes(file: Path) -> None:
    """Raise if a file is empty."""
    if file.stat().st_size == 0:
        raise fault(file, None, "the file is empty", "copy or record it again")


@contextmanager
def decoding(file: object, what: str, broken: tuple[type[Exception], ...], way_out: str) -> Iterator[None]:
    """Convert a library's exceptions on damaged bytes to a fault."""
    try:
        yield
    except (InputError, Warning):
        raise
    except broken as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:160]
        raise fault(file, None, f"it is no whole {what} ({reason})", way_out) from error


def learn_command(path: object, **options: Any) -> str:
    """Return the command that learns from a recording with some options.

    >>> learn_command("my hand.csv", columns=["X", "Y"], rate=100, clean=None)
    "comove learn 'my hand.csv' --columns X,Y --rate 100 --out 'my hand.json'"
    """
    words = ["comove", "learn", str(path)]
    for key, value in options.items():
        if value is None or value is False:
            continue
        words.append(f"--{key.replace('_', '-')}")
        if value is not True:
            words.append(",".join(map(str, value)) if isinstance(value, list | tuple) else f"{value}")
    return shlex.join([*words, "--out", f"{Path(str(path)).stem}.json"])


AXES = ("x", "y", "z")
QUATERNION = ("qw", "qx", "qy", "qz")
SHOWN = 12
"""Names that a message lists."""

MAX_ROWS = 2_000_000
"""Samples that are read from one file."""
_EVEN_SHARE = 1e-3
"""How far stamps may lie from even ones, in steps, where a format knows only a rate."""


@dataclass(frozen=True)
class Origin:
    """Names of the places of samples in messages.

    Attributes
    ----------
    file : file from which the samples were read; None for arrays in memory
    time, orientation : functions of a sample's number that name its time stamp and its quaternion
    position : function of the numbers of a sample and a coordinate that names the number there
    axes : place of the coordinates' names
    """

    file: object = None
    time: Callable[[int], str] = lambda sample: f"time[{sample}]"
    position: Callable[[int, int], str] = lambda sample, dim: f"position[{sample}, {dim}]"
    orientation: Callable[[int], str] = lambda sample: f"orientation[{sample}]"
    axes: str = "axes"


IN_MEMORY = Origin()
TIME, UNIT = "time", "unit"
"""What a recording may state: that time is in seconds, and the unit of its positions or joints."""


@dataclass(frozen=True, eq=False)
class RecordedSamples:
    """One movement as read or to be written. `Demonstration` checks it and explains its fields.

    Attributes
    ----------
    stated : statements of the file or the user, which are not questioned: `TIME`, that time is in seconds, and `UNIT`
    origin : names of the places of its samples in the file
    """

    time: NDArray[np.float64]
    position: NDArray[np.float64]
    name: str = ""
    notes: tuple[str, ...] = ()
    unit: str = "m"
    orientation: NDArray[np.float64] | None = field(default=None, kw_only=True)
    axes: tuple[str, ...] = field(default=(), kw_only=True)
    stated: frozenset[str] = field(default=frozenset(), kw_only=True)
    origin: Origin = field(default=IN_MEMORY, kw_only=True, repr=False)

    @property
    def is_joints(self) -> bool:
        """Return whether the coordinates are joints', not an end effector's path."""
        return is_of_joints(self.unit) or (bool(self.axes) and not is_length(self.unit))

    def stating(self, unit: str) -> Self:
        """Return the movement with the unit that a user states.

        Raises
        ------
        OptionError
            If the unit is unknown, the recording states another one, or positions x, y, z were angles.
        """
        unit = require_unit(unit, self.origin.file)
        if unit != self.unit and (UNIT in self.stated or self.unit not in ("m", "rad")):
            raise OptionError(
                f"the recording says that it is in {self.unit}", key="unit", way_out="leave the unit out"
            )
        if is_angle(unit) and not self.is_joints:
            raise OptionError(
                f"its positions are no angles, as {unit} would be",
                key="unit",
                way_out="give a length, such as mm",
            )
        return replace(self, unit=unit, stated=self.stated | {UNIT})

    @property
    def n_steps(self) -> int:
        """Return the number of samples."""
        return self.position.shape[0]

    @property
    def n_dims(self) -> int:
        """Return the number of coordinates."""
        return self.position.shape[1]

    @property
    def duration(self) -> float:
        """Return the time of the last sample [s]."""
        return float(self.time[-1])


@dataclass(frozen=True)
class Format:
    """A kind of recordings: recognition, reading and writing of files.

    Attributes
    ----------
    name : name of the kind for users
    read : function of a path that returns the movements by manipulator. If the kind has `parts`, it returns those of
        each part, and takes the name of a single one as the keyword argument that `part` names
    suffixes : suffixes of its files, in lower case
    marker : file by which a folder of this kind is recognised
    part : kind of part, "episode" or "topic", of which a file may hold several; empty if it holds one recording
    parts : function of a path that returns the names of its parts; a mapping adds a word about each
    bodies : function of a path, and of the same options as `read`, that returns the names of the manipulators without
        reading their numbers; None if there is no cheaper way than to read them
    options : further options of `Demonstration.load` that `read` takes as keyword arguments, such as `rate`;
        others are refused
    write : function of a path and movements (`RecordedSamples`, or several of them by manipulator) that writes a file
    """

    name: str
    read: Callable[..., Mapping[str, RecordedSamples] | Mapping[str, Mapping[str, RecordedSamples]]]
    suffixes: tuple[str, ...] = ()
    marker: str = ""
    part: str = ""
    parts: Callable[[Any], Iterable[str]] = lambda path: ()
    bodies: Callable[..., Iterable[str]] | None = None
    options: frozenset[str] = frozenset()
    write: Callable[..., None] | None = None


def select_name(names: Iterable[str], name: str | None, file: object, what: str) -> str:
    """Return `name` if it exists, or the only name.

    Parameters
    ----------
    names : the existing names; texts among the values of a mapping describe them in messages
    what : kind of thing that is chosen: the key in messages

    Raises
    ------
    DemonstrationError
        If there are several and the name is missing, or the name is unknown; lists the names.
    """
    words = names if isinstance(names, Mapping) else dict.fromkeys(names)
    if name is None and len(words) == 1:
        return next(iter(words))
    if name in words:
        return str(name)
    known = [f"{key} ({word})" if isinstance(word, str) else key for key, word in words.items()]
    if name is None:
        message, way_out = f"it holds {len(words)} {what}s", f"name one of {listed(known, 20)}"
    else:
        message, way_out = f"there is no {name!r}", near_name(name, words).partition("known: ")[0]
        way_out += f"known: {listed(known, 20)}"
    raise fault(file, what, message, way_out, **{what: next(iter(words), None)})


def one_of(episodes: Sequence[str], episode: str | int | None, prefix: str, file: object) -> list[str]:
    """Return the names to read: all, or the requested one. It is given by its name or its number.

    Raises
    ------
    DemonstrationError
        If there is no such episode; lists the episodes.
    """
    if episode is None:
        return list(episodes)
    for name in (str(episode), f"{prefix}{episode}"):
        if name in episodes:
            return [name]
    raise fault(file, "episode", f"there is no episode {episode!r}", f"known: {listed(episodes, 20)}")


def by_manipulator(
    demos: RecordedSamples | Mapping[str, RecordedSamples], file: object, *, alike: bool = True
) -> dict[str, RecordedSamples]:
    """Return movements by manipulator, checked to fit into one file. A single one is under "".

    Parameters
    ----------
    alike : whether the format needs names, and common time stamps, dimensions and orientations

    Raises
    ------
    DemonstrationError
        If there are none, one of several has no name, they differ in time stamps or dimensions, or only some have
        orientations.
    """
    found = {"": demos} if isinstance(demos, RecordedSamples) else dict(demos)
    if not found:
        raise fault(file, None, "there is no movement to write", "give one at least")
    first_name, first = next(iter(found.items()))
    for name, demo in found.items() if alike else ():
        if len(found) > 1 and not name:
            raise fault(file, None, f"one of {len(found)} manipulators has no name", "name all of them")
        if not np.array_equal(demo.time, first.time) or demo.n_dims != first.n_dims:
            raise fault(
                file,
                None,
                f"{name!r} differs from {first_name!r} in its time stamps or dimensions",
                "bring both to the same duration and resampled(n_steps), or write a file for each",
            )
        if (demo.orientation is None) != (first.orientation is None):
            raise fault(
                file,
                None,
                f"only one of {name!r} and {first_name!r} has orientations",
                "give orientations to all or to none, or write a file for each",
            )
    return found


Episodes = (
    RecordedSamples
    | Mapping[str, RecordedSamples]
    | Sequence[RecordedSamples | Mapping[str, RecordedSamples]]
)
"""Episodes to write: one or several, each of one movement or of movements by manipulator."""


def as_episodes(episodes: Episodes, file: object) -> list[dict[str, RecordedSamples]]:
    """Return episodes as movements by manipulator, checked to fit one file.

    Raises
    ------
    DemonstrationError
        If there are none, movements of one episode do not belong together, or episodes differ in their manipulators
        or coordinates.
    """
    given = [episodes] if isinstance(episodes, RecordedSamples | Mapping) else list(episodes)
    if not given:
        raise fault(file, None, "there is no episode to write", "give one at least")
    found = [by_manipulator(episode, file) for episode in given]
    kinds = [[(name, demo.n_dims, demo.orientation is None) for name, demo in e.items()] for e in found]
    for index, kind in enumerate(kinds):
        if kind != kinds[0]:
            raise fault(
                file,
                None,
                f"episode {index} differs from episode 0 in its manipulators or their coordinates",
                "write a file for each kind",
            )
    return found


def even_rate(demos: Mapping[str, RecordedSamples], file: object) -> float:
    """Return the sampling rate [Hz] of movements with common stamps.

    Raises
    ------
    DemonstrationError
        If the time steps are not even.
    """
    demo = next(iter(demos.values()))
    rate = (demo.n_steps - 1) / demo.duration
    if math.isclose(rate, round(rate, 3), rel_tol=1e-9):
        rate = round(rate, 3)
    off = np.abs(demo.time * rate - np.arange(demo.n_steps))
    if off.max() > _EVEN_SHARE:
        row = int(off.argmax())
        raise fault(
            file,
            None,
            f"time[{row}] of {demo.name or 'the movement'} is {demo.time[row]:.6g} s, which is no even step at "
            f"{rate:.6g} Hz",
            "the format keeps a rate and no stamps: write demonstration.resampled(n_steps)",
        )
    return rate


def common_rate(episodes: Sequence[Mapping[str, RecordedSamples]], file: object) -> float:
    """Return the common sampling rate of all episodes [Hz].

    Raises
    ------
    DemonstrationError
        If the time steps are not even, or the episodes differ in them.
    """
    rates = [even_rate(demos, file) for demos in episodes]
    for index, rate in enumerate(rates):
        if not math.isclose(rate, rates[0], rel_tol=1e-9):
            raise fault(
                file,
                None,
                f"episode {index} runs at {rate:.6g} Hz and episode 0 at {rates[0]:.6g} Hz",
                "the format has one rate: resample the episodes",
            )
    return rates[0]
