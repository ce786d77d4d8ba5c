"""Robots carry a bar among obstacles: comove beside RoboPlan, whose planner knows constraints of relative poses.

    pip install roboplan-core roboplan-rrt roboplan-toppra
    python benchmarks/robots_peers.py                        # 5 scenes for each of 5 robots
    python benchmarks/robots_peers.py --scenes 2 --seed 600 --robots two_xarm7

Scenes are the robots' examples with start, goal and obstacles moved at random. RoboPlan gets the pairs of joints at
start and goal that comove works with, the likeliest first, two seconds for each; the load hangs on the first hand,
the second is held to it by a constraint, and others keep both level and in the workspace. Its own TOPP-RA times its
path. Both results are judged alike, by Pinocchio and coal at 1000 samples: no contact of exact bodies, limits of
joints, the load in its workspace within 5 mm, and hands within 1 mm and 5 mrad of the load, RoboPlan's own tolerance.
comove solves every scene twice, once on RoboPlan's terms, where bodies may nearly touch, and once with the scene's
clearance; both are verified besides, for every instant and in the scene's duration. A scene is *witnessed* where one
of the systems carries the load. The second table is what RoboPlan was made for: one arm alone goes from one end to
the other, without a load or a constraint. Times and budgets are of the processor, in seconds, but for RoboPlan's two
seconds; acceleration and jerk are root mean squares over all joints for a motion of unit duration, so that pace does
not count.
"""

from __future__ import annotations

import argparse
import tempfile
import time
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml
from numpy.typing import NDArray
from roboplan.core import (
    Box,
    Cylinder,
    JointConfiguration,
    Sphere,
    loadUrdfSceneDescriptionFromXml,
)
from roboplan.core import (
    Scene as PeerScene,
)
from roboplan.rrt import RRT, PoseConstraint, RRTOptions
from roboplan.toppra import PathParameterizerTOPPRA, TOPPRAOptions
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from comove.coordination.motion import CoordinatedMotion
from comove.planning import SceneKind
from comove.planning.clock import processor_time
from comove.planning.solution import Progress
from comove.robots import Robot, RobotCarrier, carry
from comove.robots.description import Placement
from comove.robots.free_space import Room, way
from comove.robots.kernels import load_robot_kernels
from comove.robots.urdf import for_pinocchio
from comove.robots.verification.bodies import LOAD, Bodies, bodies_of
from comove.robots.verification.carried import Carried, placements
from comove.robots.verification.reach import Bases
from comove.scenes import Scene

Array = NDArray[np.float64]
EXAMPLES = Path(__file__).parents[1] / "examples" / "robots"
ROBOTS = ("two_fr3", "two_pandas", "two_ur10", "two_xarm7", "ur5_and_panda")
BUDGET, EACH = 10.0, 2.0  # s, for a scene, and for one pair of joints
TOLERANCE = 1e-3, 5e-3  # m, rad
ROOM = 5e-3  # m, by which a load may leave its workspace


@dataclass(frozen=True)
class Outcome:
    """What a system found: joints at even times in unit duration, shape (n_samples, n_joints), None where nothing.

    `first` is the time to the first valid path, `whole` to the result [s of the processor]; `verified` whether
    comove's own verification holds.
    """

    joints: Array | None
    first: float
    whole: float
    verified: bool = False


def drawn(name: str, seed: int) -> Scene:
    """Return the robot's example with its ends and obstacles moved at random; always the same for a seed."""
    data = yaml.safe_load((EXAMPLES / f"{name}.yaml").read_text(encoding="utf-8"))
    rng = np.random.default_rng(seed)
    reach = np.array([0.04, 0.04, 0.02])
    for end in ("start", "goal"):
        shift = rng.uniform(-reach, reach)
        for hand in data["manipulators"]:
            hand[end] = (np.array(hand[end]) + shift).round(4).tolist()
    for obstacle in data["obstacles"]:
        shift = rng.uniform(-reach, reach) * [1.0, 1.0, 0.0]
        obstacle["center"] = (np.array(obstacle["center"]) + shift).round(4).tolist()
    return Scene.from_dict({**data, "name": f"{name} {seed}"})


def by_comove(scene: Scene, robot: Robot, seed: int) -> Outcome:
    """Solve a scene with comove."""
    begun, first = time.process_time(), [np.nan]

    def told(progress: Progress) -> None:
        if np.isnan(first[0]) and progress.best is not None:
            first[0] = time.process_time() - begun

    with processor_time():
        found = carry(scene, robot, seed=seed, budget=BUDGET, progress=told)
    whole = time.process_time() - begun
    if not found.verified:
        return Outcome(None, np.nan, whole)
    times = np.linspace(0.0, found.joints.time[-1], 1000)
    return Outcome(found.joints.curve(times), first[0], whole, True)


def element(tag: str, /, **attributes: str) -> ET.Element:
    """Return an element of a URDF."""
    return ET.Element(tag, attributes)


def fixed(name: str, parent: str, child: str, pose: Array) -> ET.Element:
    """Return a fixed joint at a pose, array of shape (4, 4)."""
    joint = element("joint", name=name, type="fixed")
    x, y, z = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz").tolist()
    origin = element("origin", xyz=" ".join(map(repr, pose[:3, 3].tolist())), rpy=f"{x!r} {y!r} {z!r}")
    joint.extend([element("parent", link=parent), element("child", link=child), origin])
    return joint


def placed(base: Placement) -> Array:
    """Return the pose of a base; array, shape (4, 4)."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(base.quaternion_wxyz, scalar_first=True).as_matrix()
    pose[:3, 3] = base.position
    return pose


def whole_robot(carrier: RobotCarrier, q: Array) -> Array:
    """Return the joints of the whole robot from those of the holders."""
    whole = carrier.robot.home
    whole[np.concatenate([arm.columns for arm in carrier.holders])] = q
    return whole


class Peer:
    """A scene as RoboPlan sees it: one URDF of all models, the load on the first hand unless left out."""

    def __init__(self, scene: Scene, robot: Robot, carrier: RobotCarrier, *, loaded: bool):
        self.robot, self.arms = robot, carrier.holders
        nodes, count = scene.nodes_at("start"), len(scene.manipulators)
        beyond = np.linalg.norm(nodes[:, None] - nodes[None, :count], axis=2).min(axis=1).max()
        inset = float(scene.body.radii.max()) + np.array([beyond, beyond, 0.0])
        self.lower, self.upper = (
            scene.lower + inset,
            scene.upper - inset,
        )  # in which hands keep the load inside
        self.names = list(robot.joint_names)
        with tempfile.TemporaryDirectory() as folder:
            text = self._urdf(scene, carrier, Path(folder), loaded)
            self.scene = PeerScene("both", loadUrdfSceneDescriptionFromXml(text))
        self.scene.addGroup("all", self.names)
        for arm in self.arms:
            self.scene.addGroup(arm.name, [self.names[column] for column in arm.columns])
        bodies = [item.name.rpartition("_")[0] for item in robot.collision.geometryObjects]
        compared = {frozenset((bodies[p.first], bodies[p.second])) for p in robot.collision.collisionPairs}
        links = sorted(set(bodies))
        pairs = [(a, b) for k, a in enumerate(links) for b in links[:k] if frozenset((a, b)) not in compared]
        held = [
            body
            for body, item in zip(bodies, robot.collision.geometryObjects, strict=True)
            if self._is_hand(item)
        ]
        if loaded:
            pairs += [("load", body) for body in dict.fromkeys(held)]
        self.scene.setCollisions(pairs, False)
        self._add_obstacles(scene, [body for body in links if self._stands(body)])

    def _is_hand(self, item: Any) -> bool:
        lasts = {int(arm.columns[-1]) + 1 for arm in self.arms}
        return bool(lasts & set(self.robot.model.supports[item.parentJoint]))

    def _stands(self, body: str) -> bool:
        items = self.robot.collision.geometryObjects
        return all(item.parentJoint == 0 for item in items if item.name.rpartition("_")[0] == body)

    def _urdf(self, scene: Scene, carrier: RobotCarrier, folder: Path, loaded: bool) -> str:
        """Return one URDF of all models, whose joints outside the arms stay at 0."""
        whole = element("robot", name="both")
        whole.append(element("link", name="world"))
        for k, source in enumerate(self.robot.sources):
            own = folder / str(k)
            own.mkdir()
            model = ET.fromstring(for_pinocchio(source, own))
            children = {joint.find("child").get("link") for joint in model.findall("joint")}
            (root,) = (link.get("name") for link in model.findall("link") if link.get("name") not in children)
            for joint in model.findall("joint"):
                if joint.get("type") != "fixed" and joint.get("name") not in self.names:
                    joint.set("type", "fixed")
                    for part in joint.findall("mimic"):
                        joint.remove(part)
            whole.extend(list(model))
            whole.append(fixed(f"base {k}", "world", root, placed(source.base)))
        for arm in self.arms:
            whole.append(element("link", name=f"grasp_{arm.name}"))
            whole.append(fixed(f"to_{arm.name}", arm.tip, f"grasp_{arm.name}", arm.tool))
        if loaded:
            whole.extend(self._load(scene, carrier))
        return ET.tostring(whole, encoding="unicode")

    def _load(self, scene: Scene, carrier: RobotCarrier) -> list[ET.Element]:
        """Return the bar as a link on the first hand."""
        nodes, q = scene.nodes_at("start"), carrier._ends[0][0]
        ends = nodes[np.unique(scene.body.edges)]
        far = np.linalg.norm(ends[:, None] - ends[None], axis=2)
        a, b = ends[list(np.unravel_index(far.argmax(), far.shape))]
        pose = np.eye(4)
        pose[:3, 3] = 0.5 * (a + b)
        pose[:3, :3] = Rotation.align_vectors((b - a)[None], [[0.0, 0.0, 1.0]])[0].as_matrix()
        hand = self.robot.tool_pose(whole_robot(carrier, q), self.arms[0])
        link, body, shape = element("link", name="load"), element("collision"), element("geometry")
        shape.append(
            element("cylinder", radius=repr(float(scene.body.radii.max())), length=repr(float(far.max())))
        )
        body.append(shape)
        link.append(body)
        return [link, fixed("holds", f"grasp_{self.arms[0].name}", "load", np.linalg.inv(hand) @ pose)]

    def _add_obstacles(self, scene: Scene, standing: list[str]) -> None:
        color = np.array([0.5, 0.5, 0.5, 1.0])
        for k, obstacle in enumerate(scene.file.obstacles):
            pose = np.asfortranarray(np.eye(4))
            pose[:3, 3] = obstacle.center
            name, where = f"obstacle{k}", ("universe",)
            if obstacle.shape == "box":
                self.scene.addBoxGeometry(name, *where, Box(*obstacle.size), pose, color)
            elif obstacle.shape == "cylinder":
                shape = Cylinder(obstacle.radius, obstacle.height)
                self.scene.addCylinderGeometry(name, *where, shape, pose, color)
            else:
                self.scene.addSphereGeometry(name, *where, Sphere(obstacle.radius), pose, color)
            others = [f"obstacle{other}" for other in range(k)]
            self.scene.setCollisions([(name, body) for body in [*standing, *others]], False)

    def constraints(self, q: Array) -> list[PoseConstraint]:
        """Return what holds the second hand to the first, and the first level, as they are at joints q."""
        poses = [self.robot.tool_pose(q, arm) for arm in self.arms[:2]]
        frames = [f"grasp_{arm.name}" for arm in self.arms[:2]]
        none, turn = np.zeros(6), np.array([np.inf, np.inf, np.inf, 0.0, 0.0, np.inf])
        any_way = np.full(3, np.inf)
        room = [np.append(self.lower, -any_way), np.append(self.upper, any_way)]
        world = np.asfortranarray(np.eye(4))
        apart = np.asfortranarray(np.linalg.inv(poses[0]) @ poses[1])
        level = np.asfortranarray(poses[0])
        return [
            PoseConstraint(
                self.scene,
                "all",
                frames[1],
                none,
                none,
                apart,
                frames[0],
                position_tolerance=TOLERANCE[0],
                orientation_tolerance=TOLERANCE[1],
            ),
            PoseConstraint(
                self.scene, "all", frames[0], -turn, turn, level, orientation_tolerance=TOLERANCE[1]
            ),
            *(PoseConstraint(self.scene, "all", frame, *room, world) for frame in frames),
        ]

    def plan(
        self, group: str, start: Array, goal: Array, seed: int, constraints: list[PoseConstraint]
    ) -> Any:
        """Return a path of a group of joints, None where there is none within the time for one pair."""
        options = RRTOptions(
            group_name=group,
            max_nodes=40_000,
            max_connection_distance=0.5,
            collision_check_step_size=0.05,
            max_planning_time=EACH,
            rrt_connect=True,
        )
        rrt = RRT(self.scene, options)
        rrt.setRngSeed(seed)
        ends = []
        for q in (start, goal):
            ends.append(JointConfiguration())
            ends[-1].positions = q
        try:
            return rrt.plan(*ends, constraints)
        except RuntimeError:  # it found none
            return None

    def timed(self, group: str, path: Any) -> Array:
        """Return the path at even times by TOPP-RA; array, shape (n_samples, n_joints of the group)."""
        options = TOPPRAOptions()
        options.dt = 0.005
        found = PathParameterizerTOPPRA(self.scene, group).generate(path, options)
        times = np.array(found.times)
        curve = CubicHermiteSpline(times, np.array(found.positions), np.array(found.velocities))
        return curve(np.linspace(times[0], times[-1], 1000))


def by_roboplan(scene: Scene, robot: Robot, carrier: RobotCarrier, seed: int) -> Outcome:
    """Solve a scene with RoboPlan."""
    peer, begun = Peer(scene, robot, carrier, loaded=True), time.process_time()
    for start, goal in carrier._ends:
        if time.process_time() - begun > BUDGET:
            break
        first, last = whole_robot(carrier, start), whole_robot(carrier, goal)
        path = peer.plan("all", first, last, seed, peer.constraints(first))
        if path is not None:
            done = time.process_time() - begun
            return Outcome(peer.timed("all", path), done, time.process_time() - begun)
    return Outcome(None, np.nan, time.process_time() - begun)


def bodies(scene: Scene, robot: Robot, carrier: RobotCarrier) -> Bodies:
    """Return the exact bodies of robot, obstacles and load."""
    carried = Carried(CoordinatedMotion.straight(scene))
    return bodies_of(
        Bases(robot, robot.description.uncertainty), carrier.holders, carried, scene.start[None], 0.0
    )


def flaws(scene: Scene, robot: Robot, carrier: RobotCarrier, joints: Array) -> str:
    """Return what is wrong with a carry at its samples, in words; nothing where all is well."""
    known, arms, model = bodies(scene, robot, carrier), carrier.holders[:2], robot.model
    data, of_bodies = model.createData(), known.geometry.createData()
    exact = known.exact == np.arange(len(known.exact))
    for number in np.flatnonzero(~exact).tolist():
        of_bodies.deactivateCollisionPair(number)
    held = [robot.tool_pose(joints[0], arm) for arm in arms]
    nodes = np.linalg.inv(held[0]) @ np.vstack(
        [scene.nodes_at("start").T, np.ones(len(scene.nodes_at("start")))]
    )
    if (joints < robot.lower - 1e-9).any() or (joints > robot.upper + 1e-9).any():
        return "limits"
    off = np.zeros(2)
    for q in joints:
        poses = [robot.tool_pose(q, arm) for arm in arms]
        error = np.linalg.inv(np.linalg.inv(held[0]) @ held[1]) @ np.linalg.inv(poses[0]) @ poses[1]
        turn = Rotation.from_matrix(error[:3, :3]).magnitude()
        off = np.maximum(off, [np.linalg.norm(error[:3, 3]), turn])
        pin.updateGeometryPlacements(model, data, known.geometry, of_bodies, q)
        here = (poses[0] @ nodes)[:3].T
        if (here < scene.lower - ROOM).any() or (here > scene.upper + ROOM).any():
            return "out of the workspace"
        for rod, *spanned in known.rods:
            (rotation,), (middle,) = placements(here[None], tuple(spanned))
            of_bodies.oMg[rod] = pin.SE3(rotation, middle)
        if pin.computeCollisions(known.geometry, of_bodies, True):
            return "contact"
    return "" if (off <= TOLERANCE).all() else f"hands off by {1e3 * off[0]:.1f} mm, {1e3 * off[1]:.1f} mrad"


def sizes(joints: Array) -> tuple[float, float]:
    """Return root mean squares of acceleration and jerk over all joints, in unit duration."""
    step = 1.0 / (len(joints) - 1)
    second, third = (np.diff(joints, order, axis=0) / step**order for order in (2, 3))
    return float(np.sqrt((second**2).mean())), float(np.sqrt((third**2).mean()))


def alone(scene: Scene, robot: Robot, carrier: RobotCarrier, seed: int) -> list[tuple[float, bool]]:
    """Move the first arm from one end to the other without a load: time and success of comove and RoboPlan."""
    start, goal = (whole_robot(carrier, q) for q in carrier._ends[0])
    arm = carrier.holders[0]
    goal = np.where(np.isin(np.arange(len(start)), arm.columns), goal, start)
    known = bodies(scene, robot, carrier)
    keep = known.kind != LOAD
    geometry = known.geometry.copy()
    for pair, kept in zip(known.geometry.collisionPairs, keep, strict=True):
        if not kept:
            geometry.removeCollisionPair(pair)
    number = np.cumsum(keep) - 1
    free = replace(
        known, geometry=geometry, kind=known.kind[keep], taken=known.taken[keep], reach=known.reach[keep],
        exact=number[known.exact[keep]], rods=(), required=np.zeros(3),
    )  # fmt: skip
    begun = time.process_time()
    room = Room.for_ends(free, scene, np.stack([start, goal]), None)
    path = way(room, start, goal, np.random.default_rng(seed))
    rows = [(time.process_time() - begun, path is not None)]
    peer, begun = Peer(scene, robot, carrier, loaded=False), time.process_time()
    peer.scene.setJointPositions(start)
    found = peer.plan(arm.name, start[arm.columns], goal[arm.columns], seed, [])
    return [*rows, (time.process_time() - begun, found is not None)]


def median(values: list[float]) -> str:
    """Return the median of what is known, in words."""
    known = [value for value in values if np.isfinite(value)]
    return f"{np.median(known):.3g}" if known else "-"


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0, help="seed of the first scene")
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    systems: dict[str, Callable[[Scene, Robot, RobotCarrier, int], Outcome]] = {
        "comove": lambda scene, robot, carrier, seed: by_comove(scene.limited(clearance=0.0), robot, seed),
        "RoboPlan": by_roboplan,
        "comove, clearance kept": lambda scene, robot, carrier, seed: by_comove(scene, robot, seed),
    }
    print(
        "| robot | witnessed | system | carried | first [s] | all [s] | acceleration | jerk | what was wrong |"
    )
    print("|---|---|---|---|---|---|---|---|---|", flush=True)
    singles: dict[str, list[list[tuple[float, bool]]]] = {}
    for name in options.robots:
        rows: dict[str, list[tuple[Outcome, str]]] = {system: [] for system in systems}
        for seed in range(options.seed, options.seed + options.scenes):
            scene = drawn(name, seed)
            robot = Robot.load(scene.file.robot)
            load_robot_kernels(SceneKind.of(scene))
            carrier = RobotCarrier(robot, scene)
            _ = carrier.arms  # capsules belong to the robot, as RoboPlan's model does, and not to a search
            for system, solve in systems.items():
                found = solve(scene, robot, carrier, seed)
                wrong = "none found" if found.joints is None else flaws(scene, robot, carrier, found.joints)
                rows[system].append((found, wrong))
            singles.setdefault(name, []).append(alone(scene, robot, carrier, seed))
        witnessed = sum(any(not rows[s][k][1] for s in systems) for k in range(options.scenes))
        for system, results in rows.items():
            good = [found for found, wrong in results if not wrong]
            smooth = [sizes(found.joints) for found in good]
            print(
                f"| {name} | {witnessed}/{options.scenes} | {system} | {len(good)} "
                f"| {median([f.first for f in good])} | {median([f.whole for f in good])} "
                f"| {median([s[0] for s in smooth])} | {median([s[1] for s in smooth])} "
                f"| {'; '.join(sorted({wrong for _, wrong in results if wrong}))} |",
                flush=True,
            )
    print("\n| robot, one arm alone | comove found | [s] | RoboPlan found | [s] |\n|---|---|---|---|---|")
    for name, runs in singles.items():
        cells = [
            f"{sum(run[k][1] for run in runs)}/{len(runs)} | {median([run[k][0] for run in runs])}"
            for k in (0, 1)
        ]
        print(f"| {name} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
