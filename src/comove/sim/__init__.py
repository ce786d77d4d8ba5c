"""Simulators that play a joint motion, by geometry alone or in MuJoCo."""

from typing import TYPE_CHECKING

from comove._doors import lazily

if TYPE_CHECKING:
    from comove.simulators.execution import Contact as Contact, Execution as Execution
    from comove.simulators.files import SIMULATION as SIMULATION, write_simulation as write_simulation
    from comove.simulators.grasps import (
        GRASPS as GRASPS,
        Connect as Connect,
        Friction as Friction,
        GraspModel as GraspModel,
        Weld as Weld,
    )
    from comove.simulators.pictures import (
        ABOVE as ABOVE,
        FRONT as FRONT,
        View as View,
        draw_film as draw_film,
        draw_sheet as draw_sheet,
    )
    from comove.simulators.playback import play as play
    from comove.simulators.settings import Perturbation as Perturbation, Push as Push, Settings as Settings
    from comove.simulators.dynamics import simulate as simulate

__all__, __getattr__, __dir__ = lazily(
    __name__,
    {
        "simulators.execution": ["Contact", "Execution"],
        "simulators.files": ["SIMULATION", "write_simulation"],
        "simulators.grasps": ["GRASPS", "Connect", "Friction", "GraspModel", "Weld"],
        "simulators.pictures": ["ABOVE", "FRONT", "View", "draw_film", "draw_sheet"],
        "simulators.playback": ["play"],
        "simulators.settings": ["Perturbation", "Push", "Settings"],
        "simulators.dynamics": ["simulate"],
    },
)
