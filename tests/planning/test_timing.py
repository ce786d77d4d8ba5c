"""Tables of obstacles at a time, and bounds of how far obstacles come, against the scene's own."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from comove.geometry.distances import CENTER, REACH, ROTATION
from comove.model import Scene
from comove.planning.timing import fastest_point, place_obstacles
from tests.cases import examples

DURATION = 4.0  # s


def scene_of(seed):
    """Boxes that move and turn in several ways, and one at rest."""
    rng = np.random.default_rng(seed)
    turn = {"axis": rng.normal(size=3).tolist(), "rate_deg_per_s": float(rng.uniform(-90, 90))}
    ways = [
        {"velocity": rng.uniform(-0.2, 0.2, 3).tolist(), "turn": turn},
        {"circle": {"radius": 0.2, "period_s": float(rng.uniform(2, 9))}},
        {"turn": turn | {"hinge": [0.0, 0.0, 0.2]}},
        None,
    ]
    boxes = [
        {
            "shape": "box",
            "size": [0.1, 0.2, 0.3],
            "center": [2.0 + k, 2.0, 1.0],
            **({"motion": way} if way else {}),
        }
        for k, way in enumerate(ways)
    ]
    hands = [{"name": n, "start": [0.2, y, 0.5], "goal": [0.8, y, 0.5]} for n, y in (("a", 0.4), ("b", 0.6))]
    return Scene.from_dict(
        {
            "name": "boxes",
            "duration": DURATION,
            "workspace": {"lower": [0, 0, 0], "upper": [9, 3, 2]},
            "obstacles": boxes,
            "load": {"shape": "bar", "length": 0.2},
            "manipulators": hands,
        }
    )


@examples(20)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0), st.floats(0.0, 0.05))
def test_tables_are_those_of_the_scene_and_no_point_is_faster_than_told(seed, share, step):
    scene = scene_of(seed)
    moved = scene.displacements(np.linspace(0.0, DURATION, 401))
    table, later = scene.obstacles.copy(), scene.obstacles.copy()
    place_obstacles(scene.obstacles, moved, share, table)
    exact = scene.obstacles_at(share * DURATION)
    np.testing.assert_allclose(table[:, CENTER:ROTATION], exact[:, CENTER:ROTATION], atol=1e-4)
    np.testing.assert_allclose(
        table[:, ROTATION : ROTATION + 9], exact[:, ROTATION : ROTATION + 9], atol=1e-9
    )
    sample = round(share * 400) / 400  # where displacements are not interpolated
    place_obstacles(scene.obstacles, moved, sample, later)
    np.testing.assert_allclose(later, scene.obstacles_at(sample * DURATION), atol=1e-12)
    place_obstacles(scene.obstacles, moved, 1.0, later)  # a table that was used for another time
    place_obstacles(scene.obstacles, moved, 0.0, later)
    np.testing.assert_array_equal(later, scene.obstacles)
    place_obstacles(scene.obstacles, moved, share + step, later)
    shift = np.linalg.norm(later[:, CENTER:ROTATION] - table[:, CENTER:ROTATION], axis=1)
    turn = np.linalg.norm(later[:, ROTATION : ROTATION + 9] - table[:, ROTATION : ROTATION + 9], axis=1)
    away = (
        shift + turn / np.sqrt(2.0) * scene.obstacles[:, REACH]
    )  # of the point that is furthest from the axis
    assert (away <= fastest_point(scene.obstacles, moved) * step * (1 + 1e-9) + 1e-12).all()


def test_nothing_is_moved_where_nothing_moves():
    scene = scene_of(0).standing()
    table = np.full_like(scene.obstacles, 7.0)
    place_obstacles(scene.obstacles, scene.displacements(np.zeros(0)), 0.5, table)
    assert (table == 7.0).all()
