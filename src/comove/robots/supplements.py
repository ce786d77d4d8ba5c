"""Properties of a robot that Pinocchio does not read from its URDF: further joint limits, and masses of links.

A ``<safety_controller soft_lower_limit="a" soft_upper_limit="b" k_position="k"/>`` bounds the velocities that ROS's
controllers allow by -k (q - a) from below and by -k (q - b) from above: so q + q'/k stays within the *soft limits* a
and b, and q as well. They bind wherever a URDF states them, but for joints that turn without end. Its ``k_velocity``
bounds the effort of joints that are commanded by efforts; a URDF does not tell how a joint is commanded, so it is not
used.

``<limit>`` may have the attributes `acceleration`, `deceleration` and `jerk`, with any prefix, such as Drake's
``drake:acceleration``.

Sources: ``joint_limits_interface`` of ros_control (`PositionJointSoftLimitsHandle`), the ROS wiki's
``pr2_controller_manager/safety_limits``, and Drake's notes on parsing (``drake:acceleration``).

Masses that a model does not state are guessed from collision bodies only where nothing that a joint moves has one:
models often give a link's mass to its neighbour.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from comove.arrays import Array
from comove.errors import RobotError
from comove.robots.description import JointLimits
from comove.robots.soundness import LIMITED, MOMENTS, RATES, ends_of, local_name, number

# rad and m, of a joint of an arm: none turns twice either way, nor slides so far
LARGEST_TURN, LARGEST_STROKE = 4.0 * math.pi, 50.0
SOFT = {"soft_lower": "soft_lower_limit", "soft_upper": "soft_upper_limit"}  # by key of a description


@dataclass(frozen=True)
class FurtherLimits:
    """Limits of a joint that Pinocchio does not read [rad, m for prismatic joints, s].

    Attributes
    ----------
    soft_lower, soft_upper : soft limits, infinite where there are none
    approach : 1/k_position, time constant with which the joint may approach its position limits [s]; 0 where none
    acceleration, jerk : None where they are not stated
    """

    soft_lower: float = -math.inf
    soft_upper: float = math.inf
    approach: float = 0.0
    acceleration: float | None = None
    jerk: float | None = None


def further_limits(joint: ET.Element, name: str, given: JointLimits | None) -> FurtherLimits:
    """Return the further limits of a joint; those of the description replace those of the URDF, key by key.

    Parameters
    ----------
    joint : the joint of the URDF, found sound (`comove.robots.soundness`), with the description's limits filled in
    name : its name with the model's prefix, for messages
    given : limits of the description

    Raises
    ------
    RobotError
        If soft limits leave no range within the others.
    """
    stated = _rates(joint) | _soft(joint)
    if given is not None:
        stated |= given.model_dump(include={*SOFT, *RATES, "k_position"}, exclude_none=True)
    gain = stated.pop("k_position", 0.0)
    limits = FurtherLimits(**stated, approach=1.0 / gain if gain > 0.0 else 0.0)
    lower, upper = _hard(joint)
    if lower < upper and not max(lower, limits.soft_lower) < min(upper, limits.soft_upper):
        raise RobotError(
            f"the joint '{name}' has the soft limits {limits.soft_lower:g} to {limits.soft_upper:g}, which leave "
            f"nothing of its limits {lower:g} to {upper:g}",
            way_out=f"correct its <safety_controller>, or replace it in the description: limits: {{{name}: "
            f"{{soft_lower: {lower:g}, soft_upper: {upper:g}}}}}",
        )
    return limits


def doubts_of_limits(
    joints: Mapping[str, ET.Element], limits: Mapping[str, FurtherLimits], given: Mapping[str, JointLimits]
) -> Iterator[str]:
    """Yield warnings of soft limits that may not be what was meant.

    Parameters
    ----------
    joints : joints of the URDF, by name
    limits : their further limits
    given : limits of the description
    """
    one_sided: dict[str, list[str]] = {}
    beyond: dict[str, list[str]] = {}
    for name, joint in joints.items():
        replaced = given[name].model_dump(exclude_none=True) if name in given else {}
        safety, soft = joint.find("safety_controller"), _soft(joint)
        for key, attribute in SOFT.items():
            if soft and safety is not None and attribute not in safety.attrib and key not in replaced:
                one_sided.setdefault(name, []).append(f"{key}: 0")
        for key, end, narrower in zip(("lower", "upper"), _hard(joint), (max, min), strict=True):
            bound = getattr(limits[name], f"soft_{key}")
            if key in replaced and f"soft_{key}" not in replaced and narrower(end, bound) != end:
                beyond.setdefault(name, []).append(f"soft_{key}: {end!r}")
    if one_sided:
        yield (
            f"one soft limit of {_listed(one_sided)} is not stated and so is 0, as in ROS; state it in the URDF, or "
            f"write limits: {_as_limits(one_sided)}"
        )
    if beyond:
        yield (
            f"limits of the description of {_listed(beyond)} go beyond the soft limits in the URDF, which bind; to "
            f"replace these, write limits: {_as_limits(beyond)}"
        )


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)


def _as_limits(keys: Mapping[str, list[str]]) -> str:
    return "{" + ", ".join(f"{name}: {{{', '.join(values)}}}" for name, values in keys.items()) + "}"


def stated_limits(joint: ET.Element) -> dict[str, float | None]:
    """Return the numbers that a joint's <limit> states, by attribute; None where a text is none.

    Position limits are narrowed to the soft ones. The joint need not be sound.
    """
    limits = {key: number(text) for limit in joint.findall("limit") for key, text in limit.attrib.items()}
    with suppress(ValueError):
        soft = _soft(joint)
        for key, narrower in (("lower", max), ("upper", min)):
            if soft and limits.get(key) is not None:
                limits[key] = narrower(float(limits[key] or 0.0), soft[f"soft_{key}"])
    return limits


def in_radians_or_metres(lower: float, upper: float, *, slides: bool) -> tuple[float, float] | None:
    """Return limits that must be meant in degrees or millimetres in radians or metres; None for all others."""
    if max(abs(lower), abs(upper)) <= (LARGEST_STROKE if slides else LARGEST_TURN):
        return None
    factor = 1e-3 if slides else math.pi / 180.0
    return float(f"{factor * lower:.6g}"), float(f"{factor * upper:.6g}")


def _hard(joint: ET.Element) -> tuple[float, float]:
    limit = joint.find("limit")
    texts = [None if limit is None else limit.get(key) for key in ("lower", "upper")]
    if joint.get("type") not in LIMITED:
        return -math.inf, math.inf
    return float(texts[0] or 0.0), float(texts[1] or 0.0)  # as Pinocchio reads what is missing


def _rates(joint: ET.Element) -> dict[str, float]:
    """Return the least acceleration and jerk that the attributes of a <limit> state."""
    found: dict[str, float] = {}
    for limit in joint.findall("limit"):
        for attribute, text in limit.attrib.items():
            for key, names in RATES.items():
                if local_name(attribute) in names:
                    found[key] = min(found.get(key, math.inf), float(text))
    return found


def _soft(joint: ET.Element) -> dict[str, float]:
    """Return the soft limits, where a joint has any, and its `k_position`."""
    safety = joint.find("safety_controller")
    if safety is None or joint.get("type") not in LIMITED or not set(SOFT.values()) & set(safety.attrib):
        return {}
    found = {key: float(safety.get(attribute, "0")) for key, attribute in SOFT.items()}
    return found | {"k_position": float(safety.get("k_position", "0"))}


DENSITY = 1000.0  # kg/m^3
ROUNDING = 1e-9  # share of a mass
MAX_TOLD = 6


def moved_masses(model: Any, without: float | Array = 0.0) -> Array:
    """Return the masses that the joints of a model move; array, shape (n_joints + 1,), the universe first [kg].

    Parameters
    ----------
    without : masses that do not count, as `masses_of` returns them
    """
    masses = np.array([inertia.mass for inertia in model.inertias])
    masses = np.where(masses - without > ROUNDING * masses, masses - without, 0.0)
    for joint in range(model.njoints - 1, 0, -1):
        masses[model.parents[joint]] += masses[joint]
    return masses


def mass_beyond(joint: str, urdfs: Iterable[str]) -> float:
    """Return the mass of all links beyond the one that a joint moves [kg]: of the hand, if it is an arm's last."""
    for urdf in urdfs:
        ends = {each.get("name", ""): ends_of(each) for each in ET.fromstring(urdf).findall("joint")}
        if joint in ends:
            break
    below = dict[str, list[str]]()
    for parent, child in ends.values():
        below.setdefault(parent, []).append(child)
    beyond = list(below.get(ends[joint][1], []))
    for name in beyond:
        beyond += below.get(name, [])
    masses = _link_masses(urdf)
    return sum(masses.get(name, 0.0) for name in beyond)


def masses_of(urdf: str, links: Collection[str], model: Any) -> Array:
    """Return the masses of some links of a URDF by the joint that moves each; array, shape (n_joints + 1,) [kg]."""
    masses = np.zeros(model.njoints)
    for link, mass in _link_masses(urdf).items() if links else ():
        if link in links:
            masses[model.frames[model.getFrameId(link, pin.FrameType.BODY)].parentJoint] += mass
    return masses


def _link_masses(urdf: str) -> dict[str, float]:
    links = (
        (link.get("name", ""), link.find("inertial/mass")) for link in ET.fromstring(urdf).findall("link")
    )
    return {name: float(mass.get("value", "0")) for name, mass in links if mass is not None}


def with_guessed_masses(
    urdf: str, known: Mapping[str, float], grippers: Collection[str], model: Any, geometry: Any
) -> tuple[str, str | None]:
    """Give masses to links that have none, or a mass alone, in a model and in its URDF.

    Parameters
    ----------
    known : masses of links whose inertia follows from their bodies, by name [kg]
    grippers : names of the links of grippers, whose masses are not guessed
    model : pinocchio.Model of the URDF, which is changed
    geometry : pinocchio.GeometryModel of its collision bodies

    Returns
    -------
    the URDF with these masses, and a note about them; None where there was nothing to guess
    """
    bodies = dict[int, list[Any]]()
    massless = moved_masses(model, masses_of(urdf, grippers, model)) == 0.0
    for item in geometry.geometryObjects:
        name = model.frames[item.parentFrame].name
        guess = item.parentJoint > 0 and massless[item.parentJoint] and name not in grippers
        if guess or name in known:
            bodies.setdefault(item.parentFrame, []).append(item)
    found = {frame: _inertia(items, model.frames[frame].placement) for frame, items in bodies.items()}
    guessed = {}
    for frame, inertia in found.items():
        mass = known.get(model.frames[frame].name)
        if mass is None and inertia.mass > 0.0:
            guessed[frame] = inertia
        elif mass is not None:
            found[frame] = _of_mass(inertia, mass, model.frames[frame].name)
    if not guessed and not known:
        return urdf, None
    tree = ET.fromstring(urdf)
    links = {link.get("name"): link for link in tree.findall("link")}
    for frame, inertia in found.items():
        if inertia.mass > 0.0:
            place = model.frames[frame]
            model.appendBodyToJoint(place.parentJoint, inertia, place.placement)
            _write(links[place.name], inertia)
    urdf = ET.tostring(tree, encoding="unicode")
    if not guessed:
        return urdf, None
    told = [f"{model.frames[frame].name} {inertia.mass:.3g} kg" for frame, inertia in guessed.items()]
    more = f" and {len(told) - MAX_TOLD} more" if len(told) > MAX_TOLD else ""
    note = (
        f"links that joints move have no masses; they were guessed from collision bodies, at {DENSITY:g} kg/m^3: "
        f"{', '.join(told[:MAX_TOLD])}{more}: what they ask of the motors is a guess; write <inertial> into the links"
    )
    return urdf, note


def _of_mass(inertia: Any, mass: float, link: str) -> Any:
    """Return an inertia of the same shape that has a mass [kg]."""
    if not inertia.mass > 0.0:
        raise RobotError(
            f"the bodies of '{link}' have no volume, over which its mass could be spread",
            way_out="give it a body that is not flat",
        )
    share = mass / inertia.mass
    return pin.Inertia(mass, np.array(inertia.lever), share * np.array(inertia.inertia))


def _inertia(items: Iterable[Any], link: Any) -> Any:
    """Return the inertia of collision bodies in the frame of their link, whose placement is given."""
    total = pin.Inertia.Zero()
    for item in items:
        shape = item.geometry
        if isinstance(shape, coal.BVHModelBase):
            try:
                shape.buildConvexHull(True, "Qt")
            except RuntimeError:  # flat
                continue
            shape = shape.convex
        volume = shape.computeVolume()
        own = pin.Inertia(
            DENSITY * volume,
            np.array(shape.computeCOM()),
            DENSITY * np.array(shape.computeMomentofInertiaRelatedToCOM()),
        )
        total += link.actInv(item.placement).act(own)
    return total


def _write(link: ET.Element, inertia: Any) -> None:
    """Write an inertia into a link of a URDF."""
    for old in link.findall("inertial"):
        link.remove(old)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=" ".join(repr(float(x)) for x in inertia.lever))
    ET.SubElement(inertial, "mass", value=repr(float(inertia.mass)))
    ET.SubElement(
        inertial, "inertia", {key: repr(float(inertia.inertia[row, column])) for key, row, column in MOMENTS}
    )
