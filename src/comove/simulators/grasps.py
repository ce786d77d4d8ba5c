"""How the hands hold the load in a simulation: rigidly, by a joint, or by fingers and friction alone.

Every hand has a site, its grasp frame, and the load a site for each hand. Where they are is known only when the hands
stand at the load, so a grasp is closed at run time: the load's sites are moved to where the hands are, and what
connects the two is switched on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np

from comove.errors import RobotError
from comove.robots.model import Arm, Robot
from comove.simulators.engine import engine, hangs_on
from comove.simulators.servos import add_servo
from comove.simulators.things import STIFF

if TYPE_CHECKING:
    from comove.simulators.world import World

HARD = (0.99, 0.999, 0.001, 0.5, 2.0)  # impedance of a grasp's constraint: 1 % soft at most
CLOSING = 0.5  # s, in which fingers close, and in which they then grip
GIVE = 0.001  # m, behind the surface, at which a finger's servo has its whole force
BEYOND = 0.005  # m, behind its limit, to which a finger is sent


class Grasp(Protocol):
    """What every grasp offers.

    Attributes
    ----------
    section : width and height [m] of a bar, None where it is round
    touching : whether hands and load meet in contacts; otherwise they pass through each other
    """

    section: tuple[float, float] | None
    touching: ClassVar[bool]

    def moving(self, arms: Sequence[Arm]) -> tuple[str, ...]:
        """Names of joints that it moves besides the arms'."""

    def furnish(self, spec: Any, robot: Robot, arms: Sequence[Arm], friction: float) -> None:
        """Put into the world what it needs; `friction` is a factor on what it believes."""

    def close(self, world: World, data: Any) -> None:
        """Take hold of the load, the hands standing at it."""


@dataclass(frozen=True)
class Weld:
    """Hand and load are one body: position and orientation are held."""

    section: tuple[float, float] | None = None
    touching: ClassVar[bool] = False

    def moving(self, arms: Sequence[Arm]) -> tuple[str, ...]:
        """None."""
        return ()

    def furnish(self, spec: Any, robot: Robot, arms: Sequence[Arm], friction: float) -> None:
        """A weld for each hand, open for now."""
        _connect(spec, arms, engine().mjtEq.mjEQ_WELD)

    def close(self, world: World, data: Any) -> None:
        """Weld where the hands are."""
        _close_connections(world, data)


@dataclass(frozen=True)
class Connect:
    """Hand and load share a point, about which they may turn."""

    section: tuple[float, float] | None = None
    touching: ClassVar[bool] = False

    def moving(self, arms: Sequence[Arm]) -> tuple[str, ...]:
        """None."""
        return ()

    def furnish(self, spec: Any, robot: Robot, arms: Sequence[Arm], friction: float) -> None:
        """A ball joint for each hand, open for now."""
        _connect(spec, arms, engine().mjtEq.mjEQ_CONNECT)

    def close(self, world: World, data: Any) -> None:
        """Connect where the hands are."""
        _close_connections(world, data)


@dataclass(frozen=True)
class Friction:
    """Fingers close on the load before the motion begins; nothing but friction holds it from then on.

    Attributes
    ----------
    section : width (between the fingers) and height of a bar [m]
    coefficient : of sliding friction between fingers and load
    force : of each finger [N]; None takes the effort that the URDF allows it
    """

    section: tuple[float, float] | None = (0.020, 0.024)
    coefficient: float = 1.0
    force: float | None = None
    touching: ClassVar[bool] = True

    def moving(self, arms: Sequence[Arm]) -> tuple[str, ...]:
        """The fingers.

        Raises
        ------
        RobotError
            If an arm has none.
        """
        for arm in arms:
            if not arm.fingers:
                raise RobotError(
                    f"the arm '{arm.name}' has no fingers, so it cannot hold anything by friction",
                    key=f"arms.{arm.name}.fingers",
                    way_out="name them in the description, or weld the load to the hands",
                )
        return tuple(finger for arm in arms for finger in arm.fingers)

    def furnish(self, spec: Any, robot: Robot, arms: Sequence[Arm], friction: float) -> None:
        """Servos of the fingers, coupled so that the load stays in their middle; rubber on them."""
        mj = engine()
        still = spec.add_equality(type=mj.mjtEq.mjEQ_WELD, objtype=mj.mjtObj.mjOBJ_BODY, active=False)
        still.name, still.name1, still.name2 = "still", "world", "load"
        still.solref, still.solimp = STIFF, HARD
        for arm in arms:
            for name in arm.fingers:
                self._drive(spec, name)
                for body in _below(spec.joint(name).parent):
                    for geom in body.geoms:
                        geom.friction = (self.coefficient * friction, 0.005, 0.0001)
                        geom.priority, geom.condim, geom.solref = 1, 4, STIFF
            for name in arm.fingers[1:]:
                both = spec.add_equality(
                    type=mj.mjtEq.mjEQ_JOINT, objtype=mj.mjtObj.mjOBJ_JOINT, active=False
                )
                both.name, both.name1, both.name2 = f"couple {name}", name, arm.fingers[0]
                both.solref, both.solimp = STIFF, HARD

    def _drive(self, spec: Any, name: str) -> None:
        joint = spec.joint(name)
        force = self.force or float(joint.actfrcrange[1])
        if not (force > 0 and joint.range[1] > joint.range[0]):
            raise RobotError(
                f"the finger '{name}' has no limits of position and effort",
                key="limits",
                way_out=f"give them: limits: {{{name}: {{lower: 0, upper: 0.02, effort: 20}}}}",
            )
        add_servo(spec, name, force / GIVE, 2 * np.sqrt(0.1 * force / GIVE), force)

    def close(self, world: World, data: Any) -> None:
        """Open the fingers, hold the load still, close them, let go of it."""
        mj, model = engine(), world.model
        fingers = [f for hand in world.fingers for f in hand]
        joints = [model.joint(f) for f in fingers]
        shut = np.array([_closing(world, data, f) for f in fingers])
        low, high = np.array([j.range for j in joints]).T
        opened, closed = np.where(shut > 0, low, high), np.where(shut > 0, high, low)
        at = np.array([j.qposadr[0] for j in joints])
        drive = np.array([model.actuator(f).id for f in fingers])
        data.qpos[at] = opened
        mj.mj_forward(model, data)
        self._couple(world, data, dict(zip(fingers, zip(opened, closed, strict=True), strict=True)))
        still = model.equality("still").id
        model.eq_data[still, :3] = 0.0  # the anchor, in the load's frame
        model.eq_data[still, 3:6], model.eq_data[still, 6:10] = (
            data.xpos[world.load_body],
            data.xquat[world.load_body],
        )
        data.eq_active[still] = 1
        n_steps = round(CLOSING / model.opt.timestep)
        for share in np.linspace(0.0, 1.0, n_steps):
            data.ctrl[drive] = opened + share * (closed + BEYOND * shut - opened)
            mj.mj_step(model, data)
        mj.mj_step(model, data, n_steps)
        data.eq_active[still] = 0

    def _couple(self, world: World, data: Any, travel: dict[str, tuple[float, float]]) -> None:
        """All fingers of a hand have closed by the same share of their travel."""
        for hand in world.fingers:
            first = travel[hand[0]]
            for name in hand[1:]:
                equality = world.model.equality(f"couple {name}").id
                (a, b), (c, d) = first, travel[name]
                ratio = (d - c) / (b - a)
                # y - y0 = a0 + a1 (x - x0), and both are 0 in the reference configuration
                world.model.eq_data[equality, :5] = (c - ratio * a, ratio, 0.0, 0.0, 0.0)
                data.eq_active[equality] = 1


def _connect(spec: Any, arms: Sequence[Arm], kind: Any) -> None:
    for arm in arms:
        grasp = spec.add_equality(type=kind, objtype=engine().mjtObj.mjOBJ_SITE, active=False)
        grasp.name, grasp.name1, grasp.name2 = f"grasp {arm.name}", f"hand {arm.name}", f"held {arm.name}"
        grasp.solref, grasp.solimp = STIFF, HARD


def _close_connections(world: World, data: Any) -> None:
    for name in world.holder_names:
        data.eq_active[world.model.equality(f"grasp {name}").id] = 1


def _below(body: Any) -> list[Any]:
    return [body, *body.find_all(engine().mjtObj.mjOBJ_BODY)]


def _closing(world: World, data: Any, finger: str) -> float:
    """The direction, 1 or -1, in which a finger's joint brings it nearer to the line of approach of its hand."""
    mj, model = engine(), world.model
    joint = model.joint(finger)
    hand = next(i for i, names in enumerate(world.fingers) if finger in names)
    site = world.holder_sites[hand]
    frame = data.site_xmat[site].reshape(3, 3)
    bodies = [b for b in range(model.nbody) if hangs_on(model, b, int(model.jnt_bodyid[joint.id]))]
    geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] in bodies and model.geom_contype[g]]
    nearest = min(geoms, key=lambda g: np.linalg.norm(data.geom_xpos[g] - data.site_xpos[site]))
    jacobian = np.zeros((3, model.nv))
    mj.mj_jac(model, data, jacobian, None, data.geom_xpos[nearest], model.geom_bodyid[nearest])
    aside = frame[:, :2].T @ (data.geom_xpos[nearest] - data.site_xpos[site])
    return -float(np.sign(aside @ (frame[:, :2].T @ jacobian[:, joint.dofadr[0]])))
