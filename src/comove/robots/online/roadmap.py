"""The roadmap of an online run: payload configurations with joints, and paths.

It begins with the plan, an instant of it for every slot of time, and grows by random configurations beside it, as a
rapidly exploring random graph does (Karaman and Frazzoli, 2011). It keeps clear of all static obstacles, and arms can
follow it at a moderate speed; moving obstacles are considered in the choice of a trajectory
(`comove.robots.online.courses`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.model.blocks import place_one
from comove.planning.configurations import Space, edge_is_free, interpolate, random_configuration, span
from comove.robots.online.link_rows import LinkNeeds, keeps_clear
from comove.robots.search.chains import reach_pose
from comove.robots.search.following import Arms, hand_rotation
from comove.robots.search.links import place_links
from comove.robots.search.planner import LEADING

SLOT = 0.1  # s, between two samples of a way
FREE, BLOCKED, FAST = range(3)


@dataclass(frozen=True)
class RoadmapSettings:
    """Settings of a roadmap.

    Attributes
    ----------
    n_nodes, n_more : configurations beside the plan, and of every further growth
    n_draws : random configurations for every added one
    reach : longest path of a new configuration to the nearest one, and of it to others [m]
    apart : least path between two configurations to which one is joined [m]
    n_joined : configurations to which a new one is joined at most
    nearby : share of random configurations that are drawn near to an existing one
    speed, rates : shares of the limits of end effectors and joints on paths
    fastest : speed of end effectors where the scene has no limit [m/s]
    agree, turning : largest difference of redundant joints where two paths meet, which one of them compensates [rad],
        and the share of `rates` for that
    """

    n_nodes: int = 1800
    n_more: int = 100
    n_draws: int = 8
    reach: float = 0.3
    apart: float = 0.1
    n_joined: int = 4
    nearby: float = 0.7
    speed: float = 0.7
    rates: float = 0.6
    fastest: float = 0.5
    agree: float = 0.6
    turning: float = 0.4


class Way(NamedTuple):
    """Samples of a path, one a slot, both ends included.

    Attributes
    ----------
    configurations, joints : arrays, shape (n_samples, n_columns) and (n_samples, n_joints)
    """

    configurations: Array
    joints: Array


class Ground(NamedTuple):
    """The criteria for paths of payload and arms.

    Attributes
    ----------
    space : the payload's space among static obstacles, whose `required` is the margin
    arms : the arms among static obstacles
    needs : required clearances of links
    most : array, shape (n_joints,), largest joint motion in a slot [rad]
    step : largest payload motion in a slot [m]
    """

    space: Space
    arms: Arms
    needs: LinkNeeds
    most: Array
    step: float


@kernel(nogil=True)
def lead(ground: Ground, p: Array, target: Array, way: Way) -> int:
    """Write the straight path from p to a target; return `FREE`, `BLOCKED` or too `FAST`."""
    space, arms, needs, most, _ = ground
    (configurations, joints), n = way, way.joints.shape[0] - 1
    nodes, rotation = np.empty((space.blocks.node.shape[0], 3)), np.empty((3, 3))
    start, end = arms.links.start.copy(), arms.links.end.copy()
    configurations[0] = p
    if not edge_is_free(space, p, target, space.required, np.empty_like(p), nodes):
        return BLOCKED
    for k in range(1, n + 1):
        interpolate(space, p, target, k / n, configurations[k])
        place_one(space.blocks, configurations[k], 1.0, nodes)
        joints[k] = joints[k - 1]
        for i in range(arms.chains.first.shape[0] - 1):
            hand_rotation(arms.around, nodes, i, rotation)
            left = reach_pose(arms.chains, i, rotation, nodes[i], arms.around.posture, LEADING, joints[k])
            if left > LEADING.tolerance:
                return BLOCKED
        for j in range(most.shape[0]):
            if abs(joints[k, j] - joints[k - 1, j]) > most[j]:
                return FAST
        place_links(arms.chains, arms.links, joints[k], start, end)
        if not keeps_clear(arms, start, end, nodes, needs):
            return BLOCKED
    return FREE


@kernel(nogil=True)
def nearest(space: Space, configurations: Array, q: Array) -> int:
    """Return the number of the configuration nearest to q."""
    best, least = 0, np.inf
    for i in range(configurations.shape[0]):
        away = span(space, configurations[i], q)
        if away < least:
            best, least = i, away
    return best


@kernel(nogil=True)
def nearby(space: Space, configurations: Array, q: Array, within: tuple[float, float], most: int) -> Integers:
    """Return numbers of separate configurations near q, nearest first; array, shape (n,).

    Parameters
    ----------
    within : longest path to q, and least path between two returned ones [m]
    most : largest number returned
    """
    far, apart = within
    near, away = np.empty(configurations.shape[0], dtype=np.int64), np.empty(configurations.shape[0])
    n, n_chosen, chosen = 0, 0, np.empty(most, dtype=np.int64)
    for i in range(configurations.shape[0]):
        away[n], near[n] = span(space, configurations[i], q), i
        n += 1e-9 < away[n] <= far
    while n_chosen < most:
        best, least = -1, np.inf
        for m in range(n):
            if away[m] < least:
                best, least = m, away[m]
        if best < 0:
            break
        away[best], candidate, alone = np.inf, configurations[near[best]], True
        for other in chosen[:n_chosen]:
            alone = alone and span(space, candidate, configurations[other]) > apart
        if alone:
            chosen[n_chosen] = near[best]
            n_chosen += 1
    return chosen[:n_chosen].copy()


class Roadmap(NamedTuple):
    """Configurations with joints, and paths between them.

    Attributes
    ----------
    configurations, joints : arrays, shape (n_samples, n_columns) and (n_samples, n_joints), of nodes and inside paths
    nodes : array of int, shape (n_nodes,), samples of the nodes
    goal : number of the node at the goal
    source, target, slots : arrays of int, shape (n_ways,): ends of the paths, and their durations in slots
    begin, stride : arrays of int, shape (n_ways,), the first sample inside a path, and its stride, 1 or -1
    """

    configurations: Array
    joints: Array
    nodes: Integers
    goal: int
    source: Integers
    target: Integers
    slots: Integers
    begin: Integers
    stride: Integers

    def with_node(self, configuration: Array, joints: Array, ways: list[tuple[int, Way]]) -> Roadmap:
        """Return the roadmap with another node and paths to it. They are used in both directions."""
        new = len(self.nodes)
        at = np.append(self.nodes, len(self.joints))
        added = _roadmap(
            Way(configuration[None], joints[None]), [(other, new, way) for other, way in ways], self.goal
        )
        return Roadmap(
            np.concatenate([self.configurations, added.configurations]),
            np.concatenate([self.joints, added.joints]),
            at,
            self.goal,
            np.concatenate([self.source, added.source]),
            np.concatenate([self.target, added.target]),
            np.concatenate([self.slots, added.slots]),
            np.concatenate([self.begin, added.begin + len(self.joints)]),
            np.concatenate([self.stride, added.stride]),
        )


def _roadmap(nodes: Way, ways: list[tuple[int, int, Way]], goal: int) -> Roadmap:
    """Return the roadmap of nodes and paths, given by source and target."""
    counts = np.array([len(way.joints) - 2 for *_, way in ways], dtype=np.int64)
    begins, ones = len(nodes.joints) + np.cumsum(counts) - counts, np.ones_like(counts)
    source, target = (np.array([way[k] for way in ways], dtype=np.int64) for k in range(2))
    return Roadmap(
        np.concatenate([nodes.configurations, *(way.configurations[1:-1] for *_, way in ways)]),
        np.concatenate([nodes.joints, *(way.joints[1:-1] for *_, way in ways)]),
        np.arange(len(nodes.joints)),
        goal,
        np.concatenate([source, target]),
        np.concatenate([target, source]),
        np.concatenate([counts, counts]) + 1,
        np.concatenate([begins, begins + counts - 1]),
        np.concatenate([ones, -ones]),
    )


class GrowingRoadmap:
    """A roadmap that grows, and the ground that it grows on.

    Parameters
    ----------
    ground : criteria for paths
    plan : the plan's samples, one a slot
    rng : source of random configurations
    """

    def __init__(self, ground: Ground, plan: Way, rng: np.random.Generator, settings: RoadmapSettings):
        self.ground, self.settings, self.rng = ground, settings, rng
        self._nodes, self._goal = plan, len(plan.joints) - 1
        self._known: Roadmap | None = None
        pieces = [Way(*(values[k : k + 2] for values in plan)) for k in range(self._goal)]
        self._ways = [(k, k + 1, piece) for k, piece in enumerate(pieces)]

    @property
    def roadmap(self) -> Roadmap:
        """Return the present roadmap."""
        if self._known is None:
            self._known = _roadmap(self._nodes, self._ways, self._goal)
        return self._known

    def grow(self, n_nodes: int, around: Array | None = None) -> None:
        """Add up to so many configurations, near a given one, if any."""
        how, added = self.settings, 0
        for _ in range(n_nodes * how.n_draws):
            if added == n_nodes:
                break
            drawn = self._drawn(around)
            near = nearest(self.ground.space, self._nodes.configurations, drawn)
            drawn = self._towards(self._nodes.configurations[near], drawn)
            ways = self.ways_to(drawn)
            if ways:
                new = len(self._nodes.joints)
                self._ways += [(node, new, way) for node, way in ways]
                ends = (values[-1:] for values in ways[0][1])
                self._nodes = Way(*map(np.concatenate, zip(self._nodes, ends, strict=True)))
                added += 1
        self._known = None

    def ways_to(self, configuration: Array, joints: Array | None = None) -> list[tuple[int, Way]]:
        """Return paths to a configuration from nodes nearby, with consistent final joints.

        Parameters
        ----------
        joints : array, shape (n_joints,), the joints at the configuration; those of the nearest node's path unless
            given
        """
        how, found = self.settings, list[tuple[int, Way]]()
        within, there = (1.5 * how.reach, how.apart), self._nodes.configurations
        for node in nearby(self.ground.space, there, configuration, within, how.n_joined).tolist():
            way = self._way(node, configuration)
            if way is None:
                continue
            joints = way.joints[-1] if joints is None else joints
            off = joints - way.joints[-1]
            slowly = np.abs(off) <= how.turning * self.ground.most * (len(way.joints) - 1)
            if slowly.all() and np.abs(off).max() <= how.agree:
                share = np.linspace(0.0, 1.0, len(way.joints))[:, None]
                found.append((node, Way(way.configurations, way.joints + share * off)))
        return found

    def _drawn(self, around: Array | None) -> Array:
        """Return a random configuration, or a point towards it from a node."""
        space, how, there = self.ground.space, self.settings, self._nodes.configurations
        drawn = np.empty(there.shape[1])
        random_configuration(space, self.rng, drawn)
        if around is None and self.rng.random() >= how.nearby:
            return drawn
        here = around
        if here is None:
            here = there[self.rng.integers(len(there))]
        return self._towards(here, drawn, self.rng.random())

    def _towards(self, here: Array, there: Array, share: float = 1.0) -> Array:
        """Return the configuration at a share of a reach towards `there`."""
        out, way = np.empty_like(here), span(self.ground.space, here, there)
        interpolate(
            self.ground.space, here, there, min(1.0, share * self.settings.reach / max(way, 1e-12)), out
        )
        return out

    def _way(self, node: int, configuration: Array) -> Way | None:
        """Return the path from a node to a configuration; None if blocked."""
        begin = self._nodes.configurations[node]
        n = max(1, int(np.ceil(span(self.ground.space, begin, configuration) / self.ground.step)))
        for slower in (1, 2):
            way = Way(
                np.empty((slower * n + 1, len(configuration))),
                np.empty((slower * n + 1, self._nodes.joints.shape[1])),
            )
            way.joints[0] = self._nodes.joints[node]
            what = lead(self.ground, begin, configuration, way)
            if what != FAST:
                break
        return way if what == FREE else None
