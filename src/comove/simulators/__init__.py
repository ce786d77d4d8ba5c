"""Simulators that play a joint motion, by geometry alone or in MuJoCo."""

from comove.simulators.execution import Contact, Execution
from comove.simulators.files import SIMULATION, write_simulation
from comove.simulators.grasps import GRASPS, Connect, Friction, GraspModel, Weld
from comove.simulators.pictures import ABOVE, FRONT, View, draw_film, draw_sheet
from comove.simulators.playback import play
from comove.simulators.settings import Perturbation, Push, Settings
from comove.simulators.simulate import simulate

__all__ = [
    "ABOVE",
    "FRONT",
    "GRASPS",
    "SIMULATION",
    "View",
    "Connect",
    "Contact",
    "Execution",
    "Friction",
    "GraspModel",
    "Perturbation",
    "Push",
    "Settings",
    "Weld",
    "draw_film",
    "draw_sheet",
    "play",
    "simulate",
    "write_simulation",
]
