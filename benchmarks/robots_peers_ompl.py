"""OMPL with Pinocchio and coal: KPIECE on the grasp manifold.

The end effectors hold the payload level. OMPL reaches the manifold by projection: steps of Newton's method on the
error of the second end effector in the first, and on the tilt of the first. States, errors and contacts are computed
in Python, as for any of its users. The path is shortened by OMPL, and timed by TOPP-RA (`toppra`).

RRT-Connect, which interpolates towards states sampled in the whole space, finds no path along this manifold to most
of them: its trees did not grow. KPIECE samples near the states that it has. It and its range were chosen on the
first ten scenes of `robots-hard`.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import ompl.base as ob
import ompl.geometric as og
import ompl.util as ou
import pinocchio as pin
import toppra
from numpy.typing import NDArray
from robots_peers_terms import BUDGET, EACH, N_SAMPLES, Outcome, Terms
from toppra.algorithm import TOPPRA
from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint

Array = NDArray[np.float64]

N_EQUATIONS = 9
DELTA = 0.05  # rad, between states that are checked along a motion
RANGE = 0.3  # rad, of a motion that the tree grows by
HELD = 1e-4  # m and rad, the norm of errors within which a state is on the manifold
STEPS = 20  # of Newton's method
SIMPLIFYING = 1.0  # s, at most


class Held(ob.Constraint):  # type: ignore[misc, name-defined]
    """Constraint of two end effectors on a level payload. Six equations hold the second end effector in the first as
    at the start, two keep the payload level, and one is the distance of both outside their workspace, so that
    projections return to it."""

    def __init__(self, terms: Terms, start: Array):
        super().__init__(len(terms.columns), N_EQUATIONS, HELD)
        self.terms, self.model = terms, terms.robot.model
        self.data, self.q = self.model.createData(), start.copy()
        self.frames = [self.model.getFrameId(arm.tip) for arm in terms.arms]
        self.tools = [pin.SE3(arm.tool) for arm in terms.arms]
        first, second = self._hands(start[terms.columns])
        self.apart = second.actInv(first)  # of the first in the second, as it is held
        self.up = first.rotation.T[:, 2]  # in the first hand

    def _hands(self, x: Array) -> list[Any]:
        self.q[self.terms.columns] = x
        pin.computeJointJacobians(self.model, self.data, self.q)
        pin.updateFramePlacements(self.model, self.data)
        return [self.data.oMf[frame] * tool for frame, tool in zip(self.frames, self.tools, strict=True)]

    def function(self, x: Array, out: Array) -> None:
        """Write the errors of the end effectors [m, rad]."""
        first, second = self._hands(x)
        out[:6] = pin.log6(self.apart * first.actInv(second)).vector
        out[6:8] = (first.rotation @ self.up)[:2]
        out[8] = np.linalg.norm(self._outside(first, second))

    def _outside(self, first: Any, second: Any) -> Array:
        """Return the end effectors' distances outside their workspace [m]. Array, shape (2, 3)."""
        at = np.stack([first.translation, second.translation])
        return np.maximum(at - self.terms.upper, 0.0) + np.minimum(at - self.terms.lower, 0.0)

    def jacobian(self, x: Array, out: Array) -> None:
        """Write the derivatives of the errors by the joints, shape (9, n)."""
        first, second = self._hands(x)
        local = []
        for frame, tool in zip(self.frames, self.tools, strict=True):
            whole = pin.getFrameJacobian(self.model, self.data, frame, pin.ReferenceFrame.LOCAL)
            local.append(tool.toActionMatrixInverse() @ whole[:, self.terms.columns])
        between = first.actInv(second)
        moved = local[1] - between.toActionMatrixInverse() @ local[0]
        out[:6] = pin.Jlog6(self.apart * between) @ moved
        out[6:8] = -(pin.skew(first.rotation @ self.up) @ first.rotation @ local[0][3:])[:2]
        beyond = self._outside(first, second)
        along = beyond / max(np.linalg.norm(beyond), 1e-12)
        out[8] = along[0] @ first.rotation @ local[0][:3] + along[1] @ second.rotation @ local[1][:3]

    def project(self, x: Array) -> bool:
        """Move joints onto the manifold in place; return whether they reached it."""
        errors, slopes = np.empty(N_EQUATIONS), np.empty((N_EQUATIONS, len(x)))
        for _ in range(STEPS):
            self.function(x, errors)
            if np.linalg.norm(errors) < HELD:
                return True
            self.jacobian(x, slopes)
            x -= slopes.T @ np.linalg.solve(slopes @ slopes.T + 1e-9 * np.eye(N_EQUATIONS), errors)
        return False


class Planning:
    """OMPL's planner between two ends."""

    def __init__(self, terms: Terms, first: Array, last: Array):
        self.terms, self.q, columns = terms, first.copy(), terms.columns
        self.lower, self.upper = terms.robot.lower[columns], terms.robot.upper[columns]
        self.on_hand = terms.load_on_hand(first)
        ambient, bounds = ob.RealVectorStateSpace(len(columns)), ob.RealVectorBounds(len(columns))
        for axis, (low, high) in enumerate(zip(self.lower.tolist(), self.upper.tolist(), strict=True)):
            bounds.setLow(axis, low)
            bounds.setHigh(axis, high)
        ambient.setBounds(bounds)
        self.constraint = Held(terms, first)
        space = ob.ProjectedStateSpace(ambient, self.constraint)
        self.information = ob.ConstrainedSpaceInformation(space)
        space.setDelta(DELTA)
        self.information.setStateValidityChecker(lambda state: self.is_free(self.read(state)))
        self.information.setup()
        ends = [space.allocState(), space.allocState()]
        for state, q in zip(ends, (first, last), strict=True):
            state.copy(q[columns])
        self.wanted = ob.ProblemDefinition(self.information)
        self.wanted.setStartAndGoalStates(*ends)
        self.planner = og.KPIECE1(self.information)
        self.planner.setProblemDefinition(self.wanted)
        self.planner.setRange(RANGE)
        self.planner.setup()

    def read(self, state: Any) -> Array:
        """Convert a state of OMPL to an array, shape (n,)."""
        return np.array([state[i] for i in range(len(self.lower))])

    def is_free(self, x: Array) -> bool:
        """Return whether joints are within limits, workspace and clearances."""
        if (x < self.lower).any() or (x > self.upper).any():
            return False
        self.q[self.terms.columns] = x
        robot, arms = self.terms.robot, self.terms.arms
        hands = robot.tool_poses(self.q[None], arms)[0]
        inside = (hands[:, :3, 3] >= self.terms.lower).all() and (hands[:, :3, 3] <= self.terms.upper).all()
        return bool(inside) and not self.terms.contacts.touch(self.q, (hands[0] @ self.on_hand)[:3].T)

    def solve(self, seconds: float) -> bool:
        """Plan for at most `seconds` of processor time; return success."""
        until = time.process_time() + seconds
        self.planner.solve(ob.PlannerTerminationCondition(lambda: time.process_time() > until))
        return bool(self.wanted.hasExactSolution())

    def path(self) -> Array:
        """Return the current path, interpolated along the manifold. Array, shape (n_states, n)."""
        path = og.PathGeometric(self.wanted.getSolutionPath())
        path.interpolate()
        return np.array([self.read(state) for state in path.getStates()])

    def simplify(self) -> None:
        """Shorten the current path."""
        og.PathSimplifier(self.information).simplify(self.wanted.getSolutionPath(), SIMPLIFYING)


def timed(terms: Terms, path: Array) -> Array:
    """Return a path at even times by TOPP-RA; array, shape (N_SAMPLES, n)."""
    robot, columns = terms.robot, terms.columns
    path = path[np.append(True, np.linalg.norm(np.diff(path, axis=0), axis=1) > 1e-9)]
    at = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    limits = [
        JointVelocityConstraint(robot.velocity[columns]),
        JointAccelerationConstraint(robot.acceleration[columns]),
    ]
    found = TOPPRA(limits, toppra.SplineInterpolator(at, path)).compute_trajectory()
    return found(np.linspace(0.0, found.duration, N_SAMPLES))


def by_ompl(terms: Terms, seed: int) -> Outcome:
    """Solve a scene with OMPL."""
    ou.setLogLevel(ou.LOG_NONE)
    ou.RNG.setSeed(seed + 1)
    _ = terms.contacts  # of the robot, and not of a search
    begun = time.process_time()
    for first, last in terms.ends:
        if time.process_time() - begun > BUDGET:
            break
        planning = Planning(terms, first, last)
        if planning.solve(EACH):
            done = time.process_time() - begun
            planning.simplify()
            joints = np.tile(first, (N_SAMPLES, 1))
            joints[:, terms.columns] = timed(terms, planning.path())
            return Outcome(joints, done, time.process_time() - begun)
    return Outcome(None, np.nan, time.process_time() - begun)
