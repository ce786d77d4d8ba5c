"""Kinds of movements in files, and how they are written and read.

Writing gives mappings, lists and numbers for JSON, reading builds the movement of them, which checks itself. `traced`
gives the coordinates of a movement at some instants, which reveal weights of another basis.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.dmp.averaging import AveragedDMP
from comove.dmp.cooperative import CooperativeDMP
from comove.dmp.dmp import DMP, VECTORS
from comove.dmp.pose_distributions import PoseProMP
from comove.dmp.poses import Pose, PoseDMP
from comove.dmp.probabilistic import ProMP
from comove.dmp.system import ExponentialPhase, LinearPhase, Phase
from comove.errors import OptionError

Movement = DMP | PoseDMP | ProMP | PoseProMP | AveragedDMP | CooperativeDMP

_CONTEXT = ("context_mean", "context_std", "slopes")


@dataclass(frozen=True)
class PrimitiveKind:
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
    read: Callable[[dict[str, Any]], Any]


def kind_of(movement: object) -> PrimitiveKind:
    """Return the kind of a movement."""
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
    of cooperating end effectors all movements follow each other.
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
        **{name: getattr(dmp, name).tolist() for name in VECTORS},
        "weights": dmp.weights.tolist(),
    }


def _read_position(content: dict[str, Any]) -> DMP:
    return DMP(**{**content, "phase": _read_phase(content["phase"])})


def _read_phase(content: dict[str, Any]) -> Phase:
    return ExponentialPhase(content["alpha"]) if content["name"] == "exponential" else LinearPhase()


def _write_pose(dmp: PoseDMP) -> dict[str, Any]:
    return {
        "translation": _write_position(dmp.translation),
        "turning": _write_position(dmp.turning),
        "reference_wxyz": np.asarray(dmp.reference).tolist(),
        "axis": None if dmp.axis is None else np.asarray(dmp.axis).tolist(),
    }


def _read_pose(content: dict[str, Any]) -> PoseDMP:
    axis = content["axis"]
    return PoseDMP(
        _read_position(content["translation"]),
        _read_position(content["turning"]),
        np.array(content["reference_wxyz"], dtype=float),
        None if axis is None else np.array(axis, dtype=float),
    )


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


def _read_distribution(content: dict[str, Any]) -> ProMP:
    arguments = {key: value for key, value in content.items() if key != "context"} | (
        content["context"] or {}
    )
    arguments["phase"] = _read_phase(content["phase"])
    arguments["manipulators"] = tuple(content["manipulators"])
    return ProMP(**arguments)


def _write_poses(poses: PoseProMP) -> dict[str, Any]:
    return {
        "coordinates": _write_distribution(poses.promp),
        "references_wxyz": [reference.tolist() for reference in poses.references],
    }


def _read_poses(content: dict[str, Any]) -> PoseProMP:
    return PoseProMP(_read_distribution(content["coordinates"]), tuple(content["references_wxyz"]))


def _write_average(average: AveragedDMP) -> dict[str, Any]:
    return {
        "mean": _write_position(average.mean),
        "members": [_write_position(member) for member in average.members],
    }


def _read_average(content: dict[str, Any]) -> AveragedDMP:
    return AveragedDMP(_read_position(content["mean"]), tuple(map(_read_position, content["members"])))


def _write_cooperative(dmp: CooperativeDMP) -> dict[str, Any]:
    return {
        "load": None if dmp.load is None else _write_pose(dmp.load),
        "hands": {
            name: {"movement": _write_pose(hand)}
            if isinstance(hand, PoseDMP)
            else {"held": _write_place(hand)}
            for name, hand in dmp.hands.items()
        },
    }


def _read_cooperative(content: dict[str, Any]) -> CooperativeDMP:
    load = content["load"]
    return CooperativeDMP(
        None if load is None else _read_pose(load),
        {
            name: _read_pose(hand["movement"]) if "movement" in hand else _read_place(hand["held"])
            for name, hand in content["hands"].items()
        },
    )


def _write_place(pose: Pose) -> dict[str, Any]:
    return {"position": pose.position.tolist(), "orientation_wxyz": pose.orientation.tolist()}


def _read_place(content: dict[str, Any]) -> Pose:
    return Pose(content["position"], content["orientation_wxyz"])


KINDS = {
    kind.name: kind
    for kind in (
        PrimitiveKind("position", DMP, _write_position, _read_position),
        PrimitiveKind("pose", PoseDMP, _write_pose, _read_pose),
        PrimitiveKind("distribution", ProMP, _write_distribution, _read_distribution),
        PrimitiveKind("poses", PoseProMP, _write_poses, _read_poses),
        PrimitiveKind("average", AveragedDMP, _write_average, _read_average),
        PrimitiveKind("cooperative", CooperativeDMP, _write_cooperative, _read_cooperative),
    )
}
