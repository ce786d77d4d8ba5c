"""The names of keys in a scene's file, for messages. Only files of version 2 have their own."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

from comove.io.keys import KeyPath, place


class Words(NamedTuple):
    """Names and lines of a scene's keys in its file.

    Attributes
    ----------
    version : version of the file
    lines : lines of its keys, by their paths; None where the file has other keys
    hands : paths in the file of the end effectors
    obstacles : numbers in the file of the obstacles
    imported : those of them that are files of several
    grasps : names of arms, points of the payload [m], and paths of the grasps in the file
    """

    version: int = 1
    lines: Mapping[KeyPath, int] | None = None
    hands: tuple[KeyPath, ...] = ()
    obstacles: tuple[int, ...] = ()
    imported: frozenset[int] = frozenset()
    grasps: tuple[tuple[str, tuple[float, ...], KeyPath], ...] = ()

    def path(self, path: KeyPath) -> KeyPath:
        """Return the path in the file of a key of `SceneFile`."""
        if self.version == 1 or not path:
            return path
        first, *rest = path
        if first == "grasp" or (first == "load" and rest[:1] == ["grasps"]):
            return ("grasps", *(rest[1:] if first == "load" else ()))
        if first == "load":
            return ("payload", *rest)
        if first == "obstacles" and rest and isinstance(rest[0], int):
            return ("obstacles", self.obstacles[rest[0]], *rest[1:])
        if first == "manipulators":
            number = int(rest.pop(0)) if rest and isinstance(rest[0], int) else 0
            hand = self.hands[number]
            if not rest:
                return hand[:1]
            return ("payload", *rest) if hand[0] == "grasps" else (*hand, *rest)
        return path

    def key(self, key: str) -> str:
        """Return a message's keys, separated by commas, as in the file."""
        if self.version == 1:
            return key
        paths = [
            self.path(
                tuple[str | int, ...](
                    int(part) if part.isdigit() else part for part in re.findall(r"[^.\[\]]+", one)
                )
            )
            for one in key.split(", ")
        ]
        return ", ".join(dict.fromkeys(place(path, self.lines or {}) or "" for path in paths))

    def support(self, obstacle: int, name: str) -> str:
        """Return what makes an obstacle, called `name`, a support."""
        key = self.key(f"obstacles[{obstacle}]")
        is_imported = self.version != 1 and self.obstacles[obstacle] in self.imported
        return f"supports: [{name}] in {key}" if is_imported else f"support: true in {key}"

    def grasp(self, name: str, point: tuple[float, ...] | None) -> str:
        """Return the key of an arm's grasp at a point [m]; None for its only grasp."""
        if self.version == 1:
            return "load"
        written = (path for who, at, path in self.grasps if who == name and point in (at, None))
        return place(next(written, ("grasps", name)), self.lines or {}) or ""

    def moved(self, end: str) -> str:
        """Return the name of the payload's position at an end."""
        return f"the {end} of every manipulator" if self.version == 1 else f"payload.{end}.position"

    @property
    def hand(self) -> str:
        """Return the name of an end effector."""
        return "manipulator" if self.version == 1 else "end effector"

    @property
    def load(self) -> str:
        """Return the name of the payload."""
        return "load" if self.version == 1 else "payload"

    @property
    def bodies(self) -> str:
        """Return the names of the moving bodies."""
        return "the load or a hand" if self.version == 1 else "the payload or an end effector"


VERSION_1 = Words()
"""The words of files of version 1, which are those of `SceneFile`."""
