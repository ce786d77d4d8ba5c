"""Systems of the comparison by name. They are comove's methods, published ones, and other tools. Importing this
module needs none of the tools. A system whose tool is missing raises `comove.errors.ExtraError` at its run."""

from __future__ import annotations

from comove.errors import OptionError, near_name
from comove.lab.compared import LeaderFollower, SpeedScaled, TaskPriority, Unconstrained
from comove.lab.evolution import Projection
from comove.lab.evolution.paper import Paper
from comove.lab.evolution.printed import Printed
from comove.lab.peers.drake import Drake
from comove.lab.peers.ompl import OMPL, ProjectedOMPL
from comove.lab.peers.shapes import Coupled, PycmaAL, Scipy
from comove.lab.peers.transcription import Transcription
from comove.lab.systems import OwnSystem, System
from comove.planning.methods import Comove

_OWN = (
    OwnSystem("comove", Comove(), carries=True),
    OwnSystem("comove-no-planner", Comove(), planner=False),
    OwnSystem("projection", Projection()),
    OwnSystem("paper", Paper()),
    OwnSystem("printed", Printed()),
    OwnSystem("unconstrained", Unconstrained()),
    OwnSystem("leader-follower", LeaderFollower()),
    OwnSystem("speed-scaled", SpeedScaled()),
    OwnSystem("task-priority", TaskPriority()),
)
_PEERS = (
    OMPL("ompl-rrtconnect", "RRTConnect", "simplify"),
    OMPL("ompl-rrtconnect-raw", "RRTConnect", "offer"),
    ProjectedOMPL("ompl-projected"),
    OMPL("ompl-aorrtc", "AORRTC", "improve"),
    PycmaAL("pycma-al"),
    Scipy("slsqp", "SLSQP"),
    Scipy("trust-constr", "trust-constr"),
    Transcription("ipopt"),
    Coupled("movement-primitives"),
    Drake("drake"),
)
PEERS: dict[str, System] = {system.name: system for system in _PEERS}
SYSTEMS: dict[str, System] = {system.name: system for system in _OWN} | PEERS


def systems_named(names: list[str]) -> dict[str, System]:
    """Return the systems with these names."""
    for name in names:
        if name not in SYSTEMS:
            raise OptionError(
                f"there is no system '{name}'", key="--systems", way_out=near_name(name, SYSTEMS)
            )
    return {name: SYSTEMS[name] for name in names}
