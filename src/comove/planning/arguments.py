"""Checks of the arguments of `solve`."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Mapping, Sequence
from typing import cast

import numpy as np

from comove.arrays import Array
from comove.dmp.demonstrations import Demonstration
from comove.dmp.dmp import DMP
from comove.dmp.operations import scale
from comove.dmp.poses import PoseDMP
from comove.dmp.probabilistic import ProMP
from comove.dmp.variants import scaled_share
from comove.errors import ComoveWarning, OptionError, near_name
from comove.methods import METHODS
from comove.model.adaptation import (
    carried_to_hands,
    hands_of_poses,
    magnification,
    movements_of_hands,
    rounded_up,
)
from comove.model.demonstration import fitted, require_dimension
from comove.model.scene import Scene
from comove.planning.clock import Budget
from comove.planning.method import Method
from comove.planning.objective import N_STEPS
from comove.planning.objectives import OBJECTIVES, Criterion

OBSTACLES = ("constraint", "cost")
OUTSIDE = 0.01
"""Share of the workspace's longest side by which an adapted demonstration may leave it without a warning."""
SCALES = tuple(m * 10.0**-k for k in range(1, 5) for m in (5, 2, 1))
"""Scales of a demonstration that are tried, to name one that keeps it in the workspace."""


def check_scene(scene: object) -> None:
    if not isinstance(scene, Scene):
        raise OptionError(
            f"scene = {scene!r}", way_out="give a Scene: Scene.load(path) or Scene.from_dict(data)"
        )


def check_budget(budget: object) -> None:
    """Reject anything but a budget or a positive number of seconds."""
    seconds = 1.0 if isinstance(budget, Budget) else budget
    if isinstance(seconds, bool) or not isinstance(seconds, (int, float)) or not 0 < seconds < np.inf:
        raise OptionError(f"budget = {budget!r}", way_out="give a positive number of seconds")


def check_options(
    scene: object,
    demonstration: object,
    seed: object,
    method: object,
    budget: object,
    objective: object,
    obstacles: str,
    checks: object,
) -> None:
    check_scene(scene)
    if not isinstance(checks, (list, tuple)) or not all(map(callable, checks)):
        raise OptionError(f"checks = {checks!r}", way_out="give a list of functions of the motion")
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise OptionError(f"seed = {seed!r}", way_out="give a whole number, 0 or more")
    if method is not None and not isinstance(method, Method):
        places = {name: known.place for name, known in METHODS.items()}
        way_out = _object_for(method, places, "give a method object, such as Comove()")
        raise OptionError(f"method = {method!r}", way_out=way_out)
    check_budget(budget)
    if objective is not None and not isinstance(objective, Criterion):
        places = {name.replace("_", "-"): f"comove.{kind.__name__}" for name, kind in OBJECTIVES.items()}
        way_out = _object_for(objective, places, "give LeastJerk(), LeastTime(), PaperCost() or a function")
        raise OptionError(f"objective = {objective!r}", way_out=way_out)
    if objective is not None and demonstration is None:
        objective.check_untaught()
    if obstacles not in OBSTACLES:
        raise OptionError(f"obstacles = {obstacles!r}", way_out=near_name(obstacles, OBSTACLES))


def _object_for(given: object, known: Mapping[str, str], otherwise: str) -> str:
    """Return advice on the object to pass instead of a command-line name."""
    if isinstance(given, type):
        return f"give an object of this class: {given.__name__}()"
    if not isinstance(given, str):
        return otherwise
    name = given.strip().lower().replace("_", "-").replace(" ", "-")
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1)
        if not near:
            return otherwise
        name = near[0]
    module, _, kind = known[name].rpartition(".")
    return f"names are for the command line; here give {kind}(), from {module} import {kind}"


def listed(constraints: object) -> tuple:
    if not isinstance(constraints, (list, tuple)):
        raise OptionError(
            f"constraints = {constraints!r}", key="constraints", way_out="give a list of functions of Samples"
        )
    return tuple(constraints)


def carried_demonstration(dmp: DMP | Sequence[DMP], scene: Scene) -> Array:
    """Transfer a demonstration to every manipulator's ends; array, shape (N_STEPS, n_manipulators, 3) [m].

    Raises
    ------
    OptionError
        If a movement has not the scene's dimension.
    """
    for one in [dmp] if isinstance(dmp, DMP) else dmp:
        require_dimension(one.n_dims, scene)
    hands = np.zeros((N_STEPS, len(scene.manipulators), 3))
    hands[..., : scene.n_dims] = carried_to_hands(dmp, scene)
    return hands


def movements_of(demonstration: object, scene: Scene) -> tuple[DMP, ...] | None:
    """Return one movement for every manipulator, in their order; None without a demonstration.

    Raises
    ------
    OptionError
        If a manipulator has no movement, a movement is for no manipulator, or an argument is no movement.
    """
    if demonstration is None:
        return None
    if isinstance(demonstration, ProMP):
        return movements_of_hands(demonstration, scene)
    names, each = scene.manipulators, cast("Sequence[object]", demonstration)
    if isinstance(demonstration, Mapping):
        others = [name for name in demonstration if name not in names]
        missing = [name for name in names if name not in demonstration]
        if others or missing:
            raise OptionError(
                f"a movement is for {others[0]!r}" if others else f"there is no movement for {missing[0]!r}",
                key="demonstration",
                way_out=f"give one for each of {', '.join(names)}",
            )
        each = [demonstration[name] for name in names]
    elif not isinstance(demonstration, (list, tuple)):
        if isinstance(demonstration, Demonstration):
            demonstration = fitted(scene, demonstration)
        if isinstance(demonstration, PoseDMP):
            return hands_of_poses(demonstration, scene)
        each = [_movement(demonstration)] * len(names)
    if len(each) != len(names):
        raise OptionError(
            f"there are {len(each)} movements for {len(names)} manipulators",
            key="demonstration",
            way_out=f"give one for each of {', '.join(names)}",
        )
    return tuple(map(_movement, each))


def warn_of_adaptation(movements: Sequence[DMP], scene: Scene, *, stacklevel: int = 2) -> None:
    """Warn of a demonstration that is much magnified or leaves the workspace.

    Parameters
    ----------
    movements : movement of every manipulator, in their order
    stacklevel : as for `warnings.warn`, from this function's caller on

    Warns
    -----
    ComoveWarning
        Names the manipulator, the size or the distance outside, and what to change.
    """
    hands = carried_demonstration(movements, scene)[..., : scene.n_dims]
    each = zip(movements, scene.start, scene.goal, scene.manipulators, strict=True)
    magnified = [magnification(own, start, goal, f"'{name}'") for own, start, goal, name in each]
    said = [max(magnified)[1], _outside(movements, scene, hands)]
    if any(said):
        warnings.warn("; ".join(filter(None, said)), ComoveWarning, stacklevel=stacklevel + 1)


def _outside(movements: Sequence[DMP], scene: Scene, hands: Array) -> str:
    """Return the message that end effectors leave the workspace. It is empty up to `OUTSIDE`."""
    far = _beyond(hands, scene)
    k, i, _ = map(int, np.unravel_index(int(np.argmax(far)), far.shape))
    allowed = OUTSIDE * float((scene.upper - scene.lower).max())
    if far[k, i].max() <= allowed:
        return ""
    where = (
        f"the demonstration, adapted to the ends of '{scene.manipulators[i]}', leaves the workspace by "
        f"{far[k, i].max():.2g} m at {k / (len(hands) - 1):.0%} of its duration"
    )
    own, way = movements[i], np.linalg.norm(scene.goal[i] - scene.start[i])
    gap = np.linalg.norm(own.goal - own.start)
    share = scaled_share(own.goal - own.start, own.extent)
    if share == 0.0 or (1.0 - share) * gap >= share * way:  # its own size tells most
        for factor in SCALES:
            smaller = carried_demonstration([scale(own, factor) for own in movements], scene)
            if _beyond(smaller[..., : scene.n_dims], scene).max() <= allowed:
                return f"{where}: scale it by {factor:g}"
    lower = np.minimum(scene.lower, -rounded_up(-hands.min(axis=(0, 1))))
    upper = np.maximum(scene.upper, rounded_up(hands.max(axis=(0, 1))))
    return f"{where}: a workspace from {lower.tolist()} to {upper.tolist()} holds it"


def _beyond(hands: Array, scene: Scene) -> Array:
    return np.maximum(np.maximum(scene.lower - hands, hands - scene.upper), 0.0)


def _movement(demonstration: object) -> DMP:
    if isinstance(demonstration, Demonstration):
        if demonstration.is_joints:
            raise OptionError(
                f"{demonstration.name or 'it'} is a movement of joints in {demonstration.unit}, which is no path of "
                "an end effector",
                key="demonstration",
                way_out="give the path that a robot makes of it: comove.robots.end_effector_path",
            )
        return DMP.fit(demonstration)
    if not isinstance(demonstration, DMP):
        raise OptionError(
            f"the demonstration is {type(demonstration).__name__}",
            key="demonstration",
            way_out="give a primitive, DMP.fit(demonstration), or a Demonstration, or one for each manipulator",
        )
    return demonstration
