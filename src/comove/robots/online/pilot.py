"""The online replanner: it checks the reference, and replaces it for a better trajectory.

The reference is first the verified plan. Every tenth of a second the replanner predicts whether moving obstacles,
with their present motion, would meet the arms or the payload along it. Where they would, and every second where the
reference is no longer the plan, the best trajectory of the roadmap is computed; it begins where the reference,
followed during the computation and then braked, comes to a stop, and is chosen if it is better by enough. For arms
that were displaced to where the roadmap does not lead, a new path is planned once they rest. All of that is counted
in nodes and slots, never in computing time, so that runs repeat: simulated time pauses meanwhile. Where time does not
wait, it is computed beside the control steps (`Pilot.aside`), and taken while the reference has not yet braked.
"""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass, field
from time import perf_counter
from typing import NamedTuple, Protocol

import numpy as np

from comove.arrays import Array
from comove.control.loop import ControlLoop, Replanner, Setpoint
from comove.control.safety.qp_workspace import Sighting
from comove.dmp.arguments import require_positive
from comove.geometry.rotations import matrices
from comove.model.blocks import write_pose
from comove.model.coordinates import poses_at
from comove.model.groups import GroupPose
from comove.model.scene import Scene
from comove.planning.configurations import span
from comove.planning.planner import continuous
from comove.robots.online.course_finder import CourseFinder, FinderSettings
from comove.robots.online.courses import Places
from comove.robots.online.reference import MotionReference, ReferenceSettings, Stop
from comove.robots.online.roadmap import SLOT, Way

LONGER, LONGEST = 1.5, 1.0  # times the last computation, and s, that the next one beside the steps may take


@dataclass(frozen=True)
class PilotSettings:
    """Settings of a pilot.

    Attributes
    ----------
    every : time between two looks along the reference [s]
    at_once, anew : time between two choices of a course, where something would be met, and otherwise [s]; twice the
        first where nothing better was found
    thinking : time after which a new course can begin [s]
    braking : share of the hands' acceleration that is used for a stop
    worth : slots by which another course must be better
    off : distance of the hands from the reference from which on a course begins where they are [m]
    patience : time that arms may stay behind before any course is taken [s]
    clear : slots ahead in which nothing may be touched for the reference to count as clear
    finder, reference : settings of the search for courses, and of what is followed
    """

    every: float = 0.1
    at_once: float = 0.3
    anew: float = 1.0
    thinking: float = 0.2
    braking: float = 0.8
    worth: float = 3.0
    off: float = 0.03
    patience: float = 1.5
    clear: int = 10
    finder: FinderSettings = field(default_factory=FinderSettings)
    reference: ReferenceSettings = field(default_factory=ReferenceSettings)

    def __post_init__(self) -> None:
        for name in ("every", "at_once", "anew", "thinking", "braking", "worth", "off", "patience"):
            require_positive(name, getattr(self, name))


def movers(scene: Scene, seen: Sighting) -> Sighting:
    """Return the rows of moving obstacles, and of those beyond the scene's."""
    n_more = len(seen.margin) - len(scene.owners)
    moves = np.append(scene.moving[scene.owners], np.ones(n_more, dtype=bool))
    return Sighting(*(array[moves] for array in seen))


class Wish(NamedTuple):
    """What a trajectory is wanted for.

    Attributes
    ----------
    follows, since, stop : the reference that it replaces, from when on [s], and how that one brakes
    seen : moving obstacles
    best : cost of the reference [slots]
    any : whether any will do
    """

    follows: MotionReference
    since: float
    stop: Stop
    seen: Sighting
    best: float
    any: bool


class Choice(NamedTuple):
    """A trajectory that was found: the reference, whether it is clear, and the computing time [s]."""

    reference: MotionReference | None
    is_clear: bool
    computed: float


class Sought(NamedTuple):
    """The run when a trajectory was wanted.

    Attributes
    ----------
    reference, clock : its reference, and where on it the run was [s]
    thinks : time for which it is followed until another one is taken [s]
    choice : the trajectory, once it is found beside the control steps
    """

    reference: MotionReference
    clock: float
    thinks: float
    choice: Future[Choice] = Future()


class Searcher(Protocol):
    """What searches for trajectories beside the control steps."""

    def submit(self, wish: Wish) -> Future[Choice]:
        """Return a trajectory that will be found."""


class Pilot(Replanner):
    """A replanner of arms with a reference on a roadmap in time.

    Parameters
    ----------
    finder : search for courses

    Attributes
    ----------
    reference, clock : what is followed, and where on it the run is [s]
    is_clear : whether the last prediction found the reference clear of obstacles
    waited : time that the arms have not come along [s]
    aside : what searches for trajectories beside the control steps; None to search within them
    """

    aside: Searcher | None = None

    def __init__(self, finder: CourseFinder, settings: PilotSettings):
        self.finder, self.settings, self.reference = finder, settings, finder.plan
        self.clock, self.waited, self.is_clear = 0.0, 0.0, False
        self._looked = self._chosen = self._present = -np.inf
        self._pause, self._thinking = settings.at_once, settings.thinking
        self._placed: tuple[MotionReference, Places] | None = None
        self._sought: Sought | None = None
        self._rehearsed: Sighting | None = None

    def prepare(self, seen: Sighting) -> None:
        """Create the roadmap before the run, denser without a free trajectory. All kernels are loaded."""
        self._rehearsed = seen
        begin, joints, _ = self.reference.at(0.0)
        self._ahead(self.reference, 0.0, seen)
        self.finder.planned(begin, joints)  # for its kernels alone
        for _ in range(self.settings.finder.most_grown):
            found = self.finder.course(begin, joints, seen, Stop(self.settings.thinking, 0.0))
            if found is None or found.cost < self.settings.finder.courses.costs.meeting:
                break

    def update(self, run: ControlLoop) -> None:
        """Predict along the reference periodically, and replace it for a better trajectory."""
        if self._sought is not None and self._sought.choice.done():
            sought, self._sought = self._sought, None
            self._take(run, sought, sought.choice.result())
        if not self._is_due(run.time):
            return
        seen = movers(run.scene, run.observer.observe(run.time))
        if not self.looks_on(run.time, seen, self.waited) or self._sought is not None:
            return
        off = run.distance_from(self.current(run).here)
        wish = self._wish(run.time, seen, self.present(run), off, self.waited)
        if self.aside is None:
            self._take(run, self._now(wish), self.found(wish))
        else:
            self._sought = self._now(wish)._replace(choice=self.aside.submit(wish))

    def _now(self, wish: Wish) -> Sought:
        return Sought(self.reference, self.clock, wish.stop.thinks)

    def _take(self, run: ControlLoop, sought: Sought, choice: Choice) -> None:
        """Follow what was found."""
        run.log.note_plan(choice.computed, aside=self.aside is not None)
        if self.aside is not None:
            self._thinking = min(max(self.settings.thinking, LONGER * choice.computed), LONGEST)
        if self._adopt(sought, choice):
            self.waited = 0.0
            run.tell(f"another course, of {self.reference.duration:.2f} s")

    def current(self, run: ControlLoop) -> Setpoint:
        """Return the reference's poses now and next, its joints and rates. Next is a period later."""
        configurations, joints, rates = self.reference.at(self.clock + np.array([0.0, run.period]))
        here, ahead = poses_at(self.finder.coordinates, configurations).each()
        return Setpoint(here, ahead, False, joints[0], rates[0])

    def advance(self, run: ControlLoop, pace: float) -> None:
        """Advance by a control period, at a share of the reference's speed. Below a half the arms wait."""
        self.clock = min(self.clock + pace * run.period, self.reference.duration)
        waits = pace < 0.5 or self.clock >= self.reference.duration
        self.waited = self.waited + run.period if waits else 0.0

    def present(self, run: ControlLoop) -> Way:
        """Return the configuration and joints of the run, one sample."""
        (part,) = self.finder.coordinates.parts  # one rigid payload, or `ArmRows` had refused it
        pose = GroupPose(run.poses.center[0], matrices(run.poses.quaternion[0]))
        pose = self.finder.coordinates.groups[0].turn(pose)
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
        if cost.max() >= how.finder.courses.costs.meeting:
            return since >= self._pause
        fine = self.reference is self.finder.plan and not cost.any()
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
        wish = self._wish(time, seen, here, off, waited)
        return self._adopt(self._now(wish), self.found(wish))

    def _wish(self, time: float, seen: Sighting, here: Way, off: float, waited: float) -> Wish:
        """Return what a trajectory is wanted for now; see `choose`."""
        how = self.settings
        self._chosen, self._pause = time, 2.0 * how.at_once  # unless something better is found
        follows, clock, stop = self.reference, self.clock, self._stop()
        if off > how.off or waited >= how.patience:
            follows, clock = MotionReference.standing(here, how.reference), 0.0
            stop = Stop(self._thinking, 0.0)
        wants_any = waited >= how.patience
        return Wish(follows, clock, stop, seen, self._present, wants_any)

    def load(self) -> None:
        """Search once, for the kernels alone."""
        if (seen := self._rehearsed) is None:
            return
        begin, joints, _ = self.reference.at(0.0)
        self._ahead(self.reference, 0.0, seen)
        self.finder.course(begin, joints, seen, Stop(self.settings.thinking, 0.0))

    def found(self, wish: Wish) -> Choice:
        """Search for a trajectory."""
        begun, (follows, since, stop) = perf_counter(), wish[:3]
        begin, joints, _ = follows.at(follows.braked(since, stop, stop.after))
        found = self.finder.course(begin, joints, wish.seen, stop)
        way, left = (None, 0.0) if found is None else (found.way, found.left)
        if way is None and wish.any:
            way = self.finder.planned(begin, joints)
        if way is None:
            return Choice(None, False, perf_counter() - begun)
        path = continuous(self.finder.ground.space, np.vstack([begin, way.configurations]))[1:]
        other = follows.spliced(since, stop, way._replace(configurations=path), SLOT, left)
        ahead = self._ahead(other, 0.0, wish.seen)
        better = wish.any or self._total(other, 0.0, ahead) <= wish.best - self.settings.worth
        return Choice(other if better else None, self._is_clear(ahead), perf_counter() - begun)

    def _adopt(self, sought: Sought, choice: Choice) -> bool:
        """Follow what was found, unless the run has left its beginning; return whether."""
        gone = self.clock - sought.clock
        if choice.reference is None or self.reference is not sought.reference or gone > sought.thinks:
            return False
        self.reference, self.clock, self._pause = choice.reference, gone, self.settings.at_once
        self.is_clear = choice.is_clear
        return True

    def stand(self, here: Way) -> None:
        """Rest at a sample, and choose a trajectory at once."""
        self.reference, self.clock = MotionReference.standing(here, self.settings.reference), 0.0
        self.is_clear, self.waited = False, self.settings.patience
        self._looked = self._chosen = -np.inf

    def _ahead(self, reference: MotionReference, clock: float, seen: Sighting) -> Array:
        """Return a reference's costs from now on, then its end's, by slot."""
        how = self.settings.finder.courses
        placed = self._placed
        if placed is None or placed[0] is not reference:
            slots = np.arange(1 + np.ceil(reference.duration / SLOT))
            configurations, joints, _ = reference.at(SLOT * slots)
            placed = self._placed = reference, self.finder.foresight.placed(Way(configurations, joints))
        first = int(np.ceil(clock / SLOT))
        slots = first + np.arange(how.n_slots + 1)
        times = SLOT * slots.astype(np.float64) - clock
        return self.finder.foresight.cost_along(placed[1], slots, seen, times)

    def _is_clear(self, ahead: Array) -> bool:
        """Return whether there is no contact soon. A close pass is allowed."""
        return bool((ahead[: self.settings.clear] < self.finder.foresight.touching).all())

    def _total(self, reference: MotionReference, clock: float, cost: Array) -> float:
        """Return the cost of a reference from now on [slots]."""
        to_go = (reference.duration - clock) / SLOT
        how, stops = self.settings, reference.left > 0.0  # and another one has to be begun
        again = (how.thinking + how.reference.settling) / SLOT + how.worth if stops else 0.0
        return float(cost.sum()) + max(0.0, to_go) + reference.left + again

    def _stop(self) -> Stop:
        """Return the stop of the reference from its present speed."""
        how, moment = self.settings, 0.02  # s
        then = self.clock + self._thinking
        p, q = self.reference.at(np.array([then, then + moment]))[0]
        speed = span(self.finder.ground.space, p, q) / moment
        return Stop(self._thinking, speed / (how.braking * self.finder.standing.acceleration_limit))
