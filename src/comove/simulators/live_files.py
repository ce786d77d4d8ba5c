"""The files of an online run of a robot: `robot_run.json` and `robot_run.npz`.

The arrays are, after every control step, `time` (n_steps,) [s], `commanded` and `measured` (n_steps, n_joints) [rad],
`nodes` (n_steps, n_nodes, 3), hands and corners of the load as commanded [m], `load_pose` (n_steps, 4, 4), the load
in the simulator, `driven_off` (n_steps,), whether the robot gave way to what had driven it off, and `obstacle_center`
(n_steps, n_obstacles, 3) [m].
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np

from comove._version import __version__
from comove.results.sealed import ResultKind, Summary, finite
from comove.robots.online.executor import OnlineLog
from comove.simulators.live_record import OnlineRecord, OnlineReport

ROBOT_RUN = ResultKind(
    summary="robot_run.json",
    arrays="robot_run.npz",
    checksum="motion_sha256",
    made_by="comove robot run SCENE --out DIR",
    hint="run it again",
    required=("time", "commanded", "measured", "nodes", "load_pose", "obstacle_center"),
    unsealed=("planning_s", "control_s_median", "control_s_p999", "wall_time_s"),
)


def write_robot_run(
    folder: Path,
    record: OnlineRecord,
    report: OnlineReport,
    log: OnlineLog,
    *,
    seed: int,
    wall_time_s: float,
) -> Summary:
    """Write both files into an existing folder, and return the summary."""
    measures = {
        name: finite(value) if isinstance(value, float) else value for name, value in vars(report).items()
    }
    del measures["reasons"]
    summary = {
        "as_it_should_be": not report.reasons,
        "arrived": record.arrived,
        "interrupted": record.interrupted,
        "reasons": list(report.reasons),
        "scene": record.scene.name,
        "scene_sha256": record.scene.sha256,
        "robot": record.robot.name,
        "robot_sha256": record.robot.sha256,
        "seed": seed,
        "version": __version__,
        "period_s": record.period,
        **measures,
        "relaxed_max": log.relaxed,
        "stopped_steps": log.stopped,
        "contacts": [asdict(contact) for contact in record.contacts],
        "plans": len(log.planning),
        "planning_s": [float(seconds) for seconds in log.planning],
        "control_s_median": float(np.median(log.control)),
        "control_s_p999": float(np.quantile(log.control, 0.999)),
        "wall_time_s": wall_time_s,
        "blocking": {str(obstacle): steps for obstacle, steps in sorted(log.blocking.items())},
        "events": [{"time": event.time, "what": event.what} for event in log.events],
    }
    arrays = {
        "time": np.array(record.time),
        "commanded": np.array(record.commanded),
        "measured": np.array(record.measured),
        "nodes": np.array(record.nodes),
        "load_pose": np.array(record.load),
        "driven_off": np.array(record.driven_off),
        "obstacle_center": np.array(record.obstacles),
    }
    return ROBOT_RUN.write(folder, summary, arrays)
