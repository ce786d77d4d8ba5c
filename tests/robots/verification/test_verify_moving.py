"""Clearances of links among moving obstacles against dense sampling on the raw URDF."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.model import Scene
from comove.robots import verify_joints
from comove.robots.motion import Ranges
from comove.robots.verification.bodies import SCENE, MovingObstacles
from tests.cases import examples
from tests.robots.known_carry import DURATION, baxter, known_carry, on_scene, scene_data
from tests.robots.raw_links import RawLinks
from tests.robots.verification.test_verify_clearance import certified

TIGHT, COAL = 1e-3, 2e-4  # m, of bounds, and of distances


@cache
def raw_baxter():
    """Baxter as its file has it."""
    return RawLinks(baxter())


def passing(rng):
    """A sphere that moves past the arms, or a plank that swings about an end, somewhere."""
    place = rng.uniform([0.2, -0.8, 0.25], [1.0, 0.8, 0.9])
    there = rng.uniform([0.2, -0.8, 0.25], [1.0, 0.8, 0.9])
    times = np.sort(rng.uniform(0.0, DURATION, 3)).round(3)
    turn = {"axis": rng.normal(size=3).round(3).tolist(), "rate_deg_per_s": float(rng.uniform(-60, 60))}
    ways = [
        {"velocity": ((there - place) / DURATION).round(4).tolist()},
        {"circle": {"radius": 0.2, "period_s": float(rng.uniform(2, 20))}},
        {
            "waypoints": [place.round(4).tolist(), there.round(4).tolist(), place.round(4).tolist()],
            "times": times.tolist(),
        },
        {"turn": turn | {"hinge": [0.25, 0.0, 0.0]}},
    ]
    how = ways[rng.integers(len(ways))]
    solid = (
        {"shape": "box", "size": [0.5, 0.08, 0.04]} if "turn" in how else {"shape": "sphere", "radius": 0.08}
    )
    return solid | {"center": place.round(4).tolist(), "motion": how}


@examples(10)
@given(st.integers(0, 2**32 - 1))
def test_clearances_from_moving_obstacles_are_those_of_dense_sampling(seed):
    motion, joints = known_carry()
    obstacle = passing(np.random.default_rng(seed))
    scene = Scene.from_dict(scene_data(obstacles=(obstacle,)), check_ends=False)
    (found, *_), required = certified(on_scene(motion, scene), joints)
    look = lambda time: raw_baxter().distances(scene.file.obstacles, time, joints.curve(time))  # noqa: E731
    near = look(np.linspace(0.0, DURATION, 201)).min(axis=(1, 2)).argsort()[:20]
    time = np.unique(np.clip(np.add.outer(near / 20.0, np.linspace(-0.05, 0.05, 21)), 0.0, DURATION))
    least = look(time).min()
    assert found.lower <= least + COAL
    if least > required[SCENE] + COAL + TIGHT:
        assert found.lower >= least - COAL - TIGHT - 1e-3  # as far as things get between samples
    elif least < required[SCENE] - COAL:
        assert found.upper < required[SCENE]


def crossing(when):
    """A sphere that crosses the known path, faster than samples tell, at a time [s]."""
    ends = [[0.78, 0.585, 2.0], [0.78, 0.585, -2.0]]
    how = {"waypoints": ends, "times": [when - 0.05, when + 0.05]}
    return {"name": "ball", "shape": "sphere", "radius": 0.05, "center": ends[0], "motion": how}


def test_a_sphere_that_crosses_is_seen_only_where_something_is_in_its_way():
    """It passes where the left arm is after 3 s, and where nothing is later."""
    motion, joints = known_carry()
    for when, clear in ((5.0, True), (3.0, False), (8.0, True)):
        scene = Scene.from_dict(
            scene_data(obstacles=(crossing(when),), workspace={"lower": [-3] * 3, "upper": [3] * 3})
        )
        verdict = verify_joints(baxter(), on_scene(motion, scene), joints)
        (found, *_), required = certified(on_scene(motion, scene), joints)
        assert (found.lower >= required[SCENE]) == clear, found
        assert (verdict.verified is not None) is clear


def test_the_bound_rests_on_the_speed_of_obstacles(monkeypatch):
    """Without it the sphere passes between the instants that are looked at."""
    monkeypatch.setattr(
        MovingObstacles,
        "speed",
        property(lambda own: Ranges(np.array([0.0, DURATION]), np.zeros((1, 1)))),
    )
    motion, joints = known_carry()
    scene = Scene.from_dict(
        scene_data(obstacles=(crossing(3.0),), workspace={"lower": [-3] * 3, "upper": [3] * 3})
    )
    (found, *_), required = certified(on_scene(motion, scene), joints)
    assert found.lower >= required[SCENE], "then this test says nothing"


@pytest.mark.parametrize("link", ["torso", "pedestal"])
def test_obstacles_are_kept_from_links_that_nothing_moves(link):
    """An obstacle that drives into the robot's base meets it, wherever the arms are."""
    height = {"torso": 0.1, "pedestal": -0.6}[link]
    way = [[-2.0, 0.0, height], [0.0, 0.0, height]]
    ram = {"shape": "box", "size": [0.2, 0.2, 0.05], "center": way[0], "name": "ram"}
    ram["motion"] = {"waypoints": way, "times": [0.0, DURATION]}
    scene = Scene.from_dict(scene_data(obstacles=(ram,), workspace={"lower": [-3] * 3, "upper": [3] * 3}))
    motion, joints = known_carry()
    verdict = verify_joints(baxter(), on_scene(motion, scene), joints)
    assert verdict.verified is None
    assert any("ram" in reason and " s " in reason for reason in verdict.reasons), verdict.reasons
