"""Published methods of others for comparison, with the interface of `solve`."""

from comove.lab.compared.cooperation import Laws
from comove.lab.compared.leader_follower import Gains, LeaderFollower
from comove.lab.compared.single import Single
from comove.lab.compared.speed_scaled import Human, SpeedScaled
from comove.lab.compared.task_priority import Performance, TaskPriority
from comove.lab.compared.unconstrained import Unconstrained

__all__ = [
    "Gains",
    "Human",
    "Laws",
    "LeaderFollower",
    "Performance",
    "Single",
    "SpeedScaled",
    "TaskPriority",
    "Unconstrained",
]
