"""Stages of a task: what is done with one body, from the approach to the retreat."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from comove.arrays import Array
from comove.tasks.grasps import Grasp
from comove.tasks.world import Body


class Leg(NamedTuple):
    """A transfer of a body.

    Attributes
    ----------
    goal : array, shape (4, 4) [m]
    upright_deg : tolerance of `upright` [deg]; None where it may lean
    time : duration [s]; None for the least
    rests_on : name of the obstacle on which it then rests; None for none
    """

    goal: Array
    upright_deg: float | None
    time: float | None
    rests_on: str | None = None


@dataclass(eq=False)
class Stage:
    """What is done with a body.

    Attributes
    ----------
    body : the body where it is at first
    grasps : how each arm may hold it, by the arm's name
    close_time, open_time : time in which grippers close, open [s]; None where they do not
    legs : its transfers
    takes_over : whether the arms take the body from those of the stage before
    stands_on : name of the obstacle on which it was set down before; None where it was not
    retreats : whether the arms draw back in the end
    """

    body: Body
    grasps: Mapping[str, Grasp]
    close_time: float | None = None
    legs: list[Leg] = field(default_factory=list)
    open_time: float | None = None
    takes_over: bool = False
    stands_on: str | None = None
    retreats: bool = False
