"""Log of the quantities that are measured while a simulation runs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.simulators.engine import engine
from comove.simulators.servos import motor_weight
from comove.simulators.world import World

Array = NDArray[np.float64]


class Log:
    """Samples of the measured quantities, in arrays allocated in advance."""

    def __init__(self, world: World, n_steps: int):
        self.world, self.count = world, 0
        model, holders = world.model, len(world.holder_sites)
        self.finger_qpos = [model.joint(f).qposadr[0] for hand in world.fingers for f in hand]
        self.hand_of_equality = np.full(model.neq, -1)
        for i, name in enumerate(world.holder_names):
            equality = engine().mj_name2id(model, engine().mjtObj.mjOBJ_EQUALITY, f"grasp {name}")
            if equality >= 0:
                self.hand_of_equality[equality] = i
        self.joints = np.empty((n_steps, len(world.qpos)))
        self.torque = np.empty((n_steps, len(world.qpos)))
        self.fingers = np.empty((n_steps, len(self.finger_qpos)))
        self.hands = np.zeros((n_steps, len(world.sites), 4, 4))
        self.load_pose = np.full((n_steps, 4, 4), 0.0 if world.load is not None else np.nan)
        self.wrench = np.zeros((n_steps, holders, 6))
        self.hands[..., 3, 3] = 1.0

    def write_state(self, data: Any) -> None:
        """Log the state, which a step overwrites."""
        self.joints[self.count] = data.qpos[self.world.qpos]
        self.fingers[self.count] = data.qpos[self.finger_qpos]

    def write_rest(self, data: Any) -> None:
        """Log the other quantities of the same instant, after the step."""
        world, i = self.world, self.count
        self.torque[i] = data.qfrc_actuator[world.dofs] + motor_weight(world, data)
        self.hands[i, :, :3, 3] = data.site_xpos[world.sites]
        self.hands[i, :, :3, :3] = data.site_xmat[world.sites].reshape(-1, 3, 3)
        if world.load is not None:
            self.load_pose[i, 3, 3] = 1.0
            self.load_pose[i, :3, 3] = data.xpos[world.load_body]
            self.load_pose[i, :3, :3] = data.xmat[world.load_body].reshape(3, 3)
            self._write_wrenches(data)
        self.count += 1

    def _write_wrenches(self, data: Any) -> None:
        """Sum the constraints' forces on the load by hand, and log them as wrenches.

        The columns of the constraints' Jacobian for a free body give the force in the world's axes and the torque
        about its origin in the body's axes.
        """
        world, n_dofs = self.world, self.world.model.nv
        if not data.nefc:
            return
        rows = data.efc_J.reshape(data.nefc, n_dofs)[:, world.load_dof : world.load_dof + 6]
        hand = self._hand_of_rows(data)
        by_hand = (hand[None, :] == np.arange(len(world.holder_sites))[:, None]) * data.efc_force
        wrench = by_hand @ rows
        turned = data.xmat[world.load_body].reshape(3, 3)
        arms = data.site_xpos[world.holder_sites] - data.xpos[world.load_body]
        self.wrench[self.count, :, :3] = wrench[:, :3]
        self.wrench[self.count, :, 3:] = wrench[:, 3:] @ turned.T - np.cross(arms, wrench[:, :3])

    def _hand_of_rows(self, data: Any) -> NDArray[np.int64]:
        """Return the number of the holder that each row of the constraints belongs to, -1 for none; array, shape
        (n_rows,).
        """
        kinds = engine().mjtConstraint
        hand = np.full(data.nefc, -1)
        equality = data.efc_type == int(kinds.mjCNSTR_EQUALITY)
        hand[equality] = self.hand_of_equality[data.efc_id[equality]]
        touching = data.efc_type >= int(kinds.mjCNSTR_CONTACT_FRICTIONLESS)
        if touching.any():
            pairs = data.contact.geom
            hand[touching] = self.world.hand_of_geom[pairs].max(axis=1)[data.efc_id[touching]]
        return hand

    def forget_broken(self) -> None:
        """Drop all samples from the first one with a value that is not finite, but keep one at least."""
        broken = ~np.isfinite(self.hands[: self.count]).all(axis=(1, 2, 3))
        broken |= ~np.isfinite(self.joints[: self.count]).all(axis=1)
        if self.world.load is not None:
            broken |= ~np.isfinite(self.load_pose[: self.count]).all(axis=(1, 2))
        if broken.any():
            self.count = max(1, int(broken.argmax()))

    def series(self) -> dict[str, Array]:
        """Return the logged series, by the names of `Execution`."""
        names = ("joints", "torque", "hands", "load_pose", "wrench", "fingers")
        return {name: getattr(self, name)[: self.count] for name in names}
