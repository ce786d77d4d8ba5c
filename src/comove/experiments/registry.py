"""The systems of the comparison, by name."""

from __future__ import annotations

from comove.errors import OptionError, near_name
from comove.experiments.compared import LeaderFollower, SpeedScaled, TaskPriority, Unconstrained
from comove.experiments.peers import PEERS
from comove.experiments.systems import OwnSystem, System
from comove.planning.methods import Comove, Projection
from comove.planning.paper import Paper
from comove.planning.printed import Printed

OWN: dict[str, System] = {
    system.name: system
    for system in (
        OwnSystem("comove", Comove()),
        OwnSystem("comove-no-planner", Comove(), planner=False),
        OwnSystem("projection", Projection()),
        OwnSystem("paper", Paper()),
        OwnSystem("printed", Printed()),
        OwnSystem("unconstrained", Unconstrained()),
        OwnSystem("leader-follower", LeaderFollower()),
        OwnSystem("speed-scaled", SpeedScaled()),
        OwnSystem("task-priority", TaskPriority()),
    )
}
SYSTEMS: dict[str, System] = OWN | PEERS


def systems_named(names: list[str]) -> dict[str, System]:
    """Return the systems with these names.

    Raises
    ------
    OptionError
        If a name is unknown.
    """
    for name in names:
        if name not in SYSTEMS:
            raise OptionError(
                f"there is no system '{name}'", key="--systems", way_out=near_name(name, SYSTEMS)
            )
    return {name: SYSTEMS[name] for name in names}
