"""Runs among obstacles that a person drags, in real time."""

from __future__ import annotations

import copy
import time as clock
from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array
from comove.control import ExecutionLog, Executor, Functions, Pace, write_run
from comove.control.safety.twists import nodes_of
from comove.errors import OptionError
from comove.model.scene import Scene
from comove.verification.record import Record, verify_execution
from comove.verification.verify import VerifiedMotion
from comove.view.workbench.edits import Contents
from comove.view.workbench.geometry import longest_side


@dataclass(frozen=True)
class LiveSettings:
    """Settings of a run in real time.

    Attributes
    ----------
    fastest : speed of a dragged obstacle, in longest sides of the workspace a second: payloads cannot evade faster
        ones
    lag : time constant with which it follows the pointer [s]
    near : distance from the pointer at which it has arrived [m]
    states : states sent a second of the run
    longest : time after which a run ends [s]
    late : allowed delay of the run behind the wall clock, before the clock is reset [s]
    pace : periods of control and planning; short ones, as the page is blocked meanwhile
    """

    fastest: float = 0.4
    lag: float = 0.12
    near: float = 1e-4
    states: float = 25.0
    longest: float = 60.0
    late: float = 0.1
    pace: Pace = field(default_factory=lambda: Pace(leisure=3.0, haste=0.3))


class Led:
    """Path of an obstacle that follows a pointer, linear between knots.

    Parameters
    ----------
    place : array, shape (3,), its centre before [m]
    since : time until which it stays there [s]
    fastest : largest speed [m/s]
    settings : settings of its motion
    """

    def __init__(self, place: Array, since: float, fastest: float, settings: LiveSettings = LiveSettings()):
        self.times, self.places, self.settings = [0.0], [place], settings
        self.target, self.fastest = place, fastest
        if since > 0.0:
            self._add(since, place)

    def go_on(self, until: float) -> None:
        """Follow the pointer until a later instant [s]."""
        period, way, settings = until - self.times[-1], self.target - self.places[-1], self.settings
        left = float(np.linalg.norm(way))
        share = min(period / settings.lag, self.fastest * period / left) if left > settings.near else 1.0
        self._add(until, self.places[-1] + min(share, 1.0) * way)

    def _add(self, time: float, place: Array) -> None:
        """Add a knot, in place of the last one if nothing changed."""
        stands = len(self.times) > 1 and np.array_equal(self.places[-2], self.places[-1])
        if stands and np.array_equal(self.places[-1], place):
            self.times[-1] = time
            return
        self.times.append(time)
        self.places.append(place)

    def at(self, time: float) -> Array:
        """Return the position at an instant [s]; array, shape (3,) [m]. After the last knot it is constant."""
        if len(self.times) == 1 or time >= self.times[-1]:
            return self.places[-1]
        k = max(bisect_right(self.times, time) - 1, 0)
        share = (time - self.times[k]) / (self.times[k + 1] - self.times[k])
        return self.places[k] + share * (self.places[k + 1] - self.places[k])

    def motion(self, n_dims: int) -> Contents:
        """Return the path as an obstacle's `motion` in a scene file."""
        return {"waypoints": [place[:n_dims].tolist() for place in self.places], "times": list(self.times)}


class LedObstacles(Functions):
    """Observer of obstacles, some of which are dragged unpredictably.

    Parameters
    ----------
    scene : the scene to which the obstacles belong
    settings : settings of their motion
    """

    def __init__(self, scene: Scene, settings: LiveSettings = LiveSettings()):
        self.settings = settings
        super().__init__(scene, (None,) * len(scene.motions))
        self.led: dict[int, Led] = {}

    def lead(self, obstacle: int, place: ArrayLike, now: float) -> None:
        """Set the position to which an obstacle moves from now on.

        Parameters
        ----------
        place : array, shape (3,), the position [m]
        now : present time [s]

        Raises
        ------
        OptionError
            If there is no such obstacle, it is a mesh, or has a motion of its own.
        """
        scene, goal = self.scene, np.array(place, dtype=float)
        known = isinstance(obstacle, int) and 0 <= obstacle < len(scene.motions)
        if not known or goal.shape != (3,) or not np.isfinite(goal).all():
            raise OptionError("an obstacle cannot be led there", way_out="take hold of it again")
        if scene.moving[obstacle] or obstacle in scene.surfaces.owner:
            raise OptionError(
                f"{scene.name_of(obstacle)} cannot be led by hand",
                way_out="take one that stands, and is no mesh",
            )
        if obstacle not in self.led:
            fastest = self.settings.fastest * longest_side(scene)
            self.led[obstacle] = Led(scene.centers[obstacle], now, fastest, self.settings)
        goal[scene.n_dims :] = 0.0
        self.led[obstacle].target = goal

    def go_on(self, until: float) -> None:
        """Move all dragged obstacles to a later instant [s]."""
        for led in self.led.values():
            led.go_on(until)

    def ground_truth(self, time: Array) -> Array:
        """Return the true positions of all obstacles. Array, shape (n_times, n_obstacles, 3) [m]."""
        centers = self.scene.centers_at(time)
        for obstacle, led in self.led.items():
            centers[:, obstacle] = [led.at(instant) for instant in time.tolist()]
        return centers

    def contents(self, contents: Contents) -> Contents:
        """Return a scene's contents with the motions of dragged obstacles."""
        contents = copy.deepcopy(contents)
        for obstacle, led in self.led.items():
            contents["obstacles"][obstacle]["motion"] = led.motion(self.scene.n_dims)
        return contents


@dataclass(frozen=True, eq=False)
class State:
    """Present state of a run.

    Attributes
    ----------
    time : time since its beginning [s]
    nodes : array, shape (n_nodes, 3), end effectors first [m]
    offsets : array, shape (n_obstacles, 3), of the obstacles' centres from the scene's [m]
    planned : whether a plan is followed
    """

    time: float
    nodes: Array
    offsets: Array
    planned: bool


@dataclass(frozen=True, eq=False)
class LiveRun:
    """Completed run: its record, the executor's log, and the final blocker."""

    record: Record
    log: ExecutionLog
    blocker: str


def run_live(
    scene: Scene,
    contents: Contents,
    *,
    demonstration: Any,
    seed: int,
    plan: VerifiedMotion | None = None,
    leads: Callable[[], Mapping[int, ArrayLike]],
    tell: Callable[[State], None],
    stop: Callable[[], bool],
    settings: LiveSettings = LiveSettings(),
) -> LiveRun:
    """Execute a scene in real time until the payload arrives. Obstacles may be dragged meanwhile.

    Parameters
    ----------
    scene, contents : the scene, with a duration, and the contents of its file
    demonstration, seed, plan : as in `Executor`
    leads : function that returns the new positions of dragged obstacles since its last call, by number
    tell : function that is called with states
    stop : function that returns whether to stop early
    """
    observer, pace = LedObstacles(scene, settings), settings.pace
    executor = Executor(scene, observer, seed=seed, pace=pace, demonstration=demonstration, plan=plan)
    poses, every = [executor.poses], max(1, round(1.0 / (settings.states * pace.period)))
    executor.step()  # the first plan may take its time
    poses.append(executor.poses)
    observer.go_on(executor.time)
    begun = clock.perf_counter() - executor.time
    while not stop() and executor.time < settings.longest and not executor.ended:
        for obstacle, place in leads().items():
            observer.lead(obstacle, place, executor.time)
        executor.step()
        observer.go_on(executor.time)
        poses.append(executor.poses)
        if executor.n_steps % every == 0:
            tell(_state(executor, observer))
        late = clock.perf_counter() - begun - executor.time
        if late > settings.late:
            begun += late
        elif late < 0:
            clock.sleep(-late)
    poses.append(executor.poses)  # and stands
    observer.go_on(executor.time + pace.period)
    executed = Scene.from_dict(observer.contents(contents), folder=scene.folder)
    executed = executed if executed.is_timed else executed.timed(scene.duration)
    return LiveRun(executor.record(poses, executed), executor.log, executor.blocker)


def _state(executor: Executor, observer: LedObstacles) -> State:
    scene = executor.scene
    offsets = observer.ground_truth(np.array([executor.time]))[0] - scene.centers
    return State(executor.time, nodes_of(scene, executor.poses), offsets, executor.plan is not None)


def save_run(run: LiveRun, folder: Path, *, seed: int) -> None:
    """Write a run into a result folder, without a film. The other files are those of `comove run`."""
    from comove.view.figures import draw_run, save

    report = verify_execution(run.record, run.blocker)
    save(draw_run(run.record), folder / "run.png")
    time = float(run.record.time[-1])
    write_run(folder, run.record, report, run.log, seed=seed, interrupted=False, wall_time_s=time)
