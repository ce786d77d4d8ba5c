"""Certified clearances of other robots than the known one, against dense sampling by Pinocchio and coal."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from comove.model import Scene
from comove.robots import JointMotion, Robot
from comove.robots.verification.bodies import bodies_of
from comove.robots.verification.carried import Carried
from comove.robots.verification.certificate import JointCertificateSettings, certify
from comove.robots.verification.kinematics import Bases

EXAMPLES = Path(__file__).parents[3] / "examples" / "robots"
ROUNDING = 2e-5  # m, of GJK and coal
TIGHT = JointCertificateSettings().tight


def least(bodies, carried, motion, rate):
    """Least distances of all exact pairs at even times, less what is taken, by kind."""
    exact = np.unique(bodies.exact)
    model, data, found = bodies.robot.model, bodies.robot.model.createData(), np.full(3, np.inf)
    for time in np.linspace(0.0, motion.duration, round(rate * motion.duration) + 1):
        placed = bodies.placed_at(carried.nodes(np.array([time]))[0], time)
        of = placed.geometry.createData()
        pin.updateGeometryPlacements(model, data, placed.geometry, of, motion.curve(time))
        for pair in exact.tolist():
            near = pin.computeDistance(placed.geometry, of, pair).min_distance - bodies.taken[pair]
            found[bodies.kind[pair]] = min(found[bodies.kind[pair]], near)
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "rate"),
    [
        *(("two_pandas", 50.0), ("two_ur10", 25.0), ("two_fr3", 50.0), ("sliding_gate", 25.0)),
        *(("tilted_board", 50.0), ("pr2", 25.0), ("g1", 3.0)),
    ],
)
def test_no_sample_is_nearer_than_certified(name, rate):
    """Joints wander about home while the load goes straight; what moves, tilts, or is no convex mesh counts."""
    scene = Scene.load(EXAMPLES / f"{name}.yaml").alternatives[0].timed(2.0)
    robot, rng = Robot.load(scene.file.robot), np.random.default_rng(7)
    carried = Carried.straight(scene)
    arms = tuple(robot.arm(arm) for arm in scene.manipulators)
    hands = carried.hands(carried.time).positions
    bodies = bodies_of(Bases(robot, robot.description.uncertainty), arms, carried, hands, 1e-5)
    for size in (0.05, 0.3):
        away = size * rng.uniform(-1.0, 1.0, (9, len(robot.home)))
        joints = np.clip(robot.home + away, robot.lower, robot.upper)
        motion = JointMotion(np.linspace(0.0, 2.0, 9), robot.joint_names, joints)
        sampled = least(bodies, carried, motion, rate)
        for slack in (0.0, 1.0):
            found = certify(bodies, carried, motion.curve, slack)
            for clearance, near, required in zip(found, sampled, bodies.required, strict=True):
                assert clearance.lower <= max(near, 0.0) + ROUNDING
                assert near > required or clearance.upper < required
                spread = clearance.upper - clearance.lower
                assert slack > 0.0 or clearance.upper < required or np.isinf(near) or spread <= TIGHT + 1e-12
