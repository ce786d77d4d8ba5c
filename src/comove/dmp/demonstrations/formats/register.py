"""The register of file formats.

A format turns files into `comove.dmp.demonstrations.samples.RecordedSamples` and back; it uses no `Demonstration`.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, cast

from comove.dmp.demonstrations.bodies import matching_body
from comove.dmp.demonstrations.formats import hdf5, lerobot, npz, rosbag, tables
from comove.dmp.demonstrations.samples import Format, RecordedSamples, advising, fault, select_name
from comove.errors import near_name
from comove.io.files import require_content, telling

FORMATS: list[Format] = [
    tables.FORMAT,
    npz.FORMAT,
    hdf5.FORMAT,
    lerobot.FORMAT,
    rosbag.FORMAT,
]


_OTHERS = (
    ".json",
    ".yaml",
    ".yml",
    ".toml",
    ".xml",
    ".py",
    ".md",
    ".bvh",
    ".ply",
    ".pcd",
    ".obj",
    ".off",
    ".stl",
)
"""Suffixes of texts that are no tables of movements."""


def format_of(path: str | os.PathLike[str]) -> Format:
    """Return the format of a file or folder by suffix or content.

    Raises
    ------
    DemonstrationError
        If no format has that suffix, or the folder holds none.
    """
    path = Path(path)
    folders = [format for format in FORMATS if format.marker]
    with telling(path):
        is_folder, exists = path.is_dir(), path.is_file()
        for format in folders:
            if is_folder and (path / format.marker).exists():
                return format
    if is_folder:
        known = " or ".join(f"{format.marker} ({format.name})" for format in folders)
        raise fault(
            path, None, f"it is a folder without {known}", "name the folder that holds one of them, or a file"
        )
    if exists:
        require_content(path)
    kinds = {suffix: format for format in FORMATS for suffix in format.suffixes}
    if path.suffix.lower() not in kinds:
        if exists and path.suffix.lower() not in _OTHERS and tables.is_table(path):
            return tables.FORMAT
        way_out = near_name(path.suffix, kinds)
        if path.suffix.lower() == ".npy":
            table = path.with_suffix(".csv").name
            way_out = (
                f"write it as a table: numpy.savetxt({table!r}, numpy.load({path.name!r}), delimiter=',')"
            )
        raise fault(path, None, f"its kind {path.suffix!r} is not known", way_out)
    return kinds[path.suffix.lower()]


def write(path: str | os.PathLike[str], demos: RecordedSamples | Mapping[str, RecordedSamples]) -> None:
    """Write one or several movements in the format of the suffix.

    Raises
    ------
    DemonstrationError
        If no format has that suffix or its format is only read, or as the format's writer.
    """
    writers = {suffix: format.write for format in FORMATS for suffix in format.suffixes if format.write}
    suffix = Path(path).suffix
    if suffix.lower() not in writers:
        raise fault(path, None, f"its kind {suffix!r} is not written", near_name(suffix, writers))
    writers[suffix.lower()](path, demos)


NO_OPTIONS: Mapping[str, Any] = {}
OPTIONS = {
    "manipulator": "a bag knows topics, not manipulators",
    "episode": "it holds one recording",
    "topic": "only bags have topics",
    "columns": "its columns are not chosen",
    "delimiter": "only text tables have delimiters",
    "time": "its time is not chosen",
    "rate": "it has time stamps of its own",
}
"""Why a kind of file refuses an option that belongs to other kinds."""


def load(
    path: str | os.PathLike[str],
    manipulator: str | None = None,
    *,
    unit: str | None = None,
    options: Mapping[str, Any] = NO_OPTIONS,
) -> RecordedSamples:
    """Return one movement; see `Demonstration.load`.

    Options that the format does not have are refused by name; those that are None count as not given.
    """
    path = Path(path)
    said = {"manipulator": manipulator, "unit": unit, **options}
    with advising(path, {key: value for key, value in said.items() if value is not None}):
        return _load(path, format_of(path), manipulator, unit, options)


def _load(
    path: Path, format: Format, manipulator: str | None, unit: str | None, options: Mapping[str, Any]
) -> RecordedSamples:
    given = {key: value for key, value in options.items() if value is not None}
    reading = {key: given.pop(key) for key in sorted(format.options & set(given))}
    part = given.pop(format.part, None)
    if format.part == "topic" and manipulator is not None:
        given["manipulator"] = manipulator
    for key, value in given.items():
        shown = ",".join(map(str, value)) if isinstance(value, list | tuple) else value
        reason = OPTIONS.get(key, f"{format.name} has no such option")
        raise fault(path, key, f"{shown!r} was asked for, but {reason}", f"leave the {key} out")
    states = "unit" in format.options
    if unit is not None and states:
        reading["unit"] = unit
    if not format.part:
        if format.bodies is not None:
            manipulator = chosen_name(format.bodies(path, **reading), manipulator, path)
            reading["manipulator"] = manipulator or None
        movements = cast(Mapping[str, RecordedSamples], format.read(path, **reading))
        found = movements[chosen_name(movements, manipulator or None, path)]
    else:
        if part is None and "dataset" not in reading:
            part = select_name(format.parts(path), None, path, format.part)
        parts = format.read(path, **{format.part: part}, **reading)
        read = parts[select_name(parts, None, path, format.part)]
        found = read if isinstance(read, RecordedSamples) else read[chosen_name(read, manipulator, path)]
    return found if unit is None or states else found.stating(unit)


def load_recordings(path: str | os.PathLike[str]) -> tuple[dict[str, RecordedSamples], ...]:
    """Return all recordings by manipulator; see `Demonstration.load_recordings`."""
    path = Path(path)
    found = format_of(path).read(path)
    alone = {name: entry for name, entry in found.items() if isinstance(entry, RecordedSamples)}
    if alone:
        return (alone,)
    return tuple(dict(cast(Mapping[str, RecordedSamples], entry)) for entry in found.values())


def is_format(path: Path) -> bool:
    """Return whether a path has a known suffix, or marker file."""
    if path.is_dir():
        return any(format.marker and (path / format.marker).exists() for format in FORMATS)
    suffix = path.suffix.lower()
    return any(suffix in format.suffixes for format in FORMATS) and (
        suffix != ".txt" or tables.is_table(path)
    )


def select(demos: Mapping[str, RecordedSamples], manipulator: str | None, file: object) -> RecordedSamples:
    """Return one of the movements of a recording, selected by its manipulator.

    Raises
    ------
    DemonstrationError
        If there are several and the name is missing, or the name is unknown.
    """
    return demos[chosen_name(demos, manipulator, file)]


def chosen_name(names: Iterable[str], manipulator: str | None, file: object) -> str:
    """Return the movement's name that a manipulator's name means."""
    names = list(names)
    if names == [""] and manipulator is not None:
        raise fault(
            file,
            "manipulator",
            f"it holds one movement without a name, not {manipulator!r}",
            "leave the manipulator out",
        )
    meant = None if manipulator is None else matching_body(manipulator, names)
    return select_name(names, meant or manipulator, file, "manipulator")
