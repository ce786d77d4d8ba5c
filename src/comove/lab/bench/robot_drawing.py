"""Robot scenes sampled around a joint motion, which proves them feasible.

First poses of the payload are sampled, from start to goal, and a motion along them, which arms follow and which is
verified without obstacles; then obstacles that block the straight motion and lie near the swept volume, each of
which leaves the motion its clearance. No planner and no smoothing is involved, so that none is favoured.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.data.carried import robot_of
from comove.dmp.basis import motion_basis
from comove.errors import SceneError
from comove.lab.bench.drawing import clutter
from comove.lab.bench.workplaces import RobotDifficulty, Workplace
from comove.model.coordinates import load_coordinates
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.planning.configurations import configuration_space
from comove.planning.seeds import fit, targets_along
from comove.robots import JointMotion, JointVerdict, RobotCarrier, verify_joints
from comove.verification.verify import verify

N_BASIS = 20  # shape weights a column of a witness, as files hold them
RIDGE, STEADY = 2, -1  # of the fits of `seeds.fit`: which damping and which profile of speed a witness has


@dataclass(frozen=True, eq=False)
class JointWitness:
    """Motion of the payload, with a robot's joints.

    Attributes
    ----------
    weights : array, shape (n_columns, N_BASIS), of the payload's motion in load coordinates
    position : array, shape (n_steps, n_joints), joints at even times [rad, m for prismatic joints]
    """

    weights: Array
    position: Array

    def motion(self, scene: Scene) -> CoordinatedMotion:
        """Return the payload's motion in a scene with the witness's ends."""
        coordinates = load_coordinates(scene)
        boundary, basis = coordinates.boundary(), motion_basis(N_BASIS, "jerk")
        return CoordinatedMotion(scene, coordinates, basis, boundary, self.weights)

    def judged(self, scene: Scene, *, slack: float = 0.0) -> JointVerdict:
        """Return the witness's verification in continuous time. `slack` is as in `verify_joints`."""
        robot = robot_of(scene)
        time = np.linspace(0.0, scene.duration, len(self.position))
        joints = JointMotion(time, robot.joint_names, self.position)
        return verify_joints(robot, self.motion(scene), joints, slack=slack)


def drawn(
    name: str, difficulty: RobotDifficulty, place: Workplace, seed: list[int]
) -> tuple[dict[str, Any], JointWitness]:
    """Sample a scene; return its file contents and its witness.

    Parameters
    ----------
    seed : seed of all random numbers, one or several
    """
    rng = np.random.default_rng(seed)
    while True:
        draft = RobotDraft(name, difficulty, place, rng)
        witness = draft.moved()
        if witness is not None and draft.obstructed(witness):
            return draft.data(), witness


class RobotDraft:
    """Scene during sampling."""

    def __init__(self, name: str, difficulty: RobotDifficulty, place: Workplace, rng: np.random.Generator):
        self.name, self.difficulty, self.place, self.rng = name, difficulty, place, rng
        self.obstacles: list[dict[str, Any]] = []
        self.tilt = rng.uniform(-difficulty.tilt, difficulty.tilt)  # which hands keep that point down
        between = int(rng.integers(difficulty.between[0], difficulty.between[1] + 1))
        while True:
            self.poses = [self._pose() for _ in range(between + 2)]
            if np.linalg.norm(self.poses[-1][0] - self.poses[0][0]) > difficulty.far * place.length:
                break

    def _pose(self) -> Array:
        """Sample the end effectors on a bar; array, shape (2, 3) [m]."""
        p, d, rng = self.place, self.difficulty, self.rng
        heading, tilt = rng.uniform(-d.turn, d.turn), self.tilt
        along = np.array([-np.sin(heading) * np.cos(tilt), np.cos(heading) * np.cos(tilt), np.sin(tilt)])
        aside = 0.5 * p.length * np.abs(along) + p.radius + d.spare
        middle = rng.uniform(np.array(p.lower) + aside, np.array(p.upper) - aside)
        return middle + 0.5 * p.length * np.array([along, -along])

    def data(self, first: int = 0, last: int = -1) -> dict[str, Any]:
        """Return the scene file's contents, from one pose to another."""
        p = self.place
        hands = zip(p.hands, self.poses[first].round(10), self.poses[last].round(10), strict=True)
        return {
            "name": self.name,
            "duration": self.difficulty.duration,
            "robot": p.robot,
            "grasp": {"orientation": "down", "yaw": "load", "offset_deg": p.offset_deg},
            "workspace": {"lower": list(p.lower), "upper": list(p.upper)},
            "obstacles": self.obstacles,
            "load": {"shape": "bar", "length": p.length, "radius": p.radius, "mass": p.mass},
            "manipulators": [{"name": name, "start": a.tolist(), "goal": b.tolist()} for name, a, b in hands],
            "limits": {"speed": 0.5, "acceleration": 1.0, "clearance": self.difficulty.clearance},
        }

    def moved(self) -> JointWitness | None:
        """Return a motion along the poses without obstacles. Return None where arms cannot follow it."""
        scene = Scene.from_dict(self.data())
        coordinates, carrier = load_coordinates(scene), RobotCarrier(robot_of(scene), scene)
        try:
            carrier.require_reach()
        except SceneError:
            return None
        path = [
            load_coordinates(Scene.from_dict(self.data(k, k + 1))).boundary()[0]
            for k in range(len(self.poses) - 1)
        ]
        path.append(coordinates.boundary()[2])
        space = configuration_space(scene, coordinates)
        target = targets_along(space, np.array(path), gentle=True)[STEADY:]
        dmp, weights = fit(target, target[0, -1], coordinates, motion_basis(N_BASIS, "jerk"), scene)
        motion = CoordinatedMotion(scene, coordinates, dmp.basis, dmp.boundary, weights[RIDGE])
        if verify(motion).verified is None:
            return None
        joints, miss = carrier.track(motion)
        if miss is not None:
            return None
        time = np.linspace(0.0, scene.duration, round(self.difficulty.rate * scene.duration) + 1)
        witness = JointWitness(motion.weights, joints.curve(time))
        return witness if self._clear(witness, scene) else None

    def _clear(self, witness: JointWitness, scene: Scene) -> bool:
        return witness.judged(scene.limited(clearance=self.difficulty.spare), slack=1.0).verified is not None

    def obstructed(self, witness: JointWitness) -> bool:
        """Add obstacles; return whether they fit and block the straight motion."""
        d, free = self.difficulty, Scene.from_dict(self.data())
        straight, swept = CoordinatedMotion.straight(free), witness.motion(free)
        for k in range(int(self.rng.integers(d.obstacles[0], d.obstacles[1] + 1))):
            if not self._placed(straight if k < d.in_the_way else swept, witness):
                return False
            if k + 1 == d.in_the_way and not verify(straight.on(Scene.from_dict(self.data()))).reasons:
                return False
        return self._clear(witness, Scene.from_dict(self.data()))

    def _placed(self, motion: CoordinatedMotion, witness: JointWitness) -> bool:
        """Place an obstacle near the bar, as close as the witness allows."""
        for _ in range(self.difficulty.tries):
            point, away, obstacle = self._obstacle(motion)
            for apart in self.difficulty.step * np.arange(self.difficulty.n_steps):
                center = np.clip(point + apart * away, self.place.lower, self.place.upper)
                if "height" in obstacle:
                    center[2] = 0.5 * (self.place.lower[2] + self.place.upper[2])
                placed = obstacle | {"center": center.round(3).tolist()}
                try:
                    scene = Scene.from_dict(self.data() | {"obstacles": [placed]})
                except SceneError:  # an end in an obstacle
                    continue
                if self._clear(witness, scene):
                    self.obstacles.append(placed)
                    return True
        return False

    def _obstacle(self, motion: CoordinatedMotion) -> tuple[Array, Array, dict[str, Any]]:
        """Sample a bar point of the motion, a direction, and an obstacle."""
        p, rng = self.place, self.rng
        hands = motion.hands(rng.uniform(0.2, 0.8, 1))[0, 0]
        point = hands[0] + rng.uniform() * (hands[1] - hands[0])
        away, size = rng.standard_normal(3), rng.uniform(*self.difficulty.size)
        if rng.uniform() >= self.difficulty.upright:
            return point, away / np.linalg.norm(away), clutter(rng, point, size)
        height = round(p.upper[2] - p.lower[2], 3)
        post = {"shape": "cylinder", "radius": round(0.75 * size, 3), "height": height}
        away[2] = 0.0
        return point, away / np.linalg.norm(away), post
