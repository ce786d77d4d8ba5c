"""The description that URDFs suggest: arms, tools, homes, limits that are missing, and pairs that always touch."""

from __future__ import annotations

import os
import re
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from comove.errors import ComoveWarning, RobotError
from comove.robots.description import RobotFile
from comove.robots.model import Arm, Robot, assembled, frame_of_joint
from comove.robots.proposal.bodies import link_of, placed_bodies
from comove.robots.proposal.examination import near_but_apart, overloaded, pairs_of, touching
from comove.robots.proposal.homes import Homes, homes_of
from comove.robots.proposal.tree import Chain, Tree
from comove.robots.soundness import number
from comove.robots.urdf import CONVERT, resolve

Array = NDArray[np.float64]
Pair = tuple[str, str]

APART = 0.8  # m, between the bases of two models
SIDES = ("left", "right")
TURNING, SLIDING = {"velocity": 1.0, "effort": 50.0}, {"velocity": 0.1, "effort": 50.0}  # rad/s, N m; m/s, N
# By kind of joint, where a URDF states nothing above 0.
GUESSED = {"revolute": TURNING, "continuous": TURNING, "prismatic": SLIDING}
ENDLESS = 3.14  # rad, either way, of joints that turn without end
SPRINGS = 0.9  # share of a weight that is too much for a motor, guessed to be held by springs
ALWAYS = 0.95  # share of random configurations from which on a pair counts as always touching
# m, of a tip and of the centre of mass from the last joint, from where on they tell the direction of approach; that
# centre lies behind a bare flange, but by less
APART_FROM_WRIST, HEAVY_FROM_WRIST = 0.01, 0.02
BETWEEN, GRIP = 0.3, 0.75  # of fingers' length: where a tip lies between them, and where a tool is put
N_SAMPLES = 300  # random configurations that tell which pairs of links touch always, and which come near
TOLD = {
    "Always": "touch in every configuration",
    "Never": "come near each other, but were never seen to touch",
}
TOOLS = re.compile(r"tcp|grasp|tool_frame|gripper$", re.IGNORECASE)  # names of frames between fingers
SIDE_OF = re.compile(r"(?:^|[_/])((?i:left|right|l|r))(?=[_/]|$)|^(Left|Right|LEFT|RIGHT|L|R)(?=[A-Z])")


@dataclass(frozen=True)
class Proposal:
    """A description for a person to check, with what was guessed.

    Attributes
    ----------
    data : contents of the description (`comove.robots.description.RobotFile`)
    robot : the robot that it describes
    srdf : text of a file of pairs that are not compared, by URDF; where a robot's own does not have them all
    notes : what was chosen or guessed, and what is missing, in words
    """

    data: dict[str, Any]
    robot: Robot
    srdf: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def text(self) -> str:
        """Return the description as YAML, with the notes as comments."""
        notes = "".join(f"# - {note}\n" for note in self.notes)
        head = (
            f"# Proposed from {', '.join(sorted({m['urdf'] for m in self.data['models']}))}. To be checked:\n"
        )
        return head + notes + yaml.safe_dump(self.data, sort_keys=False, default_flow_style=None, width=110)


@dataclass(frozen=True)
class _Part:
    """One URDF among the models: its entry in the description, its text and its arms."""

    entry: dict[str, Any]
    text: str
    chains: tuple[Chain, ...]
    notes: tuple[str, ...]


def propose(urdfs: Sequence[str], file: Path, *, apart: float = APART, seed: int = 0) -> Proposal:
    """Propose the description of a robot that one or several URDFs form.

    Parameters
    ----------
    urdfs : paths or ``package://NAME/...``, in the order of their bases from left to right; one URDF given twice is
        two robots of a kind
    file : path of the description to be written, to which paths are relative
    apart : distance between the bases [m]
    seed : seed of the random configurations, from which home and pairs that always touch are found

    Raises
    ------
    RobotError
        If a URDF is missing or unsound, or there is no arm in it.
    """
    parts = tuple(_part(urdf, i, len(urdfs), file, apart) for i, urdf in enumerate(urdfs))
    data: dict[str, Any] = {"name": _name_of(file), "models": [part.entry for part in parts], "arms": {}}
    notes = [note for part in parts for note in part.notes]
    limits: dict[str, dict[str, float]] = {}
    posture: dict[str, float] = {}
    for part in parts:
        prefix = part.entry.get("prefix", "")
        for chain in part.chains:
            name = _arm_name(chain, prefix, data["arms"])
            data["arms"][name] = {"tip": prefix + chain.tip}
            if chain.fingers:
                data["arms"][name]["fingers"] = [prefix + finger for finger in chain.fingers]
            trunk = {prefix + joint: _nearest_to_0(part.text, joint) for joint in chain.trunk}
            if trunk.keys() - posture.keys():
                notes.append(f"all arms hang on {', '.join(trunk)}: `posture` says where that stays")
            posture |= trunk
        guessed = _limits_of(part, prefix)
        limits |= guessed
        if guessed:
            notes.append(
                f"the URDF states no usable limits of {', '.join(guessed)}: those under `limits` are guesses; "
                "put the maker's there"
            )
        lost = _leaderless(part.text)
        posture |= {prefix + joint: _nearest_to_0(part.text, joint) for joint in lost}
        notes += [
            f"'{prefix}{joint}' goes along with '{leader}', which is not there: `posture` says where it stays"
            for joint, leader in lost.items()
        ]
    if not data["arms"]:
        raise RobotError(
            f"no arm of four joints or more was found in {', '.join(urdfs)}",
            file=file,
            way_out="write the description by hand: docs/robots.md",
        )
    if posture:
        data["posture"] = posture
    if limits:
        data["limits"] = limits
    notes.append("no URDF states accelerations: 5 rad/s^2 unless `acceleration` says something else")
    with warnings.catch_warnings():  # they come once, with the last robot
        warnings.simplefilter("ignore", ComoveWarning)
        data, more = _with_tools(data, _robot(data, file), parts)
        robot, notes = _robot(data, file), notes + more
    left_out = _left_out(robot, parts, seed)
    srdf = {part.entry["urdf"]: _srdf(part, left_out, file) for part in parts if left_out[part.entry["urdf"]]}
    pairs = [pair for part in parts for pair in _named(part, left_out)]
    notes += [f"'{a}' and '{b}' {TOLD[reason]}: not compared" for (a, b), reason in pairs]
    robot = _without(robot, pairs)
    homes: Homes = homes_of(robot, seed)
    for arm, home in zip(robot.arms, homes.joints, strict=True):
        data["arms"][arm.name]["home"] = _written(home, robot.lower[arm.columns], robot.upper[arm.columns])
    notes += homes.notes
    weak = overloaded(_robot(data, file))
    if weak:
        data["springs"] = dict.fromkeys(weak, SPRINGS)
        notes.append(
            f"the motors of {', '.join(weak)} cannot hold the robot's own weight at home: `springs` guesses that "
            f"springs hold {SPRINGS:.0%} of it, of which a URDF does not know"
        )
    return Proposal(data, _without(_robot(data, file), pairs), srdf, tuple(notes))


def _written(home: Array, lower: Array, upper: Array) -> list[float]:
    """Return joints in thousandths, or in all digits where rounding would lead out of their limits."""
    rounded = home.round(3)
    return np.where((rounded < lower) | (rounded > upper), home, rounded).tolist()


def _name_of(file: Path) -> str:
    return re.sub(r"\W+", "_", file.stem) or "robot"


def _srdf_beside(urdf: Path) -> Path | None:
    """Return the SRDF of a URDF: of its name in its folder, or alike in the folder `srdf` next to that; or None."""
    if (same := urdf.with_suffix(".srdf")).is_file():
        return same
    own = sorted((urdf.parent.parent / "srdf").glob("*.srdf"))
    return next((p for p in own if p.stem.startswith(urdf.stem) or urdf.stem.startswith(p.stem)), None)


def _part(urdf: str, i: int, n: int, file: Path, apart: float) -> _Part:
    """Read one URDF and find its arms."""
    path = resolve(urdf, file) if "://" in urdf else Path(urdf)
    try:
        text = path.read_text(encoding="utf-8")
        if ET.fromstring(text).tag == "mujoco":
            raise RobotError(f"'{urdf}' is a model of MuJoCo's", file=file, way_out=CONVERT)
        tree = Tree.of(text)
    except (OSError, UnicodeDecodeError, ET.ParseError, IndexError, AttributeError) as error:
        raise RobotError(
            f"'{urdf}' cannot be read: {error}", file=file, way_out="name a URDF; xacro makes one of a .xacro"
        ) from error
    entry: dict[str, Any] = {"urdf": urdf if "://" in urdf else os.path.relpath(path, file.absolute().parent)}
    notes: list[str] = []
    if (pairs := _srdf_beside(path)) is not None:
        shared = pairs.parent if pairs.parent == path.parent else pairs.parent.parent
        folder = str(entry["urdf"]).removesuffix(path.relative_to(shared).as_posix())
        entry["srdf"] = folder + pairs.relative_to(shared).as_posix()
        notes.append(
            f"pairs that need not be kept apart are those of {pairs.name}, which lay beside the URDF"
        )
    if n > 1:
        entry["prefix"] = f"{SIDES[i]}_" if n == len(SIDES) else f"robot{i + 1}_"
        entry["base"] = {"position": [0.0, round(apart * (0.5 * (n - 1) - i), 6), 0.0]}
        notes.append(
            f"the base of {path.stem} number {i + 1} stands at y = {entry['base']['position'][1]:g} m"
        )
    chains = tree.chains()
    for chain in chains:
        if chain.is_other:
            notes.append(
                f"the chain from '{chain.joints[0]}' to '{chain.tip}' was taken for no arm: it stays"
            )
    return _Part(entry, text, tuple(c for c in chains if not c.is_other), tuple(notes))


def _arm_name(chain: Chain, prefix: str, taken: dict[str, Any]) -> str:
    """Return the name of an arm: its side where the names tell, else that of the model, else a number."""
    found = SIDE_OF.search(prefix) or SIDE_OF.search(chain.joints[0]) or SIDE_OF.search(chain.tip)
    letter = "" if found is None else (found.group(1) or found.group(2))[0].lower()
    name = {"l": "left", "r": "right"}.get(letter, "arm")
    while name in taken:
        stem, _, digits = name.partition("_")
        name = f"{stem}_{int(digits or 1) + 1}"
    return name


def _limits_of(part: _Part, prefix: str) -> dict[str, dict[str, float]]:
    """Return limits for the joints of arms whose URDF states none that can be used, and for others that lack one."""
    found: dict[str, dict[str, float]] = {}
    moving = {joint for chain in part.chains for joint in (*chain.joints, *chain.fingers)}
    for joint in ET.fromstring(part.text).findall("joint"):
        kind, name, limit = str(joint.get("type")), str(joint.get("name")), joint.find("limit")
        stated = {} if limit is None else {key: number(text) for key, text in limit.attrib.items()}
        usual = GUESSED.get(kind, {})
        missing = {key: value for key, value in usual.items() if key not in stated}
        if name in moving:
            missing = {key: value for key, value in usual.items() if not (stated.get(key) or 0.0) > 0.0}
            lower, upper = stated.get("lower") or 0.0, stated.get("upper") or 0.0
            if kind == "continuous" or not lower < upper:
                missing |= {"lower": -ENDLESS, "upper": ENDLESS}
        if missing:
            found[prefix + name] = missing
    return found


def _leaderless(text: str) -> dict[str, str]:
    """Return the joints that go along with one which their URDF does not have, and its name."""
    joints = ET.fromstring(text).findall("joint")
    names = {joint.get("name") for joint in joints}
    leaders = {
        str(joint.get("name")): str(mimic.get("joint"))
        for joint in joints
        for mimic in joint.findall("mimic")
    }
    return {joint: leader for joint, leader in leaders.items() if leader not in names}


def _nearest_to_0(text: str, name: str) -> float:
    """Return the position of a joint within its limits that is nearest to 0."""
    for joint in ET.fromstring(text).findall("joint"):
        limit = joint.find("limit")
        if joint.get("name") == name and limit is not None and joint.get("type") != "continuous":
            lower, upper = (number(limit.get(key, "0")) or 0.0 for key in ("lower", "upper"))
            return min(max(0.0, lower), upper)
    return 0.0


def _robot(data: dict[str, Any], file: Path) -> Robot:
    return assembled(RobotFile.model_validate(data), file)


def _with_tools(
    data: dict[str, Any], robot: Robot, parts: Sequence[_Part]
) -> tuple[dict[str, Any], list[str]]:
    """Return the description with a grasp frame for every arm whose tip is none, and notes about them."""
    chains = [(part.entry.get("prefix", ""), chain) for part in parts for chain in part.chains]
    arms, notes = dict(data["arms"]), []
    bodies = list(placed_bodies(robot, robot.home))
    for arm, (prefix, chain) in zip(robot.arms, chains, strict=True):
        hand = {prefix + link for link in (*chain.links, *chain.grippers)}
        held = [points for link, points in bodies if link in hand]
        frames, at_tip = _finger_frames(robot, arm), TOOLS.search(chain.tip) is not None
        if not chain.fingers:
            if not at_tip:
                found, note = _flange(robot, arm, frames[0], held)
                arms[arm.name] = arms[arm.name] | found
                notes.append(note)
            continue
        turn, begin = _grasp_axes(frames)
        approach = turn[:, 2]
        end = _farthest(robot, arm, approach, held, begin)
        between = at_tip and begin + BETWEEN * (end - begin) <= 0.0
        if between and approach[2] > 0.5:
            continue
        tool: dict[str, Any] = {}
        if (turned := Rotation.from_matrix(turn)).magnitude() > 1e-6:
            tool["quaternion_wxyz"] = [round(float(v), 6) for v in turned.as_quat(scalar_first=True)]
        axis = "xyz"[int(np.abs(approach).argmax())]
        sign = "-" if approach.sum() < 0 else ""
        if between:
            notes.append(
                f"the tool of '{arm.name}' turns '{arm.tip}', whose fingers point along its {sign}{axis}, so that z "
                "is the direction of approach"
            )
        else:
            tool["position"] = [round(float(v), 4) for v in (begin + GRIP * (end - begin)) * approach]
            where = f"{GRIP:.0%} of the way along its fingers" if end > begin else "where the fingers begin"
            notes.append(
                f"the tool of '{arm.name}' is {where}, its approach along {sign}{axis} of '{arm.tip}': see the "
                "picture, and move it between the finger tips"
            )
        arms[arm.name] = arms[arm.name] | {"tool": tool}
    return data | {"arms": arms}, notes


def _flange(robot: Robot, arm: Arm, from_wrist: Array, hand: Sequence[Array]) -> tuple[dict[str, Any], str]:
    """Return the tool of an arm without fingers, where it is not its tip, and a note about it.

    The approach leads away from the last joint: to the tip, where that lies apart, or else to the centre of mass of
    all that the joint moves. The load is at the end of what is fixed to the tip, or at that centre without a body.

    Parameters
    ----------
    from_wrist : array, shape (3,), the tip from the last joint, in its own frame [m]
    hand : as in `_farthest`
    """
    center, approach, least = _center_of_mass(robot, arm), np.array([0.0, 0.0, 1.0]), 0.0
    if np.linalg.norm(from_wrist) > APART_FROM_WRIST:
        approach = _nearest_axis(from_wrist)
    elif np.linalg.norm(from_wrist + center) > HEAVY_FROM_WRIST:
        approach = _nearest_axis(from_wrist + center)
        least = float(center @ approach)
    end = _farthest(robot, arm, approach, hand, least)
    axes = np.column_stack([np.roll(approach, 1), np.roll(approach, 2), approach])
    axes[:, 0] *= np.linalg.det(axes)
    tool: dict[str, Any] = {}
    if approach[2] < 0.5:
        quaternion = Rotation.from_matrix(axes).as_quat(scalar_first=True)
        tool["quaternion_wxyz"] = [round(float(v), 6) for v in quaternion]
    if end > 0.0:
        tool["position"] = [round(float(v), 4) for v in end * approach]
    axis, sign = "xyz"[int(np.abs(approach).argmax())], "-" if approach.sum() < 0 else ""
    note = (
        f"the arm '{arm.name}' ends in '{arm.tip}' without fingers: its tool is taken for the end of that, its "
        f"approach along {sign}{axis}; give the one that it holds the load with, tool: {{position: [0, 0, LENGTH]}}"
    )
    return {"tool": tool} if tool else {}, note


def _center_of_mass(robot: Robot, arm: Arm) -> Array:
    """Return the centre of mass of all that the last joint of an arm moves, from its tip; array, shape (3,) [m]."""
    model, data = robot.model, robot.model.createData()
    last = int(arm.columns[-1]) + 1
    pin.framesForwardKinematics(model, data, robot.home)
    place = data.oMi[last].act(model.inertias[last].lever)
    return np.array(data.oMf[model.getFrameId(arm.tip)].actInv(place))


def _farthest(robot: Robot, arm: Arm, approach: Array, hand: Sequence[Array], least: float) -> float:
    """Return how far a hand reaches along the approach from the tip, `least` at least [m].

    Parameters
    ----------
    approach : array, shape (3,), in the frame of the tip
    hand : arrays, shape (n, 3), points around its bodies at home [m]
    """
    tip = robot.tool_pose(robot.home, replace(arm, tool=np.eye(4)))
    along = tip[:3, :3] @ approach
    return max([least, *(float(((points - tip[:3, 3]) @ along).max()) for points in hand)])


def _grasp_axes(frames: Array) -> tuple[Array, float]:
    """Return the axes of a grasp frame in those of the tip, and how far along its approach the fingers begin [m].

    Parameters
    ----------
    frames : array, shape (1 + n_fingers, 3), as `_finger_frames` returns them

    Returns
    -------
    array, shape (3, 3), a rotation, and the distance from the tip
    """
    from_wrist, fingers = frames[0], frames[1:]  # the tip is at minus the one from the last joint
    middle = fingers.mean(axis=0)
    approach = _nearest_axis(middle) if np.linalg.norm(middle) > 1e-3 else np.array([0.0, 0.0, 1.0])
    spread = np.ptp(fingers, axis=0) if len(fingers) > 1 else np.array([0.0, 1.0, 0.0])
    across = _nearest_axis(spread - (spread @ approach) * approach)
    if abs(across @ approach) > 0.5:
        across = np.roll(approach, 1)
    axes = np.column_stack([np.cross(across, approach), across, approach])
    return axes, float((middle - from_wrist) @ approach)


def _finger_frames(robot: Robot, arm: Arm) -> Array:
    """Return the places of the tip and of the fingers' joints from the arm's last joint, along the axes of the tip.

    Returns
    -------
    array, shape (1 + n_fingers, 3) [m]
    """
    model = robot.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, robot.home)
    wrist, tip = data.oMi[int(arm.columns[-1]) + 1].translation, data.oMf[model.getFrameId(arm.tip)]
    frames = [tip, *(data.oMf[frame_of_joint(model, finger)] for finger in arm.fingers)]
    return np.array([tip.rotation.T @ (frame.translation - wrist) for frame in frames])


def _nearest_axis(vector: Array) -> Array:
    """Return the signed axis that is nearest to a vector; array, shape (3,)."""
    axis, k = np.zeros(3), int(np.abs(vector).argmax())
    axis[k] = 1.0 if vector[k] >= 0.0 else -1.0
    return axis


def _left_out(robot: Robot, parts: Sequence[_Part], seed: int) -> dict[str, dict[Pair, str]]:
    """Find the pairs of links of one model that touch in nearly all configurations, or come near but never touch.

    Links of different models must not touch, wherever the bases stand.

    Returns
    -------
    by URDF its pairs, as it names the links, with the reason of each as SRDF has it
    """
    rng = np.random.default_rng(seed)
    drawn = rng.uniform(robot.lower, robot.upper, (N_SAMPLES, len(robot.lower)))
    shares = touching(robot, drawn).mean(axis=0)
    always = {pair for pair, share in zip(pairs_of(robot), shares, strict=True) if share >= ALWAYS}
    never = near_but_apart(robot, N_SAMPLES, rng)
    reasons = dict.fromkeys(sorted(always), "Always") | dict.fromkeys(sorted(never), "Never")
    found: dict[str, dict[Pair, str]] = {part.entry["urdf"]: {} for part in parts}
    for part, ((a, b), reason) in product(parts, reasons.items()):
        prefix = part.entry.get("prefix", "")
        if a.startswith(prefix) and b.startswith(prefix):
            found[part.entry["urdf"]][a.removeprefix(prefix), b.removeprefix(prefix)] = reason
    return found


def _named(part: _Part, left_out: dict[str, dict[Pair, str]]) -> list[tuple[Pair, str]]:
    """Return a model's pairs that are left out, as the robot names their links, and the reasons."""
    prefix = part.entry.get("prefix", "")
    return [((prefix + a, prefix + b), reason) for (a, b), reason in left_out[part.entry["urdf"]].items()]


def _srdf(part: _Part, left_out: dict[str, dict[Pair, str]], file: Path) -> str:
    """Return the SRDF of a model with those of its pairs that are left out."""
    top = ET.Element("robot", name=ET.fromstring(part.text).get("name", "robot"))
    if "srdf" in part.entry:
        top = ET.fromstring(resolve(part.entry["srdf"], file).read_bytes())
    for (one, other), reason in left_out[part.entry["urdf"]].items():
        ET.SubElement(top, "disable_collisions", link1=one, link2=other, reason=reason)
    ET.indent(top)
    return ET.tostring(top, encoding="unicode") + "\n"


def _without(robot: Robot, pairs: Iterable[tuple[Pair, str]]) -> Robot:
    """Return a robot that does not compare some pairs of links."""
    geometry, known = robot.collision.copy(), {frozenset(pair) for pair, _ in pairs}
    links = [link_of(item.name) for item in geometry.geometryObjects]
    ends = [(pair.first, pair.second) for pair in geometry.collisionPairs]
    geometry.removeAllCollisionPairs()
    for a, b in ends:
        if frozenset((links[a], links[b])) not in known:
            geometry.addCollisionPair(pin.CollisionPair(a, b))
    return replace(robot, collision=geometry)
