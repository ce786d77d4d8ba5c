"""Checks of a URDF beyond Pinocchio's: names, numbers and the tree."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from graphlib import CycleError, TopologicalSorter

import numpy as np

from comove.arrays import Array
from comove.errors import RobotError, shortened

LIMITED = ("revolute", "prismatic")
FREE = ("floating", "planar")
LIMITS, REQUIRED = ("lower", "upper", "velocity", "effort"), ("velocity", "effort")
RATES = {"acceleration": ("acceleration", "deceleration"), "jerk": ("jerk",)}
"""Attributes of a <limit>, with any prefix, that state a limit of a description."""
MOMENTS = (("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2))
NUMBERS = {
    "origin": {"xyz": (3, "m"), "rpy": (3, "rad")},
    "axis": {"xyz": (3, "")},
    "safety_controller": dict.fromkeys(
        ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"), (1, "")
    ),
    "dynamics": {"damping": (1, ""), "friction": (1, "")},
    "mimic": {"multiplier": (1, ""), "offset": (1, "")},
    "calibration": {"rising": (1, ""), "falling": (1, "")},
    "mass": {"value": (1, "kg")},
    "inertia": dict.fromkeys((key for key, *_ in MOMENTS), (1, "kg m^2")),
    "box": {"size": (3, "m")},
    "sphere": {"radius": (1, "m")},
    "cylinder": {"radius": (1, "m"), "length": (1, "m")},
    "capsule": {"radius": (1, "m"), "length": (1, "m")},
    "mesh": {"scale": (3, "")},
    "color": {"rgba": (4, "")},
    "limit": dict.fromkeys(sum(RATES.values(), ()), (1, "")),
}
"""How many numbers an attribute holds, and their unit, by element; `_check_limits` checks those of `LIMITS`."""
WHOLE = ("axis", "mass", "inertia", "box", "sphere", "cylinder", "capsule")  # have all of these attributes
HINTS = "collision_checking"  # names shapes that Pinocchio may take for others, and gives them no sizes
COUNTS = {1: "one number", 3: "three numbers with blanks between", 4: "four numbers with blanks between"}
_NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")
_MINUS = str.maketrans(dict.fromkeys("\u2010\u2011\u2012\u2013\u2014\u2212\ufe63\uff0d", "-"))
MAX_NAME = 200  # characters
MAX_LINKS = 10_000
MAX_CHAIN = 1000  # joints one after the other: Pinocchio goes down by recursion
MAX_JOINTS, MAX_BODIES = 1000, 1000  # that move; shapes, every two of which are compared
FARTHEST = 1000.0  # m, of a frame from its parent frame
HEAVIEST = 1e6  # kg, and kg m^2
TAKEN = "universe"  # Pinocchio's own frame


def require_sound(tree: ET.Element) -> None:
    """Reject a model that is meaningless or too large."""
    joints, links = tree.findall("./joint"), tree.findall("./link")
    for element in (*links, *joints):
        _require_name(element)
    for element in tree:
        if element.tag in ("link", "joint", "material"):
            _check_numbers(element, f"the {element.tag} '{element.get('name', '')}'")
    for joint in joints:
        name = joint.get("name", "")
        _check_limits(joint, name)
        _check_axis(joint, name)
        _check_place(joint, f"the joint '{name}'")
    _check_mimics(joints)
    for link in links:
        _check_link(link, f"the link '{link.get('name', '')}'")
    _check_sizes(tree)
    require_tree(tree)


def _require_name(element: ET.Element) -> None:
    name = element.get("name")
    if name is None:
        return  # Pinocchio tells
    if not name or len(name) > MAX_NAME or not name.isprintable() or name == TAKEN:
        raise RobotError(
            f"a {element.tag} has the name {shortened(ascii(name) if not name.isprintable() else repr(name))}",
            way_out=f"give it another, of 1 to {MAX_NAME} characters that can be printed"
            if name != TAKEN
            else "give it another: that one is Pinocchio's own",
        )


def local_name(name: str) -> str:
    """Return the name of an element or an attribute without its prefix."""
    return name.rpartition(":")[2]


def _check_numbers(owner: ET.Element, told: str) -> None:
    """Reject attributes with a wrong count of numbers; separate these by blanks. Pinocchio requires it."""
    hints = {element for hint in owner.iter(HINTS) for element in hint.iter()}
    for element in (each for each in owner.iter() if each not in hints):
        for attribute, (count, unit) in NUMBERS[element.tag].items() if element.tag in WHOLE else ():
            if attribute not in element.attrib:
                raise RobotError(
                    f"{told} has <{element.tag}> without {attribute}",
                    way_out=f"write {attribute}: {COUNTS[count]}{unit and f' [{unit}]'}",
                )
        for attribute, text in element.attrib.items():
            count, unit = NUMBERS.get(element.tag, {}).get(local_name(attribute), (0, ""))
            parts = text.split()
            if count and not _are_numbers(parts, count):
                raise RobotError(
                    f"{told} has <{element.tag} {attribute}={shortened(ascii(text))}>",
                    way_out=_correction(attribute, text, count, unit),
                )
            if count:
                element.set(attribute, " ".join(parts))


def _are_numbers(parts: list[str], count: int) -> bool:
    return len(parts) == count and all(number(part) is not None for part in parts)


def _correction(attribute: str, text: str, count: int, unit: str) -> str:
    """Return the correction of a text that should hold some numbers."""
    if "$" in text:
        return "expand the xacro first: xacro FILE > robot.urdf"
    plain = text.translate(_MINUS)
    for parts in (plain.split(), re.split(r"[\s,;]+", plain.strip(" ,;")), plain.replace(",", ".").split()):
        if _are_numbers(parts, count):
            return f'write {attribute}="{" ".join(parts)}"'
    return f"write {COUNTS[count]}{unit and f' [{unit}]'}"


def _check_limits(joint: ET.Element, name: str) -> None:
    limit, wrong = joint.find("limit"), {}
    for key in LIMITS:
        text = None if limit is None else limit.get(key)
        if text is None:
            if joint.get("type") in LIMITED and key in REQUIRED:
                wrong[key] = "is missing"
        elif number(text) is None or (key in REQUIRED and float(text) < 0):
            wrong[key] = f"is '{shortened(text)}'"
        elif limit is not None:
            limit.set(key, text.strip())
    if wrong:
        told = ", ".join(f"{key} {what}" for key, what in wrong.items())
        given = ", ".join(f"{key}: NUMBER" for key in wrong)
        raise RobotError(
            f"of the limits of the joint '{name}', {told}",
            way_out=f"correct it, or give it in the description: limits: {{{name}: {{{given}}}}}",
        )


def _check_axis(joint: ET.Element, name: str) -> None:
    axis = joint.find("axis") if joint.get("type") in (*LIMITED, "continuous", "planar") else None
    if axis is None:
        return
    length = math.hypot(*map(float, axis.get("xyz", "1 0 0").split()))
    if not 1e-6 < length < 1e6:
        raise RobotError(f"the axis of the joint '{name}' has no direction", way_out="correct it")


def _check_mimics(joints: list[ET.Element]) -> None:
    """Reject joints that mimic each other in a circle."""
    follows = {
        joint.get("name"): {mimic.get("joint")} for joint in joints for mimic in joint.findall("mimic")
    }
    try:
        TopologicalSorter(follows).prepare()
    except CycleError as error:
        raise RobotError(
            f"the joint '{_first_of(follows, error)}' goes along with itself", way_out="correct its <mimic>"
        ) from None


def _first_of(names: Iterable[str | None], error: CycleError) -> str | None:
    circle = set(error.args[1])
    return next(name for name in names if name in circle)


def _check_link(link: ET.Element, told: str) -> None:
    for inertial in link.findall("inertial"):
        _check_place(inertial, told)
        _check_inertia(inertial, told)
    for collision in link.findall("collision"):
        _check_place(collision, told)
        for shape in collision.findall("geometry/*"):
            _check_shape(shape, told)


def _check_place(element: ET.Element, told: str) -> None:
    """Reject origins that are too far away, or turned by impossible angles."""
    origin = element.find("origin")
    if origin is None:
        return
    for key, how, unit in (("xyz", "has an origin at", "metres"), ("rpy", "is turned by", "radians")):
        values = origin.get(key, "")
        if any(abs(float(text)) > FARTHEST for text in values.split()):
            raise RobotError(f"{told} {how} {shortened(values)}", way_out=f"write {unit}")


def _check_inertia(inertial: ET.Element, told: str) -> None:
    """Reject masses and moments of inertia that are missing or impossible."""
    mass = inertial.find("mass")
    for tag in ("mass", "inertia"):
        if inertial.find(tag) is None:
            raise RobotError(
                f"{told} has an <inertial> without <{tag}>", way_out="write it, or leave the <inertial> out"
            )
    kilograms = 0.0 if mass is None else float(mass.get("value", "0"))
    if not 0 <= kilograms < HEAVIEST:
        raise RobotError(f"{told} has the mass {kilograms:g} kg", way_out="correct its <inertial>")
    moments = _moments(inertial)
    if not (np.abs(moments) < HEAVIEST).all():
        raise RobotError(
            f"{told} has the moments of inertia {_listed(moments)}", way_out="correct its <inertial>"
        )


def _moments(inertial: ET.Element) -> Array:
    """Compute the principal moments of inertia, the least first; array, shape (3,) [kg m^2]."""
    inertia, matrix = inertial.find("inertia"), np.zeros((3, 3))
    for key, row, column in MOMENTS:
        matrix[column, row] = (
            0.0 if inertia is None else float(inertia.get(key, "0"))
        )  # the lower half counts
    with np.errstate(all="ignore"):
        return np.asarray(np.linalg.eigvalsh(matrix), dtype=np.float64)


def _listed(moments: Array) -> str:
    return f"{', '.join(f'{moment:.3g}' for moment in moments)} kg m^2"


def doubts(tree: ET.Element) -> Iterator[str]:
    """Yield warnings of impossible values that published models contain."""
    # of the largest moment of inertia, and kg m^2, that the least may be below 0
    rounding, least = 1e-6, 1e-12
    for link in tree.findall("./link"):
        for inertial in link.findall("inertial"):
            moments = _moments(inertial)
            if moments[0] < -rounding * moments[2] - least:
                yield (
                    f"the link '{link.get('name', '')}' has the moments of inertia {_listed(moments)}, "
                    "and none can be negative: what it asks of its motors may be wrong"
                )


def _check_shape(shape: ET.Element, told: str) -> None:
    """Reject sizes that are not positive. A mesh may be mirrored."""
    for key in ("size", "radius", "length", "scale"):
        values = [float(text) for text in shape.get(key, "").split()]
        if any(v == 0 or (v < 0 and key != "scale") for v in values):
            raise RobotError(
                f"{told} has a <{shape.tag}> with the {key} '{shortened(shape.get(key, ''))}'",
                way_out="write positive numbers [m]" if key != "scale" else "write numbers other than 0",
            )


def _check_sizes(tree: ET.Element) -> None:
    moving = sum(joint.get("type") != "fixed" for joint in tree.findall("./joint"))
    for n, most, what in (
        (moving, MAX_JOINTS, "joints that move"),
        (len(tree.findall("./link/collision")), MAX_BODIES, "collision bodies"),
    ):
        if n > most:
            raise RobotError(f"it has {n} {what}, more than {most}", way_out="simplify it")


def ends_of(joint: ET.Element) -> tuple[str, str]:
    """Return the links that a joint connects, the parent first. They are empty where it names none."""
    parent, child = (joint.find(tag) for tag in ("parent", "child"))
    return ("" if parent is None else parent.get("link", ""), "" if child is None else child.get("link", ""))


def require_tree(tree: ET.Element) -> None:
    """Reject what is not one tree of links, and trees too deep. Joints connect two links each."""
    links = dict.fromkeys(link.get("name", "") for link in tree.findall("./link"))
    if not links:
        raise RobotError("it has no link", way_out="name a URDF with the links of a robot")
    hangs: dict[str, tuple[str, str]] = {}  # on which joint, and link above it
    for joint in tree.findall("./joint"):
        parent, child = ends_of(joint)
        for end, tag in ((parent, "parent"), (child, "child")):
            if end not in links:
                lacks = f"the <{tag}> '{shortened(end)}', which is not there" if end else f"no <{tag}>"
                raise RobotError(
                    f"the joint '{joint.get('name')}' has {lacks}", way_out="let it connect two links"
                )
        if child in hangs:
            raise RobotError(
                f"the link '{child}' hangs on two joints, '{hangs[child][0]}' and '{joint.get('name')}'",
                way_out="let it hang on one: a URDF is a tree",
            )
        hangs[child] = joint.get("name", ""), parent
    depth: dict[str, int] = {}
    try:
        for link in TopologicalSorter({child: {above} for child, (_, above) in hangs.items()}).static_order():
            depth[link] = 1 + depth[hangs[link][1]] if link in hangs else 0
    except CycleError as error:
        raise RobotError(
            f"the joints go round in a circle at the link '{_first_of(links, error)}'",
            way_out="open it: a URDF is a tree",
        ) from None
    if max(depth.values(), default=0) > MAX_CHAIN:
        raise RobotError(
            f"more than {MAX_CHAIN} joints follow one another", way_out="join links that do not move"
        )
    if len(links) > MAX_LINKS:
        raise RobotError(
            f"it has {len(links)} links, more than {MAX_LINKS}",
            way_out="leave out what is no part of the robot",
        )
    if len(roots := [link for link in links if link not in hangs]) > 1:
        raise RobotError(
            f"the links '{roots[0]}' and '{roots[1]}' both hang on no joint",
            way_out="connect all links by joints: a URDF is a tree",
        )


def number(text: str) -> float | None:
    """Return the finite number that a URDF text holds, or None."""
    value = float(text) if _NUMBER.fullmatch(text.strip()) else math.nan
    return value if math.isfinite(value) else None
