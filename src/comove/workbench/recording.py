"""A motion sampled for the eye: states of the load, and what is measured of it over time."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from comove.coordination.motion import CoordinatedMotion
from comove.scenes.scene import Scene
from comove.verification.certificate import Clearance, certify
from comove.verification.record import Record, clearance_of

Array = NDArray[np.float64]

TINY = 1e-12  # m or rad, in place of a tolerance of 0


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """States and measures of a motion at even times; what is proved of it stands in its report, not here.

    Attributes
    ----------
    time : array, shape (n_steps,) [s]
    nodes : array, shape (n_steps, n_nodes, 3), hands first, then corners of the load [m]
    offsets : array, shape (n_steps, n_obstacles, 3), of the obstacles' centres from where they are at 0 s [m]
    speed, acceleration : arrays, shape (n_steps, n_manipulators) [m/s], [m/s^2]
    clearance : array, shape (n_steps,), of load and hands from obstacles and border, inf where nothing is near [m]
    error : array, shape (n_steps,), share of its tolerance that the error of the worst constraint uses
    links : array, shape (n_steps, n_joints, 7), poses of a robot's joints, x y z [m] and w x y z; no joints without
    tightest : array, shape (2,), time of the least clearance [s], and number of the nearest obstacle, -1: the border
    """

    time: Array
    nodes: Array
    offsets: Array
    speed: Array
    acceleration: Array
    clearance: Array
    error: Array
    links: Array
    tightest: Array

    @classmethod
    def of(cls, motion: CoordinatedMotion) -> RecordedMotion:
        """Sample a motion; the tightest instant is the one that its certificate names."""
        scene, duration = motion.scene, motion.scene.duration
        s = np.linspace(0.0, 1.0, _n_states(duration))
        states = motion.coordinates.motion(motion.at(s))
        _, velocity, acceleration = states[:, :, : len(scene.manipulators)]
        return cls.of_states(
            scene,
            s * duration,
            np.ascontiguousarray(states[0]),
            velocity / duration,
            acceleration / duration**2,
            certificate=certify(motion),
        )

    @classmethod
    def of_run(cls, record: Record) -> RecordedMotion:
        """Sample an execution; velocities are averages over its steps."""
        scene, hands = record.scene, record.nodes[:, : len(record.scene.manipulators)]
        n_states = _n_states(float(record.time[-1]))
        steps = np.unique(np.linspace(0, len(record.time) - 1, n_states).round().astype(int))
        period = np.diff(record.time)[:, None, None]
        velocity = np.diff(hands, axis=0, prepend=hands[:1])
        velocity[1:] /= period
        acceleration = np.diff(velocity, axis=0, append=velocity[-1:])
        acceleration[:-1] /= period
        return cls.of_states(
            scene,
            record.time[steps],
            np.ascontiguousarray(record.nodes[steps]),
            velocity[steps],
            acceleration[steps],
            offsets=record.obstacles[steps] - scene.centers,
            certificate=clearance_of(record),
        )

    @classmethod
    def of_states(
        cls,
        scene: Scene,
        time: Array,
        nodes: Array,
        velocity: Array,
        acceleration: Array,
        *,
        offsets: Array | None = None,
        links: Array | None = None,
        certificate: Clearance | None = None,
    ) -> RecordedMotion:
        """Return a recording of states that were sampled elsewhere.

        Parameters
        ----------
        time, nodes, links : as the attributes
        velocity, acceleration : arrays, shape (n_steps, n_manipulators, 3) [m/s], [m/s^2]
        offsets : as the attribute; as the scene's obstacles move unless given
        certificate : says what is tightest; the tightest of the states unless given
        """
        clearance = scene.clearances(nodes, time)
        if certificate is None:
            step = int(clearance.argmin())
            tightest = float(time[step]), scene.nearest_at(nodes[step], float(time[step]))[1]
        else:
            tightest = certificate.time, certificate.nearest
        return cls(
            time=time,
            nodes=nodes,
            offsets=scene.offsets(time) if offsets is None else offsets,
            speed=np.linalg.norm(velocity, axis=2),
            acceleration=np.linalg.norm(acceleration, axis=2),
            clearance=clearance,
            error=_errors(scene, nodes),
            links=np.zeros((len(time), 0, 7)) if links is None else links,
            tightest=np.array(tightest, dtype=float),
        )

    def arrays(self) -> dict[str, Array]:
        """Return all arrays by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def index_at(self, time: float) -> int:
        """Return the number of the state that is nearest to an instant [s]."""
        return int(np.abs(self.time - time).argmin())

    @property
    def center(self) -> Array:
        """Return the middle of the hands; array, shape (n_steps, 3) [m]."""
        return self.nodes[:, : self.speed.shape[1]].mean(axis=1)


def _n_states(duration: float, rate: float = 25.0, fewest: int = 61, most: int = 301) -> int:
    """Return the number of states of a recording: `rate` of them a second [Hz], within bounds."""
    return int(np.clip(round(duration * rate) + 1, fewest, most))


def _errors(scene: Scene, nodes: Array) -> Array:
    """Return which share of its tolerance the worst constraint uses at every state; array, shape (n_steps,)."""
    hands = nodes[:, : len(scene.manipulators)]
    shares = [c.error(hands, scene.n_dims) / max(c.allowed, TINY) for c in scene.constraints]
    return np.maximum(np.max(shares, axis=0), 0.0) if shares else np.zeros(len(nodes))
