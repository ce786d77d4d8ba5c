"""Random motions of boxes next to random obstacles, and their true clearance by points, or by coal.

The judges here place the box by the hands and the scene *file* alone. That by points meets what it finds, so it is an
upper bound; near its end it looks every thousandth of a knot's interval and every hundredth of a millimetre.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from comove.dmp.basis import motion_basis
from comove.errors import SceneError
from comove.geometry.solids import solid_at, solid_distance
from comove.model import Scene, load_coordinates
from comove.model.motion import CoordinatedMotion
from tests import brute_force

from .random_motions import WIDE, on_scene, random_obstacle, scene_data

TIMES = 201  # of a first look
WINDOW = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, 5)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
KEPT, ROUNDS = 12, 14  # times that are looked at more closely, and how often windows shrink
HOLDS = {
    "one hand": {"a": [0.0, 0.0, 0.06]},
    "two hands": {"a": [0.14, 0.01, 0.04], "b": [-0.14, 0.01, 0.04]},
    "three hands": {"a": [0.12, 0.06, 0.04], "b": [-0.12, 0.06, 0.04], "c": [0.0, -0.12, 0.0]},
}


def random_box_motion(rng, hold=None):
    """A random motion of a box, in an empty scene."""
    hold = hold or str(rng.choice(list(HOLDS), p=[0.15, 0.5, 0.35]))
    grasps, ends = HOLDS[hold], []
    size = np.exp(rng.uniform(np.log(0.01), np.log(0.4), 3))
    for middle in (0.2, 0.8):
        turn = Rotation.random(random_state=int(rng.integers(2**31)))
        if hold != "three hands":
            turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi))
        ends.append(turn.apply(list(grasps.values())) + [middle, *rng.uniform(0.2, 0.8, 2)])
    scene = Scene.from_dict(
        {
            "name": "box",
            "duration": 10.0,
            "workspace": {"lower": [WIDE[0]] * 3, "upper": [WIDE[1]] * 3},
            "load": {"shape": "box", "size": size.tolist(), "grasps": grasps},
            "manipulators": [
                {"name": name, "start": start.tolist(), "goal": goal.tolist()}
                for name, start, goal in zip(grasps, *ends, strict=True)
            ],
            "constraints": [{"type": "upright"}] if hold == "two hands" else [],
        }
    )
    coordinates, basis = load_coordinates(scene), motion_basis(20, "velocity")
    sigma = rng.choice([0.005, 0.02, 0.06, 0.2], p=[0.3, 0.3, 0.3, 0.1])
    z = sigma * rng.standard_normal((coordinates.search.shape[1], basis.n_basis))
    turn = int(rng.choice([0, 0, 1, -1]))
    return CoordinatedMotion(scene, coordinates, basis, coordinates.boundary(turn), coordinates.search @ z)


def box_near_contact(rng):
    """A random box motion past obstacles, whose clearance is decided by at most some millimetres."""
    while True:
        motion = random_box_motion(rng)
        obstacles = [obstacle for _ in range(rng.integers(1, 4)) if (obstacle := _pushed(motion, rng))]
        required = float(rng.choice([0.0, 0.0, 0.004]))
        data = scene_data(motion.scene) | {"obstacles": obstacles, "limits": {"clearance": required}}
        try:
            return on_scene(motion, data)
        except SceneError:  # an end is in contact: such scenes are refused
            continue


def _pushed(motion, rng):
    """An obstacle moved towards what the box sweeps until it is some offset away, by the kernels' distance."""
    obstacle, solid = random_obstacle(rng, 3), np.empty((4, 3))
    obstacle["center"] = rng.uniform(-2.0, 3.0, 3).tolist()
    scale = float(np.exp(rng.uniform(np.log(0.1), np.log(2.0))))
    for key in ("size", "radii", "radius", "length", "height"):
        if key in obstacle:
            obstacle[key] = (scale * np.array(obstacle[key])).tolist()
    data = scene_data(motion.scene)
    corners = motion.scene.body.solids[0]
    nodes = motion.coordinates.motion(motion.at(np.linspace(0, 1, 201)))[0]
    direction = nodes[rng.integers(40, 160), corners].mean(axis=0) - obstacle["center"]
    direction /= np.linalg.norm(direction)
    offset = float(rng.uniform(-0.001, 0.003)) if rng.random() < 0.8 else float(rng.uniform(0.003, 0.05))
    for _ in range(30):
        try:
            table = Scene.from_dict(data | {"obstacles": [obstacle]}).obstacles
        except SceneError:  # it is on the way to an end
            return None
        distance = np.inf
        for node in nodes:
            solid_at(node, corners, solid)
            distance = min(distance, solid_distance(table, 0, solid, distance, np.array([1.0, 0.0, 0.0]))[0])
        obstacle["center"] = (np.array(obstacle["center"]) + (distance - offset) * direction).tolist()
        if abs(distance - offset) < 1e-5:
            break
    return obstacle


# --- The truth ---


def poses(motion, s):
    """Centres (n, 3) and rotations (n, 3, 3) of the box at normalised times, from hands and grasps."""
    file, hands = motion.scene.file, brute_force.hands_at(motion, s)
    names = [m.name for m in file.manipulators]
    hands = hands[:, [names.index(name) for name in file.load.grasps]]
    grasps = np.array(list(file.load.grasps.values()))
    if len(grasps) == 1:
        turn = np.repeat(np.eye(3)[None], len(hands), axis=0)
    elif len(grasps) == 2:
        (x, y), line = (hands[:, 0] - hands[:, 1])[:, :2].T, grasps[0] - grasps[1]
        angle = np.arctan2(y, x) - np.arctan2(line[1], line[0])
        turn = Rotation.from_rotvec(np.outer(angle, [0.0, 0.0, 1.0])).as_matrix()
    else:
        held, wanted = grasps - grasps.mean(axis=0), hands - hands.mean(axis=1, keepdims=True)
        u, _, v = np.linalg.svd(np.einsum("ni,tnj->tij", held, wanted))
        sign = np.linalg.det(np.swapaxes(u @ v, -1, -2))
        v[:, 2] *= sign[:, None]
        turn = np.swapaxes(u @ v, -1, -2)
    return hands.mean(axis=1) - turn @ grasps.mean(axis=0), turn


def least_clearance(motion):
    """The least clearance [m] that points of the box and the hands meet.

    For every obstacle, the nearest point of the box at every coarse time, by a window of points that shrinks about
    the best of them (the distance is convex over the box); then the same in time and space about the lowest.
    """
    scene, half = motion.scene, 0.5 * np.array(motion.scene.file.load.size)
    hands = brute_force.hands_at(motion, np.linspace(0.0, 1.0, 40 * TIMES))
    center, turn = poses(motion, np.linspace(0.0, 1.0, TIMES))
    corners = center[:, None] + (WINDOW * half) @ np.swapaxes(turn, -1, -2)
    lower, upper = np.array(scene.file.workspace.lower), np.array(scene.file.workspace.upper)
    least = min(
        brute_force.point_clearance(scene, hands).min(), (corners - lower).min(), (upper - corners).min()
    )
    for obstacle in scene.file.obstacles:
        when, where = np.linspace(0.0, 1.0, TIMES), np.zeros((TIMES, 3))
        when, where, distance = _closer(motion, obstacle, when, where, 0.0, 1.0)
        lowest = np.argsort(distance)[:KEPT]
        _, _, distance = _closer(motion, obstacle, when[lowest], where[lowest], 1.0 / (TIMES - 1), 0.2)
        least = min(least, distance.min())
    return float(least)


def _closer(motion, obstacle, when, where, step, reach):
    """Times (n,), shares of the half edges (n, 3) and distances (n,) [m] of points ever nearer to an obstacle."""
    half, rows = 0.5 * np.array(motion.scene.file.load.size), np.arange(len(when))
    for _ in range(ROUNDS):
        times = np.clip(when[:, None] + step * np.linspace(-1.0, 1.0, 5 if step else 1), 0.0, 1.0)
        shares = np.clip(where[:, None] + reach * WINDOW, -1.0, 1.0)
        center, turn = poses(motion, times.ravel())
        turn = np.swapaxes(turn.reshape(*times.shape, 3, 3), -1, -2)
        points = center.reshape(*times.shape, 1, 3) + (shares * half)[:, None] @ turn
        distance = brute_force.obstacle_distance(obstacle, points).reshape(len(when), -1)
        best = distance.argmin(axis=1)
        when, where = times[rows, best // len(WINDOW)], shares[rows, best % len(WINDOW)]
        step, reach = 0.5 * step, 0.6 * reach
    return when, where, distance.min(axis=1)


def least_by_coal(motion, coal):
    """The least distance [m] of the box from the obstacles by coal, at times ever closer about the least."""
    file = motion.scene.file
    shapes = {
        "box": lambda o: coal.Box(*o.size),
        "sphere": lambda o: coal.Sphere(o.radius),
        "capsule": lambda o: coal.Capsule(o.radius, o.length),
        "cylinder": lambda o: coal.Cylinder(o.radius, o.height),
        "ellipsoid": lambda o: coal.Ellipsoid(*o.radii),
    }
    load, request = coal.Box(*file.load.size), coal.DistanceRequest()
    request.gjk_tolerance = request.epa_tolerance = 1e-9
    least = np.inf
    for obstacle in file.obstacles:
        w, x, y, z = getattr(obstacle, "quaternion_wxyz", (1.0, 0.0, 0.0, 0.0))
        other = shapes[obstacle.shape](obstacle)
        place = coal.Transform3s(Rotation.from_quat([x, y, z, w]).as_matrix(), np.array(obstacle.center))
        s, step = np.linspace(0.0, 1.0, TIMES), 1.0 / (TIMES - 1)
        for _ in range(5):
            distances = np.array(
                [
                    coal.distance(
                        load, coal.Transform3s(turn, center), other, place, request, coal.DistanceResult()
                    )
                    for center, turn in zip(*poses(motion, s), strict=True)
                ]
            )
            least = min(least, float(distances.min()))
            lowest = s[np.argsort(distances)[:6]]
            s = np.unique(np.clip(lowest[:, None] + step * np.linspace(-1, 1, 9), 0.0, 1.0))
            step /= 4.0
    return least
