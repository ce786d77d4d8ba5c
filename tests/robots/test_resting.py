"""A payload on its stand, carried by two arms: joints, links and simulation."""

from types import SimpleNamespace

import coal
import numpy as np
import pytest

import comove
from comove.model import Scene
from comove.model.resting import SLOPE, TOLERANCE
from comove.robots import Robot
from comove.robots.verification import checks
from comove.sim import play, simulate
from comove.sim.loads import hand_poses


def stands(support=True):
    """Two arms lift a bar off one stand, over a wall, onto another; hands are beside the stands."""
    top = {"shape": "box", "size": [0.1, 0.2, 0.038]} | ({"support": True} if support else {})
    return {
        "name": "stands",
        "duration": 6.0,
        "robot": "two_fr3",
        "grasp": {"orientation": "down", "yaw": "load", "offset_deg": 180},
        "workspace": {"lower": [0.2, -0.6, 0.02], "upper": [0.8, 0.6, 0.7]},
        "obstacles": [
            {"shape": "box", "center": [0.48, 0.0, 0.1], "size": [0.04, 0.9, 0.2]},
            top | {"name": "stand", "center": [0.33, 0.0, 0.119]},
            top | {"name": "shelf", "center": [0.63, 0.0, 0.119]},
        ],
        "load": {"shape": "bar", "length": 0.6, "radius": 0.012, "mass": 0.6},
        "manipulators": [
            {"name": "left", "start": [0.33, 0.3, 0.15], "goal": [0.63, 0.3, 0.15]},
            {"name": "right", "start": [0.33, -0.3, 0.15], "goal": [0.63, -0.3, 0.15]},
        ],
        "limits": {"speed": 0.5, "acceleration": 1.0, "clearance": 0.005},
    }


@pytest.mark.slow
def test_arms_lift_a_payload_off_its_stand_and_set_it_down():
    scene, robot = Scene.from_dict(stands()), Robot.load("two_fr3")
    found = comove.solve(scene, robot=robot, seed=0)
    assert found.verified, found.reasons
    assert found.joints.report.clearance_scene >= 0.005  # of links, which nothing relieves
    joints = found.joints.attempt
    time = np.linspace(0.0, joints.duration, 1501)
    hands = hand_poses(robot, scene, joints.at(time)[0])[..., :3, 3]
    moved = [np.linalg.norm(hands - end, axis=2).max(axis=1) for end in (scene.start, scene.goal)]
    bar = coal.Capsule(0.012, 0.6)
    for i, away in ((1, moved[0]), (2, moved[1])):
        obstacle = scene.file.obstacles[i]
        stand, place = coal.Box(*obstacle.size), coal.Transform3s(np.eye(3), np.array(obstacle.center))
        required = np.minimum(scene.clearance, SLOPE * away - TOLERANCE)
        for (left, right), least in zip(hands, required, strict=True):
            along = (left - right) / np.linalg.norm(left - right)
            side = np.cross(along, [0.0, 0.0, 1.0])
            turn = np.column_stack([side, np.cross(along, side), along])
            at, result = coal.Transform3s(turn, 0.5 * (left + right)), coal.DistanceResult()
            distance = coal.distance(bar, at, stand, place, coal.DistanceRequest(), result)
            assert distance >= least - 2e-5
    for execution in (simulate(joints, scene, robot), play(joints, robot, scene)):
        assert execution.delivered, execution.reasons
    touched = simulate(joints, Scene.from_dict(stands(support=False), check_ends=False), robot)
    assert {contact.between[1] for contact in touched.contacts} == {"stand (box)", "shelf (box)"}


@pytest.mark.parametrize(("off", "refused"), [(0.0, False), (5e-5, False), (1e-3, True)])
def test_resting_contacts_allow_for_bases_that_are_not_known_exactly(off, refused, monkeypatch):
    monkeypatch.setattr(checks, "Carried", lambda motion: None)
    monkeypatch.setattr(checks.Displacement, "of", lambda *_: (off, off))
    bases = SimpleNamespace(turn=0.0, uncertainty=SimpleNamespace(position=off), deviations=None)
    report = SimpleNamespace(clearance_min=0.005, support_distance_min=-TOLERANCE)
    motion, errors = SimpleNamespace(motion=None, report=report), SimpleNamespace(hands=np.zeros((2, 1, 3)))
    found = checks.displacements(bases, (None,), errors, motion, None)
    assert bool(found.reasons) == refused
