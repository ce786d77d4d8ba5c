"""An online run of Baxter's in which everything goes as planned, in milliseconds and without a simulator."""

import numpy as np

from comove.control.loop import ExecutionLog
from comove.io.folders import whole_folder
from comove.results import RESULT
from comove.sim.live_record import OnlineRecord, judge_run
from comove.sim.loads import carried, hand_poses, load_of
from comove.sim.robot_runs import write_robot_run
from tests.robots.known_carry import baxter, known_carry


def write_known_run(folder, period=0.02):
    """The folder of the run."""
    motion, joints = known_carry()
    scene, robot = motion.scene, baxter()
    time = period * np.arange(1, round(joints.duration / period) + 1)
    commanded = joints.at(time)[0]
    hands = hand_poses(robot, scene, commanded)
    nodes = motion.coordinates.nodes(np.ascontiguousarray(motion.at(time / joints.duration)[0].T[None]))[0]
    load = load_of(scene, hands[0])
    held = hands[:, list(load.holders)]
    record = OnlineRecord(
        scene,
        robot,
        list(time),
        list(commanded),
        list(commanded),
        list(nodes),
        list(carried(held, np.linalg.inv(held[0]) @ load.pose)),
        [False] * len(time),
        list(np.tile(scene.centers, (len(time), 1, 1))),
        arrived=True,
    )
    report = judge_run(record)
    log = ExecutionLog(control=[0.001] * len(time))
    with whole_folder(folder, RESULT) as draft:
        write_robot_run(draft, record, report, log, seed=0, wall_time_s=1.0)
    return folder
