"""Rehearsals: a simulated robot behind the interfaces of a real one in ROS 2.

The robot and its controllers run in this process, in real time; `ros2_robot.py` has the action servers and topics.
The robot's clock begins at the system's, or at 0 as simulated time. It advances by the simulation's steps, which wait
for the system's clock and catch up with it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from comove.errors import OptionError, SendError
from comove.ros.bridges import BridgeProcess, Event
from comove.ros.clients import ROS2, Names, started
from comove.ros.priority import SIMULATING, priority
from comove.ros.robot_controllers import MovedRobot, RobotControllers
from comove.ros.trajectory_control import NANO, GoalEnd

PROGRAM = Path(__file__).with_name("ros2_robot.py")
FASTEST = 500.0  # Hz, of joint states
FEEDBACK = 0.05  # s, between feedbacks
CLOCK = 0.004  # s, between messages of simulated time
SEEN = 0.01  # s, between messages of the obstacles
OBSTACLES = "/obstacles"  # topic of the centres of those that move, in their order
LATE = 0.1  # s, by which the simulation may be behind the clock without a word
AT_ONCE = 25  # steps between looks at what arrives while it catches up
STARTING = 20.0  # s, for a Python to load ROS and to join its graph

Tell = Callable[[str], None]


@dataclass(frozen=True)
class RehearsalSettings:
    """Settings of a rehearsal.

    Attributes
    ----------
    rate : joint states a second [Hz], from 1 to 500; rounded to whole steps of the simulation
    sim_time : whether the robot's time is simulated, from 0, and told on /clock
    moving_end : whether trajectories may end with a velocity
    """

    rate: float = 100.0
    sim_time: bool = False
    moving_end: bool = False

    def __post_init__(self) -> None:
        if not 1.0 <= self.rate <= FASTEST:
            raise OptionError(
                f"{self.rate} Hz are not possible",
                key="--rate",
                way_out=f"give a number from 1 to {FASTEST:g}",
            )


USUAL = RehearsalSettings()


class Rehearsal:
    """A robot behind interfaces of ROS 2, as a context.

    Parameters
    ----------
    robot : robot that is moved
    names : names of its interfaces; those of its description unless given, or the usual ones
    settings : settings
    tell : function that gets what happens, in words
    python : path of a Python with ROS 2; searched for unless given

    Attributes
    ----------
    ended : reason why it ended by itself; empty if it did not

    Raises
    ------
    SendError
        If there is no ROS 2 here, or the interfaces cannot be served.
    """

    def __init__(
        self,
        robot: MovedRobot,
        names: Names | None = None,
        settings: RehearsalSettings = USUAL,
        *,
        tell: Tell = print,
        python: str | None = None,
    ):
        names = (names or Names.of(robot.robot)).or_usual(ROS2)
        self.robot, self.settings, self.ended, self._tell = robot, settings, "", tell
        self._controllers = RobotControllers(robot, names, moving_end=settings.moving_end)
        self._step, self._epoch = round(robot.timestep * NANO), 0
        self._of_goal, self._cancelled, self._said = dict[str, str](), set[str](), set[str]()
        self._obstacles_at: int | None = None
        self._bridge, self._middleware = self._opened(python)

    def __enter__(self) -> Rehearsal:
        return self

    def __exit__(self, *_: object) -> None:
        self._bridge.close()

    def _opened(self, python: str | None) -> tuple[BridgeProcess, str]:
        """Start the program under the first Python with ROS 2; return it with its middleware, in words."""
        controllers = self._controllers
        command = {
            "do": "serve",
            "servers": {action: server.kind for action, server in controllers.servers.items()},
            "streams": controllers.streams,
            "joint_states": controllers.names.joint_states,
            "joints": controllers.joint_names,
            "sim_time": self.settings.sim_time,
            "obstacles": OBSTACLES if self.robot.scene.moving.any() else None,
        }
        process, answer, _ = started(PROGRAM, command, "serving", STARTING, python)
        if answer["event"] == "serving":
            return process, f"{answer['distribution'] or 'ROS 2'}, {answer['rmw']}, domain {answer['domain']}"
        process.close()
        raise SendError(
            f"ROS 2 does not serve the robot's interfaces: {answer['what']}",
            key="ros",
            way_out="correct their names, and look whether ROS 2 works in its Python",
        )

    def offers(self) -> list[tuple[str, str]]:
        """Return what the robot offers, in words."""
        controllers = self._controllers
        topic, n_joints = controllers.names.joint_states, len(controllers.joint_names)
        rate = 1.0 / (self._every(1.0 / self.settings.rate) * self.robot.timestep)
        rows = [("middleware", self._middleware), *controllers.offers()]
        rows.append(("joint states", f"{topic}, {n_joints} joints, {rate:.4g} Hz"))
        rows.append(("time", "simulated, on /clock" if self.settings.sim_time else "the system's"))
        if self.robot.scene.moving.any():
            rows.append(
                ("moving obstacles", f"begin with the first command of an arm, {OBSTACLES} tells where")
            )
        return rows

    def run(self, ends: Callable[[], bool]) -> str:
        """Move the robot in real time until something ends that; return the reason if it ended by itself.

        That is `ends`, which then returns true, the end of ROS, or a simulation that breaks down.
        """
        robot, step = self.robot, self._step
        self._epoch = 0 if self.settings.sim_time else time.time_ns() - robot.n_steps * step
        began = time.monotonic_ns() - robot.n_steps * step
        in_time = nullcontext() if self.settings.sim_time else priority(SIMULATING, self._bridge.threads)
        with in_time:
            self._run(began, ends)
        return self.ended

    def _run(self, began: int, ends: Callable[[], bool]) -> None:
        robot, step = self.robot, self._step
        while not (self.ended or ends()):
            behind = (time.monotonic_ns() - began) // step - robot.n_steps
            if behind * step > LATE * NANO:
                began += self._tell_late(behind * step)
            for _ in range(min(behind, AT_ONCE)):
                self._advance()
            due = began + (robot.n_steps + 1) * step
            for event in self._bridge.news((due - time.monotonic_ns()) / NANO):
                self._take(event)
            for text in robot.news():
                self._tell(text)

    def _every(self, period: float) -> int:
        """Return the number of steps in a period [s]."""
        return max(1, round(period / self.robot.timestep))

    def _tell_late(self, behind: int) -> int:
        """Say that the simulation is late [ns]; return by how much the clock waits. Only simulated time does."""
        waits = self.settings.sim_time
        advice = "joint states are as old, and motions as late; --sim-time lets time pass more slowly"
        self._tell_once(
            "late",
            f"warning: the simulation is {behind / NANO:.2f} s behind the clock: "
            + ("simulated time passes more slowly" if waits else advice),
        )
        return behind if waits else 0

    def _tell_once(self, key: str, text: str) -> None:
        if key not in self._said:
            self._said.add(key)
            self._tell(text)

    @property
    def now(self) -> int:
        """Return the robot's time [ns]."""
        return self._epoch + self.robot.n_steps * self._step

    def _advance(self) -> None:
        """Move the robot one step, and publish what is due."""
        robot, controllers = self.robot, self._controllers
        if self._obstacles_at is not None and self.now >= self._obstacles_at:
            robot.begin_obstacles()
        for action, end in controllers.step(self.now):
            self._end(action, [end])
        if self.settings.sim_time and robot.n_steps % self._every(CLOCK) == 0:
            self._bridge.tell({"do": "clock", "stamp": self.now})
        if robot.n_steps % self._every(1.0 / self.settings.rate) == 0:
            self._bridge.tell({"do": "states", "stamp": self.now, **controllers.states()})
        if robot.scene.moving.any() and robot.n_steps % self._every(SEEN) == 0:
            centers = robot.obstacle_centers.tolist()
            self._bridge.tell({"do": "obstacles", "stamp": self.now, "centers": centers})
        if robot.n_steps % self._every(FEEDBACK) == 0:
            for server in controllers.servers.values():
                if server.is_busy:
                    self._bridge.tell(server.feedback(self.now))
            if robot.is_broken:
                self.ended = "the simulation broke down"

    def _end(self, action: str, ends: Sequence[GoalEnd]) -> None:
        for end in ends:
            self._of_goal.pop(end.number, None)
            self._cancelled.discard(end.number)
            result = self._controllers.servers[action].result()
            self._bridge.tell({"do": "end", "goal": end.number, **end._asdict(), **result})
            said = f": {end.text}" if end.text and end.status != "SUCCEEDED" else ""
            self._tell_at(f"{action} {end.status.lower()}{said}")

    def _tell_at(self, text: str) -> None:
        self._tell(f"{self.robot.time:.2f} s: {text}")

    def _take(self, event: Event) -> None:
        """Answer an event of the program."""
        kind, servers = event["event"], self._controllers.servers
        if kind in ("goal", "grip"):
            self._answer(event)
        elif kind == "begin":
            self._begin(event["goal"])
        elif kind == "cancel":
            self._cancelled.add(event["goal"])
            action = self._of_goal.get(event["goal"])
            if action is not None:
                self._end(action, servers[action].cancel(event["goal"]))
        elif kind == "stream":
            reason, topic = self._controllers.stream(event, self.now), event["topic"]
            if reason:
                self._tell_once(
                    f"{topic}: {reason}", f"warning: commands of {topic} are ignored while {reason}"
                )
            else:
                self.robot.begin_obstacles()
        elif kind in ("ended", "refused"):
            self.ended = f"the interfaces of ROS ended: {event.get('what') or self._bridge.last_words()}"

    def _answer(self, event: Event) -> None:
        """Accept or refuse a goal."""
        number, action = event["goal"], event["server"]
        reason = self._controllers.servers[action].answer(event, self.now)
        self._bridge.tell({"do": "answer", "goal": number, "accepted": not reason, "reason": reason})
        if reason:
            self._tell_at(f"{action} refused a goal: {reason}")
        else:
            self._of_goal[number] = action

    def _begin(self, number: str) -> None:
        """Begin an accepted goal."""
        action = self._of_goal[number]
        server = self._controllers.servers[action]
        self._tell_at(f"{action} begins a goal")
        self._end(action, server.begin(number, self.now))
        if self._obstacles_at is None and action in self._controllers.arms:
            self._obstacles_at = self._controllers.arms[action].controller.start
        if number in self._cancelled:
            self._end(action, server.cancel(number))
