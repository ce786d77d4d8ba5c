"""The online replanner: it checks the reference, and replaces it for a better trajectory.

The reference is first the verified plan. Every tenth of a second the replanner predicts whether moving obstacles,
with their present motion, would meet the arms or the payload along it. Where they would, and every second where the
reference is no longer the plan, the best trajectory of the roadmap is computed; it begins where the reference,
followed during the computation and then braked, comes to a stop, and is chosen if it is better by enough. For arms
that were displaced to where the roadmap does not lead, a new path is planned once they rest. All of that is counted
in nodes and slots, never in computing time, so that runs repeat.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from time import perf_counter

import numpy as np

from comove.arrays import Array
from comove.control.loop import ControlLoop, Replanner, Setpoint
from comove.control.safety.qp_workspace import Sighting
from comove.dmp.arguments import require_positive
from comove.geometry.rotations import matrices
from comove.model.blocks import write_pose
from comove.model.coordinates import Coordinates, poses_at
from comove.model.groups import GroupPose
from comove.model.scene import Scene
from comove.planning.configurations import configuration_space, span
from comove.planning.planner import continuous
from comove.planning.world import World
from comove.robots.online.courses import CourseSettings, Foresight, Places, RoadmapCourse
from comove.robots.online.link_rows import LinkNeeds, clearances_along
from comove.robots.online.reference import MotionReference, ReferenceSettings, Stop
from comove.robots.online.roadmap import SLOT, Ground, GrowingRoadmap, Roadmap, RoadmapSettings, Way
from comove.robots.search.chains import turned_towards
from comove.robots.search.following import Arms
from comove.robots.search.planner import plan_with_arms
from comove.trajectory import interpolated


@dataclass(frozen=True)
class PilotSettings:
    """Settings of the online replanner.

    Attributes
    ----------
    every : time between two predictions along the reference [s]
    at_once, anew : time between two choices of a trajectory, with predicted contact, and otherwise [s]; twice the
        first without an improvement
    thinking : time after which a new trajectory can begin [s]
    braking : share of the end effectors' acceleration that is used for a stop
    worth : slots by which another trajectory must be better
    off : distance of the end effectors from the reference above which a trajectory begins at their place [m]
    patience : time that arms may lag before any trajectory is chosen [s]
    most_grown : how often the roadmap may grow without a free trajectory
    aside, n_aside : slots before a contact, around which it grows as well, and by how many configurations
    clear : slots ahead without contact for the reference to count as clear
    n_nodes, most_goals : nodes of the trees, and joints at the goal that are tried, where no trajectory leads from
        the arms' place
    spare : clearance of the payload beyond the scene's, in the roadmap [m]
    roadmap, courses, reference : settings of the roadmap, of the choice of a trajectory, and of references
    """

    every: float = 0.1
    at_once: float = 0.3
    anew: float = 1.0
    thinking: float = 0.2
    braking: float = 0.8
    worth: float = 3.0
    off: float = 0.03
    patience: float = 1.5
    most_grown: int = 6
    aside: tuple[int, ...] = (0, 5, 10)
    n_aside: int = 50
    clear: int = 10
    n_nodes: int = 400
    most_goals: int = 6
    spare: float = 0.002
    roadmap: RoadmapSettings = field(default_factory=RoadmapSettings)
    courses: CourseSettings = field(default_factory=CourseSettings)
    reference: ReferenceSettings = field(default_factory=ReferenceSettings)

    def __post_init__(self) -> None:
        for name in ("every", "at_once", "anew", "thinking", "braking", "worth", "off", "patience"):
            require_positive(name, getattr(self, name))


def movers(scene: Scene, seen: Sighting) -> Sighting:
    """Return the rows of moving obstacles, and of those beyond the scene's."""
    n_more = len(seen.margin) - len(scene.owners)
    moves = np.append(scene.moving[scene.owners], np.ones(n_more, dtype=bool))
    return Sighting(*(array[moves] for array in seen))


class Pilot(Replanner):
    """An online replanner of arms, with a reference on a timed roadmap.

    Parameters
    ----------
    standing : the scene without moving obstacles
    arms : the arms in it
    coordinates : coordinates of the payload
    plan : the verified plan
    needs : clearances that links keep from static obstacles, and from each other
    goals : array, shape (n, n_joints), joints that hold the payload at the goal, beside those of the plan
    seed : seed of the roadmap, and of plans from where it does not lead

    Attributes
    ----------
    reference, clock : the reference, and the run's time on it [s]
    is_clear : whether the last prediction found the reference clear of obstacles
    waited : time that the arms have lagged [s]
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
        settings: PilotSettings,
    ):
        self.settings, self.reference = settings, plan
        self.clock, self.waited, self.is_clear = 0.0, 0.0, False
        self.standing, self.coordinates, self._plan, self._seed = standing, coordinates, plan, seed
        how, chains = settings.roadmap, arms.chains
        space = configuration_space(standing, coordinates)
        self.arms = arms
        self.ground = Ground(
            space._replace(required=standing.clearance + settings.spare),
            self.arms,
            needs,
            how.rates * chains.velocity * SLOT,
            how.speed * min(standing.speed_limit, how.fastest) * SLOT,
        )
        self.foresight = Foresight(space, self.arms, standing.clearance, settings.courses)
        last = plan.way.joints[-1:]
        self._goals = last if goals is None else np.vstack([last, goals])
        self._rng = np.random.default_rng([seed, 1])
        self._growth: GrowingRoadmap | None = None
        self._looked = self._chosen = self._present = -np.inf
        self._n_grown, self._pause = 0, settings.at_once
        self._placed: tuple[MotionReference, Places] | None = None

    def _slots(self, reference: MotionReference, begin: float, end: float) -> Way:
        """Return samples of a reference, one a slot."""
        count = 1 + max(0, int(np.ceil((end - begin) / SLOT - 1e-9)))
        configurations, joints, _ = reference.at(np.minimum(begin + SLOT * np.arange(count), end))
        return Way(np.ascontiguousarray(configurations), np.ascontiguousarray(joints))

    @property
    def growth(self) -> GrowingRoadmap:
        """Return the roadmap, created on first use."""
        if self._growth is None:
            rng, how = np.random.default_rng(self._seed), self.settings.roadmap
            plan = self._slots(self._plan, 0.0, self._plan.duration)
            self._growth = GrowingRoadmap(self.ground, plan, rng, how)
            self._growth.grow(how.n_nodes)
        return self._growth

    def prepare(self, seen: Sighting) -> None:
        """Create the roadmap before the run, denser without a free trajectory. All kernels are loaded."""
        begin, joints, _ = self.reference.at(0.0)
        self._ahead(self.reference, 0.0, seen)
        self._planned(begin, joints)  # for its kernels alone
        for _ in range(self.settings.most_grown):
            found = self._course(begin, joints, seen, Stop(self.settings.thinking, 0.0))
            if found is None or found.cost < self.settings.courses.costs.meeting:
                break

    def update(self, run: ControlLoop) -> None:
        """Predict along the reference periodically, and replace it for a better trajectory."""
        if not self._is_due(run.time):
            return
        seen = movers(run.scene, run.observer.observe(run.time))
        if not self.looks_on(run.time, seen, self.waited):
            return
        begun, off = perf_counter(), run.distance_from(self.current(run).here)
        found = self.choose(run.time, seen, self.present(run), off, self.waited)
        run.log.note_plan(perf_counter() - begun)
        if found:
            self.waited = 0.0
            run.tell(f"another course, of {self.reference.duration:.2f} s")

    def current(self, run: ControlLoop) -> Setpoint:
        """Return the reference's poses now and next, its joints and rates. Next is a period later."""
        configurations, joints, rates = self.reference.at(self.clock + np.array([0.0, run.period]))
        here, ahead = (poses_at(self.coordinates, q) for q in configurations)
        return Setpoint(here, ahead, False, joints[0], rates[0])

    def advance(self, run: ControlLoop, pace: float) -> None:
        """Advance by a control period, at a share of the reference's speed. Below a half the arms wait."""
        self.clock = min(self.clock + pace * run.period, self.reference.duration)
        waits = pace < 0.5 or self.clock >= self.reference.duration
        self.waited = self.waited + run.period if waits else 0.0

    def present(self, run: ControlLoop) -> Way:
        """Return the configuration and joints of the run, one sample."""
        (part,) = self.coordinates.parts  # one rigid payload, or `ArmRows` had refused it
        pose = GroupPose(run.poses.center[0], matrices(run.poses.quaternion[0]))
        pose = self.coordinates.groups[0].turn(pose)
        return Way(write_pose(part.kind, pose, run.scene.n_dims)[None], run.joints[None])

    def _is_due(self, time: float) -> bool:
        return time - self._looked >= self.settings.every - 1e-9

    def looks_on(self, time: float, seen: Sighting, waited: float) -> bool:
        """Predict along the reference periodically; return whether to choose another trajectory.

        Parameters
        ----------
        seen : moving obstacles
        waited : time that the arms have lagged [s]
        """
        how = self.settings
        if not self._is_due(time):
            return False
        self._looked = time
        cost = self._ahead(self.reference, self.clock, seen)
        self._present = self._total(self.reference, self.clock, cost)
        self.is_clear = self._is_clear(cost)
        since = time - self._chosen
        if waited >= how.patience:
            return since >= how.patience
        if cost.max() >= how.courses.costs.meeting:
            return since >= self._pause
        fine = self.reference is self._plan and not cost.any()
        ends = self.clock >= self.reference.duration and self.reference.left == 0.0
        return not (fine or ends) and since >= how.anew

    def choose(self, time: float, seen: Sighting, here: Way, off: float, waited: float) -> bool:
        """Choose a trajectory; return whether the reference has changed.

        Parameters
        ----------
        seen : moving obstacles
        here : configuration and joints of the run, one sample each
        off : distance of the end effectors from the reference [m]
        waited : time that the arms have lagged [s]
        """
        how = self.settings
        self._chosen, self._pause = time, 2.0 * how.at_once  # unless something better is found
        follows, clock, stop = self.reference, self.clock, self._stop()
        if off > how.off or waited >= how.patience:
            follows, clock = MotionReference.standing(here, how.reference), 0.0
            stop = Stop(how.thinking, 0.0)
        begin, joints, _ = follows.at(follows.braked(clock, stop, stop.after))
        found = self._course(begin, joints, seen, stop)
        way, left = (None, 0.0) if found is None else (found.way, found.left)
        if way is None and waited >= how.patience:
            way = self._planned(begin, joints)
        if way is None:
            return False
        path = continuous(self.ground.space, np.vstack([begin, way.configurations]))[1:]
        other = follows.spliced(clock, stop, way._replace(configurations=path), SLOT, left)
        ahead = self._ahead(other, 0.0, seen)
        cost = self._total(other, 0.0, ahead)
        if waited < how.patience and cost > self._present - how.worth:
            return False
        self.reference, self.clock, self._pause = other, 0.0, how.at_once
        self.is_clear = self._is_clear(ahead)
        return True

    def stand(self, here: Way) -> None:
        """Rest at a sample, and choose a trajectory at once."""
        self.reference, self.clock = MotionReference.standing(here, self.settings.reference), 0.0
        self.is_clear, self.waited = False, self.settings.patience
        self._looked = self._chosen = -np.inf

    def _course(
        self, configuration: Array, joints: Array, seen: Sighting, stop: Stop
    ) -> RoadmapCourse | None:
        """Return the best trajectory from a configuration.

        The roadmap grows without a free one, also around contacts of its best one.
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
        """Return a trajectory's configurations before contact; array, shape (n, n_columns).

        Parameters
        ----------
        way : samples of the trajectory, which has a contact
        since : time from now until it begins [s]
        """
        how, slots = self.settings, np.arange(len(way.joints))
        times = since + SLOT * slots.astype(np.float64)
        cost = self.foresight.cost_along(self.foresight.placed(way), slots, seen, times)
        meets = int(np.argmax(cost >= how.courses.costs.meeting))
        return way.configurations[np.unique(np.maximum(meets - np.array(how.aside), 0))]

    def _planned(self, configuration: Array, joints: Array) -> Way | None:
        """Return a path to any joints at the goal without the roadmap. None on failure."""
        how, ground = self.settings, self._lenient(configuration, joints)
        end = self._plan.at(self._plan.duration)[0]
        nodes = self.coordinates.nodes(np.stack([configuration, end], axis=1)[None])[0]
        around = self.arms.around._replace(
            ends=np.ascontiguousarray(nodes[:, : self.arms.around.ends.shape[1]])
        )
        goals = np.unique(
            np.vstack([turned_towards(self.arms.chains, joints, self._goals), self._goals]), axis=0
        )
        for k in np.argsort(np.abs(goals - joints).max(axis=1), kind="stable")[: how.most_goals]:
            found = plan_with_arms(
                World.of(ground.space),
                self.arms._replace(around=around),
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
        """Return samples of a path, one a slot, at the roadmap's speed."""
        space, ground = self.ground.space, self.ground
        spans = [span(space, p, q) for p, q in pairwise(path.configurations)]
        turned = (np.abs(np.diff(path.joints, axis=0)) / ground.most).max(axis=1)
        slots = np.append(0.0, np.cumsum(np.maximum(np.array(spans) / ground.step, turned)))
        at = np.linspace(0.0, slots[-1], 1 + int(np.ceil(slots[-1])))
        return Way(*(interpolated(at, slots, values) for values in path))

    def _ahead(self, reference: MotionReference, clock: float, seen: Sighting) -> Array:
        """Return a reference's costs from now on, then its end's, by slot."""
        how = self.settings.courses
        if self._placed is None or self._placed[0] is not reference:
            slots = np.arange(1 + np.ceil(reference.duration / SLOT))
            configurations, joints, _ = reference.at(SLOT * slots)
            self._placed = reference, self.foresight.placed(Way(configurations, joints))
        first = int(np.ceil(clock / SLOT))
        slots = first + np.arange(how.n_slots + 1)
        times = SLOT * slots.astype(np.float64) - clock
        return self.foresight.cost_along(self._placed[1], slots, seen, times)

    def _is_clear(self, ahead: Array) -> bool:
        """Return whether there is no contact soon. A close pass is allowed."""
        return bool((ahead[: self.settings.clear] < self.foresight.touching).all())

    def _total(self, reference: MotionReference, clock: float, cost: Array) -> float:
        """Return the cost of a reference from now on [slots]."""
        to_go = (reference.duration - clock) / SLOT
        how, stops = self.settings, reference.left > 0.0  # and another one has to be begun
        again = (how.thinking + how.reference.settling) / SLOT + how.worth if stops else 0.0
        return float(cost.sum()) + max(0.0, to_go) + reference.left + again

    def _stop(self) -> Stop:
        """Return the stop of the reference from its present speed."""
        how, moment = self.settings, 0.02  # s
        then = self.clock + how.thinking
        p, q = self.reference.at(np.array([then, then + moment]))[0]
        return Stop(
            how.thinking,
            span(self.ground.space, p, q) / moment / (how.braking * self.standing.acceleration_limit),
        )

    def _extended(self, configuration: Array, joints: Array) -> Roadmap | None:
        """Return the roadmap with a configuration as its last node; None without a connection."""
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
        """Return a ground with no more required clearance than at a configuration."""
        nodes, ground = self.coordinates.nodes(configuration[None, :, None])[0, 0], self.ground
        keep, other, still = clearances_along(
            self.arms, joints[None], nodes[None], self.arms.around.obstacles, self.arms.around.clearance
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
