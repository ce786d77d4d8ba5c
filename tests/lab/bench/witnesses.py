"""The witnesses of frozen scenes, read from the files beside them."""

from functools import cache

import yaml

from comove.io.arrays import read_arrays
from comove.lab.bench.drawing import Witness
from comove.lab.bench.sets import JOINT_WITNESSES, WITNESSES


def witness_of(frozen, scene):
    """Of a frozen scene, which `scene` is as it was read; its `judged` says that it can be solved."""
    if not frozen.set.startswith("robots"):
        return Witness.from_rows(poses_in(frozen.path.with_name(WITNESSES))[frozen.name], scene)
    from comove.lab.bench.robot_drawing import JointWitness

    names = [f"{frozen.name}.{key}" for key in ("weights", "position")]
    arrays = read_arrays(frozen.path.with_name(JOINT_WITNESSES), tuple(names))
    return JointWitness(*(arrays[name] for name in names))


@cache
def poses_in(path):
    return yaml.safe_load(path.read_text(encoding="utf-8"))
