"""Robots that tilt their payloads, in scenes sampled around witnesses.

    python benchmarks/tilting.py                          # 60 scenes
    python benchmarks/tilting.py --seed 3 --count 12      # other scenes, and fewer
    python benchmarks/tilting.py --count 10 --places pr2 --kinds slot

Scenes are solved, verified and played in MuJoCo. Planks, trays, boxes and a mesh are held by two or three arms from
one pose to another, one of which is tilted by 15 to 60 degrees, through another tilted pose. A *slot* are two slabs
along the payload on the path, a *hatch* two plates across it, a *shelf* two slabs along it at its goal; all are so
near to the payload that it would touch them if it were level there. The motion around which a scene is sampled, its
witness, is verified; no planner is involved. Seeds 0 to 99 are for tuning.
"""

from __future__ import annotations

import argparse
import tempfile
import time
import warnings
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from timing import print_head, print_row

import comove
from comove.data.carried import robot_of
from comove.dmp.basis import motion_basis
from comove.errors import SceneError
from comove.lab.bench.drawing import clutter
from comove.lab.bench.robot_drawing import N_BASIS, JointWitness
from comove.model import Scene
from comove.model.coordinates import load_coordinates
from comove.model.motion import CoordinatedMotion
from comove.planning import SceneKind
from comove.planning.configurations import configuration_space
from comove.planning.seeds import fit, targets_along
from comove.planning.solution import Progress
from comove.robots import RobotCarrier
from comove.robots.kernels import load_robot_kernels
from comove.sim import Weld, simulate
from comove.verification.verify import verify

Array = NDArray[np.float64]

KINDS = ("open", "slot", "hatch", "shelf")
PAYLOADS = ("plank", "tray", "box", "mesh")
DOWN = Rotation.from_matrix(np.diag([-1.0, 1.0, -1.0]))
THREE = str(Path(__file__).with_name("three_ur5.yaml"))
TILT = np.deg2rad([15.0, 60.0])  # of start or goal, and on the way
LEVEL = 0.17  # rad, of the other end
TURN = 0.4  # rad, of headings
DURATION, CLEARANCE, SPARE, RATE = 10.0, 0.005, 0.01, 20.0  # s, m, m, Hz
GAPS = np.arange(0.015, 0.1, 0.015)  # m, between a slab and the payload
THICK = 0.02  # m, of slabs and plates
HAND = 0.09  # m, beside a grasp that is left to the hand
NEAREST = 0.15  # m, between start and goal
TRIES = 60  # motions that are drawn for one scene, before its kind is drawn anew


@dataclass(frozen=True)
class Place:
    """Workspace of a robot with payloads.

    Attributes
    ----------
    robot, hands : its name, and its arms
    lower, upper : range of a payload's centre [m]
    apart : length of the payload between two end effectors, or its width where there are three [m]
    yaw : heading of its x axis [rad]
    offsets : rotations of the end effectors on it about the vertical, by arm [rad]
    mass : of a payload [kg]
    """

    robot: str
    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    apart: float
    mass: float
    yaw: float = 0.5 * np.pi
    hands: tuple[str, ...] = ("left", "right")
    offsets: tuple[float, ...] = (0.0, 0.0)

    def size(self, payload: str) -> Array:
        """Return the sides of a payload [m]; array, shape (3,)."""
        wide, high = {"plank": (0.08, 0.025), "tray": (0.24, 0.03), "box": (0.14, 0.1), "mesh": (0.16, 0.06)}[
            payload
        ]
        return np.array([self.apart + 0.04, self.apart + 0.04 if len(self.hands) > 2 else wide, high])

    def grasps(self, size: Array) -> dict[str, Array]:
        """Return the grasps on the upper side of a payload [m]."""
        if len(self.hands) == 2:
            places = [(0.5 * self.apart, 0.0), (-0.5 * self.apart, 0.0)]
        else:
            angles = np.pi + 2 * np.pi / 3 * np.arange(len(self.hands))
            places = [(0.5 * self.apart * np.cos(a), 0.5 * self.apart * np.sin(a)) for a in angles]
        return {name: np.array([*xy, 0.5 * size[2]]) for name, xy in zip(self.hands, places, strict=True)}


PLACES = {
    place.robot: place
    for place in (
        Place("two_pandas", (0.35, -0.15, 0.2), (0.6, 0.15, 0.55), 0.5, 0.6, offsets=(np.pi, np.pi)),
        Place("ur5_and_panda", (-0.1, -0.1, 0.2), (0.35, 0.1, 0.5), 0.4, 0.6, offsets=(0.0, np.pi)),
        Place("pr2", (0.5, -0.1, 0.65), (0.65, 0.1, 1.0), 0.45, 0.4),
        Place("two_ur10", (0.5, -0.2, 0.2), (0.85, 0.2, 0.6), 0.6, 1.0),
        Place(
            THREE,
            (-0.1, -0.1, 0.2),
            (0.1, 0.1, 0.45),
            0.36,
            1.0,
            0.0,
            ("a", "b", "c"),
            (np.pi, -np.pi / 3, np.pi / 3),
        ),
    )
}


def tilted(rng: np.random.Generator, place: Place, least: float, most: float) -> Rotation:
    """Sample an orientation of a payload, tilted about any horizontal axis."""
    about = rng.uniform(-np.pi, np.pi)
    axis = np.array([np.cos(about), np.sin(about), 0.0])
    heading = Rotation.from_rotvec([0.0, 0.0, place.yaw + rng.uniform(-TURN, TURN)])
    return Rotation.from_rotvec(rng.uniform(least, most) * axis) * heading


def quaternion(turn: Rotation) -> list[float]:
    x, y, z, w = turn.as_quat().tolist()
    return [w, x, y, z]


@dataclass
class Draft:
    """Scene during sampling."""

    name: str
    place: Place
    payload: str
    kind: str
    rng: np.random.Generator
    folder: Path
    poses: list[tuple[Array, Rotation]] = field(default_factory=list)
    obstacles: list[dict[str, Any]] = field(default_factory=list)

    @property
    def size(self) -> Array:
        return self.place.size(self.payload)

    def drawn(self) -> JointWitness | None:
        """Sample poses and obstacles; return the witness, or None if infeasible."""
        rng, place = self.rng, self.place
        ends = [tilted(rng, place, 0.0, LEVEL), tilted(rng, place, *TILT)]
        if self.kind != "shelf" and rng.random() < 0.5:
            ends.reverse()
        turns = [ends[0], tilted(rng, place, *TILT), ends[1]]
        start, between, goal = ((rng.uniform(place.lower, place.upper), turn) for turn in turns)
        self.obstacles, self.poses = [], [start, between, goal]
        if self.kind != "open":  # straight through, or in
            middle, turn = goal if self.kind == "shelf" else between
            along = turn.apply([0.0, rng.choice([-1.0, 1.0]), 0.0])
            near = 0.5 * self.size[1] + 0.03
            away = near + rng.uniform(0.03, 0.12, 2)
            ways = [side * along for side in (-1.0, 1.0)]
            outside = [middle + r * way + rng.normal(0.0, 0.03, 3) for way, r in zip(ways, away, strict=True)]
            inside = [(middle + near * way, turn) for way in ways]
            self.poses = [(outside[0], start[1]), inside[0], inside[1], (outside[1], goal[1])]
            if self.kind == "shelf":
                self.poses[2:] = [goal]
        if np.linalg.norm(self.poses[-1][0] - self.poses[0][0]) < NEAREST:
            return None
        witness = self.moved()
        if witness is None or (self.kind != "open" and not self.narrow(witness)):
            return None
        for _ in range(int(rng.integers(1, 3))):
            self.clutter(witness)
        return witness if self.clear(witness, self.obstacles) else None

    def data(self, first: int = 0, last: int = -1) -> dict[str, Any]:
        """Return the scene file's contents, from one pose to another."""
        place, size, names = self.place, self.size, self.place.hands
        grasps = place.grasps(size)
        ends = {"start": self.poses[first], "goal": self.poses[last]}
        load: dict[str, Any] = {"shape": "box", "size": size.round(6).tolist()}
        if self.payload == "mesh":
            load = {"shape": "mesh", "file": wedge(size, self.folder)}
        load |= {"mass": place.mass, "grasps": {name: grasps[name].tolist() for name in names}}
        load |= {
            end: {"position": p.tolist(), "quaternion_wxyz": quaternion(turn)}
            for end, (p, turn) in ends.items()
        }
        frames = [Rotation.from_rotvec([0.0, 0.0, offset]) * DOWN for offset in place.offsets]
        return {
            "name": self.name,
            "duration": DURATION,
            "robot": place.robot,
            "grasp": {"frames": {name: quaternion(f) for name, f in zip(names, frames, strict=True)}},
            "workspace": {
                "lower": [x - 0.6 for x in place.lower[:2]] + [0.02],
                "upper": [x + 0.6 for x in place.upper],
            },
            "obstacles": self.obstacles,
            "load": load,
            "manipulators": [
                {"name": name}
                | {end: (p + turn.apply(grasps[name])).tolist() for end, (p, turn) in ends.items()}
                for name in names
            ],
            "limits": {"speed": 0.5, "acceleration": 1.0, "clearance": CLEARANCE},
        }

    def scene(self, **changes: Any) -> Scene:
        return Scene.from_dict(self.data() | changes, folder=self.folder)

    def moved(self) -> JointWitness | None:
        """Return a motion along the poses without obstacles, or None."""
        try:
            scene = self.scene()
            path = [
                load_coordinates(Scene.from_dict(self.data(k, k + 1), folder=self.folder)).boundary()[0]
                for k in range(len(self.poses) - 1)
            ]
            carrier = RobotCarrier(robot_of(scene), scene)
            carrier.require_reach()
        except SceneError:
            return None
        coordinates = load_coordinates(scene)
        path.append(coordinates.boundary()[2])
        for before, after in zip(path, path[1:], strict=False):
            after[3:] *= np.sign(before[3:] @ after[3:])
        target = targets_along(configuration_space(scene, coordinates), np.array(path), gentle=True)[-1:]
        dmp, weights = fit(target, target[0, -1], coordinates, motion_basis(N_BASIS, "jerk"), scene)
        motion = CoordinatedMotion(scene, coordinates, dmp.basis, dmp.boundary, weights[2])
        if verify(motion).verified is None or (dmp.boundary != coordinates.boundary()).any():
            return None  # witnesses begin and end as coordinates do
        joints, miss = carrier.track(motion)
        if miss is not None:
            return None
        time = np.linspace(0.0, scene.duration, round(RATE * scene.duration) + 1)
        witness = JointWitness(motion.weights, joints.curve(time))
        return witness if self.clear(witness, []) else None

    def clear(self, witness: JointWitness, obstacles: list[dict[str, Any]]) -> bool:
        """Return whether a witness keeps clear, with a margin."""
        try:
            scene = self.scene(obstacles=obstacles)
        except SceneError:
            return False
        return witness.judged(scene.limited(clearance=SPARE), slack=1.0).verified is not None

    def narrow(self, witness: JointWitness) -> bool:
        """Add two slabs or plates that require a tilted payload."""
        at = 1.0 if self.kind == "shelf" else self.rng.uniform(0.4, 0.6)
        motion = witness.motion(self.scene())
        q = motion.at([at])[0, 0]
        center, turn = q[:3], Rotation.from_quat(np.roll(q[3:], -1))
        size, grasps = self.size, np.array(list(self.place.grasps(self.size).values()))
        long = 2.0 * (np.abs(grasps[:, 0]).min() - HAND)
        tall = self.rng.uniform(0.06, 0.15) if self.kind == "hatch" else THICK
        deep = THICK if self.kind == "hatch" else 0.06
        slab = np.array([max(long, 0.05), deep, tall])
        for gap in GAPS:
            off = 0.5 * (size[2] + tall) + gap
            pair = [
                {
                    "shape": "box",
                    "center": (center + turn.apply([0.0, 0.0, side * off])).tolist(),
                    "size": slab.tolist(),
                    "quaternion_wxyz": quaternion(turn),
                }
                for side in (-1.0, 1.0)
            ]
            if self.clear(witness, pair):
                self.obstacles = pair
                return self.touches_level(center, pair)
        return False

    def touches_level(self, center: Array, obstacles: list[dict[str, Any]]) -> bool:
        """Return whether a level payload touches something with every heading."""
        scene, nearest = self.scene(obstacles=obstacles), []
        for heading in np.linspace(-np.pi, np.pi, 24, endpoint=False):
            nodes = scene.nodes_at("start").copy()
            group = scene.groups[0]
            nodes[scene.nodes_of_groups[0]] = center + Rotation.from_rotvec([0, 0, heading]).apply(
                group.points
            )
            nearest.append(scene.clearance_at(nodes)[0])
        return max(nearest) < CLEARANCE

    def clutter(self, witness: JointWitness) -> None:
        """Add an obstacle near the witness, where there is room."""
        motion, rng = witness.motion(self.scene()), self.rng
        for _ in range(4):
            q = motion.at([rng.uniform(0.1, 0.9)])[0, 0]
            near = q[:3] + rng.normal(0.0, 0.2, 3)
            placed = clutter(rng, near.round(3), rng.uniform(0.02, 0.05))
            if self.clear(witness, [*self.obstacles, placed]):
                self.obstacles = [*self.obstacles, placed]
                return


def wedge(size: Array, folder: Path) -> str:
    """Write a non-convex trough; return its file name. Its walls are on both long sides."""
    name, (x, y, z), wall = f"trough_{size[0]:g}_{size[1]:g}.obj", 0.5 * size, 0.012
    profile = [
        (-y, -z),
        (y, -z),
        (y, z),
        (y - wall, z),
        (y - wall, wall - z),
        (wall - y, wall - z),
        (wall - y, z),
        (-y, z),
    ]
    points = [(side * x, b, c) for side in (-1, 1) for b, c in profile]
    n = len(profile)
    faces = [(k, (k + 1) % n, n + (k + 1) % n, n + k) for k in range(n)]
    caps = [(0, 7, 6, 5), (0, 5, 4, 1), (1, 4, 3, 2)]
    faces += [*caps, *(tuple(n + i for i in reversed(cap)) for cap in caps)]
    lines = [f"v {a:.6f} {b:.6f} {c:.6f}" for a, b, c in points]
    lines += ["f " + " ".join(str(i + 1) for i in face) for face in faces]
    (folder / name).write_text("\n".join(lines) + "\n")
    return name


def scenes(options: argparse.Namespace, folder: Path):
    """Yield drafts with their witnesses, alternating place, payload and kind."""
    places = [
        place for name, place in PLACES.items() if not options.places or Path(name).stem in options.places
    ]
    for number in range(options.count):
        place = places[number % len(places)]
        rng = np.random.default_rng([options.seed, number])
        while True:
            kind, payload = str(rng.choice(options.kinds)), str(rng.choice(PAYLOADS))
            draft = Draft(f"{Path(place.robot).stem}-{number:02d}", place, payload, kind, rng, folder)
            witness = next(filter(None, (draft.drawn() for _ in range(TRIES))), None)
            if witness is not None:
                yield draft, witness
                break


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=100, help="of the scenes")
    parser.add_argument("--places", nargs="+", help="robots; all of them unless given")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--draw", action="store_true", help="draw scenes only")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    print_head(["scene", "payload", "kind", "verified", "first [s]", "all [s]", "delivered", "why not"])
    total = defaultdict(lambda: np.zeros(3, dtype=int))
    with tempfile.TemporaryDirectory() as folder:
        for draft, _ in scenes(options, Path(folder)):
            result = ["-", np.nan, np.nan, "-", ""] if options.draw else solved(draft)
            print_row(
                [
                    draft.name,
                    draft.payload,
                    draft.kind,
                    *result[:1],
                    *(f"{x:.1f}" for x in result[1:3]),
                    *result[3:],
                ]
            )
            total[Path(draft.place.robot).stem] += [1, result[0] == "yes", result[3] == "yes"]
    print_head(["robot", "witnessed", "solved", "delivered"])
    for robot, counts in total.items():
        print_row([robot, *counts])
    print_row(["all", *sum(total.values())])


def solved(draft: Draft) -> list[Any]:
    """Solve and play a scene; return its table row."""
    scene = draft.scene()
    robot, first = robot_of(scene), [np.nan]
    load_robot_kernels(SceneKind.of(scene))
    begun = time.perf_counter()

    def told(progress: Progress) -> None:
        if np.isnan(first[0]) and progress.best is not None:
            first[0] = time.perf_counter() - begun

    found = comove.solve(scene, robot=robot, progress=told)
    spent = time.perf_counter() - begun
    if found.joints.motion is None:
        return ["no", first[0], spent, "-", found.reasons[0]]
    played = simulate(found.joints.attempt, scene, robot, Weld())
    return ["yes", first[0], spent, "yes" if played.delivered else "no", "; ".join(played.reasons)]


if __name__ == "__main__":
    main()
