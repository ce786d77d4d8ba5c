"""Random motions and, around them, random scenes in which contact is a matter of a fraction of a millimetre.

Obstacles drawn first are hardly ever near a motion drawn later. So the motion comes first, and every obstacle is
then pushed towards what it sweeps until it is a chosen offset away, or as deep inside.
"""

from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from scipy.spatial.transform import Rotation

from comove.dmp.basis import motion_basis
from comove.errors import OptionError, SceneError
from comove.model import (
    CoordinatedMotion,
    Scene,
    arms_coordinates,
    load_coordinates,
    projected_coordinates,
)
from comove.model.coordinates import coordinates_for
from tests import brute_force

TRIANGLE = np.array([[-0.08, -0.05, 0.0], [0.08, -0.05, 0.0], [0.0, 0.1, 0.0]])
BAR = np.array([[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0]])
RAIL = np.array([[-0.1, 0.0, 0.0], [0.04, 0.0, 0.0], [0.12, 0.0, 0.0]])  # three hands in one line
LOADS = {2: ("bar", "bar", "hands", "frame", "polygon", "pairs", "bar and hand")}
LOADS[3] = ("bar", "bar", "hands", "frame", "frame", "pairs", "bar and hand", "rail")
WIDE = [-3.0, 4.0]  # m, a workspace that is in nobody's way


def random_motion(rng, *, n_dims=None, load=None, sigma=None, projected=None, arms=False):
    """A random motion of random hands and load, in an empty scene; with `arms` every hand for itself."""
    n_dims = n_dims or int(rng.integers(2, 4))
    load = load or str(rng.choice(LOADS[n_dims]))
    scene = Scene.from_dict(_empty_scene(rng, n_dims, load))
    if projected is None:
        projected = rng.random() < 0.3
    coordinates = load_coordinates(scene)
    if projected:
        with suppress(OptionError):  # grasps off the middle, or three hands in space
            coordinates = projected_coordinates(scene)
    if arms:
        coordinates = arms_coordinates(scene)
    basis = motion_basis(*[(30, "velocity"), (20, "velocity"), (20, "acceleration")][rng.integers(3)])
    sigma = sigma or rng.choice([0.005, 0.02, 0.06, 0.2], p=[0.3, 0.3, 0.3, 0.1])
    z = sigma * rng.standard_normal((coordinates.search.shape[1], basis.n_basis))
    boundary = coordinates.boundary(turn=int(rng.choice([0, 0, 0, 1, -1])))
    return CoordinatedMotion(scene, coordinates, basis, boundary, coordinates.search @ z)


def motion_on(scene, rng, sigma, coordinates=None):
    """A random motion on a scene, in its load coordinates unless others are given."""
    coordinates = coordinates or load_coordinates(scene)
    basis = motion_basis(20, "velocity")
    z = sigma * rng.standard_normal((coordinates.search.shape[1], basis.n_basis))
    return CoordinatedMotion(scene, coordinates, basis, coordinates.boundary(), coordinates.search @ z)


def held_scene(rng, n_dims, held, *, level=False, **more):
    """An empty scene of rigid bodies `held`, arrays (n, 3) of grasps, that go from left to right.

    With `level` all bodies keep their tilt between the ends, and their first hands are at one height.
    """
    ends = []
    turns = [_turn(rng, n_dims) for _ in held]
    for middle in (0.2, 0.8):
        height, hands = rng.uniform(0.2, 0.8), []
        for grasps, tilt in zip(held, turns, strict=True):
            spin = _turn(rng, n_dims)
            if level:
                angle = rng.uniform(-np.pi, np.pi) if n_dims == 3 else 0.0
                spin = Rotation.from_euler("z", angle).as_matrix() @ tilt
            body = (grasps @ spin.T)[:, :n_dims] + rng.uniform(0.2, 0.8, n_dims)
            body[:, 0] += middle - body[:, 0].mean()
            if level:
                body[:, -1] += height - body[0, -1]
            hands.append(body)
        ends.append(np.concatenate(hands))
    return Scene.from_dict(
        {
            "name": "held",
            "duration": 10.0,
            "workspace": {"lower": [WIDE[0]] * n_dims, "upper": [WIDE[1]] * n_dims},
            "manipulators": [
                {"name": name, "start": start.tolist(), "goal": goal.tolist()}
                for name, start, goal in zip("abcdef", *ends, strict=False)
            ],
            **more,
        }
    )


def on_scene(motion, data, folder=None):
    """The same curve on the scene of other data, such as further obstacles."""
    scene = Scene.from_dict(data, folder=folder)
    return replace(motion, scene=scene, coordinates=coordinates_for(scene, motion.coordinates.kind))


def near_contact(rng, moving=0.0):
    """A random motion in a random scene whose clearance is decided by at most a few millimetres.

    `moving` is the share of obstacles that move and turn.
    """
    while True:
        motion = random_motion(rng)
        required = float(rng.choice([0.0, 0.0, 0.0, 0.004]))
        sweep = Sweep(motion)
        obstacles = [
            obstacle
            for _ in range(rng.integers(1, 4))
            if (
                obstacle := sweep.pushed(
                    random_obstacle(rng, motion.scene.n_dims, moving), required + offset_of(rng), rng
                )
            )
        ]
        if rng.random() < 0.15:
            obstacles.append(sweep.thin_wall(rng))
        data = scene_data(motion.scene) | {"obstacles": [o for o in obstacles if o]}
        data["limits"] = {"clearance": required}
        if rng.random() < 0.15:
            data["workspace"] = sweep.tight_workspace(required + offset_of(rng), rng)
        try:
            return on_scene(motion, data)
        except SceneError:  # an end is in contact: such scenes are refused
            continue


def with_turning_obstacles(motion, rng, more=(), folder=None):
    """The motion on its scene with obstacles that move and turn, and `more`; None where an end is in contact."""
    data = scene_data(motion.scene)
    data["obstacles"] = [o | {"motion": random_turn(rng, 3)} for o in [*data["obstacles"], *more]]
    try:
        return on_scene(motion, data, folder)
    except SceneError:
        return None


def perturbed(motion, rng):
    """A solved motion, its weights scaled and shaken: most pass their obstacles by little or touch them."""
    scale = 1.0 + rng.choice([0.0, 0.003, 0.02, 0.1]) * rng.standard_normal((motion.weights.shape[0], 1))
    noise = rng.choice([0.0, 0.0003, 0.001, 0.004]) * rng.standard_normal(
        (motion.coordinates.search.shape[1], motion.weights.shape[1])
    )
    return replace(motion, weights=scale * motion.weights + motion.coordinates.search @ noise)


def scene_data(scene):
    """What a scene's file says, as plain data; hands where the scene moved them."""
    data = scene.file.model_dump()
    for manipulator, start, goal in zip(data["manipulators"], scene.start, scene.goal, strict=True):
        manipulator["start"], manipulator["goal"] = start.tolist(), goal.tolist()
    return data


def random_obstacle(rng, n_dims, moving=0.0):
    """An obstacle without a place, turned anyhow; boxes may be thin, and a share of all is moving."""
    shapes = ["box", "box", "sphere", "capsule", "ellipsoid", "cylinder"]
    shape = str(rng.choice(shapes[: 5 if n_dims == 2 else 6]))
    obstacle = {"shape": shape, "center": [0.0] * n_dims}
    length = lambda *n: rng.uniform(0.02, 0.15, n).tolist() if n else float(rng.uniform(0.02, 0.15))  # noqa: E731
    if shape == "box":
        obstacle["size"] = length(n_dims)
        if rng.random() < 0.5:
            obstacle["size"][rng.integers(n_dims)] = float(rng.uniform(0.0005, 0.004))
    elif shape == "ellipsoid":
        obstacle["radii"] = length(n_dims)
    else:
        obstacle["radius"] = length()
    if shape == "capsule":
        obstacle["length"] = length()
    if shape == "cylinder":
        obstacle["height"] = length()
    if shape != "sphere":
        if n_dims == 2:
            obstacle["rotation_deg"] = float(rng.uniform(-180, 180))
        else:
            x, y, z, w = Rotation.random(random_state=int(rng.integers(2**31))).as_quat()
            obstacle["quaternion_wxyz"] = [w, x, y, z]
    if moving and rng.random() < moving:
        obstacle["motion"] = random_turn(rng, n_dims)
    return obstacle


def random_turn(rng, n_dims):
    """A turn, slow or fast, about the centre or a hinge, of what stands, goes straight or on a circle."""
    turn = {"rate_deg_per_s": float(rng.choice([-1, 1]) * 10 ** rng.uniform(0.5, 3.0))}
    if n_dims == 3:
        turn["axis"] = rng.standard_normal(3).tolist()
    if rng.random() < 0.5:
        turn["hinge"] = rng.uniform(-0.1, 0.1, n_dims).tolist()
    circle = {"radius": float(rng.uniform(0.02, 0.1)), "period_s": float(rng.uniform(1.0, 6.0))}
    paths = [{}, {}, {"velocity": rng.uniform(-0.05, 0.05, n_dims).tolist()}, {"circle": circle}]
    return paths[rng.integers(4)] | {"turn": turn}


def as_told(obstacle):
    """An obstacle of a file's plain data as `brute_force` takes it."""
    motion = obstacle.get("motion")
    if motion is not None:
        keys = dict.fromkeys(("velocity", "waypoints", "times", "circle"))
        turn = SimpleNamespace(**{"axis": None, "hinge": None, **motion["turn"]})
        circle = SimpleNamespace(**motion["circle"]) if "circle" in motion else None
        motion = SimpleNamespace(**keys | motion | {"turn": turn, "circle": circle})
    return SimpleNamespace(**obstacle | {"motion": motion})


class Sweep:
    """Points of the body at many times, array of shape (n_times, n_edges, n_shares, n_dims)."""

    def __init__(self, motion):
        self.time = np.linspace(0.0, motion.scene.duration, brute_force.COARSE + 1)
        a, b, self.radii = brute_force.body_of(motion.scene, brute_force.hands_at(motion))
        self.hands = a[:, -1]
        shares = np.linspace(0.0, 1.0, 9)[:, None]
        self.points = a[:, :, None] + shares * (b - a)[:, :, None]

    def pushed(self, obstacle, offset, rng):
        """`obstacle` moved towards the sweep until `offset` [m] away, None where the ends are in the way."""
        towards = self._direction(rng)
        target = self.points[rng.integers(200, 1400), rng.integers(len(self.radii)), rng.integers(9)]
        center = target - 0.6 * towards
        points, radii = self.points[::8, :, ::2], self.radii[:, None]
        for _ in range(12):
            obstacle["center"] = center.tolist()
            apart = brute_force.obstacle_distance(as_told(obstacle), points, self.time[::8])
            distance = (apart - radii).min()
            center = center + (distance - offset) * towards
            if abs(distance - offset) < 1e-6:
                break
        apart = brute_force.obstacle_distance(as_told(obstacle), self.points[[0, -1]], self.time[[0, -1]])
        ends = apart - radii
        return obstacle if ends.min() > 0.0 else None

    def thin_wall(self, rng):
        """A wall of a millimetre or two across the way of a hand, in its middle."""
        k = int(rng.integers(300, 900))
        forward = self.hands[k + 1] - self.hands[k]
        size = np.linalg.norm(forward)
        if size == 0.0:
            return None
        n_dims = len(forward)
        wall = {"shape": "box", "center": self.hands[k].tolist()}
        wall["size"] = [float(rng.uniform(0.0005, 0.002)), *rng.uniform(0.002, 0.1, n_dims - 1).tolist()]
        if n_dims == 2:
            wall["rotation_deg"] = float(np.rad2deg(np.arctan2(forward[1], forward[0])))
        else:
            x, y, z, w = Rotation.align_vectors([forward / size], [[1.0, 0.0, 0.0]])[0].as_quat()
            wall["quaternion_wxyz"] = [w, x, y, z]
        distance = brute_force.obstacle_distance(SimpleNamespace(**wall), self.points[[0, -1]])
        return wall if (distance - self.radii[:, None]).min() > 0.01 else None

    def tight_workspace(self, offset, rng):
        """A workspace whose border is `offset` [m] from the sweep on one side."""
        n_dims = self.points.shape[-1]
        lower, upper = [WIDE[0]] * n_dims, [WIDE[1]] * n_dims
        axis, points = int(rng.integers(n_dims)), self.points
        if rng.random() < 0.5:
            lower[axis] = float((points[..., axis].min(axis=2) - self.radii).min()) - offset
        else:
            upper[axis] = float((points[..., axis].max(axis=2) + self.radii).max()) + offset
        return {"lower": lower, "upper": upper}

    def _direction(self, rng):
        direction = rng.standard_normal(self.points.shape[-1])
        return direction / np.linalg.norm(direction)


def offset_of(rng):
    """How near an obstacle comes [m]: hardly touching more often than not."""
    kind = rng.random()
    if kind < 0.65:
        return float(rng.uniform(0.0, 0.002))
    return float(rng.uniform(-0.002, 0.0)) if kind < 0.8 else float(rng.uniform(0.002, 0.02))


def _empty_scene(rng, n_dims, load):
    held = {"bar": [BAR], "pairs": [BAR, 0.8 * BAR], "frame": [TRIANGLE], "polygon": [BAR], "rail": [RAIL]}
    held |= {"hands": [np.zeros((1, 3))] * int(rng.integers(1, 4)), "bar and hand": [BAR, np.zeros((1, 3))]}
    ends = []
    for middle in (0.2, 0.8):
        hands = []
        for grasps in held[load]:
            turn = _turn(rng, n_dims)
            hands.append((grasps @ turn.T)[:, :n_dims] + rng.uniform(0.2, 0.8, n_dims))
            hands[-1][:, 0] += middle - hands[-1][:, 0].mean()
        ends.append(np.concatenate(hands))
    names = "abcdef"[: len(ends[0])]
    scene = {
        "name": load,
        "duration": float(rng.choice([2.0, 10.0])),
        "workspace": {"lower": [WIDE[0]] * n_dims, "upper": [WIDE[1]] * n_dims},
        "manipulators": [
            {"name": name, "start": start.tolist(), "goal": goal.tolist()}
            for name, start, goal in zip(names, *ends, strict=True)
        ],
    }
    thick = {"radius": float(rng.choice([0.0, 0.012]))}
    if load.startswith("bar"):
        overhang, held_by = float(rng.choice([0.0, 0.04])), [["a", "b"], ["b", "a"]][rng.integers(2)]
        scene["load"] = {"shape": "bar", "length": 0.2, "overhang": overhang, "held_by": held_by, **thick}
    elif load == "rail":
        scene["load"] = {"shape": "frame", "edges": [["a", "c"]], **thick}
    elif load == "frame":
        scene["load"] = {"shape": "frame", "edges": [["a", "b"], ["b", "c"], ["c", "a"]], **thick}
    elif load == "polygon":
        low = float(rng.choice([0.0, -0.02]))  # grasps about the frame's origin, or not
        grasps = {"a": [-0.1, low], "b": [0.1, low]}
        vertices = [[-0.12, -0.04], [0.12, -0.04], [0.06, 0.07], [-0.06, 0.05]]
        scene["load"] = {"shape": "polygon", "vertices": vertices, "grasps": grasps, **thick}
    elif load == "pairs":
        pairs = (("a", "b", 0.2), ("c", "d", 0.16))
        scene["constraints"] = [{"type": "distance", "between": [a, b], "distance": d} for a, b, d in pairs]
    return scene


def _turn(rng, n_dims):
    if n_dims == 3:
        return Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    angle = rng.uniform(-np.pi, np.pi)
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
