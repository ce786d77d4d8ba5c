"""A course among moving obstacles while there is no plan: the most promising of many random ones.

A course is a twist for every moment up to a short horizon, approached from the present velocity as fast as the
acceleration limit allows (a dynamic window: Fox, Burgard and Thrun, 1997), among obstacles that move as expected.
Some courses have one twist throughout, others change to another one on the way, and the best of them is varied; the
course of a moment ago is among them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from comove.control.safety.twists import hand_velocities, twists_between
from comove.coordination.coordinates import HandPoses
from comove.geometry.distances import inflated
from comove.geometry.rotations import exponential, matrices, quaternion_product
from comove.planning.objective import Objective
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

TO_GOAL = 2  # number of the course that goes there, among those drawn
FIXED = {"none": [3, 4, 5], "fixed": [3, 4, 5], "plane": [3, 4], "vertical": [3, 4]}
"""Entries of the twist that are 0, by the orientation of a rigid group."""


@dataclass(frozen=True)
class DynamicWindow:
    """Settings of the search for a course.

    A clearance of more than `safe` is worth no more than `safe`; among safe courses the one is taken that comes
    nearest to the goal and also leaves some distance to moving obstacles, as these may turn.

    Attributes
    ----------
    moment, n_moments : time between two twists [s], and how many of them are looked ahead
    n_drawn, n_varied : courses drawn, and variations of the best
    spreads : shares of random twists by which the best course is varied in turn
    safe : clearance beyond which more is no better, and an objective looks no farther [m]
    unsafe : way to the goal that a metre of clearance below `safe` outweighs [m]
    room : clearance to moving obstacles beyond which more is no better [m]
    cramped : way to the goal that a metre short of `room` outweighs [m]
    turning : way to the goal that it must be worth to turn off [m]
    """

    moment: float = 0.1
    n_moments: int = 15
    n_drawn: int = 60
    n_varied: int = 30
    spreads: tuple[float, ...] = (0.4, 0.2, 0.1)
    safe: float = 0.01
    unsafe: float = 100.0
    room: float = 0.15
    cramped: float = 5.0
    turning: float = 0.2

    @property
    def instants(self) -> Array:
        """Return the ends of the moments up to the horizon, from now on [s]; array, shape (n_moments + 1,)."""
        return self.moment * np.arange(self.n_moments + 1, dtype=np.float64)

    def best_course(
        self,
        here: WindowStart,
        objective: Objective,
        goal: HandPoses,
        offsets: Array,
        rng: np.random.Generator,
        before: Array | None = None,
    ) -> Array | None:
        """Return the most promising course; array, shape (n_moments, n_groups, 6) [m/s, rad/s].

        None means that the course straight to the goal is the best.

        Parameters
        ----------
        here : present state of the load
        objective : objective of the scene as it is expected to be
        goal : poses at the goal
        offsets : array, shape (n_moments + 1, n_rows, 3), of the obstacles' rows at the ends of the moments [m]
        before : the course of a moment ago
        """
        scene, n_hands = here.scene, len(here.scene.manipulators)
        moving = scene.moving[scene.owners].astype(np.float64)
        wider = replace(scene, obstacles=inflated(scene.obstacles, self.room * moving))
        roomy = replace(objective, scene=wider)

        def worth(courses: Array) -> Array:
            nodes = here.nodes_along(courses, self.moment)
            spare = np.minimum(
                objective.evaluate_nodes(nodes, offsets).clearance - scene.clearance, self.safe
            )
            room = roomy.evaluate_nodes(nodes, offsets).clearance - scene.clearance
            away = np.linalg.norm(nodes[:, -1, :n_hands, : scene.n_dims] - scene.goal, axis=2).max(axis=1)
            turning = (courses != courses[:, :1]).any(axis=(1, 2, 3))
            return (
                self.unsafe * spare
                + self.cramped * np.clip(room, -self.room, 0.0)
                - away
                - self.turning * turning
            )

        courses = self._drawn(here, goal, rng)
        if before is not None:
            courses = np.concatenate([courses, np.concatenate([before[1:], before[-1:]])[None]])
        values = worth(courses)
        best = int(np.argmax(values))
        course, value = courses[best], values[best]
        if best == TO_GOAL:
            return None
        for spread in self.spreads:  # look closer
            varied = course + spread * self._turned_off(here.random_twists(self.n_varied, rng), rng)
            varied = here.limited(varied, scene.speed_limit)
            values = worth(varied)
            if values.max() > value:
                course, value = varied[np.argmax(values)], values.max()
        return course

    def _drawn(self, here: WindowStart, goal: HandPoses, rng: np.random.Generator) -> Array:
        """Return courses: to stand still, to go on, to go to the goal, and random ones.

        Array, shape (n_drawn, n_moments, n_groups, 6) [m/s, rad/s].
        """
        drawn = here.random_twists(self.n_drawn, rng)
        drawn[0], drawn[1] = 0.0, here.twists
        drawn[TO_GOAL] = twists_between(here.scene, here.poses, goal, self.moment * self.n_moments)
        drawn = here.limited(drawn, here.pace)
        courses = np.repeat(drawn[:, None], self.n_moments, axis=1)
        half = self.n_drawn // 2
        courses[half:] = self._turned_off(drawn[half:], rng)
        return courses

    def _turned_off(self, drawn: Array, rng: np.random.Generator) -> Array:
        """Return courses (n, n_moments, n_groups, 6) that change from each twist to another at a random moment."""
        moment = rng.integers(1, self.n_moments // 2 + 3, len(drawn))
        turned = np.arange(self.n_moments) >= moment[:, None]
        return np.where(turned[:, :, None, None], rng.permutation(drawn)[:, None], drawn[:, None])


@dataclass(frozen=True, eq=False)
class WindowStart:
    """The state of a load from which courses begin, and what it can do from there.

    Attributes
    ----------
    scene : the scene as it is expected to be
    poses, twists : present poses and twists of the rigid groups; `twists` has the shape (n_groups, 6)
    """

    scene: Scene
    poses: HandPoses
    twists: Array

    @property
    def pace(self) -> float:
        """Return the speed of random courses [m/s]: the limit, or 1 m/s if that is higher."""
        return min(self.scene.speed_limit, 1.0)

    @cached_property
    def _hands(self) -> Array:
        """Return the linear map from twists to velocities of the hands; array, shape (n_hands, 3, n_groups, 6)."""
        n = len(self.scene.groups)
        of_each = [hand_velocities(self.scene, self.poses, row.reshape(n, 6)) for row in np.eye(6 * n)]
        return np.moveaxis(np.array(of_each), 0, -1).reshape(-1, 3, n, 6)

    def speeds(self, twists: Array) -> Array:
        """Return the speed of the fastest hand [m/s]; `twists` of any shape (..., n_groups, 6)."""
        velocities = np.einsum("hdgk,...gk->...hd", self._hands, twists)
        return np.sqrt((velocities**2).sum(axis=-1)).max(axis=-1)

    def limited(self, twists: Array, limit: float) -> Array:
        """Return twists, slowed down where a hand would be faster than the limit [m/s]; (..., n_groups, 6)."""
        return twists * np.minimum(1.0, limit / np.maximum(self.speeds(twists), 1e-9))[..., None, None]

    def random_twists(self, n: int, rng: np.random.Generator) -> Array:
        """Return random twists that the load can perform, array, shape (n, n_groups, 6).

        The fastest hand moves at 0.3 to 1 times the `pace`.
        """
        drawn = rng.standard_normal((n, len(self.scene.groups), 6))
        for g, group in enumerate(self.scene.groups):
            drawn[:, g, 3:] /= max(group.reach, 1e-3)
            drawn[:, g, FIXED.get(group.orientation, [])] = 0.0
        drawn[:, :, self.scene.n_dims : 3] = 0.0
        wanted = self.pace * rng.uniform(0.3, 1.0, n)
        return drawn * (wanted / np.maximum(self.speeds(drawn), 1e-9))[:, None, None]

    def nodes_along(self, courses: Array, moment: float) -> Array:
        """Return the nodes along courses, at the ends of the moments; (n_courses, n_moments + 1, n_nodes, 3) [m].

        Parameters
        ----------
        courses : array, shape (n_courses, n_moments, n_groups, 6)
        moment : length of a moment [s]
        """
        n_courses, n_moments = courses.shape[:2]
        velocity = np.zeros((n_courses, n_moments + 1, *self.twists.shape))
        way = np.zeros_like(velocity)
        velocity[:, 0] = self.twists
        for k in range(n_moments):
            change = courses[:, k] - velocity[:, k]
            needed = np.maximum(self.speeds(change) / self.scene.acceleration_limit, 1e-9)  # to get there [s]
            share = np.minimum(1.0, moment / needed)[:, None, None]
            gained = moment - 0.5 * np.minimum(needed, moment)[:, None, None]
            velocity[:, k + 1] = velocity[:, k] + share * change
            way[:, k + 1] = way[:, k] + moment * velocity[:, k] + gained * share * change
        nodes = np.zeros((*way.shape[:2], self.scene.body.n_nodes, 3))
        turns = quaternion_product(exponential(way[..., 3:]), self.poses.quaternion)
        for g, own in enumerate(self.scene.nodes_of_groups):
            placed = np.einsum("ktij,nj->ktni", matrices(turns[:, :, g]), self.scene.groups[g].points)
            nodes[:, :, own] = self.poses.center[g] + way[:, :, g, None, :3] + placed
        return nodes
