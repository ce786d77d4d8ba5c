"""Whole tasks: approach, grasp, carry, hand over, set down and retreat, planned and verified together."""

from typing import TYPE_CHECKING

from comove._doors import lazily

if TYPE_CHECKING:
    from comove.tasks.grasps import Grasp as Grasp
    from comove.tasks.grippers import Gripper as Gripper
    from comove.tasks.mujoco_world import MujocoWorld as MujocoWorld
    from comove.tasks.plan import Command as Command, TaskPart as TaskPart, TaskPlan as TaskPlan
    from comove.tasks.robot import Rates as Rates
    from comove.tasks.task import Task as Task
    from comove.tasks.world import Body as Body, World as World

__all__, __getattr__, __dir__ = lazily(
    __name__,
    {
        "tasks.grasps": ["Grasp"],
        "tasks.grippers": ["Gripper"],
        "tasks.mujoco_world": ["MujocoWorld"],
        "tasks.plan": ["Command", "TaskPart", "TaskPlan"],
        "tasks.robot": ["Rates"],
        "tasks.task": ["Task"],
        "tasks.world": ["Body", "World"],
    },
)
