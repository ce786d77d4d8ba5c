"""The tree of links of a URDF: ends of its arms, and finger joints.

Links that fixed joints connect form one body. A body that at least two long chains leave is a trunk: the joints above
it belong to no arm, nor do those that drive a mobile base, as simulators add them. An arm ends at a palm, whose
joints are fingers, or at a body that no joint leaves.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, pi

from comove.robots.further_limits import stated_limits
from comove.robots.soundness import ends_of, number

MOVING = ("revolute", "continuous", "prismatic")
# By kind of joint, where a model states nothing above 0 [rad/s, N m, m/s, N].
TURNING, SLIDING = {"velocity": 1.0, "effort": 50.0}, {"velocity": 0.1, "effort": 50.0}
GUESSED = {"revolute": TURNING, "continuous": TURNING, "prismatic": SLIDING}
GUESSES, SPRINGS = "comove:guessed", "comove:springs"  # attributes of a URDF (`comove.sim.mjcf`)
WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[^\W\d_A-Za-z]+")
OTHERS = re.compile(r"[lr]?(leg|hip|knee|ankle|foot|toe|wheel|thigh|calf|neck|head|gaze)s?")
FINGERS = re.compile(r"[lr]?(finger|gripper|jaw|knuckle|thumb|claw)s?")
WRISTS = frozenset(("roll", "pitch", "yaw", "wrist", "swivel", "rotate", "rotation", "twist"))
TIPS = (
    "tcp",
    "grasp|grasping",
    "tool(head|frame|plate)?",
    "gripper$",
    "ee|eef|effector",
    "flange",
    "palm",
    "hand",
    "gripper",
)
"""Words in the name of an arm's last frame, the best first; with $ only as the last word."""
LONG_STROKE = 0.2  # m, from which on a joint that slides is no finger unless it is called so
LONGEST_STROKE = 4.0  # m, beyond which what slides is no lift or gantry of an arm, but a base that drives


@dataclass(frozen=True)
class ArmShape:
    """Numbers that distinguish arms, hands and fingers.

    Attributes
    ----------
    least : joints of an arm
    finger : joints of the fingers that leave a palm, at most
    longest_finger : joints of any finger, at most: the number of thumb and little finger of a Shadow hand
    many : least number of joints that leave a hand
    """

    least: int = 4
    finger: int = 4
    longest_finger: int = 5
    many: int = 3


SHAPE = ArmShape()


def words_of(name: str) -> tuple[str, ...]:
    """Return the words of a name in lower case. It is split at non-letters, and in camelCase."""
    return tuple(word.lower() for word in WORD.findall(name))


def has_word(name: str, pattern: str | re.Pattern[str]) -> bool:
    """Return whether a whole word of a name matches a pattern. With $ at its end, the last word must."""
    words = words_of(name)
    if isinstance(pattern, str) and pattern.endswith("$"):
        words, pattern = words[-1:], pattern[:-1]
    return any(re.fullmatch(pattern, word) for word in words)


@dataclass(frozen=True)
class Joint:
    """A joint of a URDF.

    Attributes
    ----------
    name, kind : name and type
    parent, child : links that it connects
    leader : name of the joint that it follows; None where it moves by itself
    limits : the stated numbers, by name; None where a text is none
    guessed : names of those of them that are guesses
    springs : share of the weight that its motor need not hold
    """

    name: str
    kind: str
    parent: str
    child: str
    leader: str | None
    limits: Mapping[str, float | None]
    guessed: tuple[str, ...] = ()
    springs: float = 0.0

    @property
    def moves(self) -> bool:
        """Return whether it has a motor of its own."""
        return self.kind in MOVING and self.leader is None

    @property
    def states_acceleration(self) -> bool:
        """Return whether an acceleration is stated, with any prefix."""
        return any(key.rpartition(":")[2] == "acceleration" for key in self.limits)

    @property
    def bounds(self) -> tuple[float, float]:
        """Return its lower and upper limit [rad, m]; 0 where none is stated, infinite where it turns without end."""
        if self.kind == "continuous":
            return -inf, inf
        return self.limits.get("lower") or 0.0, self.limits.get("upper") or 0.0

    @property
    def nearest_to_0(self) -> float:
        """Return its position nearest to 0 within its limits [rad, m]."""
        lower, upper = self.bounds
        return min(max(0.0, lower), upper)

    @property
    def slides_far(self) -> bool:
        """Return whether it slides further than any arm, or without an end."""
        lower, upper = self.bounds
        return self.kind == "prismatic" and upper - lower > LONGEST_STROKE

    @property
    def grips(self) -> bool:
        """Return whether it may be a finger's: it follows, slides by little, or has such a name and turns by less
        than half a turn. A roll, pitch or yaw of a gripper is a wrist.
        """
        if self.leader is not None:
            return True
        lower, upper = self.bounds
        is_called_so = has_word(self.name, FINGERS)
        if self.kind == "prismatic":
            return is_called_so or upper - lower < LONG_STROKE
        return is_called_so and upper - lower < pi and not WRISTS & set(words_of(self.name))


@dataclass(frozen=True)
class Chain:
    """An arm as the tree suggests it.

    Attributes
    ----------
    trunk : joints from the base to the trunk, which move other arms too, or the base itself
    joints : joints from there to the last body
    moved : links that these joints move, one a joint
    links : links of the last body, from the last joint on
    fingers : joints beyond, those that go along with others included
    grippers : links that fingers move
    tip : the link that suits best for the arm's last frame
    """

    trunk: tuple[str, ...]
    joints: tuple[str, ...]
    moved: tuple[str, ...]
    links: tuple[str, ...]
    fingers: tuple[str, ...]
    grippers: tuple[str, ...]

    @property
    def tip(self) -> str:
        """Return the last body's link with a tool's name, else the last."""
        for pattern in TIPS if self.fingers else TIPS[:-1]:
            for link in self.links:
                if has_word(link, pattern):
                    return link
        return self.links[-1]

    @property
    def is_other(self) -> bool:
        """Return whether most joints or links have leg, wheel or neck names. One such name may be a tool's."""
        return any(
            2 * sum(has_word(name, OTHERS) for name in names) >= len(names)
            for names in (self.joints, self.moved)
        )


@dataclass(frozen=True)
class Tree:
    """The links and joints of a URDF.

    Attributes
    ----------
    name : name of the model
    root : link without a parent
    joints : all joints
    bodiless : links that have neither mass nor shape
    """

    name: str
    root: str
    joints: tuple[Joint, ...]
    bodiless: frozenset[str] = frozenset()

    @classmethod
    def of(cls, top: ET.Element) -> Tree:
        """Return the tree of a URDF's root element, which `comove.robots.soundness.require_tree` has accepted."""
        joints = tuple(
            Joint(
                joint.get("name", ""),
                joint.get("type", ""),
                *ends_of(joint),
                next((mimic.get("joint", "") for mimic in joint.findall("mimic")), None),
                stated_limits(joint),
                tuple(word for limit in joint.findall("limit") for word in limit.get(GUESSES, "").split()),
                number(joint.get(SPRINGS, "0")) or 0.0,
            )
            for joint in top.findall("joint")
        )
        children = {joint.child for joint in joints}
        roots = [link.get("name", "") for link in top.findall("link") if link.get("name") not in children]
        bodiless = frozenset(
            link.get("name", "")
            for link in top.findall("link")
            if not any(link.find(tag) is not None for tag in ("inertial", "collision", "visual"))
        )
        return cls(top.get("name", "robot"), roots[0], joints, bodiless)

    def groups(self, srdf: ET.Element) -> dict[str, frozenset[str]]:
        """Return the moving joints of an SRDF's groups, by name.

        A group may name joints, links, chains and other groups.
        """
        elements = {group.get("name", ""): group for group in srdf.findall("group")}
        above = {joint.child: joint for joint in self.joints}
        moving = {joint.name for joint in self.joints if joint.moves}

        def named(name: str, within: tuple[str, ...]) -> set[str]:
            found, group = set[str](), elements.get(name)
            if group is None or name in within:
                return found
            found |= {joint.get("name", "") for joint in group.findall("joint")}
            found |= {
                above[at].name for link in group.findall("link") if (at := link.get("name", "")) in above
            }
            for chain in group.findall("chain"):
                at = chain.get("tip_link", "")
                while at != chain.get("base_link") and at in above:
                    found.add(above[at].name)
                    at = above[at].parent
            for inner in group.findall("group"):
                found |= named(inner.get("name", ""), (*within, name))
            return found

        return {name: frozenset(named(name, ()) & moving) for name in elements}

    @cached_property
    def _below(self) -> dict[str, list[Joint]]:
        below: dict[str, list[Joint]] = {}
        for joint in self.joints:
            below.setdefault(joint.parent, []).append(joint)
        return below

    def body(self, link: str) -> tuple[str, ...]:
        """Return a link and all further links on fixed joints."""
        links = [link]
        for known in links:
            links += [joint.child for joint in self._below.get(known, []) if joint.kind not in MOVING]
        return tuple(links)

    def leaving(self, link: str) -> list[Joint]:
        """Return the joints, moving or following, that leave a link's body."""
        return [
            joint for known in self.body(link) for joint in self._below.get(known, []) if joint.kind in MOVING
        ]

    def depth(self, joint: Joint) -> int:
        """Return the largest number of motors in series from a joint on."""
        return int(joint.moves) + max((self.depth(j) for j in self.leaving(joint.child)), default=0)

    def is_palm(self, link: str) -> bool:
        """Return whether only fingers leave the body of a link."""
        leaving = self.leaving(link)
        short = all(self.depth(joint) <= SHAPE.finger for joint in leaving)
        of_gripper = [joint for joint in leaving if joint.grips]
        return bool(leaving) and short and (len(leaving) > 1 or len(of_gripper) == len(leaving))

    def chains(self) -> tuple[Chain, ...]:
        """Return the arms of the robot, and other chains of their length."""
        found = map(self._without_drive, self._from(self.root, (), ()))
        return tuple(chain for chain in found if len(chain.joints) >= SHAPE.least)

    def _without_drive(self, chain: Chain) -> Chain:
        """Return a chain whose mobile-base joints belong to its trunk.

        They reach as far as the last that slides further than any arm, and those after it that turn a link without a
        body.
        """
        known = {joint.name: joint for joint in self.joints}
        joints = [known[name] for name in chain.joints]
        far = [k for k, joint in enumerate(joints) if joint.slides_far]
        count = far[-1] + 1 if far else 0
        while 0 < count < len(joints) and joints[count].parent in self.bodiless:
            count += 1
        return replace(
            chain,
            trunk=chain.trunk + chain.joints[:count],
            joints=chain.joints[count:],
            moved=chain.moved[count:],
        )

    def _from(self, link: str, trunk: tuple[str, ...], joints: tuple[str, ...]) -> Iterator[Chain]:
        """Yield the chains from a link's body on, after `trunk` and `joints`."""
        leaving = self.leaving(link)
        deep = sum(self.depth(joint) > SHAPE.longest_finger for joint in leaving)
        is_chest = deep == 2  # models of hands have such fingers as well, but more
        has_fingers = self.is_palm(link) or len(leaving) >= SHAPE.many
        at_hand = len(joints) >= SHAPE.least and not is_chest and has_fingers
        if not leaving or at_hand:
            fingers = tuple(self._all_from(leaving))
            grippers = (link for finger in fingers for link in self.body(finger.child))
            child = {joint.name: joint.child for joint in self.joints}
            moved = tuple(child[joint] for joint in joints)
            names = tuple(finger.name for finger in fingers)
            yield Chain(trunk, joints, moved, self.body(link), names, tuple(grippers))
            return
        long = [joint for joint in leaving if self.depth(joint) >= SHAPE.least]
        if len(long) > 1:
            for joint in long:
                yield from self._from(joint.child, (*trunk, *joints), (joint.name,))
            return
        # What else leaves it, such as a head, is no part of the arm.
        deepest = max(leaving, key=self.depth)
        yield from self._from(deepest.child, trunk, (*joints, deepest.name) if deepest.moves else joints)

    def rest(self, chains: Iterable[Chain]) -> tuple[str, ...]:
        """Return motorised joints of no chain, trunk or fingers."""
        known = {name for chain in chains for name in (*chain.trunk, *chain.joints, *chain.fingers)}
        return tuple(joint.name for joint in self.joints if joint.moves and joint.name not in known)

    def _all_from(self, joints: list[Joint]) -> Iterator[Joint]:
        for joint in joints:
            yield joint
            yield from self._all_from(self.leaving(joint.child))
