"""The tree of links of a URDF: where its arms begin and end, and which joints are fingers.

Links that fixed joints connect form one body. A body that at least two long chains leave is a trunk: the joints above
it belong to no arm. An arm ends at a palm, whose joints are fingers, or at a body that no joint leaves.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import inf, pi

from comove.robots.soundness import number

MOVING = ("revolute", "continuous", "prismatic")
LEAST = 4  # joints of an arm
MOST_OF_FINGER = 4  # joints
LONGEST_FINGER = 5  # joints, as the thumb and the little finger of a Shadow hand have
MANY = 3  # joints that leave the hand of an arm
OTHERS = re.compile(r"leg|hip|knee|ankle|foot|toe|wheel|thigh|calf|neck|head|gaze", re.IGNORECASE)
FINGERS = re.compile(r"finger|gripper|jaw|knuckle|thumb|claw", re.IGNORECASE)
TIPS = tuple(  # names of the last frame of an arm, the best first
    re.compile(pattern, re.IGNORECASE)
    for pattern in ("tcp", "grasp", "tool", "gripper$", "(^|_)ee(_|$)|eef", "palm", "hand", "gripper")
)


@dataclass(frozen=True)
class Joint:
    """A joint of a URDF.

    Attributes
    ----------
    name, kind : name and type
    parent, child : links that it connects
    follows : whether it goes along with another joint
    range : between its limits [rad, m]; inf of one that turns without end, 0 of one whose limits are not stated
    """

    name: str
    kind: str
    parent: str
    child: str
    follows: bool
    range: float

    @property
    def moves(self) -> bool:
        """Return whether it has a motor of its own."""
        return self.kind in MOVING and not self.follows

    @property
    def grips(self) -> bool:
        """Return whether it may be a finger's: it slides, follows, or has such a name and turns by less than half a
        turn, as wrists of that name do not.
        """
        return (
            self.kind == "prismatic" or self.follows or (bool(FINGERS.search(self.name)) and self.range < pi)
        )


@dataclass(frozen=True)
class Chain:
    """An arm as the tree suggests it.

    Attributes
    ----------
    trunk : joints from the base to the trunk, which move other arms too
    joints : joints from the trunk to the last body
    links : links of the last body, from the last joint on
    fingers : joints beyond, those that go along with others included
    grippers : links that fingers move
    tip : the link that suits best for the arm's last frame
    """

    trunk: tuple[str, ...]
    joints: tuple[str, ...]
    links: tuple[str, ...]
    fingers: tuple[str, ...]
    grippers: tuple[str, ...]

    @property
    def tip(self) -> str:
        """Return the link of the last body whose name is that of a tool, else the last one."""
        for pattern in TIPS if self.fingers else TIPS[:-1]:
            for link in self.links:
                if pattern.search(link):
                    return link
        return self.links[-1]

    @property
    def is_other(self) -> bool:
        """Return whether the names are those of a leg, a wheel or a neck."""
        return any(OTHERS.search(name) for name in (*self.joints, *self.links))


@dataclass(frozen=True)
class Tree:
    """The links and joints of a URDF.

    Attributes
    ----------
    root : link without a parent
    joints : all joints
    """

    root: str
    joints: tuple[Joint, ...]

    @classmethod
    def of(cls, urdf: str) -> Tree:
        """Return the tree of a URDF's text, which has been found sound (`comove.robots.soundness`)."""
        top = ET.fromstring(urdf)
        joints = tuple(
            Joint(
                joint.get("name", ""),
                joint.get("type", ""),
                joint.find("parent").get("link", ""),  # type: ignore[union-attr]  # sound
                joint.find("child").get("link", ""),  # type: ignore[union-attr]
                joint.find("mimic") is not None,
                _range(joint),
            )
            for joint in top.findall("joint")
        )
        children = {joint.child for joint in joints}
        roots = [link.get("name", "") for link in top.findall("link") if link.get("name") not in children]
        return cls(roots[0], joints)

    @cached_property
    def _below(self) -> dict[str, list[Joint]]:
        below: dict[str, list[Joint]] = {}
        for joint in self.joints:
            below.setdefault(joint.parent, []).append(joint)
        return below

    def body(self, link: str) -> tuple[str, ...]:
        """Return a link and all that fixed joints connect to it from there on."""
        links = [link]
        for known in links:
            links += [joint.child for joint in self._below.get(known, []) if joint.kind not in MOVING]
        return tuple(links)

    def leaving(self, link: str) -> list[Joint]:
        """Return the joints, moving or following, that leave the body of a link."""
        return [
            joint for known in self.body(link) for joint in self._below.get(known, []) if joint.kind in MOVING
        ]

    def depth(self, joint: Joint) -> int:
        """Return the largest number of motors one after the other from a joint on."""
        return int(joint.moves) + max((self.depth(j) for j in self.leaving(joint.child)), default=0)

    def is_palm(self, link: str) -> bool:
        """Return whether only fingers leave the body of a link."""
        leaving = self.leaving(link)
        short = all(self.depth(joint) <= MOST_OF_FINGER for joint in leaving)
        of_gripper = [joint for joint in leaving if joint.grips]
        return bool(leaving) and short and (len(leaving) > 1 or len(of_gripper) == len(leaving))

    def chains(self) -> tuple[Chain, ...]:
        """Return the arms of the robot, and what else is as long as an arm."""
        return tuple(chain for chain in self._from(self.root, (), ()) if len(chain.joints) >= LEAST)

    def _from(self, link: str, trunk: tuple[str, ...], joints: tuple[str, ...]) -> Iterator[Chain]:
        """Yield the chains that leave the body of a link, which the joints of a trunk and `joints` have led to."""
        leaving = self.leaving(link)
        deep = sum(self.depth(joint) > LONGEST_FINGER for joint in leaving)
        is_chest = deep == 2  # models of hands have such fingers as well, but more
        at_hand = len(joints) >= LEAST and not is_chest and (self.is_palm(link) or len(leaving) >= MANY)
        if not leaving or at_hand:
            fingers = tuple(self._all_from(leaving))
            moved = (link for finger in fingers for link in self.body(finger.child))
            yield Chain(
                trunk, joints, self.body(link), tuple(finger.name for finger in fingers), tuple(moved)
            )
            return
        long = [joint for joint in leaving if self.depth(joint) >= LEAST]
        if len(long) > 1:
            for joint in long:
                yield from self._from(joint.child, (*trunk, *joints), (joint.name,))
            return
        # What else leaves it, such as a head, is no part of the arm.
        deepest = max(leaving, key=self.depth)
        yield from self._from(deepest.child, trunk, (*joints, deepest.name) if deepest.moves else joints)

    def _all_from(self, joints: list[Joint]) -> Iterator[Joint]:
        for joint in joints:
            yield joint
            yield from self._all_from(self.leaving(joint.child))


def _range(joint: ET.Element) -> float:
    """Return by how much a joint turns or slides [rad, m]; 0 where its URDF states no limits of it."""
    limit = joint.find("limit")
    if joint.get("type") == "continuous":
        return inf
    lower, upper = (
        number("0" if limit is None else limit.get(key, "0")) or 0.0 for key in ("lower", "upper")
    )
    return max(upper - lower, 0.0)
