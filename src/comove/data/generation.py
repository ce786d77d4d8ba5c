"""Studies of generated episodes: a scene and its distributions."""

from __future__ import annotations

import copy
import hashlib
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import ValidationError

from comove._version import __version__
from comove.data.cameras import require_cameras
from comove.data.distributions import Distribution, OneOf, TruncatedNormal, Uniform
from comove.data.episode import Made, solved_run
from comove.data.keys import LENGTH, change, fit_hands, hand_names
from comove.data.runs import StudyRun
from comove.data.store import digest
from comove.data.study_file import GENERATE, MAX_EPISODES, DrawPart, StudyFile
from comove.dmp import Library
from comove.dmp.demonstrations.formats import format_of, is_format
from comove.errors import (
    ComoveWarning,
    DemonstrationError,
    OptionError,
    RobotError,
    SceneError,
    near_name,
    shortened,
)
from comove.io.files import telling
from comove.io.keys import Contract, Flaw, Part, Wrong, explained, scene_error
from comove.io.kinds import PathKind, misnamed
from comove.io.yaml_reader import Lines, read_yaml
from comove.model.demonstration import LIBRARY
from comove.model.files.keys import READING
from comove.model.scene import Scene
from comove.planning import Comove
from comove.planning.effort import NORMAL, EffortLevel

Model = TypeVar("Model", bound=Part)

PROBED, PROBED_DRAWS = 50, 2000
"""Episodes, and draws in all, by which the share of rejected draws is told before the first run."""


@dataclass(frozen=True)
class Draw:
    """Sampled keys of the scene with the distribution of their value. `add` says whether the value is added to that
    of the scene."""

    keys: tuple[str, ...]
    distribution: Distribution
    add: bool = False

    def apply(self, data: dict[str, Any], rng: np.random.Generator) -> None:
        """Sample a value, and change a scene's contents by it, in place."""
        value = self.distribution.draw(rng)
        for key in self.keys:
            change(data, key, copy.deepcopy(value), add=self.add)


@dataclass(frozen=True, eq=False)
class Drawn:
    """Scene sampled for an episode.

    Attributes
    ----------
    number, seed : number of the episode in its study, and its seed
    scene : the scene; None where no sample gave a valid one
    rejected : number of samples that gave no valid scene
    reason : error of the last of these
    """

    number: int
    seed: int
    scene: Scene | None
    rejected: int
    reason: str = ""


@dataclass(frozen=True)
class Probe:
    """Share of samples that give valid scenes, in the first episodes.

    Attributes
    ----------
    valid, rejected : numbers of samples
    reason : error of the last rejected sample
    """

    valid: int
    rejected: int
    reason: str

    @property
    def share(self) -> float:
        """Return the share of rejected samples."""
        return self.rejected / max(1, self.rejected + self.valid)


@dataclass(frozen=True, eq=False)
class Study:
    """Dataset config, read from its file by `load`.

    Attributes
    ----------
    file : the parsed file
    path : path of the file
    folder : folder to which paths in the scene are relative
    template : contents of the scene file that is varied
    draws : samples of every episode, in order
    """

    file: StudyFile
    path: Path
    folder: Path
    template: dict[str, Any] = field(repr=False)
    draws: tuple[Draw, ...] = ()

    @classmethod
    def load(cls, path: str | Path, *, episodes: int | None = None, seed: int | None = None) -> Study:
        """Read a study file (YAML).

        Parameters
        ----------
        episodes, seed : number of episodes, and seed of all of them; those of the file unless given

        Raises
        ------
        SceneError
            If the file or its scene cannot be read or breaks the rules; one message names file, key, line, value and
            correction.
        RobotError, ExtraError
            If the scene's robot cannot be loaded, or needs a package that is not installed.
        """
        path = Path(path)
        file, lines = read_study(path, StudyFile, GENERATE)
        if isinstance(file.scene, str):
            where = path.parent / file.scene
            folder, template = where.parent, read_yaml(where)[0]
        else:
            folder, template = path.parent, file.scene
        if episodes is not None:
            if not 1 <= episodes <= MAX_EPISODES:
                raise OptionError(
                    f"episodes = {episodes}", key="--episodes", way_out=f"give 1 to {MAX_EPISODES:,} of them"
                )
            file = file.model_copy(update={"episodes": episodes})
        if seed is not None:
            if seed < 0:
                raise OptionError(f"seed = {seed}", key="--seed", way_out="give 0 or more")
            file = file.model_copy(update={"seed": seed})
        study = cls(file, path, folder, template)
        study._require_cameras(lines)
        study._require_robot(lines)
        return replace(study, draws=tuple(study._resolved(lines)))

    def _require_cameras(self, lines: Lines) -> None:
        """Refuse cameras without a simulation, or in unknown end effectors."""
        cameras = self.file.cameras
        if cameras is None:
            return
        if self.file.simulate is None:
            flaw = Flaw(
                ("cameras",),
                "pictures are taken of what is simulated, and the study simulates nothing",
                "add simulate: {grasp: friction}, or leave cameras out",
            )
            raise scene_error([flaw], self.path, lines)
        hands = hand_names(self.template)
        for name, view in cameras.views.items():
            if view.hand is not None and view.hand not in hands:
                place = ("cameras", "views", name, "hand")
                flaw = Flaw(place, f"there is no hand {view.hand!r}", near_name(view.hand, hands))
                raise scene_error([flaw], self.path, lines)

    def _require_robot(self, lines: Lines) -> None:
        """Refuse a robot that cannot be loaded, and simulations without one."""
        if self.file.simulate is not None and not self.on_robot:
            flaw = Flaw(
                ("simulate",),
                "the scene names no robot that could be simulated",
                "add robot: NAME and grasp: {orientation: down} to the scene, or leave simulate out",
            )
            raise scene_error([flaw], self.path, lines)
        if not self.on_robot:
            return
        from comove.data.carried import robot_named

        for name in self._robots:
            try:
                robot_named(name, self.folder)
            except RobotError as error:
                error.file = error.file or self.path
                raise
        if self.file.simulate is not None:
            from comove.sim.engine import engine

            engine()

    @property
    def on_robot(self) -> bool:
        """Return whether the episodes are motions of a robot."""
        return bool(self._robots)

    @property
    def without_gripper(self) -> dict[str, tuple[str, ...]]:
        """Return the arms described without a gripper, by robot. As in `comove.robots.JointReport`."""
        if not self.on_robot:
            return {}
        from comove.data.carried import robot_named
        from comove.robots.verification.checks import without_gripper

        return {name: without_gripper(robot_named(name, self.folder)) for name in self._robots}

    @cached_property
    def _robots(self) -> tuple[str, ...]:
        chosen = [value for part in self.file.draws if "robot" in part.key for value in part.choice or ()]
        named = chosen or [self.template.get("robot")]
        return tuple(dict.fromkeys(str(name) for name in named if name is not None))

    def _resolved(self, lines: Lines) -> Iterator[Draw]:
        """Yield the distributions, each tried once on the scene."""
        data, rng = copy.deepcopy(self.template), np.random.default_rng(0)
        for i, part in enumerate(self.file.draws):
            try:
                said = self.template.get("demonstration")
                draw = Draw(part.key, _distribution(part, self.folder, said), part.add)
                draw.apply(data, rng)
            except Wrong as wrong:
                raise scene_error([Flaw(("draws", i), *wrong.args)], self.path, lines) from None
            yield draw

    @property
    def name(self) -> str:
        """Return the name of the study."""
        return self.file.name

    @property
    def total(self) -> int:
        """Return the number of episodes."""
        return self.file.episodes

    @property
    def budget(self) -> float:
        """Return the time for each episode [s]."""
        return self.file.budget

    @property
    def effort(self) -> EffortLevel:
        """Return the effort for improving a verified motion."""
        given = {name: value for name in ("ways", "gain") if (value := getattr(self.file, name)) is not None}
        return replace(EffortLevel.of(self.file.effort), **given)

    @cached_property
    def described(self) -> dict[str, Any]:
        """Return the data that determine the episodes, without their number."""
        described = {
            "comove": __version__,
            "scene": self.template,
            "draws": [part.model_dump(exclude_defaults=True) for part in self.file.draws],
            "demonstrations": dict(self._checksums()),
            "seed": self.file.seed,
            "budget": self.file.budget,
        }
        if self.effort != NORMAL:
            described["effort"] = asdict(self.effort)
        return described | (self._described_robot() if self.on_robot else {})

    def _described_robot(self) -> dict[str, Any]:
        """Return the further data that determine a robot's episodes."""
        from comove.data.carried import robot_named

        simulate, cameras = self.file.simulate, self.file.cameras
        return {
            "robots": {name: robot_named(name, self.folder).sha256 for name in self._robots},
            "simulate": None if simulate is None else simulate.model_dump(),
        } | ({} if cameras is None else {"cameras": cameras.model_dump()})

    @cached_property
    def sha256(self) -> str:
        """Return the checksum of the description."""
        return digest(self.described)

    def _checksums(self) -> Iterator[tuple[str, str]]:
        choices = [value for draw in self.draws for value in _demonstrations(draw)]
        for source in [self.template.get("demonstration"), *choices]:
            file = _file_of(source, self.folder) if isinstance(source, dict) else None
            if file is not None:
                yield file.relative_to(self.folder).as_posix(), _checksum(file)

    def files(self) -> list[Path]:
        """Return the files and folders that determine the episodes."""
        found = [self.path, *(self.folder / name for name, _ in self._checksums())]
        if isinstance(self.file.scene, str):
            found.append(self.path.parent / self.file.scene)
        found += [
            self.folder / name for part in self.file.draws for name in (part.library, part.recordings) if name
        ]
        parts = [
            *(self.template.get("obstacles") or []),
            self.template.get("load"),
            self.template.get("payload"),
        ]
        found += [self.folder / part["file"] for part in parts if isinstance(part, dict) and part.get("file")]
        if self.on_robot:
            from comove.data.carried import robot_named

            found += [path for name in self._robots for path in robot_named(name, self.folder).files]
        return found

    def seed_of(self, number: int) -> int:
        """Return the seed of an episode. It depends on the study's seed and the episode's number alone."""
        rng = np.random.default_rng([self.file.seed, number])
        return int(rng.integers(2**48))

    def draw(self, number: int, attempts: int = 100) -> Drawn:
        """Return the first valid sampled scene of an episode. At most `attempts` scenes are sampled."""
        seed, reason = self.seed_of(number), ""
        rng = np.random.default_rng(seed)
        for rejected in range(attempts):
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", ComoveWarning)
                    scene = Scene.from_dict(self.contents(number, rng), folder=self.folder)
                    self._require_hold(scene)
                return Drawn(number, seed, scene, rejected, reason)
            except SceneError as error:
                reason = str(error)
            except Wrong as wrong:
                reason = str(wrong.args[0])
        return Drawn(number, seed, None, attempts, reason)

    def _require_hold(self, scene: Scene) -> None:
        if self.on_robot:
            from comove.data.carried import require_hold

            require_hold(scene)

    def key(self, number: int) -> str:
        """Return the key of an episode, a checksum of its input data."""
        return hashlib.sha256(f"{self.sha256} {number}".encode()).hexdigest()

    def run(self, number: int) -> Made:
        """Sample and solve an episode; return its row and verified motion."""
        drawn = self.draw(number)
        run = StudyRun(self.key(number), number, method=Comove.name, seed=drawn.seed, rejected=drawn.rejected)
        if drawn.scene is None:
            return replace(run, status="invalid", reason=drawn.reason), None
        if not self.on_robot:
            return solved_run(run, drawn.scene, Comove(), self.budget, self.effort)
        from comove.data.carried import Carrying, carried_run

        how = Carrying(self.budget, None, self.file.simulate, self.file.cameras, self.effort)
        return carried_run(run, drawn.scene, how)

    def require(self) -> None:
        """Check that this process can simulate and render, where required."""
        if self.file.simulate is not None:
            from comove.sim.engine import engine

            engine()
        if self.file.cameras is not None:
            require_cameras()

    def example_scenes(self) -> Iterator[Scene]:
        """Yield the scenes of the first episodes."""
        for number in range(min(8, self.total)):
            if (scene := self.draw(number).scene) is not None:
                yield scene

    def contents(self, number: int, rng: np.random.Generator) -> dict[str, Any]:
        """Return the contents of a scene file, sampled once."""
        data = copy.deepcopy(self.template)
        for draw in self.draws:
            draw.apply(data, rng)
        if any(LENGTH in draw.keys for draw in self.draws):
            fit_hands(data)
        return data | {"name": f"{data.get('name', self.name)}-{number:06d}"}

    def probe(self) -> Probe:
        """Sample the first episodes; return the share of valid scenes.

        Raises
        ------
        SceneError
            If none of them is valid.
        """
        valid = rejected = 0
        reason = ""
        for number in range(min(PROBED, self.file.episodes)):
            drawn = self.draw(number)
            valid, rejected = valid + (drawn.scene is not None), rejected + drawn.rejected
            reason = drawn.reason or reason
            if rejected + valid >= PROBED_DRAWS:
                break
        if not valid:
            raise SceneError(
                f"none of {rejected} draws gives a valid scene, the last because: {shortened(reason, 300)}",
                file=self.path,
                key="draws",
                way_out="narrow the distributions, or correct the scene",
            )
        return Probe(valid, rejected, reason)


def read_study(path: Path, model: type[Model], contract: Contract) -> tuple[Model, Lines]:
    """Read a study file of one kind; return it with key lines.

    Raises
    ------
    SceneError
        One message that names file, key, line, value and correction of the first three errors.
    """
    data, lines = read_yaml(path)
    try:
        return model.model_validate(data), lines
    except ValidationError as error:
        if found := misnamed(path, PathKind.STUDY):
            raise SceneError(found[0], file=path, way_out=found[1]) from None
        raise scene_error(explained(error, data, contract), path, lines) from None


def _distribution(part: DrawPart, folder: Path, said: object = None) -> Distribution:
    """Return the distribution of a sampled key. Sampled demonstrations are read, laid out and scaled as `said`, the
    scene's own demonstration."""
    laid = _kept(said, ("plane", "scale"))
    read = laid | _kept(said, [key for key in ("manipulator", *READING) if key != "episode"])
    if part.uniform is not None:
        return Uniform(*map(np.asarray, part.uniform))
    if part.normal is not None:
        return TruncatedNormal(*map(np.asarray, part.normal), *map(np.asarray, part.within))
    if part.choice is not None:
        return OneOf(part.choice)
    if part.library is not None:
        names = Library(folder / part.library).names
        if not names:
            raise Wrong(f"there is no primitive in {part.library}", "name a library: comove library add DEMO")
        return OneOf(tuple({"library": f"{part.library}/{name}"} | laid for name in names))
    return OneOf(tuple(one | read for one in _recordings(folder, part.recordings or "")))


def _kept(said: object, keys: Sequence[str]) -> dict[str, Any]:
    return {key: said[key] for key in keys if key in said} if isinstance(said, Mapping) else {}


def _recordings(folder: Path, name: str) -> list[dict[str, Any]]:
    """Return the demonstrations in a recording's episodes or a folder."""
    path = folder / name
    try:
        if path.is_dir() and not is_format(path):
            found = [{"file": f"{name}/{file.name}"} for file in sorted(path.iterdir()) if is_format(file)]
        else:
            kind = format_of(path)
            parts = tuple(kind.parts(path)) if kind.part == "episode" else ()
            found = [{"file": name, "episode": part} for part in parts] or [{"file": name}]
        missing = not found or not path.exists()
    except (DemonstrationError, OSError) as error:
        raise Wrong(f"the recordings cannot be read: {error}", "name a recording beside the scene") from error
    if missing:
        raise Wrong(
            f"there are no recordings at {name!r}", "name a recording, or a folder of them, beside the scene"
        )
    return found


def _demonstrations(draw: Draw) -> tuple[Any, ...]:
    if draw.keys != ("demonstration",) or not isinstance(draw.distribution, OneOf):
        return ()
    return draw.distribution.values


def _file_of(source: Mapping[str, Any], folder: Path) -> Path | None:
    """Return the file or folder of a demonstration. Return None where there is none beside the scene."""
    if source.get("file") is not None:
        path = folder / str(source["file"])
    elif source.get("library") is not None:
        place = Path(str(source["library"]))
        inner = place.parent if len(place.parts) > 1 else Path(LIBRARY)
        path = Library(folder / inner).path(place.name)
    else:
        return None
    return path if path.exists() else None


def _checksum(path: Path) -> str:
    """Return the checksum of a file, or a folder's files."""
    digest = hashlib.sha256()
    with telling(path):
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.is_file():
                digest.update(f"{file.name}\n".encode())
                digest.update(file.read_bytes())
    return digest.hexdigest()
