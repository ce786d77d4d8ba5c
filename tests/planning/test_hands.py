"""Recordings of several hands: each hand follows its own; and recordings do as well as primitives."""

import numpy as np
import pytest

import comove
from comove import DMP, Demonstration
from comove.dmp.demonstrations import write_csv
from comove.errors import OptionError
from comove.model import Scene, demonstration_of, recording_of
from comove.planning import carried_demonstration
from tests.solved import example

TIME = np.linspace(0.0, 4.0, 401)
SHARE = TIME / 4.0
SHARE = SHARE**3 * (10 - 15 * SHARE + 6 * SHARE**2)


def swing(height):
    """A movement by 0.7 m along x that swings by a height."""
    return Demonstration(TIME, np.column_stack([0.7 * SHARE, height * np.sin(np.pi * SHARE) ** 2]))


def free_scene(**more):
    """Two hands beside each other, free of each other."""
    return {
        "version": 1,
        "name": "free",
        "duration": 5.0,
        "workspace": {"lower": [0, 0], "upper": [1, 1]},
        "manipulators": [
            {"name": "low", "start": [0.15, 0.3], "goal": [0.85, 0.3]},
            {"name": "high", "start": [0.15, 0.7], "goal": [0.85, 0.7]},
        ],
        **more,
    }


def test_each_hand_follows_its_own():
    scene = Scene.from_dict(free_scene())
    own = {"low": swing(-0.1), "high": swing(0.1)}
    solution = comove.solve(scene, demonstration=own)
    assert solution.verified
    hands = solution.attempt.hands(np.linspace(0, 1, 101))[0]
    assert hands[50, 0, 1] == pytest.approx(0.2, abs=0.02)
    assert hands[50, 1, 1] == pytest.approx(0.8, abs=0.02)
    assert solution.followed.distance < 0.01


def test_recordings_do_as_well_as_primitives():
    scene = example("narrow")
    recording = recording_of(scene)
    ways = [
        comove.solve(scene, demonstration=d).attempt.hands(np.linspace(0, 1, 50))[0]
        for d in (recording, DMP.fit(recording), {name: recording for name in scene.manipulators})
    ]
    np.testing.assert_allclose(ways[0], ways[1], atol=1e-9)
    np.testing.assert_allclose(ways[0], ways[2], atol=1e-9)


def test_a_file_of_all_hands_is_theirs(tmp_path):
    write_csv(tmp_path / "hands.csv", {"low": swing(-0.1), "high": swing(0.1)})
    scene = Scene.from_dict(free_scene(demonstration={"file": "hands.csv"}), folder=tmp_path)
    low, high = demonstration_of(scene)
    carried = carried_demonstration((low, high), scene)
    assert carried[100, 0, 1] == pytest.approx(0.2, abs=0.01)
    assert carried[100, 1, 1] == pytest.approx(0.8, abs=0.01)
    one = Scene.from_dict(
        free_scene(demonstration={"file": "hands.csv", "manipulator": "low"}), folder=tmp_path
    )
    assert isinstance(demonstration_of(one), DMP)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"low": swing(0.1)}, "no movement for 'high'"),
        ({"low": swing(0.1), "high": swing(0.1), "third": swing(0.1)}, "is for 'third'"),
        ({"low": swing(0.1), "high": "up"}, "is str"),
        ("up", "is str"),
        ({}, "no movement for 'low'"),
    ],
)
def test_what_belongs_to_nobody_is_refused(given, words):
    with pytest.raises(OptionError, match=words):
        comove.solve(Scene.from_dict(free_scene()), demonstration=given)
