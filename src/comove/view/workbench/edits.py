"""Interactive edits of a scene, as functions of file contents, with history. Nothing here checks a scene: reading
the contents again does, and reports errors in words."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.errors import OptionError
from comove.geometry.rotations import matrices, quaternion_of_rotation, quaternion_product
from comove.methods import OWN
from comove.model.scene import Scene
from comove.planning.objectives import OBJECTIVES as AIMS

Contents = dict[str, Any]

DIGITS = 6  # of metres that are written: a micrometre
OBJECTIVES = ("as the scene says", *AIMS)


@dataclass(frozen=True)
class Draft:
    """Edited scene, with settings of its solution.

    Attributes
    ----------
    contents : contents of the scene file; never changed in place
    method, objective : names from `comove.methods.OWN` and `OBJECTIVES`
    resemblance : closeness to the demonstration, from 0 to 1; that of the scene unless given
    seed : seed of all random numbers
    taught : movement demonstrated in the page, rows of time [s] and position [m]; that of the scene unless given
    """

    contents: Contents
    method: str = OWN[0]
    objective: str = OBJECTIVES[0]
    resemblance: float | None = None
    seed: int = 0
    taught: tuple[tuple[float, ...], ...] | None = None

    def __post_init__(self) -> None:
        for value, known, key in (
            (self.method, OWN, "method"),
            (self.objective, OBJECTIVES, "objective"),
        ):
            if value not in known:
                raise OptionError(
                    f"there is no {key} {value!r}", key=key, way_out=f"take one of: {', '.join(known)}"
                )
        if self.resemblance is not None and not _is_share(self.resemblance):
            raise OptionError(
                f"the resemblance {self.resemblance!r} is not between 0 and 1",
                key="resemblance",
                way_out="give a number from 0 to 1",
            )

    def with_contents(self, contents: Contents) -> Draft:
        """Return the draft with another scene and the same settings."""
        return replace(self, contents=contents)


def _is_share(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and 0.0 <= value <= 1.0


@dataclass(frozen=True)
class History:
    """Drafts in order, with the present one. A new one removes those that were undone."""

    drafts: tuple[Draft, ...]
    at: int = 0

    @property
    def now(self) -> Draft:
        """Return the present draft."""
        return self.drafts[self.at]

    def then(self, draft: Draft, most: int = 200) -> History:
        """Return the history after a change, with `most` drafts at most."""
        if draft == self.now:
            return self
        kept = (*self.drafts[: self.at + 1], draft)[-most:]
        return History(kept, len(kept) - 1)

    def undone(self) -> History:
        """Return the history one step back, if there is one."""
        return replace(self, at=max(self.at - 1, 0))

    def redone(self) -> History:
        """Return the history one step forward, if there is one."""
        return replace(self, at=min(self.at + 1, len(self.drafts) - 1))


@dataclass(frozen=True)
class Grip:
    """Movable element of a scene.

    Attributes
    ----------
    kind : "obstacle", "start" or "goal"
    number : of the obstacle, or of the rigid group of end effectors
    hands : end effectors that move along, by number; none for an obstacle
    turns : whether it can be rotated as well
    """

    kind: str
    number: int
    hands: tuple[int, ...] = field(default=())
    turns: bool = False

    @property
    def name(self) -> str:
        """Return a name for paths and tests, such as "obstacle_0"."""
        return f"{self.kind}_{self.number}"


def contents_of(scene: Scene) -> Contents:
    """Return a scene's file contents, with ends projected onto constraints."""
    contents = scene.file.model_dump(mode="json")
    for manipulator, start, goal in zip(contents["manipulators"], scene.start, scene.goal, strict=True):
        manipulator |= {"start": start.tolist(), "goal": goal.tolist()}
    return contents


def grips_of(scene: Scene) -> tuple[Grip, ...]:
    """Return all movable elements of a scene. They are obstacles, then starts and goals of its rigid groups."""
    found = [
        Grip("obstacle", i, turns=obstacle.shape != "sphere")
        for i, obstacle in enumerate(scene.file.obstacles)
    ]
    for kind in ("start", "goal"):
        found += [
            Grip(kind, i, hands=group.members, turns=len(group.members) > 1)
            for i, group in enumerate(scene.groups)
        ]
    return tuple(found)


def place_of(contents: Contents, grip: Grip) -> Array:
    """Return the position of a grip; array, shape (3,) [m]. It is an obstacle's centre, or the mean of the end
    effectors."""
    if grip.kind == "obstacle":
        where = np.array(contents["obstacles"][grip.number]["center"], dtype=float)
    else:
        where = _hands(contents, grip).mean(axis=0)
    return np.append(where, np.zeros(3 - len(where)))


def moved(contents: Contents, grip: Grip, to: Array, turn: Array | None = None) -> Contents:
    """Return the contents after a grip was moved and rotated.

    Parameters
    ----------
    to : array, shape (3,), the new position of the grip; its height is ignored in the plane [m]
    turn : array, shape (4,), rotation relative to the former orientation, w x y z; none unless given

    Raises
    ------
    OptionError
        If these are not finite numbers, as a page might send.
    """
    to, turn = _finite(to, 3, "place"), None if turn is None else _finite(turn, 4, "turn")
    if turn is not None:
        turn = turn / np.linalg.norm(turn)
    contents = copy.deepcopy(contents)
    if grip.kind == "obstacle":
        _move_obstacle(contents["obstacles"][grip.number], to, turn)
        return contents
    hands = _hands(contents, grip)
    n_dims = hands.shape[1]
    about = hands - hands.mean(axis=0)
    if turn is not None:
        turn = _upright(turn) if n_dims == 2 else turn
        about = about @ matrices(turn)[:n_dims, :n_dims].T
    for hand, place in zip(grip.hands, to[:n_dims] + about, strict=True):
        contents["manipulators"][hand][grip.kind] = _written(place, 12)
    for pose in _poses(contents, grip):
        _move_pose(pose, to[:n_dims], hands.mean(axis=0), turn)
    return contents


def _poses(contents: Contents, grip: Grip) -> list[Contents]:
    load = contents.get("load") or {}
    names = [contents["manipulators"][hand]["name"] for hand in grip.hands]
    if not load.get(grip.kind) or not set(load.get("held_by") or names) <= set(names):
        return []
    return [load[grip.kind], *(c[grip.kind] for c in contents.get("choices") or () if grip.kind in c)]


def _move_pose(pose: Contents, to: Array, middle: Array, turn: Array | None) -> None:
    """Move a pose in place, with end effectors around their mean."""
    away, n_dims = np.array(pose["position"], dtype=float) - middle, len(middle)
    if turn is not None:
        away = matrices(turn)[:n_dims, :n_dims] @ away
        whole = quaternion_product(turn, np.array(pose["quaternion_wxyz"], dtype=float))
        pose["quaternion_wxyz"] = quaternion_of_rotation(matrices(whole / np.linalg.norm(whole))).tolist()
    pose["position"] = _written(to + away, 12)


def _move_obstacle(obstacle: Contents, to: Array, turn: Array | None) -> None:
    """Move an obstacle in place, with its path if it moves."""
    before = np.array(obstacle["center"], dtype=float)
    obstacle["center"] = _written(to[: len(before)])
    waypoints = (obstacle.get("motion") or {}).get("waypoints")
    if waypoints:
        shift = to[: len(before)] - before
        obstacle["motion"]["waypoints"] = [_written(np.array(point) + shift) for point in waypoints]
        obstacle["center"] = _written(np.array(obstacle["motion"]["waypoints"][0]))
    if turn is None:
        return
    turns = (obstacle.get("motion") or {}).get("turn") or {}
    for key in ("axis", "hinge"):  # which go with the obstacle
        if turns.get(key) is not None:
            given = np.array(turns[key], dtype=float)
            turns[key] = _written(matrices(turn)[: len(given), : len(given)] @ given)
    if len(before) == 2:
        if "rotation_deg" in obstacle:
            angle = 2.0 * math.atan2(turn[3], turn[0])
            degrees = (obstacle["rotation_deg"] or 0.0) + math.degrees(angle)
            obstacle["rotation_deg"] = round(math.remainder(degrees, 360.0), DIGITS)
    elif "quaternion_wxyz" in obstacle:
        whole = quaternion_product(turn, np.array(obstacle["quaternion_wxyz"], dtype=float))
        whole = quaternion_of_rotation(matrices(whole / np.linalg.norm(whole)))
        obstacle["quaternion_wxyz"] = whole.tolist()


def _hands(contents: Contents, grip: Grip) -> Array:
    return np.array([contents["manipulators"][hand][grip.kind] for hand in grip.hands], dtype=float)


def _upright(turn: Array) -> Array:
    angle = math.atan2(turn[3], turn[0])
    return np.array([math.cos(angle), 0.0, 0.0, math.sin(angle)])


def _finite(values: Sequence[float] | Array, count: int, what: str) -> Array:
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.shape != (count,) or not np.isfinite(array).all() or not np.linalg.norm(array) < 1e6:
        raise OptionError(f"the {what} is not {count} finite numbers", way_out="take hold of it again")
    return array


def _written(values: Array, digits: int = DIGITS) -> list[float]:
    return [round(float(value), digits) for value in values]


VALUES = ("duration", "bar", "speed", "acceleration", "clearance")
"""What `with_value` changes."""


def with_value(contents: Contents, key: str, value: float) -> Contents:
    """Return the contents with another value, one of `VALUES`.

    It is a duration [s], a limit, or the length of the bar [m]. 0 leaves the duration open, and removes a limit,
    except the clearance. The end effectors at both ends of a bar are moved along their line.

    Raises
    ------
    OptionError
        If the value is not a number from 0 on, or the payload is no bar, or a bar's length is not positive.
    """
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not number or not 0 <= float(value) < math.inf:
        raise OptionError(f"{key} = {value!r}", key=key, way_out="give a number from 0 on")
    if key == "duration":
        return contents | {"duration": value if value > 0 else None}
    if key == "bar":
        return _with_bar(contents, value)
    limits = dict(contents["limits"]) | {key: value if value > 0 or key == "clearance" else None}
    return contents | {"limits": limits}


def _with_bar(contents: Contents, length: float) -> Contents:
    load = contents.get("load") or {}
    if load.get("shape") != "bar" or not length > 0:
        raise OptionError("only a bar has a length, and it is positive", way_out="give a positive length")
    contents = copy.deepcopy(contents)
    contents["load"]["length"] = length
    names = [m["name"] for m in contents["manipulators"]]
    held_by = load.get("held_by") or names
    pair = [contents["manipulators"][names.index(name)] for name in held_by]
    for end in ("start", "goal"):
        ends = np.array([hand[end] for hand in pair], dtype=float)
        way = ends - ends.mean(axis=0)
        grown = ends.mean(axis=0) + way * length / np.linalg.norm(ends[1] - ends[0])
        for hand, place in zip(pair, grown, strict=True):
            hand[end] = _written(place, 12)
    for choice in contents.get("choices") or ():
        for name, grasp in choice["grasps"].items():
            choice["grasps"][name] = [x * length / load["length"] for x in grasp]
    return contents


SIZES = ("first size", "second size", "third size")
"""Names of the controls of an obstacle's sizes; no shape has more."""
_SIZES = {"size": "size", "radii": "semi-axis"}  # a list, with a value for each axis
_LENGTHS = {"radius": "radius [m]", "length": "length [m]", "height": "height [m]", "scale": "scale"}


def sizes_of(contents: Contents, obstacle: int) -> tuple[tuple[str, str, int | None, float], ...]:
    """Return the sizes of an obstacle. Each has a label, the key in the scene file, the index in the list there, and
    the value."""
    entry = contents["obstacles"][obstacle]
    found: list[tuple[str, str, int | None, float]] = []
    for key, words in _SIZES.items():
        values = enumerate(entry.get(key) or ())
        found += [(f"{words} along {'xyz'[axis]} [m]", key, axis, value) for axis, value in values]
    found += [(words, key, None, entry[key]) for key, words in _LENGTHS.items() if key in entry]
    return tuple(found)


def with_size(contents: Contents, obstacle: int, number: int, value: float) -> Contents:
    """Return the contents with another size, numbered as in `sizes_of`.

    Raises
    ------
    OptionError
        If there is no such size, or the value is not positive.
    """
    sizes = sizes_of(contents, obstacle)
    positive = isinstance(value, (int, float)) and not isinstance(value, bool) and 0 < value < math.inf
    if not positive or number >= len(sizes):
        raise OptionError(f"size = {value!r}", key="size", way_out="give a number above 0")
    _, key, axis, _ = sizes[number]
    contents = copy.deepcopy(contents)
    entry = contents["obstacles"][obstacle]
    if axis is None:
        entry[key] = value
    else:
        entry[key][axis] = value
    return contents


def with_box(contents: Contents, share: float = 0.1) -> Contents:
    """Return the contents with one more box in the workspace's middle.

    Parameters
    ----------
    share : its edges, as a share of the longest side of the workspace
    """
    low, high = (np.array(contents["workspace"][end], dtype=float) for end in ("lower", "upper"))
    names = {obstacle.get("name") for obstacle in contents["obstacles"]}
    name = next(name for i in range(1, len(names) + 2) if (name := f"box_{i}") not in names)
    edge = round(share * float((high - low).max()), DIGITS)
    box = {"shape": "box", "name": name, "center": _written(0.5 * (low + high)), "size": [edge] * len(low)}
    turn = {"rotation_deg": 0.0} if len(low) == 2 else {"quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}
    return contents | {"obstacles": [*contents["obstacles"], box | turn]}


def without_obstacle(contents: Contents, obstacle: int) -> Contents:
    """Return the contents without an obstacle."""
    kept = [entry for i, entry in enumerate(contents["obstacles"]) if i != obstacle]
    return contents | {"obstacles": kept}
