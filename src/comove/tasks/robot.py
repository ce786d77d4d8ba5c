"""The robot of a compiled MuJoCo model, as it stands now.

Its URDF, meshes and description lie in a folder of the cache, named after the SHA-256 of their contents. Every file
appears whole, and is checked by its size, so that processes can share them.
"""

from __future__ import annotations

import hashlib
import json
import os
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from pkgutil import get_data
from threading import get_ident
from typing import Any

import numpy as np
import yaml

from comove.arrays import Array
from comove.errors import ComoveWarning, RobotError, near_name
from comove.geometry.rotations import quaternion_of_rotation
from comove.io.files import telling
from comove.robots.description import RobotFile
from comove.robots.model import Robot, assembled
from comove.robots.proposal.bodies import pairs_of, touching
from comove.robots.proposal.homes import clearance_at_home
from comove.robots.proposal.tree import Chain, Joint, Tree
from comove.sim.meshes import cache_folder
from comove.sim.mjcf import MESHES, Converted
from comove.tasks.grippers import Gripper, Hand, gripper_of

URDF = "robot.urdf"
CLOSE = 2
"""Joints between two links of an arm, at most, that need not keep the clearance which they do not have now."""
WITHIN = 0.05
"""How far a joint may be beyond its limits, which are soft in MuJoCo [rad, m]."""
SIDES = ("left", "right")
PHYSICS = ("actuator_", "dof_", "eq_", "jnt_", "tendon_", "wrap_")
"""Beginnings of the names of a model's arrays that say how fingers move."""


@dataclass(frozen=True)
class Rates:
    """Limits of joints for which a model states none.

    Attributes
    ----------
    velocity : largest speed [rad/s, m/s]
    acceleration : largest acceleration [rad/s^2, m/s^2]
    """

    velocity: float = 1.0
    acceleration: float = 5.0


def folder_of(
    mj: Any, model: Any, roots: frozenset[int], converted: Converted, meshes: Mapping[str, bytes]
) -> Path:
    """Return the cache's folder of a model, with URDF and meshes.

    Parameters
    ----------
    roots : trees of the robot; what else moves has another folder only if its meshes differ
    meshes : of all else, by name
    """
    files = {URDF: converted.urdf.encode()}
    files |= {f"{MESHES}/{name}": content for name, content in {**converted.meshes, **meshes}.items()}
    own = {
        "jnt_": np.isin(model.body_rootid[model.jnt_bodyid], list(roots)),
        "dof_": np.isin(model.body_rootid[model.dof_bodyid], list(roots)),
    }
    arrays = [
        np.ascontiguousarray(values[own.get(name[:4], slice(None))]).tobytes()
        for name in dir(model)
        if name.startswith(PHYSICS) and isinstance(values := getattr(model, name), np.ndarray)
    ]
    made_by = [get_data("comove.tasks", f"{name}.py") or b"" for name in ("grippers", "robot")]
    parts = [mj.__version__.encode(), *made_by, *arrays, *(item for file in files.items() for item in file)]
    digest = _digest([part.encode() if isinstance(part, str) else part for part in parts])
    folder = cache_folder("worlds") / digest
    for name, content in files.items():
        _keep(folder / name, content)
    return folder


def _digest(parts: Sequence[bytes]) -> str:
    return hashlib.sha256(b"".join(hashlib.sha256(part).digest() for part in parts)).hexdigest()


def _keep(path: Path, content: bytes) -> None:
    """Write a file of the cache unless it is there."""
    with suppress(OSError):
        if path.stat().st_size == len(content):
            return
    with telling(path.parent, "written", RobotError):
        path.parent.mkdir(parents=True, exist_ok=True)
        draft = path.with_name(f".{path.name}-{os.getpid()}-{get_ident()}")
        draft.write_bytes(content)
        os.replace(draft, path)  # what a cache loses is made again, so nothing waits for the disk


def arms_of(tree: Tree, driven: frozenset[str], named: Mapping[str, str] | None) -> dict[str, Chain]:
    """Return the arms by name: chains of joints that actuators drive.

    Parameters
    ----------
    driven : joints with an actuator
    named : a joint or link of each arm, by the arm's name

    Raises
    ------
    RobotError
        If there is none, or a name belongs to none.
    """
    chains = [chain for chain in tree.chains() if driven.issuperset(chain.joints)]
    if not chains:
        raise RobotError(
            "no arm is in the model: no four joints in a row that actuators drive",
            way_out="give the joints of its arms actuators",
        )
    if named is None:
        return dict(zip(_names(tree, chains), chains, strict=True))
    owners = {
        name: chain
        for chain in chains
        for name in (*chain.joints, *chain.moved, *chain.links, *chain.fingers, *chain.grippers)
    }
    found: dict[str, Chain] = {}
    for arm, name in named.items():
        if name not in owners:
            raise RobotError(
                f"no arm has a joint or body '{name}'", key=f"arms.{arm}", way_out=near_name(name, owners)
            )
        if owners[name] in found.values():
            raise RobotError(
                f"'{name}' is of an arm that has a name already",
                key=f"arms.{arm}",
                way_out="name a joint or body of another one",
            )
        found[arm] = owners[name]
    return found


def _names(tree: Tree, chains: Sequence[Chain]) -> list[str]:
    """Return the names of arms: robot0, robot1 where each stands for itself, else their sides."""
    above = {joint.child: joint for joint in tree.joints}

    def stands_on(chain: Chain) -> str:
        link = chain.moved[0]
        while above[link].parent != tree.root:
            link = above[link].parent
        return link

    if len({stands_on(chain) for chain in chains}) == len(chains):
        return [f"robot{k}" for k in range(len(chains))]
    words = [[*_words(chain.joints[0]), *_words(chain.moved[0])] for chain in chains]
    sides = [next((side for side in SIDES if side in own), "") for own in words]
    if all(sides) and len(set(sides)) == len(sides):
        return sides
    return [f"arm{k}" for k in range(len(chains))]


def _words(name: str) -> list[str]:
    return "".join(letter if letter.isalpha() else " " for letter in name.lower()).split()


def grippers_of(
    mj: Any, model: Any, now: Array, arms: Mapping[str, Chain], joints: Mapping[str, int], folder: Path
) -> dict[str, tuple[Gripper, Array]]:
    """Return grippers and grasp frames by arm, from the cache if there.

    Parameters
    ----------
    now : array, shape (nq,), state of the model from which the fingers move
    joints : numbers of the model's joints, by name
    """
    found: dict[str, tuple[Gripper, Array]] = {}
    for arm, chain in arms.items():
        if not chain.fingers:
            continue
        hand = Hand(body_of(model, chain.tip), tuple(joints[name] for name in chain.fingers))
        begins = now[[int(model.jnt_qposadr[joint]) for joint in hand.joints]]
        file = folder / f"gripper-{_digest([begins.tobytes(), chain.tip.encode()])[:16]}.json"
        try:
            known = json.loads(file.read_text())
        except (OSError, ValueError):
            made = gripper_of(mj, model, now, hand)
            known = None if made is None else {**asdict(made[0]), "frame": made[1].tolist()}
            _keep(file, json.dumps(known).encode())
        if known is not None:
            frame = np.array(known.pop("frame"))
            listed = {key: tuple(known[key]) for key in ("actuators", "open", "closed")}
            found[arm] = Gripper(**{**known, **listed}), frame
    return found


def body_of(model: Any, link: str) -> int:
    """Return the number of the body that is a link."""
    for body in range(model.nbody):
        if link == str(model.body(body).name or f"body{body}"):
            return body
    raise RobotError(f"no body is the link '{link}'", way_out="give the bodies of its arms names")


def robot_now(
    name: str,
    converted: Converted,
    tree: Tree,
    arms: Mapping[str, Chain],
    grippers: Mapping[str, tuple[Gripper, Array]],
    now: Mapping[str, float],
    rates: Rates,
    folder: Path,
) -> Robot:
    """Return the robot at home where it is now, with open grippers.

    Links of one arm, or of its base, that touch each other so need not be kept apart.

    Parameters
    ----------
    now : positions of all joints [rad, m]

    Raises
    ------
    RobotError
        If a joint is beyond its limits, or the description does not fit.
    """
    known = {joint.name: joint for joint in tree.joints if joint.name in now}
    moving = {joint for chain in arms.values() for joint in chain.joints}
    opened = {joint: at for gripper, _ in grippers.values() for joint, at in gripper.posture.items()}
    posture = {joint: value for joint, value in {**now, **opened}.items() if joint not in moving}
    limits = {joint: _limits(known[joint], now[joint], rates) for joint in sorted(moving)}
    limits |= {joint: _wider(known[joint], value) for joint, value in posture.items()}
    springs = {joint: known[joint].springs for joint in sorted(moving) if known[joint].springs > 0.0}
    data: dict[str, Any] = {
        "name": name,
        "models": [{"urdf": URDF}],
        "arms": {
            arm: {
                "tip": chain.tip,
                "tool": _placement(grippers[arm][1] if arm in grippers else np.eye(4)),
                "fingers": [*chain.fingers],
            }
            for arm, chain in arms.items()
        },
        "posture": posture,
        "acceleration": rates.acceleration,
        "limits": {joint: known for joint, known in limits.items() if known},
        "springs": springs,
    }
    srdf = _with_pairs(converted, set())
    if srdf is not None:
        data["models"][0]["srdf"] = _kept(folder, "pairs", "srdf", srdf)
    bare = _robot(yaml.safe_dump(data), folder)
    home = np.array([_within(known[joint], now[joint]) for joint in bare.joint_names])
    if pairs := _touching(bare, home):
        data["models"][0]["srdf"] = _kept(folder, "pairs", "srdf", _with_pairs(converted, pairs) or "")
    for arm in bare.arms:
        data["arms"][arm.name]["home"] = home[arm.columns].tolist()
    text = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=110)
    return _loaded(folder / _kept(folder, "robot", "yaml", text))


def _kept(folder: Path, kind: str, suffix: str, text: str) -> str:
    """Write a text to the cache's folder; return the name of its file."""
    name = f"{kind}-{_digest([text.encode()])[:16]}.{suffix}"
    _keep(folder / name, text.encode())
    return name


def _placement(pose: Array) -> dict[str, list[float]]:
    quaternion = quaternion_of_rotation(pose[:3, :3])
    return {
        "position": pose[:3, 3].tolist(),
        "quaternion_wxyz": (quaternion / np.linalg.norm(quaternion)).tolist(),
    }


def _wider(joint: Joint, value: float) -> dict[str, float]:
    """Return limits of a still joint that contain its value. Servos and soft stops exceed them."""
    lower, upper = joint.bounds
    return ({"lower": value} if value < lower else {}) | ({"upper": value} if value > upper else {})


def _within(joint: Joint, value: float) -> float:
    """Return a joint's value within its limits."""
    lower, upper = joint.bounds
    inside = min(max(value, lower), upper)
    if abs(inside - value) > WITHIN:
        raise RobotError(
            f"the joint '{joint.name}' is at {value:.6g}, outside its limits {lower:g} to {upper:g}",
            way_out="bring it within them",
        )
    return inside


def _limits(joint: Joint, now: float, rates: Rates) -> dict[str, float]:
    """Return the limits of a joint that its URDF lacks. What turns without end turns half a turn from where it is."""
    limits = {"velocity": rates.velocity} if "velocity" in joint.guessed else {}
    if joint.kind == "continuous":
        limits |= {"lower": now - np.pi, "upper": now + np.pi}
    return limits


@lru_cache(maxsize=4)
def _loaded(path: Path) -> Robot:
    """Return the robot of a description in the cache."""
    with warnings.catch_warnings():  # what lacks in a model is told by the world's notes
        warnings.simplefilter("ignore", ComoveWarning)
        return Robot.load(path)


@lru_cache(maxsize=4)
def _robot(text: str, folder: Path) -> Robot:
    """Return the robot of a description without homes."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ComoveWarning)
        return assembled(RobotFile.model_validate(yaml.safe_load(text)), folder / os.fspath(URDF))


def _touching(robot: Robot, q: Array) -> set[tuple[str, str]]:
    """Return pairs of links of one arm that touch, or nearly.

    Nearly is within the clearance at home, with few joints between them.

    Parameters
    ----------
    q : array, shape (n_joints,) [rad, m]
    """
    geometry, model = robot.collision, robot.model
    columns = [set(arm.columns.tolist()) for arm in robot.arms]
    near, hit = (touching(robot, q[None], margin)[0] for margin in (clearance_at_home(robot), 0.0))
    found = set[tuple[str, str]]()
    for k, (pair, links) in enumerate(zip(geometry.collisionPairs, pairs_of(robot), strict=True)):
        moved = [
            {
                model.idx_vs[joint]
                for joint in model.supports[geometry.geometryObjects[body].parentJoint]
                if joint
            }
            for body in (pair.first, pair.second)
        ]
        owners = [{i for i, own in enumerate(columns) if own & joints} for joints in moved]
        if all(owners) and not owners[0] & owners[1]:
            continue
        if hit[k] or (near[k] and len(moved[0] ^ moved[1]) <= CLOSE):
            found.add(links)
    return found


def _with_pairs(converted: Converted, pairs: set[tuple[str, str]]) -> str | None:
    """Return the SRDF of a model with further pairs, None without any."""
    if converted.srdf is None and not pairs:
        return None
    top = (
        ET.Element("robot", name=converted.name) if converted.srdf is None else ET.fromstring(converted.srdf)
    )
    for one, other in sorted(pairs):
        ET.SubElement(top, "disable_collisions", link1=one, link2=other, reason="Default")
    ET.indent(top)
    return ET.tostring(top, encoding="unicode") + "\n"
