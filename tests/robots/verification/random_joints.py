"""Random joint motions of robots, near contact with an obstacle, a payload or themselves, and an independent judge.

The judge has links from the raw URDFs (`tests.robots.raw_links`), obstacles and payload from the scene's file
(`tests.brute_force`), joints from SciPy's spline, and distances from coal. What it finds at an instant is met there,
so it is an upper bound of the true clearance: nothing certified may lie above it. Where joints may deviate, it looks
for the corner of their box that brings the bodies nearest, joint by joint.
"""

from functools import cache
from typing import Any, NamedTuple

import coal
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from comove.model import Scene
from comove.model.files.keys import ROBOT_CLEARANCE
from comove.robots import JointMotion
from comove.robots.description import Uncertainty
from comove.robots.verification.bodies import LOAD, SCENE, SELF, bodies_of
from comove.robots.verification.carried import Carried
from comove.robots.verification.certificate import certify
from comove.robots.verification.kinematics import Bases
from tests import brute_force
from tests.robots.raw_links import SHAPES, RawLinks
from tests.robots.small_robots import robot
from tests.verification.random_motions import offset_of

NAMES = ("baxter", "two_ur10", "ur5_and_panda", "two_pandas", "two_fr3", "pr2", "two_xarm7")
LARGE = ("g1", "tiago_pro", "two_so101")  # whose meshes take long
DURATION, N_KNOTS = 2.0, 9  # s, and samples of the joints
COARSE, KEPT, PARTS, REFINEMENTS = (
    24,
    3,
    8,
    3,
)  # intervals of a first look, and how the lowest are looked at again
ASIDE = np.array([0.0, 0.0, 4.0])  # m, where nobody meets anything
FORWARD = np.array([0.3, 0.0, 0.0])  # m, from start to goal of a hand
ROUNDING = 1e-6  # m, of coal
LEVERS = (
    0.5,
    4.0,
)  # m, between which the sum of a body's lever arms is guessed, to bring bodies near in the end


class Body(NamedTuple):
    """A shape and its places at some instants: orientations (n, 3, 3), origins and middles (n, 3) [m]."""

    geometry: Any
    turns: Any
    places: Any
    middles: Any


class Draw(NamedTuple):
    """A robot's motion on a scene, and the kind of pairs that are near."""

    robot: Any
    scene: Any
    joints: Any
    kind: int


def robot_of(seed):
    """Name of the robot of a draw, by the draw's number."""
    return NAMES[seed % len(NAMES)] if seed % 20 else LARGE[seed // 20 % len(LARGE)]


@cache
def raw(name):
    """The links of a robot as its files have them."""
    return RawLinks(robot(name))


@cache
def movable(name):
    """Numbers in `raw` of the bodies that joints of the robot move."""
    home = robot(name).home
    both = zip(raw(name).bodies(home), raw(name).bodies(home + 0.1), strict=True)
    return frozenset(k for k, (a, b) in enumerate(both) if a[2] != b[2])


@cache
def own_pairs(name):
    """Pairs of links, by their numbers in `raw`, that the robot keeps apart."""
    number = {item: k for k, (item, *_) in enumerate(raw(name).bodies(robot(name).home))}
    model = robot(name).collision
    named = [
        (model.geometryObjects[p.first].name, model.geometryObjects[p.second].name)
        for p in model.collisionPairs
    ]
    return [(number[a], number[b]) for a, b in named if a in number and b in number]


def near_contact(rng, name, strays=0.0):
    """A random motion of a robot, and a scene in which it hardly touches something, or itself.

    Where joints may stray that far [rad, m], it is about as far away as they may bring it nearer.
    """
    machine, kind = robot(name), int(rng.choice([SCENE, SCENE, LOAD, SELF]))
    size, wanted = float(rng.choice([0.05, 0.2, 0.6, 1.5])), ROBOT_CLEARANCE + offset_of(rng)
    wanted += strays * rng.uniform(*LEVERS) - ROBOT_CLEARANCE if strays else 0.0
    away = rng.uniform(-1.0, 1.0, (N_KNOTS, len(machine.home)))

    def joints(share):
        """Joints that wander about home by some share of `size`."""
        q = np.clip(machine.home + share * size * away, machine.lower, machine.upper)
        return JointMotion(np.linspace(0.0, DURATION, N_KNOTS), machine.joint_names, q)

    if kind == SELF:
        scene, shares = _scene(machine, ASIDE, None), [0.0, 1.0]
        for _ in range(8):  # the share with which links come as near as wanted, if there is one
            middle = sum(shares) / 2
            near = least(name, Draw(machine, scene, joints(middle), kind), 0)[0]
            shares[near < wanted] = middle
        return Draw(machine, scene, joints(shares[0]), kind)
    motion, direction = joints(1.0), rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    first, *_, last = motion.position
    moved = [
        k
        for k, (a, b) in enumerate(zip(raw(name).bodies(first), raw(name).bodies(last), strict=True))
        if a[2] != b[2]
    ]
    _, geometry, pose, _ = raw(name).bodies(motion.position[rng.integers(N_KNOTS)])[rng.choice(moved)]
    center = pose.act(geometry.aabb_center) - 0.7 * direction
    obstacle = _obstacle(rng) if kind == SCENE else None
    scene = None
    for _ in range(8):
        scene = _scene(
            machine, ASIDE if kind == SCENE else center, obstacle and obstacle | {"center": center.tolist()}
        )
        near = least(name, Draw(machine, scene, motion, kind), 0)[0]
        center = center + (near - wanted) * direction
        if abs(near - wanted) < 1e-4:
            break
    return Draw(machine, scene, motion, kind)


def deviating(rng, name):
    """A draw of `near_contact`, and deviations of its joints: of all, of one alone, or of each another one."""
    largest, n = float(rng.choice([0.002, 0.01, 0.05])), len(robot(name).home)
    deviations = np.full(n, largest)
    if (kind := rng.integers(3)) == 1:
        deviations = np.where(np.arange(n) == rng.integers(n), largest, 1e-9)
    elif kind == 2:
        deviations = largest * rng.uniform(0.01, 1.0, n)
    return near_contact(rng, name, float(deviations.mean())), deviations


def least(name, draw, refinements=REFINEMENTS):
    """The least distance [m] of the draw's kind of pairs that is met, and its time [s]."""
    curve = CubicSpline(draw.joints.time, draw.joints.position, bc_type="clamped")
    times, found, step = np.linspace(0.0, DURATION, COARSE + 1), (np.inf, 0.0), DURATION / COARSE
    for _ in range(refinements + 1):
        bodies, pairs = _bodies(name, draw, curve, times)
        nearest = _nearest(bodies, pairs, len(times), KEPT if refinements else 1)
        k = int(nearest.argmin())
        found = min(found, (float(nearest[k]), float(times[k])))
        low = times[np.argsort(nearest)[:KEPT]]
        times = np.unique(np.clip(low[:, None] + step * np.linspace(-1, 1, 2 * PARTS + 1), 0.0, DURATION))
        step /= PARTS
    return found


def worst_corner(name, draw, time, deviations):
    """The least distance [m] that is met at an instant where joints deviate that much; array, shape (n_joints,)."""
    curve = CubicSpline(draw.joints.time, draw.joints.position, bc_type="clamped")

    def met(off):
        bodies, pairs = _bodies(name, draw, curve, np.array([time]), off)
        return float(_nearest(bodies, pairs, 1, 1)[0])

    off = np.zeros(len(deviations))
    found = met(off)
    for j in np.flatnonzero(deviations):
        for sign in (-1.0, 1.0):
            other = off.copy()
            other[j] = sign * deviations[j]
            if (near := met(other)) < found:
                found, off = near, other
    return found


def judged(name, draw, deviations=None):
    """What is certified [m], what is met [m], and the outcome in a word.

    `deviations` are those that joints may have from their commands; array, shape (n_joints,).
    """
    scene = draw.scene
    carried = Carried.straight(scene)
    arms = tuple(draw.robot.arm(arm) for arm in scene.manipulators)
    uncertainty, curve = draw.robot.description.uncertainty, draw.joints.curve
    if deviations is not None:
        uncertainty = Uncertainty(joints=dict(zip(draw.robot.joint_names, deviations.tolist(), strict=True)))
    bases, hands = Bases(draw.robot, uncertainty), carried.hands(carried.time).positions
    bodies = bodies_of(bases, arms, carried, hands, 1e-5, holding=(), curve=curve)
    bodies = bodies if deviations is None else bodies.deviating
    clearance, required = certify(bodies, carried, curve, 0.0)[draw.kind], bodies.required[draw.kind]
    met, time = least(name, draw)
    if deviations is not None:
        met = worst_corner(name, draw, time, deviations)
    word = "certified" if clearance.lower >= required else "contact" if met < required else "undecided"
    if clearance.lower > max(met, 0.0) + ROUNDING:
        word = "false certificate"
    return clearance, met, word


def _obstacle(rng):
    """A random obstacle of a scene's file, which moves and turns more often than not."""
    a, b, c = rng.uniform(0.02, 0.2, 3).tolist()
    data = [
        {"shape": "box", "size": [a, b, c]},
        {"shape": "sphere", "radius": a},
        {"shape": "capsule", "radius": a, "length": b},
        {"shape": "cylinder", "radius": a, "height": b},
    ][rng.integers(4)]
    if data["shape"] != "sphere":
        data["quaternion_wxyz"] = (
            Rotation.random(random_state=int(rng.integers(2**31))).as_quat()[[3, 0, 1, 2]].tolist()
        )
    if rng.random() < 0.6:
        motion = {"velocity": rng.uniform(-0.3, 0.3, 3).tolist()}
        if rng.random() < 0.5:
            motion["turn"] = {
                "axis": rng.standard_normal(3).tolist(),
                "rate_deg_per_s": float(rng.uniform(-90.0, 90.0)),
            }
        data["motion"] = motion
    return data


def _scene(machine, place, obstacle):
    """A scene in which two hands take a bar straight forward from a place [m]."""
    ends = [np.array(place) + [0.0, y, 0.0] for y in (0.15, -0.15)]
    data = {
        "name": "random",
        "duration": DURATION,
        "workspace": {"lower": [-4.5] * 3, "upper": [4.5] * 3},
        "load": {"shape": "bar", "length": 0.3, "radius": 0.02, "overhang": 0.05},
        "manipulators": [
            {"name": arm.name, "start": end.tolist(), "goal": (end + FORWARD).tolist()}
            for arm, end in zip(machine.arms, ends, strict=False)
        ],
        "obstacles": [obstacle] if obstacle else [],
    }
    return Scene.from_dict(data)


def _bodies(name, draw, curve, times, off=0.0):
    """Bodies at instants, and the pairs of them that are of the draw's kind; joints are off by so much [rad, m]."""
    placed = [raw(name).bodies(q) for q in curve(times) + off]
    bodies = []
    for k, (_, geometry, _, _) in enumerate(placed[0]):
        turns = np.array([row[k][2].rotation for row in placed])
        places = np.array([row[k][2].translation for row in placed])
        bodies.append(_body(geometry, turns, places))
    if draw.kind == SELF:
        return bodies, own_pairs(name)
    if draw.kind == SCENE:
        others = _obstacles(draw.scene, times)
    else:
        others = _rods(draw.scene, times, _hands_off(name, draw.scene, curve(times), off))
    at_rest = draw.kind == SCENE and draw.scene.file.obstacles[0].motion is None
    met = [k for k in range(len(bodies)) if not at_rest or k in movable(name)]
    return [*bodies, *others], [(k, len(bodies) + i) for k in met for i in range(len(others))]


def _obstacles(scene, times):
    return [_body(SHAPES[one.shape](one), *brute_force.placed(one, times)) for one in scene.file.obstacles]


def _hands_off(name, scene, joints, off):
    """By how much hands are displaced where joints are off; array, shape (n_times, 2, 3) [m]."""
    return np.array(
        [
            [
                raw(name).grasp(arm, q + off).translation - raw(name).grasp(arm, q).translation
                for arm in scene.manipulators
            ]
            for q in joints
        ]
    )


def _rods(scene, times, off):
    """The payload's rods; the hands take it straight at the pace of least jerk, and it goes along where they are off.

    It keeps its length then: its middle and its direction are those of the line between the hands.
    """
    s = times / DURATION
    pace = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    ends = [np.array([getattr(m, end) for m in scene.file.manipulators]) for end in ("start", "goal")]
    hands = ends[0] + pace[:, None, None] * (ends[1] - ends[0])
    a, b, radii = brute_force.body_of(scene, hands)
    lines, middles = np.diff(hands, axis=1), hands.mean(axis=1, keepdims=True)
    turned = np.diff(hands + off, axis=1)
    turned *= np.linalg.norm(lines, axis=2, keepdims=True) / np.linalg.norm(turned, axis=2, keepdims=True)
    along = [
        ((x - middles) * lines).sum(axis=2, keepdims=True) / (lines**2).sum(axis=2, keepdims=True)
        for x in (a, b)
    ]
    a, b = (middles + off.mean(axis=1, keepdims=True) + share * turned for share in along)
    rods = []
    for k in np.flatnonzero(np.linalg.norm(b[0] - a[0], axis=1)):
        axis, radius = b[:, k] - a[:, k], radii[k]
        turns = np.array([Rotation.align_vectors([x], [[0.0, 0.0, 1.0]])[0].as_matrix() for x in axis])
        rods.append(_body(coal.Capsule(radius, np.linalg.norm(axis[0])), turns, 0.5 * (a[:, k] + b[:, k])))
    return rods


def _body(geometry, turns, places):
    geometry.computeLocalAABB()
    return Body(geometry, turns, places, places + turns @ geometry.aabb_center)


def _nearest(bodies, pairs, n_times, kept):
    """The least distance [m] at each instant; array, shape (n_times,), exact at the `kept` lowest of them."""
    first, second = np.array(pairs).T
    middles, radii = np.array([b.middles for b in bodies]), np.array([b.geometry.aabb_radius for b in bodies])
    apart = np.linalg.norm(middles[first] - middles[second], axis=2) - (radii[first] + radii[second])[:, None]
    found = np.full(n_times, np.inf)
    for flat in np.argsort(apart, axis=None):
        pair, k = np.unravel_index(flat, apart.shape)
        if apart[pair, k] > np.partition(found, kept - 1)[kept - 1]:
            break
        if apart[pair, k] > found[k]:
            continue
        a, b = bodies[first[pair]], bodies[second[pair]]
        at = [coal.Transform3s(x.turns[k], x.places[k]) for x in (a, b)]
        answer = coal.DistanceResult()
        found[k] = min(
            found[k], coal.distance(a.geometry, at[0], b.geometry, at[1], coal.DistanceRequest(), answer)
        )
    return found
