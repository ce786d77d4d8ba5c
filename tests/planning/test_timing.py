"""Bounds of how far obstacles come, against points of them."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from comove.contacts.displaced import carried_forward, instant_at
from comove.geometry.distances import CENTER, REACH, ROTATION
from comove.model import Scene
from comove.planning.timing import fastest_point
from tests.cases import examples

DURATION = 4.0  # s


def scene_of(seed):
    """Bodies that move and turn in several ways, and one at rest."""
    rng = np.random.default_rng(seed)
    turn = {"axis": rng.normal(size=3).tolist(), "rate_deg_per_s": float(rng.uniform(-90, 90))}
    ways = [
        {"velocity": rng.uniform(-0.2, 0.2, 3).tolist(), "turn": turn},
        {"circle": {"radius": 0.2, "period_s": float(rng.uniform(2, 9))}},
        {"turn": turn | {"hinge": [0.0, 0.0, 0.2]}},
        None,
    ]
    shapes = [
        {"shape": "box", "size": [0.1, 0.2, 0.3]},
        {"shape": "sphere", "radius": 0.15},
        {"shape": "capsule", "radius": 0.05, "length": 0.4},
        {"shape": "cylinder", "radius": 0.1, "height": 0.3},
    ]
    bodies = [
        {**shape, "center": [2.0 + k, 2.0, 1.0], **({"motion": way} if way else {})}
        for k, (shape, way) in enumerate(zip(shapes, ways, strict=True))
    ]
    hands = [{"name": n, "start": [0.2, y, 0.5], "goal": [0.8, y, 0.5]} for n, y in (("a", 0.4), ("b", 0.6))]
    return Scene.from_dict(
        {
            "name": "bodies",
            "duration": DURATION,
            "workspace": {"lower": [0, 0, 0], "upper": [9, 3, 2]},
            "obstacles": bodies,
            "load": {"shape": "bar", "length": 0.2},
            "manipulators": hands,
        }
    )


@examples(20)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0), st.floats(0.0, 0.05))
def test_no_point_of_an_obstacle_is_faster_than_told(seed, share, step):
    scene, rng = scene_of(seed), np.random.default_rng(seed)
    moved = scene.displacements(np.linspace(0.0, DURATION, 401))
    fastest = fastest_point(scene.obstacles, moved)
    for row, body in enumerate(scene.obstacles):
        on = rng.normal(size=3)
        on *= body[REACH] / np.linalg.norm(on)
        here, there = body[CENTER:ROTATION] + on, body[CENTER:ROTATION] + on
        carried_forward(moved, row, instant_at(moved, share), here)
        carried_forward(moved, row, instant_at(moved, share + step), there)
        assert np.linalg.norm(there - here) <= fastest * step * (1 + 1e-9) + 1e-12
