"""A reader that stands in for `joint_trajectory_file_playback.py`, from its description in shared/robots.md.

It keeps the habits that make files fail on the robot: the header is whatever stands in the first line, cells that are
no number vanish, and a command that misses a joint or a gripper stops it.
"""

from dataclasses import dataclass, field

SLOW = 0.25  # rad/s, of the move to the first row
SIDES = ("left", "right")


@dataclass
class Goal:
    """What one action server or gripper gets: names, and points as (time [s], positions)."""

    names: list[str] = field(default_factory=list)
    points: list[tuple[float, list[float]]] = field(default_factory=list)


def number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None


def play(path, measured):
    """Goals by limb and gripper, and how long the slow move takes [s]; `measured`: position [rad] by joint."""
    with open(path, encoding="ascii") as file:
        header, *rows = file.readlines()
    names = header.rstrip().split(",")
    goals = {name: Goal() for side in SIDES for name in (side, f"{side}_gripper")}
    for name in names:
        if name[:-3] in SIDES:  # "left_s0"; a name with a space in front is not of a limb
            goals[name[:-3]].names.append(name)
    for side in SIDES:
        goals[f"{side}_gripper"].names.append(f"{side}_gripper")
    delay = None
    for row in rows:
        cells = [number(cell) for cell in row.rstrip().split(",")]
        command = {name: cell for name, cell in zip(names[1:], cells[1:], strict=False) if cell is not None}
        if delay is None:
            joints = [name for side in SIDES for name in goals[side].names]
            delay = max(abs(command[name] - measured[name]) / SLOW for name in joints)
            for side in SIDES:
                goals[side].points.append((0.0, [measured[name] for name in goals[side].names]))
        for goal in goals.values():
            goal.points.append((cells[0] + delay, [command[name] for name in goal.names]))
    return goals, delay


def require_playable(goals):
    """What the limbs' servers and a careful person demand of the goals."""
    for side in SIDES:
        assert goals[side].names == [
            f"{side}_{joint}" for joint in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")
        ]
        times = [time for time, _ in goals[side].points]
        assert all(later > earlier for earlier, later in zip(times, times[1:], strict=False))
        assert times == [goals["left"].points[0][0], *(time for time, _ in goals["left_gripper"].points)]
        for _, positions in goals[f"{side}_gripper"].points:
            assert len(positions) == 1 and 0.0 <= positions[0] <= 100.0
