"""Online runs over ROS 2, and how arms stop when something fails.

    python benchmarks/streams.py                     # ROS 2 Kilted: 10 runs of a minute, every fault twice
    python benchmarks/streams.py --ros jazzy --runs 0 --repeats 20
    python benchmarks/streams.py --one-controller --runs 5 --repeats 0

Runs: two UR10 in MuJoCo (`comove simulate --ros 2`) wait with a bar until a gate has slid aside, and set it down
behind; `comove run --ros 2` commands them at 250 Hz and gets its place from a topic. Instants at which the gate
opens, and seeds, are drawn. Columns: seconds that the run took; stops that were not commanded; time between commands,
median, 99.9 % and most; from the gate's measurement until a command is played that knows it, median and 99.9 %;
contacts of the simulator; largest force inside the payload. Two controllers get their commands at slightly different
instants; one of both arms gets them at once.

Faults: while commands move a robot that is where they say (`tests/ros/ros2_sink.py`), something fails. Columns: time
until the last command that moves an arm, median and most; between both arms; change of the hands' distance; how often
an arm moved later, which must be 0. Instants are by the system's monotonic clock.

Needs ROS (`make ros2-wheels`). The load of the machine is printed, since other work on it delays commands as well.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

import numpy as np
import yaml
from timing import number, print_table

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from comove.robots import find_description  # noqa: E402
from tests.ros.robots import JAZZY, KILTED, Ros, may_have_hosts  # noqa: E402
from tests.ros.streaming import (  # noqa: E402
    CUT,
    FAULTS,
    OBSTACLES,
    Rest,
    planned,
    rest_after,
    running,
    standing,
    wait_until_it_moves,
)

GATE = ROOT / "examples" / "robots" / "sliding_gate.yaml"
REST = 2.5  # s, in which the arms must have come to rest for good


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--ros", choices=("kilted", "jazzy"), default="kilted")
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=60.0, help="duration of the scenes [s]")
    parser.add_argument("--one-controller", action="store_true", help="of both arms, in the runs")
    parser.add_argument("--repeats", type=int, default=2, help="of every fault")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    ros = {"kilted": KILTED, "jazzy": JAZZY}[options.ros]
    print(f"{ros.name}; {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n")
    with ros.network() as environment, tempfile.TemporaryDirectory() as folder:
        os.environ.update(environment)
        if options.runs:
            rng = np.random.default_rng(options.seed)
            robot = with_one_controller(Path(folder)) if options.one_controller else None
            rows = [run_once(ros, Path(folder), rng, options.seconds, k, robot) for k in range(options.runs)]
            print_table(
                [
                    "run",
                    "arrived",
                    "took [s]",
                    "stops",
                    "period [ms]: median, 99.9 %, most",
                    "gate to command [ms]",
                    "contacts",
                    "force [N]",
                ],
                rows,
            )
        if options.repeats:
            scene, plan, motion = planned(Path(folder))
            rows = []
            for fault in FAULTS:
                rests = list[Rest]()
                if fault == CUT and not may_have_hosts():
                    print(
                        f"{fault}: not tried, since this host may make no network namespaces (iproute2, as root)"
                    )
                    continue
                for k in range(options.repeats):
                    out = Path(folder) / f"{fault} {k}"
                    with (
                        standing(ros, motion, fault) as sink,
                        running(ros, scene, plan, out, ["--obstacles", OBSTACLES]) as process,
                    ):
                        wait_until_it_moves(sink, process)
                        at = time.monotonic()
                        FAULTS[fault](process, sink)
                        time.sleep(REST)
                        rests.append(rest_after(sink, motion, at, at + REST))
                after = [1e3 * rest.after for rest in rests]
                rows.append(
                    [
                        fault,
                        str(len(rests)),
                        f"{number(median(after))}, {number(max(after))}",
                        number(1e3 * max(rest.apart for rest in rests)),
                        number(1e3 * max(rest.torn for rest in rests)),
                        str(sum(rest.moved_on for rest in rests)),
                    ]
                )
                print("; ".join(rows[-1]), file=sys.stderr, flush=True)
            print()
            print_table(
                ["fault", "runs", "at rest after [ms]", "arms apart [ms]", "hands torn [mm]", "moved on"],
                rows,
            )


def with_one_controller(folder: Path) -> Path:
    """Write a description of the scene's robot with one controller of both arms; return its file."""
    robot = yaml.safe_load(GATE.read_text(encoding="utf-8"))["robot"]
    data = yaml.safe_load(find_description(robot).read_text(encoding="utf-8"))
    path = folder / "one_controller.yaml"
    path.write_text(yaml.safe_dump({**data, "ros": {"commands": "/both_position_controller/commands"}}))
    return path


def run_once(
    ros: Ros, folder: Path, rng: np.random.Generator, seconds: float, k: int, robot_file: Path | None
) -> list[str]:
    """Run one scene, with a robot of its own where one is given; return its row."""
    data = yaml.safe_load(GATE.read_text(encoding="utf-8"))
    data |= {} if robot_file is None else {"robot": str(robot_file)}
    opens = float(rng.uniform(0.55, 0.7)) * seconds
    gate = data["obstacles"][0]["motion"]
    gate["times"] = [0.0, opens, opens + 4.0]
    scene, plan, out = folder / f"gate{k}.yaml", folder / f"gate{k}", folder / f"gate{k}-run"
    scene.write_text(yaml.safe_dump({**data, "duration": seconds}))
    python, seed = [sys.executable, "-m", "comove"], str(int(rng.integers(2**31)))
    words = ["solve", str(scene), "--out", str(plan), "--no-pictures", "--seed", seed]
    subprocess.run([*python, *words], check=True, capture_output=True)
    environment = {**os.environ, "COMOVE_ROS_PYTHON": ros.python, "PYTHONUNBUFFERED": "1"}
    robot = subprocess.Popen(
        [*python, "simulate", str(plan), "--ros", "2"], env=environment, stdout=subprocess.PIPE, text=True
    )
    while "ready" not in robot.stdout.readline():
        pass
    with running(
        ros, scene, plan, out, ["--obstacles", "/obstacles", "--budget", str(seconds), "--seed", seed]
    ) as run:
        run.communicate()
    robot.send_signal(signal.SIGINT)
    said, _ = robot.communicate()
    summary = json.loads((out / "robot_run.json").read_text(encoding="utf-8"))
    ms = summary["timing_ms"]
    force = re.search(r"force inside the load +(.*?) N", said)
    contacts = re.search(r"contacts +(.*)", said)
    return [
        str(k),
        str(summary["arrived"]),
        number(summary["duration_s"]),
        str(len(summary["stops"])),
        ", ".join(number(ms[f"period_{q}"]) for q in ("p50", "p999", "most")),
        ", ".join(number(ms[f"latency_{q}"]) for q in ("p50", "p999")),
        contacts[1].strip() if contacts else "?",
        force[1] if force else "?",
    ]


if __name__ == "__main__":
    main()
