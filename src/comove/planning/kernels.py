"""The compilation or loading of kernels, before the time of a search is measured.

Compilation happens once after installation. Where there are processor cores for it, a second process compiles what a
search needs last, while this one compiles what it needs first and then finds the rest in the cache on disk.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from comove.compiled.finished import finish, finished
from comove.dmp.demonstrations.demonstration import Demonstration
from comove.dmp.dmp import DMP
from comove.model.coordinates import load_coordinates
from comove.model.scene import Scene
from comove.planning.clock import STRIDE, clock_until, worked
from comove.planning.compiling import meanwhile
from comove.planning.configurations import configuration_space
from comove.planning.convex.limits import Limits
from comove.planning.methods import Quick
from comove.planning.objective import N_STEPS, Objective
from comove.planning.objectives import LeastJerk, PaperCost
from comove.planning.planner import FOREST, flat_direction, forest
from comove.planning.search import Search
from comove.planning.seeds import minimum_jerk
from comove.planning.smooth import smooth_way

TETRAHEDRON = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


@dataclass(frozen=True)
class SceneKind:
    """The traits of a scene that kernels are compiled for.

    Attributes
    ----------
    n_dims : 2 or 3
    moving : whether obstacles move
    solids : whether the load is a box, a mesh or another solid, not only rods
    meshes : whether obstacles are meshes
    """

    n_dims: int
    moving: bool = False
    solids: bool = False
    meshes: bool = False

    @classmethod
    def of(cls, scene: Scene) -> SceneKind:
        """Return the kind of a scene."""
        return cls(
            scene.n_dims,
            bool(scene.moving.any()),
            len(scene.body.solids) > 0,
            len(scene.surfaces.root) > 0,
        )


def load_kernels(kind: SceneKind, beside: Callable[[], object] | None = None) -> None:
    """Compile, or load from the cache, all kernels needed to solve scenes of a kind; once in a process.

    Parameters
    ----------
    beside : function that is called while another process compiles; where there is nothing to compile, at once
    """
    if str(kind) in finished():
        return
    with meanwhile(load_last_kernels, **asdict(kind)):
        begin_loading(beside)
        _load_once(kind)
    _load_forest_once(kind)
    finish(str(kind))


def begin_loading(beside: Callable[[], object] | None) -> None:
    """Load a small kernel, so that another process begins where kernels have to be compiled, and call a function."""
    worked(clock_until(), 2 * STRIDE)  # the first look at the time prepares the others
    if beside is not None:
        beside()


@lru_cache(maxsize=16)
def _load_once(kind: SceneKind) -> None:
    Quick(n_ways=1).run(_stand_in(kind), planner=True)


@lru_cache(maxsize=16)
def _load_forest_once(kind: SceneKind) -> None:
    _search_by_forest(_stand_in(kind))


def load_last_kernels(**kind: Any) -> None:
    """Load the kernels that a search needs last: those of smooth motions, and of the forest."""
    load_smooth_kernels(SceneKind(**kind))
    _search_by_forest(_stand_in(SceneKind(**kind)))


def load_smooth_kernels(kind: SceneKind) -> None:
    """Load the kernels that make a path a smooth motion: of the convex programme, of the certificate, of the cost."""
    search = _stand_in(kind)
    boundary = search.objective.coordinates.boundary()
    way = boundary[0] + np.linspace(0.0, 1.0, N_STEPS)[:, None] * (boundary[2] - boundary[0])
    smooth_way(search, way, boundary)
    search.objective.evaluate(np.ascontiguousarray(way.T)[None])


def _search_by_forest(search: Search) -> None:
    """Search once by the planner that comes second, which spatial scenes need."""
    coordinates = search.objective.coordinates
    if search.scene.n_dims == 3:
        space, ends = configuration_space(search.scene, coordinates), coordinates.boundary()
        flat = flat_direction(space.blocks.point)
        rng = np.random.default_rng(0)
        forest(space, flat, ends[0], ends[2], 0.01, rng, 2, FOREST)


def _stand_in(kind: SceneKind) -> Search:
    """Return the search for a motion in a small scene of a kind."""
    scene = _scene(kind)
    way = np.linspace(0.0, 1.0, 41)
    dmp = DMP.fit(Demonstration(way, np.outer(minimum_jerk(way), np.ones(kind.n_dims))))
    return Search(
        objective=Objective(scene, load_coordinates(scene), PaperCost()),
        taught=(dmp,) * 2,
        hard=True,
        rng=np.random.default_rng(0),
        aim=LeastJerk(),
        limits=Limits.of(scene, scene.duration),
    )


def _scene(kind: SceneKind) -> Scene:
    def at(*values: float) -> list[float]:
        return [*values, *[0.5] * (kind.n_dims - len(values))]

    load = {"shape": "box", "size": [0.2, 0.02, 0.02]} if kind.solids else {"shape": "bar", "length": 0.2}
    drifts = {"motion": {"velocity": [0.01] * kind.n_dims}} if kind.moving else {}
    obstacles = [{"shape": "sphere", "center": at(0.4, 0.4), "radius": 0.05, **drifts}]
    with tempfile.TemporaryDirectory() as folder:
        if kind.meshes:
            Path(folder, "mesh.obj").write_text(TETRAHEDRON)
            obstacles.append({"shape": "mesh", "file": "mesh.obj", "center": [0.8, 0.8, 0.8]})
        return Scene.from_dict(
            {
                "name": "kernels",
                "duration": 1.0,
                "workspace": {"lower": [0.0] * kind.n_dims, "upper": [1.0] * kind.n_dims},
                "obstacles": obstacles,
                "load": load,
                "constraints": [{"type": "upright"}] if kind.n_dims == 3 else [],
                "manipulators": [
                    {"name": "a", "start": at(0.2, 0.4), "goal": at(0.6, 0.4)},
                    {"name": "b", "start": at(0.2, 0.6), "goal": at(0.6, 0.6)},
                ],
            },
            folder=folder,
        )
