"""A motion sampled for the eye: states of the load, and what is measured of it over time."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from comove.coordination.motion import CoordinatedMotion
from comove.scenes.scene import Scene
from comove.verification.certificate import certify
from comove.verification.record import Record, clearance_of

Array = NDArray[np.float64]

STEPS_PER_SECOND = 25.0
FEWEST, MOST = 61, 301  # states of a recording
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
        n_steps = int(np.clip(round(duration * STEPS_PER_SECOND) + 1, FEWEST, MOST))
        s = np.linspace(0.0, 1.0, n_steps)
        time = s * duration
        states = motion.coordinates.motion(motion.at(s))
        rates = states[1:, :, : len(scene.manipulators)]
        nodes = np.ascontiguousarray(states[0])
        clearance = scene.clearances(nodes, time)
        certificate = certify(motion)
        return cls(
            time=time,
            nodes=nodes,
            offsets=scene.offsets(time),
            speed=np.linalg.norm(rates[0], axis=2) / duration,
            acceleration=np.linalg.norm(rates[1], axis=2) / duration**2,
            clearance=clearance,
            error=_errors(scene, nodes),
            links=np.zeros((n_steps, 0, 7)),
            tightest=np.array([certificate.time, certificate.nearest], dtype=float),
        )

    @classmethod
    def of_run(cls, record: Record) -> RecordedMotion:
        """Sample an execution; velocities are averages over its steps."""
        scene, n_hands = record.scene, len(record.scene.manipulators)
        n_steps = int(np.clip(round(record.time[-1] * STEPS_PER_SECOND) + 1, FEWEST, MOST))
        steps = np.unique(np.linspace(0, len(record.time) - 1, n_steps).round().astype(int))
        time, nodes = record.time[steps], np.ascontiguousarray(record.nodes[steps])
        period = np.diff(record.time)[:, None, None]
        velocity = np.diff(record.nodes[:, :n_hands], axis=0, prepend=record.nodes[:1, :n_hands])
        velocity[1:] /= period
        changes = np.diff(velocity, axis=0, append=velocity[-1:])
        changes[:-1] /= period
        certificate = clearance_of(record)
        return cls(
            time=time,
            nodes=nodes,
            offsets=record.obstacles[steps] - scene.centers,
            speed=np.linalg.norm(velocity, axis=2)[steps],
            acceleration=np.linalg.norm(changes, axis=2)[steps],
            clearance=scene.clearances(nodes, time),
            error=_errors(scene, nodes),
            links=np.zeros((len(steps), 0, 7)),
            tightest=np.array([certificate.time, certificate.nearest], dtype=float),
        )

    @classmethod
    def of_states(
        cls, scene: Scene, time: Array, nodes: Array, speed: Array, acceleration: Array, links: Array
    ) -> RecordedMotion:
        """Return a recording of states that were sampled elsewhere; what is tightest is tightest of the samples."""
        clearance = scene.clearances(nodes, time)
        tightest = int(clearance.argmin())
        _, nearest = scene.nearest_at(nodes[tightest], float(time[tightest]))
        return cls(
            time=time,
            nodes=nodes,
            offsets=scene.offsets(time),
            speed=speed,
            acceleration=acceleration,
            clearance=clearance,
            error=_errors(scene, nodes),
            links=links,
            tightest=np.array([time[tightest], nearest], dtype=float),
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


def _errors(scene: Scene, nodes: Array) -> Array:
    """Return which share of its tolerance the worst constraint uses at every state; array, shape (n_steps,)."""
    hands = nodes[:, : len(scene.manipulators)]
    shares = [c.error(hands, scene.n_dims) / max(c.allowed, TINY) for c in scene.constraints]
    return np.maximum(np.max(shares, axis=0), 0.0) if shares else np.zeros(len(nodes))
