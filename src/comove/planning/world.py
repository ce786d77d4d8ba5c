"""The world in which trees of a payload grow, for `planning.trees`.

A node is a configuration of the payload; then, where arms hold it, their joints; and last, where obstacles move, its
normalised time. An edge is free if the payload keeps its margin from obstacles at that time, is no faster than
allowed, and if arms can follow it from the joints of the node where it begins. The displacement of the body relative
to any point of the obstacles is bounded by the sum of its span and theirs.

Trees in time grow forward from the start at 0 and backward from the goal at 1; both ends can reach each sample in
time (Grothe et al., 2022). The joints of both trees need not belong to one inverse-kinematics solution: a planner for
arms follows the whole path from the start.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from comove.arrays import Array
from comove.compiled import Question, copy_to, kernel
from comove.planning import trees
from comove.planning.configurations import (
    Space,
    edge_is_free_in_time,
    interpolate,
    may_be_within,
    nearest,
    random_configuration,
    span,
)
from comove.planning.timing import Timing, share_of_step, write_time

SHORTER = 1e-6  # m, that a straight edge saves of a way, to be worth taking


class World(NamedTuple):
    """The payload's space, with optional times of nodes and arms.

    Attributes
    ----------
    space : space of the payload
    timing : times of nodes
    arms : object with `follow` and `reaches`, and the fields `n_columns` (of a configuration), `course` (joints at
        both ends, array of shape (2, n_joints)) and `settings`, as `robots.search.planner.CarryingArms`; None for
        free end effectors
    clock : clock of the space, on which the trees' work counts as well
    """

    space: Space
    timing: Timing
    arms: Any
    clock: Array

    @classmethod
    def of(cls, space: Space, timing: Timing | None = None, arms: Any = None) -> World:
        """Return the world of a space."""
        return cls(space, timing or space.untimed, arms, space.clock)

    def paced(self, speed: float, share: float = 1.0) -> World:
        """Return the world with another speed limit and joint share. The speed is the payload's [m a duration]."""
        assert self.timing.timed, "nodes have times"
        return self._replace(timing=self.timing._replace(speed=speed, share=share))


@Question
def follow(arms, world, p, out):
    """Write an edge's final joints, followed from p; return whether arms can."""
    return arms.follow(world, p, out)


@Question
def reaches(arms, world, node):
    """Return whether arms may reach a node; mark its joints as unknown."""
    return arms.reaches(world, node)


@trees.between.answered_for(World)
@kernel
def between(world, p, q, share, out):
    """Write configuration and time at a share of an edge."""
    interpolate(world.space, p, q, share, out)
    write_time(world.timing, p, q, share, out)


@trees.extend.answered_for(World)
@kernel
def _extend(world, p, q, steps, margin, out):
    space, scratch = world.space, np.empty(p.shape[0])
    share = min(1.0, space.settings.step * steps / max(span(space, p, q), 1e-12))
    share = min(share, share_of_step(world.timing, p, q, steps))
    between(world, p, q, share, out)
    nodes = np.empty((space.blocks.node.shape[0], 3))
    if not edge_is_free_in_time(space, world.timing, p, out, margin, scratch, nodes):
        return trees.BLOCKED
    if not _followed(world.arms, world, p, out):
        return trees.BLOCKED
    if share < 1.0:
        return trees.FREE
    return trees.ARRIVED if _same_joints(world.arms, out, q) else trees.BLOCKED


@kernel
def _followed(arms, world, p, out):
    if arms is None:
        return True
    return follow(arms, world, p, out)


@kernel
def _same_joints(arms, p, q):
    """Return whether joints are those of q. A random q has none."""
    if arms is None:
        return True
    for c in range(arms.n_columns, arms.n_columns + arms.course.shape[1]):
        if abs(p[c] - q[c]) > arms.settings.jump:
            return False
    return True


@trees.nearest.answered_for(World)
@kernel
def _nearest(world, tree, count, q):
    return _nearest_in_time(world.timing, world.space, tree, count, q)


@kernel
def _nearest_in_time(timing, space, tree, count, q):
    """Return the nearest node that reaches q in time; -1 if there is none."""
    if not timing.timed:
        return nearest(space, tree, count, q)
    best, least, later = -1, np.inf, tree[0, -1] == 0.0
    for i in range(count):
        wait = q[-1] - tree[i, -1] if later else tree[i, -1] - q[-1]
        if wait > 0.0 and may_be_within(space, tree[i], q, timing.speed * wait):
            way = span(space, tree[i], q)
            effort = way / space.settings.step + wait / timing.time_step
            if way <= timing.speed * wait and effort < least:
                best, least = i, effort
    return best


@trees.draw.answered_for(World)
@kernel
def _draw(world, nodes, counts, this, rng, out):
    if not _drawn_in_time(world.timing, world.space, nodes, counts, this, rng, out):
        return False
    return _reached(world.arms, world, out)


@kernel
def _drawn_in_time(timing, space, nodes, counts, this, rng, out):
    """Write a random node that both ends reach in time; return success."""
    if not timing.timed:
        random_configuration(space, rng, out)
        return True
    if rng.random() < timing.waiting:
        copy_to(nodes[this, int(rng.random() * counts[this])], out)
    else:
        random_configuration(space, rng, out)
    soonest = span(space, nodes[0, 0], out) / timing.speed
    latest = 1.0 - span(space, nodes[1, 0], out) / timing.speed
    if soonest >= latest:
        return False
    out[-1] = soonest + rng.random() * (latest - soonest)
    return True


@kernel
def _reached(arms, world, node):
    if arms is None:
        return True
    return reaches(arms, world, node)


@trees.exists.answered_for(World)
@kernel
def _exists(world, p, node):
    return _followed(world.arms, world, p, node)


@trees.length.answered_for(World)
@kernel
def _length(world, p, q):
    return _length_in_time(world.timing, world.space, p, q)


@kernel
def _length_in_time(timing, space, p, q):
    if not timing.timed:
        return span(space, p, q)
    return abs(q[-1] - p[-1])


@trees.shortens.answered_for(World)
@kernel
def _shortens(world, p, q, way, margin):
    if not _shortens_in_time(world.timing, world.space, p, q, way - _worth(world.arms)):
        return False
    return _payload_is_free(world.arms, world, p, q, margin)


@kernel
def _payload_is_free(arms, world, p, q, margin):
    """Return whether the payload is free on an edge. Arms take longer to be led along it."""
    if arms is None:  # all that an extension checks
        return True
    nodes = np.empty((world.space.blocks.node.shape[0], 3))
    return edge_is_free_in_time(world.space, world.timing, p, q, margin, np.empty(p.shape[0]), nodes)


@kernel
def _shortens_in_time(timing, space, p, q, way):
    if not timing.timed:
        return span(space, p, q) <= way
    return span(space, p, q) <= timing.speed * abs(q[-1] - p[-1])


@kernel
def _worth(arms):
    """Return the least saving of a straight edge worth following [m]."""
    if arms is None:
        return SHORTER
    return arms.settings.shorter
