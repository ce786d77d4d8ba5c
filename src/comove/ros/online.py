"""Online runs of real robots: the executor of `comove.robots.online` in real time, its commands streamed.

The executor's time is that at which its next command is played. A command that is not ready then makes the bridge
brake (`command_player.py`); the executor goes on from where the arms came to rest. So whatever is late, the joints,
the obstacles or a plan, the arms stand, and nothing is commanded that was computed for another instant.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from comove.arrays import Array, first_largest
from comove.control.measured import Observed
from comove.control.safety.twists import nodes_of
from comove.errors import RobotError, SendError
from comove.geometry.distances import CENTER
from comove.model.scene import Scene
from comove.planning.search import Interruption
from comove.planning.seeds import minimum_jerk
from comove.processes import one_blas_thread
from comove.robots.online.aside import SearchProcess
from comove.robots.online.executor import JointExecutor
from comove.robots.online.streamed import StreamedRun, StreamTiming
from comove.ros.priority import COMMANDING, priority
from comove.ros.streams import Braked, CommandStream, Played, SeenObstacle

SLOWLY = 0.02  # rad/s, at most, with which joints go from where they rest to where a command is computed for
AWAY = 0.01  # rad, of a joint from the beginning of the plan, at most
AGAIN = 0.2  # s that everything must be in time before a run goes on
NEARER = -2  # number of commands that are not the executor's
PATIENCE = 10.0  # s, in which it is in time again


@dataclass
class _Sent:
    """What is noted of the commands that were sent, by their number."""

    nodes: list[Array] = field(default_factory=list)
    known: list[float] = field(default_factory=list)


@dataclass
class _Seen:
    """Where obstacles were taken to be, by the monotonic clock [s]."""

    time: list[float] = field(default_factory=list)
    centers: list[Array] = field(default_factory=list)

    def at(self, instants: Array) -> Array:
        """Return the last centres before instants.

        Arrays, (n,) -> (n, n_obstacles, 3) [m].
        """
        order = np.argsort(self.time, kind="stable")  # commands are computed ahead of their time
        last = np.searchsorted(np.array(self.time)[order], instants, side="right") - 1
        return np.array(self.centers)[order[np.maximum(last, 0)]]


def moving_names(scene: Scene) -> dict[int, str]:
    """Return the names of obstacles that move, by number."""
    obstacles = scene.file.obstacles
    return {int(j): obstacles[j].name or f"obstacles[{j}]" for j in np.flatnonzero(scene.moving)}


def await_obstacles(stream: CommandStream, observer: Observed, within: float) -> float:
    """Wait until every moving obstacle was seen; return the instant by the monotonic clock that counts as 0 [s].

    Raises
    ------
    SendError
        If one is not seen `within` so many seconds.
    """
    missing, until = set(np.flatnonzero(observer.scene.moving).tolist()), time.monotonic() + within
    zero, first = None, dict[int, SeenObstacle]()
    while missing - set(first):
        if time.monotonic() > until:
            lost = min(missing - set(first))
            why = stream.why_unseen(moving_names(observer.scene)[lost])
            raise SendError(
                f"nobody tells where '{observer.scene.name_of(lost)}' is{why and f': {why}'}",
                key="obstacles",
                way_out="let the clouds show it, about where the scene has it at 0 s"
                if why
                else "tell it on the topic of --obstacles, by this name or by its number among those that move",
            )
        for seen in stream.news(0.05):
            if seen.time <= time.monotonic() + stream.settings.clock:
                first[seen.number] = seen
    zero = max((seen.time for seen in first.values()), default=time.monotonic())
    stream.let_turn(zero)
    for seen in first.values():
        observer.update(seen.number, seen.center[: observer.scene.n_dims], 0.0)
    return zero


def require_start(stream: CommandStream, executor: JointExecutor) -> None:
    """Check that the robot is where the plan begins.

    Raises
    ------
    SendError
        If it is not.
    """
    found, wanted = stream.position, executor.plan.joints.position[0]
    off = np.abs(found - wanted)
    if not (off <= AWAY).all():
        worst = first_largest(np.nan_to_num(off, nan=np.inf))
        raise SendError(
            f"the joint '{executor.robot.joint_names[worst]}' is at {found[worst]:.4f} rad, and the plan begins at "
            f"{wanted[worst]:.4f} rad, {off[worst]:.3g} rad away ({AWAY:g} allowed)",
            key="start",
            way_out="solve the scene, bring it there by 'comove send DIR --part approach', and give --plan DIR",
        )


@one_blas_thread()
def run_streamed(
    executor: JointExecutor,
    stream: CommandStream,
    budget: float,
    *,
    zero: float | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> StreamedRun:
    """Run a robot until its payload arrives.

    Parameters
    ----------
    executor : executor at the beginning of its plan, with the stream's period
    stream : stream to the robot, which rests there
    budget : time that the run may last [s]
    zero : instant by the monotonic clock that is 0 on the executor's [s], as `await_obstacles` returns it; that of
        the first command unless given
    tell : function that gets what happens, in words

    Raises
    ------
    SendError
        If the robot is not where the plan begins, or the stream ends.
    """
    stream.require_clock()
    require_start(stream, executor)
    run = _Run(executor, stream, tell)
    with SearchProcess(executor.replanner) as aside, _without_garbage(), priority(COMMANDING, stream.threads):
        executor.replanner.aside = aside
        try:
            run.begin(zero)
            run.go(budget)
        except BaseException:  # whatever it is, the arms rest
            stream.close()
            raise
        finally:
            executor.replanner.aside = None
        return run.ended(stream.end())


class _Run:
    """A run while it lasts."""

    def __init__(self, executor: JointExecutor, stream: CommandStream, tell: Callable[[str], None]):
        self.executor, self.stream, self.tell = executor, stream, tell
        self.period, self.sent = executor.period, _Sent()
        self.number, self.run, self.zero = 0, 0, 0.0
        self.given_up, self.stops = "", list[str]()
        self.known, self.interruption, self.seen = -np.inf, Interruption(), _Seen()

    @property
    def due(self) -> float:
        """Return when the next command is due, by the monotonic clock [s]."""
        return self.zero + self.executor.time - self.stream.lead * self.period

    def begin(self, zero: float | None) -> None:
        """Go to the beginning of the plan; let the executor's clock begin."""
        executor, stream = self.executor, self.stream
        measured, wanted = stream.position, executor.position
        self.zero = time.monotonic() if zero is None else zero
        stream.begin(measured)
        now = self._go_slowly(measured, wanted)
        if zero is None:
            self.zero = now
        executor.let_pass(now - self.zero)

    def _go_slowly(self, here: Array, there: Array) -> float:
        """Go to joints from others, (n_joints,) [rad], both at rest; return when the next command is played [s]."""
        most = float(
            np.abs(there - here).max()
        )  # the fastest instant of least jerk has 1.875 times the mean speed
        n_steps, begun = 2 + int(1.875 * most / (SLOWLY * self.period)), time.monotonic()
        for k, share in enumerate(minimum_jerk(np.linspace(0.0, 1.0, n_steps + 1))[1:]):
            self._wait(begun + k * self.period)
            lag = float(np.abs(self.stream.position - here).max())
            if lag > most + AWAY:  # it does not go where it is commanded
                self.stream.brake(
                    f"a joint is {lag:.2g} rad from where it rested, and {most:.2g} rad are commanded"
                )
            self.stream.follow(self.run, NEARER, here + share * (there - here))
        self._wait(begun + (n_steps + self.stream.lead + 2) * self.period)
        return time.monotonic() + self.stream.lead * self.period

    def go(self, budget: float) -> None:
        """Command until the end."""
        executor, until = self.executor, self.executor.time + budget
        with self.interruption.noticed():
            while executor.time < until - 1e-9 and not self.interruption.wished:
                self._wait(self.due)
                if not self._is_in_time():
                    self.stream.brake("a measurement is late")
                stop = self.stream.braked()
                if stop is not None:
                    if not self._goes_on(stop):
                        return
                    continue
                if self.given_up:
                    return
                try:
                    command = executor.step(self.stream.position)
                except RobotError as error:
                    self.given_up = error.message
                    return
                self.stream.follow(self.run, self.number, command)
                self._note()
                if executor.arrived:
                    return

    def _note(self) -> None:
        """Note what the last command was made from."""
        executor, sent = self.executor, self.sent
        sent.nodes.append(nodes_of(executor.scene, executor.poses))
        self._look(self.zero + executor.time)
        sent.known.append(
            self.known if np.isfinite(self.known) else time.monotonic() - self.stream.joints_age
        )
        self.number += 1

    def _look(self, instant: float) -> None:
        """Note where obstacles are at an instant by the monotonic clock [s]."""
        table = self.executor.observer.observe(instant - self.zero).table
        self.seen.time.append(instant)
        self.seen.centers.append(table[self.executor.scene.first_rows, CENTER : CENTER + 3])

    def _wait(self, until: float) -> None:
        """Take in what is measured, until an instant."""
        while True:
            left = until - time.monotonic()
            for seen in self.stream.news(max(left, 0.0)):
                self._see(seen)
            if left <= 0.0:
                return

    def _see(self, seen: SeenObstacle) -> None:
        observer = self.executor.observer
        if seen.time > time.monotonic() + self.stream.settings.clock:
            return  # later ones would be old news
        if isinstance(observer, Observed) and observer.is_news(seen.number, seen.time - self.zero):
            observer.update(seen.number, seen.center[: observer.scene.n_dims], seen.time - self.zero)
            self.known = seen.time

    def _is_in_time(self) -> bool:
        how, stream = self.stream.settings, self.stream
        joints, obstacles = abs(stream.joints_age), abs(stream.obstacles_age)
        return joints <= how.joints_silence and obstacles <= how.obstacles_silence

    def _goes_on(self, stop: Braked) -> bool:
        """Go on from where the arms came to rest; return whether. All must be in time again."""
        self.stops.append(stop.why)
        self.tell(f"{self.executor.time:.2f} s: the arms braked: {stop.why}")
        until, since = time.monotonic() + PATIENCE, time.monotonic()
        while time.monotonic() - since < AGAIN:
            self._wait(time.monotonic() + 0.01)
            self._look(time.monotonic())
            if not self._is_in_time():
                since = time.monotonic()
            if time.monotonic() > until or self.interruption.wished:
                self.given_up = "" if self.interruption.wished else f"{stop.why}, for {PATIENCE:g} s"
                return False
        self.run = stop.run + 1
        try:
            self.executor.rest_at(stop.position)
        except RobotError as error:
            self.given_up = error.message
            return False
        self.executor.let_pass(self._go_slowly(stop.position, self.executor.position) - self.zero)
        return True

    def ended(self, played: Played) -> StreamedRun:
        """Return the run from what was played, from its first command on."""
        sent, first = self.sent, np.flatnonzero(played.number >= 0)
        begin = int(first[0]) if len(first) else len(played.number)
        time_of, number, commanded, measured = (rows[begin:] for rows in played)
        if not len(number):
            raise SendError(
                f"nothing was commanded: {self.given_up or 'the run was interrupted'}",
                key="ros",
                way_out="run it again",
            )
        held, latest = number >= 0, np.maximum.accumulate(number) if len(number) else number
        nodes = np.array([sent.nodes[n] for n in latest]).reshape(len(number), -1, 3)
        for k in np.flatnonzero(~held):
            nodes[k] = nodes_of(self.executor.scene, self.executor.payload_at(commanded[k]))
        return StreamedRun(
            self.executor.scene,
            self.executor.robot,
            self.period,
            commanded,
            measured,
            held,
            nodes,
            self.seen.at(time_of),
            self.executor.arrived,
            self.interruption.wished,
            self.given_up,
            tuple(self.stops),
            self._timing(time_of, number),
        )

    def _timing(self, played: Array, number: Array) -> StreamTiming:
        held = np.flatnonzero(number >= 0)
        known = np.array(self.sent.known)[number[held]]
        late, ages = played[held] - known, np.abs(self.stream.ages)
        steps = np.diff(played)
        return StreamTiming(
            *(
                _quantile(a, q)
                for a, q in (
                    (steps, 0.5),
                    (steps, 0.999),
                    (steps, 1.0),
                    (late, 0.5),
                    (late, 0.999),
                    (ages, 0.5),
                    (ages, 0.99),
                )
            )
        )


def _quantile(values: Array, q: float) -> float:
    return float(np.quantile(values, q)) if len(values) else float("nan")


@contextmanager
def _without_garbage() -> Iterator[None]:
    """Collect no garbage meanwhile: that takes longer than a period."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()
