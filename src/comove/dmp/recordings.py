"""Recordings by name: a file or lasa:SHAPE:DEMO."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from comove.dmp.demonstrations import Demonstration, formats
from comove.dmp.demonstrations.plausibility import doubts
from comove.dmp.demonstrations.samples import fault
from comove.dmp.files import Primitive, checksum
from comove.errors import ComoveError, DemonstrationError

LASA = "lasa:"
ALL = ":all"  # of the recordings of a shape


@dataclass(frozen=True, eq=False)
class NamedRecording:
    """A movement of a recording.

    Attributes
    ----------
    demonstration : the movement
    source : the recording's name without its folder, for the provenance of a primitive
    name : a name for a primitive that is learned from it
    """

    demonstration: Demonstration
    source: str
    name: str


def read_recordings(
    named: str,
    manipulator: str | None = None,
    episode: str | None = None,
    topic: str | None = None,
    **options: Any,
) -> list[NamedRecording]:
    """Return the movements of a recording, or the chosen one.

    Parameters
    ----------
    named : path of a file, or lasa:SHAPE or lasa:SHAPE:DEMO
    manipulator, episode, topic, options : as for `Demonstration.load`
    """
    if named.startswith(LASA):
        shape, _, number = named.removeprefix(LASA).partition(":")
        if number and not number.isdigit():
            raise DemonstrationError(
                f"{number!r} is no recording", file=named, way_out="write lasa:SHAPE:0 to :6"
            )
        count = int(number or 0)
        return [
            NamedRecording(
                Demonstration.from_lasa(shape, count), f"{LASA}{shape}:{count}", f"{shape}-{count}"
            )
        ]
    if (manipulator, episode, topic) == (None, None, None) and not options:
        path = Path(named)
        found = Demonstration.load_all(path)
        alone = len(found) == 1
        return [
            NamedRecording(one, _source(path), name_from(path.stem if alone else one.name or path.stem))
            for one in found
        ]
    return [read_recording(named, manipulator, episode, topic, **options)]


def _source(path: Path) -> str:
    return path.name.encode(errors="replace").decode()


def is_several(named: str) -> bool:
    """Return whether a name means several recordings: a folder or lasa:SHAPE:all."""
    if named.startswith(LASA):
        return named.endswith(ALL)
    path = Path(named)
    try:
        return path.is_dir() and not formats.is_format(path)
    except (OSError, ValueError):
        return False


def read_several(
    names: Sequence[str], **options: Any
) -> tuple[list[Demonstration | dict[str, Demonstration]], list[str]]:
    """Return recordings for a distribution, and their names without folders.

    Parameters
    ----------
    names : files that hold one recording or several, folders of such files, lasa:SHAPE:DEMO, or lasa:SHAPE:all
    options : as for `Demonstration.load`; each file then holds one recording
    """
    found: list[Demonstration | dict[str, Demonstration]] = []
    sources: list[str] = []
    for named in _spelt_out(names):
        if named.startswith(LASA) or options:
            one = read_recording(named, **options)
            found.append(one.demonstration)
            sources.append(one.source)
            continue
        for i, recording in enumerate(Demonstration.load_recordings(named)):
            found.append(recording[""] if list(recording) == [""] else recording)
            sources.append(Path(named).name if i == 0 else f"{Path(named).name}, recording {i}")
    return found, sources


def _spelt_out(names: Sequence[str]) -> list[str]:
    """Return the names with folders and lasa:SHAPE:all expanded."""
    from comove.dmp.demonstrations.formats.lasa import N_DEMOS

    spelt: list[str] = []
    for named in names:
        if named.startswith(LASA) and named.endswith(ALL):
            spelt += [f"{named.removesuffix(ALL)}:{k}" for k in range(N_DEMOS)]
        elif is_several(named):
            inner = sorted(p for p in Path(named).iterdir() if p.name[0] != "." and formats.is_format(p))
            if not inner:
                raise DemonstrationError(
                    "it holds no recordings", file=named, way_out="put recordings there, such as .csv or .npz"
                )
            spelt += map(str, inner)
        else:
            spelt.append(named)
    return spelt


def read_recording(
    named: str,
    manipulator: str | None = None,
    episode: str | None = None,
    topic: str | None = None,
    **options: Any,
) -> NamedRecording:
    """Return the only movement of a recording, or the chosen one. Nothing else is read.

    Arguments and errors are those of `read_recordings`; if there are several movements, the error lists them.
    """
    if named.startswith(LASA):
        return read_recordings(named)[0]
    path = Path(named)
    one = Demonstration.load(path, manipulator, episode=episode, topic=topic, **options)
    chosen = ".".join(choice for choice in (path.stem, episode, manipulator, topic) if choice)
    return NamedRecording(one, _source(path), name_from(chosen))


def recording_of(primitive: Primitive) -> Demonstration | None:
    """Return a primitive's recording, None if missing or changed."""
    if primitive.provenance is None:
        return None
    try:
        for recording in read_recordings(primitive.provenance.source):
            if checksum(recording.demonstration) == primitive.provenance.sha256:
                return recording.demonstration
    except ComoveError:
        pass
    return None


def require_plausible(recording: Demonstration, named: str) -> None:
    """Raise DemonstrationError for numbers implausible in their unit. Stated units are accepted.

    Raises
    ------
    DemonstrationError
        The message names a plausible unit, and the option that states it.
    """
    found = doubts(recording.time, recording.position, recording.unit, stated=recording.stated)
    for doubt in found:
        if doubt.is_unit:
            raise fault(named, doubt.key, doubt.message, doubt.way_out, **doubt.options)


def name_from(text: str) -> str:
    """Return a valid name for a primitive, made from any text.

    >>> name_from("reach & grasp (2)")
    'reach-grasp-2'
    """
    return re.sub(r"[^\w.+-]+", "-", text).strip("-.+")[:100] or "movement"
