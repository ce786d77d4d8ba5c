"""The search for courses: the best one of a roadmap that grows, and plans from where it does not lead."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from comove.arrays import Array
from comove.control.safety.qp_workspace import Sighting
from comove.model.coordinates import Coordinates
from comove.model.scene import Scene
from comove.planning.configurations import configuration_space, span
from comove.planning.world import World
from comove.robots.online.courses import CourseSettings, Foresight, RoadmapCourse
from comove.robots.online.link_rows import LinkNeeds, clearances_along
from comove.robots.online.reference import MotionReference, Stop
from comove.robots.online.roadmap import SLOT, Ground, GrowingRoadmap, Roadmap, RoadmapSettings, Way
from comove.robots.search.chains import turned_towards
from comove.robots.search.following import Arms
from comove.robots.search.planner import plan_with_arms
from comove.trajectory import interpolated


@dataclass(frozen=True)
class FinderSettings:
    """Settings of the search for courses.

    Attributes
    ----------
    most_grown : how often the roadmap may grow where nothing in it is free
    aside, n_aside : slots before a meeting, around which it grows as well, and by how many configurations
    n_nodes, most_goals : nodes of the trees, and joints at the goal that are tried, where no course leads from where
        arms have come
    spare : clearance of the load beyond the scene's, in the roadmap [m]
    roadmap, courses : settings of the roadmap, and of the choice of a course
    """

    most_grown: int = 6
    aside: tuple[int, ...] = (0, 5, 10)
    n_aside: int = 50
    n_nodes: int = 400
    most_goals: int = 6
    spare: float = 0.002
    roadmap: RoadmapSettings = field(default_factory=RoadmapSettings)
    courses: CourseSettings = field(default_factory=CourseSettings)


class CourseFinder:
    """A search for paths of arms with a payload.

    Parameters
    ----------
    standing : the scene without what moves
    arms : the arms in it
    coordinates : coordinates of the load
    plan : the verified plan
    needs : clearances that links keep from what stands, and from each other
    goals : array, shape (n, n_joints), joints that hold the load at the goal, beside those of the plan
    seed : seed of the roadmap, and of plans from where it does not lead

    Attributes
    ----------
    ground : criteria by which ways are judged
    foresight : costs of courses among what moves
    """

    def __init__(
        self,
        standing: Scene,
        arms: Arms,
        coordinates: Coordinates,
        plan: MotionReference,
        needs: LinkNeeds,
        *,
        goals: Array | None = None,
        seed: int,
        settings: FinderSettings,
    ):
        self.settings, self.standing, self.coordinates, self.plan = settings, standing, coordinates, plan
        how, chains = settings.roadmap, arms.chains
        space = configuration_space(standing, coordinates)
        self.ground = Ground(
            space._replace(required=standing.clearance + settings.spare),
            arms,
            needs,
            how.rates * chains.velocity * SLOT,
            how.speed * min(standing.speed_limit, how.fastest) * SLOT,
        )
        self.foresight = Foresight(space, arms, standing.clearance, settings.courses)
        last = plan.way.joints[-1:]
        self._goals = last if goals is None else np.vstack([last, goals])
        self._seed, self._rng = seed, np.random.default_rng([seed, 1])
        self._growth: GrowingRoadmap | None = None
        self._n_grown = 0

    def _slots(self, reference: MotionReference, begin: float, end: float) -> Way:
        """Return samples of a reference, one a slot."""
        count = 1 + max(0, int(np.ceil((end - begin) / SLOT - 1e-9)))
        configurations, joints, _ = reference.at(np.minimum(begin + SLOT * np.arange(count), end))
        return Way(np.ascontiguousarray(configurations), np.ascontiguousarray(joints))

    @property
    def growth(self) -> GrowingRoadmap:
        """Return the roadmap, which is made when it is needed first."""
        if self._growth is None:
            rng, how = np.random.default_rng(self._seed), self.settings.roadmap
            plan = self._slots(self.plan, 0.0, self.plan.duration)
            self._growth = GrowingRoadmap(self.ground, plan, rng, how)
            self._growth.grow(how.n_nodes)
        return self._growth

    def course(self, configuration: Array, joints: Array, seen: Sighting, stop: Stop) -> RoadmapCourse | None:
        """Return the best course from a configuration.

        The roadmap grows where it leads to nothing that is free, also around where its best course meets something.
        """
        how, found = self.settings, None
        for _ in range(2):
            extended = self._extended(configuration, joints)
            if extended is None:
                return found
            found = self.foresight.best(self.growth.roadmap, extended, seen, stop.after)
            if found.cost < how.courses.costs.meeting or self._n_grown >= how.most_grown:
                break
            self._n_grown += 1
            self.growth.grow(how.roadmap.n_more)
            for before in self._before_meeting(found.way, seen, stop.after):
                self.growth.grow(how.n_aside, before)
        return found

    def _before_meeting(self, way: Way, seen: Sighting, since: float) -> Array:
        """Return configurations of a course from where it could yet turn aside; array, shape (n, n_columns).

        Parameters
        ----------
        way : samples of the course, which meets something
        since : time from now until it begins [s]
        """
        how, slots = self.settings, np.arange(len(way.joints))
        times = since + SLOT * slots.astype(np.float64)
        cost = self.foresight.cost_along(self.foresight.placed(way), slots, seen, times)
        meets = int(np.argmax(cost >= how.courses.costs.meeting))
        return way.configurations[np.unique(np.maximum(meets - np.array(how.aside), 0))]

    def planned(self, configuration: Array, joints: Array) -> Way | None:
        """Return a path to the goal without the roadmap; None where none was found."""
        how, ground = self.settings, self._lenient(configuration, joints)
        end = self.plan.at(self.plan.duration)[0]
        nodes = self.coordinates.nodes(np.stack([configuration, end], axis=1)[None])[0]
        arms, around = self.ground.arms, self.ground.arms.around
        around = around._replace(ends=np.ascontiguousarray(nodes[:, : around.ends.shape[1]]))
        goals = np.unique(np.vstack([turned_towards(arms.chains, joints, self._goals), self._goals]), axis=0)
        for k in np.argsort(np.abs(goals - joints).max(axis=1), kind="stable")[: how.most_goals]:
            found = plan_with_arms(
                World.of(ground.space),
                arms._replace(around=around),
                (configuration, joints),
                (end, goals[k].copy()),
                how.spare,
                self._rng,
                required=ground.space.required,
                max_nodes=how.n_nodes,
                densely=True,
            )
            if found is not None:
                return self._paced(Way(*found[:2]))
        return None

    def _paced(self, path: Way) -> Way:
        """Return samples of a path at the speed of the roadmap's edges."""
        space, ground = self.ground.space, self.ground
        spans = [span(space, p, q) for p, q in pairwise(path.configurations)]
        turned = (np.abs(np.diff(path.joints, axis=0)) / ground.most).max(axis=1)
        slots = np.append(0.0, np.cumsum(np.maximum(np.array(spans) / ground.step, turned)))
        at = np.linspace(0.0, slots[-1], 1 + int(np.ceil(slots[-1])))
        return Way(*(interpolated(at, slots, values) for values in path))

    def _extended(self, configuration: Array, joints: Array) -> Roadmap | None:
        """Return the roadmap with a configuration as its last node; None where nothing leads there."""
        for attempt in range(3):
            ways = self.growth.ways_to(configuration, joints)
            if ways:
                return self.growth.roadmap.with_node(configuration, joints, ways)
            if attempt == 0:
                self.growth.grow(self.settings.roadmap.n_more, configuration)
            else:
                self.growth.ground = self._lenient(configuration, joints)
        self.growth.ground = self.ground
        return None

    def _lenient(self, configuration: Array, joints: Array, less: float = 1e-3) -> Ground:
        """Return a ground that requires the clearance of a configuration at most."""
        ground, arms = self.ground, self.ground.arms
        nodes = self.coordinates.nodes(configuration[None, :, None])[0, 0]
        keep, other, still = clearances_along(
            arms, joints[None], nodes[None], arms.around.obstacles, arms.around.clearance
        )
        needs = ground.needs._replace(
            obstacle=np.minimum(ground.needs.obstacle, keep - less),
            other=min(ground.needs.other, other - less),
            still=min(ground.needs.still, still - less),
        )
        left = self.standing.clearance_at(nodes)[0] - less
        return ground._replace(
            needs=needs, space=ground.space._replace(required=min(ground.space.required, left))
        )
