"""Kinds of movements that the files of primitives hold: how each is written, read and traced.

Writing gives mappings, lists and numbers for JSON; reading checks all of them. `traced` gives the coordinates of a
movement at some instants, by which weights that were made for another basis are noticed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.errors import OptionError, near_name
from comove.primitives.average import AveragedDMP
from comove.primitives.basis import MAX_BASIS
from comove.primitives.cooperative import CooperativeDMP
from comove.primitives.dmp import DMP
from comove.primitives.entries import LEARN_AGAIN, FileEntry, shown
from comove.primitives.phase import FASTEST, ExponentialPhase, LinearPhase, Phase
from comove.primitives.pose_distributions import PoseProMP
from comove.primitives.poses import Pose, PoseDMP
from comove.primitives.probabilistic import ProMP
from comove.primitives.projection import (
    Constraint,
    HandDistance,
    RelativePose,
    SameHeight,
    Separation,
    Upright,
)
from comove.primitives.variants import Variant

Array = NDArray[np.float64]
Movement = DMP | PoseDMP | ProMP | PoseProMP | AveragedDMP | CooperativeDMP

MAX_DIMS = 64
_CONTEXT = ("context_mean", "context_std", "slopes")
_VECTORS = ("start", "goal", "start_velocity", "goal_velocity", "learned")


@dataclass(frozen=True)
class Kind:
    """A kind of movement in files.

    Attributes
    ----------
    name : its name in files
    of : its class
    write : function from a movement to mappings, lists and numbers
    read : function from these to the movement
    """

    name: str
    of: type
    write: Callable[[Any], dict[str, Any]]
    read: Callable[[FileEntry], Any]


def kind_of(movement: object) -> Kind:
    """Return the kind of a movement.

    Raises
    ------
    OptionError
        If it is no movement that files hold.
    """
    for kind in KINDS.values():
        if type(movement) is kind.of:
            return kind
    raise OptionError(
        f"a {type(movement).__name__} is no movement of a file",
        way_out=f"give one of {', '.join(kind.of.__name__ for kind in KINDS.values())}",
    )


def traced(movement: Movement, time: Array) -> Array:
    """Return the coordinates at some times [s]; array, shape (n_steps, n_columns).

    Positions come first, then rotation vectors or angles; standard deviations follow the mean of a distribution, and
    of hands that cooperate all movements follow each other.
    """
    if isinstance(movement, ProMP):
        return np.concatenate([movement.mean_at(time), movement.std_at(time)], axis=1)
    if isinstance(movement, PoseProMP):
        return traced(movement.promp, time)
    if isinstance(movement, AveragedDMP):
        shares = time / movement.duration
        parts = [movement.mean, *movement.members]
        return np.concatenate([part.at(shares * part.duration).position for part in parts], axis=1)
    if isinstance(movement, CooperativeDMP):
        return np.concatenate([traced(part, time) for part in movement.movements.values()], axis=1)
    if isinstance(movement, PoseDMP):
        return np.concatenate(
            [movement.translation.at(time).position, movement.turning.at(time).position], axis=1
        )
    return movement.at(time).position


def _write_phase(phase: Phase) -> dict[str, Any]:
    if isinstance(phase, ExponentialPhase):
        return {"name": "exponential", "alpha": float(phase.alpha)}
    return {"name": "linear"}


def _write_position(dmp: DMP) -> dict[str, Any]:
    return {
        "variant": str(dmp.variant),
        "phase": _write_phase(dmp.phase),
        "duration": float(dmp.duration),
        **{name: getattr(dmp, name).tolist() for name in _VECTORS},
        "weights": dmp.weights.tolist(),
    }


def _read_position(part: FileEntry, n_dims: int | None = None) -> DMP:
    part.with_keys(("variant", "phase", "duration", *_VECTORS, "weights"))
    variant = part.text("variant")
    names = [known.value for known in Variant]
    if variant not in names:
        raise part.wrong("variant", f"{shown(variant)} is not known", near_name(variant, names))
    duration = part.number("duration")
    if not duration > 0:
        raise part.wrong(
            "duration", f"{duration!r} is no duration", "a positive number of seconds belongs there"
        )
    weights = part.array("weights", (n_dims, None))
    n_dims, n_basis = weights.shape
    if n_dims > MAX_DIMS or n_basis > MAX_BASIS:
        way_out = f"at most {MAX_DIMS} lists of {MAX_BASIS} weights belong there"
        raise part.wrong("weights", f"{n_dims} lists of {n_basis} weights", way_out)
    vectors = {name: part.array(name, (n_dims,)) for name in _VECTORS}
    phase = _phase(part.part("phase"))
    return DMP(weights=weights, duration=duration, phase=phase, variant=Variant(variant), **vectors)


def _phase(part: FileEntry) -> Phase:
    name = part.text("name")
    if name == "linear":
        part.with_keys(("name",))
        return LinearPhase()
    if name != "exponential":
        raise part.wrong("name", f"{shown(name)} is not known", near_name(name, ("linear", "exponential")))
    alpha = part.with_keys(("name", "alpha")).number("alpha")
    if not 0 < alpha <= FASTEST:
        way_out = f"a number above 0, at most {FASTEST:g}, belongs there"
        raise part.wrong("alpha", f"{alpha!r} is no decay rate", way_out)
    return ExponentialPhase(alpha)


def _write_pose(dmp: PoseDMP) -> dict[str, Any]:
    return {
        "translation": _write_position(dmp.translation),
        "turning": _write_position(dmp.turning),
        "reference_wxyz": np.asarray(dmp.reference).tolist(),
        "axis": None if dmp.axis is None else np.asarray(dmp.axis).tolist(),
    }


def _read_pose(part: FileEntry) -> PoseDMP:
    part.with_keys(("translation", "turning", "reference_wxyz", "axis"))
    axis = None if part.value("axis") is None else part.array("axis", (3,))
    translation = _read_position(part.part("translation"))
    if translation.n_dims not in (2, 3):
        message = f"a pose in {translation.n_dims} dimensions"
        raise part.wrong("translation.weights", message, "2 or 3 lists of weights belong there")
    turning = _read_position(part.part("turning"), 3 if axis is None else 1)
    if turning.duration != translation.duration:
        message = f"{turning.duration!r} is not the {translation.duration!r} of the translation"
        raise part.wrong("turning.duration", message, LEARN_AGAIN)
    reference = part.array("reference_wxyz", (4,))
    for key, vector in (("reference_wxyz", reference), ("axis", axis)):
        if vector is not None and not abs(np.linalg.norm(vector) - 1.0) <= 1e-9:
            raise part.wrong(key, f"its norm is {np.linalg.norm(vector):.6g}", "a unit vector belongs there")
    return PoseDMP(translation, turning, reference, axis)


def _write_distribution(promp: ProMP) -> dict[str, Any]:
    context = None
    if len(promp.context_mean):
        context = {name: getattr(promp, name).tolist() for name in _CONTEXT}
    return {
        "phase": _write_phase(promp.phase),
        "duration": float(promp.duration),
        "duration_std": float(promp.duration_std),
        "manipulators": list(promp.manipulators),
        "n_recordings": promp.n_recordings,
        "mean_parameters": promp.mean_parameters.tolist(),
        "noise": promp.noise.tolist(),
        "context": context,
        "covariance": promp.covariance.tolist(),
    }


def _read_distribution(part: FileEntry) -> ProMP:
    arrays = ("mean_parameters", "noise", "covariance")
    part.with_keys(("phase", "duration", "duration_std", "manipulators", "n_recordings", "context", *arrays))
    mean = part.array("mean_parameters", (None, None))
    context: dict[str, Any] = {}
    if part.value("context") is not None:
        inner = part.part("context").with_keys(_CONTEXT)
        means = inner.array("context_mean", (None,))
        context = {
            "context_mean": means,
            "context_std": inner.array("context_std", (len(means),)),
            "slopes": inner.array("slopes", (len(means), *mean.shape)),
        }
    n_recordings = part.value("n_recordings")
    try:
        return ProMP(
            mean,
            part.array("covariance", (mean.size, mean.size)),
            part.array("noise", (len(mean),)),
            duration=part.number("duration"),
            duration_std=part.number("duration_std"),
            phase=_phase(part.part("phase")),
            manipulators=part.texts("manipulators"),
            n_recordings=part.count("n_recordings") if n_recordings != 0 else 0,
            **context,
        )
    except OptionError as error:
        raise part.wrong("mean_parameters", error.message, LEARN_AGAIN) from error


def _write_poses(poses: PoseProMP) -> dict[str, Any]:
    return {
        "coordinates": _write_distribution(poses.promp),
        "references_wxyz": [reference.tolist() for reference in poses.references],
    }


def _read_poses(part: FileEntry) -> PoseProMP:
    part.with_keys(("coordinates", "references_wxyz"))
    promp = _read_distribution(part.part("coordinates"))
    references = part.array("references_wxyz", (None, 4))
    try:
        return PoseProMP(promp, tuple(references))
    except OptionError as error:
        raise part.wrong("references_wxyz", error.message, LEARN_AGAIN) from error


def _write_average(average: AveragedDMP) -> dict[str, Any]:
    return {
        "mean": _write_position(average.mean),
        "members": [_write_position(member) for member in average.members],
    }


def _read_average(part: FileEntry) -> AveragedDMP:
    part.with_keys(("mean", "members"))
    mean = _read_position(part.part("mean"))
    members = tuple(_read_position(member) for member in part.parts("members"))
    if len(members) < 2:
        raise part.wrong("members", f"{len(members)} movements have no spread", "two or more belong there")
    for i, member in enumerate(members):
        one, other = ((dmp.weights.shape, dmp.variant, dmp.phase) for dmp in (member, mean))
        if one != other:
            raise part.wrong(f"members[{i}]", "it has another basis than the mean", LEARN_AGAIN)
    return AveragedDMP(mean, members)


def _write_cooperative(dmp: CooperativeDMP) -> dict[str, Any]:
    return {
        "load": None if dmp.load is None else _write_pose(dmp.load),
        "hands": {
            name: {"movement": _write_pose(hand)}
            if isinstance(hand, PoseDMP)
            else {"held": _write_place(hand)}
            for name, hand in dmp.hands.items()
        },
        "mobility": {name: float(share) for name, share in dmp.mobility.items()},
        "constraints": [_write_constraint(constraint) for constraint in dmp.constraints],
    }


def _read_cooperative(part: FileEntry) -> CooperativeDMP:
    part.with_keys(("load", "hands", "mobility", "constraints"))
    load = None if part.value("load") is None else _read_pose(part.part("load"))
    hands: dict[str, Pose | PoseDMP] = {}
    for name, hand in part.named("hands").items():
        key = "movement" if "movement" in hand.content else "held"
        inner = hand.with_keys((key,)).part(key)
        hands[name] = _read_pose(inner) if key == "movement" else _read_place(inner)
    shares = part.part("mobility")
    mobility = {name: shares.number(name) for name in shares.content}
    constraints = tuple(_read_constraint(entry) for entry in part.parts("constraints"))
    for entry, constraint in zip(part.parts("constraints"), constraints, strict=True):
        for key in ("first", "second", "name"):
            hand_name = getattr(constraint, key, None)
            if hand_name is not None and hand_name not in hands:
                raise entry.wrong(key, f"there is no hand {shown(hand_name)}", near_name(hand_name, hands))
    try:
        return CooperativeDMP(load, hands, constraints, mobility)
    except OptionError as error:
        raise part.wrong("hands", error.message, LEARN_AGAIN) from error


def _write_place(pose: Pose) -> dict[str, Any]:
    return {"position": pose.position.tolist(), "orientation_wxyz": pose.orientation.tolist()}


def _read_place(part: FileEntry) -> Pose:
    part.with_keys(("position", "orientation_wxyz"))
    position, orientation = part.array("position", (3,)), part.array("orientation_wxyz", (4,))
    try:
        return Pose(position, orientation)
    except OptionError as error:
        raise part.wrong("orientation_wxyz", error.message, "a unit quaternion belongs there") from error


_PAIRS: dict[str, type] = {"distance": HandDistance, "separation": Separation}  # of two hands, with a length


def _write_constraint(constraint: Constraint) -> dict[str, Any]:
    for name, of in _PAIRS.items():
        if type(constraint) is of:
            pair: Any = constraint
            return {
                "kind": name,
                "first": pair.first,
                "second": pair.second,
                "distance": float(pair.distance),
            }
    if isinstance(constraint, SameHeight):
        return {"kind": "same height", "first": constraint.first, "second": constraint.second}
    if isinstance(constraint, RelativePose):
        hands = {"first": constraint.first, "second": constraint.second}
        return {"kind": "relative pose", **hands, "pose": _write_place(constraint.pose)}
    if isinstance(constraint, Upright):
        return {"kind": "upright", "name": constraint.name, "axis": [float(x) for x in constraint.axis]}
    raise OptionError(
        f"the constraint {constraint} cannot be written to a file",
        key="constraints",
        way_out="write the movement without it, and add it by dataclasses.replace(dmp, constraints=...) once read",
    )


def _read_constraint(part: FileEntry) -> Constraint:
    kind = part.text("kind")
    try:
        if kind in _PAIRS:
            part.with_keys(("kind", "first", "second", "distance"))
            pair: Constraint = _PAIRS[kind](part.text("first"), part.text("second"), part.number("distance"))
            return pair
        if kind == "same height":
            part.with_keys(("kind", "first", "second"))
            return SameHeight(part.text("first"), part.text("second"))
        if kind == "relative pose":
            part.with_keys(("kind", "first", "second", "pose"))
            return RelativePose(part.text("first"), part.text("second"), _read_place(part.part("pose")))
        if kind == "upright":
            part.with_keys(("kind", "name", "axis"))
            x, y, z = part.array("axis", (3,)).tolist()
            return Upright(part.text("name"), (x, y, z))
    except OptionError as error:
        raise part.wrong("kind", error.message, "a valid constraint belongs there") from error
    known = (*_PAIRS, "same height", "relative pose", "upright")
    raise part.wrong("kind", f"{shown(kind)} is not known", near_name(kind, known))


KINDS = {
    kind.name: kind
    for kind in (
        Kind("position", DMP, _write_position, _read_position),
        Kind("pose", PoseDMP, _write_pose, _read_pose),
        Kind("distribution", ProMP, _write_distribution, _read_distribution),
        Kind("poses", PoseProMP, _write_poses, _read_poses),
        Kind("average", AveragedDMP, _write_average, _read_average),
        Kind("cooperative", CooperativeDMP, _write_cooperative, _read_cooperative),
    )
}
