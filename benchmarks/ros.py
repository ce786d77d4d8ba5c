"""Synchrony of arms over ROS 1 and ROS 2, and how they stop when something fails.

    python benchmarks/ros.py                                  # ROS 2 Kilted: 5 carries a robot, every fault twice
    python benchmarks/ros.py --ros jazzy --carries 17 --repeats 20

FollowJointTrajectory servers of all arms run on loopback, in processes of their own (`tests/ros/ros1_server.py`,
`tests/ros/ros2_server.py`); carries are solved, verified and sent to them by `comove send`'s own functions. Instants
are those that the servers log, by the system's monotonic clock:

- carries: between the first and last arm's end; deviation of the joints from the motion;
- faults, somewhere in the middle of the motion: from the fault until the other arms get the stop command, and until
  they are at rest. "moved on" counts arms that were not at rest within 5 s: it must be 0.

Needs ROS (`tests/ros/robots.py` says how to install each version). The load of the machine is printed, since other
work on it delays arms as well.
"""

from __future__ import annotations

import argparse
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import numpy as np
from timing import number, print_table

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from comove.robots import VerifiedJointMotion, verify_stored  # noqa: E402
from comove.ros import SendError, Tolerances, send  # noqa: E402
from tests.ros.robots import (  # noqa: E402
    JAZZY,
    KILTED,
    NOETIC,
    Host,
    Process,
    Ros,
    dds_domain,
    may_have_hosts,
    second_host,
)

VERSIONS = {ros.name: ros for ros in (NOETIC, JAZZY, KILTED)}
SCENES = (
    ROOT / "examples" / "baxter" / "gap_30.yaml",
    ROOT / "examples" / "robots" / "two_ur10.yaml",
    ROOT / "examples" / "robots" / "two_pandas.yaml",
)
MIDDLE = (0.2, 0.8)  # of the motion: when something fails
REST = 5.0  # s, within which all arms must be at rest
TOLERANCES = Tolerances(connect=30.0)
RESTING = ("stopped", "aborted", "done")


@dataclass
class Run:
    """A motion that is sent, and what happened.

    Attributes
    ----------
    ros, motion, servers : version of ROS, motion, and the servers' processes by arm
    failed : time of the fault [s]
    victim : arm that has the fault; empty if none
    began : whether a goal has come, so that arms may move
    """

    ros: Ros
    motion: VerifiedJointMotion
    folder: Path
    environment: Mapping[str, str]
    servers: dict[str, Process]
    victim: str
    rng: np.random.Generator
    failed: float = np.nan
    reason: str = ""
    told: list[float] = field(default_factory=list)
    stood: list[float] = field(default_factory=list)
    moved_on: int = 0
    began: bool = False

    def wait_for_middle(self) -> None:
        """Wait until the motion is somewhere in its middle."""
        for server in self.servers.values():
            server.wait_for("goal", 60.0)
            self.began = True
        time.sleep(TOLERANCES.delay + self.rng.uniform(*MIDDLE) * self.motion.joints.duration)

    def send(self, client: object) -> None:
        """Send the motion; note why it was stopped."""
        try:
            send(client, self.motion, tolerances=TOLERANCES)
        except SendError as error:
            self.reason = error.message

    def look(self) -> None:
        """Note when the arms without a fault were told to stop, and stood."""
        for arm, server in self.servers.items():
            if arm == self.victim:
                continue
            events = list[dict]()
            until = time.monotonic() + REST
            while time.monotonic() < until and not any(e["event"] in RESTING for e in events):
                with suppress(queue.Empty):
                    events.append(server.events.get(timeout=0.05))
            at = {event["event"]: event["at"] for event in events}
            if not self.began and "goal" not in at:
                continue
            if "cancel" in at:
                self.told.append(at["cancel"] - self.failed)
            if rested := [at[name] for name in RESTING if name in at]:
                self.stood.append(min(rested) - self.failed)
            else:
                self.moved_on += 1


def solved(path: Path, folder: Path) -> VerifiedJointMotion:
    """Solve a scene into a folder; return its verified motion, or exit without one."""
    comove = Path(sys.executable).with_name("comove")
    subprocess.run([comove, "solve", path, "--out", folder, "--no-pictures"], check=True, capture_output=True)
    motion = verify_stored(folder).verified
    if motion is None:
        sys.exit(f"{path}: no verified motion was found")
    return motion


@contextmanager
def arms_at_start(
    ros: Ros,
    motion: VerifiedJointMotion,
    environment: Mapping[str, str],
    faults: Mapping[str, str],
    hosts: Mapping[str, Host] | None = None,
) -> Iterator[dict[str, Process]]:
    """Yield servers of all arms, on hosts of their own where given, with joints at the motion's start."""
    names, first = motion.robot.joint_names, motion.joints.position[0]
    with ExitStack() as running:
        servers = {}
        for arm in motion.robot.arms:
            position = {names[column]: float(first[column]) for column in arm.columns}
            host = (hosts or {}).get(arm.name)
            server = ros.server(arm.name, position, environment, fault=faults.get(arm.name), host=host)
            servers[arm.name] = running.enter_context(server)
        for server in servers.values():
            server.wait_for("ready", 60.0)
        yield servers


def carried(
    ros: Ros, motion: VerifiedJointMotion, environment: Mapping[str, str]
) -> tuple[float, float, float]:
    """Run a motion; return the time between the arms' ends, as the servers and as `send` tell [s], and the deviation
    [rad]."""
    with arms_at_start(ros, motion, environment, {}) as servers, ros.client() as client:
        outcome = send(client, motion, tolerances=TOLERANCES)
        ends = [server.wait_for("done")["at"] for server in servers.values()]
    return max(ends) - min(ends), outcome.apart, outcome.deviation


def in_middle(fault: Callable[[Run, object], None]) -> Callable[[Run], None]:
    """Return a run in whose middle something fails; the fault gets run and client."""

    def run(this: Run) -> None:
        with this.ros.client() as client:

            def fail() -> None:
                with suppress(queue.Empty):  # it was not sent
                    this.wait_for_middle()
                    this.failed = time.monotonic()
                    fault(this, client)

            failing = threading.Thread(target=fail)
            failing.start()
            this.send(client)
            failing.join()
            this.look()

    return run


def to_server(how: signal.Signals) -> Callable[[Run], None]:
    """Return a run in which the victim's server gets a signal."""
    return in_middle(lambda this, _: this.servers[this.victim].process.send_signal(how))


def to_bridge(how: signal.Signals) -> Callable[[Run], None]:
    """Return a run in which the bridge gets a signal."""
    return in_middle(lambda _, client: client._bridge._process.send_signal(how))


def arm_fails(this: Run) -> None:
    """Send the motion to an arm that has a fault from the beginning, and fails at its `STUCK_AT` or `SILENT_AT`."""
    this.failed = time.monotonic()
    with this.ros.client() as client:
        this.send(client)
        this.look()


def comove_killed(this: Run) -> None:
    """Kill the command that sends."""
    with sending(this) as command:
        this.wait_for_middle()
        this.failed = time.monotonic()
        command.kill()
        this.look()


def killed_before(this: Run) -> None:
    """Kill a connected client with its bridges, uncleanly; the next one must get its motion to the end."""
    names = this.motion.robot.joint_names
    arms = {arm.name: tuple(names[c] for c in arm.columns) for arm in this.motion.robot.arms}
    with this.ros.client() as client:
        client.connect(arms, TOLERANCES.connect)
        client._bridge.kill()
        client._guard.kill()
    with this.ros.client() as client:
        this.send(client)
    this.reason = this.reason or "sent to its end"


@contextmanager
def sending(this: Run) -> Iterator[subprocess.Popen]:
    """Run `comove send` in a process of its own."""
    comove = Path(sys.executable).with_name("comove")
    words = [comove, "send", this.folder, "--ros", str(this.ros.version), "--timeout", "30"]
    environment = {**os.environ, **this.environment, "COMOVE_ROS_PYTHON": this.ros.python}
    with subprocess.Popen(
        words, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as command:
        try:
            yield command
        finally:
            command.kill()


def other_goal(this: Run) -> None:
    """Have another client send the victim's controller a goal."""
    (arm,) = (arm for arm in this.motion.robot.arms if arm.name == this.victim)
    joints = [this.motion.robot.joint_names[column] for column in arm.columns]
    program = ROOT / "tests" / "ros" / "ros2_other.py"
    with subprocess.Popen(
        [this.ros.python, str(program), this.ros.action(this.victim), *joints],
        env={**os.environ, **this.environment},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as other:
        other.stdout.readline()

        def begin(_: Run, __: object) -> None:
            other.stdin.write("\n")
            other.stdin.flush()
            other.stdout.readline()

        in_middle(begin)(this)
        other.kill()


FAULTS: dict[str, tuple[Callable[[Run], None], str | None]] = {
    "server gets SIGTERM": (to_server(signal.SIGTERM), None),
    "server gets SIGKILL": (to_server(signal.SIGKILL), None),
    "server gets SIGSTOP": (to_server(signal.SIGSTOP), None),
    "bridge gets SIGKILL": (to_bridge(signal.SIGKILL), None),
    "bridge gets SIGSTOP": (to_bridge(signal.SIGSTOP), None),
    "comove gets SIGKILL": (comove_killed, None),
    "a client was killed before": (killed_before, None),
    "another client's goal": (other_goal, None),
    "arm refuses": (arm_fails, "refuse"),
    "arm gives up": (arm_fails, "abort"),
    "arm is stuck": (arm_fails, "stuck"),
    "arm is slow": (arm_fails, "slow"),
    "clock of the robot is late": (arm_fails, "skewed"),
    "joint states fall silent": (arm_fails, "silent"),
    "network of an arm is cut": (in_middle(lambda this, _: this.servers[this.victim].host.cut()), None),
}
"""Runs by what fails, and the fault that the victim's server has from the beginning."""
ON_A_SECOND_HOST = "network"  # is the victim's server
NOT_VICTIM = ("bridge", "comove", "a client")
WITHIN = ("server", "bridge", "comove", "another", "network")  # whose fault has an instant
NOT_IN_ROS1 = ("another client's goal", "network of an arm is cut")


def spread(times: list[float]) -> str:
    """Return median and largest [ms]."""
    return f"{number(1e3 * median(times))}, {number(1e3 * max(times))}" if times else ""


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ros", choices=VERSIONS, default="kilted")
    parser.add_argument("--carries", type=int, default=5, help="of each robot (5)")
    parser.add_argument("--repeats", type=int, default=2, help="of each fault (2)")
    parser.add_argument(
        "--only", nargs="+", default=list(FAULTS), help="faults, by the beginning of their names"
    )
    options = parser.parse_args()
    ros = VERSIONS[options.ros]
    if not ros.is_there:
        sys.exit(f"ROS {ros.name} is not installed: {ros.install}")
    network = ros.network() if ros.version == 1 else dds_domain(quick=False)
    with tempfile.TemporaryDirectory() as folder, network as environment:
        os.environ.update(environment)
        motions = {path.stem: (Path(folder, path.stem), path) for path in SCENES}
        motions = {name: (place, solved(path, place)) for name, (place, path) in motions.items()}
        print(f"{ros.name}; {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n")
        if options.carries:
            rows = []
            for name, (_, motion) in motions.items():
                told = [carried(ros, motion, environment) for _ in range(options.carries)]
                servers, sent, off = (list(column) for column in zip(*told, strict=True))
                rows.append([name, len(told), spread(servers), spread(sent), number(max(off))])
            print_table(
                [
                    "carry",
                    "to its end",
                    "arms apart: median, largest [ms]",
                    "as send tells [ms]",
                    "deviation [rad]",
                ],
                rows,
            )
            print()
        rows = []
        place, motion = motions[SCENES[0].stem]
        arms = [arm.name for arm in motion.robot.arms]
        rng = np.random.default_rng(0)
        for name, (fault, of_server) in FAULTS.items():
            if not any(name.startswith(word) for word in options.only) or not options.repeats:
                continue
            if ros.version == 1 and name in NOT_IN_ROS1:
                continue
            apart = name.startswith(ON_A_SECOND_HOST)
            if apart and not may_have_hosts():
                print(
                    f"{name}: not tried, since this host may make no network namespaces (iproute2, as root)\n"
                )
                continue
            told, stood, moved_on, reasons = list[float](), list[float](), 0, dict[str, int]()
            for k in range(options.repeats):
                victim = "" if name.startswith(NOT_VICTIM) else arms[k % len(arms)]
                faults = {} if of_server is None else {victim: of_server}
                with second_host() if apart else nullcontext() as host:
                    there = environment if host is None else host.domain
                    os.environ.update(there)
                    hosts = {} if host is None else {victim: host}
                    with arms_at_start(ros, motion, there, faults, hosts) as servers:
                        this = Run(ros, motion, place, there, servers, victim, rng)
                        fault(this)
                told += this.told if name.startswith(WITHIN) else []
                stood += this.stood if name.startswith(WITHIN) else []
                moved_on += this.moved_on
                reasons[this.reason] = reasons.get(this.reason, 0) + 1
            often = max(reasons, key=lambda reason: reasons[reason])
            rows.append([name, options.repeats, spread(told), spread(stood), moved_on, often])
            print("; ".join(map(str, rows[-1])), file=sys.stderr, flush=True)
        print_table(
            [
                "fault",
                "times",
                "told to stop after [ms]",
                "at rest after [ms]",
                "moved on",
                "most often told",
            ],
            rows,
        )


if __name__ == "__main__":
    main()
