"""Robot run of the comparison, from the scene to MuJoCo's delivery."""

from __future__ import annotations

import numpy as np

from comove.arrays import Array
from comove.data.carried import robot_of
from comove.lab.systems import SystemOutcome, SystemProblem, with_figures
from comove.planning import SceneKind
from comove.planning.clock import now
from comove.robots import RobotCarrier, VerifiedJointMotion
from comove.robots.kernels import load_robot_kernels
from comove.sim import Execution, Friction, Perturbation, Weld, simulate
from comove.solving import solve


def carried(problem: SystemProblem) -> SystemOutcome:
    """Move the payload by comove's method for robots. The joints are played in MuJoCo (see `executed`); it counts as
    verified if the payload is delivered too."""
    scene, robot = problem.scene, robot_of(problem.scene)
    load_robot_kernels(SceneKind.of(scene))
    _ = RobotCarrier(robot, scene.alternatives[0]).arms  # what belongs to the robot is not a search's
    begun, found = now(), list[tuple[float, VerifiedJointMotion]]()
    solution = solve(
        scene,
        robot=robot,
        demonstration=problem.demonstration,
        seed=problem.seed,
        budget=problem.budget,
        found=lambda motion: found.append((now() - begun, motion)),
    )
    seconds, joints = now() - begun, solution.joints
    execution = None
    if joints.motion is not None:
        execution = executed(joints.motion, problem.seed)
    reasons = solution.reasons or joints.verdict.reasons if execution is None else execution.reasons
    outcome = SystemOutcome(
        verified=execution is not None and execution.delivered,
        reasons=tuple(reasons),
        seconds=seconds,
        acceleration_max=solution.report.acceleration_max,
        distance_error_max=joints.report.distance_error_max,
        clearance_min=min(
            solution.report.clearance_min,
            joints.report.clearance_scene,
            joints.report.clearance_load,
            joints.report.clearance_self,
        ),
    )

    def hands(motion: VerifiedJointMotion) -> Array:
        return motion.motion.motion.hands(problem.instants)[0]

    last = solution.attempt.hands(problem.instants)[0]
    timed = solution.scene  # which has a duration where the problem leaves it open
    return with_figures(outcome, timed, last, [(at, hands(motion)) for at, motion in found])


def executed(motion: VerifiedJointMotion, seed: int) -> Execution:
    """Simulate a verified motion with a perturbation of scene and seed. The payload is held by friction where all
    arms have fingers, and is welded to the end effectors otherwise."""
    scene, robot = motion.scene, motion.robot
    grasp = Friction() if all(robot.arm(name).fingers for name in scene.manipulators) else Weld()
    drawn = Perturbation.drawn(
        np.random.default_rng([seed, int(scene.sha256[:8], 16)]), len(robot.joint_names)
    )
    return simulate(motion.joints, scene, robot, grasp, drawn)
