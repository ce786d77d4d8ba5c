"""Goals whose turn is free, on supports and where no turn that is sampled will do."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import comove
from comove.errors import SceneError
from comove.model import Scene
from comove.model.free_goals import FreeGoal
from comove.model.scene import TURNS
from comove.planning import Budget

TABLE = {"name": "table", "shape": "box", "center": [0.5, 0.5, -0.05], "size": [1, 1, 0.1], "support": True}
WALL = {"shape": "box", "center": [0.8, 0.5, 0.2], "size": [0.02, 0.4, 0.4]}


def box(obstacles, goal, position=(0.7, 0.5, 0.03), **more):
    """A box of 30 cm that two hands hold at its top, and put down with a turn that is free."""
    return {
        "version": 2,
        "name": "box",
        "duration": 4.0,
        "workspace": {"lower": [0, 0, -0.2], "upper": [1, 1, 1]},
        "obstacles": obstacles,
        "payload": {
            "shape": "box",
            "size": [0.3, 0.1, 0.06],
            "start": {"position": [0.25, 0.5, 0.03]},
            "goal": {"position": list(position), "free": "yaw"} | goal,
        },
        "grasps": {"a": {"position": [-0.1, 0, 0.03]}, "b": {"position": [0.1, 0, 0.03]}},
    } | more


def test_a_payload_is_put_down_on_a_support_with_a_turn_past_a_wall():
    """Unturned it would be in the wall; supports hold it however it is turned."""
    scene = Scene.from_dict(box([TABLE, WALL], {}))
    (choice,) = scene.file.choices
    with pytest.raises(SceneError, match="reaches"):
        scene.put_down(choice).require_free_ends()
    solution = comove.solve(scene, seed=0, budget=Budget(work=0.2))
    assert solution.verified, solution.reasons
    assert [rest.end for rest in solution.scene.rests] == ["start", "goal"]
    w, *_, z = solution.scene.file.load.goal.quaternion_wxyz
    assert abs(np.sin(2 * np.arctan2(z, w))) > 0.5


def test_turns_in_which_a_payload_would_be_in_its_support_are_left_out():
    """About its long side it lies on a face; on an edge, as it starts, it would be in the table."""
    data = box([TABLE], {"free": "x"}, limits={"clearance": 0.005})
    data["payload"]["start"] = {"position": [0.25, 0.5, 0.3], "rpy_deg": [45, 0, 0]}
    scene = Scene.from_dict(data)
    free = FreeGoal(scene, scene.file.choices[0])
    assert not free.is_clear(0.0)
    assert free.is_clear(np.deg2rad(-45.0)) and free.turns()
    for turn in free.turns():
        scene.put_down(scene.file.choices[0], turn).require_free_ends()


def test_where_no_turn_that_is_sampled_will_do_the_one_that_turns_least_does():
    """A hand beside its payload goes a shorter way if the payload turns, which a constraint forbids."""
    data = box([], {}, (0.7, 0.8, 0.5), constraints=[{"type": "no_rotation"}])
    data["grasps"] = {"a": {"position": [0.1, 0.02, 0.03]}}
    data["payload"]["start"]["position"] = [0.3, 0.5, 0.5]
    scene = Scene.from_dict(data)
    (choice,) = scene.file.choices
    for turn in FreeGoal(scene, choice).turns():
        with pytest.raises(SceneError):
            scene.put_down(choice, turn).require_free_ends()
    solution = comove.solve(scene, seed=0)
    assert solution.verified, solution.reasons
    there = Rotation.from_quat(solution.scene.file.load.goal.quaternion_wxyz, scalar_first=True)
    assert there.magnitude() < 1e-12


def test_turns_that_are_tried_for_a_free_end_are_even_and_each_is_tried_once():
    angles = np.exp(1j * np.array(TURNS))
    apart = np.abs(angles[:, None] - angles) + 2 * np.eye(len(angles))
    assert apart.min() == pytest.approx(2 * np.sin(np.deg2rad(2.5)))
    assert TURNS[0] == 0.0
    assert len(TURNS) == 72
