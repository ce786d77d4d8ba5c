"""Frozen sets of scenes, and functions that sample and write them."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from comove.arrays import Array
from comove.errors import OptionError, near_name
from comove.io.folders import Contents, whole_folder
from comove.lab.bench.drawing import DIFFICULTIES, drawn
from comove.lab.bench.workplaces import ROBOT_DIFFICULTIES, WORKPLACES
from comove.model.scene import Scene

if TYPE_CHECKING:
    from comove.lab.bench.robot_drawing import JointWitness

OWN = "own"  # name of the set in which scenes of one's own are
WITNESSES = "witnesses.yaml"
JOINT_WITNESSES = "witnesses.npz"
CONTENTS = Contents("set of scenes", frozenset(), frozenset())  # one that is drawn replaces nothing
HEAD = """\
# That the scenes of this folder can be solved: poses that the load passes, from rest to rest, by scene.
# In the plane x, y [m] and an angle [rad]; in space x, y, z [m] and a quaternion w, x, y, z.
"""


@dataclass(frozen=True)
class BenchScene:
    """Scene of a set.

    Attributes
    ----------
    set : name of the set
    path : path of the scene file
    """

    set: str
    path: Path

    @property
    def name(self) -> str:
        """Return the name of the scene."""
        return self.path.stem

    @cached_property
    def sha256(self) -> str:
        """Return the checksum of the scene file."""
        return hashlib.sha256(self.path.read_bytes()).hexdigest()

    def load(self) -> Scene:
        """Read the scene."""
        return Scene.load(self.path)


@dataclass(frozen=True)
class SceneSet(ABC):
    """Set of scenes of equal difficulty.

    Attributes
    ----------
    name : name of the set
    number : number of the set, which enters the seeds of its scenes
    kinds : kinds of scenes, which alternate
    count : number of frozen scenes
    """

    name: str
    number: int
    kinds: tuple[str, ...]
    count: int

    @property
    def folder(self) -> Path:
        """Return the folder of the frozen scenes."""
        return Path(str(files("comove") / "lab" / "sets" / self.name))

    def draw(self, index: int, seed: int = 0) -> tuple[dict[str, Any], Any]:
        """Sample a scene; return its file contents and its witness. The frozen scenes have the seed 0."""
        turn, kind = divmod(index, len(self.kinds))
        return self._drawn(f"{self.kinds[kind]}-{turn:02d}", self.kinds[kind], [seed, self.number, index])

    @abstractmethod
    def _drawn(self, name: str, kind: str, seed: list[int]) -> tuple[dict[str, Any], Any]:
        """Sample a scene of a kind."""

    @abstractmethod
    def keep(self, folder: Path, witnesses: Mapping[str, Any]) -> None:
        """Write the witnesses of scenes, by name, into their folder."""


@dataclass(frozen=True)
class HandSet(SceneSet):
    """Scenes of end effectors alone, planar and spatial in turn. A witness is the sequence of payload poses."""

    def _drawn(self, name: str, kind: str, seed: list[int]) -> tuple[dict[str, Any], Array]:
        return drawn(name, DIFFICULTIES[self.name], 3 if kind == "spatial" else 2, seed)

    def keep(self, folder: Path, witnesses: Mapping[str, Array]) -> None:
        """Write the poses of all scenes into one file."""
        lines = [
            f"{name}: [{', '.join(flow(row) for row in rows.tolist())}]\n" for name, rows in witnesses.items()
        ]
        (folder / WITNESSES).write_text(HEAD + "".join(sorted(lines)), encoding="utf-8")


@dataclass(frozen=True)
class RobotSet(SceneSet):
    """Scenes of five robots in turn; a witness is a motion of the joints."""

    def _drawn(self, name: str, kind: str, seed: list[int]) -> tuple[dict[str, Any], JointWitness]:
        from comove.lab.bench import robot_drawing

        return robot_drawing.drawn(name, ROBOT_DIFFICULTIES[self.name], WORKPLACES[kind], seed)

    def keep(self, folder: Path, witnesses: Mapping[str, JointWitness]) -> None:
        """Write the joints of all scenes into one archive."""
        arrays = {
            f"{name}.{key}": value
            for name, witness in witnesses.items()
            for key, value in vars(witness).items()
        }
        np.savez_compressed(folder / JOINT_WITNESSES, **arrays)


_KINDS, _ROBOTS = ("planar", "spatial"), tuple(WORKPLACES)
SETS: dict[str, SceneSet] = {
    one.name: one
    for one in (
        HandSet("easy", 0, _KINDS, 50),
        HandSet("hard", 1, _KINDS, 50),
        HandSet("extreme", 2, _KINDS, 50),
        RobotSet("robots-easy", 3, _ROBOTS, 20),
        RobotSet("robots-hard", 4, _ROBOTS, 20),
        RobotSet("robots-extreme", 5, _ROBOTS, 20),
    )
}


def set_named(name: str) -> SceneSet:
    """Return the set with a name."""
    if name not in SETS:
        raise OptionError(f"there is no set '{name}'", key="set", way_out=near_name(name, SETS))
    return SETS[name]


def scenes_of(name: str, count: int | None = None) -> list[BenchScene]:
    """Return a frozen set's scenes, or only the first `count`. Their kinds alternate.

    Raises
    ------
    OptionError
        If there is no such set, or `count` is not between 1 and their number.
    """
    chosen = set_named(name)
    by_kind = [sorted(chosen.folder.glob(f"{kind}-*.yaml")) for kind in chosen.kinds]
    paths = [path for turn in zip(*by_kind, strict=True) for path in turn]
    if count is not None and not 0 < count <= len(paths):
        raise OptionError(
            f"scenes = {count}",
            key="--scenes",
            way_out=f"give a number from 1 to {len(paths)}, or leave it out",
        )
    return [BenchScene(name, path) for path in paths[:count]]


def own_scenes(paths: Iterable[Path]) -> list[BenchScene]:
    """Return the user's scenes: files, and all scene files in folders. Each is read once.

    Raises
    ------
    OptionError
        If two files have one name, which a report could not tell apart, or a folder holds no scene.
    SceneError
        If a scene cannot be read.
    """
    found: list[BenchScene] = []
    for path in paths:
        files = sorted(path.glob("*.yaml")) if path.is_dir() else [path]
        files = [file for file in files if file.name != WITNESSES]
        if not files:
            raise OptionError(
                "the folder holds no scene", file=path, way_out="name a folder of scene files (YAML)"
            )
        found += [BenchScene(OWN, file) for file in files]
    names: set[str] = set()
    for scene in found:
        if scene.name in names:
            raise OptionError(
                f"two scenes are called '{scene.name}'", file=scene.path, way_out="rename one of them"
            )
        names.add(scene.name)
        scene.load()
    return found


def draw_set(name: str, folder: Path, count: int | None = None, seed: int = 0) -> int:
    """Sample a set and write it to a folder; return its count. Each scene has a file; the witnesses are written too.

    Raises
    ------
    OptionError
        If there is no such set, or `count` is below 1.
    ResultError
        If the folder is not empty or cannot be written.
    """
    chosen = set_named(name)
    count = chosen.count if count is None else count
    if count < 1:
        raise OptionError(f"count = {count}", key="--count", way_out="draw 1 scene or more")
    with whole_folder(folder, CONTENTS) as draft:
        witnesses = {}
        for index in range(count):
            data, witness = chosen.draw(index, seed)
            (draft / f"{data['name']}.yaml").write_text(scene_text(data), encoding="utf-8")
            witnesses[data["name"]] = witness
        chosen.keep(draft, witnesses)
    return count


def scene_text(data: dict[str, Any]) -> str:
    """Return a scene file as YAML, one line per obstacle or manipulator."""
    lines = ["version: 1"]
    for key, value in data.items():
        if isinstance(value, list):
            lines += [f"{key}:", *(f"  - {flow(one)}" for one in value)] if value else [f"{key}: []"]
        else:
            lines.append(f"{key}: {flow(value)}")
    return "\n".join(lines) + "\n"


def flow(value: Any) -> str:
    """Return a value in YAML's flow style.

    >>> flow({"center": [0.5, 1.0], "shape": "box"})
    '{center: [0.5, 1], shape: box}'
    """
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {flow(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(flow(one) for one in value) + "]"
    if not isinstance(value, float):
        return str(value)
    return f"{value:.10f}".rstrip("0").rstrip(".")  # ends are as exact as they are judged
