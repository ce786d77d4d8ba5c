"""Synchrony and emergency stop of Baxter's arms over ROS 1.

    python benchmarks/ros.py                    # five motions to the end, five that are broken off
    python benchmarks/ros.py --repeats 20

A master and a FollowJointTrajectory server each arm run on loopback, in processes of their own
(`tests/ros/ros1_server.py`); a transfer motion is solved, verified and sent to them. All instants are those at which
the servers' own processes log them, by the system's monotonic clock:

- finish: between the two arms' ends of one motion; at most 50 ms is required;
- told, stopped: from the moment at which one server is killed (SIGKILL, in turn left and right, somewhere in the
  middle of the motion) until the other one gets the stop command, and until it is at rest; at most 100 ms is
  required.

Needs ROS 1: apt-get install python3-rospy python3-actionlib python3-roslaunch. The load of the machine is printed,
since other work on it delays arms as well.
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from statistics import median

from timing import number, print_table

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tests.ros.ros1_robot import INSTALL, Process, arm_server, has_ros, ros_master  # noqa: E402

from comove import solve  # noqa: E402
from comove.model import Scene, demonstration_of  # noqa: E402
from comove.robots import VerifiedJointMotion  # noqa: E402
from comove.ros import Ros1Client, SendError, Tolerances, send  # noqa: E402

SCENE = ROOT / "examples" / "baxter" / "gap_30.yaml"
APART, STOPPED = 0.050, 0.100  # s, what is wanted
MIDDLE = (0.2, 0.8)  # of the motion: when servers are killed
TOLERANCES = Tolerances(connect=10.0)


def solved(path: Path) -> VerifiedJointMotion:
    """Return a verified transfer motion, or exit without one."""
    scene = Scene.load(path)
    found = solve(scene, demonstration=demonstration_of(scene)).joints
    if found.motion is None:
        sys.exit(f"{path}: no verified motion was found: {found.verdict.reasons[0]}")
    return found.motion


@contextmanager
def robot_at_start(
    motion: VerifiedJointMotion, environment: Mapping[str, str]
) -> Iterator[dict[str, Process]]:
    """Yield servers of all arms with joints at the motion's start."""
    names, first = motion.robot.joint_names, motion.joints.position[0]
    with ExitStack() as running:
        servers = {}
        for arm in motion.robot.arms:
            position = {names[column]: float(first[column]) for column in arm.columns}
            servers[arm.name] = running.enter_context(arm_server(arm.name, position, environment))
        for server in servers.values():
            server.wait_for("ready")
        yield servers


def finished_apart(motion: VerifiedJointMotion, environment: Mapping[str, str]) -> tuple[float, float]:
    """Run a motion; return the time between the arms' ends [s]. The time measured by `send` itself is added."""
    with robot_at_start(motion, environment) as servers, Ros1Client() as client:
        outcome = send(client, motion, tolerances=TOLERANCES)
        ends = [server.wait_for("done")["at"] for server in servers.values()]
    return max(ends) - min(ends), outcome.apart


def stopped_after(
    motion: VerifiedJointMotion, environment: Mapping[str, str], victim: str, share: float
) -> tuple[float, float]:
    """Break off a motion; return the other arm's reaction times [s]. They are those of its stop command and of its
    rest after `victim` was killed."""
    with robot_at_start(motion, environment) as servers, Ros1Client() as client:
        killed = []

        def kill() -> None:
            servers[victim].wait_for("goal", timeout=60.0)
            time.sleep(TOLERANCES.delay + share * motion.joints.duration)
            killed.append(time.monotonic())
            servers[victim].process.kill()

        killer = threading.Thread(target=kill)
        killer.start()
        try:
            send(client, motion, tolerances=TOLERANCES)
        except SendError as error:
            if error.outcome is None:  # it did not begin
                raise
        killer.join()
        (other,) = (server for arm, server in servers.items() if arm != victim)
        told, stood = other.wait_for("cancel")["at"], other.wait_for("stopped")["at"]
    return told - killed[0], stood - killed[0]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5, help="motions of each kind (5)")
    parser.add_argument("--scene", type=Path, default=SCENE, help="of a robot with two arms (gap_30)")
    options = parser.parse_args()
    if options.repeats < 1:
        parser.error(f"--repeats {options.repeats}: give 1 or more")
    if not has_ros():
        sys.exit(f"ROS 1 is not installed: {INSTALL}")
    motion = solved(options.scene)
    arms = [arm.name for arm in motion.robot.arms]
    print(
        f"{motion.scene.name}, {motion.joints.duration:g} s, {options.repeats} motions of each kind; "
        f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n"
    )
    with ros_master() as environment:
        os.environ.update(environment)
        ends = [finished_apart(motion, environment) for _ in range(options.repeats)]
        low, high = MIDDLE
        shares = [low + (high - low) * (i + 0.5) / options.repeats for i in range(options.repeats)]
        stops = [
            stopped_after(motion, environment, arms[i % len(arms)], share) for i, share in enumerate(shares)
        ]
    rows = [
        ("finish of both arms apart, by the servers", [end for end, _ in ends], APART),
        ("finish of both arms apart, as send tells", [told for _, told in ends], APART),
        ("server killed: other arm told to stop after", [told for told, _ in stops], STOPPED),
        ("server killed: other arm stands after", [stood for _, stood in stops], STOPPED),
    ]
    print_table(
        ["ms", "least", "median", "largest", "wanted", "within"],
        [
            [
                what,
                *(number(1e3 * value(times)) for value in (min, median, max)),
                f"{1e3 * wanted:g}",
                f"{sum(t <= wanted for t in times)} of {len(times)}",
            ]
            for what, times, wanted in rows
        ],
    )


if __name__ == "__main__":
    main()
