"""Measures of a simulated robot that follows commands.

They are those of an `Execution`, computed from some samples at a time, so that a robot may run for days. Each time
all end effectors hold the payload, its plan begins anew: where the commanded end effectors carry it from there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.model.scene import Scene
from comove.robots.motion import JointMotion
from comove.robots.verification.checks import without_gripper
from comove.sim.dynamics import Log
from comove.sim.execution import Conditions, Contact, Execution
from comove.sim.loads import hand_poses, points_of
from comove.sim.world import SimulatedWorld

CHUNK = 10  # samples that are measured at once
CARRIED = (
    *("lag_max", "distance_error_max", "slip_max"),
    *("internal_force_max", "internal_torque_max", "squeeze_max"),
)
"""Measures that exist while the payload is held."""


@dataclass(frozen=True)
class RobotReport:
    """What a simulated robot has done.

    Attributes
    ----------
    measures : largest measures, by their names in `Execution.measures`, and `end_error`, the payload's present
        distance from its goal [m]; without a payload, that of an end effector
    contacts : unwanted contacts
    reasons : reasons why the payload was not delivered; empty if it was
    without_gripper : names of the arms whose description has no gripper
    """

    measures: Mapping[str, float]
    contacts: tuple[Contact, ...]
    reasons: tuple[str, ...]
    without_gripper: tuple[str, ...]

    @property
    def delivered(self) -> bool:
        """Return whether the payload was delivered. No slip, contact or instability happened then."""
        return not self.reasons


class RobotRecord:
    """Largest measures of a robot, from samples written one by one.

    Parameters
    ----------
    world : simulated world with the robot and its payload
    scene, conditions : as in an `Execution`
    """

    def __init__(self, world: SimulatedWorld, scene: Scene, conditions: Conditions):
        self._world, self._robot, self._load = world, world.robot, world.load
        self._scene, self._conditions = scene, conditions
        self._log, self._rows = Log(world, CHUNK), list[tuple[float, Array]]()
        self._first: dict[str, Array] | None = None
        self._carries = self._has_carried = False
        self._largest: dict[str, float] = {}
        self._since: dict[str, float] = {}

    @property
    def carries(self) -> bool:
        """Whether all end effectors carry the payload; always without one."""
        return self._carries

    @carries.setter
    def carries(self, carries: bool) -> None:
        carries = carries or self._load is None
        if carries != self._carries:
            self._flush()
            self._carries, self._first = carries, None

    def write_state(self, time: float, commanded: Array, data: Any) -> None:
        """Write time [s], commanded joints [rad] and state before a time step."""
        self._rows.append((time, commanded.copy()))
        self._log.write_state(data)

    def write_rest(self, data: Any) -> None:
        """Write the rest of a sample, after the time step."""
        self._log.write_rest(data)
        if self._log.count == CHUNK:
            self._flush()

    def _flush(self) -> None:
        """Measure the samples that were written."""
        if count := self._log.count:
            time, commanded = map(np.array, zip(*self._rows[:count], strict=True))
            self._add(commanded, {"time": time, **self._log.series()})
        self._log, self._rows = Log(self._world, CHUNK), []

    def _add(self, commanded: Array, series: Mapping[str, Array]) -> None:
        self._note("tracking_error_max", np.abs(series["joints"] - commanded).max())
        self._note("torque_share_max", np.abs(series["torque"] / self._robot.effort).max())
        if not self._carries:
            return
        rows = {"commanded": commanded, **series}
        if self._first is None:
            self._first = {name: array[:1].copy() for name, array in rows.items()}
            self._first["time"] -= 1e-3  # before the first sample, as times rise
        self._has_carried = True
        rows = {name: np.concatenate([self._first[name], array]) for name, array in rows.items()}
        self._measure(rows.pop("commanded"), rows)

    def _measure(self, commanded: Array, series: dict[str, Any]) -> None:
        motion = JointMotion(series["time"] - series["time"][0], self._robot.joint_names, commanded)
        time = series.pop("time")
        execution = Execution(
            robot=self._robot,
            scene=self._scene,
            motion=motion,
            conditions=self._conditions,
            load=self._load,
            time=time - time[0],
            contacts=(),
            **series,
        )
        measures, limits = execution.measures, self._conditions.settings
        for name in CARRIED:
            self._note(name, measures[name])
        for hand, slip in zip(execution.holders, execution.slip.T, strict=True):
            if (beyond := slip > limits.slip_limit).any():
                self._since.setdefault(f"slip {hand}", float(time[beyond.argmax()]))
            self._note(f"slip {hand}", slip.max(initial=0.0))
        force = np.linalg.norm(execution.internal[..., :3], axis=-1).max(axis=1, initial=0.0)
        if (beyond := force > limits.internal_force_limit).any():
            self._since.setdefault("force", float(time[beyond.argmax()]))

    def _note(self, name: str, value: Any) -> None:
        if value is not None and np.isfinite(value):
            self._largest[name] = max(self._largest.get(name, 0.0), float(value))

    def report(
        self, contacts: tuple[Contact, ...], load_pose: Array, joints: Array, known: tuple[str, ...]
    ) -> RobotReport:
        """Measure what was written last; return all measures.

        Parameters
        ----------
        contacts : unwanted contacts so far
        load_pose, joints : present pose of the payload, shape (4, 4), and measured joints, shape (n_joints,) [rad]
        known : reasons that are known already
        """
        self._flush()
        end_error = self._from_goal(load_pose, joints)
        measures = {name: value for name, value in self._largest.items() if not name.startswith("slip ")}
        return RobotReport(
            {**measures, "end_error": end_error},
            contacts,
            (*known, *self._reasons(contacts, end_error)),
            without_gripper(self._robot),
        )

    def _from_goal(self, load_pose: Array, joints: Array) -> float:
        if self._load is None:
            places, goal = hand_poses(self._robot, self._scene, joints[None])[0, :, :3, 3], self._scene.goal
        else:
            places = points_of(load_pose[None], self._load.grasps)[0]
            goal = self._scene.nodes_at("goal")[list(self._load.holders)]
        return float(np.linalg.norm(places - goal, axis=1).max())

    def _reasons(self, contacts: tuple[Contact, ...], end_error: float) -> list[str]:
        limits, what = self._conditions.settings, "a hand" if self._load is None else "the load"
        found = [contact.words for contact in contacts]
        if not self._has_carried:
            found.append("the payload was never held by all grippers")
        for hand in () if self._load is None else self._load.holders:
            if (since := self._since.get(f"slip {hand}")) is not None:
                found.append(
                    f"the load slid {1e3 * self._largest[f'slip {hand}']:.1f} mm in the hand "
                    f"'{self._scene.manipulators[hand]}', beyond {1e3 * limits.slip_limit:g} mm from {since:.2f} s on"
                )
        if (since := self._since.get("force")) is not None:
            found.append(
                f"the hands worked against each other with {self._largest['internal_force_max']:.0f} N from "
                f"{since:.2f} s on, more than {limits.internal_force_limit:g} N"
            )
        if not end_error <= limits.end_error_limit:
            found.append(
                f"{what} is {1e3 * end_error:.1f} mm from its goal, more than {1e3 * limits.end_error_limit:g} mm"
            )
        return found
