"""A scene of any size is solved as the same scene a metre wide is."""

import numpy as np
import pytest

import comove
from comove.lab.examples import example
from comove.model import CoordinatedMotion, Scene

SCALES = (1e-3, 10.0, 1e3)


@pytest.mark.parametrize("name", ["narrow", "window"])
@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.few(2)
def test_the_same_scene_is_solved_alike_at_any_scale(name, scale):
    scene = example(name)
    here, there = comove.solve(scene, seed=0), comove.solve(scene.scaled(scale), seed=0)
    assert here.motion is not None
    assert there.motion is not None
    assert there.motion.motion.scene is there.scene
    assert there.cost.total / scale**2 == pytest.approx(here.cost.total, rel=0.1)
    assert there.motion.clearance_min / scale == pytest.approx(here.motion.clearance_min, rel=0.2)
    assert there.report.end_error <= 1e-9


def test_a_demonstration_grows_along():
    """Resemblance to what was taught, on a scene a hundred times as large."""
    scene, dmp = example("wide"), comove.DMP.fit(comove.Demonstration.from_lasa("Sine"))
    weights = comove.PaperCost(resemblance=10.0)
    here, there = (
        comove.solve(s, demonstration=dmp, objective=weights, seed=0) for s in (scene, scene.scaled(100.0))
    )
    assert there.cost.resemblance / 1e4 == pytest.approx(here.cost.resemblance, rel=0.2)


@pytest.mark.parametrize("scale", SCALES)
def test_a_scaled_scene_has_all_its_lengths_scaled(scale):
    scene = example("triangle")
    other = scene.scaled(scale)
    assert not 0.3 <= (other.upper - other.lower).max() <= 5.0
    assert other.start == pytest.approx(scale * scene.start)
    assert other.nodes_at("goal") == pytest.approx(scale * scene.nodes_at("goal"))
    assert other.body.radii == pytest.approx(scale * scene.body.radii)
    assert other.speed_limit == pytest.approx(scale * scene.speed_limit)
    assert [c.tolerance for c in other.distances] == pytest.approx(
        [scale * c.tolerance for c in scene.distances]
    )
    point = scene.nodes_at("start")
    assert other.clearance_at(scale * point)[0] == pytest.approx(scale * scene.clearance_at(point)[0])


def test_the_room_that_an_objective_asks_for_is_scaled_and_its_weights_are_not():
    data = example("narrow").file.model_dump(mode="json")
    wish = {"type": "least_jerk", "resemblance": 0.0, "room": 0.02}
    smooth = Scene.from_dict(data | {"demonstration": None, "objective": wish})
    assert smooth.scaled(5.0).file.objective.room == pytest.approx(0.1)
    weights = {"type": "paper", "goal": 2.0, "velocity": 0.02, "obstacle": 3.0}
    paper = Scene.from_dict(data | {"demonstration": None, "objective": weights})
    assert paper.scaled(5.0).file.objective == paper.file.objective


def test_a_motion_on_a_larger_scene_is_the_motion_made_larger():
    scene = example("triangle")
    motion = CoordinatedMotion.straight(scene)
    other = motion.on(scene.scaled(20.0))
    s = np.linspace(0, 1, 11)
    assert other.hands(s) == pytest.approx(20.0 * motion.hands(s))


@pytest.mark.parametrize("scale", [0.02, 50.0])
def test_a_wish_for_room_is_in_the_metres_of_the_scene(scale):
    """A wish that grows with the scene gives the motion that grows with it."""
    scene = example("narrow")
    wish = 0.01
    found = comove.solve(scene, objective=comove.LeastJerk(room=wish))
    other = comove.solve(scene.scaled(scale), objective=comove.LeastJerk(room=scale * wish))
    assert other.report.clearance_min == pytest.approx(scale * found.report.clearance_min, rel=0.05)
    assert other.objective.room == pytest.approx(scale * wish), "as asked for"
    default = comove.solve(scene.scaled(scale)).objective.room
    assert default == pytest.approx(0.01 * (other.scene.upper - other.scene.lower).max()), "and it is told"
