"""Loading compiled kernels ahead of the clock."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from comove.coordination.coordinates import load_coordinates
from comove.coordination.motion import CoordinatedDMP
from comove.demonstrations.demonstration import Demonstration
from comove.planning.clock import STRIDE, clock_until, worked
from comove.planning.configurations import configuration_space
from comove.planning.objective import Objective
from comove.planning.planner import forest, plan
from comove.planning.seeds import fit, minimum_jerk, targets_along
from comove.planning.spacetime import plan_in_time, spacetime, targets_in_time
from comove.primitives.basis import motion_basis
from comove.primitives.dmp import DMP
from comove.scenes.scene import Scene
from comove.verification.verify import verify


@lru_cache(maxsize=4)
def load_kernels(n_dims: int, moving: bool = False) -> None:
    """Compile, or load from the cache, every kernel that solving a scene of `n_dims` dimensions needs.

    Parameters
    ----------
    moving : whether obstacles move
    """

    def at(*values: float) -> list[float]:
        return [*values, *[0.5] * (n_dims - len(values))]

    load = {"shape": "bar", "length": 0.2}
    if n_dims == 3:  # a box needs all that a bar needs, and the kernels of solids
        load = {"shape": "box", "size": [0.2, 0.02, 0.02]}
    scene = Scene.from_dict(
        {
            "name": "kernels",
            "duration": 1.0,
            "workspace": {"lower": [0.0] * n_dims, "upper": [1.0] * n_dims},
            "obstacles": [{"shape": "sphere", "center": at(0.9, 0.9), "radius": 0.01}],
            "load": load,
            "constraints": [{"type": "upright"}] if n_dims == 3 else [],
            "manipulators": [
                {"name": "a", "start": at(0.2, 0.4), "goal": at(0.3, 0.4)},
                {"name": "b", "start": at(0.2, 0.6), "goal": at(0.3, 0.6)},
            ],
        }
    )
    worked(clock_until(), 2 * STRIDE)  # the first look at the time prepares the others
    coordinates, basis = load_coordinates(scene), motion_basis(30, "velocity")
    way = np.linspace(0.0, 1.0, 21)
    dmp = DMP.fit(Demonstration(way, np.outer(minimum_jerk(way), np.ones(n_dims))))
    CoordinatedDMP.from_demonstration(dmp, scene, coordinates, basis)
    space, ends = configuration_space(scene, coordinates), coordinates.boundary()
    path = plan(space, ends[0], ends[2], 0.01, np.random.default_rng(0))
    if n_dims == 3:
        forest(space, ends[0], ends[2], 0.01, np.random.default_rng(0), 2)
    motion = fit(targets_along(space, path), path[-1], coordinates, basis, scene)[0].rollout()
    if moving:
        world, rng = spacetime(scene, space), np.random.default_rng(0)
        found = plan_in_time(world, ends[0], ends[2], 10.0, 0.01, rng, max_nodes=10)
        targets_in_time(space, *found, 11)
    Objective(scene, coordinates).cost(motion)
    verify(motion)
