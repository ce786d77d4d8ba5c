"""Grippers of a simulated robot, and what holds its payload.

Before it is gripped, and after it was released at its start or goal, a fixture holds the payload: many scenes have
nothing for it to rest on. Released anywhere else, it falls. Grippers move at one speed from open to closed. With a
friction grasp these are the fingers; other grasps have no moving fingers: a closed gripper is then connected to the
payload, if it is at its grasp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from comove.model.scene import Scene
from comove.sim.building import TIMESTEP
from comove.sim.dynamics import move_grasp
from comove.sim.grasps import FingerTravel, GraspModel, hold_still, let_go
from comove.sim.loads import points_of
from comove.sim.world import SimulatedWorld

CLOSING = 0.5  # s, in which a gripper closes
RESTING = 1e-3  # m/s or rad/s, below which a finger rests
GRIPPING = 0.3  # s, in which fingers then gain their force
NEAR = 0.01  # m, by which a gripper may miss the payload's grasp, or the payload its place


@dataclass
class Gripper:
    """Gripper of an arm.

    Attributes
    ----------
    wanted, share : wanted and present share by which it is closed, from 0 to 1
    since : time at which it moved last [s]
    holds : whether it holds the payload
    settled : whether it has arrived, and holds the payload if it can
    """

    wanted: float
    share: float
    since: float = 0.0
    holds: bool = False
    settled: bool = True

    @property
    def closes(self) -> bool:
        """Return whether it is to be closed rather than open."""
        return self.wanted > 0.5


class Grippers:
    """Grippers of all arms of a simulated robot.

    Parameters
    ----------
    world, data : the simulated world and its state
    scene : scene with start and goal of the payload
    grasp : model of the grasp
    travel : travel of the fingers, None where none move
    closed : whether the grippers hold the payload at first; otherwise they are open, and a fixture holds it

    Attributes
    ----------
    by_arm : the grippers
    words : what they did, in words, until somebody clears it
    dropped : releases of the payload elsewhere than at its start and goal, in words
    """

    def __init__(
        self,
        world: SimulatedWorld,
        data: Any,
        scene: Scene,
        grasp: GraspModel,
        travel: FingerTravel | None,
        *,
        closed: bool,
    ):
        self._world, self._data, self._scene = world, data, scene
        self._grasp, self._travel = grasp, travel
        self._is_fixed = world.load is not None and not closed
        share, holders = float(closed), [holder.name for holder in world.holders]
        self.by_arm = {
            arm: Gripper(share, share, holds=closed and arm in holders) for arm in scene.manipulators
        }
        self.words, self.dropped = list[str](), list[str]()

    @property
    def all_hold(self) -> bool:
        """Return whether all holders hold the payload."""
        holders = self._world.holders
        return bool(holders) and all(self.by_arm[holder.name].holds for holder in holders)

    @property
    def carries(self) -> bool:
        """Return whether all hold the payload, and nothing else does."""
        return self.all_hold and not self._is_fixed

    def move(self, arm: str, share: float, effort: float = 0.0) -> None:
        """Close an arm's gripper by a share, with a largest effort [N]; 0 for its own."""
        gripper = self.by_arm[arm]
        gripper.wanted, gripper.settled = float(np.clip(share, 0.0, 1.0)), False
        if self._travel is not None and (own := self._fingers(arm)):
            force = np.minimum(effort if effort > 0.0 else np.inf, self._travel.force[own])
            self._world.model.actuator_forcerange[self._travel.servos[own]] = np.stack(
                [-force, force], axis=1
            )

    def closed_share(self, arm: str) -> float:
        """Return the share by which an arm's gripper is closed; of fingers that move, the measured one."""
        if self._travel is None or not (own := self._fingers(arm)):
            return self.by_arm[arm].share
        at = self._data.qpos[np.array(self._world.finger_qpos)[own]]
        opened, closed = self._travel.opened[own], self._travel.closed[own]
        return float(((at - opened) / (closed - opened)).mean())

    def is_done(self, arm: str, time: float) -> bool:
        """Return whether an arm's gripper is done; it then holds the payload if it can. `time` is in s."""
        gripper = self.by_arm[arm]
        gripping = GRIPPING if self._travel is not None and gripper.closes else 0.0
        return gripper.settled and time - gripper.since >= gripping

    def step(self, time: float) -> None:
        """Move the grippers for one time step from a time [s]."""
        most = TIMESTEP / CLOSING
        for arm, gripper in self.by_arm.items():
            if gripper.share == gripper.wanted:
                continue
            gripper.share += float(np.clip(gripper.wanted - gripper.share, -most, most))
            gripper.since = time
            if self._travel is not None and (own := self._fingers(arm)):
                self._data.ctrl[self._travel.servos[own]] = self._travel.at(gripper.share)[own]

    def look(self, time: float) -> None:
        """Connect and release grippers that have moved, at a time [s]."""
        for number, holder in enumerate(self._world.holders):
            gripper = self.by_arm[holder.name]
            if gripper.holds and not gripper.closes:
                if self.all_hold:
                    self._release(holder.name, time)
                gripper.holds = False
                self._grasp.hold(self._world, self._data, holder, holds=False)
                self._say(time, f"the gripper of '{holder.name}' opens")
            arrived = gripper.share == gripper.wanted
            if arrived and not gripper.settled and (not gripper.closes or self._is_there(number)):
                gripper.settled = True
                if gripper.closes and not gripper.holds:
                    self._close(number, time)
        for arm in self.by_arm.keys() - set(self._holders()):
            gripper = self.by_arm[arm]
            gripper.settled = gripper.share == gripper.wanted
        if self._is_fixed and self.all_hold and all(self.is_done(arm, time) for arm in self._holders()):
            let_go(self._world, self._data)
            self._is_fixed = False
            self._say(time, "all grippers hold the payload")

    def _holders(self) -> Sequence[str]:
        return [holder.name for holder in self._world.holders]

    def _fingers(self, arm: str) -> list[int]:
        """Return the numbers of an arm's fingers that move."""
        owners = [holder.name for holder in self._world.holders for _ in holder.fingers]
        return [i for i, owner in enumerate(owners) if owner == arm]

    def _say(self, time: float, text: str) -> None:
        self.words.append(f"{time:.2f} s: {text}")

    def _close(self, number: int, time: float) -> None:
        """Let a closed gripper hold the payload, if it is there."""
        holder = self._world.holders[number]
        gripper = self.by_arm[holder.name]
        apart = self._data.site_xpos[holder.site] - self._data.site_xpos[holder.held]
        off = float(np.linalg.norm(apart))
        gripper.holds = off <= NEAR if self._travel is None else self._touches(number)
        if gripper.holds:
            move_grasp(self._world, self._data, holder)
            self._grasp.hold(self._world, self._data, holder)
        what = "the payload" if gripper.holds else f"nothing: the payload's grasp is {1e3 * off:.0f} mm away"
        self._say(time, f"the gripper of '{holder.name}' has closed on {what}")

    def _is_there(self, number: int) -> bool:
        """Return whether closing fingers touch the payload or rest."""
        if self._travel is None or self._touches(number):
            return True
        fingers = self._world.holders[number].fingers
        speeds = [abs(self._data.qvel[self._world.model.joint(finger).dofadr[0]]) for finger in fingers]
        return max(speeds, default=0.0) < RESTING

    def _touches(self, number: int) -> bool:
        """Return whether a hand touches the payload."""
        of_hand = self._world.hand_of_geom == number
        of_load = self._world.model.geom_bodyid == self._world.load_body
        first, second = self._data.contact.geom.T
        return bool((of_hand[first] & of_load[second] | of_hand[second] & of_load[first]).any())

    def _release(self, arm: str, time: float) -> None:
        """Fix a payload that an arm releases at its start or goal; note another one."""
        load = self._world.load
        assert load is not None, "something was held"
        grasps = points_of(self._world.load_pose(self._data)[None], load.grasps)[0]
        off = {
            end: float(np.linalg.norm(grasps - self._scene.nodes_at(end)[list(load.holders)], axis=1).max())
            for end in ("start", "goal")
        }
        where = min(off, key=off.__getitem__)
        if off[where] <= NEAR:
            hold_still(self._world, self._data)
            self._is_fixed = True
            self._say(time, f"the payload is released at its {where}")
        else:
            dropped = f"the payload was released by '{arm}' {1e3 * off['goal']:.0f} mm from its goal at {time:.2f} s"
            self.dropped.append(dropped)
            self._say(time, dropped)
