"""Sweeps: all combinations of scenes, methods, seeds and settings. `study` runs one from Python and returns a
table."""

from __future__ import annotations

import copy
import itertools
import json
import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from comove._version import __version__
from comove.data.episode import solved_run
from comove.data.generation import read_study
from comove.data.keys import change
from comove.data.runner import on_processes, run_study
from comove.data.runs import COLUMNS, LONGEST, RUNS, StoredMotion, StudyRun, StudyStore
from comove.data.store import digest, parquet_kinds
from comove.data.study_file import SWEEP, SimulationPart, SweepFile
from comove.errors import ComoveWarning, OptionError, RobotError, SceneError, near_name
from comove.io.keys import Flaw, Wrong, scene_error
from comove.io.parquet import write_parquet
from comove.io.yaml_reader import Lines, read_yaml
from comove.methods import METHODS as KNOWN
from comove.methods import OWN
from comove.model.files.keys import canonical
from comove.model.scene import Scene
from comove.planning import Comove
from comove.planning.method import Method
from comove.results.inputs import files_of_scene

METHODS: dict[str, Method] = {name: KNOWN[name].kind() for name in OWN}
"""Methods that solve whole scenes, by their names in a study file."""
ROBOT_METHODS: dict[str, Method | None] = {
    name: None if isinstance(method, Comove) else method
    for name, method in METHODS.items()
    if KNOWN[name].serves_robots
}
"""Methods by which robots carry; None is comove's own for them."""


@dataclass(frozen=True, eq=False)
class SweptScene:
    """Scene of a sweep. `folder` is that to which its paths are relative. There is no `path` where the scene was
    made in Python."""

    name: str
    folder: Path
    contents: dict[str, Any] = field(repr=False)
    path: Path | None = None

    def robot(self, settings: Mapping[str, Any]) -> str | None:
        """Return the robot's name with some settings; None without a robot."""
        name = settings.get("robot", self.contents.get("robot"))
        return None if name is None else str(name)


@dataclass(frozen=True, eq=False)
class Sweep:
    """Runs of scenes with methods, settings and seeds. The seed changes slowest, so that seeds can be added.

    Attributes
    ----------
    name : name of the study
    scenes : the scenes
    methods : names in `METHODS`
    settings : changes of the scenes, by dotted keys
    seeds : number of seeds, from 0 on
    budget : time for each run [s]
    simulate : settings of robots' simulations; None without simulation
    """

    name: str
    scenes: tuple[SweptScene, ...]
    methods: tuple[str, ...] = ("comove",)
    settings: tuple[Mapping[str, Any], ...] = ({},)
    seeds: int = 1
    budget: float = 10.0
    simulate: SimulationPart | None = None

    @classmethod
    def load(cls, path: str | Path) -> Sweep:
        """Read a study file (YAML).

        Raises
        ------
        SceneError
            If the file or a scene cannot be read or breaks the rules; one message names file, key, line, value and
            correction.
        RobotError, ExtraError
            If a robot cannot be loaded, or needs a package that is not installed.
        """
        path = Path(path)
        file, lines = read_study(path, SweepFile, SWEEP)
        scenes = tuple(_swept(path.parent / name) for name in file.scenes)
        flaws = [*_method_flaws(file), *_setting_flaws(file, scenes)]
        if flaws:
            raise scene_error(flaws, path, lines)
        combined = itertools.product(*file.settings.values())
        settings = tuple(dict(zip(file.settings, values, strict=True)) for values in combined)
        sweep = cls(file.name, scenes, file.methods, settings, file.seeds, file.budget, file.simulate)
        _require_distinct(sweep, path, lines)
        flaws = list(_robot_flaws(sweep))
        if flaws:
            raise scene_error(flaws, path, lines)
        try:
            _ = sweep.described  # which loads the robots
        except RobotError as error:
            error.file = error.file or path
            raise
        return sweep

    @property
    def total(self) -> int:
        """Return the number of runs."""
        return self.seeds * self._combinations

    @property
    def _combinations(self) -> int:
        return len(self.scenes) * len(self.methods) * len(self.settings)

    @cached_property
    def described(self) -> dict[str, Any]:
        """Return the data that determine the runs, without their number."""
        described = {
            "comove": __version__,
            "scenes": {scene.name: scene.contents for scene in self.scenes},
            "methods": list(self.methods),
            "settings": [dict(setting) for setting in self.settings],
            "budget": self.budget,
        }
        return described | ({"carried": self._carried} if self._carried else {})

    @cached_property
    def _carried(self) -> dict[str, Any]:
        """Return the data that determine the runs of robots; else {}."""
        named = {(scene, scene.robot(setting)) for scene in self.scenes for setting in self.settings}
        used = [(scene, name) for scene, name in named if name is not None]
        if not used:
            return {}
        from comove.data.carried import robot_named

        return {
            "robots": {f"{s.name}: {name}": robot_named(name, s.folder).sha256 for s, name in used},
            "simulate": None if self.simulate is None else self.simulate.model_dump(),
        }

    def files(self) -> list[Path]:
        """Return the files that determine the runs, without the study's own."""
        found = [scene.path for scene in self.scenes if scene.path is not None]
        found += [file for scene in self.example_scenes() for file in files_of_scene(scene)]
        for swept, settings in itertools.product(self.scenes, self.settings):
            if (name := swept.robot(settings)) is not None:
                from comove.data.carried import robot_named

                found += robot_named(name, swept.folder).files
        return found

    def require(self) -> None:
        """Check that this process can simulate motions, where required."""
        if self.simulate is not None:
            from comove.sim.engine import engine

            engine()

    def example_scenes(self) -> Iterator[Scene]:
        """Yield the scenes with all settings that are valid for them."""
        for swept, settings in itertools.product(self.scenes, self.settings):
            with suppress(SceneError):
                yield _changed(swept, settings)

    def _at(self, number: int) -> tuple[SweptScene, str, Mapping[str, Any], int]:
        seed, rest = divmod(number, self._combinations)
        scene, rest = divmod(rest, len(self.methods) * len(self.settings))
        method, setting = divmod(rest, len(self.settings))
        return self.scenes[scene], self.methods[method], self.settings[setting], seed

    def key(self, number: int) -> str:
        """Return the key of a run, a checksum of its input data."""
        scene, method, settings, seed = self._at(number)
        what = {"scene": scene.contents, "method": method, "settings": settings, "seed": seed}
        robot, name = {}, scene.robot(settings)
        if name is not None:
            own = self._carried["robots"][f"{scene.name}: {name}"]
            robot = {"robot": own, "simulate": self._carried["simulate"]}
        return digest(what | robot | {"budget": self.budget, "comove": __version__})

    def run(self, number: int) -> tuple[StudyRun, StoredMotion | None]:
        """Do a run; return its row and verified motion, if any."""
        swept, method, settings, seed = self._at(number)
        run = StudyRun(
            self.key(number),
            number,
            scene=swept.name,
            method=method,
            seed=seed,
            settings=json.dumps(settings) if settings else "",
        )
        try:
            scene = _changed(swept, settings)
        except SceneError as error:
            return StudyRun(**(vars(run) | {"status": "invalid", "reason": str(error)[:LONGEST]})), None
        if scene.file.robot is None:
            return solved_run(run, scene, METHODS[method], self.budget)
        from comove.data.carried import Carrying, carried_run

        return carried_run(run, scene, Carrying(self.budget, ROBOT_METHODS[method], self.simulate))


def _swept(path: Path) -> SweptScene:
    contents = read_yaml(path)[0]
    return SweptScene(str(contents.get("name", path.stem)), path.parent, contents, path)


def _changed(swept: SweptScene, settings: Mapping[str, Any]) -> Scene:
    """Return a scene with its settings."""
    contents = copy.deepcopy(swept.contents)
    for key, value in settings.items():
        change(contents, key, copy.deepcopy(value))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ComoveWarning)
        return Scene.from_dict(contents, folder=swept.folder)


def _method_flaws(file: SweepFile) -> Iterator[Flaw]:
    for i, name in enumerate(file.methods):
        if name not in METHODS:
            yield Flaw(("methods", i), f"there is no method {name!r}", near_name(name, METHODS))


def _robot_flaws(sweep: Sweep) -> Iterator[Flaw]:
    """Yield flaws of methods without robots, and of simulations without one."""
    carrying = [s.name for s in sweep.scenes if any(map(s.robot, sweep.settings))]
    for i, name in enumerate(sweep.methods):
        if carrying and name not in ROBOT_METHODS:
            yield Flaw(
                ("methods", i),
                f"by the method {name!r} no robot carries, as one does in the scene {carrying[0]}",
                f"use {' or '.join(ROBOT_METHODS)}, or leave robots to a study of their own",
            )
    if sweep.simulate is not None and not carrying:
        yield Flaw(
            ("simulate",),
            "no scene names a robot that could be simulated",
            "add robot: NAME and grasp: {orientation: down} to a scene, or leave simulate out",
        )


def _setting_flaws(file: SweepFile, scenes: tuple[SweptScene, ...]) -> Iterator[Flaw]:
    """Yield flaws of settings that do not apply to a scene."""
    for key, values in file.settings.items():
        for swept in scenes:
            try:
                change(copy.deepcopy(swept.contents), key, values[0])
            except Wrong as wrong:
                yield Flaw(("settings", key), f"in the scene {swept.name}: {wrong.args[0]}", wrong.args[1])
                break


def _require_distinct(sweep: Sweep, path: Path, lines: Lines) -> None:
    """Refuse duplicate names of scenes, and duplicate runs."""
    names = [scene.name for scene in sweep.scenes]
    twice = [name for i, name in enumerate(names) if name in names[:i]]
    if twice:
        flaw = Flaw(
            ("scenes", names.index(twice[0])), f"two scenes are called {twice[0]!r}", "rename one of them"
        )
        raise scene_error([flaw], path, lines)
    if len(set(sweep.methods)) < len(sweep.methods):
        raise scene_error([Flaw(("methods",), "a method is named twice", "name it once")], path, lines)
    several = {key: [s[key] for s in sweep.settings] for key in sweep.settings[0]}
    shown = {json.dumps(dict(setting), sort_keys=True) for setting in sweep.settings}
    if len(shown) < len(sweep.settings):
        raise scene_error(
            [Flaw(("settings", *list(several)[:1]), "a value is given twice", "give it once")], path, lines
        )


@dataclass(frozen=True)
class StudyTable:
    """Table of a study's runs, one row each.

    Attributes
    ----------
    runs : the runs, by seed, then scene, then method
    """

    runs: tuple[StudyRun, ...]

    @property
    def columns(self) -> dict[str, list[Any]]:
        """Return the columns by name, for ``pandas.DataFrame`` and ``polars.DataFrame``."""
        return {name: [getattr(run, name) for run in self.runs] for name in COLUMNS}

    def write_parquet(self, path: str | Path) -> None:
        """Write the table to a Parquet file.

        Raises
        ------
        ExtraError
            If pyarrow is not installed.
        ResultError
            If the file cannot be written.
        """
        write_parquet(path, self.columns, parquet_kinds(StudyStore.KINDS))


def study(
    scenes: Sequence[Scene],
    methods: Sequence[str] = ("comove",),
    seeds: int = 1,
    workers: int = 2,
    *,
    budget: float = 30.0,
    out: str | Path | None = None,
) -> StudyTable:
    """Run scenes with methods and seeds; return a table. Each run follows the demonstration that its scene names.

    Parameters
    ----------
    scenes
        Scenes with different names.
    methods
        Names of methods: comove, projection, paper, printed.
    seeds
        Number of runs of every scene with every method, with the seeds from 0 on.
    workers
        Number of processes.
    budget
        Time for each run [s].
    out
        Folder of the runs, with which the same call resumes after an interruption; none unless given.

    Raises
    ------
    OptionError
        If there is nothing to run, two scenes have one name, or a method is unknown.
    ResultError
        If `out` holds another study, or cannot be written.
    """
    names = [scene.name for scene in scenes]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise OptionError(f"two scenes are called {twice!r}", key="scenes", way_out="give each its own name")
    if not names or not methods or seeds < 1:
        raise OptionError("there is nothing to run", key="scenes", way_out="give scenes, methods and seeds")
    for name in methods:
        if name not in METHODS:
            raise OptionError(f"there is no method {name!r}", key="methods", way_out=near_name(name, METHODS))
        if name not in ROBOT_METHODS and any(scene.file.robot for scene in scenes):
            raise OptionError(
                f"by the method {name!r} no robot carries",
                key="methods",
                way_out=f"use {' or '.join(ROBOT_METHODS)}",
            )
    swept = tuple(SweptScene(s.name, s.folder, json.loads(canonical(s.file))) for s in scenes)
    sweep = Sweep("study", swept, tuple(methods), seeds=seeds, budget=budget)
    if out is not None:
        return _run(sweep, Path(out), workers)
    with tempfile.TemporaryDirectory() as folder:
        return _run(sweep, Path(folder), workers)


def _run(sweep: Sweep, folder: Path, workers: int) -> StudyTable:
    run_study(sweep, folder, on_processes(workers))
    wanted = range(sweep.total)
    return StudyTable(tuple(run for run in StudyStore.open(folder / RUNS).runs() if run.number in wanted))
