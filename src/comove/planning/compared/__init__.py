"""Methods published by others, with the interface of `solve`, for comparison."""

from comove.planning.compared.cooperation import Laws
from comove.planning.compared.coupling import Gains
from comove.planning.compared.leader_follower import LeaderFollower
from comove.planning.compared.performance import Performance
from comove.planning.compared.single import Single
from comove.planning.compared.speed_scaled import Human, SpeedScaled
from comove.planning.compared.task_priority import TaskPriority
from comove.planning.compared.unconstrained import Unconstrained

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
