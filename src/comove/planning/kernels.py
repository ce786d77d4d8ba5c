"""The compilation or loading of kernels, before the time of a search is measured."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from comove.coordination.coordinates import load_coordinates
from comove.demonstrations.demonstration import Demonstration
from comove.planning.clock import STRIDE, clock_until, worked
from comove.planning.configurations import configuration_space
from comove.planning.convex.limits import Limits
from comove.planning.methods import Quick
from comove.planning.objective import Objective
from comove.planning.objectives import LeastJerk, PaperCost
from comove.planning.planner import forest
from comove.planning.search import Search
from comove.planning.seeds import minimum_jerk
from comove.primitives.dmp import DMP
from comove.scenes.scene import Scene


@lru_cache(maxsize=4)
def load_kernels(n_dims: int, moving: bool = False) -> None:
    """Compile, or load from the cache, all kernels needed to solve a scene of `n_dims` dimensions.

    Parameters
    ----------
    moving : whether obstacles move
    """

    def at(*values: float) -> list[float]:
        return [*values, *[0.5] * (n_dims - len(values))]

    load = {"shape": "bar", "length": 0.2}
    if n_dims == 3:  # a box needs all that a bar needs, and the kernels of solids
        load = {"shape": "box", "size": [0.2, 0.02, 0.02]}
    drifts = {"motion": {"velocity": [0.01] * n_dims}} if moving else {}
    scene = Scene.from_dict(
        {
            "name": "kernels",
            "duration": 1.0,
            "workspace": {"lower": [0.0] * n_dims, "upper": [1.0] * n_dims},
            "obstacles": [{"shape": "sphere", "center": at(0.4, 0.4), "radius": 0.05, **drifts}],
            "load": load,
            "constraints": [{"type": "upright"}] if n_dims == 3 else [],
            "manipulators": [
                {"name": "a", "start": at(0.2, 0.4), "goal": at(0.6, 0.4)},
                {"name": "b", "start": at(0.2, 0.6), "goal": at(0.6, 0.6)},
            ],
        }
    )
    worked(clock_until(), 2 * STRIDE)  # the first look at the time prepares the others
    coordinates, way = load_coordinates(scene), np.linspace(0.0, 1.0, 21)
    dmp = DMP.fit(Demonstration(way, np.outer(minimum_jerk(way), np.ones(n_dims))))
    search = Search(
        objective=Objective(scene, coordinates, PaperCost()),
        taught=(dmp,) * 2,
        hard=True,
        rng=np.random.default_rng(0),
        started=0.0,
        deadline=np.inf,
        aim=LeastJerk(),
        limits=Limits.of(scene, scene.duration),
    )
    Quick(n_ways=1).run(search, planner=True)
    if n_dims == 3:
        space, ends = configuration_space(scene, coordinates), coordinates.boundary()
        forest(space, ends[0], ends[2], 0.01, np.random.default_rng(0), 2)
