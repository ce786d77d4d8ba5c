"""Boxes are planned, searched and certified as the solids that they are."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import comove
from comove.model import Scene
from comove.model.coordinates import load_coordinates
from comove.planning.configurations import clearance_of, configuration_space
from comove.planning.objective import ContactPenalty, Objective
from comove.view.figures.motion import draw_motion
from tests.cases import examples
from tests.verification.random_boxes import box_near_contact, least_clearance, random_box_motion

seeds = st.integers(0, 2**32 - 1)


def flat_scene(*, size=(0.5, 0.2, 0.05), gap=0.34, **more):
    """A box that two arms carry flat between two posts, which are nearer to each other than the box is long.

    The hands hold it above its ends, 0.6 m apart; posts and ways are those of a two-armed robot at the origin.
    """
    ends = []
    for x, y, yaw in ((0.56, 0.34, np.pi / 4), (0.56, -0.32, np.pi / 4)):
        along = 0.3 * np.array([np.cos(yaw), np.sin(yaw), 0.0])
        ends.append([np.array([x, y, 0.12]) + along, np.array([x, y, 0.12]) - along])
    left, right = ({"start": s.tolist(), "goal": g.tolist()} for s, g in zip(*ends, strict=True))
    return {
        "name": "flat",
        "duration": 10.0,
        "workspace": {"lower": [0.1, -0.9, -0.2], "upper": [1.2, 0.9, 0.6]},
        "obstacles": [
            {"shape": "box", "center": [0.68, 0.0, -0.175], "size": [0.7, 1.6, 0.05]},
            *(
                {"shape": "cylinder", "center": [x, 0.0, 0.0], "radius": 0.03, "height": 0.3}
                for x in (0.58 - gap / 2 - 0.03, 0.58 + gap / 2 + 0.03)
            ),
        ],
        "load": {
            "shape": "box",
            "size": list(size),
            "grasps": {"left": [0.3, 0, 0.03], "right": [-0.3, 0, 0.03]},
            "mass": 0.3,
        },
        "manipulators": [{"name": "left", **left}, {"name": "right", **right}],
        "robot": "baxter",
        "grasp": {"orientation": "down", "yaw": "load"},
        "limits": {"clearance": 0.005, "speed": 1.0},
        **more,
    }


@cache
def flat():
    return comove.solve(Scene.from_dict(flat_scene()), seed=0, budget=10.0)


def test_a_box_is_carried_flat_between_posts():
    """It is longer than the gap; points of the box find no less clearance than was certified, and hardly more."""
    solution = flat()
    assert solution.verified
    assert solution.report.tilt_max < 1e-9
    truth = least_clearance(solution.attempt)
    assert 0.005 <= solution.report.clearance_min <= truth + 1e-9
    assert truth - solution.report.clearance_min < 1e-3


def test_hands_keep_their_tilt_and_turn_with_the_box():
    motion, scene = flat().attempt, flat().scene
    hands = motion.hands(np.linspace(0, 1, 101))[0]
    rotations = scene.grasp.hand_rotations(hands)
    heading = np.arctan2(
        -rotations[:, 0, 0, 1], rotations[:, 0, 1, 1]
    )  # of the direction in which fingers close
    assert np.allclose(rotations[..., 2], [0, 0, -1], atol=1e-12)
    assert np.ptp(heading) > 1e-3
    along = np.stack([np.cos(heading), np.sin(heading), np.zeros(101)], axis=-1)
    assert np.allclose(hands[:, 0] - hands[:, 1], 0.6 * along, atol=1e-9)


def test_a_straight_way_would_hit_a_post():
    scene = flat().scene
    straight = replace(flat().attempt, weights=np.zeros_like(flat().attempt.weights))
    verdict = comove.verification.verify(straight)
    assert verdict.verified is None
    assert any("obstacles[" in reason for reason in verdict.reasons)
    assert Objective(scene, straight.coordinates).cost(straight).obstacle > 0


@pytest.mark.slow
def test_without_a_planner_the_box_grows():
    solution = comove.solve(Scene.from_dict(flat_scene()), seed=0, budget=10.0, planner=False, robot=False)
    assert solution.verified


def test_it_is_drawn():
    """One outline a state in every view, whose extent from above is that of the turned box."""
    figure = draw_motion(flat().attempt)
    outlines = figure.axes[0].collections[0].get_paths()
    assert len(outlines) > 10
    extent = np.ptp(outlines[0].vertices, axis=0)
    assert extent == pytest.approx([0.7 / np.sqrt(2)] * 2, abs=1e-3)


@examples(25)
@given(seeds)
def test_search_planner_and_scene_agree_on_the_clearance(seed):
    """Of configurations along random motions, wherever they are not capped."""
    motion = box_near_contact(np.random.default_rng(seed))
    scene, coordinates = motion.scene, motion.coordinates
    space = configuration_space(scene, load_coordinates(scene))
    scratch = np.empty((scene.body.n_nodes, 3))
    q = motion.at(np.linspace(0, 1, 12))[0]
    for configuration in q:
        nodes = coordinates.nodes(np.ascontiguousarray(configuration[None, :, None]))[0, 0]
        told, _ = scene.clearance_at(nodes)
        planned = clearance_of(space, configuration, scratch, -np.inf)
        assert planned <= told + 1e-9
        if told > 0:
            assert planned >= min(told, space.cap) - 3e-4
        still = np.repeat(configuration[None, :, None], 3, axis=2)
        objective = Objective(scene, coordinates, penalty=ContactPenalty(margin=0.05))
        searched = objective.evaluate(np.ascontiguousarray(still)).clearance[0]
        assert (
            searched == pytest.approx(min(told, 0.05 + scene.clearance), abs=2e-4)
            or max(searched, told) < 1e-9
        )


def test_contact_of_a_face_is_felt_by_the_search():
    """A pin stands up into the middle of the box: no edge touches it."""
    motion = random_box_motion(np.random.default_rng(3), "two hands")
    data = motion.scene.file.model_dump()
    nodes = motion.coordinates.motion(motion.at([0.5]))[0, 0]
    center = nodes[motion.scene.body.solids[0]].mean(axis=0)
    data["obstacles"] = [{"shape": "sphere", "center": center.tolist(), "radius": 1e-3}]
    scene = Scene.from_dict(data)
    q = motion.at(np.linspace(0, 1, 201))[0].T[None]
    value = Objective(scene, load_coordinates(scene)).evaluate(np.ascontiguousarray(q))
    assert value.clearance[0] < 0
    assert value.hits[0] > 0
    assert value.penalty[0] > 0
