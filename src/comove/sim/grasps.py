"""Models of the grasp in a simulation: rigid, jointed, or frictional.

Every end effector has a site, its grasp frame, and the payload has a site for each end effector. Their relative
poses are known only when the end effectors are at the payload, so a grasp is closed at run time: the payload's sites
are moved to the end effectors, and the constraints between both are activated.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from comove.arrays import Array, Integers
from comove.errors import RobotError
from comove.robots.model import Arm
from comove.sim.engine import STIFF, add_servo, below, engine, hangs_on
from comove.sim.loads import THINNEST
from comove.sim.settings import require_finite

if TYPE_CHECKING:
    from comove.sim.world import Holder, SimulatedWorld

STILL = "still"  # constraint that fixes the payload


def add_constraint(spec: Any, name: str, kind: str, of: str, first: str, second: str) -> None:
    """Add a constraint between two objects, inactive at first.

    Parameters
    ----------
    kind, of : kind of the constraint and of the two objects, by MuJoCo's names without prefix
    """
    mj = engine()
    equality = spec.add_equality(
        type=getattr(mj.mjtEq, f"mjEQ_{kind}"),
        objtype=getattr(mj.mjtObj, f"mjOBJ_{of}"),
        active=False,
        solref=STIFF,
        solimp=(0.99, 0.999, 0.001, 0.5, 2.0),  # 1 % soft at most
    )
    equality.name, equality.name1, equality.name2 = name, first, second


class GraspModel(ABC):
    """Model of the grasp of a payload in a simulation.

    Attributes
    ----------
    touching : whether end effectors and payload are in contact; otherwise they pass through each other
    """

    touching: ClassVar[bool] = False

    def section(self, radius: float) -> tuple[float, float] | None:
        """Return width and height of a bar's box [m]. Return None where the bar is round."""
        return None

    def moving(self, arms: Sequence[Arm]) -> tuple[str, ...]:
        """Return the names of further joints that the grasp moves."""
        return ()

    @abstractmethod
    def furnish(self, spec: Any, arms: Sequence[Arm], friction: float) -> None:
        """Add the parts of the grasp to the world. `friction` is a factor on its coefficient of friction."""

    @abstractmethod
    def close(self, world: SimulatedWorld, data: Any) -> None:
        """Grasp the payload with the end effectors at it."""

    def hold(self, world: SimulatedWorld, data: Any, holder: Holder, *, holds: bool = True) -> None:
        """Connect one end effector to the payload, or end that; nothing where fingers do."""
        return


def hold_still(world: SimulatedWorld, data: Any) -> None:
    """Fix the payload where it is."""
    still = world.model.equality(STILL).id
    pose = np.concatenate([data.xpos[world.load_body], data.xquat[world.load_body]])
    world.model.eq_data[still, :10] = [0.0, 0.0, 0.0, *pose]  # the anchor in the load, and where the load is
    data.eq_active[still] = 1


def let_go(world: SimulatedWorld, data: Any) -> None:
    """Release a payload that is fixed."""
    data.eq_active[world.model.equality(STILL).id] = 0


class _Fixed(GraspModel):
    """Grasp by a constraint; base of welds and links."""

    kind: ClassVar[str]

    def furnish(self, spec: Any, arms: Sequence[Arm], friction: float) -> None:
        """Add an inactive constraint between each pair of grasp sites."""
        for arm in arms:
            add_constraint(
                spec, f"grasp {arm.name}", self.kind, "SITE", f"hand {arm.name}", f"held {arm.name}"
            )

    def close(self, world: SimulatedWorld, data: Any) -> None:
        """Activate the constraints, at the present poses of the end effectors."""
        for holder in world.holders:
            self.hold(world, data, holder)

    def hold(self, world: SimulatedWorld, data: Any, holder: Holder, *, holds: bool = True) -> None:
        """Activate the constraint of one end effector, or end it; see `GraspModel`."""
        data.eq_active[world.model.equality(f"grasp {holder.name}").id] = holds


@dataclass(frozen=True)
class Weld(_Fixed):
    """Grasp that fixes the payload's position and orientation."""

    kind: ClassVar[str] = "WELD"


@dataclass(frozen=True)
class Connect(_Fixed):
    """Grasp that fixes a common point, about which both may rotate."""

    kind: ClassVar[str] = "CONNECT"


@dataclass(frozen=True, eq=False)
class FingerTravel:
    """Travel of all fingers that move; arrays of shape (n_fingers,) [rad or m].

    Attributes
    ----------
    servos : indices of their servos
    opened, closed : positions of open and closed fingers
    beyond : references of closed fingers, behind the limit
    force : their largest forces or torques [N, N m]
    """

    servos: Integers
    opened: Array
    closed: Array
    beyond: Array
    force: Array

    def at(self, share: float | Array) -> Array:
        """Return the references of fingers that are closed by a share."""
        return self.opened + share * (self.beyond - self.opened)


@dataclass(frozen=True)
class Friction(GraspModel):
    """Grasp by fingers that close on the payload and hold by friction.

    Attributes
    ----------
    coefficient : coefficient of sliding friction between fingers and payload
    force : force of each finger [N]; by default the effort limit of the URDF
    size : width (between the fingers) and height of a bar [m]; by default 5/3 and 2 times its radius: fingers
        need sides to hold it by
    """

    coefficient: float = 1.0
    force: float | None = None
    size: tuple[float, float] | None = None
    touching: ClassVar[bool] = True

    def __post_init__(self) -> None:
        require_finite("coefficient", self.coefficient, positive=True)
        require_finite("force", *(() if self.force is None else (self.force,)), positive=True)
        require_finite("size", *(self.size or ()), positive=True)

    def section(self, radius: float) -> tuple[float, float] | None:
        """Return width and height of a bar, grasped by its sides [m]."""
        return self.size or (5 / 3 * max(radius, THINNEST), 2 * max(radius, THINNEST))

    def moving(self, arms: Sequence[Arm]) -> tuple[str, ...]:
        """Return the names of the fingers' joints.

        Raises
        ------
        RobotError
            If an arm has no fingers.
        """
        for arm in arms:
            if not arm.fingers:
                raise RobotError(
                    f"the arm '{arm.name}' has no fingers, so it cannot hold anything by friction",
                    key=f"arms.{arm.name}.fingers",
                    way_out="name them in the description, or weld the load to the hands",
                )
        return tuple(finger for arm in arms for finger in arm.fingers)

    def furnish(self, spec: Any, arms: Sequence[Arm], friction: float) -> None:
        """Add finger servos, couplings that centre the payload, and friction."""
        spin = (0.005, 0.0001)  # friction against spinning and rolling [m]
        for finger in self.moving(arms):
            self._drive(spec, finger)
            for body in below(spec.joint(finger).parent):
                for geom in body.geoms:
                    geom.friction = (self.coefficient * friction, *spin)
                    geom.priority, geom.condim, geom.solref = 1, 4, STIFF
        for arm in arms:
            for finger in arm.fingers[1:]:
                add_constraint(spec, f"couple {finger}", "JOINT", "JOINT", finger, arm.fingers[0])

    def _drive(self, spec: Any, finger: str) -> None:
        give = 0.001  # m, behind the surface, at which it has its whole force
        response = 0.004  # s, of its motor behind a gear: a finger alone would leap at a load that it lost
        joint = spec.joint(finger)
        force = float(joint.actfrcrange[1]) if self.force is None else self.force
        if not (force > 0 and joint.range[1] > joint.range[0]):
            raise RobotError(
                f"the finger '{finger}' has no limits of position and effort",
                key="limits",
                way_out=f"give them: limits: {{{finger}: {{lower: 0, upper: 0.02, effort: 20}}}}",
            )
        joint.actfrclimited = False
        stiffness = force / give
        joint.armature = max(joint.armature, stiffness * response**2)
        add_servo(spec, finger, stiffness, 2 * stiffness * response, force)

    def close(self, world: SimulatedWorld, data: Any) -> None:
        """Close the fingers on the fixed payload, then release the payload.

        Raises
        ------
        RobotError
            If the payload is wider than a gripper opens.
        """
        self.grip(world, data, self.open(world, data))

    def open(self, world: SimulatedWorld, data: Any) -> FingerTravel:
        """Open the fingers; return their travel.

        Raises
        ------
        RobotError
            If the payload is wider than a gripper opens.
        """
        beyond = 0.005  # m, behind its limit, to which a finger is sent
        mj, model = engine(), world.model
        fingers = world.fingers
        low, high = np.array([model.joint(finger).range for finger in fingers]).T
        data.qpos[world.finger_qpos] = 0.5 * (low + high)
        mj.mj_forward(model, data)  # at 0, where joints begin, fingers may stand beyond each other
        inward = np.array([_inward(world, data, finger) for finger in fingers])
        opened, closed = np.where(inward > 0, low, high), np.where(inward > 0, high, low)
        data.qpos[world.finger_qpos] = opened
        mj.mj_forward(model, data)
        _require_room(world, data)
        _couple(world, data, dict(zip(fingers, zip(opened, closed, strict=True), strict=True)))
        servos = np.array([model.actuator(finger).id for finger in fingers])
        force = model.actuator_forcerange[servos, 1].copy()
        return FingerTravel(servos, opened, closed, closed + beyond * inward, force)

    def grip(self, world: SimulatedWorld, data: Any, travel: FingerTravel) -> None:
        """Close the open fingers on the fixed payload, then release the payload."""
        closing = 0.5  # s, in which fingers close, and in which they then grip
        mj, model = engine(), world.model
        hold_still(world, data)
        n_steps = round(closing / model.opt.timestep)
        for share in np.linspace(0.0, 1.0, n_steps):
            data.ctrl[travel.servos] = travel.at(share)
            mj.mj_step(model, data)
        mj.mj_step(model, data, n_steps)
        let_go(world, data)


GRASPS: dict[str, type[Weld] | type[Connect] | type[Friction]] = {
    "weld": Weld,
    "connect": Connect,
    "friction": Friction,
}
"""By what commands and study files call them."""


def _couple(world: SimulatedWorld, data: Any, travel: dict[str, tuple[float, float]]) -> None:
    """Couple the fingers of a gripper to equal shares of travel. The travel goes from open to closed."""
    for first, *others in (holder.fingers for holder in world.holders):
        begin, end = travel[first]
        for finger in others:
            equality = world.model.equality(f"couple {finger}").id
            ratio = (travel[finger][1] - travel[finger][0]) / (end - begin)
            # finger = a + ratio first
            world.model.eq_data[equality, :5] = [travel[finger][0] - ratio * begin, ratio, 0.0, 0.0, 0.0]
            data.eq_active[equality] = 1


def _require_room(world: SimulatedWorld, data: Any) -> None:
    """Refuse a payload that overlaps with open grippers."""
    overlap = 0.001  # m, by which it may
    for pair, distance in zip(data.contact.geom, data.contact.dist, strict=True):
        hand = world.hand_of_geom[pair].max()
        if hand >= 0 and distance < -overlap and not world.watched[tuple(pair)]:
            raise RobotError(
                f"the hand '{world.holders[hand].name}' does not open wide enough for the load",
                key="load",
                way_out="make it thinner, turn the hands, or weld it to them",
            )


def _inward(world: SimulatedWorld, data: Any, finger: str) -> float:
    """Return the closing direction of a finger's joint, 1 or -1. The finger then moves towards the line of
    approach."""
    mj, model = engine(), world.model
    joint = model.joint(finger)
    site = next(holder.site for holder in world.holders if finger in holder.fingers)
    of_finger = [hangs_on(model, body, int(model.jnt_bodyid[joint.id])) for body in model.geom_bodyid]
    geoms = np.flatnonzero(of_finger & (model.geom_contype > 0))
    away = data.geom_xpos[geoms] - data.site_xpos[site]
    tip = int(np.linalg.norm(away, axis=1).argmin())
    jacobian = np.zeros((3, model.nv))
    mj.mj_jac(model, data, jacobian, None, data.geom_xpos[geoms[tip]], model.geom_bodyid[geoms[tip]])
    across = data.site_xmat[site].reshape(3, 3)[:, :2]
    return -float(np.sign((away[tip] @ across) @ (across.T @ jacobian[:, joint.dofadr[0]])))
