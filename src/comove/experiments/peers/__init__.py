"""Other tools for the same problems, behind one interface; each needs packages that `comove[bench]` installs.

`PEERS` holds them by the name that tables call them by. To import this module needs none of them; a system whose
module is missing raises `comove.errors.ExtraError` when it is to run.
"""

from comove.experiments.peers.augmented_lagrangian import PycmaAL
from comove.experiments.peers.coupled import Coupled
from comove.experiments.peers.drake import Drake
from comove.experiments.peers.gradients import Scipy
from comove.experiments.peers.ompl import OMPL, ProjectedOMPL
from comove.experiments.peers.transcription import Transcription
from comove.experiments.systems import System

_SYSTEMS: tuple[System, ...] = (
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
PEERS: dict[str, System] = {system.name: system for system in _SYSTEMS}

__all__ = ["PEERS"]
