"""Robots of all kinds for tests, written as text: random chains with turning and sliding joints, and a gantry."""

import tempfile
import warnings
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
import yaml

from comove.dmp.basis import motion_basis
from comove.errors import ComoveWarning
from comove.model import CoordinatedDMP, CoordinatedMotion, Scene
from comove.model.coordinates import load_coordinates
from comove.robots import Arm, Robot
from comove.robots.carrying import RobotCarrier
from comove.robots.search.chains import TURN

BUNDLED = (
    "baxter",
    "g1",
    "pr2",
    "tiago_pro",
    "two_fr3",
    "two_pandas",
    "two_so101",
    "two_ur10",
    "two_xarm7",
    "ur5_and_panda",
)
RANDOM = ("random 0", "random 1", "random 2")
FOOT = """<link name="base"><collision><origin xyz="0.1 0.2 0.3" rpy="1 2 3"/>
<geometry><box size="0.1 0.2 0.3"/></geometry></collision></link>"""
AXES = np.array([[1, 0, 0], [0, -1, 0], [0, 0, 1], [1, 2, -2], [-3, 0, 4], [0.2, 0.1, 0.7]])


@cache
def robot(name: str) -> Robot:
    """A bundled robot, "gantry", or "random SEED"; loaded once."""
    if name in BUNDLED:
        return Robot.load(name)
    with tempfile.TemporaryDirectory() as folder:
        if name == "gantry":
            return Robot.load(gantry(Path(folder)))
        if name == "lifts":
            return Robot.load(lifts(Path(folder)))
        return Robot.load(random_arms(Path(folder), int(name.split()[1])))


def urdf(body: str, name: str = "robot") -> str:
    """A model around links and joints, with the link `base`."""
    return f'<robot name="{name}"><link name="base"/>{body}</robot>'


def written(folder: Path, urdfs: dict[str, str], description: dict) -> Path:
    """Write models and their description; the description's path."""
    for name, text in urdfs.items():
        (folder / name).write_text(text, encoding="utf-8")
    path = folder / "robot.yaml"
    path.write_text(yaml.safe_dump({"name": "small", **description}, sort_keys=False), encoding="utf-8")
    return path


def random_arms(folder: Path, seed: int) -> Path:
    """Two random arms on one base, a third on a model of its own that has a prefix; both stand somewhere."""
    rng = np.random.default_rng(seed)
    one = urdf(random_arm(rng, "a", 7) + random_arm(rng, "b", 6))
    two = urdf(random_arm(rng, "a", 8))
    one, two = (text.replace('<link name="base"/>', FOOT) for text in (one, two))
    bases = [
        {"position": place, "quaternion_wxyz": (turn / np.linalg.norm(turn)).tolist()}
        for place, turn in zip(([-0.1, 0.2, 0.3], [0.3, -0.4, 0.2]), rng.normal(size=(2, 4)), strict=True)
    ]
    joints = [*(f"a_j{k}" for k in range(7)), *(f"other_a_j{k}" for k in range(8)), "b_j0"]
    tool = {"position": [0.01, 0.05, -0.02], "quaternion_wxyz": [0.5, -0.5, 0.5, 0.5]}
    description = {
        "models": [
            {"urdf": "one.urdf", "base": bases[0]},
            {"urdf": "two.urdf", "base": bases[1], "prefix": "other_"},
        ],
        "arms": {"b": {"tip": "b_tip"}, "a": {"tip": "a_tip", "tool": tool}, "c": {"tip": "other_a_tip"}},
        "springs": {name: float(rng.uniform(0, 1)) for name in joints} | {"b_j0": 1.0},
    }
    return written(folder, {"one.urdf": one, "two.urdf": two}, description)


def random_arm(rng: np.random.Generator, name: str, n_joints: int) -> str:
    """Links and joints of an arm in all directions; its last link is NAME_tip, fixed to the one before."""
    parts, before = [], "base"
    for k in range(n_joints):
        kind = "prismatic" if rng.random() < 0.3 else "revolute"
        low, high = (-0.3, 0.4) if kind == "prismatic" else (-2.5, 2.8)
        parts.append(
            f'<link name="{name}_{k}">{_inertial(rng)}<collision>{_origin(rng, 0.03)}'
            f'<geometry><cylinder radius="0.03" length="0.15"/></geometry></collision></link>'
            f'<joint name="{name}_j{k}" type="{kind}"><parent link="{before}"/><child link="{name}_{k}"/>'
            f'{_origin(rng, 0.2)}<axis xyz="{_numbers(AXES[rng.integers(len(AXES))])}"/>'
            f'<limit lower="{low}" upper="{high}" velocity="2" effort="80"/></joint>'
        )
        before = f"{name}_{k}"
    return "".join(parts) + (
        f'<link name="{name}_tip"/><joint name="{name}_fixed" type="fixed"><parent link="{before}"/>'
        f'<child link="{name}_tip"/><origin xyz="0.02 -0.03 0.1" rpy="0.3 -0.2 1"/></joint>'
    )


def _inertial(rng: np.random.Generator) -> str:
    """Mass, centre and a full inertia matrix that a body can have."""
    points = rng.normal(0.0, 0.08, (12, 3))
    spread = points.T @ points / len(points)
    mass = rng.uniform(0.5, 4.0)
    inertia = mass * (np.trace(spread) * np.eye(3) - spread)[np.triu_indices(3)]
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    parts = " ".join(f'{name}="{value:.17g}"' for name, value in zip(names, inertia, strict=True))
    return f'<inertial>{_origin(rng, 0.05)}<mass value="{mass:.17g}"/><inertia {parts}/></inertial>'


def _origin(rng: np.random.Generator, size: float) -> str:
    return f'<origin xyz="{_numbers(rng.normal(0, size, 3))}" rpy="{_numbers(rng.uniform(-3, 3, 3))}"/>'


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.17g}" for value in values)


def gantry(folder: Path, nearer: float = 0.0) -> Path:
    """Two hands that slide along x, y and z under a ceiling and turn about the vertical; they point down at 0. At
    home each is `nearer` to the middle than 0.4 m.
    """
    sides = {"left": 1.0, "right": -1.0}
    parts = "".join(_slides(name, 0.4 * side) for name, side in sides.items())
    arms = {
        name: {
            "tip": f"{name}_yaw",
            "tool": {"quaternion_wxyz": [0, 0, 1, 0]},
            "home": [0.0, -nearer * side, -0.5, 0.0],
        }
        for name, side in sides.items()
    }
    return written(folder, {"gantry.urdf": urdf(parts)}, {"models": [{"urdf": "gantry.urdf"}], "arms": arms})


def _slides(name: str, y: float) -> str:
    body = '<inertial><mass value="2"/><inertia ixx=".01" ixy="0" ixz="0" iyy=".01" iyz="0" izz=".01"/></inertial>'
    box = '<collision><geometry><box size="0.06 0.06 {}"/></geometry>{}</collision>'
    column = box.format(1.0, '<origin xyz="0 0 0.55"/>')
    parts, before = [], "base"
    for axis, limits, xyz, shape in (
        ("x", (-0.6, 0.6), f"0 {y} 1", ""),
        ("y", (-0.8, 0.8), "0 0 0", ""),
        ("z", (-1.0, 0.0), "0 0 0", column),
        ("yaw", (-3.0, 3.0), "0 0 0", box.format(0.05, '<origin xyz="0 0 0.03"/>')),
    ):
        kind = "revolute" if axis == "yaw" else "prismatic"
        along = {"x": "1 0 0", "y": "0 1 0"}.get(axis, "0 0 1")
        parts.append(
            f'<link name="{name}_{axis}">{body}{shape}</link><joint name="{name}_{axis}_joint" type="{kind}">'
            f'<parent link="{before}"/><child link="{name}_{axis}"/><origin xyz="{xyz}"/><axis xyz="{along}"/>'
            f'<limit lower="{limits[0]}" upper="{limits[1]}" velocity="1.5" effort="200"/></joint>'
        )
        before = f"{name}_{axis}"
    return "".join(parts)


SHELF = {
    "shape": "box",
    "center": (0.03, 0.1, 0.592),
    "size": (0.1, 0.1, 0.1),
}  # above an elbow that points inwards
CAMERA = np.array([0.1, 0.0, 0.1])  # m


def lifts(folder: Path) -> Path:
    """Two arms of two links, on lifts, that turn about the vertical; hands point down, elbows go to either side.

    A camera beside each wrist points along x of the hand, `CAMERA` from its grasp.
    """
    sides, parts = {"left": 0.5, "right": -0.5}, ""
    body = '<inertial><mass value="2"/><inertia ixx=".01" ixy="0" ixz="0" iyy=".01" iyz="0" izz=".01"/></inertial>'
    rod = (
        '<collision><origin xyz="{} 0 {}" rpy="0 {} 0"/><geometry><cylinder radius="0.03" length="{}"/></geometry>'
        "</collision>"
    )
    along = rod.format(0.2, 0, np.pi / 2, 0.26)
    hanging = rod.format(0, -0.11, 0, 0.14) + rod.format(CAMERA[0], CAMERA[2] - 0.2, np.pi / 2, 0.08)
    for name, y in sides.items():
        before = "base"
        for joint, kind, (lower, upper), xyz, shape in (
            ("lift", "prismatic", (0.0, 1.0), f"0 {y} 0", ""),
            ("shoulder", "revolute", (-2.9, 2.9), "0 0 0", along),
            ("elbow", "revolute", (-2.6, 2.6), "0.4 0 0", along),
            ("wrist", "revolute", (-3.1, 3.1), "0.4 0 0", hanging),
        ):
            parts += (
                f'<link name="{name}_{joint}">{body}{shape}</link><joint name="{name}_{joint}_joint" type="{kind}">'
                f'<parent link="{before}"/><child link="{name}_{joint}"/><origin xyz="{xyz}"/><axis xyz="0 0 1"/>'
                f'<limit lower="{lower}" upper="{upper}" velocity="1.5" effort="200"/></joint>'
            )
            before = f"{name}_{joint}"
    tool = {"position": [0, 0, -0.2], "quaternion_wxyz": [0, 1, 0, 0]}
    arms = {
        name: {"tip": f"{name}_wrist", "tool": tool, "home": [0.7, 0.6 * y, 1.2 * y, 0.0]}
        for name, y in sides.items()
    }
    return written(folder, {"lifts.urdf": urdf(parts)}, {"models": [{"urdf": "lifts.urdf"}], "arms": arms})


def lifts_scene(obstacles: tuple[dict, ...] = (), **more: object) -> Scene:
    """The arms on lifts move a bar level by 0.1 m, away from their bases; `more` replaces keys."""
    hands = {"left": 0.25, "right": -0.25}
    return Scene.from_dict(
        {
            "name": "lifts",
            "duration": 4.0,
            "workspace": {"lower": [-0.2, -1.2, 0.0], "upper": [1.2, 1.2, 1.5]},
            "obstacles": list(obstacles),
            "load": {"shape": "bar", "length": 0.5, "radius": 0.01, "mass": 1.0},
            "manipulators": [
                {"name": name, "start": [0.4, y, 0.3], "goal": [0.5, y, 0.3]} for name, y in hands.items()
            ],
            "grasp": {"orientation": "down", "offset_deg": -90},
            **more,
        }
    )


POST = {"shape": "cylinder", "center": [0.0, 0.0, 0.3], "radius": 0.04, "height": 0.6}


def gantry_scene(obstacles: tuple[dict, ...] = (POST,), **more: object) -> Scene:
    """The gantry carries a bar past a post that is in the middle of the straight way; `more` replaces keys."""
    return Scene.from_dict(
        {
            "name": "gantry",
            "duration": 6.0,
            "workspace": {"lower": [-0.7, -1.2, 0.0], "upper": [0.7, 1.2, 0.45]},
            "obstacles": list(obstacles),
            "load": {"shape": "bar", "length": 0.5, "radius": 0.01, "mass": 1.0},
            "manipulators": [
                {"name": "left", "start": [-0.3, 0.25, 0.3], "goal": [0.3, 0.25, 0.3]},
                {"name": "right", "start": [-0.3, -0.25, 0.3], "goal": [0.3, -0.25, 0.3]},
            ],
            "grasp": {"orientation": "down", "offset_deg": -90},
            **more,
        }
    )


EXAMPLES = Path(__file__).parents[2] / "examples"


@lru_cache(maxsize=8)
def task(name: str) -> RobotCarrier:
    """A robot with something to carry: "gantry", or the name of an example scene."""
    if name == "gantry":
        return RobotCarrier(robot("gantry"), gantry_scene())
    with warnings.catch_warnings():  # ends are moved onto the constraints by less than a nanometre
        warnings.simplefilter("ignore", ComoveWarning)
        scene = Scene.load(next(EXAMPLES.glob(f"*/{name}.yaml")))
    return RobotCarrier(robot(scene.file.robot), scene)


def movement(scene: Scene, bend: tuple[float, ...] = ()) -> CoordinatedMotion:
    """The straight movement of the load; `bend` shifts its columns at mid-time [m, rad]."""
    coordinates, basis = load_coordinates(scene), motion_basis(20)
    boundary, s = coordinates.boundary(), np.linspace(0.0, 1.0, 201)
    straight = CoordinatedDMP(scene, coordinates, basis, boundary, np.zeros((len(boundary[0]), 20)))
    q = straight.rollout().at(s)[0].T
    q[: len(bend)] += np.array(bend).reshape(-1, 1) * np.sin(np.pi * s) ** 4
    phi, base = np.split(basis.sampled(201).T, [basis.n_basis], axis=1)
    weights = np.linalg.lstsq(phi, q.T - base @ boundary, rcond=None)[0].T
    return CoordinatedMotion(scene, coordinates, basis, boundary, weights)


def columns(arms: tuple[Arm, ...]) -> np.ndarray:
    """Indices of the joints of some arms in the robot's vector, in the order of the chains."""
    return np.concatenate([arm.columns for arm in arms])


def grasp_errors(robot: Robot, arms: tuple[Arm, ...], position: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Errors of the grasps by Pinocchio [m], a radian as `TURN`; array, shape (n_steps, n_arms)."""
    errors = np.empty(wanted.shape[:2])
    for t, q in enumerate(position):
        for i, arm in enumerate(arms):
            pose, target = robot.tool_pose(q, arm), wanted[t, i]
            turn = 0.5 * np.linalg.norm(target[:3, :3] @ pose[:3, :3].T - np.eye(3), 2)
            angle = 2 * np.arcsin(min(1.0, turn))
            errors[t, i] = np.hypot(np.linalg.norm(target[:3, 3] - pose[:3, 3]), TURN * angle)
    return errors


def whole(carrying, q):
    """Joints of the chains in the robot's vector; array, shape (n_steps, n_joints)."""
    position = np.tile(carrying.robot.home, (len(q), 1))
    position[:, columns(carrying.holders)] = q
    return position
