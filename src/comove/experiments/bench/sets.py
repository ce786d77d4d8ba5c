"""The frozen sets of scenes, and functions that draw and write them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.errors import OptionError, near_name
from comove.experiments.bench.drawing import DIFFICULTIES, Difficulty, drawn
from comove.experiments.bench.witness import Witness
from comove.io.folders import Contents, whole_folder
from comove.io.yaml_reader import read_yaml
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

SETS = tuple(DIFFICULTIES)
COUNT, SEED = 50, 0  # of the frozen sets
OWN = "own"  # name of the set in which scenes of one's own are
WITNESSES = "witnesses.yaml"
CONTENTS = Contents("set of scenes", frozenset(), frozenset())  # one that is drawn replaces nothing
HEAD = """\
# That the scenes of this folder can be solved: poses that the load passes, from rest to rest, by scene.
# In the plane x, y [m] and an angle [rad]; in space x, y, z [m] and a quaternion w, x, y, z.
"""


@dataclass(frozen=True)
class BenchScene:
    """A scene of a set.

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

    def witness(self, scene: Scene) -> Witness:
        """Return the witness that the scene can be solved; `scene` is the result of `load`."""
        return Witness.from_rows(_witnesses(self.path.with_name(WITNESSES))[self.name], scene)


@lru_cache(maxsize=8)
def _witnesses(path: Path) -> dict[str, list[list[float]]]:
    return read_yaml(path)[0]


def scenes_of(name: str, count: int | None = None) -> list[BenchScene]:
    """Return the scenes of a frozen set, planar and spatial in turn, or only the first `count`.

    Raises
    ------
    OptionError
        If there is no such set, or `count` is not between 1 and their number.
    """
    difficulty_named(name)
    folder = Path(str(files("comove") / "experiments" / "sets" / name))
    planar, spatial = (sorted(folder.glob(f"{kind}-*.yaml")) for kind in ("planar", "spatial"))
    paths = [path for pair in zip(planar, spatial, strict=True) for path in pair]
    if count is not None and not 0 < count <= len(paths):
        raise OptionError(
            f"scenes = {count}",
            key="--scenes",
            way_out=f"give a number from 1 to {len(paths)}, or leave it out",
        )
    return [BenchScene(name, path) for path in paths[:count]]


def own_scenes(paths: Iterable[Path]) -> list[BenchScene]:
    """Return scenes of one's own: files, and all scene files of folders; each is read once.

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


def difficulty_named(name: str) -> Difficulty:
    """Return the difficulty of a set.

    Raises
    ------
    OptionError
        If there is no such set.
    """
    if name not in DIFFICULTIES:
        raise OptionError(f"there is no set '{name}'", key="set", way_out=near_name(name, DIFFICULTIES))
    return DIFFICULTIES[name]


def draw_scene(set_name: str, index: int, seed: int = SEED) -> tuple[dict[str, Any], Array]:
    """Draw scene `index` of a set, as `drawing.drawn` returns it: even ones are planar, odd ones spatial."""
    n_dims = 2 + index % 2
    name = f"{('planar', 'spatial')[index % 2]}-{index // 2:02d}"
    return drawn(name, difficulty_named(set_name), n_dims, [seed, SETS.index(set_name), index])


def draw_set(set_name: str, folder: Path, count: int = COUNT, seed: int = SEED) -> None:
    """Draw a set and write it to a folder: a file per scene, and the witnesses.

    Raises
    ------
    OptionError
        If there is no such set, or `count` is below 1.
    ResultError
        If the folder is not empty or cannot be written.
    """
    difficulty_named(set_name)
    if count < 1:
        raise OptionError(f"count = {count}", key="--count", way_out="draw 1 scene or more")
    with whole_folder(folder, CONTENTS) as draft:
        lines = []
        for index in range(count):
            data, rows = draw_scene(set_name, index, seed)
            (draft / f"{data['name']}.yaml").write_text(scene_text(data), encoding="utf-8")
            poses = ", ".join(flow(row) for row in rows.tolist())
            lines.append(f"{data['name']}: [{poses}]\n")
        (draft / WITNESSES).write_text(HEAD + "".join(sorted(lines)), encoding="utf-8")


def scene_text(data: dict[str, Any]) -> str:
    """Return the contents of a scene file as YAML, with a line per obstacle and per manipulator."""
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
