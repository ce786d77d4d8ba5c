"""What a new user would look at: no overshoot, no jitter, no standing about, with loads and with arms."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import yaml

import comove
from comove.model import Scene
from comove.verification.measures import smoothness

S = np.linspace(0.0, 1.0, 801)
TRAY = {
    "version": 1,
    "name": "tray",
    "duration": 6.0,
    "workspace": {"lower": [0, -0.6, 0], "upper": [1.2, 0.6, 1]},
    "load": {
        "shape": "box",
        "size": [0.3, 0.4, 0.03],
        "grasps": {"left": [0, 0.22, 0], "right": [0, -0.22, 0]},
    },
    "manipulators": [
        {"name": "left", "start": [0.3, 0.22, 0.3], "goal": [0.8, 0.32, 0.5]},
        {"name": "right", "start": [0.3, -0.22, 0.3], "goal": [0.8, -0.12, 0.5]},
    ],
    "constraints": [{"type": "upright"}],
    "limits": {"speed": 1.0},
}


def peaks(speed):
    """How many local maxima a speed has that stand out by more than 2 % of the largest."""
    from scipy.signal import find_peaks

    return len(find_peaks(np.concatenate([[0.0], speed, [0.0]]), prominence=0.02 * speed.max())[0])


def overshoot(hands, start, goal):
    """How far hands go beyond the box between their ends [m]."""
    low, high = np.minimum(start, goal), np.maximum(start, goal)
    return max(float((low - hands).max()), float((hands - high).max()))


@pytest.mark.parametrize(
    "changes", [{}, {"duration": None}, {"limits": {"speed": 1.0, "acceleration": 0.3}}], ids=str
)
@pytest.mark.few(1)
def test_a_tray_is_carried_without_overshoot(changes):
    """One peak of speed, nothing beyond the goal or below the start, level, half of it after half of the time."""
    scene = Scene.from_dict(TRAY | changes)
    solution = comove.solve(scene)
    assert solution.verified
    hands, velocity, _ = solution.attempt.hands(S)
    assert overshoot(hands, scene.start, scene.goal) < 1e-3
    assert all(peaks(np.linalg.norm(velocity[:, i], axis=1)) == 1 for i in range(2))
    assert solution.report.tilt_max < 1e-6
    assert smoothness(solution.attempt).halfway == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_an_open_way_in_the_plane_is_straight(seed):
    rng = np.random.default_rng([seed, 31])
    start, turn = rng.uniform(0.2, 0.4, 2), rng.uniform(0, 0.5)
    goal, bar = rng.uniform(0.6, 0.8, 2), 0.2
    ends = [
        [middle + 0.5 * bar * side * np.array([np.cos(a), np.sin(a)]) for side in (-1, 1)]
        for middle, a in ((start, 1.0), (goal, 1.0 + turn))
    ]
    scene = Scene.from_dict(
        {
            "name": "open",
            "duration": 4.0,
            "workspace": {"lower": [0, 0], "upper": [1, 1]},
            "load": {"shape": "bar", "length": bar},
            "manipulators": [
                {"name": name, "start": a.tolist(), "goal": b.tolist()}
                for name, a, b in zip(("left", "right"), *ends, strict=True)
            ],
        }
    )
    solution = comove.solve(scene)
    hands, velocity, acceleration = solution.attempt.hands(S)
    for i in range(2):
        way = np.linalg.norm(scene.goal[i] - scene.start[i])
        length = np.linalg.norm(np.diff(hands[:, i], axis=0), axis=1).sum()
        assert length < 1.05 * way
        assert peaks(np.linalg.norm(velocity[:, i], axis=1)) == 1
        assert np.linalg.norm(acceleration[:, i], axis=1).max() < 1.35 * 10 / np.sqrt(3) * way


XARM = "package://example-robot-data/robots/xarm_description"
TWO_XARM7 = {
    "name": "two_xarm7",
    "models": [
        {
            "urdf": f"{XARM}/urdf/xarm7.urdf",
            "srdf": f"{XARM}/srdf/xarm7.srdf",
            "base": {"position": [0.0, y, 0.0]},
            "prefix": f"{side}_",
        }
        for side, y in (("left", 0.35), ("right", -0.35))
    ],
    "arms": {
        side: {"tip": f"{side}_link_eef", "home": [0.0, -0.3, 0.0, 1.2, 0.0, 1.5, 0.0]}
        for side in ("left", "right")
    },
    "acceleration": 10.0,
}


@pytest.mark.skipif(find_spec("pinocchio") is None, reason="robots need the extra 'robot'")
def test_two_arms_lift_a_bar_as_straight_as_can_be(tmp_path):
    """In the open: the straight way of least jerk, to a percent, at rest neither before nor after its time."""
    from comove.robots import Robot

    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(TWO_XARM7), encoding="utf-8")
    scene = Scene.from_dict(
        {
            "name": "lift",
            "duration": 12.0,
            "grasp": {"orientation": "down", "yaw": "load"},
            "workspace": {"lower": [0.1, -0.7, 0.02], "upper": [0.8, 0.7, 0.6]},
            "load": {"shape": "bar", "length": 0.5, "radius": 0.012, "mass": 0.4},
            "manipulators": [
                {"name": "left", "start": [0.35, 0.25, 0.15], "goal": [0.5, 0.25, 0.374]},
                {"name": "right", "start": [0.35, -0.25, 0.15], "goal": [0.5, -0.25, 0.374]},
            ],
            "limits": {"speed": 0.5, "acceleration": 1.0, "clearance": 0.01},
        }
    )
    found = comove.solve(scene, robot=Robot.load(tmp_path / "robot.yaml"))
    assert found.verified
    measures = smoothness(found.attempt)
    assert measures.jerk_ratio < 1.02
    assert measures.halfway == pytest.approx(0.5, abs=0.01)
    assert measures.nearly_there > 0.75


@pytest.mark.skipif(find_spec("pinocchio") is None, reason="robots need the extra 'robot'")
def test_two_arms_go_straight_where_nothing_is_in_the_way():
    """They do not wander, and do not stand still after half of the time."""
    from comove.robots import Robot

    path = Path(__file__).parents[2] / "examples" / "robots" / "two_pandas.yaml"
    scene = Scene.load(path, {"obstacles": []})
    found = comove.solve(scene, robot=Robot.load("two_pandas"), budget=30.0)
    assert found.verified
    motion = found.attempt
    hands, velocity, _ = motion.hands(S)
    for i in range(2):
        way = np.linalg.norm(scene.goal[i] - scene.start[i])
        assert np.linalg.norm(np.diff(hands[:, i], axis=0), axis=1).sum() < 1.3 * way
    speed = np.linalg.norm(velocity, axis=2).sum(axis=1)
    share = np.cumsum(speed) / speed.sum()
    assert np.interp(0.5, share, S) == pytest.approx(0.5, abs=0.1)
    assert np.interp(0.95, share, S) > 0.7
    assert smoothness(motion).jerk_ratio < 30
