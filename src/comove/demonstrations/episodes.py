"""Functions shared by the readers and writers of recordings: episodes of a file, and movements that share one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from comove.demonstrations.demonstration import Demonstration
from comove.errors import DemonstrationError

MAX_ROWS = 2_000_000
"""Samples that are read from one file."""
_EVEN_SHARE = 1e-3
"""How far stamps may lie from even ones, in steps, where a format knows only a rate."""


def one_of(episodes: Sequence[str], episode: str | int | None, prefix: str, file: object) -> list[str]:
    """Return the names to read: all, or only the requested one, given by its name or its number.

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
    shown = ", ".join(episodes[:20]) + (f" and {len(episodes) - 20} more" if len(episodes) > 20 else "")
    raise DemonstrationError(
        f"there is no episode {episode!r}", file=file, key="episode", way_out=f"known: {shown}"
    )


def as_episodes(
    episodes: Sequence[Demonstration | Mapping[str, Demonstration]], file: object
) -> list[dict[str, Demonstration]]:
    """Return each episode as movements by manipulator, after a check that one file can hold them.

    Raises
    ------
    DemonstrationError
        If there are none, movements of one episode do not belong together, or episodes differ in their manipulators
        or coordinates.
    """
    if isinstance(episodes, Demonstration | Mapping):
        episodes = [episodes]
    if not episodes:
        raise DemonstrationError("there is no episode to write", file=file, way_out="give one at least")
    episodes = [together(episode, file) for episode in episodes]
    kinds = [[(name, demo.n_dims, demo.orientation is None) for name, demo in e.items()] for e in episodes]
    for index, kind in enumerate(kinds):
        if kind != kinds[0]:
            raise DemonstrationError(
                f"episode {index} differs from episode 0 in its manipulators or their coordinates",
                file=file,
                way_out="write a file for each kind",
            )
    return episodes


def even_rate(demo: Demonstration, file: object) -> float:
    """Return the sampling rate [Hz] of a movement, for formats without time stamps.

    Raises
    ------
    DemonstrationError
        If its time steps are not even.
    """
    rate = (demo.n_steps - 1) / demo.duration
    if math.isclose(rate, round(rate, 3), rel_tol=1e-9):
        rate = round(rate, 3)
    off = np.abs(demo.time * rate - np.arange(demo.n_steps))
    if off.max() > _EVEN_SHARE:
        row = int(off.argmax())
        raise DemonstrationError(
            f"time[{row}] of {demo.name or 'the movement'} is {demo.time[row]:.6g} s, which is no even step at "
            f"{rate:.6g} Hz",
            file=file,
            way_out="the format keeps a rate and no stamps: write demonstration.resampled(n_steps)",
        )
    return rate


def together(demos: Demonstration | Mapping[str, Demonstration], file: object) -> dict[str, Demonstration]:
    """Return movements by manipulator after a check that one file can hold them.

    A single `Demonstration` has the name "".

    Raises
    ------
    DemonstrationError
        If there are none, one of several has no name, they differ in time stamps or dimensions, or only some have
        orientations.
    """
    demos = {"": demos} if isinstance(demos, Demonstration) else dict(demos)
    if not demos:
        raise DemonstrationError("there is no movement to write", file=file, way_out="give one at least")
    first_name, first = next(iter(demos.items()))
    for name, demo in demos.items():
        if len(demos) > 1 and not name:
            raise DemonstrationError(
                f"one of {len(demos)} manipulators has no name", file=file, way_out="name all of them"
            )
        if not np.array_equal(demo.time, first.time) or demo.n_dims != first.n_dims:
            raise DemonstrationError(
                f"{name!r} differs from {first_name!r} in its time stamps or dimensions",
                file=file,
                way_out="bring both to the same duration and resampled(n_steps), or write a file for each",
            )
        if (demo.orientation is None) != (first.orientation is None):
            raise DemonstrationError(
                f"only one of {name!r} and {first_name!r} has orientations",
                file=file,
                way_out="give orientations to all or to none, or write a file for each",
            )
    return demos
