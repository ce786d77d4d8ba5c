"""Grasp by fingers and friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from comove.errors import OptionError, RobotError
from comove.robots.model import Arm
from comove.simulators.bodies import STIFF, THE_LOAD
from comove.simulators.engine import engine, hangs_on
from comove.simulators.grasps import HARD
from comove.simulators.loads import THINNEST
from comove.simulators.servos import add_servo
from comove.simulators.world import World

CLOSING = 0.5  # s, in which fingers close, and in which they then grip
GIVE = 0.001  # m, behind the surface, at which a finger's servo has its whole force
BEYOND = 0.005  # m, behind its limit, to which a finger is sent
FINGER_MASS = 0.1  # kg, that a finger's servo is damped for
SPIN = (0.005, 0.0001)  # friction of fingers against spinning and rolling [m]
OVERLAP = 0.001  # m, by which a load reaches into a hand that is too narrow for it


@dataclass(frozen=True)
class Friction:
    """A grasp in which fingers close on the load before the motion begins, and only friction holds it from then on.

    Attributes
    ----------
    coefficient : coefficient of sliding friction between fingers and load
    force : force of each finger [N]; None takes the effort limit of the URDF
    size : width (between the fingers) and height of a bar [m]; None takes 5/3 and 2 times its radius: fingers
        need sides to hold it by
    """

    coefficient: float = 1.0
    force: float | None = None
    size: tuple[float, float] | None = None
    touching: ClassVar[bool] = True

    def __post_init__(self) -> None:
        given = {"coefficient": [self.coefficient], "force": [self.force], "size": self.size or ()}
        for name, values in given.items():
            if any(value is not None and not 0 < value < np.inf for value in values):
                raise OptionError(
                    f"{getattr(self, name)} is not possible", key=name, way_out="give positive numbers"
                )

    def section(self, radius: float) -> tuple[float, float] | None:
        """Return width and height of a bar, which the fingers hold by its sides [m]."""
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
        """Add servos of the fingers, couplings that keep the load in their middle, and the friction of their
        surfaces.
        """
        mj = engine()
        still = spec.add_equality(
            type=mj.mjtEq.mjEQ_WELD, objtype=mj.mjtObj.mjOBJ_BODY, active=False, solref=STIFF, solimp=HARD
        )
        still.name, still.name1, still.name2 = "still", "world", THE_LOAD
        for finger in self.moving(arms):
            self._drive(spec, finger)
            for body in _below(spec.joint(finger).parent):
                for geom in body.geoms:
                    geom.friction = (self.coefficient * friction, *SPIN)
                    geom.priority, geom.condim, geom.solref = 1, 4, STIFF
        for arm in arms:
            for finger in arm.fingers[1:]:
                both = spec.add_equality(
                    type=mj.mjtEq.mjEQ_JOINT,
                    objtype=mj.mjtObj.mjOBJ_JOINT,
                    active=False,
                    solref=STIFF,
                    solimp=HARD,
                )
                both.name, both.name1, both.name2 = f"couple {finger}", finger, arm.fingers[0]

    def _drive(self, spec: Any, finger: str) -> None:
        joint = spec.joint(finger)
        force = float(joint.actfrcrange[1]) if self.force is None else self.force
        if not (force > 0 and joint.range[1] > joint.range[0]):
            raise RobotError(
                f"the finger '{finger}' has no limits of position and effort",
                key="limits",
                way_out=f"give them: limits: {{{finger}: {{lower: 0, upper: 0.02, effort: 20}}}}",
            )
        joint.actfrclimited = False
        add_servo(spec, finger, force / GIVE, 2 * np.sqrt(FINGER_MASS * force / GIVE), force)

    def close(self, world: World, data: Any) -> None:
        """Open the fingers, hold the load still, close them, and release the load to their friction.

        Raises
        ------
        RobotError
            If the load is wider than a hand opens.
        """
        mj, model = engine(), world.model
        fingers = [finger for hand in world.fingers for finger in hand]
        inward = np.array([_inward(world, data, finger) for finger in fingers])
        low, high = np.array([model.joint(finger).range for finger in fingers]).T
        opened, closed = np.where(inward > 0, low, high), np.where(inward > 0, high, low)
        data.qpos[[model.joint(finger).qposadr[0] for finger in fingers]] = opened
        mj.mj_forward(model, data)
        _require_room(world, data)
        _couple(world, data, dict(zip(fingers, zip(opened, closed, strict=True), strict=True)))
        still = model.equality("still").id
        pose = np.concatenate([data.xpos[world.load_body], data.xquat[world.load_body]])
        model.eq_data[still, :10] = [0.0, 0.0, 0.0, *pose]  # the anchor in the load, and where the load is
        data.eq_active[still] = 1
        servos, n_steps = (
            [model.actuator(finger).id for finger in fingers],
            round(CLOSING / model.opt.timestep),
        )
        for share in np.linspace(0.0, 1.0, n_steps):
            data.ctrl[servos] = opened + share * (closed + BEYOND * inward - opened)
            mj.mj_step(model, data)
        mj.mj_step(model, data, n_steps)
        data.eq_active[still] = 0


def _couple(world: World, data: Any, travel: dict[str, tuple[float, float]]) -> None:
    """Couple all fingers of a hand, so that they close by the same share of their travel, from open to closed."""
    for first, *others in world.fingers:
        begin, end = travel[first]
        for finger in others:
            equality = world.model.equality(f"couple {finger}").id
            ratio = (travel[finger][1] - travel[finger][0]) / (end - begin)
            # finger = a + ratio first
            world.model.eq_data[equality, :5] = [travel[finger][0] - ratio * begin, ratio, 0.0, 0.0, 0.0]
            data.eq_active[equality] = 1


def _require_room(world: World, data: Any) -> None:
    """Refuse a load that reaches into open hands."""
    for pair, distance in zip(data.contact.geom, data.contact.dist, strict=True):
        hand = world.hand_of_geom[pair].max()
        if hand >= 0 and distance < -OVERLAP and not world.watched[tuple(pair)]:
            raise RobotError(
                f"the hand '{world.holder_names[hand]}' does not open wide enough for the load",
                key="load",
                way_out="make it thinner, turn the hands, or weld it to them",
            )


def _below(body: Any) -> list[Any]:
    return [body, *body.find_all(engine().mjtObj.mjOBJ_BODY)]


def _inward(world: World, data: Any, finger: str) -> float:
    """Return the direction, 1 or -1, in which a joint brings its finger nearer to its hand's line of approach."""
    mj, model = engine(), world.model
    joint = model.joint(finger)
    site = next(s for s, names in zip(world.holder_sites, world.fingers, strict=True) if finger in names)
    of_finger = [hangs_on(model, body, int(model.jnt_bodyid[joint.id])) for body in model.geom_bodyid]
    geoms = np.flatnonzero(of_finger & (model.geom_contype > 0))
    away = data.geom_xpos[geoms] - data.site_xpos[site]
    tip = int(np.linalg.norm(away, axis=1).argmin())
    jacobian = np.zeros((3, model.nv))
    mj.mj_jac(model, data, jacobian, None, data.geom_xpos[geoms[tip]], model.geom_bodyid[geoms[tip]])
    across = data.site_xmat[site].reshape(3, 3)[:, :2]
    return -float(np.sign((away[tip] @ across) @ (across.T @ jacobian[:, joint.dofadr[0]])))
