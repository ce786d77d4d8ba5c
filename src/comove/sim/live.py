"""Online runs in MuJoCo: servos track step-by-step commands from measured joints."""

from __future__ import annotations

from typing import Any

import numpy as np

from comove.errors import OptionError, RobotError
from comove.planning.search import Interruption
from comove.processes import one_blas_thread
from comove.robots.online.executor import JointExecutor
from comove.sim.building import TIMESTEP, build_world
from comove.sim.dynamics import at_start, broken, contacts_of, note_contacts
from comove.sim.engine import engine, without_log
from comove.sim.grasps import GraspModel, Weld
from comove.sim.live_record import OnlineRecord
from comove.sim.loads import hand_poses, load_of
from comove.sim.servos import PayloadTorques, carry_payload, limit_servos
from comove.sim.settings import PLAN, USUAL, Perturbation
from comove.sim.world import SimulatedWorld, move_obstacles


def steps_of(period: float) -> int:
    """Return the number of simulation steps in a control period [s].

    Raises
    ------
    OptionError
        If it is no whole number.
    """
    every = round(period / TIMESTEP)
    if every < 1 or abs(every * TIMESTEP - period) > 1e-9:
        raise OptionError(
            f"a control period of {period} s",
            key="period",
            way_out=f"give a multiple of {TIMESTEP} s, the simulation's step",
        )
    return every


@one_blas_thread()
def run_live(
    executor: JointExecutor,
    budget: float,
    grasp: GraspModel | None = None,
    perturbation: Perturbation | None = None,
) -> OnlineRecord:
    """Run a robot in MuJoCo until its payload arrives.

    The run lasts `budget` [s] of simulated time at most. The executor gets the measured joints at every control
    step; the servos get its commands, interpolated between control steps. Obstacles are at the true positions of the
    executor's observer. Simulated time pauses while a plan is computed: by then the robot is at rest.

    Parameters
    ----------
    grasp : model of the grasp of the payload; `Weld()` unless given
    perturbation : deviations from the plan; none unless given. A push is not applied here

    Raises
    ------
    ExtraError
        If MuJoCo is not installed.
    OptionError
        If the control period is not a multiple of the simulation's step.
    RobotError, SceneError
        If the robot cannot hold the payload by this grasp.
    """
    grasp, perturbation = grasp or Weld(), perturbation or PLAN
    every = steps_of(executor.settings.period)
    scene, robot, motion = executor.scene, executor.robot, executor.plan.joints
    load = load_of(scene, hand_poses(robot, scene, motion.position[:1])[0], grasp.section)
    with without_log():
        world = build_world(robot, scene, load, grasp, perturbation)
        payload = PayloadTorques(robot, scene)
        data = at_start(world, motion, payload, perturbation)
        _move_obstacles(data, executor)
        if load is not None:
            grasp.close(world, data)
        engine().mj_step(world.model, data, round(USUAL.settle / TIMESTEP))
        return _run(world, data, executor, payload, budget, every)


def _run(
    world: SimulatedWorld,
    data: Any,
    executor: JointExecutor,
    payload: PayloadTorques,
    budget: float,
    every: int,
) -> OnlineRecord:
    mj, interruption, given_up = engine(), Interruption(), ""
    record = OnlineRecord(executor.scene, executor.robot)
    contacts: dict[tuple[int, int], tuple[float, float]] = {}
    with interruption.noticed():
        while executor.time < budget - 1e-9 and not interruption.wished:
            before = executor.position.copy()
            try:
                command = executor.command(data.qpos[world.qpos])
            except RobotError as error:  # something holds the robot
                given_up = error.message
                break
            _move_obstacles(data, executor)
            carry_payload(world, data, payload.at_rest(command))
            limit_servos(world, data)
            rates = (command - before) / executor.settings.period
            if executor.driven_off:  # what gives way brakes: its commands go where the robot goes
                rates *= 0.0
            for part in range(every):
                reference = before + (part + 1) / every * (command - before)
                data.ctrl[world.servos] = reference + world.lead * rates
                mj.mj_step(world.model, data)
                if data.ncon:
                    note_contacts(world, data, executor.scene, executor.time, contacts)
            record.add(executor, data.qpos[world.qpos], world.load_pose(data))
            if broken(data) or executor.arrived:
                break
    record.contacts, record.given_up = contacts_of(world, contacts), given_up
    record.arrived, record.unstable = executor.arrived, broken(data)
    record.interrupted = interruption.wished
    return record


def _move_obstacles(data: Any, executor: JointExecutor) -> None:
    centers = executor.observer.ground_truth(np.array([executor.time]))[0]
    move_obstacles(data, executor.scene, executor.time, centers)
