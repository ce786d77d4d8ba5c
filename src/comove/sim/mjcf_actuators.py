"""Joint limits from the actuators of a compiled MuJoCo model.

They are efforts, speeds and ranges. An actuator applies gain * u + bias to its target, u being its control or
activation. The force of a motor, or of a velocity servo at rest, follows from its range of controls; that of a
position servo is limited by its range of forces alone, and its controls limit the position.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import inf, isfinite
from typing import Any

EVERYWHERE = (-inf, inf)


@dataclass(frozen=True)
class Drive:
    """Limits of a joint from a model's actuators.

    Attributes
    ----------
    is_driven : whether any actuator drives it
    least, largest : effort of all actuators together [N m, N]; infinite where nothing limits it
    velocity : largest commanded speed [rad/s, m/s]; infinite where nothing limits it
    lower, upper : commanded positions [rad, m]; infinite where nothing limits them
    """

    is_driven: bool = False
    least: float = 0.0
    largest: float = 0.0
    velocity: float = inf
    lower: float = -inf
    upper: float = inf

    @property
    def effort(self) -> float | None:
        """Return the effort available both ways; None without a limit. Of a one-sided drive, return the largest
        one."""
        most = min(-self.least, self.largest) if not self.is_one_sided else max(-self.least, self.largest)
        return most if isfinite(most) and most > 0.0 else None

    @property
    def is_one_sided(self) -> bool:
        """Return whether the joint is driven one way only."""
        return not self.least < 0.0 < self.largest


def drives_of(mj: Any, model: Any) -> list[Drive]:
    """Return the limits of every joint from its actuators."""
    drives = [Drive() for _ in range(model.njnt)]
    for actuator in range(model.nu):
        for joint, ratio in driven(mj, model, actuator):
            drives[joint] = _with(mj, model, actuator, drives[joint], ratio)
    for joint, drive in enumerate(drives):
        if drive.is_driven and model.jnt_actfrclimited[joint]:
            least, largest = model.jnt_actfrcrange[joint].tolist()
            drives[joint] = replace(drive, least=max(drive.least, least), largest=min(drive.largest, largest))
        elif model.jnt_actfrclimited[joint]:
            drives[joint] = replace(
                drive, **dict(zip(("least", "largest"), model.jnt_actfrcrange[joint].tolist(), strict=True))
            )
    return drives


def driven(mj: Any, model: Any, actuator: int) -> Iterator[tuple[int, float]]:
    """Yield the joints that an actuator drives, with transmission ratios. It drives a joint directly or by a fixed
    tendon; the ratio is the effort at the joint for a force of one."""
    kind, target = model.actuator_trntype[actuator], int(model.actuator_trnid[actuator, 0])
    gear = float(model.actuator_gear[actuator, 0])
    if is_one_of(kind, mj.mjtTrn.mjTRN_JOINT, mj.mjtTrn.mjTRN_JOINTINPARENT):
        yield target, gear
    elif is_one_of(kind, mj.mjtTrn.mjTRN_TENDON):
        first = int(model.tendon_adr[target])
        for wrap in range(first, first + int(model.tendon_num[target])):
            if is_one_of(model.wrap_type[wrap], mj.mjtWrap.mjWRAP_JOINT):
                yield int(model.wrap_objid[wrap]), gear * float(model.wrap_prm[wrap])


def is_one_of(kind: Any, *kinds: Any) -> bool:
    """Return whether a model's entry is one of some kinds. MuJoCo's kinds compare with it in one order only."""
    return int(kind) in map(int, kinds)


def _with(mj: Any, model: Any, actuator: int, drive: Drive, ratio: float) -> Drive:
    """Return a joint's limits with one more actuator of a ratio."""
    if ratio == 0.0:
        return replace(drive, is_driven=True)
    least, largest = _scaled(_forces(mj, model, actuator), ratio)
    velocity, (lower, upper) = _commands(mj, model, actuator)
    lower, upper = _scaled((lower, upper), 1.0 / ratio)
    return Drive(
        is_driven=True,
        least=drive.least + least,
        largest=drive.largest + largest,
        velocity=min(drive.velocity, velocity / abs(ratio)),
        lower=max(drive.lower, lower),
        upper=min(drive.upper, upper),
    )


def _scaled(ends: tuple[float, float], ratio: float) -> tuple[float, float]:
    low, high = (ratio * end for end in ends)
    return min(low, high), max(low, high)


def _forces(mj: Any, model: Any, actuator: int) -> tuple[float, float]:
    """Return the least and largest force of an actuator; else infinite."""
    (low, high), inputs, law = EVERYWHERE, _inputs(mj, model, actuator), _law(mj, model, actuator)
    if law is not None and inputs is not None:
        gain, offset, stiffness, _ = law
        if stiffness == 0.0:
            low, high = (end + offset for end in _scaled(inputs, gain))
    if model.actuator_forcelimited[actuator]:
        least, largest = model.actuator_forcerange[actuator].tolist()
        low, high = max(low, least), min(high, largest)
    return low, high


def _law(mj: Any, model: Any, actuator: int) -> tuple[float, float, float, float] | None:
    """Return an actuator's gain, and its bias's offset, stiffness and damping. Return None where they vary."""
    kind = model.actuator_biastype[actuator]
    if not is_one_of(model.actuator_gaintype[actuator], mj.mjtGain.mjGAIN_FIXED):
        return None
    if is_one_of(kind, mj.mjtBias.mjBIAS_NONE):
        bias = [0.0, 0.0, 0.0]
    elif is_one_of(kind, mj.mjtBias.mjBIAS_AFFINE):
        bias = model.actuator_biasprm[actuator, :3].tolist()
    else:
        return None
    return float(model.actuator_gainprm[actuator, 0]), bias[0], bias[1], bias[2]


def _inputs(mj: Any, model: Any, actuator: int) -> tuple[float, float] | None:
    """Return the range of an actuator's control or activation, or None."""
    kinds, kind = mj.mjtDyn, model.actuator_dyntype[actuator]
    if is_one_of(kind, kinds.mjDYN_NONE, kinds.mjDYN_FILTER, kinds.mjDYN_FILTEREXACT):
        limited, ends = model.actuator_ctrllimited[actuator], model.actuator_ctrlrange[actuator]
    else:
        limited, ends = model.actuator_actlimited[actuator], model.actuator_actrange[actuator]
    return (float(ends[0]), float(ends[1])) if limited else None


def _commands(mj: Any, model: Any, actuator: int) -> tuple[float, tuple[float, float]]:
    """Return a servo's largest commanded speed and positions, infinite if unlimited."""
    inputs, law, speed, positions = _inputs(mj, model, actuator), _law(mj, model, actuator), inf, EVERYWHERE
    if law is None:
        return speed, positions
    gain, offset, stiffness, damping = law
    if stiffness != 0.0:
        if inputs is not None:
            low, high = ((gain * end + offset) / -stiffness for end in inputs)
            positions = min(low, high), max(low, high)
        integrates = is_one_of(model.actuator_dyntype[actuator], mj.mjtDyn.mjDYN_INTEGRATOR)
        if integrates and model.actuator_ctrllimited[actuator]:
            speed = max(abs(gain / stiffness * float(end)) for end in model.actuator_ctrlrange[actuator])
    elif damping != 0.0 and inputs is not None:
        speed = max(abs((gain * end + offset) / damping) for end in inputs)
    return speed, positions
