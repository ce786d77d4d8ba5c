"""Tasks in the worlds of others."""

from typing import TYPE_CHECKING

from comove._doors import lazily

if TYPE_CHECKING:
    from comove.tasks.grippers import Gripper as Gripper
    from comove.tasks.robot import Rates as Rates
    from comove.tasks.world import Body as Body, World as World

__all__, __getattr__, __dir__ = lazily(
    __name__,
    {
        "tasks.grippers": ["Gripper"],
        "tasks.robot": ["Rates"],
        "tasks.world": ["Body", "World"],
    },
)
