"""Small searches of end effectors, which need all kernels of a search.

A search first requires the jobs of its scene's kind (`planning.warming`), so that kernels are compiled by all cores
before its time is measured.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from comove.dmp.demonstrations.demonstration import Demonstration
from comove.dmp.dmp import DMP
from comove.model.blocks import QUATERNION, turned
from comove.model.coordinates import load_coordinates
from comove.model.scene import Scene
from comove.planning.configurations import configuration_space
from comove.planning.convex.limits import Limits
from comove.planning.methods import Quick
from comove.planning.objective import N_STEPS, Objective
from comove.planning.objectives import LeastJerk, PaperCost
from comove.planning.orientations import turned_otherwise
from comove.planning.planner import FOREST, flat_direction, forest
from comove.planning.search import Search
from comove.planning.seeds import minimum_jerk
from comove.planning.smooth import smooth_way
from comove.planning.warming import require

TETRAHEDRON = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"


@dataclass(frozen=True)
class SceneKind:
    """The traits of a scene that kernels are compiled for.

    Attributes
    ----------
    n_dims : 2 or 3
    moving : whether obstacles move
    meshes : whether payload or obstacles are meshes or other solids, not only rods and convex obstacles
    """

    n_dims: int
    moving: bool = False
    meshes: bool = False

    @classmethod
    def of(cls, scene: Scene) -> SceneKind:
        """Return the kind of a scene."""
        has_meshes = len(scene.body.solids) > 0 or len(scene.surfaces.root) > 0
        return cls(scene.n_dims, bool(scene.moving.any()), has_meshes)

    @property
    def jobs(self) -> tuple[str, ...]:
        """Return the jobs that need the same kernels, slowest first."""
        name = "planar" if self.n_dims == 2 else "spatial"
        more = ["moving plans"] * self.moving + ["meshes"] * self.meshes
        return f"{name} plans", f"{name} motions", *more

    @property
    def robot_jobs(self) -> tuple[str, ...]:
        """Return the jobs for robots in scenes of the kind."""
        return "robot motions", "robot plans, moving" if self.moving else "robot plans", *self.jobs


def load_kernels(kind: SceneKind) -> None:
    """Wait until the kernels for scenes of a kind are compiled."""
    require(*kind.jobs)


def plan_in(n_dims: int, moving: bool = False) -> None:
    """Plan in a small scene by all planners, and smooth the path."""
    kind = SceneKind(n_dims, moving)
    Quick(n_ways=2).run(_stand_in(kind), planner=True)  # the second path is compared with the first motion
    if not moving:
        _search_otherwise(_stand_in(kind))


def smooth_in(n_dims: int, meshes: bool = False) -> None:
    """Smooth a path in a small scene by convex programming. Certificate and cost are included."""
    search = _stand_in(SceneKind(n_dims, meshes=meshes))
    boundary = search.objective.coordinates.boundary()
    way = boundary[0] + np.linspace(0.0, 1.0, N_STEPS)[:, None] * (boundary[2] - boundary[0])
    smooth_way(search, way, boundary)
    search.objective.evaluate(np.ascontiguousarray(way.T)[None])
    if n_dims == 3:  # the small scene's payload stays level
        turned(QUATERNION, np.ones((3, 1, 4)), np.zeros((1, 3)))


def _search_otherwise(search: Search) -> None:
    """Search once by what a demonstration leaves out: other orientations and, in space, the second planner."""
    coordinates = search.objective.coordinates
    space, ends = configuration_space(search.scene, coordinates), coordinates.boundary()
    turned_otherwise(space, ends[[0, 2]], 0.01)
    if search.scene.n_dims == 2:
        return
    flat = flat_direction(space.blocks.point)
    rng = np.random.default_rng(0)
    forest(space, flat, ends[0], ends[2], 0.01, rng, 2, FOREST)


def _stand_in(kind: SceneKind) -> Search:
    """Return a search in a small scene of a kind."""
    scene = small_scene(kind)
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


def small_scene(kind: SceneKind, **more: Any) -> Scene:
    """Return a small scene of a kind.

    Parameters
    ----------
    more : further keys of its file
    """

    def at(*values: float) -> list[float]:
        return [*values, *[0.5] * (kind.n_dims - len(values))]

    load = {"shape": "box", "size": [0.2, 0.02, 0.02]} if kind.meshes else {"shape": "bar", "length": 0.2}
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
                "limits": {"speed": 10.0},
                "load": load,
                "constraints": [{"type": "upright"}] if kind.n_dims == 3 else [],
                "manipulators": [
                    {"name": "a", "start": at(0.2, 0.4), "goal": at(0.6, 0.4)},
                    {"name": "b", "start": at(0.2, 0.6), "goal": at(0.6, 0.6)},
                ],
                **more,
            },
            folder=folder,
        )
