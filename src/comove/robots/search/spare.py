"""Margins of the arms along a motion, and their gradients."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import sqrt
from typing import NamedTuple

import numpy as np

from comove.arrays import Array
from comove.compiled import copy_to, kernel
from comove.contacts.displaced import Instant, instant_at
from comove.model.blocks import Blocks, place_one
from comove.robots.search.chains import Chains, jacobian, place_arm, reach_pose, solve_damped
from comove.robots.search.following import MET, SEARCHING, Arms, follow_one, hand_rotation
from comove.robots.search.links import (
    ENOUGH,
    ROUGH,
    clearance_around,
    clearance_between,
    place_links,
)

EXACT = SEARCHING._replace(tolerance=1e-8)
"""Iteration for differences, where the end of an arm's reach is seen by how its joints turn."""
N_KEPT_MOTIONS = 8  # whose joints are kept


class FollowerSettings(NamedTuple):
    """Settings of arms that follow an optimised motion.

    Attributes
    ----------
    within : by which poses must be within reach [m]
    more : clearance added at first and after every rejection, as samples neither cover the time between them nor
        determine redundant joints [m]
    soon : distance beyond the required one below which slopes are computed [m]
    move : step of finite differences [m, or of a direction or quaternion]
    lever : makes distances to the end of reach about right for most arms, see `_within_reach` [m]
    """

    within: float = 2e-3
    more: float = 1e-3
    soon: float = 0.012
    move: float = 1e-3
    lever: float = 0.2


SETTINGS = FollowerSettings()


@dataclass(frozen=True, eq=False)
class ArmsFollower:
    """Arms that follow a payload, as `comove.planning.convex.programme.Follower`.

    The distances are of as many kinds as there are arms, and two more: the distance of each end effector's pose
    within the arm's reach, negative out of it, the clearance of the links from obstacles and payload, and the one
    from each other.

    Attributes
    ----------
    course : array, shape (2, n_joints), joints at start and goal
    at_ends : array, shape (n_kinds,), least distances at start and goal [m]
    settings : settings of the following arms
    strict : how often more clearance than the required one is added
    known : the latest results by keypoints, oldest first, for all copies of the same arms, course and settings
    """

    arms: Arms
    course: Array
    at_ends: Array
    settings: FollowerSettings = SETTINGS
    strict: int = 1
    known: dict[bytes, tuple[Array, Array]] = field(default_factory=dict)

    @classmethod
    def near(
        cls, arms: Arms, course: Array, nodes: Array, settings: FollowerSettings = SETTINGS
    ) -> ArmsFollower:
        """Return the follower of motions near a given one. Distances that are smaller at its ends may be so anywhere.

        Parameters
        ----------
        nodes : array, shape (n_steps, n_nodes, 3), keypoints [m]
        """
        _, spare = spare_along(arms, np.ascontiguousarray(nodes), course, settings.lever)
        return cls(arms, course, spare[[0, -1]].min(axis=0) - ROUGH, settings)

    def stricter(self) -> ArmsFollower:
        """Return a follower that requires more clearance."""
        return replace(self, strict=self.strict + 1)

    def required(self, margin: float) -> Array:
        """Return the required distances; array, shape (n_kinds,) [m]."""
        reach = np.full(len(self.arms.chains.first) - 1, self.settings.within)
        clearance = np.full(2, self.arms.around.clearance + self.strict * self.settings.more + margin)
        return np.minimum(self.at_ends, np.concatenate([reach, clearance]))

    def follow(self, nodes: Array) -> tuple[Array, Array]:
        """Compute joints along a motion, (n_samples, n_joints), and distances, (n_samples, n_kinds) [m].

        Half of all motions are asked for again: where a step ends, the next one begins.
        """
        key = nodes.tobytes()
        if key not in self.known:
            if len(self.known) == N_KEPT_MOTIONS:
                self.known.pop(next(iter(self.known)), None)
            self.known[key] = spare_along(
                self.arms, np.ascontiguousarray(nodes), self.course, self.settings.lever
            )
            for array in self.known[key]:
                array.setflags(write=False)
        return self.known[key]

    def slopes(self, blocks: Blocks, q: Array, joints: Array, spare: Array) -> Array:
        """Compute the derivatives of distances by the configurations `q`; array, shape (n_samples, n_kinds,
        n_columns), 0 where there is so much to spare that it does not count.
        """
        near = self.required(0.0) + self.settings.soon
        return slopes_along(self.arms, blocks, np.array(q), joints, spare, near, self.settings)


@kernel(nogil=True)
def spare_along(arms: Arms, nodes: Array, course: Array, lever: float) -> tuple[Array, Array]:
    """Follow one motion; return joints, shape (n_steps, n_joints), and distances, (n_steps, n_kinds) [m]."""
    links, n_steps, n_arms = arms.links, nodes.shape[0], arms.chains.first.shape[0] - 1
    q, left = np.empty((n_steps, course.shape[1])), np.empty((n_steps, n_arms))
    follow_one(arms, nodes, course, q, left)
    spare, start, end = np.empty((n_steps, n_arms + 2)), links.start.copy(), links.end.copy()
    for t in range(n_steps):
        for i in range(n_arms):
            spare[t, i] = _reach(arms.chains, i, q[t], left[t, i], lever)
        instant = instant_at(arms.around.moved, t / (n_steps - 1))
        _clearances(arms, instant, nodes[t], q[t], start, end, spare[t])
    return q, spare


@kernel
def _reach(chains: Chains, arm: int, q: Array, left: float, lever: float) -> float:
    """Return an end effector's distance within reach [m]. Its pose is missed by `left`."""
    return min(ENOUGH, _within_reach(chains, arm, q, lever)) if left <= MET else -left


@kernel
def _within_reach(chains: Chains, arm: int, q: Array, lever: float) -> float:
    """Return an end effector's approximate distance from a stretched arm [m].

    It is `ENOUGH` for fewer than six joints. An arm of two parts of length a, whose elbow is bent by a small angle e,
    reaches a e^2 / 4 further, and a radian of its joints moves the end effector by s = a e / 2 in that direction: the
    distance is s^2 / a. Here s^2 is the least eigenvalue of J J^T, by inverse iteration. Its direction is one of
    poses, and turns as well as it moves, which makes s smaller: `lever` is less than a.
    """
    n_inversions = 4
    n = chains.first[arm + 1] - chains.first[arm]
    if n < 6:
        return ENOUGH
    rotations, points, jac = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((6, n))
    x, y, free, size = np.ones(6), np.empty(6), np.ones(n, dtype=np.bool_), 1.0
    place_arm(chains, arm, q, rotations, points)
    jacobian(chains, arm, rotations, points, jac)
    for _ in range(n_inversions):
        solve_damped(jac, free, 1e-9, x, y)
        size = 0.0
        for i in range(6):
            size += y[i] * y[i]
        size = sqrt(size)
        for i in range(6):
            x[i] = y[i] / size
    return 1.0 / (size * lever)


@kernel
def _clearances(
    arms: Arms, instant: Instant, nodes: Array, q: Array, start: Array, end: Array, out: Array
) -> None:
    """Write the links' clearances at joints q, the last two distances."""
    place_links(arms.chains, arms.links, q, start, end)
    out[-2] = clearance_around(arms.links, arms.around, instant, start, end, nodes, ENOUGH)
    out[-1] = clearance_between(arms.links, start, end, ENOUGH) + arms.around.eased


@kernel(nogil=True)
def slopes_along(
    arms: Arms,
    blocks: Blocks,
    at: Array,
    joints: Array,
    spare: Array,
    near: Array,
    how: FollowerSettings,
) -> Array:
    """Compute derivatives of distances below `near`, shape (n_kinds,), by differences.

    Arms follow each move of a configuration with the least motion of their joints. Samples are evenly spaced in time.

    Parameters
    ----------
    at : array, shape (n_steps, n_columns), configurations of the payload

    Returns
    -------
    array, shape (n_steps, n_kinds, n_columns)
    """
    chains, links, (n_steps, n_kinds), n_columns = arms.chains, arms.links, spare.shape, at.shape[1]
    slopes, nodes = np.zeros((n_steps, n_kinds, n_columns)), np.empty((blocks.node.shape[0], 3))
    start, end = links.start.copy(), links.end.copy()
    moved, q = np.empty(n_columns), np.empty(joints.shape[1])
    rotation, value = np.empty((3, 3)), np.empty((2, n_kinds))
    n_arms = n_kinds - 2
    for t in range(n_steps):
        counts = spare[t] < near
        links_count = counts[n_arms] or counts[n_arms + 1]
        instant = instant_at(arms.around.moved, t / (n_steps - 1))
        for c in range(-1, n_columns if counts.any() else -1):
            copy_to(at[t], moved)
            copy_to(joints[t], q)
            if c >= 0:
                moved[c] += how.move
            place_one(blocks, moved, 1.0, nodes)
            for i in range(n_arms):
                if counts[i] or links_count:
                    hand_rotation(arms.around, nodes, i, rotation)
                    left = reach_pose(chains, i, rotation, nodes[i], joints[t], EXACT, q)
                    if counts[i]:
                        value[int(c >= 0), i] = _reach(chains, i, q, left, how.lever)
            if links_count:
                _clearances(arms, instant, nodes, q, start, end, value[int(c >= 0)])
            for k in range(n_kinds):
                if c >= 0 and counts[k] and value[0, k] < near[k]:
                    slopes[t, k, c] = (value[1, k] - value[0, k]) / how.move
    return slopes
