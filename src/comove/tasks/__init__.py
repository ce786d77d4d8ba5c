"""Whole tasks: approach, grasp, carry, set down and retreat, planned and verified together."""

from comove.tasks.grasps import Grasp
from comove.tasks.plan import Command, TaskPart, TaskPlan
from comove.tasks.task import Task
from comove.tasks.world import Body, World

__all__ = ["Body", "Command", "Grasp", "Task", "TaskPart", "TaskPlan", "World"]
