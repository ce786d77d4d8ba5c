"""Runs of the safety filter among moving obstacles, judged by plain NumPy that reads the scene's file alone."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from comove.control.safety.cbf_qp import FilterSettings, SafetyFilter, Sighting
from comove.control.safety.twists import advanced, nodes_of, poses_of
from comove.geometry.distances import CENTER, ROTATION
from comove.model import Scene
from tests.brute_force import body_of, obstacle_distance

N_POINTS = 201  # along an edge


def scene_of(obstacles=(), *, load="bar", spatial=False, side=4.0, **more):
    """A load in the middle of a square or cubic workspace of `side` [m]."""
    z = [side / 2] if spatial else []
    middle = side / 2
    hands = {"left": [middle, middle - 0.2, *z], "right": [middle, middle + 0.2, *z]}
    data = {
        "name": "moving",
        "duration": 10.0,
        "workspace": {"lower": [0.0] * (2 + spatial), "upper": [side] * (2 + spatial)},
        "obstacles": list(obstacles),
        "load": {"shape": "bar", "length": 0.4, "radius": 0.01, "held_by": ["left", "right"]},
        "limits": {"speed": 1.0},
    }
    if load == "frame":
        hands["third"] = [middle + 0.3, middle, *z]
        edges = [["left", "right"], ["right", "third"], ["third", "left"]]
        data["load"] = {"shape": "frame", "edges": edges, "radius": 0.005}
    elif load in ("two bodies", "hands"):
        hands["third"] = [middle + 0.3, middle, *z]
    elif load == "overhang":
        data["load"] = {"shape": "bar", "length": 0.4, "overhang": 0.2}
    elif load == "polygon":
        vertices = [[-0.25, -0.05], [0.25, -0.05], [0.25, 0.05], [0.0, 0.2], [-0.25, 0.05]]
        data["load"] = {
            "shape": "polygon",
            "vertices": vertices,
            "grasps": {"left": [-0.2, 0], "right": [0.2, 0]},
        }
    elif load == "box":
        grasps = {"left": [-0.2, 0, 0], "right": [0.2, 0, 0]}
        data["load"] = {"shape": "box", "size": [0.5, 0.2, 0.1], "grasps": grasps}
    if load == "hands":
        del data["load"]
    data["manipulators"] = [{"name": n, "start": p, "goal": p} for n, p in hands.items()]
    for key, value in more.items():
        data[key] = data[key] | value if isinstance(value, dict) else value
    return Scene.from_dict(data)


class World:
    """Obstacles of a scene that move with constant velocities (n, 3) [m/s] and spins (n, 3) [rad/s]."""

    def __init__(self, scene, velocity=None, spin=None):
        n = len(scene.obstacles)
        self.scene = scene
        self.center = scene.obstacles[:, CENTER : CENTER + 3].copy()
        self.turn = np.repeat(np.eye(3)[None], n, axis=0)  # since the start
        self.first = scene.obstacles[:, ROTATION : ROTATION + 9].reshape(-1, 3, 3)
        self.velocity = np.zeros((n, 3)) if velocity is None else np.array(velocity, dtype=float)
        self.spin = np.zeros((n, 3)) if spin is None else np.array(spin, dtype=float)

    def sighting(self, margin=0.0):
        """What is seen."""
        table = self.scene.obstacles.copy()
        table[:, CENTER : CENTER + 3] = self.center
        table[:, ROTATION : ROTATION + 9] = (self.turn @ self.first).reshape(-1, 9)
        return Sighting(table, self.velocity.copy(), self.spin.copy(), np.full(len(table), margin))

    def go_on(self, dt):
        """The same `dt` [s] later."""
        self.center = self.center + dt * self.velocity
        if len(self.turn):
            self.turn = Rotation.from_rotvec(dt * self.spin).as_matrix() @ self.turn

    def clearance(self, nodes):
        """Least clearance [m] of the load and the hands, by brute force along the edges of the body."""
        scene, n = self.scene, self.scene.n_dims
        if len(scene.body.solids):
            points, radii = _on_box(nodes[scene.body.solids[0]]), np.zeros(1)
            points = points[None]
        else:
            a, b, radii = body_of(scene, nodes[None, : len(scene.manipulators), :n])
            points = a[0, :, None] + np.linspace(0.0, 1.0, N_POINTS)[:, None] * (b - a)[0, :, None]
        least = np.minimum(points - scene.lower, scene.upper - points).min(axis=(1, 2)) - radii
        for j, obstacle in enumerate(scene.file.obstacles):
            center = np.array(obstacle.center)
            back = (points - self.center[j, :n]) @ self.turn[j][:n, :n] + center
            least = np.minimum(least, obstacle_distance(obstacle, back).min(axis=1) - radii)
        return float(least.min())


def _on_box(corners):
    """A grid on a box whose corners (8, 3) are numbered in binary."""
    shares = np.stack(np.meshgrid(*[np.linspace(0, 1, 13)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    shares = shares[((shares == 0) | (shares == 1)).any(axis=1)]
    return corners[0] + shares @ (corners[[1, 2, 4]] - corners[0])


class Run(NamedTuple):
    """What a run met: least clearance [m], largest speed [m/s], acceleration [m/s^2] and relaxation [m/s]."""

    clearance: float
    speed: float
    acceleration: float
    relaxed: float
    poses: object
    n_relaxed: int


def run(world, wanted, n_steps, *, period=0.01, settings=None, look=5, margin=0.0):
    """Drive with the hands' velocities `wanted(i, nodes)`, array of shape (n_hands, 3), for so many steps."""
    scene = world.scene
    programme, poses = SafetyFilter(scene, period, settings or FilterSettings()), poses_of(scene, "start")
    before = np.zeros((len(scene.manipulators), 3))
    clearance, speed, acceleration, relaxed, n_relaxed = np.inf, 0.0, 0.0, 0.0, 0
    for i in range(n_steps):
        asked = wanted(i, nodes_of(scene, poses)) if callable(wanted) else wanted
        allowed = programme.allowed(poses, before, asked, world.sighting(margin))
        later = advanced(poses, allowed.twists, period)
        now = (nodes_of(scene, later) - nodes_of(scene, poses))[: len(before)] / period
        speed = max(speed, np.linalg.norm(now, axis=1).max())
        acceleration = max(acceleration, np.linalg.norm(now - before, axis=1).max() / period)
        relaxed, n_relaxed = max(relaxed, allowed.relaxed), n_relaxed + (allowed.relaxed > 0)
        poses, before = later, now
        world.go_on(period)
        if i % look == 0:
            clearance = min(clearance, world.clearance(nodes_of(scene, poses)))
    return Run(clearance, speed, acceleration, relaxed, poses, n_relaxed)
