"""Limits of joints that Pinocchio does not read from a URDF: soft limits, acceleration and jerk.

A ``<safety_controller soft_lower_limit="a" soft_upper_limit="b" k_position="k"/>`` bounds the velocities that ROS's
controllers allow by -k (q - a) from below and by -k (q - b) from above: so q + q'/k stays within the *soft limits* a
and b, and q as well. They bind wherever a URDF states them, but for joints that turn without end. Its ``k_velocity``
bounds the effort of joints that are commanded by efforts; a URDF does not tell how a joint is commanded, so it is not
used.

``<limit>`` may have the attributes `acceleration`, `deceleration` and `jerk`, with any prefix, such as Drake's
``drake:acceleration``.

Sources: ``joint_limits_interface`` of ros_control (`PositionJointSoftLimitsHandle`), the ROS wiki's
``pr2_controller_manager/safety_limits``, and Drake's notes on parsing (``drake:acceleration``).
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass

from comove.errors import RobotError
from comove.robots.description import JointLimits
from comove.robots.soundness import LIMITED, RATES, local_name, number

# rad and m, of a joint of an arm: none turns twice either way, nor slides so far
LARGEST_TURN, LARGEST_STROKE = 4.0 * math.pi, 50.0
SOFT = {"soft_lower": "soft_lower_limit", "soft_upper": "soft_upper_limit"}  # by key of a description


@dataclass(frozen=True)
class FurtherLimits:
    """Joint limits beyond Pinocchio's [rad, m for prismatic joints, s].

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
    """Return the further limits of a joint. Those of the description replace those of the URDF, key by key.

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
    """Yield warnings of soft limits that may be unintended.

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
    """Convert limits apparently in degrees or millimetres; None for all others."""
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
    """Return the least acceleration and jerk that a <limit> states."""
    found: dict[str, float] = {}
    for limit in joint.findall("limit"):
        for attribute, text in limit.attrib.items():
            for key, names in RATES.items():
                if local_name(attribute) in names:
                    found[key] = min(found.get(key, math.inf), float(text))
    return found


def _soft(joint: ET.Element) -> dict[str, float]:
    """Return the soft limits of a joint, if any, and its `k_position`."""
    safety = joint.find("safety_controller")
    if safety is None or joint.get("type") not in LIMITED or not set(SOFT.values()) & set(safety.attrib):
        return {}
    found = {key: float(safety.get(attribute, "0")) for key, attribute in SOFT.items()}
    return found | {"k_position": float(safety.get("k_position", "0"))}
