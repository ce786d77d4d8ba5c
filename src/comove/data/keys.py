"""Changes of a scene file's contents by dotted keys.

Examples are `load.length` and `obstacles.0.center.1`. An entry of a list is named by its number, a manipulator also
by its name. Besides the keys of a scene there are `start` and `goal`, a shift of all end effectors together,
`start.turn_deg` and `goal.turn_deg`, a rotation of all end effectors about their common centre, or of the payload
about its frame's origin, in space about the vertical, and `scene`, a shift of end effectors, obstacles and workspace
together, as if the robot stood elsewhere.
"""

from __future__ import annotations

import math
from typing import Any

from comove.errors import near_name
from comove.io.keys import Wrong, show

ENDS = ("start", "goal")
TURNS = {f"{end}.turn_deg": end for end in ENDS}
LENGTH = "load.length"
WHOLE = "scene"


def change(data: dict[str, Any], key: str, value: Any, *, add: bool = False) -> None:
    """Change the contents of a scene file in place.

    Parameters
    ----------
    value : value of the key, or shift, or rotation [deg]
    add : whether numbers are added to the present ones

    Raises
    ------
    Wrong
        If there is no such key, or the value does not fit; with the correction.
    """
    if key in ENDS:
        _shift(data, key, value)
    elif key in TURNS:
        _turn(data, TURNS[key], value)
    elif key == WHOLE:
        _shift_all(data, value)
    else:
        holder, last = _place(data, key.split("."))
        if add:
            value = _sum(_at(holder, last), value, key)
        holder[last] = value


def fit_hands(data: dict[str, Any]) -> None:
    """Fit the distance of a bar's end effectors to its length. They move along the line between them; their centre
    stays. Nothing changes where end effectors or length are not valid in a scene."""
    load = data.get("load")
    hands = [hand for hand in _hands(data) if not isinstance(load, dict) or _holds(load, hand)]
    if not isinstance(load, dict) or load.get("shape") != "bar" or len(hands) != 2:
        return
    for end in ENDS:
        first, second = (hand.get(end) or [] for hand in hands)
        if not (_is_vector(first) and _is_vector(second) and _is_number(load.get("length"))):
            return
        apart = math.dist(first, second) if len(first) == len(second) else 0.0
        if apart > 0.0:
            share = 0.5 * (load["length"] / apart - 1.0)
            away = [share * (a - b) for a, b in zip(first, second, strict=True)]
            hands[0][end] = [a + d for a, d in zip(first, away, strict=True)]
            hands[1][end] = [b - d for b, d in zip(second, away, strict=True)]


def hand_names(data: dict[str, Any]) -> tuple[str, ...]:
    """Return the names of the end effectors in a scene's contents."""
    given = data.get("grasps")
    held = given[0] if isinstance(given, list) and given else given
    free = data.get("end_effectors")
    new = [*(held if isinstance(held, dict) else ()), *(free if isinstance(free, dict) else ())]
    return tuple(map(str, new)) or tuple(str(hand.get("name")) for hand in _hands(data))


def _holds(load: dict[str, Any], hand: dict[str, Any]) -> bool:
    return load.get("held_by") is None or hand.get("name") in load["held_by"]


def _hands(data: dict[str, Any]) -> list[dict[str, Any]]:
    hands = data.get("manipulators")
    return [hand for hand in hands if isinstance(hand, dict)] if isinstance(hands, list) else []


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _is_vector(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(map(_is_number, value))


def _vectors(data: dict[str, Any], end: str) -> list[list[float]]:
    """Return the starts or goals of all end effectors, or raise `Wrong`."""
    points = [hand.get(end) for hand in _hands(data)]
    if not points or not all(map(_is_vector, points)):
        raise Wrong(f"the scene gives no {end} of every hand", f"write the {end} of every manipulator")
    return points  # type: ignore[return-value]


def _pose(data: dict[str, Any], end: str) -> dict[str, Any] | None:
    """Return the payload's pose at an end; None before version 2."""
    payload = data.get("payload")
    pose = payload.get(end) if isinstance(payload, dict) else None
    return pose if isinstance(pose, dict) and _is_vector(pose.get("position")) else None


def _shift(data: dict[str, Any], end: str, shift: Any) -> None:
    if (pose := _pose(data, end)) is not None:
        pose["position"] = _sum(pose["position"], shift, end)
        return
    points = _vectors(data, end)
    for hand, point in zip(_hands(data), points, strict=True):
        hand[end] = _sum(point, shift, end)


def _turn_pose(pose: dict[str, Any], degrees: float) -> None:
    """Rotate a pose in place, about the vertical through its position."""
    key, half = "angle_deg", math.radians(degrees) / 2
    if len(pose["position"]) == 3:
        key = "quaternion_wxyz" if "quaternion_wxyz" in pose else "rpy_deg"
    if key == "angle_deg":
        pose[key] = pose.get(key, 0.0) + degrees
    elif key == "rpy_deg":  # the turn about z is the last
        x, y, z = pose.get(key, (0.0, 0.0, 0.0))
        pose[key] = [x, y, z + degrees]
    else:
        c, s, (w, x, y, z) = math.cos(half), math.sin(half), pose[key]
        pose[key] = [c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w]


def _shift_all(data: dict[str, Any], shift: Any) -> None:
    for end in ENDS:
        _shift(data, end, shift)
    obstacles = data.get("obstacles")
    parts = [data.get("workspace"), *(obstacles if isinstance(obstacles, list) else ())]
    for part in (one for one in parts if isinstance(one, dict)):
        for key in ("lower", "upper", "center"):
            if key in part:
                part[key] = _sum(part[key], shift, key)
        motion = part.get("motion")
        if isinstance(motion, dict) and isinstance(motion.get("waypoints"), list):
            motion["waypoints"] = [_sum(point, shift, "waypoints") for point in motion["waypoints"]]


def _turn(data: dict[str, Any], end: str, degrees: Any) -> None:
    if not _is_number(degrees):
        raise Wrong(f"{show(degrees)} is no angle", "draw a number of degrees")
    if (pose := _pose(data, end)) is not None:
        _turn_pose(pose, float(degrees))
        return
    points = _vectors(data, end)
    center = [sum(p[axis] for p in points) / len(points) for axis in (0, 1)]
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    for hand, point in zip(_hands(data), points, strict=True):
        x, y = point[0] - center[0], point[1] - center[1]
        turned = [center[0] + cosine * x - sine * y, center[1] + sine * x + cosine * y]
        hand[end] = [*turned, *point[2:]]


def _sum(value: Any, more: Any, key: str) -> Any:
    """Return the sum of two numbers or of two lists of numbers."""
    if _is_number(value) and _is_number(more):
        return value + more
    if _is_vector(value) and _is_vector(more) and len(value) == len(more):
        return [a + b for a, b in zip(value, more, strict=True)]
    wanted = f"a list of {len(value)} numbers" if isinstance(value, list) else "a number"
    raise Wrong(f"{show(more)} cannot be added to {show(value)}, the value of {key}", f"draw {wanted}")


def _place(data: Any, parts: list[str]) -> tuple[Any, str | int]:
    """Return the container of a key, and the key within it. Missing mappings are made."""
    found = data
    here: list[str] = []
    for part in parts[:-1]:
        key = _key_in(found, part, here)
        if isinstance(found, dict) and found.get(part) is None:
            found[part] = {}
        found = found[key]
        here.append(part)
    return found, _key_in(found, parts[-1], here)


def _key_in(holder: Any, part: str, here: list[str]) -> str | int:
    """Return a key part as mapping key or list index."""
    where = ".".join(here) or "the scene"
    if isinstance(holder, dict):
        return part
    if not isinstance(holder, list):
        raise Wrong(
            f"{where} is {show(holder)}, which has no {show(part)}", "name a key of the scene that there is"
        )
    names = [entry.get("name") for entry in holder if isinstance(entry, dict) and "name" in entry]
    if part in names:
        return next(i for i, e in enumerate(holder) if isinstance(e, dict) and e.get("name") == part)
    if part.isdigit() and int(part) < len(holder):
        return int(part)
    known = [str(name) for name in names] + [str(i) for i in range(len(holder))]
    raise Wrong(f"{where} has no entry {show(part)}", near_name(part, known))


def _at(holder: Any, key: str | int) -> Any:
    """Return the value of a key, or raise `Wrong` without one."""
    if isinstance(holder, dict) and holder.get(str(key)) is None:
        raise Wrong(f"the scene has no {key} to add to", "leave add out, or write the key in the scene")
    return holder[key]
