"""Commanded joints of arms that hold a payload, step by step."""

from __future__ import annotations

import numpy as np

from comove.arrays import Array
from comove.control.safety.cbf_qp import JointState
from comove.control.safety.twists import advanced, nodes_of
from comove.model.coordinates import HandPoses
from comove.robots.carrying import RobotCarrier
from comove.robots.motion import approach_shares
from comove.robots.online.arm_rows import ArmRows
from comove.robots.search.chains import Iteration
from comove.robots.search.tracking import tracked

SHARES = (1.0, 0.9, 0.75, 0.5, 0.25, 0.0)  # of a twist, tried in turn
HOLDING = Iteration(gain=0.0, keep=0.0, tolerance=1e-10, steady=np.inf, most=30)
"""Iteration for the next command: redundant joints stay where the safety filter has taken them."""


class HoldingArms:
    """Arms that hold a payload: their commands, which keep the grasps to rounding.

    Parameters
    ----------
    carrier : the robot with the payload
    rows : rows of its arms in the safety filter
    position : array, shape (n_joints,), joints of the robot at the start [rad]

    Attributes
    ----------
    position : array, shape (n_joints,), the joints commanded last, those that do not move included [rad]
    rates : array, shape (n_arm_joints,), rates of the arms' joints in the last period [rad/s]
    columns : their places in `position`
    """

    def __init__(self, carrier: RobotCarrier, rows: ArmRows, position: Array):
        self.carrier, self.rows, self.position = carrier, rows, position.copy()
        self.columns = np.concatenate([arm.columns for arm in carrier.holders])
        self.rest(self.joints)

    @property
    def joints(self) -> Array:
        """Return the commanded joints of the arms; array, shape (n_arm_joints,) [rad]."""
        return self.position[self.columns]

    def rest(self, joints: Array) -> None:
        """Rest at joints of the arms."""
        self.rates, self._bend = np.zeros(len(self.columns)), np.zeros(len(self.columns))
        self.position[self.columns] = joints

    def hold(self, poses: HandPoses) -> bool:
        """Rest where the payload has some poses; return whether the arms can."""
        (solved,), missed = self._solved(poses, self.joints)
        can = bool(missed.max() <= HOLDING.tolerance)
        if can:
            self.rest(solved)
        return can

    def state(self, drawn: Array) -> JointState:
        """Return the state for the safety filter, with desired rates."""
        return JointState(self.joints, self.rates, drawn, self._bend)

    def advance(self, poses: HandPoses, twists: Array, rates: Array) -> HandPoses | None:
        """Move for a period by the largest feasible share of a twist.

        Parameters
        ----------
        poses : poses of the payload
        twists : array, shape (n_groups, 6), its desired twists [m/s, rad/s]
        rates : array, shape (n_arm_joints,), joint rates that belong to them [rad/s]

        Returns
        -------
        its poses after the period; None where no share of the twist can be held: then all stands
        """
        chains, period, joints = self.rows.arms.chains, self.rows.period, self.joints
        soft = chains.approach, chains.lower, chains.upper
        reached, following, roughest = None, joints, np.inf
        for share in SHARES:
            there = advanced(poses, share * twists, period)
            (solved,), missed = self._solved(there, joints + share * period * rates)
            moved = (solved - joints) / period
            rough = float((np.abs(moved - self.rates) / (chains.acceleration * period)).max())
            if (
                missed.max() <= HOLDING.tolerance
                and (np.abs(moved) <= chains.velocity).all()
                and (approach_shares(solved, moved, *soft) <= 1.0).all()
                and rough < roughest
            ):
                reached, following, roughest = there, solved, rough
                if share == 1.0:
                    self._bend = moved - rates  # of the way that joints go in a step
            if roughest <= 1.0:
                break
        self.rates = (following - joints) / period
        self.position[self.columns] = following
        return reached

    def _solved(self, poses: HandPoses, guess: Array) -> tuple[Array, Array]:
        return tracked(self.rows.arms, nodes_of(self.rows.scene, poses)[None], guess[None], HOLDING)
