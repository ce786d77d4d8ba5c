"""Methods published by others, with the interface of `solve`, for comparison."""

from comove.experiments.compared.cooperation import Laws
from comove.experiments.compared.leader_follower import Gains, LeaderFollower
from comove.experiments.compared.single import Single
from comove.experiments.compared.speed_scaled import Human, SpeedScaled
from comove.experiments.compared.task_priority import Performance, TaskPriority
from comove.experiments.compared.unconstrained import Unconstrained

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
