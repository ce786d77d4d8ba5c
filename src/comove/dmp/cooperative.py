"""Movements of several end effectors in cooperative coordinates, on one phase.

Every end effector's pose is that of a common frame times its own pose in that frame,

    T_i(s) = X(s) G_i(s),

where X is the movement of the payload, and G_i is constant for a rigid grasp or a primitive of its own for a
prescribed relative motion (as when one turns the lid of a jar that the other holds). Relative poses then hold by
construction for any X: at another pace, paused, run backwards, pushed, or with a goal that moves. End effectors that
move independently have no X; constraints between them are those of a scene (`comove.model.constraints`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array
from comove.dmp.arguments import instants, require_steps
from comove.dmp.demonstrations import Demonstration
from comove.dmp.poses import Pose, PoseDMP, PoseRecording, PoseState
from comove.errors import DemonstrationError, OptionError, near_name
from comove.geometry import rotations
from comove.trajectory import PoseTrajectory


@dataclass(frozen=True, eq=False)
class CooperativeState:
    """The state of an execution: the states of its movements.

    Attributes
    ----------
    parts : states of the movements, by the name of the end effector, "" for the payload
    """

    parts: Mapping[str, PoseState]

    @property
    def time(self) -> float:
        """Return the time since the start [s]."""
        return next(iter(self.parts.values())).time

    @property
    def progress(self) -> float:
        """Return the phase in durations."""
        return next(iter(self.parts.values())).progress


@dataclass(frozen=True, eq=False)
class CooperativeDMP:
    """A movement of several manipulators in space that share one phase.

    Attributes
    ----------
    load : movement of the payload's frame; None where every end effector moves independently
    hands : by name, the end effector's pose in that frame: constant, or a movement of the same duration
    """

    load: PoseDMP | None
    hands: Mapping[str, Pose | PoseDMP]

    def __post_init__(self) -> None:
        if not isinstance(self.hands, Mapping):
            raise OptionError(
                f"hands = {self.hands!r}", way_out="give a mapping of names to poses or movements"
            )
        object.__setattr__(self, "hands", dict(self.hands))
        if not self.hands or "" in self.hands:
            raise OptionError("hands without names", way_out="name every manipulator, and one at least")
        for name, hand in self.hands.items():
            if not isinstance(hand, (Pose, PoseDMP)):
                raise OptionError(
                    f"the hand {name!r} is {type(hand).__name__}", way_out="give a Pose or a PoseDMP"
                )
            length = len(hand.position) if isinstance(hand, Pose) else hand.n_dims
            if length != 3:
                raise OptionError(f"the hand {name!r} is planar", way_out="give poses in space")
        if self.load is not None and (not isinstance(self.load, PoseDMP) or self.load.n_dims != 3):
            raise OptionError(
                "the load's movement is none in space", way_out="give a PoseDMP of three dimensions"
            )
        movements = self.movements
        if not movements:
            raise OptionError("nothing moves", way_out="give the load's movement, or one for every hand")
        if self.load is None and len(movements) < len(self.hands):
            still = next(name for name in self.hands if name not in movements)
            raise OptionError(
                f"the hand {still!r} does not move", way_out="give it a movement, or give the load one"
            )
        durations = {movement.duration for movement in movements.values()}
        if len(durations) > 1:
            raise OptionError(
                f"the movements last {', '.join(f'{d:g}' for d in sorted(durations))} s",
                way_out="bring them to one duration by towards(duration=...)",
            )

    @classmethod
    def from_hand(
        cls,
        demonstration: PoseRecording,
        name: str,
        grasps: Mapping[str, Pose],
        *,
        n_basis: int = 20,
        **options: Any,
    ) -> CooperativeDMP:
        """Build the end effectors' movement with a payload from one demonstration.

        Parameters
        ----------
        demonstration
            The poses of the end effector `name`.
        grasps
            Poses of all end effectors in the payload's frame.
        n_basis, options
            As for `PoseDMP.fit`.
        """
        if not isinstance(grasps, Mapping) or not all(
            isinstance(grasp, Pose) and len(grasp.position) == 3 for grasp in grasps.values()
        ):
            raise OptionError(f"grasps = {grasps!r}", way_out="give a mapping of names to poses in space")
        if name not in grasps:
            raise OptionError(f"there is no hand {name!r}", way_out=near_name(name, grasps))
        if getattr(demonstration, "orientation", None) is None or demonstration.position.shape[1] != 3:
            raise DemonstrationError(
                "the recording is none of a hand in space with its orientation",
                way_out="record positions (x, y, z) and orientations",
            )
        held = grasps[name]
        orientation = rotations.quaternion_product(
            np.asarray(demonstration.orientation), rotations.conjugate(held.orientation)
        )
        position = demonstration.position - rotations.matrices(orientation) @ held.position
        load = Demonstration(demonstration.time, position, orientation=orientation)
        return cls(PoseDMP.fit(load, n_basis=n_basis, **options), grasps)

    @property
    def duration(self) -> float:
        """Return the duration of the movement [s]."""
        return next(iter(self.movements.values())).duration

    @property
    def manipulators(self) -> tuple[str, ...]:
        """Return the names of the end effectors."""
        return tuple(self.hands)

    def towards(self, *, duration: float | None = None, **ends: Any) -> CooperativeDMP:
        """Return the movement between other payload poses and velocities.

        The duration [s] may change too. Arguments are as for `PoseDMP.towards`.
        """
        if self.load is None and any(end is not None for end in ends.values()):
            raise OptionError(
                "hands that move for themselves have no common start or goal",
                way_out="change the movement of each",
            )
        load = None if self.load is None else self.load.towards(duration=duration, **ends)
        hands = {
            name: hand.towards(duration=duration) if isinstance(hand, PoseDMP) else hand
            for name, hand in self.hands.items()
        }
        return replace(self, load=load, hands=hands)

    def rollout(self, *, n_steps: int = 201, **ends: Any) -> PoseTrajectory:
        """Return samples of the movement, between other ends as in `towards`."""
        require_steps(n_steps)
        dmp = self.towards(**ends)
        return dmp.at(np.linspace(0.0, dmp.duration, n_steps))

    def at(self, time: ArrayLike) -> PoseTrajectory:
        """Return poses and velocities at times [s], shape (n_steps,)."""
        time = instants(time)
        frame = None if self.load is None else self.load.at(time)
        moved = [_played(hand, time, frame) for hand in self.hands.values()]
        p, q, v, w = (np.stack(values, axis=1) for values in zip(*moved, strict=True))
        return PoseTrajectory(time, p, v, self.manipulators, orientation=q, angular_velocity=w)

    def initial_state(self) -> CooperativeState:
        """Return the state at time 0, from which `step` continues."""
        return CooperativeState({name: movement.initial_state() for name, movement in self.movements.items()})

    def step(
        self,
        state: CooperativeState,
        dt: float,
        *,
        rate: float = 1.0,
        coupling: Mapping[str, ArrayLike] | None = None,
        velocity_coupling: Mapping[str, ArrayLike] | None = None,
    ) -> CooperativeState:
        """Advance by `dt` [s] online, exactly. `rate` is the pace of the phase, as for `DMP.step`.

        Parameters
        ----------
        coupling, velocity_coupling : couplings during the step, as for `PoseDMP.step`, by the name of the end
            effector, "" for the payload; in the payload's frame for one that moves relative to it
        """
        movements = self.movements
        pushes, drifts = (
            self._acting(name, value)
            for name, value in (("coupling", coupling), ("velocity_coupling", velocity_coupling))
        )
        return CooperativeState(
            {
                name: movements[name].step(
                    part,
                    dt,
                    rate=rate,
                    coupling=pushes.get(name),
                    velocity_coupling=drifts.get(name),
                )
                for name, part in state.parts.items()
            }
        )

    def _acting(self, key: str, coupling: Mapping[str, ArrayLike] | None) -> Mapping[str, ArrayLike]:
        """Return couplings by the name of the movement, checked."""
        if coupling is None:
            return {}
        if not isinstance(coupling, Mapping):
            raise OptionError(
                f"{key} = {coupling!r}", way_out='give a mapping of names to numbers, "" for the load'
            )
        for name in coupling:
            self._movement(name)
        return coupling

    def redirected(self, state: CooperativeState, goal: Pose, name: str = "") -> CooperativeState:
        """Return the state with another goal of the payload or end effector."""
        return self._changed(state, name, self._movement(name).redirected(state.parts[name], goal))

    def displaced(self, state: CooperativeState, pose: Pose, name: str = "") -> CooperativeState:
        """Return the state after a push of payload or end effector."""
        return self._changed(state, name, self._movement(name).displaced(state.parts[name], pose))

    def poses(self, state: CooperativeState) -> dict[str, Pose]:
        """Return the poses of all end effectors in a state, by name."""
        now = {name: self.movements[name].pose(part) for name, part in state.parts.items()}
        frame = now.get("", Pose(np.zeros(3)))
        return {
            name: _composed(frame, now[name] if isinstance(hand, PoseDMP) else hand)
            for name, hand in self.hands.items()
        }

    @property
    def movements(self) -> dict[str, PoseDMP]:
        """Return the movements by name: "" for the payload, then end effectors."""
        load = {} if self.load is None else {"": self.load}
        return load | {name: hand for name, hand in self.hands.items() if isinstance(hand, PoseDMP)}

    def _movement(self, name: str) -> PoseDMP:
        movements = self.movements
        if name not in movements:
            what = f"the hand {name!r}" if name else "the load"
            raise OptionError(f"{what} has no movement of its own", way_out=near_name(name, movements))
        return movements[name]

    def _changed(self, state: CooperativeState, name: str, part: PoseState) -> CooperativeState:
        return CooperativeState({**state.parts, name: part})


def _composed(frame: Pose, hand: Pose) -> Pose:
    return Pose(
        frame.position + rotations.matrices(frame.orientation) @ hand.position,
        rotations.quaternion_product(frame.orientation, hand.orientation),
    )


def _played(
    hand: Pose | PoseDMP, time: Array, frame: PoseTrajectory | None
) -> tuple[Array, Array, Array, Array]:
    """Return positions, orientations, velocities and angular velocities of an end effector."""
    if isinstance(hand, PoseDMP):
        own = hand.at(time)
        p, q, v, w = own.position, own.orientation, own.velocity, own.angular_velocity
    else:
        p, q = np.tile(hand.position, (len(time), 1)), np.tile(hand.orientation, (len(time), 1))
        v = w = np.zeros((len(time), 3))
    if frame is None:
        return p, q, v, w
    turn = rotations.matrices(frame.orientation)
    p, v, w = (np.einsum("tij,tj->ti", turn, vectors) for vectors in (p, v, w))
    v = frame.velocity + np.cross(frame.angular_velocity, p) + v
    q = rotations.quaternion_product(frame.orientation, q)
    return frame.position + p, q, v, frame.angular_velocity + w
