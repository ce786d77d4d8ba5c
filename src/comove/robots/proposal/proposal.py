"""The description suggested by URDFs: arms, tools, homes, limits and contacts."""

from __future__ import annotations

import os
import re
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml
from scipy.spatial.transform import Rotation

from comove.arrays import Array
from comove.errors import ComoveWarning, RobotError
from comove.geometry.rotations import quaternion_of_rotation
from comove.io.keys import MAX_NAME
from comove.model.scene import Scene
from comove.robots.description import RobotFile, errors_in
from comove.robots.formats import SRDF, URDF, elements_in
from comove.robots.further_limits import in_radians_or_metres
from comove.robots.model import FREEDOMS, LARGEST_LIMIT, Arm, Robot, assembled, frame_of_joint
from comove.robots.proposal.bodies import link_of, near_but_apart, pairs_of, points_from_tip, touching
from comove.robots.proposal.examination import overloaded
from comove.robots.proposal.homes import clearance_at_home, homes_of
from comove.robots.proposal.tree import GUESSED, MOVING, SHAPE, Chain, Tree, has_word
from comove.robots.soundness import require_tree
from comove.robots.urdf import has_rounded_right_angles, resolve
from comove.robots.verification.kinematics import joint_axes

Pair = tuple[str, str]

SIDES = ("left", "right")
TOLD = {
    "Always": "touch in every configuration",
    "Never": "come near each other, but were never seen to touch",
}
BETWEEN = ("tcp", "grasp|grasping", "gripper$")  # words in the names of frames between fingers
TOOL_FRAME = re.compile(r"(?i)(^|[^a-z])tool_?frame([^a-z]|$)")
FORWARD = re.compile(
    r"(?i)(^|[^a-z])(tool_?0|tcp)([^a-z]|$)"
)  # of frames whose z leads forward by convention
MOUNT = "tool|ee|eef|flange"  # words of frames whose z, or x, leads forward
SIDE_OF = re.compile(r"(?:^|[_/])((?i:left|right|l|r))(?=[_/]|$)|^(Left|Right|LEFT|RIGHT|L|R)(?=[A-Z])")


@dataclass(frozen=True)
class ProposalSettings:
    """Settings of guesses.

    Attributes
    ----------
    endless : limit, either way, of joints that turn without end or state none [rad]
    springs : share of a weight too large for a motor that springs are guessed to hold
    n_samples : random configurations to find pairs of links that touch always, and that come near
    always : least share of these for a pair that always touches
    tip_off : distance of a tip, or of a joint before, from the last joint above which it defines the direction of
        approach [m]
    mass_off : likewise of the centre of mass of an end effector without a body [m]
    between : least share of the fingers' length for a tip between them
    grip : share of the fingers' length at the tool
    """

    endless: float = 3.14
    springs: float = 0.9
    n_samples: int = 300
    always: float = 0.95
    tip_off: float = 0.01
    mass_off: float = 0.02
    between: float = 0.3
    grip: float = 0.75


SETTINGS = ProposalSettings()


@dataclass(frozen=True)
class Proposal:
    """A description for a person to check, with its guesses.

    Attributes
    ----------
    data : contents of the description (`comove.robots.description.RobotFile`)
    robot : the robot that it describes
    srdf : text of a file of pairs that are not compared, by URDF; where a robot's own does not have them all
    notes : choices, guesses and missing parts, in words
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
    """One URDF among the models: its entry in the description, its joints and its arms."""

    entry: dict[str, Any]
    tree: Tree
    chains: tuple[Chain, ...]
    notes: tuple[str, ...]
    names: Mapping[tuple[str, ...], str] = field(default_factory=dict)
    """Names of arms by their joints, where a group of the SRDF has just those."""

    @property
    def prefix(self) -> str:
        """Return the prefix of its names."""
        return str(self.entry.get("prefix", ""))


def propose(
    urdfs: Sequence[str],
    file: Path,
    *,
    apart: float = 0.8,
    around: Scene | None = None,
    gripper: str | None = None,
    srdf: str | None = None,
    home_state: str | None = None,
    seed: int = 0,
) -> Proposal:
    """Propose the description of a robot that one or several URDFs form.

    Parameters
    ----------
    urdfs : paths or ``package://NAME/...``, in the order of their bases from left to right; one URDF given twice is
        two robots of a kind
    file : path of the description to be written, to which paths are relative
    apart : distance between the bases [m]
    around : scene of obstacles around the robot, from which homes keep away
    gripper : URDF of a gripper for every arm without fingers, as `urdfs` are named
    srdf : SRDF of the URDFs, in place of one beside them; its groups name the arms
    home_state : group state of the SRDF that is home, in place of a home that is searched
    seed : seed of the random configurations, from which home and pairs that always touch are found

    Raises
    ------
    RobotError
        If a URDF is missing or unsound, or there is no arm in it.
    """
    parts = tuple(_part(urdf, i, len(urdfs), file, apart, srdf) for i, urdf in enumerate(urdfs))
    data, notes = _arms_of(parts)
    if not data["arms"]:
        raise RobotError(
            f"no arm of four joints or more was found in {', '.join(urdfs)}",
            file=file,
            way_out="write the description by hand: docs/robots.md",
        )
    data = {"name": re.sub(r"\W+", "_", file.stem) or "robot", **data}
    with warnings.catch_warnings():  # they come once, with the last robot
        warnings.simplefilter("ignore", ComoveWarning)
        if gripper is not None:
            data, more = _with_gripper(data, gripper, file)
            notes += more
        data, more = _with_tools(data, _robot(data, file), parts)
        robot, notes = _robot(data, file), notes + more
    left_out, touching = _left_out(robot, parts, seed)
    for name, links in touching.items():
        data["arms"][name]["gripper"]["touch_links"] = links
        notes.append(f"{', '.join(links)} may touch the gripper of '{name}', as `touch_links` says")
    texts = {
        part.entry["urdf"]: _srdf(part, left_out, file) for part in parts if left_out[part.entry["urdf"]]
    }
    pairs = [
        ((part.prefix + a, part.prefix + b), reason)
        for part in parts
        for (a, b), reason in left_out[part.entry["urdf"]].items()
    ]
    notes += [f"'{a}' and '{b}' {TOLD[reason]}: not compared" for (a, b), reason in pairs]
    robot = _without(robot, pairs)
    if home_state is not None:
        for arm in data["arms"].values():
            arm["home_state"] = home_state
    else:
        homes, more = homes_of(robot, seed, around)
        for arm, home in zip(robot.arms, homes, strict=True):
            data["arms"][arm.name]["home"] = home.tolist()
        notes += more
    weak = overloaded(_robot(data, file))
    if weak:
        data["springs"] = data.get("springs", {}) | dict.fromkeys(weak, SETTINGS.springs)
        notes.append(
            f"the motors of {', '.join(weak)} cannot hold the robot's own weight at home: `springs` guesses that "
            f"springs hold {SETTINGS.springs:.0%} of it, of which a URDF does not know"
        )
    return Proposal(data, _without(_robot(data, file), pairs), texts, tuple(notes))


def _arms_of(parts: Sequence[_Part]) -> tuple[dict[str, Any], list[str]]:
    """Return a description's models, arms, posture and limits, and notes on guesses."""
    data: dict[str, Any] = {"models": [part.entry for part in parts], "arms": {}}
    notes = [note for part in parts for note in part.notes]
    limits: dict[str, dict[str, float]] = {}
    posture: dict[str, float] = {}
    springs: dict[str, float] = {}
    for part in parts:
        prefix, joints = part.prefix, {joint.name: joint for joint in part.tree.joints}
        for chain in part.chains:
            name = part.names.get(chain.joints, "")
            if not name or name in data["arms"]:
                name = _arm_name(chain, prefix, data["arms"])
            data["arms"][name] = {"tip": prefix + chain.tip}
            if chain.fingers:
                fingers = [prefix + finger for finger in chain.fingers]
                data["arms"][name]["fingers"] = fingers
                notes.append(
                    f"the last joint of the arm '{name}' is '{prefix}{chain.joints[-1]}'; {', '.join(fingers)} are "
                    "taken for fingers, which stay: where one is the arm's, take it out of `fingers`, name a `tip` "
                    "beyond it, and give `home` a value for it"
                )
            trunk = {prefix + joint: joints[joint].nearest_to_0 for joint in chain.trunk}
            if trunk.keys() - posture.keys():
                notes.append(
                    f"{', '.join(trunk)} move several arms or a base: `posture` says where they stay"
                )
            posture |= trunk
        guessed = _limits_of(part)
        limits |= guessed
        notes += _told_guesses(guessed)
        own = {joint for chain in part.chains for joint in chain.joints}
        held = {prefix + joint: joints[joint].springs for joint in own if joints[joint].springs > 0.0}
        springs |= {joint: held[joint] for joint in sorted(held)}
        lost = [joint for joint in part.tree.joints if joint.leader not in (None, *joints)]
        posture |= {prefix + joint.name: joint.nearest_to_0 for joint in lost}
        notes += [
            f"'{prefix}{joint.name}' goes along with '{joint.leader}', which is not there: `posture` says where it "
            "stays"
            for joint in lost
        ]
    if posture:
        data["posture"] = posture
    if limits:
        data["limits"] = limits
    if springs:
        data["springs"] = springs
        notes.append(f"the model takes weight off the motors of {', '.join(springs)}, as `springs` says")
    states = (joint.states_acceleration for part in parts for joint in part.tree.joints if joint.moves)
    if not all(states):
        notes.append(
            "where a URDF states no acceleration, it is 5 rad/s^2 unless `acceleration` says otherwise"
        )
    return data, notes


def _told_guesses(guessed: dict[str, dict[str, float]]) -> Iterator[str]:
    """Yield messages of guessed limits of joints."""
    keys = {joint: " and ".join(given) for joint, given in guessed.items()}
    for told in dict.fromkeys(keys.values()):
        names = [joint for joint, lacks in keys.items() if lacks == told]
        yield (
            f"the URDF states no usable {told} of {', '.join(names)}: those under `limits` are guesses; "
            "put the maker's there"
        )


def _srdf_beside(urdf: Path, named: str) -> str | None:
    """Return the SRDF of a URDF, named as that is, or None: of its name in its folder, or alike in the folder `srdf`
    next to that, the one that shares most with it. That of a ur5e is not alike that of a ur5.
    """
    pairs, shared = urdf.with_suffix(".srdf"), urdf.parent
    if not pairs.is_file():
        shared = urdf.parent.parent
        own = sorted((shared / "srdf").glob("*.srdf"))
        alike = [path for path in own if _begins(path.stem, urdf.stem) or _begins(urdf.stem, path.stem)]
        pairs = max(
            alike, key=lambda path: (min(len(path.stem), len(urdf.stem)), -len(path.stem)), default=pairs
        )
    if not pairs.is_file():
        return None
    return named.removesuffix(urdf.relative_to(shared).as_posix()) + pairs.relative_to(shared).as_posix()


def _read(urdf: str, file: Path) -> tuple[Path, dict[str, Any], ET.Element, Tree]:
    """Return a named model's path, its entry in `file`, root and tree."""
    path, named = Path(urdf), urdf
    if "://" in urdf:
        path = resolve(urdf, file)
    else:
        named = os.path.relpath(urdf, file.absolute().parent)
    top = elements_in(path, URDF)
    with errors_in(path):
        require_tree(top)
    entry = {"urdf": named}
    if (pairs := _srdf_beside(path, named)) is not None:
        entry["srdf"] = pairs
    return path, entry, top, Tree.of(top)


def _begins(name: str, stem: str) -> bool:
    return re.match(rf"{re.escape(stem)}(?![^\W_])", name) is not None


def _part(urdf: str, i: int, n: int, file: Path, apart: float, srdf: str | None = None) -> _Part:
    """Read one URDF and find its arms."""
    path, entry, top, tree = _read(urdf, file)
    notes: list[str] = []
    groups: dict[str, frozenset[str]] = {}
    if srdf is not None:
        entry["srdf"] = srdf if "://" in srdf else os.path.relpath(srdf, file.absolute().parent)
        groups = tree.groups(elements_in(resolve(entry["srdf"], file), SRDF))
    elif "srdf" in entry:
        notes.append(
            f"pairs that need not be kept apart are those of {Path(entry['srdf']).name}, which lay beside the URDF"
        )
    if n > 1:
        entry["prefix"] = f"{SIDES[i]}_" if n == len(SIDES) else f"robot{i + 1}_"
        entry["base"] = {"position": [0.0, round(apart * (0.5 * (n - 1) - i), 6), 0.0]}
        notes.append(
            f"the base of {path.stem} number {i + 1} stands at y = {entry['base']['position'][1]:g} m"
        )
    chains, prefix = tree.chains(), entry.get("prefix", "")
    notes += [
        f"{', '.join(prefix + name for name in chain.joints)} are called like a leg, a wheel or a neck, and are no "
        f"arm: they stay; if they are one, add it to `arms`: {{NAME: {{tip: {prefix}{chain.tip}}}}}"
        for chain in chains
        if chain.is_other
    ]
    if rest := tree.rest(chains):
        notes.append(
            f"{', '.join(prefix + name for name in rest)} belong to no chain of four joints: they stay"
        )
    arms = tuple(chain for chain in chains if not chain.is_other)
    if any(len(chain.joints) < FREEDOMS for chain in arms) and has_rounded_right_angles(top):
        entry["round_right_angles"] = True
        notes.append(
            "angles such as 1.5708 are taken for right angles: five joints cannot make up for the rest"
        )
    names = {
        arm.joints: re.sub(r"[^\w-]+", "_", prefix + name)[:MAX_NAME]
        for name, joints in reversed(groups.items())
        for arm in arms
        if joints == set(arm.joints)
    }
    unnamed = [", ".join(arm.joints) for arm in arms if groups and arm.joints not in names]
    notes += [
        f"no group of the SRDF has just the joints {one}, so the arm has a name of its own" for one in unnamed
    ]
    return _Part(entry, tree, arms, tuple(notes), names)


def _arm_name(chain: Chain, prefix: str, taken: dict[str, Any]) -> str:
    """Return the name of an arm: its side where the names tell, else that of the model, else a number."""
    found = SIDE_OF.search(prefix) or SIDE_OF.search(chain.joints[0]) or SIDE_OF.search(chain.tip)
    letter = "" if found is None else (found.group(1) or found.group(2))[0].lower()
    name = {"l": "left", "r": "right"}.get(letter, "arm")
    while name in taken:
        stem, _, digits = name.partition("_")
        name = f"{stem}_{int(digits or 1) + 1}"
    return name


def _limits_of(part: _Part) -> dict[str, dict[str, float]]:
    """Return limits of arms' joints without usable ones, and others' missing ones."""
    found: dict[str, dict[str, float]] = {}
    moving = {joint for chain in part.chains for joint in (*chain.joints, *chain.fingers)}
    for joint in part.tree.joints:
        usual = GUESSED.get(joint.kind, {})
        stated = {key: value for key, value in joint.limits.items() if key not in joint.guessed}
        missing = {key: value for key, value in usual.items() if key not in stated}
        if joint.name in moving:
            missing = {
                key: value
                for key, value in usual.items()
                if not 0.0 < (stated.get(key) or 0.0) <= LARGEST_LIMIT
            }
            lower, upper = joint.bounds
            if joint.kind == "continuous" or not lower < upper:
                missing |= {"lower": -SETTINGS.endless, "upper": SETTINGS.endless}
            elif (right := in_radians_or_metres(lower, upper, slides=joint.kind == "prismatic")) is not None:
                missing |= dict(zip(("lower", "upper"), right, strict=True))
        if missing:
            found[part.prefix + joint.name] = missing
    return found


def _robot(data: dict[str, Any], file: Path) -> Robot:
    return assembled(RobotFile.model_validate(data), file)


def _with_tools(
    data: dict[str, Any], robot: Robot, parts: Sequence[_Part]
) -> tuple[dict[str, Any], list[str]]:
    """Return the description with missing grasp frames of arms, and notes."""
    chains = [(part.prefix, chain) for part in parts for chain in part.chains]
    arms, notes = dict(data["arms"]), []
    for arm, (prefix, chain) in zip(robot.arms, chains, strict=True):
        hand = robot.gripper_links(arm) or {prefix + link for link in (*chain.links, *chain.grippers)}
        held = points_from_tip(robot, arm, hand)
        at_tip = any(has_word(chain.tip, word) for word in BETWEEN) or bool(TOOL_FRAME.search(chain.tip))
        if not arm.fingers:
            tool, note = _flange(robot, arm, held[:0] if at_tip else held)
            arms[arm.name] = arms[arm.name] | tool
            notes.append(note)
            continue
        turn, begin = _grasp_axes(_finger_frames(robot, arm), bool(FORWARD.search(chain.tip)))
        approach = turn[:, 2]
        end = float((held @ approach).max(initial=begin))
        between = at_tip and begin + SETTINGS.between * (end - begin) <= 0.0
        if between and approach[2] > 0.5:
            continue
        if between:
            arms[arm.name] = arms[arm.name] | _tool(turn, 0.0)
            notes.append(
                f"the tool of '{arm.name}' turns '{arm.tip}', whose fingers point along its {_axis_name(approach)}, "
                "so that z is the direction of approach"
            )
            continue
        arms[arm.name] = arms[arm.name] | _tool(turn, begin + SETTINGS.grip * (end - begin))
        where = (
            f"{SETTINGS.grip:.0%} of the way along its fingers" if end > begin else "where the fingers begin"
        )
        notes.append(
            f"the tool of '{arm.name}' is {where}, its approach along {_axis_name(approach)} of '{arm.tip}': see the "
            "picture, and move it between the finger tips"
        )
    return data | {"arms": arms}, notes


def _with_gripper(data: dict[str, Any], gripper: str, file: Path) -> tuple[dict[str, Any], list[str]]:
    """Return the description with a gripper on arms without fingers, and notes.

    The gripper's bodies are turned along the approach of the arm.
    """
    path, entry, _, tree = _read(gripper, file)
    if chain := next((chain for chain in tree.chains() if len(chain.joints) > SHAPE.longest_finger), None):
        raise RobotError(
            f"it has an arm of its own, from '{chain.joints[0]}' to '{chain.joints[-1]}'",
            file=path,
            way_out="name the URDF of the gripper alone",
        )
    moving = [joint.name for joint in tree.joints if joint.kind in MOVING]
    bare = _robot(data, file)
    data = data | {"arms": dict(data["arms"]), "limits": dict(data.get("limits", {}))}
    arms, notes = [arm for arm in bare.arms if not arm.fingers], list[str]()
    if not arms:
        raise RobotError(
            "every arm has fingers already",
            key="--gripper",
            way_out="leave it out, or name a URDF of the arm alone",
        )
    for arm in arms:
        prefix = f"{arm.name}_gripper_"
        fingers = {"fingers": [prefix + name for name in moving]} if moving else {}
        data["arms"][arm.name] = data["arms"][arm.name] | fingers | {"gripper": dict(entry)}
        chain = Chain((), (), (), (), tuple(moving), ())
        guessed = _limits_of(_Part({"prefix": prefix}, tree, (chain,), ()))
        data["limits"] |= guessed
        notes += _told_guesses(guessed)
    if not data["limits"]:
        del data["limits"]
    robot = _robot(data, file)
    for arm in arms:
        points = points_from_tip(robot, arm, robot.gripper_links(arm))
        forward = _nearest_axis(np.concatenate([points, [[0.0, 0.0, 1e-6]]]).mean(axis=0))
        approach, why, _ = _approach_of(bare, arm)
        if (approach != forward).any():
            turn, _ = Rotation.align_vectors(approach, forward)
            quaternion = turn.as_quat(scalar_first=True).round(6).tolist()
            data["arms"][arm.name]["gripper"]["mount"] = {"quaternion_wxyz": quaternion}
        notes.append(
            f"the gripper of '{arm.name}' is mounted on '{arm.tip}', its {_axis_name(forward)} along "
            f"{_axis_name(approach)} of that, {why}: see the picture, and correct `mount`"
        )
    return data, notes


def _tool(turn: Array, along: float) -> dict[str, Any]:
    """Return a tool's entry, empty where it is the tip itself.

    Parameters
    ----------
    turn : array, shape (3, 3), its axes in those of the tip
    along : its distance from the tip along its approach [m]
    """
    tool = {}
    if np.abs(turn - np.eye(3)).max() > 1e-6:
        tool["quaternion_wxyz"] = quaternion_of_rotation(turn).round(6).tolist()
    if along != 0.0:
        tool["position"] = (along * turn[:, 2]).round(4).tolist()
    return {"tool": tool} if tool else {}


def _axis_name(axis: Array) -> str:
    return f"{'-' if axis.sum() < 0 else ''}{'xyz'[int(np.abs(axis).argmax())]}"


def _flange(robot: Robot, arm: Arm, hand: Array) -> tuple[dict[str, Any], str]:
    """Return the tool's entry of an arm without fingers, and a note.

    The payload is at the end of the bodies fixed to the tip; where an end effector without a body is known by its
    mass alone, at its centre.

    Parameters
    ----------
    hand : array, shape (n, 3), points around the bodies fixed to the tip; empty for a tip that is the tool itself [m]
    """
    approach, why, center = _approach_of(robot, arm)
    least = float(center @ approach) if why == BY_MASS else 0.0
    end = float((hand @ approach).max(initial=least))
    axes = np.column_stack([np.roll(approach, 1), np.roll(approach, 2), approach])
    axes[:, 0] *= np.linalg.det(axes)
    return _tool(axes, max(end, 0.0)), (
        f"the arm '{arm.name}' ends in '{arm.tip}' without fingers: its tool is taken for the end of that, its "
        f"approach along {_axis_name(approach)}, {why}; give the one that it holds the payload with, "
        "tool: {position: [0, 0, LENGTH]}"
    )


BY_NAME = "as its name says"
BY_PLACE = "away from the last joint"
BY_MASS = "towards the mass of the hand"
BY_AXIS = "along the axis of the last joint, away from the others"
BY_CHAIN = "away from the joints before"
BY_NOTHING = "as nothing tells of another"


def _approach_of(robot: Robot, arm: Arm) -> tuple[Array, str, Array]:
    """Return a bare tip's signed approach axis, the reason, and a centre.

    The centre of mass [m] is the end effector's, in the tip's frame. A tool's frame has z forward by convention
    (ROS-Industrial's tool0), a flange's has z or x forward. The centre of mass is decisive only for an end effector
    that reaches out aside of the last axis: that of a bare flange lies behind it.
    """
    model, data = robot.model, robot.model.createData()
    last, *before = (int(column) + 1 for column in arm.columns[::-1])
    pin.framesForwardKinematics(model, data, robot.home)
    tip, origin = data.oMf[model.getFrameId(arm.tip)], data.oMi[last].translation
    turn, forward = tip.rotation.T, np.array([0.0, 0.0, 1.0])
    place = turn @ (tip.translation - origin)
    axis = turn @ data.oMi[last].rotation @ joint_axes(model)[0][last - 1]
    center = np.array(tip.actInv(data.oMi[last].act(model.inertias[last].lever)))
    steps = (turn @ (origin - data.oMi[joint].translation) for joint in before)
    far = next((step for step in steps if np.linalg.norm(step) > SETTINGS.tip_off), None)
    along = float((place + center) @ axis)
    aside = place + center - along * axis
    if FORWARD.search(arm.tip):
        found = forward, BY_NAME
    elif np.linalg.norm(place) > SETTINGS.tip_off:
        found = _nearest_axis(place), BY_PLACE
    elif has_word(arm.tip, MOUNT):
        found = np.roll(forward, 1) if np.abs(axis).argmax() == 0 else forward, BY_NAME
    elif np.linalg.norm(aside) > max(SETTINGS.mass_off, abs(along)):
        found = _nearest_axis(aside), BY_MASS
    elif far is not None and abs(far @ axis) > 0.5 * np.linalg.norm(far):
        found = _nearest_axis(float(far @ axis) * axis), BY_AXIS
    elif abs(along) > SETTINGS.mass_off:
        found = _nearest_axis(along * axis), BY_MASS
    else:
        found = (forward, BY_NOTHING) if far is None else (_nearest_axis(far), BY_CHAIN)
    return *found, center


def _grasp_axes(frames: Array, z_is_forward: bool) -> tuple[Array, float]:
    """Return a grasp frame's axes, and the fingers' start along it [m].

    The axes are in the tip's frame. `frames` are those of `_finger_frames`; `z_is_forward` of tips whose z is their
    approach by convention.
    """
    from_wrist, fingers = frames[0], frames[1:]  # the tip is at minus the one from the last joint
    middle = fingers.mean(axis=0)
    approach = np.array([0.0, 0.0, 1.0])
    if np.linalg.norm(middle) > 1e-3 and not z_is_forward:
        approach = _nearest_axis(middle)
    spread = np.ptp(fingers, axis=0) if len(fingers) > 1 else np.array([0.0, 1.0, 0.0])
    across = _nearest_axis(spread - (spread @ approach) * approach)
    if abs(across @ approach) > 0.5:
        across = np.roll(approach, 1)
    axes = np.column_stack([np.cross(across, approach), across, approach])
    return axes, float((middle - from_wrist) @ approach)


def _finger_frames(robot: Robot, arm: Arm) -> Array:
    """Return tip and fingers' joints from the last joint; array, (1 + n_fingers, 3) [m], along the tip's axes."""
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, robot.home)
    wrist, tip = data.oMi[int(arm.columns[-1]) + 1].translation, data.oMf[model.getFrameId(arm.tip)]
    frames = [tip, *(data.oMf[frame_of_joint(model, finger)] for finger in arm.fingers)]
    return np.array([tip.rotation.T @ (frame.translation - wrist) for frame in frames])


def _nearest_axis(vector: Array) -> Array:
    """Return the signed axis that is nearest to a vector; array, shape (3,)."""
    axis, k = np.zeros(3), int(np.abs(vector).argmax())
    axis[k] = 1.0 if vector[k] >= 0.0 else -1.0
    return axis


def _left_out(
    robot: Robot, parts: Sequence[_Part], seed: int
) -> tuple[dict[str, dict[Pair, str]], dict[str, list[str]]]:
    """Find pairs of links that nearly always touch, or never despite nearness.

    They are links of one model. Links of different models must not touch, wherever the bases stand.

    Returns
    -------
    by URDF its pairs, as it names the links, with the reason of each in SRDF's terms; and by arm the links that its
    gripper touches so
    """
    rng = np.random.default_rng(seed)
    drawn = rng.uniform(robot.lower, robot.upper, (SETTINGS.n_samples, len(robot.lower)))
    shares = touching(robot, drawn).mean(axis=0)
    always = {pair for pair, share in zip(pairs_of(robot), shares, strict=True) if share >= SETTINGS.always}
    never = near_but_apart(robot, clearance_at_home(robot), SETTINGS.n_samples, rng)
    reasons = dict.fromkeys(sorted(always), "Always") | dict.fromkeys(sorted(never), "Never")
    found: dict[str, dict[Pair, str]] = {part.entry["urdf"]: {} for part in parts}
    touched: dict[str, list[str]] = {}
    for arm in robot.arms:
        own = robot.gripper_links(arm)
        for pair in [pair for pair in reasons if own & set(pair)]:
            del reasons[pair]
            touched.setdefault(arm.name, []).extend(link for link in pair if link not in own)
    for part, ((a, b), reason) in product(parts, reasons.items()):
        if a.startswith(part.prefix) and b.startswith(part.prefix):
            inside = a.removeprefix(part.prefix), b.removeprefix(part.prefix)
            found[part.entry["urdf"]][inside] = reason
    return found, {name: sorted(set(links)) for name, links in touched.items()}


def _srdf(part: _Part, left_out: dict[str, dict[Pair, str]], file: Path) -> str:
    """Return the SRDF of a model with its left-out pairs."""
    top = ET.Element("robot", name=part.tree.name)
    if "srdf" in part.entry:
        top = elements_in(resolve(part.entry["srdf"], file), SRDF)
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
