"""Acceleration and jerk of robots' joints, beside TOPP-RA (toppra).

    pip install 'comove[bench]'
    python benchmarks/robots_pacing.py                           # 5 scenes of `comove bench`, one for each robot
    python benchmarks/robots_pacing.py --set robots-extreme --scenes 20

Every scene is solved twice: in its duration, and as fast as end effectors and joints can. The joints' path of the
second motion is then timed by TOPP-RA, with the joints' limits of velocity and acceleration; end effectors' limits,
torques and the law of motion are comove's alone, so it may be slower. Acceleration and jerk are root mean squares
over all joints that move, for unit duration, so that pace does not count; the jerk's largest value is at the motion's
own pace, from 20,000 samples.
"""

from __future__ import annotations

import argparse
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray
from timing import by_toppra, number, on_one_thread, peer, print_table

from comove import LeastTime, solve
from comove.lab.bench.sets import scenes_of
from comove.robots import Robot

Array = NDArray[np.float64]

N_PATH, N_SEEN = 2001, 20_001
SEEN = ("duration [s]", "acceleration", "jerk", "largest jerk [rad/s³]")


def main() -> None:
    """Print one row for each system."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--set", default="robots-hard", help="robots-easy, robots-hard or robots-extreme")
    parser.add_argument("--scenes", type=int, default=5)
    asked = parser.parse_args()
    on_one_thread()
    warnings.simplefilter("ignore")
    peer("toppra")
    found: dict[str, list[tuple[float, ...]]] = {}
    for frozen in scenes_of(asked.set, asked.scenes):
        scene = frozen.load()
        robot = Robot.load(scene.file.robot)
        columns = np.concatenate([robot.arm(name).columns for name in scene.manipulators])
        fastest = None
        for name, objective in (("comove, in the duration", None), ("comove, in least time", LeastTime())):
            motion = solve(scene, robot=robot, objective=objective).joints.motion
            if motion is not None:
                found.setdefault(name, []).append(seen(motion.joints.curve, motion.joints.duration, columns))
                fastest = motion.joints if objective is not None else None
        if fastest is not None:
            position = fastest.curve(np.linspace(0.0, fastest.duration, N_PATH))[:, columns]
            timed = by_toppra(position, robot.velocity[columns], robot.acceleration[columns])()
            if timed is not None:
                own = seen(timed, timed.duration, np.arange(len(columns)))
                found.setdefault("TOPP-RA on the latter's path", []).append(own)
    rows = [
        [name, str(len(values)), *(number(np.median(column), 3) for column in zip(*values, strict=True))]
        for name, values in found.items()
    ]
    print_table(("", "motions", *SEEN), rows)


def seen(curve: Any, duration: float, columns: Array) -> tuple[float, ...]:
    """Return duration, unit-duration acceleration and jerk, and the largest jerk."""
    time = np.linspace(0.0, duration, N_SEEN)
    acceleration = curve(time, 2)[:, columns]
    jerk = np.diff(acceleration, axis=0) / time[1]
    sizes = (float(np.sqrt((x**2).mean())) for x in (acceleration * duration**2, jerk * duration**3))
    return (duration, *sizes, float(np.abs(jerk).max()))


if __name__ == "__main__":
    main()
