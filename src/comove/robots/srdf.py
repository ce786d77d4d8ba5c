"""Reader of SRDFs: which pairs of links need not be kept apart, and group states.

As in MoveIt 2, ``<disable_default_collisions link="a"/>`` leaves out all pairs of a link, ``<enable_collisions/>``
brings pairs back, and ``<disable_collisions/>`` leaves out pairs in the end (srdfdom, `AllowedCollisionMatrix`).
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from comove.errors import RobotError, shortened
from comove.robots.soundness import number

LinkPair = frozenset[str]


@dataclass(frozen=True)
class GroupState:
    """Values of joints [rad, m for prismatic joints] that an SRDF names for a group."""

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
    """Return what an SRDF says of the links of a model; `prefix` is put before all names.

    Raises
    ------
    RobotError
        If an element does not name its links, or a value is not a number.
    """
    disabled = set(_pairs(root, "disable_collisions"))
    enabled = set(_pairs(root, "enable_collisions")) - disabled
    for element in root.iter("disable_default_collisions"):
        if not (link := element.get("link")):
            raise RobotError("a <disable_default_collisions> does not name a link", way_out='write link=""')
        disabled |= {frozenset((link, other)) for other in links} - enabled
    return Srdf(_prefixed(disabled, prefix), _prefixed(enabled, prefix), tuple(_states(root, prefix)))


def _pairs(root: ET.Element, tag: str) -> Iterator[LinkPair]:
    for element in root.iter(tag):
        first, second = element.get("link1"), element.get("link2")
        if not (first and second):
            raise RobotError(f"a <{tag}> does not name two links", way_out='write link1="" link2=""')
        yield frozenset((first, second))


def _prefixed(pairs: Iterable[LinkPair], prefix: str) -> frozenset[LinkPair]:
    return frozenset(frozenset(prefix + link for link in pair) for pair in pairs)


def _states(root: ET.Element, prefix: str) -> Iterator[GroupState]:
    """Yield the group states; joints of several values, which do not move, are left out."""
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
