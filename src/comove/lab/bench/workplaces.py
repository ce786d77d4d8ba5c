"""Payloads and workspaces of robots in sampled scenes, by difficulty."""

from __future__ import annotations

from dataclasses import dataclass

Range = tuple[float, float]


@dataclass(frozen=True)
class Workplace:
    """Workspace of a robot, with the bar that it carries.

    Attributes
    ----------
    robot : its name
    lower, upper : workspace of payload and end effectors [m]
    length, radius, mass : of the bar [m, m, kg]; along y, unless it is rotated
    offset_deg : rotation of the end effectors on it, as in scene files
    hands : names of the arms, the first one at the larger y
    """

    robot: str
    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    length: float
    radius: float
    mass: float
    offset_deg: float | dict[str, float] = 0.0
    hands: tuple[str, str] = ("left", "right")


_WORKPLACES = (
    Workplace("baxter", (0.30, -0.75, -0.10), (0.95, 0.75, 0.25), 0.6, 0.012, 0.25),
    Workplace("two_pandas", (0.10, -0.75, 0.05), (0.80, 0.75, 0.40), 0.5, 0.012, 0.4, 180.0),
    Workplace("two_ur10", (0.30, -0.80, 0.05), (1.10, 0.80, 0.60), 0.6, 0.015, 1.0),
    Workplace("two_xarm7", (0.15, -0.60, 0.05), (0.75, 0.60, 0.45), 0.4, 0.012, 0.3),
    Workplace(
        "ur5_and_panda",
        (-0.60, -0.45, 0.05),
        (0.70, 0.45, 0.40),
        0.4,
        0.012,
        0.4,
        {"left": 0.0, "right": 180.0},
    ),
)
WORKPLACES = {place.robot: place for place in _WORKPLACES}


@dataclass(frozen=True)
class RobotDifficulty:
    """Ranges from which scenes of robots are sampled.

    Attributes
    ----------
    between, obstacles : smallest and largest number of poses between start and goal, and of obstacles
    in_the_way : obstacles that are sampled to block the straight motion
    turn, tilt : largest heading of the bar against y, and against the horizontal [rad]
    size : of obstacles [m]
    step : steps by which an obstacle is moved away from the bar until the witness is clear of it [m]
    spare : smallest clearance of the witness, of payload and links [m]
    duration : duration of the scene [s]
    clearance : clearance required by the scene [m]
    rate : samples of a witness [Hz]
    far : least distance between start and goal, in lengths of the bar
    upright : share of obstacles that are posts from the bottom of the workspace to its top
    tries : further obstacles that are sampled where there is no room for one, before a restart
    n_steps : largest number of steps by which an obstacle is moved away
    """

    between: tuple[int, int]
    obstacles: tuple[int, int]
    in_the_way: int
    turn: float
    tilt: float
    size: Range
    step: float
    spare: float
    duration: float = 10.0
    clearance: float = 0.01
    rate: float = 20.0
    far: float = 0.4
    upright: float = 0.6
    tries: int = 6
    n_steps: int = 12


ROBOT_DIFFICULTIES = {
    "robots-easy": RobotDifficulty((1, 1), (1, 2), 1, 0.5, 0.1, (0.02, 0.05), 0.05, 0.02),
    "robots-hard": RobotDifficulty((1, 2), (4, 6), 1, 0.9, 0.2, (0.02, 0.06), 0.03, 0.015),
    "robots-extreme": RobotDifficulty((2, 3), (8, 14), 2, 1.2, 0.3, (0.02, 0.08), 0.015, 0.012),
}
