"""Simulators of joint motions: geometric playback and MuJoCo."""

from typing import TYPE_CHECKING

from comove._doors import lazily

if TYPE_CHECKING:
    from comove.sim.execution import Conditions as Conditions, Contact as Contact, Execution as Execution
    from comove.sim.files import SIMULATION as SIMULATION, write_simulation as write_simulation
    from comove.sim.grasps import (
        GRASPS as GRASPS,
        Connect as Connect,
        Friction as Friction,
        GraspModel as GraspModel,
        Weld as Weld,
    )
    from comove.sim.pictures import (
        ABOVE as ABOVE,
        FRONT as FRONT,
        View as View,
        draw_film as draw_film,
        draw_sheet as draw_sheet,
    )
    from comove.sim.playback import play as play
    from comove.sim.settings import Perturbation as Perturbation, Push as Push, Settings as Settings
    from comove.sim.dynamics import simulate as simulate

__all__, __getattr__, __dir__ = lazily(
    __name__,
    {
        "sim.execution": ["Conditions", "Contact", "Execution"],
        "sim.files": ["SIMULATION", "write_simulation"],
        "sim.grasps": ["GRASPS", "Connect", "Friction", "GraspModel", "Weld"],
        "sim.pictures": ["ABOVE", "FRONT", "View", "draw_film", "draw_sheet"],
        "sim.playback": ["play"],
        "sim.settings": ["Perturbation", "Push", "Settings"],
        "sim.dynamics": ["simulate"],
    },
)
