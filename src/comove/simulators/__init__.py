"""Simulators that play a joint motion, by geometry alone or in MuJoCo."""

from comove.simulators.execution import Contact, Execution
from comove.simulators.files import SIMULATION, write_simulation
from comove.simulators.friction import Friction
from comove.simulators.grasps import Connect, GraspModel, Weld
from comove.simulators.lighting import ABOVE, FRONT, View
from comove.simulators.perturbation import Perturbation, Push
from comove.simulators.pictures import draw_film, draw_sheet
from comove.simulators.playback import play
from comove.simulators.settings import Settings
from comove.simulators.simulate import simulate

__all__ = [
    "ABOVE",
    "FRONT",
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
