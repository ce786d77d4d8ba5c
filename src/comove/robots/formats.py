"""Formats of robot files: their detection, and commands that convert them.

Of an SRDF, the pairs of links that need not be kept apart and the group states are read.
As in MoveIt 2, ``<disable_default_collisions link="a"/>`` leaves out all pairs of a link, ``<enable_collisions/>``
brings pairs back, and ``<disable_collisions/>`` leaves out pairs in the end (srdfdom, `AllowedCollisionMatrix`).
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from comove.errors import MeshError, RobotError, shortened
from comove.geometry.triangles import elements_of
from comove.robots.soundness import number

MAX_BYTES = 20_000_000
URDF, SRDF, MJCF, XACRO, SDF = "a URDF", "an SRDF", "a model of MuJoCo's (MJCF)", "a xacro", "an SDF"
DESCRIPTION = "a robot description (YAML)"
ROOTS = {"mujoco": MJCF, "mujocoinclude": MJCF, "sdf": SDF}
UNEXPANDED = ("${", "$(")  # in the values of a xacro


def elements_in(path: Path, wanted: str) -> ET.Element:
    """Return the root element of a robot file of the format `wanted`.

    Raises
    ------
    RobotError
        If it cannot be read, or is of another format; the message names the command that converts it.
    """
    data = bytes_in(path, MAX_BYTES)
    if path.suffix.lower() in (".yaml", ".yml") and not data.lstrip().startswith(b"<"):
        raise _other(path, DESCRIPTION, wanted)
    try:
        root = elements_of(data)
    except MeshError as error:
        raise RobotError(error.message, file=path, way_out=error.way_out) from None
    require_format(root, path, wanted)
    return root


def bytes_in(path: Path, limit: int) -> bytes:
    """Read a file of at most `limit` bytes.

    Raises
    ------
    RobotError
        If it cannot be read, or is larger.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(limit + 1)
    except OSError as error:
        raise RobotError(
            f"it cannot be read: {error.strerror}", file=path, way_out="check name and rights"
        ) from None
    if len(data) > limit:
        raise RobotError(f"it is larger than {limit // 1_000_000} MB", file=path, way_out="simplify it")
    return data


def require_format(root: ET.Element, path: Path, wanted: str) -> None:
    """Reject a file of another format, with the command to convert it."""
    text = None if wanted == MJCF and root.tag != "robot" else _unexpanded(root)
    if text is not None:
        raise _other(path, XACRO, wanted, f" ({shortened(text)})")
    if root.tag == "robot":
        found = SRDF if root.find("link") is None and _tells_pairs(root) else URDF
        if wanted == SRDF and found == URDF and root.find("link") is None:
            return  # one that names no pair
    else:
        found = ROOTS.get(root.tag, "")
    if not found:
        needs = "<mujoco>" if wanted == MJCF else "<robot>"
        raise RobotError(
            f"it is a <{shortened(root.tag)}>, not a {needs}", file=path, way_out=f"name {wanted}"
        )
    if found != wanted:
        raise _other(path, found, wanted)


def require_description(path: Path) -> None:
    """Reject a model in place of a description. The message names the command that converts it."""
    try:
        with open(path, "rb") as file:
            begins = file.read(200).removeprefix(b"\xef\xbb\xbf").lstrip()
    except OSError:
        return  # the reader tells
    if begins.startswith(b"<"):
        elements_in(path, DESCRIPTION)


def _unexpanded(root: ET.Element) -> str | None:
    """Return the first text of an unexpanded xacro; None if there is none."""
    for element in root.iter():
        if "xacro" in element.tag:
            return f"<{element.tag}>"
        for key, value in element.attrib.items():
            if any(mark in value for mark in UNEXPANDED):
                return f'{key}="{value}"'
    return None


def _tells_pairs(root: ET.Element) -> bool:
    tags = ("disable_collisions", "disable_default_collisions", "group", "group_state", "end_effector")
    return any(root.find(tag) is not None for tag in tags)


def _other(path: Path, found: str, wanted: str, shown: str = "") -> RobotError:
    """Return the error of a file of the format `found`."""
    way_out = {
        XACRO: f"expand it first: pip install xacro, then xacro {path} > robot.urdf",
        MJCF: f"convert it first: comove robot convert {path} --out FOLDER",
        URDF: f"describe it first: comove robot new {path} --out robot.yaml",
        SRDF: "name the URDF, and this file as its `srdf` in the description",
        DESCRIPTION: f"check it with comove robot check {path}, or name the model in it",
        SDF: "export it as a URDF from the program that wrote it",
    }[found]
    if wanted == SRDF:
        way_out = "name the SRDF of the URDF, or leave `srdf` out of the description"
    return RobotError(f"it is {found}{shown}, not {wanted}", file=path, way_out=way_out)


LinkPair = frozenset[str]


@dataclass(frozen=True)
class GroupState:
    """Joint values of an SRDF's group [rad, m for prismatic joints]."""

    name: str
    group: str
    values: dict[str, float]


@dataclass(frozen=True)
class Srdf:
    """Contents of an SRDF.

    Attributes
    ----------
    disabled : pairs of links that need not be kept apart
    enabled : pairs of links that are kept apart, even if one joint connects them
    states : group states, in the order of the file
    """

    disabled: frozenset[LinkPair] = frozenset()
    enabled: frozenset[LinkPair] = frozenset()
    states: tuple[GroupState, ...] = ()


def srdf_of(root: ET.Element, links: Iterable[str], prefix: str = "") -> Srdf:
    """Return the contents of an SRDF for the links of a model.

    Parameters
    ----------
    links : names of the links, with the model's prefix
    prefix : the model's prefix of the names in the SRDF

    Raises
    ------
    RobotError
        If an element does not name its links, or a value is not a number.
    """
    disabled = set(_pairs(root, "disable_collisions", prefix))
    enabled = set(_pairs(root, "enable_collisions", prefix)) - disabled
    for element in root.iter("disable_default_collisions"):
        if not (link := element.get("link")):
            raise RobotError("a <disable_default_collisions> does not name a link", way_out='write link=""')
        disabled |= {frozenset((prefix + link, other)) for other in links} - enabled
    return Srdf(frozenset(disabled), frozenset(enabled), tuple(_states(root, prefix)))


def _pairs(root: ET.Element, tag: str, prefix: str) -> Iterator[LinkPair]:
    for element in root.iter(tag):
        first, second = element.get("link1"), element.get("link2")
        if not (first and second):
            raise RobotError(f"a <{tag}> does not name two links", way_out='write link1="" link2=""')
        yield frozenset((prefix + first, prefix + second))


def _states(root: ET.Element, prefix: str) -> Iterator[GroupState]:
    """Yield the group states. Joints of several values, which do not move, are left out."""
    for state in root.iter("group_state"):
        values: dict[str, float] = {}
        for joint in state.findall("joint"):
            text = joint.get("value", "")
            value = number(text)
            if value is not None:
                values[prefix + joint.get("name", "")] = value
            elif not text.split() or any(number(part) is None for part in text.split()):
                raise RobotError(
                    f"the group state '{shortened(state.get('name', ''))}' has the joint "
                    f"'{shortened(joint.get('name', ''))}' at '{shortened(text)}'",
                    way_out="write a number [rad, m]",
                )
        yield GroupState(state.get("name", ""), state.get("group", ""), values)
